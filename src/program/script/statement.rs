//! Statements of a routine, in the order of the text: the few that move, wait and set are known, others have a place
//! only.

use super::value::{Argument, Expression, Names, Value};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::listing::{Action, Does};
use crate::program::text::Span;
use crate::program::{Language, Listing, Setup};

/// Calls inside each other.
const DEPTH: usize = 50;
/// Actions of a program, after which it is held to have no end.
const ACTIONS: usize = 200_000;

#[derive(Clone, Debug)]
pub(crate) struct Statement {
    pub(crate) span: Span,
    pub(crate) kind: Kind,
}

#[derive(Clone, Debug)]
pub(crate) enum Kind {
    /// Of a routine or an instruction; RAPID's names are in capitals.
    Call {
        name: String,
        arguments: Vec<Argument>,
    },
    Assign {
        name: String,
        value: Expression,
    },
    /// `while not is_steady()` of URScript.
    UntilSteady,
    /// One that is not executed, with its first word.
    Other(String),
}

#[derive(Clone, Debug)]
pub(crate) struct Routine {
    pub(crate) name: String,
    /// Number of the file.
    pub(crate) file: usize,
    pub(crate) parameters: Vec<String>,
    pub(crate) body: Vec<Statement>,
}

/// What is done with the program's routines one after the other.
pub(crate) trait Dialect {
    /// The routine that a name means in a file, if it is one of the program's.
    fn routine(&self, file: usize, name: &str) -> Option<Routine>;

    /// The value of a name in a file that is not a variable of the routine.
    fn global(&self, file: usize, name: &str) -> Option<Value>;

    /// What an instruction of the controller does.
    fn instruction(
        &mut self,
        call: &Statement,
        lookup: &dyn Fn(&str) -> Option<Value>,
        file: usize,
    ) -> Result<Vec<Does>, ProgramFinding>;
}

/// Follows the calls of a program and lists what it does.
pub(crate) struct Unrolling<'a, D> {
    pub(crate) dialect: &'a mut D,
    pub(crate) listing: Listing,
    depth: usize,
    ball: Option<u32>,
}

impl<'a, D: Dialect> Unrolling<'a, D> {
    pub(crate) fn new(dialect: &'a mut D, language: Language, files: Vec<(String, String)>) -> Self {
        let listing = Listing { language, files, actions: Vec::new(), setups: Vec::new() };
        Self { dialect, listing, depth: 0, ball: None }
    }

    /// Lists a routine with the values of its parameters.
    pub(crate) fn routine(&mut self, routine: &Routine, mut locals: Names) -> Result<(), Diagnostic> {
        let before = self.ball;
        self.depth += 1;
        self.enter(routine.file, &locals);
        for statement in &routine.body {
            if self.depth > DEPTH {
                let nested = ProgramFinding::NestedTooDeeply { most: DEPTH };
                return Err(self.wrong(routine.file, statement, nested));
            }
            if self.listing.actions.len() > ACTIONS {
                return Err(self.wrong(routine.file, statement, ProgramFinding::NeverWaits));
            }
            self.statement(routine, statement, &mut locals)?;
        }
        self.depth -= 1;
        if let (Some(before), true) = (before, before != self.ball) {
            self.ball = Some(before);
            self.push(routine.file, 0..0, Does::Ball(before));
        }
        Ok(())
    }

    fn statement(
        &mut self,
        routine: &Routine,
        statement: &Statement,
        locals: &mut Names,
    ) -> Result<(), Diagnostic> {
        let file = routine.file;
        let lookup = |dialect: &D, locals: &Names, name: &str| {
            locals.get(name).cloned().or_else(|| dialect.global(file, name))
        };
        match &statement.kind {
            Kind::UntilSteady => {
                let still = crate::program::listing::Standstill::ZeroSpeed;
                self.push(file, statement.span.clone(), Does::Standstill(still));
            }
            Kind::Other(word) => {
                let instead =
                    "only motions, waits, outputs and calls without conditions are simulated".into();
                let unsupported = ProgramFinding::Unsupported { what: word.clone(), instead };
                return Err(self.wrong(file, statement, unsupported));
            }
            Kind::Assign { name, value } => {
                let value = super::value::value(value, file, &|name| lookup(self.dialect, locals, name));
                match value {
                    Some(value) => _ = locals.insert(name.clone(), value),
                    None => _ = locals.remove(name),
                }
                self.enter(file, locals);
            }
            Kind::Call { name, arguments } => {
                let Some(called) = self.dialect.routine(file, name) else {
                    let given = locals.clone();
                    let global = |name: &str| lookup(self.dialect, &given, name);
                    // The values of globals do not change while an instruction is read.
                    let values: Names =
                        names(arguments).filter_map(|name| Some((name.clone(), global(&name)?))).collect();
                    let does = self
                        .dialect
                        .instruction(statement, &|name| values.get(name).cloned(), file)
                        .map_err(|finding| self.wrong(file, statement, finding))?;
                    for does in does {
                        self.push(file, statement.span.clone(), does);
                    }
                    return Ok(());
                };
                let (expected, given) = (called.parameters.len(), arguments.len());
                if expected != given {
                    let wrong = ProgramFinding::Arguments { routine: name.clone(), expected, given };
                    return Err(self.wrong(file, statement, wrong));
                }
                let mut inside = Names::new();
                for (parameter, argument) in called.parameters.iter().zip(arguments) {
                    let value = argument.value.as_ref().and_then(|value| {
                        super::value::value(value, file, &|name| lookup(self.dialect, locals, name))
                    });
                    inside.extend(value.map(|value| (parameter.clone(), value)));
                }
                self.routine(&called, inside)?;
            }
        }
        Ok(())
    }

    /// Takes the ball and the bar that the variables of a routine or of its module name.
    fn enter(&mut self, file: usize, locals: &Names) {
        let lookup = |name: &str| locals.get(name).cloned().or_else(|| self.dialect.global(file, name));
        let Some(setup) = setup(&lookup) else { return };
        if self.ball != Some(setup.ball) {
            self.ball = Some(setup.ball);
            self.push(file, 0..0, Does::Ball(setup.ball));
        }
        if !self.listing.setups.contains(&setup) {
            self.listing.setups.push(setup);
        }
    }

    fn push(&mut self, file: usize, span: Span, does: Does) {
        self.listing.actions.push(Action { file, span, does });
    }

    fn wrong(&self, file: usize, statement: &Statement, finding: ProgramFinding) -> Diagnostic {
        self.listing.text(file).wrong(&statement.span, finding)
    }
}

/// The names that arguments mention.
fn names(arguments: &[Argument]) -> impl Iterator<Item = String> {
    let mut found = Vec::new();
    let mut open: Vec<&Expression> =
        arguments.iter().filter_map(|argument| argument.value.as_ref()).collect();
    while let Some(expression) = open.pop() {
        match &expression.kind {
            super::value::Kind::Name(name) => found.push(name.clone()),
            super::value::Kind::List(list) | super::value::Kind::Pose(list) => open.extend(list),
            _ => {}
        }
    }
    found.into_iter()
}

/// The set-up that dbbd wrote; `None` where it is not there, whole.
fn setup(lookup: &dyn Fn(&str) -> Option<Value>) -> Option<Setup> {
    let number = |name: &str| lookup(name)?.number();
    let ball = number("DBBBALL")?;
    (ball.fract() == 0.0 && (1.0..1e6).contains(&ball)).then_some(())?;
    Some(Setup {
        ball: ball as u32,
        centre_mm: lookup("DBBCEN")?.numbers()?,
        length_mm: number("DBBLEN")?,
        stroke_mm: [number("DBBLOW")?, number("DBBHIGH")?],
    })
}
