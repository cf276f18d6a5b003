//! What a pair's dense map tells, as groups of JSON fields: order of the eyes, light, sharpness, noise, window, ghosts, shape.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use vergence_stereo::faults::PairFaults;
use vergence_stereo::faults::appearance::Appearance;
use vergence_stereo::faults::photometry::Tone;
use vergence_stereo::faults::swap::SwapDecision;
use vergence_stereo::faults::window::{EdgeViolation, Window};

/// The groups of fields that come from here.
pub(super) const GROUPS: [&str; 10] = [
    "swapped",
    "swap",
    "gain",
    "photometry",
    "blur_sigma_px",
    "sharpness",
    "noise",
    "window_violation",
    "ghosting",
    "shape",
];

/// What was found, and why something was not.
#[derive(Default)]
pub(super) struct EyeMeasures {
    pub(super) groups: BTreeMap<&'static str, Value>,
    pub(super) not_judged: BTreeMap<String, String>,
}

/// The fields of a pair whose points were matched.
pub(super) fn fields(faults: &PairFaults) -> EyeMeasures {
    let mut found = EyeMeasures::default();
    let Some(seen) = &faults.appearance else {
        found.lacks(&GROUPS, "no dense map of the pair can be made");
        return found;
    };
    found.swap(seen);
    found.light(seen);
    found.put("window_violation", window(&seen.window));
    match &seen.ghosting {
        Some(g) => found.put(
            "ghosting",
            json!({
                "crosstalk": g.crosstalk,
                "contrast_percent": g.contrast_percent,
                "visible_percent": g.visible_percent,
            }),
        ),
        None => found.lacks(&["ghosting"], "the crosstalk is 0"),
    }
    match &seen.shape {
        Some(s) => found.put(
            "shape",
            json!({
                "roundness": s.roundness,
                "roundness_at_median": s.roundness_at_median,
                "puppet_ratio": s.puppet_ratio,
            }),
        ),
        None => found.lacks(
            &["shape"],
            "the rig is not known (--rig takes that of the settings), or its geometry does not fit the pair",
        ),
    }
    found
}

impl EyeMeasures {
    fn put(&mut self, group: &'static str, value: Value) {
        self.groups.insert(group, value);
    }

    fn lacks(&mut self, groups: &[&'static str], why: &str) {
        for group in groups {
            self.not_judged.insert((*group).to_owned(), why.to_owned());
        }
    }

    fn swap(&mut self, seen: &Appearance) {
        match seen.swap.decision {
            SwapDecision::AsGiven => self.put("swapped", json!(false)),
            SwapDecision::Swapped => self.put("swapped", json!(true)),
            SwapDecision::CannotTell => self.lacks(
                &["swapped"],
                "the signs of depth in the pictures are too few or contradict each other",
            ),
        }
        let signs = seen.swap.signs.iter();
        let signs: Vec<Value> = signs
            .map(|s| json!({"name": s.name, "log_odds": s.log_odds, "places": s.places}))
            .collect();
        self.put(
            "swap",
            json!({"probability": seen.swap.probability, "log_odds": seen.swap.log_odds, "signs": signs}),
        );
    }

    fn light(&mut self, seen: &Appearance) {
        match &seen.photometry {
            Some(p) => {
                self.put("gain", json!(p.luma.gain));
                self.put(
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
                        "shading_percent": p.shading_percent,
                        "shading_sigma_percent": p.shading_sigma_percent,
                        "areas": p.areas,
                    }),
                );
            }
            None => self.lacks(&["gain", "photometry"], "too few areas correspond"),
        }
        match &seen.sharpness {
            Some(s) => {
                self.put("blur_sigma_px", json!(s.blur_sigma_px));
                self.put(
                    "sharpness",
                    json!({
                        "sigma_px": s.sigma_px,
                        "blurrier": s.blurrier.map(|eye| format!("{eye:?}").to_lowercase()),
                        "patches": s.patches,
                    }),
                );
            }
            None => self.lacks(&["blur_sigma_px", "sharpness"], "too few places correspond"),
        }
        match &seen.noise {
            Some(n) => self.put(
                "noise",
                json!({"left": n.level[0], "right": n.level[1], "difference": n.difference}),
            ),
            None => self.lacks(&["noise"], "no place is flat enough to read noise from"),
        }
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

fn window(w: &Window) -> Value {
    let edge = |e: &EdgeViolation| json!({"share": e.share, "nearest_px": e.nearest_px, "nearest_percent": e.nearest_percent});
    json!({
        "left": edge(&w.left),
        "right": edge(&w.right),
        "top": edge(&w.top),
        "bottom": edge(&w.bottom),
        "mask_left_of_left_px": w.mask_left_of_left_px,
        "mask_right_of_right_px": w.mask_right_of_right_px,
    })
}
