//! Rows of lengths by parameters and coefficients of the joints' errors, whitened pose by pose.
//!
//! The lengths of one pose share its repeatability: with U the unit vectors along them their covariance is
//! s^2 U U', plus what joints that are off their angles do to them, plus what each length has of its own. Coordinates of a
//! position are lengths along the axes of the tracker.

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

/// The noise of rows; what a pose and its joints are off moves the lengths to all balls.
pub(super) struct RowNoise {
    /// Standard deviation of a pose in each direction.
    pub(super) pose: f64,
    /// Of each row beside it.
    pub(super) own: Vec<f64>,
    /// Of the joints' angles at each row, rad.
    pub(super) joints: Vec<[f64; AXES]>,
}

impl RowNoise {
    /// Of independent rows with these standard deviations.
    pub(super) fn independent(own: Vec<f64>) -> Self {
        Self { pose: 0.0, joints: vec![[0.0; AXES]; own.len()], own }
    }

    /// So many times as large.
    pub(super) fn times(self, factor: f64) -> Self {
        Self {
            pose: factor * self.pose,
            own: self.own.into_iter().map(|sd| factor * sd).collect(),
            joints: self.joints.into_iter().map(|joints| joints.map(|sd| factor * sd)).collect(),
        }
    }
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
/// And of its variance beside the pose at least this share is its own.
const LEAST_OWN: f64 = 0.01;

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
    /// The senses in which the joints came.
    pub(super) senses: Vec<[i8; AXES]>,
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
            senses: lines.iter().map(|line| geometry.coupling.senses(line.approach).senses()).collect(),
            approaches: lines.iter().map(|line| line.approach).collect(),
            levers: lines.iter().map(|line| line.levers).collect(),
            poses: poses.into_values().collect(),
        }
    }

    /// The noise of the rows of a robot at `model`. The scatter of lengths contains backlash of unknown sense: it is taken out
    /// of what each length has of its own.
    pub(super) fn noise(&self, noise: &LengthNoise<'_>, model: &LengthModel) -> RowNoise {
        let backlash = noise.joints.map_or([0.0; AXES], |unknown| unknown.unapproached_rad);
        let own = |row: usize| {
            let moves = (0..AXES).filter(|joint| self.senses[row][*joint] == 0);
            let moved: f64 = moves.map(|joint| (self.levers[row][joint] * backlash[joint]).powi(2)).sum();
            (noise.length_mm.powi(2) - moved).max(LEAST_OWN * noise.length_mm.powi(2)).sqrt()
        };
        let unknown = |row: usize| {
            noise.joints.map_or([0.0; AXES], |unknown| {
                beside(&model.geometry, unknown, &self.axes[row], self.approaches[row])
            })
        };
        let rows = self.values.nrows();
        RowNoise {
            pose: noise.pose_mm,
            own: (0..rows).map(own).collect(),
            joints: (0..rows).map(unknown).collect(),
        }
    }

    /// Root of the mean variance of the rows.
    pub(super) fn rms_sd(&self, noise: &RowNoise) -> f64 {
        let of = |row: usize| {
            let joints = noise.joints[row].iter().zip(self.levers[row]);
            let joints: f64 = joints.map(|(sd, lever)| (sd * lever).powi(2)).sum();
            noise.pose.powi(2) + noise.own[row].powi(2) + joints
        };
        let rows = self.levers.len();
        ((0..rows).map(of).sum::<f64>() / rows as f64).sqrt()
    }

    /// Brings rows to unit noise; the logarithm of the determinant of their covariance. `None` where it has no inverse.
    pub(super) fn whiten(&self, whole: &mut DMatrix<f64>, noise: &RowNoise) -> Option<f64> {
        let mut ln_determinant = 0.0;
        for rows in &self.poses {
            ln_determinant += self.whiten_pose(whole, rows, noise)?;
        }
        Some(ln_determinant)
    }

    fn whiten_pose(&self, whole: &mut DMatrix<f64>, rows: &[usize], noise: &RowNoise) -> Option<f64> {
        let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let [u, v] = [rows[i], rows[j]].map(|row| self.units[row]);
            let mut shared = (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * (noise.pose * noise.pose);
            let [u, v] = [rows[i], rows[j]].map(|row| self.levers[row]);
            for (joint, sd) in noise.joints[rows[i]].iter().enumerate() {
                shared += u[joint] * v[joint] * sd * sd;
            }
            let own = if i == j { noise.own[rows[i]].powi(2) } else { 0.0 };
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
