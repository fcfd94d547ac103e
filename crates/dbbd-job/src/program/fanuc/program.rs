//! A TP program as the list of its actions.

use std::collections::HashMap;

use super::instruction::Instruction;
use super::parser::{TpProgram, parse};
use super::position::{Taught, frame, taught};
use crate::program::ProgramFinding;
use crate::program::listing::{ActionKind, Move, ProgrammedConfiguration};
use crate::program::script::expression::Routine;
use crate::program::script::unroll::{Dialect, unroll};
use crate::program::script::value::{Evaluated, Value};
use crate::program::text::Text;
use crate::program::{Frames, Language, Listing};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

/// The remark with the number of the strobe's output.
const STROBE: &str = "DBBSTB";
/// Acceleration along a path, mm/s^2.
const ACCELERATION_MM_S2: f64 = 5000.0;

/// Reads the program that begins in `first` (name and text of a listing). Programs that it calls are looked up in `others`.
///
/// # Errors
/// The first listing is no TP program.
pub fn open(first: (String, String), others: Vec<(String, String)>) -> Result<Listing, Diagnostic> {
    let files: Vec<(String, String)> = [first].into_iter().chain(others).collect();
    let mut programs = Vec::new();
    for (at, (file, text)) in files.iter().enumerate() {
        match parse(Text { file, text }, at) {
            Ok(program) => programs.push(program),
            Err(wrong) if at == 0 => return Err(wrong),
            Err(_) => {}
        }
    }
    let Some(main) = programs.first().map(|program| program.routine.clone()) else {
        return Err(ProgramFinding::NoProc.into());
    };
    unroll(Fanuc { programs, registers: HashMap::new() }, Language::Fanuc, files, &main)
}

struct Fanuc {
    programs: Vec<TpProgram>,
    /// The registers, frames and selections that the program has set; `None` for a computed value.
    registers: HashMap<String, Option<Value>>,
}

impl Fanuc {
    /// The frame that the setting `select` selects, or the frame `own` that a position names.
    fn frame(&self, array: &'static str, select: &str, own: Option<u32>) -> Result<Pose, ProgramFinding> {
        let setting = self.registers.get(select);
        let selected = setting.and_then(|value| value.as_ref()?.number()).map(|number| number as u32);
        let number = match (own, selected) {
            (Some(own), Some(selected)) if own != selected => {
                let what = format!("a position of {array}[{own}] while {array}[{selected}] is selected");
                return Err(ProgramFinding::Unsupported {
                    what,
                    instead: format!("{select}={own} before it"),
                });
            }
            (own, selected) => {
                own.or(selected).ok_or_else(|| ProgramFinding::NotSet { name: select.to_owned() })?
            }
        };
        if number == 0 {
            return Ok(Pose::identity());
        }
        let name = format!("{array}[{number}]");
        let defined = self.registers.get(&name).and_then(Option::as_ref).and_then(frame);
        defined.ok_or(ProgramFinding::NotSet { name })
    }

    fn motion(&self, instruction: &Instruction<'_>) -> Result<Move, ProgramFinding> {
        let unsupported = |what: &str, instead: &str| ProgramFinding::Unsupported {
            what: what.to_owned(),
            instead: instead.to_owned(),
        };
        let Some(ends_in_position) = instruction.ends_in_position() else {
            return Err(unsupported("a motion that does not end in FINE or CNT0", "every point is a stop"));
        };
        if instruction.effect().is_some() {
            return Err(unsupported("an option of a motion", "only motions to their points are simulated"));
        }
        let point = |argument: &Evaluated<'_>| {
            let found = argument.value.as_ref().and_then(taught).ok_or(ProgramFinding::NoPosition)?;
            let is_own = argument.variable().is_some_and(|name| name.starts_with("P["));
            Ok(if is_own { found } else { Taught { frames: [None, None], ..found } })
        };
        let points: Vec<Taught> = instruction.points().map(point).collect::<Result<_, _>>()?;
        let (through, to) = match points.as_slice() {
            [to] => (None, to),
            [through, to] => (Some(through), to),
            _ => return Err(ProgramFinding::NoPosition),
        };
        let [tool, base] = to.frames;
        let frames = Frames {
            tool: self.frame("UTOOL", "UTOOL_NUM", tool)?,
            base: self.frame("UFRAME", "UFRAME_NUM", base)?,
        };
        let pace = instruction.pace(ACCELERATION_MM_S2);
        let pace = pace.ok_or(ProgramFinding::NoSpeed { variable: "the speed".into() })?;
        Ok(Move {
            motion: instruction.motion,
            through: through.map(|through| through.target.clone()),
            to: to.target.clone(),
            configuration: to.configuration.map(ProgrammedConfiguration::Fanuc),
            frames,
            pace,
            ends_in_position,
        })
    }
}

impl Dialect for Fanuc {
    fn routine(&self, _: usize, name: &str) -> Option<Routine> {
        self.programs.iter().map(|program| &program.routine).find(|routine| routine.name == name).cloned()
    }

    fn global(&self, file: usize, name: &str) -> Option<Value> {
        if let Some(set) = self.registers.get(name) {
            return set.clone();
        }
        let program = self.programs.iter().find(|program| program.routine.file == file)?;
        program.positions.get(name).or_else(|| program.remarks.get(name)).cloned()
    }

    fn instruction(
        &mut self,
        name: &str,
        arguments: &[Evaluated<'_>],
    ) -> Result<Option<ActionKind>, ProgramFinding> {
        if let Some(instruction) = Instruction::new(name, arguments) {
            return Ok(Some(ActionKind::Move(Box::new(self.motion(&instruction)?))));
        }
        let first = arguments.first();
        let seconds =
            || first.and_then(Evaluated::number).ok_or(ProgramFinding::NotSet { name: name.into() });
        let strobes = |program: &TpProgram| {
            let number = program.remarks.get(STROBE).and_then(Value::number)?;
            (name == format!("DO[{number}]")).then_some(())
        };
        let is_strobe = self.programs.iter().any(|program| strobes(program).is_some());
        Ok(match name {
            "WAIT" => Some(ActionKind::Wait(seconds()?)),
            "PAUSE" => Some(ActionKind::Halt),
            "MESSAGE" => None,
            _ if is_strobe && first.is_some_and(|first| first.name.is_some()) => {
                Some(ActionKind::PulseStrobe(seconds()?))
            }
            _ if is_strobe => match first.and_then(Evaluated::variable) {
                Some("ON") => Some(ActionKind::SetStrobe(true)),
                Some("OFF") => Some(ActionKind::SetStrobe(false)),
                Some(_) | None => return Err(ProgramFinding::NotSet { name: name.into() }),
            },
            _ if name.ends_with(']') || name.ends_with("_NUM") || name == "OVERRIDE" => {
                self.registers.insert(name.to_owned(), first.and_then(|first| first.value.clone()));
                None
            }
            _ => {
                let instead = "the simulated controller has no such instruction, and no listing beside this one is such a program";
                return Err(ProgramFinding::Unsupported { what: name.into(), instead: instead.into() });
            }
        })
    }
}
