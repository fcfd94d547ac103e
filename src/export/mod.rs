//! Results and captures as texts that other programs read.

pub mod frames;
pub mod mastering;
pub mod urdf;
