//! Design of measurements: candidate poses, their exchange, recommendations for a plan and for a result, and the calibration
//! with recommendations.

mod calibrate;
pub mod candidates;
pub mod exchange;
pub mod length_count;
pub mod placement;
mod recommend;
pub mod second_ball;

pub use calibrate::calibrate;
pub use candidates::{Candidate, Near, Sphere, change_rows, design_rows, tool_rows, workspace_rows};
pub use exchange::{Criterion, Exchange};
pub use recommend::recommend;

#[cfg(test)]
mod tests;
