//! Is the rig still what its calibration says? A look at one pair a second, on a thread of its own beside the loop, without a target.
//!
//! A pair that is due is copied with the poses that the calibration gives for it; a thread rectifies it, matches points and gives them to the
//! [`HealthMonitor`]. The answer is taken at the first pair half a period later *by the run's clock*, and waited for if need be, so that what the
//! loop does depends on no thread and no machine. With a period of a second there is nothing to wait for.

use std::thread::JoinHandle;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use vergence_calib::health::{Health, HealthMonitor, Match};
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::{Camera, Eye};
use vergence_imaging::Gray;
use vergence_imaging::remap::Kernel;
use vergence_stereo::faults::matching::matched;
use vergence_stereo::rectify::{Choices, Rectification};

/// How the rig is watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchSettings {
    /// Time between two looks, s of the run's clock; 0: never look.
    pub every_s: f64,
    /// Whether pitch, vergence and roll of the right camera are corrected as far as they are certain.
    pub correct: bool,
}

impl Default for WatchSettings {
    /// Never: for those who only step the loop.
    fn default() -> Self {
        Self {
            every_s: 0.0,
            correct: false,
        }
    }
}

/// Share of what is known that is kept from look to look: some five looks count.
const KEEP: f64 = 0.8;

/// Time in which the loop goes over to a new correction, s: the filter takes a jump of the vergence for one of the target.
const EASE_S: f64 = 0.5;

/// What one look said.
#[derive(Clone, Debug)]
pub struct HealthNote {
    /// When the pair was taken, s.
    pub time_s: f64,
    /// The rig's health by this and the last few looks; `None` for a pair that said nothing and until enough points were matched.
    pub health: Option<Health>,
    /// Why this pair said nothing, when it did not.
    pub skipped: Option<String>,
    /// Turn of the right camera that the loop takes into account, to which it goes over within half a second, rad: pitch, vergence, roll with
    /// the signs of [`vergence_calib::health::DriftKind`].
    pub corrected_rad: [f64; 3],
}

/// The watcher with what it knows.
pub(crate) struct Watch {
    settings: WatchSettings,
    cameras: [Camera; 2],
    monitor: Option<HealthMonitor>,
    at_work: Option<Work>,
    due_s: f64,
    spare: Option<[Gray; 2]>,
    /// What is corrected, before and from `since_s` on.
    corrections: [Correction; 2],
    since_s: f64,
}

/// A turn of the right camera that the calibration does not know, rad.
#[derive(Clone, Copy, Default)]
struct Correction {
    /// Pitch, vergence, roll in the rectified frame.
    told: Vector3<f64>,
    /// The same turn in the camera's own frame: `calibrated_from_true`.
    in_cam: Vector3<f64>,
}

struct Work {
    time_s: f64,
    thread: JoinHandle<Looked>,
}

/// What the thread hands back.
struct Looked {
    monitor: HealthMonitor,
    pictures: [Gray; 2],
    health: Option<Health>,
    /// The right camera's calibrated attitude in the rectified frame in which the health is told.
    rect_from_right: UnitQuaternion<f64>,
    skipped: Option<String>,
}

impl Watch {
    pub(crate) fn new(cameras: [Camera; 2], settings: WatchSettings) -> Self {
        Self {
            settings,
            cameras,
            monitor: Some(HealthMonitor::new(KEEP)),
            at_work: None,
            due_s: f64::NEG_INFINITY,
            spare: None,
            corrections: [Correction::default(); 2],
            since_s: 0.0,
        }
    }

    /// What is known of the right camera counts no more: its axis is homed. A look that is under way is finished, and says nothing.
    pub(crate) fn begin_anew(&mut self) {
        if let Some(work) = self.at_work.take()
            && let Ok(looked) = work.thread.join()
        {
            self.spare = Some(looked.pictures);
        }
        self.monitor = Some(HealthMonitor::new(KEEP));
        self.corrections = [Correction::default(); 2];
    }

    /// What is corrected at `time_s`.
    fn correction(&self, time_s: f64) -> Correction {
        let [before, after] = &self.corrections;
        let share = ((time_s - self.since_s) / EASE_S).clamp(0.0, 1.0);
        Correction {
            told: before.told.lerp(&after.told, share),
            in_cam: before.in_cam.lerp(&after.in_cam, share),
        }
    }

    /// The poses with what is known of the right camera's drift at `time_s` taken into account.
    pub(crate) fn corrected(
        &self,
        time_s: f64,
        calibrated: &[Isometry3<f64>; 2],
    ) -> [Isometry3<f64>; 2] {
        let [left, right] = *calibrated;
        let in_cam = self.correction(time_s).in_cam;
        if in_cam == Vector3::zeros() {
            return [left, right];
        }
        [left, right * UnitQuaternion::from_scaled_axis(in_cam)]
    }

    /// How much further right (+) the right camera looks at `time_s` than its axis says, rad.
    pub(crate) fn right_offset_rad(&self, time_s: f64) -> f64 {
        self.correction(time_s).told.y
    }

    /// Whether a look was begun whose answer is due at `time_s`.
    pub(crate) fn is_answer_due(&self, time_s: f64) -> bool {
        let half_s = self.settings.every_s / 2.0;
        self.at_work
            .as_ref()
            .is_some_and(|work| time_s >= work.time_s + half_s)
    }

    /// Whether a pair taken at `time_s` shall be looked at.
    pub(crate) fn is_look_due(&self, time_s: f64) -> bool {
        self.settings.every_s > 0.0 && self.at_work.is_none() && time_s >= self.due_s
    }

    /// Begin to look at a pair: its grey pictures, and the poses that the calibration gives for it, any common frame.
    pub(crate) fn look(&mut self, time_s: f64, pictures: [&Gray; 2], poses: &[Isometry3<f64>; 2]) {
        let Some(monitor) = self.monitor.take() else {
            return;
        };
        self.due_s = time_s + self.settings.every_s;
        let copies = match self.spare.take() {
            Some(mut spare) => {
                for (to, from) in spare.iter_mut().zip(pictures) {
                    to.samples_mut().copy_from_slice(from.samples());
                }
                spare
            }
            None => pictures.map(Gray::clone),
        };
        let (cameras, poses) = (self.cameras, *poses);
        let work = move || looked(monitor, copies, &cameras, &poses);
        // Where the system has no thread to give, this look is left out and the next one begins anew.
        match std::thread::Builder::new()
            .name("health".to_owned())
            .spawn(work)
        {
            Ok(thread) => self.at_work = Some(Work { time_s, thread }),
            Err(_) => self.monitor = Some(HealthMonitor::new(KEEP)),
        }
    }

    /// The answer of the look at work, waited for, taken at `now_s` of the run's clock; `None` when there is none. After the last step (`None`
    /// for the time) nothing is corrected any more.
    pub(crate) fn answer(&mut self, now_s: Option<f64>) -> Option<HealthNote> {
        let Work { time_s, thread } = self.at_work.take()?;
        let Ok(looked) = thread.join() else {
            // Only a bug panics there; the loop does not depend on it.
            self.monitor = Some(HealthMonitor::new(KEEP));
            return Some(HealthNote {
                time_s,
                health: None,
                skipped: Some("looking at the pair failed".to_owned()),
                corrected_rad: self.corrections[1].told.into(),
            });
        };
        self.monitor = Some(looked.monitor);
        self.spare = Some(looked.pictures);
        if self.settings.correct
            && let Some(now_s) = now_s
            && let Some(health) = &looked.health
        {
            let told = health.certain_turn();
            let in_cam = looked.rect_from_right.inverse() * told;
            self.corrections = [self.correction(now_s), Correction { told, in_cam }];
            self.since_s = now_s;
        }
        Some(HealthNote {
            time_s,
            health: looked.health,
            skipped: looked.skipped,
            corrected_rad: self.corrections[1].told.into(),
        })
    }
}

fn looked(
    mut monitor: HealthMonitor,
    pictures: [Gray; 2],
    cameras: &[Camera; 2],
    poses: &[Isometry3<f64>; 2],
) -> Looked {
    let rig = rig_from_poses(cameras, poses);
    let found = rig.and_then(|rig| {
        let plan = Rectification::new(&rig.cameras, &rig.base_from_cam, &Choices::default())
            .map_err(|e| e.to_string())?;
        Ok((matches_of(&plan, &pictures)?, rig))
    });
    let mut rect_from_right = UnitQuaternion::identity();
    let (health, skipped) = match found {
        Ok((matches, rig)) => {
            monitor.update(&rig, &matches);
            rect_from_right = rig.base_from_cam[1].rotation;
            (monitor.health(&rig), None)
        }
        Err(reason) => (None, Some(reason)),
    };
    Looked {
        monitor,
        pictures,
        health,
        rect_from_right,
        skipped,
    }
}

fn rig_from_poses(
    cameras: &[Camera; 2],
    poses: &[Isometry3<f64>; 2],
) -> Result<RigCalibration, String> {
    let pose = |eye: usize, name: &str| CameraPose {
        name: name.to_owned(),
        camera: cameras[eye],
        rig_from_cam: poses[eye],
    };
    RigCalibration::from_poses(pose(0, "left"), pose(1, "right")).map_err(|e| e.to_string())
}

/// Matched points of a pair as pixels of its own pictures. They are looked for in the pictures rectified by `plan`, where eyes that stand askew
/// look alike.
///
/// # Errors
/// A sentence: why the pair cannot be rectified or matched.
pub fn matches_of(plan: &Rectification, pictures: &[Gray; 2]) -> Result<Vec<Match>, String> {
    let rectified = |eye: Eye| {
        plan.rectified(eye, &pictures[eye as usize], Kernel::Bicubic, 0)
            .map_err(|e| e.to_string())
    };
    let (left, right) = (rectified(Eye::Left)?, rectified(Eye::Right)?);
    let found = matched(&left, &right).map_err(|refusal| refusal.to_string())?;
    let matches = found.points.iter().filter_map(|point| {
        Some(Match {
            left: plan.source_from_rectified(Eye::Left, &point.left_px)?,
            right: plan.source_from_rectified(Eye::Right, &point.right_px)?,
            sigma_px: point.sigma_px,
        })
    });
    Ok(matches.collect())
}
