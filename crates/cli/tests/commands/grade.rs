//! `vergence grade` end to end: what goes in, what comes out, what the exit code says. Scores here are those of a toy model; that features
//! and the LIVE model's scores are right is shown on golden values, the latter where the shared folder is at hand. How well faults of a
//! pair are measured is shown in the crate `stereo`; here it is shown that they arrive.

use std::process::Stdio;

use crate::grading::{
    Place, beside, drawn_leaves, fields, jpeg, leaves, mpo, number, pair, shared, with_segment,
};
use serde_json::Value;
use vergence_imaging::Rgb;

#[test]
fn one_picture_has_a_score_a_scale_and_a_meaning() {
    let place = Place::new();
    let file = leaves("leaves_a_ref.png");
    let done = place.grade(&[file.to_str().unwrap()]);
    assert_eq!((done.code, done.err.as_str()), (0, ""), "{done:?}");
    for part in [
        "one picture of 256 x 192 px",
        "0 best … 100 worst; DIIVINE, model toy",
        "the picture ",
        "Gaussian blur",
    ] {
        assert!(done.out.contains(part), "{part}\n{}", done.out);
    }
    let json = place.json(&[file.to_str().unwrap(), "--features"]);
    assert_eq!(json["kind"], "picture");
    assert_eq!(json["model"], "toy");
    let probabilities = json["class_probabilities"].as_object().unwrap();
    let sum: f64 = probabilities.values().map(|p| p.as_f64().unwrap()).sum();
    assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    let weighted: f64 = ["jp2k", "jpeg", "wn", "blur", "ff"]
        .iter()
        .map(|c| {
            number(&json, &format!("/class_probabilities/{c}"))
                * number(&json, &format!("/regression_scores/{c}"))
        })
        .sum();
    assert!((weighted - number(&json, "/score")).abs() < 1e-9);
    // The features are those of the release, by the golden values of this picture.
    let golden = std::fs::read_to_string(leaves("golden.json")).unwrap();
    let golden: Value = serde_json::from_str(&golden).unwrap();
    let golden = golden["images"].as_array().unwrap();
    let golden = golden
        .iter()
        .find(|g| g["file"] == "leaves_a_ref.png")
        .unwrap();
    for (i, expected) in golden["features"].as_array().unwrap().iter().enumerate() {
        let (expected, found) = (
            expected.as_f64().unwrap(),
            number(&json, &format!("/features/{i}")),
        );
        assert!(
            (found - expected).abs() <= 1e-8 * expected.abs().max(1e-1),
            "f{}",
            i + 1
        );
    }
}

/// With the model of the release the scores of all golden pictures come out of the program.
#[test]
fn scores_of_the_live_model_are_the_golden_ones() {
    let Some(data) = shared("diivine") else {
        return;
    };
    let place = Place::new();
    let model = data.join("data_live_trained.mat");
    let done = place.run(&["model", "import", model.to_str().unwrap(), "--name", "live"]);
    assert_eq!(done.code, 0, "{done:?}");
    for folder in [data.clone(), data.join("own")] {
        let golden = std::fs::read_to_string(folder.join("golden.json")).unwrap();
        let golden: Value = serde_json::from_str(&golden).unwrap();
        let folder = folder.to_str().unwrap();
        let done = place.run(&["grade", folder, "--model", "live", "--format", "jsonl"]);
        assert_eq!(done.code, 0, "{done:?}");
        let found = done.lines();
        let images = golden["images"].as_array().unwrap();
        assert_eq!(found.len(), images.len());
        for expected in images {
            let name = expected["file"].as_str().unwrap();
            let found = found
                .iter()
                .find(|f| f["item"].as_str().unwrap().ends_with(name))
                .unwrap();
            let error = (number(found, "/score") - number(expected, "/score")).abs();
            assert!(error < 1e-6, "{name}: {error:e}");
        }
    }
}

/// A pair whose left picture lies 3 px lower: the offset, its verdict and the parallax of both depths arrive, in every way to give a pair.
#[test]
fn a_pair_is_measured_however_it_is_packed() {
    let place = Place::new();
    let [left, right] = pair(480, 360, 6, 8, 3);
    let [l, r] = [
        place.picture("a_l.png", &left),
        place.picture("a_r.png", &right),
    ];
    let sides = [
        "--left",
        l.to_str().unwrap(),
        "--right",
        r.to_str().unwrap(),
    ];
    let reference = place.json(&sides);
    assert_eq!(reference["layout"]["name"], "two-files");
    let offset = number(&reference, "/vertical/offset_px");
    assert!((offset - 3.0).abs() < 0.1, "{offset}");
    let near = number(&reference, "/parallax/near/disparity_px");
    let far = number(&reference, "/parallax/far/disparity_px");
    assert!(
        (near - 6.0).abs() < 1.0 && (far + 8.0).abs() < 1.0,
        "{near} {far}"
    );
    assert_eq!(
        reference["swapped"],
        Value::Bool(false),
        "{}",
        reference["swap"]
    );
    let verdicts = reference["verdicts"].as_array().unwrap();
    assert!(
        verdicts.iter().any(|v| v["cause"] == "vertical_offset"),
        "{verdicts:?}"
    );
    let worse = ["/left/score", "/right/score"].map(|p| number(&reference, p));
    assert_eq!(number(&reference, "/worse/score"), worse[0].max(worse[1]));

    let same = |json: &Value, layout: &str| {
        assert_eq!(json["layout"]["name"], layout, "{}", json["layout"]);
        for field in [
            "left",
            "right",
            "difference",
            "vertical",
            "parallax",
            "verdicts",
        ] {
            assert_eq!(json[field], reference[field], "{layout} {field}");
        }
    };
    let parallel = place.picture("packed.png", &beside([&left, &right]));
    let parallel = parallel.to_str().unwrap();
    same(&place.json(&[parallel]), "side-by-side");
    let crossed = place.picture("packed_rl.png", &beside([&right, &left]));
    same(&place.json(&[crossed.to_str().unwrap()]), "cross-eyed");
    same(
        &place.json(&[crossed.to_str().unwrap(), "--layout", "cross-eyed"]),
        "cross-eyed",
    );
    let above = Rgb::from_fn(480, 720, |x, y| {
        if y < 360 {
            left.at(x, y)
        } else {
            right.at(x, y - 360)
        }
    });
    let above = place.picture("above.png", &above);
    same(&place.json(&[above.to_str().unwrap()]), "over-under");
    // As one picture it has one score.
    let mono = place.json(&[parallel, "--layout", "mono"]);
    assert_eq!(
        (&mono["kind"], &mono["size_px"][0]),
        (&Value::from("picture"), &Value::from(960))
    );
    // The table names every cause with its verdict and how the eyes were found.
    let table = place.grade(&[parallel]).out;
    for part in [
        "layout: side-by-side (by its content",
        "vertical offset",
        "parallax near",
        "Verdict: ",
    ] {
        assert!(table.contains(part), "{part}\n{table}");
    }
}

/// Eyes exchanged: said so, whatever the file is called.
#[test]
fn swapped_eyes_are_told() {
    let place = Place::new();
    let [left, right] = pair(480, 360, 16, 8, 0);
    let [l, r] = [
        place.picture("x.png", &right),
        place.picture("y.png", &left),
    ];
    let json = place.json(&[
        "--left",
        l.to_str().unwrap(),
        "--right",
        r.to_str().unwrap(),
    ]);
    assert_eq!(json["swapped"], Value::Bool(true), "{}", json["swap"]);
    assert_eq!(json["verdict"], "bad");
}

/// MPO with its views in either order, JPS with and without its descriptor, built byte by byte.
#[test]
fn stereo_files_say_which_eye_is_which() {
    let place = Place::new();
    let eyes = pair(320, 240, 6, 4, 2);
    let jpegs = [jpeg(&place, &eyes[0]), jpeg(&place, &eyes[1])];
    let swapped = [jpegs[1].clone(), jpegs[0].clone()];
    let usual = place.bytes("usual.mpo", &mpo(jpegs, [1, 2]));
    let turned = place.bytes("turned.mpo", &mpo(swapped, [2, 1]));
    let [usual, turned] = [usual, turned].map(|f| place.json(&[f.to_str().unwrap()]));
    assert_eq!(usual["layout"]["name"], "mpo");
    assert_eq!(usual["left"], turned["left"]);
    assert!((number(&usual, "/vertical/offset_px") - 2.0).abs() < 0.2);

    let crossed = jpeg(&place, &beside([&eyes[1], &eyes[0]]));
    let plain = place.bytes("plain.jps", &crossed);
    let json = place.json(&[plain.to_str().unwrap()]);
    assert_eq!(json["layout"]["name"], "cross-eyed", "{}", json["layout"]);
    assert!((number(&json, "/vertical/offset_px") - 2.0).abs() < 0.2);
    // Left field first: the same file would then have its eyes exchanged, and the offset turns round.
    let tagged = with_segment(crossed.clone(), 0xe3, b"_JPSJPS_\0\x04\0\x04\x02\x01\0\0");
    let tagged = place.bytes("tagged.jps", &tagged);
    let json = place.json(&[tagged.to_str().unwrap()]);
    assert_eq!(json["layout"]["name"], "side-by-side", "{}", json["layout"]);
    assert!((number(&json, "/vertical/offset_px") + 2.0).abs() < 0.2);
    let rows = with_segment(crossed, 0xe3, b"_JPSJPS_\0\x04\0\x04\x01\x01\0\0");
    let rows = place.bytes("rows.jps", &rows);
    let error = place.grade(&[rows.to_str().unwrap()]);
    assert!(
        error.refused(2).contains("rows of both eyes interleaved"),
        "{error:?}"
    );
}

/// Real files of cameras, in one call so that all cores work.
#[test]
fn real_stereo_files_are_understood() {
    let Some(folder) = shared("stereo/sbs") else {
        return;
    };
    let place = Place::new();
    let expected = [
        ("frozenpond.mpo", "mpo", [640, 480]),
        ("panasonic_gx8.mpo", "mpo", [1824, 1368]),
        ("stereopi_board1_lr.png", "side-by-side", [320, 240]),
        ("stereopi_drone_lr.png", "side-by-side", [320, 240]),
    ];
    let files = expected.map(|(name, ..)| folder.join(name));
    let mut args: Vec<&str> = files.iter().map(|f| f.to_str().unwrap()).collect();
    args.extend(["--format", "jsonl"]);
    let done = place.grade(&args);
    assert_eq!((done.code, done.err.as_str()), (0, ""), "{done:?}");
    let lines = done.lines();
    assert_eq!(lines.len(), expected.len());
    for ((name, layout, size), json) in expected.into_iter().zip(lines) {
        assert_eq!(json["layout"]["name"], layout, "{name}: {}", json["layout"]);
        assert_eq!(json["size_px"], serde_json::json!(size), "{name}");
        let swap = &json["swap"];
        assert_ne!(json["swapped"], Value::Bool(true), "{name}: {swap}");
    }
}

/// A folder: pairs by name, in order; a bad file is named with its reason, stops nothing and makes the exit code 1.
#[test]
fn one_bad_file_does_not_stop_a_folder() {
    let place = Place::new();
    for (i, name) in ["a.png", "b.png", "d.png"].iter().enumerate() {
        place.picture(&format!("in/{name}"), &drawn_leaves(96, 80, i as u32 + 1));
    }
    let whole = jpeg(&place, &drawn_leaves(96, 80, 9));
    place.bytes("in/c.jpg", &whole[..whole.len() / 2]);
    let eyes = pair(240, 160, 2, 4, 0);
    place.picture("in/e_left.png", &eyes[0]);
    place.picture("in/e_right.png", &eyes[1]);
    place.bytes("in/notes.txt", b"no picture");
    let done = place.grade(&["in", "--format", "jsonl"]);
    assert_eq!(done.code, 1, "{done:?}");
    assert!(
        done.err.contains("failed: in/c.jpg: ")
            && done.err.contains("1 of 5 items could not be graded"),
        "{}",
        done.err
    );
    let kinds: Vec<String> = done
        .lines()
        .iter()
        .map(|r| {
            format!(
                "{} {}",
                r["item"].as_str().unwrap(),
                r["kind"].as_str().unwrap()
            )
        })
        .collect();
    assert_eq!(
        kinds,
        [
            "in/a.png picture",
            "in/b.png picture",
            "in/c.jpg failed",
            "in/d.png picture",
            "in/e_left.png + e_right.png pair",
        ]
    );
    // One document, a table for programs, lines for people: the same items.
    let done = place.grade(&["in", "--format", "json"]);
    let json: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(json["items"].as_array().unwrap().len(), 5);
    assert_eq!(json["summary"]["failed"], 1);
    let csv = place.grade(&["in", "--format", "csv"]).out;
    assert_eq!(csv.lines().count(), 6);
    let columns: Vec<usize> = csv.lines().map(|l| l.split(',').count()).collect();
    assert!(columns.iter().all(|c| *c == columns[0]), "{csv}");
    let text = place.grade(&["in", "--threads", "2"]).out;
    assert!(
        text.contains("5 items: ") && text.contains("1 failed"),
        "{text}"
    );
}

/// A list: paths from its own folder, two with a tab, comments; a line that names nothing is a failed item.
#[test]
fn lists_are_read_line_by_line() {
    let place = Place::new();
    let eyes = pair(240, 160, 2, 4, 0);
    place.picture("lists/l.png", &eyes[0]);
    place.picture("lists/r.png", &eyes[1]);
    place.bytes(
        "lists/all.txt",
        b"# two eyes\nl.png\tr.png\r\n\nl.png\nmissing.png\n",
    );
    let done = place.grade(&["@lists/all.txt", "--format", "jsonl"]);
    assert_eq!(done.code, 1);
    let kinds: Vec<Value> = done.lines().iter().map(|r| r["kind"].clone()).collect();
    assert_eq!(kinds, ["pair", "picture", "failed"]);
    assert!(
        done.err.contains("line 5: there is no such file"),
        "{}",
        done.err
    );
    let same = place.grade(&["--list", "lists/all.txt", "--format", "jsonl"]);
    assert_eq!(same.out, done.out);
}

/// Killed in the middle, a call leaves whole lines; the next one goes on and the file ends as if nothing had happened, with one thread or
/// two.
#[test]
fn a_killed_call_is_gone_on_with() {
    let place = Place::new();
    for i in 0..12 {
        place.picture(&format!("in/{i:02}.png"), &drawn_leaves(200, 160, i + 1));
    }
    let whole = place.grade(&["in", "--out", "whole.jsonl", "--threads", "1"]);
    assert_eq!(whole.code, 0, "{whole:?}");
    let expected = std::fs::read_to_string(place.path("whole.jsonl")).unwrap();
    assert_eq!(expected.lines().count(), 12);

    let mut child = place
        .command(&[
            "grade",
            "--model",
            "toy",
            "in",
            "--out",
            "cut.jsonl",
            "--threads",
            "2",
        ])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let cut = place.path("cut.jsonl");
    let lines = || {
        std::fs::read_to_string(&cut)
            .unwrap_or_default()
            .lines()
            .count()
    };
    while lines() < 3 && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    // As if the kill had come in the middle of a line.
    let mut left = std::fs::read_to_string(&cut).unwrap();
    left += "{\"item\":\"in/0";
    std::fs::write(&cut, &left).unwrap();
    let before = left.lines().count() - 1;
    let again = place.grade(&["in", "--out", "cut.jsonl", "--format", "json"]);
    assert_eq!(again.code, 0, "{again:?}");
    let summary: Value = serde_json::from_str(&again.out).unwrap();
    assert_eq!(summary["summary"]["items"], 12);
    assert_eq!(summary["summary"]["skipped"], before);
    assert_eq!(std::fs::read_to_string(&cut).unwrap(), expected);
    // With other options the results would not go together.
    let other = place.grade(&["in", "--out", "cut.jsonl", "--crosstalk", "5%"]);
    assert!(
        other
            .refused(2)
            .contains("made with another model, other options"),
        "{other:?}"
    );
    assert_eq!(std::fs::read_to_string(&cut).unwrap(), expected);
    // A file that has changed is graded again.
    place.picture("in/03.png", &drawn_leaves(200, 160, 99));
    let changed = place.grade(&["in", "--out", "cut.jsonl", "--format", "json"]);
    let summary: Value = serde_json::from_str(&changed.out).unwrap();
    assert_eq!(summary["summary"]["skipped"], 11);
}

/// A file of results that cannot be opened is a fault of the call: code 2, said before anything is graded, and the folder named.
#[test]
fn results_need_a_folder_that_is_there() {
    let place = Place::new();
    place.picture("leaf.png", &drawn_leaves(96, 80, 3));
    let missing = place.grade(&["leaf.png", "--out", "no/such/r.jsonl"]);
    let told = missing.refused(2);
    assert!(
        told.contains("cannot write no/such/r.jsonl") && told.contains("make the folder no/such"),
        "{told}"
    );
    assert!(!place.path("no").exists());
    let below_a_file = place.grade(&["leaf.png", "--out", "leaf.png/r.jsonl"]);
    below_a_file.refused(2);
    let a_folder = place.grade(&["leaf.png", "--out", "data"]);
    a_folder.refused(2);
}

/// An ordered folder gone on with: what was excused stays excused, a sequence is known by all its pictures, and one of them that changed brings a new
/// account of the whole. A single item that is finished says so.
#[test]
fn an_ordered_folder_is_gone_on_with() {
    let place = Place::new();
    let [left, right] = pair(480, 360, 6, 8, 0);
    place.picture("s/0_l.png", &left);
    place.picture("s/0_r.png", &right);
    // Two leaves with nothing in common cannot be judged as a pair.
    place.picture("s/1_l.png", &drawn_leaves(240, 160, 1));
    place.picture("s/1_r.png", &drawn_leaves(240, 160, 2));
    let args = ["s", "--sequence", "--out", "s.jsonl", "--format", "json"];
    let wholes = || {
        let text = std::fs::read_to_string(place.path("s.jsonl")).unwrap();
        text.matches("\"kind\":\"sequence\"").count()
    };
    let first = place.grade(&args);
    assert_eq!((first.code, wholes()), (0, 1), "{first:?}");
    let again = place.grade(&args);
    assert_eq!((again.code, wholes()), (0, 1), "{again:?}");
    let summary: Value = serde_json::from_str(&again.out).unwrap();
    assert_eq!(summary["summary"]["skipped"], 3);
    place.picture("s/0_r.png", &left);
    let changed = place.grade(&args);
    let summary: Value = serde_json::from_str(&changed.out).unwrap();
    assert_eq!(summary["summary"]["skipped"], 1, "{changed:?}");
    assert_eq!(wholes(), 2);

    place.picture("leaf.png", &drawn_leaves(96, 80, 3));
    let args = ["leaf.png", "--out", "leaf.jsonl"];
    assert_eq!(place.grade(&args).code, 0);
    let again = place.grade(&args);
    assert_eq!((again.code, again.out.as_str()), (0, ""), "{again:?}");
    assert!(
        again.err.contains("finished by an earlier call"),
        "{again:?}"
    );
}

/// `--fail-on` decides about the exit code alone; the results are printed as ever.
#[test]
fn fail_on_is_for_scripts() {
    let place = Place::new();
    let [left, right] = pair(480, 360, 6, 8, 9);
    let packed = place.picture("p_lr.png", &beside([&left, &right]));
    let packed = packed.to_str().unwrap();
    let json = place.json(&[packed]);
    assert_eq!(json["verdict"], "bad", "{}", json["verdicts"]);
    let done = place.grade(&[packed, "--fail-on", "bad"]);
    assert_eq!(done.code, 1);
    assert!(
        done.out.contains("Verdict: BAD") && done.err.contains("1 of 1 item is bad"),
        "{done:?}"
    );
}

/// Each kind of bad input gets one sentence that names the file and what is wrong, nothing on stdout and the exit code 2.
#[test]
fn bad_input_is_one_sentence() {
    let place = Place::new();
    let leaf = drawn_leaves(96, 80, 3);
    let png = std::fs::read(place.picture("leaf.png", &leaf)).unwrap();
    let photo = jpeg(&place, &leaf);
    let mut huge = photo.clone();
    let at = huge.windows(2).position(|w| w == [0xff, 0xc0]).unwrap() + 5;
    huge[at..at + 4].copy_from_slice(&[0xea, 0x60, 0xea, 0x60]);
    let flat = std::fs::read(place.picture("flat.png", &Rgb::filled(100, 80, [7; 3]))).unwrap();
    let dot = std::fs::read(place.picture("dot.png", &Rgb::filled(1, 1, [7; 3]))).unwrap();
    for (name, bytes, part) in [
        ("empty.jpg", Vec::new(), "the file is empty"),
        ("text.png", b"no picture".to_vec(), "it is no PNG, JPEG"),
        (
            "cut.png",
            png[..png.len() / 2].to_vec(),
            "not a readable picture",
        ),
        (
            "cut.jpg",
            photo[..photo.len() - 40].to_vec(),
            "its data break off",
        ),
        ("huge.jpg", huge, "60000 x 60000 pixels are more than"),
        (
            "header.pgm",
            b"P5 60000 60000 255\n".to_vec(),
            "60000 x 60000 pixels are more than",
        ),
        (
            "wide.pgm",
            b"P5 20000 10000 255\n".to_vec(),
            "more than can be graded",
        ),
        ("flat.png", flat, "the picture is constant"),
        (
            "dot.png",
            dot,
            "1 x 1 pixels; the index needs 45 on each side and 60 on one: ",
        ),
        (
            "phone.heic",
            b"\0\0\0\x18ftypheic\0\0\0\0".to_vec(),
            "a HEIC picture",
        ),
    ] {
        let path = place.bytes(name, &bytes);
        let done = place.grade(&[path.to_str().unwrap()]);
        let error = done.refused(2);
        assert!(error.contains(part), "{name}: {error}");
        assert_eq!(
            error.lines().filter(|l| l.starts_with("error")).count(),
            1,
            "{error}"
        );
    }
    for (args, part) in [
        (vec!["nowhere.png"], "there is no such file"),
        (vec!["nowhere.mp4"], "there is no such file"),
        (vec![], "nothing to grade was named"),
        (
            vec!["--left", "leaf.png"],
            "--left and --right belong together",
        ),
        (
            vec!["--left", "leaf.png", "--right", "dot.png"],
            "a pair needs one size",
        ),
        (vec!["leaf.png", "--every", "soon"], "--every 'soon'"),
        (vec!["leaf.png", "--every", "-1s"], "is negative"),
        (vec!["leaf.png", "--crosstalk", "80%"], "out of range"),
        (vec!["data"], "no pictures"),
    ] {
        let done = place.grade(&args);
        assert!(done.refused(2).contains(part), "{args:?}: {done:?}");
    }
}

/// A model that is not there is a mistake of the call.
#[test]
fn an_unknown_model_is_named() {
    let place = Place::new();
    place.picture("leaf.png", &drawn_leaves(96, 80, 3));
    let done = place.run(&["grade", "leaf.png", "--model", "nobody"]);
    assert!(done.refused(2).contains("nobody"), "{done:?}");
}

/// A single picture whose halves look alike is no pair: a tile that repeats, under a name that promises two eyes, is graded as one picture, and
/// that is said. Typed, the layout stands.
#[test]
fn a_pattern_is_one_picture() {
    let place = Place::new();
    // One tile again and again: every place of the left half is found in the right one, and no place is found surely.
    let tile = drawn_leaves(40, 40, 5);
    let pattern = Rgb::from_fn(640, 240, |x, y| tile.at(x % 40, y % 40));
    let file = place.picture("pattern_lr.png", &pattern);
    let file = file.to_str().unwrap();
    let json = place.json(&[file]);
    assert_eq!(json["kind"], "picture", "{}", json["layout"]);
    let remark = json["remarks"][0].as_str().unwrap();
    assert!(remark.contains("graded as one picture"), "{remark}");
    let typed = place.grade(&[file, "--layout", "side-by-side"]);
    assert_eq!(typed.code, 1, "{typed:?}");
}

/// Two pictures that show nothing in common, and plain ones: scores come, a verdict does not, and the exit code says so.
#[test]
fn what_is_no_pair_is_not_judged() {
    let place = Place::new();
    let [l, r] =
        [1, 2].map(|seed| place.picture(&format!("{seed}.png"), &drawn_leaves(240, 160, seed)));
    let sides = [
        "--left",
        l.to_str().unwrap(),
        "--right",
        r.to_str().unwrap(),
        "--format",
        "json",
    ];
    let done = place.grade(&sides);
    assert_eq!(done.code, 1, "{done:?}");
    let json: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(json["verdict"], Value::Null);
    assert_eq!(json["vertical"], Value::Null);
    assert!(json["left"]["score"].is_number());
    assert!(json["not_judged"]["vertical"].is_string());
    assert!(done.err.contains("could not be judged"), "{}", done.err);
}

/// Pictures with peculiarities are graded, and it is said what was done.
#[test]
fn peculiar_pictures_are_remarked_on() {
    let place = Place::new();
    // 16-bit grey as PGM: most significant byte first.
    let leaf = drawn_leaves(96, 80, 3);
    let mut deep = b"P5 96 80 65535\n".to_vec();
    deep.extend(leaf.samples().iter().flat_map(|p| [p[0], p[0]]));
    let json = place.json(&[place.bytes("deep.pgm", &deep).to_str().unwrap()]);
    assert!(
        json["remarks"][0]
            .as_str()
            .unwrap()
            .contains("rounded to 8"),
        "{json}"
    );
    let mut plain = b"P5 96 80 255\n".to_vec();
    plain.extend(leaf.samples().iter().map(|p| p[0]));
    let same = place.json(&[place.bytes("plain.pgm", &plain).to_str().unwrap()]);
    assert_eq!(
        (&json["score"], same["remarks"].as_array().unwrap().len()),
        (&same["score"], 0)
    );
}

/// The reference names every field that there is, and no other: the tables of a picture, a pair and a sequence against real output.
#[test]
fn the_reference_is_true() {
    let place = Place::new();
    let [left, right] = pair(480, 360, 6, 8, 0);
    let packed = place.picture("p_lr.png", &beside([&left, &right]));
    let leaf = leaves("leaves_a_ref.png");
    let mut found = Vec::new();
    let item = [leaf.to_str().unwrap(), "--features"];
    fields(&place.json(&item), "", &mut found);
    fields(
        &place.json(&[packed.to_str().unwrap(), "--rig"]),
        "",
        &mut found,
    );
    for i in 0..2 {
        place.picture(&format!("s/{i}_l.png"), &left);
        place.picture(&format!("s/{i}_r.png"), &right);
    }
    let several = place.json(&["s", "--sequence"]);
    let last = several["items"].as_array().unwrap().last().unwrap();
    assert_eq!(last["kind"], "sequence", "{last}");
    fields(last, "", &mut found);
    fields(&several["summary"], "", &mut found);

    let text = include_str!("../../../../docs/reference-grade.md");
    let named: Vec<&str> = text
        .split('`')
        .skip(1)
        .step_by(2)
        .map(|name| name.trim_end_matches("[]"))
        .collect();
    for path in &found {
        // A group's row names what is in it by its last part; a group may be named by its parts alone.
        let last = path.rsplit('.').next().unwrap();
        let (group, part) = (format!("{path}."), format!(".{last}"));
        let is_named =
            |n: &&str| *n == path || *n == last || n.starts_with(&group) || n.ends_with(&part);
        assert!(named.iter().any(is_named), "{path} is not in the reference");
    }
    for name in named
        .iter()
        .filter(|n| n.contains('.') && !n.contains(['/', ' ']))
    {
        let is_file = ["json", "md", "png", "avi"]
            .iter()
            .any(|e| name.ends_with(&format!(".{e}")));
        assert!(
            is_file || found.iter().any(|f| f == name),
            "{name} is in the reference and not in the output"
        );
    }
}
