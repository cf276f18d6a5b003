//! Does a camera look where it is thought to? A part of the room that was seen before tells.
//!
//! A [`Keyframe`] remembers a picture and the pose from which it was taken. A later picture shows the same things in the same directions, wherever the
//! camera has turned in between, as long as its pose is known; shows it them elsewhere, all by the same angle, then one of the two poses was wrong. Both
//! are laid out by directions about the axis in question ([`Panorama`]), where a turn about it is a shift of columns.
//! Where the lens stood is neglected: what has moved by decimetres sideways in between sees another room, and who compares must allow for it.

use std::borrow::Cow;
use std::f64::consts::PI;

use nalgebra::{Isometry3, Point2, Unit, UnitQuaternion, Vector3};
use vergence_geometry::Camera;
use vergence_imaging::Gray;

use crate::range::best_of;
use crate::sampling::{bilinear_row, level_of};
use crate::view::{EyeView, PixelBox};

/// Columns of a panorama to a picture's width ...
const ACROSS: f64 = 91.0;

/// ... of which the exact camera is asked every so many, and the places in between lie on straight lines.
const MESH: usize = 3;

/// Places of patches, across and down.
const PATCHES: [usize; 2] = [6, 5];

/// Their outermost middles are so far from the edge, as a share of the picture's width and height.
const MARGIN: f64 = 0.13;

/// Size of a patch, columns and rows.
const SIZE: [usize; 2] = [18, 15];

/// Least contrast of a patch, grey levels: below it there are more noise and light than things.
const CONTRAST: f32 = 4.0;

/// Correlation from which a patch counts as found.
const FOUND: f32 = 0.8;

/// "Where it should be" is so many columns to each side (1.4° for a picture 31° wide): calibration, play, and the way of the lens.
pub const NEAR: i32 = 4;

/// Patches that lie further than this from their median are not where the others are, columns.
const ALIKE: f64 = 1.0;

/// Columns beside each other are one place.
const SPREAD: usize = 1;

/// So many columns from a place is another.
const BESIDE: usize = 4;

/// A picture laid out by direction: column `c` and row `r` look `c` and `r` steps about `axis` and along it.
///
/// Directions are those of the base frame; outside the picture there is nothing (NaN). The seam lies behind the base's z axis, where a rig does not look.
#[derive(Clone, Debug)]
pub struct Panorama {
    axis: Unit<Vector3<f64>>,
    step_rad: f64,
    first: [i32; 2],
    cols: usize,
    rows: usize,
    samples: Vec<f32>,
}

/// A part of the room as one camera saw it.
#[derive(Clone, Debug)]
pub struct Keyframe {
    picture: Gray,
    camera: Camera,
    base_from_cam: Isometry3<f64>,
    /// Middles of the patches that are compared: directions in base.
    rays: Vec<Vector3<f64>>,
    /// The patches about the vertical, which is asked for most.
    patches: Vec<Patch>,
}

/// How many of a keyframe's patches a picture shows somewhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Patches that lie in the picture there.
    pub visible: u32,
    /// How many of them look as they did.
    pub found: u32,
}

impl Agreement {
    /// Whether so many were found, and this share of those that lie in the picture.
    pub fn is_at_least(&self, found: u32, share: f64) -> bool {
        self.found >= found && f64::from(self.found) >= share * f64::from(self.visible)
    }
}

/// Where a keyframe's patches were found about where they should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// By this angle beside that, rad: their median; 0 when there are none. Right-handed about the axis, as in [`Turned`].
    pub by_rad: f64,
    /// How many.
    pub agreement: Agreement,
}

/// Where most of a keyframe's patches were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// By this angle about the axis of the search they lie beside where they should be, rad, right-handed: + is to the right about the base's y axis. Right to
    /// half a column.
    pub by_rad: f64,
    /// How many.
    pub agreement: Agreement,
    /// How many were found at once anywhere else, at most.
    pub elsewhere: u32,
}

impl Turned {
    /// Whether so many were found, this share of those that lie in the picture, and anywhere else no more than half as many: walls may look alike.
    pub fn is_clear(&self, found: u32, share: f64) -> bool {
        self.agreement.is_at_least(found, share) && 2 * self.elsewhere <= self.agreement.found
    }
}

/// A patch in a panorama, normalised.
#[derive(Clone, Debug)]
struct Patch {
    first: [i32; 2],
    samples: Vec<f32>,
}

impl Panorama {
    /// Lay out what a camera sees, about `axis` (in base), without the columns of `without` (pixels at full size): people do not stay, and seem to go
    /// with a camera that follows them.
    pub fn new(view: &EyeView, axis: &Unit<Vector3<f64>>, without: &[PixelBox]) -> Self {
        let picture = view.pyramid.level(level(view));
        Self::of(picture, view.camera, &view.base_from_cam, axis, without)
    }

    /// The angle between two columns, rad: a picture has 91 to its width.
    pub fn step_rad(&self) -> f64 {
        self.step_rad
    }

    /// `picture` is the camera's, smaller by any factor.
    fn of(
        picture: &Gray,
        camera: &Camera,
        base_from_cam: &Isometry3<f64>,
        axis: &Unit<Vector3<f64>>,
        without: &[PixelBox],
    ) -> Self {
        let k = &camera.intrinsics;
        let step_rad = step_rad(camera);
        let upright = upright(axis);
        let towards = |x: f64, y: f64| {
            let ray = camera.ray(&Point2::new(x, y))?;
            Some(azimuth_elevation(
                &(upright * (base_from_cam.rotation * ray)),
            ))
        };
        let (w, h) = (k.width as f64, k.height as f64);
        let middle = towards(w / 2.0, h / 2.0).unwrap_or_default();
        let mut least = middle;
        let mut most = middle;
        for i in 0..=8 {
            let share = f64::from(i) / 8.0;
            let edges = [
                (share * w, 0.0),
                (share * w, h),
                (0.0, share * h),
                (w, share * h),
            ];
            for [azimuth, elevation] in edges.into_iter().filter_map(|(x, y)| towards(x, y)) {
                let azimuth = middle[0] + wrapped(azimuth - middle[0]);
                for (i, value) in [azimuth, elevation].into_iter().enumerate() {
                    least[i] = least[i].min(value);
                    most[i] = most[i].max(value);
                }
            }
        }
        let first = least.map(|rad| (rad / step_rad).floor() as i32);
        let count = |i: usize| ((most[i] / step_rad).ceil() as i32 - first[i]).max(0) as usize + 1;
        let mut panorama = Self {
            axis: *axis,
            step_rad,
            first,
            cols: count(0),
            rows: count(1),
            samples: Vec::new(),
        };
        panorama.fill(
            picture,
            camera,
            &(upright * base_from_cam.rotation),
            without,
        );
        panorama
    }

    fn fill(
        &mut self,
        picture: &Gray,
        camera: &Camera,
        upright_from_cam: &UnitQuaternion<f64>,
        without: &[PixelBox],
    ) {
        let cam_from_upright = upright_from_cam.inverse();
        let scale = picture.width() as f64 / camera.intrinsics.width as f64;
        // Where the camera sees the nodes of a mesh, in pixels of the picture.
        let nodes = [self.cols, self.rows].map(|count| count.div_ceil(MESH) + 1);
        let node = |i: usize, j: usize| {
            let [azimuth, elevation] = [(i, 0), (j, 1)]
                .map(|(n, along)| f64::from(self.first[along] + (n * MESH) as i32) * self.step_rad);
            let ray = Vector3::new(
                azimuth.sin() * elevation.cos(),
                elevation.sin(),
                azimuth.cos() * elevation.cos(),
            );
            let seen = cam_from_upright * ray;
            let px = (seen.z > 0.1).then(|| camera.project(&seen.into()))??;
            Some([(px.x + 0.5) * scale - 0.5, (px.y + 0.5) * scale - 0.5].map(|c| c as f32))
        };
        let mesh: Vec<[f32; 2]> = (0..nodes[1])
            .flat_map(|j| (0..nodes[0]).map(move |i| (i, j)))
            .map(|(i, j)| node(i, j).unwrap_or([f32::NAN; 2]))
            .collect();
        self.samples = vec![f32::NAN; self.cols * self.rows];
        let (mut u, mut v) = (vec![0.0; self.cols], vec![0.0; self.cols]);
        let (last_x, last_y) = ((picture.width() - 1) as f32, (picture.height() - 1) as f32);
        let column = |x: f64| ((x + 0.5) * scale - 0.5) as f32;
        let left_out: Vec<_> = (without.iter())
            .map(|b| column(b.x)..=column(b.x + b.w))
            .collect();
        for (row, out) in self.samples.chunks_mut(self.cols).enumerate() {
            let (j, below) = (row / MESH, (row % MESH) as f32 / MESH as f32);
            let edge = |i: usize| -> [f32; 2] {
                let (top, bottom) = (mesh[j * nodes[0] + i], mesh[(j + 1) * nodes[0] + i]);
                std::array::from_fn(|c| top[c] + below * (bottom[c] - top[c]))
            };
            for (i, (u, v)) in u.chunks_mut(MESH).zip(v.chunks_mut(MESH)).enumerate() {
                let (from, to) = (edge(i), edge(i + 1));
                for (k, (u, v)) in u.iter_mut().zip(v).enumerate() {
                    let right = k as f32 / MESH as f32;
                    *u = from[0] + right * (to[0] - from[0]);
                    *v = from[1] + right * (to[1] - from[1]);
                }
            }
            bilinear_row(picture, &u, &v, out);
            for ((out, u), v) in out.iter_mut().zip(&u).zip(&v) {
                let is_inside = (0.0..=last_x).contains(u) && (0.0..=last_y).contains(v);
                if !is_inside || left_out.iter().any(|columns| columns.contains(u)) {
                    *out = f32::NAN;
                }
            }
        }
    }

    /// The row of a patch that begins at this column and row; `None` outside.
    fn row(&self, column: i32, row: i32) -> Option<&[f32]> {
        let column = usize::try_from(column - self.first[0]).ok()?;
        let row = usize::try_from(row - self.first[1]).ok()?;
        let is_inside = column + SIZE[0] <= self.cols && row < self.rows;
        is_inside.then(|| &self.samples[row * self.cols + column..][..SIZE[0]])
    }

    /// The patch with its middle in this direction; `None` where it reaches outside or shows next to nothing.
    fn patch(&self, [azimuth, elevation]: [f64; 2]) -> Option<Patch> {
        let middle = [azimuth, elevation].map(|rad| (rad / self.step_rad).round() as i32);
        let first = [0, 1].map(|i: usize| middle[i] - SIZE[i] as i32 / 2);
        let mut samples = Vec::with_capacity(SIZE[0] * SIZE[1]);
        for row in 0..SIZE[1] as i32 {
            samples.extend_from_slice(self.row(first[0], first[1] + row)?);
        }
        let count = samples.len() as f32;
        let mean = samples.iter().sum::<f32>() / count;
        samples.iter_mut().for_each(|s| *s -= mean);
        let deviation = (samples.iter().map(|s| s * s).sum::<f32>() / count).sqrt();
        samples.iter_mut().for_each(|s| *s /= deviation);
        (deviation >= CONTRAST).then_some(Patch { first, samples })
    }

    /// Correlation with a patch that is shifted by so many columns: `None` where that reaches outside, 0 where there is nothing.
    fn correlation(&self, patch: &Patch, shift: i32) -> Option<f32> {
        let mut sums = [[0.0_f32; SIZE[0]]; 3];
        for (row, there) in patch.samples.chunks(SIZE[0]).enumerate() {
            let here = self.row(patch.first[0] + shift, patch.first[1] + row as i32)?;
            for (i, (there, here)) in there.iter().zip(here).enumerate() {
                sums[0][i] += here;
                sums[1][i] += here * here;
                sums[2][i] += here * there;
            }
        }
        let count = patch.samples.len() as f32;
        let [sum, squares, products] = sums.map(|columns| columns.iter().sum::<f32>() / count);
        // The patch has mean zero, so the mean of what is here drops out of the product.
        let variance = squares - sum * sum;
        match variance.is_finite() {
            true if variance >= 1.0 => Some(products / variance.sqrt()),
            true => Some(0.0),
            false => None,
        }
    }
}

impl Keyframe {
    /// Remember a picture without the columns of `without` (pixels at full size).
    pub fn new(view: &EyeView, without: &[PixelBox]) -> Self {
        let k = &view.camera.intrinsics;
        let place = |i: usize, of: usize, size: usize| {
            let share = MARGIN + (1.0 - 2.0 * MARGIN) * i as f64 / (of - 1) as f64;
            share * size as f64 - 0.5
        };
        let panorama = Panorama::new(view, &Vector3::y_axis(), without);
        let places = (0..PATCHES[1]).flat_map(|j| (0..PATCHES[0]).map(move |i| (i, j)));
        let (rays, patches) = places
            .map(|(i, j)| {
                let across = place(i, PATCHES[0], k.width);
                Point2::new(across, place(j, PATCHES[1], k.height))
            })
            .filter_map(|pixel| {
                let ray = view.ray(&pixel)?;
                Some((ray, panorama.patch(azimuth_elevation(&ray))?))
            })
            .unzip();
        Self {
            picture: view.pyramid.level(level(view)).clone(),
            camera: *view.camera,
            base_from_cam: view.base_from_cam,
            rays,
            patches,
        }
    }

    /// How many patches are compared: few of a bare wall.
    pub fn count(&self) -> u32 {
        self.rays.len() as u32
    }

    /// What is compared with `seen`: nothing when that is another camera's.
    fn patches(&self, seen: &Panorama) -> Cow<'_, [Patch]> {
        let axis = &seen.axis;
        if seen.step_rad != step_rad(&self.camera) {
            return Cow::Borrowed(&[]);
        }
        if *axis == Vector3::y_axis() {
            return Cow::Borrowed(&self.patches);
        }
        let (picture, pose) = (&self.picture, &self.base_from_cam);
        let panorama = Panorama::of(picture, &self.camera, pose, axis, &[]);
        let upright = upright(axis);
        let patch = |ray| panorama.patch(azimuth_elevation(&(upright * ray)));
        Cow::Owned(self.rays.iter().filter_map(patch).collect())
    }

    /// How many patches `seen` shows about where they should be, [`NEAR`] columns to each side of it, and beside that by how much, about its axis. Those that are
    /// not where the others are do not count.
    pub fn placed(&self, seen: &Panorama) -> Placed {
        let mut visible = 0;
        let mut beside = Vec::new();
        for patch in self.patches(seen).iter() {
            let scores: Vec<f64> = (-NEAR..=NEAR)
                .map(|shift| seen.correlation(patch, shift))
                .map(|score| score.map_or(f64::NEG_INFINITY, f64::from))
                .collect();
            let Some((at, best)) = best_of(&scores).filter(|_| scores[NEAR as usize].is_finite())
            else {
                continue;
            };
            visible += 1;
            // At the end of the search a patch is on its way to somewhere else.
            let is_within = at > 0.0 && at < f64::from(2 * NEAR);
            if is_within && best >= f64::from(FOUND) {
                beside.push((at - f64::from(NEAR)) * seen.step_rad);
            }
        }
        beside.sort_by(f64::total_cmp);
        let by_rad = beside.get(beside.len() / 2).copied().unwrap_or(0.0);
        beside.retain(|rad| (rad - by_rad).abs() <= ALIKE * seen.step_rad);
        let found = beside.len() as u32;
        Placed {
            by_rad,
            agreement: Agreement { visible, found },
        }
    }

    /// The one turn about the axis of `seen` between `from_rad` and `to_rad` by which most patches lie beside where they should be. `None` where none was found.
    pub fn turned(&self, seen: &Panorama, [from_rad, to_rad]: [f64; 2]) -> Option<Turned> {
        let from = (from_rad / seen.step_rad).floor() as i32;
        let count = ((to_rad - from_rad) / seen.step_rad).ceil().max(0.0) as usize + 1;
        let mut agreements = vec![Agreement::default(); count];
        let mut scores = vec![None; count];
        for patch in self.patches(seen).iter() {
            for (n, score) in scores.iter_mut().enumerate() {
                *score = seen.correlation(patch, from + n as i32);
            }
            for (n, agreement) in agreements.iter_mut().enumerate() {
                let about = n.saturating_sub(SPREAD)..(n + SPREAD + 1).min(count);
                let best = scores[about]
                    .iter()
                    .flatten()
                    .copied()
                    .max_by(f32::total_cmp);
                agreement.visible += u32::from(best.is_some());
                agreement.found += u32::from(best.is_some_and(|best| best >= FOUND));
            }
        }
        let most = agreements
            .iter()
            .map(|a| a.found)
            .max()
            .filter(|m| *m > 0)?;
        // Where several columns beside each other have as many, the middle one.
        let first = agreements.iter().position(|a| a.found == most)?;
        let plateau = agreements[first..].iter().take_while(|a| a.found == most);
        let at = first + (plateau.count() - 1) / 2;
        let is_aside = |n: &usize| n.abs_diff(at) > BESIDE;
        let aside = (0..count).filter(is_aside).map(|n| agreements[n].found);
        Some(Turned {
            by_rad: f64::from(from + at as i32) * seen.step_rad,
            agreement: agreements[at],
            elsewhere: aside.max().unwrap_or(0),
        })
    }
}

fn step_rad(camera: &Camera) -> f64 {
    camera.intrinsics.width as f64 / camera.intrinsics.fx / ACROSS
}

/// The level of a pyramid whose pixels are about as far apart as the columns of a panorama.
fn level(view: &EyeView) -> usize {
    level_of(view, view.camera.intrinsics.width as f64 / ACROSS)
}

/// The rotation that takes `axis` to +y, the same for the same axis.
fn upright(axis: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(axis, &Vector3::y()).unwrap_or_else(UnitQuaternion::identity)
}

/// About +y from +z towards +x, and towards +y, rad.
fn azimuth_elevation(ray: &Vector3<f64>) -> [f64; 2] {
    [ray.x.atan2(ray.z), ray.y.atan2(ray.x.hypot(ray.z))]
}

/// The same angle between -π and π, rad.
fn wrapped(rad: f64) -> f64 {
    rad - 2.0 * PI * (rad / (2.0 * PI)).round()
}
