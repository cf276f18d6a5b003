//! Fetching the square of pixels around each place of a block, before all are computed at once.

use super::map::{FRACTION_BITS, holds};
use super::{Sample, Source};

/// Pixels computed at once.
pub(super) const BLOCK: usize = 64;

/// Places of a block; those that a short one lacks are pixel (0, 0), in `memory`.
#[inline(always)]
pub(super) fn block<'a>(places: &'a [i32], memory: &'a mut [i32; BLOCK]) -> &'a [i32; BLOCK] {
    if let Ok(whole) = places.try_into() {
        return whole;
    }
    *memory = [0; BLOCK];
    memory[..places.len()].copy_from_slice(places);
    memory
}

/// `N` samples from the upper left and from the lower left sample of each place, zeros outside the source; whether none is near its border.
#[inline(always)]
pub(super) fn fetch<S: Sample, const C: usize, const N: usize>(
    source: &Source<'_, S>,
    us: &[i32; BLOCK],
    vs: &[i32; BLOCK],
    mut upper: impl FnMut(usize, [S; N]),
    mut lower: impl FnMut(usize, [S; N]),
) -> bool {
    let Source {
        samples,
        width,
        height,
    } = *source;
    let row = width * C;
    let (columns, rows) = (width as u32 - 1, height as u32 - 1);
    // Where the square around a place lies in the picture, and its samples, read N at a time, before its end.
    let end = samples.len().saturating_sub(row + N - 1) as u32;
    let mut at = [0_u32; BLOCK];
    let mut inner = true;
    for i in 0..BLOCK {
        let x = (us[i] >> FRACTION_BITS) as u32;
        let y = (vs[i] >> FRACTION_BITS) as u32;
        at[i] = y
            .wrapping_mul(row as u32)
            .wrapping_add(x.wrapping_mul(C as u32));
        inner &= (x < columns) & (y < rows) & (at[i] < end);
    }
    if inner {
        for i in 0..BLOCK {
            let at = at[i] as usize;
            upper(i, samples_at(samples, at));
            lower(i, samples_at(samples, at + row));
        }
        return true;
    }
    for i in 0..BLOCK {
        let (a, b) = if holds((width, height), us[i], vs[i]) {
            let x = us[i] >> FRACTION_BITS;
            let y = vs[i] >> FRACTION_BITS;
            let of_row = |y: i32| {
                let y = y.clamp(0, rows as i32) as usize;
                repeated::<S, C, N>(&samples[y * row..(y + 1) * row], x)
            };
            (of_row(y), of_row(y + 1))
        } else {
            ([S::default(); N], [S::default(); N])
        };
        upper(i, a);
        lower(i, b);
    }
    false
}

#[inline(always)]
fn samples_at<S: Sample, const N: usize>(samples: &[S], at: usize) -> [S; N] {
    let mut near = [S::default(); N];
    near.copy_from_slice(&samples[at..at + N]);
    near
}

/// Two pixels of a row from column `x`, the row's ends repeated.
#[inline(always)]
fn repeated<S: Sample, const C: usize, const N: usize>(row: &[S], x: i32) -> [S; N] {
    let mut near = [S::default(); N];
    let last = (row.len() / C) as i32 - 1;
    for k in 0..2 {
        let from = (x + k).clamp(0, last) as usize * C;
        let to = k as usize * C;
        near[to..to + C].copy_from_slice(&row[from..from + C]);
    }
    near
}
