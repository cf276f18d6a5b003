//! Proves that two network cameras make pairs: at their rate, with little latency, in H.264 and JPEG, over both transports, gone and back, frozen, steadily
//! apart; by this crate itself and through `ffmpeg`. The cameras are `ci/rtsp/server.py` (GStreamer's RTSP server), which draws the machine's clock
//! into every picture, so that age and skew are measured from the pictures and not from what the source believes. `ci/rtsp/run.sh` brings what the
//! server needs; without it the tests say that they are skipped.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use vergence_calib::{CameraPose, RigCalibration};
use vergence_capture::live::{LiveKind, Transport};
use vergence_capture::{
    LiveConfig, LiveInput, LiveRig, LiveSource, LiveStatistics, Next, RealClock, Source as _,
    SourceEventKind, StereoFrame,
};
use vergence_geometry::{Camera, Distortion, Intrinsics};
use vergence_imaging::Rgb;

const SIZE: (usize, usize) = (1024, 768);
const FPS: f64 = 30.0;

/// The server, as long as a test has it; one test at a time, since it is time that they measure.
struct Server {
    child: Child,
    orders: ChildStdin,
    port: u16,
    started: Instant,
    _alone: MutexGuard<'static, ()>,
}

impl Server {
    /// Started; `None` where there is none.
    fn start() -> Option<Self> {
        static ALONE: Mutex<()> = Mutex::new(());
        let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(script) = std::env::var_os("VERGENCE_RTSP_SERVER") else {
            println!("skipped: there is no server; ci/rtsp/run.sh brings one");
            return None;
        };
        let mut child = Command::new("/usr/bin/python3")
            .arg(script)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut said)
            .unwrap();
        let port = said
            .trim()
            .strip_prefix("listening ")
            .unwrap()
            .parse()
            .unwrap();
        Some(Self {
            orders: child.stdin.take().unwrap(),
            child,
            port,
            started: Instant::now(),
            _alone: alone,
        })
    }

    fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").unwrap();
        self.orders.flush().unwrap();
    }

    fn config(&self, kind: LiveKind, coding: &str) -> LiveConfig {
        let url = |side| format!("rtsp://127.0.0.1:{}/{coding}/{side}", self.port).into();
        LiveConfig::new(
            kind,
            LiveInput::Two {
                left: url("left"),
                right: url("right"),
            },
        )
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        println!("  took {:.1} s", self.started.elapsed().as_secs_f64());
    }
}

fn rig() -> RigCalibration {
    let pose = |x_m: f64| CameraPose {
        name: format!("x {x_m}"),
        camera: Camera {
            intrinsics: Intrinsics {
                width: SIZE.0,
                height: SIZE.1,
                fx: 1000.0,
                fy: 1000.0,
                cx: 511.5,
                cy: 383.5,
            },
            distortion: Distortion::NONE,
        },
        rig_from_cam: Isometry3::from_parts(
            Translation3::new(x_m, 0.0, 0.0),
            UnitQuaternion::identity(),
        ),
    };
    RigCalibration::from_poses(pose(-0.035), pose(0.035)).unwrap()
}

fn open(config: &LiveConfig) -> LiveSource {
    LiveSource::open(config, LiveRig::Fixed(&rig()), &RealClock::new()).unwrap()
}

/// When a picture was made, tenths of a millisecond of the machine's monotonic clock, 32 bits of them.
fn born(picture: &Rgb) -> u32 {
    let side = picture.width() / 32;
    (0..32)
        .filter(|k| picture.at(k * side + side / 2, 16)[1] > 125)
        .fold(0, |bits, k| bits | 1 << k)
}

/// The machine's monotonic clock in the same unit.
fn now() -> u32 {
    let uptime = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    (uptime.tv_sec as u64 * 10_000 + uptime.tv_nsec as u64 / 100_000) as u32
}

/// What the pictures themselves say.
#[derive(Debug)]
struct Measured {
    fps: f64,
    latency_ms: [f64; 3],
    /// Right picture's birth less the left one's, ms: median and the one that is furthest from it.
    apart_ms: [f64; 2],
    pairs: Vec<StereoFrame>,
}

/// Fetch pairs for some seconds, as the loop does, and look at their clocks.
fn measure(source: &mut LiveSource, seconds: f64) -> Measured {
    let started = Instant::now();
    let (mut latency, mut apart, mut pairs) = (Vec::new(), Vec::new(), Vec::<StereoFrame>::new());
    let mut reuse = None;
    while started.elapsed().as_secs_f64() < seconds {
        let Next::Pair(pair) = source.next_within(1.0, reuse.take()).unwrap() else {
            continue;
        };
        let seen = now();
        let [left, right] = [&pair.left.picture, &pair.right.picture].map(born);
        for birth in [left, right] {
            latency.push(f64::from(seen.wrapping_sub(birth)) / 10.0);
        }
        apart.push(f64::from(right.wrapping_sub(left) as i32) / 10.0);
        pairs.push(StereoFrame {
            left: vergence_capture::Frame {
                picture: Rgb::filled(1, 1, [0; 3]),
                ..pair.left
            },
            right: vergence_capture::Frame {
                picture: Rgb::filled(1, 1, [0; 3]),
                ..pair.right
            },
            index: pair.index,
        });
        reuse = None;
    }
    let first_s = pairs.first().unwrap().capture_s();
    let fps = (pairs.len() - 1) as f64 / (pairs.last().unwrap().capture_s() - first_s);
    latency.sort_by(f64::total_cmp);
    let at = |q: f64| latency[(q * (latency.len() - 1) as f64) as usize];
    let latency_ms = [at(0.5), at(0.95), at(1.0)];
    apart.sort_by(f64::total_cmp);
    let middle = apart[apart.len() / 2];
    let furthest = apart
        .iter()
        .map(|a| a - middle)
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))
        .unwrap();
    Measured {
        fps,
        latency_ms,
        apart_ms: [middle, furthest],
        pairs,
    }
}

fn tell(name: &str, measured: &Measured, seen: &LiveStatistics) {
    let [median, p95, max] = measured.latency_ms;
    println!(
        "{name}: {:.2} pairs/s, latency {median:.1} ms (p95 {p95:.1}, max {max:.1}), pictures {:.1} ms apart (furthest {:+.1}); torn {}+{}, late {}+{}, \
         skipped {}, lost pairs {}, offset {:?}",
        measured.fps,
        measured.apart_ms[0],
        measured.apart_ms[1],
        seen.left.counts.torn,
        seen.right.counts.torn,
        seen.left.late,
        seen.right.late,
        seen.skipped_pairs,
        seen.pairing.lost_pairs,
        seen.offset_s.map(|s| (s * 1e4).round() / 10.0)
    );
}

/// The figure that is asked for: two streams of 1024x768 at 30 frames a second in H.264 over TCP, 30 held, half of the pairs within 40 ms of their birth.
#[test]
fn thirty_a_second_within_forty_milliseconds() {
    let Some(server) = Server::start() else {
        return;
    };
    let mut source = open(&server.config(LiveKind::Rtsp, "h264"));
    let measured = measure(&mut source, 6.0);
    tell("H.264 over TCP", &measured, &source.statistics());
    assert!(
        (measured.fps - FPS).abs() < 0.5,
        "{} pairs a second",
        measured.fps
    );
    assert!(measured.latency_ms[0] <= 40.0, "{:?}", measured.latency_ms);
    let pairs = &measured.pairs;
    assert!(
        pairs
            .windows(2)
            .all(|w| w[0].index < w[1].index && w[0].capture_s() < w[1].capture_s())
    );
    assert!(
        measured.apart_ms[1].abs() < 0.5e3 / FPS,
        "a pair of two moments: {:?}",
        measured.apart_ms
    );
}

/// JPEG, and H.264 packet by packet.
#[test]
fn other_ways() {
    let Some(server) = Server::start() else {
        return;
    };
    for (coding, transport) in [("mjpeg", Transport::Tcp), ("h264", Transport::Udp)] {
        let mut config = server.config(LiveKind::Rtsp, coding);
        config.transport = transport;
        let mut source = open(&config);
        let measured = measure(&mut source, 2.0);
        tell(
            &format!("{coding} over {transport:?}"),
            &measured,
            &source.statistics(),
        );
        // What a loaded machine makes late on its way is no pair.
        assert!(
            (24.0..31.0).contains(&measured.fps),
            "{} pairs a second",
            measured.fps
        );
        assert!(measured.latency_ms[0] <= 60.0);
    }
}

/// The same streams through `ffmpeg`.
#[test]
fn through_ffmpeg() {
    let Some(server) = Server::start() else {
        return;
    };
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        println!("skipped: there is no program ffmpeg");
        return;
    }
    let mut source = open(&server.config(LiveKind::Stream, "h264"));
    let measured = measure(&mut source, 3.0);
    tell("through ffmpeg", &measured, &source.statistics());
    assert!((measured.fps - FPS).abs() < 2.0);
    assert!(measured.latency_ms[0] <= 120.0, "{:?}", measured.latency_ms);
}

/// A right camera that is steadily 14 ms late is paired with the same left one throughout, the offset is found to a few milliseconds, and one that
/// freezes or goes is told, stalls the source, and is back.
#[test]
fn offset_freeze_and_loss() {
    let Some(mut server) = Server::start() else {
        return;
    };
    server.order("delay 14");
    let mut config = server.config(LiveKind::Rtsp, "h264");
    // Streams are asked whether they are frozen only where one says so.
    config.frozen_after = 15;
    let mut source = open(&config);
    // The offset is known after some twenty frames.
    let _ = measure(&mut source, 1.5);
    let measured = measure(&mut source, 2.0);
    let seen = source.statistics();
    tell("14 ms apart", &measured, &seen);
    assert!((measured.fps - FPS).abs() < 2.0);
    assert!(
        (measured.apart_ms[0] - 14.0).abs() < 4.0 && measured.apart_ms[1].abs() < 16.0,
        "{:?}",
        measured.apart_ms
    );
    assert!(!seen.offset_of_exposure);

    server.order("drop");
    let gone = wait_for(&mut source, SourceEventKind::Gone);
    let back = wait_for(&mut source, SourceEventKind::Back);
    println!("{gone}; {back}");
    let again = measure(&mut source, 1.0);
    assert!(again.pairs.len() > 15, "{}", again.pairs.len());
    let counts = source.statistics().left.counts;
    assert!(counts.gone >= 1 && counts.back >= 1);

    server.order("freeze");
    // The clock in the picture stands as well; the coder repeats itself after a few frames.
    println!("{}", wait_for(&mut source, SourceEventKind::Frozen));
    while let Next::Pair(_) = source.next_within(0.5, None).unwrap() {}
    server.order("thaw");
    wait_for(&mut source, SourceEventKind::Thawed);
    assert!(measure(&mut source, 1.0).pairs.len() > 15);
}

/// The text of the next event of a kind, while pairs are fetched.
fn wait_for(source: &mut LiveSource, kind: SourceEventKind) -> String {
    let until = Instant::now() + Duration::from_secs(10);
    let mut all = Vec::new();
    loop {
        all.extend(source.take_events());
        if let Some(event) = all.iter().find(|e| e.kind == kind) {
            return event.text.clone();
        }
        assert!(Instant::now() < until, "no {kind:?} among {all:?}");
        let _ = source.next_within(0.1, None).unwrap();
    }
}

/// What is no camera is refused with one sentence.
#[test]
fn bad_addresses_are_refused() {
    let Some(server) = Server::start() else {
        return;
    };
    let refused = |left: &str| {
        let mut config = server.config(LiveKind::Rtsp, "h264");
        let LiveInput::Two { right, .. } = config.input else {
            unreachable!()
        };
        config.input = LiveInput::Two {
            left: left.into(),
            right,
        };
        config.start_s = 5.0;
        let error = LiveSource::open(&config, LiveRig::Fixed(&rig()), &RealClock::new())
            .unwrap_err()
            .to_string();
        println!("{error}");
        assert!(
            !error.contains('\n') && error.len() < 400 && !error.contains("secret"),
            "{error}"
        );
        error
    };
    let port = server.port;
    assert!(refused("rtsp://127.0.0.1:1/none").contains("rtsp://127.0.0.1:1/none"));
    assert!(refused(&format!("rtsp://user:secret@127.0.0.1:{port}/nowhere")).contains("nowhere"));
    assert!(refused("http://127.0.0.1/").contains("rtsp://host"));
    assert!(refused("no address").contains("no address"));
}
