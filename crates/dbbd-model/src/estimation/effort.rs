//! What the measurements cost, and what an hour more of the same would leave.

use super::result::{Effort, MapPoint, MoreOfTheSame, PositionParts};
use crate::math::distributions::COVERAGE_FACTOR;
use crate::measurement::Measurement;

const MINUTES: f64 = 60.0;

impl Effort {
    /// Of these rows, of which `used` are used. `map` and `parts` are the predicted position uncertainty and its sources.
    pub(super) fn of(rows: &[Measurement], used: usize, map: &[MapPoint], parts: &PositionParts) -> Self {
        let poses = rows.chunk_by(|one, next| one.axes == next.axes).count();
        let minutes = minutes(rows);
        let hour_more = minutes.filter(|_| used > 0).map(|minutes| {
            let of_hour = MINUTES / minutes;
            // Of n lengths the noise is left with the share n/(n + more) of its square. The rest is known from before; what
            // more lengths take from it is not counted, so that this is an upper bound.
            let noise = parts.noise_mm.powi(2);
            let rest = (MapPoint::root_mean_square_mm(map).powi(2) - noise).max(0.0);
            MoreOfTheSame {
                measurements: (of_hour * used as f64).round() as usize,
                expanded_uncertainty_mm: COVERAGE_FACTOR * (rest + noise / (1.0 + of_hour)).sqrt(),
            }
        });
        Self { poses, minutes, hour_more }
    }
}

/// Minutes from the first to the last row of each run, in sum; a run begins where the time falls. `None` if a row has no
/// time, or all have the same.
fn minutes(rows: &[Measurement]) -> Option<f64> {
    let time = |row: &Measurement| row.context.as_ref()?.time_s;
    let times: Vec<f64> = rows.iter().map(time).collect::<Option<_>>()?;
    let runs = times.chunk_by(|before, after| before <= after);
    let seconds: f64 = runs.map(|run| run[run.len() - 1] - run[0]).sum();
    (seconds > 0.0).then_some(seconds / 60.0)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::Vector3;

    use super::*;
    use crate::measurement::MeasurementContext;
    use crate::test_support::checked_robot::calibrated_from_two_balls;

    /// Rows at these times, s, each at a pose of its own.
    fn rows(times_s: &[Option<f64>]) -> Vec<Measurement> {
        let (_, data) = calibrated_from_two_balls();
        let at = |(row, time_s): (&Measurement, &Option<f64>)| {
            let context = MeasurementContext { time_s: *time_s, ..MeasurementContext::default() };
            Measurement { context: Some(Arc::new(context)), ..row.clone() }
        };
        data.rows.iter().zip(times_s).map(at).collect()
    }

    #[test]
    fn minutes_are_those_of_the_runs() {
        assert_eq!(minutes(&rows(&[Some(5.0), Some(65.0), Some(125.0)])), Some(2.0));
        assert_eq!(minutes(&rows(&[Some(5.0), Some(65.0), Some(0.0), Some(30.0)])), Some(1.5));
        assert_eq!(minutes(&rows(&[Some(5.0), None])), None);
        assert_eq!(minutes(&rows(&[Some(5.0)])), None);
    }

    /// 20 minutes: an hour has three times as many lengths, after which a quarter of the square of the noise is left: of
    /// 0.5 mm, of which 0.4 mm are noise, the root of 0.09 + 0.04 square millimetres.
    #[test]
    fn an_hour_more_lowers_the_noise_alone() {
        let rows = rows(&[Some(0.0), Some(600.0), Some(1200.0)]);
        let map = [MapPoint { position: Vector3::zeros(), rms_mm: 0.5 }];
        let parts = PositionParts { noise_mm: 0.4, ..PositionParts::default() };
        let effort = Effort::of(&rows, 3, &map, &parts);
        let more = effort.hour_more.unwrap();
        assert_eq!((effort.poses, effort.minutes, more.measurements), (3, Some(20.0), 9));
        assert!((more.expanded_uncertainty_mm - 2.0 * 0.13f64.sqrt()).abs() < 1e-12);
    }
}
