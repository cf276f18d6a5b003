//! From movers in single frames to one that is there for good.

use nalgebra::Vector3;

use crate::movers::Mover;

/// Frames in which a mover must have been seen at least.
const MIN_HITS: u32 = 3;
/// A track not seen for longer ends, s.
const PATIENCE_S: f64 = 0.5;
/// Tracks kept at most.
const MAX_TRACKS: usize = 16;
/// Distance in space within which a mover continues a track, metres.
const SAME_M: f64 = 0.6;

#[derive(Clone, Copy, Debug)]
struct Track {
    ray: Vector3<f64>,
    distance_m: f64,
    first_ray: Vector3<f64>,
    first_s: f64,
    last_s: f64,
    hits: u32,
}

/// A nearer mover that is not confirmed yet holds up a confirmed one for at most this long beyond its confirmation, s.
const HOLD_S: f64 = 0.4;

/// Movers over time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Search {
    tracks: Vec<Track>,
}

impl Search {
    pub(crate) fn clear(&mut self) {
        self.tracks.clear();
    }

    /// The nearest mover of this frame that has been seen for `confirm_s`.
    pub(crate) fn confirmed(
        &mut self,
        movers: &[Mover],
        time_s: f64,
        confirm_s: f64,
    ) -> Option<Mover> {
        self.tracks.retain(|t| time_s - t.last_s <= PATIENCE_S);
        let mut chosen: Option<(Mover, f64)> = None;
        let mut nearest_m = f64::INFINITY;
        for mover in movers {
            let known = self
                .tracks
                .iter()
                .position(|t| t.last_s < time_s && continues(t, mover));
            let index = match known {
                Some(index) => index,
                None if self.tracks.len() < MAX_TRACKS => {
                    self.tracks.push(Track {
                        ray: mover.ray,
                        distance_m: mover.distance_m,
                        first_ray: mover.ray,
                        first_s: time_s,
                        last_s: time_s,
                        hits: 0,
                    });
                    self.tracks.len() - 1
                }
                None => continue,
            };
            let track = &mut self.tracks[index];
            track.ray = mover.ray;
            track.distance_m = mover.distance_m;
            track.last_s = time_s;
            track.hits += 1;
            let confirmed = track.hits >= MIN_HITS && time_s - track.first_s >= confirm_s;
            nearest_m = nearest_m.min(mover.distance_m);
            if confirmed && chosen.is_none_or(|(c, _)| mover.distance_m < c.distance_m) {
                let age_s = time_s - track.first_s;
                let velocity = (mover.ray - track.first_ray) * mover.distance_m / age_s.max(0.1);
                chosen = Some((Mover { velocity, ..*mover }, age_s));
            }
        }
        let (mover, age_s) = chosen?;
        let held = nearest_m < 0.9 * mover.distance_m && age_s < confirm_s + HOLD_S;
        (!held).then_some(mover)
    }
}

fn continues(track: &Track, mover: &Mover) -> bool {
    let across = (track.ray - mover.ray).norm() * mover.distance_m;
    let along = (1.0 / track.distance_m - 1.0 / mover.distance_m).abs();
    across < SAME_M && along < 0.05 + 0.25 / mover.distance_m
}
