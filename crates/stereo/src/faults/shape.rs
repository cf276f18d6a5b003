//! Roundness and cardboard, where the rig is known.
//!
//! Flatness is not measured from the disparities alone: a scene of boards and a scene flattened by a long lens have the same map.

use vergence_geometry::array::Mode;
use vergence_geometry::comfort::{PuppetTheatre, Roundness};

use super::{Cause, Conditions, Estimate, Finding, Limits};
use crate::dense::DisparityMap;

/// Shape of what is seen, from rig, screen and viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Depth magnification over width magnification at the plane of convergence: 1 = true, < 1 flat. 0 for parallel axes.
    pub roundness: f64,
    /// The same at the median disparity of the pair, `V t / (z (e - p))`; `None` where the sensor's width is not known, or the median
    /// lies beyond infinity.
    pub roundness_at_median: Option<f64>,
    /// Seen size over real size at the nearest over the same at the farthest (1st and 99th percentile of disparity); < 1: near things look
    /// small (puppet theatre). `None` as above.
    pub puppet_ratio: Option<f64>,
}

/// Shape by the rig of the conditions; `None` where none is given.
pub fn shape_of(conditions: &Conditions, map: &DisparityMap) -> Option<Shape> {
    let rig = conditions.rig?;
    let viewing = &conditions.viewing;
    let viewer = &viewing.viewer;
    let convergence_m = match rig.mode {
        Mode::Parallel => f64::INFINITY,
        Mode::Converged { distance_m } | Mode::Shifted { distance_m } => distance_m,
        Mode::Verged { target_m } => target_m[2],
    };
    let rule = Roundness::default();
    let roundness = rule.measure(rig.interaxial_m, convergence_m, viewer);
    let deeper = conditions.sensor_width_m.and_then(|sensor_m| {
        let magnification = viewing.screen_width_m / sensor_m;
        let pixel_m = viewing.screen_width_m / viewing.width_px.max(1) as f64;
        // p = M f t (1 / L - 1 / z)
        let reach = magnification * rig.focal_m * rig.interaxial_m;
        let distance_m = |p: f64| 1.0 / (1.0 / convergence_m - p / reach);
        let [far, median, near] = map.quantiles_px([0.01, 0.5, 0.99])?.map(|d| -d * pixel_m);
        let visible = |p: f64| distance_m(p) > 0.0 && p < viewer.interocular_m;
        let size = |p: f64| {
            PuppetTheatre::size_ratio(magnification, rig.focal_m, distance_m(p), p, viewer)
        };
        let at_median = visible(median).then(|| {
            let room = viewer.interocular_m - median;
            viewer.distance_m * rig.interaxial_m / (distance_m(median) * room)
        });
        let puppet = (visible(near) && visible(far)).then(|| size(near) / size(far));
        Some((at_median, puppet))
    });
    let (roundness_at_median, puppet_ratio) = deeper.unwrap_or((None, None));
    Some(Shape {
        roundness,
        roundness_at_median,
        puppet_ratio,
    })
}

/// The verdict on how often too flat things are: 1 / roundness where the pair's own depth is, else at the plane of convergence.
pub(crate) fn finding(shape: &Shape) -> Option<Finding> {
    let roundness = shape.roundness_at_median.unwrap_or(shape.roundness);
    if !(roundness > 0.0) {
        return None;
    }
    let rule = Roundness::default();
    let limits = Limits {
        look: 1.0 / rule.comfortable,
        bad: 1.0 / rule.acceptable,
        source: "geometry for the measure; limits fitted to distances in Yang et al. 2016",
    };
    let what = format!(
        "depth is {:.1} times too flat for its width",
        1.0 / roundness
    );
    let estimate = Estimate {
        value: 1.0 / roundness,
        sigma: 0.0,
    };
    let remedy = "a wider base, a nearer camera or a longer viewing distance";
    Some(Finding::judged(
        Cause::Cardboard,
        estimate,
        "times",
        limits,
        &what,
        remedy,
    ))
}
