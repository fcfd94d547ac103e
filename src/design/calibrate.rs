//! The whole calibration: estimation first, then what design recommends for it, then the result.

use super::recommend;
use crate::catalogue::EstimationFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::{Calibration, CalibrationResult, ChangedSetUp, Input, remounted};
use crate::measurement::Measurements;

/// A calibration with the measurements as it took them.
pub struct Calibrated {
    pub result: CalibrationResult,
    /// With balls of their own for those that were mounted anew amid the data, and without what the zero of a bar changed by;
    /// `None` where they are as they were given.
    pub observations: Option<Measurements>,
}

/// Changes amid the data that are looked for one after the other.
const MOST_CHANGES: usize = 8;
/// How much smaller the residuals of a ball apart are than those without a change of the zero, which has fewer unknowns.
const SMALLER: f64 = 0.9;

/// What changed amid the data, and the calibration that takes it into account.
struct Changed {
    result: CalibrationResult,
    set_up: ChangedSetUp,
}

impl Changed {
    fn new(
        set_up: ChangedSetUp,
        input: &Input<'_>,
        found: Vec<Diagnostic>,
    ) -> Result<Self, EstimationFinding> {
        Ok(Self { result: calibrate(&set_up.instead_of(input), found)?, set_up })
    }

    fn rms_mm(&self) -> f64 {
        self.result.residual_mm.after.rms
    }

    /// Whether it leaves less, or fewer outliers.
    fn is_better_than(&self, before: &CalibrationResult) -> bool {
        self.rms_mm() < before.residual_mm.after.rms || self.result.outliers.len() < before.outliers.len()
    }
}

/// Calibrates; the lengths to a base ball that was mounted anew amid the data get a ball of their own, and a change of the zero
/// of a bar is taken out. `found` is what was found in the inputs before.
///
/// # Errors
/// Numbers that are not finite, nothing to estimate.
pub fn calibrate_run(input: &Input<'_>, found: Vec<Diagnostic>) -> Result<Calibrated, EstimationFinding> {
    let mut result = calibrate(input, found)?;
    let mut set_up: Option<ChangedSetUp> = None;
    for _ in 0..MOST_CHANGES {
        let here = set_up.as_ref().map_or(*input, |changed| changed.instead_of(input));
        let Some((changed, finding)) = changed(&here, &result)? else { break };
        result = changed.result.with_finding(finding.into());
        set_up = Some(changed.set_up);
    }
    Ok(Calibrated { result, observations: set_up.map(|changed| changed.observations) })
}

/// The change that the data show most, beside a result of theirs.
fn changed(
    here: &Input<'_>,
    result: &CalibrationResult,
) -> Result<Option<(Changed, EstimationFinding)>, EstimationFinding> {
    let found = || result.input_findings.clone();
    // A list of parameters says what the lengths are to show; what belongs to other rows has no order.
    let is_other = |finding: &EstimationFinding| {
        matches!(finding, EstimationFinding::ShiftedRows { .. } | EstimationFinding::ManyOutliers { .. })
    };
    let is_sought = here.options.estimate.is_none() && !result.findings.iter().any(is_other);
    let change = result.zero_change.as_ref().filter(|_| is_sought);
    let steady = change.map(|change| {
        let observations = change.taken_out(here.observations);
        let changed = Changed::new(ChangedSetUp { observations, start: here.start.clone() }, here, found())?;
        Ok((changed, change.finding(here.observations)))
    });
    let steady = steady.transpose()?.filter(|(steady, _)| steady.is_better_than(result));
    let Some(remounted) = remounted(here) else { return Ok(steady) };
    let apart = Changed::new(remounted.set_up.clone(), here, found())?;
    let decisive = remounted.finding(here, result, &apart.result);
    let is_better = |(steady, _): &(Changed, _)| apart.rms_mm() < SMALLER * steady.rms_mm();
    Ok(match decisive {
        Some(finding) if steady.as_ref().is_none_or(is_better) => Some((apart, finding)),
        _ => steady,
    })
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
