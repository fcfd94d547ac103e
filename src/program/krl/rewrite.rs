//! Rewrites the points of a program for an identified robot: only their numbers change, every other byte stays.

use super::data::Origin;
use super::points::{Files, PointProgram, TaughtPoint};
use crate::catalogue::CompensationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::compensate::{Branch, Commanded, Corrected, Corrector};
use crate::program::rewrite::{self, Moved};
use crate::program::text::{Edit, Span, Text, number_like, rewritten};
use crate::program::{Frames, Target};
use crate::robot::{Pose, Robot};

/// Fewest decimals of a rewritten length and angle: those that were taught with fewer get more.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 4;

/// A program with corrected points.
#[derive(Clone, Debug)]
pub struct Compensated {
    pub source: String,
    /// The `.dat`, where there was one.
    pub data: Option<String>,
    /// The points in the order in which the program first goes there.
    pub moved: Vec<Moved>,
}

/// Corrects a program for `robot`, an identified one that carries its nominal robot. No commanded point may move by more
/// than `limit_mm`.
///
/// # Errors
/// Every point that cannot be corrected; not empty.
pub fn compensate(
    files: Files<'_>,
    program: &PointProgram,
    robot: &Robot,
    limit_mm: f64,
) -> Result<Compensated, Vec<Diagnostic>> {
    let (mut source_edits, mut data_edits) = (Vec::new(), Vec::new());
    let moved = rewrite::points(robot, limit_mm, &program.points, |corrector, point| {
        let (text, edits) = match (point.origin, files.data) {
            (Origin::Data, Some(data)) => (data, &mut data_edits),
            _ => (files.source, &mut source_edits),
        };
        let rewritten = rewrite(corrector, point, text, edits);
        let (Corrected { shift_mm, turn_deg, .. }, turn_bits) =
            rewritten.map_err(|why| text.wrong(&point.span, why))?;
        let line = files.source.line(point.used.start);
        Ok(Moved { name: point.name.clone(), line, shift_mm, turn_deg, turn_bits })
    })?;
    let source = rewritten(files.source.text, source_edits);
    let data = files.data.map(|data| rewritten(data.text, data_edits));
    Ok(Compensated { source, data, moved })
}

/// Adds the edits of a point; its correction, and its turn bits before and after where they change.
fn rewrite(
    corrector: &mut Corrector,
    point: &TaughtPoint,
    text: Text<'_>,
    edits: &mut Vec<Edit>,
) -> Result<(Corrected, Option<[u8; 2]>), CompensationFinding> {
    let branch = if point.by_ptp { Branch::ByStatusAndTurn } else { Branch::Nearest };
    let frames = point.frames.as_ref();
    let corrected = corrector.correct(Commanded { target: &point.target, frames, branch })?;
    let lengths = if matches!(point.target, Target::Axes(_)) { 0 } else { 3 };
    let mut values = corrected.numbers;
    let mut turn_bits = None;
    let mut written = Vec::with_capacity(7);
    for (at, (span, value)) in point.numbers.iter().zip(&mut values).enumerate() {
        let fewest = if at < lengths { DECIMALS_MM } else { DECIMALS_DEG };
        let new = number_like(text.text.get(span.clone()).unwrap_or(""), *value, fewest);
        *value = new.parse().unwrap_or(*value);
        written.push((span.clone(), new));
    }
    if let (Branch::ByStatusAndTurn, Some(frames), Some((old, span))) = (branch, frames, turn(point)) {
        let new = new_turn(corrector, &corrected, values, frames)?;
        if i64::from(new) != old {
            turn_bits = u8::try_from(old).ok().map(|old| [old, new]);
            written.push((span.clone(), whole_like(text.text.get(span).unwrap_or(""), new)));
        }
    }
    edits.extend(written);
    Ok((corrected, turn_bits))
}

/// The turn bits of a pose that has status and turn, and their bytes.
fn turn(point: &TaughtPoint) -> Option<(i64, Span)> {
    match point.target {
        Target::Pose { status: Some(_), turn: Some(turn), .. } => Some((turn, point.turn.clone()?)),
        _ => None,
    }
}

fn new_turn(
    corrector: &Corrector,
    corrected: &Corrected,
    [x, y, z, a, b, c]: [f64; 6],
    frames: &Frames,
) -> Result<u8, CompensationFinding> {
    corrector.turn(corrected, &Pose::from_kuka([x, y, z], [a, b, c]), frames)
}

/// A whole number in the form in which another was written: decimal, `'B..'` or `'H..'`.
fn whole_like(written: &str, value: u8) -> String {
    let width = written.len().saturating_sub(3);
    match written.as_bytes() {
        [b'\'', b'B' | b'b', ..] => format!("'B{value:0width$b}'"),
        [b'\'', b'H' | b'h', ..] => format!("'H{value:0width$X}'"),
        _ => value.to_string(),
    }
}
