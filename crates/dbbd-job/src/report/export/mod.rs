//! Results and captures in the formats of other tools.

pub mod frames;
pub mod mastering;
pub mod mcap;
pub mod urdf;
pub mod urdf_patch;
