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
    // Between the poses the scale has the whole band: a curve within its band shows no error.
    let is_measured = |point: &JointPoint| (low..=high).contains(&point.angle_deg);
    let ends = seen.iter().flat_map(|point| {
        let half = if is_measured(point) { COVERAGE_95 * point.sd } else { 0.0 };
        let band = [middle(point) - half, middle(point) + half];
        [[point.rising, point.falling], band].concat().into_iter().map(move |value| value - mean)
    });
    let largest = magnitude(ends);
    let unit = Unit::angle(largest);
    let top = 1.1 * largest * unit.factor;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The heights of the points of the first path with a class, in pixels.
    fn heights(svg: &str, class: &str) -> Vec<f64> {
        let (_, path) = svg.split_once(&format!("<path class=\"{class}\" d=\"M")).unwrap();
        let (path, _) = path.split_once('"').unwrap();
        let points = path.trim_end_matches('Z').split('L');
        points.map(|point| point.split_once(' ').unwrap().1.parse().unwrap()).collect()
    }

    /// A curve of 5 urad with a standard deviation of 100 urad: the band ends within the picture, and the curve is flat.
    #[test]
    fn a_curve_without_meaning_is_flat_within_its_band() {
        let point = |at: i32| {
            let value = 5e-6 * f64::from(at) / 20.0;
            let sd = if at.abs() <= 20 { 100e-6 } else { 1e-3 };
            JointPoint { angle_deg: f64::from(at), rising: value, falling: value, sd }
        };
        let curve: Vec<JointPoint> = (-24..=24).map(point).collect();
        let svg = joint_error(0, &curve, &[-20.0, 20.0]);
        let span = |heights: &[f64]| {
            let ends =
                heights.iter().fold([f64::MAX, f64::MIN], |[low, high], at| [low.min(*at), high.max(*at)]);
            ends[1] - ends[0]
        };
        let (band, line) = (heights(&svg, "band"), heights(&svg, "l-after"));
        // The upper edge at a measured angle lies below that of the prior, which ends at the edge of the picture.
        assert!(band[24] > band[0] + 5.0, "{} {}", band[24], band[0]);
        assert!(span(&line) < 0.05 * span(&band), "{} {}", span(&line), span(&band));
        // A rule for all paths of a plot would be stronger than the class, and hide the band.
        let css = crate::report::svg::plot_css();
        assert!(css.contains(".band{fill:") && !css.contains("svg.plot path"), "{css}");
    }
}
