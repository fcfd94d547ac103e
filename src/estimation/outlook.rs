//! What lengths at planned poses will tell: rank, standard deviations, indices, 3-D error.

use super::predicted::unit_draws;
use super::priors::WEAK;
use super::result::MapPoint;
use super::{
    Analysis, ErrorSummary, Observability, Posterior, Workspace, analyse, factor, inverse_root, observability,
};
use crate::measurement::PreparedMeasurement;
use crate::robot::{AXES, ParamId};

/// What will be known after a plan.
pub struct Outlook {
    /// Rank and dependent directions.
    pub analysis: Analysis,
    /// The indices of what is determined, its columns in units of what was known before.
    pub observability: Option<Observability>,
    /// Each parameter: before, after, and from the lengths alone where these tell it.
    pub parameters: Vec<Foreseen>,
    /// 3-D error of the robot as it is known now, and as it will be, mm.
    pub error_mm: [ErrorSummary; 2],
    /// Its error afterwards over the workspace.
    pub map: Vec<MapPoint>,
}

/// One parameter's standard deviations, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foreseen {
    /// The parameter.
    pub id: ParamId,
    /// As it is known now.
    pub before: f64,
    /// With the lengths and what is known now.
    pub after: f64,
    /// From the lengths alone, for a parameter of the base set.
    pub alone: Option<f64>,
}

/// What lengths at `readings` of standard deviation `sigma_mm` will add to `posterior`, with the 3-D error over the
/// axis vectors of `poses` (rad). `None` when a number is not finite.
pub fn outlook(
    posterior: &Posterior,
    readings: &[PreparedMeasurement],
    sigma_mm: f64,
    poses: &[[f64; AXES]],
) -> Option<Outlook> {
    let ids = posterior.ids();
    let analysis = analyse(&posterior.model, readings, ids)?;
    let after = posterior.after(readings, sigma_mm)?;
    let kept = analysis.kept();
    let mut scaled = factor(&posterior.model, readings, &kept);
    for (at, id) in kept.iter().enumerate() {
        scaled.column_mut(at).scale_mut(posterior.sd(*id).unwrap_or(1.0));
    }
    let inverse = inverse_root(&scaled);
    let alone = |id: &ParamId| {
        let at = kept.iter().position(|other| other == id)?;
        Some(inverse.as_ref()?.row(at).norm() * posterior.sd(*id)? * sigma_mm)
    };
    let parameters: Vec<Foreseen> = ids
        .iter()
        .zip(posterior.sds().zip(after.sds()))
        .map(|(id, (before, after))| Foreseen { id: *id, before, after, alone: alone(id) })
        .collect();
    // A combination that only rounding determines would dominate all indices.
    let determined: Vec<usize> = (0..kept.len())
        .filter(|&at| {
            let before = posterior.sd(kept[at]).unwrap_or(0.0);
            alone(&kept[at]).is_some_and(|alone| alone <= WEAK * before)
        })
        .collect();
    let workspace = Workspace::new(&posterior.model.geometry, poses, ids);
    let [now, then] = [posterior.root(), after.root()]
        .map(|root| workspace.displacements(&(root * unit_draws(root.ncols()))));
    Some(Outlook {
        observability: (!determined.is_empty())
            .then(|| observability(&scaled.select_columns(&determined), readings.len()))
            .flatten(),
        error_mm: [workspace.summary(&now), workspace.summary(&then)],
        map: workspace.map(&then),
        analysis,
        parameters,
    })
}
