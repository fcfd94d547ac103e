//! Stages: a few poses that are measured before the rest, because their length is safe with the present knowledge of
//! the robot.

use serde::{Deserialize, Serialize};

use super::job::{Job, OptimiseTable};
use dbbd_model::design::Criterion;

/// Share of the poses that may be barred without a stage: before the first length is measured, and later.
const FEW_AT_FIRST: f64 = 1.0 / 3.0;
const FEW_LATER: f64 = 0.01;

/// The poses that are barred in a stage, because their length might leave the stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Number of lengths that were measured before the stage.
    pub lengths: usize,
    /// Number of candidates that can be reached.
    pub reachable: usize,
    /// Number of candidates that can be reached, but whose length might leave the stroke.
    pub barred: usize,
}

impl Stage {
    pub(super) fn bars_many(&self) -> bool {
        let few = if self.lengths == 0 { FEW_AT_FIRST } else { FEW_LATER };
        self.barred as f64 > few * self.reachable as f64
    }
}

impl Job {
    /// The job without `taught_deg`.
    #[must_use]
    pub(super) fn untaught(&self) -> Self {
        let mut job = self.clone();
        job.centres.iter_mut().for_each(|table| table.taught_deg = None);
        job
    }

    /// The job with `points` chosen poses about its base balls in place of its circles.
    #[must_use]
    pub fn as_stage(&self, points: u32) -> Self {
        let before = self.optimise.clone().unwrap_or(OptimiseTable { points, ..OptimiseTable::default() });
        self.with_poses(OptimiseTable { stage_points: points, ..before })
    }

    /// The job with `points` poses about its base balls that are best for a calibrated robot, in place of its circles.
    #[must_use]
    pub fn as_check(&self, points: u32, criterion: Criterion) -> Self {
        let before = self.optimise.clone().unwrap_or_default();
        self.with_poses(OptimiseTable { points, criterion, parameters: None, stage_points: points, ..before })
    }

    /// The job with `poses` given poses in place of its circles.
    #[must_use]
    pub fn as_given(&self, poses: usize) -> Self {
        /// Minimum number of poses that a job may request.
        const MIN_POINTS: u32 = 6;
        let points = u32::try_from(poses).unwrap_or(u32::MAX).max(MIN_POINTS);
        let before = self.optimise.clone().unwrap_or_default();
        self.with_poses(OptimiseTable { points, stage_points: points, parameters: None, ..before })
    }

    fn with_poses(&self, optimise: OptimiseTable) -> Self {
        Self { circles: Vec::new(), optimise: Some(optimise), ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::job;

    #[test]
    fn first_stage_allows_a_third_and_a_later_one_a_hundredth_to_be_barred() {
        let bars_many = |lengths, barred| Stage { lengths, reachable: 300, barred }.bars_many();
        assert_eq!([bars_many(0, 100), bars_many(0, 101)], [false, true]);
        assert_eq!([bars_many(1, 3), bars_many(1, 4)], [false, true]);
    }

    #[test]
    fn stage_and_check_replace_the_circles() {
        let job =
            job("[[circle]]\nplane = \"XY\"\npoints = 12\n[optimise]\npoints = 50\nstage_points = 30\n");
        let stage = job.as_stage(8);
        let table = stage.optimise.expect("a stage has chosen poses");
        assert_eq!((stage.circles.len(), table.points, table.stage_points), (0, 50, 8));
        let check = job.as_check(9, Criterion::Change);
        let table = check.optimise.expect("a check has chosen poses");
        assert_eq!((check.circles.len(), table.points, table.stage_points), (0, 9, 9));
        assert_eq!(table.criterion, Criterion::Change);
    }
}
