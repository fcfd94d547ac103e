//! Lengths at the points of a pass without stops: the commanded path against time.
//!
//! Strobe or reports tell when the motion began and ended; how long it took against the plan tells the
//! override. What is read comes later than what is commanded, by the lag of the drives and the delays of
//! output and line. At a constant speed these are one number, and a pass each way tells it: the length at an
//! angle is then read early on the one and late on the other.

use std::ops::Range;

use super::Input;
use super::fate::{Fate, PoseFate};
use super::parabola::{Passing, passing};
use super::report;
use super::seen::Stretch;
use super::strobe;
use crate::plan::{Kind, Pass, Plan};

/// What a pair of passes over one circle tells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// The circle's number.
    pub circle: u32,
    /// How much later the reading comes than the commanded motion, s.
    pub lag_s: f64,
    /// Its standard deviation, s.
    pub sd_s: f64,
    /// Counter-clockwise less clockwise length, mm: what play and friction leave.
    pub hysteresis_mm: f64,
}

/// The passes of a run, read.
#[derive(Clone, Debug, Default)]
pub(super) struct Passed {
    /// What became of their points.
    pub(super) fates: Vec<PoseFate>,
    /// How much a point's length is uncertain by the lag, mm, for each of `fates`.
    pub(super) timing_mm: Vec<f64>,
    pub(super) lags: Vec<Lag>,
    /// Circles of which no pair of passes tells the lag.
    pub(super) one_way: Vec<u32>,
    /// When the robot was on a pass, s.
    pub(super) spans_s: Vec<Range<f64>>,
}

/// Before a pair tells it the lag is known to be about 0, with this standard deviation, s.
pub(super) const LAG_SD_S: f64 = 0.05;
/// A motion lasts as planned over the override: no longer than this many times, no shorter.
const STRETCHES: Range<f64> = 0.97..10.0;
/// Angles that are the same one, degrees.
const SAME_DEG: f64 = 0.01;

/// A pass that was found.
struct Found<'a> {
    pass: &'a Pass,
    start_s: f64,
    /// How many times as long as planned it took.
    stretch: f64,
}

/// Reads the passes of the plan.
pub(super) fn read(input: &Input<'_>) -> Passed {
    let passes = &input.plan.header.passes;
    let mut passed = Passed::default();
    let spans = spans(input);
    let mut circles: Vec<u32> = passes.iter().map(|pass| pass.circle).collect();
    circles.dedup();
    for circle in circles {
        let mut found = Vec::new();
        for (pass, span) in passes.iter().zip(&spans).filter(|(pass, _)| pass.circle == circle) {
            let checked = span.clone().and_then(|span| check(input, pass, &span).map(|found| (found, span)));
            match checked {
                Ok((one, span)) => {
                    passed.spans_s.push(span);
                    found.push(one);
                }
                Err(reason) => passed.lose(pass, &reason),
            }
        }
        passed.circle(input, circle, &found);
    }
    passed
}

impl Passed {
    /// Whether a stretch lies on a pass.
    pub(super) fn holds(&self, stretch: &Stretch) -> bool {
        let middle_s = 0.5 * (stretch.start_s + stretch.end_s);
        self.spans_s.iter().any(|span| span.contains(&middle_s))
    }

    fn lose(&mut self, pass: &Pass, reason: &str) {
        for index in pass.points[0]..=pass.points[1] {
            self.push(index, Fate::Missing { reason: reason.to_owned() }, 0.0);
        }
    }

    fn push(&mut self, index: u32, fate: Fate, timing_mm: f64) {
        self.fates.push(PoseFate { index, fate });
        self.timing_mm.push(timing_mm);
    }

    /// The passes over one circle, of which any number was found.
    fn circle(&mut self, input: &Input<'_>, circle: u32, found: &[Found<'_>]) {
        let read = |lag_s: f64| -> Vec<Vec<(u32, Option<Passing>)>> {
            found.iter().map(|one| one.points(input, lag_s)).collect()
        };
        let (mut lag_s, mut sd_s) = (0.0, LAG_SD_S);
        let mut points = read(lag_s);
        // Each round looks where the one before says; the fit is linear in what is left.
        for round in 0..3 {
            let Some((left_s, left_sd_s, hysteresis_mm)) = lag(input.plan, found, &points) else { break };
            // What is known of lags at all counts as one observation more.
            let [prior, told] = [LAG_SD_S, left_sd_s].map(|sd| 1.0 / (sd * sd));
            lag_s = told * (lag_s + left_s) / (told + prior);
            sd_s = 1.0 / (told + prior).sqrt();
            points = read(lag_s);
            if round == 2 {
                self.lags.push(Lag { circle, lag_s, sd_s, hysteresis_mm });
            }
        }
        if !found.is_empty() && self.lags.last().is_none_or(|last| last.circle != circle) {
            self.one_way.push(circle);
        }
        for (index, passing) in points.into_iter().flatten() {
            match passing {
                Some(Passing { dwell, slope_mm_s }) => {
                    self.push(index, Fate::Matched { dwell, posterior: 1.0 }, slope_mm_s.abs() * sd_s);
                }
                None => {
                    let reason = "the bar sent too little while the robot passed".to_owned();
                    self.push(index, Fate::Missing { reason }, 0.0);
                }
            }
        }
    }
}

impl Found<'_> {
    /// What was read at each point, `lag_s` after it was commanded.
    fn points(&self, input: &Input<'_>, lag_s: f64) -> Vec<(u32, Option<Passing>)> {
        let indices = self.pass.points[0]..=self.pass.points[1];
        let mut t_s = self.start_s + lag_s;
        let times_s: Vec<f64> = indices
            .clone()
            .map(|index| {
                let time = (index as usize).checked_sub(1).and_then(|at| input.plan.header.moves.get(at));
                t_s += self.stretch * time.map_or(0.0, |time| time.duration_s);
                t_s
            })
            .collect();
        let half_s = |at: usize| {
            let to = (at + 1).min(times_s.len() - 1);
            let from = at.saturating_sub(1);
            0.5 * (times_s[to] - times_s[from]) / (to - from).max(1) as f64
        };
        indices
            .zip(0..times_s.len())
            .map(|(index, at)| (index, passing(input.stream, times_s[at], half_s(at))))
            .collect()
    }
}

/// The lag that is left, its standard deviation, s, and the hysteresis, mm: least squares of the differences
/// between the two senses at the same angles. `None` without a pass each way, or where no length changes.
fn lag(plan: &Plan, found: &[Found<'_>], points: &[Vec<(u32, Option<Passing>)>]) -> Option<(f64, f64, f64)> {
    let places = plan.circle_places();
    let sense = |clockwise: bool| {
        let at = found.iter().position(|one| one.pass.clockwise == clockwise)?;
        let known = points.get(at)?.iter().filter_map(|(index, passing)| {
            let place = places.get((*index as usize).checked_sub(1)?)?.as_ref()?;
            Some((place.angle_deg, passing.as_ref()?))
        });
        Some(known.collect::<Vec<_>>())
    };
    let (counter, clockwise) = (sense(false)?, sense(true)?);
    let mut rows: Vec<(f64, f64)> = Vec::new();
    for (angle_deg, one) in &counter {
        let same = |other: &&(f64, &Passing)| {
            let apart = (other.0 - angle_deg).rem_euclid(360.0);
            apart.min(360.0 - apart) < SAME_DEG
        };
        if let Some((_, other)) = clockwise.iter().find(same) {
            rows.push((one.slope_mm_s - other.slope_mm_s, other.dwell.reading_mm - one.dwell.reading_mm));
        }
    }
    let count = rows.len() as f64;
    if rows.len() < 4 {
        return None;
    }
    let (x, y) = (
        rows.iter().map(|row| row.0).sum::<f64>() / count,
        rows.iter().map(|row| row.1).sum::<f64>() / count,
    );
    let xx: f64 = rows.iter().map(|row| (row.0 - x).powi(2)).sum();
    let xy: f64 = rows.iter().map(|row| (row.0 - x) * (row.1 - y)).sum();
    if xx <= 0.0 {
        return None;
    }
    let left_s = xy / xx;
    let rest: f64 = rows.iter().map(|row| (row.1 - y - left_s * (row.0 - x)).powi(2)).sum();
    let sd_s = (rest / (count - 2.0) / xx).sqrt().max(1e-6);
    Some((left_s, sd_s, left_s * x - y))
}

/// When each pass began and ended, s of the stream, or why that is not known.
fn spans(input: &Input<'_>) -> Vec<Result<Range<f64>, String>> {
    let passes = &input.plan.header.passes;
    if let Some(told) = report::spans(input.reports, input.stream) {
        let of = |pass: &Pass| told.get(&pass.end).cloned();
        return passes.iter().map(|pass| of(pass).ok_or("the controller did not report it".into())).collect();
    }
    if passes.is_empty() {
        return Vec::new();
    }
    if !strobe::present(input.stream) {
        let reason = "neither a strobe nor a report tells when the robot passed: write the program with `krl --sync output` or `ekrl`";
        return vec![Err(reason.into()); passes.len()];
    }
    // The n-th strobe is that of the n-th dwell or pass.
    let told = input.plan.rows.iter().filter(|row| {
        row.kind != Kind::Transit && !row.is_passed() || passes.iter().any(|pass| pass.end == row.index)
    });
    let told: Vec<u32> = told.map(|row| row.index).collect();
    let strobed = strobe::find(input.stream);
    if strobed.len() != told.len() {
        let reason = format!("{} strobes were seen where {} are commanded", strobed.len(), told.len());
        return vec![Err(reason); passes.len()];
    }
    passes
        .iter()
        .map(|pass| {
            let at = told.iter().position(|index| *index == pass.end);
            let one = at.and_then(|at| strobed.get(at)).ok_or("the plan has no row where it ends")?;
            Ok(one.stretch.start_s..one.stretch.end_s)
        })
        .collect()
}

fn check<'a>(input: &Input<'_>, pass: &'a Pass, span: &Range<f64>) -> Result<Found<'a>, String> {
    let took_s = span.end - span.start;
    let stretch = took_s / pass.duration_s;
    if !STRETCHES.contains(&stretch) {
        let planned_s = pass.duration_s;
        return Err(format!("the pass lasted {took_s:.1} s, which no override makes of {planned_s:.1} s"));
    }
    if input.stream.broken_between(span.start, span.end) {
        return Err("the bar's clock broke during the pass".into());
    }
    Ok(Found { pass, start_s: span.start, stretch })
}
