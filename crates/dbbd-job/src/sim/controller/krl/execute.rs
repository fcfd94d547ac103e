//! Executes statements until one takes time.

use std::sync::Arc;

use super::{
    ExecutionLevel, Interpreter, KrlActivity, KrlVariable, KrlVariables, LevelKind, OutputPulse, SIGNALS,
};
use crate::program::MotionKind;
use crate::program::ProgramFinding;
use crate::program::krl::evaluate::{At, Fault, Scope};
use crate::program::krl::syntax::{
    Declaration, Expression, ExpressionKind, Move, Part, Place, Routine, Span, Statement, StatementKind,
};
use crate::program::krl::value::{Type, Value};

/// Most statements in sequence that take no time: a program with more is assumed to hang.
const IMMEDIATE: usize = 100_000;
/// Most calls and blocks inside each other.
const DEPTH: usize = 200;

impl Interpreter {
    /// Executes statements until one takes time or the program ends.
    pub(super) fn execute(&mut self) -> Result<(), Fault> {
        for _ in 0..IMMEDIATE {
            if !matches!(self.activity, KrlActivity::Ready) {
                return Ok(());
            }
            let Some(level) = self.calls.levels.last_mut() else {
                self.activity = KrlActivity::Done;
                return Ok(());
            };
            let block = Arc::clone(&level.block);
            match block.get(level.next) {
                Some(statement) => {
                    level.next += 1;
                    self.calls.at = (self.module(), statement.span.clone());
                    self.statement(statement)?;
                }
                None => self.end_of_block()?,
            }
        }
        Err(Fault::new(&self.calls.at.1, ProgramFinding::NeverWaits))
    }

    fn end_of_block(&mut self) -> Result<(), Fault> {
        let Some(kind) = self.calls.levels.last().map(|level| level.kind.clone()) else { return Ok(()) };
        let is_repeated = match &kind {
            LevelKind::Routine { .. } | LevelKind::Plain => false,
            LevelKind::Loop => true,
            LevelKind::While(condition) => condition.bool(self)?,
            LevelKind::For { counter, last, step } => {
                let value = self.read(counter)?.int().at(&counter.span)?;
                let value = value.saturating_add(*step);
                self.write(counter, Value::Int(value))?;
                within(value, *last, *step)
            }
        };
        match self.calls.levels.last_mut() {
            Some(level) if is_repeated => level.next = 0,
            _ => {
                self.calls.levels.pop();
                self.select_ball(self.module());
            }
        }
        Ok(())
    }

    /// Takes the base ball from the `.dat` of the module that control enters or returns to, if it names one.
    pub(super) fn select_ball(&mut self, module: usize) {
        let ball = self.memory.get(module).and_then(|memory| memory.variables.get("DBBBALL"));
        if let Some(ball) =
            ball.and_then(|ball| ball.value.int().ok()).and_then(|ball| u32::try_from(ball).ok())
        {
            self.ball = ball;
        }
    }

    /// Begins a block.
    fn push(&mut self, level: ExecutionLevel) -> Result<(), ProgramFinding> {
        if self.calls.levels.len() >= DEPTH {
            return Err(ProgramFinding::NestedTooDeeply { most: DEPTH });
        }
        self.calls.levels.push(level);
        Ok(())
    }

    fn statement(&mut self, statement: &Statement) -> Result<(), Fault> {
        let span = &statement.span;
        match &statement.kind {
            StatementKind::Assign { target, value } => {
                let value = value.value(self)?;
                self.write(target, value)?;
            }
            StatementKind::Move(motion) => self.motion(motion, span)?,
            StatementKind::WaitSeconds(seconds) => {
                let seconds = seconds.number(self)?.max(0.0);
                self.activity = KrlActivity::Waiting(self.t_s + seconds);
            }
            StatementKind::WaitFor(condition) => self.activity = KrlActivity::Until(condition.clone()),
            StatementKind::Pulse { output, level, seconds } => self.pulse(output, level, seconds)?,
            StatementKind::Halt => self.activity = KrlActivity::Halted,
            StatementKind::Return => {
                while self.calls.levels.pop().is_some_and(|level| level.module().is_none()) {}
                self.select_ball(self.module());
            }
            StatementKind::Exit => self.exit().at(span)?,
            StatementKind::Call { name, arguments } => self.call_routine(name, arguments, span)?,
            StatementKind::For { .. } => self.begin_for(&statement.kind, span)?,
            StatementKind::If { condition, then, otherwise } => {
                let block = if condition.bool(self)? { then } else { otherwise };
                self.push(ExecutionLevel::block(block, LevelKind::Plain)).at(span)?;
            }
            StatementKind::While { condition, body } => {
                if condition.bool(self)? {
                    self.push(ExecutionLevel::block(body, LevelKind::While(condition.clone()))).at(span)?;
                }
            }
            StatementKind::Loop(body) => self.push(ExecutionLevel::block(body, LevelKind::Loop)).at(span)?,
            // The interrupt on stop messages in the head of every program never occurs here.
            StatementKind::InterruptDeclaration { condition } if mentions(condition, "$STOPMESS") => {}
            StatementKind::InterruptDeclaration { .. } => {
                let instead = "the simulator supports only the interrupt on $STOPMESS".into();
                return Err(Fault::new(
                    span,
                    ProgramFinding::Unsupported { what: "INTERRUPT".into(), instead },
                ));
            }
            StatementKind::InterruptSwitch => {}
        }
        Ok(())
    }

    fn motion(&mut self, motion: &Move, span: &Span) -> Result<(), Fault> {
        // With approximate positioning the point is never reached.
        if let Some(word) = &motion.approximate {
            let what = format!("approximate positioning ({word})");
            let instead = "remove it: every point is an exact stop".into();
            return Err(Fault::new(span, ProgramFinding::Unsupported { what, instead }));
        }
        match (motion.motion, &motion.through) {
            (MotionKind::Ptp, _) => self.ptp(&motion.to, span),
            (_, Some(through)) => self.circ(motion, through, span),
            (_, None) => self.lin(&motion.to, span),
        }
    }

    /// Leaves the innermost `LOOP`.
    fn exit(&mut self) -> Result<(), ProgramFinding> {
        loop {
            match self.calls.levels.pop().map(|level| level.kind) {
                Some(LevelKind::Loop) => return Ok(()),
                Some(LevelKind::Routine { .. }) | None => return Err(ProgramFinding::ExitOutsideLoop),
                Some(_) => {}
            }
        }
    }

    fn begin_for(&mut self, statement: &StatementKind, span: &Span) -> Result<(), Fault> {
        let StatementKind::For { counter, from, to, step, body } = statement else { return Ok(()) };
        let (from, last) = (from.int(self)?, to.int(self)?);
        let step = step.as_ref().map_or(Ok(1), |step| step.int(self))?;
        if step == 0 {
            return Err(Fault::new(span, ProgramFinding::ZeroStep));
        }
        self.write(counter, Value::Int(from))?;
        if within(from, last, step) {
            let kind = LevelKind::For { counter: counter.clone(), last, step };
            self.push(ExecutionLevel::block(body, kind)).at(span)?;
        }
        Ok(())
    }

    fn pulse(&mut self, output: &Place, level: &Expression, seconds: &Expression) -> Result<(), Fault> {
        let level = level.bool(self)?;
        let seconds = seconds.number(self)?;
        if !(0.012..=3.0).contains(&seconds) {
            return Err(Fault::new(&output.span, ProgramFinding::PulseTime { seconds }));
        }
        let number = match output.parts.as_slice() {
            [Part::Element(index)] if output.name == "$OUT" => {
                usize::try_from(index.int(self)?).ok().filter(|number| (1..=SIGNALS).contains(number))
            }
            _ => {
                let signal = self.signal(output);
                let single = signal.filter(|signal| signal.is_output && signal.first == signal.last);
                single.map(|signal| signal.first)
            }
        };
        let Some(number) = number else { return Err(Fault::new(&output.span, ProgramFinding::NoOutput)) };
        self.set_bit("$OUT", number, level);
        self.pulses.retain(|pulse| pulse.output != number);
        self.pulses.push(OutputPulse { output: number, level: !level, until_s: self.t_s + seconds });
        Ok(())
    }

    fn call_routine(&mut self, name: &str, arguments: &[Expression], span: &Span) -> Result<(), Fault> {
        let module = self.module();
        let routine = self.program.routine(module, name).map(|(at, routine)| (at, routine.clone()));
        let Some((callee, routine)) = routine else {
            return self.built_in(name, arguments, span);
        };
        let (expected, given) = (routine.parameters.len(), arguments.len());
        if expected != given {
            let routine = name.into();
            return Err(Fault::new(span, ProgramFinding::Arguments { routine, expected, given }));
        }
        let mut locals = locals(&routine).at(span)?;
        for (parameter, argument) in routine.parameters.iter().zip(arguments) {
            let value = argument.value(self)?;
            let Some(variable) = locals.get_mut(parameter) else {
                let (routine, parameter) = (name.into(), parameter.clone());
                return Err(Fault::new(span, ProgramFinding::ParameterNotDeclared { routine, parameter }));
            };
            let kind = variable.kind;
            variable.value.store(kind, value).at(&argument.span)?;
        }
        self.push(ExecutionLevel::routine(callee, &routine, locals)).at(span)?;
        self.select_ball(callee);
        Ok(())
    }

    /// The controller's own `BAS (#COMMAND,value)`.
    fn built_in(&mut self, name: &str, arguments: &[Expression], span: &Span) -> Result<(), Fault> {
        let unsupported = |what: String, instead: &str| {
            Fault::new(span, ProgramFinding::Unsupported { what, instead: instead.into() })
        };
        if name != "BAS" {
            return Err(unsupported(
                name.into(),
                "of the controller's routines the simulator supports only BAS",
            ));
        }
        let [Expression { kind: ExpressionKind::Enum(command), .. }, value] = arguments else {
            return Err(Fault::new(span, ProgramFinding::BasCommand));
        };
        let percent = value.number(self)?;
        let variable = match command.as_str() {
            "INITMOV" => return Ok(()),
            "VEL_PTP" => "$VEL_AXIS",
            "ACC_PTP" => "$ACC_AXIS",
            _ => {
                let instead = "set the variables themselves, as in $TOOL={X 0.0,..}";
                return Err(unsupported(format!("BAS (#{command},..)"), instead));
            }
        };
        if !(1.0..=100.0).contains(&percent) {
            return Err(Fault::new(&value.span, ProgramFinding::NotPercent { value: percent }));
        }
        if let Some(Value::Array(axes)) = self.system.get_mut(variable).map(|variable| &mut variable.value) {
            axes.fill(Value::Int(percent.round() as i64));
        }
        Ok(())
    }
}

/// The local variables of a routine.
fn locals(routine: &Routine) -> Result<KrlVariables, ProgramFinding> {
    let mut locals = KrlVariables::new();
    for declaration in &routine.declarations {
        let Declaration::Variables { type_name, variables } = declaration else { continue };
        let kind =
            Type::named(type_name).ok_or_else(|| ProgramFinding::NoType { name: type_name.clone() })?;
        for declared in variables {
            if declared.value.is_some() {
                return Err(ProgramFinding::Unsupported {
                    what: format!("a value in the declaration of {}", declared.name),
                    instead: "in a .src file set it in a line of its own".into(),
                });
            }
            locals.insert(declared.name.clone(), KrlVariable::new(kind, declared.elements));
        }
    }
    Ok(locals)
}

/// Whether a counter has not passed its last value.
fn within(value: i64, last: i64, step: i64) -> bool {
    if step > 0 { value <= last } else { value >= last }
}

fn mentions(expression: &Expression, name: &str) -> bool {
    match &expression.kind {
        ExpressionKind::Place(place) => place.name == name,
        ExpressionKind::Unary(_, operand) => mentions(operand, name),
        ExpressionKind::Binary(_, left, right) => mentions(left, name) || mentions(right, name),
        ExpressionKind::Int(_)
        | ExpressionKind::Real(_)
        | ExpressionKind::Bool(_)
        | ExpressionKind::Enum(_)
        | ExpressionKind::Text(_)
        | ExpressionKind::Aggregate(_)
        | ExpressionKind::Call { .. } => false,
    }
}
