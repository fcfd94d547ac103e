//! An interpreter of KRL. Statements take effect when they are reached: there is no advance run, and all stops are exact.
//!
//! This file has the state of the interpreter. The fields are private to the files below it, which have its functions.

mod data_files;
mod ekrl;
mod execute;
mod memory;
mod motion;
mod run;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use super::{CommandedMotion, SimulatedArm};
use crate::program::krl::Program;
use crate::program::krl::syntax::{Block, Expression, Place, Routine, Span};
use crate::program::krl::value::{Type, Value};

/// The present activity of the controller.
#[derive(Clone, Debug)]
enum KrlActivity {
    /// The next statement is to be executed.
    Ready,
    Moving(Box<CommandedMotion>),
    /// Waits until this time, s.
    Waiting(f64),
    /// Waits until this condition is true.
    Until(Expression),
    /// Waits until the operator presses START.
    Halted,
    Done,
}

/// An output that changes to a level at a time.
#[derive(Clone, Copy, Debug)]
struct OutputPulse {
    output: usize,
    level: bool,
    until_s: f64,
}

#[derive(Clone, Debug)]
pub(super) struct Interpreter {
    program: Program,
    arm: SimulatedArm,
    t_s: f64,
    /// Number of the base ball, from 1.
    ball: u32,
    dwells: DwellCounter,
    activity: KrlActivity,
    calls: KrlCallStack,
    system: KrlVariables,
    /// The variables of each module, by the index of the module.
    memory: Vec<ModuleMemory>,
    pulses: Vec<OutputPulse>,
    ekrl: EkrlChannel,
}

impl Interpreter {
    /// The module whose routine is being executed.
    fn module(&self) -> usize {
        self.calls.levels.iter().rev().find_map(ExecutionLevel::module).unwrap_or(self.calls.at.0)
    }
}

/// Counts the dwells, by the strobe output if the program has one.
#[derive(Clone, Copy, Debug, Default)]
struct DwellCounter {
    strobe: Option<usize>,
    count: u32,
}

/// The position in the program.
#[derive(Clone, Debug)]
struct KrlCallStack {
    levels: Vec<ExecutionLevel>,
    /// Module and bytes of the statement that was begun last.
    at: (usize, Span),
}

/// Digital inputs and outputs.
const SIGNALS: usize = 4096;

#[derive(Clone, Debug)]
struct KrlVariable {
    /// Type of the value; for an array, the type of its elements.
    kind: Type,
    value: Value,
}

impl KrlVariable {
    fn new(kind: Type, elements: Option<usize>) -> Self {
        let value = match elements {
            // A text is one value, whatever the length of its array.
            Some(_) if kind == Type::Char => Value::Unset,
            Some(elements) => Value::Array(vec![kind.unset(); elements]),
            None => kind.unset(),
        };
        Self { kind, value }
    }
}

/// Variables by name.
type KrlVariables = BTreeMap<String, KrlVariable>;

/// The first and the last output (or input) of a SIGNAL, from 1.
#[derive(Clone, Copy, Debug)]
struct KrlSignal {
    is_output: bool,
    first: usize,
    last: usize,
}

/// The variables that the `.dat` of a module declares.
#[derive(Clone, Debug, Default)]
struct ModuleMemory {
    variables: KrlVariables,
    signals: BTreeMap<String, KrlSignal>,
}

/// A block that is being executed, with the index of its next statement.
#[derive(Clone, Debug)]
struct ExecutionLevel {
    block: Block,
    next: usize,
    kind: LevelKind,
}

/// The continuation after the end of a block.
#[derive(Clone, Debug)]
enum LevelKind {
    /// Goes on in the caller.
    Routine { module: usize, locals: KrlVariables },
    /// Goes on with the statement after the block.
    Plain,
    /// Goes on at the start of the block.
    Loop,
    /// Goes on at the start of the block while the condition is true.
    While(Expression),
    /// Goes on at the start of the block until the counter is past `last`.
    For { counter: Place, last: i64, step: i64 },
}

impl ExecutionLevel {
    fn routine(module: usize, routine: &Routine, locals: KrlVariables) -> Self {
        Self { block: Arc::clone(&routine.body), next: 0, kind: LevelKind::Routine { module, locals } }
    }

    fn block(block: &Block, kind: LevelKind) -> Self {
        Self { block: Arc::clone(block), next: 0, kind }
    }

    fn module(&self) -> Option<usize> {
        match self.kind {
            LevelKind::Routine { module, .. } => Some(module),
            LevelKind::Plain | LevelKind::Loop | LevelKind::While(_) | LevelKind::For { .. } => None,
        }
    }

    fn locals_mut(&mut self) -> Option<&mut KrlVariables> {
        match &mut self.kind {
            LevelKind::Routine { locals, .. } => Some(locals),
            LevelKind::Plain | LevelKind::Loop | LevelKind::While(_) | LevelKind::For { .. } => None,
        }
    }
}

/// The channel of EthernetKRL.
#[derive(Clone, Debug, Default)]
struct EkrlChannel {
    /// Whether telegrams are carried to a server.
    is_linked: bool,
    is_open: bool,
    /// Values by path, in the order of their first assignment.
    values: Vec<(String, String)>,
    sent: VecDeque<String>,
    answers: VecDeque<i64>,
}
