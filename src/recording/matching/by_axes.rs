//! Poses by the axes that the controller published: where the robot rested, and which pose of the plan is there.
//!
//! No strobe, time code or sync marker is needed. Rests and poses are both in order of time, so they are aligned by dynamic
//! programming: as many pairs as there can be, then as few poses as possible passed over while the axes show that the robot
//! did not rest there. A pair that another alignment as good does not have is not used.

use super::lag::{self, OnBall};
use super::program::Poses;
use super::published::Published;
use super::{AxesReport, DwellSource, Input, Paired, Pairing, PublishedAxes, Shown, outcomes, passes};
use crate::plan::Plan;
use crate::recording::ClockMap;
use crate::recording::axes::Rest;
use crate::recording::dwell::{Dwell, measure};
use crate::robot::AXES;

/// A rest is at a pose when it is nearer to it than this share of the way to the next other pose.
const NEAR: f64 = 0.25;
/// No controller corrects by more, and no follows worse at rest, degrees.
const FAR_DEG: f64 = 1.0;
/// Poses nearer to each other than this are one place, degrees.
const SAME_DEG: f64 = 0.01;
/// A pair weighs more than all poses that can be passed over.
const PAIR: i64 = 1 << 20;
/// Kept free at the end of a rest, s.
const GUARD_S: f64 = 0.03;
/// A rest that is longer than its program waits by more than this holds something else too, s.
const LONGER_S: f64 = 1.0;
/// Rests of one pose whose durations are off the program's by as much are alike, s.
const ALIKE_S: f64 = 0.15;
/// Readings at both ends of a long rest that differ by less are of one mounted bar, mm.
const SAME_MM: f64 = 0.003;

/// By the axes that the controller published; `None` where there are none, or where they cannot be laid on the bar's time.
pub(super) fn shown(input: &Input<'_>, poses: &Poses<'_>) -> Option<Shown> {
    let PublishedAxes { track, geometry } = input.published?;
    let mut published = Published::of(track, input.stream)?;
    let assigned = assign(poses, &published);
    let times_s = pass_times(input, &published);
    let on_ball = on_ball(input.plan, poses, &assigned, &times_s, &published);
    published.lag = lag::determine(&published, input.stream, geometry, &on_ball);
    let paired = assigned.paired(input, poses, &published);
    let passes = passes::read_published(input, &published, &times_s);
    let mut axes_deg = input.axes_deg.cloned().unwrap_or_default();
    let mut measured = passes.axes_deg.clone();
    for pose in outcomes(input, poses, &paired) {
        let Some(reading) = pose.reading() else { continue };
        measured.extend(published.at_rest_deg(reading.from_s, reading.to_s).map(|deg| (pose.index, deg)));
    }
    let clock = track.clock();
    let report = AxesReport {
        protocol: track.protocol.name(),
        packets: track.counts,
        drift: clock.and_then(ClockMap::drift),
        bound_s: clock.and_then(ClockMap::bound_s),
        lag: published.lag,
        following: track.following(&published.rests),
        rests: published.rests.len(),
        measured: measured.len(),
        pairs: passes.pairs,
        effective_pairs: passes.effective_pairs,
    };
    axes_deg.extend(measured);
    Some(Shown { paired, passes, axes_deg, report: Some(report) })
}

/// When the bar is on which ball, by the poses and passes that were found.
fn on_ball(
    plan: &Plan,
    poses: &Poses<'_>,
    assigned: &Assigned,
    times_s: &[Option<Vec<f64>>],
    published: &Published<'_>,
) -> Vec<OnBall> {
    /// Markers lie so far before the first and behind the last pose at most, s.
    const AROUND_S: f64 = 10.0;
    let row = |index: u32| plan.rows.get((index as usize).checked_sub(1)?);
    let passed = plan.header.passes.iter().zip(times_s).filter_map(|(pass, times_s)| {
        let centre = row(pass.end)?.centre;
        Some(times_s.as_ref()?.iter().map(move |t_s| (*t_s, centre)))
    });
    let rested = assigned.places(published).map(|(t_s, pose)| (t_s, poses.rows[pose].centre));
    let mut places: Vec<(f64, u32)> = rested.chain(passed.flatten()).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let balls = &plan.header.job.centres;
    let centre_mm = |id: u32| balls.iter().find(|ball| ball.id == id).map(|ball| ball.xyz_mm.into());
    let stretch = |same: &[(f64, u32)]| {
        let (first, last) = (same.first()?, same.last()?);
        Some(OnBall { from_s: first.0 - AROUND_S, to_s: last.0 + AROUND_S, centre_mm: centre_mm(first.1)? })
    };
    places.chunk_by(|a, b| a.1 == b.1).filter_map(stretch).collect()
}

/// The greatest distance of two poses in one axis, degrees.
fn apart_deg(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// How near a rest must be to each pose, degrees.
pub(super) fn reach_deg(poses: &[[f64; AXES]]) -> Vec<f64> {
    let nearest = |pose: &[f64; AXES]| {
        let others = poses.iter().map(|other| apart_deg(pose, other)).filter(|deg| *deg > SAME_DEG);
        others.fold(FAR_DEG / NEAR, f64::min)
    };
    poses.iter().map(|pose| NEAR * nearest(pose)).collect()
}

/// Scores of the best alignments of the first rests and poses, and of the last ones.
struct Table {
    poses: usize,
    scores: Vec<i64>,
}

impl Table {
    fn at(&self, rest: usize, pose: usize) -> i64 {
        self.scores[rest * (self.poses + 1) + pose]
    }

    /// By rests and poses in the order of `near(rest, pose)`; passing over a pose before the rest costs `cost(rest)`.
    fn new(
        rests: usize,
        poses: usize,
        near: impl Fn(usize, usize) -> bool,
        cost: impl Fn(usize) -> i64,
    ) -> Self {
        let mut table = Self { poses, scores: vec![0; (rests + 1) * (poses + 1)] };
        for rest in 0..=rests {
            for pose in 0..=poses {
                let mut best = if rest + pose == 0 { 0 } else { i64::MIN };
                if rest > 0 {
                    best = best.max(table.at(rest - 1, pose));
                }
                if pose > 0 {
                    best = best.max(table.at(rest, pose - 1) - cost(rest));
                }
                if rest > 0 && pose > 0 && near(rest - 1, pose - 1) {
                    best = best.max(table.at(rest - 1, pose - 1) + PAIR);
                }
                table.scores[rest * (poses + 1) + pose] = best;
            }
        }
        table
    }
}

/// The rests that are a pose's in some best alignment, for each pose, and how many poses each rest is so.
struct Candidates {
    rests: Vec<Vec<usize>>,
    shared: Vec<usize>,
}

fn candidates(rests: &[Rest], poses: &[[f64; AXES]], lost: &[bool]) -> Candidates {
    let reach = reach_deg(poses);
    let (many, all) = (rests.len(), poses.len());
    let near = |rest: usize, pose: usize| apart_deg(&rests[rest].axes_deg, &poses[pose]) <= reach[pose];
    // Before the first rest and after the last, and where packets are lost, poses may have been without a trace.
    let cost = |rest: usize| i64::from(rest > 0 && rest < many && !lost[rest]);
    let forward = Table::new(many, all, near, cost);
    let backward =
        Table::new(many, all, |rest, pose| near(many - 1 - rest, all - 1 - pose), |rest| cost(many - rest));
    let best = forward.at(many, all);
    let mut found = Candidates { rests: vec![Vec::new(); all], shared: vec![0; many] };
    for pose in 0..all {
        for rest in (0..many).filter(|rest| near(*rest, pose)) {
            let through = forward.at(rest, pose) + PAIR + backward.at(many - 1 - rest, all - 1 - pose);
            if through == best {
                found.rests[pose].push(rest);
                found.shared[rest] += 1;
            }
        }
    }
    found
}

/// The rest of each pose, and by how many poses it may be shared.
pub(super) struct Assigned {
    rests: Vec<Option<(usize, usize)>>,
}

/// Which rest is at which pose.
pub(super) fn assign(poses: &Poses<'_>, published: &Published<'_>) -> Assigned {
    let rests = &published.rests;
    let places: Vec<[f64; AXES]> = poses.rows.iter().map(|row| row.axes_deg).collect();
    let lost: Vec<bool> = (0..rests.len())
        .map(|at| at > 0 && !published.is_whole(rests[at - 1].end_s, rests[at].start_s))
        .collect();
    let found = candidates(rests, &places, &lost);
    let of_pose = |(of_pose, wait_s): (&Vec<usize>, f64)| {
        let shared = of_pose.iter().map(|rest| found.shared[*rest]).max().unwrap_or(1);
        Some((choose(rests, of_pose, wait_s)?, shared))
    };
    let waits_s = poses.commanded.iter().map(|pose| pose.wait_s);
    Assigned { rests: found.rests.iter().zip(waits_s).map(of_pose).collect() }
}

impl Assigned {
    /// The middles of the rests, s of the track, each with the position of its pose.
    pub(super) fn places<'b>(
        &'b self,
        published: &'b Published<'_>,
    ) -> impl Iterator<Item = (f64, usize)> + 'b {
        let middle = |rest: usize| published.rests.get(rest).map(|rest| 0.5 * (rest.start_s + rest.end_s));
        self.rests
            .iter()
            .enumerate()
            .filter_map(move |(pose, found)| Some((middle(found.as_ref()?.0)?, pose)))
    }

    /// The dwells of the poses, in the bar's time.
    pub(super) fn paired(&self, input: &Input<'_>, poses: &Poses<'_>, published: &Published<'_>) -> Paired {
        let mut dwells: Vec<Dwell> = Vec::new();
        let mut pairings = Vec::new();
        for (found, pose) in self.rests.iter().zip(&poses.commanded) {
            let Some((rest, shared)) =
                found.and_then(|(rest, shared)| Some((published.rests.get(rest)?, shared)))
            else {
                pairings.push(Pairing::None { posterior: 1.0 });
                continue;
            };
            let number = dwells.len();
            let dwell = dwell(input, published, rest, pose.wait_s);
            pairings.push(if shared == 1 && dwell.is_ok() {
                Pairing::Dwell { dwell: number, posterior: 1.0 }
            } else {
                Pairing::Ambiguous { dwell: number, posterior: 1.0 / (shared.max(2) as f64) }
            });
            dwells.push(dwell.unwrap_or_else(|whole| whole));
        }
        Paired { source: DwellSource::Axes, dwells, pairings, override_factor: None, findings: Vec::new() }
    }
}

/// When the axes went by the points of each pass, one after the other, s of the track; `None` where they did not.
pub(super) fn pass_times(input: &Input<'_>, published: &Published<'_>) -> Vec<Option<Vec<f64>>> {
    let mut from = 0;
    let mut times = Vec::new();
    for pass in &input.plan.header.passes {
        let [first, last] = pass.points.map(|index| (index as usize).saturating_sub(1));
        let rows = input.plan.rows.get(first..=last).unwrap_or_default();
        let points: Vec<[f64; AXES]> = rows.iter().map(|row| row.axes_deg).collect();
        let found = went_by(published, &points, from);
        if let Some(last_s) = found.as_ref().and_then(|times| times.last()) {
            from = published.track.at(*last_s);
        }
        times.push(found);
    }
    times
}

/// The first time after a sample at which the axes go by all points in order.
fn went_by(published: &Published<'_>, points: &[[f64; AXES]], from: usize) -> Option<Vec<f64>> {
    let reach = reach_deg(points);
    let (first, reach_first) = (points.first()?, *reach.first()?);
    let mut at = from;
    while let Some(start) = next_nearest(published, first, reach_first, at..published.track.len()) {
        let mut times = vec![time_at(published, first, start)];
        let (mut here, mut last) = (start, start);
        for (point, reach) in points.iter().zip(&reach).skip(1) {
            // As long as some of the steps before, and a while for the first.
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

/// The first sample of a range at which the axes are nearest to a point, within reach.
fn next_nearest(
    published: &Published<'_>,
    point: &[f64; AXES],
    reach: f64,
    range: std::ops::Range<usize>,
) -> Option<usize> {
    let axes = &published.track.measured_deg;
    let apart = |at: usize| axes.get(at).map(|axes| square_deg(axes, point));
    let within = |at: &usize| axes.get(*at).is_some_and(|axes| apart_deg(axes, point) <= reach);
    range.take_while(|at| *at < axes.len()).filter(within).find(|at| {
        let here = apart(*at);
        here.is_some_and(|here| apart(at + 1).is_none_or(|next| next > here))
            && at.checked_sub(1).and_then(apart).is_none_or(|before| here.is_some_and(|here| before >= here))
    })
}

fn square_deg(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// When the axes are nearest to a point, by their motion about the nearest sample.
fn time_at(published: &Published<'_>, point: &[f64; AXES], at: usize) -> f64 {
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

/// Of several rests at a pose that whose duration is the program's; of rests alike the last.
fn choose(rests: &[Rest], of_pose: &[usize], wait_s: f64) -> Option<usize> {
    let off = |rest: usize| (rests[rest].end_s - rests[rest].start_s - wait_s).abs();
    let least = of_pose.iter().map(|rest| off(*rest)).fold(f64::INFINITY, f64::min);
    of_pose.iter().rev().copied().find(|rest| off(*rest) <= least + ALIKE_S)
}

/// When a rest was read; the whole rest as an error where the bar was not the same at both of its ends.
fn dwell(input: &Input<'_>, published: &Published<'_>, rest: &Rest, wait_s: f64) -> Result<Dwell, Dwell> {
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
    // A HALT before the dwell, or a pause after it: the bar may have been handled.
    let last_s = whole.until_s - motion.dwell_s;
    let first = measure(input.stream, whole.settled_s, whole.settled_s + motion.dwell_s);
    let last = measure(input.stream, last_s, whole.until_s);
    match (first, last) {
        (Some(a), Some(b)) if (a.reading_mm - b.reading_mm).abs() > SAME_MM + 4.0 * a.u_mm.hypot(b.u_mm) => {
            Err(whole)
        }
        (None, Some(_)) => Ok(Dwell { settled_s: last_s, ..whole }),
        _ => Ok(whole),
    }
}
