//! A map of a positive quantity over two coordinates, such as the predicted position uncertainty over a plane.

use super::frame::{Area, Frame, Grid, Labels, NARROW};
use crate::report::scale::{Scale, Ticks, Unit, range, significant};
use crate::report::scene::BallMark;
use crate::report::svg::{Anchor, Svg};
use dbbd_model::estimation::result::MapPoint;

const AREA: Area = Area { width: NARROW, left: 56.0, right: 390.0, top: 30.0, bottom: 30.0 };
const LEGEND: f64 = 404.0;
/// Steps of the colour bar.
const STEPS: u32 = 40;
/// Cells along the longer side of a map.
const CELLS: usize = 24;
/// Dark blue to yellow through grey: lightness in even steps, also for colour-blind readers.
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
    pub title: String,
    /// Names of the two coordinates with unit, such as `X (mm)`.
    pub axis_names: [String; 2],
    /// First and last edge of the grid along x and along y.
    pub extent: [[f64; 2]; 2],
    pub columns: usize,
    /// Values row by row from the lowest y, mm; not finite in an empty cell.
    pub values_mm: Vec<f64>,
    pub overlay: Overlay,
}

/// The arm and the base balls in the coordinates of a map, mm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overlay {
    pub arm: Vec<[f64; 2]>,
    /// Name and place of each base ball.
    pub balls: Vec<(String, [f64; 2])>,
}

impl HeatMap {
    /// Maps of the predicted position uncertainty with the arm and the base balls.
    pub(crate) fn of_uncertainty(points: &[MapPoint], arm: &[[f64; 3]], balls: &[BallMark]) -> Vec<String> {
        let mut maps = Self::binned_from_two_sides("Predicted position uncertainty", points);
        let projections = [|[x, y, _]: [f64; 3]| [x, y], |[x, y, z]: [f64; 3]| [x.hypot(y), z]];
        for (map, project) in maps.iter_mut().zip(projections) {
            map.overlay = Overlay {
                arm: arm.iter().map(|joint| project(*joint)).collect(),
                balls: balls.iter().map(|ball| (ball.name(), project(ball.at))).collect(),
            };
        }
        maps.iter().map(Self::to_svg).collect()
    }

    /// Maps of a quantity of the position.
    pub(crate) fn of_positions(quantity: &str, points: &[MapPoint]) -> Vec<String> {
        Self::binned_from_two_sides(quantity, points).iter().map(Self::to_svg).collect()
    }

    /// Two maps: from above and from the side.
    fn binned_from_two_sides(quantity: &str, points: &[MapPoint]) -> Vec<Self> {
        let above = points.iter().map(|point| (point.position.xy().into(), point.rms_mm)).collect();
        let from_axis_1 = |point: &MapPoint| [point.position.xy().norm(), point.position.z];
        let side = points.iter().map(|point| (from_axis_1(point), point.rms_mm)).collect();
        let above = Self::binned(format!("{quantity}, from above"), ["X (mm)", "Y (mm)"], above);
        let names = ["distance from axis 1 (mm)", "Z (mm)"];
        let side = Self::binned(format!("{quantity}, from the side"), names, side);
        [above, side].into_iter().flatten().collect()
    }

    /// The root mean square of the values in each cell of a grid; `None` if all places are the same.
    fn binned(title: String, names: [&str; 2], places: Vec<([f64; 2], f64)>) -> Option<Self> {
        let ends = [0, 1].map(|axis| {
            let values = places.iter().map(|(place, _)| place[axis]);
            [values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max)]
        });
        let spans = ends.map(|[low, high]| high - low);
        let cell = spans[0].max(spans[1]) / CELLS as f64;
        if !(cell.is_finite() && cell > 0.0) {
            return None;
        }
        let [columns, rows] = spans.map(|span| ((span / cell).ceil() as usize).max(1));
        let mut sums = vec![(0.0, 0u32); columns * rows];
        for (place, value) in &places {
            let at =
                |axis: usize, count: usize| (((place[axis] - ends[axis][0]) / cell) as usize).min(count - 1);
            let (sum, count) = &mut sums[at(1, rows) * columns + at(0, columns)];
            *sum += value * value;
            *count += 1;
        }
        let mean =
            |(sum, count): (f64, u32)| if count > 0 { (sum / f64::from(count)).sqrt() } else { f64::NAN };
        let edges = |axis: usize, count: usize| [ends[axis][0], ends[axis][0] + cell * count as f64];
        Some(Self {
            title,
            axis_names: names.map(str::to_owned),
            extent: [edges(0, columns), edges(1, rows)],
            columns,
            values_mm: sums.into_iter().map(mean).collect(),
            overlay: Overlay::default(),
        })
    }

    /// The picture, with x and y to the same scale.
    pub fn to_svg(&self) -> String {
        let drawn = |axis: usize| {
            let balls = self.overlay.balls.iter().map(move |(_, ball)| ball[axis]);
            self.overlay.arm.iter().map(move |joint| joint[axis]).chain(balls)
        };
        let [x, y] = [0, 1].map(|axis| range(self.extent[axis].into_iter().chain(drawn(axis))));
        let aspect = (y[1] - y[0]) / (x[1] - x[0]);
        let tall = ((AREA.right - AREA.left) * aspect).clamp(90.0, 520.0);
        let labels = Labels {
            title: &self.title,
            description: "Map in colours, light is large",
            x: &self.axis_names[0],
            y: &self.axis_names[1],
        };
        let mut frame = Frame::new(Area { bottom: AREA.top + tall, ..AREA }, &labels, x, y);
        let found = range(self.values_mm.iter().copied());
        let unit = Unit::length(found[1]);
        let scale = [found[0].max(0.0) * unit.factor, found[1] * unit.factor];
        self.cells(&mut frame, unit, scale);
        self.overlay(&mut frame);
        let ([left, right], [bottom, top]) = (frame.x.pixels, frame.y.pixels);
        frame.svg.path("rule", &[[left, top], [right, top], [right, bottom], [left, bottom]], true);
        frame.x_axis(&Ticks::inside(x, 7.0), Grid::Marks);
        frame.y_axis(&Ticks::inside(y, 5.0), Grid::Marks);
        colours(&mut frame.svg, &Scale { values: scale, pixels: [bottom, top] });
        frame.svg.text("soft", [LEGEND, top - 8.0], Anchor::Start, unit.sign);
        frame.svg.finish()
    }

    fn overlay(&self, frame: &mut Frame) {
        let arm: Vec<[f64; 2]> = self.overlay.arm.iter().map(|[x, y]| frame.at(*x, *y)).collect();
        ["arm", "arm-core"].into_iter().for_each(|class| frame.svg.path(class, &arm, false));
        arm.into_iter().for_each(|joint| frame.svg.circle("joint", joint, 2.6, ""));
        for (name, [x, y]) in &self.overlay.balls {
            let [x, y] = frame.at(*x, *y);
            frame.svg.circle("d-ball", [x, y], 5.0, name);
            frame.svg.text("halo", [x + 7.0, y - 7.0], Anchor::Start, name);
        }
    }

    fn cells(&self, frame: &mut Frame, unit: Unit, scale: [f64; 2]) {
        let columns = self.columns.max(1);
        let rows = self.values_mm.len().div_ceil(columns).max(1);
        let [[left, right], [bottom, top]] =
            [self.extent[0].map(|value| frame.x.at(value)), self.extent[1].map(|value| frame.y.at(value))];
        let size = [(right - left) / columns as f64, (bottom - top) / rows as f64];
        for (number, value) in self.values_mm.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let (row, column) = (number / columns, number % columns);
            let corner = [left + size[0] * column as f64, bottom - size[1] * (row + 1) as f64];
            let value = value * unit.factor;
            let tip = format!("{} {}", significant(value, 3), unit.sign);
            // Cells overlap, so that edges rounded to a pixel leave no gap.
            let size = size.map(|side| side + 0.6);
            frame.svg.cell(&colour((value - scale[0]) / (scale[1] - scale[0])), corner, size, &tip);
        }
    }
}

fn colours(svg: &mut Svg, scale: &Scale) {
    let [bottom, top] = scale.pixels;
    let height = (bottom - top) / f64::from(STEPS);
    for part in 0..STEPS {
        let at = [LEGEND, bottom - height * f64::from(part + 1)];
        // Steps overlap, so that edges rounded to a pixel leave no gap.
        let overlap = if part > 0 { 0.6 } else { 0.0 };
        svg.cell(&colour(f64::from(part) / f64::from(STEPS - 1)), at, [14.0, height + overlap], "");
    }
    let ticks = Ticks::inside(scale.values, 5.0);
    for &value in &ticks.values {
        svg.text("soft", [LEGEND + 19.0, scale.at(value) + 4.0], Anchor::Start, &ticks.label(value));
    }
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
