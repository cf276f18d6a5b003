//! Flat boards of black and white rectangles, as a camera sees them: calibration targets with known corners.
//!
//! Coverage of a pixel is exact: the pixel's outline is carried onto the board's plane through the lens, corner by corner, and the
//! quadrilateral is clipped against the board's rectangles. What is neglected is the bend of the lens and of the perspective *within*
//! one pixel, below 0.002 px for lenses and distances that show a board at all. Blur, shading, noise and rounding are a second step
//! ([`develop`]), so that several boards, or a board and what hides it, can be drawn first.

// Index loops: both coordinates.
#![allow(clippy::needless_range_loop)]

use std::ops::Range;

use nalgebra::{Isometry3, Point2, Point3};
use vergence_geometry::Camera;
use vergence_imaging::{Gray, Plane};

use crate::hash::Draws;

/// A uniform axis-aligned rectangle on the board's plane z = 0, metres in the board frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Smallest x and y.
    pub min_m: [f64; 2],
    /// Largest x and y.
    pub max_m: [f64; 2],
    /// White, else black.
    pub white: bool,
}

/// Code values of black and white in full light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tones {
    /// Of black areas.
    pub black: f32,
    /// Of white areas.
    pub white: f32,
}

/// What lens and sensor make of exact light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Standard deviation of the Gaussian blur, pixels; 0 for none.
    pub blur_px: f64,
    /// Relative change of the light across the picture's width and height: 0.4 is 20 % darker at the left or upper border
    /// and 20 % brighter at the other.
    pub shading: [f64; 2],
    /// Standard deviation of the noise, code values.
    pub noise: f64,
    /// Seed of the noise.
    pub seed: u64,
}

/// Draws a board over a picture in exact light. Later patches cover earlier ones; where there are none, and where the lens shows no
/// point of the plane in front of the camera, the picture stays as it is. `cam_from_board` carries board points into the
/// camera frame.
///
/// # Panics
/// When the picture's size is not that of the camera.
pub fn draw(
    onto: &mut Plane<f32>,
    patches: &[Patch],
    tones: Tones,
    camera: &Camera,
    cam_from_board: &Isometry3<f64>,
) {
    let k = &camera.intrinsics;
    assert_eq!(
        onto.size(),
        (k.width, k.height),
        "the picture must have the camera's size"
    );
    let cells = Cells::new(patches);
    let on_board = BoardRays::new(camera, cam_from_board);
    let [columns, rows] = bounds(patches, camera, cam_from_board);
    // The pixels' corners of the row's upper and lower border.
    let border = |v: usize| -> Vec<Option<[f64; 2]>> {
        (columns.start..=columns.end)
            .map(|u| on_board.at(u as f64 - 0.5, v as f64 - 0.5))
            .collect()
    };
    let mut upper = border(rows.start);
    for v in rows {
        let lower = border(v + 1);
        for u in columns.clone() {
            let i = u - columns.start;
            if let (Some(a), Some(b), Some(c), Some(d)) =
                (upper[i], upper[i + 1], lower[i + 1], lower[i])
            {
                let value = cells.seen(&[a, b, c, d], tones, onto.at(u, v));
                onto.set(u, v, value);
            }
        }
        upper = lower;
    }
}

/// Points on each side of an outline.
const STEPS: usize = 32;

/// Columns and rows of the picture that can show the patches: their outline is projected and the lens's bend between the points of the
/// outline allowed for. All of the picture when a part of the outline has no pixel.
fn bounds(
    patches: &[Patch],
    camera: &Camera,
    cam_from_board: &Isometry3<f64>,
) -> [Range<usize>; 2] {
    let size = [camera.intrinsics.width, camera.intrinsics.height];
    let whole = [0..size[0], 0..size[1]];
    let mut outline = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for p in patches {
        for i in 0..2 {
            outline[0][i] = outline[0][i].min(p.min_m[i]);
            outline[1][i] = outline[1][i].max(p.max_m[i]);
        }
    }
    let mut seen = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];

    for i in 0..4 * STEPS {
        let t = (i % STEPS) as f64 / STEPS as f64;
        let [x, y] = match i / STEPS {
            0 => [t, 0.0],
            1 => [1.0, t],
            2 => [1.0 - t, 1.0],
            _ => [0.0, 1.0 - t],
        };
        let at = |i: usize, t: f64| outline[0][i] + t * (outline[1][i] - outline[0][i]);
        let point = cam_from_board * Point3::new(at(0, x), at(1, y), 0.0);
        let Some(pixel) = camera.project(&point) else {
            return whole;
        };
        for i in 0..2 {
            seen[0][i] = seen[0][i].min(pixel[i]);
            seen[1][i] = seen[1][i].max(pixel[i]);
        }
    }
    [0, 1].map(|i| {
        let margin = 3.0 + 0.02 * (seen[1][i] - seen[0][i]);
        let clamped = |c: f64| c.clamp(0.0, size[i] as f64) as usize;
        clamped(seen[0][i] - margin)..clamped(seen[1][i] + margin)
    })
}

/// Light while the picture moves evenly by a path, pixels, during the exposure: the mean along it. The truth is that of the middle of the exposure; what
/// lies beyond the border is repeated.
pub fn smeared(light: &Plane<f32>, path_px: [f64; 2]) -> Plane<f32> {
    let (width, height) = light.size();
    // Two samples a pixel of the path.
    let count = (2.0 * path_px[0].hypot(path_px[1])).ceil() as usize + 1;
    if count == 1 || width == 0 || height == 0 {
        return light.clone();
    }
    let clamped = |at: f64, n: usize| at.clamp(0.0, (n - 1) as f64);
    Plane::from_fn(width, height, |u, v| {
        let sum: f64 = (0..count)
            .map(|i| {
                let t = (i as f64 + 0.5) / count as f64 - 0.5;
                let x = clamped(u as f64 + t * path_px[0], width);
                let y = clamped(v as f64 + t * path_px[1], height);
                let (left, top) = (x as usize, y as usize);
                let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
                let (fx, fy) = (x - left as f64, y - top as f64);
                let row = |v: usize| {
                    let (a, b) = (f64::from(light.at(left, v)), f64::from(light.at(right, v)));
                    a + fx * (b - a)
                };
                row(top) + fy * (row(bottom) - row(top))
            })
            .sum();
        (sum / count as f64) as f32
    })
}

/// Exact light to 8 bits: blur, shading, noise, rounding. The same inputs give the same bytes.
pub fn develop(light: &Plane<f32>, look: &Look) -> Gray {
    let (width, height) = light.size();
    let blurred = blurred(light, look.blur_px);
    let mut draws = Draws::new(look.seed, 0xb0a2d);
    Gray::from_fn(width, height, |u, v| {
        let x = (u as f64 + 0.5) / width as f64 - 0.5;
        let y = (v as f64 + 0.5) / height as f64 - 0.5;
        let shade = 1.0 + look.shading[0] * x + look.shading[1] * y;
        let mut value = f64::from(blurred.at(u, v)) * shade;
        if look.noise > 0.0 {
            value += look.noise * normal(&mut draws);
        }
        (value + 0.5).clamp(0.0, 255.0) as u8
    })
}

/// A draw from the normal distribution (Box & Muller 1958).
fn normal(draws: &mut Draws) -> f64 {
    let radius = (-2.0 * (1.0 - draws.unit()).ln()).sqrt();
    radius * (std::f64::consts::TAU * draws.unit()).cos()
}

fn blurred(light: &Plane<f32>, sigma: f64) -> Plane<f32> {
    if sigma <= 0.0 {
        return light.clone();
    }
    let reach = (4.0 * sigma).ceil() as isize;
    let mut kernel: Vec<f32> = (-reach..=reach)
        .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32)
        .collect();
    let sum: f32 = kernel.iter().sum();
    for weight in &mut kernel {
        *weight /= sum;
    }
    let (width, height) = light.size();
    let along = |at: usize, i: usize, n: usize| {
        (at as isize + i as isize - reach).clamp(0, n as isize - 1) as usize
    };
    let across = Plane::from_fn(width, height, |u, v| {
        let row = light.row(v);
        (kernel.iter().enumerate())
            .map(|(i, weight)| weight * row[along(u, i, width)])
            .sum::<f32>()
    });
    Plane::from_fn(width, height, |u, v| {
        (kernel.iter().enumerate())
            .map(|(i, weight)| weight * across.at(u, along(v, i, height)))
            .sum()
    })
}

/// Where viewing rays meet the board's plane.
struct BoardRays<'a> {
    camera: &'a Camera,
    board_from_cam: Isometry3<f64>,
    lens_in_board: Point3<f64>,
}

impl<'a> BoardRays<'a> {
    fn new(camera: &'a Camera, cam_from_board: &Isometry3<f64>) -> Self {
        let board_from_cam = cam_from_board.inverse();
        Self {
            camera,
            board_from_cam,
            lens_in_board: board_from_cam * Point3::origin(),
        }
    }

    fn at(&self, u: f64, v: f64) -> Option<[f64; 2]> {
        let ray = self.board_from_cam.rotation * self.camera.ray(&Point2::new(u, v))?;
        let reach = -self.lens_in_board.z / ray.z;
        if !(reach.is_finite() && reach > 0.0) {
            return None;
        }
        let hit = self.lens_in_board + reach * ray;
        Some([hit.x, hit.y])
    }
}

/// The board cut along all borders of its patches: every cell has one colour, or none.
struct Cells {
    borders: [Vec<f64>; 2],
    colours: Vec<Option<bool>>,
}

impl Cells {
    fn new(patches: &[Patch]) -> Self {
        let borders = [0, 1].map(|axis| {
            let mut all: Vec<f64> = patches
                .iter()
                .flat_map(|p| [p.min_m[axis], p.max_m[axis]])
                .collect();
            all.sort_by(f64::total_cmp);
            // Borders that differ by rounding are one.
            all.dedup_by(|b, a| *b - *a < 1e-9);
            all
        });
        let columns = borders[0].len().saturating_sub(1);
        let rows = borders[1].len().saturating_sub(1);
        let mut colours = vec![None; columns * rows];
        for p in patches {
            let [from, to] = [p.min_m, p.max_m].map(|corner| {
                [0, 1].map(|axis| borders[axis].partition_point(|&b| b < corner[axis] - 0.5e-9))
            });
            for row in from[1]..to[1].min(rows) {
                for column in from[0]..to[0].min(columns) {
                    colours[row * columns + column] = Some(p.white);
                }
            }
        }
        Self { borders, colours }
    }

    fn columns(&self) -> usize {
        self.borders[0].len().saturating_sub(1)
    }

    /// Number of the strip that holds a coordinate, counted from 1; 0 lies before the first border, the number of borders behind
    /// the last.
    fn strip(&self, axis: usize, at: f64) -> usize {
        self.borders[axis].partition_point(|&b| b <= at)
    }

    /// Colour of a cell in strips; `None` beside the board.
    fn colour(&self, column: usize, row: usize) -> Option<bool> {
        let inside = (1..self.borders[0].len()).contains(&column)
            && (1..self.borders[1].len()).contains(&row);
        inside
            .then(|| self.colours[(row - 1) * self.columns() + column - 1])
            .flatten()
    }

    /// What a pixel shows whose outline is `quad` on the board and that showed `behind` before.
    fn seen(&self, quad: &[[f64; 2]; 4], tones: Tones, behind: f32) -> f32 {
        let value = |colour: Option<bool>| match colour {
            Some(true) => tones.white,
            Some(false) => tones.black,
            None => behind,
        };
        let range = [0, 1].map(|axis| {
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for corner in quad {
                low = low.min(corner[axis]);
                high = high.max(corner[axis]);
            }
            self.strip(axis, low)..=self.strip(axis, high)
        });
        if range.iter().all(|r| r.start() == r.end()) {
            return value(self.colour(*range[0].start(), *range[1].start()));
        }
        let (mut sum, mut total) = (0.0, 0.0);
        let mut column_part = Vec::with_capacity(12);
        let mut part = Vec::with_capacity(16);
        for column in range[0].clone() {
            column_part.clear();
            column_part.extend_from_slice(quad);
            self.clip(&mut column_part, 0, column);
            if column_part.len() < 3 {
                continue;
            }
            for row in range[1].clone() {
                part.clone_from(&column_part);
                self.clip(&mut part, 1, row);
                let area = area(&part);
                sum += area * f64::from(value(self.colour(column, row)));
                total += area;
            }
        }
        if total > 0.0 {
            (sum / total) as f32
        } else {
            behind
        }
    }

    /// What of a polygon lies in a strip (Sutherland & Hodgman 1974).
    fn clip(&self, polygon: &mut Vec<[f64; 2]>, axis: usize, strip: usize) {
        let borders = &self.borders[axis];
        if strip > 0 {
            clip_half(polygon, axis, borders[strip - 1], 1.0);
        }
        if strip < borders.len() {
            clip_half(polygon, axis, borders[strip], -1.0);
        }
    }
}

/// Keeps what of a polygon lies on one side of an axis-parallel line: above it for `side` 1, below it for -1.
fn clip_half(polygon: &mut Vec<[f64; 2]>, axis: usize, at: f64, side: f64) {
    let whole = std::mem::take(polygon);
    for (i, b) in whole.iter().enumerate() {
        let a = &whole[(i + whole.len() - 1) % whole.len()];
        let (da, db) = (side * (a[axis] - at), side * (b[axis] - at));
        if (da > 0.0) != (db > 0.0) {
            let t = da / (da - db);
            polygon.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
        }
        if db > 0.0 {
            polygon.push(*b);
        }
    }
}

/// Area of a polygon, without its sign.
fn area(polygon: &[[f64; 2]]) -> f64 {
    let twice: f64 = (0..polygon.len())
        .map(|i| {
            let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
            a[0] * b[1] - b[0] * a[1]
        })
        .sum();
    0.5 * twice.abs()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};
    use vergence_geometry::{BrownConrady, Intrinsics};

    use super::*;

    const TONES: Tones = Tones {
        black: 0.0,
        white: 1.0,
    };

    fn camera() -> Camera {
        Camera {
            intrinsics: Intrinsics {
                width: 64,
                height: 48,
                fx: 60.0,
                fy: 60.0,
                cx: 31.5,
                cy: 23.5,
            },
            distortion: BrownConrady {
                k1: -0.1,
                ..BrownConrady::NONE
            }
            .into(),
        }
    }

    /// A tilted patch whose border is away from every pixel's axis: each pixel agrees with 200 x 200 rays through it.
    #[test]
    fn coverage_agrees_with_many_rays() {
        let camera = camera();
        let cam_from_board = Isometry3::from_parts(
            Translation3::new(-0.3, -0.2, 1.2),
            UnitQuaternion::from_euler_angles(0.4, -0.5, 0.3),
        );
        let patches = [
            Patch {
                min_m: [0.0, 0.0],
                max_m: [0.5, 0.4],
                white: true,
            },
            Patch {
                min_m: [0.1, 0.1],
                max_m: [0.2, 0.3],
                white: false,
            },
        ];
        let mut seen = Plane::filled(64, 48, 0.25);
        draw(&mut seen, &patches, TONES, &camera, &cam_from_board);
        let rays = BoardRays::new(&camera, &cam_from_board);
        let value = |u: f64, v: f64| {
            let Some(p) = rays.at(u, v) else { return 0.25 };
            let inside = |q: &Patch| (0..2).all(|i| p[i] >= q.min_m[i] && p[i] < q.max_m[i]);
            match (inside(&patches[0]), inside(&patches[1])) {
                (_, true) => 0.0,
                (true, _) => 1.0,
                _ => 0.25,
            }
        };
        let (mut worst, mut mixed) = (0.0_f64, 0);
        for v in 0..48 {
            for u in 0..64 {
                let n = 200;
                let sum: f64 = (0..n * n)
                    .map(|i| {
                        let at = |i: usize| (i as f64 + 0.5) / f64::from(n as u32) - 0.5;
                        value(u as f64 + at(i % n), v as f64 + at(i / n))
                    })
                    .sum();
                let exact = f64::from(seen.at(u, v));
                worst = worst.max((exact - sum / (n * n) as f64).abs());
                mixed += usize::from(![0.0, 0.25, 1.0].contains(&exact));
            }
        }
        assert!(mixed > 60, "only {mixed} pixels lie on a border");
        // A border moved by 0.004 px changes a pixel by 0.004; the rays themselves are off by up to 1/200.
        assert!(worst < 0.006, "off by {worst}");
    }

    /// A point that moves leaves a streak: its light, its middle, and the second moments of an even path (length squared over 12, along the
    /// path) beside those of sampling between pixels.
    #[test]
    fn motion_leaves_a_streak() {
        let light = Plane::from_fn(41, 41, |u, v| if (u, v) == (20, 20) { 100.0 } else { 0.0 });
        let path = [6.0, -4.0];
        let streak = smeared(&light, path);
        let mut sums = [0.0_f64; 6];
        for v in 0..41 {
            for u in 0..41 {
                let (x, y) = (u as f64 - 20.0, v as f64 - 20.0);
                let terms = [1.0, x, y, x * x, y * y, x * y];
                for (sum, term) in sums.iter_mut().zip(terms) {
                    *sum += term * f64::from(streak.at(u, v)) / 100.0;
                }
            }
        }
        let [mass, x, y, xx, yy, xy] = sums;
        assert!((mass - 1.0).abs() < 1e-5 && x.abs() < 1e-5 && y.abs() < 1e-5);
        // Bilinear samples add up to 1/4 along each axis and nothing across.
        assert!((0.0..0.27).contains(&(xx - 3.0)), "{xx}");
        assert!((-0.02..0.27).contains(&(yy - 16.0 / 12.0)), "{yy}");
        assert!((xy + 2.0).abs() < 0.05, "{xy}");
        assert_eq!(smeared(&light, [0.0, 0.0]), light);
    }

    /// Blur keeps the mean, noise has the deviation that was asked for, and the seed decides all.
    #[test]
    fn develops_as_asked() {
        let light = Plane::filled(128, 128, 120.0_f32);
        let look = Look {
            blur_px: 1.5,
            shading: [0.0, 0.0],
            noise: 3.0,
            seed: 5,
        };
        let picture = develop(&light, &look);
        let n = 128.0 * 128.0;
        let mean = picture.samples().iter().map(|&s| f64::from(s)).sum::<f64>() / n;
        let variance = (picture.samples().iter())
            .map(|&s| (f64::from(s) - mean).powi(2))
            .sum::<f64>()
            / n;
        assert!((mean - 120.0).abs() < 0.1, "{mean}");
        // Rounding adds 1/12.
        assert!((variance - 9.0 - 1.0 / 12.0).abs() < 0.4, "{variance}");
        assert_eq!(picture, develop(&light, &look));
        assert_ne!(picture, develop(&light, &Look { seed: 6, ..look }));
    }
}
