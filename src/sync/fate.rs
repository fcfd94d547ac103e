//! What became of each commanded pose, and why some have no length.

use super::align::Pairing;
use super::commanded::Poses;
use super::dwell::Dwell;
use super::interval::{Pace, Program};
use super::seen::Stretch;
use super::stream::Stream;
use super::{Candidate, Source, Synced, Warning};
use crate::plan::Plan;

/// What became of a commanded dwell.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseFate {
    /// The plan's index.
    pub index: u32,
    /// What became of it.
    pub fate: Fate,
}

/// What became of a commanded dwell.
#[derive(Clone, Debug, PartialEq)]
pub enum Fate {
    /// It has a length.
    Matched {
        /// The dwell.
        dwell: Dwell,
        /// Probability that it is this pose's.
        posterior: f64,
    },
    /// It has none.
    Missing {
        /// Why.
        reason: String,
    },
    /// It was dropped, since it is not certain which dwell it is.
    Ambiguous {
        /// What is known.
        reason: String,
    },
}

/// Where poses should have been, by their matched neighbours.
pub(super) struct Places {
    program: Program,
    /// Begin of the matched dwell of each pose, s.
    starts: Vec<Option<f64>>,
    waits_s: Vec<f64>,
    modules: Vec<usize>,
    pace: Pace,
}

impl Places {
    pub(super) fn new(
        poses: &Poses<'_>,
        candidates: &[Candidate],
        pairings: &[Pairing],
        override_factor: f64,
    ) -> Self {
        let starts = pairings
            .iter()
            .map(|pairing| match *pairing {
                Pairing::Dwell { dwell, .. } => {
                    candidates.get(dwell).map(|candidate| candidate.stretch.start_s)
                }
                _ => None,
            })
            .collect();
        Self {
            program: Program::new(&poses.commanded),
            starts,
            waits_s: poses.commanded.iter().map(|pose| pose.wait_s).collect(),
            modules: poses.commanded.iter().map(|pose| pose.module).collect(),
            pace: Pace { stretch: 1.0 / override_factor, slack: 0.0 },
        }
    }

    /// When pose `at` should have begun; `None` when no pose of its module was matched.
    fn expected_s(&self, at: usize) -> Option<f64> {
        let near = |other: &usize| self.modules[*other] == self.modules[at] && self.starts[*other].is_some();
        // The residual of an interval "seen" as 0 is minus what was commanded.
        let takes_s = |from, to| -self.program.interval(from, to, 0.0, 0.0, false).residual_s(self.pace);
        let before = (0..at).rev().find(near).and_then(|from| Some(self.starts[from]? + takes_s(from, at)));
        before.or_else(|| {
            let after = (at + 1..self.starts.len()).find(near)?;
            Some(self.starts[after]? - takes_s(at, after))
        })
    }

    /// Why pose `at` has no dwell.
    pub(super) fn reason(&self, at: usize, stream: &Stream, source: Source) -> String {
        let end_s = stream.t_s.last().copied().unwrap_or(0.0);
        let what = match source {
            Source::Reports => "report of the controller",
            Source::Strobe => "strobe",
            Source::Stillness => "still stretch",
        };
        let Some(expected_s) = self.expected_s(at) else {
            return format!("no {what} can be told to be this pose");
        };
        let wait_s = self.waits_s[at];
        if expected_s < 0.0 {
            return "the capture began later".into();
        }
        if expected_s + 0.5 * wait_s > end_s {
            return "the capture ended before".into();
        }
        let range = stream.at(expected_s)..stream.at(expected_s + wait_s);
        let period_s = stream.period_s();
        if (range.len() as f64) * period_s < 0.5 * wait_s {
            return format!("the bar sent too little at {expected_s:.1} s, when it was due");
        }
        if range.clone().filter(|&at| stream.valid(at)).count() * 2 < range.len() {
            return format!("the bar did not vouch for its readings at {expected_s:.1} s");
        }
        format!("no {what} at about {expected_s:.1} s, when it was due")
    }
}

/// Why a dwell that was seen gave no reading.
pub(super) fn unread(stream: &Stream, stretch: Stretch) -> String {
    let Stretch { start_s, end_s, .. } = stretch;
    let range = stream.at(start_s)..stream.at(end_s);
    let invalid = range.clone().filter(|&at| !stream.valid(at)).count();
    if stream.broken_between(start_s, end_s) {
        format!("the bar's clock broke during the dwell at {start_s:.1} s")
    } else if invalid * 2 > range.len() {
        format!("the bar did not vouch for its readings at {start_s:.1} s")
    } else {
        format!("the dwell at {start_s:.1} s was too short or held too few readings")
    }
}

/// What the user should know about a run.
pub(super) fn warnings(synced: &Synced, stream: &Stream) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut warn = |doubt: bool, text: String| warnings.push(Warning { doubt, text });
    let count = |of: fn(&Fate) -> bool| synced.fates.iter().filter(|pose| of(&pose.fate)).count();
    let ambiguous = count(|fate| matches!(fate, Fate::Ambiguous { .. }));
    let matched = count(|fate| matches!(fate, Fate::Matched { .. }));
    if ambiguous > 0 {
        warn(true, format!("{ambiguous} poses were dropped: it is not certain which dwell is theirs"));
    }
    if 2 * matched < synced.fates.len() {
        warn(true, format!("only {matched} of {} poses have a length", synced.fates.len()));
    }
    let creep = count(|fate| matches!(fate, Fate::Matched { dwell, .. } if dwell.creep_mm.is_some()));
    if creep > 0 {
        warn(false, format!("in {creep} dwells the reading drifted by more than its noise (column `creep`)"));
    }
    let gaps = count(|fate| matches!(fate, Fate::Matched { dwell, .. } if dwell.gaps > 0));
    if gaps > 0 {
        warn(false, format!("in {gaps} dwells samples are missing by their sequence numbers"));
    }
    for broken in stream.clock().into_iter().flat_map(|clock| &clock.breaks) {
        let t_s = stream.t_s.get(broken.at).copied().unwrap_or(0.0);
        let what = if broken.reset { "began again" } else { "jumped" };
        let (jump_s, host_s) = (broken.jump_s, broken.host_s);
        warn(false, format!("the bar's clock {what} at {t_s:.3} s: it went {jump_s:+.3} s in {host_s:.3} s"));
    }
    if let Some(drift) = synced.drift.filter(|drift| drift.significant) {
        let um = 1000.0 * drift.change_mm;
        warn(true, format!("the length at the reference pose drifted by {um:.1} um over the run"));
    }
    warnings
}

/// Whether the robot stood elsewhere than commanded by the axis angles that it told: everywhere by a little where the
/// controller corrects by an accuracy model of its own, at single poses or by far where something is wrong.
pub(super) fn elsewhere(synced: &Synced, plan: &Plan) -> Option<Warning> {
    /// No controller in position is further off, degrees.
    const IN_POSITION_DEG: f64 = 0.05;
    /// No robot is corrected by more at most of its poses, degrees.
    const CORRECTED_DEG: f64 = 3.0;
    let off_deg = synced.observations.rows.iter().filter_map(|row| {
        let commanded = plan.rows.get((row.index as usize).checked_sub(1)?)?;
        let apart = row.axes_deg.iter().zip(&commanded.axes_deg).map(|(told, plan)| (told - plan).abs());
        Some(apart.fold(0.0, f64::max))
    });
    let mut off_deg: Vec<f64> = off_deg.collect();
    off_deg.sort_by(f64::total_cmp);
    let (usual_deg, worst_deg) = (*off_deg.get(off_deg.len() / 2)?, *off_deg.last()?);
    if worst_deg <= IN_POSITION_DEG {
        return None;
    }
    let count = off_deg.iter().filter(|deg| **deg > IN_POSITION_DEG).count();
    let corrected = usual_deg > IN_POSITION_DEG && usual_deg <= CORRECTED_DEG;
    let why = if corrected {
        "as a controller with an accuracy model of its own moves them"
    } else if usual_deg > CORRECTED_DEG {
        "was another plan driven?"
    } else {
        "and at the others where they were commanded: was the robot stopped or moved by hand?"
    };
    Some(Warning {
        doubt: !corrected,
        text: format!(
            "at {count} poses the measured axis angles are up to {worst_deg:.2} degrees from the commanded ones, {why}"
        ),
    })
}
