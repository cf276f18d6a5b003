//! Everything about one point.

use serde_json::{Value, json};
use vergence_geometry::cases::CaseResult;
use vergence_geometry::comfort::{Band, Rule, VerticalParallax};
use vergence_geometry::planning::Setup;
use vergence_geometry::{Mode, State};

use crate::output::{self, Format};
use crate::rig;

/// Answer for one point, planner's frame, metres.
pub(super) fn run(setup: &Setup, point: [f64; 3], format: Format) -> anyhow::Result<()> {
    let views = setup.array.views().map_err(rig::refused)?;
    let sight = views
        .sight(point, &setup.screen, &setup.viewer)
        .map_err(rig::refused)?;
    let result = CaseResult::from(sight);
    match format {
        Format::Text => output::print(&text(setup, point, &result))?,
        Format::Json => {
            let mut case = case_json(setup, "point", point, &result);
            case["picture"] = picture_json(setup, &result);
            output::print_json(&json!({ "cases": [case] }))?;
        }
    }
    Ok(())
}

/// A case with its result, in the names of a file of cases.
pub(super) fn case_json(setup: &Setup, id: &str, point: [f64; 3], result: &CaseResult) -> Value {
    let mut case = json!({
        "id": id,
        "mode": setup.array.mode.kind().name(),
        "t": setup.array.interaxial_m,
        "f": setup.array.focal_m,
        "M": setup.screen.magnification,
        "e": setup.viewer.interocular_m,
        "V": setup.viewer.distance_m,
        "pupil": setup.array.pupil_m,
        "x0": point[0],
        "y0": point[1],
        "z0": point[2],
        "result": result,
    });
    match setup.array.mode {
        Mode::Parallel => {}
        Mode::Converged { distance_m } | Mode::Shifted { distance_m } => {
            case["L"] = json!(distance_m);
        }
        Mode::Verged { target_m } => {
            case["target"] = json!(target_m);
        }
    }
    case
}

/// Pixels of both pictures, and the parallax in units of the picture.
fn picture_json(setup: &Setup, result: &CaseResult) -> Value {
    let width = setup.screen_width_m();
    let per_pixel = width / setup.sensor.width_px as f64;
    json!({
        "left_px": result.left.map(|xy| pixel(setup, xy)),
        "right_px": result.right.map(|xy| pixel(setup, xy)),
        "left_inside": result.left.is_some_and(|xy| inside(setup, xy)),
        "right_inside": result.right.is_some_and(|xy| inside(setup, xy)),
        "p_width_fraction": result.p.map(|p| p / width),
        "p_px": result.p.map(|p| p / per_pixel),
        "q_px": result.q.map(|q| vertical_px(setup, q)),
    })
}

/// Pixel (u right, v down; the centre of the first pixel is 0, 0) of an upright position on the sensor.
fn pixel(setup: &Setup, xy: [f64; 2]) -> [f64; 2] {
    let sensor = &setup.sensor;
    [
        (sensor.width_px as f64 - 1.0) / 2.0 + xy[0] / sensor.pitch_m(),
        (sensor.height_px as f64 - 1.0) / 2.0 - xy[1] / sensor.pitch_y_m(),
    ]
}

/// Rows between two points with vertical parallax `q`, + when the right one is higher: v_left - v_right.
fn vertical_px(setup: &Setup, q: f64) -> f64 {
    q / (setup.screen.magnification * setup.sensor.pitch_y_m())
}

fn inside(setup: &Setup, xy: [f64; 2]) -> bool {
    xy[0].abs() <= setup.sensor.width_m / 2.0 && xy[1].abs() <= setup.sensor.height_m / 2.0
}

fn text(setup: &Setup, point: [f64; 3], r: &CaseResult) -> String {
    let mut out = heading(setup, point);
    let row = |name: &str, value: String, note: &str| {
        let note = if note.is_empty() {
            String::new()
        } else {
            format!("  {note}")
        };
        format!("{name:<26}{value:<34}{note}").trim_end().to_owned() + "\n"
    };
    out += &row("state", r.state.name().to_owned(), meaning(r.state));
    out += "\nIn the cameras             left              right\n";
    let two = |a: String, b: String| format!("{a:<17} {b}");
    out += &row(
        "depth along the axis",
        two(format!("{:.6} m", r.depth_l), format!("{:.6} m", r.depth_r)),
        "from the lens centre",
    );
    out += &row(
        "pan",
        two(
            format!("{:.6} deg", r.pan_l_deg),
            format!("{:.6} deg", r.pan_r_deg),
        ),
        "+ turns right",
    );
    let on = |xy: Option<[f64; 2]>, k: usize| {
        xy.map_or("-".to_owned(), |v| format!("{:.6} mm", v[k] * 1e3))
    };
    out += &row(
        "sensor x",
        two(on(r.left, 0), on(r.right, 0)),
        "upright, + right of the centre",
    );
    out += &row(
        "sensor y",
        two(on(r.left, 1), on(r.right, 1)),
        "upright, + above the centre",
    );
    let px = |xy: Option<[f64; 2]>, k: usize| {
        xy.map_or("-".to_owned(), |v| format!("{:.3} px", pixel(setup, v)[k]))
    };
    out += &row(
        "pixel u",
        two(px(r.left, 0), px(r.right, 0)),
        "0 is the centre of the left column",
    );
    out += &row(
        "pixel v",
        two(px(r.left, 1), px(r.right, 1)),
        "0 is the centre of the top row",
    );
    let seen = |xy: Option<[f64; 2]>| {
        xy.map_or("-", |v| {
            if inside(setup, v) {
                "inside"
            } else {
                "outside"
            }
        })
    };
    out += &row(
        "picture",
        two(seen(r.left).to_owned(), seen(r.right).to_owned()),
        "",
    );
    if let (Some(p), Some(q)) = (r.p, r.q) {
        out += &on_screen(setup, r, p, q, row);
    }
    out
}

/// The rows about the screen and the viewer.
fn on_screen(
    setup: &Setup,
    r: &CaseResult,
    p: f64,
    q: f64,
    row: impl Fn(&str, String, &str) -> String,
) -> String {
    let viewing = setup.viewing();
    let per_pixel = viewing.screen_width_m / setup.sensor.width_px as f64;
    let rule = Rule::default();
    let judged = rule
        .verdict_for_parallax(p, &viewing)
        .map_or("", |v| words(v.band));
    let mut out = String::from("\nOn the screen\n");
    out += &row(
        "horizontal parallax p",
        format!("{:.6} mm", p * 1e3),
        "right minus left; < 0 in front of the screen",
    );
    out += &row(
        "",
        format!("{:.4} % of the width", 100.0 * p / viewing.screen_width_m),
        judged,
    );
    out += &row("", format!("{:.4} px", p / per_pixel), "");
    let vertical = VerticalParallax::default();
    let arcmin = vertical.measure(q, &viewing);
    let verdict = Rule::VerticalParallax(vertical).verdict(arcmin, &viewing);
    out += &row(
        "vertical parallax q",
        format!("{:.6} mm", q * 1e3),
        "+ the right eye's point is higher",
    );
    let limit = format!(
        "{}; good to {} arcmin, alarm at {} (design values)",
        words_vertical(verdict.band),
        vertical.comfortable_arcmin,
        vertical.acceptable_arcmin
    );
    out += &row(
        "",
        format!("{:.4} px, {arcmin:.3} arcmin", vertical_px(setup, q)),
        &limit,
    );
    out += &row(
        "paper's h, v",
        format!("{:.6} mm, {:.6} mm", -p * 1e3 + 0.0, -q * 1e3 + 0.0),
        "h = -p, v = -q",
    );
    out += "\nTo the viewer\n";
    let Some(seen) = r.perceived else {
        out += &row("seen at", "-".to_owned(), meaning(r.state));
        return out;
    };
    let mm = |v: [f64; 3]| format!("{:.4}, {:.4}, {:.4} mm", v[0] * 1e3, v[1] * 1e3, v[2] * 1e3);
    out += &row(
        "seen at X, Y, Z",
        mm(seen),
        "from the screen's centre; Z + towards the viewer",
    );
    out += &row(
        "",
        format!("{:.4} % of V", 100.0 * seen[2] / setup.viewer.distance_m),
        "10 % cannot be fused, 8 % comfortable, 5 % no more depth",
    );
    if let Some(closest) = r.closest3d {
        out += &row(
            "nearest point of the rays",
            mm(closest),
            "middle of their shortest link",
        );
    }
    if let (Some(gap), Some(d), Some(v)) = (r.ray_gap, r.disparity_arcmin, r.vdisparity_arcmin) {
        out += &row(
            "gap of the rays",
            format!("{:.6} mm", gap * 1e3),
            "right minus left, where they cross in plan",
        );
        out += &row(
            "disparity",
            format!("{d:.4} arcmin"),
            "+ in front; below 60 arcmin by the 1 degree rule (Lambooij 2009)",
        );
        out += &row(
            "vertical disparity",
            format!("{v:.4} arcmin"),
            "elevation of the right ray minus the left",
        );
    }
    out
}

fn heading(setup: &Setup, point: [f64; 3]) -> String {
    let mode = match setup.array.mode {
        Mode::Parallel => "parallel".to_owned(),
        Mode::Converged { distance_m } => format!("converged on {distance_m} m"),
        Mode::Shifted { distance_m } => format!("shifted to {distance_m} m"),
        Mode::Verged {
            target_m: [x, _, z],
        } => format!("verged on ({x}, 0, {z}) m"),
    };
    format!(
        "Point ({}, {}, {}) m, x right, y up, z ahead; cameras {mode}\n\
         base {} mm, f {} mm, sensor {} x {} mm, {} x {} px; picture {} mm wide, seen from {} m by eyes {} mm apart\n\n",
        point[0],
        point[1],
        point[2],
        short(setup.array.interaxial_m * 1e3),
        short(setup.array.focal_m * 1e3),
        short(setup.sensor.width_m * 1e3),
        short(setup.sensor.height_m * 1e3),
        setup.sensor.width_px,
        setup.sensor.height_px,
        short(setup.screen_width_m() * 1e3),
        short(setup.viewer.distance_m),
        short(setup.viewer.interocular_m * 1e3),
    )
}

fn short(value: f64) -> String {
    crate::settings::quantity::significant(value, 6)
}

fn meaning(state: State) -> &'static str {
    match state {
        State::Front => "seen in front of the screen",
        State::Screen => "seen on the screen",
        State::Behind => "seen behind the screen",
        State::Infinity => "seen at infinity",
        State::Divergent => "seen nowhere: the eyes would have to diverge",
        State::BehindLeft => "not in front of the left camera",
        State::BehindRight => "not in front of the right camera",
        State::BehindBoth => "in front of neither camera",
    }
}

fn words(band: Band) -> &'static str {
    match band {
        Band::NoDepth => "no depth seen (rule: seen depth)",
        Band::Comfortable => "comfortable (rule: seen depth)",
        Band::Acceptable => "fusible, beyond comfort (rule: seen depth)",
        Band::Excessive => "cannot be fused (rule: seen depth)",
    }
}

fn words_vertical(band: Band) -> &'static str {
    match band {
        Band::NoDepth | Band::Comfortable => "good",
        Band::Acceptable => "noticeable",
        Band::Excessive => "too much",
    }
}
