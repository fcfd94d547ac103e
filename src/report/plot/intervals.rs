//! Corrections with their 95 % intervals, one line each.

use super::frame::NARROW;
use crate::report::scale::{Scale, Ticks, magnitude, signed};
use crate::report::svg::{Anchor, Svg};

const ROW: f64 = 19.0;
const LEFT: f64 = 104.0;
const RIGHT: f64 = 466.0;
const TOP: f64 = 46.0;

/// A chart of values with error bars about zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Intervals {
    /// What it shows.
    pub title: String,
    /// Unit of all values, such as `µm`.
    pub unit: String,
    /// The lines, from the top.
    pub rows: Vec<Interval>,
    /// Half width of a band about zero (one tolerance), in the unit.
    pub tolerance: Option<f64>,
}

/// A value with its interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Interval {
    /// Name of the quantity.
    pub name: String,
    /// The value.
    pub value: f64,
    /// Half width of the 95 % interval.
    pub half_width: f64,
}

impl Intervals {
    /// Draws it; the values set the scale, and an interval that is wider runs to the edge.
    pub fn to_svg(&self) -> String {
        let bottom = TOP + ROW * self.rows.len() as f64 + 4.0;
        let tolerance = self.tolerance.filter(|width| width.is_finite() && *width > 0.0);
        let ends = self.rows.iter().flat_map(|row| {
            let half = row.half_width.min(3.0 * row.value.abs());
            [row.value - half, row.value + half]
        });
        let most = 1.06 * magnitude(ends.chain(tolerance));
        let x = Scale { values: [-most, most], pixels: [LEFT, RIGHT] };
        let mut svg = Svg::new(NARROW, bottom + 42.0, &self.title, "Correction with its 95 % interval");
        svg.text("head", [4.0, 16.0], Anchor::Start, &self.title);
        let mut note = 4.0;
        if let Some(width) = tolerance {
            svg.rect("band", [x.at(-width), TOP], [x.at(width), bottom], "");
            svg.rect("band", [note, 25.0], [note + 14.0, 35.0], "");
            svg.text("soft", [note + 19.0, 34.0], Anchor::Start, "± 1 tolerance of the maker");
            note += 200.0;
        }
        svg.circle("d-after", [note + 10.0, 30.0], 3.4, "");
        svg.line("l-bar", [note, 30.0], [note + 20.0, 30.0]);
        svg.text("soft", [note + 26.0, 34.0], Anchor::Start, "value, 95 % interval");
        let ticks = Ticks::inside(x.values, 6.0);
        for &value in &ticks.values {
            let class = if value == 0.0 { "zero" } else { "grid" };
            svg.line(class, [x.at(value), TOP], [x.at(value), bottom]);
            svg.text("soft", [x.at(value), bottom + 17.0], Anchor::Middle, &ticks.label(value));
        }
        svg.text("soft", [0.5 * (LEFT + RIGHT), bottom + 34.0], Anchor::Middle, &format!("({})", self.unit));
        for (number, row) in self.rows.iter().enumerate() {
            let y = TOP + ROW * (number as f64 + 0.5);
            svg.text("mono", [LEFT - 8.0, y + 4.0], Anchor::End, &row.name);
            let [low, high] = [row.value - row.half_width, row.value + row.half_width]
                .map(|end| x.at(end).clamp(LEFT, RIGHT));
            svg.line("l-bar", [low, y], [high, y]);
            svg.line("l-bar", [low, y - 4.0], [low, y + 4.0]);
            svg.line("l-bar", [high, y - 4.0], [high, y + 4.0]);
            let tip = format!(
                "{}: {} ± {} {}",
                row.name,
                signed(row.value, 2),
                signed(row.half_width, 2).trim_start_matches('+'),
                self.unit
            );
            svg.circle("d-after", [x.at(row.value), y], 3.4, &tip);
        }
        svg.finish()
    }
}
