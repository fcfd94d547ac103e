//! Residuals against the angle of one axis, by the sense in which it came to the pose.

use super::frame::{Frame, Labels};
use super::thinning::thinned;
use super::{Series, legend};
use crate::report::scale::{Unit, magnitude, range, signed};

/// A small panel: three stand side by side.
const SIZE: [f64; 2] = [330.0, 230.0];

/// Residuals against one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisPlot {
    /// What it shows.
    pub title: String,
    /// The residuals, in any order.
    pub points: Vec<AxisPoint>,
    /// Largest residual to be shown, mm: the same for all axes, so that they compare.
    pub largest_mm: f64,
}

/// One residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisPoint {
    /// The axis angle, degrees.
    pub angle_deg: f64,
    /// The residual, mm.
    pub residual_mm: f64,
    /// The sense of the motion to the pose: negative, 0 for not known, positive.
    pub sense: i8,
}

impl AxisPlot {
    /// Draws it.
    pub fn to_svg(&self) -> String {
        let largest_mm = magnitude([self.largest_mm].into_iter());
        let unit = Unit::length(largest_mm);
        let top = 1.08 * largest_mm * unit.factor;
        let y_name = format!("residual ({})", unit.sign);
        let labels = Labels {
            title: &self.title,
            description: "Residual of each length against the axis angle",
            x: "axis angle (deg)",
            y: &y_name,
        };
        let [first, last] = range(self.points.iter().map(|point| point.angle_deg));
        let pad = 0.03 * (last - first);
        let mut frame = Frame::new(SIZE, [first - pad, last + pad], [-top, top], &labels);
        frame.axes(&labels, 5.0);
        frame.level("zero", 0.0);
        let radius = if self.points.len() > 300 { 1.5 } else { 2.2 };
        let mut x = 4.0;
        for (series, name, senses) in [
            (Series::First, "falling", -1..=-1),
            (Series::Second, "rising", 1..=1),
            (Series::Third, "not known", 0..=0),
        ] {
            let of_sense = |point: &&AxisPoint| senses.contains(&point.sense);
            let place = |point: &AxisPoint| [point.angle_deg, point.residual_mm];
            for point in thinned(self.points.iter().filter(of_sense).collect(), place) {
                let value = point.residual_mm * unit.factor;
                let tip = format!("{:.2} deg: {} {}", point.angle_deg, signed(value, 1), unit.sign);
                frame.svg.circle(series.dot(), frame.at(point.angle_deg, value), radius, &tip);
            }
            if self.points.iter().any(|point| of_sense(&point)) {
                x = legend(&mut frame.svg, [x, 34.0], series, name);
            }
        }
        frame.svg.finish()
    }
}
