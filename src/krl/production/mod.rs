//! Reads point programs as they are made on controllers: inline forms, taught points, frames.
//!
//! The reader looks for motions and for what sets `$TOOL` and `$BASE`; every other statement is passed
//! over, whatever it is, because the program is to be rewritten and not executed. It goes line by
//! line, so that what it does not know cannot lead it astray.

mod constants;
mod frames;
mod line;
mod walk;

use super::syntax::Span;
use crate::diag::Diagnostic;
use crate::model::{AXES, Pose};

/// A file as the user named it, and its text.
#[derive(Clone, Copy, Debug)]
pub struct Text<'a> {
    /// The file's name, for messages.
    pub file: &'a str,
    /// What stands in it.
    pub text: &'a str,
}

impl Text<'_> {
    fn wrong(&self, span: &Span, message: impl Into<String>) -> Diagnostic {
        Diagnostic::span(self.file, self.text, span.clone(), message)
    }

    /// The line (from 1) in which a byte stands.
    fn line(&self, at: usize) -> usize {
        self.text.as_bytes().get(..at).unwrap_or_default().iter().filter(|byte| **byte == b'\n').count() + 1
    }
}

/// The files of a point program.
#[derive(Clone, Copy, Debug)]
pub struct Files<'a> {
    /// `NAME.src`
    pub source: Text<'a>,
    /// `NAME.dat`, where there is one.
    pub data: Option<Text<'a>>,
    /// `$config.dat`, which holds `TOOL_DATA` and `BASE_DATA`.
    pub config: Option<Text<'a>>,
}

/// What the user says `$TOOL` and `$BASE` are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given {
    /// `$TOOL`, in the flange frame.
    pub tool: Option<Pose>,
    /// `$BASE`, in the robot's base.
    pub base: Option<Pose>,
}

/// The file in which something stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Origin {
    /// The `.src`.
    Source,
    /// The `.dat`.
    Data,
    /// `$config.dat`, which is never rewritten.
    Config,
}

/// A number in a file.
#[derive(Clone, Debug)]
pub struct Number {
    /// Its value.
    pub value: f64,
    /// Its bytes.
    pub span: Span,
}

/// What is written for a point. Nearly all are poses, so that boxing them would save nothing.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug)]
pub enum Position {
    /// A1 to A6, degrees.
    Axes([Number; AXES]),
    /// A pose of the tool in the base frame.
    Pose {
        /// X, Y, Z, mm, and A, B, C, degrees.
        numbers: [Number; 6],
        /// KUKA's status bits, where they are given.
        status: Option<i64>,
        /// KUKA's turn bits, where they are given, and their bytes.
        turn: Option<(i64, Span)>,
        /// `$TOOL` in the flange frame, and
        tool: Pose,
        /// `$BASE` in the robot's base, when the robot goes there.
        base: Pose,
    },
}

/// A point to which the program moves.
#[derive(Clone, Debug)]
pub struct TaughtPoint {
    /// Its name in capitals; `inline` for one without.
    pub name: String,
    /// The file in which it stands.
    pub origin: Origin,
    /// Its bytes there.
    pub span: Span,
    /// The statement in the `.src` that goes there first.
    pub used: Span,
    /// Whether a PTP or SPTP goes there: only these follow status and turn.
    pub by_ptp: bool,
    /// What is written for it.
    pub position: Position,
}

/// The points of a program, in the order in which it first goes there.
#[derive(Clone, Debug)]
pub struct PointProgram {
    /// Points that stand in the program's own files.
    pub points: Vec<TaughtPoint>,
    /// Motions that are not to a point of these files (relative ones, points declared elsewhere), each
    /// with its place and why it stays.
    pub left: Vec<Diagnostic>,
}

/// Reads a point program.
///
/// # Errors
/// A point or frame that is not understood, or that is not known before the program runs; `$TOOL` or
/// `$BASE` that nothing tells; each with its line and column.
pub fn read(files: Files<'_>, given: Given) -> Result<PointProgram, Diagnostic> {
    walk::Walk::new(files, given)?.read()
}
