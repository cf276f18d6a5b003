//! From corner to corner along the edges between them.
//!
//! An edge of a board keeps its white side until the next corner, where the sides change. So an edge is followed, a pixel
//! or two at a time and steered back onto its steepest place, until a corner comes that has the edge's colours on the other end, or
//! until the contrast ends. Nothing is assumed about straightness or spacing: strong distortion, perspective and the unequal steps of
//! an AprilGrid are all the same.

// Index loops: both coordinates.
#![expect(
    clippy::needless_range_loop,
    reason = "the loops' numbers are coordinates, and index several buffers at once"
)]

use super::level::{Level, sample};
use super::saddle::Saddle;

/// Steps along the edge, pixels.
const STEP_PX: f64 = 1.5;
/// Where following begins, pixels from the corner: outside of its own blur.
const SKIP_PX: f64 = 2.0;
/// A corner this near is reached, pixels; at the end of the contrast, where blur hides the last pixels, [`END_PX`].
const NEAR_PX: f64 = 2.0;
const END_PX: f64 = 5.0;
/// Largest angle between an edge and the direction in which a corner says that it leaves, radians.
const LARGEST_TURN: f64 = 0.5;
/// Largest angle between the edges that cross at two neighbouring corners, radians: lens and perspective turn them by less. What notches and
/// noise make on an edge crosses it anyhow.
const LARGEST_CROSSING: f64 = 0.45;
/// Least contrast and strength of the next corner as shares of this one's.
const LEAST_AMPLITUDE: f32 = 0.3;
const LEAST_STRENGTH: f32 = 0.4;
/// Contrast at which an edge ends, as a share of its own mean.
const END_SHARE: f32 = 0.35;
/// Longest edge as a share of the picture's longer side.
const LONGEST: f64 = 0.35;
/// Side of the cells that corners are looked up in, pixels: less than what candidates are apart.
const CELL_PX: f64 = 2.0;

/// An edge that was followed from one corner to another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    /// Number of the corner where it ends.
    pub(crate) to: usize,
    /// Which of that corner's edges it is.
    pub(crate) arrives_by: usize,
}

/// Where candidates are.
struct Finder {
    columns: usize,
    rows: usize,
    cells: Vec<u32>,
}

const EMPTY: u32 = u32::MAX;

impl Finder {
    fn new(level: &Level, saddles: &[Saddle]) -> Self {
        let (width, height) = level.smooth().size();
        let columns = (width as f64 / CELL_PX) as usize + 2;
        let rows = (height as f64 / CELL_PX) as usize + 2;
        let mut cells = vec![EMPTY; columns * rows];
        for (i, s) in saddles.iter().enumerate() {
            let [x, y] = s.at.map(|c| (c / CELL_PX) as usize);
            let cell = &mut cells[y.min(rows - 1) * columns + x.min(columns - 1)];
            let kept = saddles.get(*cell as usize);
            if kept.is_none_or(|k| k.amplitude < s.amplitude) {
                *cell = i as u32;
            }
        }
        Self {
            columns,
            rows,
            cells,
        }
    }

    /// Candidates of the cells that a circle touches.
    fn around(&self, at: [f64; 2], radius: f64) -> impl Iterator<Item = usize> + '_ {
        let range = |c: f64, n: usize| {
            let from = ((c - radius) / CELL_PX).max(0.0) as usize;
            let to = ((c + radius) / CELL_PX).max(0.0) as usize;
            from.min(n)..(to + 1).min(n)
        };
        let columns = range(at[0], self.columns);
        range(at[1], self.rows)
            .flat_map(move |y| {
                columns
                    .clone()
                    .map(move |x| self.cells[y * self.columns + x])
            })
            .filter(|&i| i != EMPTY)
            .map(|i| i as usize)
    }
}

/// The edges of every corner, followed: `links[corner][edge]`.
pub(crate) fn links(level: &Level, saddles: &[Saddle]) -> Vec<[Option<Link>; 4]> {
    let finder = Finder::new(level, saddles);
    (0..saddles.len())
        .map(|i| std::array::from_fn(|edge| follow(level, saddles, &finder, i, edge)))
        .collect()
}

/// A pencil on an edge.
struct Pencil {
    at: [f64; 2],
    /// Unit vector.
    along: [f64; 2],
}

impl Pencil {
    fn advance(&mut self, by: f64) {
        self.at = [
            self.at[0] + by * self.along[0],
            self.at[1] + by * self.along[1],
        ];
    }
}

fn follow(
    level: &Level,
    saddles: &[Saddle],
    finder: &Finder,
    from: usize,
    edge: usize,
) -> Option<Link> {
    let start = &saddles[from];
    let (sin, cos) = start.edges[edge].sin_cos();
    let white_side = if edge.is_multiple_of(2) { 1.0 } else { -1.0 };
    let mut pencil = Pencil {
        at: start.at,
        along: [cos, sin],
    };
    pencil.advance(SKIP_PX - STEP_PX);
    let mut mean_contrast = start.amplitude;
    let (width, height) = level.smooth().size();
    let most = (LONGEST * width.max(height) as f64 / STEP_PX) as usize;
    for step in 0..most {
        pencil.advance(STEP_PX);
        let reached = arrival(saddles, finder, from, edge, &pencil, NEAR_PX);
        if reached.is_some() {
            return reached;
        }
        let profile = profile(level, &pencil, white_side)?;
        let contrast = profile[4] - profile[0];
        if contrast < END_SHARE * mean_contrast {
            return arrival(saddles, finder, from, edge, &pencil, END_PX);
        }
        // The first steps settle what contrast the edge has; a corner's ring says it only roughly.
        let weight = if step < 3 { 0.4 } else { 0.1 };
        mean_contrast += weight * (contrast - mean_contrast);
        steer(&mut pencil, &profile, white_side);
    }
    None
}

/// Values across an edge, two pixels to either side, from black to white.
fn profile(level: &Level, pencil: &Pencil, white_side: f64) -> Option<[f32; 5]> {
    let across = [-pencil.along[1] * white_side, pencil.along[0] * white_side];
    let mut values = [0.0; 5];
    for (i, value) in values.iter_mut().enumerate() {
        let off = i as f64 - 2.0;
        *value = sample(
            level.smooth(),
            pencil.at[0] + off * across[0],
            pencil.at[1] + off * across[1],
        )?;
    }
    Some(values)
}

/// Moves the pencil halfway to the steepest place of the profile and turns it a little that way.
fn steer(pencil: &mut Pencil, profile: &[f32; 5], white_side: f64) {
    let slope: [f32; 3] = std::array::from_fn(|i| profile[i + 2] - profile[i]);
    let bend = slope[0] - 2.0 * slope[1] + slope[2];
    let steepest = if bend < 0.0 {
        0.5 * (slope[0] - slope[2]) / bend
    } else {
        (slope[2] - slope[0]).signum()
    };
    let off = f64::from(steepest.clamp(-1.0, 1.0)) * white_side;
    let across = [-pencil.along[1], pencil.along[0]];
    for i in 0..2 {
        pencil.at[i] += 0.5 * off * across[i];
        pencil.along[i] += 0.08 * off * across[i];
    }
    let norm = pencil.along[0].hypot(pencil.along[1]);
    pencil.along = pencil.along.map(|c| c / norm);
}

/// The corner that the pencil has reached, if one fits: near, ahead, with an edge that leads back and has the same colours.
fn arrival(
    saddles: &[Saddle],
    finder: &Finder,
    from: usize,
    edge: usize,
    pencil: &Pencil,
    radius: f64,
) -> Option<Link> {
    let start = &saddles[from];
    let back = (-pencil.along[1]).atan2(-pencil.along[0]);
    let mut best: Option<(f64, Link)> = None;
    for to in finder.around(pencil.at, radius) {
        let candidate = &saddles[to];
        let gap = [
            candidate.at[0] - pencil.at[0],
            candidate.at[1] - pencil.at[1],
        ];
        let distance = gap[0].hypot(gap[1]);
        let sideways = (gap[0] * pencil.along[1] - gap[1] * pencil.along[0]).abs();
        let too_weak = candidate.amplitude < LEAST_AMPLITUDE * start.amplitude
            || candidate.strength < LEAST_STRENGTH * start.strength;
        if to == from || too_weak || distance > radius || sideways > NEAR_PX {
            continue;
        }
        // Black and white change sides when one looks back, so edges of unlike parity meet.
        for arrives_by in [(edge + 1) % 4, (edge + 3) % 4] {
            let turn = angle_between(candidate.edges[arrives_by], back);
            let crossing = [1, 3]
                .iter()
                .map(|k| {
                    let there = candidate.edges[(arrives_by + 4 - k) % 4];
                    angle_between(start.edges[(edge + k) % 4], there)
                })
                .fold(0.0, f64::max);
            let fits = turn < LARGEST_TURN && crossing < LARGEST_CROSSING;
            if fits && best.is_none_or(|(d, _)| distance < d) {
                best = Some((distance, Link { to, arrives_by }));
            }
        }
    }
    best.map(|(_, link)| link)
}

/// Angle between two directions, 0..=π.
pub(crate) fn angle_between(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(std::f64::consts::TAU);
    turn.min(std::f64::consts::TAU - turn)
}
