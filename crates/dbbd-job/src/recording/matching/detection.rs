//! Detects the dwells of a run, and decides which dwell belongs to which pose: by the controller's reports, else by its
//! strobe, else by stillness.

use std::collections::BTreeMap;

use super::alignment::{DwellEvidence, Pairing, align, code_log_odds};
use super::inferred;
use super::input::{MatchingInput, MeasuredAxes};
use super::outcome::{self, DwellSource, ExpectedTimes, MatchOutcome, PoseOutcome};
use super::passes::{MatchedPasses, read_passes};
use super::pose_matching::{CodeOdds, ModuleOdds};
use super::program::DwellPoses;
use super::published::AxesReport;
use super::stillness::still_dwells;
use crate::plan::PlanRow;
use crate::recording::dwell::{Dwell, DwellReading, reading_between};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::reports::reported_dwells;
use crate::recording::strobe_decoder::{has_strobe, strobed_dwells};

/// Time kept clear of the end of a still interval, s: the start of the next move is detected late.
const GUARD_S: f64 = 0.15;
/// Least share of a dwell that must have readings.
const MIN_READ_SHARE: f64 = 0.3;

/// Everything that was detected in a run.
pub(super) struct DwellDetection {
    pub(super) source: DwellSource,
    dwells: Vec<Dwell>,
    /// One pairing for each pose at which the robot stops.
    pairings: Vec<Pairing>,
    pub(super) override_factor: Option<f64>,
    pub(super) passes: MatchedPasses,
    /// Measured axes, degrees, by the plan's index.
    pub(super) axes_deg: MeasuredAxes,
    pub(super) report: Option<AxesReport>,
    pub(super) findings: Vec<Finding>,
}

impl DwellDetection {
    pub(super) fn new(source: DwellSource, dwells: Vec<Dwell>, pairings: Vec<Pairing>) -> Self {
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

    /// The outcome of each pose at which the robot stops.
    pub(super) fn outcomes(&self, input: &MatchingInput<'_>, poses: &DwellPoses<'_>) -> Vec<PoseOutcome> {
        let Self { source, dwells, pairings, override_factor, .. } = self;
        let expected = ExpectedTimes::new(poses, dwells, pairings, override_factor.unwrap_or(1.0));
        let outcome = |at: usize, pairing: &Pairing, row: &PlanRow| match *pairing {
            Pairing::Dwell { dwell, posterior } => match reading(input, &dwells[dwell], row) {
                Some(reading) => MatchOutcome::Matched { reading, posterior },
                None => MatchOutcome::Missing { reason: outcome::why_unread(input.stream, &dwells[dwell]) },
            },
            Pairing::None { .. } => {
                MatchOutcome::Missing { reason: expected.reason(at, input.stream, *source) }
            }
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

    /// The odds that the dwells are from a program with this plan's time code. Empty for a plan of an earlier version,
    /// because other plans share its code.
    pub(super) fn code_odds(&self, input: &MatchingInput<'_>, poses: &DwellPoses<'_>) -> CodeOdds {
        if !input.plan.identifies_its_poses() {
            return CodeOdds::default();
        }
        let mut order: Vec<usize> = (0..self.dwells.len()).collect();
        order.sort_by(|a, b| self.dwells[*a].start_s.total_cmp(&self.dwells[*b].start_s));
        let dwells: Vec<Dwell> = order.iter().map(|at| self.dwells[*at]).collect();
        let plain = MatchingInput { expected: None, ..*input };
        let evidence = evidence(&plain, &dwells, self.source);
        let kept = |pairing: &Pairing| match *pairing {
            Pairing::Dwell { dwell, .. } => order.iter().position(|at| *at == dwell),
            Pairing::None { .. } | Pairing::Ambiguous { .. } => None,
        };
        let kept: Vec<Option<usize>> = self.pairings.iter().map(kept).collect();
        let (mut by_module, mut first) = (Vec::new(), 0);
        for module in poses.commanded.chunk_by(|a, b| a.module == b.module) {
            let end = first + module.len();
            // A module that was run from another plan has no pairs: its dwells are between the dwells of its
            // neighbours.
            let after = kept[..first].iter().flatten().max().map_or(0, |last| last + 1);
            let until = kept[end..].iter().flatten().min().copied().unwrap_or(evidence.len());
            let log_odds = code_log_odds(module, evidence.get(after..until).unwrap_or_default());
            let matched = kept[first..end].iter().flatten().count();
            // With stillness the dwells of a module may be undetectable: then only the whole run shows its plan.
            let dwells = if self.source == DwellSource::Stillness { 0 } else { module.len() };
            by_module.push(ModuleOdds { log_odds, dwells, matched });
            first = end;
        }
        CodeOdds { by_module }
    }

    /// The dwells that belong to no pose and no pass.
    pub(super) fn spurious(&self) -> Vec<Dwell> {
        let mut used = vec![false; self.dwells.len()];
        for pairing in &self.pairings {
            if let Pairing::Dwell { dwell, .. } | Pairing::Ambiguous { dwell, .. } = *pairing {
                used[dwell] = true;
            }
        }
        let unused = self.dwells.iter().zip(used).filter(|(_, used)| !used).map(|(dwell, _)| *dwell);
        unused.filter(|dwell| !self.passes.contains(dwell)).collect()
    }
}

/// Detects dwells by the controller's reports, else by its strobe, else by stillness.
pub(super) fn detect_dwells(input: &MatchingInput<'_>, poses: &DwellPoses<'_>) -> DwellDetection {
    let passes = read_passes(input);
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

/// The reading in the dwell of a row; `None` if it has too few readings.
pub(super) fn reading(input: &MatchingInput<'_>, dwell: &Dwell, row: &PlanRow) -> Option<DwellReading> {
    let period_s = input.stream.period_s();
    let whole = if period_s > 0.0 { row.dwell_s / period_s } else { 0.0 };
    let to_s = dwell.until_s.min(dwell.settled_s + row.dwell_s);
    let suffices = |reading: &DwellReading| {
        reading.to_s - reading.from_s >= MIN_READ_SHARE * row.dwell_s
            && reading.samples as f64 >= MIN_READ_SHARE * whole
    };
    reading_between(input.stream, dwell.settled_s, to_s).filter(suffices)
}

/// Pairs dwells with poses by reports, which carry the index of the pose.
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
    let mut dwell_modules: Vec<usize> = strobed.iter().map(|dwell| dwell.module).collect();
    let first_module = first_module(&pairings, &pose_modules, &dwell_modules);
    dwell_modules.iter_mut().for_each(|module| *module += first_module);
    let last_module = dwell_modules.last().copied().unwrap_or(0);
    let modules = pose_modules.last().map_or(0, |last| last + 1);
    if !strobed.is_empty() && (first_module > 0 || last_module + 1 < modules) {
        findings.push(Finding::SomeModules { first: first_module + 1, last: last_module + 1, modules });
    }
    for module in first_module..=last_module {
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

/// The module of the plan with which the run began: most of the pairs found by the durations have this difference of
/// modules.
fn first_module(pairings: &[Pairing], pose_modules: &[usize], dwell_modules: &[usize]) -> usize {
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for (pairing, pose_module) in pairings.iter().zip(pose_modules) {
        if let Pairing::Dwell { dwell, .. } = *pairing
            && let Some(later) = pose_module.checked_sub(dwell_modules[dwell])
        {
            *counts.entry(later).or_default() += 1;
        }
    }
    counts
        .into_iter()
        .max_by_key(|(later, count)| (*count, std::cmp::Reverse(*later)))
        .map_or(0, |(later, _)| later)
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

/// The dwells as evidence for the alignment.
fn evidence(input: &MatchingInput<'_>, dwells: &[Dwell], source: DwellSource) -> Vec<DwellEvidence> {
    let job = &input.plan.header.job;
    let mut before_s = f64::NEG_INFINITY;
    dwells
        .iter()
        .map(|dwell| {
            let to_s = dwell.until_s.min(dwell.settled_s + job.motion.dwell_s);
            // The reading is needed only for expected lengths; a dwell without a reading is far from all expected
            // lengths.
            let reading = input.expected.and_then(|_| reading_between(input.stream, dwell.settled_s, to_s));
            let after_break = input.stream.broken_between(before_s, dwell.start_s);
            before_s = dwell.start_s;
            DwellEvidence {
                start_s: dwell.start_s,
                start_sd_s: dwell.start_sd_s,
                // A strobe is high while the program reads; this is shorter than its wait.
                duration_s: (source == DwellSource::Stillness).then(|| dwell.duration_s()),
                length_mm: reading.map_or(0.0, |reading| job.bar.length_mm + reading.reading_mm),
                after_break,
            }
        })
        .collect()
}
