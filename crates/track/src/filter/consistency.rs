//! Is a filter as good as it says? Chi-square statistics of its errors and innovations.
//!
//! Normalised estimation error squared (NEES) and normalised innovation squared (NIS), Bar-Shalom, Li & Kirubarajan
//! 2001, *Estimation with Applications to Tracking and Navigation*, chapter 5: for a consistent filter both are
//! chi-square distributed with as many degrees of freedom as the state, or the measurement, has components.

use nalgebra::{Const, DimMin, SMatrix, SVector};

/// `e' P⁻¹ e`; `None` when `covariance` is not positive definite or a number is not finite.
pub fn normalized_square<const N: usize>(
    error: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
) -> Option<f64>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let factor = covariance.cholesky()?;
    let value = error.dot(&factor.solve(error));
    value.is_finite().then_some(value)
}

/// Probability that a chi-square variable of `degrees` degrees of freedom is at most `x`: the regularised lower
/// incomplete gamma function P(degrees/2, x/2), by its series below the mean and by its continued fraction above
/// (Abramowitz & Stegun 1964, 6.5.29 and 6.5.31). Absolute error below 1e-10 for up to 1e6 degrees.
pub fn chi_square_probability(x: f64, degrees: usize) -> f64 {
    if degrees == 0 || x.is_nan() {
        return f64::NAN;
    }
    if x <= 0.0 {
        return 0.0;
    }
    if x == f64::INFINITY {
        return 1.0;
    }
    let (a, x) = (degrees as f64 / 2.0, x / 2.0);
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        front * series(a, x)
    } else {
        1.0 - front * continued_fraction(a, x)
    }
}

/// The value that a chi-square variable of `degrees` degrees of freedom stays below with `probability` (0..1,
/// exclusive), by bisection of [`chi_square_probability`]; NaN outside that range.
pub fn chi_square_quantile(probability: f64, degrees: usize) -> f64 {
    if !(probability > 0.0 && probability < 1.0) || degrees == 0 {
        return f64::NAN;
    }
    let k = degrees as f64;
    let (mut low, mut high) = (0.0, k + 60.0 * (2.0 * k).sqrt() + 100.0);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if chi_square_probability(middle, degrees) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// The two-sided interval in which the *mean* of `samples` independent chi-square variables of `degrees` degrees of
/// freedom each lies with `probability`: their sum is chi-square with `samples * degrees` degrees of freedom.
pub fn mean_bounds(samples: usize, degrees: usize, probability: f64) -> [f64; 2] {
    let tail = (1.0 - probability) / 2.0;
    [tail, 1.0 - tail].map(|p| chi_square_quantile(p, samples * degrees) / samples as f64)
}

fn series(a: f64, x: f64) -> f64 {
    let mut term = 1.0 / a;
    let mut sum = term;
    // Terms shrink once n > x - a, and x < a + 1 here; the bound covers a up to about 1e6.
    for n in 1..100_000 {
        term *= x / (a + f64::from(n));
        sum += term;
        if term < sum * 1e-16 {
            break;
        }
    }
    sum
}

fn continued_fraction(a: f64, x: f64) -> f64 {
    // Modified Lentz evaluation of 1/(x+1-a- 1(1-a)/(x+3-a- ...)).
    let tiny = 1e-300;
    let mut b = x + 1.0 - a;
    let mut c = 1.0 / tiny;
    let mut d = 1.0 / b;
    let mut h = d;
    for n in 1..100_000 {
        let n = f64::from(n);
        let an = -n * (n - a);
        b += 2.0;
        d = an * d + b;
        d = 1.0 / if d.abs() < tiny { tiny } else { d };
        c = b + an / c;
        if c.abs() < tiny {
            c = tiny;
        }
        let step = d * c;
        h *= step;
        if (step - 1.0).abs() < 1e-16 {
            break;
        }
    }
    h
}

/// ln Γ(a), a > 0: Stirling's series after shifting the argument above 15 (Abramowitz & Stegun 1964, 6.1.41).
fn ln_gamma(a: f64) -> f64 {
    let mut shift = 0.0;
    let mut a = a;
    while a < 15.0 {
        shift += a.ln();
        a += 1.0;
    }
    let r = 1.0 / (a * a);
    let tail = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r / 1680.0))) / a;
    (a - 0.5) * a.ln() - a + 0.5 * (2.0 * std::f64::consts::PI).ln() + tail - shift
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    /// Quantiles are those of the printed tables (Abramowitz & Stegun 1964, table 26.8).
    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (p, k, table) in [
            (0.95, 1, 3.84146),
            (0.99, 3, 11.3449),
            (0.999, 3, 16.2662),
            (0.025, 6, 1.237_34),
            (0.975, 6, 14.4494),
            (0.5, 10, 9.341_82),
            (0.025, 100, 74.2219),
            (0.975, 100, 129.561),
        ] {
            let got = chi_square_quantile(p, k);
            assert!((got - table).abs() < 1e-5 * table + 5e-5, "{p} {k}: {got}");
        }
    }

    /// Two degrees of freedom have a closed form; many come close to the Wilson–Hilferty approximation.
    #[test]
    fn probability_has_its_closed_form_and_its_limit() {
        for x in [0.01_f64, 0.5, 2.0, 9.0, 40.0] {
            let exact = 1.0 - (-x / 2.0).exp();
            assert!((chi_square_probability(x, 2) - exact).abs() < 1e-13);
        }
        let k = 60_000.0;
        let h = 2.0 / (9.0 * k);
        let approximate = k * (1.0_f64 - h + 1.959_963_985 * h.sqrt()).powi(3);
        let got = chi_square_quantile(0.975, 60_000);
        assert!((got - approximate).abs() < 0.05, "{got} {approximate}");
    }

    /// The normalised square of a known case, and refusal of a matrix that is no covariance.
    #[test]
    fn normalized_square_by_hand() {
        let e = Vector2::new(2.0, 3.0);
        let p = Matrix2::new(4.0, 0.0, 0.0, 9.0);
        assert_eq!(normalized_square(&e, &p), Some(2.0));
        assert_eq!(
            normalized_square(&e, &Matrix2::new(1.0, 2.0, 2.0, 1.0)),
            None
        );
        assert_eq!(normalized_square(&Vector2::new(f64::NAN, 0.0), &p), None);
    }
}
