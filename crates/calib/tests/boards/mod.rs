//! Rendered boards with known corners, drawn at random from a seed.

use std::ops::Range;

use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector3};
use vergence_calib::{Detection, Target};
use vergence_geometry::{BrownConrady, Camera, Intrinsics};
use vergence_imaging::{Gray, Plane};
use vergence_scene::board::{Look, Patch, Tones, develop, draw, smeared};
use vergence_scene::hash::{mix, uniform_from};

/// Draws from a seed.
pub(crate) struct Draws(u64);

impl Draws {
    pub(crate) fn new(seed: u64) -> Self {
        Self(mix(seed))
    }

    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = mix(self.0);
        uniform_from(self.0)
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub(crate) fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n - 1)
    }
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Case {
    /// The whole board, sharp, any attitude.
    Whole,
    /// Something in front of the board, or a part of it outside the picture.
    Hidden,
    /// Out of focus.
    Blurred,
    /// Contrast of 20 code values and noise.
    Dim,
    /// A barrel distortion that bends edges by tens of pixels.
    Bent,
    /// Another board than the one asked for.
    Other,
    /// No board at all.
    Clutter,
    /// Seen in a mirror.
    Mirrored,
    /// Moved during the exposure by 2 to 8 pixels, in any direction.
    Moving,
    /// Seen from the side, at 50 to 67 degrees.
    Oblique,
}

pub(crate) const CASES: [Case; 10] = [
    Case::Whole,
    Case::Hidden,
    Case::Blurred,
    Case::Dim,
    Case::Bent,
    Case::Other,
    Case::Clutter,
    Case::Mirrored,
    Case::Moving,
    Case::Oblique,
];

/// A rendered picture and the truth about it.
pub(crate) struct Shot {
    pub(crate) picture: Gray,
    /// Where every corner of the shown target is, hidden ones too; `None` where the lens shows none.
    pub(crate) truth: Vec<Option<Point2<f64>>>,
    /// How many of them lie in the picture by a margin of 8 pixels.
    pub(crate) inside: usize,
}

pub(crate) fn patches(target: &Target) -> Vec<Patch> {
    target
        .rectangles()
        .iter()
        .map(|r| Patch {
            min_m: r.min_m,
            max_m: r.max_m,
            white: r.white,
        })
        .collect()
}

pub(crate) fn camera(size: (usize, usize), focal_px: f64, k1: f64) -> Camera {
    Camera {
        intrinsics: Intrinsics {
            width: size.0,
            height: size.1,
            fx: focal_px,
            fy: focal_px,
            cx: 0.5 * size.0 as f64 - 0.3,
            cy: 0.5 * size.1 as f64 + 0.2,
        },
        distortion: BrownConrady {
            k1,
            ..BrownConrady::NONE
        }
        .into(),
    }
}

/// A pose that shows the board's middle near the picture's, with its diagonal over `share` of the picture's height.
pub(crate) fn pose(
    target: &Target,
    camera: &Camera,
    draws: &mut Draws,
    share: f64,
    tilts: Range<f64>,
    off_centre: f64,
) -> Isometry3<f64> {
    let sheet = target.rectangles()[0];
    let middle = [0, 1].map(|i| 0.5 * (sheet.min_m[i] + sheet.max_m[i]));
    let diagonal = (sheet.max_m[0] - sheet.min_m[0]).hypot(sheet.max_m[1] - sheet.min_m[1]);
    let k = &camera.intrinsics;
    let z = k.fx * diagonal / (share * k.height as f64);
    let roll = draws.between(0.0, std::f64::consts::TAU);
    let tilt = draws.between(tilts.start, tilts.end);
    let around = draws.between(0.0, std::f64::consts::TAU);
    let tilted =
        UnitQuaternion::from_scaled_axis(tilt * Vector3::new(around.cos(), around.sin(), 0.0));
    let turned = tilted * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    let mut off = |side: usize| off_centre * draws.between(-0.5, 0.5) * side as f64 * z / k.fx;
    let at = Translation3::new(off(k.width), off(k.height), z);
    at * Isometry3::from_parts(Translation3::identity(), turned)
        * Translation3::new(-middle[0], -middle[1], 0.0)
}

pub(crate) const TONES: Tones = Tones {
    black: 35.0,
    white: 205.0,
};

/// A board before an even background.
pub(crate) fn shot(
    target: &Target,
    camera: &Camera,
    cam_from_board: &Isometry3<f64>,
    look: &Look,
) -> Shot {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut light = Plane::filled(w, h, 120.0);
    draw(&mut light, &patches(target), TONES, camera, cam_from_board);
    Shot {
        picture: develop(&light, look),
        ..truth(target, camera, cam_from_board)
    }
}

fn truth(target: &Target, camera: &Camera, cam_from_board: &Isometry3<f64>) -> Shot {
    let truth: Vec<Option<Point2<f64>>> = (0..target.point_count())
        .map(|id| camera.project(&(cam_from_board * target.point_in_board(id))))
        .collect();
    let k = &camera.intrinsics;
    let well_inside = |p: &Point2<f64>| {
        p.x > 8.0 && p.y > 8.0 && p.x < k.width as f64 - 9.0 && p.y < k.height as f64 - 9.0
    };
    Shot {
        picture: Gray::filled(0, 0, 0),
        inside: truth.iter().flatten().filter(|p| well_inside(p)).count(),
        truth,
    }
}

/// Rectangles of any size in the picture plane, as a background or in front of a board.
fn clutter(light: &mut Plane<f32>, camera: &Camera, draws: &mut Draws, count: usize, size_px: f64) {
    let k = &camera.intrinsics;
    for _ in 0..count {
        let flat = Camera {
            distortion: BrownConrady::NONE.into(),
            ..*camera
        };
        let side = |d: &mut Draws| d.between(0.2, 1.0) * size_px / k.fx;
        let (w, h) = (side(draws), side(draws));
        let at = |d: &mut Draws, side: usize| d.between(-0.5, 0.5) * side as f64 / k.fx;
        let place = Isometry3::from_parts(
            Translation3::new(at(draws, k.width), at(draws, k.height), 1.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), draws.between(0.0, 3.0)),
        );
        let tone = draws.between(10.0, 240.0) as f32;
        let tones = Tones {
            black: tone,
            white: tone,
        };
        let patch = Patch {
            min_m: [-w, -h],
            max_m: [w, h],
            white: true,
        };
        draw(light, &[patch], tones, &flat, &place);
    }
}

/// Picture number `seed` of a case. `shown` is drawn; what will be asked for does not matter here.
pub(crate) fn random_shot(shown: &Target, case: Case, seed: u64) -> Shot {
    // Cases do not share their cameras and attitudes.
    let draws = &mut Draws::new(mix(seed) ^ case as u64);
    let k1 = match case {
        Case::Bent => draws.between(-0.42, -0.25),
        _ => draws.between(-0.15, 0.05),
    };
    let focal = match case {
        Case::Bent => draws.between(300.0, 380.0),
        _ => draws.between(450.0, 900.0),
    };
    let camera = camera((640, 480), focal, k1);
    let hidden = case == Case::Hidden;
    let share = match case {
        Case::Blurred => draws.between(0.9, 1.2),
        Case::Bent => draws.between(1.0, 1.5),
        Case::Oblique | Case::Moving => draws.between(0.9, 1.3),
        _ if hidden => draws.between(0.7, 1.6),
        _ => draws.between(0.6, 1.15),
    };
    let off = if hidden { 0.7 } else { 0.2 };
    let tilts = match case {
        Case::Bent => 0.0..0.5,
        Case::Oblique => 0.87..1.17,
        _ => 0.0..0.8,
    };
    let cam_from_board = pose(shown, &camera, draws, share, tilts, off);
    let mut light = Plane::filled(640, 480, draws.between(20.0, 220.0) as f32);
    let many = if case == Case::Clutter { 120 } else { 25 };
    clutter(&mut light, &camera, draws, many, 60.0);
    let tones = match case {
        Case::Dim => Tones {
            black: 22.0,
            white: 42.0,
        },
        _ => Tones {
            black: draws.between(5.0, 60.0) as f32,
            white: draws.between(140.0, 245.0) as f32,
        },
    };
    if case != Case::Clutter {
        draw(&mut light, &patches(shown), tones, &camera, &cam_from_board);
    }
    if hidden {
        let count = 1 + draws.below(3);
        clutter(&mut light, &camera, draws, count, 130.0);
    }
    if case == Case::Moving {
        let (length, angle) = (draws.between(2.0, 8.0), draws.between(0.0, 3.15));
        light = smeared(&light, [length * angle.cos(), length * angle.sin()]);
    }
    let look = Look {
        blur_px: match case {
            Case::Blurred => draws.between(1.5, 3.0),
            _ => draws.between(0.4, 1.1),
        },
        shading: [draws.between(-0.5, 0.5), draws.between(-0.5, 0.5)],
        noise: if case == Case::Dim {
            1.2
        } else {
            draws.between(0.0, 4.0)
        },
        seed,
    };
    let mut shot = Shot {
        picture: develop(&light, &look),
        ..truth(shown, &camera, &cam_from_board)
    };
    if case == Case::Mirrored {
        let upright = shot.picture.clone();
        shot.picture = Gray::from_fn(640, 480, |u, v| upright.at(639 - u, v));
        for p in shot.truth.iter_mut().flatten() {
            p.x = 639.0 - p.x;
        }
    }
    shot
}

/// Largest and root mean square distance of the corners from the truth, pixels.
pub(crate) fn errors(detection: &Detection, truth: &[Option<Point2<f64>>]) -> (f64, f64) {
    let all: Vec<f64> = detection
        .corners
        .iter()
        .map(|c| truth[c.id].map_or(f64::INFINITY, |t| (t - c.pixel).norm()))
        .collect();
    let mean = all.iter().map(|e| e * e).sum::<f64>() / all.len() as f64;
    (all.iter().fold(0.0, |a: f64, &b| a.max(b)), mean.sqrt())
}
