//! Proves that two USB cameras behind the kernel's own driver make pairs: frames of motion JPEG and raw ones arrive as they were sent, picture by picture;
//! exposure, gain, white balance and focus are what the cameras themselves were told, the same in both; damaged frames are counted and left out; and a
//! camera that is plugged in again is known by its place. The cameras are ours (`camera.rs`), plugged into the kernel's virtual host controller
//! (`usbip.rs`); the driver between them and the source is `uvcvideo`.

mod camera;
mod descriptors;
mod usbip;

use std::path::{Path, PathBuf};
use std::sync::{MutexGuard, OnceLock};
use std::time::{Duration, Instant};

use vergence_capture::live::{Abilities, ClockDomain, LiveKind, PixelFormat};
use vergence_capture::{
    CameraState, Clock as _, Frame, LiveConfig, LiveInput, LiveRig, LiveSource, RealClock,
    Source as _, SourceEventKind, StereoFrame,
};
use vergence_geometry::Eye;
use vergence_imaging::{Rgb, files};

use self::camera::{Camera, FPS, Level, SIZE, Spoil, State, period};
use self::descriptors::{MJPEG, YUYV};
use self::usbip::{Cable, HOST};
use super::{Devices, events_until, line, pairs, rig};

/// Where links to the cameras' nodes stand, as `udev` makes them: by the place in which they are plugged.
const LINKS: &str = "/dev/v4l/by-path";

/// So many pictures are sent in turn; at 15 a second the turn takes 533 ms.
const PICTURES: usize = 8;

/// What both cameras send.
struct Pictures {
    jpegs: [Vec<Vec<u8>>; 2],
    /// The same, decoded.
    seen: [Vec<Rgb>; 2],
    raws: [Vec<Vec<u8>>; 2],
    foreign: Vec<u8>,
}

fn pictures() -> &'static Pictures {
    static PICTURES_SENT: OnceLock<Pictures> = OnceLock::new();
    PICTURES_SENT.get_or_init(|| {
        let jpegs = [0, 1].map(|eye| (0..PICTURES).map(|k| jpeg(eye, k, SIZE)).collect());
        let decode = |all: &Vec<Vec<u8>>| all.iter().map(|one| decoded(one)).collect();
        Pictures {
            seen: jpegs.each_ref().map(decode),
            jpegs,
            raws: [0, 1].map(|eye| (0..PICTURES).map(|k| raw(eye, k)).collect()),
            foreign: jpeg(0, 0, (160, 120)),
        }
    })
}

/// A camera as it comes from the factory: its automatics are on.
fn fresh(eye: usize) -> State {
    let mut state = State::new(["left camera", "right camera"][eye]);
    state.jpegs.clone_from(&pictures().jpegs[eye]);
    state.raws.clone_from(&pictures().raws[eye]);
    state.foreign.clone_from(&pictures().foreign);
    state
}

/// Both cameras, the left one at port 0.
struct Pair {
    cameras: [Option<Camera>; 2],
    epoch: Instant,
    /// The run's clock, and what it showed at the epoch.
    clock: RealClock,
    epoch_s: f64,
    _devices: Devices,
}

impl Pair {
    /// Plug both in; `None` where there is no place for them.
    fn plug(change: impl Fn(usize, &mut State)) -> Option<Self> {
        let there = |path: &str| Path::new(path).exists();
        if !there("/sys/module/vivid") {
            println!("skipped: there is no virtual USB host; ci/vivid/run.sh makes one");
            return None;
        }
        // Where `vivid` is, `ci/vivid/run.sh` has loaded these, too.
        assert!(
            there("/sys/module/uvcvideo") && there(HOST),
            "no virtual USB host"
        );
        let devices = Devices::wait();
        let (epoch, clock) = (Instant::now(), RealClock::new());
        let mut pair = Self {
            cameras: [None, None],
            epoch,
            epoch_s: clock.now_s() - epoch.elapsed().as_secs_f64(),
            clock,
            _devices: devices,
        };
        for eye in 0..2 {
            let mut state = fresh(eye);
            change(eye, &mut state);
            pair.put(eye, state);
        }
        Some(pair)
    }

    /// Plug a camera into its port and wait until its nodes are there; link to the one that gives pictures, as `udev` does.
    fn put(&mut self, eye: usize, state: State) {
        self.cameras[eye] = Some(Camera::plug(eye, state, self.epoch));
        let until = Instant::now() + Duration::from_secs(5);
        while nodes(eye).len() < 2 {
            assert!(Instant::now() < until, "port {eye} has {:?}", nodes(eye));
            std::thread::sleep(Duration::from_millis(10));
        }
        std::fs::create_dir_all(LINKS).unwrap();
        std::os::unix::fs::symlink(&nodes(eye)[0], link(eye)).unwrap();
    }

    fn unplug(&mut self, eye: usize) {
        let _ = std::fs::remove_file(link(eye));
        self.cameras[eye] = None;
    }

    fn state(&self, eye: usize) -> MutexGuard<'_, State> {
        self.cameras[eye].as_ref().unwrap().state()
    }

    fn open(&self, config: &LiveConfig) -> LiveSource {
        LiveSource::open(config, LiveRig::Fixed(&rig(SIZE)), &self.clock).unwrap()
    }

    /// The numbers with which the pictures of a pair were sent; `all` is what each eye sends in turn.
    fn numbers(&self, seen: &StereoFrame, all: &[Vec<Rgb>; 2]) -> [usize; 2] {
        [0, 1].map(|eye| {
            let side = sides(seen)[eye];
            let k = all[eye].iter().position(|sent| *sent == side.picture);
            let k = k.unwrap_or_else(|| panic!("a picture of eye {eye} that nobody sent"));
            // Of those whose picture it is, the one nearest to its time.
            let periods = (side.capture_s - self.epoch_s) * f64::from(FPS) - k as f64;
            k + PICTURES * (periods / PICTURES as f64).round() as usize
        })
    }

    /// The middle of a picture's exposure, s.
    fn middle_s(&self, number: usize) -> f64 {
        self.epoch_s + period().as_secs_f64() * number as f64
    }
}

impl Drop for Pair {
    fn drop(&mut self) {
        (0..2).for_each(|eye| self.unplug(eye));
    }
}

fn link(port: usize) -> PathBuf {
    Path::new(LINKS).join(format!("vergence-test-{port}"))
}

/// The nodes of the camera at a port, the one that gives pictures first.
fn nodes(port: usize) -> Vec<PathBuf> {
    let interface = Cable::shown(port);
    let name = interface.file_name().unwrap().to_str().unwrap().to_owned();
    let class = interface.join(format!("{name}:1.0/video4linux"));
    let Ok(entries) = std::fs::read_dir(class) else {
        return Vec::new();
    };
    let mut found: Vec<(String, PathBuf)> = entries
        .filter_map(|entry| {
            let entry = entry.ok()?;
            let index = std::fs::read_to_string(entry.path().join("index")).ok()?;
            let node = Path::new("/dev").join(entry.file_name());
            node.exists().then_some((index, node))
        })
        .collect();
    found.sort();
    found.into_iter().map(|(_, node)| node).collect()
}

/// Picture k of an eye: a ramp with a square that is elsewhere in each.
fn drawn(eye: usize, k: usize, (width, height): (usize, usize)) -> Rgb {
    let mut picture = Rgb::filled(width, height, [0; 3]);
    for y in 0..height {
        for (x, pixel) in picture.row_mut(y).iter_mut().enumerate() {
            let square =
                (x + 10 * eye).abs_diff(30 + 30 * k) < 20 && y.abs_diff(60 + 80 * eye) < 30;
            *pixel = match square {
                true => [250, 30 * k as u8, 200 * eye as u8],
                false => [(x * 255 / width) as u8, (y * 255 / height) as u8, 90],
            };
        }
    }
    picture
}

fn jpeg(eye: usize, k: usize, size: (usize, usize)) -> Vec<u8> {
    files::encode_jpeg(&drawn(eye, k, size), 85).unwrap()
}

fn decoded(jpeg: &[u8]) -> Rgb {
    files::shown_from_bytes(jpeg, Path::new("sent.jpg"))
        .unwrap()
        .picture
}

/// Picture k of an eye as YUYV: grey, each pixel's luma told by its place and the picture's number.
fn raw(eye: usize, k: usize) -> Vec<u8> {
    let luma = |i: usize| (16 + (i * 7 + k * 13 + eye * 101) % 200) as u8;
    (0..SIZE.0 * SIZE.1).flat_map(|i| [luma(i), 128]).collect()
}

fn config(format: PixelFormat) -> LiveConfig {
    let [left, right] = [0, 1].map(|eye| nodes(eye)[0].clone());
    let mut config = LiveConfig::new(LiveKind::V4l2, LiveInput::Two { left, right });
    config.v4l2.format = Some(format);
    config
}

fn sides(pair: &StereoFrame) -> [&Frame; 2] {
    [&pair.left, &pair.right]
}

/// Frames of motion JPEG are the pictures that were sent, in order, both eyes' of one moment, and their times are the middle of the exposure as far as a
/// driver can know it; what is damaged, is of another size or is marked by the camera is counted and not used, and nothing else comes of it. Raw frames
/// are the bytes that were sent. The node that tells about pictures is refused.
#[test]
fn frames_as_they_were_sent() {
    let Some(pair) = Pair::plug(|_, _| {}) else {
        return;
    };
    motion_jpeg(&pair);

    let all = pictures().raws.each_ref();
    let all = all.map(|raws| raws.iter().map(|raw| grey(raw)).collect());
    let mut source = pair.open(&config(PixelFormat::Yuyv));
    for stereo in pairs(&mut source, 5) {
        pair.numbers(&stereo, &all);
    }
    println!("YUYV: {}", line(&source.statistics()));

    let mut tells = config(PixelFormat::Mjpeg);
    let [left, right] = [nodes(0)[1].clone(), nodes(1)[0].clone()];
    tells.input = LiveInput::Two { left, right };
    let refused = LiveSource::open(&tells, LiveRig::Fixed(&rig(SIZE)), &pair.clock);
    let refused = refused.unwrap_err().to_string();
    println!("{refused}");
    assert!(refused.contains("data about pictures"), "{refused}");
}

fn motion_jpeg(pair: &Pair) {
    let all = &pictures().seen;
    let mut config = config(PixelFormat::Mjpeg);
    config.v4l2.controls.exposure = Some(300);
    let mut source = pair.open(&config);
    let mut got = pairs(&mut source, 20);
    let before = source.statistics();
    println!("MJPG: {}", line(&before));
    assert_eq!((before.left.counts.torn, before.right.counts.torn), (0, 0));
    for camera in [&before.left, &before.right] {
        assert_eq!(camera.counts.clock, ClockDomain::Machine);
        let rate = camera.period.median_s * f64::from(FPS);
        assert!((rate - 1.0).abs() < 0.2, "{camera:?}");
    }

    let spoiled = [Spoil::Cut, Spoil::Garbled, Spoil::Hollow, Spoil::Foreign];
    pair.state(0).spoil.extend(spoiled);
    pair.state(1).spoil.extend([Spoil::Marked; 2]);
    got.extend(pairs(&mut source, 10));
    let seen = source.statistics();
    println!("MJPG: {}", line(&seen));
    assert!((0..2).all(|eye| pair.state(eye).spoil.is_empty()));
    assert_eq!((seen.left.counts.torn, seen.right.counts.torn), (4, 0));
    let lost = seen.right.counts.lost - before.right.counts.lost;
    assert!(lost >= 2, "{seen:?}");
    assert_eq!((seen.left.counts.gone, seen.right.counts.gone), (0, 0));

    let numbers: Vec<[usize; 2]> = got.iter().map(|p| pair.numbers(p, all)).collect();
    let rising = |w: &[[usize; 2]]| w[0][0] < w[1][0] && w[0][1] < w[1][1];
    assert!(numbers.windows(2).all(rising), "{numbers:?}");
    let apart = numbers.iter().filter(|n| n[0] != n[1]).count();
    let late_s = got.iter().zip(&numbers).flat_map(|(stereo, numbers)| {
        let late_s = |eye: usize| sides(stereo)[eye].capture_s - pair.middle_s(numbers[eye]);
        [0, 1].map(late_s)
    });
    let mut late_s: Vec<f64> = late_s.collect();
    late_s.sort_by(f64::total_cmp);
    let [first_ms, median_ms] = [late_s[0], late_s[late_s.len() / 2]].map(|s| 1e3 * s);
    println!(
        "  {apart} pairs of two moments; stamps behind the exposure's middle by {first_ms:.1} ms at least, {median_ms:.1} in the median"
    );
    // A guest that stands still for a moment gives two pictures one time of arrival, which is all that the driver knows.
    assert!(apart <= 2, "{numbers:?}");
    assert!((-2.0..12.0).contains(&first_ms), "{late_s:?}");
}

/// The grey picture of [`raw`] bytes, by the definition of limited range (ITU-R BT.601-7).
fn grey(bytes: &[u8]) -> Rgb {
    let mut picture = Rgb::filled(SIZE.0, SIZE.1, [0; 3]);
    for y in 0..SIZE.1 {
        for (x, pixel) in picture.row_mut(y).iter_mut().enumerate() {
            let luma = f64::from(bytes[2 * (SIZE.0 * y + x)]) - 16.0;
            *pixel = [(luma * 255.0 / 219.0).round() as u8; 3];
        }
    }
    picture
}

/// The cameras themselves were told that their automatics are off and the same exposure, gain, white balance and focus. What one of them does not take is
/// said, and both get what both take. Both are unplugged and come back as they were made and in the other order, so that their numbers are exchanged: each
/// eye finds its own camera, and tells it the same again.
#[test]
fn controls_and_places() {
    let make = |eye: usize, state: &mut State| {
        *state.level("exposure") = Level::new(3, [2047, 300][eye], 1, [1800, 150][eye]);
        *state.level("brightness") = Level::new(-64, 64, 1, [7, -20][eye]);
        *state.level("contrast") = Level::new([0, 40][eye], 95, 1, [32, 50][eye]);
    };
    let Some(mut pair) = Pair::plug(make) else {
        return;
    };
    let mut config = config(PixelFormat::Mjpeg);
    config.v4l2.controls.exposure = Some(1500);
    config.v4l2.controls.gain = Some(77);
    config.v4l2.controls.white_balance = Some(5200);
    config.v4l2.controls.focus = Some(120);
    let mut source = pair.open(&config);
    let [left, right] = [0, 1].map(|eye| nodes(eye)[0].display().to_string());
    println!("{:?}", source.remarks());
    assert_eq!(
        source.remarks(),
        [
            format!("exposure 1500 cannot be set: {right} takes 3 to 300; it is 300 on both"),
            format!("contrast was 32 on {left}: {right} takes 40 to 95; it is 40 on both"),
        ]
    );
    (0..2).for_each(|eye| was_told(&mut pair.state(eye)));
    pairs(&mut source, 3);

    (0..2).for_each(|eye| pair.unplug(eye));
    for eye in Eye::BOTH {
        let state = source.liveness().unwrap()[eye as usize].state;
        if state != CameraState::Gone {
            events_until(&mut source, SourceEventKind::Gone, Some(eye));
        }
    }
    for (eye, which) in [(1, Eye::Right), (0, Eye::Left)] {
        let mut state = fresh(eye);
        make(eye, &mut state);
        pair.put(eye, state);
        let back = events_until(&mut source, SourceEventKind::Back, Some(which));
        println!("{:?}: {}", nodes(eye)[0], back.last().unwrap().text);
        was_told(&mut pair.state(eye));
    }
    assert_eq!(nodes(1)[0].display().to_string(), left);
    let numbers: Vec<[usize; 2]> = (pairs(&mut source, 5).iter())
        .map(|p| pair.numbers(p, &pictures().seen))
        .collect();
    println!("  {numbers:?}");
    let counts = Eye::BOTH.map(|eye| {
        let seen = source.statistics();
        [seen.left.counts, seen.right.counts][eye as usize]
    });
    assert!(
        counts.iter().all(|c| (c.gone, c.back) == (1, 1)),
        "{counts:?}"
    );
}

/// Cameras whose formats or rates differ are refused in one sentence that says what each gives and what to do.
#[test]
fn formats_and_rates_that_differ() {
    let refused = |pair: &Pair, asked: Option<PixelFormat>| {
        let mut config = config(PixelFormat::Mjpeg);
        config.v4l2.format = asked;
        let refused = LiveSource::open(&config, LiveRig::Fixed(&rig(SIZE)), &pair.clock);
        let text = refused.unwrap_err().to_string();
        println!("{text}");
        text
    };
    let unlike = |eye: usize, state: &mut State| state.sends = vec![[MJPEG, YUYV][eye]];
    let Some(pair) = Pair::plug(unlike) else {
        return;
    };
    let names = || [0, 1].map(|eye| nodes(eye)[0].display().to_string());
    let [left, right] = names();
    assert_eq!(
        refused(&pair, None),
        format!(
            "left and right do not belong together: {left} gives MJPG, {right} gives YUYV in 320x240 pixels; there must be one format that both have: use two \
             cameras of one type, or a size in which they share a format"
        )
    );
    assert_eq!(
        refused(&pair, Some(PixelFormat::Mjpeg)),
        format!(
            "{right} cannot be used: it gives YUYV; needed is MJPG: ask for a format that it gives, or for none"
        )
    );
    drop(pair);

    let slower = |eye: usize, state: &mut State| state.fps = [FPS, 10][eye];
    let Some(pair) = Pair::plug(slower) else {
        return;
    };
    let [left, right] = names();
    assert_eq!(
        refused(&pair, Some(PixelFormat::Mjpeg)),
        format!(
            "left and right do not belong together: {left} gives 15.00 pictures a second, {right} 10.00; ask for a rate that both have"
        )
    );
}

/// A camera that is asked says its formats, sizes, rates and controls, and stands as it stood; what both were opened with is told as well.
#[test]
fn what_cameras_can_do() {
    let Some(pair) = Pair::plug(|_, _| {}) else {
        return;
    };
    let can = Abilities::of(&nodes(0)[0]).unwrap();
    println!("{can:?}");
    assert_eq!(can.driver, "uvcvideo");
    assert!(can.card.contains("left camera"), "{}", can.card);
    let formats: Vec<(&str, bool)> = (can.formats.iter())
        .map(|f| (f.name.as_str(), f.is_read))
        .collect();
    assert_eq!(formats, [("MJPG", true), ("YUYV", true)]);
    for format in &can.formats {
        let [size] = &format.sizes[..] else {
            panic!("{format:?}");
        };
        assert_eq!((size.size, size.up_to), ((320, 240), None));
        assert!(
            size.fps.len() == 1 && (size.fps[0] - 15.0).abs() < 0.01,
            "{size:?}"
        );
    }
    let exposure = can.controls.iter().find(|c| c.name == "exposure").unwrap();
    assert_eq!(
        (exposure.least, exposure.most, exposure.now),
        (3, 2047, 250)
    );
    assert!(can.automatics.contains(&"automatic focus"), "{can:?}");
    assert!(pair.state(0).set.is_empty(), "asking sets nothing");

    let mut config = config(PixelFormat::Mjpeg);
    config.v4l2.controls.exposure = Some(300);
    let mut source = pair.open(&config);
    // While it is read it may be asked.
    assert_eq!(Abilities::of(&nodes(0)[0]).unwrap().formats, can.formats);
    pairs(&mut source, 5);
    let agreed = source.agreement();
    for mode in agreed.modes {
        assert_eq!((mode.format, mode.size), (Some("MJPG"), SIZE));
        assert!(
            mode.fps.is_some_and(|fps| (fps - 15.0).abs() < 0.01),
            "{mode:?}"
        );
    }
    let locked = |name: &str| {
        agreed
            .controls
            .iter()
            .find(|c| c.name == name)
            .unwrap()
            .value
    };
    assert_eq!((locked("exposure"), locked("automatic focus")), (300, 0));
    assert_eq!(agreed.unset, [""; 0]);
    assert!((source.pairing_limit_s() * f64::from(FPS) - 0.2).abs() < 0.01);
    let refused = Abilities::of(&nodes(0)[1]).unwrap_err().to_string();
    assert!(refused.contains("data about pictures"), "{refused}");
}

/// The camera saw all of this being set, and stands there.
fn was_told(state: &mut State) {
    for (name, value) in [
        ("exposure mode", 1),
        ("exposure before rate", 0),
        ("automatic white balance", 0),
        ("automatic focus", 0),
        ("exposure", 300),
        ("gain", 77),
        ("white balance", 5200),
        ("focus", 120),
        ("brightness", 7),
        ("contrast", 40),
        ("saturation", 128),
    ] {
        let seen = &state.set;
        assert!(seen.contains(&(name, value)), "{name}: {seen:?}");
        assert_eq!(state.level(name).now, value, "{name}");
    }
}
