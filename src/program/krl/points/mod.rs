//! The motions of a program, as they are made on controllers (inline forms, taught points) or by dbbd: in order, each
//! with its points, their frames and their bytes.
//!
//! The reader looks for motions and for what sets `$TOOL` and `$BASE`; every other statement is passed over, because
//! the program is to be rewritten and not executed. It goes line by line, so that what it does not know cannot lead it
//! astray.

mod frames;
mod line;
mod walk;

use super::data::Origin;
use super::syntax::{Span, Text};
use crate::diagnostic::Diagnostic;
use crate::plan::Motion;
use crate::program::{Frames, Target};
use crate::robot::Pose;

#[derive(Clone, Copy, Debug)]
pub struct Files<'a> {
    /// `NAME.src`
    pub source: Text<'a>,
    /// `NAME.dat`, where there is one.
    pub data: Option<Text<'a>>,
    /// `$config.dat`, which holds `TOOL_DATA` and `BASE_DATA`.
    pub config: Option<Text<'a>>,
}

/// `$TOOL` and `$BASE` as the user gives them, where the program does not set them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given {
    /// In the flange frame.
    pub tool: Option<Pose>,
    /// In the robot's base.
    pub base: Option<Pose>,
}

/// A point to which the program moves.
#[derive(Clone, Debug)]
pub struct TaughtPoint {
    /// `inline` for one without.
    pub name: String,
    /// The file that is rewritten.
    pub origin: Origin,
    /// Its bytes there.
    pub span: Span,
    /// The statement in the `.src` that goes there first.
    pub used: Span,
    /// Whether a PTP or SPTP goes there: only these follow status and turn.
    pub by_ptp: bool,
    pub target: Target,
    /// The bytes of its six numbers.
    pub numbers: [Span; 6],
    /// The bytes of its turn bits.
    pub turn: Option<Span>,
    /// When the robot goes there; an axis position needs none.
    pub frames: Option<Frames>,
}

/// A motion: numbers of points in [`PointProgram::points`]. Of an array whose index is computed any element may be meant;
/// a point that is not in the program's files is none.
#[derive(Clone, Debug)]
pub struct Leg {
    pub motion: Motion,
    /// The auxiliary point of an arc.
    pub through: Vec<usize>,
    pub to: Vec<usize>,
    /// The angle round which an arc goes, degrees, where it does not end at `to`.
    pub sweep_deg: Option<f64>,
}

#[derive(Clone, Debug, Default)]
pub struct PointProgram {
    /// In the order in which the text goes there.
    pub legs: Vec<Leg>,
    /// Points of the program's own files, each once.
    pub points: Vec<TaughtPoint>,
    /// Motions that are not to a point of these files: relative ones, points declared elsewhere.
    pub left: Vec<Diagnostic>,
}

pub fn read(files: Files<'_>, given: Given) -> Result<PointProgram, Diagnostic> {
    walk::read(files, given)
}
