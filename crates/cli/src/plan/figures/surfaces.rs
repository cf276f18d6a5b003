//! Figures 3 and 4 of the paper: horizontal parallax h over the scene, converged above parallel.

use vergence_geometry::ModeKind;

use super::super::report::Question;
use super::{metres, panel_distances, parallax, rig_line};
use crate::figure::Figure;
use crate::figure::axis::Axis;
use crate::figure::surface::{Sheet, Surface};

/// Half the range of x0 over the nearest distance: the reference tables reach 0.8 m at 1 m.
const REACH: f64 = 0.8;
const CELLS: usize = 28;

/// The value over the two axes of a box, and half the width of the picture there.
struct Shape {
    title: String,
    value: Box<dyn Fn(f64, f64) -> f64>,
    half_width: Box<dyn Fn(f64) -> f64>,
}

/// Figure 3: h over x0 and z0 at four convergence distances.
pub(super) fn figure3(question: &Question) -> anyhow::Result<Figure> {
    let distances = panel_distances(question);
    let [half_x, _] = question
        .setup
        .sensor
        .half_field(question.setup.array.focal_m);
    let pupil = question.setup.array.pupil_m;
    let shape = |title: String, mode, l| -> anyhow::Result<Shape> {
        let p = parallax(&question.setup, mode, l)?;
        Ok(Shape {
            title,
            value: Box::new(move |x, z| -1e3 * p([x, 0.0, z])[0]),
            half_width: Box::new(move |z| half_x * (z - pupil)),
        })
    };
    let converged = distances
        .iter()
        .map(|l| {
            let title = format!("converged at *L* = {}", metres(*l));
            shape(title, ModeKind::Converged, *l)
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    // Parallel cameras know no L: one box for all.
    let parallel = shape(
        "parallel, any *L*".to_owned(),
        ModeKind::Parallel,
        question.near_m,
    )?;
    let mut first = converged;
    let mut second = first.split_off(3);
    second.push(parallel);
    let rows = [("", first), ("", second)];
    sheet(
        question,
        &rows,
        "*z*_{0} / m",
        "Horizontal parallax over the scene (Figure 3 of Yang et al. 2016)",
        "Parallax *h* of a point (*x*_{0}, 0, *z*_{0}) for cameras converged at *L* and for parallel cameras, which do not depend on *L*. \
         Paper's sign: *h* > 0 is seen in front of the screen. Net without colour: outside the picture.",
    )
}

/// Figure 4: h over x0 and L at four distances of the point.
pub(super) fn figure4(question: &Question) -> anyhow::Result<Figure> {
    let distances = panel_distances(question);
    let [half_x, _] = question
        .setup
        .sensor
        .half_field(question.setup.array.focal_m);
    let pupil = question.setup.array.pupil_m;
    let modes = [
        ("Converged", ModeKind::Converged),
        ("Parallel", ModeKind::Parallel),
    ];
    let rows = modes.map(|(name, mode)| {
        let shape = |z: f64| {
            let setup = question.setup;
            // A faulty distance cannot come up between near and far, both of which were checked; NaN leaves a hole.
            Shape {
                title: format!("*z*_{{0}} = {}", metres(z)),
                value: Box::new(move |x, l| {
                    parallax(&setup, mode, l).map_or(f64::NAN, |p| -1e3 * p([x, 0.0, z])[0])
                }),
                half_width: Box::new(move |_| half_x * (z - pupil)),
            }
        };
        (name, distances.map(shape).into())
    });
    sheet(
        question,
        &rows,
        "*L* / m",
        "Horizontal parallax over the convergence distance (Figure 4 of Yang et al. 2016)",
        "Parallax *h* of a point (*x*_{0}, 0, *z*_{0}) for cameras converged at *L* and for parallel cameras, which do not depend on *L*. \
         Paper's sign: *h* > 0 is seen in front of the screen. Net without colour: outside the picture.",
    )
}

fn sheet(
    question: &Question,
    rows: &[(&str, Vec<Shape>); 2],
    y_label: &str,
    title: &str,
    subtitle: &str,
) -> anyhow::Result<Figure> {
    let reach = REACH * question.near_m;
    let x = Axis::linear("*x*_{0} / m", -reach, reach);
    let y = Axis::linear(y_label, question.near_m, question.far_m);
    let extreme = rows
        .iter()
        .flat_map(|row| &row.1)
        .flat_map(|f| samples(&x, &y).map(move |(a, b)| (f.value)(a, b).abs()))
        .filter(|v| v.is_finite())
        .fold(0.0, f64::max);
    // A little air above and below; the colours are symmetric about 0.
    let z = Axis::linear("*h* / mm", -1.05 * extreme, 1.05 * extreme);
    let sheet = Sheet {
        title: title.to_owned(),
        subtitle: format!("{subtitle} {}", rig_line(&question.setup)),
        x,
        y,
        z,
        rows: rows
            .iter()
            .map(|(name, shapes)| {
                let surfaces = shapes
                    .iter()
                    .map(|shape| Surface {
                        title: shape.title.clone(),
                        value: shape.value.as_ref(),
                        half_width: shape.half_width.as_ref(),
                    })
                    .collect();
                ((*name).to_owned(), surfaces)
            })
            .collect(),
        cells: CELLS,
    };
    Ok(sheet.draw())
}

/// Places on a coarse grid, for the range of values.
fn samples<'a>(x: &'a Axis, y: &'a Axis) -> impl Iterator<Item = (f64, f64)> + 'a {
    const N: usize = 8;
    (0..=N * N + 2 * N).map(move |k| {
        let (i, j) = (k % (N + 1), k / (N + 1));
        let at = |axis: &Axis, i: usize| axis.min + (axis.max - axis.min) * i as f64 / N as f64;
        (at(x, i), at(y, j))
    })
}
