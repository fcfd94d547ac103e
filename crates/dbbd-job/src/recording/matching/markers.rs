//! Checks that the reading follows the sync markers. Their height is commanded, so they show sign and scale of the bar.
//! The lengths at the poses do not show them: a worse robot would explain the same lengths. The times of the markers
//! show whether the reading comes later than the signals of the dwells.

use super::outcome::PoseOutcome;
use super::pose_matching::PoseMatching;
use super::program::{self, AFTER_S};
use crate::plan::{MotionKind, Plan, PoseKind};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;
use dbbd_model::math::straight_line::RegressionLine;

/// A linear move shorter than this is a marker, mm.
const LONGEST_MM: f64 = 1.0;
/// Range and step of the search for a wave, s at full override.
const SEARCH_S: f64 = 1.5;
const STEP_S: f64 = 0.01;
/// Pauses of a controller between two exact stops, s.
const PAUSES_S: [f64; 4] = [0.0, 0.05, 0.1, 0.2];
/// Share of the variance of the reading that a wave must explain.
const SEEN: f64 = 0.9;
/// Least number of samples of a wave.
const MIN_WAVE_SAMPLES: usize = 12;
/// Least number of waves for a judgement, and the least significant deviation, in standard deviations.
const MIN_WAVES: usize = 3;
const SURE: f64 = 5.0;
/// Allowed error of a marker, in repeatabilities of the robot: too short (by backlash), and too long.
const LESS: f64 = 2.0;
const MORE: f64 = 1.0;
/// Least delay of the reading that counts as late, s.
const MIN_LATE_S: f64 = 0.2;
/// Repeatability of a robot that states none, mm.
const REPEATABILITY_MM: f64 = 0.1;

/// Ratio of the reading to the commanded length over all detected waves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerFit {
    pub scale: f64,
    /// Standard deviation of the scale.
    pub sd: f64,
    /// Mean absolute height as commanded, mm.
    pub height_mm: f64,
    /// Least delay of all waves against the dwells beside them, s. Another speed or pauses of the controller move waves
    /// after a dwell and waves before a dwell in opposite senses. 0 if waves of one kind are not seen.
    pub late_s: f64,
    pub waves: usize,
}

/// The markers at the start or end of a module: the length over time at full override.
struct Wave {
    /// Start of the wave by the dwell beside it, s of the stream.
    begins_s: f64,
    /// Whether the dwell beside the wave is before it.
    follows_dwell: bool,
    moves_s: Vec<f64>,
    /// Length at its corners less the length before, mm.
    corners_mm: Vec<f64>,
}

/// Quality of the fit of the reading to a wave.
#[derive(Clone, Copy)]
struct WaveFit {
    begins_s: f64,
    share: f64,
    scale: f64,
}

impl MarkerFit {
    /// `None` if too few markers are detected in a matched run.
    pub fn seen(plan: &Plan, stream: &SampleStream, matching: &PoseMatching) -> Option<Self> {
        let stretch = matching.override_factor.unwrap_or(1.0).recip();
        let waves = waves(plan, matching, stretch);
        let seen: Vec<(&Wave, WaveFit)> =
            waves.iter().filter_map(|wave| Some((wave, wave.fit(stream, stretch)?))).collect();
        if seen.len() < MIN_WAVES {
            return None;
        }
        let count = seen.len() as f64;
        let scale = seen.iter().map(|(_, fit)| fit.scale).sum::<f64>() / count;
        let squares: f64 = seen.iter().map(|(_, fit)| (fit.scale - scale).powi(2)).sum();
        let sd = (squares / (count - 1.0) / count).sqrt();
        let height_mm = seen.iter().map(|(wave, _)| wave.height_mm()).sum::<f64>() / count;
        let late_s = |follows: bool| {
            let waves = seen.iter().filter(|(wave, _)| wave.follows_dwell == follows);
            waves.map(|(wave, fit)| fit.begins_s - wave.begins_s).min_by(f64::total_cmp)
        };
        let late_s = late_s(true).zip(late_s(false)).map_or(0.0, |(after, before)| after.min(before));
        Some(Self { scale, sd, height_mm, late_s, waves: seen.len() })
    }

    /// The finding about a wrong sign or scale that exceeds chance and the error of the robot.
    pub fn finding(&self, repeatability_mm: Option<f64>) -> Option<Finding> {
        let &Self { scale, sd, height_mm, waves, .. } = self;
        let off = scale - 1.0;
        let allowed = if off < 0.0 { LESS } else { MORE } * repeatability_mm.unwrap_or(REPEATABILITY_MM);
        if off.abs() * height_mm < allowed || off.abs() < SURE * sd {
            return None;
        }
        Some(if scale < -SURE * sd {
            Finding::ReadingInverted { waves, scale }
        } else {
            Finding::ReadingScaled { waves, scale, sd }
        })
    }

    /// The finding about a reading that is so late that within the dwells it is still a reading of the motion.
    /// `settle_s` is the time between motion and dwell.
    pub fn late(&self, settle_s: f64) -> Option<Finding> {
        let &Self { late_s, waves, .. } = self;
        (late_s > settle_s.max(MIN_LATE_S)).then_some(Finding::ReadingLate { waves, late_s })
    }
}

/// The waves of a plan next to which a dwell was matched.
fn waves(plan: &Plan, matching: &PoseMatching, stretch: f64) -> Vec<Wave> {
    let rows = &plan.rows;
    let is_marker = |at: usize| {
        let (Some(row), Some(before)) = (rows.get(at), at.checked_sub(1).and_then(|before| rows.get(before)))
        else {
            return false;
        };
        let steps = row.xyz_mm.iter().zip(before.xyz_mm);
        let step_mm = steps.map(|(to, from)| (to - from).powi(2)).sum::<f64>().sqrt();
        row.kind == PoseKind::Transit
            && row.motion == MotionKind::Lin
            && step_mm > 0.0
            && step_mm < LONGEST_MM
    };
    let places: Vec<usize> = (0..rows.len()).filter(|at| is_marker(*at)).collect();
    let groups = places.chunk_by(|one, next| one + 1 == *next);
    let duration_s = |at: usize| plan.header.moves.get(at).map_or(0.0, |time| time.duration_s);
    let between_s = |from: usize, to: usize| stretch * (from..to).map(duration_s).sum::<f64>();
    let wave = |group: &[usize]| {
        let (first, end) = (*group.first()?, group.last()? + 1);
        let moves_s: Vec<f64> = (first..end).map(duration_s).collect();
        let base_mm = rows[first - 1].length_mm;
        let corners_mm = (first - 1..end).map(|at| rows[at].length_mm - base_mm).collect();
        let stops = |at: &usize| program::stops(&rows[*at]);
        // The duration of a PTP move is not planned.
        let timed = |at: &usize| rows[*at].motion != MotionKind::Ptp;
        let after = (end..rows.len()).take_while(timed).find(stops);
        let before = || (0..first).rev().take_while(timed).find(stops);
        let (begins_s, follows_dwell) = match after.and_then(|at| reading(matching, rows[at].index)) {
            Some(dwell) => {
                let settle_s = plan.header.job.motion.settle_s;
                (dwell.0 - settle_s - between_s(first, after? + 1), false)
            }
            None => {
                let at = before()?;
                (reading(matching, rows[at].index)?.1 + AFTER_S + between_s(at + 1, first), true)
            }
        };
        Some(Wave { begins_s, follows_dwell, moves_s, corners_mm })
    };
    groups.filter_map(wave).collect()
}

/// Interval in which a pose was read, s of the stream.
fn reading(matching: &PoseMatching, index: u32) -> Option<(f64, f64)> {
    let at = matching.outcomes.binary_search_by_key(&index, |pose| pose.index).ok()?;
    matching.outcomes.get(at).and_then(PoseOutcome::reading).map(|reading| (reading.from_s, reading.to_s))
}

impl Wave {
    fn height_mm(&self) -> f64 {
        self.corners_mm.iter().fold(0.0, |most, corner| corner.abs().max(most))
    }

    /// The best fit near the expected time; `None` if the wave is not seen.
    fn fit(&self, stream: &SampleStream, stretch: f64) -> Option<WaveFit> {
        let steps = (SEARCH_S * stretch / STEP_S) as i32;
        let fits = PAUSES_S.iter().flat_map(|&pause_s| {
            let knots = self.knots(stretch, pause_s);
            (-steps..=steps)
                .filter_map(move |step| fit(&knots, stream, self.begins_s + f64::from(step) * STEP_S))
        });
        fits.max_by(|a, b| a.share.total_cmp(&b.share)).filter(|fit| fit.share > SEEN)
    }

    /// Times from the start (s) and lengths (mm) of the corners.
    fn knots(&self, stretch: f64, pause_s: f64) -> Vec<[f64; 2]> {
        let mut knots = vec![[0.0, 0.0]];
        let mut t_s = 0.0;
        for (move_s, corner_mm) in self.moves_s.iter().zip(self.corners_mm.iter().skip(1)) {
            t_s += stretch * move_s;
            knots.push([t_s, *corner_mm]);
            t_s += pause_s;
            knots.push([t_s, *corner_mm]);
        }
        knots
    }
}

/// Linear interpolation between knots.
fn interpolate(knots: &[[f64; 2]], t_s: f64) -> f64 {
    let next = knots.partition_point(|knot| knot[0] <= t_s);
    let knot = |at: usize| knots.get(at).or(knots.last()).copied().unwrap_or_default();
    let [[from_s, from_mm], [to_s, to_mm]] = [knot(next.saturating_sub(1)), knot(next)];
    let share = if to_s > from_s { (t_s - from_s) / (to_s - from_s) } else { 0.0 };
    from_mm + share * (to_mm - from_mm)
}

/// Fits scale, level and slope of the knots to the readings from `begins_s` on.
fn fit(knots: &[[f64; 2]], stream: &SampleStream, begins_s: f64) -> Option<WaveFit> {
    let ends_s = begins_s + knots.last()?[0];
    let valid: Vec<usize> = (stream.at(begins_s)..stream.at(ends_s)).filter(|at| stream.valid(*at)).collect();
    if valid.len() < MIN_WAVE_SAMPLES {
        return None;
    }
    let times = || valid.iter().map(|at| stream.t_s[*at] - begins_s);
    let read = detrended(times().zip(valid.iter().map(|at| stream.reading_mm[*at])))?;
    let commanded = detrended(times().map(|t_s| (t_s, interpolate(knots, t_s))))?;
    let product = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(a, b)| a * b).sum::<f64>();
    let (both, own, all) =
        (product(&commanded, &read), product(&commanded, &commanded), product(&read, &read));
    let share = both * both / (own * all);
    (own > 0.0 && all > 0.0).then(|| WaveFit { begins_s, share, scale: both / own })
}

/// The values less their straight line over time.
fn detrended(values: impl Iterator<Item = (f64, f64)>) -> Option<Vec<f64>> {
    let points: Vec<[f64; 2]> = values.map(|(x, y)| [x, y]).collect();
    let RegressionLine { centre: [middle, level], slope, .. } = RegressionLine::through(&points)?;
    Some(points.iter().map(|[x, y]| y - level - slope * (x - middle)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    #[test]
    fn length_is_linear_between_the_corners() {
        let knots = [[0.0, 0.0], [1.0, 2.0], [3.0, 2.0], [4.0, -1.0]];
        for (t_s, length_mm) in
            [(-1.0, 0.0), (0.0, 0.0), (0.25, 0.5), (1.0, 2.0), (2.0, 2.0), (3.5, 0.5), (9.0, -1.0)]
        {
            assert!((interpolate(&knots, t_s) - length_mm).abs() < 1e-12, "{t_s}");
        }
        assert_eq!(interpolate(&[], 1.0), 0.0);
    }

    fn wave() -> Wave {
        Wave { begins_s: 2.0, follows_dwell: false, moves_s: vec![0.5, 0.5], corners_mm: vec![0.0, 0.4, 0.0] }
    }

    #[test]
    fn moves_stretch_and_pauses_do_not() {
        let expected = [[0.0, 0.0], [1.0, 0.4], [1.1, 0.4], [2.1, 0.0], [2.2, 0.0]];
        for (knot, expected) in wave().knots(2.0, 0.1).iter().zip(expected) {
            assert!((knot[0] - expected[0]).abs() < 1e-12 && knot[1] == expected[1]);
        }
        assert_eq!(wave().height_mm(), 0.4);
    }

    #[test]
    fn straight_line_is_removed() {
        let rest = detrended([(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)].into_iter()).unwrap();
        assert!(rest.iter().all(|rest| rest.abs() < 1e-12));
        // The values 1, 0, 1 less their mean.
        let rest = detrended([(0.0, 1.0), (1.0, 0.0), (2.0, 1.0)].into_iter()).unwrap();
        assert!(rest.iter().zip([1.0 / 3.0, -2.0 / 3.0, 1.0 / 3.0]).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    /// The bar shows half of the wave, inverted, 0.3 s later than expected, on a level and a slope.
    #[test]
    fn wave_is_found_with_its_scale_and_time() {
        let mut builder = StreamBuilder::new(None);
        let knots = wave().knots(1.0, 0.0);
        for at in 0..600_u32 {
            let t_s = 0.01 * f64::from(at);
            let moved = if (2.3..3.3).contains(&t_s) { interpolate(&knots, t_s - 2.3) } else { 0.0 };
            builder.push(HostNs(u64::from(at) * 10_000_000), &Sample::of(3.0 + 0.02 * t_s - 0.5 * moved));
        }
        let found = wave().fit(&builder.build(), 1.0).unwrap();
        assert!((found.scale + 0.5).abs() < 0.02, "{}", found.scale);
        assert!((found.begins_s - 2.3).abs() < 0.03, "{}", found.begins_s);
        assert!(found.share > 0.99);
    }

    /// The wave 0, 1, 0, 1, .. and readings of a quarter of it with as much of 0, 0, 1, 1, .., both less their straight
    /// lines: both parts have equal squares, so the wave explains half of the readings. Without a motion there is
    /// nothing to fit.
    #[test]
    fn share_is_the_squared_correlation() {
        let wave = |at: u32| f64::from(at % 2);
        let stream = |reading: &dyn Fn(u32) -> f64| {
            let mut builder = StreamBuilder::new(None);
            (0..401)
                .for_each(|at| builder.push(HostNs(u64::from(at) * 10_000_000), &Sample::of(reading(at))));
            builder.build()
        };
        let knots: Vec<[f64; 2]> = (0..401).map(|at| [0.01 * f64::from(at), wave(at)]).collect();
        let both = |at: u32| 7.0 + 0.003 * f64::from(at) + 0.25 * (wave(at) + f64::from(at / 2 % 2));
        let found = fit(&knots, &stream(&both), 0.0).unwrap();
        assert!(
            (found.share - 0.5).abs() < 0.01 && (found.scale - 0.25).abs() < 0.005,
            "{} {}",
            found.share,
            found.scale
        );
        assert!(fit(&knots, &stream(&|_| 7.0), 0.0).is_none());
        assert!(fit(&[[0.0, 1.0], [4.0, 1.0]], &stream(&both), 0.0).is_none());
    }

    /// Markers of 0.4 mm: without a stated repeatability of the robot, 0.1 mm counts.
    #[test]
    fn sign_and_scale_of_the_markers_are_judged() {
        let fit = |scale| MarkerFit { scale, sd: 0.01, height_mm: 0.4, late_s: 0.0, waves: 5 };
        let inverted = Some(Finding::ReadingInverted { waves: 5, scale: -1.0 });
        let scaled = |scale| Some(Finding::ReadingScaled { waves: 5, scale, sd: 0.01 });
        assert_eq!(fit(-1.0).finding(None), inverted);
        // Too short by two repeatabilities, or too long by one: 0.5 and 0.25 of the height.
        assert_eq!([fit(0.51).finding(None), fit(0.49).finding(None)], [None, scaled(0.49)]);
        assert_eq!([fit(1.24).finding(None), fit(1.26).finding(None)], [None, scaled(1.26)]);
        assert_eq!(fit(1.24).finding(Some(0.05)), scaled(1.24));
        // The deviation must exceed five standard deviations.
        assert_eq!(MarkerFit { sd: 0.1, ..fit(1.49) }.finding(None), None);
    }

    #[test]
    fn reading_is_late_after_the_settling_time() {
        let late = |late_s, settle_s| {
            MarkerFit { scale: 1.0, sd: 0.01, height_mm: 0.4, late_s, waves: 5 }.late(settle_s)
        };
        assert_eq!(late(0.19, 0.0), None);
        assert_eq!(late(0.21, 0.0), Some(Finding::ReadingLate { waves: 5, late_s: 0.21 }));
        assert_eq!(late(0.49, 0.5), None);
        assert!(late(0.51, 0.5).is_some());
    }
}
