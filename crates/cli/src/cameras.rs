//! Live cameras for commands that need no calibration of them: which kind they are, and in which size a video device is asked for pictures.

use vergence_capture::live::LiveKind;

use crate::fault::{self, Fault};

/// How cameras are reached that are looked at as they see now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum LiveChoice {
    /// Video devices (/dev/video0); needs the feature v4l2.
    V4l2,
    /// RTSP URLs; needs the feature rtsp.
    Rtsp,
    /// What ffmpeg reads, live.
    Stream,
}

/// Size that video devices are asked for unless told otherwise, px.
pub(crate) const USUAL_SIZE: (usize, usize) = (640, 480);

/// Largest side of a picture, px.
const MAX_SIDE: usize = 16_384;

impl LiveChoice {
    pub(crate) fn kind(self) -> LiveKind {
        match self {
            Self::V4l2 => LiveKind::V4l2,
            Self::Rtsp => LiveKind::Rtsp,
            Self::Stream => LiveKind::Stream,
        }
    }

    /// What `--size` says, where such cameras can be asked for a size; `None` where it was not given.
    pub(crate) fn size(self, text: Option<&str>) -> Result<Option<(usize, usize)>, Fault> {
        if self != Self::V4l2 && text.is_some() {
            return Err(fault::usage(
                "--size has no meaning for streams, which have a size of their own",
            )
            .hint("it belongs to --source v4l2"));
        }
        text.map(size_from_text).transpose()
    }
}

/// A size as typed, 1280x720.
fn size_from_text(text: &str) -> Result<(usize, usize), Fault> {
    let side = |text: &str| {
        text.parse()
            .ok()
            .filter(|side| (16..=MAX_SIDE).contains(side))
    };
    let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
    sides.ok_or_else(|| {
        fault::usage(format!(
            "--size '{text}': width and height must lie in 16..={MAX_SIDE}"
        ))
        .hint("write both, for example 1280x720")
    })
}

#[cfg(test)]
mod tests {
    //! Proves: sizes are read with both sides, and nothing else is; streams are asked for none.
    use super::*;

    #[test]
    fn sizes_are_read() {
        let size = |text| LiveChoice::V4l2.size(Some(text));
        assert_eq!(size("1280x720").unwrap(), Some((1280, 720)));
        assert_eq!(LiveChoice::V4l2.size(None).unwrap(), None);
        for text in [
            "1280",
            "x720",
            "1280x",
            "0x720",
            "1280x720x3",
            "99999x720",
            "-4x8",
        ] {
            assert!(
                size(text).unwrap_err().to_string().contains("--size"),
                "{text}"
            );
        }
        let refused = LiveChoice::Stream.size(Some("640x480")).unwrap_err();
        assert!(refused.to_string().contains("no meaning for streams"));
    }
}
