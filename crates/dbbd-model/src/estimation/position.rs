//! The predicted position uncertainty of the tool ball at poses, from all uncertainties of a robot: whoever states how sure a point
//! is, or an arm over its workspace, asks [`Positions`].
//!
//! The covariance at a pose is J C J' of parameters and joint errors, after a rigid motion of all poses (six degrees of
//! freedom) was removed. Each joint adds the variance that its smooth function keeps outside the measured angles (far
//! from them its whole variance) and, where the sense of approach is not known, backlash.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::ball_motion::BallMotion;
use super::workspace::{ErrorSummary, Workspace, take_out_rigid_motion, take_out_rigid_motion_of};
use crate::math::{aligned_differences, beside, gram, stacked};
use crate::measurement::{ApproachedPose, LengthModel};
use crate::robot::{
    AXES, Approach, Geometry, Joint, JointTerm, ParamId, Payload, Robot, RobotUncertainty, TermKind,
    Tolerance,
};

/// Least number of robots that are drawn for a summary.
const ROBOTS: usize = 100;
/// Fewer poses determine the place of the robot's base too poorly: poses of the workspace are added.
const MIN_POSES: usize = 10;

/// The positions of the tool ball at poses, with their uncertainty.
pub struct Positions {
    /// Positions of the tool ball in the robot base, mm.
    pub balls: Vec<Vector3<f64>>,
    errors: PoseErrors,
    /// The part of the repeatability of a pose that counts as an error of the robot, mm.
    unexplained_mm: f64,
}

/// The uncertainty of a vector at poses: the position of the tool ball (mm), or the rotation of the flange (rad).
struct PoseErrors {
    /// Displacement by each column of the root, 3 rows for each pose.
    moved: DMatrix<f64>,
    /// For each joint the displacement per rad, and the standard deviation of the joint's error that is not in the
    /// root, rad.
    joints: Vec<[JointDisplacement; AXES]>,
    /// The standard deviation of each coordinate when a pose is repeated.
    repeated: Vec<f64>,
}

#[derive(Clone, Copy)]
struct JointDisplacement {
    column: Vector3<f64>,
    sd_rad: f64,
}

impl PoseErrors {
    fn covariance(&self, pose: usize) -> Matrix3<f64> {
        let moved = self.moved.rows(3 * pose, 3);
        moved * moved.transpose() + self.covariance_of_pose(pose, self.repeated[pose])
    }

    /// The covariance of what no other pose has: its repeatability, and the joints' errors that are not in the root.
    fn covariance_of_pose(&self, pose: usize, repeated: f64) -> Matrix3<f64> {
        let mut covariance = Matrix3::identity() * repeated.powi(2);
        for by_angle in &self.joints[pose] {
            covariance += by_angle.column * by_angle.column.transpose() * (by_angle.sd_rad * by_angle.sd_rad);
        }
        covariance
    }

    /// Errors of at least `robots` robots that are drawn from this uncertainty, a column for each robot and 3 rows for
    /// each pose. Every pose gets a random error of the repeatability `repeated` in each direction.
    fn draws(&self, repeated: f64, robots: usize) -> DMatrix<f64> {
        self.of_numbers(&unit_draws(self.moved.ncols(), robots), repeated, POSES_SEED)
    }

    /// As [`Self::draws`], with the robots of these unit normal numbers (a row for each column of the root).
    fn of_numbers(&self, numbers: &DMatrix<f64>, repeated: f64, seed: u64) -> DMatrix<f64> {
        let mut drawn = &self.moved * numbers;
        let mut random = Pcg64::seed_from_u64(seed);
        for pose in 0..self.joints.len() {
            let covariance = self.covariance_of_pose(pose, repeated);
            // Where nothing moves the pose in a direction, the substitute is far below any error.
            let Some(root) = Cholesky::new_with_substitute(covariance, NO_ERROR) else { continue };
            let root = root.l();
            for mut column in drawn.column_iter_mut() {
                let unit = Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
                let mut there = column.fixed_rows_mut::<3>(3 * pose);
                there += root * unit;
            }
        }
        drawn
    }
}

/// Seed of what each pose has by itself.
const POSES_SEED: u64 = 2;
/// Variance in a direction in which nothing moves, mm^2 or rad^2.
const NO_ERROR: f64 = 1e-24;

impl Positions {
    /// The tool ball of a robot at `poses`, with the uncertainty in the robot's file.
    pub fn of(robot: &Robot, poses: &[ApproachedPose]) -> Self {
        Self::aligned(robot, &AlignedPoses::of(robot, poses, &[]))
    }

    /// The tool ball of a robot at aligned poses, with the uncertainty in the robot's file.
    pub(super) fn aligned(robot: &Robot, poses: &AlignedPoses) -> Self {
        let AlignedPoses { all, datum, count } = poses;
        let mut positions = Self::in_datum(&robot.geometry, &robot.known_uncertainty(), all, datum.clone());
        positions.balls.truncate(*count);
        positions
    }

    /// The tool ball of a robot with the uncertainty `unknown` at `poses`, aligned over these poses.
    pub fn new(geometry: &Geometry, unknown: &RobotUncertainty, poses: &[ApproachedPose]) -> Self {
        Self::in_datum(geometry, unknown, poses, 0..poses.len())
    }

    fn in_datum(
        geometry: &Geometry,
        unknown: &RobotUncertainty,
        poses: &[ApproachedPose],
        datum: Range<usize>,
    ) -> Self {
        let all: Vec<([f64; AXES], Approach)> =
            poses.iter().map(|pose| (pose.axes.radians(), pose.approach)).collect();
        let motion = BallMotion::new(geometry, &all, &unknown.parameters);
        let remaining = RemainingErrors::new(geometry, unknown);
        let joints = all.iter().zip(&motion.by_joint).map(|((axes, approach), by_joint)| {
            let sds = remaining.sds(geometry, axes, *approach);
            std::array::from_fn(|i| JointDisplacement { column: by_joint[i], sd_rad: sds[i] })
        });
        let joints = joints.collect();
        let by_payload = by_payload(geometry, &all, &motion.balls);
        let BallMotion { jacobian, balls, .. } = motion;
        let mut moved = beside(jacobian * &unknown.root, &by_payload);
        take_out_rigid_motion_of(&mut moved, &balls, datum);
        let repeated = vec![unknown.pose_mm; balls.len()];
        let errors = PoseErrors { moved, joints, repeated };
        Self { balls, errors, unexplained_mm: unknown.unexplained_mm }
    }

    /// The covariance of the tool ball's position at a pose, with the repeatability of the pose, mm^2.
    pub fn covariance(&self, pose: usize) -> Matrix3<f64> {
        self.errors.covariance(pose)
    }

    /// The 3-D standard deviation (root of the mean square) at a pose, mm.
    pub fn sd_mm(&self, pose: usize) -> f64 {
        self.covariance(pose).trace().sqrt()
    }

    /// Errors of at least `robots` robots that are drawn from this uncertainty, a column for each robot and 3 rows for each
    /// pose of [`Self::new`], mm. Of the repeatability of a pose they contain what the bar and the stated repeatability do
    /// not explain.
    pub fn draws(&self, robots: usize) -> DMatrix<f64> {
        self.errors.draws(self.unexplained_mm, robots)
    }

    /// The displacement by each column of the root of the uncertainty, then by the uncertain payload: 3 rows for each pose, mm.
    pub(super) fn by_column(&self) -> &DMatrix<f64> {
        &self.errors.moved
    }

    /// The errors as [`Self::draws`] of the robots of these unit normal numbers, a row for each of [`Self::by_column`].
    pub(super) fn of_numbers(&self, numbers: &DMatrix<f64>, seed: u64) -> DMatrix<f64> {
        self.errors.of_numbers(numbers, self.unexplained_mm, seed)
    }

    /// The errors from which a predicted position uncertainty is stated, as [`Self::draws`].
    pub(super) fn stated_errors(&self) -> DMatrix<f64> {
        self.draws(ROBOTS)
    }

    /// The predicted position uncertainty over the poses of [`Self::new`], mm: `predicted_position_uncertainty_mm` of
    /// every document.
    pub fn summary(&self) -> ErrorSummary {
        ErrorSummary::of(&self.stated_errors())
    }
}

/// The displacement of tool balls (mm) from `before` to `after`, whose best rigid motion is removed: 3 rows for each pose.
pub fn displacement(before: &[Vector3<f64>], after: &[Vector3<f64>]) -> DVector<f64> {
    let moved = aligned_differences(after, before);
    DVector::from_iterator(3 * moved.len(), moved.iter().flat_map(|moved| moved.iter().copied()))
}

/// Poses (axis angles, rad) at which the position of a tool matters.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolPoses {
    /// An exactly known point in the flange frame, mm; the tool ball if absent.
    pub tool_mm: Option<Vector3<f64>>,
    pub poses: Vec<[f64; AXES]>,
}

/// The position errors of robots that are drawn with a seed, at poses of tools, mm: a column for each robot, 3 rows for each pose of
/// each tool. The poses of each tool are aligned by themselves.
pub(super) fn drawn_errors(
    geometry: &Geometry,
    unknown: &RobotUncertainty,
    tolerance: &Tolerance,
    tools: &[ToolPoses],
    seed: u64,
) -> DMatrix<f64> {
    let errors = |positions: Positions| {
        let mut random = Pcg64::seed_from_u64(seed);
        let columns = positions.errors.moved.ncols();
        let robots = DMatrix::from_fn(columns, ROBOTS, |_, _| StandardNormal.sample(&mut random));
        positions.errors.of_numbers(&robots, 0.0, seed)
    };
    let of_tool = |ToolPoses { tool_mm, poses }: &ToolPoses| {
        let poses: Vec<ApproachedPose> = poses.iter().map(ApproachedPose::unapproached).collect();
        match tool_mm {
            Some(tool) => {
                let geometry = Geometry { tool: *tool, ..geometry.clone() };
                errors(Positions::new(&geometry, &unknown.clone().at_exact_tool(tolerance), &poses))
            }
            None => errors(Positions::new(geometry, unknown, &poses)),
        }
    };
    tools.iter().map(of_tool).reduce(|above, below| stacked(&above, &below)).unwrap_or(DMatrix::zeros(0, 0))
}

/// Poses, with the poses over which the robot's base is aligned (the datum).
pub(super) struct AlignedPoses {
    /// The poses, then the poses of the datum that are not among them.
    pub(super) all: Vec<ApproachedPose>,
    pub(super) datum: Range<usize>,
    /// Number of the poses themselves.
    count: usize,
}

impl AlignedPoses {
    /// The poses, aligned over `datum` (axis angles, rad). If `datum` is empty, they are aligned over themselves, and
    /// where they are few, also over poses of the workspace.
    pub(super) fn of(robot: &Robot, poses: &[ApproachedPose], datum: &[[f64; AXES]]) -> Self {
        const WORKSPACE_POSES: usize = 300;
        const SEED: u64 = 1;
        let more = if datum.is_empty() && poses.len() < MIN_POSES { WORKSPACE_POSES } else { 0 };
        let workspace = Workspace::uniform(robot.controller(), more, SEED);
        let further = workspace.iter().chain(datum).map(ApproachedPose::unapproached);
        let all: Vec<ApproachedPose> = poses.iter().copied().chain(further).collect();
        let first = if datum.is_empty() { 0 } else { poses.len() };
        Self { datum: first..all.len(), all, count: poses.len() }
    }
}

/// The uncertainty of the orientation of a tool frame at poses.
pub struct Orientations {
    errors: PoseErrors,
}

impl Orientations {
    /// The orientation uncertainty of a robot's flange at `poses`; the rotation that all poses have in common is
    /// removed.
    pub fn of(robot: &Robot, poses: &[ApproachedPose]) -> Self {
        Self::new(&robot.geometry, &robot.known_uncertainty(), robot.reach_mm(), poses)
    }

    /// The orientation uncertainty from the uncertainty `unknown` of an arm that reaches `arm_mm`.
    ///
    /// It follows from the displacements of three points relative to the flange: one point on each axis of the flange,
    /// at the distance `arm_mm`.
    pub(super) fn new(
        geometry: &Geometry,
        unknown: &RobotUncertainty,
        arm_mm: f64,
        poses: &[ApproachedPose],
    ) -> Self {
        let unknown = unknown.clone().without_tool();
        let points = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
        let geometries = points.map(|point| Geometry { tool: point * arm_mm, ..geometry.clone() });
        let given: Vec<([f64; AXES], Approach)> =
            poses.iter().map(|pose| (pose.axes.radians(), pose.approach)).collect();
        let motions = geometries.map(|geometry| BallMotion::new(&geometry, &given, &unknown.parameters));
        let rows = 3 * given.len();
        let mut moved = DMatrix::zeros(4 * rows, unknown.root.ncols());
        let mut places = Vec::new();
        for (at, motion) in motions.iter().enumerate() {
            moved.rows_mut(at * rows, rows).copy_from(&(&motion.jacobian * &unknown.root));
            places.extend(&motion.balls);
        }
        take_out_rigid_motion(&mut moved, &places);
        let remaining = RemainingErrors::new(geometry, &unknown);
        let mut turned = DMatrix::zeros(rows, unknown.root.ncols());
        let joints = given.iter().enumerate().map(|(pose, (axes, approach))| {
            let axis = |of: usize| (motions[of].balls[pose] - motions[0].balls[pose]) / arm_mm;
            let units = [axis(1), axis(2), axis(3)];
            for (column, mut turn) in turned.column_iter_mut().enumerate() {
                let point = |of: usize| moved.fixed_view::<3, 1>(of * rows + 3 * pose, column).into_owned();
                let ends = [1, 2, 3].map(|of| (point(of) - point(0)) / arm_mm);
                turn.fixed_rows_mut::<3>(3 * pose).copy_from(&rotation(&units, &ends));
            }
            let sds = remaining.sds(geometry, axes, *approach);
            std::array::from_fn(|joint| {
                let end = |of: usize| {
                    (motions[of].by_joint[pose][joint] - motions[0].by_joint[pose][joint]) / arm_mm
                };
                JointDisplacement { column: rotation(&units, &[end(1), end(2), end(3)]), sd_rad: sds[joint] }
            })
        });
        let joints = joints.collect();
        // The repeatability of a pose is taken as if all joints scattered alike.
        let repeated = |moved: &[Vector3<f64>; AXES]| {
            let squares: f64 = moved.iter().map(Vector3::norm_squared).sum();
            (AXES as f64 / squares).sqrt() * unknown.pose_mm
        };
        let repeated = BallMotion::new(geometry, &given, &[]).by_joint.iter().map(repeated).collect();
        Self { errors: PoseErrors { moved: turned, joints, repeated } }
    }

    /// The standard deviation of the rotation at a pose (root of the mean square angle), rad.
    pub fn sd_rad(&self, pose: usize) -> f64 {
        self.errors.covariance(pose).trace().sqrt()
    }

    /// The errors over all poses and many robots, mrad, without the repeatability of a pose.
    pub(super) fn summary_mrad(&self) -> ErrorSummary {
        ErrorSummary::of(&(self.errors.draws(0.0, ROBOTS) * 1e3))
    }
}

/// The rotation vector of a frame whose unit vectors move by `ends`: half the sum of their cross products.
fn rotation(units: &[Vector3<f64>; 3], ends: &[Vector3<f64>; 3]) -> Vector3<f64> {
    units.iter().zip(ends).map(|(unit, end)| unit.cross(end)).sum::<Vector3<f64>>() / 2.0
}

/// The displacement of the tool ball at poses by each standard uncertainty of the payload carried, a column each and 3
/// rows for each pose, mm.
fn by_payload(
    geometry: &Geometry,
    poses: &[([f64; AXES], Approach)],
    balls: &[Vector3<f64>],
) -> DMatrix<f64> {
    let mut varied = Vec::new();
    if let Some(Payload { u_kg, u_mm, .. }) = geometry.load.carried() {
        let with = |change: &dyn Fn(&mut Payload)| {
            let mut geometry = geometry.clone();
            geometry.load.payloads.iter_mut().take(1).for_each(change);
            geometry
        };
        if *u_kg > 0.0 {
            varied.push(with(&|payload| payload.kg += payload.u_kg));
        }
        if *u_mm > 0.0 {
            varied.extend([0, 1, 2].map(|axis| with(&|payload| payload.centre[axis] += payload.u_mm)));
        }
    }
    let mut moved = DMatrix::zeros(3 * poses.len(), varied.len());
    for (column, geometry) in varied.iter().enumerate() {
        let there = BallMotion::new(geometry, poses, &[]).balls;
        for (at, (there, here)) in there.iter().zip(balls).enumerate() {
            moved.fixed_view_mut::<3, 1>(3 * at, column).copy_from(&(there - here));
        }
    }
    moved
}

/// Standard normal numbers from seed 1, a column for each of at least `robots` robots, transformed so that their sample
/// covariance is exactly the identity: the sample covariance of so few robots could be wrong by a tenth in one direction.
pub(super) fn unit_draws(rows: usize, robots: usize) -> DMatrix<f64> {
    let mut random = Pcg64::seed_from_u64(1);
    let robots = robots.max(rows);
    let drawn = DMatrix::from_fn(robots, rows, |_, _| StandardNormal.sample(&mut random));
    drawn.qr().q().transpose() * (robots as f64).sqrt()
}

/// The errors of joints that are not in the root of an uncertainty.
#[derive(Clone, Debug)]
pub(super) struct RemainingErrors {
    /// The uncertainty, without its root.
    uncertainty: RobotUncertainty,
    /// Prior variance of each coefficient of the smooth functions; 0 for the other coefficients.
    variances: Vec<f64>,
}

impl RemainingErrors {
    pub(super) fn new(geometry: &Geometry, uncertainty: &RobotUncertainty) -> Self {
        let variance = |term: &JointTerm| match term.kind {
            TermKind::Smooth { frequency } => uncertainty.spectral_density(term.joint, frequency),
            TermKind::Backlash | TermKind::Ripple { .. } => 0.0,
        };
        let variances = geometry.joint_errors.terms().iter().map(variance).collect();
        Self { uncertainty: uncertainty.rootless(), variances }
    }

    /// Standard deviation with which a pose repeats in each direction, mm.
    pub(super) fn pose_mm(&self) -> f64 {
        self.uncertainty.pose_mm
    }

    /// The standard deviation of each joint's remaining error at axis angles (rad), rad.
    pub(super) fn sds(&self, geometry: &Geometry, axes: &[f64; AXES], approach: Approach) -> [f64; AXES] {
        let uncertainty = &self.uncertainty;
        let joints = geometry.coupling.joints(axes);
        let errors = &geometry.joint_errors;
        let nearest = |place: usize| Some(errors.at(place)?.smooth.nearest_measured(joints[place]));
        let nearest: [f64; AXES] = std::array::from_fn(|place| nearest(place).unwrap_or(joints[place]));
        let here = self.smooth_variance(geometry, &joints);
        let measured = if nearest == joints { here } else { self.smooth_variance(geometry, &nearest) };
        let of_visit = uncertainty.of_visit(geometry.coupling.senses(approach).senses());
        std::array::from_fn(|place| {
            // Within the measured angles the noise of the lengths already contains what the basis functions lack.
            let held = if measured[place] > 0.0 { (here[place] / measured[place]).min(1.0) } else { 0.0 };
            (uncertainty.smooth_variance(Joint::ALL[place]) * (1.0 - held)).sqrt().hypot(of_visit[place])
        })
    }

    /// The variance that the basis functions of each joint's smooth function have at joint angles (rad) before any
    /// length, rad^2.
    fn smooth_variance(&self, geometry: &Geometry, joints: &[f64; AXES]) -> [f64; AXES] {
        let mut variance = [0.0; AXES];
        let mut of_term = self.variances.iter();
        geometry.joint_errors.derivatives(joints, Approach::default(), |place, value| {
            variance[place] += of_term.next().map_or(0.0, |prior| prior * value * value);
        });
        variance
    }
}

/// Largest number of columns of a root in a robot file.
const COLUMNS: usize = 66;
/// Iterations that find these columns.
const ITERATIONS: usize = 4;

/// Poses for which an uncertainty is compressed.
pub(super) struct CompressingPoses {
    pub(super) workspace: Vec<ApproachedPose>,
    pub(super) measured: Vec<ApproachedPose>,
    /// Poses whose angles lie between those of the measured ones.
    pub(super) between: Vec<ApproachedPose>,
}

/// The same uncertainty with few columns. They are the directions that most move, relative to each other, the tool ball at the poses of
/// the workspace and at the measured ones, an exactly known tool with another payload there, and the base balls; and the tool ball
/// between the measured poses, where it is known best. Each position counts in units of its own standard deviation, so that small
/// uncertainties are kept too. What the columns lack between the measured poses becomes an error of each pose: quick functions of many
/// joints make it, which poses hardly share.
pub(super) fn compressed(
    model: &LengthModel,
    unknown: &RobotUncertainty,
    by: &CompressingPoses,
) -> RobotUncertainty {
    if unknown.root.ncols() <= COLUMNS {
        return unknown.clone();
    }
    let all: Vec<ApproachedPose> = by.workspace.iter().chain(&by.measured).copied().collect();
    let between = moved_relatively(model, unknown, &by.between);
    // Columns that are best at some poses lack more at others: every second pose says how much.
    let [even, odd]: [Vec<usize>; 2] =
        [0, 1].map(|part| (0..between.nrows()).filter(|row| row / 3 % 2 == part).collect());
    let mut moved = stacked(&moved_with_balls(model, unknown, &all), &between.select_rows(&even));
    for pose in 0..moved.nrows() / 3 {
        let mut rows = moved.rows_mut(3 * pose, 3);
        let norm = rows.norm();
        if norm > 0.0 {
            rows /= norm;
        }
    }
    let gram = gram(&moved);
    let mut random = Pcg64::seed_from_u64(1);
    let mut space = DMatrix::from_fn(gram.ncols(), COLUMNS, |_, _| StandardNormal.sample(&mut random));
    for _ in 0..ITERATIONS {
        space = (&gram * space).qr().q();
    }
    let others = between.select_rows(&odd);
    let lacking = others.norm_squared() - (&others * &space).norm_squared();
    let lacking_mm = (lacking.max(0.0) / odd.len().max(1) as f64).sqrt();
    RobotUncertainty {
        root: &unknown.root * space,
        pose_mm: unknown.pose_mm.hypot(lacking_mm),
        unexplained_mm: unknown.unexplained_mm.hypot(lacking_mm),
        ..unknown.clone()
    }
}

/// Displacements of the tool ball at the poses by the columns of the root, 3 rows for each pose, without their rigid motions.
fn moved_relatively(
    model: &LengthModel,
    unknown: &RobotUncertainty,
    poses: &[ApproachedPose],
) -> DMatrix<f64> {
    let poses: Vec<_> = poses.iter().map(|pose| (pose.axes.radians(), pose.approach)).collect();
    let BallMotion { jacobian, balls, .. } = BallMotion::new(&model.geometry, &poses, &unknown.parameters);
    let mut moved = jacobian * &unknown.root;
    take_out_rigid_motion(&mut moved, &balls);
    moved
}

/// Displacements by the columns of the root, 3 rows for each position: the tool ball at the poses, an exactly known tool
/// with another payload at the poses, then the base balls. Rigid motions of all are removed.
fn moved_with_balls(
    model: &LengthModel,
    unknown: &RobotUncertainty,
    poses: &[ApproachedPose],
) -> DMatrix<f64> {
    let poses: Vec<_> = poses.iter().map(|pose| (pose.axes.radians(), pose.approach)).collect();
    let BallMotion { jacobian, balls: mut places, .. } =
        BallMotion::new(&model.geometry, &poses, &unknown.parameters);
    let mut other = model.geometry.clone();
    let payload = other.load.rated(&other.rows);
    other.tool += Vector3::repeat(payload.centre.norm());
    other.load.payloads.insert(0, payload);
    let other = BallMotion::new(&other, &poses, &unknown.parameters);
    // What flange and tool ball have in common moves a tool whose place on the flange is known.
    let at_other = &other.jacobian * unknown.clone().without_tool().root;
    let moved_tools = stacked(&(&jacobian * &unknown.root), &at_other);
    places.extend(&other.balls);
    let is_ball = |id: &ParamId| matches!(id, ParamId::Ball(..));
    let rows: Vec<usize> =
        (0..unknown.parameters.len()).filter(|at| is_ball(&unknown.parameters[*at])).collect();
    // A base ball with an exact coordinate does not move freely: then no base ball is used.
    let whole = rows.len() == 3 * model.balls.len();
    let rows = if whole { rows } else { Vec::new() };
    let mut moved = stacked(&moved_tools, &unknown.root.select_rows(&rows));
    places.extend(model.balls.iter().take(rows.len() / 3));
    take_out_rigid_motion(&mut moved, &places);
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::tool_balls;

    /// A frame that is turned by 0.2 mrad about an axis moves its unit vectors by the cross product.
    #[test]
    fn a_rotation_follows_from_how_the_axes_move() {
        let turn = Vector3::new(1e-4, -2e-4, 5e-5);
        let frame = crate::robot::pose::rot_x(0.7) * crate::robot::pose::rot_z(-0.4);
        let units = [0, 1, 2].map(|axis| Vector3::from(frame.column(axis)));
        let ends = units.map(|unit| turn.cross(&unit));
        assert!((rotation(&units, &ends) - turn).norm() < 1e-15);
    }

    /// An error of theta6 alone turns the flange about its own axis by as much at every pose, and moves it nowhere.
    #[test]
    fn the_flange_turns_by_the_error_of_the_last_joint() {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let poses: Vec<ApproachedPose> = Workspace::uniform(&robot, 40, 3)
            .iter()
            .map(|axes| ApproachedPose {
                axes: crate::robot::AxisAngles::from_degrees(axes.map(f64::to_degrees)),
                approach: Approach::default(),
            })
            .collect();
        let unknown = RobotUncertainty {
            parameters: vec![ParamId::Theta(Joint::J6)],
            root: DMatrix::from_element(1, 1, 3e-4),
            pose_mm: 0.0,
            ..robot.known_uncertainty()
        };
        robot.uncertainty = Some(Box::new(unknown));
        let found = Orientations::of(&robot, &poses);
        // The rotation that all poses have in common is removed; it is small for rotations about axes in all
        // directions.
        for pose in 0..poses.len() {
            assert!((found.sd_rad(pose) / 3e-4 - 1.0).abs() < 0.35, "{}", found.sd_rad(pose));
        }
    }

    /// Two parameters with the root [[0.2 mm, 0], [3e-4, 1e-4 rad]]: each column moves the ball by its part of the displacements,
    /// which differences of aligned positions give. The repeatability adds its square on the diagonal.
    #[test]
    fn a_covariance_is_that_of_displacements() {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let (arm, wrist) = (ParamId::A(Joint::J3), ParamId::Theta(Joint::J5));
        let unknown = RobotUncertainty {
            parameters: vec![arm, wrist],
            root: DMatrix::from_row_slice(2, 2, &[0.2, 0.0, 3e-4, 1e-4]),
            pose_mm: 0.03,
            ..robot.known_uncertainty()
        };
        robot.uncertainty = Some(Box::new(unknown));
        let poses: Vec<ApproachedPose> =
            Workspace::uniform(&robot, 40, 3).iter().map(ApproachedPose::unapproached).collect();
        let moved = |id: ParamId, step: f64| {
            let [low, high] = [-step, step].map(|step| {
                let mut geometry = robot.geometry.clone();
                *geometry.value_mut(id).unwrap() += step;
                tool_balls(&geometry, &poses)
            });
            displacement(&low, &high) / (2.0 * step)
        };
        let (by_arm, by_wrist) = (moved(arm, 1e-2), moved(wrist, 1e-5));
        let columns = [&by_arm * 0.2 + &by_wrist * 3e-4, &by_wrist * 1e-4];
        let found = Positions::of(&robot, &poses);
        for pose in 0..poses.len() {
            let mut expected = Matrix3::identity() * 0.03 * 0.03;
            for column in &columns {
                let there = column.fixed_rows::<3>(3 * pose);
                expected += there * there.transpose();
            }
            let covariance = found.covariance(pose);
            assert!((covariance - expected).norm() < 1e-4 * expected.norm(), "{covariance} {expected}");
            assert_eq!(covariance, covariance.transpose());
            assert!(covariance.symmetric_eigenvalues().min() > 0.03 * 0.03 * (1.0 - 1e-9));
            assert!((covariance.trace() - found.sd_mm(pose).powi(2)).abs() < 1e-15);
        }
    }

    fn identified(pose_mm: f64) -> (Robot, Vec<ApproachedPose>) {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let unknown = RobotUncertainty {
            parameters: Vec::new(),
            root: DMatrix::zeros(0, 0),
            pose_mm,
            ..robot.known_uncertainty()
        };
        robot.uncertainty = Some(Box::new(unknown));
        let axes = crate::robot::AxisAngles::from_degrees([10.0, -60.0, 90.0, 20.0, 40.0, 0.0]);
        (robot, vec![ApproachedPose { axes, approach: Approach::default() }])
    }

    /// If each joint scatters by s, the ball scatters by s times the root of the squares of what the joints move, and the flange
    /// turns by s times the root of six: axes are unit vectors.
    #[test]
    fn a_flange_turns_as_far_as_the_joints_that_scatter_the_ball() {
        let (robot, poses) = identified(0.05);
        let moved = robot.geometry.axis_jacobian(&poses[0].axes.radians());
        let ball: f64 = moved.iter().map(|(shift, _)| shift.norm_squared()).sum();
        let turn: f64 = moved.iter().map(|(_, turn)| turn.norm_squared()).sum();
        let each_rad = (3.0 * 0.05f64.powi(2) / ball).sqrt();
        let found = Orientations::of(&robot, &poses).sd_rad(0);
        assert!((found - each_rad * turn.sqrt()).abs() < 1e-12, "{found}");
    }

    /// 5 kg more about joint 2, whose axis is level: the ball turns with it by the compliance times 5 * 9.80665 N at their lever.
    #[test]
    fn an_uncertain_payload_moves_the_ball_by_its_torque() {
        let (mut robot, poses) = identified(0.0);
        robot.geometry.compliance[1] = 3e-7;
        let payload = Payload { kg: 40.0, u_kg: 5.0, ..Payload::default() };
        robot.geometry.load.payloads = vec![payload];
        let axes = poses[0].axes.radians();
        let given = [(axes, Approach::default())];
        let balls = BallMotion::new(&robot.geometry, &given, &[]).balls;
        let found = by_payload(&robot.geometry, &given, &balls);
        let (shift, axis) = robot.geometry.axis_jacobian(&axes)[1];
        let shoulder = robot.geometry.skeleton(&axes)[1];
        let lever = (robot.geometry.flange(&axes).position - shoulder) * 1e-3;
        let torque = axis.dot(&lever.cross(&Vector3::new(0.0, 0.0, -5.0 * 9.80665)));
        let expected = shift * (3e-7 * torque);
        assert_eq!(found.shape(), (3, 1));
        assert!(expected.norm() > 0.01, "{expected}");
        assert!((found.column(0) - expected).norm() < 1e-3 * expected.norm(), "{found} {expected}");
    }

    #[test]
    fn draws_have_unit_covariance() {
        for rows in [3, 64, 120] {
            let draws = unit_draws(rows, ROBOTS);
            let covariance = &draws * draws.transpose() / draws.ncols() as f64;
            assert!((covariance - DMatrix::identity(rows, rows)).norm() < 1e-12);
        }
    }
}
