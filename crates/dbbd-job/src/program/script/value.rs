//! Values of expressions. A value knows the file and the bytes of its literal, so that a point can be corrected where it is
//! written, however many names refer to it.

use std::collections::HashMap;

use super::expression::{Argument, Expression, ExpressionKind};
use crate::program::text::Span;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Value {
    /// Index of the file.
    pub(crate) file: usize,
    /// The bytes of the literal.
    pub(crate) span: Span,
    /// The name under which the value is declared.
    pub(crate) name: Option<String>,
    pub(crate) content: Content,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Content {
    Number(f64),
    Text(String),
    Bool(bool),
    List(Vec<Value>),
    Pose(Vec<Value>),
    /// A part that is not known.
    Unknown,
}

impl Value {
    /// Whether the literal stands inside that of another value.
    pub(crate) fn is_inside(&self, outer: &Self) -> bool {
        self.file == outer.file && self.span.start >= outer.span.start && self.span.end <= outer.span.end
    }

    pub(crate) fn number(&self) -> Option<f64> {
        if let Content::Number(value) = self.content { Some(value) } else { None }
    }

    pub(crate) fn bool(&self) -> Option<bool> {
        if let Content::Bool(value) = self.content { Some(value) } else { None }
    }

    pub(crate) fn list(&self) -> Option<&[Value]> {
        if let Content::List(list) = &self.content { Some(list) } else { None }
    }

    /// The part of a list with this index.
    pub(crate) fn part_mut(&mut self, index: usize) -> Option<&mut Self> {
        if let Content::List(list) = &mut self.content { list.get_mut(index) } else { None }
    }

    /// The elements of a list or pose of this length.
    pub(crate) fn elements<const N: usize>(&self) -> Option<&[Value; N]> {
        let (Content::List(list) | Content::Pose(list)) = &self.content else { return None };
        list.as_slice().try_into().ok()
    }

    /// The numbers of a list or pose of this length.
    pub(crate) fn numbers<const N: usize>(&self) -> Option<[f64; N]> {
        let numbers: Option<Vec<f64>> = self.elements::<N>()?.iter().map(Value::number).collect();
        numbers?.try_into().ok()
    }
}

/// Values by name.
pub(crate) type Variables = HashMap<String, Value>;

/// The value of an expression in a file; `None` if it is computed or one of its names has no value.
pub(crate) fn value(
    expression: &Expression,
    file: usize,
    lookup: &dyn Fn(&str) -> Option<Value>,
) -> Option<Value> {
    let all = |list: &[Expression]| -> Option<Vec<Value>> {
        list.iter().map(|expression| value(expression, file, lookup)).collect()
    };
    let content = match &expression.kind {
        ExpressionKind::Number(number) => Content::Number(*number),
        ExpressionKind::Text(text) => Content::Text(text.clone()),
        ExpressionKind::Bool(value) => Content::Bool(*value),
        ExpressionKind::List(list) => Content::List(all(list)?),
        ExpressionKind::Pose(list) => Content::Pose(all(list)?),
        ExpressionKind::Name(name) => return lookup(name),
        ExpressionKind::Call { .. } | ExpressionKind::Computed => return None,
    };
    Some(Value { file, span: expression.span.clone(), name: None, content })
}

/// An argument of a call with its value at the call.
pub(crate) struct Evaluated<'a> {
    pub(crate) name: Option<&'a str>,
    pub(crate) expression: Option<&'a Expression>,
    pub(crate) value: Option<Value>,
}

impl Evaluated<'_> {
    pub(crate) fn number(&self) -> Option<f64> {
        self.value.as_ref()?.number()
    }

    /// The name of an argument that is a variable.
    pub(crate) fn variable(&self) -> Option<&str> {
        if let ExpressionKind::Name(name) = &self.expression?.kind { Some(name) } else { None }
    }
}

pub(crate) fn evaluated<'a>(
    arguments: &'a [Argument],
    file: usize,
    lookup: &dyn Fn(&str) -> Option<Value>,
) -> Vec<Evaluated<'a>> {
    let evaluated = arguments.iter().map(|Argument { name, value: expression }| Evaluated {
        name: name.as_deref(),
        expression: expression.as_ref(),
        value: expression.as_ref().and_then(|expression| value(expression, file, lookup)),
    });
    evaluated.collect()
}
