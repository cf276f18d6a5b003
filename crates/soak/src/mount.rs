//! Where the cameras of the simulated rig truly stand.

use vergence_control::AxisError;
use vergence_geometry::HeadAngles;

/// Motors that turn cameras.
pub trait Mount: Send + Sync {
    /// Where the axes truly stood at a past time, s of the world; at least the last second is kept.
    ///
    /// # Errors
    /// A time that is not kept, or has not come yet.
    fn true_angles(&self, at_s: f64) -> Result<HeadAngles, AxisError>;
}
