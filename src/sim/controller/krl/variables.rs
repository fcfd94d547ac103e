//! What the names in a program mean: variables, signals, functions.

use super::store::{Found, READ_ONLY, Step, Variable, part};
use super::{Interpreter, Signal};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::nearest;
use crate::program::krl::evaluate::{AXIS_NAMES, At, Fault, POSE_NAMES, Scope};
use crate::program::krl::syntax::{Expression, Part, Place, Span};
use crate::program::krl::value::{Type, Value};
use crate::robot::AXES;

impl Scope for Interpreter {
    fn read(&mut self, place: &Place) -> Result<Value, Fault> {
        let steps = self.steps(place)?;
        if let Some(signal) = self.signal(place) {
            return Ok(self.read_signal(signal));
        }
        let mut measured = self.measured(&place.name);
        let variable = match &mut measured {
            Some(variable) => variable,
            None => self.variable(&place.name).at(&place.span)?,
        };
        match part(variable, &steps).at(&place.span)?.value {
            Value::Unset => Err(Fault::new(&place.span, ProgramFinding::NotSet { name: place.name.clone() })),
            value => Ok(value.clone()),
        }
    }

    fn call(&mut self, name: &str, arguments: &[Expression], span: &Span) -> Result<Value, Fault> {
        self.ekrl_call(name, arguments, span)
    }
}

impl Interpreter {
    fn steps(&mut self, place: &Place) -> Result<Vec<Step>, Fault> {
        let steps = place.parts.iter().map(|part| {
            Ok(match part {
                Part::Whole => Step::Whole,
                Part::Member(name) => Step::Member(name.clone()),
                Part::Element(index) => Step::Element(index.int(self)?),
            })
        });
        steps.collect()
    }

    pub(super) fn write(&mut self, place: &Place, value: Value) -> Result<(), Fault> {
        let steps = self.steps(place)?;
        self.store(place, &steps, value).at(&place.span)
    }

    fn store(&mut self, place: &Place, steps: &[Step], value: Value) -> Result<(), ProgramFinding> {
        if READ_ONLY.contains(&place.name.as_str()) {
            return Err(ProgramFinding::ReadOnly { name: place.name.clone() });
        }
        if let Some(signal) = self.signal(place) {
            return self.write_signal(signal, &value);
        }
        let Found { value: here, kind } = part(self.variable(&place.name)?, steps)?;
        here.store(kind, value)?;
        if place.name == "$OV_PRO" && !(0..=100).contains(&here.int()?) {
            return Err(ProgramFinding::NotPercent { value: here.number()? });
        }
        if place.name == "XQ" && self.strobe.is_none() {
            self.dwells = self.dwells.saturating_add(1);
        }
        Ok(())
    }

    /// A variable of the routine, of its module's `.dat`, or of the system.
    fn variable(&mut self, name: &str) -> Result<&mut Variable, ProgramFinding> {
        let module = self.module();
        let locals = self.levels.iter_mut().rev().find_map(|level| level.locals_mut());
        if let Some(found) = locals.and_then(|locals| locals.get_mut(name)) {
            return Ok(found);
        }
        if let Some(found) = self.data.get_mut(module).and_then(|data| data.get_mut(name)) {
            return Ok(found);
        }
        if !name.starts_with('$') {
            return Err(ProgramFinding::NotDeclared { name: name.into() });
        }
        if !self.system.contains_key(name) {
            return Err(match nearest(name, self.system.keys().map(String::as_str)) {
                Some(near) => ProgramFinding::SystemVariableMistyped { name: name.into(), near: near.into() },
                None => ProgramFinding::NoSystemVariable { name: name.into() },
            });
        }
        self.system.get_mut(name).ok_or_else(|| ProgramFinding::NoSystemVariable { name: name.into() })
    }

    /// What the controller measures: it is where it is commanded to be.
    fn measured(&self, name: &str) -> Option<Variable> {
        let (kind, names, values) = match name {
            "$AXIS_ACT" | "$AXIS_ACT_MEAS" => ("E6AXIS", AXIS_NAMES, self.arm.axes.map(f64::to_degrees)),
            "$POS_ACT" | "$POS_ACT_MES" => ("E6POS", POSE_NAMES, self.pose_now()),
            _ => return None,
        };
        let external = ["E1", "E2", "E3", "E4", "E5", "E6"].into_iter().zip([0.0; AXES]);
        let fields = names.into_iter().zip(values).chain(external);
        let fields = fields.map(|(name, value)| (name.to_owned(), Value::Real(value)));
        Some(Variable { kind: Type::named(kind)?, value: Value::Struct(fields.collect()) })
    }

    fn signal(&self, place: &Place) -> Option<Signal> {
        let signals = self.signals.get(self.module())?;
        signals.get(&place.name).copied().filter(|_| place.parts.is_empty())
    }

    /// One output is a BOOL, several are an INT, the first its lowest bit.
    fn read_signal(&self, signal: Signal) -> Value {
        let level = |at: usize| signal.output && self.output(at); // no input is ever high
        if signal.first == signal.last {
            return Value::Bool(level(signal.first));
        }
        let bits = (signal.first..=signal.last).rev();
        Value::Int(bits.fold(0, |value, at| 2 * value + i64::from(level(at))))
    }

    fn write_signal(&mut self, signal: Signal, value: &Value) -> Result<(), ProgramFinding> {
        if !signal.output {
            return Err(ProgramFinding::InputSet);
        }
        if signal.first == signal.last {
            let level = value.bool()?;
            if self.strobe == Some(signal.first) && self.output(signal.first) && !level {
                self.dwells = self.dwells.saturating_add(1);
            }
            self.set_output(signal.first, level);
            return Ok(());
        }
        let (value, outputs) = (value.int()?, signal.last - signal.first + 1);
        if value < 0 || value >= 1_i64 << outputs {
            return Err(ProgramFinding::NotOnOutputs { value, outputs });
        }
        for (bit, at) in (signal.first..=signal.last).enumerate() {
            self.set_output(at, value >> bit & 1 == 1);
        }
        Ok(())
    }
}
