//! A quantity in time: values with their 95 % intervals, and the straight line through them.

use super::Series;
use super::frame::{Area, Frame, Labels};
use crate::math::straight_line::StraightLine;
use crate::report::scale::{Unit, range, signed, significant};

/// Three stand side by side.
const SIZE: [f64; 2] = [330.0, 230.0];
const COVERAGE: f64 = 1.96;

/// The values of a quantity at their times.
pub(crate) struct TrendPlot<'a> {
    pub(crate) title: &'a str,
    pub(crate) unit: Unit,
    /// Name of the time axis with unit.
    pub(crate) time_name: &'a str,
    /// Time, value and standard deviation.
    pub(crate) values: Vec<[f64; 3]>,
    pub(crate) line: Option<StraightLine>,
    /// A level that must not be exceeded, in the quantity's own unit.
    pub(crate) limit: Option<f64>,
}

impl TrendPlot<'_> {
    pub(crate) fn to_svg(&self) -> String {
        let factor = self.unit.factor;
        let ends = self
            .values
            .iter()
            .flat_map(|[_, value, sd]| [(value - COVERAGE * sd) * factor, (value + COVERAGE * sd) * factor]);
        let [low, high] = range(ends.chain(self.limit.map(|limit| limit * factor)));
        let [first, last] = range(self.values.iter().map(|[time, ..]| *time));
        let (pad, wide) = (0.08 * (high - low), 0.05 * (last - first));
        let labels = Labels {
            title: self.title,
            description: "Values with their 95 % intervals against time",
            x: self.time_name,
            y: &format!("({})", self.unit.sign),
        };
        let x = [first - wide, last + wide];
        let mut frame = Frame::new(Area::of(SIZE), &labels, x, [low - pad, high + pad]);
        frame.axes();
        if let Some(limit) = self.limit {
            frame.level("limit", limit * factor);
        }
        if let Some(line) = self.line {
            let [from, to] = [first, last].map(|time| frame.at(time, line.at(time) * factor));
            frame.svg.line(Series::Third.line(), from, to);
        }
        for &[time, value, sd] in &self.values {
            let [bottom, top] = [-COVERAGE, COVERAGE].map(|k| frame.at(time, (value + k * sd) * factor));
            frame.svg.line("l-bar", bottom, top);
            let width = significant(COVERAGE * sd * factor, 2);
            let tip = format!("{} ± {width} {}", signed(value * factor, 4), self.unit.sign);
            frame.svg.circle(Series::Second.dot(), frame.at(time, value * factor), 3.0, &tip);
        }
        frame.svg.finish()
    }
}
