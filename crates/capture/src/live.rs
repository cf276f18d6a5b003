//! Stereo from cameras as it happens: video devices of the machine, network cameras, anything that `ffmpeg` reads.
//!
//! One thread for each device reads it, opens it again when it goes, and hands its frames over through a bounded queue in which the
//! newest wins. Pairs are made by time ([`crate::pairing`]), a steady offset of the two streams taken out first. The loop is never
//! held for ever: [`crate::Source::next_within`] comes back without a pair when none is there in time, and [`crate::Source::liveness`] says which
//! camera is to blame.

mod abilities;
mod agreed;
#[cfg(test)]
mod arbitrary;
mod camera;
mod look;
mod offset;
mod open;
#[cfg(any(feature = "v4l2", feature = "rtsp", test))]
mod pixels;
mod program;
mod reader;
#[cfg(feature = "rtsp")]
mod rtsp;
mod settings;
mod spread;
mod stamps;
mod statistics;
#[cfg(test)]
mod tests;
#[cfg(feature = "v4l2")]
mod v4l2;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

use nalgebra::Isometry3;
use vergence_calib::RigCalibration;
use vergence_geometry::{Camera, Distortion, Eye, Intrinsics};

pub use abilities::{Abilities, ControlOffer, FormatOffer, SizeOffer, reads_devices};
pub use agreed::{Agreement, CameraMode, LockedControl};
pub use reader::CameraCounts;
pub use settings::{
    LiveConfig, LiveInput, LiveKind, PixelFormat, Transport, V4l2Controls, V4l2Settings,
};
pub use spread::SpreadSummary;
pub use stamps::ClockDomain;
pub use statistics::{CameraStatistics, LiveStatistics};

use self::offset::Offset;
use self::reader::{BACK_OFF, Gives, LiveFrame, Reader, Shared, State};
use self::spread::Spread;
use self::statistics::Measure;
use crate::CaptureError;
use crate::clock::{Clock as _, RealClock};
use crate::pairing::{Paired, Pairer, PairingLimits};
use crate::source::{
    Frame, Liveness, Next, Source, SourceEvent, SourceEventKind, SourceInfo, StereoFrame,
};

/// The offset is worked out anew after so many frames.
const OFFSET_EVERY: u64 = 8;

/// How long is waited for the first pair before it is asked whether anybody still wants it, s.
const LOOK_S: f64 = 0.05;

/// Changes of the offset below this part of a period are not followed: they are smaller than what pairing has to bear anyway.
const OFFSET_STEP: f64 = 0.02;

/// Changes above this part of a period are told.
const OFFSET_TOLD: f64 = 0.1;

/// A rate is kept while the measured one is within this part of it.
const RATE_BELIEVED: f64 = 0.1;

/// So many looks in a row, one every [`OFFSET_EVERY`] frames, must say that the rate is another one: a second and a half of both cameras at
/// 30 frames a second, so that the median has forgotten a burst.
const RATE_LOOKS: u32 = 12;

/// What is known of the rig whose cameras these are.
#[derive(Clone, Copy, Debug)]
pub enum LiveRig<'a> {
    /// The cameras stand still.
    Fixed(&'a RigCalibration),
    /// Motors move the cameras; these are their lenses.
    Moving(&'a [Camera; 2]),
    /// Nothing is known yet: cameras that are to be calibrated. Video devices are asked for pictures of this width and height; whatever size
    /// both streams have will do. [`SourceInfo::cameras`] are then pinholes as long as the picture is wide, which stand for nothing.
    Unknown {
        /// Width and height, px.
        size: (usize, usize),
    },
}

impl LiveRig<'_> {
    fn cameras(&self) -> [Camera; 2] {
        match self {
            LiveRig::Fixed(calibration) => calibration.cameras,
            LiveRig::Moving(cameras) => **cameras,
            LiveRig::Unknown { size } => [unknown(*size); 2],
        }
    }
}

/// A pinhole that stands for a lens of which nothing is known, as long as its sensor is wide.
fn unknown((width, height): (usize, usize)) -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(1.0, 1.0, width, height),
        distortion: Distortion::NONE,
    }
}

/// A [`Source`] of cameras as they see now.
///
/// Dropping it stops its threads, which takes up to a tenth of a second, longer while a stream is being opened.
#[derive(Debug)]
pub struct LiveSource {
    info: SourceInfo,
    calibration: Option<RigCalibration>,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    names: [String; 2],
    remarks: Vec<String>,
    agreement: Agreement,
    patience_s: f64,
    pairer: Pairer<LiveFrame>,
    frozen_after: u32,
    /// Largest time between the exposures of a pair, s, where one was set.
    max_apart_s: f64,
    period_s: f64,
    /// How many looks in a row found another rate.
    other_rate: u32,
    offset: Offset,
    /// Taken off the right times before pairing, s.
    correction_s: f64,
    found: Option<offset::Steady>,
    frames: u64,
    measures: [Measure; 2],
    skew: Spread,
    opened: [u64; 2],
    skipped_pairs: u64,
    too_far_apart: u64,
    stalls: u64,
    passed: Option<u64>,
}

impl LiveSource {
    /// Open the cameras, and wait until both give pictures and their rate is known. All times are on `clock`.
    ///
    /// # Errors
    /// One sentence for each thing that can be wrong: no such device, no permission, in use, no camera at all, formats or sizes that
    /// differ between the eyes, no picture within [`LiveConfig::start_s`], a calibration for other pictures.
    pub fn open(
        config: &LiveConfig,
        rig: LiveRig<'_>,
        clock: &RealClock,
    ) -> Result<Self, CaptureError> {
        config.check()?;
        let wanted = rig.cameras();
        let size = |i: usize| (wanted[i].intrinsics.width, wanted[i].intrinsics.height);
        let opened = open::open(config, [size(0), size(1)], clock)?;
        Self::start(config, opened, rig, clock)
    }

    /// Read devices that are open.
    fn start(
        config: &LiveConfig,
        opened: open::Opened,
        rig: LiveRig<'_>,
        clock: &RealClock,
    ) -> Result<Self, CaptureError> {
        let names = opened.names();
        let shared = Arc::new(Shared::new(clock.clone()));
        let mut source = Self {
            info: SourceInfo {
                name: config.name(),
                cameras: rig.cameras(),
                fixed_base_from_cam: None,
                fps: 0.0,
                pairs: None,
            },
            calibration: None,
            shared: Arc::clone(&shared),
            threads: Vec::new(),
            names,
            agreement: opened.agreement(),
            remarks: opened.remarks,
            patience_s: config.patience_s,
            pairer: Pairer::new(PairingLimits::for_fps(1.0))?,
            frozen_after: config.frozen_after,
            max_apart_s: config.max_apart_s.unwrap_or(f64::INFINITY),
            period_s: 1.0,
            other_rate: 0,
            offset: Offset::default(),
            correction_s: 0.0,
            found: None,
            frames: 0,
            measures: Default::default(),
            skew: Spread::default(),
            opened: [0; 2],
            skipped_pairs: 0,
            too_far_apart: 0,
            stalls: 0,
            passed: None,
        };
        for device in opened.devices {
            let thread = reading(device, config, &shared)?;
            source.threads.push(thread);
        }
        source.begin(config)?;
        source.fit(rig)?;
        Ok(source)
    }

    /// Wait for the first pictures of both, and for their rate.
    fn begin(&mut self, config: &LiveConfig) -> Result<(), CaptureError> {
        let until_s = self.shared.clock.now_s() + config.start_s;
        let shared = Arc::clone(&self.shared);
        let mut state = shared.lock();
        let (period_s, told) = loop {
            for frame in self.fetch(&mut state) {
                let side = &mut state.sides[frame.0 as usize];
                side.recycle(frame.1.picture);
            }
            let told = state.sides[0].fps.or(state.sides[1].fps);
            if let Some(period_s) = self.offset.period_s() {
                break (period_s, told);
            }
            let silent = state.sides.iter().position(|s| s.size.is_none());
            let refused = silent.is_some_and(|i| state.sides[i].counts.gone > 0);
            if refused || shared.clock.now_s() >= until_s {
                let silent = silent.unwrap_or(0);
                let why = state
                    .events
                    .iter()
                    .rev()
                    .find(|e| e.kind == SourceEventKind::Gone);
                return Err(CaptureError::Camera {
                    what: if refused {
                        "gave no picture".to_owned()
                    } else {
                        format!("gave too few pictures within {} s", config.start_s)
                    },
                    why: why.map_or_else(|| "nothing came".to_owned(), |e| e.text.clone()),
                    camera: self.names[silent].clone(),
                });
            }
            state = shared.wait(state, until_s);
        };
        // What is said is believed at first: streams often begin with a burst. A rate that stays another one is followed.
        let fps = config.fps.or(told).unwrap_or(1.0 / period_s);
        drop(state);
        self.info.fps = fps;
        self.period_s = 1.0 / fps;
        self.pairer.set_limits(self.limits())
    }

    /// What pairing may do at the present period.
    fn limits(&self) -> PairingLimits {
        let mut limits = PairingLimits::for_fps(1.0 / self.period_s);
        limits.max_apart_s = limits.max_apart_s.min(self.max_apart_s);
        limits
    }

    /// Follow the cameras' rate, when several looks in a row say that it has become another one.
    fn follow_rate(&mut self, state: &mut State) {
        let Some(period_s) = self.offset.period_s() else {
            return;
        };
        if (period_s / self.period_s - 1.0).abs() <= RATE_BELIEVED {
            self.other_rate = 0;
            return;
        }
        self.other_rate += 1;
        if self.other_rate < RATE_LOOKS {
            return;
        }
        let (before, now) = (1.0 / self.period_s, 1.0 / period_s);
        let text = format!(
            "the cameras give {now:.1} pictures a second, not {before:.1}; dim light makes many cameras slower"
        );
        self.other_rate = 0;
        self.period_s = period_s;
        // A period that is measured makes limits that fit each other; if not, the ones of before stay.
        let _ = self.pairer.set_limits(self.limits());
        let now_s = self.shared.clock.now_s();
        state.event(now_s, None, SourceEventKind::Rate, text);
    }

    /// The pictures' size against each other and against the calibration.
    fn fit(&mut self, rig: LiveRig<'_>) -> Result<(), CaptureError> {
        let sizes = {
            let state = self.shared.lock();
            [0, 1].map(|i| state.sides[i].size.unwrap_or_default())
        };
        if sizes[0] != sizes[1] {
            return Err(CaptureError::Unequal(format!(
                "{} gives {}x{} pixels, {} {}x{}; set both to one size",
                self.names[0], sizes[0].0, sizes[0].1, self.names[1], sizes[1].0, sizes[1].1
            )));
        }
        for (mode, size) in self.agreement.modes.iter_mut().zip(sizes) {
            mode.size = size;
        }
        match rig {
            LiveRig::Fixed(calibration) => {
                let calibration = calibration.scaled_to([sizes[0]; 2])?;
                self.info.cameras = calibration.cameras;
                self.info.fixed_base_from_cam = Some(calibration.base_from_cam);
                self.remarks.extend(calibration.notes.iter().cloned());
                self.calibration = Some(calibration);
            }
            LiveRig::Unknown { .. } => self.info.cameras = [unknown(sizes[0]); 2],
            LiveRig::Moving(cameras) => {
                let k = &cameras[0].intrinsics;
                if (k.width, k.height) != sizes[0] {
                    return Err(CaptureError::Unequal(format!(
                        "the machine was calibrated with pictures of {}x{} pixels, the cameras give {}x{}",
                        k.width, k.height, sizes[0].0, sizes[0].1
                    )));
                }
            }
        }
        Ok(())
    }

    /// The calibration, scaled to the pictures; `None` when motors move the cameras.
    pub fn calibration(&self) -> Option<&RigCalibration> {
        self.calibration.as_ref()
    }

    /// Where the cameras stand, if they stand still.
    pub fn fixed_base_from_cam(&self) -> Option<[Isometry3<f64>; 2]> {
        self.info.fixed_base_from_cam
    }

    /// The clock that its times are on.
    pub fn clock(&self) -> &RealClock {
        &self.shared.clock
    }

    /// What the user should know and may not expect.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// What was measured so far.
    pub fn statistics(&self) -> LiveStatistics {
        let state = self.shared.lock();
        let camera = |i: usize| {
            let side = &state.sides[i];
            self.measures[i].told(self.names[i].clone(), side.counts, side.state)
        };
        LiveStatistics {
            left: camera(0),
            right: camera(1),
            pairing: *self.pairer.counts(),
            skipped_pairs: self.skipped_pairs,
            too_far_apart: self.too_far_apart,
            stalls: self.stalls,
            skew: self.skew.summary(),
            offset_s: self.found.map(|f| f.offset_s),
            offset_ambiguous: self.found.is_some_and(|f| f.ambiguous),
            offset_of_exposure: of_exposure(&state),
            events_left_out: state.events_left_out,
        }
    }

    /// Frames that wait, with their eyes; measured on the way.
    fn fetch(&mut self, state: &mut State) -> Vec<(Eye, LiveFrame)> {
        let mut frames = Vec::new();
        for eye in Eye::BOTH {
            let (i, side) = (eye as usize, &mut state.sides[eye as usize]);
            if side.opened != self.opened[i] {
                self.opened[i] = side.opened;
                self.measures[i].restart();
                self.offset.clear();
            }
            for frame in side.queue.drain(..) {
                self.measures[i].take(&frame);
                self.offset.take(eye == Eye::Right, frame.capture_s);
                self.frames += 1;
                frames.push((eye, frame));
            }
        }
        frames
    }

    /// Follow the steady offset, and tell when it becomes another one.
    fn follow_offset(&mut self, state: &mut State) {
        let Some(steady) = self.offset.steady() else {
            return;
        };
        let before = self.found.map(|f| f.offset_s);
        let steady = match before {
            Some(before_s) => steady.counted_on(before_s, self.period_s),
            None => steady,
        };
        let change_s = steady.offset_s - before.unwrap_or(0.0);
        if change_s.abs() >= OFFSET_STEP * self.period_s {
            self.correction_s = steady.offset_s;
        }
        if change_s.abs() >= OFFSET_TOLD * self.period_s {
            let now_s = self.shared.clock.now_s();
            let text = offset_text(&steady, of_exposure(state));
            state.event(now_s, None, SourceEventKind::Offset, text);
        }
        if before.is_none() || change_s.abs() >= OFFSET_STEP * self.period_s {
            self.found = Some(steady);
        }
    }

    /// Take what has come and give the newest pair of it.
    fn take(&mut self, state: &mut State) -> Option<StereoFrame> {
        let before = self.frames / OFFSET_EVERY;
        for (eye, frame) in self.fetch(state) {
            let correction_s = if eye == Eye::Right {
                self.correction_s
            } else {
                0.0
            };
            self.pairer.push(eye, frame.capture_s - correction_s, frame);
        }
        if self.frames / OFFSET_EVERY != before {
            self.follow_rate(state);
            self.follow_offset(state);
        }
        let exposure = of_exposure(state);
        let mut newest: Option<StereoFrame> = None;
        while let Some(paired) = self.pairer.pop() {
            let Some(pair) = self.pair(paired, exposure, state) else {
                continue;
            };
            if let Some(old) = newest.replace(pair) {
                self.skipped_pairs += 1;
                recycle(state, old);
            }
        }
        newest
    }

    /// A pair from two frames; `None` when their exposures are further apart than the limit that was set.
    fn pair(
        &mut self,
        paired: Paired<LiveFrame>,
        exposure: bool,
        state: &mut State,
    ) -> Option<StereoFrame> {
        let skew_s = (paired.left_s - paired.right_s).abs();
        let frame = |live: LiveFrame, capture_s: f64| Frame {
            picture: live.picture,
            capture_s,
            arrival_s: live.arrival_s,
        };
        // Unlike clocks: what pairing believes is what is told. One clock: each frame keeps its own time.
        let right_s = if exposure {
            paired.right.capture_s
        } else {
            paired.right_s
        };
        let counts = self.pairer.counts();
        let pair = StereoFrame {
            index: (counts.paired + counts.lost_pairs).saturating_sub(1),
            left: frame(paired.left, paired.left_s),
            right: frame(paired.right, right_s),
        };
        if (pair.left.capture_s - pair.right.capture_s).abs() > self.max_apart_s {
            self.too_far_apart += 1;
            recycle(state, pair);
            return None;
        }
        self.skew.add(skew_s);
        Some(pair)
    }

    /// Wait for a pair until `until_s` on the run's clock.
    fn wait_for_pair(&mut self, until_s: f64, reuse: Option<StereoFrame>) -> Option<StereoFrame> {
        let shared = Arc::clone(&self.shared);
        let mut state = shared.lock();
        if let Some(old) = reuse {
            recycle(&mut state, old);
        }
        loop {
            if let Some(mut pair) = self.take(&mut state) {
                // A correction that changes could make two pairs of one number.
                pair.index = pair.index.max(self.passed.map_or(0, |last| last + 1));
                self.passed = Some(pair.index);
                return Some(pair);
            }
            if shared.clock.now_s() >= until_s {
                self.stalls += 1;
                return None;
            }
            state = shared.wait(state, until_s);
        }
    }
}

impl Source for LiveSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    /// The next pair, waiting at most [`LiveConfig::patience_s`]; none until then is an error, after which it may be asked again.
    fn next_pair(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> Result<Option<StereoFrame>, CaptureError> {
        let until_s = self.shared.clock.now_s() + self.patience_s;
        match self.wait_for_pair(until_s, reuse) {
            Some(pair) => Ok(Some(pair)),
            None => Err(self.silence()),
        }
    }

    fn next_within(
        &mut self,
        wait_s: f64,
        reuse: Option<StereoFrame>,
    ) -> Result<Next, CaptureError> {
        // What is no number waits for nothing.
        let until_s = self.shared.clock.now_s() + wait_s.max(0.0);
        let pair = self.wait_for_pair(until_s, reuse);
        Ok(pair.map_or(Next::Stalled, Next::Pair))
    }

    fn dropped_pairs(&self) -> u64 {
        self.pairer.counts().lost_pairs + self.skipped_pairs + self.too_far_apart
    }

    fn liveness(&self) -> Option<[Liveness; 2]> {
        let state = self.shared.lock();
        Some([0, 1].map(|i| {
            let side = &state.sides[i];
            Liveness {
                state: side.state,
                newest_s: side.newest_s,
                dark: side.dark,
            }
        }))
    }

    fn take_events(&mut self) -> Vec<SourceEvent> {
        self.shared.lock().events.drain(..).collect()
    }
}

impl LiveSource {
    /// How often a picture must come again bit for bit until its camera counts as frozen; 0: never ([`LiveConfig::frozen_after`]).
    pub fn frozen_after(&self) -> u32 {
        self.frozen_after
    }

    /// [`Source::next_pair`] that can be given up: then `None`.
    ///
    /// # Errors
    /// When no pair comes within [`LiveConfig::patience_s`].
    pub fn next_pair_unless(
        &mut self,
        given_up: &dyn Fn() -> bool,
    ) -> Result<Option<StereoFrame>, CaptureError> {
        let until_s = self.shared.clock.now_s() + self.patience_s;
        let stalls = self.stalls;
        loop {
            let now_s = self.shared.clock.now_s();
            if let Some(pair) = self.wait_for_pair(until_s.min(now_s + LOOK_S), None) {
                self.stalls = stalls;
                return Ok(Some(pair));
            }
            if given_up() {
                return Ok(None);
            }
            if now_s >= until_s {
                return Err(self.silence());
            }
        }
    }

    /// Why no pair came.
    fn silence(&self) -> CaptureError {
        let state = self.shared.lock();
        let now_s = self.shared.clock.now_s();
        let told = |i: usize| {
            let side = &state.sides[i];
            let age = side
                .newest_s
                .map(|s| format!("its newest picture is {:.1} s old", now_s - s));
            let what = format!("{:?}", side.state).to_lowercase();
            format!(
                "{} is {what}, {}",
                self.names[i],
                age.unwrap_or_else(|| "it gave none".to_owned())
            )
        };
        CaptureError::Camera {
            what: format!("gave no pair for {} s", self.patience_s),
            why: format!("{}; {}", told(0), told(1)),
            camera: self.info.name.clone(),
        }
    }
}

impl Drop for LiveSource {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic of the thread has ended its camera already; there is nobody left to tell.
            let _ = thread.join();
        }
    }
}

/// The thread that reads a device.
fn reading(
    device: open::Attached,
    config: &LiveConfig,
    shared: &Arc<Shared>,
) -> Result<JoinHandle<()>, CaptureError> {
    let open::Attached {
        opener,
        camera,
        gives,
    } = device;
    let reader = Reader {
        shared: Arc::clone(shared),
        opener,
        gives,
        frozen_after: config.frozen_after,
        delay_s: config.delay_s,
        gone_s: None,
        wait: BACK_OFF[0],
        silence: Duration::from_secs_f64(config.silence_s),
        start: Duration::from_secs_f64(config.start_s),
        size: None,
    };
    let name = match gives {
        Gives::One(Eye::Left) => "left camera",
        Gives::One(Eye::Right) => "right camera",
        Gives::Both => "both cameras",
    };
    let thread = std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(move || reader.run(camera));
    thread.map_err(|error| CaptureError::Camera {
        what: "the thread that reads it could not be started".to_owned(),
        why: error.to_string(),
        camera: name.to_owned(),
    })
}

fn recycle(state: &mut State, pair: StereoFrame) {
    state.sides[0].recycle(pair.left.picture);
    state.sides[1].recycle(pair.right.picture);
}

/// Whether both cameras are stamped by the machine's own clock, so that their times can be compared as they are.
fn of_exposure(state: &State) -> bool {
    state
        .sides
        .iter()
        .all(|s| s.counts.clock == ClockDomain::Machine)
}

fn offset_text(steady: &offset::Steady, exposure: bool) -> String {
    let ms = steady.offset_s * 1e3;
    let mut text = if exposure {
        format!(
            "right pictures are taken {ms:+.1} ms after the left ones: what moves 1 m/s across is seen {:.0} mm displaced; a common trigger is the cure",
            ms.abs()
        )
    } else {
        format!(
            "right pictures are stamped {ms:+.1} ms after the left ones; that was taken out of their times"
        )
    };
    if steady.ambiguous {
        text.push_str("; being near half a period it may as well be the other neighbour's");
    }
    text
}
