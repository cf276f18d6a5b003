//! Costs summed along eight paths (Hirschmüller 2008): four from above in one pass, four from below in another, at the same time.

use vergence_imaging::Gray;

use super::census::CostVolume;

/// Penalties for a change of disparity between neighbours, in bits of the census word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Penalties {
    /// For a change by one.
    pub(super) small: u8,
    /// For any other change, in even areas ...
    pub(super) large: u8,
    /// ... down to this at strong edges of the picture.
    pub(super) least_large: u8,
}

impl Default for Penalties {
    /// Our own choice, on twin pictures: an eighth of the word for slopes, up to twice its half for jumps.
    fn default() -> Self {
        Self {
            small: 9,
            large: 70,
            least_large: 24,
        }
    }
}

impl Penalties {
    /// The large penalty between neighbours of these grey values. A path cost is at most 62 + `large` and fits a byte.
    fn between(&self, a: u8, b: u8) -> u8 {
        let fall = a.abs_diff(b);
        self.large.saturating_sub(fall).max(self.least_large)
    }
}

/// Path costs over the eight directions, `sums[(y * width + x) * count + k]`; at most 8 x 132.
pub(super) fn sums(costs: &CostVolume, left: &Gray, penalties: &Penalties) -> Vec<u16> {
    let (mut sums, other) = rayon::join(
        || pass(costs, left, penalties, Way::Down),
        || pass(costs, left, penalties, Way::Up),
    );
    for (s, o) in sums.iter_mut().zip(&other) {
        *s += o;
    }
    sums
}

/// Order in which pixels are visited; the four neighbours that were visited before are the paths' last steps.
#[derive(Clone, Copy)]
enum Way {
    /// From the top left: paths from the left, top left, top, top right.
    Down,
    /// From the bottom right: the opposite ones.
    Up,
}

/// Costs of one path at one pixel, with a sentinel at both ends so that neighbours need no test.
const SENTINEL: u8 = u8::MAX;

/// The paths' costs at the pixels of one row.
struct Row {
    /// Three paths (diagonal, vertical, other diagonal), each `width` x (`count` + 2).
    paths: [Vec<u8>; 3],
    /// Their minima.
    least: [Vec<u8>; 3],
}

impl Row {
    fn new(width: usize, stride: usize) -> Self {
        Self {
            paths: std::array::from_fn(|_| vec![SENTINEL; width * stride]),
            least: std::array::from_fn(|_| vec![0; width]),
        }
    }
}

fn pass(costs: &CostVolume, left: &Gray, penalties: &Penalties, way: Way) -> Vec<u16> {
    let (width, height, count) = (costs.width, costs.height, costs.count);
    let stride = count + 2;
    let mut sums = vec![0u16; costs.costs.len()];
    let mut last = Row::new(width, stride);
    let mut this = Row::new(width, stride);
    // Along the row: the pixel before, and this one.
    let mut along = [vec![SENTINEL; stride], vec![SENTINEL; stride]];
    let start = vec![0u8; stride];
    for step_y in 0..height {
        let y = match way {
            Way::Down => step_y,
            Way::Up => height - 1 - step_y,
        };
        let mut along_least = 0;
        for step_x in 0..width {
            let (x, before, after) = match way {
                Way::Down => (step_x, step_x.wrapping_sub(1), step_x + 1),
                Way::Up => (
                    width - 1 - step_x,
                    width - step_x,
                    (width - 1 - step_x).wrapping_sub(1),
                ),
            };
            let at = (y * width + x) * count;
            let cost = &costs.costs[at..at + count];
            let grey = left.at(x, y);
            let sum = &mut sums[at..at + count];
            let [old, new] = &mut along;
            let old_cost = if step_x == 0 { &start } else { &*old };
            let jump = match step_x {
                0 => 0,
                _ => penalties.between(grey, left.at(before, y)),
            };
            along_least = step(cost, old_cost, along_least, penalties.small, jump, new, sum);
            std::mem::swap(old, new);
            for (path, from) in [before, x, after].into_iter().enumerate() {
                let known = step_y > 0 && from < width;
                let (old, least, jump) = if known {
                    let row = match way {
                        Way::Down => y - 1,
                        Way::Up => y + 1,
                    };
                    (
                        &last.paths[path][from * stride..(from + 1) * stride],
                        last.least[path][from],
                        penalties.between(grey, left.at(from, row)),
                    )
                } else {
                    (&start[..], 0, 0)
                };
                let new = &mut this.paths[path][x * stride..(x + 1) * stride];
                this.least[path][x] = step(cost, old, least, penalties.small, jump, new, sum);
            }
        }
        std::mem::swap(&mut last, &mut this);
    }
    sums
}

/// One step of one path (Hirschmüller 2008, Eq. 13): `new(k) = cost(k) + min(old(k), old(k -+ 1) + small, least + large) - least`.
/// Adds it to `sum` and returns its minimum. `old` and `new` have a sentinel before and after.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn step(
    cost: &[u8],
    old: &[u8],
    least: u8,
    small: u8,
    large: u8,
    new: &mut [u8],
    sum: &mut [u16],
) -> u8 {
    let count = cost.len();
    let (lower, same, upper) = (&old[..count], &old[1..=count], &old[2..count + 2]);
    let new = &mut new[1..=count];
    let sum = &mut sum[..count];
    let jump = least.saturating_add(large);
    let mut minimum = u8::MAX;
    for k in 0..count {
        let beside = lower[k].min(upper[k]).saturating_add(small);
        let path = cost[k] + (same[k].min(beside).min(jump) - least);
        new[k] = path;
        minimum = minimum.min(path);
        sum[k] += u16::from(path);
    }
    minimum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The eight paths written out one by one, by the definition.
    fn plain_sums(costs: &CostVolume, left: &Gray, penalties: &Penalties) -> Vec<u16> {
        let (width, height, count) = (costs.width as i64, costs.height as i64, costs.count);
        let mut sums = vec![0u16; costs.costs.len()];
        for (dx, dy) in [
            (1, 0),
            (1, 1),
            (0, 1),
            (-1, 1),
            (-1, 0),
            (-1, -1),
            (0, -1),
            (1, -1),
        ] {
            let mut path = vec![0i64; sums.len()];
            let mut order: Vec<(i64, i64)> = (0..height)
                .flat_map(|y| (0..width).map(move |x| (x, y)))
                .collect();
            if dy < 0 || (dy == 0 && dx < 0) {
                order.reverse();
            }
            for (x, y) in order {
                let at = ((y * width + x) as usize) * count;
                let (fx, fy) = (x - dx, y - dy);
                let inside = (0..width).contains(&fx) && (0..height).contains(&fy);
                for k in 0..count {
                    let cost = i64::from(costs.costs[at + k]);
                    path[at + k] = cost;
                    if inside {
                        let from = ((fy * width + fx) as usize) * count;
                        let old = &path[from..from + count];
                        let least = *old.iter().min().unwrap();
                        let fall = left
                            .at(x as usize, y as usize)
                            .abs_diff(left.at(fx as usize, fy as usize));
                        let large = (i64::from(penalties.large) - i64::from(fall))
                            .max(i64::from(penalties.least_large));
                        let mut best = old[k].min(least + large);
                        if k > 0 {
                            best = best.min(old[k - 1] + i64::from(penalties.small));
                        }
                        if k + 1 < count {
                            best = best.min(old[k + 1] + i64::from(penalties.small));
                        }
                        path[at + k] = cost + best - least;
                    }
                }
            }
            for (s, p) in sums.iter_mut().zip(&path) {
                *s += *p as u16;
            }
        }
        sums
    }

    /// The two interleaved passes give exactly what eight separate paths give, on rough costs.
    #[test]
    fn passes_equal_single_paths() {
        let left = Gray::from_fn(23, 17, |x, y| ((x * 37 + y * 91) % 256) as u8);
        let costs = CostVolume {
            width: 23,
            height: 17,
            first: -3,
            count: 16,
            costs: (0..23 * 17 * 16)
                .map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 13) as u8 % 63)
                .collect(),
        };
        let penalties = Penalties::default();
        assert_eq!(
            sums(&costs, &left, &penalties),
            plain_sums(&costs, &left, &penalties)
        );
    }
}
