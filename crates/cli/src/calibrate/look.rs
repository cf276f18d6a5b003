//! Look for the board in every picture.

use std::collections::BTreeMap;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayon::prelude::*;
use vergence_calib::solve::Sighting;
use vergence_calib::{Target, detect};
use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::files::{read_whole, shown_from_bytes};

use super::lists::View;
use crate::fault::{self, Fault};

/// What is seen of the board in a picture.
#[derive(Clone, Debug)]
pub(crate) enum Seen {
    /// Its corners.
    Board(Vec<Sighting>),
    /// It takes no part, and why.
    Nothing(String),
}

/// One picture, looked at.
struct Looked {
    size: (usize, usize),
    bytes_digest: u64,
    seen: Seen,
}

/// Look at all pictures; fills in their sizes.
///
/// # Errors
/// Files that cannot be read, pictures of one camera in two sizes, and no board in any picture.
pub(super) fn at(views: &mut [View], target: &Target, cameras: usize) -> Result<Vec<Seen>, Fault> {
    let bar = progress(views.len());
    let looked: Vec<Result<Looked, Fault>> = views
        .par_iter()
        .map(|view| {
            let looked = look(view, target);
            bar.inc(1);
            looked
        })
        .collect();
    bar.finish_and_clear();
    let mut seen = Vec::with_capacity(views.len());
    let mut digests: BTreeMap<(usize, u64), usize> = BTreeMap::new();
    for (i, looked) in looked.into_iter().enumerate() {
        let looked = looked?;
        views[i].size = looked.size;
        let twin = digests.insert((views[i].camera, looked.bytes_digest), i);
        seen.push(match twin {
            Some(other) => Seen::Nothing(format!(
                "the same picture as {}",
                views[other].path.display()
            )),
            None => looked.seen,
        });
    }
    check_sizes(views, cameras)?;
    if !seen.iter().any(|s| matches!(s, Seen::Board(_))) {
        let reason = match seen.first() {
            Some(Seen::Nothing(reason)) => reason.clone(),
            _ => String::new(),
        };
        return Err(fault::usage(format!(
            "no picture shows the board; {}: {reason}",
            views[0].path.display()
        ))
        .hint("check --target: for a chessboard count inner corners, for others squares or tags"));
    }
    Ok(seen)
}

fn progress(count: usize) -> ProgressBar {
    let bar =
        ProgressBar::with_draw_target(Some(count as u64), ProgressDrawTarget::stderr_with_hz(5));
    if let Ok(style) = ProgressStyle::with_template("{pos}/{len} {wide_bar} {eta} left") {
        bar.set_style(style);
    }
    bar
}

fn look(view: &View, target: &Target) -> Result<Looked, Fault> {
    let unusable = |e: vergence_imaging::ImageError| fault::usage(e.to_string());
    let bytes = read_whole(&view.path).map_err(unusable)?;
    let picture = shown_from_bytes(&bytes, &view.path)
        .map_err(unusable)?
        .picture;
    let gray = luma_from_rgb(&picture);
    Ok(Looked {
        size: picture.size(),
        bytes_digest: digest(&bytes),
        seen: seen_in(&gray, target),
    })
}

/// The board in a picture.
pub(super) fn seen_in(picture: &Gray, target: &Target) -> Seen {
    match detect(picture, target) {
        Err(missing) => Seen::Nothing(missing.to_string()),
        Ok(found) if found.mirrored => Seen::Nothing(
            "it shows the board as in a mirror; take the picture unmirrored, or print the board anew"
                .to_owned(),
        ),
        Ok(found) => Seen::Board(
            found
                .corners
                .iter()
                .map(|corner| Sighting {
                    point_in_board: target.point_in_board(corner.id),
                    pixel: corner.pixel,
                    sigma_px: corner.sigma_px.max(LEAST_SIGMA_PX),
                })
                .collect(),
        ),
    }
}

/// No corner is believed to be known better than this, px: flatness of the board and the lens model are not perfect.
const LEAST_SIGMA_PX: f64 = 0.02;

/// FNV-1a, 64 bits: good enough to notice that a file was given twice.
fn digest(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

fn check_sizes(views: &[View], cameras: usize) -> Result<(), Fault> {
    for camera in 0..cameras {
        let mut own = views.iter().filter(|v| v.camera == camera);
        let Some(first) = own.next() else {
            continue;
        };
        if let Some(other) = own.find(|v| v.size != first.size) {
            return Err(fault::usage(format!(
                "pictures of one camera must have one size: {} is {}x{} and {} is {}x{}",
                first.path.display(),
                first.size.0,
                first.size.1,
                other.path.display(),
                other.size.0,
                other.size.1
            ))
            .hint("leave out those that were cropped or reduced"));
        }
    }
    Ok(())
}
