//! The report of a calibration: one HTML page that needs nothing but itself.

use std::path::Path;

use base64::Engine as _;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use vergence_calib::Target;
use vergence_calib::solve::Calibration;

use super::answer::Answer;
use super::{Work, figures};
use crate::fault;
use crate::figure::Figure;
use crate::output;

/// Name of the page in its folder.
pub(super) const PAGE: &str = "index.html";

/// What the page looks like: the sheet of every report of this program.
const STYLE: &str = include_str!("../grade/report/style.css");

/// Nothing may be fetched from anywhere, and nothing may run.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// Drawings keep their own light ground in dark pages: their colours are made for it.
const DRAWINGS: &str = "figure img { background: #fff; }\n";

/// Write the page into a folder, which is made if it is not there.
pub(super) fn write(
    dir: &Path,
    work: &Work<'_>,
    found: &Calibration,
    answer: &Answer,
    target: &Target,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(dir)
        .map_err(|e| fault::failed(format!("cannot make the folder {}: {e}", dir.display())))?;
    let page = page(work, found, answer, target).into_string();
    output::write_file(&dir.join(PAGE), page.as_bytes())
}

fn page(work: &Work<'_>, found: &Calibration, answer: &Answer, target: &Target) -> Markup {
    let title = match work.names.len() {
        1 => format!("Calibration of camera {}", work.names[0]),
        n if work.machine => format!("Calibration of a head of {n} cameras"),
        n => format!("Calibration of {n} cameras"),
    };
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                link rel="icon" href="data:,";
                title { (title) " \u{2013} vergence calibrate" }
                style { (PreEscaped(STYLE)) (PreEscaped(DRAWINGS)) }
            }
            body {
                header {
                    p.kicker { "vergence calibrate" }
                    h1 { (title) }
                    (facts(answer, target))
                }
                main {
                    (weak(answer))
                    (cameras(answer))
                    (pair(answer))
                    (axes(answer))
                    (drawings(work, found))
                    (pictures(work, found, answer))
                    (how_to_read())
                }
                footer {
                    p { "Made by vergence " (env!("CARGO_PKG_VERSION")) ". This page is complete in itself and fetches nothing." }
                }
            }
        }
    }
}

fn facts(answer: &Answer, target: &Target) -> Markup {
    let fact = |name: &str, value: String| html! { div { dt { (name) } dd { (value) } } };
    html! {
        dl.facts {
            (fact("error", format!("{:.3} px RMS", answer.rms_px)))
            (fact("pictures", format!("{} of {}", answer.views_used, answer.views)))
            (fact("corners", answer.corners.to_string()))
            (fact("board", target.text()))
            @if let Some(baseline_m) = answer.baseline_m {
                (fact("baseline", format!("{:.2} mm", 1e3 * baseline_m)))
            }
            @if let Some(rows) = &answer.rows {
                (fact("rectified rows", format!("{:.3} px RMS, {:.2} px at most", rows.rms_px, rows.largest_px)))
            }
        }
    }
}

fn weak(answer: &Answer) -> Markup {
    html! {
        section.card {
            h2 { "What is weak, and what to do" }
            @if answer.weak.is_empty() {
                p { "Nothing that these pictures could tell." }
            }
            @for weak in &answer.weak {
                p { span.badge.look { "weak" } " " (weak.what) ". " strong { (weak.remedy) "." } }
            }
            @for next in &answer.next_views {
                p { span.badge.none { "next picture" } " " (next.say)
                    ". It would shrink the uncertainty of the lens to " (format!("{:.0}", 100.0 * next.shrinks_to)) " %." }
            }
        }
    }
}

fn cameras(answer: &Answer) -> Markup {
    html! {
        section.card {
            h2 { "Cameras" }
            div style="overflow-x: auto" {
                table {
                    thead { tr { th { "camera" } th { "fx, fy, px" } th { "cx, cy, px" } th { "distortion" } th { "error, px RMS" } } }
                    tbody {
                        @for c in &answer.cameras {
                            @let sigma = |what: &str| answer.uncertainty.sigma.get(&format!("{}.{what}", c.name)).map_or(String::new(), |s| format!(" ± {s:.2}"));
                            tr {
                                th { (c.name) br; span.source { (c.width) "x" (c.height) ", " (c.model) } }
                                td { (format!("{:.2}", c.fx)) span.sigma { (sigma("fx")) } br; (format!("{:.2}", c.fy)) span.sigma { (sigma("fy")) } }
                                td { (format!("{:.2}", c.cx)) span.sigma { (sigma("cx")) } br; (format!("{:.2}", c.cy)) span.sigma { (sigma("cy")) } }
                                td { (c.distortion.iter().map(|k| format!("{k:.5}")).collect::<Vec<_>>().join(" ")) }
                                td { (format!("{:.3}", c.rms_px)) }
                            }
                        }
                    }
                }
            }
            @if let Some(halves) = &answer.uncertainty.halves {
                p { "Calibrated from two halves of the pictures: each half's corners lie " (format!("{:.3}", halves.other_half_rms_px))
                    " px RMS from where the other half's lenses put them; the two lenses put the same directions "
                    (halves.lens_difference_px.iter().map(|d| format!("{:.2} px (mean) and {:.2} px (worst)", d[0], d[1])).collect::<Vec<_>>().join(", "))
                    " apart." }
            }
        }
    }
}

fn pair(answer: &Answer) -> Markup {
    let Some(pose) = &answer.right_from_left else {
        return html! {};
    };
    let vector = |v: &[f64; 3], scale: f64, digits: usize| {
        v.iter()
            .map(|x| rounded(x * scale, digits))
            .collect::<Vec<_>>()
            .join(", ")
    };
    html! {
        section.card {
            h2 { "Where the second camera stands" }
            p { "A point x of the first camera is R x + t of the second one. t = (" (vector(&pose.translation_m, 1e3, 2)) ") mm; R turns by ("
                (vector(&pose.rotation_vector_deg, 1.0, 3)) ") degrees about x, y, z; the optical axes enclose "
                (format!("{:.3}", answer.axes_angle_deg.unwrap_or_default())) " degrees." }
            table {
                thead { tr { th { "range" } th { "± by the calibration" } th { "± by matching to a quarter pixel" } } }
                tbody {
                    @for r in &answer.uncertainty.range {
                        tr { th { (format!("{:.1} m", r.range_m)) } td { (format!("{:.2} mm", 1e3 * r.calibration_m)) } td { (format!("{:.2} mm", 1e3 * r.matching_m)) } }
                    }
                }
            }
        }
    }
}

fn axes(answer: &Answer) -> Markup {
    let Some(machine) = &answer.machine else {
        return html! {};
    };
    let give = |s: Option<f64>, digits: usize| {
        s.map_or(" (not told)".to_owned(), |s| format!(" ± {s:.digits$}"))
    };
    html! {
        section.card {
            h2 { "Axes" }
            table {
                thead { tr { th { "axis" } th { "degrees a step" } th { "backlash, degrees" } th { "direction at home" } } }
                tbody {
                    @for a in &machine.axes {
                        tr {
                            th { (a.name) }
                            td { (format!("{:.6}", a.degrees_per_step)) span.sigma { (give(a.degrees_per_step_sigma, 6)) } }
                            td { (format!("{:.4}", a.backlash_deg)) span.sigma { (give(a.backlash_sigma_deg, 4)) } }
                            td { (a.direction.iter().map(|d| rounded(*d, 4)).collect::<Vec<_>>().join(" ")) }
                        }
                    }
                }
            }
        }
    }
}

fn drawings(work: &Work<'_>, found: &Calibration) -> Markup {
    // As pictures, not as parts of the page: each drawing's names for its own parts must not meet those of the others.
    let figure = |figure: &Figure, alt: &str| {
        let svg = base64::engine::general_purpose::STANDARD.encode(figure.svg());
        html! { section.card { figure { img src=(format!("data:image/svg+xml;base64,{svg}")) alt=(alt); } } }
    };
    html! {
        (figure(&figures::coverage(work, found), "where corners were seen, and their errors"))
        @for map in figures::projection_maps(work, found) { (figure(&map, "uncertainty of projections over the picture")) }
        @if let Some(ranges) = figures::ranges(found) { (figure(&ranges, "uncertainty of ranges")) }
        (figure(&figures::residuals(work, found), "error of every picture"))
    }
}

fn pictures(work: &Work<'_>, found: &Calibration, answer: &Answer) -> Markup {
    html! {
        section.card {
            h2 { "Pictures" }
            @for r in &answer.views_rejected {
                p { span.badge.bad { "left out" } " " (r.file) ": " (r.reason) }
            }
            details {
                summary { "Error of every picture that was used" }
                table {
                    thead { tr { th { "picture" } th { "corners" } th { "error, px RMS" } } }
                    tbody {
                        @for ((shot, rms), view) in work.shots.iter().zip(&found.shot_rms_px).zip(&work.view_of_shot) {
                            @if let Some(rms) = rms {
                                tr { th { (work.views[*view].path.display().to_string()) } td { (shot.sightings.len()) } td { (format!("{rms:.3}")) } }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn how_to_read() -> Markup {
    html! {
        details.card {
            summary { "How to read this page" }
            p { "Errors are the distances between where a corner was found and where the calibration puts it. They say how well the model fits, not how well it "
                "is known: few pictures fit any model. How well it is known stands in the standard deviations, in the maps and in the two halves." }
            p { "The maps show the standard deviation of where a point is seen, by the calibration alone, while the boards hold the scene (\u{201c}mean frames\u{201d}, as mrcal "
                "has it). It is small where boards were held and grows outside; at a larger distance it grows when all boards were near." }
            p { "Matching errors of ranges differ from point to point and average out over an object; the calibration's error is the same for all of them." }
        }
    }
}

/// A number with so many decimals, without the sign of what rounds to nothing.
fn rounded(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|b| matches!(b, b'0' | b'.')) => digits.to_owned(),
        _ => text,
    }
}
