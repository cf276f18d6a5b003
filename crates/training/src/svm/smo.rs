//! Sequential minimal optimisation with second-order choice of the working set (Fan, Chen and Lin 2005).

use super::Kernel;

/// The dual problem: minimise a'Qa / 2 + p'a with y'a = 0 and 0 <= a_t <= bound, where Q_ts = y_t y_s K(v_t, v_s).
#[derive(Clone, Debug)]
pub struct Dual<'a> {
    /// Kernel between the vectors.
    pub kernel: &'a Kernel,
    /// Which vector belongs to each variable.
    pub vector: Vec<usize>,
    /// Sign of each variable, +1 or -1.
    pub sign: Vec<f64>,
    /// Linear term of each variable.
    pub linear: Vec<f64>,
    /// Largest value of a variable: libsvm's C.
    pub bound: f64,
}

/// Where the optimum lies.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// The variables.
    pub alpha: Vec<f64>,
    /// Offset of the decision: f(x) = sum of sign alpha K - rho.
    pub rho: f64,
    /// Largest violation of the conditions of Karush, Kuhn and Tucker that is left.
    pub violation: f64,
}

/// Violation at which libsvm stops.
pub const TOLERANCE: f64 = 1e-3;
/// In place of a curvature that is not positive.
const TAU: f64 = 1e-12;
/// Steps at most, per variable; libsvm's bound is higher, but a problem that needs as many is of no use here.
const STEPS_PER_VARIABLE: usize = 4000;

impl Dual<'_> {
    /// Solved from alpha = 0 until no pair violates the conditions by more than `tolerance`, or the steps are used up
    /// (then `violation` says how far it is).
    pub fn solved(&self, tolerance: f64) -> Optimum {
        let n = self.sign.len();
        let mut alpha = vec![0.0; n];
        // force_t = -y_t times the gradient: the conditions hold when no variable that may grow along y has a larger one
        // than a variable that may shrink.
        let mut force: Vec<f64> = self
            .sign
            .iter()
            .zip(&self.linear)
            .map(|(y, p)| -y * p)
            .collect();
        let mut violation = f64::INFINITY;
        for _ in 0..STEPS_PER_VARIABLE * n.max(1) {
            let (up, down, gap) = self.working_pair(&alpha, &force);
            violation = gap;
            if gap < tolerance {
                break;
            }
            let (Some(i), Some(j)) = (up, down) else {
                break;
            };
            let step = self.step(&mut alpha, &force, i, j);
            let (row_i, row_j) = (
                self.kernel.row(self.vector[i]),
                self.kernel.row(self.vector[j]),
            );
            for (f, &v) in force.iter_mut().zip(&self.vector) {
                *f -= step * (row_i[v] - row_j[v]);
            }
        }
        Optimum {
            rho: self.rho(&alpha, &force),
            alpha,
            violation,
        }
    }

    fn may_rise(&self, t: usize, alpha: f64) -> bool {
        if self.sign[t] > 0.0 {
            alpha < self.bound
        } else {
            alpha > 0.0
        }
    }

    fn may_fall(&self, t: usize, alpha: f64) -> bool {
        if self.sign[t] > 0.0 {
            alpha > 0.0
        } else {
            alpha < self.bound
        }
    }

    /// The variable with the largest force, the partner that promises the largest decrease, and the largest gap.
    fn working_pair(&self, alpha: &[f64], force: &[f64]) -> (Option<usize>, Option<usize>, f64) {
        let mut up = None;
        let mut most = f64::NEG_INFINITY;
        for (t, &f) in force.iter().enumerate() {
            if f > most && self.may_rise(t, alpha[t]) {
                (up, most) = (Some(t), f);
            }
        }
        let Some(i) = up else {
            return (None, None, 0.0);
        };
        let row = self.kernel.row(self.vector[i]);
        let (mut down, mut best, mut least) = (None, 0.0, f64::INFINITY);
        for (t, &f) in force.iter().enumerate() {
            if !self.may_fall(t, alpha[t]) {
                continue;
            }
            least = least.min(f);
            let gap = most - f;
            if gap > 0.0 {
                let gain = gap * gap / self.curvature(row[self.vector[t]]);
                if gain > best {
                    (down, best) = (Some(t), gain);
                }
            }
        }
        (up, down, most - least)
    }

    /// K_ii + K_jj - 2 K_ij; the radial kernel is 1 on the diagonal.
    fn curvature(&self, between: f64) -> f64 {
        (2.0 - 2.0 * between).max(TAU)
    }

    /// Moves the pair along y and returns by how much.
    fn step(&self, alpha: &mut [f64], force: &[f64], i: usize, j: usize) -> f64 {
        let between = self.kernel.at(self.vector[i], self.vector[j]);
        let room = |t: usize, along: f64| {
            if self.sign[t] * along > 0.0 {
                self.bound - alpha[t]
            } else {
                alpha[t]
            }
        };
        let (room_i, room_j) = (room(i, 1.0), room(j, -1.0));
        let wanted = (force[i] - force[j]) / self.curvature(between);
        let step = wanted.min(room_i).min(room_j);
        // A variable that reaches its end is put exactly there.
        let moved = |t: usize, along: f64, room: f64| {
            let grows = self.sign[t] * along > 0.0;
            match (step >= room, grows) {
                (true, true) => self.bound,
                (true, false) => 0.0,
                (false, true) => alpha[t] + step,
                (false, false) => alpha[t] - step,
            }
        };
        let (new_i, new_j) = (moved(i, 1.0, room_i), moved(j, -1.0, room_j));
        alpha[i] = new_i;
        alpha[j] = new_j;
        step
    }

    /// Minus the mean force of the free variables, or of the middle of what the bound ones allow.
    fn rho(&self, alpha: &[f64], force: &[f64]) -> f64 {
        let (mut sum, mut free) = (0.0, 0usize);
        let (mut lowest, mut highest) = (f64::NEG_INFINITY, f64::INFINITY);
        for (t, &f) in force.iter().enumerate() {
            match (self.may_rise(t, alpha[t]), self.may_fall(t, alpha[t])) {
                (true, true) => {
                    sum += f;
                    free += 1;
                }
                (true, false) => lowest = lowest.max(f),
                (false, true) => highest = highest.min(f),
                (false, false) => {}
            }
        }
        if free > 0 {
            -sum / free as f64
        } else {
            -(lowest + highest) / 2.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two points of either sign at distance d: both variables are 1 / (1 - K), unless the bound is lower, and rho is 0.
    #[test]
    fn two_points_have_a_closed_form() {
        let (mut a, mut b) = ([0.0; 88], [0.0; 88]);
        (a[0], b[0]) = (1.0, -1.0);
        let kernel = Kernel::new(&[&a, &b], 0.25);
        let dual = |bound| Dual {
            kernel: &kernel,
            vector: vec![0, 1],
            sign: vec![1.0, -1.0],
            linear: vec![-1.0; 2],
            bound,
        };
        let expected = 1.0 / (1.0 - (-1.0f64).exp());
        let free = dual(100.0).solved(1e-9);
        assert!((free.alpha[0] - expected).abs() < 1e-9 && (free.alpha[1] - expected).abs() < 1e-9);
        assert!(free.rho.abs() < 1e-9);
        assert_eq!(dual(0.5).solved(1e-9).alpha, [0.5, 0.5]);
    }
}
