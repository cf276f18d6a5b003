//! Are the zeros of the vergence axes still where they were? A motor without an encoder that misses steps says nothing of it; the pictures do.
//!
//! Looked at while nobody is followed, and until the rig was once seen to be well: what lies behind infinity ([`InfinityCheck`]) says that the eyes are
//! turned towards each other further than the axes say. Eyes that are turned apart from what they should be only make everything seem nearer, and are
//! not noticed here.

use vergence_geometry::HeadAngles;
use vergence_track::{EyeView, FarSight, InfinityCheck};

/// Time between two looks, s.
const EVERY_S: f64 = 0.35;

/// So many looks in a row make a finding.
const LOOKS: u32 = 3;

/// A look says something when at least so many patches were matched ...
const LEAST_MATCHED: u32 = 6;

/// ... and that the eyes stand wrong when at least so many, and this share of them, lie behind infinity.
const LEAST_BEYOND: u32 = 3;
const BEYOND_SHARE: f64 = 0.25;

/// While the head turns faster than this a pair of different times would look like eyes turned apart, rad/s (3°/s).
const STILL_RAD_S: f64 = 3.0 * std::f64::consts::PI / 180.0;

/// Findings without a good look between them: the first says that steps were missed, the second that homing did not mend it, and then it is no matter
/// of zeros.
const FINDINGS: u32 = 2;

/// What the looks say together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LostZero {
    /// The eyes are turned towards each other further than the axes say, by at least this angle, rad.
    pub by_rad: f64,
    /// Whether it was so before, and homing did not mend it.
    pub again: bool,
    /// Whether the eyes were ever seen to stand right in this run: if not, it is the calibration that is wrong.
    pub was_right: bool,
}

impl LostZero {
    /// As a sentence for a person who is to do something.
    pub fn sentence(&self) -> String {
        let degrees = self.by_rad.to_degrees();
        let seen = format!(
            "what both cameras see lies behind infinity: they are turned towards each other at least {degrees:.1} degrees further than the vergence axes say"
        );
        match self.again {
            false => format!(
                "{seen}; a motor has missed steps, or left and right are swapped: home the rig"
            ),
            true => format!(
                "{seen}, and homing did not mend it; look whether a camera was turned or left and right are swapped, and calibrate"
            ),
        }
    }
}

/// The looks, with what they said so far.
#[derive(Default)]
pub(crate) struct Zeros {
    check: InfinityCheck,
    due_s: f64,
    before: Option<(f64, HeadAngles)>,
    bad: u32,
    good: u32,
    was_right: bool,
    findings: u32,
}

impl Zeros {
    /// Look at a pair when it is time to. `in_sight` says that somebody is followed in it.
    pub(crate) fn look(
        &mut self,
        time_s: f64,
        in_sight: bool,
        angles: &HeadAngles,
        views: [&EyeView; 2],
    ) -> Option<LostZero> {
        let still = self.stands(time_s, angles);
        if in_sight && self.was_right {
            self.bad = 0;
            return None;
        }
        if !still || time_s < self.due_s {
            return None;
        }
        self.due_s = time_s + EVERY_S;
        let sight = self.check.look(views[0], views[1]);
        self.take(&sight)
    }

    /// The axes were homed, or a person has looked: what was seen before counts no more.
    pub(crate) fn begin_anew(&mut self) {
        self.bad = 0;
        self.good = 0;
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

    fn take(&mut self, sight: &FarSight) -> Option<LostZero> {
        if sight.matched < LEAST_MATCHED {
            return None;
        }
        let least = BEYOND_SHARE * f64::from(sight.matched);
        if sight.beyond < LEAST_BEYOND || f64::from(sight.beyond) < least {
            self.bad = 0;
            self.good += 1;
            if self.good >= LOOKS {
                self.was_right = true;
                self.findings = 0;
            }
            return None;
        }
        self.good = 0;
        self.bad += 1;
        if self.bad < LOOKS || self.findings >= FINDINGS {
            return None;
        }
        self.bad = 0;
        self.findings += 1;
        Some(LostZero {
            by_rad: sight.by_rad,
            again: self.findings > 1,
            was_right: self.was_right,
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

    fn told(zeros: &mut Zeros, looks: &[FarSight]) -> Vec<LostZero> {
        looks.iter().filter_map(|look| zeros.take(look)).collect()
    }

    const GOOD: [FarSight; 3] = [FarSight {
        matched: 12,
        beyond: 0,
        by_rad: 0.0,
    }; 3];

    /// Three looks in a row make a finding, not two, nor three with a good one among them; few matches say nothing.
    #[test]
    fn one_look_is_no_finding() {
        let mut zeros = Zeros::default();
        assert!(told(&mut zeros, &GOOD).is_empty());
        let (bad, good) = (sight(10, 5), GOOD[0]);
        assert!(told(&mut zeros, &[bad, bad, good, bad, bad, good]).is_empty());
        assert!(told(&mut zeros, &[sight(5, 5); 9]).is_empty());
        assert!(told(&mut zeros, &[sight(30, 5); 9]).is_empty());
        let found = told(&mut zeros, &[bad, bad, sight(3, 3), bad]);
        assert_eq!(found.len(), 1);
        assert!(found[0].was_right && !found[0].again && found[0].by_rad == 0.01);
        assert!(found[0].sentence().contains("0.6 degrees"));
    }

    /// What homing does not mend is told once more and then left alone, until the eyes stand right again; what was never right is the calibration.
    #[test]
    fn it_is_told_twice() {
        let mut zeros = Zeros::default();
        let bad = [sight(10, 5); 3];
        let first = told(&mut zeros, &bad);
        assert!(!first[0].was_right);
        zeros.begin_anew();
        assert!(told(&mut zeros, &bad)[0].again);
        assert!(told(&mut zeros, &[sight(10, 5); 30]).is_empty());
        assert!(told(&mut zeros, &GOOD).is_empty());
        let anew = told(&mut zeros, &bad);
        assert!(anew[0].was_right && !anew[0].again);
    }
}
