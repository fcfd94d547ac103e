//! Values with their 95 % intervals, one line each.

use super::frame::{Area, Frame, Grid, Labels, NARROW};
use super::{Key, Legend};
use crate::report::scale::{Ticks, Unit, magnitude, signed};
use crate::report::svg::Anchor;

const ROW: f64 = 19.0;
const TOP: f64 = 46.0;
/// Room for names: for short ones, for each letter of a longer one, and between a name and the chart.
const NAME: f64 = 104.0;
const LETTER: f64 = 7.2;
const GAP: f64 = 8.0;

/// A chart of corrections or changes, about zero.
pub(crate) struct Intervals {
    pub(crate) title: String,
    pub(crate) description: &'static str,
    pub(crate) unit: Unit,
    pub(crate) rows: Vec<Interval>,
    /// One standard deviation of the tolerance, in the parameters' own unit: a band about zero.
    pub(crate) tolerance: Option<f64>,
}

/// A value with the half width of its interval, in its own unit.
pub(crate) struct Interval {
    pub(crate) name: String,
    pub(crate) value: f64,
    pub(crate) half_width: f64,
}

impl Intervals {
    /// `None` without a value. The values set the scale; a wider interval ends at the edge.
    pub(crate) fn to_svg(&self) -> Option<String> {
        if self.rows.is_empty() {
            return None;
        }
        let factor = self.unit.factor;
        let tolerance = self.tolerance.map(|width| width * factor);
        let tolerance = tolerance.filter(|width| width.is_finite() && *width > 0.0);
        let ends = self.rows.iter().flat_map(|row| {
            let (value, half) = (row.value * factor, row.half_width * factor);
            let half = half.min(3.0 * value.abs());
            [value - half, value + half]
        });
        let most = 1.06 * magnitude(ends.chain(tolerance));
        let bottom = TOP + ROW * self.rows.len() as f64 + 4.0;
        let letters = self.rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0) as f64;
        let left = NAME.max(LETTER * letters + 2.0 * GAP);
        let area = Area { width: NARROW, left, right: 466.0, top: TOP, bottom };
        let labels = Labels {
            title: &self.title,
            description: self.description,
            x: &format!("({})", self.unit.sign),
            y: "",
        };
        let mut frame = Frame::new(area, &labels, [-most, most], [self.rows.len() as f64 + 4.0 / ROW, 0.0]);
        let mut legend = Legend::new(34.0);
        if let Some(width) = tolerance {
            frame.svg.rect("band", [frame.x.at(-width), TOP], [frame.x.at(width), bottom], "");
            legend.add(&mut frame.svg, Key::Band, "± 1 tolerance of the maker");
        }
        legend.add(&mut frame.svg, Key::Interval, "value, 95 % interval");
        frame.x_axis(&Ticks::inside([-most, most], 6.0), Grid::Lines);
        frame.upright("zero", 0.0);
        for (number, row) in self.rows.iter().enumerate() {
            self.draw(&mut frame, number, row);
        }
        Some(frame.svg.finish())
    }

    fn draw(&self, frame: &mut Frame, number: usize, row: &Interval) {
        let (name, factor) = (&row.name, self.unit.factor);
        let (value, half_width) = (row.value * factor, row.half_width * factor);
        let [left, right] = frame.x.pixels;
        let [x, y] = frame.at(value, number as f64 + 0.5);
        let [low, high] =
            [value - half_width, value + half_width].map(|end| frame.x.at(end).clamp(left, right));
        frame.svg.text("mono", [left - GAP, y + 4.0], Anchor::End, name);
        frame.svg.line("l-bar", [low, y], [high, y]);
        frame.svg.line("l-bar", [low, y - 4.0], [low, y + 4.0]);
        frame.svg.line("l-bar", [high, y - 4.0], [high, y + 4.0]);
        let half = signed(half_width, 2);
        let tip =
            format!("{name}: {} ± {} {}", signed(value, 2), half.trim_start_matches('+'), self.unit.sign);
        frame.svg.circle("d-after", [x, y], 3.4, &tip);
    }
}
