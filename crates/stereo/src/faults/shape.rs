//! Roundness and cardboard, where the rig is known.

/// Shape of what is seen, from rig, screen and viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Depth magnification over width magnification at the plane of convergence: 1 = true, < 1 flat.
    pub roundness: f64,
    /// The same at the median distance of the scene, by the pair's own disparities.
    pub roundness_at_median: f64,
    /// Seen size over real size at the nearest over the same at the farthest (1st and 99th percentile of disparity); < 1: near
    /// things look small (puppet theatre). `None` where a percentile lies beyond infinity.
    pub puppet_ratio: Option<f64>,
}
