//! A quantity along the path of a plan, with its limits.

use super::Series;
use super::frame::{Area, Frame, Labels};
use crate::plan::PlanRow;
use crate::report::scale::{range, significant};
use dbbd_model::measurement::PoseKind;

/// A line against the row's number; dwells are dots.
pub(crate) struct Trace<'a> {
    pub(crate) title: String,
    /// Width and height, pixels.
    pub(crate) size: [f64; 2],
    /// Name of the y axis with unit.
    pub(crate) y_name: &'a str,
    pub(crate) rows: &'a [PlanRow],
    pub(crate) value: &'a dyn Fn(&PlanRow) -> f64,
    /// Lowest and highest value allowed, always inside the picture.
    pub(crate) limits: [f64; 2],
    pub(crate) margin: f64,
}

impl Trace<'_> {
    pub(crate) fn to_svg(&self) -> String {
        let values = self.rows.iter().map(self.value);
        let [low, high] = range(values.chain(self.limits));
        let pad = 0.08 * (high - low);
        let labels = Labels {
            title: &self.title,
            description: "A line against the row of the plan; dashed lines are the limits",
            x: "row of the plan",
            y: self.y_name,
        };
        let x = range(self.rows.iter().map(|row| f64::from(row.index)));
        let mut frame = Frame::new(Area::of(self.size), &labels, x, [low - pad, high + pad]);
        frame.axes();
        frame.level("zero", 0.0);
        let [least, most] = self.limits;
        for (limit, kept) in [(least, least + self.margin), (most, most - self.margin)] {
            frame.level("limit", limit);
            if self.margin > 0.0 {
                frame.level("margin", kept);
            }
        }
        let place = |row: &PlanRow| frame.at(f64::from(row.index), (self.value)(row));
        let places: Vec<[f64; 2]> = self.rows.iter().map(place).collect();
        frame.svg.path(Series::Second.line(), &places, false);
        let radius = if places.len() as f64 > 0.25 * self.size[0] { 1.4 } else { 2.2 };
        for (row, place) in self.rows.iter().zip(places).filter(|(row, _)| row.kind != PoseKind::Transit) {
            let tip = format!("{}: {}", row.index, significant((self.value)(row), 4));
            frame.svg.circle(Series::Second.dot(), place, radius, &tip);
        }
        frame.svg.finish()
    }
}
