//! Texts of combinations, reasons, groups and recommendations.

use std::fmt;

use super::parameters::Reason;
use super::result::{CirclePlane, FurtherMeasurement, MadeFrom, Recommendation, StartRobot};
use super::{Combination, Group, GroupEvidence};
use crate::base::text;
use crate::robot::{BarId, ParamId, ParamOwner, ParamUnit};

/// As "140 lengths and 70 positions of 2 targets".
impl fmt::Display for MadeFrom {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { lengths, positions, targets } = *self;
        let kinds =
            [(lengths, "lengths"), (positions, "positions")].into_iter().filter(|(count, _)| *count > 0);
        let kinds: Vec<String> = kinds.map(|(count, kind)| format!("{count} {kind}")).collect();
        out.write_str(&kinds.join(" and "))?;
        if targets > 1 { write!(out, " of {targets} targets") } else { Ok(()) }
    }
}

impl fmt::Display for Combination {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_sum(out)?;
        out.write_str(" is identifiable")?;
        let bar = |id: &ParamId| if let ParamId::BarOffset(bar) = id { Some(*bar) } else { None };
        match (self.members.iter().filter_map(|(id, _)| bar(id)).max(), self.kept.owner()) {
            (Some(BarId::FIRST), _) => out.write_str(
                ": bar_offset is a uniform scale by another name; calibrate the bar or add a second length",
            ),
            (Some(bar), _) => write!(
                out,
                ": bar_offset{bar} is a uniform scale by another name while each bar has an offset of its own; calibrate \
                 one of the bars, or set one to a second length"
            ),
            (None, ParamOwner::Ball(_)) => out.write_str(
                ": lengths determine where the ball is from the robot's base, not where that base is",
            ),
            (None, ParamOwner::ToolBall) => out.write_str(": the flange is known only by the ball on it"),
            (None, ParamOwner::Robot | ParamOwner::Target(_) | ParamOwner::Bar(_) | ParamOwner::Tracker) => {
                Ok(())
            }
        }
    }
}

/// A sum of more terms is not written out,
const MAX_TERMS: usize = 6;
/// nor one with a term below this fraction of the largest.
const MIN_TERM: f64 = 1e-3;

impl Combination {
    /// Writes the sum with each parameter in mm or mrad (urad/(N m)); or the number of terms and the largest one.
    fn write_sum(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let terms: Vec<(ParamId, f64)> = self.scaled().collect();
        let size = |(_, share): &&(ParamId, f64)| share.abs();
        let Some(largest) = terms.iter().max_by(|a, b| size(a).total_cmp(&size(b))) else { return Ok(()) };
        if terms.len() > MAX_TERMS || terms.iter().any(|term| size(&term) < MIN_TERM * size(&largest)) {
            return write!(out, "only a combination of {} parameters, mostly of {},", terms.len(), largest.0);
        }
        out.write_str("only ")?;
        for (at, (id, coefficient)) in terms.iter().enumerate() {
            out.write_str(match (at, *coefficient < 0.0) {
                (0, _) => "",
                (_, true) => " - ",
                (_, false) => " + ",
            })?;
            let size = coefficient.abs();
            if (size - 1.0).abs() > 1e-6 {
                write!(out, "{} ", significant(size))?;
            }
            write!(out, "{id}")?;
        }
        let mixed = terms.iter().any(|(id, _)| id.unit() != self.kept.unit());
        out.write_str(if mixed { " (in mm and mrad)" } else { "" })
    }
}

/// Combinations for a terminal: the short ones, and the number of the longer ones.
pub fn in_short<'a>(combinations: impl IntoIterator<Item = &'a Combination>) -> Vec<String> {
    let (short, long): (Vec<_>, Vec<_>) =
        combinations.into_iter().partition(|combination| combination.members.len() <= MAX_TERMS);
    let mut lines: Vec<String> = short.iter().map(ToString::to_string).collect();
    if let Some(largest) = long.iter().map(|combination| combination.members.len()).max() {
        lines.push(format!(
            "{} combinations of more than {MAX_TERMS} parameters are identifiable only as a whole; the largest has {largest}",
            long.len()
        ));
    }
    lines
}

/// Four significant digits, without an exponent if possible.
fn significant(value: f64) -> String {
    if !(1e-3..1e5).contains(&value) {
        return format!("{value:.3e}");
    }
    let digits = (3 - value.log10().floor() as i32).clamp(0, 6) as usize;
    text::without_end_zeros(&format!("{value:.digits$}")).to_owned()
}

impl Reason {
    /// The reason in words, of the parameter `id`; empty if it is identified by itself.
    pub(super) fn text(&self, id: ParamId) -> String {
        let text = |combination: &Option<Combination>| {
            combination.iter().map(ToString::to_string).collect::<String>()
        };
        match self {
            Reason::Identified => String::new(),
            Reason::IdentifiedFor { combination, shared: false } => combination.to_string(),
            Reason::IdentifiedFor { combination, shared: true } => {
                format!("{combination}; the prior shares it out")
            }
            Reason::PriorShares { combination } => format!("{}; the prior shares it out", text(combination)),
            Reason::PriorCarries { data_sd } => {
                format!("the data alone leave {}; the prior carries it", with_unit(*data_sd, id))
            }
            Reason::ByEvidence { determined } => format!(
                "the lengths determine {:.0} % of it, and the prior of its group the rest",
                determined * 100.0
            ),
            Reason::Dependent { combination } => text(combination),
            Reason::FixedAsAsked => "fixed as asked".into(),
            Reason::NotAsked => "not asked for".into(),
            Reason::ChangesNoLength => "changes no length in these poses".into(),
            Reason::Open { limit } => format!(
                "poorly observable: these poses leave it open by more than {}, as where the tool never turns or every bar \
                 lies in one plane; vary the poses",
                with_unit(*limit, id)
            ),
        }
    }
}

/// A value in mm, mrad or urad/(N m).
fn with_unit(value: f64, id: ParamId) -> String {
    match id.unit() {
        _ if value.is_infinite() => "nothing known".into(),
        ParamUnit::Rad => format!("{:.3} mrad", value * 1e3),
        ParamUnit::RadPerNm => format!("{:.3} urad/(N m)", value * 1e6),
        ParamUnit::Mm if value >= 10.0 => format!("{value:.0} mm"),
        ParamUnit::Mm => format!("{value:.3} mm"),
    }
}

impl fmt::Display for StartRobot {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Nominal => "the nominal robot",
            Self::Identified => "the robot as it was identified before",
        })
    }
}

impl fmt::Display for GroupEvidence {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { group, sd, effective_parameters, rms_mm, share } = self;
        let what = match group {
            Group::Harmonic => "first harmonic of the joints",
            Group::Smooth => "smooth error of the joints",
            Group::Backlash => "backlash of the joints",
            Group::Ripple => "transmission ripple",
            Group::Compliance => "compliance",
            Group::Tolerance => "geometry",
            Group::Tool => "tool ball",
            Group::Cluster => "displacement of poses that are alike",
            Group::Warming => "zeros and links with time",
        };
        let size = match group {
            Group::Compliance => format!("{sd:.2} of its prior standard deviation"),
            Group::Tolerance => format!("{sd:.2} tolerances of the robot"),
            Group::Tool => format!("{sd:.2} times what is stated of it"),
            Group::Cluster => format!("{sd:.4} mm"),
            Group::Harmonic | Group::Smooth | Group::Backlash | Group::Ripple | Group::Warming => {
                format!("{:.1} urad", sd * 1e6)
            }
        };
        write!(
            out,
            "{what}: standard deviation {size}, {effective_parameters:.1} parameters determined, it explains {rms_mm:.4} mm of the \
             lengths"
        )?;
        match share {
            Some(share) => write!(out, ", {:.1} % of what the geometry leaves", share * 100.0),
            None => Ok(()),
        }
    }
}

impl fmt::Display for CirclePlane {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Xy => out.write_str("XY"),
            Self::Xz => out.write_str("XZ"),
            Self::Yz => out.write_str("YZ"),
            Self::TiltedAboutX(degrees) => write!(out, "XY tilted by {degrees} degrees about X"),
            Self::TiltedAboutY(degrees) => write!(out, "XY tilted by {degrees} degrees about Y"),
        }
    }
}

impl Recommendation {
    /// The measurement, without its effect.
    pub fn what(&self) -> String {
        let poses = self.poses;
        let place = |[x, y, z]: [f64; 3]| format!("({x:.0}, {y:.0}, {z:.0}) mm");
        match &self.measure {
            FurtherMeasurement::Circle { planes } => {
                let planes = match planes.as_slice() {
                    [others @ .., last] if !others.is_empty() => {
                        let others: Vec<String> = others.iter().map(ToString::to_string).collect();
                        format!("{} and {last}", others.join(", "))
                    }
                    planes => planes.iter().map(ToString::to_string).collect(),
                };
                format!("further circles about the same ball, {planes}, {poses} poses")
            }
            FurtherMeasurement::Wrist { degrees } => {
                format!("the same places with the wrist turned by {degrees} degrees more, {poses} poses")
            }
            FurtherMeasurement::Ball { ball_mm } => {
                format!("a further ball at {}, {poses} poses", place(*ball_mm))
            }
            FurtherMeasurement::TurnedBall { ball_mm } => {
                format!("a ball turned about axis 1 to {}, {poses} poses", place(*ball_mm))
            }
            FurtherMeasurement::Bar { length_mm } => {
                format!("a bar of {length_mm:.0} mm on the same ball, {poses} poses")
            }
        }
    }
}

impl fmt::Display for Recommendation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { before_mm, after_mm, identifies, .. } = self;
        write!(out, "{}: predicted position uncertainty {before_mm:.3} -> {after_mm:.3} mm", self.what())?;
        if !identifies.is_empty() {
            let names: Vec<String> = identifies.iter().map(ToString::to_string).collect();
            write!(out, ", and it identifies {}", names.join(", "))
        } else if !self.adds {
            out.write_str(", so it adds next to nothing")
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Joint;

    #[test]
    fn long_and_badly_scaled_sums_are_counted() {
        let of = |kept, others: &[(ParamId, f64)]| {
            let members = [&[(kept, 1.0)], others].concat();
            Combination { kept, members }.to_string()
        };
        let (alpha1, d2, beta2) =
            (ParamId::Alpha(Joint::J2), ParamId::D(Joint::J2), ParamId::Beta(Joint::J3));
        assert!(of(alpha1, &[(d2, 1.0 / 15.0)]).contains("+ 66.67 "), "{}", of(alpha1, &[(d2, 1.0 / 15.0)]));
        let rounding = of(d2, &[(beta2, -6.607e8)]);
        assert!(!rounding.contains("607") && rounding.contains("2 parameters"), "{rounding}");
        let many: Vec<(ParamId, f64)> = Joint::ALL.into_iter().map(|j| (ParamId::A(j), 0.5)).collect();
        assert!(of(d2, &many).contains("7 parameters"));
    }
}
