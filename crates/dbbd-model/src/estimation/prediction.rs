//! The predicted position uncertainty of the tool ball over a workspace, before and after the lengths.

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::ball_motion::BallMotion;
use super::estimator::Estimate;
use super::hyper_parameters::{Group, Hypers};
use super::lengths::Lengths;
use super::options::Setting;
use super::position::{CompressingPoses, Orientations, Positions, compressed};
use super::priors::{Prior, Priors};
use super::result::{MapPoint, PositionParts, PredictedPair};
use super::selection::is_bar;
use super::workspace::{ErrorSummary, take_out_rigid_motion};
use crate::measurement::{ApproachedPose, LengthModel, PreparedMeasurement};
use crate::robot::{
    AXES, Approach, AxisAngles, Drift, Geometry, Joint, ParamId, Robot, RobotPosterior, RobotUncertainty,
    ZeroSteps, parameter,
};

/// Number of poses of the workspace, and of measured poses, for which the uncertainty is compressed.
const COMPRESSING: usize = 150;
/// The predicted uncertainty of the identified robot must be at most this fraction of the predicted uncertainty with the
/// manufacturer's tolerance.
const BETTER: f64 = 0.5;

/// The predicted position uncertainty of the nominal and the identified robot.
pub(crate) struct Prediction {
    pub(crate) pair: PredictedPair,
    /// The predicted orientation uncertainty of the flange, mrad.
    pub(super) orientation: PredictedPair,
    pub(super) parts: PositionParts,
    pub(super) map: Vec<MapPoint>,
    /// Predicted position uncertainty of the robot with its manufacturer's tolerance, independent of an earlier
    /// identification.
    pub(super) maker: ErrorSummary,
    /// The uncertainty of the identified robot, for its file.
    pub(crate) uncertainty: RobotUncertainty,
    /// The posterior of the identified robot.
    pub(super) posterior: Option<RobotPosterior>,
}

/// The predicted positions of the identified robot over the workspace.
pub(super) struct IdentifiedPositions {
    /// The uncertainty of the identified robot, for its file.
    uncertainty: RobotUncertainty,
    /// The robot with all its errors, and its uncertainty.
    whole: Geometry,
    of_whole: RobotUncertainty,
    pub(super) summary: ErrorSummary,
    pub(super) map: Vec<MapPoint>,
}

impl IdentifiedPositions {
    /// With the uncertainty as the robot's file will have it, over the workspace of the options.
    pub(super) fn of(setting: &Setting<'_>, estimate: &Estimate, lengths: &Lengths) -> Self {
        let model = &estimate.fit.model;
        let axes = setting.options.workspace_poses(setting.robot);
        let poses: Vec<ApproachedPose> = axes.iter().map(ApproachedPose::unapproached).collect();
        let by = compressing_poses(&axes, lengths);
        // What a result states is what its robot file says later.
        let unexplained_mm = unexplained_mm(setting, estimate, lengths);
        let uncertainty = estimate.uncertainty(setting.robot);
        // A file of the geometry alone has what it leaves out as scatter of its poses.
        let with_left_out_mm = unexplained_mm.hypot(uncertainty.unexplained_mm);
        let uncertainty = RobotUncertainty { unexplained_mm: with_left_out_mm, ..uncertainty };
        let uncertainty = compressed(model, &uncertainty, &by).with_digits_of_file();
        let (whole, of_whole) = match &estimate.left_out {
            Some(left_out) => {
                let whole = LengthModel { geometry: left_out.whole.clone(), ..model.clone() };
                let of_whole = RobotUncertainty { unexplained_mm, ..left_out.uncertainty.clone() };
                let of_whole = compressed(&whole, &of_whole, &by);
                (whole.geometry, of_whole)
            }
            None => (model.geometry.clone(), uncertainty.clone()),
        };
        let positions = Positions::new(&whole, &of_whole, &poses);
        let mut moved = positions.stated_errors();
        if let Some(left_out) = &estimate.left_out {
            let poses: Vec<_> = axes.iter().map(|axes| (*axes, Approach::default())).collect();
            let off = left_out.displacements(&model.geometry, &poses);
            moved.column_iter_mut().for_each(|mut robot| robot += &off);
        }
        let map = MapPoint::map(&positions.balls, &moved);
        Self { uncertainty, whole, of_whole, summary: ErrorSummary::of(&moved), map }
    }
}

/// The predicted position uncertainty over the workspace before any length, mm.
pub(super) fn position_before(setting: &Setting<'_>) -> ErrorSummary {
    let axes = setting.options.workspace_poses(setting.robot);
    let poses: Vec<ApproachedPose> = axes.iter().map(ApproachedPose::unapproached).collect();
    Before::of(setting, &poses).nominal
}

impl Prediction {
    pub(super) fn of(setting: &Setting<'_>, estimate: &Estimate, lengths: &Lengths) -> Self {
        let identified = IdentifiedPositions::of(setting, estimate, lengths);
        let IdentifiedPositions { uncertainty, whole, of_whole, summary, map } = identified;
        let axes = setting.options.workspace_poses(setting.robot);
        let poses: Vec<ApproachedPose> = axes.iter().map(ApproachedPose::unapproached).collect();
        let of_workspace: Vec<ApproachedPose> = thinned(poses.len()).map(|at| poses[at]).collect();
        let Before { start: (start, of_start), nominal, maker } = Before::of(setting, &poses);
        let turned = |geometry: &Geometry, unknown: &RobotUncertainty| {
            Orientations::new(geometry, unknown, setting.robot.reach_mm(), &of_workspace).summary_mrad()
        };
        let orientation =
            PredictedPair { nominal: turned(&start, &of_start), identified: turned(&whole, &of_whole) };
        Self {
            pair: PredictedPair { nominal, identified: summary },
            orientation,
            parts: parts(estimate, &axes),
            map,
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

/// The robot before the lengths.
struct Before {
    start: (Geometry, RobotUncertainty),
    /// Its predicted position uncertainty, and that of a robot with its manufacturer's tolerance.
    nominal: ErrorSummary,
    maker: ErrorSummary,
}

impl Before {
    fn of(setting: &Setting<'_>, poses: &[ApproachedPose]) -> Self {
        let geometry = &setting.start.geometry;
        let ids = setting.all_and(0.into(), &[]);
        let ids: Vec<ParamId> = ids.into_iter().filter(|id| id.is_geometric()).collect();
        let has_errors = !setting.options.follows_list();
        let of_usual =
            |root: &DMatrix<f64>| (geometry.rigid(), with_usual_joint_errors(&ids, root, has_errors));
        let of_maker = of_usual(&tolerances(&ids, &setting.priors));
        let maker = Positions::new(&of_maker.0, &of_maker.1, poses).summary();
        let start = match setting.options.prior {
            Prior::Posterior => (geometry.clone(), setting.robot.known_uncertainty()),
            Prior::Given(_) => {
                let sds: Vec<f64> = ids.iter().map(|id| setting.priors.bound(*id).unwrap_or(0.0)).collect();
                of_usual(&setting.priors.root(&ids, &sds))
            }
            Prior::None | Prior::Datasheet => return Self { start: of_maker, nominal: maker, maker },
        };
        Self { nominal: Positions::new(&start.0, &start.1, poses).summary(), start, maker }
    }
}

/// The root of the covariance of parameters that are known to the maker's tolerance.
fn tolerances(ids: &[ParamId], priors: &Priors) -> DMatrix<f64> {
    let tolerances = ids.iter().map(|id| priors.geometric(*id).unwrap_or(0.0));
    DMatrix::from_diagonal(&DVector::from_iterator(ids.len(), tolerances))
}

/// The predicted position errors over axis angles (rad) of a robot that is as its maker promises, mm.
pub fn of_maker(robot: &Robot, axes: &[[f64; AXES]]) -> ErrorSummary {
    let ids: Vec<ParamId> = robot.posterior.iter().flat_map(|known| known.ids().iter().copied()).collect();
    let ids: Vec<ParamId> = ids.into_iter().filter(|id| id.is_geometric()).collect();
    let unknown = with_usual_joint_errors(&ids, &tolerances(&ids, &Priors::datasheet(robot, None)), true);
    let poses: Vec<ApproachedPose> = axes.iter().map(ApproachedPose::unapproached).collect();
    Positions::new(&robot.geometry.rigid(), &unknown, &poses).summary()
}

/// The uncertainty of a robot whose geometry has this root of its covariance, with the usual errors of joints. If the
/// user gave a list of parameters, there are no errors of joints, neither before nor after the estimate.
fn with_usual_joint_errors(ids: &[ParamId], root: &DMatrix<f64>, has_errors: bool) -> RobotUncertainty {
    if !has_errors {
        return RobotUncertainty::of_root(ids.to_vec(), root.clone());
    }
    let (usual, own) = (Hypers::usual(), ids.len());
    let harmonics: Vec<ParamId> = parameter::gear().collect();
    let all = own + harmonics.len();
    let mut whole = root.clone().resize(all, all, 0.0);
    (own..all).for_each(|at| whole[(at, at)] = usual.sd(Group::Harmonic));
    RobotUncertainty {
        smooth: usual.processes().to_vec(),
        smooth_of_joints: usual.of_joints(),
        unapproached_rad: [usual.sd(Group::Backlash); AXES],
        ..RobotUncertainty::of_root([ids, &harmonics].concat(), whole)
    }
}

/// The posterior is C = root root'. The part of a bar is the covariance of its error with the positions. The part of
/// the noise is C A' A C = C - C P C, with A the whitened rows and P the precision of the prior.
fn parts(estimate: &Estimate, axes: &[[f64; AXES]]) -> PositionParts {
    let Estimate { kept, root, fit, .. } = estimate;
    let is_own = |id: ParamId| id.moves_tool_ball();
    let own: Vec<usize> = (0..kept.len()).filter(|&k| is_own(kept[k])).collect();
    let ids: Vec<ParamId> = own.iter().map(|&k| kept[k]).collect();
    let rows: Vec<usize> = own.iter().copied().chain(kept.len()..root.nrows()).collect();
    let some: Vec<_> = thinned(axes.len()).map(|at| (axes[at], Approach::default())).collect();
    let BallMotion { jacobian, balls, by_joint } = BallMotion::new(&fit.model.geometry, &some, &ids);
    let mut moved = jacobian * root.select_rows(&rows);
    take_out_rigid_motion(&mut moved, &balls);
    let rms = |square: f64| (square.max(0.0) / balls.len().max(1) as f64).sqrt();
    let bars = (0..kept.len()).filter(|&k| is_bar(&kept[k])).map(|k| root.row(k).transpose());
    let bar: f64 =
        bars.filter(|row| row.norm() > 0.0).map(|row| (&moved * row.normalize()).norm_squared()).sum();
    let by_prior = (&moved * &estimate.of_prior).norm_squared();
    let unapproached = estimate.unapproached_rad;
    let backlash = by_joint.iter().flatten().zip(unapproached.iter().cycle());
    let backlash: f64 = backlash.map(|(by_angle, rad)| by_angle.norm_squared() * rad * rad).sum();
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

/// The drift of the zeros, learnt from their steps since the estimate whose posterior is the prior of this one.
pub(super) fn drift_after(setting: &Setting<'_>, estimate: &Estimate) -> Drift {
    let before = setting.robot.drift;
    let known = setting.robot.posterior.as_ref().filter(|_| setting.options.prior == Prior::Posterior);
    let Some(known) = known.filter(|_| before.has_waited()) else { return before };
    let Estimate { kept, root, fit, .. } = estimate;
    let own: Vec<usize> = (0..kept.len()).filter(|&k| known.ids().contains(&kept[k])).collect();
    let ids: Vec<ParamId> = own.iter().map(|&k| kept[k]).collect();
    let moved = ids.iter().map(|id| fit.model.value(*id) - setting.start.value(*id));
    let moved = DVector::from_iterator(ids.len(), moved);
    let zeros = Joint::ALL.map(|joint| ids.iter().position(|id| *id == ParamId::Theta(joint)));
    let steps = ZeroSteps::of(&known.root_of(&ids), zeros, &root.select_rows(&own), &moved);
    steps.map_or(before, |steps| before.after(&steps))
}

/// The poses for which an uncertainty is compressed: some of the workspace, and some that were measured.
pub(super) fn compressing_poses(axes: &[[f64; AXES]], lengths: &Lengths) -> CompressingPoses {
    CompressingPoses {
        workspace: thinned(axes.len()).map(|at| ApproachedPose::unapproached(&axes[at])).collect(),
        measured: thinned(lengths.len()).map(|at| measured_pose(&lengths.reading(at))).collect(),
        between: poses_between(lengths),
    }
}

/// Poses among those that were measured, and at most as many: each angle lies anywhere between the angles of two of them.
fn poses_between(lengths: &Lengths) -> Vec<ApproachedPose> {
    let mut random = Pcg64::seed_from_u64(1);
    let mut pose = |_| {
        let [one, other] = [0, 1].map(|_| lengths.reading(random.random_range(0..lengths.len())));
        let angle = |axis: usize, share: f64| one.axes[axis] + share * (other.axes[axis] - one.axes[axis]);
        let axes = std::array::from_fn(|axis| angle(axis, random.random()));
        measured_pose(&PreparedMeasurement { axes, ..one })
    };
    (0..lengths.len().min(COMPRESSING)).map(&mut pose).collect()
}

/// At most [`COMPRESSING`] indices of `count`, evenly spread.
fn thinned(count: usize) -> impl Iterator<Item = usize> {
    (0..count).step_by(count.div_ceil(COMPRESSING).max(1))
}

fn measured_pose(reading: &PreparedMeasurement) -> ApproachedPose {
    ApproachedPose {
        axes: AxisAngles::from_degrees(reading.axes.map(f64::to_degrees)),
        approach: reading.approach,
    }
}

/// The scatter of the lengths beyond their given standard deviations and the robot's repeatability, mm. It comes from
/// the robot, such as backlash where the sense of approach is not known.
fn unexplained_mm(setting: &Setting<'_>, estimate: &Estimate, lengths: &Lengths) -> f64 {
    if !lengths.known || lengths.is_sigma_given {
        return 0.0;
    }
    let given = lengths.weighted(super::lengths::Sigma::Given, &[]).rms_sigma();
    let repeatability = setting.robot.repeatability_sd_mm().unwrap_or(0.0);
    let square = estimate.noise.sigma_mm().powi(2) - given.powi(2) - repeatability.powi(2);
    square.max(0.0).sqrt().min(estimate.noise.pose_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Joint;
    use crate::test_support::cell::kr60;

    #[test]
    fn at_most_so_many_are_spread_evenly() {
        for count in [0, 1, COMPRESSING, COMPRESSING + 1, 7 * COMPRESSING + 3] {
            let kept: Vec<usize> = thinned(count).collect();
            assert!(kept.len() <= COMPRESSING && kept.len() >= count.min(COMPRESSING / 2), "{count}");
            let step = kept.get(1).copied().unwrap_or(1);
            assert!(kept.iter().zip(0..).all(|(at, number)| *at == step * number), "{kept:?}");
            assert!(kept.last().is_none_or(|last| last + step >= count), "{count}");
        }
    }

    /// At one joint: half a milliradian of each harmonic, 0.1 mrad of each smooth process, 0.03 mrad of backlash, by the medians
    /// of the hyper-priors. A sine and a cosine of 0.5 mrad are an error of 0.5 mrad at any angle.
    #[test]
    fn a_robot_before_its_lengths_has_the_usual_errors_of_joints() {
        let (ids, root) = ([ParamId::A(Joint::J2)], DMatrix::from_element(1, 1, 0.0));
        let poses: Vec<ApproachedPose> = [[0.3, -1.0, 1.2, 0.4, 0.5, 0.1], [-0.6, -1.4, 0.9, -0.2, 0.8, 0.3]]
            .iter()
            .map(ApproachedPose::unapproached)
            .collect();
        let unknown = with_usual_joint_errors(&ids, &root, true);
        let geometry = kr60().geometry.rigid();
        let axes: Vec<_> = poses.iter().map(|pose| (pose.axes.radians(), pose.approach)).collect();
        let by_joint = BallMotion::new(&geometry, &axes, &[]).by_joint;
        let sd_rad = (2.5e-7f64 + 2.0 * 1e-8 + 9e-10).sqrt();
        // Without an alignment the squares of the joints add up.
        let jacobian = BallMotion::new(&geometry, &axes, &unknown.parameters).jacobian;
        let by_harmonics = (jacobian * &unknown.root).rows(0, 3).norm_squared();
        let remaining = 2.0 * 1e-8 + 9e-10;
        let arms: f64 = by_joint[0].iter().map(nalgebra::Vector3::norm_squared).sum();
        let found = by_harmonics + arms * remaining;
        assert!((found / (arms * sd_rad * sd_rad) - 1.0).abs() < 1e-9, "{found}");
        let smooth: f64 = unknown.smooth.iter().map(|part| part.sd_rad.powi(2)).sum();
        assert!((smooth / 2e-8 - 1.0).abs() < 1e-12, "{smooth}");
        assert!((unknown.unapproached_rad[3] - 3e-5).abs() < 1e-18);
        // A list has none.
        let none = with_usual_joint_errors(&ids, &root, false);
        assert!(none.smooth.is_empty() && none.parameters == ids && none.unapproached_rad == [0.0; AXES]);
    }
}
