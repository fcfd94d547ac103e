//! Stages: a few poses whose length is safe as the robot is known now, measured before the rest.

use serde::{Deserialize, Serialize};

use super::job::{Job, OptimiseTable};
use dbbd_model::design::Criterion;

/// Share of the poses that may be barred without a stage: before the first length, and later.
const FEW_AT_FIRST: f64 = 1.0 / 3.0;
const FEW_LATER: f64 = 0.01;

/// The poses that are barred in a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Lengths that were measured before it.
    pub lengths: usize,
    /// Candidates that can be reached.
    pub reachable: usize,
    /// Of these, the ones whose length might leave the stroke.
    pub barred: usize,
}

impl Stage {
    pub(crate) fn bars_many(&self) -> bool {
        let few = if self.lengths == 0 { FEW_AT_FIRST } else { FEW_LATER };
        self.barred as f64 > few * self.reachable as f64
    }
}

impl Job {
    /// The job without `taught_deg`.
    #[must_use]
    pub(crate) fn untaught(&self) -> Self {
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

    /// The job with `points` poses about its base balls that detect changes best, in place of its circles.
    #[must_use]
    pub fn as_check(&self, points: u32) -> Self {
        let before = self.optimise.clone().unwrap_or_default();
        let criterion = Criterion::Change;
        self.with_poses(OptimiseTable { points, criterion, parameters: None, stage_points: points, ..before })
    }

    fn with_poses(&self, optimise: OptimiseTable) -> Self {
        Self { circles: Vec::new(), optimise: Some(optimise), ..self.clone() }
    }
}
