//! What one can look at after a run: short films of the pair.

use std::path::Path;

use vergence_imaging::avi::Film;
use vergence_imaging::{Plane, Rgb};
use vergence_stereo::compose::{Anaglyph, Composition, Layout};

/// Most pictures of a film; a run that is longer is sampled more thinly as it goes on.
const MOST: usize = 90;

/// Pictures a second of the film.
const FILM_FPS: f64 = 10.0;

/// Widest picture of one eye in a film, pixels.
const WIDEST: usize = 512;

/// Names of the films and of the stills beside them.
pub(crate) const LAYOUTS: [(&str, Layout); 2] = [
    ("sample_side_by_side", Layout::SideBySide),
    ("sample_red_cyan", Layout::Anaglyph(Anaglyph::Dubois)),
];

/// Pairs kept from a run, at most [`MOST`], evenly spread over it.
pub(crate) struct Sample {
    every: u64,
    kept: Vec<(u64, Small)>,
}

/// A pair as shown, reduced to the size of the films.
pub(crate) struct Small {
    pair: [Rgb; 2],
    shift_px: [f64; 2],
}

impl Small {
    /// From a pair as shown with its electronic shift (full-size pixels).
    pub(crate) fn of(pair: [&Rgb; 2], shift_px: [f64; 2]) -> Self {
        let factor = pair[0].width().div_ceil(WIDEST).max(1);
        Self {
            pair: pair.map(|p| shrunk(p, factor)),
            shift_px: shift_px.map(|s| s / factor as f64),
        }
    }

    /// Both pictures in one.
    pub(crate) fn composed(&self, layout: Layout) -> anyhow::Result<Rgb> {
        let composition = Composition {
            layout,
            shift_px: self.shift_px,
        };
        Ok(composition.compose(&self.pair[0], &self.pair[1])?)
    }
}

impl Sample {
    /// A sample of one pair in `every` (at least 1) to begin with.
    pub(crate) fn new(every: u64) -> Self {
        Self {
            every: every.max(1),
            kept: Vec::new(),
        }
    }

    /// Whether pair `index` belongs to the sample.
    pub(crate) fn wants(&self, index: u64) -> bool {
        index.is_multiple_of(self.every)
    }

    /// Keep a pair that is wanted.
    pub(crate) fn keep(&mut self, index: u64, pair: Small) {
        self.kept.push((index, pair));
        if self.kept.len() > MOST {
            // The run is longer than thought: every other one goes, and from now on twice as few come.
            self.every *= 2;
            let every = self.every;
            self.kept.retain(|(index, _)| index.is_multiple_of(every));
        }
    }

    /// Write `sample_side_by_side.avi` and `sample_red_cyan.avi`; nothing when no pair was kept.
    pub(crate) fn write(&self, folder: &Path) -> anyhow::Result<()> {
        for (name, layout) in LAYOUTS {
            let mut film: Option<Film> = None;
            for (_, kept) in &self.kept {
                let picture = kept.composed(layout)?;
                film.get_or_insert_with(|| Film::new(picture.size(), FILM_FPS))
                    .push(&picture)?;
            }
            if let Some(film) = film {
                film.write(&folder.join(format!("{name}.avi")))?;
            }
        }
        Ok(())
    }
}

/// The picture reduced by a whole factor: the mean of each `factor` x `factor` block.
fn shrunk(picture: &Rgb, factor: usize) -> Rgb {
    if factor == 1 {
        return picture.clone();
    }
    let area = (factor * factor) as u32;
    Plane::from_fn(
        picture.width() / factor,
        picture.height() / factor,
        |x, y| {
            let mut sums = [0u32; 3];
            for row in y * factor..(y + 1) * factor {
                for px in &picture.row(row)[x * factor..(x + 1) * factor] {
                    for (sum, &value) in sums.iter_mut().zip(px) {
                        *sum += u32::from(value);
                    }
                }
            }
            sums.map(|s| ((s + area / 2) / area) as u8)
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However long a run is, the sample stays bounded and evenly spread.
    #[test]
    fn the_sample_is_bounded_and_even() {
        let picture = Rgb::filled(8, 4, [9; 3]);
        let mut sample = Sample::new(1);
        for index in 0..1000 {
            if sample.wants(index) {
                sample.keep(index, Small::of([&picture, &picture], [0.0; 2]));
            }
        }
        assert!(sample.kept.len() <= MOST && sample.kept.len() > MOST / 2 - 1);
        let gaps: Vec<u64> = sample.kept.windows(2).map(|w| w[1].0 - w[0].0).collect();
        assert!(gaps.iter().all(|g| *g == gaps[0]), "{gaps:?}");
    }

    /// Shrinking keeps the mean.
    #[test]
    fn shrinking_is_a_mean() {
        let picture = Rgb::from_fn(4, 2, |x, y| [(x * 10 + y * 4) as u8; 3]);
        assert_eq!(shrunk(&picture, 2).at(0, 0), [7; 3]);
        assert_eq!(shrunk(&picture, 2).at(1, 0), [27; 3]);
    }
}
