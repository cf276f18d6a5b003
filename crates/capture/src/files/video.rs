//! Videos, decoded by the program `ffmpeg` and read through a pipe.
//!
//! The pipe carries PPM pictures: each says its own size, so a turned or rescaled video cannot be misread. Every frame keeps
//! the time that the file gives it, counted from the file's start: the filter `showinfo` tells it on standard error while the frame
//! itself goes through the pipe. Where a recording skipped frames there are none, and nothing is repeated in their place.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Deserialize;
use vergence_imaging::{Rgb, files};

use crate::CaptureError;
use crate::files::stream::{Decoder, EyeStream, Timed};
use crate::files::{MAX_FPS, OnFault};
use crate::secrets::{cleaned, shown_path};

/// How often, and how often at most, a program is asked whether it has ended: 20 s in all.
const ASK_EVERY: Duration = Duration::from_millis(10);
const ASKS: usize = 2000;

/// Most characters of a program's last complaint that are quoted.
const MAX_COMPLAINT: usize = 500;

/// Most bytes of answers that are read from `ffprobe`.
const MAX_ANSWER: u64 = 1 << 20;

/// Relative difference of two frame rates that are still the same (30 and 30000/1001 are not).
const SAME_FPS: f64 = 5e-4;

/// How much faster than on average the nominal rate may be: a file whose base rate is far above its average has no even rate.
const NOMINAL_OVER_AVERAGE: f64 = 1.5;

/// Rate at which frames pass through `ffmpeg`, 1/s. They are renumbered for it, so that it neither repeats nor drops any; their
/// times are told apart from it.
const PASSING_FPS: &str = "25";

/// Most times that are told ahead of their frames: `ffmpeg` holds back a few dozen at most. Beyond it the program waits for the reader.
const TIMES_AHEAD: usize = 1024;

/// What is known of a video before it is decoded.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    /// Nominal frame rate: numerator and denominator.
    rate: (u32, u32),
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
            path: shown_path(path),
        };
        let mut command = Command::new(ffmpeg.with_file_name("ffprobe"));
        command
            .args(["-v", "error", "-select_streams", "v:0", "-of", "json"])
            .args(["-show_entries", "stream=avg_frame_rate,r_frame_rate", "-i"])
            .arg(input_name(path));
        let (child, stdout) = Program::start(command, "ffprobe", path, Listener::Plain)?;
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
        let text = text.ok().and_then(Result::ok).unwrap_or_default();
        let rate =
            rate_in_answer(&text).map_err(|what| refuse(format!("found no {what} in it")))?;
        let video = Self {
            path: path.to_owned(),
            rate,
        };
        if let Some(wanted) = wanted_fps
            && (wanted / video.fps() - 1.0).abs() > SAME_FPS
        {
            return Err(CaptureError::Input {
                reason: format!(
                    "the video has {} frames per second, but fps is set to {wanted}",
                    video.fps()
                ),
                path: shown_path(path),
            });
        }
        Ok(video)
    }

    /// Frames per second, nominally: a recording that lost frames has fewer.
    pub(crate) fn fps(&self) -> f64 {
        quotient(self.rate)
    }

    /// A stream that is read as it comes: nothing is asked beforehand, and times are taken to the microsecond.
    pub(crate) fn live(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            rate: (1_000_000, 1),
        }
    }

    /// Start decoding a recording.
    pub(crate) fn open(
        self,
        ffmpeg: &Path,
        on_unreadable: OnFault,
    ) -> Result<EyeStream, CaptureError> {
        // A damaged file is an error; a damaged packet of a live stream is daily life.
        let strict = on_unreadable == OnFault::Refuse && !is_url(&self.path);
        let input: &[&str] = if strict { &["-xerror"] } else { &[] };
        self.start(ffmpeg, input, strict)
    }

    /// Start decoding what comes live; `input` are options of the input.
    pub(crate) fn open_live(
        self,
        ffmpeg: &Path,
        input: &[&str],
    ) -> Result<EyeStream, CaptureError> {
        self.start(ffmpeg, input, false)
    }

    fn start(self, ffmpeg: &Path, input: &[&str], strict: bool) -> Result<EyeStream, CaptureError> {
        let mut command = Command::new(ffmpeg);
        command.args([
            "-nostdin",
            "-hide_banner",
            "-nostats",
            "-v",
            "repeat+level+info",
        ]);
        command
            .args(input)
            .arg("-i")
            .arg(input_name(&self.path))
            .args(["-map", "0:v:0", "-an", "-sn", "-dn"])
            .args(["-sws_flags", "accurate_rnd+full_chroma_int+bitexact"])
            .args(["-vf", &format!("{SHOWINFO},settb=1/{PASSING_FPS},setpts=N")])
            .args(["-r", PASSING_FPS])
            .args([
                "-f",
                "image2pipe",
                "-c:v",
                "ppm",
                "-pix_fmt",
                "rgb24",
                "pipe:1",
            ]);
        let (to_decoder, times) = sync_channel(TIMES_AHEAD);
        let listener = Listener::Ffmpeg(to_decoder);
        let (program, stdout) = Program::start(command, "ffmpeg", &self.path, listener)?;
        let guard = ChildGuard(program.child.clone());
        let path = shown_path(&self.path);
        let decoder = VideoDecoder {
            pipe: BufReader::with_capacity(1 << 20, stdout),
            program,
            times,
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
    /// Times of the frames in their order, as they are told.
    times: Receiver<FrameTime>,
    count: u64,
    size: Option<(usize, usize)>,
    /// Whether a complaint is an error even if the program went on.
    strict: bool,
    video: Video,
}

impl Decoder for VideoDecoder {
    fn next(&mut self, reuse: Option<Rgb>) -> Result<Option<Timed>, CaptureError> {
        match picture_from_ppm(&mut self.pipe, &mut self.size, reuse) {
            Ok(Some(picture)) => {
                // The time is told before the frame is encoded, so it is on its way.
                let time = self.times.recv_timeout(ASK_EVERY * ASKS as u32);
                let Ok(Some(time_s)) = time.map(|t| t.seconds(self.video.rate)) else {
                    return Err(
                        self.fault(format!("did not tell when frame {} was taken", self.count))
                    );
                };
                self.count += 1;
                Ok(Some(Timed {
                    time_s,
                    picture: Some(picture),
                }))
            }
            Ok(None) => self.ended(true),
            Err(e) => {
                if e.kind() == std::io::ErrorKind::InvalidData {
                    // It still has frames to give that nobody will take.
                    end(&self.program.child);
                }
                self.ended(false)
            }
        }
    }
}

impl VideoDecoder {
    /// What the end of the pipe means, `clean` between two pictures or not.
    fn ended(&mut self, clean: bool) -> Result<Option<Timed>, CaptureError> {
        let status = self.program.wait();
        // Until the listener has heard all: it waits for room while there are more times than frames were asked for.
        let withheld = self.times.iter().count();
        let last_words = self.program.last_words();
        let well = clean && status.is_some_and(|s| s.success());
        if well && !self.strict {
            return Ok(None);
        }
        Err(self.fault(match last_words.as_str() {
            "" if well && withheld == 0 => return Ok(None),
            "" if well => format!("gave {} frames and withheld {withheld}", self.count),
            "" if status.is_none() => format!("stopped answering after {} frames", self.count),
            "" => format!(
                "broke off after {} frames without giving a reason",
                self.count
            ),
            words => format!("gave {} frames and complained: {words}", self.count),
        }))
    }

    fn fault(&self, reason: String) -> CaptureError {
        CaptureError::Video {
            program: "ffmpeg",
            reason,
            path: shown_path(&self.video.path),
        }
    }
}

/// One picture, `None` at the end of the stream, an error where it breaks off or where a picture has another size than the first one.
fn picture_from_ppm(
    pipe: &mut impl std::io::BufRead,
    size: &mut Option<(usize, usize)>,
    reuse: Option<Rgb>,
) -> std::io::Result<Option<Rgb>> {
    if pipe.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let broken = || std::io::Error::from(std::io::ErrorKind::InvalidData);
    let mut fields = [0_usize; 3];
    if read_word(pipe)? != "P6" {
        return Err(broken());
    }
    for field in &mut fields {
        *field = read_word(pipe)?.parse().map_err(|_| broken())?;
    }
    let [w, h, depth] = fields;
    let side = files::MAX_SIDE as usize;
    if w == 0 || h == 0 || w > side || h > side || depth != 255 {
        return Err(broken());
    }
    if w * h * 3 > files::MAX_DECODE_BYTES as usize || *size.get_or_insert((w, h)) != (w, h) {
        return Err(broken());
    }
    let mut picture = match reuse {
        Some(old) if old.size() == (w, h) => old,
        _ => Rgb::filled(w, h, [0; 3]),
    };
    pipe.read_exact(picture.samples_mut().as_flattened_mut())?;
    Ok(Some(picture))
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
        listener: Listener,
    ) -> Result<(Self, ChildStdout), CaptureError> {
        let refuse = |reason: String| CaptureError::Video {
            program: name,
            reason,
            path: shown_path(path),
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
        let about = path.to_owned();
        let complaints = std::thread::spawn(move || listener.last_complaint(stderr, &about));
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

    /// The last complaint that the program wrote on its standard error, once and only after it has ended; empty if none.
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

/// Name of the filter that tells the frames' times, as it is asked for and as its lines begin; sums of the pixels are left out.
const SHOWINFO: &str = "showinfo=checksum=0";
const SHOWINFO_LINE: &str = "[Parsed_showinfo_";

/// The time of a frame as the file gives it: a number of ticks, and how many seconds each has.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FrameTime {
    ticks: i64,
    tick: (u32, u32),
}

impl FrameTime {
    /// Seconds from the start of the file. Ticks of a millisecond are coarse against a frame's period; within one tick of where an even
    /// rate has a frame, the frame is there.
    fn seconds(self, rate: (u32, u32)) -> Option<f64> {
        let (num, den) = self.tick;
        let seconds = self.ticks as f64 * f64::from(num) / f64::from(den);
        let frame = (seconds * f64::from(rate.0) / f64::from(rate.1)).round();
        let even = frame * f64::from(rate.1) / f64::from(rate.0);
        let near = (even - seconds).abs() <= quotient(self.tick);
        Some(if near { even } else { seconds }).filter(|s| s.is_finite())
    }
}

/// What is done with a program's standard error.
enum Listener {
    /// Every line is a complaint.
    Plain,
    /// Lines are marked with their level, and the filter tells times between them.
    Ffmpeg(SyncSender<FrameTime>),
}

impl Listener {
    /// Listen to the end; the last complaint, without what is secret in the address of `about`.
    fn last_complaint(self, stderr: impl std::io::Read, about: &Path) -> String {
        let mut pipe = BufReader::new(stderr);
        let (mut last, mut tick) = (String::new(), None);
        loop {
            let mut line = Vec::new();
            match (&mut pipe).take(64 << 10).read_until(b'\n', &mut line) {
                Ok(0) | Err(_) => return last,
                Ok(_) => {}
            }
            let line = String::from_utf8_lossy(&line);
            let complaint = match &self {
                Self::Plain => Some(line.trim().to_owned()),
                Self::Ffmpeg(times) => {
                    if line.starts_with(SHOWINFO_LINE) {
                        tick = tick_in(&line).or(tick);
                        if let (Some(ticks), Some(tick)) = (ticks_in(&line), tick) {
                            // A decoder that is gone needs no times; complaints are still heard.
                            let _ = times.send(FrameTime { ticks, tick });
                        }
                    }
                    complaint_in(&line)
                }
            };
            if let Some(words) = complaint.filter(|words| !words.is_empty()) {
                // Before it is cut short: half an address is not known again.
                last = cleaned(&words, about).chars().take(MAX_COMPLAINT).collect();
            }
        }
    }
}

/// "config in time_base: 1/1000" as two numbers.
fn tick_in(line: &str) -> Option<(u32, u32)> {
    let (_, rest) = line.split_once("config in time_base:")?;
    let (num, den) = rest
        .trim_start()
        .split([',', ' '])
        .next()?
        .split_once('/')?;
    let (num, den) = (num.parse().ok()?, den.parse().ok()?);
    (num > 0 && den > 0).then_some((num, den))
}

/// "n: 7 pts: 280 pts_time:..." as 280.
fn ticks_in(line: &str) -> Option<i64> {
    let (_, rest) = line.split_once(" pts:")?;
    rest.split_whitespace().next()?.parse().ok()
}

/// The words of a line that is marked as an error, without the mark. It stands first, or after who speaks: `[h264 @ 0x55e5]`.
fn complaint_in(line: &str) -> Option<String> {
    let line = line.trim();
    ["[error] ", "[fatal] ", "[panic] "]
        .iter()
        .find_map(|mark| {
            let (speaker, words) = line.split_once(mark)?;
            let at_its_place = speaker.is_empty()
                || (speaker.starts_with('[') && speaker.find("] ") == Some(speaker.len() - 2));
            at_its_place.then(|| format!("{speaker}{words}"))
        })
}

pub(crate) fn is_url(path: &Path) -> bool {
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

/// The nominal rate by an answer of `ffprobe`, or what is missing in it.
fn rate_in_answer(text: &str) -> Result<(u32, u32), &'static str> {
    let answer: Option<Answer> = serde_json::from_str(text).ok();
    let stream = answer.and_then(|a| a.streams.into_iter().next());
    let stream = stream.ok_or("video")?;
    nominal(rate(&stream.r_frame_rate), rate(&stream.avg_frame_rate)).ok_or("frame rate")
}

/// The rate that the recording was made for: the base rate of its times, unless that is far above the average.
fn nominal(base: Option<(u32, u32)>, average: Option<(u32, u32)>) -> Option<(u32, u32)> {
    match (base, average) {
        (Some(b), Some(a)) if quotient(b) > NOMINAL_OVER_AVERAGE * quotient(a) => Some(a),
        _ => base.or(average),
    }
}

fn quotient((num, den): (u32, u32)) -> f64 {
    f64::from(num) / f64::from(den)
}

/// "30000/1001" as two numbers; `None` for "0/0" and anything outside 0..=[`MAX_FPS`].
fn rate(text: &str) -> Option<(u32, u32)> {
    let (num, den) = text.split_once('/')?;
    let (num, den): (u32, u32) = (num.parse().ok()?, den.parse().ok()?);
    let fps = f64::from(num) / f64::from(den);
    (den > 0 && fps > 0.0 && fps <= MAX_FPS).then_some((num, den))
}

#[cfg(test)]
mod tests;
