//! The closed loop without pictures: control law, simulated motors with steps, play and home offset, and the geometry
//! crate's projections as judge. Estimates are perfect but late: pixels of the true cameras, triangulated where the counters
//! say that the cameras stood; velocity is true. What is proved is the motor side; finding and filtering are other crates'.

use nalgebra::{Matrix6, Point3, Vector3};
use vergence_control::{
    AxisCommand, AxisName, ControlOutput, ControlSettings, ControlState, Controller, HeadConfig,
    LoadObserver, ModeRequest, ModeSettings, RunningMode, SimulatedHead, TargetEstimate,
};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};

pub(crate) const RIG: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.0,
};
pub(crate) const FOCAL_PX: f64 = 6.5 / 4.8 * 1024.0;
const FRAME_S: f64 = 1.0 / 30.0;
const LATENCY_S: f64 = 0.040;

/// Undistorted pixel position relative to the picture's middle, (u right, v down), left then right.
fn pixels(angles: &HeadAngles, p: &Point3<f64>) -> [[f64; 2]; 2] {
    Eye::BOTH.map(|eye| {
        let q = RIG.cam_from_base(eye, angles) * p;
        [FOCAL_PX * q.x / q.z, FOCAL_PX * q.y / q.z]
    })
}

/// The point that cameras at `angles` see at these pixels (rays of the two cameras met half way).
pub(crate) fn triangulated(angles: &HeadAngles, px: &[[f64; 2]; 2]) -> Point3<f64> {
    let ray = |eye: Eye, px: [f64; 2]| {
        let base_from_cam = RIG.base_from_cam(eye, angles);
        let d = base_from_cam.rotation * Vector3::new(px[0] / FOCAL_PX, px[1] / FOCAL_PX, 1.0);
        (base_from_cam.translation.vector, d)
    };
    let ((a, u), (b, v)) = (ray(Eye::Left, px[0]), ray(Eye::Right, px[1]));
    let w = a - b;
    let (uu, uv, vv, uw, vw) = (u.dot(&u), u.dot(&v), v.dot(&v), u.dot(&w), v.dot(&w));
    let det = uu * vv - uv * uv;
    let (s, t) = ((uv * vw - vv * uw) / det, (uu * vw - uv * uw) / det);
    Point3::from((a + u * s + b + v * t) / 2.0)
}

struct Frame {
    time_s: f64,
    distance_m: f64,
    /// Left minus right, pixels, as the true cameras saw the target.
    disparity_px: f64,
    pointing_px: f64,
    out: ControlOutput,
}

struct Setup {
    head: HeadConfig,
    settings: ControlSettings,
    noise_px: f64,
    seen: fn(f64) -> bool,
}

impl Setup {
    fn new(head: HeadConfig, request: ModeRequest) -> Self {
        let settings = ControlSettings {
            backlash_rad: head.backlash_rad(),
            mode: ModeSettings {
                request,
                ..ModeSettings::default()
            },
            ..ControlSettings::default()
        };
        Self {
            head,
            settings,
            noise_px: 0.0,
            seen: |_| true,
        }
    }
}

/// Run the loop on a path (position and velocity at a time).
fn run(
    setup: &Setup,
    seconds: f64,
    path: impl Fn(f64) -> (Point3<f64>, Vector3<f64>),
) -> (Vec<Frame>, SimulatedHead, Controller) {
    let head = SimulatedHead::homed(&setup.head, 0.0).unwrap();
    let mut axes = head.axes();
    let mut controller = Controller::new(setup.settings.clone(), RIG, setup.head.limits()).unwrap();
    let mut observer = LoadObserver::new(setup.settings.backlash_rad);
    let mut noise = Noise(1);
    let mut frames = Vec::new();
    for i in 0..(seconds / FRAME_S) as usize {
        let taken_s = i as f64 * FRAME_S;
        let now_s = taken_s + LATENCY_S;
        // The last frame's command went out at its own time, LATENCY_S after its picture: later than this picture.
        head.advance_to(taken_s).unwrap();
        let (p, v) = path(taken_s);
        let truth = head.true_angles(taken_s).unwrap();
        let mut px = pixels(&truth, &p);
        let disparity_px = px[0][0] - px[1][0];
        let pointing_px = px.iter().map(|q| q[0].hypot(q[1])).fold(0.0, f64::max);
        for q in px.iter_mut().flatten() {
            *q += setup.noise_px * noise.next();
        }
        let believed = observer.observe(&head.readings(taken_s).unwrap());
        let estimate = (setup.seen)(taken_s).then(|| TargetEstimate {
            time_s: taken_s,
            seen_s: taken_s,
            position_in_base: triangulated(&believed, &px),
            velocity_in_base: v,
            covariance: Matrix6::zeros(),
        });
        head.advance_to(now_s).unwrap();
        let out = controller.step(now_s, estimate.as_ref(), &head.readings(now_s).unwrap());
        assert!(out.apply(&mut axes, now_s).iter().all(Result::is_ok));
        frames.push(Frame {
            time_s: taken_s,
            distance_m: p.coords.norm(),
            disparity_px,
            pointing_px,
            out,
        });
    }
    assert_eq!(head.violations().map(|v| v.total()), [0; 4]);
    (frames, head, controller)
}

/// Uniform in [-1, 1], from a linear congruential generator (Knuth's constants).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

fn rms_and_max(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut n, mut sum, mut max) = (0.0, 0.0, 0.0_f64);
    for v in values {
        n += 1.0;
        sum += v * v;
        max = max.max(v.abs());
    }
    ((sum / f64::max(n, 1.0)).sqrt(), max)
}

fn walk(t: f64) -> (Point3<f64>, Vector3<f64>) {
    (
        Point3::new(0.3, 0.1, 10.0 - t),
        Vector3::new(0.0, 0.0, -1.0),
    )
}

/// Walking in from 10 m to 1 m at 1 m/s: zero parallax within 0.5 px RMS, down to 1.5 m and to 1 m, with the default motors and with perfect ones.
#[test]
fn walk_stays_converged() {
    for (name, head, limit) in [
        ("default motors", HeadConfig::default(), 0.5),
        (
            "no play, no home offset",
            HeadConfig::default().without_faults(),
            0.2,
        ),
    ] {
        let (frames, ..) = run(&Setup::new(head, ModeRequest::Converged), 9.0, walk);
        let part = |near: f64| {
            let chosen = frames
                .iter()
                .filter(move |f| f.time_s > 1.0 && f.distance_m > near);
            rms_and_max(chosen.map(|f| f.disparity_px))
        };
        let (rms, max) = part(1.5);
        let (rms_near, max_near) = part(0.0);
        println!(
            "{name}: {rms:.3} px RMS, {max:.3} max to 1.5 m; {rms_near:.3} RMS, {max_near:.3} max to 1 m"
        );
        assert!(
            rms < limit && rms_near < limit && max_near < 4.0 * limit,
            "{name}: {rms} {rms_near} {max_near}"
        );
        assert!(
            frames
                .iter()
                .skip(10)
                .all(|f| f.out.state == ControlState::Tracking)
        );
    }
}

/// Crossing at 3 m with 1.4 m/s and zigzag with sharp turns: parallax stays small although pan is slower than vergence; the target stays
/// within the leash of the middle.
#[test]
fn cross_and_zigzag_stay_converged() {
    let cross = |t: f64| {
        (
            Point3::new(-3.0 + 1.4 * t, 0.0, 3.0),
            Vector3::new(1.4, 0.0, 0.0),
        )
    };
    // A triangle of ±1 m at 1 m/s whose corners are parabolas of half a second (4 m/s²).
    let zigzag = |t: f64| {
        let (leg, turn) = (t % 4.0, 0.25);
        let to_corner = (leg % 2.0) - 1.0;
        let way = if leg < 2.0 { 1.0 } else { -1.0 };
        let (x, speed) = if to_corner.abs() < 1.0 - turn {
            (to_corner, 1.0)
        } else {
            let left = 1.0 - to_corner.abs();
            let x = 1.0 - turn / 2.0 - left * left / (2.0 * turn);
            (x * to_corner.signum(), left / turn)
        };
        (
            Point3::new(way * x, 0.0, 6.0 - 0.4 * t),
            Vector3::new(way * speed, 0.0, -0.4),
        )
    };
    let setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
    for (name, frames) in [
        ("cross", run(&setup, 4.3, cross).0),
        ("zigzag", run(&setup, 10.0, zigzag).0),
    ] {
        let late = || frames.iter().filter(|f| f.time_s > 1.0);
        let (rms, max) = rms_and_max(late().map(|f| f.disparity_px));
        let (pointing, pointing_max) = rms_and_max(late().map(|f| f.pointing_px));
        println!(
            "{name}: parallax {rms:.3} px RMS, {max:.3} max; pointing {pointing:.1} px RMS, {pointing_max:.1} max"
        );
        assert!(rms < 0.6 && max < 2.0, "{name}");
        // One degree of leash is 24 px; the latency adds to it at turns.
        assert!(pointing_max < 35.0, "{name}");
    }
}

/// A still target seen with noise: play and compensation do not hunt. With noise below the hysteresis (0.1 px, as after a filter) the
/// compensation does not reverse at all and the load rests within the hysteresis; with much more (0.5 px, unfiltered)
/// the load swings by less than noise and play together.
#[test]
fn no_limit_cycle_under_noise_and_play() {
    // The controller believes half, all, and half as much again of the true play.
    for (believed, noise_px) in [(0.5, 0.1), (1.0, 0.1), (1.5, 0.1), (1.0, 0.5)] {
        let mut setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
        setup.settings.backlash_rad = setup.head.backlash_rad().map(|b| believed * b);
        setup.noise_px = noise_px;
        let seconds = 30.0;
        let still = |_| (Point3::new(0.2, -0.1, 3.0), Vector3::zeros());
        let (frames, head, controller) = run(&setup, seconds, still);
        let late = frames.iter().filter(|f| f.time_s > 2.0);
        let (rms, max) = rms_and_max(late.map(|f| f.disparity_px));
        let swing = head.with_axis(AxisName::LeftVergence, |axis| {
            let angles = (0..3000).map(|i| {
                axis.true_angle(seconds - 3.2 + f64::from(i) * 1e-3)
                    .unwrap()
            });
            let (low, high) = angles.fold((f64::MAX, f64::MIN), |(l, h), a| (l.min(a), h.max(a)));
            high - low
        });
        let reversals = controller.reversals();
        println!(
            "play believed x{believed}, noise {noise_px} px: {rms:.3} px RMS, {max:.3} max, load swings {:.4}°, {reversals:?}",
            swing.to_degrees()
        );
        let noise_rad = 2.0 * noise_px / FOCAL_PX;
        if noise_px < 0.2 {
            assert!(
                swing < setup.settings.hysteresis_rad[2] && reversals == [0; 4],
                "{swing} {reversals:?}"
            );
            assert!(max < 0.6, "{max}");
        } else {
            assert!(
                swing < noise_rad + setup.head.left.backlash_rad + 4.0 * setup.head.left.step_rad()
            );
        }
    }
}

/// A target that goes: coast, hold, park slowly at parallel axes, search; the axes never diverge and never go past the nearest distance.
#[test]
fn loss_ends_parked() {
    let mut setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
    setup.seen = |t| t < 3.0;
    // It walks at 2 m/s up to 1.2 m, where it is lost: the prediction would pass through the rig.
    let (frames, head, controller) = run(&setup, 12.0, |t| {
        (
            Point3::new(0.0, 0.0, 7.2 - 2.0 * t.min(3.0)),
            Vector3::new(0.0, 0.0, -2.0),
        )
    });
    let order: Vec<_> = frames
        .iter()
        .filter_map(|f| f.out.transition.as_ref().map(|t| t.to))
        .collect();
    use ControlState::{Coasting, Holding, Parking, Searching, Tracking};
    assert_eq!(order, [Tracking, Coasting, Holding, Parking, Searching]);
    assert!(
        frames
            .iter()
            .filter_map(|f| f.out.transition.as_ref())
            .all(|t| !t.reason.is_empty())
    );
    let nearest = 0.035_f64.atan2(0.4);
    for f in &frames {
        let AxisCommand::Follow(left) = f.out.commands[2] else {
            continue;
        };
        assert!(
            left.position_rad > -1e-3 && left.position_rad < nearest + 1e-3,
            "{left:?}"
        );
    }
    for i in 0..3000 {
        let angles = head.true_angles(12.0 - 3.2 + f64::from(i) * 1e-3).unwrap();
        assert!(angles.vergence() > -2e-4, "diverges: {angles:?}");
    }
    assert_eq!(controller.state(), Searching);
    let end = head.true_angles(frames[frames.len() - 1].time_s).unwrap();
    assert!(end.left.abs() < 6e-4 && end.right.abs() < 6e-4, "{end:?}");
}

/// A target that walks to and fro and is lost as it runs to the right: the head never turns by more than 10° beyond where it last saw it, and
/// by the end looks where the target usually was.
#[test]
fn a_lost_target_is_looked_for_where_it_was() {
    let mut setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
    setup.seen = |t| t < 9.0;
    let (frames, head, _) = run(&setup, 20.0, |t| {
        // 8° to either side; out of sight on at 2 m/s.
        match t < 9.0 {
            true => {
                let phase = std::f64::consts::TAU * t / 4.0;
                let x = 0.5 * phase.sin();
                let speed = 0.5 * std::f64::consts::TAU / 4.0 * phase.cos();
                (Point3::new(x, 0.0, 3.5), Vector3::new(speed, 0.0, 0.0))
            }
            false => (
                Point3::new(0.5 + 2.0 * (t - 9.0), 0.0, 3.5),
                Vector3::new(2.0, 0.0, 0.0),
            ),
        }
    });
    let pan = |t: f64| head.true_angles(t).unwrap().pan.to_degrees();
    let end_s = frames[frames.len() - 1].time_s;
    let most = (0..400).map(|i| pan(end_s - 3.0 + 0.0075 * f64::from(i)));
    assert!(most.fold(0.0, f64::max) < 1.5);
    let wanted = frames.iter().filter(|f| f.time_s > 8.9);
    let farthest = wanted
        .filter_map(|f| f.out.wanted)
        .map(|w| w.pan.to_degrees());
    assert!(farthest.fold(0.0, f64::max) < 8.2 + 10.0);
    assert!(pan(end_s).abs() < 1.5, "{}", pan(end_s));
}

/// A target that was seen for two seconds, 12° aside, is not thought to stand there usually: the head turns back towards zero, first by no more than 10°.
#[test]
fn a_target_lost_early_is_looked_for_from_zero_on() {
    let mut setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
    setup.seen = |t| t < 2.0;
    let there = Point3::new(0.74, 0.0, 3.5);
    let (frames, ..) = run(&setup, 12.0, |_| (there, Vector3::zeros()));
    let pan = |at_s: f64| {
        let frame = frames.iter().find(|f| f.time_s >= at_s).unwrap();
        frame.out.believed.pan.to_degrees()
    };
    assert!((pan(1.9) - 11.9).abs() < 0.3, "{}", pan(1.9));
    assert!((1.5..6.0).contains(&pan(5.5)), "{}", pan(5.5));
    assert!((1.0..5.0).contains(&pan(11.9)), "{}", pan(11.9));
}

/// A sighting that is taken back, with nothing left that can be trusted: the motors stop following it at once.
#[test]
fn a_sighting_that_was_taken_back_is_not_followed() {
    let head = HeadConfig::default();
    let mut controller = Controller::new(ControlSettings::default(), RIG, head.limits()).unwrap();
    let estimate = |time_s: f64, seen_s: f64, x: f64, speed: f64, sigma: f64| TargetEstimate {
        time_s,
        seen_s,
        position_in_base: Point3::new(x, 0.0, 3.0),
        velocity_in_base: Vector3::new(speed, 0.0, 0.0),
        covariance: Matrix6::identity() * sigma * sigma,
    };
    let readings = |time_s| {
        [vergence_control::AxisReading {
            time_s,
            position_rad: 0.0,
            velocity_rad_s: 0.0,
        }; 4]
    };
    let old = estimate(1.0, 1.0, 0.0, 0.0, 0.01);
    assert_eq!(
        controller.step(1.0, Some(&old), &readings(1.0)).state,
        ControlState::Tracking
    );
    let hasty = estimate(1.4, 1.4, -0.5, -2.5, 0.01);
    let out = controller.step(1.4, Some(&hasty), &readings(1.4));
    assert!(matches!(out.commands[0], AxisCommand::Follow(_)));
    let vague = estimate(1.5, 1.0, 0.2, 0.0, 2.0);
    let out = controller.step(1.5, Some(&vague), &readings(1.5));
    assert_eq!(out.state, ControlState::Holding);
    assert_eq!(out.commands, [AxisCommand::Hold; 4]);
    assert!(out.refused.is_some());
}

/// `auto` on a walk: one change at the threshold, with its reason; the target's parallax glides from the parallel value to zero without a jump.
#[test]
fn auto_changes_once_and_smoothly() {
    let (frames, ..) = run(
        &Setup::new(HeadConfig::default(), ModeRequest::Auto),
        9.0,
        walk,
    );
    let changes: Vec<_> = frames
        .iter()
        .filter_map(|f| f.out.mode_change.as_ref())
        .collect();
    assert_eq!(changes.len(), 1, "{changes:?}");
    println!("{} s: {}", changes[0].time_s, changes[0].reason);
    assert_eq!(
        (changes[0].from, changes[0].to),
        (RunningMode::Parallel, RunningMode::Converged)
    );
    let fastest = frames
        .windows(2)
        .map(|w| (w[1].disparity_px - w[0].disparity_px).abs())
        .fold(0.0, f64::max);
    println!("fastest glide {fastest:.2} px per frame");
    // 15 px in 1.5 s with a peak of 1.875 times the mean: 0.62 px per frame, and steps.
    assert!(fastest < 0.9, "{fastest}");
    let after = frames.iter().filter(|f| f.time_s > changes[0].time_s + 1.6);
    assert!(rms_and_max(after.map(|f| f.disparity_px)).0 < 0.5);
}

/// In `shifted` the axes stay parallel, and the shift takes the target's parallax away; a change from converged to
/// shifted does so all the way.
#[test]
fn shifted_nulls_electronically() {
    for change_s in [0.0, 4.0] {
        let request = if change_s == 0.0 {
            ModeRequest::Shifted
        } else {
            ModeRequest::Converged
        };
        let setup = Setup::new(HeadConfig::default().without_faults(), request);
        let head = SimulatedHead::homed(&setup.head, 0.0).unwrap();
        let mut axes = head.axes();
        let mut controller =
            Controller::new(setup.settings.clone(), RIG, setup.head.limits()).unwrap();
        for i in 0..240 {
            let now_s = f64::from(i) * FRAME_S;
            if now_s >= change_s {
                controller.request_mode(ModeRequest::Shifted);
            }
            let (p, v) = walk(now_s);
            let estimate = TargetEstimate {
                time_s: now_s,
                seen_s: now_s,
                position_in_base: p,
                velocity_in_base: v,
                covariance: Matrix6::zeros(),
            };
            head.advance_to(now_s).unwrap();
            let out = controller.step(now_s, Some(&estimate), &head.readings(now_s).unwrap());
            let px = pixels(&head.true_angles(now_s).unwrap(), &p);
            let seen = px[0][0] + out.shift_px[0] - px[1][0] - out.shift_px[1];
            assert!(
                now_s < 1.0 || seen.abs() < 0.5,
                "{now_s} s: {seen} px, shift {:?}",
                out.shift_px
            );
            if now_s > change_s + 1.6 {
                let wanted = out.wanted.unwrap();
                assert_eq!((wanted.left, wanted.right), (0.0, -0.0));
            }
            assert!(out.apply(&mut axes, now_s).iter().all(Result::is_ok));
        }
    }
}

/// The shift of the pictures of a lost target does not stay for ever: it glides back to nothing while the rig parks.
#[test]
fn shift_of_a_lost_target_fades() {
    let mut setup = Setup::new(HeadConfig::default(), ModeRequest::Shifted);
    setup.seen = |t| t < 2.0;
    let (frames, ..) = run(&setup, 12.0, |_| {
        (Point3::new(0.0, 0.0, 2.0), Vector3::zeros())
    });
    let shift = |f: &Frame| f.out.shift_px[0] - f.out.shift_px[1];
    let at = |t: f64| frames.iter().find(|f| f.time_s >= t).map(shift).unwrap();
    assert!(at(1.9).abs() > 40.0, "{}", at(1.9));
    for pair in frames.windows(2).filter(|p| p[0].time_s > 2.0) {
        let step = (shift(&pair[1]) - shift(&pair[0])).abs();
        assert!(step < 5.0, "jumps by {step} px at {} s", pair[1].time_s);
    }
    assert_eq!(at(11.9), 0.0);
}

/// A sighting that is taken back: the estimate then rests on an older sighting, and it is that estimate that counts.
#[test]
fn the_newest_estimate_counts_not_the_newest_sighting() {
    let setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
    let head = SimulatedHead::homed(&setup.head, 0.0).unwrap();
    let mut controller = Controller::new(setup.settings.clone(), RIG, setup.head.limits()).unwrap();
    let readings = head.readings(0.0).unwrap();
    let estimate = |time_s: f64, seen_s: f64, z: f64| TargetEstimate {
        time_s,
        seen_s,
        position_in_base: Point3::new(0.0, 0.0, z),
        velocity_in_base: Vector3::zeros(),
        covariance: Matrix6::zeros(),
    };
    controller.step(0.0, Some(&estimate(0.0, 0.0, 4.0)), &readings);
    let phantom = controller.step(0.1, Some(&estimate(0.1, 0.1, 2.0)), &readings);
    assert_eq!(phantom.distance_m, Some(2.0));
    let back = controller.step(0.13, Some(&estimate(0.13, 0.0, 4.0)), &readings);
    assert_eq!(back.distance_m, Some(4.0));
    // An estimate for an earlier time is late, whatever it rests on.
    let late = controller.step(0.16, Some(&estimate(0.05, 0.05, 3.0)), &readings);
    assert_eq!(late.distance_m, Some(4.0));
}

/// Estimates that are no numbers, readings that are none, and time that runs backwards: nothing jumps, the fault is named, the loop goes on.
#[test]
fn faults_never_make_it_jump() {
    let setup = Setup::new(HeadConfig::default(), ModeRequest::Converged);
    let head = SimulatedHead::homed(&setup.head, 0.0).unwrap();
    let mut controller = Controller::new(setup.settings.clone(), RIG, setup.head.limits()).unwrap();
    let good = |t: f64| TargetEstimate {
        time_s: t,
        seen_s: t,
        position_in_base: Point3::new(0.0, 0.0, 4.0),
        velocity_in_base: Vector3::zeros(),
        covariance: Matrix6::zeros(),
    };
    let readings = head.readings(0.0).unwrap();
    controller.step(0.0, Some(&good(0.0)), &readings);
    let before = controller.step(0.1, Some(&good(0.1)), &readings);
    let mut nan = good(0.13);
    nan.position_in_base.z = f64::NAN;
    let mut vague = good(0.13);
    vague.covariance = Matrix6::identity() * 4.0;
    for bad in [nan, vague] {
        let out = controller.step(0.13, Some(&bad), &readings);
        assert!(out.refused.is_some());
        let wanted = [before.wanted.unwrap().left, out.wanted.unwrap().left];
        assert!((wanted[0] - wanted[1]).abs() < 1e-12 && out.state == ControlState::Tracking);
    }
    let back = controller.step(0.05, Some(&good(0.05)), &readings);
    assert!(back.refused.is_some() && back.commands == [AxisCommand::Keep; 4]);
    let mut broken = readings;
    broken[2].position_rad = f64::NAN;
    let held = controller.step(0.16, Some(&good(0.16)), &broken);
    assert!(held.refused.is_some() && held.commands == [AxisCommand::Hold; 4]);
    let after = controller.step(0.2, Some(&good(0.2)), &readings);
    assert!(after.refused.is_none() && after.state == ControlState::Tracking);
}

/// The same inputs give the same outputs, to the last bit.
#[test]
fn runs_repeat_exactly() {
    let mut setup = Setup::new(HeadConfig::default(), ModeRequest::Auto);
    setup.noise_px = 0.5;
    let (a, ..) = run(&setup, 4.0, walk);
    let (b, ..) = run(&setup, 4.0, walk);
    for (x, y) in a.iter().zip(&b) {
        assert_eq!(x.out, y.out);
        assert_eq!(x.disparity_px.to_bits(), y.disparity_px.to_bits());
    }
}
