//! What of a sound job has no effect.

use super::{Job, ObstacleTable};
use crate::catalogue::JobFinding;
use crate::robot::Robot;

impl Job {
    /// Balls that no circle is around, where circles are given, and floors that this robot does not reach.
    pub fn without_effect(&self, robot: &Robot) -> Vec<JobFinding> {
        let is_used = |ball: u32| self.circles.iter().any(|circle| circle.centre == ball);
        let given = self.optimise.is_none() && !self.circles.is_empty();
        let unused = self.centres.iter().map(|table| table.id).filter(|ball| given && !is_used(*ball));
        let hand_mm = robot.geometry.rows[5].d.abs() + robot.geometry.tool.norm();
        let lowest_mm = -(robot.reach_mm() + hand_mm);
        let floors = self.obstacles.iter().filter_map(|obstacle| match *obstacle {
            ObstacleTable::Floor { z_mm } if z_mm < lowest_mm => {
                Some(JobFinding::FloorBelow { z_mm, lowest_mm })
            }
            _ => None,
        });
        unused.map(|ball| JobFinding::BallWithoutCircle { ball }).chain(floors).collect()
    }
}
