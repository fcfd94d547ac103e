//! The positions of a listing: their frames, configuration and numbers.

use super::operand::number;
use crate::program::Target;
use crate::program::compensate::External;
use crate::program::lexer::Token;
use crate::program::script::value::{Content, Value};
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;
use dbbd_model::robot::inverse::FanucConfiguration;

/// X, Y, Z in mm and W, P, R in degrees: rotations about the fixed X, Y and Z, which are KUKA's C, B and A.
pub(super) fn pose([x, y, z, w, p, r]: [f64; 6]) -> Pose {
    Pose::from_kuka([x, y, z], [r, p, w])
}

/// Converts X, Y, Z, A, B, C into X, Y, Z, W, P, R, and the other way round.
pub(super) fn swapped([x, y, z, a, b, c]: [f64; 6]) -> [f64; 6] {
    [x, y, z, c, b, a]
}

/// The target of a position, with its configuration and frame numbers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Taught {
    pub(super) target: Target,
    pub(super) configuration: Option<FanucConfiguration>,
    /// The numbers of the position's tool and user frame; `None` for the frame that is selected when the robot moves
    /// there.
    pub(super) frames: [Option<u32>; 2],
}

/// Reads a position as it is parsed: `[[user frame, tool], config, numbers, external axes]`.
pub(super) fn taught(value: &Value) -> Option<Taught> {
    let [frames, config, numbers, _] = value.elements()?;
    let [user, tool] = frames.elements()?;
    let frame = |value: &Value| value.number().map(|number| number as u32);
    let configuration = if let Content::Text(config) = &config.content { config.parse().ok() } else { None };
    let six: [f64; 6] = numbers.numbers()?;
    let target = if matches!(numbers.content, Content::Pose(_)) {
        Target::pose(&pose(six))
    } else {
        Target::Axes(six)
    };
    Some(Taught { target, configuration, frames: [frame(tool), frame(user)] })
}

/// The frame that a position holds.
pub(super) fn frame(value: &Value) -> Option<Pose> {
    let [_, _, numbers, _] = value.elements()?;
    matches!(numbers.content, Content::Pose(_)).then(|| numbers.numbers().map(pose))?
}

/// The extended axes of a position, and the axes of a second group.
pub(super) fn external(value: &Value) -> External {
    let list = value.list().and_then(|parts| parts.last()?.list()).unwrap_or_default();
    std::array::from_fn(|at| list.get(at).and_then(Value::number))
}

const POSE: [&str; 6] = ["X", "Y", "Z", "W", "P", "R"];
const AXES: [&str; 6] = ["J1", "J2", "J3", "J4", "J5", "J6"];
const EXTENDED: [&str; 3] = ["E1", "E2", "E3"];

/// Parses the positions, each with its name `P[n]`. A position that cannot be read has no value.
pub(super) fn positions(tokens: &mut Tokens<'_>, file: usize) -> Vec<(String, Value)> {
    let mut positions = Vec::new();
    while *tokens.peek() != Token::End {
        let start = tokens.position();
        match position(tokens, file) {
            Ok(found) => positions.push(found),
            Err(_) => {
                tokens.go_to(start);
                while !matches!(tokens.next(), Token::Sign("}") | Token::End) {}
                tokens.accept(";");
            }
        }
    }
    positions
}

/// A number with its name and unit.
type Named = (String, Value);

fn position(tokens: &mut Tokens<'_>, file: usize) -> Result<(String, Value), Diagnostic> {
    let start = tokens.position();
    tokens.expect_name("P")?;
    tokens.expect("[")?;
    let Token::Real(number) = tokens.next() else { return Err(tokens.expected("a number")) };
    let name = format!("P[{number}]");
    tokens.expect("]")?;
    tokens.expect("{")?;
    let value = |content| Value { file, span: 0..0, name: None, content };
    let (mut frames, mut config) = (vec![], value(Content::Text(String::new())));
    let (mut own, mut second): (Vec<Named>, Vec<Named>) = (Vec::new(), Vec::new());
    let mut group = String::new();
    while !tokens.accept("}") {
        let (word, _) = tokens.name()?;
        let is_first = group == "GP1";
        if word.starts_with("GP") {
            tokens.expect(":")?;
            group = word;
        } else if word == "UF" || word == "UT" {
            tokens.expect(":")?;
            let span = tokens.span();
            let frame = if tokens.accept_name("F") {
                Value { span, ..value(Content::Text("F".into())) }
            } else {
                number_value(tokens, file)?
            };
            frames.extend(is_first.then_some(frame));
        } else if word == "CONFIG" {
            tokens.expect(":")?;
            let span = tokens.span();
            let Token::Text(text) = tokens.next() else { return Err(tokens.expected("a configuration")) };
            if is_first {
                config = Value { span, ..value(Content::Text(text)) };
            }
        } else {
            tokens.expect("=")?;
            let number = number_value(tokens, file)?;
            // The unit: mm or deg.
            tokens.name()?;
            if is_first { own.push((word, number)) } else { second.push((word, number)) }
        }
        tokens.accept(",");
    }
    let span = tokens.since(start);
    tokens.accept(";");
    let of = |names: &[&str]| -> Option<Vec<Value>> {
        let find = |name: &&str| own.iter().find(|(known, _)| known == name).map(|(_, value)| value.clone());
        names.iter().map(find).collect()
    };
    let numbers = of(&POSE).map(Content::Pose).or_else(|| of(&AXES).map(Content::List));
    let Some(numbers) = numbers.filter(|_| frames.len() == 2) else {
        return Err(tokens.expected("X, Y, Z, W, P, R or J1 to J6 of the first group"));
    };
    let extended = EXTENDED.iter().filter_map(|name| own.iter().find(|(known, _)| known == name));
    let external = extended.chain(&second).map(|(_, value)| value.clone()).collect();
    let parts = vec![value(Content::List(frames)), config, value(numbers), value(Content::List(external))];
    // Each position has all its parts between the brackets.
    let parts = parts
        .into_iter()
        .map(|part| if part.span == (0..0) { Value { span: span.clone(), ..part } } else { part });
    let content = Content::List(parts.collect());
    Ok((name.clone(), Value { file, span, name: Some(name), content }))
}

fn number_value(tokens: &mut Tokens<'_>, file: usize) -> Result<Value, Diagnostic> {
    let start = tokens.position();
    let found = number(tokens)?;
    Ok(Value { file, span: tokens.since(start), name: None, content: Content::Number(found) })
}
