//! Scores of the depth map on recorded pairs with ground truth, with the settings that users get: per scene and on average, over the pixels that
//! both eyes see, bad-1, bad-2 and bad-4 (a missing disparity is bad), the mean error of what has one, its share, the range found and the time.
//!
//! `cargo run --release -p vergence-stereo --example depth_scores [all|chosen|confirming|SCENE[,SCENE]...]`. Constants were chosen on `chosen`. The recordings
//! are read from the folder in `VERGENCE_TEST_DATA`, or `../shared` beside the repository.

use std::path::{Path, PathBuf};
use std::time::Instant;

use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::files::{read_gray, read_gray16, read_rgb};
use vergence_stereo::depth::{DepthMap, DepthMatcher, DepthSettings};

const CHOSEN: [&str; 4] = ["art", "dolls", "cloth3", "motorcycle"];
const CONFIRMING: [&str; 4] = ["cones", "moebius", "aloe", "playground"];

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let root = data.join("stereo/disparity");
    let which = std::env::args().nth(1).unwrap_or_else(|| "all".to_owned());
    let scenes: Vec<&str> = match which.as_str() {
        "all" => [CHOSEN, CONFIRMING].concat(),
        "chosen" => CHOSEN.to_vec(),
        "confirming" => CONFIRMING.to_vec(),
        named => named.split(',').collect(),
    };
    println!(
        "{:<12} {:>6} {:>6} {:>6} {:>9} {:>8} {:>6}  range",
        "scene", "bad-1", "bad-2", "bad-4", "error, px", "known, %", "s"
    );
    let mut mean = [0.0; 6];
    for scene in &scenes {
        let folder = root.join(scene);
        let pair = [grey(&folder, "left")?, grey(&folder, "right")?];
        let mut matcher = DepthMatcher::default();
        let start = Instant::now();
        let map = matcher.map([&pair[0], &pair[1]], &DepthSettings::default())?;
        let seconds = start.elapsed().as_secs_f64();
        let scores = scores(&folder, &map)?;
        let row = [
            scores[0], scores[1], scores[2], scores[3], scores[4], seconds,
        ];
        print_row(scene, &row, &format!("{:?}", map.range_px));
        for (mean, value) in mean.iter_mut().zip(row) {
            *mean += value / scenes.len() as f64;
        }
    }
    print_row("mean", &mean, "");
    Ok(())
}

fn print_row(name: &str, row: &[f64; 6], range: &str) {
    println!(
        "{name:<12} {:>6.2} {:>6.2} {:>6.2} {:>9.3} {:>8.1} {:>6.3}  {range}",
        row[0], row[1], row[2], row[3], row[4], row[5]
    );
}

fn grey(folder: &Path, name: &str) -> Result<Gray, Failure> {
    let path = ["png", "jpg"].map(|ext| folder.join(format!("{name}.{ext}")));
    let path = path.iter().find(|path| path.is_file());
    let path = path.ok_or_else(|| format!("no {name} picture in {}", folder.display()))?;
    Ok(luma_from_rgb(&read_rgb(path)?))
}

/// Shares in percent that are wrong by more than 1, 2 and 4 px, mean error in px, share in percent with a disparity.
fn scores(folder: &Path, map: &DepthMap) -> Result<[f64; 5], Failure> {
    let truth = read_gray16(&folder.join("gt.png"))?;
    let seen = read_gray(&folder.join("nonocc.png"))?;
    let pixels = truth
        .samples()
        .iter()
        .zip(seen.samples())
        .zip(map.disparity_px.samples());
    let (mut all, mut known, mut sum, mut bad) = (0.0, 0.0, 0.0, [0.0; 3]);
    for ((truth, _), d) in pixels.filter(|((_, seen), _)| **seen == 255) {
        // 256 steps a pixel.
        let error = (d - f32::from(*truth) / 256.0).abs();
        all += 1.0;
        for (bad, limit) in bad.iter_mut().zip([1.0, 2.0, 4.0]) {
            // A missing disparity is NaN, which is not below any limit.
            *bad += if error <= limit { 0.0 } else { 100.0 };
        }
        if !error.is_nan() {
            known += 1.0;
            sum += f64::from(error);
        }
    }
    Ok([
        bad[0] / all,
        bad[1] / all,
        bad[2] / all,
        sum / known,
        100.0 * known / all,
    ])
}
