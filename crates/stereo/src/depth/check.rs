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
    rows.for_each_init(Vec::new, |reached, (y, out)| {
        let (own, other) = (winners.left.row(y), winners.right.row(y));
        reached_from(other, width, reached);
        seen_row(own, other, agree_px, reached, out);
    });
    seen
}

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn seen_row(own: &[f32], other: &[f32], agree_px: f32, reached: &[bool], out: &mut [Seen]) {
    for (x, (out, &d)) in out.iter_mut().zip(own).enumerate() {
        let there = nearest(x as f32 - d);
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
}

/// The nearest column; halves go up. (Processors have an instruction for it; for halves away from zero they have none.)
#[inline(always)]
pub(super) fn nearest(column: f32) -> f32 {
    (column + 0.5).floor()
}

/// Which left pixels the right eye's disparities lead to; gaps of one pixel, which slanted surfaces leave, are closed.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn reached_from(other: &[f32], width: usize, reached: &mut Vec<bool>) {
    reached.clear();
    reached.resize(width, false);
    for (x, &d) in other.iter().enumerate() {
        // NaN fails both tests.
        let at = nearest(x as f32 + d);
        if at >= 0.0 && at < width as f32 {
            reached[at as usize] = true;
        }
    }
    let mut behind = false;
    for x in 1..width.saturating_sub(1) {
        let before = if x == 1 { reached[0] } else { behind };
        behind = reached[x];
        reached[x] |= before && reached[x + 1];
    }
}

/// Connected areas of smooth disparity with fewer pixels than `least` become unknown. Bands of rows are joined up by themselves, then along
/// their borders: what is connected does not depend on how.
pub(super) fn drop_islands(map: &Plane<f32>, seen: &mut Plane<Seen>, step_px: f32, least: usize) {
    let (width, height) = map.size();
    let band = height.div_ceil(rayon::current_num_threads()).max(1) * width;
    // Not one cloned from the other: so each thread is the first to touch its own part.
    let [mut parent, mut size] = [(); 2].map(|()| vec![0u32; map.samples().len()]);
    let land = Land {
        map: map.samples(),
        seen: seen.samples(),
        width,
        step_px,
    };
    let bands = (parent.par_chunks_mut(band)).zip(size.par_chunks_mut(band));
    bands.enumerate().for_each(|(i, (parent, size))| {
        let first = i * band;
        Islands::new(first, parent, size).join(&land);
    });
    let mut all = Islands::new(0, &mut parent, &mut size);
    for border in (band..land.map.len()).step_by(band) {
        for i in border..border + width {
            if land.joins(i, i - width) {
                all.unite(i, i - width);
            }
        }
    }
    let (parent, size) = (&*parent, &*size);
    let bands = seen.samples_mut().par_chunks_mut(width).enumerate();
    bands.for_each(|(y, seen)| {
        // Neighbours mostly have one parent.
        let (mut last, mut small) = (u32::MAX, false);
        for (x, seen) in seen.iter_mut().enumerate() {
            if *seen != Seen::Both {
                continue;
            }
            let above = parent[y * width + x];
            if above != last {
                small = (size[root(parent, above as usize)] as usize) < least;
                last = above;
            }
            if small {
                *seen = Seen::Unknown;
            }
        }
    });
}

/// What islands are made of.
struct Land<'a> {
    map: &'a [f32],
    seen: &'a [Seen],
    width: usize,
    step_px: f32,
}

impl Land<'_> {
    #[inline(always)]
    fn joins(&self, i: usize, n: usize) -> bool {
        self.seen[i] == Seen::Both
            && self.seen[n] == Seen::Both
            && (self.map[n] - self.map[i]).abs() <= self.step_px
    }
}

fn root(parent: &[u32], mut i: usize) -> usize {
    while parent[i] as usize != i {
        i = parent[i] as usize;
    }
    i
}

/// Disjoint sets of the pixels from `first` on; a root is its own parent and knows the size. Parents are told by their place in the picture.
struct Islands<'a> {
    first: usize,
    parent: &'a mut [u32],
    size: &'a mut [u32],
}

impl<'a> Islands<'a> {
    fn new(first: usize, parent: &'a mut [u32], size: &'a mut [u32]) -> Self {
        Self {
            first,
            parent,
            size,
        }
    }

    /// All pixels of this band with their neighbours in it, run by run: pixels of a row that are connected go under the first one together.
    fn join(&mut self, land: &Land<'_>) {
        let rows = self.parent.len() / land.width;
        for row in 0..rows {
            let row_start = self.first + row * land.width;
            let row_end = row_start + land.width;
            let mut start = row_start;
            while start < row_end {
                if land.seen[start] != Seen::Both {
                    start += 1;
                    continue;
                }
                let mut end = start + 1;
                while end < row_end && land.joins(end, end - 1) {
                    end += 1;
                }
                self.parent[start - self.first..end - self.first].fill(start as u32);
                self.size[start - self.first] = (end - start) as u32;
                if row > 0 {
                    self.join_above(land, start, end);
                }
                start = end;
            }
        }
    }

    /// A run with what lies above it. Pixels above that are a run, too, need to be joined only once.
    #[inline(always)]
    fn join_above(&mut self, land: &Land<'_>, start: usize, end: usize) {
        let mut joined = u32::MAX;
        for i in start..end {
            let above = i - land.width;
            if land.joins(i, above) {
                let run = self.parent[above - self.first];
                if run != joined {
                    self.unite(i, above);
                    // What it has now is what its run's other pixels may have, or not: either way they are joined.
                    joined = run;
                }
            }
        }
    }

    fn root(&mut self, mut i: usize) -> usize {
        loop {
            let up = self.parent[i - self.first] as usize;
            if up == i {
                return i;
            }
            // Halve the way for the next one.
            let next = self.parent[up - self.first];
            self.parent[i - self.first] = next;
            i = next as usize;
        }
    }

    fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        // The smaller under the larger, so that ways stay short.
        let of = |i: usize| self.size[i - self.first];
        let (small, large) = if of(a) < of(b) { (a, b) } else { (b, a) };
        self.size[large - self.first] += of(small);
        self.parent[small - self.first] = large as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Islands by their definition: everything that can be reached from a pixel, step by step.
    fn plain(map: &Plane<f32>, seen: &Plane<Seen>, step_px: f32, least: usize) -> Plane<Seen> {
        let (width, height) = map.size();
        let mut out = seen.clone();
        let mut island_of = vec![usize::MAX; width * height];
        for start in 0..width * height {
            if island_of[start] != usize::MAX || seen.samples()[start] != Seen::Both {
                continue;
            }
            let mut island = vec![start];
            island_of[start] = start;
            let mut next = 0;
            while next < island.len() {
                let at = island[next];
                next += 1;
                for n in [
                    at.wrapping_sub(1),
                    at + 1,
                    at.wrapping_sub(width),
                    at + width,
                ] {
                    let beside = n < width * height
                        && (n % width).abs_diff(at % width) + (n / width).abs_diff(at / width) == 1;
                    if beside
                        && island_of[n] == usize::MAX
                        && seen.samples()[n] == Seen::Both
                        && (map.samples()[n] - map.samples()[at]).abs() <= step_px
                    {
                        island_of[n] = start;
                        island.push(n);
                    }
                }
            }
            if island.len() < least {
                for at in island {
                    out.samples_mut()[at] = Seen::Unknown;
                }
            }
        }
        out
    }

    /// Bands joined along their borders drop what the definition drops, on any number of threads: mazes of three levels with holes, thinner
    /// than a band and of one row or column among them.
    #[test]
    fn islands_are_those_of_the_definition() {
        let on = |threads: usize| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
        };
        let pools = [1, 2, 3, 7].map(on);
        let (mut dropped, mut kept) = (0, 0);
        for (width, height, seed) in [(61, 47, 1), (40, 3, 2), (1, 30, 3), (30, 1, 4), (97, 64, 5)]
        {
            let noise = |x: usize, y: usize| {
                let h = (x * 7919 + y * 104_729 + seed * 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                (h >> 40) % 10
            };
            let map = Plane::from_fn(width, height, |x, y| (2 * (noise(x, y) % 3 / 2)) as f32);
            let seen = Plane::from_fn(width, height, |x, y| match noise(y + 5, x) {
                0 => Seen::Unknown,
                1 => Seen::Occluded,
                _ => Seen::Both,
            });
            let expected = plain(&map, &seen, 1.0, 6);
            for pool in &pools {
                let mut found = seen.clone();
                pool.install(|| drop_islands(&map, &mut found, 1.0, 6));
                assert!(found.samples() == expected.samples(), "{width} x {height}");
            }
            let both = |p: &Plane<Seen>| p.samples().iter().filter(|&&s| s == Seen::Both).count();
            dropped += both(&seen) - both(&expected);
            kept += both(&expected);
        }
        assert!(dropped > 500 && kept > 500, "{dropped} {kept}");
    }
}
