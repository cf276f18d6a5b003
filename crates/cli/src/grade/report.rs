//! The report of a grading: one HTML page that needs nothing but itself.
//!
//! No script, no font, no picture comes from elsewhere, and the page forbids its browser to fetch anything. Pictures are reduced
//! and embedded; drawings are SVG whose colours follow the light or dark scheme. Everything from outside (names, reasons) is escaped.

mod collect;
mod figures;
mod gauge;
mod page;
mod pictures;
mod sections;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use vergence_geometry::comfort::Viewing;
use vergence_imaging::Rgb;
use vergence_imaging::files::write_whole;
use vergence_quality::Score;
use vergence_stereo::faults::Verdict;

use crate::fault;

pub(super) use collect::Collected;

/// Name of the page in its folder.
pub(crate) const PAGE: &str = "index.html";

/// What a report shows. What is empty or `None` is left out of the page.
#[derive(Clone, Debug)]
pub(crate) struct ReportData {
    /// Heading: what was graded.
    pub(crate) title: String,
    /// Facts of the call below it: model, screen; name and text.
    pub(crate) facts: Vec<(String, String)>,
    /// What one should know of the call.
    pub(crate) remarks: Vec<String>,
    /// Facts of the item whose pictures are shown: size, layout.
    pub(crate) item_facts: Vec<(String, String)>,
    /// What one should know of how that item was read.
    pub(crate) item_remarks: Vec<String>,
    /// The worst verdict; `None` when it could not be judged.
    pub(crate) verdict: Option<Verdict>,
    /// The pictures.
    pub(crate) pictures: Pictures,
    /// Scores by the quality index.
    pub(crate) scores: Vec<NamedScore>,
    /// The verdict on the item's score (of a pair the worse eye's).
    pub(crate) quality: Option<Judged>,
    /// Causes, each with its limits and verdict.
    pub(crate) causes: Vec<Judged>,
    /// What could not be measured, and why.
    pub(crate) not_judged: Vec<(String, String)>,
    /// Vertical disparity over the left picture.
    pub(crate) vertical: Option<VerticalMap>,
    /// Horizontal parallax over the picture.
    pub(crate) parallax: Option<ParallaxSamples>,
    /// What touches the edges.
    pub(crate) window: Vec<WindowStrip>,
    /// Of a line of items, the one of which pictures, scores and causes are shown.
    pub(crate) worst_item: Option<String>,
    /// Of several items: how many have which verdict, those of earlier calls among them.
    pub(crate) counts: Option<Counts>,
    /// A folder or a list in its order, and each sequence by itself.
    pub(crate) time_lines: Vec<TimeLine>,
}

impl ReportData {
    /// A report with nothing but its heading.
    pub(crate) fn new(title: &str) -> Self {
        Self {
            title: title.to_owned(),
            facts: Vec::new(),
            remarks: Vec::new(),
            item_facts: Vec::new(),
            item_remarks: Vec::new(),
            verdict: None,
            pictures: Pictures::None,
            scores: Vec::new(),
            quality: None,
            causes: Vec::new(),
            not_judged: Vec::new(),
            vertical: None,
            parallax: None,
            window: Vec::new(),
            worst_item: None,
            counts: None,
            time_lines: Vec::new(),
        }
    }
}

/// The graded pictures in their own size; the page holds reduced ones.
#[derive(Clone, Debug)]
pub(crate) enum Pictures {
    /// None is shown.
    None,
    /// One picture.
    One(Rgb),
    /// Both eyes' pictures, of one size.
    Pair {
        /// The left eye's.
        left: Rgb,
        /// The right eye's.
        right: Rgb,
    },
}

/// What the index says of one picture.
#[derive(Clone, Debug)]
pub(crate) struct NamedScore {
    /// "left", "right", "difference", "worse eye", "fused".
    pub(crate) name: String,
    /// The score, or a sentence why there is none.
    pub(crate) score: Result<Score, String>,
    /// Good up to `look`, bad beyond `bad`; `None` where the number has no limits (a difference is no picture).
    pub(crate) limits: Option<[f64; 2]>,
}

/// One judged cause.
#[derive(Clone, Debug)]
pub(crate) struct Judged {
    /// As people read it: "Vertical offset".
    pub(crate) name: String,
    /// The value in `unit`.
    pub(crate) value: f64,
    /// Its standard deviation, where it is known.
    pub(crate) sigma: Option<f64>,
    /// Unit: `px`, `deg`, `%`.
    pub(crate) unit: String,
    /// Magnitude up to which it is good.
    pub(crate) look: f64,
    /// Magnitude beyond which it is bad.
    pub(crate) bad: f64,
    /// Where the limits come from.
    pub(crate) source: String,
    /// The verdict.
    pub(crate) verdict: Verdict,
    /// What it means and what to do.
    pub(crate) meaning: String,
}

/// `keystone_toe_in` as "Keystone toe in".
fn readable(id: &str) -> String {
    let text = id.replace('_', " ");
    let mut letters = text.chars();
    let first = letters.next().map(|c| c.to_ascii_uppercase());
    first.into_iter().chain(letters).collect()
}

/// Vertical disparity at matched points.
#[derive(Clone, Debug)]
pub(crate) struct VerticalMap {
    /// Width and height of the left picture, pixels.
    pub(crate) size_px: [usize; 2],
    /// x, y in the left picture and `v_l - v_r` (down), pixels.
    pub(crate) samples: Vec<[f64; 3]>,
    /// The same after all that the fit explains; empty when there is no fit.
    pub(crate) residuals: Vec<[f64; 3]>,
}

/// Horizontal parallax at matched points.
#[derive(Clone, Debug)]
pub(crate) struct ParallaxSamples {
    /// Percent of the picture's width, < 0 in front.
    pub(crate) percent: Vec<f64>,
    /// Screen and viewer.
    pub(crate) viewing: Viewing,
}

/// What touches one edge of the picture.
#[derive(Clone, Debug)]
pub(crate) struct WindowStrip {
    /// Which.
    pub(crate) edge: Edge,
    /// Share of its length that things in front of the screen touch, 0 to 1.
    pub(crate) share: f64,
    /// How far in front the nearest is, percent of the width, >= 0.
    pub(crate) nearest_percent: f64,
    /// Width of the mask that repairs it, pixels; 0 for none.
    pub(crate) mask_px: f64,
}

/// An edge of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Edge {
    Left,
    Right,
    Top,
    Bottom,
}

impl Edge {
    fn name(self) -> &'static str {
        match self {
            Edge::Left => "left",
            Edge::Right => "right",
            Edge::Top => "top",
            Edge::Bottom => "bottom",
        }
    }
}

/// How many items there are, and how many of each verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// All, judged or not.
    pub(crate) items: usize,
    pub(crate) good: usize,
    pub(crate) look: usize,
    pub(crate) bad: usize,
}

impl Counts {
    fn take(&mut self, verdict: Option<Verdict>) {
        self.items += 1;
        match verdict {
            Some(Verdict::Good) => self.good += 1,
            Some(Verdict::Look) => self.look += 1,
            Some(Verdict::Bad) => self.bad += 1,
            None => {}
        }
    }
}

/// Items in their order.
#[derive(Clone, Debug)]
pub(crate) struct TimeLine {
    /// Of a sequence, what the call named; empty for items by themselves.
    pub(crate) name: String,
    /// What runs along it: "time / s" or "item".
    pub(crate) axis: String,
    /// The order means something (time): the items are joined by lines.
    pub(crate) ordered: bool,
    /// The measures beside the score, each a panel: name with unit ("vertical offset / px").
    pub(crate) measures: Vec<String>,
    /// The items by rising place.
    pub(crate) items: Vec<TimeItem>,
    /// Scores are good up to the first and bad beyond the second.
    pub(crate) limits: [f64; 2],
    /// Places of cuts.
    pub(crate) cuts: Vec<f64>,
    /// Causes of the sequence as a whole.
    pub(crate) whole: Vec<Judged>,
}

impl TimeLine {
    /// The worst of its items and of the whole.
    fn verdict(&self) -> Option<Verdict> {
        let items = self.items.iter().filter_map(|i| i.verdict);
        items.chain(self.whole.iter().map(|w| w.verdict)).max()
    }
}

/// One item of a time line.
#[derive(Clone, Debug)]
pub(crate) struct TimeItem {
    /// Its place on the axis.
    pub(crate) at: f64,
    /// Its name.
    pub(crate) name: String,
    /// Its score (of a pair the worse eye's).
    pub(crate) score: Option<f64>,
    /// Its verdict.
    pub(crate) verdict: Option<Verdict>,
    /// The measures in the order of [`TimeLine::measures`].
    pub(crate) measures: Vec<Option<f64>>,
    /// Why it was not graded.
    pub(crate) failure: Option<String>,
}

/// Write `DIR/index.html`, whole or not at all; the folder is made when it is not there. Gives its path.
pub(crate) fn write_report(dir: &Path, data: &ReportData) -> anyhow::Result<PathBuf> {
    let page = page::html(data)?;
    let path = dir.join(PAGE);
    fs::create_dir_all(dir)
        .map_err(|e| fault::failed(format!("cannot make the folder {}: {e}", dir.display())))?;
    write_whole(&path, page.as_bytes())
        .map_err(|e| fault::failed(format!("cannot write {}: {e}", path.display())))?;
    Ok(path)
}
