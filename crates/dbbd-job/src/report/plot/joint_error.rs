//! The error of a joint against its angle, with its 95 % band and the measured angles.

use super::frame::{Area, Frame, Labels};
use super::{Key, Legend, Series};
use crate::report::scale::{Unit, magnitude, range};
use dbbd_model::estimation::JointPoint;
use dbbd_model::math::distributions::COVERAGE_95;

const SIZE: [f64; 2] = [480.0, 250.0];

/// The error of axis `axis` (from 0) about its mean; `measured_deg` are the angles of the poses.
pub(crate) fn joint_error(axis: usize, curve: &[JointPoint], measured_deg: &[f64]) -> String {
    let [low, high] = range(measured_deg.iter().copied());
    let seen: Vec<&JointPoint> =
        curve.iter().filter(|point| point.angle_deg >= low - 5.0 && point.angle_deg <= high + 5.0).collect();
    let middle = |point: &JointPoint| 0.5 * (point.rising + point.falling);
    let mean = seen.iter().map(|point| middle(point)).sum::<f64>() / seen.len().max(1) as f64;
    let ends = seen.iter().flat_map(|point| [point.rising - mean, point.falling - mean]);
    let largest = magnitude(ends);
    let unit = Unit::angle(largest);
    let top = 1.4 * largest * unit.factor;
    let labels = Labels {
        title: &format!("Axis {}", axis + 1),
        description: "Error of the joint against its angle, with its 95 % band",
        x: "angle of the joint (deg)",
        y: &format!("error ({})", unit.sign),
    };
    let (first, last) = (seen.first().map_or(0.0, |p| p.angle_deg), seen.last().map_or(1.0, |p| p.angle_deg));
    let mut frame = Frame::new(Area::of(SIZE), &labels, [first, last], [-top, top]);
    let at = |frame: &Frame, angle: f64, value: f64| {
        frame.at(angle, ((value - mean) * unit.factor).clamp(-top, top))
    };
    let edge = |side: f64| {
        seen.iter().map(move |point| (point.angle_deg, middle(point) + side * COVERAGE_95 * point.sd))
    };
    let band: Vec<[f64; 2]> =
        edge(1.0).chain(edge(-1.0).rev()).map(|(angle, value)| at(&frame, angle, value)).collect();
    frame.svg.path("band", &band, true);
    frame.axes();
    frame.level("zero", 0.0);
    let mut legend = Legend::new(34.0);
    let differs = seen.iter().any(|point| point.rising != point.falling);
    let mut line = |series: Series, name: &str, value: fn(&JointPoint) -> f64| {
        let points: Vec<[f64; 2]> =
            seen.iter().map(|point| at(&frame, point.angle_deg, value(point))).collect();
        frame.svg.path(series.line(), &points, false);
        legend.add(&mut frame.svg, Key::Dot(series), name);
    };
    if differs {
        line(Series::First, "falling", |point| point.falling);
        line(Series::Second, "rising", |point| point.rising);
    } else {
        line(Series::Second, "either sense", |point| point.rising);
    }
    let [bottom, _] = frame.y.pixels;
    for angle in measured_deg {
        let x = frame.x.at(*angle);
        frame.svg.line("rule", [x, bottom - 5.0], [x, bottom]);
    }
    frame.svg.finish()
}
