//! Where the target is, how fast it goes, and how well that is known: an interacting multiple model filter.
//!
//! The state (position, velocity, acceleration in the base frame) is estimated under three [`MotionModel`]s at
//! once, standing, walking, manoeuvring (start, stop, turn), whose probabilities follow the measurements (Blom &
//! Bar-Shalom 1988). Measurements come in the head's disparity space, in which their noise hardly depends on the
//! distance (range noise grows as z²), or as points of the base frame; each with the time of its exposure.
//!
//! ```text
//!   observe(first) ──▶ started ──▶ observe: accepted ◀──▶ rejected (outside the gate)
//!                         ▲                                   │ several in a row that agree with one another
//!                         └───────────── restarted ◀──────────┘
//! ```
//!
//! [`TargetFilter::predict`] answers for any later time without changing the filter; the uncertainty grows the
//! longer nothing was seen.

mod bank;
pub mod consistency;
mod models;
mod observation;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, SVector, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use bank::{Bank, Belief, Surprise};
use consistency::{chi_square_quantile, normalized_square};
pub use models::{MODELS, Motion, MotionModel};
pub use observation::{Observation, Sight};

use models::{State, StateCovariance};

/// What the filter believes of people before it sees one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FilterSettings {
    /// Standing, walking, manoeuvre: the order of [`Motion::ALL`].
    pub models: [MotionModel; MODELS],
    /// How often per second one model (row) gives way to another (column); the diagonal is ignored.
    pub switching_per_s: [[f64; MODELS]; MODELS],
    /// Probabilities of the models at the first sight; they sum to 1.
    pub first_probabilities: [f64; MODELS],
    /// Standard deviation of the unknown level speed at the first sight, m/s per axis.
    pub first_level_speed_m_s: f64,
    /// Standard deviation of the unknown vertical speed at the first sight, m/s.
    pub first_vertical_speed_m_s: f64,
    /// A true measurement passes the gate with this probability, 0.9..0.99999.
    pub gate_probability: f64,
    /// After so many rejected measurements in a row that agree with one another the filter starts again from them.
    pub restart_after: usize,
    /// The target is never nearer than this along the base's z, m; `None` when the base frame says nothing about
    /// where targets can be (a room's own frame).
    pub nearest_z_m: Option<f64>,
    /// A first sight must be nearer than this, m: beyond it an inverse depth gives no usable distance.
    pub farthest_start_m: f64,
    /// A gap longer than this, s, is not bridged: prediction beyond it is refused and the next sight starts anew.
    pub longest_gap_s: f64,
}

impl Default for FilterSettings {
    /// A walking person (1 m/s, steps at about 2 Hz, head and torso bob 2 to 3 cm), seen 30 times a second.
    fn default() -> Self {
        Self {
            models: [
                MotionModel {
                    velocity_decay_per_s: 7.5,
                    acceleration_time_s: 0.05,
                    level_sigma_m_s2: 0.75,
                    vertical_sigma_m_s2: 1.2,
                },
                MotionModel {
                    velocity_decay_per_s: 0.0,
                    acceleration_time_s: 0.04,
                    level_sigma_m_s2: 0.405,
                    vertical_sigma_m_s2: 1.22,
                },
                MotionModel {
                    velocity_decay_per_s: 0.0,
                    acceleration_time_s: 0.55,
                    level_sigma_m_s2: 6.5,
                    vertical_sigma_m_s2: 3.5,
                },
            ],
            switching_per_s: [[0.0, 0.3, 3.2], [0.35, 0.0, 0.3], [0.05, 1.5, 0.0]],
            first_probabilities: [0.2, 0.6, 0.2],
            first_level_speed_m_s: 0.5,
            first_vertical_speed_m_s: 0.5,
            gate_probability: 0.999,
            restart_after: 5,
            nearest_z_m: Some(0.2),
            farthest_start_m: 50.0,
            longest_gap_s: 30.0,
        }
    }
}

impl FilterSettings {
    /// Settings that can be used, or what is wrong with them.
    pub fn validated(self) -> Result<Self, FilterError> {
        let fault = |reason| Err(FilterError::Settings { reason });
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !self.models.iter().all(MotionModel::is_valid) {
            return fault(
                "a motion model needs decay 0..100 per s, time >= 0.01 s and positive sigmas",
            );
        }
        let rates = self.switching_per_s.as_flattened();
        if !rates.iter().all(|r| (0.0..=1000.0).contains(r)) {
            return fault("switching rates must be 0..1000 per s");
        }
        let p = &self.first_probabilities;
        if !p.iter().all(|x| (0.0..=1.0).contains(x)) || (p.iter().sum::<f64>() - 1.0).abs() > 1e-9
        {
            return fault("the models' first probabilities must be 0..1 and sum to 1");
        }
        if !(positive(self.first_level_speed_m_s) && positive(self.first_vertical_speed_m_s)) {
            return fault("the first speeds' standard deviations must be positive (m/s)");
        }
        if !(0.9..=0.99999).contains(&self.gate_probability) {
            return fault("the gate's probability must be 0.9..0.99999");
        }
        if self.restart_after == 0 {
            return fault("at least one rejected measurement must come before a restart");
        }
        if !self.nearest_z_m.is_none_or(positive) || !positive(self.farthest_start_m) {
            return fault("nearest and farthest distance must be positive (m)");
        }
        if !(positive(self.longest_gap_s) && self.longest_gap_s <= 600.0) {
            return fault("the longest gap must be above 0 s and at most 600 s");
        }
        Ok(self)
    }

    /// Move a position that lies behind the rig in front of it; whether that was needed.
    pub(crate) fn keep_in_front(&self, state: &mut State) -> bool {
        match self.nearest_z_m {
            Some(nearest) if state[2] < nearest => {
                state[2] = nearest;
                state[5] = state[5].max(0.0);
                true
            }
            _ => false,
        }
    }
}

/// Why the filter refused something; its state is then as before.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// Settings that make no filter.
    #[error("filter settings: {reason}")]
    Settings {
        /// What would be right.
        reason: &'static str,
    },
    /// A measurement with numbers that mean nothing.
    #[error("measurement at {time_s} s refused: {reason}")]
    BadMeasurement {
        /// Its time, s.
        time_s: f64,
        /// What is wrong.
        reason: &'static str,
    },
    /// A measurement that is not later than the newest one, or whose time is not finite.
    #[error(
        "measurement at {time_s} s refused: it must be later than the newest one at {newest_s} s"
    )]
    NotLater {
        /// Its time, s.
        time_s: f64,
        /// The newest time that was taken, s.
        newest_s: f64,
    },
    /// Nothing was seen yet from which a distance follows.
    #[error("the filter has not started: it needs one sight with a distance below {farthest_m} m")]
    NotStarted {
        /// [`FilterSettings::farthest_start_m`].
        farthest_m: f64,
    },
    /// A prediction for a time before the newest measurement, or too long after it.
    #[error("no prediction for {time_s} s: it must lie between {newest_s} s and {last_s} s")]
    OutOfRange {
        /// The time asked for, s.
        time_s: f64,
        /// The newest measurement, s.
        newest_s: f64,
        /// Latest time for which there is an answer, s.
        last_s: f64,
    },
    /// The measurement would have left no valid covariance (numbers of absurd size).
    #[error("measurement at {time_s} s refused: the filter's covariance would break down")]
    Breakdown {
        /// Its time, s.
        time_s: f64,
    },
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The first one: the filter started from it.
    Started,
    /// Used.
    Accepted,
    /// Outside the gate: not used.
    Rejected,
    /// Outside the gate, but so were several before it that agree with it: the filter started again from them.
    Restarted,
}

/// Answer to one measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// What became of it.
    pub verdict: Verdict,
    /// Normalised innovation squared under the mixture of the models; `None` when there was nothing to compare with.
    pub nis: Option<f64>,
    /// Its degrees of freedom: components of the measurement.
    pub degrees: usize,
    /// What the gate compares: the innovation squared under the widest model, and the gate's limit.
    pub gate: Option<[f64; 2]>,
}

/// The target at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetEstimate {
    /// For this time, s on the run's clock.
    pub time_s: f64,
    /// Position, m.
    pub position_in_base: Point3<f64>,
    /// Velocity, m/s.
    pub velocity_in_base: Vector3<f64>,
    /// Acceleration, m/s² (its covariance is kept inside).
    pub acceleration_in_base: Vector3<f64>,
    /// Covariance of position and velocity `(x, y, z, vx, vy, vz)`, base frame, SI.
    pub covariance: Matrix6<f64>,
    /// Probabilities of the models, in the order of [`Motion::ALL`].
    pub model_probabilities: [f64; MODELS],
    /// Seconds since the last measurement that was used.
    pub unseen_s: f64,
    /// Whether a position behind the rig was moved to the nearest allowed distance since the last measurement.
    pub clamped: bool,
}

impl TargetEstimate {
    /// The most probable motion.
    pub fn motion(&self) -> Motion {
        let p = &self.model_probabilities;
        let best = (1..MODELS).fold(0, |best, m| if p[m] > p[best] { m } else { best });
        Motion::ALL[best]
    }

    /// Covariance of the position, m².
    pub fn position_covariance(&self) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// Normalised estimation error squared of position and velocity (6 degrees of freedom) given the truth.
    pub fn nees(
        &self,
        position_in_base: &Point3<f64>,
        velocity_in_base: &Vector3<f64>,
    ) -> Option<f64> {
        let p = self.position_in_base - position_in_base;
        let v = self.velocity_in_base - velocity_in_base;
        let error = Vector6::new(p.x, p.y, p.z, v.x, v.y, v.z);
        normalized_square(&error, &self.covariance)
    }

    /// Normalised estimation error squared of the position alone (3 degrees of freedom).
    pub fn nees_position(&self, position_in_base: &Point3<f64>) -> Option<f64> {
        normalized_square(
            &(self.position_in_base - position_in_base),
            &self.position_covariance(),
        )
    }
}

/// A second filter that grows from rejected measurements.
#[derive(Clone, Debug)]
struct Rival {
    bank: Bank,
    count: usize,
}

/// The filter of one target.
#[derive(Clone, Debug)]
pub struct TargetFilter {
    settings: FilterSettings,
    /// Limits of the gate for 2 and for 3 degrees of freedom.
    gates: [f64; 2],
    bank: Option<Bank>,
    rival: Option<Rival>,
    newest_s: f64,
}

impl TargetFilter {
    /// A filter that has seen nothing yet.
    pub fn new(settings: FilterSettings) -> Result<Self, FilterError> {
        let settings = settings.validated()?;
        Ok(Self {
            settings,
            gates: [2, 3].map(|k| chi_square_quantile(settings.gate_probability, k)),
            bank: None,
            rival: None,
            newest_s: f64::NEG_INFINITY,
        })
    }

    /// The settings in use.
    pub fn settings(&self) -> &FilterSettings {
        &self.settings
    }

    /// Whether there is an estimate.
    pub fn is_started(&self) -> bool {
        self.bank.is_some()
    }

    /// Time of the newest measurement that was used, s.
    pub fn last_used_s(&self) -> Option<f64> {
        self.bank.as_ref().map(|b| b.time_s)
    }

    /// Forget the target; settings stay, and time may start again anywhere.
    pub fn reset(&mut self) {
        self.bank = None;
        self.rival = None;
        self.newest_s = f64::NEG_INFINITY;
    }

    /// Take one measurement. Times must increase from call to call (rejected measurements count); what is refused
    /// with an error changes nothing.
    pub fn observe(&mut self, observation: &Observation) -> Result<Update, FilterError> {
        let time_s = observation.time_s;
        let sight = &observation.sight;
        if !time_s.is_finite() || time_s <= self.newest_s {
            return Err(FilterError::NotLater {
                time_s,
                newest_s: self.newest_s,
            });
        }
        if let Some(reason) = sight.fault() {
            return Err(FilterError::BadMeasurement { time_s, reason });
        }
        let bridged = self
            .bank
            .as_ref()
            .is_some_and(|b| time_s - b.time_s <= self.settings.longest_gap_s);
        let update = if bridged {
            self.compare(observation)?
        } else {
            self.start(observation)?
        };
        self.newest_s = time_s;
        Ok(update)
    }

    /// The target at a time not before the newest measurement that was used and at most
    /// [`FilterSettings::longest_gap_s`] after it.
    pub fn predict(&self, time_s: f64) -> Result<TargetEstimate, FilterError> {
        let bank = self.bank.as_ref().ok_or(FilterError::NotStarted {
            farthest_m: self.settings.farthest_start_m,
        })?;
        let last_s = bank.time_s + self.settings.longest_gap_s;
        if !(time_s >= bank.time_s && time_s <= last_s) {
            return Err(FilterError::OutOfRange {
                time_s,
                newest_s: bank.time_s,
                last_s,
            });
        }
        let unseen_s = time_s - bank.time_s;
        if unseen_s > 0.0 {
            Ok(estimate(
                &bank.propagated(&self.settings, time_s),
                unseen_s,
                &self.settings,
            ))
        } else {
            Ok(estimate(bank, 0.0, &self.settings))
        }
    }

    fn start(&mut self, observation: &Observation) -> Result<Update, FilterError> {
        let restarted = self.bank.is_some();
        self.bank = Some(self.bank_from(observation)?);
        self.rival = None;
        Ok(Update {
            verdict: if restarted {
                Verdict::Restarted
            } else {
                Verdict::Started
            },
            nis: None,
            degrees: observation.sight.degrees(),
            gate: None,
        })
    }

    fn bank_from(&self, observation: &Observation) -> Result<Bank, FilterError> {
        let s = &self.settings;
        let (position, covariance) =
            observation
                .sight
                .position(s.farthest_start_m)
                .ok_or(FilterError::NotStarted {
                    farthest_m: s.farthest_start_m,
                })?;
        let mut mean = State::zeros();
        mean.fixed_rows_mut::<3>(0).copy_from(&position.coords);
        let clamped = s.keep_in_front(&mut mean);
        let speed = [
            s.first_level_speed_m_s,
            s.first_vertical_speed_m_s,
            s.first_level_speed_m_s,
        ];
        let beliefs = s.models.map(|model| {
            let mut p = StateCovariance::zeros();
            p.fixed_view_mut::<3, 3>(0, 0).copy_from(&covariance);
            let acceleration = model.acceleration_variance();
            for axis in 0..3 {
                p[(3 + axis, 3 + axis)] = speed[axis] * speed[axis];
                p[(6 + axis, 6 + axis)] = acceleration[axis];
            }
            Belief {
                mean,
                covariance: p,
            }
        });
        Ok(Bank {
            time_s: observation.time_s,
            beliefs,
            probabilities: s.first_probabilities,
            clamped,
        })
    }

    fn compare(&mut self, observation: &Observation) -> Result<Update, FilterError> {
        let breakdown = FilterError::Breakdown {
            time_s: observation.time_s,
        };
        let Some(bank) = &self.bank else {
            return self.start(observation);
        };
        let (surprise, limit, updated) = self.tried(bank, observation).ok_or(breakdown)?;
        let mut update = Update {
            verdict: Verdict::Accepted,
            nis: Some(surprise.nis),
            degrees: observation.sight.degrees(),
            gate: Some([surprise.gate_distance, limit]),
        };
        if let Some(updated) = updated {
            self.bank = Some(updated);
            self.rival = None;
            return Ok(update);
        }
        update.verdict = Verdict::Rejected;
        self.rival = self.next_rival(observation);
        if let Some(rival) = self
            .rival
            .take_if(|r| r.count >= self.settings.restart_after)
        {
            self.bank = Some(rival.bank);
            update.verdict = Verdict::Restarted;
        }
        Ok(update)
    }

    /// What the rejected measurements make together with one more: they go on if it fits them, else start from it.
    fn next_rival(&self, observation: &Observation) -> Option<Rival> {
        let grown = self.rival.as_ref().and_then(|rival| {
            let (_, _, updated) = self.tried(&rival.bank, observation)?;
            Some(Rival {
                bank: updated?,
                count: rival.count + 1,
            })
        });
        grown.or_else(|| {
            let bank = self.bank_from(observation).ok()?;
            Some(Rival { bank, count: 1 })
        })
    }

    /// A bank moved to the measurement's time: the surprise there, the gate's limit, and the updated bank when the
    /// measurement is inside. `None` when a covariance broke down.
    fn tried(
        &self,
        bank: &Bank,
        observation: &Observation,
    ) -> Option<(Surprise, f64, Option<Bank>)> {
        let ahead = bank.propagated(&self.settings, observation.time_s);
        match &observation.sight {
            Sight::Stereo {
                base_from_head,
                value,
                covariance,
            } => self.gated(&ahead, value, covariance, &|x| {
                observation::stereo_of(base_from_head, x)
            }),
            Sight::Direction {
                base_from_head,
                value,
                covariance,
            } => self.gated(&ahead, value, covariance, &|x| {
                observation::direction_of(base_from_head, x)
            }),
            Sight::Position {
                position_in_base,
                covariance,
            } => self.gated(
                &ahead,
                &position_in_base.coords,
                covariance,
                &observation::position_of,
            ),
        }
    }

    fn gated<const N: usize>(
        &self,
        ahead: &Bank,
        value: &SVector<f64, N>,
        noise: &SMatrix<f64, N, N>,
        expect: &impl Fn(&State) -> observation::Expected<N>,
    ) -> Option<(Surprise, f64, Option<Bank>)>
    where
        nalgebra::Const<N>: nalgebra::DimMin<nalgebra::Const<N>, Output = nalgebra::Const<N>>,
    {
        let limit = self.gates[N - 2];
        let surprise = ahead.surprise(value, noise, expect)?;
        if surprise.gate_distance > limit {
            return Some((surprise, limit, None));
        }
        let updated = ahead.updated(&self.settings, value, noise, expect)?;
        Some((surprise, limit, Some(updated)))
    }
}

fn estimate(bank: &Bank, unseen_s: f64, settings: &FilterSettings) -> TargetEstimate {
    let Belief {
        mut mean,
        covariance,
    } = bank.combined();
    // A mixture of positions in front lies in front; the call guards against rounding alone.
    let clamped = settings.keep_in_front(&mut mean) || bank.clamped;
    TargetEstimate {
        time_s: bank.time_s,
        position_in_base: Point3::new(mean[0], mean[1], mean[2]),
        velocity_in_base: Vector3::new(mean[3], mean[4], mean[5]),
        acceleration_in_base: Vector3::new(mean[6], mean[7], mean[8]),
        covariance: covariance.fixed_view::<6, 6>(0, 0).into_owned(),
        model_probabilities: bank.probabilities,
        unseen_s,
        clamped,
    }
}
