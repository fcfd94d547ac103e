//! Whether a calibrated robot is still what it was: its interim check, and results and circular tests side by side in
//! time.
//!
//! Changes are tested at one level for all quantities of a family together (Holm, Scand. J. Statist. 6, 1979). Pure:
//! results in, numbers out.

mod budget;
mod circles;
mod decision;
mod interim;
mod results;
mod timeline;
mod tracked;

use serde::Serialize;

pub use budget::{Basis, Budget, BudgetLine, COVERAGE_FACTOR, Source};
pub use circles::{
    CircleCompared, CircleFile, CircleRead, TraceRead, compare_circles, unlike as unlike_circles,
};
pub use decision::{Decision, Outcome, Rule, decide};
pub use interim::{CheckInput, InterimCheck, LEAST_FREEDOM, PositionNow, own_sigma_mm, sigma_mm};
pub use results::{
    NotCompared, PositionChange, ResultRead, ResultsCompared, compare_results, of_robot, same_robot,
};
pub use timeline::{TimeUnit, Timeline};
pub use tracked::{Change, LEVEL, Tracked, Trend, Value};

/// Results or circular tests side by side, in the order of time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub schema: u32,
    pub inputs: Vec<Input>,
    /// Probability of a change that is none among all quantities of a family.
    pub level: f64,
    pub time_unit: TimeUnit,
    /// Of the position over the workspace, or of the circular deviation.
    pub tolerance_mm: Option<f64>,
    #[serde(flatten)]
    pub subject: Subject,
}

/// A file that is compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Input {
    pub file: String,
    pub date: Option<String>,
}

/// What is compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Subject {
    Results(Box<ResultsCompared>),
    Circles { circles: Vec<CircleCompared> },
}
