//! The predicted position uncertainty of a tool at the points of a program: of the program as it is, which assumes the
//! nominal robot, and of the corrected program.

use nalgebra::{DMatrix, Vector3};
use serde::Serialize;

use super::position::{AlignedPoses, Positions};
use super::workspace::take_out_rigid_motion_of;
use crate::measurement::{ApproachedPose, ToolPoint};
use crate::robot::{AXES, Robot};

/// Predicted position uncertainty at points: the root mean square of the 3-D error that is expected at a point, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PointUncertainty {
    /// Mean over the points.
    pub mean: f64,
    pub max: f64,
}

impl PointUncertainty {
    fn of(errors_mm: impl Iterator<Item = f64> + Clone) -> Self {
        let count = errors_mm.clone().count().max(1) as f64;
        Self { mean: errors_mm.clone().sum::<f64>() / count, max: errors_mm.fold(0.0, f64::max) }
    }
}

/// The predicted position uncertainty of the program's own tool, after the best rigid alignment over its datum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ProgramUncertainty {
    /// Uncertainty of the program as it is: the distance of the identified robot from the nominal one, and the
    /// uncertainty of the identified robot.
    pub before: PointUncertainty,
    /// Uncertainty of the corrected program: that of the identified robot, with the repeatability of a pose.
    pub after: PointUncertainty,
    /// The share of the flange's tolerance in `after`.
    pub flange: PointUncertainty,
}

impl ProgramUncertainty {
    /// The uncertainty of an identified robot at points; `None` without points. `datum` are poses (axis angles, rad).
    /// If there are none, the points of each tool are aligned by themselves; fewer than 10 points are aligned with
    /// poses of the workspace.
    pub fn of(robot: &Robot, points: &[ToolPoint], datum: &[[f64; AXES]]) -> Option<Self> {
        let mut tools: Vec<Vector3<f64>> = Vec::new();
        for point in points {
            if !tools.contains(&point.tool) {
                tools.push(point.tool);
            }
        }
        let of_tool = |tool: &Vector3<f64>| {
            let own = points.iter().filter(|point| point.tool == *tool);
            errors(robot, tool, &own.map(|point| point.pose).collect::<Vec<_>>(), datum)
        };
        let errors: Vec<[f64; 3]> = tools.iter().flat_map(of_tool).collect();
        (!errors.is_empty()).then(|| Self {
            before: PointUncertainty::of(errors.iter().map(|[before, ..]| *before)),
            after: PointUncertainty::of(errors.iter().map(|[_, after, _]| *after)),
            flange: PointUncertainty::of(errors.iter().map(|[.., flange]| *flange)),
        })
    }

    /// Whether a correction makes the uncertainty smaller by more than a tenth, without the share of the flange, which it leaves as it
    /// is. Otherwise the correction is smaller than its own uncertainty.
    pub fn is_better(&self) -> bool {
        let rest = |mean: f64| (mean * mean - self.flange.mean * self.flange.mean).max(0.0).sqrt();
        rest(self.after.mean) < 0.9 * rest(self.before.mean)
    }
}

/// The errors before and after at each pose of one tool, and the share of the flange in the latter, mm.
fn errors(
    robot: &Robot,
    tool: &Vector3<f64>,
    poses: &[ApproachedPose],
    datum: &[[f64; AXES]],
) -> Vec<[f64; 3]> {
    let mut known_flange = robot.clone();
    known_flange.tolerance.state_flange();
    let [robot, known_flange] = [robot.clone(), known_flange].map(|one| one.with_exact_tool((*tool).into()));
    let mut controller = robot.controller().geometry.clone();
    controller.tool = *tool;
    let aligned = AlignedPoses::of(&robot, poses, datum);
    let (mut off, mut places) = (DMatrix::zeros(3 * aligned.all.len(), 1), Vec::new());
    for (at, pose) in aligned.all.iter().enumerate() {
        let axes = pose.axes.radians();
        let there = robot.geometry.approached(pose.approach).ball(&axes).position;
        let commanded = controller.ball(&axes).position;
        off.fixed_view_mut::<3, 1>(3 * at, 0).copy_from(&(there - commanded));
        places.push(commanded);
    }
    take_out_rigid_motion_of(&mut off, &places, aligned.datum.clone());
    let [all, rest] = [&robot, &known_flange].map(|robot| Positions::aligned(robot, &aligned));
    let of_pose = |at: usize| {
        let (after, without_flange) = (all.sd_mm(at), rest.sd_mm(at));
        let flange = (after * after - without_flange * without_flange).max(0.0).sqrt();
        [off.rows(3 * at, 3).norm().hypot(after), after, flange]
    };
    (0..poses.len()).map(of_pose).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Workspace;
    use crate::robot::{Approach, AxisAngles, Joint, ParamId, RobotUncertainty};

    /// A robot whose second arm is 1 mm longer than nominal, known to 0.1 mm.
    fn identified() -> Robot {
        let nominal = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let unknown = RobotUncertainty {
            parameters: vec![ParamId::A(Joint::J3)],
            root: DMatrix::from_element(1, 1, 0.1),
            pose_mm: 0.0,
            ..nominal.known_uncertainty()
        };
        let mut robot = Robot { nominal: Some(Box::new(nominal.clone())), ..nominal };
        robot.geometry.rows[2].a += 1.0;
        robot.uncertainty = Some(Box::new(unknown));
        robot
    }

    fn points(robot: &Robot, count: usize, tool: Vector3<f64>) -> Vec<ToolPoint> {
        let pose = |axes: &[f64; 6]| ApproachedPose {
            axes: AxisAngles::from_degrees(axes.map(f64::to_degrees)),
            approach: Approach::default(),
        };
        let axes = Workspace::uniform(robot.controller(), count, 5);
        axes.iter().map(|axes| ToolPoint { tool, pose: pose(axes) }).collect()
    }

    /// The same displacement, ten times as large: before is sqrt(1 + 0.1^2) of it, after 0.1, for every tool.
    #[test]
    fn before_is_the_correction_and_what_is_not_known() {
        let robot = identified();
        for (count, tool) in [(40, Vector3::zeros()), (4, Vector3::new(0.0, 100.0, 300.0))] {
            let found = ProgramUncertainty::of(&robot, &points(&robot, count, tool), &[]).unwrap();
            let ratio = found.before.mean / found.after.mean;
            assert!((ratio - 101f64.sqrt()).abs() < 1e-3 * ratio, "{count}: {ratio}");
            assert!(found.after.mean > 0.02 && found.after.max < 0.15 && found.is_better(), "{found:?}");
        }
        assert!(ProgramUncertainty::of(&robot, &[], &[]).is_none());
    }

    #[test]
    fn two_tools_count_by_their_points() {
        let robot = identified();
        let [few, many] =
            [(12, 0.0), (36, 400.0)].map(|(count, z)| points(&robot, count, Vector3::new(0.0, 0.0, z)));
        let mean = |points: &[ToolPoint]| ProgramUncertainty::of(&robot, points, &[]).unwrap().after.mean;
        let both = mean(&[few.clone(), many.clone()].concat());
        assert!((both - 0.25 * mean(&few) - 0.75 * mean(&many)).abs() < 1e-12);
    }

    /// A correction of 0.05 mm that is known to 0.1 mm.
    #[test]
    fn a_correction_that_is_smaller_than_its_uncertainty_does_not_help() {
        let mut robot = identified();
        robot.geometry.rows[2].a -= 0.96;
        let found = ProgramUncertainty::of(&robot, &points(&robot, 40, Vector3::zeros()), &[]).unwrap();
        assert!(!found.is_better(), "{found:?}");
    }

    /// Aligned over the workspace, points near each other have an error that they would share with their own base.
    #[test]
    fn points_near_each_other_are_worse_in_the_datum_of_the_workspace() {
        let robot = identified();
        let near = |at: usize| {
            let axes_deg = [10.0, -60.0, 70.0, 20.0, 40.0, 5.0].map(|deg| deg + 0.3 * at as f64);
            let pose =
                ApproachedPose { axes: AxisAngles::from_degrees(axes_deg), approach: Approach::default() };
            ToolPoint { tool: Vector3::zeros(), pose }
        };
        let points: Vec<ToolPoint> = (0..12).map(near).collect();
        let workspace = Workspace::uniform(robot.controller(), 400, 1);
        let own = ProgramUncertainty::of(&robot, &points, &[]).unwrap();
        let shared = ProgramUncertainty::of(&robot, &points, &workspace).unwrap();
        assert!(shared.before.mean > 5.0 * own.before.mean, "{shared:?} {own:?}");
        // The same poses as datum are the same.
        let axes: Vec<[f64; AXES]> = points.iter().map(|point| point.pose.axes.radians()).collect();
        let again = ProgramUncertainty::of(&robot, &points, &axes).unwrap();
        assert!((again.before.mean - own.before.mean).abs() < 1e-9);
    }
}
