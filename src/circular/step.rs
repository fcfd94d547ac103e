//! How much an axis or a joint loses as it reverses: steps fitted to the deviation.
//!
//! Behind its play b a drive stands b/2 short of where it was sent, on the side that it came from: the
//! length changes by -b/2 times the sense of its motion times its lever. For two linear axes the levers
//! are cos t and sin t; for a robot's joint the lever is the derivative of the length, mm/rad. The steps
//! are fitted together with harmonics up to the third order, so on a robot they hold where the
//! orientation is fixed or turns smoothly.

use nalgebra::{DMatrix, DVector};

use super::quantities::Rays;
use super::{Drive, Sense, Trace};

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
    /// Which.
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
/// Columns of unit norm that are nearer to each other cannot be told apart.
const LEAST_SINGULAR: f64 = 1e-3;
/// More points than this tell a few numbers no better: only some of them are used.
const MOST_POINTS: usize = 20_000;
const NORMAL: f64 = 1.96;

/// The plays of all drives that reverse; empty where they cannot be told.
pub(super) fn fit(traces: &[Trace], rays: &Rays, centre: [f64; 2]) -> Vec<Step> {
    let joints = traces.iter().flat_map(|trace| &trace.points).any(|point| point.axes_deg.is_some());
    let (mut rows, mut values): (Vec<(f64, Vec<Drive>)>, Vec<f64>) = (Vec::new(), Vec::new());
    let points: usize = traces.iter().map(|trace| trace.points.len()).sum();
    let stride = points.div_ceil(MOST_POINTS).max(1);
    for (trace, rays) in traces.iter().zip(&rays.traces) {
        for (point, ray) in trace.points.iter().zip(rays).step_by(stride) {
            let theta = point.angle_deg.to_radians();
            let drives = match (joints, point.drives) {
                (false, _) => linear(theta, trace.sense),
                (true, Some(drives)) => drives.to_vec(),
                (true, None) => continue,
            };
            rows.push((theta, drives));
            values.push(ray.deviation(centre));
        }
    }
    let Some(drives) = rows.first().map(|(_, drives)| drives.len()) else { return Vec::new() };
    let reverses = |drive: &usize| {
        let going = |sense: i8| rows.iter().filter(|(_, drives)| drives[*drive].sense == sense).count();
        going(1).min(going(-1)) >= LEAST_EACH
    };
    let reversing: Vec<usize> = (0..drives).filter(reverses).collect();
    // Where it is not known from which side a drive came, a point says nothing of it.
    let known = |drives: &[Drive]| reversing.iter().all(|&drive| drives[drive].sense != 0);
    let (rows, values): (Vec<_>, Vec<f64>) =
        rows.into_iter().zip(values).filter(|((_, drives), _)| known(drives)).unzip();
    let smooth = 1 + 2 * ORDERS;
    let columns = smooth + reversing.len();
    if reversing.is_empty() || rows.len() <= columns + 2 {
        return Vec::new();
    }
    let mut matrix = DMatrix::zeros(rows.len(), columns);
    for (row, (theta, drives)) in rows.iter().enumerate() {
        matrix[(row, 0)] = 1.0;
        for order in 1..=ORDERS {
            let (sin, cos) = (order as f64 * theta).sin_cos();
            (matrix[(row, 2 * order - 1)], matrix[(row, 2 * order)]) = (cos, sin);
        }
        for (at, &drive) in reversing.iter().enumerate() {
            let Drive { lever_mm, sense } = drives[drive];
            matrix[(row, smooth + at)] = -0.5 * f64::from(sense) * lever_mm;
        }
    }
    let Some((solved, covariance, variance)) = solve(matrix, DVector::from(values)) else {
        return Vec::new();
    };
    reversing
        .iter()
        .enumerate()
        .map(|(at, &drive)| {
            let play = solved[smooth + at];
            let levers = rows.iter().map(|(_, drives)| drives[drive].lever_mm.abs());
            Step {
                mover: if joints { Mover::Joint(drive + 1) } else { Mover::Axis(drive + 1) },
                play,
                u95: NORMAL * (variance * covariance[(smooth + at, smooth + at)]).sqrt(),
                most_mm: play.abs() * levers.fold(0.0, f64::max),
            }
        })
        .collect()
}

/// Two linear axes on the circle: their levers, and the sense of their motion there.
fn linear(theta: f64, sense: Sense) -> Vec<Drive> {
    let (sin, cos) = theta.sin_cos();
    let turn = if sense == Sense::CounterClockwise { 1.0 } else { -1.0 };
    let sign = |velocity: f64| if velocity * turn >= 0.0 { 1 } else { -1 };
    vec![Drive { lever_mm: cos, sense: sign(-sin) }, Drive { lever_mm: sin, sense: sign(cos) }]
}

/// Least squares with columns scaled to unit norm: solution, covariance for a unit variance, and the
/// variance of the residuals. `None` when columns cannot be told apart.
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
