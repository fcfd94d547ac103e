//! The parameters of the measurement model: names, units, groups, columns, and the LIST of the command line.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::{BallId, BarId, Coordinate, Joint, TargetId};
use crate::diagnostic::Diagnostic;
use crate::robot::RobotFinding;

/// A parameter of the measurement model; the order is the canonical one. Those of the DH table have the joint of their row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ParamId {
    /// Twist of the frame before the joint: `alpha0` of joint 1.
    Alpha(Joint),
    /// Link length of the frame before the joint: `a0` of joint 1.
    A(Joint),
    /// Joint offset: `theta1` of joint 1.
    Theta(Joint),
    /// Link offset along the joint: `d1` of joint 1.
    D(Joint),
    /// Hayati's turn about y of the frame before the joint: `beta2` of joint 3.
    Beta(Joint),
    /// Tool ball in the flange frame.
    Tool(Coordinate),
    /// A further target on the tool (from the second one) in the flange frame.
    Target(TargetId, Coordinate),
    /// Base ball in the robot base.
    Ball(BallId, Coordinate),
    BarOffset(BarId),
    /// Origin of the tracker's frame in the robot base.
    Tracker(Coordinate),
    /// Rotation vector of the tracker's frame in the robot base.
    TrackerTurn(Coordinate),
    Compliance(Joint),
    /// Added to the compliance under the torque of the payload.
    PayloadCompliance(Joint),
    /// Cosine of the first harmonic of the transmission error.
    GearCos(Joint),
    /// Sine of the first harmonic of the transmission error.
    GearSin(Joint),
}

/// The unit of a parameter's values, corrections and standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ParamUnit {
    #[serde(rename = "mm")]
    Mm,
    #[serde(rename = "rad")]
    Rad,
    #[serde(rename = "rad/Nm")]
    RadPerNm,
}

impl ParamUnit {
    pub fn name(self) -> &'static str {
        match self {
            Self::Mm => "mm",
            Self::Rad => "rad",
            Self::RadPerNm => "rad/Nm",
        }
    }
}

impl fmt::Display for ParamUnit {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.name())
    }
}

/// The groups of parameters that a LIST may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ParamGroup {
    Geometric,
    Tool,
    Targets,
    Balls,
    Bar,
    Tracker,
    Compliance,
    Gear,
}

impl ParamGroup {
    const ALL: [Self; 8] = [
        Self::Geometric,
        Self::Tool,
        Self::Targets,
        Self::Balls,
        Self::Bar,
        Self::Tracker,
        Self::Compliance,
        Self::Gear,
    ];

    /// The name in a LIST.
    pub fn name(self) -> &'static str {
        match self {
            Self::Geometric => "geometric",
            Self::Tool => "tool",
            Self::Targets => "targets",
            Self::Balls => "centres",
            Self::Bar => "bar",
            Self::Tracker => "tracker",
            Self::Compliance => "compliance",
            Self::Gear => "gear",
        }
    }

    /// Whether the parameters of the group are estimated only if the data support them.
    pub fn is_optional(self) -> bool {
        matches!(self, Self::Compliance | Self::Gear)
    }
}

/// The source of the prior standard deviation of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PriorRule {
    /// The maker's tolerance of a length, mm.
    LengthTolerance,
    /// The maker's tolerance of an angle, rad. The zero of a joint, and so its gear error, is no better.
    AngleTolerance,
    /// The tolerances of the flange on the last axis, mm and rad.
    FlangeLength,
    FlangeAngle,
    /// The usual deflection of a joint over the greatest torque at the joint, rad/(N m).
    DeflectionOverTorque(Joint),
    /// The usual deflection over the greatest torque, times the relative error of the masses of the links against the
    /// payload.
    MassErrorOverTorque(Joint),
    /// The standard uncertainty of the bar's certificate, else the value of `uncertified`, mm: the bar is not part of the robot.
    Certificate {
        uncertified: f64,
    },
    /// Free in an estimate: measured, taught or estimated by eye. Where a prior is needed, this is its standard
    /// deviation, mm or rad.
    Free(f64),
}

/// The owner of a parameter: the robot, or a part of the set-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParamOwner {
    Robot,
    ToolBall,
    Target(TargetId),
    Ball(BallId),
    Bar(BarId),
    Tracker,
}

/// The common properties of the parameters of a family.
struct ParamFamily {
    /// `{i}` is the joint counted from 0, `{n}` the joint, ball, target or bar counted from 1, `{c}` the coordinate.
    name: &'static str,
    unit: ParamUnit,
    group: ParamGroup,
    /// First column in a [`super::LengthRow`].
    column: usize,
    prior: PriorRule,
    /// A larger posterior standard deviation, mm or rad, is better replaced by a measurement with a ruler.
    max_sd: Option<f64>,
    /// A larger correction is implausible, mm; the robot's parameters and its tool ball are judged by what the robot file states.
    max_correction_mm: Option<f64>,
}

impl ParamFamily {
    /// A family of parameters of the robot: their limits follow from their tolerance.
    const fn of_robot(
        name: &'static str,
        unit: ParamUnit,
        group: ParamGroup,
        column: usize,
        prior: PriorRule,
    ) -> Self {
        Self { name, unit, group, column, prior, max_sd: None, max_correction_mm: None }
    }

    /// A coordinate of the set-up in mm, with its prior and limits in mm.
    const fn of_place(
        name: &'static str,
        group: ParamGroup,
        column: usize,
        prior: f64,
        max_sd: f64,
        max_correction_mm: Option<f64>,
    ) -> Self {
        let (unit, prior, max_sd) = (ParamUnit::Mm, PriorRule::Free(prior), Some(max_sd));
        Self { name, unit, group, column, prior, max_sd, max_correction_mm }
    }
}

impl ParamId {
    /// The table of the parameters: the one place that knows their names, units, groups, columns, priors and limits.
    const fn family(self) -> ParamFamily {
        use ParamGroup::{Balls, Bar, Compliance, Gear, Geometric, Targets, Tool, Tracker};
        use ParamUnit::{Mm, Rad, RadPerNm};
        use PriorRule::{
            AngleTolerance, Certificate, DeflectionOverTorque, FlangeAngle, FlangeLength, Free,
            LengthTolerance, MassErrorOverTorque,
        };
        match self {
            Self::Alpha(_) => ParamFamily::of_robot("alpha{i}", Rad, Geometric, 0, AngleTolerance),
            Self::A(_) => ParamFamily::of_robot("a{i}", Mm, Geometric, 6, LengthTolerance),
            Self::Theta(Joint::J6) => ParamFamily::of_robot("theta{n}", Rad, Geometric, 12, FlangeAngle),
            Self::D(Joint::J6) => ParamFamily::of_robot("d{n}", Mm, Geometric, 18, FlangeLength),
            Self::Theta(_) => ParamFamily::of_robot("theta{n}", Rad, Geometric, 12, AngleTolerance),
            Self::D(_) => ParamFamily::of_robot("d{n}", Mm, Geometric, 18, LengthTolerance),
            Self::Beta(_) => ParamFamily::of_robot("beta{i}", Rad, Geometric, 24, AngleTolerance),
            // The tool ball is known from a drawing or from the controller.
            Self::Tool(_) => ParamFamily::of_place("tool_{c}", Tool, 30, 0.1, 50.0, None),
            // A tracker and targets may be set up anywhere.
            Self::Target(..) => ParamFamily::of_place("target{n}_{c}", Targets, 30, 100.0, 50.0, None),
            Self::Ball(..) => ParamFamily::of_place("centre{n}_{c}", Balls, 33, 10.0, 500.0, Some(300.0)),
            Self::Tracker(_) => ParamFamily::of_place("tracker_{c}", Tracker, 33, 1000.0, 500.0, None),
            // A bar that is set by hand is right to a tenth of a millimetre or so.
            Self::BarOffset(_) => ParamFamily {
                max_correction_mm: Some(50.0),
                ..ParamFamily::of_robot("bar_offset{n}", Mm, Bar, 36, Certificate { uncertified: 0.07 })
            },
            Self::Compliance(joint) => {
                ParamFamily::of_robot("compliance{n}", RadPerNm, Compliance, 37, DeflectionOverTorque(joint))
            }
            Self::PayloadCompliance(joint) => ParamFamily::of_robot(
                "payload_compliance{n}",
                RadPerNm,
                Compliance,
                58,
                MassErrorOverTorque(joint),
            ),
            Self::GearCos(_) => ParamFamily::of_robot("gear{n}_cos", Rad, Gear, 43, AngleTolerance),
            Self::GearSin(_) => ParamFamily::of_robot("gear{n}_sin", Rad, Gear, 49, AngleTolerance),
            Self::TrackerTurn(_) => ParamFamily {
                max_sd: Some(0.1),
                ..ParamFamily::of_robot("tracker_r{c}", Rad, Tracker, 55, Free(1.0))
            },
        }
    }

    /// Number of columns of a [`super::LengthRow`].
    pub(super) const COLUMNS: usize = Self::PayloadCompliance(Joint::J6).column() + 1;

    /// The column of the derivative with respect to the parameter in a [`super::LengthRow`]. A row has one target, one
    /// base ball or tracker, and one bar: all targets share their columns, and so on; derivatives with respect to
    /// others are zero.
    pub const fn column(self) -> usize {
        let place = match self {
            Self::Tool(coordinate)
            | Self::Target(_, coordinate)
            | Self::Ball(_, coordinate)
            | Self::Tracker(coordinate)
            | Self::TrackerTurn(coordinate) => coordinate as usize,
            Self::BarOffset(_) => 0,
            Self::Alpha(joint)
            | Self::A(joint)
            | Self::Theta(joint)
            | Self::D(joint)
            | Self::Beta(joint)
            | Self::Compliance(joint)
            | Self::PayloadCompliance(joint)
            | Self::GearCos(joint)
            | Self::GearSin(joint) => joint as usize,
        };
        self.family().column + place
    }

    pub fn unit(self) -> ParamUnit {
        self.family().unit
    }

    pub fn group(self) -> ParamGroup {
        self.family().group
    }

    pub fn prior(self) -> PriorRule {
        self.family().prior
    }

    /// The largest standard deviation with which a coordinate of the set-up is estimated, mm or rad; `None` for parameters of the
    /// robot and for the bar, whose limit follows from their tolerance.
    pub fn max_sd(self) -> Option<f64> {
        self.family().max_sd
    }

    /// The largest plausible correction of the set-up, mm; `None` where none is stated.
    pub fn max_correction_mm(self) -> Option<f64> {
        self.family().max_correction_mm
    }

    /// Whether it is a geometric parameter of the robot: one of the 24 of the DH table, or a beta.
    pub fn is_geometric(self) -> bool {
        self.group() == ParamGroup::Geometric
    }

    pub fn owner(self) -> ParamOwner {
        match self {
            Self::Alpha(_)
            | Self::A(_)
            | Self::Theta(_)
            | Self::D(_)
            | Self::Beta(_)
            | Self::Compliance(_)
            | Self::PayloadCompliance(_)
            | Self::GearCos(_)
            | Self::GearSin(_) => ParamOwner::Robot,
            Self::Tool(_) => ParamOwner::ToolBall,
            Self::Target(target, _) => ParamOwner::Target(target),
            Self::Ball(ball, _) => ParamOwner::Ball(ball),
            Self::BarOffset(bar) => ParamOwner::Bar(bar),
            Self::Tracker(_) | Self::TrackerTurn(_) => ParamOwner::Tracker,
        }
    }

    /// Whether it belongs to the set-up (tool ball, targets, base balls, bar, tracker) and not to the robot.
    pub fn is_setup(self) -> bool {
        self.owner() != ParamOwner::Robot
    }

    pub fn is_optional(self) -> bool {
        self.group().is_optional()
    }

    /// Whether the position of the tool ball in the robot base depends on it.
    pub fn moves_tool_ball(self) -> bool {
        matches!(self.owner(), ParamOwner::Robot | ParamOwner::ToolBall)
    }

    /// The 24 Denavit-Hartenberg parameters in canonical order.
    pub fn denavit_hartenberg() -> impl Iterator<Item = Self> {
        [Self::Alpha, Self::A, Self::Theta, Self::D]
            .into_iter()
            .flat_map(|family: fn(Joint) -> Self| Joint::ALL.map(family))
    }

    /// All parameters whose name does not depend on the set-up.
    fn named() -> impl Iterator<Item = Self> {
        Self::denavit_hartenberg()
            .chain(Joint::ALL.into_iter().skip(1).map(Self::Beta))
            .chain(Coordinate::ALL.map(Self::Tool))
            .chain(Coordinate::ALL.map(Self::Tracker))
            .chain(Coordinate::ALL.map(Self::TrackerTurn))
            .chain(optional())
    }
}

impl fmt::Display for ParamId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.family().name;
        let of_joint = |joint: Joint| {
            name.replace("{i}", &joint.index().to_string()).replace("{n}", &joint.number().to_string())
        };
        let at = |axis: Coordinate| name.replace("{c}", &axis.to_string());
        let numbered =
            |number: &dyn fmt::Display, axis: Coordinate| at(axis).replace("{n}", &number.to_string());
        out.write_str(&match *self {
            Self::Alpha(joint)
            | Self::A(joint)
            | Self::Theta(joint)
            | Self::D(joint)
            | Self::Beta(joint)
            | Self::Compliance(joint)
            | Self::PayloadCompliance(joint)
            | Self::GearCos(joint)
            | Self::GearSin(joint) => of_joint(joint),
            Self::Tool(axis) | Self::Tracker(axis) | Self::TrackerTurn(axis) => at(axis),
            Self::Target(target, axis) => numbered(&target, axis),
            Self::Ball(ball, axis) => numbered(&ball, axis),
            // A single bar needs no number.
            Self::BarOffset(BarId::FIRST) => name.replace("{n}", ""),
            Self::BarOffset(bar) => name.replace("{n}", &bar.to_string()),
        })
    }
}

impl FromStr for ParamId {
    type Err = RobotFinding;

    fn from_str(word: &str) -> Result<Self, RobotFinding> {
        let number = |digits: &str| digits.parse().ok();
        let placed = |rest: &str| {
            let (digits, axis) = rest.split_once('_')?;
            let coordinate = Coordinate::ALL.into_iter().find(|name| name.to_string() == axis)?;
            Some((number(digits)?, coordinate))
        };
        let numbered = if let Some(rest) = word.strip_prefix("centre") {
            placed(rest).and_then(|(ball, axis)| Some(Self::Ball(BallId::new(ball)?, axis)))
        } else if let Some(rest) = word.strip_prefix("target") {
            let further = |number: u32| TargetId::new(number).filter(|target| *target != TargetId::FIRST);
            placed(rest).and_then(|(target, axis)| Some(Self::Target(further(target)?, axis)))
        } else {
            word.strip_prefix("bar_offset").and_then(|digits| {
                let bar = if digits.is_empty() { Some(1) } else { number(digits) };
                bar.and_then(BarId::new).map(Self::BarOffset)
            })
        };
        // `centre01_x` and `bar_offset1` would parse but are not names.
        let named = numbered.into_iter().chain(Self::named()).find(|id| id.to_string() == word);
        named.ok_or_else(|| RobotFinding::UnknownParameter { word: word.into() })
    }
}

impl Serialize for ParamId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for ParamId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
    }
}

/// Number of base balls, bars of different length, targets on the tool (with the tool ball) and trackers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetUpCounts {
    pub balls: usize,
    pub bars: usize,
    pub targets: usize,
    /// 0 or 1.
    pub trackers: usize,
}

impl SetUpCounts {
    /// Refuses a parameter that the set-up does not have.
    pub fn check(self, id: ParamId) -> Result<(), RobotFinding> {
        let name = id.to_string();
        match id.owner() {
            ParamOwner::Ball(ball) if ball.index() >= self.balls => {
                Err(RobotFinding::NoSuchBall { name, balls: self.balls })
            }
            ParamOwner::Bar(bar) if bar.index() >= self.bars => {
                Err(RobotFinding::NoSuchBar { name, bars: self.bars })
            }
            ParamOwner::Target(target) if target.index() >= self.targets => {
                Err(RobotFinding::NoSuchTarget { name, targets: self.targets })
            }
            ParamOwner::Tracker if self.trackers == 0 => Err(RobotFinding::NoTracker { name }),
            ParamOwner::Robot
            | ParamOwner::ToolBall
            | ParamOwner::Ball(_)
            | ParamOwner::Bar(_)
            | ParamOwner::Target(_)
            | ParamOwner::Tracker => Ok(()),
        }
    }
}

/// Base balls that are measured with one bar.
impl From<usize> for SetUpCounts {
    fn from(balls: usize) -> Self {
        Self { balls, bars: 1, targets: 1, trackers: 0 }
    }
}

/// The parameters of the optional groups, compliance and gear.
pub fn optional() -> impl Iterator<Item = ParamId> {
    let inner = || Joint::ALL.into_iter().skip(1).take(4);
    let gear = Joint::ALL.into_iter().flat_map(|joint| [ParamId::GearCos(joint), ParamId::GearSin(joint)]);
    inner().map(ParamId::Compliance).chain(inner().map(ParamId::PayloadCompliance)).chain(gear)
}

/// The parameters of the group `compliance`.
pub fn compliance() -> impl Iterator<Item = ParamId> {
    optional().filter(|id| id.group() == ParamGroup::Compliance)
}

/// The parameters of the group `gear`.
pub fn gear() -> impl Iterator<Item = ParamId> {
    optional().filter(|id| id.group() == ParamGroup::Gear)
}

/// The parameters of `all` in a LIST, in canonical order: the 24 of the DH table, the beta of each joint whose axis is nominally
/// `parallel` to the one before, tool, targets, balls, bars, tracker. The optional groups are not among them.
pub fn all_parameters(parallel: &[Joint], set_up: impl Into<SetUpCounts>) -> Vec<ParamId> {
    let SetUpCounts { balls, bars, targets, trackers } = set_up.into();
    let of_target = |target| Coordinate::ALL.map(|coordinate| ParamId::Target(target, coordinate));
    let of_tracker = [ParamId::Tracker, ParamId::TrackerTurn]
        .into_iter()
        .flat_map(|family: fn(Coordinate) -> ParamId| Coordinate::ALL.map(family));
    let coordinates = |ball| Coordinate::ALL.map(|coordinate| ParamId::Ball(ball, coordinate));
    ParamId::denavit_hartenberg()
        .chain(parallel.iter().copied().map(ParamId::Beta))
        .chain(Coordinate::ALL.map(ParamId::Tool))
        .chain((1..targets).map(TargetId::at).flat_map(of_target))
        .chain((0..balls).map(BallId::at).flat_map(coordinates))
        .chain((0..bars).map(|at| ParamId::BarOffset(BarId::at(at))))
        .chain(of_tracker.filter(|_| trackers > 0))
        .collect()
}

/// Parses a LIST: names, ranges (`alpha1-5`) and groups, separated by commas. The result is sorted and has no duplicates.
pub fn parse_list(
    list: &str,
    parallel: &[Joint],
    set_up: impl Into<SetUpCounts>,
) -> Result<Vec<ParamId>, Diagnostic> {
    let set_up = set_up.into();
    let everything = all_parameters(parallel, set_up);
    let mut chosen: Vec<ParamId> = Vec::new();
    for word in list.split(',').map(str::trim).filter(|word| !word.is_empty()) {
        if word == "all" {
            chosen.extend(&everything);
        } else if let Some(group) = ParamGroup::ALL.into_iter().find(|group| group.name() == word) {
            let members = everything.iter().copied().chain(optional());
            chosen.extend(members.filter(|id| id.group() == group));
        } else if let Some((first, last)) = word.split_once('-') {
            chosen.extend(range(word, first, last)?);
        } else {
            chosen.push(word.parse()?);
        }
    }
    chosen.sort();
    chosen.dedup();
    chosen.iter().try_for_each(|id| set_up.check(*id))?;
    Ok(chosen)
}

/// The parameters of a range such as `alpha1-5`.
fn range(word: &str, first: &str, last: &str) -> Result<Vec<ParamId>, RobotFinding> {
    let unknown = || RobotFinding::UnknownParameter { word: word.into() };
    let stem = first.trim_end_matches(|c: char| c.is_ascii_digit());
    let from: usize = first[stem.len()..].parse().map_err(|_| unknown())?;
    let to: usize = last.strip_prefix(stem).unwrap_or(last).parse().map_err(|_| unknown())?;
    if from > to || to > 99 {
        return Err(unknown());
    }
    (from..=to).map(|number| format!("{stem}{number}").parse()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back_and_columns_are_unique() {
        let (mut columns, mut all) = (std::collections::BTreeSet::new(), std::collections::BTreeSet::new());
        let second = BarId::at(1);
        let set_up = [
            ParamId::Ball(BallId::at(9), Coordinate::Y),
            ParamId::Target(TargetId::at(1), Coordinate::Z),
            ParamId::BarOffset(second),
        ];
        for id in ParamId::named().chain(set_up) {
            let json = serde_json::to_string(&id).unwrap();
            assert_eq!(json, format!("\"{id}\""));
            assert_eq!(serde_json::from_str::<ParamId>(&json).unwrap(), id);
            all.insert(id.column());
            // The tracker shares the columns of the balls, and targets share those of the tool ball.
            let is_unique =
                matches!(id, ParamId::Tracker(_) | ParamId::Target(..)) || columns.insert(id.column());
            assert!(id.column() < ParamId::COLUMNS && is_unique, "{id}");
        }
        // Hayati's turn of the first joint, and the compliance of a joint that carries no weight, have columns but no names. A
        // family that is missing in the lists of names leaves more columns open.
        all.insert(ParamId::Beta(Joint::J1).column());
        for joint in [Joint::J1, Joint::J6] {
            all.extend([ParamId::Compliance(joint), ParamId::PayloadCompliance(joint)].map(ParamId::column));
        }
        assert!(all.into_iter().eq(0..ParamId::COLUMNS));
        for word in [
            "centre01_x",
            "centre0_x",
            "target1_x",
            "bar_offset1",
            "beta0",
            "alpha6",
            "theta0",
            "compliance1",
            "d",
        ] {
            assert!(word.parse::<ParamId>().is_err(), "{word}");
        }
    }
}
