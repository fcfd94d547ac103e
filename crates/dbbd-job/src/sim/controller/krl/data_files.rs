//! The `.dat` files: loaded before the program starts, and saved with the values that the program assigned.

use super::{Interpreter, KrlSignal, KrlVariable, SIGNALS};
use crate::program::ProgramFinding;
use crate::program::krl::evaluate::{At, Fault};
use crate::program::krl::syntax::{Data, DataItem, Declaration, Declared, Expression, Part, Place};
use crate::program::krl::value::{Type, Value};
use dbbd_model::diagnostic::Diagnostic;

impl Interpreter {
    /// Declares and sets the variables of a module's `.dat`.
    pub(super) fn load(&mut self, module: usize) -> Result<(), Diagnostic> {
        let Some(data) = self.program.modules.get(module).and_then(|module| module.data.clone()) else {
            return Ok(());
        };
        for item in &data.items {
            let loaded = match item {
                DataItem::Declaration(declaration) => self.declare(module, declaration),
                DataItem::Value { target, value } => {
                    value.value(self).and_then(|value| self.write(target, value))
                }
            };
            loaded.map_err(|fault| data.as_text().wrong(&fault.span, fault.finding))?;
        }
        Ok(())
    }

    fn declare(&mut self, module: usize, declaration: &Declaration) -> Result<(), Fault> {
        match declaration {
            Declaration::External { .. } => {}
            Declaration::Signal { name, first, last } => {
                let low = signal(first)?;
                let high = last.as_ref().map_or(Ok(low), signal)?;
                if high.last < low.first || high.last - low.first > 31 {
                    return Err(Fault::new(&first.span, ProgramFinding::SignalWidth));
                }
                self.memory[module].signals.insert(name.clone(), KrlSignal { last: high.last, ..low });
            }
            Declaration::Variables { type_name, variables } => {
                for declared in variables {
                    self.declare_variable(module, type_name, declared)?;
                }
            }
        }
        Ok(())
    }

    fn declare_variable(&mut self, module: usize, type_name: &str, declared: &Declared) -> Result<(), Fault> {
        let Some(kind) = Type::named(type_name) else {
            return Err(Fault::new(&declared.span, ProgramFinding::NoType { name: type_name.into() }));
        };
        let mut variable = KrlVariable::new(kind, declared.elements);
        if let Some(initial) = &declared.value {
            let value = initial.value(self)?;
            variable.value.store(kind, value).at(&initial.span)?;
        }
        let name = declared.name.clone();
        if self.memory[module].variables.insert(name.clone(), variable).is_some() {
            return Err(Fault::new(&declared.span, ProgramFinding::DeclaredTwice { name }));
        }
        Ok(())
    }

    /// Name and text of each `.dat` file with the values that the program assigned: scalars in their declarations,
    /// elements of arrays in lines before `ENDDAT`. The other text stays as it is.
    pub(super) fn saved_files(&self) -> Vec<(String, String)> {
        let modules = self.program.modules.iter().zip(&self.memory);
        let saved = modules.filter_map(|(module, memory)| {
            let data = module.data.as_ref()?;
            Some((data.file.clone(), saved(data, |name| memory.variables.get(name))))
        });
        saved.collect()
    }
}

/// `$OUT[9]` or `$IN[9]` as a signal of one output or input.
fn signal(place: &Place) -> Result<KrlSignal, Fault> {
    let is_output = place.name == "$OUT";
    let number = match place.parts.as_slice() {
        [Part::Element(index)] if is_output || place.name == "$IN" => index.index(),
        _ => None,
    };
    let number = number.and_then(|number| usize::try_from(number).ok());
    match number.filter(|number| (1..=SIGNALS).contains(number)) {
        Some(number) => Ok(KrlSignal { is_output, first: number, last: number }),
        None => Err(Fault::new(&place.span, ProgramFinding::NoSignal)),
    }
}

fn saved<'v>(data: &Data, variable: impl Fn(&str) -> Option<&'v KrlVariable>) -> String {
    let mut text = data.text.clone();
    // Whether the file assigns to an element, or to the whole array.
    let is_assigned = |name: &str, element: usize| {
        data.items.iter().any(|item| match item {
            DataItem::Value { target, .. } => {
                let index = target
                    .parts
                    .first()
                    .and_then(|part| if let Part::Element(index) = part { index.index() } else { None });
                target.name == name && index.is_none_or(|index| usize::try_from(index) == Ok(element))
            }
            DataItem::Declaration(_) => false,
        })
    };
    let (mut replaced, mut added) = (Vec::new(), String::new());
    for item in &data.items {
        let DataItem::Declaration(declaration) = item else { continue };
        for Declared { name, value: initial, .. } in declaration.variables() {
            let Some(KrlVariable { kind, value }) = variable(name) else { continue };
            match (value, initial) {
                (Value::Array(elements), _) => {
                    for (element, value) in (1..).zip(elements) {
                        if let Some(text) = literal(value, *kind).filter(|_| !is_assigned(name, element)) {
                            added.push_str(&format!("{name}[{element}]={text}\r\n"));
                        }
                    }
                }
                (Value::Int(_) | Value::Real(_) | Value::Bool(_), Some(initial))
                    if !has_value(initial, value) =>
                {
                    replaced.extend(literal(value, *kind).map(|text| (initial.span.clone(), text)));
                }
                _ => {}
            }
        }
    }
    for (span, value) in replaced.into_iter().rev() {
        text.replace_range(span, &value);
    }
    let end = text.to_ascii_uppercase().rfind("ENDDAT").unwrap_or(text.len());
    text.insert_str(end, &added);
    text
}

/// Whether a constant expression has this value.
fn has_value(expression: &Expression, value: &Value) -> bool {
    match (expression.constant(), value) {
        (Ok(Value::Bool(constant)), Value::Bool(value)) => constant == *value,
        (Ok(constant), value) => constant.number().ok() == value.number().ok(),
        (Err(_), _) => false,
    }
}

/// A value as KRL writes it; `None` if KRL cannot write it.
fn literal(value: &Value, kind: Type) -> Option<String> {
    Some(match (value, kind) {
        (Value::Int(value), _) => value.to_string(),
        // Nine decimals are enough for a measured angle. KRL allows no exponent here; adding zero removes the sign of -0.
        (Value::Real(value), _) => format!("{:.9}", value + 0.0),
        (Value::Bool(value), _) => if *value { "TRUE" } else { "FALSE" }.into(),
        (Value::Struct(fields), Type::Struct(types)) => {
            let parts = types
                .iter()
                .filter_map(|(name, kind)| Some(format!("{name} {}", literal(fields.get(*name)?, *kind)?)));
            let parts: Vec<String> = parts.collect();
            (!parts.is_empty()).then(|| format!("{{{}}}", parts.join(",")))?
        }
        _ => return None,
    })
}
