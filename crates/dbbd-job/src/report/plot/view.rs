//! Orthographic views of the cell: base balls, path, robot skeletons.

use super::frame::{Area, Frame, Grid, Labels, NARROW};
use crate::plan::PlanRow;
use crate::report::scale::{Scale, Ticks, range};
use crate::report::scene::BallMark;
use crate::report::svg::Anchor;
use dbbd_model::measurement::PoseKind;

const LEFT: f64 = 60.0;
const RIGHT: f64 = 466.0;
const TOP: f64 = 30.0;
/// Tallest plot area, pixels.
const TALL: f64 = 400.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Projection {
    /// The view from above: X to the right, Y up.
    Xy,
    /// The view from the robot's right side: X to the right, Z up.
    Xz,
    /// The view from the front, against X: Y to the right, Z up.
    Yz,
}

impl Projection {
    pub(crate) const ALL: [Self; 3] = [Self::Xy, Self::Xz, Self::Yz];

    fn axes(self) -> [usize; 2] {
        match self {
            Self::Xy => [0, 1],
            Self::Xz => [0, 2],
            Self::Yz => [1, 2],
        }
    }
}

/// The cell in the robot base, mm.
pub(crate) struct View<'a> {
    pub(crate) title: &'a str,
    pub(crate) balls: &'a [BallMark],
    pub(crate) rows: &'a [PlanRow],
    /// Polylines through the robot's joints, base first.
    pub(crate) skeletons: &'a [Vec<[f64; 3]>],
    /// Edges of the obstacles, clipped to the extent of the other parts.
    pub(crate) obstacles: &'a [Vec<[f64; 3]>],
}

/// The part of a segment within a rectangle, given by its range along x and along y (Liang and Barsky, 1984).
fn clipped([from, to]: [[f64; 2]; 2], area: [[f64; 2]; 2]) -> Option<[[f64; 2]; 2]> {
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for (axis, [low, high]) in area.into_iter().enumerate() {
        let step = to[axis] - from[axis];
        if step == 0.0 {
            if !(low..=high).contains(&from[axis]) {
                return None;
            }
            continue;
        }
        let [one, other] = [low, high].map(|end| (end - from[axis]) / step);
        (first, last) = (first.max(one.min(other)), last.min(one.max(other)));
    }
    let at = |share: f64| [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
    (first < last).then(|| [at(first), at(last)])
}

impl View<'_> {
    /// The picture, with both axes to the same scale.
    pub(crate) fn to_svg(&self, projection: Projection) -> String {
        let axes = projection.axes();
        let [x_name, y_name] = axes.map(|axis| ["X", "Y", "Z"][axis]);
        let [x, y] = self.scales(axes);
        let area = Area { width: NARROW, left: LEFT, right: RIGHT, top: TOP, bottom: y.pixels[0] };
        let labels = Labels {
            title: &format!("{x_name}{y_name}, {}", self.title),
            description: "Base balls, path and robot",
            x: &format!("{x_name} (mm)"),
            y: &format!("{y_name} (mm)"),
        };
        let mut frame = Frame::new(area, &labels, x.values, y.values);
        let along = Ticks::inside(x.values, 6.0);
        frame.x_axis(&along, Grid::Lines);
        frame.y_axis(&Ticks::stepped(y.values, along.step), Grid::Lines);
        let place = |frame: &Frame, point: &[f64; 3]| frame.at(point[axes[0]], point[axes[1]]);
        let [bottom, top] = frame.y.pixels;
        for edge in self.obstacles {
            let points: Vec<[f64; 2]> = edge.iter().map(|point| place(&frame, point)).collect();
            for ends in points.windows(2) {
                if let Some([from, to]) = clipped([ends[0], ends[1]], [[LEFT, RIGHT], [top, bottom]]) {
                    frame.svg.line("edge", from, to);
                }
            }
        }
        for skeleton in self.skeletons {
            let bones: Vec<[f64; 2]> = skeleton.iter().map(|joint| place(&frame, joint)).collect();
            frame.svg.path("bone", &bones, false);
            for joint in bones {
                frame.svg.circle("joint", joint, 3.0, "");
            }
        }
        let path: Vec<[f64; 2]> = self.rows.iter().map(|row| place(&frame, &row.xyz_mm)).collect();
        frame.svg.path("hop", &path, false);
        for (_, at) in self.rows.iter().zip(path).filter(|(row, _)| row.kind != PoseKind::Transit) {
            frame.svg.circle("d-after", at, 1.8, "");
        }
        for ball in self.balls {
            let (name, [x, y]) = (ball.name(), place(&frame, &ball.at));
            frame.svg.circle("d-ball", [x, y], 5.0, &name);
            frame.svg.text("halo", [x + 7.0, y - 8.0], Anchor::Start, &name);
        }
        frame.svg.finish()
    }

    /// Scales that contain everything, with the same mm per pixel.
    fn scales(&self, axes: [usize; 2]) -> [Scale; 2] {
        let everything = || {
            let balls = self.balls.iter().map(|ball| &ball.at);
            balls.chain(self.rows.iter().map(|row| &row.xyz_mm)).chain(self.skeletons.iter().flatten())
        };
        let [[x0, x1], [y0, y1]] = axes.map(|axis| {
            let [low, high] = range(everything().map(|point| point[axis]));
            let pad = (0.06 * (high - low)).max(20.0);
            [low - pad, high + pad]
        });
        let mm_per_px = ((x1 - x0) / (RIGHT - LEFT)).max((y1 - y0) / TALL);
        let tall = ((y1 - y0) / mm_per_px).max(60.0);
        let about = |middle: f64, pixels: [f64; 2]| {
            let half = 0.5 * (pixels[1] - pixels[0]).abs() * mm_per_px;
            Scale { values: [middle - half, middle + half], pixels }
        };
        [about(0.5 * (x0 + x1), [LEFT, RIGHT]), about(0.5 * (y0 + y1), [TOP + tall, TOP])]
    }
}
