//! Cameras as they see now: flags and settings of `vergence run`.

use std::path::{Path, PathBuf};

use vergence_calib::{MachineCalibration, ReadOptions, RigCalibration};
use vergence_capture::live::{
    ClockDomain, LiveKind, PixelFormat, Transport, V4l2Controls, V4l2Settings,
};
use vergence_capture::{LiveConfig, LiveInput, LiveRig, LiveSource, RealClock};

use crate::fault::{self, Fault};
use crate::output;
use crate::settings::quantity::Dimension;

use super::on_motors::LARGEST_MACHINE;
use super::{RunArgs, SourceKind};

/// How a video device sends its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Pixels {
    /// YUV 4:2:2.
    Yuyv,
    /// A JPEG for every frame.
    Mjpeg,
    /// YUV 4:2:0.
    Nv12,
    /// Grey.
    Grey,
    /// Red, green, blue.
    Rgb24,
}

/// Flags of live cameras.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Cameras")]
pub(crate) struct CameraFlags {
    /// One camera that gives both pictures side by side, in place of --left and --right.
    #[arg(long, value_name = "CAMERA")]
    device: Option<PathBuf>,
    /// How the devices send pictures [default: what both have, uncompressed first].
    #[arg(long, value_enum, value_name = "FORMAT")]
    pixels: Option<Pixels>,
    /// Exposure time of both, units of 100 µs [default: the left camera's].
    #[arg(long, value_name = "N")]
    exposure: Option<i64>,
    /// Gain of both, in the driver's units.
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    gain: Option<i64>,
    /// Colour temperature of both, K.
    #[arg(long, value_name = "K")]
    white_balance: Option<i64>,
    /// Focus of both, in the driver's units.
    #[arg(long, value_name = "N")]
    focus: Option<i64>,
    /// Leave exposure, gain, white balance and focus to each camera.
    #[arg(long)]
    leave_controls: bool,
    /// Largest time between the exposures of a pair [default: a fifth of a frame around the steady offset].
    #[arg(long, value_name = "TIME")]
    max_apart: Option<String>,
    /// How long pictures take from the middle of the exposure to here at least, for cameras that this machine's clock does not stamp [default: 0s].
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    delay: Option<String>,
    /// So many equal pictures in a row are a frozen camera, 0 never asks [default: 15 for video devices, 0 for streams, which repeat a still scene bit for bit].
    #[arg(long, value_name = "N")]
    frozen_after: Option<u32>,
    /// Fetch RTSP packet by packet: lost ones are not sent again.
    #[arg(long)]
    udp: bool,
}

impl CameraFlags {
    /// The flags that were given.
    fn given(&self) -> Vec<&'static str> {
        let all = [
            ("--device", self.device.is_some()),
            ("--pixels", self.pixels.is_some()),
            ("--exposure", self.exposure.is_some()),
            ("--gain", self.gain.is_some()),
            ("--white-balance", self.white_balance.is_some()),
            ("--focus", self.focus.is_some()),
            ("--leave-controls", self.leave_controls),
            ("--max-apart", self.max_apart.is_some()),
            ("--delay", self.delay.is_some()),
            ("--frozen-after", self.frozen_after.is_some()),
            ("--udp", self.udp),
        ];
        all.into_iter().filter(|f| f.1).map(|f| f.0).collect()
    }

    /// The first flag that was given and belongs to video devices alone.
    fn of_devices(&self) -> Option<&'static str> {
        let theirs = [
            "--pixels",
            "--exposure",
            "--gain",
            "--white-balance",
            "--focus",
            "--leave-controls",
        ];
        self.given().into_iter().find(|flag| theirs.contains(flag))
    }

    /// Refuse flags that have no meaning for the source.
    pub(crate) fn refuse(&self, source: &str) -> Result<(), Fault> {
        match self.given().first() {
            Some(flag) => Err(fault::usage(format!("{flag} has no meaning for {source}"))
                .hint("add --source v4l2, rtsp or stream to run on cameras")),
            None => Ok(()),
        }
    }

    /// What these flags say of cameras of a kind.
    pub(crate) fn config(
        &self,
        kind: LiveKind,
        left: Option<&Path>,
        right: Option<&Path>,
        fps: Option<&str>,
    ) -> Result<LiveConfig, Fault> {
        if kind != LiveKind::V4l2
            && let Some(flag) = self.of_devices()
        {
            let hint = "it belongs to --source v4l2";
            return Err(fault::usage(format!("{flag} has no meaning for streams")).hint(hint));
        }
        if kind != LiveKind::Rtsp && self.udp {
            return Err(fault::usage("--udp has no meaning for these cameras")
                .hint("it belongs to --source rtsp"));
        }
        let mut config = LiveConfig::new(kind, self.input(left, right)?);
        if let Some(text) = fps {
            config.fps = Some(super::build::rate_from_text(text, "--fps")?);
        }
        if let Some(text) = self.max_apart.as_deref() {
            let limit_s = time(
                text,
                "--max-apart",
                |s| s > 0.0 && s <= 1.0,
                "greater than 0 and at most 1 s",
            )?;
            config.max_apart_s = Some(limit_s);
        }
        if let Some(text) = self.delay.as_deref() {
            config.delay_s = time(
                text,
                "--delay",
                |s| (0.0..=2.0).contains(&s),
                "between 0 and 2 s",
            )?;
        }
        if let Some(pictures) = self.frozen_after {
            config.frozen_after = pictures;
        }
        if self.udp {
            config.transport = Transport::Udp;
        }
        config.v4l2 = self.of_v4l2();
        Ok(config)
    }

    /// Which cameras these flags name.
    fn input(&self, left: Option<&Path>, right: Option<&Path>) -> Result<LiveInput, Fault> {
        match (&self.device, left, right) {
            (Some(device), None, None) => Ok(LiveInput::SideBySide(device.clone())),
            (None, Some(left), Some(right)) => Ok(LiveInput::Two {
                left: left.to_owned(),
                right: right.to_owned(),
            }),
            (Some(_), _, _) => Err(fault::usage(
                "--device is both cameras, --left and --right are one each",
            )
            .hint("give either --device or --left and --right")),
            _ => Err(fault::usage("cameras need --left and --right, or --device")
                .hint("for example --left /dev/video0 --right /dev/video2")),
        }
    }

    /// What these flags say of video devices alone.
    fn of_v4l2(&self) -> V4l2Settings {
        V4l2Settings {
            format: self.pixels.map(|pixels| match pixels {
                Pixels::Yuyv => PixelFormat::Yuyv,
                Pixels::Mjpeg => PixelFormat::Mjpeg,
                Pixels::Nv12 => PixelFormat::Nv12,
                Pixels::Grey => PixelFormat::Grey,
                Pixels::Rgb24 => PixelFormat::Rgb24,
            }),
            controls: V4l2Controls {
                exposure: self.exposure,
                gain: self.gain,
                white_balance: self.white_balance,
                focus: self.focus,
                leave: self.leave_controls,
            },
            ..V4l2Settings::default()
        }
    }
}

/// A time as typed, s; `right` says in words what `fits` asks for.
fn time(text: &str, flag: &str, fits: impl Fn(f64) -> bool, right: &str) -> Result<f64, Fault> {
    let wrong = |why: &str| {
        fault::usage(format!("{flag} '{text}': {why}")).hint("write a time, for example 5ms")
    };
    let seconds = Dimension::Time.parse(text).map_err(|e| wrong(&e))?;
    match fits(seconds) {
        true => Ok(seconds),
        false => Err(wrong(&format!("must be {right}"))),
    }
}

/// Open the cameras that the flags name, which stand still.
pub(crate) fn source(args: &RunArgs, options: &ReadOptions<'_>) -> anyhow::Result<LiveSource> {
    let config = config(args)?;
    let calibration = args.calibration.as_ref().ok_or_else(|| {
        fault::usage("cameras need --calibration").hint("vergence calibrate makes one")
    })?;
    if output::read_text(calibration, "calibration", LARGEST_MACHINE)
        .is_ok_and(|text| MachineCalibration::is_one(&text))
    {
        return Err(fault::usage(format!(
            "{} is the calibration of a machine: nothing says where its motors stand",
            calibration.display()
        ))
        .hint("--motors CONTROLLER names what turns them; cameras that stand still need the calibration of a pair")
        .into());
    }
    let rig = RigCalibration::read_with(&[calibration.as_path()], options)
        .map_err(|e| fault::usage(e.to_string()))?;
    Ok(opened(&config, LiveRig::Fixed(&rig), &RealClock::new())?)
}

/// Open cameras, and say what of the flags has no effect on them.
pub(super) fn opened(
    config: &LiveConfig,
    rig: LiveRig<'_>,
    clock: &RealClock,
) -> Result<LiveSource, Fault> {
    let source = LiveSource::open(config, rig, clock).map_err(|e| fault::failed(e.to_string()))?;
    let seen = source.statistics();
    let cameras = [&seen.left, &seen.right].map(|c| (c.name.as_str(), c.counts.clock));
    if let Some(sentence) = idle_delay(config.delay_s, cameras) {
        output::say(&sentence);
    }
    Ok(source)
}

/// That a delay has no effect on cameras whose pictures this machine's clock stamps, as a sentence with their names; `None` where it has on all.
fn idle_delay(delay_s: f64, cameras: [(&str, ClockDomain); 2]) -> Option<String> {
    let stamped = (cameras.iter()).filter(|(_, clock)| *clock == ClockDomain::Machine);
    let mut names: Vec<&str> = stamped.map(|(name, _)| *name).collect();
    // One device may give both pictures.
    names.dedup();
    (delay_s > 0.0 && !names.is_empty()).then(|| {
        format!(
            "--delay has no effect on the pictures of {}: the driver stamps them with this machine's clock, so that their times need none",
            names.join(" and ")
        )
    })
}

/// What the flags say of the cameras.
pub(super) fn config(args: &RunArgs) -> Result<LiveConfig, Fault> {
    let kind = match args.source {
        SourceKind::Rtsp => LiveKind::Rtsp,
        SourceKind::Stream => LiveKind::Stream,
        _ => LiveKind::V4l2,
    };
    for (flag, given) in [
        ("--path", args.path.is_some()),
        ("--seed", args.seed.is_some()),
        ("--light", args.light.is_some()),
        ("--fast", args.fast),
        ("--rehearse", args.rehearse),
        ("--on-fault", args.on_fault.is_some()),
    ] {
        if given {
            return Err(fault::usage(format!("{flag} has no meaning for cameras")));
        }
    }
    let [left, right] = [&args.left, &args.right].map(Option::as_deref);
    args.cameras_live
        .config(kind, left, right, args.fps.as_deref())
}

#[cfg(test)]
mod tests {
    //! Proves: who asks for a delay of cameras that need none is told whose; who asks for none, or of cameras that need it, is told nothing.
    use super::*;

    #[test]
    fn delays_without_effect_are_told() {
        use ClockDomain::{Arrival, Machine, Own};
        let told = |delay_s, left, right| idle_delay(delay_s, [("a", left), ("b", right)]);
        let both = told(0.04, Machine, Machine).unwrap();
        assert!(
            both.contains("--delay has no effect on the pictures of a and b:"),
            "{both}"
        );
        let one = told(0.04, Own, Machine).unwrap();
        assert!(one.contains("of b:"), "{one}");
        let halves = idle_delay(0.04, [("a", Machine); 2]).unwrap();
        assert!(halves.contains("of a:"), "{halves}");
        assert_eq!(told(0.0, Machine, Machine), None);
        assert_eq!(told(0.04, Own, Arrival), None);
    }
}
