//! `report.html` from a result: what the page needs is picked out here, and drawn by the report room.

use std::collections::BTreeMap;

use crate::export::frames;
use crate::export::mastering::{self, AxisOffset};
use crate::identify::{Identified, senses};
use crate::model::{Observation, Observations, Robot};
use crate::plan::Kind;
use crate::report::plot::HeatMap;
use crate::report::{AxisZero, BallPlace, Fact, Provenance, ReportError, Source};
use crate::report::{CirclePanel, IdentificationPlots, ObservationPoint, Tolerance, identification};

/// What `dbbd sync` writes into the column `kind` of a length at the reference pose.
const REFERENCE: &str = "reference";
/// Lengths that are drawn at most: an even sample of more.
const DRAWN: usize = 20_000;
/// Cells along the longer side of a map of the predicted error.
const CELLS: usize = 24;

/// The report of an identification.
pub(super) fn html(
    robot: &Robot,
    observations: &Observations,
    found: &Identified,
    sources: Vec<Source>,
) -> Result<String, ReportError> {
    let stride = observations.rows.len().div_ceil(DRAWN).max(1);
    let points = points(observations, found, stride);
    let sample = (stride > 1).then(|| Fact::new("Drawn below", format!("every {stride}th length")));
    let plots = IdentificationPlots {
        circles: circles(&points),
        observations: points,
        per_ball: per_ball(observations),
        references: references(observations),
        tolerance: Some(Tolerance {
            length_mm: robot.tolerance.length_mm,
            angle_rad: robot.tolerance.angle_deg.to_radians(),
        }),
        zeros: zeros(found),
        balls: balls(found),
        maps: error_maps(&found.predicted),
        facts: sample.into_iter().collect(),
        provenance: Provenance {
            dbbd_version: env!("CARGO_PKG_VERSION").into(),
            robot: robot.name.clone(),
            plan_hash: None,
            date: None,
            sources,
        },
    };
    identification::html(&found.result, &plots)
}

/// Every `stride`-th of the observations as the page takes them; circle, angle and kind stand in the further columns
/// that `dbbd sync` writes.
fn points(observations: &Observations, found: &Identified, stride: usize) -> Vec<ObservationPoint> {
    let rows = observations.rows.iter();
    let senses = senses(rows.clone().map(Observation::axes)).step_by(stride);
    let drawn = rows.clone().step_by(stride).zip(found.residuals(rows.step_by(stride)));
    let columns = ["circle", "angle_deg", "kind"].map(|name| column(observations, name));
    drawn
        .zip(senses)
        .map(|((row, residual), senses)| {
            let cells = observations.further.cells(row.further);
            let [circle, angle, kind] =
                columns.map(|at| at.and_then(|at| cells.get(at)).map_or("", String::as_str));
            ObservationPoint {
                index: row.index,
                centre: row.centre,
                axes_deg: row.axes_deg,
                senses,
                before_mm: residual.before,
                after_mm: residual.after,
                circle: circle.parse().ok().filter(|number| *number > 0),
                angle_deg: angle.parse().ok(),
                kind: match kind {
                    "measure" => Some(Kind::Measure),
                    REFERENCE => Some(Kind::Reference),
                    _ => None,
                },
            }
        })
        .collect()
}

/// Where a further column stands.
fn column(observations: &Observations, name: &str) -> Option<usize> {
    observations.further.columns.iter().position(|column| column == name)
}

/// How many lengths were measured at the reference pose.
fn references(observations: &Observations) -> usize {
    let Some(kind) = column(observations, "kind") else { return 0 };
    let kinds = observations.rows.iter().map(|row| observations.further.cells(row.further));
    kinds.filter(|cells| cells.get(kind).is_some_and(|kind| kind == REFERENCE)).count()
}

fn per_ball(observations: &Observations) -> BTreeMap<usize, usize> {
    let mut per_ball = BTreeMap::new();
    for row in &observations.rows {
        *per_ball.entry(row.centre).or_default() += 1;
    }
    per_ball
}

/// What goes back to the controller.
fn zeros(found: &Identified) -> Vec<AxisZero> {
    mastering::offsets(&found.robot, &found.result)
        .into_iter()
        .map(|AxisOffset { axis, offset_deg, sd_deg, told, remark, .. }| AxisZero {
            axis,
            offset_deg,
            sd_deg,
            told,
            remark,
        })
        .collect()
}

fn balls(found: &Identified) -> Vec<BallPlace> {
    frames::frames(&found.result)
        .into_iter()
        .map(|frame| BallPlace {
            corrected_mm: std::array::from_fn(|axis| frame.found_mm[axis] - frame.before_mm[axis]),
            what: frame.what,
            found_mm: frame.found_mm,
            told: frame.told,
        })
        .collect()
}

fn circles(points: &[ObservationPoint]) -> Vec<CirclePanel> {
    let on_circle = |point: &&ObservationPoint| point.angle_deg.is_some();
    let mut numbers: Vec<(u32, usize)> =
        points.iter().filter(on_circle).filter_map(|point| Some((point.circle?, point.centre))).collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
        .into_iter()
        .map(|(number, ball)| CirclePanel {
            number,
            name: format!("Circle {number}, ball {ball}"),
            radius_mm: None,
            axis_names: None,
        })
        .collect()
}

/// The predicted error (where the ball is, and the error there, mm) seen from above and from the side.
pub(crate) fn error_maps(found: &[([f64; 3], f64)]) -> Vec<HeatMap> {
    let side = |p: &[f64; 3]| [p[0].hypot(p[1]), p[2]];
    let above = |p: &[f64; 3]| [p[0], p[1]];
    [
        map("Predicted 3-D error from above", ["X (mm)", "Y (mm)"], found, above),
        map("Predicted 3-D error from the side", ["distance from axis 1 (mm)", "Z (mm)"], found, side),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// The root mean square error of the workspace poses in each cell of a grid.
fn map(
    title: &str,
    names: [&str; 2],
    found: &[([f64; 3], f64)],
    project: impl Fn(&[f64; 3]) -> [f64; 2],
) -> Option<HeatMap> {
    let places: Vec<[f64; 2]> = found.iter().map(|(position, _)| project(position)).collect();
    let ends = |axis: usize| {
        let values = places.iter().map(|place| place[axis]);
        [values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max)]
    };
    let extent = [ends(0), ends(1)];
    let cell = (extent[0][1] - extent[0][0]).max(extent[1][1] - extent[1][0]) / CELLS as f64;
    // All poses in one place make no map.
    if !(cell.is_finite() && cell > 0.0) {
        return None;
    }
    let count = |axis: usize| (((extent[axis][1] - extent[axis][0]) / cell).ceil() as usize).max(1);
    let (columns, rows) = (count(0), count(1));
    let mut sums = vec![(0.0, 0u32); columns * rows];
    for (place, (_, error)) in places.iter().zip(found) {
        let at =
            |axis: usize, count: usize| (((place[axis] - extent[axis][0]) / cell) as usize).min(count - 1);
        let (sum, poses) = &mut sums[at(1, rows) * columns + at(0, columns)];
        *sum += error * error;
        *poses += 1;
    }
    Some(HeatMap {
        title: title.into(),
        axis_names: names.map(str::to_owned),
        extent: [
            [extent[0][0], extent[0][0] + cell * columns as f64],
            [extent[1][0], extent[1][0] + cell * rows as f64],
        ],
        columns,
        values_mm: sums
            .into_iter()
            .map(|(sum, poses)| if poses > 0 { (sum / f64::from(poses)).sqrt() } else { f64::NAN })
            .collect(),
    })
}
