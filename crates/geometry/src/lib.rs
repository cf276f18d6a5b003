//! Geometry of stereo camera arrays and of their viewers: pure mathematics, no pixels, no I/O.
//!
//! Frames, units and signs are those of `CONVENTIONS.md` at the root of the repository.
//!
//! * [`camera`], [`head`], [`frames`]: one camera, the motorised head, the one turn between y up and y down.
//! * [`mod@array`], [`viewing`]: a row of cameras in the planner's frame, and what two eyes see of its pictures.
//! * [`cases`]: files of cases with the field names of the reference file.
//! * [`paper`]: the equations of the paper that the project starts from, in its own signs.
//! * [`comfort`]: rules for what a viewer can fuse and likes to look at.
//! * [`planning`]: thresholds, base and convergence, depth resolution, coverage, advice.
//! * [`bulk`]: parallax of many points at once.

pub mod array;
pub mod bulk;
pub mod camera;
pub mod cases;
pub mod comfort;
pub mod error;
pub mod frames;
pub mod head;
pub mod paper;
pub mod planning;
pub mod viewing;

pub use array::{Mode, ModeKind, Sensor, StereoArray, View, Views};
pub use camera::{BrownConrady, Camera, Distortion, Intrinsics, KannalaBrandt};
pub use error::{GeometryError, Result};
pub use head::{Eye, HeadAngles, HeadGeometry};
pub use viewing::{Parallax, Screen, Seen, Sight, State, Viewer};
