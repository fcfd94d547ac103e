//! The joint axes of an arm as lines in space, and the robot with their table.

use dbbd_model::estimation::Workspace;
use dbbd_model::robot::{AXES, ArmLoad, ArmTable, ControllerFrames, DhRow, JointAxis, Pose, Robot};

use super::catalogue::DescriptionFinding;

/// A robot as its controller knows it.
#[derive(Clone, Debug)]
pub struct ImportedRobot {
    pub robot: Robot,
    /// Findings about a base or flange of the controller that differs from the table's, and about what the description does not say.
    pub findings: Vec<DescriptionFinding>,
    /// The largest distance between the flanges of table and description over [`CHECKED_POSES`] poses, mm.
    pub largest_mm: f64,
}

/// Poses over which the table is compared with the description.
pub const CHECKED_POSES: usize = 1000;
/// Largest difference between equal frames, mm and rad: descriptions have six digits.
const SAME_MM: f64 = 1e-3;
const SAME_RAD: f64 = 1e-5;

/// The joint axes and the flange of an arm where all axis angles are zero.
#[derive(Clone, Debug)]
pub(super) struct ArmLines {
    pub axes: [JointAxis; AXES],
    /// 1, or -1 where the controller counts an axis against the direction of its line.
    pub signs: [f64; AXES],
    pub flange: Pose,
}

impl ArmLines {
    /// The flange at axis angles (rad): the turns about the lines, one after the other.
    pub(super) fn flange_at(&self, angles: &[f64; AXES]) -> Pose {
        let turn = |(axis, sign): (&JointAxis, &f64), angle: f64| {
            let turn = Pose::from_rotation_vector([0.0; 3], (axis.direction * (sign * angle)).into());
            let position = axis.point - turn.rotation * axis.point;
            Pose { position, ..turn }
        };
        let moved = self.axes.iter().zip(&self.signs).zip(angles).map(|(axis, angle)| turn(axis, *angle));
        moved.fold(Pose::identity(), |before, next| before.then(&next)).then(&self.flange)
    }

    /// The table of these lines, with their senses.
    pub(super) fn table(&self) -> ArmTable {
        let table = ArmTable::of(&self.axes, &self.flange);
        let rows = std::array::from_fn(|at| DhRow { sign: self.signs[at], ..table.rows[at] });
        ArmTable { rows, ..table }
    }

    /// The same robot with the table of these lines. `world` is the frame of the lines in the World of the controller.
    pub(super) fn imported(&self, mut robot: Robot, world: &Pose) -> ImportedRobot {
        let table = self.table();
        robot.set_rows(table.rows);
        let poses = Workspace::uniform(&robot, CHECKED_POSES, 1);
        let off = |axes: &[f64; AXES]| {
            let found = table.base.then(&robot.geometry.rigid().flange(axes)).then(&table.flange);
            (found.position - self.flange_at(axes).position).norm()
        };
        let largest_mm = poses.iter().map(off).fold(0.0, f64::max);
        let null = Pose::identity();
        let same = |pose: Pose| Pose {
            position: if pose.position.norm() < SAME_MM { null.position } else { pose.position },
            rotation: if pose.angle_to(&null) < SAME_RAD { null.rotation } else { pose.rotation },
        };
        robot.frames = ControllerFrames { base: same(world.then(&table.base)), flange: same(table.flange) };
        let ControllerFrames { base, flange } = robot.frames;
        // An upright robot keeps the gravity that its type states.
        if base.rotation != null.rotation {
            robot.geometry.load.gravity = base.rotation.transpose() * ArmLoad::DOWN;
        }
        let base = (base != null).then(|| DescriptionFinding::BaseElsewhere { frame: shown(&base) });
        let flange = (flange != null).then(|| DescriptionFinding::FlangeElsewhere { frame: shown(&flange) });
        ImportedRobot { robot, findings: base.into_iter().chain(flange).collect(), largest_mm }
    }
}

/// A pose as X, Y, Z in mm and A, B, C in degrees.
fn shown(pose: &Pose) -> String {
    pose.xyzabc().map(|value| format!("{:.4}", value + 0.0)).join(",")
}
