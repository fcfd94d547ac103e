//! The controller's variables: those of the system, of each module, and of each routine that runs.

use std::collections::BTreeMap;

use crate::catalogue::ProgramFinding;
use crate::program::krl::value::{APPROXIMATE, FRAME_TYPE, LOAD_TYPE, PATH, Type, Value};
use crate::robot::AXES;

/// Digital inputs and outputs.
const SIGNALS: usize = 4096;
/// `$FLAG[n]`.
const FLAGS: usize = 1024;

/// A variable; an array's type is that of its elements.
#[derive(Clone, Debug)]
pub(super) struct Variable {
    pub(super) kind: Type,
    pub(super) value: Value,
}

impl Variable {
    pub(super) fn new(kind: Type, elements: Option<usize>) -> Self {
        let value = match elements {
            // A text is stored whole, whatever its array's length.
            Some(_) if kind == Type::Char => Value::Unset,
            Some(elements) => Value::Array(vec![kind.unset(); elements]),
            None => kind.unset(),
        };
        Self { kind, value }
    }

    fn set(kind: Type, value: Value) -> Self {
        Self { kind, value }
    }
}

/// Variables by name.
pub(super) type Names = BTreeMap<String, Variable>;

/// A step into a variable, its index known.
#[derive(Clone, Debug)]
pub(super) enum Step {
    Element(i64),
    Whole,
    Member(String),
}

/// System variables, with the values that they have before a program sets them.
pub(super) fn system() -> Names {
    let null = |names: [&str; 6]| {
        Value::Struct(names.into_iter().map(|name| (name.to_owned(), Value::Real(0.0))).collect())
    };
    let frame = || null(["X", "Y", "Z", "A", "B", "C"]);
    let path = |cp: f64, turn: f64| {
        let fields = [("CP", cp), ("ORI1", turn), ("ORI2", turn)];
        Value::Struct(fields.into_iter().map(|(name, value)| (name.to_owned(), Value::Real(value))).collect())
    };
    let percent = || Value::Array(vec![Value::Int(100); AXES]);
    let low = || Value::Array(vec![Value::Bool(false); SIGNALS]);
    let word = |word: &str| Variable::set(Type::Enum, Value::Enum(word.to_owned()));
    [
        ("$TOOL", Variable::set(FRAME_TYPE, frame())),
        ("$BASE", Variable::set(FRAME_TYPE, frame())),
        ("$LOAD", Variable::set(LOAD_TYPE, LOAD_TYPE.unset())),
        ("$VEL", Variable::set(PATH, path(0.25, 200.0))),
        ("$ACC", Variable::set(PATH, path(2.3, 1000.0))),
        ("$APO", Variable::set(APPROXIMATE, APPROXIMATE.unset())),
        // Whole percents: what is set is rounded.
        ("$VEL_AXIS", Variable::set(Type::Int, percent())),
        ("$ACC_AXIS", Variable::set(Type::Int, percent())),
        ("$IPO_MODE", word("BASE")),
        ("$ORI_TYPE", word("VAR")),
        ("$CIRC_TYPE", word("BASE")),
        ("$ADVANCE", Variable::set(Type::Int, Value::Int(3))),
        ("$OV_PRO", Variable::set(Type::Int, Value::Int(100))),
        ("$STOPMESS", Variable::set(Type::Bool, Value::Bool(false))),
        ("$ABS_ACCUR", Variable::set(Type::Bool, Value::Bool(false))),
        ("$FLAG", Variable::set(Type::Bool, Value::Array(vec![Value::Bool(false); FLAGS]))),
        ("$OUT", Variable::set(Type::Bool, low())),
        ("$IN", Variable::set(Type::Bool, low())),
    ]
    .into_iter()
    .map(|(name, variable)| (name.to_owned(), variable))
    .collect()
}

/// System variables that a program may not set.
pub(super) const READ_ONLY: &[&str] =
    &["$IN", "$ABS_ACCUR", "$STOPMESS", "$AXIS_ACT", "$AXIS_ACT_MEAS", "$POS_ACT", "$POS_ACT_MES"];

/// A part of a variable, and its type.
pub(super) struct Found<'v> {
    pub(super) value: &'v mut Value,
    pub(super) kind: Type,
}

pub(super) fn part<'v>(variable: &'v mut Variable, steps: &[Step]) -> Result<Found<'v>, ProgramFinding> {
    let mut kind = variable.kind;
    let mut value = &mut variable.value;
    for step in steps {
        value = match (step, value) {
            (&Step::Element(index), Value::Array(array)) => {
                let elements = array.len();
                let at = usize::try_from(index).ok().and_then(|index| index.checked_sub(1));
                at.and_then(|at| array.get_mut(at)).ok_or(ProgramFinding::IndexOutside { index, elements })?
            }
            (Step::Whole, value) if kind == Type::Char => value,
            (Step::Member(name), value) => {
                let none = || ProgramFinding::NoComponent { component: name.clone() };
                let (Value::Struct(fields), Type::Struct(types)) = (value, kind) else { return Err(none()) };
                let (_, of) = types.iter().find(|(known, _)| known == name).ok_or_else(none)?;
                kind = *of;
                fields.entry(name.clone()).or_insert(Value::Unset)
            }
            (Step::Element(_) | Step::Whole, _) => return Err(ProgramFinding::NotAnArray),
        };
    }
    Ok(Found { value, kind })
}
