//! What the target looks like, coarsely: brightness and texture of the body in cells, with their usual spread.

use crate::sampling::{Facet, Footprint, Lattice, sample};
use crate::view::EyeView;

/// Cells across the body.
const ACROSS: usize = 3;
/// Cells down from the neck to the knees.
const DOWN: usize = 8;
/// Samples per side of a cell.
const FINE: usize = 5;
/// Spread that is always granted, in units of the picture's median brightness: gain and light are never quite steady.
const GRANTED: f32 = 0.1;

/// Brightness and texture of each cell relative to the picture's median; `None` for cells outside the picture.
pub(crate) type Signature = [Option<[f32; 2]>; ACROSS * DOWN];

/// Mean and variance of signatures.
#[derive(Clone, Debug, Default)]
pub(crate) struct Appearance {
    cells: [Option<[[f32; 2]; 2]>; ACROSS * DOWN],
    samples: Vec<f32>,
}

impl Appearance {
    pub(crate) fn reset(&mut self) {
        self.cells = Default::default();
    }

    /// Signature of a body whose chest is the middle of `facet`.
    pub(crate) fn signature(&mut self, view: &EyeView, facet: &Facet) -> Option<Signature> {
        let (cols, rows) = (ACROSS * FINE, DOWN * FINE);
        let (w, h) = (0.42, 1.2);
        let lattice = Lattice {
            cols,
            rows,
            x0_m: -w / 2.0 + w / cols as f64 / 2.0,
            y0_m: -0.22 + h / rows as f64 / 2.0,
            step_x_m: w / cols as f64,
            step_y_m: h / rows as f64,
        };
        let footprint = Footprint::new(view, facet, &lattice)?;
        sample(view, &footprint, &mut self.samples);
        let unit = median_brightness(view) + 8.0;
        let mut signature: Signature = [None; ACROSS * DOWN];
        for (index, cell) in signature.iter_mut().enumerate() {
            let (i, j) = (index % ACROSS, index / ACROSS);
            let x = lattice.x0_m + (i * FINE + FINE / 2) as f64 * lattice.step_x_m;
            let y = lattice.y0_m + (j * FINE + FINE / 2) as f64 * lattice.step_y_m;
            if !view
                .project(&facet.at(x, y))
                .is_some_and(|p| view.camera.contains(&p))
            {
                continue;
            }
            let (mut sum, mut sum_sq) = (0.0, 0.0);
            for b in 0..FINE {
                for a in 0..FINE {
                    let s = self.samples[(j * FINE + b) * cols + i * FINE + a] / unit;
                    sum += s;
                    sum_sq += s * s;
                }
            }
            let mean = sum / (FINE * FINE) as f32;
            let spread = (sum_sq / (FINE * FINE) as f32 - mean * mean)
                .max(0.0)
                .sqrt();
            *cell = Some([mean, spread]);
        }
        Some(signature)
    }

    /// Learn a signature with weight `rate`; cells seen for the first time count whole.
    pub(crate) fn learn(&mut self, signature: &Signature, rate: f32) {
        for (known, new) in self.cells.iter_mut().zip(signature) {
            let Some(new) = new else { continue };
            match known {
                None => *known = Some([*new, [GRANTED * GRANTED; 2]]),
                Some([mean, variance]) => {
                    for k in 0..2 {
                        let off = new[k] - mean[k];
                        mean[k] += rate * off;
                        variance[k] += rate * (off * off - variance[k]);
                    }
                }
            }
        }
    }

    /// Mean squared deviation from what is known in units of its spread: about 1 for the target itself. `None` when
    /// too few cells can be compared. One cell counts at most 16, so that a bag or an arm does not decide.
    pub(crate) fn strangeness(&self, signature: &Signature) -> Option<f64> {
        let (mut sum, mut n) = (0.0_f32, 0.0_f32);
        for (known, new) in self.cells.iter().zip(signature) {
            let (Some([mean, variance]), Some(new)) = (known, new) else {
                continue;
            };
            for k in 0..2 {
                let off = new[k] - mean[k];
                sum += (off * off / (variance[k] + 0.5 * GRANTED * GRANTED)).min(16.0);
                n += 1.0;
            }
        }
        (n >= 8.0).then(|| f64::from(sum / n))
    }
}

/// Median grey level over a sparse sample of the smallest level.
fn median_brightness(view: &EyeView) -> f32 {
    let picture = view.pyramid.level(view.pyramid.count() - 1);
    let mut counts = [0_u32; 256];
    for &s in picture.samples().iter().step_by(5) {
        counts[usize::from(s)] += 1;
    }
    let half = counts.iter().sum::<u32>() / 2;
    let mut below = 0;
    for (level, &count) in counts.iter().enumerate() {
        below += count;
        if below > half {
            return level as f32;
        }
    }
    0.0
}
