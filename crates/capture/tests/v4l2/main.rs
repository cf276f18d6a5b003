//! Proves that two video devices make pairs. The devices are the kernel's own virtual ones (`vivid.rs`), and USB cameras of ours behind the kernel's
//! driver of such cameras, `uvcvideo` (`uvc.rs`). `ci/vivid/run.sh` brings both; elsewhere the tests say that they are skipped.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod uvc;
mod vivid;

use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use vergence_calib::{CameraPose, RigCalibration};
use vergence_capture::{LiveSource, Next, Source as _, SourceEvent, SourceEventKind, StereoFrame};
use vergence_geometry::{Camera, Distortion, Eye, Intrinsics};

/// The devices, as long as a test has them; says how long that was.
pub(crate) struct Devices {
    started: Instant,
    _guard: MutexGuard<'static, ()>,
}

impl Devices {
    /// Wait until no other test has them.
    pub(crate) fn wait() -> Self {
        static DEVICES: Mutex<()> = Mutex::new(());
        Self {
            _guard: DEVICES.lock().unwrap_or_else(PoisonError::into_inner),
            started: Instant::now(),
        }
    }
}

impl Drop for Devices {
    fn drop(&mut self) {
        println!("  took {:.1} s", self.started.elapsed().as_secs_f64());
    }
}

/// What `v4l2-ctl` says.
pub(crate) fn ctl(device: &str, arguments: &[&str]) -> String {
    let done = Command::new("v4l2-ctl")
        .arg("--device")
        .arg(device)
        .args(arguments)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(
        done.status.success(),
        "v4l2-ctl {arguments:?}: {said}{}",
        String::from_utf8_lossy(&done.stderr)
    );
    said
}

pub(crate) fn rig((width, height): (usize, usize)) -> RigCalibration {
    let pose = |x_m: f64| CameraPose {
        name: format!("x {x_m}"),
        camera: Camera {
            intrinsics: Intrinsics {
                width,
                height,
                fx: 800.0,
                fy: 800.0,
                cx: 319.5,
                cy: 239.5,
            },
            distortion: Distortion::NONE,
        },
        rig_from_cam: Isometry3::from_parts(
            Translation3::new(x_m, 0.0, 0.0),
            UnitQuaternion::identity(),
        ),
    };
    RigCalibration::from_poses(pose(-0.035), pose(0.035)).unwrap()
}

/// So many pairs, each within a second.
pub(crate) fn pairs(source: &mut LiveSource, count: usize) -> Vec<StereoFrame> {
    let mut got = Vec::new();
    let until = Instant::now() + Duration::from_secs(20);
    while got.len() < count {
        assert!(
            Instant::now() < until,
            "only {} pairs: {:?}",
            got.len(),
            source.statistics()
        );
        if let Next::Pair(pair) = source.next_within(1.0, None).unwrap() {
            got.push(pair);
        }
    }
    got
}

/// All events until one of this kind comes, while pairs are fetched.
pub(crate) fn events_until(
    source: &mut LiveSource,
    kind: SourceEventKind,
    eye: Option<Eye>,
) -> Vec<SourceEvent> {
    let mut all = Vec::new();
    let until = Instant::now() + Duration::from_secs(20);
    while !all
        .iter()
        .any(|e: &SourceEvent| e.kind == kind && e.eye == eye)
    {
        assert!(Instant::now() < until, "no {kind:?} among {all:?}");
        let _ = source.next_within(0.1, None).unwrap();
        all.extend(source.take_events());
    }
    all
}

pub(crate) fn line(seen: &vergence_capture::LiveStatistics) -> String {
    let one = |c: &vergence_capture::live::CameraStatistics| {
        format!(
            "{:.2} fps, jitter p95 {:.1} ms, latency {:.1} ms (p95 {:.1}), lost {} torn {} late {}",
            1.0 / c.period.median_s,
            c.jitter.p95_s * 1e3,
            c.latency.median_s * 1e3,
            c.latency.p95_s * 1e3,
            c.counts.lost,
            c.counts.torn,
            c.late
        )
    };
    format!(
        "left {}; right {}; {} pairs, skew p95 {:.2} ms, offset {:?}",
        one(&seen.left),
        one(&seen.right),
        seen.pairing.paired,
        seen.skew.p95_s * 1e3,
        seen.offset_s
    )
}
