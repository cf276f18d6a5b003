//! How two series of numbers agree, and the rising curve that fits one to the other.

/// Correlation of Pearson; NaN where a series does not vary.
pub fn pearson(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        let (x, y) = (x - mean_a, y - mean_b);
        ab += x * y;
        aa += x * x;
        bb += y * y;
    }
    ab / (aa * bb).sqrt()
}

/// Rank correlation of Spearman; equal values share their mean rank.
pub fn spearman(a: &[f64], b: &[f64]) -> f64 {
    pearson(&ranks(a), &ranks(b))
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut from = 0;
    while from < order.len() {
        let same = |&&i: &&usize| values[i] == values[order[from]];
        let to = from + order[from..].iter().take_while(same).count();
        for &i in &order[from..to] {
            ranks[i] = (from + to - 1) as f64 / 2.0;
        }
        from = to;
    }
    ranks
}

/// A curve that never falls, constant beyond its ends.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rising {
    /// Rising abscissae with what the curve is there; linear between.
    points: Vec<(f64, f64)>,
}

impl Rising {
    /// Least squares by pooling neighbours that fall (Ayer et al. 1955).
    pub fn through(mut points: Vec<(f64, f64)>) -> Self {
        points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        // Each pool: sum of values, count, first and last abscissa.
        let mut pools: Vec<(f64, f64, [f64; 2])> = Vec::new();
        for (x, y) in points {
            pools.push((y, 1.0, [x, x]));
            while let [.., before, last] = pools.as_slice()
                && before.0 / before.1 >= last.0 / last.1
            {
                let joined = (
                    before.0 + last.0,
                    before.1 + last.1,
                    [before.2[0], last.2[1]],
                );
                pools.truncate(pools.len() - 2);
                pools.push(joined);
            }
        }
        let ends = pools
            .iter()
            .flat_map(|&(sum, n, [from, to])| [(from, sum / n), (to, sum / n)]);
        let mut points: Vec<(f64, f64)> = ends.collect();
        points.dedup();
        Self { points }
    }

    /// Its value; 0 where nothing was fitted.
    pub fn at(&self, x: f64) -> f64 {
        let next = self.points.partition_point(|p| p.0 < x);
        match (next.checked_sub(1), self.points.get(next)) {
            (Some(before), Some(&(x1, y1))) => {
                let (x0, y0) = self.points[before];
                y0 + (y1 - y0) * (x - x0) / (x1 - x0)
            }
            (None, Some(&(_, y))) => y,
            (_, None) => self.points.last().map_or(0.0, |p| p.1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: what falls is replaced by its mean, the rest stays; constant beyond the ends.
    #[test]
    fn rising_curve_by_hand() {
        let curve = Rising::through(vec![(1.0, 1.0), (3.0, 2.0), (2.0, 4.0), (4.0, 6.0)]);
        for (x, y) in [
            (0.0, 1.0),
            (1.0, 1.0),
            (2.0, 3.0),
            (2.5, 3.0),
            (3.5, 4.5),
            (9.0, 6.0),
        ] {
            assert!((curve.at(x) - y).abs() < 1e-12, "{x}: {}", curve.at(x));
        }
        assert_eq!(Rising::default().at(1.0), 0.0);
    }

    /// By hand: 1 - 6 sum d^2 / (n (n^2 - 1)) without ties; a monotone map changes nothing; ties share ranks.
    #[test]
    fn correlations_by_hand() {
        let (a, b) = ([1.0, 2.0, 3.0, 4.0, 5.0], [2.0, 1.0, 4.0, 3.0, 5.0]);
        assert!((spearman(&a, &b) - 0.8).abs() < 1e-12);
        let cubes = b.map(|v: f64| v.powi(3));
        assert!((spearman(&a, &cubes) - 0.8).abs() < 1e-12);
        assert!((pearson(&a, &a.map(|v| 3.0 - 2.0 * v)) + 1.0).abs() < 1e-12);
        assert_eq!(ranks(&[3.0, 1.0, 3.0]), [1.5, 0.0, 1.5]);
    }
}
