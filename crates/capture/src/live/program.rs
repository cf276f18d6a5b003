//! A stream through the program `ffmpeg`: whatever it reads, as soon as it comes, started again when it dies.

use std::path::PathBuf;
use std::time::Duration;

use vergence_imaging::Rgb;

use super::camera::{Camera, Got, Opener, Taken};
use super::look::fingerprint;
use super::settings::Transport;
use super::stamps::Stamp;
use crate::CaptureError;
use crate::files::stream::{EyeStream, Polled};
use crate::files::video::Video;
use crate::secrets::shown;

/// Options by which `ffmpeg` waits for nothing: no buffer at the input, a short look at the stream, and one thread, since every further one holds a
/// frame back.
const AT_ONCE: [&str; 10] = [
    "-fflags",
    "nobuffer",
    "-flags",
    "low_delay",
    "-probesize",
    "100000",
    "-analyzeduration",
    "500000",
    "-threads",
    "1",
];

/// Starts `ffmpeg`.
pub(crate) struct ProgramOpener {
    pub(crate) path: PathBuf,
    pub(crate) ffmpeg: PathBuf,
    pub(crate) transport: Transport,
}

impl Opener for ProgramOpener {
    fn name(&self) -> String {
        shown(&self.path)
    }

    fn open(&mut self) -> Result<Box<dyn Camera>, CaptureError> {
        let mut input = AT_ONCE.to_vec();
        if self.path.to_string_lossy().starts_with("rtsp://") {
            let transport = match self.transport {
                Transport::Tcp => "tcp",
                Transport::Udp => "udp",
            };
            input.extend(["-rtsp_transport", transport]);
        }
        let stream = Video::live(&self.path).open_live(&self.ffmpeg, &input)?;
        Ok(Box::new(ProgramCamera {
            stream,
            name: self.name(),
        }))
    }
}

struct ProgramCamera {
    stream: EyeStream,
    name: String,
}

impl Camera for ProgramCamera {
    fn fps(&self) -> Option<f64> {
        None
    }

    fn next(&mut self, wait: Duration, reuse: Option<Rgb>) -> Result<Got, CaptureError> {
        if let Some(old) = reuse {
            self.stream.recycle(old);
        }
        let gone = |why: &str| CaptureError::Camera {
            camera: self.name.clone(),
            what: "ended".to_owned(),
            why: why.to_owned(),
        };
        match self.stream.poll(wait)? {
            Polled::Nothing => Ok(Got::Nothing),
            Polled::Ended => Err(gone("ffmpeg has no more pictures")),
            Polled::Frame(timed) => {
                let Some(picture) = timed.picture else {
                    return Ok(Got::Torn { lost: 0 });
                };
                Ok(Got::Frame(Taken {
                    print: fingerprint(picture.samples().as_flattened()),
                    picture,
                    stamp: Stamp::Own(timed.time_s),
                    lost: 0,
                }))
            }
        }
    }
}
