//! Whether a camera shows anything: where noise makes every picture another one, the same again and again is none, and black ones show nothing.

use vergence_imaging::Rgb;

/// Mean level below which a picture is dark, of 255: what a covered lens gives with its noise.
const DARK: f64 = 6.0;

/// So many dark pictures in a row before it is told, and as many light ones.
const DARK_FOR: u32 = 5;

/// Every so many-th pixel is looked at, an odd number so that all columns come in turn.
const EVERY: usize = 61;

/// What changed with a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Seen {
    /// The picture is one of a frozen stream.
    pub(crate) frozen: bool,
    /// It became frozen (`true`) or moves again (`false`).
    pub(crate) froze: Option<bool>,
    /// It became dark (`true`) or light (`false`).
    pub(crate) darkened: Option<bool>,
}

/// Looks at one camera's pictures.
#[derive(Clone, Debug)]
pub(crate) struct Look {
    frozen_after: u32,
    print: Option<u64>,
    same: u32,
    frozen: bool,
    dark: bool,
    other: u32,
}

impl Look {
    /// After a picture came again so many times the stream is frozen; 0 never asks.
    pub(crate) fn new(frozen_after: u32) -> Self {
        Self {
            frozen_after,
            print: None,
            same: 0,
            frozen: false,
            dark: false,
            other: 0,
        }
    }

    /// Look at a picture with its fingerprint.
    pub(crate) fn take(&mut self, print: u64, picture: &Rgb) -> Seen {
        self.same = if self.print.replace(print) == Some(print) {
            self.same.saturating_add(1)
        } else {
            0
        };
        let frozen = self.frozen_after > 0 && self.same >= self.frozen_after;
        let froze = (frozen != self.frozen).then_some(frozen);
        self.frozen = frozen;
        let dark = mean(picture) < DARK;
        self.other = if dark == self.dark { 0 } else { self.other + 1 };
        let darkened = (self.other >= DARK_FOR).then_some(dark);
        if darkened.is_some() {
            self.dark = dark;
            self.other = 0;
        }
        Seen {
            frozen,
            froze,
            darkened,
        }
    }
}

fn mean(picture: &Rgb) -> f64 {
    let (mut sum, mut count) = (0_u64, 0_u64);
    for px in picture.samples().iter().step_by(EVERY) {
        sum += px.iter().map(|&v| u64::from(v)).sum::<u64>();
        count += 3;
    }
    sum as f64 / count.max(1) as f64
}

/// A number that is another one for other bytes, as good as certainly. Words are mixed by multiplication in four lanes, so that they need not wait for
/// one another; nobody who wants to deceive chooses these bytes.
pub(crate) fn fingerprint(bytes: &[u8]) -> u64 {
    const ODD: u64 = 0x9e37_79b9_7f4a_7c15;
    let mut lanes = [1_u64, 2, 3, 4];
    let (blocks, rest) = bytes.as_chunks::<32>();
    for block in blocks {
        let (words, _) = block.as_chunks::<8>();
        for (lane, word) in lanes.iter_mut().zip(words) {
            *lane = (*lane ^ u64::from_le_bytes(*word))
                .wrapping_mul(ODD)
                .rotate_left(29);
        }
    }
    let mut all = bytes.len() as u64;
    for lane in lanes {
        all = (all ^ lane).wrapping_mul(ODD).rotate_left(31);
    }
    for &byte in rest {
        all = (all ^ u64::from(byte)).wrapping_mul(ODD).rotate_left(31);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every single bit of a buffer counts, wherever it lies.
    #[test]
    fn every_bit_counts() {
        let mut bytes: Vec<u8> = (0..103_u8).collect();
        let print = fingerprint(&bytes);
        for bit in 0..8 * bytes.len() {
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_ne!(fingerprint(&bytes), print, "bit {bit}");
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        assert_eq!(fingerprint(&bytes), print);
        assert_ne!(fingerprint(&bytes[..102]), print);
    }

    /// Frozen after the agreed count and not before, told once; moving again told once.
    #[test]
    fn frozen_streams() {
        let picture = Rgb::filled(64, 48, [90; 3]);
        let mut look = Look::new(3);
        let told: Vec<Seen> = [7, 7, 7, 7, 7, 8, 8]
            .map(|print| look.take(print, &picture))
            .to_vec();
        let frozen: Vec<bool> = told.iter().map(|s| s.frozen).collect();
        assert_eq!(frozen, [false, false, false, true, true, false, false]);
        let changes: Vec<Option<bool>> = told.iter().map(|s| s.froze).collect();
        assert_eq!(
            changes,
            [None, None, None, Some(true), None, Some(false), None]
        );
        let mut never = Look::new(0);
        assert!((0..100).all(|_| !never.take(1, &picture).frozen));
    }

    /// Dark after five dark pictures, light after five light ones; single ones between them change nothing.
    #[test]
    fn dark_streams() {
        let (dark, light) = (Rgb::filled(64, 48, [2; 3]), Rgb::filled(64, 48, [80; 3]));
        let mut look = Look::new(0);
        let mut told = Vec::new();
        for (k, is_dark) in [
            (0, true),
            (4, true),
            (1, false),
            (5, true),
            (9, true),
            (4, false),
            (1, true),
            (5, false),
        ]
        .into_iter()
        .flat_map(|(count, is_dark)| std::iter::repeat_n(is_dark, count))
        .enumerate()
        {
            let seen = look.take(k as u64, if is_dark { &dark } else { &light });
            told.extend(seen.darkened);
        }
        assert_eq!(told, [true, false]);
    }
}
