//! Residual of each length, before and after, with the outliers marked.

use super::frame::{Area, Frame, Labels, NARROW};
use super::thinning::thinned;
use super::{Key, Legend, Series};
use crate::report::scale::{Unit, magnitude, range, signed};
use crate::report::svg::Anchor;
use crate::robot::{AXES, CircleId, Datum};

const HEIGHT: f64 = 270.0;

/// A length with its residuals, as the figures show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ResidualPoint {
    pub(crate) index: u32,
    pub(crate) datum: Datum,
    pub(crate) axes_deg: [f64; AXES],
    /// The sense in which each axis came to its angle: -1, 1, or 0 where it is not known.
    pub(crate) senses: [i8; AXES],
    /// With the nominal robot, mm.
    pub(crate) before_mm: f64,
    /// With the identified robot, mm.
    pub(crate) after_mm: f64,
    /// Number of its circle and its angle there, degrees.
    pub(crate) on_circle: Option<(CircleId, f64)>,
    pub(crate) outlier: bool,
}

/// Which residuals a plot shows.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Shown {
    BeforeAndAfter,
    /// On their own scale, with a band of twice this standard deviation.
    After {
        sigma_mm: f64,
    },
}

/// Residuals against the measurement's index. The outliers do not set the scale: one beyond it is drawn at the edge,
/// with its value.
pub(crate) fn residuals(title: &str, points: &[ResidualPoint], shown: Shown) -> String {
    let sound = || points.iter().filter(|point| !point.outlier);
    let largest_mm = match shown {
        Shown::BeforeAndAfter => magnitude(sound().flat_map(|point| [point.before_mm, point.after_mm])),
        Shown::After { sigma_mm } => magnitude(sound().map(|point| point.after_mm).chain([2.0 * sigma_mm])),
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
    let mut frame = Frame::new(Area::of([NARROW, HEIGHT]), &labels, [first - pad, last + pad], [-top, top]);
    let mut legend = Legend::new(34.0);
    if shown == Shown::BeforeAndAfter {
        legend.add(&mut frame.svg, Key::Dot(Series::First), "before");
    }
    legend.add(&mut frame.svg, Key::Dot(Series::Second), "after");
    if points.iter().any(|point| point.outlier) {
        legend.add(&mut frame.svg, Key::Outlier, "outlier, excluded");
    }
    if let Shown::After { sigma_mm } = shown {
        let half = 2.0 * sigma_mm * unit.factor;
        let [left, right] = frame.x.pixels;
        frame.svg.rect("band", [left, frame.y.at(-half)], [right, frame.y.at(half)], "");
        legend.add(&mut frame.svg, Key::Band, "± 2 sigma of a length");
    }
    frame.axes();
    frame.level("zero", 0.0);
    if shown == Shown::BeforeAndAfter {
        let inside = points.iter().filter(|point| (point.before_mm * unit.factor).abs() <= top).collect();
        dots(&mut frame, inside, unit, Series::First);
    }
    dots(&mut frame, sound().collect(), unit, Series::Second);
    outliers(&mut frame, points, unit);
    frame.svg.finish()
}

/// The residuals before are the first series.
fn dots(frame: &mut Frame, points: Vec<&ResidualPoint>, unit: Unit, series: Series) {
    let digits = if unit == Unit::MM { 3 } else { 1 };
    let radius = if points.len() > 150 { 1.9 } else { 2.6 };
    let (word, value): (_, fn(&ResidualPoint) -> f64) = match series {
        Series::First => ("before", |point| point.before_mm),
        Series::Second | Series::Third => ("after", |point| point.after_mm),
    };
    for point in thinned(points, |point| [f64::from(point.index), value(point)]) {
        let shown = value(point) * unit.factor;
        let tip = format!("{} {word}: {} {}", point.index, signed(shown, digits), unit.sign);
        let at = frame.at(f64::from(point.index), shown);
        frame.svg.circle(series.dot(), at, radius, &tip);
    }
}

/// A cross each, within the frame, with index and value.
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
