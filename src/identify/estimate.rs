//! From lengths to parameters: what can be told, what is too weak, the fit, and the lengths' sigma.

use super::covariance::too_weak;
use super::fit::{self, Fit};
use super::options::{Options, Prior};
use super::prior;
use super::solver::PriorRows;
use crate::identifiability::{Analysis, analyse};
use crate::linalg::Triangle;
use crate::model::{LengthModel, ParamId, Reading, Robot, Selection, parameter};

/// Lengths with the standard deviations they are weighted by.
#[derive(Clone, Debug)]
pub(super) struct Lengths {
    pub(super) readings: Vec<Reading>,
    /// As given, mm; 1 where nothing is known.
    pub(super) given: Vec<f64>,
    /// Whether the user vouches for them, so that they are not brought to what the residuals show.
    pub(super) vouched: bool,
    /// Whether anything is known of them at all.
    pub(super) known: bool,
}

/// An estimate, and how it came about.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    /// The nominal robot with the free part of the set-up fitted.
    pub(super) before: LengthModel,
    pub(super) analysis: Analysis,
    /// Parameters that were estimated, in canonical order.
    pub(super) kept: Vec<ParamId>,
    /// Parameters held because the data are too weak, weakest first.
    pub(super) weak: Vec<ParamId>,
    pub(super) prior: Option<PriorRows>,
    pub(super) fit: Fit,
    /// Standard deviation of each length that the fit went by, mm.
    pub(super) sigma: Vec<f64>,
}

/// Why there is no estimate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IdentifyError {
    /// A number on the way is not finite.
    #[error(
        "a length or its derivative is not finite: check angles, lengths, tool and centres for absurd values"
    )]
    NotFinite,
    /// Nothing asked for can be told.
    #[error(
        "none of the parameters asked for changes a length in these poses; ask for others, or vary the poses"
    )]
    NothingToEstimate,
    /// Fewer lengths than unknowns.
    #[error("{lengths} lengths cannot tell {parameters} parameters; measure more poses, or ask for fewer")]
    TooFewLengths {
        /// Lengths there are.
        lengths: usize,
        /// Parameters asked for.
        parameters: usize,
    },
}

/// The parameters asked for.
pub(super) fn asked(robot: &Robot, centres: usize, options: &Options) -> Vec<ParamId> {
    let mut ids = match &options.estimate {
        Some(list) => list.clone(),
        None => parameter::all(&robot.parallel_joints(), centres),
    };
    ids.retain(|id| !options.hold.contains(id));
    ids.sort();
    ids
}

/// Estimates what the options ask for, from the nominal robot and a rough set-up.
pub(super) fn estimate(
    robot: &Robot,
    start: &LengthModel,
    lengths: &Lengths,
    options: &Options,
) -> Result<Estimate, IdentifyError> {
    let readings = &lengths.readings;
    let asked = asked(robot, start.centres.len(), options);
    let set_up = fit::set_up(readings, &lengths.given, &asked, start);
    let analysis = analyse(&set_up.model, readings, &asked).ok_or(IdentifyError::NotFinite)?;
    let base = analysis.kept();
    if base.is_empty() {
        return Err(IdentifyError::NothingToEstimate);
    }
    let follow_list = options.estimate.is_some() && options.prior == Prior::None;
    if readings.len() < base.len() && options.prior == Prior::None && follow_list {
        return Err(IdentifyError::TooFewLengths { lengths: readings.len(), parameters: base.len() });
    }
    let mut sigma = first_sigma(lengths, &set_up, &base);
    let mut kept = base.clone();
    let mut weak = Vec::new();
    let mut start = set_up.model.clone();
    let mut iterations = set_up.iterations;
    let mut rounds = 0;
    loop {
        if !follow_list && options.prior == Prior::None {
            weak = too_weak(robot, &set_up.model, readings, &base, &sigma);
            kept = base.iter().copied().filter(|id| !weak.contains(id)).collect();
        }
        let prior = prior::rows(robot, &options.prior, &analysis, &kept, &set_up.model);
        // A parameter held now may have moved in the round before.
        for id in base.iter().filter(|id| !kept.contains(id)) {
            start.shift(*id, set_up.model.value(*id) - start.value(*id));
        }
        let fit = fit::all(readings, &sigma, &kept, prior.as_ref(), &start);
        iterations += fit.iterations;
        let shown = shown_sigma(lengths, &fit, kept.len());
        let settled = shown.iter().zip(&sigma).all(|(new, old)| (new / old - 1.0).abs() < 0.02);
        rounds += 1;
        if settled || rounds == 6 || (lengths.vouched && rounds == 1) {
            let fit = Fit { iterations, ..fit };
            return Ok(Estimate { before: set_up.model, analysis, kept, weak, prior, fit, sigma: shown });
        }
        sigma = shown;
        start = fit.model;
    }
}

/// Before the fit: what a linear fit of the base set leaves, or what is given.
fn first_sigma(lengths: &Lengths, set_up: &Fit, base: &[ParamId]) -> Vec<f64> {
    if lengths.vouched {
        return lengths.given.clone();
    }
    let selection = Selection::new(base);
    let mut triangle = Triangle::new(base.len());
    let mut row = vec![0.0; base.len()];
    let mut count = 0;
    for (at, reading) in lengths.readings.iter().enumerate().filter(|(at, _)| set_up.used[*at]) {
        let predicted = set_up.model.row(reading);
        selection.pick(&predicted, reading.centre, &mut row);
        row.iter_mut().for_each(|value| *value /= lengths.given[at]);
        triangle.push(&row, (reading.length - predicted.length) / lengths.given[at]);
        count += 1;
    }
    let freedom = count as f64 - base.len() as f64;
    let excess = if freedom > 0.0 { (triangle.residual_sum() / freedom).sqrt() } else { 1.0 };
    let factor = if lengths.known { excess.max(1.0) } else { excess.max(FLOOR_MM) };
    lengths.given.iter().map(|sigma| sigma * factor).collect()
}

/// Lengths are not better than this, mm: it keeps exact data from a division by zero.
const FLOOR_MM: f64 = 1e-9;

/// After the fit: what is given, brought to what the residuals show. Where nothing is known, one
/// sigma for all; where the residuals are larger than the given sigmas, a common further
/// deviation (repeatability, what the model lacks) is added in squares (Paule and Mandel, J. Res.
/// NBS 87, 1982).
fn shown_sigma(lengths: &Lengths, fit: &Fit, parameters: usize) -> Vec<f64> {
    if lengths.vouched {
        return lengths.given.clone();
    }
    let used = || (0..lengths.readings.len()).filter(|&at| fit.used[at]);
    let squares: Vec<(f64, f64)> = used()
        .map(|at| {
            let residual = lengths.readings[at].length - fit.model.length(&lengths.readings[at]);
            (residual * residual, lengths.given[at] * lengths.given[at])
        })
        .collect();
    let freedom = squares.len() as f64 - parameters as f64;
    if freedom <= 0.0 {
        return lengths.given.clone();
    }
    if !lengths.known {
        let sum: f64 = squares.iter().map(|(r2, _)| r2).sum();
        return vec![(sum / freedom).sqrt().max(FLOOR_MM); lengths.given.len()];
    }
    let chi = |common: f64| squares.iter().map(|(r2, s2)| r2 / (s2 + common)).sum::<f64>();
    if chi(0.0) <= freedom {
        return lengths.given.clone();
    }
    let (mut low, mut high) = (0.0, squares.iter().map(|(r2, _)| r2).sum::<f64>());
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if chi(middle) > freedom { low = middle } else { high = middle }
    }
    lengths.given.iter().map(|sigma| (sigma * sigma + high).sqrt()).collect()
}
