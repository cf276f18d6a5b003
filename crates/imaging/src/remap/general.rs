//! Rows of any kernel, type and number of channels in single precision.
//!
//! A pixel's taps lie side by side in each of its rows, channels included: they are summed down the rows as one vector, many such
//! vectors are weighted across as one long one, and the taps of each channel are added by sums of that one shifted against itself.

// Lanes of several buffers are read best with indices.
#![allow(clippy::needless_range_loop)]

use multiversion::multiversion;

use super::fetch;
use super::kernel::{Kernel, MAX_TAPS, PHASES};
use super::map::{FRACTION_BITS, holds};
use super::{Pixel, Sample, Source};

/// Pixels computed at once.
const BLOCK: usize = 32;
/// Most samples that are read in one row for one pixel.
const MAX_LANES: usize = 24;
/// A shifted sum reads up to this many entries beyond a block.
const BEYOND: usize = MAX_LANES;

/// Makes one row of samples from the map's columns and rows.
pub(super) type RowFunction<S> = Box<dyn Fn(Source<'_, S>, &[i32], &[i32], &mut [S])>;

/// The function of a kernel for a pixel's type.
pub(super) fn row_function<P: Pixel>(kernel: Kernel) -> RowFunction<P::Sample> {
    // Lanes are taps times channels, rounded up to whole vectors.
    match (kernel, P::CHANNELS) {
        (Kernel::Bilinear, 1) => Box::new(row_of_one::<P::Sample>),
        (Kernel::Bilinear, _) => row_with::<P::Sample, 3, 2, 8>(kernel),
        (Kernel::Bicubic, 1) => row_with::<P::Sample, 1, 4, 4>(kernel),
        (Kernel::Bicubic, _) => row_with::<P::Sample, 3, 4, 16>(kernel),
        (Kernel::Lanczos3, 1) => row_with::<P::Sample, 1, 6, 8>(kernel),
        (Kernel::Lanczos3, _) => row_with::<P::Sample, 3, 6, 24>(kernel),
    }
}

fn row_with<S: Sample, const C: usize, const T: usize, const L: usize>(
    kernel: Kernel,
) -> RowFunction<S> {
    let down = kernel.table();
    // Each tap's weight for each channel; none for lanes beyond the taps.
    let across: Vec<[f32; L]> = down
        .iter()
        .map(|weights| std::array::from_fn(|l| if l < T * C { weights[l / C] } else { 0.0 }))
        .collect();
    Box::new(move |source, us, vs, out| {
        row::<S, C, T, L>(source, us, vs, (down, &across), out);
    })
}

/// Weights of the taps down, and of the lanes across.
type Tables<'a, const L: usize> = (&'a [[f32; MAX_TAPS]; PHASES], &'a [[f32; L]]);

/// A row with `C` channels, `T` taps and `L` lanes.
#[multiversion(targets("x86_64+avx2"))]
fn row<S: Sample, const C: usize, const T: usize, const L: usize>(
    source: Source<'_, S>,
    us: &[i32],
    vs: &[i32],
    (down, across): Tables<'_, L>,
    out: &mut [S],
) {
    source.fetch_lines::<C>(us, vs, T / 2);
    let mut columns = [0.0_f32; BLOCK * MAX_LANES + BEYOND];
    let mut values = [S::default(); BLOCK * MAX_LANES];
    let blocks = us.chunks(BLOCK).zip(vs.chunks(BLOCK));
    for (out, (us, vs)) in out.chunks_mut(C * BLOCK).zip(blocks) {
        let filled = us.len() * L;
        let places = us.iter().zip(vs);
        for (lanes, (&u, &v)) in columns.as_chunks_mut::<L>().0.iter_mut().zip(places) {
            let (y, x) = (v as usize % PHASES, u as usize % PHASES);
            weighted::<S, C, T, L>(&source, [u, v], &down[y], &across[x], lanes);
        }
        for i in 0..filled {
            let mut sum = columns[i];
            for t in 1..T {
                sum += columns[i + t * C];
            }
            values[i] = S::from_f32(sum);
        }
        for (px, lanes) in out.chunks_exact_mut(C).zip(values.chunks_exact(L)) {
            px.copy_from_slice(&lanes[..C]);
        }
    }
}

/// A bilinear row of one channel: its taps are too few to fill a vector, so that it is pixels that lie side by side.
#[multiversion(targets("x86_64+avx2"))]
fn row_of_one<S: Sample>(source: Source<'_, S>, us: &[i32], vs: &[i32], out: &mut [S]) {
    source.fetch_lines::<1>(us, vs, 1);
    let (mut upper, mut lower) = (
        [[S::default(); 2]; fetch::BLOCK],
        [[S::default(); 2]; fetch::BLOCK],
    );
    let mut values = [S::default(); fetch::BLOCK];
    let (mut short_us, mut short_vs) = ([0; fetch::BLOCK], [0; fetch::BLOCK]);
    let fraction = |c: i32| (c & (PHASES as i32 - 1)) as f32 / PHASES as f32;
    let blocks = us.chunks(fetch::BLOCK).zip(vs.chunks(fetch::BLOCK));
    for (out, (us, vs)) in out.chunks_mut(fetch::BLOCK).zip(blocks) {
        let (us, vs) = (
            fetch::block(us, &mut short_us),
            fetch::block(vs, &mut short_vs),
        );
        fetch::fetch::<S, 1, 2>(
            &source,
            us,
            vs,
            |i, pair| upper[i] = pair,
            |i, pair| lower[i] = pair,
        );
        for i in 0..fetch::BLOCK {
            let (x, y) = (fraction(us[i]), fraction(vs[i]));
            let [a, b] = upper[i].map(S::to_f32);
            let [c, d] = lower[i].map(S::to_f32);
            let (left, right) = (a * (1.0 - y) + c * y, b * (1.0 - y) + d * y);
            values[i] = S::from_f32(left * (1.0 - x) + right * x);
        }
        out.copy_from_slice(&values[..out.len()]);
    }
}

/// The rows of taps around a place, summed by their weights down, times those across; zeros outside the source.
#[inline(always)]
fn weighted<S: Sample, const C: usize, const T: usize, const L: usize>(
    source: &Source<'_, S>,
    [u, v]: [i32; 2],
    down: &[f32; MAX_TAPS],
    across: &[f32; L],
    lanes: &mut [f32; L],
) {
    let Source {
        samples,
        width,
        height,
    } = *source;
    let reach = T as i32 / 2 - 1;
    let (x, y) = ((u >> FRACTION_BITS) - reach, (v >> FRACTION_BITS) - reach);
    let row = width * C;
    let inner = x >= 0 && y >= 0 && x as usize + T <= width && y as usize + T <= height;
    let at = (y as usize)
        .wrapping_mul(row)
        .wrapping_add((x as usize).wrapping_mul(C));
    if inner && let Some(near) = samples.get(at..at + (T - 1) * row + L) {
        let rows: [&[S; L]; T] = std::array::from_fn(|t| {
            let lanes = near[t * row..].first_chunk();
            lanes.expect("the last row has L samples, the others more")
        });
        for l in 0..L {
            let mut sum = rows[0][l].to_f32() * down[0];
            for t in 1..T {
                sum += rows[t][l].to_f32() * down[t];
            }
            lanes[l] = sum * across[l];
        }
        return;
    }
    *lanes = [0.0; L];
    if !holds((width, height), u, v) {
        return;
    }
    for t in 0..T {
        let y = (y + t as i32).clamp(0, height as i32 - 1) as usize;
        for k in 0..T {
            let x = (x + k as i32).clamp(0, width as i32 - 1) as usize;
            for c in 0..C {
                lanes[k * C + c] += down[t] * samples[y * row + x * C + c].to_f32();
            }
        }
    }
    for l in 0..L {
        lanes[l] *= across[l];
    }
}
