//! The one place where the planner's y-up world and the cameras' y-down frames meet.

use nalgebra::Point3;

/// A point of the planner's world (y up) in the rig's base frame (y down); both metres, x right, z forward.
///
/// The planner's frame is left-handed (x right, y up, z forward), so this is a mirror and holds for points
/// only. It is its own inverse; [`planner_from_base`] exists so that call sites read in the right direction.
pub fn base_from_planner(point_in_planner: &Point3<f64>) -> Point3<f64> {
    Point3::new(point_in_planner.x, -point_in_planner.y, point_in_planner.z)
}

/// Inverse of [`base_from_planner`].
pub fn planner_from_base(point_in_base: &Point3<f64>) -> Point3<f64> {
    base_from_planner(point_in_base)
}
