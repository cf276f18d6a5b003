//! The recording of a simulated run: the program's own recorder on a disk that fills up, takes next to nothing, or loses a chunk (a planted bug); and what
//! must be in it.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use vergence_capture::StereoFrame;
use vergence_control::supervisor::Decision;
use vergence_record::rows::Happening;
use vergence_record::{
    Beside, Description, Limits, Pictures, RecordSettings, Recorder, Recording, Storage, Topic,
};
use vergence_servo::Step;

use crate::bugs::Bug;
use crate::eyes;

/// One pair in so many keeps its pictures.
const PICTURES_EVERY: u64 = 15;

/// A slow disk takes so many bytes in a step of the world: a kilobyte a second.
const SLOW_BYTES: usize = 5;

/// What is younger than this need not be on the disk yet, s.
const BEHIND_S: f64 = 1.5;

/// How the disk is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mood {
    /// It takes everything.
    Good,
    /// It takes next to nothing.
    Slow,
    /// It is full.
    Full,
}

struct Disk {
    bytes: Vec<u8>,
    mood: Mood,
    budget: usize,
    appended: u64,
    bug: Option<Bug>,
}

struct Handle(Arc<Mutex<Disk>>);

fn locked(disk: &Mutex<Disk>) -> MutexGuard<'_, Disk> {
    disk.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Storage for Handle {
    fn append(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut disk = locked(&self.0);
        let most = match disk.mood {
            Mood::Good => bytes.len(),
            Mood::Slow => disk.budget.min(bytes.len()),
            Mood::Full => return Err(io::Error::from(io::ErrorKind::StorageFull)),
        };
        if most == 0 {
            return Err(io::Error::from(io::ErrorKind::WouldBlock));
        }
        disk.budget = disk.budget.saturating_sub(most);
        disk.appended += 1;
        // The first bytes are the file's head; a later chunk is what the bug loses.
        let lost = disk.bug == Some(Bug::ChunkLost) && disk.appended == 8;
        if !lost {
            disk.bytes.extend_from_slice(&bytes[..most]);
        }
        Ok(most)
    }

    fn sync(&mut self) -> io::Result<()> {
        match locked(&self.0).mood {
            Mood::Full => Err(io::Error::from(io::ErrorKind::StorageFull)),
            _ => Ok(()),
        }
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        locked(&self.0).bytes.truncate(length);
        Ok(())
    }
}

/// The recording while it is made, with what it was given.
pub(crate) struct Tape {
    recorder: Recorder,
    disk: Arc<Mutex<Disk>>,
    /// When each pair's step was given, s of the world.
    steps_s: Vec<f64>,
    /// Sentences of the supervisor that were given.
    told: Vec<String>,
    /// Since when the disk has taken everything, s of the world.
    good_since_s: f64,
}

impl Tape {
    /// A recording on an empty disk.
    ///
    /// # Errors
    /// A recorder that cannot be set up.
    pub(crate) fn new(seed: u64, bug: Option<Bug>) -> anyhow::Result<Self> {
        let disk = Arc::new(Mutex::new(Disk {
            bytes: Vec::new(),
            mood: Mood::Good,
            budget: 0,
            appended: 0,
            bug,
        }));
        let description = Description {
            facts: vec![("seed".to_owned(), seed.to_string())],
            attachments: Vec::new(),
            cameras: [eyes::camera(); 2],
            fixed_base_from_cam: None,
            fps: eyes::FPS,
            timing: false,
            truth: false,
            epoch_ns: 0,
        };
        let settings = RecordSettings {
            pictures: Pictures::Jpeg(60),
            every: PICTURES_EVERY,
            limits: Limits::default(),
        };
        Ok(Self {
            recorder: Recorder::here(description, settings, Box::new(Handle(disk.clone())))?,
            disk,
            steps_s: Vec::new(),
            told: Vec::new(),
            good_since_s: 0.0,
        })
    }

    /// A pair that the loop used.
    pub(crate) fn step(&mut self, world_s: f64, pair: &StereoFrame, step: &Step) {
        self.steps_s.push(world_s);
        self.recorder.step(pair, step, Beside::default());
    }

    /// A decision of the supervisor.
    pub(crate) fn decided(&mut self, decision: &Decision) {
        self.told.push(decision.text.clone());
        self.recorder.happening(&Happening {
            time_s: decision.time_s,
            level: "info".to_owned(),
            source: "supervisor".to_owned(),
            kind: "decision".to_owned(),
            text: decision.text.clone(),
        });
    }

    /// Let the recorder work, with the disk in this mood. `world_s` is the world's time, `now_s` the program's, made steady.
    pub(crate) fn pump(&mut self, world_s: f64, now_s: f64, mood: Mood) {
        {
            let mut disk = locked(&self.disk);
            disk.mood = mood;
            disk.budget = SLOW_BYTES;
        }
        if mood != Mood::Good {
            self.good_since_s = world_s;
        }
        self.recorder.pump(now_s);
    }

    /// What is wrong with the recording as it lies on the disk now.
    pub(crate) fn wrong(&self, world_s: f64) -> Option<String> {
        let limits = Limits::default();
        let [pictures, numbers] = self.recorder.waiting_bytes();
        if pictures > limits.pictures_bytes || numbers > limits.numbers_bytes {
            return Some("more waits for the disk than may".to_owned());
        }
        let disk = locked(&self.disk);
        let (steps, told) = match read(&disk.bytes) {
            Ok(read) => read,
            Err(reason) => return Some(reason),
        };
        // A disk that was bad a moment ago may be behind.
        let behind_s = BEHIND_S + (2.0 * BEHIND_S - (world_s - self.good_since_s)).max(0.0) * 1e3;
        let due = self
            .steps_s
            .iter()
            .filter(|s| **s < world_s - behind_s)
            .count();
        if steps < due {
            return Some(format!("{steps} steps are in the recording, {due} must be"));
        }
        let prefix = told
            .iter()
            .zip(&self.told)
            .all(|(read, given)| read == given);
        (!prefix || told.len() > self.told.len())
            .then(|| "what is read of the supervisor is not what was written".to_owned())
    }

    /// Finish it; what is wrong with it then. Everything that was given must be there.
    pub(crate) fn finish(self, now_s: f64) -> Option<String> {
        let (status, result) = self.recorder.finish(now_s);
        if let Err(error) = result {
            return Some(format!("the recording was not finished: {error}"));
        }
        if status.counts.numbers_lost > 0 {
            return Some(format!("{} numbers were lost", status.counts.numbers_lost));
        }
        let disk = locked(&self.disk);
        match read(&disk.bytes) {
            Err(reason) => Some(reason),
            Ok((steps, told)) => (steps != self.steps_s.len() || told != self.told).then(|| {
                format!(
                    "{steps} steps and {} sentences are in the finished recording, {} and {} were written",
                    told.len(),
                    self.steps_s.len(),
                    self.told.len()
                )
            }),
        }
    }
}

/// Steps and sentences of the supervisor in a recording; an error for anything but an end that is missing.
fn read(bytes: &[u8]) -> Result<(usize, Vec<String>), String> {
    let unreadable = |e: vergence_record::RecordError| format!("the recording cannot be read: {e}");
    let mut recording = Recording::new(bytes).map_err(unreadable)?;
    let (mut steps, mut told) = (0, Vec::new());
    while let Some(message) = recording.next_message().map_err(unreadable)? {
        match message.topic {
            Some(Topic::Step) => steps += 1,
            Some(Topic::Event) => {
                let cells = message.cells().and_then(Result::ok).unwrap_or_default();
                let mut text = cells.into_iter().flatten().filter_map(|cell| match cell {
                    vergence_record::table::Cell::Text(text) => Some(text),
                    _ => None,
                });
                // Its last words are the sentence.
                told.extend(text.next_back());
            }
            _ => {}
        }
    }
    let damaged = recording
        .contents()
        .problems
        .iter()
        .find(|p| !matches!(p, vergence_record::mcap::Problem::CutShort { .. }));
    match damaged {
        Some(problem) => Err(format!("the recording is damaged: {problem}")),
        None => Ok((steps, told)),
    }
}
