//! Where the axes were, from status reports: a history that is interpolated, and a little that is foreseen.

use std::collections::VecDeque;

use crate::grbl::facts::{DRIVEN, Values};

/// History kept, s.
const KEPT_S: f64 = 2.0;
/// Reports kept at most.
pub(crate) const KEPT_MAX: usize = 512;
/// A moving axis is foreseen for this long after its last report, s.
const MOVING_FORESEEN_S: f64 = 0.12;
/// A standing one, s.
const STANDING_FORESEEN_S: f64 = 0.3;
/// Between reports further apart than this nothing is interpolated, s.
const GAP_S: f64 = 0.5;

/// One report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) at_s: f64,
    /// Machine position of the driven axes.
    pub(crate) units: Values,
    pub(crate) moving: bool,
}

/// The history of reports.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    places: VecDeque<Place>,
}

impl Track {
    pub(crate) fn push(&mut self, place: Place) {
        if self.places.back().is_some_and(|p| place.at_s <= p.at_s) {
            return;
        }
        self.places.push_back(place);
        while self.places.len() > KEPT_MAX
            || (self.places.len() > 2 && self.places[1].at_s < place.at_s - KEPT_S)
        {
            self.places.pop_front();
        }
    }

    pub(crate) fn clear(&mut self) {
        self.places.clear();
    }

    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }

    pub(crate) fn newest(&self) -> Option<&Place> {
        self.places.back()
    }

    /// Times between which it can answer, s.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.places.front()?, self.places.back()?);
        let foreseen = if last.moving {
            MOVING_FORESEEN_S
        } else {
            STANDING_FORESEEN_S
        };
        Some((first.at_s, last.at_s + foreseen))
    }

    /// Position and velocity of an axis, units and units/s; `None` outside the span or inside a gap.
    pub(crate) fn at(&self, axis: usize, at_s: f64) -> Option<(f64, f64)> {
        let (from_s, to_s) = self.span()?;
        if axis >= DRIVEN || !(from_s - 1e-9..=to_s + 1e-9).contains(&at_s) {
            return None;
        }
        let after = self.places.partition_point(|p| p.at_s <= at_s).max(1);
        let a = &self.places[after - 1];
        let Some(b) = self.places.get(after) else {
            let velocity = self.velocity(after - 1, axis);
            return Some((a.units[axis] + velocity * (at_s - a.at_s), velocity));
        };
        let dt = b.at_s - a.at_s;
        if dt > GAP_S && a.units[axis] != b.units[axis] {
            return None;
        }
        let (va, vb) = (self.velocity(after - 1, axis), self.velocity(after, axis));
        Some(hermite(
            a.units[axis],
            va,
            b.units[axis],
            vb,
            dt,
            (at_s - a.at_s) / dt,
        ))
    }

    /// Velocity at a report, from its neighbours; zero where nothing moved before it or after it.
    fn velocity(&self, i: usize, axis: usize) -> f64 {
        let here = &self.places[i];
        if !here.moving {
            return 0.0;
        }
        let slope = |a: &Place, b: &Place| (b.units[axis] - a.units[axis]) / (b.at_s - a.at_s);
        let before = i.checked_sub(1).map(|j| slope(&self.places[j], here));
        let after = self.places.get(i + 1).map(|next| slope(here, next));
        match (before, after) {
            (Some(a), Some(b)) => f64::midpoint(a, b),
            // The newest report: its speed is the last slope carried on by half of how that changed.
            (Some(a), None) => {
                let earlier = i
                    .checked_sub(2)
                    .map(|j| slope(&self.places[j], &self.places[i - 1]));
                a + 0.5 * earlier.map_or(0.0, |e| a - e)
            }
            (None, Some(b)) => b,
            (None, None) => 0.0,
        }
    }
}

/// Cubic through two positions with two velocities; position and velocity at the part `s` of the way.
fn hermite(a: f64, va: f64, b: f64, vb: f64, dt: f64, s: f64) -> (f64, f64) {
    let way = b - a;
    // A position that did not change has not moved in between.
    if way == 0.0 && va * vb >= 0.0 {
        return (a, 0.0);
    }
    let (c2, c3) = (3.0 * way - dt * (2.0 * va + vb), dt * (va + vb) - 2.0 * way);
    let position = a + s * (dt * va + s * (c2 + s * c3));
    let velocity = va + s * (2.0 * c2 + s * 3.0 * c3) / dt;
    (position, velocity)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(positions: impl Iterator<Item = (f64, f64, bool)>) -> Track {
        let mut track = Track::default();
        for (at_s, x, moving) in positions {
            track.push(Place {
                at_s,
                units: [x; DRIVEN],
                moving,
            });
        }
        track
    }

    /// A smooth motion sampled at 50 Hz is given back to a thousandth of its size between the samples, position and velocity.
    #[test]
    fn a_smooth_motion_is_given_back() {
        let x = |t: f64| 5.0 * (2.0 * t).sin();
        let track = track((0..60).map(|i| {
            let t = f64::from(i) * 0.02;
            (t, x(t), true)
        }));
        let mut seen = 0;
        for i in 0..1000 {
            let t = 0.1 + f64::from(i) * 1e-3;
            let (p, v) = track.at(0, t).unwrap();
            assert!((p - x(t)).abs() < 0.001, "{t}: {p} {}", x(t));
            assert!((v - 10.0 * (2.0 * t).cos()).abs() < 0.05, "{t}: {v}");
            seen += 1;
        }
        assert_eq!(seen, 1000);
    }

    /// It foresees a moving axis for a short time and a standing one a little longer, never beyond, and nothing before its first report.
    #[test]
    fn it_refuses_what_it_cannot_know() {
        let moving = track([(0.0, 0.0, true), (0.02, 0.2, true)].into_iter());
        assert_eq!(
            moving.at(0, 0.12).map(|r| (r.0 * 100.0).round()),
            Some(120.0)
        );
        assert_eq!(moving.at(0, 0.02 + MOVING_FORESEEN_S + 0.001), None);
        assert_eq!(moving.at(0, -0.001), None);
        assert_eq!(moving.at(0, f64::NAN), None);
        let standing = track([(0.0, 1.0, false), (0.02, 1.0, false)].into_iter());
        assert_eq!(standing.at(0, 0.3), Some((1.0, 0.0)));
        assert_eq!(standing.at(0, 0.4), None);
        assert_eq!(Track::default().at(0, 0.0), None);
    }
}
