//! Unrolls a program into the list of its actions: follows its calls.

use super::expression::{Routine, Statement, StatementKind};
use super::value::{Evaluated, Value, Variables, evaluated, value};
use crate::program::ProgramFinding;
use crate::program::listing::{Action, ActionKind, Standstill};
use crate::program::text::Span;
use crate::program::{Language, Listing, Setup};
use dbbd_model::diagnostic::Diagnostic;

/// Most calls inside each other.
const DEPTH: usize = 50;
/// Most actions: a program with more is assumed to be endless.
const ACTIONS: usize = 200_000;

/// The part of unrolling that depends on the language.
pub(crate) trait Dialect {
    /// The routine of the program with this name as seen in a file.
    fn routine(&self, file: usize, name: &str) -> Option<Routine>;

    /// The value of a name in a file that is not a variable of the routine.
    fn global(&self, file: usize, name: &str) -> Option<Value>;

    /// The action of an instruction of the controller, if it has one.
    fn instruction(
        &mut self,
        name: &str,
        arguments: &[Evaluated<'_>],
    ) -> Result<Option<ActionKind>, ProgramFinding>;
}

/// The actions of the program that begins with `routine`.
pub(crate) fn unroll(
    dialect: impl Dialect,
    language: Language,
    files: Vec<(String, String)>,
    routine: &Routine,
) -> Result<Listing, Diagnostic> {
    let listing = Listing { language, files, actions: Vec::new(), setups: Vec::new() };
    let mut unroller = Unroller { dialect, listing, depth: 0, ball: None };
    unroller.routine(routine, Variables::new())?;
    Ok(unroller.listing)
}

struct Unroller<D> {
    dialect: D,
    listing: Listing,
    depth: usize,
    /// The base ball that was selected last.
    ball: Option<u32>,
}

impl<D: Dialect> Unroller<D> {
    /// Adds the actions of a routine with the values of its parameters.
    fn routine(&mut self, routine: &Routine, mut locals: Variables) -> Result<(), Diagnostic> {
        let ball_before = self.ball;
        self.depth += 1;
        self.note_setup(routine.file, &locals);
        for statement in &routine.body {
            let wrong = |finding| self.listing.text(routine.file).wrong(&statement.span, finding);
            if self.depth > DEPTH {
                return Err(wrong(ProgramFinding::NestedTooDeeply { most: DEPTH }));
            }
            if self.listing.actions.len() > ACTIONS {
                return Err(wrong(ProgramFinding::NeverWaits));
            }
            self.statement(routine.file, statement, &mut locals)?;
        }
        self.depth -= 1;
        if let Some(ball) = ball_before.filter(|_| ball_before != self.ball) {
            self.ball = ball_before;
            self.push(routine.file, 0..0, ActionKind::SelectBall(ball));
        }
        Ok(())
    }

    fn statement(
        &mut self,
        file: usize,
        statement: &Statement,
        locals: &mut Variables,
    ) -> Result<(), Diagnostic> {
        let Statement { span, kind, .. } = statement;
        let unsupported = |word: &String| {
            let instead = "only motions, waits, outputs and calls without conditions are simulated";
            let unsupported = ProgramFinding::Unsupported { what: word.clone(), instead: instead.into() };
            self.listing.text(file).wrong(span, unsupported)
        };
        match kind {
            StatementKind::UntilSteady => {
                self.push(file, span.clone(), ActionKind::WaitForStandstill(Standstill::ZeroSpeed));
            }
            StatementKind::Assign { name: word, components, .. } if !components.is_empty() => {
                return Err(unsupported(word));
            }
            StatementKind::Control { word, .. } | StatementKind::Other(word) => {
                return Err(unsupported(word));
            }
            StatementKind::Declare { name, value: None } => _ = locals.remove(name),
            StatementKind::Assign { name, value: assigned, .. }
            | StatementKind::Declare { name, value: Some(assigned) } => {
                match value(assigned, file, &|name| self.lookup(file, locals, name)) {
                    Some(value) => _ = locals.insert(name.clone(), value),
                    None => _ = locals.remove(name),
                }
                self.note_setup(file, locals);
            }
            StatementKind::Call { name, arguments } => {
                let arguments = evaluated(arguments, file, &|name| self.lookup(file, locals, name));
                self.call(file, span, name, &arguments)?;
            }
        }
        Ok(())
    }

    fn call(
        &mut self,
        file: usize,
        span: &Span,
        name: &str,
        arguments: &[Evaluated<'_>],
    ) -> Result<(), Diagnostic> {
        let wrong = |listing: &Listing, finding| listing.text(file).wrong(span, finding);
        let Some(routine) = self.dialect.routine(file, name) else {
            let action = self.dialect.instruction(name, arguments);
            if let Some(action) = action.map_err(|finding| wrong(&self.listing, finding))? {
                self.push(file, span.clone(), action);
            }
            return Ok(());
        };
        let (expected, given) = (routine.parameters.len(), arguments.len());
        if expected != given {
            let finding = ProgramFinding::Arguments { routine: name.into(), expected, given };
            return Err(wrong(&self.listing, finding));
        }
        let values = routine.parameters.iter().zip(arguments);
        let locals =
            values.filter_map(|(given, argument)| Some((given.name.clone(), argument.value.clone()?)));
        self.routine(&routine, locals.collect())
    }

    fn lookup(&self, file: usize, locals: &Variables, name: &str) -> Option<Value> {
        locals.get(name).cloned().or_else(|| self.dialect.global(file, name))
    }

    /// Notes the ball and the bar that the variables of a routine or its module name.
    fn note_setup(&mut self, file: usize, locals: &Variables) {
        let Some(setup) = setup(|name| self.lookup(file, locals, name)) else { return };
        if self.ball != Some(setup.ball) {
            self.ball = Some(setup.ball);
            self.push(file, 0..0, ActionKind::SelectBall(setup.ball));
        }
        if !self.listing.setups.contains(&setup) {
            self.listing.setups.push(setup);
        }
    }

    fn push(&mut self, file: usize, span: Span, kind: ActionKind) {
        self.listing.actions.push(Action { file, span, kind });
    }
}

/// The set-up that dbbd wrote; `None` if it is missing or incomplete.
fn setup(lookup: impl Fn(&str) -> Option<Value>) -> Option<Setup> {
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
