//! The predicted position uncertainty of the tool ball over a workspace.
//!
//! The estimator is simulated to first order. True errors delta are drawn from the tolerance and noise z from the standard
//! deviation of the lengths, all scaled to their exact covariance. F is the triangular factor of the whitened Jacobian of
//! all parameters, Fk its columns of the estimated ones, W the rows of the prior, and [Fk; W] = [Q1; Q2] R. The estimate is
//! R^-1 Q1' F delta + R^-1 S^(1/2) z with S = Q1'Q1. If the rank of F is deficient F is not unique, but R and S are, so that the
//! draws do not depend on rounding. The error, estimate minus delta, moves the ball by its position Jacobian. One best rigid
//! alignment over the workspace is taken out, because lengths do not determine the base of the robot. Thus a parameter that
//! was fixed because the data do not determine it contributes its whole tolerance, and its effect on the others.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::estimate::Estimate;
use super::joint_prediction::JointPrediction;
use super::lengths::Weighted;
use super::linear_system::factor;
use super::options::Setting;
use super::prior::PriorRows;
use super::priors::Prior;
use super::result::{MapPoint, PredictedPair};
use super::selection::is_bar;
use super::workspace::{ErrorSummary, Workspace};
use crate::estimation::EstimationFinding;
use crate::math::{stacked, svd};
use crate::measurement::LengthModel;
use crate::robot::{ParamId, RobotPosterior, RobotUncertainty};

/// Number of drawn robots, unless there are more random numbers for each.
const DRAWS: usize = 100;
/// The predicted error of the identified robot must be at most this fraction of that by the manufacturer's tolerance.
const BETTER: f64 = 0.5;

/// Contributions to the position error of the identified robot: root mean square over robots and poses, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionParts {
    /// The error of the bar's length.
    pub bar_mm: f64,
    /// The noise of the lengths.
    pub noise_mm: f64,
}

/// The linearised response of an estimate to true errors and noise.
struct Estimator<'a> {
    /// All parameters with errors, in the order of the factor's columns.
    ids: &'a [ParamId],
    /// Triangular factor of their whitened Jacobian.
    factor: &'a DMatrix<f64>,
    /// Root of the covariance of the true errors, a row a parameter; zero rows for exact and free parameters.
    truth: &'a DMatrix<f64>,
    /// Indices of the estimated parameters.
    kept: &'a [usize],
    /// Rows of the prior on the estimated parameters; none without a prior.
    prior: &'a DMatrix<f64>,
}

impl Estimator<'_> {
    /// True errors of drawn robots, a column each, and the noise, a row an estimated parameter.
    fn draws(&self) -> [DMatrix<f64>; 2] {
        let drawn = unit_draws(self.ids.len() + self.kept.len());
        let truths = self.truth * drawn.rows(0, self.ids.len());
        [truths, drawn.rows(self.ids.len(), self.kept.len()).into_owned()]
    }

    /// The errors after the estimate, estimate minus truth, a column a robot. `None` if the estimate is not determined.
    fn errors(&self, truths: &DMatrix<f64>, noise: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let mut errors = -truths;
        if self.kept.is_empty() {
            return Some(errors);
        }
        let qr = stacked(&self.factor.select_columns(self.kept), self.prior).qr();
        let of_data = qr.q().rows(0, self.factor.nrows()).into_owned();
        let svd = svd(&of_data)?;
        let root = &svd.v * DMatrix::from_diagonal(&svd.values) * svd.v.transpose();
        let right = of_data.tr_mul(&(self.factor * truths)) + root * noise;
        let estimate = qr.r().solve_upper_triangular(&right)?;
        for (place, &k) in self.kept.iter().enumerate() {
            let mut row = errors.row_mut(k);
            row += estimate.row(place);
        }
        Some(errors)
    }
}

/// The predicted position uncertainty of the nominal and the identified robot.
pub(crate) struct Prediction {
    pub(crate) pair: PredictedPair,
    pub(super) parts: PositionParts,
    pub(super) map: Vec<MapPoint>,
    /// Of the robot by its manufacturer's tolerance, independent of an earlier identification.
    pub(super) maker: ErrorSummary,
    /// The uncertainty of a robot with errors of the joints.
    pub(super) joint_uncertainty: Option<RobotUncertainty>,
    /// The posterior of the identified robot.
    pub(super) posterior: Option<RobotPosterior>,
    /// Root of the prior covariance of the errors of `ids`.
    pub(crate) before: DMatrix<f64>,
    /// All parameters with errors.
    pub(crate) ids: Vec<ParamId>,
    /// Factor of their whitened Jacobian at the solution.
    pub(super) factor: DMatrix<f64>,
    pub(crate) workspace: Workspace,
}

impl Prediction {
    /// # Errors
    /// The estimate is not determined, or a number is not finite.
    pub(super) fn of(
        setting: &Setting<'_>,
        estimate: &Estimate,
        lengths: &Weighted,
    ) -> Result<Self, EstimationFinding> {
        let more = [estimate.analysis.ids.as_slice(), &estimate.kept].concat();
        let ids = setting.all_and(estimate.before.balls.len().into(), &more);
        // Optional parameters count as exact, even if they are estimated.
        let sd = |id: &ParamId| setting.priors.bound(*id, &[]).or_else(|| estimate.prior_sd(*id));
        let tolerance: Vec<f64> =
            ids.iter().map(|id| sd(id).filter(|_| !id.is_optional()).unwrap_or(0.0)).collect();
        let kept: Vec<usize> =
            estimate.kept.iter().filter_map(|id| ids.iter().position(|other| other == id)).collect();
        let none = DMatrix::zeros(0, kept.len());
        let prior = estimate.prior.as_ref().map_or(&none, PriorRows::matrix);
        let model = &estimate.fit.model;
        let factor = factor(model, lengths, &ids);
        let before = setting.priors.root(&ids, &tolerance);
        let estimator = Estimator { ids: &ids, factor: &factor, truth: &before, kept: &kept, prior };
        let workspace =
            Workspace::new(&model.geometry, &setting.options.workspace_poses(setting.robot), &ids);
        let [truths, noise] = estimator.draws();
        // Parameters that the user fixed count as exact in the identified robot.
        let unknown = without_rows(&truths, &ids, |id| !estimate.analysis.ids.contains(id));
        let displacements = |truths: &DMatrix<f64>, noise: &DMatrix<f64>| {
            let errors = estimator.errors(truths, noise).ok_or(EstimationFinding::NotFinite)?;
            Ok(workspace.displacements(&errors))
        };
        let moved = displacements(&unknown, &noise)?;
        // The estimate is linear, so that the contributions can be computed separately.
        let rms = |moved: DMatrix<f64>| moved.norm() / (moved.len().max(3) as f64 / 3.0).sqrt();
        let of_bar = without_rows(&unknown, &ids, |id| !is_bar(id));
        let parts = PositionParts {
            bar_mm: rms(displacements(&of_bar, &(&noise * 0.0))?),
            noise_mm: rms(displacements(&(&unknown * 0.0), &noise)?),
        };
        let summary = |errors: &DMatrix<f64>| ErrorSummary::of(&workspace.displacements(errors));
        let pair = PredictedPair { nominal: summary(&truths), identified: ErrorSummary::of(&moved) };
        let maker = if setting.options.prior == Prior::Posterior {
            let sd = |at: usize, _| setting.priors.geometric(ids[at]).unwrap_or(0.0);
            let tolerance = DMatrix::from_diagonal(&DVector::from_fn(ids.len(), sd));
            summary(&(tolerance * unit_draws(ids.len())))
        } else {
            pair.nominal
        };
        let posterior = estimator.posterior(setting, estimate);
        Ok(Self {
            map: workspace.map(&moved),
            joint_uncertainty: None,
            pair,
            parts,
            maker,
            posterior,
            before,
            ids,
            factor,
            workspace,
        })
    }

    /// With errors of the joints.
    pub(super) fn with_joints(self, joints: JointPrediction) -> Self {
        let JointPrediction { summary, map, unknown } = joints;
        let pair = PredictedPair { identified: summary, ..self.pair };
        Self { pair, map, joint_uncertainty: Some(unknown), ..self }
    }

    /// Whether the identified robot is predicted to be clearly better than the manufacturer's tolerance.
    pub(crate) fn is_determined(&self) -> bool {
        self.pair.identified.mean <= BETTER * self.maker.mean
    }
}

impl Estimator<'_> {
    /// The posterior of the parameters of the robot and of the base balls. A set-up that the user fixed is exact; a fixed
    /// parameter of the robot keeps its prior.
    fn posterior(&self, setting: &Setting<'_>, estimate: &Estimate) -> Option<RobotPosterior> {
        let (count, kept) = (self.ids.len(), self.kept.len());
        let mut truth = self.truth.clone();
        let is_own = |id: ParamId| id.is_geometric() || matches!(id, ParamId::Tool(_) | ParamId::Ball(..));
        let is_asked = |id: &ParamId| estimate.analysis.ids.contains(id);
        let poor = |id: &ParamId| estimate.poorly_observable.contains(id);
        for (at, id) in self.ids.iter().enumerate() {
            if matches!(id, ParamId::Tool(_)) && poor(id) {
                truth[(at, at)] = setting.priors.sd(*id);
            } else if !id.moves_tool_ball() && !is_asked(id) {
                truth.row_mut(at).fill(0.0);
            }
        }
        let of_truth = self.errors(&truth, &DMatrix::zeros(kept, count))?;
        let of_noise = self.errors(&DMatrix::zeros(count, kept), &DMatrix::identity(kept, kept))?;
        let own: Vec<usize> = (0..count)
            .filter(|&at| is_own(self.ids[at]) && (of_truth.row(at).norm() + of_noise.row(at).norm()) > 0.0)
            .collect();
        let mut root = of_truth.select_rows(&own).resize_horizontally(count + kept, 0.0);
        root.columns_mut(count, kept).copy_from(&of_noise.select_rows(&own));
        let ids: Vec<ParamId> = own.iter().map(|at| self.ids[*at]).collect();
        let LengthModel { geometry, balls, .. } = &estimate.fit.model;
        RobotPosterior::with_balls(&ids, geometry, balls, &root)
    }
}

/// The errors with zero rows for some parameters.
fn without_rows(errors: &DMatrix<f64>, ids: &[ParamId], is_exact: impl Fn(&ParamId) -> bool) -> DMatrix<f64> {
    let mut errors = errors.clone();
    for (at, _) in ids.iter().enumerate().filter(|(_, id)| is_exact(id)) {
        errors.row_mut(at).fill(0.0);
    }
    errors
}

/// Standard normal numbers, a column a robot, from seed 1, scaled to unit covariance: the sample covariance of so few robots
/// could be wrong by a tenth in one direction.
pub(super) fn unit_draws(rows: usize) -> DMatrix<f64> {
    let mut random = Pcg64::seed_from_u64(1);
    let robots = DRAWS.max(rows);
    let drawn = DMatrix::from_fn(robots, rows, |_, _| StandardNormal.sample(&mut random));
    drawn.qr().q().transpose() * (robots as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_have_unit_covariance() {
        for rows in [3, 64, 120] {
            let draws = unit_draws(rows);
            let covariance = &draws * draws.transpose() / draws.ncols() as f64;
            assert!((covariance - DMatrix::identity(rows, rows)).norm() < 1e-12);
        }
    }

    /// Three linearly dependent parameters, and a prior that separates them.
    #[test]
    fn errors_do_not_depend_on_the_rows_of_the_factor() {
        let factor = DMatrix::from_row_slice(
            4,
            4,
            &[3.0, 1.0, 4.0, 0.5, 0.0, 2.0, 2.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5],
        );
        // The third is the sum of the first two.
        assert!((factor.column(2) - factor.column(0) - factor.column(1)).norm() < 1e-15);
        let (ids, kept) = ([ParamId::Tool(crate::robot::Coordinate::X); 4], [0, 1, 2]);
        let prior = DMatrix::from_diagonal(&nalgebra::DVector::from_row_slice(&[0.2, 0.1, 0.4]));
        let tolerance = [5.0, 10.0, 2.5, 0.3];
        let truth = DMatrix::from_diagonal(&nalgebra::DVector::from_row_slice(&tolerance));
        let errors = |factor: &DMatrix<f64>| {
            let estimator = Estimator { ids: &ids, factor, truth: &truth, kept: &kept, prior: &prior };
            let [truths, noise] = estimator.draws();
            estimator.errors(&truths, &noise).unwrap()
        };
        let found = errors(&factor);
        let turned = DMatrix::from_fn(4, 4, |i, j| ((3 * i + 5 * j) as f64).sin()).qr().q() * &factor;
        assert!((errors(&turned) - &found).norm() < 1e-12 * found.norm());
        let kept_columns = factor.columns(0, 3);
        let inverse = (kept_columns.tr_mul(&kept_columns) + prior.tr_mul(&prior)).try_inverse().unwrap();
        let held = &inverse * kept_columns.tr_mul(&factor.column(3)) * tolerance[3];
        let expected = &inverse + &held * held.transpose();
        let covariance = found.rows(0, 3) * found.rows(0, 3).transpose() / found.ncols() as f64;
        assert!((covariance - &expected).norm() < 1e-10 * expected.norm());
    }
}
