//! Quantities of ISO 9283:1998 (7.3, 7.6) along the bar, from lengths at repeated poses.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use crate::math::distributions::{chi_square_exceeded, coverage_95};
use crate::math::straight_line::RegressionLine;
use crate::measurement::{LengthModel, Measurement, PreparedMeasurement};

/// Least degrees of freedom of each half of a run for the drift of repeatability.
const MIN_FREEDOM: usize = 4;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DistanceQuantities {
    /// Poses that were measured more than once, and the number of their lengths.
    pub poses: usize,
    pub lengths: usize,
    /// Mean measured minus predicted length, for the pose where it is largest.
    pub accuracy: DistanceQuantity,
    /// Three standard deviations, pooled over the poses.
    pub repeatability: DistanceQuantity,
    /// Drift of the length at a pose with time; `None` if times are not known.
    pub drift: Option<DistanceQuantity>,
    /// Repeatability of the second half of the run minus that of the first; `None` with too few lengths.
    pub repeatability_drift: Option<DistanceQuantity>,
}

/// A value with its 95 % interval, and how it relates to the standard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DistanceQuantity {
    pub value: f64,
    pub interval95: [f64; 2],
    /// `mm` or `mm/h`.
    pub unit: Cow<'static, str>,
    pub meets: Cow<'static, str>,
    pub lacks: Cow<'static, str>,
}

/// A length at a repeated pose.
#[derive(Clone, Copy)]
struct Visit {
    pose: usize,
    /// Measured minus predicted, mm.
    deviation_mm: f64,
    time_h: Option<f64>,
}

impl DistanceQuantities {
    /// Of all rows as they were measured. `None` if no pose was measured more than once. `model` has the base balls of the
    /// lengths.
    pub fn of(rows: &[Measurement], model: &LengthModel) -> Option<Self> {
        Self::of_places(rows, 0..rows.len(), |at| PreparedMeasurement::from(&rows[at]), model)
    }

    /// As [`Self::of`], of the rows at these places; `reading` has their lengths without what certain events added.
    pub(super) fn of_places(
        rows: &[Measurement],
        places: impl Iterator<Item = usize>,
        reading: impl Fn(usize) -> PreparedMeasurement,
        model: &LengthModel,
    ) -> Option<Self> {
        let visits = visits(rows, places, reading, model);
        let pooled = Pooled::of(&visits)?;
        Some(Self {
            poses: pooled.means.len(),
            lengths: visits.len(),
            accuracy: pooled.accuracy(),
            repeatability: pooled.repeatability(),
            drift: pooled.drift(&visits),
            repeatability_drift: repeatability_drift(&visits),
        })
    }
}

/// The lengths at poses with the same commanded angles, ball and bar.
fn visits(
    rows: &[Measurement],
    places: impl Iterator<Item = usize>,
    reading: impl Fn(usize) -> PreparedMeasurement,
    model: &LengthModel,
) -> Vec<Visit> {
    let model = model.prepare();
    let key = |at: usize| (reading(at).datum, rows[at].target, rows[at].axes.degrees().map(f64::to_bits));
    let mut places: Vec<usize> = places.filter(|at| !rows[*at].datum.is_plane()).collect();
    places.sort_by_cached_key(|at| key(*at));
    let repeated = places.chunk_by(|a, b| key(*a) == key(*b)).filter(|group| group.len() > 1);
    let visit = |pose: usize, at: usize| {
        let (row, deviation_mm) = (&rows[at], model.residual(&reading(at)));
        let time_s = row.context.as_ref().and_then(|context| context.time_s);
        Visit { pose, deviation_mm, time_h: time_s.map(|time_s| (time_s * 1e6).round() / 3.6e9) }
    };
    let mut visits = Vec::new();
    for (pose, group) in repeated.enumerate() {
        visits.extend(group.iter().map(|at| visit(pose, *at)));
    }
    visits
}

/// The mean of each pose and the pooled standard deviation.
struct Pooled {
    /// Mean deviation and number of visits of each pose.
    means: Vec<(f64, usize)>,
    sd_mm: f64,
    freedom: usize,
}

impl Pooled {
    /// `None` if no pose has two visits.
    fn of(visits: &[Visit]) -> Option<Self> {
        let poses = visits.iter().map(|visit| visit.pose + 1).max()?;
        let mean = |pose: usize| {
            let deviations = || visits.iter().filter(move |visit| visit.pose == pose);
            let count = deviations().count();
            (deviations().map(|visit| visit.deviation_mm).sum::<f64>() / count.max(1) as f64, count)
        };
        let means: Vec<(f64, usize)> = (0..poses).map(mean).collect();
        let freedom = means.iter().map(|(_, count)| count.saturating_sub(1)).sum::<usize>();
        let about = |visit: &Visit| (visit.deviation_mm - means[visit.pose].0).powi(2);
        let squares: f64 = visits.iter().map(about).sum();
        (freedom > 0).then(|| Self { sd_mm: (squares / freedom as f64).sqrt(), means, freedom })
    }

    fn accuracy(&self) -> DistanceQuantity {
        let larger = |a: &&(f64, usize), b: &&(f64, usize)| a.0.abs().total_cmp(&b.0.abs());
        let (value, count) = self.means.iter().max_by(larger).copied().unwrap_or((f64::NAN, 1));
        let half = coverage_95(Some(self.freedom as f64)) * self.sd_mm / (count as f64).sqrt();
        DistanceQuantity {
            value,
            interval95: [value - half, value + half],
            unit: "mm".into(),
            meets: "distance accuracy (7.3.2) as mean attained minus computed distance".into(),
            lacks: "one end is the base ball, which is fitted, not a second commanded pose; not the \
                    poses, load, speed and 30 cycles of the standard"
                .into(),
        }
    }

    fn repeatability(&self) -> DistanceQuantity {
        let freedom = self.freedom as f64;
        let end = |p: f64| 3.0 * self.sd_mm * (freedom / chi_square_exceeded(p, freedom)).sqrt();
        DistanceQuantity {
            value: 3.0 * self.sd_mm,
            interval95: [end(0.025), end(0.975)],
            unit: "mm".into(),
            meets: "distance repeatability (7.3.3) as three standard deviations".into(),
            lacks: "the noise of the bar is in it; one end is at rest; poses are approached from any side and pooled, not \
                    30 cycles at one distance"
                .into(),
        }
    }

    /// A common slope of the deviations from the mean of each pose.
    fn drift(&self, visits: &[Visit]) -> Option<DistanceQuantity> {
        let times: Vec<f64> = visits.iter().map(|visit| visit.time_h).collect::<Option<_>>()?;
        let mean_time = |pose: usize| {
            let of_pose = || visits.iter().zip(&times).filter(move |(visit, _)| visit.pose == pose);
            of_pose().map(|(_, time)| time).sum::<f64>() / of_pose().count().max(1) as f64
        };
        let means: Vec<f64> = (0..self.means.len()).map(mean_time).collect();
        let points: Vec<[f64; 2]> = visits
            .iter()
            .zip(&times)
            .map(|(visit, time)| [time - means[visit.pose], visit.deviation_mm - self.means[visit.pose].0])
            .collect();
        let freedom = self.freedom.checked_sub(1).filter(|freedom| *freedom > 0)? as f64;
        let RegressionLine { slope, slope_sd, .. } = RegressionLine::through(&points)?;
        // The means of the poses are estimated from the same lengths.
        let sd = slope_sd * ((points.len() as f64 - 2.0) / freedom).sqrt();
        let half = coverage_95(Some(freedom)) * sd;
        Some(DistanceQuantity {
            value: slope,
            interval95: [slope - half, slope + half],
            unit: "mm/h".into(),
            meets: "drift of pose accuracy (7.6) along the bar, as a rate".into(),
            lacks: "one direction; bar and stand drift with the robot; not 8 h from a cold start".into(),
        })
    }
}

/// The interval uses the normal approximation of the distribution of a standard deviation.
fn repeatability_drift(visits: &[Visit]) -> Option<DistanceQuantity> {
    let mut times: Vec<f64> = visits.iter().map(|visit| visit.time_h).collect::<Option<_>>()?;
    times.sort_by(f64::total_cmp);
    let middle = times[times.len() / 2];
    let (first, second): (Vec<Visit>, Vec<Visit>) =
        visits.iter().partition(|visit| visit.time_h.is_some_and(|time| time < middle));
    let [first, second] = [Pooled::of(&first)?, Pooled::of(&second)?];
    if first.freedom.min(second.freedom) < MIN_FREEDOM {
        return None;
    }
    let value = 3.0 * (second.sd_mm - first.sd_mm);
    let variance = |half: &Pooled| half.sd_mm.powi(2) / (2.0 * half.freedom as f64);
    let half = 3.0 * coverage_95(None) * (variance(&first) + variance(&second)).sqrt();
    Some(DistanceQuantity {
        value,
        interval95: [value - half, value + half],
        unit: "mm".into(),
        meets: "drift of pose repeatability (7.6) along the bar, between the halves of the run".into(),
        lacks: "one direction; the noise of the bar is in it; not 8 h from a cold start".into(),
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::measurement::{AxisAngles, BallId, BarId, BaseBall, Datum, MeasurementContext, TargetId};
    use crate::robot::{Approach, PayloadId, Robot};

    /// Three poses in turn, four times. From tables: t(0.975; 9), chi-square(0.025 and 0.975; 9).
    #[test]
    fn quantities_of_known_deviations() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ball = BaseBall { id: BallId::FIRST, position: Vector3::new(1200.0, 0.0, 600.0) };
        let model = LengthModel::new(robot.geometry, &[ball]);
        let deviations = [0.01, -0.02, 0.03, 0.02, -0.01, 0.03, 0.0, -0.03, 0.04, 0.01, -0.02, 0.02];
        let row = |(at, deviation_mm): (usize, &f64)| {
            let axes = AxisAngles::from_degrees([10.0 * (at % 3) as f64, -90.0, 90.0, 10.0, 40.0, 0.0]);
            let mut row = Measurement {
                index: at as u32 + 1,
                datum: Datum::Ball(BallId::FIRST, BarId::FIRST),
                target: TargetId::FIRST,
                axes,
                approach: Approach::default(),
                length_mm: 0.0,
                sigma_mm: None,
                payload: PayloadId::FIRST,
                context: Some(
                    MeasurementContext { time_s: Some(600.0 * at as f64), ..MeasurementContext::default() }
                        .into(),
                ),
            };
            row.length_mm = model.prepare().length(&PreparedMeasurement::from(&row)) + deviation_mm;
            row
        };
        let rows: Vec<Measurement> = deviations.iter().enumerate().map(row).collect();
        let found = DistanceQuantities::of(&rows, &model).unwrap();
        let near = |found: f64, expected: f64| {
            assert!((found - expected).abs() < 1e-6, "{found} is not {expected}");
        };
        // Means 0.01, -0.02, 0.03; each pose has squares of 0.0002.
        let sd = (0.0006f64 / 9.0).sqrt();
        assert_eq!((found.poses, found.lengths), (3, 12));
        near(found.accuracy.value, 0.03);
        near(found.accuracy.interval95[1], 0.03 + 2.262157 * sd / 2.0);
        near(found.repeatability.value, 3.0 * sd);
        near(found.repeatability.interval95[0], 3.0 * sd * (9.0f64 / 19.022768).sqrt());
        near(found.repeatability.interval95[1], 3.0 * sd * (9.0f64 / 2.700389).sqrt());
        let drift = found.drift.unwrap();
        near(drift.value, -0.004);
        assert!(drift.interval95[0] < 0.0 && drift.interval95[1] > 0.0);
        assert!(found.repeatability_drift.is_none());
        assert!(DistanceQuantities::of(&rows[..3], &model).is_none());
        // An outlier and a step of the bar that the fit has taken away are no properties of the robot.
        let mut disturbed = rows.clone();
        disturbed.iter_mut().for_each(|row| row.length_mm += 0.3);
        disturbed.push(Measurement { index: 13, length_mm: rows[0].length_mm + 2.0, ..rows[0].clone() });
        let used = DistanceQuantities::of_places(&disturbed, 0..12, |at| (&rows[at]).into(), &model);
        assert_eq!(used, DistanceQuantities::of(&rows, &model));
    }

    /// Six visits with deviations of +-0.01 mm, then six with +-0.03 mm: variances of 6e-4 / 5 and 54e-4 / 5 about the means.
    #[test]
    fn drift_of_repeatability_is_the_difference_of_the_halves() {
        let visit = |at: usize| {
            let size = if at < 6 { 0.01 } else { 0.03 };
            let deviation_mm = if at.is_multiple_of(2) { size } else { -size };
            Visit { pose: 0, deviation_mm, time_h: Some(at as f64) }
        };
        let visits: Vec<Visit> = (0..12).map(visit).collect();
        let found = repeatability_drift(&visits).unwrap();
        let [first, second] = [1.2e-4f64, 1.08e-3];
        let value = 3.0 * (second.sqrt() - first.sqrt());
        // The variance of a standard deviation s of f degrees of freedom is s^2 / 2f.
        let half = 3.0 * 1.959964 * ((first + second) / 10.0).sqrt();
        assert!((found.value - value).abs() < 1e-12);
        assert!((found.interval95[0] - (value - half)).abs() < 1e-7, "{:?}", found.interval95);
        assert!((found.interval95[1] - (value + half)).abs() < 1e-7);
        // Five visits in a half have four degrees of freedom, which is enough; four have not.
        assert!(repeatability_drift(&visits[1..11]).is_some());
        assert!(repeatability_drift(&visits[2..10]).is_none());
        let timeless: Vec<Visit> = visits.iter().map(|visit| Visit { time_h: None, ..*visit }).collect();
        assert!(repeatability_drift(&timeless).is_none());
    }
}
