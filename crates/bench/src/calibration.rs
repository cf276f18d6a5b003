//! `cargo xtask bench-vs calibration`: stereo calibration from recorded pairs beside OpenCV's, judged by pairs that were held out.
//!
//! Every fourth pair is left out, four times; each side calibrates from the others, and the corners of the pairs left out are rectified. What
//! counts is how far they lie off their rows. Every calibration is judged on both sides' corners, and each side also calibrates from the
//! other's, so that finding corners and solving can be told apart. The same code judges all: rows on the plane z = 1 times the focal length of
//! the left camera.
//!
//! Where a set states when its pictures were taken, a third column takes the board's own motion out of the rows: each corner of the right picture is
//! carried back along its way between the pictures before and after, by a delay that is chosen for every calibration as suits it best. A board that
//! moves between two exposures has corners off their rows under a perfect calibration, and on their rows under one that is bent to suit.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use nalgebra::{
    Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};
use serde_json::{Value, json};
use vergence_calib::solve::{LensModel, MotorState, Settings, Shot, Sighting, calibrate_fixed};
use vergence_calib::{CameraPose, RigCalibration, Target, detect};
use vergence_geometry::{BrownConrady, Camera, Distortion, Eye, Intrinsics};
use vergence_imaging::files::read_gray;

/// Every fourth pair is held out.
const FOLDS: usize = 4;
/// The best time of so many rounds counts.
const ROUNDS: usize = 5;
/// What is stated of a corner whose detector states nothing, px.
const UNSTATED_PX: f64 = 0.1;

/// Corners of one picture: number, pixel, standard deviation.
type Corners = Vec<(usize, Point2<f64>, f64)>;
/// Corners of all pairs, left and right.
type Pairs = Vec<[Corners; 2]>;

struct Set {
    name: &'static str,
    target: &'static str,
}

const SETS: [Set; 2] = [
    Set {
        name: "opencv_chessboard",
        target: "chessboard:9x6:25mm",
    },
    Set {
        name: "charuco_pair_cam0_cam3",
        target: "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
    },
];

/// A calibration's models of every fold.
struct Rival {
    name: String,
    folds: Vec<RigCalibration>,
    seconds: f64,
    baseline_m: f64,
}

/// Runs both sides and prints the table; an error when the pictures, python3 or OpenCV are missing.
pub(crate) fn run() -> anyhow::Result<()> {
    println!(
        "stereo calibration, every {FOLDS}th pair held out in turn: rows of held-out corners, RMS px (largest), -n: corners without a viewing ray; times of all pairs, one thread, best of {ROUNDS}"
    );
    for set in &SETS {
        table(set)?;
    }
    Ok(())
}

fn table(set: &Set) -> anyhow::Result<()> {
    let folder = crate::targets::data()?.join(set.name);
    let target = Target::parse(set.target)?;
    let files = pairs_of(&folder)?;
    let begin = Instant::now();
    let mut size = (0, 0);
    let mut ours = Pairs::new();
    let mut reading_s = 0.0;
    for pair in &files {
        let mut eyes: [Corners; 2] = [Vec::new(), Vec::new()];
        for (eye, file) in eyes.iter_mut().zip(pair) {
            let reading = Instant::now();
            let picture = read_gray(file)?;
            reading_s += reading.elapsed().as_secs_f64();
            size = picture.size();
            *eye = detect(&picture, &target).map_or_else(
                |_| Vec::new(),
                |d| {
                    d.corners
                        .iter()
                        .map(|c| (c.id, c.pixel, c.sigma_px))
                        .collect()
                },
            );
        }
        ours.push(eyes);
    }
    let detect_s = begin.elapsed().as_secs_f64() - reading_s;
    let report = peer(&folder, &files, &target, &ours)?;
    let theirs = pairs_from_report(&report["corners"])?;
    let mut rivals = vec![
        own("Vergence, its corners", &ours, None, &target, size)?,
        own("Vergence, OpenCV's corners", &theirs, None, &target, size)?,
    ];
    let times = times_of(&folder, files.len())?;
    if let Some(times) = &times {
        let told = Some(times.as_slice());
        rivals.push(own(
            "Vergence, its corners, times",
            &ours,
            told,
            &target,
            size,
        )?);
        let name = "Vergence, OpenCV's corners, times";
        rivals.push(own(name, &theirs, told, &target, size)?);
    }
    for model in report["models"].as_array().into_iter().flatten() {
        rivals.push(rival(model, size)?);
    }
    println!(
        "{}: {} pairs, OpenCV {}; finding corners takes {:.0} ms (OpenCV {:.0} ms)",
        set.name,
        files.len(),
        report["opencv"].as_str().unwrap_or("?"),
        1e3 * detect_s,
        1e3 * report["detect_s"].as_f64().unwrap_or(f64::NAN)
    );
    print_rows(&rivals, [&ours, &theirs], times.as_deref());
    Ok(())
}

/// Each calibration's rows on both sides' corners, as they are and, where times are stated, with the board's motion taken out.
fn print_rows(rivals: &[Rival], [ours, theirs]: [&Pairs; 2], times: Option<&[[f64; 2]]>) {
    println!(
        "  calibration                                on our corners    on OpenCV's     baseline, mm    ms{}",
        if times.is_some() {
            "    motion taken out of ours / OpenCV's (delay, ms)"
        } else {
            ""
        }
    );
    for rival in rivals {
        let on = |pairs: &Pairs| {
            let rows = held_out_rows(&rival.folds, pairs);
            let lost = match rows.lost {
                0 => String::new(),
                lost => format!(" -{lost}"),
            };
            format!("{:.3} ({:.2}){lost}", rows.rms_px, rows.largest_px)
        };
        println!(
            "  {:<42} {:<17} {:<15} {:>8.2}  {:>8.1}{}",
            rival.name,
            on(ours),
            on(theirs),
            1e3 * rival.baseline_m,
            1e3 * rival.seconds,
            times.map_or_else(String::new, |times| {
                let still = |pairs: &Pairs| {
                    let (rows, delay_s) = still_rows(&rival.folds, pairs, times);
                    format!("{:.3} ({:+.0})", rows.rms_px, 1e3 * delay_s)
                };
                format!("    {} / {}", still(ours), still(theirs))
            })
        );
    }
}

/// When the left and the right picture of every pair were taken, s, where the set says so.
fn times_of(folder: &Path, pairs: usize) -> anyhow::Result<Option<Vec<[f64; 2]>>> {
    let path = folder.join("frames.csv");
    let Ok(text) = std::fs::read_to_string(&path) else {
        return Ok(None);
    };
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| {
        let at = head.iter().position(|c| *c == name);
        at.with_context(|| format!("{}: there is no column {name}", path.display()))
    };
    let columns = [column("time_left_s")?, column("time_right_s")?];
    let times: Vec<[f64; 2]> = lines
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            columns.map(|c| {
                cells
                    .get(c)
                    .and_then(|t| t.parse().ok())
                    .unwrap_or(f64::NAN)
            })
        })
        .collect();
    ensure!(
        times.len() == pairs && times.iter().flatten().all(|t| t.is_finite()),
        "{}: a row with two times is needed for each of {pairs} pairs",
        path.display()
    );
    Ok(Some(times))
}

/// Pictures of the left and the right camera that belong together.
fn pairs_of(folder: &Path) -> anyhow::Result<Vec<[PathBuf; 2]>> {
    let mut lefts: Vec<PathBuf> = std::fs::read_dir(folder)?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|p| {
            let name = p.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with("left") && name.ends_with(".jpg")
        })
        .collect();
    lefts.sort();
    let pair = |left: PathBuf| {
        let name = left.file_name().unwrap_or_default().to_string_lossy();
        let right = folder.join(name.replacen("left", "right", 1));
        ensure!(right.is_file(), "there is no partner: {}", right.display());
        Ok([left, right])
    };
    lefts.into_iter().map(pair).collect()
}

fn peer(
    folder: &Path,
    files: &[[PathBuf; 2]],
    target: &Target,
    ours: &Pairs,
) -> anyhow::Result<Value> {
    let name = |p: &PathBuf| {
        p.file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let names: Vec<[String; 2]> = files.iter().map(|p| [name(&p[0]), name(&p[1])]).collect();
    let corners: Vec<[Vec<(usize, f64, f64)>; 2]> = ours
        .iter()
        .map(|pair| {
            [0, 1].map(|eye: usize| pair[eye].iter().map(|c| (c.0, c.1.x, c.1.y)).collect())
        })
        .collect();
    let points: Vec<[f64; 2]> = (0..target.point_count())
        .map(|id| target.point_in_board(id))
        .map(|p| [p.x, p.y])
        .collect();
    let described = match target {
        Target::Chessboard(board) => json!({
            "kind": "chessboard", "columns": board.columns, "rows": board.rows
        }),
        Target::Charuco(board) => json!({
            "kind": "charuco", "columns": board.columns, "rows": board.rows, "square": board.square_m,
            "marker": board.marker_m, "dictionary": board.dictionary.name(), "inverted": board.inverted
        }),
        Target::AprilGrid(_) => bail!("OpenCV knows no april grids"),
    };
    let job = json!({
        "folder": folder, "pairs": names, "target": described, "folds": FOLDS, "rounds": ROUNDS, "ours": corners, "points": points
    });
    let path =
        std::env::temp_dir().join(format!("vergence-calibration-{}.json", std::process::id()));
    std::fs::write(&path, job.to_string())
        .with_context(|| format!("the job could not be written to {}", path.display()))?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/calibration_cv2.py");
    let output = Command::new("python3").arg(&script).arg(&path).output();
    // A file left behind would only be litter.
    let _ = std::fs::remove_file(&path);
    let output = output
        .context("python3 could not be started; bench-vs calibration needs python3 with opencv-contrib-python")?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    serde_json::from_slice(&output.stdout)
        .context("the peer's report is not the JSON that it should be")
}

fn pairs_from_report(value: &Value) -> anyhow::Result<Pairs> {
    let read: Vec<[Vec<(usize, f64, f64)>; 2]> =
        serde_json::from_value(value.clone()).context("the peer's corners cannot be read")?;
    let corner = |c: &(usize, f64, f64)| (c.0, Point2::new(c.1, c.2), UNSTATED_PX);
    Ok(read
        .iter()
        .map(|pair| [0, 1].map(|eye: usize| pair[eye].iter().map(corner).collect()))
        .collect())
}

/// Our calibration of these corners: of all pairs, timed, and of each fold.
fn own(
    name: &str,
    pairs: &Pairs,
    times: Option<&[[f64; 2]]>,
    target: &Target,
    size: (usize, usize),
) -> anyhow::Result<Rival> {
    let settings = Settings::new(LensModel::BrownConrady5, &[size; 2]);
    let solved = |leave: Option<usize>| -> anyhow::Result<RigCalibration> {
        let calibration = calibrate_fixed(&shots(pairs, times, target, leave), &settings)?;
        let pose = |camera: usize| {
            let home = MotorState::default();
            calibration.mechanism.rig_from_cam(camera, &home)
        };
        rig_of(
            [calibration.cameras[0], calibration.cameras[1]],
            [pose(0), pose(1)],
        )
    };
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut seconds = f64::INFINITY;
    let mut whole = None;
    for _ in 0..ROUNDS {
        let begin = Instant::now();
        whole = Some(one.install(|| solved(None))?);
        seconds = seconds.min(begin.elapsed().as_secs_f64());
    }
    let whole = whole.context("no round was run")?;
    let folds: anyhow::Result<Vec<RigCalibration>> = (0..FOLDS).map(|k| solved(Some(k))).collect();
    Ok(Rival {
        name: name.to_owned(),
        folds: folds?,
        seconds,
        baseline_m: whole.interaxial_m(),
    })
}

fn shots(
    pairs: &Pairs,
    times: Option<&[[f64; 2]]>,
    target: &Target,
    leave: Option<usize>,
) -> Vec<Shot> {
    let kept = pairs
        .iter()
        .enumerate()
        .filter(|(i, _)| leave != Some(i % FOLDS));
    let mut shots = Vec::new();
    for (placement, (number, pair)) in kept.enumerate() {
        for (camera, corners) in pair.iter().enumerate().filter(|(_, c)| !c.is_empty()) {
            let sighting = |(id, pixel, sigma_px): &(usize, Point2<f64>, f64)| Sighting {
                point_in_board: target.point_in_board(*id),
                pixel: *pixel,
                sigma_px: sigma_px.max(0.02),
            };
            shots.push(Shot {
                camera,
                placement,
                motors: MotorState::default(),
                sightings: corners.iter().map(sighting).collect(),
                time_s: times.map(|times| times[number][camera]),
            });
        }
    }
    shots
}

/// OpenCV's calibration as its report has it.
fn rival(model: &Value, size: (usize, usize)) -> anyhow::Result<Rival> {
    let origin = match model["corners"].as_str() {
        Some("ours") => "our corners",
        _ => "its corners",
    };
    let way = match model["fixed"].as_bool() {
        Some(true) => "lenses fixed",
        _ => "all refined",
    };
    let folds: anyhow::Result<Vec<RigCalibration>> = model["folds"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|fold| rig(fold, size))
        .collect();
    Ok(Rival {
        name: format!("OpenCV, {origin}, {way}"),
        folds: folds?,
        seconds: model["seconds"].as_f64().unwrap_or(f64::NAN),
        baseline_m: rig(&model["whole"], size)?.interaxial_m(),
    })
}

fn rig(model: &Value, (width, height): (usize, usize)) -> anyhow::Result<RigCalibration> {
    let numbers = |value: &Value| -> Vec<f64> {
        value
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_f64)
            .collect()
    };
    let lens = |i: usize| -> anyhow::Result<Camera> {
        let (k, d) = (numbers(&model["k"][i]), numbers(&model["d"][i]));
        ensure!(k.len() == 9 && d.len() >= 5, "the peer's lens is not whole");
        Ok(Camera {
            intrinsics: Intrinsics {
                fx: k[0],
                fy: k[4],
                cx: k[2],
                cy: k[5],
                width,
                height,
            },
            distortion: Distortion::from(BrownConrady {
                k1: d[0],
                k2: d[1],
                p1: d[2],
                p2: d[3],
                k3: d[4],
                ..BrownConrady::default()
            }),
        })
    };
    let (r, t) = (numbers(&model["r"]), numbers(&model["t"]));
    ensure!(r.len() == 9 && t.len() == 3, "the peer's pose is not whole");
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&r));
    let right_from_left = Isometry3::from_parts(
        Translation3::from(Vector3::new(t[0], t[1], t[2])),
        UnitQuaternion::from_rotation_matrix(&turn),
    );
    rig_of(
        [lens(0)?, lens(1)?],
        [Isometry3::identity(), right_from_left.inverse()],
    )
}

/// A rig to be judged whatever its lenses are: one that folds within the picture would be refused, and the frame needs poses only.
fn rig_of(cameras: [Camera; 2], poses: [Isometry3<f64>; 2]) -> anyhow::Result<RigCalibration> {
    let pose = |i: usize| CameraPose {
        name: i.to_string(),
        camera: Camera {
            distortion: Distortion::NONE,
            ..cameras[i]
        },
        rig_from_cam: poses[i],
    };
    let mut rig = RigCalibration::from_poses(pose(0), pose(1))?;
    rig.cameras = cameras;
    Ok(rig)
}

/// Corners of pairs that their fold did not see.
struct Rows {
    rms_px: f64,
    largest_px: f64,
    /// Corners without a viewing ray under the calibration.
    lost: usize,
}

/// How far corners lie off their rows, px: every pair by the fold that did not see it.
fn held_out_rows(folds: &[RigCalibration], pairs: &Pairs) -> Rows {
    let (mut sum, mut count, mut largest, mut lost) = (0.0, 0.0, 0.0_f64, 0);
    for (i, [left, right]) in pairs.iter().enumerate() {
        let rig = &folds[i % FOLDS];
        for (id, pixel, _) in left {
            let Some(partner) = right.iter().find(|c| c.0 == *id) else {
                continue;
            };
            let seen = rig
                .rectified_from_pixel(Eye::Left, pixel)
                .zip(rig.rectified_from_pixel(Eye::Right, &partner.1));
            if let Some((l, r)) = seen {
                let error_px = (l.y - r.y) * rig.cameras[0].intrinsics.fy;
                sum += error_px * error_px;
                count += 1.0;
                largest = largest.max(error_px.abs());
            } else {
                lost += 1;
            }
        }
    }
    Rows {
        rms_px: (sum / f64::max(count, 1.0)).sqrt(),
        largest_px: largest,
        lost,
    }
}

/// The same with the board's motion taken out, by the delay of the right camera that suits the calibration best, within 60 ms.
fn still_rows(folds: &[RigCalibration], pairs: &Pairs, times: &[[f64; 2]]) -> (Rows, f64) {
    let ways = pixel_ways(pairs, times);
    let at = |delay_s: f64| {
        let mut still = pairs.clone();
        for ((pair, time), ways) in still.iter_mut().zip(times).zip(&ways) {
            let later_s = time[1] - time[0] + delay_s;
            for (corner, way) in pair[1].iter_mut().zip(ways) {
                corner.1 -= way * later_s;
            }
        }
        held_out_rows(folds, &still)
    };
    (-60..=60)
        .map(|ms| f64::from(ms) / 1e3)
        .map(|delay_s| (at(delay_s), delay_s))
        .min_by(|a, b| a.0.rms_px.total_cmp(&b.0.rms_px))
        .unwrap_or_else(|| (at(0.0), 0.0))
}

/// How fast every corner of the right pictures moves, px/s, by where it was in the pictures before and after (a parabola through three); the mean
/// of its picture's where it was not seen there.
fn pixel_ways(pairs: &Pairs, times: &[[f64; 2]]) -> Vec<Vec<Vector2<f64>>> {
    let seen = |pair: usize, id: usize| -> Option<(f64, Vector2<f64>)> {
        let corner = pairs.get(pair)?[1].iter().find(|c| c.0 == id)?;
        Some((times[pair][1], corner.1.coords))
    };
    let rate = |a: (f64, Vector2<f64>), b: (f64, Vector2<f64>)| (b.1 - a.1) / (b.0 - a.0);
    let way = |pair: usize, id: usize| -> Option<Vector2<f64>> {
        let here = seen(pair, id)?;
        // The nearest two others: before and after, or two on one side at the ends.
        let (one, two) = match pair {
            0 => (1, 2),
            last if last + 1 == pairs.len() => (last.checked_sub(1)?, last.checked_sub(2)?),
            middle => (middle - 1, middle + 1),
        };
        let (one, two) = (seen(one, id)?, seen(two, id)?);
        let (near, far) = (rate(here, one), rate(here, two));
        let (h, k) = (one.0 - here.0, two.0 - here.0);
        Some((near * k - far * h) / (k - h))
    };
    (0..pairs.len())
        .map(|pair| {
            let ways: Vec<Option<Vector2<f64>>> =
                pairs[pair][1].iter().map(|c| way(pair, c.0)).collect();
            let told: Vec<&Vector2<f64>> = ways.iter().flatten().collect();
            let mean = told.iter().copied().sum::<Vector2<f64>>() / told.len().max(1) as f64;
            ways.iter().map(|w| w.unwrap_or(mean)).collect()
        })
        .collect()
}
