//! The points of a program and their correction: each point once, where its numbers are written.

use std::collections::{HashMap, HashSet};

use super::expression::{ExpressionKind, Routine, StatementKind, statements};
use super::value::{Content, Evaluated, Value};
use crate::program::CompensationFinding;
use crate::program::compensate::{
    Branch, Commanded, Corrected, Correction, Corrector, External, Moved, correct_points, external_axis_away,
};
use crate::program::flow::At;
use crate::program::left_motions::LeftMotions;
use crate::program::text::{Edit, Span, Text, number_like, rewritten};
use crate::program::{Frames, Target};
use dbbd_model::diagnostic::Diagnostic;

/// A point to which the program moves.
#[derive(Clone, Debug)]
pub struct Point {
    /// The numbers of the point.
    pub(crate) value: Value,
    /// The first statement that moves to the point.
    pub(crate) first_use: Span,
    pub(crate) branch: Branch,
    pub target: Target,
    /// The frames that are active at the point; `None` for axis angles.
    pub(crate) frames: Option<Frames>,
}

/// Writes a corrected point in the language of the program.
type Write = fn(&Corrector, &Point, &Corrected, Text<'_>) -> Result<Vec<Edit>, CompensationFinding>;

#[derive(Clone, Debug)]
pub struct Points {
    write: Write,
    /// The points, in the order of their first use.
    pub points: Vec<Point>,
    /// Uses of points that are not corrected: uses in instructions that are not read, and uses of points that are
    /// computed or in another file.
    pub not_corrected: Vec<Diagnostic>,
    /// Warnings that concern all corrections.
    pub warnings: Vec<Diagnostic>,
    /// The index of each point by the first byte of its literal.
    by_start: HashMap<usize, usize>,
    /// Uses in calls that are not motions, by the first byte of the point's literal.
    other_uses: Vec<(usize, Diagnostic)>,
    /// The first bytes of the statements and arguments that were reported: several ways may lead to one.
    reported: HashSet<usize>,
    /// The motions that stay as they are; a point is the first byte of its literal.
    left: LeftMotions<usize>,
    rewritten: fn(&[Value]) -> &[Value],
}

/// Names of instructions other than the supported motions that matter for points.
pub(crate) struct OtherInstructions {
    /// Starts of the names of motions.
    pub(crate) motions: &'static [&'static str],
    /// Instructions that displace the motions after them.
    pub(crate) displacements: &'static [&'static str],
    /// Starts of the names of instructions whose poses are no points.
    pub(crate) settings: &'static [&'static str],
}

impl Points {
    /// `rewritten` are the parts of a point that a correction rewrites: they must be numbers of the point itself.
    pub(crate) fn new(write: Write, rewritten: fn(&[Value]) -> &[Value]) -> Self {
        let (points, not_corrected, warnings) = (Vec::new(), Vec::new(), Vec::new());
        let (by_start, other_uses, reported) = (HashMap::new(), Vec::new(), HashSet::new());
        let left = LeftMotions::none();
        Self { write, points, not_corrected, warnings, by_start, other_uses, reported, left, rewritten }
    }

    /// Adds a finding about a use that is not corrected, once for each place.
    pub(crate) fn leave(&mut self, file: Text<'_>, span: &Span, why: CompensationFinding) {
        if self.reported.insert(span.start) {
            self.not_corrected.push(file.wrong(span, why));
        }
    }

    /// Leaves a motion as it is, with the points that it alone uses so far.
    ///
    /// # Errors
    /// What the user stated contradicts the program.
    pub(crate) fn leave_motion(
        &mut self,
        file: Text<'_>,
        motion: &Span,
        why: Diagnostic,
    ) -> Result<(), Diagnostic> {
        self.not_corrected.extend(self.left.leave(file, motion, why)?);
        let own = self.points.iter().filter(|point| point.first_use == *motion);
        let line = file.line(motion.start);
        own.for_each(|point| self.left.share(point.value.span.start, line));
        Ok(())
    }

    /// Leaves a point that a motion which stays as it is uses, in this line.
    pub(crate) fn share(&mut self, value: &Value, line: usize) {
        if value.file == 0 {
            self.left.share(value.span.start, line);
        }
    }

    /// Adds the motions to which no way leads, such as those of a routine that is never called.
    pub(crate) fn leave_unreached<'r>(
        &mut self,
        file: Text<'_>,
        routines: impl IntoIterator<Item = &'r Routine>,
        is_motion: fn(&str) -> bool,
        reached: &HashSet<At>,
    ) {
        for (at, statement) in statements(routines) {
            if let StatementKind::Call { name, .. } = &statement.kind
                && is_motion(name)
                && !reached.contains(&at)
            {
                self.leave(file, &statement.span, CompensationFinding::NeverReached);
            }
        }
    }

    /// Warns of all corrections if an external axis of the points, which `external` reads, is not at 0.
    pub(crate) fn warn_of_external_axes(&mut self, file: Text<'_>, external: fn(&Value) -> External) {
        let of_points = self.points.iter().map(|point| {
            let name = point.value.name.as_deref().unwrap_or("inline");
            (name, external(&point.value))
        });
        let away = external_axis_away(of_points);
        self.warnings.extend(away.map(|(at, finding)| file.wrong(&self.points[at].first_use, finding)));
    }

    /// Whether the numbers of a point are written in this file, and as those of this point.
    pub(crate) fn is_own(&self, value: &Value) -> bool {
        value.file == 0 && is_literal(value, self.rewritten)
    }

    /// Adds the point of a motion, with `frames` if it is a pose. A point is not corrected if it is computed or if it
    /// is not written in this file (file 0).
    pub(crate) fn add(
        &mut self,
        file: Text<'_>,
        motion: &Span,
        argument: &Evaluated<'_>,
        taught: Option<(Target, Branch)>,
        frames: impl FnOnce() -> Result<Frames, Diagnostic>,
    ) -> Result<(), Diagnostic> {
        let value = argument.value.clone().filter(|value| self.is_own(value));
        let (Some(value), Some((target, branch))) = (value, taught) else {
            let name = match argument.expression.map(|expression| &expression.kind) {
                Some(ExpressionKind::Name(name) | ExpressionKind::Call { name, .. }) => name.clone(),
                _ => "this point".into(),
            };
            let span = argument.expression.map_or(motion, |expression| &expression.span);
            self.leave(file, span, CompensationFinding::PointElsewhere { name });
            return Ok(());
        };
        let frames = match target {
            Target::Axes(_) => None,
            Target::Pose { .. } => {
                let line = file.line(motion.start);
                Some(frames().inspect_err(|_| self.left.share(value.span.start, line))?)
            }
        };
        let at = *self.by_start.entry(value.span.start).or_insert(self.points.len());
        match self.points.get_mut(at) {
            None => self.points.push(Point { value, first_use: motion.clone(), branch, target, frames }),
            Some(known) if known.frames == frames => {
                if matches!(known.branch, Branch::Nearest | Branch::NearestElse(_)) {
                    known.branch = branch;
                }
            }
            Some(known) => {
                let line = file.line(known.first_use.start);
                self.left.share(value.span.start, file.line(motion.start));
                let name = value.name.unwrap_or_else(|| "inline".into());
                return Err(file.wrong(motion, CompensationFinding::PointTwice { name, line }));
            }
        }
        Ok(())
    }

    /// Notes a statement that is not a supported motion. Points among its arguments are not corrected unless a motion uses
    /// them as well.
    pub(crate) fn other(
        &mut self,
        file: Text<'_>,
        (span, statement): (&Span, &StatementKind),
        arguments: &[Evaluated<'_>],
        names: &OtherInstructions,
        is_point: fn(&Value) -> bool,
    ) {
        let (StatementKind::Call { name: word, .. } | StatementKind::Other(word)) = statement else { return };
        let begins_with = |starts: &[&str]| starts.iter().any(|start| word.starts_with(start));
        if names.displacements.contains(&word.as_str()) {
            self.leave(file, span, CompensationFinding::Displacing { word: word.clone() });
            return;
        }
        if matches!(statement, StatementKind::Other(_)) && begins_with(names.motions) {
            self.leave(file, span, CompensationFinding::NotRead { word: word.clone() });
        }
        if begins_with(names.settings) {
            return;
        }
        let mut has_point = false;
        for argument in arguments {
            let (Some(expression), Some(value)) = (argument.expression, &argument.value) else { continue };
            if value.file == 0 && is_point(value) {
                has_point = true;
                let name = value.name.clone().unwrap_or_else(|| "this point".into());
                let finding = CompensationFinding::PointOfOtherCall { name, call: word.clone() };
                if self.reported.insert(expression.span.start) {
                    self.other_uses.push((value.span.start, file.wrong(&expression.span, finding)));
                }
            }
        }
        if !has_point && !arguments.is_empty() && begins_with(names.motions) {
            self.leave(file, span, CompensationFinding::NotRead { word: word.clone() });
        }
    }

    /// Completes the points after the last statement: reports the points that are only used by calls that are no
    /// motions, and leaves those that motions which stay as they are use too.
    ///
    /// # Errors
    /// Nothing of the program would be right.
    pub(crate) fn completed(mut self, file: Text<'_>) -> Result<Self, Diagnostic> {
        for (start, line) in self.left.shared() {
            let Some(at) = self.points.iter().position(|point| point.value.span.start == *start) else {
                continue;
            };
            let Point { value, first_use, .. } = self.points.remove(at);
            let name = value.name.unwrap_or_else(|| "inline".into());
            self.not_corrected.push(file.wrong(&first_use, CompensationFinding::PointShared { name, line }));
        }
        let has_pose = self.points.iter().any(|point| point.frames.is_some());
        if let Some(why) = self.left.nothing_right(!self.points.is_empty(), has_pose) {
            return Err(why.clone());
        }
        let other_uses = std::mem::take(&mut self.other_uses).into_iter();
        let only_there = other_uses.filter(|(start, _)| !self.by_start.contains_key(start));
        self.not_corrected.extend(only_there.map(|(_, finding)| finding));
        Ok(self)
    }

    /// The program with corrected points.
    ///
    /// # Errors
    /// One finding for each point that cannot be corrected.
    pub fn compensate(
        &self,
        file: Text<'_>,
        correction: Correction<'_>,
    ) -> Result<(String, Vec<Moved>), Vec<Diagnostic>> {
        let mut edits = Vec::new();
        let moved = correct_points(correction, &self.points, |corrector, point| {
            let wrong = |why: CompensationFinding| file.wrong(&point.value.span, why);
            let frames = point.frames.as_ref();
            let commanded = Commanded { target: &point.target, frames, branch: point.branch };
            let corrected = corrector.correct(commanded).map_err(wrong)?;
            edits.extend((self.write)(corrector, point, &corrected, file).map_err(wrong)?);
            let name = point.value.name.clone().unwrap_or_else(|| "inline".into());
            let line = file.line(point.first_use.start);
            Ok(Moved::new(name, line, &corrected, None))
        })?;
        Ok((rewritten(file.text, edits), moved))
    }
}

/// Whether the numbers of a point that are rewritten stand in its own literal: numbers of a variable may be used elsewhere as well.
fn is_literal(value: &Value, rewritten: fn(&[Value]) -> &[Value]) -> bool {
    let (Content::List(parts) | Content::Pose(parts)) = &value.content else { return true };
    rewritten(parts).iter().all(|part| part.is_inside(value) && is_literal(part, |parts| parts))
}

/// The elements of a point's value, of which there must be `N`.
pub(crate) fn elements<const N: usize>(value: &Value) -> Result<&[Value; N], CompensationFinding> {
    value.elements().ok_or(CompensationFinding::PointShape { numbers: N })
}

/// Edits that replace the numbers of a list, each with at least `min_decimals` decimals, and the numbers as they are written
/// then.
pub(crate) fn replaced<const N: usize>(
    list: &Value,
    new: &[f64; N],
    file: Text<'_>,
    min_decimals: usize,
) -> Result<(Vec<Edit>, [f64; N]), CompensationFinding> {
    let mut written = *new;
    let mut edits = Vec::with_capacity(N);
    for ((old, new), written) in elements::<N>(list)?.iter().zip(new).zip(&mut written) {
        let text = number_like(file.text.get(old.span.clone()).unwrap_or("0"), *new, min_decimals);
        *written = text.parse().map_err(|_| CompensationFinding::PointShape { numbers: N })?;
        edits.push((old.span.clone(), text));
    }
    Ok((edits, written))
}
