//! Camera modes while running, and who chooses them.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::law::Nulling;

/// A mode that the cameras can be in while running.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RunningMode {
    /// Axes parallel, pictures as they are: the target is seen in front of the screen.
    #[default]
    Parallel,
    /// Both axes turn towards the target: zero parallax by the motors.
    Converged,
    /// Axes parallel, pictures shifted: zero parallax without keystone.
    Shifted,
}

impl RunningMode {
    /// As typed and printed.
    pub fn name(self) -> &'static str {
        match self {
            RunningMode::Parallel => "parallel",
            RunningMode::Converged => "converged",
            RunningMode::Shifted => "shifted",
        }
    }

    fn nulling(self) -> Nulling {
        let (mechanical, nulled) = match self {
            RunningMode::Parallel => (0.0, 0.0),
            RunningMode::Converged => (1.0, 1.0),
            RunningMode::Shifted => (0.0, 1.0),
        };
        Nulling { mechanical, nulled }
    }
}

impl fmt::Display for RunningMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What was asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ModeRequest {
    /// Always parallel.
    Parallel,
    /// Always converged.
    Converged,
    /// Always shifted.
    Shifted,
    /// Converged for a near target, parallel for a far one, by the planner's threshold.
    #[default]
    Auto,
}

impl ModeRequest {
    /// The mode asked for, `None` for `auto`.
    pub fn fixed(self) -> Option<RunningMode> {
        match self {
            ModeRequest::Parallel => Some(RunningMode::Parallel),
            ModeRequest::Converged => Some(RunningMode::Converged),
            ModeRequest::Shifted => Some(RunningMode::Shifted),
            ModeRequest::Auto => None,
        }
    }
}

/// The distances between which `auto` does not change. They come from the planner with the name of the rule.
///
/// The default is the seen-depth rule at 5 % of the viewing distance for the default rig: unshifted parallel pictures show the
/// target in front of the screen by 5 % or more up to 6.65 m (`M f t / (e · 0.05/0.95)`), and 7.35 m (`0.05/1.05`, seen behind) is the other edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutoThreshold {
    /// Nearer than this: converged, m.
    pub near_m: f64,
    /// Farther than this: parallel, m; > `near_m`.
    pub far_m: f64,
    /// The rule from which they come, in words.
    pub rule: String,
}

impl Default for AutoThreshold {
    fn default() -> Self {
        Self {
            near_m: 6.65,
            far_m: 7.35,
            rule: "seen depth 5 %".to_owned(),
        }
    }
}

/// When and how fast modes change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModeSettings {
    /// What was asked for.
    pub request: ModeRequest,
    /// For `auto`.
    pub threshold: AutoThreshold,
    /// Least time between two changes, s; >= 0.
    pub dwell_s: f64,
    /// How long the target must be beyond an edge before `auto` believes it, s; >= 0.
    pub confirm_s: f64,
    /// Length of a change, s; > 0. Longer where the axes would turn faster than `fade_speed_rad_s`.
    pub fade_s: f64,
    /// Fastest turn of one camera's vergence during a change, rad/s; > 0.
    pub fade_speed_rad_s: f64,
}

impl Default for ModeSettings {
    fn default() -> Self {
        Self {
            request: ModeRequest::Auto,
            threshold: AutoThreshold::default(),
            dwell_s: 2.0,
            confirm_s: 0.25,
            fade_s: 1.5,
            fade_speed_rad_s: 2.0_f64.to_radians(),
        }
    }
}

impl ModeSettings {
    /// Whether the settings make sense.
    pub fn check(&self) -> Result<(), ControlError> {
        let t = &self.threshold;
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let rules = [
            ("near_m", t.near_m, positive(t.near_m), "greater than 0"),
            (
                "far_m",
                t.far_m,
                t.far_m.is_finite() && t.far_m > t.near_m,
                "greater than near_m",
            ),
            (
                "dwell_s",
                self.dwell_s,
                self.dwell_s >= 0.0 && self.dwell_s.is_finite(),
                "0 or more",
            ),
            (
                "confirm_s",
                self.confirm_s,
                self.confirm_s >= 0.0 && self.confirm_s.is_finite(),
                "0 or more",
            ),
            (
                "fade_s",
                self.fade_s,
                positive(self.fade_s),
                "greater than 0",
            ),
            (
                "fade_speed_rad_s",
                self.fade_speed_rad_s,
                positive(self.fade_speed_rad_s),
                "greater than 0",
            ),
        ];
        match rules.into_iter().find(|(_, _, good, _)| !good) {
            None => Ok(()),
            Some((field, value, _, rule)) => Err(ControlError::Setting { field, value, rule }),
        }
    }
}

/// One change of mode, for the log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModeChange {
    /// When it began, s.
    pub time_s: f64,
    /// Mode before.
    pub from: RunningMode,
    /// Mode after.
    pub to: RunningMode,
    /// Why, in words.
    pub reason: String,
}

/// Chooses the mode and carries out the change.
///
/// What a viewer sees of a change at distance z: between `parallel` and `converged` the target glides between the screen and its place in front
/// of it (parallax `f t / z`: 14 px at 7 m with the default camera) within `fade_s`, as a minimum-jerk motion, peak speed 1.9 times the
/// mean, and the background glides with it. Between `converged` and `shifted` the target stays at zero
/// parallax and keystone grows or fades. Between `parallel` and `shifted` the pictures glide, the cameras stand still.
#[derive(Clone, Debug)]
pub struct ModeSelector {
    settings: ModeSettings,
    active: RunningMode,
    changed_s: Option<f64>,
    wish: Option<(RunningMode, f64)>,
    fade: Option<Fade>,
    nulling: Nulling,
}

#[derive(Clone, Copy, Debug)]
struct Fade {
    from: Nulling,
    start_s: f64,
    duration_s: f64,
}

/// Parts and their rates per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NullingNow {
    /// Parts now.
    pub parts: Nulling,
    /// Rate of `parts.mechanical`, 1/s.
    pub mechanical_rate: f64,
}

/// Largest slope of [`minimum_jerk`].
pub const MINIMUM_JERK_PEAK: f64 = 1.875;

/// The minimum-jerk profile from 0 to 1, `10 x³ - 15 x⁴ + 6 x⁵`, and its slope (Flash & Hogan 1985); x is clamped to 0..1.
pub fn minimum_jerk(x: f64) -> (f64, f64) {
    let x = x.clamp(0.0, 1.0);
    let part = x * x * x * (10.0 + x * (6.0 * x - 15.0));
    (part, 30.0 * (x * (1.0 - x)).powi(2))
}

impl ModeSelector {
    /// A selector in the mode asked for; `auto` begins parallel.
    pub fn new(settings: ModeSettings) -> Self {
        let active = settings.request.fixed().unwrap_or_default();
        Self {
            settings,
            active,
            changed_s: None,
            wish: None,
            fade: None,
            nulling: active.nulling(),
        }
    }

    /// The mode that is active or being changed to.
    pub fn active(&self) -> RunningMode {
        self.active
    }

    /// Ask for another mode; it comes when the dwell time allows.
    pub fn request(&mut self, request: ModeRequest) {
        self.settings.request = request;
    }

    /// Take new edges for `auto`, for example after the viewer's screen has changed.
    pub fn set_threshold(&mut self, threshold: AutoThreshold) -> Result<(), ControlError> {
        let settings = ModeSettings {
            threshold,
            ..self.settings.clone()
        };
        settings.check()?;
        self.settings = settings;
        Ok(())
    }

    /// Decide at `now_s`, given the target's distance (`None`: not known now) and the full vergence of one camera for it.
    pub fn update(
        &mut self,
        now_s: f64,
        distance_m: Option<f64>,
        vergence_rad: f64,
    ) -> Option<ModeChange> {
        let wanted = self.wanted(distance_m);
        let Some((to, reason)) = wanted.filter(|(to, _)| *to != self.active) else {
            self.wish = None;
            return None;
        };
        let since_s = match self.wish {
            Some((mode, since_s)) if mode == to => since_s,
            _ => now_s,
        };
        self.wish = Some((to, since_s));
        let confirm_s = if self.settings.request == ModeRequest::Auto {
            self.settings.confirm_s
        } else {
            0.0
        };
        let dwelt = self
            .changed_s
            .is_none_or(|t| now_s - t >= self.settings.dwell_s);
        let fading = self.fade.is_some_and(|f| now_s < f.start_s + f.duration_s);
        if now_s - since_s < confirm_s || !dwelt || fading {
            return None;
        }
        let from = self.active;
        let start = self.nulling_at(now_s).parts;
        let turn = (to.nulling().mechanical - start.mechanical).abs() * vergence_rad.abs();
        self.fade = Some(Fade {
            from: start,
            start_s: now_s,
            duration_s: self
                .settings
                .fade_s
                .max(MINIMUM_JERK_PEAK * turn / self.settings.fade_speed_rad_s),
        });
        self.nulling = to.nulling();
        self.active = to;
        self.changed_s = Some(now_s);
        self.wish = None;
        Some(ModeChange {
            time_s: now_s,
            from,
            to,
            reason,
        })
    }

    /// The parts at a time not before the last change.
    pub fn nulling_at(&self, at_s: f64) -> NullingNow {
        let Some(fade) = self.fade else {
            return NullingNow {
                parts: self.nulling,
                mechanical_rate: 0.0,
            };
        };
        let (part, slope) = minimum_jerk((at_s - fade.start_s) / fade.duration_s);
        let slope = slope / fade.duration_s;
        let way = self.nulling.mechanical - fade.from.mechanical;
        NullingNow {
            parts: Nulling {
                mechanical: fade.from.mechanical + part * way,
                nulled: fade.from.nulled + part * (self.nulling.nulled - fade.from.nulled),
            },
            mechanical_rate: slope * way,
        }
    }

    fn wanted(&self, distance_m: Option<f64>) -> Option<(RunningMode, String)> {
        if let Some(mode) = self.settings.request.fixed() {
            return Some((mode, format!("{mode} was asked for")));
        }
        let t = &self.settings.threshold;
        let z = distance_m?;
        if z < t.near_m {
            let reason = format!(
                "target at {z:.2} m, nearer than {:.2} m: converged by rule {}",
                t.near_m, t.rule
            );
            Some((RunningMode::Converged, reason))
        } else if z > t.far_m {
            let reason = format!(
                "target at {z:.2} m, farther than {:.2} m: parallel by rule {}",
                t.far_m, t.rule
            );
            Some((RunningMode::Parallel, reason))
        } else {
            // Between the edges `auto` leaves what is, unless that is a mode it would never choose.
            (self.active == RunningMode::Shifted).then(|| {
                (
                    RunningMode::Converged,
                    format!("target at {z:.2} m: auto chooses between converged and parallel"),
                )
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_S: f64 = 1.0 / 30.0;

    fn changes(
        settings: &ModeSettings,
        distance: impl Fn(f64) -> f64,
        seconds: f64,
    ) -> Vec<ModeChange> {
        let mut selector = ModeSelector::new(settings.clone());
        (0..(seconds / FRAME_S) as usize)
            .filter_map(|i| {
                let t = i as f64 * FRAME_S;
                let z = distance(t);
                selector.update(t, Some(z), 0.035 / z)
            })
            .collect()
    }

    /// A target that walks in changes the mode once, at the near edge, with the reason in words; walking out once at the far edge.
    #[test]
    fn walk_changes_once_at_the_edge() {
        let walk_in = changes(&ModeSettings::default(), |t| 10.0 - t, 9.0);
        assert_eq!(walk_in.len(), 1);
        assert_eq!(walk_in[0].to, RunningMode::Converged);
        let at = 10.0 - walk_in[0].time_s;
        assert!((6.3..6.45).contains(&at), "{at}");
        assert!(
            walk_in[0].reason.contains("nearer than 6.65 m"),
            "{}",
            walk_in[0].reason
        );
        let out = changes(&ModeSettings::default(), |t| 1.0 + t, 9.0);
        let modes: Vec<_> = out.iter().map(|c| c.to).collect();
        assert_eq!(modes, [RunningMode::Converged, RunningMode::Parallel]);
    }

    /// Noise within the band changes nothing; a target that jumps across both edges every frame, or every
    /// half second, never changes the mode twice within the dwell time.
    #[test]
    fn modes_do_not_flutter() {
        let inside = changes(
            &ModeSettings::default(),
            |t| 7.0 + 0.34 * (t * 40.0).sin(),
            20.0,
        );
        assert_eq!(inside.len(), 0);
        for hz in [0.5, 1.0, 14.0] {
            let settings = ModeSettings {
                confirm_s: 0.0,
                ..ModeSettings::default()
            };
            let wild = changes(
                &settings,
                |t| {
                    if (t * hz * 2.0) as i64 % 2 == 0 {
                        3.0
                    } else {
                        9.0
                    }
                },
                30.0,
            );
            assert!(wild.len() > 3);
            for pair in wild.windows(2) {
                assert!(pair[1].time_s - pair[0].time_s >= 2.0, "{pair:?}");
            }
        }
    }

    /// A change has no jump in the parts nor in their rate, keeps the axes below the speed limit, and its rate is its slope.
    #[test]
    fn fades_are_smooth() {
        let settings = ModeSettings {
            request: ModeRequest::Converged,
            ..ModeSettings::default()
        };
        let mut selector = ModeSelector::new(settings.clone());
        selector.request(ModeRequest::Parallel);
        let vergence = 5.0_f64.to_radians();
        assert!(selector.update(1.0, Some(0.4), vergence).is_some());
        let h = 1e-4;
        for i in 0..80_000 {
            let t = 1.0 + f64::from(i) * h;
            let (a, b) = (selector.nulling_at(t), selector.nulling_at(t + h));
            let slope = (b.parts.mechanical - a.parts.mechanical) / h;
            assert!((slope - 0.5 * (a.mechanical_rate + b.mechanical_rate)).abs() < 1e-6);
            assert!(slope.abs() * vergence <= settings.fade_speed_rad_s * (1.0 + 1e-9));
        }
        assert_eq!(selector.nulling_at(9.0).parts, Nulling::default());
    }

    /// Between converged and shifted the target stays nulled all the way.
    #[test]
    fn converged_to_shifted_keeps_zero_parallax() {
        let settings = ModeSettings {
            request: ModeRequest::Converged,
            ..ModeSettings::default()
        };
        let mut selector = ModeSelector::new(settings);
        selector.request(ModeRequest::Shifted);
        selector.update(0.0, None, 0.01);
        for i in 0..40 {
            assert_eq!(selector.nulling_at(f64::from(i) * 0.05).parts.nulled, 1.0);
        }
    }
}
