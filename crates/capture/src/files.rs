//! Recorded stereo: two folders of pictures or two videos.

mod frames;
mod list;
pub(crate) mod stream;
pub(crate) mod video;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use vergence_calib::RigCalibration;
use vergence_geometry::Eye;
use vergence_imaging::Rgb;

use crate::CaptureError;
pub use crate::files::frames::{Frames, TimedFrame};
use crate::files::list::PictureList;
use crate::files::stream::EyeStream;
use crate::files::video::Video;
use crate::pairing::{Paired, Pairer, PairingCounts, PairingLimits};
use crate::secrets::shown;
use crate::source::{Frame, Source, SourceInfo, StereoFrame};

/// Frames per second of pictures when nothing else is said.
pub const DEFAULT_FPS: f64 = 30.0;

/// Highest frame rate that is believed, 1/s.
pub const MAX_FPS: f64 = 10_000.0;

/// So many frames more on one side when the other has ended are no longer the end of one recording.
const GOES_ON_AFTER: usize = 3;

/// What to do about a fault in the input that could be passed over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnFault {
    /// Stop with an error that names the file.
    #[default]
    Refuse,
    /// Drop the pair and count it.
    Skip,
}

/// Where recorded stereo comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FilesConfig {
    /// The left pictures: a folder, one picture, a pattern with `*` in its last part (`frames/left_*.jpg`), a video file or
    /// a URL that `ffmpeg` reads.
    pub left: PathBuf,
    /// The right pictures, likewise.
    pub right: PathBuf,
    /// Frames per second, 0 < fps <= [`MAX_FPS`]. A picture whose name holds the number n (the last one in the name) was taken
    /// n / fps seconds after the start; when `None`, the rate of the video beside them or else [`DEFAULT_FPS`]. A video knows
    /// its own rate, and a value that contradicts it is an error.
    pub fps: Option<f64>,
    /// What to do with a picture whose number the other side does not have.
    pub unpaired: OnFault,
    /// What to do with a picture that cannot be decoded. Of a damaged video file, `Skip` takes what `ffmpeg` can make of it, as
    /// is always done with a URL; `Refuse` makes anything that `ffmpeg` complains about an error.
    pub unreadable: OnFault,
    /// The program `ffmpeg`; `ffprobe` is looked for beside it. Only videos need them.
    pub ffmpeg: PathBuf,
}

impl Default for FilesConfig {
    fn default() -> Self {
        Self {
            left: PathBuf::new(),
            right: PathBuf::new(),
            fps: None,
            unpaired: OnFault::Refuse,
            unreadable: OnFault::Refuse,
            ffmpeg: PathBuf::from("ffmpeg"),
        }
    }
}

/// A [`Source`] of recorded stereo; the cameras do not move.
///
/// Left and right are decoded ahead, each by a thread of its own, and paired by time. What can be checked is checked before
/// the first pair is passed: that every picture has its partner, that all have one size (from their headers), that
/// the calibration fits it. `arrival_s` of a frame is its `capture_s`: a recording does not say what came between. The pairs
/// end with the shorter of two videos, and [`FilesSource::remarks`] says so.
#[derive(Debug)]
pub struct FilesSource {
    info: SourceInfo,
    calibration: RigCalibration,
    streams: [EyeStream; 2],
    /// `None` in place of a picture that could not be read.
    pairer: Pairer<Option<Rgb>>,
    /// Pairs that were not passed since one of their pictures could not be read.
    unreadable_pairs: u64,
    remarks: Vec<String>,
    passed: u64,
    ended: bool,
}

enum Input {
    Pictures(PictureList),
    Video(Video),
}

impl FilesSource {
    /// Open both inputs and check them against each other and against the calibration, which is scaled to the size of
    /// the pictures where that has the calibrated proportions.
    ///
    /// # Errors
    /// Every fault named at [`FilesSource`], each as one sentence that names the file.
    pub fn open(config: &FilesConfig, calibration: &RigCalibration) -> Result<Self, CaptureError> {
        if config.left == config.right {
            return Err(CaptureError::Unequal(format!(
                "both are {}; where one folder holds both, patterns such as left_*.jpg and right_*.jpg tell them apart",
                shown(&config.left)
            )));
        }
        if let Some(fps) = config.fps
            && !(fps > 0.0 && fps <= MAX_FPS)
        {
            return Err(CaptureError::Setting {
                name: "fps",
                value: fps.to_string(),
                right: "it must lie above 0 and at most at 10000",
            });
        }
        let mut left = Input::find(&config.left, config)?;
        let mut right = Input::find(&config.right, config)?;
        let mut remarks = calibration.notes.clone();
        let mut pairs = None;
        match (&mut left, &mut right) {
            (Input::Pictures(l), Input::Pictures(r)) => {
                // Two pictures that were named one by one belong together, whatever their numbers.
                if l.is_single() && r.is_single() {
                    l.count_from_zero();
                    r.count_from_zero();
                }
                let count = l.match_with(r, config.unpaired)?;
                if config.fps.is_none() && count > 1 {
                    remarks.push(format!(
                        "the pictures do not say how fast they were taken: {DEFAULT_FPS} a second are assumed, and every speed \
                         depends on it"
                    ));
                }
                pairs = Some(count as u64);
            }
            (Input::Pictures(list), Input::Video(video))
            | (Input::Video(video), Input::Pictures(list)) => list.fps = video.fps(),
            (Input::Video(_), Input::Video(_)) => {}
        }
        let fps = left.fps().max(right.fps());
        let mut streams = [left.open(config)?, right.open(config)?];
        let size = common_size(&mut streams)?;
        let calibration = calibration.scaled_to([size; 2])?;
        let info = SourceInfo {
            name: format!("files {} and {}", shown(&config.left), shown(&config.right)),
            cameras: calibration.cameras,
            fixed_base_from_cam: Some(calibration.base_from_cam),
            fps,
            pairs,
        };
        Ok(Self {
            info,
            calibration,
            streams,
            pairer: Pairer::new(PairingLimits::for_fps(fps))?,
            unreadable_pairs: 0,
            remarks,
            passed: 0,
            ended: false,
        })
    }

    /// The calibration, scaled to the pictures.
    pub fn calibration(&self) -> &RigCalibration {
        &self.calibration
    }

    /// What became of the frames so far.
    pub fn counts(&self) -> &PairingCounts {
        self.pairer.counts()
    }

    /// What the user should know and may not expect: the calibration's notes, a frame rate that was assumed, and, once the pairs
    /// have ended, that one input goes on when the other has ended.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// Say so when the stream beside the one that ended goes on.
    fn remark_on_the_end(&mut self) {
        let Some(ended) = self.pairer.wants() else {
            return;
        };
        let other = match ended {
            Eye::Left => Eye::Right,
            Eye::Right => Eye::Left,
        };
        // What waits for a partner counts; a fault of the rest is not one of the pairs.
        let mut more = self.pairer.waiting();
        while more < GOES_ON_AFTER {
            match self.streams[usize::from(other == Eye::Right)].next() {
                Ok(Some(_)) => more += 1,
                Ok(None) | Err(_) => return,
            }
        }
        let stream = |eye: Eye| self.streams[usize::from(eye == Eye::Right)].path();
        self.remarks.push(format!(
            "{} ended after {} pairs and {} goes on: the rest has no partner",
            stream(ended).display(),
            self.passed,
            stream(other).display()
        ));
    }

    /// Ask the stream that has nothing waiting for its next frame; `false` when it has ended.
    fn pull(&mut self) -> Result<bool, CaptureError> {
        let Some(eye) = self.pairer.wants() else {
            return Ok(true);
        };
        match self.streams[usize::from(eye == Eye::Right)].next()? {
            Some(timed) => {
                self.pairer.push(eye, timed.time_s, timed.picture);
                Ok(true)
            }
            None => Ok(false),
        }
    }

    fn pair(&mut self, p: Paired<Option<Rgb>>) -> Option<StereoFrame> {
        let (Some(left), Some(right)) = (p.left, p.right) else {
            self.unreadable_pairs += 1;
            return None;
        };
        let frame = |picture, time_s| Frame {
            picture,
            capture_s: time_s,
            arrival_s: time_s,
        };
        let index = self.passed;
        self.passed += 1;
        Some(StereoFrame {
            index,
            left: frame(left, p.left_s),
            right: frame(right, p.right_s),
        })
    }

    fn next_or_fault(&mut self) -> Result<Option<StereoFrame>, CaptureError> {
        loop {
            while let Some(paired) = self.pairer.pop() {
                if let Some(pair) = self.pair(paired) {
                    return Ok(Some(pair));
                }
            }
            if !self.pull()? {
                self.remark_on_the_end();
                return Ok(None);
            }
        }
    }
}

impl Source for FilesSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_pair(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> Result<Option<StereoFrame>, CaptureError> {
        if self.ended {
            return Ok(None);
        }
        if let Some(old) = reuse {
            self.streams[0].recycle(old.left.picture);
            self.streams[1].recycle(old.right.picture);
        }
        let next = self.next_or_fault();
        if !matches!(next, Ok(Some(_))) {
            self.ended = true;
            self.pairer.finish();
        }
        next
    }

    fn dropped_pairs(&self) -> u64 {
        self.pairer.counts().lost_pairs + self.unreadable_pairs
    }
}

impl Input {
    fn find(path: &Path, config: &FilesConfig) -> Result<Self, CaptureError> {
        if path.as_os_str().is_empty() {
            return Err(CaptureError::Input {
                reason: "an input is missing: both a left and a right one must be named".to_owned(),
                path: path.to_owned(),
            });
        }
        match PictureList::find(path, config.fps.unwrap_or(DEFAULT_FPS), config.unreadable)? {
            Some(list) => Ok(Input::Pictures(list)),
            None => Video::probe(path, &config.ffmpeg, config.fps).map(Input::Video),
        }
    }

    fn fps(&self) -> f64 {
        match self {
            Input::Pictures(list) => list.fps,
            Input::Video(video) => video.fps(),
        }
    }

    fn open(self, config: &FilesConfig) -> Result<EyeStream, CaptureError> {
        match self {
            Input::Pictures(list) => list.open(),
            Input::Video(video) => video.open(&config.ffmpeg, config.unreadable),
        }
    }
}

/// The size of the pictures of both streams, which must be one.
fn common_size(streams: &mut [EyeStream; 2]) -> Result<(usize, usize), CaptureError> {
    let [left, right] = streams;
    let expected = left.size()?;
    let found = right.size()?;
    if found != expected {
        return Err(CaptureError::PictureSize {
            found,
            expected,
            reference: left.path().to_owned(),
            path: right.path().to_owned(),
        });
    }
    Ok(expected)
}
