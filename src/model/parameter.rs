//! The parameters by name: order, units, groups, and the LIST of the command line.

use std::fmt;
use std::str::FromStr;

use super::AXES;

/// One parameter of the measurement model. Indices are those of the names: `Alpha(0)` is `alpha0`,
/// `Theta(1)` is `theta1`, `Centre(1, 0)` is `centre1_x`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ParamId {
    /// Twist `alpha0..alpha5`, rad: that of the frame before joint i + 1.
    Alpha(usize),
    /// Link length `a0..a5`, mm: that of the frame before joint i + 1.
    A(usize),
    /// Joint offset `theta1..theta6`, rad.
    Theta(usize),
    /// Link offset `d1..d6`, mm.
    D(usize),
    /// Hayati's `beta1..beta5`, rad: a turn about y after joint i (row i + 1).
    Beta(usize),
    /// Tool ball in the flange frame, `tool_x tool_y tool_z`, mm.
    Tool(usize),
    /// Base ball k (from 1), `centre<k>_x/_y/_z` in the robot base, mm.
    Centre(usize, usize),
    /// Length offset of bar k (from 1), mm: `bar_offset` of the first, `bar_offset2`, .. of further ones.
    BarOffset(usize),
    /// Joint compliance `compliance2..compliance5`, rad/(N m).
    Compliance(usize),
    /// Cosine part of the gear error of joint j, rad.
    GearCos(usize),
    /// Sine part of the gear error of joint j, rad.
    GearSin(usize),
}

const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];

impl ParamId {
    /// The unit of values and corrections: `mm`, `rad` or `rad/Nm`.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Alpha(_) | Self::Theta(_) | Self::Beta(_) | Self::GearCos(_) | Self::GearSin(_) => "rad",
            Self::A(_) | Self::D(_) | Self::Tool(_) | Self::Centre(..) | Self::BarOffset(_) => "mm",
            Self::Compliance(_) => "rad/Nm",
        }
    }

    /// Whether it is one of the robot's own geometric parameters (the 24 and the betas).
    pub fn is_geometric(self) -> bool {
        matches!(self, Self::Alpha(_) | Self::A(_) | Self::Theta(_) | Self::D(_) | Self::Beta(_))
    }

    /// Whether it belongs to the set-up (tool ball, base balls, bar) and not to the robot.
    pub fn is_setup(self) -> bool {
        matches!(self, Self::Tool(_) | Self::Centre(..) | Self::BarOffset(_))
    }

    /// Whether it belongs to a group that is estimated only where the data carry it: compliance, gear error.
    pub fn is_optional(self) -> bool {
        matches!(self, Self::Compliance(_) | Self::GearCos(_) | Self::GearSin(_))
    }

    /// The 24 Denavit-Hartenberg parameters in canonical order.
    pub fn denavit_hartenberg() -> impl Iterator<Item = Self> {
        (0..AXES)
            .map(Self::Alpha)
            .chain((0..AXES).map(Self::A))
            .chain((1..=AXES).map(Self::Theta))
            .chain((1..=AXES).map(Self::D))
    }
}

impl fmt::Display for ParamId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Alpha(i) => write!(out, "alpha{i}"),
            Self::A(i) => write!(out, "a{i}"),
            Self::Theta(i) => write!(out, "theta{i}"),
            Self::D(i) => write!(out, "d{i}"),
            Self::Beta(i) => write!(out, "beta{i}"),
            Self::Tool(axis) => write!(out, "tool_{}", AXIS_NAMES[axis]),
            Self::Centre(k, axis) => write!(out, "centre{k}_{}", AXIS_NAMES[axis]),
            Self::BarOffset(1) => write!(out, "bar_offset"),
            Self::BarOffset(k) => write!(out, "bar_offset{k}"),
            Self::Compliance(j) => write!(out, "compliance{j}"),
            Self::GearCos(j) => write!(out, "gear{j}_cos"),
            Self::GearSin(j) => write!(out, "gear{j}_sin"),
        }
    }
}

/// A parameter name or LIST that is not one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{word}` is not a parameter: {hint}")]
pub struct UnknownParameter {
    /// What stood there.
    pub word: String,
    /// What could stand there.
    pub hint: String,
}

impl UnknownParameter {
    fn new(word: &str) -> Self {
        let hint = "the names are alpha0..5, a0..5, theta1..6, d1..6, beta1..5, tool_x/_y/_z, centre<k>_x/_y/_z, \
                    bar_offset (bar_offset2, .. of further bars), compliance2..5, gear1..6_cos/_sin; the groups geometric, tool, centres, bar, all, \
                    compliance, gear; ranges as alpha1-5";
        Self { word: word.into(), hint: hint.into() }
    }
}

impl FromStr for ParamId {
    type Err = UnknownParameter;

    fn from_str(word: &str) -> Result<Self, UnknownParameter> {
        let unknown = || UnknownParameter::new(word);
        if let Some(digits) = word.strip_prefix("bar_offset") {
            let further = || digits.parse().ok().filter(|k| *k > 1 && !digits.starts_with(['0', '+']));
            let bar = if digits.is_empty() { Some(1) } else { further() };
            return bar.map(Self::BarOffset).ok_or_else(unknown);
        }
        let split = word.find(|c: char| c.is_ascii_digit() || c == '_').ok_or_else(unknown)?;
        let (stem, rest) = word.split_at(split);
        let (digits, suffix) = match rest.split_once('_') {
            Some((digits, suffix)) => (digits, Some(suffix)),
            None => (rest, None),
        };
        let axis = suffix.and_then(|suffix| AXIS_NAMES.iter().position(|name| *name == suffix));
        let number: Option<usize> = digits.parse().ok();
        let id = match (stem, number, suffix, axis) {
            ("alpha", Some(i @ 0..=5), None, _) => Self::Alpha(i),
            ("a", Some(i @ 0..=5), None, _) => Self::A(i),
            ("theta", Some(i @ 1..=6), None, _) => Self::Theta(i),
            ("d", Some(i @ 1..=6), None, _) => Self::D(i),
            ("beta", Some(i @ 1..=5), None, _) => Self::Beta(i),
            ("compliance", Some(j @ 2..=5), None, _) => Self::Compliance(j),
            ("gear", Some(j @ 1..=6), Some("cos"), _) => Self::GearCos(j),
            ("gear", Some(j @ 1..=6), Some("sin"), _) => Self::GearSin(j),
            ("tool", None, Some(_), Some(axis)) if digits.is_empty() => Self::Tool(axis),
            ("centre", Some(k @ 1..), Some(_), Some(axis)) => Self::Centre(k, axis),
            _ => return Err(unknown()),
        };
        // `alpha01` or `a+1` would parse as numbers but are not names.
        if id.to_string() == word { Ok(id) } else { Err(unknown()) }
    }
}

/// What stands around the robot: how many base balls, and how many bars of different length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetUp {
    /// Base balls.
    pub centres: usize,
    /// Bars.
    pub bars: usize,
}

impl SetUp {
    /// # Errors
    /// A parameter of a base ball or bar that is not there.
    pub fn check(self, id: ParamId) -> Result<(), UnknownParameter> {
        let hint = match id {
            ParamId::Centre(k, _) if k > self.centres => {
                format!("the data have {} base ball(s)", self.centres)
            }
            ParamId::BarOffset(k) if k > self.bars => format!("the data have {} bar(s)", self.bars),
            _ => return Ok(()),
        };
        Err(UnknownParameter { word: id.to_string(), hint })
    }
}

/// Base balls measured with one bar.
impl From<usize> for SetUp {
    fn from(centres: usize) -> Self {
        Self { centres, bars: 1 }
    }
}

/// The members of the optional group `compliance`.
pub fn compliance() -> impl Iterator<Item = ParamId> {
    (2..=5).map(ParamId::Compliance)
}

/// The members of the optional group `gear`.
pub fn gear() -> impl Iterator<Item = ParamId> {
    (1..=AXES).flat_map(|j| [ParamId::GearCos(j), ParamId::GearSin(j)])
}

/// The parameters that a LIST may name, in canonical order, for a robot in its set-up: the 24, the
/// `betas` of its nominally parallel axes, tool, centres, bars. The optional groups are not among them.
pub fn all(betas: &[usize], set_up: impl Into<SetUp>) -> Vec<ParamId> {
    let SetUp { centres, bars } = set_up.into();
    ParamId::denavit_hartenberg()
        .chain(betas.iter().map(|&joint| ParamId::Beta(joint)))
        .chain((0..3).map(ParamId::Tool))
        .chain((1..=centres).flat_map(|k| (0..3).map(move |axis| ParamId::Centre(k, axis))))
        .chain((1..=bars).map(ParamId::BarOffset))
        .collect()
}

/// Reads a LIST: names, ranges (`alpha1-5`) and groups, comma-separated; sorted, each once.
///
/// # Errors
/// A word that is neither, or a centre or bar that the set-up has not.
pub fn parse_list(
    list: &str,
    betas: &[usize],
    set_up: impl Into<SetUp>,
) -> Result<Vec<ParamId>, UnknownParameter> {
    let set_up = set_up.into();
    let everything = all(betas, set_up);
    let mut chosen = Vec::new();
    for word in list.split(',').map(str::trim).filter(|word| !word.is_empty()) {
        match word {
            "all" => chosen.extend(&everything),
            "geometric" => chosen.extend(everything.iter().filter(|id| id.is_geometric())),
            "tool" => chosen.extend((0..3).map(ParamId::Tool)),
            "centres" => chosen.extend(everything.iter().filter(|id| matches!(id, ParamId::Centre(..)))),
            "bar" => chosen.extend((1..=set_up.bars).map(ParamId::BarOffset)),
            "compliance" => chosen.extend(compliance()),
            "gear" => chosen.extend(gear()),
            _ => match word.split_once('-') {
                Some((first, last)) => chosen.extend(range(word, first, last)?),
                None => chosen.push(word.parse()?),
            },
        }
    }
    chosen.sort();
    chosen.dedup();
    chosen.iter().try_for_each(|id| set_up.check(*id))?;
    Ok(chosen)
}

/// `alpha1-5`: the stem once, two numbers.
fn range(word: &str, first: &str, last: &str) -> Result<Vec<ParamId>, UnknownParameter> {
    let unknown = || UnknownParameter::new(word);
    let stem = first.trim_end_matches(|c: char| c.is_ascii_digit());
    let from: usize = first[stem.len()..].parse().map_err(|_| unknown())?;
    let to: usize = last.strip_prefix(stem).unwrap_or(last).parse().map_err(|_| unknown())?;
    if from > to || to > 99 {
        return Err(unknown());
    }
    (from..=to).map(|number| format!("{stem}{number}").parse()).collect()
}
