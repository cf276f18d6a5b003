//! Network cameras by RTSP: `retina` fetches, `openh264` decodes, motion JPEG goes to the decoder of `imaging`.
//!
//! Each camera's thread drives its own connection; nothing asynchronous leaves this module. Times are those of the stream's own clock (RTP).
//! After a lost packet a stream of H.264 shows what it makes up until its next key frame; such pictures count as torn.

use std::num::NonZeroU32;
use std::path::Path;
use std::time::Duration;

use futures_util::StreamExt as _;
use openh264::decoder::Decoder;
use openh264::formats::YUVSource as _;
use percent_encoding::percent_decode_str;
use retina::client::{
    Credentials, Demuxed, Described, InitialTimestampPolicy, PlayOptions, Session, SessionOptions,
    SetupOptions, TcpTransportOptions, UdpTransportOptions,
};
use retina::codec::{CodecItem, FrameFormat, VideoFrame};
use tokio::runtime::Runtime;
use url::Url;
use vergence_imaging::{Rgb, files};

use super::camera::{Camera, Got, Opener, Taken};
use super::look::fingerprint;
use super::pixels::rgb_from_i420;
use super::settings::Transport;
use super::stamps::Stamp;
use crate::CaptureError;
use crate::secrets::{cleaned, shown};

/// How long a camera may take to answer one question.
const ANSWER: Duration = Duration::from_secs(5);

/// Most characters of an error of the library that are quoted.
const MAX_WORDS: usize = 200;

/// What a camera answers that wants a user and a password (RFC 2326, 7.1.1).
const UNAUTHORIZED: u16 = 401;

/// The largest believable step of a stream's clock, s: beyond it the stream is opened anew.
const LARGEST_STEP_S: NonZeroU32 = NonZeroU32::MIN.saturating_add(59);

/// Who opens a network camera.
pub(super) fn opener(path: &Path, transport: Transport) -> Result<Box<dyn Opener>, CaptureError> {
    let name = shown(path);
    let refuse = |why: &str| CaptureError::Camera {
        camera: name.clone(),
        what: "cannot be opened".to_owned(),
        why: cleaned(why, path).into_owned(),
    };
    let text = path
        .to_str()
        .ok_or_else(|| refuse("its address is no text"))?;
    let mut url =
        Url::parse(text).map_err(|e| refuse(&format!("its address makes no sense: {e}")))?;
    if url.scheme() != "rtsp" || url.host_str().is_none() {
        return Err(refuse("an address like rtsp://host:554/path is needed"));
    }
    let credentials = (!url.username().is_empty()).then(|| Credentials {
        username: decoded(url.username()),
        password: decoded(url.password().unwrap_or_default()),
    });
    // Neither fails for an address with a host.
    let _ = url.set_username("");
    let _ = url.set_password(None);
    Ok(Box::new(RtspOpener {
        name,
        url,
        credentials,
        transport,
    }))
}

/// A part of a URL without its percent signs; what is no code stays as it is.
fn decoded(part: &str) -> String {
    percent_decode_str(part).decode_utf8_lossy().into_owned()
}

struct RtspOpener {
    name: String,
    url: Url,
    credentials: Option<Credentials>,
    transport: Transport,
}

impl Opener for RtspOpener {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn open(&mut self) -> Result<Box<dyn Camera>, CaptureError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| self.failed(&e.to_string()))?;
        let (session, stream, codec, fps) = runtime.block_on(self.connect())?;
        let decoder = match codec {
            Codec::H264 => Some(Decoder::new().map_err(|e| self.failed(&e.to_string()))?),
            Codec::Jpeg => None,
        };
        Ok(Box::new(RtspCamera {
            session: Some(session),
            runtime,
            stream,
            decoder,
            fps,
            whole: false,
            name: self.name.clone(),
        }))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Codec {
    H264,
    Jpeg,
}

impl RtspOpener {
    fn failed(&self, why: &str) -> CaptureError {
        CaptureError::Camera {
            camera: self.name.clone(),
            what: "cannot be opened".to_owned(),
            why: cleaned(why, Path::new(self.url.as_str())).into_owned(),
        }
    }

    /// The answer to a question, or why there is none.
    async fn answer<T>(
        &self,
        question: impl Future<Output = Result<T, retina::Error>>,
    ) -> Result<T, CaptureError> {
        match tokio::time::timeout(ANSWER, question).await {
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(error)) => Err(self.failed(&one_line(&error))),
            Err(_) => Err(self.failed(&format!("it gave no answer for {} s", ANSWER.as_secs()))),
        }
    }

    /// Ask for the picture and let it run.
    async fn connect(&self) -> Result<(Demuxed, usize, Codec, Option<f64>), CaptureError> {
        let options = SessionOptions::default().creds(self.credentials.clone());
        let described = Session::describe(self.url.clone(), options);
        let mut session: Session<Described> = self.answer(described).await?;
        let (stream, codec) = self.picture(&session)?;
        let fps = session.streams()[stream]
            .framerate()
            .map(f64::from)
            .filter(|f| f.is_finite() && *f > 0.0);
        let transport = match self.transport {
            Transport::Tcp => retina::client::Transport::Tcp(TcpTransportOptions::default()),
            Transport::Udp => retina::client::Transport::Udp(UdpTransportOptions::default()),
        };
        let options = SetupOptions::default()
            .transport(transport)
            .frame_format(FrameFormat::SIMPLE);
        self.answer(session.setup(stream, options)).await?;
        let options = PlayOptions::default()
            .initial_timestamp(InitialTimestampPolicy::Permissive)
            .enforce_timestamps_with_max_jump_secs(LARGEST_STEP_S);
        let playing = self.answer(session.play(options)).await?;
        let session = playing.demuxed().map_err(|e| self.failed(&one_line(&e)))?;
        Ok((session, stream, codec, fps))
    }

    /// Which of the streams is the picture.
    fn picture(&self, session: &Session<Described>) -> Result<(usize, Codec), CaptureError> {
        let mut others = Vec::new();
        for (i, stream) in session.streams().iter().enumerate() {
            match (stream.media(), stream.encoding_name()) {
                ("video", "h264") => return Ok((i, Codec::H264)),
                ("video", "jpeg") => return Ok((i, Codec::Jpeg)),
                ("video", other) => others.push(other.to_owned()),
                _ => {}
            }
        }
        Err(self.failed(&if others.is_empty() {
            "it has no picture".to_owned()
        } else {
            format!(
                "its picture is coded as {}; set the camera to H.264 or JPEG",
                others.join(", ")
            )
        }))
    }
}

/// An error without its lines of context.
fn one_line(error: &retina::Error) -> String {
    let text = error.to_string();
    let mut short: String = text
        .lines()
        .next()
        .unwrap_or_default()
        .chars()
        .take(MAX_WORDS)
        .collect();
    if error.status_code() == Some(UNAUTHORIZED) {
        short.push_str(" (user and password go before the host: rtsp://user:password@host/)");
    }
    short
}

struct RtspCamera {
    /// `None` only while it is dropped: it must go while the runtime is there.
    session: Option<Demuxed>,
    runtime: Runtime,
    stream: usize,
    /// `None` for JPEG.
    decoder: Option<Decoder>,
    fps: Option<f64>,
    /// Whether every packet since a key frame has come.
    whole: bool,
    name: String,
}

impl Camera for RtspCamera {
    fn fps(&self) -> Option<f64> {
        self.fps
    }

    fn format(&self) -> Option<&'static str> {
        Some(match self.decoder {
            Some(_) => "H.264",
            None => "JPEG",
        })
    }

    fn next(&mut self, wait: Duration, reuse: Option<Rgb>) -> Result<Got, CaptureError> {
        let Some(session) = self.session.as_mut() else {
            return Ok(Got::Nothing);
        };
        let stream = self.stream;
        let next = async {
            loop {
                match session.next().await {
                    Some(Ok(CodecItem::VideoFrame(frame))) if frame.stream_id() == stream => {
                        return Ok(Some(frame));
                    }
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(one_line(&error)),
                    None => return Ok(None),
                }
            }
        };
        // A time-out needs the runtime's clock, hence the block.
        let next = self
            .runtime
            .block_on(async { tokio::time::timeout(wait, next).await });
        let gone = |why: String| CaptureError::Camera {
            camera: self.name.clone(),
            what: "broke off".to_owned(),
            why,
        };
        match next {
            Err(_) => Ok(Got::Nothing),
            Ok(Err(why)) => Err(gone(why)),
            Ok(Ok(None)) => Err(gone("the camera ended the stream".to_owned())),
            Ok(Ok(Some(frame))) => Ok(self.frame(&frame, reuse)),
        }
    }
}

impl RtspCamera {
    fn frame(&mut self, frame: &VideoFrame, reuse: Option<Rgb>) -> Got {
        if frame.loss() > 0 {
            self.whole = false;
        }
        if frame.is_random_access_point() && frame.loss() == 0 {
            self.whole = true;
        }
        let picture = match &mut self.decoder {
            Some(decoder) => decoder.decode(frame.data()).ok().flatten().and_then(|yuv| {
                let (y, u, v) = yuv.strides();
                rgb_from_i420(
                    [yuv.y(), yuv.u(), yuv.v()],
                    [y, u, v],
                    yuv.dimensions(),
                    reuse,
                )
            }),
            None => files::rgb_from_motion_jpeg(frame.data(), None).ok(),
        };
        match picture {
            Some(picture) if self.whole => Got::Frame(Taken {
                print: fingerprint(picture.samples().as_flattened()),
                picture,
                stamp: Stamp::Own(frame.timestamp().elapsed_secs()),
                lost: 0,
            }),
            _ => Got::Torn { lost: 0 },
        }
    }
}

impl Drop for RtspCamera {
    fn drop(&mut self) {
        // Taking leave of the camera is a task of the runtime; it gets a moment for it.
        let _entered = self.runtime.enter();
        self.session = None;
        drop(_entered);
        self.runtime
            .block_on(async { tokio::time::sleep(Duration::from_millis(20)).await });
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Any words as an address: an opener or one sentence, never a panic, and the password stays hidden in both.
        #[test]
        fn addresses_of_any_words(text in any::<String>(), tail in "[ -~]{0,40}") {
            for text in [text, format!("rtsp://{tail}"), format!("rtsp://us:pass%77ord@{tail}")] {
                match opener(Path::new(&text), Transport::Tcp) {
                    Ok(opener) => prop_assert!(!opener.name().contains("pass%77ord")),
                    Err(error) => prop_assert!(!error.to_string().contains("pass%77ord")),
                }
            }
        }
    }

    /// User and password come out of an address as they were meant: codes are decoded, what only looks like one stays.
    #[test]
    fn credentials() {
        for (given, told) in [
            ("p%40ss", "p@ss"),
            ("100%25", "100%"),
            ("a%+5", "a%+5"),
            ("a%zz%4", "a%zz%4"),
            ("%C3%BC", "ü"),
            ("", ""),
        ] {
            assert_eq!(decoded(given), told, "{given}");
        }
    }
}
