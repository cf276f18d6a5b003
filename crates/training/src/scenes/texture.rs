//! Surfaces: noise whose spectrum falls as a power of frequency, and stripes.

use vergence_fft::Complex32;

use crate::field::{Field, Spectrum, deviation, mean};
use crate::random::Random;

/// Side of a tile, pixels; a power of two, so that it repeats by a mask.
pub(super) const TILE: usize = 512;

/// Periodic noise of mean 0 and deviation 1 whose amplitude spectrum falls as frequency to the power `-slope`,
/// sharpened or dulled in its distribution by `cubes` (0: normal), and drawn out along x by `stretch` (1: the same in
/// all directions).
pub(super) fn noise_tile(slope: f64, cubes: f64, stretch: f64, random: &mut Random) -> Field {
    let white = Field::from_fn(TILE, TILE, |_, _| random.normal() as f32);
    let mut spectrum = Spectrum::from_field(&white);
    for y in 0..TILE {
        let fy = spectrum.frequency_y(y) / stretch;
        for x in 0..TILE {
            let f = (spectrum.frequency_x(x) * stretch).hypot(fy);
            let gain = if f > 0.0 { f.powf(-slope) } else { 0.0 };
            let sample: &mut Complex32 = &mut spectrum.samples[y * TILE + x];
            *sample *= gain as f32;
        }
    }
    let samples = spectrum.inverse().samples.iter().map(|v| v.re).collect();
    let raw = unit(&Field::from_samples(TILE, TILE, samples));
    unit(&raw.map(|v| v + cubes as f32 * v * v * v))
}

fn unit(field: &Field) -> Field {
    let (middle, spread) = (mean(field) as f32, deviation(field).max(1e-9) as f32);
    field.map(|v| (v - middle) / spread)
}

/// How the inside of a leaf looks, in grey levels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub(super) level: f32,
    /// Change of level per pixel along x and y.
    pub(super) slope: [f32; 2],
    /// Which tile, from where, at which scale, and how strong.
    pub(super) tile: usize,
    pub(super) offset: [f32; 2],
    pub(super) zoom: f32,
    pub(super) relief: f32,
    /// Waves per pixel along x and y, and half their height.
    pub(super) wave: [f32; 2],
    pub(super) wave_height: f32,
}

impl Surface {
    /// Level at a pixel; (dx, dy) from the leaf's middle.
    pub(super) fn at(&self, tiles: &[Field], x: f32, y: f32, dx: f32, dy: f32) -> f32 {
        let mut level = self.level + self.slope[0] * dx + self.slope[1] * dy;
        if self.relief != 0.0 {
            let tile = &tiles[self.tile];
            let wrap = |v: f32, o: f32| (v * self.zoom + o) as usize & (TILE - 1);
            level += self.relief * tile.at(wrap(x, self.offset[0]), wrap(y, self.offset[1]));
        }
        if self.wave_height != 0.0 {
            let phase = self.wave[0] * dx + self.wave[1] * dy;
            level += self.wave_height * (std::f32::consts::TAU * phase).sin();
        }
        level
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The spectrum falls as it should: octave by octave, amplitude halves for a slope of one.
    #[test]
    fn spectrum_falls_by_its_slope() {
        let tile = noise_tile(1.0, 0.0, 1.0, &mut Random::new(5, 5));
        let spectrum = Spectrum::from_field(&tile);
        let ring = |lo: f64, hi: f64| {
            let (mut sum, mut n) = (0.0, 0.0);
            for y in 0..TILE {
                for x in 0..TILE {
                    let f = spectrum.frequency_x(x).hypot(spectrum.frequency_y(y));
                    if (lo..hi).contains(&f) {
                        sum += f64::from(spectrum.samples[y * TILE + x].norm());
                        n += 1.0;
                    }
                }
            }
            sum / n
        };
        let ratio = ring(0.05, 0.06) / ring(0.2, 0.24);
        assert!((ratio - 4.0).abs() < 0.3, "{ratio}");
    }
}
