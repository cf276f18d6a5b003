//! Copies that go past the caches (non-temporal stores) and reads asked for ahead, for arrays too large for the caches.
//! On x86-64; elsewhere plain copies and no prefetch.

use std::ops::Range;

/// A cache line of every machine that this was measured on.
const LINE_BYTES: usize = 64;

/// Copies `from` into `to`, of one length, past the caches. Call [`finish`] after the last one.
#[inline(always)]
pub(super) fn copy(from: &[f64], to: &mut [f64]) {
    assert_eq!(
        from.len(),
        to.len(),
        "stream::copy needs slices of one length"
    );
    #[cfg(target_arch = "x86_64")]
    x86_64::copy(from, to);
    #[cfg(not(target_arch = "x86_64"))]
    to.copy_from_slice(from);
}

/// How many values lie before the first whole cache line.
pub(super) fn to_line_end(values: &[f64]) -> usize {
    values.as_ptr().align_offset(LINE_BYTES)
}

/// Asks for the cache lines of a range of `values`; what lies beyond their end is left out.
#[inline(always)]
pub(super) fn prefetch(values: &[f64], range: Range<usize>) {
    #[cfg(target_arch = "x86_64")]
    x86_64::prefetch(values, range);
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, range);
}

/// Makes streamed results visible in the order in which the program goes on.
#[inline(always)]
pub(super) fn finish() {
    #[cfg(target_arch = "x86_64")]
    x86_64::finish();
}

// The language has no safe word for a non-temporal store or a prefetch. Without the first every result costs the memory
// a read as well, without the second the inputs wait at every page.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod x86_64 {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_loadu_pd, _mm_prefetch, _mm_sfence, _mm_stream_pd};
    use std::ops::Range;

    /// Doubles that one store takes.
    const LANES: usize = 2;
    /// Alignment that the store needs, bytes.
    const ALIGN: usize = 16;
    /// Doubles in a cache line.
    const LINE: usize = super::LINE_BYTES / size_of::<f64>();

    #[inline(always)]
    pub(super) fn copy(from: &[f64], to: &mut [f64]) {
        let head = to.as_ptr().align_offset(ALIGN).min(to.len());
        let (from_head, from_rest) = from.split_at(head);
        let (to_head, to_rest) = to.split_at_mut(head);
        to_head.copy_from_slice(from_head);
        let (to_pairs, to_tail) = to_rest.as_chunks_mut::<LANES>();
        let (from_pairs, from_tail) = from_rest.as_chunks::<LANES>();
        for (from, to) in from_pairs.iter().zip(to_pairs) {
            // SAFETY: both arrays hold two doubles; `to` is aligned to 16 bytes because the head was split off there and
            // every pair is 16 bytes long. SSE2 is part of x86-64. The caller fences before it hands the results out.
            unsafe { _mm_stream_pd(to.as_mut_ptr(), _mm_loadu_pd(from.as_ptr())) };
        }
        to_tail.copy_from_slice(from_tail);
    }

    #[inline(always)]
    pub(super) fn prefetch(values: &[f64], range: Range<usize>) {
        for line in values.get(range).unwrap_or_default().chunks(LINE) {
            // SAFETY: the pointer is that of a slice that is borrowed here; a prefetch changes nothing. SSE is part of
            // x86-64.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
        }
    }

    #[inline(always)]
    pub(super) fn finish() {
        // SAFETY: SSE, which holds this instruction, is part of x86-64.
        unsafe { _mm_sfence() };
    }
}
