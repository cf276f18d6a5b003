//! Precedence, checks and messages of the settings, and that what is printed reads back as the same settings.

use super::*;

fn load(
    file: &str,
    environment: &[(&str, &str)],
    flags: &[(&str, &str)],
) -> anyhow::Result<Settings> {
    let mut settings = Settings::defaults()?;
    settings.apply_file(Path::new("rig.toml"), file)?;
    settings.apply_environment(
        environment
            .iter()
            .map(|(n, v)| ((*n).to_owned(), (*v).to_owned())),
    )?;
    for (path, text) in flags {
        settings.apply_flag(&Override {
            path: (*path).to_owned(),
            flag: "--flag".to_owned(),
            text: (*text).to_owned(),
        })?;
    }
    settings.check_together()?;
    Ok(settings)
}

fn message(file: &str) -> String {
    load(file, &[], &[]).unwrap_err().to_string()
}

/// Every default is inside its own range, every key has a section, a meaning and a name of its own.
#[test]
fn table_of_keys_is_sound() {
    let settings = load("", &[], &[]).unwrap();
    let mut names = std::collections::BTreeSet::new();
    for entry in settings.entries() {
        assert!(keys::SECTIONS.iter().any(|(s, _)| *s == entry.key.section));
        assert!(entry.key.meaning.ends_with('.'), "{}", entry.key.path());
        assert!(
            names.insert(entry.key.environment()),
            "{}",
            entry.key.path()
        );
    }
    assert_eq!(settings.number("rig.interaxial"), 0.07);
    assert_eq!(settings.number("camera.focal_length"), 0.0065);
    assert_eq!(settings.number("screen.interocular"), 0.065);
}

/// Flags win over the environment, that over the file, that over defaults; each value knows its origin.
#[test]
fn precedence_is_flags_environment_file_default() {
    let file = "[rig]\ninteraxial = \"60mm\"\npupil = 0.01\n[camera]\nwidth = 640\n";
    let env = [
        ("VERGENCE_RIG_INTERAXIAL", "61mm"),
        ("VERGENCE_CAMERA_WIDTH", "800"),
        ("VERGENCE_TEST_DATA", "x"),
    ];
    let settings = load(file, &env, &[("rig.interaxial", "62mm")]).unwrap();
    assert_eq!(settings.number("rig.interaxial"), 0.062);
    assert_eq!(settings.count("camera.width"), 800);
    assert_eq!(settings.number("rig.pupil"), 0.01);
    assert_eq!(settings.count("camera.height"), 768);
    assert_eq!(
        settings.entry("rig.pupil").origin.to_string(),
        "rig.toml line 3"
    );
    assert_eq!(
        settings.entry("camera.width").origin.to_string(),
        "environment VERGENCE_CAMERA_WIDTH"
    );
    assert_eq!(
        settings.entry("rig.interaxial").origin.to_string(),
        "--flag"
    );
    assert_eq!(settings.entry("camera.height").origin, Origin::Default);
}

/// A mistyped key, section or word names its line and the nearest that exists.
#[test]
fn unknown_names_are_told_the_nearest() {
    assert_eq!(
        message("[rig]\n\ninteraxail = 0.07\n"),
        "settings file rig.toml line 3: unknown setting rig.interaxail; the nearest is rig.interaxial"
    );
    assert_eq!(
        message("[camrea]\nfps = 3\n"),
        "settings file rig.toml line 1: unknown section [camrea]; the nearest is [camera]"
    );
    assert!(message("[rig]\nfocal_length = 1\n").ends_with("the nearest is camera.focal_length"));
    assert!(message("[motors.pan]\ngaer = 3\n").ends_with("the nearest is motors.pan.gear"));
    assert!(message("[rig]\nbase = 1\n").ends_with("the nearest is rig.interaxial"));
    assert!(message("[screen]\nipd = 1\n").ends_with("the nearest is screen.interocular"));
    assert!(message("interaxial = 1\n").ends_with("the nearest is rig.interaxial"));
    let unknown = load("", &[("VERGENCE_RIG_PUPLI", "1")], &[])
        .unwrap_err()
        .to_string();
    assert!(
        unknown.ends_with("the nearest is VERGENCE_RIG_PUPIL"),
        "{unknown}"
    );
}

/// Zero, negative, infinite and wordy values are refused with a sentence that names the key and its range.
#[test]
fn values_out_of_range_are_refused() {
    assert_eq!(
        message("[rig]\ninteraxial = -0.07\n"),
        "settings file rig.toml line 2: rig.interaxial = '-0.07' is out of range: rig.interaxial must be more than 0"
    );
    for bad in [
        "0",
        "nan",
        "inf",
        "-inf",
        "\"0mm\"",
        "\"70 furlongs\"",
        "true",
        "[1]",
        "{ a = 1 }",
        "1979-05-27",
    ] {
        assert!(
            load(&format!("[rig]\ninteraxial = {bad}\n"), &[], &[]).is_err(),
            "{bad}"
        );
    }
    assert!(message("[camera]\nwidth = 100.5\n").contains("whole"));
    assert!(message("[run]\nmode = \"convergd\"\n").ends_with("the nearest is converged"));
    assert!(message("[plan]\nnear = 10\nfar = 1\n").contains("must be less than"));
    assert!(message("[rig\n").contains("line 1: not TOML"));
}

/// The magnification and the width of the screen say the same thing: the stronger layer wins, and two at once are refused.
#[test]
fn screen_width_and_magnification_are_one_setting() {
    assert!(message("[screen]\nwidth = 1\nmagnification = 40\n").contains("both set"));
    let flag = load(
        "[screen]\nwidth = 1\n",
        &[],
        &[("screen.magnification", "40")],
    )
    .unwrap();
    assert_eq!(flag.number_or_auto("screen.width"), None);
    let env = load(
        "[screen]\nmagnification = 40\n",
        &[("VERGENCE_SCREEN_WIDTH", "2m")],
        &[],
    )
    .unwrap();
    assert_eq!(env.number_or_auto("screen.width"), Some(2.0));
}

/// The printed file reads back to the same values, whatever was set.
#[test]
fn printed_settings_read_back() {
    let flags = [
        ("rig.interaxial", "0.123456789 m"),
        ("motors.pan.max", "1.2rad"),
        ("screen.width", "55in"),
        ("run.out", "a \"quoted\" \\ folder\u{7}"),
        ("camera.gain_difference", "0.333"),
    ];
    let settings = load("", &[], &flags).unwrap();
    let again = load(&settings.to_toml(), &[], &[]);
    let again = again.unwrap();
    for (a, b) in settings.entries().iter().zip(again.entries()) {
        assert_eq!(a.value, b.value, "{}", a.key.path());
    }
}
