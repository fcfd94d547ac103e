//! What is checked, how near it came to its limit, and which limit that is.

use serde::{Deserialize, Serialize};

use super::job::{Bar, Job};
use crate::catalogue::PlanFinding;

/// An axis that turns by more than this within one fine step has jumped, degrees.
pub(crate) const JUMP_DEG: f64 = 20.0;

/// What is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Least distance of an axis from its limits, degrees.
    AxisMarginDeg,
    /// Least angle of joint 5 from a straight wrist, degrees.
    WristDeg,
    /// Least angle of the elbow from stretched or folded, degrees.
    ElbowDeg,
    /// Least distance of the wrist centre from axis 1, mm.
    OverheadMm,
    /// Greatest change of an axis within one fine step, degrees.
    AxisJumpDeg,
    /// Greatest axis speed, percent of the axis's greatest.
    AxisSpeedPercent,
    /// Least reading of the bar, mm.
    ReadingLowMm,
    /// Greatest reading of the bar, mm.
    ReadingHighMm,
    /// Greatest probability, of any one pose, of a reading outside the stroke.
    StrokeRisk,
    /// Probability of such a reading anywhere on a run in which the bar stays on.
    RunRisk,
    /// Greatest angle between bar and cup, degrees.
    CupDeg,
    /// Greatest angle between bar and the tool's cup, degrees.
    ToolCupDeg,
    /// Greatest axis acceleration, percent of the axis's greatest.
    AxisAccelerationPercent,
    /// Least distance of bar, tool or arm from an obstacle, mm.
    ClearanceMm,
}

impl Quantity {
    pub(crate) const ALL: [Self; 14] = [
        Self::AxisMarginDeg,
        Self::WristDeg,
        Self::ElbowDeg,
        Self::OverheadMm,
        Self::AxisJumpDeg,
        Self::AxisSpeedPercent,
        Self::ReadingLowMm,
        Self::ReadingHighMm,
        Self::StrokeRisk,
        Self::RunRisk,
        Self::CupDeg,
        Self::ToolCupDeg,
        Self::AxisAccelerationPercent,
        Self::ClearanceMm,
    ];

    /// Whether small values are the unsafe ones.
    pub fn at_least(self) -> bool {
        matches!(
            self,
            Self::AxisMarginDeg
                | Self::WristDeg
                | Self::ElbowDeg
                | Self::OverheadMm
                | Self::ReadingLowMm
                | Self::ClearanceMm
        )
    }

    /// The name that it has in plan.json, unit included.
    pub fn name(self) -> String {
        serde_json::to_value(self).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
    }

    /// A value with its unit, for people.
    pub fn shown(self, value: f64) -> String {
        match self.words().1 {
            "" => format!("{value:.1e}"),
            unit => format!("{value:.3} {unit}"),
        }
    }

    /// In words, and the unit.
    pub fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::AxisMarginDeg => ("distance from a joint limit", "deg"),
            Self::WristDeg => ("|A5| from the wrist singularity", "deg"),
            Self::ElbowDeg => ("elbow from stretched", "deg"),
            Self::OverheadMm => ("wrist centre from axis 1", "mm"),
            Self::AxisJumpDeg => ("jump of an axis on the path", "deg"),
            Self::AxisSpeedPercent => ("axis speed", "%"),
            Self::ReadingLowMm => ("lowest reading of the bar", "mm"),
            Self::ReadingHighMm => ("highest reading of the bar", "mm"),
            Self::StrokeRisk => ("risk of leaving the stroke at one pose", ""),
            Self::RunRisk => ("risk of leaving the stroke on the run", ""),
            Self::CupDeg => ("angle between bar and cup", "deg"),
            Self::ToolCupDeg => ("angle between bar and the tool's cup", "deg"),
            Self::AxisAccelerationPercent => ("axis acceleration", "%"),
            Self::ClearanceMm => ("distance from an obstacle", "mm"),
        }
    }
}

/// The worst value of a quantity, over the plan or on the way to one row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// What was checked.
    pub quantity: Quantity,
    /// The value nearest to the limit, or beyond it.
    pub worst: f64,
    /// The limit.
    pub limit: f64,
    /// The row at or before which it occurs.
    pub row: u32,
}

impl Check {
    /// Whether the limit is kept; rounding in the last digits breaks none.
    pub fn holds(&self) -> bool {
        if self.quantity.at_least() {
            self.worst >= self.limit - 1e-9
        } else {
            self.worst <= self.limit + 1e-9
        }
    }
}

impl std::fmt::Display for Check {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let bound = if self.quantity.at_least() { "at least" } else { "at most" };
        let shown = |value: f64| self.quantity.shown(value);
        let (words, _) = self.quantity.words();
        write!(out, "row {}: {words}: {}, must be {bound} {}", self.row, shown(self.worst), shown(self.limit))
    }
}

impl From<&Check> for PlanFinding {
    fn from(check: &Check) -> Self {
        let &Check { quantity, worst, limit, row } = check;
        let name = quantity.name();
        match quantity {
            Quantity::AxisMarginDeg | Quantity::WristDeg | Quantity::ElbowDeg | Quantity::OverheadMm => {
                Self::ArmBelow { row, quantity: name, worst, limit }
            }
            Quantity::AxisJumpDeg => Self::ArmAbove { row, quantity: name, worst, limit },
            Quantity::AxisSpeedPercent | Quantity::AxisAccelerationPercent => {
                Self::TooFast { row, quantity: name, worst, limit }
            }
            Quantity::ReadingLowMm => Self::ReadingBelow { row, quantity: name, worst, limit },
            Quantity::ReadingHighMm => Self::ReadingAbove { row, quantity: name, worst, limit },
            Quantity::StrokeRisk | Quantity::RunRisk => {
                Self::StrokeRisk { row, quantity: name, worst, limit }
            }
            Quantity::CupDeg | Quantity::ToolCupDeg => Self::CupAngle { row, quantity: name, worst, limit },
            Quantity::ClearanceMm => Self::Obstacle { row, quantity: name, worst, limit },
        }
    }
}

fn within_margin(bar: &Bar) -> [f64; 2] {
    [bar.stroke_mm[0] + bar.margin_mm, bar.stroke_mm[1] - bar.margin_mm]
}

/// The limit of a quantity.
pub(crate) fn limit(job: &Job, centre: u32, quantity: Quantity) -> f64 {
    let limits = &job.limits;
    match quantity {
        Quantity::AxisMarginDeg => 0.0,
        Quantity::WristDeg => limits.min_a5_deg,
        Quantity::ElbowDeg => limits.min_elbow_deg,
        Quantity::OverheadMm => limits.min_overhead_mm,
        Quantity::AxisJumpDeg => JUMP_DEG,
        Quantity::AxisSpeedPercent | Quantity::AxisAccelerationPercent => 100.0,
        Quantity::ReadingLowMm => within_margin(&job.bar)[0],
        Quantity::ReadingHighMm => within_margin(&job.bar)[1],
        Quantity::StrokeRisk | Quantity::RunRisk => limits.max_stroke_risk,
        Quantity::ClearanceMm => limits.min_clearance_mm,
        Quantity::ToolCupDeg => job.tool.cup_limit_deg.unwrap_or(180.0),
        Quantity::CupDeg => job.ball(centre).and_then(|table| table.cup_limit_deg).unwrap_or(180.0),
    }
}
