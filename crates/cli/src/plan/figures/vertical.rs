//! Vertical parallax of toe-in over the picture.

use vergence_geometry::ModeKind;

use super::super::report::Question;
use super::{metres, panel_distances, parallax, rig_line};
use crate::figure::Figure;
use crate::figure::axis::Axis;
use crate::figure::map::{Atlas, Map};
use crate::rig::refused;

/// Values that get a contour line, pixels, both signs; the first get their label first.
const LEVELS: [f64; 7] = [20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2];

/// Vertical parallax in pixels at a column and row.
type Parallax = Box<dyn Fn(f64, f64) -> f64>;

/// Maps of q over the picture for walls at the convergence distance.
pub(super) fn draw(question: &Question) -> anyhow::Result<Figure> {
    let setup = question.setup;
    let sensor = setup.sensor;
    let focal = setup.array.focal_m;
    let (w, h) = (sensor.width_px as f64, sensor.height_px as f64);
    let to_px = 1.0 / (setup.screen.magnification * sensor.pitch_y_m());
    let mut functions: Vec<(String, Parallax)> = Vec::new();
    let mut extreme: f64 = 0.0;
    for l in panel_distances(question) {
        let views = setup.views_at(ModeKind::Converged, l).map_err(refused)?;
        let p = parallax(&setup, ModeKind::Converged, l)?;
        let q_px = move |u: f64, v: f64| {
            let x = (u - (w - 1.0) / 2.0) * sensor.pitch_m() / focal;
            let y = ((h - 1.0) / 2.0 - v) * sensor.pitch_y_m() / focal;
            p(setup.point_in_picture(&views, [x, y], l))[1] * to_px
        };
        let corner = q_px(-0.5, -0.5).abs();
        extreme = extreme.max(corner);
        let title = format!("*L* = {}: up to {corner:.1} px in the corners", metres(l));
        functions.push((title, Box::new(q_px)));
    }
    let contours = std::iter::once(0.0)
        .chain(LEVELS.iter().flat_map(|l| [*l, -l]))
        .filter(|l| l.abs() < extreme)
        .collect();
    let atlas = Atlas {
        title: "Vertical parallax of converged cameras over the picture".to_owned(),
        subtitle: format!(
            "Vertical parallax *q* (right minus left picture, + up) of a flat wall at the convergence distance *L*, in pixels of the picture; columns and rows are those \
             of a camera half way between the two. \
             Good up to 1 px, limit 2 px (design values). Parallel and shifted cameras have none. {}",
            rig_line(&setup)
        ),
        x: Axis::linear("column *u* of the middle / px", -0.5, w - 0.5),
        y: Axis::linear("row *v* / px", -0.5, h - 0.5),
        y_down: true,
        value: Axis::linear("*q* / px", -extreme, extreme),
        contours,
        maps: functions
            .iter()
            .map(|(title, value)| Map {
                title: title.clone(),
                value: value.as_ref(),
            })
            .collect(),
        columns: 2,
    };
    Ok(atlas.draw())
}
