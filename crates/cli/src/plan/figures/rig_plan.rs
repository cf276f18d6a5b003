//! The rig from above, to scale: the scene, the head, the viewer.

use vergence_geometry::planning::thresholds;
use vergence_geometry::{ModeKind, View};

use super::super::report::Question;
use super::{metres, rig_line};
use crate::figure::Figure;
use crate::figure::canvas::{Canvas, Paint, Place, Type};
use crate::figure::colour::{BLUE, Colour, GREEN, GREY, INK, PALE, VERMILION, WHITE};
use crate::figure::lines::wrapped;
use crate::rig::refused;
use crate::settings::quantity::significant;

const WIDTH: f64 = 800.0;
const LEFT: f64 = 56.0;
const NOTE: f64 = 11.0;
const LABEL: f64 = 12.0;

const FIELD_LEFT: Colour = Colour(0xd6, 0xe6, 0xf2);
const FIELD_RIGHT: Colour = Colour(0xfa, 0xe3, 0xd3);
const FIELD_BOTH: Colour = Colour(0xe6, 0xe8, 0xdc);

/// Three plans below each other, each with its own scale.
pub(super) fn draw(question: &Question) -> anyhow::Result<Figure> {
    let setup = &question.setup;
    let title = "The rig and its viewer in plan, to scale";
    let subtitle = format!(
        "(a) scene and fields of view, (b) stereo head, (c) screen and viewer. Blue: left camera and eye; vermilion: right. {}",
        rig_line(setup)
    );
    let lines = wrapped(&subtitle, WIDTH - 40.0, NOTE);
    let top = 58.0 + 15.0 * lines.len() as f64;
    let [half_x, _] = setup.sensor.half_field(setup.array.focal_m);
    let scale = (WIDTH - LEFT - 60.0) / question.far_m;
    let scene_half = (scale * (half_x * question.far_m + setup.array.interaxial_m)).min(300.0);
    let lower = top + 2.0 * scene_half + 70.0;
    let mut canvas = Canvas::new(WIDTH, lower + 330.0);
    canvas.text((20.0, 26.0), title, &Type::size(15.0).bold());
    for (i, line) in lines.iter().enumerate() {
        canvas.text(
            (20.0, 46.0 + 15.0 * i as f64),
            line,
            &Type::size(NOTE).colour(GREY),
        );
    }
    let scene = Scene {
        origin: (LEFT, top + scene_half),
        scale,
        half: scene_half,
    };
    draw_scene(&mut canvas, question, &scene)?;
    draw_head(&mut canvas, question, (20.0, lower))?;
    draw_viewer(&mut canvas, question, (430.0, lower))?;
    Ok(canvas.finish(title, &subtitle))
}

/// Scale of part (a): z to the right, x downwards (the rig's right is below, as seen from above).
struct Scene {
    origin: Place,
    scale: f64,
    half: f64,
}

impl Scene {
    fn at(&self, x: f64, z: f64) -> Place {
        (
            self.origin.0 + z * self.scale,
            self.origin.1 + x * self.scale,
        )
    }
}

fn draw_scene(canvas: &mut Canvas, question: &Question, scene: &Scene) -> anyhow::Result<()> {
    let setup = &question.setup;
    let far = question.far_m;
    let half_t = setup.array.interaxial_m / 2.0;
    let [tan, _] = setup.sensor.half_field(setup.array.focal_m);
    let corner = (scene.origin.0, scene.origin.1 - scene.half);
    let size = (far * scene.scale, 2.0 * scene.half);
    // Fields begin at the lenses.
    let pupil = setup.array.pupil_m;
    canvas.clipped(corner, size, |canvas| {
        let half = tan * (far - pupil);
        let wedge = |x: f64| {
            [
                scene.at(x, pupil),
                scene.at(x - half, far),
                scene.at(x + half, far),
            ]
        };
        canvas.polygon(&wedge(-half_t), &Paint::area(FIELD_LEFT));
        canvas.polygon(&wedge(half_t), &Paint::area(FIELD_RIGHT));
        let apex = pupil + half_t / tan;
        if apex < far {
            let both = [
                scene.at(0.0, apex),
                scene.at(half_t - half, far),
                scene.at(half - half_t, far),
            ];
            canvas.polygon(&both, &Paint::area(FIELD_BOTH));
        }
    });
    // The axes of the tick marks.
    let bottom = scene.origin.1 + scene.half;
    let axis = crate::figure::axis::Axis::linear("", 0.0, far);
    for (z, text) in axis.ticks(10) {
        let x = scene.at(0.0, z).0;
        canvas.line((x, bottom), (x, bottom + 4.0), &Paint::line(INK, 0.8));
        canvas.text((x, bottom + 17.0), &text, &Type::size(NOTE).middle());
    }
    canvas.line(
        (scene.origin.0, bottom),
        (scene.at(0.0, far).0, bottom),
        &Paint::line(INK, 0.8),
    );
    let middle = 0.5 * (scene.origin.0 + scene.at(0.0, far).0);
    canvas.text(
        (middle, bottom + 34.0),
        "distance *z* / m; the same scale across",
        &Type::size(LABEL).middle(),
    );
    canvas.text((20.0, corner.1 + 4.0), "(a)", &Type::size(LABEL).bold());
    draw_distances(canvas, question, scene)?;
    draw_toe_in(canvas, question, scene);
    let (l, r) = (scene.at(-half_t, 0.0), scene.at(half_t, 0.0));
    canvas.circle(l, 2.2, &Paint::area(BLUE));
    canvas.circle(r, 2.2, &Paint::area(VERMILION));
    canvas.text((r.0 - 4.0, r.1 + 18.0), "rig", &Type::size(NOTE).end());
    Ok(())
}

/// The thresholds of the rule as lines across the field.
fn draw_distances(canvas: &mut Canvas, question: &Question, scene: &Scene) -> anyhow::Result<()> {
    let t = thresholds(&question.setup, &question.rule).map_err(refused)?;
    let [tan, _] = question
        .setup
        .sensor
        .half_field(question.setup.array.focal_m);
    let rows = [
        (t.parallel_fusible_from_m, "parallel fusible"),
        (t.parallel_comfortable_from_m, "parallel comfortable"),
        (t.converged_stops_mattering_m, "parallel: no depth"),
        (t.indistinguishable_from_m, "modes alike"),
    ];
    let mut row = 0;
    for (z, name) in rows {
        let Some(z) = z.filter(|z| *z > question.near_m && *z < question.far_m) else {
            continue;
        };
        let half = (tan * z * scene.scale).min(scene.half);
        let x = scene.at(0.0, z).0;
        let y = scene.origin.1;
        canvas.line((x, y - half), (x, y + half), &Paint::line(GREEN, 1.2));
        let label = format!("{name} from {z:.2} m");
        // Names stand at the upper left of the field, one below the other, with a line to their distance.
        let at = (LEFT + 10.0, y - scene.half + 12.0 + 16.0 * f64::from(row));
        let wide = crate::figure::text::width(&label, NOTE, false);
        canvas.polyline(
            &[
                (at.0 + wide + 4.0, at.1 - 4.0),
                (x, at.1 - 4.0),
                (x, y - half),
            ],
            &Paint::line(GREEN, 0.7).dashed("2 2"),
        );
        canvas.text(at, &label, &Type::size(NOTE).halo());
        row += 1;
    }
    Ok(())
}

/// The axes of cameras that converge on the nearest target.
fn draw_toe_in(canvas: &mut Canvas, question: &Question, scene: &Scene) {
    let near = question.near_m;
    let target = scene.at(0.0, near);
    let half_t = question.setup.array.interaxial_m / 2.0;
    for (x, colour) in [(-half_t, BLUE), (half_t, VERMILION)] {
        canvas.line(scene.at(x, 0.0), target, &Paint::line(colour, 0.9));
    }
    for z in [near, question.far_m] {
        let at = scene.at(0.0, z);
        // A person from above is about half a metre wide.
        canvas.circle(
            at,
            (0.25 * scene.scale).max(2.5),
            &Paint {
                fill: Some(PALE),
                stroke: Some(INK),
                width: 0.9,
                ..Paint::default()
            },
        );
    }
    canvas.text(
        (target.0, target.1 + 0.25 * scene.scale + 14.0),
        &format!("nearest target, {}", metres(near)),
        &Type::size(NOTE).middle().halo(),
    );
    let far = scene.at(0.0, question.far_m);
    canvas.text(
        (far.0 - 0.25 * scene.scale - 6.0, far.1 + 4.0),
        &format!("farthest, {}", metres(question.far_m)),
        &Type::size(NOTE).end().halo(),
    );
}

/// Height of part (b) above the pivots that the axes may take.
const AXIS_UP: f64 = 165.0;

/// Part (b): the head enlarged, turned to the nearest target; z upwards.
fn draw_head(canvas: &mut Canvas, question: &Question, corner: Place) -> anyhow::Result<()> {
    let setup = &question.setup;
    canvas.text(
        (corner.0, corner.1 + 12.0),
        "(b)",
        &Type::size(LABEL).bold(),
    );
    let (t, f, pupil) = (
        setup.array.interaxial_m,
        setup.array.focal_m,
        setup.array.pupil_m,
    );
    // As large as the base allows, but lens and pivot both within the part.
    let scale = (190.0 / t).min(0.7 * AXIS_UP / pupil.max(1e-9));
    let centre = (corner.0 + 195.0, corner.1 + 215.0);
    let views = setup
        .views_at(ModeKind::Converged, question.near_m)
        .map_err(refused)?;
    let head = Head { centre, scale };
    for (view, (colour, name, side)) in views
        .cameras()
        .iter()
        .zip([(BLUE, "left", -1.0), (VERMILION, "right", 1.0)])
    {
        head.draw_camera(canvas, view, [f, setup.sensor.width_m], colour);
        let foot = head.at(view.pivot_x_m, 0.0);
        let kind = Type::size(NOTE);
        let kind = if side < 0.0 { kind.end() } else { kind };
        canvas.text((foot.0 + side * 14.0, foot.1 + 4.0), name, &kind);
    }
    let beta = (t / (2.0 * question.near_m)).atan().to_degrees();
    let text = format!(
        "axes turned by β = {beta:.3}° each towards {}",
        metres(question.near_m)
    );
    canvas.text(
        (centre.0, corner.1 + 30.0),
        &text,
        &Type::size(NOTE).middle(),
    );
    dimension(
        canvas,
        head.at(-t / 2.0, 0.0),
        head.at(t / 2.0, 0.0),
        50.0,
        &format!("*t* = {} mm", significant(t * 1e3, 4)),
    );
    let mut facts = format!(
        "*f* = {} mm; sensor {} mm wide",
        significant(f * 1e3, 4),
        significant(setup.sensor.width_m * 1e3, 4)
    );
    if pupil > 0.0 {
        facts += &format!("; lens {} mm before its pivot", significant(pupil * 1e3, 4));
    }
    canvas.text(
        (centre.0, centre.1 + 90.0),
        &facts,
        &Type::size(NOTE).middle(),
    );
    Ok(())
}

/// Where part (b) lies: the middle of the pivots, and its scale.
struct Head {
    centre: Place,
    scale: f64,
}

impl Head {
    fn at(&self, x: f64, z: f64) -> Place {
        (
            self.centre.0 + x * self.scale,
            self.centre.1 - z * self.scale,
        )
    }

    /// One camera: pivot, axis, lens, and the field behind the lens onto the sensor (focal length, width).
    fn draw_camera(&self, canvas: &mut Canvas, view: &View, [f, w]: [f64; 2], colour: Colour) {
        let [cx, cz] = view.centre_m();
        let [ax, az] = view.axis;
        let along =
            |d: f64, across: f64| self.at(cx + ax * d + az * across, cz + az * d - ax * across);
        let reach = AXIS_UP / self.scale;
        let pivot = self.at(view.pivot_x_m, 0.0);
        canvas.line(
            pivot,
            self.at(view.pivot_x_m, reach),
            &Paint::line(GREY, 0.7).dashed("3 2"),
        );
        canvas.line(pivot, along(0.0, 0.0), &Paint::line(colour, 1.0));
        canvas.line(
            along(-1.6 * f, 0.0),
            along((reach - cz) / az, 0.0),
            &Paint::line(colour, 1.0),
        );
        canvas.polygon(
            &[along(0.0, 0.0), along(-f, -w / 2.0), along(-f, w / 2.0)],
            &Paint::area(colour).faint(0.18),
        );
        canvas.line(
            along(-f, -w / 2.0),
            along(-f, w / 2.0),
            &Paint::line(colour, 3.0),
        );
        canvas.circle(
            along(0.0, 0.0),
            3.4,
            &Paint {
                fill: Some(WHITE),
                stroke: Some(colour),
                width: 1.4,
                ..Paint::default()
            },
        );
        canvas.circle(pivot, 2.2, &Paint::area(INK));
    }
}

/// Part (c): screen, eyes, and where the nearest target of parallel cameras is seen; the viewer below.
fn draw_viewer(canvas: &mut Canvas, question: &Question, corner: Place) -> anyhow::Result<()> {
    let setup = &question.setup;
    canvas.text(
        (corner.0, corner.1 + 12.0),
        "(c)",
        &Type::size(LABEL).bold(),
    );
    let (e, v) = (setup.viewer.interocular_m, setup.viewer.distance_m);
    let width = setup.screen_width_m();
    let p_near = setup
        .axial_parallax_m(ModeKind::Parallel, question.near_m, question.near_m)
        .map_err(refused)?
        .unwrap_or(f64::NAN);
    let seen = v * setup.viewer.seen_fraction(p_near).unwrap_or(f64::NAN);
    let scale = (200.0 / v).min(250.0 / width);
    let screen_y = corner.1 + 62.0;
    let middle = corner.0 + 165.0;
    let at = |x: f64, z: f64| (middle + x * scale, screen_y + z * scale);
    canvas.line(
        at(-width / 2.0, 0.0),
        at(width / 2.0, 0.0),
        &Paint::line(INK, 3.0),
    );
    canvas.text(
        (middle, screen_y - 24.0),
        &format!("screen, picture {} mm wide", significant(width * 1e3, 4)),
        &Type::size(NOTE).middle(),
    );
    for (eye, picture, colour, name) in [
        (-e / 2.0, -p_near / 2.0, BLUE, "left eye"),
        (e / 2.0, p_near / 2.0, VERMILION, "right eye"),
    ] {
        canvas.line(at(eye, v), at(picture, 0.0), &Paint::line(colour, 1.0));
        canvas.circle(at(eye, v), 4.0, &Paint::area(colour));
        canvas.circle(at(picture, 0.0), 2.4, &Paint::area(colour));
        let place = at(eye, v);
        let kind = if eye < 0.0 {
            Type::size(NOTE).end()
        } else {
            Type::size(NOTE)
        };
        canvas.text((place.0 + 9.0 * eye.signum(), place.1 + 4.0), name, &kind);
    }
    let point = at(0.0, seen);
    canvas.circle(point, 3.2, &Paint::area(GREEN));
    // Beside the point, but above the names of the eyes.
    let note_y = point.1.min(at(0.0, v).1 - 40.0);
    let text = format!("parallel target at {}: seen", metres(question.near_m));
    canvas.text((point.0 + 16.0, note_y), &text, &Type::size(NOTE).halo());
    let text = if seen < 1.0 {
        format!("{} mm before the screen", significant(seen * 1e3, 3))
    } else {
        format!("{} before the screen", metres(seen))
    };
    canvas.text(
        (point.0 + 16.0, note_y + 14.0),
        &text,
        &Type::size(NOTE).halo(),
    );
    let left = at(-width / 2.0, 0.0).0.min(middle - 60.0) - 10.0;
    dimension_down(
        canvas,
        (left, screen_y),
        (left, at(0.0, v).1),
        &format!("*V* = {} m", significant(v, 4)),
    );
    dimension(
        canvas,
        at(-e / 2.0, v),
        at(e / 2.0, v),
        28.0,
        &format!("*e* = {} mm", significant(e * 1e3, 4)),
    );
    Ok(())
}

/// A horizontal dimension below two places.
fn dimension(canvas: &mut Canvas, a: Place, b: Place, below: f64, text: &str) {
    let y = a.1.max(b.1) + below;
    let thin = Paint::line(GREY, 0.8);
    for p in [a, b] {
        canvas.line((p.0, p.1 + 8.0), (p.0, y + 4.0), &Paint::line(GREY, 0.5));
    }
    let middle = (0.5 * (a.0 + b.0), y);
    canvas.arrow(middle, (a.0, y), &thin);
    canvas.arrow(middle, (b.0, y), &thin);
    canvas.text((middle.0, y + 16.0), text, &Type::size(NOTE).middle());
}

/// A vertical dimension along two places, its text to the left.
fn dimension_down(canvas: &mut Canvas, a: Place, b: Place, text: &str) {
    let thin = Paint::line(GREY, 0.8);
    let middle = (a.0, 0.5 * (a.1 + b.1));
    canvas.arrow(middle, a, &thin);
    canvas.arrow(middle, b, &thin);
    canvas.text(
        (a.0 - 6.0, middle.1),
        text,
        &Type::size(NOTE).middle().turned(-90.0),
    );
}
