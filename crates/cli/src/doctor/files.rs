//! Calibration and disk.

use std::path::Path;

use vergence_calib::{MachineCalibration, ReadOptions, RigCalibration};
use vergence_geometry::Camera;

use super::{Check, Status};

/// What a run records in a second with pictures of 1024x768 at 30 pairs a second as JPEG, bytes: 60 pictures of about 100 kB.
const RECORDED_PER_S: f64 = 6e6;

/// Less than this many minutes of recording is too little.
const FEW_MINUTES: f64 = 10.0;

/// The calibration that was named; a note when there is none.
pub(crate) fn calibration(path: Option<&Path>, camera: &Camera) -> Vec<Check> {
    let group = "calibration";
    let Some(path) = path else {
        return vec![
            Check::new(
                group,
                "file",
                Status::Note,
                "none is named: only the simulated rig runs without one",
            )
            .next(
                "name it: vergence doctor --calibration FILE; make one: vergence calibrate --help",
            ),
        ];
    };
    let item = path.display().to_string();
    let (what, cameras) = match MachineCalibration::read(path) {
        Ok(machine) => ("a machine: cameras, axes and steps", machine.cameras),
        Err(of_machine) => match RigCalibration::read_with(&[path], &ReadOptions::default()) {
            Ok(rig) => ("a pair of cameras", rig.cameras),
            Err(of_pair) => {
                return vec![
                    Check::new(
                        group,
                        item,
                        Status::Wrong,
                        format!("as a machine: {of_machine}; as a pair: {of_pair}"),
                    )
                    .next("vergence calibrate makes one that can be read"),
                ];
            }
        },
    };
    let size = |c: &Camera| (c.intrinsics.width, c.intrinsics.height);
    let (wanted, given) = (size(camera), size(&cameras[0]));
    let found = format!("{what}, for pictures of {}x{}", given.0, given.1);
    if wanted != given {
        return vec![
            Check::new(group, item, Status::Wrong, format!("{found}, but the settings' cameras give {}x{}", wanted.0, wanted.1))
                .next("set camera.width and camera.height as the calibration says, or calibrate at this size"),
        ];
    }
    vec![Check::new(group, item, Status::Good, found)]
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
