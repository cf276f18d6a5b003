//! The 88 features as the index is defined: whole spectra, whole matrices, loops as one would write them down. Slow, one
//! thread, much memory; the reference of the tests, never of a program.

use nalgebra::DMatrix;
use vergence_fft::Complex64;
use vergence_fft::double::ComplexFft2;
use vergence_imaging::Plane;

use super::enlarge::{Enlargement, keys};
use super::normalise::cut;
use super::shape::shape_from_ratio;
use super::tables::{ORIENTATIONS, TABLES, turn_from_angle};
use super::{FEATURE_COUNT, Features, LAGS, check};
use crate::error::QualityError;

/// f1 to f88 of a picture with values 0 to 255.
pub fn features(picture: &Plane<f64>) -> Result<Features, QualityError> {
    check(picture)?;
    let (high, bands) = pyramid(picture);
    let maps = (0..12)
        .map(|b| normalised(&bands, b))
        .collect::<Result<Vec<_>, _>>()?;
    let mut f = Vec::with_capacity(FEATURE_COUNT);
    f.extend(maps.iter().map(|g| variance(g.samples())));
    f.extend(maps.iter().map(|g| shape(g.samples(), mean(g.samples()))));
    let mut centre = 0.0;
    for b in 0..ORIENTATIONS {
        let pool = [maps[b].samples(), maps[b + 6].samples()].concat();
        centre = mean(&pool);
        f.push(shape(&pool, centre));
    }
    // About the mean of the last pair, a slip of the release.
    let all: Vec<f64> = maps.iter().flat_map(|g| g.samples()).copied().collect();
    f.push(shape(&all, centre));
    f.extend(bands.iter().map(|band| {
        let line = |n: usize, length: usize| Enlargement {
            length,
            ratio: length as f64 / n as f64,
        };
        let across = line(band.width(), picture.width());
        let down = line(band.height(), picture.height());
        contrast_structure(&enlarged(band, across, down), &high)
    }));
    for g in &maps[..6] {
        f.extend(cubic(&correlations(g)));
    }
    for a in 0..6 {
        for b in a + 1..6 {
            f.push(contrast_structure(&maps[a], &maps[b]));
        }
    }
    let f: Features = f.try_into().map_err(|_| QualityError::Constant)?;
    if f.iter().all(|v| v.is_finite()) {
        Ok(f)
    } else {
        Err(QualityError::Constant)
    }
}

/// A spectrum with the zero frequency in its middle, and the coordinates of its samples.
struct Shifted {
    width: usize,
    height: usize,
    values: Vec<Complex64>,
    rho: Vec<f64>,
    theta: Vec<f64>,
}

impl Shifted {
    fn of(picture: &Plane<f64>) -> Self {
        let (width, height) = picture.size();
        let mut values: Vec<Complex64> = picture
            .samples()
            .iter()
            .map(|&v| Complex64::new(v, 0.0))
            .collect();
        ComplexFft2::new(width, height).forward(&mut values);
        let (middle_x, middle_y) = (width / 2, height / 2);
        let mut shifted = Self {
            width,
            height,
            values: values.clone(),
            rho: vec![0.0; width * height],
            theta: vec![0.0; width * height],
        };
        for row in 0..height {
            for column in 0..width {
                let i = row * width + column;
                let from_x = (column + width - middle_x) % width;
                let from_y = (row + height - middle_y) % height;
                shifted.values[i] = values[from_y * width + from_x];
                let x = (column as f64 - middle_x as f64) / (width as f64 / 2.0);
                let y = (row as f64 - middle_y as f64) / (height as f64 / 2.0);
                shifted.theta[i] = y.atan2(x);
                shifted.rho[i] = x.hypot(y).log2();
            }
        }
        let zero = middle_y * width + middle_x;
        shifted.rho[zero] = shifted.rho[zero - 1];
        shifted
    }

    /// Real part of the inverse transform of the values times a mask of (rho, theta).
    fn real_inverse(&self, mask: impl Fn(f64, f64) -> Complex64) -> Plane<f64> {
        let (width, height) = (self.width, self.height);
        let mut values = vec![Complex64::new(0.0, 0.0); width * height];
        for row in 0..height {
            for column in 0..width {
                let i = row * width + column;
                let to_x = (column + width - width / 2) % width;
                let to_y = (row + height - height / 2) % height;
                values[to_y * width + to_x] = self.values[i] * mask(self.rho[i], self.theta[i]);
            }
        }
        ComplexFft2::new(width, height).inverse(&mut values);
        Plane::from_samples(width, height, values.iter().map(|v| v.re).collect())
    }

    fn low_passed(mut self, shift: f64) -> Self {
        for (value, &rho) in self.values.iter_mut().zip(&self.rho) {
            *value *= TABLES.low(rho, shift);
        }
        self
    }

    fn bands(&self, shift: f64) -> Vec<Plane<f64>> {
        (0..ORIENTATIONS)
            .map(|b| {
                self.real_inverse(|rho, theta| {
                    let lobe = TABLES.angular(turn_from_angle(theta), b);
                    Complex64::new(0.0, -1.0) * lobe * TABLES.high(rho, shift)
                })
            })
            .collect()
    }

    /// The middle, half as large (rounded up); coordinates are kept, not computed again.
    fn cropped(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let left = self.width / 2 - width / 2;
        let top = self.height / 2 - height / 2;
        let places: Vec<usize> = (0..height)
            .flat_map(|row| (0..width).map(move |column| (top + row, left + column)))
            .map(|(row, column)| row * self.width + column)
            .collect();
        Self {
            width,
            height,
            values: places.iter().map(|&i| self.values[i]).collect(),
            rho: places.iter().map(|&i| self.rho[i]).collect(),
            theta: places.iter().map(|&i| self.theta[i]).collect(),
        }
    }
}

/// High-pass residual and the twelve bands, by scale, then orientation.
pub fn pyramid(picture: &Plane<f64>) -> (Plane<f64>, Vec<Plane<f64>>) {
    let whole = Shifted::of(picture);
    let high = whole.real_inverse(|rho, _| Complex64::new(TABLES.high(rho, 0.0), 0.0));
    let low = whole.low_passed(0.0);
    let mut bands = low.bands(1.0);
    bands.extend(low.cropped().low_passed(1.0).bands(2.0));
    (high, bands)
}

/// See [`super::enlarge::enlarged`].
pub fn enlarged(source: &Plane<f64>, across: Enlargement, down: Enlargement) -> Plane<f64> {
    let reflected = |i: i64, n: usize| -> usize {
        let mut i = i;
        loop {
            if i < 0 {
                i = -1 - i;
            } else if i >= n as i64 {
                i = 2 * n as i64 - 1 - i;
            } else {
                return i as usize;
            }
        }
    };
    let value = |line: Enlargement, n: usize, i: usize, sample: &dyn Fn(usize) -> f64| -> f64 {
        let u = (i + 1) as f64 / line.ratio + (1.0 - 1.0 / line.ratio) / 2.0;
        let first = (u - 2.0).floor() as i64;
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in first..first + 6 {
            let weight = keys(u - k as f64);
            sum += weight * sample(reflected(k - 1, n));
            weights += weight;
        }
        sum / weights
    };
    let tall = Plane::from_fn(source.width(), down.length, |x, y| {
        value(down, source.height(), y, &|i| source.at(x, i))
    });
    Plane::from_fn(across.length, down.length, |x, y| {
        value(across, source.width(), x, &|i| tall.at(i, y))
    })
}

/// The vectors of band `b` (0 to 11), one for each interior sample: the 3 x 3 neighbourhood, the parent for the first
/// five, the other orientations.
pub fn neighbourhoods(bands: &[Plane<f64>], b: usize) -> Vec<Vec<f64>> {
    let band = &bands[b];
    let (width, height) = band.size();
    let scale = b - b % ORIENTATIONS;
    let parent = (b < 5).then(|| {
        let child = &bands[b + ORIENTATIONS];
        let twice = |n| Enlargement {
            length: 2 * n,
            ratio: 2.0,
        };
        enlarged(child, twice(child.width()), twice(child.height()))
    });
    let mut all = Vec::new();
    for row in 1..height - 1 {
        for column in 1..width - 1 {
            let mut y = Vec::new();
            for dy in [1, 0, -1_isize] {
                for dx in [1, 0, -1_isize] {
                    y.push(band.at(column.wrapping_add_signed(dx), row.wrapping_add_signed(dy)));
                }
            }
            y.extend(parent.as_ref().map(|p| p.at(column, row)));
            let others = (scale..scale + ORIENTATIONS).filter(|&o| o != b);
            y.extend(others.map(|o| bands[o].at(column, row)));
            all.push(y);
        }
    }
    all
}

/// Mean of y yᵀ; the mean of y is not removed.
pub fn covariance(vectors: &[Vec<f64>]) -> DMatrix<f64> {
    let d = vectors[0].len();
    let mut c = DMatrix::zeros(d, d);
    for y in vectors {
        for i in 0..d {
            for j in 0..d {
                c[(i, j)] += y[i] * y[j];
            }
        }
    }
    c / vectors.len() as f64
}

/// The pseudo-inverse of a covariance whose eigenvalues that are not positive were set to zero and the others raised to
/// the same sum; none when nothing is left.
pub fn inverse_covariance(c: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (values, vectors) = eigen(c)?;
    let positive: Vec<f64> = values.iter().map(|v| v.max(0.0)).collect();
    let raise = values.iter().sum::<f64>() / positive.iter().sum::<f64>();
    let raised: Vec<f64> = positive.iter().map(|v| v * raise).collect();
    let (values, vectors) = eigen(&composed(&raised, &vectors))?;
    let largest = values.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
    let cut = cut(c.nrows(), largest);
    let inverted: Vec<f64> = values
        .iter()
        .map(|&v| if v.abs() > cut { 1.0 / v } else { 0.0 })
        .collect();
    (largest > 0.0).then(|| composed(&inverted, &vectors))
}

/// V diag(values) Vᵀ.
fn composed(values: &[f64], vectors: &DMatrix<f64>) -> DMatrix<f64> {
    let d = values.len();
    DMatrix::from_fn(d, d, |i, j| {
        (0..d)
            .map(|k| vectors[(i, k)] * values[k] * vectors[(j, k)])
            .sum()
    })
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by Jacobi's rotations, each of which makes one entry off
/// the diagonal zero (Golub and Van Loan, Matrix Computations, 8.5); none when an entry is not finite.
fn eigen(c: &DMatrix<f64>) -> Option<(Vec<f64>, DMatrix<f64>)> {
    const SWEEPS: usize = 60;
    let d = c.nrows();
    let (mut a, mut vectors) = (c.clone(), DMatrix::identity(d, d));
    for _ in 0..SWEEPS {
        let mut turned = false;
        for p in 0..d {
            for q in p + 1..d {
                let product = a[(p, p)].abs() * a[(q, q)].abs();
                if a[(p, q)].abs() <= 1e-3 * f64::EPSILON * product.sqrt() {
                    continue;
                }
                turned = true;
                let ratio = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
                let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
                let cosine = 1.0 / tangent.hypot(1.0);
                let sine = tangent * cosine;
                for k in 0..d {
                    let (x, y) = (a[(k, p)], a[(k, q)]);
                    a[(k, p)] = cosine * x - sine * y;
                    a[(k, q)] = sine * x + cosine * y;
                }
                for k in 0..d {
                    let (x, y) = (a[(p, k)], a[(q, k)]);
                    a[(p, k)] = cosine * x - sine * y;
                    a[(q, k)] = sine * x + cosine * y;
                    let (x, y) = (vectors[(k, p)], vectors[(k, q)]);
                    vectors[(k, p)] = cosine * x - sine * y;
                    vectors[(k, q)] = sine * x + cosine * y;
                }
            }
        }
        if !turned {
            break;
        }
    }
    let values: Vec<f64> = (0..d).map(|i| a[(i, i)]).collect();
    values
        .iter()
        .all(|v| v.is_finite())
        .then_some((values, vectors))
}

/// Divisively normalised band `b` (0 to 11) without its guard band, mean removed.
pub fn normalised(bands: &[Plane<f64>], b: usize) -> Result<Plane<f64>, QualityError> {
    let (width, height) = bands[b].size();
    let (width, height) = (width - 2, height - 2);
    let vectors = neighbourhoods(bands, b);
    let inverse = inverse_covariance(&covariance(&vectors)).ok_or(QualityError::Constant)?;
    let centre = mean(&vectors.iter().map(|y| y[4]).collect::<Vec<_>>());
    let divisor = if b < 5 { 10.0 } else { 9.0 };
    let mut g = Vec::with_capacity(vectors.len());
    for y in &vectors {
        let mut form = 0.0;
        for (i, yi) in y.iter().enumerate() {
            for (j, yj) in y.iter().enumerate() {
                form += yi * inverse[(i, j)] * yj;
            }
        }
        let z = (form / divisor).sqrt();
        if z.is_nan() || z == 0.0 {
            return Err(QualityError::Constant);
        }
        g.push((y[4] - centre) / z);
    }
    let guard = if b < ORIENTATIONS { 16 } else { 8 };
    let inner = Plane::from_fn(width - 2 * guard, height - 2 * guard, |x, y| {
        g[(y + guard) * width + x + guard]
    });
    let centre = mean(inner.samples());
    Ok(inner.map(|v| v - centre))
}

/// Shape parameter of samples about a centre.
pub fn shape(samples: &[f64], centre: f64) -> f64 {
    let n = samples.len() as f64;
    let squares: f64 = samples.iter().map(|t| (t - centre).powi(2)).sum();
    let absolute: f64 = samples.iter().map(|t| (t - centre).abs()).sum();
    shape_from_ratio(squares / n / (absolute / n).powi(2))
}

/// The contrast-structure factor of SSIM (Wang et al. 2004), mean over all windows inside.
pub fn contrast_structure(a: &Plane<f64>, b: &Plane<f64>) -> f64 {
    const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);
    let weights: [f64; 11] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - 5.0) / 1.5).powi(2)).exp());
    let total = weights.iter().sum::<f64>().powi(2);
    let (width, height) = (a.width() - 10, a.height() - 10);
    let mut sum = 0.0;
    for y in 0..height {
        for x in 0..width {
            let (mut ea, mut eb, mut eaa, mut ebb, mut eab) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for dy in 0..11 {
                for dx in 0..11 {
                    let w = weights[dx] * weights[dy] / total;
                    let (a, b) = (a.at(x + dx, y + dy), b.at(x + dx, y + dy));
                    ea += w * a;
                    eb += w * b;
                    eaa += w * a * a;
                    ebb += w * b * b;
                    eab += w * a * b;
                }
            }
            let spread = eaa - ea * ea + ebb - eb * eb;
            sum += (2.0 * (eab - ea * eb) + C2) / (spread + C2);
        }
    }
    sum / (width * height) as f64
}

/// Correlation of quantised samples with their eight neighbours at each lag, over all pairs inside.
pub fn correlations(g: &Plane<f64>) -> [f64; 7] {
    let low = g.samples().iter().copied().fold(f64::INFINITY, f64::min);
    let high = g
        .samples()
        .iter()
        .copied()
        .fold(f64::NEG_INFINITY, f64::max);
    let width = (high - low) / 100.0;
    let bin = g.map(|v| (((v - low) / width).ceil() - 1.0).clamp(0.0, 99.0) as usize);
    let centres: Vec<f64> = (0..100).map(|i| low + (i as f64 + 0.5) * width).collect();
    LAGS.map(|lag| {
        let j = lag as isize;
        let mut table = vec![[0.0; 100]; 100];
        for y in 0..g.height() {
            for x in 0..g.width() {
                for (dx, dy) in [
                    (j, 0),
                    (-j, 0),
                    (0, j),
                    (0, -j),
                    (j, j),
                    (j, -j),
                    (-j, j),
                    (-j, -j),
                ] {
                    let to_x = x.checked_add_signed(dx).filter(|&x| x < g.width());
                    let to_y = y.checked_add_signed(dy).filter(|&y| y < g.height());
                    if let (Some(x2), Some(y2)) = (to_x, to_y) {
                        table[bin.at(x, y)][bin.at(x2, y2)] += 1.0;
                    }
                }
            }
        }
        correlation(&table, &centres)
    })
}

fn correlation(table: &[[f64; 100]], x: &[f64]) -> f64 {
    let total: f64 = table.iter().flatten().sum();
    let over = |f: &dyn Fn(usize, usize) -> f64| -> f64 {
        let mut sum = 0.0;
        for (i, row) in table.iter().enumerate() {
            for (k, count) in row.iter().enumerate() {
                sum += f(i, k) * count / total;
            }
        }
        sum
    };
    let (mean_x, mean_y) = (over(&|i, _| x[i]), over(&|_, k| x[k]));
    let var_x = over(&|i, _| (x[i] - mean_x).powi(2));
    // About mean_x, a slip of the release.
    let var_y = over(&|_, k| (x[k] - mean_x).powi(2));
    (over(&|i, k| x[i] * x[k]) - mean_x * mean_y) / (var_x * var_y).sqrt()
}

/// Coefficients of j³, j², j, 1 of the least-squares cubic through the correlations, and the sum of squared residuals.
pub fn cubic(rho: &[f64; 7]) -> [f64; 5] {
    let powers = DMatrix::from_fn(7, 4, |i, k| (LAGS[i] as f64).powi(3 - k as i32));
    let rho = DMatrix::from_column_slice(7, 1, rho);
    let qr = powers.clone().qr();
    let projected = qr.q().transpose() * &rho;
    let Some(c) = qr.r().solve_upper_triangular(&projected) else {
        return [f64::NAN; 5];
    };
    let rest = (&rho - powers * &c).norm_squared();
    [c[0], c[1], c[2], c[3], rest]
}

fn mean(samples: &[f64]) -> f64 {
    samples.iter().sum::<f64>() / samples.len() as f64
}

fn variance(samples: &[f64]) -> f64 {
    let mean = mean(samples);
    samples.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / samples.len() as f64
}
