//! How one picture holds two eyes: as it was typed, else by its tags, else by what its halves show and its name says.

use std::path::Path;

use vergence_imaging::stereo_file::{Found, Halves, Order, Packing, StereoTag};
use vergence_imaging::{Gray, Rgb};

use super::names;
use super::record::LayoutGrade;

/// What can be typed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum LayoutChoice {
    /// Found from tags, content and name.
    #[default]
    Auto,
    /// One picture.
    Mono,
    /// Left eye's picture on the left.
    SideBySide,
    /// Right eye's picture on the left.
    CrossEyed,
    /// Left eye's picture above.
    OverUnder,
    /// Side by side, each squeezed to half its width.
    HalfSideBySide,
    /// Over-under, each squeezed to half its height.
    HalfOverUnder,
}

/// What a file holds, and how that is known.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Layout {
    /// `None`: one picture.
    pub(crate) packing: Option<Packing>,
    /// A clause for people: "the halves show one scene".
    pub(crate) reason: String,
    /// Only the content and the name say so.
    pub(crate) guessed: bool,
}

impl From<&Layout> for LayoutGrade {
    fn from(layout: &Layout) -> Self {
        Self {
            name: name(layout.packing).to_owned(),
            reason: layout.reason.clone(),
        }
    }
}

/// Share of the places of one half that must be found again in the other for the content alone to decide.
const CONTENT_DECIDES: f64 = 0.45;
/// The same when the name says so too.
const CONTENT_AGREES: f64 = 0.12;
/// By how much the better arrangement of halves must win.
const CONTENT_WINS: f64 = 1.5;

/// Narrower or wider than this a half was squeezed (width over height).
const NARROW: f64 = 1.0;
const WIDE: f64 = 2.6;

impl LayoutChoice {
    /// What was typed, as a packing; `None` for `auto`, `Some(None)` for one picture.
    fn packing(self) -> Option<Option<Packing>> {
        let packing = |halves, order, squeezed| {
            Some(Packing {
                halves,
                order,
                squeezed,
                gap_px: 0,
            })
        };
        use Halves::{OverUnder, SideBySide};
        use Order::{LeftFirst, RightFirst};
        match self {
            LayoutChoice::Auto => None,
            LayoutChoice::Mono => Some(None),
            LayoutChoice::SideBySide => Some(packing(SideBySide, LeftFirst, false)),
            LayoutChoice::CrossEyed => Some(packing(SideBySide, RightFirst, false)),
            LayoutChoice::OverUnder => Some(packing(OverUnder, LeftFirst, false)),
            LayoutChoice::HalfSideBySide => Some(packing(SideBySide, LeftFirst, true)),
            LayoutChoice::HalfOverUnder => Some(packing(OverUnder, LeftFirst, true)),
        }
    }
}

/// The layout of a picture that is in memory. `tag` is what its file says.
///
/// # Errors
/// One clause, where the file says that it holds two eyes in a way that is not read.
pub(crate) fn of_picture(
    picture: &Rgb,
    path: &Path,
    tag: Option<&Found>,
    choice: LayoutChoice,
) -> Result<Layout, String> {
    if let Some(layout) = without_content(path, tag, choice)? {
        return Ok(layout);
    }
    Ok(by_content(picture, path).unwrap_or_else(|| Layout {
        packing: None,
        reason: "no tag, and it is too plain to tell by its content".to_owned(),
        guessed: true,
    }))
}

/// The layout as it was typed or as the file's tag or ending says; `None` where only the content can tell.
///
/// # Errors
/// One clause, where the file says that it holds two eyes in a way that is not read.
pub(crate) fn without_content(
    path: &Path,
    tag: Option<&Found>,
    choice: LayoutChoice,
) -> Result<Option<Layout>, String> {
    let known = |packing, reason| {
        Some(Layout {
            packing,
            reason,
            guessed: false,
        })
    };
    if let Some(packing) = choice.packing() {
        return Ok(known(packing, "as given by --layout".to_owned()));
    }
    if let Some(found) = tag {
        let reason = format!("by its {}", found.place);
        match &found.tag {
            StereoTag::Packed(packing) => return Ok(known(Some(*packing), reason)),
            StereoTag::Mono => return Ok(known(None, reason)),
            StereoTag::NotRead(what) => {
                return Err(format!(
                    "it holds {what} ({reason}), which is not read; --layout mono grades what is seen of it"
                ));
            }
            StereoTag::Separate { .. } => {}
        }
    }
    if names::is_crossed_by_ending(path) {
        let packing = Packing {
            halves: Halves::SideBySide,
            order: Order::RightFirst,
            squeezed: false,
            gap_px: 0,
        };
        let reason = "by its ending: such files are for crossed eyes unless a tag says otherwise";
        return Ok(known(Some(packing), reason.to_owned()));
    }
    Ok(None)
}

/// By what the halves show, helped by the name; `None` where the picture is too plain to tell.
pub(crate) fn by_content(picture: &Rgb, path: &Path) -> Option<Layout> {
    let shares = [Halves::SideBySide, Halves::OverUnder].map(|h| share_in_common(picture, h));
    if shares == [None, None] {
        return None;
    }
    let shares = shares.map(|share| share.unwrap_or(0.0));
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    if let Some((word, halves, order, squeezed)) = names::layout_in_name(path) {
        let share = shares[halves as usize];
        if share >= CONTENT_AGREES {
            return Some(Layout {
                packing: Some(Packing {
                    halves,
                    order,
                    squeezed: squeezed.unwrap_or_else(|| looks_squeezed(picture.size(), halves)),
                    gap_px: 0,
                }),
                reason: format!(
                    "by its name (_{word}) and content: {} of one half is found in the other",
                    percent(share)
                ),
                guessed: true,
            });
        }
    }
    let (halves, share, other) = if shares[0] >= shares[1] {
        (Halves::SideBySide, shares[0], shares[1])
    } else {
        (Halves::OverUnder, shares[1], shares[0])
    };
    if share >= CONTENT_DECIDES && share >= CONTENT_WINS * other {
        return Some(Layout {
            packing: Some(Packing {
                halves,
                order: Order::LeftFirst,
                squeezed: looks_squeezed(picture.size(), halves),
                gap_px: 0,
            }),
            reason: format!(
                "by its content: {} of one half is found in the other; which eye is first and whether the halves are squeezed is \
                 assumed (--layout says otherwise)",
                percent(share)
            ),
            guessed: true,
        });
    }
    Some(Layout {
        packing: None,
        reason: "no tag, and its halves show no common scene".to_owned(),
        guessed: true,
    })
}

/// Whether halves of this picture have a shape that no whole picture has.
pub(crate) fn looks_squeezed((w, h): (usize, usize), halves: Halves) -> bool {
    let (w, h) = (w as f64, h as f64);
    match halves {
        Halves::SideBySide => w / 2.0 / h < NARROW,
        Halves::OverUnder => w / (h / 2.0) > WIDE,
    }
}

/// Longer side of a half while it is compared, pixels.
const SMALL: usize = 192;
/// Half the side of a place that is compared, pixels.
const REACH: isize = 5;
/// How far a place may have moved, as shares of the half's width and height.
const FAR_ACROSS: f64 = 0.18;
const FAR_DOWN: f64 = 0.03;
/// Least contrast of a place (standard deviation, levels) and least likeness (normalised correlation).
const LEAST_CONTRAST: f64 = 5.0;
const LEAST_LIKENESS: f64 = 0.88;
/// Places across and down.
const PLACES: usize = 14;

/// Share of the places of one half that look like a place of the other half, near the same spot; `None` where too few places have
/// anything to compare.
fn share_in_common(picture: &Rgb, halves: Halves) -> Option<f64> {
    let (w, h) = picture.size();
    let (hw, hh) = match halves {
        Halves::SideBySide => (w / 2, h),
        Halves::OverUnder => (w, h / 2),
    };
    if hw.min(hh) < 32 {
        return None;
    }
    let factor = (hw.max(hh) / SMALL).max(1);
    let origin = match halves {
        Halves::SideBySide => (w - hw, 0),
        Halves::OverUnder => (0, h - hh),
    };
    let first = reduced(picture, (0, 0), (hw, hh), factor);
    let second = reduced(picture, origin, (hw, hh), factor);
    let (sw, sh) = (first.width() as isize, first.height() as isize);
    let across = (FAR_ACROSS * sw as f64) as isize;
    let down = ((FAR_DOWN * sh as f64) as isize).max(1);
    let (mut tried, mut found) = (0_usize, 0_usize);
    for row in 0..PLACES {
        for column in 0..PLACES {
            let spread = |i: usize, side: isize| {
                REACH + (side - 1 - 2 * REACH) * i as isize / (PLACES as isize - 1)
            };
            let (x, y) = (spread(column, sw), spread(row, sh));
            let Some(place) = Place::new(&first, x, y) else {
                continue;
            };
            tried += 1;
            let best = (-down..=down)
                .flat_map(|dy| (-across..=across).map(move |dx| (x + dx, y + dy)))
                .filter_map(|(x, y)| Place::new(&second, x, y))
                .map(|other| place.likeness(&other))
                .fold(0.0, f64::max);
            found += usize::from(best >= LEAST_LIKENESS);
        }
    }
    (tried >= PLACES).then(|| found as f64 / tried as f64)
}

/// A part of the picture in grey, reduced by a whole factor (mean of the pixels).
fn reduced(picture: &Rgb, origin: (usize, usize), size: (usize, usize), factor: usize) -> Gray {
    let luma = |x: usize, y: usize| {
        let [r, g, b] = picture.at(x, y).map(u32::from);
        (299 * r + 587 * g + 114 * b) / 1000
    };
    let area = (factor * factor) as u32;
    Gray::from_fn(size.0 / factor, size.1 / factor, |x, y| {
        let mut sum = 0;
        for dy in 0..factor {
            for dx in 0..factor {
                sum += luma(origin.0 + x * factor + dx, origin.1 + y * factor + dy);
            }
        }
        (sum / area) as u8
    })
}

/// A square of grey values without their mean, scaled to length 1.
struct Place([f64; ((2 * REACH + 1) * (2 * REACH + 1)) as usize]);

impl Place {
    /// `None` outside the picture and where it is plain.
    fn new(picture: &Gray, x: isize, y: isize) -> Option<Self> {
        let (w, h) = (picture.width() as isize, picture.height() as isize);
        if x < REACH || y < REACH || x + REACH >= w || y + REACH >= h {
            return None;
        }
        let mut values = [0.0; ((2 * REACH + 1) * (2 * REACH + 1)) as usize];
        let side = (2 * REACH + 1) as usize;
        for (i, row) in values.chunks_exact_mut(side).enumerate() {
            let line = picture.row((y - REACH) as usize + i);
            let from = (x - REACH) as usize;
            for (value, sample) in row.iter_mut().zip(&line[from..from + side]) {
                *value = f64::from(*sample);
            }
        }
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        values.iter_mut().for_each(|v| *v -= mean);
        let length = values.iter().map(|v| v * v).sum::<f64>().sqrt();
        if length < LEAST_CONTRAST * count.sqrt() {
            return None;
        }
        values.iter_mut().for_each(|v| *v /= length);
        Some(Self(values))
    }

    fn likeness(&self, other: &Self) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}

/// The two eyes of a packed picture, each in its full shape: squeezed halves are stretched to twice their width or height (linearly).
///
/// # Errors
/// One clause, where the picture cannot be cut into two equal halves.
pub(crate) fn unpacked(picture: &Rgb, packing: Packing) -> Result<[Rgb; 2], String> {
    let (w, h) = picture.size();
    let along = match packing.halves {
        Halves::SideBySide => w,
        Halves::OverUnder => h,
    };
    let half = along.saturating_sub(packing.gap_px) / 2;
    if half == 0 {
        return Err(format!("{w} x {h} pixels cannot be cut into two eyes"));
    }
    let second = along - half;
    let cut = |from: usize| match packing.halves {
        Halves::SideBySide => Rgb::from_fn(half, h, |x, y| picture.at(from + x, y)),
        Halves::OverUnder => Rgb::from_fn(w, half, |x, y| picture.at(x, from + y)),
    };
    let mut eyes = [cut(0), cut(second)];
    if packing.squeezed {
        eyes = eyes.map(|eye| stretched(&eye, packing.halves));
    }
    if packing.order == Order::RightFirst {
        eyes.swap(0, 1);
    }
    Ok(eyes)
}

/// Twice the width or height: new pixels a quarter of a pixel to each side of the old ones' centres.
fn stretched(eye: &Rgb, halves: Halves) -> Rgb {
    let (w, h) = eye.size();
    let mix = |near: [u8; 3], far: [u8; 3]| {
        std::array::from_fn(|c| ((3 * u16::from(near[c]) + u16::from(far[c]) + 2) / 4) as u8)
    };
    let neighbour = |at: usize, count: usize| {
        let far = if at.is_multiple_of(2) {
            (at / 2).saturating_sub(1)
        } else {
            (at / 2 + 1).min(count - 1)
        };
        (at / 2, far)
    };
    match halves {
        Halves::SideBySide => Rgb::from_fn(2 * w, h, |x, y| {
            let (near, far) = neighbour(x, w);
            mix(eye.at(near, y), eye.at(far, y))
        }),
        Halves::OverUnder => Rgb::from_fn(w, 2 * h, |x, y| {
            let (near, far) = neighbour(y, h);
            mix(eye.at(x, near), eye.at(x, far))
        }),
    }
}

/// The name of a layout as it is typed and printed.
fn name(packing: Option<Packing>) -> &'static str {
    match packing {
        None => "mono",
        Some(p) => match (p.halves, p.order, p.squeezed) {
            (Halves::SideBySide, Order::LeftFirst, false) => "side-by-side",
            (Halves::SideBySide, Order::RightFirst, false) => "cross-eyed",
            (Halves::SideBySide, Order::LeftFirst, true) => "half-side-by-side",
            (Halves::SideBySide, Order::RightFirst, true) => "half-cross-eyed",
            (Halves::OverUnder, Order::LeftFirst, false) => "over-under",
            (Halves::OverUnder, Order::RightFirst, false) => "under-over",
            (Halves::OverUnder, Order::LeftFirst, true) => "half-over-under",
            (Halves::OverUnder, Order::RightFirst, true) => "half-under-over",
        },
    }
}

#[cfg(test)]
mod tests;
