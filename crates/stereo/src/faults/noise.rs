//! Noise of each eye's picture and its difference.

use vergence_imaging::Gray;

use super::{Cause, Estimate, Finding, Limits};

/// Noise of both pictures: of the green channel, coded levels of 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of the noise of the left and the right picture, levels.
    pub level: [f64; 2],
    /// Standard deviation of the estimates, levels.
    pub level_sigma: [f64; 2],
    /// Right minus left, levels.
    pub difference: f64,
}

/// Side of a block, px.
const BLOCK: usize = 12;

/// Share of the blocks, the flattest ones, that are read.
const FLAT_SHARE: f64 = 0.10;

/// Fewer flat blocks than this tell nothing.
const LEAST_BLOCKS: usize = 12;

/// At most about so many blocks are looked at.
const MOST_BLOCKS: usize = 6000;

/// Blocks with means outside this hold clipped noise.
const MEANS: [f64; 2] = [12.0, 243.0];

/// Noise of both pictures' `planes` (the green channels), each from its own flattest blocks: where nothing is to be seen, nothing can be
/// matched either, so no map is asked.
///
/// In each block the residual of `[1 -2 1] x [1 -2 1]` (Immerkær 1996) has 36 times the noise's variance and no answer to planes; blocks
/// are chosen by how little the means of their nine parts differ, which noise hardly moves, so the choice does not favour quiet blocks.
/// In a picture with texture everywhere this is an upper bound. `None` with fewer than 12 blocks.
pub fn noise_of(planes: [&Gray; 2]) -> Option<Noise> {
    let [left, right] = planes.map(level_of);
    let (left, right) = (left?, right?);
    Some(Noise {
        level: [left.0, right.0],
        level_sigma: [left.1, right.1],
        difference: right.0 - left.0,
    })
}

/// Noise of one plane and its standard deviation.
fn level_of(plane: &Gray) -> Option<(f64, f64)> {
    let (width, height) = plane.size();
    let step = ((width * height) as f64 / MOST_BLOCKS as f64)
        .sqrt()
        .max(BLOCK as f64) as usize;
    let mut blocks: Vec<Block> = (1..height.saturating_sub(BLOCK + 1))
        .step_by(step)
        .flat_map(|y| {
            (1..width.saturating_sub(BLOCK + 1))
                .step_by(step)
                .map(move |x| (x, y))
        })
        .filter_map(|(x, y)| block(plane, x, y))
        .collect();
    let count = ((blocks.len() as f64 * FLAT_SHARE) as usize).max(LEAST_BLOCKS);
    if blocks.len() < count {
        return None;
    }
    blocks.sort_unstable_by(|a, b| a.uneven.total_cmp(&b.uneven));
    Some(middle(blocks[..count].iter().map(|b| b.residual).collect()))
}

struct Block {
    /// Largest minus smallest mean of its nine parts, levels.
    uneven: f64,
    /// Variance of the noise by the residual, levels squared.
    residual: f64,
}

/// The block with its top left corner at (x, y), one pixel or more from the border; `None` where it is clipped.
fn block(plane: &Gray, x: usize, y: usize) -> Option<Block> {
    let part = BLOCK / 3;
    let (mut low, mut high, mut total) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
    for j in 0..3 {
        for i in 0..3 {
            let rows = y + j * part..y + (j + 1) * part;
            let sum: u32 = rows
                .flat_map(|r| &plane.row(r)[x + i * part..x + (i + 1) * part])
                .map(|&v| u32::from(v))
                .sum();
            let mean = f64::from(sum) / (part * part) as f64;
            (low, high, total) = (low.min(mean), high.max(mean), total + mean / 9.0);
        }
    }
    if !(MEANS[0]..=MEANS[1]).contains(&total) {
        return None;
    }
    let mut squares = 0.0;
    for r in y..y + BLOCK {
        let rows = [r - 1, r, r + 1].map(|r| &plane.row(r)[x - 1..=x + BLOCK]);
        for c in 0..BLOCK {
            let line = |row: &[u8]| {
                f64::from(row[c]) - 2.0 * f64::from(row[c + 1]) + f64::from(row[c + 2])
            };
            let value = line(rows[0]) - 2.0 * line(rows[1]) + line(rows[2]);
            squares += value * value;
        }
    }
    Some(Block {
        uneven: high - low,
        residual: squares / (36.0 * (BLOCK * BLOCK) as f64),
    })
}

/// Square root of the median variance, and its standard deviation by the quartiles.
fn middle(mut variances: Vec<f64>) -> (f64, f64) {
    variances.sort_unstable_by(f64::total_cmp);
    let n = variances.len();
    let at = |share: f64| variances[((n - 1) as f64 * share).round() as usize].sqrt();
    let spread = (at(0.75) - at(0.25)) / 1.349;
    (at(0.5), 1.25 * spread / (n as f64).sqrt())
}

/// The verdict on the difference.
pub(crate) fn finding(found: &Noise) -> Finding {
    let limits = Limits {
        look: 1.5,
        bad: 4.0,
        source: "our own choice: no study of a limit was read",
    };
    let what = format!(
        "noise of {:.1} levels in the left picture, {:.1} in the right one",
        found.level[0], found.level[1]
    );
    let sigma = found.level_sigma[0].hypot(found.level_sigma[1]);
    let estimate = Estimate {
        value: found.difference,
        sigma,
    };
    let remedy = "give both cameras the same gain (ISO) and the same light";
    Finding::judged(Cause::Noise, estimate, "levels", limits, &what, remedy)
}
