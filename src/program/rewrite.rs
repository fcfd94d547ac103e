//! Goes through the points of a program with a corrector.

use super::compensate::Corrector;
use crate::diagnostic::Diagnostic;
use crate::robot::Robot;

/// A point that was rewritten.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Moved {
    /// `inline` for one without.
    pub name: String,
    /// The line (of the `.src`, in KRL) that goes there first.
    pub line: usize,
    /// How far the commanded tool point moved (of an axis position: the flange).
    pub shift_mm: f64,
    /// How far the commanded orientation turned.
    pub turn_deg: f64,
    /// KUKA's turn bits before and after, where an axis came to the other side of zero.
    pub turn_bits: Option<[u8; 2]>,
}

/// Corrects all points for `robot`, in the order in which the program goes there; `rewrite` writes the new numbers.
///
/// # Errors
/// Every point that cannot be corrected; not empty.
pub(crate) fn points<P>(
    robot: &Robot,
    limit_mm: f64,
    points: &[P],
    mut rewrite: impl FnMut(&mut Corrector, &P) -> Result<Moved, Diagnostic>,
) -> Result<Vec<Moved>, Vec<Diagnostic>> {
    let mut corrector = Corrector::new(robot, limit_mm);
    let (mut moved, mut refused) = (Vec::with_capacity(points.len()), Vec::new());
    for point in points {
        match rewrite(&mut corrector, point) {
            Ok(point) => moved.push(point),
            Err(why) => refused.push(why),
        }
    }
    if refused.is_empty() { Ok(moved) } else { Err(refused) }
}
