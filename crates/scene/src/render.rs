//! Pictures of the world.
//!
//! A picture is cut into tiles of 64 x 16 pixels; per tile only the things whose bounds meet it are looked at. Rays go
//! through pixel centres; where the surface changes between neighbouring pixels, a pixel is taken with
//! 8 rays (64 in tiles with a calibration mark), and rays that meet a surface which shows at the centre of the pixel or
//! of one next to it take its colour from there. A tile in which everything moves alike during the exposure (the camera
//! turns) is smeared along that motion; one in which something moves by itself is taken at 2 to 16 instants.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use vergence_geometry::{Camera, Eye};
use vergence_imaging::Rgb;

use crate::camera::TwinCamera;
use crate::error::SceneError;
use crate::figure::FIGURE_SOLIDS;
use crate::hash::mix;
use crate::light::{Lighting, balls, surface_axes};
use crate::material::Textures;
use crate::room::ROOM;
use crate::sensor::Sensor;
use crate::shade::Flat;
use crate::solid::Solid;
use crate::tile::{
    AROUND, COARSE_EDGE_SAMPLES, EDGE_SAMPLES, Instant, MARGIN, Place, RayTable, Surroundings,
    TILE, Workspace,
};
use crate::view::{Rect, View};
use crate::world::World;

/// One pair to be taken.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    /// Number of the pair: with the seed it chooses the noise.
    pub index: u64,
    /// Middle of the exposure of the left and of the right camera, s.
    pub mid_exposure_s: [f64; 2],
    /// Where each camera stands at any time within its exposure: base points to camera points.
    pub cam_from_base: &'a (dyn Fn(Eye, f64) -> Isometry3<f64> + Sync),
}

/// Renders pairs of a world; keeps its tables and buffers from frame to frame.
///
/// The pictures depend on the world, the cameras, the seed and the shot alone: not on the number of threads (rayon's
/// current pool) and, since no kernel fuses a multiplication with an addition, not on the processor's vector width.
pub struct Renderer {
    world: Arc<World>,
    cameras: [TwinCamera; 2],
    eyes: [EyeTables; 2],
    flats: Vec<(Flat, u16)>,
    textures: Textures,
    lighting: Arc<Lighting>,
    seed: u64,
    edge_samples: usize,
    workspaces: Mutex<Vec<Workspace>>,
}

/// What does not change from frame to frame.
#[derive(Clone)]
struct EyeTables {
    rays: RayTable,
    places: Vec<Place>,
    sensor: Sensor,
}

/// One eye's frame in the making.
struct EyeFrame {
    /// Views at 1, 2, 4, 8, 16 instants; empty where no tile needs so many.
    levels: [Vec<View>; LEVELS],
    /// Level that everything at rest needs.
    still_level: usize,
    /// Level that every solid needs which does not move in the picture as what is at rest behind it.
    own_motion: Vec<Option<usize>>,
    /// Turns of the camera from the middle of the exposure to its start and end.
    turns: [UnitQuaternion<f64>; 2],
    cubes: Vec<[f32; 6]>,
    balls: Vec<[f32; 4]>,
    noise_key: u64,
}

const LEVELS: usize = 5;

impl Renderer {
    /// A renderer for two cameras (left, right); `seed` chooses the noise. Fails on settings out of range and on
    /// distortion that cannot be undone within the picture.
    pub fn new(world: Arc<World>, cameras: [TwinCamera; 2], seed: u64) -> Result<Self, SceneError> {
        cameras.iter().try_for_each(TwinCamera::check)?;
        let left = EyeTables::new(&cameras[0])?;
        let right = if cameras[1] == cameras[0] {
            left.clone()
        } else {
            EyeTables::new(&cameras[1])?
        };
        Ok(Self {
            flats: flats(&world),
            textures: Textures::new(world.config().seed),
            lighting: world.lighting(),
            eyes: [left, right],
            world,
            cameras,
            seed,
            edge_samples: EDGE_SAMPLES,
            workspaces: Mutex::new(Vec::new()),
        })
    }

    /// Edges between surfaces are taken with 2 rays a pixel instead of 8: where many pictures are wanted, and a tenth of a pixel does not matter.
    pub fn with_coarse_edges(self) -> Self {
        Self {
            edge_samples: COARSE_EDGE_SAMPLES,
            ..self
        }
    }

    /// A renderer for the same cameras in the same room with nobody in it, at a hundredth of what it takes to make one.
    pub fn without_people(&self) -> Self {
        Self {
            world: Arc::new(self.world.without_people()),
            cameras: self.cameras,
            eyes: self.eyes.clone(),
            flats: self.flats.clone(),
            textures: self.textures.clone(),
            lighting: Arc::clone(&self.lighting),
            seed: self.seed,
            edge_samples: self.edge_samples,
            workspaces: Mutex::new(Vec::new()),
        }
    }

    /// The world that is seen.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// The two cameras, left and right.
    pub fn cameras(&self) -> &[TwinCamera; 2] {
        &self.cameras
    }

    /// Renders both pictures of a shot. A buffer of another size than its camera's is replaced by one that fits.
    pub fn render_pair(&mut self, shot: &Shot, out: [&mut Rgb; 2]) {
        let frames = Eye::BOTH.map(|eye| self.frame(eye, shot));
        let mut bands: Vec<(usize, usize, &mut [[u8; 3]])> = Vec::new();
        for (e, picture) in out.into_iter().enumerate() {
            let k = &self.cameras[e].camera.intrinsics;
            if picture.size() != (k.width, k.height) {
                *picture = Rgb::filled(k.width, k.height, [0; 3]);
            }
            let rows = picture.samples_mut().chunks_mut(k.width * TILE[1]);
            bands.extend(rows.enumerate().map(|(b, rows)| (e, b, rows)));
        }
        bands.par_iter_mut().for_each(|(e, band, rows)| {
            let mut work = self.workspace();
            self.render_band(*e, &frames[*e], *band, rows, &mut work);
            self.give_back(work);
        });
    }

    fn workspace(&self) -> Workspace {
        let mut spare = self
            .workspaces
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        spare.pop().unwrap_or_else(Workspace::new)
    }

    fn give_back(&self, work: Workspace) {
        let mut spare = self
            .workspaces
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        spare.push(work);
    }

    /// Everything that all tiles of one eye's picture share.
    fn frame(&self, eye: Eye, shot: &Shot) -> EyeFrame {
        let twin = &self.cameras[eye as usize];
        let mid_s = shot.mid_exposure_s[eye as usize];
        let open_s = if twin.motion_blur {
            twin.exposure_s
        } else {
            0.0
        };
        let at = |share: f64| {
            let time_s = mid_s + (share - 0.5) * open_s;
            let mut solids = Vec::new();
            self.world.solids(time_s, &mut solids);
            (solids, (shot.cam_from_base)(eye, time_s))
        };
        let middle = at(0.5);
        let (mut still_level, mut own_motion) = (0, vec![None; middle.0.len()]);
        let mut turns = [UnitQuaternion::identity(); 2];
        if open_s > 0.0 {
            let (start, end) = (at(0.0), at(1.0));
            turns = [&start, &end].map(|s| s.1.rotation * middle.1.rotation.inverse());
            still_level = level_of(still_motion_px(&twin.camera, &start.1, &end.1));
            own_motion = own_motions(&twin.camera, &start, &end);
        }
        let mut needed = [false; LEVELS];
        (needed[0], needed[still_level]) = (true, true);
        for own in own_motion.iter().flatten() {
            needed[*own.max(&still_level)] = true;
        }
        let levels = std::array::from_fn(|l| {
            let n = if needed[l] { 1 << l } else { 0 };
            (0..n)
                .map(|k| {
                    let (solids, pose) = at((f64::from(k) + 0.5) / f64::from(n));
                    View::new(&self.world, &solids, &pose)
                })
                .collect()
        });
        let (cubes, balls) = self.lit(&middle.0);
        EyeFrame {
            levels,
            still_level,
            own_motion,
            turns,
            cubes,
            balls,
            noise_key: mix(self.seed ^ mix(shot.index * 2 + eye as u64)),
        }
    }

    /// Light on the solids, and the balls that shade the floor.
    fn lit(&self, solids: &[Solid]) -> (Vec<[f32; 6]>, Vec<[f32; 4]>) {
        let still = self.world.room.solids.len();
        let lighting = &self.lighting;
        let mut cubes: Vec<[f32; 6]> = solids[..still]
            .iter()
            .map(|s| lighting.cube_at(&s.centre, &[]))
            .collect();
        let mut shading = Vec::new();
        for figure in solids[still..].chunks(FIGURE_SOLIDS) {
            let own = balls(figure);
            for (i, s) in figure.iter().enumerate() {
                let others: Vec<(Point3<f64>, f64)> = own
                    .iter()
                    .enumerate()
                    .filter(|(j, _)| *j != i)
                    .map(|(_, b)| *b)
                    .collect();
                cubes.push(lighting.cube_at(&s.centre, &others));
            }
            shading.extend(
                own.iter()
                    .map(|(c, r)| [c.x as f32, c.y as f32, c.z as f32, *r as f32]),
            );
        }
        (cubes, shading)
    }

    fn render_band(
        &self,
        e: usize,
        frame: &EyeFrame,
        band: usize,
        rows: &mut [[u8; 3]],
        work: &mut Workspace,
    ) {
        let twin = &self.cameras[e];
        let tables = &self.eyes[e];
        let width = twin.camera.intrinsics.width;
        let around = Surroundings {
            world: &self.world,
            textures: &self.textures,
            lighting: &self.lighting,
            flats: &self.flats,
            cubes: &frame.cubes,
            balls: &frame.balls,
            level: self.world.config().light.level(),
            pixel: (1.0 / twin.camera.intrinsics.fx) as f32,
            edge_samples: self.edge_samples,
        };
        let across = width.div_ceil(TILE[0]);
        for place in &tables.places[band * across..(band + 1) * across] {
            self.expose(frame, place, &tables.rays, &around, work);
            for y in 0..place.height {
                let from = (place.y + y) * tables.rays.stride + place.x;
                let own = y * place.width..(y + 1) * place.width;
                let light = work.sum.each_ref().map(|s| &s[own.clone()]);
                let rays = [&tables.rays.nx, &tables.rays.ny].map(|n| &n[from..from + place.width]);
                let first = (place.y - AROUND + y) * width + place.x - AROUND;
                let out = &mut rows[y * width + place.x - AROUND..][..place.width];
                tables
                    .sensor
                    .develop(light, rays, frame.noise_key, first, out, &mut work.codes);
            }
        }
    }

    /// Light that falls on a tile during the exposure, into `work.sum`.
    fn expose(
        &self,
        frame: &EyeFrame,
        place: &Place,
        rays: &RayTable,
        around: &Surroundings,
        work: &mut Workspace,
    ) {
        let n = place.width * place.height;
        match frame.plan(place, rays, around.pixel) {
            Plan::Instants(level) if frame.levels[level].len() == 1 => {
                work.render(&frame.levels[level][0], place, rays, around, Instant::ONLY);
                std::mem::swap(&mut work.sum, &mut work.rgb);
            }
            Plan::Instants(level) => {
                let views = &frame.levels[level];
                work.sum.iter_mut().for_each(|s| s[..n].fill(0.0));
                let weight = 1.0 / views.len() as f32;
                for (index, view) in views.iter().enumerate() {
                    let instant = Instant {
                        index,
                        count: views.len(),
                    };
                    work.render(view, place, rays, around, instant);
                    for (sum, rgb) in work.sum.iter_mut().zip(&work.rgb) {
                        for (s, v) in sum[..n].iter_mut().zip(&rgb[..n]) {
                            *s += v * weight;
                        }
                    }
                }
            }
            Plan::Smear(motion) => {
                // As far as the motion reaches to either side of the middle.
                let margin = motion.map(|m| (m.abs() / 2.0 + 1e-3).ceil() as usize);
                let wide = place.with_margin(margin, around.pixel);
                work.render(&frame.levels[0][0], &wide, rays, around, Instant::ONLY);
                work.smear(place, &wide, motion);
            }
        }
    }
}

/// How a tile is exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plan {
    /// At 2^n instants.
    Instants(usize),
    /// At the middle, smeared along one motion, pixels: all that it shows moves alike, because only the camera
    /// turns.
    Smear([f32; 2]),
}

impl EyeFrame {
    fn plan(&self, place: &Place, rays: &RayTable, pixel: f32) -> Plan {
        if self.levels[0].is_empty() {
            return Plan::Instants(self.still_level);
        }
        // Bounds at another instant of the exposure differ by the motion itself: at most some pixels.
        let wide = place.rect.grown((2 * MARGIN) as f32 * pixel);
        let solids = &self.levels[0][0].solids;
        let own = (self.own_motion.iter().zip(solids))
            .filter(|(own, (_, bounds))| own.is_some() && bounds.meets(&wide))
            .filter_map(|(own, _)| *own)
            .max();
        if let Some(level) = own {
            return Plan::Instants(level.max(self.still_level));
        }
        if self.still_level == 0 {
            return Plan::Instants(0);
        }
        let motion = self.still_motion(place, rays);
        if motion.iter().all(|m| m.abs() <= 2.0 * (MARGIN - 1) as f32) {
            Plan::Smear(motion)
        } else {
            Plan::Instants(self.still_level)
        }
    }

    /// Motion in pixels, over the exposure, of what is far away behind the middle of a tile.
    fn still_motion(&self, place: &Place, rays: &RayTable) -> [f32; 2] {
        let at = (place.y + place.height / 2) * rays.stride + place.x + place.width / 2;
        let middle = Vector3::new(f64::from(rays.nx[at]), f64::from(rays.ny[at]), 1.0);
        let seen = |turn: &UnitQuaternion<f64>| {
            let d = turn * middle;
            [d.x / d.z, d.y / d.z]
        };
        let [from, to] = self.turns.each_ref().map(seen);
        let across = rays.nx[at + 1] - rays.nx[at - 1];
        let down = rays.ny[at + rays.stride] - rays.ny[at - rays.stride];
        [
            (to[0] - from[0]) as f32 * 2.0 / across,
            (to[1] - from[1]) as f32 * 2.0 / down,
        ]
    }
}

/// Instants (as a power of two) for a motion in pixels: about one per pixel. Up to 0.8 pixels, which would widen the
/// picture's point spread by a standard deviation of 0.23 pixels, no blur is drawn.
fn level_of(motion_px: f64) -> usize {
    [0.8, 2.4, 4.8, 9.6]
        .iter()
        .filter(|limit| motion_px.is_nan() || motion_px > **limit)
        .count()
}

/// Largest motion of anything at rest during the exposure, pixels: turns of the camera at the picture's corners,
/// and its shift as seen at 0.7 m.
fn still_motion_px(camera: &Camera, start: &Isometry3<f64>, end: &Isometry3<f64>) -> f64 {
    let k = &camera.intrinsics;
    let reach = (k.width as f64 / 2.0 / k.fx, k.height as f64 / 2.0 / k.fy);
    let end_from_start = end * start.inverse();
    let turned = [
        (-1.0, -1.0),
        (1.0, -1.0),
        (-1.0, 1.0),
        (1.0, 1.0),
        (0.0, 0.0),
    ]
    .into_iter()
    .map(|(a, b)| {
        let from = Vector3::new(a * reach.0, b * reach.1, 1.0);
        let to = end_from_start.rotation * from;
        ((to / to.z - from).norm() * k.fx).abs()
    })
    .fold(0.0, f64::max);
    turned + end_from_start.translation.vector.norm() / 0.7 * k.fx
}

/// Levels of the solids that move in the picture otherwise (by more than 0.8 pixels) than if they were at rest.
fn own_motions(
    camera: &Camera,
    start: &(Vec<Solid>, Isometry3<f64>),
    end: &(Vec<Solid>, Isometry3<f64>),
) -> Vec<Option<usize>> {
    let focal_px = camera.intrinsics.fx;
    let seen = |pose: &Isometry3<f64>, p: Point3<f64>| {
        let c = pose * p;
        Vector3::new(c.x, c.y, 0.0) / c.z.max(0.1) * focal_px
    };
    let ends = |s: &Solid| [s.origin, s.far()];
    (start.0.iter().zip(&end.0))
        .map(|(a, b)| {
            let (mut most, mut own) = (0.0_f64, 0.0_f64);
            for (p, q) in ends(a).into_iter().zip(ends(b)) {
                let (from, to) = (seen(&start.1, p), seen(&end.1, q));
                most = most.max((to - from).norm());
                own = own.max((to - seen(&end.1, p)).norm());
            }
            (own > 0.8).then(|| level_of(most))
        })
        .collect()
}

impl EyeTables {
    fn new(twin: &TwinCamera) -> Result<Self, SceneError> {
        let rays = RayTable::new(&twin.camera)?;
        let k = &twin.camera.intrinsics;
        let mut places = Vec::new();
        for y in (0..k.height).step_by(TILE[1]) {
            for x in (0..k.width).step_by(TILE[0]) {
                let (width, height) = (TILE[0].min(k.width - x), TILE[1].min(k.height - y));
                let (x, y) = (x + AROUND, y + AROUND);
                let mut rect = Rect::NONE;
                for v in 0..height + 2 {
                    let row = (y + v - 1) * rays.stride + x - 1;
                    for i in row..row + width + 2 {
                        rect.include(rays.nx[i], rays.ny[i]);
                    }
                }
                places.push(Place {
                    x,
                    y,
                    width,
                    height,
                    rect,
                });
            }
        }
        Ok(Self {
            rays,
            places,
            sensor: Sensor::new(twin),
        })
    }
}

impl RayTable {
    fn new(camera: &Camera) -> Result<Self, SceneError> {
        let k = &camera.intrinsics;
        let stride = k.width + 2 * AROUND;
        let rays: Option<Vec<(f32, f32)>> = (0..stride * (k.height + 2 * AROUND))
            .into_par_iter()
            .map(|i| {
                let at = |k: usize| k as f64 - AROUND as f64;
                let px = Point2::new(at(i % stride), at(i / stride));
                camera
                    .normalized_from_pixel(&px)
                    .map(|n| (n.x as f32, n.y as f32))
            })
            .collect();
        let rays = rays.ok_or(SceneError::Camera {
            setting: "distortion.k1",
            value: camera.distortion.coefficients()[0],
            expected: "coefficients whose distortion does not fold over within the picture",
        })?;
        let (nx, ny) = rays.into_iter().unzip();
        Ok(Self { nx, ny, stride })
    }
}

/// The flat surfaces for shading: the room's faces, then six for every box.
fn flats(world: &World) -> Vec<(Flat, u16)> {
    let flat = |axis: usize, material: u16, zero: &[f64; 3], is_low_top: bool| {
        let [a, b] = surface_axes(axis);
        let tile = world.palette.materials[usize::from(material)].tile_m;
        let flat = Flat {
            axes: [axis, a, b],
            zero: [zero[a] as f32, zero[b] as f32],
            per_m: tile.map(|m| 1.0 / m),
            is_low_top,
        };
        (flat, material)
    };
    let corner = ROOM.map(|r| r[0]);
    let mut list: Vec<(Flat, u16)> = world
        .room
        .faces
        .iter()
        .enumerate()
        .map(|(face, &m)| flat(face / 2, m, &corner, false))
        .collect();
    for (i, c) in world.room.cuboids.iter().enumerate() {
        let low = c.hi.y - c.lo.y < 0.035 && c.hi.y > ROOM[1][1] - 0.04;
        // Every box shows another part of its pattern.
        let shift = |k: u64| crate::hash::uniform(i as u64, k) * 3.0;
        let zero = [c.lo.x - shift(1), c.lo.y - shift(2), c.lo.z - shift(3)];
        for face in 0..6 {
            list.push(flat(face / 2, c.material, &zero, low && face == 2));
        }
    }
    list
}
