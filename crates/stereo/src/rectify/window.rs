//! Which part of the rectified plane the pictures show.
//!
//! All is done on the plane z = 1 of the rectified frame, the right camera's side shifted so that what has zero disparity coincides:
//! then one window stands for both pictures.

use nalgebra::{Point2, UnitQuaternion, Vector3};
use vergence_geometry::Intrinsics;

use super::lens::Lens;
use super::{Field, MOST_ZOOM};
use crate::StereoError;

/// A ray this near to the rectified plane (z of a unit vector, 84 degrees off the axis) cannot be shown.
const LEAST_Z: f64 = 0.1;

/// Places across and down that the search starts with, the ones around the best that follow, and how often.
const FIRST: usize = 11;
const NEXT: usize = 5;
const REFINEMENTS: usize = 12;

/// Rays are checked at every so many pixels around an inscribed window.
const CHECK_PX: usize = 8;

/// What an inscribed window is made smaller by where a check fails.
const SHRINK: f64 = 0.998;

/// How far beyond the outermost centres a checked place may lie: a picture covers half a pixel there; the rest is left for what lies between the
/// checked places and for the fast maps' error.
const SLACK_PX: f64 = 0.1;

/// Centre and half width from the first to the last pixel's centre, on the plane z = 1 of the left camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    centre: Point2<f64>,
    half_width: f64,
}

impl Window {
    /// The left camera of a picture of this size that shows the window.
    pub(super) fn intrinsics(&self, (width, height): (usize, usize)) -> Intrinsics {
        let (w, h) = (width as f64 - 1.0, height as f64 - 1.0);
        let f = w / 2.0 / self.half_width;
        Intrinsics {
            width,
            height,
            fx: f,
            fy: f,
            cx: w / 2.0 - f * self.centre.x,
            cy: h / 2.0 - f * self.centre.y,
        }
    }
}

/// A pair in its orientation.
pub(super) struct Pair<'a> {
    pub(super) lenses: &'a [Lens; 2],
    pub(super) rect_from_cam: &'a [UnitQuaternion<f64>; 2],
    /// Disparity of the zero plane on the plane z = 1.
    pub(super) shift: f64,
    /// Width and height of the rectified pictures, pixels.
    pub(super) size: (usize, usize),
}

impl Pair<'_> {
    /// The window that a field asks for.
    pub(super) fn window(&self, field: Field) -> Result<Window, StereoError> {
        match field {
            Field::KeepFocal => Ok(self.centred(self.own_focal_px())),
            Field::Focal(focal_px) => Ok(self.centred(focal_px)),
            Field::All => self.of_all(),
            Field::Inscribed => self.without_wedges(),
        }
    }

    fn own_focal_px(&self) -> f64 {
        (self.lenses[0].focal_px() * self.lenses[1].focal_px()).sqrt()
    }

    /// Half the width over half the height.
    fn shape(&self) -> f64 {
        (self.size.0 as f64 - 1.0) / (self.size.1 as f64 - 1.0)
    }

    /// Where a camera's ray meets the common window's plane, and whether that is near enough to the axis to be shown.
    fn on_plane(&self, i: usize, ray: &Vector3<f64>) -> (Point2<f64>, bool) {
        let ray = self.rect_from_cam[i] * ray.normalize();
        let z = ray.z.max(LEAST_Z);
        let shift = [0.0, self.shift][i];
        (Point2::new(ray.x / z + shift, ray.y / z), ray.z >= LEAST_Z)
    }

    /// Around the middles of both pictures.
    fn centred(&self, focal_px: f64) -> Window {
        let [a, b] = [0, 1].map(|i| self.on_plane(i, self.lenses[i].middle()).0);
        Window {
            centre: nalgebra::center(&a, &b),
            half_width: (self.size.0 as f64 - 1.0) / 2.0 / focal_px,
        }
    }

    /// Around both outlines.
    fn of_all(&self) -> Result<Window, StereoError> {
        let mut low = Point2::new(f64::INFINITY, f64::INFINITY);
        let mut high = -low;
        for (i, lens) in self.lenses.iter().enumerate() {
            for ray in lens.border() {
                let (p, shown) = self.on_plane(i, ray);
                if !shown {
                    return Err(StereoError::FieldTooWide);
                }
                low = low.inf(&p);
                high = high.sup(&p);
            }
        }
        let half = (high - low) / 2.0;
        Ok(Window {
            centre: nalgebra::center(&low, &high),
            half_width: half.x.max(half.y * self.shape()),
        })
    }

    /// Inside both outlines.
    fn without_wedges(&self) -> Result<Window, StereoError> {
        let shape = self.shape();
        // Heights are scaled so that the window is a square.
        let outlines = [0, 1].map(|i| {
            let rays = self.lenses[i].border().iter();
            rays.map(|ray| {
                let p = self.on_plane(i, ray).0;
                Point2::new(p.x, p.y * shape)
            })
            .collect::<Vec<_>>()
        });
        let mut window = inscribed(&outlines, |centre| {
            let (x, y) = (centre.x - self.shift / 2.0, centre.y / shape);
            (1.0 + x * x + y * y).powf(-0.75)
        });
        window.centre.y /= shape;
        // Half the width of what the left camera itself shows, on a plane of its own.
        let own_width = self.lenses[0].size().0 as f64 / 2.0 / self.own_focal_px();
        while window.half_width >= own_width / MOST_ZOOM {
            if self.shows_source(&window) {
                return Ok(window);
            }
            window.half_width *= SHRINK;
        }
        Err(StereoError::NoInscribedWindow {
            zoom: own_width / window.half_width.max(0.0),
            most: MOST_ZOOM,
        })
    }

    /// Whether the pixels around a window come from inside both pictures.
    fn shows_source(&self, window: &Window) -> bool {
        let left = window.intrinsics(self.size);
        let (w, h) = (self.size.0 - 1, self.size.1 - 1);
        let along = |last: usize| (0..last).step_by(CHECK_PX).chain([last]);
        let level = along(w).flat_map(|x| [(x, 0), (x, h)]);
        let upright = along(h).flat_map(|y| [(0, y), (w, y)]);
        let ring: Vec<(usize, usize)> = level.chain(upright).collect();
        self.lenses.iter().enumerate().all(|(i, lens)| {
            let cx = left.cx + [0.0, left.fx * self.shift][i];
            let cam_from_rect = self.rect_from_cam[i].inverse().to_rotation_matrix();
            let (width, height) = lens.size();
            let covers = |c: f64, side: usize| c >= -SLACK_PX && c <= side as f64 - 1.0 + SLACK_PX;
            ring.iter().all(|&(x, y)| {
                let (x, y) = ((x as f64 - cx) / left.fx, (y as f64 - left.cy) / left.fy);
                let at = lens.place(&(cam_from_rect * Vector3::new(x, y, 1.0)));
                at.is_some_and(|p| covers(p.x, width) && covers(p.y, height))
            })
        })
    }
}

/// The square inside both outlines (closed lines) whose side times the weight of its centre is largest: by looking at a coarse grid of
/// centres, then at ever finer ones around the best.
///
/// With the weight (1 + x² + y²)^(-3/4) that is the window of the largest solid angle. The largest window of the plane would be drawn to the far ends
/// of the field, where the plane is stretched.
fn inscribed(outlines: &[Vec<Point2<f64>>; 2], weight: impl Fn(&Point2<f64>) -> f64) -> Window {
    let box_of = |outline: &Vec<Point2<f64>>| {
        let low = outline.iter().fold(outline[0], |a, p| a.inf(p));
        let high = outline.iter().fold(outline[0], |a, p| a.sup(p));
        (low, high)
    };
    let [a, b] = outlines.each_ref().map(box_of);
    let (low, high) = (a.0.sup(&b.0), a.1.inf(&b.1));
    let mut step = (high - low) / FIRST as f64;
    let mut best = Window {
        centre: nalgebra::center(&low, &high),
        half_width: f64::NEG_INFINITY,
    };
    let mut most = f64::NEG_INFINITY;
    let mut count = FIRST;
    for _ in 0..=REFINEMENTS {
        let around = best.centre;
        for j in 0..count {
            for i in 0..count {
                let off = |k: usize| k as f64 - (count as f64 - 1.0) / 2.0;
                let centre = Point2::new(around.x + off(i) * step.x, around.y + off(j) * step.y);
                let half_width = outlines
                    .iter()
                    .map(|outline| room(outline, &centre))
                    .fold(f64::INFINITY, f64::min);
                let size = if half_width > 0.0 {
                    half_width * weight(&centre)
                } else {
                    half_width
                };
                if size > most {
                    most = size;
                    best = Window { centre, half_width };
                }
            }
        }
        step *= 0.5;
        count = NEXT;
    }
    best
}

/// Half the side of the largest square around a place that no part of a closed line enters; negative when the place lies outside it.
fn room(outline: &[Point2<f64>], centre: &Point2<f64>) -> f64 {
    let mut nearest = f64::INFINITY;
    let mut inside = false;
    let mut from = outline[outline.len() - 1] - centre;
    for p in outline {
        let to = p - centre;
        // A ray to the right crosses an outline an odd number of times from inside.
        if (from.y > 0.0) != (to.y > 0.0)
            && from.x + (to.x - from.x) * from.y / (from.y - to.y) > 0.0
        {
            inside = !inside;
        }
        // max(|x|, |y|) along a straight line is least at its ends or where |x| = |y|.
        let along = to - from;
        let at = |t: f64| {
            let q = from + along * t.clamp(0.0, 1.0);
            q.x.abs().max(q.y.abs())
        };
        let equal = -(from.x - from.y) / (along.x - along.y);
        let opposite = -(from.x + from.y) / (along.x + along.y);
        nearest = nearest.min(at(1.0));
        for t in [equal, opposite] {
            if t > 0.0 && t < 1.0 {
                nearest = nearest.min(at(t));
            }
        }
        from = to;
    }
    if inside { nearest } else { -nearest }
}
