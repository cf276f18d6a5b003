//! A pair that needs no file: textured discs at many depths ("dead leaves"), rendered exactly for both eyes.
//!
//! Each disc has a disparity of its own and hides what is behind it, so both pictures are true views of one scene, with occlusion;
//! every disparity and the (zero) vertical disparity are known exactly. Written without the code under test.

use vergence_imaging::Rgb;

/// Discs; lengths in widths of the picture.
pub(crate) struct Leaves {
    discs: Vec<Disc>,
}

struct Disc {
    x: f64,
    y: f64,
    radius: f64,
    disparity: f64,
    colour: [f64; 3],
    phase: [f64; 4],
}

impl Leaves {
    /// Disparities from -2 % to +6 % of the width; the nearer, the further in front.
    pub(crate) fn new(seed: u64) -> Self {
        Self::within(seed, [-0.02, 0.06])
    }

    /// With a range of disparities, widths.
    pub(crate) fn within(seed: u64, [far, near]: [f64; 2]) -> Self {
        let mut state = seed;
        let mut unit = move || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        };
        let count = 500;
        let discs = (0..count)
            .map(|k| Disc {
                // The first ones are large, so that nothing is left bare.
                x: 1.6 * unit() - 0.3,
                y: 1.3 * unit() - 0.25,
                radius: if k < 80 {
                    0.3
                } else {
                    0.02 + 0.08 * unit() * unit()
                },
                disparity: far + (near - far) * f64::from(k) / f64::from(count),
                colour: [unit(), unit(), unit()].map(|v| 50.0 + 150.0 * v),
                phase: [unit(), unit(), unit(), unit()].map(|v| std::f64::consts::TAU * v),
            })
            .collect();
        Self { discs }
    }

    /// Left and right picture.
    pub(crate) fn pair(&self, size: (usize, usize)) -> [Rgb; 2] {
        [0.5, -0.5].map(|eye| self.view(size, eye))
    }

    fn view(&self, (w, h): (usize, usize), eye: f64) -> Rgb {
        let width = w as f64;
        let mut values = vec![[0.0f64; 3]; w * h];
        for disc in &self.discs {
            let centre = disc.x + eye * disc.disparity;
            let rows = |v: f64| ((v * width).max(0.0) as usize).min(h);
            for y in rows(disc.y - disc.radius)..rows(disc.y + disc.radius + 2.0 / width) {
                let dy = (y as f64 + 0.5) / width - disc.y;
                let columns = |v: f64| ((v * width).max(0.0) as usize).min(w);
                for x in columns(centre - disc.radius)..columns(centre + disc.radius + 2.0 / width)
                {
                    let dx = (x as f64 + 0.5) / width - centre;
                    // One pixel of soft edge.
                    let cover = ((disc.radius - dx.hypot(dy)) * width + 0.5).clamp(0.0, 1.0);
                    if cover > 0.0 {
                        let grain = disc.grain(dx, dy);
                        let value = &mut values[y * w + x];
                        for (v, colour) in value.iter_mut().zip(disc.colour) {
                            *v += cover * (colour + grain - *v);
                        }
                    }
                }
            }
        }
        let bytes = values
            .iter()
            .map(|v| v.map(|v| v.round().clamp(0.0, 255.0) as u8));
        Rgb::from_samples(w, h, bytes.collect())
    }
}

impl Disc {
    /// Texture that is fixed to the disc: four waves, the shortest 1 / 80 of the width.
    fn grain(&self, x: f64, y: f64) -> f64 {
        let wave = |k: usize, u: f64, v: f64, length: f64| {
            (std::f64::consts::TAU * (u * x + v * y) / length + self.phase[k]).sin()
        };
        12.0 * wave(0, 1.0, 0.3, 0.05)
            + 12.0 * wave(1, -0.4, 1.0, 0.037)
            + 10.0 * wave(2, 0.8, -0.7, 0.0191)
            + 10.0 * wave(3, 0.5, 0.9, 0.0233)
    }
}
