//! The motion instructions of a TP program with their arguments.

use super::motion::without_number;
use crate::program::MotionKind;
use crate::program::listing::Pace;
use crate::program::script::value::Evaluated;

/// A motion: `J`, `L` or `C`.
pub(super) struct Instruction<'a> {
    pub(super) motion: MotionKind,
    arguments: &'a [Evaluated<'a>],
}

const MOTIONS: [(&str, MotionKind); 3] =
    [("J", MotionKind::Ptp), ("L", MotionKind::Lin), ("C", MotionKind::Circ)];

/// The first words of motions that are not read: arcs of three instructions and splines.
pub(super) const OTHER_MOTIONS: [&str; 2] = ["A", "S"];

/// The units of speeds, and options that leave the end of the motion where it is. Public programs of car makers write MAX_SPEED, P-SPS
/// (sub-lines at the end of a motion) and PRESS_MOTN (a press robot's path), controllers set to German MM/SEK.
const HARMLESS: [&str; 34] = [
    "%",
    "MM/SEC",
    "MM/SEK",
    "MAX_SPEED",
    "P-SPS",
    "PRESS_MOTN",
    "IND.EV",
    "CM/MIN",
    "INCH/MIN",
    "DEG/SEC",
    "SEC",
    "MSEC",
    "FINE",
    "CNT",
    "CR",
    "CD",
    "WELD_SPEED",
    "ACC",
    "WJNT",
    "PTH",
    "EV",
    "INDEV",
    "TA",
    "TB",
    "DB",
    "MROT",
    "BREAK",
    "AP_LD",
    "RT_LD",
    "PSPD",
    "ARC",
    "START",
    "END",
    "SPOT",
];
/// Options that move the end of a motion: offsets, and the motion of another group or of a conveyor.
const DISPLACING: [&str; 6] = ["OFFSET", "TOOL_OFFSET", "VOFFSET", "COORD", "TRACK", "LINE_TRACK"];
/// Options of a relative motion.
const RELATIVE: [&str; 2] = ["INC", "INCREMENTAL"];
/// Option of a fixed tool: the robot moves the work.
const FIXED: &str = "RTCP";

/// The effect of an option on the place where a motion ends.
pub(super) enum OptionEffect<'a> {
    Relative,
    FixedTool(&'a str),
    Displaced(&'a str),
    Unknown(&'a str),
}

/// Whether an instruction is a motion.
pub(super) fn is_motion(name: &str) -> bool {
    MOTIONS.iter().any(|(known, _)| *known == name)
}

impl<'a> Instruction<'a> {
    /// The motion of a call, if the call is one.
    pub(super) fn new(name: &str, arguments: &'a [Evaluated<'a>]) -> Option<Self> {
        let (_, motion) = *MOTIONS.iter().find(|(known, _)| *known == name)?;
        Some(Self { motion, arguments })
    }

    /// The points, the auxiliary one first.
    pub(super) fn points(&self) -> impl Iterator<Item = &'a Evaluated<'a>> {
        self.arguments.iter().filter(|argument| argument.name.is_none())
    }

    /// The first option that changes where the motion ends.
    pub(super) fn effect(&self) -> Option<OptionEffect<'a>> {
        let words = self.arguments.iter().filter_map(|argument| argument.name);
        let word = words
            .into_iter()
            .find(|word| !HARMLESS.contains(word) && !HARMLESS.contains(&without_number(word)))?;
        Some(match word {
            FIXED => OptionEffect::FixedTool(word),
            _ if RELATIVE.contains(&word) => OptionEffect::Relative,
            _ if DISPLACING.contains(&word) => OptionEffect::Displaced(word),
            _ => OptionEffect::Unknown(word),
        })
    }

    fn number(&self, unit: &str) -> Option<f64> {
        self.arguments
            .iter()
            .find(|argument| argument.name == Some(unit))?
            .number()
            .filter(|number| *number > 0.0)
    }

    /// Whether the motion ends with a wait until the robot is in position; `None` if the robot need not reach the point.
    pub(super) fn ends_in_position(&self) -> Option<bool> {
        self.arguments.iter().find_map(|argument| match argument.name? {
            "FINE" => Some(true),
            "CNT0" => Some(false),
            _ => None,
        })
    }

    /// The speed of the motion, with an acceleration of the tool, mm/s^2, that a program cannot set.
    pub(super) fn pace(&self, mm_s2: f64) -> Option<Pace> {
        let duration = self.number("SEC").or_else(|| self.number("MSEC").map(|ms| 1e-3 * ms));
        let tool = || {
            let mm_s = self.number("MM/SEC").or_else(|| self.number("CM/MIN").map(|cm_min| cm_min / 6.0))?;
            (self.motion != MotionKind::Ptp).then_some(Pace::Tool { mm_s, mm_s2, deg_s: None })
        };
        let share = || {
            let percent = self.number("%").filter(|_| self.motion == MotionKind::Ptp)?;
            Some(Pace::AxisShare(1e-2 * percent.min(100.0)))
        };
        duration.map(Pace::Duration).or_else(tool).or_else(share)
    }
}
