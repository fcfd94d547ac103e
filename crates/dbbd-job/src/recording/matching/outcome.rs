//! The match outcome of each commanded pose, and the reason if it has no reading.

use super::alignment::Pairing;
use super::program::{DwellPoses, ProgramPace};
use crate::recording::dwell::{Dwell, DwellReading};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;

/// The way in which the dwells were detected.
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
pub struct PoseOutcome {
    /// The plan's index.
    pub index: u32,
    pub outcome: MatchOutcome,
}

#[derive(Clone, Debug, PartialEq)]
pub enum MatchOutcome {
    /// `posterior` is the probability that the dwell belongs to this pose.
    Matched { reading: DwellReading, posterior: f64 },
    /// The pose has no length.
    Missing { reason: Finding },
    /// The pose is left out, because it is not certain which dwell belongs to it.
    Ambiguous { reason: Finding },
}

impl PoseOutcome {
    pub fn reading(&self) -> Option<&DwellReading> {
        if let MatchOutcome::Matched { reading, .. } = &self.outcome { Some(reading) } else { None }
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
        let start = |pairing: &Pairing| {
            if let Pairing::Dwell { dwell, .. } = *pairing {
                dwells.get(dwell).map(|dwell| dwell.start_s)
            } else {
                None
            }
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
