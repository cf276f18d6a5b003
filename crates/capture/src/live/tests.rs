//! Proves, with cameras of its own on the real clock, that the live source makes pairs by time, finds a steady offset, never waits longer than it was told, tells
//! and survives cameras that go, and refuses what does not fit. Real devices and streams are tested in `tests/v4l2.rs` and `tests/rtsp.rs`.

use std::time::Duration;

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::{Camera as Lens, Distortion, Eye, Intrinsics};
use vergence_imaging::Rgb;

use super::camera::{Camera, Got, Opener, Taken};
use super::open::{Attached, Opened};
use super::reader::Gives;
use super::stamps::Stamp;
use super::{LiveConfig, LiveInput, LiveKind, LiveRig, LiveSource};
use crate::CaptureError;
use crate::clock::{Clock as _, RealClock};
use crate::source::{CameraState, Next, Source as _, SourceEvent, SourceEventKind, StereoFrame};

const PERIOD_S: f64 = 0.010;
const SIZE: (usize, usize) = (32, 24);

/// What a camera does instead of giving its picture of number k.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Does {
    Picture,
    /// The picture never comes.
    Lose,
    Tear,
    /// The picture of before, again.
    Repeat,
    /// A black picture.
    Dark,
    /// A picture of half the width.
    Narrow,
    Fail,
    Panic,
    /// No picture from here on.
    Silence,
}

#[derive(Clone)]
struct Fake {
    clock: RealClock,
    offset_s: f64,
    size: (usize, usize),
    does: fn(u64) -> Does,
    next: u64,
    lost: u64,
}

impl Opener for Fake {
    fn name(&self) -> String {
        format!("fake {:+.3}", self.offset_s)
    }

    fn open(&mut self) -> Result<Box<dyn Camera>, CaptureError> {
        let mut camera = self.clone();
        // Pictures of the time while it was away are gone.
        camera.next = (self.clock.now_s() / PERIOD_S).ceil() as u64;
        Ok(Box::new(camera))
    }
}

impl Camera for Fake {
    fn fps(&self) -> Option<f64> {
        Some(1.0 / PERIOD_S)
    }

    fn next(&mut self, wait: Duration, _reuse: Option<Rgb>) -> Result<Got, CaptureError> {
        let k = self.next;
        let taken_s = k as f64 * PERIOD_S + self.offset_s;
        let does = (self.does)(k);
        if does == Does::Silence {
            std::thread::sleep(wait);
            return Ok(Got::Nothing);
        }
        self.clock.sleep_until(taken_s);
        self.next += 1;
        match does {
            Does::Fail => {
                return Err(CaptureError::Unequal("a fake that breaks off".to_owned()));
            }
            Does::Panic => panic!("a fake that panics, as it shall"),
            Does::Lose => {
                self.lost += 1;
                return Ok(Got::Nothing);
            }
            Does::Tear => return Ok(Got::Torn { lost: 0 }),
            Does::Picture | Does::Repeat | Does::Dark | Does::Narrow | Does::Silence => {}
        }
        let shown = if does == Does::Repeat { 0 } else { k };
        // The left half shows the number, the right one its low byte turned about.
        let width = self.size.0 / if does == Does::Narrow { 2 } else { 1 };
        let picture = Rgb::from_fn(width, self.size.1, |x, _| {
            if does == Does::Dark {
                return [0; 3];
            }
            let low = shown as u8;
            let low = if x < self.size.0 / 2 { low } else { !low };
            [low, (shown >> 8) as u8, 90]
        });
        Ok(Got::Frame(Taken {
            picture,
            stamp: Stamp::Run(taken_s),
            lost: std::mem::take(&mut self.lost),
            print: shown,
        }))
    }
}

/// The number of the picture.
fn number(picture: &Rgb) -> u64 {
    let [low, high, _] = picture.at(0, 0);
    u64::from(low) | u64::from(high) << 8
}

fn rig((width, height): (usize, usize)) -> RigCalibration {
    let pose = |x_m: f64| CameraPose {
        name: format!("x {x_m}"),
        camera: Lens {
            intrinsics: Intrinsics {
                width,
                height,
                fx: 40.0,
                fy: 40.0,
                cx: 15.5,
                cy: 11.5,
            },
            distortion: Distortion::NONE,
        },
        rig_from_cam: Isometry3::from_parts(
            Translation3::new(x_m, 0.0, 0.0),
            UnitQuaternion::identity(),
        ),
    };
    RigCalibration::from_poses(pose(-0.035), pose(0.035)).unwrap()
}

fn config() -> LiveConfig {
    let input = LiveInput::Two {
        left: "left".into(),
        right: "right".into(),
    };
    LiveConfig {
        silence_s: 0.2,
        start_s: 2.0,
        ..LiveConfig::new(LiveKind::Stream, input)
    }
}

/// Two fakes: the right one that much later, and what each does.
fn start(
    config: &LiveConfig,
    offset_s: f64,
    does: [fn(u64) -> Does; 2],
) -> Result<LiveSource, CaptureError> {
    let clock = RealClock::new();
    let fake = |eye: usize| Fake {
        clock: clock.clone(),
        offset_s: if eye == 1 { offset_s } else { 0.0 },
        size: SIZE,
        does: does[eye],
        next: 0,
        lost: 0,
    };
    let mut devices = Vec::new();
    for eye in Eye::BOTH {
        let mut opener: Box<dyn Opener> = Box::new(fake(eye as usize));
        let camera = opener.open()?;
        devices.push(Attached {
            opener,
            camera,
            gives: Gives::One(eye),
        });
    }
    let opened = Opened {
        devices,
        ..Opened::default()
    };
    LiveSource::start(config, opened, LiveRig::Fixed(&rig(SIZE)), &clock)
}

fn always(_: u64) -> Does {
    Does::Picture
}

/// What comes within a time, and what happened.
fn run(source: &mut LiveSource, seconds: f64) -> (Vec<StereoFrame>, Vec<SourceEvent>) {
    let until_s = source.clock().now_s() + seconds;
    let (mut pairs, mut events) = (Vec::new(), Vec::new());
    while source.clock().now_s() < until_s {
        if let Next::Pair(pair) = source.next_within(0.02, None).unwrap() {
            pairs.push(pair);
        }
        events.extend(source.take_events());
    }
    (pairs, events)
}

fn kinds(events: &[SourceEvent]) -> Vec<SourceEventKind> {
    events.iter().map(|e| e.kind).collect()
}

/// With lost and torn pictures on both sides every pair is of one moment, in order, and what is missing is counted where it was lost.
#[test]
fn pairs_are_of_one_moment() {
    let left = |k: u64| {
        if k % 7 == 3 {
            Does::Lose
        } else {
            Does::Picture
        }
    };
    let right = |k: u64| {
        if k % 11 == 5 {
            Does::Tear
        } else {
            Does::Picture
        }
    };
    let mut source = start(&config(), 0.001, [left, right]).unwrap();
    let (pairs, _) = run(&mut source, 0.6);
    assert!(pairs.len() > 10, "{}", pairs.len());
    for pair in &pairs {
        assert_eq!(number(&pair.left.picture), number(&pair.right.picture));
        assert!((pair.right.capture_s - pair.left.capture_s - 0.001).abs() < 1e-9);
    }
    assert!(pairs.windows(2).all(|w| w[0].index < w[1].index));
    let seen = source.statistics();
    assert!(
        seen.left.counts.lost > 2 && seen.left.counts.torn == 0,
        "{seen:?}"
    );
    assert!(
        seen.right.counts.torn > 2 && seen.right.counts.lost == 0,
        "{seen:?}"
    );
    assert!(source.dropped_pairs() >= seen.pairing.lost_pairs && seen.pairing.lost_pairs > 0);
    assert_eq!(source.info().fps, 1.0 / PERIOD_S);
    let modes = source.agreement().modes;
    assert!(
        modes
            .iter()
            .all(|m| m.size == SIZE && m.fps == Some(1.0 / PERIOD_S))
    );
    assert!((source.pairing_limit_s() - 0.2 * PERIOD_S).abs() < 1e-12);
}

/// A camera whose first picture takes longer than the silence that it may keep later is waited for, and not opened again and again.
#[test]
fn a_slow_start_is_no_silence() {
    let slow = |k: u64| {
        if k < 60 { Does::Lose } else { Does::Picture }
    };
    assert!(60.0 * PERIOD_S > 2.0 * config().silence_s);
    let mut source = start(&config(), 0.0, [always, slow]).unwrap();
    let (pairs, events) = run(&mut source, 0.2);
    assert!(!pairs.is_empty());
    assert!(
        !kinds(&events).contains(&SourceEventKind::Gone),
        "{events:?}"
    );
    // The first few may lie before its opening.
    let lost = source.statistics().right.counts.lost;
    assert!((50..=60).contains(&lost), "{lost}");
}

/// A camera that comes back in another size has gone, is told with both sizes, and is back with the first picture of the old one; none of another size is paired.
#[test]
fn another_size_is_no_picture() {
    let right = |k: u64| match k {
        20..45 => Does::Narrow,
        _ => Does::Picture,
    };
    let mut source = start(&config(), 0.0, [always, right]).unwrap();
    let (pairs, events) = run(&mut source, 1.0);
    assert!(pairs.iter().all(|pair| pair.right.picture.size() == SIZE));
    let gone = events.iter().find(|e| e.kind == SourceEventKind::Gone);
    let text = &gone.unwrap().text;
    assert!(text.contains("gives 16x24 pixels now, not 32x24"), "{text}");
    assert!(
        kinds(&events).contains(&SourceEventKind::Back),
        "{events:?}"
    );
    assert!(pairs.last().unwrap().right.capture_s > 0.5);
}

/// A camera all of whose pictures are damaged has gone after a while, and that is told; a few damaged ones between whole ones are borne.
#[test]
fn damaged_pictures_alone_are_none() {
    let right = |k: u64| match k {
        10..20 => Does::Tear,
        40.. => Does::Tear,
        _ => Does::Picture,
    };
    let quick = LiveConfig {
        start_s: 1.0,
        ..config()
    };
    let mut source = start(&quick, 0.0, [always, right]).unwrap();
    let (pairs, events) = run(&mut source, 3.0);
    assert!(!pairs.is_empty());
    let gone = events.iter().find(|e| e.kind == SourceEventKind::Gone);
    let gone = gone.unwrap();
    assert!(
        gone.text.contains("gave nothing but") && gone.text.contains("damaged pictures for "),
        "{gone:?}"
    );
    // Not of the ten between whole ones.
    assert!(gone.time_s > 0.85, "{gone:?}");
}

/// A camera that gave black pictures, broke off and came back with light ones is not taken for dark any more.
#[test]
fn darkness_ends_with_the_opening() {
    let right = |k: u64| match k {
        ..40 => Does::Dark,
        40..45 => Does::Fail,
        _ => Does::Picture,
    };
    let mut source = start(&config(), 0.0, [always, right]).unwrap();
    let (_, events) = run(&mut source, 1.0);
    let kinds = kinds(&events);
    assert!(kinds.contains(&SourceEventKind::Dark), "{events:?}");
    assert!(kinds.contains(&SourceEventKind::Back), "{events:?}");
    assert!(!source.liveness().unwrap()[1].dark, "{events:?}");
}

/// A steady 3.5 ms of 10 are found and borne; each picture keeps its own time, since both are stamped by one clock. With a limit of 3 ms such pairs
/// are not used, and the wait ends when it shall.
#[test]
fn a_steady_offset_is_found() {
    let mut source = start(&config(), 0.0035, [always, always]).unwrap();
    let (_, mut events) = run(&mut source, 0.5);
    let (pairs, more) = run(&mut source, 0.3);
    events.extend(more);
    assert!(
        kinds(&events).contains(&SourceEventKind::Offset),
        "{events:?}"
    );
    assert!(pairs.len() > 5, "{}", pairs.len());
    for pair in &pairs {
        assert_eq!(number(&pair.left.picture), number(&pair.right.picture));
        assert!((pair.right.capture_s - pair.left.capture_s - 0.0035).abs() < 1e-9);
    }
    let seen = source.statistics();
    assert!((seen.offset_s.unwrap() - 0.0035).abs() < 1e-6 && seen.offset_of_exposure);
    assert!(!seen.offset_ambiguous && seen.skew.p95_s < 1e-6);

    let strict = LiveConfig {
        max_apart_s: Some(0.003),
        ..config()
    };
    let mut source = start(&strict, 0.0035, [always, always]).unwrap();
    let (pairs, _) = run(&mut source, 0.6);
    assert!(pairs.is_empty() && source.statistics().too_far_apart > 5);
}

/// A camera that breaks off, panics or falls silent is told, makes the source stall for a bounded time with the other camera's age known, and is
/// back by itself.
#[test]
fn cameras_go_and_come_back() {
    for does in [Does::Fail, Does::Panic, Does::Silence] {
        let right: fn(u64) -> Does = match does {
            Does::Fail => |k| if k == 60 { Does::Fail } else { Does::Picture },
            Does::Panic => |k| if k == 60 { Does::Panic } else { Does::Picture },
            _ => |k| {
                if k == 60 {
                    Does::Silence
                } else {
                    Does::Picture
                }
            },
        };
        let mut source = start(&config(), 0.0, [always, right]).unwrap();
        let mut events = Vec::new();
        let until_s = source.clock().now_s() + 5.0;
        while !kinds(&events).contains(&SourceEventKind::Back) {
            assert!(source.clock().now_s() < until_s, "{does:?}: {events:?}");
            let asked_s = source.clock().now_s();
            let _ = source.next_within(0.02, None).unwrap();
            assert!(source.clock().now_s() - asked_s < 1.0);
            events.extend(source.take_events());
            assert_ne!(source.liveness().unwrap()[0].state, CameraState::Gone);
        }
        assert_eq!(
            kinds(&events)[0],
            SourceEventKind::Gone,
            "{does:?}: {events:?}"
        );
        assert_eq!(events[0].eye, Some(Eye::Right));
        let (pairs, _) = run(&mut source, 0.2);
        assert!(!pairs.is_empty());
        assert!(
            pairs
                .iter()
                .all(|p| number(&p.left.picture) == number(&p.right.picture))
        );
        let seen = source.statistics();
        assert_eq!((seen.right.counts.gone, seen.right.counts.back), (1, 1));
        assert!(seen.stalls > 0);
    }
}

/// A camera that went and can be opened again, but gives nothing yet, is gone and not merely silent, until its first picture.
#[test]
fn gone_until_a_picture_comes() {
    let right = |k: u64| match k {
        60 => Does::Fail,
        61..120 => Does::Lose,
        _ => Does::Picture,
    };
    let mut source = start(&config(), 0.0, [always, right]).unwrap();
    let until_s = source.clock().now_s() + 5.0;
    let (mut seen, mut looks) = (Vec::new(), 0);
    while !seen.contains(&SourceEventKind::Back) {
        assert!(source.clock().now_s() < until_s, "{seen:?}");
        let _ = source.next_within(0.01, None).unwrap();
        // Looked at before the events: what is not told after it was not so then.
        let state = source.liveness().unwrap()[1].state;
        let went = seen.contains(&SourceEventKind::Gone);
        seen.extend(kinds(&source.take_events()));
        if went && !seen.contains(&SourceEventKind::Back) {
            assert_eq!(state, CameraState::Gone);
            looks += 1;
        }
    }
    // Much longer than the quarter of the time of silence after which a camera that is there counts as silent.
    assert!(looks > 10, "{looks}");
    let (pairs, _) = run(&mut source, 0.1);
    assert!(!pairs.is_empty());
    assert_eq!(source.liveness().unwrap()[1].state, CameraState::Live);
}

/// Cameras that give half of their rate, as in dim light, are followed: told, and paired by the new period.
#[test]
fn another_rate_is_followed() {
    let half = |k: u64| {
        if k.is_multiple_of(2) {
            Does::Picture
        } else {
            Does::Lose
        }
    };
    let mut source = start(&config(), 0.003, [half, half]).unwrap();
    assert_eq!(source.info().fps, 1.0 / PERIOD_S);
    let until_s = source.clock().now_s() + 8.0;
    let mut events = Vec::new();
    while !kinds(&events).contains(&SourceEventKind::Rate) {
        assert!(source.clock().now_s() < until_s, "{events:?}");
        events.extend(run(&mut source, 0.1).1);
    }
    let (pairs, _) = run(&mut source, 0.3);
    assert!(pairs.len() > 3, "{}", pairs.len());
    assert!(source.statistics().skew.max_s <= 0.2 * 2.0 * PERIOD_S + 1e-9);
}

/// A loop that fetches nothing for a while gets the newest pair, and the queues stay bounded.
#[test]
fn the_newest_wins() {
    let mut source = start(&config(), 0.0, [always, always]).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    let Next::Pair(pair) = source.next_within(0.5, None).unwrap() else {
        panic!("no pair");
    };
    let age_s = source.clock().now_s() - pair.capture_s();
    assert!(age_s < 0.15, "{age_s}");
    let seen = source.statistics();
    assert!(
        seen.skipped_pairs > 3 && seen.left.counts.overrun > 3,
        "{seen:?}"
    );
}

/// A frozen camera gives no pairs, is told, and is live again when its picture changes.
#[test]
fn frozen_cameras_give_no_pairs() {
    let left = |k: u64| {
        if (60..120).contains(&k) {
            Does::Repeat
        } else {
            Does::Picture
        }
    };
    let asked = LiveConfig {
        frozen_after: 15,
        ..config()
    };
    let mut source = start(&asked, 0.0, [left, always]).unwrap();
    let (pairs, events) = run(&mut source, 1.6);
    assert_eq!(
        kinds(&events),
        [SourceEventKind::Frozen, SourceEventKind::Thawed]
    );
    let frozen = |p: &&StereoFrame| number(&p.left.picture) == 0 && p.left.capture_s > 0.1;
    assert!(pairs.iter().filter(frozen).count() <= 16);
    assert!(pairs.iter().any(|p| number(&p.left.picture) >= 120));
    assert!(source.statistics().left.counts.frozen >= 40);
}

/// A stream of a still scene, whose pictures are equal bit for bit, is not taken for a frozen camera unless that is asked for: its pairs go on.
#[test]
fn still_streams_are_not_frozen() {
    assert_eq!(config().frozen_after, 0);
    let devices = LiveConfig::new(LiveKind::V4l2, config().input);
    assert!(devices.frozen_after > 0);
    let still = |k: u64| {
        if k >= 40 { Does::Repeat } else { Does::Picture }
    };
    let mut source = start(&config(), 0.0, [still, still]).unwrap();
    let (pairs, events) = run(&mut source, 1.2);
    assert_eq!(kinds(&events), []);
    let repeated = |p: &&StereoFrame| number(&p.left.picture) == 0;
    assert!(pairs.iter().filter(repeated).count() > 30);
    assert_eq!(source.statistics().left.counts.frozen, 0);
}

/// Both halves of one camera are a pair of one time; sizes that do not fit and cameras that give nothing are refused in one sentence.
#[test]
fn halves_and_misfits() {
    let clock = RealClock::new();
    let open = |size: (usize, usize), gives: Vec<Gives>, does: fn(u64) -> Does| {
        let devices = gives.into_iter().map(|gives| {
            let mut opener: Box<dyn Opener> = Box::new(Fake {
                clock: clock.clone(),
                offset_s: 0.0,
                size: if gives == Gives::One(Eye::Right) {
                    (40, 24)
                } else {
                    size
                },
                does,
                next: 0,
                lost: 0,
            });
            let camera = opener.open().unwrap();
            Attached {
                opener,
                camera,
                gives,
            }
        });
        let opened = Opened {
            devices: devices.collect(),
            ..Opened::default()
        };
        let config = LiveConfig {
            start_s: 0.5,
            ..config()
        };
        LiveSource::start(&config, opened, LiveRig::Fixed(&rig(SIZE)), &clock)
    };
    let mut source = open((64, 24), vec![Gives::Both], always).unwrap();
    let (pairs, _) = run(&mut source, 0.2);
    assert!(!pairs.is_empty());
    for pair in &pairs {
        assert_eq!(
            (pair.left.picture.size(), pair.right.picture.size()),
            (SIZE, SIZE)
        );
        assert_eq!(pair.left.capture_s, pair.right.capture_s);
        assert_eq!(
            pair.left.picture.at(3, 3)[0],
            !pair.right.picture.at(3, 3)[0]
        );
    }
    let both = || vec![Gives::One(Eye::Left), Gives::One(Eye::Right)];
    let error = open(SIZE, both(), always).unwrap_err().to_string();
    assert!(
        error.contains("32x24") && error.contains("40x24"),
        "{error}"
    );
    let error = open(SIZE, both(), |_| Does::Silence)
        .unwrap_err()
        .to_string();
    assert!(error.contains("fake +0.000 gave"), "{error}");
    let error = open((66, 24), vec![Gives::Both], always)
        .unwrap_err()
        .to_string();
    assert!(error.contains("33x24"), "{error}");
}
