//! `cargo xtask bench-vs remap`: remapping and rectification maps beside OpenCV's, on one thread each, in one run.
//!
//! Both sides get the same picture and the same places; OpenCV its fast fixed-point maps (CV_16SC2). Pictures and maps of both sides are
//! compared before any time is printed: with the plain double-precision reference in grey levels, and with exact places in pixels.
//! Times are the best of rounds in which both sides are measured in turn.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use nalgebra::{Matrix3, Point2, Point3};
use serde_json::json;
use vergence_geometry::{BrownConrady, Camera, Distortion, Eye, HeadGeometry, Intrinsics};
use vergence_imaging::Plane;
use vergence_imaging::remap::{Kernel, Map, Outside, Pixel, plain, remap};
use vergence_stereo::rectify::{Choices, Convergence, Field, MapWork, Rectification, Rectifier};

const SIZE: (usize, usize) = (1024, 768);
const KERNELS: [(Kernel, &str); 3] = [
    (Kernel::Bilinear, "bilinear"),
    (Kernel::Bicubic, "bicubic"),
    (Kernel::Lanczos3, "lanczos"),
];
/// For each kernel, type and round.
const MEASURE: Duration = Duration::from_millis(250);
const ROUNDS: usize = 3;
/// Both maps of a new pose, seconds.
const MAPS_GOAL_S: f64 = 0.004;

/// Runs both sides and prints the tables; an error when they differ, or when python3 or OpenCV is missing.
pub(crate) fn run() -> anyhow::Result<()> {
    let folder = Folder::new()?;
    let (rectifier, poses) = moving_rig()?;
    let made = rectifier.at(&poses[0])?;
    // The left camera's map of a verged pose is the one that pictures are remapped by.
    let exact = |x: usize, y: usize| {
        let at = made.source_from_rectified(Eye::Left, &Point2::new(x as f64, y as f64))?;
        Some([at.x, at.y])
    };
    let source = picture();
    folder.write_job(&source, &exact, &made)?;
    let map = made.exact_map(Eye::Left);
    let mut ours = measure(&source, &map);
    let mut peer = folder.peer()?;
    for _ in 1..ROUNDS {
        keep_best(&mut ours, measure(&source, &map));
        keep_best(&mut peer.times, folder.peer()?.times);
    }
    let mut maps_s = measure_maps(&rectifier, &poses)?;
    maps_s = maps_s.min(measure_maps(&rectifier, &poses)?);
    println!(
        "remap of {} x {}, one thread, milliseconds; OpenCV {} with CV_16SC2 maps (Lanczos: its 8 x 8 beside our 6 x 6)",
        SIZE.0, SIZE.1, peer.version
    );
    println!("  {:<20} vergence  OpenCV  ratio", "");
    for (name, seconds) in &ours {
        let of_peer = *peer
            .times
            .get(name)
            .with_context(|| format!("no time of {name}"))?;
        println!(
            "  {name:<20} {:>8.2}  {:>6.2}  {:>5.2}",
            1e3 * seconds,
            1e3 * of_peer,
            of_peer / seconds
        );
    }
    quality(&folder, &source, &map, &exact)?;
    maps(&folder, &rectifier, &poses, maps_s, &peer)?;
    let bilinear = "u8 x 3 bilinear";
    let verdict = |reached: bool| if reached { "reached" } else { "missed" };
    println!(
        "at least as fast as OpenCV ({bilinear}) {}, both maps of a new vergence within 4 ms {}",
        verdict(ours[bilinear] <= peer.times[bilinear]),
        verdict(maps_s <= MAPS_GOAL_S),
    );
    Ok(())
}

/// The default rig with its lens (five coefficients), and where its cameras stand for targets from 1 to 10 m.
fn moving_rig() -> anyhow::Result<(Rectifier, Vec<[nalgebra::Isometry3<f64>; 2]>)> {
    let camera = Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, SIZE.0, SIZE.1),
        distortion: Distortion::from(BrownConrady {
            k1: -0.12,
            k2: 0.05,
            p1: 3e-4,
            p2: -2e-4,
            k3: -0.01,
            ..BrownConrady::NONE
        }),
    };
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };
    let choices = Choices {
        field: Field::KeepFocal,
        convergence: Convergence::Axes,
        ..Choices::default()
    };
    let poses = (0..10).map(|i| {
        let z = 1.0 + f64::from(i);
        let target = Point3::new(0.1 * z, -0.05 * z, z);
        let angles = head.angles_converged_on(&target).context("a near target")?;
        Ok(Eye::BOTH.map(|eye| head.base_from_cam(eye, &angles)))
    });
    let poses: anyhow::Result<Vec<_>> = poses.collect();
    Ok((Rectifier::new(&[camera; 2], &choices)?, poses?))
}

/// A smooth scene with edges and grain.
fn picture() -> Plane<[u8; 3]> {
    let mut state = 1_u32;
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (a, b) = (x as f64, y as f64);
        let waves = 50.0 * (a / 37.0).sin() * (b / 23.0).cos() + 30.0 * (a * b / 9000.0).sin();
        let edges = if (x / 23 + y / 31) % 2 == 0 {
            25.0
        } else {
            -25.0
        };
        [0.0, 11.0, -7.0].map(|tint| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (128.0 + tint + waves + edges + f64::from(state >> 27) - 16.0) as u8
        })
    })
}

type Times = BTreeMap<String, f64>;

fn keep_best(best: &mut Times, other: Times) {
    for (name, seconds) in other {
        let kept = best.entry(name).or_insert(f64::INFINITY);
        *kept = kept.min(seconds);
    }
}

fn measure(source: &Plane<[u8; 3]>, map: &Map) -> Times {
    let mut times = Times::new();
    let green = source.map(|px| px[1]);
    let f = f32::from;
    let wide = |v: u8| u16::from(v) * 257;
    measure_type("u8 x 3", source, map, &mut times);
    measure_type("u8 x 1", &green, map, &mut times);
    measure_type("u16 x 3", &source.map(|px| px.map(wide)), map, &mut times);
    measure_type("u16 x 1", &green.map(wide), map, &mut times);
    measure_type("f32 x 3", &source.map(|px| px.map(f)), map, &mut times);
    measure_type("f32 x 1", &green.map(f), map, &mut times);
    times
}

fn measure_type<P: Pixel>(name: &str, source: &Plane<P>, map: &Map, times: &mut Times) {
    let fill = source.at(0, 0);
    let mut out = source.clone();
    for (kernel, word) in KERNELS {
        let seconds = fastest(|| {
            remap(
                black_box(source),
                map,
                kernel,
                Outside::Fill(fill),
                &mut out,
            );
            black_box(&mut out);
        });
        times.insert(format!("{name} {word}"), seconds);
    }
}

/// Seconds of the fastest repetition.
fn fastest(mut work: impl FnMut()) -> f64 {
    let (begin, mut best) = (Instant::now(), f64::INFINITY);
    while begin.elapsed() < MEASURE {
        let start = Instant::now();
        work();
        best = best.min(start.elapsed().as_secs_f64());
    }
    best
}

/// Seconds for a new pose and both its maps, from one pose to the next: the mean over a sweep, the fastest sweep.
fn measure_maps(
    rectifier: &Rectifier,
    poses: &[[nalgebra::Isometry3<f64>; 2]],
) -> anyhow::Result<f64> {
    let mut maps = [Map::new(SIZE, SIZE), Map::new(SIZE, SIZE)];
    let mut work = [MapWork::default(), MapWork::default()];
    let (begin, mut best) = (Instant::now(), f64::INFINITY);
    while begin.elapsed() < 4 * MEASURE {
        let start = Instant::now();
        for pose in poses {
            let made = rectifier.at(black_box(pose))?;
            for i in 0..2 {
                made.map_into(Eye::BOTH[i], &mut maps[i], &mut work[i]);
            }
            black_box(&mut maps);
        }
        best = best.min(start.elapsed().as_secs_f64() / poses.len() as f64);
    }
    Ok(best)
}

/// Grey levels between pictures of both sides and the double-precision reference at the exact places.
fn quality(
    folder: &Folder,
    source: &Plane<[u8; 3]>,
    map: &Map,
    exact: &impl Fn(usize, usize) -> Option<[f64; 2]>,
) -> anyhow::Result<()> {
    println!("difference from double precision at the exact places, grey levels of 8 bits:");
    for (kernel, word) in KERNELS {
        let reference = plain::remapped(source, SIZE, exact, kernel, [0; 3]);
        let mut ours = source.clone();
        remap(source, map, kernel, Outside::Fill([0; 3]), &mut ours);
        let (mean, most) = difference(&ours, &reference, map);
        print!("  {word:<9} vergence mean {mean:.4}, largest {most}");
        // The other kernels of OpenCV are others (a = -3/4; 8 x 8).
        if kernel == Kernel::Bilinear {
            let bytes = std::fs::read(folder.0.join("cv2_bilinear.u8"))?;
            let pixels = bytes.as_chunks::<3>().0.to_vec();
            let (peer_mean, peer_most) = difference(
                &Plane::from_samples(SIZE.0, SIZE.1, pixels),
                &reference,
                map,
            );
            print!("; OpenCV mean {peer_mean:.4}, largest {peer_most}");
            ensure!(
                peer_mean < 1.0,
                "OpenCV's picture is another: mean {peer_mean}"
            );
        }
        println!();
        ensure!(most <= 3.0, "{word} differs by {most}");
    }
    Ok(())
}

/// Mean and largest difference over samples whose place has its square of pixels inside the source.
fn difference(a: &Plane<[u8; 3]>, b: &Plane<[u8; 3]>, map: &Map) -> (f64, f64) {
    let (mut sum, mut most, mut n) = (0.0, 0.0_f64, 0);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let whole = |c: f64, side: usize| c >= 3.0 && c <= side as f64 - 4.0;
            if !map
                .place(x, y)
                .is_some_and(|[u, v]| whole(u, SIZE.0) && whole(v, SIZE.1))
            {
                continue;
            }
            for (a, b) in a.at(x, y).iter().zip(b.at(x, y)) {
                let d = f64::from(a.abs_diff(b));
                sum += d;
                most = most.max(d);
                n += 1;
            }
        }
    }
    (sum / f64::from(n), most)
}

/// Places of both sides' maps beside the exact ones, and what both cost.
fn maps(
    folder: &Folder,
    rectifier: &Rectifier,
    poses: &[[nalgebra::Isometry3<f64>; 2]],
    seconds: f64,
    peer: &Peer,
) -> anyhow::Result<()> {
    let made = rectifier.at(&poses[0])?;
    let mut errors = [[0.0_f64; 2]; 2];
    for (i, eye) in Eye::BOTH.into_iter().enumerate() {
        let map = made.map(eye);
        let places = read_floats(&folder.0.join(format!("cv2_map_{i}.f32")))?;
        for (n, place) in places.as_chunks::<2>().0.iter().enumerate() {
            let (x, y) = (n % SIZE.0, n / SIZE.0);
            let at = made.source_from_rectified(eye, &Point2::new(x as f64, y as f64));
            let (Some(at), Some(fast)) = (at, map.place(x, y)) else {
                continue;
            };
            for (side, place) in [fast, place.map(f64::from)].iter().enumerate() {
                let off = (at.x - place[0]).abs().max((at.y - place[1]).abs());
                errors[side][i] = errors[side][i].max(off);
            }
        }
    }
    let [ours, theirs] = errors.map(|e| e[0].max(e[1]));
    let of_peer = *peer.times.get("maps").context("no time of maps")?;
    println!("both maps of a new pose, distortion included, milliseconds:");
    println!(
        "  vergence {:.2} (largest error {ours:.4} px, with orientation and window), OpenCV initUndistortRectifyMap x 2 {:.2} ({theirs:.4} px), ratio {:.1}",
        1e3 * seconds,
        1e3 * of_peer,
        of_peer / seconds
    );
    ensure!(ours < 0.01, "the fast maps are {ours} px off");
    ensure!(
        theirs < 0.05,
        "OpenCV's maps are {theirs} px off: not the same rectification"
    );
    Ok(())
}

struct Peer {
    version: String,
    times: Times,
}

/// Where both sides exchange files; removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> anyhow::Result<Self> {
        let name = format!("vergence-remap-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path)
            .with_context(|| format!("no folder can be made at {}", path.display()))?;
        Ok(Self(path))
    }

    fn write(&self, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
        std::fs::write(self.0.join(name), bytes)
            .with_context(|| format!("{name} could not be written"))
    }

    fn write_job(
        &self,
        source: &Plane<[u8; 3]>,
        exact: &impl Fn(usize, usize) -> Option<[f64; 2]>,
        made: &Rectification,
    ) -> anyhow::Result<()> {
        self.write("source.u8", source.samples().as_flattened())?;
        for (i, name) in ["map_u.f32", "map_v.f32"].into_iter().enumerate() {
            let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
            let places = pixels.map(|(x, y)| exact(x, y).map_or(-1e4, |at| at[i]) as f32);
            self.write(
                name,
                &places.flat_map(f32::to_le_bytes).collect::<Vec<u8>>(),
            )?;
        }
        let cameras = [Eye::Left, Eye::Right].map(|eye| opencv_camera(made, eye));
        let job = json!({
            "width": SIZE.0,
            "height": SIZE.1,
            "seconds": MEASURE.as_secs_f64(),
            "cameras": cameras,
        });
        self.write("job.json", job.to_string().as_bytes())
    }

    fn peer(&self) -> anyhow::Result<Peer> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/remap_cv2.py");
        let output = Command::new("python3")
            .arg(&script)
            .arg(&self.0)
            .output()
            .context(
                "python3 could not be started; bench-vs remap needs python3 with numpy and cv2",
            )?;
        if !output.status.success() {
            bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
        }
        let report: serde_json::Value = serde_json::from_slice(&output.stdout)
            .context("the peer's report is not the JSON that it should be")?;
        let times = report["times"].as_object().context("no times")?;
        Ok(Peer {
            version: report["version"].as_str().unwrap_or("?").to_owned(),
            times: times
                .iter()
                .filter_map(|(name, s)| Some((name.clone(), s.as_f64()?)))
                .collect(),
        })
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A folder left behind would only be litter.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Camera matrix, distortion, rotation and new camera matrix in OpenCV's order.
fn opencv_camera(made: &Rectification, eye: Eye) -> serde_json::Value {
    let i = usize::from(eye == Eye::Right);
    let rows = |m: &Matrix3<f64>| -> Vec<Vec<f64>> {
        m.row_iter()
            .map(|row| row.iter().copied().collect())
            .collect()
    };
    let camera = made.camera(eye);
    let turn = made.rect_from_cam()[i].to_rotation_matrix();
    json!([
        rows(&camera.intrinsics.matrix()),
        camera.distortion.coefficients(),
        rows(turn.matrix()),
        rows(&made.intrinsics()[i].matrix()),
    ])
}

fn read_floats(path: &Path) -> anyhow::Result<Vec<f32>> {
    let bytes = std::fs::read(path)?;
    let words = bytes.as_chunks::<4>().0;
    Ok(words.iter().map(|w| f32::from_le_bytes(*w)).collect())
}
