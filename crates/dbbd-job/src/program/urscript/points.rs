//! The points of a script and their correction.

use nalgebra::Vector3;

use super::instruction::{Instruction, pose, target};
use super::parser::parse;
use crate::program::CompensationFinding;
use crate::program::compensate::{Branch, Corrected, Corrector};
use crate::program::script::expression::{Statement, StatementKind};
use crate::program::script::points::{OtherInstructions, Point, Points, replaced};
use crate::program::script::value::{self, Evaluated, Value, Variables, evaluated};
use crate::program::text::{Edit, Span, Text};
use crate::program::{Frames, Target};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;
use dbbd_model::robot::pose::rotation_vector;

/// Fewest decimals of a number: in metres 0.1 um, in radians less than 0.1 um at a distance of a metre.
const DECIMALS: usize = 7;

/// The name of the TCP in findings.
const TOOL: &str = "the tool";
/// TCPs that differ by less are the same.
const SAME_MM: f64 = 0.01;
const SAME_RAD: f64 = 1e-4;

const OTHERS: OtherInstructions = OtherInstructions {
    motions: &["mov", "servo", "speed"],
    displacements: &["track_conveyor_linear", "track_conveyor_circular", "path_offset_enable", "force_mode"],
    settings: &["set_", "get_"],
};

/// The points of a script; `tool` is the TCP if the script does not set one with `set_tcp`.
pub fn read(text: Text<'_>, tool: Option<Pose>) -> Result<Points, Diagnostic> {
    let mut reader = Reader {
        text,
        given: tool,
        tool: Tcp::NotSet,
        variables: Variables::new(),
        points: Points::new(write),
        open_blocks: Vec::new(),
    };
    let mut statements: Vec<Statement> = parse(text)?.into_iter().flat_map(|routine| routine.body).collect();
    statements.sort_by_key(|statement| statement.span.start);
    statements.iter().try_for_each(|statement| reader.statement(statement))?;
    Ok(reader.points.completed())
}

/// The TCP that the script has set.
#[derive(Clone, Copy)]
enum Tcp {
    NotSet,
    /// By a computed pose, or in a branch of an IF.
    Unknown,
    Known(Pose),
}

/// Reads the statements in the order of the text.
struct Reader<'a> {
    text: Text<'a>,
    /// The TCP of the user.
    given: Option<Pose>,
    tool: Tcp,
    /// The variables that are assigned once so far.
    variables: Variables,
    points: Points,
    /// For each open block whether it is an IF.
    open_blocks: Vec<bool>,
}

impl Reader<'_> {
    fn statement(&mut self, Statement { span, kind }: &Statement) -> Result<(), Diagnostic> {
        let lookup = |name: &str| self.variables.get(name).cloned();
        match kind {
            StatementKind::Assign { name, value } => match value::value(value, 0, &lookup) {
                Some(value) if !self.variables.contains_key(name) => {
                    let named = Value { name: Some(name.clone()), ..value };
                    self.variables.insert(name.clone(), named);
                }
                _ => _ = self.variables.remove(name),
            },
            StatementKind::Call { name, arguments } => {
                let arguments = evaluated(arguments, 0, &lookup);
                if name == "set_tcp" {
                    self.set_tcp(span, &arguments)?;
                } else if let Some(instruction) = Instruction::new(name, &arguments) {
                    self.motion(span, &instruction)?;
                } else {
                    let is_point = |value: &Value| target(value).is_some();
                    self.points.other(self.text, (span, kind), &arguments, &OTHERS, is_point);
                }
            }
            StatementKind::Other(word) if ["if", "while", "thread"].contains(&word.as_str()) => {
                self.open_blocks.push(word == "if");
            }
            StatementKind::Other(word) if word == "end" => _ = self.open_blocks.pop(),
            StatementKind::Other(_) => self.points.other(self.text, (span, kind), &[], &OTHERS, |_| false),
            StatementKind::UntilSteady => {}
        }
        Ok(())
    }

    fn set_tcp(&mut self, span: &Span, arguments: &[Evaluated<'_>]) -> Result<(), Diagnostic> {
        let tool = arguments.first().and_then(|argument| pose(argument.value.as_ref()?));
        if let (Some(given), Some(tool)) = (self.given, tool)
            && ((given.position - tool.position).norm() > SAME_MM || given.angle_to(&tool) > SAME_RAD)
        {
            let differs = CompensationFinding::FrameDiffers { frame: TOOL, stated: "the given tool" };
            return Err(self.text.wrong(span, differs));
        }
        let is_conditional = self.open_blocks.contains(&true);
        self.tool = tool.filter(|_| !is_conditional).map_or(Tcp::Unknown, Tcp::Known);
        Ok(())
    }

    fn motion(&mut self, span: &Span, instruction: &Instruction<'_>) -> Result<(), Diagnostic> {
        for argument in instruction.points() {
            let taught = argument.value.as_ref().and_then(target).map(|target| (target, Branch::Nearest));
            let frames = self.frames(span);
            self.points.add(self.text, span, argument, taught, || frames)?;
        }
        Ok(())
    }

    /// The frames of a motion: with the TCP that the script sets, else with that of the user.
    fn frames(&self, motion: &Span) -> Result<Frames, Diagnostic> {
        let frame = TOOL;
        let unknown = match (self.tool, self.given) {
            (Tcp::Known(tool), _) | (Tcp::NotSet, Some(tool)) => {
                return Ok(Frames { tool, base: Pose::identity() });
            }
            (Tcp::Unknown, _) => {
                CompensationFinding::FrameComputed { frame, line: self.text.line(motion.start) }
            }
            (Tcp::NotSet, None) => CompensationFinding::FrameNotSet { frame },
        };
        Err(self.text.wrong(motion, unknown))
    }
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
            let Pose { position, rotation } = Pose::from_xyzabc(corrected.numbers);
            let taught: Option<[f64; 6]> = point.value.numbers();
            let [.., rx, ry, rz] = taught.ok_or(CompensationFinding::PointShape { numbers: 6 })?;
            // Of the two rotation vectors of an orientation the one nearer to the taught one.
            let short = rotation_vector(&rotation);
            let long = short * (1.0 - std::f64::consts::TAU / short.norm());
            let distance = |turn: &Vector3<f64>| (turn - Vector3::new(rx, ry, rz)).norm();
            let is_long = long.iter().all(|part| part.is_finite()) && distance(&long) < distance(&short);
            let turn = if is_long { long } else { short };
            [position.x * 1e-3, position.y * 1e-3, position.z * 1e-3, turn.x, turn.y, turn.z]
        }
    };
    Ok(replaced(&point.value, &new, text, DECIMALS)?.0)
}
