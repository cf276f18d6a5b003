//! Videos, decoded by the program `ffmpeg` and read through a pipe.
//!
//! The pipe carries PPM pictures: each says its own size, so a turned or rescaled video cannot be misread. `ffmpeg` is told
//! to give a constant frame rate, the video's own, so that frame n belongs to n / fps seconds after the start even where
//! the recording skipped some.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Deserialize;
use vergence_imaging::{Rgb, files};

use crate::CaptureError;
use crate::files::stream::{Decoder, EyeStream, Timed};
use crate::files::{MAX_FPS, OnFault};

/// How often, and how often at most, a program is asked whether it has ended: 20 s in all.
const ASK_EVERY: Duration = Duration::from_millis(10);
const ASKS: usize = 2000;

/// Most bytes of a program's complaints that are read; the last line is quoted.
const MAX_COMPLAINT: usize = 500;

/// Most bytes of answers that are read from `ffprobe`.
const MAX_ANSWER: u64 = 1 << 20;

/// Relative difference of two frame rates that are still the same (30 and 30000/1001 are not).
const SAME_FPS: f64 = 5e-4;

/// What is known of a video before it is decoded.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    fps_num: u32,
    fps_den: u32,
}

#[derive(Deserialize)]
struct Answer {
    #[serde(default)]
    streams: Vec<StreamAnswer>,
}

#[derive(Deserialize)]
struct StreamAnswer {
    #[serde(default)]
    avg_frame_rate: String,
    #[serde(default)]
    r_frame_rate: String,
}

impl Video {
    /// Ask `ffprobe` for the frame rate.
    pub(crate) fn probe(
        path: &Path,
        ffmpeg: &Path,
        wanted_fps: Option<f64>,
    ) -> Result<Self, CaptureError> {
        let refuse = |reason: String| CaptureError::Video {
            program: "ffprobe",
            reason,
            path: path.to_owned(),
        };
        let mut command = Command::new(ffmpeg.with_file_name("ffprobe"));
        command
            .args(["-v", "error", "-select_streams", "v:0", "-of", "json"])
            .args(["-show_entries", "stream=avg_frame_rate,r_frame_rate", "-i"])
            .arg(input_name(path));
        let (child, stdout) = Program::start(command, "ffprobe", path)?;
        let _guard = ChildGuard(child.child.clone());
        // Reading is done by a thread, so that a network that says nothing cannot hold us for ever.
        let reader = std::thread::spawn(move || {
            let mut text = String::new();
            let read = stdout.take(MAX_ANSWER).read_to_string(&mut text);
            read.map(|_| text)
        });
        let status = child.wait();
        let last_words = child.last_words();
        let text = reader.join();
        match status {
            None => return Err(refuse("gave no answer within 20 s".to_owned())),
            Some(status) if !status.success() => {
                return Err(refuse(match last_words.as_str() {
                    "" => "cannot read it and gives no reason".to_owned(),
                    words => format!("cannot read it: {words}"),
                }));
            }
            Some(_) => {}
        }
        let answer: Option<Answer> = match text {
            Ok(Ok(text)) => serde_json::from_str(&text).ok(),
            _ => None,
        };
        let stream = answer
            .and_then(|a| a.streams.into_iter().next())
            .ok_or_else(|| refuse("found no video in it".to_owned()))?;
        let (fps_num, fps_den) = rate(&stream.avg_frame_rate)
            .or_else(|| rate(&stream.r_frame_rate))
            .ok_or_else(|| refuse("found no frame rate in it".to_owned()))?;
        let video = Self {
            path: path.to_owned(),
            fps_num,
            fps_den,
        };
        if let Some(wanted) = wanted_fps
            && (wanted / video.fps() - 1.0).abs() > SAME_FPS
        {
            return Err(CaptureError::Input {
                reason: format!(
                    "the video has {} frames per second, but fps is set to {wanted}",
                    video.fps()
                ),
                path: path.to_owned(),
            });
        }
        Ok(video)
    }

    /// Frames per second.
    pub(crate) fn fps(&self) -> f64 {
        f64::from(self.fps_num) / f64::from(self.fps_den)
    }

    /// Start decoding.
    pub(crate) fn open(
        self,
        ffmpeg: &Path,
        on_unreadable: OnFault,
    ) -> Result<EyeStream, CaptureError> {
        let mut command = Command::new(ffmpeg);
        command.args(["-nostdin", "-v", "error"]);
        // A damaged file is an error; a damaged packet of a live stream is daily life.
        let strict = on_unreadable == OnFault::Refuse && !is_url(&self.path);
        if strict {
            command.arg("-xerror");
        }
        command
            .arg("-i")
            .arg(input_name(&self.path))
            .args(["-map", "0:v:0", "-an", "-sn", "-dn"])
            .args(["-sws_flags", "accurate_rnd+full_chroma_int+bitexact"])
            .args(["-r", &format!("{}/{}", self.fps_num, self.fps_den)])
            .args([
                "-f",
                "image2pipe",
                "-c:v",
                "ppm",
                "-pix_fmt",
                "rgb24",
                "pipe:1",
            ]);
        let (program, stdout) = Program::start(command, "ffmpeg", &self.path)?;
        let guard = ChildGuard(program.child.clone());
        let path = self.path.clone();
        let decoder = VideoDecoder {
            pipe: BufReader::with_capacity(1 << 20, stdout),
            program,
            count: 0,
            size: None,
            strict,
            video: self,
        };
        EyeStream::of_video(decoder, guard, path)
    }
}

/// Reads PPM pictures from the pipe.
struct VideoDecoder {
    pipe: BufReader<ChildStdout>,
    program: Program,
    count: u64,
    size: Option<(usize, usize)>,
    /// Whether a complaint is an error even if the program went on.
    strict: bool,
    video: Video,
}

impl Decoder for VideoDecoder {
    fn next(&mut self, reuse: Option<Rgb>) -> Result<Option<Timed>, CaptureError> {
        let read = self.read_picture(reuse);
        let ended = matches!(read, Ok(None));
        match read {
            Ok(Some(picture)) => {
                let index = self.count as f64;
                self.count += 1;
                Ok(Some(Timed {
                    time_s: index * f64::from(self.video.fps_den) / f64::from(self.video.fps_num),
                    picture: Some(picture),
                }))
            }
            Ok(None) | Err(_) => {
                let status = self.program.wait();
                let last_words = self.program.last_words();
                let well = ended && status.is_some_and(|s| s.success());
                if well && (last_words.is_empty() || !self.strict) {
                    return Ok(None);
                }
                let reason = match last_words.as_str() {
                    "" if status.is_none() => {
                        format!("stopped answering after {} frames", self.count)
                    }
                    "" => format!(
                        "broke off after {} frames without giving a reason",
                        self.count
                    ),
                    words => format!("gave {} frames and complained: {words}", self.count),
                };
                Err(CaptureError::Video {
                    program: "ffmpeg",
                    reason,
                    path: self.video.path.clone(),
                })
            }
        }
    }
}

impl VideoDecoder {
    /// One picture, `None` at the end of the stream, an error where it breaks off.
    fn read_picture(&mut self, reuse: Option<Rgb>) -> std::io::Result<Option<Rgb>> {
        if self.pipe.fill_buf()?.is_empty() {
            return Ok(None);
        }
        let broken = || std::io::Error::from(std::io::ErrorKind::InvalidData);
        let mut fields = [0_usize; 3];
        if read_word(&mut self.pipe)? != "P6" {
            return Err(broken());
        }
        for field in &mut fields {
            *field = read_word(&mut self.pipe)?.parse().map_err(|_| broken())?;
        }
        let [w, h, depth] = fields;
        let side = files::MAX_SIDE as usize;
        if w == 0 || h == 0 || w > side || h > side || depth != 255 {
            return Err(broken());
        }
        if w * h * 3 > files::MAX_DECODE_BYTES as usize
            || *self.size.get_or_insert((w, h)) != (w, h)
        {
            return Err(broken());
        }
        let mut picture = match reuse {
            Some(old) if old.size() == (w, h) => old,
            _ => Rgb::filled(w, h, [0; 3]),
        };
        self.pipe
            .read_exact(picture.samples_mut().as_flattened_mut())?;
        Ok(Some(picture))
    }
}

/// A word of a PPM header and the one white space after it.
fn read_word(pipe: &mut impl std::io::Read) -> std::io::Result<String> {
    let mut word = String::new();
    loop {
        let mut byte = [0];
        pipe.read_exact(&mut byte)?;
        if byte[0].is_ascii_whitespace() {
            return Ok(word);
        }
        if word.len() == 12 || !byte[0].is_ascii() {
            return Err(std::io::ErrorKind::InvalidData.into());
        }
        word.push(char::from(byte[0]));
    }
}

/// A running program whose complaints are collected.
struct Program {
    child: Arc<Mutex<Child>>,
    complaints: Mutex<Option<JoinHandle<String>>>,
}

impl Program {
    fn start(
        mut command: Command,
        name: &'static str,
        path: &Path,
    ) -> Result<(Self, ChildStdout), CaptureError> {
        let refuse = |reason: String| CaptureError::Video {
            program: name,
            reason,
            path: path.to_owned(),
        };
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|e| {
            refuse(format!(
                "could not be started ({e}); videos need the programs ffmpeg and ffprobe, folders of pictures do not"
            ))
        })?;
        let pipes = (child.stdout.take(), child.stderr.take());
        let child = Arc::new(Mutex::new(child));
        let (Some(stdout), Some(stderr)) = pipes else {
            drop(ChildGuard(child));
            return Err(refuse("was started without pipes".to_owned()));
        };
        let complaints = std::thread::spawn(move || last_line(stderr));
        let program = Self {
            child,
            complaints: Mutex::new(Some(complaints)),
        };
        Ok((program, stdout))
    }

    /// The status with which the program ended; it is ended when it does not do so by itself (`None`).
    fn wait(&self) -> Option<ExitStatus> {
        for _ in 0..ASKS {
            match lock(&self.child).try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) => std::thread::sleep(ASK_EVERY),
                Err(_) => break,
            }
        }
        end(&self.child);
        None
    }

    /// The last line that the program wrote on its standard error, once and only after it has ended; empty if none.
    fn last_words(&self) -> String {
        let complaints = self
            .complaints
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        match complaints.map(JoinHandle::join) {
            Some(Ok(line)) => line,
            _ => String::new(),
        }
    }
}

/// Ends and reaps a program when dropped.
#[derive(Debug)]
pub(crate) struct ChildGuard(Arc<Mutex<Child>>);

impl Drop for ChildGuard {
    fn drop(&mut self) {
        end(&self.0);
    }
}

fn end(child: &Mutex<Child>) {
    let mut child = lock(child);
    // Both fail only for a program that has ended and been reaped already.
    let _ = child.kill();
    let _ = child.wait();
}

fn lock(child: &Mutex<Child>) -> std::sync::MutexGuard<'_, Child> {
    child.lock().unwrap_or_else(PoisonError::into_inner)
}

fn last_line(stderr: impl std::io::Read) -> String {
    let mut pipe = BufReader::new(stderr);
    let mut last = String::new();
    loop {
        let mut line = Vec::new();
        match (&mut pipe).take(64 << 10).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return last,
            Ok(_) => {
                let line = String::from_utf8_lossy(&line);
                if !line.trim().is_empty() {
                    last = line.trim().chars().take(MAX_COMPLAINT).collect();
                }
            }
        }
    }
}

fn is_url(path: &Path) -> bool {
    path.to_str().is_some_and(|s| s.contains("://"))
}

/// The name as `ffmpeg` shall read it: without the prefix a colon in a file's name would choose a protocol.
fn input_name(path: &Path) -> std::ffi::OsString {
    if is_url(path) {
        return path.as_os_str().to_owned();
    }
    let mut name = std::ffi::OsString::from("file:");
    name.push(path);
    name
}

/// "30000/1001" as two numbers; `None` for "0/0" and anything outside 0..=[`MAX_FPS`].
fn rate(text: &str) -> Option<(u32, u32)> {
    let (num, den) = text.split_once('/')?;
    let (num, den): (u32, u32) = (num.parse().ok()?, den.parse().ok()?);
    let fps = f64::from(num) / f64::from(den);
    (den > 0 && fps > 0.0 && fps <= MAX_FPS).then_some((num, den))
}
