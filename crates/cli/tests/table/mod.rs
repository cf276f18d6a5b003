//! A rig on the table without a rig: a simulated Grbl controller on a pseudo-terminal, and a person's walk as two cameras see it that stand on its axes, in
//! real time. The pictures are sent as two live streams; what is true of each is kept.

#![allow(dead_code, reason = "the tests and the example each use a part")]
// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod stream;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Instant;

use nalgebra::{Isometry3, Point3, Translation3, Unit, Vector3};
use vergence_calib::MachineCalibration;
use vergence_calib::solve::TurningAxis;
use vergence_capture::{RealClock, Source as _, Standing, TwinConfig, TwinSource, TwinTruth};
use vergence_control::HeadConfig;
use vergence_control::grbl::{
    GrblFault, GrblTerminal, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};
use vergence_geometry::{Camera, Eye, HeadAngles, Intrinsics};
use vergence_scene::{PathSpec, TwinCamera, read_waypoints};

use stream::Plug;

/// Width and height of the pictures.
pub(crate) const SIZE: (usize, usize) = (512, 384);

/// Largest pan, degrees.
const PAN_DEG: f64 = 25.0;

/// Somebody who walks between three places for minutes, `x_m,z_m` each: a file of waypoints.
pub(crate) fn walk(places: [&str; 3]) -> String {
    let round = places.map(|place| format!("{place},0.9\n")).concat();
    format!("x_m,z_m,speed_m_s\n{}", round.repeat(30))
}

/// To and fro between 5 m and 2.5 m.
pub(crate) const TO_AND_FRO: [&str; 3] = ["0,5", "0.4,2.5", "-0.4,2.5"];

/// The rig as it runs.
pub(crate) struct Table {
    pub(crate) axes: Axes,
    plugs: [Plug; 2],
    seen: Arc<Mutex<Seen>>,
    ends: Arc<AtomicBool>,
    cameras: Option<JoinHandle<()>>,
    machine: PathBuf,
}

/// Its controller, on a pseudo-terminal.
pub(crate) struct Axes {
    grbl: SharedGrbl,
    terminal: GrblTerminal,
    start: Instant,
}

/// What was true so far.
#[derive(Default)]
struct Seen {
    truths: Vec<TwinTruth>,
    /// Least time from the middle of an exposure until its picture was sent, s.
    way_s: Option<f64>,
}

/// The twin of the table: small pictures, everything else as it is by default.
pub(crate) fn config(walk: &Path, fps: f64) -> TwinConfig {
    let usual = TwinCamera::default();
    let camera = TwinCamera {
        camera: Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, SIZE.0, SIZE.1),
            ..usual.camera
        },
        ..usual
    };
    TwinConfig {
        path: PathSpec::Waypoints(read_waypoints(walk).unwrap()),
        fps,
        seconds: Some(600.0),
        cameras: [camera; 2],
        head: head(),
        ..TwinConfig::default()
    }
}

/// The default head on a shorter pan axis, whose switch is sooner found.
fn head() -> HeadConfig {
    let mut head = HeadConfig::default();
    let limits = &mut head.pan.limits;
    limits.position_max_rad = PAN_DEG.to_radians();
    limits.position_min_rad = -limits.position_max_rad;
    head
}

/// What a perfect calibration of that rig says.
pub(crate) fn machine(config: &TwinConfig) -> MachineCalibration {
    let half_m = config.geometry.interaxial_m / 2.0;
    let step_rad = config.head.axes().map(|axis| axis.step_rad());
    let axis = |i: usize, direction: Vector3<f64>, x_m: f64| TurningAxis {
        direction: Unit::new_normalize(direction),
        point: Point3::new(x_m, 0.0, 0.0),
        rad_per_step: step_rad[i],
        backlash_rad: 0.0,
    };
    let (x, y) = (Vector3::x(), Vector3::y());
    MachineCalibration {
        cameras: config.cameras.map(|c| c.camera),
        names: ["left".to_owned(), "right".to_owned()],
        axes: [
            axis(0, y, 0.0),
            axis(1, x, 0.0),
            axis(2, y, -half_m),
            axis(3, y, half_m),
        ],
        home: [-half_m, half_m].map(|x_m| Isometry3::from(Translation3::new(x_m, 0.0, 0.0))),
        rms_px: 0.0,
        sigmas: Vec::new(),
        notes: Vec::new(),
    }
}

/// A controller of the default rig that finds its switches fast: they are near, and so is nothing else.
fn controller() -> SimulatedGrbl {
    let mut config = SimulatedGrblConfig::for_rig(&head());
    config.start[..4].copy_from_slice(&[-4.0; 4]);
    // 40 degrees a second to the switches, 20 to get off them.
    assert!(config.settings.set(25, 2400.0) && config.settings.set(24, 1200.0));
    SimulatedGrbl::new(config, 0.0)
}

impl Axes {
    /// A controller that is switched on now; `folder` gets the link to its port.
    pub(crate) fn start(folder: &Path) -> Self {
        let start = Instant::now();
        let clock = move || start.elapsed().as_secs_f64();
        let grbl = SharedGrbl::new(controller());
        let link = folder.join("grbl");
        let terminal = GrblTerminal::start(grbl.clone(), clock, Some(&link)).unwrap();
        Self {
            grbl,
            terminal,
            start,
        }
    }

    /// The flags by which `vergence run` finds it.
    pub(crate) fn flags(&self) -> Vec<String> {
        [
            "--motors",
            &format!("grbl:{}", self.terminal.path().display()),
            "--set",
            &format!("motors.pan.min=-{PAN_DEG}deg"),
            "--set",
            &format!("motors.pan.max={PAN_DEG}deg"),
        ]
        .map(str::to_owned)
        .into()
    }

    /// The world's time now, s.
    pub(crate) fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// Where the axes truly stood at a time of the last seconds, degrees.
    pub(crate) fn angles_deg(&self, at_s: f64) -> [f64; 4] {
        angles(&mut self.grbl.lock(), self.now_s(), at_s).map(f64::to_degrees)
    }

    /// A switch at the end of an axis is hit: the controller cuts its steps off with an alarm.
    pub(crate) fn alarm(&self) {
        let now_s = self.now_s();
        self.grbl.lock().fault(GrblFault::Alarm(1), now_s);
    }

    /// How often the motion so far was faster, accelerated more or changed more suddenly than an axis may, by the controller's own audit.
    pub(crate) fn limits_passed(&self) -> u64 {
        let mut grbl = self.grbl.lock();
        grbl.advance_to(self.now_s());
        let audit = grbl.audit();
        audit.speed + audit.acceleration + audit.jumps
    }
}

impl Table {
    /// A rig whose files lie in `folder`, before which somebody walks as the file of waypoints says. It begins now.
    pub(crate) fn start(folder: &Path, walk: &Path, fps: f64) -> Self {
        let axes = Axes::start(folder);
        let (start, grbl) = (axes.start, axes.grbl.clone());
        let config = config(walk, fps);
        let file = folder.join("machine.toml");
        machine(&config).write(&file).unwrap();
        let twin = TwinSource::new(config).unwrap();
        let twin = twin.on_motors(standing(grbl, start), RealClock::since(start));
        let plugs = [Plug::new(SIZE, fps), Plug::new(SIZE, fps)];
        let seen = Arc::new(Mutex::new(Seen::default()));
        let ends = Arc::new(AtomicBool::new(false));
        let cameras = {
            let (plugs, seen, ends) = (plugs.clone(), Arc::clone(&seen), Arc::clone(&ends));
            std::thread::spawn(move || look(twin, &plugs, &seen, &ends, start))
        };
        Self {
            axes,
            plugs,
            seen,
            ends,
            cameras: Some(cameras),
            machine: file,
        }
    }

    /// The flags by which `vergence run` finds it.
    pub(crate) fn flags(&self) -> Vec<String> {
        let [left, right] = [0, 1].map(|eye: usize| self.plugs[eye].url());
        let cameras = [
            "--source",
            "stream",
            "--left",
            &left,
            "--right",
            &right,
            "--calibration",
            &self.machine.to_string_lossy(),
        ];
        [&cameras.map(str::to_owned)[..], &self.axes.flags()].concat()
    }

    /// Least time from the middle of an exposure until its picture was sent, s.
    pub(crate) fn way_s(&self) -> Option<f64> {
        self.seen.lock().unwrap().way_s
    }

    /// Pull a camera's plug out, or put it in.
    pub(crate) fn plug(&self, eye: Eye, is_in: bool) {
        self.plugs[eye as usize].set(is_in);
    }

    /// What was true of the frames taken between two times.
    pub(crate) fn truths(&self, from_s: f64, to_s: f64) -> Vec<TwinTruth> {
        let seen = self.seen.lock().unwrap();
        let during = (seen.truths.iter()).filter(|t| (from_s..to_s).contains(&t.capture_s[0]));
        during.copied().collect()
    }
}

impl Drop for Table {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(cameras) = self.cameras.take() {
            // A panic of the cameras has ended the streams, which is seen.
            let _ = cameras.join();
        }
    }
}

fn angles(grbl: &mut MutexGuard<'_, SimulatedGrbl>, now_s: f64, at_s: f64) -> [f64; 4] {
    grbl.advance_to(now_s);
    let units = grbl.true_positions(at_s);
    grbl.settings().rig_angles(&head(), &units)
}

/// The cameras stand where the controller's axes truly do.
fn standing(grbl: SharedGrbl, start: Instant) -> Standing {
    Arc::new(move |at_s| {
        let now_s = start.elapsed().as_secs_f64();
        Ok(HeadAngles::from_array(angles(
            &mut grbl.lock(),
            now_s,
            at_s,
        )))
    })
}

/// Take pair after pair and send it.
fn look(
    mut twin: TwinSource,
    plugs: &[Plug; 2],
    seen: &Mutex<Seen>,
    ends: &AtomicBool,
    start: Instant,
) {
    let mut used = None;
    while !ends.load(Ordering::Relaxed) {
        let Some(pair) = twin.next_pair(used.take()).unwrap() else {
            return;
        };
        let truth = *twin.truth_at(pair.index).unwrap();
        for (plug, frame) in plugs.iter().zip([&pair.left, &pair.right]) {
            plug.send(&frame.picture, frame.capture_s);
        }
        let way_s = start.elapsed().as_secs_f64() - truth.capture_s[0];
        let mut seen = seen.lock().unwrap();
        seen.truths.push(truth);
        seen.way_s = Some(seen.way_s.map_or(way_s, |least_s| least_s.min(way_s)));
        used = Some(pair);
    }
}
