//! Design rows: the derivatives of lengths by parameters and by coefficients of the joints' errors, whitened pose by
//! pose.
//!
//! The lengths of one visit to a pose share the repeatability s of the pose: with U the unit vectors along the lengths,
//! their covariance is s^2 U U', plus a part from the random errors of the joints' angles, plus the independent noise
//! of each length. Coordinates of a position are lengths along the axes of the tracker.

use nalgebra::{Cholesky, DMatrix, DVector, Dim, Dyn, Matrix, StorageMut};

use super::linear_system::Rows;
use super::position::RemainingErrors;
use crate::math::Triangle;
use crate::measurement::{LengthModel, MeasurementPieces, PreparedMeasurement};
use crate::robot::{AXES, Approach, Coordinate, Datum, Joint, ParamId, RobotUncertainty};

/// The noise of a length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthNoise<'a> {
    /// Standard deviation of the pose in each direction, mm; all lengths at the pose share this error.
    pub pose_mm: f64,
    /// Standard deviation of the independent noise of a length, mm.
    pub length_mm: f64,
    /// The uncertainty of the robot: errors of its joints that the coefficients do not describe add to the noise.
    pub joints: Option<&'a RobotUncertainty>,
}

/// The noise of rows, in mm and rad, or all of it divided by sigma. The errors of a pose and of its joints act on the
/// lengths to all balls.
pub(super) struct RowNoise {
    /// Standard deviation of a pose in each direction.
    pub(super) pose: f64,
    /// Standard deviation of the independent noise of each row.
    pub(super) own: Vec<f64>,
    /// Standard deviations of the joints' angles at each row.
    pub(super) joints: Vec<[f64; AXES]>,
}

impl From<f64> for LengthNoise<'_> {
    /// The noise of independent lengths with this standard deviation, mm.
    fn from(sigma_mm: f64) -> Self {
        Self { pose_mm: 0.0, length_mm: sigma_mm, joints: None }
    }
}

impl<'a> LengthNoise<'a> {
    /// The noise of lengths with this standard deviation (mm), for a robot with the uncertainty `joints`. What the lengths of
    /// a visit shared in the identification is not their own: the pose and its joints have it again. The error of the pose is
    /// no larger than what is shared, although the robot's file foresees more at poses that are unlike the measured ones.
    pub fn of(sigma_mm: f64, joints: Option<&'a RobotUncertainty>) -> Self {
        let pose_mm = joints.map_or(0.0, |joints| joints.pose_mm);
        let shared_mm = joints.and_then(|joints| joints.shared_mm).unwrap_or(pose_mm);
        let variance = sigma_mm.powi(2);
        let own = (variance - shared_mm.powi(2)).max(MIN_OWN * variance);
        Self { pose_mm: pose_mm.min((variance - own).sqrt()), length_mm: own.sqrt(), joints }
    }

    /// The degrees of freedom of a t-distribution of all lengths together whose sum of squares scatters as much as that of visits
    /// which are t-distributed one by one; `None` for normal errors. With v degrees of freedom the sum of n squares has the
    /// variance 2 n + 2 n (n + 2) / (v - 4).
    pub(crate) fn degrees_of_freedom_together(
        self,
        model: &LengthModel,
        readings: &[PreparedMeasurement],
    ) -> Option<f64> {
        let of_visit = self.joints?.visit_degrees_of_freedom?;
        let unit = vec![1.0; readings.len()];
        let visits = PoseRows::at(model, &(readings, unit.as_slice()), &[], |_| None).poses;
        let excess = |count: usize| (count * (count + 2)) as f64;
        let of_visits: f64 = visits.iter().map(|visit| excess(visit.len())).sum();
        Some(4.0 + (of_visit - 4.0) * excess(readings.len()) / of_visits)
    }

    /// Standard deviation of a length, mm.
    pub fn sigma_mm(self) -> f64 {
        self.pose_mm.hypot(self.length_mm)
    }
}

/// Least share of the independent noise in the variance of a length.
const MIN_OWN: f64 = 0.01;

/// Design rows at a model.
#[derive(Clone)]
pub(super) struct PoseRows {
    /// A row for each length, a column for each unknown: parameters, then coefficients; mm per unit.
    pub(super) values: DMatrix<f64>,
    /// Measured minus predicted, mm.
    pub(super) residual: DVector<f64>,
    pub(super) lengths: Vec<LengthAtPose>,
    /// The rows of each visit to a pose.
    pub(super) poses: Vec<Vec<usize>>,
}

/// The length of a row, its pose, and its derivatives.
#[derive(Clone)]
pub(super) struct LengthAtPose {
    /// Place of the length among all lengths.
    pub(super) place: usize,
    pub(super) datum: Datum,
    /// Unit vector along the length.
    pub(super) unit: [f64; 3],
    /// Axis angles (rad) with the sense of approach.
    axes: [f64; AXES],
    approach: Approach,
    /// The joints' own angles (rad), their senses of approach, and the derivatives of the length by these angles,
    /// mm/rad.
    pub(super) joints: [f64; AXES],
    pub(super) senses: [i8; AXES],
    pub(super) by_joint: [f64; AXES],
    /// Derivative of the length by a relative growth of all links, mm.
    pub(super) growth: f64,
    /// Derivatives of the length by a displacement of the target on the tool, mm per mm.
    pub(super) target: [f64; 3],
}

/// The rows of a piece of the lengths.
#[derive(Default)]
struct Made {
    /// Row after row.
    values: Vec<f64>,
    residual: Vec<f64>,
    lengths: Vec<LengthAtPose>,
}

/// The rows of each visit to a pose, in the order of poses and visits. A second length to the same ball belongs to another
/// visit.
fn visits(lengths: &[LengthAtPose], time: impl Fn(usize) -> Option<f64>) -> Vec<Vec<usize>> {
    let pose = |row: &LengthAtPose| {
        (row.axes.map(f64::to_bits), row.approach.senses(), time(row.place).map(f64::to_bits))
    };
    let mut sorted: Vec<usize> = (0..lengths.len()).collect();
    sorted.sort_by_key(|at| pose(&lengths[*at]));
    let mut visits: Vec<Vec<usize>> = Vec::with_capacity(lengths.len());
    for of_pose in sorted.chunk_by(|one, other| pose(&lengths[*one]) == pose(&lengths[*other])) {
        let first = visits.len();
        for at in of_pose {
            let has_room =
                |visit: &Vec<usize>| visit.iter().all(|own| lengths[*own].datum != lengths[*at].datum);
            match visits[first..].iter_mut().find(|visit| has_room(visit)) {
                Some(visit) => visit.push(*at),
                None => visits.push(vec![*at]),
            }
        }
    }
    visits
}

impl PoseRows {
    /// The rows of lengths with a standard deviation of 1 mm; lengths with an infinite standard deviation are left out.
    pub(super) fn at<L: MeasurementPieces + ?Sized>(
        model: &LengthModel,
        lengths: &L,
        ids: &[ParamId],
        time: impl Fn(usize) -> Option<f64>,
    ) -> Self {
        let geometry = &model.geometry;
        let (own, further) = (ids.len(), geometry.joint_errors.count());
        let links =
            [ParamId::A, ParamId::D].into_iter().flat_map(|of: fn(Joint) -> ParamId| Joint::ALL.map(of));
        let links: Vec<(ParamId, f64)> = links.map(|id| (id, model.value(id))).collect();
        let pieces = Rows { model, ids, further }.fold(lengths, Made::default, |made: &mut Made, row| {
            if row.weight == 0.0 {
                return;
            }
            let (reading, by) = (row.reading, row.derivatives);
            by.joint_terms(geometry, &reading.axes, reading.approach, &mut row.values[own..]);
            let length = LengthAtPose {
                place: row.place,
                datum: reading.datum,
                unit: by.unit().into(),
                axes: reading.axes,
                approach: reading.approach,
                joints: geometry.coupling.joints(&reading.axes),
                senses: geometry.coupling.senses(reading.approach).senses(),
                by_joint: Joint::ALL.map(|joint| by.derivative(ParamId::Theta(joint))),
                target: Coordinate::ALL.map(|axis| by.derivative(ParamId::Tool(axis))),
                growth: links.iter().map(|(id, mm)| by.derivative(*id) * mm).sum(),
            };
            made.values.extend_from_slice(row.values);
            made.residual.push(row.residual);
            made.lengths.push(length);
        });
        let mut whole = Made::default();
        for piece in pieces {
            whole.values.extend(piece.values);
            whole.residual.extend(piece.residual);
            whole.lengths.extend(piece.lengths);
        }
        let Made { values, residual, lengths } = whole;
        Self {
            values: DMatrix::from_row_slice(lengths.len(), own + further, &values),
            residual: residual.into(),
            poses: visits(&lengths, time),
            lengths,
        }
    }

    /// Whether the noise of a pose and the independent noise of its lengths can be separated: more than a tenth of the
    /// poses have several lengths in directions that are not orthogonal. (The coordinates of a position are
    /// orthogonal.)
    pub(super) fn tell_noise_apart(&self) -> bool {
        /// Cosine of the angle between two lengths.
        const OBLIQUE: f64 = 0.02;
        let is_oblique = |rows: &Vec<usize>| {
            let pairs = rows
                .iter()
                .enumerate()
                .flat_map(|(at, one)| rows[..at].iter().map(move |other| (*one, *other)));
            pairs.into_iter().any(|(one, other)| {
                let cosine: f64 =
                    (0..3).map(|k| self.lengths[one].unit[k] * self.lengths[other].unit[k]).sum();
                cosine.abs() > OBLIQUE
            })
        };
        let oblique = self.poses.iter().filter(|rows| is_oblique(rows)).count();
        10 * oblique > self.poses.len()
    }

    /// The noise of the rows of a robot at `model`. Where it is not known what the lengths of a visit share, their standard
    /// deviation is a mean over the rows that contains the random errors of the joints and backlash of unknown sense. Their
    /// mean variance is then subtracted from the independent noise of the lengths that they move.
    pub(super) fn noise(&self, noise: &LengthNoise<'_>, model: &LengthModel) -> RowNoise {
        let rows = self.values.nrows();
        let unshared = noise.joints.filter(|unknown| unknown.shared_mm.is_none());
        let moved = |row: usize| -> f64 {
            let LengthAtPose { senses, by_joint, .. } = &self.lengths[row];
            let sds = unshared.map_or([0.0; AXES], |unknown| unknown.of_visit(*senses));
            sds.iter().zip(by_joint).map(|(sd, by_angle)| (sd * by_angle).powi(2)).sum()
        };
        let moved: Vec<f64> = (0..rows).map(moved).collect();
        let count = moved.iter().filter(|moved| **moved > 0.0).count();
        let mean_moved = moved.iter().sum::<f64>() / count.max(1) as f64;
        let variance = noise.length_mm.powi(2);
        let scattered = (variance - mean_moved).max(MIN_OWN * variance).sqrt();
        let own = moved.iter().map(|moved| if *moved > 0.0 { scattered } else { noise.length_mm }).collect();
        let remaining = noise.joints.map(|unknown| RemainingErrors::new(&model.geometry, unknown));
        let of_joints = |row: usize| {
            let sds = |remaining: &RemainingErrors| {
                remaining.sds(&model.geometry, &self.lengths[row].axes, self.lengths[row].approach)
            };
            remaining.as_ref().map_or([0.0; AXES], sds)
        };
        RowNoise { pose: noise.pose_mm, own, joints: (0..rows).map(of_joints).collect() }
    }

    /// Root of the mean variance of the rows.
    pub(super) fn rms_sd(&self, noise: &RowNoise) -> f64 {
        let of = |row: usize| {
            let joints = noise.joints[row].iter().zip(self.lengths[row].by_joint);
            let joints: f64 = joints.map(|(sd, by_angle)| (sd * by_angle).powi(2)).sum();
            noise.pose.powi(2) + noise.own[row].powi(2) + joints
        };
        let rows = self.lengths.len();
        ((0..rows).map(of).sum::<f64>() / rows as f64).sqrt()
    }

    /// The transformation of these rows to unit noise. `None` if their covariance has no inverse.
    pub(super) fn whitening(&self, noise: &RowNoise) -> Option<Whitening> {
        let covariance = |i: usize, j: usize| {
            let [u, v] = [i, j].map(|row| self.lengths[row].unit);
            let mut shared = (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * (noise.pose * noise.pose);
            let [u, v] = [i, j].map(|row| self.lengths[row].by_joint);
            for (joint, sd) in noise.joints[i].iter().enumerate() {
                shared += u[joint] * v[joint] * sd * sd;
            }
            let own = if i == j { noise.own[i].powi(2) } else { 0.0 };
            shared + own
        };
        let factor = |rows: &Vec<usize>| match rows.as_slice() {
            [row] => {
                let variance = covariance(*row, *row);
                (variance > 0.0).then(|| VisitFactor::Alone(*row, variance.sqrt()))
            }
            rows => {
                let covariance =
                    DMatrix::from_fn(rows.len(), rows.len(), |i, j| covariance(rows[i], rows[j]));
                Some(VisitFactor::Together(rows.to_vec(), Cholesky::new(covariance)?.unpack()))
            }
        };
        Some(Whitening { visits: self.poses.iter().map(factor).collect::<Option<_>>()? })
    }
}

/// The transformation to unit noise, visit by visit.
pub(super) struct Whitening {
    visits: Vec<VisitFactor>,
}

/// The Cholesky factor of the covariance of a visit's rows.
enum VisitFactor {
    /// A visit with one length, and its standard deviation.
    Alone(usize, f64),
    Together(Vec<usize>, DMatrix<f64>),
}

impl VisitFactor {
    fn rows(&self) -> &[usize] {
        match self {
            Self::Alone(row, _) => std::slice::from_ref(row),
            Self::Together(rows, _) => rows,
        }
    }

    fn factor(&self) -> DMatrix<f64> {
        match self {
            Self::Alone(_, sd) => DMatrix::from_element(1, 1, *sd),
            Self::Together(_, factor) => factor.clone(),
        }
    }

    /// The inverse of the factor.
    fn inverse(&self) -> DMatrix<f64> {
        match self {
            Self::Alone(_, sd) => DMatrix::from_element(1, 1, sd.recip()),
            Self::Together(rows, factor) => {
                let identity = DMatrix::identity(rows.len(), rows.len());
                factor.solve_lower_triangular(&identity).unwrap_or(identity)
            }
        }
    }
}

impl Whitening {
    /// Brings rows to unit noise.
    pub(super) fn apply<C: Dim, S: StorageMut<f64, Dyn, C>>(&self, matrix: &mut Matrix<f64, Dyn, C, S>) {
        for mut column in matrix.column_iter_mut() {
            for visit in &self.visits {
                match visit {
                    VisitFactor::Alone(row, sd) => column[*row] /= sd,
                    VisitFactor::Together(rows, factor) => {
                        for i in 0..rows.len() {
                            let before: f64 = (0..i).map(|j| factor[(i, j)] * column[rows[j]]).sum();
                            column[rows[i]] = (column[rows[i]] - before) / factor[(i, i)];
                        }
                    }
                }
            }
        }
    }

    /// Multiplies by the transpose of the transformation to unit noise.
    pub(super) fn apply_transpose<C: Dim, S: StorageMut<f64, Dyn, C>>(
        &self,
        matrix: &mut Matrix<f64, Dyn, C, S>,
    ) {
        for mut column in matrix.column_iter_mut() {
            for visit in &self.visits {
                match visit {
                    VisitFactor::Alone(row, sd) => column[*row] /= sd,
                    VisitFactor::Together(rows, factor) => {
                        for i in (0..rows.len()).rev() {
                            let behind: f64 =
                                (i + 1..rows.len()).map(|j| factor[(j, i)] * column[rows[j]]).sum();
                            column[rows[i]] = (column[rows[i]] - behind) / factor[(i, i)];
                        }
                    }
                }
            }
        }
    }

    /// Of each visit its rows, with the lower Cholesky factor of the covariance.
    pub(super) fn factors(&self) -> impl Iterator<Item = (&[usize], DMatrix<f64>)> {
        self.visits.iter().map(|visit| (visit.rows(), visit.factor()))
    }

    /// The inverse of the covariance: of each visit its rows, with their matrix.
    pub(super) fn weights(&self) -> impl Iterator<Item = (&[usize], DMatrix<f64>)> {
        self.visits.iter().map(|visit| {
            let inverse = visit.inverse();
            (visit.rows(), inverse.tr_mul(&inverse))
        })
    }

    /// The inverse of the Cholesky factor of a visit's covariance.
    pub(super) fn inverse_factor(&self, visit: usize) -> DMatrix<f64> {
        self.visits[visit].inverse()
    }

    /// The logarithm of the determinant of the covariance of all rows.
    pub(super) fn ln_determinant(&self) -> f64 {
        let of_visit = |visit: &VisitFactor| match visit {
            VisitFactor::Alone(_, sd) => 2.0 * sd.ln(),
            VisitFactor::Together(_, factor) => 2.0 * factor.diagonal().map(f64::ln).sum(),
        };
        self.visits.iter().map(of_visit).sum()
    }
}

/// As [`linear_system()`](super::linear_system()), by `ids` and then by the coefficients of the joint errors, with noise that the lengths of a pose
/// share. `None` if the covariance of the noise is singular.
pub(super) fn linear_system_by_pose(
    model: &LengthModel,
    readings: &[PreparedMeasurement],
    noise: LengthNoise<'_>,
    ids: &[ParamId],
) -> Option<Triangle> {
    let unit = vec![1.0; readings.len()];
    let lines = PoseRows::at(model, &(readings, unit.as_slice()), ids, |_| None);
    let unknowns = lines.values.ncols();
    let mut rows = lines.values.clone().insert_column(unknowns, 0.0);
    rows.set_column(unknowns, &lines.residual);
    lines.whitening(&lines.noise(&noise, model))?.apply(&mut rows);
    let mut triangle = Triangle::new(unknowns);
    for row in rows.row_iter() {
        let values: Vec<f64> = row.iter().copied().collect();
        triangle.push(&values[..unknowns], values[unknowns]);
    }
    Some(triangle)
}

#[cfg(test)]
mod tests {
    use super::super::linear_system::factor;
    use super::super::tests::cell_of_poses::{model, readings};
    use super::*;
    use crate::measurement::{PreparedMeasurement, Tracker};
    use crate::robot::BallId;

    fn rows(model: &LengthModel, readings: &[PreparedMeasurement], times: &[f64]) -> PoseRows {
        let unit = vec![1.0; readings.len()];
        PoseRows::at(model, &(readings, unit.as_slice()), &[], |place| times.get(place).copied())
    }

    /// The visits, by their first rows.
    fn visits(model: &LengthModel, readings: &[PreparedMeasurement], times: &[f64]) -> Vec<Vec<usize>> {
        let mut visits = rows(model, readings, times).poses;
        visits.sort();
        visits
    }

    /// A length of 13 um of which the lengths of a visit shared 12 um has 5 um of its own, whatever is assumed of new poses.
    #[test]
    fn own_noise_is_what_the_lengths_of_a_visit_did_not_share() {
        let robot = crate::robot::Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let unknown = |shared_mm| RobotUncertainty { pose_mm: 0.014, shared_mm, ..robot.known_uncertainty() };
        let of = |sigma_mm, shared_mm| {
            let unknown = unknown(shared_mm);
            let noise = LengthNoise::of(sigma_mm, Some(&unknown));
            (noise.pose_mm, noise.length_mm)
        };
        let near = |found: (f64, f64), [pose_mm, length_mm]: [f64; 2]| {
            let off = (found.0 - pose_mm).abs().max((found.1 - length_mm).abs());
            assert!(off < 1e-12, "{found:?}, not {pose_mm} {length_mm}");
        };
        near(of(0.013, Some(0.012)), [0.012, 0.005]);
        near(of(0.017, Some(0.015)), [0.014, 0.008]);
        // Without a statement the pose is shared; a tenth of the length's noise is always its own.
        near(of(0.0175, None), [0.014, 0.0105]);
        near(of(0.013, None), [0.013 * 0.99f64.sqrt(), 0.0013]);
        assert_eq!(
            LengthNoise::of(0.013, None),
            LengthNoise { pose_mm: 0.0, length_mm: 0.013, joints: None }
        );
    }

    /// One visit of three lengths has the freedom of the visit; 24 such visits 4 + (10 - 4) (72 74) / (24 15).
    #[test]
    fn visits_together_are_more_normal_than_each() {
        let model = model(3);
        let robot = crate::robot::Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let tails = |visit_degrees_of_freedom, count: usize| {
            let unknown = RobotUncertainty { visit_degrees_of_freedom, ..robot.known_uncertainty() };
            LengthNoise::of(0.01, Some(&unknown))
                .degrees_of_freedom_together(&model, &readings(&model, count, 1))
        };
        assert_eq!(tails(None, 24), None);
        assert!((tails(Some(10.0), 1).unwrap() - 10.0).abs() < 1e-12);
        assert!((tails(Some(10.0), 24).unwrap() - 92.8).abs() < 1e-9);
    }

    #[test]
    fn a_visit_has_one_length_to_each_ball_at_one_time() {
        let model = model(3);
        let (one, other) = ([0.1, -1.0, 1.5, 0.0, 1.0, 0.0], [0.2, -1.0, 1.5, 0.0, 1.0, 0.0]);
        let to = |axes: [f64; AXES], ball: usize| PreparedMeasurement::new(axes, BallId::at(ball), 300.0);
        let mut all = vec![to(one, 0), to(one, 1), to(one, 2), to(one, 0), to(other, 0), to(one, 1)];
        assert_eq!(visits(&model, &all, &[]), [vec![0, 1, 2], vec![3, 5], vec![4]]);
        // At other times they are other visits.
        assert_eq!(
            visits(&model, &all, &[0.0, 0.0, 0.5, 0.6, 0.7, 0.6]),
            [vec![0, 1], vec![2], vec![3, 5], vec![4]]
        );
        // An axis that came from the other side is at another place.
        all[1].approach = Approach::new([1, 0, 0, 0, 0, 0]);
        assert_eq!(visits(&model, &all[..3], &[]), [vec![0, 2], vec![1]]);
    }

    #[test]
    fn noise_is_told_apart_by_several_lengths_of_a_pose_that_are_not_orthogonal() {
        let of_balls = |balls: usize| {
            let model = model(balls);
            rows(&model, &readings(&model, 12, 1), &[]).tell_noise_apart()
        };
        assert_eq!([1, 2, 3].map(of_balls), [false, true, true]);
        // Coordinates of a position are orthogonal.
        let origin = nalgebra::Vector3::new(2500.0, 300.0, 100.0);
        let tracker = Tracker { origin, turn: nalgebra::Vector3::new(0.3, -0.2, 0.9) };
        let model = LengthModel { tracker: Some(tracker), ..model(1) };
        let planes = |reading: PreparedMeasurement| {
            let mut planes = [reading; 3];
            planes.iter_mut().zip(Coordinate::ALL).for_each(|(row, axis)| row.datum = Datum::Plane(axis));
            planes
        };
        let positions: Vec<PreparedMeasurement> =
            readings(&model, 12, 1).into_iter().flat_map(planes).collect();
        let rows = rows(&model, &positions, &[]);
        assert!(rows.poses.iter().all(|pose| pose.len() == 3));
        assert!(!rows.tell_noise_apart());
        // Rows of one visit in ten are too few.
        let model = super::super::tests::cell_of_poses::model(3);
        let three = readings(&model, 21, 1);
        let few = |with_three: usize| {
            let is_kept = |at: &usize| at.is_multiple_of(3) || at / 3 < with_three;
            let some: Vec<PreparedMeasurement> =
                (0..three.len()).filter(is_kept).map(|at| three[at]).collect();
            self::rows(&model, &some, &[]).tell_noise_apart()
        };
        assert_eq!([2, 3].map(few), [false, true]);
    }

    #[test]
    fn independent_noise_by_pose_is_that_of_the_lengths() {
        let model = model(3);
        let readings = readings(&model, 12, 1);
        let ids = [ParamId::Theta(Joint::J2), ParamId::A(Joint::J2)];
        let sigma = vec![0.5; readings.len()];
        let expected = factor(&model, &(readings.as_slice(), sigma.as_slice()), &ids);
        let found = linear_system_by_pose(&model, &readings, 0.5.into(), &ids).unwrap().factor();
        assert!((found.tr_mul(&found) - expected.tr_mul(&expected)).norm() < 1e-9 * expected.norm_squared());
    }
}
