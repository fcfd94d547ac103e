//! Pages and pictures from results: SVG and HTML texts. Nothing is computed here but layout.
//!
//! The same input gives the same bytes. A page fetches nothing, runs no script, and follows the
//! reader's choice of light or dark. Templates take the result itself; numbers are formatted by the
//! filters of `page`.

pub mod bar;
pub mod calibration;
pub mod check;
pub mod circle;
pub mod compare;
pub mod export;
mod page;
mod parameters;
pub mod plan;
pub mod plot;
mod scale;
pub mod svg;
