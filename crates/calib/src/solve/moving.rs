//! Boards that move while cameras look one after the other.
//!
//! Cameras without a common trigger see a hand-held board at different moments, and a stated time tells when a picture arrived rather than when
//! it was exposed. Where times are stated, the board's motion at every place follows from the places before and after it, and how much later
//! than stated a camera exposes (against camera 0) is one more unknown for each camera, as Furgale, Rehder and Siegwart (2013) treat it between
//! a camera and an inertial sensor, here without their splines: pictures of a board come a few times a second, too seldom for more than a
//! velocity.

use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector6};

use super::bundle::{Shot, State};
use super::calibrate::Calibration;
use super::checks::Weakness;
use super::mechanism::{Twist, carried};

/// A velocity is told by neighbours no farther away in time than this, s. A hand changes its motion within half a second or so; pairs held out
/// of three a second leave gaps of two thirds.
const LONGEST_GAP_S: f64 = 1.0;

/// Delays are believed to be 0, give or take this, s: three frames at 30 a second. Where the board stands still nothing else is known of them.
pub(crate) const DELAY_BELIEF_S: f64 = 0.1;

/// How uncertain a velocity is, as a share of itself: what a parabola through three places a third of a second apart leaves of a hand's motion
/// (4 % in the test of a moving board). A delay is as uncertain.
const VELOCITY_SHARE: f64 = 0.05;

/// Fewest places that a camera must share with camera 0, at stated times, for its delay to be an unknown.
const LEAST_MOVING: usize = 3;

/// Delays beyond so many standard deviations, and above this, s, are told.
const TOLD_DELAY: f64 = 3.0;
const LEAST_DELAY_S: f64 = 1e-3;

/// How much later than stated a camera exposes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay {
    /// Seconds, beyond what the stated times tell, against camera 0; negative when it is earlier.
    pub seconds: f64,
    /// Its standard deviation, s: of the corners' errors, and a twentieth of the delay for what is not known of the board's velocity. About 0.1,
    /// which is believed before a picture is seen, where the board hardly moved.
    pub sigma_s: f64,
}

/// When places of the board were seen, how fast it moved there, and how late each camera was.
#[derive(Clone, Debug, Default)]
pub(crate) struct Moving {
    /// Of every camera, s; camera 0 has 0. Empty where times tell no delays.
    pub(crate) delays: Vec<f64>,
    /// Of every place that camera 0 saw at a stated time.
    pub(crate) places: Vec<Option<Way>>,
}

/// How the board moves at a place, in the rig's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way {
    /// When camera 0 saw it there, as stated, s.
    time_s: f64,
    /// The board's origin there, metres, which turns carry along.
    origin: Vector3<f64>,
    /// Angular velocity, rad/s, then velocity of the origin, m/s.
    rates: Vector6<f64>,
}

impl Way {
    fn turn(&self) -> Vector3<f64> {
        self.rates.fixed_rows::<3>(0).into_owned()
    }

    fn shift(&self) -> Vector3<f64> {
        self.rates.fixed_rows::<3>(3).into_owned()
    }

    /// Where the board moves within a time: an even turn about its origin, which moves evenly.
    fn after(&self, later_s: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_scaled_axis(self.turn() * later_s);
        let origin = self.origin + self.shift() * later_s;
        Isometry3::from_parts((origin - turn * self.origin).into(), turn)
    }

    /// How [`Self::after`] changes: its left twist a second.
    fn twist(&self, later_s: f64) -> Twist {
        let origin = self.origin + self.shift() * later_s;
        let shift = self.shift() - self.turn().cross(&origin);
        let mut twist = self.rates;
        twist.fixed_rows_mut::<3>(3).copy_from(&shift);
        twist
    }
}

/// Where the board has moved to when a shot was exposed.
pub(crate) struct Moved {
    /// Left of `rig_from_board`.
    pub(crate) motion: Isometry3<f64>,
    /// How that changes with the camera's delay: a left twist of it a second.
    pub(crate) by_delay: Twist,
}

impl Moving {
    /// Of shots that tell delays at all: several cameras, and times of enough places that two of them saw. Else nothing moves.
    pub(crate) fn of(shots: &[Shot], cameras: usize) -> Self {
        let mut places = vec![None; shots.iter().map(|s| s.placement + 1).max().unwrap_or(0)];
        for shot in shots.iter().filter(|s| s.camera == 0) {
            places[shot.placement] = shot.time_s.map(|time_s| Way {
                time_s,
                origin: Vector3::zeros(),
                rates: Vector6::zeros(),
            });
        }
        let followed = |camera: usize| {
            let both = |s: &&Shot| {
                s.camera == camera && s.time_s.is_some() && places[s.placement].is_some()
            };
            shots.iter().filter(both).count() >= LEAST_MOVING
        };
        match cameras > 1 && (1..cameras).all(followed) {
            true => Self {
                delays: vec![0.0; cameras],
                places,
            },
            false => Self::default(),
        }
    }

    /// Whether delays are unknowns.
    pub(crate) fn is_told(&self) -> bool {
        !self.delays.is_empty()
    }

    /// The places with these numbers, in their order.
    pub(crate) fn taken(&self, numbers: &[usize]) -> Self {
        let place = |number: &usize| self.places.get(*number).copied().flatten();
        Self {
            delays: self.delays.clone(),
            places: numbers.iter().map(place).collect(),
        }
    }

    /// The board's motion at every place from where it was before and after: the derivative of the parabola through three places in
    /// succession, of the origin's path and of the turns, one-sided at the ends and beside gaps. `known` are the places whose poses can be
    /// trusted. Gives the largest change of a velocity, as a share of one metre or radian a second.
    pub(crate) fn follow(&mut self, poses: &[Isometry3<f64>], known: &[usize]) -> f64 {
        let mut line: Vec<(f64, usize)> = known
            .iter()
            .filter_map(|&place| Some((self.places.get(place)?.as_ref()?.time_s, place)))
            .collect();
        line.sort_by(|a, b| a.0.total_cmp(&b.0));
        let spans: Vec<Option<(f64, Vector6<f64>)>> = line
            .windows(2)
            .map(|two| {
                let span_s = two[1].0 - two[0].0;
                let near = span_s > 0.0 && span_s <= LONGEST_GAP_S;
                near.then(|| {
                    (
                        span_s,
                        mean_rates(&poses[two[0].1], &poses[two[1].1], span_s),
                    )
                })
            })
            .collect();
        let span = |i: Option<usize>| i.and_then(|i| spans.get(i).copied().flatten());
        let mut change = 0.0_f64;
        for (i, (_, place)) in line.iter().enumerate() {
            let (before, after) = (span(i.checked_sub(1)), span(Some(i)));
            let rates = match (before, after) {
                (Some((h, a)), Some((k, b))) => (a * k + b * h) / (h + k),
                (None, Some(near)) => at_the_end(near, span(Some(i + 1))),
                (Some(near), None) => at_the_end(near, span(i.checked_sub(2))),
                (None, None) => Vector6::zeros(),
            };
            if let Some(Some(way)) = self.places.get_mut(*place) {
                change = change.max((rates - way.rates).amax());
                way.rates = rates;
                way.origin = poses[*place].translation.vector;
            }
        }
        change
    }

    /// Where the board had moved to when a shot was exposed; `None` where it is taken to stand still.
    pub(crate) fn moved(&self, shot: &Shot) -> Option<Moved> {
        let way = self.places.get(shot.placement)?.as_ref()?;
        let later_s = shot.time_s? - way.time_s + self.delays.get(shot.camera)?;
        Some(Moved {
            motion: way.after(later_s),
            by_delay: way.twist(later_s),
        })
    }
}

/// Velocity at the outer end of a span, by the span beside it.
fn at_the_end((h, near): (f64, Vector6<f64>), far: Option<(f64, Vector6<f64>)>) -> Vector6<f64> {
    far.map_or(near, |(k, far)| near + (near - far) * (h / (h + k)))
}

/// Mean angular velocity between two poses of the board, and mean velocity of its origin.
fn mean_rates(from: &Isometry3<f64>, to: &Isometry3<f64>, span_s: f64) -> Vector6<f64> {
    let w = (to.rotation * from.rotation.inverse()).scaled_axis();
    let shift = to.translation.vector - from.translation.vector;
    Vector6::new(w.x, w.y, w.z, shift.x, shift.y, shift.z) / span_s
}

impl State {
    /// `cam_from_rig` of a shot, for points of the rig where its place of the board has them: a board that has moved on is a camera that has
    /// moved back.
    pub(crate) fn cam_from_rig(&self, shot: &Shot) -> Isometry3<f64> {
        let cam_from_rig = self
            .mechanism
            .rig_from_cam(shot.camera, &shot.motors)
            .inverse();
        match self.moving.moved(shot) {
            Some(moved) => cam_from_rig * moved.motion,
            None => cam_from_rig,
        }
    }
}

impl Moved {
    /// A left twist of `rig_from_cam`, as a twist of the camera against the place of the board.
    pub(crate) fn before(&self, twist: &Twist) -> Twist {
        carried(&self.motion.inverse(), twist)
    }
}

/// Every camera's delay with its standard deviation.
pub(crate) fn delays(calibration: &Calibration) -> Vec<Delay> {
    let delay = |(camera, seconds): (usize, &f64)| Delay {
        seconds: *seconds,
        sigma_s: calibration
            .sigma(&format!("camera{camera}.delay_s"))
            .map_or(0.0, |sigma_s| sigma_s.hypot(VELOCITY_SHARE * seconds)),
    };
    let found = calibration.moving.delays.iter();
    found.enumerate().map(delay).collect()
}

/// Cameras that certainly expose at other times than stated.
pub(crate) fn late(delays: &[Delay]) -> Vec<Weakness> {
    let certain = |(_, d): &(usize, &Delay)| {
        d.seconds.abs() > LEAST_DELAY_S && d.seconds.abs() > TOLD_DELAY * d.sigma_s
    };
    let told = delays.iter().enumerate().filter(certain);
    told.map(|(camera, d)| Weakness {
        what: format!(
            "camera {camera}: it exposes {:.1} ms {} than stated, beside the first (± {:.1} ms); the board's motion between is taken into account",
            1e3 * d.seconds.abs(),
            if d.seconds > 0.0 { "later" } else { "earlier" },
            1e3 * d.sigma_s
        ),
        remedy: "what moves is seen at two places for it: trigger the cameras together".to_owned(),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shot(camera: usize, placement: usize, time_s: f64) -> Shot {
        Shot {
            camera,
            placement,
            motors: super::super::MotorState::default(),
            sightings: Vec::new(),
            time_s: Some(time_s),
        }
    }

    /// A board that turns evenly far from the rig's origin while its own speeds up evenly: velocities at the ends and between are what they are,
    /// with uneven spans, and a moment later it is where they say, to second order.
    #[test]
    fn velocities_follow_a_parabola() {
        let at = |t: f64| {
            let shift = Vector3::new(0.3 * t - 0.2 * t * t, 0.1 * t, 1.0 + 0.05 * t * t);
            Isometry3::new(shift, Vector3::new(0.4, -0.7, 0.9) * t)
        };
        let speed = |t: f64| Vector6::new(0.4, -0.7, 0.9, 0.3 - 0.4 * t, 0.1, 0.1 * t);
        let times = [0.0, 0.3, 0.7, 1.0];
        let poses = times.map(at);
        let shots: Vec<Shot> = (times.iter().enumerate())
            .flat_map(|(i, t)| [shot(0, i, *t), shot(1, i, *t)])
            .collect();
        let mut moving = Moving::of(&shots, 2);
        assert!(moving.is_told());
        moving.follow(&poses, &[0, 1, 2, 3]);
        assert_eq!(moving.follow(&poses, &[0, 1, 2, 3]), 0.0);
        const LATER_S: f64 = 0.02;
        for ((place, pose), t) in moving.places.iter().zip(&poses).zip(times) {
            let way = place.unwrap();
            let error = way.rates - speed(t);
            assert!(error.amax() < 1e-12, "at {t}: {error}");
            let (moved, truth) = (way.after(LATER_S) * pose, at(t + LATER_S));
            let point = nalgebra::Point3::new(0.2, 0.1, 0.0);
            let off = (moved * point - truth * point).norm();
            assert!(off < 0.25 * LATER_S * LATER_S, "at {t}: {off} m");
        }
    }

    /// Nothing is told by one camera, without times, or across a gap.
    #[test]
    fn gaps_tell_no_velocity() {
        let far: Vec<Shot> = (0..4)
            .flat_map(|i| [shot(0, i, 5.0 * i as f64), shot(1, i, 5.0 * i as f64)])
            .collect();
        let mut moving = Moving::of(&far, 2);
        let poses: Vec<_> = (0..4)
            .map(|i| Isometry3::translation(f64::from(i), 0.0, 0.0))
            .collect();
        moving.follow(&poses, &[0, 1, 2, 3]);
        for place in &moving.places {
            assert_eq!(place.unwrap().rates, Vector6::zeros());
        }
        assert!(!Moving::of(&far, 1).is_told());
        let untimed: Vec<Shot> = far
            .iter()
            .map(|s| Shot {
                time_s: None,
                ..s.clone()
            })
            .collect();
        assert!(!Moving::of(&untimed, 2).is_told());
    }

    /// The gradient by every parameter, the delay among them, is that of differences of the cost, with a board that turns and shifts.
    #[test]
    fn gradient_agrees_with_differences() {
        use super::super::bundle::{LensBelief, Problem, Sighting, State};
        use super::super::lens::LensModel;
        use super::super::mechanism::{Mechanism, Unknowns};
        use nalgebra::{DVector, Point2, Point3};
        use vergence_geometry::{Camera, Distortion, Intrinsics};

        let intrinsics = Intrinsics {
            width: 1000,
            height: 800,
            fx: 900.0,
            fy: 900.0,
            cx: 500.0,
            cy: 400.0,
        };
        let camera = Camera {
            intrinsics,
            distortion: Distortion::NONE,
        };
        let corners = [[0.0, 0.0], [0.2, 0.0], [0.0, 0.1], [0.2, 0.1], [0.1, 0.2]];
        let seen = |c: &[f64; 2]| Sighting {
            point_in_board: Point3::new(c[0], c[1], 0.0),
            pixel: Point2::new(480.0 + 700.0 * c[0], 390.0 + 650.0 * c[1]),
            sigma_px: 5.0,
        };
        let shots: Vec<Shot> = (0..4)
            .flat_map(|i| [(0, i, 0.3 * i as f64), (1, i, 0.3 * i as f64 + 0.02)])
            .map(|(camera, place, time_s)| Shot {
                sightings: corners.iter().map(seen).collect(),
                ..shot(camera, place, time_s)
            })
            .collect();
        let placements: Vec<Isometry3<f64>> = (0..4)
            .map(|i| {
                let t = f64::from(i);
                let turn = Vector3::new(0.3 * t, 0.2 - 0.1 * t, 0.1 * t * t);
                Isometry3::new(Vector3::new(0.05 * t, -0.02 * t * t, 1.0 + 0.03 * t), turn)
            })
            .collect();
        let mut moving = Moving::of(&shots, 2);
        moving.follow(&placements, &[0, 1, 2, 3]);
        moving.delays[1] = 0.04;
        let right = Isometry3::new(Vector3::new(0.1, 0.01, 0.0), Vector3::new(0.02, -0.1, 0.03));
        let state = State {
            cameras: vec![camera; 2],
            mechanism: Mechanism::Fixed(vec![Isometry3::identity(), right]),
            placements,
            moving,
        };
        let problem = Problem {
            models: vec![LensModel::BrownConrady5; 2],
            unknowns: Unknowns::fixed(2).with_delays(true),
            shots: &shots,
            huber: f64::INFINITY,
            lenses_told: false,
            belief: LensBelief::OPEN,
        };
        let normal = problem.normal(&state).unwrap();
        assert_eq!(problem.names().last().unwrap(), "camera1.delay_s");
        let (count, h) = (problem.parameter_count(), 1e-6);
        let still = vec![Vector6::zeros(); 4];
        for i in 0..count + 24 {
            let at = |sign: f64| {
                let mut shared = DVector::zeros(count);
                let mut places = still.clone();
                match i.checked_sub(count) {
                    None => shared[i] = sign * h,
                    Some(j) => places[j / 6][j % 6] = sign * h,
                }
                let next = problem.moved(&state, &shared, &places);
                problem.normal(&next).unwrap().cost
            };
            let numeric = (at(1.0) - at(-1.0)) / (2.0 * h);
            let own = match i.checked_sub(count) {
                None => normal.g[i],
                Some(j) => normal.places[j / 6].g[j % 6],
            };
            let error = (own - numeric).abs();
            assert!(
                error < 1e-5 * (1.0 + numeric.abs()),
                "{i}: {own}, {numeric}"
            );
        }
    }
}
