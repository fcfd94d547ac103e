//! Measurements and the observations CSV of the lengths among them.

use nalgebra::Vector3;
use std::f64::consts::TAU;
use std::fmt::Write;
use std::iter;
use std::sync::Arc;

use super::{ContextColumn, MeasurementContext, context};
use crate::base::table::{TableReader, TableRow};
use crate::diagnostic::Diagnostic;
use crate::measurement::MeasurementFinding::{
    self, BarWithoutLength, NoMeasurement, NoPose, NotASense, TooMany, TooManyTargets, UnknownBall,
    UnknownBar, UnknownTarget, UnseenTarget, UntrackedPosition,
};
use crate::plausibility::{PlausibilityFinding, Quantity};
use crate::robot::parameter::SetUpCounts;
use crate::robot::{
    AXES, Approach, ArmLoad, AxisAngles, BarId, Datum, PayloadId, Robot, RobotFinding, TargetId,
};

/// One length at one pose. A position of a tracker is three of them, one for each plane of the tracker's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The number that the plan, or else the user, gave it.
    pub index: u32,
    pub datum: Datum,
    pub target: TargetId,
    pub axes: AxisAngles,
    /// The sense in which each axis came to the pose.
    pub approach: Approach,
    /// Distance between the ball centres (the bar's length plus its reading), or the signed distance from a plane.
    pub length_mm: f64,
    /// Standard deviation of the length, if known.
    pub sigma_mm: Option<f64>,
    /// The payload on the flange.
    pub payload: PayloadId,
    /// Equal contexts of consecutive rows are shared, so that a million lengths take about 100 bytes each.
    pub context: Option<Arc<MeasurementContext>>,
}

impl Measurement {
    /// Appends the row of a length to the CSV.
    fn append(&self, optional: OptionalColumns, table: &Measurements, text: &mut String) {
        let Datum::Ball(ball, bar) = self.datum else { return };
        // Writing to a string does not fail.
        let _ = write!(text, "{},{ball}", self.index);
        for angle in self.axes.degrees() {
            let _ = write!(text, ",{angle}");
        }
        let _ = write!(text, ",{},", self.length_mm);
        if let Some(sigma) = self.sigma_mm {
            let _ = write!(text, "{sigma}");
        }
        if optional.bars {
            let _ = write!(text, ",{bar}");
        }
        if optional.targets {
            let _ = write!(text, ",{}", self.target);
        }
        if optional.approach {
            self.append_approach(text);
        }
        if optional.payloads {
            let name = table.payloads.get(self.payload.index()).map_or("", String::as_str);
            let _ = write!(text, ",{}", context::quoted(name));
        }
        match &self.context {
            Some(context) => context.append(&table.columns, text),
            None => text.extend(table.columns.iter().map(|_| ',')),
        }
        text.push('\n');
    }

    /// Appends the senses of approach, each after a comma.
    pub(super) fn append_approach(&self, text: &mut String) {
        for sense in self.approach.senses() {
            let _ = write!(text, ",{sense}");
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurements {
    pub rows: Vec<Measurement>,
    /// The further columns, in the order in which they are written.
    pub columns: Vec<ContextColumn>,
    /// The names of the payloads by [`PayloadId::index`]; without any the rows name none.
    pub payloads: Vec<String>,
}

pub(super) const AXIS_COLUMNS: [&str; AXES] = ["a1_deg", "a2_deg", "a3_deg", "a4_deg", "a5_deg", "a6_deg"];
const SIGMA: &str = "sigma_mm";
const BAR: &str = "bar";
pub(super) const TARGET: &str = "target";
pub(super) const PAYLOAD: &str = "payload";
const FORCE: &str = "force_n";
/// The sense of approach of each axis: -1, 0 (not known) or 1 (rising angle).
pub const APPROACH: [&str; AXES] =
    ["approach1", "approach2", "approach3", "approach4", "approach5", "approach6"];

/// The optional columns that are written.
#[derive(Clone, Copy)]
struct OptionalColumns {
    bars: bool,
    targets: bool,
    approach: bool,
    payloads: bool,
}

/// Limits of one calibration: each ball, bar and target adds unknowns, and the time grows with their cube.
pub const MAX_BALLS: usize = 100;
pub(super) const MAX_BARS: usize = 20;
const MAX_TARGETS: usize = 20;

/// Rows of a piece of CSV.
const PIECE: usize = 4096;

impl Measurements {
    /// Reads the CSV `index,centre,a1_deg,..,a6_deg,length_mm[,sigma_mm][,bar][,target][,approach1,..,approach6][,..]`,
    /// columns in any order. The default bar is bar 1, the default target the tool ball.
    pub fn from_csv(file: &str, text: &str) -> Result<Self, Diagnostic> {
        Self::from_table(&mut TableReader::of(file, text)?)
    }

    /// Reads the measurements from a table, a row at a time.
    pub fn from_table(table: &mut TableReader<'_>) -> Result<Self, Diagnostic> {
        let [a1, a2, a3, a4, a5, a6] = AXIS_COLUMNS;
        let places = table.required(["index", "centre", a1, a2, a3, a4, a5, a6, "length_mm"])?;
        let (sigma, bar) = (table.optional(SIGMA)?, table.optional(BAR)?);
        let (target, approach) = (table.optional(TARGET)?, ApproachColumns::of(table)?);
        let mut payloads = PayloadColumn::of(table)?;
        let force = table.optional(FORCE)?;
        let is_known = |at: &usize| {
            places.contains(at)
                || [sigma, bar, target, payloads.at].contains(&Some(*at))
                || approach.0.contains(&Some(*at))
        };
        let others: Vec<usize> = (0..table.names().len()).filter(|at| !is_known(at)).collect();
        let further: Vec<ContextColumn> =
            others.iter().map(|&at| ContextColumn::of(&table.names()[at])).collect();
        let [index, ball, axes @ .., length] = places;
        let mut rows: Vec<Measurement> = Vec::new();
        while let Some(row) = table.row()? {
            let (axes, length_mm) = (angles(&row, axes)?, distance(&row, length)?);
            row.given(force, |at| bar_force(&row, at))?;
            let context = MeasurementContext::read(&further, others.iter().map(|&at| row.plain(at)));
            let before = rows.last().and_then(|row| row.context.as_ref());
            rows.push(Measurement {
                index: row.whole(index, 0)?,
                datum: Datum::Ball(
                    row.numbered(ball)?,
                    row.given(bar, |at| row.numbered(at))?.unwrap_or(BarId::FIRST),
                ),
                target: row.given(target, |at| row.numbered(at))?.unwrap_or(TargetId::FIRST),
                axes,
                approach: approach.read(&row)?,
                length_mm,
                sigma_mm: row.given(sigma, |at| row.positive(at))?,
                payload: payloads.read(&row),
                context: shared(context, before),
            });
        }
        let read = Self::new(rows, further).map_err(|finding| Diagnostic::file(table.file(), finding))?;
        Ok(Self { payloads: payloads.names, ..read })
    }

    /// # Errors
    /// No row; too many balls, bars or targets; a bar or target whose number is below the highest has no measurement.
    pub fn new(rows: Vec<Measurement>, columns: Vec<ContextColumn>) -> Result<Self, MeasurementFinding> {
        if rows.is_empty() {
            return Err(NoMeasurement);
        }
        let set = Self { rows, columns, payloads: Vec::new() };
        let (balls, bars) = (set.balls(), set.bars());
        if balls > MAX_BALLS || bars > MAX_BARS {
            return Err(TooMany { balls, bars, most_balls: MAX_BALLS, most_bars: MAX_BARS });
        }
        let is_unused = |bar: &BarId| set.rows.iter().all(|row| row.datum.bar() != Some(*bar));
        if let Some(unused) = (0..bars).map(BarId::at).find(is_unused) {
            return Err(BarWithoutLength { bar: unused.number() });
        }
        let targets = set.targets();
        if targets > MAX_TARGETS {
            return Err(TooManyTargets { targets, most: MAX_TARGETS });
        }
        let is_unseen = |target: &TargetId| set.rows.iter().all(|row| row.target != *target);
        match (1..targets).map(TargetId::at).find(is_unseen) {
            None => Ok(set),
            Some(unseen) => Err(UnseenTarget { target: unseen.number() }),
        }
    }

    /// The measurements with the payloads of a robot in the order of its file.
    ///
    /// # Errors
    /// A row names a payload that the robot does not have.
    pub fn carrying(mut self, load: &ArmLoad) -> Result<Self, RobotFinding> {
        if self.payloads.is_empty() {
            return Ok(self);
        }
        let known: Vec<&str> = load.payloads.iter().map(|payload| payload.name.as_str()).collect();
        for row in &mut self.rows {
            let name = &self.payloads[row.payload.index()];
            row.payload = match known.iter().position(|other| other == name) {
                Some(at) => PayloadId::at(at),
                None if name.is_empty() => PayloadId::FIRST,
                None => {
                    let (index, name, known) = (row.index, name.clone(), load.named());
                    return Err(RobotFinding::PayloadOfRow { index, name, known });
                }
            };
        }
        self.payloads = known.into_iter().map(str::to_owned).collect();
        Ok(self)
    }

    /// Adds seconds to the times of all rows.
    pub fn delay(&mut self, by_s: f64) {
        if by_s == 0.0 {
            return;
        }
        for context in self.rows.iter_mut().filter_map(|row| row.context.as_mut()) {
            let context = Arc::make_mut(context);
            context.time_s = context.time_s.map(|time_s| time_s + by_s);
            // The spelling of the time that was read.
            context.texts.retain(|(at, _)| self.columns[*at] != ContextColumn::TimeS);
        }
    }

    /// Appends the rows of a further table of the same robot, with the columns of both.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn and(mut self, further: &Self) -> Result<Self, MeasurementFinding> {
        let mut payloads = self.payloads;
        // If one table names no payload, all its rows have the first payload of the other table.
        let are_named = !payloads.is_empty();
        let place = |(at, name): (usize, &String)| {
            let known = payloads.iter().position(|known| known == name);
            let appended = || {
                payloads.push(name.clone());
                payloads.len() - 1
            };
            if are_named { known.unwrap_or_else(appended) } else { at }
        };
        let places: Vec<usize> = further.payloads.iter().enumerate().map(place).collect();
        let mut columns = self.columns;
        let column = |column: &ContextColumn| {
            columns.iter().position(|known| known == column).unwrap_or_else(|| {
                columns.push(column.clone());
                columns.len() - 1
            })
        };
        let column_places: Vec<usize> = further.columns.iter().map(column).collect();
        let appended = further.rows.iter().map(|row| {
            let context = row.context.as_deref().map(|context| Arc::new(context.in_columns(&column_places)));
            let payload = places.get(row.payload.index()).map_or(row.payload, |at| PayloadId::at(*at));
            Measurement { context, payload, ..row.clone() }
        });
        self.rows.extend(appended);
        let all = Self::new(self.rows, columns)?;
        let payloads = if are_named { payloads } else { further.payloads.clone() };
        Ok(Self { payloads, ..all })
    }

    /// Reads only the axis angles a1_deg..a6_deg of a table, and the senses of approach if it has them.
    pub fn poses_from_table(table: &mut TableReader<'_>) -> Result<Vec<ApproachedPose>, Diagnostic> {
        let axes = table.required(AXIS_COLUMNS)?;
        let approach = ApproachColumns::of(table)?;
        let mut poses = Vec::new();
        while let Some(row) = table.row()? {
            poses.push(ApproachedPose { axes: angles(&row, axes)?, approach: approach.read(&row)? });
        }
        if poses.is_empty() {
            return Err(Diagnostic::file(table.file(), NoPose));
        }
        Ok(poses)
    }

    /// The CSV of the lengths; every number reads back bit for bit.
    pub fn to_csv(&self) -> String {
        self.csv_pieces(|_| true).collect()
    }

    /// The CSV of the lengths whose row number `keep` accepts, in pieces, so that a long one is never in memory as a whole.
    pub fn csv_pieces(&self, keep: impl Fn(usize) -> bool) -> impl Iterator<Item = String> {
        let lengths = || self.rows.iter().filter(|row| !row.datum.is_plane());
        let optional = OptionalColumns {
            bars: self.bars() > 1,
            targets: lengths().any(|row| row.target != TargetId::FIRST),
            approach: lengths().any(|row| !row.approach.is_unknown()),
            payloads: self.payloads.len() > 1,
        };
        let pieces = self.rows.chunks(PIECE).enumerate().map(move |(piece, rows)| {
            let mut text = String::new();
            for (at, row) in rows.iter().enumerate() {
                if keep(PIECE * piece + at) {
                    row.append(optional, self, &mut text);
                }
            }
            text
        });
        iter::once(self.header(optional)).chain(pieces)
    }

    fn header(&self, optional: OptionalColumns) -> String {
        let mut text = format!("index,centre,{},length_mm,{SIGMA}", AXIS_COLUMNS.join(","));
        if optional.bars {
            text.push_str(&format!(",{BAR}"));
        }
        if optional.targets {
            text.push_str(&format!(",{TARGET}"));
        }
        if optional.approach {
            text.push_str(&format!(",{}", APPROACH.join(",")));
        }
        if optional.payloads {
            text.push_str(&format!(",{PAYLOAD}"));
        }
        for column in &self.columns {
            text.push_str(&format!(",{}", context::quoted(column.name())));
        }
        text.push('\n');
        text
    }

    /// Checks that every ball, bar, target and tracker of the rows is in the set-up.
    pub fn check(&self, file: &str, set_up: SetUpCounts) -> Result<(), Diagnostic> {
        let SetUpCounts { balls, bars, targets, trackers } = set_up;
        let unknown =
            self.rows.iter().find_map(|&Measurement { index, datum, target, .. }| match (target, datum) {
                (target, _) if target.index() >= targets => {
                    Some(UnknownTarget { index, target: target.number(), targets })
                }
                (_, Datum::Plane(_)) => (trackers == 0).then_some(UntrackedPosition { index }),
                (_, Datum::Ball(ball, _)) if ball.index() >= balls => {
                    Some(UnknownBall { index, ball: ball.number(), balls })
                }
                (_, Datum::Ball(_, bar)) => {
                    (bar.index() >= bars).then(|| UnknownBar { index, bar: bar.number(), bars })
                }
            });
        unknown.map_or(Ok(()), |finding| Err(Diagnostic::file(file, finding)))
    }

    /// A finding if some rows have a standard deviation and others have none.
    pub(crate) fn without_sigma(&self) -> Option<MeasurementFinding> {
        let (rows, without) =
            (self.rows.len(), self.rows.iter().filter(|row| row.sigma_mm.is_none()).count());
        (0 < without && without < rows).then_some(MeasurementFinding::SigmaMissing { without, rows })
    }

    /// As [`beyond`], for the rows.
    pub fn beyond(&self, robot: &Robot) -> Option<MeasurementFinding> {
        beyond(self.rows.iter().map(|row| (row.index as usize, row.axes)), robot)
    }

    fn temperatures_c(&self) -> impl Iterator<Item = f64> {
        self.rows.iter().filter_map(|row| row.context.as_ref()?.temperature_c)
    }

    /// Mean temperature of the rows that have one, degrees Celsius.
    pub fn mean_temperature_c(&self) -> Option<f64> {
        let count = self.temperatures_c().count();
        (count > 0).then(|| self.temperatures_c().sum::<f64>() / count as f64)
    }

    /// A finding if the temperatures are impossible for a room.
    pub fn warm(&self) -> Option<PlausibilityFinding> {
        const COLUMN: &str = "temp_c";
        let mean_c = self.mean_temperature_c()?;
        if self.temperatures_c().all(|celsius| celsius == 0.0) {
            return Some(Quantity::Temperature.always_zero(COLUMN));
        }
        let impossible = || self.temperatures_c().find_map(|c| Quantity::Temperature.impossible(COLUMN, c));
        Quantity::Temperature.unusual("mean of temp_c", mean_c).or_else(impossible)
    }

    /// The set-up of the rows, with this number of base balls.
    pub fn set_up(&self, balls: usize) -> SetUpCounts {
        let trackers = usize::from(self.rows.iter().any(|row| row.datum.is_plane()));
        SetUpCounts { balls, bars: self.bars(), targets: self.targets(), trackers }
    }

    /// The number of measurements; a position counts once.
    pub fn count(&self) -> usize {
        self.rows.iter().filter(|row| row.datum.is_first()).count()
    }

    /// The highest target number; 1 is the tool ball.
    pub(crate) fn targets(&self) -> usize {
        self.rows.iter().map(|row| row.target.index() + 1).max().unwrap_or(1)
    }

    /// The highest bar number; 0 without lengths.
    pub fn bars(&self) -> usize {
        self.rows.iter().filter_map(|row| Some(row.datum.bar()?.index() + 1)).max().unwrap_or(0)
    }

    /// The highest ball number; 0 without lengths.
    pub fn balls(&self) -> usize {
        self.rows.iter().filter_map(|row| Some(row.datum.ball()?.index() + 1)).max().unwrap_or(0)
    }
}

/// A finding if numbered poses are beyond the axis limits of the robot (another robot, or typing errors), or seem to be in
/// radians.
pub fn beyond(poses: impl Iterator<Item = (usize, AxisAngles)>, robot: &Robot) -> Option<MeasurementFinding> {
    /// Controllers allow an axis a little beyond its limit.
    const TOLERANCE_DEG: f64 = 1.0;
    let all: Vec<(usize, AxisAngles)> = poses.collect();
    let beyond = all.iter().filter_map(|&(number, axes)| {
        let is_beyond = |(deg, [low, high]): (&f64, &[f64; 2])| {
            // A wrist axis with a range of 540 degrees and more may be given by another full turn.
            let turned = if high - low >= 540.0 { low + (deg - low).rem_euclid(360.0) } else { *deg };
            turned < low - TOLERANCE_DEG || turned > high + TOLERANCE_DEG
        };
        let axes_deg = axes.degrees();
        let axis = axes_deg.iter().zip(&robot.limits_at_deg(&axes_deg)).position(is_beyond)?;
        Some((number, axis + 1, axes_deg[axis]))
    });
    let beyond: Vec<_> = beyond.collect();
    let Some(&(index, axis, deg)) = beyond.first() else { return in_radians(&all) };
    Some(MeasurementFinding::BeyondLimits { rows: beyond.len(), index, axis, deg })
}

/// A finding if all axis angles are small numbers with decimals.
fn in_radians(poses: &[(usize, AxisAngles)]) -> Option<MeasurementFinding> {
    const MIN_ROWS: usize = 3;
    let angles = || poses.iter().flat_map(|(_, axes)| axes.degrees());
    let decimals = angles().filter(|angle| angle.fract() != 0.0).count();
    let small = angles().all(|angle| angle.abs() <= TAU);
    if small && poses.len() >= MIN_ROWS && 2 * decimals >= angles().count() {
        return Some(MeasurementFinding::Radians { rows: poses.len() });
    }
    single_in_radians(poses)
}

/// A finding if a few poses have only small numbers with decimals.
fn single_in_radians(poses: &[(usize, AxisAngles)]) -> Option<MeasurementFinding> {
    const MIN_DECIMALS: usize = 4;
    /// If the fraction is larger, the arm probably is near its zero position.
    const FEW: f64 = 0.2;
    let is_small = |(_, axes): &&(usize, AxisAngles)| {
        let deg = axes.degrees();
        let decimals = deg.iter().filter(|deg| (*deg * 1e3).fract() != 0.0).count();
        decimals >= MIN_DECIMALS && deg.iter().all(|deg| deg.abs() <= TAU)
    };
    let found: Vec<_> = poses.iter().filter(is_small).collect();
    let &&(index, _) = found.first()?;
    ((found.len() as f64) < FEW * poses.len() as f64)
        .then_some(MeasurementFinding::RowsInRadians { rows: found.len(), index })
}

/// A pose with the sense in which each axis came to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachedPose {
    pub axes: AxisAngles,
    pub approach: Approach,
}

impl ApproachedPose {
    /// A pose at axis angles (rad) with an unknown sense of approach.
    pub fn unapproached(axes: &[f64; AXES]) -> Self {
        let axes = AxisAngles::from_degrees(axes.map(f64::to_degrees));
        Self { axes, approach: Approach::default() }
    }
}

/// A point to which a program moves a tool.
#[derive(Clone, Copy, Debug)]
pub struct ToolPoint {
    /// The tool point in the flange frame, mm.
    pub tool: Vector3<f64>,
    /// The axis angles to which the controller moves without a correction.
    pub pose: ApproachedPose,
}

/// The column with the names of payloads, if present, and the names that were read.
pub(super) struct PayloadColumn {
    pub(super) at: Option<usize>,
    pub(super) names: Vec<String>,
}

impl PayloadColumn {
    pub(super) fn of(table: &mut TableReader<'_>) -> Result<Self, Diagnostic> {
        let at = table.optional(PAYLOAD)?;
        // The first name is the one of rows that name none.
        Ok(Self { at, names: at.iter().map(|_| String::new()).collect() })
    }

    pub(super) fn read(&mut self, row: &TableRow<'_>) -> PayloadId {
        let Some(at) = self.at else { return PayloadId::FIRST };
        let name = row.text(at);
        let place = self.names.iter().position(|known| known == name).unwrap_or_else(|| {
            self.names.push(name.to_owned());
            self.names.len() - 1
        });
        PayloadId::at(place)
    }
}

/// The numbers of the columns with the sense of approach, if present.
pub(super) struct ApproachColumns([Option<usize>; AXES]);

impl ApproachColumns {
    pub(super) fn of(table: &TableReader<'_>) -> Result<Self, Diagnostic> {
        let mut places = [None; AXES];
        for (place, name) in places.iter_mut().zip(APPROACH) {
            *place = table.optional(name)?;
        }
        Ok(Self(places))
    }

    pub(super) fn read(&self, row: &TableRow<'_>) -> Result<Approach, Diagnostic> {
        let mut senses = [0; AXES];
        for (sense, at) in senses.iter_mut().zip(self.0) {
            let read = |at: usize| match row.whole_text(at) {
                "-1" => Ok(-1),
                "0" | "-0" => Ok(0),
                "1" | "+1" => Ok(1),
                _ => {
                    let (column, cell) = (row.column(at), row.text(at).into());
                    Err(row.line(NotASense { column, cell }))
                }
            };
            *sense = row.given(at, read)?.unwrap_or(0);
        }
        Ok(Approach::new(senses))
    }
}

/// A context for sharing: none if nothing is known, the previous one if it is equal.
fn shared(
    context: MeasurementContext,
    before: Option<&Arc<MeasurementContext>>,
) -> Option<Arc<MeasurementContext>> {
    match before {
        _ if context == MeasurementContext::default() => None,
        Some(before) if **before == context => Some(Arc::clone(before)),
        _ => Some(Arc::new(context)),
    }
}

pub(super) fn angles(row: &TableRow<'_>, places: [usize; AXES]) -> Result<AxisAngles, Diagnostic> {
    let mut axes_deg = [0.0; AXES];
    for (angle, at) in axes_deg.iter_mut().zip(places) {
        *angle = row.number(at)?;
    }
    Ok(AxisAngles::from_degrees(axes_deg))
}

/// The length of a row. A negative one probably is the bar's reading.
fn distance(row: &TableRow<'_>, at: usize) -> Result<f64, Diagnostic> {
    row.number(at)?;
    row.positive(at).map_err(|wrong| {
        wrong.help("is it the bar's reading? length_mm is between the ball centres: the bar's length plus the reading")
    })
}

/// The pull of the bar, N.
fn bar_force(row: &TableRow<'_>, at: usize) -> Result<f64, Diagnostic> {
    let force_n = row.number(at)?;
    Quantity::BarForce.check(FORCE, force_n).map_err(|finding| row.wrong(at, finding))?;
    Ok(force_n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Payload;

    const HEADER: &str = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm";

    fn table(further: &str, rows: &[&str]) -> Result<Measurements, Diagnostic> {
        let rows: String = rows.iter().map(|row| format!("{row}\n")).collect();
        Measurements::from_csv("t.csv", &format!("{HEADER}{further}\n{rows}"))
    }

    fn robot() -> Robot {
        Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()
    }

    #[test]
    fn optional_columns_have_their_defaults_and_read_back() {
        let read = table(
            ",sigma_mm,bar,approach1,note",
            &["5,2,1.5,2,3,4,5,6,300.25,0.01,2,-1,\"a, b\"", "6,1,1,2,3,4,5,6,301,,1,1,"],
        )
        .unwrap();
        let [first, second] = &read.rows[..] else { panic!() };
        let datum = |ball, bar| Datum::Ball(crate::robot::BallId::at(ball), BarId::at(bar));
        assert_eq!((first.index, first.datum, first.target), (5, datum(1, 1), TargetId::FIRST));
        assert_eq!((first.sigma_mm, second.sigma_mm, second.datum), (Some(0.01), None, datum(0, 0)));
        assert_eq!(first.approach.senses(), [-1, 0, 0, 0, 0, 0]);
        assert_eq!(Measurements::from_csv("t.csv", &read.to_csv()).unwrap(), read);
        assert_eq!((read.balls(), read.bars(), read.targets(), read.count()), (2, 2, 1, 2));
        assert_eq!(read.set_up(3), SetUpCounts { balls: 3, bars: 2, targets: 1, trackers: 0 });
        assert!(matches!(
            read.without_sigma(),
            Some(MeasurementFinding::SigmaMissing { without: 1, rows: 2 })
        ));
        assert!(read.check("t.csv", read.set_up(2)).is_ok() && read.check("t.csv", read.set_up(1)).is_err());
        let both = read.clone().and(&read).unwrap();
        assert_eq!((both.rows.len(), both.rows[2].context == read.rows[0].context), (4, true));
    }

    /// Tables that name payloads in another order, and one that names none.
    #[test]
    fn joined_rows_keep_their_payload_and_the_pull_of_the_bar() {
        let first = table(",payload", &["1,1,0,0,0,0,0,0,300,bar", "2,1,1,0,0,0,0,0,300,gripper"]).unwrap();
        let rows =
            ["3,1,2,0,0,0,0,0,300,gripper,20", "4,1,3,0,0,0,0,0,300,spindle,", "5,1,4,0,0,0,0,0,300,bar,50"];
        let second = table(",payload,force_n", &rows).unwrap();
        let names = |of: &Measurements| -> Vec<String> {
            of.rows
                .iter()
                .map(|row| of.payloads.get(row.payload.index()).cloned().unwrap_or_default())
                .collect()
        };
        let forces = |of: &Measurements| -> Vec<Option<f64>> {
            of.rows.iter().map(|row| row.context.as_ref().and_then(|context| context.force_n)).collect()
        };
        let both = first.clone().and(&second).unwrap();
        assert_eq!(names(&both), ["bar", "gripper", "gripper", "spindle", "bar"]);
        assert_eq!(forces(&both), [None, None, Some(20.0), None, Some(50.0)]);
        let read = Measurements::from_csv("t.csv", &both.to_csv()).unwrap();
        assert_eq!((names(&read), forces(&read)), (names(&both), forces(&both)));
        let plain = table("", &["6,1,5,0,0,0,0,0,300"]).unwrap();
        assert_eq!(names(&plain.clone().and(&first).unwrap()), ["", "bar", "gripper"]);
        assert_eq!(names(&first.and(&plain).unwrap()), ["bar", "gripper", ""]);
        assert!(table(",force_n", &["1,1,0,0,0,0,0,0,300,x"]).is_err());
        assert!(table(",force_n", &["1,1,0,0,0,0,0,0,300,5000"]).is_err());
    }

    #[test]
    fn impossible_tables_are_refused() {
        for rows in [
            &["1,0,0,0,0,0,0,0,300"][..],
            &["1,1,0,0,0,0,0,0,-1"],
            &["1,101,0,0,0,0,0,0,300"],
            &["-1,1,0,0,0,0,0,0,300"],
            &[],
        ] {
            assert!(table("", rows).is_err(), "{rows:?}");
        }
        let unused = table(",bar", &["1,1,0,0,0,0,0,0,300,3", "2,1,0,0,0,0,0,0,300,1"]);
        assert!(matches!(
            unused.unwrap_err().finding::<MeasurementFinding>(),
            Some(BarWithoutLength { bar: 2 })
        ));
        let unseen = table(",target", &["1,1,0,0,0,0,0,0,300,1", "2,1,0,0,0,0,0,0,300,3"]);
        assert!(matches!(
            unseen.unwrap_err().finding::<MeasurementFinding>(),
            Some(UnseenTarget { target: 2 })
        ));
        assert!(table(",approach2", &["1,1,0,0,0,0,0,0,300,2"]).is_err());
        assert!(table("", &["1,100,0,0,0,0,0,0,300"]).is_ok());
    }

    /// The limits of axis 2 of the KR 60 HA are -135 and 35, those of axis 4 -350 and 350 degrees.
    #[test]
    fn poses_beyond_the_limits_and_in_radians_are_reported() {
        let poses = |axes: &[[f64; AXES]]| -> Vec<(usize, AxisAngles)> {
            axes.iter()
                .map(|deg| AxisAngles::from_degrees(*deg))
                .zip(1..)
                .map(|(axes, at)| (at, axes))
                .collect()
        };
        let of = |axes: &[[f64; AXES]]| beyond(poses(axes).into_iter(), &robot());
        let upright = [10.0, -90.0, 90.0, 0.0, 30.0, 0.0];
        let with = |axis: usize, deg: f64| {
            let mut axes = upright;
            axes[axis] = deg;
            axes
        };
        assert!(of(&[upright, with(1, 36.0), with(1, -136.0), with(3, 351.0)]).is_none());
        let found = of(&[upright, with(1, 36.1), with(0, -186.1)]);
        assert!(matches!(found, Some(MeasurementFinding::BeyondLimits { rows: 2, index: 2, axis: 2, .. })));
        // A wrist axis of more than 540 degrees may be given by another turn.
        assert!(of(&[with(5, 700.0)]).is_none());
        let small = [0.1, -1.2, 1.3, 0.4, 0.5, 0.6];
        assert!(matches!(of(&[small; 3]), Some(MeasurementFinding::Radians { rows: 3 })));
        assert!(of(&[[1.0, -2.0, 3.0, 0.0, 0.0, 0.0]; 3]).is_none(), "whole numbers are degrees");
        let mut mixed = vec![upright; 10];
        mixed[4] = [0.1234, -1.2345, 1.3456, 0.4567, 0.5678, 0.6789];
        assert!(matches!(of(&mixed), Some(MeasurementFinding::RowsInRadians { rows: 1, index: 5 })));
        assert!(of(&mixed[3..6]).is_none(), "a third of the poses is near zero");
    }

    /// The file of the robot lists its payloads in another order than the rows.
    #[test]
    fn payloads_are_those_of_the_robot_and_read_back() {
        let rows = ["1,1,0,0,0,0,0,0,300,gripper", "2,1,1,0,0,0,0,0,300,", "3,1,2,0,0,0,0,0,300,bar"];
        let read = table(",payload", &rows).unwrap();
        let payload = |name: &str| Payload { name: name.into(), ..Payload::default() };
        let load =
            |names: [&str; 3]| ArmLoad { payloads: names.map(payload).to_vec(), ..ArmLoad::known(vec![]) };
        let carrying = read.clone().carrying(&load(["fork", "bar", "gripper"])).unwrap();
        let places = |of: &Measurements| of.rows.iter().map(|row| row.payload.index()).collect::<Vec<_>>();
        // Without a name in the row the robot carries the first payload.
        assert_eq!(places(&carrying), [2, 0, 1]);
        let again = Measurements::from_csv("t.csv", &carrying.to_csv()).unwrap();
        assert_eq!(places(&again.carrying(&load(["gripper", "fork", "bar"])).unwrap()), [0, 1, 2]);
        let lacking = read.carrying(&load(["fork", "grip", "gripper"])).unwrap_err();
        assert!(matches!(lacking, RobotFinding::PayloadOfRow { index: 3, .. }), "{lacking:?}");
        // Without the column nothing is asked of the robot.
        let plain = table("", &["1,1,0,0,0,0,0,0,300"]).unwrap();
        assert_eq!(plain.clone().carrying(&ArmLoad::known(vec![])).unwrap(), plain);
        assert!(!plain.to_csv().contains("payload"));
    }

    #[test]
    fn temperatures_that_are_not_those_of_a_room_are_reported() {
        let of = |temperatures: &[f64]| {
            let rows: Vec<String> = temperatures.iter().map(|c| format!("1,1,0,0,0,0,0,0,300,{c}")).collect();
            table(",temp_c", &rows.iter().map(String::as_str).collect::<Vec<_>>()).unwrap()
        };
        assert_eq!(of(&[20.0, 23.0]).mean_temperature_c(), Some(21.5));
        assert!(of(&[20.0, 0.0]).warm().is_none() && of(&[45.0]).warm().is_none());
        assert!(matches!(of(&[45.1]).warm(), Some(PlausibilityFinding::UnusualUnit { value: 45.1, .. })));
        assert!(matches!(of(&[0.0, 0.0]).warm(), Some(PlausibilityFinding::AlwaysZero { .. })));
        assert!(matches!(of(&[20.0, -30.5]).warm(), Some(PlausibilityFinding::Unusual { value: -30.5, .. })));
        assert!(matches!(
            of(&[5.0, 80.5]).warm(),
            Some(PlausibilityFinding::UnusualUnit { value: 80.5, .. })
        ));
        assert_eq!(table("", &["1,1,0,0,0,0,0,0,300"]).unwrap().mean_temperature_c(), None);
    }
}
