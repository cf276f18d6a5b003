//! All that concerns a pair: match, triangulate, electronic vergence, compose for a display.
//!
//! Frames, units and signs are those of `CONVENTIONS.md` at the root of the repository; pixels are full-size pixels.

#![allow(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "`!(x > 0.0)` refuses NaN with everything else that is not positive"
)]

pub mod compose;
pub mod dense;
pub mod depth;
pub mod electronic;
pub mod error;
pub mod faults;
pub mod fuse;
pub mod measure;
pub mod rectify;
pub mod triangulate;

pub use error::StereoError;
