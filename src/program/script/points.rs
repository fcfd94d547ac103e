//! Points of a program that are rewritten: each once, where its numbers are written.

use std::collections::HashMap;

use super::statement::{Kind as StatementKind, Statement};
use super::value::{Expression, Kind, Value};
use crate::catalogue::CompensationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::compensate::{Branch, Commanded, Corrected, Corrector};
use crate::program::rewrite::{self, Moved};
use crate::program::text::{Edit, Span, Text, number_like, rewritten};
use crate::program::{Frames, Target};
use crate::robot::Robot;

/// A point to which the program moves.
#[derive(Clone, Debug)]
pub struct Point {
    /// Where its numbers are.
    pub(crate) value: Value,
    /// The statement that goes there first.
    pub(crate) used: Span,
    pub(crate) branch: Branch,
    pub target: Target,
    /// When the robot goes there; an axis position needs none.
    pub(crate) frames: Option<Frames>,
}

/// The new text of a corrected point.
pub(crate) type Write =
    fn(&Corrector, &Point, &Corrected, Text<'_>) -> Result<Vec<Edit>, CompensationFinding>;

/// The points of a program in the order in which its text goes there.
#[derive(Clone, Debug)]
pub struct Points {
    /// As the language writes one.
    write: Write,
    pub points: Vec<Point>,
    /// Motions that are not to a point of this file.
    pub left: Vec<Diagnostic>,
    found: HashMap<usize, usize>,
    /// Points of calls that are no motions.
    others: Vec<OtherUse>,
}

/// A point in a call that is no motion.
#[derive(Clone, Debug)]
struct OtherUse {
    at: usize,
    left: Diagnostic,
}

/// What instructions that are no motions mean for the points.
pub(crate) struct Vocabulary {
    /// Beginnings of the names of instructions that move.
    pub(crate) moving: &'static [&'static str],
    /// Instructions after which motions are displaced.
    pub(crate) displacing: &'static [&'static str],
    /// Beginnings of the names of instructions whose poses are no points.
    pub(crate) setting: &'static [&'static str],
}

/// What an expression teaches.
pub(crate) struct Taught {
    pub(crate) value: Value,
    pub(crate) target: Target,
    pub(crate) branch: Branch,
}

impl Points {
    pub(crate) fn new(write: Write) -> Self {
        Self { write, points: Vec::new(), left: Vec::new(), found: HashMap::new(), others: Vec::new() }
    }

    /// Takes the point of a motion, `frames` where it is a pose. One that is computed, or not written in this file (the
    /// file 0), is left.
    pub(crate) fn visit(
        &mut self,
        file: Text<'_>,
        motion: &Span,
        to: &Expression,
        taught: Option<Taught>,
        frames: impl FnOnce() -> Result<Frames, Diagnostic>,
    ) -> Result<(), Diagnostic> {
        let Some(Taught { value, target, branch }) = taught.filter(|taught| taught.value.file == 0) else {
            let name = match &to.kind {
                Kind::Name(name) | Kind::Call(name) => name.clone(),
                _ => "this point".into(),
            };
            self.left.push(file.wrong(&to.span, CompensationFinding::PointElsewhere { name }));
            return Ok(());
        };
        let frames = match target {
            Target::Axes(_) => None,
            Target::Pose { .. } => Some(frames()?),
        };
        self.add(Point { value, used: motion.clone(), branch, target, frames }, file)
    }

    /// Takes a statement that is no motion: the points that it names, `point` of an expression, are left where no motion goes
    /// to them.
    pub(crate) fn other(
        &mut self,
        file: Text<'_>,
        statement: &Statement,
        words: &Vocabulary,
        point: impl Fn(&Expression) -> Option<Value>,
    ) {
        let begins = |word: &str, with: &[&str]| with.iter().any(|start| word.starts_with(start));
        let (word, arguments) = match &statement.kind {
            StatementKind::Call { name, arguments } => (name, &arguments[..]),
            StatementKind::Other(word) => (word, &[][..]),
            _ => return,
        };
        if words.displacing.contains(&word.as_str()) {
            let word = word.clone();
            self.left.push(file.wrong(&statement.span, CompensationFinding::Displacing { word }));
            return;
        }
        if matches!(statement.kind, StatementKind::Other(_)) && begins(word, words.moving) {
            let word = word.clone();
            self.left.push(file.wrong(&statement.span, CompensationFinding::NotRead { word }));
        }
        if begins(word, words.setting) {
            return;
        }
        for expression in arguments.iter().filter_map(|argument| argument.value.as_ref()) {
            let Some(value) = point(expression).filter(|value| value.file == 0) else { continue };
            let name = value.name.clone().unwrap_or_else(|| "this point".into());
            let finding = CompensationFinding::PointOfOtherCall { name, call: word.clone() };
            self.others.push(OtherUse { at: value.span.start, left: file.wrong(&expression.span, finding) });
        }
    }

    /// Leaves the points that only calls which are no motions name.
    pub(crate) fn completed(mut self) -> Self {
        let others = std::mem::take(&mut self.others).into_iter();
        self.left.extend(others.filter(|other| !self.found.contains_key(&other.at)).map(|other| other.left));
        self
    }

    /// Takes a point of the program's own file.
    fn add(&mut self, point: Point, file: Text<'_>) -> Result<(), Diagnostic> {
        let at = *self.found.entry(point.value.span.start).or_insert(self.points.len());
        match self.points.get_mut(at) {
            None => self.points.push(point),
            Some(before) if before.frames == point.frames => {
                if before.branch == Branch::Nearest {
                    before.branch = point.branch;
                }
            }
            Some(before) => {
                let line = file.line(before.used.start);
                let twice = CompensationFinding::PointTwice { name: point.name(), line };
                return Err(file.wrong(&point.used, twice));
            }
        }
        Ok(())
    }

    /// The program with corrected points, none moved by more than `limit_mm`, and what was moved.
    ///
    /// # Errors
    /// Every point that cannot be corrected; not empty.
    pub fn compensate(
        &self,
        file: Text<'_>,
        robot: &Robot,
        limit_mm: f64,
    ) -> Result<(String, Vec<Moved>), Vec<Diagnostic>> {
        let mut edits = Vec::new();
        let moved = rewrite::points(robot, limit_mm, &self.points, |corrector, point| {
            let wrong = |why: CompensationFinding| file.wrong(&point.value.span, why);
            let frames = point.frames.as_ref();
            let commanded = Commanded { target: &point.target, frames, branch: point.branch };
            let corrected = corrector.correct(commanded).map_err(wrong)?;
            edits.extend((self.write)(corrector, point, &corrected, file).map_err(wrong)?);
            let Corrected { shift_mm, turn_deg, .. } = corrected;
            let line = file.line(point.used.start);
            Ok(Moved { name: point.name(), line, shift_mm, turn_deg, turn_bits: None })
        })?;
        Ok((rewritten(file.text, edits), moved))
    }
}

impl Point {
    fn name(&self) -> String {
        self.value.name.clone().unwrap_or_else(|| "inline".into())
    }
}

/// New numbers in place of those of a list, each with at least so many decimals; and what is then written there.
pub(crate) fn numbers<const N: usize>(
    list: &Value,
    new: &[f64; N],
    file: Text<'_>,
    fewest: usize,
) -> Result<(Vec<Edit>, [f64; N]), CompensationFinding> {
    let old = list.parts::<N>().ok_or(CompensationFinding::PointShape { numbers: N })?;
    let mut written = *new;
    let mut edits = Vec::with_capacity(N);
    for ((old, new), written) in old.iter().zip(new).zip(&mut written) {
        let text = number_like(file.text.get(old.span.clone()).unwrap_or("0"), *new, fewest);
        *written = text.parse().map_err(|_| CompensationFinding::PointShape { numbers: N })?;
        edits.push((old.span.clone(), text));
    }
    Ok((edits, written))
}
