//! Values and types of KRL variables.

use std::collections::BTreeMap;

use crate::program::ProgramFinding;

/// A value. A variable that was never assigned has [`Value::Unset`].
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Unset,
    Int(i64),
    Real(f64),
    Bool(bool),
    Enum(String),
    Text(String),
    Struct(BTreeMap<String, Value>),
    Array(Vec<Value>),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Type {
    Int,
    Real,
    Bool,
    Char,
    Enum,
    Struct(&'static [(&'static str, Type)]),
}

const R: Type = Type::Real;
const I: Type = Type::Int;
const VECTOR: &[(&str, Type)] = &[("X", R), ("Y", R), ("Z", R)];
const FRAME: &[(&str, Type)] = &[("X", R), ("Y", R), ("Z", R), ("A", R), ("B", R), ("C", R)];
const POS: &[(&str, Type)] =
    &[("X", R), ("Y", R), ("Z", R), ("A", R), ("B", R), ("C", R), ("S", I), ("T", I)];
#[rustfmt::skip]
const E6POS: &[(&str, Type)] = &[
    ("X", R), ("Y", R), ("Z", R), ("A", R), ("B", R), ("C", R), ("S", I), ("T", I),
    ("E1", R), ("E2", R), ("E3", R), ("E4", R), ("E5", R), ("E6", R),
];
const AXIS: &[(&str, Type)] = &[("A1", R), ("A2", R), ("A3", R), ("A4", R), ("A5", R), ("A6", R)];
#[rustfmt::skip]
const E6AXIS: &[(&str, Type)] = &[
    ("A1", R), ("A2", R), ("A3", R), ("A4", R), ("A5", R), ("A6", R),
    ("E1", R), ("E2", R), ("E3", R), ("E4", R), ("E5", R), ("E6", R),
];
const LOAD: &[(&str, Type)] = &[("M", R), ("CM", Type::Struct(FRAME)), ("J", Type::Struct(VECTOR))];
const EKI_STATUS: &[(&str, Type)] = &[("BUFF", I), ("READ", I), ("MSG_NO", I), ("CONNECTED", Type::Bool)];
/// `$VEL`, `$ACC`
pub(crate) const PATH: Type = Type::Struct(&[("CP", R), ("ORI1", R), ("ORI2", R)]);
/// `$APO`
pub(crate) const APPROXIMATE: Type = Type::Struct(&[("CDIS", R), ("CPTP", R), ("CORI", R), ("CVEL", R)]);
pub(crate) const FRAME_TYPE: Type = Type::Struct(FRAME);
pub(crate) const LOAD_TYPE: Type = Type::Struct(LOAD);

impl Type {
    pub(crate) fn named(name: &str) -> Option<Self> {
        Some(match name {
            "INT" => Type::Int,
            "REAL" => Type::Real,
            "BOOL" => Type::Bool,
            "CHAR" => Type::Char,
            "FRAME" => FRAME_TYPE,
            "POS" => Type::Struct(POS),
            "E6POS" => Type::Struct(E6POS),
            "AXIS" => Type::Struct(AXIS),
            "E6AXIS" => Type::Struct(E6AXIS),
            "LOAD" => LOAD_TYPE,
            "EKI_STATUS" => Type::Struct(EKI_STATUS),
            _ => return None,
        })
    }

    /// Number of values that a variable of this type holds.
    pub(crate) fn values(self) -> usize {
        if let Type::Struct(fields) = self { fields.iter().map(|(_, kind)| kind.values()).sum() } else { 1 }
    }

    /// The value of a variable of this type before the first assignment.
    pub(crate) fn unset(self) -> Value {
        if let Type::Struct(fields) = self {
            Value::Struct(fields.iter().map(|(name, kind)| ((*name).to_owned(), kind.unset())).collect())
        } else {
            Value::Unset
        }
    }
}

impl Value {
    fn describe(&self) -> &'static str {
        match self {
            Value::Unset => "nothing",
            Value::Int(_) => "an INT",
            Value::Real(_) => "a REAL",
            Value::Bool(_) => "a BOOL",
            Value::Enum(_) => "an enumeration",
            Value::Text(_) => "a text",
            Value::Struct(_) => "a structure",
            Value::Array(_) => "an array",
        }
    }

    fn wrong(&self, expected: &'static str) -> ProgramFinding {
        ProgramFinding::WrongType { expected, found: self.describe() }
    }

    pub(crate) fn number(&self) -> Result<f64, ProgramFinding> {
        match self {
            Value::Int(value) => Ok(*value as f64),
            Value::Real(value) => Ok(*value),
            Value::Unset
            | Value::Bool(_)
            | Value::Enum(_)
            | Value::Text(_)
            | Value::Struct(_)
            | Value::Array(_) => Err(self.wrong("a number")),
        }
    }

    pub(crate) fn int(&self) -> Result<i64, ProgramFinding> {
        match self {
            Value::Int(value) => Ok(*value),
            // KRL rounds a REAL that is used as an INT.
            Value::Real(value) if value.abs() < 2e9 => Ok(value.round() as i64),
            Value::Real(value) => Err(ProgramFinding::IntTooLarge { value: *value }),
            Value::Unset
            | Value::Bool(_)
            | Value::Enum(_)
            | Value::Text(_)
            | Value::Struct(_)
            | Value::Array(_) => Err(self.wrong("an INT")),
        }
    }

    pub(crate) fn bool(&self) -> Result<bool, ProgramFinding> {
        if let Value::Bool(value) = self { Ok(*value) } else { Err(self.wrong("a BOOL")) }
    }

    pub(crate) fn text(&self) -> Result<&str, ProgramFinding> {
        if let Value::Text(text) = self { Ok(text) } else { Err(self.wrong("a text")) }
    }

    /// A component of a structure, if it has a value.
    pub(crate) fn field(&self, name: &str) -> Option<&Value> {
        if let Value::Struct(fields) = self {
            fields.get(name).filter(|value| **value != Value::Unset)
        } else {
            None
        }
    }

    /// Assigns `value`, converted to `kind`. Components that `value` does not have keep their value.
    pub(crate) fn store(&mut self, kind: Type, value: Value) -> Result<(), ProgramFinding> {
        match (kind, value, &mut *self) {
            (_, Value::Unset, _) => {
                return Err(ProgramFinding::CannotStore { found: Value::Unset.describe() });
            }
            (_, _, Value::Array(_)) => return Err(ProgramFinding::ArrayAsWhole),
            (Type::Struct(types), Value::Struct(assigned), Value::Struct(fields)) => {
                for (name, value) in assigned {
                    let Some((_, kind)) = types.iter().find(|(known, _)| *known == name) else {
                        return Err(ProgramFinding::NoComponent { component: name });
                    };
                    if value != Value::Unset {
                        fields.entry(name).or_insert_with(|| kind.unset()).store(*kind, value)?;
                    }
                }
            }
            (Type::Int, value, own) => *own = Value::Int(value.int()?),
            (Type::Real, value, own) => *own = Value::Real(value.number()?),
            (Type::Bool, value, own) => *own = Value::Bool(value.bool()?),
            (Type::Char, Value::Text(text), own) => *own = Value::Text(text),
            (Type::Enum, Value::Enum(name), own) => *own = Value::Enum(name),
            (_, value, _) => return Err(ProgramFinding::CannotStore { found: value.describe() }),
        }
        Ok(())
    }
}
