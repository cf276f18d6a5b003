//! The pair in which the target was seen best: with what the loop made of it drawn in, and as it was shown.

use std::path::Path;

use nalgebra::Point2;
use vergence_capture::StereoFrame;
use vergence_geometry::Camera;
use vergence_imaging::Rgb;
use vergence_imaging::files::write_rgb;
use vergence_servo::Step;

use crate::figure::canvas::{Canvas, Paint, Type};
use crate::figure::colour::{ORANGE, SKY};
use crate::figure::text;

use super::check::{Agreement, lines};
use super::sample::{LAYOUTS, Small};
use super::shown::Turned;

/// Sightings are equally good when their scores fall into the same of so many classes.
const CLASSES: f64 = 20.0;

/// Type is never smaller than this, units of the picture's pixels.
const LEAST_TYPE: f64 = 9.0;

/// The pair with the best sighting; of equally good ones the one nearest to the middle of the run.
pub(crate) struct Still {
    middle: Option<u64>,
    kept: Option<Kept>,
}

struct Kept {
    score: u32,
    pictures: [Rgb; 2],
    scene: Scene,
}

/// What belongs to the pictures of one moment.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) step: Step,
    /// How well pictures and cameras agree on the target.
    pub(crate) agreement: Option<Agreement>,
    /// How the pair was turned; `None` when motors move the cameras.
    pub(crate) turned: Option<Turned>,
    pub(crate) shift_px: [f64; 2],
}

impl Still {
    /// A still of a run of about so many pairs.
    pub(crate) fn new(pairs: Option<u64>) -> Self {
        Self {
            middle: pairs.map(|n| n / 2),
            kept: None,
        }
    }

    /// Whether the pair of this step is to be kept: it has a sighting with a distance, and a better one than what is kept.
    pub(crate) fn wants(&self, step: &Step, turned: Option<&Turned>) -> bool {
        let Some(score) = score(step, turned) else {
            return false;
        };
        let Some(kept) = &self.kept else {
            return true;
        };
        let off = |index: u64| self.middle.map_or(0, |m| m.abs_diff(index));
        // Pictures are copied a few times a run only: on the way to the middle every tenth pair will do.
        let due = off(step.index) < 3 || step.index.is_multiple_of(10);
        let nearer = off(step.index) < off(kept.scene.step.index);
        score > kept.score || (score == kept.score && nearer && due)
    }

    /// Keep a pair that is wanted.
    pub(crate) fn keep(&mut self, pair: &StereoFrame, scene: Scene) {
        let Some(score) = score(&scene.step, scene.turned.as_ref()) else {
            return;
        };
        self.kept = Some(Kept {
            score,
            pictures: [pair.left.picture.clone(), pair.right.picture.clone()],
            scene,
        });
    }

    /// Write the pictures into the run's folder; none when the target was never measured.
    pub(crate) fn write(&self, folder: &Path, cameras: &[Camera; 2]) -> anyhow::Result<()> {
        let Some(Kept {
            pictures, scene, ..
        }) = &self.kept
        else {
            return Ok(());
        };
        let label = label(cameras, pictures, scene);
        for (eye, name) in [(0, "target_left.png"), (1, "target_right.png")] {
            let marked = marked(&pictures[eye], scene, &cameras[eye], eye, &label)?;
            write_rgb(&folder.join(name), &marked)?;
        }
        let mut shown = pictures.clone();
        if let Some(turned) = &scene.turned {
            shown = turned.pictures(pictures.each_ref())?;
            write_rgb(&folder.join("converged_left.png"), &shown[0])?;
            write_rgb(&folder.join("converged_right.png"), &shown[1])?;
        }
        let small = Small::of(shown.each_ref(), scene.shift_px);
        for (name, layout) in LAYOUTS {
            let path = folder.join(format!("{name}.png"));
            write_rgb(&path, &small.composed(layout)?)?;
        }
        Ok(())
    }
}

/// How good a sighting is: its confidence, the patches that agree, and how far the pair is turned to it. `None` without a
/// distance.
fn score(step: &Step, turned: Option<&Turned>) -> Option<u32> {
    let measured = step.measured.as_ref()?;
    let [agree, tried] = measured.patches;
    let patches = agree as f64 / tried.max(1) as f64;
    let confidence = step.sighting.as_ref().map_or(0.0, |s| s.confidence);
    let nulled = turned.map_or(1.0, |t| t.nulled);
    Some((confidence * patches * nulled * CLASSES).round() as u32)
}

/// The picture of one eye (0 left, 1 right) with the target drawn in.
fn marked(
    picture: &Rgb,
    scene: &Scene,
    camera: &Camera,
    eye: usize,
    label: &[String],
) -> anyhow::Result<Rgb> {
    let (width, height) = (picture.width() as f64, picture.height() as f64);
    let thick = (width / 500.0).max(1.0);
    let mut canvas = Canvas::new(width, height);
    let step = &scene.step;
    if let (Some(sighting), 0) = (&step.sighting, eye) {
        for (outline, colour) in [(&sighting.body, ORANGE), (&sighting.torso, SKY)] {
            let corner = (outline.x + 0.5, outline.y + 0.5);
            canvas.rect(corner, (outline.w, outline.h), &Paint::line(colour, thick));
        }
    }
    if let Some(measured) = &step.measured {
        let arm = 8.0 * thick;
        let cross = |canvas: &mut Canvas, at: (f64, f64), paint: &Paint| {
            canvas.line((at.0 - arm, at.1), (at.0 + arm, at.1), paint);
            canvas.line((at.0, at.1 - arm), (at.0, at.1 + arm), paint);
        };
        let at = place([&measured.left_px, &measured.right_px][eye]);
        cross(&mut canvas, at, &Paint::line(SKY, thick));
        if let Some(delivered) = delivered_px(step, camera, eye) {
            let at = place(&delivered);
            canvas.circle(at, arm, &Paint::line(ORANGE, thick));
        }
        let below = match (&step.sighting, eye) {
            (Some(sighting), 0) => sighting.body.y + sighting.body.h,
            _ => at.1 + 2.0 * arm,
        };
        write_label(&mut canvas, label, (at.0, below), (width, height));
    }
    canvas
        .finish_clear(
            "the target",
            "the followed target with its measured distance",
        )
        .over(picture)
}

/// Pixel (0, 0) is the centre of its square, half a unit from the drawing's corner.
fn place(px: &Point2<f64>) -> (f64, f64) {
    (px.x + 0.5, px.y + 0.5)
}

/// Where the delivered place of the target falls in the picture as taken.
fn delivered_px(step: &Step, camera: &Camera, eye: usize) -> Option<Point2<f64>> {
    let estimate = step.estimate.as_ref()?;
    camera.project(&(step.base_from_cam[eye].inverse() * estimate.position_in_base))
}

/// Lines of text under a point, moved and made smaller so that the picture holds them.
fn write_label(canvas: &mut Canvas, lines: &[String], at: (f64, f64), size: (f64, f64)) {
    let (width, height) = size;
    let widest = |points: f64| {
        let widths = lines.iter().map(|line| text::width(line, points, true));
        widths.fold(0.0, f64::max)
    };
    let wanted = (width / 45.0).max(LEAST_TYPE);
    let points = (wanted * (0.96 * width / widest(wanted)).min(1.0)).max(LEAST_TYPE);
    let half = (widest(points) / 2.0 + 0.01 * width).min(width / 2.0);
    let x = at.0.max(half).min(width - half);
    let block = 1.25 * points * lines.len() as f64;
    let y = (at.1 + 1.4 * points).min(height - block).max(1.2 * points);
    let kind = Type::size(points).middle().bold().halo();
    for (i, line) in lines.iter().enumerate() {
        canvas.text((x, y + 1.25 * points * i as f64), line, &kind);
    }
}

fn label(cameras: &[Camera; 2], pictures: &[Rgb; 2], scene: &Scene) -> Vec<String> {
    let step = &scene.step;
    let Some(measured) = &step.measured else {
        return Vec::new();
    };
    let filtered = step.estimate.as_ref().map(|e| e.position_in_base);
    let mut first = format!("{:.2} m", measured.point_in_base.coords.norm());
    if let Some(place) = &filtered {
        first += &format!(", filtered {:.2} m", place.coords.norm());
    }
    let delivered = filtered.unwrap_or(measured.point_in_base);
    let agreement = scene.agreement.as_ref();
    let check = lines(cameras, pictures, step, agreement, &delivered);
    [vec![first], check].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Text goes into pictures of any shape without a panic: also into one fourteen times as wide as high, and a narrow one.
    #[test]
    fn labels_fit_any_picture() {
        let lines = vec![
            "1.28 m, filtered 1.29 m".to_owned(),
            "f B / z = 1 px".to_owned(),
        ];
        for (width, height) in [(2000.0, 64.0), (64.0, 2000.0), (64.0, 64.0)] {
            for at in [(-50.0, -50.0), (1e4, 1e4), (32.0, 32.0)] {
                let mut canvas = Canvas::new(width, height);
                write_label(&mut canvas, &lines, at, (width, height));
                let picture = Rgb::filled(width as usize, height as usize, [9; 3]);
                let out = canvas.finish_clear("a", "b").over(&picture).unwrap();
                assert_eq!(out.size(), picture.size());
            }
        }
    }
}
