//! Bilinear 8-bit rows in fixed point: the exact value at the map's place, rounded, halves up.
//!
//! A block of pixels is first fetched into a buffer, one by one, then computed, all at once in the widest vectors that the machine
//! has: weights are of 8 bits, so that a lane of 16 bits holds the sum of a column and one of 32 bits that of a square.

// Lanes of several buffers are read best with indices.
#![allow(clippy::needless_range_loop)]

use multiversion::multiversion;

use super::Source;
use super::fetch::{BLOCK, block, fetch};
use super::map::FRACTION_BITS;

const ONE: u32 = 1 << FRACTION_BITS;
const HALF: u32 = ONE * ONE / 2;
/// Two samples of 8 bits in lanes of 16.
const PAIR: u32 = 0x00ff_00ff;

/// A row of three channels; whether all of it comes from within the source's border.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(super) fn row_of_three(source: Source<'_, u8>, us: &[i32], vs: &[i32], out: &mut [u8]) -> bool {
    source.fetch_lines::<3>(us, vs, 1);
    let (mut upper, mut lower) = ([0_u64; BLOCK], [0_u64; BLOCK]);
    let mut mixed = [0_u32; BLOCK];
    // Two pixels are stored at a time, with two bytes to spare.
    let mut packed = [0_u8; 3 * BLOCK + 2];
    let mut inner = true;
    let (mut short_us, mut short_vs) = ([0; BLOCK], [0; BLOCK]);
    let blocks = us.chunks(BLOCK).zip(vs.chunks(BLOCK));
    for (out, (us, vs)) in out.chunks_mut(3 * BLOCK).zip(blocks) {
        let (us, vs) = (block(us, &mut short_us), block(vs, &mut short_vs));
        inner &= fetch::<u8, 3, 8>(
            &source,
            us,
            vs,
            |i, bytes| upper[i] = u64::from_le_bytes(bytes),
            |i, bytes| lower[i] = u64::from_le_bytes(bytes),
        );
        for i in 0..BLOCK {
            let (x, y) = (us[i] as u32 & (ONE - 1), vs[i] as u32 & (ONE - 1));
            let column = |a: u32, b: u32| a * (ONE - y) + b * y;
            let cell = |a: u32, b: u32| (a * (ONE - x) + b * x + HALF) >> (2 * FRACTION_BITS);
            let (a, b) = (upper[i] as u32, lower[i] as u32);
            let (c, d) = ((upper[i] >> 24) as u32, (lower[i] >> 24) as u32);
            // Red and blue share a word of 32 bits until columns are done.
            let left = column(a & PAIR, b & PAIR);
            let right = column(c & PAIR, d & PAIR);
            let green = cell(
                column(a >> 8 & 255, b >> 8 & 255),
                column(c >> 8 & 255, d >> 8 & 255),
            );
            let red = cell(left & 0xffff, right & 0xffff);
            let blue = cell(left >> 16, right >> 16);
            mixed[i] = red | green << 8 | blue << 16;
        }
        for i in 0..BLOCK / 2 {
            let two = u64::from(mixed[2 * i]) | u64::from(mixed[2 * i + 1]) << 24;
            packed[6 * i..6 * i + 8].copy_from_slice(&two.to_le_bytes());
        }
        out.copy_from_slice(&packed[..out.len()]);
    }
    inner
}

/// A row of one channel; whether all of it comes from within the source's border.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(super) fn row_of_one(source: Source<'_, u8>, us: &[i32], vs: &[i32], out: &mut [u8]) -> bool {
    source.fetch_lines::<1>(us, vs, 1);
    let (mut upper, mut lower) = ([0_u16; BLOCK], [0_u16; BLOCK]);
    let mut mixed = [0_u8; BLOCK];
    let mut inner = true;
    let (mut short_us, mut short_vs) = ([0; BLOCK], [0; BLOCK]);
    let blocks = us.chunks(BLOCK).zip(vs.chunks(BLOCK));
    for (out, (us, vs)) in out.chunks_mut(BLOCK).zip(blocks) {
        let (us, vs) = (block(us, &mut short_us), block(vs, &mut short_vs));
        inner &= fetch::<u8, 1, 2>(
            &source,
            us,
            vs,
            |i, bytes| upper[i] = u16::from_le_bytes(bytes),
            |i, bytes| lower[i] = u16::from_le_bytes(bytes),
        );
        for i in 0..BLOCK {
            let (x, y) = (us[i] as u32 & (ONE - 1), vs[i] as u32 & (ONE - 1));
            let (a, b) = (u32::from(upper[i]), u32::from(lower[i]));
            let left = (a & 255) * (ONE - y) + (b & 255) * y;
            let right = (a >> 8) * (ONE - y) + (b >> 8) * y;
            mixed[i] = ((left * (ONE - x) + right * x + HALF) >> (2 * FRACTION_BITS)) as u8;
        }
        out.copy_from_slice(&mixed[..out.len()]);
    }
    inner
}
