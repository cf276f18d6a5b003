//! Where a patch of one picture lies in a window of the other: normalised cross-correlation at every whole pixel.

use multiversion::multiversion;
use vergence_imaging::Gray;

/// Half the side of a patch.
pub(super) const REACH: usize = 4;

/// Side of a patch.
const SIDE: usize = 2 * REACH + 1;

/// Samples of a patch.
const SAMPLES: usize = SIDE * SIDE;

/// Least contrast of a patch (standard deviation, grey levels) that correlation says anything about.
const LEAST_CONTRAST: f64 = 1.0;

/// Another peak nearer than this belongs to the same one, px.
const SAME_PEAK: isize = 2;

/// One level of one picture, ready to be searched.
#[derive(Clone, Debug)]
pub(super) struct Field {
    pub(super) width: usize,
    pub(super) height: usize,
    samples: Vec<f32>,
    /// One over the length of each patch with its mean removed; 0 where it has no contrast or leaves the picture.
    inverse_norm: Vec<f32>,
}

/// Whole pixels from..=to of both axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) x: [isize; 2],
    pub(super) y: [isize; 2],
}

/// The best place in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Peak {
    /// Position with the fraction by a parabola on each axis.
    pub(super) at: [f64; 2],
    /// Whole pixel.
    pub(super) whole: [usize; 2],
    /// Correlation there.
    pub(super) score: f32,
    /// Correlation of the best other peak; -1 when there is none.
    pub(super) second: f32,
}

impl Field {
    /// Of a level.
    pub(super) fn new(picture: &Gray) -> Self {
        let (width, height) = picture.size();
        let samples: Vec<f32> = picture.samples().iter().map(|&s| f32::from(s)).collect();
        Self {
            width,
            height,
            inverse_norm: inverse_norms(picture),
            samples,
        }
    }

    fn patch(&self, x: usize, y: usize) -> [f32; SAMPLES] {
        let mut patch = [0.0; SAMPLES];
        for (j, out) in patch.chunks_exact_mut(SIDE).enumerate() {
            let from = (y + j - REACH) * self.width + x - REACH;
            out.copy_from_slice(&self.samples[from..from + SIDE]);
        }
        patch
    }

    /// Whether a patch with contrast lies around a pixel.
    fn usable(&self, x: usize, y: usize) -> bool {
        x < self.width && y < self.height && self.inverse_norm[y * self.width + x] > 0.0
    }
}

/// One over the length of each patch with its mean removed.
fn inverse_norms(picture: &Gray) -> Vec<f32> {
    let (w, h) = picture.size();
    let mut out = vec![0.0f32; w * h];
    if w < SIDE || h < SIDE {
        return out;
    }
    // Sums down the columns over the last SIDE rows, then along the row; integers, so exact.
    let mut columns = vec![[0u32; 2]; w];
    for y in 0..h {
        let leaves = y.checked_sub(SIDE).map(|y| picture.row(y));
        for (x, column) in columns.iter_mut().enumerate() {
            let s = u32::from(picture.at(x, y));
            column[0] += s;
            column[1] += s * s;
            if let Some(row) = leaves {
                let s = u32::from(row[x]);
                column[0] -= s;
                column[1] -= s * s;
            }
        }
        if y + 1 < SIDE {
            continue;
        }
        let row = &mut out[(y - REACH) * w..][..w];
        let mut sum = [0u32; 2];
        for x in 0..w {
            for k in 0..2 {
                sum[k] += columns[x][k];
                if x >= SIDE {
                    sum[k] -= columns[x - SIDE][k];
                }
            }
            if x + 1 >= SIDE {
                let n = SAMPLES as f64;
                let square = f64::from(sum[1]) - f64::from(sum[0]).powi(2) / n;
                if square > n * LEAST_CONTRAST * LEAST_CONTRAST {
                    row[x - REACH] = (1.0 / square.sqrt()) as f32;
                }
            }
        }
    }
    out
}

/// The search with its buffer.
#[derive(Clone, Debug, Default)]
pub(super) struct Search {
    scores: Vec<f32>,
}

impl Search {
    /// Best place in `field` for the patch of `from` around a pixel. `allowed` says which rows of the window count in a
    /// column (whole pixels from..=to). `None` without contrast, or when no place in the window has any.
    pub(super) fn best(
        &mut self,
        from: &Field,
        at: [usize; 2],
        field: &Field,
        window: Window,
        allowed: impl Fn(isize) -> [isize; 2],
    ) -> Option<Peak> {
        if !from.usable(at[0], at[1]) {
            return None;
        }
        let clip = |range: [isize; 2], length: usize| {
            let (low, high) = (REACH as isize, length as isize - 1 - REACH as isize);
            let range = [range[0].max(low), range[1].min(high)];
            (range[0] <= range[1]).then(|| range.map(|v| v as usize))
        };
        let (x, y) = (clip(window.x, field.width)?, clip(window.y, field.height)?);
        let (columns, rows) = (x[1] - x[0] + 1, y[1] - y[0] + 1);
        let mut template = from.patch(at[0], at[1]);
        let mean = template.iter().sum::<f32>() / SAMPLES as f32;
        for t in &mut template {
            *t = (*t - mean) * from.inverse_norm[at[1] * from.width + at[0]];
        }
        self.scores.clear();
        self.scores.resize(columns * rows, 0.0);
        for (j, out) in self.scores.chunks_exact_mut(columns).enumerate() {
            let row = y[0] + j;
            let top = (row - REACH) * field.width + x[0] - REACH;
            correlate_row(&field.samples[top..], field.width, &template, out);
            let norms = &field.inverse_norm[row * field.width + x[0]..][..columns];
            for (i, (out, norm)) in out.iter_mut().zip(norms).enumerate() {
                let [low, high] = allowed((x[0] + i) as isize);
                let inside = low <= row as isize && row as isize <= high && *norm > 0.0;
                *out = if inside { *out * norm } else { -1.0 };
            }
        }
        self.peak(columns, rows, [x[0], y[0]])
    }

    fn peak(&self, columns: usize, rows: usize, origin: [usize; 2]) -> Option<Peak> {
        let at = |i: usize, j: usize| self.scores[j * columns + i];
        let mut best = (-1.0, 0);
        for (k, &s) in self.scores.iter().enumerate() {
            if s > best.0 {
                best = (s, k);
            }
        }
        if best.0 <= 0.0 {
            return None;
        }
        let (bi, bj) = (best.1 % columns, best.1 / columns);
        let mut second = -1.0f32;
        for j in 0..rows {
            for i in 0..columns {
                let s = at(i, j);
                let apart = (i as isize - bi as isize).abs() > SAME_PEAK
                    || (j as isize - bj as isize).abs() > SAME_PEAK;
                if s > second && apart && self.is_peak(columns, rows, i, j) {
                    second = s;
                }
            }
        }
        let fraction = |before: Option<f32>, after: Option<f32>| match (before, after) {
            (Some(a), Some(b)) if a > -1.0 && b > -1.0 => {
                let bend = a - 2.0 * best.0 + b;
                if bend < 0.0 {
                    f64::from((0.5 * (a - b) / bend).clamp(-0.5, 0.5))
                } else {
                    0.0
                }
            }
            _ => 0.0,
        };
        let fx = fraction(
            (bi > 0).then(|| at(bi - 1, bj)),
            (bi + 1 < columns).then(|| at(bi + 1, bj)),
        );
        let fy = fraction(
            (bj > 0).then(|| at(bi, bj - 1)),
            (bj + 1 < rows).then(|| at(bi, bj + 1)),
        );
        let whole = [origin[0] + bi, origin[1] + bj];
        Some(Peak {
            at: [whole[0] as f64 + fx, whole[1] as f64 + fy],
            whole,
            score: best.0,
            second,
        })
    }

    /// Whether no neighbour in the window is higher.
    fn is_peak(&self, columns: usize, rows: usize, i: usize, j: usize) -> bool {
        let here = self.scores[j * columns + i];
        for v in j.saturating_sub(1)..=(j + 1).min(rows - 1) {
            for u in i.saturating_sub(1)..=(i + 1).min(columns - 1) {
                if self.scores[v * columns + u] > here {
                    return false;
                }
            }
        }
        true
    }
}

/// Columns correlated together: their sums stay in registers.
const BLOCK: usize = 32;

/// Dot product of the template with the patches whose upper left samples are `samples[0..out.len()]`.
#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn correlate_row(samples: &[f32], stride: usize, template: &[f32; SAMPLES], out: &mut [f32]) {
    let whole = out.len() - out.len() % BLOCK;
    for (b, block) in out[..whole].chunks_exact_mut(BLOCK).enumerate() {
        let mut sums = [0.0f32; BLOCK];
        for (j, weights) in template.chunks_exact(SIDE).enumerate() {
            let row = &samples[j * stride + b * BLOCK..][..BLOCK + SIDE - 1];
            for (i, &weight) in weights.iter().enumerate() {
                for (sum, &sample) in sums.iter_mut().zip(&row[i..i + BLOCK]) {
                    *sum += weight * sample;
                }
            }
        }
        block.copy_from_slice(&sums);
    }
    let rest = &mut out[whole..];
    for (j, weights) in template.chunks_exact(SIDE).enumerate() {
        let row = &samples[j * stride + whole..][..rest.len() + SIDE - 1];
        for (i, &weight) in weights.iter().enumerate() {
            for (out, &sample) in rest.iter_mut().zip(&row[i..]) {
                *out += weight * sample;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(shift: [usize; 2], gain: f64, offset: f64) -> Gray {
        Gray::from_fn(80, 60, |x, y| {
            let (u, v) = ((x + shift[0]) as u32, (y + shift[1]) as u32);
            let hash = (u.wrapping_mul(73_856_093) ^ v.wrapping_mul(19_349_663))
                .wrapping_mul(2_654_435_761)
                >> 24;
            (offset + gain * f64::from(hash)) as u8
        })
    }

    /// A shifted picture with another gain and offset is found where it was put, with correlation (almost) 1, and nothing else
    /// comes near; the score is the plain correlation of the two patches.
    #[test]
    fn finds_the_shift() {
        let left = Field::new(&texture([0, 0], 0.9, 10.0));
        let right_picture = texture([7, 2], 0.5, 60.0);
        let right = Field::new(&right_picture);
        let window = Window {
            x: [0, 79],
            y: [20, 40],
        };
        let peak = Search::default()
            .best(&left, [40, 30], &right, window, |_| [20, 40])
            .unwrap();
        assert_eq!(peak.whole, [33, 28]);
        assert!(peak.score > 0.99 && peak.second < 0.7, "{peak:?}");
        assert!((peak.at[0] - 33.0).abs() < 0.2 && (peak.at[1] - 28.0).abs() < 0.2);
        // Outside what is allowed it cannot be found.
        let other = Search::default().best(&left, [40, 30], &right, window, |_| [30, 40]);
        assert!(other.is_none_or(|p| p.score < 0.7));
    }

    /// A flat patch finds nothing.
    #[test]
    fn flat_finds_nothing() {
        let flat = Field::new(&Gray::filled(80, 60, 7));
        let window = Window {
            x: [0, 79],
            y: [0, 59],
        };
        assert_eq!(
            Search::default().best(&flat, [40, 30], &flat, window, |_| [0, 59]),
            None
        );
    }
}
