//! Pages and pictures from results: SVG and HTML texts. Nothing is computed here but layout.
//!
//! The same input gives the same bytes. A page fetches nothing, runs no script, and follows the
//! reader's choice of light or dark.

mod choices;
pub mod circle;
mod diagnosis;
mod handing_back;
pub mod identification;
mod page;
mod parameters;
pub mod plan;
mod plan_told;
pub mod plot;
mod scale;
pub mod svg;

pub use handing_back::{AxisZero, BallPlace};
pub use identification::{CirclePanel, IdentificationPlots, ObservationPoint, Tolerance};
pub use page::{Fact, Provenance, ReportError, Source};
pub use plan::{CheckRow, CircleRow, PlanView, PredictedRow};
