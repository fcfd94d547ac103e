//! Expressions, and reading and setting variables.

use std::collections::BTreeMap;

use super::store::{READ_ONLY, Step, Variable, part};
use super::value::{Type, Value};
use super::{Controller, Fault, Signal};
use crate::diag::nearest;
use crate::krl::syntax::{Binary, Expression, ExpressionKind, Part, Place, Unary};
use crate::model::AXES;

impl Controller {
    pub(super) fn evaluate(&mut self, expression: &Expression) -> Result<Value, Fault> {
        let wrong = |message: String| Fault::new(&expression.span, message);
        Ok(match &expression.kind {
            ExpressionKind::Int(value) => Value::Int(*value),
            ExpressionKind::Real(value) => Value::Real(*value),
            ExpressionKind::Bool(value) => Value::Bool(*value),
            ExpressionKind::Enum(name) => Value::Enum(name.clone()),
            ExpressionKind::Text(text) => Value::Text(text.clone()),
            ExpressionKind::Place(place) => self.read(place)?,
            ExpressionKind::Aggregate(fields) => {
                let mut given = BTreeMap::new();
                for field in fields {
                    given.insert(field.name.clone(), self.evaluate(&field.value)?);
                }
                Value::Struct(given)
            }
            ExpressionKind::Call { name, arguments } => self.ekrl_call(name, arguments, &expression.span)?,
            ExpressionKind::Unary(operator, operand) => {
                let value = self.evaluate(operand)?;
                match (operator, &value) {
                    (Unary::Minus, Value::Int(value)) => Value::Int(-value),
                    (Unary::Minus, value) => Value::Real(-value.number().map_err(wrong)?),
                    (Unary::Not, value) => Value::Bool(!value.bool().map_err(wrong)?),
                }
            }
            ExpressionKind::Binary(operator, left, right) => {
                let (left, right) = (self.evaluate(left)?, self.evaluate(right)?);
                operate(*operator, &left, &right).map_err(wrong)?
            }
        })
    }

    /// A number that an expression gives.
    pub(super) fn number(&mut self, expression: &Expression) -> Result<f64, Fault> {
        self.evaluate(expression)?.number().map_err(|why| Fault::new(&expression.span, why))
    }

    fn steps(&mut self, place: &Place) -> Result<Vec<Step>, Fault> {
        let mut steps = Vec::new();
        for part in &place.parts {
            steps.push(match part {
                Part::Whole => Step::Whole,
                Part::Member(name) => Step::Member(name.clone()),
                Part::Element(index) => {
                    let value = self.evaluate(index)?;
                    Step::Element(value.int().map_err(|why| Fault::new(&index.span, why))?)
                }
            });
        }
        Ok(steps)
    }

    fn read(&mut self, place: &Place) -> Result<Value, Fault> {
        let steps = self.steps(place)?;
        if let Some(signal) = self.signal(place) {
            return Ok(self.read_signal(signal));
        }
        let mut measured = self.measured(&place.name);
        let variable = match &mut measured {
            Some(variable) => variable,
            None => self.variable(place)?,
        };
        let (value, _) = part(variable, &steps).map_err(|why| Fault::new(&place.span, why))?;
        if *value == Value::Unset {
            return Err(Fault::new(&place.span, format!("{} has no value yet", place.name)));
        }
        Ok(value.clone())
    }

    pub(super) fn write(&mut self, place: &Place, value: Value) -> Result<(), Fault> {
        let steps = self.steps(place)?;
        let wrong = |why: String| Fault::new(&place.span, why);
        if READ_ONLY.contains(&place.name.as_str()) {
            return Err(wrong(format!("{} cannot be set", place.name)));
        }
        if let Some(signal) = self.signal(place) {
            return self.write_signal(signal, &value).map_err(wrong);
        }
        let variable = self.variable(place)?;
        let (here, kind) = part(variable, &steps).map_err(wrong)?;
        here.store(kind, value).map_err(wrong)?;
        if place.name == "$OV_PRO" && !(0..=100).contains(&here.int().map_err(wrong)?) {
            return Err(wrong("$OV_PRO is a percentage, 0 to 100".into()));
        }
        if place.name == "XQ" && self.strobe.is_none() {
            self.dwells = self.dwells.saturating_add(1);
        }
        Ok(())
    }

    /// A variable of the routine, of its module's `.dat`, or of the system.
    fn variable(&mut self, place: &Place) -> Result<&mut Variable, Fault> {
        let module = self.module();
        let name = place.name.as_str();
        let locals = self.levels.iter_mut().rev().find_map(|level| level.locals_mut());
        if let Some(found) = locals.and_then(|locals| locals.get_mut(name)) {
            return Ok(found);
        }
        let data = self.data.get_mut(module);
        let unknown = if name.starts_with('$') {
            let near = nearest(name, self.system.keys().map(String::as_str));
            let meant = near.map_or(String::new(), |near| format!("; did you mean {near}?"));
            format!("the simulator has no {name}{meant}")
        } else {
            format!("{name} is not declared, neither in the routine nor in the module's .dat")
        };
        data.and_then(|data| data.get_mut(name))
            .or_else(|| self.system.get_mut(name))
            .ok_or_else(|| Fault::new(&place.span, unknown))
    }

    /// What the controller measures: it stands where it is commanded to.
    fn measured(&self, name: &str) -> Option<Variable> {
        let fields = |names: [&str; 6], values: [f64; 6]| {
            names.iter().zip(values).map(|(name, value)| ((*name).to_owned(), Value::Real(value))).collect()
        };
        let (kind, mut given): (&str, BTreeMap<String, Value>) = match name {
            "$AXIS_ACT" | "$AXIS_ACT_MEAS" => {
                ("E6AXIS", fields(["A1", "A2", "A3", "A4", "A5", "A6"], self.axes.map(f64::to_degrees)))
            }
            "$POS_ACT" | "$POS_ACT_MES" => ("E6POS", self.pose_fields()),
            _ => return None,
        };
        let external: BTreeMap<String, Value> = fields(["E1", "E2", "E3", "E4", "E5", "E6"], [0.0; AXES]);
        given.extend(external);
        Some(Variable { kind: Type::named(kind)?, value: Value::Struct(given) })
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

    fn write_signal(&mut self, signal: Signal, value: &Value) -> Result<(), String> {
        if !signal.output {
            return Err("an input cannot be set".into());
        }
        if signal.first == signal.last {
            let level = value.bool()?;
            if self.strobe == Some(signal.first) && self.output(signal.first) && !level {
                self.dwells = self.dwells.saturating_add(1);
            }
            self.set_output(signal.first, level);
            return Ok(());
        }
        let count = signal.last - signal.first + 1;
        let number = value.int()?;
        if number < 0 || number >= 1_i64 << count {
            return Err(format!("{number} does not fit on {count} outputs"));
        }
        for (bit, at) in (signal.first..=signal.last).enumerate() {
            self.set_output(at, number >> bit & 1 == 1);
        }
        Ok(())
    }
}

fn operate(operator: Binary, left: &Value, right: &Value) -> Result<Value, String> {
    use Binary::{Add, And, Divide, Equal, Greater, GreaterOrEqual, Less, LessOrEqual, Multiply, Or};
    use Binary::{Subtract, Unequal};
    if let (Value::Int(left), Value::Int(right)) = (left, right) {
        let result = match operator {
            Add => left.checked_add(*right),
            Subtract => left.checked_sub(*right),
            Multiply => left.checked_mul(*right),
            Divide => left.checked_div(*right),
            _ => Some(0),
        };
        let result = result.ok_or("an INT overflows, or is divided by zero")?;
        if matches!(operator, Add | Subtract | Multiply | Divide) {
            return Ok(Value::Int(result));
        }
    }
    Ok(match operator {
        Add => Value::Real(left.number()? + right.number()?),
        Subtract => Value::Real(left.number()? - right.number()?),
        Multiply => Value::Real(left.number()? * right.number()?),
        Divide if right.number()? == 0.0 => return Err("a division by zero".into()),
        Divide => Value::Real(left.number()? / right.number()?),
        And => Value::Bool(left.bool()? && right.bool()?),
        Or => Value::Bool(left.bool()? || right.bool()?),
        Equal | Unequal => {
            let same = match (left, right) {
                (Value::Bool(_) | Value::Enum(_) | Value::Text(_), _) => left == right,
                _ => left.number()? == right.number()?,
            };
            Value::Bool(same == (operator == Equal))
        }
        Less => Value::Bool(left.number()? < right.number()?),
        LessOrEqual => Value::Bool(left.number()? <= right.number()?),
        Greater => Value::Bool(left.number()? > right.number()?),
        GreaterOrEqual => Value::Bool(left.number()? >= right.number()?),
    })
}
