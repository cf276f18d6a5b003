//! Proves what `vergence rectify` writes, says and refuses, on a small pair of its own. That rows agree is proved in `stereo`.

use crate::common::Place;
use vergence_imaging::{Rgb, files};

/// Two cameras 70 mm apart, converging, the right one rolled a little; the right one's x position is `right_x`.
fn calibration(right_x: f64) -> String {
    let camera = |name: &str, x: f64, yaw: f64, roll: f64| {
        let ((s, c), (sr, cr)) = (yaw.sin_cos(), roll.sin_cos());
        format!(
            "[{name}]\nname = \"{name}\"\nwidth_px = 160\nheight_px = 120\nfx_px = 180.0\nfy_px = 181.0\ncx_px = 79.0\ncy_px = 60.5\n\
             position_m = [{x}, 0.0, 0.0]\nrotation = [[{}, {}, {s}], [{sr}, {cr}, 0.0], [{}, {}, {c}]]\n\
             [{name}.distortion]\nk1 = -0.1\nk2 = 0.02\n",
            c * cr,
            -c * sr,
            -s * cr,
            s * sr,
        )
    };
    format!(
        "format = \"vergence-rig\"\nversion = 1\n{}{}",
        camera("left", -0.035, 0.03, 0.0),
        camera("right", right_x, -0.02, 0.015)
    )
}

fn picture(place: &Place, name: &str, width: usize) {
    let path = place.path().join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let picture = Rgb::from_fn(width, width * 3 / 4, |x, y| {
        [
            (x + 60) as u8,
            (y + 60) as u8,
            ((x / 8 + y / 8) % 2 * 100 + 80) as u8,
        ]
    });
    files::write_rgb(&path, &picture).unwrap();
}

fn pair() -> Place {
    let place = Place::new();
    place.file("rig.toml", &calibration(0.035));
    for name in [
        "l/a_left.png",
        "r/a_right.png",
        "l/b_left.jpg",
        "r/b_right.jpg",
    ] {
        picture(&place, name, 160);
    }
    place
}

const FOLDERS: [&str; 7] = [
    "rectify",
    "--left",
    "l",
    "--right",
    "r",
    "--calibration",
    "rig.toml",
];

/// Folders in, a whole folder out: pictures under their names, masks, the overlay, both descriptions; no pixel black.
#[test]
fn two_folders_become_one() {
    let place = pair();
    let done = place.run(
        &[
            &FOLDERS[..],
            &["--masks", "--out", "out", "--format", "json"],
        ]
        .concat(),
    );
    assert_eq!(done.code, 0, "{done:?}");
    assert!(done.err.contains("wrote out"), "{done:?}");
    let told: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    let out = place.path().join("out");
    let written = std::fs::read_to_string(out.join("rectified.json")).unwrap();
    assert_eq!(
        told,
        serde_json::from_str::<serde_json::Value>(&written).unwrap()
    );
    for name in [
        "left/a_left",
        "left/b_left",
        "right/a_right",
        "right/b_right",
        "rows",
    ] {
        let made = files::read_rgb(&out.join(format!("{name}.png"))).unwrap();
        assert_eq!(made.height(), 120);
        assert_eq!(made.width(), if name == "rows" { 328 } else { 160 });
        let black = made.samples().iter().filter(|px| **px == [0; 3]).count();
        assert_eq!(black, 0, "{name}");
    }
    for side in ["left", "right"] {
        let mask = files::read_gray(&out.join(format!("mask_{side}.png"))).unwrap();
        assert!(mask.samples().iter().all(|v| *v == 255));
    }
    assert_eq!(told["width"], 160);
    assert_eq!(told["doffs_px"], 0.0);
    assert!((told["baseline_m"].as_f64().unwrap() - 0.07).abs() < 1e-12);
    assert!(told["zero_disparity_m"].is_null());
    assert_eq!(told["cameras"][0]["valid_fraction"], 1.0);
    assert_eq!(told["pairs"].as_array().unwrap().len(), 2);
    assert_eq!(told["pairs"][1]["right_rectified"], "right/b_right.png");
    // The result is itself a rectified pair with a calibration: rectifying it again turns nothing.
    let again = place.run(&[
        "rectify",
        "--left",
        "out/left",
        "--right",
        "out/right",
        "--calibration",
        "out/rectified.toml",
        "--fov",
        "keep",
        "--out",
        "again",
        "--format",
        "json",
    ]);
    let again: serde_json::Value = serde_json::from_str(&again.out).unwrap();
    for i in 0..2 {
        assert!(again["cameras"][i]["turn_deg"].as_f64().unwrap() < 1e-6);
        let focal = again["focal_px"].as_f64().unwrap();
        assert!((focal / told["focal_px"].as_f64().unwrap() - 1.0).abs() < 1e-9);
    }
}

/// Another size, the whole field and a convergence distance: the figures fit each other, and black parts are told.
#[test]
fn choices_are_followed() {
    let place = pair();
    let done = place.run(&[
        "rectify",
        "--left",
        "l/a_left.png",
        "--right",
        "r/a_right.png",
        "--calibration",
        "rig.toml",
        "--size",
        "200x150",
        "--fov",
        "all",
        "--convergence",
        "2m",
        "--kernel",
        "lanczos3",
        "--out",
        "out",
        "--format",
        "json",
    ]);
    let told: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    let number = |name: &str| told[name].as_f64().unwrap();
    let doffs = number("focal_px") * number("baseline_m") / 2.0;
    assert!((number("doffs_px") - doffs).abs() < 1e-9);
    assert!((number("zero_disparity_m") - 2.0).abs() < 1e-9);
    assert_eq!([number("width"), number("height")], [200.0, 150.0]);
    let valid = told["cameras"][1]["valid_fraction"].as_f64().unwrap();
    assert!((0.5..0.999).contains(&valid), "{valid}");
    assert_eq!(told["kernel"], "lanczos3");
}

/// Each call that cannot be answered says what is wrong and leaves nothing behind.
#[test]
fn bad_calls_are_refused_and_leave_nothing() {
    let place = pair();
    picture(&place, "r/c_right.png", 160);
    picture(&place, "big_right.png", 320);
    place.file("exchanged.toml", &calibration(-0.2));
    std::fs::create_dir(place.path().join("full")).unwrap();
    place.file("full/note.txt", "kept");
    let one = ["--left", "l/a_left.png", "--right", "r/a_right.png"];
    let rig = ["--calibration", "rig.toml"];
    let out = ["--out", "out"];
    let cases: [(&[&[&str]], &str); 11] = [
        (
            &[&["--left", "l", "--right", "r"], &rig, &out],
            "c_right.png has no partner",
        ),
        (
            &[
                &[
                    "--left",
                    "l/a_left.png",
                    "l/b_left.jpg",
                    "--right",
                    "r/a_right.png",
                ],
                &rig,
                &out,
            ],
            "2 left and 1 right",
        ),
        (
            &[
                &["--left", "l/a_left.png", "--right", "l/a_left.png"],
                &rig,
                &out,
            ],
            "both eyes",
        ),
        (
            &[
                &["--left", "l/x.png", "--right", "r/a_right.png"],
                &rig,
                &out,
            ],
            "no such file: l/x.png",
        ),
        (
            &[
                &[
                    "--left",
                    "l/a_left.png",
                    "l/b_left.jpg",
                    "--right",
                    "r/a_right.png",
                    "big_right.png",
                ],
                &rig,
                &out,
            ],
            "differ in size",
        ),
        (
            &[&one, &["--calibration", "exchanged.toml"], &out],
            "exchange left and right",
        ),
        (&[&one, &["--calibration", "none.toml"], &out], "none.toml"),
        (&[&one, &rig, &out, &["--size", "200"]], "--size '200'"),
        (
            &[&one, &rig, &out, &["--convergence", "near"]],
            "--convergence 'near'",
        ),
        (
            &[&one, &rig, &out, &["--convergence", "-2m"]],
            "convergence distance is -2",
        ),
        (&[&one, &rig, &["--out", "full"]], "full is there already"),
    ];
    for (parts, wanted) in cases {
        let err = place
            .run(&[&["rectify"], &parts.concat()[..]].concat())
            .refused(2);
        assert!(err.contains(wanted), "{wanted}: {err}");
        for name in ["out", "out.part", "full.part"] {
            assert!(!place.path().join(name).exists(), "{wanted}: {name}");
        }
    }
    // A picture that turns out broken in the middle of the work: nothing half-written either.
    let broken = place.path().join("l/b_left.jpg");
    let bytes = std::fs::read(&broken).unwrap();
    std::fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
    std::fs::remove_file(place.path().join("r/c_right.png")).unwrap();
    let done = place.run(&[&FOLDERS[..], &["--out", "out"]].concat());
    assert_eq!(done.code, 2, "{done:?}");
    assert!(done.err.contains("b_left.jpg"), "{done:?}");
    assert!(!place.path().join("out").exists() && !place.path().join("out.part").exists());
}
