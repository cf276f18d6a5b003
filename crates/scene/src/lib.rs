//! The twin's world: a walking person in a room, rendered exactly, with ground truth.
//!
//! Everything lives in the base frame of `CONVENTIONS.md` (x right, y down, z forward, metres; the rig's head at the
//! origin, [`figure::FLOOR_M`] above the floor).

pub mod board;
pub mod camera;
pub mod error;
pub mod figure;
mod gait;
pub mod hash;
mod kernels;
mod light;
pub mod mark;
pub mod material;
pub mod path;
pub mod reference;
pub mod render;
pub mod room;
mod sensor;
mod shade;
pub mod solid;
pub mod texture;
mod tile;
pub mod truth;
mod view;
pub mod world;

pub use camera::TwinCamera;
pub use error::SceneError;
pub use mark::{Mark, MarkKind};
pub use path::{PathSpec, Waypoint, parse_waypoints, read_waypoints};
pub use render::{Renderer, Shot};
pub use room::Object;
pub use truth::{EyeTruth, FrameTruth};
pub use world::{Light, World, WorldConfig};
