//! The masks of the steerable pyramid as the release has them: linear interpolation in equispaced tables.
//!
//! The formulas behind the tables differ from them by up to 5e-6, which moves features by up to 1e-3: the tables are
//! part of the index.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// Orientations of each scale.
pub(crate) const ORIENTATIONS: usize = 6;

/// Entries of the angular table in half a turn.
const HALF_TURN: f64 = 1024.0;

/// Entries of the radial tables per octave, and the octave of the first entry in entries below zero.
const OCTAVE: f64 = 256.0;
const RADIAL_ORIGIN: f64 = 257.0;

/// Entries of the angular table before angle zero.
const ANGULAR_ORIGIN: f64 = 2049.0;

/// The tables: what passes a ring, what stays below it, and the six lobes.
#[derive(Debug)]
pub(crate) struct Tables {
    high: Vec<f64>,
    low: Vec<f64>,
    angular: Vec<f64>,
}

/// Made once: they hold for every picture.
pub(crate) static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

impl Tables {
    fn new() -> Self {
        let mut squares: Vec<f64> = (-257..=1)
            .map(|m| (PI * f64::from(m) / 512.0).cos().powi(2))
            .collect();
        let last = squares.len() - 1;
        squares[0] = squares[1];
        squares[last] = squares[last - 1];
        // 2¹⁰ (5!)² / (6 · 10!), so that the squares of the six lobes add to 1 before the order's gain.
        let gain = (1024.0_f64 * 120.0 * 120.0 / (6.0 * 3_628_800.0)).sqrt();
        Self {
            high: squares.iter().map(|v| v.sqrt()).collect(),
            low: squares.iter().map(|v| (1.0 - v).sqrt()).collect(),
            angular: (-2049..=1025)
                .map(|m| gain * (PI * f64::from(m) / HALF_TURN).cos().powi(5))
                .collect(),
        }
    }

    /// High-pass at `rho` (octaves, 0 at Nyquist on an axis) for a ring `shift` octaves down.
    pub(crate) fn high(&self, rho: f64, shift: f64) -> f64 {
        interpolated(&self.high, radial_position(rho, shift))
    }

    /// Low-pass, the rest of [`Self::high`] in power. Zero wherever `rho + shift >= 0`.
    pub(crate) fn low(&self, rho: f64, shift: f64) -> f64 {
        interpolated(&self.low, radial_position(rho, shift))
    }

    /// Lobe `b` (0 to 5) in the direction that [`turn_from_angle`] gives. Odd under half a turn, and not cut in half.
    pub(crate) fn angular(&self, turn: f64, b: usize) -> f64 {
        let shift = HALF_TURN / ORIENTATIONS as f64 * b as f64;
        interpolated(&self.angular, turn + (ANGULAR_ORIGIN - shift))
    }
}

/// An angle in radians in steps of the angular table.
pub(crate) fn turn_from_angle(theta_rad: f64) -> f64 {
    theta_rad * (HALF_TURN / PI)
}

fn radial_position(rho: f64, shift: f64) -> f64 {
    (rho + shift) * OCTAVE + RADIAL_ORIGIN
}

/// The table at a position counted from its first entry; the last pieces at both ends are extrapolated.
fn interpolated(table: &[f64], position: f64) -> f64 {
    // Casting saturates: what is below the table is entry 0.
    let i = (position as usize).min(table.len() - 2);
    table[i] + (table[i + 1] - table[i]) * (position - i as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Low and high share the power at every entry, ends are flat, and the lobes are odd under half a turn: what the
    /// half spectra of the pyramid rely on.
    #[test]
    fn masks_share_the_power_and_lobes_are_odd() {
        let t = &TABLES;
        for m in -300..=40 {
            let rho = f64::from(m) / 256.0;
            let power = t.high(rho, 0.0).powi(2) + t.low(rho, 0.0).powi(2);
            assert!((power - 1.0).abs() < 1e-15);
        }
        assert_eq!(t.low(0.0, 0.0), 0.0);
        assert_eq!(t.low(0.4, 0.0), 0.0);
        assert_eq!(t.low(-1.0, 1.0), 0.0);
        assert!(t.high(-5.0, 0.0).abs() < 1e-16);
        for i in 0..200 {
            let turn = f64::from(i) * 5.12;
            for b in 0..ORIENTATIONS {
                let sum = t.angular(turn, b) + t.angular(turn - HALF_TURN, b);
                assert!(sum.abs() < 1e-12);
            }
        }
    }

    /// Half way between two entries stands their mean, not the formula.
    #[test]
    fn tables_are_interpolated_linearly() {
        let t = &TABLES;
        let entry = |m: f64| t.high(m / 256.0, 0.0);
        let middle = entry(-100.5);
        assert!((middle - 0.5 * (entry(-100.0) + entry(-101.0))).abs() < 1e-15);
        assert!((middle - (PI * -100.5 / 512.0).cos()).abs() > 1e-7);
    }
}
