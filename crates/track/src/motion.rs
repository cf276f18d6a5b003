//! What moves by itself: differences against earlier pictures after the known turn of the camera is taken out.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use vergence_geometry::Camera;
use vergence_imaging::{Gray, Plane};

use crate::background::Background;
use crate::sampling::bilinear_row;
use crate::view::{EyeView, PixelBox};

/// Ages of the three earlier pictures against which a picture is compared, seconds: from a limb's swing to the body's
/// own advance. The middle of the three differences counts, so that what was uncovered (present in one
/// difference) or flickers (likewise) does not.
const LAGS_S: [f64; 3] = [0.13, 0.27, 0.53];

/// Most pixels of the level on which motion is looked for.
const MOST_PIXELS: usize = 140_000;

/// Pictures kept at most; enough for the longest lag at 60 pictures per second.
const KEPT: usize = 40;

/// Distance at which the background is assumed when the small travel of the lens centre is taken out, metres.
const BACKGROUND_M: f64 = 7.0;

/// Displacement that is forgiven as misregistration (parallax of relief, lens calibration), pixels of the level.
const FORGIVEN_PX: f32 = 0.35;

/// Deviations of noise that are forgiven.
const FORGIVEN_SIGMAS: f32 = 3.0;

/// Deviation of noise, grey levels, that no camera has: pictures of a camera that turned which differ by so much all over were taken where it was not, by an
/// axis that is stuck or by angles of another moment, and do not tell what moves by itself.
const UNFIT_LEVELS: f32 = 12.0;

/// Units of the map per standard deviation of noise above what is forgiven.
pub(crate) const UNITS_PER_SIGMA: f32 = 16.0;

/// Mesh spacing of the exact warp, pixels of the level.
const MESH: usize = 16;

/// Brightness bins of the noise model.
const BINS: usize = 8;

#[derive(Clone, Debug)]
struct Past {
    picture: Gray,
    base_from_cam: Isometry3<f64>,
    time_s: f64,
}

/// Motion map of each picture: standard deviations of noise by which a pixel has changed, minus what is forgiven, in
/// [`UNITS_PER_SIGMA`], saturating at 255.
#[derive(Clone, Debug)]
pub(crate) struct MotionMap {
    level: usize,
    still: bool,
    background: Background,
    camera: Option<Camera>,
    rays: Vec<Vector3<f64>>,
    past: VecDeque<Past>,
    slack: Plane<f32>,
    layers: [Gray; 3],
    map: Gray,
    ready: bool,
}

impl MotionMap {
    pub(crate) fn new() -> Self {
        let none = Gray::filled(0, 0, 0);
        Self {
            level: 0,
            still: true,
            background: Background::default(),
            camera: None,
            rays: Vec::new(),
            past: VecDeque::new(),
            slack: Plane::filled(0, 0, 0.0),
            layers: std::array::from_fn(|_| none.clone()),
            map: none,
            ready: false,
        }
    }

    /// Pyramid level of the map.
    pub(crate) fn level(&self) -> usize {
        self.level
    }

    /// The newest map, or nothing while there are too few pictures.
    pub(crate) fn map(&self) -> Option<&Gray> {
        self.ready.then_some(&self.map)
    }

    /// The map and its scale (full-size pixels per pixel of the map) when it shows everything that is not the empty
    /// scene, resting people included: for a camera that stands still, after a while.
    pub(crate) fn foreground(&self) -> Option<(&Gray, f64)> {
        let all = self.ready && self.still && self.background.picture().is_some();
        all.then(|| (&self.map, f64::from(1_u32 << self.level)))
    }

    /// Whether the camera has stood where it stands now for as long as is remembered.
    pub(crate) fn stands_still(&self, view: &EyeView) -> bool {
        self.past
            .iter()
            .all(|p| p.base_from_cam == view.base_from_cam)
    }

    /// No map until the next comparison.
    pub(crate) fn forget_map(&mut self) {
        self.ready = false;
    }

    /// Compare with earlier pictures; the picture is not kept yet, see [`Self::keep`].
    pub(crate) fn compare(&mut self, view: &EyeView, time_s: f64) {
        self.ready = false;
        self.level = level_for(view);
        let picture = view.pyramid.level(self.level);
        if self.map.size() != picture.size() || self.camera != Some(*view.camera) {
            self.prepare(view, picture.size());
        }
        self.still = self.stands_still(view);
        if self.still && self.background.picture().is_some() {
            self.forgive(picture);
            let mesh = self.identity_mesh();
            if let Some(empty) = self.background.picture() {
                difference(picture, empty, &mesh, &self.slack, &mut self.map);
                self.ready = true;
                return;
            }
        }
        // A longer history gives the three lags; a shorter one is not enough to tell motion from uncovering.
        let Some(oldest) = self.past.front() else {
            return;
        };
        if time_s - oldest.time_s < 0.9 * LAGS_S[1] || self.past.len() < 3 {
            return;
        }
        let chosen = self.choose(time_s);
        self.forgive(picture);
        let mut unfit = 0;
        for (layer, &which) in chosen.iter().enumerate() {
            let mut out = std::mem::replace(&mut self.layers[layer], Gray::filled(0, 0, 0));
            let mesh = self.mesh(view, &self.past[which]);
            let noise = difference(
                picture,
                &self.past[which].picture,
                &mesh,
                &self.slack,
                &mut out,
            );
            let turned = self.past[which].base_from_cam != view.base_from_cam;
            unfit += usize::from(turned && noise > UNFIT_LEVELS);
            self.layers[layer] = out;
        }
        // The middle of the three counts.
        if unfit > 1 {
            return;
        }
        let [a, b, c] = &self.layers;
        for (((m, &a), &b), &c) in self
            .map
            .samples_mut()
            .iter_mut()
            .zip(a.samples())
            .zip(b.samples())
            .zip(c.samples())
        {
            *m = a.min(b).max(a.max(b).min(c));
        }
        self.ready = true;
    }

    /// Remember the picture for later comparisons.
    ///
    /// `target` is where the target was seen, full-size pixels: it never becomes background.
    pub(crate) fn keep(&mut self, view: &EyeView, time_s: f64, target: Option<&PixelBox>) {
        self.level = level_for(view);
        let picture = view.pyramid.level(self.level);
        if self
            .past
            .back()
            .is_some_and(|p| p.base_from_cam != view.base_from_cam)
        {
            self.background.clear();
        }
        if self.still {
            let scale = 1.0 / f64::from(1_u32 << self.level);
            let target = target.map(|t| PixelBox {
                x: t.x * scale,
                y: t.y * scale,
                w: t.w * scale,
                h: t.h * scale,
            });
            self.background.learn(picture, time_s, target.as_ref());
        }
        let mut slot = if self.past.len() >= KEPT {
            self.past.pop_front()
        } else {
            None
        }
        .map_or_else(|| picture.clone(), |old| old.picture);
        if slot.size() == picture.size() {
            slot.samples_mut().copy_from_slice(picture.samples());
        } else {
            slot = picture.clone();
        }
        self.past.push_back(Past {
            picture: slot,
            base_from_cam: view.base_from_cam,
            time_s,
        });
        while self
            .past
            .front()
            .is_some_and(|p| time_s - p.time_s > 3.0 * LAGS_S[2] && self.past.len() > 4)
        {
            self.past.pop_front();
        }
    }

    fn identity_mesh(&self) -> Vec<[f32; 2]> {
        mesh_nodes(self.map.size())
            .map(|(x, y)| [x as f32, y as f32])
            .collect()
    }

    fn prepare(&mut self, view: &EyeView, size: (usize, usize)) {
        self.camera = Some(*view.camera);
        self.past.retain(|p| p.picture.size() == size);
        self.background.clear();
        self.map = Gray::filled(size.0, size.1, 0);
        self.slack = Plane::filled(size.0, size.1, 0.0);
        self.layers = std::array::from_fn(|_| self.map.clone());
        let full = f64::from(1_u32 << self.level);
        self.rays = mesh_nodes(size)
            .map(|(x, y)| {
                let px = Point2::new((x + 0.5) * full - 0.5, (y + 0.5) * full - 0.5);
                view.camera
                    .ray(&px)
                    .map_or_else(Vector3::zeros, |r| r.normalize())
            })
            .collect();
    }

    /// Index of the kept picture nearest to each lag; distinct when there are enough.
    fn choose(&self, time_s: f64) -> [usize; 3] {
        let last = self.past.len() - 1;
        let mut chosen = LAGS_S.map(|lag| {
            (0..=last)
                .min_by(|&a, &b| {
                    let miss = |i: usize| (time_s - self.past[i].time_s - lag).abs();
                    miss(a).total_cmp(&miss(b))
                })
                .unwrap_or(last)
        });
        // Slow sources: the last three pictures, rather than one of them twice.
        if chosen[1] >= chosen[0] {
            chosen[1] = chosen[0].saturating_sub(1);
        }
        if chosen[2] >= chosen[1] {
            chosen[2] = chosen[1].saturating_sub(1);
        }
        chosen
    }

    /// Grey levels per pixel that a small misregistration explains.
    fn forgive(&mut self, picture: &Gray) {
        let (w, h) = picture.size();
        for y in 0..h {
            let (above, here, below) = (
                picture.row(y.saturating_sub(1)),
                picture.row(y),
                picture.row((y + 1).min(h - 1)),
            );
            let out = self.slack.row_mut(y);
            for x in 0..w {
                let (left, right) = (x.saturating_sub(1), (x + 1).min(w - 1));
                let c = here[x];
                let steepest = c
                    .abs_diff(here[left])
                    .max(c.abs_diff(here[right]))
                    .max(c.abs_diff(above[x]))
                    .max(c.abs_diff(below[x]));
                out[x] = FORGIVEN_PX * f32::from(steepest);
            }
        }
    }

    /// Where each mesh node of the picture now was in an earlier one, pixels of the level.
    fn mesh(&self, view: &EyeView, past: &Past) -> Vec<[f32; 2]> {
        let old_from_new = past.base_from_cam.inverse() * view.base_from_cam;
        let scale = 1.0 / f64::from(1_u32 << self.level);
        self.rays
            .iter()
            .map(|ray| {
                let p = old_from_new * Point3::from(ray * BACKGROUND_M);
                let px = if p.z > 1e-3 * BACKGROUND_M {
                    view.camera.project(&p)
                } else {
                    None
                };
                px.map_or([f32::NAN; 2], |px| {
                    [
                        ((px.x + 0.5) * scale - 0.5) as f32,
                        ((px.y + 0.5) * scale - 0.5) as f32,
                    ]
                })
            })
            .collect()
    }
}

/// The finest level with a bearable number of pixels.
fn level_for(view: &EyeView) -> usize {
    let (w, h) = view.pyramid.level(0).size();
    let last = view.pyramid.count() - 1;
    (0..last)
        .find(|l| (w >> l) * (h >> l) <= MOST_PIXELS)
        .unwrap_or(last)
}

fn mesh_nodes((w, h): (usize, usize)) -> impl Iterator<Item = (f64, f64)> {
    let (cols, rows) = mesh_size(w, h);
    (0..rows).flat_map(move |j| (0..cols).map(move |i| ((i * MESH) as f64, (j * MESH) as f64)))
}

fn mesh_size(w: usize, h: usize) -> (usize, usize) {
    (w.div_ceil(MESH) + 1, h.div_ceil(MESH) + 1)
}

/// One difference picture: noise sigmas beyond what is forgiven. The answer is the noise of all pixels, grey levels.
fn difference(
    new: &Gray,
    old: &Gray,
    mesh: &[[f32; 2]],
    slack: &Plane<f32>,
    out: &mut Gray,
) -> f32 {
    let (w, h) = new.size();
    let mut warped = vec![f32::NAN; w];
    let mut residual = vec![f32::NAN; w * h];
    for y in 0..h {
        warp_row(old, mesh, y, &mut warped);
        for ((r, &n), &o) in residual[y * w..(y + 1) * w]
            .iter_mut()
            .zip(new.row(y))
            .zip(&warped)
        {
            *r = f32::from(n) - o;
        }
    }
    let gain = illumination(new, &residual);
    let (sigma, all) = noise(new, &residual, gain);
    for (((out, &r), &n), &s) in out
        .samples_mut()
        .iter_mut()
        .zip(&residual)
        .zip(new.samples())
        .zip(slack.samples())
    {
        let change = (r - gain * f32::from(n)).abs() - s;
        let sigmas = change / sigma[usize::from(n) * BINS / 256] - FORGIVEN_SIGMAS;
        // NaN (no earlier pixel there) becomes 0.
        *out = (sigmas * UNITS_PER_SIGMA).clamp(0.0, 255.0) as u8;
    }
    all
}

/// A row of the old picture as the new camera sees it; NaN outside.
fn warp_row(old: &Gray, mesh: &[[f32; 2]], y: usize, out: &mut [f32]) {
    let (w, h) = old.size();
    let (cols, _) = mesh_size(w, h);
    let (j, b) = (y / MESH, (y % MESH) as f32 / MESH as f32);
    let edge = |i: usize| -> [f32; 2] {
        let (top, bottom) = (mesh[j * cols + i], mesh[(j + 1) * cols + i]);
        [
            top[0] + b * (bottom[0] - top[0]),
            top[1] + b * (bottom[1] - top[1]),
        ]
    };
    let (mut u, mut v) = ([0.0; MESH], [0.0; MESH]);
    for (i, span) in out.chunks_mut(MESH).enumerate() {
        let (from, to) = (edge(i), edge(i + 1));
        let step = [
            (to[0] - from[0]) / MESH as f32,
            (to[1] - from[1]) / MESH as f32,
        ];
        for k in 0..MESH {
            (u[k], v[k]) = (from[0] + step[0] * k as f32, from[1] + step[1] * k as f32);
        }
        bilinear_row(old, &u[..span.len()], &v[..span.len()], span);
        let (most_u, most_v) = ((w - 1) as f32, (h - 1) as f32);
        for ((o, &u), &v) in span.iter_mut().zip(&u).zip(&v) {
            let inside = (u >= 0.0) & (v >= 0.0) & (u <= most_u) & (v <= most_v);
            *o = if inside { *o } else { f32::NAN };
        }
    }
}

/// Relative change of the light between the pictures: median over a sparse sample of residual over brightness.
fn illumination(new: &Gray, residual: &[f32]) -> f32 {
    let mut ratios: Vec<f32> = (0..residual.len())
        .step_by(37)
        .filter(|&i| residual[i].is_finite() && (16..250).contains(&new.samples()[i]))
        .map(|i| residual[i] / f32::from(new.samples()[i]))
        .collect();
    median(&mut ratios).unwrap_or(0.0)
}

/// Standard deviation of the residual per brightness bin, from the median of its magnitude (people are a minority of
/// the picture); bins with few samples borrow from their neighbours, and there is always the rounding to whole levels. Then the same of all bins
/// together.
fn noise(new: &Gray, residual: &[f32], gain: f32) -> ([f32; BINS], f32) {
    let mut magnitudes: [Vec<f32>; BINS] = std::array::from_fn(|_| Vec::new());
    for i in (0..residual.len()).step_by(11) {
        if residual[i].is_finite() {
            let n = new.samples()[i];
            magnitudes[usize::from(n) * BINS / 256].push((residual[i] - gain * f32::from(n)).abs());
        }
    }
    // 1.4826: the deviation of a normal variable over its median magnitude.
    let deviation = |m: &mut [f32]| median(m).map_or(f32::NAN, |m| 1.4826 * m);
    let all = deviation(&mut magnitudes.concat());
    let mut known = [f32::NAN; BINS];
    for (s, m) in known.iter_mut().zip(&mut magnitudes) {
        if m.len() >= 40 {
            *s = deviation(m);
        }
    }
    let bins = std::array::from_fn(|i| {
        let nearest = (0..BINS)
            .filter(|&k| known[k].is_finite())
            .min_by_key(|&k| k.abs_diff(i));
        nearest.map_or(2.0, |k| known[k]).max(0.8)
    });
    (bins, all)
}

fn median(values: &mut [f32]) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
