//! The strength of the prior by cross-validation: which factor on its standard deviations predicts held-out
//! lengths best.

use std::borrow::Cow;

use super::estimate::{IdentifyError, estimate};
use super::folds::{DEFAULT_FOLDS, held_out, predicts_better, rms};
use super::lengths::Lengths;
use super::options::{Options, Prior, PriorScale};
use super::result::{PriorUsed, ScaleTried};
use crate::model::{LengthModel, ParamId, Robot};

/// The factors tried, from the nearest to 1 outwards.
const TRIED: [f64; 9] = [1.0, 0.5, 2.0, 0.25, 4.0, 0.125, 8.0, 0.0625, 16.0];

/// The options with the prior's scale settled, and how it came about; no prior has none.
///
/// Of the factors whose held-out residuals are not clearly worse than the best one's, the nearest to 1 is
/// taken: the maker's word counts until the lengths speak against it.
pub(super) fn settle<'a>(
    robot: &Robot,
    start: &LengthModel,
    lengths: &Lengths,
    asked: &[ParamId],
    options: &'a Options,
) -> Result<(Cow<'a, Options>, Option<PriorUsed>), IdentifyError> {
    let source = match options.prior {
        Prior::None => return Ok((Cow::Borrowed(options), None)),
        Prior::Datasheet => "datasheet",
        Prior::Given(_) => "file",
    };
    let used = |scale, tried| Some(PriorUsed { source: source.into(), scale, tried });
    match options.prior_scale {
        PriorScale::AsGiven => return Ok((Cow::Borrowed(options), used(1.0, vec![]))),
        PriorScale::By(scale) => return Ok((Cow::Borrowed(options), used(scale, vec![]))),
        PriorScale::CrossValidated => (),
    }
    let with = |scale| Options { prior_scale: PriorScale::By(scale), ..options.clone() };
    let first = estimate(robot, start, lengths, asked, &with(1.0))?;
    let mut tried: Vec<(f64, Vec<f64>)> = Vec::new();
    for scale in TRIED {
        let options = with(scale);
        let fit = |training: &Lengths| estimate(robot, start, training, asked, &options);
        let out = held_out(lengths, &first.fit.out, DEFAULT_FOLDS, fit)?;
        let Some(residuals) = out else { return Ok((Cow::Owned(with(1.0)), used(1.0, vec![]))) };
        tried.push((scale, residuals));
    }
    let best =
        tried.iter().min_by(|(_, a), (_, b)| rms(a).total_cmp(&rms(b))).map(|(_, residuals)| residuals);
    let scale = tried
        .iter()
        .find(|(_, residuals)| best.is_some_and(|best| !predicts_better(residuals, best)))
        .map_or(1.0, |(scale, _)| *scale);
    let mut told: Vec<ScaleTried> = tried
        .iter()
        .map(|(scale, residuals)| ScaleTried { scale: *scale, held_out_rms_mm: rms(residuals) })
        .collect();
    told.sort_by(|a, b| a.scale.total_cmp(&b.scale));
    Ok((Cow::Owned(with(scale)), used(scale, told)))
}
