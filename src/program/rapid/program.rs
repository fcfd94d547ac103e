//! A program: a module and all that it calls, as the list of what it does.

use std::cell::RefCell;
use std::rc::Rc;

use super::instruction::{Instruction, motion};
use super::literal::predefined;
use super::parser::{Module, parse};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::listing::{Does, Move, Pace, Standstill};
use crate::program::script::statement::{Dialect, Kind, Routine, Statement, Unrolling};
use crate::program::script::value::{self, Argument, Names, Value};
use crate::program::text::Text;
use crate::program::{Language, Listing, Motion, Target};

/// The signal that is the strobe.
const STROBE: &str = "DBBSTB";
/// Acceleration along a path before a program limits it, mm/s^2.
const ACCELERATION_MM_S2: f64 = 5000.0;

/// Reads the program that begins in `first` (name and text of a module): its `main`, else its first routine. Routines
/// that it does not have are looked for in `others`.
pub fn open(first: (String, String), others: Vec<(String, String)>) -> Result<Listing, Diagnostic> {
    let entry = parse(Text { file: &first.0, text: &first.1 }, 0)?;
    let named = |(routine, _): &&(Routine, bool)| routine.name == "MAIN";
    let main = entry.routines.iter().find(named).or_else(|| entry.routines.first()).cloned();
    let Some((main, _)) = main else {
        return Err(Diagnostic::file(&first.0, ProgramFinding::NoProc));
    };
    let mut files = vec![first];
    files.extend(others);
    let modules = RefCell::new(files.iter().map(|_| None).collect::<Vec<Option<Rc<Module>>>>());
    modules.borrow_mut()[0] = Some(Rc::new(entry));
    let mut run = Run { files: files.clone(), modules, checks: true, mm_s2: ACCELERATION_MM_S2 };
    let mut unrolling = Unrolling::new(&mut run, Language::Rapid, files);
    unrolling.routine(&main, Names::new())?;
    Ok(unrolling.listing)
}

/// The value of a name (in capitals) that a module declares.
pub(super) fn declared(module: &Module, name: &str, file: usize) -> Option<Value> {
    let declared = module.data.iter().find(|declared| declared.name == name)?;
    let lookup = |other: &str| {
        // A value may name others that are declared before it, no more.
        let value = module
            .data
            .iter()
            .take_while(|before| before.name != name)
            .find(|before| before.name == other)?;
        value::value(&value.value, file, &|_| None)
    };
    let value = value::value(&declared.value, file, &lookup)?;
    Some(Value { name: Some(declared.name.clone()), ..value })
}

struct Run {
    files: Vec<(String, String)>,
    /// Those that were read; another's module is read when a routine or a value of it is wanted.
    modules: RefCell<Vec<Option<Rc<Module>>>>,
    /// Whether the configuration of a line or an arc is checked (`ConfL`).
    checks: bool,
    /// The limit of the acceleration along a path.
    mm_s2: f64,
}

impl Run {
    /// The module of a file; `None` of one that cannot be read.
    fn module(&self, file: usize) -> Option<Rc<Module>> {
        let mut modules = self.modules.borrow_mut();
        let here = modules.get_mut(file)?;
        if here.is_none() {
            let (name, text) = self.files.get(file)?;
            *here = parse(Text { file: name, text }, file).ok().map(Rc::new);
        }
        here.clone()
    }

    fn moving(
        &self,
        statement: &Statement,
        file: usize,
        lookup: &dyn Fn(&str) -> Option<Value>,
    ) -> Result<Option<Move>, ProgramFinding> {
        let Some(instruction) = motion(statement) else { return Ok(None) };
        if !instruction.stops() {
            let what = "a motion that does not end in `fine`".into();
            let instead = "every point is an exact stop".into();
            return Err(ProgramFinding::Unsupported { what, instead });
        }
        let point =
            |expression| Instruction::point(expression, file, lookup).ok_or(ProgramFinding::NoPosition);
        let (_, to) = point(instruction.to)?;
        let through_mm = match instruction.through.map(point).transpose()? {
            Some((_, through)) => match through.target {
                Target::Pose { xyz_mm, .. } => Some(xyz_mm),
                Target::Axes(_) => return Err(ProgramFinding::NoPosition),
            },
            None => None,
        };
        let frames = instruction.frames(file, lookup);
        let frames = frames.map_err(|why| ProgramFinding::NotDeclared { name: why.to_string() })?;
        let time = instruction.time.and_then(|time| value::value(time, file, lookup)?.number());
        let pace = match (time, instruction.speeds(file, lookup)) {
            (Some(seconds), _) if seconds > 0.0 => Pace::Duration(seconds),
            (_, Some([mm_s, deg_s])) if mm_s > 0.0 && deg_s > 0.0 => {
                Pace::Tool { mm_s, mm_s2: self.mm_s2, deg_s: Some(deg_s) }
            }
            _ => return Err(ProgramFinding::NoSpeed { variable: "the speed".into() }),
        };
        let is_axes = instruction.motion == Motion::Ptp;
        let configuration = to.configuration.filter(|_| is_axes || self.checks);
        Ok(Some(Move { motion: instruction.motion, through_mm, to: to.target, configuration, frames, pace }))
    }
}

impl Dialect for Run {
    fn routine(&self, file: usize, name: &str) -> Option<Routine> {
        let in_file = |at: usize| {
            let module = self.module(at)?;
            let found = module
                .routines
                .iter()
                .find(|(routine, local)| routine.name == name && (at == file || !local));
            found.map(|(routine, _)| routine.clone())
        };
        in_file(file).or_else(|| (0..self.files.len()).filter(|at| *at != file).find_map(in_file))
    }

    fn global(&self, file: usize, name: &str) -> Option<Value> {
        let in_file = |at: usize| {
            let module = self.module(at)?;
            let visible =
                |value: &&super::parser::Declared| value.name == name && (at == file || !value.is_local);
            module.data.iter().any(|value| visible(&value)).then(|| declared(&module, name, at))?
        };
        let own = in_file(file);
        own.or_else(|| predefined(name))
            .or_else(|| (0..self.files.len()).filter(|at| *at != file).find_map(in_file))
    }

    fn instruction(
        &mut self,
        call: &Statement,
        lookup: &dyn Fn(&str) -> Option<Value>,
        file: usize,
    ) -> Result<Vec<Does>, ProgramFinding> {
        let Kind::Call { name, arguments } = &call.kind else { return Ok(Vec::new()) };
        if let Some(motion) = self.moving(call, file, lookup)? {
            return Ok(vec![Does::Move(Box::new(motion))]);
        }
        let has = |switch: &str| named(arguments, switch).is_some();
        let number = |argument: Option<&Argument>| {
            let value = argument.and_then(|argument| value::value(argument.value.as_ref()?, file, lookup));
            value.and_then(|value| value.number()).ok_or(ProgramFinding::NotSet { name: name.clone() })
        };
        let mut plain = arguments.iter().filter(|argument| argument.name.is_none());
        Ok(match name.as_str() {
            "WAITROB" if has("InPos") => vec![Does::Standstill(Standstill::InPosition)],
            "WAITROB" => vec![Does::Standstill(Standstill::ZeroSpeed)],
            "WAITTIME" => vec![Does::Wait(number(plain.next())?)],
            "SETDO" if is_strobe(plain.next()) => vec![Does::Strobe(number(plain.next())? != 0.0)],
            "PULSEDO" => {
                let seconds = match named(arguments, "PLength") {
                    Some(length) => number(Some(length))?,
                    None => 0.2,
                };
                if is_strobe(plain.next()) { vec![Does::Pulse(seconds)] } else { Vec::new() }
            }
            "STOP" => vec![Does::Halt],
            "CONFL" => {
                self.checks = has("On");
                Vec::new()
            }
            "PATHACCLIM" => {
                let limit = named(arguments, "AccMax").map(|limit| number(Some(limit))).transpose()?;
                self.mm_s2 = limit.map_or(ACCELERATION_MM_S2, |m_s2| 1e3 * m_s2);
                Vec::new()
            }
            "TPWRITE" | "TPERASE" | "CONFJ" | "SETDO" | "SETGO" => Vec::new(),
            _ => {
                let instead = "the simulated controller has no such instruction, and no module beside this one has such a \
                               routine";
                return Err(ProgramFinding::Unsupported { what: name.clone(), instead: instead.into() });
            }
        })
    }
}

fn named<'a>(arguments: &'a [Argument], name: &str) -> Option<&'a Argument> {
    let is =
        |argument: &&Argument| argument.name.as_ref().is_some_and(|given| given.eq_ignore_ascii_case(name));
    arguments.iter().find(is)
}

fn is_strobe(signal: Option<&Argument>) -> bool {
    let value = signal.and_then(|signal| signal.value.as_ref());
    matches!(value.map(|value| &value.kind), Some(value::Kind::Name(name)) if name.eq_ignore_ascii_case(STROBE))
}
