//! Which further measurement would tell most: candidates are tried, not judged by rule.
//!
//! The rows that a candidate's poses would add are stacked on those measured, with what is known
//! beforehand; the 3-D error that is left over the workspace follows from the covariance, and from the
//! stacked rows alone which parameters the lengths would tell. All of it is taken at one model, the nominal
//! geometry in its set-up, where ranks are taken.

mod candidates;
mod words;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::Workspace;
use super::analysis::{factor, order_of_choice};
use super::belief::known_beforehand;
use crate::linalg::base_set;
use crate::model::{LengthModel, ParamId, Reading, Robot};
use candidates::Candidate;

/// A parameter of which lengths alone leave more than this many of its standard deviations before is not told.
const WEAK: f64 = 3.0;

/// What is measured, and of what.
pub struct Measured<'a> {
    /// The robot: limits, reach, tolerance.
    pub robot: &'a Robot,
    /// The nominal geometry in its set-up.
    pub model: &'a LengthModel,
    /// The lengths there are, or an even sample of many.
    pub readings: &'a [Reading],
    /// What is unknown, in canonical order.
    pub ids: &'a [ParamId],
    /// One standard deviation of each as known beforehand, mm or rad.
    pub known: &'a [f64],
}

/// The kinds of further measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// No further pose: the tolerance of the robot's file as prior.
    Prior,
    /// Circles in other planes about the same ball.
    Circle,
    /// Poses measured again with the wrist turned more.
    Wrist,
    /// A ball at another distance from axis 1 and another height.
    Ball,
    /// The same poses and ball, turned about axis 1.
    TurnedBall,
    /// Another length of the bar.
    Bar,
}

/// A further measurement, and what it would do.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// Its kind; of each only the best is proposed.
    pub kind: Kind,
    /// In words, such as `a further ball at (900, 600, 500) mm, 20 poses`.
    pub what: String,
    /// Lengths to be measured.
    pub poses: usize,
    /// Where a further ball would stand in the robot base, mm.
    pub ball_mm: Option<[f64; 3]>,
    /// Predicted mean 3-D error afterwards, mm.
    pub error_mm: f64,
    /// Parameters that the lengths would then tell, and do not now.
    pub tells: Vec<ParamId>,
}

impl Measured<'_> {
    /// Whether poses all over the robot's reach, to the same balls, would tell more directions than these do.
    /// What remains dependent then, no lengths tell.
    pub fn more_can_be_told(&self, rank: usize) -> bool {
        let balls = self.model.centres.len().max(1);
        let count = 3 * self.ids.len() + 10;
        let readings: Vec<Reading> = Workspace::uniform(self.robot.controller(), count, 1)
            .into_iter()
            .enumerate()
            .map(|(at, axes)| Reading::new(axes, at % balls, 0.0))
            .collect();
        let mut columns = factor(self.model, readings.as_slice(), self.ids);
        columns.column_iter_mut().for_each(|mut column| {
            let norm = column.norm();
            column /= if norm < 1e-9 { f64::INFINITY } else { norm };
        });
        let pivots = columns.col_piv_qr().unpack_r().diagonal();
        pivots.iter().filter(|pivot| pivot.abs() > 1e-8 * pivots[0].abs()).count() > rank
    }

    /// The best of each kind of further measurement, best first. `workspace` is where the error counts; `mean_of_rms`
    /// makes a mean error of a root mean square. `told` are the parameters that count as told now. `factor` is that of
    /// the weighted Jacobian of all lengths, whose standard deviation is `sigma_mm`. The first number is the error that
    /// these lengths leave by the same measure, mm. `None` when a number is not finite.
    pub fn proposals(
        &self,
        (factor, sigma_mm): (&DMatrix<f64>, f64),
        workspace: &Workspace,
        mean_of_rms: f64,
        told: &[ParamId],
    ) -> Option<(f64, Vec<Proposal>)> {
        let weight = self.weight(workspace);
        let now_mm = mean_of_rms * rms(&self.root(factor)?, &weight);
        let told_now = self.told(factor, self.ids)?;
        let mut best: Vec<(Candidate, DMatrix<f64>, f64)> = Vec::new();
        for candidate in candidates::all(self) {
            let stacked = self.stacked(factor, &candidate, sigma_mm);
            let error_mm = mean_of_rms * rms(&self.root(&stacked)?, &weight);
            match best.iter_mut().find(|(other, ..)| other.kind == candidate.kind) {
                Some(other) if error_mm < other.2 => *other = (candidate, stacked, error_mm),
                Some(_) => {}
                None => best.push((candidate, stacked, error_mm)),
            }
        }
        best.sort_by(|(.., a), (.., b)| a.total_cmp(b));
        let mut proposals = Vec::new();
        for (candidate, stacked, error_mm) in best {
            let ids = self.with_ball(candidate.ball.is_some());
            let mut tells = self.told(&stacked, &ids)?;
            tells.retain(|id| !told.contains(id) && !told_now.contains(id) && self.ids.contains(id));
            proposals.push(Proposal {
                kind: candidate.kind,
                what: words::what(&candidate),
                poses: candidate.poses.len(),
                ball_mm: candidate.ball.map(Into::into),
                error_mm,
                tells,
            });
        }
        Some((now_mm, proposals))
    }

    /// The parameters, with those of one ball more where there is one.
    fn with_ball(&self, further: bool) -> Vec<ParamId> {
        let mut ids = self.ids.to_vec();
        if further {
            let number = self.model.centres.len() + 1;
            ids.extend((0..3).map(|axis| ParamId::Centre(number, axis)));
        }
        ids
    }

    /// Mean over the workspace of what each pair of parameters moves, mm^2; that of a further ball is none.
    fn weight(&self, workspace: &Workspace) -> DMatrix<f64> {
        let place = |id| workspace.ids().iter().position(|other| other == id);
        let places: Vec<Option<usize>> = self.ids.iter().map(place).collect();
        let jacobian = workspace.jacobian();
        let mut moves = DMatrix::zeros(jacobian.nrows(), places.len());
        for (mut column, place) in moves.column_iter_mut().zip(&places) {
            if let Some(place) = place {
                column.copy_from(&jacobian.column(*place));
            }
        }
        moves.tr_mul(&moves) / (jacobian.nrows() as f64 / 3.0).max(1.0)
    }

    /// The factor with the rows of a candidate under it, each over `sigma`; columns of a further ball at the end.
    fn stacked(&self, factor: &DMatrix<f64>, candidate: &Candidate, sigma: f64) -> DMatrix<f64> {
        let ids = self.with_ball(candidate.ball.is_some());
        let mut model = self.model.clone();
        model.centres.extend(candidate.ball);
        let sigmas = vec![sigma; candidate.poses.len()];
        let further = self::factor(&model, &(candidate.poses.as_slice(), sigmas.as_slice()), &ids);
        let mut stacked = DMatrix::zeros(factor.nrows() + further.nrows(), ids.len());
        stacked.view_mut((0, 0), factor.shape()).copy_from(factor);
        stacked.rows_mut(factor.nrows(), further.nrows()).copy_from(&further);
        stacked
    }

    /// The root of the covariance that weighted rows leave of what is known beforehand; columns beyond the known
    /// ones are a further ball's, which is known as any is that was taught.
    fn root(&self, rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let n = rows.ncols();
        let taught = known_beforehand(self.robot, ParamId::Centre(1, 0), None);
        let sd = DVector::from_fn(n, |at, _| self.known.get(at).copied().unwrap_or(taught));
        let mut scaled = DMatrix::identity(n + rows.nrows(), n);
        scaled.rows_mut(n, rows.nrows()).copy_from(rows);
        for (mut column, sd) in scaled.column_iter_mut().zip(&sd) {
            column.rows_range_mut(n..).scale_mut(*sd);
        }
        let mut root = scaled.qr().r().try_inverse()?;
        root.row_iter_mut().zip(&sd).for_each(|(mut row, sd)| row *= *sd);
        root.iter().all(|x| x.is_finite()).then_some(root)
    }

    /// The parameters that weighted rows alone tell to three times what is known of them beforehand.
    fn told(&self, rows: &DMatrix<f64>, ids: &[ParamId]) -> Option<Vec<ParamId>> {
        let triangle = rows.clone().qr().r();
        let set = base_set(&triangle, &order_of_choice(ids))?;
        let mut kept = triangle.select_columns(&set.kept);
        let norms: Vec<f64> = kept.column_iter().map(|column| column.norm()).collect();
        kept.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
        let Some(inverse) = kept.qr().r().try_inverse() else { return Some(Vec::new()) };
        let told = set.kept.iter().enumerate().filter(|(place, k)| {
            let limit = match ids[**k] {
                ParamId::Tool(_) | ParamId::Centre(..) => f64::INFINITY,
                id => WEAK * known_beforehand(self.robot, id, None),
            };
            inverse.row(*place).norm() / norms[*place] <= limit
        });
        Some(told.map(|(_, k)| ids[*k]).collect())
    }
}

/// Root mean square of the 3-D error over the workspace of `weight`, of errors with this root of their covariance;
/// parameters beyond those of the weight move nothing.
fn rms(root: &DMatrix<f64>, weight: &DMatrix<f64>) -> f64 {
    let root = root.rows(0, weight.nrows());
    (weight * root).dot(&root).sqrt()
}
