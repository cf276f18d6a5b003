//! Where the cameras of a rig stand, and how that moves with what is unknown about it.
//!
//! The rig's frame has no freedom left: camera 0 (of a head: camera 0 at zero steps of every axis) has the identity pose.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3, Vector6};

/// Axes of a head in the order that everything has: pan, tilt, left vergence, right vergence.
pub const AXES: usize = 4;

/// Names of the axes in their order.
pub const AXIS_NAMES: [&str; AXES] = ["pan", "tilt", "left", "right"];

/// Where the motors of a head stood: pan, tilt, left vergence, right vergence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotorState {
    /// Steps from home, as the controllers count them.
    pub steps: [f64; AXES],
    /// From which side each axis came to its place: +1 after a move towards more steps, -1 towards fewer, 0 unknown.
    pub approach: [f64; AXES],
}

/// A small motion, left of a pose: `target_from_source` becomes `exp(twist) target_from_source`. First the turn ω (radians), then the
/// shift v (metres): a point moves by `ω × p + v`.
pub(crate) type Twist = Vector6<f64>;

/// A point's motion under twists is `[-[p]×, 1]`; this is the motion of a pose, to first order exact in the turn.
pub(crate) fn moved_by(twist: &Twist, pose: &Isometry3<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(twist.fixed_rows::<3>(0).into_owned());
    let shift = twist.fixed_rows::<3>(3).into_owned();
    Isometry3::from_parts(
        Translation3::from(turn * pose.translation.vector + shift),
        turn * pose.rotation,
    )
}

fn twist(turn: Vector3<f64>, shift: Vector3<f64>) -> Twist {
    Twist::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// The same motion seen from another frame: `Ad(target_from_source) twist`.
pub(crate) fn carried(target_from_source: &Isometry3<f64>, t: &Twist) -> Twist {
    let turn = target_from_source.rotation * t.fixed_rows::<3>(0).into_owned();
    let shift = target_from_source.rotation * t.fixed_rows::<3>(3).into_owned();
    twist(
        turn,
        shift + target_from_source.translation.vector.cross(&turn),
    )
}

/// One turning axis: a line in the frame that carries it, and what a step is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningAxis {
    /// Direction of the axis; a positive step turns right-handed about it.
    pub direction: Unit<Vector3<f64>>,
    /// A point of the axis, metres.
    pub point: Point3<f64>,
    /// Radians per step, > 0.
    pub rad_per_step: f64,
    /// Free play: the axis lags behind its motor by half of it on either side, radians, >= 0.
    pub backlash_rad: f64,
}

/// What can be unknown about an axis: direction (2), point (2), radians per step, backlash.
const AXIS_PARAMETERS: usize = 6;

impl TurningAxis {
    /// Angle at a place of the motor, radians.
    pub fn angle(&self, steps: f64, approach: f64) -> f64 {
        self.rad_per_step * steps - approach * self.backlash_rad / 2.0
    }

    /// Where a turn by `angle` brings what the axis carries.
    pub fn turned(&self, angle: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&self.direction, angle);
        let point = self.point.coords;
        Isometry3::from_parts(Translation3::from(point - turn * point), turn)
    }

    /// Two unit vectors across the axis.
    fn across(&self) -> [Vector3<f64>; 2] {
        let d = self.direction.into_inner();
        let start = match d.x.abs() < 0.6 {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let first = (start - d * d.dot(&start)).normalize();
        [first, d.cross(&first)]
    }

    /// Left twists of [`Self::turned`] by each parameter at this place. With the turn R by θ about the direction a:
    /// a step da ⊥ a gives ω = sin θ da + (1 - cos θ) a × da about the axis' point; a step dp of the point shifts by (1 - R) dp.
    fn twists(&self, steps: f64, approach: f64) -> [Twist; AXIS_PARAMETERS] {
        let angle = self.angle(steps, approach);
        let (a, p) = (self.direction.into_inner(), self.point.coords);
        let turn = UnitQuaternion::from_axis_angle(&self.direction, angle);
        let about_point = |w: Vector3<f64>| twist(w, p.cross(&w));
        let tilted =
            |d: Vector3<f64>| about_point(d * angle.sin() + a.cross(&d) * (1.0 - angle.cos()));
        let shifted = |d: Vector3<f64>| twist(Vector3::zeros(), d - turn * d);
        let [e, f] = self.across();
        let along = about_point(a);
        [
            tilted(e),
            tilted(f),
            shifted(e),
            shifted(f),
            along * steps,
            along * (-approach / 2.0),
        ]
    }

    fn moved(&self, step: &[f64; AXIS_PARAMETERS]) -> Self {
        let [e, f] = self.across();
        Self {
            direction: Unit::new_normalize(self.direction.into_inner() + e * step[0] + f * step[1]),
            point: self.point + e * step[2] + f * step[3],
            rad_per_step: self.rad_per_step + step[4],
            backlash_rad: self.backlash_rad + step[5],
        }
    }
}

/// Where the cameras stand.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "one mechanism exists for a whole calibration"
)]
pub enum Mechanism {
    /// Cameras that do not move against each other: `rig_from_cam`, camera 0 the identity.
    Fixed(Vec<Isometry3<f64>>),
    /// The motorised head of two cameras.
    Head(Head),
}

/// The motorised head: pan carries tilt carries both vergence axes, each of which carries a camera. All at zero steps in the frame of
/// camera 0 there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// Pan, tilt, left vergence, right vergence.
    pub axes: [TurningAxis; AXES],
    /// `rig_from_cam` of the right camera at zero steps; the left one's is the identity.
    pub rig_from_right_at_home: Isometry3<f64>,
}

impl Head {
    /// `rig_from_cam` of camera 0 (left) or 1 (right).
    pub fn rig_from_cam(&self, camera: usize, motors: &MotorState) -> Isometry3<f64> {
        let at = |axis: usize| {
            let turning = &self.axes[axis];
            turning.turned(turning.angle(motors.steps[axis], motors.approach[axis]))
        };
        at(0) * at(1) * at(2 + camera) * self.at_home(camera)
    }

    fn at_home(&self, camera: usize) -> Isometry3<f64> {
        match camera {
            0 => Isometry3::identity(),
            _ => self.rig_from_right_at_home,
        }
    }
}

/// Which parameters of a head the pictures can tell; the others keep their values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Told {
    /// Per axis: its direction, point and radians per step.
    pub axis: [bool; AXES],
    /// Per axis: its backlash.
    pub backlash: [bool; AXES],
}

/// The mechanism with the list of its parameters that are solved for.
#[derive(Clone, Debug)]
pub(crate) struct Unknowns {
    told: Told,
    cameras: usize,
    /// Whether cameras may expose later than stated.
    delays: bool,
}

/// What a parameter of the mechanism is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Parameter {
    /// Left twist `component` of a camera's pose (at home).
    Camera { camera: usize, component: usize },
    /// One of an axis' parameters.
    Axis { axis: usize, component: usize },
    /// How much later than stated a camera exposes, s. It moves no camera; where the board moves it does (see [`super::moving`]).
    Delay { camera: usize },
}

impl Unknowns {
    /// Of cameras that stand still.
    pub(crate) fn fixed(cameras: usize) -> Self {
        Self {
            told: Told::default(),
            cameras,
            delays: false,
        }
    }

    /// With the delay of every camera but the first.
    pub(crate) fn with_delays(self, delays: bool) -> Self {
        Self { delays, ..self }
    }

    /// Place of a camera's delay among the unknowns.
    pub(crate) fn delay(&self, camera: usize) -> Option<usize> {
        let first = self.count() - self.delay_count();
        (self.delays && (1..self.cameras).contains(&camera)).then(|| first + camera - 1)
    }

    fn delay_count(&self) -> usize {
        match self.delays {
            true => self.cameras.saturating_sub(1),
            false => 0,
        }
    }

    /// Of a head.
    pub(crate) fn head(told: Told) -> Self {
        Self {
            told,
            cameras: 2,
            delays: false,
        }
    }

    fn parameters(&self) -> Vec<Parameter> {
        let cameras = (1..self.cameras).flat_map(|camera| {
            (0..6).map(move |component| Parameter::Camera { camera, component })
        });
        let axes = (0..AXES).flat_map(|axis| {
            (0..AXIS_PARAMETERS).filter_map(move |component| {
                let told = match component {
                    5 => self.told.backlash[axis],
                    _ => self.told.axis[axis],
                };
                told.then_some(Parameter::Axis { axis, component })
            })
        });
        let delays = (1..=self.delay_count()).map(|camera| Parameter::Delay { camera });
        cameras.chain(axes).chain(delays).collect()
    }

    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.parameters().len()
    }

    /// What each is called, with its unit.
    pub(crate) fn names(&self) -> Vec<String> {
        self.parameters()
            .into_iter()
            .map(|parameter| match parameter {
                Parameter::Camera { camera, component } => {
                    let what = [
                        "turn_x_rad",
                        "turn_y_rad",
                        "turn_z_rad",
                        "x_m",
                        "y_m",
                        "z_m",
                    ];
                    format!("camera{camera}.{}", what[component])
                }
                Parameter::Axis { axis, component } => {
                    let what = [
                        "direction_1",
                        "direction_2",
                        "point_1_m",
                        "point_2_m",
                        "rad_per_step",
                        "backlash_rad",
                    ];
                    format!("{}.{}", AXIS_NAMES[axis], what[component])
                }
                Parameter::Delay { camera } => format!("camera{camera}.delay_s"),
            })
            .collect()
    }

    /// The left twists of `rig_from_cam` by those parameters that move this camera: (index of the parameter, twist).
    pub(crate) fn twists(
        &self,
        mechanism: &Mechanism,
        camera: usize,
        motors: &MotorState,
    ) -> Vec<(usize, Twist)> {
        let mut out = Vec::new();
        let frames = match mechanism {
            Mechanism::Fixed(_) => None,
            Mechanism::Head(head) => {
                let mut before = [Isometry3::identity(); AXES + 1];
                for (slot, axis) in [0, 1, 2 + camera].into_iter().enumerate() {
                    let turning = &head.axes[axis];
                    let angle = turning.angle(motors.steps[axis], motors.approach[axis]);
                    before[slot + 1] = before[slot] * turning.turned(angle);
                }
                Some((head, before))
            }
        };
        for (index, parameter) in self.parameters().into_iter().enumerate() {
            match parameter {
                Parameter::Camera {
                    camera: moved,
                    component,
                } if moved == camera => {
                    let mut unit = Twist::zeros();
                    unit[component] = 1.0;
                    let carrier = frames.as_ref().map(|(_, before)| before[3]);
                    out.push((index, carried(&carrier.unwrap_or_default(), &unit)));
                }
                Parameter::Axis { axis, component } => {
                    let (Some((head, before)), Some(slot)) = (
                        frames.as_ref(),
                        [0, 1, 2 + camera].iter().position(|a| *a == axis),
                    ) else {
                        continue;
                    };
                    let twists = head.axes[axis].twists(motors.steps[axis], motors.approach[axis]);
                    out.push((index, carried(&before[slot], &twists[component])));
                }
                Parameter::Camera { .. } | Parameter::Delay { .. } => {}
            }
        }
        out
    }

    /// The mechanism with a step added to its parameters.
    pub(crate) fn moved(&self, mechanism: &Mechanism, step: &[f64]) -> Mechanism {
        let mut twists = vec![Twist::zeros(); self.cameras];
        let mut axis_steps = [[0.0; AXIS_PARAMETERS]; AXES];
        for (parameter, &value) in self.parameters().into_iter().zip(step) {
            match parameter {
                Parameter::Camera { camera, component } => twists[camera][component] = value,
                Parameter::Axis { axis, component } => axis_steps[axis][component] = value,
                Parameter::Delay { .. } => {}
            }
        }
        match mechanism {
            Mechanism::Fixed(poses) => Mechanism::Fixed(
                poses
                    .iter()
                    .zip(&twists)
                    .map(|(pose, t)| moved_by(t, pose))
                    .collect(),
            ),
            Mechanism::Head(head) => Mechanism::Head(Head {
                axes: std::array::from_fn(|i| head.axes[i].moved(&axis_steps[i])),
                rig_from_right_at_home: moved_by(&twists[1], &head.rig_from_right_at_home),
            }),
        }
    }
}

impl Mechanism {
    /// `rig_from_cam` of a camera; `motors` matters to a head only.
    pub fn rig_from_cam(&self, camera: usize, motors: &MotorState) -> Isometry3<f64> {
        match self {
            Self::Fixed(poses) => poses[camera],
            Self::Head(head) => head.rig_from_cam(camera, motors),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(direction: [f64; 3], point: [f64; 3], rad_per_step: f64) -> TurningAxis {
        TurningAxis {
            direction: Unit::new_normalize(Vector3::from(direction)),
            point: Point3::from(point),
            rad_per_step,
            backlash_rad: 1e-3,
        }
    }

    fn head() -> Mechanism {
        Mechanism::Head(Head {
            axes: [
                axis([0.02, 1.0, -0.01], [0.035, 0.0, -0.02], 2e-4),
                axis([1.0, 0.01, 0.03], [0.035, 0.01, -0.03], 3e-4),
                axis([0.01, 1.0, 0.02], [0.001, 0.0, -0.015], 1e-4),
                axis([-0.01, 1.0, 0.01], [0.071, 0.0, -0.018], 1.1e-4),
            ],
            rig_from_right_at_home: Isometry3::new(
                Vector3::new(0.07, 0.001, -0.002),
                Vector3::new(0.01, -0.02, 0.005),
            ),
        })
    }

    /// Every twist agrees with the difference of poses, for both cameras, at places away from home and near it.
    #[test]
    fn twists_agree_with_differences() {
        let told = Told {
            axis: [true; AXES],
            backlash: [true; AXES],
        };
        let fixed = Mechanism::Fixed(vec![
            Isometry3::identity(),
            Isometry3::new(Vector3::new(0.1, 0.02, 0.0), Vector3::new(0.1, -0.2, 0.05)),
        ]);
        for (mechanism, unknowns) in [(head(), Unknowns::head(told)), (fixed, Unknowns::fixed(2))] {
            for motors in [
                MotorState {
                    steps: [500.0, -300.0, 800.0, -700.0],
                    approach: [1.0, -1.0, 1.0, -1.0],
                },
                MotorState::default(),
            ] {
                for camera in 0..2 {
                    let twists = unknowns.twists(&mechanism, camera, &motors);
                    let mut seen = vec![Twist::zeros(); unknowns.count()];
                    for (index, t) in twists {
                        seen[index] = t;
                    }
                    for (index, expected) in seen.iter().enumerate() {
                        let h = 1e-6;
                        let at = |sign: f64| {
                            let mut step = vec![0.0; unknowns.count()];
                            step[index] = sign * h;
                            let moved = unknowns.moved(&mechanism, &step);
                            moved.rig_from_cam(camera, &motors)
                        };
                        let (low, high) = (at(-1.0), at(1.0));
                        for p in [Point3::new(0.3, -0.2, 1.5), Point3::new(-0.4, 0.1, 3.0)] {
                            let numeric = (high * p - low * p) / (2.0 * h);
                            let place = (mechanism.rig_from_cam(camera, &motors) * p).coords;
                            let w = expected.fixed_rows::<3>(0).into_owned();
                            let v = expected.fixed_rows::<3>(3).into_owned();
                            let error = (numeric - (w.cross(&place) + v)).norm();
                            let size = 1.0 + numeric.norm();
                            assert!(error < 1e-6 * size, "{}: {error}", unknowns.names()[index]);
                        }
                    }
                }
            }
        }
    }

    /// Points of an axis stay where they are; everything else turns right-handed.
    #[test]
    fn an_axis_keeps_its_points() {
        let a = axis([0.1, 1.0, 0.0], [0.3, 0.0, 0.1], 1e-3);
        let turned = a.turned(0.4);
        let on_axis = a.point + a.direction.into_inner() * 0.7;
        assert!((turned * on_axis - on_axis).norm() < 1e-15);
        let y =
            axis([0.0, 1.0, 0.0], [0.0, 0.0, 0.0], 1e-3).turned(0.1) * Point3::new(0.0, 0.0, 1.0);
        assert!(y.x > 0.09, "z turns towards x about y: {y}");
    }
}
