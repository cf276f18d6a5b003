//! The simulated rig that the settings describe.

use vergence_capture::{Knock, TwinConfig};
use vergence_control::{AxisConfig, AxisLimits, AxisName, HeadConfig};
use vergence_geometry::{BrownConrady, Camera, Distortion, HeadGeometry, Intrinsics};
use vergence_scene::{Light, PathSpec, TwinCamera, read_waypoints};

use crate::fault;
use crate::settings::Settings;

/// Everything about the twin, checked.
pub(crate) fn config(settings: &Settings) -> anyhow::Result<TwinConfig> {
    let light = match settings.word("run.light") {
        "dim" => Light::Dim,
        _ => Light::Day,
    };
    let head = head(settings)?;
    let config = TwinConfig {
        path: path(settings.word("run.path"))?,
        light,
        seed: settings.number("run.seed") as u64,
        fps: settings.number("camera.fps"),
        seconds: settings.number_or_auto("run.seconds"),
        cameras: cameras(settings, light)?,
        eye_offset_s: [0.0, settings.number("camera.time_offset")],
        latency_s: settings.number("camera.latency"),
        latency_jitter_s: settings.number("camera.latency_jitter"),
        drop_probability: settings.number("camera.drop_probability"),
        geometry: HeadGeometry {
            interaxial_m: settings.number("rig.interaxial"),
            pupil_m: settings.number("rig.pupil"),
        },
        head,
        knock: Knock {
            time_s: settings.number("run.knock.time"),
            pitch_rad: settings.number("run.knock.pitch"),
            yaw_rad: settings.number("run.knock.yaw"),
            roll_rad: settings.number("run.knock.roll"),
        },
    };
    Ok(config)
}

/// A path by its name, or the waypoints of a file.
fn path(word: &str) -> anyhow::Result<PathSpec> {
    match word.parse::<PathSpec>() {
        Ok(path) => Ok(path),
        Err(_) if std::path::Path::new(word).is_file() => {
            let points = read_waypoints(word.as_ref()).map_err(|e| fault::usage(e.to_string()))?;
            Ok(PathSpec::Waypoints(points))
        }
        Err(error) => Err(fault::usage(format!("run.path = '{word}': {error}"))
            .hint("a path is one of the names or a file of waypoints that exists")
            .into()),
    }
}

/// Left and right camera.
fn cameras(settings: &Settings, light: Light) -> anyhow::Result<[TwinCamera; 2]> {
    let n = |key: &str| settings.number(&format!("camera.{key}"));
    let size = (
        settings.count("camera.width"),
        settings.count("camera.height"),
    );
    let usual = TwinCamera::for_light(light);
    let left = TwinCamera {
        camera: Camera {
            intrinsics: Intrinsics {
                fy: n("focal_length") / (n("sensor_height") / size.1 as f64),
                ..Intrinsics::from_sensor(n("focal_length"), n("sensor_width"), size.0, size.1)
            },
            distortion: Distortion::from(BrownConrady {
                k1: n("k1"),
                k2: n("k2"),
                p1: n("p1"),
                p2: n("p2"),
                k3: n("k3"),
                k4: n("k4"),
                k5: n("k5"),
                k6: n("k6"),
            }),
        },
        exposure_s: settings
            .number_or_auto("camera.exposure")
            .unwrap_or(usual.exposure_s),
        motion_blur: settings.switch("camera.motion_blur"),
        response_e_s: n("response"),
        full_well_e: n("full_well"),
        gain: settings.number_or_auto("camera.gain").unwrap_or(usual.gain),
        read_noise_e: n("read_noise"),
        shot_noise: settings.switch("camera.shot_noise"),
        gamma: n("gamma"),
        vignetting: n("vignetting"),
    };
    let right = TwinCamera {
        gain: left.gain * (1.0 + n("gain_difference")),
        ..left
    };
    for camera in [left, right] {
        camera.check().map_err(|e| fault::usage(e.to_string()))?;
    }
    Ok([left, right])
}

/// The four axes. Vergence is set once for both cameras, + towards the other one, which for the right camera is left.
fn head(settings: &Settings) -> anyhow::Result<HeadConfig> {
    let vergence = axis(settings, "vergence", "left");
    let limits = vergence.limits;
    let head = HeadConfig {
        pan: axis(settings, "pan", "pan"),
        tilt: axis(settings, "tilt", "tilt"),
        left: vergence,
        right: AxisConfig {
            home_offset_rad: settings.number("motors.home.right"),
            limits: AxisLimits {
                position_min_rad: -limits.position_max_rad,
                position_max_rad: -limits.position_min_rad,
                ..limits
            },
            ..vergence
        },
    };
    for (axis, name) in head.axes().into_iter().zip(AxisName::ALL) {
        axis.check(name).map_err(|e| fault::usage(e.to_string()))?;
    }
    Ok(head)
}

fn axis(settings: &Settings, section: &str, home: &str) -> AxisConfig {
    let n = |key: &str| settings.number(&format!("motors.{section}.{key}"));
    AxisConfig {
        full_step_rad: n("step"),
        microsteps: n("microsteps") as u32,
        gear_ratio: n("gear"),
        backlash_rad: n("backlash"),
        home_offset_rad: settings.number(&format!("motors.home.{home}")),
        command_delay_s: n("command_delay"),
        timeout_s: n("timeout"),
        limits: AxisLimits {
            position_min_rad: n("min"),
            position_max_rad: n("max"),
            velocity_max_rad_s: n("velocity"),
            acceleration_max_rad_s2: n("acceleration"),
            jerk_max_rad_s3: n("jerk"),
        },
    }
}

#[cfg(test)]
mod tests {
    //! The defaults of the settings are the defaults of the crates that they go to, to the last bit.
    use super::*;

    #[test]
    fn default_settings_give_the_default_twin() {
        let settings = Settings::load(None, [], &[]).unwrap();
        assert_eq!(config(&settings).unwrap(), TwinConfig::default());
    }
}
