//! What surfaces are made of: a pattern run through three colours.

use crate::texture::{PATTERNS, Pattern, Texture, texture_of};

/// How a surface looks.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Which texture.
    pub pattern: Pattern,
    /// Size of one tile of it, m.
    pub tile_m: [f32; 2],
    /// Linear RGB reflectance (0 to 1) where the pattern is 0, 1/2 and 1.
    pub colours: [[f32; 3]; 3],
    /// Light that it gives off, as a multiple of its colour under full daylight; 0 for nearly everything.
    pub glow: f32,
}

impl Material {
    /// A pattern from one sRGB colour to another; the middle is half way between them.
    pub(crate) fn two(pattern: Pattern, tile_m: f32, dark: u32, bright: u32) -> Self {
        let (a, b) = (linear(dark), linear(bright));
        let mid = std::array::from_fn(|c| (a[c] + b[c]) / 2.0);
        Self {
            pattern,
            tile_m: [tile_m; 2],
            colours: [a, mid, b],
            glow: 0.0,
        }
    }

    /// A pattern through three sRGB colours.
    pub(crate) fn three(pattern: Pattern, tile_m: f32, colours: [u32; 3]) -> Self {
        Self {
            pattern,
            tile_m: [tile_m; 2],
            colours: colours.map(linear),
            glow: 0.0,
        }
    }

    /// Linear RGB reflectance at a value of the pattern, 0 to 1. The plain form of the renderer's kernel.
    pub fn colour(&self, value: f32) -> [f32; 3] {
        let low = (2.0 * value).clamp(0.0, 1.0);
        let high = (2.0 * value - 1.0).clamp(0.0, 1.0);
        let c = &self.colours;
        std::array::from_fn(|i| c[0][i] + low * (c[1][i] - c[0][i]) + high * (c[2][i] - c[1][i]))
    }
}

/// Linear RGB of an sRGB colour 0xRRGGBB (IEC 61966-2-1).
pub(crate) fn linear(srgb: u32) -> [f32; 3] {
    [16, 8, 0].map(|shift| {
        let v = (srgb >> shift & 255) as f32 / 255.0;
        if v <= 0.04045 {
            v / 12.92
        } else {
            ((v + 0.055) / 1.055).powf(2.4)
        }
    })
}

/// All materials of a world.
#[derive(Clone, Debug, Default)]
pub struct Palette {
    /// Materials by index.
    pub materials: Vec<Material>,
}

impl Palette {
    /// Adds a material; its index.
    pub(crate) fn add(&mut self, material: Material) -> u16 {
        self.materials.push(material);
        (self.materials.len() - 1) as u16
    }
}

/// A texture for every pattern.
#[derive(Clone, Debug)]
pub(crate) struct Textures(Vec<Texture>);

impl Textures {
    /// The textures of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        use rayon::prelude::*;
        Self(PATTERNS.par_iter().map(|&p| texture_of(p, seed)).collect())
    }

    /// The texture of a pattern.
    pub(crate) fn of(&self, pattern: Pattern) -> &Texture {
        &self.0[pattern as usize]
    }
}
