//! What is known of robot, set-up and bar: a model and its covariance, and what lengths add to it.
//!
//! The covariance is kept as a root, C = root root'. In the coordinates w of x = x0 + root w what is known is a unit
//! normal; lengths whose whitened rows have the factor R add the rows R root to it: with Q S = [I; R root] the new root
//! is root S^-1. No matrix is squared, so mm and rad, and what is known well beside what is not known at all, do not
//! disturb each other.
//!
//! Behind the parameters come the coefficients of the joints' errors, where the covariance has them.

use nalgebra::{DMatrix, DVector};

use super::linear_system::LinearSystem;
use super::pose_rows::LengthNoise;
use super::priors::Priors;
use crate::measurement::{LengthModel, PreparedMeasurement, Selection};
use crate::robot::{
    AXES, Approach, BallId, BarId, Coordinate, Datum, ParamId, Robot, RobotPosterior, RobotUncertainty,
    parameter,
};

/// Gauss-Newton steps of [`Posterior::learn`]: the model is near the truth, so they settle at once.
const STEPS: usize = 6;

/// A model with the covariance of its parameters.
#[derive(Clone, Debug)]
pub struct Posterior {
    /// The likeliest model.
    pub model: LengthModel,
    ids: Vec<ParamId>,
    selection: Selection,
    root: DMatrix<f64>,
}

/// What lengths lead to.
pub(super) struct Learnt {
    pub(super) found: Posterior,
    /// Its place in the coordinates of the root before: x = x0 + root w.
    pub(super) w: DVector<f64>,
}

impl Posterior {
    /// Of independent parameters with standard deviations `sd` (mm, rad), about `model`.
    pub fn new(model: LengthModel, ids: &[ParamId], sd: &[f64]) -> Self {
        Self::with_root(model, ids, DMatrix::from_diagonal(&DVector::from_column_slice(sd)))
    }

    /// Of the parameters `ids`, and the coefficients of the joints' errors in the further rows, with the covariance root
    /// root'.
    pub(super) fn with_root(model: LengthModel, ids: &[ParamId], root: DMatrix<f64>) -> Self {
        Self { model, ids: ids.to_vec(), selection: Selection::new(ids), root }
    }

    /// Of what an identification left unknown of a robot, about `model`: with the coefficients of the joints' errors where its
    /// file has their covariance.
    pub fn of_robot(model: LengthModel, known: &RobotPosterior, unknown: Option<&RobotUncertainty>) -> Self {
        Self::of_known(model, known, known.ids(), unknown)
    }

    /// The same with the base balls of `model` where the identification had them.
    pub fn of_robot_with_balls(
        model: LengthModel,
        known: &RobotPosterior,
        unknown: Option<&RobotUncertainty>,
    ) -> Self {
        let is_here = |id: &ParamId| match id {
            ParamId::Ball(ball, _) => ball.index() < model.balls.len(),
            _ => true,
        };
        let ids: Vec<ParamId> = known.all_ids().iter().copied().filter(is_here).collect();
        Self::of_known(model, known, &ids, unknown)
    }

    fn of_known(
        model: LengthModel,
        known: &RobotPosterior,
        ids: &[ParamId],
        unknown: Option<&RobotUncertainty>,
    ) -> Self {
        let Some(unknown) = unknown else {
            return Self::with_root(model, ids, known.root_of(ids));
        };
        // Another tool ball than that of the identification is in neither.
        let is_known = |id: &ParamId| !matches!(id, ParamId::Tool(_) | ParamId::Ball(..)) || ids.contains(id);
        let parameters = unknown.parameters.iter().enumerate().filter(|(_, id)| is_known(id));
        let (mut rows, ids): (Vec<usize>, Vec<ParamId>) = parameters.map(|(row, id)| (row, *id)).unzip();
        rows.extend(unknown.parameters.len()..unknown.root.nrows());
        Self::with_root(model, &ids, unknown.root.select_rows(&rows))
    }

    /// Before any length: all parameters of the robot and its set-up.
    pub fn prior(robot: &Robot, model: LengthModel, priors: &Priors) -> Self {
        let ids = parameter::all(&robot.parallel_joints(), model.balls.len());
        let sd: Vec<f64> = ids.iter().map(|id| priors.sd(*id)).collect();
        Self::new(model, &ids, &sd)
    }

    /// The parameters, in the order of the rows of [`Posterior::root`].
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// How many coefficients of the joints' errors there are behind the parameters.
    pub fn coefficients(&self) -> usize {
        self.root.nrows() - self.ids.len()
    }

    /// The root of the covariance: C = root root', mm and rad.
    pub fn root(&self) -> &DMatrix<f64> {
        &self.root
    }

    /// The covariance, in the units of the parameters.
    pub fn covariance(&self) -> DMatrix<f64> {
        &self.root * self.root.transpose()
    }

    /// Standard deviation of a parameter, mm or rad; `None` of one that is not among them.
    pub fn sd(&self, id: ParamId) -> Option<f64> {
        self.ids.iter().position(|other| *other == id).map(|at| self.root.row(at).norm())
    }

    /// The standard deviations in the order of the parameters.
    pub fn sds(&self) -> impl Iterator<Item = f64> {
        self.root.row_iter().map(|row| row.norm())
    }

    /// With the covariance of errors added that these columns carry, a row a row of the root.
    pub(super) fn widened(self, columns: &DMatrix<f64>) -> Self {
        let mut root = DMatrix::zeros(self.root.nrows(), self.root.ncols() + columns.ncols());
        root.columns_mut(0, self.root.ncols()).copy_from(&self.root);
        root.columns_mut(self.root.ncols(), columns.ncols()).copy_from(columns);
        Self { root, ..self }
    }

    /// The derivative of the length from a base ball at `axes` (rad) in the coordinates of the root, mm: its norm is the
    /// length's standard deviation.
    pub fn design_row(&self, axes: &[f64; AXES], ball: BallId) -> DVector<f64> {
        self.root.tr_mul(&self.derivative(axes, ball))
    }

    /// The derivative of the length from a base ball at `axes` (rad) in the order of the root's rows; of no ball, zero.
    pub fn derivative(&self, axes: &[f64; AXES], ball: BallId) -> DVector<f64> {
        let mut picked = DVector::zeros(self.root.nrows());
        if let Some(place) = self.model.balls.get(ball.index()) {
            let geometry = &self.model.geometry;
            let mut row = geometry.length_row(axes, place, 0.0);
            row.datum = Datum::Ball(ball, BarId::FIRST);
            let (own, coefficients) = picked.as_mut_slice().split_at_mut(self.ids.len());
            self.selection.pick(&row, own);
            row.joint_terms(geometry, axes, Approach::default(), coefficients);
        }
        picked
    }

    /// With a base ball touched by the tool ball at `axes` (rad) to `sd_mm`: the ball is then wrong as the robot is wrong
    /// there. No length to this ball may have been measured yet.
    pub fn touched(&self, touched_ball: BallId, axes: &[f64; AXES], sd_mm: f64) -> Self {
        let mut touched = self.clone();
        let ball = self.model.geometry.ball(axes).position;
        for axis in Coordinate::ALL {
            let Some(at) = self.ids.iter().position(|id| *id == ParamId::Ball(touched_ball, axis)) else {
                continue;
            };
            // The derivative of a length from a far point is that of the position along the line to it.
            let mut far = ball;
            far[axis.index()] -= 1.0;
            let row = self.model.geometry.length_row(axes, &far, 0.0);
            let mut there = self.root.row(at) * 0.0;
            for (parameter, id) in self.ids.iter().enumerate() {
                if id.moves_tool_ball() {
                    there += self.root.row(parameter) * row.derivative(*id);
                }
            }
            // Unmeasured, the ball has had this coordinate of the root to itself.
            there[self.root.row(at).iamax_full().1] += sd_mm;
            touched.root.set_row(at, &there);
        }
        touched
    }

    /// After lengths at these poses about the same model. `None` when a number is not finite.
    pub fn after<'a>(
        &self,
        readings: &[PreparedMeasurement],
        noise: impl Into<LengthNoise<'a>>,
    ) -> Option<Self> {
        let mut system = self.system(&self.model, readings, noise.into())?;
        let root = root_after(&self.root, &system.factor())?;
        Some(Self { root, ..self.clone() })
    }

    /// After these lengths: the likeliest model and its covariance. `None` when a number is not finite.
    pub fn learn<'a>(
        &self,
        readings: &[PreparedMeasurement],
        noise: impl Into<LengthNoise<'a>>,
    ) -> Option<Self> {
        self.learnt(readings, noise.into()).map(|learnt| learnt.found)
    }

    /// The same with the coordinates of the root.
    pub(super) fn learnt(&self, readings: &[PreparedMeasurement], noise: LengthNoise<'_>) -> Option<Learnt> {
        let unknowns = self.root.ncols();
        let mut found = self.clone();
        let mut w = DVector::zeros(unknowns);
        for _ in 0..STEPS {
            let mut system = self.system(&found.model, readings, noise)?;
            let rows = system.factor() * &self.root;
            let rhs = system.rhs() + &rows * &w;
            let mut stacked = DMatrix::identity(unknowns + rows.nrows(), unknowns);
            stacked.rows_mut(unknowns, rows.nrows()).copy_from(&rows);
            let mut right = DVector::zeros(stacked.nrows());
            right.rows_mut(unknowns, rows.nrows()).copy_from(&rhs);
            let qr = stacked.qr();
            qr.q_tr_mul(&mut right);
            w = qr.r().solve_upper_triangular(&right.rows(0, unknowns))?;
            found.root =
                &self.root * qr.r().solve_upper_triangular(&DMatrix::identity(unknowns, unknowns))?;
            found.model = self.moved(&(&self.root * &w));
        }
        found.root.iter().chain(w.iter()).all(|x| x.is_finite()).then_some(Learnt { found, w })
    }

    /// The model with its parameters, then the coefficients of the joints' errors, moved by these steps.
    fn moved(&self, steps: &DVector<f64>) -> LengthModel {
        let mut model = self.model.clone();
        self.ids.iter().zip(steps).for_each(|(id, step)| model.shift(*id, *step));
        if self.coefficients() > 0 {
            let errors = &self.model.geometry.joint_errors;
            let further = steps.iter().skip(self.ids.len());
            let coefficients: Vec<f64> =
                errors.coefficients().iter().zip(further).map(|(c, step)| c + step).collect();
            model.geometry.joint_errors = errors.with(coefficients);
        }
        model
    }

    /// `None` where the noise has no inverse.
    pub(super) fn system(
        &self,
        model: &LengthModel,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
    ) -> Option<LinearSystem> {
        if self.coefficients() > 0 {
            return LinearSystem::by_pose(model, readings, noise, &self.ids);
        }
        let sigma = vec![noise.sigma_mm(); readings.len()];
        Some(LinearSystem::at(model, &(readings, sigma.as_slice()), &self.ids))
    }
}

/// The root after lengths whose whitened rows have this factor; `None` when a number is not finite.
pub fn root_after(root: &DMatrix<f64>, factor: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let unknowns = root.ncols();
    let mut stacked = DMatrix::identity(unknowns + factor.nrows(), unknowns);
    stacked.rows_mut(unknowns, factor.nrows()).gemm(1.0, factor, root, 0.0);
    let inverse = stacked.qr().r().solve_upper_triangular(&DMatrix::identity(unknowns, unknowns))?;
    let after = root * inverse;
    after.iter().all(|x| x.is_finite()).then_some(after)
}

/// A root of the inverse Gram matrix of rows, a row an unknown: what they alone leave unknown. `None` when they do not
/// determine all.
pub fn inverse_root(rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Unit columns first: mm and rad differ by orders of magnitude.
    let norms: Vec<f64> = rows.column_iter().map(|column| column.norm()).collect();
    let mut unit = rows.clone();
    unit.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
    let factor = unit.qr().r();
    let rounding = factor.nrows() as f64 * f64::EPSILON;
    if factor.nrows() < factor.ncols() || factor.diagonal().iter().any(|pivot| pivot.abs() <= rounding) {
        return None;
    }
    let mut inverse = factor.try_inverse()?;
    inverse.row_iter_mut().zip(&norms).for_each(|(mut row, norm)| row /= *norm);
    inverse.iter().all(|x| x.is_finite()).then_some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_after_rows_is_that_of_the_normal_equations() {
        let root = DMatrix::from_diagonal(&DVector::from_row_slice(&[10.0, 1e-3]));
        let rows = DMatrix::from_row_slice(3, 2, &[1.0, 800.0, 0.5, -300.0, 0.0, 100.0]);
        let after = root_after(&root, &rows).unwrap();
        let information = (&root * root.transpose()).try_inverse().unwrap() + rows.tr_mul(&rows);
        let expected = information.try_inverse().unwrap();
        assert!((&after * after.transpose() - &expected).norm() < 1e-9 * expected.norm());
    }

    #[test]
    fn what_rows_do_not_determine_has_no_inverse() {
        assert!(inverse_root(&DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 4.0])).is_none());
        let inverse = inverse_root(&DMatrix::from_row_slice(2, 2, &[2.0, 0.0, 0.0, 1e-6])).unwrap();
        assert!((inverse.row(0).norm() - 0.5).abs() < 1e-15 && (inverse.row(1).norm() - 1e6).abs() < 1e-6);
    }
}
