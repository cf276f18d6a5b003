//! A bracketed root finder.

use crate::error::{GeometryError, Result};

/// Steps after which [`brent`] gives up; bisection alone would need about 100 for any bracket of doubles.
pub const MAX_STEPS: usize = 200;

/// Root of `f` between `low` and `high`, where its values must differ in sign (a zero at an end is a root): Brent's
/// method (Brent 1973, "Algorithms for Minimization without Derivatives", ch. 4), to about 4 units in the last place.
///
/// `what` names the function in errors. Bounded by [`MAX_STEPS`].
pub fn brent(
    what: &'static str,
    low: f64,
    high: f64,
    mut f: impl FnMut(f64) -> f64,
) -> Result<f64> {
    let (mut a, mut b) = (low, high);
    let (mut fa, mut fb) = (f(a), f(b));
    let no_root = GeometryError::NoRoot {
        what,
        low,
        high,
        at_low: fa,
        at_high: fb,
    };
    if fa.is_nan() || fb.is_nan() || fa * fb > 0.0 || low.is_nan() || high.is_nan() {
        return Err(no_root);
    }
    // b is the best guess, a the one before it, c keeps the root bracketed with b.
    let (mut c, mut fc) = (a, fa);
    let mut step = b - a;
    let mut step_before = step;
    for _ in 0..MAX_STEPS {
        if fb.is_nan() {
            return Err(no_root);
        }
        if fb * fc > 0.0 {
            (c, fc) = (a, fa);
            step = b - a;
            step_before = step;
        }
        if fc.abs() < fb.abs() {
            (a, fa) = (b, fb);
            (b, fb) = (c, fc);
            (c, fc) = (a, fa);
        }
        let tolerance = 2.0 * f64::EPSILON * b.abs() + f64::MIN_POSITIVE;
        let half = 0.5 * (c - b);
        if half.abs() <= tolerance || fb == 0.0 {
            return Ok(b);
        }
        let (next, before) = if step_before.abs() < tolerance || fa.abs() <= fb.abs() {
            (half, half)
        } else {
            interpolated([a, b, c], [fa, fb, fc], step_before, tolerance)
                .map_or((half, half), |s| (s, step))
        };
        (step, step_before) = (next, before);
        (a, fa) = (b, fb);
        b += if step.abs() > tolerance {
            step
        } else {
            tolerance.copysign(half)
        };
        fb = f(b);
    }
    Err(GeometryError::NotSettled {
        what,
        steps: MAX_STEPS,
    })
}

/// The step from b by inverse quadratic interpolation, or the secant when only two points differ; `None` when it
/// would leave the bracket or shrink too slowly.
fn interpolated(
    [a, b, c]: [f64; 3],
    [fa, fb, fc]: [f64; 3],
    step_before: f64,
    tolerance: f64,
) -> Option<f64> {
    let half = 0.5 * (c - b);
    let s = fb / fa;
    let (mut p, mut q) = if a == c {
        (2.0 * half * s, 1.0 - s)
    } else {
        let (q, r) = (fa / fc, fb / fc);
        (
            s * (2.0 * half * q * (q - r) - (b - a) * (r - 1.0)),
            (q - 1.0) * (r - 1.0) * (s - 1.0),
        )
    };
    if p > 0.0 {
        q = -q;
    } else {
        p = -p;
    }
    let inside = 2.0 * p < 3.0 * half * q - (tolerance * q).abs();
    let shrinks = p < (0.5 * step_before * q).abs();
    (inside && shrinks).then(|| p / q)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Roots of functions with known ones, among them a flat and a steep one.
    #[test]
    fn finds_known_roots() {
        let cube = brent("x³ - 2", 0.0, 2.0, |x| x * x * x - 2.0).unwrap();
        assert!((cube - 2f64.cbrt()).abs() < 1e-15);
        let flat = brent("(x - 1)^9", 0.0, 3.0, |x| (x - 1.0).powi(9)).unwrap();
        assert!((flat - 1.0).abs() < 1e-12, "{flat}");
        let steep = brent("1/x - 1e6", 1e-9, 1.0, |x| 1.0 / x - 1e6).unwrap();
        assert!((steep * 1e6 - 1.0).abs() < 1e-14, "{steep}");
        assert_eq!(brent("end", 0.0, 1.0, |x| x).unwrap(), 0.0);
    }

    /// No change of sign, or NaN, is an error and not a number.
    #[test]
    fn refuses_what_has_no_root() {
        assert!(matches!(
            brent("x² + 1", -1.0, 1.0, |x| x * x + 1.0),
            Err(GeometryError::NoRoot { .. })
        ));
        assert!(brent("nan", 0.0, 1.0, |_| f64::NAN).is_err());
    }

    /// A jump is located as sharply as a root, within the bound of steps.
    #[test]
    fn locates_a_jump() {
        let x = brent("jump", 0.0, 10.0, |x| if x < 3.7 { -1.0 } else { 1.0 }).unwrap();
        assert!((x - 3.7).abs() < 1e-14);
    }
}
