//! A KRL data list for the controller: tool ball and base balls as frames, and the mastering offsets.

use std::fmt::Write;

use serde::Serialize;

use super::mastering::{AxisOffset, remark};
use dbbd_model::estimation::result::{CalibrationResult, ParameterResult, Status};
use dbbd_model::robot::{BallId, Coordinate, ParamId};

/// Name of the data list.
const MODULE: &str = "DBB_RESULT";
/// Name of the file of the data list.
pub(super) const FILE: &str = "DBB_RESULT.dat";

/// Longest comment line, characters.
const LINE: usize = 110;

/// A ball in a frame: the tool ball in the flange frame, or a base ball in the robot base.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BallInFrame {
    /// Variable in the data list.
    pub variable: String,
    /// The ball in words, such as `tool ball in $FLANGE`.
    pub what: String,
    pub nominal_mm: [f64; 3],
    pub identified_mm: [f64; 3],
    corrections_mm: [f64; 3],
    /// Status of each coordinate.
    statuses: [Status; 3],
    /// Remark on each coordinate.
    pub remarks: [String; 3],
}

/// The tool ball, then the base balls.
pub fn frames(result: &CalibrationResult) -> Vec<BallInFrame> {
    let balls = (0..).map(BallId::at).map_while(|ball| {
        let place = coordinates(result, |axis| ParamId::Ball(ball, axis))?;
        Some(frame(format!("DBB_BALL{ball}"), format!("base ball {ball} in $ROBROOT"), place))
    });
    let tool = coordinates(result, ParamId::Tool)
        .map(|place| frame("DBB_TOOL".into(), "tool ball in $FLANGE".into(), place));
    tool.into_iter().chain(balls).collect()
}

fn coordinates(
    result: &CalibrationResult,
    id: impl Fn(Coordinate) -> ParamId,
) -> Option<[&ParameterResult; 3]> {
    let [x, y, z] = Coordinate::ALL.map(|axis| result.parameter(id(axis)));
    Some([x?, y?, z?])
}

fn frame(variable: String, what: String, place: [&ParameterResult; 3]) -> BallInFrame {
    BallInFrame {
        variable,
        what,
        nominal_mm: place.map(|coordinate| coordinate.nominal),
        identified_mm: place.map(|coordinate| coordinate.identified),
        corrections_mm: place.map(|coordinate| coordinate.identified - coordinate.nominal),
        statuses: place.map(|coordinate| coordinate.status),
        remarks: place.map(remark),
    }
}

/// `DBB_RESULT.dat`: frames and offsets, each with its remark as a comment.
pub(super) fn data_list(robot: &str, frames: &[BallInFrame], offsets: &[AxisOffset]) -> String {
    let mut text = format!("&ACCESS RVO\n&COMMENT dbbd\nDEFDAT {MODULE} PUBLIC\n");
    text.push_str(&comment(&format!("Identified from ball-bar lengths on {robot}")));
    text.push_str("; Nothing here acts by itself. Frames as X, Y, Z in mm; A, B, C are those of the flange or the base.\n");
    for BallInFrame { variable, what, identified_mm, corrections_mm, remarks, .. } in frames {
        let _ = writeln!(text, "\n; {what}, corrected by {}", krl(corrections_mm));
        for (axis, remark) in ["X", "Y", "Z"].into_iter().zip(remarks) {
            text.push_str(&comment(&format!("{axis}: {remark}")));
        }
        let _ = writeln!(text, "DECL FRAME {variable}={{{},A 0.0,B 0.0,C 0.0}}", krl(identified_mm));
    }
    text.push_str("\n; Zero errors of the axes, degrees: an axis that shows A is at A + offset. An offset of 0.0 without\n");
    text.push_str("; a standard deviation says nothing. They belong to the identified table as a whole: with the nominal table they are\n");
    text.push_str("; the best of these single corrections, not all of it.\n");
    for offset in offsets {
        text.push_str(&comment(&format!("A{}: {}", offset.axis, offset.remark)));
    }
    let angles: Vec<String> =
        offsets.iter().map(|o| format!("A{} {}", o.axis, number(o.offset_deg))).collect();
    let _ = writeln!(text, "DECL AXIS DBB_MASTERING={{{}}}\nENDDAT", angles.join(","));
    text.replace('\n', "\r\n")
}

fn krl(place_mm: &[f64; 3]) -> String {
    let [x, y, z] = place_mm.map(number);
    format!("X {x},Y {y},Z {z}")
}

/// Four decimals, without a negative zero.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    if text == "-0.0000" { "0.0000".into() } else { text }
}

/// A comment in ASCII, in lines that fit a controller's editor.
fn comment(text: &str) -> String {
    let mut lines = String::from(";");
    let mut length = 1;
    for word in text.split_whitespace() {
        if length + word.len() > LINE {
            lines.push_str("\n;");
            length = 1;
        }
        lines.push(' ');
        lines.extend(word.chars().map(|c| if c.is_ascii_graphic() { c } else { '?' }));
        length += 1 + word.len();
    }
    lines + "\n"
}
