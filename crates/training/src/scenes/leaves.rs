//! Dead leaves: shapes of all sizes that hide each other, their radii distributed as r^-3, which gives pictures the scale
//! invariance of natural scenes (Lee, Mumford and Huang 2001), on layers in and out of focus.

use vergence_imaging::Gray;

use super::texture::{Surface, TILE, noise_tile};
use crate::field::{Field, blurred, combined, deviation, gray_from_field, mean, shrunk};
use crate::random::Random;

/// Drawn this many times larger, then averaged, so that edges are smooth.
const OVERSAMPLING: usize = 2;
/// Sizes of pictures, pixels.
const SIZES: [(usize, usize); 6] = [
    (512, 384),
    (480, 480),
    (560, 416),
    (384, 512),
    (640, 400),
    (600, 440),
];
/// Leaves of one layer at most: a bound on the work.
const MAX_LEAVES: usize = 60_000;

/// How the leaves of a layer are turned: real scenes are seldom the same in all directions.
#[derive(Clone, Copy, Debug)]
enum Turns {
    /// Any way.
    Any,
    /// Sides level and upright, but for so many radians.
    Upright(f64),
    /// Along one direction with a spread, radians.
    Along(f64, f64),
}

impl Turns {
    fn drawn(random: &mut Random) -> Self {
        match random.below(4) {
            0 => Self::Upright(random.log_between(0.003, 0.1)),
            1 => Self::Along(random.between(0.0, 6.3), random.log_between(0.05, 0.6)),
            _ => Self::Any,
        }
    }

    fn angle(self, random: &mut Random) -> f64 {
        match self {
            Self::Any => random.between(0.0, std::f64::consts::TAU),
            Self::Upright(spread) => {
                std::f64::consts::FRAC_PI_2 * random.below(4) as f64 + spread * random.normal()
            }
            Self::Along(direction, spread) => direction + spread * random.normal(),
        }
    }
}

/// What one scene is made of.
#[derive(Clone, Debug)]
struct Recipe {
    /// Smallest and largest radius, drawn pixels.
    radii: [f64; 2],
    /// Exponent of the density of radii.
    exponent: f64,
    /// Share of each shape: disc, ellipse, rectangle, wavy outline, stroke.
    shapes: [f64; 5],
    /// Spread of the leaves' levels, grey levels.
    contrast: f64,
    /// Strength of relief inside leaves, relative to the spread, and the share of leaves that have any.
    relief: [f64; 2],
    /// Share of leaves with a gradient and with stripes.
    shaded: f64,
    striped: f64,
    /// How leaves are turned.
    turns: Turns,
    /// Laid in courses, as bricks are, with these sides in drawn pixels; else anywhere.
    courses: Option<[f64; 2]>,
    /// How often each point is covered on average.
    cover: f64,
}

impl Recipe {
    fn drawn(random: &mut Random, height: f64) -> Self {
        let smallest = random.log_between(1.2, 80.0);
        Self {
            radii: [smallest, height * random.between(0.15, 0.6)],
            exponent: random.between(2.6, 3.3),
            shapes: std::array::from_fn(|_| random.unit().powi(2)),
            contrast: random.log_between(14.0, 60.0),
            relief: [random.log_between(0.1, 1.2), random.unit().powf(0.3)],
            shaded: random.unit(),
            striped: if random.chance(0.4) {
                0.15 * random.unit()
            } else {
                0.0
            },
            turns: Turns::drawn(random),
            courses: None,
            cover: random.between(2.0, 5.0),
        }
    }
}

/// One picture.
pub(super) fn picture(random: &mut Random) -> Gray {
    let (w, h) = SIZES[random.below(SIZES.len())];
    let (big_w, big_h) = (w * OVERSAMPLING, h * OVERSAMPLING);
    let tiles = tiles(random);
    let mut canvas = background(big_w, big_h, &tiles, random);
    let layers = 1 + random.below(3);
    for layer in 0..layers {
        let mut recipe = Recipe::drawn(random, big_h as f64);
        let front = layer + 1 == layers;
        if layer == 0 && random.chance(0.12) {
            recipe.courses = Some([
                random.log_between(24.0, 160.0),
                random.log_between(14.0, 90.0),
            ]);
            recipe.contrast *= 0.5;
        }
        if layer > 0 {
            recipe.cover = random.log_between(0.15, 1.5);
        } else if random.chance(0.35) {
            // Some of the background, a sky or a wall, stays.
            recipe.cover = random.between(0.4, 1.2);
        }
        let drawn = draw(big_w, big_h, &recipe, &tiles, random);
        let defocus = if front || random.chance(0.5) {
            0.0
        } else {
            random.log_between(1.0, 12.0)
        };
        canvas = laid_over(&canvas, drawn, defocus);
    }
    finished(&canvas, &tiles, random)
}

fn tiles(random: &mut Random) -> Vec<Field> {
    (0..3)
        .map(|_| {
            let cubes = if random.chance(0.5) {
                random.between(0.0, 0.4)
            } else {
                0.0
            };
            let stretch = if random.chance(0.4) {
                random.log_between(0.4, 2.5)
            } else {
                1.0
            };
            noise_tile(random.between(0.1, 1.6), cubes, stretch, random)
        })
        .collect()
}

/// A gradient with clouds, in grey levels about 128.
fn background(w: usize, h: usize, tiles: &[Field], random: &mut Random) -> Field {
    let surface = Surface {
        level: random.between(70.0, 200.0) as f32,
        slope: [
            (random.normal() * 25.0 / w as f64) as f32,
            (random.normal() * 60.0 / h as f64) as f32,
        ],
        tile: random.below(tiles.len()),
        offset: [0.0; 2],
        zoom: random.between(0.7, 1.0) as f32,
        relief: random.log_between(0.5, 12.0) as f32,
        wave: [0.0; 2],
        wave_height: 0.0,
    };
    let smooth = random.log_between(1.0, 8.0);
    let field = Field::from_fn(w, h, |x, y| {
        let (x, y) = (x as f32, y as f32);
        surface.at(tiles, x, y, x - w as f32 / 2.0, y - h as f32 / 2.0)
    });
    blurred(&field, smooth)
}

/// Levels and how much of each pixel is covered.
struct Layer {
    levels: Field,
    cover: Field,
}

fn draw(w: usize, h: usize, recipe: &Recipe, tiles: &[Field], random: &mut Random) -> Layer {
    let mut layer = Layer {
        levels: Field::filled(w, h, 0.0),
        cover: Field::filled(w, h, 0.0),
    };
    if let Some(sides) = recipe.courses {
        for leaf in courses(w, h, sides, recipe, tiles.len(), random) {
            leaf.paint(&mut layer, tiles);
        }
        return layer;
    }
    let wanted = recipe.cover * (w * h) as f64;
    let mut covered = 0.0;
    for _ in 0..MAX_LEAVES {
        if covered >= wanted {
            break;
        }
        let leaf = Leaf::drawn(w, h, recipe, tiles.len(), random);
        covered += leaf.paint(&mut layer, tiles) as f64;
    }
    layer
}

/// A wall of bricks with joints between them, every other course shifted by half a brick.
fn courses(
    w: usize,
    h: usize,
    [wide, high]: [f64; 2],
    recipe: &Recipe,
    tiles: usize,
    random: &mut Random,
) -> Vec<Leaf> {
    let radius = 0.5 * wide.max(high);
    let joint = random.between(0.01, 0.12);
    let half = |side: f64| (0.5 * side * (1.0 - joint) / radius) as f32;
    let tilt = 0.05 * random.normal();
    let mut found = Vec::new();
    for row in 0..=(h as f64 / high) as usize {
        for column in 0..=1 + (w as f64 / wide) as usize {
            let shift = if row % 2 == 1 { 0.5 } else { 0.0 };
            found.push(Leaf {
                x: ((column as f64 - shift) * wide) as f32,
                y: ((row as f64 + 0.5) * high) as f32,
                radius: radius as f32,
                cos: f64::cos(tilt) as f32,
                sin: f64::sin(tilt) as f32,
                shape: Shape::Rectangle([half(wide), half(high)]),
                surface: surface(recipe, radius, tiles, random),
            });
        }
    }
    found
}

#[derive(Clone, Copy, Debug)]
enum Shape {
    /// Half axes in units of the radius.
    Ellipse([f32; 2]),
    Rectangle([f32; 2]),
    /// Waves about the outline, their height and phase.
    Wavy {
        waves: f32,
        height: f32,
        phase: f32,
    },
}

struct Leaf {
    x: f32,
    y: f32,
    radius: f32,
    cos: f32,
    sin: f32,
    shape: Shape,
    surface: Surface,
}

impl Leaf {
    fn drawn(w: usize, h: usize, recipe: &Recipe, tiles: usize, random: &mut Random) -> Self {
        let radius = power_law(recipe.radii, recipe.exponent, random.unit()) as f32;
        let reach = f64::from(radius) * 0.7;
        let angle = recipe.turns.angle(random);
        Self {
            x: random.between(-reach, w as f64 + reach) as f32,
            y: random.between(-reach, h as f64 + reach) as f32,
            radius,
            cos: angle.cos() as f32,
            sin: angle.sin() as f32,
            shape: shape(&recipe.shapes, random),
            surface: surface(recipe, f64::from(radius), tiles, random),
        }
    }

    /// Paints over what is there; pixels painted.
    fn paint(&self, layer: &mut Layer, tiles: &[Field]) -> usize {
        let (w, h) = layer.levels.size();
        let reach = self.radius * 1.5;
        let range = |middle: f32, n: usize| {
            let from = (middle - reach).floor().max(0.0) as usize;
            let to = (middle + reach).ceil().max(0.0) as usize;
            from..to.min(n)
        };
        let mut painted = 0;
        for y in range(self.y, h) {
            let dy = y as f32 - self.y;
            let levels = layer.levels.row_mut(y);
            let cover = layer.cover.row_mut(y);
            for x in range(self.x, w) {
                let dx = x as f32 - self.x;
                if self.covers(dx, dy) {
                    levels[x] = self.surface.at(tiles, x as f32, y as f32, dx, dy);
                    cover[x] = 1.0;
                    painted += 1;
                }
            }
        }
        painted
    }

    fn covers(&self, dx: f32, dy: f32) -> bool {
        let u = (self.cos * dx + self.sin * dy) / self.radius;
        let v = (self.cos * dy - self.sin * dx) / self.radius;
        match self.shape {
            Shape::Ellipse([a, b]) => (u / a).powi(2) + (v / b).powi(2) <= 1.0,
            Shape::Rectangle([a, b]) => u.abs() <= a && v.abs() <= b,
            Shape::Wavy {
                waves,
                height,
                phase,
            } => {
                let square = u * u + v * v;
                square <= 2.25 && {
                    let outline = 1.0 + height * (waves * v.atan2(u) + phase).sin();
                    square <= outline * outline
                }
            }
        }
    }
}

/// A draw from the density proportional to r^-exponent between two radii, by the inverse of its distribution.
fn power_law([lo, hi]: [f64; 2], exponent: f64, u: f64) -> f64 {
    let k = 1.0 - exponent;
    (lo.powf(k) + u * (hi.powf(k) - lo.powf(k))).powf(1.0 / k)
}

fn shape(shares: &[f64; 5], random: &mut Random) -> Shape {
    let mut pick = random.unit() * shares.iter().sum::<f64>();
    let index = shares
        .iter()
        .position(|share| {
            pick -= share;
            pick <= 0.0
        })
        .unwrap_or(0);
    match index {
        0 => Shape::Ellipse([1.0, 1.0]),
        1 => Shape::Ellipse([1.2, random.between(0.3, 0.9) as f32]),
        2 => Shape::Rectangle([
            random.between(0.5, 1.0) as f32,
            random.between(0.2, 0.9) as f32,
        ]),
        3 => Shape::Wavy {
            waves: (2 + random.below(7)) as f32,
            height: random.between(0.05, 0.45) as f32,
            phase: random.between(0.0, 6.3) as f32,
        },
        _ => Shape::Rectangle([1.5, random.log_between(0.02, 0.15) as f32]),
    }
}

fn surface(recipe: &Recipe, radius: f64, tiles: usize, random: &mut Random) -> Surface {
    let spread = recipe.contrast;
    let shaded = random.chance(recipe.shaded);
    let relief = if random.chance(recipe.relief[1]) {
        recipe.relief[0] * spread * random.log_between(0.3, 1.5)
    } else {
        0.0
    };
    let (frequency, angle) = (random.log_between(0.01, 0.2), random.between(0.0, 6.3));
    let gradient = |random: &mut Random| {
        if shaded {
            (random.normal() * 0.5 * spread / radius) as f32
        } else {
            0.0
        }
    };
    Surface {
        level: (128.0 + spread * random.normal()) as f32,
        slope: [gradient(random), gradient(random)],
        tile: random.below(tiles),
        offset: std::array::from_fn(|_| random.below(TILE) as f32),
        zoom: random.log_between(0.7, 2.0) as f32,
        relief: relief as f32,
        wave: [
            (frequency * angle.cos()) as f32,
            (frequency * angle.sin()) as f32,
        ],
        wave_height: if random.chance(recipe.striped) {
            (spread * random.between(0.1, 0.8)) as f32
        } else {
            0.0
        },
    }
}

/// A layer, out of focus by `defocus` drawn pixels, in front of what stands behind it.
fn laid_over(behind: &Field, layer: Layer, defocus: f64) -> Field {
    let Layer { levels, cover } = layer;
    let mut weighted = combined(&levels, &cover, |l, c| l * c);
    let mut cover = cover;
    if defocus > 0.0 {
        weighted = blurred(&weighted, defocus);
        cover = blurred(&cover, defocus);
    }
    let shown = combined(behind, &cover, |b, c| b * (1.0 - c));
    combined(&shown, &weighted, |b, l| b + l)
}

/// With a fine structure over everything, as light and weather leave it.
fn textured(canvas: &Field, tiles: &[Field], random: &mut Random) -> Field {
    let tile = &tiles[random.below(tiles.len())];
    let strength = (random.log_between(0.015, 0.3) * deviation(canvas)) as f32;
    let (w, h) = canvas.size();
    Field::from_fn(w, h, |x, y| {
        canvas.at(x, y) + strength * tile.at(x & (TILE - 1), y & (TILE - 1))
    })
}

/// Through the lens and onto 8 bits: a little blur, light that varies over the picture, exposure, grain.
fn finished(canvas: &Field, tiles: &[Field], random: &mut Random) -> Gray {
    let softened = blurred(&textured(canvas, tiles, random), random.between(0.1, 0.9));
    let small = shrunk(&softened, OVERSAMPLING);
    let (w, h) = small.size();
    let (middle, spread) = (mean(&small) as f32, deviation(&small).max(1.0));
    let gain = (random.between(22.0, 65.0) / spread) as f32;
    let level = random.between(80.0, 160.0) as f32;
    let fall: [f32; 2] = std::array::from_fn(|_| (0.25 * random.normal()) as f32);
    let grain = if random.chance(0.6) {
        random.between(0.0, 1.5)
    } else {
        0.0
    };
    let mut out = Field::from_fn(w, h, |x, y| {
        let u = x as f32 / w as f32 - 0.5;
        let v = y as f32 / h as f32 - 0.5;
        let light = (1.0 + fall[0] * u + fall[1] * v).max(0.3);
        light * (level + gain * (small.at(x, y) - middle))
    });
    for v in out.samples_mut() {
        *v += (grain * random.normal()) as f32;
    }
    gray_from_field(&out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Radii stay in their range, and their median is that of the law: for exponent 3, m^-2 is the mean of the ends'.
    #[test]
    fn radii_follow_the_power_law() {
        let radii = [2.0, 100.0];
        assert!((power_law(radii, 3.0, 0.0) - 2.0).abs() < 1e-9);
        assert!((power_law(radii, 3.0, 1.0) - 100.0).abs() < 1e-6);
        let median: f64 = power_law(radii, 3.0, 0.5);
        assert!((median.powi(-2) - (2f64.powi(-2) + 1e-4) / 2.0).abs() < 1e-9);
    }

    /// A seed gives one picture, another seed another; all have contrast.
    #[test]
    fn pictures_repeat_and_vary() {
        let one = picture(&mut Random::new(1, 0));
        assert_eq!(one, picture(&mut Random::new(1, 0)));
        let other = picture(&mut Random::new(1, 1));
        assert_ne!(one, other);
        assert!(deviation(&one.map(f32::from)) > 10.0);
    }
}
