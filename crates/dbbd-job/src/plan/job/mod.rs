//! The job file: bar, base balls, circles, motion, limits.

mod catalogue;
pub use catalogue::JobFinding;

mod check;
mod check_goal;
mod goal;
mod obstacle;
mod values;

use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

pub(crate) use check::JobCheck;
use dbbd_model::base::fixed_array::fixed_array;
use dbbd_model::design::Criterion;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{Artefact, ArtefactRole, BarIdentity, Identity, Provenance, TracedArtefact};
use dbbd_model::robot::{AXES, Robot};
pub use goal::{BarChoiceTable, GoalStatistic, GoalTable, GoalTool, PlaceTable};
pub use obstacle::ObstacleTable;
pub(crate) use values::JobTable;

/// Standard deviation of a length where the job gives none, micrometres.
pub const SIGMA_UM: f64 = 2.0;
/// The protocol of a bar where nothing names one.
pub const DEFAULT_PROTOCOL: &str = "dbb-cobs-1";

/// What is to be measured, with what, and within which limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    pub robot: String,
    /// Serial number of the robot in this cell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Serial numbers, people, place and circumstances.
    #[serde(default, skip_serializing_if = "Identity::is_empty")]
    pub identity: Identity,
    /// What the flange carries during the run: the name of a payload of the robot's file; the first of them when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<String>,
    /// Seed of random orientations and of chosen poses.
    #[serde(default = "one")]
    pub seed: u32,
    pub bar: JobBar,
    /// The base balls, numbered from 1 in this order.
    #[serde(rename = "centre", default)]
    pub centres: Vec<BaseBallTable>,
    /// The circles, in the order in which they are measured.
    #[serde(rename = "circle", default, skip_serializing_if = "Vec::is_empty")]
    pub circles: Vec<CircleTable>,
    /// Chosen poses, measured after the circles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub optimise: Option<OptimiseTable>,
    /// What the run is to reach: balls, bar and number of poses are then chosen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<GoalTable>,
    /// Where further balls can stand.
    #[serde(rename = "place", default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<PlaceTable>,
    /// The bars that exist.
    #[serde(rename = "bar_choice", default, skip_serializing_if = "Vec::is_empty")]
    pub bar_choices: Vec<BarChoiceTable>,
    #[serde(rename = "obstacle", default, skip_serializing_if = "Vec::is_empty")]
    pub obstacles: Vec<ObstacleTable>,
    #[serde(default)]
    pub tool: JobToolTable,
    #[serde(default)]
    pub motion: MotionTable,
    #[serde(default)]
    pub limits: JobLimits,
}

fn one() -> u32 {
    1
}

impl Job {
    /// The table `identity` with the serial numbers of robot, bar and balls.
    pub fn identity(&self) -> Identity {
        let serials =
            self.centres.iter().filter_map(|ball| Some((ball.id.to_string(), ball.serial.clone()?)));
        let mut identity = self.identity.clone();
        identity.extend(&Identity {
            robot: self.serial.clone(),
            bar: self.bar.identity(),
            balls: serials.collect(),
            ..Identity::default()
        });
        identity
    }

    /// The bars of which a goal takes one: those that are listed, else that of the job.
    pub(crate) fn bars(&self) -> Vec<JobBar> {
        if self.bar_choices.is_empty() {
            return vec![self.bar.clone()];
        }
        let bar = |choice: &BarChoiceTable| JobBar {
            length_mm: choice.length_mm,
            length_u_mm: choice.length_u_mm.or(self.bar.length_u_mm),
            ..self.bar.clone()
        };
        self.bar_choices.iter().map(bar).collect()
    }

    /// The job with base balls, numbered in this order.
    #[must_use]
    pub(crate) fn with_centres(&self, centres: impl IntoIterator<Item = BaseBallTable>) -> Self {
        let numbered = (1..).zip(centres).map(|(id, table)| BaseBallTable { id, ..table });
        Self { centres: numbered.collect(), ..self.clone() }
    }

    /// The job as an artefact, `path` being its file.
    pub fn traced(&self, path: &Path) -> Result<TracedArtefact, Diagnostic> {
        let artefact = Artefact {
            serial: self.bar.serial.clone(),
            ..crate::artefact::of_file(ArtefactRole::Job, path)?
        };
        Ok(TracedArtefact {
            artefact,
            provenance: Provenance { identity: self.identity(), ..Provenance::default() },
        })
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobBar {
    /// Distance between the ball centres at reading zero, mm; that of the first bar in the list of bars when absent.
    #[serde(default)]
    pub length_mm: f64,
    /// Lowest and highest reading, mm.
    #[serde(deserialize_with = "fixed_array")]
    pub stroke_mm: [f64; 2],
    /// How far every planned reading stays inside the stroke, mm.
    #[serde(default)]
    pub margin_mm: f64,
    /// Standard deviation of one length, um.
    #[serde(default = "default_sigma")]
    pub sigma_um: f64,
    /// Expanded uncertainty (k = 2) of the length by its certificate, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_u_mm: Option<f64>,
    /// Temperature at which the certificate gives the length, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Thermal expansion of the bar, 1/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expansion_per_k: Option<f64>,
    /// How strongly the bar pulls the tool ball towards the base ball, N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Radius of the bar's body, mm, for the distance from obstacles.
    #[serde(default = "default_radius")]
    pub radius_mm: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Number of the certificate of its length, its date YYYY-MM-DD, and the laboratory that issued it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certified_on: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certified_by: Option<String>,
    /// Name or file of the protocol that the bar speaks.
    #[serde(default = "default_protocol")]
    pub protocol: String,
}

fn default_sigma() -> f64 {
    SIGMA_UM
}

fn default_radius() -> f64 {
    15.0
}

fn default_protocol() -> String {
    DEFAULT_PROTOCOL.into()
}

impl JobBar {
    /// Standard uncertainty of the length, mm, if it has a certificate.
    pub fn u_mm(&self) -> Option<f64> {
        self.identity().u_mm()
    }

    fn identity(&self) -> BarIdentity {
        BarIdentity {
            serial: self.serial.clone(),
            certificate: self.certificate.clone(),
            certified_on: self.certified_on.clone(),
            certified_by: self.certified_by.clone(),
            length_mm: Some(self.length_mm),
            length_u_mm: self.length_u_mm,
            temperature_c: self.temperature_c,
            expansion_per_k: self.expansion_per_k,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseBallTable {
    pub id: u32,
    #[serde(deserialize_with = "fixed_array")]
    pub xyz_mm: [f64; 3],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// The axis of its cup, out of the cup, in the robot base.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub cup_axis: Option<[f64; 3]>,
    /// Greatest angle between the bar and the cup's axis, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cup_limit_deg: Option<f64>,
    /// The controller's axis angles, degrees, with the tool ball at this ball's place, when `xyz_mm` was taken from the
    /// controller. When absent: with the orientation of the tool at the start of the run.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub taught_deg: Option<[f64; AXES]>,
}

/// Poses that are chosen among many that can be reached: the most informative ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimiseTable {
    /// Poses to choose for all base balls together.
    pub points: u32,
    #[serde(default)]
    pub criterion: Criterion,
    /// The unknown parameters, as `identify --estimate` lists them, all others being exact; all when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameters: Option<String>,
    /// Poses of a stage: while some poses are barred by the risk of leaving the stroke, this many of the others are chosen,
    /// to be measured before the rest.
    #[serde(default = "default_stage_points")]
    pub stage_points: u32,
    /// Candidates to choose from.
    #[serde(default = "default_candidates")]
    pub candidates: u32,
    /// Lowest and highest corner of the box in which accuracy matters, mm; all of the robot's reach when absent.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub workspace_mm: Option<[[f64; 3]; 2]>,
}

impl Default for OptimiseTable {
    fn default() -> Self {
        Self {
            points: DEFAULT_POINTS,
            criterion: Criterion::default(),
            parameters: None,
            stage_points: default_stage_points(),
            candidates: default_candidates(),
            workspace_mm: None,
        }
    }
}

/// Poses of a job that states no number: about three balls more of them hardly help.
const DEFAULT_POINTS: u32 = 210;

fn default_candidates() -> u32 {
    4000
}

fn default_stage_points() -> u32 {
    20
}

/// The tool: its cup, and how thick it and the arm are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobToolTable {
    /// The tool ball in the frame of the flange, mm; when absent that of the robot file.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub ball_mm: Option<[f64; 3]>,
    /// Standard uncertainty of each of its coordinates, mm; when absent that of the robot file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ball_u_mm: Option<f64>,
    /// The axis of the tool ball's cup, out of the cup, in the flange frame.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub cup_axis: Option<[f64; 3]>,
    /// Greatest angle between the bar and it, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cup_limit_deg: Option<f64>,
    /// Radius of the tool from the flange to its ball, mm.
    pub radius_mm: f64,
    /// Radius of the arm's links, mm.
    pub arm_radius_mm: f64,
}

impl JobToolTable {
    /// Gives a robot the tool ball that the job states. One that is identified keeps what is known of the same ball.
    pub fn state_in(&self, robot: &mut Robot) {
        /// Two statements of one ball do not differ by more, mm.
        const ALIKE_MM: f64 = 1e-9;
        let Some(ball_mm) = self.ball_mm else { return };
        robot.ball_u_mm = self.ball_u_mm.unwrap_or(robot.ball_u_mm);
        let known = robot.controller();
        if known.has_tool && (known.geometry.tool - Vector3::from(ball_mm)).norm() < ALIKE_MM {
            return;
        }
        robot.set_tool(ball_mm);
        robot.nominal.iter_mut().for_each(|nominal| nominal.set_tool(ball_mm));
    }
}

impl Default for JobToolTable {
    fn default() -> Self {
        Self {
            ball_mm: None,
            ball_u_mm: None,
            cup_axis: None,
            cup_limit_deg: None,
            radius_mm: 20.0,
            arm_radius_mm: 150.0,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CircleTable {
    /// Number of the base ball at its centre.
    #[serde(default = "one")]
    pub centre: u32,
    /// Either this or `normal`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<PlaneAxes>,
    /// The normal of its plane in the robot base.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub normal: Option<[f64; 3]>,
    /// The bar's length when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_mm: Option<f64>,
    /// Points in one pass.
    pub points: u32,
    #[serde(default)]
    pub direction: CircleDirection,
    #[serde(default)]
    pub orientation: OrientationPattern,
    /// Greatest turn of the tool about each axis by `seed`, `random` and `optimal`, degrees; 45 when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amplitude_deg: Option<f64>,
    /// The turn of the tool at each point by `optimal`, degrees about Z, Y, X; chosen when planning.
    #[serde(default, skip_serializing_if = "Vec::is_empty", deserialize_with = "fixed_array")]
    pub turns_deg: Vec<[f64; 3]>,
    /// A constant tilt of the tool about the base's Y, degrees, which keeps the wrist from its singularity: the base
    /// orientation is R0 = Ry(tilt) Rx(180) Rz(spin).
    #[serde(default)]
    pub tilt_deg: f64,
    /// A constant turn of the tool about its own axis, degrees, which shifts the range of axis 6.
    #[serde(default)]
    pub spin_deg: f64,
    /// Angle of the first point from the plane's first axis, degrees.
    #[serde(default)]
    pub start_deg: f64,
    /// Length of the arc, degrees; one of less than 360 has a point at both ends.
    #[serde(default = "whole_circle")]
    pub arc_deg: f64,
    #[serde(default)]
    pub mode: CircleMode,
    /// Feed-in before the first point and overshoot past the last in a continuous circle, degrees.
    #[serde(default = "overshoot")]
    pub overshoot_deg: f64,
}

fn overshoot() -> f64 {
    30.0
}

/// How a circle's points are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CircleMode {
    /// The robot stops at each.
    #[default]
    Dwell,
    /// One motion at the feed for each pass, with a constant orientation of the tool.
    Continuous,
}

fn whole_circle() -> f64 {
    360.0
}

/// A plane by its axes: a circle's angle is 0 at the first axis and 90 degrees at the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum PlaneAxes {
    Xy,
    Xz,
    Yz,
}

/// The sense in which a circle is passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CircleDirection {
    /// Angles grow.
    #[default]
    Ccw,
    /// Angles fall.
    Cw,
    /// First growing, then falling: two passes of all points.
    Both,
}

/// The orientation pattern of the tool along a circle. R0 is the base orientation: the tool points down, Rx(180), turned by
/// the circle's tilt and spin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OrientationPattern {
    /// Constant.
    Fixed,
    /// Rz(q sin 2t) Ry(q sin 3t) Rx(q sin 5t) R0 with t the circle's angle and q the amplitude.
    #[default]
    Seed,
    /// Rz Ry Rx R0 with three angles drawn again for each point, uniform within the amplitude.
    Random,
    /// Rz(t) R0: the tool turns about the vertical as the bar does.
    Turning,
    /// As random, but of many draws for each point the most informative combination.
    Optimal,
}

/// How the robot moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionTable {
    /// Greatest speed of the ball, mm/s.
    pub feed_mm_s: f64,
    /// Greatest speed of the orientation, degrees/s.
    pub turn_deg_s: f64,
    /// Wait after arrival before the strobe, s.
    pub settle_s: f64,
    /// Strobe time at a pose, s.
    pub dwell_s: f64,
    /// The program's $TOOL, X Y Z in mm and A B C in degrees, with its origin in the tool ball; with the flange's
    /// orientation when absent.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub tool: Option<[f64; 6]>,
    /// The program's $BASE in the robot base, X Y Z in mm and A B C in degrees; the robot base when absent.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub base: Option<[f64; 6]>,
    pub outputs: MarkerOutputs,
}

impl Default for MotionTable {
    fn default() -> Self {
        Self {
            feed_mm_s: 40.0,
            turn_deg_s: 40.0,
            settle_s: 0.5,
            dwell_s: 1.0,
            tool: None,
            base: None,
            outputs: MarkerOutputs::default(),
        }
    }
}

/// Digital outputs of the controller that mark the dwells.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MarkerOutputs {
    /// High during a dwell.
    pub strobe: u32,
    /// First and last output of the index, eight in all.
    #[serde(deserialize_with = "fixed_array")]
    pub index: [u32; 2],
}

impl Default for MarkerOutputs {
    fn default() -> Self {
        Self { strobe: 1, index: [9, 16] }
    }
}

/// The limits of a plan besides the robot's own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobLimits {
    /// Least distance of each axis from its limits in the robot file, degrees: the software limits of a controller, offsets of
    /// its mastering and corrections of a program differ from the file by tenths.
    pub min_axis_margin_deg: f64,
    /// Least |A5|, degrees: at 0 the wrist is singular.
    pub min_a5_deg: f64,
    /// Least angle of the elbow from stretched, degrees.
    pub min_elbow_deg: f64,
    /// Least distance of the wrist centre from axis 1, mm.
    pub min_overhead_mm: f64,
    /// Greatest probability that a robot within its tolerance leaves the stroke anywhere on a run in which the bar stays
    /// mounted, with a taught base ball.
    pub max_stroke_risk: f64,
    /// Least distance of bar, tool and arm from the obstacles, mm.
    pub min_clearance_mm: f64,
}

impl Default for JobLimits {
    fn default() -> Self {
        Self {
            min_axis_margin_deg: 0.0,
            min_a5_deg: 5.0,
            min_elbow_deg: 5.0,
            min_overhead_mm: 100.0,
            max_stroke_risk: 1e-3,
            min_clearance_mm: 10.0,
        }
    }
}
