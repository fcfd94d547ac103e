//! Fit, loss, stages, outliers, validation, summary.

pub mod result;

pub use result::Identification;
