//! The quantities that are checked, their limits, and the worst value of each.

use serde::{Deserialize, Serialize};

use super::job::Job;
use crate::plan::PlanFinding;

/// An axis that turns by more than this within one fine step has jumped, degrees.
pub(super) const JUMP_DEG: f64 = 20.0;

/// A quantity that is checked, in the unit of its name; a risk is a probability.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckQuantity {
    AxisMarginDeg,
    WristDeg,
    ElbowDeg,
    OverheadMm,
    AxisJumpDeg,
    AxisSpeedPercent,
    ReadingLowMm,
    ReadingHighMm,
    /// The greatest risk of any one pose to leave the stroke.
    StrokeRisk,
    /// The risk of leaving the stroke in a whole run in which the bar stays on.
    RunRisk,
    CupDeg,
    ToolCupDeg,
    AxisAccelerationPercent,
    ClearanceMm,
}

/// The side on which the limit of a quantity binds.
#[derive(Clone, Copy, PartialEq)]
enum LimitBound {
    AtLeast,
    AtMost,
}

/// Each quantity with its bound, its description and its unit, in the order of the enum.
const TABLE: [(CheckQuantity, LimitBound, &str, &str); 14] = [
    (CheckQuantity::AxisMarginDeg, LimitBound::AtLeast, "distance from a joint limit", "deg"),
    (CheckQuantity::WristDeg, LimitBound::AtLeast, "|A5| from the wrist singularity", "deg"),
    (CheckQuantity::ElbowDeg, LimitBound::AtLeast, "elbow from stretched", "deg"),
    (CheckQuantity::OverheadMm, LimitBound::AtLeast, "wrist centre from axis 1", "mm"),
    (CheckQuantity::AxisJumpDeg, LimitBound::AtMost, "jump of an axis on the path", "deg"),
    (CheckQuantity::AxisSpeedPercent, LimitBound::AtMost, "axis speed", "%"),
    (CheckQuantity::ReadingLowMm, LimitBound::AtLeast, "lowest reading of the bar", "mm"),
    (CheckQuantity::ReadingHighMm, LimitBound::AtMost, "highest reading of the bar", "mm"),
    (CheckQuantity::StrokeRisk, LimitBound::AtMost, "risk of leaving the stroke at one pose", ""),
    (CheckQuantity::RunRisk, LimitBound::AtMost, "risk of leaving the stroke on the run", ""),
    (CheckQuantity::CupDeg, LimitBound::AtMost, "angle between bar and cup", "deg"),
    (CheckQuantity::ToolCupDeg, LimitBound::AtMost, "angle between bar and the tool's cup", "deg"),
    (CheckQuantity::AxisAccelerationPercent, LimitBound::AtMost, "axis acceleration", "%"),
    (CheckQuantity::ClearanceMm, LimitBound::AtLeast, "distance from an obstacle", "mm"),
];

const _: () = {
    let mut at = 0;
    while at < TABLE.len() {
        assert!(TABLE[at].0 as usize == at);
        at += 1;
    }
};

impl CheckQuantity {
    pub(super) const COUNT: usize = TABLE.len();

    pub(super) fn all() -> impl Iterator<Item = Self> {
        TABLE.iter().map(|entry| entry.0)
    }

    /// Whether the limit is a least value: small values are unsafe.
    pub fn at_least(self) -> bool {
        TABLE[self as usize].1 == LimitBound::AtLeast
    }

    pub fn description(self) -> &'static str {
        TABLE[self as usize].2
    }

    /// The name of the quantity in plan.json, unit included.
    pub fn name(self) -> String {
        serde_json::to_value(self).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
    }

    /// A value as text, with its unit.
    pub fn format(self, value: f64) -> String {
        match TABLE[self as usize].3 {
            "" => format!("{value:.1e}"),
            unit => format!("{value:.3} {unit}"),
        }
    }

    /// What a chosen pose keeps from the limit: with rounded poses the plan's own check finds slightly other values than those by
    /// which the pose was chosen.
    pub(super) fn reserve(self) -> f64 {
        match self {
            Self::AxisMarginDeg | Self::WristDeg | Self::ElbowDeg | Self::CupDeg | Self::ToolCupDeg => 0.1,
            Self::OverheadMm | Self::ClearanceMm => 0.5,
            Self::AxisJumpDeg
            | Self::AxisSpeedPercent
            | Self::AxisAccelerationPercent
            | Self::ReadingLowMm
            | Self::ReadingHighMm
            | Self::StrokeRisk
            | Self::RunRisk => 0.0,
        }
    }

    /// The limit in a job, for a pose about base ball `ball` (from 1).
    pub(super) fn limit(self, job: &Job, ball: u32) -> f64 {
        let (limits, bar) = (&job.limits, &job.bar);
        match self {
            Self::AxisMarginDeg => limits.min_axis_margin_deg,
            Self::WristDeg => limits.min_a5_deg,
            Self::ElbowDeg => limits.min_elbow_deg,
            Self::OverheadMm => limits.min_overhead_mm,
            Self::AxisJumpDeg => JUMP_DEG,
            Self::AxisSpeedPercent | Self::AxisAccelerationPercent => 100.0,
            Self::ReadingLowMm => bar.stroke_mm[0] + bar.margin_mm,
            Self::ReadingHighMm => bar.stroke_mm[1] - bar.margin_mm,
            Self::StrokeRisk | Self::RunRisk => limits.max_stroke_risk,
            Self::ClearanceMm => limits.min_clearance_mm,
            Self::ToolCupDeg => job.tool.cup_limit_deg.unwrap_or(180.0),
            Self::CupDeg => job.ball(ball).and_then(|table| table.cup_limit_deg).unwrap_or(180.0),
        }
    }
}

/// The worst value of a quantity, over the plan or on the way to one row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanCheck {
    pub quantity: CheckQuantity,
    /// The value nearest to the limit, or farthest beyond it.
    pub worst: f64,
    pub limit: f64,
    /// The row at or before which it occurs.
    pub row: u32,
}

impl PlanCheck {
    /// Whether the limit is kept; rounding in the last digits does not break it.
    pub fn holds(&self) -> bool {
        self.slack() >= -1e-9
    }

    /// Distance of the value from its limit, negative beyond it.
    pub(super) fn slack(&self) -> f64 {
        if self.quantity.at_least() { self.worst - self.limit } else { self.limit - self.worst }
    }
}

impl std::fmt::Display for PlanCheck {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let &Self { quantity, worst, limit, row } = self;
        let bound = if quantity.at_least() { "at least" } else { "at most" };
        let (worst, limit) = (quantity.format(worst), quantity.format(limit));
        write!(out, "row {row}: {}: {worst}, must be {bound} {limit}", quantity.description())
    }
}

impl From<&PlanCheck> for PlanFinding {
    fn from(check: &PlanCheck) -> Self {
        let &PlanCheck { quantity, worst, limit, row } = check;
        let name = quantity.name();
        match quantity {
            CheckQuantity::AxisMarginDeg
            | CheckQuantity::WristDeg
            | CheckQuantity::ElbowDeg
            | CheckQuantity::OverheadMm => Self::ArmBelow { row, quantity: name, worst, limit },
            CheckQuantity::AxisJumpDeg => Self::ArmAbove { row, quantity: name, worst, limit },
            CheckQuantity::AxisSpeedPercent | CheckQuantity::AxisAccelerationPercent => {
                Self::TooFast { row, quantity: name, worst, limit }
            }
            CheckQuantity::ReadingLowMm => Self::ReadingBelow { row, quantity: name, worst, limit },
            CheckQuantity::ReadingHighMm => Self::ReadingAbove { row, quantity: name, worst, limit },
            CheckQuantity::StrokeRisk | CheckQuantity::RunRisk => {
                Self::StrokeRisk { row, quantity: name, worst, limit }
            }
            CheckQuantity::CupDeg | CheckQuantity::ToolCupDeg => {
                Self::CupAngle { row, quantity: name, worst, limit }
            }
            CheckQuantity::ClearanceMm => Self::Obstacle { row, quantity: name, worst, limit },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::job;

    /// The bar of the example reads -2 to 6 mm with a margin of 0.5 mm.
    #[test]
    fn limits_are_those_of_the_job() {
        let mut job = job("");
        job.centres[0].cup_limit_deg = Some(70.0);
        job.limits.min_clearance_mm = 12.0;
        job.limits.min_axis_margin_deg = 2.5;
        for (quantity, limit) in [
            (CheckQuantity::ReadingLowMm, -1.5),
            (CheckQuantity::ReadingHighMm, 5.5),
            (CheckQuantity::AxisMarginDeg, 2.5),
            (CheckQuantity::AxisSpeedPercent, 100.0),
            (CheckQuantity::AxisAccelerationPercent, 100.0),
            (CheckQuantity::StrokeRisk, 1e-3),
            (CheckQuantity::RunRisk, 1e-3),
            (CheckQuantity::CupDeg, 70.0),
            (CheckQuantity::ToolCupDeg, 180.0),
            (CheckQuantity::ClearanceMm, 12.0),
            (CheckQuantity::WristDeg, 5.0),
            (CheckQuantity::OverheadMm, 100.0),
        ] {
            assert_eq!(quantity.limit(&job, 1), limit, "{quantity:?}");
        }
    }

    #[test]
    fn value_at_its_limit_holds_and_beyond_it_does_not() {
        let check = |quantity, worst| PlanCheck { quantity, worst, limit: 5.0, row: 1 };
        for (quantity, good, bad) in [(CheckQuantity::WristDeg, 5.5, 4.5), (CheckQuantity::CupDeg, 4.5, 5.5)]
        {
            assert!(check(quantity, good).holds() && check(quantity, 5.0).holds());
            assert!(!check(quantity, bad).holds() && !check(quantity, f64::NAN).holds());
            assert_eq!([check(quantity, good).slack(), check(quantity, bad).slack()], [0.5, -0.5]);
        }
    }

    #[test]
    fn quantities_are_printed_with_their_unit() {
        assert_eq!(CheckQuantity::WristDeg.format(5.0), "5.000 deg");
        assert_eq!(CheckQuantity::RunRisk.format(0.00123), "1.2e-3");
        assert_eq!(CheckQuantity::ReadingLowMm.name(), "reading_low_mm");
    }
}
