//! Proves that pictures show things where geometry says: saddle marks hung in the room are found in rendered pictures
//! within 0.02 px of an independent projection (closed forms of the planner's model and ray shooting, with the
//! distortion written out here), in the modes parallel (which `shifted` shares), converged and verged, with the lens
//! centre on and off the pivot, over the whole picture; and with the head panned and tilted, through a lens with all eight
//! coefficients. Also that motion blur leaves marks where they are at the
//! middle of the exposure. It does not prove colours.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, SMatrix, SVector, Vector3};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::{
    Light, Mark, MarkKind, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig,
};

const BASE_M: f64 = 0.07;
/// Within this, pixels.
const LIMIT_PX: f64 = 0.02;

/// Marks over the whole field at a distance, cards about 32 pixels high.
fn marks(depth_m: f64, camera: &TwinCamera) -> Vec<Mark> {
    let k = &camera.camera.intrinsics;
    let reach = (
        k.width as f64 / 2.0 / k.fx * depth_m,
        k.height as f64 / 2.0 / k.fy * depth_m,
    );
    let mut list = Vec::new();
    for i in -4_i32..=4 {
        for j in -3_i32..=3 {
            let (a, b) = (f64::from(i) / 4.0, f64::from(j) / 3.0);
            list.push(Mark {
                centre: Point3::new(0.93 * a * reach.0, 0.92 * b * reach.1, depth_m),
                normal: Vector3::new(0.15 * a, 0.1 * b, -1.0),
                half_m: 16.0 / k.fx * depth_m,
                kind: MarkKind::Saddle,
            });
        }
    }
    list
}

/// A mode as the planner's model has it: the turns of both cameras, + right.
fn pans(mode: &str, target: &Point3<f64>) -> [f64; 2] {
    match mode {
        "parallel" => [0.0, 0.0],
        "converged" => [1.0, -1.0].map(|s| s * (BASE_M / 2.0 / target.z).atan()),
        _ => [-1.0, 1.0].map(|s: f64| (target.x - s * BASE_M / 2.0).atan2(target.z)),
    }
}

/// Undistorted upright image position (x right, y down, focal length 1) by shooting a ray: lens centre, optical axis,
/// and the right-hand direction written out, no transformation library.
fn shot_ray(p: &Point3<f64>, side: f64, pan: f64, pupil_m: f64) -> Option<[f64; 2]> {
    let (s, c) = pan.sin_cos();
    let lens = [side * BASE_M / 2.0 + pupil_m * s, 0.0, pupil_m * c];
    let to = [p.x - lens[0], p.y - lens[1], p.z - lens[2]];
    let depth = to[0] * s + to[2] * c;
    let right = to[0] * c - to[2] * s;
    (depth > 0.0).then(|| [right / depth, to[1] / depth])
}

/// The closed form for `converged` with the lens on the pivot (README of the model): x and y over f.
fn closed_form(p: &Point3<f64>, side: f64, convergence_m: f64) -> [f64; 2] {
    let (a, b) = (BASE_M / 2.0 / p.z, BASE_M / 2.0 / convergence_m);
    let beta = b.atan();
    let x = p.x / p.z;
    let depth = p.z * beta.cos() - side * (p.x - side * BASE_M / 2.0) * beta.sin();
    let x = if side < 0.0 {
        (x + a - b) / (1.0 + (x + a) * b)
    } else {
        (x - a + b) / (1.0 - (x - a) * b)
    };
    [x, p.y / depth]
}

/// Brown (1971) over the denominator of Claus and Fitzgibbon (2005), written out again.
fn pixel(n: [f64; 2], camera: &TwinCamera) -> [f64; 2] {
    let k = &camera.camera.intrinsics;
    let mut lens = camera.camera.distortion;
    let d = lens.brown_conrady_mut().unwrap();
    let [x, y] = n;
    let r2 = x * x + y * y;
    let radial = (1.0 + d.k1 * r2 + d.k2 * r2 * r2 + d.k3 * r2 * r2 * r2)
        / (1.0 + d.k4 * r2 + d.k5 * r2 * r2 + d.k6 * r2 * r2 * r2);
    [
        k.fx * (x * radial + 2.0 * d.p1 * x * y + d.p2 * (r2 + 2.0 * x * x)) + k.cx,
        k.fy * (y * radial + d.p1 * (r2 + 2.0 * y * y) + 2.0 * d.p2 * x * y) + k.cy,
    ]
}

/// Grey levels around a place, smoothed by a Gaussian of 1.6 pixels: a picture with steps in it is sampled too coarsely
/// for gradients to be taken at once.
struct Patch {
    corner: [i64; 2],
    grey: Vec<f64>,
}

impl Patch {
    const SIDE: i64 = 21;
    const REACH: i64 = 6;

    fn new(picture: &Rgb, start: [f64; 2]) -> Self {
        let corner = start.map(|c| c.round() as i64 - Self::SIDE / 2);
        let weight = |k: i64| (-(k * k) as f64 / (2.0 * 1.6 * 1.6)).exp();
        let total: f64 = (-Self::REACH..=Self::REACH).map(weight).sum();
        let (w, h) = picture.size();
        let at = |x: i64, y: i64| {
            let (x, y) = (x.clamp(0, w as i64 - 1), y.clamp(0, h as i64 - 1));
            f64::from(picture.at(x as usize, y as usize)[1])
        };
        let reach = -Self::REACH..=Self::REACH;
        // Along the rows first, then across them.
        let rows: Vec<f64> = (0..(Self::SIDE + 2 * Self::REACH) * Self::SIDE)
            .map(|i| {
                let (x, y) = (
                    corner[0] + i % Self::SIDE,
                    corner[1] + i / Self::SIDE - Self::REACH,
                );
                reach.clone().map(|k| weight(k) * at(x + k, y)).sum::<f64>() / total
            })
            .collect();
        let grey = (0..Self::SIDE * Self::SIDE)
            .map(|i| {
                let from = |k: i64| rows[(i + (k + Self::REACH) * Self::SIDE) as usize];
                reach.clone().map(|k| weight(k) * from(k)).sum::<f64>() / total
            })
            .collect();
        Self { corner, grey }
    }

    fn at(&self, x: i64, y: i64) -> f64 {
        self.grey[((y - self.corner[1]) * Self::SIDE + x - self.corner[0]) as usize]
    }
}

/// The saddle point near `start`: least squares of `c + d tanh(k a) tanh(k b)`, with a and b the distances from two
/// lines of any direction that cross there (Gauss–Newton). The model is odd about the crossing as the picture is,
/// so that it need not be the exact profile of a blurred edge.
fn saddle(picture: &Rgb, start: [f64; 2]) -> [f64; 2] {
    const HALF: i64 = 6;
    let patch = Patch::new(picture, start);
    let (cx, cy) = (start[0].round() as i64, start[1].round() as i64);
    let width = 1.2 / (2.0 * (1.6 * 1.6 + 1.0 / 12.0_f64)).sqrt();
    let mut p = SVector::<f64, 6>::from([start[0], start[1], 0.0, 0.0, 110.0, -100.0]);
    for _ in 0..8 {
        let ((s1, c1), (s2, c2)) = (p[2].sin_cos(), p[3].sin_cos());
        let (mut normal, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        for y in cy - HALF..=cy + HALF {
            for x in cx - HALF..=cx + HALF {
                let (dx, dy) = (x as f64 - p[0], y as f64 - p[1]);
                let (a, b) = (
                    (width * (c1 * dx + s1 * dy)).tanh(),
                    (width * (c2 * dy - s2 * dx)).tanh(),
                );
                let (da, db) = (
                    p[5] * width * (1.0 - a * a) * b,
                    p[5] * width * (1.0 - b * b) * a,
                );
                let row = SVector::<f64, 6>::from([
                    s2 * db - c1 * da,
                    -s1 * da - c2 * db,
                    da * (c1 * dy - s1 * dx),
                    -db * (s2 * dy + c2 * dx),
                    1.0,
                    a * b,
                ]);
                normal += row * row.transpose();
                right += row * (patch.at(x, y) - p[4] - p[5] * a * b);
            }
        }
        p += normal.lu().solve(&right).unwrap();
    }
    [p[0], p[1]]
}

fn renderer(marks: Vec<Mark>, camera: TwinCamera) -> Renderer {
    let world = World::new(&WorldConfig {
        path: PathSpec::Empty,
        light: Light::Day,
        seed: 3,
        marks,
    })
    .unwrap();
    Renderer::new(Arc::new(world), [camera; 2], 1).unwrap()
}

fn rendered(
    renderer: &mut Renderer,
    pose: &(dyn Fn(Eye, f64) -> Isometry3<f64> + Sync),
) -> [Rgb; 2] {
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    let [left, right] = &mut pair;
    renderer.render_pair(
        &Shot {
            index: 0,
            mid_exposure_s: [1.0; 2],
            cam_from_base: pose,
        },
        [left, right],
    );
    pair
}

/// Largest and root-mean-square distance of found marks from where they must be, and their number.
fn errors(
    pair: &[Rgb; 2],
    marks: &[Mark],
    expected: impl Fn(&Point3<f64>, f64) -> Option<[f64; 2]>,
) -> (f64, f64, usize) {
    let (mut most, mut sum, mut n) = (0.0_f64, 0.0, 0);
    for (eye, picture) in Eye::BOTH.into_iter().zip(pair) {
        let (w, h) = picture.size();
        for mark in marks {
            let Some([u, v]) = expected(&mark.centre, eye.side()) else {
                continue;
            };
            let margin = 17.0;
            if u < margin
                || v < margin
                || u > w as f64 - 1.0 - margin
                || v > h as f64 - 1.0 - margin
            {
                continue;
            }
            // Begin off the true place: the search must find it, not keep it.
            let found = saddle(picture, [u + 0.7, v - 0.6]);
            let e = (found[0] - u).hypot(found[1] - v);
            most = most.max(e);
            sum += e * e;
            n += 1;
        }
    }
    (most, (sum / n as f64).sqrt(), n)
}

#[test]
fn marks_are_where_the_model_says() {
    let camera = TwinCamera::ideal(TwinCamera::default().camera);
    for depth_m in [1.1, 4.0] {
        let marks = marks(depth_m, &camera);
        let mut renderer = renderer(marks.clone(), camera);
        for mode in ["parallel", "converged", "verged"] {
            for pupil_m in [0.0, 0.02] {
                let target = Point3::new(
                    if mode == "verged" {
                        0.08 * depth_m
                    } else {
                        0.0
                    },
                    0.0,
                    depth_m,
                );
                let pan = pans(mode, &target);
                let rig = HeadGeometry {
                    interaxial_m: BASE_M,
                    pupil_m,
                };
                let angles = HeadAngles {
                    pan: 0.0,
                    tilt: 0.0,
                    left: pan[0],
                    right: pan[1],
                };
                let pose = |eye: Eye, _: f64| rig.cam_from_base(eye, &angles);
                let pair = rendered(&mut renderer, &pose);
                let by_ray = |p: &Point3<f64>, side: f64| {
                    let n = shot_ray(p, side, pan[usize::from(side > 0.0)], pupil_m)?;
                    if mode == "converged" && pupil_m == 0.0 {
                        let closed = closed_form(p, side, target.z);
                        assert!((n[0] - closed[0]).abs() + (n[1] - closed[1]).abs() < 1e-12);
                    }
                    Some(pixel(n, &camera))
                };
                let (most, rms, n) = errors(&pair, &marks, by_ray);
                println!(
                    "{mode}, pupil {pupil_m} m, {depth_m} m: {n} marks, largest {most:.4} px, rms {rms:.4} px"
                );
                assert!(n >= 80, "{n} marks in view");
                assert!(
                    most < LIMIT_PX,
                    "{mode}, pupil {pupil_m} m, {depth_m} m: {most} px"
                );
            }
        }
    }
}

/// A place of the base frame in the frame of a head that is panned and tilted, written out: + pan turns the head to the right,
/// + tilt upwards (y points down).
fn in_head(p: &Point3<f64>, pan: f64, tilt: f64) -> Point3<f64> {
    let ((sp, cp), (st, ct)) = (pan.sin_cos(), tilt.sin_cos());
    let ahead = p.x * sp + p.z * cp;
    Point3::new(
        p.x * cp - p.z * sp,
        p.y * ct + ahead * st,
        ahead * ct - p.y * st,
    )
}

/// The same with the head panned and tilted, its cameras verged and their lenses off the pivots, through a lens with all eight
/// coefficients.
#[test]
fn marks_are_where_the_model_says_when_the_head_is_turned() {
    let mut camera = TwinCamera::ideal(TwinCamera::default().camera);
    let d = camera.camera.distortion.brown_conrady_mut().unwrap();
    (d.k1, d.k2, d.k3) = (0.12, -0.05, 0.02);
    (d.k4, d.k5, d.k6) = (0.2, 0.03, 0.01);
    let (pupil_m, vergence) = (0.02, [0.03, -0.05]);
    for (pan, tilt, depth_m) in [(0.3, -0.2, 1.1), (-0.25, 0.15, 2.0)] {
        // Hung before the turned head: the turn undone by its opposite, first tilt, then pan.
        let to_base = |p: &Point3<f64>| in_head(&in_head(p, 0.0, -tilt), -pan, 0.0);
        let turned: Vec<Mark> = marks(depth_m, &camera)
            .into_iter()
            .map(|mark| Mark {
                centre: to_base(&mark.centre),
                normal: to_base(&Point3::from(mark.normal)).coords,
                ..mark
            })
            .collect();
        let rig = HeadGeometry {
            interaxial_m: BASE_M,
            pupil_m,
        };
        let angles = HeadAngles {
            pan,
            tilt,
            left: vergence[0],
            right: vergence[1],
        };
        let pose = |eye: Eye, _: f64| rig.cam_from_base(eye, &angles);
        let pair = rendered(&mut renderer(turned.clone(), camera), &pose);
        let (most, rms, n) = errors(&pair, &turned, |p, side| {
            let p = in_head(p, pan, tilt);
            let own = vergence[usize::from(side > 0.0)];
            Some(pixel(shot_ray(&p, side, own, pupil_m)?, &camera))
        });
        println!(
            "pan {pan}, tilt {tilt}, {depth_m} m: {n} marks, largest {most:.4} px, rms {rms:.4} px"
        );
        assert!(n >= 80, "{n} marks in view");
        assert!(most < LIMIT_PX, "pan {pan}, tilt {tilt}: {most} px");
    }
}

/// A head that pans evenly during a long exposure smears marks, but evenly about the middle of the exposure.
#[test]
fn blur_is_centred_on_the_middle_of_the_exposure() {
    let camera = TwinCamera {
        motion_blur: true,
        exposure_s: 0.004,
        ..TwinCamera::ideal(TwinCamera::default().camera)
    };
    let marks = marks(3.0, &camera);
    let rig = HeadGeometry {
        interaxial_m: BASE_M,
        pupil_m: 0.0,
    };
    // 0.6 rad/s for 4 ms: 3.3 pixels.
    let at = |t: f64| HeadAngles {
        pan: 0.6 * (t - 1.0),
        ..HeadAngles::default()
    };
    let pose = |eye: Eye, t: f64| rig.cam_from_base(eye, &at(t));
    let pair = rendered(&mut renderer(marks.clone(), camera), &pose);
    let still = TwinCamera {
        motion_blur: false,
        ..camera
    };
    let sharp = rendered(&mut renderer(marks.clone(), still), &pose);
    assert!(pair[0] != sharp[0], "nothing was blurred");
    let (most, rms, n) = errors(&pair, &marks, |p, side| {
        Some(pixel(shot_ray(p, side, 0.0, 0.0)?, &camera))
    });
    println!("panning: {n} marks, largest {most:.4} px, rms {rms:.4} px");
    assert!(n > 80 && most < 0.03, "{most} px");
}
