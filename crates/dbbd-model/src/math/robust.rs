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
