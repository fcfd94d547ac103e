//! The motion instructions of RAPID with their arguments.

use super::literal::{Holder, speed, tool, work_object};
use crate::program::CompensationFinding;
use crate::program::script::value::{Evaluated, Value};
use crate::program::{Frames, MotionKind};
use dbbd_model::robot::Pose;

/// A motion: `MoveAbsJ`, `MoveJ`, `MoveL` or `MoveC`.
pub(super) struct Instruction<'a> {
    pub(super) motion: MotionKind,
    /// Whether the point is axis angles, which need no frame.
    is_to_axes: bool,
    pub(super) through: Option<&'a Evaluated<'a>>,
    pub(super) to: &'a Evaluated<'a>,
    speed: Option<&'a Evaluated<'a>>,
    zone: Option<&'a Evaluated<'a>>,
    tool: Option<&'a Evaluated<'a>>,
    work_object: Option<&'a Evaluated<'a>>,
    /// Duration by `\T`, s.
    pub(super) time: Option<&'a Evaluated<'a>>,
}

const MOTIONS: [(&str, MotionKind); 4] = [
    ("MOVEABSJ", MotionKind::Ptp),
    ("MOVEJ", MotionKind::Ptp),
    ("MOVEL", MotionKind::Lin),
    ("MOVEC", MotionKind::Circ),
];

/// Whether an instruction is one of these motions.
pub(super) fn is_motion(name: &str) -> bool {
    MOTIONS.iter().any(|(known, _)| *known == name)
}

/// The names of the frames in findings.
const TOOL: &str = "the tool";
const WORK_OBJECT: &str = "the work object";

/// The optional argument `\name`.
pub(super) fn optional<'a>(arguments: &'a [Evaluated<'a>], name: &str) -> Option<&'a Evaluated<'a>> {
    arguments.iter().find(|argument| argument.name.is_some_and(|given| given.eq_ignore_ascii_case(name)))
}

/// The arguments without a name, in order.
pub(super) fn required<'a>(arguments: &'a [Evaluated<'a>]) -> impl Iterator<Item = &'a Evaluated<'a>> {
    arguments.iter().filter(|argument| argument.name.is_none())
}

impl<'a> Instruction<'a> {
    /// The motion of a call, if the call is one.
    pub(super) fn new(name: &str, arguments: &'a [Evaluated<'a>]) -> Option<Self> {
        let (_, motion) = *MOTIONS.iter().find(|(known, _)| *known == name)?;
        let mut required = required(arguments);
        Some(Self {
            motion,
            is_to_axes: name == "MOVEABSJ",
            through: if motion == MotionKind::Circ { Some(required.next()?) } else { None },
            to: required.next()?,
            speed: required.next(),
            zone: required.next(),
            tool: required.next(),
            work_object: optional(arguments, "WObj").filter(|argument| argument.expression.is_some()),
            time: optional(arguments, "T"),
        })
    }

    /// The points, the auxiliary one first.
    pub(super) fn points(&self) -> impl Iterator<Item = &'a Evaluated<'a>> {
        [self.through, Some(self.to)].into_iter().flatten()
    }

    /// The names of the variables that give the motion its tool and its work object.
    pub(super) fn frame_names(&self) -> impl Iterator<Item = &'a str> {
        [self.tool, self.work_object].into_iter().flatten().filter_map(Evaluated::variable)
    }

    pub(super) fn frames(&self) -> Result<Frames, CompensationFinding> {
        let name = |frame: Option<&Evaluated<'_>>| {
            frame.and_then(Evaluated::variable).unwrap_or("not written").to_owned()
        };
        let elsewhere = |frame: &'static str, argument: Option<&Evaluated<'_>>| {
            CompensationFinding::FrameElsewhere { frame, name: name(argument) }
        };
        let fixed = |argument| CompensationFinding::FixedTool { name: name(argument) };
        let held = self.tool.and_then(|argument| tool(argument.value.as_ref()?));
        let (holder, tool) = held.ok_or_else(|| elsewhere(TOOL, self.tool))?;
        if holder == Holder::World {
            return Err(fixed(self.tool));
        }
        if self.work_object.is_none() {
            return Ok(Frames { tool, base: Pose::identity() });
        }
        let held = self.work_object.and_then(|argument| work_object(argument.value.as_ref()?));
        match held.ok_or_else(|| elsewhere(WORK_OBJECT, self.work_object))? {
            (Holder::World, base) => Ok(Frames { tool, base }),
            (Holder::Robot, _) => Err(fixed(self.work_object)),
            (Holder::MechanicalUnit, _) => {
                Err(CompensationFinding::MovedWorkObject { name: name(self.work_object) })
            }
        }
    }

    /// The finding if the module assigns to one of the points or frames so that it is not known here: a point without numbers of its own
    /// (`is_own`). `assigned_line` returns the line of an assignment to a name.
    pub(super) fn computed(
        &self,
        is_own: impl Fn(&Value) -> bool,
        assigned_line: impl Fn(&str) -> Option<usize>,
    ) -> Option<CompensationFinding> {
        let assigned = |argument: Option<&Evaluated<'_>>, is_known: &dyn Fn(&Value) -> bool| {
            let argument = argument.filter(|argument| !argument.value.as_ref().is_some_and(is_known))?;
            let name = argument.variable()?;
            Some((name.to_owned(), assigned_line(name)?))
        };
        let point = assigned(self.through, &is_own).or_else(|| assigned(Some(self.to), &is_own));
        let point = point.map(|(name, line)| CompensationFinding::PointComputed { name, line });
        if self.is_to_axes {
            return point;
        }
        let tool = assigned(self.tool, &|value| tool(value).is_some()).map(|found| (TOOL, found));
        let frame = tool.or_else(|| {
            let found = assigned(self.work_object, &|value| work_object(value).is_some());
            Some((WORK_OBJECT, found?))
        });
        let frame = frame.map(|(frame, (_, line))| CompensationFinding::FrameComputed { frame, line });
        point.or(frame)
    }

    /// The speeds in mm/s and degrees/s.
    pub(super) fn speeds(&self) -> Option<[f64; 2]> {
        speed(self.speed?.value.as_ref()?)
    }

    /// Whether the motion ends in an exact stop.
    pub(super) fn stops(&self) -> bool {
        self.zone.and_then(Evaluated::variable).is_some_and(|zone| zone.eq_ignore_ascii_case("fine"))
    }
}
