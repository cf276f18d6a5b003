//! Proves: what is recorded is read back, every bit of numbers and (as PNG) of pictures; the same run gives the same bytes with and without a thread;
//! a replay gives the pairs and the readings again. Does not say that other programs read it: `ci/record` does.

use crate::runs;
use crate::runs::{Disk, description, pair, png, readings, step};
use vergence_capture::Source as _;
use vergence_control::{AxisLimits, AxisName};
use vergence_record::recording::{Info, Recording};
use vergence_record::table::Row as _;
use vergence_record::{Beside, Description, Recorder, ReplaySource, Topic, WhenFull, rows, steps};

const SIZE: (usize, usize) = (48, 32);
const PAIRS: u64 = 70;

fn record(mut recorder: Recorder, pairs: u64) {
    for index in 0..pairs {
        let pair = pair(index, SIZE);
        let beside = Beside {
            readings: readings(&pair),
            ..Beside::default()
        };
        let step = step(&pair);
        recorder.step(&pair, &step, beside);
        recorder.pump(step.command_s);
    }
    let (status, result) = recorder.finish(1e3);
    result.unwrap();
    assert_eq!(status.counts.pictures_thinned, 0);
    assert_eq!(status.counts.numbers_lost, 0);
}

fn recorded() -> Vec<u8> {
    let disk = Disk::new();
    record(
        Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap(),
        PAIRS,
    );
    disk.bytes()
}

/// Numbers come back as they went in, in order, and the file says that it is whole.
#[test]
fn numbers_come_back() {
    let bytes = recorded();
    let info = Info::read(&bytes[..]).unwrap();
    assert!(info.contents.finished && info.contents.problems.is_empty());
    assert_eq!(info.pairs, PAIRS);
    assert_eq!((info.pairs_missing, info.gaps, info.unreadable), (0, 0, 0));
    assert_eq!(info.contents.facts["seed"], "7");
    assert_eq!(info.contents.text("settings.toml"), Some("a = 1\n"));
    assert!((info.period_s.unwrap() - 1.0 / runs::FPS).abs() < 1e-9);
    let mut recording = Recording::new(&bytes[..]).unwrap();
    let (mut estimates, mut axes) = (0, 0);
    while let Some(message) = recording.next_message().unwrap() {
        match message.topic {
            Some(Topic::Estimate) => {
                let step = step(&pair(estimates, SIZE));
                let row = steps::estimate(estimates, step.estimate.as_ref().unwrap());
                assert_eq!(rows::Estimate::decode(&message.data).unwrap(), row);
                estimates += 1;
            }
            Some(Topic::Axis) => {
                let row = rows::Axis::decode(&message.data).unwrap();
                assert!(
                    row.velocity_rad_s.is_sign_negative(),
                    "the sign of -0 is kept"
                );
                assert_eq!(row, readings(&pair(axes / 4, SIZE))[axes as usize % 4]);
                axes += 1;
            }
            _ => {}
        }
    }
    assert_eq!((estimates, axes), (PAIRS, 4 * PAIRS));
}

/// A thread beside the loop writes the same bytes as the caller.
#[test]
fn the_thread_changes_nothing() {
    let disk = Disk::new();
    record(
        Recorder::beside(
            description(SIZE),
            png(),
            Box::new(disk.clone()),
            WhenFull::Wait,
        )
        .unwrap(),
        PAIRS,
    );
    assert!(disk.bytes() == recorded(), "bytes differ");
}

/// The rows of all pairs.
fn pairs_in(disk: &Disk) -> Vec<rows::Pair> {
    let bytes = disk.bytes();
    let mut recording = Recording::new(&bytes[..]).unwrap();
    let mut pairs = Vec::new();
    while let Some(message) = recording.next_message().unwrap() {
        if message.topic == Some(Topic::Pair) {
            pairs.push(rows::Pair::decode(&message.data).unwrap());
        }
    }
    pairs
}

/// A recorder that is dropped without its end leaves a whole file with everything that it was given, pumped or not.
#[test]
fn dropped_is_ended() {
    let disk = Disk::new();
    let mut recorder = Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap();
    for index in 0..5 {
        let pair = pair(index, SIZE);
        recorder.step(&pair, &step(&pair), Beside::default());
    }
    drop(recorder);
    let info = Info::read(&disk.bytes()[..]).unwrap();
    assert!(info.contents.finished && info.contents.problems.is_empty());
    assert_eq!((pairs_in(&disk).len(), info.pairs), (5, 5));
}

/// A run on the clock of the world: recording times, exposure times and the stamps within the pictures' messages are UTC, our own rows and a replay
/// keep the run's seconds to the last bit.
#[test]
fn times_of_the_world() {
    let epoch_ns = 1_796_000_000_123_456_789;
    let disk = Disk::new();
    let described = Description {
        epoch_ns,
        ..description(SIZE)
    };
    let recorder = Recorder::here(described, png(), Box::new(disk.clone())).unwrap();
    record(recorder, PAIRS);
    let bytes = disk.bytes();
    let info = Info::read(&bytes[..]).unwrap();
    assert!(info.contents.finished && info.contents.problems.is_empty());
    let usual = Info::read(&recorded()[..]).unwrap();
    assert_eq!(
        info.times_ns,
        usual.times_ns.map(|times| times.map(|ns| ns + epoch_ns))
    );
    let plain = recorded();
    let mut here = Recording::new(&bytes[..]).unwrap();
    let mut there = Recording::new(&plain[..]).unwrap();
    let mut pictures = 0;
    while let Some(message) = here.next_message().unwrap() {
        let other = there.next_message().unwrap().unwrap();
        assert_eq!(message.publish_ns, other.publish_ns + epoch_ns);
        if message.cells().is_some() {
            assert_eq!(
                message,
                vergence_record::recording::Message {
                    log_ns: other.log_ns + epoch_ns,
                    publish_ns: other.publish_ns + epoch_ns,
                    ..other
                }
            );
        } else if message.topic == Some(Topic::LeftImage) {
            let stamp = stamp_in(&message.data);
            assert_eq!(stamp, message.publish_ns);
            pictures += 1;
        }
    }
    assert_eq!(pictures, PAIRS);
}

/// What was counted and measured of live cameras comes back, every figure, with the time of the run; a late pair says by how much. The twin's recordings
/// and those of runs that nobody waited for have no such channel, as before there was one.
#[test]
fn counts_of_cameras_come_back() {
    let cameras = |second: u64| rows::Cameras {
        time_s: second as f64,
        left_frames: 30 * second,
        left_late: second,
        right_clock_jumps: 1,
        right_jitter_s: (second > 1).then_some(1.0 / 3.0),
        doubled: u64::MAX,
        offset_s: Some(-0.004),
        ..rows::Cameras::default()
    };
    for (timing, truth) in [(true, false), (true, true), (false, false)] {
        let disk = Disk::new();
        let described = Description {
            timing,
            truth,
            ..description(SIZE)
        };
        let mut recorder = Recorder::here(described, png(), Box::new(disk.clone())).unwrap();
        for second in 1..=3 {
            let pair = pair(30 * second, SIZE);
            let beside = Beside {
                late_s: 0.05 * second as f64,
                ..Beside::default()
            };
            recorder.step(&pair, &step(&pair), beside);
            recorder.cameras(&cameras(second));
        }
        recorder.finish(4.0).1.unwrap();
        let bytes = disk.bytes();
        let info = Info::read(&bytes[..]).unwrap();
        assert!(info.contents.finished && info.unreadable == 0);
        let is_live = timing && !truth;
        let there = info.channels.iter().any(|c| c.topic == "/cameras");
        assert_eq!(there, is_live);
        let mut recording = Recording::new(&bytes[..]).unwrap();
        let (mut counts, mut late_s) = (Vec::new(), Vec::new());
        while let Some(message) = recording.next_message().unwrap() {
            match message.topic {
                Some(Topic::Cameras) => {
                    counts.push(rows::Cameras::decode(&message.data).unwrap());
                }
                Some(Topic::Timing) => {
                    late_s.push(rows::Timing::decode(&message.data).unwrap().late_s);
                }
                _ => {}
            }
        }
        let wanted = if is_live { 3 } else { 0 };
        assert_eq!(counts, (1..=wanted).map(cameras).collect::<Vec<_>>());
        assert_eq!(late_s.len(), if timing { 3 } else { 0 });
        assert!(
            late_s
                .iter()
                .zip(1..)
                .all(|(s, n)| *s == 0.05 * f64::from(n))
        );
    }
}

/// The time stamp of a message of Foxglove's, its field 1, ns.
fn stamp_in(data: &[u8]) -> u64 {
    use vergence_record::proto::{Value, fields};
    let numbers = |bytes: &[u8]| {
        fields(bytes)
            .map(|f| f.unwrap())
            .filter_map(|f| match f.value {
                Value::Varint(v) => Some((f.number, v)),
                _ => None,
            })
            .collect::<Vec<_>>()
    };
    let stamp = fields(data).map(|f| f.unwrap()).find(|f| f.number == 1);
    let Some(Value::Bytes(stamp)) = stamp.map(|f| f.value) else {
        panic!("no stamp");
    };
    let parts = numbers(stamp);
    let of = |number| parts.iter().find(|p| p.0 == number).map_or(0, |p| p.1);
    of(1) * 1_000_000_000 + of(2)
}

/// Pairs that the loop took, and refused, while its clock stood or had gone back: a replay keeps them apart, with the times by which the loop took
/// them, and knows which of them were stepped.
#[test]
fn pairs_of_one_moment() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.mcap");
    let disk = Disk::new();
    let mut recorder = Recorder::here(description(SIZE), png(), Box::new(disk.clone())).unwrap();
    let offset_s = 1.0 / 3.0;
    for index in 0..6 {
        let pair = pair(index, SIZE);
        if index % 3 == 2 {
            let beside = Beside {
                readings: readings(&pair),
                offset_s,
                ..Beside::default()
            };
            recorder.pair(&pair, 0.5, beside, "the left picture is dark");
            continue;
        }
        let mut step = step(&pair);
        step.command_s = 0.5;
        let beside = Beside {
            offset_s,
            ..Beside::default()
        };
        recorder.step(&pair, &step, beside);
    }
    recorder.finish(1.0).1.unwrap();
    std::fs::write(&path, disk.bytes()).unwrap();
    let reasons: Vec<_> = pairs_in(&disk).into_iter().map(|p| p.refused).collect();
    let dark = Some("the left picture is dark".to_owned());
    assert_eq!(reasons, [None, None, dark.clone(), None, None, dark]);
    let info = Info::read(&disk.bytes()[..]).unwrap();
    let axes = info.channels.iter().find(|c| c.topic == "/axis").unwrap();
    assert_eq!((info.pairs, axes.messages), (6, 8));
    let mut source = ReplaySource::open(&path).unwrap();
    for index in 0..6 {
        let found = source.next_pair(None).unwrap().unwrap();
        let wanted = pair(index, SIZE);
        assert!(found.index == index && found.left.picture == wanted.left.picture);
        let late_s = wanted.left.capture_s + offset_s;
        assert_eq!(found.left.capture_s.to_bits(), late_s.to_bits());
        let step = source.recorded().step.as_ref();
        assert_eq!(step.map(|s| s.index), (index % 3 != 2).then_some(index));
    }
    assert!(source.next_pair(None).unwrap().is_none());
}

/// A replay gives every picture, time and reading again.
#[test]
fn a_replay_is_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.mcap");
    std::fs::write(&path, recorded()).unwrap();
    let mut source = ReplaySource::open(&path).unwrap();
    assert!(source.is_lossless());
    assert_eq!(source.info().cameras, [runs::camera(SIZE); 2]);
    let limits = AxisLimits {
        position_min_rad: -1.0,
        position_max_rad: 1.0,
        velocity_max_rad_s: 1.0,
        acceleration_max_rad_s2: 1.0,
        jerk_max_rad_s3: 1.0,
    };
    let drive = source.drive([limits; 4]);
    for index in 0..PAIRS {
        let found = source.next_pair(None).unwrap().unwrap();
        let wanted = pair(index, SIZE);
        assert_eq!(found.index, index);
        for (found, wanted) in [(&found.left, &wanted.left), (&found.right, &wanted.right)] {
            assert!(found.picture == wanted.picture, "picture {index}");
            assert_eq!(found.capture_s.to_bits(), wanted.capture_s.to_bits());
            assert_eq!(found.arrival_s.to_bits(), wanted.arrival_s.to_bits());
        }
        for (axis, row) in AxisName::ALL.into_iter().zip(readings(&wanted)) {
            let reading = drive.reading(axis, wanted.capture_s()).unwrap();
            assert_eq!(reading.position_rad.to_bits(), row.position_rad.to_bits());
        }
    }
    assert!(source.next_pair(None).unwrap().is_none());
    // A question that was not asked in the run is answered between the readings around it.
    let between = drive
        .reading(AxisName::Pan, 0.5 / runs::FPS + 60.0 / runs::FPS)
        .unwrap();
    assert!(
        (between.position_rad - 60.5 / 3.0).abs() < 1e-3,
        "{between:?}"
    );
}
