//! The motions of URScript with their arguments: `movej`, `movel` and `movec`.

use crate::program::script::value::{Content, Evaluated, Value};
use crate::program::{MotionKind, Target};
use dbbd_model::robot::Pose;

pub(super) struct Instruction<'a> {
    pub(super) motion: MotionKind,
    arguments: &'a [Evaluated<'a>],
    names: &'static [&'static str],
}

/// Each motion with the names of its arguments in order; the first argument (of an arc, the first two) is a point.
const MOTIONS: [(&str, MotionKind, &[&str]); 3] = [
    ("movej", MotionKind::Ptp, &["q", "a", "v", "t", "r"]),
    ("movel", MotionKind::Lin, &["pose", "a", "v", "t", "r"]),
    ("movec", MotionKind::Circ, &["pose_via", "pose_to", "a", "v", "r", "mode"]),
];

/// Whether a function is one of these motions.
pub(super) fn is_motion(name: &str) -> bool {
    MOTIONS.iter().any(|(known, ..)| *known == name)
}

/// An argument by its name, or by its position in `names`, the names of all arguments.
pub(super) fn argument<'a>(
    arguments: &'a [Evaluated<'a>],
    names: &[&str],
    name: &str,
) -> Option<&'a Evaluated<'a>> {
    let by_name = arguments.iter().find(|argument| argument.name == Some(name));
    let by_position = || {
        let at = names.iter().position(|known| *known == name)?;
        arguments.get(at).filter(|argument| argument.name.is_none())
    };
    by_name.or_else(by_position)
}

impl<'a> Instruction<'a> {
    /// The motion of a call, if the call is one.
    pub(super) fn new(name: &str, arguments: &'a [Evaluated<'a>]) -> Option<Self> {
        let (_, motion, names) = *MOTIONS.iter().find(|(known, ..)| *known == name)?;
        Some(Self { motion, arguments, names })
    }

    /// The points, the auxiliary one first.
    pub(super) fn points(&self) -> impl Iterator<Item = &'a Evaluated<'a>> {
        let count = if self.motion == MotionKind::Circ { 2 } else { 1 };
        let (arguments, names) = (self.arguments, self.names);
        names.iter().take(count).filter_map(move |name| argument(arguments, names, name))
    }

    /// A number among the arguments, in the units of the language.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        argument(self.arguments, self.names, name)?.number()
    }
}

/// A pose `p[x,y,z,rx,ry,rz]` in metres and as a rotation vector.
pub(super) fn pose(value: &Value) -> Option<Pose> {
    let Content::Pose(_) = value.content else { return None };
    let [x, y, z, rx, ry, rz]: [f64; 6] = value.numbers()?;
    Some(Pose::from_rotation_vector([1e3 * x, 1e3 * y, 1e3 * z], [rx, ry, rz]))
}

/// A target: a pose, or six axis angles in rad.
pub(super) fn target(value: &Value) -> Option<Target> {
    match pose(value) {
        Some(pose) => Some(Target::pose(&pose)),
        None => Some(Target::Axes(value.numbers::<6>()?.map(f64::to_degrees))),
    }
}
