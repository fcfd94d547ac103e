//! A program as the list of its actions, independent of the language. The simulated controller executes this list for
//! RAPID, URScript and TP programs: the supported programs of these languages have neither variables that change nor
//! conditions. KRL has an interpreter.

use std::fmt;

use super::text::{Span, Text};
use super::{Frames, Language, MotionKind, Setup, Target, krl};
use dbbd_model::diagnostic::{Diagnostic, Finding};
use dbbd_model::robot::inverse::{self, FanucConfiguration, Unsolved};
use dbbd_model::robot::{AXES, Geometry, Pose, Robot};

/// A program for the simulated controller.
#[derive(Clone, Debug)]
pub enum Program {
    Krl(krl::Program),
    Listed(Listing),
}

impl From<krl::Program> for Program {
    fn from(program: krl::Program) -> Self {
        Self::Krl(program)
    }
}

impl From<Listing> for Program {
    fn from(listing: Listing) -> Self {
        Self::Listed(listing)
    }
}

impl Program {
    /// The file in which execution begins.
    pub fn first(&self) -> Text<'_> {
        match self {
            Self::Krl(program) => program.first(),
            Self::Listed(listing) => listing.text(0),
        }
    }

    /// The set-up of each module that has one.
    pub fn setups(&self) -> Vec<Setup> {
        match self {
            Self::Krl(program) => program.setups(),
            Self::Listed(listing) => listing.setups.clone(),
        }
    }
}

/// The actions of a program, in order.
#[derive(Clone, Debug)]
pub struct Listing {
    pub language: Language,
    /// Name and text of each file.
    pub files: Vec<(String, String)>,
    pub actions: Vec<Action>,
    pub setups: Vec<Setup>,
}

impl Listing {
    /// The text of a file, by its index.
    pub fn text(&self, file: usize) -> Text<'_> {
        self.files.get(file).map_or(Text { file: "", text: "" }, |(file, text)| Text { file, text })
    }

    /// A finding about an action.
    pub fn wrong(&self, action: &Action, finding: impl Finding) -> Diagnostic {
        self.text(action.file).wrong(&action.span, finding)
    }
}

/// An action and the statement that causes it.
#[derive(Clone, Debug)]
pub struct Action {
    /// Index in [`Listing::files`].
    pub file: usize,
    pub span: Span,
    pub kind: ActionKind,
}

#[derive(Clone, Debug)]
pub enum ActionKind {
    /// The bar is on this base ball from here on.
    SelectBall(u32),
    Move(Box<Move>),
    /// Wait, seconds.
    Wait(f64),
    WaitForStandstill(Standstill),
    SetStrobe(bool),
    /// Sets the strobe high for this time, s, while the program continues.
    PulseStrobe(f64),
    /// Waits for the operator.
    Halt,
}

/// The condition that a program waits for after a motion; for the program, a motion ends when its command ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standstill {
    /// The arm is within a band about the commanded position.
    InPosition,
    /// No axis moves.
    ZeroSpeed,
}

#[derive(Clone, Debug)]
pub struct Move {
    pub motion: MotionKind,
    /// The auxiliary point of an arc.
    pub through: Option<Target>,
    pub to: Target,
    /// The configuration of the arm: for a PTP the one to reach, for a line or an arc the one that is checked at its
    /// end.
    pub configuration: Option<ProgrammedConfiguration>,
    pub frames: Frames,
    pub pace: Pace,
    /// Whether the program waits at the end of the motion until the robot is in position: `FINE` of a TP program.
    pub ends_in_position: bool,
}

/// The configuration of the arm that a target names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgrammedConfiguration {
    /// ABB's configuration, see [`inverse::quadrants`].
    Quadrants([i32; 4]),
    /// FANUC's configuration.
    Fanuc(FanucConfiguration),
}

impl ProgrammedConfiguration {
    /// The axis angles (rad) of a pose.
    pub fn axes(self, robot: &Robot, pose: &Pose) -> Result<[f64; AXES], Unsolved> {
        match self {
            Self::Quadrants(wanted) => inverse::from_quadrants(robot, pose, wanted),
            Self::Fanuc(wanted) => inverse::from_fanuc(robot, pose, wanted, None),
        }
    }

    /// The configuration of an arm at the end of a line, if the controller refuses it there. A FANUC ignores the turns.
    pub fn refused(self, geometry: &Geometry, axes: &[f64; AXES]) -> Option<Self> {
        let (reached, is_accepted) = match self {
            Self::Quadrants(wanted) => {
                let reached = inverse::quadrants(geometry, axes);
                (Self::Quadrants(reached), reached == wanted)
            }
            Self::Fanuc(wanted) => {
                let reached = FanucConfiguration::certain(geometry, axes)?;
                (Self::Fanuc(reached), reached.is_branch_of(&wanted))
            }
        };
        (!is_accepted).then_some(reached)
    }
}

impl fmt::Display for ProgrammedConfiguration {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Quadrants(quadrants) => write!(out, "{quadrants:?}"),
            Self::Fanuc(configuration) => write!(out, "{configuration}"),
        }
    }
}

/// The programmed speed of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// Duration of the whole motion, s.
    Duration(f64),
    /// Speed and acceleration of the tool point; speed of the orientation, if it is limited.
    Tool { mm_s: f64, mm_s2: f64, deg_s: Option<f64> },
    /// Speed and acceleration of the fastest axis.
    Axis { deg_s: f64, deg_s2: f64 },
    /// Share of the greatest speed of the axes.
    AxisShare(f64),
}
