//! Proves against the twin's exact truth: planted gain, gamma, colour, blur and noise are found at their strength, alone and mixed, in rooms
//! that differ; the sensor's own noise is told apart from blur; what an edge cuts, ghosts, roundness and a jump of depth are what the
//! geometry says; and a clean pair behind the screen raises no alarm at all. Does not prove it for lenses or sensors unlike the twin's.

use crate::planted::{blurred, noisy, tinted, toned};
use crate::twin::{INTERAXIAL_M, Twin};
use rayon::prelude::*;
use std::sync::Arc;
use vergence_geometry::array::Mode;
use vergence_geometry::comfort::Viewing;
use vergence_geometry::viewing::Viewer;
use vergence_geometry::{Distortion, StereoArray};
use vergence_imaging::Rgb;
use vergence_imaging::colour::luma_from_rgb;
use vergence_scene::{FrameTruth, PathSpec, TwinCamera};
use vergence_stereo::dense::{DenseSettings, DisparityMap, disparity_map};
use vergence_stereo::faults::appearance::Appearance;
use vergence_stereo::faults::cuts::{CutFinder, DepthSummary};
use vergence_stereo::faults::{Conditions, PairFaults, Verdict, measure};

const SCREEN_M: f64 = 1.0;
const DISTANCE_M: f64 = 3.0;
const INTEROCULAR_M: f64 = 0.065;

fn viewing(width_px: usize) -> Viewing {
    Viewing {
        viewer: Viewer {
            interocular_m: INTEROCULAR_M,
            distance_m: DISTANCE_M,
        },
        screen_width_m: SCREEN_M,
        width_px,
    }
}

fn measured(pair: [&Rgb; 2]) -> PairFaults {
    measure(pair[0], pair[1], &Conditions::new(viewing(pair[0].width()))).unwrap()
}

fn seen(pair: [&Rgb; 2]) -> Appearance {
    measured(pair).appearance.unwrap()
}

/// Rooms, paths and times.
fn scenes() -> Vec<(&'static str, [Rgb; 2])> {
    [
        ("cross 4 s", PathSpec::Cross, 3, 4.0),
        ("walk 6 s", PathSpec::Walk, 11, 6.0),
        ("zigzag 5 s", PathSpec::Zigzag, 5, 5.0),
        ("two 3 s", PathSpec::Two, 8, 3.0),
    ]
    .into_iter()
    .map(|(name, path, seed, time_s)| (name, Twin::new(path, seed).pair(time_s, 0.0)))
    .collect()
}

/// What is planted into the right picture.
#[derive(Clone, Copy)]
struct Plant {
    gain: f64,
    gamma: f64,
    tint: [f64; 3],
    blur: f64,
    noise: f64,
}

const NONE: Plant = Plant {
    gain: 1.0,
    gamma: 1.0,
    tint: [1.0; 3],
    blur: 0.0,
    noise: 0.0,
};

impl Plant {
    fn into(self, right: &Rgb) -> Rgb {
        let mut out = right.clone();
        if self.blur > 0.0 {
            out = blurred(&out, self.blur);
        }
        if self.tint != [1.0; 3] {
            out = tinted(&out, self.tint);
        }
        if (self.gain, self.gamma) != (1.0, 1.0) {
            out = toned(&out, self.gain, 0.0, self.gamma);
        }
        if self.noise > 0.0 {
            out = noisy(&out, self.noise, 5);
        }
        out
    }
}

fn plants() -> Vec<(&'static str, Plant)> {
    vec![
        ("nothing", NONE),
        ("gain 0.8", Plant { gain: 0.8, ..NONE }),
        ("gain 1.15", Plant { gain: 1.15, ..NONE }),
        ("gamma 1.2", Plant { gamma: 1.2, ..NONE }),
        (
            "colour",
            Plant {
                tint: [1.08, 1.0, 0.93],
                ..NONE
            },
        ),
        ("blur 0.5", Plant { blur: 0.5, ..NONE }),
        ("blur 1", Plant { blur: 1.0, ..NONE }),
        ("blur 2", Plant { blur: 2.0, ..NONE }),
        ("blur 3", Plant { blur: 3.0, ..NONE }),
        ("noise 4", Plant { noise: 4.0, ..NONE }),
        (
            "blur 1.5, gain 0.9, noise 3",
            Plant {
                blur: 1.5,
                gain: 0.9,
                noise: 3.0,
                ..NONE
            },
        ),
        (
            "blur 0.8, colour, noise 2",
            Plant {
                blur: 0.8,
                tint: [0.95, 1.0, 1.06],
                noise: 2.0,
                ..NONE
            },
        ),
    ]
}

/// Gain to 1 %, gamma to 0.03, colour to 1 %, blur to 0.2 px, noise to 0.7 levels, against what was planted (not against the pair's own
/// difference: the twin's cameras are equal).
#[test]
fn planted_light_sharpness_and_noise() {
    let scenes = scenes();
    let own: Vec<_> = scenes
        .par_iter()
        .map(|(_, [left, right])| seen([left, right]).noise.unwrap())
        .collect();
    let cases: Vec<_> = (scenes.iter().zip(&own))
        .enumerate()
        .flat_map(|(i, (scene, own))| {
            // Every plant in one of the scenes.
            let plants = plants().into_iter().skip(i % 4).step_by(4);
            plants.map(move |plant| (scene, own, plant))
        })
        .collect();
    let all: Vec<[f64; 5]> = (cases.par_iter())
        .map(|((scene, [left, right]), own, (name, plant))| {
            let found = seen([left, &Plant::into(*plant, right)]);
            let (light, sharpness) = (found.photometry.unwrap(), found.sharpness.unwrap());
            let noise = found.noise.unwrap();
            let balance = [0, 1].map(|k| {
                let planted = plant.tint[2 * k] / plant.tint[1];
                light.white_balance_percent[k] - 100.0 * (planted - 1.0)
            });
            // A pure gamma shows as gain and offset of the line; a colour as a gain of luma.
            let tinted = plant.tint != [1.0; 3];
            let errors = [
                match plant.gamma == 1.0 && !tinted {
                    true => light.luma.gain / plant.gain - 1.0,
                    false => 0.0,
                },
                // Blur and noise bend nothing, but the mixtures are not asked for gamma.
                if plant.blur == 0.0 {
                    light.luma.gamma - plant.gamma
                } else {
                    0.0
                },
                balance[0].abs().max(balance[1].abs()),
                sharpness.blur_sigma_px - plant.blur,
                noise.level[1]
                    - (plant
                        .noise
                        .hypot(own.level[1] * f64::from(plant.blur == 0.0))),
            ];
            println!(
                "{scene:12} {name:30} gain {:.4} offset {:+.2} gamma {:.3} ± {:.3} colour {:+.1} {:+.1} % blur {:+.2} ± {:.2} noise {:.2} {:.2}",
                light.luma.gain,
                light.luma.offset,
                light.luma.gamma,
                light.luma.gamma_sigma,
                light.white_balance_percent[0],
                light.white_balance_percent[1],
                sharpness.blur_sigma_px,
                sharpness.sigma_px,
                noise.level[0],
                noise.level[1],
            );
            assert!(
                errors.iter().all(|e| e.is_finite()),
                "{scene} {name}: {errors:?}"
            );
            errors
        })
        .collect();
    assert_eq!(all.len(), plants().len());
    let mut worst = [0.0f64; 5];
    for errors in &all {
        for (w, e) in worst.iter_mut().zip(errors) {
            *w = w.max(e.abs());
        }
    }
    println!(
        "worst: gain {:.4}, gamma {:.3}, colour {:.2} %, blur {:.2} px, noise {:.2}",
        worst[0], worst[1], worst[2], worst[3], worst[4]
    );
    let goals = [0.01, 0.03, 1.0, 0.2, 0.7];
    for (w, goal) in worst.iter().zip(goals) {
        assert!(*w <= goal, "{worst:?} beyond {goals:?}");
    }
}

/// A right camera with a sixth of the light and six times the gain: as bright, as sharp, but noisier, by what two pictures of the still
/// room differ by.
#[test]
fn sensor_noise_is_no_blur() {
    let quiet = TwinCamera::default().scaled(0.5);
    let loud = TwinCamera {
        exposure_s: quiet.exposure_s / 6.0,
        gain: 6.0,
        ..quiet
    };
    let mut twin = Twin::with_cameras(PathSpec::Empty, 4, [quiet, loud]);
    let [left, right] = twin.pair(1.0, 0.0);
    let [left_again, right_again] = twin.pair(2.0, 0.0);
    let found = seen([&left, &right]);
    let noise = found.noise.unwrap();
    for (eye, (a, b)) in [(&left, &left_again), (&right, &right_again)]
        .into_iter()
        .enumerate()
    {
        let [low, high] = noise_range(a, b);
        println!(
            "eye {eye}: {:.2}, true {low:.2} to {high:.2}",
            noise.level[eye]
        );
        assert!((low..=high).contains(&noise.level[eye]), "{noise:?}");
    }
    let sharpness = found.sharpness.unwrap();
    let light = found.photometry.unwrap();
    println!("{sharpness:?} gain {:.4}", light.luma.gain);
    assert!(sharpness.blur_sigma_px.abs() < 0.35, "{sharpness:?}");
    assert_eq!(sharpness.blurrier, None);
    assert!((light.luma.gain - 1.0).abs() < 0.01, "{:?}", light.luma);
}

/// First and ninth decile, over blocks of the still room, of the green noise, levels.
fn noise_range(a: &Rgb, b: &Rgb) -> [f64; 2] {
    const SIDE: usize = 16;
    let mut levels = Vec::new();
    for y in (0..a.height() - SIDE).step_by(SIDE) {
        for x in (0..a.width() - SIDE).step_by(SIDE) {
            let mut squares = 0.0;
            for j in 0..SIDE {
                for i in 0..SIDE {
                    let d = f64::from(a.at(x + i, y + j)[1]) - f64::from(b.at(x + i, y + j)[1]);
                    squares += d * d;
                }
            }
            levels.push((squares / (2 * SIDE * SIDE) as f64).sqrt());
        }
    }
    levels.sort_unstable_by(f64::total_cmp);
    [levels[levels.len() / 10], levels[levels.len() * 9 / 10]]
}

/// The twin with pinhole cameras (no distortion), its head turned to the right by `pan`, rad.
fn pinholes(path: PathSpec, seed: u64, pan: f64) -> Twin {
    let mut camera = TwinCamera::default().scaled(0.5);
    camera.camera.distortion = Distortion::NONE;
    let mut twin = Twin::with_cameras(path, seed, [camera; 2]);
    twin.pan = pan;
    twin
}

/// A pair of pinhole cameras with its truth, from which [`Shifted`] ones are cut.
struct Taken {
    eyes: [Rgb; 2],
    truth: Arc<FrameTruth>,
}

impl Taken {
    fn by(twin: &mut Twin, time_s: f64) -> Self {
        Self {
            eyes: twin.pair(time_s, 0.0),
            truth: Arc::new(twin.truth(time_s)),
        }
    }

    fn shifted(&self, shift_px: usize) -> Shifted {
        let [left, right] = &self.eyes;
        let width = left.width() - shift_px;
        Shifted {
            left: Rgb::from_fn(width, left.height(), |x, y| left.at(x + shift_px, y)),
            right: Rgb::from_fn(width, right.height(), |x, y| right.at(x, y)),
            shift_px,
            truth: Arc::clone(&self.truth),
        }
    }
}

/// A pair of pinhole cameras whose screen plane lies at `shift_px` of disparity, with its truth.
struct Shifted {
    left: Rgb,
    right: Rgb,
    shift_px: usize,
    truth: Arc<FrameTruth>,
}

impl Shifted {
    fn new(path: PathSpec, seed: u64, time_s: f64, shift_px: usize) -> Self {
        Taken::by(&mut pinholes(path, seed, 0.0), time_s).shifted(shift_px)
    }

    fn pair(&self) -> [&Rgb; 2] {
        [&self.left, &self.right]
    }

    /// True disparity of a left pixel of the shifted pair, and whether both eyes see it.
    fn disparity(&self, x: usize, y: usize) -> (f64, bool) {
        let d = f64::from(self.truth.disparity_px.at(x + self.shift_px, y)[0]);
        let other = x as f64 + self.shift_px as f64 - d;
        let seen = self.truth.seen_by_right.at(x + self.shift_px, y);
        (
            d - self.shift_px as f64,
            seen && other < self.left.width() as f64 - 0.5,
        )
    }

    /// Quantile of the disparities that both eyes see.
    fn quantile(&self, q: f64) -> f64 {
        let (w, h) = self.left.size();
        let places = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
        let mut seen: Vec<f64> = places
            .map(|(x, y)| self.disparity(x, y))
            .filter(|d| d.1)
            .map(|d| d.0)
            .collect();
        seen.sort_unstable_by(f64::total_cmp);
        seen[((seen.len() - 1) as f64 * q).round() as usize]
    }

    fn map(&self) -> DisparityMap {
        let grey = self.pair().map(luma_from_rgb);
        disparity_map([&grey[0], &grey[1]], &|_, _| 0.0, &DenseSettings::default()).unwrap()
    }

    /// The rig that took it, with the screen plane where the shift puts it: distance f t / shift.
    fn rig(&self) -> StereoArray {
        let rig = StereoArray::default();
        assert!((rig.interaxial_m - INTERAXIAL_M).abs() < 1e-12);
        StereoArray {
            mode: Mode::Shifted {
                distance_m: self.focal_px() * INTERAXIAL_M / self.shift_px as f64,
            },
            ..rig
        }
    }

    fn focal_px(&self) -> f64 {
        0.0065 / 0.0048 * (self.left.width() + self.shift_px) as f64
    }
}

/// With the whole room behind the screen a clean pair raises no alarm of any kind.
#[test]
fn clean_pairs_raise_no_alarm() {
    for (path, seed, time_s) in [
        (PathSpec::Cross, 3, 4.0),
        (PathSpec::Walk, 11, 4.0),
        (PathSpec::Zigzag, 5, 3.0),
        (PathSpec::Empty, 2, 1.0),
    ] {
        let name = path.name();
        let taken = Taken::by(&mut pinholes(path, seed, 0.0), time_s);
        // What is nearest touches the screen.
        let near = taken.shifted(1).quantile(1.0).ceil() as usize + 1;
        let clean = taken.shifted(near);
        for finding in &measured(clean.pair()).findings {
            println!(
                "{name} {:?} {:.3} {:?}",
                finding.cause, finding.value, finding.verdict
            );
            assert_eq!(finding.verdict, Verdict::Good, "{name}: {finding:?}");
        }
    }
}

/// The person is in front of the screen and cut by the left edge of the right picture: the edge's disparity is the geometry's.
#[test]
fn a_person_cut_by_the_edge() {
    let mut checked = 0;
    let mut twin = pinholes(PathSpec::Cross, 3, 0.0);
    for step in 0..12 {
        let time_s = 4.0 + 0.25 * f64::from(step);
        let taken = Taken::by(&mut twin, time_s);
        // Half way between the person and the room behind.
        let whole = taken.shifted(1);
        let [room, person] = [0.5, 0.995].map(|q| whole.quantile(q) + 1.0);
        let pair = taken.shifted((0.5 * (room + person)) as usize);
        // The right picture is cut again so that its left edge runs through the person's middle.
        let body: Vec<usize> = (0..pair.left.width())
            .filter(|&x| {
                let (w, h) = (pair.left.width(), pair.left.height());
                x < w
                    && (0..h)
                        .filter(|&y| pair.disparity(x, y).0 > 0.5 * (person - room) * 0.6)
                        .count()
                        > h / 4
            })
            .collect();
        let (Some(first), Some(last)) = (body.first(), body.last()) else {
            continue;
        };
        let middle = (first + last) / 2;
        let front = pair.disparity(middle, pair.left.height() / 2).0;
        let cut = (middle as f64 - front).round().max(0.0) as usize;
        if cut + 250 > pair.left.width() {
            continue;
        }
        let crop =
            |eye: &Rgb| Rgb::from_fn(eye.width() - cut, eye.height(), |x, y| eye.at(x + cut, y));
        let (left, right) = (crop(&pair.left), crop(&pair.right));
        let window = seen([&left, &right]).window;
        // Truth: what lies at the right picture's first columns.
        let strip = (0.02 * left.width() as f64).ceil() as usize;
        let mut rows = Vec::new();
        for y in 0..left.height() {
            let mut there: Vec<f64> = (0..left.width())
                .map(|x| (x, pair.disparity(x + cut, y)))
                .filter(|(x, d)| d.1 && (0.0..strip as f64).contains(&(*x as f64 - d.0)))
                .map(|(_, d)| d.0)
                .collect();
            there.sort_unstable_by(f64::total_cmp);
            rows.extend(there.get(there.len() / 2).copied().filter(|d| *d > 1.0));
        }
        rows.sort_unstable_by(f64::total_cmp);
        let share = rows.len() as f64 / left.height() as f64;
        if share < 0.1 {
            continue;
        }
        let nearest = rows[((rows.len() - 1) as f64 * 0.95).round() as usize];
        println!(
            "{time_s} s: nearest {:.2} px (true {nearest:.2}), share {:.3} (true {share:.3}), mask {:.2} px",
            window.left.nearest_px, window.left.share, window.mask_left_of_left_px
        );
        assert!((window.left.nearest_px - nearest).abs() < 0.5, "{window:?}");
        assert!((window.left.share - share).abs() < 0.06, "{window:?}");
        assert!(
            (window.mask_left_of_left_px - nearest).abs() < 0.5,
            "{window:?}"
        );
        checked += 1;
    }
    assert!(checked >= 4, "only {checked}");
}

/// Ghosts by their formula over the whole pair with the true disparities.
#[test]
fn ghosts_by_the_formula() {
    let pair = Shifted::new(PathSpec::Walk, 11, 4.0, 14);
    let mut conditions = Conditions::new(viewing(pair.left.width()));
    conditions.crosstalk = 0.04;
    let found = measure(&pair.left, &pair.right, &conditions).unwrap();
    let found = found.appearance.unwrap().ghosting.unwrap();
    let [left, right] = pair.pair().map(luma_from_rgb);
    let linear = |v: u8| {
        let v = f64::from(v) / 255.0;
        if v <= 0.04045 {
            v / 12.92
        } else {
            ((v + 0.055) / 1.055).powf(2.4)
        }
    };
    // One arc minute at this distance, px.
    let resolved = DISTANCE_M * (1.0f64 / 60.0).to_radians().tan() / SCREEN_M * left.width() as f64;
    let mut ghosts = Vec::new();
    for y in 0..left.height() {
        for x in 0..left.width() {
            let (d, both) = pair.disparity(x, y);
            let difference = (linear(left.at(x, y)) - linear(right.at(x, y))).abs();
            ghosts.push(if both && d.abs() < resolved {
                0.0
            } else {
                4.0 * difference
            });
        }
    }
    let visible = 100.0 * ghosts.iter().filter(|g| **g > 1.0).count() as f64 / ghosts.len() as f64;
    ghosts.sort_unstable_by(f64::total_cmp);
    let high = ghosts[((ghosts.len() - 1) as f64 * 0.95).round() as usize];
    println!("{found:?}; by truth {high:.4} % and {visible:.2} %");
    assert!((found.contrast_percent - high).abs() < 0.03 * high);
    assert!((found.visible_percent - visible).abs() < 0.03 * visible + 0.2);
}

/// Roundness and the puppet ratio from the rig's exact numbers, `V t / (z (e - p))`: of the map's disparities to 1 % (its rows are put right first), of the true ones to
/// 5 % (a quarter of a pixel in the median) and to 20 % (the puppet ratio goes by the farthest and nearest percent).
#[test]
fn roundness_by_the_rig() {
    for (path, seed, time_s, shift) in [
        (PathSpec::Walk, 11, 4.0, 14),
        (PathSpec::Cross, 3, 4.0, 18),
        (PathSpec::Zigzag, 5, 3.0, 10),
    ] {
        let pair = Shifted::new(path, seed, time_s, shift);
        let width = pair.left.width();
        let mut conditions = Conditions::new(viewing(width));
        conditions.rig = Some(pair.rig());
        conditions.sensor_width_m = Some(0.0048 * width as f64 / (width + shift) as f64);
        let found = measure(&pair.left, &pair.right, &conditions).unwrap();
        let shape = found.appearance.unwrap().shape.unwrap();
        let pixel_m = SCREEN_M / width as f64;
        // By the formula, from three disparities: farthest, middle, nearest.
        let by = |[far, middle, near]: [f64; 3]| {
            let depth = |d: f64| pair.focal_px() * INTERAXIAL_M / (d + shift as f64);
            let room = |d: f64| INTEROCULAR_M + d * pixel_m;
            // Seen size over real size goes with (f / z) and with the seen distance, V e / (e - p).
            let size = |d: f64| 1.0 / (depth(d) * room(d));
            let median = DISTANCE_M * INTERAXIAL_M / (depth(middle) * room(middle));
            [median, size(near) / size(far)]
        };
        let quantiles = [0.01, 0.5, 0.99];
        let mapped = pair.map().quantiles_px(quantiles).unwrap();
        let truth = quantiles.map(|q| pair.quantile(q));
        let found = [
            shape.roundness_at_median.unwrap(),
            shape.puppet_ratio.unwrap(),
        ];
        println!(
            "{found:.4?}, by the map's disparities {:.4?}, by the true ones {:.4?}; map {mapped:.2?}, true {truth:.2?} px",
            by(mapped),
            by(truth)
        );
        for ((found, mapped), (truth, share)) in found
            .iter()
            .zip(by(mapped))
            .zip(by(truth).into_iter().zip([0.05, 0.2]))
        {
            assert!((found / mapped - 1.0).abs() < 0.01, "{shape:?}");
            assert!((found / truth - 1.0).abs() < share, "{shape:?}");
        }
        let there = pair.rig();
        let Mode::Shifted { distance_m } = there.mode else {
            unreachable!()
        };
        let converged = DISTANCE_M / distance_m * INTERAXIAL_M / INTEROCULAR_M;
        assert!((shape.roundness - converged).abs() < 1e-9);
    }
}

/// A cut from one shot of a room to another: the jump is that of the true median disparities.
#[test]
fn a_cut_between_two_shots() {
    let view = viewing(512 - 8);
    let three = |twin: &mut Twin, from_s: f64| {
        [0.0, 0.04, 0.08].map(|t| Taken::by(twin, from_s + t).shifted(8))
    };
    let seen = |shots: &[Shifted; 3]| {
        let depth = |shot: &Shifted| DepthSummary::from_map(&shot.map());
        shots
            .each_ref()
            .map(|shot| (luma_from_rgb(&shot.left), depth(shot)))
    };
    let before = three(&mut pinholes(PathSpec::Cross, 3, 0.0), 4.0);
    let seen_before = seen(&before);
    for (path, seed, time_s, pan_deg) in [
        (PathSpec::Walk, 11, 8.6, -30.0f64),
        (PathSpec::Zigzag, 5, 6.0, 25.0),
        (PathSpec::Walk, 7, 9.0, 30.0),
    ] {
        let mut panned = pinholes(path.clone(), seed, pan_deg.to_radians());
        let after = three(&mut panned, time_s);
        let mut finder = CutFinder::new();
        let mut cuts = Vec::new();
        for (grey, depth) in seen_before.iter().chain(&seen(&after)) {
            cuts.extend(finder.push(grey, *depth, &view));
        }
        let [old, new] = [&before[2], &after[0]].map(|s| s.quantile(0.5));
        let jump = 100.0 * (new - old) / 504.0;
        println!("{cuts:?}; true jump {jump:.3} %");
        assert_eq!(cuts.len(), 1, "{} {pan_deg}", path.name());
        let cut = cuts[0].unwrap();
        assert_eq!(cut.pair, 3);
        assert!((cut.jump_percent - jump).abs() < 0.15);
        let angle = |d: f64| {
            let p = -d / 504.0 * SCREEN_M;
            // Vergence at the point minus at the screen, on the axis.
            let seen = 2.0 * ((INTEROCULAR_M - p) / 2.0 / DISTANCE_M).atan();
            let screen = 2.0 * (INTEROCULAR_M / 2.0 / DISTANCE_M).atan();
            (seen - screen).to_degrees() * 60.0
        };
        let arcmin = angle(new) - angle(old);
        assert!((cut.jump_arcmin - arcmin).abs() < 2.0, "{cut:?} {arcmin}");
    }
}
