//! Differences of brightness, tone curve and colour between the eyes, over corresponding areas.
//!
//! All in the *coded* (gamma-encoded) values 0 to 255 of the pictures as given, right eye from left:
//! `R = gain * L + offset`, or with a different tone curve `R / 255 = gain * (L / 255)^gamma + offset / 255`.

/// Tone of the right eye's picture against the left's, in one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Factor on coded values, right over left; 1 = equal.
    pub gain: f64,
    /// Its standard deviation.
    pub gain_sigma: f64,
    /// What is added to coded values, levels of 0 to 255; 0 = equal.
    pub offset: f64,
    /// Its standard deviation, levels.
    pub offset_sigma: f64,
    /// Exponent on coded values; 1 = equal, > 1: the right eye's mid-tones are darker.
    pub gamma: f64,
    /// Its standard deviation.
    pub gamma_sigma: f64,
    /// Robust standard deviation of what remains, levels.
    pub residual: f64,
}

/// Photometric differences of a pair; right eye against left.
#[derive(Clone, Debug, PartialEq)]
pub struct Photometry {
    /// Luma (BT.601).
    pub luma: Tone,
    /// Red, green, blue.
    pub channels: [Tone; 3],
    /// Difference of the mean coded luma over corresponding areas, right minus left, percent of the left's.
    pub level_percent: f64,
    /// Its standard deviation.
    pub level_sigma_percent: f64,
    /// Difference of colour that is left when luma is equalised: (red over green, blue over green), right over left, as factors
    /// on coded values minus one, percent.
    pub white_balance_percent: [f64; 2],
    /// Their standard deviation, percent.
    pub white_balance_sigma_percent: f64,
    /// Colour matrix `R = M L` (coded values, offset removed) by robust least squares, rows red, green, blue; `None` where the
    /// pair has not enough colours to tell.
    pub matrix: Option<[[f64; 3]; 3]>,
    /// Corresponding areas that it was read from.
    pub areas: usize,
}
