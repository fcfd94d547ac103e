//! The bar that a program of a plan holds: its base balls are where the arm had the tool ball when they were taught, and not
//! where the nominal robot has them. A corrected program keeps its distances from the balls as they are mounted.

use nalgebra::Vector3;

use crate::plan::{Plan, PlanRow};
use crate::program::CompensationFinding;
use dbbd_model::robot::{BallId, Pose, Robot};

/// A target farther from every row of the plan has nothing to do with the bar, mm: larger than sync markers and steps aside,
/// smaller than the way to a ball.
const MAX_FROM_ROW_MM: f64 = 20.0;

/// The rows of a plan about its base balls as they are mounted.
pub struct MountedBalls {
    rows: Vec<PlanRow>,
    /// The place of each base ball in the plan, and from there to where it is mounted, mm.
    balls: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// The tool ball of the controller and of the identified robot, in the frame of the flange, mm.
    tools: [Vector3<f64>; 2],
    bar_mm: f64,
    stroke_mm: [f64; 2],
}

impl MountedBalls {
    /// The balls of `plan` as they are mounted in the frame of the identified `robot`; kept balls are those of its
    /// identification.
    ///
    /// # Errors
    /// It is not known where a ball is mounted.
    pub fn of(plan: &Plan, robot: &Robot, are_kept: bool) -> Result<Self, CompensationFinding> {
        // A ball without taught angles is taught at those that the plan states.
        let job = plan.job_as_taught();
        let is_known =
            |at: usize| job.centres[at].taught_deg.is_some() || are_kept && is_identified(robot, at);
        if let Some(at) = (0..job.centres.len()).find(|at| !is_known(*at)) {
            return Err(CompensationFinding::BallNotTaught { ball: job.centres[at].id });
        }
        let mounted = job.mounted(robot, are_kept);
        let places = job.balls().into_iter().zip(mounted.balls());
        Ok(Self {
            rows: plan.rows.clone(),
            balls: places.map(|(plan, now)| (plan.position, now.position - plan.position)).collect(),
            tools: [robot.controller().geometry.tool, robot.geometry.tool],
            bar_mm: job.bar.length_mm,
            stroke_mm: job.bar.stroke_mm,
        })
    }

    /// How a pose of the flange (mm, in the base of the controller's robot) is moved with its ball, mm.
    ///
    /// # Errors
    /// The bar would leave its stroke there.
    pub(super) fn shift(&self, flange: &Pose) -> Result<Vector3<f64>, CompensationFinding> {
        let [nominal, identified] = self.tools.map(|tool| flange.position + flange.rotation * tool);
        let distance = |row: &&PlanRow| (Vector3::from(row.xyz_mm) - nominal).norm();
        let nearest = self.rows.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(row) = nearest.filter(|row| distance(row) <= MAX_FROM_ROW_MM) else {
            return Ok(Vector3::zeros());
        };
        let Some((ball, shift)) = self.balls.get(row.centre.index()) else { return Ok(Vector3::zeros()) };
        let [low_mm, high_mm] = self.stroke_mm;
        let within = low_mm..=high_mm;
        // Where the plan itself is out of the stroke, the bar is not mounted.
        let reading_mm = (identified - ball).norm() - self.bar_mm;
        if within.contains(&(row.length_mm - self.bar_mm)) && !within.contains(&reading_mm) {
            return Err(CompensationFinding::LeavesStroke { row: row.index, reading_mm, low_mm, high_mm });
        }
        Ok(*shift)
    }
}

/// Whether the identification of a robot has the place of a base ball.
fn is_identified(robot: &Robot, at: usize) -> bool {
    robot.posterior.as_ref().is_some_and(|known| known.ball(BallId::at(at)).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::circle_plan;
    use dbbd_model::robot::ParamId;

    /// A ball that was taught with an arm whose third zero is off by 0.1 degrees is where that arm had the tool ball: some
    /// millimetres from where the plan has it. Every target about it moves with it.
    #[test]
    fn targets_move_with_the_ball_as_it_is_mounted() {
        let mut plan = circle_plan::plan(1, 4);
        let nominal = circle_plan::robot();
        let mut robot = nominal.clone();
        let zero: ParamId = "theta3".parse().unwrap();
        *robot.geometry.value_mut(zero).unwrap() += 0.1_f64.to_radians();
        robot.nominal = Some(Box::new(nominal.clone()));
        let refused = MountedBalls::of(&plan, &robot, true).err();
        assert!(matches!(refused, Some(CompensationFinding::BallNotTaught { ball: 1 })));
        let taught = plan.rows[0].axes_deg;
        plan.header.job.centres[0].taught_deg = Some(taught);
        let axes = taught.map(f64::to_radians);
        plan.header.job.centres[0].xyz_mm = nominal.geometry.ball(&axes).position.into();
        let mounted = MountedBalls::of(&plan, &robot, false).unwrap();
        let off = robot.geometry.ball(&axes).position - nominal.geometry.ball(&axes).position;
        assert!(off.norm() > 1.0, "{off}");
        let far = Pose { position: Vector3::new(0.0, 0.0, 5000.0), ..Pose::identity() };
        assert_eq!(mounted.shift(&far).unwrap(), Vector3::zeros());
        let (_, shift) = mounted.balls[0];
        assert!((shift - off).norm() < 1e-9);
    }

    /// With a tool ball that is 3 mm farther out than the controller has it, some reading of a circle is 3 mm off.
    #[test]
    fn a_reading_beyond_the_stroke_is_refused_with_its_row() {
        let mut plan = circle_plan::plan(1, 12);
        plan.header.job.centres[0].taught_deg = Some(plan.rows[0].axes_deg);
        let nominal = circle_plan::robot();
        let mut robot = nominal.clone();
        robot.geometry.tool.z += 3.0;
        robot.geometry.tool.x += 3.0;
        robot.nominal = Some(Box::new(nominal.clone()));
        let mounted = MountedBalls::of(&plan, &robot, false).unwrap();
        let flange = |row: &PlanRow| {
            let ball = Pose::from_kuka(row.xyz_mm, row.abc_deg);
            Pose { position: ball.position - ball.rotation * nominal.geometry.tool, ..ball }
        };
        let refused = plan.rows.iter().find_map(|row| mounted.shift(&flange(row)).err().zip(Some(row.index)));
        let Some((CompensationFinding::LeavesStroke { row, reading_mm, low_mm, high_mm }, index)) = refused
        else {
            panic!("{refused:?}")
        };
        assert_eq!((row, [low_mm, high_mm]), (index, plan.header.job.bar.stroke_mm));
        assert!((1.0..4.3).contains(&reading_mm.abs()), "{reading_mm}");
    }
}
