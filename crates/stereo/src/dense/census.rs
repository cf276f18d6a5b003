//! Census words of 9 x 7 pixels and the volume of their Hamming distances.

use rayon::prelude::*;
use vergence_imaging::{Gray, Plane};

/// Half width and half height of the window: 62 neighbours.
const HALF: [isize; 2] = [4, 3];

/// Cost of a disparity that leads out of the other picture: what two unrelated words have less a little, so that the border
/// follows its neighbours.
pub(super) const OUTSIDE: u8 = 26;

/// One bit for each neighbour that is darker than the middle; the border repeats the picture's edge.
pub(crate) fn census(picture: &Gray) -> Plane<u64> {
    let (width, height) = picture.size();
    let mut words = vec![0u64; width * height];
    words
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, out)| {
            for dy in -HALF[1]..=HALF[1] {
                let row = picture.row((y as isize + dy).clamp(0, height as isize - 1) as usize);
                for dx in -HALF[0]..=HALF[0] {
                    if (dx, dy) == (0, 0) {
                        continue;
                    }
                    add_bit(out, picture.row(y), row, dx);
                }
            }
        });
    Plane::from_samples(width, height, words)
}

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
/// Shift each word left and put the comparison with the neighbour `dx` to the right into its lowest bit.
fn add_bit(words: &mut [u64], middle: &[u8], row: &[u8], dx: isize) {
    let width = words.len();
    let inner_from = dx.unsigned_abs().min(width);
    let inner_to = width - inner_from;
    let bit = |x: usize| {
        let at = (x as isize + dx).clamp(0, width as isize - 1) as usize;
        u64::from(row[at] < middle[x])
    };
    for x in (0..inner_from).chain(inner_to.max(inner_from)..width) {
        words[x] = words[x] << 1 | bit(x);
    }
    if inner_to > inner_from {
        let from = (inner_from as isize + dx) as usize;
        let near = &row[from..from + inner_to - inner_from];
        let inner = words[inner_from..inner_to].iter_mut();
        for ((word, &m), &n) in inner.zip(&middle[inner_from..inner_to]).zip(near) {
            *word = *word << 1 | u64::from(n < m);
        }
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
