//! Gives the work of a call bit by bit, in order: stills as names, frames of films as pictures.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_capture::{CaptureError, Frames, Pairer, PairingLimits};
use vergence_geometry::Eye;
use vergence_imaging::{Rgb, files};

use super::film::{self, Container};
use super::grader::Screening;
use super::inputs::{Item, Source};
use super::layout::{Layout, LayoutChoice};
use super::read::{self, Content, Pictures};
use super::record::{LayoutGrade, Resume};
use super::results::{Earlier, Finished};
use super::sequence::Collector;

/// One piece of work.
pub(super) struct Task {
    pub(super) name: String,
    pub(super) files: Vec<PathBuf>,
    pub(super) remarks: Vec<String>,
    /// Of a film's frame.
    pub(super) time_s: Option<f64>,
    pub(super) place: Place,
    pub(super) work: Work,
    /// Pixels of one eye, by which memory is shared out.
    pub(super) pixels: usize,
    /// By what a later call knows it again.
    pub(super) resume: Option<Resume>,
}

/// Where a task stands among the items of the call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// It is an item.
    Item,
    /// A picture or pair of a sequence (a film, an ordered folder), after this share of it, 0 to 1, where its length is known.
    Frame(Option<f64>),
    /// The sequence as a whole, after its frames; the item that was named.
    Whole,
}

/// What there is to do.
pub(super) enum Work {
    /// Read and grade one file.
    File(PathBuf),
    /// Read and grade a file for each eye.
    Pair(PathBuf, PathBuf),
    /// Grade what was read.
    Ready(Box<Content>),
    /// Measure a sequence as a whole.
    Whole(Box<Collector>),
    /// Nothing: an earlier call has done it.
    Finished(Finished),
    /// Nothing can be done, and why.
    Failed(String),
}

/// How a call reads.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub(super) layout: LayoutChoice,
    /// Seconds between the frames of a film that are graded; 0 is every frame.
    pub(super) every_s: f64,
    /// For the depth at cuts.
    pub(super) screen: Screening,
}

/// The work of a call.
pub(super) struct Feed {
    items: VecDeque<Item>,
    reading: Reading,
    /// Digest of the options, when results are kept.
    options: Option<String>,
    earlier: Earlier,
    running: Option<Running>,
    /// Set from outside: no more is read.
    stop: Arc<AtomicBool>,
}

/// A sequence that is being read.
struct Running {
    name: String,
    files: Vec<PathBuf>,
    /// By whose state the whole is known again: the films, or all stills.
    known_by: Vec<PathBuf>,
    remarks: Vec<String>,
    frames: FrameSource,
    next_s: f64,
    collector: Collector,
    /// Length of a film in seconds, or number of stills, where it is known.
    length: Option<f64>,
}

enum FrameSource {
    /// A film, and how its frames hold two eyes.
    Film(Frames, Layout),
    Films(Box<TwoFilms>),
    /// Pictures and pairs, and how many there have been.
    Stills(VecDeque<Item>, usize),
}

/// A sequence that was opened.
struct Opened {
    frames: FrameSource,
    fps: Option<f64>,
    length: Option<f64>,
    layout: Option<LayoutGrade>,
}

/// A frame with its time (of stills: their number), its name where it has one of its own, and what it shows.
struct Frame {
    time_s: Option<f64>,
    name: Option<String>,
    files: Option<Vec<PathBuf>>,
    content: Result<Content, String>,
}

impl Feed {
    pub(super) fn new(
        items: Vec<Item>,
        reading: Reading,
        options: Option<String>,
        earlier: Earlier,
        stop: Arc<AtomicBool>,
    ) -> Self {
        Self {
            items: items.into(),
            reading,
            options,
            earlier,
            running: None,
            stop,
        }
    }

    fn task(&self, name: String, files: Vec<PathBuf>, work: Work) -> Task {
        let resume = self.resume(&files);
        self.task_known_by(resume, name, files, work)
    }

    /// By what a task is known again that depends on these files.
    fn resume(&self, files: &[PathBuf]) -> Option<Resume> {
        self.options.as_deref().map(|o| Resume::new(o, files))
    }

    fn task_known_by(
        &self,
        resume: Option<Resume>,
        name: String,
        files: Vec<PathBuf>,
        work: Work,
    ) -> Task {
        let earlier = resume
            .as_ref()
            .and_then(|r| self.earlier.finished(&name, &r.files));
        let work = match earlier {
            Some(finished) => Work::Finished(finished.clone()),
            None => work,
        };
        Task {
            name,
            files,
            remarks: Vec::new(),
            time_s: None,
            place: Place::Item,
            work,
            pixels: 0,
            resume,
        }
    }

    fn start(&mut self, item: Item) -> Option<Task> {
        let Item {
            name,
            source,
            remarks,
        } = item;
        let mut task = match source {
            Source::Unusable(why) => self.task(name, Vec::new(), Work::Failed(why)),
            Source::File(path) => self.task(name, vec![path.clone()], Work::File(path)),
            Source::Pair(left, right) => {
                let files = vec![left.clone(), right.clone()];
                self.task(name, files, Work::Pair(left, right))
            }
            Source::Film(path) => {
                let files = vec![path.clone()];
                let choice = self.reading.layout;
                return self.start_sequence(name, files, remarks, || opened_film(&path, choice));
            }
            Source::Films(left, right) => {
                let files = vec![left.clone(), right.clone()];
                return self.start_sequence(name, files, remarks, || opened_films(&left, &right));
            }
            Source::Sequence(items) => {
                self.running = Some(Running {
                    name,
                    files: Vec::new(),
                    known_by: files_of(&items),
                    remarks,
                    next_s: 0.0,
                    collector: Collector::new(None, None),
                    length: Some(items.len() as f64),
                    frames: FrameSource::Stills(items.into(), 0),
                });
                return None;
            }
        };
        task.remarks = remarks;
        task.pixels = pixels_of(&task.work);
        Some(task)
    }

    /// Begin a film; a task only where it cannot be opened or is finished.
    fn start_sequence(
        &mut self,
        name: String,
        files: Vec<PathBuf>,
        remarks: Vec<String>,
        open: impl FnOnce() -> Result<Opened, String>,
    ) -> Option<Task> {
        let mut task = self.task(name.clone(), files.clone(), Work::Failed(String::new()));
        if matches!(task.work, Work::Finished(_)) {
            task.place = Place::Whole;
            return Some(task);
        }
        match open() {
            Ok(opened) => {
                self.running = Some(Running {
                    name,
                    known_by: files.clone(),
                    files,
                    remarks,
                    frames: opened.frames,
                    next_s: 0.0,
                    collector: Collector::new(opened.fps, opened.layout),
                    length: opened.length,
                });
                None
            }
            Err(why) => Some(self.whole(name, files, Work::Failed(why))),
        }
    }

    fn whole(&self, name: String, files: Vec<PathBuf>, work: Work) -> Task {
        let mut task = self.task(name, files, work);
        task.place = Place::Whole;
        task
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The next graded frame of the running sequence, or the sequence as a whole at its end; `None` when it is time to stop.
    fn next_of(&mut self, mut running: Running) -> Option<Task> {
        loop {
            let next = running.next_frame(self.reading.layout);
            // Ctrl-C on a terminal ends the decoder too: what it says then is neither the film's end nor a fault of the film.
            if self.is_stopped() {
                return None;
            }
            let frame = match next {
                Ok(Some(frame)) => frame,
                Ok(None) => {
                    let work = Work::Whole(Box::new(running.collector));
                    let resume = self.resume(&running.known_by);
                    let mut task = self.task_known_by(resume, running.name, running.files, work);
                    task.place = Place::Whole;
                    task.remarks = running.remarks;
                    return Some(task);
                }
                Err(why) => {
                    return Some(self.whole(running.name, running.files, Work::Failed(why)));
                }
            };
            let Frame {
                time_s,
                name,
                files,
                content,
            } = frame;
            if let Ok(content) = &content {
                running
                    .collector
                    .take(&content.pictures, time_s, &self.reading.screen);
            }
            let due = time_s.is_none_or(|t| t + 1e-9 >= running.next_s);
            if !due {
                running.recycle(content);
                continue;
            }
            if let Some(time_s) = time_s {
                running.next_s = time_s + self.reading.every_s;
            }
            let share = running.share(time_s);
            let name = name
                .unwrap_or_else(|| format!("{} at {:.3} s", running.name, time_s.unwrap_or(0.0)));
            let files = files.unwrap_or_else(|| running.files.clone());
            let work = match content {
                Ok(content) => Work::Ready(Box::new(content)),
                Err(why) => Work::Failed(why),
            };
            let pixels = pixels_of(&work);
            let mut task = self.task(name, files, work);
            task.time_s = time_s;
            task.place = Place::Frame(share);
            task.pixels = pixels;
            task.remarks.clone_from(&running.remarks);
            self.running = Some(running);
            return Some(task);
        }
    }
}

impl Iterator for Feed {
    type Item = Task;

    fn next(&mut self) -> Option<Task> {
        loop {
            if self.is_stopped() {
                return None;
            }
            if let Some(running) = self.running.take() {
                return self.next_of(running);
            }
            let item = self.items.pop_front()?;
            if let Some(task) = self.start(item) {
                return Some(task);
            }
        }
    }
}

/// Pixels of one eye: by the header of what is still to be read.
fn pixels_of(work: &Work) -> usize {
    let (w, h) = match work {
        Work::File(path) | Work::Pair(path, _) => files::read_size(path).unwrap_or((0, 0)),
        Work::Ready(content) => match &content.pictures {
            Pictures::One(picture) => picture.size(),
            Pictures::Two { eyes, .. } => eyes[0].size(),
        },
        _ => (0, 0),
    };
    w.saturating_mul(h)
}

/// All files that items name.
fn files_of(items: &[Item]) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for item in items {
        match &item.source {
            Source::File(path) | Source::Film(path) => files.push(path.clone()),
            Source::Pair(left, right) | Source::Films(left, right) => {
                files.extend([left.clone(), right.clone()]);
            }
            Source::Sequence(inner) => files.extend(files_of(inner)),
            Source::Unusable(_) => {}
        }
    }
    files
}

/// A film, with what its container and its first frames say of two eyes.
fn opened_film(path: &Path, choice: LayoutChoice) -> Result<Opened, String> {
    let frames = film::open(path).map_err(|e| film::said_once(&e, path))?;
    let container = Container::of(path);
    let layout = film::layout_of(path, &container, choice)?;
    Ok(Opened {
        fps: Some(frames.fps()),
        length: container.duration_s,
        layout: Some(LayoutGrade::from(&layout)),
        frames: FrameSource::Film(frames, layout),
    })
}

/// A film for each eye.
fn opened_films(left: &Path, right: &Path) -> Result<Opened, String> {
    let films = TwoFilms::open(left, right).map_err(|e| e.to_string())?;
    Ok(Opened {
        fps: Some(films.fps),
        length: Container::of(left).duration_s,
        layout: Some(two_films()),
        frames: FrameSource::Films(Box::new(films)),
    })
}

fn two_films() -> LayoutGrade {
    LayoutGrade {
        name: "two-files".to_owned(),
        reason: "a film for each eye, paired by time".to_owned(),
    }
}

impl Running {
    /// How much of the sequence has been read, 0 to 1.
    fn share(&self, time_s: Option<f64>) -> Option<f64> {
        let done = match &self.frames {
            FrameSource::Stills(_, count) => *count as f64,
            FrameSource::Film(..) | FrameSource::Films(_) => time_s?,
        };
        Some((done / self.length?).clamp(0.0, 1.0))
    }

    fn next_frame(&mut self, choice: LayoutChoice) -> Result<Option<Frame>, String> {
        match &mut self.frames {
            FrameSource::Film(frames, layout) => {
                let Some(frame) = frames.next_frame().map_err(|e| e.to_string())? else {
                    return Ok(None);
                };
                let content = read::split_as(frame.picture, layout).map(|pictures| Content {
                    pictures,
                    remarks: Vec::new(),
                    guessed: false,
                });
                Ok(Some(Frame {
                    time_s: Some(frame.time_s),
                    name: None,
                    files: None,
                    content,
                }))
            }
            FrameSource::Films(films) => {
                let Some((time_s, eyes)) = films.next_pair().map_err(|e| e.to_string())? else {
                    return Ok(None);
                };
                Ok(Some(Frame {
                    time_s: Some(time_s),
                    name: None,
                    files: None,
                    content: Ok(Content {
                        pictures: Pictures::Two {
                            eyes,
                            layout: two_films(),
                        },
                        remarks: Vec::new(),
                        guessed: false,
                    }),
                }))
            }
            FrameSource::Stills(items, count) => {
                let Some(item) = items.pop_front() else {
                    return Ok(None);
                };
                *count += 1;
                let (files, content) = match item.source {
                    Source::File(path) => (vec![path.clone()], read::file(&path, choice)),
                    Source::Pair(left, right) => {
                        (vec![left.clone(), right.clone()], read::pair(&left, &right))
                    }
                    Source::Unusable(why) => (Vec::new(), Err(why)),
                    _ => (
                        Vec::new(),
                        Err("a film inside a sequence of pictures is not read".to_owned()),
                    ),
                };
                Ok(Some(Frame {
                    time_s: None,
                    name: Some(item.name),
                    files: Some(files),
                    content,
                }))
            }
        }
    }

    /// Give buffers back to the decoder.
    fn recycle(&self, content: Result<Content, String>) {
        if let (
            FrameSource::Film(frames, _),
            Ok(Content {
                pictures: Pictures::One(picture),
                ..
            }),
        ) = (&self.frames, content)
        {
            frames.recycle(picture);
        }
    }
}

/// A film for each eye.
struct TwoFilms {
    eyes: [Frames; 2],
    pairer: Pairer<Rgb>,
    fps: f64,
}

impl TwoFilms {
    fn open(left: &Path, right: &Path) -> Result<Self, CaptureError> {
        let eyes = [film::open(left)?, film::open(right)?];
        let fps = eyes[0].fps().max(eyes[1].fps());
        Ok(Self {
            pairer: Pairer::new(PairingLimits::for_fps(fps))?,
            eyes,
            fps,
        })
    }

    fn next_pair(&mut self) -> Result<Option<(f64, [Rgb; 2])>, CaptureError> {
        loop {
            if let Some(paired) = self.pairer.pop() {
                if paired.left.size() != paired.right.size() {
                    let [(lw, lh), (rw, rh)] = [paired.left.size(), paired.right.size()];
                    return Err(CaptureError::Unequal(format!(
                        "the left film is {lw} x {lh} pixels, the right one {rw} x {rh}"
                    )));
                }
                return Ok(Some((paired.left_s, [paired.left, paired.right])));
            }
            let Some(eye) = self.pairer.wants() else {
                continue;
            };
            match self.eyes[usize::from(eye == Eye::Right)].next_frame()? {
                Some(frame) => self.pairer.push(eye, frame.time_s, frame.picture),
                None => return Ok(None),
            }
        }
    }
}
