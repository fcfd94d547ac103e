//! What a run is to reach: the goal of a job, the places where balls can stand, the bars that exist.

use serde::{Deserialize, Serialize};

use dbbd_model::base::fixed_array::fixed_array;
use dbbd_model::estimation::{ErrorSummary, ToolPoses};

/// The position error that is to be left after a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalTable {
    /// The greatest position error of the identified robot, mm.
    pub position_mm: f64,
    /// What it is of all points.
    #[serde(default)]
    pub of: GoalStatistic,
    /// Lowest and highest corner of the box in which the tool works, mm; all of the robot's reach without it and without a program.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub region_mm: Option<[[f64; 3]; 2]>,
    /// A program whose points matter, beside the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
    /// The tools that work; the tool ball when absent.
    #[serde(rename = "tool", default, skip_serializing_if = "Vec::is_empty")]
    pub tools: Vec<GoalTool>,
    /// The minutes that are available.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// Minutes to mount a base ball and to drive the tool ball onto it.
    #[serde(default = "minutes_per_ball")]
    pub minutes_per_ball: f64,
    /// Minutes to mount a bar.
    #[serde(default = "minutes_per_bar")]
    pub minutes_per_bar: f64,
    /// Seconds from one pose to the next; by the job's motion when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds_per_pose: Option<f64>,
    /// The points of the program, which are read when a plan is made.
    #[serde(skip)]
    pub of_program: Vec<ToolPoses>,
}

fn minutes_per_ball() -> f64 {
    3.0
}

fn minutes_per_bar() -> f64 {
    5.0
}

/// The statistic of a position error over points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GoalStatistic {
    #[default]
    Mean,
    /// The error that 95 % of the points keep.
    P95,
    Max,
}

impl GoalStatistic {
    pub fn of(self, error: &ErrorSummary) -> f64 {
        match self {
            Self::Mean => error.mean,
            Self::P95 => error.p95,
            Self::Max => error.max,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::P95 => "95 %",
            Self::Max => "max",
        }
    }
}

/// A point of a tool that works.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalTool {
    /// In the flange frame, mm.
    #[serde(deserialize_with = "fixed_array")]
    pub xyz_mm: [f64; 3],
}

/// Where a base ball can stand: a point, or anywhere in a box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceTable {
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub xyz_mm: Option<[f64; 3]>,
    /// Lowest and highest corner; a table top has one height.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub box_mm: Option<[[f64; 3]; 2]>,
    /// The axis of the cup there, out of the cup, in the robot base.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub cup_axis: Option<[f64; 3]>,
    /// Greatest angle between the bar and that axis, degrees; 90 when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cup_limit_deg: Option<f64>,
}

/// A bar that exists; all else is as in `[bar]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BarChoiceTable {
    pub length_mm: f64,
    /// Expanded uncertainty (k = 2) of the length by its certificate, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_u_mm: Option<f64>,
}
