//! Numbers with units as people type them, and back.

use std::f64::consts::PI;

/// What a number measures; decides which units it may carry and which one a bare number has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dimension {
    /// Metres inside; bare: metres.
    Length,
    /// Radians inside; bare: degrees.
    Angle,
    /// Radians per second inside; bare: degrees per second.
    AngularVelocity,
    /// rad/s² inside; bare: deg/s².
    AngularAcceleration,
    /// rad/s³ inside; bare: deg/s³.
    AngularJerk,
    /// Seconds inside; bare: seconds.
    Time,
    /// Hertz inside; bare: hertz.
    Rate,
    /// A fraction of one; `%` is allowed.
    Fraction,
    /// A plain number.
    Number,
}

/// How a unit becomes the inner one. Division keeps "70 mm" the nearest number to 0.07, which a product would not.
#[derive(Clone, Copy)]
enum Scale {
    Times(f64),
    Over(f64),
}

impl Scale {
    fn inner(self, typed: f64) -> f64 {
        match self {
            Scale::Times(k) => typed * k,
            Scale::Over(k) => typed / k,
        }
    }

    fn typed(self, inner: f64) -> f64 {
        match self {
            Scale::Times(k) => inner / k,
            Scale::Over(k) => inner * k,
        }
    }
}

const DEGREE: Scale = Scale::Times(PI / 180.0);

/// The units of a dimension; the first one is that of a bare number.
fn units(dimension: Dimension) -> &'static [(&'static str, Scale)] {
    use Scale::{Over, Times};
    match dimension {
        Dimension::Length => &[
            ("m", Times(1.0)),
            ("mm", Over(1e3)),
            ("cm", Over(1e2)),
            ("um", Over(1e6)),
            ("µm", Over(1e6)),
            ("km", Times(1e3)),
            ("in", Times(0.0254)),
        ],
        Dimension::Angle => &[
            ("deg", DEGREE),
            ("°", DEGREE),
            ("rad", Times(1.0)),
            ("mrad", Over(1e3)),
            ("arcmin", Times(PI / 10_800.0)),
            ("arcsec", Times(PI / 648_000.0)),
        ],
        Dimension::AngularVelocity => &[
            ("deg/s", DEGREE),
            ("°/s", DEGREE),
            ("rad/s", Times(1.0)),
            ("rpm", Times(PI / 30.0)),
        ],
        Dimension::AngularAcceleration => &[
            ("deg/s2", DEGREE),
            ("deg/s^2", DEGREE),
            ("deg/s²", DEGREE),
            ("rad/s2", Times(1.0)),
            ("rad/s^2", Times(1.0)),
            ("rad/s²", Times(1.0)),
        ],
        Dimension::AngularJerk => &[
            ("deg/s3", DEGREE),
            ("deg/s^3", DEGREE),
            ("deg/s³", DEGREE),
            ("rad/s3", Times(1.0)),
            ("rad/s^3", Times(1.0)),
            ("rad/s³", Times(1.0)),
        ],
        Dimension::Time => &[
            ("s", Times(1.0)),
            ("ms", Over(1e3)),
            ("us", Over(1e6)),
            ("µs", Over(1e6)),
            ("min", Times(60.0)),
        ],
        Dimension::Rate => &[("Hz", Times(1.0)), ("fps", Times(1.0)), ("/s", Times(1.0))],
        Dimension::Fraction => &[("", Times(1.0)), ("%", Over(1e2))],
        Dimension::Number => &[("", Times(1.0))],
    }
}

impl Dimension {
    /// The name of what is measured, for messages.
    pub(crate) fn noun(self) -> &'static str {
        match self {
            Dimension::Length => "length",
            Dimension::Angle => "angle",
            Dimension::AngularVelocity => "angular velocity",
            Dimension::AngularAcceleration => "angular acceleration",
            Dimension::AngularJerk => "angular jerk",
            Dimension::Time => "time",
            Dimension::Rate => "rate",
            Dimension::Fraction => "fraction",
            Dimension::Number => "number",
        }
    }

    /// The unit of the inner number, empty for plain numbers.
    pub(crate) fn inner_unit(self) -> &'static str {
        match self {
            Dimension::Length => "m",
            Dimension::Angle => "rad",
            Dimension::AngularVelocity => "rad/s",
            Dimension::AngularAcceleration => "rad/s2",
            Dimension::AngularJerk => "rad/s3",
            Dimension::Time => "s",
            Dimension::Rate => "Hz",
            Dimension::Fraction | Dimension::Number => "",
        }
    }

    fn example(self) -> &'static str {
        match self {
            Dimension::Length => "70mm, 7cm or 0.07m",
            Dimension::Angle => "2deg, 0.1rad or 5arcmin",
            Dimension::AngularVelocity => "90deg/s or 1.5rad/s",
            Dimension::AngularAcceleration => "400deg/s2 or 7rad/s2",
            Dimension::AngularJerk => "9000deg/s3 or 150rad/s3",
            Dimension::Time => "8ms or 0.008s",
            Dimension::Rate => "30 or 30Hz",
            Dimension::Fraction => "0.02 or 2%",
            Dimension::Number => "1.5",
        }
    }

    /// The inner number (SI, radians) of what was typed: a number, perhaps a space, perhaps a unit.
    ///
    /// The error is the second half of a sentence that begins with the key and the text.
    pub(crate) fn parse(self, text: &str) -> Result<f64, String> {
        let text = text.trim().replace('\u{2212}', "-");
        let (number, unit) = split_number(&text).ok_or_else(|| {
            format!(
                "is no {}; write for example {}",
                self.noun(),
                self.example()
            )
        })?;
        if !number.is_finite() {
            return Err("is too large to be a number here".to_owned());
        }
        if unit.starts_with(',') {
            return Err("has a comma; write a decimal point".to_owned());
        }
        let scale = if unit.is_empty() {
            units(self)[0].1
        } else {
            units(self)
                .iter()
                .find(|(name, _)| *name == unit)
                .map(|(_, scale)| *scale)
                .ok_or_else(|| self.unknown_unit(unit))?
        };
        Ok(scale.inner(number))
    }

    fn unknown_unit(self, unit: &str) -> String {
        let names: Vec<_> = units(self)
            .iter()
            .map(|(name, _)| *name)
            .filter(|name| name.is_ascii() && !name.is_empty() && !name.contains('^'))
            .collect();
        if names.is_empty() {
            return format!("has a unit '{unit}', but takes a plain number");
        }
        format!(
            "has the unit '{unit}'; a {} is written in {}",
            self.noun(),
            names.join(", ")
        )
    }

    /// What a person would type for an inner number, in the unit that `like` carries ("70 mm"). Parsing it gives the number back.
    pub(crate) fn format(self, inner: f64, like: &str) -> String {
        let unit = split_number(like.trim()).map_or("", |(_, unit)| unit);
        let scale = units(self)
            .iter()
            .find(|(name, _)| *name == unit)
            .map_or(Scale::Times(1.0), |(_, scale)| *scale);
        let typed = scale.typed(inner);
        let number = (6..=17)
            .map(|digits| significant(typed, digits))
            .find(|text| text.parse().map(|back| scale.inner(back)) == Ok(inner));
        match number {
            Some(number) if unit.is_empty() || unit == "%" => format!("{number}{unit}"),
            Some(number) => format!("{number} {unit}"),
            // Some numbers have no text in that unit; the inner one is always exact.
            None => format!("{inner} {}", self.inner_unit())
                .trim_end()
                .to_owned(),
        }
    }
}

/// A number with at most `digits` significant digits, without trailing zeros.
pub(crate) fn significant(value: f64, digits: usize) -> String {
    let rounded: f64 = format!("{value:.*e}", digits.saturating_sub(1))
        .parse()
        .unwrap_or(value);
    // Rust prints the shortest decimal text that gives the number back.
    if rounded != 0.0 && !(1e-6..1e15).contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        format!("{rounded}")
    }
}

/// The number at the front of a text and the trimmed rest.
fn split_number(text: &str) -> Option<(f64, &str)> {
    if !text.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+')) {
        return None;
    }
    let longest = text
        .char_indices()
        .map(|(i, c)| i + c.len_utf8())
        .take(40)
        .filter(|&end| {
            let head = &text[..end];
            // "-inf" begins like a number but is none.
            !head.contains(['n', 'N', 'i', 'I']) && head.parse::<f64>().is_ok()
        })
        .last()?;
    Some((text[..longest].parse().ok()?, text[longest..].trim()))
}

#[cfg(test)]
mod tests {
    //! What people type becomes the nearest number in SI; what is no number is refused; printing and parsing are inverse.
    use super::*;

    /// Units scale exactly: "70 mm" is the literal 0.07 and not its neighbour.
    #[test]
    fn lengths_and_angles_take_units() {
        for (text, metres) in [
            ("70mm", 0.07),
            ("7cm", 0.07),
            ("0.07m", 0.07),
            ("0.07", 0.07),
            (" 6.5 mm ", 0.0065),
            ("65e-3", 0.065),
            ("1e3 mm", 1.0),
            ("-5mm", -0.005),
        ] {
            assert_eq!(Dimension::Length.parse(text), Ok(metres), "{text}");
        }
        for (text, radians) in [
            ("180deg", PI),
            ("180", PI),
            ("2rad", 2.0),
            ("60arcmin", PI / 180.0),
            ("90°", PI / 2.0),
        ] {
            let got = Dimension::Angle.parse(text).unwrap();
            assert!((got - radians).abs() < 1e-15, "{text} {got}");
        }
        assert_eq!(Dimension::Fraction.parse("2%"), Ok(0.02));
    }

    /// No text that is not a finite number with a known unit gets through.
    #[test]
    fn what_is_no_quantity_is_refused() {
        for text in [
            "nan",
            "NaN",
            "inf",
            "-inf",
            "",
            "mm",
            "seven",
            "1e999",
            "--3",
            "0,07m",
            "70 parsec",
            "7 c m",
        ] {
            assert!(Dimension::Length.parse(text).is_err(), "{text}");
        }
        assert!(
            Dimension::Length
                .parse("70 parsec")
                .unwrap_err()
                .contains("mm")
        );
        assert!(
            Dimension::Length
                .parse("0,07m")
                .unwrap_err()
                .contains("point")
        );
    }

    /// Printed values parse to the same bits.
    #[test]
    fn printing_is_the_inverse_of_parsing() {
        for (dimension, like) in [
            (Dimension::Length, "70 mm"),
            (Dimension::Length, "1 m"),
            (Dimension::Angle, "2 deg"),
            (Dimension::Angle, "1 rad"),
            (Dimension::Fraction, "1%"),
        ] {
            for value in [0.07, 0.1 + 0.2, 1.0 / 3.0, 1e-7, 12345.678, 0.0, -0.5] {
                let text = dimension.format(value, like);
                assert_eq!(dimension.parse(&text), Ok(value), "{text}");
            }
        }
        assert_eq!(Dimension::Length.format(0.07, "70 mm"), "70 mm");
    }
}
