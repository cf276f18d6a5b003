//! The contrast-structure factor of SSIM (Wang, Bovik, Sheikh and Simoncelli 2004) between maps of one size.
//!
//! CS = mean over all windows inside of (2 σ_ab + C2) / (σ_a² + σ_b² + C2), moments weighted by an 11 x 11 Gaussian of
//! σ = 1.5. The window is separable: columns first, straight from the samples, then rows of the moments. All maps are
//! taken together, a few rows at a time, so that each sample comes from memory once and nothing but those rows is kept.

use rayon::prelude::*;
use vergence_imaging::Plane;

use super::enlarge::{EnlargedRows, Enlargement};
use super::plain;
use super::windows::{Known, SIDE, all_pairs, moments, with_known};

/// Rows of windows done together; sums are over these, then over all, so that threads change nothing.
const ROWS: usize = 16;

/// Maps compared with each other.
pub(crate) const MAPS: usize = 6;

/// Pairs of those.
pub const PAIRS: usize = 15;

/// CS of each of `bands` with `high`; smaller bands are enlarged to its size first.
///
/// # Panics
/// When `high` is smaller than 42 x 11 samples.
pub fn with_high(high: &Plane<f64>, bands: &[Plane<f64>]) -> Vec<f64> {
    let (width, height) = high.size();
    let sources: Vec<Source> = bands
        .iter()
        .map(|band| Source::new(band, (width, height)))
        .collect();
    over_windows((width, height), bands.len(), |room, rows, sums| {
        let count = rows.len();
        let windows = width - (SIDE - 1);
        let [columns, mean, variance, enlarged] = room;
        mean.resize(count * windows, 0.0);
        variance.resize(count * windows, 0.0);
        let samples = rows_of(high, rows.start, count + SIDE - 1);
        moments(&samples, columns, mean, variance);
        let known = Known {
            samples: &samples,
            mean,
            variance,
        };
        for (source, sum) in sources.iter().zip(sums) {
            *sum += match source {
                Source::Same(band) => {
                    let band = rows_of(band, rows.start, count + SIDE - 1);
                    with_known(&known, &band, columns)
                }
                Source::Enlarged(band) => {
                    enlarged.resize((count + SIDE - 1) * width, 0.0);
                    band.write(rows.start, enlarged);
                    let band: Vec<&[f64]> = enlarged.chunks_exact(width).collect();
                    with_known(&known, &band, columns)
                }
            };
        }
    })
}

enum Source<'a> {
    Same(&'a Plane<f64>),
    Enlarged(EnlargedRows<'a>),
}

impl<'a> Source<'a> {
    fn new(band: &'a Plane<f64>, (width, height): (usize, usize)) -> Self {
        if band.size() == (width, height) {
            return Source::Same(band);
        }
        let line = |length: usize, n: usize| Enlargement {
            length,
            ratio: length as f64 / n as f64,
        };
        let (across, down) = (line(width, band.width()), line(height, band.height()));
        Source::Enlarged(EnlargedRows::new(band, across, down))
    }
}

/// CS of the pairs (1,2), (1,3), .., (5,6) of six maps of one size, at least 11 x 11.
pub fn among(maps: [&Plane<f64>; MAPS]) -> [f64; PAIRS] {
    let (width, height) = maps[0].size();
    if width < super::windows::MIN_WIDTH {
        return among_narrow(maps);
    }
    let values = over_windows((width, height), PAIRS, |[columns, ..], rows, sums| {
        let samples = maps.map(|map| rows_of(map, rows.start, rows.len() + SIDE - 1));
        for (sum, value) in sums.iter_mut().zip(all_pairs(&samples, columns)) {
            *sum += value;
        }
    });
    std::array::from_fn(|p| values[p])
}

/// [`among`] of maps with few windows in a row: on their side where that is longer, else one by one.
fn among_narrow(maps: [&Plane<f64>; MAPS]) -> [f64; PAIRS] {
    let (width, height) = maps[0].size();
    if height >= super::windows::MIN_WIDTH {
        let turned = maps.map(|map| Plane::from_fn(height, width, |x, y| map.at(y, x)));
        return among(turned.each_ref());
    }
    let mut values = [0.0; PAIRS];
    let pairs = (0..MAPS).flat_map(|a| (a + 1..MAPS).map(move |b| (a, b)));
    for (value, (a, b)) in values.iter_mut().zip(pairs) {
        *value = plain::contrast_structure(maps[a], maps[b]);
    }
    values
}

/// Memory that one thread uses again and again.
type Room = [Vec<f64>; 4];

/// Means over all windows of `count` sums, to which `add` adds what some rows of windows give.
fn over_windows(
    (width, height): (usize, usize),
    count: usize,
    add: impl Fn(&mut Room, std::ops::Range<usize>, &mut [f64]) + Sync,
) -> Vec<f64> {
    let (width, height) = (width - (SIDE - 1), height - (SIDE - 1));
    let starts: Vec<usize> = (0..height).step_by(ROWS).collect();
    let blocks: Vec<Vec<f64>> = starts
        .par_iter()
        .map_init(Room::default, |room, &from| {
            let mut sums = vec![0.0; count];
            add(room, from..height.min(from + ROWS), &mut sums);
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
        for width in [11, 25, 41, 42, 43, 57, 73, 74, 75, 255, 256, 257, 270] {
            let maps = maps(width, 55 - width % 30);
            let fast = among(std::array::from_fn(|m| &maps[m]));
            let with_first = (width >= 42).then(|| with_high(&maps[0], &maps[1..]));
            let pairs = (0..6).flat_map(|a| (a + 1..6).map(move |b| (a, b)));
            for (p, (a, b)) in pairs.enumerate() {
                let slow = plain::contrast_structure(&maps[a], &maps[b]);
                assert!(
                    (fast[p] - slow).abs() < 1e-13,
                    "{width}: {} {slow}",
                    fast[p]
                );
                if let (0, Some(values)) = (a, &with_first) {
                    let one = values[b - 1];
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
