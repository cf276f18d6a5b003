//! The square window on the person that the correlation filter looks at, of fixed size in metres.

use crate::correlation::SIDE;
use crate::sampling::{Facet, Footprint, Lattice, sample};
use crate::view::EyeView;

/// Spacing of the window's samples on the person, metres: 64 of them span 0.96 m.
pub(crate) const STEP_M: f64 = 0.015;

/// Fill `window` with the facet's picture; its footprint and the share of it inside the picture. `None` when part of it is
/// behind the lens.
pub(crate) fn cut_window(
    view: &EyeView,
    facet: &Facet,
    window: &mut Vec<f32>,
) -> Option<(Footprint, f64)> {
    let lattice = Lattice::centred(SIDE, SIDE, STEP_M, 0.0, 0.0);
    // Sample SIDE / 2 is the middle, as in the transform.
    let lattice = Lattice {
        x0_m: lattice.x0_m - STEP_M / 2.0,
        y0_m: lattice.y0_m - STEP_M / 2.0,
        ..lattice
    };
    let footprint = Footprint::new(view, facet, &lattice)?;
    let inside = sample(view, &footprint, window);
    Some((footprint, inside))
}
