//! Corrects the points of a program for an identified robot. Only their numbers change; every other byte stays.

use super::data::Origin;
use super::points::{Files, PointProgram, TaughtPoint};
use crate::program::CompensationFinding;
use crate::program::Target;
use crate::program::compensate::{
    Branch, Commanded, Corrected, Correction, Corrector, Moved, correct_points,
};
use crate::program::text::{Edit, Text, number_like, rewritten};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

/// Minimum number of decimals of a corrected length and angle.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 4;

/// A program with corrected points.
#[derive(Clone, Debug)]
pub struct Compensated {
    pub source: String,
    /// The `.dat`, if there was one.
    pub data: Option<String>,
    /// The corrected points, in the order of their first use.
    pub moved: Vec<Moved>,
}

/// Corrects the points of a program.
///
/// # Errors
/// One finding for each point that cannot be corrected.
pub fn compensate(
    files: Files<'_>,
    program: &PointProgram,
    correction: Correction<'_>,
) -> Result<Compensated, Vec<Diagnostic>> {
    let (mut source_edits, mut data_edits) = (Vec::new(), Vec::new());
    let moved = correct_points(correction, &program.points, |corrector, point| {
        let (text, edits) = match (point.origin, files.data) {
            (Origin::Data, Some(data)) => (data, &mut data_edits),
            _ => (files.source, &mut source_edits),
        };
        let rewritten = rewrite(corrector, point, text, edits);
        let (corrected, turn_bits) = rewritten.map_err(|why| text.wrong(&point.span, why))?;
        let line = files.source.line(point.first_use.start);
        Ok(Moved::new(point.name.clone(), line, &corrected, turn_bits))
    })?;
    let source = rewritten(files.source.text, source_edits);
    let data = files.data.map(|data| rewritten(data.text, data_edits));
    Ok(Compensated { source, data, moved })
}

/// Adds the edits of a point. Returns its correction, and its turn bits before and after if they change.
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
    for (at, (span, value)) in point.numbers.iter().zip(&mut values).enumerate() {
        let min_decimals = if at < lengths { DECIMALS_MM } else { DECIMALS_DEG };
        let new = number_like(text.text.get(span.clone()).unwrap_or(""), *value, min_decimals);
        *value = new.parse().unwrap_or(*value);
        edits.push((span.clone(), new));
    }
    let Target::Pose { status: Some(_), turn: Some(old), .. } = point.target else {
        return Ok((corrected, None));
    };
    let (true, Some(frames), Some(span)) = (point.by_ptp, frames, &point.turn) else {
        return Ok((corrected, None));
    };
    let new = corrector.turn(&corrected, &Pose::from_xyzabc(values), frames)?;
    if i64::from(new) == old {
        return Ok((corrected, None));
    }
    edits.push((span.clone(), integer_like(text.text.get(span.clone()).unwrap_or(""), new)));
    Ok((corrected, u8::try_from(old).ok().map(|old| [old, new])))
}

/// An integer written in the form of another one: decimal, `'B..'` or `'H..'`.
fn integer_like(written: &str, value: u8) -> String {
    let width = written.len().saturating_sub(3);
    match written.as_bytes() {
        [b'\'', b'B' | b'b', ..] => format!("'B{value:0width$b}'"),
        [b'\'', b'H' | b'h', ..] => format!("'H{value:0width$X}'"),
        _ => value.to_string(),
    }
}
