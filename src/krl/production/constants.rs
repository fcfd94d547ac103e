//! Points and frames that have one value: those of the `.dat` files, and those that the `.src` sets once.

use std::collections::HashMap;

use super::line::{Line, lines};
use super::{Number, Origin, Text};
use crate::diag::Diagnostic;
use crate::krl::lexer::Token;
use crate::krl::syntax::type_of_declaration;
use crate::krl::syntax::{Expression, ExpressionKind, Field, Part, Place, Span};
use crate::model::Pose;

/// A variable, or an element of an array.
pub(super) type Key = (String, Option<i64>);

/// A value and where it stands.
#[derive(Clone, Debug)]
pub(super) struct Constant {
    pub(super) value: Expression,
    pub(super) origin: Origin,
}

/// Values by name.
#[derive(Default)]
pub(super) struct Constants {
    values: HashMap<Key, Constant>,
    /// Elements of each array, in order.
    elements: HashMap<String, Vec<i64>>,
    /// What the `.src` sets more than once, or to a value that is computed, and where.
    varying: HashMap<String, Span>,
}

/// Types of a declaration whose value matters here.
const TYPES: &[&str] = &["E6POS", "POS", "FRAME", "E6AXIS", "AXIS", "FDAT"];

impl Constants {
    pub(super) fn get(&self, key: &Key) -> Option<&Constant> {
        self.values.get(key)
    }

    /// Where a name is set to something that is not known beforehand.
    pub(super) fn varies(&self, name: &str) -> Option<&Span> {
        self.varying.get(name)
    }

    /// The elements of an array that have a value.
    pub(super) fn elements(&self, name: &str) -> &[i64] {
        self.elements.get(name).map_or(&[], Vec::as_slice)
    }

    fn insert(&mut self, key: Key, value: Expression, origin: Origin) {
        if let Some(index) = key.1 {
            let elements = self.elements.entry(key.0.clone()).or_default();
            if elements.last() != Some(&index) {
                elements.push(index);
            }
        }
        self.values.insert(key, Constant { value, origin });
    }

    /// Takes the points and frames of a `.dat` file; other lines are passed over.
    pub(super) fn add_data(&mut self, file: Text<'_>, origin: Origin) -> Result<(), Diagnostic> {
        for line in lines(file) {
            let Some((left, right)) = line.code().split_once('=') else { continue };
            if left.contains(',') || !right.trim_start().starts_with('{') {
                continue; // more dimensions than a point has, or no structure
            }
            let declares =
                matches!(line.word.as_str(), "DECL" | "GLOBAL" | "CONST") || type_of_declaration(&line.word);
            let known = |word: &str| TYPES.iter().any(|name| word.eq_ignore_ascii_case(name));
            if (declares || line.word == "FDAT") && !left.split_ascii_whitespace().any(known) {
                continue;
            }
            let mut parser = line.parser(file)?;
            if let Token::Name(_) = parser.ahead(1) {
                while let (Token::Name(_), Token::Name(_)) = (parser.peek(), parser.ahead(1)) {
                    parser.advance();
                }
            }
            let place = parser.place()?;
            parser.sign("=")?;
            let value = parser.expression()?;
            parser.line_end()?;
            if let Some(key) = key(&place) {
                self.insert(key, value, origin);
            }
        }
        Ok(())
    }

    /// Takes what a line of the `.src` sets: `NAME={..}` once is a value, all else makes the name vary.
    pub(super) fn add_assignment(&mut self, file: Text<'_>, line: &Line<'_>) {
        let rest = line.code().get(line.word.len()..).unwrap_or("").trim_start();
        if line.word.is_empty() || line.word.starts_with('$') || !rest.starts_with(['=', '[', '.']) {
            return;
        }
        let assigned = line.parser(file).and_then(|mut parser| {
            let place = parser.place()?;
            parser.sign("=")?;
            let value = parser.expression()?;
            parser.line_end()?;
            Ok((place, value))
        });
        let constant = assigned.ok().and_then(|(place, value)| {
            matches!(value.kind, ExpressionKind::Aggregate(_)).then_some((key(&place)?, value))
        });
        match constant {
            Some((key, value)) if !self.values.contains_key(&key) => self.insert(key, value, Origin::Source),
            _ => {
                self.varying.insert(line.word.clone(), line.span.clone());
            }
        }
    }
}

/// The variable or element that a place names, where its index is a number.
pub(super) fn key(place: &Place) -> Option<Key> {
    match place.parts.as_slice() {
        [] => Some((place.name.clone(), None)),
        [Part::Element(index)] => match index.kind {
            ExpressionKind::Int(index) => Some((place.name.clone(), Some(index))),
            _ => None,
        },
        _ => None,
    }
}

/// A component that is a number.
pub(super) fn number(fields: &[Field], name: &str) -> Result<Number, String> {
    let Some(field) = fields.iter().find(|field| field.name == name) else {
        return Err(format!("{name} is missing"));
    };
    let value = match field.value.kind {
        ExpressionKind::Real(value) => value,
        ExpressionKind::Int(value) => value as f64,
        _ => return Err(format!("{name} is no number")),
    };
    Ok(Number { value, span: field.value.span.clone() })
}

/// A component that is a whole number, where it is given, and its bytes.
pub(super) fn whole(fields: &[Field], name: &str) -> Result<Option<(i64, Span)>, String> {
    match fields.iter().find(|field| field.name == name).map(|field| &field.value) {
        None => Ok(None),
        Some(Expression { kind: ExpressionKind::Int(value), span }) => Ok(Some((*value, span.clone()))),
        Some(_) => Err(format!("{name} is no whole number")),
    }
}

/// The frame that an aggregate gives.
pub(super) fn frame(value: &Expression) -> Result<Pose, String> {
    let ExpressionKind::Aggregate(fields) = &value.kind else { return Err("this is no frame".into()) };
    let at = |name: &str| number(fields, name).map(|number| number.value);
    Ok(Pose::from_kuka([at("X")?, at("Y")?, at("Z")?], [at("A")?, at("B")?, at("C")?]))
}
