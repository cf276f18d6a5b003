//! The interpolation kernels and their weights at each of the 256 places between two pixels.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// How a value between pixels is made of those around it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// 2 x 2 pixels. The fastest; blurs by up to half a pixel.
    #[default]
    Bilinear,
    /// 4 x 4 pixels, the cubic convolution of Keys (1981, eq. 15, a = -1/2, which makes quadratic signals exact).
    /// Overshoots at edges by up to 1/14 of a step.
    Bicubic,
    /// 6 x 6 pixels, the sinc windowed by a sinc three times as wide (Lanczos; Turkowski 1990), weights scaled to a sum of one.
    /// The sharpest; rings beside edges.
    Lanczos3,
}

/// Places between two pixels.
pub(super) const PHASES: usize = 256;

/// Taps of the longest kernel.
pub(super) const MAX_TAPS: usize = 6;

impl Kernel {
    /// Pixels across and down of which a value is made.
    pub fn taps(self) -> usize {
        match self {
            Self::Bilinear => 2,
            Self::Bicubic => 4,
            Self::Lanczos3 => 6,
        }
    }

    /// Weights of the taps for a place `fraction` (0..1) after the middle pair's first pixel; their sum is one. Entries beyond
    /// [`Self::taps`] are zero.
    pub fn weights(self, fraction: f64) -> [f64; MAX_TAPS] {
        let taps = self.taps();
        let first = 1.0 - taps as f64 / 2.0;
        let mut weights = [0.0; MAX_TAPS];
        for (i, w) in weights[..taps].iter_mut().enumerate() {
            *w = self.at(fraction - first - i as f64);
        }
        let sum: f64 = weights.iter().sum();
        weights.map(|w| w / sum)
    }

    /// The kernel `x` pixels from its middle.
    fn at(self, x: f64) -> f64 {
        let x = x.abs();
        match self {
            Self::Bilinear => (1.0 - x).max(0.0),
            Self::Bicubic if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
            Self::Bicubic if x < 2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
            Self::Lanczos3 if x < 3.0 => sinc(x) * sinc(x / 3.0),
            Self::Bicubic | Self::Lanczos3 => 0.0,
        }
    }

    /// Weights at each of the [`PHASES`].
    pub(super) fn table(self) -> &'static [[f32; MAX_TAPS]; PHASES] {
        static TABLES: LazyLock<[[[f32; MAX_TAPS]; PHASES]; 3]> = LazyLock::new(|| {
            [Kernel::Bilinear, Kernel::Bicubic, Kernel::Lanczos3].map(|kernel| {
                std::array::from_fn(|phase| {
                    kernel
                        .weights(phase as f64 / PHASES as f64)
                        .map(|w| w as f32)
                })
            })
        });
        match self {
            Self::Bilinear => &TABLES[0],
            Self::Bicubic => &TABLES[1],
            Self::Lanczos3 => &TABLES[2],
        }
    }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 {
        1.0
    } else {
        (PI * x).sin() / (PI * x)
    }
}

#[cfg(test)]
mod tests {
    //! Proves: at a pixel each kernel gives that pixel alone; between pixels it keeps what its theory says it keeps: constants
    //! (all), slopes (bilinear, cubic), parabolas (cubic). Lanczos keeps neither slope nor parabola exactly: bounded.
    use super::*;

    const ALL: [Kernel; 3] = [Kernel::Bilinear, Kernel::Bicubic, Kernel::Lanczos3];

    #[test]
    fn a_pixel_is_itself() {
        for kernel in ALL {
            let weights = kernel.weights(0.0);
            for (i, w) in weights.iter().enumerate() {
                let own = f64::from(u8::from(i == kernel.taps() / 2 - 1));
                assert!((w - own).abs() < 1e-15, "{kernel:?} {weights:?}");
            }
        }
    }

    #[test]
    fn polynomials_that_are_kept() {
        for kernel in ALL {
            for phase in 0..PHASES {
                let f = phase as f64 / PHASES as f64;
                let weights = kernel.weights(f);
                let first = 1.0 - kernel.taps() as f64 / 2.0;
                let moment = |power: i32| -> f64 {
                    let at = |i: usize| (first + i as f64 - f).powi(power);
                    (0..kernel.taps()).map(|i| weights[i] * at(i)).sum()
                };
                let (slope, parabola) = match kernel {
                    Kernel::Bilinear => (1e-15, 0.26),
                    Kernel::Bicubic => (1e-15, 1e-14),
                    // What six windowed sines leave once they sum to one: 0.01998 of a pixel at most.
                    Kernel::Lanczos3 => (0.02, 0.05),
                };
                assert!((moment(0) - 1.0).abs() < 1e-14);
                assert!(moment(1).abs() <= slope, "{kernel:?} {}", moment(1));
                assert!(moment(2).abs() <= parabola, "{kernel:?} {}", moment(2));
            }
        }
    }
}
