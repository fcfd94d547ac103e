//! Rewrites the points of a program so that the identified robot, driven by a controller that knows
//! the nominal one, comes where the nominal robot would.
//!
//! For each point: the flange's nominal pose P; the axis angles q at which the identified robot's
//! flange is at P; the command is the nominal flange's pose at q. Only the numbers of points change,
//! every other byte stays. Both robots are taken in their own base frame.
//!
//! Lengths to one tool ball cannot tell a longer last link from a ball that sits further out. The
//! identified flange is therefore taken to be where the ball is at its nominal place on it; the tools of
//! the program stay what they are.

use nalgebra::Vector3;

use super::number::fixed;
use super::production::{Files, Number, Origin, PointProgram, Position, TaughtPoint, Text};
use super::syntax::Span;
use crate::diag::Diagnostic;
use crate::model::inverse::{self, Unsolved};
use crate::model::{AXES, Geometry, Pose, Robot};

/// Where the robot is taken to stand before the first point: KUKA's home, degrees.
const HOME_DEG: [f64; AXES] = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0];
/// An axis that a correction turns further, degrees, is near a singularity.
const LARGEST_TURN_DEG: f64 = 5.0;
/// The digits of a pose move an axis by less than this, degrees.
const ROUNDED_DEG: f64 = 0.005;
/// Fewest decimals of a rewritten length and angle: those that were taught with fewer get more.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 4;

/// A point that was rewritten.
#[derive(Clone, Debug)]
pub struct Moved {
    /// Its name in capitals; `inline` for one without.
    pub name: String,
    /// The line of the `.src` that goes there first.
    pub line: usize,
    /// How far the commanded tool point moved, mm (of an axis position: the flange).
    pub shift_mm: f64,
    /// How far the commanded orientation turned, degrees.
    pub turn_deg: f64,
    /// KUKA's turn bits before and after, where an axis came to the other side of zero.
    pub turn_bits: Option<[u8; 2]>,
}

/// A program with corrected points.
#[derive(Clone, Debug)]
pub struct Compensated {
    /// The `.src`.
    pub source: String,
    /// The `.dat`, where there was one.
    pub data: Option<String>,
    /// The points in the order in which the program first goes there.
    pub moved: Vec<Moved>,
}

/// A program that cannot be compensated: one entry for each point that stands against it; not empty.
#[derive(Clone, Debug)]
pub struct Refused {
    /// What is wrong with each point.
    pub points: Vec<Diagnostic>,
}

impl std::fmt::Display for Refused {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "the program is refused: {} point(s) cannot be compensated", self.points.len())?;
        self.points.iter().try_for_each(|point| write!(out, "\n{point}"))
    }
}

impl std::error::Error for Refused {}

/// Corrects a program for `robot`, an identified one that carries its nominal robot. No commanded point
/// may move by more than `limit_mm`.
///
/// # Errors
/// Every point that moves too far, is out of reach or beyond an axis limit, is too near to a
/// singularity, or would need another status: that lies beyond a singularity.
pub fn compensate(
    files: Files<'_>,
    program: &PointProgram,
    robot: &Robot,
    limit_mm: f64,
) -> Result<Compensated, Refused> {
    let mut corrector = Corrector::new(robot, limit_mm);
    let (mut source_edits, mut data_edits) = (Vec::new(), Vec::new());
    let (mut moved, mut refused) = (Vec::new(), Vec::new());
    let ends: Vec<usize> = files.source.text.match_indices('\n').map(|(at, _)| at).collect();
    for point in &program.points {
        let (text, edits) = match (point.origin, files.data) {
            (Origin::Data, Some(data)) => (data, &mut data_edits),
            _ => (files.source, &mut source_edits),
        };
        match corrector.correct(point, text) {
            Ok(corrected) => {
                edits.extend(corrected.edits);
                moved.push(Moved {
                    name: point.name.clone(),
                    line: ends.partition_point(|end| *end < point.used.start) + 1,
                    shift_mm: corrected.shift_mm,
                    turn_deg: corrected.turn_deg,
                    turn_bits: corrected.turn_bits,
                });
            }
            Err(why) => {
                let message = format!("{}: {why}", point.name);
                refused.push(Diagnostic::span(text.file, text.text, point.span.clone(), message));
            }
        }
    }
    if !refused.is_empty() {
        return Err(Refused { points: refused });
    }
    let source = rewritten(files.source.text, source_edits);
    let data = files.data.map(|data| rewritten(data.text, data_edits));
    Ok(Compensated { source, data, moved })
}

/// Goes through the points as the robot would.
struct Corrector<'a> {
    /// The controller's robot, its tool point at the flange.
    controller: Robot,
    nominal: Geometry,
    /// The true robot, its tool point at the flange too.
    identified: Geometry,
    limits_deg: &'a [[f64; 2]; AXES],
    limit_mm: f64,
    /// Nominal axis angles at the last point, rad.
    last: [f64; AXES],
}

/// New numbers for a point, as they are written.
struct Corrected {
    edits: Vec<(Span, String)>,
    shift_mm: f64,
    turn_deg: f64,
    turn_bits: Option<[u8; 2]>,
}

impl<'a> Corrector<'a> {
    fn new(robot: &'a Robot, limit_mm: f64) -> Self {
        let at = |geometry: &Geometry, tool| Geometry { tool, ..geometry.clone() };
        let controller = robot.controller();
        let nominal = at(&controller.geometry, Vector3::zeros());
        // Lengths tell where the ball is on the last link, not where the flange is.
        let off = robot.geometry.tool - controller.geometry.tool;
        Self {
            controller: Robot { geometry: nominal.clone(), ..controller.clone() },
            nominal,
            identified: at(&robot.geometry, off),
            limits_deg: &controller.limits_deg,
            limit_mm,
            last: HOME_DEG.map(f64::to_radians),
        }
    }

    fn correct(&mut self, point: &TaughtPoint, text: Text<'_>) -> Result<Corrected, String> {
        match &point.position {
            Position::Axes(numbers) => {
                let taught: [f64; AXES] = std::array::from_fn(|i| numbers[i].value.to_radians());
                let wanted = self.nominal.ball(&taught);
                let axes = self.solve(&wanted, &taught)?;
                let told = self.nominal.ball(&axes);
                let values = axes.map(f64::to_degrees);
                self.within(Corrected {
                    edits: printed(numbers, values, [DECIMALS_DEG; AXES], text).0,
                    shift_mm: (told.position - wanted.position).norm(),
                    turn_deg: told.angle_to(&wanted).to_degrees(),
                    turn_bits: None,
                })
            }
            Position::Pose { numbers, status, turn, tool, base } => {
                let [x, y, z, a, b, c] = numbers.each_ref().map(|number| number.value);
                let taught = Pose::from_kuka([x, y, z], [a, b, c]);
                let wanted = base.then(&taught).then(&tool.inverse());
                let bits = status.zip(turn.as_ref().map(|(bits, _)| *bits));
                let start = self.nominal_axes(&wanted, bits, point.by_ptp)?;
                let axes = self.solve(&wanted, &start)?;
                let told = base.inverse().then(&self.nominal.ball(&axes)).then(tool);
                let ([x, y, z], [a, b, c]) = (<[f64; 3]>::from(told.position), told.abc_deg());
                let (mm, deg) = (DECIMALS_MM, DECIMALS_DEG);
                let (mut edits, values) =
                    printed(numbers, [x, y, z, a, b, c], [mm, mm, mm, deg, deg, deg], text);
                let mut turn_bits = None;
                if let (true, Some((_, old)), Some((_, span))) = (point.by_ptp, bits, turn) {
                    let [x, y, z, a, b, c] = values;
                    let printed = base.then(&Pose::from_kuka([x, y, z], [a, b, c])).then(&tool.inverse());
                    let new = self.turn(&start, &axes, &printed)?;
                    if i64::from(new) != old {
                        turn_bits = u8::try_from(old).ok().map(|old| [old, new]);
                        let written = text.text.get(span.clone()).unwrap_or("");
                        edits.push((span.clone(), whole_like(written, new)));
                    }
                }
                self.within(Corrected {
                    edits,
                    shift_mm: (told.position - taught.position).norm(),
                    turn_deg: told.angle_to(&taught).to_degrees(),
                    turn_bits,
                })
            }
        }
    }

    /// The nominal robot's axis angles at a pose of its flange: by status and turn where a PTP
    /// follows them, else nearest to the last point.
    fn nominal_axes(
        &self,
        wanted: &Pose,
        bits: Option<(i64, i64)>,
        by_ptp: bool,
    ) -> Result<[f64; AXES], String> {
        let bits = bits.map(|(status, turn)| (u8::try_from(status & 7), u8::try_from(turn)));
        match bits {
            Some((Ok(status), Ok(turn))) if by_ptp => self.taught_axes(wanted, status, turn),
            Some((Err(_), _) | (_, Err(_))) if by_ptp => return Err("S or T is out of range".into()),
            _ => inverse::nearest(&self.nominal, wanted, &self.last),
        }
        .map_err(|unsolved| format!("the nominal robot does not come here: {unsolved}"))
    }

    /// The nominal robot's axis angles by status and turn. The digits of a pose may put an axis that was taught at zero
    /// on its other side: its bit then counts for nothing.
    fn taught_axes(&self, wanted: &Pose, status: u8, turn: u8) -> Result<[f64; AXES], Unsolved> {
        let as_written = inverse::from_status_turn(&self.controller, wanted, status, turn);
        if !matches!(as_written, Err(Unsolved::NoSuchConfiguration { .. })) {
            return as_written;
        }
        let mut others = (1..1_u8 << AXES).filter_map(|flipped| {
            let axes = inverse::from_status_turn(&self.controller, wanted, status, turn ^ flipped).ok()?;
            let at_zero = |axis: usize| axes[axis].to_degrees().abs() < ROUNDED_DEG;
            (0..AXES).all(|axis| (flipped >> axis) & 1 == 0 || at_zero(axis)).then_some(axes)
        });
        others.next().map_or(as_written, Ok)
    }

    /// The identified robot's axis angles at a pose of its flange, in the branch of `start`.
    fn solve(&mut self, wanted: &Pose, start: &[f64; AXES]) -> Result<[f64; AXES], String> {
        self.last = *start;
        let axes = inverse::numeric(&self.identified, wanted, start)
            .map_err(|unsolved| format!("the identified robot does not come here: {unsolved}"))?;
        for (i, (to, from)) in axes.iter().zip(start).enumerate() {
            let ([low, high], deg) = (self.limits_deg[i], to.to_degrees());
            if !(low..=high).contains(&deg) {
                let axis = i + 1;
                return Err(format!("axis {axis} would leave its limits: {deg:.3} deg of {low} to {high}"));
            }
            let turned = (to - from).abs().to_degrees();
            if turned > LARGEST_TURN_DEG {
                return Err(format!(
                    "axis {} would have to turn by {turned:.1} deg: the point is too near to a singularity",
                    i + 1
                ));
            }
        }
        Ok(axes)
    }

    /// KUKA's turn bits of a corrected point, as its printed pose has them. An axis that the correction
    /// carries through zero has another one than was taught: with the old bit a controller would look for
    /// the same pose a full turn away.
    fn turn(&self, start: &[f64; AXES], axes: &[f64; AXES], printed: &Pose) -> Result<u8, String> {
        let there = inverse::nearest(&self.nominal, printed, axes)
            .map_err(|unsolved| format!("the nominal robot does not come here: {unsolved}"))?;
        let [old, new] = [start, &there].map(|axes| inverse::status(&self.nominal, axes));
        if old != new {
            return Err(format!(
                "it would need S {new} in place of S {old}: a singularity lies between; teach it further away, \
                 or go there by LIN"
            ));
        }
        Ok(inverse::turn(&there))
    }

    fn within(&self, corrected: Corrected) -> Result<Corrected, String> {
        if corrected.shift_mm > self.limit_mm {
            let (shift, limit) = (corrected.shift_mm, self.limit_mm);
            return Err(format!("it would move by {shift:.3} mm, allowed are {limit:.3}"));
        }
        Ok(corrected)
    }
}

/// The numbers as they are written, with at least the digits that were there and `fewest` of them; and the
/// values that these say.
fn printed<const N: usize>(
    numbers: &[Number; N],
    values: [f64; N],
    fewest: [usize; N],
    text: Text<'_>,
) -> (Vec<(Span, String)>, [f64; N]) {
    let mut said = values;
    let mut edits = Vec::with_capacity(N + 1);
    for ((number, value), fewest) in numbers.iter().zip(&mut said).zip(fewest) {
        let written = text.text.get(number.span.clone()).unwrap_or("");
        let digits = written
            .split_once('.')
            .map_or(0, |(_, tail)| tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len()));
        let new = fixed(*value, digits.clamp(fewest, 9));
        *value = new.parse().unwrap_or(*value);
        edits.push((number.span.clone(), new));
    }
    (edits, said)
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
fn rewritten(text: &str, mut edits: Vec<(Span, String)>) -> String {
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
