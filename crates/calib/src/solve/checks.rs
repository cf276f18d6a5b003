//! Sets of pictures that cannot tell what is asked, or tell it badly: refused or flagged, with the remedy.

use super::bundle::Shot;
use super::calibrate::{Calibration, Settings};
use super::mechanism::{AXES, AXIS_NAMES, Told};
use super::plane::LEAST_CORNERS;
use crate::CalibError;

/// Something about a calibration that deserves better pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Weakness {
    /// What is weak, with its figure.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

impl Weakness {
    /// The same, told of a camera that was number 0 when it was alone.
    pub(crate) fn of_camera(&self, camera: usize) -> Self {
        Self {
            what: self
                .what
                .replacen("camera 0", &format!("camera {camera}"), 1),
            remedy: self.remedy.clone(),
        }
    }
}

/// Fewest pictures of a camera.
pub const LEAST_VIEWS: usize = 3;

/// Below so many pictures a calibration is called thin.
const FEW_VIEWS: usize = 10;

/// Boards must differ in attitude by this at least, degrees (Zhang 2000, section 3: parallel planes say nothing new).
const LEAST_TILT_DEG: f64 = 8.0;

/// Below this it is flagged.
const LITTLE_TILT_DEG: f64 = 25.0;

/// Corners must reach this share of the half diagonal; below, the lens near the border is a guess.
const LITTLE_REACH: f64 = 0.75;

/// Focal lengths that are less certain than this share are refused, and flagged.
const WORST_FOCAL_SHARE: f64 = 0.1;
const POOR_FOCAL_SHARE: f64 = 0.005;

/// Enough pictures of enough corners to begin with.
pub(crate) fn enough_views(camera: usize, shots: &[Shot]) -> Result<(), CalibError> {
    let usable = shots
        .iter()
        .filter(|s| s.sightings.len() >= LEAST_CORNERS)
        .count();
    if usable < LEAST_VIEWS {
        return Err(CalibError::Views {
            reason: format!(
                "camera {camera} has {usable} pictures with {LEAST_CORNERS} corners or more; {LEAST_VIEWS} are needed, {FEW_VIEWS} or more \
                 are good"
            ),
            remedy: "add pictures of the board at different angles and distances".to_owned(),
        });
    }
    Ok(())
}

/// What is weak about a calibration.
///
/// # Errors
/// [`CalibError::Views`] where it is not weak but void: boards all parallel, a focal length that is known to a tenth only.
pub(crate) fn weaknesses(
    calibration: &Calibration,
    shots: &[Shot],
    settings: &Settings,
) -> Result<Vec<Weakness>, CalibError> {
    let mut found: Vec<Weakness> = bent(calibration).into_iter().collect();
    if settings.known.is_some() {
        return Ok(found);
    }
    for camera in 0..calibration.cameras.len() {
        let own: Vec<&Shot> = shots.iter().filter(|s| s.camera == camera).collect();
        let tilt = largest_tilt_deg(calibration, &own);
        if tilt < LEAST_TILT_DEG {
            return Err(CalibError::Views {
                reason: format!(
                    "camera {camera} saw the board at nearly one attitude only ({tilt:.1} degrees between the two that differ most), which \
                     leaves the focal length open"
                ),
                remedy: "tilt the board by 30 to 45 degrees to all sides".to_owned(),
            });
        }
        if tilt < LITTLE_TILT_DEG {
            found.push(Weakness {
                what: format!("camera {camera}: the board was tilted by {tilt:.0} degrees at most"),
                remedy: "add pictures with the board tilted by 30 to 45 degrees".to_owned(),
            });
        }
        if own.len() < FEW_VIEWS {
            found.push(Weakness {
                what: format!("camera {camera}: {} pictures", own.len()),
                remedy: format!("take {FEW_VIEWS} or more"),
            });
        }
        let reach = reach(&own, settings.sizes[camera]);
        if reach < LITTLE_REACH {
            found.push(Weakness {
                what: format!(
                    "camera {camera}: corners reach {:.0} % of the way to the picture's corners; beyond them the lens is a guess",
                    100.0 * reach
                ),
                remedy: "add pictures with the board in the picture's corners and along its borders"
                    .to_owned(),
            });
        }
        found.extend(focal_weakness(calibration, camera)?);
    }
    Ok(found)
}

/// A board that is not flat.
fn bent(calibration: &Calibration) -> Option<Weakness> {
    let board = calibration.flatness.filter(|f| f.bent)?;
    Some(Weakness {
        what: format!(
            "the board is bent by about {:.2} mm (± {:.2} mm) from its lowest to its highest corner",
            1e3 * board.bend_m,
            1e3 * board.sigma_m
        ),
        remedy: "glue it to something flat and stiff, such as glass or an aluminium panel"
            .to_owned(),
    })
}

fn focal_weakness(
    calibration: &Calibration,
    camera: usize,
) -> Result<Option<Weakness>, CalibError> {
    let focal = calibration.cameras[camera].intrinsics.fx;
    let Some(sigma) = calibration.sigma(&format!("camera{camera}.fx")) else {
        return Ok(None);
    };
    let share = sigma / focal;
    let remedy = "add pictures with the board tilted, near and far";
    if share > WORST_FOCAL_SHARE {
        return Err(CalibError::Views {
            reason: format!(
                "the focal length of camera {camera} is {focal:.0} px, give or take {sigma:.0} px: the pictures leave it open"
            ),
            remedy: remedy.to_owned(),
        });
    }
    Ok((share > POOR_FOCAL_SHARE).then(|| Weakness {
        what: format!(
            "camera {camera}: the focal length is known to {:.1} % only",
            100.0 * share
        ),
        remedy: remedy.to_owned(),
    }))
}

/// Largest angle between the boards' normals in the camera's frame, degrees.
fn largest_tilt_deg(calibration: &Calibration, shots: &[&Shot]) -> f64 {
    let normals: Vec<_> = shots
        .iter()
        .filter_map(|shot| {
            let board = calibration.placements[shot.placement]?;
            let cam_from_rig = calibration
                .mechanism
                .rig_from_cam(shot.camera, &shot.motors)
                .inverse();
            Some((cam_from_rig * board).rotation * nalgebra::Vector3::z())
        })
        .collect();
    let mut largest: f64 = 0.0;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            largest = largest.max(a.angle(b));
        }
    }
    largest.to_degrees()
}

/// How far the corners reach from the picture's middle, as a share of the half diagonal.
fn reach(shots: &[&Shot], size: (usize, usize)) -> f64 {
    let (w, h) = (size.0 as f64, size.1 as f64);
    let corners = shots.iter().flat_map(|s| &s.sightings);
    corners
        .map(|s| (s.pixel.x - (w - 1.0) / 2.0).hypot(s.pixel.y - (h - 1.0) / 2.0))
        .fold(0.0, f64::max)
        / (w.hypot(h) / 2.0)
}

/// Axes of a head that the pictures say nothing about.
pub(crate) fn axes(shots: &[Shot], told: &Told) -> Vec<Weakness> {
    let moved = |axis: usize| {
        shots
            .iter()
            .any(|s| s.motors.steps[axis] != shots[0].motors.steps[axis])
    };
    (0..AXES)
        .filter(|axis| !told.axis[*axis])
        .map(|axis| Weakness {
            what: match moved(axis) {
                true => format!(
                    "axis {}: it moved, but no place of the board was seen at two of its positions",
                    AXIS_NAMES[axis]
                ),
                false => format!("axis {}: it was never moved", AXIS_NAMES[axis]),
            },
            remedy: format!(
                "leave the board where it stands and take pictures at five or more positions of {}",
                AXIS_NAMES[axis]
            ),
        })
        .chain((0..AXES).filter(|axis| told.axis[*axis] && !told.backlash[*axis]).map(|axis| Weakness {
            what: format!(
                "axis {}: its backlash is not told, because it came to its positions from one side only",
                AXIS_NAMES[axis]
            ),
            remedy: "come to some positions from above and to others from below".to_owned(),
        }))
        .collect()
}
