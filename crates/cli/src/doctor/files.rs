//! Calibration and disk.

use std::path::Path;

use vergence_calib::{MachineCalibration, ReadOptions, RigCalibration};

use super::{Check, Status};

/// What a run records in a second with pictures of 1024x768 at 30 pairs a second as JPEG, bytes: 60 pictures of about 100 kB.
const RECORDED_PER_S: f64 = 6e6;

/// Less than this many minutes of recording is too little.
const FEW_MINUTES: f64 = 10.0;

/// A calibration that could be read.
pub(crate) struct Calibrated {
    item: String,
    what: &'static str,
    /// Width and height of the pictures that it is for, px.
    pub(crate) size: (usize, usize),
    /// Pictures in the same proportion will do, too.
    is_scaled: bool,
}

/// That no calibration was named.
pub(crate) fn no_calibration() -> Check {
    Check::new(
        "calibration",
        "file",
        Status::Note,
        "none is named: only the simulated rig runs without one",
    )
    .next("name it: vergence doctor --calibration FILE; make one: vergence calibrate --help")
}

/// The calibration that was named, or what is wrong with it.
pub(crate) fn calibration(path: &Path) -> Result<Calibrated, Check> {
    let item = path.display().to_string();
    let (what, cameras, is_scaled) = match MachineCalibration::read(path) {
        Ok(machine) => ("a machine: cameras, axes and steps", machine.cameras, false),
        Err(of_machine) => match RigCalibration::read_with(&[path], &ReadOptions::default()) {
            Ok(rig) => ("a pair of cameras", rig.cameras, true),
            Err(of_pair) => {
                let found = format!("as a machine: {of_machine}; as a pair: {of_pair}");
                return Err(Check::new("calibration", item, Status::Wrong, found)
                    .next("vergence calibrate makes one that can be read"));
            }
        },
    };
    let k = &cameras[0].intrinsics;
    Ok(Calibrated {
        item,
        what,
        size: (k.width, k.height),
        is_scaled,
    })
}

impl Calibrated {
    /// Whether it is for the pictures of the settings' cameras.
    pub(crate) fn for_settings(&self, wanted: (usize, usize)) -> Check {
        match wanted == self.size {
            true => self.check(Status::Good, ""),
            false => self
                .check(
                    Status::Wrong,
                    &format!(", but the settings' cameras give {}x{}", wanted.0, wanted.1),
                )
                .next("set camera.width and camera.height as the calibration says, or calibrate at this size"),
        }
    }

    /// Whether it is for what the cameras gave; `None` when they gave nothing.
    pub(crate) fn for_cameras(&self, seen: Option<(usize, usize)>) -> Check {
        let Some((width, height)) = seen else {
            return self.check(Status::Good, "");
        };
        let (w, h) = self.size;
        // As a run does it, which scales the calibration of a pair.
        let fits = match self.is_scaled {
            true => width.checked_mul(h) == height.checked_mul(w),
            false => (width, height) == (w, h),
        };
        match fits {
            true => self.check(Status::Good, ""),
            false => self
                .check(
                    Status::Wrong,
                    &format!(", but the cameras give {width}x{height}"),
                )
                .next("set the cameras to this size (--size), or calibrate at theirs"),
        }
    }

    fn check(&self, status: Status, but: &str) -> Check {
        let (w, h) = self.size;
        let found = format!("{}, for pictures of {w}x{h}{but}", self.what);
        Check::new("calibration", self.item.clone(), status, found)
    }
}

/// Whether recordings have room where runs are kept.
pub(crate) fn disk(out: &Path) -> Check {
    let group = "disk";
    // The folder is made by the first run; until then its parent counts.
    let here = Path::new(".");
    let place = out.ancestors().find(|p| p.is_dir()).unwrap_or(here);
    let item = format!("{}", out.display());
    let free = match rustix::fs::statvfs(place) {
        Ok(stat) => stat.f_bavail as f64 * stat.f_frsize as f64,
        Err(error) => {
            return Check::new(
                group,
                item,
                Status::Wrong,
                format!("cannot be looked at: {error}"),
            )
            .next("choose another folder: --out, or run.out in the settings");
        }
    };
    let writable = rustix::fs::access(place, rustix::fs::Access::WRITE_OK);
    if let Err(error) = writable {
        return Check::new(
            group,
            item,
            Status::Wrong,
            format!("cannot be written to: {error}"),
        )
        .next("choose another folder: --out, or run.out in the settings");
    }
    let minutes = free / RECORDED_PER_S / 60.0;
    let found = format!(
        "{:.1} GB free, {minutes:.0} minutes of recording (1024x768, 30 pairs a second, about {:.0} MB/s)",
        free / 1e9,
        RECORDED_PER_S / 1e6
    );
    match minutes < FEW_MINUTES {
        true => Check::new(group, item, Status::Wrong, found)
            .next("free some room, or choose another folder with --out"),
        false => Check::new(group, item, Status::Good, found),
    }
}

#[cfg(test)]
mod tests {
    //! Proves: a pair's calibration fits pictures in its proportion, a machine's those of its size alone.
    use super::*;

    #[test]
    fn sizes_that_fit() {
        let calibrated = |is_scaled| Calibrated {
            item: "c.toml".to_owned(),
            what: "it",
            size: (640, 480),
            is_scaled,
        };
        let status = |is_scaled, size| calibrated(is_scaled).for_cameras(Some(size)).status;
        assert_eq!(status(true, (320, 240)), Status::Good);
        assert_eq!(status(false, (320, 240)), Status::Wrong);
        assert_eq!(status(false, (640, 480)), Status::Good);
        assert_eq!(calibrated(true).for_cameras(None).status, Status::Good);
        let wrong = calibrated(true).for_cameras(Some((640, 360)));
        assert_eq!(
            wrong.found,
            "it, for pictures of 640x480, but the cameras give 640x360"
        );
        assert!(wrong.next.is_some());
        assert_eq!(
            calibrated(true).for_settings((1024, 768)).found,
            "it, for pictures of 640x480, but the settings' cameras give 1024x768"
        );
    }
}
