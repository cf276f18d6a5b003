//! The control law on the driver and the simulated controller, beside the same law on the simulated steppers: how much of the parallax is the
//! controller's planning ahead. Estimates are perfect but late, as in `loop.rs`; neither head has play.

use crate::closed_loop::{FOCAL_PX, RIG, triangulated};
use nalgebra::{Matrix6, Point3, Vector3};
use vergence_control::grbl::{
    GrblConfig, GrblDrive, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};
use vergence_control::{
    AxisCommand, AxisName, AxisSetpoint, AxisState, BoxedDrive, ControlSettings, ControlState,
    Controller, HeadConfig, ModeRequest, ModeSettings, SimulatedHead, TargetEstimate,
};
use vergence_geometry::{Eye, HeadAngles};

const LATENCY_S: f64 = 0.040;
const UPDATE_S: f64 = 0.005;
/// Updates between two frames: 28.6 a second.
const FRAME: usize = 7;
/// By then the heads are homed and look straight ahead.
const START_S: f64 = 12.0;

/// A head, and where it truly stands at a past time.
struct World {
    drive: BoxedDrive,
    truth: Box<dyn Fn(f64) -> HeadAngles>,
}

fn grbl_world(head: &HeadConfig) -> (World, SharedGrbl) {
    let grbl = SharedGrbl::new(SimulatedGrbl::new(SimulatedGrblConfig::for_rig(head), 0.0));
    let drive = GrblDrive::new(GrblConfig::default(), head, Box::new(grbl.port()), 0.0).unwrap();
    let shared = grbl.clone();
    let truth = move |at_s: f64| {
        let units = shared.lock().true_positions(at_s);
        let zero = [-76.0, -31.0, -13.0, -2.0];
        HeadAngles::from_array([0, 1, 2, 3].map(|i| (units[i] - zero[i]).to_radians()))
    };
    let world = World {
        drive: Box::new(drive),
        truth: Box::new(truth),
    };
    (world, grbl)
}

fn stepper_world(head: &HeadConfig) -> World {
    let head = SimulatedHead::homed(head, 0.0).unwrap();
    let drive = head.drive();
    let truth = move |at_s: f64| {
        head.advance_to(at_s).unwrap();
        head.true_angles(at_s).unwrap()
    };
    World {
        drive,
        truth: Box::new(truth),
    }
}

fn pixels(angles: &HeadAngles, p: &Point3<f64>) -> [[f64; 2]; 2] {
    Eye::BOTH.map(|eye| {
        let q = RIG.cam_from_base(eye, angles) * p;
        [FOCAL_PX * q.x / q.z, FOCAL_PX * q.y / q.z]
    })
}

/// Home and look straight ahead.
fn make_ready(world: &mut World) {
    let mut now_s = 0.0;
    while now_s < START_S {
        now_s += UPDATE_S;
        // Simulated steppers answer for times to which they were run.
        (world.truth)(now_s);
        world.drive.update(now_s);
        if (now_s - 1.0).abs() < UPDATE_S / 2.0 {
            world.drive.home(now_s).unwrap();
        }
        if world.drive.states()[0] != AxisState::Unhomed {
            let ahead = AxisSetpoint {
                time_s: now_s,
                position_rad: 0.0,
                velocity_rad_s: 0.0,
            };
            let results = world.drive.command(&[AxisCommand::Follow(ahead); 4], now_s);
            assert!(results.iter().all(Result::is_ok), "{results:?}");
        }
    }
}

/// Parallax and pointing error of every frame from the first second on, px.
fn follow(
    world: &mut World,
    head: &HeadConfig,
    seconds: f64,
    path: impl Fn(f64) -> (Point3<f64>, Vector3<f64>),
) -> Vec<(f64, f64)> {
    make_ready(world);
    let settings = ControlSettings {
        backlash_rad: [0.0; 4],
        mode: ModeSettings {
            request: ModeRequest::Converged,
            ..ModeSettings::default()
        },
        ..ControlSettings::default()
    };
    let mut controller = Controller::new(settings, RIG, head.limits()).unwrap();
    let mut frames = Vec::new();
    let count = (seconds / UPDATE_S) as usize;
    for i in 0..count {
        let now_s = START_S + (i + 1) as f64 * UPDATE_S;
        (world.truth)(now_s);
        world.drive.update(now_s);
        if i % FRAME != 0 || i < 2 * FRAME {
            continue;
        }
        let taken_s = now_s - LATENCY_S;
        let (p, v) = path(taken_s - START_S);
        let px = pixels(&(world.truth)(taken_s), &p);
        if taken_s - START_S > 1.0 {
            frames.push((px[0][0] - px[1][0], px[0][0].hypot(px[0][1])));
        }
        // Seen where it is, as far as the readings are right.
        let read = AxisName::ALL.map(|a| world.drive.reading(a, taken_s).unwrap().position_rad);
        let estimate = TargetEstimate {
            time_s: taken_s,
            seen_s: taken_s,
            position_in_base: triangulated(&HeadAngles::from_array(read), &px),
            velocity_in_base: v,
            covariance: Matrix6::zeros(),
        };
        let readings = AxisName::ALL.map(|a| world.drive.reading(a, now_s).unwrap());
        let out = controller.step(now_s, Some(&estimate), &readings);
        let results = world.drive.command(&out.commands, now_s);
        assert!(results.iter().all(Result::is_ok), "{now_s}: {results:?}");
        assert_eq!(out.state, ControlState::Tracking);
    }
    frames
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|v| v * v).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Walking in from 10 m to 1 m, crossing at 3 m, and swinging from side to side: the target stays converged within half a pixel (the walk) and one
/// pixel (the others), on the controller as on the steppers; nothing leaves its limits.
#[test]
fn a_target_is_kept_through_the_controller() {
    let head = HeadConfig::default().without_faults();
    let walk = |t: f64| {
        (
            Point3::new(0.3, 0.1, 10.0 - t),
            Vector3::new(0.0, 0.0, -1.0),
        )
    };
    let cross = |t: f64| {
        (
            Point3::new(-3.0 + 1.4 * t, 0.0, 3.0),
            Vector3::new(1.4, 0.0, 0.0),
        )
    };
    let swing = |t: f64| {
        let (sin, cos) = (1.5 * t).sin_cos();
        (
            Point3::new(sin, 0.0, 4.0),
            Vector3::new(1.5 * cos, 0.0, 0.0),
        )
    };
    type Path = fn(f64) -> (Point3<f64>, Vector3<f64>);
    let paths: [(&str, Path, f64, f64); 3] = [
        ("walk", walk, 8.9, 0.5),
        ("cross", cross, 4.3, 1.0),
        ("swing", swing, 10.0, 1.0),
    ];
    for (name, path, seconds, limit) in paths {
        let steppers = follow(&mut stepper_world(&head), &head, seconds, path);
        let (mut world, grbl) = grbl_world(&head);
        let frames = follow(&mut world, &head, seconds, path);
        assert!(frames.len() > 80);
        let of = |frames: &[(f64, f64)]| {
            (
                rms(frames.iter().map(|f| f.0)),
                frames.iter().map(|f| f.0.abs()).fold(0.0, f64::max),
                rms(frames.iter().map(|f| f.1)),
            )
        };
        let (ours, theirs) = (of(&frames), of(&steppers));
        println!(
            "{name}: parallax {:.3} px RMS, {:.3} max, pointing {:.1} RMS; steppers {:.3}, {:.3}, {:.1}",
            ours.0, ours.1, ours.2, theirs.0, theirs.1, theirs.2
        );
        assert!(ours.0 < limit, "{name}: {ours:?} {theirs:?}");
        let grbl = grbl.lock();
        let audit = grbl.audit();
        assert_eq!(
            (audit.speed, audit.acceleration, audit.jumps, audit.cut),
            (0, 0, 0, 0)
        );
        assert_eq!(grbl.overflowed(), 0);
        let events = world.drive.take_events();
        assert_eq!(events.len(), 2, "{events:?}");
    }
}
