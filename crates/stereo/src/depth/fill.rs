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

/// For each pixel that is not seen by both, in the order of the pixels: what comes from the four directions before it; and, in the opposite
/// order, from those after it.
fn carried(map: &Plane<f32>, seen: &Plane<Seen>, left: &Gray) -> [Vec<[Carried; 4]>; 2] {
    let scene = Scene { map, seen, left };
    let (down, up) = rayon::join(|| pass::<false>(&scene), || pass::<true>(&scene));
    [down, up]
}

struct Scene<'a> {
    map: &'a Plane<f32>,
    seen: &'a Plane<Seen>,
    left: &'a Gray,
}

/// From the top left to the bottom right (or the other way with `UP`): what comes along the row and from the three pixels before it in
/// the last row, for each pixel that is not seen by both, in the order of the way.
fn pass<const UP: bool>(scene: &Scene<'_>) -> Vec<[Carried; 4]> {
    let (width, height) = scene.map.size();
    let mut out = Vec::new();
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
    let of_pixel = |seen: Seen, around: &Around| {
        let (d, least) = match seen {
            // What hides a place is often nearer than what it belongs to: here the way counts for less.
            Seen::Occluded => {
                let d = quantile(around, &around.weights, HIDDEN_SHARE);
                (d, LEAST_SUPPORT[0])
            }
            _ => {
                let squares = around.weights.map(|w| w * w);
                (quantile(around, &squares, 0.5), LEAST_SUPPORT[1])
            }
        };
        let keep = match fill {
            Fill::None => false,
            Fill::Likely => support(around, d) >= least,
            Fill::All => true,
        };
        (d, keep)
    };
    let gaps: Vec<u32> = (0u32..)
        .zip(seen.samples())
        .filter(|(_, seen)| **seen != Seen::Both)
        .map(|(i, _)| i)
        .collect();
    let [down, up] = carried(raw, seen, left);
    let both = down.par_iter().zip(up.par_iter().rev());
    let filled: Vec<(f32, bool)> = (gaps.par_iter().zip(both))
        .map(|(&i, (d, u))| of_pixel(seen.samples()[i as usize], &Around::new(d, u)))
        .collect();
    let mut map = raw.clone();
    for (&i, (d, _)) in gaps.iter().zip(&filled) {
        map.samples_mut()[i as usize] = *d;
    }
    // The median sees what is filled even where it is not wanted, so that it is the same whatever is wanted.
    let mut map = median(&map);
    for (&i, (_, keep)) in gaps.iter().zip(&filled) {
        if !keep {
            map.samples_mut()[i as usize] = f32::NAN;
        }
    }
    map
}

/// What comes from eight directions: disparities, and weights, the inverse ways to them; 0 where nothing comes.
struct Around {
    disparities: [f32; 8],
    weights: [f32; 8],
}

impl Around {
    #[inline(always)]
    fn new(down: &[Carried; 4], up: &[Carried; 4]) -> Self {
        let all = [
            down[0], down[1], down[2], down[3], up[0], up[1], up[2], up[3],
        ];
        Self {
            disparities: all.map(|c| c.disparity),
            weights: all.map(|c| 1.0 / (1.0 + c.way)),
        }
    }
}

/// The disparity that `share` of the weight lies below; NaN when nothing came.
fn quantile(around: &Around, weights: &[f32; 8], share: f32) -> f32 {
    // The order of `f32::total_cmp`: NaN comes last; its weight is 0.
    let keys = around.disparities.map(|d| {
        let bits = d.to_bits() as i32;
        bits ^ ((bits >> 31) as u32 >> 1) as i32
    });
    // How many lie below each, of equal ones those before it: no branch, all eight at once.
    let mut ranks = [0u32; 8];
    for (j, &other) in keys.iter().enumerate() {
        for (i, rank) in ranks.iter_mut().enumerate() {
            *rank += u32::from(if j < i {
                other <= keys[i]
            } else {
                other < keys[i]
            });
        }
    }
    let mut sorted = [(0.0, 0.0); 8];
    for i in 0..8 {
        sorted[ranks[i] as usize & 7] = (around.disparities[i], weights[i]);
    }
    let wanted = share * sorted.iter().map(|(_, weight)| weight).sum::<f32>();
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
fn support(around: &Around, d: f32) -> f32 {
    let all: f32 = around.weights.iter().sum();
    let pairs = around.disparities.iter().zip(&around.weights);
    let same = pairs.filter(|(other, _)| (**other - d).abs() <= AGREE_PX);
    same.map(|(_, weight)| weight).sum::<f32>() / all.max(f32::MIN_POSITIVE)
}

/// The median of 3 x 3 pixels; edges repeat.
fn median(map: &Plane<f32>) -> Plane<f32> {
    let (width, height) = map.size();
    let mut out = map.clone();
    let rows = out.samples_mut().par_chunks_mut(width).enumerate();
    rows.for_each(|(y, out)| {
        let row = |y: usize| {
            let row = map.row(y);
            let mut padded = Vec::with_capacity(width + 2);
            padded.push(row[0]);
            padded.extend_from_slice(row);
            padded.push(row[width - 1]);
            padded
        };
        let rows = [
            row(y.saturating_sub(1)),
            row(y),
            row((y + 1).min(height - 1)),
        ];
        median_row(&rows[0], &rows[1], &rows[2], out);
    });
    out
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
