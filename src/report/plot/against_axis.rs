//! Residuals against the angle of one axis, by the sense in which it came to the pose.

use super::frame::{Area, Frame, Labels};
use super::residuals::ResidualPoint;
use super::thinning::thinned;
use super::{Key, Legend, Series};
use crate::report::scale::{Unit, magnitude, range, signed};

/// A small panel: three stand side by side.
const SIZE: [f64; 2] = [330.0, 230.0];

/// The residuals afterwards against axis `axis` (from 0); `largest_mm` is the same for all axes, so that they compare.
pub(crate) fn against_axis(axis: usize, points: &[&ResidualPoint], largest_mm: f64) -> String {
    let largest_mm = magnitude([largest_mm].into_iter());
    let unit = Unit::length(largest_mm);
    let top = 1.08 * largest_mm * unit.factor;
    let labels = Labels {
        title: &format!("Axis {}", axis + 1),
        description: "Residual of each length against the axis angle",
        x: "axis angle (deg)",
        y: &format!("residual ({})", unit.sign),
    };
    let [first, last] = range(points.iter().map(|point| point.axes_deg[axis]));
    let pad = 0.03 * (last - first);
    let mut frame = Frame::new(Area::of(SIZE), &labels, [first - pad, last + pad], [-top, top]);
    frame.axes();
    frame.level("zero", 0.0);
    let radius = if points.len() > 300 { 1.5 } else { 2.2 };
    let mut legend = Legend::new(34.0);
    for (series, name, sense) in
        [(Series::First, "falling", -1), (Series::Second, "rising", 1), (Series::Third, "unknown", 0)]
    {
        let of_sense: Vec<&ResidualPoint> =
            points.iter().copied().filter(|point| point.senses[axis].signum() == sense).collect();
        if !of_sense.is_empty() {
            legend.add(&mut frame.svg, Key::Dot(series), name);
        }
        for point in thinned(of_sense, |point| [point.axes_deg[axis], point.after_mm]) {
            let (angle, value) = (point.axes_deg[axis], point.after_mm * unit.factor);
            let tip = format!("{angle:.2} deg: {} {}", signed(value, 1), unit.sign);
            frame.svg.circle(series.dot(), frame.at(angle, value), radius, &tip);
        }
    }
    frame.svg.finish()
}
