//! The contrast-structure factor of SSIM (Wang, Bovik, Sheikh and Simoncelli 2004) between maps of one size.
//!
//! CS = mean over all windows inside of (2 σ_ab + C2) / (σ_a² + σ_b² + C2), moments weighted by an 11 x 11 Gaussian of
//! σ = 1.5. The window is separable: columns first, straight from the samples, then rows of the moments. All maps are
//! taken together, a few rows at a time, so that each sample comes from memory once and nothing but those rows is kept.

use rayon::prelude::*;
use vergence_imaging::Plane;

use super::enlarge::{EnlargedRows, Enlargement};
use super::windows::{SIDE, all_pairs, with_each};

/// Rows of windows done together; sums are over these, then over all, so that threads change nothing.
const ROWS: usize = 32;

/// Enlarged bands made together: as many as stay in a near cache.
const LARGE: usize = 2;

/// Maps compared with each other.
pub(crate) const MAPS: usize = 6;

/// Pairs of those.
pub const PAIRS: usize = 15;

/// CS of each of `bands` with `high`; smaller bands are enlarged to its size first.
///
/// # Panics
/// When `high` is smaller than 11 x 11 samples.
pub fn with_high(high: &Plane<f64>, bands: &[Plane<f64>]) -> Vec<f64> {
    let (width, height) = high.size();
    let (same, smaller): (Vec<_>, Vec<_>) =
        (0..bands.len()).partition(|b| bands[*b].size() == (width, height));
    let line = |length: usize, n: usize| Enlargement {
        length,
        ratio: length as f64 / n as f64,
    };
    let enlargements = smaller.iter().map(|b| {
        let (w, h) = bands[*b].size();
        EnlargedRows::new(&bands[*b], line(width, w), line(height, h))
    });
    let enlargements: Vec<EnlargedRows> = enlargements.collect();
    over_windows((width, height), bands.len(), |enlarged, rows, sums| {
        let count = rows.len() + SIDE - 1;
        let high = rows_of(high, rows.start, count);
        let bands: Vec<_> = (same.iter())
            .map(|b| rows_of(&bands[*b], rows.start, count))
            .collect();
        for (b, value) in same.iter().zip(with_each(&high, &bands)) {
            sums[*b] = value;
        }
        for (b, sources) in smaller.chunks(LARGE).zip(enlargements.chunks(LARGE)) {
            enlarged.resize(sources.len() * count * width, 0.0);
            for (source, out) in sources.iter().zip(enlarged.chunks_exact_mut(count * width)) {
                source.write(rows.start, out);
            }
            let bands: Vec<Vec<&[f64]>> = (enlarged.chunks_exact(count * width))
                .map(|rows| rows.chunks_exact(width).collect())
                .collect();
            for (b, value) in b.iter().zip(with_each(&high, &bands)) {
                sums[*b] = value;
            }
        }
    })
}

/// CS of the pairs (1,2), (1,3), .., (5,6) of six maps of one size, at least 11 x 11.
pub fn among(maps: [&Plane<f64>; MAPS]) -> [f64; PAIRS] {
    let values = over_windows(maps[0].size(), PAIRS, |_, rows, sums| {
        let samples = maps.map(|map| rows_of(map, rows.start, rows.len() + SIDE - 1));
        sums.copy_from_slice(&all_pairs(&samples));
    });
    std::array::from_fn(|p| values[p])
}

/// Means over all windows of `count` sums; `fill` is given memory that a thread uses again and again, and writes the sums of
/// some rows of windows.
fn over_windows(
    (width, height): (usize, usize),
    count: usize,
    fill: impl Fn(&mut Vec<f64>, std::ops::Range<usize>, &mut [f64]) + Sync,
) -> Vec<f64> {
    let (width, height) = (width - (SIDE - 1), height - (SIDE - 1));
    let starts: Vec<usize> = (0..height).step_by(ROWS).collect();
    let blocks: Vec<Vec<f64>> = starts
        .par_iter()
        .map_init(Vec::new, |room, &from| {
            let mut sums = vec![0.0; count];
            fill(room, from..height.min(from + ROWS), &mut sums);
            sums
        })
        .collect();
    let total = (0..count).map(|i| blocks.iter().map(|b| b[i]).sum::<f64>());
    total.map(|sum| sum / (width * height) as f64).collect()
}

fn rows_of(map: &Plane<f64>, top: usize, count: usize) -> Vec<&[f64]> {
    (top..top + count).map(|y| map.row(y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::plain;

    fn maps(width: usize, height: usize) -> Vec<Plane<f64>> {
        (0..6)
            .map(|m| {
                Plane::from_fn(width, height, |x, y| {
                    ((x * (7 + m) + y * y * 13 + m * x * y) % 31) as f64 - 15.0
                })
            })
            .collect()
    }

    /// Both ways give the plain sums over whole windows, for widths with every kind of remainder and one or several tiles.
    #[test]
    fn separable_windows_are_the_plain_ones() {
        for width in [11, 12, 25, 41, 43, 58, 137, 138, 139, 140, 257, 276] {
            let maps = maps(width, 55 - width % 30);
            let fast = among(std::array::from_fn(|m| &maps[m]));
            let with_first = with_high(&maps[0], &maps[1..]);
            let pairs = (0..6).flat_map(|a| (a + 1..6).map(move |b| (a, b)));
            for (p, (a, b)) in pairs.enumerate() {
                let slow = plain::contrast_structure(&maps[a], &maps[b]);
                assert!(
                    (fast[p] - slow).abs() < 1e-13,
                    "{width}: {} {slow}",
                    fast[p]
                );
                if a == 0 {
                    let one = with_first[b - 1];
                    assert!((one - slow).abs() < 1e-13, "{width}: {one} {slow}");
                }
            }
        }
    }

    /// Smaller maps are enlarged before they are compared.
    #[test]
    fn smaller_maps_are_enlarged() {
        let maps = maps(60, 47);
        let small = Plane::from_fn(30, 24, |x, y| ((x * 5 + y * 3) % 17) as f64);
        let line = |length: usize, n: usize| Enlargement {
            length,
            ratio: length as f64 / n as f64,
        };
        let large = plain::enlarged(&small, line(60, 30), line(47, 24));
        let slow = plain::contrast_structure(&maps[0], &large);
        let fast = with_high(&maps[0], &[small])[0];
        assert!((fast - slow).abs() < 1e-13, "{fast} {slow}");
    }
}
