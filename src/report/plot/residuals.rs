//! Residual of each length, before and after, with the outliers marked.

use super::frame::{Frame, Labels, NARROW};
use super::thinning::thinned;
use super::{Series, legend};
use crate::report::scale::{Unit, magnitude, range, signed};
use crate::report::svg::Anchor;

const HEIGHT: f64 = 270.0;

/// Residuals against the observation's index.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualPlot {
    /// What it shows.
    pub title: String,
    /// The observations, in any order.
    pub points: Vec<ResidualPoint>,
    /// Draws a band of twice this standard deviation, mm.
    pub sigma_mm: Option<f64>,
}

/// One observation's residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualPoint {
    /// Index of the observation.
    pub index: u32,
    /// With the nominal robot, mm; not drawn where absent.
    pub before_mm: Option<f64>,
    /// With the identified robot, mm.
    pub after_mm: f64,
    /// Whether it was set aside.
    pub outlier: bool,
}

impl ResidualPlot {
    /// Draws it. The outliers do not set the scale: one beyond it stands at the edge, with its value.
    pub fn to_svg(&self) -> String {
        let sound = |point: &&ResidualPoint| !point.outlier;
        let drawn = self.points.iter().filter(sound).flat_map(|p| [p.before_mm.unwrap_or(0.0), p.after_mm]);
        let largest_mm = magnitude(drawn.chain(self.sigma_mm.map(|sigma| 2.0 * sigma)));
        let unit = Unit::length(largest_mm);
        let top = 1.12 * largest_mm * unit.factor;
        let y_name = format!("residual ({})", unit.sign);
        let labels = Labels {
            title: &self.title,
            description: "Residual of each length against the observation's index",
            x: "observation (index)",
            y: &y_name,
        };
        let [first, last] = range(self.points.iter().map(|point| f64::from(point.index)));
        let pad = 0.015 * (last - first) + 0.5;
        let mut frame = Frame::new([NARROW, HEIGHT], [first - pad, last + pad], [-top, top], &labels);
        if let Some(sigma) = self.sigma_mm {
            let band = [2.0 * sigma * unit.factor, -2.0 * sigma * unit.factor].map(|value| frame.y.at(value));
            frame.svg.rect("band", [frame.x.pixels[0], band[0]], [frame.x.pixels[1], band[1]], "");
        }
        frame.axes(&labels, 6.0);
        frame.level("zero", 0.0);
        let digits = if unit == Unit::MM { 3 } else { 1 };
        let tip = |index: u32, word: &str, value: f64| {
            format!("{index} {word}: {} {}", signed(value * unit.factor, digits), unit.sign)
        };
        let radius = if self.points.len() > 150 { 1.9 } else { 2.6 };
        let before = |point: &ResidualPoint| [f64::from(point.index), point.before_mm.unwrap_or(0.0)];
        for point in thinned(self.points.iter().collect(), before) {
            if let Some(before) = point.before_mm
                && (before * unit.factor).abs() <= top
            {
                let at = frame.at(f64::from(point.index), before * unit.factor);
                frame.svg.circle("d-before", at, radius, &tip(point.index, "before", before));
            }
        }
        let after = |point: &ResidualPoint| [f64::from(point.index), point.after_mm];
        for point in thinned(self.points.iter().filter(sound).collect(), after) {
            let at = frame.at(f64::from(point.index), point.after_mm * unit.factor);
            frame.svg.circle("d-after", at, radius, &tip(point.index, "after", point.after_mm));
        }
        for point in thinned(self.points.iter().filter(|point| point.outlier).collect(), after) {
            let value = point.after_mm * unit.factor;
            let at = frame.at(f64::from(point.index), value.clamp(-0.95 * top, 0.95 * top));
            frame.svg.cross("l-mark", at, 4.5);
            let middle = 0.5 * (frame.x.pixels[0] + frame.x.pixels[1]);
            let (dx, anchor) = if at[0] > middle { (-9.0, Anchor::End) } else { (9.0, Anchor::Start) };
            let own = Unit::length(point.after_mm.abs());
            let text = format!("{}: {} {}", point.index, signed(point.after_mm * own.factor, 2), own.sign);
            frame.svg.text("halo", [at[0] + dx, at[1] + 4.0], anchor, &text);
        }
        self.legend(&mut frame);
        frame.svg.finish()
    }

    fn legend(&self, frame: &mut Frame) {
        let mut x = 4.0;
        if self.points.iter().any(|point| point.before_mm.is_some()) {
            x = legend(&mut frame.svg, [x, 34.0], Series::First, "before");
        }
        x = legend(&mut frame.svg, [x, 34.0], Series::Second, "after");
        if self.points.iter().any(|point| point.outlier) {
            frame.svg.cross("l-mark", [x + 4.0, 30.0], 3.5);
            frame.svg.text("soft", [x + 13.0, 34.0], Anchor::Start, "outlier, set aside");
            x += 140.0;
        }
        if self.sigma_mm.is_some() {
            frame.svg.rect("band", [x, 25.0], [x + 14.0, 35.0], "");
            frame.svg.text("soft", [x + 19.0, 34.0], Anchor::Start, "± 2 sigma of a length");
        }
    }
}
