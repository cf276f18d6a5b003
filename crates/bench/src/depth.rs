//! `cargo xtask bench-vs depth`: the depth map beside OpenCV's semi-global matchers on the same made pairs with the same disparities, in one
//! run; itself on one thread and two; and the memory that it takes.
//!
//! Rounds of both sides alternate, so that a neighbour's noise hits them alike; the best counts. Speed is width x height x disparities over
//! time, as OpenCV's own figures are given; what is extended on the left for OpenCV is not counted as work done.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use vergence_imaging::Gray;
use vergence_stereo::depth::{DepthMap, DepthMatcher, DepthSettings};

use crate::ALLOCATOR;

/// Width, height and disparities: about those of the pairs that such matchers are compared on, small, middle and large.
const SIZES: [(usize, usize, usize); 3] = [(450, 375, 64), (741, 500, 64), (1282, 1110, 224)];
/// Alternations of both sides.
const ROUNDS: usize = 4;
/// Repetitions of each side in one of them, about so many million disparities.
const CELLS_EACH: usize = 960_000_000;
/// At least as fast as HH; better, as fast as SGBM_3WAY; this much faster on two threads.
const LEAST_GAIN: f64 = 1.7;

/// Runs both sides and prints the table; an error when python3 or OpenCV is missing.
pub(crate) fn run() -> anyhow::Result<()> {
    println!("dense disparity, best of rounds, milliseconds (million disparities a second)");
    println!(
        "       size  disparities      one thread     two threads   gain  bytes/cell     OpenCV HH, 1 thread  SGBM_3WAY, 1 thread  ratio to HH  to 3WAY"
    );
    let mut version = String::new();
    for (width, height, count) in SIZES {
        let [left, right] = pair(width, height, count);
        let cells = (width * height * count) as f64;
        let repeat = (CELLS_EACH / (width * height * count)).clamp(1, 20);
        let settings = DepthSettings {
            range_px: Some([0, count as i32 - 1]),
            ..DepthSettings::default()
        };
        let on = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let pools = [on(1)?, on(2)?];
        // Both sides keep their memory from pair to pair.
        let mut matcher = DepthMatcher::default();
        ALLOCATOR.reset_peak_usage();
        let before = ALLOCATOR.current_usage() as f64;
        let first = pools[0].install(|| matcher.map([&left, &right], &settings))?;
        let bytes = (ALLOCATOR.peak_usage() as f64 - before) / cells;
        let second = pools[1].install(|| matcher.map([&left, &right], &settings))?;
        ensure!(
            same(&first, &second),
            "two threads give another map than one"
        );
        let files = [file("left", &left)?, file("right", &right)?];
        let mut best = [f64::INFINITY; 4];
        for _ in 0..ROUNDS {
            for (pool, best) in pools.iter().zip(&mut best) {
                for _ in 0..repeat {
                    let start = Instant::now();
                    pool.install(|| matcher.map([&left, &right], &settings))?;
                    *best = best.min(start.elapsed().as_secs_f64());
                }
            }
            let peer = peer(width, height, count, &files, repeat)?;
            version = peer["version"].as_str().unwrap_or_default().to_owned();
            for (mode, best) in ["HH", "SGBM_3WAY"].iter().zip(&mut best[2..]) {
                let seconds = peer[mode]["seconds"]["1"].as_f64().context("no seconds")?;
                *best = best.min(seconds);
            }
        }
        for path in files {
            // A file left behind would only be litter.
            let _ = std::fs::remove_file(path);
        }
        let show = |s: f64| format!("{:.1} ({:.0})", 1e3 * s, cells / s / 1e6);
        println!(
            "{width:>5} x {height:<4} {count:>11}  {:>14}  {:>14}  {:>5.2}  {bytes:>10.2}  {:>22}  {:>19}  {:>11.2}  {:>7.2}",
            show(best[0]),
            show(best[1]),
            best[0] / best[1],
            show(best[2]),
            show(best[3]),
            best[2] / best[0],
            best[3] / best[0],
        );
    }
    println!(
        "OpenCV {version}. Goals: ratio to HH at least 1, to SGBM_3WAY too if it can be; gain at least {LEAST_GAIN} on two threads."
    );
    Ok(())
}

fn same(a: &DepthMap, b: &DepthMap) -> bool {
    let bits = |map: &DepthMap| map.disparity_px.map(f32::to_bits);
    bits(a) == bits(b) && a.seen == b.seen
}

/// A slanted floor and boards before it, with grain: every step but the filling costs the same whatever is shown.
fn pair(width: usize, height: usize, count: usize) -> [Gray; 2] {
    let texture = |u: f64, v: f64, seed: u32| {
        let (x, y) = (u.floor() as i64, v as i64);
        let cell = |x: i64, y: i64| {
            let mut h = (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca6b);
            h = (h ^ seed ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
            h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
            f64::from((h ^ (h >> 15)) & 0xff)
        };
        let part = u - u.floor();
        let fine = cell(x, y) * (1.0 - part) + cell(x + 1, y) * part;
        0.6 * fine + 0.4 * cell(x.div_euclid(7), y.div_euclid(7))
    };
    let disparity = |x: f64, y: f64| {
        let board = ((x / 90.0) as i64 + (y / 70.0) as i64) % 3 == 0;
        let floor = 0.2 + 0.4 * y / height as f64;
        (count as f64 - 8.0) * if board { floor + 0.25 } else { floor }
    };
    let right = Gray::from_fn(width, height, |x, y| texture(x as f64, y as f64, 1) as u8);
    let left = Gray::from_fn(width, height, |x, y| {
        let u = x as f64 - disparity(x as f64, y as f64);
        texture(u, y as f64, 1) as u8
    });
    [left, right]
}

fn file(name: &str, picture: &Gray) -> anyhow::Result<PathBuf> {
    let name = format!("vergence-depth-{}-{name}.u8", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, picture.samples())
        .with_context(|| format!("the picture could not be written to {}", path.display()))?;
    Ok(path)
}

fn peer(
    width: usize,
    height: usize,
    count: usize,
    files: &[PathBuf; 2],
    rounds: usize,
) -> anyhow::Result<serde_json::Value> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/depth_opencv.py");
    let output = Command::new("python3")
        .arg(&script)
        .args([width.to_string(), height.to_string()])
        .args(files)
        .args([count.to_string(), rounds.to_string()])
        .output()
        .context("python3 could not be started; bench-vs depth needs python3 with OpenCV")?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    serde_json::from_slice(&output.stdout)
        .context("the peer's report is not the JSON that it should be")
}
