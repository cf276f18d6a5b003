//! What both eyes agree on, and what the rest is.

use rayon::prelude::*;
use vergence_imaging::Plane;

use super::winner::Winners;
use crate::dense::Seen;

/// What each left pixel is: `Both` where the other eye's map says the same within `agree_px`; `Occluded` where no disparity of the
/// other eye leads here, or the match lies outside; `Unknown` where the eyes disagree.
pub(super) fn seen_by(winners: &Winners, agree_px: f32) -> Plane<Seen> {
    let (width, height) = winners.left.size();
    let mut seen = Plane::filled(width, height, Seen::Both);
    let rows = seen.samples_mut().par_chunks_mut(width).enumerate();
    rows.for_each(|(y, out)| {
        let (own, other) = (winners.left.row(y), winners.right.row(y));
        let reached = reached_from(other, width);
        for (x, (out, &d)) in out.iter_mut().zip(own).enumerate() {
            let there = (x as f32 - d).round();
            let inside = there >= 0.0 && there < other.len() as f32;
            if inside && (other[there as usize] - d).abs() <= agree_px {
                continue;
            }
            *out = if inside && reached[x] {
                Seen::Unknown
            } else {
                Seen::Occluded
            };
        }
    });
    seen
}

/// Which left pixels the right eye's disparities lead to; gaps of one pixel, which slanted surfaces leave, are closed.
fn reached_from(other: &[f32], width: usize) -> Vec<bool> {
    let mut reached = vec![false; width];
    for (x, &d) in other.iter().enumerate() {
        // NaN fails both tests.
        let at = (x as f32 + d).round();
        if at >= 0.0 && at < width as f32 {
            reached[at as usize] = true;
        }
    }
    let open = reached.clone();
    for x in 1..width.saturating_sub(1) {
        reached[x] |= open[x - 1] && open[x + 1];
    }
    reached
}

/// Connected areas of smooth disparity with fewer pixels than `least` become unknown.
pub(super) fn drop_islands(map: &Plane<f32>, seen: &mut Plane<Seen>, step_px: f32, least: usize) {
    let width = map.width();
    let d = map.samples();
    let seen = seen.samples_mut();
    let mut islands = Islands {
        parent: vec![0; d.len()],
        size: vec![0; d.len()],
    };
    for i in 0..d.len() {
        if seen[i] != Seen::Both {
            continue;
        }
        let joins = |n: usize| seen[n] == Seen::Both && (d[n] - d[i]).abs() <= step_px;
        let beside = (i % width > 0 && joins(i - 1)).then(|| islands.root(i - 1));
        let above = (i >= width && joins(i - width)).then(|| islands.root(i - width));
        islands.add(i, beside, above);
    }
    for (i, seen) in seen.iter_mut().enumerate() {
        if *seen == Seen::Both {
            let root = islands.root(i);
            if (islands.size[root] as usize) < least {
                *seen = Seen::Unknown;
            }
        }
    }
}

/// Disjoint sets of pixels; a root is its own parent and knows the size.
struct Islands {
    parent: Vec<u32>,
    size: Vec<u32>,
}

impl Islands {
    fn root(&mut self, mut i: usize) -> usize {
        while self.parent[i] as usize != i {
            // Halve the way for the next one.
            self.parent[i] = self.parent[self.parent[i] as usize];
            i = self.parent[i] as usize;
        }
        i
    }

    /// A pixel that belongs to the islands of these roots.
    fn add(&mut self, i: usize, beside: Option<usize>, above: Option<usize>) {
        let root = match (beside, above) {
            (None, None) => i,
            (Some(a), None) | (None, Some(a)) => a,
            (Some(a), Some(b)) if a == b => a,
            (Some(a), Some(b)) => {
                // The smaller under the larger, so that ways stay short.
                let (small, large) = if self.size[a] < self.size[b] {
                    (a, b)
                } else {
                    (b, a)
                };
                self.parent[small] = large as u32;
                self.size[large] += self.size[small];
                large
            }
        };
        self.parent[i] = root as u32;
        self.size[root] += 1;
    }
}
