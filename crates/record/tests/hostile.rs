//! Proves: no file, however damaged or malicious, makes the reader panic, read for ever or take memory that the file does not have; what is wrong is said in one
//! sentence. Does not prove that every damage is found: a chunk without a checksum may lie.

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod runs;

use proptest::prelude::*;
use runs::{Disk, description, pair, png, step};
use vergence_record::mcap::{Event, Reader};
use vergence_record::recording::Info;
use vergence_record::{Beside, RecordError, Recorder, ReplaySource};

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

/// Cut at any byte, a file gives every chunk that is whole, and says that it was cut.
#[test]
fn cut_anywhere() {
    let bytes = recorded(40);
    let whole = Info::read(&bytes[..]).unwrap();
    let ends = chunks(&bytes);
    assert!(ends.len() >= 3);
    for cut in (8..bytes.len()).step_by(997) {
        let info = Info::read(&bytes[..cut]).unwrap();
        assert!(!info.contents.finished);
        assert_eq!(info.contents.problems.len(), 1, "cut at {cut}");
        let read = ends.iter().filter(|end| **end <= cut as u64).count();
        let share = info.pairs as f64 / whole.pairs as f64;
        let wanted = read as f64 / ends.len() as f64;
        assert!(
            (share - wanted).abs() < 0.5,
            "{share} of the pairs at {wanted} of the chunks"
        );
        assert!(info.pairs > 0 || read == 0);
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
    chunk.extend(u64::MAX.to_le_bytes());
    bytes.extend((chunk.len() as u64).to_le_bytes());
    bytes.extend(chunk);
    let info = Info::read(&bytes[..]).unwrap();
    assert!(!info.contents.problems.is_empty());
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
    let error = vergence_capture::Source::next_pair(&mut source, None).unwrap_err();
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
    }
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
