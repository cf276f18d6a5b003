//! `vergence depth` from end to end on a made pair. Proves that the folder holds what the reference says, with the right signs and units; that
//! JSON has its fields; and that whatever is refused leaves no file behind. How good the disparities are is proved in their crate.

use crate::common::Place;
use vergence_imaging::Gray;
use vergence_imaging::files::{read_rgb, write_gray};
use vergence_imaging::pfm::read_pfm;

const SIZE: (usize, usize) = (240, 120);
const FAR: i64 = 6;
const NEAR: i64 = 20;

/// A grain that is the same for the same place of a surface.
fn grain(u: i64, v: i64, surface: u32) -> u8 {
    let cell = |u: i64, v: i64| {
        let mut h = (u as u32).wrapping_mul(0x9e37_79b1) ^ (v as u32).wrapping_mul(0x85eb_ca6b);
        h = (h ^ surface ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
        h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
        (h >> 17) & 0x7f
    };
    (cell(u, v) + cell(u.div_euclid(3), v.div_euclid(3))) as u8
}

/// A board of disparity 20 before a wall of disparity 6, both told by columns of the left picture.
fn write_pair(place: &Place) {
    let board = |u: i64, y: i64| (100..170).contains(&u) && (25..95).contains(&y);
    let pictures = [("left.png", 0, 0), ("right.png", NEAR, FAR)];
    for (name, near, far) in pictures {
        let picture = Gray::from_fn(SIZE.0, SIZE.1, |x, y| {
            let (x, y) = (x as i64, y as i64);
            if board(x + near, y) {
                grain(x + near, y, 7)
            } else {
                grain(x + far, y, 99)
            }
        });
        write_gray(&place.path().join(name), &picture).expect("a picture");
    }
}

const CALL: [&str; 7] = [
    "depth",
    "--left",
    "left.png",
    "--right",
    "right.png",
    "--rectified",
    "--out",
];

fn call<'a>(more: &[&'a str]) -> Vec<&'a str> {
    CALL.iter().copied().chain(more.iter().copied()).collect()
}

/// Nothing but the two pictures is there.
fn nothing_written(place: &Place) {
    let count = std::fs::read_dir(place.path()).expect("the folder").count();
    assert_eq!(count, 2);
}

/// Disparities with their sign, NaN where asked, the 16-bit picture, metres, the cloud, and the fields of the answer.
#[test]
fn files_and_fields() {
    let place = Place::new();
    write_pair(&place);
    let metric = [
        "out",
        "--focal-px",
        "600",
        "--baseline-m",
        "10cm",
        "--fill",
        "all",
        "--format",
        "json",
    ];
    let answer = place.run(&call(&metric)).json();
    assert_eq!(
        (answer["width"].as_u64(), answer["height"].as_u64()),
        (Some(240), Some(120))
    );
    assert!(answer["ms"].as_f64().expect("ms") > 0.0);
    assert!(answer["valid_fraction"].as_f64() > Some(0.97));
    let seen = answer["seen_fraction"].as_f64().expect("a share");
    assert!(seen > 0.7 && seen < 0.99, "{seen}");
    let out = place.path().join("out");
    let disparity = read_pfm(&out.join("disparity.pfm")).expect("a PFM file");
    assert_eq!(disparity.size(), SIZE);
    assert!((disparity.at(135, 60) - NEAR as f32).abs() < 0.2);
    assert!((disparity.at(60, 60) - FAR as f32).abs() < 0.2);
    // Hidden beside the board: filled with the wall.
    assert!((disparity.at(93, 60) - FAR as f32).abs() < 1.0);
    let depth = read_pfm(&out.join("depth.pfm")).expect("a PFM file");
    assert!(
        (depth.at(135, 60) - 3.0).abs() < 0.05,
        "600 px x 0.1 m / 20 px"
    );
    let steps = image_16(&out.join("disparity.png"));
    assert!((i64::from(steps[60 * SIZE.0 + 135]) - 256 * NEAR).abs() < 60);
    let view = read_rgb(&out.join("view.png")).expect("a picture");
    assert!(view.width() > SIZE.0 && view.height() >= SIZE.1);
    let ply = std::fs::read(out.join("cloud.ply")).expect("a cloud");
    let points = answer["points"].as_u64().expect("points") as usize;
    let end = b"end_header\n";
    let header = ply
        .windows(end.len())
        .position(|w| w == end)
        .expect("a header")
        + end.len();
    assert_eq!(ply.len() - header, 19 * points);
    let listed = answer["files"].as_array().expect("files").len();
    assert_eq!(std::fs::read_dir(&out).expect("the folder").count(), listed);
    assert_eq!(
        std::fs::read_dir(place.path()).expect("the folder").count(),
        3
    );
    // A second call replaces the first; without filling there are gaps.
    let none = ["out", "--fill", "none", "--format", "json"];
    let answer = place.run(&call(&none)).json();
    assert!(answer["valid_fraction"].as_f64() < Some(0.99));
    assert!(answer["depth_m"].is_null() && !out.join("depth.pfm").exists());
    let disparity = read_pfm(&out.join("disparity.pfm")).expect("a PFM file");
    assert!(disparity.at(93, 60).is_nan());
}

/// 16-bit samples of a PNG file, by the bytes of the format itself would be much; the size alone tells that they are 16-bit.
fn image_16(path: &std::path::Path) -> Vec<u16> {
    let picture = vergence_imaging::files::read_gray16(path).expect("a picture");
    picture.samples().to_vec()
}

/// A region has its own size and says where it lies; text output is for people.
#[test]
fn a_region() {
    let place = Place::new();
    write_pair(&place);
    let text = place.run(&call(&["out", "--region", "90,20,60,40"])).good();
    assert!(text.starts_with("60 x 40 pixels, disparities "), "{text}");
    let disparity = read_pfm(&place.path().join("out/disparity.pfm")).expect("a PFM file");
    assert_eq!(disparity.size(), (60, 40));
    assert!((disparity.at(45, 30) - NEAR as f32).abs() < 0.3);
}

/// Whatever cannot be answered is refused with the remedy, and leaves nothing behind.
#[test]
fn refusals() {
    let place = Place::new();
    write_pair(&place);
    for (more, words) in [
        (
            &["out", "--min-disparity", "0", "--max-disparity", "240"][..],
            "240 px wide",
        ),
        (
            &["out", "--min-disparity", "9", "--max-disparity", "3"],
            "must not exceed",
        ),
        (
            &["out", "--region", "200,0,60,40"],
            "does not lie in the picture",
        ),
        (
            &["out", "--focal-px", "0", "--baseline-m", "1"],
            "must be above 0",
        ),
        (
            &["out", "--focal-px", "600", "--baseline-m", "-1m"],
            "must be above 0",
        ),
    ] {
        let error = place.run(&call(more)).refused(2);
        assert!(error.contains(words), "{error} for {words}");
        nothing_written(&place);
    }
    let swapped = [
        "depth",
        "--left",
        "right.png",
        "--right",
        "left.png",
        "--rectified",
        "--out",
        "out",
    ];
    let metric = ["--focal-px", "600", "--baseline-m", "10cm"];
    let error = place.run(&[&swapped[..], &metric[..]].concat()).refused(2);
    assert!(
        error.contains("left and right seem to be exchanged"),
        "{error}"
    );
    assert!(
        error.contains("hint: exchange --left and --right"),
        "{error}"
    );
    nothing_written(&place);
    write_gray(&place.path().join("left.png"), &Gray::filled(100, 80, 9)).expect("a picture");
    let error = place.run(&call(&["out"])).refused(2);
    assert!(error.contains("both must have one size"), "{error}");
    nothing_written(&place);
    let error = place.run(&[
        "depth",
        "--left",
        "left.png",
        "--right",
        "right.png",
        "--out",
        "out",
    ]);
    assert_eq!(error.code, 2);
}

/// A folder with other things in it is not replaced, and told before any work is done.
#[test]
fn folders_of_others_stay() {
    let place = Place::new();
    write_pair(&place);
    std::fs::create_dir(place.path().join("out")).expect("a folder");
    place.file("out/notes.txt", "mine");
    let error = place.run(&call(&["out"])).refused(2);
    assert!(
        error.contains("it holds other files (notes.txt)"),
        "{error}"
    );
    assert!(place.path().join("out/notes.txt").exists());
}
