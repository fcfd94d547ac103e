//! A map of a positive quantity over two coordinates, such as the predicted error over a plane.

use super::frame::NARROW;
use crate::report::scale::{Scale, Ticks, Unit, range, significant};
use crate::report::svg::{Anchor, Svg};

const LEFT: f64 = 56.0;
const RIGHT: f64 = 390.0;
const TOP: f64 = 30.0;
const LEGEND: f64 = 404.0;
/// Dark blue to yellow through grey: even steps of lightness, the same for every kind of sight.
const COLOURS: [[f64; 3]; 5] = [
    [0.0, 34.0, 78.0],
    [66.0, 78.0, 107.0],
    [124.0, 123.0, 120.0],
    [187.0, 173.0, 108.0],
    [254.0, 232.0, 56.0],
];

/// A map of lengths (mm) over a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// What it shows.
    pub title: String,
    /// Names of the two coordinates with unit, such as `X (mm)`.
    pub axis_names: [String; 2],
    /// First and last edge of the grid along x and along y.
    pub extent: [[f64; 2]; 2],
    /// Number of cells along x.
    pub columns: usize,
    /// The values in mm, row by row from the lowest y; not finite where there is none.
    pub values_mm: Vec<f64>,
}

impl HeatMap {
    /// Draws it, x and y to the same scale.
    pub fn to_svg(&self) -> String {
        let columns = self.columns.max(1);
        let rows = self.values_mm.len().div_ceil(columns).max(1);
        let [x_range, y_range] = self.extent.map(|ends| range(ends.into_iter()));
        let aspect = (y_range[1] - y_range[0]) / (x_range[1] - x_range[0]);
        let tall = ((RIGHT - LEFT) * aspect).clamp(90.0, 520.0);
        let bottom = TOP + tall;
        let x = Scale { values: x_range, pixels: [LEFT, RIGHT] };
        let y = Scale { values: y_range, pixels: [bottom, TOP] };
        let found = range(self.values_mm.iter().copied());
        let unit = Unit::length(found[1]);
        let scale = [found[0].max(0.0) * unit.factor, found[1] * unit.factor];
        let mut svg = Svg::new(NARROW, bottom + 42.0, &self.title, "Map in colours, light is large");
        svg.text("head", [4.0, 16.0], Anchor::Start, &self.title);
        let size = [(RIGHT - LEFT) / columns as f64, tall / rows as f64];
        for (number, value) in self.values_mm.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let (row, column) = (number / columns, number % columns);
            let corner = [LEFT + size[0] * column as f64, bottom - size[1] * (row + 1) as f64];
            let value = value * unit.factor;
            let colour = colour((value - scale[0]) / (scale[1] - scale[0]));
            let tip = format!("{} {}", significant(value, 3), unit.sign);
            svg.cell(&colour, corner, size, &tip);
        }
        svg.path("rule", &[[LEFT, TOP], [RIGHT, TOP], [RIGHT, bottom], [LEFT, bottom]], true);
        axes(&mut svg, &x, &y, &self.axis_names);
        let legend = Scale { values: scale, pixels: [bottom, TOP] };
        for part in 0..40 {
            let share = f64::from(part) / 39.0;
            let at = [LEGEND, bottom - tall * f64::from(part + 1) / 40.0];
            // Each over the one below: edges rounded to a pixel leave no gap.
            let overlap = if part > 0 { 0.6 } else { 0.0 };
            svg.cell(&colour(share), at, [14.0, tall / 40.0 + overlap], "");
        }
        let ticks = Ticks::inside(scale, 5.0);
        for &value in &ticks.values {
            let label = ticks.label(value);
            svg.text("soft", [LEGEND + 19.0, legend.at(value) + 4.0], Anchor::Start, &label);
        }
        svg.text("soft", [LEGEND, TOP - 8.0], Anchor::Start, unit.sign);
        svg.finish()
    }
}

fn axes(svg: &mut Svg, x: &Scale, y: &Scale, names: &[String; 2]) {
    let [bottom, top] = y.pixels;
    let along = Ticks::inside(x.values, 7.0);
    for &value in &along.values {
        svg.line("rule", [x.at(value), bottom], [x.at(value), bottom + 4.0]);
        svg.text("soft", [x.at(value), bottom + 17.0], Anchor::Middle, &along.label(value));
    }
    let up = Ticks::inside(y.values, 5.0);
    for &value in &up.values {
        svg.line("rule", [LEFT - 4.0, y.at(value)], [LEFT, y.at(value)]);
        svg.text("soft", [LEFT - 7.0, y.at(value) + 4.0], Anchor::End, &up.label(value));
    }
    svg.text("soft", [0.5 * (LEFT + RIGHT), bottom + 34.0], Anchor::Middle, &names[0]);
    svg.text_upwards("soft", [12.0, 0.5 * (top + bottom)], &names[1]);
}

/// The colour of a share from 0 to 1.
fn colour(share: f64) -> String {
    let place = if share.is_finite() { share.clamp(0.0, 1.0) * 4.0 } else { 0.0 };
    let below = (place.floor() as usize).min(3);
    let part = place - below as f64;
    let [r, g, b] = [0, 1, 2].map(|channel| {
        let value = COLOURS[below][channel] * (1.0 - part) + COLOURS[below + 1][channel] * part;
        value.round() as u8
    });
    format!("#{r:02x}{g:02x}{b:02x}")
}
