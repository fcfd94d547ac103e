//! A program as a list of what it does, whatever the controller's language: what the simulated controller executes of
//! the languages whose programs here have no variables that change. (KRL has an interpreter of its own.)

use super::text::{Span, Text};
use super::{Frames, Language, Motion, Target, krl};
use crate::diagnostic::{Diagnostic, Finding};

/// The ball and the bar that a module of dbbd names (in KRL, its `.dat`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Number of the base ball, from 1.
    pub ball: u32,
    /// In the robot base.
    pub centre_mm: [f64; 3],
    /// Distance between the ball centres at reading zero.
    pub length_mm: f64,
    /// Lowest and highest reading.
    pub stroke_mm: [f64; 2],
}

/// A program with what its modules name.
pub trait Equipped {
    /// The set-up of each module that has one.
    fn setups(&self) -> Vec<Setup>;
}

/// A program that the simulated controller executes.
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

impl Equipped for Program {
    fn setups(&self) -> Vec<Setup> {
        match self {
            Self::Krl(program) => program.setups(),
            Self::Listed(listing) => listing.setups.clone(),
        }
    }
}

impl Equipped for Listing {
    fn setups(&self) -> Vec<Setup> {
        self.setups.clone()
    }
}

/// What a program does, in order.
#[derive(Clone, Debug)]
pub struct Listing {
    pub language: Language,
    /// Name and text of each file.
    pub files: Vec<(String, String)>,
    pub actions: Vec<Action>,
    pub setups: Vec<Setup>,
}

impl Listing {
    /// The text of a file, by its number.
    pub fn text(&self, file: usize) -> Text<'_> {
        self.files.get(file).map_or(Text { file: "", text: "" }, |(file, text)| Text { file, text })
    }

    /// A finding about an action.
    pub fn wrong(&self, action: &Action, finding: impl Finding) -> Diagnostic {
        self.text(action.file).wrong(&action.span, finding)
    }
}

/// One thing that a program does, and the statement that says so.
#[derive(Clone, Debug)]
pub struct Action {
    /// Number of the file in [`Listing::files`].
    pub file: usize,
    pub span: Span,
    pub does: Does,
}

#[derive(Clone, Debug)]
pub enum Does {
    /// From here on the bar is on this base ball.
    Ball(u32),
    Move(Box<Move>),
    /// Seconds.
    Wait(f64),
    Standstill(Standstill),
    Strobe(bool),
    /// The strobe goes high for so long, s, while the program goes on.
    Pulse(f64),
    /// Until the operator goes on.
    Halt,
}

/// What a program waits for after a motion: its end is that of the command, not of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standstill {
    /// The arm is within a band about the commanded position.
    InPosition,
    /// No axis moves.
    ZeroSpeed,
}

#[derive(Clone, Debug)]
pub struct Move {
    pub motion: Motion,
    /// The auxiliary point of an arc, mm, in the base frame.
    pub through_mm: Option<[f64; 3]>,
    pub to: Target,
    /// The axis configuration that is to be taken (of a PTP) or checked (of a line or an arc).
    pub configuration: Option<[i32; 4]>,
    pub frames: Frames,
    pub pace: Pace,
}

/// How fast a motion is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// The whole motion in so long, s.
    Duration(f64),
    /// Speed and acceleration of the tool point, mm/s and mm/s^2, and of the orientation, degrees/s, where it is limited.
    Tool { mm_s: f64, mm_s2: f64, deg_s: Option<f64> },
    /// Speed and acceleration of the fastest axis, degrees/s and degrees/s^2.
    Axis { deg_s: f64, deg_s2: f64 },
}
