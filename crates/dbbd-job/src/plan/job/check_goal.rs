//! Checks a goal, and the tables that only a goal needs.

use super::check::JobCheck;
use super::values::JobTable;
use super::{BarChoiceTable, GoalTable, Job, JobFinding, PlaceTable};
use dbbd_model::plausibility::Quantity;

impl Job {
    /// Checks the goal, and the tables that only a goal needs.
    pub(super) fn check_goal(&self) -> JobCheck {
        for (at, place) in self.places.iter().enumerate() {
            place.check(JobTable::nth("[[place]]", at))?;
        }
        for (at, bar) in self.bar_choices.iter().enumerate() {
            bar.check(JobTable::nth("[[bar_choice]]", at))?;
        }
        let Some(goal) = &self.goal else {
            let header = if self.places.is_empty() { "[[bar_choice]]" } else { "[[place]]" };
            let needs = !self.places.is_empty() || !self.bar_choices.is_empty();
            return JobTable::nth(header, 0).ensure("", !needs, || JobFinding::OnlyWithGoal);
        };
        goal.check(self)
    }
}

impl GoalTable {
    fn check(&self, job: &Job) -> JobCheck {
        let table = JobTable::new("[goal]");
        table.check("position_mm", self.position_mm, Quantity::PositionGoal)?;
        for (key, value, quantity) in [
            ("minutes", self.minutes, Quantity::RunMinutes),
            ("minutes_per_ball", Some(self.minutes_per_ball), Quantity::MountingMinutes),
            ("minutes_per_bar", Some(self.minutes_per_bar), Quantity::MountingMinutes),
            ("seconds_per_pose", self.seconds_per_pose, Quantity::PoseSeconds),
        ] {
            value.map_or(Ok(()), |value| table.check(key, value, quantity))?;
        }
        if let Some([low, high]) = self.region_mm {
            table.corners("region_mm", low, high)?;
            table.large("region_mm", std::array::from_fn(|axis| high[axis] - low[axis]))?;
        }
        let contradicted = [
            (self.region_mm.is_some() && self.program.is_some(), "program", "region_mm"),
            (!self.tools.is_empty() && self.program.is_some(), "program", "[[goal.tool]]"),
        ];
        for (is_contradicted, key, other) in contradicted {
            table.ensure(key, !is_contradicted, || JobFinding::GoalTwice { other: other.into() })?;
        }
        for (at, tool) in self.tools.iter().enumerate() {
            let table = JobTable::nth("[[goal.tool]]", at);
            tool.xyz_mm.iter().try_for_each(|mm| table.check("xyz_mm", *mm, Quantity::ArmLength))?;
        }
        table.ensure("", job.circles.is_empty(), || JobFinding::GoalWithCircles)
    }
}

impl PlaceTable {
    fn check(&self, table: JobTable) -> JobCheck {
        match (self.xyz_mm, self.box_mm) {
            (Some(xyz_mm), None) => table.finite("xyz_mm", &xyz_mm)?,
            (None, Some([low, high])) => {
                table.finite("box_mm", low.iter().chain(&high))?;
                let ordered = low.iter().zip(&high).all(|(low, high)| low <= high);
                table.ensure("box_mm", ordered, || JobFinding::CornersSwapped { key: "box_mm".into() })?;
                table.large("box_mm", std::array::from_fn(|axis| high[axis] - low[axis]))?;
            }
            (Some(_), Some(_)) | (None, None) => return Err(table.wrong("", JobFinding::PointOrBox)),
        }
        self.cup_axis.map_or(Ok(()), |axis| table.direction("cup_axis", axis))?;
        self.cup_limit_deg.map_or(Ok(()), |limit| table.check("cup_limit_deg", limit, Quantity::HalfTurn))
    }
}

impl BarChoiceTable {
    fn check(&self, table: JobTable) -> JobCheck {
        table.check("length_mm", self.length_mm, Quantity::BarLength)?;
        let u_mm = self.length_u_mm;
        u_mm.map_or(Ok(()), |u_mm| table.check("length_u_mm", u_mm, Quantity::ExpandedLengthUncertainty))
    }
}
