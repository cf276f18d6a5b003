//! Colours that people with any colour vision can tell apart.

use std::fmt;

/// An opaque sRGB colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Colour(pub(crate) u8, pub(crate) u8, pub(crate) u8);

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#{:02x}{:02x}{:02x}", self.0, self.1, self.2)
    }
}

pub(crate) const INK: Colour = Colour(0x22, 0x22, 0x22);
pub(crate) const GREY: Colour = Colour(0x77, 0x77, 0x77);
pub(crate) const PALE: Colour = Colour(0xe2, 0xe2, 0xe2);
pub(crate) const WHITE: Colour = Colour(0xff, 0xff, 0xff);

// The qualitative colours of Okabe and Ito (2008), told apart under protanopia, deuteranopia and tritanopia.
pub(crate) const BLUE: Colour = Colour(0x00, 0x72, 0xb2);
pub(crate) const VERMILION: Colour = Colour(0xd5, 0x5e, 0x00);
pub(crate) const GREEN: Colour = Colour(0x00, 0x9e, 0x73);
pub(crate) const PURPLE: Colour = Colour(0xcc, 0x79, 0xa7);
pub(crate) const ORANGE: Colour = Colour(0xe6, 0x9f, 0x00);
pub(crate) const SKY: Colour = Colour(0x56, 0xb4, 0xe9);

/// The colours of lines in the order in which they are taken.
pub(crate) const LINES: [Colour; 6] = [BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY];

/// A mix in sRGB: `share` 0 gives `a`, 1 gives `b`; shares outside are clamped.
pub(crate) fn mix(a: Colour, b: Colour, share: f64) -> Colour {
    let t = share.clamp(0.0, 1.0);
    let channel = |x: u8, y: u8| (f64::from(x) * (1.0 - t) + f64::from(y) * t).round() as u8;
    Colour(channel(a.0, b.0), channel(a.1, b.1), channel(a.2, b.2))
}

/// A diverging scale: -1 blue, 0 near white, +1 red-brown; lightness falls evenly to both sides, so it also reads in grey
/// as a magnitude, and blue against orange is told apart with any colour vision.
pub(crate) fn diverging(value: f64) -> Colour {
    const MIDDLE: Colour = Colour(0xf6, 0xf4, 0xf1);
    let arms: [[Colour; 3]; 2] = [
        [
            Colour(0xa6, 0xc9, 0xe3),
            Colour(0x3f, 0x85, 0xbd),
            Colour(0x0b, 0x3c, 0x74),
        ],
        [
            Colour(0xf6, 0xc7, 0x9d),
            Colour(0xdb, 0x76, 0x2b),
            Colour(0x83, 0x31, 0x06),
        ],
    ];
    let arm = arms[usize::from(value > 0.0)];
    let t = value.abs().clamp(0.0, 1.0) * 3.0;
    match t {
        t if t < 1.0 => mix(MIDDLE, arm[0], t),
        t if t < 2.0 => mix(arm[0], arm[1], t - 1.0),
        t => mix(arm[1], arm[2], t - 2.0),
    }
}
