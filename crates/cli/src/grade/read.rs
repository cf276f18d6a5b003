//! From files to the pictures of one or two eyes.

use std::path::Path;

use vergence_imaging::Rgb;
use vergence_imaging::files::{self, ShownPicture};
use vergence_imaging::stereo_file::{Found, StereoTag, stereo_tag};

use super::layout::{self, LayoutChoice};
use super::record::LayoutGrade;

/// Most pixels of one eye's picture that are graded: the index takes up to 200 bytes for each.
pub(super) const MAX_PIXELS: usize = 50_000_000;

/// What was read of an item.
pub(super) struct Content {
    pub(super) pictures: Pictures,
    pub(super) remarks: Vec<String>,
    /// That it holds two eyes is known from its content and name alone.
    pub(super) guessed: bool,
}

/// One eye or two.
pub(super) enum Pictures {
    One(Rgb),
    Two { eyes: [Rgb; 2], layout: LayoutGrade },
}

/// Read one file, which holds one picture or two eyes.
///
/// # Errors
/// One sentence with the path last.
pub(super) fn file(path: &Path, choice: LayoutChoice) -> Result<Content, String> {
    let bytes = files::read_whole(path).map_err(|e| e.to_string())?;
    let at = |reason: String| format!("{reason}: {}", path.display());
    let tag = match choice {
        LayoutChoice::Auto => stereo_tag(&bytes).map_err(at)?,
        _ => None,
    };
    if let Some(Found {
        tag: StereoTag::Separate { left, right, views },
        place,
    }) = &tag
    {
        let shown = [left, right].map(|range| shown(&bytes[range.clone()], path));
        let [left, right] = shown;
        let (left, right) = (left?, right?);
        let mut remarks = remarks_of_two(&left, &right);
        if *views > 2 {
            remarks.push(format!(
                "{views} views in the file: the first two are taken"
            ));
        }
        let layout = LayoutGrade {
            name: "mpo".to_owned(),
            reason: format!("by its {place}"),
        };
        let eyes = one_size([left.picture, right.picture]).map_err(at)?;
        return Ok(Content {
            pictures: Pictures::Two { eyes, layout },
            remarks,
            guessed: false,
        });
    }
    let ShownPicture { picture, remarks } = shown(&bytes, path)?;
    drop(bytes);
    let found = layout::of_picture(&picture, path, tag.as_ref(), choice).map_err(at)?;
    Ok(Content {
        pictures: split_as(picture, &found).map_err(at)?,
        remarks,
        guessed: found.guessed,
    })
}

/// Read the two files of a pair.
///
/// # Errors
/// One sentence that names the file.
pub(super) fn pair(left: &Path, right: &Path) -> Result<Content, String> {
    let read = |path: &Path| {
        let bytes = files::read_whole(path).map_err(|e| e.to_string())?;
        shown(&bytes, path)
    };
    let (l, r) = (read(left)?, read(right)?);
    let remarks = remarks_of_two(&l, &r);
    let eyes = one_size([l.picture, r.picture])
        .map_err(|reason| format!("{reason}: {} and {}", left.display(), right.display()))?;
    Ok(Content {
        pictures: Pictures::Two {
            eyes,
            layout: LayoutGrade {
                name: "two-files".to_owned(),
                reason: "a file for each eye".to_owned(),
            },
        },
        remarks,
        guessed: false,
    })
}

/// The eyes of a picture of known layout.
///
/// # Errors
/// One clause.
pub(super) fn split_as(picture: Rgb, found: &layout::Layout) -> Result<Pictures, String> {
    let Some(packing) = found.packing else {
        return Ok(Pictures::One(picture));
    };
    Ok(Pictures::Two {
        eyes: layout::unpacked(&picture, packing)?,
        layout: LayoutGrade::from(found),
    })
}

fn shown(bytes: &[u8], path: &Path) -> Result<ShownPicture, String> {
    let (w, h) = files::size_from_bytes(bytes, path).map_err(|e| e.to_string())?;
    // Two eyes in one picture are two pictures.
    if w.saturating_mul(h) > 2 * MAX_PIXELS {
        return Err(format!(
            "{w} x {h} pixels are more than can be graded ({} million an eye); reduce it: {}",
            MAX_PIXELS / 1_000_000,
            path.display()
        ));
    }
    files::shown_from_bytes(bytes, path).map_err(|e| e.to_string())
}

/// What is said of both once, of one with the eye.
fn remarks_of_two(left: &ShownPicture, right: &ShownPicture) -> Vec<String> {
    let mut remarks = Vec::new();
    for remark in &left.remarks {
        if right.remarks.contains(remark) {
            remarks.push(remark.clone());
        } else {
            remarks.push(format!("left: {remark}"));
        }
    }
    let alone = right.remarks.iter().filter(|r| !left.remarks.contains(r));
    remarks.extend(alone.map(|r| format!("right: {r}")));
    remarks
}

fn one_size(eyes: [Rgb; 2]) -> Result<[Rgb; 2], String> {
    let [(lw, lh), (rw, rh)] = eyes.each_ref().map(Rgb::size);
    if (lw, lh) == (rw, rh) {
        return Ok(eyes);
    }
    Err(format!(
        "the left picture is {lw} x {lh} pixels, the right one {rw} x {rh}; a pair needs one size"
    ))
}
