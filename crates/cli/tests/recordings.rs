//! Proves, with the real program on a small twin: a run records, `info` finds the file whole, a lossless recording replays bit for bit, the same seed
//! gives the same bytes, `export` writes every pair and number, hostile files are refused in a sentence. Real disks and real time are measured by hand.

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod running;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

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
