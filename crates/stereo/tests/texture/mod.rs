//! A made texture for pairs whose truth is known.

/// A smooth random texture, by value noise at two sizes.
pub(crate) fn texture(u: f64, v: f64, seed: u32) -> f64 {
    let lattice = |x: i64, y: i64| {
        let mut h =
            (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca6b) ^ seed;
        h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
        h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
        f64::from((h ^ (h >> 15)) & 0xffff) / 65_535.0
    };
    let noise = |u: f64, v: f64| {
        let (x, y) = (u.floor(), v.floor());
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (a, b) = (smooth(u - x), smooth(v - y));
        let (x, y) = (x as i64, y as i64);
        let top = lattice(x, y) * (1.0 - a) + lattice(x + 1, y) * a;
        let bottom = lattice(x, y + 1) * (1.0 - a) + lattice(x + 1, y + 1) * a;
        top * (1.0 - b) + bottom * b
    };
    40.0 + 120.0 * noise(u / 3.0, v / 3.0) + 80.0 * noise(u / 11.0, v / 11.0)
}
