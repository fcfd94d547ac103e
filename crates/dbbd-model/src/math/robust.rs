//! Robust estimates of location, scale and slope.

/// Ratio of a normal distribution's standard deviation to its median absolute deviation.
pub const SIGMA_OF_MAD: f64 = 1.482_602_218_505_602;

/// The (upper) median; reorders `values`. `None` if there are none.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The mean without the smallest and the largest tenth; reorders `values`. `None` if there are none.
pub fn trimmed_mean(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let cut = values.len() / 10;
    let kept = values.get(cut..values.len() - cut)?;
    (!kept.is_empty()).then(|| kept.iter().sum::<f64>() / kept.len() as f64)
}

/// The Theil-Sen slope of points `(x, y)`: the median of the slopes of all pairs.
pub fn slope(points: &[(f64, f64)], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    for (at, (x1, y1)) in points.iter().enumerate() {
        scratch
            .extend(points[at + 1..].iter().filter(|(x2, _)| x2 > x1).map(|(x2, y2)| (y2 - y1) / (x2 - x1)));
    }
    median(scratch).unwrap_or(0.0)
}

/// Standard deviation of the normal part of some magnitudes, of which an unknown fraction is larger: the median of those
/// within 1.5 standard deviations, iterated until it no longer changes. Sorts `magnitudes`.
pub fn bulk_scale(magnitudes: &mut [f64]) -> f64 {
    const CUT: f64 = 1.5;
    /// Median magnitude of a standard normal distribution truncated at `CUT`.
    const MEDIAN_WITHIN_CUT: f64 = 0.5726;
    magnitudes.sort_unstable_by(f64::total_cmp);
    let mut within = magnitudes.len();
    let mut scale = 0.0;
    for _ in 0..200 {
        scale = magnitudes.get(within / 2).map_or(0.0, |median| median / MEDIAN_WITHIN_CUT);
        let next = magnitudes.partition_point(|&magnitude| magnitude <= CUT * scale);
        if next == within || next == 0 {
            break;
        }
        within = next;
    }
    scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_upper_median_and_the_trimmed_mean() {
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median(&mut [5.0, -1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut []), None);
        // 0 and 1000 are cut: the mean of 1..=8 is 4.5.
        let mut values = [1000.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 0.0];
        assert_eq!(trimmed_mean(&mut values), Some(4.5));
        assert_eq!(trimmed_mean(&mut [1.0, 4.0]), Some(2.5));
        assert_eq!(trimmed_mean(&mut []), None);
    }

    #[test]
    fn the_slope_is_not_changed_by_an_outlier() {
        let mut points: Vec<(f64, f64)> = (0..9).map(|x| (f64::from(x), 1.0 - 2.5 * f64::from(x))).collect();
        points[4].1 = 100.0;
        assert_eq!(slope(&points, &mut Vec::new()), -2.5);
        // Points at one x have no slope.
        assert_eq!(slope(&[(1.0, 0.0), (1.0, 5.0), (2.0, 3.0)], &mut Vec::new()), 3.0);
        assert_eq!(slope(&[(1.0, 0.0), (1.0, 5.0)], &mut Vec::new()), 0.0);
    }

    /// All of a uniform distribution is within 1.5 standard deviations: only the median counts.
    #[test]
    fn bulk_scale_ignores_a_sixth_of_outliers() {
        let mut magnitudes: Vec<f64> = (0..1000).map(|at| f64::from(at) * 1e-3).collect();
        magnitudes.extend([500.0; 200]);
        assert!((bulk_scale(&mut magnitudes) - 0.5 / 0.5726).abs() < 1e-12);
        assert_eq!(bulk_scale(&mut []), 0.0);
    }

    /// Half of a normal distribution is within its median absolute deviation.
    #[test]
    fn median_absolute_deviation_of_a_normal_distribution() {
        let tail = crate::math::distributions::chi_square_tail(SIGMA_OF_MAD.powi(-2), 1.0);
        assert!((tail - 0.5).abs() < 1e-14, "{tail}");
    }
}
