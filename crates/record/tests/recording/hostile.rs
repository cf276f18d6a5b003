//! Proves: no file, however damaged or malicious, makes the reader panic, read for ever or take memory that the file does not have; what is wrong is said in one
//! sentence. Does not prove that every damage is found: a chunk without a checksum may lie.

use crate::runs::{Disk, description, pair, png, step};
use proptest::prelude::*;
use vergence_capture::Source as _;
use vergence_record::mcap::{Event, Reader};
use vergence_record::recording::{Info, Recording};
use vergence_record::{Beside, Description, RecordError, Recorder, ReplaySource};

const SIZE: (usize, usize) = (32, 24);

fn recorded(pairs: u64) -> Vec<u8> {
    let disk = Disk::new();
    let mut recorder = Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap();
    for index in 0..pairs {
        let pair = pair(index, SIZE);
        let step = step(&pair);
        recorder.step(&pair, &step, Beside::default());
        recorder.pump(step.command_s);
    }
    recorder.finish(1e3).1.unwrap();
    disk.bytes()
}

/// Where the whole records of a file end, and the pairs up to there.
fn chunks(bytes: &[u8]) -> Vec<u64> {
    let mut reader = Reader::new(bytes).unwrap();
    let mut ends = Vec::new();
    while let Some(event) = reader.next_event().unwrap() {
        if let Event::Chunk { offset, length } = event {
            ends.push(offset + length);
        }
    }
    ends
}

/// Cut at any byte, a file gives every chunk that is whole and nothing else, and says that it was cut.
#[test]
fn cut_anywhere() {
    let bytes = recorded(40);
    let messages = |bytes: &[u8]| {
        let info = Info::read(bytes).unwrap();
        let count: u64 = info.channels.iter().map(|c| c.messages).sum();
        (info, count)
    };
    // Messages up to the end of each chunk, by reading the file up to there.
    let ends: Vec<_> = (chunks(&bytes).into_iter())
        .map(|end| (end, messages(&bytes[..end as usize]).1))
        .collect();
    assert!(ends.len() >= 3 && ends.windows(2).all(|w| w[0].1 < w[1].1));
    for cut in (8..bytes.len()).step_by(997) {
        let (info, found) = messages(&bytes[..cut]);
        assert!(!info.contents.finished);
        assert_eq!(info.contents.problems.len(), 1, "cut at {cut}");
        let whole = ends.iter().rev().find(|(end, _)| *end <= cut as u64);
        assert_eq!(found, whole.map_or(0, |(_, count)| *count), "cut at {cut}");
    }
}

/// One flipped byte within a chunk costs that chunk and no other, and is told.
#[test]
fn a_flipped_byte_costs_one_chunk() {
    let mut bytes = recorded(40);
    let ends = chunks(&bytes);
    let before = Info::read(&bytes[..]).unwrap().pairs;
    bytes[ends[1] as usize - 500] ^= 0x40;
    let info = Info::read(&bytes[..]).unwrap();
    assert!(info.contents.finished);
    assert_eq!(info.contents.problems.len(), 1);
    let text = info.contents.problems[0].to_string();
    assert!(text.contains("checksum"), "{text}");
    assert!(info.pairs < before && info.pairs > before / 3);
}

/// Each kind of file that is no recording of ours is refused in words that say what it is.
#[test]
fn other_files() {
    let said = |bytes: &[u8]| match Info::read(bytes) {
        Err(RecordError::Format(text)) => text,
        other => panic!("{other:?}"),
    };
    assert!(said(b"").contains("empty"));
    assert!(said(b"RIFF....AVI ").contains("not an MCAP"));
    assert!(said(b"\x89MCAP1\r\n").contains("version '1'"));
    assert!(said(b"\x89MCA").contains("not an MCAP"));
}

/// Lengths that lie: larger than anything that is read, and larger than the file.
#[test]
fn lying_lengths() {
    for (length, word) in [
        (u64::MAX, "says that it has"),
        (1 << 25, "was not finished"),
    ] {
        let mut bytes = b"\x89MCAP0\r\n\x06".to_vec();
        bytes.extend(length.to_le_bytes());
        bytes.extend([0; 100]);
        let info = Info::read(&bytes[..]).unwrap();
        let text = info.contents.problems[0].to_string();
        assert!(text.contains(word), "{text}");
    }
}

/// A chunk that is compressed is left out, with what to do.
#[test]
fn compressed_chunks_are_told() {
    let mut bytes = b"\x89MCAP0\r\n\x06".to_vec();
    let mut chunk = vec![0u8; 28];
    chunk.extend(3u32.to_le_bytes());
    chunk.extend(b"lz4");
    chunk.extend(4u64.to_le_bytes());
    chunk.extend([1, 2, 3, 4]);
    bytes.extend((chunk.len() as u64).to_le_bytes());
    bytes.extend(chunk);
    let info = Info::read(&bytes[..]).unwrap();
    let text = info.contents.problems[0].to_string();
    assert!(
        text.contains("compressed (lz4)") && text.contains("mcap compress"),
        "{text}"
    );
}

/// Names of thousands of channels and facts without end are not kept.
#[test]
fn what_is_kept_is_bounded() {
    let mut writer = Vec::new();
    let text = |out: &mut Vec<u8>, length: usize| {
        out.extend((length as u32).to_le_bytes());
        out.extend(vec![b'x'; length]);
    };
    let record = |out: &mut Vec<u8>, opcode: u8, content: &[u8]| {
        out.push(opcode);
        out.extend((content.len() as u64).to_le_bytes());
        out.extend(content);
    };
    writer.extend(b"\x89MCAP0\r\n");
    // Two channels: a name that is too long, and one that is not.
    for length in [100_000, 10] {
        let mut channel = (length as u16).to_le_bytes().to_vec();
        channel.extend([0; 2]);
        text(&mut channel, length);
        text(&mut channel, 8);
        record(&mut writer, 4, &channel);
    }
    // A hundred metadata records of ours, each with a fact of 100 kB under another name.
    for index in 0..100u8 {
        let mut map = vec![1, 0, 0, 0, b' ' + index];
        text(&mut map, 100_000);
        let mut metadata = b"\x08\0\0\0vergence".to_vec();
        metadata.extend((map.len() as u32).to_le_bytes());
        metadata.extend(map);
        record(&mut writer, 12, &metadata);
    }
    let info = Info::read(&writer[..]).unwrap();
    assert_eq!(info.channels.len(), 1);
    assert!(
        info.contents.problems[0]
            .to_string()
            .contains("at most 1000")
    );
    let kept: usize = info.contents.facts.values().map(String::len).sum();
    assert!((1_000_000..5_000_000).contains(&kept), "{kept}");
}

/// Numbers of pairs that jump to and fro do not overflow what is missing.
#[test]
fn numbers_of_pairs_that_jump() {
    let disk = Disk::new();
    let mut recorder = Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap();
    for (place, index) in [0, u64::MAX, 0, u64::MAX, 0].into_iter().enumerate() {
        let mut pair = pair(place as u64, SIZE);
        pair.index = index;
        recorder.step(&pair, &step(&pair), Beside::default());
    }
    recorder.finish(1.0).1.unwrap();
    let info = Info::read(&disk.bytes()[..]).unwrap();
    assert_eq!((info.pairs, info.pairs_missing), (5, u64::MAX));
}

/// A recording as a file that a replay opens.
fn opened(bytes: &[u8]) -> Result<ReplaySource, RecordError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    std::fs::write(&path, bytes).unwrap();
    ReplaySource::open(&path)
}

/// Cameras that no computation can use are refused before it begins.
#[test]
fn cameras_that_are_none() {
    let mut bad = Vec::new();
    for change in [
        |d: &mut Description| d.fps = f64::NAN,
        |d: &mut Description| d.cameras[0].intrinsics.fx = 0.0,
        |d: &mut Description| d.cameras[1].intrinsics.cy = f64::INFINITY,
        |d: &mut Description| d.cameras[1].intrinsics.width = 0,
        |d: &mut Description| d.cameras[1].intrinsics.height = 1 << 40,
    ] {
        let mut description = description(SIZE);
        change(&mut description);
        bad.push(description);
    }
    for (wrong, description) in [(false, description(SIZE))]
        .into_iter()
        .chain(bad.into_iter().map(|d| (true, d)))
    {
        let disk = Disk::new();
        let mut recorder = Recorder::here(description, png(), Box::new(disk.clone())).unwrap();
        let pair = pair(0, SIZE);
        recorder.step(&pair, &step(&pair), Beside::default());
        recorder.finish(1.0).1.unwrap();
        let answer = opened(&disk.bytes());
        assert_eq!(answer.is_err(), wrong, "{:?}", answer.err());
    }
}

/// A recording whose pictures are larger than its cameras say is refused before they are decoded.
#[test]
fn pictures_of_another_size() {
    let disk = Disk::new();
    let mut recorder =
        Recorder::here(description((16, 16)), png(), Box::new(disk.clone())).unwrap();
    let pair = pair(0, SIZE);
    recorder.step(&pair, &step(&pair), Beside::default());
    recorder.finish(1.0).1.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    std::fs::write(&path, disk.bytes()).unwrap();
    let mut source = ReplaySource::open(&path).unwrap();
    let error = source.next_pair(None).unwrap_err();
    assert!(error.to_string().contains("32x24"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// Any bytes after the magic.
    #[test]
    fn any_bytes(tail in prop::collection::vec(any::<u8>(), 0..400)) {
        let mut bytes = b"\x89MCAP0\r\n".to_vec();
        bytes.extend(tail);
        let info = Info::read(&bytes[..]).unwrap();
        prop_assert!(info.contents.problems.len() <= 101);
    }

    /// A real file with bytes changed, taken out and put in, checksums set right or to none so that the inner records are reached.
    #[test]
    fn changed_files(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0u8..3), 1..20),
        without_sums in any::<bool>(),
    ) {
        let mut bytes = small().clone();
        if without_sums {
            drop_sums(&mut bytes);
        }
        for (at, byte, kind) in changes {
            let at = at.index(bytes.len() - 8) + 8;
            match kind {
                0 => bytes[at] = byte,
                1 => { bytes.remove(at.min(bytes.len() - 1)); }
                _ => bytes.insert(at, byte),
            }
        }
        let info = Info::read(&bytes[..]).unwrap();
        prop_assert!(info.pairs <= 4);
        // A replay refuses in a sentence or goes to its end.
        if let Ok(mut source) = opened(&bytes) {
            for _ in 0..6 {
                match source.next_pair(None) {
                    Ok(Some(_)) => {}
                    Ok(None) | Err(_) => break,
                }
            }
        }
    }

    /// Lengths of a real file replaced by any other: nothing is taken that the file does not have.
    #[test]
    fn any_lengths(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u64>(), 0u32..64), 1..8)) {
        let mut bytes = small().clone();
        drop_sums(&mut bytes);
        let lengths = lengths(&bytes);
        for (which, length, shift) in changes {
            let at = lengths[which.index(lengths.len())];
            bytes[at..at + 8].copy_from_slice(&(length >> shift).to_le_bytes());
        }
        let mut recording = Recording::new(&bytes[..]).unwrap();
        let mut given = 0;
        while let Some(message) = recording.next_message().unwrap() {
            given += message.data.len();
            prop_assert!(message.data.capacity() <= 2 * bytes.len());
        }
        let attached: usize = recording.contents().attachments.iter().map(|(_, d)| d.len()).sum();
        prop_assert!(given + attached <= bytes.len());
    }
}

/// Where the lengths of a file's records stand, those within chunks too.
fn lengths(bytes: &[u8]) -> Vec<usize> {
    fn walk(bytes: &[u8], from: usize, to: usize, found: &mut Vec<usize>) {
        let mut at = from;
        while at + 9 <= to {
            found.push(at + 1);
            let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
            if bytes[at] == 6 {
                // Its size, its compression (none) and the length of its records come first.
                found.extend([at + 9 + 16, at + 9 + 32]);
                walk(bytes, at + 9 + 40, at + 9 + length, found);
            }
            at += 9 + length;
        }
    }
    let mut found = Vec::new();
    walk(bytes, 8, bytes.len() - 8, &mut found);
    assert!(found.len() > 50);
    found
}

fn small() -> &'static Vec<u8> {
    static SMALL: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    SMALL.get_or_init(|| recorded(3))
}

/// Set the checksums of all chunks to "none".
fn drop_sums(bytes: &mut [u8]) {
    let whole = bytes.to_vec();
    let mut reader = Reader::new(&whole[..]).unwrap();
    while let Some(event) = reader.next_event().unwrap() {
        if let Event::Chunk { offset, .. } = event {
            let at = offset as usize + 9 + 24;
            bytes[at..at + 4].fill(0);
        }
    }
}
