//! The drawings of the page: vertical disparity over the picture, the histogram of parallax, the time line.

use maud::{Markup, PreEscaped, html};
use vergence_geometry::comfort::{AngularDisparity, Rule, Viewing, WidthFraction};

use super::pictures::Embedded;
use super::{ParallaxSamples, TimeLine};
use crate::figure::axis::{Axis, fixed};
use crate::figure::canvas::{Canvas, Paint, Type};
use crate::figure::colour::{self, BLUE, GREEN, GREY, INK, ORANGE, PALE, VERMILION, WHITE};
use crate::figure::lines::{Level, Panel, Series, Stack, Stroke};
use crate::figure::{Figure, text};

/// Most points that are drawn on the map.
const MAP_POINTS: usize = 500;

/// Most points of a line of the time line.
const LINE_POINTS: usize = 600;

/// Height of an empty title of stacked lines.
const HEAD: f64 = 44.0;

/// Bars of the histogram.
const BARS: usize = 60;

/// Type of the drawings, large enough for a phone.
const SMALL: f64 = 12.5;

/// A figure as part of the page: no sheet, colours of the page's scheme, ids of its own, as wide as its place.
fn inline(figure: &Figure, id: &str) -> Markup {
    let sheet = figure.svg().find("<rect width=").map(|at| {
        let end = figure.svg()[at..].find('\n').map_or(0, |n| at + n + 1);
        (at, end)
    });
    let mut svg = figure.svg().to_owned();
    if let Some((at, end)) = sheet.filter(|(at, end)| svg[*at..*end].contains(&WHITE.to_string())) {
        svg.replace_range(at..end, "");
    }
    for (colour, name) in [
        (INK, "var(--ink)"),
        (GREY, "var(--soft)"),
        (PALE, "var(--line)"),
        (WHITE, "var(--card)"),
        (BLUE, "var(--blue)"),
        (VERMILION, "var(--red)"),
        (GREEN, "var(--green)"),
        (ORANGE, "var(--orange)"),
    ] {
        svg = svg.replace(&format!("\"{colour}\""), &format!("\"{name}\""));
    }
    svg = svg
        .replace("id=\"clip", &format!("id=\"{id}-clip"))
        .replace("url(#clip", &format!("url(#{id}-clip"));
    // The view box says how tall it is for its width.
    if let (Some(from), Some(to)) = (svg.find(" width=\""), svg.find(" viewBox=")) {
        svg.replace_range(from..to, "");
    }
    html! { (PreEscaped(svg)) }
}

/// Vertical disparity at points of the picture: from each a line to the height at which the right eye sees it, exaggerated.
pub(super) fn vertical_map(
    samples: &[[f64; 3]],
    size_px: [usize; 2],
    backdrop: Option<&Embedded>,
    what: &str,
) -> Markup {
    let width = 480.0;
    let (w, h) = (size_px[0].max(1) as f64, size_px[1].max(1) as f64);
    let height = (width * h / w).clamp(60.0, 1200.0);
    let known: Vec<&[f64; 3]> = samples
        .iter()
        .filter(|s| s.iter().all(|v| v.is_finite()))
        .collect();
    let reach = reach_of(&known);
    let exaggeration = nice(0.06 * height / (reach * height / h));
    let step = known.len().div_ceil(MAP_POINTS).max(1);
    let description = format!(
        "{what}: {} points, from {} to {} pixels for nine in ten of them, drawn {} times as long",
        known.len(),
        fixed(-reach, 2),
        fixed(reach, 2),
        exaggeration
    );
    html! {
        figure.map {
            svg viewBox=(format!("0 0 {width} {height:.1}")) role="img" aria-label=(description) {
                @if let Some(picture) = backdrop {
                    image href=(picture.uri) width=(width) height=(format!("{height:.1}")) preserveAspectRatio="none" {}
                    rect.veil width=(width) height=(format!("{height:.1}")) {}
                } @else {
                    rect.blank width=(width) height=(format!("{height:.1}")) {}
                }
                @for [x, y, dy] in known.iter().step_by(step) {
                    @let (u, v) = ((x + 0.5) / w * width, (y + 0.5) / h * height);
                    @let end = v - dy / h * height * exaggeration;
                    @let paint = colour::diverging(dy / reach).to_string();
                    line x1=(fixed_1(u)) y1=(fixed_1(v)) x2=(fixed_1(u)) y2=(fixed_1(end)) stroke=(paint) stroke-width="1.6" {}
                    circle cx=(fixed_1(u)) cy=(fixed_1(v)) r="2.6" fill=(paint) {}
                }
            }
            div.ramp {
                span { (fixed(-reach, 2)) " px" }
                span.ramp-bar style=(ramp()) aria-hidden="true" {}
                span { "+" (fixed(reach, 2)) " px" }
            }
            figcaption {
                (what) ". Each line leads from a point of the left picture to the height at which the right eye sees it, " (exaggeration)
                " times exaggerated: up (orange, +) where the right eye's point is higher, down (blue, \u{2212}) where it is lower."
            }
        }
    }
}

fn fixed_1(value: f64) -> String {
    format!("{:.1}", value.clamp(-1e5, 1e5))
}

/// 95th percentile of the magnitudes, at least a tenth of a pixel.
fn reach_of(samples: &[&[f64; 3]]) -> f64 {
    let mut sizes: Vec<f64> = samples.iter().map(|s| s[2].abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let at = (sizes.len() * 95 / 100).min(sizes.len().saturating_sub(1));
    sizes.get(at).copied().unwrap_or(0.1).max(0.1)
}

/// 1, 2 or 5 times a power of ten, not above the value and at least 1.
fn nice(value: f64) -> f64 {
    let power = 10_f64.powf(value.max(1.0).log10().floor());
    let times = [5.0, 2.0, 1.0].into_iter().find(|k| k * power <= value);
    (times.unwrap_or(1.0) * power).max(1.0)
}

/// The colours of the map from -1 to 1.
fn ramp() -> String {
    let stops = (-6..=6).map(|i| colour::diverging(f64::from(i) / 6.0).to_string());
    format!(
        "background:linear-gradient(90deg,{})",
        stops.collect::<Vec<_>>().join(",")
    )
}

/// How much of the picture lies at which parallax, with the bands of two rules below.
pub(super) fn parallax_histogram(samples: &ParallaxSamples) -> Markup {
    let values: Vec<f64> = samples
        .percent
        .iter()
        .copied()
        .filter(|v| v.is_finite())
        .collect();
    if values.is_empty() {
        return html! {};
    }
    let rules = [
        Rule::WidthFraction(WidthFraction::BROADCAST),
        Rule::AngularDisparity(AngularDisparity::ONE_DEGREE),
    ];
    let bands: Vec<(Rule, Option<[f64; 4]>)> = rules
        .into_iter()
        .map(|rule| (rule, limits_percent(&rule, &samples.viewing)))
        .collect();
    let around = [-3.0, 4.5];
    let axis = Axis::around(
        "",
        values.iter().copied().map(|v| v.clamp(-30.0, 30.0)),
        &around,
    );
    let figure = histogram(&values, &axis, &bands, &samples.viewing);
    html! {
        figure {
            (inline(&figure, "histogram"))
            figcaption {
                "Share of the matched points at each horizontal parallax, in percent of the picture's width: minus is in front of the screen, plus behind it; below in arc minutes (\u{2032}), where in front is plus. \
                 Below it what two rules accept on this screen (" (fixed(100.0 * samples.viewing.screen_width_m, 0)) " cm wide, seen from "
                (fixed(samples.viewing.viewer.distance_m, 2)) " m): green is comfortable, yellow within the limit, red beyond."
                ul {
                    @for (rule, _) in &bands {
                        li { (rule.info().name) ": " (rule.info().source) }
                    }
                }
            }
        }
    }
}

/// Acceptable and comfortable in front, comfortable and acceptable behind, percent of the width.
fn limits_percent(rule: &Rule, viewing: &Viewing) -> Option<[f64; 4]> {
    let limits = rule.parallax_limits(viewing)?;
    let percent = |m: f64| 100.0 * m / viewing.screen_width_m;
    Some([
        percent(limits.front_acceptable_m),
        percent(limits.front_comfortable_m),
        percent(limits.behind_comfortable_m),
        percent(limits.behind_acceptable_m),
    ])
}

fn histogram(
    values: &[f64],
    axis: &Axis,
    bands: &[(Rule, Option<[f64; 4]>)],
    viewing: &Viewing,
) -> Figure {
    let (left, right, top, floor) = (14.0, 466.0, 34.0, 196.0);
    let strip = 30.0;
    let bottom = floor + 44.0 + strip * bands.len() as f64;
    let mut canvas = Canvas::new(480.0, bottom + 18.0);
    let x_of = |v: f64| left + axis.share(v).clamp(0.0, 1.0) * (right - left);
    let mut counts = [0_usize; BARS];
    for v in values {
        let bar = (axis.share(*v).clamp(0.0, 1.0) * BARS as f64) as usize;
        counts[bar.min(BARS - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let bar_width = (right - left) / BARS as f64;
    for (i, count) in counts.iter().enumerate() {
        let tall = (floor - top) * *count as f64 / most;
        let corner = (left + i as f64 * bar_width, floor - tall);
        canvas.rect(corner, (bar_width - 0.8, tall), &Paint::area(BLUE));
    }
    let zero = x_of(0.0);
    canvas.line(
        (zero, top - 6.0),
        (zero, floor),
        &Paint::line(INK, 1.0).dashed("3 3"),
    );
    canvas.text((zero, top - 12.0), "screen", &Type::size(SMALL).middle());
    for (text, at, kind) in [
        ("\u{2190} in front", left, Type::size(SMALL).colour(GREY)),
        (
            "behind \u{2192}",
            right,
            Type::size(SMALL).colour(GREY).end(),
        ),
    ] {
        canvas.text((at, top - 12.0), text, &kind);
    }
    draw_ticks(&mut canvas, (left, right), floor, axis, viewing, &x_of);
    for (i, (rule, limits)) in bands.iter().enumerate() {
        let y = floor + 42.0 + strip * i as f64;
        draw_band(&mut canvas, (left, right), y, *limits, &x_of);
        canvas.text(
            (left + 4.0, y + 26.0),
            rule.info().name,
            &Type::size(11.0).colour(GREY),
        );
    }
    canvas.finish_clear(
        "Horizontal parallax",
        &format!(
            "{} points from {} to {} percent of the picture's width; minus is in front of the screen",
            values.len(),
            fixed(values.iter().copied().fold(f64::INFINITY, f64::min), 2),
            fixed(values.iter().copied().fold(f64::NEG_INFINITY, f64::max), 2)
        ),
    )
}

/// The histogram's lower edge with percent and, below them, arc minutes.
fn draw_ticks(
    canvas: &mut Canvas,
    (left, right): (f64, f64),
    floor: f64,
    axis: &Axis,
    viewing: &Viewing,
    x_of: &dyn Fn(f64) -> f64,
) {
    canvas.line((left, floor), (right, floor), &Paint::line(INK, 1.0));
    let angle = Rule::AngularDisparity(AngularDisparity::ONE_DEGREE);
    for (v, label) in axis.ticks(7) {
        canvas.line(
            (x_of(v), floor),
            (x_of(v), floor + 4.0),
            &Paint::line(INK, 1.0),
        );
        canvas.text(
            (x_of(v), floor + 17.0),
            &format!("{label} %"),
            &Type::size(SMALL).middle(),
        );
        let metres = v / 100.0 * viewing.screen_width_m;
        if let Some(arcmin) = angle
            .measure_parallax(metres, viewing)
            .filter(|a| a.is_finite())
        {
            let label = format!("{}\u{2032}", fixed(arcmin, 0));
            canvas.text(
                (x_of(v), floor + 32.0),
                &label,
                &Type::size(11.0).middle().colour(GREY),
            );
        }
    }
}

fn draw_band(
    canvas: &mut Canvas,
    (left, right): (f64, f64),
    y: f64,
    limits: Option<[f64; 4]>,
    x_of: &dyn Fn(f64) -> f64,
) {
    let finite = |v: f64| if v.is_nan() { 0.0 } else { v };
    let Some(limits) = limits else { return };
    let [a, b, c, d] = limits.map(|v| x_of(finite(v)));
    for (from, to, colour) in [
        (left, a, VERMILION),
        (a, b, ORANGE),
        (b, c, GREEN),
        (c, d, ORANGE),
        (d, right, VERMILION),
    ] {
        canvas.rect(
            (from, y),
            (to - from, 12.0),
            &Paint::area(colour).faint(0.75),
        );
    }
}

/// Score and measures along the items, drawn for a wide page and for a narrow one; `number` of the line on the page.
pub(super) fn time_line(line: &TimeLine, number: usize) -> Markup {
    html! {
        div.wide { (without_head(inline(&stack(line, 760.0), &format!("wide-{number}")))) }
        div.narrow { (without_head(inline(&stack(line, 400.0), &format!("narrow-{number}")))) }
    }
}

/// Without the room for a title that the page has already.
fn without_head(drawing: Markup) -> Markup {
    let svg = drawing.into_string();
    let sizes = svg.split_once("viewBox=\"0 0 ").and_then(|(_, rest)| {
        let (width, rest) = rest.split_once(' ')?;
        let (height, _) = rest.split_once('"')?;
        Some((width.to_owned(), height.parse::<f64>().ok()?))
    });
    let Some((width, height)) = sizes else {
        return PreEscaped(svg);
    };
    let whole = format!("viewBox=\"0 0 {width} ");
    let at = svg.find(&whole).unwrap_or(0);
    let end = at + svg[at..].find('>').unwrap_or(0);
    let cut = svg[at..end].replacen(
        &format!("{whole}{}\"", fixed_short(height)),
        &format!(
            "viewBox=\"0 {HEAD} {width} {}\"",
            fixed_short(height - HEAD)
        ),
        1,
    );
    PreEscaped(format!("{}{cut}{}", &svg[..at], &svg[end..]))
}

fn fixed_short(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn stack(line: &TimeLine, width: f64) -> Figure {
    let items = &line.items;
    let points = |value: &dyn Fn(usize) -> Option<f64>| {
        let all = (0..items.len()).map(|i| (items[i].at, value(i).unwrap_or(f64::NAN)));
        decimated(&all.collect::<Vec<_>>())
    };
    let score = points(&|i| items[i].score);
    let [look, bad] = line.limits;
    let y = Axis::around(
        "score (0 best)",
        score.iter().map(|p| p.1),
        &[0.0, 1.1 * bad],
    );
    let drawn = |points: Vec<(f64, f64)>| {
        let joined = line
            .ordered
            .then(|| Series::new("", points.clone()).colour(BLUE));
        let dotted = points.len() <= 40 || !line.ordered;
        let dots = dotted.then(|| Series::new("", points).colour(BLUE).stroke(Stroke::Points));
        joined.into_iter().chain(dots).collect()
    };
    let mut scores = Panel::new(y, drawn(score));
    scores.levels = [("good to here", look), ("bad from here", bad)]
        .map(|(label, at)| Level {
            label: label.to_owned(),
            at,
        })
        .into();
    let mut panels = vec![scores];
    for (m, name) in line.measures.iter().enumerate().take(6) {
        let values = points(&|i| items[i].measures.get(m).copied().flatten());
        let y = Axis::around(name, values.iter().map(|p| p.1), &[0.0]);
        let mut panel = Panel::new(y, drawn(values));
        // Tall enough for its name along the side.
        panel.height = (text::width(name, 12.5, false) + 14.0).clamp(104.0, 220.0);
        panels.push(panel);
    }
    let ends = [items.first(), items.last()].map(|i| i.map_or(0.0, |i| i.at));
    // Points by themselves are drawn whole.
    let margin = if line.ordered { 0.0 } else { 0.5 };
    let x = Axis::linear(&line.axis, ends[0] - margin, ends[1] + margin);
    let mut stack = Stack::new("", "", x, panels);
    let step = line.cuts.len().div_ceil(24).max(1);
    let cut = |(i, at): (usize, &f64)| Level {
        label: if i == 0 {
            "cut".to_owned()
        } else {
            String::new()
        },
        at: *at,
    };
    stack.marks = line
        .cuts
        .iter()
        .step_by(step)
        .enumerate()
        .map(cut)
        .collect();
    stack.width = width;
    stack.draw()
}

/// So many points that no more could be seen: of each run the lowest and the highest.
fn decimated(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= LINE_POINTS {
        return points.to_vec();
    }
    let run = points.len().div_ceil(LINE_POINTS / 2);
    let ends = points.chunks(run).flat_map(|chunk| {
        let known = || chunk.iter().filter(|p| p.1.is_finite());
        let low = known().min_by(|a, b| a.1.total_cmp(&b.1));
        let high = known().max_by(|a, b| a.1.total_cmp(&b.1));
        match (low, high) {
            (Some(a), Some(b)) if a.0 <= b.0 => vec![*a, *b],
            (Some(a), Some(b)) => vec![*b, *a],
            // A run without any value stays a gap.
            _ => vec![chunk[0]],
        }
    });
    ends.collect()
}

/// The picture's frame with what touches its edges.
pub(super) fn window_frame(strips: &[super::WindowStrip]) -> Markup {
    use super::Edge;
    let mut canvas = Canvas::new(260.0, 160.0);
    canvas.rect((12.0, 12.0), (236.0, 136.0), &Paint::line(GREY, 1.0));
    for strip in strips {
        let share = strip.share.clamp(0.0, 1.0);
        let (corner, size) = match strip.edge {
            Edge::Left => ((6.0, 148.0 - 136.0 * share), (12.0, 136.0 * share)),
            Edge::Right => ((242.0, 148.0 - 136.0 * share), (12.0, 136.0 * share)),
            Edge::Top => ((12.0, 6.0), (236.0 * share, 12.0)),
            Edge::Bottom => ((12.0, 142.0), (236.0 * share, 12.0)),
        };
        canvas.rect(corner, size, &Paint::area(ORANGE));
    }
    let figure = canvas.finish_clear(
        "Window",
        "The picture's frame; a bar on an edge is as long as the part of it that things in front of the screen touch",
    );
    inline(&figure, "window")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_keep_their_peaks() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), 1.0)).collect();
        points[77_777].1 = 99.0;
        points[5].1 = f64::NAN;
        let few = decimated(&points);
        assert!(few.len() <= LINE_POINTS + 2);
        assert!(few.contains(&(77_777.0, 99.0)));
        assert!(few.is_sorted_by(|a, b| a.0 <= b.0));
    }

    #[test]
    fn exaggerations_are_round() {
        assert_eq!(
            [0.3, 1.0, 7.0, 49.0, 50.0].map(nice),
            [1.0, 1.0, 5.0, 20.0, 50.0]
        );
    }
}
