//! Rows of lengths by parameters and coefficients of the joints' errors, whitened pose by pose.
//!
//! The lengths of one pose share its repeatability: with U the unit vectors along them their covariance is
//! s^2 U U' plus what each length has of its own. Coordinates of a position are lengths along the axes of the tracker.

use std::collections::BTreeMap;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::linear_system::Rows;
use super::position::beside;
use crate::measurement::{LengthModel, MeasurementPieces};
use crate::robot::{AXES, Approach, Joint, ParamId, RobotUncertainty};

/// The noise of a length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthNoise<'a> {
    /// Standard deviation of the pose in each direction, which its lengths share, mm.
    pub pose_mm: f64,
    /// Standard deviation of a length beside it, mm.
    pub length_mm: f64,
    /// What is not known of the joints beside the coefficients of their errors: it adds to the noise.
    pub joints: Option<&'a RobotUncertainty>,
}

impl From<f64> for LengthNoise<'_> {
    /// Of independent lengths with this standard deviation, mm.
    fn from(sigma_mm: f64) -> Self {
        Self { pose_mm: 0.0, length_mm: sigma_mm, joints: None }
    }
}

impl<'a> LengthNoise<'a> {
    /// Of lengths with this standard deviation (mm) of a robot of which this is not known.
    pub fn of(sigma_mm: f64, joints: Option<&'a RobotUncertainty>) -> Self {
        let of_pose = |joints: &RobotUncertainty| joints.pose_mm.min(MOST_OF_POSE * sigma_mm);
        let pose_mm = joints.map_or(0.0, of_pose);
        Self { pose_mm, length_mm: (sigma_mm * sigma_mm - pose_mm * pose_mm).sqrt(), joints }
    }

    /// Of a length, mm.
    pub fn sigma_mm(self) -> f64 {
        self.pose_mm.hypot(self.length_mm)
    }
}

/// A length has some noise of its own: the share of the pose is at most this.
const MOST_OF_POSE: f64 = 0.995;

/// Rows at a model.
#[derive(Clone)]
pub(super) struct PoseRows {
    /// A row a length, a column an unknown: parameters, then coefficients; mm per unit.
    pub(super) values: DMatrix<f64>,
    /// Measured minus predicted, mm.
    pub(super) residual: DVector<f64>,
    /// Places among all lengths.
    pub(super) places: Vec<usize>,
    /// Unit vectors along the lengths.
    units: Vec<[f64; 3]>,
    /// Axis angles (rad) with the sense of approach, the joints' own angles, and what these move, mm/rad.
    axes: Vec<[f64; AXES]>,
    approaches: Vec<Approach>,
    pub(super) joints: Vec<[f64; AXES]>,
    pub(super) levers: Vec<[f64; AXES]>,
    /// Rows of equal pose.
    pub(super) poses: Vec<Vec<usize>>,
}

/// A row on its way into the matrix.
struct Line {
    place: usize,
    values: Vec<f64>,
    residual: f64,
    unit: [f64; 3],
    axes: [f64; AXES],
    approach: Approach,
    levers: [f64; AXES],
}

impl PoseRows {
    /// Of lengths with a standard deviation of 1 mm; those of infinity are left out.
    pub(super) fn at<L: MeasurementPieces + ?Sized>(
        model: &LengthModel,
        lengths: &L,
        ids: &[ParamId],
    ) -> Self {
        let geometry = &model.geometry;
        let (own, further) = (ids.len(), geometry.joint_errors.count());
        let pieces = Rows { model, ids, further }.fold(lengths, Vec::new, |lines: &mut Vec<Line>, row| {
            if row.weight == 0.0 {
                return;
            }
            let (reading, by) = (row.reading, row.derivatives);
            by.joint_terms(geometry, &reading.axes, reading.approach, &mut row.values[own..]);
            lines.push(Line {
                place: row.place,
                values: row.values.to_vec(),
                residual: row.residual,
                unit: by.unit().into(),
                axes: reading.axes,
                approach: reading.approach,
                levers: Joint::ALL.map(|joint| by.derivative(ParamId::Theta(joint))),
            });
        });
        let lines: Vec<Line> = pieces.into_iter().flatten().collect();
        let mut poses: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (at, line) in lines.iter().enumerate() {
            poses.entry((line.axes.map(f64::to_bits), line.approach.senses())).or_default().push(at);
        }
        Self {
            values: DMatrix::from_fn(lines.len(), own + further, |row, column| lines[row].values[column]),
            residual: DVector::from_iterator(lines.len(), lines.iter().map(|line| line.residual)),
            places: lines.iter().map(|line| line.place).collect(),
            units: lines.iter().map(|line| line.unit).collect(),
            axes: lines.iter().map(|line| line.axes).collect(),
            joints: lines.iter().map(|line| geometry.coupling.joints(&line.axes)).collect(),
            approaches: lines.iter().map(|line| line.approach).collect(),
            levers: lines.iter().map(|line| line.levers).collect(),
            poses: poses.into_values().collect(),
        }
    }

    /// Standard deviations of what each length has of its own, mm.
    pub(super) fn own(&self, noise: &LengthNoise<'_>, model: &LengthModel) -> Vec<f64> {
        let of = |row: usize| {
            let unknown = noise.joints.map_or([0.0; AXES], |unknown| {
                beside(&model.geometry, unknown, &self.axes[row], self.approaches[row])
            });
            let moved = self.levers[row].iter().zip(unknown).map(|(lever, sd)| (lever * sd).powi(2));
            (noise.length_mm.powi(2) + moved.sum::<f64>()).sqrt()
        };
        (0..self.values.nrows()).map(of).collect()
    }

    /// Brings rows to unit noise, where a pose repeats to `pose` in each direction and each length has `own` beside it; the
    /// logarithm of the determinant of their covariance. `None` where it has no inverse.
    pub(super) fn whiten(&self, whole: &mut DMatrix<f64>, pose: f64, own: &[f64]) -> Option<f64> {
        let mut ln_determinant = 0.0;
        for rows in &self.poses {
            ln_determinant += self.whiten_pose(whole, rows, pose, own)?;
        }
        Some(ln_determinant)
    }

    fn whiten_pose(&self, whole: &mut DMatrix<f64>, rows: &[usize], pose: f64, own: &[f64]) -> Option<f64> {
        let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let [u, v] = [rows[i], rows[j]].map(|row| self.units[row]);
            let shared = (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * (pose * pose);
            let own = if i == j { own[rows[i]].powi(2) } else { 0.0 };
            shared + own
        });
        let factor = Cholesky::new(covariance)?.l();
        for mut column in whole.column_iter_mut() {
            for i in 0..rows.len() {
                let before: f64 = (0..i).map(|j| factor[(i, j)] * column[rows[j]]).sum();
                column[rows[i]] = (column[rows[i]] - before) / factor[(i, i)];
            }
        }
        Some(factor.diagonal().iter().map(|pivot| 2.0 * pivot.ln()).sum())
    }
}
