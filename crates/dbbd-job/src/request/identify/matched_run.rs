//! A capture with the poses to which its dwells were matched.

use std::path::Path;

use dbbd_model::diagnostic::{Diagnostic, Finding, Severity};
use dbbd_model::estimation::{AngleSource, EstimationFinding};
use dbbd_model::robot::{AXES, BallId, Robot};

use crate::plan::PoseKind;
use crate::recording::matching::{MatchingFinding, PoseMatching};
use crate::recording::run::{self, RecordedRun};
use crate::request::RequestSession;

/// A capture, and its latest pose matching.
pub(super) struct MatchedRun {
    pub run: Box<RecordedRun>,
    pub matching: PoseMatching,
}

impl MatchedRun {
    /// Reads and matches a capture; `None` if the file is not a capture.
    pub(super) fn read(path: &Path, session: &RequestSession<'_>) -> Result<Option<Self>, Diagnostic> {
        if !run::is_capture(path)? {
            return Ok(None);
        }
        let run = run::open_run(path, None, &[], &mut |finding| session.finding(finding))?;
        let matching = run.matching(None)?;
        Ok(Some(Self { run: Box::new(run), matching }))
    }

    /// The source of the axis angles: measured by the controller or commanded.
    pub(super) fn axes(&self) -> AngleSource {
        let published = self.matching.axes.as_ref().is_some_and(|axes| axes.measured > 0);
        if published || !self.run.axes_deg.is_empty() { AngleSource::Given } else { AngleSource::Commanded }
    }

    /// The name of the robot of the plan, if it is not `robot`.
    pub(super) fn other_robot(&self, robot: &Robot) -> Option<String> {
        self.run.robot().ok().map(|planned| planned.name).filter(|name| *name != robot.name)
    }

    /// The poses of the plan that have no length, with their base ball and commanded axis angles, rad.
    pub(super) fn lost_poses(&self) -> impl Iterator<Item = (BallId, [f64; AXES])> {
        let measured = &self.matching.observations.rows;
        let rows = self.run.plan.rows.iter();
        let planned = rows.filter(|row| row.kind == PoseKind::Measure && !row.is_passed());
        let lost = planned.filter(|row| !measured.iter().any(|length| length.index == row.index));
        lost.map(|row| (row.centre, row.axes_deg.map(f64::to_radians)))
    }

    /// The findings of the run. If other runs measured the poses that this one lost (`is_completed`), nothing is lacking.
    pub(super) fn findings(&self, robot: &Robot, is_completed: bool) -> Vec<Diagnostic> {
        let lost = self.run.has_warnings.then(|| EstimationFinding::PartOfRunLost.into());
        let is_reported = |finding: &&MatchingFinding| {
            let is_of_axes = matches!(
                finding,
                MatchingFinding::AxesMeasured { .. } | MatchingFinding::AxesMeasuredLagUnknown { .. }
            );
            let is_of_a_cut_run = matches!(
                finding,
                MatchingFinding::PosesLost { .. }
                    | MatchingFinding::StrobeCount { .. }
                    | MatchingFinding::PlanNotShown { .. }
            );
            is_of_axes || finding.code().severity() == Severity::Warning && !(is_completed && is_of_a_cut_run)
        };
        let of_matching = self.matching.findings.iter().filter(is_reported).cloned().map(Diagnostic::from);
        let given = || robot.name.clone();
        let other = self
            .other_robot(robot)
            .map(|planned| EstimationFinding::PlannedForAnother { planned, given: given() }.into());
        lost.into_iter().chain(of_matching).chain(other).collect()
    }
}
