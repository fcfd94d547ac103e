//! The `.dat` files as a controller keeps them: with the values that the program left in its variables.

use super::Interpreter;
use super::store::Variable;
use crate::program::krl::syntax::{Data, DataItem, DeclarationKind, Expression, Part};
use crate::program::krl::value::{Type, Value};

impl Interpreter {
    /// The name of each `.dat` file and its text with what the program has set since: scalars in their
    /// declarations, elements of arrays in lines before `ENDDAT`. All else stays as it is.
    pub(in crate::sim::controller) fn saved(&self) -> Vec<(String, String)> {
        let modules = self.program.modules.iter().zip(&self.data);
        modules
            .filter_map(|(module, variables)| {
                let data = module.data.as_ref()?;
                Some((data.file.clone(), saved(data, |name| variables.get(name))))
            })
            .collect()
    }
}

fn saved<'v>(data: &Data, variable: impl Fn(&str) -> Option<&'v Variable>) -> String {
    let mut text = data.text.clone();
    let given = |name: &str, at: usize| {
        data.items.iter().any(|item| match item {
            DataItem::Value { target, .. } => {
                let element = target.parts.first().and_then(|part| match part {
                    Part::Element(index) => index.index(),
                    _ => None,
                });
                target.name == name && element.is_none_or(|element| usize::try_from(element) == Ok(at))
            }
            DataItem::Declaration(_) => false,
        })
    };
    let (mut replaced, mut added) = (Vec::new(), String::new());
    for item in &data.items {
        let DataItem::Declaration(declaration) = item else { continue };
        let DeclarationKind::Variables { names, .. } = &declaration.kind else { continue };
        for declared in names {
            let Some(variable) = variable(&declared.name) else { continue };
            match (&variable.value, &declared.value) {
                (Value::Array(elements), _) => {
                    let set = elements.iter().enumerate().filter(|(at, _)| !given(&declared.name, at + 1));
                    for (at, text) in set.filter_map(|(at, value)| Some((at, literal(value, variable.kind)?)))
                    {
                        added.push_str(&format!("{}[{}]={text}\r\n", declared.name, at + 1));
                    }
                }
                (value @ (Value::Int(_) | Value::Real(_) | Value::Bool(_)), Some(written))
                    if !says(written, value) =>
                {
                    replaced.extend(literal(value, variable.kind).map(|text| (written.span.clone(), text)));
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

/// Whether a declaration gives this value already.
fn says(written: &Expression, value: &Value) -> bool {
    match (written.constant(), value) {
        (Ok(Value::Bool(given)), Value::Bool(value)) => given == *value,
        (Ok(given), value) => given.number().ok() == value.number().ok(),
        (Err(_), _) => false,
    }
}

/// A value as KRL writes it, every digit of it; `None` where nothing was set.
fn literal(value: &Value, kind: Type) -> Option<String> {
    Some(match (value, kind) {
        (Value::Int(value), _) => value.to_string(),
        (Value::Real(value), _) => real(*value),
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

/// Nine decimals: what a measured angle needs, and no exponent.
fn real(value: f64) -> String {
    format!("{:.9}", value + 0.0)
}
