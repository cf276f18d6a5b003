//! What a pair's pictures tell beyond its matched points: order of the eyes, light, sharpness, noise.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use vergence_imaging::{Gray, Rgb, colour};
use vergence_stereo::dense::{DenseSettings, disparity_map};
use vergence_stereo::faults::PairFaults;
use vergence_stereo::faults::noise::noise_of;
use vergence_stereo::faults::photometry::{Tone, photometry_from_map};
use vergence_stereo::faults::sharpness::sharpness_from_map;
use vergence_stereo::faults::swap::{Swap, SwapDecision, swap_from_map};

use super::record::{VerdictEntry, VerdictWord};

/// The groups of fields that come from here.
pub(super) const GROUPS: [&str; 7] = [
    "swapped",
    "swap",
    "gain",
    "photometry",
    "blur_sigma_px",
    "sharpness",
    "noise",
];

/// What was found, and why something was not.
pub(super) struct EyeMeasures {
    pub(super) groups: BTreeMap<&'static str, Value>,
    pub(super) not_judged: BTreeMap<String, String>,
    /// The verdict on the order of the eyes; `None` where it cannot be told.
    pub(super) swapped_entry: Option<VerdictEntry>,
}

/// Measure both pictures of a pair whose points were matched.
pub(super) fn measure(eyes: &[Rgb; 2], faults: &PairFaults) -> EyeMeasures {
    let mut found = EyeMeasures {
        groups: GROUPS.into_iter().map(|name| (name, Value::Null)).collect(),
        not_judged: BTreeMap::new(),
        swapped_entry: None,
    };
    let luma = eyes.each_ref().map(colour::luma_from_rgb);
    let median_px = faults.parallax.median.disparity_px;
    let vertical_px = |u: f64, v: f64| faults.alignment.model.vertical_px([u, v], median_px);
    let map = disparity_map(
        [&luma[0], &luma[1]],
        &vertical_px,
        &DenseSettings::default(),
    );
    let map = match map {
        Ok(map) => map,
        Err(why) => {
            for group in GROUPS {
                found.not_judged.insert(group.to_owned(), why.to_string());
            }
            return found;
        }
    };
    let swap = swap_from_map(&map);
    let swapped = match swap.decision {
        SwapDecision::AsGiven => Some(false),
        SwapDecision::Swapped => Some(true),
        SwapDecision::CannotTell => {
            let why = "the signs of depth in the pictures are too few or contradict each other";
            found
                .not_judged
                .insert("swapped".to_owned(), why.to_owned());
            None
        }
    };
    found.groups.insert("swapped", json!(swapped));
    found.swapped_entry = swapped.map(|swapped| swapped_entry(&swap, swapped));
    let signs = swap.signs.iter();
    let signs: Vec<Value> = signs
        .map(|s| json!({"name": s.name, "log_odds": s.log_odds, "places": s.places}))
        .collect();
    found.groups.insert(
        "swap",
        json!({"probability": swap.probability, "log_odds": swap.log_odds, "signs": signs}),
    );
    let green = eyes.each_ref().map(|eye| eye.map(|p| p[1]));
    let green: [&Gray; 2] = [&green[0], &green[1]];
    let noise = noise_of(green);
    match &noise {
        Some(n) => {
            found.groups.insert(
                "noise",
                json!({"left": n.level[0], "right": n.level[1], "difference": n.difference}),
            );
        }
        None => found.lacks(&["noise"], "no flat places to read noise from"),
    }
    let sharpness = sharpness_from_map(green, &map, &vertical_px, noise.as_ref());
    match &sharpness {
        Some(s) => {
            found.groups.insert("blur_sigma_px", json!(s.blur_sigma_px));
            found.groups.insert(
                "sharpness",
                json!({
                    "sigma_px": s.sigma_px,
                    "blurrier": s.blurrier.map(|eye| format!("{eye:?}").to_lowercase()),
                    "patches": s.patches,
                }),
            );
        }
        None => found.lacks(&["blur_sigma_px", "sharpness"], "too few places correspond"),
    }
    match photometry_from_map([&eyes[0], &eyes[1]], &map, &vertical_px, sharpness.as_ref()) {
        Some(p) => {
            found.groups.insert("gain", json!(p.luma.gain));
            found.groups.insert(
                "photometry",
                json!({
                    "luma": tone(&p.luma),
                    "red": tone(&p.channels[0]),
                    "green": tone(&p.channels[1]),
                    "blue": tone(&p.channels[2]),
                    "level_percent": p.level_percent,
                    "level_sigma_percent": p.level_sigma_percent,
                    "white_balance_percent": p.white_balance_percent,
                    "white_balance_sigma_percent": p.white_balance_sigma_percent,
                    "matrix": p.matrix,
                    "areas": p.areas,
                }),
            );
        }
        None => found.lacks(&["gain", "photometry"], "too few areas correspond"),
    }
    found
}

impl EyeMeasures {
    fn lacks(&mut self, groups: &[&str], why: &str) {
        for group in groups {
            self.not_judged.insert((*group).to_owned(), why.to_owned());
        }
    }
}

fn swapped_entry(swap: &Swap, swapped: bool) -> VerdictEntry {
    VerdictEntry {
        cause: "eyes_swapped".to_owned(),
        value: swap.probability,
        sigma: None,
        unit: "probability",
        look: 0.5,
        bad: 0.91,
        source: "odds of 10 to 1 decide",
        verdict: if swapped {
            VerdictWord::Bad
        } else {
            VerdictWord::Good
        },
        meaning: if swapped {
            "the left eye's picture was taken by the right camera: exchange the two (a file for crossed eyes wants --layout cross-eyed)"
                .to_owned()
        } else {
            "each eye sees its own picture".to_owned()
        },
    }
}

fn tone(t: &Tone) -> Value {
    json!({
        "gain": t.gain,
        "gain_sigma": t.gain_sigma,
        "offset": t.offset,
        "offset_sigma": t.offset_sigma,
        "gamma": t.gamma,
        "gamma_sigma": t.gamma_sigma,
    })
}
