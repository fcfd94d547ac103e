//! A stage: a few poses whose length is safe as the robot is known now, to be measured before the rest.

use serde::{Deserialize, Serialize};

use super::job::{Job, Optimise};
use crate::design::Criterion;

/// Up to this share of the poses may be barred without a stage: of a robot of which nothing was measured yet, and later.
const FEW_AT_FIRST: f64 = 1.0 / 3.0;
const FEW_LATER: f64 = 0.01;

/// What a stage bars.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Lengths that were known before it.
    pub lengths: usize,
    /// Poses drawn that can be reached, and
    pub reachable: usize,
    /// those of them whose length might leave the stroke.
    pub barred: usize,
}

impl Stage {
    pub(crate) fn bars_many(&self) -> bool {
        let few = if self.lengths == 0 { FEW_AT_FIRST } else { FEW_LATER };
        self.barred as f64 > few * self.reachable as f64
    }
}

impl Job {
    /// The job without how its base balls were taught.
    #[must_use]
    pub(crate) fn untaught(&self) -> Self {
        let mut job = self.clone();
        job.centres.iter_mut().for_each(|table| table.taught_deg = None);
        job
    }

    /// The job with `points` chosen poses about its base balls in place of its circles.
    #[must_use]
    pub fn as_stage(&self, points: u32) -> Self {
        let before = self.optimise.clone().unwrap_or(Optimise { points, ..Optimise::default() });
        self.with_poses(Optimise { stage_points: points, ..before })
    }

    /// The job with `points` poses about its base balls that see most of a change, in place of its circles.
    #[must_use]
    pub fn as_check(&self, points: u32) -> Self {
        let before = self.optimise.clone().unwrap_or_default();
        let criterion = Criterion::Change;
        self.with_poses(Optimise { points, criterion, parameters: None, stage_points: points, ..before })
    }

    fn with_poses(&self, optimise: Optimise) -> Self {
        Self { circles: Vec::new(), optimise: Some(optimise), ..self.clone() }
    }
}
