//! What lengths at planned poses will tell: rank, standard deviations, indices, 3-D error.

use super::predicted::unit_draws;
use super::{Analysis, Belief, ErrorSummary, Observability, Workspace, analyse, factor, observability};
use crate::model::{AXES, ParamId, Reading};

/// A parameter of which lengths alone leave more than this many of its standard deviations before is not told.
const WEAK: f64 = 3.0;

/// What will be known after a plan.
pub struct Outlook {
    /// Rank and dependent directions.
    pub analysis: Analysis,
    /// The indices of what is told, its columns in units of what was known before.
    pub observability: Option<Observability>,
    /// Each parameter: before, after, and from the lengths alone where these tell it.
    pub parameters: Vec<Foreseen>,
    /// 3-D error of the robot as it is known now, and as it will be, mm.
    pub error_mm: [ErrorSummary; 2],
    /// Over the workspace: where the ball is, mm, and the root mean square of its error afterwards, mm.
    pub map: Vec<([f64; 3], f64)>,
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

/// What lengths at `readings` of standard deviation `sigma_mm` will add to `belief`, with the 3-D error over the
/// axis vectors of `poses` (rad). `None` when a number is not finite.
pub fn outlook(
    belief: &Belief,
    readings: &[Reading],
    sigma_mm: f64,
    poses: &[[f64; AXES]],
) -> Option<Outlook> {
    let ids = belief.ids();
    let analysis = analyse(&belief.model, readings, ids)?;
    let after = belief.after(readings, sigma_mm)?;
    let kept = analysis.kept();
    let place = |id: &ParamId| ids.iter().position(|other| other == id);
    let mut scaled = factor(&belief.model, readings, &kept);
    for (at, id) in kept.iter().enumerate() {
        scaled.column_mut(at).scale_mut(place(id).map_or(1.0, |place| belief.sd(place)));
    }
    // Unit columns for the inverse: lengths and angles differ by orders of magnitude.
    let inverse = scaled.clone().qr().r().try_inverse();
    let alone = |id: &ParamId| {
        let at = kept.iter().position(|other| other == id)?;
        Some(inverse.as_ref()?.row(at).norm() * belief.sd(place(id)?) * sigma_mm)
    };
    let parameters: Vec<Foreseen> = ids
        .iter()
        .enumerate()
        .map(|(at, id)| Foreseen { id: *id, before: belief.sd(at), after: after.sd(at), alone: alone(id) })
        .collect();
    // A combination that only rounding tells would stand for all indices.
    let told: Vec<usize> = (0..kept.len())
        .filter(|&at| {
            let before = place(&kept[at]).map_or(0.0, |place| belief.sd(place));
            alone(&kept[at]).is_some_and(|alone| alone <= WEAK * before)
        })
        .collect();
    let workspace = Workspace::new(&belief.model.geometry, poses, ids);
    let [now, then] =
        [belief.root(), after.root()].map(|root| workspace.displacements(&(root * unit_draws(root.ncols()))));
    let positions = workspace.positions.iter().map(|position| (*position).into());
    Some(Outlook {
        observability: (!told.is_empty())
            .then(|| observability(&scaled.select_columns(&told), readings.len()))
            .flatten(),
        error_mm: [workspace.summary(&now), workspace.summary(&then)],
        map: positions.zip(workspace.map(&then)).collect(),
        analysis,
        parameters,
    })
}
