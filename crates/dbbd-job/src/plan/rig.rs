//! Converts steps into rows: poses as KRL prints them, with the axis angles that the controller computes for them.

use std::ops::Range;

use nalgebra::Vector3;

use super::job::Job;
use super::{BranchRun, MotionKind, PlanKinematics, PlanRow, PlanStep, PoseKind};
use crate::plan::PlanFinding;
use dbbd_model::robot::inverse::{Unsolved, branches, clearance, nearest, status, turn, turns_within};
use dbbd_model::robot::{AXES, BallId, Pose, Robot};

/// The extremes of a run, which show its distance from the limits.
struct RunExtremes {
    /// Lowest and highest angle of each axis and of each joint, degrees.
    axes_deg: [[f64; 2]; AXES],
    joints_deg: [[f64; 2]; AXES],
    /// Least distance of the wrist from the limit about its singularity, degrees.
    wrist_deg: f64,
}

impl RunExtremes {
    fn new() -> Self {
        let none = [[f64::INFINITY, f64::NEG_INFINITY]; AXES];
        Self { axes_deg: none, joints_deg: none, wrist_deg: f64::INFINITY }
    }

    fn add(&mut self, rig: &PlanKinematics<'_>, axes: &[f64; AXES]) {
        let geometry = &rig.controller.geometry;
        let joints = geometry.coupling.joints(axes);
        let ranges = self.axes_deg.iter_mut().zip(axes).chain(self.joints_deg.iter_mut().zip(&joints));
        for ([low, high], angle) in ranges {
            (*low, *high) = (low.min(angle.to_degrees()), high.max(angle.to_degrees()));
        }
        if let Some(clear) = clearance(geometry, axes) {
            self.wrist_deg = self.wrist_deg.min(clear.wrist.to_degrees() - rig.job.limits.min_a5_deg);
        }
    }

    /// The least distance from any limit if the whole run is turned by `turn`, rad.
    fn margin_deg(&self, robot: &Robot, turn: [f64; AXES]) -> f64 {
        let margin = |[low, high]: [f64; 2], [lowest, highest]: [f64; 2], turn: f64| {
            (lowest + turn.to_degrees() - low).min(high - highest - turn.to_degrees())
        };
        let axes = (0..AXES).map(|i| margin(robot.limits_deg[i], self.axes_deg[i], turn[i]));
        let turned = robot.geometry.coupling.joints(&turn);
        let coupled = (0..AXES).filter_map(|i| Some((i, robot.coupled_limits_deg[i]?)));
        let joints = coupled.map(|(i, limits)| margin(limits, self.joints_deg[i], turned[i]));
        axes.chain(joints).fold(self.wrist_deg, f64::min)
    }
}

impl<'a> PlanKinematics<'a> {
    pub(super) fn new(job: &'a Job, robot: &'a Robot) -> Self {
        Self { job, robot, controller: robot.controller(), arm: &robot.geometry }
    }

    /// The pose to command so that the arm comes to `pose`, near axis angles in rad.
    pub(super) fn commanded(&self, pose: &Pose, near: &[f64; AXES]) -> Result<Pose, Unsolved> {
        if self.robot.nominal.is_none() {
            return Ok(*pose);
        }
        Ok(self.controller.geometry.ball(&nearest(self.arm, pose, near)?))
    }

    /// The axis angles, rad, at which the arm has its tool ball at the job's place of base ball `ball` (from 1), with the
    /// orientation that the tool has at `start`; `None` if they are beyond the limits.
    pub(super) fn touching(&self, ball: u32, start: &[f64; AXES]) -> Option<[f64; AXES]> {
        let geometry = self.arm;
        let position = Vector3::from(self.job.ball(ball)?.xyz_mm);
        let pose = Pose { rotation: geometry.ball(start).rotation, position };
        let min_deg = self.job.limits.min_axis_margin_deg;
        nearest(geometry, &pose, start).ok().filter(|axes| self.controller.limit_margin_deg(axes) >= min_deg)
    }

    /// Axis angles of the first step in each branch that has a turn within the limits.
    pub(super) fn starts(&self, first: &PlanStep) -> Result<Vec<[f64; AXES]>, Unsolved> {
        if let Some(axes) = first.axes {
            return Ok(vec![axes]);
        }
        let all = branches(self.arm, &first.pose)?;
        let turns = |axes: &&[f64; AXES]| !turns_within(axes, self.controller).is_empty();
        let within: Vec<_> = all.iter().filter(turns).copied().collect();
        // If all branches are beyond the limits, the findings say by how much.
        Ok(if within.is_empty() { all } else { within })
    }

    /// The rows of a run of steps, followed from `start` in its branch.
    pub(super) fn follow(
        &self,
        steps: &[PlanStep],
        first_index: u32,
        start: &[f64; AXES],
    ) -> Result<BranchRun, PlanFinding> {
        let frames = self.job.motion.frames();
        let mut near = *start;
        // The robot's axis angles before a pass: the auxiliary points of the pass are far away on its circle.
        let mut before_pass = None;
        let mut rows = Vec::with_capacity(steps.len());
        let mut extremes = RunExtremes::new();
        for ((index, step), next) in
            (first_index..).zip(steps).zip(steps.iter().skip(1).map(Some).chain([None]))
        {
            let auxiliary =
                |step: &PlanStep| step.kind == PoseKind::Transit && step.motion == MotionKind::Circ;
            if auxiliary(step) && next.is_some_and(auxiliary) {
                before_pass = Some(near);
            } else if !auxiliary(step) {
                near = before_pass.take().unwrap_or(near);
            }
            near = step.axes.unwrap_or(near);
            let failed = |why| unreachable(index, step.pose.position.into(), &why);
            let commanded = self.commanded(&step.pose, &near).map_err(failed)?;
            let (xyz_mm, abc_deg) = frames.as_driven(frames.as_printed(&commanded));
            let rounded = Pose::from_kuka(xyz_mm, abc_deg);
            near = nearest(&self.controller.geometry, &rounded, &near).map_err(failed)?;
            let axes_deg = near.map(|a| if a.to_degrees().abs() < 1e-6 { 0.0 } else { a.to_degrees() });
            let axes = axes_deg.map(f64::to_radians);
            extremes.add(self, &axes);
            let (centre, table) = BallId::new(step.centre)
                .zip(self.job.ball(step.centre))
                .ok_or(PlanFinding::NoSuchBall { ball: step.centre, balls: self.job.centres.len() })?;
            rows.push(PlanRow {
                index,
                circle: step.circle,
                centre,
                kind: step.kind,
                motion: step.motion,
                xyz_mm,
                abc_deg,
                axes_deg,
                status: status(&self.controller.geometry, &axes),
                turn: turn(&axes),
                length_mm: self.arm.length(&axes, &table.xyz_mm.into(), 0.0),
                dwell_s: step.dwell_s,
            });
        }
        let given = steps.first().is_some_and(|first| first.axes.is_some());
        let within = turns_within(start, self.controller);
        let starts = if given || within.is_empty() { vec![*start] } else { within };
        let margin_deg = |turned: &[f64; AXES]| {
            extremes.margin_deg(self.controller, std::array::from_fn(|i| turned[i] - start[i]))
        };
        Ok(BranchRun {
            rows,
            starts: starts.into_iter().map(|turned| (margin_deg(&turned), turned)).collect(),
        })
    }
}

pub(super) fn unreachable(row: u32, xyz_mm: [f64; 3], why: &Unsolved) -> PlanFinding {
    let [x_mm, y_mm, z_mm] = xyz_mm;
    PlanFinding::Unreachable { row, x_mm, y_mm, z_mm, why: why.to_string() }
}

/// The runs of steps in which the bar stays on: each begins with a PTP motion to a pose at which the robot is not yet.
pub(super) fn runs(steps: &[PlanStep]) -> Vec<Range<usize>> {
    let begins: Vec<usize> = (0..steps.len())
        .filter(|&i| steps[i].motion == MotionKind::Ptp && !(i > 0 && steps[i].pose == steps[i - 1].pose))
        .collect();
    let ends = begins.iter().skip(1).copied().chain([steps.len()]);
    begins.iter().copied().zip(ends).map(|(first, past)| first..past).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::{job, robot};

    fn extremes(rig: &PlanKinematics<'_>, all_deg: &[[f64; AXES]]) -> RunExtremes {
        let mut extremes = RunExtremes::new();
        for deg in all_deg {
            extremes.add(rig, &deg.map(f64::to_radians));
        }
        extremes
    }

    /// Limits of the KR 60: A1 +-185, A2 -135 to 35, A3 -120 to 158, A5 +-119 degrees; the wrist keeps 5 degrees.
    #[test]
    fn margin_of_a_run_is_the_least_distance_from_any_limit() {
        let (job, robot) = (job(""), robot());
        let rig = PlanKinematics::new(&job, &robot);
        let margin = |all_deg: &[[f64; AXES]], turn: [f64; AXES]| {
            extremes(&rig, all_deg).margin_deg(&robot, turn.map(f64::to_radians))
        };
        let middle = [0.0, -60.0, 90.0, 0.0, 60.0, 0.0];
        let with = |axis: usize, deg: f64| {
            let mut axes = middle;
            axes[axis] = deg;
            axes
        };
        for (all_deg, expected) in [
            (vec![middle], 55.0),
            (vec![middle, with(0, 172.0), with(0, -10.0)], 13.0),
            (vec![middle, with(1, 24.0), with(1, -120.0)], 11.0),
            (vec![middle, with(1, -128.0)], 7.0),
            (vec![middle, with(2, 160.0)], -2.0),
            (vec![middle, with(4, 12.0)], 7.0),
            (vec![middle, with(4, -116.0)], 3.0),
        ] {
            assert!((margin(&all_deg, [0.0; AXES]) - expected).abs() < 1e-9, "{all_deg:?}");
        }
        // A whole turn of axis 6 from 20 to 80 degrees ends at 440: 90 beyond its limit of 350.
        let run = [with(5, 20.0), with(5, 80.0)];
        assert!((margin(&run, [0.0, 0.0, 0.0, 0.0, 0.0, 360.0]) + 90.0).abs() < 1e-9);
        assert!((margin(&run, [0.0, 0.0, 0.0, 0.0, 0.0, -360.0]) - 10.0).abs() < 1e-9);
    }

    #[test]
    fn run_begins_with_a_motion_of_the_axes_to_another_pose() {
        let pose = |x| Pose::from_kuka([x, 0.0, 0.0], [0.0; 3]);
        let step = |motion, x| PlanStep {
            circle: 1,
            centre: 1,
            kind: PoseKind::Transit,
            motion,
            pose: pose(x),
            dwell_s: 0.0,
            axes: None,
        };
        let steps = [
            step(MotionKind::Ptp, 0.0),
            step(MotionKind::Lin, 1.0),
            // The next module begins where the robot is: the bar stays on.
            step(MotionKind::Ptp, 1.0),
            step(MotionKind::Lin, 2.0),
            step(MotionKind::Ptp, 5.0),
        ];
        assert_eq!(runs(&steps), [0..4, 4..5]);
        assert!(runs(&[]).is_empty());
    }

    #[test]
    fn followed_row_is_rounded_as_it_is_printed_and_keeps_its_branch() {
        let (job, robot) = (job("[[circle]]\nplane = \"XY\"\npoints = 6\ntilt_deg = 30.0\n"), robot());
        let rig = PlanKinematics::new(&job, &robot);
        let steps = crate::plan::steps::circle_steps(&job).expect("the job is possible");
        let start = rig.starts(&steps[0]).expect("it is in reach")[0];
        let run = rig.follow(&steps[..20], 41, &start).expect("it is in reach");
        assert_eq!(run.rows.iter().map(|row| row.index).collect::<Vec<_>>(), (41..61).collect::<Vec<_>>());
        for (row, step) in run.rows.iter().zip(&steps) {
            let axes = row.axes_deg.map(f64::to_radians);
            let ball = robot.geometry.ball(&axes);
            // 0.5 um for each coordinate, and the effect of 0.00005 degrees at the wrist.
            assert!((ball.position - Vector3::from(row.xyz_mm)).norm() < 1e-6);
            assert!((ball.position - step.pose.position).norm() < 1e-3);
            assert!(row.xyz_mm.iter().all(|x| ((x * 1e3).round() - x * 1e3).abs() < 1e-6));
            assert!((row.length_mm - (ball.position - Vector3::new(1300.0, 0.0, 800.0)).norm()).abs() < 1e-9);
            assert_eq!(row.status, run.rows[0].status);
        }
    }
}
