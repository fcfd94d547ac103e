//! Whether the lengths of a table are shifted by some rows against their poses. On smooth circles wrong parameters compensate
//! much of such a shift, so that the residuals alone do not reveal it.

use super::lengths::{Lengths, SAMPLE, Sigma};
use super::linear_system::linear_system;
use super::solver::{Loss, Problem, minimise, robust_scale};
use crate::estimation::EstimationFinding;
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::ParamId;

/// A positive shift assigns the length of a later row to each pose.
const SHIFTS: [isize; 4] = [-1, 1, -2, 2];
/// Natural logarithm of the likelihood ratio that is required,
const DECISIVE: f64 = 20.0;
/// and the required ratio of the residuals: with very many lengths a tiny improvement reaches the likelihood ratio.
const SMALLER: f64 = 1.5;
/// Residuals are truncated at this number of robust standard deviations.
const CAP: f64 = 3.0;
/// Degrees of freedom below which nothing is decided.
const MIN_FREEDOM: f64 = 10.0;

/// Fits the geometry alone, without a prior, to shifted lengths: errors of the joints would compensate more of a shift.
pub(super) struct ShiftedRowSearch<'a> {
    /// The start of each fit.
    pub(super) start: &'a LengthModel,
    /// The parameters that the lengths alone determine.
    pub(super) base: &'a [ParamId],
    pub(super) sigma: Sigma,
}

impl ShiftedRowSearch<'_> {
    /// The shift with which the lengths fit decisively better than unshifted.
    pub(super) fn shift_of(&self, lengths: &Lengths) -> Option<EstimationFinding> {
        let own = self.shifted(lengths, 0);
        if self.freedom(&own) < MIN_FREEDOM {
            return None;
        }
        let model = self.fitted(&own);
        let residual_mm = self.size_mm(&own, &model);
        let whitened = residuals(&own, &model).enumerate().map(|(at, residual)| residual / own.given(at));
        let squares: f64 = whitened.map(|residual| residual.powi(2)).sum();
        let better = SHIFTS.iter().filter_map(|&rows| {
            let other = self.shifted(lengths, rows);
            let weighted = other.weighted(Sigma::Given, &[]);
            // One linearised step is cheap and rules out almost every shift.
            if linear_system(self.start, &weighted, self.base).residual_sum() >= squares {
                return None;
            }
            let shifted_mm = self.size_mm(&other, &self.fitted(&other));
            let gain = decisive(self.freedom(&other), [residual_mm, shifted_mm], SMALLER)?;
            Some((gain, EstimationFinding::ShiftedRows { rows, residual_mm, shifted_mm, gain }))
        });
        better.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, finding)| finding)
    }

    fn fitted(&self, lengths: &Lengths) -> LengthModel {
        let weighted = lengths.weighted(Sigma::Given, &[]);
        let problem = Problem { lengths: weighted, ids: self.base, loss: Loss::Huber, prior: None };
        minimise(&problem, self.start).model
    }

    /// The poses with the lengths `rows` further; the first ones of very many. Poses without a length are dropped.
    fn shifted(&self, lengths: &Lengths, rows: isize) -> Lengths<'static> {
        let count = lengths.len().min(2 * SAMPLE);
        let other = |at: usize| {
            let datum = lengths.reading(at).datum;
            let rows = if datum.is_plane() { 3 * rows } else { rows };
            let other = at.checked_add_signed(rows).filter(|other| *other < count)?;
            (lengths.reading(other).datum.is_plane() == datum.is_plane()).then_some(other)
        };
        let pairs = (0..count).filter_map(|at| Some((at, other(at)?)));
        let (readings, sigma) = pairs
            .map(|(at, other)| {
                let length_mm = lengths.reading(other).length_mm;
                let reading = PreparedMeasurement { length_mm, ..lengths.reading(at) };
                (reading, self.sigma.of(lengths.given(at)))
            })
            .unzip();
        Lengths::few(readings, sigma)
    }

    fn freedom(&self, lengths: &Lengths) -> f64 {
        lengths.len() as f64 - self.base.len() as f64
    }

    /// The standard deviation of the truncated residuals, mm.
    fn size_mm(&self, lengths: &Lengths, model: &LengthModel) -> f64 {
        let residuals: Vec<f64> = residuals(lengths, model).collect();
        let most = CAP * robust_scale(&residuals);
        let squares: f64 = residuals.iter().map(|residual| residual.abs().min(most).powi(2)).sum();
        (squares / self.freedom(lengths).max(1.0)).sqrt()
    }
}

/// The natural logarithm of the likelihood ratio by which the standard deviation of the residuals falls from `before` to
/// `after`, if it is decisive and they fall by the factor `smaller`.
fn decisive(freedom: f64, [before, after]: [f64; 2], smaller: f64) -> Option<f64> {
    let gain = freedom * (before / after).ln();
    (freedom >= MIN_FREEDOM && gain > DECISIVE && before > smaller * after).then_some(gain)
}

fn residuals(lengths: &Lengths, model: &LengthModel) -> impl Iterator<Item = f64> {
    let prepared = model.prepare();
    (0..lengths.len()).map(move |at| prepared.residual(&lengths.reading(at)))
}
