//! Reversals of the axes or joints along the circle, and the backlash of each, estimated from the steps that it causes.
//!
//! On a robot the reversals are not at 0, 90, 180 and 270 degrees but where the axis angles turn. With a backlash b a
//! drive stops b/2 short of its target, on the side that it came from: the length changes by -b/2 times the sense of
//! its motion times its lever. The levers of two linear axes are cos t and sin t; that of a robot's joint is the
//! derivative of the length, mm/rad. The steps of linear axes are fitted together with the form of the circle,
//! harmonics up to the third order. The form of a robot's circle is not of low order if the orientation changes along
//! it. Its steps are fitted to the differences between the two senses at the same poses, in which the form cancels.

use nalgebra::{DMatrix, DVector};

use super::quantities::RadialTraces;
use super::trace::{CirclePoint, CircleSense, CircleTrace, DriveState};
use crate::math::distributions::coverage_95;

/// A joint reverses.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Reversal {
    pub run: String,
    pub sense: CircleSense,
    /// Number of the joint, from 1.
    pub joint: usize,
    /// Angle of the pose at which it turns, degrees, 0..360.
    pub angle_deg: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum DriveId {
    /// A linear axis of the plane, 1 or 2. Its backlash is in mm.
    Axis(usize),
    /// A joint of the robot, from 1. Its backlash is in rad.
    Joint(usize),
}

/// The backlash of a drive.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct DriveBacklash {
    pub mover: DriveId,
    /// Backlash: mm of an axis, rad of a joint. Negative if the drive runs ahead.
    pub play: f64,
    /// Half width of its 95 % interval, from the scatter about the fit.
    pub u95: f64,
    /// The largest step that it causes in the length, mm.
    pub most_mm: f64,
}

const ORDERS: usize = 3;
/// Least number of points on either side of a reversal, summed over the traces.
const MIN_POINTS_EACH_SIDE: usize = 3;
/// Columns of unit norm are not separable below this singular value.
const MIN_SINGULAR_VALUE: f64 = 1e-3;
/// More points do not improve the fit: only some of them are used.
const MAX_FITTED_POINTS: usize = 20_000;
/// Joint angles of the same pose in both senses differ by less, degrees.
const SAME_DEG: f64 = 1e-3;

/// A row of the linear system.
struct BacklashRow {
    form: Vec<f64>,
    /// One effect per drive.
    moves: Vec<DriveEffect>,
    value: f64,
}

/// The effect of a drive on the length.
#[derive(Clone, Copy)]
struct DriveEffect {
    column: f64,
    lever_mm: f64,
    /// Sense of its motion; 0 if unknown.
    sense: i8,
}

impl DriveEffect {
    /// A drive stops half of its backlash short of its target.
    fn new(DriveState { lever_mm, sense }: DriveState) -> Self {
        Self { column: -0.5 * f64::from(sense) * lever_mm, lever_mm, sense }
    }

    /// The same pose reached in both senses.
    fn difference(one: DriveState, other: DriveState) -> Self {
        let sense = if one.sense * other.sense < 0 { one.sense } else { 0 };
        Self { column: Self::new(one).column - Self::new(other).column, lever_mm: one.lever_mm, sense }
    }
}

/// A joint that moves less between two poses is at rest, degrees.
const STILL_DEG: f64 = 1e-3;

/// The reversals of all traces with axis angles, in the order of the motion.
pub(super) fn reversals(traces: &[CircleTrace]) -> Vec<Reversal> {
    let mut reversals = Vec::new();
    for CircleTrace { run, sense, points } in traces {
        let mut going = [0.0_f64; 6];
        for pair in points.windows(2) {
            let (Some(from), Some(to)) = (pair[0].axes_deg, pair[1].axes_deg) else { continue };
            for (joint, going) in going.iter_mut().enumerate() {
                let step = to[joint] - from[joint];
                if step.abs() < STILL_DEG {
                    continue;
                }
                if *going * step < 0.0 {
                    let angle_deg = pair[0].angle_deg.rem_euclid(360.0);
                    reversals.push(Reversal { run: run.clone(), sense: *sense, joint: joint + 1, angle_deg });
                }
                *going = step;
            }
        }
    }
    reversals
}

/// The backlash of all drives that reverse; empty if it is not identifiable.
pub(super) fn backlash(traces: &[CircleTrace], rays: &RadialTraces) -> Vec<DriveBacklash> {
    let joints = traces.iter().flat_map(|trace| &trace.points).any(|point| point.axes_deg.is_some());
    let rows = if joints { between_senses(traces, rays) } else { along(traces, rays) };
    let Some(drives) = rows.first().map(|row| row.moves.len()) else { return Vec::new() };
    let reverses = |drive: &usize| {
        let going = |sense: i8| rows.iter().filter(|row| row.moves[*drive].sense == sense).count();
        if joints {
            going(1) + going(-1) >= 2 * MIN_POINTS_EACH_SIDE
        } else {
            going(1).min(going(-1)) >= MIN_POINTS_EACH_SIDE
        }
    };
    let reversing: Vec<usize> = (0..drives).filter(reverses).collect();
    // A point with an unknown sense of a drive has no information about it.
    let rows: Vec<BacklashRow> =
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
            DriveBacklash {
                mover: if joints { DriveId::Joint(drive + 1) } else { DriveId::Axis(drive + 1) },
                play,
                u95: coverage * (variance * covariance[(form + at, form + at)]).sqrt(),
                most_mm: play.abs() * levers.fold(0.0, f64::max),
            }
        })
        .collect()
}

/// Rows of two linear axes: the deviation of each point, with the form up to the third order.
fn along(traces: &[CircleTrace], rays: &RadialTraces) -> Vec<BacklashRow> {
    let points: usize = traces.iter().map(|trace| trace.points.len()).sum();
    let stride = points.div_ceil(MAX_FITTED_POINTS).max(1);
    let mut rows = Vec::new();
    for (at, trace) in traces.iter().enumerate() {
        for (place, point) in trace.points.iter().enumerate().step_by(stride) {
            let theta = point.angle_deg.to_radians();
            let harmonics = (1..=ORDERS).flat_map(|order| {
                let (sin, cos) = (order as f64 * theta).sin_cos();
                [cos, sin]
            });
            let moves = linear(theta, trace.sense).into_iter().map(DriveEffect::new).collect();
            rows.push(BacklashRow {
                form: std::iter::once(1.0).chain(harmonics).collect(),
                moves,
                value: rays.deviation(at, place),
            });
        }
    }
    rows
}

/// Rows of the joints of a robot: the difference of the lengths of a pose in the two senses, in which the form of the
/// circle cancels. Besides the backlash it has a constant, the drift between the passes.
fn between_senses(traces: &[CircleTrace], rays: &RadialTraces) -> Vec<BacklashRow> {
    let of = |sense| traces.iter().enumerate().filter(move |(_, trace)| trace.sense == sense);
    let mut rows = Vec::new();
    for (ccw, one) in of(CircleSense::CounterClockwise) {
        for (cw, other) in of(CircleSense::Clockwise).filter(|(_, other)| other.run == one.run) {
            for (place, point) in one.points.iter().enumerate() {
                let mut others = other.points.iter().enumerate();
                let Some((back, mate)) = others.find(|(_, mate)| same_pose(point, mate)) else { continue };
                let Some((ours, theirs)) = point.drives.zip(mate.drives) else { continue };
                let moves =
                    ours.into_iter().zip(theirs).map(|(one, other)| DriveEffect::difference(one, other));
                let value = rays.deviation(ccw, place) - rays.deviation(cw, back);
                rows.push(BacklashRow { form: vec![1.0], moves: moves.collect(), value });
            }
        }
    }
    rows
}

fn same_pose(one: &CirclePoint, other: &CirclePoint) -> bool {
    let Some((one, other)) = one.axes_deg.zip(other.axes_deg) else { return false };
    one.iter().zip(&other).all(|(one, other)| (one - other).abs() < SAME_DEG)
}

/// Levers of two linear axes on the circle, and the senses of their motion.
fn linear(theta: f64, sense: CircleSense) -> Vec<DriveState> {
    let (sin, cos) = theta.sin_cos();
    let turn = if sense == CircleSense::CounterClockwise { 1.0 } else { -1.0 };
    let sign = |velocity: f64| if velocity * turn >= 0.0 { 1 } else { -1 };
    vec![DriveState { lever_mm: cos, sense: sign(-sin) }, DriveState { lever_mm: sin, sense: sign(cos) }]
}

/// Least squares with columns scaled to unit norm: solution, covariance for unit variance, and variance of the
/// residuals. `None` if the columns are not separable.
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
    // The norm of the inverse is a lower bound of the smallest singular value.
    if 1.0 / inverse.norm() < MIN_SINGULAR_VALUE {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn point(angle_deg: f64, length_mm: f64) -> CirclePoint {
        CirclePoint {
            angle_deg,
            length_mm,
            sigma_mm: None,
            t_s: None,
            temp_c: None,
            axes_deg: None,
            drives: None,
        }
    }

    /// A joint turns where its step changes the sign; steps below 1e-3 degrees are rest.
    #[test]
    fn a_joint_reverses_where_its_steps_change_their_sign() {
        let second = [10.0, 11.0, 12.0, 12.0005, 11.0, 10.0, 11.0];
        let points = second.iter().enumerate().map(|(at, deg)| CirclePoint {
            axes_deg: Some([0.0, *deg, at as f64, 0.0, 0.0, -5.0]),
            ..point(350.0 + 10.0 * at as f64, 100.0)
        });
        let trace = CircleTrace { run: "7".into(), sense: CircleSense::Clockwise, points: points.collect() };
        let found = reversals(&[trace]);
        let places: Vec<(usize, f64)> = found.iter().map(|found| (found.joint, found.angle_deg)).collect();
        // Between 380 and 390 degrees, and from 400 on.
        assert_eq!(places, [(2, 20.0), (2, 40.0)]);
        assert_eq!((found[0].run.as_str(), found[0].sense), ("7", CircleSense::Clockwise));
    }

    /// A drive stops half of its backlash short: -b / 2 times its sense times its lever.
    #[test]
    fn backlash_of_two_linear_axes_is_recovered_beside_the_form() {
        let [first, second] = [0.012, -0.005];
        let trace = |sense: CircleSense| {
            let turn = if sense == CircleSense::CounterClockwise { 1.0 } else { -1.0 };
            let points = (0..72).map(|at| {
                let theta = (turn * (5.0 * f64::from(at) + 2.5)).to_radians();
                let (sin, cos) = theta.sin_cos();
                let form = 0.01 + 0.02 * (2.0 * theta).sin() - 0.004 * (3.0 * theta).cos() + 0.03 * cos;
                let steps =
                    -0.5 * first * (-sin * turn).signum() * cos - 0.5 * second * (cos * turn).signum() * sin;
                point(theta.to_degrees(), 150.0 + form + steps)
            });
            CircleTrace { run: "1".into(), sense, points: points.collect() }
        };
        let traces = [trace(CircleSense::CounterClockwise), trace(CircleSense::Clockwise)];
        let found = backlash(&traces, &RadialTraces::new(&traces, 150.0));
        assert_eq!(
            found.iter().map(|found| found.mover).collect::<Vec<_>>(),
            [DriveId::Axis(1), DriveId::Axis(2)]
        );
        // The largest lever is cos 2.5 degrees.
        for (found, play) in found.iter().zip([first, second]) {
            assert!((found.play - play).abs() < 1e-10 && found.u95 < 1e-10, "{found:?}");
            assert!((found.most_mm - play.abs() * 2.5f64.to_radians().cos()).abs() < 1e-9);
        }
        assert!(backlash(&[], &RadialTraces::new(&[], 150.0)).is_empty());
    }

    /// The form cancels in the difference of the senses: -b times the lever times the sense, and the drift between the
    /// passes.
    #[test]
    fn backlash_of_a_joint_is_recovered_from_both_senses() {
        let (play, drift) = (4e-4, 0.003);
        let trace = |sense: CircleSense| {
            let turn = if sense == CircleSense::CounterClockwise { 1 } else { -1 };
            let points = (0..40).map(|at| {
                let lever_mm = 100.0 + 5.0 * f64::from(at);
                let moves = if at < 20 { turn } else { -turn };
                let still = DriveState { lever_mm: 50.0, sense: 0 };
                let mut drives = [still; 6];
                drives[2] = DriveState { lever_mm, sense: moves };
                let form = 0.05 * (7.0 * f64::from(at)).sin();
                let step = -0.5 * play * f64::from(moves) * lever_mm;
                CirclePoint {
                    axes_deg: Some([f64::from(at); 6]),
                    drives: Some(drives),
                    ..point(9.0 * f64::from(at), 150.0 + form + step + if turn < 0 { drift } else { 0.0 })
                }
            });
            CircleTrace { run: "1".into(), sense, points: points.collect() }
        };
        let traces = [trace(CircleSense::CounterClockwise), trace(CircleSense::Clockwise)];
        let found = backlash(&traces, &RadialTraces::new(&traces, 150.0));
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].mover, DriveId::Joint(3));
        assert!((found[0].play - play).abs() < 1e-12 && found[0].u95 < 1e-11, "{found:?}");
        assert!((found[0].most_mm - play * 295.0).abs() < 1e-9);
    }

    /// numpy.linalg.lstsq of five rows of three unknowns; variance = residuals / (5 - 3), covariance = inv(X'X).
    #[test]
    fn least_squares_match_numpy() {
        let x = [1.0, 2.0, 0.0, 0.0, 1.0, -1.0, 3.0, 0.5, 2.0, 1.0, -1.0, 4.0, 2.0, 2.0, 1.0];
        let matrix = DMatrix::from_row_slice(5, 3, &x);
        let values = DVector::from_row_slice(&[1.0, 2.0, -1.0, 0.5, 3.0]);
        let (solved, covariance, variance) = solve(matrix.clone(), values).unwrap();
        for (value, expected) in
            solved.iter().zip([-1.061570247933885, 1.7033057851239686, 0.779338842975207])
        {
            assert!((value - expected).abs() < 1e-12, "{value} for {expected}");
        }
        assert!((variance - 3.9179752066115694 / 2.0).abs() < 1e-12);
        assert!((covariance * matrix.transpose() * &matrix - DMatrix::identity(3, 3)).norm() < 1e-12);
        let dependent = DMatrix::from_row_slice(3, 2, &[1.0, 2.0, 2.0, 4.0, 3.0, 6.0]);
        assert!(solve(dependent, DVector::zeros(3)).is_none());
        assert!(solve(DMatrix::zeros(3, 1), DVector::zeros(3)).is_none());
    }

    #[test]
    fn levers_of_linear_axes_are_the_direction_of_the_point() {
        use std::f64::consts::FRAC_PI_6;
        // At 30 degrees, counter-clockwise: x falls, y rises.
        let [x, y] = linear(FRAC_PI_6, CircleSense::CounterClockwise)[..] else { panic!() };
        assert!((x.lever_mm - 0.75f64.sqrt()).abs() < 1e-15 && (y.lever_mm - 0.5).abs() < 1e-15);
        assert_eq!((x.sense, y.sense), (-1, 1));
        let senses = |theta| linear(theta, CircleSense::Clockwise).into_iter().map(|state| state.sense);
        assert!(senses(FRAC_PI_6).eq([1, -1]) && senses(7.0 * FRAC_PI_6).eq([-1, 1]));
    }
}
