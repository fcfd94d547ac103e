//! From a job to a plan: circles and chosen poses, checked before anything moves.

mod catalogue;
pub use catalogue::PlanFinding;

mod build;
mod cell;
pub mod check;
mod circle;
pub mod clearance;
mod files;
mod frames;
pub mod job;
mod module;
mod optimise;
mod orientations;
mod pass;
pub mod path;
pub mod prediction;
mod prior;
mod quantity;
mod recommend;
mod refusal;
pub mod region;
mod rig;
mod risk;
mod route;
pub mod rows;
mod stage;
mod steps;
pub mod timing;
pub mod workspace;

use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer, Serialize};

pub use circle::REFERENCE_EVERY;
use dbbd_model::estimation::change::CheckPower;
pub use dbbd_model::measurement::PoseKind;
use dbbd_model::provenance::Provenance;
pub use frames::PlanFrames;
pub use job::{DEFAULT_PROTOCOL, Job, MotionTable, SIGMA_UM};
pub use module::MODULE_DWELLS;
pub use pass::PlannedPass;
pub use prediction::PlanPrediction;
pub use prior::{PlanningPrior, TaughtBall};
pub use quantity::{CheckQuantity, PlanCheck};
pub use refusal::Refusal;
pub use rows::{CirclePlace, MotionKind, PlanRow};
pub use stage::Stage;

/// A plan: the rows of `plan.csv` and the header in `plan.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    pub rows: Vec<PlanRow>,
    pub header: PlanHeader,
}

/// `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanHeader {
    pub schema: u32,
    /// CRC-64/XZ over the text of `plan.csv` with job, robot, moves and passes, sixteen hexadecimal digits.
    pub hash: String,
    /// The same over both files, computed with these digits as 0; present only in a file. Absent in files of older versions,
    /// whose `hash` is that of `plan.csv` alone.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub text_hash: String,
    pub job: Job,
    /// The text of the robot's file.
    pub robot: String,
    #[serde(default, skip_serializing_if = "Provenance::is_empty")]
    pub provenance: Provenance,
    /// One entry for each row, in order.
    pub moves: Vec<MoveTime>,
    /// The passes of continuous circles, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub passes: Vec<PlannedPass>,
    /// The worst value of each quantity that was checked.
    pub checks: Vec<PlanCheck>,
    /// Findings about the chosen poses; for people, not read back.
    #[serde(default, skip_serializing_if = "Vec::is_empty", with = "notes")]
    pub notes: Vec<PlanFinding>,
    /// The base balls that are to be taught before the bar is mounted; the risk depends on it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub taught: Vec<TaughtBall>,
    /// Probability that a robot within its tolerance leaves the stroke anywhere while the bar is mounted.
    #[serde(default)]
    pub stroke_risk: f64,
    /// Present if not every pose that can be reached is allowed yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Stage>,
    /// What the plan will determine; for people, not read back.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "not_read")]
    pub predictions: Option<PlanPrediction>,
    /// What the check of a calibrated robot by this plan will find; for people, not read back.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "not_read")]
    pub check: Option<CheckPower>,
}

/// Findings with code, text and values.
mod notes {
    use serde::{Deserializer, Serializer};

    use super::{PlanFinding, not_read};
    use dbbd_model::diagnostic::Diagnostic;

    pub(super) fn serialize<S: Serializer>(notes: &[PlanFinding], out: S) -> Result<S::Ok, S::Error> {
        out.collect_seq(notes.iter().map(|note| Diagnostic::new(note.clone())))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<PlanFinding>, D::Error> {
        not_read(from)
    }
}

/// Skips a value that is written for people.
fn not_read<'de, D: Deserializer<'de>, T: Default>(from: D) -> Result<T, D::Error> {
    IgnoredAny::deserialize(from).map(|_| T::default())
}

/// The time code: speeds and duration of a row's move, chosen so that all intervals between dwells differ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MoveTime {
    pub index: u32,
    /// Speed of the ball along its path, mm/s (LIN, CIRC).
    pub feed_mm_s: f64,
    /// Speed of the orientation, degrees/s (LIN, CIRC).
    pub turn_deg_s: f64,
    /// Share of the greatest axis speeds, percent (PTP).
    pub axis_percent: f64,
    /// Duration of the move from the last pose to this one at full override, s.
    pub duration_s: f64,
}
