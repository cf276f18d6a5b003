//! Proves of what the page is made from: each film has a time line of its own, and the heading counts all items, those of an earlier call
//! among them. The records are made up.

use super::*;
use crate::grade::record::{PictureGrade, SequenceGrade, score_entry};
use crate::grade::results::Finished;
use crate::model::store;

fn collected(several: bool) -> Collected {
    let grader = Grader {
        model: store::load(store::DEFAULT).unwrap(),
        viewer: Viewer::default(),
        screen_width_m: 0.5,
        crosstalk: 0.02,
        rig: None,
        features: false,
    };
    Collected::new("films", &grader, several)
}

fn done(item: &str, time_s: Option<f64>, place: Place, kind: &'static str, grade: Grade) -> Done {
    Done::Graded(Box::new(Graded {
        record: Record {
            item: item.to_owned(),
            kind,
            files: Vec::new(),
            time_s,
            remarks: Vec::new(),
            model: "default".to_owned(),
            grade,
            resume: None,
        },
        place,
        shown: None,
    }))
}

fn picture(score: f64) -> Grade {
    let scored = Scored {
        score,
        class_probabilities: std::collections::BTreeMap::new(),
        regression_scores: std::collections::BTreeMap::new(),
        features: None,
    };
    let entry = score_entry(&scored, "the picture");
    Grade::Picture(Box::new(PictureGrade {
        size_px: [640, 480],
        scored,
        verdict: entry.verdict,
        verdicts: vec![entry],
    }))
}

fn frame(film: &str, time_s: f64, score: f64) -> Done {
    let name = format!("{film} at {time_s:.3} s");
    let place = Place::Frame(None);
    done(&name, Some(time_s), place, "picture", picture(score))
}

/// The end of a film with a cut at this time, and one judged cause where it has a word.
fn end(film: &str, cut_s: f64, word: Option<VerdictWord>) -> Done {
    let entry = word.map(|verdict| VerdictEntry {
        cause: "time_offset".to_owned(),
        value: 1.0,
        sigma: None,
        unit: "frames",
        look: 0.2,
        bad: 0.5,
        source: "made up",
        verdict,
        meaning: "one eye is late".to_owned(),
    });
    let whole = SequenceGrade {
        layout: None,
        frames: 0,
        pairs: 0,
        frames_per_second: Some(10.0),
        score: None,
        time_offset_frames: None,
        time_offset: Value::Null,
        cuts: vec![serde_json::json!({"pair": 1, "time_s": cut_s})],
        more_cuts: 0,
        verdict: word,
        verdicts: entry.into_iter().collect(),
        not_judged: std::collections::BTreeMap::new(),
    };
    let grade = Grade::Sequence(Box::new(whole));
    done(film, None, Place::Whole, "sequence", grade)
}

fn broke_off(film: &str) -> Done {
    let error = "its data break off".to_owned();
    done(film, None, Place::Whole, "failed", Grade::Failed { error })
}

fn finish(several: bool, all: Vec<Done>) -> ReportData {
    let mut page = collected(several);
    for mut one in all {
        page.take(&mut one);
    }
    page.finish()
}

fn earlier(verdict: VerdictWord, place: Place, name: &str) -> Done {
    Done::Finished(Finished::of(verdict), place, name.to_owned())
}

/// Two films, the first of which breaks off, a picture between them, one more film that cannot be opened: a line for each film with its
/// own frames, cuts and causes; what is no frame in a line before them.
#[test]
fn each_film_has_a_line_of_its_own() {
    let data = finish(
        true,
        vec![
            frame("a.mkv", 0.0, 10.0),
            frame("a.mkv", 1.0, 20.0),
            broke_off("a.mkv"),
            done("still.jpg", None, Place::Item, "picture", picture(12.0)),
            frame("b.mkv", 0.0, 30.0),
            frame("b.mkv", 2.0, 60.0),
            end("b.mkv", 1.5, Some(VerdictWord::Look)),
            broke_off("c.mp4"),
            frame("d.mkv", 0.0, 5.0),
        ],
    );
    #[expect(clippy::type_complexity, reason = "a table to compare with")]
    let told: Vec<(&str, &str, Vec<f64>, Vec<f64>, usize)> = (data.time_lines.iter())
        .map(|l| {
            let places = l.items.iter().map(|i| i.at).collect();
            (
                l.name.as_str(),
                l.axis.as_str(),
                places,
                l.cuts.clone(),
                l.whole.len(),
            )
        })
        .collect();
    assert_eq!(
        told,
        [
            ("", "item", vec![1.0, 2.0], vec![], 0),
            ("a.mkv", "time / s", vec![0.0, 1.0, 1.0], vec![], 0),
            ("b.mkv", "time / s", vec![0.0, 2.0], vec![1.5], 1),
            // Interrupted.
            ("d.mkv", "time / s", vec![0.0], vec![], 0),
        ]
    );
    let ordered: Vec<bool> = data.time_lines.iter().map(|l| l.ordered).collect();
    assert_eq!(ordered, [false, true, true, true]);
    let page = super::super::page::html(&data).unwrap();
    for part in [
        "Sequence: a.mkv",
        "Sequence: b.mkv",
        "The sequence as a whole: b.mkv",
        "8 items: ",
    ] {
        assert!(page.contains(part), "{part} is missing");
    }
    // No id stands for two things.
    let mut ids: Vec<&str> = page.split(" id=\"").skip(1).collect();
    ids.iter_mut()
        .for_each(|id| *id = id.split('"').next().unwrap());
    let count = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), count);
}

/// What an earlier call finished is not drawn, but its verdict counts: of frames, of a film as a whole, and of a single item.
#[test]
fn the_heading_counts_what_an_earlier_call_finished() {
    let frame_place = Place::Frame(None);
    let data = finish(
        true,
        vec![
            earlier(VerdictWord::Bad, frame_place, "a.mkv at 0.000 s"),
            earlier(VerdictWord::Good, frame_place, "a.mkv at 1.000 s"),
            frame("a.mkv", 2.0, 20.0),
            end("a.mkv", 1.5, None),
        ],
    );
    assert_eq!(data.verdict, Some(Verdict::Bad));
    let counts = Counts {
        items: 3,
        good: 2,
        look: 0,
        bad: 1,
    };
    assert_eq!(data.counts, Some(counts));
    assert_eq!(data.time_lines[0].items.len(), 1);
    assert!(data.remarks[0].contains("2 items") && data.remarks[0].contains("bad"));

    let whole = earlier(VerdictWord::Look, Place::Whole, "a.mkv");
    let data = finish(true, vec![whole, frame("b.mkv", 0.0, 20.0)]);
    assert_eq!(data.verdict, Some(Verdict::Look));
    assert_eq!(data.counts.map(|c| c.items), Some(1));
    let single = earlier(VerdictWord::Bad, Place::Item, "a.jpg");
    assert_eq!(finish(false, vec![single]).verdict, Some(Verdict::Bad));
}

/// Of very many films the worst are drawn, in their order, and the rest is counted.
#[test]
fn of_many_films_the_worst_are_drawn() {
    let films = 2 * MOST_LINES;
    let all = (0..films).flat_map(|i| {
        let score = if i == 40 || i == 30 { 90.0 } else { 10.0 };
        let name = format!("{i}.mkv");
        [frame(&name, 0.0, score), end(&name, 0.5, None)]
    });
    let data = finish(true, all.collect());
    let names: Vec<&str> = data.time_lines.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names.len(), MOST_LINES);
    assert_eq!(names[MOST_LINES - 3..], ["21.mkv", "30.mkv", "40.mkv"]);
    assert!(data.remarks.iter().any(|r| r.contains("24 more sequences")));
    assert_eq!(data.counts.map(|c| c.items), Some(films));
}
