//! Parameters as a reader wants them: in groups of one unit, to the digits that their sd supports.

use serde::Serialize;

use super::plot::{Interval, Intervals};
use super::scale::{Unit, decimals, fixed, signed};
use crate::identify::result::{ParameterResult, Status};
use crate::model::ParamId;

/// A table of parameters of one unit.
#[derive(Serialize)]
pub(super) struct Group {
    title: &'static str,
    /// Unit of nominal and identified.
    value_unit: &'static str,
    /// Unit of correction and sd.
    small_unit: &'static str,
    rows: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    name: String,
    nominal: String,
    identified: String,
    correction: String,
    sd: String,
    interval: String,
    /// Standard deviation and interval by Monte Carlo.
    drawn: Option<[String; 2]>,
    status: &'static str,
    class: &'static str,
    reason: String,
    raw: String,
}

/// What a parameter belongs to, in the order of the tables.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Lengths,
    Angles,
    Tool,
    Centres,
    Compliance,
    Gear,
    Other,
}

impl Kind {
    const ALL: [Self; 7] =
        [Self::Lengths, Self::Angles, Self::Tool, Self::Centres, Self::Compliance, Self::Gear, Self::Other];

    fn of(parameter: &ParameterResult) -> Self {
        match parameter.name.parse::<ParamId>() {
            Ok(ParamId::Tool(_) | ParamId::BarOffset(_)) => Self::Tool,
            Ok(ParamId::Centre(..)) => Self::Centres,
            Ok(ParamId::A(_) | ParamId::D(_)) => Self::Lengths,
            Ok(ParamId::Compliance(_)) => Self::Compliance,
            Ok(ParamId::GearCos(_) | ParamId::GearSin(_)) => Self::Gear,
            Ok(_) => Self::Angles,
            Err(_) => Self::Other,
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Lengths => "Robot: lengths",
            Self::Angles => "Robot: angles",
            Self::Tool => "Set-up: tool ball and bar",
            Self::Centres => "Set-up: base balls",
            Self::Compliance => "Joint compliance",
            Self::Gear => "Gear errors",
            Self::Other => "Others, in their own units",
        }
    }

    /// Units of values and of corrections up to `largest`.
    fn units(self, largest: f64) -> [Unit; 2] {
        match self {
            Self::Lengths | Self::Tool | Self::Centres => {
                [Unit::MM, Unit::length(if largest < 10.0 { 0.0 } else { largest })]
            }
            Self::Angles => [Unit::DEG, Unit { sign: "mrad", factor: 1e3 }],
            Self::Compliance => [Unit { sign: "µrad/(N m)", factor: 1e6 }; 2],
            Self::Gear => [Unit::angle(largest); 2],
            Self::Other => [Unit { sign: "own unit", factor: 1.0 }; 2],
        }
    }
}

/// The members of each kind that has some, with their units.
fn kinds(parameters: &[ParameterResult]) -> impl Iterator<Item = (Kind, Vec<&ParameterResult>, [Unit; 2])> {
    Kind::ALL.into_iter().filter_map(|kind| {
        let members: Vec<&ParameterResult> =
            parameters.iter().filter(|parameter| Kind::of(parameter) == kind).collect();
        let largest = members.iter().map(|member| member.correction.abs()).fold(0.0, f64::max);
        (!members.is_empty()).then(|| (kind, members, kind.units(largest)))
    })
}

/// The tables.
pub(super) fn groups(parameters: &[ParameterResult]) -> Vec<Group> {
    kinds(parameters)
        .map(|(kind, members, [value, small])| {
            // Two figures of the smallest sd, the same for the whole column so that points align.
            let sds = members.iter().filter_map(|member| member.sd).filter(|sd| *sd > 0.0);
            let smallest = sds.fold(f64::INFINITY, f64::min);
            let digits = |unit: Unit| match smallest.is_finite() {
                true => (decimals(smallest * unit.factor) + 1).min(6),
                false => 3,
            };
            Group {
                title: kind.title(),
                value_unit: value.sign,
                small_unit: small.sign,
                rows: members
                    .iter()
                    .map(|member| row(member, [value, small], [digits(value), digits(small)]))
                    .collect(),
            }
        })
        .collect()
}

fn row(parameter: &ParameterResult, [value, small]: [Unit; 2], [long, short]: [usize; 2]) -> Row {
    let correction = parameter.correction * small.factor;
    let estimated = parameter.sd.is_some();
    let range = |interval: Option<[f64; 2]>| match interval {
        Some(ends) => {
            let [low, high] = ends.map(|end| signed((end - parameter.nominal) * small.factor, short));
            format!("{low} to {high}")
        }
        None => "–".into(),
    };
    let (sd, interval) = match parameter.sd {
        Some(sd) => (fixed(sd * small.factor, short), range(parameter.interval95)),
        None => ("–".into(), "–".into()),
    };
    let sd_raw = parameter.sd.map_or("none".to_owned(), |sd| sd.to_string());
    Row {
        name: parameter.name.clone(),
        nominal: fixed(parameter.nominal * value.factor, long),
        identified: fixed(parameter.identified * value.factor, long),
        correction: if estimated || parameter.correction != 0.0 {
            signed(correction, short)
        } else {
            "–".into()
        },
        sd,
        interval,
        drawn: parameter
            .monte_carlo
            .map(|drawn| [fixed(drawn.sd * small.factor, short), range(Some(drawn.interval95))]),
        status: word(parameter.status),
        class: class(parameter.status),
        reason: parameter.reason.clone(),
        raw: format!(
            "{} in {}: start {}, nominal {}, identified {}, correction {}, sd {sd_raw}",
            parameter.name,
            parameter.unit,
            parameter.start,
            parameter.nominal,
            parameter.identified,
            parameter.correction
        ),
    }
}

/// A chart for each kind whose corrections were estimated; the tolerance is (mm, rad).
pub(super) fn charts(parameters: &[ParameterResult], tolerance: Option<[f64; 2]>) -> Vec<String> {
    kinds(parameters)
        .filter_map(|(kind, members, [_, small])| {
            let rows: Vec<Interval> = members
                .iter()
                .filter_map(|member| {
                    Some(Interval {
                        name: member.name.clone(),
                        value: member.correction * small.factor,
                        half_width: member.interval95.map(|[low, high]| 0.5 * (high - low) * small.factor)?,
                    })
                })
                .collect();
            let promised = match kind {
                Kind::Lengths => tolerance.map(|[mm, _]| mm * small.factor),
                Kind::Angles => tolerance.map(|[_, rad]| rad * small.factor),
                _ => None,
            };
            let title = format!("{}, correction", kind.title());
            let chart = Intervals { title, unit: small.sign.into(), rows, tolerance: promised };
            (!chart.rows.is_empty()).then(|| chart.to_svg())
        })
        .collect()
}

/// Whether the data moved it.
pub(super) fn estimated(status: Status) -> bool {
    matches!(status, Status::Identified | Status::Prior)
}

/// A status in words.
pub(super) fn word(status: Status) -> &'static str {
    match status {
        Status::Identified => "identified",
        Status::Dependent => "dependent",
        Status::Held => "held",
        Status::TooWeak => "too weak",
        Status::Prior => "with prior",
    }
}

/// The class of a status in the style sheet.
pub(super) fn class(status: Status) -> &'static str {
    match status {
        Status::Identified => "told",
        Status::Prior => "prior",
        Status::Dependent | Status::Held | Status::TooWeak => "untold",
    }
}
