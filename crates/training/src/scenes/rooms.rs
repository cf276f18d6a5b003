//! The twin's rooms, as a camera without noise sees them from somewhere in the room.

use std::sync::Arc;

use anyhow::{Context as _, Result};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use vergence_geometry::Eye;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::{Gray, Rgb};
use vergence_scene::{PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

use crate::field::{blurred, deviation, field_from_gray, gray_from_field, mean, shrunk};
use crate::random::Random;

/// Tries to find a view with something in it.
const TRIES: usize = 8;
/// A view with less spread of grey levels shows a bare wall.
const LEAST_SPREAD: f64 = 18.0;
const PATHS: [&str; 3] = ["walk", "two", "occlude"];

/// One picture.
pub(super) fn picture(random: &mut Random) -> Result<Gray> {
    let mut best: Option<(f64, Gray)> = None;
    for _ in 0..TRIES {
        let view = view(random)?;
        let spread = deviation(&field_from_gray(&view));
        if best.as_ref().is_none_or(|(most, _)| spread > *most) {
            best = Some((spread, view));
        }
        if spread > LEAST_SPREAD {
            break;
        }
    }
    let (_, picture) = best.context("no view was rendered")?;
    Ok(picture)
}

fn view(random: &mut Random) -> Result<Gray> {
    let world = Arc::new(World::new(&WorldConfig {
        path: PATHS[random.below(PATHS.len())].parse::<PathSpec>()?,
        seed: random.bits() >> 32,
        ..WorldConfig::default()
    })?);
    let default = TwinCamera::default();
    let pixels = [1.0, 1.1, 1.25][random.below(3)];
    let camera = TwinCamera {
        gamma: default.gamma,
        vignetting: random.unit(),
        response_e_s: default.response_e_s * random.between(0.6, 1.1),
        ..TwinCamera::ideal(default.scaled(pixels).camera)
    };
    let time = random.unit() * world.duration_s();
    let place = Translation3::new(
        random.between(-1.2, 1.2),
        random.between(-0.4, 0.3),
        random.between(-0.2, 3.0),
    );
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.5 * random.normal())
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.15 * random.normal())
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.05 * random.normal());
    let cam_from_base = (place * turn).inverse();
    let poses = move |_: Eye, _: f64| -> Isometry3<f64> { cam_from_base };
    let mut renderer = Renderer::new(world, [camera; 2], 1)?;
    let shot = Shot {
        index: 0,
        mid_exposure_s: [time; 2],
        cam_from_base: &poses,
    };
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    let [left, right] = &mut pair;
    renderer.render_pair(&shot, [left, right]);
    Ok(finished(&luma_from_rgb(&pair[0]), random))
}

/// Half as large, so that nothing is jagged; exposed for contrast; through a lens that is not ideal, onto a sensor with the
/// grain of a good one.
fn finished(picture: &Gray, random: &mut Random) -> Gray {
    let field = shrunk(
        &blurred(&field_from_gray(picture), random.between(0.2, 0.9)),
        2,
    );
    let (middle, spread) = (mean(&field) as f32, deviation(&field).max(1.0));
    let gain = (random.between(25.0, 60.0) / spread).clamp(1.0, 2.5) as f32;
    let level = random.between(90.0, 150.0) as f32;
    let grain = random.between(0.0, 1.5);
    let mut out = field.map(|v| level + gain * (v - middle));
    for v in out.samples_mut() {
        *v += (grain * random.normal()) as f32;
    }
    gray_from_field(&out)
}
