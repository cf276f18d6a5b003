//! Disparities where the eyes do not agree, from the nearest ones where they do in eight directions (Hirschmüller 2008, section 2.6).

use rayon::prelude::*;
use vergence_imaging::{Gray, Plane};

use crate::dense::Seen;

/// The nearest known disparity on the way, and how far it is: steps in pixels plus weighed changes of grey.
#[derive(Clone, Copy)]
struct Carried {
    disparity: f32,
    way: f32,
}

const NOTHING: Carried = Carried {
    disparity: f32::NAN,
    way: f32::INFINITY,
};

/// For each of the `gaps` pixels that are not seen by both, in the order of the pixels: what comes from the four directions before it; and, in the opposite
/// order, from those after it.
fn carried(
    map: &Plane<f32>,
    seen: &Plane<Seen>,
    left: &Gray,
    gaps: usize,
) -> [Vec<[Carried; 4]>; 2] {
    let scene = Scene { map, seen, left };
    let (down, up) = rayon::join(
        || pass::<false>(&scene, gaps),
        || pass::<true>(&scene, gaps),
    );
    [down, up]
}

struct Scene<'a> {
    map: &'a Plane<f32>,
    seen: &'a Plane<Seen>,
    left: &'a Gray,
}

/// From the top left to the bottom right (or the other way with `UP`): what comes along the row and from the three pixels before it in
/// the last row, for each pixel that is not seen by both, in the order of the way.
fn pass<const UP: bool>(scene: &Scene<'_>, gaps: usize) -> Vec<[Carried; 4]> {
    let (width, height) = scene.map.size();
    let mut out = Vec::with_capacity(gaps);
    // A pixel more on each side, from which nothing comes.
    let mut last = vec![[NOTHING; 3]; width + 2];
    let mut this = last.clone();
    let diagonal = std::f32::consts::SQRT_2;
    for step_y in 0..height {
        let y = if UP { height - 1 - step_y } else { step_y };
        let (grays, seen, map) = (scene.left.row(y), scene.seen.row(y), scene.map.row(y));
        let row_before = match UP {
            true => (y + 1).min(height - 1),
            false => y.saturating_sub(1),
        };
        let grays_before = scene.left.row(row_before);
        let mut along = NOTHING;
        for step_x in 0..width {
            let x = if UP { width - 1 - step_x } else { step_x };
            if seen[x] == Seen::Both {
                let here = Carried {
                    disparity: map[x],
                    way: 0.0,
                };
                along = here;
                this[x + 1] = [here; 3];
                continue;
            }
            let gray = f32::from(grays[x]);
            let on = |c: Carried, other: u8, steps: f32| Carried {
                disparity: c.disparity,
                way: c.way + steps + PIXELS_PER_GREY * (f32::from(other) - gray).abs(),
            };
            // In padded columns; where there is no pixel nothing comes, whatever its grey.
            let (behind, ahead) = if UP { (x + 2, x) } else { (x, x + 2) };
            let gray_at = |padded: usize| grays_before[padded.saturating_sub(1).min(width - 1)];
            let beside = grays[behind.saturating_sub(1).min(width - 1)];
            along = on(along, beside, 1.0);
            let a = on(last[behind][0], gray_at(behind), diagonal);
            let b = on(last[x + 1][1], gray_at(x + 1), 1.0);
            let c = on(last[ahead][2], gray_at(ahead), diagonal);
            this[x + 1] = [a, b, c];
            out.push([along, a, b, c]);
        }
        std::mem::swap(&mut last, &mut this);
    }
    out
}

/// Which pixels that the eyes do not agree on get a disparity from around.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fill {
    /// None: they stay unknown.
    None,
    /// Those where what is around agrees well enough; where it contradicts itself they stay unknown.
    Likely,
    /// All.
    All,
}

/// A step of one level of grey on the way to a disparity counts as so many pixels.
const PIXELS_PER_GREY: f32 = 0.5;

/// Hidden places take the disparity that this share of the weight lies below: what hides them is nearer, what they belong to is not.
const HIDDEN_SHARE: f32 = 0.1;

/// Disparities from around agree within this, px.
const AGREE_PX: f32 = 3.0;

/// Least share of the weight that must agree with a disparity for it to be likely, at hidden and at other places. The surroundings of hidden
/// places disagree by nature. Less fills more and errs more.
const LEAST_SUPPORT: [f32; 2] = [0.5, 0.7];

/// The map with its gaps filled by quantiles of what is around, weighed by the inverse way to it (hidden places) or its square; then a median
/// over 3 x 3 pixels, of what is known.
pub(super) fn filled(raw: &Plane<f32>, seen: &Plane<Seen>, left: &Gray, fill: Fill) -> Plane<f32> {
    let (width, height) = raw.size();
    let gaps: Vec<u32> = (0u32..)
        .zip(seen.samples())
        .filter(|(_, seen)| **seen != Seen::Both)
        .map(|(i, _)| i)
        .collect();
    let [down, up] = carried(raw, seen, left, gaps.len());
    let mut filled = vec![(0.0, false); gaps.len()];
    let parts = filled.par_chunks_mut(GAPS).zip(gaps.par_chunks(GAPS));
    parts.enumerate().for_each(|(i, (out, gaps))| {
        let from = i * GAPS;
        let down = &down[from..from + gaps.len()];
        // The first gap is the last one on the way up.
        let up = &up[up.len() - from - gaps.len()..up.len() - from];
        fill_gaps(gaps, [down, up], seen.samples(), fill, out);
    });
    drop([down, up]);
    let gaps_of_row = |y: usize| {
        let before = |y: usize| gaps.partition_point(|&i| (i as usize) < y * width);
        before(y)..before(y + 1)
    };
    let mut map = Plane::filled(width, height, 0.0);
    let rows = map.samples_mut().par_chunks_mut(width).enumerate();
    rows.for_each(|(y, out)| {
        out.copy_from_slice(raw.row(y));
        for i in gaps_of_row(y) {
            out[gaps[i] as usize % width] = filled[i].0;
        }
    });
    // The median sees what is filled even where it is not wanted, so that it is the same whatever is wanted.
    let mut out = Plane::filled(width, height, 0.0);
    let rows = out.samples_mut().par_chunks_mut(width).enumerate();
    rows.for_each_init(Padded::default, |padded, (y, out)| {
        median(&map, y, padded, out);
        for i in gaps_of_row(y) {
            if !filled[i].1 {
                out[gaps[i] as usize % width] = f32::NAN;
            }
        }
    });
    out
}

/// So many gaps are filled at a time.
const GAPS: usize = 1024;

/// What fills gaps, and whether it is wanted; of what comes from below the last is that of the first gap.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn fill_gaps(
    gaps: &[u32],
    [down, up]: [&[[Carried; 4]]; 2],
    seen: &[Seen],
    fill: Fill,
    out: &mut [(f32, bool)],
) {
    let around = down.iter().zip(up.iter().rev());
    for ((out, &gap), (down, up)) in out.iter_mut().zip(gaps).zip(around) {
        let around = Around::new(down, up);
        let (d, least) = match seen[gap as usize] {
            // What hides a place is often nearer than what it belongs to: here the way counts for less.
            Seen::Occluded => {
                let d = quantile(&around, &around.weights, HIDDEN_SHARE);
                (d, LEAST_SUPPORT[0])
            }
            _ => {
                let mut squares = around.weights;
                for w in &mut squares {
                    *w *= *w;
                }
                (quantile(&around, &squares, 0.5), LEAST_SUPPORT[1])
            }
        };
        let keep = match fill {
            Fill::None => false,
            Fill::Likely => support(&around, d) >= least,
            Fill::All => true,
        };
        *out = (d, keep);
    }
}

/// What comes from eight directions: disparities, and weights, the inverse ways to them; 0 where nothing comes.
struct Around {
    disparities: [f32; 8],
    weights: [f32; 8],
}

impl Around {
    #[inline(always)]
    fn new(down: &[Carried; 4], up: &[Carried; 4]) -> Self {
        // Loops, not closures: what calls those is compiled without the vectors of the caller.
        let (mut disparities, mut weights) = ([0.0; 8], [0.0; 8]);
        for i in 0..4 {
            disparities[i] = down[i].disparity;
            disparities[i + 4] = up[i].disparity;
            weights[i] = 1.0 / (1.0 + down[i].way);
            weights[i + 4] = 1.0 / (1.0 + up[i].way);
        }
        Self {
            disparities,
            weights,
        }
    }
}

/// The disparity that `share` of the weight lies below; NaN when nothing came.
#[inline(always)]
fn quantile(around: &Around, weights: &[f32; 8], share: f32) -> f32 {
    // The order of `f32::total_cmp`: NaN comes last; its weight is 0.
    let mut keys = [0; 8];
    for i in 0..8 {
        let bits = around.disparities[i].to_bits() as i32;
        keys[i] = bits ^ ((bits >> 31) as u32 >> 1) as i32;
    }
    // How many lie below each, of equal ones those before it: no branch, all eight at once.
    let mut ranks = [0u32; 8];
    for j in 0..8 {
        for i in 0..8 {
            let below = (keys[j] < keys[i]) | ((keys[j] == keys[i]) & (j < i));
            ranks[i] += u32::from(below);
        }
    }
    let mut sorted = [(0.0, 0.0); 8];
    for i in 0..8 {
        sorted[ranks[i] as usize & 7] = (around.disparities[i], weights[i]);
    }
    // As a sum of an iterator starts.
    let mut all = -0.0;
    for (_, weight) in sorted {
        all += weight;
    }
    let wanted = share * all;
    let mut so_far = 0.0;
    for (disparity, weight) in sorted {
        so_far += weight;
        if so_far >= wanted {
            return disparity;
        }
    }
    sorted[0].0
}

/// Share of what is around that agrees with `d`, weighed by the inverse way, 0 to 1.
#[inline(always)]
fn support(around: &Around, d: f32) -> f32 {
    let (mut all, mut same) = (0.0f32, 0.0);
    for i in 0..8 {
        all += around.weights[i];
        let agrees = (around.disparities[i] - d).abs() <= AGREE_PX;
        same += if agrees { around.weights[i] } else { 0.0 };
    }
    same / all.max(f32::MIN_POSITIVE)
}

/// Three rows with a pixel more on each side.
type Padded = [Vec<f32>; 3];

/// The medians of 3 x 3 pixels of row `y`; edges repeat.
fn median(map: &Plane<f32>, y: usize, padded: &mut Padded, out: &mut [f32]) {
    let (width, height) = map.size();
    let rows = [y.saturating_sub(1), y, (y + 1).min(height - 1)];
    for (padded, y) in padded.iter_mut().zip(rows) {
        let row = map.row(y);
        padded.clear();
        padded.push(row[0]);
        padded.extend_from_slice(row);
        padded.push(row[width - 1]);
    }
    median_row(&padded[0], &padded[1], &padded[2], out);
}

/// Medians by sorted columns; the rows have a pixel more on each side. NaN loses against every number.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn median_row(above: &[f32], here: &[f32], below: &[f32], out: &mut [f32]) {
    let width = out.len();
    let (above, here, below) = (&above[..width + 2], &here[..width + 2], &below[..width + 2]);
    for x in 0..width {
        // Each column in order, then each rank across the columns: the median is the middle of the three that remain.
        let sorted = |a: f32, b: f32, c: f32| {
            let (low, high) = (a.min(b), a.max(b));
            (low.min(c), low.max(high.min(c)), high.max(c))
        };
        let (a0, a1, a2) = sorted(above[x], here[x], below[x]);
        let (b0, b1, b2) = sorted(above[x + 1], here[x + 1], below[x + 1]);
        let (c0, c1, c2) = sorted(above[x + 2], here[x + 2], below[x + 2]);
        let largest_low = a0.max(b0).max(c0);
        let (_, middle, _) = sorted(a1, b1, c1);
        let least_high = a2.min(b2).min(c2);
        let (_, median, _) = sorted(largest_low, middle, least_high);
        out[x] = median;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The quantile by its definition: sorted by the disparity, equal ones in their order, then added up.
    fn plain(around: &Around, weights: &[f32; 8], share: f32) -> f32 {
        let mut pairs: Vec<(f32, f32)> = (around
            .disparities
            .iter()
            .copied()
            .zip(weights.iter().copied()))
        .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let wanted = share * pairs.iter().map(|p| p.1).sum::<f32>();
        let mut so_far = 0.0;
        for (d, weight) in &pairs {
            so_far += weight;
            if so_far >= wanted {
                return *d;
            }
        }
        pairs[0].0
    }

    /// Ranks counted without branches give, bit for bit, the quantile of the definition: with equal disparities, both signs, zeros of both
    /// signs, and directions from which nothing comes.
    #[test]
    fn quantiles_are_those_of_the_definition() {
        let mut state = 1u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as u32
        };
        let mut nothing = 0;
        for _ in 0..4000 {
            let mut carried = || match next() % 6 {
                0 => NOTHING,
                1 => Carried {
                    disparity: -0.0,
                    way: (next() % 50) as f32,
                },
                _ => Carried {
                    disparity: (next() % 9) as f32 - 4.0,
                    way: (next() % 50) as f32,
                },
            };
            let [down, up]: [[Carried; 4]; 2] =
                std::array::from_fn(|_| std::array::from_fn(|_| carried()));
            let around = Around::new(&down, &up);
            for share in [HIDDEN_SHARE, 0.5] {
                let found = quantile(&around, &around.weights, share);
                let expected = plain(&around, &around.weights, share);
                assert_eq!(found.to_bits(), expected.to_bits());
            }
            nothing += usize::from(around.weights.contains(&0.0));
        }
        assert!(nothing > 1000, "{nothing}");
    }
}
