//! Which matches agree: with their neighbours, and with one geometry of the whole pair.

use crate::faults::alignment::model::{
    BASE_ROLL, OFFSET, Place, ROLL, Terms, ZOOM, basis, residual,
};
use nalgebra::{Matrix4, Vector4};

/// Neighbours that are asked.
const NEIGHBOURS: usize = 8;

/// How many of them must agree.
const SUPPORT: usize = 2;

/// Tries of the sampling: with half of the matches right, four right ones come together once in 16 tries.
const TRIES: usize = 400;

/// The four numbers that are sampled; keystone and lens are fitted later.
const SAMPLED: [usize; 4] = [OFFSET, ROLL, ZOOM, BASE_ROLL];

/// By how much neighbours may differ.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    /// Half widths.
    pub(super) constant: f64,
    /// Part of their distance, along the rows (depth that slopes) and down the columns.
    pub(super) slope: [f64; 2],
}

/// For each match whether at least [`SUPPORT`] of its nearest neighbours have about the same displacement.
pub(super) fn supported(places: &[Place], tolerance: Tolerance) -> Vec<bool> {
    let displacement = |p: &Place| [p.left[0] - p.right[0], p.left[1] - p.right[1]];
    let mut nearest = Nearest::default();
    (0..places.len())
        .map(|i| {
            let here = displacement(&places[i]);
            let agree = nearest.of(places, i).iter().filter(|&&(square, j)| {
                let there = displacement(&places[j]);
                let reach = square.sqrt();
                (0..2).all(|k| {
                    (here[k] - there[k]).abs() <= tolerance.constant + tolerance.slope[k] * reach
                })
            });
            agree.count() >= SUPPORT
        })
        .collect()
}

/// The nearest neighbours of a match in the left picture.
#[derive(Default)]
struct Nearest {
    list: Vec<(f64, usize)>,
}

impl Nearest {
    /// (square of the distance, place), at most [`NEIGHBOURS`] of them.
    fn of(&mut self, places: &[Place], i: usize) -> &[(f64, usize)] {
        let here = places[i].left;
        self.list.clear();
        let others = places.iter().enumerate().filter(|&(j, _)| j != i);
        self.list.extend(others.map(|(j, other)| {
            let (dx, dy) = (here[0] - other.left[0], here[1] - other.left[1]);
            (dx * dx + dy * dy, j)
        }));
        let count = NEIGHBOURS.min(self.list.len());
        if count > 0 {
            self.list
                .select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0));
        }
        &self.list[..count]
    }
}

/// The geometry that most matches agree with to `tolerance` half widths, and which do: random samples of four (Fischler & Bolles
/// 1981), from a fixed seed.
pub(super) fn consensus(places: &[Place], tolerance: f64) -> Option<(Terms, Vec<bool>)> {
    let mut random = SplitMix(0x5eed_0001);
    let mut best: Option<(f64, Terms)> = None;
    for _ in 0..TRIES {
        let four = [(); 4].map(|()| random.below(places.len()));
        let Some(terms) = through(places, &four) else {
            continue;
        };
        // Truncated squares tell good from better where a count cannot (Torr & Zisserman 2000).
        let cost: f64 = places
            .iter()
            .map(|p| (residual(&terms, p) / tolerance).powi(2).min(1.0))
            .sum();
        if best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, terms));
        }
    }
    let (_, terms) = best?;
    let agree = places
        .iter()
        .map(|p| residual(&terms, p).abs() <= tolerance)
        .collect();
    Some((terms, agree))
}

/// The four numbers through four matches, if they are possible for a pair of pictures.
fn through(places: &[Place], four: &[usize; 4]) -> Option<Terms> {
    let mut terms = Terms::zeros();
    // Twice: the basis is of first order.
    for _ in 0..2 {
        let mut rows = Matrix4::zeros();
        let mut rest = Vector4::zeros();
        for (i, &at) in four.iter().enumerate() {
            let b = basis(&terms, &places[at]);
            for (j, &k) in SAMPLED.iter().enumerate() {
                rows[(i, j)] = b[k];
            }
            rest[i] = residual(&terms, &places[at]);
        }
        let step = rows.lu().solve(&rest)?;
        for (j, &k) in SAMPLED.iter().enumerate() {
            terms[k] += step[j];
        }
        // Offset 20 % of the half width, 6 degrees, 10 %, 12 degrees: beyond them it is no pair.
        let possible = terms[OFFSET].abs() < 0.2
            && terms[ROLL].abs() < 0.1
            && terms[ZOOM].abs() < 0.1
            && terms[BASE_ROLL].abs() < 0.2;
        if !possible {
            return None;
        }
    }
    Some(terms)
}

/// SplitMix64 (Steele, Lea & Flood 2014).
struct SplitMix(u64);

impl SplitMix {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n as u64) as usize
    }
}
