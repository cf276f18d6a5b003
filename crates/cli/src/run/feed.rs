//! Where a run's pairs come from, with the truth where there is one.

use nalgebra::Point3;
use vergence_capture::{FilesSource, Source, SourceInfo, StereoFrame, TwinSource};
use vergence_geometry::Eye;
use vergence_servo::Step;

use super::record::Truth;

/// The source of a run.
pub(crate) enum Feed {
    Twin(Box<TwinSource>),
    Files(Box<FilesSource>),
}

impl Feed {
    pub(crate) fn info(&self) -> &SourceInfo {
        match self {
            Feed::Twin(twin) => twin.info(),
            Feed::Files(files) => files.info(),
        }
    }

    pub(crate) fn next_pair(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> anyhow::Result<Option<StereoFrame>> {
        Ok(match self {
            Feed::Twin(twin) => twin.next_pair(reuse)?,
            Feed::Files(files) => files.next_pair(reuse)?,
        })
    }

    pub(crate) fn dropped_pairs(&self) -> u64 {
        match self {
            Feed::Twin(twin) => twin.dropped_pairs(),
            Feed::Files(files) => files.dropped_pairs(),
        }
    }

    /// How often the motors' trajectories left their limits.
    pub(crate) fn limit_violations(&self) -> u64 {
        match self {
            Feed::Twin(twin) => twin.head().violations().iter().map(|v| v.total()).sum(),
            Feed::Files(_) => 0,
        }
    }

    /// The truth of one step; `None` for real footage, or when the twin is empty.
    pub(crate) fn truth_of(&self, step: &Step, shift_px: [f64; 2]) -> Option<Truth> {
        let Feed::Twin(twin) = self else {
            return None;
        };
        let truth = twin.truth_at(step.index)?;
        let target = (truth.target_in_base[0]? + truth.target_in_base[1]?.coords) / 2.0;
        let disparity_px = truth.disparity_px();
        let angles = [0, 1].map(|eye| truth.angles[eye].to_array());
        Some(Truth {
            target_in_base: target.into(),
            occluded: truth.occluded,
            angles_rad: std::array::from_fn(|axis| (angles[0][axis] + angles[1][axis]) / 2.0),
            left_px: left_px(twin, truth),
            disparity_px,
            shown_disparity_px: disparity_px.map(|d| d + shift_px[0] - shift_px[1]),
            pointing_px: pointing_px(twin, truth),
        })
    }
}

/// Where the reference point appears in the left picture, lens distortion and all.
fn left_px(twin: &TwinSource, truth: &vergence_capture::TwinTruth) -> Option<[f64; 2]> {
    let camera = &twin.info().cameras[Eye::Left as usize];
    let k = &camera.intrinsics;
    let ideal = truth.target_undistorted_px[Eye::Left as usize]?;
    let ray = Point3::new((ideal.x - k.cx) / k.fx, (ideal.y - k.cy) / k.fy, 1.0);
    camera.project(&ray).map(Into::into)
}

/// Distance of the reference point from the principal point (where the optical axis meets the picture), mean of both eyes,
/// lens distortion removed.
fn pointing_px(twin: &TwinSource, truth: &vergence_capture::TwinTruth) -> Option<f64> {
    let mut sum = 0.0;
    for eye in Eye::BOTH {
        let k = &twin.info().cameras[eye as usize].intrinsics;
        let px = truth.target_undistorted_px[eye as usize]?;
        sum += (px.x - k.cx).hypot(px.y - k.cy);
    }
    Some(sum / 2.0)
}
