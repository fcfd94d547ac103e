//! Circles and pose sets: what the robot is to do, checked before anything moves.

mod advice;
mod build;
pub mod candidates;
mod cell;
pub mod check;
mod circle;
pub mod clearance;
mod datasheet;
mod files;
mod frames;
mod hold;
pub mod how_many;
pub mod job;
mod knowledge;
mod module;
mod optimise;
mod pass;
pub mod path;
mod places;
pub mod prediction;
mod quantity;
pub mod region;
mod rig;
mod risk;
mod route;
pub mod rows;
mod second_ball;
mod solve;
mod stage;
mod steps;
pub mod timing;
pub mod workspace;

use serde::{Deserialize, Serialize};

pub use build::Refused;
pub use check::Finding;
pub use circle::REFERENCE_EVERY;
pub use frames::Frames;
pub use job::{Job, MotionTable};
pub use knowledge::{Knowledge, Taught};
pub use module::MODULE_DWELLS;
pub use pass::Pass;
pub use places::CirclePlace;
pub use prediction::Prediction;
pub use quantity::{Check, Quantity};
pub use rows::{Kind, Motion, PlanRow};
pub use stage::Stage;

/// A plan: the rows of `plan.csv` and the header in `plan.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The rows, in order.
    pub rows: Vec<PlanRow>,
    /// What stands beside them.
    pub header: Header,
}

/// `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Version of this form: 1.
    pub schema: u32,
    /// CRC-64/XZ over the text of `plan.csv`, sixteen hexadecimal digits.
    pub hash: String,
    /// The job it was made from.
    pub job: Job,
    /// The robot it was made for, as its file's text.
    pub robot: String,
    /// How long each move lasts: one entry for each row, in order.
    pub moves: Vec<MoveTime>,
    /// The passes of continuous circles, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub passes: Vec<Pass>,
    /// Of each quantity that was checked the worst value, its limit, and where.
    pub checks: Vec<Check>,
    /// What the planner has to say about it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// The base balls that are to be taught before the bar is mounted, and how; the risk rests on it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub taught: Vec<Taught>,
    /// Probability that a robot within its tolerance leaves the stroke anywhere while the bar is on.
    #[serde(default)]
    pub stroke_risk: f64,
    /// Where not every pose that can be reached is allowed yet: what this stage bars.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Stage>,
    /// What the plan will tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predictions: Option<Prediction>,
}

/// The time code: how a row's move is driven, so that every interval between dwells is its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MoveTime {
    /// The row's index.
    pub index: u32,
    /// Speed of the ball along its path, mm/s (LIN, CIRC).
    pub feed_mm_s: f64,
    /// Speed of the orientation, degrees/s (LIN, CIRC).
    pub turn_deg_s: f64,
    /// Share of the greatest axis speeds, percent (PTP).
    pub axis_percent: f64,
    /// How long the move lasts at full override, s, from leaving the last pose to reaching this one.
    pub duration_s: f64,
}
