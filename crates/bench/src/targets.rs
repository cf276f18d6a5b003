//! `cargo xtask bench-vs targets`: calibration targets in real pictures beside OpenCV, in one run on one thread.
//!
//! Both sides read the same files, each picture is detected several times, the fastest counts, and the median over the pictures is
//! printed, with the pictures found and the mean distance between the corners that both sides found.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use serde_json::Value;
use vergence_calib::{Target, detect};
use vergence_imaging::files::read_gray;

/// Each picture is detected this often.
const REPEATS: usize = 3;

const SETS: [(&str, &str); 4] = [
    ("opencv_chessboard", "chessboard:9x6:25mm"),
    (
        "charuco_pair_cam0_cam3",
        "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
    ),
    (
        "charuco_single",
        "charuco:5x7:40mm:20mm:DICT_6X6_250:legacy",
    ),
    ("aprilgrid_euroc", "aprilgrid:6x6:88mm:0.3"),
];

type Corners = BTreeMap<String, Vec<(usize, [f64; 2])>>;

/// Runs both sides and prints the table.
pub(crate) fn run() -> anyhow::Result<()> {
    let folder = data()?;
    let peer = peer(&folder)?;
    println!(
        "calibration targets, one thread, fastest of {REPEATS}, median over the pictures; OpenCV {}",
        peer["opencv"].as_str().unwrap_or("?")
    );
    println!(
        "set                      found  ms      OpenCV's         found  ms      ratio  corners apart, px (mean, largest)  from its first way"
    );
    for (name, target) in SETS {
        let (corners, ms) = ours(&folder.join(name), &Target::parse(target)?)?;
        let found = corners.values().filter(|c| !c.is_empty()).count();
        let all = corners.len();
        let theirs = peer["sets"].as_array().into_iter().flatten();
        let mut printed = false;
        // OpenCV's first way of a set is what its other ways are compared with: how far its own answers lie apart.
        let mut first: Option<Corners> = None;
        for set in theirs.filter(|set| set["set"] == name) {
            printed = true;
            let other = corners_of(&set["corners"]);
            let their_ms = set["ms"].as_f64().unwrap_or(f64::NAN);
            let their_found = other.values().filter(|c| !c.is_empty()).count();
            let (mean, largest) = apart(&corners, &other, name == "opencv_chessboard");
            let own = first.as_ref().map(|first| apart(first, &other, true));
            let own = own.map_or_else(String::new, |(mean, largest)| {
                format!("{mean:.3}, {largest:.3}")
            });
            println!(
                "{name:<23} {found:>3}/{all:<3} {ms:>6.2}  {:<15} {their_found:>3}/{all:<3} {their_ms:>6.2}  {:>5.1}  {:<33}  {own}",
                set["way"].as_str().unwrap_or("?"),
                their_ms / ms,
                format!("{mean:.3}, {largest:.3}"),
            );
            first.get_or_insert(other);
        }
        if !printed {
            println!("{name:<23} {found:>3}/{all:<3} {ms:>6.2}  (none finds them)");
        }
    }
    Ok(())
}

/// The folder of calibration pictures.
pub(crate) fn data() -> anyhow::Result<PathBuf> {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let folder = data.join("stereo/calib");
    ensure!(
        folder.is_dir(),
        "no pictures to measure with: set VERGENCE_TEST_DATA: {}",
        folder.display()
    );
    Ok(folder)
}

fn ours(folder: &Path, target: &Target) -> anyhow::Result<(Corners, f64)> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "jpg" || e == "png"))
        .collect();
    files.sort();
    let mut corners = Corners::new();
    let mut times = Vec::new();
    for file in files {
        let picture = read_gray(&file)?;
        let mut best = f64::INFINITY;
        let mut found = Vec::new();
        for _ in 0..REPEATS {
            let begin = Instant::now();
            let detection = detect(&picture, target);
            best = best.min(begin.elapsed().as_secs_f64());
            found = detection.map_or_else(
                |_| Vec::new(),
                |d| {
                    d.corners
                        .iter()
                        .map(|c| (c.id, [c.pixel.x, c.pixel.y]))
                        .collect()
                },
            );
        }
        times.push(1e3 * best);
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        corners.insert(name.into_owned(), found);
    }
    times.sort_by(f64::total_cmp);
    ensure!(!times.is_empty(), "no pictures in {}", folder.display());
    Ok((corners, times[times.len() / 2]))
}

fn peer(folder: &Path) -> anyhow::Result<Value> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/targets_cv2.py");
    let output = Command::new("python3")
        .arg(&script)
        .arg(folder)
        .arg(REPEATS.to_string())
        .output()
        .context("python3 could not be started; bench-vs targets needs python3 with opencv-contrib-python")?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    serde_json::from_slice(&output.stdout)
        .context("the peer's report is not the JSON that it should be")
}

fn corners_of(value: &Value) -> Corners {
    let corner = |c: &Value| {
        let number = |i: usize| c[i].as_f64().unwrap_or(f64::NAN);
        (number(0) as usize, [number(1), number(2)])
    };
    value
        .as_object()
        .into_iter()
        .flatten()
        .map(|(name, all)| {
            (
                name.clone(),
                all.as_array().into_iter().flatten().map(corner).collect(),
            )
        })
        .collect()
}

/// Mean and largest distance of corners that both found; by number, or (plain boards may be numbered from another end) the nearest.
fn apart(ours: &Corners, theirs: &Corners, by_place: bool) -> (f64, f64) {
    let distance = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut all = Vec::new();
    for (name, ours) in ours {
        for (id, at) in theirs.get(name).into_iter().flatten() {
            let same = ours
                .iter()
                .filter(|(i, _)| by_place || i == id)
                .map(|(_, a)| distance(a, at))
                .min_by(f64::total_cmp);
            all.extend(same);
        }
    }
    let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
    (mean, all.iter().copied().fold(0.0, f64::max))
}
