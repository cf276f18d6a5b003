//! What can be wrong with an input, and the checks that find it.

/// Errors of this crate: each names what failed, its value and unit, and what would be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GeometryError {
    /// A number that no rig, screen or viewer can have.
    #[error("{name} is {value} {unit}, it must be {expected}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// What was given.
        value: f64,
        /// Its unit; empty for pure numbers.
        unit: &'static str,
        /// What would be right.
        expected: String,
    },
    /// A count out of range.
    #[error("{name} is {value}, it must be {expected}")]
    Count {
        /// Name of the count.
        name: &'static str,
        /// What was given.
        value: usize,
        /// What would be right.
        expected: &'static str,
    },
    /// A field that this camera mode needs.
    #[error("mode {mode} needs the field {field:?}")]
    MissingField {
        /// The mode.
        mode: &'static str,
        /// Name of the field.
        field: &'static str,
    },
    /// Slices that should have one length.
    #[error("{name} holds {found} values, it must hold {expected}, as many as x")]
    Length {
        /// Name of the slice.
        name: &'static str,
        /// Its length.
        found: usize,
        /// The length of `x`.
        expected: usize,
    },
    /// A rule that does not judge horizontal parallax where one is needed.
    #[error(
        "rule {rule:?} does not judge horizontal parallax, choose one that does, such as \"seen-depth\""
    )]
    NotOverParallax {
        /// Its id.
        rule: &'static str,
    },
    /// A bracket without a change of sign.
    #[error(
        "no root of {what} between {low} and {high}: the values there are {at_low} and {at_high}, \
         they must differ in sign"
    )]
    NoRoot {
        /// The function.
        what: &'static str,
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
        /// Value at the lower end.
        at_low: f64,
        /// Value at the upper end.
        at_high: f64,
    },
    /// A root search that used up its steps.
    #[error("the search for a root of {what} did not settle in {steps} steps")]
    NotSettled {
        /// The function.
        what: &'static str,
        /// Steps used.
        steps: usize,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, GeometryError>;

/// Positive lengths and ratios outside this range belong to no rig, and would overflow when squared twice.
const SMALLEST: f64 = 1e-12;
const LARGEST: f64 = 1e12;

pub(crate) fn fault(
    name: &'static str,
    value: f64,
    unit: &'static str,
    expected: impl Into<String>,
) -> GeometryError {
    GeometryError::Parameter {
        name,
        value,
        unit,
        expected: expected.into(),
    }
}

/// Finite and greater than zero (and within 1e-12 to 1e12).
pub(crate) fn positive(name: &'static str, value: f64, unit: &'static str) -> Result<f64> {
    if !(value.is_finite() && value > 0.0) {
        return Err(fault(name, value, unit, "finite and greater than 0"));
    }
    if !(SMALLEST..=LARGEST).contains(&value) {
        return Err(fault(name, value, unit, "between 1e-12 and 1e12"));
    }
    Ok(value)
}

/// Finite and not negative (and at most 1e12).
pub(crate) fn not_negative(name: &'static str, value: f64, unit: &'static str) -> Result<f64> {
    if !(value.is_finite() && (0.0..=LARGEST).contains(&value)) {
        return Err(fault(
            name,
            value,
            unit,
            "finite, 0 or greater, at most 1e12",
        ));
    }
    Ok(value)
}

/// Finite (and at most 1e12 in magnitude).
pub(crate) fn finite(name: &'static str, value: f64, unit: &'static str) -> Result<f64> {
    if !(value.is_finite() && value.abs() <= LARGEST) {
        return Err(fault(
            name,
            value,
            unit,
            "finite, at most 1e12 in magnitude",
        ));
    }
    Ok(value)
}

/// A distance that may be infinite: greater than zero, never NaN.
pub(crate) fn positive_or_infinite(
    name: &'static str,
    value: f64,
    unit: &'static str,
) -> Result<f64> {
    if value == f64::INFINITY {
        Ok(value)
    } else {
        positive(name, value, unit)
    }
}

/// Strictly between zero and one.
pub(crate) fn fraction(name: &'static str, value: f64) -> Result<f64> {
    if value > 0.0 && value < 1.0 {
        Ok(value)
    } else {
        Err(fault(name, value, "(fraction)", "between 0 and 1"))
    }
}
