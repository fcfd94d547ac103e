//! The points of a module, and new numbers for them.

use std::collections::HashMap;

use super::instruction::{Instruction, motion};
use super::parser::{Module, parse};
use super::program::declared;
use crate::catalogue::CompensationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::Motion;
use crate::program::compensate::{Branch, Corrected, Corrector};
use crate::program::script::points::{Point, Points, Taught, Vocabulary, numbers};
use crate::program::script::statement::{Kind, Statement};
use crate::program::script::value::Value;
use crate::program::text::{Edit, Text};
use crate::robot::Pose;

/// Fewest decimals of a length, an axis angle and a part of a quaternion.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 5;
const DECIMALS_TURN: usize = 8;

const WORDS: Vocabulary = Vocabulary {
    moving: &["MOVE", "TRIGG", "SEARCH", "ARC", "SPOT", "PAINT", "DISP"],
    displacing: &["PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET"],
    setting: &[],
};

/// The points of a module; `config` is a module that holds tools and work objects.
pub fn read(text: Text<'_>, config: Option<Text<'_>>) -> Result<Points, Diagnostic> {
    let module = parse(text, 0)?;
    let config = config.map(|config| parse(config, 1)).transpose()?;
    let mut points = Points::new(write);
    let statements = || module.routines.iter().flat_map(|(routine, _)| &routine.body);
    let set: HashMap<&str, usize> = statements().filter_map(|statement| set(statement, text)).collect();
    for statement in statements() {
        take(statement, &module, config.as_ref(), &set, &mut points, text)?;
    }
    Ok(points.completed())
}

/// The name that a statement gives another value, or a part of one, and its line.
fn set<'s>(statement: &'s Statement, text: Text<'_>) -> Option<(&'s str, usize)> {
    match &statement.kind {
        Kind::Assign { name, .. } | Kind::Other(name) => Some((name, text.line(statement.span.start))),
        _ => None,
    }
}

fn take(
    statement: &Statement,
    module: &Module,
    config: Option<&Module>,
    set: &HashMap<&str, usize>,
    points: &mut Points,
    text: Text<'_>,
) -> Result<(), Diagnostic> {
    let lookup = |name: &str| {
        let own = declared(module, name, 0);
        own.or_else(|| declared(config?, name, 1)).or_else(|| super::literal::predefined(name))
    };
    let Some(instruction) = motion(statement) else {
        let point = |expression: &_| Instruction::point(expression, 0, &lookup).map(|(value, _)| value);
        points.other(text, statement, &WORDS, point);
        return Ok(());
    };
    // What a routine declares itself is read as computed elsewhere.
    if let Some(why) = instruction.computed(|name| lookup(name).and(set.get(name).copied())) {
        return Err(text.wrong(&statement.span, why));
    }
    for expression in [instruction.through, Some(instruction.to)].into_iter().flatten() {
        let taught = Instruction::point(expression, 0, &lookup).map(|(value, taught)| {
            let branch = match taught.configuration {
                Some(configuration) if instruction.motion == Motion::Ptp => {
                    Branch::ByQuadrants(configuration)
                }
                _ => Branch::Nearest,
            };
            Taught { value, target: taught.target, branch }
        });
        let frames = || instruction.frames(0, &lookup).map_err(|why| text.wrong(&statement.span, why));
        points.visit(text, &statement.span, expression, taught, frames)?;
    }
    Ok(())
}

fn write(
    corrector: &Corrector,
    point: &Point,
    corrected: &Corrected,
    text: Text<'_>,
) -> Result<Vec<Edit>, CompensationFinding> {
    let [x, y, z, a, b, c] = corrected.numbers;
    let Some(frames) = &point.frames else {
        let [axes, _] = parts(&point.value)?;
        return Ok(numbers(axes, &corrected.numbers, text, DECIMALS_DEG)?.0);
    };
    let [place, turn, configuration, _] = parts(&point.value)?;
    let (mut edits, place) = numbers(place, &[x, y, z], text, DECIMALS_MM)?;
    let taught: [f64; 4] = turn.numbers().ok_or(CompensationFinding::PointShape { numbers: 4 })?;
    let new = Pose::from_kuka([x, y, z], [a, b, c]).quaternion();
    let along: f64 = taught.iter().zip(new).map(|(taught, new)| taught * new).sum();
    let turned = new.map(|part| if along < 0.0 { -part } else { part });
    let (turns, turn) = numbers(turn, &turned, text, DECIMALS_TURN)?;
    edits.extend(turns);
    let printed = Pose::from_quaternion(place, turn).ok_or(CompensationFinding::PointShape { numbers: 4 })?;
    let quadrants = corrector.quadrants(corrected, &printed, frames)?;
    for (old, new) in parts::<4>(configuration)?.iter().zip(quadrants) {
        if old.number() != Some(f64::from(new)) {
            edits.push((old.span.clone(), new.to_string()));
        }
    }
    Ok(edits)
}

fn parts<const N: usize>(value: &Value) -> Result<&[Value; N], CompensationFinding> {
    value.parts().ok_or(CompensationFinding::PointShape { numbers: N })
}
