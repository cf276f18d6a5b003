//! Points worth looking for: the strongest corner of each cell of a grid (Shi & Tomasi 1994, the smaller eigenvalue of the
//! structure tensor), so that they are spread over the picture whatever is in it.

use vergence_imaging::Gray;

/// Half the side of the window of the structure tensor, px of the level.
const WINDOW: usize = 3;

/// Least smaller eigenvalue per sample, (grey levels / px)²: below it there is only noise and coding.
const LEAST: f32 = 0.5;

/// A point of a level that can be found again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Corner {
    pub(super) x: usize,
    pub(super) y: usize,
}

/// The strongest corner of each cell of about `columns` x `rows`, row by row, none nearer to the border than `margin`.
pub(super) fn corners(picture: &Gray, columns: usize, rows: usize, margin: usize) -> Vec<Corner> {
    let (w, h) = picture.size();
    let margin = margin.max(WINDOW + 1);
    if w <= 2 * margin || h <= 2 * margin {
        return Vec::new();
    }
    let strength = strengths(picture);
    let mut found = Vec::with_capacity(columns * rows);
    let edge = |k: usize, n: usize, length: usize| margin + k * (length - 2 * margin) / n;
    for j in 0..rows {
        for i in 0..columns {
            let mut best = (LEAST, None);
            for y in edge(j, rows, h)..edge(j + 1, rows, h) {
                for x in edge(i, columns, w)..edge(i + 1, columns, w) {
                    let s = strength[y * w + x];
                    if s > best.0 {
                        best = (s, Some(Corner { x, y }));
                    }
                }
            }
            found.extend(best.1);
        }
    }
    found
}

/// Smaller eigenvalue of the structure tensor per sample of its window; 0 along the border.
fn strengths(picture: &Gray) -> Vec<f32> {
    let (w, h) = picture.size();
    let side = 2 * WINDOW + 1;
    let mut out = vec![0.0f32; w * h];
    // Column sums of the three products over the last `side` rows, kept as exact integers.
    let mut sums = vec![[0i32; 3]; w];
    let mut ring = vec![vec![[0i32; 3]; w]; side];
    for y in 1..h - 1 {
        let slot = &mut ring[y % side];
        let (above, here, below) = (picture.row(y - 1), picture.row(y), picture.row(y + 1));
        for x in 1..w - 1 {
            let gx = i32::from(here[x + 1]) - i32::from(here[x - 1]);
            let gy = i32::from(below[x]) - i32::from(above[x]);
            let new = [gx * gx, gx * gy, gy * gy];
            for k in 0..3 {
                sums[x][k] += new[k] - slot[x][k];
            }
            slot[x] = new;
        }
        if y >= side {
            eigenvalues(&sums, &mut out[(y - WINDOW) * w..][..w]);
        }
    }
    out
}

/// One row of [`strengths`] from the column sums around it.
fn eigenvalues(sums: &[[i32; 3]], out: &mut [f32]) {
    let side = 2 * WINDOW + 1;
    // The gradients are differences over two pixels.
    let scale = 1.0 / (4 * side * side) as f32;
    let mut box_sum = [0i32; 3];
    for x in 1..sums.len() - 1 {
        for k in 0..3 {
            box_sum[k] += sums[x][k];
            if x > side {
                box_sum[k] -= sums[x - side][k];
            }
        }
        if x >= side {
            let [xx, xy, yy] = box_sum.map(|s| s as f32 * scale);
            let half = 0.5 * (xx - yy);
            out[x - WINDOW] = 0.5 * (xx + yy) - (half * half + xy * xy).sqrt();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tensor's smaller eigenvalue, computed plainly at one pixel, is what the running sums give there.
    #[test]
    fn running_sums_equal_the_plain_sum() {
        let picture = Gray::from_fn(40, 30, |x, y| ((x * 37 + y * 91 + x * y * 13) % 251) as u8);
        let strength = strengths(&picture);
        for (x, y) in [(4, 4), (20, 15), (35, 25)] {
            let mut sum = [0.0f64; 3];
            for v in y - WINDOW..=y + WINDOW {
                for u in x - WINDOW..=x + WINDOW {
                    let at = |u: usize, v: usize| f64::from(picture.at(u, v));
                    let gx = (at(u + 1, v) - at(u - 1, v)) / 2.0;
                    let gy = (at(u, v + 1) - at(u, v - 1)) / 2.0;
                    for (s, p) in sum.iter_mut().zip([gx * gx, gx * gy, gy * gy]) {
                        *s += p / 49.0;
                    }
                }
            }
            let [xx, xy, yy] = sum;
            let plain = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
            let got = f64::from(strength[y * 40 + x]);
            assert!((got - plain).abs() < 1e-2 * plain, "{got} {plain}");
        }
    }

    /// A constant picture has none; a single edge has none either; its end has one.
    #[test]
    fn edges_are_no_corners() {
        assert!(corners(&Gray::filled(64, 48, 90), 8, 6, 5).is_empty());
        let edge = Gray::from_fn(64, 48, |x, _| if x < 32 { 40 } else { 200 });
        assert!(corners(&edge, 8, 6, 5).is_empty());
        let end = Gray::from_fn(64, 48, |x, y| if x < 32 && y < 24 { 40 } else { 200 });
        let found = corners(&end, 8, 6, 5);
        assert!(!found.is_empty());
        assert!(
            found
                .iter()
                .all(|c| c.x.abs_diff(32) <= 4 && c.y.abs_diff(24) <= 4)
        );
    }
}
