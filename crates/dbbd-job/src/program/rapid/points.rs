//! The points of a RAPID module and their correction.

use std::collections::{BTreeMap, HashMap, HashSet};

use super::instruction::{Instruction, is_motion};
use super::literal::{component, external, not_of_unit_length, predefined, taught, tool, work_object};
use super::parser::{LATE_BOUND, Module, parse};
use super::program::declared;
use crate::program::CompensationFinding;
use crate::program::MotionKind;
use crate::program::compensate::{Branch, Corrected, Corrector, mixed};
use crate::program::flow::{At, Calls, Followed, Follower, InForce, State, Ways, reached_from};
use crate::program::script::expression::{
    Argument, ExpressionKind, Parameter, Routine, Statement, StatementKind, calls,
};
use crate::program::script::points::{OtherInstructions, Point, Points, elements, replaced};
use crate::program::script::scope::Scope;
use crate::program::script::value::{self, Content, Evaluated, Value, evaluated};
use crate::program::text::{Edit, Span, Text};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

/// Minimum number of decimals of a length, an axis angle and a component of a quaternion.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 5;
const DECIMALS_QUATERNION: usize = 8;

const OTHERS: OtherInstructions = OtherInstructions {
    motions: &["MOVE", "TRIGG", "SEARCH", "ARC", "SPOT", "PAINT", "DISP"],
    displacements: &[],
    settings: &[],
};

/// Instructions that displace the motions after them, each group with the instruction that ends the displacement.
const DISPLACING: [(&[&str], &str); 2] =
    [(&["PDISPON", "PDISPSET"], "PDISPOFF"), (&["EOFFSON", "EOFFSSET"], "EOFFSOFF")];
const DISPLACEMENT: &str = "the displacement";
/// Starts of the names of instructions that measure a tool and write it: `MToolTCPCalib`, `SToolRotCalib`.
const MEASURING: [&str; 2] = ["MTOOL", "STOOL"];

/// The parts of a target that a correction rewrites: the axes, or position and orientation. Configuration and external axes may be
/// those of a variable.
fn rewritten(target: &[Value]) -> &[Value] {
    match target {
        [axes, _] => std::slice::from_ref(axes),
        [_, _, _, _] => &target[..2],
        _ => target,
    }
}

/// The points of a module; `config` is a module with tools and work objects.
pub fn read(text: Text<'_>, config: Option<Text<'_>>) -> Result<Points, Diagnostic> {
    let module = parse(text, 0)?;
    let config = config.map(|config| parse(config, 1)).transpose()?;
    let routines: Vec<&Routine> = module.routines.iter().chain(&module.functions).collect();
    let program = InFile::new(text, &module, config.as_ref(), routines);
    let ways: Vec<Ways> = program.routines.iter().map(|routine| routine.ways()).collect();
    let mut follower = Follower::new(&program, &ways);
    let mut reader = Reader {
        program: &program,
        points: Points::new(write, rewritten),
        reached: HashSet::new(),
        used: HashSet::new(),
        given_away: Vec::new(),
    };
    let data_at_begin = program.data_at_begin();
    let all = 0..program.routines.len();
    // The program begins in `main`; routines that `main` does not reach are called from other modules.
    let (main, others): (Vec<usize>, Vec<usize>) = all.partition(|at| program.routines[*at].name == "MAIN");
    for at in main.into_iter().chain(others) {
        let routine = program.routines[at];
        if !follower.has_visited(at) {
            let mut state = InRoutine::before(routine, data_at_begin.clone());
            if routine.is_concurrent {
                state.forget_modes(text.line(routine.body.first().map_or(0, |first| first.span.start)));
            }
            follower.visit(at, state, &mut |at, state| reader.statement(at, state))?;
        }
    }
    reader.points.leave_unreached(text, program.routines.iter().copied(), is_motion, &reader.reached);
    let mut points = reader.completed()?;
    points.warn_of_external_axes(text, external);
    Ok(points)
}

/// The settings in force at a statement.
#[derive(Clone, PartialEq)]
struct InRoutine {
    /// The parameters and variables of the routine.
    locals: Scope,
    /// The data of the modules to which the program assigns.
    data: Scope,
    /// Whether `MoveJ` goes to the configuration of its point.
    conf_j: InForce<bool>,
    /// Whether `MoveL` and `MoveC` check it.
    conf_l: InForce<bool>,
    /// The instruction that displaces the motions, for each group of [`DISPLACING`].
    displaced: [InForce<Option<String>>; 2],
}

impl InRoutine {
    /// The settings at the begin of a routine that is called from elsewhere, with what is known of the data.
    fn before(routine: &Routine, data: Scope) -> Self {
        let none = || InForce::One { value: None, line: 0 };
        let [conf_j, conf_l] = [true, true].map(|value| InForce::One { value, line: 0 });
        Self { locals: parameters(routine), data, conf_j, conf_l, displaced: [none(), none()] }
    }

    fn forget_modes(&mut self, line: usize) {
        self.conf_j.forget(line);
        self.conf_l.forget(line);
        self.displaced.iter_mut().for_each(|displaced| displaced.forget(line));
    }
}

/// The parameters of a routine without values.
fn parameters(routine: &Routine) -> Scope {
    let mut locals = Scope::default();
    routine.parameters.iter().for_each(|parameter| locals.set(&parameter.name, None));
    locals
}

impl State for InRoutine {
    fn join(&mut self, other: &Self) {
        self.locals.join(&other.locals);
        self.data.join(&other.data);
        self.conf_j.join(&other.conf_j);
        self.conf_l.join(&other.conf_l);
        self.displaced.iter_mut().zip(&other.displaced).for_each(|(known, other)| known.join(other));
    }
}

/// The module of a program, with the results of a first look before it is followed.
struct InFile<'a> {
    text: Text<'a>,
    module: &'a Module,
    config: Option<&'a Module>,
    routines: Vec<&'a Routine>,
    /// The routines that each statement calls; indexed by routine and statement.
    calls: Calls,
    changing: Changing<'a>,
    /// The data of the modules that a statement changes, with the last line that changes them.
    assigned_lines: HashMap<&'a str, usize>,
    /// Those that a TRAP changes.
    assigned_beside: HashSet<&'a str>,
    /// A line of a TRAP that displaces motions.
    displaced_beside: Option<(String, usize)>,
}

impl<'a> InFile<'a> {
    fn new(
        text: Text<'a>,
        module: &'a Module,
        config: Option<&'a Module>,
        routines: Vec<&'a Routine>,
    ) -> Self {
        let calls = calls(routines.iter().copied());
        let changing = changing(&routines);
        let traps = (0..routines.len()).filter(|at| routines[*at].is_concurrent).collect();
        let beside = reached_from(traps, &calls);
        let (mut assigned_lines, mut assigned_beside) = (HashMap::new(), HashSet::new());
        for (at, routine) in routines.iter().enumerate() {
            for statement in &routine.body {
                let names = changed(statement, &routines, &changing);
                for name in names.into_iter().filter(|name| !is_local(routine, name)) {
                    assigned_lines.insert(name, text.line(statement.span.start));
                    assigned_beside.extend(beside.contains(&at).then_some(name));
                }
            }
        }
        let displaced_beside = beside.iter().flat_map(|at| &routines[*at].body).find_map(|statement| {
            let StatementKind::Call { name, .. } = &statement.kind else { return None };
            let is_displacing = DISPLACING.iter().any(|(on, _)| on.contains(&name.as_str()));
            is_displacing.then(|| (name.clone(), text.line(statement.span.start)))
        });
        Self {
            text,
            module,
            config,
            routines,
            calls,
            changing,
            assigned_lines,
            assigned_beside,
            displaced_beside,
        }
    }

    /// What is known of the data to which the program assigns, at its begin: their components to which it does not assign. An earlier
    /// run may have left anything in the others.
    fn data_at_begin(&self) -> Scope {
        let mut known: BTreeMap<&str, Option<Value>> =
            self.assigned_lines.keys().map(|name| (*name, self.data(name))).collect();
        for routine in &self.routines {
            for statement in &routine.body {
                let components = assigned_components(&statement.kind);
                for name in changed(statement, &self.routines, &self.changing) {
                    if let Some(value) = known.get_mut(name).filter(|_| !is_local(routine, name)) {
                        assign(value, components, None);
                    }
                }
            }
        }
        let mut data = Scope::default();
        known.into_iter().for_each(|(name, value)| data.set(name, value));
        data
    }

    fn statement(&self, (routine, at): At) -> &'a Statement {
        &self.routines[routine].body[at]
    }

    /// The value of data as it is declared, outside of any routine.
    fn data(&self, name: &str) -> Option<Value> {
        let own = declared(self.module, name, 0);
        own.or_else(|| declared(self.config?, name, 1)).or_else(|| predefined(name))
    }

    fn lookup(&self, state: &InRoutine, name: &str) -> Option<Value> {
        match state.locals.get(name).or_else(|| state.data.get(name)) {
            Some(variable) => variable.cloned(),
            None => self.data(name),
        }
    }

    /// Forgets the data that are given to a parameter which the routine changes: there they have two names.
    fn forget_given(&self, routine: &Routine, arguments: &[Argument], state: &mut InRoutine) {
        for (at, argument) in arguments.iter().enumerate() {
            if let (Some(parameter), Some(name)) =
                (bound(routine, arguments, at, argument), variable(argument))
                && self.changing.contains(&(routine.name.as_str(), parameter.name.as_str()))
                && state.data.get(name).is_some()
            {
                state.data.set(name, None);
            }
        }
    }
}

/// The components to which a statement assigns; none if it is a whole variable, or another statement.
fn assigned_components(kind: &StatementKind) -> &[String] {
    if let StatementKind::Assign { components, .. } = kind { components } else { &[] }
}

/// Assigns to a component of a variable; `None` for a value that is not known.
fn assign(variable: &mut Option<Value>, components: &[String], given: Option<Value>) {
    let place = if components.is_empty() {
        None
    } else {
        variable.as_mut().and_then(|variable| component(variable, components))
    };
    match (place, given) {
        (Some(place), Some(given)) => *place = given,
        (Some(place), None) => place.content = Content::Unknown,
        (None, given) => *variable = given.filter(|_| components.is_empty()),
    }
}

fn is_local(routine: &Routine, name: &str) -> bool {
    routine.parameters.iter().any(|parameter| parameter.name == name)
        || routine.body.iter().any(
            |statement| matches!(&statement.kind, StatementKind::Declare { name: local, .. } if local == name),
        )
}

/// Pairs of a routine and a parameter of it whose variable the routine changes.
type Changing<'a> = HashSet<(&'a str, &'a str)>;

/// The parameters that routines change, directly or through a routine to which they pass them.
fn changing<'a>(routines: &[&'a Routine]) -> Changing<'a> {
    let mut changing = Changing::new();
    loop {
        let known = changing.len();
        for routine in routines {
            let changed: Vec<&str> =
                routine.body.iter().flat_map(|statement| changed(statement, routines, &changing)).collect();
            let references = routine.parameters.iter().filter(|parameter| parameter.is_reference);
            let references = references.map(|parameter| parameter.name.as_str());
            let new = references.filter(|name| changed.contains(name));
            changing.extend(new.map(|name| (routine.name.as_str(), name)));
        }
        if changing.len() == known {
            return changing;
        }
    }
}

/// The variables that a statement may change.
fn changed<'s>(statement: &'s Statement, routines: &[&Routine], changing: &Changing<'_>) -> Vec<&'s str> {
    match &statement.kind {
        StatementKind::Assign { name, .. } | StatementKind::Other(name) => vec![name],
        StatementKind::Call { name, arguments } => {
            let routine = routines.iter().find(|routine| routine.name == *name);
            let is_measuring = MEASURING.iter().any(|start| name.starts_with(start));
            let is_changed = |at: usize, argument: &Argument| {
                let parameter = routine.and_then(|routine| bound(routine, arguments, at, argument));
                let is_changing =
                    |parameter: &Parameter| changing.contains(&(name.as_str(), parameter.name.as_str()));
                parameter.map_or(is_measuring, is_changing)
            };
            let arguments = arguments.iter().enumerate();
            let changed = arguments.filter(|(at, argument)| is_changed(*at, argument));
            changed.filter_map(|(_, argument)| variable(argument)).collect()
        }
        StatementKind::Declare { .. } | StatementKind::UntilSteady | StatementKind::Control { .. } => {
            Vec::new()
        }
    }
}

/// The name of an argument that is a variable.
fn variable(argument: &Argument) -> Option<&str> {
    match &argument.value.as_ref()?.kind {
        ExpressionKind::Name(name) => Some(name),
        ExpressionKind::Number(_)
        | ExpressionKind::Text(_)
        | ExpressionKind::Bool(_)
        | ExpressionKind::List(_)
        | ExpressionKind::Pose(_)
        | ExpressionKind::Call { .. }
        | ExpressionKind::Computed => None,
    }
}

/// The parameter that takes an argument; `at` is the index of the argument.
fn bound<'r>(
    routine: &'r Routine,
    arguments: &[Argument],
    at: usize,
    argument: &Argument,
) -> Option<&'r Parameter> {
    if let Some(name) = &argument.name {
        return routine.parameters.iter().find(|parameter| parameter.name.eq_ignore_ascii_case(name));
    }
    let before = arguments.iter().take(at).filter(|argument| argument.name.is_none()).count();
    routine.parameters.iter().filter(|parameter| !parameter.is_optional).nth(before)
}

impl Followed for InFile<'_> {
    type State = InRoutine;

    fn calls(&self, (routine, at): At) -> &[usize] {
        &self.calls[routine][at]
    }

    fn enter(&self, at: At, routine: usize, state: &InRoutine) -> InRoutine {
        let routine = self.routines[routine];
        let mut entry = InRoutine { locals: parameters(routine), ..state.clone() };
        if let StatementKind::Call { name, arguments } = &self.statement(at).kind
            && *name == routine.name
        {
            let lookup = |name: &str| self.lookup(state, name);
            for (at, argument) in arguments.iter().enumerate() {
                if let (Some(parameter), Some(given)) =
                    (bound(routine, arguments, at, argument), &argument.value)
                {
                    entry.locals.set(&parameter.name, value::value(given, 0, &lookup));
                }
            }
            self.forget_given(routine, arguments, &mut entry);
        }
        entry
    }

    fn leave(&self, _: usize, before: &InRoutine, after: InRoutine) -> InRoutine {
        InRoutine { locals: before.locals.clone(), ..after }
    }

    fn apply(&self, at: At, state: &mut InRoutine) {
        let statement @ Statement { span, kind, .. } = self.statement(at);
        let lookup = |name: &str| self.lookup(state, name);
        let given = match kind {
            StatementKind::Assign { value, .. } | StatementKind::Declare { value: Some(value), .. } => {
                value::value(value, 0, &lookup)
            }
            StatementKind::Declare { value: None, .. }
            | StatementKind::Call { .. }
            | StatementKind::UntilSteady
            | StatementKind::Control { .. }
            | StatementKind::Other(_) => None,
        };
        let named = |name: &str| given.clone().map(|value| Value { name: Some(name.to_owned()), ..value });
        if let StatementKind::Declare { name, .. } = kind {
            state.locals.set(name, named(name));
            return;
        }
        let routine = self.routines[at.0];
        let components = assigned_components(kind);
        for name in changed(statement, &self.routines, &self.changing) {
            let given = if components.is_empty() { named(name) } else { given.clone() };
            let scope = if is_local(routine, name) { &mut state.locals } else { &mut state.data };
            let mut value = scope.get(name).flatten().cloned();
            assign(&mut value, components, given.filter(|_| !self.assigned_beside.contains(name)));
            scope.set(name, value);
        }
        // A routine that is called by a name which is computed may be any of them.
        if matches!(kind, StatementKind::Other(word) | StatementKind::Call { name: word, .. } if LATE_BOUND.contains(&word.as_str()))
        {
            state.data.forget();
        }
        let StatementKind::Call { name, arguments } = kind else { return };
        let line = self.text.line(span.start);
        if name == "CONFJ" || name == "CONFL" {
            let is_off = arguments.iter().any(|argument| {
                argument.name.as_deref().is_some_and(|switch| switch.eq_ignore_ascii_case("Off"))
            });
            let conf = if name == "CONFJ" { &mut state.conf_j } else { &mut state.conf_l };
            *conf = InForce::One { value: !is_off, line };
        }
        for ((on, off), displaced) in DISPLACING.into_iter().zip(&mut state.displaced) {
            if on.contains(&name.as_str()) {
                *displaced = InForce::One { value: Some(name.clone()), line };
            } else if name == off {
                *displaced = InForce::One { value: None, line };
            }
        }
    }

    fn forget(&self, at: At, state: &mut InRoutine) {
        state.locals.forget();
        state.data.forget();
        state.forget_modes(self.text.line(self.statement(at).span.start));
    }
}

/// Notes the points of the statements that are visited.
struct Reader<'a> {
    program: &'a InFile<'a>,
    points: Points,
    reached: HashSet<At>,
    /// The tools and work objects of motions.
    used: HashSet<String>,
    /// Tools and work objects that are passed to routines of other files, each with the finding about it.
    given_away: Vec<(String, Diagnostic)>,
}

impl Reader<'_> {
    fn statement(&mut self, at: At, state: &InRoutine) -> Result<(), Diagnostic> {
        let (program, text) = (self.program, self.program.text);
        self.reached.insert(at);
        let lookup = |name: &str| program.lookup(state, name);
        let Statement { span, kind, .. } = program.statement(at);
        let (name, arguments) = if let StatementKind::Call { name, arguments } = kind {
            (name.as_str(), evaluated(arguments, 0, &lookup))
        } else {
            ("", Vec::new())
        };
        let Some(instruction) = Instruction::new(name, &arguments) else {
            if program.calls(at).is_empty() {
                self.note_given_away(span, name, &arguments);
                self.points.other(text, (span, kind), &arguments, &OTHERS, |value| taught(value).is_some());
            }
            return Ok(());
        };
        self.used.extend(instruction.frame_names().map(str::to_owned));
        let read = self.motion(span, &instruction, state);
        read.or_else(|why| self.points.leave_motion(text, span, why))
    }

    fn motion(
        &mut self,
        span: &Span,
        instruction: &Instruction<'_>,
        state: &InRoutine,
    ) -> Result<(), Diagnostic> {
        let (program, text) = (self.program, self.program.text);
        // A parameter or variable of the routine is not data of the module.
        let assigned_line = |name: &str| match state.locals.get(name) {
            Some(_) => None,
            None => program.data(name).and(program.assigned_lines.get(name).copied()),
        };
        if let Some(why) = instruction.computed(|value| self.points.is_own(value), assigned_line) {
            return Err(text.wrong(span, why));
        }
        for argument in instruction.points() {
            if let Some(why) = argument.value.as_ref().and_then(not_of_unit_length) {
                return Err(text.wrong(span, why));
            }
            let taught = match argument.value.as_ref().and_then(taught) {
                Some((target, Some(quadrants))) if instruction.motion == MotionKind::Ptp => {
                    let to_configuration = match &state.conf_j {
                        InForce::One { value, .. } => *value,
                        InForce::Mixed(lines) => return Err(text.wrong(span, mixed("ConfJ", *lines))),
                    };
                    let nearest = Branch::Nearest;
                    Some((target, if to_configuration { Branch::ByQuadrants(quadrants) } else { nearest }))
                }
                Some((target, Some(quadrants))) => {
                    let is_on = matches!(state.conf_l, InForce::One { value: true, .. });
                    Some((target, if is_on { Branch::NearestElse(quadrants) } else { Branch::Nearest }))
                }
                taught => taught.map(|(target, _)| (target, Branch::Nearest)),
            };
            let frames = || {
                let displaced = program.displaced(state).map_or(Ok(()), Err);
                displaced.and_then(|()| instruction.frames()).map_err(|why| text.wrong(span, why))
            };
            self.points.add(text, span, argument, taught, frames)?;
        }
        Ok(())
    }

    /// Notes the tools and work objects that are passed to a routine of another file.
    fn note_given_away(&mut self, span: &Span, routine: &str, arguments: &[Evaluated<'_>]) {
        if OTHERS.motions.iter().any(|motion| routine.starts_with(motion)) {
            return;
        }
        for argument in arguments {
            let is_frame = |value: &Value| tool(value).is_some() || work_object(value).is_some();
            if let (Some(name), Some(_)) =
                (argument.variable(), argument.value.as_ref().filter(|v| is_frame(v)))
            {
                let (name, routine) = (name.to_owned(), routine.to_owned());
                let finding = CompensationFinding::FrameGivenAway { name: name.clone(), routine };
                if !self.given_away.iter().any(|(known, _)| *known == name) {
                    self.given_away.push((name, self.program.text.wrong(span, finding)));
                }
            }
        }
    }

    fn completed(self) -> Result<Points, Diagnostic> {
        let mut points = self.points.completed(self.program.text)?;
        let given_away = self.given_away.into_iter().filter(|(name, _)| self.used.contains(name));
        points.warnings.extend(given_away.map(|(_, finding)| finding));
        Ok(points)
    }
}

impl InFile<'_> {
    /// Why the poses of a motion are displaced.
    fn displaced(&self, state: &InRoutine) -> Option<CompensationFinding> {
        if let Some((word, line)) = self.displaced_beside.clone() {
            return Some(CompensationFinding::Displaced { word, line });
        }
        state.displaced.iter().find_map(|displaced| match displaced {
            InForce::One { value, line } => {
                let (word, line) = (value.clone()?, *line);
                Some(CompensationFinding::Displaced { word, line })
            }
            InForce::Mixed(lines) => Some(mixed(DISPLACEMENT, *lines)),
        })
    }
}

fn write(
    corrector: &Corrector,
    point: &Point,
    corrected: &Corrected,
    text: Text<'_>,
) -> Result<Vec<Edit>, CompensationFinding> {
    let Some(frames) = &point.frames else {
        let [axes, _] = elements(&point.value)?;
        return Ok(replaced(axes, &corrected.numbers, text, DECIMALS_DEG)?.0);
    };
    let pose = Pose::from_xyzabc(corrected.numbers);
    let [position, orientation, configuration, _] = elements(&point.value)?;
    let (mut edits, position) = replaced(position, &pose.position.into(), text, DECIMALS_MM)?;
    let taught: [f64; 4] = orientation.numbers().ok_or(CompensationFinding::PointShape { numbers: 4 })?;
    // An orientation has two quaternions: the one nearer to the taught quaternion.
    let new = pose.quaternion();
    let cosine: f64 = taught.iter().zip(new).map(|(taught, new)| taught * new).sum();
    let new = new.map(|part| if cosine < 0.0 { -part } else { part });
    let (orientation_edits, quaternion) = replaced(orientation, &new, text, DECIMALS_QUATERNION)?;
    edits.extend(orientation_edits);
    let printed =
        Pose::from_quaternion(position, quaternion).ok_or(CompensationFinding::PointShape { numbers: 4 })?;
    let quadrants = corrector.quadrants(corrected, &printed, frames)?;
    // A configuration that differs from the taught one is a dummy: with `ConfJ\Off` and `ConfL\Off` the controller
    // ignores it.
    let is_taught = configuration.numbers() == Some(corrector.taught_quadrants(corrected).map(f64::from));
    let is_dummy = matches!(point.branch, Branch::Nearest | Branch::NearestElse(_)) && !is_taught;
    if !is_dummy && !configuration.is_inside(&point.value) {
        let written: Option<[f64; 4]> = configuration.numbers();
        let is_same = written.is_some_and(|written| written == quadrants.map(f64::from));
        return if is_same { Ok(edits) } else { Err(CompensationFinding::SharedConfiguration) };
    }
    for (old, new) in elements::<4>(configuration)?.iter().zip(quadrants).filter(|_| !is_dummy) {
        if old.number() != Some(f64::from(new)) {
            edits.push((old.span.clone(), new.to_string()));
        }
    }
    Ok(edits)
}
