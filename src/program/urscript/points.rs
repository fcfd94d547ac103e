//! The points of a script, and new numbers for them.

use super::instruction::{motion, pose, target};
use super::parser::parse;
use crate::catalogue::CompensationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::compensate::{Branch, Corrected, Corrector};
use crate::program::script::points::{Point, Points, Taught, Vocabulary, numbers};
use crate::program::script::statement::{Kind, Statement};
use crate::program::script::value::{self, Names, Value};
use crate::program::text::{Edit, Span, Text};
use crate::program::{Frames, Target};
use crate::robot::Pose;
use crate::robot::pose::rotation_vector;

/// Fewest decimals: a tenth of a micrometre in metres, and of a radian what moves a point a metre away by less.
const DECIMALS: usize = 7;

/// The name under which a finding speaks of the TCP.
const TOOL: &str = "the tool";
/// TCPs that differ by less are one.
const SAME_MM: f64 = 0.01;
const SAME_RAD: f64 = 1e-4;

const WORDS: Vocabulary = Vocabulary {
    moving: &["mov", "servo", "speed"],
    displacing: &["track_conveyor_linear", "track_conveyor_circular", "path_offset_enable", "force_mode"],
    setting: &["set_", "get_"],
};

/// Goes through the text: the tool that is set and the variables so far.
struct Walk<'a> {
    text: Text<'a>,
    /// As the user gave it, where the program does not set it.
    given: Option<Pose>,
    /// `None` before `set_tcp`; then the pose, where it can be read.
    tool: Option<Option<Pose>>,
    names: Names,
    points: Points,
    /// Of the blocks that are open, which are choices.
    choices: Vec<bool>,
}

/// The points of a script; `tool` where it does not set one by `set_tcp`.
pub fn read(text: Text<'_>, tool: Option<Pose>) -> Result<Points, Diagnostic> {
    let mut walk = Walk {
        text,
        given: tool,
        tool: None,
        names: Names::new(),
        points: Points::new(write),
        choices: Vec::new(),
    };
    let mut statements: Vec<Statement> = parse(text)?.into_iter().flat_map(|routine| routine.body).collect();
    statements.sort_by_key(|statement| statement.span.start);
    for statement in &statements {
        walk.take(statement)?;
    }
    Ok(walk.points.completed())
}

impl Walk<'_> {
    fn take(&mut self, statement: &Statement) -> Result<(), Diagnostic> {
        match &statement.kind {
            Kind::Assign { name, value } => {
                let found = value::value(value, 0, &|name| self.names.get(name).cloned());
                match found {
                    // A name that gets a second value is none that could be read.
                    Some(found) if !self.names.contains_key(name) => {
                        let named = Value { name: Some(name.clone()), ..found };
                        self.names.insert(name.clone(), named);
                    }
                    _ => _ = self.names.remove(name),
                }
            }
            Kind::Call { name, arguments } if name == "set_tcp" => {
                let given = arguments.first().and_then(|argument| argument.value.as_ref());
                let found =
                    given.and_then(|value| value::value(value, 0, &|name| self.names.get(name).cloned()));
                let found = found.and_then(|value| pose(&value));
                if let (Some(given), Some(found)) = (self.given, found)
                    && ((given.position - found.position).norm() > SAME_MM
                        || given.angle_to(&found) > SAME_RAD)
                {
                    let differs = CompensationFinding::FrameDiffers { frame: TOOL, option: "--tool" };
                    return Err(self.text.wrong(&statement.span, differs));
                }
                // Which of the branches of a choice runs is not known.
                self.tool = Some(found.filter(|_| !self.choices.contains(&true)));
            }
            Kind::Other(word) if ["if", "while", "thread"].contains(&word.as_str()) => {
                self.choices.push(word == "if");
            }
            Kind::Other(word) if word == "end" => _ = self.choices.pop(),
            _ => self.motion(statement)?,
        }
        Ok(())
    }

    fn motion(&mut self, statement: &Statement) -> Result<(), Diagnostic> {
        let Some(instruction) = motion(statement) else {
            let found = |expression: &_| value::value(expression, 0, &|name| self.names.get(name).cloned());
            let point = |expression: &_| found(expression).filter(|value| target(value).is_some());
            self.points.other(self.text, statement, &WORDS, point);
            return Ok(());
        };
        for expression in instruction.points() {
            let found = value::value(expression, 0, &|name| self.names.get(name).cloned());
            let taught = found.and_then(|value| {
                let target = target(&value)?;
                Some(Taught { value, target, branch: Branch::Nearest })
            });
            let (tool, given, text) = (self.tool, self.given, self.text);
            let frames = || frames(tool, given, text, &statement.span);
            self.points.visit(text, &statement.span, expression, taught, frames)?;
        }
        Ok(())
    }
}

/// With the tool that the script sets (the inner `None`: computed), else with the given one.
fn frames(
    set: Option<Option<Pose>>,
    given: Option<Pose>,
    text: Text<'_>,
    motion: &Span,
) -> Result<Frames, Diagnostic> {
    let frame = TOOL;
    let tool = match (set, given) {
        (Some(None), _) => Err(CompensationFinding::FrameComputed { frame, line: text.line(motion.start) }),
        (Some(Some(tool)), _) | (None, Some(tool)) => Ok(tool),
        (None, None) => Err(CompensationFinding::FrameNotSet { frame }),
    };
    let tool = tool.map_err(|why| text.wrong(motion, why))?;
    Ok(Frames { tool, base: Pose::identity() })
}

fn write(
    _: &Corrector,
    point: &Point,
    corrected: &Corrected,
    text: Text<'_>,
) -> Result<Vec<Edit>, CompensationFinding> {
    let new = match point.target {
        Target::Axes(_) => corrected.numbers.map(f64::to_radians),
        Target::Pose { .. } => {
            let [x, y, z, a, b, c] = corrected.numbers;
            let turn = rotation_vector(&Pose::from_kuka([x, y, z], [a, b, c]).rotation);
            let taught: Option<[f64; 6]> = point.value.numbers();
            let [.., rx, ry, rz] = taught.ok_or(CompensationFinding::PointShape { numbers: 6 })?;
            // The same turn the other way round where the taught one was so written.
            let other = turn * (1.0 - std::f64::consts::TAU / turn.norm());
            let off = |turn: &nalgebra::Vector3<f64>| (turn - nalgebra::Vector3::new(rx, ry, rz)).norm();
            let turn = if other.iter().all(|part| part.is_finite()) && off(&other) < off(&turn) {
                other
            } else {
                turn
            };
            [x * 1e-3, y * 1e-3, z * 1e-3, turn.x, turn.y, turn.z]
        }
    };
    Ok(numbers(&point.value, &new, text, DECIMALS)?.0)
}
