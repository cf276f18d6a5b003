//! The channels of a recording: topic, schema, and what for.

use crate::mcap::{Channel, Schema};
use crate::rows;
use crate::schema::descriptor_of;
use crate::table::{Column, Row, descriptor};

/// A channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Left picture.
    LeftImage,
    /// Right picture.
    RightImage,
    /// Left camera's calibration.
    LeftCalibration,
    /// Right camera's calibration.
    RightCalibration,
    /// Where the cameras stand.
    Transforms,
    /// The target as a pose.
    Target,
    /// Everything worth a sentence.
    Log,
    /// Both cameras, every bit.
    Lens,
    /// Times of a pair.
    Pair,
    /// What the loop was doing.
    Step,
    /// Where the target is at the capture.
    Estimate,
    /// Where it will be when the axes act.
    Aim,
    /// What the pictures said.
    Measurement,
    /// What was asked of the axes.
    Setpoint,
    /// Readings of the step counters.
    Axis,
    /// What a viewer sees.
    Parallax,
    /// Changes of mode and state.
    Change,
    /// What happened.
    Event,
    /// Looks at the rig's health.
    Health,
    /// The recorder's own counts.
    Recorder,
    /// Wall times; in real time only.
    Timing,
    /// The truth; of the twin only.
    Truth,
    /// Counts and times of live cameras; of these only.
    Cameras,
}

impl Topic {
    /// All of them, in the order of their numbers in a file.
    pub const ALL: [Topic; 23] = [
        Topic::LeftImage,
        Topic::RightImage,
        Topic::LeftCalibration,
        Topic::RightCalibration,
        Topic::Transforms,
        Topic::Target,
        Topic::Log,
        Topic::Lens,
        Topic::Pair,
        Topic::Step,
        Topic::Estimate,
        Topic::Aim,
        Topic::Measurement,
        Topic::Setpoint,
        Topic::Axis,
        Topic::Parallax,
        Topic::Change,
        Topic::Event,
        Topic::Health,
        Topic::Recorder,
        Topic::Timing,
        Topic::Truth,
        Topic::Cameras,
    ];

    /// Its name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Topic::LeftImage => "/left/image",
            Topic::RightImage => "/right/image",
            Topic::LeftCalibration => "/left/calibration",
            Topic::RightCalibration => "/right/calibration",
            Topic::Transforms => "/tf",
            Topic::Target => "/target",
            Topic::Log => "/log",
            Topic::Lens => "/lens",
            Topic::Pair => "/pair",
            Topic::Step => "/step",
            Topic::Estimate => "/estimate",
            Topic::Aim => "/aim",
            Topic::Measurement => "/measurement",
            Topic::Setpoint => "/setpoint",
            Topic::Axis => "/axis",
            Topic::Parallax => "/parallax",
            Topic::Change => "/change",
            Topic::Event => "/event",
            Topic::Health => "/health",
            Topic::Recorder => "/recorder",
            Topic::Timing => "/timing",
            Topic::Truth => "/truth",
            Topic::Cameras => "/cameras",
        }
    }

    /// The channel of this name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Its message's name within the package `vergence` and its columns; `None` for messages of Foxglove's.
    pub fn row(self) -> Option<(&'static str, &'static [Column])> {
        fn of<R: Row>() -> Option<(&'static str, &'static [Column])> {
            Some((R::NAME, R::COLUMNS))
        }
        match self {
            Topic::Lens => of::<rows::Lens>(),
            Topic::Pair => of::<rows::Pair>(),
            Topic::Step => of::<rows::Step>(),
            Topic::Estimate | Topic::Aim => of::<rows::Estimate>(),
            Topic::Measurement => of::<rows::Measurement>(),
            Topic::Setpoint => of::<rows::Setpoint>(),
            Topic::Axis => of::<rows::Axis>(),
            Topic::Parallax => of::<rows::Parallax>(),
            Topic::Change => of::<rows::Change>(),
            Topic::Event => of::<rows::Happening>(),
            Topic::Health => of::<rows::Health>(),
            Topic::Recorder => of::<rows::Recorder>(),
            Topic::Timing => of::<rows::Timing>(),
            Topic::Truth => of::<rows::Truth>(),
            Topic::Cameras => of::<rows::Cameras>(),
            _ => None,
        }
    }

    /// The full name of its schema.
    pub fn schema(self) -> String {
        if let Some((name, _)) = self.row() {
            return format!("vergence.{name}");
        }
        let name = match self {
            Topic::LeftImage | Topic::RightImage => "CompressedImage",
            Topic::LeftCalibration | Topic::RightCalibration => "CameraCalibration",
            Topic::Transforms => "FrameTransforms",
            Topic::Target => "PoseInFrame",
            _ => "Log",
        };
        format!("foxglove.{name}")
    }
}

/// The channels of one file.
#[derive(Clone, Debug)]
pub(crate) struct Channels {
    places: [Option<usize>; Topic::ALL.len()],
    pub(crate) schemas: Vec<Schema>,
    pub(crate) channels: Vec<Channel>,
}

impl Channels {
    /// All channels that `wanted` lets pass.
    pub(crate) fn new(wanted: impl Fn(Topic) -> bool) -> Self {
        let mut all = Self {
            places: [None; Topic::ALL.len()],
            schemas: Vec::new(),
            channels: Vec::new(),
        };
        for topic in Topic::ALL.into_iter().filter(|topic| wanted(*topic)) {
            let name = topic.schema();
            let known = all.schemas.iter().position(|schema| schema.name == name);
            let schema = known.unwrap_or_else(|| {
                let data = match topic.row() {
                    Some((name, columns)) => descriptor(name, columns),
                    None => descriptor_of(&name),
                };
                all.schemas.push(Schema { name, data });
                all.schemas.len() - 1
            });
            all.places[topic as usize] = Some(all.channels.len());
            all.channels.push(Channel {
                topic: topic.name().to_owned(),
                schema,
            });
        }
        all
    }

    /// The number of a channel in this file; `None` when it is not wanted.
    pub(crate) fn place(&self, topic: Topic) -> Option<usize> {
        self.places[topic as usize]
    }
}
