//! Whether a value is plausible: one table of quantities with the range of each, and the units that are mistaken for
//! its unit. This room must not know where a value was written: it takes a number and the name of its key.
//!
//! A range has one reason, which is the comment of its row. A value outside of the range is refused: a result would be
//! computed with it that nobody can recognise as wrong. Whole tables (equal rows, decimals) are checked where they are
//! read.

mod catalogue;
pub use catalogue::PlausibilityFinding;

use std::f64::consts::{PI, TAU};
use std::fmt;

use serde::{Serialize, Serializer};

/// A unit that is mistaken for the unit of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherUnit {
    /// Name of the unit in the plural.
    pub name: &'static str,
    /// The value that is 0 in the unit of the quantity.
    pub zero: f64,
    /// Number of the quantity's units in one of this unit.
    pub factor: f64,
}

const fn unit(name: &'static str, factor: f64) -> OtherUnit {
    OtherUnit { name, zero: 0.0, factor }
}

const METRES: OtherUnit = unit("metres", 1e3);
const MICROMETRES: OtherUnit = unit("micrometres", 1e-3);
const RADIANS: OtherUnit = unit("radians", 180.0 / PI);
/// Units in which lengths in mm are given by mistake.
pub const LENGTH_UNITS: &[OtherUnit] =
    &[METRES, unit("centimetres", 10.0), unit("inches", 25.4), MICROMETRES];
/// Units in which angles in degrees are given by mistake.
pub const ANGLE_UNITS: &[OtherUnit] = &[RADIANS, unit("gon", 0.9)];
const KELVIN: OtherUnit = OtherUnit { name: "kelvin", zero: 273.15, factor: 1.0 };
const TEMPERATURE_UNITS: &[OtherUnit] =
    &[OtherUnit { name: "degrees Fahrenheit", zero: 32.0, factor: 5.0 / 9.0 }, KELVIN];
const IN_KELVIN: &[OtherUnit] = &[KELVIN];
const IN_METRES: &[OtherUnit] = &[METRES];
const IN_MICROMETRES: &[OtherUnit] = &[MICROMETRES];
const IN_METRES_OR_MICROMETRES: &[OtherUnit] = &[METRES, MICROMETRES];
const IN_RADIANS: &[OtherUnit] = &[RADIANS];
const IN_DEGREES: &[OtherUnit] = &[unit("degrees", PI / 180.0)];
const IN_RADIANS_PER_SECOND: &[OtherUnit] = &[unit("rad/s", 180.0 / PI)];
const IN_METRES_PER_SECOND: &[OtherUnit] = &[unit("m/s", 1e3)];
const IN_MICROMETRES_PER_METRE: &[OtherUnit] = &[unit("micrometres per metre and kelvin", 1e-6)];
const IN_MILLISECONDS: &[OtherUnit] = &[unit("ms", 1e-3)];
const IN_GRAMS: &[OtherUnit] = &[unit("grams", 1e-3)];

impl OtherUnit {
    /// A number of this unit in the unit of the quantity.
    fn convert(self, value: f64) -> f64 {
        (value - self.zero) * self.factor
    }
}

/// The possible values of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PlausibleRange {
    pub quantity: &'static str,
    /// Empty for a number without a unit.
    pub unit: &'static str,
    pub least: f64,
    pub most: f64,
    /// The range of measured values; by default the range of possible values.
    #[serde(skip)]
    usual: [f64; 2],
    #[serde(skip)]
    other_units: &'static [OtherUnit],
    /// Whether multiples of an eighth of a turn in radians are refused.
    #[serde(skip)]
    degrees: bool,
}

/// The range of a quantity that a row of the table begins with.
const fn range(quantity: &'static str, unit: &'static str, least: f64, most: f64) -> PlausibleRange {
    PlausibleRange { quantity, unit, least, most, usual: [least, most], other_units: &[], degrees: false }
}

impl PlausibleRange {
    const fn usually(self, least: f64, most: f64) -> Self {
        Self { usual: [least, most], ..self }
    }

    const fn not_in(self, other_units: &'static [OtherUnit]) -> Self {
        Self { other_units, ..self }
    }

    const fn in_degrees(self) -> Self {
        Self { degrees: true, other_units: IN_RADIANS, ..self }
    }

    /// The same quantity with a least value that another part of the input gives.
    #[must_use]
    pub fn from(self, least: f64) -> Self {
        Self { least, ..self }
    }

    /// The same quantity with a greatest value that another part of the input gives.
    #[must_use]
    pub fn to(self, most: f64) -> Self {
        Self { most, ..self }
    }

    /// Refuses a value outside of the range, which NaN is.
    pub fn check(self, key: impl Into<ValueKey>, value: f64) -> Result<(), PlausibilityFinding> {
        let key = key.into();
        if self.degrees && is_part_of_turn(value) {
            let meant = RADIANS.name;
            return Err(PlausibilityFinding::InOtherUnit { key, value, range: Box::new(self), meant });
        }
        if (self.least..=self.most).contains(&value) {
            return Ok(());
        }
        Err(match self.meant(value) {
            Some(meant) => PlausibilityFinding::InOtherUnit { key, value, range: Box::new(self), meant },
            None => PlausibilityFinding::Outside { key, value, range: Box::new(self) },
        })
    }

    /// The unit in which a value would be a usual one.
    fn meant(self, value: f64) -> Option<&'static str> {
        let [least, most] = self.usual;
        let fits = |unit: &&OtherUnit| (least..=most).contains(&unit.convert(value));
        self.other_units.iter().find(fits).map(|unit| unit.name)
    }
}

impl fmt::Display for PlausibleRange {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { quantity, unit, least, most, .. } = self;
        let blank = if unit.is_empty() { "" } else { " " };
        write!(out, "{quantity} is ")?;
        if *least == POSITIVE {
            out.write_str("above 0, up to ")?
        } else {
            write!(out, "{least} to ")?
        }
        write!(out, "{most}{blank}{unit}")
    }
}

/// The key, column or name of a value; nothing where the place of the finding says it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ValueKey(pub Option<String>);

impl ValueKey {
    /// For a value whose place the caller names.
    pub const NONE: Self = Self(None);
}

impl<T: Into<String>> From<T> for ValueKey {
    fn from(key: T) -> Self {
        Self(Some(key.into()))
    }
}

impl fmt::Display for ValueKey {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.as_ref().map_or(Ok(()), |key| write!(out, "{key} = "))
    }
}

impl Serialize for ValueKey {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

/// The table: a quantity, the reason of its range, and the range.
macro_rules! quantities {
    ($( $(#[$reason:meta])+ $name:ident => $range:expr; )+) => {
        /// The kind of a value.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Quantity { $( $(#[$reason])+ $name, )+ }

        impl Quantity {
            pub const ALL: &[Self] = &[$( Self::$name ),+];

            /// The possible values of the quantity.
            pub const fn range(self) -> PlausibleRange {
                match self { $( Self::$name => $range, )+ }
            }
        }
    };
}

/// The smallest number that counts as positive: below a picometre or a nanosecond nothing is given.
pub const POSITIVE: f64 = 1e-9;
/// No length (mm), angle (degrees), speed or time of a job is larger.
const MAX_NUMBER: f64 = 1e5;
/// Arms and their tools are shorter, mm.
const MAX_ARM_MM: f64 = 1e4;
/// A kilometre: farther away, rounding an angle to 16 digits moves the arm.
const MAX_OFFSET_MM: f64 = 1e6;

quantities! {
    /// Gauges between balls are longer than a fingertip. No telescoping bar is longer than ten metres.
    BarLength => range("the length of a bar", "mm", 10.0, 1e4).usually(50.0, 3e3).not_in(LENGTH_UNITS);
    /// The range goes from 10 nm, the noise of the best sensors, to the accuracy of a rope.
    LengthSd => range("the standard deviation of a length", "mm", 1e-5, 1.0).usually(5e-4, 0.1).not_in(IN_METRES_OR_MICROMETRES);
    /// Stated with k = 2. No certificate of a length is better than 0.1 µm; half a millimetre is a ruler.
    ExpandedLengthUncertainty => range("the expanded uncertainty of a length", "mm", 1e-4, 0.5).usually(2e-4, 0.05).not_in(IN_METRES_OR_MICROMETRES);
    /// Half of the least expanded uncertainty; otherwise as there.
    StandardLengthUncertainty => range("the standard uncertainty of a length", "mm", 5e-5, 0.5).usually(1e-4, 0.05).not_in(IN_METRES_OR_MICROMETRES);
    /// Laboratories certify at 20 degrees, some cells at their own temperature.
    CertificateTemperature => range("the temperature of a certificate", "degrees Celsius", 0.0, 50.0).not_in(TEMPERATURE_UNITS);
    /// The range goes from carbon fibre, which shrinks, to zinc.
    Expansion => range("a thermal expansion", "1/K", -2e-6, 5e-5).not_in(IN_MICROMETRES_PER_METRE);
    /// The temperatures in which people work. A missing sensor reads less, or more. A mean above 45 degrees is in
    /// Fahrenheit.
    Temperature => range("a temperature of a cell", "degrees Celsius", -30.0, 60.0).usually(-30.0, 45.0).not_in(TEMPERATURE_UNITS);
    /// The values that the sensor of a bar can give; a larger number is in kelvin.
    SensorTemperature => range("the temperature of a bar", "degrees Celsius", -273.15, 150.0).not_in(IN_KELVIN);
    /// Stated with k = 2: thermometers resolve a millikelvin. Twenty kelvins is no measurement.
    TemperatureUncertainty => range("the expanded uncertainty of a temperature", "K", 0.001, 20.0);
    /// The largest robots carry 2300 kg.
    Load => range("the load of a robot", "kg", 0.0, 2500.0).not_in(IN_GRAMS);
    /// A hand pulls no harder, and the springs of bars are weaker; a bar that pushes has a negative force.
    BarForce => range("the pull of a bar", "N", -500.0, 500.0);
    /// No arm and no part of it is heavier.
    Mass => range("a mass of a robot", "kg", 0.0, 5e3).not_in(IN_GRAMS);

    /// A length of a job that has no reason of its own.
    Length => range("a length", "mm", POSITIVE, MAX_NUMBER);
    /// A coordinate or an angle of a job.
    Coordinate => range("a coordinate or an angle", "mm or degrees", -MAX_NUMBER, MAX_NUMBER);
    /// The length of a vector that gives a direction: it must not vanish.
    DirectionLength => range("the length of a direction", "", 1e-6, MAX_NUMBER);
    /// Bars, tools and arms are thicker.
    BodyRadius => range("the radius of a bar, a tool or an arm", "mm", 1.0, MAX_NUMBER).usually(5.0, 1e3).not_in(IN_METRES);
    /// A ball is not in the foot of the robot, and no farther away than arm and bar reach: the robot gives both ends.
    BaseBallDistance => range("the distance of a base ball from the robot", "mm", POSITIVE, 2.0 * MAX_ARM_MM).usually(100.0, MAX_ARM_MM).not_in(IN_METRES_OR_MICROMETRES);
    /// A smaller box, cylinder or height is one in metres.
    BodySize => range("the size of an obstacle or of a workspace", "mm", 3.0, 1e6).usually(10.0, MAX_NUMBER).not_in(IN_METRES);
    /// The distance of a frame that is not 0 from the one before: tools and bases are larger than a few millimetres, and
    /// inside of a cell.
    FrameDistance => range("the distance of a tool or a base", "mm", 3.0, 1e4).usually(5.0, 1e4).not_in(LENGTH_UNITS);
    /// Robots stand up to some ten metres from the origin of a cell, and also a tenth of a millimetre beside it.
    WorldCoordinate => range("a coordinate in the World of a cell", "mm", -1e5, 1e5).not_in(IN_MICROMETRES);
    /// The largest coordinate of a tool ball that is not 0: no ball is nearer to the centre of the flange.
    ToolBallDistance => range("the distance of a tool ball from the flange", "mm", 3.0, MAX_ARM_MM).usually(5.0, 2e3).not_in(IN_METRES);
    /// The distance of a centre of mass that is not the centre of the flange; otherwise as a tool ball.
    PayloadDistance => range("the distance of a payload's centre from the flange", "mm", 3.0, MAX_ARM_MM).usually(5.0, 2e3).not_in(IN_METRES);
    /// The largest speed with a mounted bar is that of a controller's test mode; a speed below the least is in m/s.
    Feed => range("a feed with a mounted bar", "mm/s", 0.5, 250.0).not_in(IN_METRES_PER_SECOND);
    /// Nothing turns slower in a program, and no axis of a robot turns faster.
    TurnSpeed => range("a turning speed", "degrees/s", 0.01, 1000.0);
    /// No bar sends enough readings in a shorter dwell; a longer wait is a mistake.
    DwellTime => range("a dwell", "s", 0.05, 60.0).not_in(IN_MILLISECONDS);
    /// A longer wait is a mistake.
    SettleTime => range("a time to settle", "s", POSITIVE, 60.0);
    /// An angle of at most a right angle.
    LimitAngle => range("a smallest angle", "degrees", 0.0, 90.0);
    /// A distance that is smaller than a cell.
    LimitDistance => range("a smallest distance", "mm", 0.0, 1e4);
    /// A probability is from 0 to 1 by definition.
    Probability => range("a probability", "", 0.0, 1.0);
    /// A shorter arc is one in radians.
    Arc => range("an arc", "degrees", 7.0, 360.0).usually(10.0, 360.0).not_in(IN_RADIANS);
    /// Up to half a turn.
    HalfTurn => range("an angle up to half a turn", "degrees", POSITIVE, 180.0);
    /// Up to half a turn; 0 turns nothing.
    Amplitude => range("the amplitude of an orientation", "degrees", 0.0, 180.0);
    /// Fewer poses determine no robot; with more the run takes hours, in which everything drifts.
    PoseCount => range("a number of poses", "", 6.0, 1000.0);
    /// No robot is calibrated to a micrometre, and none needs a calibration for a centimetre.
    PositionGoal => range("a position error to reach", "mm", 1e-3, 10.0).usually(0.01, 3.0).not_in(IN_METRES_OR_MICROMETRES);
    /// A shorter time measures nothing; with more than a week the robot has changed.
    RunMinutes => range("the time of a run", "min", 1.0, 1e4);
    /// Nobody mounts anything for longer than a shift.
    MountingMinutes => range("the time to mount a ball or a bar", "min", 0.0, 500.0);
    /// A dwell at least, and less than a coffee break.
    PoseSeconds => range("the time of a pose", "s", 0.1, 600.0);
    /// Ten for each pose; the exchange of more takes hours.
    CandidateCount => range("a number of candidates", "", 0.0, 1e5);
    /// Fewer show no form of a circle; more are nearer to each other than a tenth of a degree.
    CirclePoints => range("a number of points on a circle", "", 12.0, 3600.0);
    /// Each ball adds unknowns, and the time grows with their cube.
    BallNumber => range("the number of a base ball", "", 1.0, 100.0);

    /// Arms are shorter.
    ArmLength => range("a length of an arm", "mm", -MAX_ARM_MM, MAX_ARM_MM).not_in(IN_MICROMETRES);
    /// Axes with an angle of 1e-5 between them have their common normal a hundred metres away.
    CancelledOffset => range("an offset that another one cancels", "mm", -MAX_OFFSET_MM, MAX_OFFSET_MM);
    /// Angles between axes are mostly multiples of a right angle: in radians these are easily recognised.
    AxisAngle => range("an angle between axes", "degrees", -MAX_NUMBER, MAX_NUMBER).in_degrees();
    /// A small angle between nearly parallel axes.
    ParallelAxisAngle => range("an angle between parallel axes", "degrees", -MAX_NUMBER, MAX_NUMBER);
    /// An angle of a frame: mostly a multiple of an eighth of a turn.
    FrameAngle => range("an angle of a frame", "degrees", -MAX_NUMBER, MAX_NUMBER).in_degrees();
    /// The larger one of two limits: no joint turns less than this many degrees, and none more than a turn in radians.
    JointLimit => range("the larger limit of a joint", "degrees", TAU + 0.1, MAX_NUMBER).not_in(IN_RADIANS);
    /// Joints of heavy robots turn with 60 degrees/s.
    JointSpeed => range("the largest speed of a joint", "degrees/s", 6.0, MAX_NUMBER).not_in(IN_RADIANS_PER_SECOND);
    /// As the speed; only its sign is checked.
    JointAcceleration => range("the largest acceleration of a joint", "degrees/s²", POSITIVE, MAX_NUMBER);
    /// A coefficient of an error of a joint, rad: an error of a radian is none.
    JointCoefficient => range("a coefficient of a joint's error", "rad", -1.0, 1.0);
    /// The middle of a range of joint angles, in a few hundred turns.
    JointMiddle => range("a joint angle", "rad", -2e3, 2e3);
    /// The width of a range of joint angles.
    JointWidth => range("a range of joint angles", "rad", POSITIVE, 2e3);
    /// Every robot is built better than 100 mm, and no robot is known to better than a micrometre.
    LengthTolerance => range("the tolerance of a robot's lengths", "mm", 1e-3, 100.0).usually(0.01, 10.0).not_in(IN_METRES_OR_MICROMETRES);
    /// The reasons are those of the tolerance of lengths.
    AngleTolerance => range("the tolerance of a robot's angles", "degrees", 1e-3, 45.0).usually(1e-3, 5.0).not_in(ANGLE_UNITS);
    /// Pose repeatability by ISO 9283: the best robots repeat to a few micrometres, the largest to a few tenths of a
    /// millimetre.
    Repeatability => range("the repeatability of a robot", "mm", 5e-4, 5.0).usually(5e-3, 1.0).not_in(IN_METRES_OR_MICROMETRES);
    /// A prior standard deviation of a length of a robot: with more it is free.
    PriorLengthSd => range("the prior standard deviation of a length", "mm", 1e-8, 50.0).usually(1e-3, 50.0).not_in(IN_MICROMETRES);
    /// A prior standard deviation of an angle: with more than two degrees it is free.
    PriorAngleSd => range("the prior standard deviation of an angle", "rad", 1e-8, 0.04).not_in(IN_DEGREES);

    /// A robot is accepted to millimetres; a larger number is one in micrometres.
    PositionTolerance => range("a tolerance", "mm", POSITIVE, 20.0).not_in(IN_MICROMETRES);
    /// With half or more a decision is as good as its contrary.
    DecisionRisk => range("the risk of a wrong decision", "", POSITIVE, 0.49);
    /// No calibration moves a point this far.
    CorrectionLimit => range("the largest correction of a point", "mm", POSITIVE, 100.0).not_in(IN_MICROMETRES);
    /// Robots are checked between each day and each decade.
    CheckInterval => range("the interval of checks", "days", 1.0, 3650.0);
    /// A loss of power costs at most an hour.
    SyncInterval => range("the interval of synchronisation", "s", 0.0, 3600.0);
    /// A worker that is silent for a day is dead.
    WorkerLease => range("the silence of a worker", "s", 1.0, 86_400.0);
    /// The range goes from no error to a metre (µm), a second (ms) or many whole turns.
    SimulatedError => range("an error of the simulated world", "", 0.0, 1e6);
    /// Bars send at least every ten seconds.
    SampleRate => range("the rate of a bar", "Hz", 0.1, 1e5);
}

impl Quantity {
    /// Refuses a value that the quantity cannot have; `key` names it.
    pub fn check(self, key: impl Into<ValueKey>, value: f64) -> Result<(), PlausibilityFinding> {
        self.range().check(key, value)
    }

    /// A warning if a measured value is outside of the usual range.
    pub fn unusual(self, key: impl Into<ValueKey>, value: f64) -> Option<PlausibilityFinding> {
        let range = self.range();
        let [least, most] = range.usual;
        (!(least..=most).contains(&value)).then(|| range.warning(key.into(), value))
    }

    /// A warning if a measured value is impossible for the quantity.
    pub fn impossible(self, key: impl Into<ValueKey>, value: f64) -> Option<PlausibilityFinding> {
        let range = self.range();
        (!(range.least..=range.most).contains(&value)).then(|| range.warning(key.into(), value))
    }

    /// A warning that all values are 0, as from a sensor that is not connected.
    pub fn always_zero(self, key: impl Into<ValueKey>) -> PlausibilityFinding {
        PlausibilityFinding::AlwaysZero { key: key.into(), range: Box::new(self.range()) }
    }
}

impl PlausibleRange {
    fn warning(self, key: ValueKey, value: f64) -> PlausibilityFinding {
        match self.meant(value) {
            Some(meant) => PlausibilityFinding::UnusualUnit { key, value, range: Box::new(self), meant },
            None => PlausibilityFinding::Unusual { key, value, range: Box::new(self) },
        }
    }
}

/// Whether a number is a multiple of an eighth of a turn in radians: where degrees are expected, it was probably given in
/// radians.
fn is_part_of_turn(value: f64) -> bool {
    use std::f64::consts::FRAC_PI_4;
    /// The rounding of a number with five significant digits.
    const ROUNDED: f64 = 5e-5;
    let parts = (value / FRAC_PI_4).round();
    (1.0..=8.0).contains(&parts.abs()) && (value - parts * FRAC_PI_4).abs() < ROUNDED
}

#[cfg(test)]
mod tests {
    use super::*;
    use Quantity::*;

    /// Values of data sheets and certificates, and the same in another unit: KUKA KR 60 HA (Spez KR 30, 60-3), QC20-W
    /// ball-bar (Renishaw H-5650-8501), Heidenhain ACANTO, steel by DIN 1.0503.
    const MISTAKES: &[(Quantity, f64, f64, &str)] = &[
        (BarLength, 300.0, 0.3, "metres"),
        (LengthSd, 0.0014, 1.4, "micrometres"),
        (LengthSd, 0.0014, 1.4e-6, "metres"),
        (ExpandedLengthUncertainty, 0.002, 2.0, "micrometres"),
        (ExpandedLengthUncertainty, 0.002, 2e-6, "metres"),
        (StandardLengthUncertainty, 0.001, 1.0, "micrometres"),
        (CertificateTemperature, 20.0, 68.0, "degrees Fahrenheit"),
        (CertificateTemperature, 20.0, 293.15, "kelvin"),
        (Expansion, 11.5e-6, 11.5, "micrometres per metre and kelvin"),
        (Temperature, 21.2, 70.2, "degrees Fahrenheit"),
        (SensorTemperature, 21.2, 294.35, "kelvin"),
        (Load, 60.0, 60_000.0, "grams"),
        (Mass, 150.0, 150_000.0, "grams"),
        (BodyRadius, 20.0, 0.02, "metres"),
        (BodySize, 600.0, 0.6, "metres"),
        (FrameDistance, 210.0, 0.21, "metres"),
        (ToolBallDistance, 210.0, 0.21, "metres"),
        (Feed, 40.0, 0.04, "m/s"),
        (DwellTime, 0.4, 400.0, "ms"),
        (Arc, 216.0, 3.77, "radians"),
        (ArmLength, 350.0, 350_000.0, "micrometres"),
        (AxisAngle, 90.0, std::f64::consts::FRAC_PI_2, "radians"),
        (FrameAngle, -45.0, -std::f64::consts::FRAC_PI_4, "radians"),
        (JointLimit, 185.0, 3.2, "radians"),
        (JointSpeed, 128.0, 2.23, "rad/s"),
        (LengthTolerance, 0.5, 500.0, "micrometres"),
        (AngleTolerance, 0.05, 0.000_873, "radians"),
        (Repeatability, 0.05, 50.0, "micrometres"),
        (Repeatability, 0.05, 5e-5, "metres"),
        (PriorLengthSd, 0.5, 500.0, "micrometres"),
        (PriorAngleSd, 8.7e-4, 0.05, "degrees"),
        (PositionTolerance, 0.3, 300.0, "micrometres"),
        (CorrectionLimit, 5.0, 5000.0, "micrometres"),
    ];

    /// The unit that a check or a warning names.
    fn meant(quantity: Quantity, value: f64) -> Option<&'static str> {
        match quantity.check(ValueKey::NONE, value).err().or_else(|| quantity.unusual(ValueKey::NONE, value))
        {
            Some(
                PlausibilityFinding::InOtherUnit { meant, .. }
                | PlausibilityFinding::UnusualUnit { meant, .. },
            ) => Some(meant),
            _ => None,
        }
    }

    #[test]
    fn a_value_in_another_unit_is_refused_with_the_unit() {
        for &(quantity, value, mistaken, unit) in MISTAKES {
            assert_eq!(quantity.check(ValueKey::NONE, value), Ok(()), "{quantity:?}");
            assert_eq!(quantity.unusual(ValueKey::NONE, value), None, "{quantity:?}");
            assert_eq!(meant(quantity, mistaken), Some(unit), "{quantity:?}");
        }
    }

    #[test]
    fn the_ends_of_a_range_belong_to_it_and_no_nan_does() {
        for quantity in Quantity::ALL {
            let range = quantity.range();
            let [least, most] = range.usual;
            assert!(range.least <= least && least < most && most <= range.most, "{quantity:?}");
            let beyond = [range.least - range.least.abs().max(1.0), 2.0 * range.most.abs() + 1.0, f64::NAN];
            for value in [range.least, range.most] {
                assert_eq!(quantity.check(ValueKey::NONE, value), Ok(()), "{quantity:?}");
            }
            for value in beyond {
                assert!(quantity.check(ValueKey::NONE, value).is_err(), "{quantity:?}");
                assert!(quantity.impossible(ValueKey::NONE, value).is_some(), "{quantity:?}");
            }
        }
    }

    #[test]
    fn a_finding_carries_what_it_compared() {
        let finding = BarLength.check("length_mm", 0.3).unwrap_err();
        let values = crate::diagnostic::Finding::values(&finding);
        assert_eq!(values["key"], "length_mm");
        assert_eq!(values["value"], 0.3);
        assert_eq!(values["meant"], "metres");
        let range =
            serde_json::json!({"quantity": "the length of a bar", "unit": "mm", "least": 10.0, "most": 1e4});
        assert_eq!(values["range"], range);
    }

    #[test]
    fn parts_of_a_turn_in_radians_are_recognised() {
        use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};
        // With four decimals, as a person writes them.
        let written = |value: f64| (1e4 * value).round() * 1e-4;
        for (value, is_part) in [
            (written(FRAC_PI_2), true),
            (-written(FRAC_PI_4), true),
            (written(TAU), true),
            (FRAC_PI_2 + 4e-5, true),
            (FRAC_PI_2 + 1e-4, false),
            (9.0 * FRAC_PI_4, false),
            (0.0, false),
            (90.0, false),
        ] {
            assert_eq!(is_part_of_turn(value), is_part, "{value}");
        }
    }
}
