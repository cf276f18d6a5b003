//! A recording fed back through the door by which it came: pairs as a [`Source`], the axes as a [`Drive`](vergence_control::Drive).

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Quaternion, Translation3, Unit};
use vergence_capture::{CaptureError, Frame, Source, SourceInfo, StereoFrame};
use vergence_control::{AxisLimits, BoxedDrive};
use vergence_geometry::Camera;
use vergence_imaging::Rgb;

use crate::channels::Topic;
use crate::error::RecordError;
use crate::foxglove::image_in;
use crate::picture::decode;
use crate::recording::{Contents, Message, Recording};
use crate::rows;
use crate::steps::camera;
use crate::table::Row as _;
use crate::tape::{History, ReplayDrive};

/// Largest side of a recorded picture, pixels: what the settings allow for a camera.
const LARGEST_SIDE: u64 = 16_384;

/// Largest area of a recorded picture, pixels: half a gigabyte in memory for a pair.
const LARGEST_AREA: u64 = 90_000_000;

/// Most messages that are taken together since they bear one time.
const MOST_MESSAGES_OF_A_MOMENT: usize = 10_000;

/// The pairs of a recording, with what was made of them.
pub struct ReplaySource {
    path: PathBuf,
    recording: Recording<BufReader<File>>,
    info: SourceInfo,
    history: History,
    /// The first message of the next moment.
    ahead: Option<Message>,
    /// What was recorded of the pair that was given out last.
    recorded: Recorded,
    lossless: bool,
    without_pictures: u64,
}

/// What the recording says of one pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recorded {
    /// What the loop was doing; `None` when the loop did not take this pair.
    pub step: Option<rows::Step>,
    /// Where the target was.
    pub estimate: Option<rows::Estimate>,
    /// Where it was going to be.
    pub aim: Option<rows::Estimate>,
    /// What the pictures said.
    pub measurement: Option<rows::Measurement>,
}

/// All messages of one recording time.
#[derive(Default)]
struct Moment {
    pair: Option<rows::Pair>,
    images: [Option<Vec<u8>>; 2],
    recorded: Recorded,
}

impl Moment {
    /// Whether this message begins the next pair: of two that were taken while the clock stood, each has its own messages.
    fn is_before(&self, message: &Message) -> bool {
        self.pair.is_some()
            && matches!(
                message.topic,
                Some(Topic::LeftImage | Topic::RightImage | Topic::Pair)
            )
    }
}

impl ReplaySource {
    /// Open a recording; refused when it holds no pictures, or no cameras that can be believed.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        let (lenses, lossless) = scan(path)?;
        let [Some(left), Some(right)] = lenses else {
            return Err(RecordError::Replay(
                "it does not say what its cameras are (no message on /lens)".to_owned(),
            ));
        };
        let Some(lossless) = lossless else {
            return Err(RecordError::Replay(
                "it holds no pictures; record with record.pictures = \"jpeg\" or \"png\""
                    .to_owned(),
            ));
        };
        let cameras = [believable(&left)?, believable(&right)?];
        let fixed = (left.fixed && right.fixed).then(|| [pose(&left), pose(&right)]);
        let mut source = Self {
            path: path.to_owned(),
            recording: Recording::new(opened(path)?)?,
            info: SourceInfo {
                name: "recording".to_owned(),
                cameras,
                fixed_base_from_cam: fixed,
                fps: left.fps,
                pairs: None,
            },
            history: History::default(),
            ahead: None,
            recorded: Recorded::default(),
            lossless,
            without_pictures: 0,
        };
        source.ahead = source.recording.next_message()?;
        Ok(source)
    }

    /// Facts, attachments and problems, as far as the file was read: before the first pair those that stand before it.
    pub fn contents(&self) -> &Contents {
        self.recording.contents()
    }

    /// Whether the pictures lost nothing when they were recorded: then a replay is the run, bit for bit.
    pub fn is_lossless(&self) -> bool {
        self.lossless
    }

    /// Pairs left out since their pictures are not in the recording.
    pub fn without_pictures(&self) -> u64 {
        self.without_pictures
    }

    /// Motors that stood where they stood in the recorded run, within these limits.
    pub fn drive(&self, limits: [AxisLimits; 4]) -> BoxedDrive {
        Box::new(ReplayDrive::new(self.history.clone(), limits))
    }

    /// What was recorded of the pair that was given out last.
    pub fn recorded(&self) -> &Recorded {
        &self.recorded
    }

    /// All messages of the next pair, which bear one recording time; `None` at the end.
    fn moment(&mut self) -> Result<Option<Moment>, RecordError> {
        let Some(first) = self.ahead.take() else {
            return Ok(None);
        };
        let log_ns = first.log_ns;
        let mut moment = Moment::default();
        let mut next = Some(first);
        let mut count = 0;
        while let Some(message) = next.take() {
            count += 1;
            if message.log_ns != log_ns
                || count > MOST_MESSAGES_OF_A_MOMENT
                || moment.is_before(&message)
            {
                self.ahead = Some(message);
                break;
            }
            self.take(&mut moment, message)?;
            next = self.recording.next_message()?;
        }
        Ok(Some(moment))
    }

    fn take(&mut self, moment: &mut Moment, message: Message) -> Result<(), RecordError> {
        let data = &message.data;
        match message.topic {
            Some(Topic::LeftImage) => moment.images[0] = Some(message.data),
            Some(Topic::RightImage) => moment.images[1] = Some(message.data),
            Some(Topic::Pair) => moment.pair = Some(rows::Pair::decode(data)?),
            Some(Topic::Axis) => self.history.push(rows::Axis::decode(data)?),
            Some(Topic::Step) => moment.recorded.step = Some(rows::Step::decode(data)?),
            Some(Topic::Estimate) => {
                moment.recorded.estimate = Some(rows::Estimate::decode(data)?);
            }
            Some(Topic::Aim) => moment.recorded.aim = Some(rows::Estimate::decode(data)?),
            Some(Topic::Measurement) => {
                moment.recorded.measurement = Some(rows::Measurement::decode(data)?);
            }
            _ => {}
        }
        Ok(())
    }

    fn next_recorded(&mut self) -> Result<Option<StereoFrame>, RecordError> {
        while let Some(moment) = self.moment()? {
            let Some(pair) = moment.pair else { continue };
            let (Some(left), Some(right)) = (&moment.images[0], &moment.images[1]) else {
                self.without_pictures += 1;
                continue;
            };
            let picture = |eye: usize, message: &[u8]| -> Result<Rgb, RecordError> {
                let (file, _) = image_in(message)
                    .ok_or_else(|| RecordError::Message("an image without data".to_owned()))?;
                let k = &self.info.cameras[eye].intrinsics;
                decode(file, (k.width, k.height))
            };
            let [left, right] = [picture(0, left)?, picture(1, right)?];
            self.recorded = moment.recorded;
            return Ok(Some(StereoFrame {
                index: pair.index,
                left: Frame {
                    picture: left,
                    capture_s: pair.left_capture_s,
                    arrival_s: pair.left_arrival_s,
                },
                right: Frame {
                    picture: right,
                    capture_s: pair.right_capture_s,
                    arrival_s: pair.right_arrival_s,
                },
            }));
        }
        Ok(None)
    }
}

impl Source for ReplaySource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_pair(
        &mut self,
        _reuse: Option<StereoFrame>,
    ) -> Result<Option<StereoFrame>, CaptureError> {
        self.next_recorded().map_err(|e| {
            self.ahead = None;
            CaptureError::Input {
                reason: e.to_string(),
                path: self.path.clone(),
            }
        })
    }

    fn dropped_pairs(&self) -> u64 {
        self.without_pictures
    }
}

/// The camera of a row, when it is one: what is computed with it must be numbers.
fn believable(row: &rows::Lens) -> Result<Camera, RecordError> {
    let refuse = |why: String| Err(RecordError::Replay(why));
    let (width, height) = (row.width_px, row.height_px);
    let sides = 1..=LARGEST_SIDE;
    if !(sides.contains(&width) && sides.contains(&height) && width * height <= LARGEST_AREA) {
        return refuse(format!(
            "its cameras have {width}x{height} pixels; 1x1 up to {LARGEST_AREA} pixels are read"
        ));
    }
    let Some(camera) = camera(row) else {
        let model: String = row.model.chars().take(40).collect();
        return refuse(format!("there is no lens model {model:?}"));
    };
    let k = &camera.intrinsics;
    let focal = [k.fx, k.fy].iter().all(|f| f.is_finite() && *f > 0.0);
    let finite = [k.cx, k.cy, row.x_m, row.y_m, row.z_m]
        .iter()
        .chain(&camera.distortion.coefficients())
        .all(|number| number.is_finite());
    let turn = row.qx.hypot(row.qy).hypot(row.qz).hypot(row.qw);
    if !(focal && finite && (turn - 1.0).abs() < 1e-6) {
        return refuse(format!(
            "its camera {} has numbers on /lens that no camera has",
            row.eye
        ));
    }
    if !(row.fps.is_finite() && row.fps > 0.0) {
        return refuse(format!("it says that it has {} pairs a second", row.fps));
    }
    Ok(camera)
}

/// The cameras, and whether pictures are lossless (`None` without pictures): the file is read until both are known.
fn scan(path: &Path) -> Result<([Option<rows::Lens>; 2], Option<bool>), RecordError> {
    let mut recording = Recording::new(opened(path)?)?;
    let (mut lenses, mut lossless) = ([None, None], None);
    while let Some(message) = recording.next_message()? {
        match message.topic {
            Some(Topic::Lens) => {
                let row = rows::Lens::decode(&message.data)?;
                if let Some(lens) = lenses.get_mut(row.eye as usize) {
                    lens.get_or_insert(row);
                }
            }
            Some(Topic::LeftImage) if lossless.is_none() => {
                lossless = image_in(&message.data).map(|(_, format)| format == "png");
            }
            _ => {}
        }
        if lossless.is_some() && lenses.iter().all(Option::is_some) {
            break;
        }
    }
    Ok((lenses, lossless))
}

fn opened(path: &Path) -> Result<BufReader<File>, RecordError> {
    let file = File::open(path).map_err(|source| RecordError::Io {
        action: "opening",
        source,
    })?;
    Ok(BufReader::with_capacity(1 << 20, file))
}

/// `base_from_cam` of a row, every bit of it.
fn pose(row: &rows::Lens) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(row.x_m, row.y_m, row.z_m),
        Unit::new_unchecked(Quaternion::new(row.qw, row.qx, row.qy, row.qz)),
    )
}
