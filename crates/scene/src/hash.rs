//! Counter-based randomness: a number in, a well-mixed number out, no state.

/// Mixes 64 bits (the finaliser of SplitMix64; Steele, Lea & Flood 2014).
pub const fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Uniform in [0, 1) from 64 well-mixed bits.
pub fn uniform_from(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// Uniform in [0, 1) for the `n`-th draw of a stream.
pub(crate) fn uniform(seed: u64, n: u64) -> f64 {
    uniform_from(mix(seed ^ mix(n)))
}

/// A stream of draws.
#[derive(Clone, Debug)]
pub(crate) struct Draws {
    seed: u64,
    n: u64,
}

impl Draws {
    /// Stream number `stream` of a seed.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        Self {
            seed: mix(seed.wrapping_add(mix(stream))),
            n: 0,
        }
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        self.n += 1;
        uniform(self.seed, self.n)
    }

    /// Uniform in [lo, hi).
    pub(crate) fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// One of 0..n.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n - 1)
    }
}
