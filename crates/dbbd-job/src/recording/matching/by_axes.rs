//! Matches poses by the axes that the controller published: finds where the robot rested, and which pose of the plan is
//! there.
//!
//! Neither strobe nor time code nor sync marker is needed: the positions of the rests and their order identify
//! the poses.

use super::alignment::{MIN_NONE_POSTERIOR, MIN_PAIR_POSTERIOR, Pairing};
use super::detection::{DwellDetection, reading};
use super::input::MatchingInput;
use super::outcome::DwellSource;
use super::passes;
use super::program::{CommandedDwell, DwellPoses};
use super::published::{AlignedTrack, BallInterval, PublishedAxes};
use super::visits::{self, PoseVisit, RestEvidence};
use crate::plan::Plan;
use crate::recording::axes::RestInterval;
use crate::recording::dwell::{Dwell, reading_between};
use dbbd_model::robot::{AXES, max_axis_difference};

/// A rest is at a pose if its distance is less than this share of the distance to the next other pose.
const NEAR: f64 = 0.25;
/// Largest distance of a rest from its pose, degrees: limit of corrections and of following errors at rest.
const FAR_DEG: f64 = 1.0;
/// Poses closer than this have one position, degrees.
const SAME_DEG: f64 = 0.01;
/// Time kept clear of the end of a rest, s.
const GUARD_S: f64 = 0.03;
/// A rest that is longer than the wait of its program by more than this contains something else, s.
const LONGER_S: f64 = 1.0;
/// The durations of rests of one pose are alike if their errors differ by less than this, s.
const ALIKE_S: f64 = 0.15;
/// Readings at both ends of a long rest that differ by less belong to one mounting of the bar, mm.
const SAME_MM: f64 = 0.003;

/// Detects the dwells by the published axes. `None` without published axes, or if their times cannot be put on the time
/// axis of the bar.
pub(super) fn detect_by_axes(input: &MatchingInput<'_>, poses: &DwellPoses<'_>) -> Option<DwellDetection> {
    let PublishedAxes { track, geometry } = input.published?;
    let mut published = AlignedTrack::of(track, input.stream)?;
    let rests = assign(poses, &published);
    let times_s = pass_times(input, &published);
    let on_ball = on_ball(input.plan, poses, &published, &rests, &times_s);
    published.determine_lag(input.stream, geometry, &on_ball);
    let (dwells, pairings) = pairings(input, poses, &published, &rests);
    let passes = passes::read_published(input, &published, &times_s);
    let mut measured = passes.axes_deg.clone();
    let mut detection = DwellDetection::new(DwellSource::Axes, dwells, pairings);
    detection.passes = passes;
    for pose in detection.outcomes(input, poses) {
        let Some(reading) = pose.reading() else { continue };
        measured.extend(published.at_rest_deg(reading.from_s, reading.to_s).map(|deg| (pose.index, deg)));
    }
    let (pairs, effective_pairs) = (detection.passes.pairs, detection.passes.effective_pairs);
    detection.report = Some(published.report(measured.len(), pairs, effective_pairs));
    detection.axes_deg = input.axes_deg.cloned().unwrap_or_default();
    detection.axes_deg.extend(measured);
    Some(detection)
}

/// The intervals in which the bar is on each ball, by the rests and passes.
fn on_ball(
    plan: &Plan,
    poses: &DwellPoses<'_>,
    published: &AlignedTrack<'_>,
    rests: &[Vec<PoseVisit>],
    times_s: &[Option<Vec<f64>>],
) -> Vec<BallInterval> {
    /// Markers are within this time before the first and after the last pose, s.
    const AROUND_S: f64 = 10.0;
    let row = |index: u32| plan.rows.get((index as usize).checked_sub(1)?);
    let passed = plan.header.passes.iter().zip(times_s).filter_map(|(pass, times_s)| {
        let centre = row(pass.end)?.centre.number();
        Some(times_s.as_ref()?.iter().map(move |t_s| (*t_s, centre)))
    });
    let rested = rests.iter().zip(&poses.rows).flat_map(|(visits, row)| {
        let certain = visits.iter().filter(|visit| visit.posterior > MIN_PAIR_POSTERIOR);
        let rests = certain.filter_map(|visit| published.rests.get(visit.rest));
        rests.map(|rest| (0.5 * (rest.start_s + rest.end_s), row.centre.number()))
    });
    let mut places: Vec<(f64, u32)> = rested.chain(passed.flatten()).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let balls = &plan.header.job.centres;
    let centre_mm = |id: u32| balls.iter().find(|ball| ball.id == id).map(|ball| ball.xyz_mm.into());
    let stretch = |same: &[(f64, u32)]| {
        let (first, last) = (same.first()?, same.last()?);
        Some(BallInterval {
            from_s: first.0 - AROUND_S,
            to_s: last.0 + AROUND_S,
            centre_mm: centre_mm(first.1)?,
        })
    };
    places.chunk_by(|a, b| a.1 == b.1).filter_map(stretch).collect()
}

/// Distance from each pose within which a rest belongs to it, degrees.
fn reach_deg(poses: &[[f64; AXES]]) -> Vec<f64> {
    let nearest = |pose: &[f64; AXES]| {
        let others = poses.iter().map(|other| max_axis_difference(pose, other)).filter(|deg| *deg > SAME_DEG);
        others.fold(FAR_DEG / NEAR, f64::min)
    };
    poses.iter().map(|pose| NEAR * nearest(pose)).collect()
}

/// The rests of each pose, the best first.
fn assign(poses: &DwellPoses<'_>, published: &AlignedTrack<'_>) -> Vec<Vec<PoseVisit>> {
    let places: Vec<[f64; AXES]> = poses.rows.iter().map(|row| row.axes_deg).collect();
    let reach = reach_deg(&places);
    let at = |rest: &RestInterval| -> Vec<usize> {
        let near = |pose: &usize| max_axis_difference(&rest.axes_deg, &places[*pose]) <= reach[*pose];
        (0..places.len()).filter(near).collect()
    };
    // A rest at no pose says nothing about the order of the poses.
    let (mut rests, mut seen): (Vec<usize>, Vec<RestEvidence>) = (Vec::new(), Vec::new());
    for (rest, interval) in published.rests.iter().enumerate() {
        let poses = at(interval);
        if poses.is_empty() {
            continue;
        }
        let before = rests.last().map(|before| published.rests[*before].end_s);
        let after_loss = before.is_some_and(|end_s| !published.is_whole(end_s, interval.start_s));
        rests.push(rest);
        seen.push(RestEvidence { poses, after_loss });
    }
    let of_pose = |(visits, pose): (Vec<PoseVisit>, &CommandedDwell)| {
        let mut visits = by_preference(visits, |visit| {
            let RestInterval { start_s, end_s, .. } = published.rests[rests[visit.rest]];
            (end_s - start_s - pose.wait_s).abs()
        });
        visits.iter_mut().for_each(|visit| visit.rest = rests[visit.rest]);
        visits
    };
    let visits = visits::visits(&seen, &poses.commanded);
    visits.into_iter().zip(&poses.commanded).map(of_pose).collect()
}

/// The visits of a pose that are certain, the best first; without a certain visit, the most probable one. A visit has
/// one rest or more. It is represented by the rest whose duration fits the program best (`off_s`); of equally good
/// rests the last one. The visits are sorted by the same rule.
fn by_preference(visits: Vec<PoseVisit>, off_s: impl Fn(&PoseVisit) -> f64) -> Vec<PoseVisit> {
    let least_s = |visits: &[PoseVisit]| visits.iter().map(&off_s).fold(f64::INFINITY, f64::min);
    let mut certain = visits.clone();
    certain.retain(|visit| visit.posterior > MIN_PAIR_POSTERIOR);
    if certain.is_empty() {
        let likeliest = visits.into_iter().max_by(|a, b| a.posterior.total_cmp(&b.posterior));
        return likeliest.into_iter().filter(|visit| visit.posterior > 1.0 - MIN_NONE_POSTERIOR).collect();
    }
    let of_visit = |rests: &[PoseVisit]| {
        let least_s = least_s(rests);
        rests.iter().rev().copied().find(|rest| off_s(rest) <= least_s + ALIKE_S)
    };
    let mut chosen: Vec<PoseVisit> =
        certain.chunk_by(|a, b| a.rest + 1 == b.rest).filter_map(of_visit).collect();
    let least_s = least_s(&chosen);
    chosen.reverse();
    chosen.sort_by_key(|visit| off_s(visit) > least_s + ALIKE_S);
    chosen
}

/// The dwells of the poses, in the time of the bar, and the pairing of each pose with its dwell.
fn pairings(
    input: &MatchingInput<'_>,
    poses: &DwellPoses<'_>,
    published: &AlignedTrack<'_>,
    rests: &[Vec<PoseVisit>],
) -> (Vec<Dwell>, Vec<Pairing>) {
    let mut dwells = Vec::new();
    let mut pairings = Vec::new();
    for ((visits, pose), row) in rests.iter().zip(&poses.commanded).zip(&poses.rows) {
        let dwell = |visit: &PoseVisit| dwell(input, published, &published.rests[visit.rest], pose.wait_s);
        let is_read =
            |visit: &&PoseVisit| dwell(visit).is_ok_and(|dwell| reading(input, &dwell, row).is_some());
        let Some(visit) = visits.iter().find(is_read).or(visits.first()) else {
            pairings.push(Pairing::None { posterior: 1.0 });
            continue;
        };
        let (number, dwell) = (dwells.len(), dwell(visit));
        let posterior = if dwell.is_ok() { visit.posterior } else { 0.5 * visit.posterior };
        pairings.push(if posterior > MIN_PAIR_POSTERIOR {
            Pairing::Dwell { dwell: number, posterior }
        } else {
            Pairing::Ambiguous { dwell: number, posterior }
        });
        dwells.push(dwell.unwrap_or_else(|whole| whole));
    }
    (dwells, pairings)
}

/// Times at which the axes passed the points of each pass, s of the track; `None` for a pass that was not driven.
fn pass_times(input: &MatchingInput<'_>, published: &AlignedTrack<'_>) -> Vec<Option<Vec<f64>>> {
    let mut from = 0;
    let mut times = Vec::new();
    for pass in &input.plan.header.passes {
        let [first, last] = pass.points.map(|index| (index as usize).saturating_sub(1));
        let rows = input.plan.rows.get(first..=last).unwrap_or_default();
        let points: Vec<[f64; AXES]> = rows.iter().map(|row| row.axes_deg).collect();
        let found = times_past(published, &points, from);
        if let Some(last_s) = found.as_ref().and_then(|times| times.last()) {
            from = published.track.at(*last_s);
        }
        times.push(found);
    }
    times
}

/// The first times after a sample at which the axes pass all points in order.
fn times_past(published: &AlignedTrack<'_>, points: &[[f64; AXES]], from: usize) -> Option<Vec<f64>> {
    let reach = reach_deg(points);
    let (first, reach_first) = (points.first()?, *reach.first()?);
    let mut at = from;
    while let Some(start) = next_nearest(published, first, reach_first, at..published.track.len()) {
        let mut times = vec![time_at(published, first, start)];
        let (mut here, mut last) = (start, start);
        for (point, reach) in points.iter().zip(&reach).skip(1) {
            // The limit is a few times the step before, and more for the first step.
            let patience = (20 * (here - last)).clamp(500, 5000);
            let Some(next) = next_nearest(published, point, *reach, here + 1..here + patience) else { break };
            times.push(time_at(published, point, next));
            (last, here) = (here, next);
        }
        if times.len() == points.len() {
            return Some(times);
        }
        at = start + 1;
    }
    None
}

/// The first sample of a range at which the axes are closest to a point, within reach.
fn next_nearest(
    published: &AlignedTrack<'_>,
    point: &[f64; AXES],
    reach: f64,
    range: std::ops::Range<usize>,
) -> Option<usize> {
    let axes = &published.track.measured_deg;
    let away = |at: usize| axes.get(at).map(|axes| squared_distance(axes, point));
    let within = |at: &usize| axes.get(*at).is_some_and(|axes| max_axis_difference(axes, point) <= reach);
    range.take_while(|at| *at < axes.len()).filter(within).find(|at| {
        let here = away(*at);
        here.is_some_and(|here| away(at + 1).is_none_or(|next| next > here))
            && at.checked_sub(1).and_then(away).is_none_or(|before| here.is_some_and(|here| before >= here))
    })
}

fn squared_distance(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Time at which the axes are closest to a point, by their speed at the closest sample.
fn time_at(published: &AlignedTrack<'_>, point: &[f64; AXES], at: usize) -> f64 {
    let (track, before, after) =
        (published.track, at.saturating_sub(1), (at + 1).min(published.track.len() - 1));
    let span_s = track.t_s[after] - track.t_s[before];
    let speed = |axis: usize| (track.measured_deg[after][axis] - track.measured_deg[before][axis]) / span_s;
    let (mut along, mut square) = (0.0, 0.0);
    for axis in 0..AXES {
        along += speed(axis) * (point[axis] - track.measured_deg[at][axis]);
        square += speed(axis) * speed(axis);
    }
    track.t_s[at] + if square > 0.0 { (along / square).clamp(-span_s, span_s) } else { 0.0 }
}

/// The dwell of a rest; `Err` with the dwell over the whole rest if the reading differs between the ends of the rest.
fn dwell(
    input: &MatchingInput<'_>,
    published: &AlignedTrack<'_>,
    rest: &RestInterval,
    wait_s: f64,
) -> Result<Dwell, Dwell> {
    let motion = &input.plan.header.job.motion;
    let [start_s, end_s] = [rest.start_s, rest.end_s].map(|t_s| published.bar_s(t_s));
    let whole = Dwell {
        start_s,
        end_s,
        start_sd_s: published.lag_sd_s(),
        settled_s: start_s + motion.settle_s,
        until_s: end_s - GUARD_S,
    };
    if end_s - start_s < wait_s + LONGER_S {
        return Ok(whole);
    }
    // The rest contains a HALT before the dwell or a pause after it: the bar may have been handled.
    let last_s = whole.until_s - motion.dwell_s;
    let first = reading_between(input.stream, whole.settled_s, whole.settled_s + motion.dwell_s);
    let last = reading_between(input.stream, last_s, whole.until_s);
    match (first, last) {
        (Some(a), Some(b)) if (a.reading_mm - b.reading_mm).abs() > SAME_MM + 4.0 * a.u_mm.hypot(b.u_mm) => {
            Err(whole)
        }
        (None, Some(_)) => Ok(Dwell { settled_s: last_s, ..whole }),
        _ => Ok(whole),
    }
}
