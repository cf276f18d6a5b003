//! Are the zeros of the axes still where they were? A motor without an encoder that misses steps says nothing of it; the pictures do.
//!
//! In two ways. What lies behind infinity ([`InfinityCheck`]) says that the eyes are turned towards each other further than the axes say; eyes that are turned
//! apart from what they should be only make everything seem nearer, and are not noticed so. It is looked for while nobody is followed, and until the rig was once
//! seen to be well. And a part of the room that was seen before lies elsewhere when an axis has lost its zero since (`servo::bearings`).

use vergence_control::AxisName;
use vergence_geometry::HeadAngles;
use vergence_track::{FarSight, InfinityCheck};

use crate::bearings::{Bearing, Bearings, Look};
use crate::watch::WatchSettings;

/// Time between two looks, s.
const EVERY_S: f64 = 0.35;

/// So many looks make a finding, with no better one between them ...
const LOOKS: u32 = 3;

/// ... and with no longer than this between two of them, s: in between somebody may have been taken for the target.
const PAUSE_S: f64 = 2.0;

/// Where the right camera's drift is corrected, that gets so many of its own periods to do so before anything is found here.
const CORRECTED_WITHIN: f64 = 5.0;

/// Looks around come faster once one found something: they make a finding when so long apart, s, ...
const ROOM_S: f64 = 0.5;

/// ... and when an eye lies beside by the same angle in all of them, to this, rad (0.3°).
const SAME_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// A look says something when at least so many patches were matched ...
const LEAST_MATCHED: u32 = 6;

/// ... and that the eyes stand wrong when at least so many, and this share of them, lie behind infinity, ...
const LEAST_BEYOND: u32 = 3;
const BEYOND_SHARE: f64 = 0.25;

/// ... by at least this angle, rad (0.3°): less may be a rig that nobody calibrated.
const LEAST_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// While the head turns faster than this a pair of different times would look like eyes turned apart, rad/s (3°/s).
const STILL_RAD_S: f64 = 3.0 * std::f64::consts::PI / 180.0;

/// So often it is looked at beside somebody who is followed, to see that the rig is well; a room without anything to match never shows it.
const LOOKS_IN_SIGHT: u32 = 30;

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrong {
    /// The eyes are turned towards each other further than the axes say.
    Vergence,
    /// The room lies beside where it was, by the fault of this axis as far as the pictures tell: a turned head is not told from one of its axes.
    Axis(AxisName),
}

/// What the looks say together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LostZero {
    /// What is wrong.
    pub wrong: Wrong,
    /// By at least this angle, rad.
    pub by_rad: f64,
    /// Whether it was so before, and homing did not mend it.
    pub again: bool,
    /// Whether the eyes were ever seen to stand right in this run: if not, it is the calibration that is wrong. Always of a room that lies beside.
    pub was_right: bool,
}

impl LostZero {
    /// As a sentence for a person who is to do something.
    pub fn sentence(&self) -> String {
        let degrees = self.by_rad.to_degrees();
        match self.wrong {
            Wrong::Vergence => {
                let remedy = if !self.was_right {
                    "they never stood as calibrated in this run: calibrate the rig, or see whether left and right are swapped"
                } else if self.again {
                    "homing did not mend it: see whether a camera was turned, left and right are swapped or one repeats an old picture, and calibrate"
                } else {
                    "a motor has missed steps: home the rig (or left and right are swapped, a camera was turned, or one repeats an old picture)"
                };
                format!(
                    "what both cameras see lies behind infinity: they are turned towards each other at least {degrees:.1} degrees further than the vergence axes say; {remedy}"
                )
            }
            Wrong::Axis(axis) => {
                let (who_sees, name) = match axis {
                    AxisName::Pan => ("the cameras see", "pan"),
                    AxisName::Tilt => ("the cameras see", "tilt"),
                    AxisName::LeftVergence => ("the left camera sees", "left vergence"),
                    AxisName::RightVergence => ("the right camera sees", "right vergence"),
                };
                let remedy = match self.again {
                    true => {
                        "homing did not mend it: the room is learned anew; see whether the rig or a camera was turned by hand, or the switch has moved"
                    }
                    false => {
                        "its motor has missed steps: home the rig (or something was turned by hand)"
                    }
                };
                format!(
                    "{who_sees} the room at least {degrees:.1} degrees beside where axis {name} says: {remedy}"
                )
            }
        }
    }
}

/// How far it has come since all was last seen to be right.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Told {
    #[default]
    Nothing,
    /// Told, and not homed since.
    Lost,
    /// Homed since.
    Homed,
    /// Told that homing did not mend it; more homing would not either.
    GivenUp,
}

/// Looks, with what they said so far: one is no finding.
#[derive(Default)]
struct Looks {
    /// A finding takes at least so long from its first look on, s.
    patience_s: f64,
    /// Looks that found something wrong: how many in a row, and when the first and the last of them were, s.
    bad: u32,
    bad_s: [f64; 2],
    good: u32,
    was_right: bool,
    told: Told,
}

impl Looks {
    /// A look that found all right.
    fn right(&mut self) {
        self.bad = 0;
        self.good += 1;
        if self.good >= LOOKS {
            self.was_right = true;
            self.told = Told::Nothing;
        }
    }

    /// A look that found it wrong: whether that is to be told, and whether again.
    fn wrong(&mut self, time_s: f64) -> Option<bool> {
        self.good = 0;
        if self.bad == 0 || time_s - self.bad_s[1] > PAUSE_S {
            self.bad = 0;
            self.bad_s[0] = time_s;
        }
        self.bad_s[1] = time_s;
        self.bad += 1;
        if self.bad < LOOKS || time_s - self.bad_s[0] < self.patience_s {
            return None;
        }
        self.bad = 0;
        let again = self.told == Told::Homed;
        self.told = match self.told {
            Told::Nothing => Told::Lost,
            Told::Homed => Told::GivenUp,
            Told::Lost | Told::GivenUp => return None,
        };
        Some(again)
    }

    fn begin_homing(&mut self) {
        self.bad = 0;
        self.good = 0;
        if self.told == Told::Lost {
            self.told = Told::Homed;
        }
    }
}

/// Both ways of looking.
#[derive(Default)]
pub(crate) struct Zeros {
    check: InfinityCheck,
    due_s: f64,
    before: Option<(f64, HeadAngles)>,
    looks_in_sight: u32,
    vergence: Looks,
    bearings: Bearings,
    room: Looks,
    /// What the last look around found beside.
    beside: Option<(AxisName, f64)>,
    told_axis: Option<AxisName>,
}

/// Whether two looks found the same axis wrong, to the same side. A pan whose counter runs away is off by more each time; an eye is not.
fn is_same((axis, by_rad): (AxisName, f64), (now, by_now_rad): (AxisName, f64)) -> bool {
    let is_eye = matches!(axis, AxisName::LeftVergence | AxisName::RightVergence);
    axis == now
        && by_rad.signum() == by_now_rad.signum()
        && (!is_eye || (by_rad - by_now_rad).abs() <= SAME_RAD)
}

impl Zeros {
    /// For a rig whose health is watched in this way beside.
    pub(crate) fn new(watch: &WatchSettings) -> Self {
        let mut zeros = Self::default();
        zeros.room.patience_s = ROOM_S;
        if watch.correct {
            zeros.vergence.patience_s = CORRECTED_WITHIN * watch.every_s;
            zeros.room.patience_s = ROOM_S.max(zeros.vergence.patience_s);
        }
        zeros
    }

    /// Look at a pair when it is time to.
    pub(crate) fn look(&mut self, look: &Look) -> Option<LostZero> {
        self.look_behind_infinity(look)
            .or_else(|| self.look_around(look))
    }

    fn look_behind_infinity(&mut self, look: &Look) -> Option<LostZero> {
        let time_s = look.time_s;
        let still = self.stands(time_s, &look.angles);
        if !still || time_s < self.due_s {
            return None;
        }
        if look.person.is_some() {
            if self.vergence.was_right || self.looks_in_sight >= LOOKS_IN_SIGHT {
                return None;
            }
            self.looks_in_sight += 1;
        }
        self.due_s = time_s + EVERY_S;
        let sight = self.check.look(&look.views[0], &look.views[1]);
        self.take(time_s, &sight)
    }

    /// Whether the room lies where it did.
    fn look_around(&mut self, look: &Look) -> Option<LostZero> {
        match self.bearings.look(look)? {
            Bearing::There => {
                self.room.right();
                None
            }
            Bearing::Beside(axis, by_rad) => {
                let mut lost = self.lies_beside(look.time_s, axis, by_rad)?;
                lost.by_rad = match axis {
                    AxisName::Pan | AxisName::Tilt => self.bearings.at_least(look, axis, by_rad),
                    AxisName::LeftVergence | AxisName::RightVergence => lost.by_rad,
                };
                if lost.again {
                    self.bearings.forget();
                }
                Some(lost)
            }
        }
    }

    fn lies_beside(&mut self, time_s: f64, axis: AxisName, by_rad: f64) -> Option<LostZero> {
        let before = self.beside.replace((axis, by_rad));
        if !before.is_some_and(|before| is_same(before, (axis, by_rad))) {
            self.room.bad = 0;
        }
        let again = self.room.wrong(time_s)?;
        let again = again && self.told_axis == Some(axis);
        self.told_axis = Some(axis);
        Some(LostZero {
            wrong: Wrong::Axis(axis),
            by_rad: by_rad.abs(),
            again,
            was_right: true,
        })
    }

    /// The axes are about to be homed: what was seen before counts no more.
    pub(crate) fn begin_homing(&mut self) {
        self.before = None;
        self.vergence.begin_homing();
        self.bearings.begin_homing();
        self.room.begin_homing();
    }

    fn stands(&mut self, time_s: f64, angles: &HeadAngles) -> bool {
        let before = self.before.replace((time_s, *angles));
        before.is_some_and(|(before_s, before)| {
            let most = STILL_RAD_S * (time_s - before_s).max(1e-3);
            let turned = angles.to_array().into_iter().zip(before.to_array());
            turned
                .into_iter()
                .all(|(now, then)| (now - then).abs() <= most)
        })
    }

    fn take(&mut self, time_s: f64, sight: &FarSight) -> Option<LostZero> {
        if sight.matched < LEAST_MATCHED {
            return None;
        }
        let least = BEYOND_SHARE * f64::from(sight.matched);
        let beyond = sight.beyond >= LEAST_BEYOND && f64::from(sight.beyond) >= least;
        if !(beyond && sight.by_rad >= LEAST_RAD) {
            self.vergence.right();
            return None;
        }
        let again = self.vergence.wrong(time_s)?;
        Some(LostZero {
            wrong: Wrong::Vergence,
            by_rad: sight.by_rad,
            again,
            was_right: self.vergence.was_right,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sight(matched: u32, beyond: u32) -> FarSight {
        FarSight {
            matched,
            beyond,
            by_rad: 0.01,
        }
    }

    /// What is told of looks `EVERY_S` apart, from `from_s` on.
    fn told_from(zeros: &mut Zeros, from_s: f64, looks: &[FarSight]) -> Vec<LostZero> {
        let looks = looks.iter().enumerate();
        looks
            .filter_map(|(i, look)| zeros.take(from_s + i as f64 * EVERY_S, look))
            .collect()
    }

    fn told(zeros: &mut Zeros, looks: &[FarSight]) -> Vec<LostZero> {
        told_from(zeros, 0.0, looks)
    }

    const GOOD: [FarSight; 3] = [FarSight {
        matched: 12,
        beyond: 0,
        by_rad: 0.0,
    }; 3];

    /// Three looks in a row make a finding, not two, nor three with a good one among them or a long pause; few matches say nothing, nor does a little.
    #[test]
    fn one_look_is_no_finding() {
        let mut zeros = Zeros::default();
        assert!(told(&mut zeros, &GOOD).is_empty());
        let (bad, good) = (sight(10, 5), GOOD[0]);
        assert!(told(&mut zeros, &[bad, bad, good, bad, bad, good]).is_empty());
        assert!(told(&mut zeros, &[sight(5, 5); 9]).is_empty());
        assert!(told(&mut zeros, &[sight(30, 5); 9]).is_empty());
        let little = FarSight {
            by_rad: 0.004,
            ..bad
        };
        assert!(told(&mut zeros, &[little; 9]).is_empty());
        assert!(told_from(&mut zeros, 10.0, &[bad, bad]).is_empty());
        assert!(told_from(&mut zeros, 13.0, &[bad, bad]).is_empty());
        assert!(told(&mut zeros, &[good]).is_empty());
        let found = told_from(&mut zeros, 20.0, &[bad, bad, sight(3, 3), bad]);
        assert_eq!(found.len(), 1);
        assert!(found[0].was_right && !found[0].again && found[0].by_rad == 0.01);
        assert!(found[0].sentence().contains("0.6 degrees"));
    }

    /// Told once until the axes are homed, then once that homing did not mend it, and no more until the eyes stand right again; what was never right is the
    /// calibration.
    #[test]
    fn it_is_told_once_and_once_more_after_homing() {
        let mut zeros = Zeros::default();
        let bad = [sight(10, 5); 30];
        let first = told(&mut zeros, &bad);
        assert!(first.len() == 1 && !first[0].was_right && !first[0].again);
        assert!(first[0].sentence().contains("calibrate"));
        zeros.begin_homing();
        let second = told(&mut zeros, &bad);
        assert!(second.len() == 1 && second[0].again);
        zeros.begin_homing();
        assert!(told(&mut zeros, &bad).is_empty());
        assert!(told(&mut zeros, &GOOD).is_empty());
        let anew = told(&mut zeros, &bad);
        assert!(anew.len() == 1 && anew[0].was_right && !anew[0].again);
    }

    /// Where the right camera's drift is corrected, that has five of its periods to do so.
    #[test]
    fn a_correction_comes_first() {
        let mut zeros = Zeros::new(&WatchSettings {
            every_s: 1.0,
            correct: true,
        });
        assert!(told(&mut zeros, &[sight(10, 5); 15]).is_empty());
        assert!(told(&mut zeros, &GOOD).is_empty());
        assert_eq!(told_from(&mut zeros, 10.0, &[sight(10, 5); 17]).len(), 1);
    }

    /// Looks around make a finding when three of them, half a second apart, find the same axis off to the same side, an eye by the same angle.
    #[test]
    fn looks_around_must_agree() {
        let pan = |by_deg: f64| (AxisName::Pan, by_deg.to_radians());
        let left = |by_deg: f64| (AxisName::LeftVergence, by_deg.to_radians());
        assert!(is_same(pan(3.0), pan(20.0)) && is_same(left(1.0), left(1.2)));
        assert!(!is_same(pan(3.0), pan(-3.0)) && !is_same(left(1.0), left(1.5)));
        assert!(!is_same(pan(3.0), (AxisName::Tilt, pan(3.0).1)));
        let told = |looks: &[(f64, (AxisName, f64))]| {
            let mut zeros = Zeros::new(&WatchSettings {
                every_s: 1.0,
                correct: false,
            });
            let found = looks
                .iter()
                .filter_map(|(time_s, (axis, by))| zeros.lies_beside(*time_s, *axis, *by));
            found.map(|lost| lost.wrong).collect::<Vec<_>>()
        };
        let one = pan(3.0);
        assert_eq!(
            told(&[(0.0, one), (0.3, one), (0.6, one)]),
            [Wrong::Axis(one.0)]
        );
        assert_eq!(told(&[(0.0, one), (0.1, one), (0.2, one)]), []);
        assert_eq!(told(&[(0.0, one), (0.3, pan(-3.0)), (0.6, one)]), []);
        assert_eq!(told(&[(0.0, one), (2.3, one), (4.6, one), (6.9, one)]), []);
        assert_eq!(
            told(&[(0.0, left(1.0)), (0.3, left(2.0)), (0.6, left(1.0))]),
            []
        );
    }
}
