//! Smaller pictures for the map, and rows that correspond.

use vergence_imaging::Gray;

/// The picture reduced `scale` times (>= 1) by the mean over the area of each new pixel; pixel u of the result lies at
/// `scale * (u + 0.5) - 0.5` of the full one. A rest of less than one new pixel at the right and bottom is dropped.
pub fn reduced(full: &Gray, scale: f64) -> Gray {
    if scale <= 1.0 {
        return full.clone();
    }
    let width = ((full.width() as f64 / scale).floor() as usize).max(1);
    let height = ((full.height() as f64 / scale).floor() as usize).max(1);
    let columns = spans(full.width(), width, scale);
    let rows = spans(full.height(), height, scale);
    let mut out = Gray::filled(width, height, 0);
    let mut sums = vec![0.0f32; full.width()];
    for (y, span) in rows.iter().enumerate() {
        sums.fill(0.0);
        for (i, &weight) in span.weights.iter().enumerate() {
            for (sum, &v) in sums.iter_mut().zip(full.row(span.first + i)) {
                *sum += weight * f32::from(v);
            }
        }
        for (o, span) in out.row_mut(y).iter_mut().zip(&columns) {
            let part = &sums[span.first..span.first + span.weights.len()];
            let mean: f32 = part.iter().zip(&span.weights).map(|(s, w)| s * w).sum();
            *o = (mean + 0.5) as u8;
        }
    }
    out
}

/// Old pixels under one new pixel, with weights that sum to 1.
struct Span {
    first: usize,
    weights: Vec<f32>,
}

fn spans(full: usize, count: usize, scale: f64) -> Vec<Span> {
    (0..count)
        .map(|i| {
            let (from, to) = (i as f64 * scale, (i + 1) as f64 * scale);
            let first = (from.floor() as usize).min(full - 1);
            let last = (to.ceil() as usize).clamp(first + 1, full);
            let covered = |k: usize| (to.min(k as f64 + 1.0) - from.max(k as f64)).max(0.0);
            let sum: f64 = (first..last).map(covered).sum();
            Span {
                first,
                weights: (first..last).map(|k| (covered(k) / sum) as f32).collect(),
            }
        })
        .collect()
}

/// The right picture with its rows moved to the left's: what the left has in row v lies in row `v - vertical` of the right.
/// Linear between rows; rows from outside repeat the edge.
pub(super) fn rows_corrected(
    right: &Gray,
    scale: f64,
    vertical_px: &dyn Fn(f64, f64) -> f64,
) -> Gray {
    let (width, height) = right.size();
    let full = |u: usize| scale * (u as f64 + 0.5) - 0.5;
    let bottom = (height - 1) as f64;
    Gray::from_fn(width, height, |x, y| {
        let v = y as f64 - vertical_px(full(x), full(y)) / scale;
        let v = v.clamp(0.0, bottom);
        let above = (v as usize).min(height - 1);
        let below = (above + 1).min(height - 1);
        let part = v - above as f64;
        let mixed =
            (1.0 - part) * f64::from(right.at(x, above)) + part * f64::from(right.at(x, below));
        (mixed + 0.5) as u8
    })
}
