//! A textured body before a textured wall, seen exactly through any two cameras: rays from each pixel's samples to the
//! surfaces, lens distortion inverted, sensor noise and gain on top. The truth is the ray's intersection itself.

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use vergence_geometry::{Camera, Distortion, Eye, HeadAngles, HeadGeometry, Intrinsics};
use vergence_imaging::Gray;
use vergence_imaging::pyramid::Pyramid;
use vergence_stereo::measure::{Region, View};

/// Front of the body, upright along the base's y, 0.6 m high.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// A flat board 0.5 m wide, turned about the vertical by the angle (rad).
    Board(f64),
    /// An elliptic cylinder 0.4 m wide and 0.24 m deep: a torso.
    Torso,
}

/// What stands where.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scene {
    pub(crate) shape: Shape,
    /// Centre of the front (board) or of the axis (torso), m.
    pub(crate) place: Point3<f64>,
    /// z of the wall, m.
    pub(crate) wall_z: f64,
    pub(crate) seed: u64,
    /// Standard deviation of the body's texture, grey levels.
    pub(crate) contrast: f64,
    /// Something narrow before the left third of the body, this many metres nearer; 0 for nothing.
    pub(crate) occluder: f64,
}

/// A rig in a pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rig {
    pub(crate) cameras: [Camera; 2],
    pub(crate) base_from_cam: [Isometry3<f64>; 2],
}

/// Noise and gain of the pictures.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sensor {
    pub(crate) noise: f64,
    pub(crate) right_gain: f64,
    pub(crate) right_offset: f64,
}

pub(crate) const SENSOR: Sensor = Sensor {
    noise: 2.0,
    right_gain: 1.08,
    right_offset: -4.0,
};

pub(crate) fn camera(distortion: Distortion) -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
        distortion,
    }
}

/// 70 mm, lens centres 20 mm before the pivots.
pub(crate) fn rig(cameras: [Camera; 2], angles: &HeadAngles) -> Rig {
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };
    Rig {
        cameras,
        base_from_cam: Eye::BOTH.map(|eye| head.base_from_cam(eye, angles)),
    }
}

pub(crate) struct Pair {
    pub(crate) rig: Rig,
    pub(crate) pyramids: [Pyramid; 2],
}

impl Pair {
    pub(crate) fn views(&self) -> [View<'_>; 2] {
        [0, 1].map(|i| View {
            pyramid: &self.pyramids[i],
            camera: &self.rig.cameras[i],
            base_from_cam: &self.rig.base_from_cam[i],
        })
    }
}

/// 64 bits from a seed and two lattice indices (SplitMix64's finaliser).
fn mixed(seed: u64, i: i64, j: i64) -> u64 {
    let mut z = seed
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .wrapping_add((i as u64).wrapping_mul(0xd1b5_4a32_d192_ed03))
        .wrapping_add((j as u64).wrapping_mul(0x8cb9_2ba7_2f3d_8dd7));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// Smooth lattice noise, -1..1, one lattice cell per unit.
fn lattice(seed: u64, x: f64, y: f64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (a, b) = (ease(x - i), ease(y - j));
    let (i, j) = (i as i64, j as i64);
    let at = |di, dj| 2.0 * unit(mixed(seed, i + di, j + dj)) - 1.0;
    let top = at(0, 0) + a * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + a * (at(1, 1) - at(0, 1));
    top + b * (bottom - top)
}

/// Octaves from 0.12 m down to 3.75 mm, amplitude falling with the square root of the scale; standard deviation about 1.
pub(crate) fn cloth(seed: u64, x: f64, y: f64) -> f64 {
    let mut sum = 0.0;
    let mut size: f64 = 0.12;
    let (mut u, mut v) = (x, y);
    for octave in 0..6 {
        sum += (size / 0.12).sqrt() * lattice(seed.wrapping_add(octave), u / size, v / size);
        size /= 2.0;
        // Each octave's lattice is turned against the last one's.
        (u, v) = (0.8 * u - 0.6 * v, 0.6 * u + 0.8 * v);
    }
    sum / 0.55
}

impl Scene {
    /// Distance along a ray (in units of `ray`) to the first surface, and its grey value.
    fn shot(&self, from: &Point3<f64>, ray: &Vector3<f64>) -> (f64, f64) {
        let mut best = ((self.wall_z - from.z) / ray.z, None::<f64>);
        if let Some(body) = self.body(from, ray) {
            best = (body.0, Some(body.1));
        }
        if self.occluder > 0.0 {
            let z = self.place.z - self.occluder;
            let s = (z - from.z) / ray.z;
            let p = from + ray * s;
            let off = p - self.place;
            if s > 0.0 && s < best.0 && (-0.3..-0.06).contains(&off.x) && off.y.abs() < 0.4 {
                return (
                    s,
                    120.0 + self.contrast * cloth(self.seed + 77, off.x, off.y),
                );
            }
        }
        let p = from + ray * best.0;
        let grey = best
            .1
            .unwrap_or_else(|| 90.0 + 20.0 * cloth(self.seed + 50, p.x / 3.0, p.y / 3.0));
        (best.0, grey)
    }

    fn body(&self, from: &Point3<f64>, ray: &Vector3<f64>) -> Option<(f64, f64)> {
        let o = from - self.place;
        match self.shape {
            Shape::Board(turn) => {
                let (s, c) = turn.sin_cos();
                let normal = Vector3::new(s, 0.0, c);
                let t = -normal.dot(&o) / normal.dot(ray);
                let p = o + ray * t;
                let across = c * p.x - s * p.z;
                (t > 0.0 && across.abs() < 0.25 && p.y.abs() < 0.3)
                    .then(|| (t, self.grey(across, p.y)))
            }
            Shape::Torso => {
                let (rx, rz) = (0.2_f64, 0.12_f64);
                let (ox, oz, dx, dz) = (o.x / rx, o.z / rz, ray.x / rx, ray.z / rz);
                let (a, b, c) = (
                    dx * dx + dz * dz,
                    ox * dx + oz * dz,
                    ox * ox + oz * oz - 1.0,
                );
                let root = (b * b - a * c).max(-1.0);
                if root < 0.0 {
                    return None;
                }
                let t = (-b - root.sqrt()) / a;
                let p = o + ray * t;
                let along = 0.16 * (p.x / rx).atan2(-p.z / rz);
                (t > 0.0 && p.y.abs() < 0.3).then(|| (t, self.grey(along, p.y)))
            }
        }
    }

    fn grey(&self, x: f64, y: f64) -> f64 {
        110.0 + self.contrast * cloth(self.seed, x, y)
    }

    /// Point on the first surface along the ray of a left pixel.
    pub(crate) fn point(&self, rig: &Rig, left_px: &Point2<f64>) -> Point3<f64> {
        let pose = &rig.base_from_cam[0];
        let ray = pose * rig.cameras[0].ray(left_px).unwrap();
        let from = Point3::from(pose.translation.vector);
        from + ray * self.shot(&from, &ray).0
    }

    /// True disparity `u_l - u_r` (undistorted) of a left pixel.
    pub(crate) fn disparity(&self, rig: &Rig, left_px: &Point2<f64>) -> f64 {
        let point = self.point(rig, left_px);
        let [l, r] = [0, 1].map(|i| {
            let k = &rig.cameras[i].intrinsics;
            let p = rig.base_from_cam[i].inverse_transform_point(&point);
            k.fx * p.x / p.z + k.cx
        });
        l - r
    }

    /// The box of 0.36 x 0.5 m around the body's middle in the left picture, off by a part of a pixel that depends on the
    /// seed.
    pub(crate) fn region(&self, rig: &Rig) -> Region {
        let front = self.place
            - Vector3::new(
                0.0,
                0.0,
                match self.shape {
                    Shape::Board(_) => 0.0,
                    Shape::Torso => 0.12,
                },
            );
        let p = rig.base_from_cam[0].inverse_transform_point(&front);
        let px = rig.cameras[0].project(&p).unwrap();
        let part = |k: i64| unit(mixed(self.seed, k, 9)) - 0.5;
        let scale = rig.cameras[0].intrinsics.fx / p.z;
        Region {
            centre_px: Point2::new(px.x + part(1), px.y + part(2)),
            width_px: 0.36 * scale,
            height_px: 0.5 * scale,
        }
    }

    /// Both pictures as pyramids of five levels, computed where the body is and grey elsewhere.
    pub(crate) fn pair(&self, rig: &Rig, sensor: &Sensor) -> Pair {
        let pictures = [0, 1].map(|eye| {
            let (gain, offset) = if eye == 0 {
                (1.0, 0.0)
            } else {
                (sensor.right_gain, sensor.right_offset)
            };
            let picture = self.picture(rig, eye, |grey, noise| {
                gain * grey + offset + sensor.noise * noise
            });
            Pyramid::new(&picture, 5)
        });
        Pair {
            rig: *rig,
            pyramids: pictures,
        }
    }

    fn picture(&self, rig: &Rig, eye: usize, expose: impl Fn(f64, f64) -> f64) -> Gray {
        let (camera, pose) = (&rig.cameras[eye], &rig.base_from_cam[eye]);
        let from = Point3::from(pose.translation.vector);
        let at = camera
            .project(&pose.inverse_transform_point(&self.place))
            .unwrap();
        let reach = 0.42 * camera.intrinsics.fx / (self.place.z - 0.2);
        let k = &camera.intrinsics;
        let turn = pose.rotation.to_rotation_matrix();
        Gray::from_fn(k.width, k.height, |x, y| {
            if (x as f64 - at.x).abs() > reach || (y as f64 - at.y).abs() > reach {
                return 90;
            }
            let mut sum = 0.0;
            let side = if self.place.z > 4.0 { 4 } else { 2 };
            // The lens is inverted in the pixel's centre and linear within the pixel (to 1e-6 px).
            let middle = camera
                .normalized_from_pixel(&Point2::new(x as f64, y as f64))
                .unwrap();
            let j = camera.distortion.jacobian(&middle);
            let det = (j[0] * j[3] - j[1] * j[2]) * k.fx;
            for row in 0..side {
                for column in 0..side {
                    let part = |n: i32| (f64::from(n) + 0.5) / f64::from(side) - 0.5;
                    let (u, v) = (part(column), part(row));
                    let n = Vector3::new(
                        middle.x + (j[3] * u - j[1] * v) / det,
                        middle.y + (j[0] * v - j[2] * u) / det,
                        1.0,
                    );
                    let ray = turn * n;
                    sum += self.shot(&from, &ray).1;
                }
            }
            let bits = mixed(self.seed ^ 0xabcd, (x + 5000 * eye) as i64, y as i64);
            let (a, b) = (1.0 - unit(bits), unit(mixed(bits, 1, 2)));
            let normal = (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos();
            (expose(sum / f64::from(side * side), normal))
                .round()
                .clamp(0.0, 255.0) as u8
        })
    }
}
