//! How much an axis or a joint loses as it reverses: steps fitted to the deviation.
//!
//! With a play b a drive stops b/2 short of its target, on the side that it came from: the
//! length changes by -b/2 times the sense of its motion times its lever. For two linear axes the levers
//! are cos t and sin t; for a robot's joint the lever is the derivative of the length, mm/rad. The steps
//! of linear axes are fitted together with the form of the circle, harmonics up to the third order. A robot's form
//! is none of low order where the orientation changes: its steps are those between the two senses at the same poses, in
//! which the form is not.

use nalgebra::{DMatrix, DVector};

use super::quantities::Rays;
use super::{Drive, Point, Sense, Trace};
use crate::math::distributions::coverage_95;

/// What reverses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Mover {
    /// A linear axis of the plane, 1 or 2; its play is in mm.
    Axis(usize),
    /// A joint of the robot, from 1; its play is in rad.
    Joint(usize),
}

/// What a drive loses as it reverses.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Step {
    pub mover: Mover,
    /// Play: mm of an axis, rad of a joint. Negative where the drive runs ahead.
    pub play: f64,
    /// Half width of its 95 % interval, from the scatter about the fit.
    pub u95: f64,
    /// The greatest step that it makes in the length, mm.
    pub most_mm: f64,
}

const ORDERS: usize = 3;
/// Points on either side of a reversal, summed over the traces, with which a play is fitted.
const LEAST_EACH: usize = 3;
/// Columns of unit norm that are nearer to each other are not separable.
const LEAST_SINGULAR: f64 = 1e-3;
/// More points than this tell a few numbers no better: only some of them are used.
const MOST_POINTS: usize = 20_000;
/// Joints of one pose in both senses differ by less, degrees.
const SAME_DEG: f64 = 1e-3;

/// A value and what a linear model has for it.
struct Row {
    form: Vec<f64>,
    /// For each drive what it does to the length, mm, and the sense of its motion: 0 where that is not known.
    moves: Vec<Move>,
    value: f64,
}

#[derive(Clone, Copy)]
struct Move {
    column: f64,
    lever_mm: f64,
    sense: i8,
}

impl Move {
    /// A drive stops half of its play short of its target.
    fn new(Drive { lever_mm, sense }: Drive) -> Self {
        Self { column: -0.5 * f64::from(sense) * lever_mm, lever_mm, sense }
    }

    /// The same pose, reached in both senses.
    fn difference(one: Drive, other: Drive) -> Self {
        let sense = if one.sense * other.sense < 0 { one.sense } else { 0 };
        Self { column: Self::new(one).column - Self::new(other).column, lever_mm: one.lever_mm, sense }
    }
}

/// The plays of all drives that reverse; empty where they are not identifiable.
pub(super) fn fit(traces: &[Trace], rays: &Rays) -> Vec<Step> {
    let joints = traces.iter().flat_map(|trace| &trace.points).any(|point| point.axes_deg.is_some());
    let rows = if joints { between_senses(traces, rays) } else { along(traces, rays) };
    let Some(drives) = rows.first().map(|row| row.moves.len()) else { return Vec::new() };
    let reverses = |drive: &usize| {
        let going = |sense: i8| rows.iter().filter(|row| row.moves[*drive].sense == sense).count();
        if joints { going(1) + going(-1) >= 2 * LEAST_EACH } else { going(1).min(going(-1)) >= LEAST_EACH }
    };
    let reversing: Vec<usize> = (0..drives).filter(reverses).collect();
    // Where it is not known from which side a drive came, a point says nothing of it.
    let rows: Vec<Row> =
        rows.into_iter().filter(|row| reversing.iter().all(|&drive| row.moves[drive].sense != 0)).collect();
    let form = rows.first().map_or(0, |row| row.form.len());
    let columns = form + reversing.len();
    if reversing.is_empty() || rows.len() <= columns + 2 {
        return Vec::new();
    }
    let matrix = DMatrix::from_fn(rows.len(), columns, |row, column| match column.checked_sub(form) {
        None => rows[row].form[column],
        Some(at) => rows[row].moves[reversing[at]].column,
    });
    let values = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.value));
    let Some((solved, covariance, variance)) = solve(matrix, values) else {
        return Vec::new();
    };
    let coverage = coverage_95(Some((rows.len() - columns) as f64));
    reversing
        .iter()
        .enumerate()
        .map(|(at, &drive)| {
            let play = solved[form + at];
            let levers = rows.iter().map(|row| row.moves[drive].lever_mm.abs());
            Step {
                mover: if joints { Mover::Joint(drive + 1) } else { Mover::Axis(drive + 1) },
                play,
                u95: coverage * (variance * covariance[(form + at, form + at)]).sqrt(),
                most_mm: play.abs() * levers.fold(0.0, f64::max),
            }
        })
        .collect()
}

/// Two linear axes: the deviation of each point, beside the form up to the third order.
fn along(traces: &[Trace], rays: &Rays) -> Vec<Row> {
    let points: usize = traces.iter().map(|trace| trace.points.len()).sum();
    let stride = points.div_ceil(MOST_POINTS).max(1);
    let mut rows = Vec::new();
    for (at, trace) in traces.iter().enumerate() {
        for (place, point) in trace.points.iter().enumerate().step_by(stride) {
            let theta = point.angle_deg.to_radians();
            let harmonics = (1..=ORDERS).flat_map(|order| {
                let (sin, cos) = (order as f64 * theta).sin_cos();
                [cos, sin]
            });
            let moves = linear(theta, trace.sense).into_iter().map(Move::new).collect();
            rows.push(Row {
                form: std::iter::once(1.0).chain(harmonics).collect(),
                moves,
                value: rays.deviation(at, place),
            });
        }
    }
    rows
}

/// Joints of a robot: the length of a pose in one sense less that in the other. The form of the circle, whatever the
/// orientation does along it, is in both; what is left besides the plays is a constant, the drift between the passes.
fn between_senses(traces: &[Trace], rays: &Rays) -> Vec<Row> {
    let of = |sense| traces.iter().enumerate().filter(move |(_, trace)| trace.sense == sense);
    let mut rows = Vec::new();
    for (ccw, one) in of(Sense::CounterClockwise) {
        for (cw, other) in of(Sense::Clockwise).filter(|(_, other)| other.run == one.run) {
            for (place, point) in one.points.iter().enumerate() {
                let mut others = other.points.iter().enumerate();
                let Some((back, mate)) = others.find(|(_, mate)| same_pose(point, mate)) else { continue };
                let Some((ours, theirs)) = point.drives.zip(mate.drives) else { continue };
                let moves = ours.into_iter().zip(theirs).map(|(one, other)| Move::difference(one, other));
                let value = rays.deviation(ccw, place) - rays.deviation(cw, back);
                rows.push(Row { form: vec![1.0], moves: moves.collect(), value });
            }
        }
    }
    rows
}

/// Whether all joints are alike.
fn same_pose(one: &Point, other: &Point) -> bool {
    let Some((one, other)) = one.axes_deg.zip(other.axes_deg) else { return false };
    one.iter().zip(&other).all(|(one, other)| (one - other).abs() < SAME_DEG)
}

/// Two linear axes on the circle: their levers, and the sense of their motion there.
fn linear(theta: f64, sense: Sense) -> Vec<Drive> {
    let (sin, cos) = theta.sin_cos();
    let turn = if sense == Sense::CounterClockwise { 1.0 } else { -1.0 };
    let sign = |velocity: f64| if velocity * turn >= 0.0 { 1 } else { -1 };
    vec![Drive { lever_mm: cos, sense: sign(-sin) }, Drive { lever_mm: sin, sense: sign(cos) }]
}

/// Least squares with columns scaled to unit norm: solution, covariance for a unit variance, and the
/// variance of the residuals. `None` when columns are not separable.
fn solve(mut matrix: DMatrix<f64>, values: DVector<f64>) -> Option<(DVector<f64>, DMatrix<f64>, f64)> {
    let (rows, columns) = matrix.shape();
    let norms: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
    for (at, norm) in norms.iter().enumerate() {
        if *norm <= 0.0 {
            return None;
        }
        matrix.column_mut(at).unscale_mut(*norm);
    }
    let qr = matrix.clone().qr();
    let r = qr.r();
    let inverse = r.clone().try_inverse()?;
    // The inverse's norm bounds the least singular value from below.
    if 1.0 / inverse.norm() < LEAST_SINGULAR {
        return None;
    }
    let scaled = &inverse * (qr.q().transpose() * &values);
    let residuals = values - &matrix * &scaled;
    let variance = residuals.norm_squared() / (rows - columns) as f64;
    let covariance = &inverse * inverse.transpose();
    let unscale = |at: usize| 1.0 / norms[at];
    let solved = DVector::from_fn(columns, |at, _| scaled[at] * unscale(at));
    let covariance = DMatrix::from_fn(columns, columns, |a, b| covariance[(a, b)] * unscale(a) * unscale(b));
    Some((solved, covariance, variance))
}
