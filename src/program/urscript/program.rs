//! A script as the list of what it does.

use super::instruction::{argument, motion, pose, target};
use super::parser::parse;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::listing::{Does, Move, Pace};
use crate::program::script::statement::{Dialect, Kind, Routine, Statement, Unrolling};
use crate::program::script::value::{self, Names, Of, Value};
use crate::program::text::Text;
use crate::program::{Frames, Language, Listing, Motion, Target};
use crate::robot::Pose;

/// The variable that holds the number of the strobe's output.
const STROBE: &str = "DBBSTB";
/// Acceleration and speed where a motion gives none: of a joint in rad/s^2 and rad/s, of the tool in m/s^2 and m/s.
const JOINT: [f64; 2] = [1.4, 1.05];
const TOOL: [f64; 2] = [1.2, 0.25];

/// Reads a script (its name and its text): its lines outside of any routine, else the first routine.
pub fn open(file: (String, String)) -> Result<Listing, Diagnostic> {
    let routines = parse(Text { file: &file.0, text: &file.1 })?;
    let is_call = |statement: &Statement| matches!(statement.kind, Kind::Call { .. });
    let outside = routines.iter().find(|routine| routine.name.is_empty() && routine.body.iter().any(is_call));
    // A routine inside another ends before it: the first that begins is the longest.
    let mut named = routines.iter().filter(|routine| !routine.name.is_empty());
    let first = outside.or_else(|| named.next_back()).cloned();
    let Some(first) = first else { return Err(Diagnostic::file(&file.0, ProgramFinding::NoDef)) };
    let mut run = Run { routines, tool: Pose::identity() };
    let mut unrolling = Unrolling::new(&mut run, Language::Urscript, vec![file]);
    unrolling.routine(&first, Names::new())?;
    Ok(unrolling.listing)
}

struct Run {
    routines: Vec<Routine>,
    tool: Pose,
}

impl Run {
    fn moving(
        &self,
        statement: &Statement,
        lookup: &dyn Fn(&str) -> Option<Value>,
    ) -> Result<Option<Move>, ProgramFinding> {
        let Some(instruction) = motion(statement) else { return Ok(None) };
        let number = |name: &str, default: f64| instruction.number(name, lookup).unwrap_or(default);
        if number("r", 0.0) != 0.0 {
            let what = "a blend radius".into();
            let instead = "every point is an exact stop: r=0".into();
            return Err(ProgramFinding::Unsupported { what, instead });
        }
        let to_point = |expression| {
            let value = value::value(expression, 0, lookup);
            value.as_ref().and_then(target).ok_or(ProgramFinding::NoPosition)
        };
        let points: Vec<Target> = instruction.points().into_iter().map(to_point).collect::<Result<_, _>>()?;
        let (through_mm, to) = match points.as_slice() {
            [to] => (None, to.clone()),
            [Target::Pose { xyz_mm, .. }, to] => (Some(*xyz_mm), to.clone()),
            _ => return Err(ProgramFinding::NoPosition),
        };
        let [a, v] = if instruction.motion == Motion::Ptp { JOINT } else { TOOL };
        let (a, v, t) = (number("a", a), number("v", v), number("t", 0.0));
        let pace = match instruction.motion {
            _ if t > 0.0 && instruction.motion != Motion::Circ => Pace::Duration(t),
            _ if !(a > 0.0 && v > 0.0) => return Err(ProgramFinding::NoSpeed { variable: "a or v".into() }),
            Motion::Ptp => Pace::Axis { deg_s: v.to_degrees(), deg_s2: a.to_degrees() },
            Motion::Lin | Motion::Circ => Pace::Tool { mm_s: 1e3 * v, mm_s2: 1e3 * a, deg_s: None },
        };
        let frames = Frames { tool: self.tool, base: Pose::identity() };
        Ok(Some(Move { motion: instruction.motion, through_mm, to, configuration: None, frames, pace }))
    }
}

impl Dialect for Run {
    fn routine(&self, _: usize, name: &str) -> Option<Routine> {
        self.routines.iter().find(|routine| routine.name == name).cloned()
    }

    fn global(&self, _: usize, _: &str) -> Option<Value> {
        None
    }

    fn instruction(
        &mut self,
        call: &Statement,
        lookup: &dyn Fn(&str) -> Option<Value>,
        _: usize,
    ) -> Result<Vec<Does>, ProgramFinding> {
        let Kind::Call { name, arguments } = &call.kind else { return Ok(Vec::new()) };
        if let Some(motion) = self.moving(call, lookup)? {
            return Ok(vec![Does::Move(Box::new(motion))]);
        }
        let given = |names: &[&str], name: &str| value::value(argument(arguments, names, name)?, 0, lookup);
        let missing = || ProgramFinding::NotSet { name: name.clone() };
        let truth = |value: Option<Value>| match value.map(|value| value.of) {
            Some(Of::Bool(truth)) => Some(truth),
            _ => None,
        };
        Ok(match name.as_str() {
            "set_tcp" => {
                self.tool = given(&["pose"], "pose").as_ref().and_then(pose).ok_or_else(missing)?;
                Vec::new()
            }
            "sleep" => {
                let seconds = given(&["t"], "t").and_then(|seconds| seconds.number());
                vec![Does::Wait(seconds.ok_or_else(missing)?)]
            }
            "set_standard_digital_out" => {
                let names = ["n", "b"];
                let level = truth(given(&names, "b")).ok_or_else(missing)?;
                let output = argument(arguments, &names, "n");
                let strobe = value::Kind::Name(STROBE.into());
                if output.is_some_and(|n| n.kind == strobe) { vec![Does::Strobe(level)] } else { Vec::new() }
            }
            "popup" => {
                let names = ["s", "title", "warning", "error", "blocking"];
                let halts = truth(given(&names, "blocking")) == Some(true);
                if halts { vec![Does::Halt] } else { Vec::new() }
            }
            "set_configurable_digital_out" | "textmsg" | "sync" | "set_target_payload" => Vec::new(),
            _ => {
                let instead = "the simulated controller has no such function, and the script no such routine";
                return Err(ProgramFinding::Unsupported { what: name.clone(), instead: instead.into() });
            }
        })
    }
}
