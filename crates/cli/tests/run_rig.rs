//! `vergence run` with cameras that stand on motors: two live streams through `ffmpeg` and a Grbl controller on a pseudo-terminal, both simulated by the test in
//! real time (`table`). Proves that the loop closes over them, that a camera that is unplugged holds the axes, that the recording of that replays bit for bit,
//! what is counted of the cameras is in it, and what a run does whose camera stays away; that a fault ends with the last decisions before it; that parking is left by the first Ctrl-C and the files are finished whatever comes after it; and that
//! combinations that make no sense are refused.

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod running;
mod table;

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use running::Ran;
use serde_json::Value;
use table::{Axes, Table};
use vergence_geometry::Eye;
use vergence_record::table::Row as _;
use vergence_record::{Recording, Topic, rows};

/// Pairs a second: what two cores render, send, read and follow beside each other.
const FPS: f64 = 15.0;

/// What happens in real time needs its processors: one test after the other.
static ALONE: Mutex<()> = Mutex::new(());

/// A rig without switches, whose zeros are where its axes stand: homed at once.
const BY_HAND: [&str; 2] = ["--set", "motors.grbl.homing=by_hand"];

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A run that goes on, with what it says line by line.
struct Going {
    child: Option<Child>,
    said: Receiver<String>,
    heard: String,
}

impl Going {
    fn start(args: &[&str], flags: &[String], out: &Path) -> Self {
        let mut command = running::command(&["run", "--headless"]);
        command.args(args).args(flags).arg("--out").arg(out);
        command.args(["--format", "json", "--set", "motors.grbl.silence=1s"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (tell, said) = channel();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        std::thread::spawn(move || lines.map_while(Result::ok).try_for_each(|l| tell.send(l)));
        Self {
            child: Some(child),
            said,
            heard: String::new(),
        }
    }

    /// Wait until it says a line with these words.
    fn wait_for(&mut self, words: &str) {
        let until = Instant::now() + Duration::from_secs(30);
        while !self.heard.lines().last().unwrap_or("").contains(words) {
            let left = until.saturating_duration_since(Instant::now());
            let line = self.said.recv_timeout(left);
            let line = line.unwrap_or_else(|_| panic!("never said '{words}': {}", self.heard));
            self.heard.push_str(&line);
            self.heard.push('\n');
        }
    }

    fn interrupt(&self) {
        let pid = self.child.as_ref().unwrap().id().to_string();
        let sent = Command::new("kill").args(["-INT", &pid]).status().unwrap();
        assert!(sent.success());
    }

    /// Wait for its end; all that it said is in the output.
    fn end(mut self) -> Output {
        let mut output = self.child.take().unwrap().wait_with_output().unwrap();
        for line in &self.said {
            self.heard.push_str(&line);
            self.heard.push('\n');
        }
        output.stderr = std::mem::take(&mut self.heard).into_bytes();
        output
    }
}

/// A test that fails leaves no program behind.
impl Drop for Going {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Wait until something is so.
fn until(what: &str, seconds: f64, is_so: impl Fn() -> bool) {
    let last = Instant::now() + Duration::from_secs_f64(seconds);
    while !is_so() {
        assert!(
            Instant::now() < last,
            "{what} did not come within {seconds} s"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn pause(seconds: f64) {
    std::thread::sleep(Duration::from_secs_f64(seconds));
}

/// Disparities of the person in what the cameras truly saw between two times, px. Parallel cameras would have 9 px at 5 m and 19 px at 2.5 m.
fn errors_px(table: &Table, from_s: f64, to_s: f64) -> Vec<f64> {
    let truths = table.truths(from_s, to_s);
    truths
        .iter()
        .filter_map(|t| Some(t.disparity_px()?.abs()))
        .collect()
}

fn is_converged(table: &Table) -> bool {
    let now_s = table.axes.now_s();
    let errors = errors_px(table, now_s - 0.5, now_s);
    errors.len() > 3 && errors.iter().all(|e| *e < 3.0)
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Names of the rig's states, one after the other.
fn states(summary: &Value) -> Vec<&str> {
    let changes = summary["rig_changes"].as_array().unwrap();
    changes.iter().map(|c| c["to"].as_str().unwrap()).collect()
}

#[test]
fn cameras_on_motors_close_the_loop() {
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        println!("skipped: no ffmpeg");
        return;
    }
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let walk = folder.path().join("walk.csv");
    std::fs::write(&walk, table::walk(table::TO_AND_FRO)).unwrap();
    let table = Table::start(folder.path(), &walk, FPS);
    it_converges_and_comes_back(&table, folder.path());
    a_camera_that_stays_away_fails_the_run(&table, folder.path());
}

/// From axes that have lost their zeros to a person who is held at zero parallax; a camera is unplugged, the axes hold, it comes back, and the person is held
/// again.
fn it_converges_and_comes_back(table: &Table, folder: &Path) {
    let args = ["--home", "--mode", "converged"];
    let args = [&args[..], &["--set", "record.pictures=png"]].concat();
    let mut run = Going::start(&args, &table.flags(), &folder.join("runs"));
    until("convergence", 30.0, || is_converged(table));
    let from_s = table.axes.now_s();
    pause(2.0);
    let errors = errors_px(table, from_s, table.axes.now_s());
    println!(
        "vergence error {:.2} px RMS over {} frames, pictures on their way after {:.0} ms",
        rms(&errors),
        errors.len(),
        1e3 * table.way_s().unwrap()
    );
    assert!(errors.len() > 15 && rms(&errors) < 3.0, "{errors:?}");

    table.plug(Eye::Left, false);
    run.wait_for("holding at");
    let why = run.heard.lines().last().unwrap_or("");
    // A machine that is too busy to hear the controller in time holds for that, just before.
    assert!(
        why.contains("the left camera's newest picture is") || why.contains("cannot serve"),
        "{why}"
    );
    pause(0.6);
    let now_s = table.axes.now_s();
    let [before, after] = [0.3, 0.05].map(|ago_s| table.axes.angles_deg(now_s - ago_s));
    for (before, after) in before.into_iter().zip(after) {
        assert!(
            (before - after).abs() < 0.01,
            "the axes move without a camera"
        );
    }
    table.plug(Eye::Left, true);
    run.wait_for("is back after");
    // The rig waits until all has been sound for a while.
    pause(0.7);
    until("convergence again", 15.0, || is_converged(table));
    run.interrupt();
    let ran = Ran::of(&run.end());
    let s = &ran.summary;
    let tracked = |states: &[&str]| states.contains(&"tracking");
    let states = states(s);
    let held = states.iter().position(|s| *s == "holding").unwrap();
    assert!(
        states[0] == "homing" && tracked(&states[..held]) && tracked(&states[held..]),
        "{s}"
    );
    assert_eq!(
        (&s["interrupted"], &s["rest"]["stopped"]),
        (&true.into(), &true.into()),
        "{s}"
    );
    assert_eq!(
        (
            ran.number("cameras.left.gone"),
            ran.number("cameras.left.back")
        ),
        (1.0, 1.0),
        "{s}"
    );
    // The controller's own audit of its motion, not the summary's: a reading that a busy machine hears late looks too fast there.
    assert_eq!(table.axes.limits_passed(), 0, "{s}");
    // What only the twin knows is not in it.
    assert_eq!(
        (&s["vergence_error_px"], &s["range_error"]),
        (&Value::Null, &Value::Null)
    );
    // Over the whole run, its beginning included; how well it converged the true cameras have told above.
    assert!(
        ran.number("latency_ms.p50") > 0.0 && ran.number("parallax_px.rms") > 0.0,
        "{s}"
    );
    its_cameras_are_on_record(&ran);
    it_replays_bit_for_bit(&ran);
}

/// Counts and times of the cameras stand in the recording, once a second and at the end, where they are those of the summary.
fn its_cameras_are_on_record(ran: &Ran) {
    let file = std::fs::File::open(ran.folder.join("recording.mcap")).unwrap();
    let mut recording = Recording::new(BufReader::new(file)).unwrap();
    let mut all = Vec::new();
    while let Some(message) = recording.next_message().unwrap() {
        if message.topic == Some(Topic::Cameras) {
            all.push(rows::Cameras::decode(&message.data).unwrap());
        }
    }
    let [first, .., last] = &all[..] else {
        panic!("{} rows of the cameras", all.len());
    };
    assert!(all.is_sorted_by(|a, b| a.time_s <= b.time_s && a.left_frames <= b.left_frames));
    let seconds = last.time_s - first.time_s;
    assert!(
        (all.len() as f64 - seconds).abs() < 3.0,
        "{} in {seconds} s",
        all.len()
    );
    let cameras = &ran.summary["cameras"];
    for (field, count) in [
        ("left.frames", last.left_frames),
        ("left.late", last.left_late),
        ("left.gone", last.left_gone),
        ("right.frames", last.right_frames),
        ("right.overrun", last.right_overrun),
        ("pairing.paired", last.paired),
        ("pairing.doubled", last.doubled),
    ] {
        let told = ran.number(&format!("cameras.{field}"));
        assert_eq!(told, count as f64, "{field}: {cameras}");
    }
    for (field, time_s) in [
        ("left.jitter.max_s", last.left_jitter_max_s),
        ("right.period.median_s", last.right_period_s),
        ("skew.p95_s", last.skew_p95_s),
    ] {
        let told = ran.number(&format!("cameras.{field}"));
        assert_eq!(Some(told), time_s, "{field}: {cameras}");
    }
    info_tells_of_them(ran, last);
}

/// `info` gives the last row by its names, and in words.
fn info_tells_of_them(ran: &Ran, last: &rows::Cameras) {
    let file = ran.folder.join("recording.mcap");
    let said = |format: &str| {
        let args = ["info", file.to_str().unwrap(), "--format", format];
        let output = running::command(&args).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let json: Value = serde_json::from_str(&said("json")).unwrap();
    let cameras = &json["cameras"];
    assert_eq!(cameras["left_gone"], last.left_gone);
    assert_eq!(cameras["skew_p95_s"].as_f64(), last.skew_p95_s);
    let text = said("text");
    let line = |name: &str| text.lines().find(|line| line.starts_with(name)).unwrap();
    let left = line("left camera");
    assert!(
        left.contains(&format!(" {} pictures, ", last.left_frames)),
        "{left}"
    );
    assert!(
        left.contains(&format!(", {} times gone", last.left_gone)),
        "{left}"
    );
    assert!(
        line("pairing").contains(&format!(" {} pairs, skew ", last.paired)),
        "{text}"
    );
}

/// What was recorded without loss of cameras that were turned, of a pause in which one was gone, and of axes that moved gives the same estimates in every bit.
fn it_replays_bit_for_bit(ran: &Ran) {
    for (axis, least_deg) in [("pan_deg", 2.0), ("left_deg", 0.3), ("right_deg", 0.3)] {
        let angles = ran.column(axis);
        let moved_deg = angles.iter().copied().fold(f64::MIN, f64::max)
            - angles.iter().copied().fold(f64::MAX, f64::min);
        assert!(moved_deg > least_deg, "{axis} moved by {moved_deg}° only");
    }
    // Pictures that the machine was too busy to record would be missed.
    assert_eq!(ran.number("recording.pictures_thinned"), 0.0);
    let file = ran.folder.join("recording.mcap");
    let replay = ["replay", "--strict", "--format", "json"];
    let start = Instant::now();
    let output = running::command(&replay).arg(&file).output().unwrap();
    let replay: Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("replayed in {:.1?}: {replay}", start.elapsed());
    assert!(
        output.status.success() && replay["lossless"] == true,
        "{output:?}"
    );
    // The two seconds at zero parallax at the least, of which a busy machine loses some.
    let least = (1.5 * FPS) as u64;
    assert!(replay["estimates"].as_u64().unwrap() >= least, "{replay}");
    assert_eq!(replay["equal"], replay["estimates"]);
    assert_eq!(
        (&replay["only_one"], &replay["without_pictures"]),
        (&0.into(), &0.into())
    );
}

fn a_camera_that_stays_away_fails_the_run(table: &Table, folder: &Path) {
    let args = [&BY_HAND[..], &["--no-record", "--home", "--seconds", "4s"]].concat();
    let run = Going::start(&args, &table.flags(), &folder.join("away"));
    // The cameras are there after a second, on a busy machine after three; they need not have found anybody.
    pause(3.5);
    table.plug(Eye::Right, false);
    let output = run.end();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains(
            "error: the rig ended holding its axes: the right camera's newest picture is"
        ),
        "{said}"
    );
    assert_eq!(said.matches(" went: ").count(), 1, "{said}");
}

/// The first Ctrl-C while the axes are parked stops them where they are; a second one at once after it changes nothing: the files are finished.
#[test]
fn ctrl_c_twice_while_parking_stops_and_finishes() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let walk = folder.path().join("walk.csv");
    // Near, so that parking takes most of a second.
    std::fs::write(&walk, table::walk(["0,2", "0.3,1.7", "-0.3,1.7"])).unwrap();
    let axes = Axes::start(folder.path());
    let left_deg = |at_s: f64| axes.angles_deg(at_s)[2];
    let twin = ["--path", walk.to_str().unwrap(), "--resolution", "512x384"];
    let more = ["--set", "camera.fps=15", "--home", "--mode", "converged"];
    let args = [&twin[..], &more, &["--no-record", "--seconds", "6s"]].concat();
    let mut run = Going::start(&args, &axes.flags(), &folder.path().join("runs"));
    run.wait_for("the axes stop and park");
    pause(0.15);
    let at_s = axes.now_s();
    run.interrupt();
    pause(0.02);
    run.interrupt();
    let output = run.end();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let ran = Ran::of(&output);
    assert_eq!(ran.summary["rest"]["stopped"], true, "{}", ran.summary);
    assert_eq!(ran.summary["rest"]["parked"], false, "{}", ran.summary);
    assert_eq!(ran.summary["interrupted"], true);
    assert_eq!(ran.rows.len() as f64, ran.number("frames"));
    // They were on their way, and stand where they were stopped.
    let [on_the_way, later] = [at_s, at_s + 0.4].map(left_deg);
    assert!(on_the_way > 0.4, "left vergence {on_the_way}°");
    assert!(
        (on_the_way - later).abs() < 0.35,
        "{on_the_way}°, then {later}°"
    );
}

/// An alarm of the controller in mid-run is a fault that waits for a person: the run goes on to its end with the axes standing, ends with exit code 1 and its
/// reason, and prints the last decisions before the fault, each with its time.
#[test]
fn a_fault_ends_with_the_last_decisions() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let walk = folder.path().join("walk.csv");
    std::fs::write(&walk, table::walk(["0,2", "0.3,1.7", "-0.3,1.7"])).unwrap();
    let axes = Axes::start(folder.path());
    let twin = ["--path", walk.to_str().unwrap(), "--resolution", "512x384"];
    let more = ["--set", "camera.fps=15", "--home", "--mode", "converged"];
    let args = [&twin[..], &more, &["--no-record", "--seconds", "8s"]].concat();
    let runs = folder.path().join("runs");
    let mut run = Going::start(&args, &axes.flags(), &runs);
    // Rows are written once the axes are homed: two seconds later they are in the file.
    until("rows", 30.0, || {
        let mut folders = std::fs::read_dir(&runs).into_iter().flatten();
        folders.any(|folder| {
            let file = folder.unwrap().path().join("frames.csv");
            std::fs::metadata(file).is_ok_and(|file| file.len() > 2000)
        })
    });
    axes.alarm();
    run.wait_for("fault at");
    let output = run.end();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let reason = "the rig ended in a fault: ";
    assert_eq!(
        said.matches(&format!("error: {reason}")).count(),
        1,
        "{said}"
    );
    // "    12.345 s  why", oldest first, twelve at most; the last is the fault itself or came after it.
    let decisions: Vec<(f64, &str)> = said
        .lines()
        .filter_map(|line| line.strip_prefix("  ")?.split_once(" s  "))
        .filter_map(|(time_s, why)| Some((time_s.trim().parse().ok()?, why)))
        .collect();
    assert!((2..=12).contains(&decisions.len()), "{said}");
    assert!(decisions.is_sorted_by(|a, b| a.0 <= b.0), "{said}");
    let why = said.lines().find_map(|line| line.split_once(reason));
    let why = why.unwrap().1;
    assert!(decisions.iter().any(|d| d.1 == why), "{why}: {said}");
    // The files are kept, with the same reason.
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["failed"], format!("{reason}{why}"));
    assert_eq!(*states(&summary).last().unwrap(), "fault", "{summary}");
    assert_eq!(summary["rest"]["parked"], false, "{summary}");
}

/// What makes no sense is refused before anything is opened, with what would be right.
#[test]
fn combinations_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let machine = table::machine(&vergence_capture::TwinConfig::default());
    machine.write(&here.join("machine.toml")).unwrap();
    std::fs::write(here.join("other.toml"), "format = \"vergence-rig\"\n").unwrap();
    let cameras = [
        "--source",
        "stream",
        "--left",
        "tcp://127.0.0.1:1",
        "--right",
        "tcp://127.0.0.1:2",
    ];
    let motors = ["--motors", "grbl:/dev/none"];
    let files = [
        "--source",
        "files",
        "--left",
        "l",
        "--right",
        "r",
        "--calibration",
        "machine.toml",
    ];
    for (first, more, told) in [
        (
            &files[..],
            &motors[..],
            "--motors has no meaning for recorded pictures",
        ),
        (
            &files,
            &["--home"],
            "--home has no meaning for recorded pictures",
        ),
        (
            &cameras,
            &["--home", "--calibration", "machine.toml"],
            "--home has no meaning for cameras that stand still",
        ),
        (
            &cameras,
            &["--motors", "simulated"],
            "simulated motors turn no real camera",
        ),
        (
            &cameras,
            &motors,
            "cameras on grbl:/dev/none need --calibration, the file of the machine",
        ),
        (
            &cameras,
            &["--motors", "grbl:/dev/none", "--calibration", "true"],
            "--calibration true is for the twin",
        ),
        (
            &cameras,
            &["--motors", "grbl:/dev/none", "--calibration", "other.toml"],
            "other.toml is no calibration of a machine",
        ),
        (
            &cameras,
            &[
                "--motors",
                "grbl:/dev/none",
                "--calibration",
                "machine.toml",
                "--unit",
                "mm",
            ],
            "--unit has no meaning for the calibration of a machine",
        ),
        (
            &cameras,
            &[
                "--motors",
                "grbl:/dev/none",
                "--calibration",
                "machine.toml",
                "--fast",
            ],
            "--fast has no meaning for cameras",
        ),
        (
            &cameras,
            &["--motors", "serial:x", "--calibration", "machine.toml"],
            "motors 'serial:x' name no controller",
        ),
        (
            &cameras,
            &["--calibration", "machine.toml"],
            "machine.toml is the calibration of a machine",
        ),
        (
            &cameras,
            &["--calibration", "machine.toml", "--delay", "5s"],
            "--delay '5s': must be between 0 and 2 s",
        ),
        (
            &["--seconds", "1s"],
            &["--delay", "5ms"],
            "--delay has no meaning for the twin",
        ),
    ] {
        let mut command = running::command(&[&["run", "--headless"], first, more].concat());
        let output = command.current_dir(here).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{more:?}: {said}");
        assert!(
            said.starts_with(&format!("error: {told}")),
            "{more:?}: {said}"
        );
        assert!(
            said.lines().count() <= 2 && output.stdout.is_empty(),
            "{said}"
        );
    }
    // Where the settings name the controller, no flag can be left out: the line to change is told.
    std::fs::write(
        here.join("rig.toml"),
        "[motors]\ncontroller = \"grbl:/dev/none\"\n",
    )
    .unwrap();
    for more in [&["--calibration", "other.toml"][..], &[]] {
        let run = ["--config", "rig.toml", "run", "--headless"];
        let mut command = running::command(&[&run[..], &cameras, more].concat());
        let output = command.current_dir(here).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(
            said.contains("set motors.controller (rig.toml line 2) to \"simulated\""),
            "{said}"
        );
    }
    assert!(!here.join("runs").exists());
}
