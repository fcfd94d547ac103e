//! Measurements with the axis angles they were made at, and the observations CSV of the lengths among them.

use std::f64::consts::TAU;
use std::fmt::Write;
use std::iter;
use std::sync::Arc;

use super::{Column, Context, context};
use crate::base::table::{Row, Table};
use crate::catalogue::MeasurementFinding::{
    self, BarWithoutLength, NoMeasurement, NoPose, NotASense, TooMany, TooManyTargets, UnknownBall,
    UnknownBar, UnknownTarget, UnseenTarget, UntrackedPosition,
};
use crate::diagnostic::Diagnostic;
use crate::robot::parameter::SetUp;
use crate::robot::{AXES, Approach, AxisAngles, BarId, Datum, Robot, TargetId};

/// One length at one pose; a position is three of them, one for each plane of the tracker's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The user's number for it; the plan's, where there is a plan.
    pub index: u32,
    pub datum: Datum,
    pub target: TargetId,
    pub axes: AxisAngles,
    /// How the axes came to the pose.
    pub approach: Approach,
    /// Distance between the ball centres, the bar's length plus its reading; from a plane the coordinate, which has a sign.
    pub length_mm: f64,
    /// Standard deviation of the length, where it is known.
    pub sigma_mm: Option<f64>,
    /// Shared by rows alike, absent where nothing is known: a million lengths stay near 100 bytes each.
    pub context: Option<Arc<Context>>,
}

impl Measurement {
    /// Its line of the CSV.
    fn append(&self, optional: Optional, columns: &[Column], text: &mut String) {
        // Writing to a string does not fail.
        let Datum::Ball(ball, bar) = self.datum else { return };
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
        optional.approach.append(self, text);
        match &self.context {
            Some(context) => context.append(columns, text),
            None => text.extend(columns.iter().map(|_| ',')),
        }
        text.push('\n');
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurements {
    pub rows: Vec<Measurement>,
    /// The further columns, in the order in which they are written.
    pub columns: Vec<Column>,
}

/// The columns that a row must have, in the order in which they are written.
const REQUIRED: [&str; 9] =
    ["index", "centre", "a1_deg", "a2_deg", "a3_deg", "a4_deg", "a5_deg", "a6_deg", "length_mm"];
const SIGMA: &str = "sigma_mm";
const BAR: &str = "bar";
pub(super) const TARGET: &str = "target";
/// Columns with the sense of approach, -1, 0 (not known) or 1 (by rising angles).
pub const APPROACH: [&str; AXES] =
    ["approach1", "approach2", "approach3", "approach4", "approach5", "approach6"];

/// Which of the columns that may be absent are written.
#[derive(Clone, Copy)]
struct Optional {
    bars: bool,
    targets: bool,
    approach: Approaching,
}

/// Whether rows are written with the columns of the sense of approach.
#[derive(Clone, Copy)]
pub(super) struct Approaching {
    pub(super) is_known: bool,
}

impl Approaching {
    pub(super) fn of<'a>(mut rows: impl Iterator<Item = &'a Measurement>) -> Self {
        Self { is_known: rows.any(|row| !row.approach.is_unknown()) }
    }

    /// The cells of a row, each after a comma.
    pub(super) fn append(self, row: &Measurement, text: &mut String) {
        for sense in row.approach.senses().into_iter().filter(|_| self.is_known) {
            let _ = write!(text, ",{sense}");
        }
    }
}

/// Base balls and bars of one calibration: each adds unknowns, and the time grows with their cube.
pub const MOST_BALLS: usize = 100;
pub(super) const MOST_BARS: usize = 20;
const MOST_TARGETS: usize = 20;

/// Rows of a piece of CSV.
const PIECE: usize = 4096;

impl Measurements {
    /// Reads the CSV `index,centre,a1_deg,..,a6_deg,length_mm[,sigma_mm][,bar][,target][,approach1,..,approach6][,..]`; columns in any
    /// order, an absent bar is bar 1, an absent target the tool ball.
    pub fn from_csv(file: &str, text: &str) -> Result<Self, Diagnostic> {
        Self::from_table(&mut Table::of(file, text)?)
    }

    /// Reads the same from a table, a row at a time.
    pub fn from_table(table: &mut Table<'_>) -> Result<Self, Diagnostic> {
        let places = table.required(REQUIRED)?;
        let (sigma, bar) = (table.optional(SIGMA)?, table.optional(BAR)?);
        let (target, approach) = (table.optional(TARGET)?, ApproachColumns::of(table)?);
        let known = |at: &usize| {
            places.contains(at)
                || [sigma, bar, target].contains(&Some(*at))
                || approach.0.contains(&Some(*at))
        };
        let others: Vec<usize> = (0..table.names().len()).filter(|at| !known(at)).collect();
        let further: Vec<Column> = others.iter().map(|&at| Column::of(&table.names()[at])).collect();
        let [index, ball, axes @ .., length] = places;
        let mut rows: Vec<Measurement> = Vec::new();
        while let Some(row) = table.row()? {
            let (axes, length_mm) = (angles(&row, axes)?, distance(&row, length)?);
            let context = Context::read(&further, others.iter().map(|&at| row.plain(at)));
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
                context: shared(context, before),
            });
        }
        Self::new(rows, further).map_err(|finding| Diagnostic::file(table.file(), finding))
    }

    /// Of these rows, with the further columns that their contexts have.
    ///
    /// # Errors
    /// No row, too many balls, bars or targets, a bar without a length, a target without a measurement.
    pub fn new(rows: Vec<Measurement>, columns: Vec<Column>) -> Result<Self, MeasurementFinding> {
        if rows.is_empty() {
            return Err(NoMeasurement);
        }
        let set = Self { rows, columns };
        let (balls, bars) = (set.balls(), set.bars());
        if balls > MOST_BALLS || bars > MOST_BARS {
            return Err(TooMany { balls, bars, most_balls: MOST_BALLS, most_bars: MOST_BARS });
        }
        let is_without = |bar: &BarId| set.rows.iter().all(|row| row.datum.bar() != Some(*bar));
        if let Some(absent) = (0..set.bars()).map(BarId::at).find(is_without) {
            return Err(BarWithoutLength { bar: absent.number() });
        }
        let targets = set.targets();
        if targets > MOST_TARGETS {
            return Err(TooManyTargets { targets, most: MOST_TARGETS });
        }
        let is_unseen = |target: &TargetId| set.rows.iter().all(|row| row.target != *target);
        match (1..targets).map(TargetId::at).find(is_unseen) {
            None => Ok(set),
            Some(absent) => Err(UnseenTarget { target: absent.number() }),
        }
    }

    /// With those of the same robot in a further table; the further columns stay those of this one.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn and(mut self, further: &Self) -> Result<Self, MeasurementFinding> {
        let plain = |row: &Measurement| Measurement { context: None, ..row.clone() };
        self.rows.extend(further.rows.iter().map(plain));
        Self::new(self.rows, self.columns)
    }

    /// Reads only the axis angles of a table with the columns a1_deg..a6_deg, and the senses of approach that it has.
    pub fn poses_from_table(table: &mut Table<'_>) -> Result<Vec<ApproachedPose>, Diagnostic> {
        let [_, _, names @ .., _] = REQUIRED;
        let axes = table.required::<AXES>(names)?;
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

    /// Writes the CSV of the lengths; every number reads back bit for bit.
    pub fn to_csv(&self) -> String {
        self.csv_pieces(|_| true).collect()
    }

    /// The CSV of the rows that `keep` wants by their places, in pieces, so that a long one need never be whole in memory.
    pub fn csv_pieces(&self, keep: impl Fn(usize) -> bool) -> impl Iterator<Item = String> {
        let lengths = || self.rows.iter().filter(|row| !row.datum.is_plane());
        let targets = lengths().any(|row| row.target != TargetId::FIRST);
        let optional = Optional { bars: self.bars() > 1, targets, approach: Approaching::of(lengths()) };
        let pieces = self.rows.chunks(PIECE).enumerate().map(move |(piece, rows)| {
            let mut text = String::new();
            for (at, row) in rows.iter().enumerate() {
                if keep(PIECE * piece + at) {
                    row.append(optional, &self.columns, &mut text);
                }
            }
            text
        });
        iter::once(self.header(optional)).chain(pieces)
    }

    fn header(&self, optional: Optional) -> String {
        let mut text = format!("{},{SIGMA}", REQUIRED.join(","));
        if optional.bars {
            text.push_str(&format!(",{BAR}"));
        }
        if optional.targets {
            text.push_str(&format!(",{TARGET}"));
        }
        if optional.approach.is_known {
            text.push_str(&format!(",{}", APPROACH.join(",")));
        }
        for column in &self.columns {
            text.push_str(&format!(",{}", context::quoted(column.name())));
        }
        text.push('\n');
        text
    }

    pub fn check(&self, file: &str, set_up: SetUp) -> Result<(), Diagnostic> {
        let SetUp { balls, bars, targets, trackers } = set_up;
        let unknown = self.rows.iter().find_map(|&Measurement { index, datum, target, .. }| {
            if target.index() >= targets {
                return Some(UnknownTarget { index, target: target.number(), targets });
            }
            let Datum::Ball(ball, bar) = datum else {
                return (trackers == 0).then_some(UntrackedPosition { index });
            };
            if ball.index() >= balls {
                Some(UnknownBall { index, ball: ball.number(), balls })
            } else {
                (bar.index() >= bars).then(|| UnknownBar { index, bar: bar.number(), bars })
            }
        });
        unknown.map_or(Ok(()), |finding| Err(Diagnostic::file(file, finding)))
    }

    /// That some rows have a standard deviation and others none.
    pub fn without_sigma(&self) -> Option<MeasurementFinding> {
        let (rows, without) =
            (self.rows.len(), self.rows.iter().filter(|row| row.sigma_mm.is_none()).count());
        (0 < without && without < rows).then_some(MeasurementFinding::SigmaMissing { without, rows })
    }

    /// That rows are at axis angles beyond a robot's limits.
    pub fn beyond(&self, robot: &Robot) -> Option<MeasurementFinding> {
        beyond(self.rows.iter().map(|row| (row.index as usize, row.axes)), robot)
    }

    /// Mean temperature of the rows that have one, degrees Celsius.
    pub fn mean_temperature_c(&self) -> Option<f64> {
        let found = self.rows.iter().filter_map(|row| row.context.as_ref()?.temperature_c);
        let (sum, count) = found.fold((0.0, 0), |(sum, count), celsius| (sum + celsius, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    }

    /// That the temperatures of its rows are those of no room.
    pub fn warm(&self) -> Option<MeasurementFinding> {
        /// 50 degrees Fahrenheit and more are above, degrees Celsius.
        const WARMEST_C: f64 = 45.0;
        /// Sensors that are missing or faulty show what is beyond, degrees Celsius.
        const COLDEST_C: f64 = -30.0;
        const HOTTEST_C: f64 = 80.0;
        let found = self.rows.iter().filter_map(|row| row.context.as_ref()?.temperature_c);
        let found: Vec<f64> = found.collect();
        let mean_c = self.mean_temperature_c()?;
        if mean_c > WARMEST_C {
            return Some(MeasurementFinding::WarmRoom { mean_c });
        }
        let is_none = |celsius: f64| !(COLDEST_C..=HOTTEST_C).contains(&celsius);
        let all_zero = found.iter().all(|celsius| *celsius == 0.0);
        let celsius = found.iter().copied().find(|celsius| all_zero || is_none(*celsius))?;
        let rows = found.iter().filter(|other| **other == celsius).count();
        Some(MeasurementFinding::NoTemperature { rows, celsius })
    }

    /// The set-up that the rows are of, with so many base balls.
    pub fn set_up(&self, balls: usize) -> SetUp {
        let trackers = usize::from(self.rows.iter().any(|row| row.datum.is_plane()));
        SetUp { balls, bars: self.bars(), targets: self.targets(), trackers }
    }

    /// How many measurements there are: a position counts once.
    pub fn count(&self) -> usize {
        self.rows.iter().filter(|row| row.datum.is_first()).count()
    }

    /// The number of targets, the tool ball among them: the highest number of one.
    pub fn targets(&self) -> usize {
        self.rows.iter().map(|row| row.target.index() + 1).max().unwrap_or(1)
    }

    /// The number of bars: the highest number of one; none without lengths.
    pub fn bars(&self) -> usize {
        self.rows.iter().filter_map(|row| Some(row.datum.bar()?.index() + 1)).max().unwrap_or(0)
    }

    /// The number of base balls: the highest number of one.
    pub fn balls(&self) -> usize {
        self.rows.iter().filter_map(|row| Some(row.datum.ball()?.index() + 1)).max().unwrap_or(0)
    }
}

/// The poses, each with its number, that no axis angles within the robot's limits give: those of another robot, or typing
/// errors.
pub fn beyond(poses: impl Iterator<Item = (usize, AxisAngles)>, robot: &Robot) -> Option<MeasurementFinding> {
    /// Controllers let an axis come to its very limit, and a little beyond.
    const BEYOND_DEG: f64 = 1.0;
    let all: Vec<(usize, AxisAngles)> = poses.collect();
    let beyond = all.iter().filter_map(|&(number, axes)| {
        let out = |(deg, [low, high]): (&f64, &[f64; 2])| {
            // Limits of one and a half turns are those of a wrist: a pose may be given by another of its turns.
            let turned = if high - low >= 540.0 { low + (deg - low).rem_euclid(360.0) } else { *deg };
            turned < low - BEYOND_DEG || turned > high + BEYOND_DEG
        };
        let axes_deg = axes.degrees();
        let axis = axes_deg.iter().zip(&robot.limits_at_deg(&axes_deg)).position(out)?;
        Some((number, axis + 1, axes_deg[axis]))
    });
    let beyond: Vec<_> = beyond.collect();
    let Some(&(index, axis, deg)) = beyond.first() else { return in_radians(&all) };
    Some(MeasurementFinding::BeyondLimits { rows: beyond.len(), index, axis, deg })
}

/// That axis angles of several poses are all small numbers with decimals.
fn in_radians(poses: &[(usize, AxisAngles)]) -> Option<MeasurementFinding> {
    const LEAST_ROWS: usize = 3;
    let angles = || poses.iter().flat_map(|(_, axes)| axes.degrees());
    let decimals = angles().filter(|angle| angle.fract() != 0.0).count();
    let small = angles().all(|angle| angle.abs() <= TAU);
    if small && poses.len() >= LEAST_ROWS && 2 * decimals >= angles().count() {
        return Some(MeasurementFinding::Radians { rows: poses.len() });
    }
    single_in_radians(poses)
}

/// Single poses whose angles are all small numbers with decimals, among poses with others.
fn single_in_radians(poses: &[(usize, AxisAngles)]) -> Option<MeasurementFinding> {
    const LEAST_DECIMALS: usize = 4;
    /// Where more poses are so, the arm is near to its zero.
    const FEW: f64 = 0.2;
    let is_small = |(_, axes): &&(usize, AxisAngles)| {
        let deg = axes.degrees();
        let decimals = deg.iter().filter(|deg| (*deg * 1e3).fract() != 0.0).count();
        decimals >= LEAST_DECIMALS && deg.iter().all(|deg| deg.abs() <= TAU)
    };
    let found: Vec<_> = poses.iter().filter(is_small).collect();
    let &&(index, _) = found.first()?;
    ((found.len() as f64) < FEW * poses.len() as f64)
        .then_some(MeasurementFinding::RowsInRadians { rows: found.len(), index })
}

/// A pose of a table, and how the axes came to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachedPose {
    pub axes: AxisAngles,
    pub approach: Approach,
}

/// The columns with the sense of approach, those that there are.
pub(super) struct ApproachColumns([Option<usize>; AXES]);

impl ApproachColumns {
    pub(super) fn of(table: &Table<'_>) -> Result<Self, Diagnostic> {
        let mut places = [None; AXES];
        for (place, name) in places.iter_mut().zip(APPROACH) {
            *place = table.optional(name)?;
        }
        Ok(Self(places))
    }

    pub(super) fn read(&self, row: &Row<'_>) -> Result<Approach, Diagnostic> {
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

/// A context, the one before where it is alike, none where nothing is known.
fn shared(context: Context, before: Option<&Arc<Context>>) -> Option<Arc<Context>> {
    match before {
        _ if context == Context::default() => None,
        Some(before) if **before == context => Some(Arc::clone(before)),
        _ => Some(Arc::new(context)),
    }
}

pub(super) fn angles(row: &Row<'_>, places: [usize; AXES]) -> Result<AxisAngles, Diagnostic> {
    let mut axes_deg = [0.0; AXES];
    for (angle, at) in axes_deg.iter_mut().zip(places) {
        *angle = row.number(at)?;
    }
    Ok(AxisAngles::from_degrees(axes_deg))
}

/// The length of a row. A bar's reading, taken for it, is negative where the bar is short.
fn distance(row: &Row<'_>, at: usize) -> Result<f64, Diagnostic> {
    row.number(at)?;
    row.positive(at).map_err(|wrong| {
        wrong.help("is it the bar's reading? length_mm is between the ball centres: the bar's length plus the reading")
    })
}
