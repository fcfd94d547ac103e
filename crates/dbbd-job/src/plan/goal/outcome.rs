//! What a run reaches of a goal, as plan.json has it.

use serde::{Deserialize, Serialize};

use crate::plan::job::GoalStatistic;

/// What a run for a goal reaches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalOutcome {
    /// The goal, mm.
    pub position_mm: f64,
    pub of: GoalStatistic,
    /// The position error that 90 % of the drawn robots keep, mm.
    pub reached_mm: f64,
    /// The time of the run with the mounting of balls and bar.
    pub minutes: f64,
    /// The position error that is kept for the time that a run takes, in order.
    pub curve: Vec<GoalPoint>,
}

/// The best run of a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalPoint {
    pub minutes: f64,
    pub position_mm: f64,
    pub bar_mm: f64,
    pub balls: usize,
    pub poses: usize,
}
