//! Geometry of stereo camera arrays and of their viewers: pure mathematics, no pixels, no I/O.
//!
//! Frames, units and signs are those of `CONVENTIONS.md` at the root of the repository.

pub mod camera;
pub mod frames;
pub mod head;

pub use camera::{Camera, Distortion, Intrinsics};
pub use head::{Eye, HeadAngles, HeadGeometry};
