//! Settings from end to end: `vergence config`, the four layers, and bad input of every kind. Proves messages, exit
//! codes and precedence of the real program; the parsing of single values is proved beside its code.

use crate::common;
use crate::common::Place;

#[test]
fn printed_settings_are_a_settings_file_that_changes_nothing() {
    let place = Place::new();
    let first = place.run(&["config"]).good();
    assert!(first.contains("interaxial = \"70 mm\"\n"), "{first}");
    assert!(first.contains("(length, more than 0; default 70 mm)"));
    place.file("rig.toml", &first);
    let again = place
        .run(&["--config", "rig.toml", "config", "--format", "json"])
        .json();
    let defaults = place.run(&["config", "--format", "json"]).json();
    let value = |json: &serde_json::Value, section: &str, key: &str| {
        json["settings"][section][key]["value"].clone()
    };
    for (section, keys) in defaults["settings"].as_object().unwrap() {
        for key in keys.as_object().unwrap().keys() {
            assert_eq!(
                value(&again, section, key),
                value(&defaults, section, key),
                "{section}.{key}"
            );
        }
    }
    assert_eq!(again["settings"]["rig"]["interaxial"]["origin"], "file");
    assert_eq!(defaults["settings"]["rig"]["interaxial"]["value"], 0.07);
    assert_eq!(defaults["settings"]["rig"]["interaxial"]["unit"], "m");
}

#[test]
fn flags_win_over_environment_over_file_and_each_value_says_where_it_came_from() {
    let place = Place::new();
    place.file(
        "rig.toml",
        "[rig]\ninteraxial = \"60mm\"\npupil = \"1cm\"\n[camera]\nfps = 25\n",
    );
    let output = place
        .command(&[
            "--config",
            "rig.toml",
            "--set",
            "rig.interaxial=62mm",
            "config",
        ])
        .env("VERGENCE_RIG_INTERAXIAL", "61mm")
        .env("VERGENCE_RIG_PUPIL", "0.02")
        .output()
        .unwrap();
    let text = common::Done::from(output).good();
    assert!(
        text.contains("interaxial = \"62 mm\"  # from --set rig.interaxial\n"),
        "{text}"
    );
    assert!(
        text.contains("pupil = \"20 mm\"  # from environment VERGENCE_RIG_PUPIL\n"),
        "{text}"
    );
    assert!(
        text.contains("fps = \"25 Hz\"  # from rig.toml line 5\n"),
        "{text}"
    );
}

#[test]
fn the_environment_names_the_file_too() {
    let place = Place::new();
    place.file("rig.toml", "[rig]\ninteraxial = 0.1\n");
    let output = place
        .command(&["config"])
        .env("VERGENCE_CONFIG", "rig.toml")
        .output()
        .unwrap();
    let text = common::Done::from(output).good();
    assert!(
        text.contains("interaxial = \"100 mm\"  # from rig.toml line 2\n"),
        "{text}"
    );
}

/// Every fault of a settings file is one sentence with the line and what would be right.
#[test]
fn faulty_files_are_refused_in_one_sentence() {
    let place = Place::new();
    for (file, says) in [
        (
            "[rig]\ninteraxail = 1\n",
            "settings file f.toml line 2: unknown setting rig.interaxail; the nearest is rig.interaxial",
        ),
        (
            "[camrea]\n",
            "settings file f.toml line 1: unknown section [camrea]; the nearest is [camera]",
        ),
        (
            "[rig]\ninteraxial = nan\n",
            "settings file f.toml line 2: rig.interaxial = 'nan' is no length",
        ),
        (
            "[rig]\ninteraxial = inf\n",
            "rig.interaxial = 'inf' is no length",
        ),
        (
            "[rig]\ninteraxial = 0\n",
            "rig.interaxial must be more than 0",
        ),
        (
            "[rig]\ninteraxial = \"-7cm\"\n",
            "rig.interaxial must be more than 0",
        ),
        (
            "[rig]\ninteraxial = \"7 parsec\"\n",
            "has the unit 'parsec'; a length is written in m, mm, cm",
        ),
        (
            "[rig]\ninteraxial = [1]\n",
            "rig.interaxial is a list, but takes a length",
        ),
        (
            "[plan]\nnear = 5\nfar = \"4m\"\n",
            "plan.near = 5 m (f.toml line 2) must be less than plan.far = 4 m (f.toml line 3)",
        ),
        ("[plan]\nrule = \"arcmin\"\n", "must be one of seen-depth"),
        ("[run]\npath = \"wlak\"\n", "run.path = 'wlak'"),
        ("[camera]\nwidth = 1e9\n", "between 16 and 16384"),
        ("rig = \n", "line 1: not TOML"),
    ] {
        place.file("f.toml", file);
        let err = place.run(&["--config", "f.toml", "config"]).refused(2);
        assert!(err.contains(says), "{file}\n{err}");
        assert!(
            !err.contains("panicked") && err.lines().count() <= 2,
            "{err}"
        );
    }
}

#[test]
fn other_bad_calls_are_usage_errors() {
    let place = Place::new();
    let err = place.run(&["--config", "none.toml", "config"]).refused(2);
    assert!(
        err.contains("settings file none.toml: cannot be read"),
        "{err}"
    );
    place.file("large.toml", &"# no end\n".repeat(120_000));
    let err = place.run(&["--config", "large.toml", "config"]).refused(2);
    assert!(err.contains("larger than 1 MiB"), "{err}");
    let err = place.run(&["--set", "rig.interaxial", "config"]).refused(2);
    assert!(err.contains("hint: write --set section.key=value"), "{err}");
    let err = place.run(&["--set", "rig.base=1", "config"]).refused(2);
    assert!(
        err.contains("--set rig.base: unknown setting rig.base; the nearest is"),
        "{err}"
    );
    let output = place
        .command(&["config"])
        .env("VERGENCE_RIG_INTERAXAIL", "1")
        .output()
        .unwrap();
    let err = common::Done::from(output).refused(2);
    assert!(
        err.contains("the nearest is VERGENCE_RIG_INTERAXIAL"),
        "{err}"
    );
    assert_eq!(place.run(&["confgi"]).code, 2);
    assert_eq!(place.run(&[]).code, 2);
}

/// Help is on stdout, names units and gives an example for every command.
#[test]
fn every_command_has_a_manual_page() {
    let place = Place::new();
    let all = place.run(&["--help"]).good();
    for word in [
        "plan",
        "project",
        "config",
        "Units:",
        "Exit code",
        "Examples:",
    ] {
        assert!(all.contains(word), "{word}\n{all}");
    }
    // The first words of what each page says at length; lines are wrapped, so white space is evened out.
    for (command, says) in [
        (
            "plan",
            "Say at which distances parallel cameras will do and at which both must be brought to bear on the target",
        ),
        ("project", "exact projection, no small-angle formulas"),
        (
            "run",
            "Run the loop: two cameras look, the target is found and followed",
        ),
        (
            "config",
            "Print the effective settings as a TOML file: every key with its value",
        ),
    ] {
        let page = place.run(&[command, "--help"]).good();
        let even = page.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(even.contains(says), "{command}: {page}");
        assert!(page.contains("Examples:"), "{page}");
        assert!(command == "run" || page.contains("JSON"), "{page}");
        let short = place.run(&[command, "-h"]).good();
        assert!(!short.contains(says), "-h is the short page: {short}");
    }
}

/// The defaults that the flags' help names are those of the settings.
#[test]
fn defaults_in_the_help_are_the_defaults() {
    let place = Place::new();
    let settings = place.run(&["config", "--format", "json"]).json();
    let page = place.run(&["plan", "--help"]).good();
    let even = page.split_whitespace().collect::<Vec<_>>().join(" ");
    for (flag, section, key) in [
        ("--base <", "rig", "interaxial"),
        ("--pupil <", "rig", "pupil"),
        ("--focal-length <", "camera", "focal_length"),
        ("--magnification <", "screen", "magnification"),
        ("--viewing-distance <", "screen", "viewing_distance"),
        ("--eyes <", "screen", "interocular"),
        ("--near <", "plan", "near"),
        ("--far <", "plan", "far"),
        ("--background <", "plan", "background"),
        ("--rule <", "plan", "rule"),
        ("--mode <", "plan", "mode"),
    ] {
        let said = even
            .split_once(flag)
            .and_then(|(_, rest)| rest.split_once("[default: "))
            .and_then(|(_, rest)| rest.split_once(']'))
            .unwrap_or_else(|| panic!("{flag} names no default: {page}"))
            .0;
        let default = settings["settings"][section][key]["default"]
            .as_str()
            .unwrap_or_else(|| panic!("{section}.{key} has no default"));
        assert_eq!(said, default.replace(' ', ""), "{flag}");
    }
}

/// A reader that closes the pipe (`vergence config | head -1`) sees no panic and no error.
#[test]
#[cfg(unix)]
fn closed_pipe_is_no_error() {
    let place = Place::new();
    let mut child = place
        .command(&["plan", "--format", "json"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert_eq!(output.status.code(), Some(0));
}
