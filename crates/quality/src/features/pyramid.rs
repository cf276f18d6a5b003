//! Simoncelli's steerable pyramid in the Fourier domain (Simoncelli and Freeman 1995), two scales of six orientations.
//!
//! Half spectra suffice, because only the real part of each band is used and the masked spectra are those of real bands:
//! the lobes are odd under half a turn and multiplied by -i, and the low-pass table is exactly zero from Nyquist on, so
//! that nothing is left on the Nyquist lines (where a frequency is its own negative and the lobes would be uneven), neither
//! of the whole spectrum nor of the cropped one. At the zero frequency the bands' spectra are imaginary and are dropped.

use multiversion::multiversion;
use rayon::prelude::*;
use vergence_fft::Complex64;
use vergence_fft::double::RealFft2;
use vergence_imaging::Plane;

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
        let masks = match memory.masks.take() {
            Some(masks) if masks.size == size => masks,
            _ => Masks::new(size),
        };
        let mut high = memory.plane(width, height);
        let mut bands: Vec<Plane<f64>> = [size, masks.half]
            .into_iter()
            .flat_map(|size| [size; ORIENTATIONS])
            .map(|(width, height)| memory.plane(width, height))
            .collect();
        let [fft, half_fft] = &masks.ffts;
        let mut spectrum = memory.spectrum(fft.spectrum_len());
        let mut inner = memory.spectrum(half_fft.spectrum_len());
        let mut work = memory.spectrum(fft.spectrum_len());
        fft.forward_into(picture.samples(), &mut work, &mut spectrum);
        let residual = |k: usize, out: &mut [Complex64]| {
            out.copy_from_slice(&spectrum[k * height..(k + 1) * height]);
            times_mask(masks.column(&masks.high, k), out);
        };
        fft.inverse_with(residual, &mut work, high.samples_mut());
        masks.inner_ring(&spectrum, &mut inner);
        spectrum
            .par_chunks_mut(height)
            .enumerate()
            .for_each(|(k, column)| times_mask(masks.column(&masks.outer_ring, k), column));
        for b in 0..ORIENTATIONS {
            let (fine, coarse) = bands.split_at_mut(ORIENTATIONS);
            masks.oriented(fft, &spectrum, b, &mut work, &mut fine[b]);
            masks.oriented(half_fft, &inner, b, &mut work, &mut coarse[b]);
        }
        memory.take_back_spectra([spectrum, inner, work]);
        memory.masks = Some(masks);
        Self { high, bands }
    }
}

/// What depends on a picture's size alone: plans of transforms, and masks at the frequencies with both parts not negative,
/// column by column, from which those of the others follow. About two and a half numbers per pixel.
#[derive(Debug)]
pub(crate) struct Masks {
    size: (usize, usize),
    half: (usize, usize),
    ffts: [RealFft2; 2],
    /// Frequencies along y: 0 to height / 2.
    rows: usize,
    /// Of the high-pass residual.
    high: Vec<f64>,
    /// Of the bands of the first scale, but for their lobes.
    outer_ring: Vec<f64>,
    /// Of the bands of the second scale.
    inner_ring: Vec<f64>,
    lobes: Vec<Vec<f64>>,
}

impl Masks {
    fn new(size @ (width, height): (usize, usize)) -> Self {
        let half = (width.div_ceil(2), height.div_ceil(2));
        let (columns, rows) = (width / 2 + 1, height / 2 + 1);
        let x = |k: usize| k as f64 / (0.5 * width as f64);
        let y = |l: usize| l as f64 / (0.5 * height as f64);
        let plane = |mask: &(dyn Fn(usize, usize) -> f64 + Sync)| -> Vec<f64> {
            let mut values = vec![0.0; columns * rows];
            let columns = values.par_chunks_mut(rows).enumerate();
            columns.for_each(|(k, column)| {
                for (l, value) in column.iter_mut().enumerate() {
                    *value = mask(k, l);
                }
            });
            values
        };
        // Octaves below Nyquist; the zero frequency takes the place of its left neighbour.
        let rho = plane(&|k, l| match (k, l) {
            (0, 0) => x(1).log2(),
            _ => 0.5 * (x(k) * x(k) + y(l) * y(l)).log2(),
        });
        let turn = plane(&|k, l| turn_from_angle(y(l).atan2(x(k))));
        let t = &*TABLES;
        let radial = |mask: &(dyn Fn(f64) -> f64 + Sync)| plane(&|k, l| mask(rho[k * rows + l]));
        Self {
            size,
            half,
            ffts: [size, half].map(|(width, height)| RealFft2::new(width, height)),
            rows,
            high: radial(&|rho| t.high(rho, 0.0)),
            outer_ring: radial(&|rho| t.low(rho, 0.0) * t.high(rho, 1.0)),
            inner_ring: radial(&|rho| t.low(rho, 0.0) * t.low(rho, 1.0) * t.high(rho, 2.0)),
            lobes: (0..ORIENTATIONS)
                .map(|b| plane(&|k, l| t.angular(turn[k * rows + l], b)))
                .collect(),
        }
    }

    /// Bytes that the masks take.
    pub(crate) fn bytes(&self) -> usize {
        (3 + ORIENTATIONS) * self.high.len() * size_of::<f64>()
    }

    /// Column `k` of a mask.
    fn column<'a>(&self, mask: &'a [f64], k: usize) -> &'a [f64] {
        &mask[k * self.rows..(k + 1) * self.rows]
    }

    /// The half spectrum of the second scale but for its lobes: the middle of the first one, masked.
    fn inner_ring(&self, spectrum: &[Complex64], ring: &mut [Complex64]) {
        let (width, height) = self.half;
        let full_height = self.size.1;
        let columns = ring.par_chunks_mut(height).enumerate();
        columns.for_each(|(k, column)| {
            let mask = self.column(&self.inner_ring, k);
            let full = &spectrum[k * full_height..(k + 1) * full_height];
            for (l, value) in column.iter_mut().enumerate() {
                let below = height - l;
                *value = if l == below || 2 * k == width {
                    ZERO
                } else if l < below {
                    full[l] * mask[l]
                } else {
                    full[full_height - below] * mask[below]
                };
            }
        });
    }

    /// Band `b` from the half spectrum of a ring.
    fn oriented(
        &self,
        fft: &RealFft2,
        ring: &[Complex64],
        b: usize,
        work: &mut Vec<Complex64>,
        band: &mut Plane<f64>,
    ) {
        let height = band.height();
        // Below the x axis lobe b is lobe 6 - b above it, since cos⁵ is even, and odd under half a turn.
        let mirrored = (ORIENTATIONS - b) % ORIENTATIONS;
        let sign = if b == 0 { 1.0 } else { -1.0 };
        let lobe = |k: usize, out: &mut [Complex64]| {
            let above = self.column(&self.lobes[b], k);
            let below = self.column(&self.lobes[mirrored], k);
            let column = &ring[k * height..(k + 1) * height];
            lobe_column(column, (above, below, sign), out);
            if k == 0 {
                out[0] = ZERO;
            }
        };
        fft.inverse_with(lobe, work, band.samples_mut());
    }
}

/// One column of a spectrum times a mask that is the same above and below the x axis.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn times_mask(mask: &[f64], column: &mut [Complex64]) {
    let (upper, lower) = column.split_at_mut(mask.len());
    for (value, mask) in upper.iter_mut().zip(mask) {
        *value *= *mask;
    }
    for (value, mask) in lower.iter_mut().rev().zip(&mask[1..]) {
        *value *= *mask;
    }
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
