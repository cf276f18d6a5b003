//! Find a target, follow it, filter its motion and predict it.
//!
//! [`Follower`] finds a person who moves and follows it in the left picture of a stereo head, whose own motion is taken
//! out; [`filter`] turns what is seen and ranged into position and velocity in space and predicts them.

mod appearance;
mod background;
mod belief;
mod correlation;
pub mod error;
pub mod filter;
pub mod follow;
pub mod infinity;
pub mod keyframe;
mod motion;
mod movers;
mod outline;
mod range;
mod sampling;
mod search;
mod silhouette;
pub mod two_view;
pub mod view;
mod window;

pub use error::TrackError;
pub use follow::{FollowSettings, Follower, Probation, check_box, was_blind};
pub use infinity::{FarSight, InfinityCheck};
pub use keyframe::{Agreement, Keyframe, Panorama, Placed, Turned};
pub use movers::Posture;
pub use two_view::{TwoViewReport, TwoViewSettings, TwoViewSighting, TwoViewTracker, TwoViews};
pub use view::{
    EyeView, FollowState, Observation, PixelBox, Prior, RangeNote, Reason, Report, Sighting,
    SightingKind,
};
