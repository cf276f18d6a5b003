//! What the filter is told: a target seen at a time, in the space where the noise is constant.

use nalgebra::{
    Const, DimMin, Isometry3, Matrix2, Matrix3, Point3, SMatrix, SVector, Vector2, Vector3,
};

use super::models::State;

/// One sight of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Middle of the exposure, s on the run's clock.
    pub time_s: f64,
    /// What was seen.
    pub sight: Sight,
}

/// What was seen, with its noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sight {
    /// Direction and inverse depth in a head frame: `(x/z, y/z, 1/z)`, of which the noise hardly depends on the
    /// distance (disparity space: 1/z is disparity over focal length times interaxial).
    Stereo {
        /// Where the head stood at that time.
        base_from_head: Isometry3<f64>,
        /// `(x/z, y/z, 1/z)`; the last in 1/m.
        value: Vector3<f64>,
        /// Its covariance, symmetric positive definite; units `1, 1, 1/m`.
        covariance: Matrix3<f64>,
    },
    /// Direction alone, when the distance could not be measured: `(x/z, y/z)` in a head frame.
    Direction {
        /// Where the head stood at that time.
        base_from_head: Isometry3<f64>,
        /// `(x/z, y/z)`.
        value: Vector2<f64>,
        /// Its covariance, symmetric positive definite.
        covariance: Matrix2<f64>,
    },
    /// A point in the base frame, from a wide base line.
    Position {
        /// The point, metres.
        position_in_base: Point3<f64>,
        /// Its covariance, m², symmetric positive definite.
        covariance: Matrix3<f64>,
    },
}

/// Nearest depth in front of a head at which directions are still linearised, metres.
const NEAREST_M: f64 = 0.05;

/// Beyond this a number of a measurement is a mistake (metres, or rise over run).
const LARGEST: f64 = 1e6;

/// Below this a variance is a mistake: a ten-thousandth of a pixel, a tenth of a micrometre.
const LEAST_VARIANCE: f64 = 1e-14;

impl Sight {
    /// Components of the measurement: 3, or 2 for a direction alone.
    pub fn degrees(&self) -> usize {
        match self {
            Sight::Direction { .. } => 2,
            _ => 3,
        }
    }

    /// Why this cannot be used, in words; `None` when it can.
    pub(crate) fn fault(&self) -> Option<&'static str> {
        match self {
            Sight::Stereo {
                base_from_head,
                value,
                covariance,
            } => pose_fault(base_from_head).or_else(|| numbers_fault(value, covariance)),
            Sight::Direction {
                base_from_head,
                value,
                covariance,
            } => pose_fault(base_from_head).or_else(|| numbers_fault(value, covariance)),
            Sight::Position {
                position_in_base,
                covariance,
            } => numbers_fault(&position_in_base.coords, covariance),
        }
    }

    /// Position in the base frame and its covariance, as far as one sight tells it: first order for
    /// [`Sight::Stereo`]. `None` for a direction alone, and for an inverse depth beyond `1 / farthest_m` or negative
    /// (its distance has no finite mean).
    pub(crate) fn position(&self, farthest_m: f64) -> Option<(Point3<f64>, Matrix3<f64>)> {
        match self {
            Sight::Position {
                position_in_base,
                covariance,
            } => Some((*position_in_base, *covariance)),
            Sight::Direction { .. } => None,
            Sight::Stereo {
                base_from_head,
                value,
                covariance,
            } => {
                if value.z < 1.0 / farthest_m {
                    return None;
                }
                let z = 1.0 / value.z;
                let point = Point3::new(value.x * z, value.y * z, z);
                // d(x, y, z) / d(x/z, y/z, 1/z)
                let j = Matrix3::new(
                    z,
                    0.0,
                    -value.x * z * z,
                    0.0,
                    z,
                    -value.y * z * z,
                    0.0,
                    0.0,
                    -z * z,
                );
                let turn = base_from_head.rotation.to_rotation_matrix();
                let j = turn.matrix() * j;
                Some((base_from_head * point, j * covariance * j.transpose()))
            }
        }
    }
}

fn pose_fault(pose: &Isometry3<f64>) -> Option<&'static str> {
    let small = |x: &f64| x.abs() <= LARGEST;
    let finite = pose.translation.vector.iter().all(small)
        && pose.rotation.coords.iter().all(|x| x.is_finite());
    (!finite).then_some("the head's pose is not finite, or beyond 1e6 m")
}

fn numbers_fault<const N: usize>(
    value: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
) -> Option<&'static str>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let variances = covariance.diagonal();
    let small = |x: &f64| x.abs() <= LARGEST;
    if !value.iter().all(small) {
        Some("the measured value is not finite, or beyond 1e6")
    } else if !covariance.iter().all(small) {
        Some("the measurement's covariance is not finite, or beyond 1e6")
    } else if (covariance - covariance.transpose()).amax() > 1e-9 * covariance.amax() {
        Some("the measurement's covariance is not symmetric")
    } else if !variances.iter().all(|&v| v >= LEAST_VARIANCE) || covariance.cholesky().is_none() {
        Some("the measurement's covariance is not positive definite, or below 1e-14")
    } else {
        None
    }
}

/// A measurement of `N` components around a state: expected value and its derivative by position.
#[derive(Clone, Debug)]
pub(crate) struct Expected<const N: usize> {
    pub(crate) value: SVector<f64, N>,
    pub(crate) by_position: SMatrix<f64, N, 3>,
}

/// `(x/z, y/z, 1/z)` in the head frame of a state, with its derivative by the position in the base frame; a
/// position nearer than [`NEAREST_M`] in front of the head is taken as that near.
pub(crate) fn stereo_of(base_from_head: &Isometry3<f64>, state: &State) -> Expected<3> {
    let position = Point3::new(state[0], state[1], state[2]);
    let p = base_from_head.inverse_transform_point(&position);
    let z = p.z.max(NEAREST_M);
    let (x, y, w) = (p.x / z, p.y / z, 1.0 / z);
    let by_head = Matrix3::new(w, 0.0, -x * w, 0.0, w, -y * w, 0.0, 0.0, -w * w);
    let head_from_base = base_from_head.rotation.inverse().to_rotation_matrix();
    Expected {
        value: Vector3::new(x, y, w),
        by_position: by_head * head_from_base.matrix(),
    }
}

/// The direction part of [`stereo_of`].
pub(crate) fn direction_of(base_from_head: &Isometry3<f64>, state: &State) -> Expected<2> {
    let all = stereo_of(base_from_head, state);
    Expected {
        value: all.value.xy(),
        by_position: all.by_position.fixed_rows::<2>(0).into_owned(),
    }
}

/// The position itself.
pub(crate) fn position_of(state: &State) -> Expected<3> {
    Expected {
        value: Vector3::new(state[0], state[1], state[2]),
        by_position: Matrix3::identity(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn head() -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(0.1, -0.05, 0.02),
            UnitQuaternion::from_euler_angles(0.1, -0.3, 0.02),
        )
    }

    /// The analytic derivative of the measurement agrees with central differences, and `position` inverts it.
    #[test]
    fn derivative_and_inverse_agree_with_the_measurement() {
        let mut state = State::zeros();
        (state[0], state[1], state[2]) = (-0.4, 0.3, 3.0);
        let here = stereo_of(&head(), &state);
        for axis in 0..3 {
            let h = 1e-6;
            let (mut plus, mut minus) = (state, state);
            plus[axis] += h;
            minus[axis] -= h;
            let slope =
                (stereo_of(&head(), &plus).value - stereo_of(&head(), &minus).value) / (2.0 * h);
            assert!((slope - here.by_position.column(axis)).amax() < 1e-9);
        }
        let sight = Sight::Stereo {
            base_from_head: head(),
            value: here.value,
            covariance: Matrix3::identity() * 1e-6,
        };
        let (point, covariance) = sight.position(100.0).unwrap();
        assert!((point.coords - state.fixed_rows::<3>(0)).norm() < 1e-12);
        // H (J R J') H' is the measurement's covariance again.
        let back = here.by_position * covariance * here.by_position.transpose();
        assert!((back - Matrix3::identity() * 1e-6).amax() < 1e-15);
    }
}
