//! `report.html` from a result.

use crate::diagnostic::Diagnostic;
use crate::estimation::CalibrationResult;
use crate::measurement::Measurements;
use crate::report::{Provenance, Source, calibration};

pub(super) fn html(
    found: &CalibrationResult,
    observations: &Measurements,
    sources: Vec<Source>,
) -> Result<String, Diagnostic> {
    let provenance = Provenance { robot: Some(found.robot.name.clone()), sources, ..Provenance::default() };
    calibration::html(found, observations, &provenance)
}
