//! Results for people: a page for one item, a line each for many.

use std::fmt::Write as _;

use vergence_quality::DISTORTIONS;

use super::record::{
    Grade, PairGrade, PictureGrade, Record, Scored, SequenceGrade, VerdictEntry, VerdictWord,
};

/// Said wherever a score stands.
const SCALE: &str = "0 best … 100 worst";

/// Everything about one item.
pub(super) fn page(record: &Record) -> String {
    let mut text = String::new();
    let _ = match &record.grade {
        Grade::Picture(p) => picture(&mut text, record, p),
        Grade::Pair(p) => pair(&mut text, record, p),
        Grade::Sequence(s) => sequence(&mut text, record, s),
        Grade::Failed { error } => writeln!(text, "{}: {error}", record.item),
    };
    text
}

fn picture(text: &mut String, record: &Record, p: &PictureGrade) -> std::fmt::Result {
    let [w, h] = p.size_px;
    writeln!(text, "{}: one picture of {w} x {h} px", record.item)?;
    remarks(text, record)?;
    let entry = &p.verdicts[0];
    writeln!(
        text,
        "\nQuality: {:.1} ({SCALE}; DIIVINE, model {}): {}\n  {}",
        p.scored.score,
        record.model,
        said(entry.verdict),
        entry.meaning
    )?;
    classes(text, &p.scored)?;
    features(text, &p.scored)
}

fn classes(text: &mut String, scored: &Scored) -> std::fmt::Result {
    writeln!(
        text,
        "\n  {:<16}{:>12}{:>20}",
        "distortion", "probability", "score if it is that"
    )?;
    for distortion in DISTORTIONS {
        let of = |map: &std::collections::BTreeMap<&str, f64>| map.get(distortion.id()).copied();
        writeln!(
            text,
            "  {:<16}{:>10.1} %{:>20.1}",
            distortion.name(),
            100.0 * of(&scored.class_probabilities).unwrap_or(f64::NAN),
            of(&scored.regression_scores).unwrap_or(f64::NAN)
        )?;
    }
    Ok(())
}

fn features(text: &mut String, scored: &Scored) -> std::fmt::Result {
    let Some(features) = &scored.features else {
        return Ok(());
    };
    writeln!(text, "\n  The 88 features:")?;
    for (row, values) in features.chunks(4).enumerate() {
        let cells = values.iter().enumerate();
        let line: String = cells
            .map(|(i, v)| format!("  f{:<3}{v:>15.8e}", 4 * row + i + 1))
            .collect();
        writeln!(text, "{line}")?;
    }
    Ok(())
}

fn pair(text: &mut String, record: &Record, p: &PairGrade) -> std::fmt::Result {
    let [w, h] = p.size_px;
    writeln!(text, "{}: a pair of {w} x {h} px an eye", record.item)?;
    writeln!(text, "  layout: {} ({})", p.layout.name, p.layout.reason)?;
    remarks(text, record)?;
    writeln!(text, "\nQuality ({SCALE}; DIIVINE, model {})", record.model)?;
    let score = |s: &Option<Scored>| {
        s.as_ref()
            .map_or("–".to_owned(), |s| format!("{:.1}", s.score))
    };
    let worse = p.worse.as_ref().map_or("–", |worse| worse.eye);
    writeln!(
        text,
        "  left {}, right {} (worse: {worse}), |difference| {}, fused {}",
        score(&p.left),
        score(&p.right),
        score(&p.difference),
        score(&p.fused)
    )?;
    verdicts(text, &p.verdicts)?;
    if let Some(advice) = p
        .measures
        .get("vertical")
        .and_then(|v| v.pointer("/correction/advice"))
    {
        let advice = advice.as_str().unwrap_or_default();
        if !advice.is_empty() {
            writeln!(text, "\nTo do at the rig: {advice}")?;
        }
    }
    not_judged(text, &p.not_judged)?;
    for (eye, scored) in [("left", &p.left), ("right", &p.right)] {
        if let Some(scored) = scored.as_ref().filter(|s| s.features.is_some()) {
            write!(text, "\n{eye} eye")?;
            features(text, scored)?;
        }
    }
    match p.verdict {
        Some(verdict) => writeln!(text, "\nVerdict: {}", said(verdict)),
        None => writeln!(text, "\nVerdict: none, the pair could not be judged"),
    }
}

fn sequence(text: &mut String, record: &Record, s: &SequenceGrade) -> std::fmt::Result {
    writeln!(
        text,
        "\n{}: the sequence as a whole, {} frames graded",
        record.item, s.frames
    )?;
    if let Some(layout) = &s.layout {
        writeln!(text, "  layout: {} ({})", layout.name, layout.reason)?;
    }
    remarks(text, record)?;
    if let Some(spread) = &s.score {
        writeln!(
            text,
            "  score ({SCALE}): mean {:.1}, best {:.1}, worst {:.1}",
            spread.mean, spread.best, spread.worst
        )?;
    }
    cuts(text, s)?;
    verdicts(text, &s.verdicts)?;
    not_judged(text, &s.not_judged)?;
    match s.verdict {
        Some(verdict) => writeln!(
            text,
            "\nVerdict: {} (the worst of the frames and of what is said here)\n",
            said(verdict)
        ),
        None => writeln!(text, "\nVerdict: none, no frame could be judged\n"),
    }
}

/// Most cuts that are told one by one.
const MOST_CUTS: usize = 12;

fn cuts(text: &mut String, s: &SequenceGrade) -> std::fmt::Result {
    let count = s.cuts.len() + s.more_cuts;
    if count == 0 {
        return Ok(());
    }
    let at = |cut: &serde_json::Value| match (cut["time_s"].as_f64(), cut["pair"].as_u64()) {
        (Some(time), _) => format!("{time:.2} s"),
        (None, frame) => format!("number {}", frame.unwrap_or(0) + 1),
    };
    let named: Vec<String> = s.cuts.iter().take(MOST_CUTS).map(at).collect();
    let more = if count > named.len() { " ..." } else { "" };
    writeln!(text, "  cuts: {count}, at {}{more}", named.join(", "))
}

fn verdicts(text: &mut String, verdicts: &[VerdictEntry]) -> std::fmt::Result {
    if verdicts.is_empty() {
        return Ok(());
    }
    let cells: Vec<[String; 3]> = verdicts.iter().map(cells).collect();
    let head = ["cause", "value", "good to / bad from"];
    let width = |column: usize| {
        let widths = cells.iter().map(|row| row[column].chars().count());
        widths.max().unwrap_or(0).max(head[column].len())
    };
    let (a, b, c) = (width(0), width(1), width(2));
    writeln!(
        text,
        "\n  {:<a$}  {:>b$}   {:<c$}  verdict",
        head[0], head[1], head[2]
    )?;
    for (v, [cause, value, limits]) in verdicts.iter().zip(&cells) {
        let verdict = said(v.verdict);
        writeln!(text, "  {cause:<a$}  {value:>b$}   {limits:<c$}  {verdict}")?;
        writeln!(text, "      {}", v.meaning)?;
    }
    Ok(())
}

/// Cause, value and limits as the table shows them.
fn cells(v: &VerdictEntry) -> [String; 3] {
    let unit = v.unit.split(',').next().unwrap_or_default();
    [
        v.cause.replace('_', " "),
        format!("{} {unit}", number(v.value)),
        format!("{} / {} {unit}", number(v.look), number(v.bad)),
    ]
}

fn not_judged(
    text: &mut String,
    reasons: &std::collections::BTreeMap<String, String>,
) -> std::fmt::Result {
    if reasons.is_empty() {
        return Ok(());
    }
    writeln!(text, "\nNot judged")?;
    // One reason often concerns several measures.
    let mut told: Vec<&str> = Vec::new();
    for reason in reasons.values() {
        if told.contains(&reason.as_str()) {
            continue;
        }
        told.push(reason);
        let names = reasons.iter().filter(|(_, r)| *r == reason);
        let names: Vec<String> = names.map(|(name, _)| name.replace('_', " ")).collect();
        writeln!(text, "  {}: {reason}", names.join(", "))?;
    }
    Ok(())
}

fn remarks(text: &mut String, record: &Record) -> std::fmt::Result {
    for remark in &record.remarks {
        writeln!(text, "  note: {remark}")?;
    }
    Ok(())
}

/// Three significant digits or so; what rounds to nothing has no sign.
fn number(value: f64) -> String {
    let digits = match value.abs() {
        v if v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        v if v >= 1.0 || v == 0.0 => 2,
        _ => 3,
    };
    let text = format!("{value:.digits$}");
    if text
        .trim_start_matches('-')
        .chars()
        .all(|c| matches!(c, '0' | '.'))
    {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    }
}

/// A verdict as it stands in tables: one sees the bad ones without colour.
fn said(verdict: VerdictWord) -> &'static str {
    match verdict {
        VerdictWord::Good => "good",
        VerdictWord::Look => "LOOK",
        VerdictWord::Bad => "BAD",
    }
}

/// What the lines of [`row`] mean.
pub(super) fn header(model: &str) -> String {
    format!(
        "Scores: {SCALE} (DIIVINE, model {model}); of pairs the worse eye's.\n{:>7}  {:<8}item\n",
        "score", "verdict"
    )
}

/// An error that ends with the path of an item whose name stands before it already.
pub(super) fn without_path<'a>(error: &'a str, item: &str) -> &'a str {
    let shorter = error.strip_suffix(item).and_then(|e| e.strip_suffix(": "));
    shorter.unwrap_or(error)
}

/// One line for one of many items.
pub(super) fn row(record: &Record) -> String {
    let score = record.score().map_or("–".to_owned(), |s| format!("{s:.1}"));
    let verdict = record.verdict().map_or("–", said);
    let worst: Vec<&VerdictEntry> = record
        .verdicts()
        .iter()
        .filter(|v| v.verdict > VerdictWord::Good && Some(v.verdict) == record.verdict())
        .collect();
    let mut line = format!("{score:>7}  {verdict:<8}{}", record.item);
    if let Grade::Failed { error } = &record.grade {
        let error = without_path(error, &record.item);
        let _ = write!(line, ": {error}");
    } else if let Some(why) = record.failure() {
        let _ = write!(line, ": not judged: {why}");
    } else if !worst.is_empty() {
        let causes: Vec<String> = worst.iter().map(|v| v.cause.replace('_', " ")).collect();
        let _ = write!(line, " ({})", causes.join(", "));
    }
    line.push('\n');
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path is told once; what does not end with it stays.
    #[test]
    fn a_path_is_told_once() {
        assert_eq!(
            without_path("it breaks off: in/a.png", "in/a.png"),
            "it breaks off"
        );
        assert_eq!(
            without_path("it breaks off: in/b.png", "in/a.png"),
            "it breaks off: in/b.png"
        );
        assert_eq!(without_path("in/a.png", "in/a.png"), "in/a.png");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(number(123.456), "123");
        assert_eq!(number(-12.345), "-12.3");
        assert_eq!(number(0.01234), "0.012");
        assert_eq!(number(-0.0001), "0.000");
    }
}
