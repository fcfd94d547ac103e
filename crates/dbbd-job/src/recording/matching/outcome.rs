//! The match outcome of each commanded pose, and the findings about a run.

use super::alignment::Pairing;
use super::program::{DwellPoses, ProgramPace};
use super::{DwellSource, PoseMatching};
use crate::plan::Plan;
use crate::recording::dwell::{Dwell, DwellReading};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;

#[derive(Clone, Debug, PartialEq)]
pub struct PoseOutcome {
    /// The plan's index.
    pub index: u32,
    pub outcome: MatchOutcome,
}

#[derive(Clone, Debug, PartialEq)]
pub enum MatchOutcome {
    /// `posterior` is the probability that the dwell belongs to this pose.
    Matched { reading: DwellReading, posterior: f64 },
    /// Without a length.
    Missing { reason: Finding },
    /// Dropped, because it is not certain which dwell belongs to it.
    Ambiguous { reason: Finding },
}

impl PoseOutcome {
    pub fn reading(&self) -> Option<&DwellReading> {
        match &self.outcome {
            MatchOutcome::Matched { reading, .. } => Some(reading),
            _ => None,
        }
    }
}

/// Expected starts of poses, from their matched neighbours.
pub(super) struct ExpectedTimes<'a> {
    poses: &'a DwellPoses<'a>,
    /// Start of the matched dwell of each pose, s.
    starts: Vec<Option<f64>>,
    pace: ProgramPace,
}

impl<'a> ExpectedTimes<'a> {
    pub(super) fn new(
        poses: &'a DwellPoses<'a>,
        dwells: &[Dwell],
        pairings: &[Pairing],
        override_factor: f64,
    ) -> Self {
        let start = |pairing: &Pairing| match *pairing {
            Pairing::Dwell { dwell, .. } => dwells.get(dwell).map(|dwell| dwell.start_s),
            _ => None,
        };
        Self {
            poses,
            starts: pairings.iter().map(start).collect(),
            pace: ProgramPace { stretch: 1.0 / override_factor, slack: 0.0 },
        }
    }

    /// Expected start of pose `at`; `None` if no pose of its module was matched.
    fn expected_s(&self, at: usize) -> Option<f64> {
        let DwellPoses { commanded, program, .. } = self.poses;
        let near =
            |other: &usize| commanded[*other].module == commanded[at].module && self.starts[*other].is_some();
        let takes_s = |from, to| program.takes_s(from, to, self.pace);
        let before = (0..at).rev().find(near).and_then(|from| Some(self.starts[from]? + takes_s(from, at)));
        before.or_else(|| {
            let after = (at + 1..self.starts.len()).find(near)?;
            Some(self.starts[after]? - takes_s(at, after))
        })
    }

    /// Why pose `at` has no dwell.
    pub(super) fn reason(&self, at: usize, stream: &SampleStream, source: DwellSource) -> Finding {
        let dwell = match source {
            DwellSource::Reports => "report of the controller",
            DwellSource::Strobe => "strobe",
            DwellSource::Axes => "rest of the axes",
            DwellSource::Stillness => "still interval",
        };
        let Some(expected_s) = self.expected_s(at) else { return Finding::NoneNearby { dwell } };
        let end_s = stream.t_s.last().copied().unwrap_or(0.0);
        let wait_s = self.poses.commanded[at].wait_s;
        if expected_s < 0.0 {
            return Finding::CaptureBeganLater;
        }
        if expected_s + 0.5 * wait_s > end_s {
            return Finding::CaptureEndedBefore;
        }
        let range = stream.at(expected_s)..stream.at(expected_s + wait_s);
        if (range.len() as f64) * stream.period_s() < 0.5 * wait_s {
            return Finding::SentTooLittle { expected_s };
        }
        if range.clone().filter(|&at| stream.valid(at)).count() * 2 < range.len() {
            return Finding::NotValid { at_s: expected_s };
        }
        Finding::NoneWhenDue { dwell, expected_s }
    }
}

/// Why a detected dwell has no reading.
pub(super) fn why_unread(stream: &SampleStream, dwell: &Dwell) -> Finding {
    let &Dwell { start_s: at_s, end_s, .. } = dwell;
    let range = stream.at(at_s)..stream.at(end_s);
    let invalid = range.clone().filter(|&at| !stream.valid(at)).count();
    if stream.broken_between(at_s, end_s) {
        Finding::ClockBroke { at_s }
    } else if invalid * 2 > range.len() {
        Finding::NotValid { at_s }
    } else {
        Finding::TooShort { at_s }
    }
}

/// Why no pose was matched, as far as the stream shows it.
pub fn nothing_matched(plan: &Plan, stream: &SampleStream) -> Finding {
    /// Least range of the reading while a robot moves the bar, mm.
    const STILL_MM: f64 = 0.005;
    /// Longest run as a multiple of the duration of its program.
    const MAX_RUN_DURATION_RATIO: f64 = 50.0;
    let valid = (0..stream.len()).filter(|at| stream.valid(*at)).map(|at| stream.reading_mm[at]);
    let [low, high] = valid.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], reading| {
        [low.min(reading), high.max(reading)]
    });
    let (seconds, planned_s) = (stream.t_s.last().copied().unwrap_or(0.0), plan.duration_s());
    if low > high {
        Finding::NothingValid
    } else if high - low < STILL_MM {
        Finding::NothingMoves { reading_mm: low }
    } else if !(plan.least_duration_s()..=MAX_RUN_DURATION_RATIO * planned_s).contains(&seconds) {
        Finding::OtherDuration { seconds, planned_s }
    } else {
        Finding::NothingMatched
    }
}

fn percent(part: usize, all: usize) -> f64 {
    100.0 * part as f64 / all as f64
}

pub(super) fn findings(matching: &PoseMatching, stream: &SampleStream) -> Vec<Finding> {
    let mut findings = Vec::new();
    let poses = matching.outcomes.len();
    let readings = || matching.outcomes.iter().filter_map(PoseOutcome::reading);
    let matched = readings().count();
    let is_ambiguous = |pose: &&PoseOutcome| matches!(pose.outcome, MatchOutcome::Ambiguous { .. });
    let ambiguous = matching.outcomes.iter().filter(is_ambiguous).count();
    if ambiguous > 0 {
        let percent = percent(ambiguous, poses);
        findings.push(Finding::AmbiguousPoses { poses: ambiguous, percent });
    }
    let lost = poses - matched - ambiguous;
    if lost > 0 {
        findings.push(Finding::PosesLost { lost, poses, percent: percent(lost, poses) });
    }
    let touched = || readings().filter(|reading| reading.invalid > 0);
    let invalid: usize = touched().map(|reading| reading.invalid).sum();
    if invalid > 0 {
        let samples = touched().map(|reading| reading.samples + reading.invalid).sum();
        let (percent, dwells) = (percent(invalid, samples), touched().count());
        findings.push(Finding::InvalidInDwells { invalid, samples, percent, dwells });
    }
    let creep = readings().filter(|reading| reading.creep_mm.is_some()).count();
    if creep > 0 {
        findings.push(Finding::Creep { dwells: creep });
    }
    let gaps = readings().filter(|reading| reading.gaps > 0).count();
    if gaps > 0 {
        findings.push(Finding::MissingSamples { dwells: gaps });
    }
    for broken in stream.clock().into_iter().flat_map(|clock| &clock.breaks) {
        let at_s = stream.t_s.get(broken.at).copied().unwrap_or(0.0);
        let (jump_s, host_s) = (broken.jump_s, broken.host_s);
        findings.push(if broken.reset {
            Finding::ClockRestarted { at_s, jump_s, host_s }
        } else {
            Finding::ClockJumped { at_s, jump_s, host_s }
        });
    }
    if let Some(drift) = matching.drift.filter(|drift| drift.significant) {
        findings.push(Finding::ReferenceDrift { change_um: 1000.0 * drift.change_mm });
    }
    findings
}

/// Whether the measured axes differ from the commanded ones: everywhere by a little in absolute-accuracy mode, at
/// single poses or by far if something is wrong.
pub(super) fn axes_deviation(matching: &PoseMatching, plan: &Plan) -> Option<Finding> {
    /// Largest deviation of a controller in position, degrees.
    const IN_POSITION_DEG: f64 = 0.05;
    /// Largest correction in absolute-accuracy mode at most poses, degrees.
    const CORRECTED_DEG: f64 = 3.0;
    let apart_deg = matching.observations.rows.iter().filter_map(|row| {
        let commanded = plan.rows.get((row.index as usize).checked_sub(1)?)?;
        let apart = row
            .axes
            .degrees()
            .into_iter()
            .zip(commanded.axes_deg)
            .map(|(measured, plan)| (measured - plan).abs());
        Some(apart.fold(0.0, f64::max))
    });
    let mut apart_deg: Vec<f64> = apart_deg.collect();
    apart_deg.sort_by(f64::total_cmp);
    let (usual_deg, worst_deg) = (*apart_deg.get(apart_deg.len() / 2)?, *apart_deg.last()?);
    if worst_deg <= IN_POSITION_DEG {
        return None;
    }
    let poses = apart_deg.iter().filter(|deg| **deg > IN_POSITION_DEG).count();
    Some(if usual_deg > CORRECTED_DEG {
        Finding::OtherPlanDriven { poses, worst_deg }
    } else if usual_deg > IN_POSITION_DEG {
        Finding::AxesCorrected { poses, worst_deg }
    } else {
        Finding::AxesMoved { poses, worst_deg }
    })
}
