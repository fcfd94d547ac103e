//! Pages and pictures from results: SVG and HTML texts. Nothing is computed here but layout.
//!
//! The same input gives the same bytes. A page fetches nothing, runs no script, and follows the
//! reader's choice of light or dark.

mod choices;
pub mod circle;
mod diagnosis;
mod handing_back;
pub mod identification;
mod identification_view;
mod page;
mod parameters;
pub mod plan;
mod plan_prediction;
mod plan_view;
pub mod plot;
mod scale;
pub mod svg;

pub use handing_back::{AxisZero, BallPlace};
pub use identification_view::{CirclePanel, IdentificationPlots, ObservationPoint, Tolerance};
pub use page::{Fact, Provenance, ReportError, Source};
pub use plan_view::{CheckRow, CircleRow, PlanView, PredictedRow};
