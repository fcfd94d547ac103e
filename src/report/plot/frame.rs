//! The frame of a plot with two straight axes: grid, ticks, labels.

use crate::report::scale::{Scale, Ticks};
use crate::report::svg::{Anchor, Svg};

/// Width of a figure that stands beside another one, pixels.
pub const NARROW: f64 = 480.0;
/// Width of a figure across the page, pixels.
pub const WIDE: f64 = 990.0;

/// Space around the plot area for title and labels, pixels.
const LEFT: f64 = 56.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 42.0;

/// A picture with its two scales.
pub(crate) struct Frame {
    pub(crate) svg: Svg,
    pub(crate) x: Scale,
    pub(crate) y: Scale,
}

/// What stands on the frame.
pub(crate) struct Labels<'a> {
    pub(crate) title: &'a str,
    pub(crate) description: &'a str,
    pub(crate) x: &'a str,
    pub(crate) y: &'a str,
}

impl Frame {
    /// A frame with room for `size`; ranges in display units.
    pub(crate) fn new(size: [f64; 2], x: [f64; 2], y: [f64; 2], labels: &Labels<'_>) -> Self {
        let [width, height] = size;
        let mut svg = Svg::new(width, height, labels.title, labels.description);
        svg.text("head", [4.0, 16.0], Anchor::Start, labels.title);
        Self {
            svg,
            x: Scale { values: x, pixels: [LEFT, width - RIGHT] },
            y: Scale { values: y, pixels: [height - BOTTOM, TOP] },
        }
    }

    /// Grid lines and tick labels of both axes, and the axes' names; `y_ticks` is about how many.
    pub(crate) fn axes(&mut self, labels: &Labels<'_>, y_ticks: f64) {
        let [left, right] = self.x.pixels;
        let [bottom, top] = self.y.pixels;
        let across = Ticks::inside(self.y.values, y_ticks);
        for &value in &across.values {
            let y = self.y.at(value);
            self.svg.line("grid", [left, y], [right, y]);
            self.svg.text("soft", [left - 6.0, y + 4.0], Anchor::End, &across.label(value));
        }
        self.x_axis(labels.x, false);
        self.svg.text_upwards("soft", [12.0, 0.5 * (top + bottom)], labels.y);
    }

    /// Ticks and name of the x axis, with grid lines when `grid`.
    pub(crate) fn x_axis(&mut self, name: &str, grid: bool) {
        let [left, right] = self.x.pixels;
        let [bottom, top] = self.y.pixels;
        let along = Ticks::inside(self.x.values, (right - left) / 65.0);
        for &value in &along.values {
            let x = self.x.at(value);
            if grid {
                self.svg.line("grid", [x, top], [x, bottom]);
            }
            self.svg.line("rule", [x, bottom], [x, bottom + 4.0]);
            self.svg.text("soft", [x, bottom + 17.0], Anchor::Middle, &along.label(value));
        }
        self.svg.line("rule", [left, bottom], [right, bottom]);
        self.svg.text("soft", [0.5 * (left + right), bottom + 34.0], Anchor::Middle, name);
    }

    /// A level line from end to end, when it lies inside.
    pub(crate) fn level(&mut self, class: &str, value: f64) {
        let [low, high] = self.y.values;
        if (low..=high).contains(&value) {
            let y = self.y.at(value);
            self.svg.line(class, [self.x.pixels[0], y], [self.x.pixels[1], y]);
        }
    }

    /// The point of a pair of values.
    pub(crate) fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [self.x.at(x), self.y.at(y)]
    }
}
