//! The thread that reads one camera: it opens it again when it goes, places its frames on the run's clock, and hands them over through a
//! bounded queue in which the newest wins.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Serialize;
use vergence_geometry::Eye;
use vergence_imaging::Rgb;

use super::camera::{Camera, Got, Opener, Taken};
use super::look::{Look, Seen};
use super::stamps::{ClockDomain, Stamps};
use crate::CaptureError;
use crate::clock::{Clock as _, RealClock};
use crate::source::{CameraState, SourceEvent, SourceEventKind};

/// How long a camera is waited for at a time: so soon a thread that shall stop does.
const WAIT: Duration = Duration::from_millis(100);

/// Time until a camera that went is tried again: at first, and at most; it doubles from one to the next until a frame comes.
pub(crate) const BACK_OFF: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];

/// Longest wait at a time: a clock that is told nonsense does not hold the loop.
const LONGEST: Duration = Duration::from_secs(1);

/// Frames of one camera that wait for the loop; one more drops the oldest.
pub(crate) const QUEUE: usize = 8;

/// Buffers of one camera that wait to be used again.
const FREE: usize = 8;

/// Events that wait to be told; more are only counted.
pub(crate) const MOST_EVENTS: usize = 256;

/// A frame on the run's clock.
#[derive(Clone, Debug)]
pub(crate) struct LiveFrame {
    pub(crate) picture: Rgb,
    pub(crate) capture_s: f64,
    pub(crate) arrival_s: f64,
}

/// What one camera has given so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CameraCounts {
    /// Frames that came whole.
    pub frames: u64,
    /// Frames that the camera or its driver says were lost before they came (gaps in its numbers).
    pub lost: u64,
    /// Frames that came damaged and were not used.
    pub torn: u64,
    /// Frames of a frozen stream, which were not used.
    pub frozen: u64,
    /// Frames that the loop did not fetch in time.
    pub overrun: u64,
    /// How often the camera went.
    pub gone: u64,
    /// How often it was found again.
    pub back: u64,
    /// How often its clock jumped.
    pub clock_jumps: u64,
    /// Which clock the newest frame's time comes from.
    pub clock: ClockDomain,
}

/// One camera as its thread leaves it.
#[derive(Debug)]
pub(crate) struct Side {
    pub(crate) queue: VecDeque<LiveFrame>,
    pub(crate) free: Vec<Rgb>,
    pub(crate) counts: CameraCounts,
    pub(crate) state: CameraState,
    pub(crate) dark: bool,
    /// Capture time of the newest frame that was not frozen, s.
    pub(crate) newest_s: Option<f64>,
    /// Size of the pictures, once one has come.
    pub(crate) size: Option<(usize, usize)>,
    /// How often the camera was opened: frames of two openings have no common order.
    pub(crate) opened: u64,
    /// Nominal frame rate, when it is told.
    pub(crate) fps: Option<f64>,
}

/// Both cameras and what happened to them.
#[derive(Debug)]
pub(crate) struct State {
    pub(crate) sides: [Side; 2],
    pub(crate) events: VecDeque<SourceEvent>,
    pub(crate) events_left_out: u64,
}

/// What the threads and the source share.
#[derive(Debug)]
pub(crate) struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    pub(crate) stop: AtomicBool,
    pub(crate) clock: RealClock,
}

impl Shared {
    pub(crate) fn new(clock: RealClock) -> Self {
        let side = || Side {
            queue: VecDeque::new(),
            free: Vec::new(),
            counts: CameraCounts::default(),
            state: CameraState::Silent,
            dark: false,
            newest_s: None,
            size: None,
            opened: 0,
            fps: None,
        };
        Self {
            state: Mutex::new(State {
                sides: [side(), side()],
                events: VecDeque::new(),
                events_left_out: 0,
            }),
            changed: Condvar::new(),
            stop: AtomicBool::new(false),
            clock,
        }
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wait until something has changed or `until_s` on the run's clock.
    pub(crate) fn wait<'a>(
        &self,
        state: MutexGuard<'a, State>,
        until_s: f64,
    ) -> MutexGuard<'a, State> {
        let left_s = until_s - self.clock.now_s();
        let left = Duration::try_from_secs_f64(left_s)
            .unwrap_or_default()
            .min(LONGEST);
        let waited = self.changed.wait_timeout(state, left);
        waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

impl State {
    pub(crate) fn event(
        &mut self,
        time_s: f64,
        eye: Option<Eye>,
        kind: SourceEventKind,
        text: String,
    ) {
        if self.events.len() == MOST_EVENTS {
            self.events_left_out += 1;
            return;
        }
        self.events.push_back(SourceEvent {
            time_s,
            eye,
            kind,
            text,
        });
    }
}

impl Side {
    fn push(&mut self, frame: LiveFrame) {
        if self.queue.len() == QUEUE
            && let Some(old) = self.queue.pop_front()
        {
            self.counts.overrun += 1;
            self.recycle(old.picture);
        }
        self.queue.push_back(frame);
    }

    /// Keep a buffer for later.
    pub(crate) fn recycle(&mut self, picture: Rgb) {
        if self.free.len() < FREE {
            self.free.push(picture);
        }
    }
}

/// Which pictures a device gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Gives {
    /// Those of one eye.
    One(Eye),
    /// Both, side by side, the left one left.
    Both,
}

impl Gives {
    fn eyes(self) -> &'static [Eye] {
        match self {
            Gives::One(Eye::Left) => &[Eye::Left],
            Gives::One(Eye::Right) => &[Eye::Right],
            Gives::Both => &Eye::BOTH,
        }
    }

    fn eye(self) -> Option<Eye> {
        match self {
            Gives::One(eye) => Some(eye),
            Gives::Both => None,
        }
    }
}

/// What is new with a frame, and how it is told of its camera.
fn tidings(seen: &Seen, jumped: bool) -> impl Iterator<Item = (SourceEventKind, &'static str)> {
    let frozen = seen.froze.map(|is| match is {
        true => (
            SourceEventKind::Frozen,
            "gives the same picture again and again",
        ),
        false => (SourceEventKind::Thawed, "gives new pictures again"),
    });
    let dark = seen.darkened.map(|is| match is {
        true => (SourceEventKind::Dark, "gives black pictures"),
        false => (SourceEventKind::Light, "gives light pictures again"),
    });
    let jumped = jumped.then_some((
        SourceEventKind::ClockJumped,
        "has a clock that jumped; its times were set anew",
    ));
    [frozen, dark, jumped].into_iter().flatten()
}

/// Reads one device until it is told to stop.
pub(crate) struct Reader {
    pub(crate) shared: Arc<Shared>,
    pub(crate) opener: Box<dyn Opener>,
    pub(crate) gives: Gives,
    /// So many equal pictures are a frozen stream; 0 never asks.
    pub(crate) frozen_after: u32,
    /// Taken off times by arrival, s.
    pub(crate) delay_s: f64,
    /// Since when the camera is gone, s on the run's clock. One that can be opened is back when it gives a frame: a program starts also where there is nothing
    /// for it to fetch.
    pub(crate) gone_s: Option<f64>,
    /// Time until it is tried again.
    pub(crate) wait: Duration,
    /// So long without a frame, and the camera is opened anew.
    pub(crate) silence: Duration,
    /// The same until the first frame of an opening, where that is longer.
    pub(crate) start: Duration,
    /// Width and height of the first picture, once there was one: the calibration is one of this size.
    pub(crate) size: Option<(usize, usize)>,
}

impl Reader {
    /// Read; `camera` is open already.
    pub(crate) fn run(mut self, camera: Box<dyn Camera>) {
        let mut camera = Some(camera);
        while !self.stopped() {
            let open = match camera.take() {
                Some(open) => Some(open),
                None => self.reopen(),
            };
            let Some(open) = open else { return };
            let opener = self.opener.complaints();
            self.tell_complaints(opener);
            // A library that panics on what a device answers is one more device that broke off.
            let reason = catch_unwind(AssertUnwindSafe(|| self.read(open)));
            let reason = reason
                .unwrap_or_else(|_| Some("its driver's answer was not understood".to_owned()));
            if let Some(reason) = reason {
                self.tell_gone(&reason);
            }
        }
    }

    fn stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    fn sides(&self) -> &'static [Eye] {
        self.gives.eyes()
    }

    /// Frame after frame, until the camera goes (why) or the thread shall stop (`None`).
    fn read(&mut self, mut camera: Box<dyn Camera>) -> Option<String> {
        let mut look = Look::new(self.frozen_after);
        let mut stamps = Stamps::with_delay(self.delay_s);
        let mut last_s = self.shared.clock.now_s();
        let mut limit_s = self.silence.max(self.start).as_secs_f64();
        // When the first damaged picture since the last whole one came, and how many there were.
        let mut damaged: Option<(f64, u64)> = None;
        self.begin(camera.fps());
        loop {
            if self.stopped() {
                return None;
            }
            let reuse = {
                let mut state = self.shared.lock();
                let side = self.sides()[0] as usize;
                // Halves are cut out of whole pictures, which keep their own buffer.
                (self.gives != Gives::Both)
                    .then(|| state.sides[side].free.pop())
                    .flatten()
            };
            match camera.next(WAIT, reuse) {
                Ok(Got::Frame(taken)) => {
                    let (width, height) = taken.picture.size();
                    let (wanted, wanted_height) = *self.size.get_or_insert((width, height));
                    if (width, height) != (wanted, wanted_height) {
                        return Some(format!(
                            "gives {width}x{height} pixels now, not {wanted}x{wanted_height} as before: set it to that size again"
                        ));
                    }
                    last_s = self.shared.clock.now_s();
                    damaged = None;
                    limit_s = self.silence.as_secs_f64();
                    self.tell_back();
                    self.take(taken, &mut look, &mut stamps);
                }
                Ok(Got::Torn { lost }) => {
                    last_s = self.shared.clock.now_s();
                    let (since_s, count) = damaged.get_or_insert((last_s, 0));
                    *count += 1;
                    let (damaged_s, count) = (last_s - *since_s, *count);
                    let mut state = self.shared.lock();
                    for &eye in self.sides() {
                        let counts = &mut state.sides[eye as usize].counts;
                        counts.torn += 1;
                        counts.lost += lost;
                    }
                    drop(state);
                    if damaged_s >= self.damaged_limit_s() {
                        return Some(format!(
                            "gave nothing but {count} damaged pictures for {damaged_s:.1} s: look at its cable, and whether both cameras share one USB controller"
                        ));
                    }
                }
                Ok(Got::Nothing) => {
                    let silent_s = self.shared.clock.now_s() - last_s;
                    if silent_s >= limit_s {
                        return Some(format!("gave no picture for {silent_s:.1} s"));
                    }
                    // A camera that is gone is gone until it gives a frame, however often it can be opened.
                    if silent_s > self.silence.as_secs_f64() / 4.0 && self.gone_s.is_none() {
                        self.set_state(CameraState::Silent);
                    }
                }
                Err(error) => return Some(error.to_string()),
            }
        }
    }

    /// After how long with damaged pictures alone a camera has gone, s. A stream may begin with pictures that lean on one that was not seen, and the next that
    /// does not may take seconds: half of the time that a start may take, so that a start that fails is told with its cause.
    fn damaged_limit_s(&self) -> f64 {
        self.silence.max(self.start / 2).as_secs_f64()
    }

    fn begin(&self, fps: Option<f64>) {
        let mut state = self.shared.lock();
        for &eye in self.sides() {
            let side = &mut state.sides[eye as usize];
            side.opened += 1;
            side.fps = fps;
            // The look at an opening begins with light pictures.
            side.dark = false;
            side.queue.clear();
        }
    }

    fn set_state(&self, to: CameraState) {
        let mut state = self.shared.lock();
        for &eye in self.sides() {
            state.sides[eye as usize].state = to;
        }
    }

    /// Hand a frame over.
    fn take(&self, taken: Taken, look: &mut Look, stamps: &mut Stamps) {
        let seen = look.take(taken.print, &taken.picture);
        let arrival_s = self.shared.clock.now_s();
        let placed = stamps.place(taken.stamp, arrival_s);
        let lost = taken.lost;
        let mut pictures: Vec<Rgb> = match self.gives {
            Gives::One(_) => vec![taken.picture],
            Gives::Both => {
                let free = {
                    let mut state = self.shared.lock();
                    [0, 1].map(|i| state.sides[i].free.pop())
                };
                halves(&taken.picture, free).into()
            }
        };
        let mut state = self.shared.lock();
        let name = |what: &str| format!("{} {what}", self.opener.name());
        for &eye in self.sides().iter().rev() {
            let side = &mut state.sides[eye as usize];
            let Some(picture) = pictures.pop() else {
                return;
            };
            side.size = Some(picture.size());
            side.counts.frames += 1;
            side.counts.lost += lost;
            side.counts.clock = placed.domain;
            side.counts.clock_jumps += u64::from(placed.jumped);
            side.dark = seen.darkened.unwrap_or(side.dark);
            if seen.frozen {
                side.counts.frozen += 1;
                side.state = CameraState::Frozen;
                side.recycle(picture);
                continue;
            }
            side.state = CameraState::Live;
            side.newest_s = Some(placed.capture_s);
            side.push(LiveFrame {
                picture,
                capture_s: placed.capture_s,
                arrival_s,
            });
        }
        for (kind, text) in tidings(&seen, placed.jumped) {
            state.event(arrival_s, self.gives.eye(), kind, name(text));
        }
        drop(state);
        self.shared.changed.notify_all();
    }

    fn tell_complaints(&self, complaints: Vec<String>) {
        let now_s = self.shared.clock.now_s();
        let mut state = self.shared.lock();
        for text in complaints {
            state.event(now_s, self.gives.eye(), SourceEventKind::Control, text);
        }
    }

    fn tell_gone(&mut self, reason: &str) {
        let now_s = self.shared.clock.now_s();
        let known = self.gone_s.is_some();
        self.gone_s.get_or_insert(now_s);
        let mut state = self.shared.lock();
        for &eye in self.sides() {
            let side = &mut state.sides[eye as usize];
            side.state = CameraState::Gone;
            side.counts.gone += u64::from(!known);
            side.queue.clear();
        }
        if known {
            return;
        }
        let text = format!("{} went: {reason}", self.opener.name());
        state.event(now_s, self.gives.eye(), SourceEventKind::Gone, text);
        drop(state);
        self.shared.changed.notify_all();
    }

    /// The camera gives frames: when it was gone, it is back.
    fn tell_back(&mut self) {
        self.wait = BACK_OFF[0];
        let Some(from_s) = self.gone_s.take() else {
            return;
        };
        let now_s = self.shared.clock.now_s();
        let text = format!(
            "{} is back after {:.1} s",
            self.opener.name(),
            now_s - from_s
        );
        let mut state = self.shared.lock();
        for &eye in self.sides() {
            state.sides[eye as usize].counts.back += 1;
        }
        state.event(now_s, self.gives.eye(), SourceEventKind::Back, text);
    }

    /// Open the camera again, as often as it takes; `None` when the thread shall stop.
    fn reopen(&mut self) -> Option<Box<dyn Camera>> {
        loop {
            let mut left = self.wait;
            while !left.is_zero() {
                if self.stopped() {
                    return None;
                }
                let step = WAIT.min(left);
                std::thread::sleep(step);
                left -= step;
            }
            self.wait = (2 * self.wait).min(BACK_OFF[1]);
            let opener = &mut self.opener;
            let opened = catch_unwind(AssertUnwindSafe(|| opener.open()));
            let opened: Option<Result<_, CaptureError>> = opened.ok();
            if let Some(Ok(camera)) = opened {
                return Some(camera);
            }
        }
    }
}

/// Left and right half of a picture; a column in the middle of an odd width belongs to neither.
pub(super) fn halves(both: &Rgb, free: [Option<Rgb>; 2]) -> [Rgb; 2] {
    let (width, height) = both.size();
    let half = width / 2;
    let starts = [0, width - half];
    let mut free = free.into_iter();
    starts.map(|start| {
        let mut out = match free.next().flatten() {
            Some(old) if old.size() == (half, height) => old,
            _ => Rgb::filled(half, height, [0; 3]),
        };
        for y in 0..height {
            out.row_mut(y)
                .copy_from_slice(&both.row(y)[start..start + half]);
        }
        out
    })
}
