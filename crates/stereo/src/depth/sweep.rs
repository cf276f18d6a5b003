//! Costs summed along eight paths (Hirschmüller 2008) in two sweeps that meet in the middle of the picture.

use super::cost::{CostRow, Features};
use super::winner::{OutRow, Row as WinnerRow, Winners};

/// Penalties for a change of disparity between neighbours, in units of the costs.
#[derive(Clone)]
pub(super) struct Penalties {
    /// For a change by one.
    pub(super) small: u8,
    /// For any other, by the step of the grey value between the neighbours; at most 64.
    pub(super) large: [u8; 256],
}

/// The large penalty in even areas, its fall per level of grey beyond the free ones, and its floor, the small penalty: at strong edges a
/// jump costs no more than a slope.
const SMALL: u8 = 10;
const LARGE: i64 = 50;
const FALL: i64 = 3;
const FREE_LEVELS: i64 = 4;

impl Default for Penalties {
    fn default() -> Self {
        Self {
            small: SMALL,
            large: std::array::from_fn(|step| {
                let beyond = (step as i64 - FREE_LEVELS).max(0);
                (LARGE - FALL * beyond).max(i64::from(SMALL)) as u8
            }),
        }
    }
}

/// Which way a sweep goes; the four neighbours that it has visited before are the last steps of its four paths.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    /// From the top left: paths from the left, the top left, the top, the top right.
    Down,
    /// From the bottom right: the opposite ones.
    Up,
}

/// Costs of one path at one pixel, with a sentinel at both ends so that neighbours need no test.
const SENTINEL: u8 = u8::MAX;

/// The paths' costs at the pixels of one row.
struct Row {
    /// Three paths (first diagonal, vertical, second diagonal), each `width` x (`count` + 2).
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

/// One sweep under way.
struct Sweep<'a> {
    way: Way,
    features: &'a Features<'a>,
    penalties: &'a Penalties,
    costs: CostRow,
    last: Row,
    this: Row,
    started: bool,
}

/// Where a sweep's sums over its four paths go.
enum Sums<'a> {
    /// Half of them is kept: they are at most 508 and fit a byte so.
    Kept(&'a mut [u8]),
    /// They are added to twice what the other sweep has kept.
    Added(&'a mut [u8], &'a mut [u16]),
}

impl<'a> Sweep<'a> {
    fn new(way: Way, features: &'a Features<'a>, penalties: &'a Penalties) -> Self {
        let stride = features.count + 2;
        Self {
            way,
            features,
            penalties,
            costs: CostRow::default(),
            last: Row::new(features.width, stride),
            this: Row::new(features.width, stride),
            started: false,
        }
    }

    /// The next row, `y`.
    fn step(&mut self, y: usize, sums: Sums<'_>) {
        let grays = self.features.left.grays;
        let before = match (self.started, self.way) {
            (false, _) => None,
            (true, Way::Down) => Some(grays.row(y - 1)),
            (true, Way::Up) => Some(grays.row(y + 1)),
        };
        let scene = Scene {
            costs: self.costs.of(self.features, y),
            grays: grays.row(y),
            before,
            penalties: self.penalties,
            count: self.features.count,
        };
        let (last, this) = (&self.last, &mut self.this);
        match (self.way, sums) {
            (Way::Down, Sums::Kept(kept)) => {
                row::<false, true>(&scene, last, this, kept, &mut []);
            }
            (Way::Up, Sums::Kept(kept)) => {
                row::<false, false>(&scene, last, this, kept, &mut []);
            }
            (Way::Down, Sums::Added(kept, sums)) => {
                row::<true, true>(&scene, last, this, kept, sums);
            }
            (Way::Up, Sums::Added(kept, sums)) => {
                row::<true, false>(&scene, last, this, kept, sums);
            }
        }
        std::mem::swap(&mut self.last, &mut self.this);
        self.started = true;
    }
}

struct Scene<'a> {
    costs: &'a [u8],
    grays: &'a [u8],
    before: Option<&'a [u8]>,
    penalties: &'a Penalties,
    count: usize,
}

/// One path's costs at the pixel before, their minimum, and the penalty of a jump from there.
type Before<'a> = (&'a [u8], u8, u8);

fn row<const ADD: bool, const FORWARD: bool>(
    scene: &Scene<'_>,
    last: &Row,
    this: &mut Row,
    kept: &mut [u8],
    sums: &mut [u16],
) {
    let count = scene.count;
    let stride = count + 2;
    let width = scene.grays.len();
    let start = vec![0u8; stride];
    let mut along = [vec![SENTINEL; stride], vec![SENTINEL; stride]];
    let mut along_least = 0;
    let large = &scene.penalties.large;
    for step_x in 0..width {
        let x = if FORWARD { step_x } else { width - 1 - step_x };
        let (behind, ahead) = if FORWARD {
            (x.wrapping_sub(1), x + 1)
        } else {
            (x + 1, x.wrapping_sub(1))
        };
        let gray = scene.grays[x];
        let penalty = |other: u8| large[usize::from(gray.abs_diff(other))];
        let from = |path: usize, place: usize| -> Before<'_> {
            match scene.before {
                Some(before) if place < width => (
                    &last.paths[path][place * stride..(place + 1) * stride],
                    last.least[path][place],
                    penalty(before[place]),
                ),
                _ => (&start[..], 0, 0),
            }
        };
        let [old, new] = &mut along;
        let first: Before<'_> = match step_x {
            0 => (&start[..], 0, 0),
            _ => (&old[..], along_least, penalty(scene.grays[behind])),
        };
        let slot = x * stride..(x + 1) * stride;
        let [a, b, c] = &mut this.paths;
        let least = step::<ADD>(
            &scene.costs[x * count..(x + 1) * count],
            scene.penalties.small,
            [first, from(0, behind), from(1, x), from(2, ahead)],
            new,
            &mut a[slot.clone()],
            &mut b[slot.clone()],
            &mut c[slot],
            &mut kept[x * count..(x + 1) * count],
            if ADD {
                &mut sums[x * count..(x + 1) * count]
            } else {
                &mut []
            },
        );
        along_least = least[0];
        for (path, least) in least[1..].iter().enumerate() {
            this.least[path][x] = *least;
        }
        std::mem::swap(old, new);
    }
}

/// One step of four paths. Their new costs have a place before and after for the sentinels. Half the sum of all four is kept, or, with
/// `ADD`, the sum and twice what is kept written into `sum`. Gives the paths' minima.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
#[allow(
    clippy::too_many_arguments,
    reason = "slices that are arguments of their own are known not to overlap"
)]
fn step<const ADD: bool>(
    cost: &[u8],
    small: u8,
    before: [Before<'_>; 4],
    new_a: &mut [u8],
    new_b: &mut [u8],
    new_c: &mut [u8],
    new_d: &mut [u8],
    kept: &mut [u8],
    sum: &mut [u16],
) -> [u8; 4] {
    let inner = 1..=cost.len();
    let least = [
        path(cost, small, before[0], &mut new_a[inner.clone()]),
        path(cost, small, before[1], &mut new_b[inner.clone()]),
        path(cost, small, before[2], &mut new_c[inner.clone()]),
        path(cost, small, before[3], &mut new_d[inner.clone()]),
    ];
    let pairs = (new_a[inner.clone()].iter().zip(&new_b[inner.clone()]))
        .zip(new_c[inner.clone()].iter().zip(&new_d[inner]));
    // Two paths fit a byte.
    let four = |((&a, &b), (&c, &d)): ((&u8, &u8), (&u8, &u8))| {
        u16::from(a.wrapping_add(b)) + u16::from(c.wrapping_add(d))
    };
    if ADD {
        for ((sum, &kept), paths) in sum.iter_mut().zip(&*kept).zip(pairs) {
            *sum = four(paths) + 2 * u16::from(kept);
        }
    } else {
        for (kept, paths) in kept.iter_mut().zip(pairs) {
            *kept = (four(paths) >> 1) as u8;
        }
    }
    least
}

/// One step of one path (Hirschmüller 2008, Eq. 13):
/// `new(k) = cost(k) + min(old(k), old(k -+ 1) + small, least + large) - least`. `old` has a sentinel before and after.
#[inline(always)]
fn path(cost: &[u8], small: u8, (old, least, large): Before<'_>, new: &mut [u8]) -> u8 {
    let count = cost.len();
    let (lower, same, upper) = (&old[..count], &old[1..=count], &old[2..count + 2]);
    let new = &mut new[..count];
    let jump = least + large;
    let mut minimum = u8::MAX;
    for k in 0..count {
        let beside = lower[k].min(upper[k]).saturating_add(small);
        let path = cost[k].wrapping_add(same[k].min(beside).min(jump).wrapping_sub(least));
        new[k] = path;
        minimum = minimum.min(path);
    }
    minimum
}

/// The winners of the sums over all eight paths. Both sweeps run to the middle, keep their sums, and go on over the rows that the
/// other one has left: what is kept is a byte for each disparity of each pixel, written once and read once, and neither costs nor whole sums of
/// more than a row exist. `kept` is that memory, for use by the next pair.
pub(super) fn winners(
    features: &Features<'_>,
    penalties: &Penalties,
    kept: &mut Vec<u8>,
) -> Winners {
    swept(features, penalties, kept, |_, _| {})
}

/// [`winners`]; the sums of each row, `sums[x * count + k]`, are shown to `look` with the row.
fn swept(
    features: &Features<'_>,
    penalties: &Penalties,
    kept: &mut Vec<u8>,
    look: impl Fn(usize, &[u16]) + Sync,
) -> Winners {
    let row = features.width * features.count;
    let middle = features.height / 2;
    kept.resize(features.height * row, 0);
    let (top, bottom) = kept.split_at_mut(middle * row);
    let mut down = Sweep::new(Way::Down, features, penalties);
    let mut up = Sweep::new(Way::Up, features, penalties);
    rayon::join(
        || {
            for (y, kept) in top.chunks_exact_mut(row).enumerate() {
                down.step(y, Sums::Kept(kept));
            }
        },
        || {
            for (i, kept) in bottom.chunks_exact_mut(row).enumerate().rev() {
                up.step(middle + i, Sums::Kept(kept));
            }
        },
    );
    let mut winners = Winners::new(features);
    let (above, below) = winners.split_rows(middle);
    rayon::join(
        || {
            let rows = bottom.chunks_exact_mut(row).zip(below).enumerate();
            let rows = rows.map(|(i, (kept, out))| (middle + i, kept, out));
            finish(&mut down, rows, &look);
        },
        || {
            let rows = top.chunks_exact_mut(row).zip(above).enumerate().rev();
            let rows = rows.map(|(y, (kept, out))| (y, kept, out));
            finish(&mut up, rows, &look);
        },
    );
    winners
}

/// The rest of a sweep's way, over rows of which the other sweep has kept its sums.
fn finish<'r>(
    sweep: &mut Sweep<'_>,
    rows: impl Iterator<Item = (usize, &'r mut [u8], OutRow<'r>)>,
    look: &impl Fn(usize, &[u16]),
) {
    let mut sums = vec![0u16; sweep.features.width * sweep.features.count];
    let mut of_row = WinnerRow::new(sweep.features);
    for (y, kept, mut out) in rows {
        sweep.step(y, Sums::Added(kept, &mut sums));
        look(y, &sums);
        of_row.find(&mut sums, &mut out);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use vergence_imaging::Gray;

    use super::*;

    /// The costs and the eight paths written out one by one, by the definition; then what the sweeps lose by halving.
    fn plain_sums(features: &Features<'_>, penalties: &Penalties) -> Vec<u16> {
        let (width, height, count) = (
            features.width as i64,
            features.height as i64,
            features.count,
        );
        let mut row = CostRow::default();
        let costs: Vec<u8> = (0..features.height)
            .flat_map(|y| row.of(features, y).to_vec())
            .collect();
        let of_way = |ways: [(i64, i64); 4]| {
            let mut sums = vec![0u16; costs.len()];
            for (dx, dy) in ways {
                let mut path = vec![0i64; sums.len()];
                let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
                let mut order: Vec<(i64, i64)> = rows.collect();
                if dy < 0 || (dy == 0 && dx < 0) {
                    order.reverse();
                }
                for (x, y) in order {
                    let at = ((y * width + x) as usize) * count;
                    let (fx, fy) = (x - dx, y - dy);
                    let inside = (0..width).contains(&fx) && (0..height).contains(&fy);
                    for k in 0..count {
                        let cost = i64::from(costs[at + k]);
                        path[at + k] = cost;
                        if !inside {
                            continue;
                        }
                        let from = ((fy * width + fx) as usize) * count;
                        let old = &path[from..from + count];
                        let least = *old.iter().min().unwrap();
                        let gray = |x: i64, y: i64| features.left.grays.at(x as usize, y as usize);
                        let step = gray(x, y).abs_diff(gray(fx, fy));
                        let large = i64::from(penalties.large[usize::from(step)]);
                        let mut best = old[k].min(least + large);
                        for beside in [k.wrapping_sub(1), k + 1] {
                            if beside < count {
                                best = best.min(old[beside] + i64::from(penalties.small));
                            }
                        }
                        path[at + k] = cost + best - least;
                    }
                }
                for (s, p) in sums.iter_mut().zip(&path) {
                    *s += u16::try_from(*p).unwrap();
                }
            }
            sums
        };
        let down = of_way([(1, 0), (1, 1), (0, 1), (-1, 1)]);
        let up = of_way([(-1, 0), (-1, -1), (0, -1), (1, -1)]);
        let middle = features.height / 2 * features.width * count;
        let both = down.iter().zip(&up).enumerate();
        both.map(|(i, (d, u))| {
            if i < middle {
                d / 2 * 2 + u
            } else {
                d + u / 2 * 2
            }
        })
        .collect()
    }

    fn pair(width: usize, height: usize) -> [Gray; 2] {
        [37, 41]
            .map(|k| Gray::from_fn(width, height, |x, y| ((x * k + y * 91 + x * y) % 256) as u8))
    }

    /// The two sweeps give exactly what eight separate paths give, on rough pictures, at counts that fill vectors of every width and those
    /// that do not, with pictures of one row and one column among them.
    #[test]
    fn sweeps_equal_single_paths() {
        let penalties = Penalties::default();
        for (width, height, count) in [
            (23, 17, 16),
            (9, 8, 48),
            (5, 6, 112),
            (1, 9, 16),
            (9, 1, 32),
        ] {
            let [left, right] = pair(width, height);
            let features = Features::new(&left, &right, -3, count, None);
            let row = width * features.count;
            let found = Mutex::new(vec![0u16; height * row]);
            swept(&features, &penalties, &mut Vec::new(), |y, sums| {
                found.lock().unwrap()[y * row..(y + 1) * row].copy_from_slice(sums);
            });
            let plain = plain_sums(&features, &penalties);
            assert_eq!(
                found.into_inner().unwrap(),
                plain,
                "{width} {height} {count}"
            );
        }
    }

    /// Winners are those of the plain sums: the first of the least, of both eyes; memory of a larger pair does not matter.
    #[test]
    fn winners_are_the_least_sums() {
        let penalties = Penalties::default();
        let [left, right] = pair(23, 17);
        let features = Features::new(&left, &right, -3, 48, None);
        let winners = winners(&features, &penalties, &mut vec![9; 1 << 17]);
        let sums = plain_sums(&features, &penalties);
        let sum = |x: usize, y: usize, k: usize| sums[(y * 23 + x) * 48 + k];
        for y in 0..17 {
            for x in 0..23 {
                let k = (0..48).min_by_key(|&k| sum(x, y, k)).unwrap();
                let d = winners.left.at(x, y) + 3.0;
                assert!((d - k as f32).abs() <= 0.5, "{d} for {k}");
                // Right column x is seen by left columns x - 3 + k.
                let leads = |k: usize| (x + k).checked_sub(3).filter(|&x| x < 23);
                let right = (0..48).filter(|&k| leads(k).is_some());
                let best = right.min_by_key(|&k| sum(leads(k).unwrap(), y, k));
                let d = winners.right.at(x, y) + 3.0;
                assert!((d - best.unwrap() as f32).abs() <= 0.5, "{d} for {best:?}");
            }
        }
    }
}
