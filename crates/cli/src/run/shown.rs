//! The pair as a viewer is shown it: as taken where motors converge, turned electronically where the cameras cannot move.
//!
//! The turn is computed once per step. What is reported of the pair (angles, disparity, share of the parallax that is taken away)
//! and every picture of it come from that one turn.

use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use vergence_capture::SourceInfo;
use vergence_control::LossTimes;
use vergence_geometry::{Camera, HeadAngles, Intrinsics};
use vergence_imaging::Rgb;
use vergence_servo::Step;
use vergence_stereo::electronic::{Retake, rotations_converged};
use vergence_track::FollowState;

/// Time in which pictures of fixed cameras turn from rest to a new target, s: no motor is waited for, and a passer-by is soon gone.
const THERE_S: f64 = 0.1;

/// Time in which they turn back to rest when it is gone, s.
const BACK_S: f64 = 0.5;

/// Fixed cameras whose pictures are turned towards the target.
pub(crate) struct Electronic {
    cameras: [Camera; 2],
    base_from_cam: [Isometry3<f64>; 2],
    /// Part of the way from rest (0) to the target (1), even in time.
    part: f64,
    /// The newest target, to which the way leads also while it is gone.
    target_in_base: Option<Point3<f64>>,
    last_s: Option<f64>,
}

/// The electronic turn of one step.
#[derive(Clone, Debug)]
pub(crate) struct Turned {
    retakes: [Retake; 2],
    /// The turned cameras as angles of a head: pan and tilt of the middle between the two axes, each camera's turn from it.
    pub(crate) angles: HeadAngles,
    /// Part of the turn, eased: 1 with both axes on the target, 0 at rest.
    pub(crate) nulled: f64,
}

impl Electronic {
    /// `None` when motors move the cameras.
    pub(crate) fn new(info: &SourceInfo) -> Option<Self> {
        Some(Self {
            cameras: info.cameras,
            base_from_cam: info.fixed_base_from_cam?,
            part: 0.0,
            target_in_base: None,
            last_s: None,
        })
    }

    /// How the pair of a step is turned; once per step, in order. Both axes go to the target, as motors would have turned them, as long as
    /// it was seen a moment ago; without one they go back to rest, where nothing is turned.
    pub(crate) fn turn(&mut self, step: &Step) -> anyhow::Result<Turned> {
        // What was corrected of the calibration is where the cameras stand.
        self.base_from_cam = step.base_from_cam;
        let target = known_target(step);
        self.target_in_base = target.or(self.target_in_base);
        let passed_s = self.last_s.map_or(THERE_S, |last| step.capture_s - last);
        self.last_s = Some(step.capture_s);
        let way = if target.is_some() {
            passed_s / THERE_S
        } else {
            -passed_s / BACK_S
        };
        // A rounding short of the goal is the goal.
        self.part = (self.part + way + 1e-9_f64.copysign(way)).clamp(0.0, 1.0);
        self.turned(self.part * self.part * (3.0 - 2.0 * self.part))
    }

    fn turned(&self, share: f64) -> anyhow::Result<Turned> {
        let rest = self.base_from_cam.map(|pose| pose.rotation);
        let centres = self
            .base_from_cam
            .map(|pose| Point3::from(pose.translation.vector));
        // On the line through both lenses there is no plane to converge in: then nothing is turned.
        let goal = self
            .target_in_base
            .and_then(|target| rotations_converged(&centres, &target).ok());
        let (turns, nulled) = match goal {
            Some(goal) if share >= 1.0 => (goal, 1.0),
            Some(goal) if share > 0.0 => {
                let between = |eye: usize| rest[eye].try_slerp(&goal[eye], share, 1e-9);
                match (between(0), between(1)) {
                    (Some(left), Some(right)) => ([left, right], share),
                    _ => (rest, 0.0),
                }
            }
            _ => (rest, 0.0),
        };
        let retake = |eye: usize| {
            let camera = &self.cameras[eye];
            Retake::new(camera, &rest[eye], &centred(camera), &turns[eye])
        };
        Ok(Turned {
            retakes: [retake(0)?, retake(1)?],
            angles: angles_from_turns(&turns),
            nulled,
        })
    }
}

impl Turned {
    /// Disparity in the turned pair, `u_l - u_r` and `v_l - v_r` in pixels, of what is at these pixels of the pair as
    /// taken; `None` when a turned camera does not see it.
    pub(crate) fn disparity_px(&self, pixels: &[Point2<f64>; 2]) -> Option<[f64; 2]> {
        let seen = |eye: usize| self.retakes[eye].turned_from_fixed(&pixels[eye]);
        let difference = seen(0)? - seen(1)?;
        Some([difference.x, difference.y])
    }

    /// The turned pictures; black where the fixed cameras saw nothing.
    pub(crate) fn pictures(&self, pair: [&Rgb; 2]) -> anyhow::Result<[Rgb; 2]> {
        Ok([
            self.retakes[0].apply(pair[0], [0; 3])?,
            self.retakes[1].apply(pair[1], [0; 3])?,
        ])
    }
}

/// Where the target is, as long as it was seen a moment ago: for as long as motors would follow its prediction.
fn known_target(step: &Step) -> Option<Point3<f64>> {
    let estimate = step.estimate.as_ref()?;
    let known = step.state != FollowState::Searching
        && estimate.unseen_s <= LossTimes::default().coast_s
        && estimate.position_in_base.iter().all(|c| c.is_finite());
    known.then_some(estimate.position_in_base)
}

/// The camera's intrinsics with the optical axis in the middle of the picture: a target on both axes is then in the middle of both.
fn centred(camera: &Camera) -> Intrinsics {
    let mut k = camera.intrinsics;
    let centre = k.centre();
    (k.cx, k.cy) = (centre.x, centre.y);
    k
}

/// Two cameras as a head: pan and tilt are those of the middle between the axes; left and right are the turns of the axes from
/// there, + to the right, about the mean of the cameras' y axes. The lenses stay where they are.
fn angles_from_turns(base_from_cam: &[UnitQuaternion<f64>; 2]) -> HeadAngles {
    let [left, right] = base_from_cam.map(|turn| turn * Vector3::z());
    let middle = left + right;
    let down = base_from_cam[0] * Vector3::y() + base_from_cam[1] * Vector3::y();
    let (Some(middle), Some(down)) = (middle.try_normalize(1e-9), down.try_normalize(1e-9)) else {
        return HeadAngles::default();
    };
    let turn = |axis: &Vector3<f64>| middle.cross(axis).dot(&down).atan2(middle.dot(axis));
    HeadAngles {
        pan: middle.x.atan2(middle.z),
        tilt: (-middle.y).atan2(middle.x.hypot(middle.z)),
        left: turn(&left),
        right: turn(&right),
    }
}

#[cfg(test)]
mod tests {
    //! Proves: the turn that is reported is the turn that is shown; what is at rest is not turned. Does not look at pictures
    //! (stereo::electronic does).
    use super::*;
    use nalgebra::Translation3;
    use vergence_geometry::{BrownConrady, Distortion, Eye, HeadGeometry};

    /// Two cameras 75 mm apart, toed in a little, with principal points that differ.
    fn fixed(target: Option<Point3<f64>>) -> Electronic {
        let camera = |cx: f64| Camera {
            intrinsics: Intrinsics {
                width: 640,
                height: 400,
                fx: 400.0,
                fy: 400.0,
                cx,
                cy: 203.0,
            },
            distortion: Distortion::from(BrownConrady {
                k1: -0.05,
                ..BrownConrady::NONE
            }),
        };
        let pose = |x: f64, toe: f64| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), toe);
            Isometry3::from_parts(Translation3::new(x, 0.0, 0.0), turn)
        };
        Electronic {
            cameras: [camera(310.0), camera(337.0)],
            base_from_cam: [pose(-0.0375, 0.01), pose(0.0375, -0.01)],
            part: 0.0,
            target_in_base: target,
            last_s: None,
        }
    }

    /// A target at 1.3 m has tens of pixels of disparity in the pair as taken, none in the turned one, and the vergence angle
    /// is that of two axes through it; half way there it is between the two.
    #[test]
    fn the_target_has_no_disparity_in_the_turned_pair() {
        let target = Point3::new(0.2, -0.1, 1.3);
        let rig = fixed(Some(target));
        let pixels = [0, 1].map(|eye| {
            let in_cam = rig.base_from_cam[eye].inverse() * target;
            rig.cameras[eye].project(&in_cam).unwrap()
        });
        let whole = rig.turned(1.0).unwrap();
        let none = whole.disparity_px(&pixels).unwrap();
        assert!(none[0].abs() < 1e-6 && none[1].abs() < 1e-6, "{none:?}");
        assert_eq!(whole.nulled, 1.0);
        let centres = [-0.0375, 0.0375].map(|x| Vector3::new(x, 0.0, 0.0));
        let between = (target.coords - centres[0]).angle(&(target.coords - centres[1]));
        assert!((whole.angles.vergence() - between).abs() < 1e-9);

        let rest = rig.turned(0.0).unwrap();
        assert_eq!(rest.nulled, 0.0);
        // 20 mrad of toe-in: no turn leaves it in.
        assert!((rest.angles.vergence() - 0.02).abs() < 1e-9);
        let taken = rest.disparity_px(&pixels).unwrap()[0];
        let half = rig.turned(0.5).unwrap().disparity_px(&pixels).unwrap()[0];
        assert!(taken > 10.0, "{taken}");
        assert!(
            half > 0.3 * taken && half < 0.7 * taken,
            "{half} of {taken}"
        );
    }

    /// Without a target nothing is turned, and a target on the line through the lenses, where two axes cannot meet, is no reason to stop.
    #[test]
    fn no_target_is_rest() {
        for target in [None, Some(Point3::new(2.0, 0.0, 0.0))] {
            let turned = fixed(target).turned(1.0).unwrap();
            assert_eq!(turned.nulled, 0.0, "{target:?}");
        }
    }

    /// Angles read back from turned cameras are those that the head was given, at any pan and tilt.
    #[test]
    fn angles_are_those_of_the_head() {
        let head = HeadGeometry {
            interaxial_m: 0.07,
            pupil_m: 0.0,
        };
        for (pan, tilt) in [(0.0, 0.0), (0.4, -0.2), (-0.7, 0.3)] {
            let given = HeadAngles {
                pan,
                tilt,
                left: 0.03,
                right: -0.03,
            };
            let turns = Eye::BOTH.map(|eye| head.base_from_cam(eye, &given).rotation);
            let read = angles_from_turns(&turns).to_array();
            for (a, b) in read.iter().zip(given.to_array()) {
                assert!((a - b).abs() < 1e-12, "{read:?}");
            }
        }
    }
}
