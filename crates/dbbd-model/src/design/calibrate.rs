//! The whole calibration: estimation, recommendations, result.

use super::recommend;
use crate::diagnostic::Diagnostic;
use crate::estimation::EstimationFinding;
use crate::estimation::{Calibration, CompletedCalibration, Input};

/// Calibrates, with recommendations; `input_findings` go into the result.
///
/// # Errors
/// A number is not finite, or there is nothing to estimate.
pub fn calibrate(
    input: &Input<'_>,
    mut input_findings: Vec<Diagnostic>,
) -> Result<CompletedCalibration, EstimationFinding> {
    let calibration = Calibration::new(input)?;
    let recommendations = recommend(&calibration).unwrap_or_else(|finding| {
        input_findings.push(finding.into());
        Vec::new()
    });
    Ok(calibration.complete(recommendations, input_findings))
}
