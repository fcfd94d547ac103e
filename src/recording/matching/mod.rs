//! From a stream of lengths and a plan to measurements: the dwells, and which dwell is which pose. Pure and
//! deterministic.
//!
//! Dwells come from the controller's reports where there are any (they carry the plan's index), else
//! from its strobe, else from intervals in which the length does not change.

mod alignment;
mod by_axes;
mod drift;
mod duration;
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
use std::ops::Range;
use std::sync::Arc;

use super::dwell::{Dwell, DwellReading, measure};
use super::reports::{self, Report, reported_dwells};
use super::stream::Stream;
use super::strobe_decoder::{StrobedDwell, has_strobe, strobed_dwells};
use crate::catalogue::MatchingFinding as Finding;
use crate::measurement::{AxisAngles, BallId, BarId, CircleId, Column, Context, Measurement, Measurements};
use crate::plan::{CirclePlace, Plan, PlanRow};
use crate::robot::{AXES, Approach, Datum, TargetId};

pub use alignment::{Alignment, DwellEvidence, Expected, Pairing, align};
pub use drift::Drift;
pub use lag::BarLag;
pub use markers::Markers;
pub use outcome::{MatchOutcome, PoseOutcome, nothing_matched};
pub use passes::Lag;
pub use program::Commanded;
pub use published::{AxesReport, PublishedAxes};
pub use stillness::still_dwells;

use outcome::ExpectedTimes;
use passes::Passes;
use program::Poses;

/// Axis angles (degrees) that were measured, by the plan's index.
pub type MeasuredAxes = BTreeMap<u32, [f64; AXES]>;

/// A plan with what was recorded while it was driven.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    pub plan: &'a Plan,
    pub stream: &'a Stream,
    /// What the controller reported, in order of arrival; may be empty.
    pub reports: &'a [Report],
    /// Lengths that a model predicts for the plan's dwell rows, in order.
    pub expected: Option<Expected<'a>>,
    /// The bar's own standard deviation, mm: no measurement claims to be better. 0 if unknown.
    pub bar_sigma_mm: f64,
    /// They replace the commanded ones.
    pub axes_deg: Option<&'a MeasuredAxes>,
    /// The axes that the controller published: they show the dwells, and replace all others.
    pub published: Option<PublishedAxes<'a>>,
}

impl<'a> Input<'a> {
    pub fn new(plan: &'a Plan, stream: &'a Stream) -> Self {
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

/// How the dwells were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DwellSource {
    Reports,
    Strobe,
    /// By the published axes.
    Axes,
    /// By intervals without motion.
    Stillness,
}

#[derive(Clone, Debug, PartialEq)]
pub struct PoseMatching {
    /// The lengths with the angles they were read at, in the plan's order, measure and reference rows;
    /// further columns `kind,t_s,samples,creep,circle,angle_deg` (`creep` is 1 where the reading drifted
    /// within the dwell; `circle` and the pose's angle on it are empty for a pose of no circle).
    ///
    /// `sigma_mm` is the standard uncertainty of the dwell's mean, not less than the bar's own. The
    /// robot's repeatability is not in it: no dwell shows it, the residuals of an identification do.
    pub observations: Measurements,
    /// One for each of the plan's dwells, in order.
    pub outcomes: Vec<PoseOutcome>,
    pub spurious: Vec<Dwell>,
    pub source: DwellSource,
    /// The override that the moves were driven with, 0..1, where it was estimated.
    pub override_factor: Option<f64>,
    /// The lag between command and reading, of each continuous circle that shows it.
    pub lags: Vec<Lag>,
    /// Change of the length at the repeated reference pose, where it was read twice or more.
    pub drift: Option<Drift>,
    /// What the published axes showed, where they were used.
    pub axes: Option<AxesReport>,
    pub findings: Vec<Finding>,
}

impl PoseMatching {
    /// Whether the same dwells belong to the same poses as in `other`.
    pub fn same_pairs(&self, other: &Self) -> bool {
        let pair = |pose: &PoseOutcome| pose.reading().map(|reading| (reading.from_s, reading.to_s));
        self.outcomes.iter().map(pair).eq(other.outcomes.iter().map(pair))
    }
}

/// Lengths that a model expects at the plan's dwells, in order, mm: what [`Expected`] takes. `length_mm` is
/// given the base ball and the axis angles (degrees): the measured ones where there are any.
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

/// Kept free of a still interval's end, s: the begin of the next move is detected late.
const GUARD_S: f64 = 0.15;
/// A dwell of which less than this share was read is not used.
const LEAST_SHARE: f64 = 0.3;

/// The dwells, and which of them is whose.
struct Paired {
    source: DwellSource,
    dwells: Vec<Dwell>,
    pairings: Vec<Pairing>,
    override_factor: Option<f64>,
    findings: Vec<Finding>,
}

/// What was found of a run, by whatever shows it.
struct Shown {
    paired: Paired,
    passes: Passes,
    /// Measured axes, degrees, by the plan's index.
    axes_deg: MeasuredAxes,
    report: Option<AxesReport>,
}

/// Matches the dwells of a run to the poses of its plan.
pub fn match_poses(input: &Input<'_>) -> PoseMatching {
    let poses = Poses::of(input.plan);
    let Shown { mut paired, passes, axes_deg, report } =
        by_axes::shown(input, &poses).unwrap_or_else(|| by_others(input, &poses));
    let mut outcomes = outcomes(input, &poses, &paired);
    let drift = drift::of(&poses.rows, &outcomes, input.bar_sigma_mm);
    let frozen = frozen::frozen(input.stream, &outcomes);
    let spurious = spurious(&paired, &passes);
    let observations = Rows::of(input, &axes_deg).collect(&outcomes, &passes);
    outcomes.extend(passes.points.into_iter().map(|point| point.pose));
    outcomes.sort_by_key(|pose| pose.index);
    let one_way = |circle| Finding::OneWayCircle { circle, lag_sd_ms: 1000.0 * passes::LAG_SD_S };
    let mut findings = std::mem::take(&mut paired.findings);
    findings.extend(frozen);
    findings.extend(passes.one_way.into_iter().map(one_way));
    findings.extend(reports::unused(input.reports, input.stream).filter(|_| report.is_none()));
    let mut matching = PoseMatching {
        observations,
        outcomes,
        spurious,
        source: paired.source,
        override_factor: paired.override_factor.filter(|_| !poses.rows.is_empty()),
        lags: passes.lags,
        drift,
        axes: report,
        findings,
    };
    matching.findings.extend(matching.axes.as_ref().map(AxesReport::finding));
    let more = outcome::findings(&matching, input.stream);
    matching.findings.extend(more);
    let apart = outcome::axes_apart(&matching, input.plan);
    matching.findings.extend(apart);
    matching
}

/// By the controller's reports, else its strobe, else stillness.
fn by_others(input: &Input<'_>, poses: &Poses<'_>) -> Shown {
    let passes = passes::read(input);
    let reported = reported_dwells(input.reports, input.stream);
    let mut paired = if let Some(reported) = reported {
        by_reports(poses, &reported)
    } else if has_strobe(input.stream) {
        by_strobe(input, poses, &passes)
    } else {
        by_stillness(input, poses)
    };
    let off_pace = input.published.filter(|axes| !axes.track.is_empty());
    paired.findings.extend(off_pace.map(|axes| Finding::AxesUnused { packets: axes.track.len() }));
    Shown { paired, passes, axes_deg: input.axes_deg.cloned().unwrap_or_default(), report: None }
}

/// The outcome of each pose at which the robot stops.
fn outcomes(input: &Input<'_>, poses: &Poses<'_>, paired: &Paired) -> Vec<PoseOutcome> {
    let Paired { source, dwells, pairings, override_factor, .. } = paired;
    let expected = ExpectedTimes::new(poses, dwells, pairings, override_factor.unwrap_or(1.0));
    let outcome = |at: usize, pairing: &Pairing, row: &PlanRow| match *pairing {
        Pairing::Dwell { dwell, posterior } => match reading(input, &dwells[dwell], row) {
            Some(reading) => MatchOutcome::Matched { reading, posterior },
            None => MatchOutcome::Missing { reason: outcome::unread(input.stream, &dwells[dwell]) },
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

/// What the bar read in the dwell of a row; `None` where that is not enough for a mean.
fn reading(input: &Input<'_>, dwell: &Dwell, row: &PlanRow) -> Option<DwellReading> {
    let period_s = input.stream.period_s();
    let whole = if period_s > 0.0 { row.dwell_s / period_s } else { 0.0 };
    let to_s = dwell.until_s.min(dwell.settled_s + row.dwell_s);
    let suffices = |reading: &DwellReading| {
        reading.to_s - reading.from_s >= LEAST_SHARE * row.dwell_s
            && reading.samples as f64 >= LEAST_SHARE * whole
    };
    measure(input.stream, dwell.settled_s, to_s).filter(suffices)
}

/// The dwells that no pose and no pass has.
fn spurious(paired: &Paired, passes: &Passes) -> Vec<Dwell> {
    let mut used = vec![false; paired.dwells.len()];
    for pairing in &paired.pairings {
        if let Pairing::Dwell { dwell, .. } | Pairing::Ambiguous { dwell, .. } = *pairing {
            used[dwell] = true;
        }
    }
    let unused = paired.dwells.iter().zip(used).filter(|(_, used)| !used).map(|(dwell, _)| *dwell);
    unused.filter(|dwell| !passes.holds(dwell)).collect()
}

/// The reports name the plan's index themselves.
fn by_reports(poses: &Poses<'_>, reported: &BTreeMap<u32, Dwell>) -> Paired {
    let mut dwells = Vec::new();
    let pairings = poses
        .rows
        .iter()
        .map(|row| match reported.get(&row.index) {
            Some(dwell) => {
                dwells.push(*dwell);
                Pairing::Dwell { dwell: dwells.len() - 1, posterior: 1.0 }
            }
            None => Pairing::None { posterior: 1.0 },
        })
        .collect();
    let (source, findings) = (DwellSource::Reports, Vec::new());
    Paired { source, dwells, pairings, override_factor: None, findings }
}

/// The n-th strobe of a module is its n-th dwell, if all of the module are there and the intervals do not
/// object; in a module with one too few or too many the intervals decide.
fn by_strobe(input: &Input<'_>, poses: &Poses<'_>, passes: &Passes) -> Paired {
    let mut strobed = strobed_dwells(input.stream);
    strobed.retain(|strobed| !passes.holds(&strobed.dwell));
    let dwells: Vec<Dwell> = strobed.iter().map(|strobed| strobed.dwell).collect();
    let alignment = align(&poses.commanded, &evidence(input, &dwells, DwellSource::Strobe), input.expected);
    let mut pairings = alignment.pairings;
    let mut findings = Vec::new();
    for (module, ModuleDwells { commanded, strobed }) in modules(poses, &strobed).into_iter().enumerate() {
        if commanded.len() != strobed.len() {
            let (strobes, dwells) = (strobed.len(), commanded.len());
            findings.push(Finding::StrobeCount { module: module + 1, strobes, dwells });
            continue;
        }
        let objects = commanded.clone().zip(strobed.clone()).any(|(pose, dwell)| match pairings[pose] {
            Pairing::Dwell { dwell: other, .. } => dwell != other,
            Pairing::None { .. } => true,
            Pairing::Ambiguous { .. } => false,
        });
        if !objects {
            for (pose, dwell) in commanded.zip(strobed) {
                pairings[pose] = Pairing::Dwell { dwell, posterior: 1.0 };
            }
        }
    }
    let override_factor = Some(alignment.override_factor);
    Paired { source: DwellSource::Strobe, dwells, pairings, override_factor, findings }
}

/// The poses and the strobed dwells of a module, by their positions.
struct ModuleDwells {
    commanded: Range<usize>,
    strobed: Range<usize>,
}

fn modules(poses: &Poses<'_>, strobed: &[StrobedDwell]) -> Vec<ModuleDwells> {
    let commanded: Vec<usize> = poses.commanded.iter().map(|pose| pose.module).collect();
    let strobed: Vec<usize> = strobed.iter().map(|dwell| dwell.module).collect();
    let of = |all: &[usize], module: usize| {
        all.partition_point(|other| *other < module)..all.partition_point(|other| *other <= module)
    };
    let count =
        [&commanded, &strobed].into_iter().filter_map(|all| all.last()).max().map_or(0, |last| last + 1);
    (0..count)
        .map(|module| ModuleDwells { commanded: of(&commanded, module), strobed: of(&strobed, module) })
        .collect()
}

fn by_stillness(input: &Input<'_>, poses: &Poses<'_>) -> Paired {
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
    let Alignment { pairings, override_factor } = alignment;
    let (source, findings) = (DwellSource::Stillness, Vec::new());
    Paired { source, dwells, pairings, override_factor: Some(override_factor), findings }
}

/// The dwells as the alignment needs them.
fn evidence(input: &Input<'_>, dwells: &[Dwell], source: DwellSource) -> Vec<DwellEvidence> {
    let job = &input.plan.header.job;
    let mut before_s = f64::NEG_INFINITY;
    dwells
        .iter()
        .map(|dwell| {
            let to_s = dwell.until_s.min(dwell.settled_s + job.motion.dwell_s);
            // Only needed against expected lengths; a dwell without a reading is far from any.
            let reading = input.expected.and_then(|_| measure(input.stream, dwell.settled_s, to_s));
            let after_break = input.stream.broken_between(before_s, dwell.start_s);
            before_s = dwell.start_s;
            DwellEvidence {
                start_s: dwell.start_s,
                start_sd_s: dwell.start_sd_s,
                // A strobe is as long as the program reads, not as it waits.
                duration_s: (source == DwellSource::Stillness).then(|| dwell.duration_s()),
                length_mm: reading.map_or(0.0, |reading| job.bar.length_mm + reading.reading_mm),
                after_break,
            }
        })
        .collect()
}

/// The further columns of the measurements.
const COLUMNS: [Column; 6] =
    [Column::Kind, Column::TimeS, Column::Samples, Column::Creep, Column::Circle, Column::AngleDeg];

/// A plan's rows name balls from 1 on.
fn ball(row: &PlanRow) -> BallId {
    BallId::numbered(row.centre)
}

/// Makes the measurements.
struct Rows<'a> {
    input: &'a Input<'a>,
    axes_deg: &'a MeasuredAxes,
    places: Vec<Option<CirclePlace>>,
    /// How the plan's moves bring the axes to each row.
    approaches: Vec<Approach>,
}

impl<'a> Rows<'a> {
    fn of(input: &'a Input<'a>, axes_deg: &'a MeasuredAxes) -> Self {
        let plan = input.plan;
        Self { input, axes_deg, places: plan.circle_places(), approaches: plan.approaches().collect() }
    }

    /// Of the poses at which the robot stopped and of those that it passed.
    fn collect(&self, stopped: &[PoseOutcome], passes: &Passes) -> Measurements {
        let mut rows: Vec<Measurement> = stopped.iter().filter_map(|pose| self.row(pose, 0.0)).collect();
        rows.extend(passes.points.iter().filter_map(|point| self.row(&point.pose, point.timing_mm)));
        rows.sort_by_key(|row| row.index);
        let mut columns = COLUMNS.to_vec();
        columns.extend(self.input.plan.taught().next().map(|_| Column::TaughtDeg));
        Measurements { rows, columns }
    }

    fn row(&self, pose: &PoseOutcome, timing_mm: f64) -> Option<Measurement> {
        let reading = pose.reading()?;
        let at = (pose.index as usize).checked_sub(1)?;
        let row = self.input.plan.rows.get(at)?;
        let place = self.places.get(at).copied().flatten();
        let measured = self.axes_deg.get(&row.index);
        let context = Context {
            kind: Some(row.kind),
            time_s: Some(reading.middle_s()),
            samples: Some(reading.samples),
            creep: Some(reading.creep_mm.is_some()),
            circle: place.and_then(|_| CircleId::new(row.circle)),
            angle_deg: place.map(|place| place.angle_deg),
            taught_deg: self
                .input
                .plan
                .taught()
                .find(|taught| taught.centre == row.centre)
                .map(|taught| Box::new(taught.axes_deg)),
            ..Context::default()
        };
        Some(Measurement {
            index: row.index,
            datum: Datum::Ball(ball(row), BarId::FIRST),
            target: TargetId::FIRST,
            axes: AxisAngles::from_degrees(measured.copied().unwrap_or(row.axes_deg)),
            approach: self.approaches.get(at).copied().unwrap_or_default(),
            length_mm: self.input.plan.header.job.bar.length_mm + reading.reading_mm,
            sigma_mm: Some(reading.u_mm.hypot(timing_mm).max(self.input.bar_sigma_mm)),
            context: Some(Arc::new(context)),
        })
    }
}
