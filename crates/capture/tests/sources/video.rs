//! Proves that videos come out of `ffmpeg` with the bytes and times that went in, and that what it complains of is told. The
//! tests make their videos with `ffmpeg` and say that they were skipped where there is none.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::parallel;
use vergence_calib::RigCalibration;
use vergence_capture::{FilesConfig, FilesSource, OnFault, Source as _, StereoFrame};
use vergence_imaging::{Rgb, files};

fn rig() -> RigCalibration {
    parallel::rig(64, 48)
}

fn no_ffmpeg() -> bool {
    let missing = Command::new("ffmpeg").arg("-version").output().is_err();
    if missing {
        println!("skipped: there is no program ffmpeg");
    }
    missing
}

/// Noise, so that no two frames are alike and a damaged file cannot go unnoticed.
fn picture(eye: u32, index: u32) -> Rgb {
    let mut state = eye * 1000 + index + 1;
    Rgb::from_fn(64, 48, |_, _| {
        std::array::from_fn(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        })
    })
}

/// A lossless video of `count` pictures at a frame rate as `ffmpeg` takes it.
fn video(folder: &Path, eye: u32, count: u32, fps: &str, more: &[&str]) -> PathBuf {
    let frames = folder.join(format!("frames{eye}"));
    std::fs::create_dir_all(&frames).unwrap();
    for i in 0..count {
        files::write_rgb(&frames.join(format!("{i:03}.png")), &picture(eye, i)).unwrap();
    }
    let out = folder.join(format!("eye {eye}: {}.mkv", fps.replace('/', "-")));
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-nostdin", "-framerate", fps, "-i"])
        .arg(frames.join("%03d.png"))
        .args(["-c:v", "png", "-pix_fmt", "rgb24"])
        .args(more)
        .arg(format!("file:{}", out.display()))
        .status()
        .unwrap();
    assert!(status.success());
    out
}

fn config(left: PathBuf, right: PathBuf) -> FilesConfig {
    FilesConfig {
        left,
        right,
        ..FilesConfig::default()
    }
}

fn all(source: &mut FilesSource) -> Vec<StereoFrame> {
    let mut pairs = Vec::new();
    while let Some(pair) = source.next_pair(None).unwrap() {
        pairs.push(pair);
    }
    pairs
}

/// Every byte and every time, at a whole and at a broken frame rate; buffers given back are used and do not show through.
#[test]
fn bytes_and_times_are_kept() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    for (fps, value) in [("25", 25.0), ("30000/1001", 30_000.0 / 1001.0)] {
        let config = config(
            video(root.path(), 1, 9, fps, &[]),
            video(root.path(), 2, 9, fps, &[]),
        );
        let mut source = FilesSource::open(&config, &rig()).unwrap();
        assert_eq!((source.info().fps, source.info().pairs), (value, None));
        let mut old = None;
        for i in 0..9 {
            let pair = source.next_pair(old.take()).unwrap().unwrap();
            assert_eq!(pair.index, u64::from(i));
            assert!((pair.capture_s() - f64::from(i) / value).abs() < 1e-12);
            assert_eq!(pair.left.picture, picture(1, i));
            assert_eq!(pair.right.picture, picture(2, i));
            old = Some(pair);
        }
        assert!(source.next_pair(old).unwrap().is_none());
        assert_eq!(source.dropped_pairs(), 0);
    }
}

/// Two rates pair by time: of 50 frames a second every other one finds its partner among 25. The shorter video ends it.
#[test]
fn different_rates_pair_by_time() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let config = config(
        video(root.path(), 1, 21, "50", &[]),
        video(root.path(), 2, 8, "25", &[]),
    );
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    let pairs = all(&mut source);
    assert_eq!(pairs.len(), 8);
    for (i, pair) in (0..).zip(&pairs) {
        assert_eq!(pair.left.picture, picture(1, 2 * i));
        assert_eq!(pair.right.picture, picture(2, i));
        assert_eq!(pair.left.capture_s, pair.right.capture_s);
    }
    assert_eq!(source.counts().paired, 8);
    assert!(source.dropped_pairs() >= 7);
}

/// A recording that lost frames keeps the times of the others: no frame is paired with another moment's, none is repeated, and only
/// the lost ones are missing, also where the losses make its average rate another one.
#[test]
fn lost_frames_leave_gaps() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let lost = |i: u32| i % 40 == 39 || (100..110).contains(&i);
    let left = video(root.path(), 1, 300, "30", &[]);
    let drop = "select=not(eq(mod(n\\,40)\\,39)+between(n\\,100\\,109))";
    let right = video(root.path(), 2, 300, "30", &["-vf", drop]);
    let mut source = FilesSource::open(&config(left, right), &rig()).unwrap();
    assert_eq!(source.info().fps, 30.0);
    let pairs = all(&mut source);
    let kept: Vec<u32> = (0..300).filter(|i| !lost(*i)).collect();
    assert_eq!(pairs.len(), kept.len());
    for (i, pair) in kept.iter().zip(&pairs) {
        assert!((pair.left.capture_s - f64::from(*i) / 30.0).abs() < 1e-12);
        assert_eq!(pair.left.capture_s, pair.right.capture_s);
        assert_eq!(pair.left.picture, picture(1, *i));
        assert_eq!(pair.right.picture, picture(2, *i));
    }
    assert_eq!(source.dropped_pairs(), 17);
    assert_eq!(source.remarks(), [""; 0]);
}

/// When one input goes on behind the end of the other, that is said once the pairs have ended; a frame or two more is the usual end.
#[test]
fn unequal_lengths_are_told() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let left = video(root.path(), 1, 30, "25", &[]);
    for (eye, count, told) in [(2, 12, true), (3, 28, false)] {
        let right = video(root.path(), eye, count, "25", &[]);
        let mut source = FilesSource::open(&config(left.clone(), right), &rig()).unwrap();
        assert_eq!(all(&mut source).len(), count as usize);
        let said = source.remarks().join("; ");
        assert_eq!(
            said.contains("ended after 12 pairs and"),
            told,
            "{count}: {said}"
        );
    }
}

/// A video beside a folder of pictures, which takes the video's rate when none is given.
#[test]
fn a_video_pairs_with_a_folder() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let left = video(root.path(), 1, 5, "25", &[]);
    video(root.path(), 2, 5, "25", &[]);
    let mut config = config(left, root.path().join("frames2"));
    for fps in [None, Some(25.0)] {
        config.fps = fps;
        let pairs = all(&mut FilesSource::open(&config, &rig()).unwrap());
        assert_eq!(pairs.len(), 5);
        assert_eq!(pairs[3].right.picture, picture(2, 3));
    }
}

/// What can be wrong: a rate that contradicts the video, sizes, a file that is no video, one that breaks off (at once an error, or
/// taken as far as it goes), and no `ffmpeg`.
#[test]
fn faults_are_told() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let left = video(root.path(), 1, 20, "25", &[]);
    let right = video(root.path(), 2, 20, "25", &[]);
    let good = config(left, right.clone());
    let complaint = |config: &FilesConfig| {
        let mut source = match FilesSource::open(config, &rig()) {
            Ok(source) => source,
            Err(e) => return (0, e.to_string()),
        };
        let mut pairs = 0;
        loop {
            match source.next_pair(None) {
                Ok(Some(_)) => pairs += 1,
                Ok(None) => return (pairs, "no complaint".to_owned()),
                Err(e) => return (pairs, e.to_string()),
            }
        }
    };
    assert_eq!(complaint(&good), (20, "no complaint".to_owned()));

    let (_, text) = complaint(&FilesConfig {
        fps: Some(30.0),
        ..good.clone()
    });
    assert!(
        text.contains("the video has 25 frames per second, but fps is set to 30"),
        "{text}"
    );

    let small = video(root.path(), 3, 3, "25", &["-vf", "scale=32:24"]);
    let (_, text) = complaint(&FilesConfig {
        right: small.clone(),
        ..good.clone()
    });
    assert!(text.contains("32x24 pixels, but 64x48 in"), "{text}");
    assert!(text.ends_with(&small.display().to_string()), "{text}");

    let fake = root.path().join("fake.mkv");
    std::fs::write(&fake, "this is no video").unwrap();
    let (_, text) = complaint(&FilesConfig {
        left: fake,
        ..good.clone()
    });
    assert!(
        text.starts_with("ffprobe cannot read it: ") && text.ends_with("fake.mkv"),
        "{text}"
    );

    let cut = root.path().join("cut.mkv");
    let bytes = std::fs::read(&right).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let mut config = FilesConfig {
        right: cut,
        ..good.clone()
    };
    let (pairs, text) = complaint(&config);
    assert!((5..20).contains(&pairs), "{pairs}");
    assert!(
        text.starts_with("ffmpeg gave ") && text.contains("frames and complained: "),
        "{text}"
    );
    config.unreadable = OnFault::Skip;
    assert_eq!(complaint(&config).1, "no complaint");

    let (_, text) = complaint(&FilesConfig {
        ffmpeg: "/nowhere/ffmpeg".into(),
        ..good
    });
    assert!(
        text.starts_with("ffprobe could not be started (")
            && text.contains("videos need the programs ffmpeg"),
        "{text}"
    );
}

/// A video that the recorder turned comes as it is to be looked at, with its sides exchanged.
#[test]
fn turned_videos_are_not_misread() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let mut turned = Vec::new();
    for eye in [1, 2] {
        let flat = video(root.path(), eye, 3, "25", &[]);
        let out = root.path().join(format!("turned{eye}.mp4"));
        let status = Command::new("ffmpeg")
            .args(["-v", "error", "-y", "-nostdin", "-i"])
            .arg(format!("file:{}", flat.display()))
            .args(["-c", "copy", "-metadata:s:v", "rotate=90"])
            .arg(&out)
            .status()
            .unwrap();
        if !status.success() {
            println!("skipped: this ffmpeg does not write turned videos");
            return;
        }
        turned.push(out);
    }
    let config = config(turned[0].clone(), turned[1].clone());
    match FilesSource::open(&config, &rig()) {
        // A version that ignores the mark gives the pictures as they were.
        Ok(mut source) => assert_eq!(all(&mut source)[0].left.picture, picture(1, 0)),
        Err(e) => assert!(
            e.to_string()
                .starts_with("calibration is for 64x48, pictures are 48x64"),
            "{e}"
        ),
    }
}

/// Leaving in the middle ends the programs: none of this process's children is left.
#[test]
fn dropping_ends_the_programs() {
    if no_ffmpeg() {
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let config = config(
        video(root.path(), 1, 60, "25", &[]),
        video(root.path(), 2, 60, "25", &[]),
    );
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    source.next_pair(None).unwrap();
    drop(source);
    let marker = root.path().display().to_string();
    let Ok(processes) = std::fs::read_dir("/proc") else {
        println!("skipped: this system has no /proc");
        return;
    };
    for process in processes.flatten() {
        let command = std::fs::read(process.path().join("cmdline")).unwrap_or_default();
        let command = String::from_utf8_lossy(&command).into_owned();
        assert!(!command.contains(&marker), "still running: {command}");
    }
}
