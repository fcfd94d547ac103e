//! The points of a TP program and their correction.

use std::collections::{HashMap, HashSet};

use super::controller_frames::controller_frames;
use super::instruction::{Instruction, OTHER_MOTIONS, OptionEffect, is_motion};
use super::parser::{TpProgram, is_instruction, parse};
use super::position::{Taught, external, frame, pose, swapped, taught};
use crate::program::compensate::{Branch, Corrected, Corrector, mixed};
use crate::program::flow::{At, Followed, Follower, InForce, State};
use crate::program::script::expression::{ExpressionKind, Statement, StatementKind};
use crate::program::script::points::{Point, Points, elements, replaced};
use crate::program::script::scope::Scope;
use crate::program::script::value::{Content, Evaluated, Value, evaluated};
use crate::program::text::{Edit, Span, Text};
use crate::program::{CompensationFinding, Frames, MotionKind, Target};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;
use dbbd_model::robot::inverse::FanucConfiguration;

/// Decimals of a length in mm and of an angle in degrees: a controller lists three.
const DECIMALS: usize = 3;

/// The frames that the user gives: the controller's SYSFRAME.VA, or one tool and one user frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct GivenFrames<'a> {
    pub config: Option<Text<'a>>,
    pub tool: Option<Pose>,
    pub base: Option<Pose>,
}

/// One of the two frames of a motion.
struct FrameKind {
    /// Name of the frame in findings.
    name: &'static str,
    stated: &'static str,
    /// The variable that selects the frame, and the array of the frames.
    select: &'static str,
    array: &'static str,
}

impl FrameKind {
    /// The name under which a definition is noted if its number is computed.
    fn any(&self) -> String {
        format!("{}[]", self.array)
    }
}

const KINDS: [FrameKind; 2] = [
    FrameKind { name: "the tool", stated: "the given tool", select: "UTOOL_NUM", array: "UTOOL" },
    FrameKind { name: "the user frame", stated: "the given base", select: "UFRAME_NUM", array: "UFRAME" },
];

/// The points of a listing.
pub fn read(text: Text<'_>, given: GivenFrames<'_>) -> Result<Points, Diagnostic> {
    let program = parse(text, 0)?;
    let listed =
        InListing { text, program: &program, calls: vec![vec![Vec::new(); program.routine.body.len()]] };
    let ways = [program.routine.ways()];
    let mut follower = Follower::new(&listed, &ways);
    let mut reader = Reader {
        listed: &listed,
        controller: given.config.map(controller_frames).unwrap_or_default(),
        given: [given.tool, given.base],
        used: [None, None],
        points: Points::new(write, |parts| parts),
        reached: HashSet::new(),
        copied: Vec::new(),
    };
    follower.visit(0, InProgram::before(), &mut |at, state| reader.statement(at, state))?;
    reader.points.leave_unreached(text, [&program.routine], is_motion, &reader.reached);
    let mut points = reader.completed()?;
    points.warn_of_external_axes(text, external);
    Ok(points)
}

/// The number of a frame that is selected.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Selected {
    NotSet,
    Computed,
    Number(u32),
}

/// A program that was called, and the line of the call.
type Called = Option<(String, usize)>;

/// The settings in force at a statement.
#[derive(Clone, PartialEq)]
struct InProgram {
    /// The numbers of the selected tool and user frame.
    selected: [InForce<Selected>; 2],
    /// The first call since tool and user frame were selected.
    called: [Called; 2],
    /// Registers, and the frames that the program defines.
    registers: Scope,
    /// The last line that defined a frame, or that called a program which may have defined one.
    defined_line: usize,
}

impl InProgram {
    fn before() -> Self {
        let none = || InForce::One { value: Selected::NotSet, line: 0 };
        Self {
            selected: [none(), none()],
            called: [None, None],
            registers: Scope::default(),
            defined_line: 0,
        }
    }
}

impl State for InProgram {
    fn join(&mut self, other: &Self) {
        self.selected.iter_mut().zip(&other.selected).for_each(|(known, other)| known.join(other));
        for (known, other) in self.called.iter_mut().zip(&other.called) {
            if known.is_none() {
                known.clone_from(other);
            }
        }
        self.registers.join(&other.registers);
        self.defined_line = self.defined_line.max(other.defined_line);
    }
}

struct InListing<'a> {
    text: Text<'a>,
    program: &'a TpProgram,
    /// Empty for each statement: a listing has only one program.
    calls: Vec<Vec<Vec<usize>>>,
}

impl<'a> InListing<'a> {
    fn statement(&self, (_, at): At) -> &'a Statement {
        &self.program.routine.body[at]
    }

    fn lookup(&self, state: &InProgram, name: &str) -> Option<Value> {
        match state.registers.get(name) {
            Some(value) => value.cloned(),
            None => self.program.positions.get(name).cloned(),
        }
    }
}

impl Followed for InListing<'_> {
    type State = InProgram;

    fn calls(&self, (routine, at): At) -> &[usize] {
        &self.calls[routine][at]
    }

    fn apply(&self, at: At, state: &mut InProgram) {
        let Statement { span, kind, .. } = self.statement(at);
        let line = self.text.line(span.start);
        let (name, arguments) = match kind {
            StatementKind::Call { name, arguments } => (name, arguments),
            // Another program is started, now or when a condition holds.
            StatementKind::Other(word) if word == "RUN" || word == "MONITOR" => {
                state.call(word, line);
                return;
            }
            StatementKind::Assign { .. }
            | StatementKind::Declare { .. }
            | StatementKind::UntilSteady
            | StatementKind::Control { .. }
            | StatementKind::Other(_) => return,
        };
        if is_motion(name) {
            return;
        }
        if !is_instruction(name) {
            state.call(name, line);
            return;
        }
        let value = evaluated(arguments, 0, &|name| self.lookup(state, name))
            .into_iter()
            .next()
            .and_then(|given| given.value);
        for (kind, (selected, called)) in KINDS.iter().zip(state.selected.iter_mut().zip(&mut state.called)) {
            let by_variable = name.starts_with("$MNUFRAMENUM") || name.starts_with("$MNUTOOLNUM");
            if name.split('[').next() == Some(kind.select) || by_variable {
                let number = value.as_ref().and_then(Value::number).filter(|_| name == kind.select);
                let value = number.map_or(Selected::Computed, |number| Selected::Number(number as u32));
                (*selected, *called) = (InForce::One { value, line }, None);
            }
        }
        if name.starts_with("$MNU") || KINDS.iter().any(|kind| name.split('[').next() == Some(kind.array)) {
            state.defined_line = line;
        }
        if name.ends_with("[]") {
            // The number of the register is computed: any register may be set.
            state.registers.forget();
        }
        if name.starts_with("$MNU") {
            KINDS.iter().for_each(|kind| state.registers.set(&kind.any(), None));
        } else if name.contains('[') {
            state.registers.set(name, value);
        }
    }

    fn forget(&self, at: At, state: &mut InProgram) {
        let line = self.text.line(self.statement(at).span.start);
        state.selected.iter_mut().for_each(|selected| selected.forget(line));
        state.registers.forget();
    }
}

impl InProgram {
    /// The state after a program of another file, which may have changed any register.
    fn call(&mut self, program: &str, line: usize) {
        for called in &mut self.called {
            called.get_or_insert_with(|| (program.to_owned(), line));
        }
        self.registers.forget();
        self.defined_line = line;
    }
}

/// Notes the points of the statements that are visited.
struct Reader<'a> {
    listed: &'a InListing<'a>,
    /// The frames of the controller by their names.
    controller: HashMap<String, Pose>,
    /// Tool and user frame given by the user, and the number that each of them was used for.
    given: [Option<Pose>; 2],
    used: [Option<u32>; 2],
    points: Points,
    reached: HashSet<At>,
    /// The positions that are copied to a register, by their first byte, each with the finding if no motion uses the
    /// position.
    copied: Vec<(usize, Diagnostic)>,
}

impl Reader<'_> {
    fn statement(&mut self, at: At, state: &InProgram) -> Result<(), Diagnostic> {
        let (listed, text) = (self.listed, self.listed.text);
        self.reached.insert(at);
        let Statement { span, kind, .. } = listed.statement(at);
        let (name, arguments) = match kind {
            StatementKind::Call { name, arguments } => (name, arguments),
            StatementKind::Other(word) => {
                if is_motion(word) || OTHER_MOTIONS.contains(&word.as_str()) {
                    self.points.leave(text, span, CompensationFinding::NotRead { word: word.clone() });
                }
                return Ok(());
            }
            StatementKind::Assign { .. }
            | StatementKind::Declare { .. }
            | StatementKind::UntilSteady
            | StatementKind::Control { .. } => return Ok(()),
        };
        let arguments = evaluated(arguments, 0, &|name| listed.lookup(state, name));
        match Instruction::new(name, &arguments) {
            Some(instruction) => {
                let read = self.motion(span, &instruction, state);
                read.or_else(|why| self.points.leave_motion(text, span, why))
            }
            None => {
                self.note_copied(span, name, &arguments);
                Ok(())
            }
        }
    }

    fn motion(
        &mut self,
        span: &Span,
        instruction: &Instruction<'_>,
        state: &InProgram,
    ) -> Result<(), Diagnostic> {
        let text = self.listed.text;
        let line = text.line(span.start);
        match instruction.effect() {
            Some(OptionEffect::Relative) => {
                self.points.leave(text, span, CompensationFinding::RelativeMotion);
                return Ok(());
            }
            Some(OptionEffect::FixedTool(word)) => {
                return Err(text.wrong(span, CompensationFinding::FixedTool { name: word.to_owned() }));
            }
            Some(OptionEffect::Displaced(word)) => {
                let word = word.to_owned();
                self.share(instruction, line);
                return Err(text.wrong(span, CompensationFinding::Displaced { word, line }));
            }
            Some(OptionEffect::Unknown(word)) => {
                let word = word.to_owned();
                self.share(instruction, line);
                return Err(text.wrong(span, CompensationFinding::OptionUnknown { word, line }));
            }
            None => {}
        }
        for argument in instruction.points() {
            let found = argument.value.as_ref().and_then(taught);
            let branch = found.as_ref().map(|taught| {
                match (&taught.target, taught.configuration, instruction.motion) {
                    (Target::Axes(_), _, _) => Ok(Branch::Nearest),
                    (Target::Pose { .. }, Some(configuration), MotionKind::Ptp) => {
                        Ok(Branch::ByFanuc(configuration))
                    }
                    (Target::Pose { .. }, Some(configuration), _) => Ok(Branch::OnLine(configuration)),
                    (Target::Pose { .. }, None, MotionKind::Ptp) => {
                        Err(CompensationFinding::NoFanucConfiguration {
                            name: argument.variable().unwrap_or("this point").to_owned(),
                        })
                    }
                    (Target::Pose { .. }, None, _) => Ok(Branch::Nearest),
                }
            });
            let branch = branch.transpose().map_err(|why| text.wrong(span, why))?;
            // A register has no frame numbers of its own: the selected frames apply.
            let is_own = argument.variable().is_some_and(|name| name.starts_with("P["));
            let numbers = found.as_ref().filter(|_| is_own).map_or([None, None], |taught| taught.frames);
            let frames = match &found {
                Some(Taught { target: Target::Pose { .. }, .. }) => Some(self.frames(span, state, numbers)?),
                Some(_) | None => None,
            };
            let target = found.map(|taught| taught.target).zip(branch);
            let frames = || Ok(frames.unwrap_or(Frames { tool: Pose::identity(), base: Pose::identity() }));
            self.points.add(text, span, argument, target, frames)?;
        }
        Ok(())
    }

    /// Leaves the points of a motion, which stays as it is.
    fn share(&mut self, instruction: &Instruction<'_>, line: usize) {
        let values = instruction.points().filter_map(|argument| argument.value.as_ref());
        values.for_each(|value| self.points.share(value, line));
    }

    /// The frames of a motion; `own` are the frame numbers of its position.
    fn frames(
        &mut self,
        motion: &Span,
        state: &InProgram,
        own: [Option<u32>; 2],
    ) -> Result<Frames, Diagnostic> {
        let text = self.listed.text;
        let mut found = [Pose::identity(), Pose::identity()];
        for at in 0..KINDS.len() {
            let number = self.number(at, motion, state, own[at]).map_err(|why| text.wrong(motion, why))?;
            found[at] = self.value(at, state, number).map_err(|why| text.wrong(motion, why))?;
        }
        let [tool, base] = found;
        Ok(Frames { tool, base })
    }

    /// The number of a frame: the number in the position, which the controller compares with the selected one; without
    /// it, the selected number.
    fn number(
        &mut self,
        at: usize,
        motion: &Span,
        state: &InProgram,
        own: Option<u32>,
    ) -> Result<u32, CompensationFinding> {
        let FrameKind { name: frame, select, .. } = KINDS[at];
        let (selected, line) = match &state.selected[at] {
            InForce::One { value, line } => (*value, *line),
            InForce::Mixed(lines) => return Err(mixed(frame, *lines)),
        };
        let called = &state.called[at];
        match (own, selected) {
            (Some(own), Selected::Number(number)) if own != number && called.is_none() => {
                Err(CompensationFinding::FrameDiffers { frame: select, stated: "the point" })
            }
            (None, Selected::Number(number)) => {
                if let Some((routine, line)) = called.clone() {
                    let warning = CompensationFinding::FrameAfterCall { frame, routine, line };
                    self.points.warnings.push(self.listed.text.wrong(motion, warning));
                }
                Ok(number)
            }
            (_, Selected::Computed) => Err(CompensationFinding::FrameComputed { frame, line }),
            (Some(own), Selected::NotSet | Selected::Number(_)) => Ok(own),
            (None, Selected::NotSet) => Err(CompensationFinding::FrameNotSet { frame }),
        }
    }

    /// The value of a frame: as defined by the program, else as stated by the controller or the user.
    fn value(&mut self, at: usize, state: &InProgram, number: u32) -> Result<Pose, CompensationFinding> {
        let FrameKind { name: kind, stated, array, .. } = KINDS[at];
        if number == 0 {
            return Ok(Pose::identity());
        }
        let name = format!("{array}[{number}]");
        let defined = state.registers.get(&name).or_else(|| state.registers.get(&KINDS[at].any()));
        if let Some(defined) = defined {
            let line = state.defined_line;
            return defined.and_then(frame).ok_or(CompensationFinding::FrameComputed { frame: kind, line });
        }
        if let Some(known) = self.controller.get(&name) {
            return Ok(*known);
        }
        let elsewhere = || CompensationFinding::FrameElsewhere { frame: kind, name: name.clone() };
        let given = self.given[at].ok_or_else(elsewhere)?;
        match self.used[at].replace(number) {
            Some(other) if other != number => {
                let first = format!("{array}[{other}]");
                Err(CompensationFinding::TwoFrames { stated, first, second: name })
            }
            Some(_) | None => Ok(given),
        }
    }

    /// Notes a position that is copied to a register: a program that is called may move there.
    fn note_copied(&mut self, span: &Span, name: &str, arguments: &[Evaluated<'_>]) {
        let is_definition = KINDS.iter().any(|kind| name.split('[').next() == Some(kind.array));
        for argument in arguments {
            let Some(value) = argument.value.as_ref().filter(|value| taught(value).is_some()) else {
                continue;
            };
            let start = value.span.start;
            if is_definition {
                self.copied.retain(|(known, _)| *known != start);
            } else if let Some(ExpressionKind::Name(_)) =
                argument.expression.map(|expression| &expression.kind)
            {
                let point = value.name.clone().unwrap_or_default();
                let finding = CompensationFinding::PointOfOtherCall { name: point, call: name.to_owned() };
                if !self.copied.iter().any(|(known, _)| *known == start) {
                    self.copied.push((start, self.listed.text.wrong(span, finding)));
                }
            }
        }
    }

    fn completed(self) -> Result<Points, Diagnostic> {
        let mut points = self.points.completed(self.listed.text)?;
        let is_corrected = |start: usize| points.points.iter().any(|point| point.value.span.start == start);
        let left = self.copied.into_iter().filter(|(start, _)| !is_corrected(*start));
        let left: Vec<Diagnostic> = left.map(|(_, finding)| finding).collect();
        points.not_corrected.extend(left);
        Ok(points)
    }
}

fn write(
    corrector: &Corrector,
    point: &Point,
    corrected: &Corrected,
    text: Text<'_>,
) -> Result<Vec<Edit>, CompensationFinding> {
    let [_, config, numbers, _] = elements(&point.value)?;
    let Some(frames) = &point.frames else {
        return Ok(replaced(numbers, &corrected.numbers, text, DECIMALS)?.0);
    };
    let (mut edits, printed) = replaced(numbers, &swapped(corrected.numbers), text, DECIMALS)?;
    let Some([taught, new]) = corrector.fanuc(corrected, &pose(printed), frames)? else { return Ok(edits) };
    let written: Option<FanucConfiguration> =
        if let Content::Text(config) = &config.content { config.parse().ok() } else { None };
    // On a line the controller ignores the turns, and some programs have dummy values there.
    let is_dummy = matches!(point.branch, Branch::OnLine(_)) && written != Some(taught);
    if written.is_some() && written != Some(new) && !is_dummy {
        edits.push((config.span.clone(), format!("'{new}'")));
    }
    Ok(edits)
}
