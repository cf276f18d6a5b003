//! Proves that folders of pictures come out as pairs with the right bytes and times, and that every kind of bad input is refused with
//! one sentence that names it, before the first pair where that is possible.

use std::path::Path;

use crate::parallel;
use vergence_calib::RigCalibration;
use vergence_capture::{CaptureError, FilesConfig, FilesSource, OnFault, Source as _, StereoFrame};
use vergence_imaging::{Rgb, files};

fn rig() -> RigCalibration {
    parallel::rig(32, 24)
}

/// A picture that shows which eye and index it belongs to.
fn picture(eye: u8, index: u64, w: usize, h: usize) -> Rgb {
    Rgb::from_fn(w, h, |x, y| [eye, index as u8, (x * 7 + y) as u8])
}

fn write(folder: &Path, name: &str, eye: u8, index: u64) {
    std::fs::create_dir_all(folder).unwrap();
    files::write_rgb(&folder.join(name), &picture(eye, index, 32, 24)).unwrap();
}

/// `l/` and `r/` with pictures of the given indexes.
fn folders(root: &Path, left: &[u64], right: &[u64]) -> FilesConfig {
    for i in left {
        write(&root.join("l"), &format!("left_{i:04}.png"), 1, *i);
    }
    for i in right {
        write(&root.join("r"), &format!("right_{i:04}.png"), 2, *i);
    }
    FilesConfig {
        left: root.join("l"),
        right: root.join("r"),
        ..FilesConfig::default()
    }
}

fn all(source: &mut FilesSource) -> Vec<StereoFrame> {
    let mut pairs = Vec::new();
    while let Some(pair) = source.next_pair(None).unwrap() {
        pairs.push(pair);
    }
    assert!(
        source.next_pair(None).unwrap().is_none(),
        "the end stays the end"
    );
    pairs
}

/// What opening or reading to the end complains of.
fn complaint(config: &FilesConfig) -> String {
    let mut source = match FilesSource::open(config, &rig()) {
        Ok(source) => source,
        Err(e) => return e.to_string(),
    };
    loop {
        match source.next_pair(None) {
            Ok(Some(_)) => {}
            Ok(None) => return "no complaint".to_owned(),
            Err(e) => return e.to_string(),
        }
    }
}

/// Bytes, times, indexes and what is known beforehand.
#[test]
fn pairs_have_the_pictures_and_times_of_their_numbers() {
    let root = tempfile::tempdir().unwrap();
    let numbers = [36, 40, 44, 400];
    let config = folders(root.path(), &numbers, &numbers);
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    let info = source.info().clone();
    assert_eq!((info.fps, info.pairs), (30.0, Some(4)));
    assert_eq!(info.cameras, rig().cameras);
    assert_eq!(info.fixed_base_from_cam, Some(rig().base_from_cam));
    let pairs = all(&mut source);
    assert_eq!(pairs.len(), 4);
    for (k, (pair, number)) in pairs.iter().zip(numbers).enumerate() {
        assert_eq!(pair.index, k as u64);
        assert_eq!(pair.capture_s(), number as f64 / 30.0);
        assert_eq!(pair.arrival_s(), pair.capture_s());
        assert_eq!(pair.left.picture, picture(1, number, 32, 24));
        assert_eq!(pair.right.picture, picture(2, number, 32, 24));
    }
    assert_eq!(source.dropped_pairs(), 0);
}

/// One folder with both eyes, told apart by patterns; numbers without leading zeros sort by value; the rate scales the time.
#[test]
fn patterns_and_rates() {
    let root = tempfile::tempdir().unwrap();
    for i in [2, 9, 10, 100] {
        write(root.path(), &format!("left_{i}.png"), 1, i);
        write(root.path(), &format!("right_{i}.jpg"), 2, i);
    }
    std::fs::write(root.path().join("notes.txt"), "left_3.png").unwrap();
    let config = FilesConfig {
        left: root.path().join("left_*"),
        right: root.path().join("r*.jpg"),
        fps: Some(60.0),
        ..FilesConfig::default()
    };
    let times: Vec<f64> = all(&mut FilesSource::open(&config, &rig()).unwrap())
        .iter()
        .map(StereoFrame::capture_s)
        .collect();
    assert_eq!(times, [2.0, 9.0, 10.0, 100.0].map(|i| i / 60.0));
}

/// Names without numbers count from 0 in order of name; a single picture is a stream of one.
#[test]
fn names_without_numbers_count_from_zero() {
    let root = tempfile::tempdir().unwrap();
    for (i, name) in ["a.png", "b.png", "c.png"].into_iter().enumerate() {
        write(&root.path().join("l"), name, 1, i as u64);
        write(&root.path().join("r"), name, 2, i as u64);
    }
    let mut config = FilesConfig {
        left: root.path().join("l"),
        right: root.path().join("r"),
        ..FilesConfig::default()
    };
    let pairs = all(&mut FilesSource::open(&config, &rig()).unwrap());
    assert_eq!(
        pairs
            .iter()
            .map(|p| p.left.picture.at(0, 0)[1])
            .collect::<Vec<_>>(),
        [0, 1, 2]
    );
    config.left.push("b.png");
    config.right.push("c.png");
    let pairs = all(&mut FilesSource::open(&config, &rig()).unwrap());
    assert_eq!((pairs.len(), pairs[0].capture_s()), (1, 0.0));
}

/// Two pictures that are named themselves are a pair, whatever numbers their names hold.
#[test]
fn two_pictures_with_other_numbers_are_a_pair() {
    let root = tempfile::tempdir().unwrap();
    write(root.path(), "im0.png", 1, 0);
    write(root.path(), "im1.png", 2, 1);
    let config = FilesConfig {
        left: root.path().join("im0.png"),
        right: root.path().join("im1.png"),
        ..FilesConfig::default()
    };
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    assert_eq!(source.remarks(), [""; 0]);
    let pairs = all(&mut source);
    assert_eq!((pairs.len(), pairs[0].capture_s()), (1, 0.0));
    assert_eq!(pairs[0].right.picture, picture(2, 1, 32, 24));
}

/// A frame rate that nobody gave is said to be assumed, and so are the calibration's notes.
#[test]
fn what_is_assumed_is_told() {
    let root = tempfile::tempdir().unwrap();
    let mut config = folders(root.path(), &[0, 1], &[0, 1]);
    let mut noted = rig();
    noted.notes = vec!["on the ceiling".to_owned()];
    let source = FilesSource::open(&config, &noted).unwrap();
    assert_eq!(source.remarks()[0], "on the ceiling");
    assert!(source.remarks()[1].contains("30 a second are assumed"));
    config.fps = Some(30.0);
    let source = FilesSource::open(&config, &noted).unwrap();
    assert_eq!(source.remarks(), ["on the ceiling"]);
}

/// Missing partners are listed; with `Skip` they are dropped and counted.
#[test]
fn missing_partners() {
    let root = tempfile::tempdir().unwrap();
    let mut config = folders(root.path(), &[1, 2, 3, 5, 8], &[1, 3, 4, 5]);
    assert_eq!(
        complaint(&config),
        "left and right do not belong together: 5 left and 4 right pictures; no right picture for indexes 2, 8; \
         no left picture for index 4"
    );
    config.unpaired = OnFault::Skip;
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    assert_eq!(source.info().pairs, Some(3));
    let pairs = all(&mut source);
    assert_eq!(
        pairs
            .iter()
            .map(|p| p.left.picture.at(0, 0)[1])
            .collect::<Vec<_>>(),
        [1, 3, 5]
    );
    assert_eq!(source.dropped_pairs(), 3);

    let other = tempfile::tempdir().unwrap();
    let mut config = folders(other.path(), &(0..30).collect::<Vec<_>>(), &[77]);
    assert!(complaint(&config).contains("for indexes 0, 1, 2, 3, 4, 5, 6, 7 and 22 more"));
    config.unpaired = OnFault::Skip;
    assert!(
        complaint(&config).contains("do not belong together"),
        "nothing in common"
    );
}

/// Sizes that differ within a stream or between the eyes are found before the first pair, and the file is named.
#[test]
fn different_sizes() {
    let root = tempfile::tempdir().unwrap();
    let config = folders(root.path(), &[0, 1, 2], &[0, 1, 2]);
    let odd = root.path().join("r/right_0001.png");
    files::write_rgb(&odd, &picture(2, 1, 32, 25)).unwrap();
    let error = FilesSource::open(&config, &rig()).unwrap_err();
    assert!(matches!(
        error,
        CaptureError::PictureSize {
            found: (32, 25),
            expected: (32, 24),
            ..
        }
    ));
    assert!(error.to_string().ends_with(&format!(": {}", odd.display())));

    for i in 0..3 {
        files::write_rgb(
            &root.path().join(format!("r/right_{i:04}.png")),
            &picture(2, i, 16, 12),
        )
        .unwrap();
    }
    let error = FilesSource::open(&config, &rig()).unwrap_err().to_string();
    assert!(
        error.contains("16x12 pixels, but 32x24 in") && error.ends_with("right_0000.png"),
        "{error}"
    );
}

/// A calibration for other proportions is refused, one for another size of the same proportions is scaled.
#[test]
fn calibration_that_does_not_fit() {
    let root = tempfile::tempdir().unwrap();
    let config = folders(root.path(), &[0], &[0]);
    let twice = rig().scaled_to([(64, 48); 2]).unwrap();
    let source = FilesSource::open(&config, &twice).unwrap();
    assert_eq!(source.info().cameras, rig().cameras);
    let mut wide = rig();
    wide.cameras[1].intrinsics.width = 40;
    let error = FilesSource::open(&config, &wide).unwrap_err().to_string();
    assert!(
        error.starts_with("calibration is for 40x24, pictures are 32x24"),
        "{error}"
    );
}

/// A picture that breaks off in the middle of the run is an error there (the pairs before it pass) or skipped and counted; one
/// that is no picture at all is found before the start.
#[test]
fn unreadable_pictures() {
    let root = tempfile::tempdir().unwrap();
    let numbers = [0, 1, 2, 3];
    let mut config = folders(root.path(), &numbers, &numbers);
    let broken = root.path().join("l/left_0002.png");
    let bytes = std::fs::read(&broken).unwrap();
    std::fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    for _ in 0..2 {
        assert!(source.next_pair(None).unwrap().is_some());
    }
    let error = source.next_pair(None).unwrap_err().to_string();
    assert!(
        error.contains("not a readable picture") && error.ends_with("left_0002.png"),
        "{error}"
    );
    assert!(
        source.next_pair(None).unwrap().is_none(),
        "after an error the source has ended"
    );

    std::fs::write(root.path().join("r/right_0001.png"), "no picture").unwrap();
    let error = FilesSource::open(&config, &rig()).unwrap_err().to_string();
    assert!(error.ends_with("right_0001.png"), "{error}");

    config.unreadable = OnFault::Skip;
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    let pairs = all(&mut source);
    assert_eq!(
        pairs
            .iter()
            .map(|p| p.left.picture.at(0, 0)[1])
            .collect::<Vec<_>>(),
        [0, 3]
    );
    assert_eq!(source.dropped_pairs(), 2);
}

/// A JPEG picture of which something is missing does not pass as a grey one: cut at 1 %, 50 % and 99 % of its length, and with
/// random bytes in its middle.
#[test]
fn broken_jpegs_are_refused() {
    let mut state = 1_u32;
    let mut byte = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let root = tempfile::tempdir().unwrap();
    let noise = Rgb::from_fn(32, 24, |_, _| [byte(), byte(), byte()]);
    for side in ["l", "r"] {
        std::fs::create_dir(root.path().join(side)).unwrap();
        for i in 0..3 {
            files::write_rgb(&root.path().join(format!("{side}/{i}.jpg")), &noise).unwrap();
        }
    }
    let mut config = FilesConfig {
        left: root.path().join("l"),
        right: root.path().join("r"),
        ..FilesConfig::default()
    };
    assert_eq!(complaint(&config), "no complaint");
    let broken = root.path().join("l/1.jpg");
    let whole = std::fs::read(&broken).unwrap();
    let n = whole.len();
    let mut garbled = whole.clone();
    garbled[n - 600..n - 200].fill_with(&mut byte);
    for bytes in [
        &whole[..n / 100],
        &whole[..n / 2],
        &whole[..n * 99 / 100],
        &garbled,
    ] {
        std::fs::write(&broken, bytes).unwrap();
        config.unreadable = OnFault::Refuse;
        let error = complaint(&config);
        assert!(
            error.contains("not a readable picture") && error.ends_with("1.jpg"),
            "{error}"
        );
        config.unreadable = OnFault::Skip;
        let mut source = FilesSource::open(&config, &rig()).unwrap();
        assert_eq!(all(&mut source).len(), 2);
        assert_eq!(source.dropped_pairs(), 1);
    }
}

/// Everything else that can be wrong with what was named.
#[test]
fn inputs_that_are_not_there_or_not_usable() {
    let root = tempfile::tempdir().unwrap();
    let good = folders(root.path(), &[0, 1], &[0, 1]);
    let at = |name: &str| root.path().join(name);
    std::fs::create_dir(at("empty")).unwrap();
    write(&at("twice"), "a_1.png", 1, 1);
    write(&at("twice"), "b_1.png", 1, 1);
    write(&at("mixed"), "a_1.png", 1, 1);
    write(&at("mixed"), "b.png", 1, 1);
    write(&at("stamps"), "1403636579763555584.png", 1, 1);
    for (left, expected) in [
        (at("nowhere"), "there is no such file or folder"),
        (
            at("empty"),
            "the folder holds no pictures (.png, .jpg, .jpeg)",
        ),
        (
            at("l/other_*.png"),
            "no picture (.png, .jpg, .jpeg) has a name like this",
        ),
        (at("no/left_*.png"), "listing a folder failed"),
        (at("twice"), "two pictures have the number 1"),
        (at("mixed"), "this one has none"),
        (at("stamps"), "too large for a frame's index"),
        (std::path::PathBuf::new(), "an input is missing"),
        (
            good.right.clone(),
            "where one folder holds both, patterns such as left_*.jpg",
        ),
    ] {
        let config = FilesConfig {
            left,
            ..good.clone()
        };
        let found = complaint(&config);
        assert!(found.contains(expected), "{expected:?} is not in {found:?}");
    }
    for fps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let config = FilesConfig {
            fps: Some(fps),
            ..good.clone()
        };
        assert!(complaint(&config).contains("the setting fps is"));
    }
}

/// Leaving in the middle ends the threads: dropping returns.
#[test]
fn dropping_in_the_middle_returns() {
    let root = tempfile::tempdir().unwrap();
    let numbers: Vec<u64> = (0..20).collect();
    let config = folders(root.path(), &numbers, &numbers);
    let mut source = FilesSource::open(&config, &rig()).unwrap();
    source.next_pair(None).unwrap();
    drop(source);
}
