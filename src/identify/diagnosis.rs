//! How well the data tell what was estimated, and what to measure next.

use nalgebra::DMatrix;

use super::estimate::Estimate;
use super::lengths::Weighted;
use super::options::{Options, Prior};
use super::places::{is_place, well_told};
use super::result::{Advice, Correlated, PredictedPair};
use crate::identifiability::trial::{Kind, Measured};
use crate::identifiability::{
    Correlation, Observability, Workspace, correlations, factor, known_beforehand, observability,
};
use crate::model::{LengthModel, ParamId, Reading, Robot};

/// Above this share of the error before, a further measurement adds next to nothing.
const NOTHING: f64 = 0.97;

/// The weighted Jacobian of all parameters at the solution, and where an error counts.
pub(super) struct Seen {
    pub(super) ids: Vec<ParamId>,
    pub(super) factor: DMatrix<f64>,
    pub(super) workspace: Workspace,
}

/// The indices of the parameters `told`, their columns in units of what is known beforehand, of lengths whose
/// standard deviation is `sigma_mm`.
pub(super) fn indices(
    robot: &Robot,
    seen: &Seen,
    told: &[ParamId],
    lengths: usize,
    sigma_mm: f64,
) -> Option<Observability> {
    let places: Vec<usize> =
        told.iter().filter_map(|id| seen.ids.iter().position(|other| other == id)).collect();
    let mut scaled = seen.factor.select_columns(&places);
    for (mut column, place) in scaled.column_iter_mut().zip(&places) {
        column *= sigma_mm * known_beforehand(robot, seen.ids[*place], None);
    }
    observability(&scaled, lengths)
}

/// The pairs that are hardly told apart. Of what only the prior tells apart, `dependent` speaks.
pub(super) fn correlated(estimate: &Estimate, covariance: &DMatrix<f64>) -> Vec<Correlated> {
    let told: Vec<usize> =
        (0..estimate.kept.len()).filter(|&k| estimate.base.contains(&estimate.kept[k])).collect();
    correlations(&estimate.base, &covariance.select_rows(&told).select_columns(&told))
        .into_iter()
        .map(|Correlation { pair: [a, b], r }| Correlated { pair: [a.to_string(), b.to_string()], r })
        .collect()
}

/// What to measure next, best first: only where something is confounded that lengths could tell, too weak, or
/// where the position is not pinned; only what would lower the error. `start` is the set-up as it was given.
pub(super) fn advice(
    robot: &Robot,
    (start, estimate): (&LengthModel, &Estimate),
    lengths: &Weighted,
    seen: &Seen,
    told: &[ParamId],
    (predicted, pinned): (&PredictedPair, bool),
    options: &Options,
) -> Vec<Advice> {
    let ids: Vec<ParamId> = estimate.analysis.ids.clone();
    let known_to = |id: &ParamId| options.prior_sd(robot, *id).or_else(|| estimate.prior_sd(*id));
    let known: Vec<f64> = ids
        .iter()
        .map(|id| known_to(id).unwrap_or_else(|| known_beforehand(robot, *id, options.bar_u_mm)))
        .collect();
    // A set-up that the lengths hardly tell may have run off in the fit.
    let told_places = well_told(robot, start, lengths, &ids).unwrap_or_default();
    let sound = ids.iter().filter(|id| is_place(id)).all(|id| told_places.contains(id));
    let model = if sound { &estimate.before } else { start };
    let some = lengths.some(|reading, sigma| (*reading, sigma)).into_iter();
    let readings: Vec<Reading> =
        some.filter(|(_, sigma)| sigma.is_finite()).map(|(reading, _)| reading).collect();
    let measured = Measured { robot, model, readings: &readings, ids: &ids, known: &known };
    let all_told = estimate.weak.is_empty() && estimate.base.iter().all(|id| told.contains(id));
    if all_told && pinned && !measured.more_can_be_told(estimate.analysis.base.rank) {
        return Vec::new();
    }
    let share = mean_of_rms(robot, seen, predicted.nominal.mean, options);
    // Two poses or fewer are aligned away whatever the robot: there is no error to lower.
    if !share.is_finite() {
        return Vec::new();
    }
    let workspace = Workspace::new(&model.geometry, &options.workspace_poses(robot), &ids);
    let rows = factor(model, lengths, &ids);
    let proposals = measured.proposals((&rows, lengths.rms_sigma()), &workspace, share, told);
    let Some((now_mm, proposals)) = proposals else { return Vec::new() };
    // With a prior the result's own figure is by the same measure, up to the robots drawn for it; where the solver
    // did worse than the prior allows, a proposal is not to pay for it.
    let scale = match options.prior {
        Prior::None => 1.0,
        _ => (predicted.identified.mean / now_mm).min(1.0),
    };
    proposals
        .into_iter()
        .filter(|proposal| proposal.kind != Kind::Prior || options.prior == Prior::None)
        .map(|proposal| {
            let mut advice = Advice {
                kind: proposal.kind,
                text: String::new(),
                poses: proposal.poses,
                ball_mm: proposal.ball_mm,
                before_mm: predicted.identified.mean,
                after_mm: scale * proposal.error_mm,
                adds: proposal.kind == Kind::Prior || proposal.error_mm < NOTHING * now_mm,
                tells: proposal.tells.iter().map(ToString::to_string).collect(),
            };
            advice.text = text(&advice, &proposal.what, &options.prior);
            advice
        })
        // Without a prior this error and that with one are of two estimates: the prior alone may make it larger.
        .filter(|advice| advice.after_mm < advice.before_mm)
        .collect()
}

/// The mean error of robots as known beforehand over its root mean square.
fn mean_of_rms(robot: &Robot, seen: &Seen, mean_mm: f64, options: &Options) -> f64 {
    let jacobian = seen.workspace.jacobian();
    let moved = |(id, column): (&ParamId, nalgebra::DVectorView<'_, f64>)| {
        let known = if id.is_optional() { None } else { options.prior_sd(robot, *id) };
        column.norm_squared() * known.unwrap_or(0.0).powi(2)
    };
    let square: f64 = seen.ids.iter().zip(jacobian.column_iter()).map(moved).sum();
    mean_mm / (3.0 * square / jacobian.nrows().max(1) as f64).sqrt()
}

/// A proposal as a sentence.
fn text(advice: &Advice, what: &str, prior: &Prior) -> String {
    let Advice { before_mm, after_mm, tells, .. } = advice;
    let mut text = format!("{what}: predicted 3-D error {before_mm:.3} -> {after_mm:.3} mm");
    if *prior == Prior::None && advice.kind != Kind::Prior {
        text.push_str(" with --prior datasheet");
    }
    if !tells.is_empty() {
        text.push_str(&format!(", and it tells {}", tells.join(", ")));
    } else if !advice.adds {
        let nothing =
            if *prior == Prior::None { "as the prior does alone" } else { "so it adds next to nothing" };
        text.push_str(&format!(", {nothing}"));
    }
    text
}
