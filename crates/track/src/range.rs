//! Coarse distance of a patch of the left picture: a sweep of planes through both pictures.

use nalgebra::{Point3, Vector3};

use crate::sampling::{Facet, Footprint, Lattice, sample};
use crate::view::EyeView;

/// Distances that the sweep covers, metres: from where a person no longer fits the picture to where two lenses 70 mm
/// apart no longer tell the distance.
pub(crate) const SWEEP_M: (f64, f64) = (0.6, 25.0);

/// Best match of a patch along its ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    /// Distance from the left lens, metres.
    pub(crate) distance_m: f64,
    /// Weighted normalised correlation at the best distance, -1 to 1.
    pub(crate) score: f64,
    /// Disparity step that one standard deviation of distance corresponds to, 1/m.
    pub(crate) sigma_inverse_m: f64,
}

/// Reusable memory of the sweep.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sweep {
    left: Vec<f32>,
    right: Vec<f32>,
    scores: Vec<f64>,
}

/// What to match: a window around a viewing ray of the left picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch<'a> {
    /// Unit vector of the window's middle, base frame.
    pub(crate) ray: Vector3<f64>,
    /// Downward direction, base frame.
    pub(crate) down: Vector3<f64>,
    /// The window for a plane at 1 m: lengths are tangents of angles.
    pub(crate) lattice: Lattice,
    /// Weight per sample, or none for equal weights.
    pub(crate) weights: Option<&'a [f32]>,
}

impl Sweep {
    /// The distance in `between` (metres, near and far) at which the right picture matches the left one best, by
    /// weighted zero-mean normalised correlation over planes at equal steps of inverse distance. `None` when the
    /// patch has no texture or no plane lies in the right picture.
    pub(crate) fn range(
        &mut self,
        left: &EyeView,
        right: &EyeView,
        patch: &Patch,
        between: (f64, f64),
    ) -> Option<Range> {
        let lens = left.lens();
        let footprint = self.footprint(left, &lens, patch, 1.0)?;
        let inside = sample(left, &footprint, &mut self.left);
        if inside < 0.5 || !normalise(&mut self.left, patch.weights) {
            return None;
        }
        // One step moves the match by 0.7 of the sampling distance.
        let baseline = (right.lens() - lens).norm();
        let stride_rad = patch.lattice.step_x_m.min(patch.lattice.step_y_m);
        let px_rad = 1.0 / left.camera.intrinsics.fx;
        let step = 0.7 * stride_rad.max(px_rad) / baseline.max(1e-3);
        let (far, near) = (1.0 / between.1, 1.0 / between.0);
        let count = (((near - far) / step).ceil() as usize + 1).clamp(3, 160);
        let step = (near - far) / (count - 1) as f64;
        self.scores.clear();
        for k in 0..count {
            let score = self.score(right, &lens, patch, far + step * k as f64);
            self.scores.push(score.unwrap_or(f64::NEG_INFINITY));
        }
        best_of(&self.scores).map(|(at, score)| Range {
            distance_m: 1.0 / (far + at * step).max(1e-3),
            score,
            sigma_inverse_m: step * (1.2 - score.clamp(0.0, 1.0)),
        })
    }

    /// Correlation at one distance.
    pub(crate) fn score_at(
        &mut self,
        left: &EyeView,
        right: &EyeView,
        patch: &Patch,
        distance_m: f64,
    ) -> Option<f64> {
        let lens = left.lens();
        let footprint = self.footprint(left, &lens, patch, 1.0)?;
        sample(left, &footprint, &mut self.left);
        if !normalise(&mut self.left, patch.weights) {
            return None;
        }
        self.score(right, &lens, patch, 1.0 / distance_m)
    }

    fn footprint(
        &self,
        view: &EyeView,
        lens: &Point3<f64>,
        patch: &Patch,
        distance_m: f64,
    ) -> Option<Footprint> {
        let facet = Facet::facing(lens, &patch.ray, distance_m, &patch.down);
        Footprint::new(view, &facet, &patch.lattice.scaled(distance_m))
    }

    fn score(
        &mut self,
        right: &EyeView,
        lens: &Point3<f64>,
        patch: &Patch,
        inverse_m: f64,
    ) -> Option<f64> {
        let footprint = self.footprint(right, lens, patch, 1.0 / inverse_m)?;
        let inside = sample(right, &footprint, &mut self.right);
        if inside < 0.5 {
            return None;
        }
        correlation(&self.left, &self.right, patch.weights)
    }
}

/// Subtract the weighted mean and divide by the weighted deviation; false for a flat patch.
pub(crate) fn normalise(samples: &mut [f32], weights: Option<&[f32]>) -> bool {
    let (mut sum, mut sum_w, mut sum_sq) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (i, &s) in samples.iter().enumerate() {
        let w = f64::from(weights.map_or(1.0, |w| w[i]));
        let s = f64::from(s);
        sum_w += w;
        sum += w * s;
        sum_sq += w * s * s;
    }
    if sum_w <= 0.0 {
        return false;
    }
    let mean = sum / sum_w;
    let variance = sum_sq / sum_w - mean * mean;
    // Below one grey level of contrast there is only noise.
    if variance < 1.0 {
        return false;
    }
    let gain = 1.0 / variance.sqrt();
    for s in samples.iter_mut() {
        *s = ((f64::from(*s) - mean) * gain) as f32;
    }
    true
}

/// Weighted correlation of a normalised patch with a raw one.
pub(crate) fn correlation(left: &[f32], right: &[f32], weights: Option<&[f32]>) -> Option<f64> {
    let mut sums = [0.0_f32; 4];
    let mut add = |l: f32, r: f32, w: f32| {
        sums[0] += w;
        sums[1] += w * r;
        sums[2] += w * r * r;
        sums[3] += w * l * r;
    };
    match weights {
        None => left.iter().zip(right).for_each(|(&l, &r)| add(l, r, 1.0)),
        Some(weights) => left
            .iter()
            .zip(right)
            .zip(weights)
            .for_each(|((&l, &r), &w)| add(l, r, w)),
    }
    let [w, r, rr, lr] = sums.map(f64::from);
    let mean = r / w;
    let variance = rr / w - mean * mean;
    // The left patch has mean zero, so the mean of the right one drops out of the product.
    (variance >= 1.0).then(|| lr / w / variance.sqrt())
}

/// Position of the largest score with a parabola's fraction, and its value.
pub(crate) fn best_of(scores: &[f64]) -> Option<(f64, f64)> {
    let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    let top = scores[best];
    if !top.is_finite() {
        return None;
    }
    let fraction = if best > 0 && best + 1 < scores.len() {
        vertex(scores[best - 1], top, scores[best + 1])
    } else {
        0.0
    };
    Some((best as f64 + fraction, top))
}

/// Vertex of the parabola through three equally spaced values, relative to the middle one; 0 when there is none.
pub(crate) fn vertex(before: f64, at: f64, after: f64) -> f64 {
    let bend = before - 2.0 * at + after;
    if !(bend < -1e-12 && before.is_finite() && after.is_finite()) {
        return 0.0;
    }
    ((before - after) / (2.0 * bend)).clamp(-0.5, 0.5)
}
