//! The whole calibration: estimation first, then what design recommends for it, then the result.

use super::recommend;
use crate::catalogue::EstimationFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::{Calibration, CalibrationResult, Input};

/// Calibrates; `found` is what was found in the inputs before.
///
/// # Errors
/// Numbers that are not finite, nothing to estimate.
pub fn calibrate(
    input: &Input<'_>,
    mut found: Vec<Diagnostic>,
) -> Result<CalibrationResult, EstimationFinding> {
    let calibration = Calibration::new(input)?;
    let recommendations = recommend(&calibration).unwrap_or_else(|finding| {
        found.push(finding.into());
        Vec::new()
    });
    Ok(calibration.result(recommendations, found))
}
