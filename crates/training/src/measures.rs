//! Full-reference measures: how much of a pristine picture is left in a distorted one.
//!
//! Each is written from its publication for grey pictures of 8 bits; an identical picture scores [`Measures::PERFECT`].

mod fsim;
mod gmsd;
mod ssim;
mod vif;

use vergence_imaging::Gray;

use crate::field::{Field, field_from_gray};

/// Number of measures.
pub const MEASURES: usize = 5;

/// What they are called, in the order of [`Measures::all`].
pub const NAMES: [&str; MEASURES] = ["MS-SSIM", "IW-SSIM", "VIF", "FSIM", "GMSD"];

/// All measures of one distorted picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measures {
    /// Multi-scale structural similarity; 1 is perfect.
    pub ms_ssim: f64,
    /// The same, pooled by local information; 1 is perfect.
    pub iw_ssim: f64,
    /// Visual information fidelity in the pixel domain; 1 is perfect, sharpening exceeds it.
    pub vif: f64,
    /// Feature similarity; 1 is perfect.
    pub fsim: f64,
    /// Gradient magnitude similarity deviation; 0 is perfect.
    pub gmsd: f64,
}

impl Measures {
    /// Of a picture beside itself.
    pub const PERFECT: Self = Self {
        ms_ssim: 1.0,
        iw_ssim: 1.0,
        vif: 1.0,
        fsim: 1.0,
        gmsd: 0.0,
    };

    /// All of them so that more is better.
    pub fn all(&self) -> [f64; MEASURES] {
        [
            self.ms_ssim,
            self.iw_ssim,
            self.vif,
            self.fsim,
            1.0 - self.gmsd,
        ]
    }

    /// The reverse of [`Self::all`].
    pub fn from_all(all: [f64; MEASURES]) -> Self {
        let [ms_ssim, iw_ssim, vif, fsim, gms] = all;
        Self {
            ms_ssim,
            iw_ssim,
            vif,
            fsim,
            gmsd: 1.0 - gms,
        }
    }
}

/// A pristine picture, ready to be compared.
#[derive(Clone, Debug)]
pub struct Reference {
    picture: Gray,
    field: Field,
    features: fsim::Features,
}

impl Reference {
    /// Of a picture of at least 176 pixels on each side (five scales of windows of 11 pixels).
    ///
    /// # Panics
    /// When a side is smaller.
    pub fn new(pristine: &Gray) -> Self {
        assert!(
            pristine.width().min(pristine.height()) >= 176,
            "pictures of at least 176 x 176 pixels"
        );
        let field = field_from_gray(pristine);
        Self {
            picture: pristine.clone(),
            features: fsim::Features::new(&field),
            field,
        }
    }

    /// The measures of a distorted version of it.
    ///
    /// # Panics
    /// When its size differs.
    pub fn measures(&self, distorted: &Gray) -> Measures {
        assert_eq!(
            self.picture.size(),
            distorted.size(),
            "pictures of one size"
        );
        if self.picture == *distorted {
            return Measures::PERFECT;
        }
        self.computed(&field_from_gray(distorted))
    }

    fn computed(&self, distorted: &Field) -> Measures {
        let similarity = ssim::over_scales(&self.field, distorted);
        Measures {
            ms_ssim: similarity.plain,
            iw_ssim: similarity.weighted,
            vif: vif::vif(&self.field, distorted),
            fsim: self.features.fsim(distorted),
            gmsd: gmsd::gmsd(&self.field, distorted),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distort::{Step, distorted};
    use crate::random::Random;

    fn picture() -> Gray {
        Gray::from_fn(192, 180, |x, y| {
            let disc = (x as f64 - 80.0).hypot(y as f64 - 75.0) < 50.0;
            let texture = ((x * 7 + y * 13) % 31) as f64;
            (60.0 + if disc { 90.0 } else { 0.3 * x as f64 } + texture) as u8
        })
    }

    /// All measures fall along ladders of strength and are perfect for the picture itself, also when computed in full.
    #[test]
    fn measures_fall_with_strength() {
        let pristine = picture();
        let ladders: [[Step; 3]; 3] = [
            [Step::Blur(0.7), Step::Blur(1.5), Step::Blur(3.0)],
            [Step::Noise(4.0), Step::Noise(12.0), Step::Noise(35.0)],
            [Step::Jpeg(85), Step::Jpeg(30), Step::Jpeg(5)],
        ];
        let reference = Reference::new(&pristine);
        assert_eq!(reference.measures(&pristine), Measures::PERFECT);
        for v in reference.computed(&reference.field).all() {
            assert!((v - 1.0).abs() < 1e-5, "{v}");
        }
        for ladder in ladders {
            let mut last = Measures::PERFECT.all();
            for step in ladder {
                let spoiled = distorted(&pristine, &[step], &mut Random::new(1, 2)).unwrap();
                let now = reference.measures(&spoiled).all();
                for (name, (now, last)) in NAMES.iter().zip(now.iter().zip(last)) {
                    assert!(*now < last, "{name} {now} after {last} at {step:?}");
                }
                last = now;
            }
        }
    }
}
