//! Orthographic views of the cell: base balls, path, robot skeletons.

use super::frame::NARROW;
use crate::report::scale::{Scale, Ticks, range};
use crate::report::svg::{Anchor, Svg};

const LEFT: f64 = 60.0;
const RIGHT: f64 = 466.0;
const TOP: f64 = 30.0;
/// Tallest plot area, pixels.
const TALL: f64 = 400.0;

/// From where one looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Projection {
    /// From above: X to the right, Y up.
    Xy,
    /// From the robot's right side: X to the right, Z up.
    Xz,
    /// From the front, against X: Y to the right, Z up.
    Yz,
}

impl Projection {
    /// The three views.
    pub const ALL: [Self; 3] = [Self::Xy, Self::Xz, Self::Yz];

    fn axes(self) -> [usize; 2] {
        match self {
            Self::Xy => [0, 1],
            Self::Xz => [0, 2],
            Self::Yz => [1, 2],
        }
    }

    /// The names of its axes.
    pub fn names(self) -> [&'static str; 2] {
        self.axes().map(|axis| ["X", "Y", "Z"][axis])
    }
}

/// One view, in the robot base, mm.
#[derive(Clone, Debug, PartialEq)]
pub struct View<'a> {
    /// What it shows.
    pub title: String,
    /// From where.
    pub projection: Projection,
    /// Base balls: name and centre.
    pub balls: &'a [(String, [f64; 3])],
    /// The path in order.
    pub path: &'a [[f64; 3]],
    /// The points of the path where the robot dwells.
    pub dwells: &'a [[f64; 3]],
    /// Polylines through the robot's joints, base first.
    pub skeletons: &'a [Vec<[f64; 3]>],
}

impl View<'_> {
    /// Draws it, both axes to the same scale.
    pub fn to_svg(&self) -> String {
        let [across, up] = self.projection.axes();
        let everything = || {
            let balls = self.balls.iter().map(|(_, centre)| centre);
            balls.chain(self.path).chain(self.dwells).chain(self.skeletons.iter().flatten())
        };
        let span = |axis: usize| {
            let [low, high] = range(everything().map(|point| point[axis]));
            let pad = (0.06 * (high - low)).max(20.0);
            [low - pad, high + pad]
        };
        let ([x0, x1], [y0, y1]) = (span(across), span(up));
        let mm_per_px = ((x1 - x0) / (RIGHT - LEFT)).max((y1 - y0) / TALL);
        let tall = ((y1 - y0) / mm_per_px).max(60.0);
        let half = 0.5 * (RIGHT - LEFT) * mm_per_px;
        let middle = 0.5 * (x0 + x1);
        let low = 0.5 * (y0 + y1) - 0.5 * tall * mm_per_px;
        let x = Scale { values: [middle - half, middle + half], pixels: [LEFT, RIGHT] };
        let y = Scale { values: [low, low + tall * mm_per_px], pixels: [TOP + tall, TOP] };
        let mut svg = Svg::new(NARROW, TOP + tall + 42.0, &self.title, "Base balls, path and robot");
        svg.text("head", [4.0, 16.0], Anchor::Start, &self.title);
        grid(&mut svg, &x, &y, self.projection.names());
        let place = |point: &[f64; 3]| [x.at(point[across]), y.at(point[up])];
        for skeleton in self.skeletons {
            let bones: Vec<[f64; 2]> = skeleton.iter().map(place).collect();
            svg.path("bone", &bones, false);
            for joint in &bones {
                svg.circle("joint", *joint, 3.0, "");
            }
        }
        let hops: Vec<[f64; 2]> = self.path.iter().map(place).collect();
        svg.path("hop", &hops, false);
        for dwell in self.dwells {
            svg.circle("d-after", place(dwell), 1.8, "");
        }
        for (name, centre) in self.balls {
            let at = place(centre);
            svg.circle("d-ball", at, 5.0, name);
            svg.text("halo", [at[0] + 7.0, at[1] - 8.0], Anchor::Start, name);
        }
        svg.finish()
    }
}

fn grid(svg: &mut Svg, x: &Scale, y: &Scale, names: [&str; 2]) {
    let [bottom, top] = y.pixels;
    let along = Ticks::inside(x.values, 6.0);
    for &value in &along.values {
        svg.line("grid", [x.at(value), bottom], [x.at(value), top]);
        svg.text("soft", [x.at(value), bottom + 17.0], Anchor::Middle, &along.label(value));
    }
    let upwards = Ticks::stepped(y.values, along.step);
    for &value in &upwards.values {
        svg.line("grid", [LEFT, y.at(value)], [RIGHT, y.at(value)]);
        svg.text("soft", [LEFT - 7.0, y.at(value) + 4.0], Anchor::End, &upwards.label(value));
    }
    svg.text("soft", [0.5 * (LEFT + RIGHT), bottom + 34.0], Anchor::Middle, &format!("{} (mm)", names[0]));
    svg.text_upwards("soft", [12.0, 0.5 * (top + bottom)], &format!("{} (mm)", names[1]));
}
