//! The posterior of robot, set-up and bar: a model with the covariance of its parameters, and its update by lengths.
//!
//! The covariance is stored as a root, C = root root'. In the coordinates w of x = x0 + root w the prior is a unit normal.
//! Lengths whose whitened rows have the factor R add the rows R root to it: with Q S = [I; R root] the new root is root S^-1.
//! No matrix is squared, so that parameters of very different size and uncertainty do not lose digits.
//!
//! The coefficients of the joint errors follow the parameters, if the covariance has them.

use nalgebra::{DMatrix, DVector, Vector3};

use super::linear_system::linear_system;
use super::pose_rows::{LengthNoise, linear_system_by_pose};
use super::position::RemainingErrors;
use super::priors::{FREE_BALL_MM, Priors};
use super::workspace::Workspace;
use crate::math::{Triangle, stacked};
use crate::measurement::{ColumnSelection, LengthModel, PreparedMeasurement};
use crate::robot::{
    AXES, Approach, BallId, BarId, Coordinate, Datum, JointErrors, ParamId, ParamOwner, Robot,
    RobotPosterior, RobotUncertainty, parameter,
};

/// Gauss-Newton steps of [`Posterior::learn`]. The model is near the truth, so they converge at once.
const STEPS: usize = 6;

/// A model with the covariance of its parameters.
#[derive(Clone, Debug)]
pub struct Posterior {
    /// The most probable model.
    pub model: LengthModel,
    ids: Vec<ParamId>,
    selection: ColumnSelection,
    root: DMatrix<f64>,
    /// The root as a product, where it has few factors.
    factors: Option<RootFactors>,
    /// What the root does not have: the repeatability of a pose, and errors of the joints that no length showed.
    of_pose: Option<RemainingErrors>,
}

/// The root of independent unknowns that a few measurements were added to: diag(sds) times I - weight row row' for each of them.
/// A plan asks for the standard deviation of millions of lengths: this product with a vector is quicker than that of the root.
#[derive(Clone, Debug)]
struct RootFactors {
    sds: DVector<f64>,
    updates: Vec<RootUpdate>,
}

/// Multiplies a root by I - weight row row'.
#[derive(Clone, Debug)]
struct RootUpdate {
    row: DVector<f64>,
    weight: f64,
}

impl RootFactors {
    /// The factors of a root that is diagonal; `None` for any other.
    fn of_diagonal(root: &DMatrix<f64>) -> Option<Self> {
        if !root.is_square() {
            return None;
        }
        let sds = root.diagonal();
        (DMatrix::from_diagonal(&sds) == *root).then_some(Self { sds, updates: Vec::new() })
    }

    /// The product of the transposed root with a vector.
    fn tr_mul(&self, vector: &DVector<f64>) -> DVector<f64> {
        let mut product = self.sds.component_mul(vector);
        for RootUpdate { row, weight } in &self.updates {
            let along = weight * row.dot(&product);
            product.axpy(-along, row, 1.0);
        }
        product
    }
}

/// A posterior after lengths.
pub(crate) struct Learnt {
    pub(crate) posterior: Posterior,
    /// The model of the posterior in the coordinates of the prior's root: x = x0 + root w.
    pub(crate) w: DVector<f64>,
}

impl Posterior {
    /// Independent parameters with standard deviations `sd` (mm, rad), about `model`.
    pub fn new(model: LengthModel, ids: &[ParamId], sd: &[f64]) -> Self {
        Self::with_root(model, ids, DMatrix::from_diagonal(&DVector::from_column_slice(sd)))
    }

    /// `root` has a row for each of `ids`, then for each coefficient of the joint errors.
    pub(crate) fn with_root(model: LengthModel, ids: &[ParamId], root: DMatrix<f64>) -> Self {
        let factors = RootFactors::of_diagonal(&root);
        Self { model, ids: ids.to_vec(), selection: ColumnSelection::new(ids), root, factors, of_pose: None }
    }

    /// The posterior with the errors of a single pose that an uncertainty has beside its root.
    pub(super) fn with_errors_of_pose(self, unknown: &RobotUncertainty) -> Self {
        let of_pose = Some(RemainingErrors::new(&self.model.geometry, unknown));
        Self { of_pose, ..self }
    }

    /// The posterior with the errors of a single pose that another one has.
    pub(crate) fn with_errors_of_pose_of(self, other: &Self) -> Self {
        Self { of_pose: other.of_pose.clone(), ..self }
    }

    /// The posterior with these further parameters, independent of all others, with standard deviations in mm or rad; those
    /// that it has stay.
    pub fn with_parameters(&self, further: &[(ParamId, f64)]) -> Self {
        let further: Vec<_> = further.iter().filter(|(id, _)| !self.ids.contains(id)).collect();
        let (own, columns) = (self.ids.len(), self.root.ncols());
        let mut root = self.root.clone().insert_rows(own, further.len(), 0.0);
        root.resize_horizontally_mut(columns + further.len(), 0.0);
        for (at, (_, sd)) in further.iter().enumerate() {
            root[(own + at, columns + at)] = *sd;
        }
        let ids: Vec<ParamId> = self.ids.iter().copied().chain(further.iter().map(|(id, _)| *id)).collect();
        Self::with_root(self.model.clone(), &ids, root).with_errors_of_pose_of(self)
    }

    /// The posterior with errors of the joints in place of those of its model, independent of all parameters, with the standard
    /// deviations of their coefficients.
    pub(super) fn with_joint_errors(&self, errors: JointErrors, sds: &[f64]) -> Self {
        let (own, columns) = (self.ids.len(), self.root.ncols());
        let mut root = self.root.rows(0, own).into_owned().resize(own + sds.len(), columns + sds.len(), 0.0);
        sds.iter().enumerate().for_each(|(at, sd)| root[(own + at, columns + at)] = *sd);
        let mut model = self.model.clone();
        model.geometry.joint_errors = errors;
        Self::with_root(model, &self.ids, root)
    }

    /// The posterior of an identification about `model`, with the coefficients of the joint errors if their covariance is
    /// known.
    pub fn of_robot(model: LengthModel, known: &RobotPosterior, unknown: Option<&RobotUncertainty>) -> Self {
        Self::of_known(model, known, known.ids(), unknown)
    }

    /// As [`Self::of_robot`], with the base balls of `model` that the identification had.
    pub fn of_robot_with_balls(
        model: LengthModel,
        known: &RobotPosterior,
        unknown: Option<&RobotUncertainty>,
    ) -> Self {
        let is_here =
            |id: &ParamId| !matches!(id.owner(), ParamOwner::Ball(ball) if ball.index() >= model.balls.len());
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
        // A tool ball or base ball that is not in `known` is not the one of the identification.
        let is_known = |id: &ParamId| !matches!(id, ParamId::Tool(_) | ParamId::Ball(..)) || ids.contains(id);
        let parameters = unknown.parameters.iter().enumerate().filter(|(_, id)| is_known(id));
        let (mut rows, ids): (Vec<usize>, Vec<ParamId>) = parameters.map(|(row, id)| (row, *id)).unzip();
        rows.extend(unknown.parameters.len()..unknown.root.nrows());
        Self::with_root(model, &ids, unknown.root.select_rows(&rows)).with_errors_of_pose(unknown)
    }

    /// All parameters of the robot and its set-up before any length.
    pub fn prior(robot: &Robot, model: LengthModel, priors: &Priors) -> Self {
        let all = Self::parameters_of_prior(robot, model.balls.len(), priors);
        Self::with_root(model, &[], DMatrix::zeros(0, 0)).with_parameters(&all)
    }

    /// The parameters of the robot and a set-up with base balls, with their standard deviations before any length, mm or rad.
    pub fn parameters_of_prior(robot: &Robot, balls: usize, priors: &Priors) -> Vec<(ParamId, f64)> {
        let sd = |id: ParamId| priors.bound(id).unwrap_or_else(|| priors.sd(id));
        parameter::all_parameters(&robot.parallel_joints(), balls)
            .into_iter()
            .map(|id| (id, sd(id)))
            .collect()
    }

    /// The parameters, in the order of the rows of [`Posterior::root`].
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// The number of coefficients of the joint errors.
    pub fn coefficients(&self) -> usize {
        self.root.nrows() - self.ids.len()
    }

    /// The root of the covariance: C = root root', mm and rad.
    pub fn root(&self) -> &DMatrix<f64> {
        &self.root
    }

    /// The covariance of the parameters, a row and a column each, mm and rad.
    pub fn covariance(&self) -> DMatrix<f64> {
        let own = self.root.rows(0, self.ids.len());
        own * own.transpose()
    }

    /// Standard deviation of a parameter, mm or rad; `None` if it is not among [`Self::ids`].
    pub fn sd(&self, id: ParamId) -> Option<f64> {
        self.ids.iter().position(|other| *other == id).map(|at| self.root.row(at).norm())
    }

    /// The standard deviations in the order of the parameters.
    pub fn sds(&self) -> impl Iterator<Item = f64> {
        self.root.row_iter().map(|row| row.norm())
    }

    /// The derivatives of the tool ball at `poses` (axis angles, rad) by the rows of the root.
    pub fn workspace(&self, poses: &[[f64; AXES]]) -> Workspace {
        let (geometry, ids) = (&self.model.geometry, self.ids());
        if self.coefficients() > 0 {
            Workspace::with_joint_errors(geometry, poses, ids)
        } else {
            Workspace::new(geometry, poses, ids)
        }
    }

    /// The posterior for an exactly known point in the flange frame, mm, in place of the tool ball.
    #[must_use]
    pub fn with_exact_tool(&self, tool_mm: &Vector3<f64>) -> Self {
        let mut known = self.clone();
        known.model.geometry.tool = *tool_mm;
        known.factors = None;
        for (row, id) in known.ids.iter().enumerate() {
            if matches!(id, ParamId::Tool(_)) {
                known.root.row_mut(row).fill(0.0);
            }
        }
        known
    }

    /// The posterior with the covariance `columns columns'` added.
    pub(crate) fn widened(self, columns: &DMatrix<f64>) -> Self {
        let own = self.root.ncols();
        let mut root = self.root.resize_horizontally(own + columns.ncols(), 0.0);
        root.columns_mut(own, columns.ncols()).copy_from(columns);
        Self { root, factors: None, ..self }
    }

    /// The derivative of the length from a base ball at `axes` (rad) in the coordinates of the root, mm: its norm is the
    /// length's standard deviation.
    pub fn design_row(&self, axes: &[f64; AXES], ball: BallId) -> DVector<f64> {
        self.in_coordinates(&self.derivative(axes, ball))
    }

    /// A derivative by the rows of the root in the coordinates of the root.
    fn in_coordinates(&self, derivative: &DVector<f64>) -> DVector<f64> {
        match &self.factors {
            Some(factors) => factors.tr_mul(derivative),
            None => self.root.tr_mul(derivative),
        }
    }

    /// The derivative of the length from a base ball at `axes` (rad) by the rows of the root; zero for an unknown ball.
    pub fn derivative(&self, axes: &[f64; AXES], ball: BallId) -> DVector<f64> {
        match self.model.balls.get(ball.index()) {
            Some(place) => self.derivative_from(axes, place, Some(Datum::Ball(ball, BarId::FIRST))),
            None => DVector::zeros(self.root.nrows()),
        }
    }

    /// The derivative of the distance of the tool ball from a place, of a datum if it has one.
    fn derivative_from(
        &self,
        axes: &[f64; AXES],
        place: &Vector3<f64>,
        datum: Option<Datum>,
    ) -> DVector<f64> {
        let mut picked = DVector::zeros(self.root.nrows());
        let geometry = &self.model.geometry;
        let mut row = geometry.length_row(axes, place, 0.0);
        row.datum = datum.unwrap_or(row.datum);
        let (own, coefficients) = picked.as_mut_slice().split_at_mut(self.ids.len());
        self.selection.pick(&row, own);
        row.joint_terms(geometry, axes, Approach::default(), coefficients);
        picked
    }

    /// Standard deviation of a length from a base ball at `axes` (rad) by the errors that this pose has alone, mm.
    pub fn own_sd_mm(&self, axes: &[f64; AXES], ball: BallId) -> f64 {
        let (Some(of_pose), Some(place)) = (&self.of_pose, self.model.balls.get(ball.index())) else {
            return 0.0;
        };
        let geometry = &self.model.geometry;
        let row = geometry.length_row(axes, place, 0.0);
        let sds = of_pose.sds(geometry, axes, Approach::default());
        let squares = row.by_joint().iter().zip(sds).map(|(by, sd)| (by * sd).powi(2));
        squares.sum::<f64>().sqrt().hypot(of_pose.pose_mm())
    }

    /// The posterior after the tool ball touched a base ball at `axes` (rad), with the standard deviation `sd_mm` of each
    /// coordinate: their positions are the same there, so that the error of the base ball is correlated with that of the robot
    /// at this pose.
    ///
    /// Each coordinate is one measurement of the difference, by which mean and root are updated (J. Potter's square-root
    /// update, in G. Bierman, "Factorization Methods for Discrete Sequential Estimation", 1977, chapter II.3): with the row a of
    /// the difference in the coordinates of the root and s = a'a + sd^2, the mean moves by root a / s times the measured minus
    /// the expected difference, and root becomes root (I - a a' / (s + sd s^1/2)).
    pub fn touched(&self, touched_ball: BallId, axes: &[f64; AXES], sd_mm: f64) -> Self {
        let mut touched = self.clone();
        for axis in Coordinate::ALL {
            let Some(at) = self.ids.iter().position(|id| *id == ParamId::Ball(touched_ball, axis)) else {
                continue;
            };
            let Some(place) = touched.model.balls.get(touched_ball.index()) else { continue };
            let ball = touched.model.geometry.ball(axes).position;
            let apart_mm = ball[axis.index()] - place[axis.index()];
            // The derivative of the length from a point along an axis is that of the coordinate.
            let mut far = ball;
            far[axis.index()] -= 1.0;
            let mut derivative = touched.derivative_from(axes, &far, None);
            for (own, id) in derivative.iter_mut().zip(&self.ids) {
                if !id.moves_tool_ball() {
                    *own = 0.0;
                }
            }
            derivative[at] = -1.0;
            let row = touched.in_coordinates(&derivative);
            let variance = row.norm_squared() + sd_mm * sd_mm;
            let gain = &touched.root * &row;
            touched.model = touched.moved(&(&gain * (-apart_mm / variance)));
            let weight = (variance + sd_mm * variance.sqrt()).recip();
            touched.root.ger(-weight, &gain, &row, 1.0);
            if let Some(factors) = &mut touched.factors {
                factors.updates.push(RootUpdate { row, weight });
            }
        }
        touched
    }

    /// The posterior with a further base ball, whose position is free.
    pub fn with_ball(&self, ball: Vector3<f64>) -> Self {
        let mut further = self.clone();
        further.model.balls.push(ball);
        let new = BallId::at(self.model.balls.len());
        further.with_parameters(&Coordinate::ALL.map(|axis| (ParamId::Ball(new, axis), FREE_BALL_MM)))
    }

    /// The posterior after lengths at these poses that agree with the model. `None` if a number is not finite.
    pub fn after<'a>(
        &self,
        readings: &[PreparedMeasurement],
        noise: impl Into<LengthNoise<'a>>,
    ) -> Option<Self> {
        let mut system = self.system(&self.model, readings, noise.into())?;
        let root = root_after(&self.root, &system.factor())?;
        Some(Self { root, factors: None, ..self.clone() })
    }

    /// The posterior after these lengths. `None` if a number is not finite.
    pub fn learn<'a>(
        &self,
        readings: &[PreparedMeasurement],
        noise: impl Into<LengthNoise<'a>>,
    ) -> Option<Self> {
        self.learnt(readings, noise.into()).map(|learnt| learnt.posterior)
    }

    /// As [`Self::learn`], and also returns the coordinates w.
    pub(crate) fn learnt(&self, readings: &[PreparedMeasurement], noise: LengthNoise<'_>) -> Option<Learnt> {
        let unknowns = self.root.ncols();
        let identity = DMatrix::identity(unknowns, unknowns);
        let mut posterior = Self { factors: None, ..self.clone() };
        let mut w = DVector::zeros(unknowns);
        for _ in 0..STEPS {
            let mut system = self.system(&posterior.model, readings, noise)?;
            let rows = system.factor() * &self.root;
            let rhs = system.rhs() + &rows * &w;
            let qr = stacked(&identity, &rows).qr();
            let mut right = DVector::zeros(unknowns + rows.nrows());
            right.rows_mut(unknowns, rows.nrows()).copy_from(&rhs);
            qr.q_tr_mul(&mut right);
            w = qr.r().solve_upper_triangular(&right.rows(0, unknowns))?;
            posterior.root = &self.root * qr.r().solve_upper_triangular(&identity)?;
            posterior.model = self.moved(&(&self.root * &w));
        }
        posterior.root.iter().chain(w.iter()).all(|x| x.is_finite()).then_some(Learnt { posterior, w })
    }

    /// A model drawn from the posterior; `normal` gives standard normal numbers.
    pub fn drawn(&self, mut normal: impl FnMut() -> f64) -> LengthModel {
        let numbers = DVector::from_fn(self.root.ncols(), |_, _| normal());
        self.moved(&(&self.root * numbers))
    }

    /// The model with steps of the parameters, then of the coefficients of the joint errors.
    fn moved(&self, steps: &DVector<f64>) -> LengthModel {
        let mut model = self.model.shifted(&self.ids, steps);
        if self.coefficients() > 0 {
            let errors = &self.model.geometry.joint_errors;
            let further = steps.iter().skip(self.ids.len());
            let coefficients: Vec<f64> =
                errors.coefficients().iter().zip(further).map(|(c, step)| c + step).collect();
            model.geometry.joint_errors = errors.with(coefficients);
        }
        model
    }

    /// The linearised problem of the lengths. `None` if the covariance of the noise is singular.
    pub(crate) fn system(
        &self,
        model: &LengthModel,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
    ) -> Option<Triangle> {
        if self.coefficients() > 0 || noise.pose_mm > 0.0 {
            return linear_system_by_pose(model, readings, noise, &self.ids);
        }
        let sigma = vec![noise.sigma_mm(); readings.len()];
        Some(linear_system(model, &(readings, sigma.as_slice()), &self.ids))
    }
}

/// The root of the covariance after lengths whose whitened rows have this factor; `None` if a number is not finite.
pub fn root_after(root: &DMatrix<f64>, factor: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let identity = DMatrix::identity(root.ncols(), root.ncols());
    let after = root * stacked(&identity, &(factor * root)).qr().r().solve_upper_triangular(&identity)?;
    after.iter().all(|x| x.is_finite()).then_some(after)
}

/// A root of the covariance (A'A)^-1 of least squares with the whitened rows A, a row for each unknown. `None` if A has
/// not full column rank.
pub fn inverse_root(rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Scaled to unit columns, because mm and rad differ by orders of magnitude.
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
    use crate::measurement::BaseBall;
    use crate::robot::Joint;

    #[test]
    fn root_after_rows_agrees_with_the_normal_equations() {
        let root = DMatrix::from_diagonal(&DVector::from_row_slice(&[10.0, 1e-3]));
        let rows = DMatrix::from_row_slice(3, 2, &[1.0, 800.0, 0.5, -300.0, 0.0, 100.0]);
        let after = root_after(&root, &rows).unwrap();
        let information = (&root * root.transpose()).try_inverse().unwrap() + rows.tr_mul(&rows);
        let expected = information.try_inverse().unwrap();
        assert!((&after * after.transpose() - &expected).norm() < 1e-9 * expected.norm());
    }

    #[test]
    fn rank_deficient_rows_have_no_inverse_root() {
        assert!(inverse_root(&DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 4.0])).is_none());
        let inverse = inverse_root(&DMatrix::from_row_slice(2, 2, &[2.0, 0.0, 0.0, 1e-6])).unwrap();
        assert!((inverse.row(0).norm() - 0.5).abs() < 1e-15 && (inverse.row(1).norm() - 1e6).abs() < 1e-6);
    }

    const AXIS_ANGLES: [f64; AXES] = [0.1, -1.2, 1.4, 0.3, 0.8, -0.2];
    const BAR: ParamId = ParamId::BarOffset(BarId::FIRST);

    fn model() -> LengthModel {
        let geometry = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry;
        let ball = BaseBall { id: BallId::FIRST, position: Vector3::new(1300.0, 0.0, 800.0) };
        LengthModel::new(geometry, &[ball])
    }

    /// Four lengths that are `excess_mm` longer than the model predicts.
    fn readings(model: &LengthModel, excess_mm: f64) -> Vec<PreparedMeasurement> {
        let predicted = PreparedMeasurement::new(AXIS_ANGLES, BallId::FIRST, 0.0);
        let length_mm = model.prepare().length(&predicted) + excess_mm;
        vec![PreparedMeasurement { length_mm, ..predicted }; 4]
    }

    /// The bar's offset adds to each length. Its prior information is 1 / 0.05^2 = 400, four lengths of 0.1 mm add 4 / 0.1^2 =
    /// 400: the variance is 1 / 800, and the mean half of the excess (normal distribution with a conjugate prior).
    #[test]
    fn lengths_share_the_excess_with_the_prior_by_their_information() {
        let prior = Posterior::new(model(), &[BAR], &[0.05]);
        let readings = readings(&prior.model, 0.08);
        let sd = prior.after(&readings, 0.1).unwrap().sd(BAR).unwrap();
        assert!((sd - 800f64.recip().sqrt()).abs() < 1e-12, "{sd}");
        let Learnt { posterior, w } = prior.learnt(&readings, 0.1.into()).unwrap();
        assert!((posterior.model.value(BAR) - 0.04).abs() < 1e-12);
        assert!((posterior.sd(BAR).unwrap() - sd).abs() < 1e-12);
        // 0.04 mm are 0.8 prior standard deviations.
        assert!((w[0] - 0.8).abs() < 1e-9);
        assert_eq!(posterior.sd(ParamId::D(Joint::J2)), None);
    }

    /// Rows below those of the parameters are coefficients of the joint errors.
    #[test]
    fn covariance_is_of_the_parameters_alone() {
        let root = DMatrix::from_row_slice(3, 2, &[0.3, 0.0, 0.4, 1.2, 5.0, 6.0]);
        let posterior = Posterior::with_root(model(), &[BAR, ParamId::A(Joint::J2)], root);
        let covariance = posterior.covariance();
        assert_eq!(covariance.shape(), (2, 2));
        assert!((covariance[(0, 1)] - 0.12).abs() < 1e-15 && (covariance[(1, 1)] - 1.6).abs() < 1e-15);
    }

    #[test]
    fn added_covariance_adds_to_the_variance() {
        let posterior = Posterior::new(model(), &[BAR, ParamId::A(Joint::J2)], &[0.3, 1.2]);
        let widened = posterior.widened(&DMatrix::from_row_slice(2, 1, &[0.4, -0.5]));
        let sds: Vec<f64> = widened.sds().collect();
        assert!((sds[0] - 0.5).abs() < 1e-15 && (sds[1] - 1.3).abs() < 1e-15);
        assert!((widened.covariance()[(0, 1)] + 0.2).abs() < 1e-15);
    }

    /// The derivative of a length by the base ball is a unit vector: the same uncertainty of each coordinate is that of the
    /// length.
    #[test]
    fn design_row_is_the_uncertainty_of_the_length() {
        let ids = Coordinate::ALL.map(|axis| ParamId::Ball(BallId::FIRST, axis));
        let posterior = Posterior::new(model(), &ids, &[2.0; 3]);
        assert!((posterior.design_row(&AXIS_ANGLES, BallId::FIRST).norm() - 2.0).abs() < 1e-12);
        assert_eq!(posterior.design_row(&AXIS_ANGLES, BallId::at(1)).norm(), 0.0);
    }

    const A2: ParamId = ParamId::A(Joint::J2);
    const BALL: [ParamId; 3] = [
        ParamId::Ball(BallId::FIRST, Coordinate::X),
        ParamId::Ball(BallId::FIRST, Coordinate::Y),
        ParamId::Ball(BallId::FIRST, Coordinate::Z),
    ];

    /// How the tool ball moves by 1 mm of a1, by differences.
    fn moved_by_a(posterior: &Posterior) -> Vector3<f64> {
        let mut moved = posterior.model.geometry.clone();
        *moved.value_mut(A2).unwrap() += 1.0;
        moved.ball(&AXIS_ANGLES).position - posterior.model.geometry.ball(&AXIS_ANGLES).position
    }

    /// A free ball is where the tool ball is: it has the error that a1 gives the tool ball there, and 0.3 mm more.
    #[test]
    fn touched_ball_shares_the_error_of_the_robot() {
        const FREE_MM: f64 = 1e4;
        let posterior =
            Posterior::new(model(), &[&[A2][..], &BALL].concat(), &[0.7, FREE_MM, FREE_MM, FREE_MM]);
        let touched = posterior.touched(BallId::FIRST, &AXIS_ANGLES, 0.3);
        let by = moved_by_a(&posterior);
        let off = touched.model.balls[0] - posterior.model.geometry.ball(&AXIS_ANGLES).position;
        assert!(off.norm() < 1e-5, "{off}");
        let covariance = touched.covariance();
        for axis in 0..3 {
            assert!((covariance[(0, 1 + axis)] - 0.49 * by[axis]).abs() < 1e-6, "{axis}");
            assert!(
                (covariance[(1 + axis, 1 + axis)] - 0.49 * by[axis].powi(2) - 0.09).abs() < 1e-6,
                "{axis}"
            );
        }
        assert!((touched.sd(A2).unwrap() - 0.7).abs() < 1e-6);
    }

    /// A ball that is already known says as much about the robot: mean and covariance of the normal equations, with the
    /// difference of tool ball and base ball as three measurements.
    #[test]
    fn touching_a_known_ball_moves_the_robot_too() {
        const SD_MM: f64 = 0.2;
        let sds = [0.7, 0.5, 0.1, 2.0];
        let tool_ball = model().geometry.ball(&AXIS_ANGLES).position;
        let (mut start, apart) = (model(), Vector3::new(0.3, -0.2, 0.4));
        start.balls[0] = tool_ball - apart;
        let posterior = Posterior::new(start.clone(), &[&[A2][..], &BALL].concat(), &sds);
        let by = moved_by_a(&posterior);
        let rows = DMatrix::from_fn(3, 4, |axis, column| match column {
            0 => by[axis],
            column => -f64::from(u8::from(column == axis + 1)),
        });
        let prior = DMatrix::from_diagonal(&DVector::from_row_slice(&sds.map(|sd| 1.0 / (sd * sd))));
        let information = prior + rows.tr_mul(&rows) / (SD_MM * SD_MM);
        let covariance = information.try_inverse().unwrap();
        let mean = -&covariance * rows.tr_mul(&apart) / (SD_MM * SD_MM);
        let touched = posterior.touched(BallId::FIRST, &AXIS_ANGLES, SD_MM);
        assert!((touched.covariance() - &covariance).norm() < 1e-5 * covariance.norm());
        assert!((touched.model.value(A2) - start.value(A2) - mean[0]).abs() < 1e-4);
        for axis in 0..3 {
            assert!((touched.model.balls[0][axis] - start.balls[0][axis] - mean[1 + axis]).abs() < 1e-4);
        }
    }

    /// The quick product is that with the whole root, also where a ball was touched twice.
    #[test]
    fn factors_multiply_as_their_root() {
        let ids: Vec<ParamId> =
            Coordinate::ALL.iter().map(|axis| ParamId::Ball(BallId::FIRST, *axis)).chain([A2, BAR]).collect();
        let start = Posterior::new(model(), &ids, &[20.0, 20.0, 30.0, 0.5, 0.01]);
        let touched =
            start.touched(BallId::FIRST, &AXIS_ANGLES, 0.1).touched(BallId::FIRST, &[0.3; AXES], 0.2);
        assert_eq!(touched.factors.as_ref().map(|factors| factors.updates.len()), Some(6));
        let derivative = touched.derivative(&[0.2; AXES], BallId::FIRST);
        let found = touched.design_row(&[0.2; AXES], BallId::FIRST);
        assert!((found - touched.root.tr_mul(&derivative)).norm() < 1e-9);
        assert!(touched.with_exact_tool(&Vector3::x()).factors.is_none());
    }

    /// Rows of further parameters come before those of the coefficients; a parameter that is there stays.
    #[test]
    fn further_parameters_are_independent() {
        let root = DMatrix::from_row_slice(2, 2, &[0.3, 0.0, 5.0, 6.0]);
        let posterior = Posterior::with_root(model(), &[BAR], root);
        let wider = posterior.with_parameters(&[(BAR, 9.0), (A2, 0.5)]);
        assert_eq!((wider.ids(), wider.coefficients()), (&[BAR, A2][..], 1));
        let expected = DMatrix::from_row_slice(3, 3, &[0.3, 0.0, 0.0, 0.0, 0.0, 0.5, 5.0, 6.0, 0.0]);
        assert_eq!(wider.root(), &expected);
    }

    /// A pose that repeats to 0.3 mm, with joint 1 off by 0.4 mm at the ball.
    #[test]
    fn a_pose_has_errors_of_its_own() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let row = robot.geometry.length_row(&AXIS_ANGLES, &model().balls[0], 0.0);
        let mut unapproached_rad = [0.0; AXES];
        unapproached_rad[0] = 0.4 / row.by_joint()[0];
        let unknown = RobotUncertainty { pose_mm: 0.3, unapproached_rad, ..robot.known_uncertainty() };
        let posterior = Posterior::new(model(), &[BAR], &[0.1]);
        assert_eq!(posterior.own_sd_mm(&AXIS_ANGLES, BallId::FIRST), 0.0);
        let posterior = posterior.with_errors_of_pose(&unknown);
        assert!((posterior.own_sd_mm(&AXIS_ANGLES, BallId::FIRST) - 0.5).abs() < 1e-12);
        // An update keeps them.
        let touched = posterior.with_ball(Vector3::zeros()).touched(BallId::FIRST, &AXIS_ANGLES, 0.1);
        assert!((touched.own_sd_mm(&AXIS_ANGLES, BallId::FIRST) - 0.5).abs() < 1e-12);
    }

    /// (A'A)^-1 of a straight line through abscissae 0, 1, 2: [[5, -3], [-3, 3]] / 6.
    #[test]
    fn inverse_root_of_a_straight_line() {
        let root = inverse_root(&DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 1.0, 1.0, 1.0, 2.0])).unwrap();
        let expected = DMatrix::from_row_slice(2, 2, &[5.0, -3.0, -3.0, 3.0]) / 6.0;
        assert!((&root * root.transpose() - expected).norm() < 1e-14);
        assert!(inverse_root(&DMatrix::from_row_slice(1, 2, &[1.0, 2.0])).is_none());
    }
}
