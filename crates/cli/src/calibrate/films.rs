//! A board in films (or live streams): somebody walks it before the cameras and holds it still now and then. Frames are taken at those moments,
//! each at a stand that none before had.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget};
use rayon::prelude::*;
use vergence_calib::Target;
use vergence_calib::solve::Sighting;
use vergence_capture::{Frames, OnFault, TimedFrame};
use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb;

use super::lists::View;
use super::look::{Seen, seen_in};
use crate::fault::{self, Fault};
use crate::output;

/// Time between two frames that are looked at, s.
const LOOK_S: f64 = 0.15;

/// A board stands still when its corners have moved by no more than this since the last look, px RMS: slower than what smears a corner by a
/// tenth of a pixel within an exposure of a tenth of that time.
const STILL_PX: f64 = 0.7;

/// A stand is a new one when its corners are this share of the picture's width away from every stand before, RMS, in some camera.
const NEW_SHARE: f64 = 0.05;

/// Most stands that are kept: more say little and take long.
const MOST_STANDS: usize = 80;

/// Fewest corners that two looks must have in common to be compared.
const LEAST_COMMON: u32 = 6;

/// What was taken from the films.
pub(super) struct Taken {
    pub(super) views: Vec<View>,
    pub(super) seen: Vec<Seen>,
}

/// What every camera saw at one moment.
struct Moment {
    time_s: f64,
    corners: Vec<Option<Vec<Sighting>>>,
}

/// All cameras' pictures at one moment after another.
pub(super) trait Moments {
    /// What each camera is called.
    fn names(&self) -> Vec<String>;

    /// The first moment at or after a time, s, with a picture of each camera; `None` when there is none any more or `enough` is set.
    fn at(&mut self, due_s: f64, enough: &AtomicBool) -> Result<Option<(f64, Vec<Gray>)>, Fault>;
}

/// Take frames of a board from one film of each camera, which run together.
///
/// # Errors
/// Films that cannot be read, and films in which no board is held still.
pub(super) fn of_films(films: &[PathBuf], target: &Target) -> Result<Taken, Fault> {
    let streams = films
        .iter()
        .map(|path| Stream::open(path).map_err(told))
        .collect::<Result<_, _>>()?;
    taken(&mut Films { streams }, target)
}

#[expect(
    clippy::needless_pass_by_value,
    reason = "the shape that map_err calls"
)]
fn told(e: vergence_capture::CaptureError) -> Fault {
    fault::usage(e.to_string())
}

/// Take frames of a board at the moments at which it stands still.
///
/// # Errors
/// What the moments' source says, and moments at which no board is held still.
pub(super) fn taken(moments: &mut impl Moments, target: &Target) -> Result<Taken, Fault> {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(5));
    // A stream ends when somebody says so: Ctrl-C is "enough".
    let enough = crate::run::stop_on_signals().map_err(|e| fault::failed(e.to_string()))?;
    let mut sizes: Vec<(usize, usize)> = Vec::new();
    let mut why_not: Option<String> = None;
    let mut stands: Vec<Moment> = Vec::new();
    let mut before: Option<Moment> = None;
    let (mut due_s, mut looks, mut with_board) = (f64::NEG_INFINITY, 0, 0);
    while !enough.load(Ordering::Relaxed)
        && let Some((time_s, grays)) = moments.at(due_s, &enough)?
    {
        due_s = time_s + LOOK_S;
        sizes = grays.iter().map(Gray::size).collect();
        let looked: Vec<Seen> = grays.par_iter().map(|gray| seen_in(gray, target)).collect();
        if let Some(Seen::Nothing(reason)) = looked.iter().find(|s| matches!(s, Seen::Nothing(_))) {
            why_not.get_or_insert_with(|| reason.clone());
        }
        let corners: Vec<Option<Vec<Sighting>>> = looked.into_iter().map(board).collect();
        looks += 1;
        with_board += usize::from(corners.iter().any(Option::is_some));
        let now = Moment { time_s, corners };
        let still = before
            .as_ref()
            .is_some_and(|before| stands_still(before, &now));
        if still && is_new(&stands, &now, &sizes) {
            stands.push(Moment {
                time_s,
                corners: now.corners.clone(),
            });
        }
        if stands.len() == MOST_STANDS {
            output::say(&format!(
                "{MOST_STANDS} stands of the board are enough; what comes after {time_s:.0} s is not looked at"
            ));
            break;
        }
        bar.set_message(format!(
            "{time_s:.0} s, {} stands of the board",
            stands.len()
        ));
        bar.tick();
        before = Some(now);
    }
    bar.finish_and_clear();
    if stands.is_empty() {
        let names = moments.names();
        return Err(nothing(&names[0], looks, with_board, why_not.as_deref()));
    }
    Ok(views_of(&moments.names(), &sizes, &stands))
}

fn nothing(name: &str, looks: usize, with_board: usize, why_not: Option<&str>) -> Fault {
    match with_board {
        0 => fault::usage(format!(
            "the board is seen in none of {looks} frames of {name}; in the first: {}",
            why_not.unwrap_or("there is none")
        ))
        .hint("check --target: for a chessboard count inner corners, for others squares or tags"),
        _ => fault::usage(format!(
            "the board is seen in {with_board} of {looks} frames of {name}, but never held still"
        ))
        .hint("hold the board still for half a second at each place, or put it on a stand"),
    }
}

fn views_of(names: &[String], sizes: &[(usize, usize)], stands: &[Moment]) -> Taken {
    let (mut views, mut seen) = (Vec::new(), Vec::new());
    for (camera, name) in names.iter().enumerate() {
        for (group, stand) in stands.iter().enumerate() {
            let Some(corners) = &stand.corners[camera] else {
                continue;
            };
            views.push(View {
                path: PathBuf::from(format!("{name} at {:.2} s", stand.time_s)),
                camera,
                group,
                size: sizes[camera],
            });
            seen.push(Seen::Board(corners.clone()));
        }
    }
    Taken { views, seen }
}

/// Every camera that sees the board now saw it a look ago in the same place.
fn stands_still(before: &Moment, now: &Moment) -> bool {
    let mut any = false;
    for (before, now) in before.corners.iter().zip(&now.corners) {
        let Some(now) = now else {
            continue;
        };
        any = true;
        let moved_px = before.as_ref().and_then(|before| apart_px(before, now));
        if moved_px.is_none_or(|moved| moved > STILL_PX) {
            return false;
        }
    }
    any
}

fn is_new(stands: &[Moment], now: &Moment, sizes: &[(usize, usize)]) -> bool {
    stands.iter().all(|stand| {
        (0..sizes.len()).any(|camera| {
            let limit_px = NEW_SHARE * sizes[camera].0 as f64;
            match (&stand.corners[camera], &now.corners[camera]) {
                (Some(then), Some(now)) => apart_px(then, now).is_none_or(|px| px > limit_px),
                // A camera that did not see the board then sees something new.
                (None, Some(_)) => true,
                (_, None) => false,
            }
        })
    })
}

/// RMS distance of the corners that both have; `None` for too few.
fn apart_px(a: &[Sighting], b: &[Sighting]) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_u32);
    for one in a {
        if let Some(other) = b.iter().find(|o| o.point_in_board == one.point_in_board) {
            sum += (one.pixel - other.pixel).norm_squared();
            count += 1;
        }
    }
    (count >= LEAST_COMMON).then(|| (sum / f64::from(count)).sqrt())
}

/// Films that run together.
struct Films {
    streams: Vec<Stream>,
}

impl Moments for Films {
    fn names(&self) -> Vec<String> {
        let name = |s: &Stream| s.path.display().to_string();
        self.streams.iter().map(name).collect()
    }

    fn at(&mut self, due_s: f64, enough: &AtomicBool) -> Result<Option<(f64, Vec<Gray>)>, Fault> {
        let Some((first, others)) = self.streams.split_first_mut() else {
            return Ok(None);
        };
        let time_s = loop {
            match first.advance().map_err(told)? {
                Some(time_s) if time_s >= due_s => break time_s,
                Some(_) if !enough.load(Ordering::Relaxed) => {}
                _ => return Ok(None),
            }
        };
        for stream in others {
            if !stream.advance_to(time_s).map_err(told)? {
                return Ok(None);
            }
        }
        let grays = self.streams.iter().filter_map(Stream::gray).collect();
        Ok(Some((time_s, grays)))
    }
}

/// One film with its newest frame.
struct Stream {
    path: PathBuf,
    frames: Frames,
    newest: Option<TimedFrame>,
}

impl Stream {
    fn open(path: &Path) -> Result<Self, vergence_capture::CaptureError> {
        Ok(Self {
            path: path.to_owned(),
            frames: Frames::open(path, Path::new("ffmpeg"), OnFault::Refuse)?,
            newest: None,
        })
    }

    /// The next frame's time; `None` at the end, the last frame kept.
    fn advance(&mut self) -> Result<Option<f64>, vergence_capture::CaptureError> {
        let Some(next) = self.frames.next_frame()? else {
            return Ok(None);
        };
        let time_s = next.time_s;
        if let Some(old) = self.newest.replace(next) {
            self.frames.recycle(old.picture);
        }
        Ok(Some(time_s))
    }

    /// Go on to the frame nearest to a time from below, by half a period; false when the film has ended before.
    fn advance_to(&mut self, time_s: f64) -> Result<bool, vergence_capture::CaptureError> {
        let from_s = time_s - 0.5 / self.frames.fps();
        while self.newest.as_ref().is_none_or(|f| f.time_s < from_s) {
            if self.advance()?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn gray(&self) -> Option<Gray> {
        self.newest.as_ref().map(|f| luma_from_rgb(&f.picture))
    }
}

fn board(seen: Seen) -> Option<Vec<Sighting>> {
    match seen {
        Seen::Board(corners) => Some(corners),
        Seen::Nothing(_) => None,
    }
}
