//! From results as they are told to what the page shows: of one item everything; of several their line, and everything of the worst.

use std::cmp::Ordering;

use serde_json::Value;
use vergence_geometry::comfort::Viewing;
use vergence_geometry::viewing::Viewer;
use vergence_quality::{DISTORTIONS, Score};
use vergence_stereo::faults::{PairFaults, Verdict};

use super::{
    Counts, Edge, Judged, NamedScore, ParallaxSamples, Pictures, ReportData, TimeItem, TimeLine,
    VerticalMap, WindowStrip, readable,
};
use crate::grade::batch::{Done, Graded, Shown};
use crate::grade::feed::Place;
use crate::grade::grader::Grader;
use crate::grade::read;
use crate::grade::record::{Grade, PairGrade, Record, SCORE, Scored, VerdictEntry, VerdictWord};

/// Causes that are drawn along a line of items.
const DRAWN: [&str; 3] = ["vertical_offset", "parallax_near", "parallax_far"];

/// Most items of all lines; what comes later is counted.
const MOST_ITEMS: usize = 500_000;

/// Most lines of the page; of more sequences the worst are drawn.
const MOST_LINES: usize = 24;

/// What the page will show.
pub(in crate::grade) struct Collected {
    title: String,
    facts: Vec<(String, String)>,
    viewer: Viewer,
    screen_width_m: f64,
    several: bool,
    /// Items that are no frames, in one line.
    items: Line,
    /// The sequence of which frames come.
    running: Line,
    /// Sequences that were heard to their end.
    lines: Vec<Line>,
    /// Items of all lines.
    shown: usize,
    /// Of all items, those of earlier calls among them.
    counts: Counts,
    /// Of all items and sequences, the same.
    verdict: Option<VerdictWord>,
    worst: Option<ReportData>,
    worst_rank: (Option<VerdictWord>, f64),
    finished: usize,
    /// The worst of what an earlier call had finished.
    finished_verdict: Option<VerdictWord>,
    left_out: usize,
}

/// Items in their order: those of one sequence, or all that are no frames.
#[derive(Default)]
struct Line {
    name: String,
    items: Vec<TimeItem>,
    /// Name with unit of each of [`DRAWN`], once one was seen.
    measures: [Option<String>; 3],
    timed: bool,
    ordered: bool,
    cuts: Vec<f64>,
    /// The verdicts on the sequence as a whole.
    whole: Vec<Judged>,
}

impl Collected {
    /// `title`: what was graded, in the words of the call; `several`: whether there may be more than one item.
    pub(in crate::grade) fn new(title: &str, grader: &Grader, several: bool) -> Self {
        let screen = format!(
            "{:.0} cm wide, seen from {:.2} m",
            100.0 * grader.screen_width_m,
            grader.viewer.distance_m
        );
        Self {
            title: title.to_owned(),
            facts: vec![
                ("Model".to_owned(), grader.model.name.clone()),
                ("Screen".to_owned(), screen),
            ],
            viewer: grader.viewer,
            screen_width_m: grader.screen_width_m,
            several,
            items: Line::default(),
            running: Line::default(),
            lines: Vec::new(),
            shown: 0,
            counts: Counts::default(),
            verdict: None,
            worst: None,
            worst_rank: (None, f64::NEG_INFINITY),
            finished: 0,
            finished_verdict: None,
            left_out: 0,
        }
    }

    /// One more was done.
    pub(in crate::grade) fn take(&mut self, done: &mut Done) {
        match done {
            Done::Finished(finished, place, name) => {
                self.finished += 1;
                self.finished_verdict = self.finished_verdict.max(finished.verdict);
                self.count(*place, finished.verdict);
                if *place == Place::Whole {
                    self.end_line(name);
                }
            }
            Done::Graded(graded) => self.graded(graded),
        }
    }

    fn count(&mut self, place: Place, word: Option<VerdictWord>) {
        self.verdict = self.verdict.max(word);
        if place != Place::Whole {
            self.counts.take(word.map(verdict));
        }
    }

    fn graded(&mut self, graded: &mut Graded) {
        let shown = graded.shown.take();
        let (record, place) = (&graded.record, graded.place);
        let failed = matches!(record.grade, Grade::Failed { .. });
        // A film that broke off is an item that failed.
        let counted = if failed { Place::Item } else { place };
        self.count(counted, record.verdict());
        if let Grade::Sequence(sequence) = &record.grade {
            self.running.whole = sequence.verdicts.iter().map(judged).collect();
            let cuts = sequence.cuts.iter().filter_map(place_of_cut);
            self.running.cuts = cuts.collect();
            return self.end_line(&record.item);
        }
        if self.several {
            self.line_up(record, place);
        }
        if place == Place::Whole {
            self.end_line(&record.item);
        }
        let rank = (
            record.verdict(),
            record.score().unwrap_or(f64::NEG_INFINITY),
        );
        let worse = match rank.0.cmp(&self.worst_rank.0) {
            Ordering::Equal => rank.1 > self.worst_rank.1,
            order => order == Ordering::Greater,
        };
        if self.worst.is_none() || worse {
            self.worst_rank = rank;
            self.worst = Some(self.page_of(record, shown));
        }
    }

    /// The sequence of this name has no more frames.
    fn end_line(&mut self, name: &str) {
        let mut line = std::mem::take(&mut self.running);
        if line.is_shown() {
            name.clone_into(&mut line.name);
            line.ordered = true;
            self.lines.push(line);
        }
    }

    fn line_up(&mut self, record: &Record, place: Place) {
        if self.shown == MOST_ITEMS {
            self.left_out += 1;
            return;
        }
        self.shown += 1;
        let line = match place {
            Place::Item => &mut self.items,
            Place::Frame(_) => &mut self.running,
            // It ended early: after its last frame, or it never began.
            Place::Whole if self.running.items.is_empty() => &mut self.items,
            Place::Whole => &mut self.running,
        };
        line.take(record);
    }

    /// Everything of one item.
    fn page_of(&self, record: &Record, shown: Option<Shown>) -> ReportData {
        let mut data = ReportData::new(&record.item);
        data.facts.clone_from(&self.facts);
        data.item_remarks.clone_from(&record.remarks);
        data.verdict = record.verdict().map(verdict);
        // The score's own verdict stands beside the score.
        let (quality, causes): (Vec<_>, Vec<_>) =
            record.verdicts().iter().partition(|v| v.cause == "quality");
        data.quality = quality.first().map(|v| judged(v));
        data.causes = causes.into_iter().map(judged).collect();
        match &record.grade {
            Grade::Picture(picture) => {
                let [w, h] = picture.size_px;
                data.item_facts
                    .push(("Size".to_owned(), format!("{w} \u{d7} {h} px")));
                data.scores = vec![named("picture", Ok(&picture.scored), true)];
            }
            Grade::Pair(pair) => fill_pair(&mut data, pair),
            Grade::Failed { error } => data.not_judged = vec![("item".to_owned(), error.clone())],
            Grade::Sequence(_) => {}
        }
        let Some(Shown { content, faults }) = shown else {
            return data;
        };
        if let (Some(faults), Grade::Pair(pair)) = (&faults, &record.grade) {
            let viewing = Viewing {
                viewer: self.viewer,
                screen_width_m: self.screen_width_m,
                width_px: pair.size_px[0],
            };
            fill_points(&mut data, faults, viewing);
        }
        data.pictures = match content.pictures {
            read::Pictures::One(picture) => Pictures::One(picture),
            read::Pictures::Two { eyes, .. } => {
                let [left, right] = eyes;
                Pictures::Pair { left, right }
            }
        };
        data
    }

    /// All that was collected.
    pub(in crate::grade) fn finish(mut self) -> ReportData {
        // An interrupted sequence has no end; a frame of a film knows its name.
        let name = self.running.name_by_frames();
        self.end_line(&name);
        let mut data = self.worst.take().unwrap_or_else(|| {
            let mut nothing = ReportData::new(&self.title);
            nothing.facts.clone_from(&self.facts);
            nothing
        });
        data.verdict = self.verdict.map(verdict);
        if self.finished > 0 {
            let worst = self.finished_verdict.map_or(String::new(), |v| {
                format!("; the worst of them: {}", v.word())
            });
            data.remarks.push(format!(
                "{} items that an earlier call had finished are counted and not shown{worst}",
                self.finished
            ));
        }
        if self.left_out > 0 {
            data.remarks
                .push(format!("the last {} items are not drawn", self.left_out));
        }
        if !self.several {
            return data;
        }
        data.counts = Some(self.counts);
        data.worst_item = Some(std::mem::replace(&mut data.title, self.title));
        let all = std::iter::once(self.items).chain(self.lines);
        data.time_lines = all.filter(Line::is_shown).map(Line::finish).collect();
        let more = only_the_worst(&mut data.time_lines);
        if more > 0 {
            data.remarks.push(format!(
                "{more} more sequences are not drawn: the {MOST_LINES} worst are"
            ));
        }
        data
    }
}

/// Takes lines away until they are few enough, the mildest first; how many went.
fn only_the_worst(lines: &mut Vec<TimeLine>) -> usize {
    let more = lines.len().saturating_sub(MOST_LINES);
    if more > 0 {
        let mut ranks: Vec<usize> = (0..lines.len()).collect();
        ranks.sort_by_key(|&i| std::cmp::Reverse(lines[i].verdict()));
        let mut kept = vec![false; lines.len()];
        ranks[..MOST_LINES].iter().for_each(|&i| kept[i] = true);
        let mut kept = kept.into_iter();
        lines.retain(|_| kept.next().unwrap_or(false));
    }
    more
}

impl Line {
    fn is_shown(&self) -> bool {
        !self.items.is_empty() || !self.whole.is_empty()
    }

    fn take(&mut self, record: &Record) {
        let mut measures = Vec::new();
        for (cause, name) in DRAWN.iter().zip(&mut self.measures) {
            let found = record.verdicts().iter().find(|v| v.cause == *cause);
            if let Some(entry) = found {
                name.get_or_insert_with(|| format!("{} / {}", readable(cause), entry.unit));
            }
            measures.push(found.map(|v| v.value));
        }
        self.timed |= record.time_s.is_some();
        // What has no time among frames that have one is told where it happened.
        let next = match self.items.last() {
            Some(last) if self.timed => last.at,
            _ => self.items.len() as f64 + 1.0,
        };
        self.items.push(TimeItem {
            at: record.time_s.unwrap_or(next),
            name: record.item.clone(),
            score: record.score(),
            verdict: record.verdict().map(verdict),
            measures,
            failure: record.failure().map(str::to_owned),
        });
    }

    /// The film's name, where its frames are named by it and their times.
    fn name_by_frames(&self) -> String {
        let of = |item: &TimeItem| Some(item.name.rsplit_once(" at ")?.0.to_owned());
        let first = self.items.first().filter(|_| self.timed);
        first.and_then(of).unwrap_or_default()
    }

    fn finish(self) -> TimeLine {
        let known: Vec<usize> = (0..DRAWN.len())
            .filter(|m| self.measures[*m].is_some())
            .collect();
        let mut items = self.items;
        for item in &mut items {
            item.measures = known.iter().map(|m| item.measures[*m]).collect();
        }
        if self.timed {
            items.sort_by(|a, b| a.at.total_cmp(&b.at));
        }
        TimeLine {
            name: self.name,
            axis: if self.timed { "time / s" } else { "item" }.to_owned(),
            ordered: self.ordered,
            measures: self.measures.into_iter().flatten().collect(),
            limits: [SCORE.look, SCORE.bad],
            items,
            cuts: self.cuts,
            whole: self.whole,
        }
    }
}

/// Where the time line shows a cut: at its time, or half an item before the first one after it.
fn place_of_cut(cut: &Value) -> Option<f64> {
    let time_s = cut.get("time_s").and_then(Value::as_f64);
    time_s.or_else(|| Some(cut.get("pair")?.as_f64()? + 0.5))
}

fn verdict(word: VerdictWord) -> Verdict {
    match word {
        VerdictWord::Good => Verdict::Good,
        VerdictWord::Look => Verdict::Look,
        VerdictWord::Bad => Verdict::Bad,
    }
}

fn judged(entry: &VerdictEntry) -> Judged {
    Judged {
        name: readable(&entry.cause),
        value: entry.value,
        sigma: entry.sigma,
        unit: entry.unit.to_owned(),
        look: entry.look,
        bad: entry.bad,
        source: entry.source.to_owned(),
        verdict: verdict(entry.verdict),
        meaning: entry.meaning.clone(),
    }
}

fn named(name: &str, scored: Result<&Scored, String>, limited: bool) -> NamedScore {
    let of = |map: &std::collections::BTreeMap<&str, f64>| {
        DISTORTIONS.map(|d| map.get(d.id()).copied().unwrap_or(0.0))
    };
    NamedScore {
        name: name.to_owned(),
        score: scored.map(|s| Score {
            score: s.score,
            class_probabilities: of(&s.class_probabilities),
            regression_scores: of(&s.regression_scores),
        }),
        limits: limited.then_some([SCORE.look, SCORE.bad]),
    }
}

fn fill_pair(data: &mut ReportData, pair: &PairGrade) {
    let [w, h] = pair.size_px;
    data.item_facts
        .push(("Size".to_owned(), format!("{w} \u{d7} {h} px each")));
    let layout = format!("{} ({})", pair.layout.name, pair.layout.reason);
    data.item_facts.push(("Layout".to_owned(), layout));
    for (name, scored) in [
        ("left", &pair.left),
        ("right", &pair.right),
        ("fused", &pair.fused),
        ("difference", &pair.difference),
    ] {
        let why = || {
            let why = pair.not_judged.get(name);
            why.cloned().unwrap_or_else(|| "not measured".to_owned())
        };
        let worse = pair.worse.as_ref().is_some_and(|w| w.eye == name);
        let shown = if worse {
            format!("{name} (worse eye)")
        } else {
            name.to_owned()
        };
        let scored = scored.as_ref().ok_or_else(why);
        // A difference is no picture that anybody looks at.
        data.scores
            .push(named(&shown, scored, name != "difference"));
    }
    let scores = ["left", "right", "fused", "difference"];
    let others = pair
        .not_judged
        .iter()
        .filter(|(what, _)| !scores.contains(&what.as_str()));
    data.not_judged = others
        .map(|(what, why)| (readable(what), why.clone()))
        .collect();
    if let Some(window) = pair.measures.get("window_violation") {
        data.window = strips(window);
    }
}

/// The edges from their group of fields.
fn strips(window: &Value) -> Vec<WindowStrip> {
    let edges = [
        (Edge::Left, Some("mask_left_of_left_px")),
        (Edge::Right, Some("mask_right_of_right_px")),
        (Edge::Top, None),
        (Edge::Bottom, None),
    ];
    let strip = |(edge, mask): (Edge, Option<&str>)| {
        let of = |field: &str| window.get(edge.name())?.get(field)?.as_f64();
        Some(WindowStrip {
            edge,
            share: of("share")?,
            nearest_percent: of("nearest_percent").unwrap_or(0.0),
            mask_px: mask.and_then(|m| window.get(m)?.as_f64()).unwrap_or(0.0),
        })
    };
    edges.into_iter().filter_map(strip).collect()
}

/// What is drawn of the matched points.
fn fill_points(data: &mut ReportData, faults: &PairFaults, viewing: Viewing) {
    let (w, h) = faults.size;
    let points = &faults.matches.points;
    let at = |dy: &dyn Fn([f64; 2], [f64; 2]) -> f64| {
        let sample = |p: &vergence_stereo::faults::PointMatch| {
            let (l, r) = ([p.left_px.x, p.left_px.y], [p.right_px.x, p.right_px.y]);
            [l[0], l[1], dy(l, r)]
        };
        points.iter().map(sample).collect()
    };
    data.vertical = Some(VerticalMap {
        size_px: [w, h],
        samples: at(&|l, r| l[1] - r[1]),
        residuals: at(&|l, r| faults.alignment.model.residual_px(l, r)),
    });
    let percent = |p: &vergence_stereo::faults::PointMatch| {
        100.0 * (p.right_px.x - p.left_px.x) / w.max(1) as f64
    };
    data.parallax = Some(ParallaxSamples {
        percent: points.iter().map(percent).collect(),
        viewing,
    });
}

#[cfg(test)]
mod tests;
