//! What a film tells before it is graded: how long it is, and how its frames hold two eyes.

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;
use vergence_capture::{CaptureError, Frames, OnFault};
use vergence_imaging::stereo_file::{Found, Halves, Order, Packing, StereoTag};

use super::layout::{self, Layout, LayoutChoice};
use super::names;

/// The program that decodes films.
pub(super) const FFMPEG: &str = "ffmpeg";

/// The program that comes with it and reads their containers.
const FFPROBE: &str = "ffprobe";

/// Frames that are asked for their layout: a film often begins in black, and one frame may mislead.
const VOTES: usize = 3;

/// Frames from one that is asked to the next, and how many are decoded at most.
const VOTE_EVERY: usize = 12;
const VOTE_FRAMES: usize = 360;

/// What a film's container says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Container {
    /// Length in seconds, where it is known.
    pub(super) duration_s: Option<f64>,
    tag: Option<Tag>,
}

/// The container's word on two eyes in a frame.
#[derive(Clone, Debug, PartialEq)]
struct Tag {
    /// As `ffprobe` calls it: "side by side".
    kind: String,
    right_first: bool,
}

impl Container {
    /// Of a film that can be opened. What cannot be asked is unknown.
    pub(super) fn of(path: &Path) -> Self {
        // An address could keep it waiting.
        if names::is_address(path) {
            return Self::default();
        }
        let mut file = std::ffi::OsString::from("file:");
        file.push(path);
        let asked = Command::new(FFPROBE)
            .args(["-v", "error", "-select_streams", "v:0", "-show_entries"])
            .arg("format=duration:stream=index:stream_side_data_list")
            .args(["-of", "json"])
            .arg(file)
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .output();
        let answer = asked.ok().filter(|a| a.status.success());
        let answer = answer.and_then(|a| serde_json::from_slice(&a.stdout).ok());
        answer.map_or_else(Self::default, |value| Self::from_answer(&value))
    }

    fn from_answer(answer: &Value) -> Self {
        let duration = answer.pointer("/format/duration").and_then(Value::as_str);
        let duration = duration.and_then(|text| text.parse().ok());
        let data = answer.pointer("/streams/0/side_data_list");
        let mut data = data.and_then(Value::as_array).into_iter().flatten();
        let tag = data.find_map(|entry| {
            let kind = entry.get("type")?.as_str()?;
            let inverted = entry.get("inverted").and_then(Value::as_i64);
            (entry.get("side_data_type")?.as_str()? == "Stereo 3D").then(|| Tag {
                kind: kind.to_owned(),
                right_first: inverted == Some(1),
            })
        });
        Self {
            duration_s: duration.filter(|d: &f64| d.is_finite() && *d > 0.0),
            tag,
        }
    }

    /// The tag for frames of this size. Containers do not say whether halves are squeezed; their shape does.
    fn found(&self, size: (usize, usize)) -> Option<Found> {
        let tag = self.tag.as_ref()?;
        let packed = |halves| {
            StereoTag::Packed(Packing {
                halves,
                order: if tag.right_first {
                    Order::RightFirst
                } else {
                    Order::LeftFirst
                },
                squeezed: layout::looks_squeezed(size, halves),
                gap_px: 0,
            })
        };
        let tag = match tag.kind.as_str() {
            "2D" => StereoTag::Mono,
            "side by side" => packed(Halves::SideBySide),
            "top and bottom" => packed(Halves::OverUnder),
            "frame alternate" => StereoTag::NotRead("the eyes in alternate frames"),
            "checkerboard" => StereoTag::NotRead("a checkerboard of both eyes"),
            "interleaved lines" => StereoTag::NotRead("rows of both eyes interleaved"),
            "interleaved columns" => StereoTag::NotRead("columns of both eyes interleaved"),
            "side by side (quincunx subsampling)" => StereoTag::NotRead("halves in quincunx"),
            _ => return None,
        };
        Some(Found {
            tag,
            place: "container (stereo mode)",
        })
    }
}

/// How the frames of a film hold two eyes: as typed, as its container says, else what most of a few frames show that are not plain.
///
/// # Errors
/// When the film cannot be read, and where its container says that it holds two eyes in a way that is not read.
pub(super) fn layout_of(
    path: &Path,
    container: &Container,
    choice: LayoutChoice,
) -> Result<Layout, String> {
    let mut frames = open(path).map_err(|e| said_once(&e, path))?;
    let mut votes: Vec<Layout> = Vec::new();
    for index in 0..VOTE_FRAMES {
        let next = frames.next_frame().map_err(|e| said_once(&e, path))?;
        let Some(frame) = next else {
            break;
        };
        if index == 0 {
            let tag = container.found(frame.picture.size());
            let told = layout::without_content(path, tag.as_ref(), choice);
            if let Some(layout) = told.map_err(|e| format!("{e}: {}", path.display()))? {
                return Ok(layout);
            }
        }
        if index.is_multiple_of(VOTE_EVERY) {
            votes.extend(layout::by_content(&frame.picture, path));
        }
        if votes.len() == VOTES {
            break;
        }
        frames.recycle(frame.picture);
    }
    Ok(most_named(&votes))
}

/// The layout that most name, of equals the one that was named first.
fn most_named(votes: &[Layout]) -> Layout {
    let count = |of: &Layout| votes.iter().filter(|v| v.packing == of.packing).count();
    let most = votes.iter().map(count).max().unwrap_or(0);
    let chosen = votes.iter().find(|v| count(v) == most).cloned();
    chosen.unwrap_or_else(|| Layout {
        packing: None,
        reason: "no tag, and its first frames are too plain to tell by their content".to_owned(),
        guessed: true,
    })
}

/// An error without the path that the decoder puts before its own words: the path stands at the end already.
pub(super) fn said_once(error: &CaptureError, path: &Path) -> String {
    let said = error.to_string();
    said.replacen(&format!("file:{}: ", path.display()), "", 1)
}

/// Start decoding a film.
pub(super) fn open(path: &Path) -> Result<Frames, CaptureError> {
    Frames::open(path, Path::new(FFMPEG), OnFault::Refuse)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// What `ffprobe` answers is understood: length, kind and order; other side data and other answers are not.
    #[test]
    fn containers_are_understood() {
        let of = |kind: &str, inverted: i64| {
            Container::from_answer(&json!({
                "streams": [{"side_data_list": [
                    {"side_data_type": "Display Matrix", "rotation": 0},
                    {"side_data_type": "Stereo 3D", "type": kind, "inverted": inverted},
                ]}],
                "format": {"duration": "4.500000"},
            }))
        };
        let packing = |container: &Container, size| match container.found(size).map(|f| f.tag) {
            Some(StereoTag::Packed(p)) => Some((p.halves, p.order, p.squeezed)),
            _ => None,
        };
        let beside = of("side by side", 1);
        assert_eq!(beside.duration_s, Some(4.5));
        let expected = (Halves::SideBySide, Order::RightFirst, true);
        assert_eq!(packing(&beside, (1920, 1080)), Some(expected));
        assert_eq!(
            packing(&of("top and bottom", 0), (1920, 2160)),
            Some((Halves::OverUnder, Order::LeftFirst, false))
        );
        let mono = of("2D", 0).found((640, 480)).map(|f| f.tag);
        assert_eq!(mono, Some(StereoTag::Mono));
        let lines = of("interleaved lines", 0).found((640, 480)).map(|f| f.tag);
        assert!(matches!(lines, Some(StereoTag::NotRead(_))));
        assert_eq!(of("unspecified", 0).found((640, 480)), None);
        assert_eq!(Container::from_answer(&json!([])), Container::default());
    }

    /// One odd frame does not decide; of equals the first does; no frame that tells is one picture.
    #[test]
    fn the_most_named_layout_wins() {
        let vote = |reason: &str, halves| Layout {
            packing: halves,
            reason: reason.to_owned(),
            guessed: true,
        };
        let beside = Some(Packing {
            halves: Halves::SideBySide,
            order: Order::LeftFirst,
            squeezed: false,
            gap_px: 0,
        });
        let chosen = most_named(&[vote("a", None), vote("b", beside), vote("c", beside)]);
        assert_eq!(chosen.reason, "b");
        assert_eq!(
            most_named(&[vote("a", None), vote("b", beside)]).reason,
            "a"
        );
        assert_eq!(most_named(&[]).packing, None);
    }
}
