//! Tool ball and base balls as KRL frames, with the mastering offsets: a data list that a controller loads.

use std::fmt::Write;

use super::mastering::{AxisOffset, remark};
use crate::identify::result::{Identification, ParameterResult};

/// Name of the data list: the file must have it too.
pub const MODULE: &str = "DBB_RESULT";

/// Characters of a comment line.
const LINE: usize = 110;

/// A ball in a frame: the tool ball in the flange's, or a base ball in the robot base.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Variable in the data list.
    pub variable: String,
    /// What it is, such as `tool ball in $FLANGE`.
    pub what: String,
    /// Where it was taken to be, mm.
    pub before_mm: [f64; 3],
    /// Where it was found, mm.
    pub found_mm: [f64; 3],
    /// One standard deviation of each coordinate, mm, where it was estimated.
    pub sd_mm: [Option<f64>; 3],
    /// Whether all three are told by the data.
    pub told: bool,
    /// What to know of each coordinate.
    pub remarks: [String; 3],
}

/// The tool ball, then the base balls.
pub fn frames(result: &Identification) -> Vec<Frame> {
    let balls = (1..).map_while(|k| {
        let place = coordinates(result, &format!("centre{k}_"))?;
        Some(frame(format!("DBB_BALL{k}"), format!("base ball {k} in $ROBROOT"), place))
    });
    let tool = coordinates(result, "tool_")
        .map(|place| frame("DBB_TOOL".into(), "tool ball in $FLANGE".into(), place));
    tool.into_iter().chain(balls).collect()
}

fn coordinates<'a>(result: &'a Identification, stem: &str) -> Option<[&'a ParameterResult; 3]> {
    let find = |axis: &str| {
        let name = format!("{stem}{axis}");
        result.parameters.iter().find(|parameter| parameter.name == name)
    };
    Some([find("x")?, find("y")?, find("z")?])
}

fn frame(variable: String, what: String, place: [&ParameterResult; 3]) -> Frame {
    let remarks = place.map(remark);
    Frame {
        variable,
        what,
        before_mm: place.map(|coordinate| coordinate.nominal),
        found_mm: place.map(|coordinate| coordinate.identified),
        sd_mm: place.map(|coordinate| coordinate.sd),
        told: remarks.iter().all(|(told, _)| *told),
        remarks: remarks.map(|(_, text)| text),
    }
}

/// `DBB_RESULT.dat`: frames and offsets, each with what is to be known of it as a comment.
pub fn data_list(robot: &str, frames: &[Frame], offsets: &[AxisOffset]) -> String {
    let mut text = format!("&ACCESS RVO\n&COMMENT dbbd\nDEFDAT {MODULE} PUBLIC\n");
    text.push_str(&comment(&format!("Found by ball-bar lengths on {robot}")));
    text.push_str("; Nothing here acts by itself. Frames as X, Y, Z in mm; A, B, C are those of the flange or the base.\n");
    for Frame { variable, what, before_mm, found_mm, remarks, .. } in frames {
        let by: [f64; 3] = std::array::from_fn(|axis| found_mm[axis] - before_mm[axis]);
        let _ = writeln!(text, "\n; {what}, corrected by {}", krl(&by));
        for (axis, remark) in ["X", "Y", "Z"].into_iter().zip(remarks) {
            text.push_str(&comment(&format!("{axis}: {remark}")));
        }
        let _ = writeln!(text, "DECL FRAME {variable}={{{},A 0.0,B 0.0,C 0.0}}", krl(found_mm));
    }
    text.push_str("\n; Zero errors of the axes, degrees: an axis that shows A stands at A + offset. An offset of 0.0 that is not\n");
    text.push_str("; told is no statement. They belong to the identified table as a whole: with the nominal table they are the\n");
    text.push_str("; best of these single corrections, not all of it.\n");
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

/// Four decimals, never minus zero.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    if text == "-0.0000" { "0.0000".into() } else { text }
}

/// A comment in ASCII, in lines that a controller's editor shows.
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
