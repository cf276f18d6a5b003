//! What can go wrong with a pair.

/// Why a picture could not be composed, turned, or a point not be triangulated. Measuring disparity has its own reasons:
/// [`crate::measure::Refusal`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StereoError {
    /// Left and right differ in size.
    #[error(
        "the left picture is {left:?} pixels, the right one {right:?}: both must have one size"
    )]
    SizesDiffer {
        /// Width and height of the left picture.
        left: (usize, usize),
        /// Width and height of the right picture.
        right: (usize, usize),
    },
    /// A picture that is too small to be matched.
    #[error("the pictures are {width} x {height} pixels, at least {least} x {least} are needed")]
    TooSmall {
        /// Width of the pictures.
        width: usize,
        /// Height of the pictures.
        height: usize,
        /// Least side.
        least: usize,
    },
    /// A range of disparities that is empty, or does not fit the picture.
    #[error(
        "disparities from {low} to {high} px cannot be searched in a picture {width} px wide: the first must not exceed the last, and \
         neither they nor their span may reach the width"
    )]
    DisparityRange {
        /// Smallest disparity, px.
        low: i32,
        /// Largest disparity, px.
        high: i32,
        /// Width of the pictures, px.
        width: usize,
    },
    /// A region that does not lie in the picture.
    #[error(
        "the region [column, row, width, height] {region:?} does not lie in the picture of {picture:?} pixels"
    )]
    RegionOutside {
        /// Column, row, width, height.
        region: [usize; 4],
        /// Width and height of the picture.
        picture: (usize, usize),
    },
    /// Two pictures that have nothing in common.
    #[error("nothing in the left picture was found in the right one")]
    NothingMatches,
    /// A picture does not belong to its camera.
    #[error("the picture is {picture:?} pixels but its camera's is {camera:?}")]
    SizeOfCamera {
        /// Width and height of the picture.
        picture: (usize, usize),
        /// Width and height by the camera.
        camera: (usize, usize),
    },
    /// A number that is not finite, or outside its range.
    #[error("{what} is {value}, it must be {needed}")]
    OutOfRange {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        needed: &'static str,
    },
    /// A pixel from which no ray can be computed.
    #[error("pixel ({u}, {v}) lies where the lens model of its camera cannot be inverted")]
    NoRay {
        /// Its column.
        u: f64,
        /// Its row.
        v: f64,
    },
    /// Two rays that fix no distance.
    #[error(
        "the rays meet at {angle_rad:.2e} rad, which is no more than their noise of {sigma_rad:.2e} rad"
    )]
    RaysParallel {
        /// Angle between the rays, rad.
        angle_rad: f64,
        /// Its standard deviation, rad.
        sigma_rad: f64,
    },
    /// The rays meet behind a camera.
    #[error("the rays meet behind a camera, {depth_m:.3} m along its axis")]
    BehindCamera {
        /// Depth along that camera's axis, m.
        depth_m: f64,
    },
    /// The lens centres are one.
    #[error(
        "the two lens centres are {baseline_m:e} m apart: a pair needs a baseline (at least 1e-6 m); was one camera given twice?"
    )]
    NoBaseline {
        /// Their distance, m.
        baseline_m: f64,
    },
    /// No plane along the baseline can be seen by both cameras.
    #[error(
        "no common plane: the cameras look {:.1} and {:.1} degrees off their baseline and {apart_deg:.1} degrees apart; both must look across it, the same way (at least 10 degrees off it)",
        along_deg[0], along_deg[1]
    )]
    NoCommonPlane {
        /// Angle between the optical axes, degrees.
        apart_deg: f64,
        /// Angle of each optical axis to the line from the left lens to the right one, degrees.
        along_deg: [f64; 2],
    },
    /// In the cameras' own pictures the left one stands on the right.
    #[error(
        "the camera called left stands to the right of the other in their own pictures; exchange left and right"
    )]
    EyesExchanged,
    /// The whole field of both cameras does not fit on a plane.
    #[error(
        "the cameras see more than 84 degrees off the common axis, which no flat picture shows; choose the inscribed field, or keep the focal length"
    )]
    FieldTooWide,
    /// What both cameras see in common is too small, or nothing.
    #[error(
        "{}; show all, keep the focal length, or put the convergence distance where the cameras look",
        if zoom.is_finite() && *zoom > 0.0 {
            format!("a window without black wedges would magnify {zoom:.1} times, at most {most} times is sensible")
        } else {
            "there is no window without black wedges: the two pictures show nothing in common".to_owned()
        }
    )]
    NoInscribedWindow {
        /// Focal length of the window relative to the cameras' own.
        zoom: f64,
        /// Most that is accepted.
        most: f64,
    },
    /// No orientation exists: the target lies on the line through both lenses, or on a lens.
    #[error("the target lies on the line through the two lenses (or on a lens): no common plane")]
    NoPlane,
}
