//! Vertical disparity against its limits.
//!
//! All limits come from one pair of angles at the viewer, 5' and 10' of vertical parallax: a cause is good as long as it makes less
//! than 5' where it makes most (offset everywhere, roll at the side edges, zoom at the upper edge, keystone in the corners, bow
//! at the side edges, roll against the base line between the nearest and the farthest point).

use vergence_geometry::comfort::{VerticalParallax, Viewing};

use super::model::half_width;
use super::{Alignment, Estimate};
use crate::faults::parallax::ParallaxRange;
use crate::faults::{Cause, Finding, Limits, Verdict};

/// Where the two angles come from.
pub(crate) const SOURCE: &str = "5' good, 10' alarm: design values of this project, far below Panum's vertical area of 19' to 26' (Qin et \
     al. 2006); mastering asks for 1 px (unconfirmed)";

/// Vertical limits before a viewer, pixels of the picture.
pub(crate) fn limits_px(viewing: &Viewing, size: (usize, usize)) -> Limits {
    let rule = VerticalParallax::default();
    let pitch_m = viewing.screen_width_m / size.0 as f64;
    Limits {
        look: VerticalParallax::parallax_m(rule.comfortable_arcmin, viewing) / pitch_m,
        bad: VerticalParallax::parallax_m(rule.acceptable_arcmin, viewing) / pitch_m,
        source: SOURCE,
    }
}

/// A finding of a cause that makes vertical disparity; `per_px` is the value that makes one pixel where it makes most.
struct Vertical {
    cause: Cause,
    estimate: Estimate,
    unit: &'static str,
    per_px: f64,
    what: String,
    remedy: &'static str,
}

/// One finding for each cause of vertical disparity.
pub(crate) fn findings(
    alignment: &Alignment,
    parallax: &ParallaxRange,
    viewing: &Viewing,
    size: (usize, usize),
) -> Vec<Finding> {
    let px = limits_px(viewing, size);
    let arcmin_per_px = 5.0 / px.look;
    let (half_w, half_h) = (half_width(size), size.1 as f64 / 2.0);
    let range_px = (parallax.near.disparity_px - parallax.far.disparity_px).abs();
    let a = alignment;
    let side = |value: f64, positive: &'static str, negative: &'static str| {
        if value > 0.0 { positive } else { negative }
    };
    let whole = Estimate {
        value: a.vertical_p95_px,
        sigma: a.offset_px.sigma.max(a.residual_px.sigma),
    };
    let vertical = [
        Vertical {
            cause: Cause::VerticalParallax,
            estimate: whole,
            unit: "px",
            per_px: 1.0,
            what: "95 % of the picture has less vertical disparity than this, all causes together".to_owned(),
            remedy: "correct the causes named below",
        },
        Vertical {
            cause: Cause::VerticalOffset,
            estimate: a.offset_px,
            unit: "px",
            per_px: 1.0,
            what: format!("the left picture lies {}", side(a.offset_px.value, "lower", "higher")),
            remedy: "shift one picture up or down, or tilt one camera",
        },
        Vertical {
            cause: Cause::Roll,
            estimate: a.roll_deg,
            unit: "deg",
            per_px: (1.0 / half_w).to_degrees(),
            what: format!(
                "the left picture is turned {} against the right one",
                side(a.roll_deg.value, "clockwise", "anti-clockwise")
            ),
            remedy: "turn one picture or one camera about its axis",
        },
        Vertical {
            cause: Cause::Zoom,
            estimate: a.zoom_percent,
            unit: "%",
            per_px: 100.0 / half_h,
            what: format!("the left picture is {}", side(a.zoom_percent.value, "larger", "smaller")),
            remedy: "scale one picture, or match the focal lengths",
        },
        Vertical {
            cause: Cause::KeystoneVertical,
            estimate: a.keystone_vertical_px,
            unit: "px",
            per_px: 1.0,
            what: "one camera looks up or down against the other: magnification changes with height".to_owned(),
            remedy: "apply the correction, or level the cameras",
        },
        Vertical {
            cause: Cause::KeystoneToeIn,
            estimate: a.keystone_toe_in_px,
            unit: "px",
            per_px: 1.0,
            what: format!(
                "the corners are at different heights, as of cameras turned {}",
                side(-a.keystone_toe_in_px.value, "towards each other", "away from each other")
            ),
            remedy: "apply the correction, or set the cameras parallel and shift the pictures",
        },
        Vertical {
            cause: Cause::Bow,
            estimate: a.bow_px,
            unit: "px",
            per_px: 1.0,
            what: "rows bend in one picture against the other".to_owned(),
            remedy: "calibrate the lenses and take their distortion out",
        },
        Vertical {
            cause: Cause::BaseRoll,
            estimate: Estimate {
                value: a.common_roll_deg.value.to_radians() * range_px,
                sigma: a.common_roll_deg.sigma.to_radians() * range_px,
            },
            unit: "px",
            per_px: 1.0,
            what: "vertical disparity from the nearest to the farthest point: one camera stands higher, or both are rolled alike".to_owned(),
            remedy: "bring both cameras to one height; the correction turns both pictures",
        },
        Vertical {
            cause: Cause::VerticalResidual,
            estimate: a.residual_px,
            unit: "px",
            per_px: 1.0,
            what: "vertical disparity that no turn, shift or zoom explains".to_owned(),
            remedy: "something moved between the two pictures, or a lens or a rolling shutter bends one of them",
        },
    ];
    vertical
        .into_iter()
        .map(|v| v.finding(&px, arcmin_per_px))
        .collect()
}

impl Vertical {
    fn finding(self, px: &Limits, arcmin_per_px: f64) -> Finding {
        let limits = Limits {
            look: px.look * self.per_px,
            bad: px.bad * self.per_px,
            source: px.source,
        };
        let arcmin = self.estimate.value.abs() / self.per_px * arcmin_per_px;
        let finding = Finding::judged(
            self.cause,
            self.estimate,
            self.unit,
            limits,
            &format!(
                "{} ({arcmin:.1}' at the viewer where it is most)",
                self.what
            ),
            self.remedy,
        );
        told_when_uncertain(finding)
    }
}

/// A value beyond its limit that is called good only because it is not known well enough: the meaning says so.
pub(crate) fn told_when_uncertain(mut finding: Finding) -> Finding {
    let sigma = finding.sigma.unwrap_or(0.0);
    let (good, limit) = (finding.verdict == Verdict::Good, finding.limits.look);
    // Where even the far limit is less than the standard deviation, the meaning is that nothing can be told.
    if good && finding.value.abs() > limit && sigma <= finding.limits.bad {
        let unit = finding.unit;
        finding.meaning += &format!(
            "; perhaps beyond the limit of {limit:.2} {unit}, but known to ±{sigma:.2} {unit} only"
        );
    }
    finding
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Good and sure: nothing is added. Beyond the limit but not surely so: good, and it says so. Surely beyond: no remark either.
    #[test]
    fn uncertain_values_are_told() {
        let finding = |value: f64, sigma: f64| {
            let estimate = Estimate { value, sigma };
            let limits = Limits {
                look: 2.0,
                bad: 4.0,
                source: "test",
            };
            told_when_uncertain(Finding::judged(
                Cause::Bow,
                estimate,
                "px",
                limits,
                "rows bend",
                "calibrate",
            ))
        };
        assert_eq!(finding(1.5, 1.0).meaning, "rows bend");
        let uncertain = finding(-3.0, 1.0);
        assert_eq!(uncertain.verdict, Verdict::Good);
        assert!(
            uncertain
                .meaning
                .contains("perhaps beyond the limit of 2.00 px, but known to ±1.00 px")
        );
        assert_eq!(finding(3.0, 0.2).verdict, Verdict::Look);
        assert!(!finding(3.0, 0.2).meaning.contains("perhaps"));
        assert!(finding(3.0, 9.0).meaning.contains("cannot be told"));
    }
}
