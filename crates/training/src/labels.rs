//! Labels without people, after BLISS (Ye, Kumar and Doermann 2014): several full-reference measures rank all pictures, their
//! ranks are brought to one, and the result is put on one scale.
//!
//! Each measure ranks the pictures of the training set; a picture's place is the mean of its relative ranks (Borda's count
//! in place of the reciprocal ranks of BLISS). The picture in place k then gets the k-th smallest loss of visual information
//! of the whole set, 100 (1 - VIF): 0 is the pristine picture itself, 100 one that tells nothing of it. So the order is that
//! of all measures, and the scale, per cent of information lost, that of one. Blur, noise and coding become commensurate
//! because every measure ranks them together.

use crate::measures::{MEASURES, Measures};

/// Turns measures into a label by the pictures that it was made from.
#[derive(Clone, Debug)]
pub struct Labels {
    /// Of each measure, the values of all pictures, falling: from best to worst.
    ladders: [Vec<f64>; MEASURES],
    /// Places (rising) and the loss at each.
    places: Vec<f64>,
    losses: Vec<f64>,
}

impl Labels {
    /// The scale of a set of pictures.
    pub fn from_measures(all: &[Measures]) -> Self {
        let ladders: [Vec<f64>; MEASURES] = std::array::from_fn(|k| {
            let mut values: Vec<f64> = all.iter().map(|m| m.all()[k]).collect();
            values.sort_by(|a, b| b.total_cmp(a));
            values
        });
        let mut labels = Self {
            ladders,
            places: Vec::new(),
            losses: Vec::new(),
        };
        labels.places = all.iter().map(|m| labels.place(m)).collect();
        labels.places.sort_by(f64::total_cmp);
        labels.losses = all
            .iter()
            .map(|m| 100.0 * (1.0 - m.vif.clamp(0.0, 1.0)))
            .collect();
        labels.losses.sort_by(f64::total_cmp);
        labels
    }

    /// 0 (best) to 100 (worst).
    pub fn label(&self, measures: &Measures) -> f64 {
        let place = self.place(measures);
        // Pictures of one place share the mean of their losses.
        let from = self.places.partition_point(|&p| p < place);
        let to = self.places.partition_point(|&p| p <= place);
        if to > from {
            return self.losses[from..to].iter().sum::<f64>() / (to - from) as f64;
        }
        match (from.checked_sub(1), self.places.get(from)) {
            (Some(below), Some(&next)) => {
                let (p, l) = (self.places[below], self.losses[below]);
                l + (self.losses[from] - l) * (place - p) / (next - p)
            }
            (None, Some(_)) => self.losses[0],
            (_, None) => self.losses.last().copied().unwrap_or(0.0),
        }
    }

    /// Mean share of the set's pictures that are better, over the measures; equal ones count half.
    fn place(&self, measures: &Measures) -> f64 {
        let shares = self.ladders.iter().zip(measures.all()).map(|(ladder, v)| {
            let better = ladder.partition_point(|&other| other > v);
            let not_worse = ladder.partition_point(|&other| other >= v);
            (better + not_worse) as f64 / 2.0 / ladder.len().max(1) as f64
        });
        shares.sum::<f64>() / MEASURES as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(quality: f64) -> Measures {
        Measures::from_all([quality; MEASURES])
    }

    /// Where all measures agree, the label is the loss itself, also of a picture that was not in the set; and one measure
    /// that disagrees is outvoted.
    #[test]
    fn agreement_gives_the_loss() {
        let set: Vec<Measures> = (0..=20).map(|i| even(1.0 - f64::from(i) / 20.0)).collect();
        let labels = Labels::from_measures(&set);
        for m in &set {
            assert!((labels.label(m) - 100.0 * (1.0 - m.vif)).abs() < 1e-9);
        }
        assert!((labels.label(&Measures::PERFECT)).abs() < 1e-9);
        assert!(labels.label(&even(-1.0)) == 100.0);
        let odd = Measures {
            vif: 0.2,
            ..even(0.8)
        };
        let label = labels.label(&odd);
        assert!((20.0..40.0).contains(&label), "{label}");
    }
}
