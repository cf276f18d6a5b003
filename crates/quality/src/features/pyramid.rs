//! Simoncelli's steerable pyramid in the Fourier domain (Simoncelli and Freeman 1995), two scales of six orientations.
//!
//! Half spectra suffice, because only the real part of each band is used and the masked spectra are those of real bands:
//! the lobes are odd under half a turn and multiplied by -i, and the low-pass table is exactly zero from Nyquist on, so
//! that nothing is left on the Nyquist lines (where a frequency is its own negative and the lobes would be uneven), neither
//! of the whole spectrum nor of the cropped one. At the zero frequency the bands' spectra are imaginary and are dropped.

use multiversion::multiversion;
use rayon::prelude::*;
use vergence_imaging::Plane;
use vergence_imaging::fft64::{Complex64, RealFft2};

use super::tables::{ORIENTATIONS, TABLES, turn_from_angle};
use super::workspace::Workspace;

const ZERO: Complex64 = Complex64::new(0.0, 0.0);

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
        Self::in_memory(picture, &mut Workspace::default())
    }

    /// [`Self::new`] in memory that may have served before.
    pub(crate) fn in_memory(picture: &Plane<f64>, memory: &mut Workspace) -> Self {
        let size @ (width, height) = picture.size();
        let half = (width.div_ceil(2), height.div_ceil(2));
        let mut high = memory.plane(width, height);
        let mut bands: Vec<Plane<f64>> = [size, half]
            .into_iter()
            .flat_map(|size| [size; ORIENTATIONS])
            .map(|(width, height)| memory.plane(width, height))
            .collect();
        let ffts = [size, half].map(|(width, height)| RealFft2::new(width, height));
        let mut spectrum = memory.spectrum(ffts[0].spectrum_len());
        let mut inner = memory.spectrum(ffts[1].spectrum_len());
        let mut work = memory.spectrum(ffts[0].spectrum_len());
        ffts[0].forward_into(picture.samples(), &mut work, &mut spectrum);
        let quarter = Quarter::new(size);
        let residual = |k: usize, out: &mut [Complex64]| {
            let column = &spectrum[k * height..(k + 1) * height];
            for (l, (out, value)) in out.iter_mut().zip(column).enumerate() {
                *out = value * TABLES.high(quarter.rho(k, l.min(height - l)), 0.0);
            }
        };
        ffts[0].inverse_with(residual, &mut work, high.samples_mut());
        inner_ring(&spectrum, &quarter, half, &mut inner);
        spectrum
            .par_chunks_mut(height)
            .enumerate()
            .for_each(|(k, column)| {
                for (l, value) in column.iter_mut().enumerate() {
                    let rho = quarter.rho(k, l.min(height - l));
                    *value *= TABLES.low(rho, 0.0) * TABLES.high(rho, 1.0);
                }
            });
        let mut lobes = Lobes::new(&quarter);
        for (b, mirrored) in [(0, 0), (1, 5), (2, 4), (3, 3)] {
            lobes.set(b, mirrored);
            for b in [b, mirrored] {
                let (fine, coarse) = bands.split_at_mut(ORIENTATIONS);
                oriented(&ffts[0], &spectrum, &lobes, b, &mut work, &mut fine[b]);
                oriented(&ffts[1], &inner, &lobes, b, &mut work, &mut coarse[b]);
                if b == mirrored {
                    break;
                }
            }
        }
        memory.take_back_spectra([spectrum, inner, work]);
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
    fn new((width, height): (usize, usize)) -> Self {
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
}

/// The half spectrum of the second scale but for its lobes: the middle of the first one, low-passed twice, high-passed.
fn inner_ring(
    spectrum: &[Complex64],
    quarter: &Quarter,
    (width, height): (usize, usize),
    ring: &mut [Complex64],
) {
    let full_height = spectrum.len() / (quarter.rho.len() / quarter.rows);
    ring.par_chunks_mut(height)
        .enumerate()
        .for_each(|(k, column)| {
            for (l, value) in column.iter_mut().enumerate() {
                let below = height - l;
                if l == below || 2 * k == width {
                    *value = ZERO;
                    continue;
                }
                let row = if l < below { l } else { full_height - below };
                let rho = quarter.rho(k, l.min(below));
                let mask = TABLES.low(rho, 0.0) * TABLES.low(rho, 1.0) * TABLES.high(rho, 2.0);
                *value = spectrum[k * full_height + row] * mask;
            }
        });
}

/// Two lobes that mirror each other at the x axis (b and 6 - b, up to the sign), at the frequencies of a quarter.
struct Lobes<'a> {
    quarter: &'a Quarter,
    indices: [usize; 2],
    planes: [Vec<f64>; 2],
}

impl<'a> Lobes<'a> {
    fn new(quarter: &'a Quarter) -> Self {
        Self {
            quarter,
            indices: [0; 2],
            planes: [Vec::new(), Vec::new()],
        }
    }

    fn set(&mut self, b: usize, mirrored: usize) {
        self.indices = [b, mirrored];
        let count = if b == mirrored { 1 } else { 2 };
        for (plane, b) in self.planes.iter_mut().zip(self.indices).take(count) {
            plane.resize(self.quarter.turn.len(), 0.0);
            plane
                .par_iter_mut()
                .zip(&self.quarter.turn)
                .with_min_len(4096)
                .for_each(|(lobe, &turn)| *lobe = TABLES.angular(turn, b));
        }
    }

    /// Lobe `b` on column `k`, above the x axis and below, the latter with its sign.
    fn columns(&self, b: usize, k: usize) -> (&[f64], &[f64], f64) {
        let rows = self.quarter.rows;
        let column = |i: usize| &self.planes[i][k * rows..(k + 1) * rows];
        let own = usize::from(b != self.indices[0]);
        let other = if self.indices[0] == self.indices[1] {
            own
        } else {
            1 - own
        };
        // cos⁵ is even, and odd under half a turn.
        let sign = if b == 0 { 1.0 } else { -1.0 };
        (column(own), column(other), sign)
    }
}

/// Band `b` from the half spectrum of a ring.
fn oriented(
    fft: &RealFft2,
    ring: &[Complex64],
    lobes: &Lobes,
    b: usize,
    work: &mut Vec<Complex64>,
    band: &mut Plane<f64>,
) {
    let height = band.height();
    let lobe = |k: usize, out: &mut [Complex64]| {
        let column = &ring[k * height..(k + 1) * height];
        lobe_column(column, lobes.columns(b, k), out);
        if k == 0 {
            out[0] = ZERO;
        }
    };
    fft.inverse_with(lobe, work, band.samples_mut());
}

/// One column of a ring times -i and a lobe.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn lobe_column(column: &[Complex64], lobe: (&[f64], &[f64], f64), out: &mut [Complex64]) {
    let (above, below, sign) = lobe;
    let height = column.len();
    let half = height.div_ceil(2);
    let (upper, lower) = out.split_at_mut(half);
    let upper = upper.iter_mut().zip(&column[..half]).zip(&above[..half]);
    for ((out, value), lobe) in upper {
        *out = Complex64::new(value.im * lobe, -value.re * lobe);
    }
    // Nyquist: nothing is left there.
    let nyquist = usize::from(height.is_multiple_of(2));
    lower[..nyquist].fill(ZERO);
    let lower = lower[nyquist..].iter_mut().zip(&column[half + nyquist..]);
    for ((out, value), lobe) in lower.zip(below[1..half].iter().rev()) {
        let lobe = sign * lobe;
        *out = Complex64::new(value.im * lobe, -value.re * lobe);
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
