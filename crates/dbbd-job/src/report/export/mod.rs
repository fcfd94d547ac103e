//! Results and captures in the formats of other tools.

pub mod frames;
pub mod hand_back;
pub mod joint_errors;
mod kuka;
pub mod mastering;
pub mod mcap;
mod ros_calibration;
pub mod urdf;
pub mod urdf_patch;
