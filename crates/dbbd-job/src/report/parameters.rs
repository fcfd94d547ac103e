//! Tables of parameters: in groups of one unit, with the digits that their standard deviations support.

use serde::Serialize;

use super::plot::{Interval, Intervals};
use super::scale::{Unit, decimals};
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::{ParameterResult, Status};
use dbbd_model::robot::{ParamGroup, ParamId, ParamUnit, Robot};

/// A table of parameters of one unit.
#[derive(Serialize)]
pub(super) struct Group<'a> {
    title: &'static str,
    /// Unit and decimals of values.
    value: Column,
    /// Unit and decimals of corrections and standard deviations.
    small: Column,
    parameters: Vec<&'a ParameterResult>,
    /// The corrections with their intervals, if some were estimated.
    chart: Option<String>,
}

/// A unit and its decimals, the same for a whole column so that points align.
#[derive(Clone, Copy, Serialize)]
struct Column {
    unit: Unit,
    decimals: usize,
}

/// Parameters that were not estimated for the same reason.
#[derive(Serialize)]
pub(super) struct NotEstimated<'a> {
    pub(super) names: Vec<ParamId>,
    status: Status,
    pub(super) reason: &'a str,
}

/// The kinds of parameters, in the order of the tables.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Lengths,
    Angles,
    Tool,
    Balls,
    Tracker,
    Compliance,
    Transmission,
}

const KINDS: [(Kind, &str); 7] = [
    (Kind::Lengths, "Robot: lengths"),
    (Kind::Angles, "Robot: angles"),
    (Kind::Tool, "Set-up: tool ball, targets and bar"),
    (Kind::Balls, "Set-up: base balls"),
    (Kind::Tracker, "Set-up: frame of the tracker (mm, rad)"),
    (Kind::Compliance, "Joint compliance"),
    (Kind::Transmission, "Transmission errors"),
];

impl Kind {
    fn of(id: ParamId) -> Self {
        match (id.group(), id.unit()) {
            (ParamGroup::Geometric, ParamUnit::Mm) => Self::Lengths,
            (ParamGroup::Geometric, ParamUnit::Rad | ParamUnit::RadPerNm) => Self::Angles,
            (ParamGroup::Tool | ParamGroup::Targets | ParamGroup::Bar, _) => Self::Tool,
            (ParamGroup::Balls, _) => Self::Balls,
            (ParamGroup::Tracker, _) => Self::Tracker,
            (ParamGroup::Compliance, _) => Self::Compliance,
            (ParamGroup::Gear, _) => Self::Transmission,
        }
    }

    /// Units of values and of corrections up to `largest`.
    fn units(self, largest: f64) -> [Unit; 2] {
        match self {
            Self::Lengths | Self::Tool | Self::Balls => {
                [Unit::MM, Unit::length(if largest < 10.0 { 0.0 } else { largest })]
            }
            Self::Angles => [Unit::DEG, Unit { sign: "mrad", factor: 1e3 }],
            Self::Tracker => [Unit { sign: "", factor: 1.0 }; 2],
            Self::Compliance => [Unit { sign: "µrad/(N m)", factor: 1e6 }; 2],
            Self::Transmission => [Unit::angle(largest); 2],
        }
    }

    /// The maker's tolerance as a standard deviation, mm or rad.
    fn tolerance(self, robot: &Robot) -> Option<f64> {
        match self {
            Self::Lengths => Some(robot.tolerance.length_mm),
            Self::Angles => Some(robot.tolerance.angle_deg.to_radians()),
            Self::Tool | Self::Balls | Self::Tracker | Self::Compliance | Self::Transmission => None,
        }
    }
}

/// The tables of the kinds that have members.
pub(super) fn groups<'a>(result: &'a CalibrationResult, robot: &Robot) -> Vec<Group<'a>> {
    let of_kind = |(kind, title)| {
        let members = result.parameters.iter().filter(|parameter| Kind::of(parameter.name) == kind);
        group(kind, title, members.collect(), robot)
    };
    KINDS.into_iter().filter_map(of_kind).collect()
}

fn group<'a>(
    kind: Kind,
    title: &'static str,
    parameters: Vec<&'a ParameterResult>,
    robot: &Robot,
) -> Option<Group<'a>> {
    if parameters.is_empty() {
        return None;
    }
    let largest = parameters.iter().map(|parameter| parameter.correction.abs()).fold(0.0, f64::max);
    let sds = parameters.iter().filter_map(|parameter| parameter.sd).filter(|sd| *sd > 0.0);
    let smallest = sds.fold(f64::INFINITY, f64::min);
    // Decimals for two figures of the smallest sd.
    let column = |unit: Unit| {
        let figures = (decimals(smallest * unit.factor) + 1).min(6);
        Column { unit, decimals: if smallest.is_finite() { figures } else { 3 } }
    };
    let [value, small] = kind.units(largest).map(column);
    let chart = Intervals {
        title: format!("{title}, correction"),
        description: "Correction with its 95 % interval",
        unit: small.unit,
        rows: parameters.iter().filter_map(|parameter| interval(parameter)).collect(),
        tolerance: kind.tolerance(robot),
    };
    Some(Group { title, value, small, chart: chart.to_svg(), parameters })
}

fn interval(parameter: &ParameterResult) -> Option<Interval> {
    let [low, high] = parameter.interval95?;
    let (name, value) = (parameter.name.to_string(), parameter.correction);
    Some(Interval { name, value, half_width: 0.5 * (high - low) })
}

/// The parameters that were not estimated, by reason.
pub(super) fn not_estimated(parameters: &[ParameterResult]) -> Vec<NotEstimated<'_>> {
    let mut lines: Vec<NotEstimated<'_>> = Vec::new();
    let estimated = |status: Status| matches!(status, Status::Identified | Status::SupportedByPrior);
    for ParameterResult { name, status, reason, .. } in parameters.iter().filter(|p| !estimated(p.status)) {
        match lines.iter_mut().find(|line| line.status == *status && line.reason == reason) {
            Some(line) => line.names.push(*name),
            None => lines.push(NotEstimated { names: vec![*name], status: *status, reason }),
        }
    }
    lines
}
