//! How often a residual of each size occurs.

use super::Series;
use super::frame::{Area, Frame, Labels, NARROW};
use crate::report::scale::{Unit, fixed, magnitude, step};

const HEIGHT: f64 = 250.0;
/// Above this number of bars a wide stray stretches the picture; the last bars then hold the rest.
const MOST_BARS: usize = 41;

/// A histogram of residuals; bars of a 1-2-5 width, one of them about zero.
pub(crate) fn histogram(title: &str, values_mm: &[f64], series: Series) -> String {
    let largest_mm = magnitude(values_mm.iter().copied());
    let unit = Unit::length(largest_mm);
    let width = step(2.0 * largest_mm * unit.factor, 20.0);
    let side = ((largest_mm * unit.factor / width).round() as usize).clamp(1, MOST_BARS / 2);
    let mut counts = vec![0usize; 2 * side + 1];
    for value in values_mm.iter().filter(|value| value.is_finite()) {
        let place = (value * unit.factor / width).round().clamp(-(side as f64), side as f64);
        if let Some(count) = counts.get_mut((place + side as f64) as usize) {
            *count += 1;
        }
    }
    let highest = counts.iter().copied().max().unwrap_or(0).max(1);
    let labels = Labels {
        title,
        description: "Histogram of the residuals",
        x: &format!("residual ({})", unit.sign),
        y: "lengths",
    };
    let half = width * (side as f64 + 0.7);
    let area = Area::of([NARROW, HEIGHT]);
    let mut frame = Frame::new(area, &labels, [-half, half], [0.0, 1.05 * highest as f64]);
    frame.axes();
    let digits = if width < 1.0 { 3 } else { 0 };
    for (place, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let middle = (place as f64 - side as f64) * width;
        let low = frame.at(middle - 0.47 * width, 0.0);
        let high = frame.at(middle + 0.47 * width, count as f64);
        let tip = format!("{count} at {} {}", fixed(middle, digits), unit.sign);
        frame.svg.rect(series.bar(), low, high, &tip);
    }
    frame.upright("zero", 0.0);
    frame.svg.finish()
}
