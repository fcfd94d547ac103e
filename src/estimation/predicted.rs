//! The 3-D position error of the tool ball that an estimate leaves over a workspace.
//!
//! The estimator is simulated to first order: true errors delta are drawn from the tolerance, noise z from the lengths'
//! sigma, all together brought to their exact covariance. With F the triangular factor of the weighted Jacobian of all
//! parameters, Fk its columns of the kept ones and W the prior's rows, [Fk; W] = [Q1; Q2] R, the estimate of the kept ones
//! is R^-1 Q1' F delta + R^-1 S^(1/2) z, S = Q1'Q1. F may be of deficient rank, and is then not unique; R and S are, so that
//! the draws do not depend on rounding. What is wrong afterwards, estimate minus delta, moves the ball by its
//! position Jacobian; one best rigid alignment over the workspace is taken out, because lengths
//! do not determine where the base is. So what was held because the data could not determine it counts
//! with its full tolerance, and with what it did to the others.

use nalgebra::{DMatrix, Vector3};
use rand::RngExt;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::estimate::Estimate;
use super::lengths::Weighted;
use super::linear_system::factor;
use super::position::BallMotion;
use super::prior::PriorRows;
use super::priors::Prior;
use super::result::{MapPoint, PredictedPair};
use super::setting::Setting;
use crate::catalogue::EstimationFinding;
use crate::math::{Orthonormal, svd};
use crate::measurement::LengthModel;
use crate::robot::{AXES, Approach, Chain, Geometry, ParamId, Robot, RobotPosterior};

/// How many robots are drawn for a prediction, unless more numbers are to be drawn for each.
const DRAWS: usize = 100;
/// The identified robot must be predicted at least this much better than its maker's tolerance leaves it.
const BETTER: f64 = 0.5;

/// Error of the ball's position over a workspace: pooled over the robots drawn, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// Mean over robots and poses.
    pub mean: f64,
    /// 95th percentile over robots and poses.
    pub p95: f64,
    /// Largest over the poses: 95 % of the robots stay below it, so that it is never below `p95`.
    pub max: f64,
}

/// What two sources alone leave of the identified robot's position: root mean square over robots and poses, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionParts {
    /// The error of the bar's length.
    pub bar_mm: f64,
    /// The noise of the lengths.
    pub noise_mm: f64,
}

/// Poses over which the error is predicted, with the ball's position Jacobian at them.
pub struct Workspace {
    /// Ball positions, mm.
    pub positions: Vec<Vector3<f64>>,
    ids: Vec<ParamId>,
    /// 3 rows a pose, a column a parameter, with rigid motions taken out.
    jacobian: DMatrix<f64>,
}

impl Workspace {
    /// `count` axis vectors uniform within the robot's limits, from `seed`, rad.
    pub fn uniform(robot: &Robot, count: usize, seed: u64) -> Vec<[f64; AXES]> {
        let mut random = Pcg64::seed_from_u64(seed);
        (0..count)
            .map(|_| {
                let mut axes_deg = [0.0; AXES];
                for i in 0..AXES {
                    let [low, high] = robot.limits_at_deg(&axes_deg)[i];
                    axes_deg[i] = random.random_range(low..high);
                }
                axes_deg.map(f64::to_radians)
            })
            .collect()
    }

    /// The position Jacobian by `ids` at `poses` (axis angles, rad).
    pub fn new(geometry: &Geometry, poses: &[[f64; AXES]], ids: &[ParamId]) -> Self {
        let mut jacobian = DMatrix::zeros(3 * poses.len(), ids.len());
        let mut positions = Vec::with_capacity(poses.len());
        let chain = Chain::new(geometry);
        for (at, axes) in poses.iter().enumerate() {
            let ball = chain.ball_jacobian(axes, ids, |column, moved| {
                jacobian.fixed_view_mut::<3, 1>(3 * at, column).copy_from(&moved);
            });
            positions.push(ball);
        }
        take_out_rigid_motion(&mut jacobian, &positions);
        Self { positions, ids: ids.to_vec(), jacobian }
    }

    /// The same by `ids`, then by the coefficients of the joints' errors.
    pub fn with_joint_errors(geometry: &Geometry, poses: &[[f64; AXES]], ids: &[ParamId]) -> Self {
        let poses: Vec<_> = poses.iter().map(|axes| (*axes, Approach::default())).collect();
        let BallMotion { mut jacobian, balls: positions, .. } = BallMotion::new(geometry, &poses, ids);
        take_out_rigid_motion(&mut jacobian, &positions);
        Self { positions, ids: ids.to_vec(), jacobian }
    }

    /// How the parameter errors of the robots (a column each, in the order of the ids) displace the
    /// ball: 3 rows a pose, mm.
    pub fn displacements(&self, errors: &DMatrix<f64>) -> DMatrix<f64> {
        &self.jacobian * errors
    }

    /// The size of the displacements of all robots.
    pub fn summary(&self, moved: &DMatrix<f64>) -> ErrorSummary {
        ErrorSummary::of(moved)
    }

    /// Root mean square displacement at each pose over the robots.
    pub fn map(&self, moved: &DMatrix<f64>) -> Vec<MapPoint> {
        let rms = |pose: usize| (moved.rows(3 * pose, 3).norm_squared() / moved.ncols().max(1) as f64).sqrt();
        self.positions
            .iter()
            .enumerate()
            .map(|(pose, position)| MapPoint { position: *position, rms_mm: rms(pose) })
            .collect()
    }

    /// What each parameter moves: three rows a pose, rigid motions taken out.
    pub fn jacobian(&self) -> &DMatrix<f64> {
        &self.jacobian
    }

    /// The parameters of the columns.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }
}

impl ErrorSummary {
    /// Of displacements, a column a robot and 3 rows a pose, mm.
    pub(super) fn of(moved: &DMatrix<f64>) -> Self {
        let mut sizes = Vec::with_capacity(moved.len() / 3);
        let mut largest = Vec::with_capacity(moved.ncols());
        for column in moved.column_iter() {
            let at = |pose: usize| column.fixed_rows::<3>(3 * pose).norm();
            let first = sizes.len();
            sizes.extend((0..moved.nrows() / 3).map(at));
            largest.push(sizes[first..].iter().copied().fold(0.0, f64::max));
        }
        if sizes.is_empty() {
            return ErrorSummary::default();
        }
        let mean = sizes.iter().sum::<f64>() / sizes.len() as f64;
        Self { mean, p95: percentile_95(&mut sizes), max: percentile_95(&mut largest) }
    }
}

/// The value that 95 % of some do not exceed.
fn percentile_95(values: &mut [f64]) -> f64 {
    let rank = ((values.len() as f64 * 0.95) as usize).min(values.len() - 1);
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// Projects the six rigid motions of the positions out of the columns.
pub(super) fn take_out_rigid_motion(jacobian: &mut DMatrix<f64>, positions: &[Vector3<f64>]) {
    if positions.is_empty() {
        return;
    }
    let centroid = positions.iter().sum::<Vector3<f64>>() / positions.len() as f64;
    let mut rigid = DMatrix::zeros(3 * positions.len(), 6);
    for (at, position) in positions.iter().enumerate() {
        for axis in 0..3 {
            let unit = Vector3::ith(axis, 1.0);
            rigid[(3 * at + axis, axis)] = 1.0;
            let turned = unit.cross(&(position - centroid));
            for row in 0..3 {
                rigid[(3 * at + row, 3 + axis)] = turned[row];
            }
        }
    }
    // Poses on a line leave fewer than six motions.
    let mut motions = Orthonormal::default();
    for column in rigid.column_iter() {
        motions.push(column.into_owned(), 1e-9 * column.norm());
    }
    for column in jacobian.column_iter_mut() {
        motions.remove_from(column);
    }
}

/// What an estimate does with true errors and noise, to first order.
pub struct Estimator<'a> {
    /// All parameters that can be wrong, in the order of the factor's columns.
    pub ids: &'a [ParamId],
    /// Triangular factor of their weighted Jacobian (rows divided by sigma).
    pub factor: &'a DMatrix<f64>,
    /// Root of the covariance of the true errors, a row a parameter; 0 for what is exact or free.
    pub truth: &'a DMatrix<f64>,
    /// Which of the parameters are estimated.
    pub kept: &'a [usize],
    /// Prior on the estimated ones as rows of weighted equations; no rows without a prior.
    pub prior: &'a DMatrix<f64>,
}

impl Estimator<'_> {
    /// True errors of drawn robots, a column each, and the noise of their lengths, a row a kept parameter.
    pub fn draws(&self) -> [DMatrix<f64>; 2] {
        let drawn = unit_draws(self.ids.len() + self.kept.len());
        let truths = self.truth * drawn.rows(0, self.ids.len());
        [truths, drawn.rows(self.ids.len(), self.kept.len()).into_owned()]
    }

    /// What is wrong after the estimate, for each robot of [`Estimator::draws`]: estimate minus truth.
    /// `None` when the estimate is not determined.
    pub fn errors(&self, truths: &DMatrix<f64>, noise: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let mut errors = -truths;
        if self.kept.is_empty() {
            return Some(errors);
        }
        let (rows, unknowns) = (self.factor.nrows(), self.kept.len());
        let mut stacked = DMatrix::zeros(rows + self.prior.nrows(), unknowns);
        stacked.rows_mut(0, rows).copy_from(&self.factor.select_columns(self.kept));
        stacked.rows_mut(rows, self.prior.nrows()).copy_from(self.prior);
        let qr = stacked.qr();
        let of_data = qr.q().rows(0, rows).into_owned();
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

/// The position uncertainty of the nominal and the identified robot over the workspace.
pub(crate) struct Prediction {
    pub(crate) pair: PredictedPair,
    pub(super) parts: PositionParts,
    pub(super) map: Vec<MapPoint>,
    /// The robot by its maker's tolerance, whatever was identified before.
    pub(super) maker: ErrorSummary,
    /// What the identified robot may still be wrong by.
    pub(super) posterior: Option<RobotPosterior>,
    /// Root of the covariance of the errors before,
    pub(crate) before: DMatrix<f64>,
    /// all parameters that can be wrong,
    pub(crate) ids: Vec<ParamId>,
    /// the factor of their whitened Jacobian at the solution,
    pub(super) factor: DMatrix<f64>,
    /// and where an error counts.
    pub(crate) workspace: Workspace,
}

impl Prediction {
    /// # Errors
    /// An estimate that is not determined, or a number that is not finite.
    pub(super) fn of(
        setting: &Setting<'_>,
        estimate: &Estimate,
        lengths: &Weighted,
    ) -> Result<Self, EstimationFinding> {
        let more = [estimate.analysis.ids.as_slice(), &estimate.kept].concat();
        let ids = setting.all_and(estimate.before.balls.len().into(), &more);
        // What is optional counts as exact for both robots, as where it is not estimated.
        let of_robot = |id: &ParamId| setting.priors.bound(*id, &[]).filter(|_| !id.is_optional());
        let sd = |id: &ParamId| of_robot(id).or_else(|| estimate.prior_sd(*id).filter(|_| !id.is_optional()));
        let tolerance: Vec<f64> = ids.iter().map(|id| sd(id).unwrap_or(0.0)).collect();
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
        // What the user fixed is taken as exact; the nominal robot has all its tolerance.
        let fixed = |id: &ParamId| !estimate.analysis.ids.contains(id);
        let unknown = without_rows(&truths, &ids, fixed);
        let errors = estimator.errors(&unknown, &noise).ok_or(EstimationFinding::NotFinite)?;
        let moved = workspace.displacements(&errors);
        // The estimate is linear in its errors: those of one source go on alone.
        let rms = |truths: &DMatrix<f64>, noise: &DMatrix<f64>| {
            let moved = workspace.displacements(&estimator.errors(truths, noise)?);
            Some(moved.norm() / (moved.len().max(3) as f64 / 3.0).sqrt())
        };
        let is_bar = |id: &ParamId| matches!(id, ParamId::BarOffset(_));
        let of_bar = without_rows(&unknown, &ids, |id| !is_bar(id));
        let parts = PositionParts {
            bar_mm: rms(&of_bar, &(&noise * 0.0)).ok_or(EstimationFinding::NotFinite)?,
            noise_mm: rms(&(&unknown * 0.0), &noise).ok_or(EstimationFinding::NotFinite)?,
        };
        let pair = PredictedPair {
            nominal: workspace.summary(&workspace.displacements(&truths)),
            identified: workspace.summary(&moved),
        };
        let maker = if setting.options.prior == Prior::Posterior {
            let sd = |at: usize| setting.priors.geometric(ids[at]).unwrap_or(0.0);
            let tolerance = DMatrix::from_fn(
                ids.len(),
                ids.len(),
                |row, column| {
                    if row == column { sd(row) } else { 0.0 }
                },
            );
            workspace.summary(&workspace.displacements(&(tolerance * unit_draws(ids.len()))))
        } else {
            pair.nominal
        };
        let posterior = estimator.left(setting, estimate);
        Ok(Self { pair, parts, maker, posterior, map: workspace.map(&moved), before, ids, factor, workspace })
    }

    /// Whether the identified robot is predicted to be clearly better than its maker's word.
    pub(crate) fn is_determined(&self) -> bool {
        self.pair.identified.mean <= BETTER * self.maker.mean
    }
}

impl Estimator<'_> {
    /// What the robot's own values and the base balls may be wrong by after the estimate: by the errors before, and by the
    /// noise. A set-up that the user fixed is exact, a robot's parameter that was fixed is known as before.
    fn left(&self, setting: &Setting<'_>, estimate: &Estimate) -> Option<RobotPosterior> {
        let (count, kept) = (self.ids.len(), self.kept.len());
        let mut truth = self.truth.clone();
        let is_own = |id: ParamId| id.is_geometric() || matches!(id, ParamId::Tool(_) | ParamId::Ball(..));
        let is_asked = |id: &ParamId| estimate.analysis.ids.contains(id);
        let poor = |id: &ParamId| estimate.poorly_observable.contains(id);
        for (at, id) in self.ids.iter().enumerate() {
            match id {
                ParamId::Tool(_) if poor(id) => truth[(at, at)] = setting.priors.sd(*id),
                _ if !id.moves_tool_ball() && !is_asked(id) => truth.row_mut(at).fill(0.0),
                _ => {}
            }
        }
        let of_truth = self.errors(&truth, &DMatrix::zeros(kept, count))?;
        let of_noise = self.errors(&DMatrix::zeros(count, kept), &DMatrix::identity(kept, kept))?;
        let own: Vec<usize> = (0..count)
            .filter(|&at| is_own(self.ids[at]) && (of_truth.row(at).norm() + of_noise.row(at).norm()) > 0.0)
            .collect();
        let mut root = DMatrix::zeros(own.len(), count + kept);
        root.columns_mut(0, count).copy_from(&of_truth.select_rows(&own));
        root.columns_mut(count, kept).copy_from(&of_noise.select_rows(&own));
        let ids: Vec<ParamId> = own.iter().map(|at| self.ids[*at]).collect();
        let LengthModel { geometry, balls, .. } = &estimate.fit.model;
        RobotPosterior::with_balls(&ids, geometry, balls, &root)
    }
}

/// The errors without those of some parameters.
fn without_rows(errors: &DMatrix<f64>, ids: &[ParamId], out: impl Fn(&ParamId) -> bool) -> DMatrix<f64> {
    let mut left = errors.clone();
    for (at, _) in ids.iter().enumerate().filter(|(_, id)| out(id)) {
        left.row_mut(at).fill(0.0);
    }
    left
}

/// Standard normal numbers, a column a robot, from seed 1. Rows are brought to unit covariance: as drawn, so few robots
/// can miss the size of an error in one direction, as of a scale, by a tenth.
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
    fn draws_have_the_covariance_they_stand_for() {
        for rows in [3, 64, 120] {
            let draws = unit_draws(rows);
            let covariance = &draws * draws.transpose() / draws.ncols() as f64;
            assert!((covariance - DMatrix::identity(rows, rows)).norm() < 1e-12);
        }
    }

    /// Lengths of which two parameters are one by another name, and a prior that separates them.
    #[test]
    fn errors_are_those_of_the_estimate_whatever_the_rows_of_the_factor() {
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
