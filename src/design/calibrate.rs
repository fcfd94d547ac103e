//! The whole calibration: estimation first, then what design recommends for it, then the result.

use super::recommend;
use crate::catalogue::EstimationFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::{Calibration, CalibrationResult, Input, Remounted, remounted};
use crate::measurement::Measurements;

/// A calibration with the measurements as it took them.
pub struct Calibrated {
    pub result: CalibrationResult,
    /// With balls of their own for those that were mounted anew amid the data; `None` where none was.
    pub observations: Option<Measurements>,
}

/// Calibrates; the lengths to a base ball that was mounted anew amid the data get a ball of their own. `found` is what was
/// found in the inputs before.
///
/// # Errors
/// Numbers that are not finite, nothing to estimate.
pub fn calibrate_mountings(
    input: &Input<'_>,
    found: Vec<Diagnostic>,
) -> Result<Calibrated, EstimationFinding> {
    let mut result = calibrate(input, found)?;
    let mut apart: Option<Remounted> = None;
    loop {
        let here = apart.as_ref().map_or(*input, |apart| apart.instead_of(input));
        let Some(further) = remounted(&here) else { break };
        let anew = calibrate(&further.instead_of(input), result.input_findings.clone())?;
        let Some(finding) = further.finding(&here, &result, &anew) else { break };
        (result, apart) = (anew.with_finding(finding.into()), Some(further));
    }
    Ok(Calibrated { result, observations: apart.map(|apart| apart.observations) })
}

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
