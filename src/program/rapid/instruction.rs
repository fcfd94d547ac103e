//! The instructions that move, as they are written.

use super::literal::{Held, Taught, speed, taught, tool, work_object};
use crate::catalogue::CompensationFinding;
use crate::program::script::statement::{Kind, Statement};
use crate::program::script::value::{self, Argument, Expression, Value};
use crate::program::{Frames, Motion};

/// `MoveAbsJ`, `MoveJ`, `MoveL` or `MoveC` with its arguments.
pub(super) struct Instruction<'s> {
    pub(super) motion: Motion,
    pub(super) through: Option<&'s Expression>,
    pub(super) to: &'s Expression,
    pub(super) speed: Option<&'s Expression>,
    pub(super) zone: Option<&'s Expression>,
    tool: Option<&'s Expression>,
    work_object: Option<&'s Expression>,
    /// `\T`, s.
    pub(super) time: Option<&'s Expression>,
}

/// Names of the instructions, in capitals, and how many points they have.
const MOTIONS: [(&str, Motion); 4] =
    [("MOVEABSJ", Motion::Ptp), ("MOVEJ", Motion::Ptp), ("MOVEL", Motion::Lin), ("MOVEC", Motion::Circ)];

/// The motion that a statement is, if it is one that is read.
pub(super) fn motion(statement: &Statement) -> Option<Instruction<'_>> {
    let Kind::Call { name, arguments } = &statement.kind else { return None };
    let (_, motion) = *MOTIONS.iter().find(|(known, _)| known == name)?;
    let named = |name: &str| {
        let argument = arguments
            .iter()
            .find(|argument| argument.name.as_ref().is_some_and(|given| given.eq_ignore_ascii_case(name)));
        argument.and_then(|argument: &Argument| argument.value.as_ref())
    };
    let mut plain = arguments.iter().filter(|argument| argument.name.is_none()).map(|a| a.value.as_ref());
    let through = if motion == Motion::Circ { plain.next()? } else { None };
    Some(Instruction {
        motion,
        through,
        to: plain.next()??,
        speed: plain.next().flatten(),
        zone: plain.next().flatten(),
        tool: plain.next().flatten(),
        work_object: named("WObj"),
        time: named("T"),
    })
}

/// The names under which a finding speaks of the frames.
const TOOL: &str = "the tool";
const WORK_OBJECT: &str = "the work object";

impl Instruction<'_> {
    /// The value of an expression and what it teaches; `None` of one that is computed or declared elsewhere.
    pub(super) fn point(
        expression: &Expression,
        file: usize,
        lookup: &dyn Fn(&str) -> Option<Value>,
    ) -> Option<(Value, Taught)> {
        let value = value::value(expression, file, lookup)?;
        let taught = taught(&value)?;
        Some((value, taught))
    }

    /// The frames under which it runs.
    pub(super) fn frames(
        &self,
        file: usize,
        lookup: &dyn Fn(&str) -> Option<Value>,
    ) -> Result<Frames, CompensationFinding> {
        let found = |expression: &Expression| value::value(expression, file, lookup);
        let name = |expression: Option<&Expression>| match expression.map(|expression| &expression.kind) {
            Some(value::Kind::Name(name)) => name.clone(),
            _ => "not written".into(),
        };
        let elsewhere = |frame: &'static str, expression: Option<&Expression>| {
            CompensationFinding::FrameElsewhere { frame, name: name(expression) }
        };
        let fixed = |expression| CompensationFinding::FixedTool { name: name(expression) };
        let held = self.tool.and_then(found).and_then(|value| tool(&value));
        let (holder, tool) = held.ok_or_else(|| elsewhere(TOOL, self.tool))?;
        if holder == Held::Fixed {
            return Err(fixed(self.tool));
        }
        let base = match self.work_object {
            None => crate::robot::Pose::identity(),
            Some(expression) => {
                let held = found(expression).and_then(|value| work_object(&value));
                let (holder, base) = held.ok_or_else(|| elsewhere(WORK_OBJECT, Some(expression)))?;
                match holder {
                    Held::ByRobot => return Err(fixed(self.work_object)),
                    Held::ByUnit => {
                        let name = name(self.work_object);
                        return Err(CompensationFinding::MovedWorkObject { name });
                    }
                    Held::Fixed => base,
                }
            }
        };
        Ok(Frames { tool, base })
    }

    /// Of its points and frames those that the module sets while it runs; `line` of a name that is set.
    pub(super) fn computed(&self, line: impl Fn(&str) -> Option<usize>) -> Option<CompensationFinding> {
        let set = |expression: Option<&Expression>| match &expression?.kind {
            value::Kind::Name(name) => Some((name.clone(), line(name)?)),
            _ => None,
        };
        let point = set(self.through).or_else(|| set(Some(self.to)));
        let point = point.map(|(name, line)| CompensationFinding::PointComputed { name, line });
        let frame = |frame: &'static str, of: Option<&Expression>| {
            set(of).map(|(_, line)| CompensationFinding::FrameComputed { frame, line })
        };
        point.or_else(|| frame(TOOL, self.tool)).or_else(|| frame(WORK_OBJECT, self.work_object))
    }

    /// mm/s and degrees/s.
    pub(super) fn speeds(&self, file: usize, lookup: &dyn Fn(&str) -> Option<Value>) -> Option<[f64; 2]> {
        speed(&value::value(self.speed?, file, lookup)?)
    }

    /// Whether it ends in a stop.
    pub(super) fn stops(&self) -> bool {
        self.zone.is_some_and(
            |zone| matches!(&zone.kind, value::Kind::Name(name) if name.eq_ignore_ascii_case("fine")),
        )
    }
}
