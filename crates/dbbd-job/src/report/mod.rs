//! Pages and pictures from results: SVG and HTML texts. Only layout is computed here.
//!
//! The same input gives the same bytes. A page loads nothing, can be read and printed without its script, and follows the
//! reader's choice of light or dark. Templates take the result itself; numbers are formatted by the filters of `page`.

mod catalogue;
pub use catalogue::ReportFinding;

pub mod bar;
pub mod calibration;
pub mod certificate;
pub mod check;
pub mod circle;
pub mod circle_json;
pub mod compare;
pub mod export;
pub mod page;
mod parameters;
pub mod plan;
pub mod plot;
mod scale;
mod scene;
pub mod svg;
mod verdict;
pub use verdict::Verdict;

#[cfg(test)]
mod tests;
