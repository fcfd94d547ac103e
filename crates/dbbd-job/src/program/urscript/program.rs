//! A script as the list of its actions.

use super::instruction::{Instruction, argument, pose, target};
use super::parser::parse;
use crate::program::ProgramFinding;
use crate::program::listing::{ActionKind, Move, Pace};
use crate::program::script::expression::{Routine, Statement, StatementKind};
use crate::program::script::unroll::{Dialect, unroll};
use crate::program::script::value::{Evaluated, Value};
use crate::program::text::Text;
use crate::program::{Frames, Language, Listing, MotionKind, Target};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

/// The variable with the number of the strobe's output.
const STROBE: &str = "DBBSTB";
/// Default acceleration and speed: of a joint in rad/s^2 and rad/s, of the tool in m/s^2 and m/s.
const JOINT: [f64; 2] = [1.4, 1.05];
const TOOL: [f64; 2] = [1.2, 0.25];

/// Reads a script (its name and text) from its lines outside of any routine, else from its first routine.
pub fn open(file: (String, String)) -> Result<Listing, Diagnostic> {
    let routines = parse(Text { file: &file.0, text: &file.1 })?;
    let is_call = |statement: &Statement| matches!(statement.kind, StatementKind::Call { .. });
    let outside = routines.iter().find(|routine| routine.name.is_empty() && routine.body.iter().any(is_call));
    // A routine ends after the routines inside it: the last one is the outermost.
    let outermost = || routines.iter().rfind(|routine| !routine.name.is_empty());
    let Some(first) = outside.or_else(outermost).cloned() else {
        return Err(Diagnostic::file(&file.0, ProgramFinding::NoDef));
    };
    let urscript = Urscript { routines, tool: Pose::identity() };
    unroll(urscript, Language::Urscript, vec![file], &first)
}

struct Urscript {
    routines: Vec<Routine>,
    /// The TCP in force.
    tool: Pose,
}

impl Urscript {
    fn motion(&self, instruction: &Instruction<'_>) -> Result<Move, ProgramFinding> {
        let number = |name: &str, default: f64| instruction.number(name).unwrap_or(default);
        if number("r", 0.0) != 0.0 {
            let what = "a blend radius".into();
            let instead = "every point is an exact stop: r=0".into();
            return Err(ProgramFinding::Unsupported { what, instead });
        }
        let point = |argument: &Evaluated<'_>| {
            argument.value.as_ref().and_then(target).ok_or(ProgramFinding::NoPosition)
        };
        let points: Vec<Target> = instruction.points().map(point).collect::<Result<_, _>>()?;
        let (through, to) = match points.as_slice() {
            [to] => (None, to.clone()),
            [through @ Target::Pose { .. }, to] => (Some(through.clone()), to.clone()),
            _ => return Err(ProgramFinding::NoPosition),
        };
        let [a, v] = if instruction.motion == MotionKind::Ptp { JOINT } else { TOOL };
        let (a, v, t) = (number("a", a), number("v", v), number("t", 0.0));
        let pace = match instruction.motion {
            _ if t > 0.0 && instruction.motion != MotionKind::Circ => Pace::Duration(t),
            _ if !(a > 0.0 && v > 0.0) => return Err(ProgramFinding::NoSpeed { variable: "a or v".into() }),
            MotionKind::Ptp => Pace::Axis { deg_s: v.to_degrees(), deg_s2: a.to_degrees() },
            MotionKind::Lin | MotionKind::Circ => Pace::Tool { mm_s: 1e3 * v, mm_s2: 1e3 * a, deg_s: None },
        };
        let frames = Frames { tool: self.tool, base: Pose::identity() };
        Ok(Move {
            motion: instruction.motion,
            through,
            to,
            configuration: None,
            frames,
            pace,
            ends_in_position: false,
        })
    }
}

impl Dialect for Urscript {
    fn routine(&self, _: usize, name: &str) -> Option<Routine> {
        self.routines.iter().find(|routine| routine.name == name).cloned()
    }

    fn global(&self, _: usize, _: &str) -> Option<Value> {
        None
    }

    fn instruction(
        &mut self,
        name: &str,
        arguments: &[Evaluated<'_>],
    ) -> Result<Option<ActionKind>, ProgramFinding> {
        if let Some(instruction) = Instruction::new(name, arguments) {
            return Ok(Some(ActionKind::Move(Box::new(self.motion(&instruction)?))));
        }
        let argument = |names: &[&str], name: &str| argument(arguments, names, name);
        let bool = |names: &[&str], name: &str| argument(names, name)?.value.as_ref()?.bool();
        let missing = || ProgramFinding::NotSet { name: name.into() };
        Ok(match name {
            "set_tcp" => {
                let tool = argument(&["pose"], "pose").and_then(|tool| pose(tool.value.as_ref()?));
                self.tool = tool.ok_or_else(missing)?;
                None
            }
            "sleep" => {
                let seconds = argument(&["t"], "t").and_then(Evaluated::number);
                Some(ActionKind::Wait(seconds.ok_or_else(missing)?))
            }
            "set_standard_digital_out" => {
                let names = ["n", "b"];
                let level = bool(&names, "b").ok_or_else(missing)?;
                let output = argument(&names, "n").and_then(Evaluated::variable);
                (output == Some(STROBE)).then_some(ActionKind::SetStrobe(level))
            }
            "popup" => {
                let is_blocking = bool(&["s", "title", "warning", "error", "blocking"], "blocking");
                (is_blocking == Some(true)).then_some(ActionKind::Halt)
            }
            "set_configurable_digital_out" | "textmsg" | "sync" | "set_target_payload" => None,
            _ => {
                let instead = "the simulated controller has no such function, and the script no such routine";
                return Err(ProgramFinding::Unsupported { what: name.into(), instead: instead.into() });
            }
        })
    }
}
