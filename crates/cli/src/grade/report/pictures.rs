//! The pictures of the page: reduced, composed and embedded.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use vergence_imaging::files::encode_jpeg;
use vergence_imaging::{Gray, Rgb};
use vergence_stereo::compose::{Anaglyph, Composition, Layout};

/// Widest picture of the page, pixels.
const WIDTH: usize = 900;

/// Widths and JPEG qualities that are tried in turn until all pictures together are small enough.
const TRIED: [(usize, u8); 4] = [(WIDTH, 86), (WIDTH, 70), (640, 66), (420, 50)];

/// Most bytes of all pictures of a pair together, before base64.
const MOST_BYTES: usize = 2 << 20;

/// A difference is shown so many times stronger.
pub(super) const DIFFERENCE_GAIN: i32 = 3;

/// An embedded picture.
#[derive(Debug)]
pub(super) struct Embedded {
    /// `data:image/jpeg;base64,..`
    pub(super) uri: String,
    /// Pixels.
    pub(super) size: (usize, usize),
}

/// The four views of a pair.
#[derive(Debug)]
pub(super) struct PairViews {
    pub(super) left: Embedded,
    pub(super) right: Embedded,
    /// Red for the left eye, cyan for the right one (Dubois 2001).
    pub(super) anaglyph: Embedded,
    /// Middle grey where both are equal, brighter where the left one is.
    pub(super) difference: Embedded,
}

/// One picture, reduced.
pub(super) fn embedded(picture: &Rgb) -> anyhow::Result<Embedded> {
    let views = |width, quality| Ok(vec![jpeg(&reduced(picture, width), quality)?]);
    let mut all = smallest(views)?;
    Ok(all.remove(0))
}

/// A small grey one to draw on.
pub(super) fn backdrop(picture: &Rgb) -> anyhow::Result<Embedded> {
    let small = reduced(picture, 480);
    let grey: Gray = vergence_imaging::colour::luma_from_rgb(&small);
    jpeg(&vergence_imaging::colour::rgb_from_luma(&grey), 60)
}

/// The views of a pair, reduced.
pub(super) fn pair_views(left: &Rgb, right: &Rgb) -> anyhow::Result<PairViews> {
    let views = |width, quality| {
        let (left, right) = (reduced(left, width), reduced(right, width));
        let anaglyph = Composition {
            layout: Layout::Anaglyph(Anaglyph::Dubois),
            shift_px: [0.0; 2],
        };
        let anaglyph = anaglyph.compose(&left, &right)?;
        let difference = difference(&left, &right);
        [&left, &right, &anaglyph, &difference]
            .into_iter()
            .map(|p| jpeg(p, quality))
            .collect()
    };
    let [left, right, anaglyph, difference] = <[Embedded; 4]>::try_from(smallest(views)?)
        .map_err(|_| anyhow::anyhow!("four views were to be made"))?;
    Ok(PairViews {
        left,
        right,
        anaglyph,
        difference,
    })
}

/// The first try that is small enough, or the last.
fn smallest(
    views: impl Fn(usize, u8) -> anyhow::Result<Vec<Embedded>>,
) -> anyhow::Result<Vec<Embedded>> {
    let mut last = Vec::new();
    for (width, quality) in TRIED {
        last = views(width, quality)?;
        if last.iter().map(|v| v.uri.len() * 3 / 4).sum::<usize>() <= MOST_BYTES {
            break;
        }
    }
    Ok(last)
}

fn jpeg(picture: &Rgb, quality: u8) -> anyhow::Result<Embedded> {
    let bytes = encode_jpeg(picture, quality)
        .map_err(|e| anyhow::anyhow!("a picture of the report cannot be encoded: {e}"))?;
    Ok(Embedded {
        uri: format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)),
        size: picture.size(),
    })
}

/// Luma of left minus right around middle grey.
fn difference(left: &Rgb, right: &Rgb) -> Rgb {
    use vergence_imaging::colour::luma_from_rgb;
    let (l, r) = (luma_from_rgb(left), luma_from_rgb(right));
    Rgb::from_fn(left.width(), left.height(), |x, y| {
        let d = i32::from(l.at(x, y)) - i32::from(r.at(x, y));
        [(128 + DIFFERENCE_GAIN * d).clamp(0, 255) as u8; 3]
    })
}

/// At most so wide, by the mean of all pixels that fall into one; small pictures stay as they are.
fn reduced(picture: &Rgb, width: usize) -> Rgb {
    let (w, h) = picture.size();
    if w <= width {
        return picture.clone();
    }
    let height = ((h * width + w / 2) / w).max(1);
    let span = |i: usize, from: usize, to: usize| {
        let first = i * from / to;
        first..((i + 1) * from / to).max(first + 1)
    };
    Rgb::from_fn(width, height, |x, y| {
        let (columns, rows) = (span(x, w, width), span(y, h, height));
        let count = (columns.len() * rows.len()) as u64;
        let mut sums = [0_u64; 3];
        for row in rows {
            for pixel in &picture.row(row)[columns.clone()] {
                for (sum, value) in sums.iter_mut().zip(pixel) {
                    *sum += u64::from(*value);
                }
            }
        }
        sums.map(|sum| ((sum + count / 2) / count) as u8)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means are kept, sizes are bounded, small pictures and thin ones come through.
    #[test]
    fn pictures_are_reduced_by_their_means() {
        let wide = Rgb::from_fn(2000, 30, |x, _| [if x % 2 == 0 { 0 } else { 200 }; 3]);
        let small = reduced(&wide, 500);
        assert_eq!(small.size(), (500, 8));
        assert!(small.samples().iter().all(|p| *p == [100; 3]));
        assert_eq!(reduced(&wide, 2000), wide);
        assert_eq!(
            reduced(&Rgb::filled(30_000, 1, [7; 3]), 900).size(),
            (900, 1)
        );
    }

    /// Noise does not compress: the tries end within the bound.
    #[test]
    fn noisy_pairs_stay_within_the_bound() {
        let noise = |seed: u32| {
            let mut state = seed;
            Rgb::from_fn(1400, 1400, |_, _| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                [(state >> 24) as u8, (state >> 16) as u8, (state >> 8) as u8]
            })
        };
        let views = pair_views(&noise(1), &noise(2)).unwrap();
        let all = [views.left, views.right, views.anaglyph, views.difference];
        assert!(all.iter().map(|v| v.uri.len() * 3 / 4).sum::<usize>() <= MOST_BYTES);
        assert!(all[0].size.0 <= WIDTH);
    }
}
