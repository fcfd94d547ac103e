//! Plausibility of the input: findings about lengths, angles and times that no circular test gives.

use std::cmp::Ordering;

use super::noise;
use super::quantities::RadialTraces;
use super::reference_circle::fit_circle;
use super::trace::{CirclePoint, CircleSense, CircleTrace, CoveredArc};
use crate::circular::CircularFinding as Finding;
use crate::diagnostic::Diagnostic;
use crate::math::robust::median;
use crate::plausibility::Quantity;

/// A spike exceeds this multiple of the median difference from the neighbours, and this many mm. No reversal causes
/// such a peak at a single point.
const SPIKE: f64 = 20.0;
const MIN_SPIKE_MM: f64 = 0.2;
/// Largest relative difference of the mean length from the radius.
const MAX_RADIUS_DEVIATION: f64 = 0.01;
/// Largest angle of one run, degrees.
const MAX_TURNED_DEG: f64 = 750.0;
/// Largest change of the bar's temperature during a test, K.
const MAX_WARMED_K: f64 = 8.0;
/// Minimum number of points whose neighbours are near.
const MIN_TESTED_POINTS: usize = 12;

pub(super) fn check_plausibility(traces: &[CircleTrace], radius_mm: f64) -> Vec<Diagnostic> {
    let mut found: Vec<Finding> = traces.iter().filter_map(spike).collect();
    found.extend(traces.iter().filter_map(rows_twice));
    found.extend(traces.iter().filter_map(many_turns));
    found.extend(traces.iter().filter_map(|trace| counted(trace, traces)));
    found.extend(traces.iter().filter_map(in_gon));
    found.extend(traces.iter().filter_map(times_back));
    found.extend(traces.iter().filter_map(turns_back));
    let warm = warm(traces);
    found.extend(rounded(traces).or_else(|| equal_run(traces)));
    let lengths = || traces.iter().flat_map(|trace| &trace.points).map(|point| point.length_mm);
    let mean_mm = lengths().sum::<f64>() / lengths().count().max(1) as f64;
    if (mean_mm - radius_mm).abs() > MAX_RADIUS_DEVIATION * radius_mm {
        found.push(Finding::OtherRadius { mean_mm, radius_mm });
    }
    let mut rest = lengths();
    let first = rest.next();
    if rest.all(|length_mm| Some(length_mm) == first) {
        found.push(Finding::EqualLengths { length_mm: mean_mm });
    }
    found.into_iter().map(Diagnostic::from).chain(warm).collect()
}

/// Lengths with so few decimals that the intervals, which follow from the noise, are too narrow.
fn rounded(traces: &[CircleTrace]) -> Option<Finding> {
    const STEP_MM: f64 = 0.01;
    let steps: Vec<f64> =
        traces.iter().flat_map(|trace| &trace.points).map(|point| point.length_mm / STEP_MM).collect();
    let is_whole = |step: &f64| (step - step.round()).abs() < 1e-6;
    let differ = steps.windows(2).any(|pair| pair[0] != pair[1]);
    (steps.len() >= MIN_TESTED_POINTS && differ && steps.iter().all(is_whole))
        .then_some(Finding::RoundedLengths { step_um: 1e3 * STEP_MM })
}

/// A run of equal lengths that is too long for the share of equal neighbours elsewhere.
fn equal_run(traces: &[CircleTrace]) -> Option<Finding> {
    const CHANCE: f64 = 1e-6;
    let runs = traces.iter().flat_map(|trace| {
        let equal = |one: &CirclePoint, next: &CirclePoint| one.length_mm == next.length_mm;
        trace.points.chunk_by(equal).map(move |run| (trace, run))
    });
    let longest = runs.max_by_key(|(_, run)| run.len());
    let (trace, run) = longest.filter(|(_, run)| run.len() > 2)?;
    let pairs = || traces.iter().flat_map(|trace| trace.points.windows(2));
    let equal = pairs().filter(|pair| pair[0].length_mm == pair[1].length_mm).count();
    let (own, all) = (run.len() - 1, pairs().count());
    // Rule of succession.
    let share = (equal - own + 1) as f64 / (all - own + 2) as f64;
    let chance = all as f64 * share.powi(i32::try_from(own).unwrap_or(i32::MAX));
    let (angle_deg, length_mm) = run.first().map(|point| (point.angle_deg, point.length_mm))?;
    (chance < CHANCE && own + 1 < traces.iter().map(|trace| trace.points.len()).sum::<usize>())
        .then(|| Finding::EqualRun { run: trace.run.clone(), points: own + 1, angle_deg, length_mm })
}

/// The two senses have different centres or radii but the same form: the ball moved between them, or the zero changed.
/// Backlash causes steps instead.
pub(super) fn centres_differ(traces: &[CircleTrace], rays: &RadialTraces) -> Option<Finding> {
    /// Relative expansion of a steel bar that warms by 3 K.
    const WARMED: f64 = 3.0 * 11.5e-6;
    /// Significant deviate.
    const DEVIATE: f64 = 5.0;
    /// Largest ratio of the rest to the change of centre. Backlash makes a square wave, whose ratio is 0.48.
    const SMOOTH: f64 = 0.25;
    // Joints turn differently in the two senses: their backlash shifts mean and centre.
    if traces.iter().flat_map(|trace| &trace.points).any(|point| point.drives.is_some()) {
        return None;
    }
    let of = |sense: CircleSense| {
        let at = traces.iter().position(|trace| trace.sense == sense)?;
        fit_circle(rays.traces[at].iter().copied()).map(|circle| (at, circle))
    };
    let ((ccw, there), (cw, back)) = of(CircleSense::CounterClockwise).zip(of(CircleSense::Clockwise))?;
    let radius_mm = traces[ccw].points.first()?.length_mm;
    let least_mm = WARMED * radius_mm;
    let scatter_mm = noise::without_form(traces, rays);
    let count = traces[ccw].points.len().min(traces[cw].points.len()) as f64;
    let sd_mm = scatter_mm * (2.0 / count).sqrt();
    let radii_mm = back.offset_mm - there.offset_mm;
    if radii_mm.abs() > least_mm.max(DEVIATE * sd_mm) {
        return Some(Finding::RadiiApart { apart_um: 1e3 * radii_mm });
    }
    let centres_mm = (back.centre[0] - there.centre[0]).hypot(back.centre[1] - there.centre[1]);
    let rest_mm = rest_between(rays, [(ccw, there.centre), (cw, back.centre)])?;
    let is_smooth = rest_mm < SMOOTH * centres_mm / 2.0_f64.sqrt();
    (is_smooth && centres_mm > least_mm.max(DEVIATE * 2.0_f64.sqrt() * sd_mm))
        .then_some(Finding::CentresApart { apart_um: 1e3 * centres_mm })
}

/// Root mean square difference of two traces at facing points, each about its own centre, mm.
fn rest_between(rays: &RadialTraces, [(ccw, there), (cw, back)]: [(usize, [f64; 2]); 2]) -> Option<f64> {
    let facing = rays.facing(ccw, cw)?;
    let squares: Vec<f64> = facing
        .map(|(one, [left, right], weight)| {
            let near = |at: usize| rays.traces[cw][at].deviation(back);
            let other = (1.0 - weight) * near(left) + weight * near(right);
            (rays.traces[ccw][one].deviation(there) - other).powi(2)
        })
        .collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// A deviation that is too large for a machine.
pub(super) fn too_large(g_mm: f64, radius_mm: f64) -> Option<Finding> {
    (g_mm > MAX_RADIUS_DEVIATION * radius_mm).then_some(Finding::LargeDeviation { g_mm, radius_mm })
}

fn rows_twice(trace: &CircleTrace) -> Option<Finding> {
    let row = |point: &CirclePoint| [Some(point.angle_deg), Some(point.length_mm), point.t_s];
    let mut rows: Vec<_> = trace.points.iter().map(row).collect();
    rows.sort_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
    let twice = rows.windows(2).filter(|pair| pair[0] == pair[1]).count();
    (2 * twice >= trace.points.len()).then(|| Finding::RowsTwice { run: trace.run.clone(), rows: twice })
}

fn many_turns(trace: &CircleTrace) -> Option<Finding> {
    let angles = || trace.points.iter().map(|point| point.angle_deg);
    let span_deg = angles().fold(f64::MIN, f64::max) - angles().fold(f64::MAX, f64::min);
    (span_deg > MAX_TURNED_DEG).then(|| Finding::ManyTurns { run: trace.run.clone(), span_deg })
}

fn warm(traces: &[CircleTrace]) -> Option<Diagnostic> {
    let found = traces.iter().flat_map(|trace| &trace.points).filter_map(|point| point.temp_c);
    let found: Vec<f64> = found.collect();
    let mean_c = found.iter().sum::<f64>() / found.len() as f64;
    let span_k = found.iter().fold(f64::MIN, |most, t| most.max(*t))
        - found.iter().fold(f64::MAX, |least, t| least.min(*t));
    if found.is_empty() {
        return None;
    }
    let warmed = || (span_k > MAX_WARMED_K).then_some(Finding::WarmedBar { span_k }.into());
    Quantity::Temperature.unusual("mean of temp_c", mean_c).map(Diagnostic::from).or_else(warmed)
}

/// Angles from 0 on whose equal steps close a circle of 400: no circle ends between one turn and two.
fn in_gon(trace: &CircleTrace) -> Option<Finding> {
    const TURN_GON: f64 = 400.0;
    /// Largest part of a step by which the circle stays open.
    const OPEN: f64 = 0.1;
    let mut angles: Vec<f64> = trace.points.iter().map(|point| point.angle_deg).collect();
    angles.sort_by(f64::total_cmp);
    let (first, last) = (*angles.first()?, *angles.last()?);
    let step = (last - first) / (angles.len() - 1).max(1) as f64;
    let is_even = angles.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() < OPEN * step);
    let closes = (TURN_GON - (last - first)) / step;
    let is_closed = [0.0, 1.0].iter().any(|steps| (closes - steps).abs() < OPEN);
    (angles.len() >= MIN_TESTED_POINTS && first.abs() < step && is_even && is_closed)
        .then(|| Finding::Gon { run: trace.run.clone(), last_deg: last })
}

/// Angles 1, 2, 3, .. are counts: no circle starts at 1 degree. So are 0, 1, 2, .. in both senses: angles rise in one only.
fn counted(trace: &CircleTrace, all: &[CircleTrace]) -> Option<Finding> {
    let points = trace.points.len();
    let counts = |trace: &CircleTrace, first: i32| {
        trace.points.iter().zip(first..).all(|(point, number)| point.angle_deg == f64::from(number))
    };
    let both = || all.iter().any(|other| other.sense != trace.sense && counts(other, 0));
    let is_turn = points % 360 < 2;
    ((counts(trace, 1) || counts(trace, 0) && both()) && points >= MIN_TESTED_POINTS && !is_turn)
        .then(|| Finding::CountedPoints { run: trace.run.clone(), points })
}

/// Numbers of angle steps in the sense of a trace and against it.
fn steps(trace: &CircleTrace) -> [usize; 2] {
    let sign = if trace.sense == CircleSense::CounterClockwise { 1.0 } else { -1.0 };
    let step = |pair: &[CirclePoint]| sign * (pair[1].angle_deg - pair[0].angle_deg);
    // The step across 0 degrees is large.
    let steps: Vec<f64> = trace.points.windows(2).map(step).filter(|step| step.abs() < 180.0).collect();
    [steps.iter().filter(|step| **step > 0.0).count(), steps.iter().filter(|step| **step < 0.0).count()]
}

/// Steps in both senses. Steps that are all against the sense have a finding of their own.
fn turns_back(trace: &CircleTrace) -> Option<Finding> {
    /// Largest share of steps against the sense: the ends of a motion may swing back.
    const MAX_BACKWARD_SHARE: f64 = 0.1;
    let [with, against] = steps(trace);
    let is_mixed = with.min(against) as f64 > MAX_BACKWARD_SHARE * trace.points.len() as f64;
    let (run, direction) = (trace.run.clone(), trace.sense.word());
    is_mixed.then_some(Finding::TurnsBack { run, direction, steps: against })
}

/// The senses do not cover the same arc. `joint` is the arc of both.
pub(super) fn unequal(traces: &[CircleTrace], joint: &CoveredArc) -> Option<Finding> {
    const MAX_SPACING_DEG: f64 = 30.0;
    /// The points of the senses may alternate.
    const BETWEEN: f64 = 1.5;
    let arc = |sense: CircleSense| {
        let of = || traces.iter().filter(|trace| trace.sense == sense);
        let points = of().map(|trace| trace.points.len()).max()?;
        let least_deg = MAX_SPACING_DEG.max(BETWEEN * 360.0 / points as f64);
        let own = CoveredArc::of(of(), joint.condition);
        Some((own.span_deg, own.largest_gap_deg - joint.largest_gap_deg > least_deg))
    };
    let ((ccw_deg, ccw_lacks), (cw_deg, cw_lacks)) =
        arc(CircleSense::CounterClockwise).zip(arc(CircleSense::Clockwise))?;
    (ccw_lacks || cw_lacks).then_some(Finding::UnequalSenses { ccw_deg, cw_deg })
}

/// The lengths contradict the given standard deviation.
pub(super) fn other_sigma(traces: &[CircleTrace], rays: &RadialTraces, sigma_mm: f64) -> Option<Finding> {
    /// Largest ratio to the scatter: a wrong unit makes a factor of a thousand.
    const MAX_SIGMA_RATIO: f64 = 10.0;
    /// The finding needs a larger standard deviation: in a motion without stops neighbours scatter less than the
    /// lengths, mm.
    const LARGE_MM: f64 = 0.1;
    /// On a circle with fewer points the scatter includes the form.
    const DENSE: usize = 36;
    if traces.iter().any(|trace| trace.points.len() < DENSE) {
        return None;
    }
    let scatter_mm = noise::without_form(traces, rays);
    let (sigma_um, scatter_um) = (1e3 * sigma_mm, 1e3 * scatter_mm);
    if sigma_mm * MAX_SIGMA_RATIO < scatter_mm {
        return Some(Finding::SigmaTooSmall { sigma_um, scatter_um });
    }
    (sigma_mm > LARGE_MM && sigma_mm > MAX_SIGMA_RATIO * scatter_mm)
        .then_some(Finding::SigmaTooLarge { sigma_um, scatter_um })
}

fn times_back(trace: &CircleTrace) -> Option<Finding> {
    /// Longest test, s.
    const LONGEST_S: f64 = 6.0 * 3600.0;
    let times: Vec<f64> = trace.points.iter().filter_map(|point| point.t_s).collect();
    let span_s = times.last()? - times.first()?;
    if span_s > LONGEST_S {
        return Some(Finding::LongTest { run: trace.run.clone(), span_s });
    }
    let back = times.windows(2).find(|pair| pair[1] < pair[0])?;
    Some(Finding::TimesBack { run: trace.run.clone(), t_s: back[1] })
}

/// A point that is too far from the mean of its neighbours.
fn spike(trace: &CircleTrace) -> Option<Finding> {
    if trace.points.len() < MIN_TESTED_POINTS {
        return None;
    }
    let mut points: Vec<_> = trace.points.iter().collect();
    points.sort_by(|a, b| a.angle_deg.total_cmp(&b.angle_deg));
    let off = points
        .windows(3)
        .map(|near| (near[1].angle_deg, near[1].length_mm - 0.5 * (near[0].length_mm + near[2].length_mm)));
    let off: Vec<(f64, f64)> = off.collect();
    let usual_mm = median(&mut off.iter().map(|(_, off_mm)| off_mm.abs()).collect::<Vec<_>>())?;
    let &(angle_deg, off_mm) = off.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    let is_spike = off_mm.abs() > MIN_SPIKE_MM.max(SPIKE * usual_mm);
    is_spike.then(|| Finding::Spike { run: trace.run.clone(), angle_deg, off_mm })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_that_warms_by_more_than_8_kelvin_is_found() {
        let trace = |temperatures_c: [f64; 2]| {
            let point = |temp_c| CirclePoint {
                angle_deg: 0.0,
                length_mm: 100.0,
                sigma_mm: None,
                t_s: None,
                temp_c: Some(temp_c),
                axes_deg: None,
                drives: None,
            };
            let points = temperatures_c.map(point).into();
            CircleTrace { run: "1".into(), sense: CircleSense::CounterClockwise, points }
        };
        assert!(warm(&[trace([18.0, 25.9])]).is_none());
        let found = warm(&[trace([18.0, 22.0]), trace([20.0, 26.1])]);
        assert_eq!(
            found.map(|found| found.to_string()),
            Some(Finding::WarmedBar { span_k: 8.1 }.to_string())
        );
    }
}
