//! One eye's frames, decoded ahead by a thread.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use vergence_imaging::Rgb;

use crate::CaptureError;
use crate::files::video::ChildGuard;

/// Frames that are decoded ahead of the one asked for.
const AHEAD: usize = 2;

/// How long a video may keep silent before it counts as broken.
const SILENCE: Duration = Duration::from_secs(20);

/// A frame and its time; no picture where it could not be read and that is to be passed over.
#[derive(Debug)]
pub(crate) struct Timed {
    pub(crate) time_s: f64,
    pub(crate) picture: Option<Rgb>,
}

/// Something that gives one eye's frames in order of time.
pub(crate) trait Decoder: Send {
    /// The next frame, or `None` at the end; `reuse` is a picture whose buffer may be used again.
    fn next(&mut self, reuse: Option<Rgb>) -> Result<Option<Timed>, CaptureError>;
}

type Decoded = Result<Timed, CaptureError>;

/// What came of waiting for a frame of a live stream.
pub(crate) enum Polled {
    Frame(Timed),
    Nothing,
    Ended,
}

/// Frames of one eye. Dropping it ends the thread and the program behind it.
#[derive(Debug)]
pub(crate) struct EyeStream {
    path: PathBuf,
    size: Option<(usize, usize)>,
    silence: Option<Duration>,
    /// A frame that was fetched to learn the size.
    first: Option<Timed>,
    frames: Option<Receiver<Decoded>>,
    used: Option<Sender<Rgb>>,
    child: Option<ChildGuard>,
    thread: Option<JoinHandle<()>>,
}

impl EyeStream {
    /// Pictures of a known size; `path` is one of them.
    pub(crate) fn of_pictures(
        decoder: impl Decoder + 'static,
        size: (usize, usize),
        path: PathBuf,
    ) -> Result<Self, CaptureError> {
        Self::start(decoder, path, Some(size), None)
    }

    /// The frames that a program decodes; dropping the stream ends the program.
    pub(crate) fn of_video(
        decoder: impl Decoder + 'static,
        child: ChildGuard,
        path: PathBuf,
    ) -> Result<Self, CaptureError> {
        Self::start(decoder, path, None, Some(child))
    }

    fn start(
        mut decoder: impl Decoder + 'static,
        path: PathBuf,
        size: Option<(usize, usize)>,
        child: Option<ChildGuard>,
    ) -> Result<Self, CaptureError> {
        let (to_stream, frames) = sync_channel(AHEAD);
        let (used, free) = channel();
        let thread = std::thread::Builder::new()
            .name("decoder".to_owned())
            .spawn(move || decode_all(&mut decoder, &to_stream, &free))
            .map_err(|source| CaptureError::Io {
                action: "starting a thread that decodes",
                source,
                path: path.clone(),
            })?;
        Ok(Self {
            path,
            size,
            silence: child.as_ref().map(|_| SILENCE),
            first: None,
            frames: Some(frames),
            used: Some(used),
            child,
            thread: Some(thread),
        })
    }

    /// The next frame, or `None` at the end. Waits for it.
    pub(crate) fn next(&mut self) -> Result<Option<Timed>, CaptureError> {
        match self.first.take() {
            Some(timed) => Ok(Some(timed)),
            None => self.receive(),
        }
    }

    /// The next frame, if it comes in time.
    pub(crate) fn poll(&mut self, wait: Duration) -> Result<Polled, CaptureError> {
        let Some(frames) = &self.frames else {
            return Ok(Polled::Ended);
        };
        match frames.recv_timeout(wait) {
            Ok(decoded) => decoded.map(Polled::Frame),
            Err(RecvTimeoutError::Timeout) => Ok(Polled::Nothing),
            Err(RecvTimeoutError::Disconnected) => Ok(Polled::Ended),
        }
    }

    /// Width and height of the pictures; a video is decoded up to its first frame for it.
    pub(crate) fn size(&mut self) -> Result<(usize, usize), CaptureError> {
        if let Some(size) = self.size {
            return Ok(size);
        }
        self.first = self.receive()?;
        let picture = self.first.as_ref().and_then(|f| f.picture.as_ref());
        let size = picture.map(Rgb::size).ok_or_else(|| CaptureError::Input {
            reason: "the video holds no picture".to_owned(),
            path: self.path.clone(),
        })?;
        self.size = Some(size);
        Ok(size)
    }

    /// Give a buffer back.
    pub(crate) fn recycle(&self, picture: Rgb) {
        if let Some(used) = &self.used {
            // The thread may have ended; then the buffer is simply freed.
            let _ = used.send(picture);
        }
    }

    /// A file that stands for this stream in messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    fn receive(&mut self) -> Result<Option<Timed>, CaptureError> {
        let Some(frames) = &self.frames else {
            return Ok(None);
        };
        let received = match self.silence {
            None => frames.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(limit) => frames.recv_timeout(limit),
        };
        match received {
            Ok(decoded) => decoded.map(Some),
            Err(RecvTimeoutError::Disconnected) => Ok(None),
            Err(RecvTimeoutError::Timeout) => Err(CaptureError::Video {
                program: "ffmpeg",
                reason: format!("gave no frame for {} s", SILENCE.as_secs()),
                path: self.path.clone(),
            }),
        }
    }
}

impl Drop for EyeStream {
    fn drop(&mut self) {
        // Without a receiver the thread's next send fails; without its program a read that it waits in ends.
        self.frames = None;
        self.used = None;
        self.child = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has ended the stream already; there is nobody left to tell.
            let _ = thread.join();
        }
    }
}

fn decode_all(decoder: &mut impl Decoder, to_stream: &SyncSender<Decoded>, free: &Receiver<Rgb>) {
    loop {
        let decoded = match decoder.next(free.try_recv().ok()) {
            Ok(None) => return,
            Ok(Some(timed)) => Ok(timed),
            Err(e) => Err(e),
        };
        let failed = decoded.is_err();
        if to_stream.send(decoded).is_err() || failed {
            return;
        }
    }
}
