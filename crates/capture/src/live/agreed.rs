//! What two live cameras agreed on before their first picture, for whoever looks at them (`vergence doctor`).

use super::LiveSource;

/// How one camera sends its pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraMode {
    /// A format of V4L2 (`YUYV`, `MJPG`) or a codec (`H.264`, `JPEG`); `None` where another program decodes the pictures.
    pub format: Option<&'static str>,
    /// Width and height of this eye's pictures, pixels.
    pub size: (usize, usize),
    /// The nominal rate, pictures a second; `None` where none is told.
    pub fps: Option<f64>,
}

/// A control that was set on both cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LockedControl {
    /// What it is, as in "white balance".
    pub name: &'static str,
    /// In the driver's units.
    pub value: i64,
}

/// What the two cameras agreed on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Agreement {
    /// How each sends, left and right.
    pub modes: [CameraMode; 2],
    /// Controls that have one value on both, the switches of automatics among them; none for streams.
    pub controls: Vec<LockedControl>,
    /// Sentences about controls that could not be given one value: there the two pictures may differ.
    pub unset: Vec<String>,
}

impl LiveSource {
    /// What the cameras agreed on when they were opened.
    pub fn agreement(&self) -> &Agreement {
        &self.agreement
    }

    /// Largest time between two frames that may be a pair, the steady offset taken out, s: a fifth of the present period, or less where less was asked for.
    pub fn pairing_limit_s(&self) -> f64 {
        self.limits().max_apart_s
    }
}
