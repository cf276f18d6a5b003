//! Small runs to record: pairs and steps made up from a number, and a disk in memory that can misbehave.
#![allow(dead_code, reason = "each test takes what it needs")]
// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

use std::io;
use std::sync::{Arc, Mutex};

use nalgebra::{Isometry3, Matrix6, Point2, Point3, Translation3, Vector3};
use vergence_capture::{Frame, StereoFrame};
use vergence_geometry::{Camera, Distortion, HeadAngles, Intrinsics};
use vergence_imaging::Rgb;
use vergence_record::{Description, Pictures, RecordSettings, Storage, rows};
use vergence_servo::{Measured, StageTimes, Step};
use vergence_track::filter::TargetEstimate;
use vergence_track::{FollowState, PixelBox, Reason, Sighting, SightingKind};

/// Pictures a second of these runs.
pub(crate) const FPS: f64 = 30.0;

pub(crate) fn camera(size: (usize, usize)) -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, size.0, size.1),
        distortion: Distortion::NONE,
    }
}

pub(crate) fn description(size: (usize, usize)) -> Description {
    Description {
        facts: vec![("seed".to_owned(), "7".to_owned())],
        attachments: vec![(
            "settings.toml".to_owned(),
            "application/toml",
            b"a = 1\n".to_vec(),
        )],
        cameras: [camera(size); 2],
        fixed_base_from_cam: None,
        fps: FPS,
        timing: false,
        truth: false,
        epoch_ns: 0,
    }
}

pub(crate) fn png() -> RecordSettings {
    RecordSettings {
        pictures: Pictures::Png,
        ..RecordSettings::default()
    }
}

/// Pair `index`: a pattern that no other pair has.
pub(crate) fn pair(index: u64, size: (usize, usize)) -> StereoFrame {
    let frame = |eye: u64| Frame {
        picture: Rgb::from_fn(size.0, size.1, |x, y| {
            let n = (x as u64 * 31 + y as u64 * 17 + index * 101 + eye * 53) as u8;
            [n, n.wrapping_mul(3), n ^ 0x5a]
        }),
        capture_s: index as f64 / FPS + eye as f64 * 1e-4,
        arrival_s: index as f64 / FPS + 0.02,
    };
    StereoFrame {
        index,
        left: frame(0),
        right: frame(1),
    }
}

/// A step with something in every channel.
pub(crate) fn step(pair: &StereoFrame) -> Step {
    let n = pair.index as f64;
    let estimate = TargetEstimate {
        time_s: pair.capture_s(),
        position_in_base: Point3::new(0.1 * n, -0.01 * n, 3.0 + n / 7.0),
        velocity_in_base: Vector3::new(0.3, 0.0, -1.0 / 3.0),
        acceleration_in_base: Vector3::zeros(),
        covariance: Matrix6::identity() * 1e-3,
        model_probabilities: [1.0 / 3.0; 3],
        unseen_s: 0.0,
        clamped: false,
    };
    let sighting = Sighting {
        anchor_px: Point2::new(10.5 + n, 11.25),
        anchor_sigma_px: 0.5,
        body: PixelBox {
            x: 1.0,
            y: 2.0,
            w: 3.0,
            h: 4.0,
        },
        torso: PixelBox {
            x: 1.0,
            y: 2.0,
            w: 3.0,
            h: 4.0,
        },
        distance_m: Some(3.0),
        px_per_m: 100.0,
        confidence: 0.9,
        kind: SightingKind::Followed,
    };
    Step {
        index: pair.index,
        capture_s: pair.capture_s(),
        arrival_s: pair.arrival_s(),
        command_s: pair.arrival_s() + 0.01,
        angles: HeadAngles::default(),
        base_from_cam: [-0.035, 0.035]
            .map(|x| Isometry3::from_parts(Translation3::new(x, 0.0, 0.0), Default::default())),
        state: FollowState::Tracking,
        reason: Reason::Seen,
        sighting: Some(sighting),
        expected: None,
        measured: Some(Measured {
            left_px: Point2::new(10.0, 11.0),
            right_px: Point2::new(9.0, 11.0),
            disparity_px: 1.0 + n / 9.0,
            sigma_px: 0.1,
            point_in_base: Point3::new(0.0, 0.0, 3.0),
            patches: [5, 6],
        }),
        update: None,
        estimate: Some(estimate),
        aim: Some(estimate),
        control: None,
        mode_change: None,
        health: None,
        lost_zero: None,
        refused: None,
        homings: 0,
        times: StageTimes::default(),
    }
}

/// A reading of every axis.
pub(crate) fn readings(pair: &StereoFrame) -> Vec<rows::Axis> {
    (0..4)
        .map(|axis| rows::Axis {
            index: pair.index,
            axis,
            asked_s: pair.capture_s(),
            time_s: pair.capture_s(),
            position_rad: 0.1 * axis as f64 + pair.index as f64 / 3.0,
            velocity_rad_s: -0.0,
        })
        .collect()
}

/// What a disk does with the next bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mood {
    /// Takes everything.
    Good,
    /// Takes at most so many bytes at a time.
    Short(usize),
    /// Takes nothing now.
    Busy,
    /// Fails.
    Full,
}

/// A disk in memory.
#[derive(Clone)]
pub(crate) struct Disk {
    pub(crate) inner: Arc<Mutex<Inner>>,
}

pub(crate) struct Inner {
    pub(crate) bytes: Vec<u8>,
    pub(crate) mood: Mood,
}

impl Disk {
    pub(crate) fn new() -> Self {
        Self {
            inner: Arc::new(Mutex::new(Inner {
                bytes: Vec::new(),
                mood: Mood::Good,
            })),
        }
    }

    pub(crate) fn set(&self, mood: Mood) {
        self.inner.lock().unwrap().mood = mood;
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.inner.lock().unwrap().bytes.clone()
    }
}

impl Storage for Disk {
    fn append(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut disk = self.inner.lock().unwrap();
        let count = match disk.mood {
            Mood::Good => bytes.len(),
            Mood::Short(most) => bytes.len().min(most),
            Mood::Busy => return Err(io::ErrorKind::WouldBlock.into()),
            Mood::Full => return Err(io::ErrorKind::StorageFull.into()),
        };
        disk.bytes.extend(&bytes[..count]);
        Ok(count)
    }

    fn sync(&mut self) -> io::Result<()> {
        match self.inner.lock().unwrap().mood {
            Mood::Full => Err(io::ErrorKind::StorageFull.into()),
            _ => Ok(()),
        }
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.inner.lock().unwrap().bytes.truncate(length as usize);
        Ok(())
    }
}
