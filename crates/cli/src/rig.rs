//! Flags that describe a rig, a screen and a viewer; shared by the commands that compute with them.

use vergence_geometry::planning::Setup;
use vergence_geometry::{Mode, Screen, Sensor, StereoArray, Viewer};

use crate::fault::{self, Fault};
use crate::settings::{Override, Settings};

/// Widths and heights of sensor types, metres as typed; the type's name is about 1.5 times the diagonal.
const SENSOR_TYPES: &[(&str, &str, &str)] = &[
    ("1/4", "3.6mm", "2.7mm"),
    ("1/3", "4.8mm", "3.6mm"),
    ("1/2", "6.4mm", "4.8mm"),
    ("2/3", "8.8mm", "6.6mm"),
    ("1", "12.8mm", "9.6mm"),
];

/// Flags for the rig, the screen and the viewer.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct RigFlags {
    /// Distance between the cameras, t [default: 70mm].
    #[arg(
        long,
        visible_alias = "interaxial",
        value_name = "LENGTH",
        help_heading = "Rig",
        allow_hyphen_values = true
    )]
    base: Option<String>,
    /// How far the lens centre lies in front of its pivot [default: 0mm].
    #[arg(
        long,
        value_name = "LENGTH",
        help_heading = "Rig",
        allow_hyphen_values = true
    )]
    pupil: Option<String>,
    /// Focal length f [default: 6.5mm].
    #[arg(
        long,
        value_name = "LENGTH",
        help_heading = "Rig",
        allow_hyphen_values = true
    )]
    focal_length: Option<String>,
    /// Sensor: WIDTHxHEIGHT (4.8mmx3.6mm) or a type: 1/4, 1/3, 1/2, 2/3, 1 [default: 1/3].
    #[arg(
        long,
        value_name = "SIZE",
        help_heading = "Rig",
        allow_hyphen_values = true
    )]
    sensor: Option<String>,
    /// Picture size in pixels [default: 1024x768].
    #[arg(
        long,
        value_name = "WxH",
        help_heading = "Rig",
        allow_hyphen_values = true
    )]
    resolution: Option<String>,
    /// Size on the screen over size on the sensor, M [default: 50].
    #[arg(
        long,
        value_name = "NUMBER",
        help_heading = "Screen and viewer",
        allow_hyphen_values = true,
        conflicts_with = "screen_width"
    )]
    magnification: Option<String>,
    /// Width of the picture on the screen, instead of --magnification.
    #[arg(
        long,
        value_name = "LENGTH",
        help_heading = "Screen and viewer",
        allow_hyphen_values = true
    )]
    screen_width: Option<String>,
    /// Distance of the viewer from the screen, V [default: 0.7m].
    #[arg(
        long,
        value_name = "LENGTH",
        help_heading = "Screen and viewer",
        allow_hyphen_values = true
    )]
    viewing_distance: Option<String>,
    /// Separation of the viewer's eyes, e [default: 65mm].
    #[arg(
        long,
        visible_alias = "interocular",
        value_name = "LENGTH",
        help_heading = "Screen and viewer",
        allow_hyphen_values = true
    )]
    eyes: Option<String>,
}

impl RigFlags {
    /// What was typed, as settings.
    pub(crate) fn overrides(&self) -> Result<Vec<Override>, Fault> {
        let mut out = Vec::new();
        for (path, flag, text) in [
            ("rig.interaxial", "--base", &self.base),
            ("rig.pupil", "--pupil", &self.pupil),
            ("camera.focal_length", "--focal-length", &self.focal_length),
            (
                "screen.magnification",
                "--magnification",
                &self.magnification,
            ),
            ("screen.width", "--screen-width", &self.screen_width),
            (
                "screen.viewing_distance",
                "--viewing-distance",
                &self.viewing_distance,
            ),
            ("screen.interocular", "--eyes", &self.eyes),
        ] {
            push(&mut out, path, flag, text.as_deref());
        }
        if let Some(text) = &self.sensor {
            let [width, height] = sensor_size(text)?;
            push(&mut out, "camera.sensor_width", "--sensor", Some(&width));
            push(&mut out, "camera.sensor_height", "--sensor", Some(&height));
        }
        if let Some(text) = &self.resolution {
            let (width, height) = text.split_once('x').ok_or_else(|| {
                fault::usage(format!("--resolution '{text}' is no size"))
                    .hint("write width x height in pixels, for example 1024x768")
            })?;
            push(&mut out, "camera.width", "--resolution", Some(width));
            push(&mut out, "camera.height", "--resolution", Some(height));
        }
        Ok(out)
    }
}

/// Add an override when something was typed.
pub(crate) fn push(out: &mut Vec<Override>, path: &str, flag: &str, text: Option<&str>) {
    if let Some(text) = text {
        out.push(Override {
            path: path.to_owned(),
            flag: flag.to_owned(),
            text: text.to_owned(),
        });
    }
}

/// Width and height of a sensor, each with its unit; one unit at the end (4.8x3.6mm) is that of both.
fn sensor_size(text: &str) -> Result<[String; 2], Fault> {
    if let Some((_, width, height)) = SENSOR_TYPES.iter().find(|(name, ..)| *name == text) {
        return Ok([*width, *height].map(str::to_owned));
    }
    let types: Vec<_> = SENSOR_TYPES.iter().map(|(name, ..)| *name).collect();
    let hint = format!("write 4.8mmx3.6mm or one of the types {}", types.join(", "));
    let Some((width, height)) = text.split_once('x') else {
        return Err(fault::usage(format!(
            "--sensor '{text}' is neither a size nor a known type"
        ))
        .hint(hint));
    };
    let [width, height] = [width.trim(), height.trim()];
    let unit = |s: &str| s[s.trim_end_matches(char::is_alphabetic).len()..].to_owned();
    match (unit(width), unit(height)) {
        (a, b) if a.is_empty() && b.is_empty() => {
            Err(fault::usage(format!("--sensor '{text}' has no unit")).hint(hint))
        }
        (a, b) if a.is_empty() => Ok([format!("{width}{b}"), height.to_owned()]),
        (a, b) if b.is_empty() => Ok([width.to_owned(), format!("{height}{a}")]),
        _ => Ok([width, height].map(str::to_owned)),
    }
}

/// The rig, screen and viewer of the settings; the mode is parallel until a question sets another.
pub(crate) fn setup(settings: &Settings) -> Setup {
    let sensor = Sensor {
        width_m: settings.number("camera.sensor_width"),
        height_m: settings.number("camera.sensor_height"),
        width_px: settings.count("camera.width"),
        height_px: settings.count("camera.height"),
    };
    let magnification = match settings.number_or_auto("screen.width") {
        Some(width) => width / sensor.width_m,
        None => settings.number("screen.magnification"),
    };
    Setup {
        array: StereoArray {
            interaxial_m: settings.number("rig.interaxial"),
            focal_m: settings.number("camera.focal_length"),
            pupil_m: settings.number("rig.pupil"),
            count: 2,
            mode: Mode::Parallel,
        },
        sensor,
        screen: Screen { magnification },
        viewer: Viewer {
            interocular_m: settings.number("screen.interocular"),
            distance_m: settings.number("screen.viewing_distance"),
        },
        far_m: settings
            .number_or_auto("plan.background")
            .unwrap_or(f64::INFINITY),
    }
}

/// A geometry error about numbers that a person gave.
#[expect(
    clippy::needless_pass_by_value,
    reason = "the shape that `map_err` takes"
)]
pub(crate) fn refused(error: vergence_geometry::GeometryError) -> anyhow::Error {
    fault::usage(error.to_string()).into()
}
