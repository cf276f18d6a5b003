//! Probabilities from decision values: 1 / (1 + exp(A f + B)), fitted by Newton's method with backtracking (Platt 2000 in
//! the form of Lin, Lin and Weng 2007).

/// A and B.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmoid {
    /// Slope; negative where larger values mean the positive class.
    pub a: f64,
    /// Offset.
    pub b: f64,
}

const STEPS: usize = 100;
const SMALLEST_STEP: f64 = 1e-10;
const RIDGE: f64 = 1e-12;
const GRADIENT: f64 = 1e-5;

/// Fitted to decision values and their true classes.
pub fn sigmoid_from_decisions(values: &[f64], positive: &[bool]) -> Sigmoid {
    let ups = positive.iter().filter(|&&p| p).count() as f64;
    let downs = positive.len() as f64 - ups;
    let (high, low) = ((ups + 1.0) / (ups + 2.0), 1.0 / (downs + 2.0));
    let targets: Vec<f64> = positive
        .iter()
        .map(|&p| if p { high } else { low })
        .collect();
    let mut at = Sigmoid {
        a: 0.0,
        b: ((downs + 1.0) / (ups + 1.0)).ln(),
    };
    let mut cost = cost_of(values, &targets, at);
    for _ in 0..STEPS {
        let slope = derivatives(values, &targets, at);
        if slope.a.abs() < GRADIENT && slope.b.abs() < GRADIENT {
            break;
        }
        let determinant = slope.aa * slope.bb - slope.ab * slope.ab;
        let da = -(slope.bb * slope.a - slope.ab * slope.b) / determinant;
        let db = -(slope.aa * slope.b - slope.ab * slope.a) / determinant;
        let descent = slope.a * da + slope.b * db;
        let mut step = 1.0;
        while step >= SMALLEST_STEP {
            let next = Sigmoid {
                a: at.a + step * da,
                b: at.b + step * db,
            };
            let next_cost = cost_of(values, &targets, next);
            if next_cost < cost + 1e-4 * step * descent {
                (at, cost) = (next, next_cost);
                break;
            }
            step /= 2.0;
        }
        if step < SMALLEST_STEP {
            break;
        }
    }
    at
}

/// Cross entropy, written so that nothing overflows.
fn cost_of(values: &[f64], targets: &[f64], s: Sigmoid) -> f64 {
    let terms = values.iter().zip(targets).map(|(v, t)| {
        let z = s.a * v + s.b;
        if z >= 0.0 {
            t * z + (-z).exp().ln_1p()
        } else {
            (t - 1.0) * z + z.exp().ln_1p()
        }
    });
    terms.sum()
}

struct Derivatives {
    a: f64,
    b: f64,
    aa: f64,
    bb: f64,
    ab: f64,
}

fn derivatives(values: &[f64], targets: &[f64], s: Sigmoid) -> Derivatives {
    let mut d = Derivatives {
        a: 0.0,
        b: 0.0,
        aa: RIDGE,
        bb: RIDGE,
        ab: 0.0,
    };
    for (&v, t) in values.iter().zip(targets) {
        let z = s.a * v + s.b;
        let p = if z >= 0.0 {
            (-z).exp() / (1.0 + (-z).exp())
        } else {
            1.0 / (1.0 + z.exp())
        };
        let curvature = p * (1.0 - p);
        d.aa += v * v * curvature;
        d.bb += curvature;
        d.ab += v * curvature;
        d.a += v * (t - p);
        d.b += t - p;
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the optimum the predicted share of positives is that of the targets, and so is the mean of value times share:
    /// both derivatives are zero.
    #[test]
    fn derivatives_vanish_at_the_fit() {
        let values: Vec<f64> = (0..60).map(|i| f64::from(i) / 10.0 - 3.0).collect();
        let positive: Vec<bool> = (0..60).map(|i| (i * 7) % 60 < i).collect();
        let fit = sigmoid_from_decisions(&values, &positive);
        assert!(fit.a < 0.0);
        let ups = positive.iter().filter(|&&p| p).count() as f64;
        let targets: Vec<f64> = positive
            .iter()
            .map(|&p| {
                if p {
                    (ups + 1.0) / (ups + 2.0)
                } else {
                    1.0 / (62.0 - ups)
                }
            })
            .collect();
        let slope = derivatives(&values, &targets, fit);
        assert!(slope.a.abs() < 1e-4 && slope.b.abs() < 1e-4);
    }
}
