//! How often a residual of each size occurs.

use super::Series;
use super::frame::{Frame, Labels, NARROW};
use crate::report::scale::{Unit, fixed, magnitude, step};

const HEIGHT: f64 = 250.0;
/// Above this number of bars a wide stray stretches the picture; the last bars then hold the rest.
const MOST_BARS: usize = 41;

/// A histogram of lengths' residuals.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// What it shows.
    pub title: String,
    /// The residuals, mm.
    pub values_mm: Vec<f64>,
    /// How it is drawn.
    pub series: Series,
}

impl Histogram {
    /// Draws it; bars of a 1-2-5 width, one of them about zero.
    pub fn to_svg(&self) -> String {
        let largest_mm = magnitude(self.values_mm.iter().copied());
        let unit = Unit::length(largest_mm);
        let width = step(2.0 * largest_mm * unit.factor, 20.0);
        let side = ((largest_mm * unit.factor / width).round() as usize).clamp(1, MOST_BARS / 2);
        let mut counts = vec![0usize; 2 * side + 1];
        for value in self.values_mm.iter().filter(|value| value.is_finite()) {
            let place = (value * unit.factor / width).round().clamp(-(side as f64), side as f64);
            if let Some(count) = counts.get_mut((place + side as f64) as usize) {
                *count += 1;
            }
        }
        let highest = counts.iter().copied().max().unwrap_or(0).max(1);
        let x_name = format!("residual ({})", unit.sign);
        let labels = Labels {
            title: &self.title,
            description: "Histogram of the residuals",
            x: &x_name,
            y: "lengths",
        };
        let half = width * (side as f64 + 0.7);
        let mut frame = Frame::new([NARROW, HEIGHT], [-half, half], [0.0, 1.05 * highest as f64], &labels);
        frame.axes(&labels, 4.0);
        let class = if self.series == Series::First { "f-before" } else { "f-after" };
        for (place, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let middle = (place as f64 - side as f64) * width;
            let low = frame.at(middle - 0.47 * width, 0.0);
            let high = frame.at(middle + 0.47 * width, count as f64);
            let digits = if width < 1.0 { 3 } else { 0 };
            frame.svg.rect(class, low, high, &format!("{count} at {} {}", fixed(middle, digits), unit.sign));
        }
        let zero = frame.x.at(0.0);
        frame.svg.line("zero", [zero, frame.y.pixels[0]], [zero, frame.y.pixels[1]]);
        frame.svg.finish()
    }
}
