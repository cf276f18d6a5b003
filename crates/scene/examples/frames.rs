//! Writes pairs of the twin's pictures as PNG: `frames OUT_DIR [PATH] [SEED] [LIGHT] [FROM_S TO_S FPS]`.
//!
//! The head looks at the target and converges on it perfectly (no motors). Beside the pictures stands `truth.csv`:
//! one row per pair with the target's reference point (base frame, m), its pixels, the angles of the head and the
//! visible fraction of the target.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::{Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

const RIG: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let word =
        |i: usize, default: &str| words.get(i).cloned().unwrap_or_else(|| default.to_owned());
    let out = PathBuf::from(word(0, "frames"));
    std::fs::create_dir_all(&out)?;
    let light: Light = word(3, "day").parse()?;
    let world = Arc::new(World::new(&WorldConfig {
        path: word(1, "walk").parse::<PathSpec>()?,
        light,
        seed: word(2, "1").parse()?,
        marks: Vec::new(),
    })?);
    let from_s: f64 = word(4, "0").parse()?;
    let to_s: f64 = word(5, &world.duration_s().to_string()).parse()?;
    let fps: f64 = word(6, "1").parse()?;
    let mut renderer = Renderer::new(world.clone(), [TwinCamera::for_light(light); 2], 1)?;
    let angles = |t: f64| -> HeadAngles {
        let target = world
            .target_reference_in_base(t)
            .unwrap_or_else(|| Point3::new(0.0, 0.0, 8.0));
        RIG.angles_converged_on(&target).unwrap_or_default()
    };
    let cam_from_base = |eye: Eye, t: f64| -> Isometry3<f64> { RIG.cam_from_base(eye, &angles(t)) };
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    let mut rows =
        "index,time_s,x_m,y_m,z_m,left_u,left_v,right_u,right_v,pan,tilt,left,right,visible\n"
            .to_owned();
    let count = ((to_s - from_s) * fps).floor() as u64 + 1;
    for index in 0..count {
        let t = from_s + index as f64 / fps;
        let shot = Shot {
            index,
            mid_exposure_s: [t; 2],
            cam_from_base: &cam_from_base,
        };
        let [left, right] = &mut pair;
        renderer.render_pair(&shot, [left, right]);
        for (eye, picture) in ["left", "right"].iter().zip(&pair) {
            vergence_imaging::files::write_rgb(
                &out.join(format!("{eye}_{index:04}.png")),
                picture,
            )?;
        }
        let target = world
            .target_reference_in_base(t)
            .unwrap_or_else(Point3::origin);
        let px = Eye::BOTH.map(|e| {
            let camera = &renderer.cameras()[e as usize].camera;
            camera
                .project(&(cam_from_base(e, t) * target))
                .map_or([f64::NAN; 2], |p| [p.x, p.y])
        });
        let a = angles(t).to_array();
        write!(rows, "{index},{t},{},{},{}", target.x, target.y, target.z)?;
        for v in px.into_iter().flatten().chain(a) {
            write!(rows, ",{v:.6}")?;
        }
        writeln!(rows, ",{:.3}", world.target_visible_fraction(t))?;
    }
    std::fs::write(out.join("truth.csv"), rows)?;
    Ok(())
}
