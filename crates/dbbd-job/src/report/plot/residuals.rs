//! Residuals of lengths: against the index of the measurement, against the angle of an axis, and as a histogram.

use super::frame::{Area, Frame, Labels, NARROW, PANEL};
use super::{Key, Legend, Series};
use crate::report::scale::{Unit, fixed, magnitude, range, signed, step};
use crate::report::svg::Anchor;
use dbbd_model::robot::{AXES, CircleId, Datum};

const SIZE: [f64; 2] = [NARROW, 270.0];
const HISTOGRAM: [f64; 2] = [NARROW, 250.0];
/// Most bars of a histogram; with outliers the last bars hold the rest.
const MOST_BARS: usize = 41;
/// With more points than this a plot shows only the least and the greatest point in each of `BINS` strips: a plot of a
/// million points does not open.
const MOST_POINTS: usize = 4000;
const BINS: usize = 1000;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ResidualPoint {
    pub(crate) index: u32,
    pub(crate) datum: Datum,
    pub(crate) axes_deg: [f64; AXES],
    /// Sense in which each axis approached its angle: -1, 1, or 0 if it is not known.
    pub(crate) senses: [i8; AXES],
    /// Residual with the nominal robot, mm.
    pub(crate) before_mm: f64,
    /// Residual with the identified robot, mm.
    pub(crate) after_mm: f64,
    /// Circle of the measurement and angle on it, degrees.
    pub(crate) on_circle: Option<(CircleId, f64)>,
    pub(crate) outlier: bool,
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum ResidualSet {
    BeforeAndAfter,
    /// Residuals after the identification on their own scale, with a band of twice this standard deviation.
    After {
        sigma_mm: f64,
    },
}

/// Residuals against the measurement's index. Outliers do not set the scale: an outlier beyond the scale is drawn at
/// the edge, with its value.
pub(crate) fn residuals(title: &str, points: &[ResidualPoint], set: ResidualSet) -> String {
    let inliers = || points.iter().filter(|point| !point.outlier);
    let largest_mm = match set {
        ResidualSet::BeforeAndAfter => {
            magnitude(inliers().flat_map(|point| [point.before_mm, point.after_mm]))
        }
        ResidualSet::After { sigma_mm } => {
            magnitude(inliers().map(|point| point.after_mm).chain([2.0 * sigma_mm]))
        }
    };
    let unit = Unit::length(largest_mm);
    let top = 1.12 * largest_mm * unit.factor;
    let labels = Labels {
        title,
        description: "Residual of each length against the measurement's index",
        x: "measurement (index)",
        y: &format!("residual ({})", unit.sign),
    };
    let [first, last] = range(points.iter().map(|point| f64::from(point.index)));
    let pad = 0.015 * (last - first) + 0.5;
    let mut frame = Frame::new(Area::of(SIZE), &labels, [first - pad, last + pad], [-top, top]);
    let mut legend = Legend::new(34.0);
    if set == ResidualSet::BeforeAndAfter {
        legend.add(&mut frame.svg, Key::Dot(Series::First), "before");
    }
    legend.add(&mut frame.svg, Key::Dot(Series::Second), "after");
    if points.iter().any(|point| point.outlier) {
        legend.add(&mut frame.svg, Key::Outlier, "outlier, excluded");
    }
    if let ResidualSet::After { sigma_mm } = set {
        let half = 2.0 * sigma_mm * unit.factor;
        let [left, right] = frame.x.pixels;
        frame.svg.rect("band", [left, frame.y.at(-half)], [right, frame.y.at(half)], "");
        legend.add(&mut frame.svg, Key::Band, "± 2 sigma of a length");
    }
    frame.axes();
    frame.level("zero", 0.0);
    if set == ResidualSet::BeforeAndAfter {
        let inside = points.iter().filter(|point| (point.before_mm * unit.factor).abs() <= top).collect();
        dots(&mut frame, inside, unit, Series::First);
    }
    dots(&mut frame, inliers().collect(), unit, Series::Second);
    outliers(&mut frame, points, unit);
    frame.svg.finish()
}

/// Draws a dot for each point. The residuals before the identification are the first series.
fn dots(frame: &mut Frame, points: Vec<&ResidualPoint>, unit: Unit, series: Series) {
    let digits = if unit == Unit::MM { 3 } else { 1 };
    let radius = if points.len() > 150 { 1.9 } else { 2.6 };
    let (word, value): (_, fn(&ResidualPoint) -> f64) = match series {
        Series::First => ("before", |point| point.before_mm),
        Series::Second | Series::Third => ("after", |point| point.after_mm),
    };
    for point in thinned(points, |point| [f64::from(point.index), value(point)]) {
        let residual = value(point) * unit.factor;
        let tip = format!("{} {word}: {} {}", point.index, signed(residual, digits), unit.sign);
        let at = frame.at(f64::from(point.index), residual);
        frame.svg.circle(series.dot(), at, radius, &tip);
    }
}

/// Draws a cross for each outlier, within the frame, with index and value.
fn outliers(frame: &mut Frame, points: &[ResidualPoint], unit: Unit) {
    let middle = 0.5 * (frame.x.pixels[0] + frame.x.pixels[1]);
    let edge = 0.95 * frame.y.values[1];
    let outliers = points.iter().filter(|point| point.outlier).collect();
    for point in thinned(outliers, |point| [f64::from(point.index), point.after_mm]) {
        let at = frame.at(f64::from(point.index), (point.after_mm * unit.factor).clamp(-edge, edge));
        frame.svg.cross("l-mark", at, 4.5);
        let (dx, anchor) = if at[0] > middle { (-9.0, Anchor::End) } else { (9.0, Anchor::Start) };
        let own = Unit::length(point.after_mm.abs());
        let text = format!("{}: {} {}", point.index, signed(point.after_mm * own.factor, 2), own.sign);
        frame.svg.text("halo", [at[0] + dx, at[1] + 4.0], anchor, &text);
    }
}

/// The residuals after the identification against axis `axis` (from 0), by the sense of approach; `largest_mm` is the
/// same for all axes, so that they compare.
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
    let mut frame = Frame::new(Area::of(PANEL), &labels, [first - pad, last + pad], [-top, top]);
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

/// The points to draw: all points, or if they are too many, the points of least and greatest y in each strip along x.
fn thinned<T>(points: Vec<&T>, place: impl Fn(&T) -> [f64; 2]) -> Vec<&T> {
    if points.len() <= MOST_POINTS {
        return points;
    }
    let [first, last] = range(points.iter().map(|point| place(point)[0]));
    let mut ends: Vec<Option<[&T; 2]>> = vec![None; BINS];
    for point in points {
        let [x, y] = place(point);
        let share = ((x - first) / (last - first)).clamp(0.0, 1.0);
        let Some(end) = ends.get_mut(((share * BINS as f64) as usize).min(BINS - 1)) else { continue };
        let [low, high] = end.get_or_insert([point, point]);
        if y < place(low)[1] {
            *low = point;
        }
        if y > place(high)[1] {
            *high = point;
        }
    }
    ends.into_iter().flatten().flatten().collect()
}

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
    let mut frame = Frame::new(Area::of(HISTOGRAM), &labels, [-half, half], [0.0, 1.05 * highest as f64]);
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
