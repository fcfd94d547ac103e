//! Recommendations of further measurements, by simulation of candidates.
//!
//! The design rows of a candidate's poses are added to those measured. With the prior they give the covariance and so the
//! position error over the workspace; without it they give the identifiable parameters. All rows are formed at one model, the
//! nominal geometry in its set-up, where the base set is chosen too.

mod candidates;

use std::mem::discriminant;

use nalgebra::DMatrix;

use crate::estimation::EstimationFinding;
use crate::estimation::result::{FurtherMeasurement, Recommendation};
use crate::estimation::{
    Calibration, Prior, Priors, Workspace, factor, inverse_root, is_place, order_of_choice, root_after,
    without_open_places,
};
use crate::math::{base_set, stacked};
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::{BallId, Coordinate, ParamId, Robot};
use candidates::Candidate;

/// A measurement that leaves more than this fraction of the error adds next to nothing.
const NOTHING: f64 = 0.97;

/// The calibration to which candidates are added.
struct Trial<'a> {
    robot: &'a Robot,
    /// The nominal geometry in its set-up.
    model: &'a LengthModel,
    /// The used lengths; an even sample of many.
    readings: Vec<PreparedMeasurement>,
    /// The unknown parameters, in canonical order.
    ids: &'a [ParamId],
    priors: &'a Priors,
    identified: Vec<ParamId>,
}

/// The measured rows, and the position error of a covariance.
struct Scale {
    /// The factor of the whitened rows of all lengths, and the root mean square of their standard deviations.
    rows: DMatrix<f64>,
    sigma_mm: f64,
    /// The mean of J'J over the Jacobians J of the workspace, mm^2.
    weight: DMatrix<f64>,
    /// Ratio of the mean position error to its root mean square.
    mean_of_rms: f64,
}

impl Scale {
    /// Mean position error with this root of the covariance, mm; further parameters do not move the tool ball.
    fn error_mm(&self, root: &DMatrix<f64>) -> f64 {
        let root = root.rows(0, self.weight.nrows());
        self.mean_of_rms * (&self.weight * root).dot(&root).sqrt()
    }
}

/// A candidate with the rows and the error after it.
struct Tried {
    candidate: Candidate,
    rows: DMatrix<f64>,
    error_mm: f64,
}

/// Further measurements that would lower the position error, best first. None if all parameters are identified, the position
/// is determined, and no lengths could separate dependent parameters.
///
/// # Errors
/// A predicted error is not finite.
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
    let prediction = &of.prediction;
    let jacobian = prediction.workspace.jacobian();
    let square = (jacobian * &prediction.before).norm_squared();
    let mean_of_rms = pair.nominal.mean / (3.0 * square / jacobian.nrows().max(1) as f64).sqrt();
    // A workspace of one or two poses has no error after the alignment.
    if !mean_of_rms.is_finite() {
        return Ok(Vec::new());
    }
    let lengths = estimate.used(&of.lengths);
    let poses = setting.options.workspace_poses(setting.robot);
    let workspace = Workspace::new(&trial.model.geometry, &poses, trial.ids);
    let jacobian = workspace.jacobian();
    let scale = Scale {
        rows: factor(trial.model, &lengths, trial.ids),
        sigma_mm: lengths.rms_sigma(),
        weight: jacobian.tr_mul(jacobian) / (jacobian.nrows() as f64 / 3.0).max(1.0),
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
        // A set-up that the lengths hardly determine may have diverged in the fit.
        let closed = without_open_places(priors, setting.start, &lengths, ids).unwrap_or_default();
        let is_determined = ids.iter().filter(|id| is_place(id)).all(|id| closed.contains(id));
        let model = if is_determined { &estimate.before } else { setting.start };
        let readings = lengths.used_sample().into_iter().map(|(reading, _)| reading).collect();
        Self { robot, model, readings, ids, priors, identified }
    }

    /// Whether lengths to the same balls from poses in the whole range of the robot have a higher rank.
    fn more_is_identifiable(&self, rank: usize) -> bool {
        let balls = self.model.balls.len();
        if balls == 0 {
            return false;
        }
        let count = 3 * self.ids.len() + 10;
        let axes = Workspace::uniform(self.robot.controller(), count, 1).into_iter().enumerate();
        let length = |(at, axes)| PreparedMeasurement::new(axes, BallId::at(at % balls), 0.0);
        let readings: Vec<PreparedMeasurement> = axes.map(length).collect();
        let mut columns = factor(self.model, readings.as_slice(), self.ids);
        for mut column in columns.column_iter_mut() {
            let norm = column.norm();
            column /= if norm < 1e-9 { f64::INFINITY } else { norm };
        }
        let pivots = columns.col_piv_qr().unpack_r().diagonal();
        pivots.iter().filter(|pivot| pivot.abs() > 1e-8 * pivots[0].abs()).count() > rank
    }

    /// The best of each kind whose error is below `before_mm`; `None` if a number is not finite.
    fn recommendations(&self, by: &Scale, prior: &Prior, before_mm: f64) -> Option<Vec<Recommendation>> {
        let now_mm = by.error_mm(&self.root(&by.rows)?);
        let identified_now = self.identified(&by.rows, self.ids)?;
        let needs_prior = *prior == Prior::None;
        // With a prior both errors are of the same estimator, apart from the drawn robots. If the fit is worse than the prior
        // allows, the error after a candidate is not increased by it.
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
        // Without a prior the two errors are of different estimators, and the prior alone may increase the error.
        recommendations.retain(|recommendation| recommendation.after_mm < recommendation.before_mm);
        Some(recommendations)
    }

    /// Sorted, best first.
    fn best_of_each_kind(&self, by: &Scale) -> Option<Vec<Tried>> {
        let mut best: Vec<Tried> = Vec::new();
        for candidate in candidates::all(self) {
            let rows = self.rows_with(&candidate, by);
            let error_mm = by.error_mm(&self.root(&rows)?);
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

    /// The parameters, including those of a candidate's further ball.
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

    /// The measured rows and those of a candidate; the columns of a further ball are last.
    fn rows_with(&self, candidate: &Candidate, by: &Scale) -> DMatrix<f64> {
        let ids = self.with_ball(candidate);
        let mut model = self.model.clone();
        model.balls.extend(candidate.ball);
        let sigma = vec![by.sigma_mm; candidate.poses.len()];
        let further = factor(&model, &(candidate.poses.as_slice(), sigma.as_slice()), &ids);
        stacked(&by.rows.clone().resize_horizontally(ids.len(), 0.0), &further)
    }

    /// The root of the posterior covariance after whitened rows. Further columns belong to a further ball, which has the prior
    /// of any ball.
    fn root(&self, rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let further = ParamId::Ball(self.further_ball(), Coordinate::X);
        let ids: Vec<ParamId> =
            self.ids.iter().copied().chain(std::iter::repeat(further)).take(rows.ncols()).collect();
        let sd: Vec<f64> = ids.iter().map(|id| self.priors.sd(*id)).collect();
        root_after(&self.priors.root(&ids, &sd), rows)
    }

    /// The parameters that whitened rows identify without a prior.
    fn identified(&self, rows: &DMatrix<f64>, ids: &[ParamId]) -> Option<Vec<ParamId>> {
        let triangle = rows.clone().qr().r();
        let set = base_set(&triangle, &order_of_choice(ids))?;
        let Some(inverse) = inverse_root(&triangle.select_columns(&set.kept)) else {
            return Some(Vec::new());
        };
        let kept = set.kept.iter().map(|k| ids[*k]).enumerate();
        let identified = kept.filter(|(row, id)| inverse.row(*row).norm() <= self.priors.weak_limit(*id));
        Some(identified.map(|(_, id)| id).collect())
    }
}
