//! One film by itself: its frames in order of time.

use std::path::Path;

use vergence_imaging::Rgb;

use crate::CaptureError;
use crate::files::OnFault;
use crate::files::stream::EyeStream;
use crate::files::video::Video;

/// A frame and its time.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedFrame {
    /// Seconds from the start of the file, as the file gives it.
    pub time_s: f64,
    /// The picture.
    pub picture: Rgb,
}

/// The frames of a video file or of a URL, decoded ahead by `ffmpeg`; dropping it ends that program. What holds for the videos of
/// [`crate::FilesSource`] holds here.
#[derive(Debug)]
pub struct Frames {
    stream: EyeStream,
    fps: f64,
}

impl Frames {
    /// Start decoding. `ffmpeg` is the program; `ffprobe` is looked for beside it.
    ///
    /// # Errors
    /// When the program is missing, or cannot read the file.
    pub fn open(path: &Path, ffmpeg: &Path, on_unreadable: OnFault) -> Result<Self, CaptureError> {
        let video = Video::probe(path, ffmpeg, None)?;
        let fps = video.fps();
        let stream = video.open(ffmpeg, on_unreadable)?;
        Ok(Self { stream, fps })
    }

    /// Frames per second, nominally.
    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// The next frame, or `None` at the end. Waits for it.
    ///
    /// # Errors
    /// Where the file breaks off, and when the program keeps silent.
    pub fn next_frame(&mut self) -> Result<Option<TimedFrame>, CaptureError> {
        loop {
            let Some(timed) = self.stream.next()? else {
                return Ok(None);
            };
            // Frames without a picture are those that were to be passed over.
            if let Some(picture) = timed.picture {
                return Ok(Some(TimedFrame {
                    time_s: timed.time_s,
                    picture,
                }));
            }
        }
    }

    /// Give a picture back whose buffer may be used again.
    pub fn recycle(&self, picture: Rgb) {
        self.stream.recycle(picture);
    }
}
