//! Proves that two devices of the kernel's own `vivid` make pairs: in every format, with equal controls, with lost, damaged, frozen and black pictures, unplugged and back,
//! with clocks that wrap, and that what enters a device comes out of the source byte for byte.
//! `v4l2-ctl` sets the faults, reads controls back and writes pictures to the outputs. Motion JPEG and the controls of a lens are not among what
//! `vivid` gives; `uvc.rs` has them.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use vergence_capture::live::{ClockDomain, PixelFormat};
use vergence_capture::{
    CameraState, LiveConfig, LiveInput, LiveRig, LiveSource, Next, RealClock, Source as _,
    SourceEventKind, StereoFrame, TwinConfig, TwinSource,
};
use vergence_geometry::{Camera, Distortion, Eye, Intrinsics};
use vergence_imaging::{Rgb, files};
use vergence_scene::TwinCamera;

use super::{Devices, ctl, events_until, line, pairs, rig};

const CAMERAS: [&str; 2] = ["/dev/video0", "/dev/video1"];
const OUTPUTS: [&str; 2] = ["/dev/video2", "/dev/video3"];
const SIZE: (usize, usize) = (640, 480);

/// `vivid` gives 640x480 at this rate at most.
const FPS: f64 = 25.0;

/// One test at a time has the devices; `None` where there are none. They start as a webcam that shows colour bars with a running time.
fn devices() -> Option<Devices> {
    if !Path::new("/sys/module/vivid").exists() {
        println!("skipped: there are no vivid devices; ci/vivid/run.sh makes some");
        return None;
    }
    let devices = Devices::wait();
    for camera in CAMERAS {
        ctl(camera, &["--set-input=0"]);
        ctl(
            camera,
            &[
                "--set-ctrl=percentage_of_dropped_buffers=0,wrap_timestamp=0,wrap_sequence_number=0,timestamp_source=1,test_pattern=0,osd_text_mode=0,gain_automatic=0,brightness=128,contrast=128",
            ],
        );
    }
    Some(devices)
}

fn config(format: PixelFormat) -> LiveConfig {
    let input = LiveInput::Two {
        left: PathBuf::from(CAMERAS[0]),
        right: PathBuf::from(CAMERAS[1]),
    };
    let mut config = LiveConfig::new(vergence_capture::live::LiveKind::V4l2, input);
    config.v4l2.format = Some(format);
    config.fps = Some(FPS);
    config
}

fn open(config: &LiveConfig) -> LiveSource {
    LiveSource::open(config, LiveRig::Fixed(&rig(SIZE)), &RealClock::new()).unwrap()
}

/// Every format at once from both cameras: the rate is held, times are the driver's, pairs belong together, and the colours are those that
/// `vivid` itself writes as RGB.
#[test]
fn two_cameras_in_every_format() {
    let Some(_guard) = devices() else { return };
    for camera in CAMERAS {
        ctl(camera, &["--set-ctrl=osd_text_mode=2"]);
    }
    let mut told: Option<Rgb> = None;
    for format in [
        PixelFormat::Rgb24,
        PixelFormat::Yuyv,
        PixelFormat::Nv12,
        PixelFormat::Grey,
    ] {
        let mut config = config(format);
        config.frozen_after = 0;
        let mut source = open(&config);
        let got = pairs(&mut source, 25);
        let seen = source.statistics();
        println!("{format:?}: {}", line(&seen));
        for (camera, name) in [(&seen.left, CAMERAS[0]), (&seen.right, CAMERAS[1])] {
            assert_eq!(camera.name, name);
            assert_eq!(camera.counts.clock, ClockDomain::Machine);
            assert!(
                (camera.period.median_s * FPS - 1.0).abs() < 0.1,
                "{camera:?}"
            );
            assert!((0.0..0.2).contains(&camera.latency.median_s), "{camera:?}");
            assert_eq!((camera.counts.torn, camera.counts.clock_jumps), (0, 0));
        }
        for pair in &got {
            assert_eq!(
                (pair.left.picture.size(), pair.right.picture.size()),
                (SIZE, SIZE)
            );
            assert_eq!(pair.left.picture, pair.right.picture);
            assert!(pair.arrival_s() >= pair.capture_s());
        }
        assert!(
            got.windows(2)
                .all(|w| w[0].index < w[1].index && w[0].capture_s() < w[1].capture_s())
        );
        assert!(seen.skew.max_s <= 0.2 / FPS, "{:?}", seen.skew);
        let picture = &got[24].left.picture;
        match &told {
            None => told = Some(picture.clone()),
            Some(rgb) if format != PixelFormat::Grey => assert!(alike(rgb, picture), "{format:?}"),
            Some(_) => assert!(picture.samples().iter().all(|[r, g, b]| r == g && g == b)),
        }
    }
}

/// Equal to two levels but at edges, where chroma that two pixels share is neither's.
fn alike(a: &Rgb, b: &Rgb) -> bool {
    let near = |(p, q): (&[u8; 3], &[u8; 3])| p.iter().zip(q).all(|(x, y)| x.abs_diff(*y) <= 3);
    let count = a
        .samples()
        .iter()
        .zip(b.samples())
        .filter(|pair| near(*pair))
        .count();
    let share = count as f64 / a.samples().len() as f64;
    println!("  {:.2} % of the pixels within 3 levels", 100.0 * share);
    share > 0.95
}

/// Automatics are off and values equal on both eyes, those that were said and those that were not; unplugged, a camera is told, held
/// against nothing, found again, and gets the same values.
#[test]
fn controls_are_equal_and_survive_unplugging() {
    let Some(_guard) = devices() else { return };
    ctl(
        CAMERAS[0],
        &["--set-ctrl=gain_automatic=1,brightness=140,contrast=120"],
    );
    ctl(
        CAMERAS[1],
        &["--set-ctrl=gain_automatic=1,brightness=90,contrast=200"],
    );
    let mut config = config(PixelFormat::Yuyv);
    config.v4l2.controls.gain = Some(77);
    let mut source = open(&config);
    let wanted = [
        "gain_automatic: 0",
        "gain: 77",
        "brightness: 140",
        "contrast: 120",
    ];
    let check = |camera: &str| {
        let said = ctl(
            camera,
            &["--get-ctrl=gain_automatic,gain,brightness,contrast"],
        );
        assert!(
            wanted.iter().all(|line| said.contains(line)),
            "{camera}: {said}"
        );
    };
    CAMERAS.iter().for_each(|c| check(c));
    assert!(
        !source.remarks().iter().any(|r| r.contains("gain")),
        "{:?}",
        source.remarks()
    );
    pairs(&mut source, 5);

    ctl(CAMERAS[1], &["--set-ctrl=disconnect=1"]);
    let gone = events_until(&mut source, SourceEventKind::Gone, Some(Eye::Right));
    let text = &gone
        .iter()
        .find(|e| e.kind == SourceEventKind::Gone)
        .unwrap()
        .text;
    assert!(text.starts_with("/dev/video1 went"), "{text}");
    println!("unplugged: {text}");
    if !gone.iter().any(|e| e.kind == SourceEventKind::Back) {
        let back = events_until(&mut source, SourceEventKind::Back, Some(Eye::Right));
        println!("{}", back.last().unwrap().text);
    }
    let again = pairs(&mut source, 10);
    assert!(again.windows(2).all(|w| w[0].index < w[1].index));
    let counts = source.statistics().right.counts;
    assert_eq!((counts.gone, counts.back), (1, 1));
    CAMERAS.iter().for_each(|c| check(c));
}

/// Buffers that the driver drops are counted as lost, those marked as damaged as torn; neither is paired with another moment's.
#[test]
fn lost_and_torn_frames() {
    let Some(_guard) = devices() else { return };
    let mut source = open(&config(PixelFormat::Yuyv));
    pairs(&mut source, 10);
    let before = source.statistics();
    ctl(CAMERAS[0], &["--set-ctrl=percentage_of_dropped_buffers=30"]);
    ctl(CAMERAS[1], &["--set-ctrl=inject_v4l2_buf_flag_error=1"]);
    let got = pairs(&mut source, 35);
    let seen = source.statistics();
    println!("{}", line(&seen));
    assert!(
        seen.left.counts.lost >= before.left.counts.lost + 5,
        "{seen:?}"
    );
    assert!((1..=2).contains(&seen.right.counts.torn), "{seen:?}");
    assert!(seen.pairing.lost_pairs > before.pairing.lost_pairs);
    let apart = |p: &StereoFrame| {
        (p.left.capture_s - p.right.capture_s - (got[0].left.capture_s - got[0].right.capture_s))
            .abs()
    };
    assert!(
        got.iter().all(|p| apart(p) < 0.5 / FPS),
        "a pair of two moments"
    );
    assert!(source.dropped_pairs() > 0);
}

/// A picture that stands still is told, not used, and makes the source stall rather than give old pairs; a black one is told and used.
#[test]
fn frozen_and_dark_pictures() {
    let Some(_guard) = devices() else { return };
    let mut source = open(&config(PixelFormat::Yuyv));
    pairs(&mut source, 3);
    ctl(CAMERAS[0], &["--set-ctrl=osd_text_mode=2"]);
    events_until(&mut source, SourceEventKind::Frozen, Some(Eye::Left));
    while let Next::Pair(_) = source.next_within(0.3, None).unwrap() {}
    assert_eq!(
        source.liveness().unwrap().map(|l| l.state),
        [CameraState::Frozen, CameraState::Live]
    );
    ctl(CAMERAS[0], &["--set-ctrl=osd_text_mode=1,test_pattern=5"]);
    events_until(&mut source, SourceEventKind::Thawed, Some(Eye::Left));
    let until = Instant::now() + Duration::from_secs(10);
    while !source.liveness().unwrap()[0].dark {
        assert!(Instant::now() < until, "a black picture that nobody sees");
        let _ = source.next_within(0.1, None).unwrap();
    }
    assert!(!source.liveness().unwrap()[1].dark);
    pairs(&mut source, 3);
    assert!(source.statistics().left.counts.frozen > 0);
}

/// A camera whose clock stands elsewhere and wraps after 16 s, and whose numbers wrap: told, and pairs go on in order.
#[test]
fn wrapped_times_and_numbers() {
    let Some(_guard) = devices() else { return };
    ctl(
        CAMERAS[1],
        &["--set-ctrl=wrap_timestamp=1,wrap_sequence_number=1"],
    );
    let mut source = open(&config(PixelFormat::Grey));
    assert_eq!(source.statistics().right.counts.clock, ClockDomain::Own);
    let started = Instant::now();
    let mut last_s = f64::NEG_INFINITY;
    let mut longest_s = 0.0_f64;
    let mut count = 0;
    while started.elapsed() < Duration::from_secs(18) {
        if let Next::Pair(pair) = source.next_within(1.0, None).unwrap() {
            assert!(pair.capture_s() > last_s);
            if last_s.is_finite() {
                longest_s = longest_s.max(pair.capture_s() - last_s);
            }
            last_s = pair.capture_s();
            count += 1;
        }
    }
    let seen = source.statistics();
    println!(
        "{count} pairs in 18 s, longest gap {longest_s:.3} s; {}",
        line(&seen)
    );
    assert_eq!(seen.left.counts.clock_jumps, 0);
    assert!(
        seen.right.counts.clock_jumps >= 1,
        "the clock did not wrap: {seen:?}"
    );
    assert!(seen.right.counts.lost < 100, "a wrapped number is no loss");
    assert!(longest_s < 2.0 && count > 200);
}

/// Where a machine that renders fast has left the twin's pictures: the guest takes half a minute for them.
fn twin_folder() -> Option<PathBuf> {
    std::env::var_os("VERGENCE_TWIN_PICTURES").map(PathBuf::from)
}

/// Two pairs of the twin, left and right; from the folder, when they are there.
fn twin_pictures() -> [Vec<Rgb>; 2] {
    let named =
        |eye: usize, k: usize| twin_folder().map(|folder| folder.join(format!("{eye}_{k}.png")));
    if named(1, 1).is_some_and(|path| path.exists()) {
        return [0, 1].map(|eye| {
            (0..2)
                .map(|k| files::read_rgb(&named(eye, k).unwrap()).unwrap())
                .collect()
        });
    }
    let camera = TwinCamera {
        camera: Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, SIZE.0, SIZE.1),
            distortion: Distortion::NONE,
        },
        ..TwinCamera::default()
    };
    let config = TwinConfig {
        cameras: [camera; 2],
        seconds: Some(0.2),
        ..TwinConfig::default()
    };
    let mut twin = TwinSource::new(config).unwrap();
    let mut pictures: [Vec<Rgb>; 2] = [Vec::new(), Vec::new()];
    for _ in 0..2 {
        let pair = twin.next_pair(None).unwrap().unwrap();
        pictures[0].push(pair.left.picture);
        pictures[1].push(pair.right.picture);
    }
    pictures
}

/// Not a test of anything: leaves the twin's pictures in the folder that `VERGENCE_TWIN_PICTURES` names, for a guest.
#[test]
fn leave_the_twins_pictures() {
    let Some(folder) = twin_folder().filter(|folder| folder.is_dir()) else {
        return;
    };
    let pictures = twin_pictures();
    for (eye, pictures) in pictures.iter().enumerate() {
        for (k, picture) in pictures.iter().enumerate() {
            let path = folder.join(format!("{eye}_{k}.png"));
            if !path.exists() {
                files::write_rgb(&path, picture).unwrap();
            }
        }
    }
}

/// Pictures of the twin, written to both outputs, come out of both cameras byte for byte.
#[test]
fn the_twins_pictures_come_through() {
    let Some(_guard) = devices() else { return };
    let written = twin_pictures();
    assert!(written[0][0] != written[0][1] && written[0][0] != written[1][0]);
    let folder = tempfile::tempdir().unwrap();
    let writers: Vec<Writer> = (0..2)
        .map(|i| Writer::start(i, folder.path(), &written[i]))
        .collect();
    let mut config = config(PixelFormat::Rgb24);
    config.fps = None;
    config.frozen_after = 0;
    let mut source = open(&config);
    let mut seen = [[0_u32; 2]; 2];
    let mut others = 0;
    for pair in pairs(&mut source, 40) {
        for (eye, picture) in [&pair.left.picture, &pair.right.picture]
            .into_iter()
            .enumerate()
        {
            match written[eye].iter().position(|w| w == picture) {
                Some(k) => seen[eye][k] += 1,
                // Before its writer has begun an output shows noise.
                None => others += u32::from(seen[eye] != [0, 0]),
            }
        }
    }
    println!(
        "{}; pictures seen {seen:?}, others {others}",
        line(&source.statistics())
    );
    drop(writers);
    assert_eq!(others, 0, "a picture that nobody wrote");
    assert!(seen.iter().flatten().all(|&n| n > 2), "{seen:?}");
}

/// Writes pictures to an output again and again.
struct Writer(Child);

impl Writer {
    fn start(i: usize, folder: &Path, pictures: &[Rgb]) -> Self {
        let file = folder.join(format!("{i}.rgb"));
        let bytes: Vec<u8> = pictures
            .iter()
            .flat_map(|p| p.samples().as_flattened().to_vec())
            .collect();
        std::fs::write(&file, bytes).unwrap();
        // Input and output with the same timings, 640x480 at 59.94 Hz, and the one led into the other.
        ctl(CAMERAS[i], &["--set-input=1"]);
        ctl(CAMERAS[i], &["--set-dv-bt-timings=index=0"]);
        ctl(OUTPUTS[i], &["--set-dv-bt-timings=index=0"]);
        ctl(CAMERAS[i], &["--set-ctrl=osd_text_mode=2,loop_video=1"]);
        ctl(
            OUTPUTS[i],
            &["--set-fmt-video-out=width=640,height=480,pixelformat=RGB3"],
        );
        let child = Command::new("v4l2-ctl")
            .args([
                "--device",
                OUTPUTS[i],
                "--stream-out-mmap=4",
                "--stream-loop",
            ])
            .arg(format!("--stream-from={}", file.display()))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Self(child)
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A driver that stamps ahead (`vivid` does with the end of the frame): no frame is taken after it arrived.
#[test]
fn stamps_ahead_are_not_believed() {
    let Some(_guard) = devices() else { return };
    for camera in CAMERAS {
        ctl(camera, &["--set-ctrl=timestamp_source=0"]);
    }
    let mut source = open(&config(PixelFormat::Grey));
    let got = pairs(&mut source, 10);
    let seen = source.statistics();
    println!("{}", line(&seen));
    assert_eq!(seen.left.counts.clock, ClockDomain::Own);
    assert!(!seen.offset_of_exposure);
    // Of two clocks that are unlike the steady offset, up to half a period, is taken out of the right one's times.
    let ahead_s = 0.5 / FPS;
    assert!(
        got.iter()
            .all(|p| p.left.arrival_s >= p.left.capture_s - 1e-9
                && p.right.arrival_s >= p.right.capture_s - ahead_s)
    );
}

/// One device that gives both pictures side by side is a pair of one moment.
#[test]
fn side_by_side() {
    let Some(_guard) = devices() else { return };
    let mut config = config(PixelFormat::Yuyv);
    config.input = LiveInput::SideBySide(PathBuf::from(CAMERAS[0]));
    config.fps = None;
    let rig = rig((320, 480));
    let mut source = LiveSource::open(&config, LiveRig::Fixed(&rig), &RealClock::new()).unwrap();
    let got = pairs(&mut source, 10);
    for pair in &got {
        assert_eq!(
            (pair.left.picture.size(), pair.right.picture.size()),
            ((320, 480), (320, 480))
        );
        assert_eq!(pair.left.capture_s, pair.right.capture_s);
        assert_ne!(pair.left.picture, pair.right.picture);
    }
    assert_eq!(source.statistics().skew.max_s, 0.0);
}

/// What cannot be used is refused with one sentence that names it, and nothing is left open.
#[test]
fn bad_devices_are_refused() {
    let Some(_guard) = devices() else { return };
    let refused = |left: &str, change: fn(&mut LiveConfig), size: (usize, usize)| {
        let mut config = config(PixelFormat::Yuyv);
        config.input = LiveInput::Two {
            left: left.into(),
            right: CAMERAS[1].into(),
        };
        change(&mut config);
        let error =
            LiveSource::open(&config, LiveRig::Fixed(&rig(size)), &RealClock::new()).unwrap_err();
        let text = error.to_string();
        println!("{text}");
        assert!(!text.contains('\n') && text.len() < 300, "{text}");
        text
    };
    let same = |_: &mut LiveConfig| {};
    assert!(refused("/dev/video77", same, SIZE).contains("no such device"));
    assert!(refused("/dev/null", same, SIZE).contains("is no camera"));
    assert!(refused("/dev/zero", same, SIZE).contains("is no camera"));
    assert!(refused("/bin/busybox", same, SIZE).contains("/bin/busybox"));
    assert!(refused("/dev", same, SIZE).contains("/dev"));
    assert!(refused(OUTPUTS[0], same, SIZE).contains("gives no pictures"));
    assert!(refused(CAMERAS[1], same, SIZE).contains("both are"));
    assert!(refused(CAMERAS[0], same, (641, 480)).contains("it gives 320x180, 640x360, 640x480"));
    let mjpeg = |c: &mut LiveConfig| c.v4l2.format = Some(PixelFormat::Mjpeg);
    assert!(refused(CAMERAS[0], mjpeg, SIZE).contains("needed is MJPG"));
    let busy = Command::new("v4l2-ctl")
        .args(["--device", CAMERAS[0], "--stream-mmap=2"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let busy = Writer(busy);
    std::thread::sleep(Duration::from_millis(1500));
    assert!(refused(CAMERAS[0], same, SIZE).contains("another program uses it"));
    drop(busy);
    pairs(&mut open(&config(PixelFormat::Yuyv)), 2);
}
