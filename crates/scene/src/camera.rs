//! A simulated camera: lens, exposure, sensor.

use serde::{Deserialize, Serialize};
use vergence_geometry::{BrownConrady, Camera, Distortion, Intrinsics};

use crate::error::SceneError;
use crate::world::Light;

/// Everything that makes one camera's picture out of light. Each effect has a value that switches it off.
///
/// Defaults: 1024 x 768 on a 1/3-inch sensor (4.8 mm x 3.6 mm, pixels of 4.69 um) behind a lens of 6.5 mm, mild
/// barrel distortion, 4 ms at full daylight. They stand for a camera of the class of Sony's ICX204; full well, read noise and
/// response are round figures typical of such sensors. `docs/parts.md` says for each figure where it comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TwinCamera {
    /// Pinhole and Brown–Conrady distortion. Off: `Distortion::NONE`.
    pub camera: Camera,
    /// Time for which the shutter is open, s; >= 0. It also scales the signal.
    pub exposure_s: f64,
    /// Whether things that move during the exposure are blurred.
    pub motion_blur: bool,
    /// Electrons per second of a pixel that looks at a white surface (reflectance 1) in full daylight; > 0.
    pub response_e_s: f64,
    /// Electrons that fill a pixel at `gain` 1: the picture's white; > 0.
    pub full_well_e: f64,
    /// Amplification before digitising; > 0. With gain g, white is reached at `full_well_e / g`.
    pub gain: f64,
    /// Standard deviation of read noise, electrons; >= 0. Off: 0.
    pub read_noise_e: f64,
    /// Whether the light's own (Poisson) noise is added; it is approximated by a normal law of the same variance.
    pub shot_noise: bool,
    /// Exponent of the encoding, `code = 255 signal^(1/gamma)`; in [1, 4]. Off: 1.
    pub gamma: f64,
    /// Strength of the fall of light off the axis: 1 is the natural cos^4, 0 is off; in [0, 1].
    pub vignetting: f64,
}

impl Default for TwinCamera {
    fn default() -> Self {
        Self {
            camera: Camera {
                intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
                distortion: Distortion::from(BrownConrady {
                    k1: -0.08,
                    k2: 0.02,
                    p1: 3e-4,
                    p2: -2e-4,
                    ..BrownConrady::NONE
                }),
            },
            exposure_s: 0.004,
            motion_blur: true,
            response_e_s: 3.75e6,
            full_well_e: 15_000.0,
            gain: 1.0,
            read_noise_e: 12.0,
            shot_noise: true,
            gamma: 2.2,
            vignetting: 1.0,
        }
    }
}

impl TwinCamera {
    /// The default camera with the exposure and gain that somebody would set for a light: 4 ms and 1 by day, 12 ms
    /// and 4 in dim light.
    pub fn for_light(light: Light) -> Self {
        match light {
            Light::Day => Self::default(),
            Light::Dim => Self {
                exposure_s: 0.012,
                gain: 4.0,
                ..Self::default()
            },
        }
    }

    /// The same lens and sensor size with another number of pixels: `scale` times as many along either side. The
    /// response per pixel stays.
    pub fn scaled(&self, scale: f64) -> Self {
        Self {
            camera: self.camera.scaled(scale),
            ..*self
        }
    }

    /// Without noise, vignetting, gamma and motion blur: geometry alone.
    pub fn ideal(camera: Camera) -> Self {
        Self {
            camera,
            motion_blur: false,
            read_noise_e: 0.0,
            shot_noise: false,
            gamma: 1.0,
            vignetting: 0.0,
            ..Self::default()
        }
    }

    /// Checks every setting against its range.
    pub fn check(&self) -> Result<(), SceneError> {
        let k = &self.camera.intrinsics;
        let refuse = |setting, value, expected| {
            Err(SceneError::Camera {
                setting,
                value,
                expected,
            })
        };
        for (setting, n) in [("width", k.width), ("height", k.height)] {
            if !(16..=MAX_SIDE).contains(&n) {
                return refuse(setting, n as f64, "16 to 8192 pixels");
            }
        }
        for (setting, v) in [("fx", k.fx), ("fy", k.fy)] {
            if !(v > 0.0 && v.is_finite()) {
                return refuse(setting, v, "a positive number of pixels");
            }
        }
        for (setting, v) in [("cx", k.cx), ("cy", k.cy)] {
            if !v.is_finite() {
                return refuse(setting, v, "a finite number of pixels");
            }
        }
        if !(0.0..=1.0).contains(&self.exposure_s) {
            return refuse("exposure_s", self.exposure_s, "0 to 1 s");
        }
        for (setting, v) in [
            ("response_e_s", self.response_e_s),
            ("full_well_e", self.full_well_e),
            ("gain", self.gain),
        ] {
            if !(v > 0.0 && v.is_finite()) {
                return refuse(setting, v, "a positive number");
            }
        }
        if !(self.read_noise_e >= 0.0 && self.read_noise_e.is_finite()) {
            return refuse("read_noise_e", self.read_noise_e, "0 electrons or more");
        }
        if !(1.0..=4.0).contains(&self.gamma) {
            return refuse("gamma", self.gamma, "1 to 4");
        }
        if !(0.0..=1.0).contains(&self.vignetting) {
            return refuse("vignetting", self.vignetting, "0 to 1");
        }
        Ok(())
    }

    /// Picture value (1 is white) of reflectance 1 in a light of level 1.
    pub(crate) fn exposure_scale(&self) -> f64 {
        self.response_e_s * self.exposure_s * self.gain / self.full_well_e
    }
}

/// Largest side of a rendered picture, pixels.
pub const MAX_SIDE: usize = 8192;
