//! Proves, with a drive that does as it is told: slow cameras are no doubt, a refused homing is not taken for done, an axis whose place is not known is not
//! moved, what was seen is kept whether the axes follow it or not, and cameras that stand still have no supervisor. The rest of the conductor is tried by the fault simulation (`vergence-soak`).
use std::sync::{Arc, Mutex};

use nalgebra::Isometry3;
use vergence_capture::{Frame, SourceInfo, StereoFrame};
use vergence_control::{
    AxisCommand, AxisError, AxisLimits, AxisName, AxisReading, AxisState, ControlSettings,
    Controller, Drive, DriveEvent, HeadConfig, Link, LossTimes, RigState, SupervisorSettings,
};
use vergence_geometry::{Camera, Distortion, HeadGeometry, Intrinsics};
use vergence_imaging::Rgb;
use vergence_servo::{Conductor, Motors, Rigging, Servo, ServoSettings, WatchSettings};
use vergence_track::FollowSettings;

const SIZE: (usize, usize) = (128, 96);

/// What the drive says and was told.
#[derive(Default)]
struct Said {
    states: Option<[AxisState; 4]>,
    /// Positions, rad; `None` where they are not known.
    places: [Option<f64>; 4],
    /// So many orders to home are refused yet.
    refusals: usize,
    homings: usize,
    commands: Vec<[AxisCommand; 4]>,
    heard_s: f64,
    /// Pan takes no orders.
    refuses: bool,
}

impl Said {
    fn answer(&self) -> [Result<(), AxisError>; 4] {
        let axis = AxisName::Pan;
        let state = AxisState::Fault;
        let mut answer = [Ok(()); 4];
        if self.refuses {
            answer[0] = Err(AxisError::NotReady { axis, state });
        }
        answer
    }
}

struct Obedient(Arc<Mutex<Said>>);

impl Drive for Obedient {
    fn name(&self) -> String {
        "obedient".to_owned()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        HeadConfig::default().limits()
    }

    fn update(&mut self, now_s: f64) {
        self.0.lock().unwrap().heard_s = now_s;
    }

    fn command(&mut self, commands: &[AxisCommand; 4], _now_s: f64) -> [Result<(), AxisError>; 4] {
        let mut said = self.0.lock().unwrap();
        said.commands.push(*commands);
        said.answer()
    }

    fn hold(&mut self, _now_s: f64) -> [Result<(), AxisError>; 4] {
        self.0.lock().unwrap().answer()
    }

    fn home(&mut self, _now_s: f64) -> Result<(), AxisError> {
        let mut said = self.0.lock().unwrap();
        if said.refusals > 0 {
            said.refusals -= 1;
            let axis = AxisName::Pan;
            let state = AxisState::Held;
            return Err(AxisError::NotReady { axis, state });
        }
        said.homings += 1;
        said.states = Some([AxisState::Unhomed; 4]);
        Ok(())
    }

    fn clear(&mut self, _now_s: f64) -> Result<(), AxisError> {
        Ok(())
    }

    fn states(&self) -> [AxisState; 4] {
        self.0
            .lock()
            .unwrap()
            .states
            .unwrap_or([AxisState::Held; 4])
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        match self.0.lock().unwrap().places[axis.index()] {
            Some(position_rad) => Ok(AxisReading {
                time_s: at_s,
                position_rad,
                velocity_rad_s: 0.0,
            }),
            None => Err(AxisError::OutOfHistory {
                axis,
                asked_s: at_s,
                from_s: 0.0,
                to_s: 0.0,
            }),
        }
    }

    fn link(&self) -> Link {
        Link::Up {
            heard_s: self.0.lock().unwrap().heard_s,
        }
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        Vec::new()
    }
}

fn info(fixed: bool) -> SourceInfo {
    let camera = Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, SIZE.0, SIZE.1),
        distortion: Distortion::NONE,
    };
    SourceInfo {
        name: "test".to_owned(),
        cameras: [camera; 2],
        fixed_base_from_cam: fixed
            .then(|| [-0.035, 0.035].map(|x| Isometry3::translation(x, 0.0, 0.0))),
        fps: 30.0,
        pairs: None,
    }
}

fn settings() -> ServoSettings {
    ServoSettings {
        watch: WatchSettings {
            every_s: 0.0,
            correct: false,
        },
        ..ServoSettings::default()
    }
}

fn rig(supervisor: SupervisorSettings) -> (Conductor, Arc<Mutex<Said>>) {
    let said = Arc::new(Mutex::new(Said {
        places: [Some(0.0); 4],
        ..Said::default()
    }));
    let geometry = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.0,
    };
    let limits = HeadConfig::default().limits();
    let controller = Controller::new(ControlSettings::default(), geometry, limits).unwrap();
    let motors = Motors::new(
        geometry,
        Box::new(Obedient(said.clone())),
        [0.0; 4],
        controller,
    );
    let servo = Servo::new(&info(false), Rigging::Motors(Box::new(motors)), &settings()).unwrap();
    (Conductor::new(servo, supervisor).unwrap(), said)
}

/// A pair of a room with noise, `latency_s` old when it comes.
fn pair(index: u64, capture_s: f64, latency_s: f64) -> StereoFrame {
    let frame = |eye: u64| Frame {
        picture: Rgb::from_fn(SIZE.0, SIZE.1, |x, y| {
            let noise = (index * 7919 + eye * 104_729 + x as u64 * 31 + y as u64 * 17) % 13;
            [100 + noise as u8; 3]
        }),
        capture_s,
        arrival_s: capture_s + latency_s,
    };
    StereoFrame {
        index,
        left: frame(0),
        right: frame(1),
    }
}

/// Two pairs a second, each 0.3 s old when it comes: with the pace of these cameras nothing is in doubt; with that of thirty a second everything is.
#[test]
fn slow_cameras_are_no_doubt() {
    for (pace, wanted) in [
        (SupervisorSettings::for_pace(0.5, 0.3), RigState::Searching),
        (SupervisorSettings::default(), RigState::Holding),
    ] {
        let (mut conductor, _) = rig(pace);
        for i in 0..12 {
            let capture_s = 0.5 * i as f64;
            let taken = conductor.take(&pair(i, capture_s, 0.3), capture_s + 0.31);
            assert!(taken.unwrap().is_some(), "{pace:?} {i}");
        }
        assert_eq!(conductor.state(), wanted);
    }
}

/// Homed axes that may not be homed yet stay where they are until the drive takes the order; then they home, and only then they go to zero.
#[test]
fn a_refused_homing_is_repeated() {
    let (mut conductor, said) = rig(SupervisorSettings::default());
    said.lock().unwrap().places = [Some(0.3); 4];
    said.lock().unwrap().refusals = 20;
    conductor.ask_home();
    let mut index = 0;
    let mut go_on = |conductor: &mut Conductor, from_s: f64, to_s: f64| {
        let mut now_s = from_s;
        while now_s < to_s {
            index += 1;
            conductor
                .take(&pair(index, now_s - 0.02, 0.01), now_s)
                .unwrap();
            now_s += 0.01;
        }
    };
    go_on(&mut conductor, 1.0, 1.15);
    assert_eq!(conductor.state(), RigState::Homing);
    assert_eq!(said.lock().unwrap().homings, 0);
    assert!(said.lock().unwrap().commands.is_empty());
    go_on(&mut conductor, 1.15, 2.0);
    assert_eq!(said.lock().unwrap().homings, 1);
    assert!(said.lock().unwrap().commands.is_empty());
    said.lock().unwrap().states = Some([AxisState::Held; 4]);
    go_on(&mut conductor, 2.0, 2.5);
    let first = said.lock().unwrap().commands[0];
    assert!(
        matches!(first[0], AxisCommand::Follow(s) if (s.position_rad - 0.3).abs() < 0.01),
        "{first:?}"
    );
    said.lock().unwrap().places = [Some(0.0); 4];
    go_on(&mut conductor, 2.5, 2.6);
    assert_eq!(conductor.state(), RigState::Searching);
}

/// On the way to zero an axis whose place is not known stands.
#[test]
fn an_unknown_axis_is_not_moved() {
    let (mut conductor, said) = rig(SupervisorSettings::default());
    said.lock().unwrap().places = [Some(0.3), None, Some(0.1), Some(0.1)];
    conductor.ask_home();
    for i in 0..30 {
        let now_s = 1.0 + 0.01 * i as f64;
        conductor.take(&pair(i, now_s - 0.02, 0.01), now_s).unwrap();
        if i == 5 {
            said.lock().unwrap().states = Some([AxisState::Ready; 4]);
        }
    }
    let said = said.lock().unwrap();
    assert!(said.commands.len() > 10);
    assert!(said.commands.iter().all(|c| c[1] == AxisCommand::Hold));
    assert!(
        said.commands
            .iter()
            .all(|c| matches!(c[0], AxisCommand::Follow(_)))
    );
}

/// What was seen in a pair after which an axis refused belongs to the record, but is no step of a rig that follows.
#[test]
fn what_an_axis_refuses_to_follow_was_seen() {
    let (mut conductor, said) = rig(SupervisorSettings::default());
    let mut index = 0;
    let mut take = |conductor: &mut Conductor| {
        index += 1;
        let now_s = 1.0 + 0.03 * index as f64;
        let taken = conductor.take(&pair(index, now_s - 0.02, 0.01), now_s);
        taken.unwrap().is_some()
    };
    assert!(take(&mut conductor));
    assert!(conductor.take_unfollowed().is_none());
    said.lock().unwrap().refuses = true;
    assert!(!take(&mut conductor));
    let refusal = conductor.refusal().map(str::to_owned).unwrap();
    let step = conductor.take_unfollowed().unwrap();
    assert_eq!((step.index, step.control.is_none()), (2, true));
    assert_eq!(step.refused.unwrap().to_string(), refusal);
    assert!(conductor.take_unfollowed().is_none());
    said.lock().unwrap().refuses = false;
    assert!(take(&mut conductor));
    assert!(conductor.take_unfollowed().is_none());
}

/// Cameras that stand still are nobody's to stop: no stall, no stop, no change of state.
#[test]
fn cameras_that_stand_still() {
    let info = info(true);
    let rigging = Rigging::Fixed(info.fixed_base_from_cam.unwrap());
    let servo = Servo::new(&info, rigging, &settings()).unwrap();
    let mut conductor = Conductor::new(servo, SupervisorSettings::default()).unwrap();
    conductor.look(0.0);
    assert!(conductor.take(&pair(0, 0.1, 0.01), 0.12).unwrap().is_some());
    conductor.look(60.0);
    conductor.stop(61.0, "Ctrl-C");
    assert!(conductor.take_changes().is_empty());
}

/// A pair that is not used has a reason: its times, its pictures, or what the rig is doing; one that is used has none.
#[test]
fn refusals_have_reasons() {
    let (mut conductor, _) = rig(SupervisorSettings::default());
    let dark = |index: u64, eyes: &[usize]| {
        let mut dark = pair(index, 0.0, 0.01);
        for &eye in eyes {
            let frame = [&mut dark.left, &mut dark.right]
                .into_iter()
                .nth(eye)
                .unwrap();
            frame.picture = Rgb::filled(SIZE.0, SIZE.1, [index as u8 % 3; 3]);
        }
        dark
    };
    let mut now_s = 1.0;
    let mut reason = |conductor: &mut Conductor, mut pair: StereoFrame, late_s: f64| {
        now_s += 0.02;
        for frame in [&mut pair.left, &mut pair.right] {
            frame.capture_s = now_s - 0.02 - late_s;
        }
        let taken = conductor.take(&pair, now_s).unwrap();
        let reason = conductor.refusal().map(str::to_owned);
        assert_eq!(taken.is_none(), reason.is_some());
        reason.unwrap_or_default()
    };
    assert_eq!(reason(&mut conductor, pair(0, 0.0, 0.01), 0.0), "");
    for (eyes, words) in [
        (&[0][..], "the left picture is dark"),
        (&[1], "the right picture is dark"),
        (&[0, 1], "both pictures are dark"),
    ] {
        assert_eq!(reason(&mut conductor, dark(1, eyes), 0.0), words);
    }
    let late = reason(&mut conductor, pair(2, 0.0, 0.01), 9.0);
    assert!(late.contains("is stamped 9.020 s before now"), "{late}");
    for same in 0..4 {
        let said = reason(&mut conductor, pair(3, 0.0, 0.01), 0.0);
        let frozen = said == "both pictures are frozen: the same again and again";
        assert_eq!(frozen, same >= 2, "{same}: {said}");
    }
    conductor.ask_home();
    let homing = reason(&mut conductor, pair(4, 0.0, 0.01), 0.0);
    assert_eq!(homing, "the rig is homing: no pair is used");
}

/// A camera under its cap, or one that gives the same again and again, lives no longer however new its pictures are: between pairs too, when the source says
/// when it gave the newest. A source that repeats a still scene is believed when it says so.
#[test]
fn new_pictures_that_show_nothing_are_no_life() {
    let state_after = |picture: fn(u64) -> StereoFrame, frozen_after: Option<u32>| {
        let (mut conductor, _) = rig(SupervisorSettings::default());
        if let Some(pictures) = frozen_after {
            conductor.set_frozen_after(pictures);
        }
        for i in 0..60 {
            let now_s = 1.0 + i as f64 / 30.0;
            let mut pair = match i < 30 {
                true => pair(i, 0.0, 0.01),
                false => picture(i),
            };
            pair.index = i;
            for frame in [&mut pair.left, &mut pair.right] {
                frame.capture_s = now_s - 0.02;
            }
            conductor.take(&pair, now_s).unwrap();
            conductor.note_pictures([Some(now_s - 0.01); 2]);
            conductor.look(now_s + 0.02);
        }
        conductor.state()
    };
    let alive: fn(u64) -> StereoFrame = |i| pair(i, 0.0, 0.01);
    let still: fn(u64) -> StereoFrame = |_| pair(7, 0.0, 0.01);
    let capped: fn(u64) -> StereoFrame = |i| {
        let mut capped = pair(i, 0.0, 0.01);
        capped.right.picture = Rgb::filled(SIZE.0, SIZE.1, [i as u8 % 3; 3]);
        capped
    };
    assert_eq!(state_after(alive, None), RigState::Searching);
    assert_eq!(state_after(capped, None), RigState::Holding);
    assert_eq!(state_after(still, None), RigState::Holding);
    assert_eq!(state_after(still, Some(0)), RigState::Searching);
}

/// A target's place is believed for as long as the head follows its prediction: one time, said in two crates that do not know each other.
#[test]
fn who_is_followed_blindly_is_believed_as_long() {
    let believed_s = FollowSettings::default().coast_s;
    assert_eq!(believed_s, LossTimes::default().coast_s);
}
