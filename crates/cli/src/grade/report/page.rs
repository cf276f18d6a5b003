//! The page as a whole.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::{Pictures, ReportData, sections};

/// What the page looks like.
const STYLE: &str = include_str!("style.css");

/// Nothing may be fetched from anywhere, and nothing may run.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// The whole page.
pub(super) fn html(data: &ReportData) -> anyhow::Result<String> {
    let pictures = sections::pictures(&data.pictures)?;
    let backdrop = match &data.pictures {
        Pictures::None => None,
        Pictures::One(picture) | Pictures::Pair { left: picture, .. } => {
            Some(super::pictures::backdrop(picture)?)
        }
    };
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta name="generator" content=(format!("vergence {}", env!("CARGO_PKG_VERSION")));
                link rel="icon" href="data:,";
                title { (data.title) " \u{2013} vergence grade" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    (sections::heading(data))
                }
                main {
                    (sections::time_lines(data))
                    (sections::worst_item(data))
                    (pictures)
                    (sections::scores(&data.scores))
                    (sections::causes("What was measured", "source", &data.causes))
                    (sections::plots(data, backdrop.as_ref()))
                    (sections::not_judged(&data.not_judged))
                    (how_to_read())
                }
                footer {
                    p { "Made by vergence " (env!("CARGO_PKG_VERSION")) ". This page is complete in itself and fetches nothing." }
                }
            }
        }
    };
    Ok(page.into_string())
}

fn how_to_read() -> Markup {
    html! {
        details.card {
            summary { "How to read this page" }
            p {
                "Scores are those of DIIVINE (Moorthy and Bovik 2011): about 0 for the best pictures to about 100 for the worst. They are not clamped and can \
                 leave that range. A score knows nothing of what the picture shows, only how natural its statistics are."
            }
            p {
                "A gauge has three zones. Good ends at the first number, bad begins at the second; both are magnitudes in the unit beside the value, and come \
                 from the source that is named. Each zone is even within itself; the zones have one width whatever their numbers. The mark is the measured \
                 value, the bar across it one standard deviation to each side. A value counts as beyond a limit only when noise alone would hardly take it there."
            }
            p {
                "Disparity is where a point lies in the left picture minus where it lies in the right one, in pixels. Horizontally + is in front of the screen; \
                 vertically + means that the right eye's point is higher. Parallax on the screen has the other sign: minus is in front."
            }
        }
    }
}
