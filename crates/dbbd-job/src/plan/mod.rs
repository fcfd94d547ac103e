//! Makes a plan from a job: circles and chosen poses, checked before anything moves.
//!
//! The types below are shared by the files of this module; their fields are private to the module.

mod catalogue;
pub use catalogue::PlanFinding;

mod build;
mod cell;
pub mod check;
mod circle;
pub mod clearance;
mod files;
mod frames;
pub mod goal;
pub mod job;
mod module;
mod optimise;
mod orientations;
mod pass;
pub mod path;
pub mod prediction;
mod prior;
mod quantity;
mod recommend;
mod refusal;
mod rig;
mod rows;
mod stage;
mod steps;
pub mod timing;
pub mod workspace;

use std::ops::Range;

use nalgebra::{DVector, Matrix3, Vector3};

use self::job::CircleTable;
use self::path::ToolBallPath;
use dbbd_model::design::Near;
use dbbd_model::estimation::Posterior;
use dbbd_model::robot::{AXES, Geometry, Pose, Robot, max_axis_difference};

pub use circle::REFERENCE_EVERY;
pub use dbbd_model::measurement::PoseKind;
pub use files::{CirclePlace, Plan, PlanHeader};
pub use frames::PlanFrames;
pub(crate) use job::JobTable;
pub use job::{DEFAULT_PROTOCOL, Job, MotionTable, SIGMA_UM};
pub use module::MODULE_DWELLS;
pub use pass::PlannedPass;
pub use prediction::PlanPrediction;
pub use prior::{KnownCell, PlanningPrior, TaughtBall};
pub use quantity::{CheckQuantity, PlanCheck};
pub use refusal::Refusal;
pub use rows::{MotionKind, PlanRow};
pub use stage::Stage;
pub use timing::MoveTime;

/// Whether a pose of one plan is a pose of another plan, by its axis angles in rad: they may differ by the rounding of
/// a pose, which is a micrometre and 0.0001 degrees.
pub fn is_same_planned_pose(a: &[f64; AXES], b: &[f64; AXES]) -> bool {
    const ROUNDED_RAD: f64 = 2e-5;
    max_axis_difference(a, b) < ROUNDED_RAD
}

/// The job, the controller that is commanded, and the arm that moves. They differ where the robot was identified:
/// the controller computes with the nominal robot.
#[derive(Clone, Copy)]
struct PlanKinematics<'a> {
    job: &'a Job,
    robot: &'a Robot,
    controller: &'a Robot,
    /// The best known geometry of the arm.
    arm: &'a Geometry,
}

/// A run of rows in one branch of the inverse kinematics.
struct BranchRun {
    rows: Vec<PlanRow>,
    /// The turns in which the run can start, axis angles in rad, each with the least distance of the run from any limit in
    /// degrees, negative outside.
    starts: Vec<(f64, [f64; AXES])>,
}

/// A pose of the tool ball to which the robot shall go.
struct PlanStep {
    circle: u32,
    centre: u32,
    kind: PoseKind,
    motion: MotionKind,
    pose: Pose,
    dwell_s: f64,
    /// Axis angles, rad, where branch and turn are known.
    axes: Option<[f64; AXES]>,
}

/// A way from one pose to the next.
enum RouteLeg {
    /// One arc through this auxiliary pose.
    Arc(Pose),
    /// Straight lines past these poses, with the axis angles (rad) at each.
    Chords(Vec<(Pose, [f64; AXES])>),
}

/// A path with the derivatives of the axis angles along it, by the share of the path from 0 to 1.
struct PathTiming {
    path: ToolBallPath,
    /// Greatest ratio of an axis's first derivative to its greatest speed, s.
    axis_s: f64,
    /// Greatest ratio of an axis's first and second derivative to its greatest acceleration, s^2.
    slope_s2: f64,
    bend_s2: f64,
}

/// The rows of a pass, by their positions from 0.
#[derive(Clone, Debug, PartialEq, Eq)]
struct RowsOfPass {
    through: [usize; 2],
    points: Range<usize>,
    end: usize,
}

/// A `circ` row that belongs to no arc: its position from 0.
#[derive(Debug)]
struct UngroupedRow {
    at: usize,
    finding: PlanFinding,
}

/// Distance of a reading from the ends of the stroke, with the uncertainty of the reading.
#[derive(Clone)]
struct StrokeMargin {
    /// Distance to the lower and to the upper end of the stroke, mm.
    room: [f64; 2],
    /// The reading's derivative with respect to the coordinates of the prior, mm.
    design_row: DVector<f64>,
    /// Standard deviation of the reading by what this pose has alone, mm.
    own_sd_mm: f64,
    /// Probability that the reading leaves the stroke at this pose.
    risk: f64,
}

/// Whether the bar is mounted; without the bar only the limits and the clearance of the arm count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BarPresence {
    Yes,
    No,
}

/// Conditions on candidates.
struct CandidateConditions {
    risk: f64,
    /// Status bits of the branch that is required, if it matters.
    branch: Option<u8>,
    near: Option<Near>,
}

/// A circle in the robot base, mm and rad.
struct PlannedCircle<'a> {
    number: u32,
    table: &'a CircleTable,
    centre: Vector3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    radius: f64,
    start: f64,
    /// Greatest turn of the tool about each axis.
    amplitude: f64,
    /// The orientation of the tool without a turn.
    down: Matrix3<f64>,
    seed: u64,
}

/// The steps that were made so far.
struct StepBuilder {
    steps: Vec<PlanStep>,
    circle: u32,
    centre: u32,
    dwell_s: f64,
}

/// The robot in its cell, and the posterior at the start of a run.
struct PlanningCell<'a> {
    rig: PlanKinematics<'a>,
    posterior: Posterior,
}

/// A robot, a job and a row for the tests of the module.
#[cfg(test)]
pub(crate) mod example {
    use super::{Job, MotionKind, PlanRow, PoseKind};
    use dbbd_model::robot::{BallId, Robot};

    pub(super) fn robot() -> Robot {
        Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0])
            .expect("it is built in")
            .expect("its file can be read")
    }

    /// A base ball in front of the KR 60, and a bar whose stroke reaches farther outwards than inwards. The job has a
    /// circle if the tables name neither a circle nor chosen poses.
    pub(super) fn job(tables: &str) -> Job {
        let measures = tables.contains("[[circle]]") || tables.contains("[optimise]");
        let circle = if measures { "" } else { "[[circle]]\nplane = \"XY\"\npoints = 12\n" };
        let text = format!(
            "robot = \"kr60ha\"\nbar = {{ length_mm = 300.0, stroke_mm = [-2.0, 6.0], margin_mm = 0.5 }}\n\
             [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n{tables}{circle}"
        );
        Job::from_toml("job.toml", &text).expect("the job is possible")
    }

    pub(crate) fn row(kind: PoseKind) -> PlanRow {
        PlanRow {
            index: 1,
            circle: 1,
            centre: BallId::FIRST,
            kind,
            motion: MotionKind::Ptp,
            xyz_mm: [0.0; 3],
            abc_deg: [0.0; 3],
            axes_deg: [0.0; 6],
            status: 0,
            turn: 0,
            length_mm: 300.0,
            dwell_s: 0.0,
        }
    }
}

#[cfg(test)]
mod tests;
