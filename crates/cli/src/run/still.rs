//! One picture of the run with what the loop made of it drawn in: the target's box, the chest, the distance.

use std::path::Path;

use vergence_capture::StereoFrame;
use vergence_imaging::Rgb;
use vergence_imaging::files::write_rgb;
use vergence_servo::Step;

use crate::figure::canvas::{Canvas, Paint, Type};
use crate::figure::colour::{ORANGE, SKY};

/// The pair nearest to the middle of the run in which the target was measured.
pub(crate) struct Still {
    middle: Option<u64>,
    kept: Option<(u64, [Rgb; 2], Step)>,
}

impl Still {
    /// A still of a run of about so many pairs.
    pub(crate) fn new(pairs: Option<u64>) -> Self {
        Self {
            middle: pairs.map(|n| n / 2),
            kept: None,
        }
    }

    /// Keep the pair if it is nearer to the middle than what is kept.
    pub(crate) fn offer(&mut self, pair: &StereoFrame, step: &Step) {
        if step.measured.is_none() {
            return;
        }
        let off = |index: u64| self.middle.map_or(0, |m| m.abs_diff(index));
        let better = match &self.kept {
            None => true,
            Some((index, _, _)) => off(step.index) < off(*index),
        };
        // Pictures are copied a few times a run only: on the way to the middle every tenth pair will do.
        let near = self.middle.is_none_or(|m| m.abs_diff(step.index) < 3);
        if better && (self.kept.is_none() || near || step.index.is_multiple_of(10)) {
            let pictures = [pair.left.picture.clone(), pair.right.picture.clone()];
            self.kept = Some((step.index, pictures, step.clone()));
        }
    }

    /// Write `target_left.png` and `target_right.png`; nothing when the target was never measured.
    pub(crate) fn write(&self, folder: &Path) -> anyhow::Result<()> {
        let Some((_, pictures, step)) = &self.kept else {
            return Ok(());
        };
        for (eye, name) in [(0, "target_left.png"), (1, "target_right.png")] {
            let marked = marked(&pictures[eye], step, eye)?;
            write_rgb(&folder.join(name), &marked)?;
        }
        Ok(())
    }
}

/// The picture of one eye (0 left, 1 right) with the target drawn in.
fn marked(picture: &Rgb, step: &Step, eye: usize) -> anyhow::Result<Rgb> {
    let (width, height) = (picture.width() as f64, picture.height() as f64);
    let thick = (width / 500.0).max(1.0);
    let mut canvas = Canvas::new(width, height);
    // Pixel (0, 0) is the centre of its square, half a unit from the drawing's corner.
    let place = |p: &nalgebra::Point2<f64>| (p.x + 0.5, p.y + 0.5);
    if let (Some(sighting), 0) = (&step.sighting, eye) {
        for (outline, colour) in [(&sighting.body, ORANGE), (&sighting.torso, SKY)] {
            let corner = (outline.x + 0.5, outline.y + 0.5);
            canvas.rect(corner, (outline.w, outline.h), &Paint::line(colour, thick));
        }
    }
    if let Some(measured) = &step.measured {
        let at = place(if eye == 0 {
            &measured.left_px
        } else {
            &measured.right_px
        });
        let arm = 8.0 * thick;
        let paint = Paint::line(SKY, thick);
        canvas.line((at.0 - arm, at.1), (at.0 + arm, at.1), &paint);
        canvas.line((at.0, at.1 - arm), (at.0, at.1 + arm), &paint);
        let size = (width / 45.0).max(12.0);
        let kind = Type::size(size).middle().bold().halo();
        let below = step
            .sighting
            .as_ref()
            .map_or(at.1 + 2.0 * arm, |s| s.body.y + s.body.h);
        let y = (below + 1.4 * size).clamp(1.4 * size, height - 1.8 * size);
        let x = at.0.clamp(size * 8.0, (width - size * 8.0).max(size * 8.0));
        for (i, line) in label(step, measured).iter().enumerate() {
            canvas.text((x, y + i as f64 * 1.2 * size), line, &kind);
        }
    }
    canvas
        .finish_clear(
            "the target",
            "the followed target with its measured distance",
        )
        .over(picture)
}

fn label(step: &Step, measured: &vergence_servo::Measured) -> [String; 2] {
    let distance = measured.point_in_base.coords.norm();
    let filtered = step.estimate.as_ref().map_or_else(String::new, |e| {
        format!(", filtered {:.2} m", e.position_in_base.coords.norm())
    });
    [
        format!("{distance:.2} m{filtered}"),
        format!(
            "disparity {:.2} ± {:.2} px",
            measured.disparity_px, measured.sigma_px
        ),
    ]
}
