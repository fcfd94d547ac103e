//! The strength of the prior by cross-validation: which factor on its standard deviations predicts held-out
//! lengths best.

use super::estimate::estimate;
use super::lengths::Lengths;
use super::priors::{Prior, PriorScale};
use super::result::{PriorSource, PriorUsed, ScaleTried};
use super::setting::Setting;
use super::validation::{DEFAULT_FOLDS, held_out, predicts_better, rms};
use crate::catalogue::EstimationFinding;
use crate::robot::ParamId;

/// The factors tried, from the nearest to 1 outwards.
const TRIED: [f64; 9] = [1.0, 0.5, 2.0, 0.25, 4.0, 0.125, 8.0, 0.0625, 16.0];

/// A setting with the prior's scale settled, and how it came about; no prior has none.
pub(super) struct Settled<'a> {
    pub(super) setting: Setting<'a>,
    pub(super) prior: Option<PriorUsed>,
}

/// Of the factors whose held-out residuals are not clearly worse than the best one's, the nearest to 1 is taken: the
/// maker's word counts until the lengths speak against it.
pub(super) fn settle<'a>(
    setting: Setting<'a>,
    lengths: &Lengths,
    asked: &[ParamId],
) -> Result<Settled<'a>, EstimationFinding> {
    let source = match setting.options.prior {
        Prior::None => return Ok(Settled { setting, prior: None }),
        Prior::Datasheet => PriorSource::Datasheet,
        Prior::Given(_) => PriorSource::File,
        Prior::Posterior => PriorSource::Posterior,
    };
    let scale = match setting.options.prior_scale {
        PriorScale::AsGiven => Some(1.0),
        PriorScale::By(scale) => Some(scale),
        PriorScale::CrossValidated => None,
    };
    if let Some(scale) = scale {
        return Ok(Settled { setting, prior: Some(PriorUsed { source, scale, tried: vec![] }) });
    }
    let tried = held_out_by_scale(&setting, lengths, asked)?;
    let best =
        tried.iter().min_by(|(_, a), (_, b)| rms(a).total_cmp(&rms(b))).map(|(_, residuals)| residuals);
    let scale = tried
        .iter()
        .find(|(_, residuals)| best.is_some_and(|best| !predicts_better(residuals, best)))
        .map_or(1.0, |(scale, _)| *scale);
    let mut tried: Vec<ScaleTried> = tried
        .iter()
        .map(|(scale, residuals)| ScaleTried { scale: *scale, held_out_rms_mm: rms(residuals) })
        .collect();
    tried.sort_by(|a, b| a.scale.total_cmp(&b.scale));
    Ok(Settled { setting: setting.scaled(scale), prior: Some(PriorUsed { source, scale, tried }) })
}

/// The held-out residuals with each factor; none where there are fewer poses than folds.
fn held_out_by_scale(
    setting: &Setting<'_>,
    lengths: &Lengths,
    asked: &[ParamId],
) -> Result<Vec<(f64, Vec<f64>)>, EstimationFinding> {
    let first = estimate(&setting.scaled(1.0), lengths, asked)?;
    let mut tried = Vec::new();
    for scale in TRIED {
        let setting = setting.scaled(scale);
        let fit = |training: &Lengths| Ok(estimate(&setting, training, asked)?.fit.model);
        match held_out(lengths, &first.fit.out, DEFAULT_FOLDS, fit)? {
            Some(residuals) => tried.push((scale, residuals)),
            None => return Ok(vec![]),
        }
    }
    Ok(tried)
}
