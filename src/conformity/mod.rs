//! Conformity of a calibrated robot over time: interim check (ISO/IEC 17025 7.7.1), decision rule (JCGM 106),
//! uncertainty budget, and the comparison of results and circular tests.
//!
//! The changes of all quantities of a family are tested together at one level (Holm, Scand. J. Statist. 6, 1979).

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

/// A comparison of results or circular tests in the order of time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub schema: u32,
    pub inputs: Vec<Input>,
    /// Probability of a false significant change in a family of quantities.
    pub level: f64,
    pub time_unit: TimeUnit,
    /// For the position over the workspace, or for the circular deviation.
    pub tolerance_mm: Option<f64>,
    #[serde(flatten)]
    pub subject: Subject,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Input {
    pub file: String,
    pub date: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Subject {
    Results(Box<ResultsCompared>),
    Circles { circles: Vec<CircleCompared> },
}
