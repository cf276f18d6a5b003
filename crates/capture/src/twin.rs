//! The simulated rig as a source: the world is rendered as the cameras on the moving head see it.

mod rehearsed;

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use vergence_control::{AxisError, HeadConfig, SimulatedHead};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::hash::{mix, uniform_from};
use vergence_scene::{Light, Mark, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

use crate::CaptureError;
use crate::clock::{Clock as _, RealClock};
use crate::source::{Frame, Source, SourceInfo, StereoFrame};

pub use rehearsed::Rehearsed;

/// For so many frames back the truth is kept.
pub const TRUTH_KEPT: usize = 256;

/// Frame rates of the twin, 1/s: below, the motors' history would not reach from frame to frame.
const FPS: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

/// How long the twin runs in an empty room when no time is set, s.
const EMPTY_ROOM_S: f64 = 10.0;

/// A camera that is knocked further looks elsewhere.
const MOST_KNOCK_RAD: f64 = 0.35;

/// Longest run, s: one day.
const MAX_SECONDS: f64 = 86_400.0;

/// The twin: who walks where, what the cameras and the head are, and what is wrong with them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TwinConfig {
    /// Where the person goes.
    pub path: PathSpec,
    /// How much light there is. The cameras' exposure does not follow it; see [`TwinCamera::for_light`].
    pub light: Light,
    /// Chooses everything that is left to chance: the world's looks, noise, jitter, dropped frames.
    pub seed: u64,
    /// Pairs a second, 1..=1000.
    pub fps: f64,
    /// How long it runs, s; until the walker has come to rest when `None` (10 s in an empty room).
    pub seconds: Option<f64>,
    /// Left and right camera.
    pub cameras: [TwinCamera; 2],
    /// How much later (or, negative, earlier) than the nominal time each camera exposes, s; less than half a period.
    pub eye_offset_s: [f64; 2],
    /// From the end of the exposure until the picture is there to be processed: readout and transfer, s; >= 0.
    pub latency_s: f64,
    /// The latency varies evenly from 0 to this much more, s; >= 0.
    pub latency_jitter_s: f64,
    /// Probability that a pair is lost on the way, 0..=1.
    pub drop_probability: f64,
    /// Dimensions of the head.
    pub geometry: HeadGeometry,
    /// Motors of the head.
    pub head: HeadConfig,
    /// A knock that turns the right camera on its mount in mid-run; nobody is told.
    pub knock: Knock,
}

/// Something hits the right camera: from a time on it is turned against its mount.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Knock {
    /// When, s.
    pub time_s: f64,
    /// How much higher it looks, rad.
    pub pitch_rad: f64,
    /// How much further right it looks, rad.
    pub yaw_rad: f64,
    /// How much it is rolled clockwise, as seen from behind, rad.
    pub roll_rad: f64,
}

impl Default for Knock {
    /// Nothing happens (after 5 s).
    fn default() -> Self {
        Self {
            time_s: 5.0,
            pitch_rad: 0.0,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        }
    }
}

impl Knock {
    /// `cam_from_base` of a camera after the knock, if it is the right one and the time has come.
    fn applied(&self, eye: Eye, time_s: f64, cam_from_base: Isometry3<f64>) -> Isometry3<f64> {
        let turn = Vector3::new(self.pitch_rad, self.yaw_rad, self.roll_rad);
        if eye == Eye::Left || time_s < self.time_s || turn == Vector3::zeros() {
            return cam_from_base;
        }
        UnitQuaternion::from_scaled_axis(turn).inverse() * cam_from_base
    }
}

impl Default for TwinConfig {
    /// The paper's rig with the twin's default cameras and motors at 30 fps. From mid-exposure to arrival it takes 2 ms (half
    /// an exposure) + 18 ms + up to 0.5 ms: readout in about half a period and a transfer over USB 3, round figures. `docs/parts.md` names the parts.
    fn default() -> Self {
        Self {
            path: PathSpec::Walk,
            light: Light::Day,
            seed: 1,
            fps: 30.0,
            seconds: None,
            cameras: [TwinCamera::default(); 2],
            eye_offset_s: [0.0; 2],
            latency_s: 0.018,
            latency_jitter_s: 0.0005,
            drop_probability: 0.0,
            geometry: HeadGeometry {
                interaxial_m: 0.07,
                pupil_m: 0.0,
            },
            head: HeadConfig::default(),
            knock: Knock::default(),
        }
    }
}

/// Tells where the axes stood at a time that has passed, s on the run's clock.
pub type Standing = Arc<dyn Fn(f64) -> Result<HeadAngles, AxisError> + Send + Sync>;

/// So long after the end of an exposure motors that are not simulated have told where they stood, s.
const TOLD_S: f64 = 0.012;

/// A real camera does not wait: a frame that would be taken this many periods late is lost.
const LATE_PERIODS: f64 = 1.0;

/// What was true of one frame. Where there are two, they belong to the left and to the right camera and to the middle of
/// its own exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwinTruth {
    /// Number of the frame.
    pub frame: u64,
    /// Middle of the exposure, s.
    pub capture_s: [f64; 2],
    /// Where the axes truly stood, with backlash and home offset.
    pub angles: [HeadAngles; 2],
    /// Where the cameras truly stood.
    pub cam_from_base: [Isometry3<f64>; 2],
    /// The target's reference point, base frame; `None` in an empty room.
    pub target_in_base: [Option<Point3<f64>>; 2],
    /// Its pixel, lens distortion included; may lie outside the picture. `None` behind the camera.
    pub target_px: [Option<Point2<f64>>; 2],
    /// The same with the lens distortion taken out.
    pub target_undistorted_px: [Option<Point2<f64>>; 2],
    /// Distance of the reference point from the base's origin at the mean of the two times, m.
    pub range_m: Option<f64>,
    /// Whether something stands between the base's origin and the reference point at the mean of the two times.
    pub occluded: bool,
    /// How much of the target's torso is in sight of the base's origin, 0..=1.
    pub visible_fraction: f64,
}

impl TwinTruth {
    /// Disparity `u_l - u_r` of the reference point with the lens distortion taken out, pixels: the vergence error in
    /// mode `converged`. `None` where a camera does not have it in front.
    pub fn disparity_px(&self) -> Option<f64> {
        let [left, right] = self.target_undistorted_px;
        Some(left?.x - right?.x)
    }
}

/// The twin as a [`Source`].
///
/// Frame k is exposed around k / fps. [`Source::next_pair`] first runs the head's motors up to the end of that exposure, so
/// everything that the loop commanded for earlier times must have been commanded before the call: the pictures of
/// frame k + 1 show what was made of frame k. Pairs that were dropped leave gaps in [`StereoFrame::index`].
pub struct TwinSource {
    info: SourceInfo,
    config: TwinConfig,
    world: Arc<World>,
    renderer: Renderer,
    head: SimulatedHead,
    standing: Standing,
    /// Set when the motors are not simulated: their clock, which is the run's.
    clock: Option<RealClock>,
    next_frame: u64,
    frames: u64,
    dropped: u64,
    truths: VecDeque<TwinTruth>,
    rehearsed: Rehearsed,
}

impl TwinSource {
    /// A twin at time 0 with its head homed and looking straight ahead.
    ///
    /// # Errors
    /// Settings out of range, and paths that cannot be walked.
    pub fn new(config: TwinConfig) -> Result<Self, CaptureError> {
        let marks = Vec::new();
        Self::with_marks(config, marks)
    }

    /// The same with calibration marks in the room.
    ///
    /// # Errors
    /// As [`Self::new`], and marks that cannot be shown.
    pub fn with_marks(config: TwinConfig, marks: Vec<Mark>) -> Result<Self, CaptureError> {
        check(&config)?;
        let world = Arc::new(World::new(&WorldConfig {
            path: config.path.clone(),
            light: config.light,
            seed: config.seed,
            marks,
        })?);
        world.check_rig(config.geometry.interaxial_m, lens_places(&config))?;
        let renderer = Renderer::new(world.clone(), config.cameras, config.seed)?;
        let head = SimulatedHead::homed(&config.head, 0.0)?;
        let simulated = head.clone();
        let standing: Standing = Arc::new(move |at_s| simulated.true_angles(at_s));
        let seconds = config.seconds.unwrap_or(match world.people() {
            0 => EMPTY_ROOM_S,
            _ => world.duration_s(),
        });
        // A frame at the very end still counts; the product may be off by its rounding.
        let frames = (seconds * config.fps + 1e-6).floor() as u64 + 1;
        let info = SourceInfo {
            name: format!("twin, path {}, seed {}", config.path.name(), config.seed),
            cameras: config.cameras.map(|c| c.camera),
            fixed_base_from_cam: None,
            fps: config.fps,
            pairs: Some(frames),
        };
        Ok(Self {
            info,
            config,
            world,
            renderer,
            head,
            standing,
            clock: None,
            next_frame: 0,
            frames,
            dropped: 0,
            truths: VecDeque::with_capacity(TRUTH_KEPT),
            rehearsed: Rehearsed::default(),
        })
    }

    /// The head whose axes the loop drives (a handle: clones move the same motors).
    pub fn head(&self) -> &SimulatedHead {
        &self.head
    }

    /// The same twin on motors that are not simulated: its cameras stand where `standing` says (no play, no home offset), and frames are
    /// taken when `clock` shows their time. [`Source::next_pair`] then waits for the exposure; frames that would come more than a period late are
    /// lost and counted. [`Self::head`] stands still.
    pub fn on_motors(mut self, standing: Standing, clock: RealClock) -> Self {
        self.standing = standing;
        self.clock = Some(clock);
        self
    }

    /// The same twin with the pictures of the same run, rendered before: frames are given out of these instead of being rendered, as long as the
    /// cameras stand where they stood then. [`Source::next_pair`] fails for a frame in which they do not.
    pub fn with_rehearsed(mut self, rehearsed: Rehearsed) -> Self {
        self.rehearsed = rehearsed;
        self
    }

    /// The world that is seen.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// What it was made from.
    pub fn config(&self) -> &TwinConfig {
        &self.config
    }

    /// What was true of a frame: the newest [`TRUTH_KEPT`] frames are kept, dropped ones too.
    pub fn truth_at(&self, frame: u64) -> Option<&TwinTruth> {
        let newest = self.truths.back()?.frame;
        let back = usize::try_from(newest.checked_sub(frame)?).ok()?;
        self.truths.get(self.truths.len().checked_sub(back + 1)?)
    }

    /// Ground truth of every pixel of a frame that is not older than a few seconds (the motors' history). Slow.
    ///
    /// # Errors
    /// When the frame has not been taken yet or is too old.
    pub fn pixel_truth(&self, frame: u64) -> Result<vergence_scene::FrameTruth, CaptureError> {
        let mid_exposure_s = self.mid_exposure_s(frame);
        let motion = self.motion(mid_exposure_s)?;
        Ok(self.renderer.truth(&Shot {
            index: frame,
            mid_exposure_s,
            cam_from_base: &|eye, t| motion.cam_from_base(eye, t),
        }))
    }

    fn mid_exposure_s(&self, frame: u64) -> [f64; 2] {
        let nominal_s = frame as f64 / self.config.fps;
        self.config
            .eye_offset_s
            .map(|offset_s| nominal_s + offset_s)
    }

    /// The head's motion during an exposure that has passed.
    fn motion(&self, mid_exposure_s: [f64; 2]) -> Result<Motion<'_>, CaptureError> {
        let mut at_mid = [HeadAngles::default(); 2];
        for (eye, angles) in at_mid.iter_mut().enumerate() {
            let half_s = self.config.cameras[eye].exposure_s / 2.0;
            let mid_s = mid_exposure_s[eye];
            // If both ends and the middle are known, so is all between.
            for t in [mid_s - half_s, mid_s + half_s] {
                (self.standing)(t.max(0.0))?;
            }
            *angles = (self.standing)(mid_s.max(0.0))?;
        }
        Ok(Motion {
            standing: &self.standing,
            geometry: &self.config.geometry,
            knock: &self.config.knock,
            at_mid,
        })
    }

    fn take_next(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> Result<Option<StereoFrame>, CaptureError> {
        while self.next_frame < self.frames {
            if self.is_missed() {
                self.next_frame += 1;
                self.dropped += 1;
                continue;
            }
            let truth = self.expose()?;
            let draw = chance(self.config.seed, truth.frame, Draw::Drop);
            if draw < self.config.drop_probability {
                self.dropped += 1;
                continue;
            }
            let [left, right] = match self.rehearsed.take(&truth)? {
                Some(pictures) => pictures,
                None => self.render(&truth, reuse),
            };
            return Ok(Some(StereoFrame {
                index: truth.frame,
                left: self.frame(Eye::Left, left, &truth),
                right: self.frame(Eye::Right, right, &truth),
            }));
        }
        Ok(None)
    }

    /// Whether the time of the next frame has passed without anybody looking.
    fn is_missed(&self) -> bool {
        let late_s = LATE_PERIODS / self.config.fps + TOLD_S;
        let clock = self.clock.as_ref();
        clock.is_some_and(|c| c.now_s() > self.exposed_s(self.next_frame) + late_s)
    }

    /// When the shutters of both eyes are closed.
    fn exposed_s(&self, frame: u64) -> f64 {
        let capture_s = self.mid_exposure_s(frame);
        let end_s = |i: usize| capture_s[i] + self.config.cameras[i].exposure_s / 2.0;
        end_s(0).max(end_s(1))
    }

    /// Take the next frame: move the motors to the end of its exposure and note the truth.
    fn expose(&mut self) -> Result<TwinTruth, CaptureError> {
        let frame = self.next_frame;
        let capture_s = self.mid_exposure_s(frame);
        let exposed_s = self.exposed_s(frame);
        match &mut self.clock {
            None => self.head.advance_to(exposed_s)?,
            Some(clock) => clock.sleep_until(exposed_s + TOLD_S),
        }
        let motion = self.motion(capture_s)?;
        let truth = self.truth(frame, capture_s, &motion);
        if self.truths.len() == TRUTH_KEPT {
            self.truths.pop_front();
        }
        self.truths.push_back(truth);
        self.next_frame += 1;
        Ok(truth)
    }

    fn truth(&self, frame: u64, capture_s: [f64; 2], motion: &Motion<'_>) -> TwinTruth {
        let mean_s = (capture_s[0] + capture_s[1]) / 2.0;
        let cam_from_base = [0, 1].map(|i| {
            let geometry = &self.config.geometry;
            let eye = Eye::BOTH[i];
            let cam_from_base = geometry.cam_from_base(eye, &motion.at_mid[i]);
            self.config.knock.applied(eye, capture_s[i], cam_from_base)
        });
        let target_in_base = capture_s.map(|t| self.world.target_reference_in_base(t));
        let in_cam = [0, 1].map(|i| target_in_base[i].map(|p| cam_from_base[i] * p));
        let px = |i: usize, camera: vergence_geometry::Camera| {
            in_cam[i].and_then(|p| camera.project(&p))
        };
        let cameras = self.info.cameras;
        let pinholes = cameras.map(|c| vergence_geometry::Camera {
            distortion: vergence_geometry::Distortion::NONE,
            ..c
        });
        TwinTruth {
            frame,
            capture_s,
            angles: motion.at_mid,
            cam_from_base,
            target_in_base,
            target_px: [px(0, cameras[0]), px(1, cameras[1])],
            target_undistorted_px: [px(0, pinholes[0]), px(1, pinholes[1])],
            range_m: self
                .world
                .target_reference_in_base(mean_s)
                .map(|p| p.coords.norm()),
            occluded: self.world.target_occluded(mean_s),
            visible_fraction: self.world.target_visible_fraction(mean_s),
        }
    }

    fn render(&mut self, truth: &TwinTruth, reuse: Option<StereoFrame>) -> [Rgb; 2] {
        let empty = || Rgb::filled(0, 0, [0; 3]);
        let (mut left, mut right) = match reuse {
            Some(old) => (old.left.picture, old.right.picture),
            None => (empty(), empty()),
        };
        let standing = Arc::clone(&self.standing);
        let motion = Motion {
            standing: &standing,
            geometry: &self.config.geometry,
            knock: &self.config.knock,
            at_mid: truth.angles,
        };
        let shot = Shot {
            index: truth.frame,
            mid_exposure_s: truth.capture_s,
            cam_from_base: &|eye, t| motion.cam_from_base(eye, t),
        };
        self.renderer.render_pair(&shot, [&mut left, &mut right]);
        [left, right]
    }

    fn frame(&self, eye: Eye, picture: Rgb, truth: &TwinTruth) -> Frame {
        let i = eye as usize;
        let capture_s = truth.capture_s[i];
        let jitter = chance(self.config.seed, truth.frame, Draw::Latency(eye));
        Frame {
            picture,
            capture_s,
            arrival_s: capture_s
                + self.config.cameras[i].exposure_s / 2.0
                + self.config.latency_s
                + self.config.latency_jitter_s * jitter,
        }
    }
}

impl Source for TwinSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_pair(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> Result<Option<StereoFrame>, CaptureError> {
        let next = self.take_next(reuse);
        if next.is_err() {
            self.next_frame = self.frames;
        }
        next
    }

    fn dropped_pairs(&self) -> u64 {
        self.dropped
    }
}

/// Where the cameras are while the shutter is open.
struct Motion<'a> {
    standing: &'a Standing,
    geometry: &'a HeadGeometry,
    knock: &'a Knock,
    at_mid: [HeadAngles; 2],
}

impl Motion<'_> {
    fn cam_from_base(&self, eye: Eye, time_s: f64) -> Isometry3<f64> {
        // Before time 0 the head stood where it stands at 0. Outside the exposure nothing is asked for; if it were, the
        // middle of the exposure is the nearest thing that is known.
        let angles = (self.standing)(time_s.max(0.0)).unwrap_or(self.at_mid[eye as usize]);
        let cam_from_base = self.geometry.cam_from_base(eye, &angles);
        self.knock.applied(eye, time_s, cam_from_base)
    }
}

fn refuse<T>(name: &'static str, value: f64, right: &'static str) -> Result<T, CaptureError> {
    Err(CaptureError::Setting {
        name,
        value: value.to_string(),
        right,
    })
}

fn check_knock(knock: &Knock) -> Result<(), CaptureError> {
    for (name, value) in [
        ("knock.pitch_rad", knock.pitch_rad),
        ("knock.yaw_rad", knock.yaw_rad),
        ("knock.roll_rad", knock.roll_rad),
    ] {
        if !(-MOST_KNOCK_RAD..=MOST_KNOCK_RAD).contains(&value) {
            return refuse(name, value, "it must lie within 0.35 rad (20 degrees)");
        }
    }
    if !knock.time_s.is_finite() {
        return refuse("knock.time_s", knock.time_s, "it must be finite");
    }
    Ok(())
}

fn check(config: &TwinConfig) -> Result<(), CaptureError> {
    if !FPS.contains(&config.fps) {
        return refuse(
            "fps",
            config.fps,
            "it must lie in 1..=1000 frames per second",
        );
    }
    if let Some(seconds) = config.seconds
        && !(0.0..=MAX_SECONDS).contains(&seconds)
    {
        return refuse("seconds", seconds, "it must lie in 0..=86400 s");
    }
    for offset_s in config.eye_offset_s {
        if offset_s.is_nan() || offset_s.abs() >= 0.5 / config.fps {
            return refuse(
                "eye_offset_s",
                offset_s,
                "it must be less than half a period",
            );
        }
    }
    for (name, value) in [
        ("latency_s", config.latency_s),
        ("latency_jitter_s", config.latency_jitter_s),
    ] {
        if !(0.0..=10.0).contains(&value) {
            return refuse(name, value, "it must lie in 0..=10 s");
        }
    }
    for camera in &config.cameras {
        if camera.exposure_s * config.fps > 1.0 {
            return refuse(
                "exposure_s",
                camera.exposure_s,
                "it must not be longer than a period",
            );
        }
    }
    check_knock(&config.knock)?;
    if !(0.0..=1.0).contains(&config.drop_probability) {
        return refuse(
            "drop_probability",
            config.drop_probability,
            "it must lie in 0..=1",
        );
    }
    let HeadGeometry {
        interaxial_m,
        pupil_m,
    } = config.geometry;
    if !(interaxial_m > 0.0 && interaxial_m <= 10.0) {
        return refuse(
            "interaxial_m",
            interaxial_m,
            "it must be positive and at most 10 m",
        );
    }
    if !(0.0..=1.0).contains(&pupil_m) {
        return refuse("pupil_m", pupil_m, "it must lie in 0..=1 m");
    }
    Ok(())
}

/// Places that the lenses take over the whole range of the axes, base frame. Between the steps of pan and tilt they move by less than
/// a tenth of the base.
fn lens_places(config: &TwinConfig) -> Vec<Point3<f64>> {
    const PANS: usize = 33;
    const TILTS: usize = 9;
    let limits = config.head.limits();
    let at = |axis: usize, i: usize, n: usize| {
        let (lo, hi) = (limits[axis].position_min_rad, limits[axis].position_max_rad);
        lo + (hi - lo) * i as f64 / (n - 1) as f64
    };
    let mut places = Vec::with_capacity(4 * PANS * TILTS);
    for i in 0..PANS * TILTS {
        for end in 0..2 {
            let angles = HeadAngles {
                pan: at(0, i % PANS, PANS),
                tilt: at(1, i / PANS, TILTS),
                left: at(2, end, 2),
                right: at(3, end, 2),
            };
            places.extend(Eye::BOTH.map(|eye| {
                let base_from_cam = config.geometry.cam_from_base(eye, &angles).inverse();
                Point3::from(base_from_cam.translation.vector)
            }));
        }
    }
    places
}

/// What is drawn by chance for a frame.
#[derive(Clone, Copy)]
enum Draw {
    Drop,
    Latency(Eye),
}

/// An even draw from 0..1 that depends on nothing but its arguments (SplitMix64's mixing, Steele, Lea & Flood 2014).
fn chance(seed: u64, frame: u64, draw: Draw) -> f64 {
    let which = match draw {
        Draw::Drop => 1,
        Draw::Latency(Eye::Left) => 2,
        Draw::Latency(Eye::Right) => 3,
    };
    uniform_from(mix(mix(mix(seed) ^ frame) ^ which))
}
