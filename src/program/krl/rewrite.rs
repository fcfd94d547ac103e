//! Rewrites the points of a program for an identified robot: only their numbers change, every other byte stays.

use super::data::Origin;
use super::emit::fixed;
use super::points::{Files, PointProgram, TaughtPoint};
use super::syntax::{Span, Text};
use crate::catalogue::CompensationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::compensate::{Branch, Commanded, Corrected, Corrector};
use crate::program::{Frames, Target};
use crate::robot::{Pose, Robot};

/// Fewest decimals of a rewritten length and angle: those that were taught with fewer get more.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 4;

/// A point that was rewritten.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Moved {
    /// `inline` for one without.
    pub name: String,
    /// The line of the `.src` that goes there first.
    pub line: usize,
    /// As [`Corrected::shift_mm`].
    pub shift_mm: f64,
    /// As [`Corrected::turn_deg`].
    pub turn_deg: f64,
    /// KUKA's turn bits before and after, where an axis came to the other side of zero.
    pub turn_bits: Option<[u8; 2]>,
}

/// A program with corrected points.
#[derive(Clone, Debug)]
pub struct Compensated {
    pub source: String,
    /// The `.dat`, where there was one.
    pub data: Option<String>,
    /// The points in the order in which the program first goes there.
    pub moved: Vec<Moved>,
}

/// New text for some bytes.
type Edit = (Span, String);

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
    let mut corrector = Corrector::new(robot, limit_mm);
    let (mut source_edits, mut data_edits) = (Vec::new(), Vec::new());
    let (mut moved, mut refused) = (Vec::new(), Vec::new());
    let ends: Vec<usize> = files.source.text.match_indices('\n').map(|(at, _)| at).collect();
    for point in &program.points {
        let (text, edits) = match (point.origin, files.data) {
            (Origin::Data, Some(data)) => (data, &mut data_edits),
            _ => (files.source, &mut source_edits),
        };
        match rewrite(&mut corrector, point, text, edits) {
            Ok((Corrected { shift_mm, turn_deg, .. }, turn_bits)) => {
                let line = ends.partition_point(|end| *end < point.used.start) + 1;
                moved.push(Moved { name: point.name.clone(), line, shift_mm, turn_deg, turn_bits });
            }
            Err(why) => refused.push(text.wrong(&point.span, why)),
        }
    }
    if !refused.is_empty() {
        return Err(refused);
    }
    let source = rewritten(files.source.text, source_edits);
    let data = files.data.map(|data| rewritten(data.text, data_edits));
    Ok(Compensated { source, data, moved })
}

/// Adds the edits of a point; its correction, and its turn bits before and after where they change.
fn rewrite(
    corrector: &mut Corrector<'_>,
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
    corrector: &Corrector<'_>,
    corrected: &Corrected,
    [x, y, z, a, b, c]: [f64; 6],
    frames: &Frames,
) -> Result<u8, CompensationFinding> {
    corrector.turn(corrected, &Pose::from_kuka([x, y, z], [a, b, c]), frames)
}

/// A number with at least the decimals of another and `fewest` of them.
fn number_like(written: &str, value: f64, fewest: usize) -> String {
    let decimals = written
        .split_once('.')
        .map_or(0, |(_, tail)| tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len()));
    fixed(value, decimals.clamp(fewest, 9))
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

/// The text with the edits, which do not overlap.
fn rewritten(text: &str, mut edits: Vec<Edit>) -> String {
    edits.sort_by_key(|(span, _)| span.start);
    let mut out = String::with_capacity(text.len() + 4 * edits.len());
    let mut at = 0;
    for (span, new) in edits {
        out.push_str(text.get(at..span.start).unwrap_or(""));
        out.push_str(&new);
        at = span.end;
    }
    out.push_str(text.get(at..).unwrap_or(""));
    out
}
