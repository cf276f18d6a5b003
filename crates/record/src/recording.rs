//! A recording as a whole: what is in it, how it is, and its rows one after the other.

use std::collections::BTreeMap;
use std::io::Read;

use crate::channels::Topic;
use crate::error::RecordError;
use crate::mcap::{Event, Problem, Reader};
use crate::rows;
use crate::table::{Cell, Row as _, decode};

/// Most problems that are listed; more are counted.
const MOST_PROBLEMS: usize = 100;

/// Most attachments, and most bytes of them together.
const MOST_ATTACHMENTS: usize = 100;
const ATTACHMENT_BYTES: usize = 64 << 20;

/// Most named facts, and most bytes of them together.
const MOST_FACTS: usize = 1000;
const FACT_BYTES: usize = 4 << 20;

/// A time without a message of a channel that is longer than so many of its usual ones is a gap.
const GAP_FACTOR: f64 = 1.9;

/// Number of a channel.
type Id = u16;

/// A message with what is known of its channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// Which of our channels; `None` for one that this program does not know.
    pub topic: Option<Topic>,
    /// Number of its channel in this file.
    pub channel: u16,
    /// When it was recorded, ns.
    pub log_ns: u64,
    /// When what it speaks of was so, ns.
    pub publish_ns: u64,
    /// Its content.
    pub data: Vec<u8>,
}

impl Message {
    /// Its values in the order of its channel's columns; `None` for messages that are no rows of ours.
    pub fn cells(&self) -> Option<Result<Vec<Option<Cell>>, RecordError>> {
        let (_, columns) = self.topic?.row()?;
        Some(decode(columns, &self.data))
    }
}

/// What stands in a file beside its messages, as far as it was read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contents {
    /// Named facts of the run.
    pub facts: BTreeMap<String, String>,
    /// Files within the file.
    pub attachments: Vec<(String, Vec<u8>)>,
    /// What is wrong with the file.
    pub problems: Vec<Problem>,
    /// Problems that are not listed.
    pub problems_left_out: u64,
    /// Whether its writer finished it.
    pub finished: bool,
    /// Names of the channels by their numbers, with their schemas.
    pub channels: BTreeMap<Id, (String, String)>,
}

impl Contents {
    /// The attachment of this name as text.
    pub fn text(&self, name: &str) -> Option<&str> {
        let (_, data) = self.attachments.iter().find(|(n, _)| n == name)?;
        std::str::from_utf8(data).ok()
    }
}

/// A recording while it is read from front to back.
pub struct Recording<R> {
    reader: Reader<R>,
    contents: Contents,
    schemas: BTreeMap<u16, String>,
    topics: BTreeMap<u16, Option<Topic>>,
    attached: usize,
    facts: usize,
}

impl<R: Read> Recording<R> {
    /// Begin to read.
    pub fn new(input: R) -> Result<Self, RecordError> {
        Ok(Self {
            reader: Reader::new(input)?,
            contents: Contents::default(),
            schemas: BTreeMap::new(),
            topics: BTreeMap::new(),
            attached: 0,
            facts: 0,
        })
    }

    /// What was read beside messages so far.
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// The next message; `None` at the end. Everything else goes to [`Recording::contents`].
    pub fn next_message(&mut self) -> Result<Option<Message>, RecordError> {
        while let Some(event) = self.reader.next_event()? {
            match event {
                Event::Message {
                    channel,
                    log_ns,
                    publish_ns,
                    data,
                    ..
                } => {
                    return Ok(Some(Message {
                        topic: self.topics.get(&channel).copied().flatten(),
                        channel,
                        log_ns,
                        publish_ns,
                        data,
                    }));
                }
                other => self.take(other),
            }
        }
        Ok(None)
    }

    fn take(&mut self, event: Event) {
        let contents = &mut self.contents;
        match event {
            Event::Schema { id, name, .. } => {
                self.schemas.insert(id, name);
            }
            Event::Channel {
                id,
                schema,
                topic,
                encoding,
            } => {
                let schema = self.schemas.get(&schema).cloned().unwrap_or_default();
                // A topic of ours with another schema or encoding is not ours.
                let ours = Topic::of(&topic)
                    .filter(|ours| encoding == "protobuf" && ours.schema() == schema);
                self.topics.insert(id, ours);
                contents.channels.insert(id, (topic, schema));
            }
            Event::Metadata { name, facts } if name == "vergence" => {
                for (key, value) in facts {
                    self.facts += key.len() + value.len();
                    if contents.facts.len() < MOST_FACTS && self.facts <= FACT_BYTES {
                        contents.facts.insert(key, value);
                    }
                }
            }
            Event::Attachment { name, data } => {
                let fits = contents.attachments.len() < MOST_ATTACHMENTS
                    && self.attached + data.len() <= ATTACHMENT_BYTES;
                if fits {
                    self.attached += data.len();
                    contents.attachments.push((name, data));
                }
            }
            Event::Problem(problem) if contents.problems.len() < MOST_PROBLEMS => {
                contents.problems.push(problem);
            }
            Event::Problem(_) => contents.problems_left_out += 1,
            Event::Finished => contents.finished = true,
            _ => {}
        }
    }
}

/// What is in one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelInfo {
    /// Its topic.
    pub topic: String,
    /// Its schema.
    pub schema: String,
    /// Messages.
    pub messages: u64,
    /// Bytes of their contents.
    pub bytes: u64,
    /// First and last recording time, ns.
    pub times_ns: [u64; 2],
    /// Longest time between two messages, s.
    pub longest_gap_s: f64,
}

/// What is in a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Info {
    /// Facts, attachments, problems.
    pub contents: Contents,
    /// Its channels in the order of their numbers; those without messages too.
    pub channels: Vec<ChannelInfo>,
    /// First and last recording time of all messages, ns; `None` without messages.
    pub times_ns: Option<[u64; 2]>,
    /// Pairs by their times.
    pub pairs: u64,
    /// Pairs whose numbers are missing between the first and the last one.
    pub pairs_missing: u64,
    /// Times between pairs that are longer than 1.9 usual ones.
    pub gaps: u64,
    /// Usual time between two pairs, s: the median of the first thousand.
    pub period_s: Option<f64>,
    /// Messages whose content does not fit their schema.
    pub unreadable: u64,
    /// The recorder's last own counts.
    pub recorder: Option<rows::Recorder>,
    /// The last counts and times of live cameras.
    pub cameras: Option<rows::Cameras>,
    /// Both cameras.
    pub lenses: Vec<rows::Lens>,
}

impl Info {
    /// Read a recording from front to back.
    pub fn read(input: impl Read) -> Result<Self, RecordError> {
        let mut recording = Recording::new(input)?;
        let mut channels: BTreeMap<Id, ChannelInfo> = BTreeMap::new();
        let mut times_ns: Option<[u64; 2]> = None;
        let mut pairs = Pairs::default();
        let mut unreadable = 0;
        let (mut recorder, mut cameras, mut lenses) = (None, None, Vec::new());
        while let Some(message) = recording.next_message()? {
            let ns = message.log_ns;
            times_ns = Some(times_ns.map_or([ns; 2], |[a, b]| [a.min(ns), b.max(ns)]));
            channels
                .entry(message.channel)
                .and_modify(|channel| channel.take(&message))
                .or_insert_with(|| ChannelInfo::first(&message));
            if matches!(message.cells(), Some(Err(_))) {
                unreadable += 1;
                continue;
            }
            match message.topic {
                Some(Topic::Pair) => pairs.take(&rows::Pair::decode(&message.data)?),
                Some(Topic::Recorder) => recorder = Some(rows::Recorder::decode(&message.data)?),
                Some(Topic::Cameras) => cameras = Some(rows::Cameras::decode(&message.data)?),
                Some(Topic::Lens) if lenses.len() < 2 => {
                    lenses.push(rows::Lens::decode(&message.data)?);
                }
                _ => {}
            }
        }
        let contents = recording.contents;
        let channels = contents
            .channels
            .iter()
            .map(|(id, (topic, schema))| {
                let mut channel = channels.remove(id).unwrap_or_else(ChannelInfo::empty);
                channel.topic.clone_from(topic);
                channel.schema.clone_from(schema);
                channel
            })
            .collect();
        let period_s = pairs.period_s();
        Ok(Self {
            contents,
            channels,
            times_ns,
            pairs: pairs.count,
            pairs_missing: pairs.missing,
            gaps: pairs.gaps,
            period_s,
            unreadable,
            recorder,
            cameras,
            lenses,
        })
    }

    /// Duration between the first and the last message, s.
    pub fn seconds(&self) -> f64 {
        self.times_ns
            .map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9)
    }
}

impl ChannelInfo {
    fn empty() -> Self {
        Self {
            topic: String::new(),
            schema: String::new(),
            messages: 0,
            bytes: 0,
            times_ns: [0; 2],
            longest_gap_s: 0.0,
        }
    }

    fn first(message: &Message) -> Self {
        Self {
            messages: 1,
            bytes: message.data.len() as u64,
            times_ns: [message.log_ns; 2],
            ..Self::empty()
        }
    }

    fn take(&mut self, message: &Message) {
        self.messages += 1;
        self.bytes += message.data.len() as u64;
        let gap = message.log_ns.saturating_sub(self.times_ns[1]);
        self.longest_gap_s = self.longest_gap_s.max(gap as f64 * 1e-9);
        self.times_ns[1] = self.times_ns[1].max(message.log_ns);
    }

    /// Messages a second; `None` with fewer than two.
    pub fn rate_hz(&self) -> Option<f64> {
        let seconds = (self.times_ns[1] - self.times_ns[0]) as f64 * 1e-9;
        (self.messages > 1 && seconds > 0.0).then(|| (self.messages - 1) as f64 / seconds)
    }
}

/// Pairs as they come.
#[derive(Default)]
struct Pairs {
    count: u64,
    missing: u64,
    gaps: u64,
    last: Option<(u64, f64)>,
    periods_s: Vec<f64>,
}

impl Pairs {
    fn take(&mut self, pair: &rows::Pair) {
        let capture_s = (pair.left_capture_s + pair.right_capture_s) / 2.0;
        if let Some((index, then_s)) = self.last {
            let missing = pair.index.saturating_sub(index).saturating_sub(1);
            self.missing = self.missing.saturating_add(missing);
            let between_s = capture_s - then_s;
            if self.period_s().is_some_and(|p| between_s > GAP_FACTOR * p) {
                self.gaps += 1;
            }
            if self.periods_s.len() < 1000 && between_s.is_finite() {
                let place = self.periods_s.partition_point(|p| *p < between_s);
                self.periods_s.insert(place, between_s);
            }
        }
        self.count += 1;
        self.last = Some((pair.index, capture_s));
    }

    fn period_s(&self) -> Option<f64> {
        self.periods_s.get(self.periods_s.len() / 2).copied()
    }
}
