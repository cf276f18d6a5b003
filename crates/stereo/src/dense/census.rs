//! Census words of 9 x 7 pixels and the volume of their Hamming distances.

use rayon::prelude::*;
use vergence_imaging::{Gray, Plane};

/// Half width and half height of the window: 62 neighbours.
const HALF: [isize; 2] = [4, 3];

/// Cost of a disparity that leads out of the other picture: what two unrelated words have less a little, so that the border
/// follows its neighbours.
pub(super) const OUTSIDE: u8 = 26;

/// So many words are made at a time, which registers hold while all neighbours are looked at.
const WORDS: usize = 32;

/// One bit for each neighbour that is darker than the middle, row by row; the border repeats the picture's edge.
pub(crate) fn census(picture: &Gray) -> Plane<u64> {
    let (width, height) = picture.size();
    let mut words = vec![0u64; width * height];
    // Rows with their edges repeated, so that no neighbour is outside.
    let beside = HALF[0] as usize;
    let wide = width.next_multiple_of(WORDS) + 2 * beside;
    let mut padded = Gray::filled(wide, height, 0);
    for y in 0..height {
        let (row, out) = (picture.row(y), padded.row_mut(y));
        out[..beside].fill(row[0]);
        out[beside..beside + width].copy_from_slice(row);
        out[beside + width..].fill(row[width - 1]);
    }
    let rows = words.par_chunks_mut(width).enumerate();
    rows.for_each(|(y, out)| {
        let around: [&[u8]; ROWS] = std::array::from_fn(|i| {
            let row = y as isize + i as isize - HALF[1];
            padded.row(row.clamp(0, height as isize - 1) as usize)
        });
        words_of_row(&around, out);
    });
    Plane::from_samples(width, height, words)
}

/// Neighbours in the window.
const NEIGHBOURS: usize = ((2 * HALF[0] + 1) * (2 * HALF[1] + 1) - 1) as usize;

/// Rows of the window.
const ROWS: usize = 2 * HALF[1] as usize + 1;

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn words_of_row(around: &[&[u8]; ROWS], out: &mut [u64]) {
    let [beside, above] = HALF.map(|half| half as usize);
    for (i, out) in out.chunks_mut(WORDS).enumerate() {
        let at = |row: usize, dx: usize| -> [u8; WORDS] {
            let from = i * WORDS + dx;
            std::array::from_fn(|k| around[row][from..from + WORDS][k])
        };
        let middle = at(above, beside);
        // Eight neighbours (six at first) fill a byte of each word: the bytes take one register where the words take eight (AVX2) or four (AVX-512).
        let mut words = [0u64; WORDS];
        let mut bits = [0u8; WORDS];
        let mut count = 0;
        for row in 0..ROWS {
            for dx in 0..=2 * beside {
                if (row, dx) == (above, beside) {
                    continue;
                }
                let near = at(row, dx);
                for k in 0..WORDS {
                    bits[k] = bits[k] << 1 | u8::from(near[k] < middle[k]);
                }
                count += 1;
                if count % 8 == NEIGHBOURS % 8 {
                    for k in 0..WORDS {
                        words[k] = words[k] << 8 | u64::from(bits[k]);
                    }
                    bits = [0; WORDS];
                }
            }
        }
        out.copy_from_slice(&words[..out.len()]);
    }
}

/// Costs of all disparities at all left pixels.
pub(super) struct CostVolume {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Disparity of index 0, map px.
    pub(super) first: i32,
    /// Disparities per pixel: a multiple of 16, so that inner loops are whole vectors.
    pub(super) count: usize,
    /// `costs[(y * width + x) * count + k]`: Hamming distance of left (x, y) and right (x - first - k, y).
    pub(super) costs: Vec<u8>,
}

impl CostVolume {
    /// Of two pictures of one size; at least `wanted` disparities from `first` on.
    pub(super) fn new(left: &Gray, right: &Gray, first: i32, wanted: usize) -> Self {
        let (width, height) = left.size();
        let count = wanted.next_multiple_of(16);
        let (left, right) = rayon::join(|| census(left), || census(right));
        let mut costs = vec![OUTSIDE; width * height * count];
        let rows = costs.par_chunks_mut(width * count).enumerate();
        rows.for_each(|(y, out)| row_costs(left.row(y), right.row(y), first, count, out));
        Self {
            width,
            height,
            first,
            count,
            costs,
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512vpopcntdq+popcnt",
    "x86_64+avx2+popcnt",
    "x86_64+popcnt"
))]
fn row_costs(left: &[u64], right: &[u64], first: i32, count: usize, out: &mut [u8]) {
    let width = left.len() as i64;
    // Right words in reverse, so that growing disparity runs forward.
    let reversed: Vec<u64> = right.iter().rev().copied().collect();
    for (x, (&word, out)) in left.iter().zip(out.chunks_exact_mut(count)).enumerate() {
        // Index k looks at right column x - first - k, i.e. reversed place width - 1 - x + first + k.
        let start = width - 1 - x as i64 + i64::from(first);
        let from = (-start).clamp(0, count as i64);
        let to = (width - start).clamp(from, count as i64);
        if from == to {
            continue;
        }
        let words = &reversed[(start + from) as usize..(start + to) as usize];
        for (o, &other) in out[from as usize..to as usize].iter_mut().zip(words) {
            *o = (word ^ other).count_ones() as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words are those of the definition, also where the window leaves the picture and in pictures smaller than it.
    #[test]
    fn words_are_those_of_the_definition() {
        for (width, height) in [(37, 11), (16, 4), (5, 3), (1, 1)] {
            let picture = Gray::from_fn(width, height, |x, y| {
                ((x * 71 + y * 113 + x * y) % 64) as u8
            });
            let words = census(&picture);
            for y in 0..height {
                for x in 0..width {
                    let mut word = 0u64;
                    for dy in -HALF[1]..=HALF[1] {
                        for dx in -HALF[0]..=HALF[0] {
                            let place = |v: usize, d: isize, side: usize| {
                                (v as isize + d).clamp(0, side as isize - 1) as usize
                            };
                            let near = picture.at(place(x, dx, width), place(y, dy, height));
                            if (dx, dy) != (0, 0) {
                                word = word << 1 | u64::from(near < picture.at(x, y));
                            }
                        }
                    }
                    assert_eq!(words.at(x, y), word, "{width} x {height}: {x} {y}");
                }
            }
        }
    }
}
