//! The figures of a plan: the paper's Figures 3 and 4, vertical parallax, comfort against distance, the rig in plan.

mod comfort;
mod rig_plan;
mod surfaces;
mod vertical;

use std::path::{Path, PathBuf};

use vergence_geometry::ModeKind;
use vergence_geometry::planning::Setup;

use super::report::Question;
use crate::figure::Figure;
use crate::rig::refused;
use crate::settings::quantity::significant;

/// Draw all into a folder; gives the paths written.
pub(super) fn draw_all(question: &Question, dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let figures: [(&str, Figure); 5] = [
        ("figure3", surfaces::figure3(question)?),
        ("figure4", surfaces::figure4(question)?),
        ("vertical-parallax", vertical::draw(question)?),
        ("comfort", comfort::draw(question)?),
        ("rig", rig_plan::draw(question)?),
    ];
    let mut paths = Vec::new();
    for (name, figure) in &figures {
        paths.extend(figure.save(dir, name)?);
    }
    Ok(paths)
}

/// Four distances for panels: the paper's 1, 4, 7 and 10 m where they are asked for, else four even ones.
fn panel_distances(question: &Question) -> [f64; 4] {
    let step = (question.far_m - question.near_m) / 3.0;
    [0.0, 1.0, 2.0, 3.0].map(|i| question.near_m + i * step)
}

/// Screen parallax (p, q) in metres of a point in a mode with zero parallax at `distance_m`; NaN where it is undefined.
fn parallax(
    setup: &Setup,
    mode: ModeKind,
    distance_m: f64,
) -> anyhow::Result<impl Fn([f64; 3]) -> [f64; 2] + use<>> {
    let views = setup.views_at(mode, distance_m).map_err(refused)?;
    let m = setup.screen.magnification;
    Ok(move |point: [f64; 3]| {
        views
            .difference_m(0, point)
            .map_or([f64::NAN; 2], |[dx, dy]| [m * dx, m * dy])
    })
}

/// One line about the rig, for subtitles; numbers stay with their units.
fn rig_line(setup: &Setup) -> String {
    let mm = |v: f64| significant(v * 1e3, 4);
    format!(
        "Base *t*\u{a0}=\u{a0}{}\u{a0}mm, *f*\u{a0}=\u{a0}{}\u{a0}mm, sensor {}\u{a0}×\u{a0}{}\u{a0}mm with {}\u{a0}×\u{a0}{}\u{a0}px, screen magnification *M*\u{a0}=\u{a0}{}, eyes *e*\u{a0}=\u{a0}{}\u{a0}mm apart, *V*\u{a0}=\u{a0}{}\u{a0}m from the screen.",
        mm(setup.array.interaxial_m),
        mm(setup.array.focal_m),
        mm(setup.sensor.width_m),
        mm(setup.sensor.height_m),
        setup.sensor.width_px,
        setup.sensor.height_px,
        significant(setup.screen.magnification, 4),
        mm(setup.viewer.interocular_m),
        significant(setup.viewer.distance_m, 4)
    )
}

/// Metres for titles.
fn metres(z: f64) -> String {
    format!("{} m", significant(z, 3))
}
