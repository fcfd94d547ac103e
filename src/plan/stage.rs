//! A stage: a few poses whose length is safe as the robot is known now, to be measured before the rest.

use serde::{Deserialize, Serialize};

use super::job::{Job, Optimise};

/// Up to this share of the poses may be barred without a stage: of a robot of which nothing was measured yet, and later.
const FEW: [f64; 2] = [1.0 / 3.0, 0.01];

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
    /// Whether more than a few poses are barred.
    pub(crate) fn bars_many(&self) -> bool {
        let few = FEW[usize::from(self.lengths > 0)];
        self.barred as f64 > few * self.reachable as f64
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let which = match self.lengths {
            0 => "this is the first stage".to_owned(),
            lengths => format!("this is another stage, after {lengths} lengths"),
        };
        write!(
            out,
            "{which}: {} of {} poses that can be reached are still barred, because their length might leave the \
             stroke as the robot is known now; measure these, identify, and plan again with --robot \
             robot-identified.toml",
            self.barred, self.reachable
        )
    }
}

impl Job {
    /// The job with `points` chosen poses about its base balls in place of its circles.
    #[must_use]
    pub fn as_stage(&self, points: u32) -> Self {
        let mut job = self.clone();
        job.circles.clear();
        let stage = Optimise { points, stage_points: points, ..Optimise::default() };
        job.optimise = Some(Optimise { stage_points: points, ..job.optimise.take().unwrap_or(stage) });
        job
    }
}
