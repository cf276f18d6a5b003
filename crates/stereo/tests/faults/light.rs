//! Proves that planted differences of light, sharpness and noise between the eyes are found at their strength, alone and mixed, on recorded
//! pairs (against the pair's own difference, which is printed), and that clean made pairs raise no alarm. Goals: gain 1 %, blur 0.2 px.
//! The ignored test prints the whole table.

use crate::asked::{at_a_desk, from_two_metres};
use crate::geometry_real;
use crate::leaves;
use crate::planted::{blurred, noisy, tinted, toned};
use crate::recorded;
use crate::twin;
use vergence_imaging::Rgb;
use vergence_imaging::colour::luma_from_rgb;
use vergence_stereo::dense::{DenseSettings, disparity_map};
use vergence_stereo::faults::noise::noise_of;
use vergence_stereo::faults::photometry::{Photometry, photometry_from_map};
use vergence_stereo::faults::sharpness::{Sharpness, sharpness_from_map};
use vergence_stereo::faults::{Cause, Conditions, PairFaults, Verdict, matching, measure};

struct Found {
    light: Photometry,
    sharpness: Sharpness,
    noise: [f64; 2],
}

/// `None` where too little corresponds to tell.
fn found(pair: [&Rgb; 2]) -> Option<Found> {
    let grey = pair.map(luma_from_rgb);
    // Rows by the median of the matches: enough for areas and patches.
    let rows = matching::matched(&grey[0], &grey[1]).map_or(0.0, |m| {
        m.percentile(m.points.iter().map(|p| p.left_px.y - p.right_px.y), 0.5)
    });
    let vertical = move |_: f64, _: f64| rows;
    let map = disparity_map([&grey[0], &grey[1]], &vertical, &DenseSettings::default()).unwrap();
    let green = pair.map(|eye| eye.map(|px| px[1]));
    let planes = [&green[0], &green[1]];
    let noise = noise_of(planes);
    let sharpness = sharpness_from_map(planes, &map, &vertical, noise.as_ref())?;
    Some(Found {
        light: photometry_from_map(pair, &map, &vertical, Some(&sharpness))?,
        sharpness,
        noise: noise.map_or([f64::NAN; 2], |n| n.level),
    })
}

/// What is planted into the right eye, and into the left.
#[derive(Clone, Copy, Default)]
struct Plant {
    gain: f64,
    offset: f64,
    blur: [f64; 2],
    noise: [f64; 2],
}

impl Plant {
    fn planted_into(self, pair: [&Rgb; 2]) -> [Rgb; 2] {
        let one = |eye: usize| {
            let mut picture = pair[eye].clone();
            if self.blur[eye] > 0.0 {
                picture = blurred(&picture, self.blur[eye]);
            }
            if eye == 1 && self.gain > 0.0 {
                picture = toned(&picture, self.gain, self.offset, 1.0);
            }
            match self.noise[eye] > 0.0 {
                true => noisy(&picture, self.noise[eye], 7 + eye as u64),
                false => picture,
            }
        };
        [one(0), one(1)]
    }

    /// Blur of the right eye against the left, px, signed squares added to the pair's own.
    fn blur_with(&self, own: f64) -> f64 {
        let square = |s: f64| s * s.abs();
        let s = square(self.blur[1]) - square(self.blur[0]) + square(own);
        s.signum() * s.abs().sqrt()
    }
}

fn plants() -> Vec<(&'static str, Plant)> {
    let none = Plant {
        gain: 1.0,
        ..Plant::default()
    };
    let right = |blur| Plant {
        blur: [0.0, blur],
        ..none
    };
    vec![
        ("gain 1.06", Plant { gain: 1.06, ..none }),
        (
            "gain 0.9, offset 8",
            Plant {
                gain: 0.9,
                offset: 8.0,
                ..none
            },
        ),
        ("blur 0.5", right(0.5)),
        ("blur 1", right(1.0)),
        ("blur 2", right(2.0)),
        ("blur 3", right(3.0)),
        (
            "noise 4",
            Plant {
                noise: [0.0, 4.0],
                ..none
            },
        ),
        (
            "blur 1.5, gain 0.92, offset 5, noise 3",
            Plant {
                gain: 0.92,
                offset: 5.0,
                blur: [0.0, 1.5],
                noise: [0.0, 3.0],
            },
        ),
        (
            "left blur 1, right noise 3",
            Plant {
                blur: [1.0, 0.0],
                noise: [0.0, 3.0],
                ..none
            },
        ),
        (
            "left noise 4, right blur 1",
            Plant {
                blur: [0.0, 1.0],
                noise: [4.0, 0.0],
                ..none
            },
        ),
    ]
}

/// Values times `1 + by . place`, from -1 to 1 across the picture and down, all darkened so that nothing is clipped.
fn shaded(picture: &Rgb, by: [f64; 2]) -> Rgb {
    let (w, h) = picture.size();
    let place = |at: usize, side: usize| 2.0 * at as f64 / (side - 1) as f64 - 1.0;
    Rgb::from_fn(w, h, |x, y| {
        let factor =
            (1.0 + by[0] * place(x, w) + by[1] * place(y, h)) / (1.0 + by[0].abs() + by[1].abs());
        let shade = |v: u8| (f64::from(v) * factor).round().clamp(0.0, 255.0) as u8;
        picture.at(x, y).map(shade)
    })
}

/// Light through everything that [`measure`] does.
fn light(left: &Rgb, right: &Rgb) -> Photometry {
    let faults = measure(left, right, &at_a_desk(left.width())).unwrap();
    faults.appearance.unwrap().photometry.unwrap()
}

/// Shading planted into the right eye comes back through `measure` with its sign along rows and down columns, on made pairs and on recorded
/// ones (against the pair's own), and its standard deviation is of the error's size. The curve of tone is not the pictures' own one, which is
/// worth some tenths of a percent that no spread over the cells tells.
#[test]
fn shading_is_measured() {
    let mut pairs: Vec<(String, Rgb, Rgb, Photometry)> = (1..4)
        .map(|seed| {
            let [left, right] = leaves::Leaves::new(seed).pair((480, 360));
            let own = light(&left, &right);
            (format!("leaves {seed}"), left, right, own)
        })
        .collect();
    if let Some(data) = recorded::data_folder("shading_is_measured") {
        let recorded = geometry_real::as_given(&data).iter();
        pairs.extend(recorded.filter(|g| g.is_rectified).map(|given| {
            let pair = &given.pair;
            let seen = given.faults.appearance.as_ref().unwrap();
            let own = seen.photometry.clone().unwrap();
            (
                pair.name.clone(),
                pair.left.clone(),
                pair.right.clone(),
                own,
            )
        }));
    }
    for (k, (name, left, right, own)) in pairs.into_iter().enumerate() {
        // Both into made pairs, one or the other into recorded ones, which are larger.
        let plants = [[0.10, -0.06], [-0.04, 0.12]];
        let plants = match name.starts_with("leaves") {
            true => &plants[..],
            false => &plants[k % 2..=k % 2],
        };
        for &by in plants {
            let got = light(&left, &shaded(&right, by));
            for i in 0..2 {
                let error = got.shading_percent[i] - own.shading_percent[i] - 100.0 * by[i];
                let sigma = got.shading_sigma_percent[i].hypot(own.shading_sigma_percent[i]);
                println!("{name} {by:?} {i}: {error:.2} % ± {sigma:.2}");
                let most = if name.starts_with("leaves") { 0.4 } else { 1.2 };
                assert!(error.abs() < most, "{name}: {got:?}");
                assert!(error.abs() < 4.0 * sigma.hypot(0.3), "{name}: {got:?}");
                assert!(sigma < 4.0, "{name}: {got:?}");
            }
        }
    }
}

/// Errors of gain (share) and blur (px) of one plant, printed.
fn errors(name: &str, pair: [&Rgb; 2], own: &Found, (what, plant): &(&str, Plant)) -> [f64; 2] {
    let eyes = plant.planted_into(pair);
    let Some(got) = found([&eyes[0], &eyes[1]]) else {
        println!("{name:18} {what:38} cannot be told");
        return [f64::NAN; 2];
    };
    let gain = got.light.luma.gain / (own.light.luma.gain * plant.gain) - 1.0;
    let own_blur = match own.sharpness.blurrier {
        Some(_) => own.sharpness.blur_sigma_px,
        None => 0.0,
    };
    let blur = got.sharpness.blur_sigma_px - plant.blur_with(own_blur);
    println!(
        "{name:18} {what:38} gain {:+.2} %, offset {:+.1}, gamma {:.2}; blur {:+.2} px (error {blur:+.2} ± {:.2}); noise {:.1} {:.1}",
        100.0 * gain,
        got.light.luma.offset,
        got.light.luma.gamma,
        got.sharpness.blur_sigma_px,
        got.sharpness.sigma_px,
        got.noise[0],
        got.noise[1],
    );
    [gain, blur]
}

fn table(pairs: &[recorded::RealPair], only: &[&str]) -> Vec<(String, [f64; 2])> {
    let mut all = Vec::new();
    for pair in pairs {
        let own = found(pair.pair()).unwrap();
        println!(
            "{:18} as given: gain {:.4}, level {:+.2} %, gamma {:.2}, colour {:+.1} {:+.1} %, blur {:+.2} ± {:.2} px, noise {:.1} {:.1}",
            pair.name,
            own.light.luma.gain,
            own.light.level_percent,
            own.light.luma.gamma,
            own.light.white_balance_percent[0],
            own.light.white_balance_percent[1],
            own.sharpness.blur_sigma_px,
            own.sharpness.sigma_px,
            own.noise[0],
            own.noise[1],
        );
        for plant in plants()
            .iter()
            .filter(|p| only.is_empty() || only.contains(&p.0))
        {
            let error = errors(&pair.name, pair.pair(), &own, plant);
            all.push((format!("{} {}", pair.name, plant.0), error));
        }
    }
    all
}

/// Two recorded pairs, alone and mixed, within the goals.
#[test]
fn planted_into_recorded_pairs() {
    let Some(data) = recorded::data_folder("planted_into_recorded_pairs") else {
        return;
    };
    let mut pairs = recorded::disparity_pairs(&data);
    pairs.retain(|p| ["cones", "motorcycle"].contains(&p.name.as_str()));
    let only = [
        "gain 0.9, offset 8",
        "blur 2",
        "blur 1.5, gain 0.92, offset 5, noise 3",
        "left blur 1, right noise 3",
    ];
    for (name, [gain, blur]) in table(&pairs, &only) {
        assert!(gain.abs() < 0.01, "{name}: gain {gain}");
        assert!(blur.abs() < 0.2, "{name}: blur {blur}");
    }
}

/// The whole table over all recorded pairs but the 12-megapixel one; only printed.
#[test]
#[ignore = "prints for a minute; run by hand"]
fn table_over_all_recorded_pairs() {
    let Some(data) = recorded::data_folder("table_over_all_recorded_pairs") else {
        return;
    };
    let mut pairs = recorded::disparity_pairs(&data);
    pairs.extend(recorded::photographs(&data));
    pairs.retain(|p| p.left.width() < 3000);
    let all = table(&pairs, &[]);
    for (k, what, goal) in [(0, "gain", 0.01), (1, "blur", 0.2)] {
        let within = all.iter().filter(|(_, e)| e[k].abs() <= goal).count();
        println!("{what}: {within} of {} within {goal}", all.len());
    }
}

/// A pair of the twin raises no alarm of light, colour, sharpness, noise or order; each planted fault raises its own.
#[test]
fn verdicts_on_the_twin() {
    let [left, right] = twin::pair(4.0, 0.0);
    let causes = [
        Cause::EyesSwapped,
        Cause::Exposure,
        Cause::Gamma,
        Cause::Colour,
        Cause::Sharpness,
        Cause::Noise,
    ];
    let conditions = Conditions::new(from_two_metres(left.width()));
    let all = |right: &Rgb| measure(&left, right, &conditions).unwrap();
    let of = |faults: PairFaults, cause: Cause| {
        let finding = faults.findings.into_iter().find(|f| f.cause == cause);
        let finding = finding.unwrap();
        println!(
            "{cause:?} {:.3} {:?}: {}",
            finding.value, finding.sigma, finding.meaning
        );
        finding.verdict
    };
    let clean = all(&right);
    for cause in causes {
        assert_eq!(of(clean.clone(), cause), Verdict::Good, "{cause:?}");
    }
    let verdict = |right: &Rgb, cause: Cause| of(all(right), cause);
    assert!(verdict(&toned(&right, 1.25, 0.0, 1.0), Cause::Exposure) >= Verdict::Look);
    assert!(verdict(&tinted(&right, [1.12, 1.0, 0.88]), Cause::Colour) >= Verdict::Look);
    assert!(verdict(&blurred(&right, 2.0), Cause::Sharpness) >= Verdict::Look);
    assert!(verdict(&noisy(&right, 8.0, 3), Cause::Noise) >= Verdict::Look);
}
