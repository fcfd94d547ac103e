//! A quantity that was determined several times: its change and its trend.

use serde::Serialize;

use super::ResultTimeline;
use crate::math::distributions::two_sided_tail;
use crate::math::straight_line::{StraightLine, WeightedPoint};

/// Probability of a false significant change in a family of quantities.
pub const SIGNIFICANCE_LEVEL: f64 = 0.01;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrackedValue {
    pub value: f64,
    pub sd: f64,
    /// Degrees of freedom of an estimated standard deviation.
    #[serde(skip)]
    pub freedom: Option<f64>,
}

/// The values of a quantity in the order of time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrackedQuantity<N> {
    pub name: N,
    /// Of values, changes and standard deviations.
    pub unit: &'static str,
    pub values: Vec<TrackedValue>,
    /// From the first to the last.
    pub change: TrackedChange,
    /// `None` for fewer than three values or equal times.
    pub trend: Option<QuantityTrend>,
}

/// A difference and its significance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrackedChange {
    pub change: f64,
    pub sd: f64,
    /// p-value of this quantity alone.
    pub p: f64,
    /// Adjusted for the family (Holm).
    pub p_holm: f64,
    pub significant: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct QuantityTrend {
    #[serde(flatten)]
    pub line: StraightLine,
    pub p_holm: f64,
    pub significant: bool,
}

pub(super) struct ValueSeries<N> {
    pub(super) name: N,
    pub(super) unit: &'static str,
    pub(super) values: Vec<TrackedValue>,
}

/// Tests the changes and trends of one family.
pub(super) fn track<N>(family: Vec<ValueSeries<N>>, timeline: &ResultTimeline) -> Vec<TrackedQuantity<N>> {
    let mut changes: Vec<TrackedChange> = family.iter().map(|series| change(&series.values)).collect();
    let adjusted = holm(&changes.iter().map(|change| change.p).collect::<Vec<f64>>());
    for (change, p_holm) in changes.iter_mut().zip(adjusted) {
        (change.p_holm, change.significant) = (p_holm, p_holm < SIGNIFICANCE_LEVEL);
    }
    let line = |series: &ValueSeries<N>| {
        timeline.has_trend().then(|| StraightLine::through(&sightings(&series.values, timeline))).flatten()
    };
    let lines: Vec<Option<StraightLine>> = family.iter().map(line).collect();
    let p = |line: &Option<StraightLine>| {
        line.map_or(1.0, |line| two_sided_tail(line.slope / line.slope_sd, None))
    };
    let slopes = holm(&lines.iter().map(p).collect::<Vec<f64>>());
    let trend = |(line, p_holm): (Option<StraightLine>, f64)| {
        line.map(|line| QuantityTrend { line, p_holm, significant: p_holm < SIGNIFICANCE_LEVEL })
    };
    let trends = lines.into_iter().zip(slopes).map(trend);
    let both = family.into_iter().zip(changes).zip(trends);
    both.map(|((ValueSeries { name, unit, values }, change), trend)| TrackedQuantity {
        name,
        unit,
        values,
        change,
        trend,
    })
    .collect()
}

fn sightings(values: &[TrackedValue], timeline: &ResultTimeline) -> Vec<WeightedPoint> {
    let places = timeline.times.iter().zip(values);
    places.map(|(x, value)| WeightedPoint { x: *x, y: value.value, sd: value.sd }).collect()
}

/// The change from the first to the last value. Its degrees of freedom are those of Welch and Satterthwaite.
fn change(values: &[TrackedValue]) -> TrackedChange {
    let nothing = TrackedValue { value: 0.0, sd: 0.0, freedom: None };
    let [first, last] = [values.first(), values.last()].map(|value| value.copied().unwrap_or(nothing));
    let (change, sd) = (last.value - first.value, last.sd.hypot(first.sd));
    let share = |value: TrackedValue| value.freedom.map_or(0.0, |freedom| value.sd.powi(4) / freedom);
    let shares = share(first) + share(last);
    let freedom = (shares > 0.0).then(|| sd.powi(4) / shares);
    let p = if change == 0.0 { 1.0 } else { two_sided_tail(change / sd, freedom) };
    TrackedChange { change, sd, p, p_holm: p, significant: false }
}

/// Holm's adjusted p-values, in the given order.
fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let (mut adjusted, mut most) = (vec![1.0; p.len()], 0.0);
    for (rank, at) in order.into_iter().enumerate() {
        most = (p[at] * (p.len() - rank) as f64).min(1.0).max(most);
        adjusted[at] = most;
    }
    adjusted
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected values from R: p.adjust(c(0.01, 0.04, 0.03, 0.005), "holm").
    #[test]
    fn p_values_are_adjusted_by_holm() {
        let adjusted = holm(&[0.01, 0.04, 0.03, 0.005]);
        for (found, expected) in adjusted.iter().zip([0.03, 0.06, 0.06, 0.02]) {
            assert!((found - expected).abs() < 1e-12, "{adjusted:?}");
        }
    }

    #[test]
    fn the_degrees_of_freedom_of_a_change_are_those_of_welch() {
        let value = |value, freedom| TrackedValue { value, sd: 1.0, freedom };
        // Welch: 2^2 / (1/5 + 1/5) = 10 degrees of freedom; scipy.stats.t.sf(3 / sqrt(2), 10) * 2.
        let found = change(&[value(0.0, Some(5.0)), value(3.0, Some(5.0))]);
        assert!((found.p - 0.0598903244255594).abs() < 1e-9, "{}", found.p);
        assert!((change(&[value(0.0, None), value(3.0, None)]).p - 0.033894853524689295).abs() < 1e-9);
    }
}
