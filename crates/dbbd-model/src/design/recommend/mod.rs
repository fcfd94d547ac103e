//! Recommendations of further measurements, by simulation of candidates.
//!
//! The design rows of a candidate's poses are added to the posterior: the covariance after them gives the position error over
//! the workspace. With the rows measured they give the identifiable parameters, at the nominal geometry in its set-up, where the
//! base set is chosen too.

mod candidates;

use std::mem::discriminant;

use nalgebra::DMatrix;

use crate::estimation::EstimationFinding;
use crate::estimation::result::Recommendation;
use crate::estimation::{
    Calibration, Posterior, Priors, Workspace, factor, inverse_root, is_place, order_of_choice,
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

/// The posterior to which candidates are added, and the rows measured.
struct Measured {
    posterior: Posterior,
    /// The factor of the whitened rows of all lengths, and the root mean square of their standard deviations.
    rows: DMatrix<f64>,
    sigma_mm: f64,
    /// The Jacobian of the workspace by the parameters and coefficients of the posterior.
    jacobian: DMatrix<f64>,
}

impl Measured {
    /// Root mean square of the position error, up to a factor; a further ball does not move the tool ball.
    fn error(&self, posterior: &Posterior) -> f64 {
        let ids = self.posterior.ids().len();
        let further = posterior.ids().len() - ids;
        let rows: Vec<usize> =
            (0..posterior.root().nrows()).filter(|row| !(ids..ids + further).contains(row)).collect();
        (&self.jacobian * posterior.root().select_rows(&rows)).norm()
    }
}

/// A candidate with the rows and the error after it.
struct Tried {
    candidate: Candidate,
    rows: DMatrix<f64>,
    error: f64,
}

/// Further measurements that would lower the position error, best first. None if all parameters are identified, the position
/// is determined, and no lengths could separate dependent parameters.
///
/// # Errors
/// A predicted uncertainty is not finite.
pub fn recommend(of: &Calibration<'_>) -> Result<Vec<Recommendation>, EstimationFinding> {
    let (setting, estimate, pair) = (&of.setting, &of.estimate, &of.prediction.pair);
    let identified = of.identified();
    let all_identified = estimate.open.is_empty() && estimate.base.iter().all(|id| identified.contains(id));
    let trial = Trial::of(of, identified);
    if all_identified
        && of.prediction.is_determined()
        && !trial.more_is_identifiable(estimate.analysis.base.rank)
    {
        return Ok(Vec::new());
    }
    let lengths = estimate.used(&of.lengths);
    let posterior = of.posterior();
    let poses = setting.options.workspace_poses(setting.robot);
    let poses: Vec<_> = poses.iter().step_by(poses.len().div_ceil(POSES)).copied().collect();
    let workspace = Workspace::with_joint_errors(&posterior.model.geometry, &poses, posterior.ids());
    let measured = Measured {
        rows: factor(trial.model, &lengths, trial.ids),
        sigma_mm: lengths.rms_sigma(),
        jacobian: workspace.jacobian().clone(),
        posterior,
    };
    // A workspace of one or two poses has no error after the alignment.
    if measured.error(&measured.posterior) <= 0.0 {
        return Ok(Vec::new());
    }
    trial.recommendations(&measured, pair.identified.mean).ok_or(EstimationFinding::NoRecommendation)
}

/// Poses of the workspace by which candidates are compared.
const POSES: usize = 200;

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

    /// The best candidate of each kind that lowers the error; `None` if a number is not finite.
    fn recommendations(&self, by: &Measured, before_mm: f64) -> Option<Vec<Recommendation>> {
        let now = by.error(&by.posterior);
        let identified_now = self.identified(&by.rows, self.ids)?;
        let mut recommendations = Vec::new();
        for Tried { candidate, rows, error } in self.best_of_each_kind(by)? {
            let mut identifies = self.identified(&rows, &self.with_ball(&candidate))?;
            identifies.retain(|id| {
                !self.identified.contains(id) && !identified_now.contains(id) && self.ids.contains(id)
            });
            recommendations.push(Recommendation {
                measure: candidate.measure,
                poses: candidate.poses.len(),
                before_mm,
                after_mm: before_mm * error / now,
                adds: error < NOTHING * now,
                identifies,
            });
        }
        Some(recommendations)
    }

    /// The best candidate of each kind, best first.
    fn best_of_each_kind(&self, by: &Measured) -> Option<Vec<Tried>> {
        let mut best: Vec<Tried> = Vec::new();
        for candidate in candidates::all(self) {
            let rows = self.rows_with(&candidate, by);
            let prior = match candidate.ball {
                Some(ball) => by.posterior.with_ball(ball),
                None => by.posterior.clone(),
            };
            let error = by.error(&prior.after(&candidate.poses, by.sigma_mm)?);
            if !error.is_finite() {
                return None;
            }
            let kind = discriminant(&candidate.measure);
            let tried = Tried { candidate, rows, error };
            match best.iter_mut().find(|other| discriminant(&other.candidate.measure) == kind) {
                Some(other) if error < other.error => *other = tried,
                Some(_) => {}
                None => best.push(tried),
            }
        }
        best.sort_by(|a, b| a.error.total_cmp(&b.error));
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

    /// The measured rows and the rows of a candidate; the columns of a further ball are last.
    fn rows_with(&self, candidate: &Candidate, by: &Measured) -> DMatrix<f64> {
        let ids = self.with_ball(candidate);
        let mut model = self.model.clone();
        model.balls.extend(candidate.ball);
        let sigma = vec![by.sigma_mm; candidate.poses.len()];
        let further = factor(&model, &(candidate.poses.as_slice(), sigma.as_slice()), &ids);
        stacked(&by.rows.clone().resize_horizontally(ids.len(), 0.0), &further)
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
