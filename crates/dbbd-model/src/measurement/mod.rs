//! Samples of the bar, measured lengths and positions with their tables, base balls, and the measurement model.

mod catalogue;
pub use catalogue::MeasurementFinding;

mod base_ball;
mod context;
mod distinct;
mod model;
pub mod positions;
pub mod sample;
pub mod table;
mod tracker;

pub use crate::robot::{AxisAngles, BallId, BarId, CircleId, Datum, TargetId};
pub use base_ball::BaseBall;
pub use context::{ContextColumn, MeasurementContext, PoseKind};
pub use distinct::{DistinctMeasurements, are_lengths_known};
pub use model::{ColumnSelection, LengthModel, MeasurementPieces, PreparedMeasurement, PreparedModel};
pub use positions::MeasuredPosition;
pub use sample::Sample;
pub use table::{APPROACH, ApproachedPose, Measurement, Measurements, ToolPoint, beyond};
pub use tracker::Tracker;

#[cfg(test)]
mod tests;
