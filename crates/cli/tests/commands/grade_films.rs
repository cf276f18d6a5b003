//! `vergence grade` on films and on recordings of `vergence run`, end to end, with the programs `ffmpeg` and `ffprobe` (said to be skipped where they
//! are missing). The films are made here: leaves that hang before leaves, the near ones in motion. Scores are those of a toy model.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::grading::{Place, beside, drawn_leaves, number};
use serde_json::Value;
use vergence_imaging::Rgb;
use vergence_imaging::files::write_rgb;

/// Size of one eye's picture.
const W: usize = 320;
const H: usize = 240;

/// Frames a second of the films.
const FPS: usize = 10;

fn no_ffmpeg() -> bool {
    let missing = ["ffmpeg", "ffprobe"]
        .iter()
        .any(|program| Command::new(program).arg("-version").output().is_err());
    if missing {
        println!("skipped: there is no program ffmpeg");
    }
    missing
}

/// A place to film: near leaves swing before far ones.
struct Scene {
    far: Rgb,
    near: Rgb,
}

impl Scene {
    fn new(seed: u32) -> Self {
        Self {
            far: drawn_leaves(W + 40, H, seed),
            near: drawn_leaves(W / 3, H / 3, seed + 1),
        }
    }

    /// What an eye sees at a frame's time; `sign` is 1 for the left eye and -1 for the right one. The far leaves lie 6 px behind the screen,
    /// the near ones 4 px in front of it.
    fn view(&self, sign: isize, frame: f64) -> Rgb {
        let x0 = 90.0 + 45.0 * (frame / 5.0).sin() + 2.0 * sign as f64;
        let y0 = 70.0 + 40.0 * (frame / 3.0).cos();
        let (x0, y0) = (x0.round() as isize, y0.round() as isize);
        Rgb::from_fn(W, H, |x, y| {
            let (u, v) = (x as isize - x0, y as isize - y0);
            let inside = (0..self.near.width() as isize).contains(&u)
                && (0..self.near.height() as isize).contains(&v);
            match inside {
                true => self.near.at(u as usize, v as usize),
                false => self.far.at((x as isize + 20 + 3 * sign) as usize, y),
            }
        })
    }

    /// So many pairs; the right eye's pictures are taken so many frames later.
    fn pairs(&self, count: usize, later: f64) -> Vec<[Rgb; 2]> {
        let pair = |i: usize| [self.view(1, i as f64), self.view(-1, i as f64 + later)];
        (0..count).map(pair).collect()
    }
}

fn above([a, b]: [&Rgb; 2]) -> Rgb {
    let (w, h) = a.size();
    Rgb::from_fn(
        w,
        2 * h,
        |x, y| if y < h { a.at(x, y) } else { b.at(x, y - h) },
    )
}

/// A film of these pictures in the place.
fn film(place: &Place, name: &str, pictures: &[Rgb], more: &[&str]) -> PathBuf {
    let frames = place.path(&format!("frames of {name}"));
    std::fs::create_dir_all(&frames).unwrap();
    std::fs::create_dir_all(place.path(name).parent().unwrap()).unwrap();
    for (i, picture) in pictures.iter().enumerate() {
        write_rgb(&frames.join(format!("{i:03}.png")), picture).unwrap();
    }
    let out = place.path(name);
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-nostdin", "-framerate"])
        .arg(FPS.to_string())
        .arg("-i")
        .arg(frames.join("%03d.png"))
        .args(["-c:v", "ffv1", "-pix_fmt", "yuv444p"])
        .args(more)
        .arg(&out)
        .status()
        .unwrap();
    assert!(status.success());
    std::fs::remove_dir_all(&frames).unwrap();
    out
}

/// Items and last object of a film that was graded well.
fn graded(place: &Place, args: &[&str]) -> (Vec<Value>, Value) {
    let done = place.grade(&[args, &["--format", "jsonl"]].concat());
    assert_eq!(done.code, 0, "{done:?}");
    let mut lines = done.lines();
    let last = lines.pop().unwrap();
    assert_eq!(last["kind"], "sequence", "{last}");
    (lines, last)
}

/// Side by side with the right eye a frame late, over-under in step, one eye alone: frames with their times, then the sequence with the time between
/// the eyes.
#[test]
fn films_are_graded_frame_by_frame_and_as_a_whole() {
    if no_ffmpeg() {
        return;
    }
    let place = Place::new();
    let scene = Scene::new(3);
    let late: Vec<Rgb> = (scene.pairs(24, 1.0).iter())
        .map(|[l, r]| beside([l, r]))
        .collect();
    let late = film(&place, "late.mkv", &late, &[]);
    let (frames, whole) = graded(&place, &[late.to_str().unwrap(), "--every", "1s"]);
    let times: Vec<f64> = frames.iter().map(|f| number(f, "/time_s")).collect();
    assert_eq!(times, [0.0, 1.0, 2.0]);
    for frame in &frames {
        assert_eq!(frame["kind"], "pair");
        assert_eq!(
            frame["layout"]["name"], "side-by-side",
            "{}",
            frame["layout"]
        );
        assert_eq!(frame["size_px"], serde_json::json!([W, H]));
        let name = frame["item"].as_str().unwrap();
        assert!(
            name.contains("late.mkv at ") && name.ends_with(" s"),
            "{name}"
        );
    }
    assert_eq!((&whole["frames"], &whole["pairs"]), (&3.into(), &24.into()));
    assert_eq!(whole["layout"]["name"], "side-by-side");
    assert!((number(&whole, "/frames_per_second") - FPS as f64).abs() < 1e-6);
    let offset = number(&whole, "/time_offset_frames");
    assert!((offset - 1.0).abs() < 0.25, "{offset}");
    let verdicts = whole["verdicts"].as_array().unwrap();
    let time = verdicts
        .iter()
        .find(|v| v["cause"] == "time_offset")
        .unwrap();
    assert_eq!(time["verdict"], "bad", "{time}");
    assert_eq!(whole["verdict"], "bad");
    let done = place.grade(&[late.to_str().unwrap(), "--fail-on", "bad"]);
    assert_eq!(done.code, 1, "{done:?}");

    let step = scene.pairs(24, 0.0);
    let over: Vec<Rgb> = step.iter().map(|[l, r]| above([l, r])).collect();
    let over = film(&place, "over.mkv", &over, &[]);
    let (frames, whole) = graded(&place, &[over.to_str().unwrap(), "--every", "10s"]);
    assert_eq!(frames.len(), 1);
    assert_eq!(
        frames[0]["layout"]["name"], "over-under",
        "{}",
        frames[0]["layout"]
    );
    let offset = number(&whole, "/time_offset_frames");
    assert!(offset.abs() < 0.25, "{offset}");

    let left: Vec<Rgb> = step.into_iter().map(|[l, _]| l).collect();
    let left = film(&place, "left.mkv", &left, &[]);
    let (frames, whole) = graded(&place, &[left.to_str().unwrap(), "--every", "1s"]);
    assert!(frames.iter().all(|f| f["kind"] == "picture"));
    assert_eq!((frames.len(), &whole["pairs"]), (3, &0.into()));
    assert!(whole["not_judged"]["time_offset_frames"].is_string());
}

/// The container's tag says which eye is first; a film that begins in black is not taken for one eye's.
#[test]
fn the_layout_of_a_film_is_found() {
    if no_ffmpeg() {
        return;
    }
    let place = Place::new();
    let pictures: Vec<Rgb> = (Scene::new(5).pairs(4, 0.0).iter())
        .map(|[l, r]| beside([r, l]))
        .collect();
    let tagged = film(
        &place,
        "tagged.mkv",
        &pictures,
        &["-metadata:s:v:0", "stereo_mode=right_left"],
    );
    let (frames, _) = graded(&place, &[tagged.to_str().unwrap()]);
    assert_eq!(
        frames[0]["layout"]["name"], "cross-eyed",
        "{}",
        frames[0]["layout"]
    );
    let reason = frames[0]["layout"]["reason"].as_str().unwrap();
    assert!(reason.contains("container"), "{reason}");

    let mut dark = vec![Rgb::filled(2 * W, H, [4; 3]); 14];
    dark.extend(vec![pictures[0].clone(); 14]);
    let dark = film(&place, "dark.mkv", &dark, &[]);
    let (frames, whole) = graded(&place, &[dark.to_str().unwrap(), "--every", "2s"]);
    assert_eq!(
        whole["layout"]["name"], "side-by-side",
        "{}",
        whole["layout"]
    );
    assert_eq!(frames.last().unwrap()["kind"], "pair");
}

/// A film that breaks off costs itself alone; what was seen of it does not go into the next one's account.
#[test]
fn a_broken_film_stops_nothing() {
    if no_ffmpeg() {
        return;
    }
    let place = Place::new();
    let pairs = Scene::new(7).pairs(12, 0.0);
    let left: Vec<Rgb> = pairs.into_iter().map(|[l, _]| l).collect();
    let whole = film(&place, "in/b.mkv", &left, &[]);
    let bytes = std::fs::read(&whole).unwrap();
    place.bytes("in/a.mkv", &bytes[..bytes.len() * 2 / 3]);
    place.bytes("in/c.mp4", b"no film");
    let done = place.grade(&["in", "--every", "0.3s", "--format", "jsonl"]);
    assert_eq!(done.code, 1, "{done:?}");
    for name in ["in/a.mkv", "in/c.mp4"] {
        assert!(
            done.err.contains(&format!("failed: {name}: ")),
            "{}",
            done.err
        );
        // Named once.
        let line = done.err.lines().find(|l| l.contains(name)).unwrap();
        assert_eq!(line.matches(name).count(), 1, "{line}");
    }
    let lines = done.lines();
    let sequence = lines.iter().find(|l| l["kind"] == "sequence").unwrap();
    assert_eq!(sequence["item"], "in/b.mkv");
    assert_eq!(sequence["frames"], 4, "{sequence}");
}

/// Gone on with in the middle of a film, the file of results ends as if nothing had happened: the sequence knows its earlier frames.
#[test]
fn a_film_is_gone_on_with() {
    if no_ffmpeg() {
        return;
    }
    let place = Place::new();
    let pictures: Vec<Rgb> = (Scene::new(9).pairs(12, 0.0).iter())
        .map(|[l, r]| beside([l, r]))
        .collect();
    film(&place, "film.mkv", &pictures, &[]);
    let args = [
        "film.mkv", "--every", "0.3s", "--out", "r.jsonl", "--format", "json",
    ];
    assert_eq!(place.grade(&args).code, 0);
    let file = place.path("r.jsonl");
    let expected = std::fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = expected.lines().collect();
    assert_eq!(lines.len(), 5, "four frames and the whole");
    std::fs::write(&file, lines[..2].join("\n") + "\n").unwrap();
    let again = place.grade(&args);
    assert_eq!(again.code, 0, "{again:?}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), expected);
    let summary: Value = serde_json::from_str(&again.out).unwrap();
    let summary = &summary["summary"];
    assert_eq!(
        (&summary["items"], &summary["skipped"]),
        (&4.into(), &2.into())
    );
    assert_eq!(summary["sequences"]["count"], 1);
    // All is done: nothing is decoded or told again.
    let third = place.grade(&args);
    let summary: Value = serde_json::from_str(&third.out).unwrap();
    assert_eq!(summary["items"], serde_json::json!([]));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), expected);
}

/// The page of a film has its time line with the cut, and what is said of the whole.
#[test]
fn the_page_of_a_film_has_a_time_line() {
    if no_ffmpeg() {
        return;
    }
    let place = Place::new();
    let mut pairs = Scene::new(11).pairs(12, 0.0);
    pairs.extend(Scene::new(40).pairs(12, 0.0));
    let pictures: Vec<Rgb> = pairs.iter().map(|[l, r]| beside([l, r])).collect();
    film(&place, "cut.mkv", &pictures, &[]);
    let (_, whole) = graded(&place, &["cut.mkv", "--every", "0.6s", "--report", "page"]);
    let cuts = whole["cuts"].as_array().unwrap();
    assert_eq!(cuts.len(), 1, "{cuts:?}");
    assert_eq!(cuts[0]["pair"], 12);
    assert!((number(&cuts[0], "/time_s") - 1.2).abs() < 1e-6);
    let page = std::fs::read_to_string(place.path("page/index.html")).unwrap();
    for part in [
        ">Sequence<",
        "time / s",
        "dashed: 1 cut",
        "The sequence as a whole",
        "The worst item",
    ] {
        assert!(page.contains(part), "{part} is missing");
    }
}

/// A folder of `vergence run`: its sample is graded as a film of pairs, and said to be a sample.
#[test]
fn a_recording_of_a_run_is_graded() {
    if no_ffmpeg() {
        return;
    }
    let place = Place::new();
    let run = [
        "run",
        "--fast",
        "--headless",
        "--seconds",
        "4",
        "--resolution",
        "512x384",
        "--out",
        "runs",
    ];
    let done = place.run(&run);
    assert_eq!(done.code, 0, "{done:?}");
    let folder = folder_of_run(&place.path("runs"));
    let (frames, whole) = graded(&place, &[folder.to_str().unwrap(), "--every", "2s"]);
    assert!(!frames.is_empty());
    for frame in &frames {
        assert_eq!(frame["kind"], "pair", "{frame}");
        assert_eq!(
            frame["layout"]["name"], "side-by-side",
            "{}",
            frame["layout"]
        );
        let remark = frame["remarks"][0].as_str().unwrap();
        assert!(remark.contains("sample of a run"), "{remark}");
    }
    let files = whole["files"][0].as_str().unwrap();
    assert!(files.ends_with("sample_side_by_side.avi"), "{files}");
    assert!(number(&whole, "/pairs") >= 10.0, "{whole}");
}

fn folder_of_run(runs: &Path) -> PathBuf {
    let mut folders = std::fs::read_dir(runs).unwrap();
    folders.next().unwrap().unwrap().path()
}
