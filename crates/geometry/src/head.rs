//! The motorised stereo head: pan, tilt and one vergence axis per camera.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// One of the two cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Eye {
    /// The camera on the head's left, the viewer's left eye.
    Left,
    /// The camera on the head's right.
    Right,
}

impl Eye {
    /// Left, then right.
    pub const BOTH: [Eye; 2] = [Eye::Left, Eye::Right];

    /// -1 for the left camera, +1 for the right one: the side of the head's x axis on which it stands.
    pub fn side(self) -> f64 {
        match self {
            Eye::Left => -1.0,
            Eye::Right => 1.0,
        }
    }
}

/// Fixed dimensions of the head.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeadGeometry {
    /// Distance of the two vergence pivots, metres; > 0.
    pub interaxial_m: f64,
    /// How far the lens centre lies in front of its pivot on the optical axis, metres; >= 0.
    pub pupil_m: f64,
}

/// The four angles of the head, radians; zero and signs in `CONVENTIONS.md` (+ turns right, + looks up).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeadAngles {
    /// Pan of the whole head, + turns right.
    pub pan: f64,
    /// Tilt of the whole head, + looks up.
    pub tilt: f64,
    /// Turn of the left camera on its pivot, + turns right (towards the other axis).
    pub left: f64,
    /// Turn of the right camera on its pivot, + turns right (away from the other axis).
    pub right: f64,
}

impl HeadAngles {
    /// The vergence angle between the two axes, radians; > 0 when they meet in front.
    pub fn vergence(&self) -> f64 {
        self.left - self.right
    }

    /// The turn of one camera on its pivot.
    pub fn of(&self, eye: Eye) -> f64 {
        match eye {
            Eye::Left => self.left,
            Eye::Right => self.right,
        }
    }

    /// `[pan, tilt, left, right]`, the order of the axes everywhere.
    pub fn to_array(self) -> [f64; 4] {
        [self.pan, self.tilt, self.left, self.right]
    }

    /// Inverse of [`Self::to_array`].
    pub fn from_array(a: [f64; 4]) -> Self {
        Self {
            pan: a[0],
            tilt: a[1],
            left: a[2],
            right: a[3],
        }
    }
}

impl HeadGeometry {
    /// Where the head stands: `base_from_head = Ry(pan) Rx(tilt)`, with the pan and tilt axes meeting at the origin of both.
    pub fn base_from_head(&self, angles: &HeadAngles) -> Isometry3<f64> {
        // y points down, so a positive turn about +y (right-handed) brings z towards +x: to the right.
        let pan = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angles.pan);
        // A positive turn about +x brings z towards -y, which is up.
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angles.tilt);
        Isometry3::from_parts(Translation3::identity(), pan * tilt)
    }

    /// One camera on the head: `head_from_cam = T(pivot) Ry(vergence) T(0, 0, pupil)`.
    pub fn head_from_cam(&self, eye: Eye, angles: &HeadAngles) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angles.of(eye));
        let pivot = Vector3::new(eye.side() * self.interaxial_m / 2.0, 0.0, 0.0);
        let lens = pivot + turn * Vector3::new(0.0, 0.0, self.pupil_m);
        Isometry3::from_parts(Translation3::from(lens), turn)
    }

    /// One camera in the base frame.
    pub fn base_from_cam(&self, eye: Eye, angles: &HeadAngles) -> Isometry3<f64> {
        self.base_from_head(angles) * self.head_from_cam(eye, angles)
    }

    /// A base point in the frame of one camera: what [`crate::Camera::project`] takes.
    pub fn cam_from_base(&self, eye: Eye, angles: &HeadAngles) -> Isometry3<f64> {
        self.base_from_cam(eye, angles).inverse()
    }

    /// The angles that put `target_in_base` on both optical axes: pan and tilt point the head at it, the vergence
    /// axes turn symmetrically (mode `converged`). `None` when the target is nearer than the pivots' circle
    /// (distance <= interaxial / 2) or behind the head.
    ///
    /// Because both lens centres lie on their optical axes, the pupil does not enter.
    pub fn angles_converged_on(&self, target_in_base: &Point3<f64>) -> Option<HeadAngles> {
        let parallel = self.angles_pointed_at(target_in_base)?;
        let distance = target_in_base.coords.norm();
        if distance <= self.interaxial_m / 2.0 {
            return None;
        }
        let beta = (self.interaxial_m / 2.0).atan2(distance);
        Some(HeadAngles {
            left: beta,
            right: -beta,
            ..parallel
        })
    }

    /// Pan and tilt towards the target with parallel axes (modes `parallel`, `shifted`). `None` for a target at the
    /// origin or not in front of the base (z <= 0).
    pub fn angles_pointed_at(&self, target_in_base: &Point3<f64>) -> Option<HeadAngles> {
        let t = target_in_base.coords;
        if t.z <= 0.0 || !t.iter().all(|c| c.is_finite()) {
            return None;
        }
        Some(HeadAngles {
            pan: t.x.atan2(t.z),
            tilt: (-t.y).atan2(t.x.hypot(t.z)),
            left: 0.0,
            right: 0.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: HeadGeometry = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };

    /// A target that the head converges on lies on both optical axes, wherever it is and wherever the pupil is.
    #[test]
    fn converged_target_is_on_both_axes() {
        for target in [
            Point3::new(0.0, 0.0, 1.0),
            Point3::new(1.3, -0.6, 2.0),
            Point3::new(-4.0, 0.9, 9.0),
        ] {
            let angles = RIG.angles_converged_on(&target).unwrap();
            for eye in Eye::BOTH {
                let p = RIG.cam_from_base(eye, &angles) * target;
                assert!(p.x.abs() < 1e-14 && p.y.abs() < 1e-14 && p.z > 0.9, "{p}");
            }
        }
    }

    /// Signs: + pan looks right, + tilt looks up, + vergence turns that camera right.
    #[test]
    fn signs_are_those_of_the_conventions() {
        let right = Point3::new(1.0, 0.0, 5.0);
        let up = Point3::new(0.0, -1.0, 5.0);
        assert!(RIG.angles_pointed_at(&right).unwrap().pan > 0.0);
        assert!(RIG.angles_pointed_at(&up).unwrap().tilt > 0.0);
        let near = RIG
            .angles_converged_on(&Point3::new(0.0, 0.0, 1.0))
            .unwrap();
        assert!(near.left > 0.0 && near.right < 0.0 && near.vergence() > 0.0);
    }

    /// Targets that cannot be converged on are refused rather than answered.
    #[test]
    fn impossible_targets_are_refused() {
        for bad in [
            Point3::new(0.0, 0.0, 0.0),
            Point3::new(0.0, 0.0, -1.0),
            Point3::new(0.0, 0.0, 0.03),
            Point3::new(f64::NAN, 0.0, 1.0),
        ] {
            assert_eq!(RIG.angles_converged_on(&bad), None);
        }
    }
}
