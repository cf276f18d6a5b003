//! What the tests ask for: two viewers, and what is read off an answer.

use vergence_geometry::comfort::Viewing;
use vergence_geometry::viewing::Viewer;
use vergence_stereo::faults::{Cause, Conditions, PairFaults};

/// Two metres away, one metre wide, eyes 65 mm apart: a pixel of 400 is 4.3'.
pub(crate) fn from_two_metres(width_px: usize) -> Viewing {
    Viewing {
        viewer: Viewer {
            interocular_m: 0.065,
            distance_m: 2.0,
        },
        screen_width_m: 1.0,
        width_px,
    }
}

/// A screen half a metre wide, 0.7 m away.
pub(crate) fn at_a_desk(width_px: usize) -> Conditions {
    Conditions::new(Viewing {
        viewer: Viewer::default(),
        screen_width_m: 0.5,
        width_px,
    })
}

/// Offset px, roll degrees, zoom percent.
pub(crate) fn similarity(faults: &PairFaults) -> [f64; 3] {
    let a = &faults.alignment;
    [a.offset_px.value, a.roll_deg.value, a.zoom_percent.value]
}

/// Alignment and lens: what a sound rig has nothing of.
pub(crate) fn is_alignment(cause: Cause) -> bool {
    matches!(
        cause,
        Cause::VerticalParallax
            | Cause::VerticalOffset
            | Cause::Roll
            | Cause::Zoom
            | Cause::KeystoneVertical
            | Cause::KeystoneToeIn
            | Cause::Bow
            | Cause::BaseRoll
            | Cause::VerticalResidual
            | Cause::LensDistortion
    )
}
