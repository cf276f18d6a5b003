//! Pixel buffers, sampling, filters, pyramids, colour, picture files.
//!
//! Pixel (0, 0) is the *centre* of the top-left pixel; u runs right, v runs down (`CONVENTIONS.md`).

pub mod avi;
pub mod colour;
pub mod files;
mod jpeg;
pub mod pfm;
pub mod plane;
pub mod ply;
pub mod pyramid;
pub mod remap;
pub mod sample;
pub mod stereo_file;
mod tags;

pub use files::ImageError;
pub use plane::{Gray, Plane, Rgb};
