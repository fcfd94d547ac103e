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
    /// Unit of values, changes and standard deviations.
    pub unit: &'static str,
    pub values: Vec<TrackedValue>,
    /// The change from the first to the last value.
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
    /// p-value adjusted for the family (Holm).
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

    fn series(name: &'static str, values: &[f64], sd: f64) -> ValueSeries<&'static str> {
        let value = |value: &f64| TrackedValue { value: *value, sd, freedom: None };
        ValueSeries { name, unit: "mm", values: values.iter().map(value).collect() }
    }

    /// Welch and Satterthwaite: (1 + 1/4)^2 / (1/5 + (1/4)^2 / 10) degrees of freedom; scipy.stats.t.sf.
    #[test]
    fn a_change_has_the_standard_deviations_of_both_values() {
        let first = TrackedValue { value: 1.0, sd: 1.0, freedom: Some(5.0) };
        let last = TrackedValue { value: 4.0, sd: 0.5, freedom: Some(10.0) };
        let found = change(&[first, TrackedValue { value: 99.0, sd: 0.1, freedom: None }, last]);
        assert_eq!((found.change, found.sd), (3.0, 1.25f64.sqrt()));
        assert!((found.p - 0.02918273022999154).abs() < 1e-10, "{}", found.p);
        assert_eq!(change(&[last, last]).p, 1.0);
        assert_eq!(change(&[]).change, 0.0);
    }

    /// scipy.stats.norm.sf(2 / 0.5) * 2 = 6.334e-5, times two quantities by Holm.
    #[test]
    fn changes_of_a_family_are_tested_together() {
        let family =
            vec![series("a", &[0.0, 2.0], 0.5 / 2f64.sqrt()), series("b", &[0.0, 1.3], 0.5 / 2f64.sqrt())];
        let found = track(family, &ResultTimeline::numbered(2));
        assert!((found[0].change.p_holm / (2.0 * 6.334248366623973e-5) - 1.0).abs() < 1e-9);
        // 2.6 standard deviations: p = 0.0093 alone, and the largest of a family is not multiplied.
        assert!(found[0].change.significant && found[1].change.significant);
        assert_eq!(found[1].change.p, found[1].change.p_holm);
        assert!(found.iter().all(|quantity| quantity.trend.is_none()), "two values have no trend");
        let alike =
            vec![series("a", &[0.0, 1.3], 0.5 / 2f64.sqrt()), series("b", &[0.0, 1.3], 0.5 / 2f64.sqrt())];
        let found = track(alike, &ResultTimeline::numbered(2));
        assert!(found.iter().all(|quantity| !quantity.change.significant), "0.0186 for each of two");
    }

    /// Slope 1 per unit of time; sd = 0.2 / sqrt(sum (x - 2)^2) = 0.2 / sqrt(8).
    #[test]
    fn a_trend_is_the_weighted_line_over_the_times() {
        let timeline =
            ResultTimeline { unit: crate::conformity::TimelineUnit::Days, times: vec![0.0, 2.0, 4.0] };
        let family = vec![series("a", &[1.0, 3.0, 5.0], 0.2), series("b", &[1.0, 1.01, 1.0], 0.2)];
        let found = track(family, &timeline);
        let trend = found[0].trend.unwrap();
        assert!((trend.line.slope - 1.0).abs() < 1e-12);
        assert!((trend.line.slope_sd - 0.2 / 8f64.sqrt()).abs() < 1e-12);
        assert!(trend.significant && !found[1].trend.unwrap().significant);
        assert!((found[1].trend.unwrap().p_holm - 1.0).abs() < 1e-9);
    }
}
