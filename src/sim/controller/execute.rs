//! Executes statements, one after the other, until one takes time.

use std::sync::Arc;

use super::store::{Names, Variable};
use super::value::{Type, Value};
use super::{Activity, Controller, Fault, Pulse};
use crate::krl::syntax::{
    Block, DeclarationKind, Expression, ExpressionKind, Part, Place, Routine, Span, Statement, StatementKind,
};

/// Statements without any that takes time, after which a program is held to hang.
const IMMEDIATE: usize = 100_000;
/// Calls and blocks inside each other.
const DEPTH: usize = 200;

/// A block that is being executed, and the place in it.
#[derive(Clone, Debug)]
pub(super) struct Level {
    block: Block,
    next: usize,
    kind: Kind,
}

/// What happens at a block's end.
#[derive(Clone, Debug)]
enum Kind {
    /// Back to the caller.
    Routine { module: usize, locals: Names },
    /// On after the block.
    Plain,
    /// From the start.
    Loop,
    /// From the start while the condition holds.
    While(Expression),
    /// From the start until the counter is past `last`.
    For { counter: Place, last: i64, step: i64 },
}

impl Level {
    pub(super) fn routine(module: usize, routine: &Routine, locals: Names) -> Self {
        Self { block: Arc::clone(&routine.body), next: 0, kind: Kind::Routine { module, locals } }
    }

    pub(super) fn module(&self) -> Option<usize> {
        match self.kind {
            Kind::Routine { module, .. } => Some(module),
            _ => None,
        }
    }

    pub(super) fn locals_mut(&mut self) -> Option<&mut Names> {
        match &mut self.kind {
            Kind::Routine { locals, .. } => Some(locals),
            _ => None,
        }
    }
}

impl Controller {
    /// Executes statements until one takes time or the program ends.
    pub(super) fn execute(&mut self) -> Result<(), Fault> {
        for _ in 0..IMMEDIATE {
            if !matches!(self.activity, Activity::Ready) {
                return Ok(());
            }
            let Some(level) = self.levels.last_mut() else {
                self.activity = Activity::Done;
                return Ok(());
            };
            let block = Arc::clone(&level.block);
            match block.get(level.next) {
                Some(statement) => {
                    level.next += 1;
                    self.at = (self.module(), statement.span.clone());
                    self.statement(statement)?;
                }
                None => self.end_of_block()?,
            }
        }
        Err(Fault::new(&self.at.1, "the program loops without ever taking time"))
    }

    fn end_of_block(&mut self) -> Result<(), Fault> {
        let Some(kind) = self.levels.last().map(|level| level.kind.clone()) else { return Ok(()) };
        let again = match &kind {
            Kind::Routine { .. } | Kind::Plain => false,
            Kind::Loop => true,
            Kind::While(condition) => self.condition(condition)?,
            Kind::For { counter, last, step } => {
                let expression =
                    Expression { span: counter.span.clone(), kind: ExpressionKind::Place(counter.clone()) };
                let value =
                    self.evaluate(&expression)?.int().map_err(|why| Fault::new(&counter.span, why))?;
                let value = value.saturating_add(*step);
                self.write(counter, Value::Int(value))?;
                within(value, *last, *step)
            }
        };
        match self.levels.last_mut() {
            Some(level) if again => level.next = 0,
            _ => {
                self.levels.pop();
                // The bar's ball is that of the module to which control returns, if it names one.
                self.enter(self.module());
            }
        }
        Ok(())
    }

    /// Takes the number of the base ball from a module's `.dat`, where it stands there.
    pub(super) fn enter(&mut self, module: usize) {
        let ball = self.data.get(module).and_then(|data| data.get("DBBBALL"));
        if let Some(ball) =
            ball.and_then(|ball| ball.value.int().ok()).and_then(|ball| u32::try_from(ball).ok())
        {
            self.centre = ball;
        }
    }

    fn condition(&mut self, expression: &Expression) -> Result<bool, Fault> {
        self.evaluate(expression)?.bool().map_err(|why| Fault::new(&expression.span, why))
    }

    fn push(&mut self, block: &Block, kind: Kind, span: &Span) -> Result<(), Fault> {
        if self.levels.len() >= DEPTH {
            return Err(Fault::new(span, "blocks and calls are nested too deeply"));
        }
        self.levels.push(Level { block: Arc::clone(block), next: 0, kind });
        Ok(())
    }

    fn statement(&mut self, statement: &Statement) -> Result<(), Fault> {
        let span = &statement.span;
        match &statement.kind {
            StatementKind::Assign { target, value } => {
                let value = self.evaluate(value)?;
                self.write(target, value)?;
            }
            StatementKind::Ptp { to, approximate } => {
                exact(approximate.as_ref(), span)?;
                self.ptp(to, span)?;
            }
            StatementKind::Lin { to, approximate } => {
                exact(approximate.as_ref(), span)?;
                self.lin(to, span)?;
            }
            StatementKind::Circ { through, to, angle, approximate } => {
                exact(approximate.as_ref(), span)?;
                self.circ(through, to, angle.as_ref(), span)?;
            }
            StatementKind::WaitSeconds(seconds) => {
                let seconds = self.number(seconds)?.max(0.0);
                self.activity = Activity::Waiting(self.t_s + seconds);
            }
            StatementKind::WaitFor(condition) => self.activity = Activity::Until(condition.clone()),
            StatementKind::Pulse { output, level, seconds } => self.pulse(output, level, seconds)?,
            StatementKind::Halt => self.activity = Activity::Halted,
            StatementKind::Return => {
                while let Some(level) = self.levels.pop() {
                    if level.module().is_some() {
                        break;
                    }
                }
                self.enter(self.module());
            }
            StatementKind::Exit => loop {
                match self.levels.pop().map(|level| level.kind) {
                    Some(Kind::Loop) => break,
                    Some(Kind::Routine { .. }) | None => {
                        return Err(Fault::new(span, "EXIT stands outside of a LOOP"));
                    }
                    Some(_) => {}
                }
            },
            StatementKind::Call { name, arguments } => self.call(name, arguments, span)?,
            StatementKind::For { counter, from, to, step, body } => {
                let mut whole = |expression: &Expression| {
                    self.evaluate(expression)?.int().map_err(|why| Fault::new(&expression.span, why))
                };
                let (from, last) = (whole(from)?, whole(to)?);
                let step = step.as_ref().map_or(Ok(1), whole)?;
                if step == 0 {
                    return Err(Fault::new(span, "a STEP of 0 never ends"));
                }
                self.write(counter, Value::Int(from))?;
                if within(from, last, step) {
                    self.push(body, Kind::For { counter: counter.clone(), last, step }, span)?;
                }
            }
            StatementKind::If { condition, then, otherwise } => {
                let block = if self.condition(condition)? { then } else { otherwise };
                self.push(block, Kind::Plain, span)?;
            }
            StatementKind::While { condition, body } => {
                if self.condition(condition)? {
                    self.push(body, Kind::While(condition.clone()), span)?;
                }
            }
            StatementKind::Loop(body) => self.push(body, Kind::Loop, span)?,
            StatementKind::InterruptDeclaration { condition } => {
                // The stop message of every program's head never comes here.
                if !mentions(condition, "$STOPMESS") {
                    return Err(Fault::new(span, "interrupts are not simulated, but that of $STOPMESS"));
                }
            }
            StatementKind::InterruptSwitch => {}
        }
        Ok(())
    }

    fn pulse(&mut self, output: &Place, level: &Expression, seconds: &Expression) -> Result<(), Fault> {
        let level = self.condition(level)?;
        let seconds = self.number(seconds)?;
        if !(0.012..=3.0).contains(&seconds) {
            return Err(Fault::new(&output.span, "a pulse lasts 0.012 to 3 s"));
        }
        let number = match output.parts.as_slice() {
            [Part::Element(index)] if output.name == "$OUT" => {
                let value = self.evaluate(index)?.int().map_err(|why| Fault::new(&index.span, why))?;
                usize::try_from(value).ok().filter(|number| (1..=4096).contains(number))
            }
            [] => self.signals.get(self.module()).and_then(|signals| signals.get(&output.name)).and_then(
                |signal| Some(signal.first).filter(|_| signal.output && signal.first == signal.last),
            ),
            _ => None,
        };
        let Some(number) = number else { return Err(Fault::new(&output.span, "this is no output")) };
        self.set_output(number, level);
        self.pulses.retain(|pulse| pulse.output != number);
        self.pulses.push(Pulse { output: number, level: !level, until_s: self.t_s + seconds });
        Ok(())
    }

    fn call(&mut self, name: &str, arguments: &[Expression], span: &Span) -> Result<(), Fault> {
        let module = self.module();
        let found = self.program.routine(module, name).map(|(at, routine)| (at, routine.clone()));
        let Some((callee, routine)) = found else {
            if name == "BAS" {
                return self.bas(arguments, span);
            }
            return Err(Fault::new(span, format!("{name} is not simulated")));
        };
        if routine.parameters.len() != arguments.len() {
            let message =
                format!("{name} takes {} arguments, {} are given", routine.parameters.len(), arguments.len());
            return Err(Fault::new(span, message));
        }
        let mut locals = Names::new();
        for declaration in &routine.declarations {
            let DeclarationKind::Variables { type_name, names } = &declaration.kind else { continue };
            for declared in names {
                let kind = Type::named(type_name).ok_or_else(|| {
                    Fault::new(span, format!("{name}: the type {type_name} is not simulated"))
                })?;
                if declared.value.is_some() {
                    let message = format!("{name}: {} has a value in its declaration", declared.name);
                    return Err(Fault::new(span, message).help("in a .src file set it in a line of its own"));
                }
                locals.insert(declared.name.clone(), Variable::new(kind, declared.elements));
            }
        }
        for (parameter, argument) in routine.parameters.iter().zip(arguments) {
            let value = self.evaluate(argument)?;
            let Some(variable) = locals.get_mut(parameter) else {
                return Err(Fault::new(span, format!("{name}: the parameter {parameter} is not declared")));
            };
            let kind = variable.kind;
            variable.value.store(kind, value).map_err(|why| Fault::new(&argument.span, why))?;
        }
        if self.levels.len() >= DEPTH {
            return Err(Fault::new(span, "blocks and calls are nested too deeply"));
        }
        self.levels.push(Level::routine(callee, &routine, locals));
        self.enter(callee);
        Ok(())
    }

    /// The controller's own `BAS (#COMMAND,value)`.
    fn bas(&mut self, arguments: &[Expression], span: &Span) -> Result<(), Fault> {
        let [command, value] = arguments else { return Err(Fault::new(span, "BAS takes two arguments")) };
        let ExpressionKind::Enum(command) = &command.kind else {
            return Err(Fault::new(span, "BAS takes a command like #VEL_PTP"));
        };
        let percent = self.number(value)?;
        let variable = match command.as_str() {
            "INITMOV" => return Ok(()),
            "VEL_PTP" => "$VEL_AXIS",
            "ACC_PTP" => "$ACC_AXIS",
            _ => {
                return Err(Fault::new(span, format!("BAS (#{command},..) is not simulated"))
                    .help("set the variables themselves, as in $TOOL={X 0.0,..}"));
            }
        };
        if !(1.0..=100.0).contains(&percent) {
            return Err(Fault::new(&value.span, format!("{percent} is no percentage of 1 to 100")));
        }
        if let Some(Value::Array(axes)) = self.system.get_mut(variable).map(|variable| &mut variable.value) {
            axes.fill(Value::Int(percent.round() as i64));
        }
        Ok(())
    }
}

fn within(value: i64, last: i64, step: i64) -> bool {
    if step > 0 { value <= last } else { value >= last }
}

/// Refuses approximate positioning: a point that is cut short is never reached.
fn exact(approximate: Option<&String>, span: &Span) -> Result<(), Fault> {
    match approximate {
        None => Ok(()),
        Some(word) => Err(Fault::new(span, format!("approximate positioning ({word}) is not simulated"))
            .help("remove it: every point is an exact stop")),
    }
}

fn mentions(expression: &Expression, name: &str) -> bool {
    match &expression.kind {
        ExpressionKind::Place(place) => place.name == name,
        ExpressionKind::Unary(_, operand) => mentions(operand, name),
        ExpressionKind::Binary(_, left, right) => mentions(left, name) || mentions(right, name),
        _ => false,
    }
}
