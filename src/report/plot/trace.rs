//! A quantity along the path, with its limits.

use super::Series;
use super::frame::{Frame, Labels};
use crate::report::scale::{range, significant};

/// A line plot against the row's number.
#[derive(Clone, Debug, PartialEq)]
pub struct TracePlot {
    /// What it shows.
    pub title: String,
    /// Width and height, pixels.
    pub size: [f64; 2],
    /// Name of the x axis.
    pub x_name: String,
    /// Name of the y axis with unit.
    pub y_name: String,
    /// The line.
    pub line: Line,
    /// Lowest and highest value allowed.
    pub limits: Option<[f64; 2]>,
    /// Distance that is kept from the limits.
    pub margin: f64,
    /// Whether the limits are in the picture even where the line stays far from them.
    pub show_limits: bool,
}

/// Points (x, y) in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// How it is drawn.
    pub series: Series,
    /// Its points.
    pub points: Vec<[f64; 2]>,
    /// Whether each point is a dwell, which gets a dot.
    pub dwell: Vec<bool>,
}

impl TracePlot {
    /// Draws it.
    pub fn to_svg(&self) -> String {
        let x = range(self.line.points.iter().map(|point| point[0]));
        let limits = self.limits.filter(|_| self.show_limits).into_iter().flatten();
        let [low, high] = range(self.line.points.iter().map(|point| point[1]).chain(limits));
        let pad = 0.08 * (high - low);
        let labels = Labels {
            title: &self.title,
            description: "A line against the row of the plan; dashed lines are the limits",
            x: &self.x_name,
            y: &self.y_name,
        };
        let mut frame = Frame::new(self.size, x, [low - pad, high + pad], &labels);
        frame.axes(&labels, ((self.size[1] - 86.0) / 24.0).max(2.0));
        if (low..=high).contains(&0.0) {
            frame.level("zero", 0.0);
        }
        if let Some([least, most]) = self.limits {
            for (limit, kept) in [(least, least + self.margin), (most, most - self.margin)] {
                frame.level("limit", limit);
                if self.margin > 0.0 {
                    frame.level("margin", kept);
                }
            }
        }
        let places: Vec<[f64; 2]> = self.line.points.iter().map(|&[x, y]| frame.at(x, y)).collect();
        frame.svg.path(self.line.series.line(), &places, false);
        let radius = if places.len() as f64 > 0.25 * self.size[0] { 1.4 } else { 2.2 };
        for ((place, point), _) in
            places.iter().zip(&self.line.points).zip(&self.line.dwell).filter(|(_, dwell)| **dwell)
        {
            let tip = format!("{}: {}", point[0], significant(point[1], 4));
            frame.svg.circle(self.line.series.dot(), *place, radius, &tip);
        }
        frame.svg.finish()
    }
}
