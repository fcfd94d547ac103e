//! Order statistics that one bad value does not move.

/// Ratio of a normal distribution's standard deviation to its median absolute deviation.
pub const SIGMA_OF_MAD: f64 = 1.482_602_218_505_602;

/// The (upper) median; reorders `values`. `None` of nothing.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Mean of what is left after a tenth is cut at either end; reorders `values`. `None` of nothing.
pub fn trimmed_mean(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let cut = values.len() / 10;
    let kept = values.get(cut..values.len() - cut)?;
    (!kept.is_empty()).then(|| kept.iter().sum::<f64>() / kept.len() as f64)
}

/// Median of the slopes of all pairs of points (Theil and Sen).
pub fn slope(points: &[(f64, f64)], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    for (at, (x1, y1)) in points.iter().enumerate() {
        scratch
            .extend(points[at + 1..].iter().filter(|(x2, _)| x2 > x1).map(|(x2, y2)| (y2 - y1) / (x2 - x1)));
    }
    median(scratch).unwrap_or(0.0)
}

/// Scale (one standard deviation of a normal distribution) of the bulk of the magnitudes, when an
/// unknown part of them belongs to something larger: the median of those within 1.5 scales,
/// repeated until it no longer changes. Sorts `magnitudes`.
pub fn bulk_scale(magnitudes: &mut [f64]) -> f64 {
    /// Median of a normal distribution's magnitude, cut at 1.5 standard deviations.
    const CUT: f64 = 1.5;
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
