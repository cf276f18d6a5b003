//! The empty scene of a camera that stands still.

use vergence_imaging::Gray;

use crate::view::PixelBox;

/// Pictures from whose median the empty scene is first made; a person may cover a place in less than half of them.
const SNAPSHOTS: usize = 15;
/// Snapshots from which it can be used.
const ENOUGH: usize = 5;
/// Time between them, s.
const INTERVAL_S: f64 = 0.25;
/// How fast it follows the light and what was put down, grey levels per second (sigma-delta, Manzanera 2004).
const FOLLOW_LEVELS_S: f64 = 2.0;

/// Background picture of one level, learned while watching.
#[derive(Clone, Debug, Default)]
pub(crate) struct Background {
    snapshots: Vec<Gray>,
    picture: Option<Gray>,
    last_snapshot_s: f64,
    last_step_s: f64,
}

impl Background {
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    /// The empty scene, when enough was seen.
    pub(crate) fn picture(&self) -> Option<&Gray> {
        self.picture.as_ref()
    }

    /// Learn from a picture; inside `protect` (pixels of this picture) a finished background does not change.
    pub(crate) fn learn(&mut self, picture: &Gray, time_s: f64, protect: Option<&PixelBox>) {
        if self
            .snapshots
            .first()
            .is_some_and(|s| s.size() != picture.size())
        {
            self.clear();
        }
        let due = self.snapshots.is_empty() || time_s - self.last_snapshot_s >= INTERVAL_S;
        if self.snapshots.len() < SNAPSHOTS {
            if due {
                self.snapshots.push(picture.clone());
                self.last_snapshot_s = time_s;
                self.last_step_s = time_s;
                if self.snapshots.len() >= ENOUGH {
                    self.picture = Some(median_picture(&self.snapshots));
                }
            }
            return;
        }
        let steps = ((time_s - self.last_step_s) * FOLLOW_LEVELS_S).floor();
        if steps >= 1.0 {
            self.last_step_s += steps / FOLLOW_LEVELS_S;
            self.follow(picture, steps.min(8.0) as u8, protect);
        }
    }

    fn follow(&mut self, picture: &Gray, most: u8, protect: Option<&PixelBox>) {
        let Some(background) = &mut self.picture else {
            return;
        };
        for y in 0..picture.height() {
            let row = background.row_mut(y);
            for (x, (b, &p)) in row.iter_mut().zip(picture.row(y)).enumerate() {
                let inside = protect.is_some_and(|r| {
                    let (x, y) = (x as f64, y as f64);
                    x >= r.x && x <= r.x + r.w && y >= r.y && y <= r.y + r.h
                });
                if !inside {
                    *b = if p > *b {
                        b.saturating_add(most.min(p - *b))
                    } else {
                        b.saturating_sub(most.min(*b - p))
                    };
                }
            }
        }
    }
}

fn median_picture(snapshots: &[Gray]) -> Gray {
    let (w, h) = snapshots[0].size();
    let mut values = [0_u8; SNAPSHOTS];
    let n = snapshots.len();
    Gray::from_fn(w, h, |x, y| {
        for (v, s) in values.iter_mut().zip(snapshots) {
            *v = s.at(x, y);
        }
        *values[..n].select_nth_unstable(n / 2).1
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square that never stays in one place for half of the time leaves no trace in the background.
    #[test]
    fn what_passes_is_not_background() {
        let empty = |x: usize, y: usize| (40 + (x * 7 + y * 3) % 50) as u8;
        let mut background = Background::default();
        for i in 0..12 {
            let picture = Gray::from_fn(64, 32, |x, y| {
                if x / 5 == i && y > 8 {
                    200
                } else {
                    empty(x, y)
                }
            });
            background.learn(&picture, i as f64 * 0.3, None);
        }
        assert_eq!(*background.picture().unwrap(), Gray::from_fn(64, 32, empty));
    }
}
