//! Which further measurement would help most: candidates are tried, not judged by rule.
//!
//! The rows that a candidate's poses would add are stacked on those measured, with the prior; the position error that is
//! left over the workspace follows from the covariance, and from the stacked rows alone which parameters the lengths would
//! identify. All of it is taken at one model, the nominal geometry in its set-up, where ranks are taken.

mod candidates;

use std::mem::discriminant;

use nalgebra::DMatrix;

use crate::catalogue::EstimationFinding;
use crate::estimation::result::{FurtherMeasurement, Recommendation};
use crate::estimation::{
    Calibration, LinearSystem, Prior, Priors, Workspace, factor, inverse_root, is_place, order_of_choice,
    root_after, without_open_places,
};
use crate::math::base_set;
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::{BallId, Coordinate, ParamId, Robot};
use candidates::Candidate;

/// Above this share of the error before, a further measurement adds next to nothing.
const NOTHING: f64 = 0.97;

/// What is measured, and what is tried on it.
struct Trial<'a> {
    robot: &'a Robot,
    /// The nominal geometry in its set-up.
    model: &'a LengthModel,
    /// The lengths there are, or an even sample of many.
    readings: Vec<PreparedMeasurement>,
    /// What is unknown, in canonical order.
    ids: &'a [ParamId],
    priors: &'a Priors,
    identified: Vec<ParamId>,
}

/// By what a candidate is judged.
struct Scale {
    /// The factor of the whitened rows of all lengths, and the root mean square of their standard deviations.
    rows: DMatrix<f64>,
    sigma_mm: f64,
    /// Mean over the workspace of what each pair of parameters moves, mm^2.
    weight: DMatrix<f64>,
    /// Makes a mean error of a root mean square.
    mean_of_rms: f64,
}

/// A candidate with what it would leave.
struct Tried {
    candidate: Candidate,
    rows: DMatrix<f64>,
    error_mm: f64,
}

/// Further measurements, best first: only where something is confounded that lengths could separate, poorly observable, or
/// where the position is not determined; only what would lower the error.
///
/// # Errors
/// When what further measurements would leave is not a finite number.
pub fn recommend(of: &Calibration<'_>) -> Result<Vec<Recommendation>, EstimationFinding> {
    let (setting, estimate, pair) = (&of.setting, &of.estimate, &of.prediction.pair);
    let identified = of.identified();
    let all_identified =
        estimate.poorly_observable.is_empty() && estimate.base.iter().all(|id| identified.contains(id));
    let trial = Trial::of(of, identified);
    if all_identified
        && of.prediction.is_determined()
        && !trial.more_is_identifiable(estimate.analysis.base.rank)
    {
        return Ok(Vec::new());
    }
    // Two poses or fewer are aligned away whatever the robot: there is no error to lower.
    let mean_of_rms = mean_of_rms(of);
    if !mean_of_rms.is_finite() {
        return Ok(Vec::new());
    }
    let lengths = estimate.used(&of.lengths);
    let poses = setting.options.workspace_poses(setting.robot);
    let scale = Scale {
        rows: factor(trial.model, &lengths, trial.ids),
        sigma_mm: lengths.rms_sigma(),
        weight: weight(&Workspace::new(&trial.model.geometry, &poses, trial.ids)),
        mean_of_rms,
    };
    trial
        .recommendations(&scale, &setting.options.prior, pair.identified.mean)
        .ok_or(EstimationFinding::NoRecommendation)
}

impl<'a> Trial<'a> {
    fn of(of: &'a Calibration<'_>, identified: Vec<ParamId>) -> Self {
        let (setting, estimate) = (&of.setting, &of.estimate);
        let (robot, priors, ids) = (setting.robot, &setting.priors, estimate.analysis.ids.as_slice());
        let lengths = estimate.used(&of.lengths);
        // A set-up that the lengths hardly determine may have run off in the fit.
        let closed = without_open_places(priors, setting.start, &lengths, ids).unwrap_or_default();
        let sound = ids.iter().filter(|id| is_place(id)).all(|id| closed.contains(id));
        let model = if sound { &estimate.before } else { setting.start };
        let some = lengths.some(|reading, sigma| (*reading, sigma)).into_iter();
        Self {
            robot,
            model,
            readings: some.filter(|(_, sigma)| sigma.is_finite()).map(|(reading, _)| reading).collect(),
            ids,
            priors,
            identified,
        }
    }

    /// Whether poses all over the robot's reach, to the same balls, would determine more directions than these do.
    /// What remains dependent then, no lengths separate.
    fn more_is_identifiable(&self, rank: usize) -> bool {
        let balls = self.model.balls.len();
        if balls == 0 {
            return false;
        }
        let count = 3 * self.ids.len() + 10;
        let readings: Vec<PreparedMeasurement> = Workspace::uniform(self.robot.controller(), count, 1)
            .into_iter()
            .enumerate()
            .map(|(at, axes)| PreparedMeasurement::new(axes, BallId::at(at % balls), 0.0))
            .collect();
        let mut columns = factor(self.model, readings.as_slice(), self.ids);
        columns.column_iter_mut().for_each(|mut column| {
            let norm = column.norm();
            column /= if norm < 1e-9 { f64::INFINITY } else { norm };
        });
        let pivots = columns.col_piv_qr().unpack_r().diagonal();
        pivots.iter().filter(|pivot| pivot.abs() > 1e-8 * pivots[0].abs()).count() > rank
    }

    /// The best of each kind that is better than `before_mm`; `None` when a number is not finite.
    fn recommendations(&self, by: &Scale, prior: &Prior, before_mm: f64) -> Option<Vec<Recommendation>> {
        let now_mm = by.mean_of_rms * rms(&self.root(&by.rows)?, &by.weight);
        let identified_now = self.identified(&by.rows, self.ids)?;
        let needs_prior = *prior == Prior::None;
        // With a prior the result's own figure is by the same measure, up to the robots drawn for it; where the solver
        // did worse than the prior allows, a proposal is not to pay for it.
        let scale = if needs_prior { 1.0 } else { (before_mm / now_mm).min(1.0) };
        let mut recommendations = Vec::new();
        for Tried { candidate, rows, error_mm } in self.best_of_each_kind(by)? {
            let is_prior = candidate.measure == FurtherMeasurement::Prior;
            if is_prior && !needs_prior {
                continue;
            }
            let mut identifies = self.identified(&rows, &self.with_ball(&candidate))?;
            identifies.retain(|id| {
                !self.identified.contains(id) && !identified_now.contains(id) && self.ids.contains(id)
            });
            recommendations.push(Recommendation {
                measure: candidate.measure,
                poses: candidate.poses.len(),
                before_mm,
                after_mm: scale * error_mm,
                needs_prior,
                adds: is_prior || error_mm < NOTHING * now_mm,
                identifies,
            });
        }
        // Without a prior this error and that with one are of two estimates: the prior alone may make it larger.
        recommendations.retain(|recommendation| recommendation.after_mm < recommendation.before_mm);
        Some(recommendations)
    }

    /// Best first.
    fn best_of_each_kind(&self, by: &Scale) -> Option<Vec<Tried>> {
        let mut best: Vec<Tried> = Vec::new();
        for candidate in candidates::all(self) {
            let rows = self.stacked(&candidate, by);
            let error_mm = by.mean_of_rms * rms(&self.root(&rows)?, &by.weight);
            let kind = discriminant(&candidate.measure);
            let tried = Tried { candidate, rows, error_mm };
            match best.iter_mut().find(|other| discriminant(&other.candidate.measure) == kind) {
                Some(other) if error_mm < other.error_mm => *other = tried,
                Some(_) => {}
                None => best.push(tried),
            }
        }
        best.sort_by(|a, b| a.error_mm.total_cmp(&b.error_mm));
        Some(best)
    }

    /// The parameters, with those of a candidate's further ball.
    fn with_ball(&self, candidate: &Candidate) -> Vec<ParamId> {
        let mut ids = self.ids.to_vec();
        if candidate.ball.is_some() {
            ids.extend(Coordinate::ALL.map(|coordinate| ParamId::Ball(self.further_ball(), coordinate)));
        }
        ids
    }

    fn further_ball(&self) -> BallId {
        BallId::at(self.model.balls.len())
    }

    /// The rows measured with those of a candidate under them; columns of a further ball at the end.
    fn stacked(&self, candidate: &Candidate, by: &Scale) -> DMatrix<f64> {
        let ids = self.with_ball(candidate);
        let mut model = self.model.clone();
        model.balls.extend(candidate.ball);
        let sigma = vec![by.sigma_mm; candidate.poses.len()];
        let further =
            LinearSystem::at(&model, &(candidate.poses.as_slice(), sigma.as_slice()), &ids).factor();
        let mut stacked = DMatrix::zeros(by.rows.nrows() + further.nrows(), ids.len());
        stacked.view_mut((0, 0), by.rows.shape()).copy_from(&by.rows);
        stacked.rows_mut(by.rows.nrows(), further.nrows()).copy_from(&further);
        stacked
    }

    /// The root of the covariance that whitened rows leave of the prior; columns beyond the known ones are a further
    /// ball's, which is known as any that was taught.
    fn root(&self, rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let further = ParamId::Ball(self.further_ball(), Coordinate::X);
        let ids: Vec<ParamId> =
            self.ids.iter().copied().chain(std::iter::repeat(further)).take(rows.ncols()).collect();
        let sd: Vec<f64> = ids.iter().map(|id| self.priors.sd(*id)).collect();
        root_after(&self.priors.root(&ids, &sd), rows)
    }

    /// The parameters that whitened rows alone identify.
    fn identified(&self, rows: &DMatrix<f64>, ids: &[ParamId]) -> Option<Vec<ParamId>> {
        let triangle = rows.clone().qr().r();
        let set = base_set(&triangle, &order_of_choice(ids))?;
        let Some(inverse) = inverse_root(&triangle.select_columns(&set.kept)) else {
            return Some(Vec::new());
        };
        let limit = |id| self.priors.weak_limit(id).unwrap_or(f64::INFINITY);
        let identified =
            set.kept.iter().enumerate().filter(|(place, k)| inverse.row(*place).norm() <= limit(ids[**k]));
        Some(identified.map(|(_, k)| ids[*k]).collect())
    }
}

/// Mean over the workspace of what each pair of parameters moves, mm^2.
fn weight(workspace: &Workspace) -> DMatrix<f64> {
    let jacobian = workspace.jacobian();
    jacobian.tr_mul(jacobian) / (jacobian.nrows() as f64 / 3.0).max(1.0)
}

/// The mean error of robots drawn from the prior over its root mean square.
fn mean_of_rms(of: &Calibration<'_>) -> f64 {
    let prediction = &of.prediction;
    let jacobian = prediction.workspace.jacobian();
    let square = (jacobian * &prediction.before).norm_squared();
    prediction.pair.nominal.mean / (3.0 * square / jacobian.nrows().max(1) as f64).sqrt()
}

/// Root mean square of the position error over the workspace of `weight`, of errors with this root of their covariance;
/// parameters beyond those of the weight move nothing.
fn rms(root: &DMatrix<f64>, weight: &DMatrix<f64>) -> f64 {
    let root = root.rows(0, weight.nrows());
    (weight * root).dot(&root).sqrt()
}
