//! A RAPID program as the list of its actions.

use std::cell::RefCell;
use std::rc::Rc;

use super::instruction::{Instruction, optional, required};
use super::literal::{predefined, taught};
use super::parser::{Declared, Module, parse};
use crate::program::ProgramFinding;
use crate::program::listing::{ActionKind, Move, Pace, ProgrammedConfiguration, Standstill};
use crate::program::script::expression::Routine;
use crate::program::script::unroll::{Dialect, unroll};
use crate::program::script::value::{self, Evaluated, Value};
use crate::program::text::Text;
use crate::program::{Language, Listing, MotionKind, Target};
use dbbd_model::diagnostic::Diagnostic;

/// Name of the signal of the strobe.
const STROBE: &str = "DBBSTB";
/// Acceleration along a path unless the program limits it, mm/s^2.
const ACCELERATION_MM_S2: f64 = 5000.0;

/// Reads the program that begins in `first` (name and text of a module) with its `main`, else with its first routine.
/// Routines that `first` does not have are looked up in `others`.
pub fn open(first: (String, String), others: Vec<(String, String)>) -> Result<Listing, Diagnostic> {
    let entry = parse(Text { file: &first.0, text: &first.1 }, 0)?;
    let main = entry.routines.iter().find(|routine| routine.name == "MAIN");
    let Some(main) = main.or_else(|| entry.routines.first()).cloned() else {
        return Err(Diagnostic::file(&first.0, ProgramFinding::NoProc));
    };
    let files: Vec<(String, String)> = [first].into_iter().chain(others).collect();
    let mut modules = vec![None; files.len()];
    modules[0] = Some(Rc::new(entry));
    let rapid = Rapid {
        files: files.clone(),
        modules: RefCell::new(modules),
        checks_configuration: true,
        mm_s2: ACCELERATION_MM_S2,
    };
    unroll(rapid, Language::Rapid, files, &main)
}

/// The value of a name (in capitals) that a module declares.
pub(super) fn declared(module: &Module, name: &str, file: usize) -> Option<Value> {
    let at = module.data.iter().position(|declared| declared.name == name)?;
    // A value may use names that were declared before it with a literal.
    let lookup = |other: &str| {
        let declared = module.data[..at].iter().find(|declared| declared.name == other)?;
        value::value(&declared.value, file, &|_| None)
    };
    let value = value::value(&module.data[at].value, file, &lookup)?;
    Some(Value { name: Some(name.to_owned()), ..value })
}

struct Rapid {
    files: Vec<(String, String)>,
    /// The modules that were parsed; the modules of other files are parsed when they are first needed.
    modules: RefCell<Vec<Option<Rc<Module>>>>,
    /// Whether the configuration at the end of a line or an arc is checked (`ConfL`).
    checks_configuration: bool,
    /// The limit of the acceleration along a path, mm/s^2.
    mm_s2: f64,
}

impl Rapid {
    /// The module of a file; `None` if it cannot be parsed.
    fn module(&self, file: usize) -> Option<Rc<Module>> {
        let mut modules = self.modules.borrow_mut();
        let module = modules.get_mut(file)?;
        if module.is_none() {
            let (name, text) = self.files.get(file)?;
            *module = parse(Text { file: name, text }, file).ok().map(Rc::new);
        }
        module.clone()
    }

    /// The files other than `file`.
    fn others(&self, file: usize) -> impl Iterator<Item = usize> {
        (0..self.files.len()).filter(move |other| *other != file)
    }

    fn motion(&self, instruction: &Instruction<'_>) -> Result<Move, ProgramFinding> {
        if !instruction.stops() {
            let what = "a motion that does not end in `fine`".into();
            let instead = "every point is an exact stop".into();
            return Err(ProgramFinding::Unsupported { what, instead });
        }
        let point = |argument: &Evaluated<'_>| {
            argument.value.as_ref().and_then(taught).ok_or(ProgramFinding::NoPosition)
        };
        let (to, configuration) = point(instruction.to)?;
        let through = match instruction.through.map(point).transpose()? {
            Some((Target::Axes(_), _)) => return Err(ProgramFinding::NoPosition),
            through => through.map(|(target, _)| target),
        };
        let frames = instruction.frames();
        let frames = frames.map_err(|why| ProgramFinding::NotDeclared { name: why.to_string() })?;
        let pace = match (instruction.time.and_then(Evaluated::number), instruction.speeds()) {
            (Some(seconds), _) if seconds > 0.0 => Pace::Duration(seconds),
            (_, Some([mm_s, deg_s])) if mm_s > 0.0 && deg_s > 0.0 => {
                Pace::Tool { mm_s, mm_s2: self.mm_s2, deg_s: Some(deg_s) }
            }
            _ => return Err(ProgramFinding::NoSpeed { variable: "the speed".into() }),
        };
        let motion = instruction.motion;
        let configuration = configuration
            .filter(|_| motion == MotionKind::Ptp || self.checks_configuration)
            .map(ProgrammedConfiguration::Quadrants);
        Ok(Move { motion, through, to, configuration, frames, pace, ends_in_position: false })
    }
}

impl Dialect for Rapid {
    fn routine(&self, file: usize, name: &str) -> Option<Routine> {
        let in_file = |at: usize| {
            let module = self.module(at)?;
            let is_visible = |routine: &&Routine| routine.name == name && (at == file || !routine.is_local);
            module.routines.iter().find(is_visible).cloned()
        };
        in_file(file).or_else(|| self.others(file).find_map(in_file))
    }

    fn global(&self, file: usize, name: &str) -> Option<Value> {
        let in_file = |at: usize| {
            let module = self.module(at)?;
            let is_visible = |data: &Declared| data.name == name && (at == file || !data.is_local);
            module.data.iter().any(is_visible).then(|| declared(&module, name, at))?
        };
        in_file(file).or_else(|| predefined(name)).or_else(|| self.others(file).find_map(in_file))
    }

    fn instruction(
        &mut self,
        name: &str,
        arguments: &[Evaluated<'_>],
    ) -> Result<Option<ActionKind>, ProgramFinding> {
        if let Some(instruction) = Instruction::new(name, arguments) {
            return Ok(Some(ActionKind::Move(Box::new(self.motion(&instruction)?))));
        }
        let has = |switch: &str| optional(arguments, switch).is_some();
        let number = |argument: Option<&Evaluated<'_>>| {
            argument.and_then(Evaluated::number).ok_or(ProgramFinding::NotSet { name: name.into() })
        };
        let mut required = required(arguments);
        let mut is_strobe = || {
            let signal = required.next().and_then(Evaluated::variable);
            signal.is_some_and(|name| name.eq_ignore_ascii_case(STROBE))
        };
        Ok(match name {
            "WAITROB" if has("InPos") => Some(ActionKind::WaitForStandstill(Standstill::InPosition)),
            "WAITROB" => Some(ActionKind::WaitForStandstill(Standstill::ZeroSpeed)),
            "WAITTIME" => Some(ActionKind::Wait(number(required.next())?)),
            "SETDO" if is_strobe() => Some(ActionKind::SetStrobe(number(required.next())? != 0.0)),
            "PULSEDO" => {
                let seconds =
                    optional(arguments, "PLength").map_or(Ok(0.2), |length| number(Some(length)))?;
                is_strobe().then_some(ActionKind::PulseStrobe(seconds))
            }
            "STOP" => Some(ActionKind::Halt),
            "CONFL" => {
                self.checks_configuration = has("On");
                None
            }
            "PATHACCLIM" => {
                let limit = optional(arguments, "AccMax").map(|limit| number(Some(limit))).transpose()?;
                self.mm_s2 = limit.map_or(ACCELERATION_MM_S2, |m_s2| 1e3 * m_s2);
                None
            }
            "TPWRITE" | "TPERASE" | "CONFJ" | "SETDO" | "SETGO" => None,
            _ => {
                let instead = "the simulated controller has no such instruction, and no module beside this one has such a \
                               routine";
                return Err(ProgramFinding::Unsupported { what: name.into(), instead: instead.into() });
            }
        })
    }
}
