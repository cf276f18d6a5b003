//! Pictures as numbers: planes of `f32`, their filters and the way back to 8 bits.

use vergence_fft::{Complex32, plans32};
use vergence_imaging::{Gray, Plane};

/// A plane of grey levels, 0 to 255 where it is a picture.
pub type Field = Plane<f32>;

/// The levels of an 8-bit picture.
pub fn field_from_gray(picture: &Gray) -> Field {
    picture.map(f32::from)
}

/// The nearest 8-bit picture: rounded, clipped to 0..=255.
pub fn gray_from_field(field: &Field) -> Gray {
    field.map(|v| v.round().clamp(0.0, 255.0) as u8)
}

/// Value by value; both of one size.
pub fn combined(a: &Field, b: &Field, f: impl Fn(f32, f32) -> f32) -> Field {
    let samples = a.samples().iter().zip(b.samples());
    Field::from_samples(
        a.width(),
        a.height(),
        samples.map(|(&a, &b)| f(a, b)).collect(),
    )
}

/// Weights of a Gaussian of `sigma` pixels at -radius..=radius, of sum 1.
pub fn gaussian(sigma: f64, radius: usize) -> Vec<f32> {
    let r = radius as i64;
    let weights: Vec<f64> = (-r..=r)
        .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp())
        .collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|w| (w / sum) as f32).collect()
}

/// What stands beyond the edge of a field that is filtered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// The picture mirrored, its edge repeated; the result is as large as the field.
    Mirrored,
    /// Nothing: only where the whole filter fits; the result is smaller by the filter's length less one.
    Valid,
}

/// Filtered by the same odd, symmetric weights along rows and columns.
pub fn filtered(field: &Field, weights: &[f32], edge: Edge) -> Field {
    let (w, h) = field.size();
    let radius = weights.len() / 2;
    let cut = if edge == Edge::Valid { 2 * radius } else { 0 };
    let (out_w, out_h) = (w.saturating_sub(cut), h.saturating_sub(cut));
    let first = if edge == Edge::Valid { radius } else { 0 };
    let mut rows = Field::filled(out_w, h, 0.0);
    let mut padded = vec![0.0f32; w + 2 * radius];
    for y in 0..h {
        for (i, p) in padded.iter_mut().enumerate() {
            *p = field.at(mirrored(i as i64 - radius as i64, w), y);
        }
        for (x, out) in rows.row_mut(y).iter_mut().enumerate() {
            let from = x + first;
            *out = dot(&padded[from..from + weights.len()], weights);
        }
    }
    let mut out = Field::filled(out_w, out_h, 0.0);
    for y in 0..out_h {
        for (k, &weight) in weights.iter().enumerate() {
            let from = mirrored((y + first + k) as i64 - radius as i64, h);
            for (o, &r) in out.row_mut(y).iter_mut().zip(rows.row(from)) {
                *o += weight * r;
            }
        }
    }
    out
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Index inside 0..n of a sample that may lie outside, the edge sample repeated.
fn mirrored(i: i64, n: usize) -> usize {
    let n = n as i64;
    let folded = i.rem_euclid(2 * n);
    folded.min(2 * n - 1 - folded) as usize
}

/// Blurred by a Gaussian of `sigma` pixels, mirrored edges, cut at four sigma.
pub fn blurred(field: &Field, sigma: f64) -> Field {
    let radius = ((4.0 * sigma).round() as usize).max(1);
    filtered(field, &gaussian(sigma, radius), Edge::Mirrored)
}

/// Means of `factor` x `factor` blocks; what does not fill a block is dropped.
pub fn shrunk(field: &Field, factor: usize) -> Field {
    let scale = 1.0 / (factor * factor) as f32;
    Field::from_fn(field.width() / factor, field.height() / factor, |x, y| {
        let mut sum = 0.0;
        for row in y * factor..(y + 1) * factor {
            sum += field.row(row)[x * factor..(x + 1) * factor]
                .iter()
                .sum::<f32>();
        }
        sum * scale
    })
}

/// Mean of all samples.
pub fn mean(field: &Field) -> f64 {
    let sum: f64 = field.samples().iter().map(|&v| f64::from(v)).sum();
    sum / field.samples().len().max(1) as f64
}

/// Standard deviation of all samples.
pub fn deviation(field: &Field) -> f64 {
    let middle = mean(field);
    let squares = field
        .samples()
        .iter()
        .map(|&v| (f64::from(v) - middle).powi(2));
    (squares.sum::<f64>() / field.samples().len().max(1) as f64).sqrt()
}

/// A plane of complex numbers with its Fourier transforms (rows, then columns).
#[derive(Clone, Debug)]
pub struct Spectrum {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub samples: Vec<Complex32>,
}

impl Spectrum {
    /// Forward transform of a real field, not scaled.
    pub fn from_field(field: &Field) -> Self {
        let samples = field
            .samples()
            .iter()
            .map(|&v| Complex32::new(v, 0.0))
            .collect();
        let mut spectrum = Self {
            width: field.width(),
            height: field.height(),
            samples,
        };
        spectrum.transform(Direction::Forward);
        spectrum
    }

    /// The inverse transform, scaled so that it undoes the forward one.
    pub fn inverse(mut self) -> Self {
        self.transform(Direction::Inverse);
        let scale = 1.0 / (self.width * self.height) as f32;
        for v in &mut self.samples {
            *v *= scale;
        }
        self
    }

    /// Frequency of a column, cycles per pixel in [-0.5, 0.5).
    pub fn frequency_x(&self, column: usize) -> f64 {
        signed_frequency(column, self.width)
    }

    /// Frequency of a row, cycles per pixel in [-0.5, 0.5).
    pub fn frequency_y(&self, row: usize) -> f64 {
        signed_frequency(row, self.height)
    }

    fn transform(&mut self, direction: Direction) {
        let plan = |n| {
            let [forward, inverse] = plans32(n);
            match direction {
                Direction::Forward => forward,
                Direction::Inverse => inverse,
            }
        };
        let (rows, columns) = (plan(self.width), plan(self.height));
        for row in self.samples.chunks_exact_mut(self.width) {
            rows.process(row);
        }
        let mut column = vec![Complex32::default(); self.height];
        for x in 0..self.width {
            for (y, value) in column.iter_mut().enumerate() {
                *value = self.samples[y * self.width + x];
            }
            columns.process(&mut column);
            for (y, &value) in column.iter().enumerate() {
                self.samples[y * self.width + x] = value;
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Direction {
    Forward,
    Inverse,
}

fn signed_frequency(index: usize, n: usize) -> f64 {
    let signed = if index >= n.div_ceil(2) {
        index as f64 - n as f64
    } else {
        index as f64
    };
    signed / n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A filter of sum 1 keeps a constant, with either edge, and mirroring repeats the edge sample.
    #[test]
    fn filters_keep_constants() {
        let flat = Field::filled(20, 15, 3.0);
        let weights = gaussian(1.5, 5);
        let whole = filtered(&flat, &weights, Edge::Mirrored);
        assert_eq!(whole.size(), (20, 15));
        let inner = filtered(&flat, &weights, Edge::Valid);
        assert_eq!(inner.size(), (10, 5));
        for v in whole.samples().iter().chain(inner.samples()) {
            assert!((v - 3.0).abs() < 1e-5);
        }
        assert_eq!(
            [mirrored(-1, 4), mirrored(-2, 4), mirrored(4, 4)],
            [0, 1, 3]
        );
    }

    /// The inverse undoes the forward transform; a cosine has its energy at its frequency.
    #[test]
    fn transforms_go_both_ways() {
        let wave = Field::from_fn(16, 12, |x, _| {
            (std::f32::consts::TAU * 3.0 * x as f32 / 16.0).cos()
        });
        let spectrum = Spectrum::from_field(&wave);
        assert!((spectrum.samples[3].re - 96.0).abs() < 1e-3);
        assert!((spectrum.frequency_x(3) - 3.0 / 16.0).abs() < 1e-12);
        assert!((spectrum.frequency_x(13) + 3.0 / 16.0).abs() < 1e-12);
        let back = spectrum.inverse();
        for (a, b) in back.samples.iter().zip(wave.samples()) {
            assert!((a.re - b).abs() < 1e-5 && a.im.abs() < 1e-5);
        }
    }

    /// Means of blocks, and what does not fill one is dropped.
    #[test]
    fn shrinking_takes_means() {
        let ramp = Field::from_fn(5, 4, |x, y| (x + 10 * y) as f32);
        let half = shrunk(&ramp, 2);
        assert_eq!(half.size(), (2, 2));
        assert!((half.at(0, 0) - 5.5).abs() < 1e-6);
    }
}
