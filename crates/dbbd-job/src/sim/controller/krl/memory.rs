//! The variables of the controller: of the system, of each module, and of each routine that is being executed.

use super::{Interpreter, KrlSignal, KrlVariable, KrlVariables, SIGNALS};
use crate::program::ProgramFinding;
use crate::program::krl::evaluate::{AXIS_NAMES, At, Fault, POSE_NAMES, Scope};
use crate::program::krl::syntax::{Expression, Part, Place, Span};
use crate::program::krl::value::{APPROXIMATE, FRAME_TYPE, LOAD_TYPE, PATH, Type, Value};
use dbbd_model::diagnostic::nearest;
use dbbd_model::robot::AXES;

/// `$FLAG[n]`
const FLAGS: usize = 1024;

/// Whether the controller moves by an accuracy model of its own, as `$ABS_ACCUR` says it: an ENUM from KSS 8.1 on, a BOOL before. Source:
/// KUKA, System Variables, for KSS 5.5 and 5.6 (2011) and for KSS 8.1 to 8.4 (2016).
pub(super) fn absolute_accuracy(is_kss5: bool, is_active: bool) -> Value {
    match (is_kss5, is_active) {
        (true, _) => Value::Bool(is_active),
        (false, true) => Value::Enum("ACTIVATED".to_owned()),
        (false, false) => Value::Enum("NONE".to_owned()),
    }
}

/// The system variables of KSS 5 or of KSS 8 with their initial values.
pub(super) fn system(is_kss5: bool) -> KrlVariables {
    let structure = |fields: &[(&str, f64)]| {
        let fields = fields.iter().map(|(name, value)| ((*name).to_owned(), Value::Real(*value)));
        Value::Struct(fields.collect())
    };
    let frame = || structure(&POSE_NAMES.map(|name| (name, 0.0)));
    let path =
        |cp: f64, orientation: f64| structure(&[("CP", cp), ("ORI1", orientation), ("ORI2", orientation)]);
    let percents = || Value::Array(vec![Value::Int(100); AXES]);
    let bools = |count: usize| Value::Array(vec![Value::Bool(false); count]);
    let mode = |mode: &str| (Type::Enum, Value::Enum(mode.to_owned()));
    let variables = [
        ("$TOOL", (FRAME_TYPE, frame())),
        ("$BASE", (FRAME_TYPE, frame())),
        ("$LOAD", (LOAD_TYPE, LOAD_TYPE.unset())),
        ("$VEL", (PATH, path(0.25, 200.0))),
        ("$ACC", (PATH, path(2.3, 1000.0))),
        ("$APO", (APPROXIMATE, APPROXIMATE.unset())),
        // The percents are INT: assigned values are rounded.
        ("$VEL_AXIS", (Type::Int, percents())),
        ("$ACC_AXIS", (Type::Int, percents())),
        ("$IPO_MODE", mode("BASE")),
        ("$ORI_TYPE", mode("VAR")),
        ("$CIRC_TYPE", mode("BASE")),
        ("$ADVANCE", (Type::Int, Value::Int(3))),
        ("$OV_PRO", (Type::Int, Value::Int(100))),
        ("$STOPMESS", (Type::Bool, Value::Bool(false))),
        ("$ABS_ACCUR", (if is_kss5 { Type::Bool } else { Type::Enum }, absolute_accuracy(is_kss5, false))),
        ("$FLAG", (Type::Bool, bools(FLAGS))),
        ("$OUT", (Type::Bool, bools(SIGNALS))),
        ("$IN", (Type::Bool, bools(SIGNALS))),
    ];
    variables
        .into_iter()
        .map(|(name, (kind, value))| (name.to_owned(), KrlVariable { kind, value }))
        .collect()
}

/// System variables to which a program may not assign.
const READ_ONLY: &[&str] =
    &["$IN", "$ABS_ACCUR", "$STOPMESS", "$AXIS_ACT", "$AXIS_ACT_MEAS", "$POS_ACT", "$POS_ACT_MES"];

/// A [`Part`] with its index evaluated.
enum EvaluatedPart<'p> {
    Element(i64),
    Whole,
    Component(&'p str),
}

/// A part of a variable with its type.
fn part<'v>(
    variable: &'v mut KrlVariable,
    steps: &[EvaluatedPart<'_>],
) -> Result<(&'v mut Value, Type), ProgramFinding> {
    let mut kind = variable.kind;
    let mut value = &mut variable.value;
    for step in steps {
        value = match (step, value) {
            (&EvaluatedPart::Element(index), Value::Array(array)) => {
                let elements = array.len();
                let at = usize::try_from(index).ok().and_then(|index| index.checked_sub(1));
                at.and_then(|at| array.get_mut(at)).ok_or(ProgramFinding::IndexOutside { index, elements })?
            }
            (EvaluatedPart::Whole, value) if kind == Type::Char => value,
            (EvaluatedPart::Component(name), value) => {
                let none = || ProgramFinding::NoComponent { component: (*name).into() };
                let (Value::Struct(fields), Type::Struct(types)) = (value, kind) else { return Err(none()) };
                (_, kind) = *types.iter().find(|(known, _)| known == name).ok_or_else(none)?;
                fields.entry((*name).into()).or_insert(Value::Unset)
            }
            (EvaluatedPart::Element(_) | EvaluatedPart::Whole, _) => return Err(ProgramFinding::NotAnArray),
        };
    }
    Ok((value, kind))
}

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
        let value = &*part(variable, &steps).at(&place.span)?.0;
        if matches!(value, Value::Unset) {
            return Err(Fault::new(&place.span, ProgramFinding::NotSet { name: place.name.clone() }));
        }
        Ok(value.clone())
    }

    fn call(&mut self, name: &str, arguments: &[Expression], span: &Span) -> Result<Value, Fault> {
        self.ekrl_call(name, arguments, span)
    }
}

impl Interpreter {
    fn steps<'p>(&mut self, place: &'p Place) -> Result<Vec<EvaluatedPart<'p>>, Fault> {
        let steps = place.parts.iter().map(|part| {
            Ok(match part {
                Part::Whole => EvaluatedPart::Whole,
                Part::Component(name) => EvaluatedPart::Component(name),
                Part::Element(index) => EvaluatedPart::Element(index.int(self)?),
            })
        });
        steps.collect()
    }

    pub(super) fn write(&mut self, place: &Place, value: Value) -> Result<(), Fault> {
        let steps = self.steps(place)?;
        self.store(place, &steps, value).at(&place.span)
    }

    fn store(
        &mut self,
        place: &Place,
        steps: &[EvaluatedPart<'_>],
        value: Value,
    ) -> Result<(), ProgramFinding> {
        if READ_ONLY.contains(&place.name.as_str()) {
            return Err(ProgramFinding::ReadOnly { name: place.name.clone() });
        }
        if let Some(signal) = self.signal(place) {
            return self.write_signal(signal, &value);
        }
        let (stored, kind) = part(self.variable(&place.name)?, steps)?;
        stored.store(kind, value)?;
        if place.name == "$OV_PRO" && !(0..=100).contains(&stored.int()?) {
            return Err(ProgramFinding::NotPercent { value: stored.number()? });
        }
        if place.name == "XQ" && self.dwells.strobe.is_none() {
            self.dwells.count = self.dwells.count.saturating_add(1);
        }
        Ok(())
    }

    /// A variable of the routine, of the module's `.dat`, or of the system.
    fn variable(&mut self, name: &str) -> Result<&mut KrlVariable, ProgramFinding> {
        let module = self.module();
        let locals = self.calls.levels.iter_mut().rev().find_map(|level| level.locals_mut());
        if let Some(variable) = locals.and_then(|locals| locals.get_mut(name)) {
            return Ok(variable);
        }
        if let Some(variable) = self.memory.get_mut(module).and_then(|memory| memory.variables.get_mut(name))
        {
            return Ok(variable);
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

    /// A measured system variable: the measured position is the commanded one.
    fn measured(&self, name: &str) -> Option<KrlVariable> {
        let (kind, names, values) = match name {
            "$AXIS_ACT" | "$AXIS_ACT_MEAS" => ("E6AXIS", AXIS_NAMES, self.arm.axes.map(f64::to_degrees)),
            "$POS_ACT" | "$POS_ACT_MES" => ("E6POS", POSE_NAMES, self.current_pose()),
            _ => return None,
        };
        let external = ["E1", "E2", "E3", "E4", "E5", "E6"].into_iter().zip([0.0; AXES]);
        let fields = names.into_iter().zip(values).chain(external);
        let fields = fields.map(|(name, value)| (name.to_owned(), Value::Real(value)));
        Some(KrlVariable { kind: Type::named(kind)?, value: Value::Struct(fields.collect()) })
    }

    /// The SIGNAL of the running module with this name.
    pub(super) fn signal(&self, place: &Place) -> Option<KrlSignal> {
        let signals = &self.memory.get(self.module())?.signals;
        signals.get(&place.name).copied().filter(|_| place.parts.is_empty())
    }

    /// The value of a SIGNAL: one output is a BOOL, several are an INT with the first output as its lowest bit.
    fn read_signal(&self, signal: KrlSignal) -> Value {
        let level = |at: usize| signal.is_output && self.output(at); // no input is ever high
        if signal.first == signal.last {
            return Value::Bool(level(signal.first));
        }
        let bits = (signal.first..=signal.last).rev();
        Value::Int(bits.fold(0, |value, at| 2 * value + i64::from(level(at))))
    }

    fn write_signal(&mut self, signal: KrlSignal, value: &Value) -> Result<(), ProgramFinding> {
        if !signal.is_output {
            return Err(ProgramFinding::InputSet);
        }
        if signal.first == signal.last {
            let level = value.bool()?;
            if self.dwells.strobe == Some(signal.first) && self.output(signal.first) && !level {
                self.dwells.count = self.dwells.count.saturating_add(1);
            }
            self.set_bit("$OUT", signal.first, level);
            return Ok(());
        }
        let (value, outputs) = (value.int()?, signal.last - signal.first + 1);
        if value < 0 || value >= 1_i64 << outputs {
            return Err(ProgramFinding::NotOnOutputs { value, outputs });
        }
        for (bit, at) in (signal.first..=signal.last).enumerate() {
            self.set_bit("$OUT", at, value >> bit & 1 == 1);
        }
        Ok(())
    }

    /// The level of an output, from 1.
    pub(super) fn output(&self, output: usize) -> bool {
        match self.system("$OUT") {
            Some(Value::Array(levels)) => {
                output.checked_sub(1).and_then(|at| levels.get(at)) == Some(&Value::Bool(true))
            }
            _ => false,
        }
    }

    /// Sets an element, from 1, of a system variable that is an array of BOOL.
    pub(super) fn set_bit(&mut self, array: &str, number: usize, level: bool) {
        if let Some(Value::Array(levels)) = self.system.get_mut(array).map(|variable| &mut variable.value)
            && let Some(element) = number.checked_sub(1).and_then(|at| levels.get_mut(at))
        {
            *element = Value::Bool(level);
        }
    }

    pub(super) fn system(&self, name: &str) -> Option<&Value> {
        self.system.get(name).map(|variable| &variable.value)
    }

    /// A component of a system variable that is a structure.
    pub(super) fn system_number(&self, name: &str, component: &str) -> Option<f64> {
        self.system(name)?.field(component)?.number().ok()
    }
}
