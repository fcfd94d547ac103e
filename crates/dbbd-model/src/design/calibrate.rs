//! The whole calibration: estimation, recommendations, result; and its correction for changes during the measurement.

use super::recommend;
use crate::diagnostic::Diagnostic;
use crate::estimation::EstimationFinding;
use crate::estimation::{Calibration, ChangedSetUp, CompletedCalibration, Input, remounted};
use crate::measurement::Measurements;

pub struct Calibrated {
    pub calibration: CompletedCalibration,
    /// The measurements corrected for remounted balls and changes of zero; `None` if there were none.
    pub observations: Option<Measurements>,
}

/// The largest number of changes.
const MOST_CHANGES: usize = 8;
/// A remounted ball must have residuals below this fraction of those of a change of zero, which has fewer unknowns.
const SMALLER: f64 = 0.9;

/// The calibration with a change during the measurement.
struct Changed {
    calibration: CompletedCalibration,
    set_up: ChangedSetUp,
    finding: EstimationFinding,
}

/// Calibrates. The later lengths to a base ball that was remounted during the measurement get a ball of their own, and a
/// change of the zero of a bar is subtracted. `input_findings` go into the result.
///
/// # Errors
/// A number is not finite, or there is nothing to estimate.
pub fn calibrate_run(
    input: &Input<'_>,
    input_findings: Vec<Diagnostic>,
) -> Result<Calibrated, EstimationFinding> {
    let mut calibration = calibrate(input, input_findings)?;
    let mut set_up: Option<ChangedSetUp> = None;
    for _ in 0..MOST_CHANGES {
        let here = set_up.as_ref().map_or(*input, |changed| changed.instead_of(input));
        let zero = zero_changed(&here, &calibration)?;
        let Some(changed) = remounted_ball(&here, &calibration, zero.as_ref())?.or(zero) else { break };
        calibration = changed.calibration.with_finding(changed.finding.into());
        set_up = Some(changed.set_up);
    }
    Ok(Calibrated { calibration, observations: set_up.map(|changed| changed.observations) })
}

/// The calibration with the change of zero that `before` found, if it is better.
fn zero_changed(
    here: &Input<'_>,
    before: &CompletedCalibration,
) -> Result<Option<Changed>, EstimationFinding> {
    // If rows are shifted, their order means nothing. With a list of parameters the user has decided what to estimate.
    let is_wrong_row = |finding: &EstimationFinding| {
        matches!(finding, EstimationFinding::ShiftedRows { .. } | EstimationFinding::ManyOutliers { .. })
    };
    if here.options.estimate.is_some() || before.estimate_findings().any(is_wrong_row) {
        return Ok(None);
    }
    let Some(change) = &before.zero_change else { return Ok(None) };
    let observations = change.taken_out(here.observations);
    let set_up = ChangedSetUp { observations, start: here.start.clone() };
    let calibration = calibrate(&set_up.instead_of(here), before.input_findings())?;
    let (old, new) = (&before.result, &calibration.result);
    let is_better =
        new.residual_mm.after.rms < old.residual_mm.after.rms || new.outliers.len() < old.outliers.len();
    let finding = change.finding(here.observations);
    Ok(is_better.then_some(Changed { calibration, set_up, finding }))
}

/// The calibration with a remounted ball, if it is better than `before` and than a change of `zero`.
fn remounted_ball(
    here: &Input<'_>,
    before: &CompletedCalibration,
    zero: Option<&Changed>,
) -> Result<Option<Changed>, EstimationFinding> {
    let Some(remounted) = remounted(here) else { return Ok(None) };
    let calibration = calibrate(&remounted.set_up.instead_of(here), before.input_findings())?;
    let rms_mm = |calibration: &CompletedCalibration| calibration.result.residual_mm.after.rms;
    let is_better = zero.is_none_or(|zero| rms_mm(&calibration) < SMALLER * rms_mm(&zero.calibration));
    let finding = remounted.finding(here, before, &calibration).filter(|_| is_better);
    Ok(finding.map(|finding| Changed { calibration, set_up: remounted.set_up, finding }))
}

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
