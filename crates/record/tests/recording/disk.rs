//! Proves: whatever the disk does, the loop goes on, what is whole can be read, numbers are kept as long as there is room for them, pictures give
//! way first and are counted. Runs on a clock that is told; the real disk that fills up is tried by hand (docs/performance.md).

use crate::runs;
use crate::runs::{Disk, Mood, description, pair, png, step};
use proptest::prelude::*;
use vergence_record::recording::Info;
use vergence_record::{Beside, Limits, RecordSettings, RecordStatus, Recorder, Storage, WhenFull};

const SIZE: (usize, usize) = (64, 48);

/// Record so many pairs on a disk that changes its mood before some of them.
fn run(settings: RecordSettings, pairs: u64, moods: &[(u64, Mood)]) -> (Info, RecordStatus, bool) {
    let disk = Disk::new();
    let mut recorder = Recorder::here(description(SIZE), settings, Box::new(disk.clone())).unwrap();
    for index in 0..pairs {
        if let Some((_, mood)) = moods.iter().find(|(at, _)| *at == index) {
            disk.set(*mood);
        }
        let pair = pair(index, SIZE);
        let step = step(&pair);
        recorder.step(&pair, &step, Beside::default());
        recorder.pump(step.command_s);
        let [pictures, numbers] = recorder.waiting_bytes();
        let one = 2 * 3 * SIZE.0 * SIZE.1;
        assert!(pictures <= settings.limits.pictures_bytes.max(one));
        assert!(numbers <= settings.limits.numbers_bytes);
    }
    let (status, result) = recorder.finish(pairs as f64 / runs::FPS + 1.0);
    let info = Info::read(&disk.bytes()[..]).unwrap();
    (info, status, result.is_ok())
}

/// A disk that is busy for two seconds: pictures are thinned and counted, every number is there, and thinning ends.
#[test]
fn a_slow_disk_costs_pictures_only() {
    let settings = RecordSettings {
        limits: Limits {
            pictures_bytes: 10 * 2 * 3 * SIZE.0 * SIZE.1,
            ..Limits::default()
        },
        ..png()
    };
    let (info, status, finished) = run(
        settings,
        400,
        &[(60, Mood::Busy), (120, Mood::Good), (150, Mood::Short(700))],
    );
    assert!(finished && info.contents.problems.is_empty());
    assert_eq!(info.pairs, 400);
    assert_eq!(status.counts.numbers_lost, 0);
    assert!(status.counts.pictures_thinned > 30, "{status:?}");
    assert_eq!(status.every, 1, "thinning ends when the disk is well again");
    let images = info
        .channels
        .iter()
        .find(|c| c.topic == "/left/image")
        .unwrap();
    assert_eq!(images.messages, status.counts.pictures_kept);
    assert_eq!(
        status.counts.pictures_kept + status.counts.pictures_thinned,
        400
    );
    assert_eq!(
        info.recorder.unwrap().pictures_thinned,
        status.counts.pictures_thinned,
        "the recording says itself what it lacks"
    );
}

/// A full disk is told, costs no number while there is memory, and when it has room again the file goes on whole.
#[test]
fn a_full_disk_recovers() {
    let (info, status, finished) = run(png(), 300, &[(50, Mood::Full), (200, Mood::Good)]);
    assert!(finished && info.contents.problems.is_empty());
    assert_eq!((info.pairs, status.counts.numbers_lost), (300, 0));
    assert_eq!(status.failures, 1);
    assert!(status.counts.pictures_thinned >= 100);
    let failed = info.recorder.unwrap();
    assert_eq!(failed.failed, None);
}

/// A disk that stays full: what was there before is whole and is all that is there; the end of the file says so by its absence.
#[test]
fn a_disk_that_stays_full_keeps_what_it_has() {
    let (info, status, finished) = run(png(), 300, &[(100, Mood::Full)]);
    assert!(!finished && !info.contents.finished);
    assert!(status.failure.is_some());
    // Everything but the last chunk that was open.
    assert!((80..=100).contains(&info.pairs), "{}", info.pairs);
    assert_eq!(
        info.contents.problems.len(),
        1,
        "{:?}",
        info.contents.problems
    );
}

/// A disk that is full from the start is told before anything depends on it.
#[test]
fn full_from_the_start() {
    let disk = Disk::new();
    disk.set(Mood::Full);
    let storage = || Box::new(disk.clone());
    let here = Recorder::here(description(SIZE), png(), storage());
    let beside = Recorder::beside(description(SIZE), png(), storage(), WhenFull::Thin);
    for refused in [here.err(), beside.err()] {
        let text = refused.unwrap().to_string();
        assert!(text.contains("beginning the recording failed"), "{text}");
    }
    assert!(disk.bytes().is_empty());
}

/// What waits when the end comes is not lost because the disk took nothing a moment before: it is asked again. What it does not take then is counted.
#[test]
fn an_end_asks_again() {
    for (last, lost) in [(Mood::Good, false), (Mood::Busy, true), (Mood::Full, true)] {
        let disk = Disk::new();
        let mut recorder =
            Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap();
        disk.set(Mood::Full);
        for index in 0..40 {
            let pair = pair(index, SIZE);
            let step = step(&pair);
            recorder.step(&pair, &step, Beside::default());
            recorder.pump(step.command_s);
        }
        disk.set(last);
        // Less than the half second after which a disk that failed is asked again by itself.
        let (status, result) = recorder.finish(40.0 / runs::FPS);
        assert_eq!(result.is_err(), lost, "{last:?}");
        assert_eq!(status.counts.numbers_lost > 0, lost, "{last:?}");
        let info = Info::read(&disk.bytes()[..]).unwrap();
        let numbers: u64 = (info.channels.iter())
            .filter(|c| !c.topic.ends_with("/image"))
            .map(|c| c.messages)
            .sum();
        assert_eq!(numbers, status.counts.numbers_kept, "{last:?}");
        assert_eq!(info.pairs, if lost { 0 } else { 40 });
    }
}

/// A disk whose writing ends the thread.
struct Trap(u32);

impl Storage for Trap {
    fn append(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        assert!(self.0 > 0, "the trap");
        self.0 -= 1;
        Ok(bytes.len())
    }

    fn sync(&mut self) -> std::io::Result<()> {
        Ok(())
    }

    fn cut(&mut self, _length: u64) -> std::io::Result<()> {
        Ok(())
    }
}

/// A thread that panicked makes room for nobody: who waits for it goes on, and is told.
#[test]
fn nobody_waits_for_a_thread_that_ended() {
    let settings = RecordSettings {
        limits: Limits {
            pictures_bytes: 1,
            numbers_bytes: 1,
        },
        ..png()
    };
    // The head of the file is one write.
    let storage = Box::new(Trap(1));
    let mut recorder =
        Recorder::beside(description(SIZE), settings, storage, WhenFull::Wait).unwrap();
    for index in 0..100 {
        let pair = pair(index, SIZE);
        recorder.step(&pair, &step(&pair), Beside::default());
    }
    assert!(recorder.status().failure.is_some());
    let (status, result) = recorder.finish(10.0);
    assert!(result.unwrap_err().to_string().contains("ended by itself"));
    assert!(status.counts.numbers_lost > 400, "{status:?}");
}

/// A recorder that nobody finishes (an error on the way, a panic) writes what waits and ends the file.
#[test]
fn a_dropped_recorder_writes_what_waits() {
    let disk = Disk::new();
    let storage = Box::new(disk.clone());
    let mut recorder = Recorder::beside(description(SIZE), png(), storage, WhenFull::Thin).unwrap();
    for index in 0..9 {
        let pair = pair(index, SIZE);
        recorder.step(&pair, &step(&pair), Beside::default());
    }
    drop(recorder);
    let info = Info::read(&disk.bytes()[..]).unwrap();
    assert!(info.contents.finished && info.contents.problems.is_empty());
    assert_eq!(info.pairs, 9);
}

/// Even numbers have a bound: it is kept, and what is lost is counted.
#[test]
fn memory_is_bounded() {
    let settings = RecordSettings {
        limits: Limits {
            numbers_bytes: 40_000,
            ..Limits::default()
        },
        ..png()
    };
    let (_, status, _) = run(settings, 200, &[(10, Mood::Full)]);
    assert!(status.counts.numbers_lost > 500);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Moods in any order: the file is readable to its last whole chunk, and if it is finished every pair is there.
    #[test]
    fn any_moods(changes in prop::collection::vec((0u64..120, 0u8..4), 0..6)) {
        let moods: Vec<_> = changes
            .iter()
            .map(|(at, mood)| (*at, match mood {
                0 => Mood::Good,
                1 => Mood::Short(999),
                2 => Mood::Busy,
                _ => Mood::Full,
            }))
            .collect();
        let disk = Disk::new();
        let mut recorder = Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap();
        for index in 0..120 {
            if let Some((_, mood)) = moods.iter().find(|(at, _)| *at == index) {
                disk.set(*mood);
            }
            let pair = pair(index, SIZE);
            recorder.step(&pair, &step(&pair), Beside::default());
            recorder.pump(index as f64 / runs::FPS);
        }
        let (status, result) = recorder.finish(10.0);
        prop_assert_eq!(status.counts.numbers_lost == 0, result.is_ok());
        let info = Info::read(&disk.bytes()[..]).unwrap();
        prop_assert_eq!(info.unreadable, 0);
        let numbers: u64 = (info.channels.iter())
            .filter(|c| !c.topic.ends_with("/image"))
            .map(|c| c.messages)
            .sum();
        prop_assert_eq!(numbers, status.counts.numbers_kept);
        prop_assert_eq!(info.contents.finished, result.is_ok());
        prop_assert_eq!(info.contents.problems.len(), usize::from(result.is_err()));
        if result.is_ok() {
            prop_assert_eq!(info.pairs, 120);
        }
    }
}

/// Beside a loop in real time the writing thread is nicer than all others, which stay as they are.
#[cfg(target_os = "linux")]
#[test]
fn the_writer_lets_the_loop_go_first() {
    let niceness = |of_writer: bool| -> Vec<i32> {
        let tasks = std::fs::read_dir("/proc/self/task").unwrap();
        tasks
            .filter_map(|task| {
                let stat = std::fs::read_to_string(task.ok()?.path().join("stat")).ok()?;
                // Number, name in brackets, and then the nineteenth field (proc(5)).
                let (name, rest) = stat.rsplit_once(')')?;
                let nice = rest.split_whitespace().nth(16)?.parse().ok()?;
                (name.ends_with("(recorder") == of_writer).then_some(nice)
            })
            .collect()
    };
    let disk = Box::new(Disk::new());
    let usual = niceness(false).into_iter().min().unwrap();
    let recorder = Recorder::beside(description(SIZE), png(), disk, WhenFull::Thin).unwrap();
    let mut nicer = false;
    for _ in 0..200 {
        nicer = niceness(true).contains(&(usual + 5));
        if nicer {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    assert!(nicer, "{:?}", niceness(true));
    assert!(niceness(false).iter().all(|nice| *nice == usual));
    recorder.finish(0.0).1.unwrap();
}
