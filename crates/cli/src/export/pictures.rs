//! Pictures as they were recorded, and a film of both side by side.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use vergence_record::foxglove::image_in;
use vergence_record::recording::Message;
use vergence_record::rows;
use vergence_record::table::Row as _;

use crate::fault::{self, Fault};

/// Name of the film.
pub(super) const VIDEO: &str = "side_by_side.mp4";

/// Time for which the last picture is to be shown, s (ffmpeg 5.1 leaves it out, and players hold that picture), and the longest for any: a
/// recording with false times makes no film of years.
const LAST_S: f64 = 1.0 / 30.0;
const LONGEST_S: f64 = 3600.0;

/// The pictures of an export while they are written.
pub(super) struct Pictures {
    folder: PathBuf,
    /// Pictures of the moment that is being read: their recording time and their files.
    waiting: [Option<(u64, Vec<u8>, &'static str)>; 2],
    /// Pairs as written: names of both files and their time, s.
    written: Vec<([String; 2], f64)>,
}

impl Pictures {
    pub(super) fn new(folder: &Path) -> Result<Self, Fault> {
        for eye in ["left", "right"] {
            let path = folder.join(eye);
            std::fs::create_dir_all(&path)
                .map_err(|e| fault::failed(format!("cannot make {}: {e}", path.display())))?;
        }
        Ok(Self {
            folder: folder.to_owned(),
            waiting: [None, None],
            written: Vec::new(),
        })
    }

    /// Pairs written.
    pub(super) fn pairs(&self) -> u64 {
        self.written.len() as u64
    }

    /// A picture; it is written when its pair is known.
    pub(super) fn take(&mut self, eye: usize, message: &Message) -> Result<(), Fault> {
        let Some((file, format)) = image_in(&message.data) else {
            return Ok(());
        };
        // The name of a file never comes from the recording.
        let extension = match format {
            "png" => "png",
            "jpeg" => "jpg",
            _ => return Ok(()),
        };
        self.waiting[eye] = Some((message.log_ns, file.to_vec(), extension));
        Ok(())
    }

    /// The pair to which the pictures of the same moment belong.
    pub(super) fn pair(&mut self, message: &Message) -> Result<(), Fault> {
        let waiting = std::mem::take(&mut self.waiting);
        let [Some(left), Some(right)] = waiting else {
            return Ok(());
        };
        if left.0 != message.log_ns || right.0 != message.log_ns {
            return Ok(());
        }
        let Ok(pair) = rows::Pair::decode(&message.data) else {
            return Ok(());
        };
        let mut names = [String::new(), String::new()];
        for (eye, (_, file, extension)) in [left, right].into_iter().enumerate() {
            let name = format!("{}/{:06}.{extension}", ["left", "right"][eye], pair.index);
            crate::output::write_file(&self.folder.join(&name), &file)
                .map_err(|e| fault::failed(e.to_string()))?;
            names[eye] = name;
        }
        let time_s = (pair.left_capture_s + pair.right_capture_s) / 2.0;
        self.written.push((names, time_s));
        Ok(())
    }

    /// Make the film; whether there is one. The error says why not, when pictures are there.
    pub(super) fn video(&self) -> Result<bool, String> {
        if self.written.is_empty() {
            return Ok(false);
        }
        let lists = ["left.txt", "right.txt"].map(|name| self.folder.join(name));
        for (eye, path) in lists.iter().enumerate() {
            std::fs::write(path, self.list(eye)).map_err(|e| format!("no video: {e}"))?;
        }
        let made = self.ffmpeg(&lists);
        for path in &lists {
            // Best effort: two small lists more in the folder do no harm.
            let _ = std::fs::remove_file(path);
        }
        made.map(|()| true)
    }

    /// The pictures of one eye with the times for which they are shown, as ffmpeg's concat reader takes them.
    fn list(&self, eye: usize) -> String {
        let mut text = String::from("ffconcat version 1.0\n");
        for (index, (names, time_s)) in self.written.iter().enumerate() {
            let next_s = self.written.get(index + 1).map_or(time_s + LAST_S, |n| n.1);
            let shown_s = (next_s - time_s).clamp(0.001, LONGEST_S);
            let _ = writeln!(
                text,
                "file '{}'\noption framerate 90000\nduration {shown_s:.6}",
                names[eye]
            );
        }
        text
    }

    /// Let ffmpeg make the film; nothing of it is left when it does not.
    fn ffmpeg(&self, lists: &[PathBuf; 2]) -> Result<(), String> {
        let mut failed = self.words_of_ffmpeg("-fps_mode", lists)?;
        if failed.as_ref().is_some_and(|w| w.contains("fps_mode")) {
            // Before version 5.1 the option had another name, which newer ones are about to drop.
            failed = self.words_of_ffmpeg("-vsync", lists)?;
        }
        let Some(words) = failed else {
            return Ok(());
        };
        // Best effort: what is told is why there is no film.
        let _ = std::fs::remove_file(self.folder.join(VIDEO));
        let last = words.lines().last().unwrap_or("it gave no reason");
        Err(format!("no video: ffmpeg failed: {}", last.trim()))
    }

    /// Call ffmpeg with this name of the option that keeps the times of the pictures; what it says when it fails.
    fn words_of_ffmpeg(
        &self,
        option: &str,
        lists: &[PathBuf; 2],
    ) -> Result<Option<String>, String> {
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-loglevel", "error", "-y"]);
        for list in lists {
            // The lists are ours; their option, times finer than 1/25 s, is not among those that ffmpeg calls safe.
            command.args(["-f", "concat", "-safe", "0", "-i"]).arg(list);
        }
        // H.264 wants even sides.
        let filter = "[0:v][1:v]hstack,crop=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p";
        command
            .args(["-filter_complex", filter, option, "vfr", "-c:v", "libx264"])
            .args(["-preset", "veryfast", "-crf", "20"])
            .args(["-movflags", "+faststart"])
            .arg(self.folder.join(VIDEO))
            .stdin(Stdio::null());
        let output = command.output().map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => {
                "no video: the ffmpeg program is not installed".to_owned()
            }
            _ => format!("no video: ffmpeg could not be started: {e}"),
        })?;
        let words = || String::from_utf8_lossy(&output.stderr).into_owned();
        Ok((!output.status.success()).then(words))
    }
}
