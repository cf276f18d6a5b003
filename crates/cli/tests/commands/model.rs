//! Proves what `vergence model` does end to end, in a data folder of the test's own: a model goes in whole, is listed, shown and removed;
//! what is no model is refused with one sentence and leaves nothing behind; nothing reaches the built-in model or leaves the folder.

use std::path::{Path, PathBuf};

use crate::common::{Done, Place};

/// libsvm's files of the crate `quality`.
const LIBSVM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../quality/tests/libsvm");

/// `vergence model ...` with the place's folder `data`.
fn model(place: &Place, args: &[&str]) -> Done {
    let args: Vec<&str> = std::iter::once("model")
        .chain(args.iter().copied())
        .collect();
    let mut command = place.command(&args);
    command.env("VERGENCE_DATA_DIR", place.path().join("data"));
    Done::from(command.output().expect("the program starts"))
}

/// Stdout of an import and its talk.
fn imported(place: &Place, args: &[&str]) -> (String, String) {
    let done = model(place, args);
    assert_eq!(done.code, 0, "{done:?}");
    (done.out, done.err)
}

fn files_under(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let paths = entries.map(|e| e.unwrap().path());
    paths
        .flat_map(|p| if p.is_dir() { files_under(&p) } else { vec![p] })
        .collect()
}

#[test]
fn a_model_is_imported_listed_shown_and_removed() {
    let place = Place::new();
    let (out, err) = imported(&place, &["import", LIBSVM, "--name", "mine"]);
    assert!(
        out.contains("0 best ... 100 worst") && out.contains("JPEG 2000"),
        "{out}"
    );
    assert!(
        err.starts_with("kept as ") && err.contains("mine.json"),
        "{err}"
    );
    let file = place.path().join("data/models/mine.json");
    assert_eq!(files_under(place.path()), std::slice::from_ref(&file));

    let shown = model(&place, &["show", "mine", "--format", "json"]).json();
    assert_eq!(shown["name"], "mine");
    assert_eq!(shown["built_in"], false);
    assert_eq!(shown["scale"]["worst"], 100.0);
    assert_eq!(shown["classifier"]["support_vectors"]["wn"], 7);
    assert_eq!(shown["classifier"]["support_vectors"]["jp2k"], 10);
    assert_eq!(shown["classes"][0], "jp2k");
    let listed = model(&place, &["list", "--format", "json"]).json();
    assert_eq!(listed["models"][0]["name"], "default");
    assert_eq!(listed["models"][1], shown);
    assert!(model(&place, &["list"]).good().contains("\nmine "));

    // Our own file can be imported again, under another name, and is then the same but for that.
    let copy = place.path().join("copy.json");
    std::fs::copy(&file, &copy).unwrap();
    let (out, _) = imported(&place, &["import", "copy.json", "--format", "json"]);
    let again: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(again["name"], "copy");
    assert_eq!(again["regressors"], shown["regressors"]);

    let taken = model(&place, &["import", "copy.json", "--name", "mine"]).refused(2);
    assert!(
        taken.contains("there is a model 'mine' already") && taken.contains("--replace"),
        "{taken}"
    );
    imported(
        &place,
        &["import", "copy.json", "--name", "mine", "--replace"],
    );

    assert_eq!(model(&place, &["remove", "mine"]).code, 0);
    assert!(!file.exists());
    let gone = model(&place, &["remove", "mine"]).refused(2);
    assert!(
        gone.contains("there is no model 'mine'") && gone.contains("copy"),
        "{gone}"
    );
    model(&place, &["show", "mine"]).refused(2);
}

#[test]
fn the_released_model_is_imported_with_its_terms() {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let release = data.join("diivine/data_live_trained.mat");
    if !release.is_file() {
        println!("skipped: no released model at {}", release.display());
        return;
    }
    let place = Place::new();
    let (_, err) = imported(
        &place,
        &["import", release.to_str().unwrap(), "--name", "live"],
    );
    assert!(
        err.contains("note: this model is not part of this project"),
        "{err}"
    );
    assert!(
        err.contains("The University of Texas at Austin") && err.contains("no warranty"),
        "{err}"
    );
    let shown = model(&place, &["show", "live", "--format", "json"]).json();
    assert_eq!(shown["classifier"]["support_vectors"]["ff"], 75);
    assert_eq!(shown["regressors"]["blur"]["support_vectors"], 98);
}

#[test]
fn the_default_model_is_built_in_and_stays() {
    let place = Place::new();
    let shown = model(&place, &["show", "--format", "json"]).json();
    assert_eq!(shown["name"], "default");
    assert_eq!(shown["built_in"], true);
    assert_eq!(shown["file"], serde_json::Value::Null);
    for args in [
        ["import", LIBSVM, "--name", "default"].as_slice(),
        &["import", LIBSVM, "--name", "Default", "--replace"],
        &["remove", "default"],
    ] {
        let refused = model(&place, args).refused(2);
        assert!(refused.contains("'default' is built in"), "{refused}");
    }
    assert_eq!(files_under(place.path()), Vec::<PathBuf>::new());
}

#[test]
fn what_is_no_model_is_refused_and_leaves_nothing() {
    let place = Place::new();
    place
        .file("empty.json", "")
        .file("text.mat", "no model")
        .file("other.json", "{\"score\": 1}")
        .file("matlab.mat", "MATLAB 5.0 MAT-file, cut short")
        .file("nan.json", "{\"format\": NaN}")
        .file("one.model", "svm_type c_svc\n");
    std::fs::create_dir(place.path().join("folder")).unwrap();
    for (path, expected) in [
        ("empty.json", "neither a quality model in JSON nor"),
        ("text.mat", "neither a quality model in JSON nor"),
        (
            "other.json",
            "not a quality model in JSON: its \"format\" is \"missing\"",
        ),
        ("nan.json", "its \"format\" is \"missing\""),
        (
            "matlab.mat",
            "not a readable MATLAB level-5 file: its data break off",
        ),
        ("one.model", "one of six models of libsvm"),
        ("folder", "class.model"),
        ("nowhere.mat", "cannot read nowhere.mat"),
    ] {
        let refused = model(&place, &["import", path, "--name", "x"]).refused(2);
        assert!(refused.contains(expected), "{refused}");
        assert_eq!(
            refused.lines().filter(|l| !l.starts_with("hint")).count(),
            1,
            "{refused}"
        );
    }
    for name in [
        "../x",
        "a/b",
        "",
        ".",
        ".hidden",
        "a.",
        "a b",
        "\u{e9}",
        &"x".repeat(65),
    ] {
        let refused = model(&place, &["import", LIBSVM, "--name", name]).refused(2);
        assert!(
            refused.contains("cannot be the name of a model"),
            "{refused}"
        );
        model(&place, &["remove", "--", name]).refused(2);
    }
    assert!(!place.path().join("data").exists());
}

/// A file in the folder that somebody broke is listed with its reason and does not hide the others.
#[test]
fn a_broken_file_is_listed_with_its_reason() {
    let place = Place::new();
    imported(&place, &["import", LIBSVM, "--name", "zebra"]);
    let file = place.path().join("data/models/zebra.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let broken = text.replacen("\"gamma\":0", "\"gamma\":NaN, \"x\":0", 1);
    std::fs::write(
        file.with_file_name("broken.json"),
        text.replacen("\"rho\":[", "\"rho\":[NaN,", 1),
    )
    .unwrap();
    std::fs::write(file.with_file_name("other.json"), broken).unwrap();
    let listed = model(&place, &["list", "--format", "json"]).json();
    let models = listed["models"].as_array().unwrap();
    let names: Vec<&str> = models.iter().map(|m| m["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["default", "broken", "other", "zebra"]);
    assert!(
        models[1]["error"]
            .as_str()
            .unwrap()
            .contains("classifier.rho"),
        "{listed}"
    );
    assert!(
        models[2]["error"]
            .as_str()
            .unwrap()
            .contains("unknown field `x`"),
        "{listed}"
    );
    assert!(models[3].get("error").is_none());
    assert!(
        model(&place, &["list"])
            .good()
            .contains("broken   cannot be read")
    );
}
