//! Lengths at the points of a pass without stops, by the commanded path over time.
//!
//! Strobe or reports show when the motion started and ended; its duration against the plan gives the override. The
//! reading is late by the lag of the drives and the delays of output and line. At constant speed they add up to one
//! number, which a pass in each direction determines: the length at an angle is read too early in one direction and too
//! late in the other.

use std::ops::Range;

use super::input::{MatchingInput, MeasuredAxes};
use super::outcome::{MatchOutcome, PoseOutcome};
use super::parabola::Parabola;
use super::published::AlignedTrack;
use crate::plan::{Plan, PlannedPass};
use crate::recording::dwell::{Dwell, DwellReading, ResidualScatter, least_u_mm};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;
use crate::recording::{reports, strobe_decoder};
use dbbd_model::math::straight_line::RegressionLine;

/// The lag shown by the passes over one circle in both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassLag {
    pub circle: u32,
    /// Delay of the reading behind the commanded motion, s.
    pub lag_s: f64,
    pub sd_s: f64,
    /// Counter-clockwise less clockwise length, mm: the effect of backlash and friction.
    pub hysteresis_mm: f64,
}

#[derive(Clone, Debug, Default)]
pub(super) struct MatchedPasses {
    pub(super) points: Vec<PassPoint>,
    pub(super) lags: Vec<PassLag>,
    /// Circles whose lag is not determined by passes in both directions.
    pub(super) one_way: Vec<u32>,
    /// Intervals of the passes, s.
    spans_s: Vec<Range<f64>>,
    /// Measured axes at the points, degrees, by the plan's index.
    pub(super) axes_deg: MeasuredAxes,
    /// Number of pairs of axes and length in motion, and of independent ones.
    pub(super) pairs: usize,
    pub(super) effective_pairs: f64,
}

#[derive(Clone, Debug)]
pub(super) struct PassPoint {
    pub(super) pose: PoseOutcome,
    /// Uncertainty of the length due to the lag, mm.
    pub(super) timing_mm: f64,
}

/// Prior standard deviation of the lag about 0, s.
pub(super) const LAG_SD_S: f64 = 0.05;
/// Range of the duration of a motion, as a multiple of the planned one.
const STRETCHES: Range<f64> = 0.97..10.0;
/// Largest difference of equal angles, degrees.
const SAME_DEG: f64 = 0.01;

struct DrivenPass<'a> {
    pass: &'a PlannedPass,
    /// Times at which the points of the pass were passed, s: by the command, or by the measured axes in the time of the
    /// bar without lag.
    times_s: Vec<f64>,
}

/// The reading at a point of a pass, by the plan's index.
struct PointReading {
    index: u32,
    passing: Option<PassingReading>,
    /// Half of the time that belongs to the point, s.
    half_s: f64,
}

pub(super) fn read_passes(input: &MatchingInput<'_>) -> MatchedPasses {
    let planned = &input.plan.header.passes;
    let mut passes = MatchedPasses::default();
    let spans = spans(input);
    let mut circles: Vec<u32> = planned.iter().map(|pass| pass.circle).collect();
    circles.dedup();
    for circle in circles {
        let mut found = Vec::new();
        for (pass, span) in planned.iter().zip(&spans).filter(|(pass, _)| pass.circle == circle) {
            match span.clone().and_then(|span| Ok((check_driven_pass(input, pass, &span)?, span))) {
                Ok((one, span)) => {
                    passes.spans_s.push(span);
                    found.push(one);
                }
                Err(reason) => passes.add_missing(pass, &reason),
            }
        }
        passes.add_circle(input, circle, &found);
    }
    passes
}

/// The passes by the published axes; `times_s` are the times of the points of each pass, s of the track.
pub(super) fn read_published(
    input: &MatchingInput<'_>,
    published: &AlignedTrack<'_>,
    times_s: &[Option<Vec<f64>>],
) -> MatchedPasses {
    let mut passes = MatchedPasses::default();
    for (pass, times_s) in input.plan.header.passes.iter().zip(times_s) {
        let Some(track_s) = times_s else {
            passes.add_missing(pass, &Finding::PassNotSeen);
            continue;
        };
        let times_s: Vec<f64> = track_s.iter().map(|t_s| published.bar_s(*t_s)).collect();
        if let [first, .., last] = times_s[..] {
            passes.spans_s.push(first..last);
        }
        let found = DrivenPass { pass, times_s };
        for (point, track_s) in found.points(input, 0.0).into_iter().zip(track_s) {
            passes.add_published(published, point, *track_s);
        }
    }
    passes
}

impl MatchedPasses {
    /// Whether a dwell lies on a pass.
    pub(super) fn contains(&self, dwell: &Dwell) -> bool {
        let middle_s = 0.5 * (dwell.start_s + dwell.end_s);
        self.spans_s.iter().any(|span| span.contains(&middle_s))
    }

    fn add_missing(&mut self, pass: &PlannedPass, reason: &Finding) {
        for index in pass.points[0]..=pass.points[1] {
            self.push(index, MatchOutcome::Missing { reason: reason.clone() }, 0.0);
        }
    }

    fn push(&mut self, index: u32, outcome: MatchOutcome, timing_mm: f64) {
        self.points.push(PassPoint { pose: PoseOutcome { index, outcome }, timing_mm });
    }

    /// Adds a point of a pass by the published axes, passed at a time of their track.
    fn add_published(&mut self, published: &AlignedTrack<'_>, point: PointReading, track_s: f64) {
        let PointReading { index, passing, half_s } = point;
        match passing.zip(published.passing_deg(track_s, half_s)) {
            Some((PassingReading { reading, slope_mm_s, effective }, (axes_deg, pairs))) => {
                self.axes_deg.insert(index, axes_deg);
                self.pairs += pairs;
                self.effective_pairs += effective.min(pairs as f64);
                let timing_mm = slope_mm_s.abs() * published.lag_sd_s();
                self.push(index, MatchOutcome::Matched { reading, posterior: 1.0 }, timing_mm);
            }
            None => self.push(index, MatchOutcome::Missing { reason: Finding::PassedTooFast }, 0.0),
        }
    }

    /// Adds the passes over one circle, however many were found.
    fn add_circle(&mut self, input: &MatchingInput<'_>, circle: u32, found: &[DrivenPass<'_>]) {
        let read = |lag_s: f64| -> Vec<Vec<PointReading>> {
            found.iter().map(|one| one.points(input, lag_s)).collect()
        };
        let (mut lag_s, mut sd_s) = (0.0, LAG_SD_S);
        let mut points = read(lag_s);
        // Each round reads at the lag of the round before; the fit is linear in the remaining lag.
        for round in 0..3 {
            let Some(left) = remaining_lag(input.plan, found, &points) else { break };
            // The prior counts as one more observation.
            let [prior, measured] = [LAG_SD_S, left.sd_s].map(|sd| 1.0 / (sd * sd));
            lag_s = measured * (lag_s + left.lag_s) / (measured + prior);
            sd_s = 1.0 / (measured + prior).sqrt();
            points = read(lag_s);
            if round == 2 {
                self.lags.push(PassLag { circle, lag_s, sd_s, ..left });
            }
        }
        if !found.is_empty() && self.lags.last().is_none_or(|last| last.circle != circle) {
            self.one_way.push(circle);
        }
        for PointReading { index, passing, .. } in points.into_iter().flatten() {
            match passing {
                Some(PassingReading { reading, slope_mm_s, .. }) => {
                    let matched = MatchOutcome::Matched { reading, posterior: 1.0 };
                    self.push(index, matched, slope_mm_s.abs() * sd_s);
                }
                None => self.push(index, MatchOutcome::Missing { reason: Finding::PassedTooFast }, 0.0),
            }
        }
    }
}

impl DrivenPass<'_> {
    /// The reading at each point, `lag_s` after its time.
    fn points(&self, input: &MatchingInput<'_>, lag_s: f64) -> Vec<PointReading> {
        let times_s = &self.times_s;
        let half_s = |at: usize| {
            let to = (at + 1).min(times_s.len() - 1);
            let from = at.saturating_sub(1);
            0.5 * (times_s[to] - times_s[from]) / (to - from).max(1) as f64
        };
        let read = |(at, index)| {
            let half_s = half_s(at);
            PointReading { index, passing: passing(input.stream, times_s[at] + lag_s, half_s), half_s }
        };
        let [first, last] = self.pass.points;
        (first..=last).take(times_s.len()).enumerate().map(read).collect()
    }
}

/// The remaining lag, its standard deviation, and the hysteresis: least squares of the differences of both
/// directions at the same angles. `None` without both directions, or if no length changes.
fn remaining_lag(plan: &Plan, found: &[DrivenPass<'_>], points: &[Vec<PointReading>]) -> Option<PassLag> {
    let pairs = sense_pairs(plan, found, points).filter(|pairs| pairs.len() >= 4)?;
    let RegressionLine { centre: [slope_mm_s, reading_mm], slope: lag_s, slope_sd } =
        RegressionLine::through(&pairs)?;
    Some(PassLag {
        circle: 0,
        lag_s,
        sd_s: slope_sd.max(1e-6),
        hysteresis_mm: lag_s * slope_mm_s - reading_mm,
    })
}

/// Pairs of differences at each angle that was passed in both directions: slope counter-clockwise less clockwise
/// (mm/s), and reading clockwise less counter-clockwise (mm).
fn sense_pairs(plan: &Plan, found: &[DrivenPass<'_>], points: &[Vec<PointReading>]) -> Option<Vec<[f64; 2]>> {
    let places = plan.circle_places();
    let sense = |clockwise: bool| {
        let at = found.iter().position(|one| one.pass.clockwise == clockwise)?;
        let known = points.get(at)?.iter().filter_map(|point| {
            let place = places.get((point.index as usize).checked_sub(1)?)?.as_ref()?;
            Some((place.angle_deg, point.passing.as_ref()?))
        });
        Some(known.collect::<Vec<_>>())
    };
    Some(at_same_angles(&sense(false)?, &sense(true)?))
}

/// The pairs of [`sense_pairs`], from the readings at angles (deg) counter-clockwise and clockwise.
fn at_same_angles(counter: &[(f64, &PassingReading)], clockwise: &[(f64, &PassingReading)]) -> Vec<[f64; 2]> {
    let pair = |(angle_deg, one): &(f64, &PassingReading)| {
        let same = |other: &&(f64, &PassingReading)| {
            let apart = (other.0 - angle_deg).rem_euclid(360.0);
            apart.min(360.0 - apart) < SAME_DEG
        };
        let (_, other) = clockwise.iter().find(same)?;
        Some([one.slope_mm_s - other.slope_mm_s, other.reading.reading_mm - one.reading.reading_mm])
    };
    counter.iter().filter_map(pair).collect()
}

/// The start and end of each pass, s of the stream, or the reason why they are unknown.
fn spans(input: &MatchingInput<'_>) -> Vec<Result<Range<f64>, Finding>> {
    let passes = &input.plan.header.passes;
    if let Some(reported) = reports::spans(input.reports, input.stream) {
        let of = |pass: &PlannedPass| reported.get(&pass.end).cloned().ok_or(Finding::PassNotReported);
        return passes.iter().map(of).collect();
    }
    if passes.is_empty() {
        return Vec::new();
    }
    if !strobe_decoder::has_strobe(input.stream) {
        return vec![Err(Finding::PassWithoutSignal); passes.len()];
    }
    // The n-th strobe belongs to the n-th counted stop.
    let commanded: Vec<u32> = input.plan.counted_stops().map(|stop| stop.row.index).collect();
    let strobed = strobe_decoder::strobed_dwells(input.stream);
    if strobed.len() != commanded.len() {
        let reason = Finding::PassStrobes { strobes: strobed.len(), commanded: commanded.len() };
        return vec![Err(reason); passes.len()];
    }
    let of = |pass: &PlannedPass| {
        let at = commanded.iter().position(|index| *index == pass.end);
        let one = at.and_then(|at| strobed.get(at)).ok_or(Finding::PassWithoutEnd)?;
        Ok(one.dwell.start_s..one.dwell.end_s)
    };
    passes.iter().map(of).collect()
}

fn check_driven_pass<'a>(
    input: &MatchingInput<'_>,
    pass: &'a PlannedPass,
    span: &Range<f64>,
) -> Result<DrivenPass<'a>, Finding> {
    let seconds = span.end - span.start;
    let stretch = seconds / pass.duration_s;
    if !STRETCHES.contains(&stretch) {
        return Err(Finding::PassDuration { seconds, planned_s: pass.duration_s });
    }
    if input.stream.broken_between(span.start, span.end) {
        return Err(Finding::PassClockBroke);
    }
    let mut t_s = span.start;
    let time = |index: u32| {
        let time = (index as usize).checked_sub(1).and_then(|at| input.plan.header.moves.get(at));
        t_s += stretch * time.map_or(0.0, |time| time.duration_s);
        t_s
    };
    Ok(DrivenPass { pass, times_s: (pass.points[0]..=pass.points[1]).map(time).collect() })
}

/// The reading at a point that the robot passed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PassingReading {
    /// The reading; its `u_mm` is the uncertainty of the parabola at the point, with the effective number of samples as
    /// for a dwell.
    reading: DwellReading,
    slope_mm_s: f64,
    /// Effective number of samples.
    effective: f64,
}

/// The reading at `at_s`, from the samples within `half_s`.
fn passing(stream: &SampleStream, at_s: f64, half_s: f64) -> Option<PassingReading> {
    let range = stream.at(at_s - half_s)..stream.at(at_s + half_s);
    let valid: Vec<(f64, f64)> = range
        .clone()
        .filter(|&at| stream.valid(at))
        .map(|at| ((stream.t_s[at] - at_s) / half_s, stream.reading_mm[at]))
        .collect();
    let parabola = Parabola::through(valid.iter().copied())?;
    let ResidualScatter { squares, correlation } =
        ResidualScatter::of(valid.iter().map(|(x, y)| y - parabola.at(*x)));
    let count = valid.len() as f64;
    let variance = squares / (count - 3.0) * (1.0 + correlation) / (1.0 - correlation);
    let reading = DwellReading {
        from_s: at_s - half_s,
        to_s: at_s + half_s,
        reading_mm: parabola.value(),
        u_mm: (variance * parabola.value_variance()).sqrt().max(least_u_mm()),
        samples: valid.len(),
        invalid: range.len() - valid.len(),
        gaps: range.skip(1).filter(|&at| stream.gap_before(at)).count(),
        creep_mm: None,
    };
    let slope_mm_s = parabola.slope() / half_s;
    let effective = count * (1.0 - correlation) / (1.0 + correlation);
    Some(PassingReading { reading, slope_mm_s, effective })
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    /// Readings 2 + 3 t + 4 t^2 about the moment 1 s, at 100 Hz.
    #[test]
    fn reading_at_a_moment_of_a_motion() {
        let mut builder = StreamBuilder::new(None);
        for at in 0..200_u32 {
            let t = 0.01 * f64::from(at) - 1.0;
            builder.push(HostNs(u64::from(at) * 10_000_000), &Sample::of(2.0 + 3.0 * t + 4.0 * t * t));
        }
        let stream = builder.build();
        let PassingReading { reading, slope_mm_s, .. } = passing(&stream, 1.0, 0.205).unwrap();
        assert!((reading.reading_mm - 2.0).abs() < 1e-9 && (slope_mm_s - 3.0).abs() < 1e-9);
        assert_eq!((reading.samples, reading.invalid, reading.gaps), (41, 0, 0));
        assert!((reading.from_s - 0.795).abs() < 1e-12 && (reading.to_s - 1.205).abs() < 1e-12);
        // With exact readings only the uncertainty by the resolution remains.
        assert_eq!(reading.u_mm, least_u_mm());
        assert!(passing(&stream, 0.0, 0.2).is_none());
    }

    /// Readings t^2 of slope 2 t: counter-clockwise at 1, 2 and 3 s, clockwise at 4 and 5 s. 359.995 and 0 degrees are one angle.
    #[test]
    fn readings_at_one_angle_are_paired() {
        let mut builder = StreamBuilder::new(None);
        for at in 0..700_u32 {
            let t = 0.01 * f64::from(at);
            builder.push(HostNs(u64::from(at) * 10_000_000), &Sample::of(t * t));
        }
        let stream = builder.build();
        let [one, two, three, four, five] =
            [1.0, 2.0, 3.0, 4.0, 5.0].map(|at_s| passing(&stream, at_s, 0.205).unwrap());
        let counter = [(10.0, &one), (359.995, &two), (20.0, &three)];
        let pairs = at_same_angles(&counter, &[(10.015, &four), (0.0, &four), (20.009, &five)]);
        let expected = [[4.0 - 8.0, 16.0 - 4.0], [6.0 - 10.0, 25.0 - 9.0]];
        assert_eq!(pairs.len(), expected.len());
        for (pair, expected) in pairs.iter().zip(expected) {
            assert!((0..2).all(|at| (pair[at] - expected[at]).abs() < 1e-9), "{pair:?}");
        }
    }

    #[test]
    fn dwell_lies_on_a_pass_by_its_middle() {
        let passes = MatchedPasses { spans_s: vec![1.0..2.0], ..MatchedPasses::default() };
        let contains = |start_s, end_s| passes.contains(&Dwell::whole(start_s, end_s, 0.1));
        assert!(contains(0.5, 1.5) && contains(1.4, 2.5));
        assert!(!contains(0.5, 1.4) && !contains(1.5, 2.5));
    }
}
