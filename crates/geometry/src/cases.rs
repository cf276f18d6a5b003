//! Files of cases: rigs and points in, every figure out, with the field names of the project's reference file
//! (`tests/data/oracle.json`): metres, `_deg` degrees, `_arcmin` arc minutes.

use serde::{Deserialize, Serialize};

use crate::array::{Mode, ModeKind, StereoArray};
use crate::error::{GeometryError, Result, finite};
use crate::viewing::{Screen, Sight, State, Viewer};

/// One rig, one screen, one viewer, one point. Symbols as in the file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Case {
    /// Name, given back with the result.
    pub id: String,
    /// Camera mode.
    pub mode: ModeKind,
    /// Interaxial, metres.
    pub t: f64,
    /// Focal length, metres.
    pub f: f64,
    /// Screen magnification.
    #[serde(rename = "M")]
    pub m: f64,
    /// Interocular, metres.
    pub e: f64,
    /// Viewing distance, metres.
    #[serde(rename = "V")]
    pub v: f64,
    /// Convergence distance, metres; modes `converged` and `shifted`.
    #[serde(rename = "L", default)]
    pub l: Option<f64>,
    /// Point aimed at, metres; mode `verged`.
    #[serde(default)]
    pub target: Option<[f64; 3]>,
    /// Lens centre in front of the pivot, metres; 0 when absent.
    #[serde(default)]
    pub pupil: Option<f64>,
    /// Point, metres, + right.
    pub x0: f64,
    /// Point, metres, + up.
    pub y0: f64,
    /// Point, metres, + forward.
    pub z0: f64,
}

/// One array of n cameras and one point.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ArrayCase {
    /// Name, given back with the result.
    pub id: String,
    /// Camera mode.
    pub mode: ModeKind,
    /// Number of cameras.
    pub n: usize,
    /// Separation of neighbours, metres.
    pub t: f64,
    /// Focal length, metres.
    pub f: f64,
    /// Screen magnification.
    #[serde(rename = "M")]
    pub m: f64,
    /// Convergence distance, metres; modes `converged` and `shifted`.
    #[serde(rename = "L", default)]
    pub l: Option<f64>,
    /// Point aimed at, metres; mode `verged`.
    #[serde(default)]
    pub target: Option<[f64; 3]>,
    /// Lens centre in front of the pivot, metres; 0 when absent.
    #[serde(default)]
    pub pupil: Option<f64>,
    /// Point, metres, + right.
    pub x0: f64,
    /// Point, metres, + up.
    pub y0: f64,
    /// Point, metres, + forward.
    pub z0: f64,
}

/// All results of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaseReport {
    /// One per case, in the file's order.
    pub cases: Vec<Answer<CaseResult>>,
    /// One per array, in the file's order.
    pub arrays: Vec<Answer<ArrayResult>>,
}

/// A result with the name of its case.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer<T> {
    /// The case's name.
    pub id: String,
    /// What came out.
    pub result: T,
}

/// All figures of one case. What is not defined for its state is absent; the projection in a camera that the point is
/// behind is null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CaseResult {
    /// Where the point is seen.
    pub state: State,
    /// Depth along the left optical axis, metres.
    pub depth_l: f64,
    /// Depth along the right optical axis, metres.
    pub depth_r: f64,
    /// Pan of the left camera, degrees, + turns right.
    pub pan_l_deg: f64,
    /// Pan of the right camera, degrees, + turns right.
    pub pan_r_deg: f64,
    /// Upright position on the left sensor, metres.
    pub left: Option<[f64; 2]>,
    /// Upright position on the right sensor, metres.
    pub right: Option<[f64; 2]>,
    /// Horizontal screen parallax `X_r - X_l`, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p: Option<f64>,
    /// Vertical screen parallax `Y_r - Y_l`, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub q: Option<f64>,
    /// The paper's h = -p, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub h_paper: Option<f64>,
    /// The paper's v = -q, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub v_paper: Option<f64>,
    /// Seen point, screen frame, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub perceived: Option<[f64; 3]>,
    /// The same in the paper's signs (x and y reversed).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub perceived_paper: Option<[f64; 3]>,
    /// Mid-point of the shortest link of the two eye rays, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closest3d: Option<[f64; 3]>,
    /// Right minus left ray height at the crossing in plan, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ray_gap: Option<f64>,
    /// Angular disparity, arc minutes, + crossed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disparity_arcmin: Option<f64>,
    /// Elevation of the right ray minus the left, arc minutes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vdisparity_arcmin: Option<f64>,
    /// True when p lies within 1e-6 e of a state's limit (0 or e) and further than rounding, 1e-12 e: the state may then
    /// differ in another arithmetic. Absent otherwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near: Option<bool>,
}

/// All figures of one array.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArrayResult {
    /// x of the lens centres, metres.
    pub centres_x: Vec<f64>,
    /// Pan of each camera, degrees, + turns right.
    pub pan_deg: Vec<f64>,
    /// Depth along each optical axis, metres.
    pub depth: Vec<f64>,
    /// Upright position on each sensor, metres; null behind a camera.
    pub image: Vec<Option<[f64; 2]>>,
    /// p between neighbours, metres; null where the point is behind one of them.
    pub p_adjacent: Vec<Option<f64>>,
    /// q between neighbours, metres; null where the point is behind one of them.
    pub q_adjacent: Vec<Option<f64>>,
}

/// Radians to arc minutes.
pub fn arcmin_from_rad(angle_rad: f64) -> f64 {
    angle_rad.to_degrees() * 60.0
}

/// Without the sign of a zero, which would only puzzle a reader.
fn plain(value: f64) -> f64 {
    value + 0.0
}

impl From<Sight> for CaseResult {
    fn from(sight: Sight) -> Self {
        let parallax = sight.parallax;
        let seen = sight.seen;
        Self {
            state: sight.state,
            depth_l: sight.depth_m[0],
            depth_r: sight.depth_m[1],
            pan_l_deg: plain(sight.pan_rad[0].to_degrees()),
            pan_r_deg: plain(sight.pan_rad[1].to_degrees()),
            left: sight.image_m[0].map(|xy| xy.map(plain)),
            right: sight.image_m[1].map(|xy| xy.map(plain)),
            p: parallax.map(|x| plain(x.p_m)),
            q: parallax.map(|x| plain(x.q_m)),
            h_paper: parallax.map(|x| plain(-x.p_m)),
            v_paper: parallax.map(|x| plain(-x.q_m)),
            perceived: seen.map(|s| s.perceived_m.map(plain)),
            perceived_paper: seen.map(|s| {
                let [x, y, z] = s.perceived_m;
                [-x, -y, z].map(plain)
            }),
            closest3d: seen.map(|s| s.closest_m.map(plain)),
            ray_gap: seen.map(|s| plain(s.ray_gap_m)),
            near: sight.near_a_limit.then_some(true),
            disparity_arcmin: seen.map(|s| plain(arcmin_from_rad(s.disparity_rad))),
            vdisparity_arcmin: seen.map(|s| plain(arcmin_from_rad(s.vertical_disparity_rad))),
        }
    }
}

impl Case {
    /// All figures of this case.
    pub fn evaluate(&self) -> Result<CaseResult> {
        let array = StereoArray {
            interaxial_m: self.t,
            focal_m: self.f,
            pupil_m: self.pupil.unwrap_or(0.0),
            count: 2,
            mode: mode(self.mode, self.l, self.target)?,
        };
        let screen = Screen {
            magnification: self.m,
        };
        let viewer = Viewer {
            interocular_m: self.e,
            distance_m: self.v,
        };
        let sight = array
            .views()?
            .sight([self.x0, self.y0, self.z0], &screen, &viewer)?;
        Ok(sight.into())
    }
}

impl ArrayCase {
    /// All figures of this array.
    pub fn evaluate(&self) -> Result<ArrayResult> {
        let array = StereoArray {
            interaxial_m: self.t,
            focal_m: self.f,
            pupil_m: self.pupil.unwrap_or(0.0),
            count: self.n,
            mode: mode(self.mode, self.l, self.target)?,
        };
        let screen = Screen {
            magnification: self.m,
        };
        array_result(&array, [self.x0, self.y0, self.z0], &screen)
    }
}

/// Every camera's view of one point (planner's frame, metres), and the parallax between neighbours on a screen.
pub fn array_result(
    array: &StereoArray,
    point_m: [f64; 3],
    screen: &Screen,
) -> Result<ArrayResult> {
    for (name, value) in ["point x", "point y", "point z"].into_iter().zip(point_m) {
        finite(name, value, "m")?;
    }
    screen.validate()?;
    let views = array.views()?;
    let cameras = views.cameras();
    let differences: Vec<_> = (0..cameras.len() - 1)
        .map(|i| views.difference_m(i, point_m))
        .collect();
    let on_screen = |axis: usize| {
        differences
            .iter()
            .map(|d| d.map(|d| plain(screen.magnification * d[axis])))
            .collect()
    };
    Ok(ArrayResult {
        centres_x: cameras.iter().map(|c| c.centre_m()[0]).collect(),
        pan_deg: cameras
            .iter()
            .map(|c| plain(c.pan_rad().to_degrees()))
            .collect(),
        depth: cameras.iter().map(|c| c.depth_m(point_m)).collect(),
        image: (0..cameras.len())
            .map(|i| views.image_m(i, point_m).map(|xy| xy.map(plain)))
            .collect(),
        p_adjacent: on_screen(0),
        q_adjacent: on_screen(1),
    })
}

fn mode(kind: ModeKind, l: Option<f64>, target: Option<[f64; 3]>) -> Result<Mode> {
    let missing = |field| GeometryError::MissingField {
        mode: kind.name(),
        field,
    };
    Ok(match kind {
        ModeKind::Parallel => Mode::Parallel,
        ModeKind::Converged | ModeKind::Shifted => kind.at(l.ok_or_else(|| missing("L"))?),
        ModeKind::Verged => Mode::Verged {
            target_m: target.ok_or_else(|| missing("target"))?,
        },
    })
}
