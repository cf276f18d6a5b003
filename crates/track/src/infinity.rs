//! Does anything that both eyes see lie behind infinity? Then they do not stand to each other as is believed.
//!
//! Nothing real is farther than infinity: two eyes that see a point must turn towards each other for it, or stand parallel. A picture in which much
//! would need eyes that turn apart was taken by eyes that stand otherwise than they are thought to: a motor has missed steps, a camera was turned, or
//! left and right are swapped. The other way round nothing follows, since whatever seems too near may be near.

use nalgebra::{Point2, Vector3};

use crate::range::{best_of, correlation, normalise};
use crate::sampling::{Facet, Footprint, Lattice, sample};
use crate::view::EyeView;

/// Patches that can be looked at, across and down ...
const PATCHES: [usize; 2] = [6, 5];

/// ... in steps of so many of them, which leads through all, so that the first few lie all over the picture ...
const SPREAD: usize = 11;

/// ... until so many were found.
const ENOUGH: u32 = 14;

/// A patch's place in the right picture is worked out exactly at every so manieth step of the search (6 degrees), and shifted with its middle in between.
const EXACT_EVERY: usize = 16;

/// Samples of a patch, across and down ...
const SAMPLES: [usize; 2] = [13, 11];

/// ... so many to a picture's width: two pixels of a picture of 256 apart.
const ACROSS: f64 = 128.0;

/// Angles of parallax that are searched, rad (±15°, more than the vergence axes of a rig turn, and never more than the picture is wide).
const SEARCHED_RAD: [f64; 2] = [-0.27, 0.27];

/// Steps of the search, in samples.
const STEP: f64 = 0.7;

/// Least correlation of a patch that counts as matched.
const SCORE: f64 = 0.85;

/// So much worse must the second best place be that is not beside the best: walls with patterns match in many.
const CLEARER_BY: f64 = 0.1;

/// Beside the best: so many steps.
const BESIDE: usize = 3;

/// Farther behind infinity than this is beyond what play, zeros and the match itself leave open, rad (0.17°).
const BEYOND_RAD: f64 = 0.003;

/// What both eyes see of the whole picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FarSight {
    /// Patches of the left picture that were found in the right one, without doubt.
    pub matched: u32,
    /// How many of them lie behind infinity.
    pub beyond: u32,
    /// By how much these do, rad: their median; 0 when there are none. The eyes stand wrong to each other by at least this angle.
    pub by_rad: f64,
}

/// The check with its buffers.
#[derive(Clone, Debug, Default)]
pub struct InfinityCheck {
    left: Vec<f32>,
    right: Vec<f32>,
    scores: Vec<f64>,
    beyond: Vec<f64>,
}

impl InfinityCheck {
    /// Look at a pair. The eyes may stand in any way that lets them see the same things, as a rig's do; cameras far apart see none of the other's patches
    /// and nothing is matched.
    pub fn look(&mut self, left: &EyeView, right: &EyeView) -> FarSight {
        let mut sight = FarSight::default();
        self.beyond.clear();
        let k = &left.camera.intrinsics;
        let place =
            |i: usize, of: usize, size: usize| (i as f64 + 0.5) / of as f64 * size as f64 - 0.5;
        let all = PATCHES[0] * PATCHES[1];
        for n in 0..all {
            if sight.matched == ENOUGH {
                break;
            }
            let number = n * SPREAD % all;
            let middle = Point2::new(
                place(number % PATCHES[0], PATCHES[0], k.width),
                place(number / PATCHES[0], PATCHES[1], k.height),
            );
            let Some(angle_rad) = left
                .ray(&middle)
                .and_then(|ray| self.parallax(left, right, &ray))
            else {
                continue;
            };
            sight.matched += 1;
            if angle_rad < -BEYOND_RAD {
                self.beyond.push(-angle_rad);
            }
        }
        self.beyond.sort_by(f64::total_cmp);
        sight.beyond = self.beyond.len() as u32;
        sight.by_rad = self
            .beyond
            .get(self.beyond.len() / 2)
            .copied()
            .unwrap_or(0.0);
        sight
    }

    /// The parallax of what the left eye sees along `ray`, rad: baseline over distance, less than 0 behind infinity. `None` where it has no clear match.
    fn parallax(&mut self, left: &EyeView, right: &EyeView, ray: &Vector3<f64>) -> Option<f64> {
        let lens = left.lens();
        let stride_rad = left.camera.intrinsics.width as f64 / ACROSS / left.camera.intrinsics.fx;
        let lattice = Lattice::centred(SAMPLES[0], SAMPLES[1], stride_rad, 0.0, 0.0);
        let facet = Facet::facing(&lens, ray, 1.0, &Vector3::y());
        let seen = Footprint::new(left, &facet, &lattice)?;
        if sample(left, &seen, &mut self.left) < 1.0 || !normalise(&mut self.left, None) {
            return None;
        }
        let width_rad = left.camera.intrinsics.width as f64 / left.camera.intrinsics.fx;
        let [from, to] = SEARCHED_RAD.map(|rad| rad.clamp(-width_rad, width_rad));
        let step_rad = STEP * stride_rad;
        let count = ((to - from) / step_rad).ceil() as usize + 1;
        let aside = (right.lens() - lens).normalize();
        self.scores.clear();
        let centre = facet.at(0.0, 0.0);
        let mut exact: Option<(Footprint, Point2<f64>)> = None;
        for n in 0..count {
            // Parallax is the distance of the eyes over that of a point: a point at 1 m seen by eyes so many metres apart has it, and with eyes
            // that have changed places one behind infinity.
            let mut view = *right;
            view.base_from_cam.translation.vector =
                lens.coords + aside * (from + n as f64 * step_rad);
            let middle = view.project(&centre);
            if n.is_multiple_of(EXACT_EVERY) {
                exact = Footprint::new(&view, &facet, &lattice).zip(middle);
            }
            let score = exact.as_ref().zip(middle).and_then(|((exact, from), to)| {
                let there = exact.shifted(to - from);
                if sample(&view, &there, &mut self.right) <= 0.9 {
                    return None;
                }
                correlation(&self.left, &self.right, None)
            });
            self.scores.push(score.unwrap_or(f64::NEG_INFINITY));
        }
        let (at, score) = best_of(&self.scores)?;
        let is_apart = |n: usize| (n as f64 - at).abs() > BESIDE as f64;
        let second = (self.scores.iter().enumerate())
            .filter(|(n, _)| is_apart(*n))
            .map(|(_, s)| *s)
            .fold(f64::NEG_INFINITY, f64::max);
        (score >= SCORE && second <= score - CLEARER_BY).then_some(from + at * step_rad)
    }
}
