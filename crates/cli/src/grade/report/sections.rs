//! The parts of the page.

use maud::{Markup, html};
use vergence_quality::DISTORTIONS;
use vergence_stereo::faults::Verdict;

use super::figures;
use super::gauge::{Gauge, short, word};
use super::pictures::{self, DIFFERENCE_GAIN, Embedded};
use super::{Counts, Judged, NamedScore, Pictures, ReportData, TimeItem, TimeLine};

/// Rows of the table of items before the rest is left out.
const MOST_ROWS: usize = 60;

/// Causes that are named at the top.
const MOST_LEADING: usize = 4;

/// Longest text of an item or a reason, characters.
const MOST_CHARS: usize = 300;

/// A verdict as a badge: a sign, a word and a colour.
fn badge(verdict: Verdict) -> Markup {
    let sign = match verdict {
        Verdict::Good => "\u{2713}",
        Verdict::Look => "!",
        Verdict::Bad => "\u{2717}",
    };
    html! {
        span class=(format!("badge {}", word(verdict))) { span.sign aria-hidden="true" { (sign) } (word(verdict)) }
    }
}

/// A score as it is told: one decimal, a true minus sign.
fn tenths(score: f64) -> String {
    crate::figure::axis::fixed(score, 1)
}

fn cut(text: &str) -> String {
    let mut out: String = text.chars().take(MOST_CHARS).collect();
    if out.len() < text.len() {
        out.push('\u{2026}');
    }
    out
}

/// Title, verdict, what stands out, facts and remarks.
pub(super) fn heading(data: &ReportData) -> Markup {
    let several = data.counts;
    let counts = several.unwrap_or_else(|| {
        let mut causes = Counts::default();
        let judged = data.quality.iter().chain(&data.causes);
        judged.for_each(|c| causes.take(Some(c.verdict)));
        causes
    });
    html! {
        p.kicker { "vergence grade" }
        h1 { (cut(&data.title)) }
        div.verdict {
            @match data.verdict {
                Some(verdict) => {
                    (badge(verdict))
                    @if several.is_some() || !data.causes.is_empty() {
                        span.counts {
                            @if several.is_some() { (counts.items) " items: " } @else { "measured: " }
                            (counts.good) " good, " (counts.look) " worth a look, " (counts.bad) " bad"
                        }
                    }
                },
                None => span.badge.none { "not judged" },
            }
        }
        // What stands out is said of one item; of several the line says it.
        @if several.is_none() { (lead(data)) (facts(&[&data.facts, &data.item_facts])) (remarks(&data.item_remarks)) }
        @else { (facts(&[&data.facts])) }
        (remarks(&data.remarks))
    }
}

/// What the score means, and the causes that are as bad as the whole.
fn lead(data: &ReportData) -> Markup {
    let worst: Vec<&Judged> = (data.causes.iter())
        .filter(|c| Some(c.verdict) == data.verdict && c.verdict != Verdict::Good)
        .collect();
    html! {
        @if let Some(quality) = &data.quality {
            p.lead { (cut(&sentence(&quality.meaning))) ": score " strong { (tenths(quality.value)) } " (0 best \u{2026} 100 worst)." }
        }
        @if !worst.is_empty() {
            p.lead {
                @for (i, cause) in worst.iter().take(MOST_LEADING).enumerate() {
                    @if i > 0 { "; " }
                    (cause.name) " " strong { (short(cause.value)) "\u{a0}" (cause.unit) }
                }
                @if worst.len() > MOST_LEADING { "; and " (worst.len() - MOST_LEADING) " more" }
                "."
            }
        }
    }
}

/// With a capital letter.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first: String = letters
        .next()
        .into_iter()
        .flat_map(char::to_uppercase)
        .collect();
    first + letters.as_str()
}

/// Of several items the one that is shown: its name, facts and remarks.
pub(super) fn worst_item(data: &ReportData) -> Markup {
    html! {
        @if let Some(name) = &data.worst_item {
            h2.item { "The worst item: " (cut(name)) }
            (facts(&[&data.item_facts]))
            (remarks(&data.item_remarks))
        }
    }
}

fn facts(groups: &[&Vec<(String, String)>]) -> Markup {
    let all: Vec<&(String, String)> = groups.iter().copied().flatten().collect();
    html! {
        @if !all.is_empty() {
            dl.facts {
                @for (name, text) in all { div { dt { (name) } dd { (cut(text)) } } }
            }
        }
    }
}

fn remarks(remarks: &[String]) -> Markup {
    html! { @for remark in remarks { p.remark { (cut(remark)) } } }
}

fn img(picture: &Embedded, alt: &str) -> Markup {
    html! { img src=(picture.uri) width=(picture.size.0) height=(picture.size.1) alt=(alt); }
}

/// The pictures; of a pair in four views, chosen without any script.
pub(super) fn pictures(shown: &Pictures) -> anyhow::Result<Markup> {
    Ok(match shown {
        Pictures::None => html! {},
        Pictures::One(picture) => html! {
            section.card {
                h2 { "Picture" }
                figure.one { (img(&pictures::embedded(picture)?, "the graded picture")) }
            }
        },
        Pictures::Pair { left, right } => {
            let views = pictures::pair_views(left, right)?;
            pair(&views)
        }
    })
}

fn pair(views: &pictures::PairViews) -> Markup {
    let tabs = [
        ("both", "Side by side"),
        ("glasses", "Red\u{2013}cyan"),
        ("blink", "Blink"),
        ("differ", "Difference"),
    ];
    let left = "the left eye's picture";
    let right = "the right eye's picture";
    html! {
        section.card.pair aria-label="Pair" {
            h2 { "Pair" }
            @for (i, (id, name)) in tabs.into_iter().enumerate() {
                input.tab type="radio" name="view" id=(format!("view-{id}")) checked[i == 0];
                label for=(format!("view-{id}")) { (name) }
            }
            div.view.both {
                figure { (img(&views.left, left)) figcaption { "left" } }
                figure { (img(&views.right, right)) figcaption { "right" } }
            }
            div.view.glasses {
                figure { (img(&views.anaglyph, "both pictures as an anaglyph")) figcaption { "For red\u{2013}cyan glasses, red before the left eye (Dubois 2001)" } }
            }
            div.view.blink {
                figure {
                    div.stacked { (img(&views.left, left)) (img(&views.right, right)) }
                    figcaption { "Left and right in turn: what jumps up and down is vertical disparity. Stands still where less motion is asked for." }
                }
            }
            div.view.differ {
                figure { (img(&views.difference, "left minus right picture")) figcaption { "Left minus right brightness, " (DIFFERENCE_GAIN) " times, around middle grey" } }
            }
        }
    }
}

/// The scores with their gauges and what distortion they are like.
pub(super) fn scores(scores: &[NamedScore]) -> Markup {
    if scores.is_empty() {
        return html! {};
    }
    html! {
        section.card aria-label="Quality" {
            h2 { "Quality" }
            p.direction { "Score of DIIVINE: 0 best \u{2026} 100 worst" }
            table.scores {
                thead { tr { th scope="col" { "Picture" } th scope="col" { "Score" } th scope="col" { "0 best \u{2026} 100 worst" } th scope="col" { "Most like" } } }
                tbody {
                    @for named in scores { (score_row(named)) }
                }
            }
            p.legend aria-hidden="true" {
                @for class in DISTORTIONS { span { span class=(format!("swatch class-{}", class.id())) {} (class.name()) } }
            }
        }
    }
}

fn score_row(named: &NamedScore) -> Markup {
    let score = match &named.score {
        Ok(score) => score,
        Err(why) => {
            return html! {
                tr { th scope="row" { (named.name) } td data-label="Score" { "\u{2013}" } td.why colspan="2" { (cut(why)) } }
            };
        }
    };
    let likeliest = (DISTORTIONS.iter().zip(score.class_probabilities))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(class, p)| format!("{} ({:.0} %)", class.name(), 100.0 * p));
    let verdict = named.limits.map(|[look, bad]| match score.score {
        s if s <= look => Verdict::Good,
        s if s <= bad => Verdict::Look,
        _ => Verdict::Bad,
    });
    html! {
        tr {
            th scope="row" { (named.name) }
            td.value data-label="Score" { strong { (tenths(score.score)) } @if let Some(v) = verdict { " " (badge(v)) } }
            td.meter data-label="0 best \u{2026} 100 worst" {
                @if let (Some([look, bad]), Some(verdict)) = (named.limits, verdict) {
                    (Gauge { name: &named.name, value: score.score.max(0.0), sigma: None, look, bad, unit: "of 100", verdict, ends: ["best", "worst"] }.draw())
                }
            }
            td.classes data-label="Most like" {
                @if let Some(text) = likeliest { span { (text) } }
                div.classes-bar role="img" aria-label=(classes_text(score)) {
                    @for (class, p) in DISTORTIONS.iter().zip(score.class_probabilities) {
                        span class=(format!("class-{}", class.id())) style=(format!("width:{:.1}%", 100.0 * p.clamp(0.0, 1.0))) title=(format!("{} {:.0} %", class.name(), 100.0 * p)) {}
                    }
                }
            }
        }
    }
}

fn classes_text(score: &vergence_quality::Score) -> String {
    let each = DISTORTIONS.iter().zip(score.class_probabilities);
    each.map(|(class, p)| format!("{} {:.0} %", class.name(), 100.0 * p))
        .collect::<Vec<_>>()
        .join(", ")
}

/// The causes with value, gauge, verdict, meaning and limits; the worst first. `id` keeps the notes of two tables apart.
pub(super) fn causes(heading: &str, id: &str, causes: &[Judged]) -> Markup {
    if causes.is_empty() {
        return html! {};
    }
    let mut sorted: Vec<&Judged> = causes.iter().collect();
    sorted.sort_by_key(|c| std::cmp::Reverse(c.verdict));
    let mut sources: Vec<&str> = Vec::new();
    for cause in &sorted {
        if !sources.contains(&cause.source.as_str()) {
            sources.push(&cause.source);
        }
    }
    let note = |c: &Judged| 1 + sources.iter().position(|s| *s == c.source).unwrap_or(0);
    html! {
        section.card aria-label=(heading) {
            h2 { (heading) }
            table.causes {
                thead { tr {
                    th scope="col" { "Cause" } th scope="col" { "Value" } th scope="col" { "good | look | bad" }
                    th scope="col" { "Meaning" } th scope="col" { "Limits" }
                } }
                tbody { @for cause in &sorted { (cause_row(cause, id, note(cause))) } }
            }
            p.direction { "Where the limits come from:" }
            ol.sources { @for (i, source) in sources.iter().enumerate() { li id=(format!("{id}-{}", i + 1)) { (cut(source)) } } }
        }
    }
}

fn cause_row(c: &Judged, id: &str, note: usize) -> Markup {
    let gauge = Gauge {
        name: &c.name,
        value: c.value,
        sigma: c.sigma,
        look: c.look,
        bad: c.bad,
        unit: &c.unit,
        verdict: c.verdict,
        ends: ["0", &c.unit],
    };
    html! {
        tr {
            th scope="row" { (c.name) " " (badge(c.verdict)) }
            td.value data-label="Value" {
                strong { (short(c.value)) "\u{a0}" (c.unit) }
                @if let Some(sigma) = c.sigma.filter(|s| s.is_finite() && *s > 0.0) { span.sigma { " \u{b1}\u{a0}" (short(sigma)) } }
            }
            td.meter data-label="good | look | bad" { (gauge.draw()) }
            td.meaning data-label="Meaning" { (cut(&c.meaning)) }
            td.source data-label="Limits" {
                "good up to " (short(c.look)) ", bad beyond " (short(c.bad)) "\u{a0}" (c.unit) " "
                a.note href=(format!("#{id}-{note}")) aria-label=(format!("source {note}")) { "[" (note) "]" }
            }
        }
    }
}

/// Vertical disparity over the picture, histogram of parallax, window.
pub(super) fn plots(data: &ReportData, backdrop: Option<&Embedded>) -> Markup {
    html! {
        @if data.vertical.is_some() || data.parallax.is_some() || !data.window.is_empty() {
            div.plots {
                @if let Some(map) = &data.vertical {
                    section.card aria-label="Vertical disparity" {
                        h2 { "Vertical disparity" }
                        (figures::vertical_map(&map.samples, map.size_px, backdrop, "Vertical disparity, pixels"))
                        @if !map.residuals.is_empty() {
                            details {
                                summary { "What remains after the fit" }
                                (figures::vertical_map(&map.residuals, map.size_px, backdrop, "Vertical disparity that offset, roll, zoom and keystone do not explain, pixels"))
                            }
                        }
                    }
                }
                @if let Some(samples) = &data.parallax {
                    section.card aria-label="Horizontal parallax" {
                        h2 { "Horizontal parallax" }
                        (figures::parallax_histogram(samples))
                    }
                }
                @if !data.window.is_empty() { (window(data)) }
            }
        }
    }
}

fn window(data: &ReportData) -> Markup {
    html! {
        section.card.broad aria-label="Window" {
            h2 { "Window" }
            div.edges {
            figure.frame { (figures::window_frame(&data.window)) }
            table.window {
                thead { tr { th scope="col" { "Edge" } th scope="col" { "Touched" } th scope="col" { "Nearest" } th scope="col" { "Mask" } } }
                tbody {
                    @for strip in &data.window {
                        tr {
                            th scope="row" { (strip.edge.name()) }
                            td data-label="Touched" { (format!("{:.0}", 100.0 * strip.share)) " % of the edge" }
                            td data-label="Nearest" { (short(strip.nearest_percent)) " % of the width in front" }
                            td data-label="Mask" { @if strip.mask_px > 0.0 { (short(strip.mask_px)) " px" } @else { "none" } }
                        }
                    }
                }
            }
            }
            p.direction { "Things in front of the screen that an edge cuts; 0 % best. At the sides a floating window (the mask) repairs it." }
        }
    }
}

/// Every line, each with what is said of the sequence as a whole.
pub(super) fn time_lines(data: &ReportData) -> Markup {
    let named = data.time_lines.len() > 1;
    html! {
        @for (i, line) in data.time_lines.iter().enumerate() {
            @let name = if named { line.name.as_str() } else { "" };
            (time_line(line, name, i))
            (causes(&of("The sequence as a whole", name), &format!("whole-{i}"), &line.whole))
        }
    }
}

/// A heading, of something where it has a name.
fn of(heading: &str, name: &str) -> String {
    match name {
        "" => heading.to_owned(),
        _ => format!("{heading}: {}", cut(name)),
    }
}

/// Score and measures along a sequence, with the items that are worst; `number` keeps the drawings of several apart.
fn time_line(line: &TimeLine, name: &str, number: usize) -> Markup {
    if line.items.is_empty() {
        return html! {};
    }
    let rank = |item: &&TimeItem| {
        let score = item.score.filter(|s| s.is_finite()).unwrap_or(f64::MIN);
        (
            std::cmp::Reverse(item.failure.is_some()),
            std::cmp::Reverse(item.verdict),
            (-1e6 * score) as i64,
        )
    };
    let mut rows: Vec<&TimeItem> = line.items.iter().collect();
    rows.sort_by_key(rank);
    rows.truncate(MOST_ROWS);
    let heading = of(if line.ordered { "Sequence" } else { "Items" }, name);
    let failed = line.items.iter().filter(|i| i.failure.is_some()).count();
    html! {
        section.card aria-label=(heading) {
            h2 { (heading) }
            p.direction {
                (line.items.len()) " items"
                @if failed > 0 { ", " (failed) " of them not graded" }
                "; scores 0 best \u{2026} 100 worst"
                @if !line.cuts.is_empty() { "; dashed: " (line.cuts.len()) @if line.cuts.len() == 1 { " cut" } @else { " cuts" } }
            }
            (figures::time_line(line, number))
            details open[rows.len() <= 12] {
                summary { @if rows.len() < line.items.len() { "The " (rows.len()) " worst items" } @else { "All items, the worst first" } }
                table.items {
                    thead { tr { th scope="col" { "Item" } th scope="col" { (line.axis) } th scope="col" { "Score" } th scope="col" { "Verdict" } } }
                    tbody {
                        @for item in rows {
                            tr {
                                th scope="row" { (cut(&item.name)) }
                                td data-label=(line.axis) { (short(item.at)) }
                                @match &item.failure {
                                    Some(why) => td.why colspan="2" data-label="Not graded" { (cut(why)) },
                                    None => {
                                        td data-label="Score" { @if let Some(s) = item.score { (tenths(s)) } @else { "\u{2013}" } }
                                        td data-label="Verdict" { @if let Some(v) = item.verdict { (badge(v)) } @else { "not judged" } }
                                    },
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// What could not be measured.
pub(super) fn not_judged(entries: &[(String, String)]) -> Markup {
    html! {
        @if !entries.is_empty() {
            section.card aria-label="Not judged" {
                h2 { "Not judged" }
                dl.facts {
                    @for (what, why) in entries.iter().take(MOST_ROWS) {
                        div { dt { (cut(what)) } dd { (cut(why)) } }
                    }
                }
            }
        }
    }
}
