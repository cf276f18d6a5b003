//! Gives the work of a call bit by bit, in order: stills as names, frames of films as pictures.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use vergence_capture::{CaptureError, Frames, OnFault, Pairer, PairingLimits};
use vergence_geometry::Eye;
use vergence_imaging::{Rgb, files};

use super::grader::Screening;
use super::inputs::{Item, Source};
use super::layout::{self, Layout, LayoutChoice};
use super::read::{self, Content, Pictures};
use super::record::{LayoutGrade, Resume};
use super::results::{Earlier, Finished};
use super::sequence::Collector;

/// The program that decodes films.
const FFMPEG: &str = "ffmpeg";

/// One piece of work.
pub(super) struct Task {
    pub(super) name: String,
    pub(super) files: Vec<PathBuf>,
    pub(super) remarks: Vec<String>,
    /// Of a film's frame.
    pub(super) time_s: Option<f64>,
    /// Whether it belongs to a sequence (a film, an ordered folder).
    pub(super) in_sequence: bool,
    pub(super) work: Work,
    /// Pixels of one eye, by which memory is shared out.
    pub(super) pixels: usize,
    /// By what a later call knows it again.
    pub(super) resume: Option<Resume>,
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
}

/// A sequence that is being read.
struct Running {
    name: String,
    files: Vec<PathBuf>,
    remarks: Vec<String>,
    frames: FrameSource,
    next_s: f64,
    collector: Collector,
    /// How the film's frames hold two eyes, found in the first one.
    layout: Option<Layout>,
}

enum FrameSource {
    Film(Frames),
    Films(Box<TwoFilms>),
    /// Pictures and pairs, and how many there have been.
    Stills(VecDeque<Item>, usize),
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
    ) -> Self {
        Self {
            items: items.into(),
            reading,
            options,
            earlier,
            running: None,
        }
    }

    fn task(&self, name: String, files: Vec<PathBuf>, work: Work) -> Task {
        let resume = self.options.as_deref().map(|o| Resume::new(o, &files));
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
            in_sequence: false,
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
                return self.start_sequence(name, files, remarks, || {
                    let frames = Frames::open(&path, Path::new(FFMPEG), OnFault::Refuse)?;
                    let fps = frames.fps();
                    Ok((FrameSource::Film(frames), Some(fps)))
                });
            }
            Source::Films(left, right) => {
                let files = vec![left.clone(), right.clone()];
                return self.start_sequence(name, files, remarks, || {
                    let films = TwoFilms::open(&left, &right)?;
                    let fps = films.fps;
                    Ok((FrameSource::Films(Box::new(films)), Some(fps)))
                });
            }
            Source::Sequence(items) => {
                return self.start_sequence(name, Vec::new(), remarks, || {
                    Ok((FrameSource::Stills(items.into(), 0), None))
                });
            }
        };
        task.remarks = remarks;
        task.pixels = pixels_of(&task.work);
        Some(task)
    }

    /// Begin a sequence; a task only where it cannot be opened or is finished.
    fn start_sequence(
        &mut self,
        name: String,
        files: Vec<PathBuf>,
        remarks: Vec<String>,
        open: impl FnOnce() -> Result<(FrameSource, Option<f64>), CaptureError>,
    ) -> Option<Task> {
        // An ordered folder has no file of its own by which its state could be known.
        if !files.is_empty() {
            let task = self.task(name.clone(), files.clone(), Work::Failed(String::new()));
            if matches!(task.work, Work::Finished(_)) {
                return Some(task);
            }
        }
        match open() {
            Ok((frames, fps)) => {
                self.running = Some(Running {
                    name,
                    files,
                    remarks,
                    frames,
                    next_s: 0.0,
                    collector: Collector::new(fps),
                    layout: None,
                });
                None
            }
            Err(error) => Some(self.task(name, files, Work::Failed(error.to_string()))),
        }
    }

    /// The next graded frame of the running sequence, or the sequence as a whole at its end.
    fn next_of(&mut self, mut running: Running) -> Task {
        loop {
            let frame = match running.next_frame(self.reading.layout) {
                Ok(Some(frame)) => frame,
                Ok(None) => {
                    let work = Work::Whole(Box::new(running.collector));
                    let mut task = self.task(running.name, running.files, work);
                    task.remarks = running.remarks;
                    return task;
                }
                Err(why) => return self.task(running.name, running.files, Work::Failed(why)),
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
                    .take(&content.pictures, &self.reading.screen);
            }
            let due = time_s.is_none_or(|t| t + 1e-9 >= running.next_s);
            if !due {
                running.recycle(content);
                continue;
            }
            if let Some(time_s) = time_s {
                running.next_s = time_s + self.reading.every_s;
            }
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
            task.in_sequence = true;
            task.pixels = pixels;
            task.remarks.clone_from(&running.remarks);
            self.running = Some(running);
            return task;
        }
    }
}

impl Iterator for Feed {
    type Item = Task;

    fn next(&mut self) -> Option<Task> {
        loop {
            if let Some(running) = self.running.take() {
                return Some(self.next_of(running));
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

impl Running {
    fn next_frame(&mut self, choice: LayoutChoice) -> Result<Option<Frame>, String> {
        match &mut self.frames {
            FrameSource::Film(frames) => {
                let Some(frame) = frames.next_frame().map_err(|e| e.to_string())? else {
                    return Ok(None);
                };
                let path = &self.files[0];
                let found = match &self.layout {
                    Some(found) => Ok(found.clone()),
                    None => layout::of_picture(&frame.picture, path, None, choice),
                };
                let content = found.and_then(|found| {
                    let pictures = read::split_as(frame.picture, &found)?;
                    self.layout = Some(found);
                    Ok(Content {
                        pictures,
                        remarks: Vec::new(),
                    })
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
                            layout: LayoutGrade {
                                name: "two-files".to_owned(),
                                reason: "a film for each eye, paired by time".to_owned(),
                            },
                        },
                        remarks: Vec::new(),
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
            FrameSource::Film(frames),
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
        let open = |path| Frames::open(path, Path::new(FFMPEG), OnFault::Refuse);
        let eyes = [open(left)?, open(right)?];
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
