//! How a lens bends the picture: Brown–Conrady for ordinary lenses, Kannala–Brandt for wide ones.
//!
//! Every model maps the plane z = 1 to itself: an undistorted position (x/z, y/z) to where an ideal pinhole of the same focal lengths
//! would have to see the point. So only points in front of the lens (z > 0, less than 90 degrees off the axis) have one.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// The lens model of a camera, with its coefficients. In files it is a table of named coefficients; `model` names the model, and where it
/// is left out the lens is Brown–Conrady.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "DistortionTable", into = "DistortionTable")]
pub enum Distortion {
    /// Polynomial in the distance from the axis on the plane z = 1.
    BrownConrady(BrownConrady),
    /// Polynomial in the angle from the axis.
    KannalaBrandt(KannalaBrandt),
}

impl Default for Distortion {
    fn default() -> Self {
        Self::NONE
    }
}

impl From<BrownConrady> for Distortion {
    fn from(lens: BrownConrady) -> Self {
        Self::BrownConrady(lens)
    }
}

impl From<KannalaBrandt> for Distortion {
    fn from(lens: KannalaBrandt) -> Self {
        Self::KannalaBrandt(lens)
    }
}

impl Distortion {
    /// No distortion at all: an ideal pinhole.
    pub const NONE: Self = Self::BrownConrady(BrownConrady::NONE);

    /// The model's name in files and reports.
    pub fn model(&self) -> &'static str {
        match self {
            Self::BrownConrady(_) => "brown-conrady",
            Self::KannalaBrandt(_) => "kannala-brandt",
        }
    }

    /// The coefficients in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6 of Brown–Conrady, k1 k2 k3 k4 of Kannala–Brandt.
    pub fn coefficients(&self) -> Vec<f64> {
        match self {
            Self::BrownConrady(d) => vec![d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, d.k5, d.k6],
            Self::KannalaBrandt(d) => vec![d.k1, d.k2, d.k3, d.k4],
        }
    }

    /// The coefficients of a Brown–Conrady lens, to look at or to change; `None` for another model.
    pub fn brown_conrady_mut(&mut self) -> Option<&mut BrownConrady> {
        match self {
            Self::BrownConrady(lens) => Some(lens),
            Self::KannalaBrandt(_) => None,
        }
    }

    /// Whether the lens is an ideal pinhole.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Distorted position on the plane z = 1 of an undistorted one.
    pub fn distort(&self, p: &Point2<f64>) -> Point2<f64> {
        match self {
            Self::BrownConrady(lens) => lens.distort(p),
            Self::KannalaBrandt(lens) => lens.distort(p),
        }
    }

    /// Whether the model is folded over at an undistorted position: its Jacobian's determinant or its radial factor is not
    /// positive there, so that it mirrors what a lens shows. A local test: of a model that folds twice it accepts what lies beyond the second
    /// fold.
    pub fn folds_at(&self, p: &Point2<f64>) -> bool {
        match self {
            Self::BrownConrady(lens) => lens.folds_at(p),
            Self::KannalaBrandt(lens) => lens.folds_at(p),
        }
    }

    /// Inverse of [`Self::distort`] by Newton's method with a numeric check; `None` where the model folds over
    /// (no undistorted point maps there, to 1e-12 within 30 steps).
    pub fn undistort(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        match self {
            Self::BrownConrady(lens) => lens.undistort(d),
            Self::KannalaBrandt(lens) => lens.undistort(d),
        }
    }

    /// `[dx'/dx, dx'/dy, dy'/dx, dy'/dy]` of [`Self::distort`].
    pub fn jacobian(&self, p: &Point2<f64>) -> [f64; 4] {
        match self {
            Self::BrownConrady(lens) => lens.jacobian(p),
            Self::KannalaBrandt(lens) => lens.jacobian(p),
        }
    }
}

/// Brown–Conrady distortion in OpenCV's rational form (Brown 1971; Claus & Fitzgibbon 2005 for the quotient).
///
/// With x, y on the plane z = 1 and r² = x² + y²:
/// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, and
/// `y' = y (...)/(...) + p1 (r² + 2 y²) + 2 p2 x y`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BrownConrady {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
    /// Radial in the denominator, r².
    pub k4: f64,
    /// Radial in the denominator, r⁴.
    pub k5: f64,
    /// Radial in the denominator, r⁶.
    pub k6: f64,
}

impl BrownConrady {
    /// No distortion at all.
    pub const NONE: Self = Self {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
        k4: 0.0,
        k5: 0.0,
        k6: 0.0,
    };

    /// Whether every coefficient is zero.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Distorted position on the plane z = 1 of an undistorted one.
    pub fn distort(&self, p: &Point2<f64>) -> Point2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = self.radial(r2);
        Point2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// As [`Distortion::folds_at`].
    pub fn folds_at(&self, p: &Point2<f64>) -> bool {
        if self.is_none() {
            return false;
        }
        let j = self.jacobian(p);
        let upright = j[0] * j[3] - j[1] * j[2] > 0.0 && self.radial(p.coords.norm_squared()) > 0.0;
        !upright
    }

    fn radial(&self, r2: f64) -> f64 {
        (1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3)))
            / (1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)))
    }

    /// As [`Distortion::undistort`].
    pub fn undistort(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        if self.is_none() {
            return Some(*d);
        }
        let mut p = *d;
        for _ in 0..30 {
            let j = self.jacobian(&p);
            let det = j[0] * j[3] - j[1] * j[2];
            if !det.is_finite() || det <= 1e-9 {
                return None;
            }
            let e = self.distort(&p) - d;
            let step_x = (j[3] * e.x - j[1] * e.y) / det;
            let step_y = (j[0] * e.y - j[2] * e.x) / det;
            p.x -= step_x;
            p.y -= step_y;
            if step_x.abs().max(step_y.abs()) < 1e-13 {
                break;
            }
        }
        ((self.distort(&p) - d).norm() < 1e-12 * (1.0 + d.coords.norm())).then_some(p)
    }

    /// `[dx'/dx, dx'/dy, dy'/dx, dy'/dy]` of [`Self::distort`].
    pub fn jacobian(&self, p: &Point2<f64>) -> [f64; 4] {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let num = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let den = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6));
        let num_d = self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3);
        let den_d = self.k4 + r2 * (2.0 * self.k5 + 3.0 * r2 * self.k6);
        let radial = num / den;
        // d radial / d r²
        let slope = (num_d * den - num * den_d) / (den * den);
        let cross = 2.0 * x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        [
            radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            cross,
            cross,
            radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        ]
    }
}

/// Kannala–Brandt distortion (Kannala & Brandt 2006, Eq. 6 with the equidistant term's factor 1, as OpenCV's `fisheye` and Kalibr's
/// `equidistant` have it): with θ the angle from the axis, `θ' = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)` is the distorted distance from
/// the axis on the plane z = 1, the direction around the axis kept. All coefficients 0 is the equidistant lens, not a pinhole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KannalaBrandt {
    /// θ³.
    pub k1: f64,
    /// θ⁵.
    pub k2: f64,
    /// θ⁷.
    pub k3: f64,
    /// θ⁹.
    pub k4: f64,
}

/// Below this distance from the axis the radial factor and its slope are taken from their series: the quotients lose digits there.
const NEAR_AXIS: f64 = 1e-4;

impl KannalaBrandt {
    /// Distorted position on the plane z = 1 of an undistorted one.
    pub fn distort(&self, p: &Point2<f64>) -> Point2<f64> {
        let (factor, _) = self.factor(p.coords.norm());
        Point2::from(p.coords * factor)
    }

    /// As [`Distortion::folds_at`].
    pub fn folds_at(&self, p: &Point2<f64>) -> bool {
        let theta = p.coords.norm().atan();
        let upright = self.slope(theta) > 0.0 && self.theta_distorted(theta) >= 0.0;
        !upright
    }

    /// As [`Distortion::undistort`]; also `None` for what lies 90 degrees or more off the axis.
    pub fn undistort(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        let goal = d.coords.norm();
        if goal < 1e-12 {
            return Some(*d);
        }
        let mut theta = goal.min(1.5);
        for _ in 0..30 {
            let slope = self.slope(theta);
            if !slope.is_finite() || slope <= 1e-9 {
                return None;
            }
            let step = (self.theta_distorted(theta) - goal) / slope;
            theta -= step;
            if step.abs() < 1e-14 {
                break;
            }
        }
        let found = (self.theta_distorted(theta) - goal).abs() < 1e-12 * (1.0 + goal);
        (found && (0.0..std::f64::consts::FRAC_PI_2 - 1e-6).contains(&theta))
            .then(|| Point2::from(d.coords * (theta.tan() / goal)))
    }

    /// `[dx'/dx, dx'/dy, dy'/dx, dy'/dy]` of [`Self::distort`].
    pub fn jacobian(&self, p: &Point2<f64>) -> [f64; 4] {
        let (x, y) = (p.x, p.y);
        let (factor, slope_over_r) = self.factor(p.coords.norm());
        let cross = x * y * slope_over_r;
        [
            factor + x * x * slope_over_r,
            cross,
            cross,
            factor + y * y * slope_over_r,
        ]
    }

    fn theta_distorted(&self, theta: f64) -> f64 {
        let t2 = theta * theta;
        theta * (1.0 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4))))
    }

    /// d θ' / d θ.
    fn slope(&self, theta: f64) -> f64 {
        let t2 = theta * theta;
        1.0 + t2
            * (3.0 * self.k1 + t2 * (5.0 * self.k2 + t2 * (7.0 * self.k3 + t2 * 9.0 * self.k4)))
    }

    /// The factor s(r) = θ'/r of a position at distance r from the axis, and s'(r)/r.
    fn factor(&self, r: f64) -> (f64, f64) {
        if r < NEAR_AXIS {
            // θ = r - r³/3 + ..., so s = 1 + (k1 - 1/3) r² + O(r⁴).
            let c = self.k1 - 1.0 / 3.0;
            return (1.0 + c * r * r, 2.0 * c);
        }
        let theta = r.atan();
        let factor = self.theta_distorted(theta) / r;
        let slope = (self.slope(theta) / (1.0 + r * r) - factor) / r;
        (factor, slope / r)
    }
}

/// Lens models by the names they have in the file.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum LensModel {
    BrownConrady,
    KannalaBrandt,
}

/// A lens in a file: Brown–Conrady where `model` is left out, each coefficient 0 where it is left out.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct DistortionTable {
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<LensModel>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k5: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k6: Option<f64>,
}

impl TryFrom<DistortionTable> for Distortion {
    type Error = String;

    fn try_from(table: DistortionTable) -> Result<Self, String> {
        let or_0 = |c: Option<f64>| c.unwrap_or(0.0);
        let [k1, k2, k3, k4] = [table.k1, table.k2, table.k3, table.k4].map(or_0);
        match table.model.unwrap_or(LensModel::BrownConrady) {
            LensModel::BrownConrady => Ok(BrownConrady {
                k1,
                k2,
                p1: or_0(table.p1),
                p2: or_0(table.p2),
                k3,
                k4,
                k5: or_0(table.k5),
                k6: or_0(table.k6),
            }
            .into()),
            LensModel::KannalaBrandt => {
                if [table.p1, table.p2, table.k5, table.k6]
                    .iter()
                    .any(Option::is_some)
                {
                    return Err(
                        "a kannala-brandt lens has the coefficients k1, k2, k3 and k4 only"
                            .to_owned(),
                    );
                }
                Ok(KannalaBrandt { k1, k2, k3, k4 }.into())
            }
        }
    }
}

impl From<Distortion> for DistortionTable {
    fn from(lens: Distortion) -> Self {
        match lens {
            Distortion::BrownConrady(d) => Self {
                model: None,
                k1: Some(d.k1),
                k2: Some(d.k2),
                p1: Some(d.p1),
                p2: Some(d.p2),
                k3: Some(d.k3),
                k4: Some(d.k4),
                k5: Some(d.k5),
                k6: Some(d.k6),
            },
            Distortion::KannalaBrandt(d) => Self {
                model: Some(LensModel::KannalaBrandt),
                k1: Some(d.k1),
                k2: Some(d.k2),
                k3: Some(d.k3),
                k4: Some(d.k4),
                ..Self::default()
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rational() -> BrownConrady {
        // Factory values of a real wide-angle module: large coefficients that nearly cancel.
        BrownConrady {
            k1: -9.209368705749512,
            k2: 65.29181671142578,
            p1: -5.2e-5,
            p2: 4.9e-4,
            k3: -87.71741485595703,
            k4: -9.287524223327637,
            k5: 65.54322052001953,
            k6: -87.8282699584961,
        }
    }

    fn models() -> [(Distortion, f64); 4] {
        let mild = BrownConrady {
            k1: -0.12,
            k2: 0.03,
            p1: 4e-4,
            p2: -3e-4,
            ..BrownConrady::NONE
        };
        // A lens of a fisheye data set, and the pure equidistant one.
        let wide = KannalaBrandt {
            k1: 0.0034,
            k2: 0.0007,
            k3: -0.0002,
            k4: 1e-5,
        };
        [
            (mild.into(), 0.6),
            (rational().into(), 0.3),
            (wide.into(), 4.0),
            (KannalaBrandt::default().into(), 8.0),
        ]
    }

    /// Undistortion inverts distortion over the field that the lens sees, for every model.
    #[test]
    fn undistort_inverts_distort() {
        for (model, reach) in models() {
            for i in -10..=10 {
                for j in -10..=10 {
                    let p = Point2::new(f64::from(i) / 10.0 * reach, f64::from(j) / 10.0 * reach);
                    let back = model.undistort(&model.distort(&p)).unwrap();
                    assert!(
                        (back - p).norm() < 1e-10 * (1.0 + p.coords.norm_squared()),
                        "{p} -> {back}"
                    );
                }
            }
        }
    }

    /// The analytic Jacobian agrees with central differences, for every model, on the axis and just beside it too.
    #[test]
    fn jacobian_agrees_with_differences() {
        let h = 1e-6;
        for (model, _) in models() {
            for (x, y) in [
                (0.0, 0.0),
                (2e-5, 3e-5),
                (2e-4, -1e-4),
                (0.2, -0.1),
                (-0.25, 0.15),
            ] {
                let j = model.jacobian(&Point2::new(x, y));
                let dx = (model.distort(&Point2::new(x + h, y))
                    - model.distort(&Point2::new(x - h, y)))
                    / (2.0 * h);
                let dy = (model.distort(&Point2::new(x, y + h))
                    - model.distort(&Point2::new(x, y - h)))
                    / (2.0 * h);
                for (a, b) in j.iter().zip([dx.x, dy.x, dx.y, dy.y]) {
                    assert!((a - b).abs() < 1e-7, "{model:?} at {x}, {y}: {a} {b}");
                }
            }
        }
    }

    /// The equidistant lens sees the angle itself: 45 degrees off the axis lie π/4 from the centre.
    #[test]
    fn equidistant_lens_sees_the_angle() {
        let d = KannalaBrandt::default().distort(&Point2::new(0.6, -0.8));
        assert!((d.coords.norm() - std::f64::consts::FRAC_PI_4).abs() < 1e-15);
        assert!((d.x / d.y + 0.75).abs() < 1e-15);
        // 89 degrees are seen, 90 are beyond this plane.
        let behind = Point2::new(std::f64::consts::FRAC_PI_2, 0.0);
        assert_eq!(KannalaBrandt::default().undistort(&behind), None);
    }
}
