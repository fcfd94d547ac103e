//! Conformity of a calibrated robot over time: interim check (ISO/IEC 17025 7.7.1), decision rule (JCGM 106),
//! uncertainty budget, and the comparison of results and circular tests.
//!
//! The changes of all quantities of a family are tested together at one level (Holm, Scand. J. Statist. 6, 1979).

mod catalogue;
pub use catalogue::ConformityFinding;

mod budget;
pub mod change;
mod circles;
mod decision;
pub mod expected;
mod headline;
mod interim;
mod results;
mod standing;
mod timeline;
mod tracked;

use serde::Serialize;

pub use budget::{BudgetBasis, BudgetLine, BudgetSource, UncertaintyBudget};
pub use circles::{
    CircleFile, ComparedCircle, StoredCircle, StoredTrace, compare_circles, unlike as unlike_circles,
};
pub use decision::{ConformityDecision, ConformityOutcome, DecisionRule, decide};
pub use headline::Headline;
pub use interim::{
    CheckInput, CheckUncertainty, InterimCheck, MAX_BALL_SHIFT_MM, MIN_DOF, own_sigma_mm, sigma_mm,
};
pub use results::{
    ComparedResults, ComparedTool, PositionChange, StoredResult, UncomparedParameter, compare_results,
    of_robot, same_robot,
};
pub use standing::{Standing, StatedCheck, StatedResult, standing};
pub use timeline::{ResultTimeline, TimelineUnit};
pub use tracked::{QuantityTrend, SIGNIFICANCE_LEVEL, TrackedChange, TrackedQuantity, TrackedValue};

/// A comparison of results or circular tests in the order of time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResultComparison {
    pub schema: u32,
    pub inputs: Vec<ComparedInput>,
    /// Probability of a false significant change in a family of quantities.
    pub level: f64,
    pub time_unit: TimelineUnit,
    /// For the position over the workspace, or for the circular deviation.
    pub tolerance_mm: Option<f64>,
    #[serde(flatten)]
    pub subject: ComparisonSubject,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ComparedInput {
    pub file: String,
    pub date: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum ComparisonSubject {
    Results(Box<ComparedResults>),
    Circles { circles: Vec<ComparedCircle> },
}

#[cfg(test)]
mod tests;
