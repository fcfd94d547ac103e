//! The predicted outcome of planned lengths: rank, standard deviations, observability indices, position uncertainty.

use super::position::unit_draws;
use super::priors::WEAK;
use super::result::MapPoint;
use super::{Analysis, ErrorSummary, Observability, Posterior, analyse, factor, inverse_root, observability};
use crate::measurement::PreparedMeasurement;
use crate::robot::{AXES, ParamId};

pub struct DesignPrediction {
    /// Rank and linearly dependent parameters.
    pub analysis: Analysis,
    /// The indices of the identifiable parameters, in units of their prior standard deviations.
    pub observability: Option<Observability>,
    pub parameters: Vec<ParameterPrediction>,
    /// Position error before and after the lengths, mm.
    pub error_mm: [ErrorSummary; 2],
    /// Position error over the workspace after the lengths.
    pub map: Vec<MapPoint>,
}

/// Standard deviations of a parameter, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterPrediction {
    pub id: ParamId,
    pub before: f64,
    pub after: f64,
    /// Standard deviation by the lengths alone, for a parameter of the base set.
    pub alone: Option<f64>,
}

/// Predicts the effect of lengths at `readings` of standard deviation `sigma_mm` on `prior`, with the position error over
/// `poses` (axis angles, rad). `None` if a number is not finite.
pub fn predict_design(
    prior: &Posterior,
    readings: &[PreparedMeasurement],
    sigma_mm: f64,
    poses: &[[f64; AXES]],
) -> Option<DesignPrediction> {
    let ids = prior.ids();
    let analysis = analyse(&prior.model, readings, ids)?;
    let after = prior.after(readings, sigma_mm)?;
    let kept = analysis.kept();
    let mut scaled = factor(&prior.model, readings, &kept);
    for (at, id) in kept.iter().enumerate() {
        scaled.column_mut(at).scale_mut(prior.sd(*id).unwrap_or(1.0));
    }
    let inverse = inverse_root(&scaled);
    let alone = |id: ParamId| {
        let at = kept.iter().position(|other| *other == id)?;
        Some(inverse.as_ref()?.row(at).norm() * prior.sd(id)? * sigma_mm)
    };
    let sds = prior.sds().zip(after.sds());
    let parameter = |(&id, (before, after))| ParameterPrediction { id, before, after, alone: alone(id) };
    // A combination that is determined only by rounding would dominate all indices.
    let is_identifiable =
        |id: ParamId| alone(id).is_some_and(|alone| alone <= WEAK * prior.sd(id).unwrap_or(0.0));
    let identifiable: Vec<usize> = (0..kept.len()).filter(|&at| is_identifiable(kept[at])).collect();
    let workspace = prior.workspace(poses);
    let [now, then] =
        [prior.root(), after.root()].map(|root| workspace.displacements(&(root * unit_draws(root.ncols()))));
    Some(DesignPrediction {
        observability: observability(&scaled.select_columns(&identifiable), readings.len()),
        parameters: ids.iter().zip(sds).map(parameter).collect(),
        error_mm: [ErrorSummary::of(&now), ErrorSummary::of(&then)],
        map: workspace.map(&then),
        analysis,
    })
}
