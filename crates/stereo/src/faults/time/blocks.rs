//! The offset by moving blocks: how far they are above or below their row in the other eye.

use std::collections::VecDeque;

use vergence_imaging::Gray;

use crate::faults::alignment::{Focal, VerticalModel, aligned};
use crate::faults::matching::matched;

/// Half side of a block, px of the reduced pictures.
const HALF: i64 = 8;

/// Distance between blocks, px.
const STEP: usize = 14;

/// How far a block is looked for in the next frame, px.
const MOTION_PX: i64 = 24;

/// How far above and below its row it is looked for in the other eye, px.
const ROWS_PX: i64 = 12;

/// Frames that are read, evenly over the window, and blocks in each.
const MOST_FRAMES: usize = 16;
const MOST_BLOCKS: usize = 60;

/// A pixel moves when it differs by more than this, levels, from the frame before *and* from the one after: what has just been
/// uncovered, or is about to be covered, belongs to the background.
const LEAST_CHANGE: u8 = 6;

/// A block is read when this share of it moves, and its mean vertical gradient is at least so much, levels.
const LEAST_MOVING: f64 = 0.25;
const LEAST_GRADIENT: f64 = 3.0;

/// Mean difference of a match that is believed, levels.
const MOST_DIFFERENCE: f64 = 14.0;

/// Vertical velocities below this say nothing, px per frame.
const LEAST_SPEED: f64 = 0.9;

/// The eyes' motions must agree to this share of their mean.
const AGREE_SHARE: f64 = 0.3;

/// Fewer equations than this tell nothing.
const LEAST_EQUATIONS: usize = 16;

/// Vertical displacement between the eyes, px, is vertical velocity, px per frame, times the offset.
struct Equation {
    frame: usize,
    displacement: f64,
    velocity: f64,
}

/// Standard deviation of a displacement, px.
const SIGMA_PX: f64 = 0.25;

/// So many blocks err alike: they lie on one limb, in one frame.
const ALIKE: f64 = 8.0;

/// Blocks hold some of what does not move, which draws the fraction to the whole frame by up to this share of it.
const DRAWN_SHARE: f64 = 0.15;

/// What the blocks say.
pub(super) struct Residue {
    /// Offset, frames, and its standard deviation; `None` where too little moves up or down.
    pub(super) offset: Option<(f64, f64)>,
    /// Disparity that four in five of the matched points do not exceed, px of the reduced pictures; `None` where nothing matches.
    pub(super) parallax_px: Option<f64>,
}

/// `near` is the offset, known to half a frame or so.
pub(super) fn residue(frames: &VecDeque<[Gray; 2]>, near: f64) -> Residue {
    let whole = near.round() as i64;
    let Some(rows) = Rows::of(frames, whole) else {
        return Residue {
            offset: None,
            parallax_px: None,
        };
    };
    Residue {
        offset: offset(frames, whole, &rows),
        parallax_px: Some(rows.parallax_px),
    }
}

/// What does not move in a block draws the fraction towards the whole frame that it was read at. Read at the whole frames on both sides,
/// it is drawn both ways alike, and the ratio is right.
fn offset(frames: &VecDeque<[Gray; 2]>, whole: i64, rows: &Rows) -> Option<(f64, f64)> {
    let (here, sigma_here) = fraction_at(frames, whole, rows)?;
    let alone = (whole as f64 + here, sigma_here.hypot(DRAWN_SHARE * here));
    if here.abs() < SMALL {
        return Some(alone);
    }
    let side = if here > 0.0 { 1 } else { -1 };
    let Some((there, sigma_there)) = fraction_at(frames, whole + side, rows) else {
        return Some(alone);
    };
    let (p, q) = (here.abs(), -there * side as f64);
    if q <= 0.0 || p + q < LEAST_SUM {
        return Some(alone);
    }
    let fraction = p / (p + q);
    let sigma = (q * sigma_here).hypot(p * sigma_there) / (p + q).powi(2);
    Some((whole as f64 + side as f64 * fraction, sigma))
}

/// A fraction of a frame below this is taken as read.
const SMALL: f64 = 0.06;

/// Fractions from both sides that sum to less than this are noise.
const LEAST_SUM: f64 = 0.3;

/// Offset beyond a whole frame, and its standard deviation.
fn fraction_at(frames: &VecDeque<[Gray; 2]>, whole: i64, rows: &Rows) -> Option<(f64, f64)> {
    let times: Vec<i64> = (1..frames.len() as i64 - 1)
        .filter(|k| (1..frames.len() as i64 - 1).contains(&(k + whole)))
        .collect();
    let stride = times.len().div_ceil(MOST_FRAMES).max(1);
    let mut equations = Vec::new();
    for &k in times.iter().step_by(stride) {
        let left = [-1, 0, 1].map(|s| &frames[(k + whole + s) as usize][0]);
        let right = [-1, 0, 1].map(|s| &frames[(k + s) as usize][1]);
        equations.extend(equations_of(k as usize, left, right, rows));
    }
    let found = solved(&equations)?;
    // The equations are of first order: far from the whole frame they were set up at they do not hold.
    (found.0.abs() < 1.2).then_some(found)
}

/// Where in the other eye a point may be.
struct Rows {
    /// Smallest and largest disparity, px.
    disparity: [i64; 2],
    parallax_px: f64,
    model: VerticalModel,
}

impl Rows {
    fn of(frames: &VecDeque<[Gray; 2]>, whole: i64) -> Option<Self> {
        let middle = frames.len() as i64 / 2;
        let left = &frames.get(usize::try_from(middle + whole).ok()?)?[0];
        let right = &frames[middle as usize][1];
        let matches = matched(left, right).ok()?;
        let (alignment, _) = aligned(&matches, Focal::assumed(left.size())).ok()?;
        let disparities = || matches.points.iter().map(|p| p.left_px.x - p.right_px.x);
        let low = disparities().fold(f64::INFINITY, f64::min);
        let high = disparities().fold(f64::NEG_INFINITY, f64::max);
        // What moves is displaced by the offset too.
        let margin = 0.75 * MOTION_PX as f64 + 0.15 * (high - low);
        Some(Self {
            disparity: [(low - margin) as i64, (high + margin) as i64],
            parallax_px: matches.percentile(disparities().map(f64::abs), 0.8),
            model: alignment.model,
        })
    }
}

fn equations_of(frame: usize, left: [&Gray; 3], right: [&Gray; 3], rows: &Rows) -> Vec<Equation> {
    let (width, height) = left[1].size();
    let edge = (HALF + 2) as usize;
    let moving = [moving(left), moving(right)];
    let mut blocks: Vec<(f64, i64, i64)> = Vec::new();
    for y in (edge..height.saturating_sub(edge)).step_by(STEP) {
        for x in (edge..width.saturating_sub(edge)).step_by(STEP) {
            let (share, gradient) = activity(left[1], &moving[0], x, y);
            if share > LEAST_MOVING && gradient > LEAST_GRADIENT {
                blocks.push((share * gradient, x as i64, y as i64));
            }
        }
    }
    blocks.sort_by(|a, b| b.0.total_cmp(&a.0));
    blocks.truncate(MOST_BLOCKS);
    let around = Window {
        x: [-MOTION_PX, MOTION_PX],
        y: [-MOTION_PX, MOTION_PX],
    };
    let mut equations = Vec::new();
    for (_, x, y) in blocks {
        let from = [x as f64, y as f64];
        let Some(l) = motion(left, &moving[0], from, &around) else {
            continue;
        };
        let [nearest, farthest] = rows.disparity;
        let mean = 0.5 * (nearest + farthest) as f64;
        let vertical = rows.model.vertical_px(from, mean);
        let there = Window {
            x: [-farthest, -nearest],
            y: [
                -ROWS_PX - vertical.round() as i64,
                ROWS_PX - vertical.round() as i64,
            ],
        };
        let Some(other) = found([left[1], &moving[0]], from, right[1], &there) else {
            continue;
        };
        let place = [from[0] + other[0], from[1] + other[1]];
        let Some(r) = motion(right, &moving[1], place, &around) else {
            continue;
        };
        let vertical = rows.model.vertical_px(from, -other[0]);
        if let Some(velocity) = agreed(l, r) {
            equations.push(Equation {
                frame,
                displacement: other[1] + vertical,
                velocity,
            });
        }
    }
    equations
}

/// The mean of the vertical velocities that the eyes measured, where it is large enough and they agree on it. What is measured wrong would
/// pass for motion without any displacement between the eyes, and draw the offset to the whole frame.
fn agreed(left: f64, right: f64) -> Option<f64> {
    let mean = 0.5 * (left + right);
    let agree = (left - right).abs() < AGREE_SHARE * mean.abs() + 0.2;
    (agree && mean.abs() > LEAST_SPEED).then_some(mean)
}

/// 255 where something moves, one pixel wider than seen, 0 elsewhere.
fn moving(frames: [&Gray; 3]) -> Gray {
    let (width, height) = frames[1].size();
    let mut seen = Gray::filled(width, height, 0);
    for y in 0..height {
        let [before, now, after] = frames.map(|f| f.row(y));
        for (x, out) in seen.row_mut(y).iter_mut().enumerate() {
            let change = now[x].abs_diff(before[x]).min(now[x].abs_diff(after[x]));
            *out = if change > LEAST_CHANGE { 255 } else { 0 };
        }
    }
    Gray::from_fn(width, height, |x, y| {
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        rows.flat_map(|y| seen.row(y)[columns.clone()].iter())
            .copied()
            .max()
            .unwrap_or(0)
    })
}

/// Share of a block that moves, and its mean vertical gradient there.
fn activity(frame: &Gray, moving: &Gray, x: usize, y: usize) -> (f64, f64) {
    let half = HALF as usize;
    let (mut count, mut gradient) = (0u32, 0u32);
    for row in y - half..=y + half {
        let (now, below, mask) = (frame.row(row), frame.row(row + 1), moving.row(row));
        for column in x - half..=x + half {
            if mask[column] > 0 {
                count += 1;
                gradient += u32::from(now[column].abs_diff(below[column]));
            }
        }
    }
    let all = ((2 * half + 1) * (2 * half + 1)) as f64;
    (
        f64::from(count) / all,
        f64::from(gradient) / f64::from(count.max(1)),
    )
}

/// Offsets that are searched, px, from `[0]` to `[1]`.
struct Window {
    x: [i64; 2],
    y: [i64; 2],
}

/// Vertical velocity of the block about a place, px per frame, from the frames before and after.
fn motion(frames: [&Gray; 3], moving: &Gray, at: [f64; 2], around: &Window) -> Option<f64> {
    let before = found([frames[1], moving], at, frames[0], around)?;
    let after = found([frames[1], moving], at, frames[2], around)?;
    Some(0.5 * (after[1] - before[1]))
}

/// Where what moves in the block about `at` lies in another picture, relative to `at` rounded to pixels: least sum of absolute
/// differences over the pixels of `mask`, then two lines of equal slope along each axis; `None` at the border of the search, where too
/// little moves, or where nothing fits.
fn found([from, mask]: [&Gray; 2], at: [f64; 2], to: &Gray, window: &Window) -> Option<[f64; 2]> {
    let [x, y] = at.map(|c| c.round() as i64);
    let (width, height) = (from.width() as i64, from.height() as i64);
    if x < HALF || y < HALF || x + HALF >= width || y + HALF >= height {
        return None;
    }
    const SIDE: usize = 2 * HALF as usize + 1;
    let mut block = [[0u8; SIDE]; SIDE];
    let mut cover = block;
    let mut count = 0.0;
    for row in 0..SIDE {
        let v = (y - HALF) as usize + row;
        let columns = (x - HALF) as usize..=(x + HALF) as usize;
        block[row].copy_from_slice(&from.row(v)[columns.clone()]);
        cover[row].copy_from_slice(&mask.row(v)[columns]);
        count += cover[row].iter().filter(|&&c| c > 0).count() as f64;
    }
    if count < LEAST_MOVING * (SIDE * SIDE) as f64 {
        return None;
    }
    let difference = |dx: i64, dy: i64| -> Option<u32> {
        let (u, v) = (x + dx - HALF, y + dy - HALF);
        if u < 0 || v < 0 || u + 2 * HALF >= width || v + 2 * HALF >= height {
            return None;
        }
        let mut sum = 0u32;
        for (row, (block, cover)) in block.iter().zip(&cover).enumerate() {
            let there = &to.row(v as usize + row)[u as usize..u as usize + SIDE];
            let mut line = 0u16;
            for ((a, c), b) in block.iter().zip(cover).zip(there) {
                line += u16::from(a.abs_diff(*b) & c);
            }
            sum += u32::from(line);
        }
        Some(sum)
    };
    // Every other place first, then all places about the best.
    let mut best = (u32::MAX, 0, 0);
    for dy in (window.y[0]..=window.y[1]).step_by(2) {
        for dx in (window.x[0]..=window.x[1]).step_by(2) {
            match difference(dx, dy) {
                Some(d) if d < best.0 => best = (d, dx, dy),
                _ => {}
            }
        }
    }
    let (_, near_x, near_y) = best;
    for dy in (near_y - 1).max(window.y[0])..=(near_y + 1).min(window.y[1]) {
        for dx in (near_x - 1).max(window.x[0])..=(near_x + 1).min(window.x[1]) {
            match difference(dx, dy) {
                Some(d) if d < best.0 => best = (d, dx, dy),
                _ => {}
            }
        }
    }
    let (least, dx, dy) = best;
    let inside = dx > window.x[0] && dx < window.x[1] && dy > window.y[0] && dy < window.y[1];
    if !inside || f64::from(least) > MOST_DIFFERENCE * count {
        return None;
    }
    let refine = |a: u32, c: u32| {
        let [a, b, c] = [a, least, c].map(f64::from);
        let steep = (a - b).max(c - b);
        if steep > 0.0 {
            0.5 * (a - c) / steep
        } else {
            0.0
        }
    };
    Some([
        dx as f64 + refine(difference(dx - 1, dy)?, difference(dx + 1, dy)?),
        dy as f64 + refine(difference(dx, dy - 1)?, difference(dx, dy + 1)?),
    ])
}

/// Robust least squares; the standard deviation by leaving out one frame at a time.
fn solved(equations: &[Equation]) -> Option<(f64, f64)> {
    if equations.len() < LEAST_EQUATIONS {
        return None;
    }
    let mut offset = 0.0;
    let mut weights = vec![1.0; equations.len()];
    let mut sums = (0.0, 0.0);
    for round in 0..10 {
        let rests = || {
            equations
                .iter()
                .map(|e| (e.displacement - e.velocity * offset) / SIGMA_PX)
        };
        let mut sizes: Vec<f64> = rests().map(f64::abs).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        let reach = 4.685 * (1.4826 * sizes[sizes.len() / 2]).max(0.5);
        for (w, rest) in weights.iter_mut().zip(rests()) {
            *w = if round == 0 {
                1.0
            } else {
                (1.0 - (rest / reach).powi(2)).max(0.0).powi(2)
            };
        }
        sums = sum(equations, &weights, None);
        if !(sums.1 > 0.0) {
            return None;
        }
        offset = sums.0 / sums.1;
    }
    let mut frames: Vec<usize> = equations.iter().map(|e| e.frame).collect();
    frames.dedup();
    let without: Vec<f64> = frames
        .iter()
        .map(|&f| sum(equations, &weights, Some(f)))
        .filter(|s| s.1 > 0.0)
        .map(|s| s.0 / s.1)
        .collect();
    let n = without.len() as f64;
    if n < 3.0 {
        return None;
    }
    let mean = without.iter().sum::<f64>() / n;
    let squares: f64 = without.iter().map(|o| (o - mean).powi(2)).sum();
    let chance = ((n - 1.0) / n * squares).sqrt().hypot(1.0 / sums.1.sqrt());
    let sigma = chance
        .hypot(DRAWN_SHARE * offset)
        .hypot(by_spread(equations));
    Some((offset, sigma))
}

/// Standard deviation by how much the blocks disagree: from the quartiles of what each says alone.
fn by_spread(equations: &[Equation]) -> f64 {
    let alone = equations.iter().map(|e| e.displacement / e.velocity);
    let mut alone: Vec<f64> = alone.collect();
    alone.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| alone[((alone.len() - 1) as f64 * share).round() as usize];
    let independent = (alone.len() as f64 / ALIKE).max(1.0);
    (at(0.75) - at(0.25)) / 1.349 / independent.sqrt()
}

fn sum(equations: &[Equation], weights: &[f64], without: Option<usize>) -> (f64, f64) {
    let kept = equations
        .iter()
        .zip(weights)
        .filter(|(e, _)| Some(e.frame) != without);
    kept.fold((0.0, 0.0), |(value, effect), (e, w)| {
        let w = w / (SIGMA_PX * SIGMA_PX);
        (
            value + w * e.velocity * e.displacement,
            effect + w * e.velocity * e.velocity,
        )
    })
}
