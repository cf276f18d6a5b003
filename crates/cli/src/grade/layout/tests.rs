//! Proves that packed pairs are recognised by what they show and single pictures are not, and that halves are cut and stretched to the
//! pixel. Real files are in the tests of the program.

use super::*;

/// Overlapping discs of many sizes (dead leaves) from a seed: it looks like nature to a matcher.
fn leaves(w: usize, h: usize, seed: u32) -> Rgb {
    let mut state = seed;
    let mut draw = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1_u32 << 24)
    };
    let mut picture = Rgb::filled(w, h, [128; 3]);
    for _ in 0..3000 {
        let radius = 3.0 / (1.0 - 0.95 * draw()).sqrt();
        let (x, y) = (draw() * w as f64, draw() * h as f64);
        let colour = [draw(), draw(), draw()].map(|c| (255.0 * c) as u8);
        let (x0, x1) = (
            (x - radius).max(0.0) as usize,
            ((x + radius) as usize).min(w - 1),
        );
        let (y0, y1) = (
            (y - radius).max(0.0) as usize,
            ((y + radius) as usize).min(h - 1),
        );
        for v in y0..=y1 {
            for u in x0..=x1 {
                if (u as f64 - x).hypot(v as f64 - y) <= radius {
                    picture.set(u, v, colour);
                }
            }
        }
    }
    picture
}

/// Two views of one scene, the second moved by so many pixels.
fn views(w: usize, h: usize, shift: usize) -> [Rgb; 2] {
    let wide = leaves(w + shift, h, 5);
    [0, shift].map(|from| Rgb::from_fn(w, h, |x, y| wide.at(x + from, y)))
}

fn packed([a, b]: &[Rgb; 2], halves: Halves) -> Rgb {
    let (w, h) = a.size();
    match halves {
        Halves::SideBySide => {
            Rgb::from_fn(
                2 * w,
                h,
                |x, y| if x < w { a.at(x, y) } else { b.at(x - w, y) },
            )
        }
        Halves::OverUnder => {
            Rgb::from_fn(
                w,
                2 * h,
                |x, y| if y < h { a.at(x, y) } else { b.at(x, y - h) },
            )
        }
    }
}

fn found(picture: &Rgb, name: &str) -> &'static str {
    let layout = of_picture(picture, Path::new(name), None, LayoutChoice::Auto).unwrap();
    super::name(layout.packing)
}

/// Full and squeezed, beside and above each other; a name can turn the order round, and cannot make a pair of one picture.
#[test]
fn packed_pairs_are_recognised() {
    let full = views(320, 240, 12);
    let beside = packed(&full, Halves::SideBySide);
    assert_eq!(found(&beside, "x.png"), "side-by-side");
    assert_eq!(found(&beside, "x_rl.png"), "cross-eyed");
    assert_eq!(found(&beside, "x.jps"), "cross-eyed");
    assert_eq!(
        found(&packed(&full, Halves::OverUnder), "x.png"),
        "over-under"
    );
    let narrow = views(160, 240, 6);
    assert_eq!(
        found(&packed(&narrow, Halves::SideBySide), "x.png"),
        "half-side-by-side"
    );
    let flat = views(400, 120, 6);
    assert_eq!(
        found(&packed(&flat, Halves::OverUnder), "x.png"),
        "half-over-under"
    );
    for name in ["x.png", "x_sbs.png"] {
        assert_eq!(found(&leaves(640, 240, 9), name), "mono", "{name}");
    }
    assert_eq!(found(&Rgb::filled(640, 240, [90; 3]), "x.png"), "mono");
    assert_eq!(found(&leaves(40, 30, 9), "x.png"), "mono");
}

/// What a tag says counts before all else but the flag.
#[test]
fn tags_and_flags_count_first() {
    let one = leaves(640, 240, 9);
    let tag = |tag| Found { tag, place: "test" };
    let layout = |tag, choice| of_picture(&one, Path::new("x.png"), tag, choice);
    let packing = LayoutChoice::CrossEyed.packing().unwrap().unwrap();
    let crossed = tag(StereoTag::Packed(packing));
    assert_eq!(
        layout(Some(&crossed), LayoutChoice::Auto).unwrap().packing,
        Some(packing)
    );
    assert_eq!(
        layout(Some(&crossed), LayoutChoice::Mono).unwrap().packing,
        None
    );
    let error = layout(Some(&tag(StereoTag::NotRead("rows"))), LayoutChoice::Auto).unwrap_err();
    assert!(error.contains("--layout mono"), "{error}");
}

/// Halves come back to the pixel, in the order of the eyes; a gap belongs to neither; squeezed ones get twice the pixels, with the old
/// ones' mean where two meet.
#[test]
fn halves_are_cut_to_the_pixel() {
    let eyes = views(64, 48, 4);
    for halves in [Halves::SideBySide, Halves::OverUnder] {
        for (order, first) in [(Order::LeftFirst, 0), (Order::RightFirst, 1)] {
            let packing = Packing {
                halves,
                order,
                squeezed: false,
                gap_px: 0,
            };
            let got = unpacked(&packed(&eyes, halves), packing).unwrap();
            assert_eq!(got[first], eyes[0]);
            assert_eq!(got[1 - first], eyes[1]);
        }
    }
    let row = Rgb::from_samples(6, 1, [10, 30, 99, 99, 50, 90].map(|v| [v; 3]).to_vec());
    let packing = Packing {
        halves: Halves::SideBySide,
        order: Order::LeftFirst,
        squeezed: true,
        gap_px: 2,
    };
    let [left, right] = unpacked(&row, packing).unwrap();
    assert_eq!(left.samples(), [10, 15, 25, 30].map(|v| [v; 3]));
    assert_eq!(right.samples(), [50, 60, 80, 90].map(|v| [v; 3]));
    assert!(unpacked(&Rgb::filled(1, 5, [0; 3]), packing).is_err());
}
