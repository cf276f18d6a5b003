//! Proves, with the real program on a small twin: a run records, `info` finds the file whole, a lossless recording replays bit for bit, the same seed
//! gives the same bytes, `export` writes every pair and number and a film of them, hostile files are refused in a sentence. Real disks are measured by
//! hand; runs that are killed are in `run_faults.rs`.

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod running;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{self, Output};

fn vergence(args: &[&str]) -> Output {
    running::command(args).output().unwrap()
}

fn recorded(out: &Path, pictures: &str) -> PathBuf {
    let pictures = format!("record.pictures={pictures}");
    // Long and large enough for the person to be found and measured.
    let mut args = vec!["run", "--fast", "--headless", "--seconds", "0.8s", "--out"];
    args.push(out.to_str().unwrap());
    args.extend(running::SMALL);
    args.extend(["--set", &pictures]);
    let output = vergence(&args);
    assert!(output.status.success(), "{output:?}");
    let folder = fs::read_dir(out).unwrap().next().unwrap().unwrap().path();
    folder.join("recording.mcap")
}

#[test]
fn a_run_is_recorded_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let file = recorded(&folder.path().join("a"), "png");
    let path = file.to_str().unwrap();
    let info = vergence(&["info", path, "--format", "json"]);
    assert!(info.status.success(), "{info:?}");
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["whole"], true);
    let pairs = info["pairs"].as_u64().unwrap();
    assert!(pairs >= 20 && info["facts"]["seed"] == "1");
    assert!(info["cameras"].is_null(), "no live cameras");
    let replay = vergence(&["replay", "--strict", path, "--format", "json"]);
    assert!(replay.status.success(), "{replay:?}");
    let replay: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert_eq!(replay["pairs"], pairs);
    assert!(replay["estimates"].as_u64().unwrap() >= 5, "{replay}");
    assert_eq!(replay["equal"], replay["estimates"]);
    assert_eq!(replay["lossless"], true);

    // The same seed, the same bytes, wherever it is recorded to.
    let again = recorded(&folder.path().join("b"), "png");
    assert!(fs::read(&file).unwrap() == fs::read(again).unwrap());

    let out = folder.path().join("export");
    let export = vergence(&["export", path, "--out", out.to_str().unwrap(), "--no-video"]);
    assert!(export.status.success(), "{export:?}");
    let count = |name: &str| fs::read_dir(out.join(name)).unwrap().count() as u64;
    assert_eq!([count("left"), count("right")], [pairs; 2]);
    let rows = fs::read_to_string(out.join("numbers/step.csv")).unwrap();
    assert_eq!(rows.lines().count() as u64, pairs + 1);

    // Cut short it is still read, and says so.
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let info = vergence(&["info", path]);
    assert_eq!(info.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&info.stdout).contains("was not finished"));
    assert!(vergence(&["replay", path]).status.success());
}

#[test]
fn other_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("other.mcap");
    let path = file.to_str().unwrap();
    for (bytes, word) in [
        (&b"GIF89a"[..], "not an MCAP recording"),
        (b"\x89MCAP1\r\n", "version '1'"),
        (b"\x89MCAP0\r\n", "lens"),
    ] {
        fs::write(&file, bytes).unwrap();
        let output = vergence(&["replay", path]);
        assert_eq!(output.status.code(), Some(2));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains(word), "{said}");
    }
    let output = vergence(&["export", "no-such-file", "--out", path]);
    assert_eq!(output.status.code(), Some(2));
}

/// The same recording with other facts or attachments: `change` gets each as name and content, and leaves it out where it gives nothing.
fn changed(from: &Path, to: &Path, change: impl Fn(&str, String) -> Option<String>) {
    use vergence_record::mcap::{Channel, Event, Reader, Schema, Writer};
    let mut reader = Reader::new(fs::File::open(from).unwrap()).unwrap();
    let mut events = Vec::new();
    let (mut schemas, mut channels) = (Vec::new(), Vec::new());
    while let Some(event) = reader.next_event().unwrap() {
        match event {
            // They are declared twice: at the beginning and at the end.
            Event::Schema { id, name, .. } if id as usize == schemas.len() + 1 => {
                let data = Vec::new();
                schemas.push(Schema { name, data });
            }
            Event::Channel {
                id, schema, topic, ..
            } if id as usize == channels.len() => {
                let schema = schema as usize - 1;
                channels.push(Channel { topic, schema });
            }
            other => events.push(other),
        }
    }
    let (mut writer, mut out) = Writer::new("test", schemas, channels);
    for event in events {
        match event {
            Event::Metadata { name, facts } => {
                let facts: Vec<_> = (facts.into_iter())
                    .filter_map(|(key, value)| Some((key.clone(), change(&key, value)?)))
                    .collect();
                out.extend(writer.metadata(&name, &facts));
            }
            Event::Attachment { name, data } => {
                if let Some(text) = change(&name, String::from_utf8(data).unwrap()) {
                    out.extend(writer.attachment(&name, "text/plain", 0, text.as_bytes()));
                }
            }
            Event::Message {
                channel,
                log_ns,
                publish_ns,
                data,
                ..
            } => writer.message(channel as usize, log_ns, publish_ns, &data),
            _ => {}
        }
    }
    out.extend(writer.take_chunk());
    out.extend(writer.finish());
    fs::write(to, out).unwrap();
}

/// What a recording says of its run is believed when it can be, and refused in one sentence when it cannot: nothing of the settings, a setting that
/// this version does not know, one that it does not allow, limits that no axis has. Another version is told.
#[test]
fn recordings_of_other_versions() {
    let folder = tempfile::tempdir().unwrap();
    let file = recorded(&folder.path().join("a"), "jpeg");
    let to = folder.path().join("changed.mcap");
    let with = |name: &'static str, text: Option<&'static str>| {
        changed(&file, &to, |found, old| match (found == name, text) {
            (true, Some(text)) => Some(text.to_owned()),
            (true, None) => None,
            (false, _) => Some(old),
        });
        let output = vergence(&["replay", to.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), said)
    };
    for (name, text, word) in [
        ("settings.toml", None, "lacks the settings"),
        ("settings.toml", Some("[run]\nwarp = 3\n"), "warp"),
        ("settings.toml", Some("nonsense"), "not TOML"),
        ("limits.json", Some("[]"), "limits.json"),
    ] {
        let (code, said) = with(name, text);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains(word), "{said}");
        let sentences = said.lines().filter(|l| !l.starts_with("hint:")).count();
        assert_eq!(sentences, 1, "{said}");
    }
    let (code, said) = with("version", Some("0.0.1"));
    assert!(
        code == Some(0) && said.contains("recorded by version 0.0.1"),
        "{said}"
    );
    let (code, said) = with("limits.json", None);
    assert!(code == Some(0) && said.is_empty(), "{said}");
}

/// An export writes into no folder that it did not make, and removes none.
#[test]
fn an_export_leaves_other_folders_alone() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("empty.mcap");
    fs::write(&file, b"\x89MCAP0\r\n").unwrap();
    let mine = folder.path().join("out.partial");
    fs::create_dir(&mine).unwrap();
    fs::write(mine.join("letter"), "mine").unwrap();
    let out = folder.path().join("out");
    let args = [
        "export",
        file.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let output = vergence(&args);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("out.partial is there already"), "{said}");
    assert!(!out.exists());
    assert_eq!(fs::read_dir(&mine).unwrap().count(), 1);
    assert_eq!(fs::read_to_string(mine.join("letter")).unwrap(), "mine");
    fs::remove_dir_all(&mine).unwrap();
    assert!(vergence(&args).status.success());
    assert!(out.is_dir() && !mine.exists());
}

/// Whether a film can be made and looked at here; says so when not.
#[cfg(unix)]
fn has_ffmpeg() -> bool {
    let there = ["ffmpeg", "ffprobe"]
        .map(|name| process::Command::new(name).arg("-version").output().is_ok());
    if there != [true; 2] {
        println!("skipped: no ffmpeg and ffprobe");
    }
    there == [true; 2]
}

/// What ffprobe says of the film: width, height, pictures, and duration in s.
#[cfg(unix)]
fn probed(film: &Path) -> [f64; 4] {
    let mut probe = process::Command::new("ffprobe");
    probe.args(["-v", "error", "-select_streams", "v:0", "-count_packets"]);
    let fields = "stream=width,height,nb_read_packets,duration";
    probe
        .args(["-show_entries", fields, "-of", "json"])
        .arg(film);
    let output = probe.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let stream = &found["streams"][0];
    // Some are numbers, some are words that are numbers.
    let number = |name: &str| match &stream[name] {
        serde_json::Value::String(text) => text.parse().unwrap(),
        value => value.as_f64().unwrap_or_else(|| panic!("{name}: {found}")),
    };
    ["width", "height", "nb_read_packets", "duration"].map(number)
}

/// `vergence export` where `PATH` is this folder; what it says.
#[cfg(unix)]
fn exported_on(path: &Path, file: &Path, out: &Path) -> (Output, String) {
    let [file, out] = [file, out].map(|p| p.to_str().unwrap());
    let mut export = running::command(&["export", file, "--out", out, "--format", "json"]);
    let output = export.env("PATH", path).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    (output, said)
}

/// A program of this name for which the shell does what `script` says.
#[cfg(unix)]
fn program(path: &Path, script: &str) {
    use std::os::unix::fs::PermissionsExt as _;
    fs::write(path, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
}

/// The film has both eyes side by side, a picture for every pair, and lasts as long as the pairs; so it does with an older ffmpeg, whose option has another
/// name. Where ffmpeg is not there, or fails, one sentence says so, everything else is written, and nothing is half-written.
#[cfg(unix)]
#[test]
fn an_export_makes_a_film() {
    let folder = tempfile::tempdir().unwrap();
    let file = recorded(&folder.path().join("a"), "jpeg");
    let programs = folder.path().join("programs");
    fs::create_dir(&programs).unwrap();
    for (name, script, why) in [
        (
            "none",
            None,
            "no video: the ffmpeg program is not installed",
        ),
        (
            "failing",
            Some(
                "echo half > \"$(eval echo \\${$#})\"; echo first >&2; echo 'no room' >&2; exit 1",
            ),
            "no video: ffmpeg failed: no room",
        ),
    ] {
        if let Some(script) = script {
            program(&programs.join("ffmpeg"), script);
        }
        let out = folder.path().join(name);
        let (output, said) = exported_on(&programs, &file, &out);
        assert!(output.status.success(), "{said}");
        assert_eq!(said, format!("{why}\nwrote {}\n", out.display()));
        let told: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(
            (&told["video"], &told["remarks"][0]),
            (&false.into(), &why.into())
        );
        let mut names: Vec<_> = (fs::read_dir(&out).unwrap())
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        let wanted = ["facts.json", "left", "numbers", "right", "settings.toml"];
        assert_eq!(names, wanted);
        let partial = folder.path().join(format!("{name}.partial"));
        assert!(!partial.exists());
    }
    if !has_ffmpeg() {
        return;
    }
    let usual = std::env::var("PATH").unwrap();
    let older = format!(
        "PATH='{usual}'\ncase \"$*\" in *fps_mode*) echo \"Unrecognized option 'fps_mode'.\" >&2; echo 'Option not found' >&2; exit 1;; esac\nexec ffmpeg \"$@\""
    );
    program(&programs.join("ffmpeg"), &older);
    for (name, path) in [("film", Path::new(&usual)), ("older", &programs)] {
        let out = folder.path().join(name);
        let (output, said) = exported_on(path, &file, &out);
        assert!(output.status.success(), "{said}");
        assert_eq!(said, format!("wrote {}\n", out.display()));
        let pairs = fs::read_to_string(out.join("numbers/pair.csv")).unwrap();
        let taken_s: Vec<f64> = (pairs.lines().skip(1))
            .map(|line| line.split(',').nth(1).unwrap().parse().unwrap())
            .collect();
        let seconds = taken_s.last().unwrap() - taken_s[0];
        let [width, height, pictures, duration_s] = probed(&out.join("side_by_side.mp4"));
        assert_eq!([width, height], [2.0 * 512.0, 384.0]);
        assert_eq!(pictures, taken_s.len() as f64);
        // Versions differ in whether the last picture has a time of its own, a thirtieth of a second.
        let more_s = duration_s - seconds;
        assert!(
            (-0.002..0.036).contains(&more_s),
            "{duration_s} s, not {seconds} s"
        );
        assert!(!out.join("left.txt").exists() && !out.join("right.txt").exists());
    }
}

/// `vergence` where no file may grow beyond so many blocks of 512 bytes: a disk that is full, or fills up.
#[cfg(target_os = "linux")]
fn vergence_on_small_disk(blocks: &str, args: &[&str]) -> Output {
    // The shell's signal for files that grow too large stays ignored in what it becomes: then the write fails.
    let script = "trap '' XFSZ; ulimit -f \"$1\"; shift; exec \"$@\"";
    std::process::Command::new("sh")
        .args(["-c", script, "sh", blocks, env!("CARGO_BIN_EXE_vergence")])
        .args(args)
        .output()
        .unwrap()
}

#[cfg(target_os = "linux")]
const ON_SMALL_DISK: [&str; 12] = [
    "run",
    "--fast",
    "--headless",
    "--seconds",
    "0.7s",
    "--set",
    "camera.width=256",
    "--set",
    "camera.height=192",
    "--set",
    "record.pictures=png",
    "--out",
];

/// A disk that is full from the start is one sentence with its remedy, and leaves nothing; so is one that takes the run's table and no recording.
#[cfg(target_os = "linux")]
#[test]
fn a_disk_full_from_the_start() {
    for (blocks, file) in [("0", "frames.csv"), ("4", "recording.mcap")] {
        let out = tempfile::tempdir().unwrap();
        let mut args = ON_SMALL_DISK.to_vec();
        args.push(out.path().to_str().unwrap());
        let output = vergence_on_small_disk(blocks, &args);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(said.lines().count(), 2, "{said}");
        assert!(
            said.contains(file) && said.contains("hint: make room"),
            "{said}"
        );
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
    }
}

/// A disk that fills up in mid-run ends no run: it is told once, the run goes to its end, and what is there stays and can be read.
#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up() {
    let out = tempfile::tempdir().unwrap();
    let mut args = ON_SMALL_DISK.to_vec();
    args.extend([out.path().to_str().unwrap(), "--format", "json"]);
    let output = vergence_on_small_disk("400", &args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["frames"], 21, "{said}");
    let told = said.matches("the recording has stopped").count();
    assert_eq!(told, 1, "{said}");
    assert!(summary["recording"]["failed"].is_string(), "{summary}");
    let folder = fs::read_dir(out.path())
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    assert!(folder.join("summary.json").is_file());
    let info = vergence(&["info", folder.join("recording.mcap").to_str().unwrap()]);
    let info = String::from_utf8_lossy(&info.stdout).into_owned();
    assert!(info.contains("was not finished"), "{info}");
}
