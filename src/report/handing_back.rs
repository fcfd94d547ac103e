//! What goes back to the controller, as the page shows it.

use serde::Serialize;

use super::scale::{fixed, signed};

/// The zero error of an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisZero {
    /// Axis, from 1.
    pub axis: usize,
    /// Where it stands minus what is shown, degrees.
    pub offset_deg: f64,
    /// One standard deviation, degrees.
    pub sd_deg: Option<f64>,
    /// Whether the data tell it.
    pub told: bool,
    /// What to know of it.
    pub remark: String,
}

/// A ball in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BallPlace {
    /// What it is.
    pub what: String,
    /// Where it was found, mm.
    pub found_mm: [f64; 3],
    /// Found minus what was taken, mm.
    pub corrected_mm: [f64; 3],
    /// Whether the data tell it.
    pub told: bool,
}

#[derive(Serialize)]
pub(super) struct ZeroLine {
    axis: String,
    offset: String,
    sd: String,
    class: &'static str,
    remark: String,
}

#[derive(Serialize)]
pub(super) struct PlaceLine {
    what: String,
    found: [String; 3],
    corrected: [String; 3],
    class: &'static str,
    told: &'static str,
}

fn class(told: bool) -> &'static str {
    if told { "told" } else { "untold" }
}

pub(super) fn zeros(axes: &[AxisZero]) -> Vec<ZeroLine> {
    let line = |zero: &AxisZero| ZeroLine {
        axis: format!("A{}", zero.axis),
        offset: if zero.told { signed(zero.offset_deg, 4) } else { "–".into() },
        sd: zero.sd_deg.map_or("–".into(), |sd| fixed(sd, 4)),
        class: class(zero.told),
        remark: zero.remark.clone(),
    };
    axes.iter().map(line).collect()
}

pub(super) fn places(balls: &[BallPlace]) -> Vec<PlaceLine> {
    let line = |ball: &BallPlace| PlaceLine {
        what: ball.what.clone(),
        found: ball.found_mm.map(|value| fixed(value, 4)),
        corrected: ball.corrected_mm.map(|value| signed(value, 4)),
        class: class(ball.told),
        told: if ball.told { "told by the data" } else { "not all told: see the parameters" },
    };
    balls.iter().map(line).collect()
}
