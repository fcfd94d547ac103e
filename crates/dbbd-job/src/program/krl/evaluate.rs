//! Evaluation of expressions: for the simulated controller, and for the constants in `.dat` files.

use std::collections::BTreeMap;
use std::ops::{Add, Div, Mul, Sub};

use super::syntax::{Binary, Expression, ExpressionKind, Place, Span, Unary};
use super::value::Value;
use crate::program::ProgramFinding;
use crate::program::Target;

pub(crate) const AXIS_NAMES: [&str; 6] = ["A1", "A2", "A3", "A4", "A5", "A6"];
pub(crate) const EXTERNAL_NAMES: [&str; 6] = ["E1", "E2", "E3", "E4", "E5", "E6"];
pub(crate) const POSE_NAMES: [&str; 6] = ["X", "Y", "Z", "A", "B", "C"];

/// A finding with its bytes in the file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Fault {
    pub(crate) span: Span,
    pub(crate) finding: ProgramFinding,
}

impl Fault {
    pub(crate) fn new(span: &Span, finding: ProgramFinding) -> Self {
        Self { span: span.clone(), finding }
    }
}

/// Adds the bytes to a finding.
pub(crate) trait At<T> {
    fn at(self, span: &Span) -> Result<T, Fault>;
}

impl<T> At<T> for Result<T, ProgramFinding> {
    fn at(self, span: &Span) -> Result<T, Fault> {
        self.map_err(|finding| Fault::new(span, finding))
    }
}

/// The meaning of the names in an expression.
pub(crate) trait Scope {
    fn read(&mut self, place: &Place) -> Result<Value, Fault>;

    fn call(&mut self, name: &str, arguments: &[Expression], span: &Span) -> Result<Value, Fault>;
}

/// A scope without variables: values in a `.dat` file and taught points are constants.
struct NoVariables;

impl Scope for NoVariables {
    fn read(&mut self, place: &Place) -> Result<Value, Fault> {
        Err(Fault::new(&place.span, ProgramFinding::NotConstant { name: place.name.clone() }))
    }

    fn call(&mut self, name: &str, _: &[Expression], span: &Span) -> Result<Value, Fault> {
        Err(Fault::new(span, ProgramFinding::NotConstant { name: name.into() }))
    }
}

impl Expression {
    pub(crate) fn value(&self, scope: &mut impl Scope) -> Result<Value, Fault> {
        Ok(match &self.kind {
            ExpressionKind::Int(value) => in_32_bits(Some(*value)).at(&self.span)?,
            ExpressionKind::Real(value) => Value::Real(*value),
            ExpressionKind::Bool(value) => Value::Bool(*value),
            ExpressionKind::Enum(name) => Value::Enum(name.clone()),
            ExpressionKind::Text(text) => Value::Text(text.clone()),
            ExpressionKind::Place(place) => scope.read(place)?,
            ExpressionKind::Aggregate(fields) => {
                let mut components = BTreeMap::new();
                for field in fields {
                    components.insert(field.name.clone(), field.value.value(scope)?);
                }
                Value::Struct(components)
            }
            ExpressionKind::Call { name, arguments } => scope.call(name, arguments, &self.span)?,
            ExpressionKind::Unary(operator, operand) => {
                let value = operand.value(scope)?;
                unary(*operator, &value).at(&self.span)?
            }
            ExpressionKind::Binary(operator, left, right) => {
                let (left, right) = (left.value(scope)?, right.value(scope)?);
                binary(*operator, &left, &right).at(&self.span)?
            }
        })
    }

    pub(crate) fn number(&self, scope: &mut impl Scope) -> Result<f64, Fault> {
        self.value(scope)?.number().at(&self.span)
    }

    pub(crate) fn int(&self, scope: &mut impl Scope) -> Result<i64, Fault> {
        self.value(scope)?.int().at(&self.span)
    }

    pub(crate) fn bool(&self, scope: &mut impl Scope) -> Result<bool, Fault> {
        self.value(scope)?.bool().at(&self.span)
    }

    /// The value of an expression without variables.
    pub(crate) fn constant(&self) -> Result<Value, Fault> {
        self.value(&mut NoVariables)
    }

    /// The value of a constant INT, such as the index of an element.
    pub(crate) fn index(&self) -> Option<i64> {
        match self.constant() {
            Ok(Value::Int(index)) => Some(index),
            _ => None,
        }
    }
}

/// A commanded position; components that are not written keep their value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Position {
    /// A1 to A6, degrees.
    Axes([Option<f64>; 6]),
    Pose {
        /// X, Y, Z, mm, and A, B, C, degrees.
        components: [Option<f64>; 6],
        status: Option<i64>,
        turn: Option<i64>,
    },
}

impl Position {
    pub(crate) fn of(value: &Value) -> Result<Self, ProgramFinding> {
        if !matches!(value, Value::Struct(_)) {
            return Err(ProgramFinding::NoPosition);
        }
        let six = |names: [&str; 6]| -> Result<[Option<f64>; 6], ProgramFinding> {
            let mut components = [None; 6];
            for (component, name) in components.iter_mut().zip(names) {
                *component = value.field(name).map(Value::number).transpose()?;
            }
            Ok(components)
        };
        let axes = six(AXIS_NAMES)?;
        if axes.iter().any(Option::is_some) {
            return Ok(Self::Axes(axes));
        }
        let bits = |name: &str| value.field(name).map(Value::int).transpose();
        Ok(Self::Pose { components: six(POSE_NAMES)?, status: bits("S")?, turn: bits("T")? })
    }

    /// The target, if all components are written.
    fn complete(self) -> Result<Target, ProgramFinding> {
        let (names, components) = match self {
            Self::Axes(components) => (AXIS_NAMES, components),
            Self::Pose { components, .. } => (POSE_NAMES, components),
        };
        let mut numbers = [0.0; 6];
        for ((number, component), name) in numbers.iter_mut().zip(components).zip(names) {
            *number = component.ok_or(ProgramFinding::ComponentMissing { component: name })?;
        }
        let [x, y, z, a, b, c] = numbers;
        Ok(match self {
            Self::Axes(_) => Target::Axes(numbers),
            Self::Pose { status, turn, .. } => {
                Target::Pose { xyz_mm: [x, y, z], abc_deg: [a, b, c], status, turn }
            }
        })
    }
}

/// The target of a constant expression.
pub(crate) fn constant_target(expression: &Expression) -> Result<Target, Fault> {
    Position::of(&expression.constant()?).and_then(Position::complete).at(&expression.span)
}

/// An INT has 32 bits with sign; an operation that needs more has no result.
fn in_32_bits(value: Option<i64>) -> Result<Value, ProgramFinding> {
    let fits = value.filter(|value| i32::try_from(*value).is_ok());
    fits.map(Value::Int).ok_or(ProgramFinding::NoResult)
}

fn unary(operator: Unary, value: &Value) -> Result<Value, ProgramFinding> {
    Ok(match (operator, value) {
        (Unary::Minus, Value::Int(value)) => in_32_bits(value.checked_neg())?,
        (Unary::Minus, value) => Value::Real(-value.number()?),
        (Unary::Not, value) => Value::Bool(!value.bool()?),
    })
}

fn binary(operator: Binary, left: &Value, right: &Value) -> Result<Value, ProgramFinding> {
    match operator {
        Binary::Add => arithmetic(left, right, i64::checked_add, f64::add),
        Binary::Subtract => arithmetic(left, right, i64::checked_sub, f64::sub),
        Binary::Multiply => arithmetic(left, right, i64::checked_mul, f64::mul),
        Binary::Divide => arithmetic(left, right, i64::checked_div, f64::div),
        Binary::And => Ok(Value::Bool(left.bool()? && right.bool()?)),
        Binary::Or => Ok(Value::Bool(left.bool()? || right.bool()?)),
        Binary::Equal | Binary::Unequal => {
            let same = if matches!(left, Value::Bool(_) | Value::Enum(_) | Value::Text(_)) {
                left == right
            } else {
                left.number()? == right.number()?
            };
            Ok(Value::Bool(same == (operator == Binary::Equal)))
        }
        Binary::Less => Ok(Value::Bool(left.number()? < right.number()?)),
        Binary::LessOrEqual => Ok(Value::Bool(left.number()? <= right.number()?)),
        Binary::Greater => Ok(Value::Bool(left.number()? > right.number()?)),
        Binary::GreaterOrEqual => Ok(Value::Bool(left.number()? >= right.number()?)),
    }
}

/// The result for two whole numbers by `whole`, else for two numbers by `real`.
fn arithmetic(
    left: &Value,
    right: &Value,
    whole: fn(i64, i64) -> Option<i64>,
    real: fn(f64, f64) -> f64,
) -> Result<Value, ProgramFinding> {
    if let (Value::Int(left), Value::Int(right)) = (left, right) {
        return in_32_bits(whole(*left, *right));
    }
    let result = real(left.number()?, right.number()?);
    if result.is_finite() { Ok(Value::Real(result)) } else { Err(ProgramFinding::NoResult) }
}
