//! A plot with two straight axes: its area, scales, grid, ticks and names.

use crate::report::scale::{Scale, Ticks};
use crate::report::svg::{Anchor, Svg};

/// Width of a figure beside another one, pixels.
pub(crate) const NARROW: f64 = 480.0;
/// Width of a figure across the page, pixels.
pub(crate) const WIDE: f64 = 990.0;
/// Size of a figure beside two others, pixels.
pub(crate) const PANEL: [f64; 2] = [330.0, 230.0];
/// Height of the ticks and the name of the x axis, pixels.
const BELOW: f64 = 42.0;

/// The area of a plot within a picture of this width, edges in pixels.
#[derive(Clone, Copy)]
pub(super) struct Area {
    pub(super) width: f64,
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) top: f64,
    pub(super) bottom: f64,
}

impl Area {
    /// The area in a picture of this size, with room for title, legend and labels.
    pub(super) fn of([width, height]: [f64; 2]) -> Self {
        Self { width, left: 56.0, right: width - 14.0, top: 44.0, bottom: height - BELOW }
    }
}

/// The texts of a plot; a screen reader reads title and description.
pub(super) struct Labels<'a> {
    pub(super) title: &'a str,
    pub(super) description: &'a str,
    pub(super) x: &'a str,
    pub(super) y: &'a str,
}

/// The form of the ticks of an axis.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Grid {
    /// Lines across the area.
    Lines,
    /// Short marks outside of it.
    Marks,
}

/// A picture with its two scales.
pub(super) struct Frame {
    pub(super) svg: Svg,
    pub(super) x: Scale,
    pub(super) y: Scale,
}

impl Frame {
    /// Title and names of the axes; ranges in display units.
    pub(super) fn new(area: Area, labels: &Labels<'_>, x: [f64; 2], y: [f64; 2]) -> Self {
        let Area { width, left, right, top, bottom } = area;
        let mut svg = Svg::new(width, bottom + BELOW, labels.title, labels.description);
        svg.text("head", [4.0, 16.0], Anchor::Start, labels.title);
        svg.text("soft", [0.5 * (left + right), bottom + 34.0], Anchor::Middle, labels.x);
        svg.text_upwards("soft", [12.0, 0.5 * (top + bottom)], labels.y);
        let (x, y) = (Scale { values: x, pixels: [left, right] }, Scale { values: y, pixels: [bottom, top] });
        Self { svg, x, y }
    }

    /// The usual axes: grid lines across, marks below.
    pub(super) fn axes(&mut self) {
        let [left, right] = self.x.pixels;
        let bottom = self.y.pixels[0];
        self.y_axis_lines();
        self.x_axis(&Ticks::inside(self.x.values, (right - left) / 65.0), Grid::Marks);
        self.svg.line("rule", [left, bottom], [right, bottom]);
    }

    pub(super) fn x_axis(&mut self, ticks: &Ticks, grid: Grid) {
        let [bottom, top] = self.y.pixels;
        for &value in &ticks.values {
            let x = self.x.at(value);
            match grid {
                Grid::Lines => self.svg.line("grid", [x, top], [x, bottom]),
                Grid::Marks => self.svg.line("rule", [x, bottom], [x, bottom + 4.0]),
            }
            self.svg.text("soft", [x, bottom + 17.0], Anchor::Middle, &ticks.label(value));
        }
    }

    /// Grid lines across at the usual distance.
    pub(super) fn y_axis_lines(&mut self) {
        let [bottom, top] = self.y.pixels;
        self.y_axis(&Ticks::inside(self.y.values, ((bottom - top) / 30.0).max(2.0)), Grid::Lines);
    }

    pub(super) fn y_axis(&mut self, ticks: &Ticks, grid: Grid) {
        let [left, right] = self.x.pixels;
        for &value in &ticks.values {
            let y = self.y.at(value);
            match grid {
                Grid::Lines => self.svg.line("grid", [left, y], [right, y]),
                Grid::Marks => self.svg.line("rule", [left - 4.0, y], [left, y]),
            }
            self.svg.text("soft", [left - 6.0, y + 4.0], Anchor::End, &ticks.label(value));
        }
    }

    /// A level line from end to end, when it lies inside.
    pub(super) fn level(&mut self, class: &str, value: f64) {
        let [low, high] = self.y.values;
        if (low..=high).contains(&value) {
            let y = self.y.at(value);
            self.svg.line(class, [self.x.pixels[0], y], [self.x.pixels[1], y]);
        }
    }

    /// A vertical line from the bottom to the top.
    pub(super) fn upright(&mut self, class: &str, value: f64) {
        let x = self.x.at(value);
        self.svg.line(class, [x, self.y.pixels[0]], [x, self.y.pixels[1]]);
    }

    /// The point of a pair of values; NaN if the value is outside the area.
    pub(super) fn inside(&self, x: f64, y: f64) -> [f64; 2] {
        let [low, high] = self.y.values;
        if (low..=high).contains(&y) { self.at(x, y) } else { [f64::NAN; 2] }
    }

    /// The point of a pair of values.
    pub(super) fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [self.x.at(x), self.y.at(y)]
    }
}
