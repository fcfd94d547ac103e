//! Whether a base ball was remounted during the measurement: from one row on, its lengths are to another place.
//!
//! Each row is tried as the first with a second place. The reduction of the sum of squares by three further coordinates follows
//! from their columns, projected orthogonally to the other unknowns. The best row is then fitted.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::estimate::estimate;
use super::lengths::{Lengths, Sigma};
use super::pose_rows::PoseRows;
use super::selection::is_bar;
use super::shifted_rows::{decisive, size_mm};
use super::solver::{Loss, Problem, minimise, robust_scale};
use super::{CompletedCalibration, Input};
use crate::estimation::EstimationFinding;
use crate::measurement::{LengthModel, Measurements};
use crate::robot::{BallId, Coordinate, Datum, ParamId};

/// The required ratio of the residuals without and with it.
const SMALLER: f64 = 1.25;
/// Residuals are truncated at so many robust standard deviations.
const FAR: f64 = 10.0;
/// Fewer lengths before or after the row do not determine a place.
const FEWEST: usize = 8;

/// Measurements and start of a fit, corrected for something that changed during the measurement.
#[derive(Clone)]
pub struct ChangedSetUp {
    pub observations: Measurements,
    pub start: LengthModel,
}

impl ChangedSetUp {
    /// The input of a calibration with this set-up.
    pub fn instead_of<'a>(&'a self, input: &Input<'a>) -> Input<'a> {
        Input { observations: &self.observations, start: &self.start, ..*input }
    }
}

/// A set-up in which the later lengths to a ball belong to a ball of their own.
pub struct Remounted {
    pub set_up: ChangedSetUp,
    ball: BallId,
    /// Of the first of these lengths.
    index: u32,
}

impl Remounted {
    /// The finding if this set-up explains all lengths decisively better: `without` is the result of `input`, `with` the result
    /// of this set-up.
    pub fn finding(
        &self,
        input: &Input<'_>,
        without: &CompletedCalibration,
        with: &CompletedCalibration,
    ) -> Option<EstimationFinding> {
        let residuals = |result: &CompletedCalibration, set: &Measurements| -> Vec<f64> {
            result.residuals(&set.rows).map(|pair| pair.after).collect()
        };
        let after = residuals(with, &self.set_up.observations);
        // Outliers of either result count, but truncated, so that a single one does not decide.
        let most = FAR * robust_scale(&after);
        let size = |residuals: Vec<f64>| {
            let squares: f64 = residuals.iter().map(|residual| residual.abs().min(most).powi(2)).sum();
            (squares / residuals.len() as f64).sqrt()
        };
        let [residual_mm, apart_mm] = [residuals(without, input.observations), after].map(size);
        let freedom = with.result.measurements as f64 - with.posterior.ids().len() as f64;
        let gain = decisive(freedom, [residual_mm, apart_mm], SMALLER)?;
        let balls = &with.posterior.model.balls;
        let moved_mm = (balls.last()? - balls.get(self.ball.index())?).norm();
        let (ball, new, index) = (self.ball.number(), BallId::at(balls.len() - 1).number(), self.index);
        Some(EstimationFinding::Remounted { ball, index, new, moved_mm, residual_mm, apart_mm, gain })
    }
}

/// The first row with a second place of a ball.
struct Step {
    ball: BallId,
    first: usize,
    /// Reduction of the sum of squares, mm^2.
    gain: f64,
}

/// The set-up with the most probable remounting, with a fit of the geometry alone.
pub fn remounted(input: &Input<'_>) -> Option<Remounted> {
    let lengths = Lengths::of(&input.observations.rows, input.options, input.robot);
    // With a list of parameters the user has decided what the lengths determine.
    if lengths.are_many() || input.options.estimate.is_some() {
        return None;
    }
    let setting = input.setting().bound();
    let estimate = estimate(&setting, &lengths, &setting.asked()).ok()?;
    // With a free bar offset a robot of any size would fit.
    let own: Vec<ParamId> = estimate.base.iter().copied().filter(|id| !is_bar(id)).collect();
    let whole = fitted(&lengths, &own, &estimate.fit.model);
    let step = strongest(&whole, &own, &lengths)?;
    let new = BallId::at(whole.balls.len());
    let mut observations = input.observations.clone();
    let of_ball = |datum: Datum| datum.ball() == Some(step.ball);
    for row in observations.rows.iter_mut().skip(step.first).filter(|row| of_ball(row.datum)) {
        row.datum = row.datum.bar().map_or(row.datum, |bar| Datum::Ball(new, bar));
    }
    let relabelled = Lengths::of(&observations.rows, input.options, input.robot);
    let mut apart = whole.clone();
    apart.balls.push(whole.balls[step.ball.index()]);
    let ids = [own.as_slice(), &Coordinate::ALL.map(|axis| ParamId::Ball(new, axis))].concat();
    apart = fitted(&relabelled, &ids, &apart);
    let [before, after] = [(&lengths, &whole), (&relabelled, &apart)]
        .map(|(lengths, model)| size_mm(lengths, model, &estimate));
    decisive(lengths.len() as f64 - ids.len() as f64, [before, after], SMALLER)?;
    let mut start = input.start.clone();
    start.balls.push(apart.balls[new.index()]);
    let index = observations.rows[step.first].index;
    Some(Remounted { set_up: ChangedSetUp { observations, start }, index, ball: step.ball })
}

fn fitted(lengths: &Lengths, ids: &[ParamId], start: &LengthModel) -> LengthModel {
    let mut ids = ids.to_vec();
    ids.sort();
    let lengths = lengths.weighted(Sigma::Given, &[]);
    minimise(&Problem { lengths, ids: &ids, loss: Loss::Huber, prior: None }, start).model
}

/// The step that reduces the sum of squares of a fit of `ids` most.
fn strongest(model: &LengthModel, ids: &[ParamId], lengths: &Lengths) -> Option<Step> {
    let rows = PoseRows::at(model, &lengths.weighted(Sigma::All(1.0), &[]), ids);
    let own = rows.values.columns(0, ids.len()).into_owned();
    let explained = own.clone().qr().q();
    let left = &rows.residual - &explained * explained.tr_mul(&rows.residual);
    let steps = (0..model.balls.len()).flat_map(|ball| {
        let ball = BallId::at(ball);
        let of_ball = Coordinate::ALL.map(|axis| ids.iter().position(|id| *id == ParamId::Ball(ball, axis)));
        // An error of a ball that the user fixed is in the residuals.
        let [Some(x), Some(y), Some(z)] = of_ball else { return Vec::new() };
        let place = own.select_columns(&[x, y, z]);
        let is_of = |at: &usize| lengths.reading(*at).datum.ball() == Some(ball);
        let places: Vec<usize> = (0..lengths.len()).filter(is_of).collect();
        let inner = places.len().checked_sub(FEWEST).and_then(|last| places.get(FEWEST..last));
        let step = |&first: &usize| {
            let mut further = place.clone();
            further.rows_mut(0, first).fill(0.0);
            Some(Step { ball, first, gain: reduction(further, &explained, &left)? })
        };
        inner.unwrap_or_default().iter().filter_map(step).collect()
    });
    steps.max_by(|a, b| a.gain.total_cmp(&b.gain))
}

/// The reduction of the squares of the residuals `left` by further columns, mm^2.
fn reduction(further: DMatrix<f64>, explained: &DMatrix<f64>, left: &DVector<f64>) -> Option<f64> {
    let apart = &further - explained * explained.tr_mul(&further);
    let right = apart.tr_mul(left);
    let factor = Cholesky::new(apart.tr_mul(&apart))?;
    Some(right.dot(&factor.solve(&right)))
}
