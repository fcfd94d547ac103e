//! The predicted position uncertainty of the tool ball over a workspace, before and after the lengths.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::estimator::Estimate;
use super::lengths::Lengths;
use super::options::Setting;
use super::position::{BallMotion, Positions, compressed};
use super::priors::Prior;
use super::result::{MapPoint, PredictedPair};
use super::selection::is_bar;
use super::workspace::{ErrorSummary, Workspace, take_out_rigid_motion};
use crate::measurement::{ApproachedPose, PreparedMeasurement};
use crate::robot::{AXES, Approach, AxisAngles, ParamId, RobotPosterior, RobotUncertainty};

/// Robots that are drawn.
const ROBOTS: usize = 100;
/// Poses of the workspace, and as many of those measured, by which the uncertainty is compressed.
const COMPRESSING: usize = 150;
/// The predicted error of the identified robot must be at most this fraction of that by the manufacturer's tolerance.
const BETTER: f64 = 0.5;

/// Contributions to the position error of the identified robot: root mean square over robots and poses, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionParts {
    /// The error of the bar's length.
    pub bar_mm: f64,
    /// The noise of the lengths.
    pub noise_mm: f64,
    /// Backlash, where no sense of approach is known.
    pub backlash_mm: f64,
}

/// The predicted position uncertainty of the nominal and the identified robot.
pub(crate) struct Prediction {
    pub(crate) pair: PredictedPair,
    pub(super) parts: PositionParts,
    pub(super) map: Vec<MapPoint>,
    /// Of the robot by its manufacturer's tolerance, independent of an earlier identification.
    pub(super) maker: ErrorSummary,
    /// What is not known of the identified robot, for its file.
    pub(crate) uncertainty: RobotUncertainty,
    /// The posterior of the identified robot.
    pub(super) posterior: Option<RobotPosterior>,
}

impl Prediction {
    pub(super) fn of(setting: &Setting<'_>, estimate: &Estimate, lengths: &Lengths) -> Self {
        let model = &estimate.fit.model;
        let axes = setting.options.workspace_poses(setting.robot);
        let poses: Vec<ApproachedPose> = axes.iter().map(unapproached).collect();
        let some = |poses: &[ApproachedPose]| -> Vec<ApproachedPose> {
            poses.iter().step_by(poses.len().div_ceil(COMPRESSING).max(1)).copied().collect()
        };
        let measured = (0..lengths.len()).step_by(lengths.len().div_ceil(COMPRESSING).max(1));
        let measured: Vec<ApproachedPose> = measured.map(|at| measured_pose(&lengths.reading(at))).collect();
        let own = estimate.uncertainty(setting.robot);
        let uncertainty = compressed(model, &own, &[some(&poses), measured].concat());
        let (whole, unknown) = match &estimate.left_out {
            Some(left_out) => (&left_out.whole, &left_out.uncertainty),
            None => (&model.geometry, &own),
        };
        let positions = Positions::new(whole, unknown, &poses, &[]);
        let mut moved = positions.draws(ROBOTS, unexplained_mm(setting, estimate, lengths));
        if let Some(left_out) = &estimate.left_out {
            let poses: Vec<_> = axes.iter().map(|axes| (*axes, Approach::default())).collect();
            let off = left_out.displacements(&model.geometry, &poses);
            moved.column_iter_mut().for_each(|mut robot| robot += &off);
        }
        let rms = |pose: usize| (moved.rows(3 * pose, 3).norm_squared() / ROBOTS as f64).sqrt();
        let point =
            |(pose, ball): (usize, &nalgebra::Vector3<f64>)| MapPoint { position: *ball, rms_mm: rms(pose) };
        let (nominal, maker) = nominal(setting, estimate, &axes);
        Self {
            pair: PredictedPair { nominal, identified: ErrorSummary::of(&moved) },
            parts: parts(estimate, &axes),
            map: positions.balls.iter().enumerate().map(point).collect(),
            maker,
            posterior: robot_posterior(estimate),
            uncertainty,
        }
    }

    /// Whether the identified robot is predicted to be clearly better than the manufacturer's tolerance.
    pub(crate) fn is_determined(&self) -> bool {
        self.pair.identified.mean <= BETTER * self.maker.mean
    }
}

/// Of the robot before the lengths, and of one by its manufacturer's tolerance.
fn nominal(setting: &Setting<'_>, estimate: &Estimate, axes: &[[f64; AXES]]) -> (ErrorSummary, ErrorSummary) {
    let ids: Vec<ParamId> = setting.all_and(estimate.before.balls.len().into(), &[]);
    let ids: Vec<ParamId> = ids.into_iter().filter(|id| id.is_geometric()).collect();
    let workspace = Workspace::new(&estimate.fit.model.geometry, axes, &ids);
    let summary = |root: DMatrix<f64>| {
        let draws = unit_draws(root.ncols());
        ErrorSummary::of(&workspace.displacements(&(root * draws)))
    };
    let tolerances = ids.iter().map(|id| setting.priors.geometric(*id).unwrap_or(0.0));
    let maker = summary(DMatrix::from_diagonal(&DVector::from_iterator(ids.len(), tolerances)));
    let before = match setting.options.prior {
        Prior::Posterior => {
            let known = setting.robot.known_uncertainty();
            let poses: Vec<ApproachedPose> = axes.iter().map(unapproached).collect();
            let positions = Positions::new(&setting.start.geometry, &known, &poses, &[]);
            ErrorSummary::of(&positions.draws(ROBOTS, 0.0))
        }
        Prior::Given(_) => {
            let sds: Vec<f64> = ids.iter().map(|id| setting.priors.bound(*id).unwrap_or(0.0)).collect();
            summary(setting.priors.root(&ids, &sds))
        }
        Prior::None | Prior::Datasheet => maker,
    };
    (before, maker)
}

/// The posterior is C = root root'. What a bar's error shares with the positions is its part; of the noise it is
/// C A' A C = C - C P C, with A the whitened rows and P the precision of the prior.
fn parts(estimate: &Estimate, axes: &[[f64; AXES]]) -> PositionParts {
    let Estimate { kept, root, fit, .. } = estimate;
    let is_own = |id: ParamId| id.moves_tool_ball();
    let own: Vec<usize> = (0..kept.len()).filter(|&k| is_own(kept[k])).collect();
    let ids: Vec<ParamId> = own.iter().map(|&k| kept[k]).collect();
    let rows: Vec<usize> = own.iter().copied().chain(kept.len()..root.nrows()).collect();
    let some: Vec<([f64; AXES], Approach)> = axes
        .iter()
        .step_by(axes.len().div_ceil(COMPRESSING).max(1))
        .map(|axes| (*axes, Approach::default()))
        .collect();
    let BallMotion { jacobian, balls, levers } = BallMotion::new(&fit.model.geometry, &some, &ids);
    let mut moved = jacobian * root.select_rows(&rows);
    take_out_rigid_motion(&mut moved, &balls);
    let rms = |square: f64| (square.max(0.0) / balls.len().max(1) as f64).sqrt();
    let bars = (0..kept.len()).filter(|&k| is_bar(&kept[k])).map(|k| root.row(k).transpose());
    let bar: f64 =
        bars.filter(|row| row.norm() > 0.0).map(|row| (&moved * row.normalize()).norm_squared()).sum();
    let by_prior = (&moved * &estimate.of_prior).norm_squared();
    let unapproached = estimate.unapproached_rad;
    let backlash = levers.iter().flatten().zip(unapproached.iter().cycle());
    let backlash: f64 = backlash.map(|(lever, rad)| lever.norm_squared() * rad * rad).sum();
    PositionParts {
        bar_mm: rms(bar),
        noise_mm: rms(moved.norm_squared() - by_prior),
        backlash_mm: rms(backlash),
    }
}

/// The posterior of the parameters of the robot and of the base balls.
fn robot_posterior(estimate: &Estimate) -> Option<RobotPosterior> {
    let Estimate { kept, root, fit, .. } = estimate;
    let is_own = |id: ParamId| id.is_geometric() || matches!(id, ParamId::Tool(_) | ParamId::Ball(..));
    let own: Vec<usize> = (0..kept.len()).filter(|&k| is_own(kept[k])).collect();
    let ids: Vec<ParamId> = own.iter().map(|&k| kept[k]).collect();
    RobotPosterior::with_balls(&ids, &fit.model.geometry, &fit.model.balls, &root.select_rows(&own))
}

fn measured_pose(reading: &PreparedMeasurement) -> ApproachedPose {
    ApproachedPose {
        axes: AxisAngles::from_degrees(reading.axes.map(f64::to_degrees)),
        approach: reading.approach,
    }
}

fn unapproached(axes: &[f64; AXES]) -> ApproachedPose {
    ApproachedPose {
        axes: AxisAngles::from_degrees(axes.map(f64::to_degrees)),
        approach: Approach::default(),
    }
}

/// What the lengths scatter beyond what is given of them and of the robot's repeatability, mm: it is of the robot, such
/// as backlash where the sense of approach is not known.
fn unexplained_mm(setting: &Setting<'_>, estimate: &Estimate, lengths: &Lengths) -> f64 {
    if !lengths.known || lengths.vouched {
        return 0.0;
    }
    let given = lengths.weighted(super::lengths::Sigma::Given, &[]).rms_sigma();
    let repeatability = setting.robot.repeatability_sd_mm().unwrap_or(0.0);
    let square = estimate.noise.sigma_mm().powi(2) - given.powi(2) - repeatability.powi(2);
    square.max(0.0).sqrt().min(estimate.noise.pose_mm)
}

/// Standard normal numbers, a column a robot, from seed 1, scaled to unit covariance: the sample covariance of so few robots
/// could be wrong by a tenth in one direction.
pub(super) fn unit_draws(rows: usize) -> DMatrix<f64> {
    let mut random = Pcg64::seed_from_u64(1);
    let robots = ROBOTS.max(rows);
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
}
