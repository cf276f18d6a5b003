//! What can go wrong in the loop.

/// What can go wrong in the loop.
#[derive(Debug, thiserror::Error)]
pub enum ServoError {
    /// The pictures are not those of the cameras.
    #[error(
        "pair {index}: the {eye} picture is {got_w} x {got_h} pixels, its camera has {want_w} x {want_h}"
    )]
    PictureSize {
        /// Which pair.
        index: u64,
        /// Which eye.
        eye: &'static str,
        /// Width found.
        got_w: usize,
        /// Height found.
        got_h: usize,
        /// Width of the camera.
        want_w: usize,
        /// Height of the camera.
        want_h: usize,
    },
    /// The cameras' pictures are too small to follow anybody in them.
    #[error(
        "the {eye} camera's pictures are {width} x {height} pixels; at least 64 x 64 are needed"
    )]
    PictureTooSmall {
        /// Which eye.
        eye: &'static str,
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
    /// The cameras move, but there are no motors, or the other way round.
    #[error("{0}")]
    Rigging(&'static str),
    /// The follower.
    #[error(transparent)]
    Track(#[from] vergence_track::TrackError),
    /// The filter's settings.
    #[error(transparent)]
    Filter(#[from] vergence_track::filter::FilterError),
    /// The control law.
    #[error(transparent)]
    Control(#[from] vergence_control::ControlError),
    /// A motor.
    #[error(transparent)]
    Axis(#[from] vergence_control::AxisError),
    /// The measurement of the pair.
    #[error(transparent)]
    Stereo(#[from] vergence_stereo::StereoError),
}
