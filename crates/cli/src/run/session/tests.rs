//! Proves: a run that fails half-way stops its axes, keeps what cannot be had again, and says why. Does not look at pictures.
use super::*;
use vergence_capture::{TwinConfig, TwinSource};
use vergence_control::{AxisName, ControlSettings, Controller, DriveEvent, ModeRequest, RigState};
use vergence_geometry::{Camera, Distortion, Intrinsics, Screen, Viewer};
use vergence_scene::TwinCamera;
use vergence_servo::{Motors, Rigging, ServoSettings};

/// A twin with small pictures whose axis `broken` is in fault from the start.
fn rig(broken: AxisName) -> (Feed, Servo) {
    let camera = TwinCamera {
        camera: Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 512, 384),
            distortion: Distortion::NONE,
        },
        ..TwinCamera::default()
    };
    let config = TwinConfig {
        seconds: Some(2.0),
        cameras: [camera; 2],
        ..TwinConfig::default()
    };
    let geometry = config.geometry;
    let mut control = ControlSettings {
        focal_px: camera.camera.intrinsics.fx,
        ..ControlSettings::default()
    };
    control.mode.request = ModeRequest::Converged;
    let controller = Controller::new(control.clone(), geometry, config.head.limits()).unwrap();
    let source = TwinSource::new(config).unwrap();
    let head = source.head();
    head.with_axis(broken, |a| a.fault(0.0)).unwrap();
    let motors = Motors::new(geometry, head.drive(), control.backlash_rad, controller);
    let feed = Feed::Twin(Box::new(source));
    let rigging = Rigging::Motors(Box::new(motors));
    let servo = Servo::new(feed.info(), rigging, &ServoSettings::default()).unwrap();
    (feed, servo)
}

fn plan(out: PathBuf, repeatable: bool) -> Plan {
    Plan {
        source: "test".to_owned(),
        real_time: false,
        rehearsed: false,
        live: None,
        home: false,
        headless: true,
        seconds: None,
        out,
        mode: "converged".to_owned(),
        seed: Some(1),
        calibration: "true".to_owned(),
        repeatable,
        record: None,
        screening: Screening {
            pitch_m: 1.5e-5,
            screen: Screen::default(),
            viewer: Viewer::default(),
        },
    }
}

/// The pan axis refuses when the target is found: the others stop, rows and summary stay with the reason, and the vergence axes
/// park. The same failure of something that can be repeated leaves nothing.
#[test]
fn a_failing_axis_ends_the_run_safely() {
    let out = tempfile::tempdir().unwrap();
    let stop = Stop::default();
    let (feed, servo) = rig(AxisName::Pan);
    let outcome = run(feed, servo, &plan(out.path().to_owned(), false), &stop).unwrap();
    let failure = outcome.failure.unwrap().to_string();
    assert!(failure.contains("Pan"), "{failure}");
    let summary = outcome.summary;
    assert_eq!(summary.failed.as_deref(), Some(failure.as_str()));
    let rest = summary.rest.unwrap();
    assert!(rest.stopped && !rest.parked, "{rest:?}");
    assert_eq!(summary.limit_violations, 0);
    let rows = std::fs::read_to_string(outcome.folder.join("frames.csv")).unwrap();
    assert_eq!(rows.lines().count() as u64, 1 + summary.frames);
    assert!(summary.frames > 3 && outcome.folder.join("summary.json").is_file());

    let (feed, servo) = rig(AxisName::Pan);
    let other = tempfile::tempdir().unwrap();
    assert!(run(feed, servo, &plan(other.path().to_owned(), true), &stop).is_err());
    assert_eq!(std::fs::read_dir(other.path()).unwrap().count(), 0);
}

fn record_plan() -> RecordPlan {
    RecordPlan {
        settings: vergence_record::RecordSettings {
            pictures: vergence_record::Pictures::None,
            ..Default::default()
        },
        tape: vergence_record::Tape::new(),
        settings_text: String::new(),
        machine: None,
        limits: None,
        target: None,
        kind: "twin",
    }
}

/// What is recorded in `/event`, as source and kind, and how many pairs, steps, and pairs with a reason why they were not used.
fn recorded(folder: &std::path::Path) -> (Vec<(String, String)>, [usize; 3]) {
    use vergence_record::table::Row as _;
    use vergence_record::{Topic, rows};
    let file = std::fs::File::open(folder.join(super::super::recording::NAME)).unwrap();
    let mut recording = vergence_record::Recording::new(file).unwrap();
    let (mut events, mut counts) = (Vec::new(), [0; 3]);
    while let Some(message) = recording.next_message().unwrap() {
        match message.topic {
            Some(Topic::Event) => {
                let event = rows::Happening::decode(&message.data).unwrap();
                events.push((event.source, event.kind));
            }
            Some(Topic::Pair) => {
                let pair = rows::Pair::decode(&message.data).unwrap();
                counts[0] += 1;
                counts[2] += usize::from(pair.refused.is_some_and(|why| why.len() > 10));
            }
            Some(Topic::Step) => counts[1] += 1,
            _ => {}
        }
    }
    assert!(recording.contents().finished);
    (events, counts)
}

/// The recording has every pair, those that the loop refused too, what controller and cameras said, and after a fault all that the supervisor
/// remembers of the time before it.
#[test]
fn the_recording_has_what_the_loop_refused() {
    let out = tempfile::tempdir().unwrap();
    let (mut feed, servo) = rig(AxisName::Pan);
    let mut plan = plan(out.path().to_owned(), false);
    plan.record = Some(record_plan());
    let folder = RunFolder::create(&plan.out).unwrap();
    let mut log = Log::new(&feed, &plan);
    log.begin_recording(&folder, &feed, &servo, &plan, 0.0)
        .unwrap();
    let mut conductor = Conductor::new(servo, SupervisorSettings::default()).unwrap();
    let mut steps = 0;
    for _ in 0..12 {
        let pair = feed.next_pair(None).unwrap().unwrap();
        let now_s = pair.arrival_s() + PROCESSING_S;
        // The second time it is a pair that the loop has had.
        for _ in 0..2 {
            match conductor.take(&pair, now_s).unwrap() {
                Some(step) => {
                    steps += 1;
                    log.take(&feed, &conductor, &pair, step, &plan).unwrap();
                }
                None => log.take_refused(&conductor, &pair, now_s),
            }
            log.tell_changes(&mut conductor);
        }
    }
    assert_eq!(conductor.state(), RigState::Fault);
    let alarm = vergence_control::DriveEventKind::Alarm;
    log.take_drive_events(&[DriveEvent {
        time_s: 0.0,
        kind: alarm,
        text: "a limit switch".to_owned(),
    }]);
    let remembered = conductor.decisions().count();
    log.recording.take().unwrap().finish();
    let (events, counts) = recorded(folder.path());
    let of = |source: &str, kind: &str| {
        let wanted = (source.to_owned(), kind.to_owned());
        events.iter().filter(|event| **event == wanted).count()
    };
    assert_eq!(counts, [24, steps, 24 - steps]);
    assert!((1..=12).contains(&steps), "{steps}");
    assert_eq!((of("drive", "alarm"), of("supervisor", "fault")), (1, 1));
    let told = of("supervisor", "remembered");
    assert!(told > 0 && told <= remembered, "{told} of {remembered}");
}

/// A run that is told to stop before its first pair is whole, with its axes at rest.
#[test]
fn a_stopped_run_is_whole() {
    let out = tempfile::tempdir().unwrap();
    let stop = Stop::default();
    (stop.flag()).store(true, std::sync::atomic::Ordering::Relaxed);
    let (feed, servo) = rig(AxisName::Tilt);
    let outcome = run(feed, servo, &plan(out.path().to_owned(), false), &stop).unwrap();
    assert!(outcome.failure.is_none() && outcome.summary.interrupted);
    assert!(outcome.summary.rest.unwrap().stopped);
    assert!(outcome.folder.join("summary.json").is_file());
}
