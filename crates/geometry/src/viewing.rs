//! The viewer's side: what two eyes see of a pair of pictures on a screen.
//!
//! Screen frame: X the viewer's right, Y up, Z from the screen **towards the viewer**; eyes at (-e/2, 0, V) and
//! (+e/2, 0, V). Parallax `p = X_r - X_l`: p < 0 crossed, in front; 0 < p < e behind; p = e infinity.

use serde::{Deserialize, Serialize};

use crate::array::Views;
use crate::error::{Result, finite, positive};

/// Limit of |p| / e for `screen` and of |p - e| / e for `infinity`.
pub const STATE_TOLERANCE: f64 = 1e-9;

/// Distances to a state's limit, over e, that are called near: beyond rounding, within a thousand tolerances.
const NEAR_LIMIT: [f64; 2] = [1e-12, 1e-6];

/// The screen: how many times larger than on the sensor the picture is shown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Screen {
    /// Screen magnification M, screen width over sensor width; > 0.
    pub magnification: f64,
}

impl Default for Screen {
    /// The paper's M = 50.
    fn default() -> Self {
        Self {
            magnification: 50.0,
        }
    }
}

/// The viewer, in front of the middle of the screen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewer {
    /// Separation e of the eyes, metres; > 0.
    pub interocular_m: f64,
    /// Viewing distance V, metres; > 0.
    pub distance_m: f64,
}

impl Default for Viewer {
    /// e = 65 mm, V = 0.7 m.
    fn default() -> Self {
        Self {
            interocular_m: 0.065,
            distance_m: 0.7,
        }
    }
}

impl Screen {
    /// Checks the magnification.
    pub fn validate(&self) -> Result<()> {
        positive("magnification", self.magnification, "").map(|_| ())
    }
}

impl Viewer {
    /// Checks both numbers.
    pub fn validate(&self) -> Result<()> {
        positive("interocular", self.interocular_m, "m")?;
        positive("viewing distance", self.distance_m, "m")?;
        Ok(())
    }

    /// Distance D of the point seen on the axis with screen parallax `p_m`: `D = V e / (e - p)`, metres; infinite at
    /// p = e, `None` for p > e (the eyes would have to diverge).
    pub fn seen_distance_m(&self, p_m: f64) -> Option<f64> {
        let rest = self.interocular_m - p_m;
        (rest >= 0.0).then(|| self.distance_m * self.interocular_m / rest)
    }

    /// How far before the screen a point with screen parallax `p_m` is seen, over V: `Z / V = -p / (e - p)`, + in front;
    /// `None` at infinity and beyond (p >= e).
    pub fn seen_fraction(&self, p_m: f64) -> Option<f64> {
        let e = self.interocular_m;
        // A zero without its sign.
        (p_m < e).then(|| -p_m / (e - p_m) + 0.0)
    }

    /// Screen parallax that puts a point at distance `d_m` from the viewer: `p = e (D - V) / D`; inverse of
    /// [`Self::seen_distance_m`]. An infinite distance gives e.
    pub fn parallax_at_m(&self, d_m: f64) -> f64 {
        if d_m == f64::INFINITY {
            self.interocular_m
        } else {
            self.interocular_m * (d_m - self.distance_m) / d_m
        }
    }
}

/// Where a point is seen, or why it is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// In front of the screen: p < 0.
    Front,
    /// On the screen: |p| <= 1e-9 e.
    Screen,
    /// Behind the screen: 0 < p < e.
    Behind,
    /// At infinity: |p - e| <= 1e-9 e.
    Infinity,
    /// Nowhere, the eyes would have to diverge: p > e.
    Divergent,
    /// Not in front of the left camera.
    BehindLeft,
    /// Not in front of the right camera.
    BehindRight,
    /// In front of neither camera.
    BehindBoth,
}

impl State {
    /// As in JSON.
    pub fn name(self) -> &'static str {
        match self {
            State::Front => "front",
            State::Screen => "screen",
            State::Behind => "behind",
            State::Infinity => "infinity",
            State::Divergent => "divergent",
            State::BehindLeft => "behind_left",
            State::BehindRight => "behind_right",
            State::BehindBoth => "behind_both",
        }
    }

    /// Of a screen parallax, metres.
    pub fn from_parallax(p_m: f64, interocular_m: f64) -> Self {
        let tolerance = STATE_TOLERANCE * interocular_m;
        if p_m.abs() <= tolerance {
            State::Screen
        } else if (p_m - interocular_m).abs() <= tolerance {
            State::Infinity
        } else if p_m > interocular_m {
            State::Divergent
        } else if p_m > 0.0 {
            State::Behind
        } else {
            State::Front
        }
    }
}

/// Everything about one point in a pair and before a viewer; metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Where it is seen.
    pub state: State,
    /// Depth along each optical axis, left and right, metres.
    pub depth_m: [f64; 2],
    /// Pan of each camera, left and right, radians, + turns right.
    pub pan_rad: [f64; 2],
    /// Upright position on each sensor, metres; `None` when not in front of that camera.
    pub image_m: [Option<[f64; 2]>; 2],
    /// Whether p lies within 1e-6 e of 0 or e, and not at it to rounding (1e-12 e).
    pub near_a_limit: bool,
    /// `None` when the point is behind a camera.
    pub parallax: Option<Parallax>,
    /// `None` also when it is at infinity or divergent.
    pub seen: Option<Seen>,
}

/// Parallax on the screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parallax {
    /// `p = X_r - X_l`, metres; < 0 in front.
    pub p_m: f64,
    /// `q = Y_r - Y_l`, metres; > 0 when the right eye's point is higher.
    pub q_m: f64,
}

/// What two eyes see of a pair of screen points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Where the eye rays cross in plan (X and Z), and half way between them there (Y), metres.
    pub perceived_m: [f64; 3],
    /// Mid-point of the shortest link of the two rays, metres.
    pub closest_m: [f64; 3],
    /// Right minus left ray height at the crossing in plan, metres.
    pub ray_gap_m: f64,
    /// Plan-view vergence at the crossing minus vergence at the screen point half way between the two image points,
    /// radians, + crossed.
    pub disparity_rad: f64,
    /// Elevation of the right ray minus that of the left, radians.
    pub vertical_disparity_rad: f64,
}

impl Views {
    /// Everything about one point (planner's frame, metres) in the first two cameras.
    pub fn sight(&self, point_m: [f64; 3], screen: &Screen, viewer: &Viewer) -> Result<Sight> {
        self.sight_of_pair(0, point_m, screen, viewer)
    }

    /// The same in the neighbouring cameras `left` and `left + 1`; `left` must be less than the number of cameras
    /// minus one.
    pub fn sight_of_pair(
        &self,
        left: usize,
        point_m: [f64; 3],
        screen: &Screen,
        viewer: &Viewer,
    ) -> Result<Sight> {
        for (name, value) in ["point x", "point y", "point z"].into_iter().zip(point_m) {
            finite(name, value, "m")?;
        }
        screen.validate()?;
        viewer.validate()?;
        let pair = [&self.cameras()[left], &self.cameras()[left + 1]];
        let depth_m = pair.map(|view| view.depth_m(point_m));
        let mut sight = Sight {
            state: State::BehindBoth,
            depth_m,
            pan_rad: pair.map(|view| view.pan_rad()),
            image_m: [self.image_m(left, point_m), self.image_m(left + 1, point_m)],
            near_a_limit: false,
            parallax: None,
            seen: None,
        };
        let (Some(difference), [Some(image_l), Some(image_r)]) =
            (self.difference_m(left, point_m), sight.image_m)
        else {
            sight.state = match sight.image_m {
                [None, None] => State::BehindBoth,
                [None, _] => State::BehindLeft,
                _ => State::BehindRight,
            };
            return Ok(sight);
        };
        let m = screen.magnification;
        let parallax = Parallax {
            p_m: m * difference[0],
            q_m: m * difference[1],
        };
        sight.parallax = Some(parallax);
        let e = viewer.interocular_m;
        sight.state = State::from_parallax(parallax.p_m, e);
        let from_limit = parallax.p_m.abs().min((parallax.p_m - e).abs()) / e;
        sight.near_a_limit = (NEAR_LIMIT[0]..NEAR_LIMIT[1]).contains(&from_limit);
        if matches!(sight.state, State::Front | State::Screen | State::Behind) {
            let middle = [
                m * 0.5 * (image_l[0] + image_r[0]),
                m * 0.5 * (image_l[1] + image_r[1]),
            ];
            sight.seen = Some(viewer.seen(middle, parallax));
        }
        Ok(sight)
    }
}

impl Viewer {
    /// What is seen of two screen points with their mid-point at `middle_m` and p < e. Every difference is formed from
    /// p and q themselves, so small parallax keeps its relative accuracy.
    pub fn seen(&self, middle_m: [f64; 2], parallax: Parallax) -> Seen {
        let (e, v) = (self.interocular_m, self.distance_m);
        let Parallax { p_m: p, q_m: q } = parallax;
        let scale = e / (e - p);
        let perceived_m = [middle_m[0] * scale, middle_m[1] * scale, -v * p / (e - p)];
        Seen {
            perceived_m,
            closest_m: self.closest(middle_m, parallax),
            ray_gap_m: q * scale,
            disparity_rad: self.disparity(middle_m[0], p),
            vertical_disparity_rad: self.vertical_disparity(middle_m, parallax),
        }
    }

    /// The two eye rays u, w from the eyes to their screen points: their link lies along `n = u x w`
    /// `= (V q, V (e - p), u_x q + u_y (e - p))`.
    fn closest(&self, middle_m: [f64; 2], Parallax { p_m: p, q_m: q }: Parallax) -> [f64; 3] {
        let (e, v) = (self.interocular_m, self.distance_m);
        let rest = e - p;
        let u = [middle_m[0] + rest / 2.0, middle_m[1] - q / 2.0, -v];
        let w = [middle_m[0] - rest / 2.0, middle_m[1] + q / 2.0, -v];
        let n = [v * q, v * rest, u[0] * q + u[1] * rest];
        let n2 = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        // Position along a ray: ((right eye - left eye) x other ray) . n / n², with the eyes e apart along X.
        let along = |other: &[f64; 3]| e * (other[1] * n[2] - other[2] * n[1]) / n2;
        let (s, k) = (along(&w), along(&u));
        [
            0.5 * (s * u[0] + k * w[0]),
            0.5 * (s * u[1] + k * w[1]),
            v * (1.0 - 0.5 * (s + k)),
        ]
    }

    fn disparity(&self, middle_x_m: f64, p: f64) -> f64 {
        let (e, v) = (self.interocular_m, self.distance_m);
        let from_l = middle_x_m + e / 2.0;
        let from_r = middle_x_m - e / 2.0;
        // How far each ray is turned from the one to the middle, as one arctangent each.
        let turn_l = (-0.5 * p * v).atan2(v * v + from_l * (from_l - 0.5 * p));
        let turn_r = (0.5 * p * v).atan2(v * v + from_r * (from_r + 0.5 * p));
        turn_l - turn_r
    }

    fn vertical_disparity(&self, middle_m: [f64; 2], parallax: Parallax) -> f64 {
        let (e, v) = (self.interocular_m, self.distance_m);
        let Parallax { p_m: p, q_m: q } = parallax;
        let rest = e - p;
        let (y_l, y_r) = (middle_m[1] - q / 2.0, middle_m[1] + q / 2.0);
        let reach_l = (middle_m[0] + rest / 2.0).hypot(v);
        let reach_r = (middle_m[0] - rest / 2.0).hypot(v);
        // reach_l - reach_r without cancellation.
        let difference = 2.0 * middle_m[0] * rest / (reach_l + reach_r);
        (q * reach_l + y_l * difference).atan2(reach_l * reach_r + y_l * y_r)
    }
}
