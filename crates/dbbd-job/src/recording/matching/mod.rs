//! Matches the stream of lengths of a run to the poses of its plan: detects dwells, and decides which dwell
//! belongs to which pose. Pure and deterministic.
//!
//! Dwells come from the published axes if there are any, else from the controller's reports (which carry the index
//! of the pose), else from its strobe, else from intervals in which the length does not change.

mod catalogue;
pub use catalogue::MatchingFinding;

mod alignment;
mod by_axes;
mod drift;
mod duration;
mod evidence;
mod frozen;
mod inferred;
mod lag;
mod markers;
mod noise;
mod outcome;
mod passes;
mod passing;
mod program;
mod published;
mod stillness;
mod trellis;
mod visits;
mod windows;

use std::collections::BTreeMap;
use std::sync::Arc;

use super::dwell::{Dwell, DwellReading, reading_between};
use super::reports::{self, DwellReport, reported_dwells};
use super::stream::SampleStream;
use super::strobe_decoder::{has_strobe, strobed_dwells};
use crate::plan::{Plan, PlanRow};
use crate::recording::matching::MatchingFinding as Finding;
use dbbd_model::measurement::{
    AxisAngles, BallId, BarId, CircleId, ContextColumn, Measurement, MeasurementContext, Measurements,
};
use dbbd_model::robot::{AXES, Approach, Datum, TargetId};

pub use alignment::{Pairing, PoseAlignment, align};
pub use drift::LengthDrift;
pub use evidence::{DwellEvidence, ExpectedLengths};
pub use lag::BarLag;
pub use markers::MarkerFit;
pub use outcome::{MatchOutcome, PoseOutcome, nothing_matched};
pub use passes::PassLag;
pub use program::CommandedDwell;
pub use published::{AxesReport, PublishedAxes};
pub use stillness::still_dwells;

use outcome::ExpectedTimes;
use passes::{MatchedPasses, PassPoint};
use program::DwellPoses;

/// Measured axis angles, degrees, by the plan's index.
pub type MeasuredAxes = BTreeMap<u32, [f64; AXES]>;

/// A plan with what was recorded while it was driven.
#[derive(Clone, Copy, Debug)]
pub struct MatchingInput<'a> {
    pub plan: &'a Plan,
    pub stream: &'a SampleStream,
    /// Reports of the controller in order of arrival; may be empty.
    pub reports: &'a [DwellReport],
    /// Lengths that a model predicts for the dwells of the plan, in order.
    pub expected: Option<ExpectedLengths<'a>>,
    /// Standard deviation of the bar, mm, the least of any measurement; 0 if unknown.
    pub bar_sigma_mm: f64,
    /// Replace the commanded angles.
    pub axes_deg: Option<&'a MeasuredAxes>,
    /// Show the dwells, and replace all other angles.
    pub published: Option<PublishedAxes<'a>>,
}

impl<'a> MatchingInput<'a> {
    pub fn new(plan: &'a Plan, stream: &'a SampleStream) -> Self {
        Self {
            plan,
            stream,
            reports: &[],
            expected: None,
            bar_sigma_mm: 0.0,
            axes_deg: None,
            published: None,
        }
    }
}

/// How the dwells were detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DwellSource {
    Reports,
    Strobe,
    /// Rests of the published axes.
    Axes,
    /// Intervals without a change of length.
    Stillness,
}

#[derive(Clone, Debug, PartialEq)]
pub struct PoseMatching {
    /// Lengths with the axis angles at which they were read, in the plan's order. The columns beyond the required
    /// ones are `kind,t_s,samples,creep,circle,angle_deg`: `creep` is 1 if the reading drifted within the dwell;
    /// `circle` and `angle_deg` are empty for a pose of no circle.
    ///
    /// `sigma_mm` is the standard uncertainty of the mean of the dwell, at least that of the bar. It does not
    /// contain the robot's repeatability, which only the residuals of an identification show.
    pub observations: Measurements,
    /// One outcome for each dwell of the plan, in order.
    pub outcomes: Vec<PoseOutcome>,
    pub spurious: Vec<Dwell>,
    pub source: DwellSource,
    /// Speed override of the moves, 0..1, if it was estimated.
    pub override_factor: Option<f64>,
    /// Lag of the reading behind the command on each continuous circle that shows it.
    pub lags: Vec<PassLag>,
    /// Drift of the length at the reference pose, if it was read twice or more.
    pub drift: Option<LengthDrift>,
    /// Results from the published axes, if they were used.
    pub axes: Option<AxesReport>,
    pub findings: Vec<Finding>,
}

impl PoseMatching {
    /// Whether both match the same dwells to the same poses.
    pub fn same_pairs(&self, other: &Self) -> bool {
        let pair = |pose: &PoseOutcome| pose.reading().map(|reading| (reading.from_s, reading.to_s));
        self.outcomes.iter().map(pair).eq(other.outcomes.iter().map(pair))
    }
}

/// Lengths that a model predicts for the dwells of the plan, in order, mm. `length_mm` takes the base ball and the
/// axis angles in degrees: measured ones if there are any.
pub fn expected_lengths(
    plan: &Plan,
    axes_deg: Option<&MeasuredAxes>,
    length_mm: impl Fn(BallId, &[f64; AXES]) -> f64,
) -> Vec<f64> {
    let dwells = plan.rows.iter().filter(|row| program::stops(row));
    dwells
        .map(|row| {
            let measured = axes_deg.and_then(|axes| axes.get(&row.index));
            length_mm(ball(row), measured.unwrap_or(&row.axes_deg))
        })
        .collect()
}

/// Kept clear of the end of a still interval, s: the start of the next move is detected late.
const GUARD_S: f64 = 0.15;
/// Least share of a dwell that must have been read.
const MIN_READ_SHARE: f64 = 0.3;

/// Everything that was detected in a run.
struct DwellDetection {
    source: DwellSource,
    dwells: Vec<Dwell>,
    /// One for each pose at which the robot stops.
    pairings: Vec<Pairing>,
    override_factor: Option<f64>,
    passes: MatchedPasses,
    /// Measured axes, degrees, by the plan's index.
    axes_deg: MeasuredAxes,
    report: Option<AxesReport>,
    findings: Vec<Finding>,
}

impl DwellDetection {
    fn new(source: DwellSource, dwells: Vec<Dwell>, pairings: Vec<Pairing>) -> Self {
        Self {
            source,
            dwells,
            pairings,
            override_factor: None,
            passes: MatchedPasses::default(),
            axes_deg: MeasuredAxes::new(),
            report: None,
            findings: Vec::new(),
        }
    }
}

/// Matches the dwells of a run to the poses of its plan.
pub fn match_poses(input: &MatchingInput<'_>) -> PoseMatching {
    let poses = DwellPoses::of(input.plan);
    let detection = by_axes::detect_by_axes(input, &poses).unwrap_or_else(|| detect_dwells(input, &poses));
    let mut outcomes = outcomes(input, &poses, &detection);
    let drift = drift::largest(&poses.rows, &outcomes, input.bar_sigma_mm);
    let frozen = frozen::detect_frozen_reading(input.stream, &outcomes);
    let spurious = spurious(&detection);
    let DwellDetection { source, override_factor, passes, axes_deg, report, mut findings, .. } = detection;
    let observations = measurements(input, &axes_deg, &outcomes, &passes.points);
    outcomes.extend(passes.points.into_iter().map(|point| point.pose));
    outcomes.sort_by_key(|pose| pose.index);
    let one_way = |circle| Finding::OneWayCircle { circle, lag_sd_ms: 1000.0 * passes::LAG_SD_S };
    findings.extend(frozen);
    findings.extend(passes.one_way.into_iter().map(one_way));
    findings.extend(match &report {
        Some(report) => Some(report.finding()),
        None => reports::unused(input.reports, input.stream),
    });
    let mut matching = PoseMatching {
        observations,
        outcomes,
        spurious,
        source,
        override_factor: override_factor.filter(|_| !poses.rows.is_empty()),
        lags: passes.lags,
        drift,
        axes: report,
        findings,
    };
    let more = outcome::findings(&matching, input.stream);
    matching.findings.extend(more);
    let deviation = outcome::axes_deviation(&matching, input.plan);
    matching.findings.extend(deviation);
    matching
}

/// Detection by the controller's reports, else its strobe, else stillness.
fn detect_dwells(input: &MatchingInput<'_>, poses: &DwellPoses<'_>) -> DwellDetection {
    let passes = passes::read_passes(input);
    let mut detection = if let Some(reported) = reported_dwells(input.reports, input.stream) {
        by_reports(poses, &reported)
    } else if has_strobe(input.stream) {
        by_strobe(input, poses, &passes)
    } else {
        by_stillness(input, poses)
    };
    let off_pace = input.published.filter(|axes| !axes.track.is_empty());
    detection.findings.extend(off_pace.map(|axes| Finding::AxesUnused { packets: axes.track.len() }));
    DwellDetection { passes, axes_deg: input.axes_deg.cloned().unwrap_or_default(), ..detection }
}

/// The outcome of each pose at which the robot stops.
fn outcomes(
    input: &MatchingInput<'_>,
    poses: &DwellPoses<'_>,
    detection: &DwellDetection,
) -> Vec<PoseOutcome> {
    let DwellDetection { source, dwells, pairings, override_factor, .. } = detection;
    let expected = ExpectedTimes::new(poses, dwells, pairings, override_factor.unwrap_or(1.0));
    let outcome = |at: usize, pairing: &Pairing, row: &PlanRow| match *pairing {
        Pairing::Dwell { dwell, posterior } => match reading(input, &dwells[dwell], row) {
            Some(reading) => MatchOutcome::Matched { reading, posterior },
            None => MatchOutcome::Missing { reason: outcome::why_unread(input.stream, &dwells[dwell]) },
        },
        Pairing::None { .. } => MatchOutcome::Missing { reason: expected.reason(at, input.stream, *source) },
        Pairing::Ambiguous { dwell, posterior } => {
            let start_s = dwells[dwell].start_s;
            MatchOutcome::Ambiguous {
                reason: Finding::AmbiguousDwell { start_s, percent: 100.0 * posterior },
            }
        }
    };
    let pairs = pairings.iter().zip(&poses.rows).enumerate();
    pairs
        .map(|(at, (pairing, row))| PoseOutcome { index: row.index, outcome: outcome(at, pairing, row) })
        .collect()
}

/// The reading in the dwell of a row; `None` if too little was read.
fn reading(input: &MatchingInput<'_>, dwell: &Dwell, row: &PlanRow) -> Option<DwellReading> {
    let period_s = input.stream.period_s();
    let whole = if period_s > 0.0 { row.dwell_s / period_s } else { 0.0 };
    let to_s = dwell.until_s.min(dwell.settled_s + row.dwell_s);
    let suffices = |reading: &DwellReading| {
        reading.to_s - reading.from_s >= MIN_READ_SHARE * row.dwell_s
            && reading.samples as f64 >= MIN_READ_SHARE * whole
    };
    reading_between(input.stream, dwell.settled_s, to_s).filter(suffices)
}

/// The dwells that belong to no pose and no pass.
fn spurious(detection: &DwellDetection) -> Vec<Dwell> {
    let mut used = vec![false; detection.dwells.len()];
    for pairing in &detection.pairings {
        if let Pairing::Dwell { dwell, .. } | Pairing::Ambiguous { dwell, .. } = *pairing {
            used[dwell] = true;
        }
    }
    let unused = detection.dwells.iter().zip(used).filter(|(_, used)| !used).map(|(dwell, _)| *dwell);
    unused.filter(|dwell| !detection.passes.contains(dwell)).collect()
}

/// Reports carry the index of the pose.
fn by_reports(poses: &DwellPoses<'_>, reported: &BTreeMap<u32, Dwell>) -> DwellDetection {
    let mut dwells = Vec::new();
    let pairing = |row: &&PlanRow| match reported.get(&row.index) {
        Some(dwell) => {
            dwells.push(*dwell);
            Pairing::Dwell { dwell: dwells.len() - 1, posterior: 1.0 }
        }
        None => Pairing::None { posterior: 1.0 },
    };
    let pairings = poses.rows.iter().map(pairing).collect();
    DwellDetection::new(DwellSource::Reports, dwells, pairings)
}

/// The n-th strobe of a module is its n-th dwell, provided that their numbers agree and the intervals do not
/// contradict. In a module with missing or additional strobes the intervals decide.
fn by_strobe(input: &MatchingInput<'_>, poses: &DwellPoses<'_>, passes: &MatchedPasses) -> DwellDetection {
    let mut strobed = strobed_dwells(input.stream);
    strobed.retain(|strobed| !passes.contains(&strobed.dwell));
    let dwells: Vec<Dwell> = strobed.iter().map(|strobed| strobed.dwell).collect();
    let alignment = align(&poses.commanded, &evidence(input, &dwells, DwellSource::Strobe), input.expected);
    let mut pairings = alignment.pairings;
    let mut findings = Vec::new();
    let pose_modules: Vec<usize> = poses.commanded.iter().map(|pose| pose.module).collect();
    let dwell_modules: Vec<usize> = strobed.iter().map(|dwell| dwell.module).collect();
    let last_module = pose_modules.last().max(dwell_modules.last());
    for module in 0..last_module.map_or(0, |last| last + 1) {
        let of_module = |modules: &[usize]| {
            modules.partition_point(|other| *other < module)
                ..modules.partition_point(|other| *other <= module)
        };
        let (commanded, strobed) = (of_module(&pose_modules), of_module(&dwell_modules));
        if commanded.len() != strobed.len() {
            let (strobes, dwells) = (strobed.len(), commanded.len());
            findings.push(Finding::StrobeCount { module: module + 1, strobes, dwells });
            continue;
        }
        let contradicts = commanded.clone().zip(strobed.clone()).any(|(pose, dwell)| match pairings[pose] {
            Pairing::Dwell { dwell: other, .. } => dwell != other,
            Pairing::None { .. } => true,
            Pairing::Ambiguous { .. } => false,
        });
        if !contradicts {
            for (pose, dwell) in commanded.zip(strobed) {
                pairings[pose] = Pairing::Dwell { dwell, posterior: 1.0 };
            }
        }
    }
    let override_factor = Some(alignment.override_factor);
    DwellDetection { override_factor, findings, ..DwellDetection::new(DwellSource::Strobe, dwells, pairings) }
}

fn by_stillness(input: &MatchingInput<'_>, poses: &DwellPoses<'_>) -> DwellDetection {
    let settle_s = input.plan.header.job.motion.settle_s;
    let shortest_s = poses.commanded.iter().map(|pose| pose.wait_s).fold(f64::INFINITY, f64::min);
    let least_s = if shortest_s.is_finite() { (0.5 * shortest_s).max(0.3) } else { 0.3 };
    let mut dwells = still_dwells(input.stream, least_s);
    for dwell in &mut dwells {
        dwell.settled_s = dwell.start_s + settle_s;
        dwell.until_s = dwell.end_s - GUARD_S;
    }
    let evidence = evidence(input, &dwells, DwellSource::Stillness);
    let mut alignment = align(&poses.commanded, &evidence, input.expected);
    inferred::infer(poses, &mut dwells, &mut alignment, input.stream, settle_s);
    let override_factor = Some(alignment.override_factor);
    DwellDetection {
        override_factor,
        ..DwellDetection::new(DwellSource::Stillness, dwells, alignment.pairings)
    }
}

/// The dwells as the alignment takes them.
fn evidence(input: &MatchingInput<'_>, dwells: &[Dwell], source: DwellSource) -> Vec<DwellEvidence> {
    let job = &input.plan.header.job;
    let mut before_s = f64::NEG_INFINITY;
    dwells
        .iter()
        .map(|dwell| {
            let to_s = dwell.until_s.min(dwell.settled_s + job.motion.dwell_s);
            // Needed only for expected lengths; a dwell without a reading is far from all of them.
            let reading = input.expected.and_then(|_| reading_between(input.stream, dwell.settled_s, to_s));
            let after_break = input.stream.broken_between(before_s, dwell.start_s);
            before_s = dwell.start_s;
            DwellEvidence {
                start_s: dwell.start_s,
                start_sd_s: dwell.start_sd_s,
                // A strobe is high while the program reads, not as long as it waits.
                duration_s: (source == DwellSource::Stillness).then(|| dwell.duration_s()),
                length_mm: reading.map_or(0.0, |reading| job.bar.length_mm + reading.reading_mm),
                after_break,
            }
        })
        .collect()
}

const COLUMNS: [ContextColumn; 6] = [
    ContextColumn::Kind,
    ContextColumn::TimeS,
    ContextColumn::Samples,
    ContextColumn::Creep,
    ContextColumn::Circle,
    ContextColumn::AngleDeg,
];

fn ball(row: &PlanRow) -> BallId {
    BallId::numbered(row.centre)
}

/// The measurements of the poses at which the robot stopped, and of those that it passed.
fn measurements(
    input: &MatchingInput<'_>,
    axes_deg: &MeasuredAxes,
    stopped: &[PoseOutcome],
    passed: &[PassPoint],
) -> Measurements {
    let plan = input.plan;
    let (places, approaches) = (plan.circle_places(), plan.approaches().collect::<Vec<Approach>>());
    let measurement = |pose: &PoseOutcome, timing_mm: f64| {
        let reading = pose.reading()?;
        let at = (pose.index as usize).checked_sub(1)?;
        let row = plan.rows.get(at)?;
        let place = places.get(at).copied().flatten();
        let taught = plan.taught().find(|taught| taught.centre == row.centre);
        let context = MeasurementContext {
            kind: Some(row.kind),
            time_s: Some(reading.middle_s()),
            samples: Some(reading.samples),
            creep: Some(reading.creep_mm.is_some()),
            circle: place.and_then(|_| CircleId::new(row.circle)),
            angle_deg: place.map(|place| place.angle_deg),
            taught_deg: taught.map(|taught| Box::new(taught.axes_deg)),
            ..MeasurementContext::default()
        };
        Some(Measurement {
            index: row.index,
            datum: Datum::Ball(ball(row), BarId::FIRST),
            target: TargetId::FIRST,
            axes: AxisAngles::from_degrees(*axes_deg.get(&row.index).unwrap_or(&row.axes_deg)),
            approach: approaches.get(at).copied().unwrap_or_default(),
            length_mm: plan.header.job.bar.length_mm + reading.reading_mm,
            sigma_mm: Some(reading.u_mm.hypot(timing_mm).max(input.bar_sigma_mm)),
            context: Some(Arc::new(context)),
        })
    };
    let stopped = stopped.iter().filter_map(|pose| measurement(pose, 0.0));
    let passed = passed.iter().filter_map(|point| measurement(&point.pose, point.timing_mm));
    let mut rows: Vec<Measurement> = stopped.chain(passed).collect();
    rows.sort_by_key(|row| row.index);
    let taught = plan.taught().next().map(|_| ContextColumn::TaughtDeg);
    Measurements { rows, columns: COLUMNS.into_iter().chain(taught).collect() }
}
