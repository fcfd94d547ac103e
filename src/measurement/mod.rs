//! What is measured: samples of the bar, lengths at poses, base balls, and the model that predicts a length.

pub mod base_ball;
pub mod context;
pub mod distinct;
pub mod model;
pub mod pieces;
pub mod sample;
pub mod table;

pub use crate::robot::{AxisAngles, BallId, BarId, CircleId};
pub use base_ball::BaseBall;
pub use context::{Column, Context, Kind};
pub use distinct::Distinct;
pub use model::{LengthModel, PreparedMeasurement, PreparedModel, Selection};
pub use pieces::MeasurementPieces;
pub use sample::Sample;
pub use table::{APPROACH, ApproachedPose, Measurement, Measurements, beyond};
