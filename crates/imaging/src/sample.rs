//! Sampling between pixels.

/// A sample that can be interpolated linearly, channel by channel.
pub trait Blend: Copy {
    /// Weighted sum of the four neighbours, rounded; the weights sum to one.
    fn blend4(samples: [Self; 4], weights: [f32; 4]) -> Self;
}

impl Blend for u8 {
    fn blend4(s: [Self; 4], w: [f32; 4]) -> Self {
        let sum: f32 = (0..4).map(|i| f32::from(s[i]) * w[i]).sum();
        (sum + 0.5) as u8
    }
}

impl Blend for [u8; 3] {
    fn blend4(s: [Self; 4], w: [f32; 4]) -> Self {
        std::array::from_fn(|c| u8::blend4(s.map(|px| px[c]), w))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each neighbour alone gives itself, halves give the mean rounded up, channels do not mix.
    #[test]
    fn weights_choose_and_mix() {
        let samples = [[10_u8, 0, 255], [20, 1, 0], [30, 2, 7], [40, 3, 9]];
        for i in 0..4 {
            let mut weights = [0.0; 4];
            weights[i] = 1.0;
            assert_eq!(<[u8; 3]>::blend4(samples, weights), samples[i]);
        }
        assert_eq!(
            <[u8; 3]>::blend4(samples, [0.5, 0.5, 0.0, 0.0]),
            [15, 1, 128]
        );
        assert_eq!(u8::blend4([255; 4], [0.25; 4]), 255);
    }
}
