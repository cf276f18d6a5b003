//! Blur along one motion: what a turning camera does to everything that is at rest.

use super::{MARGIN, Place, Workspace};

impl Workspace {
    /// Mean of the colours of `wide` along `motion` (pixels) to either side of every pixel of `place`, into `sum`.
    pub(crate) fn smear(&mut self, place: &Place, wide: &Place, motion: [f32; 2]) {
        let margin = [
            (wide.width - place.width) / 2,
            (wide.height - place.height) / 2,
        ];
        let span = [2 * margin[0] + 1, 2 * margin[1] + 1];
        let weights = smear_weights(motion, margin);
        for (sum, rgb) in self.sum.iter_mut().zip(&self.rgb) {
            sum[..place.width * place.height].fill(0.0);
            for (i, &weight) in weights[..span[0] * span[1]].iter().enumerate() {
                if weight == 0.0 {
                    continue;
                }
                for (y, out) in sum
                    .chunks_exact_mut(place.width)
                    .take(place.height)
                    .enumerate()
                {
                    let from = (y + i / span[0]) * wide.width + i % span[0];
                    for (o, v) in out.iter_mut().zip(&rgb[from..from + place.width]) {
                        *o += weight * v;
                    }
                }
            }
        }
    }
}

/// Weights of the pixels around one for the mean along a straight motion, sampled at steps of at most a pixel and
/// linear between pixels; row by row, `2 margin + 1` each way.
fn smear_weights(
    motion: [f32; 2],
    margin: [usize; 2],
) -> [f32; (2 * MARGIN + 1) * (2 * MARGIN + 1)] {
    let mut weights = [0.0; (2 * MARGIN + 1) * (2 * MARGIN + 1)];
    let span = 2 * margin[0] + 1;
    let steps = motion[0].hypot(motion[1]).ceil() as usize + 1;
    for k in 0..steps {
        let along = (k as f32 + 0.5) / steps as f32 - 0.5;
        let at = [0, 1].map(|a| along * motion[a] + margin[a] as f32);
        let (fx, fy) = (at[0].floor(), at[1].floor());
        let (x, y) = (at[0] - fx, at[1] - fy);
        let corner = fy as usize * span + fx as usize;
        for (offset, w) in [
            (0, (1.0 - x) * (1.0 - y)),
            (1, x * (1.0 - y)),
            (span, (1.0 - x) * y),
            (span + 1, x * y),
        ] {
            if w > 0.0 {
                weights[corner + offset] += w / steps as f32;
            }
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::smear_weights;

    /// Weights of a smear sum to one, and their centroid is the pixel itself.
    #[test]
    fn smears_are_centred() {
        for motion in [[3.3, -0.4], [0.2, 7.9], [-13.0, 2.0], [0.0, 0.0]] {
            let margin = motion.map(|m: f32| (m.abs() / 2.0 + 1e-3).ceil() as usize);
            let weights = smear_weights(motion, margin);
            let span = 2 * margin[0] + 1;
            let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
            for (i, w) in weights.iter().enumerate() {
                sum += w;
                x += w * ((i % span) as f32 - margin[0] as f32);
                y += w * ((i / span) as f32 - margin[1] as f32);
            }
            assert!(
                (sum - 1.0).abs() < 1e-5 && x.abs() < 1e-4 && y.abs() < 1e-4,
                "{motion:?}"
            );
        }
    }
}
