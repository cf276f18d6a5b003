//! One picture for both eyes: side by side and anaglyph, with electronic shift.

use vergence_imaging::Rgb;
use vergence_imaging::colour::luma_from_rgb;

use crate::StereoError;

/// How left and right share one picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Left picture left, both at full width.
    SideBySide,
    /// Left picture left, both squeezed to half their width (mean of two columns; an odd last column is dropped).
    HalfSideBySide,
    /// For red–cyan glasses, the red filter over the left eye.
    Anaglyph(Anaglyph),
}

/// Which red–cyan anaglyph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anaglyph {
    /// Colours nearest to the pair as seen through the glasses, and little ghosting: the least-squares projection of
    /// Dubois 2001 (*Proc. IEEE ICASSP*, 1661) for a CRT's primaries and common red–cyan filters, in linear light.
    Dubois,
    /// Luma of the left picture in red, of the right one in green and blue.
    Gray,
    /// Red of the left picture, green and blue of the right one: full colour, most retinal rivalry.
    Color,
    /// Luma of the left picture in red, green and blue of the right one.
    HalfColor,
}

/// A layout and how far each picture is moved first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Composition {
    /// How the eyes share the picture.
    pub layout: Layout,
    /// Shift of the left and of the right picture in pixels, + to the right; parts of a pixel are interpolated. Moving
    /// left by -d/2 and right by +d/2 takes a disparity `u_l - u_r` = d to zero.
    pub shift_px: [f64; 2],
}

impl Composition {
    /// The shifts that take a disparity (pixels, `u_l - u_r`) to zero, half in each picture.
    pub fn shift_to_zero(disparity_px: f64) -> [f64; 2] {
        [-disparity_px / 2.0, disparity_px / 2.0]
    }

    /// The composed picture. Fails when sizes differ or a shift is not finite.
    pub fn compose(&self, left: &Rgb, right: &Rgb) -> Result<Rgb, StereoError> {
        if left.size() != right.size() {
            return Err(StereoError::SizesDiffer {
                left: left.size(),
                right: right.size(),
            });
        }
        let left = shifted(left, self.shift_px[0])?;
        let right = shifted(right, self.shift_px[1])?;
        Ok(match self.layout {
            Layout::SideBySide => side_by_side(&left, &right),
            Layout::HalfSideBySide => side_by_side(&half_width(&left), &half_width(&right)),
            Layout::Anaglyph(kind) => anaglyph(kind, &left, &right),
        })
    }
}

/// The picture moved to the right by `shift_px` (parts of a pixel linearly interpolated), black where nothing was.
pub fn shifted(picture: &Rgb, shift_px: f64) -> Result<Rgb, StereoError> {
    if !shift_px.is_finite() {
        return Err(StereoError::OutOfRange {
            what: "a picture's shift",
            value: shift_px,
            needed: "finite (px)",
        });
    }
    let (w, h) = picture.size();
    let whole = shift_px.floor();
    let part = (shift_px - whole) as f32;
    // Beyond the width all is black; the bound also keeps the conversion exact.
    let whole = whole.clamp(-(w as f64) - 2.0, w as f64 + 2.0) as isize;
    let mut out = Rgb::filled(w, h, [0; 3]);
    for y in 0..h {
        let source = picture.row(y);
        let at = |x: isize| -> [f32; 3] {
            match usize::try_from(x) {
                Ok(x) if x < w => source[x].map(f32::from),
                _ => [0.0; 3],
            }
        };
        for (x, px) in out.row_mut(y).iter_mut().enumerate() {
            let x = x as isize - whole;
            let (near, before) = (at(x), at(x - 1));
            *px = std::array::from_fn(|c| (near[c] + part * (before[c] - near[c]) + 0.5) as u8);
        }
    }
    Ok(out)
}

fn side_by_side(left: &Rgb, right: &Rgb) -> Rgb {
    let (w, h) = left.size();
    let mut out = Rgb::filled(2 * w, h, [0; 3]);
    for y in 0..h {
        let row = out.row_mut(y);
        row[..w].copy_from_slice(left.row(y));
        row[w..].copy_from_slice(right.row(y));
    }
    out
}

fn half_width(picture: &Rgb) -> Rgb {
    Rgb::from_fn(picture.width() / 2, picture.height(), |x, y| {
        let (a, b) = (picture.at(2 * x, y), picture.at(2 * x + 1, y));
        std::array::from_fn(|c| (u16::from(a[c]) + u16::from(b[c])).div_ceil(2) as u8)
    })
}

/// Rows: red, green, blue of the anaglyph; columns: red, green, blue of the left, then of the right picture. Each row
/// sums to one, so white stays white.
const DUBOIS: [[f32; 6]; 3] = [
    [
        0.456_100,
        0.500_484,
        0.176_381,
        -0.043_470_6,
        -0.087_938_8,
        -0.001_555_29,
    ],
    [
        -0.040_082_2,
        -0.037_824_6,
        -0.015_758_9,
        0.378_476,
        0.733_64,
        -0.018_450_3,
    ],
    [
        -0.015_216_1,
        -0.020_597_1,
        -0.005_468_56,
        -0.072_152_7,
        -0.112_961,
        1.226_4,
    ],
];

fn anaglyph(kind: Anaglyph, left: &Rgb, right: &Rgb) -> Rgb {
    let (w, h) = left.size();
    match kind {
        Anaglyph::Dubois => dubois(left, right),
        Anaglyph::Color => Rgb::from_fn(w, h, |x, y| {
            let r = right.at(x, y);
            [left.at(x, y)[0], r[1], r[2]]
        }),
        Anaglyph::Gray => {
            let (l, r) = (luma_from_rgb(left), luma_from_rgb(right));
            Rgb::from_fn(w, h, |x, y| [l.at(x, y), r.at(x, y), r.at(x, y)])
        }
        Anaglyph::HalfColor => {
            let l = luma_from_rgb(left);
            Rgb::from_fn(w, h, |x, y| {
                let r = right.at(x, y);
                [l.at(x, y), r[1], r[2]]
            })
        }
    }
}

fn dubois(left: &Rgb, right: &Rgb) -> Rgb {
    let linear: [f32; 256] = std::array::from_fn(|v| linear_from_srgb(v as f32 / 255.0));
    // 4096 steps of linear light: within one code of the exact curve but for the darkest few.
    let coded: Vec<u8> = (0..=4096)
        .map(|i| (255.0 * srgb_from_linear(i as f32 / 4096.0) + 0.5) as u8)
        .collect();
    let mut out = Rgb::filled(left.width(), left.height(), [0; 3]);
    let pairs = left.samples().iter().zip(right.samples());
    for (px, (l, r)) in out.samples_mut().iter_mut().zip(pairs) {
        let both = [l[0], l[1], l[2], r[0], r[1], r[2]].map(|v| linear[usize::from(v)]);
        *px = DUBOIS.map(|row| {
            let sum: f32 = row.iter().zip(both).map(|(m, v)| m * v).sum();
            coded[(sum.clamp(0.0, 1.0) * 4096.0 + 0.5) as usize]
        });
    }
    out
}

/// IEC 61966-2-1.
fn linear_from_srgb(v: f32) -> f32 {
    if v <= 0.040_45 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// IEC 61966-2-1.
fn srgb_from_linear(v: f32) -> f32 {
    if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    //! Proves: layouts place every pixel where they say, shifts move by the stated amount and sign, anaglyphs keep grey
    //! and white and give each eye its own picture. Does not prove that the glasses at hand are Dubois' glasses.
    use super::*;

    fn ramp() -> Rgb {
        Rgb::from_fn(12, 3, |x, y| [10 * x as u8, 20 * y as u8, 7])
    }

    /// A whole shift moves pixels right for +, left for -, and leaves black; half a pixel averages neighbours.
    #[test]
    fn shift_has_its_sign_and_its_amount() {
        let p = ramp();
        for (shift, from) in [(2.0, -2_isize), (-3.0, 3), (0.0, 0), (1e9, 13), (-1e9, -13)] {
            let moved = shifted(&p, shift).unwrap();
            for x in 0..12 {
                let source = x as isize + from;
                let want = if (0..12).contains(&source) {
                    p.at(source as usize, 1)
                } else {
                    [0; 3]
                };
                assert_eq!(moved.at(x, 1), want, "shift {shift} at {x}");
            }
        }
        assert_eq!(shifted(&p, 0.5).unwrap().at(5, 0)[0], 45);
        assert_eq!(shifted(&p, -0.5).unwrap().at(5, 0)[0], 55);
        assert!(shifted(&p, f64::NAN).is_err());
    }

    /// The shifts for a disparity bring a mark at u_l and u_r = u_l - d together.
    #[test]
    fn shift_to_zero_takes_the_disparity_away() {
        let mark = |at: usize| Rgb::from_fn(30, 1, |x, _| [if x == at { 200 } else { 0 }; 3]);
        let shift_px = Composition::shift_to_zero(6.0);
        let both = Composition {
            layout: Layout::SideBySide,
            shift_px,
        }
        .compose(&mark(18), &mark(12))
        .unwrap();
        assert_eq!((both.at(15, 0)[0], both.at(30 + 15, 0)[0]), (200, 200));
    }

    /// Side by side holds both pictures; at half width each column is the mean of two.
    #[test]
    fn side_by_side_holds_both() {
        let (l, r) = (ramp(), Rgb::filled(12, 3, [1, 2, 3]));
        let compose = |layout| {
            Composition {
                layout,
                shift_px: [0.0; 2],
            }
            .compose(&l, &r)
            .unwrap()
        };
        let full = compose(Layout::SideBySide);
        assert_eq!(full.size(), (24, 3));
        assert_eq!((full.at(4, 2), full.at(13, 2)), (l.at(4, 2), [1, 2, 3]));
        let half = compose(Layout::HalfSideBySide);
        assert_eq!(half.size(), (12, 3));
        assert_eq!((half.at(2, 1), half.at(7, 1)), ([45, 20, 7], [1, 2, 3]));
        let other = Rgb::filled(11, 3, [0; 3]);
        let refused = Composition {
            layout: Layout::SideBySide,
            shift_px: [0.0; 2],
        }
        .compose(&l, &other);
        assert!(matches!(refused, Err(StereoError::SizesDiffer { .. })));
    }

    /// Every anaglyph of two equal grey pictures is that grey picture (Dubois: within 2 codes of 255).
    #[test]
    fn grey_stays_grey_in_every_anaglyph() {
        let grey = Rgb::from_fn(256, 1, |x, _| [x as u8; 3]);
        for kind in [
            Anaglyph::Dubois,
            Anaglyph::Gray,
            Anaglyph::Color,
            Anaglyph::HalfColor,
        ] {
            let out = anaglyph(kind, &grey, &grey);
            for (a, b) in out
                .samples()
                .as_flattened()
                .iter()
                .zip(grey.samples().as_flattened())
            {
                assert!(a.abs_diff(*b) <= 2, "{kind:?}: {a} for {b}");
            }
        }
    }

    /// Red comes from the left picture and cyan from the right one: white against black and the reverse.
    #[test]
    fn each_eye_gets_its_own_picture() {
        let (white, black) = (Rgb::filled(1, 1, [255; 3]), Rgb::filled(1, 1, [0; 3]));
        for kind in [Anaglyph::Gray, Anaglyph::Color, Anaglyph::HalfColor] {
            assert_eq!(anaglyph(kind, &white, &black).at(0, 0), [255, 0, 0]);
            assert_eq!(anaglyph(kind, &black, &white).at(0, 0), [0, 255, 255]);
        }
        // Dubois: rows of the matrix summed over one eye, 1.133 and below zero, clamped.
        assert_eq!(dubois(&white, &black).at(0, 0), [255, 0, 0]);
        assert_eq!(dubois(&black, &white).at(0, 0), [0, 255, 255]);
    }

    /// Dubois' published matrix keeps white: each row sums to one within its printed digits.
    #[test]
    fn dubois_rows_sum_to_one() {
        for row in DUBOIS {
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 2e-5);
        }
    }
}
