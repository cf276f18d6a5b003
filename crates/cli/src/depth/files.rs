//! The folder of results: written under a provisional name, renamed when it is whole.

use std::fs;
use std::path::{Path, PathBuf};

use vergence_imaging::Plane;
use vergence_imaging::files::{write_gray, write_gray16, write_rgb};
use vergence_imaging::pfm::write_pfm;
use vergence_imaging::ply::{CloudPoint, write_ply};
use vergence_stereo::dense::Seen;
use vergence_stereo::depth::{DepthMap, depth_m, sigma_px};

use super::{Metric, Rectified, view};
use crate::fault;

/// Steps of the 16-bit picture per pixel of disparity, as KITTI has them; its value 0 means unknown.
const STEPS_PER_PX: f32 = 256.0;

/// Every result that this command ever writes: a folder with others in it is not ours to replace.
const NAMES: [&str; 8] = [
    "left.png",
    "disparity.pfm",
    "disparity.png",
    "confidence.png",
    "seen.png",
    "view.png",
    "depth.pfm",
    "cloud.ply",
];

/// What was written.
pub(super) struct Written {
    pub(super) files: Vec<String>,
    pub(super) depth_m: Option<[f32; 2]>,
    pub(super) points: Option<usize>,
}

/// Refuse a place for the results before any work is done.
pub(super) fn check_out(out: &Path) -> anyhow::Result<()> {
    let refuse = |reason: &str| {
        fault::usage(format!("--out {}: {reason}", out.display()))
            .hint("name a folder that does not exist yet, or one of an earlier vergence depth")
    };
    if !out.exists() {
        return Ok(());
    }
    let entries = fs::read_dir(out).map_err(|_| refuse("it is there and no folder"))?;
    for entry in entries {
        let name = entry.map_err(|e| refuse(&e.to_string()))?.file_name();
        if !NAMES.iter().any(|known| name == *known) {
            let name = name.to_string_lossy();
            return Err(refuse(&format!("it holds other files ({name})")).into());
        }
    }
    Ok(())
}

/// Write all results; the folder appears whole or not at all.
pub(super) fn write(out: &Path, pair: &Rectified, map: &DepthMap) -> anyhow::Result<Written> {
    let partial = beside(out);
    // What an interrupted call left behind is nobody's.
    let _ = fs::remove_dir_all(&partial);
    let written = fs::create_dir_all(&partial)
        .map_err(|e| fault::failed(format!("cannot make {}: {e}", partial.display())).into())
        .and_then(|()| fill(&partial, pair, map))
        .and_then(|written| {
            replace(&partial, out)
                .map(|()| written)
                .map_err(|e| fault::failed(format!("cannot write {}: {e}", out.display())).into())
        });
    if written.is_err() {
        // The first failure is the one to tell.
        let _ = fs::remove_dir_all(&partial);
    }
    written
}

fn beside(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(".partial");
    out.with_file_name(name)
}

/// Put the new folder in the place of an older one.
fn replace(partial: &Path, out: &Path) -> std::io::Result<()> {
    if out.exists() {
        fs::remove_dir_all(out)?;
    }
    fs::rename(partial, out)
}

fn fill(dir: &Path, pair: &Rectified, map: &DepthMap) -> anyhow::Result<Written> {
    let mut files = Vec::new();
    let mut place = |name: &str| {
        files.push(name.to_owned());
        dir.join(name)
    };
    let [x, y] = map.origin;
    let origin = format!("first pixel is column {x}, row {y} of the left picture");
    let comment = format!("disparity u_left - u_right, pixels; NaN unknown\n{origin}");
    // Comments in a PFM header are not read by everybody: the header is plain, the words stand in the documentation.
    write_pfm(&place("disparity.pfm"), &map.disparity_px, "")?;
    if pair.rectified_here {
        write_rgb(&place("left.png"), &pair.left)?;
    }
    write_gray16(&place("disparity.png"), &steps(&map.disparity_px))?;
    let confidence = map.confidence.map(|c| (255.0 * c).round() as u8);
    write_gray(&place("confidence.png"), &confidence)?;
    let seen = map.seen.map(|seen| match seen {
        Seen::Both => 255,
        Seen::Unknown => 128,
        Seen::Occluded => 0,
    });
    write_gray(&place("seen.png"), &seen)?;
    write_rgb(
        &place("view.png"),
        &view::picture(map, pair.metric.as_ref())?,
    )?;
    let (mut range, mut points) = (None, None);
    if let Some(metric) = &pair.metric {
        let depth = map.disparity_px.map(|d| depth_of(d, metric));
        write_pfm(&place("depth.pfm"), &depth, "")?;
        let known = depth.samples().iter().filter(|z| !z.is_nan());
        range = known.fold(None, |found: Option<[f32; 2]>, &z| {
            let [near, far] = found.unwrap_or([z, z]);
            Some([near.min(z), far.max(z)])
        });
        let cloud = cloud(pair, map, metric, &depth);
        let comment = format!(
            "metres, left camera: x right, y down, z forward\n{comment}\nsigma: standard deviation of z, metres"
        );
        write_ply(&place("cloud.ply"), &cloud, &comment)?;
        points = Some(cloud.len());
    }
    Ok(Written {
        files,
        depth_m: range,
        points,
    })
}

fn depth_of(disparity_px: f32, metric: &Metric) -> f32 {
    depth_m(
        disparity_px,
        metric.focal_px,
        metric.baseline_m,
        metric.doffs_px,
    )
}

/// 256 steps a pixel; what is not above 0, and what is over 255.99 px, cannot be said and is 0 as the unknown.
fn steps(disparity_px: &Plane<f32>) -> Plane<u16> {
    disparity_px.map(|d| {
        let steps = (STEPS_PER_PX * d).round();
        if steps >= 1.0 && steps <= f32::from(u16::MAX) {
            steps as u16
        } else {
            0
        }
    })
}

/// The points that both eyes agree on, or that were filled between such: hidden ones are no measurement and stay out.
fn cloud(pair: &Rectified, map: &DepthMap, metric: &Metric, depth: &Plane<f32>) -> Vec<CloudPoint> {
    let (width, height) = depth.size();
    let [x0, y0] = map.origin;
    let mut points = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let z = depth.at(x, y);
            if z.is_nan() || map.seen.at(x, y) == Seen::Occluded {
                continue;
            }
            let [cx, cy] = metric.centre_px;
            let across = ((x + x0) as f64 - cx) / metric.focal_px;
            let down = ((y + y0) as f64 - cy) / metric.focal_px;
            // dz/dd = -z^2 / (f B).
            let per_px = f64::from(z).powi(2) / (metric.focal_px * metric.baseline_m);
            let sigma = f64::from(sigma_px(map.confidence.at(x, y))) * per_px;
            points.push(CloudPoint {
                place_m: [
                    (across * f64::from(z)) as f32,
                    (down * f64::from(z)) as f32,
                    z,
                ],
                colour: pair.left.at(x + x0, y + y0),
                sigma_m: sigma as f32,
            });
        }
    }
    points
}
