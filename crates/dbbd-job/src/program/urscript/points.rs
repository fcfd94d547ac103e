//! The points of a script and their correction.

use std::collections::HashSet;

use nalgebra::Vector3;

use super::instruction::{Instruction, argument, is_motion, pose, target};
use super::parser::parse;
use crate::program::CompensationFinding;
use crate::program::compensate::{Branch, Corrected, Corrector, mixed};
use crate::program::flow::{At, Calls, Followed, Follower, InForce, State, Ways, reached_from};
use crate::program::script::expression::{ExpressionKind, Routine, Statement, StatementKind, calls};
use crate::program::script::points::{OtherInstructions, Point, Points, replaced};
use crate::program::script::scope::Scope;
use crate::program::script::value::{self, Evaluated, Value, evaluated};
use crate::program::text::{Edit, Span, Text};
use crate::program::{Frames, Target};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;
use dbbd_model::robot::pose::rotation_vector;

/// Minimum number of decimals of a number: in metres 0.1 um, in radians less than 0.1 um at a distance of a metre.
const DECIMALS: usize = 7;

/// The name of the TCP in findings.
const TOOL: &str = "the tool";
const SET_TCP: &str = "set_tcp";
/// TCPs that differ by less are the same.
const SAME_MM: f64 = 0.01;
const SAME_RAD: f64 = 1e-4;

const OTHERS: OtherInstructions = OtherInstructions {
    motions: &["mov", "servo", "speed"],
    displacements: &["track_conveyor_linear", "track_conveyor_circular", "path_offset_enable", "force_mode"],
    settings: &["set_", "get_"],
};

/// The arguments of the function that computes the axis angles of a pose.
const INVERSE: (&str, [&str; 5]) =
    ("get_inverse_kin", ["x", "qnear", "maxPositionError", "maxOrientationError", "tcp"]);

/// The points of a script; `tool` is the TCP if the script does not set one with `set_tcp`.
pub fn read(text: Text<'_>, tool: Option<Pose>) -> Result<Points, Diagnostic> {
    let routines = parse(text)?;
    let script = Script::new(text, &routines);
    let ways: Vec<Ways> = routines.iter().map(Routine::ways).collect();
    let mut follower = Follower::new(&script, &ways);
    let mut reader = Reader {
        script: &script,
        given: tool,
        points: Points::new(write, |numbers| numbers),
        reached: HashSet::new(),
    };
    let is_called = |routine: &Routine| routine.body.iter().any(|statement| !statement.called.is_empty());
    let outside = routines.len() - 1;
    // A script runs its lines outside of any routine; a file without such lines is a program or a library of routines.
    for (at, routine) in routines.iter().enumerate().rev() {
        let is_entry = if is_called(&routines[outside]) { at == outside } else { !routine.is_local };
        if is_entry && !follower.has_visited(at) {
            follower.visit(at, InScript::before(), &mut |at, state| reader.statement(at, state))?;
        }
    }
    for (at, routine) in routines.iter().enumerate() {
        if routine.is_concurrent && script.started.contains(&routine.name) {
            let mut state = InScript::before();
            state.tcp.forget(text.line(routine.body.first().map_or(0, |first| first.span.start)));
            follower.visit(at, state, &mut |at, state| reader.statement(at, state))?;
        }
    }
    reader.points.leave_unreached(text, &routines, is_motion, &reader.reached);
    reader.points.completed(text)
}

/// The TCP that the script has set.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tcp {
    NotSet,
    /// The TCP was set by a computed pose.
    Computed,
    Known(Pose),
}

/// The settings in force at a statement.
#[derive(Clone, PartialEq)]
struct InScript {
    tcp: InForce<Tcp>,
    variables: Scope,
}

impl InScript {
    fn before() -> Self {
        Self { tcp: InForce::One { value: Tcp::NotSet, line: 0 }, variables: Scope::default() }
    }
}

impl State for InScript {
    fn join(&mut self, other: &Self) {
        self.tcp.join(&other.tcp);
        self.variables.join(&other.variables);
    }
}

/// The routines of a script, with the results of a first look before they are followed.
struct Script<'a> {
    text: Text<'a>,
    routines: &'a [Routine],
    /// The routines that each statement calls; indexed by routine and statement.
    calls: Calls,
    /// The names that are declared as global.
    globals: HashSet<&'a str>,
    /// The threads that are started.
    started: HashSet<String>,
    /// The variables that threads set, and a line in which a thread sets the TCP.
    set_beside: HashSet<&'a str>,
    tcp_beside: Option<usize>,
}

impl<'a> Script<'a> {
    fn new(text: Text<'a>, routines: &'a [Routine]) -> Self {
        let calls = calls(routines.iter());
        let statements = || routines.iter().flat_map(|routine| &routine.body);
        let code = |statement: &Statement| text.text.get(statement.span.clone()).unwrap_or("");
        let globals = statements().filter(|statement| code(statement).starts_with("global "));
        let runs = |statement: &&Statement| {
            code(statement).split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == "run")
        };
        let mut script = Self {
            text,
            routines,
            globals: globals.filter_map(assigned).collect(),
            started: statements().filter(runs).flat_map(|statement| statement.called.clone()).collect(),
            set_beside: HashSet::new(),
            tcp_beside: None,
            calls,
        };
        let is_started = |routine: &Routine| routine.is_concurrent && script.started.contains(&routine.name);
        let started = (0..routines.len()).filter(|at| is_started(&routines[*at])).collect();
        let beside = reached_from(started, &script.calls);
        for statement in beside.iter().flat_map(|at| &routines[*at].body) {
            script.set_beside.extend(assigned(statement));
            if matches!(&statement.kind, StatementKind::Call { name, .. } if name == SET_TCP) {
                script.tcp_beside.get_or_insert(text.line(statement.span.start));
            }
        }
        script
    }

    fn statement(&self, (routine, at): At) -> &'a Statement {
        &self.routines[routine].body[at]
    }

    fn lookup(&self, state: &InScript, name: &str) -> Option<Value> {
        state.variables.get(name)?.filter(|_| !self.set_beside.contains(name)).cloned()
    }
}

/// The variable that a statement may set, also if the statement is not read, such as `p[2] = 0.1`.
fn assigned(statement: &Statement) -> Option<&str> {
    match &statement.kind {
        StatementKind::Assign { name, .. } | StatementKind::Other(name) => Some(name),
        StatementKind::Call { .. }
        | StatementKind::Declare { .. }
        | StatementKind::UntilSteady
        | StatementKind::Control { .. } => None,
    }
}

impl Followed for Script<'_> {
    type State = InScript;

    fn calls(&self, (routine, at): At) -> &[usize] {
        &self.calls[routine][at]
    }

    fn enter(&self, at: At, routine: usize, state: &InScript) -> InScript {
        let routine = &self.routines[routine];
        let lookup = |name: &str| self.lookup(state, name);
        let statement = self.statement(at);
        // The arguments of a call inside an expression are not known.
        let calls = statement.called.iter().filter(|called| **called == routine.name).count();
        let arguments = match &statement.kind {
            StatementKind::Call { name, arguments } if *name == routine.name && calls == 1 => {
                Some(evaluated(arguments, 0, &lookup))
            }
            StatementKind::Call { .. }
            | StatementKind::Assign { .. }
            | StatementKind::Declare { .. }
            | StatementKind::UntilSteady
            | StatementKind::Control { .. }
            | StatementKind::Other(_) => None,
        };
        let names: Vec<&str> = routine.parameters.iter().map(|parameter| parameter.name.as_str()).collect();
        let mut entry = state.clone();
        for parameter in &routine.parameters {
            let value = arguments.as_ref().and_then(|arguments| {
                let given = argument(arguments, &names, &parameter.name);
                let default = || value::value(parameter.default.as_ref()?, 0, &lookup);
                given.map_or_else(default, |given| given.value.clone())
            });
            entry.variables.set(&parameter.name, value);
        }
        entry
    }

    fn leave(&self, routine: usize, before: &InScript, after: InScript) -> InScript {
        let own =
            |name: &str| self.routines[routine].parameters.iter().any(|parameter| parameter.name == name);
        let variables = before.variables.clone();
        let variables = variables.after_call(&after.variables, |name| self.globals.contains(name), own);
        InScript { variables, ..after }
    }

    fn apply(&self, at: At, state: &mut InScript) {
        let Statement { span, kind, called } = self.statement(at);
        let lookup = |name: &str| self.lookup(state, name);
        let line = || self.text.line(span.start);
        match kind {
            StatementKind::Assign { name, value, .. } => {
                let value = value::value(value, 0, &lookup);
                let named = value.map(|value| Value { name: Some(name.clone()), ..value });
                state.variables.set(name, named);
            }
            StatementKind::Call { name, arguments } if name == SET_TCP => {
                let value = tcp(&evaluated(arguments, 0, &lookup)).map_or(Tcp::Computed, Tcp::Known);
                state.tcp = InForce::One { value, line: line() };
            }
            StatementKind::Other(name) => state.variables.set(name, None),
            StatementKind::Call { .. }
            | StatementKind::Declare { .. }
            | StatementKind::UntilSteady
            | StatementKind::Control { .. } => {
                if called.iter().any(|name| name == SET_TCP) {
                    state.tcp = InForce::One { value: Tcp::Computed, line: line() };
                }
            }
        }
    }

    fn forget(&self, at: At, state: &mut InScript) {
        state.tcp.forget(self.text.line(self.statement(at).span.start));
        state.variables.forget();
    }
}

/// The pose that `set_tcp` sets.
fn tcp(arguments: &[Evaluated<'_>]) -> Option<Pose> {
    argument(arguments, &["pose"], "pose").and_then(|argument| pose(argument.value.as_ref()?))
}

/// Notes the points of the statements that are visited.
struct Reader<'a> {
    script: &'a Script<'a>,
    /// The TCP given by the user.
    given: Option<Pose>,
    points: Points,
    reached: HashSet<At>,
}

impl Reader<'_> {
    fn statement(&mut self, at: At, state: &InScript) -> Result<(), Diagnostic> {
        let script = self.script;
        self.reached.insert(at);
        let lookup = |name: &str| script.lookup(state, name);
        let statement @ Statement { span, kind, called } = script.statement(at);
        if let StatementKind::Call { name, arguments } = kind {
            let arguments = evaluated(arguments, 0, &lookup);
            if name == SET_TCP {
                return self.check_given(span, &arguments);
            }
            let is_own = script.routines.iter().any(|routine| routine.name == *name);
            if let Some(instruction) = Instruction::new(name, &arguments).filter(|_| !is_own) {
                let read = self.motion(span, &instruction, state);
                return read.or_else(|why| self.points.leave_motion(script.text, span, why));
            }
            if script.calls(at).is_empty() {
                let is_point = |value: &Value| target(value).is_some();
                self.points.other(script.text, (span, kind), &arguments, &OTHERS, is_point);
            }
            return Ok(());
        }
        self.points.other(script.text, (span, kind), &[], &OTHERS, |_| false);
        for name in called {
            let is_own = script.routines.iter().any(|routine| routine.name == *name);
            if !is_own && OTHERS.motions.iter().any(|motion| name.starts_with(motion)) {
                let word = name.clone();
                self.points.leave(script.text, &statement.span, CompensationFinding::NotRead { word });
            }
        }
        Ok(())
    }

    /// Refuses a TCP of the user that differs from the TCP that the script sets.
    fn check_given(&self, span: &Span, arguments: &[Evaluated<'_>]) -> Result<(), Diagnostic> {
        match (self.given, tcp(arguments)) {
            (Some(given), Some(tool))
                if (given.position - tool.position).norm() > SAME_MM || given.angle_to(&tool) > SAME_RAD =>
            {
                let differs = CompensationFinding::FrameDiffers { frame: TOOL, stated: "the given tool" };
                Err(self.script.text.wrong(span, differs))
            }
            _ => Ok(()),
        }
    }

    fn motion(
        &mut self,
        span: &Span,
        instruction: &Instruction<'_>,
        state: &InScript,
    ) -> Result<(), Diagnostic> {
        for point in instruction.points() {
            let inner;
            let (mut point, mut branch, mut tool) = (point, Some(Branch::Nearest), None);
            if let Some(ExpressionKind::Call { name, arguments }) =
                point.expression.map(|expression| &expression.kind)
                && *name == INVERSE.0
            {
                inner = evaluated(arguments, 0, &|name| self.script.lookup(state, name));
                let given = |name: &str| argument(&inner, &INVERSE.1, name);
                branch = given("qnear").map_or(branch, near);
                tool = given("tcp").map(|tcp| tcp.value.as_ref().and_then(pose));
                point = given("x").unwrap_or(point);
            }
            let taught = point.value.as_ref().and_then(target).zip(branch);
            let frames = self.frames(span, state, tool);
            self.points.add(self.script.text, span, point, taught, || frames)?;
        }
        Ok(())
    }

    /// The frames of a motion: the TCP that the statement names, else the TCP that the script sets, else the TCP of the
    /// user.
    fn frames(
        &self,
        motion: &Span,
        state: &InScript,
        named: Option<Option<Pose>>,
    ) -> Result<Frames, Diagnostic> {
        let (frame, text) = (TOOL, self.script.text);
        let why = match (named, self.script.tcp_beside, &state.tcp) {
            (Some(Some(tool)), ..) => return Ok(Frames { tool, base: Pose::identity() }),
            (Some(None), ..) => CompensationFinding::FrameComputed { frame, line: text.line(motion.start) },
            (None, Some(line), _) => CompensationFinding::FrameBeside { frame, line },
            (None, None, InForce::Mixed(lines)) => mixed(frame, *lines),
            (None, None, InForce::One { value, line }) => match (value, self.given) {
                (Tcp::Known(tool), _) => return Ok(Frames { tool: *tool, base: Pose::identity() }),
                (Tcp::NotSet, Some(tool)) => return Ok(Frames { tool, base: Pose::identity() }),
                (Tcp::NotSet, None) => CompensationFinding::FrameNotSet { frame },
                (Tcp::Computed, _) => CompensationFinding::FrameComputed { frame, line: *line },
            },
        };
        Err(text.wrong(motion, why))
    }
}

/// The branch that `qnear` selects; `None` if it is not known.
fn near(argument: &Evaluated<'_>) -> Option<Branch> {
    if let Some(axes) = argument.value.as_ref().and_then(Value::numbers::<6>) {
        return Some(Branch::NearestTo(axes));
    }
    // The call returns the present axis angles of the robot.
    let is_here = matches!(&argument.expression?.kind, ExpressionKind::Call { name, .. }
        if ["get_actual_joint_positions", "get_target_joint_positions"].contains(&name.as_str()));
    is_here.then_some(Branch::Nearest)
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
            // An orientation has two rotation vectors: the one nearer to the taught vector.
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
