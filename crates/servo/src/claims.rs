//! Sightings that were not believed, together: what walks like a person for a while is one.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};

/// Least time over which claims must agree, s.
const LEAST_S: f64 = 0.3;

/// Claims older than this are forgotten, s.
const MEMORY_S: f64 = 1.0;

/// A pause longer than this between two claims ends them, s.
const PAUSE_S: f64 = 0.3;

/// Fewest claims that say anything.
const FEWEST: usize = 6;

/// Most claims kept (1 s at up to 200 pairs a second).
const MOST: usize = 200;

/// Speeds of walkers, m/s: what is slower may be a wall that looks like the target, unless its picture moves; what is faster is no person.
const SPEED_M_S: [f64; 2] = [0.4, 2.5];

/// How far claims may lie off one straight walk, RMS, m, at 5 m and nearer; it grows with the square of the distance, as the noise
/// of the range does.
const SPREAD_M: f64 = 0.12;

/// Share of the claims of a walk whose pictures must have moved for it to be somebody who turns or stands, and no wall.
const MOVED_SHARE: f64 = 0.6;

/// How far from the last place of a walk the next one may lie, m, besides what the fastest walker covers.
const STRAY_M: f64 = 0.5;

/// Most walks thought of at once.
const WALKS: usize = 4;

/// Places where something looked like the target but where the target was not expected.
///
/// One such sighting proves nothing, since walls and pillars look like people now and then. A row of them along a straight walk at a
/// walker's pace does: then it is the expectation that is wrong.
#[derive(Clone, Debug, Default)]
pub(crate) struct Claims {
    walks: Vec<Walk>,
}

/// Times and places, in order.
type Trail = VecDeque<(f64, Point3<f64>)>;

/// Claims that can be those of one walker.
#[derive(Clone, Debug, Default)]
struct Walk {
    /// Never empty once it was added to.
    trail: Trail,
    /// Whether the picture moved in each of them.
    moved: VecDeque<bool>,
}

impl Claims {
    /// Add a sighting that was not believed, and whether it lies on something of a person's size that moves in the picture; whether it must be believed now.
    pub(crate) fn add(&mut self, time_s: f64, place_in_base: Point3<f64>, moves: bool) -> bool {
        let last = |walk: &Walk| walk.trail.back().copied();
        let fresh = |walk: &Walk| last(walk).is_some_and(|last| time_s - last.0 <= PAUSE_S);
        self.walks.retain(fresh);
        let miss_m = |walk: &Walk| {
            last(walk).map_or(f64::INFINITY, |(last_s, last)| {
                (place_in_base - last).norm() - SPEED_M_S[1] * (time_s - last_s)
            })
        };
        let nearest = (0..self.walks.len())
            .min_by(|&a, &b| miss_m(&self.walks[a]).total_cmp(&miss_m(&self.walks[b])))
            .filter(|&i| miss_m(&self.walks[i]) < STRAY_M);
        let index = nearest.unwrap_or_else(|| {
            if self.walks.len() >= WALKS {
                self.walks.remove(0);
            }
            self.walks.push(Walk::default());
            self.walks.len() - 1
        });
        let walk = &mut self.walks[index];
        let trail = &mut walk.trail;
        trail.push_back((time_s, place_in_base));
        walk.moved.push_back(moves);
        while trail.len() > MOST || trail.front().is_some_and(|p| time_s - p.0 > MEMORY_S) {
            trail.pop_front();
            walk.moved.pop_front();
        }
        let moved = walk.moved.iter().filter(|m| **m).count();
        let moves = moved as f64 >= MOVED_SHARE * trail.len() as f64;
        is_walker(&walk.trail, moves)
    }
}

fn is_walker(walk: &Trail, moves: bool) -> bool {
    let (Some(first), Some(last)) = (walk.front(), walk.back()) else {
        return false;
    };
    if walk.len() < FEWEST || last.0 - first.0 < LEAST_S {
        return false;
    }
    let (velocity, spread_m) = line(walk);
    let level = velocity.x.hypot(velocity.z);
    let allowed_m = SPREAD_M * (last.1.z / 5.0).powi(2).max(1.0);
    let slowest = if moves { 0.0 } else { SPEED_M_S[0] };
    (slowest..=SPEED_M_S[1]).contains(&level) && spread_m < allowed_m
}

/// Velocity of the least-squares line through places over time, and their RMS distance from it. At least two different times.
pub(crate) fn line(places: &Trail) -> (Vector3<f64>, f64) {
    let n = places.len() as f64;
    let mean_s = places.iter().map(|p| p.0).sum::<f64>() / n;
    let mean = places.iter().map(|p| p.1.coords).sum::<Vector3<f64>>() / n;
    let (mut slope, mut weight) = (Vector3::zeros(), 0.0);
    for (time_s, place) in places {
        slope += place.coords * (time_s - mean_s);
        weight += (time_s - mean_s).powi(2);
    }
    let velocity = slope / weight;
    let square = places
        .iter()
        .map(|(t, p)| (p.coords - mean - velocity * (t - mean_s)).norm_squared())
        .sum::<f64>();
    (velocity, (square / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claims(count: usize, place: impl Fn(f64, usize) -> Point3<f64>) -> Option<usize> {
        let mut claims = Claims::default();
        (0..count).find(|&i| {
            let time_s = i as f64 / 30.0;
            claims.add(time_s, place(time_s, i), false)
        })
    }

    /// A walker who is not where it was expected is believed after a third of a second and not before, in every direction.
    #[test]
    fn walkers_are_believed() {
        for [vx, vz] in [[1.0, 0.0], [-0.7, 0.4], [0.0, -1.2], [0.5, 0.5]] {
            let at = claims(60, |t, i| {
                let noise = 0.03 * (i as f64 * 2.4).sin();
                Point3::new(vx * t + noise, 0.2, 5.0 + vz * t - noise)
            });
            assert!(at.is_some_and(|at| (9..16).contains(&at)), "{at:?}");
        }
    }

    /// Walls, places all over the room, and what is faster than anybody never are.
    #[test]
    fn what_does_not_walk_is_not() {
        let wall = claims(300, |_, i| {
            Point3::new(
                0.02 * (i as f64).sin(),
                0.0,
                4.0 + 0.02 * (i as f64 * 1.7).cos(),
            )
        });
        assert_eq!(wall, None);
        let jumps = claims(300, |_, i| {
            let share = |step: f64| (i as f64 * step).fract();
            Point3::new(5.0 * share(0.618_034), 0.0, 2.0 + 8.0 * share(0.754_878))
        });
        assert_eq!(jumps, None);
        let fast = claims(60, |t, _| Point3::new(6.0 * t, 0.0, 5.0));
        assert_eq!(fast, None);
    }

    /// A wall that is taken for the target in between does not hide the walker.
    #[test]
    fn walls_do_not_hide_walkers() {
        let at = claims(90, |t, i| match i % 2 {
            0 => Point3::new(1.0 - t, 0.2, 5.0),
            _ => Point3::new(0.7, 0.9, 12.4),
        });
        assert!(at.is_some_and(|at| at < 25), "{at:?}");
    }

    /// Who turns on the spot has no walker's pace, but moves: in most pictures is enough, in a few is a wall beside which somebody moved.
    #[test]
    fn who_turns_is_believed() {
        let standing = |moves: fn(usize) -> bool| {
            let mut claims = Claims::default();
            (0..60_usize).find(|&i| {
                let time_s = i as f64 / 30.0;
                let sway_m = 0.05 * (4.0 * time_s).sin();
                claims.add(time_s, Point3::new(sway_m, 0.2, 3.0), moves(i))
            })
        };
        assert!(standing(|i| i % 4 != 3).is_some_and(|at| at < 16));
        assert_eq!(standing(|i| i % 4 == 3), None);
        // What moved long ago says nothing of what stands now.
        let mut claims = Claims::default();
        let mut add =
            |time_s: f64, x_m: f64, moves| claims.add(time_s, Point3::new(x_m, 0.0, 3.0), moves);
        for i in 0..60_i32 {
            // To and fro too fast for anybody: not believed, but remembered.
            add(f64::from(i) / 30.0, 0.4 * f64::from(i % 2), true);
        }
        let late = (60..100_i32).filter(|&i| add(f64::from(i) / 30.0, 0.0, false) && i > 80);
        assert_eq!(late.count(), 0);
    }

    /// Claims with pauses are not one walk, and their number is bounded.
    #[test]
    fn pauses_end_a_walk() {
        let mut claims = Claims::default();
        for i in 0..50 {
            let time_s = f64::from(i) * 0.4;
            assert!(!claims.add(time_s, Point3::new(time_s, 0.0, 5.0), true));
        }
        for i in 0..5000 {
            claims.add(
                30.0 + f64::from(i) * 1e-4,
                Point3::new(0.0, 0.0, 5.0),
                false,
            );
            assert!(claims.walks.iter().all(|w| w.trail.len() <= MOST));
        }
    }
}
