//! Costs summed along eight paths (Hirschmüller 2008) in two sweeps that meet in the middle of the picture.

use super::cost::{CostRow, Costs, Features, LANES, PixelCosts};
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

/// The costs of one path at the pixels of a row, counted along the sweep's way, and their minima. The next row is written where this one
/// is no longer needed: from row to row a pixel moves down by as many slots (two, one or none for the path from behind, from before and from
/// ahead) as it takes for what a pixel reads to lie one slot above what it writes. So only one row is held, and nearer caches hold it.
struct Trail {
    /// [`SPARE`] slots more than pixels, each `count` + 2.
    costs: Vec<u8>,
    least: Vec<u8>,
    stride: usize,
    /// Slot of the row's first pixel.
    start: usize,
}

/// As many slots as a row moves at most.
const SPARE: usize = 2;

impl Trail {
    fn new(width: usize, stride: usize) -> Self {
        Self {
            costs: vec![SENTINEL; (width + SPARE) * stride],
            least: vec![0; width + SPARE],
            stride,
            start: 0,
        }
    }

    fn next_row(&mut self, moves: usize) {
        let slots = self.least.len();
        self.start = (self.start + slots - moves) % slots;
    }

    /// What a pixel's predecessor left, with its minimum, and the slot of the pixel itself.
    #[inline(always)]
    fn at(&mut self, pixel: usize) -> (&[u8], u8, Slot<'_>) {
        let (slots, stride) = (self.least.len(), self.stride);
        let mut slot = self.start + pixel;
        if slot >= slots {
            slot -= slots;
        }
        let (above, old, new) = if slot + 1 < slots {
            let (low, high) = self.costs.split_at_mut((slot + 1) * stride);
            (slot + 1, &high[..stride], &mut low[slot * stride..])
        } else {
            let (low, high) = self.costs.split_at_mut(slot * stride);
            (0, &low[..stride], &mut high[..stride])
        };
        let old_least = self.least[above];
        let least = &mut self.least[slot];
        (old, old_least, Slot { costs: new, least })
    }
}

/// Where a pixel's costs go.
struct Slot<'a> {
    costs: &'a mut [u8],
    least: &'a mut u8,
}

/// One sweep under way.
struct Sweep<'a> {
    way: Way,
    features: &'a Features<'a>,
    penalties: &'a Penalties,
    costs: CostRow,
    /// From behind, from before and from ahead in the last row.
    trails: [Trail; 3],
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
            trails: std::array::from_fn(|_| Trail::new(features.width, stride)),
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
        for (moves, trail) in [2, 1, 0].into_iter().zip(&mut self.trails) {
            trail.next_row(moves);
        }
        let trails = &mut self.trails;
        match (self.way, sums) {
            (Way::Down, Sums::Kept(kept)) => {
                row::<false, true>(&scene, trails, kept, &mut []);
            }
            (Way::Up, Sums::Kept(kept)) => {
                row::<false, false>(&scene, trails, kept, &mut []);
            }
            (Way::Down, Sums::Added(kept, sums)) => {
                row::<true, true>(&scene, trails, kept, sums);
            }
            (Way::Up, Sums::Added(kept, sums)) => {
                row::<true, false>(&scene, trails, kept, sums);
            }
        }
        self.started = true;
    }
}

struct Scene<'a> {
    costs: Costs<'a>,
    grays: &'a [u8],
    before: Option<&'a [u8]>,
    penalties: &'a Penalties,
    count: usize,
}

/// One path's costs at the pixel before, their minimum, and the penalty of a jump from there.
type Before<'a> = (&'a [u8], u8, u8);

/// One row of a sweep. Half the sum of all four paths is kept, or, with `ADD`, the sum and twice what is kept written into `sums`.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512vpopcntdq+popcnt",
    "x86_64+avx2+popcnt",
    "x86_64+popcnt"
))]
fn row<const ADD: bool, const FORWARD: bool>(
    scene: &Scene<'_>,
    trails: &mut [Trail; 3],
    kept: &mut [u8],
    sums: &mut [u16],
) {
    let (count, width) = (scene.count, scene.grays.len());
    let stride = count + 2;
    let start = vec![0u8; stride];
    let mut along = [vec![SENTINEL; stride], vec![SENTINEL; stride]];
    let mut along_least = 0;
    let large = &scene.penalties.large;
    let [behind_trail, before_trail, ahead_trail] = trails;
    for pixel in 0..width {
        let x = if FORWARD { pixel } else { width - 1 - pixel };
        let (behind, ahead) = if FORWARD {
            (x.wrapping_sub(1), x + 1)
        } else {
            (x + 1, x.wrapping_sub(1))
        };
        let gray = scene.grays[x];
        let penalty = |other: u8| large[usize::from(gray.abs_diff(other))];
        let known = |place: usize, old, least| -> Before<'_> {
            match scene.before {
                Some(before) if place < width => (old, least, penalty(before[place])),
                _ => (&start[..], 0, 0),
            }
        };
        let [old, new] = &mut along;
        let first: Before<'_> = match pixel {
            0 => (&start[..], 0, 0),
            _ => (&old[..], along_least, penalty(scene.grays[behind])),
        };
        let (a_old, a_least, a) = behind_trail.at(pixel);
        let (b_old, b_least, b) = before_trail.at(pixel);
        let (c_old, c_least, c) = ahead_trail.at(pixel);
        let least = step::<ADD>(
            &scene.costs.at(x),
            count,
            scene.penalties.small,
            [
                first,
                known(behind, a_old, a_least),
                known(x, b_old, b_least),
                known(ahead, c_old, c_least),
            ],
            new,
            a.costs,
            b.costs,
            c.costs,
            &mut kept[x * count..(x + 1) * count],
            if ADD {
                &mut sums[x * count..(x + 1) * count]
            } else {
                &mut []
            },
        );
        [along_least, *a.least, *b.least, *c.least] = least;
        std::mem::swap(old, new);
    }
}

/// One step of four paths, at a pixel with `count` disparities. The paths' new costs have a place before and after for the sentinels. Gives
/// the paths' minima.
#[inline(always)]
#[allow(
    clippy::too_many_arguments,
    reason = "slices that are arguments of their own are known not to overlap"
)]
fn step<const ADD: bool>(
    costs: &PixelCosts<'_>,
    count: usize,
    small: u8,
    before: [Before<'_>; 4],
    new_a: &mut [u8],
    new_b: &mut [u8],
    new_c: &mut [u8],
    new_d: &mut [u8],
    kept: &mut [u8],
    sum: &mut [u16],
) -> [u8; 4] {
    let mut minima = [[u8::MAX; WIDE]; 4];
    let mut from = 0;
    while from + WIDE <= count {
        let cost = costs.block::<WIDE>(from);
        let paths = [
            path_block::<WIDE>(from, &cost, small, before[0], new_a, &mut minima[0]),
            path_block::<WIDE>(from, &cost, small, before[1], new_b, &mut minima[1]),
            path_block::<WIDE>(from, &cost, small, before[2], new_c, &mut minima[2]),
            path_block::<WIDE>(from, &cost, small, before[3], new_d, &mut minima[3]),
        ];
        add_up::<ADD, WIDE>(from, &paths, kept, sum);
        from += WIDE;
    }
    while from < count {
        let cost = costs.block::<LANES>(from);
        let [a, b, c, d] = &mut minima;
        let (a, b) = (block_mut::<u8, LANES>(a, 0), block_mut::<u8, LANES>(b, 0));
        let (c, d) = (block_mut::<u8, LANES>(c, 0), block_mut::<u8, LANES>(d, 0));
        let paths = [
            path_block::<LANES>(from, &cost, small, before[0], new_a, a),
            path_block::<LANES>(from, &cost, small, before[1], new_b, b),
            path_block::<LANES>(from, &cost, small, before[2], new_c, c),
            path_block::<LANES>(from, &cost, small, before[3], new_d, d),
        ];
        add_up::<ADD, LANES>(from, &paths, kept, sum);
        from += LANES;
    }
    // Loops, not closures: what calls those is compiled without the features of this function.
    let mut least = [u8::MAX; 4];
    for path in 0..4 {
        for k in 0..WIDE {
            least[path] = least[path].min(minima[path][k]);
        }
    }
    least
}

/// Loops go over so many disparities at a time, and over [`LANES`] of a rest: lengths that are known become vectors without remainders.
const WIDE: usize = 2 * LANES;

/// `N` places of a slice from `from` on.
#[inline(always)]
fn block<T, const N: usize>(slice: &[T], from: usize) -> &[T; N] {
    slice[from..].first_chunk().expect("a whole block")
}

#[inline(always)]
fn block_mut<T, const N: usize>(slice: &mut [T], from: usize) -> &mut [T; N] {
    slice[from..].first_chunk_mut().expect("a whole block")
}

/// The sums of all four paths at `N` disparities.
#[inline(always)]
fn add_up<const ADD: bool, const N: usize>(
    from: usize,
    [a, b, c, d]: &[[u8; N]; 4],
    kept: &mut [u8],
    sum: &mut [u16],
) {
    let kept: &mut [u8; N] = block_mut(kept, from);
    let old = *kept;
    // Two paths fit a byte.
    let four = |i: usize| u16::from(a[i].wrapping_add(b[i])) + u16::from(c[i].wrapping_add(d[i]));
    if ADD {
        let sum: &mut [u16; N] = block_mut(sum, from);
        for i in 0..N {
            sum[i] = four(i) + 2 * u16::from(old[i]);
        }
    } else {
        for i in 0..N {
            kept[i] = (four(i) >> 1) as u8;
        }
    }
}

/// One step of one path at `N` disparities (Hirschmüller 2008, Eq. 13):
/// `new(k) = cost(k) + min(old(k), old(k -+ 1) + small, least + large) - least`. `old` has a sentinel before and after.
#[inline(always)]
fn path_block<const N: usize>(
    from: usize,
    cost: &[u8; N],
    small: u8,
    (old, least, large): Before<'_>,
    new: &mut [u8],
    minimum: &mut [u8; N],
) -> [u8; N] {
    let (lower, same, upper): ([u8; N], [u8; N], [u8; N]) = (
        *block(old, from),
        *block(old, from + 1),
        *block(old, from + 2),
    );
    let jump = least + large;
    let mut path = [0; N];
    for k in 0..N {
        let beside = lower[k].min(upper[k]).saturating_add(small);
        path[k] = cost[k].wrapping_add(same[k].min(beside).min(jump).wrapping_sub(least));
    }
    for k in 0..N {
        minimum[k] = minimum[k].min(path[k]);
    }
    *block_mut(new, from + 1) = path;
    path
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
    let cells = features.height * row;
    if kept.len() < cells {
        kept.resize(cells, 0);
    }
    let (top, bottom) = kept[..cells].split_at_mut(middle * row);
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
        let mut costs = vec![0; features.width * features.height * features.count];
        for (i, costs) in costs.chunks_exact_mut(count).enumerate() {
            let of_row = row.of(features, i / features.width);
            for (k, costs) in costs.chunks_exact_mut(LANES).enumerate() {
                let block: [u8; LANES] = of_row.at(i % features.width).block(k * LANES);
                costs.copy_from_slice(&block);
            }
        }
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
