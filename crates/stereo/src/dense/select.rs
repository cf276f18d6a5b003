//! Winners of both eyes, sub-pixel, and what survives the check of one against the other.

use vergence_imaging::Plane;

use super::Seen;
use super::census::CostVolume;

/// Two maps agree within this, map px.
const AGREE_PX: f32 = 1.01;

/// Neighbours within this belong to one island, map px.
const SAME_ISLAND_PX: f32 = 1.0;

/// Best disparity of each pixel, map px.
pub(super) struct Winners {
    left: Plane<f32>,
    right: Plane<f32>,
}

/// The disparity of least summed cost at each pixel of each eye.
pub(super) fn winners(sums: &[u16], costs: &CostVolume) -> Winners {
    let (width, count, first) = (costs.width, costs.count, costs.first);
    let mut left = Plane::filled(width, costs.height, 0.0f32);
    let mut right = left.clone();
    let mut best: Vec<(u16, u16)> = vec![(0, 0); width];
    for y in 0..costs.height {
        let row = &sums[y * width * count..(y + 1) * width * count];
        best.fill((u16::MAX, 0));
        for (x, (sums, out)) in row.chunks_exact(count).zip(left.row_mut(y)).enumerate() {
            *out = first as f32 + refined(count, least_of(sums), |k| sums[k]);
            right_minima(sums, x as i64 - i64::from(first), &mut best);
        }
        for (xr, (out, &(sum, k))) in right.row_mut(y).iter_mut().zip(&best).enumerate() {
            if sum == u16::MAX {
                *out = f32::NAN;
                continue;
            }
            let at = |k: usize| {
                let x = xr as i64 + i64::from(first) + k as i64;
                match usize::try_from(x) {
                    Ok(x) if x < width => row[x * count + k],
                    _ => u16::MAX,
                }
            };
            *out = first as f32 + refined(count, usize::from(k), at);
        }
    }
    Winners { left, right }
}

fn least_of(sums: &[u16]) -> usize {
    let least = sums.iter().fold(u16::MAX, |a, &b| a.min(b));
    sums.iter().position(|&s| s == least).unwrap_or(0)
}

/// Left pixel's sums go to the right pixels `from - k`.
fn right_minima(sums: &[u16], from: i64, best: &mut [(u16, u16)]) {
    let start = (from - best.len() as i64 + 1).clamp(0, sums.len() as i64);
    let end = (from + 1).clamp(start, sums.len() as i64);
    for k in start..end {
        let entry = &mut best[(from - k) as usize];
        let sum = sums[k as usize];
        if sum < entry.0 {
            *entry = (sum, k as u16);
        }
    }
}

/// The minimum between its neighbours by two lines of equal and opposite slope.
fn refined(count: usize, k: usize, sum: impl Fn(usize) -> u16) -> f32 {
    if k == 0 || k + 1 >= count {
        return k as f32;
    }
    let [a, b, c] = [sum(k - 1), sum(k), sum(k + 1)];
    if a == u16::MAX || c == u16::MAX {
        return k as f32;
    }
    let [a, b, c] = [a, b, c].map(f32::from);
    let steep = (a - b).max(c - b);
    match steep > 0.0 {
        true => k as f32 + 0.5 * (a - c) / steep,
        false => k as f32,
    }
}

/// Disparities in full px with NaN for the rest, and what each pixel is.
pub(super) type Checked = (Plane<f32>, Plane<Seen>);

impl Winners {
    /// What both agree on, in full pixels.
    pub(super) fn checked(&self, min_island: usize, scale: f64) -> [Checked; 2] {
        let mut left = checked_against(&self.left, &self.right, -1.0);
        let mut right = checked_against(&self.right, &self.left, 1.0);
        for map in [&mut left, &mut right] {
            drop_islands(map, min_island);
            for d in map.0.samples_mut() {
                *d *= scale as f32;
            }
        }
        [left, right]
    }
}

/// `sign`: where the other eye has it, `x + sign * disparity`.
fn checked_against(own: &Plane<f32>, other: &Plane<f32>, sign: f32) -> Checked {
    let (width, height) = own.size();
    let mut map = own.clone();
    let mut seen = Plane::filled(width, height, Seen::Both);
    for y in 0..height {
        let reached = reached_from(other.row(y), -sign);
        for (x, reached) in reached.iter().enumerate() {
            let d = own.at(x, y);
            let there = (x as f32 + sign * d).round();
            let inside = there >= 0.0 && there < width as f32;
            let agrees = inside && (other.at(there as usize, y) - d).abs() <= AGREE_PX;
            if !agrees {
                map.set(x, y, f32::NAN);
                let occluded = !inside || !reached;
                seen.set(
                    x,
                    y,
                    if occluded {
                        Seen::Occluded
                    } else {
                        Seen::Unknown
                    },
                );
            }
        }
    }
    (map, seen)
}

/// Which pixels the other eye's disparities lead to, give or take one.
fn reached_from(other: &[f32], sign: f32) -> Vec<bool> {
    let mut reached = vec![false; other.len()];
    for (x, d) in other.iter().enumerate() {
        let at = (x as f32 + sign * d).round();
        if at >= 0.0 && (at as usize) < reached.len() {
            reached[at as usize] = true;
        }
    }
    reached
}

/// Connected areas of smooth disparity with fewer pixels than `least` become unknown.
fn drop_islands((map, seen): &mut Checked, least: usize) {
    let (width, height) = map.size();
    let mut visited = vec![false; width * height];
    let (mut stack, mut island) = (Vec::new(), Vec::new());
    for start in 0..width * height {
        if visited[start] || map.samples()[start].is_nan() {
            continue;
        }
        visited[start] = true;
        stack.push(start);
        island.clear();
        while let Some(at) = stack.pop() {
            island.push(at);
            let (x, d) = (at % width, map.samples()[at]);
            let neighbours = [
                (x > 0).then(|| at - 1),
                (x + 1 < width).then(|| at + 1),
                at.checked_sub(width),
                Some(at + width).filter(|&n| n < width * height),
            ];
            for n in neighbours.into_iter().flatten() {
                if !visited[n] && (map.samples()[n] - d).abs() <= SAME_ISLAND_PX {
                    visited[n] = true;
                    stack.push(n);
                }
            }
        }
        if island.len() < least {
            for &at in &island {
                map.samples_mut()[at] = f32::NAN;
                seen.samples_mut()[at] = Seen::Unknown;
            }
        }
    }
}
