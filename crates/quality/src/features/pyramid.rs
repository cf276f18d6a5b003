//! Simoncelli's steerable pyramid in the Fourier domain (Simoncelli and Freeman 1995), two scales of six orientations.
//!
//! Half spectra suffice, because only the real part of each band is used and the masked spectra are those of real bands:
//! the lobes are odd under half a turn and multiplied by -i, and the low-pass table is exactly zero from Nyquist on, so
//! that nothing is left on the Nyquist lines (where a frequency is its own negative and the lobes would be uneven), neither
//! of the whole spectrum nor of the cropped one. At the zero frequency the bands' spectra are imaginary and are dropped.

use rayon::prelude::*;
use vergence_imaging::Plane;
use vergence_imaging::fft64::{Complex64, RealFft2};

use super::tables::{ORIENTATIONS, TABLES, turn_from_angle};

/// High-pass residual and the twelve bands.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// What the low-pass takes away at first, of the picture's size.
    pub high: Plane<f64>,
    /// Six orientations of the picture's size, then six of half that size (rounded up).
    pub bands: Vec<Plane<f64>>,
}

impl Pyramid {
    /// Of a picture of at least 4 x 4 samples.
    pub fn new(picture: &Plane<f64>) -> Self {
        let (width, height) = picture.size();
        let fft = RealFft2::new(width, height);
        let mut spectrum = fft.forward(picture.samples());
        let quarter = Quarter::new(width, height);
        let mut work = Vec::new();
        let mut high = Plane::filled(width, height, 0.0);
        let residual = |k: usize, out: &mut [Complex64]| {
            let column = &spectrum[k * height..(k + 1) * height];
            for (l, (out, value)) in out.iter_mut().zip(column).enumerate() {
                *out = value * TABLES.high(quarter.rho(k, l.min(height - l)), 0.0);
            }
        };
        fft.inverse_with(residual, &mut work, high.samples_mut());
        let half = (width.div_ceil(2), height.div_ceil(2));
        let inner_ring = inner_ring(&spectrum, &quarter, half);
        spectrum
            .par_chunks_mut(height)
            .enumerate()
            .for_each(|(k, column)| {
                for (l, value) in column.iter_mut().enumerate() {
                    let rho = quarter.rho(k, l.min(height - l));
                    *value *= TABLES.low(rho, 0.0) * TABLES.high(rho, 1.0);
                }
            });
        let mut bands = Vec::with_capacity(2 * ORIENTATIONS);
        oriented(
            &fft,
            &spectrum,
            &quarter,
            &mut work,
            (width, height),
            &mut bands,
        );
        drop(spectrum);
        let fft = RealFft2::new(half.0, half.1);
        oriented(&fft, &inner_ring, &quarter, &mut work, half, &mut bands);
        Self { high, bands }
    }
}

/// Polar coordinates of the frequencies with both parts not negative, from which those of the others follow.
struct Quarter {
    /// Frequencies along y: 0 to height / 2.
    rows: usize,
    /// Octaves below Nyquist, column by column.
    rho: Vec<f64>,
    /// Direction in steps of the angular table.
    turn: Vec<f64>,
}

impl Quarter {
    fn new(width: usize, height: usize) -> Self {
        let (columns, rows) = (width / 2 + 1, height / 2 + 1);
        let x = |k: usize| k as f64 / (0.5 * width as f64);
        let y = |l: usize| l as f64 / (0.5 * height as f64);
        let plane = |f: &(dyn Fn(f64, f64) -> f64 + Sync)| -> Vec<f64> {
            let mut values = vec![0.0; columns * rows];
            let columns = values.par_chunks_mut(rows).enumerate();
            columns.for_each(|(k, column)| {
                for (l, value) in column.iter_mut().enumerate() {
                    *value = f(x(k), y(l));
                }
            });
            values
        };
        let mut rho = plane(&|x, y| 0.5 * (x * x + y * y).log2());
        // The zero frequency takes the place of its left neighbour.
        rho[0] = x(1).log2();
        let turn = plane(&|x, y| turn_from_angle(y.atan2(x)));
        Self { rows, rho, turn }
    }

    fn rho(&self, k: usize, l: usize) -> f64 {
        self.rho[k * self.rows + l]
    }

    fn turns(&self, k: usize) -> &[f64] {
        &self.turn[k * self.rows..(k + 1) * self.rows]
    }
}

/// The half spectrum of the second scale but for its lobes: the middle of the first one, low-passed twice, high-passed.
fn inner_ring(
    spectrum: &[Complex64],
    quarter: &Quarter,
    (width, height): (usize, usize),
) -> Vec<Complex64> {
    let full_height = spectrum.len() / (quarter.rho.len() / quarter.rows);
    let mut ring = vec![Complex64::new(0.0, 0.0); (width / 2 + 1) * height];
    ring.par_chunks_mut(height)
        .enumerate()
        .filter(|&(k, _)| 2 * k != width)
        .for_each(|(k, column)| {
            for (l, value) in column.iter_mut().enumerate() {
                let below = height - l;
                if l == below {
                    continue;
                }
                let row = if l < below { l } else { full_height - below };
                let rho = quarter.rho(k, l.min(below));
                let mask = TABLES.low(rho, 0.0) * TABLES.low(rho, 1.0) * TABLES.high(rho, 2.0);
                *value = spectrum[k * full_height + row] * mask;
            }
        });
    ring
}

/// Six bands from the half spectrum of a ring.
fn oriented(
    fft: &RealFft2,
    ring: &[Complex64],
    quarter: &Quarter,
    work: &mut Vec<Complex64>,
    (width, height): (usize, usize),
    bands: &mut Vec<Plane<f64>>,
) {
    for b in 0..ORIENTATIONS {
        let mut band = Plane::filled(width, height, 0.0);
        let lobe = |k: usize, out: &mut [Complex64]| {
            let column = &ring[k * height..(k + 1) * height];
            lobe_column(column, quarter.turns(k), b, out);
            if k == 0 {
                out[0] = Complex64::new(0.0, 0.0);
            }
        };
        fft.inverse_with(lobe, work, band.samples_mut());
        bands.push(band);
    }
}

/// One column of a ring times -i and lobe `b`; below the x axis the direction is mirrored.
fn lobe_column(column: &[Complex64], turns: &[f64], b: usize, out: &mut [Complex64]) {
    let height = column.len();
    let turned = |value: Complex64, turn: f64| {
        let lobe = TABLES.angular(turn, b);
        Complex64::new(value.im * lobe, -value.re * lobe)
    };
    out[0] = turned(column[0], turns[0]);
    for l in 1..height.div_ceil(2) {
        out[l] = turned(column[l], turns[l]);
        out[height - l] = turned(column[height - l], -turns[l]);
    }
    if height.is_multiple_of(2) {
        // Nyquist: nothing is left there.
        out[height / 2] = Complex64::new(0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::plain;

    /// Half spectra give what whole spectra give literally, for every remainder of the sides by four and prime sides.
    #[test]
    fn bands_are_those_of_whole_spectra() {
        for (w, h) in [
            (64, 48),
            (61, 47),
            (62, 49),
            (63, 50),
            (60, 45),
            (46, 66),
            (45, 60),
        ] {
            let picture = Plane::from_fn(w, h, |x, y| ((x * x * 7 + y * 13 * x + y) % 251) as f64);
            let fast = Pyramid::new(&picture);
            let (high, bands) = plain::pyramid(&picture);
            let both = std::iter::once((&fast.high, &high)).chain(fast.bands.iter().zip(&bands));
            for (fast, slow) in both {
                assert_eq!(fast.size(), slow.size());
                let close =
                    (fast.samples().iter().zip(slow.samples())).all(|(a, b)| (a - b).abs() < 1e-10);
                assert!(close, "{w} x {h}");
            }
        }
    }
}
