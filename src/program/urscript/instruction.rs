//! The instructions that move, as they are written: `movej`, `movel` and `movec`.

use crate::program::script::statement::{Kind, Statement};
use crate::program::script::value::{self, Argument, Expression, Of, Value};
use crate::program::{Motion, Target};
use crate::robot::Pose;

/// A motion with its arguments by the names of the manual.
pub(super) struct Instruction<'s> {
    pub(super) motion: Motion,
    arguments: &'s [Argument],
    names: &'static [&'static str],
}

/// The names of the arguments, in order; the first two or three are the points.
const MOTIONS: [(&str, Motion, &[&str]); 3] = [
    ("movej", Motion::Ptp, &["q", "a", "v", "t", "r"]),
    ("movel", Motion::Lin, &["pose", "a", "v", "t", "r"]),
    ("movec", Motion::Circ, &["pose_via", "pose_to", "a", "v", "r", "mode"]),
];

pub(super) fn motion(statement: &Statement) -> Option<Instruction<'_>> {
    let Kind::Call { name, arguments } = &statement.kind else { return None };
    let (_, motion, names) = *MOTIONS.iter().find(|(known, ..)| known == name)?;
    Some(Instruction { motion, arguments, names })
}

/// An argument by its name, or by its place among the names of all.
pub(super) fn argument<'a>(arguments: &'a [Argument], names: &[&str], name: &str) -> Option<&'a Expression> {
    let named = arguments.iter().find(|argument| argument.name.as_deref() == Some(name));
    let placed = || {
        let at = names.iter().position(|known| *known == name)?;
        arguments.get(at).filter(|argument| argument.name.is_none())
    };
    named.or_else(placed)?.value.as_ref()
}

impl Instruction<'_> {
    /// The points, the auxiliary one first.
    pub(super) fn points(&self) -> Vec<&Expression> {
        let count = if self.motion == Motion::Circ { 2 } else { 1 };
        self.names.iter().take(count).filter_map(|name| argument(self.arguments, self.names, name)).collect()
    }

    /// A number among the arguments, in the units of the language.
    pub(super) fn number(&self, name: &str, lookup: &dyn Fn(&str) -> Option<Value>) -> Option<f64> {
        value::value(argument(self.arguments, self.names, name)?, 0, lookup)?.number()
    }
}

/// A pose `p[x,y,z,rx,ry,rz]` in metres and as a rotation vector.
pub(super) fn pose(value: &Value) -> Option<Pose> {
    let Of::Pose(_) = value.of else { return None };
    let [x, y, z, rx, ry, rz]: [f64; 6] = value.numbers()?;
    Some(Pose::from_rotation_vector([1e3 * x, 1e3 * y, 1e3 * z], [rx, ry, rz]))
}

/// Where a value sends the robot: a pose, or six axis angles in rad.
pub(super) fn target(value: &Value) -> Option<Target> {
    if let Some(pose) = pose(value) {
        let (xyz_mm, abc_deg) = (pose.position.into(), pose.abc_deg());
        return Some(Target::Pose { xyz_mm, abc_deg, status: None, turn: None });
    }
    Some(Target::Axes(value.numbers::<6>()?.map(f64::to_degrees)))
}
