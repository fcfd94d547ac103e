//! From a stream of lengths and a plan to observations: the device's clock, the dwells, and which dwell
//! is which pose. Pure and deterministic.
//!
//! Dwells come from the controller's reports where there are any (they carry the plan's index), else
//! from its strobe, else from stretches in which the length stands still.

mod align;
mod clock_map;
mod commanded;
mod drift;
mod duration;
mod dwell;
mod faint;
mod fate;
mod hull;
mod interval;
mod lattice;
mod parabola;
mod passes;
mod report;
mod rest;
mod robust;
mod seen;
mod still;
mod stream;
mod strobe;
mod telegram;
mod windows;

use std::collections::BTreeMap;

use crate::model::{AXES, Further, Observation, Observations};
use crate::plan::{CirclePlace, Kind, Plan, PlanRow};

pub use align::{Alignment, Pairing, align};
pub use clock_map::{Break, ClockMap, DeviceClock};
pub use drift::Drift;
pub use dwell::{Dwell, measure};
pub use fate::{Fate, PoseFate};
pub use hull::Segment;
pub use interval::Commanded;
pub use passes::Lag;
pub use report::{Report, reported_axes};
pub use seen::{Expected, LEAST_START_SD_S, Seen, Stretch};
pub use still::find as find_still;
pub use stream::{Stream, StreamBuilder};
pub use strobe::{Strobed, find as find_strobed};
pub use telegram::{Heard, LONGEST_TELEGRAM, Telegram, TelegramReader, run_number};

use commanded::Poses;
use passes::Passed;

/// What a run is joined from.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// What was commanded.
    pub plan: &'a Plan,
    /// What the bar read.
    pub stream: &'a Stream,
    /// What the controller reported, in order of arrival; may be empty.
    pub reports: &'a [Report],
    /// Lengths that a model predicts for the plan's dwell rows, in order.
    pub expected: Option<Expected<'a>>,
    /// The bar's own standard deviation, mm: no observation claims to be better. 0 if unknown.
    pub bar_sigma_mm: f64,
    /// Axis angles (degrees) that the program logged, by the plan's index; they replace the commanded.
    pub axes_deg: Option<&'a BTreeMap<u32, [f64; AXES]>>,
}

impl Synced {
    /// Whether the same dwells belong to the same poses as in `other`.
    pub fn same_pairs(&self, other: &Self) -> bool {
        let pair = |pose: &PoseFate| match &pose.fate {
            Fate::Matched { dwell, .. } => Some((dwell.from_s, dwell.to_s)),
            _ => None,
        };
        self.fates.iter().map(pair).eq(other.fates.iter().map(pair))
    }
}

/// Lengths that a model expects at the plan's dwells, in order, mm: what [`Expected`] takes. `length_mm` is
/// given the number of the base ball and the axis angles (degrees): the logged ones where there are any.
pub fn expected_lengths(
    plan: &Plan,
    axes_deg: Option<&BTreeMap<u32, [f64; AXES]>>,
    length_mm: impl Fn(usize, &[f64; AXES]) -> f64,
) -> Vec<f64> {
    let dwells = plan.rows.iter().filter(|row| commanded::stops(row));
    dwells
        .map(|row| {
            let logged = axes_deg.and_then(|axes| axes.get(&row.index));
            length_mm(row.centre as usize, logged.unwrap_or(&row.axes_deg))
        })
        .collect()
}

impl<'a> Input<'a> {
    /// A plan and a stream alone.
    pub fn new(plan: &'a Plan, stream: &'a Stream) -> Self {
        Self { plan, stream, reports: &[], expected: None, bar_sigma_mm: 0.0, axes_deg: None }
    }
}

/// How the dwells were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// By the controller's reports.
    Reports,
    /// By its strobe.
    Strobe,
    /// By stretches without motion.
    Stillness,
}

/// What the user should know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Whether it puts the result in doubt.
    pub doubt: bool,
    /// What it is.
    pub text: String,
}

/// A run, joined.
#[derive(Clone, Debug, PartialEq)]
pub struct Synced {
    /// The lengths with the angles they were read at, in the plan's order, measure and reference rows;
    /// further columns `kind,t_s,samples,creep,circle,angle_deg` (`creep` is 1 where the reading drifted
    /// within the dwell; `circle` and the pose's angle on it are empty for a pose of no circle).
    ///
    /// `sigma_mm` is the standard uncertainty of the dwell's mean, not less than the bar's own. The
    /// robot's repeatability is not in it: no dwell shows it, the residuals of an identification do.
    pub observations: Observations,
    /// What became of each of the plan's dwells, in order.
    pub fates: Vec<PoseFate>,
    /// Dwells that belong to no pose.
    pub spurious: Vec<Stretch>,
    /// How the dwells were found.
    pub source: Source,
    /// The override that the moves were driven with, 0..1, where it was estimated.
    pub override_factor: Option<f64>,
    /// What the passes of continuous circles tell of the lag between command and reading.
    pub lags: Vec<Lag>,
    /// Change of the length at the repeated reference pose, where it was read twice or more.
    pub drift: Option<Drift>,
    /// What the user should know.
    pub warnings: Vec<Warning>,
}

/// A uniform reading without any noise is known to this step, mm.
const LEAST_STEP_MM: f64 = 1e-4;
/// Kept free of a still stretch's end, s: the begin of the next move is seen late.
const GUARD_S: f64 = 0.15;
/// A dwell of which less than this share was read says too little.
const LEAST_SHARE: f64 = 0.3;

/// A dwell before it is known which pose it is.
#[derive(Clone, Copy)]
struct Candidate {
    stretch: Stretch,
    /// From when on the reading counts, s.
    from_s: f64,
    /// Until when it may count at most, s.
    to_s: f64,
}

/// Joins a run.
pub fn observations(input: &Input<'_>) -> Synced {
    let poses = Poses::of(input.plan);
    let passed = passes::read(input);
    let mut notes = Vec::new();
    let reported = report::stretches(input.reports, input.stream);
    let (source, candidates, pairings, override_factor) = if let Some(reported) = reported {
        by_reports(&poses, &reported)
    } else if strobe::present(input.stream) {
        by_strobe(input, &poses, &passed, &mut notes)
    } else {
        by_stillness(input, &poses)
    };
    let period_s = input.stream.period_s();
    let circle_places = input.plan.circle_places();
    let mut used = vec![false; candidates.len()];
    let mut fates = Vec::new();
    let mut rows = Vec::new();
    let mut further = Further::new(["kind", "t_s", "samples", "creep", "circle", "angle_deg"]);
    let places = fate::Places::new(&poses, &candidates, &pairings, override_factor.unwrap_or(1.0));
    for (at, pairing) in pairings.iter().enumerate() {
        let row = poses.rows[at];
        let fate = match *pairing {
            Pairing::Dwell { dwell, posterior } => {
                used[dwell] = true;
                let candidate = candidates[dwell];
                let to_s = candidate.to_s.min(candidate.from_s + row.dwell_s);
                match measure(input.stream, candidate.from_s, to_s) {
                    Some(value) if enough(period_s, &value, row.dwell_s) => {
                        let place = (row.index as usize).checked_sub(1).and_then(|at| circle_places.get(at));
                        rows.push(observation(input, row, place.copied().flatten(), &value, &mut further));
                        Fate::Matched { dwell: value, posterior }
                    }
                    _ => Fate::Missing { reason: fate::unread(input.stream, candidate.stretch) },
                }
            }
            Pairing::None { .. } => Fate::Missing { reason: places.reason(at, input.stream, source) },
            Pairing::Ambiguous { dwell, posterior } => {
                used[dwell] = true;
                let start_s = candidates[dwell].stretch.start_s;
                let percent = 100.0 * posterior;
                let reason = format!("the dwell at {start_s:.1} s is this pose with {percent:.0} % only");
                Fate::Ambiguous { reason }
            }
        };
        fates.push(PoseFate { index: row.index, fate });
    }
    let spurious =
        candidates.iter().zip(used).filter(|(_, used)| !used).map(|(candidate, _)| candidate.stretch);
    let spurious = spurious.filter(|stretch| !passed.holds(stretch)).collect();
    let drift = drift::of(&poses.rows, &fates);
    for (pose, timing_mm) in passed.fates.iter().zip(&passed.timing_mm) {
        let at = (pose.index as usize).checked_sub(1);
        if let (Fate::Matched { dwell, .. }, Some(row)) =
            (&pose.fate, at.and_then(|at| input.plan.rows.get(at)))
        {
            let place = at.and_then(|at| circle_places.get(at)).copied().flatten();
            let known = Dwell { u_mm: dwell.u_mm.hypot(*timing_mm), ..*dwell };
            rows.push(observation(input, row, place, &known, &mut further));
        }
    }
    fates.extend(passed.fates);
    fates.sort_by_key(|pose| pose.index);
    rows.sort_by_key(|row| row.index);
    let mut synced = Synced {
        observations: Observations { rows, further },
        fates,
        spurious,
        source,
        override_factor: override_factor.filter(|_| !poses.rows.is_empty()),
        lags: passed.lags,
        drift,
        warnings: Vec::new(),
    };
    for circle in passed.one_way {
        let ms = 1000.0 * passes::LAG_SD_S;
        let text = format!(
            "circle {circle} was not passed both ways: the reading is taken to come 0 +- {ms:.0} ms after the command"
        );
        notes.push(Warning { doubt: false, text });
    }
    notes.extend(fate::warnings(&synced, input.stream));
    notes.extend(fate::elsewhere(&synced, input.plan));
    synced.warnings = notes;
    synced
}

type Paired = (Source, Vec<Candidate>, Vec<Pairing>, Option<f64>);

/// The reports name the plan's index themselves.
fn by_reports(poses: &Poses<'_>, reported: &BTreeMap<u32, Stretch>) -> Paired {
    let mut candidates = Vec::new();
    let pairings = poses
        .rows
        .iter()
        .map(|row| match reported.get(&row.index) {
            Some(&stretch) => {
                candidates.push(Candidate { stretch, from_s: stretch.start_s, to_s: stretch.end_s });
                Pairing::Dwell { dwell: candidates.len() - 1, posterior: 1.0 }
            }
            None => Pairing::None { posterior: 1.0 },
        })
        .collect();
    (Source::Reports, candidates, pairings, None)
}

/// The n-th strobe of a module is its n-th dwell, if all of the module are there and the intervals do not
/// object; in a module with one too few or too many the intervals tell.
fn by_strobe(input: &Input<'_>, poses: &Poses<'_>, passed: &Passed, notes: &mut Vec<Warning>) -> Paired {
    let mut strobed = find_strobed(input.stream);
    strobed.retain(|dwell| !passed.holds(&dwell.stretch));
    let candidates: Vec<Candidate> = strobed
        .iter()
        .map(|&Strobed { stretch, .. }| Candidate { stretch, from_s: stretch.start_s, to_s: stretch.end_s })
        .collect();
    let seen = seen(input, &candidates, false);
    let alignment = align(&poses.commanded, &seen, input.expected);
    let mut pairings = alignment.pairings;
    let commanded: Vec<usize> = poses.commanded.iter().map(|pose| pose.module).collect();
    let told: Vec<usize> = strobed.iter().map(|dwell| dwell.module).collect();
    for (module, (poses, dwells)) in strobe::counts(&commanded, &told).into_iter().enumerate() {
        if poses.len() != dwells.len() {
            let (seen, wanted) = (dwells.len(), poses.len());
            let text = format!(
                "module {}: {seen} strobes were seen where {wanted} dwells are commanded",
                module + 1
            );
            notes.push(Warning { doubt: true, text });
            continue;
        }
        let objects = poses.clone().zip(dwells.clone()).any(|(pose, dwell)| match pairings[pose] {
            Pairing::Dwell { dwell: other, .. } => dwell != other,
            Pairing::None { .. } => true,
            Pairing::Ambiguous { .. } => false,
        });
        if !objects {
            for (pose, dwell) in poses.zip(dwells) {
                pairings[pose] = Pairing::Dwell { dwell, posterior: 1.0 };
            }
        }
    }
    (Source::Strobe, candidates, pairings, Some(alignment.override_factor))
}

fn by_stillness(input: &Input<'_>, poses: &Poses<'_>) -> Paired {
    let motion = &input.plan.header.job.motion;
    let shortest_s = poses.commanded.iter().map(|pose| pose.wait_s).fold(f64::INFINITY, f64::min);
    let least_s = if shortest_s.is_finite() { (0.5 * shortest_s).max(0.3) } else { 0.3 };
    let mut candidates: Vec<Candidate> = find_still(input.stream, least_s)
        .into_iter()
        .map(|stretch| Candidate {
            stretch,
            from_s: stretch.start_s + motion.settle_s,
            to_s: stretch.end_s - GUARD_S,
        })
        .collect();
    let seen = seen(input, &candidates, true);
    let mut alignment = align(&poses.commanded, &seen, input.expected);
    faint::unseen(poses, &mut candidates, &mut alignment, input.stream, motion.settle_s);
    (Source::Stillness, candidates, alignment.pairings, Some(alignment.override_factor))
}

/// The candidates as the alignment needs them; `waits` when they last as long as the program waits.
fn seen(input: &Input<'_>, candidates: &[Candidate], waits: bool) -> Vec<Seen> {
    let job = &input.plan.header.job;
    let mut before_s = f64::NEG_INFINITY;
    candidates
        .iter()
        .map(|candidate| {
            let Stretch { start_s, end_s, start_sd_s } = candidate.stretch;
            let lasts_s = waits.then_some(end_s - start_s);
            let to_s = candidate.to_s.min(candidate.from_s + job.motion.dwell_s);
            // Only needed against expected lengths; a dwell without a reading is far from any.
            let reading_mm = input.expected.and_then(|_| measure(input.stream, candidate.from_s, to_s));
            let length_mm = reading_mm.map_or(0.0, |dwell| job.bar.length_mm + dwell.reading_mm);
            let after_break = input.stream.broken_between(before_s, start_s);
            before_s = start_s;
            Seen { start_s, start_sd_s, lasts_s, length_mm, after_break }
        })
        .collect()
}

/// Whether enough of a dwell was read to stand for it.
fn enough(period_s: f64, dwell: &Dwell, dwell_s: f64) -> bool {
    let whole = if period_s > 0.0 { dwell_s / period_s } else { 0.0 };
    dwell.to_s - dwell.from_s >= LEAST_SHARE * dwell_s && dwell.samples as f64 >= LEAST_SHARE * whole
}

fn observation(
    input: &Input<'_>,
    row: &PlanRow,
    place: Option<CirclePlace>,
    dwell: &Dwell,
    further: &mut Further,
) -> Observation {
    let logged = input.axes_deg.and_then(|axes| axes.get(&row.index));
    let kind = if row.kind == Kind::Reference { "reference" } else { "measure" };
    Observation {
        index: row.index,
        further: further.add([
            kind.to_owned(),
            format!("{:.4}", 0.5 * (dwell.from_s + dwell.to_s)),
            dwell.samples.to_string(),
            u8::from(dwell.creep_mm.is_some()).to_string(),
            place.map_or(String::new(), |_| row.circle.to_string()),
            place.map_or(String::new(), |place| place.angle_deg.to_string()),
        ]),
        centre: row.centre as usize,
        bar: 1,
        axes_deg: logged.copied().unwrap_or(row.axes_deg),
        length_mm: input.plan.header.job.bar.length_mm + dwell.reading_mm,
        sigma_mm: Some(dwell.u_mm.max(input.bar_sigma_mm)),
    }
}
