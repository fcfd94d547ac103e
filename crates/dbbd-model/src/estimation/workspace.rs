//! The position of the tool ball over a workspace: its Jacobian, and the size of its errors.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, DVectorViewMut, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::ball_motion::BallMotion;
use crate::math::aligned_distances;
use crate::robot::{
    AXES, Approach, AxesAtPose, Geometry, JointSinCos, KinematicChain, ParamId, PayloadId, Robot,
};

/// Position error of the tool ball over a workspace for many drawn robots, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// Mean over robots and poses.
    pub mean: f64,
    /// 95th percentile over robots and poses.
    pub p95: f64,
    /// 95th percentile over the robots of the largest error over the poses; never below `p95`.
    pub max: f64,
}

/// The Jacobian of the tool ball at the poses of a workspace, for designs. What is predicted there, `Positions` says.
pub struct Workspace {
    ids: Vec<ParamId>,
    jacobian: DMatrix<f64>,
}

impl Workspace {
    /// `count` axis vectors (rad), uniform within the robot's limits, from `seed`.
    pub fn uniform(robot: &Robot, count: usize, seed: u64) -> Vec<[f64; AXES]> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut draw = || {
            let mut axes_deg = [0.0; AXES];
            for i in 0..AXES {
                let [low, high] = robot.limits_at_deg(&axes_deg)[i];
                axes_deg[i] = random.random_range(low..high);
            }
            axes_deg.map(f64::to_radians)
        };
        (0..count).map(|_| draw()).collect()
    }

    /// The Jacobian by `ids` at `poses` (axis angles, rad).
    pub fn new(geometry: &Geometry, poses: &[[f64; AXES]], ids: &[ParamId]) -> Self {
        let mut jacobian = DMatrix::zeros(3 * poses.len(), ids.len());
        let chain = KinematicChain::new(geometry);
        let position = |(at, axes): (usize, &[f64; AXES])| {
            chain.ball_jacobian(axes, ids, |column, derivative| {
                jacobian.fixed_view_mut::<3, 1>(3 * at, column).copy_from(&derivative);
            })
        };
        let positions: Vec<Vector3<f64>> = poses.iter().enumerate().map(position).collect();
        Self::aligned(&positions, ids, jacobian)
    }

    /// The Jacobian by `ids`, then by the coefficients of the joint errors.
    pub fn with_joint_errors(geometry: &Geometry, poses: &[[f64; AXES]], ids: &[ParamId]) -> Self {
        let poses: Vec<_> = poses.iter().map(|axes| (*axes, Approach::default())).collect();
        let BallMotion { jacobian, balls, .. } = BallMotion::new(geometry, &poses, ids);
        Self::aligned(&balls, ids, jacobian)
    }

    fn aligned(positions: &[Vector3<f64>], ids: &[ParamId], mut jacobian: DMatrix<f64>) -> Self {
        take_out_rigid_motion(&mut jacobian, positions);
        Self { ids: ids.to_vec(), jacobian }
    }

    /// The Jacobian: three rows for each pose, a column for each parameter, without rigid motions of all poses.
    pub fn jacobian(&self) -> &DMatrix<f64> {
        &self.jacobian
    }

    /// The parameters of the columns.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }
}

impl ErrorSummary {
    /// The summary of displacements (3 rows for each pose, a column for each robot, mm).
    pub fn of(displacements: &DMatrix<f64>) -> Self {
        let mut sizes = Vec::with_capacity(displacements.len() / 3);
        let mut largest = Vec::with_capacity(displacements.ncols());
        for column in displacements.column_iter() {
            let at = |pose: usize| column.fixed_rows::<3>(3 * pose).norm();
            let first = sizes.len();
            sizes.extend((0..displacements.nrows() / 3).map(at));
            largest.push(sizes[first..].iter().copied().fold(0.0, f64::max));
        }
        if sizes.is_empty() {
            return Self::default();
        }
        let mean = sizes.iter().sum::<f64>() / sizes.len() as f64;
        Self { mean, p95: percentile_95(&mut sizes), max: percentile_95(&mut largest) }
    }
}

fn percentile_95(values: &mut [f64]) -> f64 {
    let rank = ((values.len() as f64 * 0.95) as usize).min(values.len() - 1);
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// Projects the six rigid motions of the positions out of the columns.
pub(super) fn take_out_rigid_motion(jacobian: &mut DMatrix<f64>, positions: &[Vector3<f64>]) {
    take_out_rigid_motion_of(jacobian, positions, 0..positions.len());
}

/// Removes from each column the rigid motion that fits best to the displacements of the positions in the datum.
pub(super) fn take_out_rigid_motion_of(
    jacobian: &mut DMatrix<f64>,
    positions: &[Vector3<f64>],
    datum: Range<usize>,
) {
    let Some(fitted) = positions.get(datum.clone()).filter(|fitted| !fitted.is_empty()) else { return };
    let centroid = fitted.iter().sum::<Vector3<f64>>() / fitted.len() as f64;
    let mut rigid = DMatrix::zeros(3 * positions.len(), 6);
    for (at, position) in positions.iter().enumerate() {
        for axis in 0..3 {
            let unit = Vector3::ith(axis, 1.0);
            rigid.fixed_view_mut::<3, 1>(3 * at, axis).copy_from(&unit);
            let rotation = unit.cross(&(position - centroid));
            rigid.fixed_view_mut::<3, 1>(3 * at, 3 + axis).copy_from(&rotation);
        }
    }
    // Motions that are orthonormal over the datum. Collinear positions have fewer than six independent ones.
    let (first, rows) = (3 * datum.start, 3 * datum.len());
    let mut motions: Vec<DVector<f64>> = Vec::with_capacity(6);
    let remove = |motions: &[DVector<f64>], mut column: DVectorViewMut<'_, f64>| {
        for motion in motions {
            let share = motion.rows(first, rows).dot(&column.rows(first, rows));
            column.axpy(-share, motion, 1.0);
        }
    };
    for column in rigid.column_iter() {
        let (mut motion, size) = (column.into_owned(), column.rows(first, rows).norm());
        // Twice: once leaves rounding errors of nearly dependent motions.
        remove(&motions, motion.as_view_mut());
        remove(&motions, motion.as_view_mut());
        let norm = motion.rows(first, rows).norm();
        if norm > 1e-9 * size {
            motions.push(motion / norm);
        }
    }
    for column in jacobian.column_iter_mut() {
        remove(&motions, column);
    }
}

/// The error of a simpler model of a robot: the distance of its tool ball from the robot's over the workspace, after
/// the best rigid alignment, mm. Backlash is taken along the way from pose to pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SimplifiedModelError {
    pub mean_mm: f64,
    pub max_mm: f64,
}

impl SimplifiedModelError {
    const POSES: usize = 2000;
    const SEED: u64 = 1;

    /// The error of the DH table alone, without compliance and joint errors. `None` if the robot has neither.
    pub fn of(robot: &Robot) -> Option<Self> {
        let table = robot.geometry.rigid();
        (table != robot.geometry).then(|| Self::by(robot, &table))
    }

    /// The error of another geometry with the same tool ball.
    pub fn by(robot: &Robot, model: &Geometry) -> Self {
        let poses = Workspace::uniform(robot.controller(), Self::POSES, Self::SEED);
        let balls = |geometry: &Geometry| -> Vec<Vector3<f64>> {
            let chain = KinematicChain::new(geometry);
            let approached = poses.iter().zip(Approach::along(poses.iter().copied()));
            let ball = |(axes, approach): (&[f64; AXES], Approach)| {
                chain.ball(&AxesAtPose {
                    axes,
                    sin_cos: &JointSinCos::of(axes),
                    approach,
                    target: &geometry.tool,
                    payload: PayloadId::FIRST,
                })
            };
            approached.map(ball).collect()
        };
        let off = aligned_distances(&balls(&robot.geometry), &balls(model));
        let max_mm = off.iter().copied().fold(0.0, f64::max);
        Self { mean_mm: off.iter().sum::<f64>() / off.len() as f64, max_mm }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::result::MapPoint;
    use crate::robot::{Coordinate, Joint};

    fn robot() -> Robot {
        Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()
    }

    /// Displacements of 5, 1 mm of one robot at two poses, and of 2, 10 mm of another.
    fn displacements() -> DMatrix<f64> {
        DMatrix::from_columns(&[
            nalgebra::DVector::from_row_slice(&[3.0, 4.0, 0.0, 0.0, 0.0, 1.0]),
            nalgebra::DVector::from_row_slice(&[0.0, 0.0, 2.0, 6.0, 8.0, 0.0]),
        ])
    }

    #[test]
    fn summary_of_displacements() {
        let found = ErrorSummary::of(&displacements());
        // (5 + 1 + 2 + 10) / 4; the fourth of four, and the second of the largest 5 and 10.
        assert_eq!((found.mean, found.p95, found.max), (4.5, 10.0, 10.0));
        assert_eq!(ErrorSummary::of(&DMatrix::zeros(0, 0)), ErrorSummary::default());
    }

    /// The rank of the 95th percentile of 1..100 counts from 0: 95 of them are smaller.
    #[test]
    fn percentile_of_a_hundred() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(percentile_95(&mut values), 96.0);
        assert_eq!(percentile_95(&mut [7.0]), 7.0);
    }

    /// sqrt((5^2 + 2^2) / 2) and sqrt((1^2 + 10^2) / 2).
    #[test]
    fn map_is_the_rms_over_the_robots() {
        let rms: Vec<f64> = MapPoint::map(&[Vector3::zeros(); 2], &displacements())
            .iter()
            .map(|point| point.rms_mm)
            .collect();
        assert!((rms[0] - 14.5f64.sqrt()).abs() < 1e-14 && (rms[1] - 50.5f64.sqrt()).abs() < 1e-14);
    }

    #[test]
    fn rigid_motions_are_taken_out_and_a_scale_stays() {
        let positions: Vec<Vector3<f64>> = (0..8)
            .map(|at| Vector3::from_fn(|axis, _| 500.0 + 300.0 * ((at * 3 + axis) as f64 * 1.7).sin()))
            .collect();
        let centroid = positions.iter().sum::<Vector3<f64>>() / 8.0;
        let rows = |motion: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| -> Vec<f64> {
            positions
                .iter()
                .flat_map(|position| motion(position).iter().copied().collect::<Vec<_>>())
                .collect()
        };
        // A screw about an axis that does not pass through the centroid, and a uniform scale about the centroid.
        let screw = rows(&|p| Vector3::new(0.1, -0.2, 0.3).cross(p) + Vector3::new(4.0, 5.0, 6.0));
        let scale = rows(&|p| p - centroid);
        let mut jacobian = DMatrix::from_column_slice(24, 2, &[screw, scale.clone()].concat());
        take_out_rigid_motion(&mut jacobian, &positions);
        assert!(jacobian.column(0).norm() < 1e-9);
        // A scale about the centroid is orthogonal to all rigid motions.
        let scale = nalgebra::DVector::from_vec(scale);
        assert!((jacobian.column(1) - &scale).norm() < 1e-9 * scale.norm());
    }

    /// A screw that the datum shares is removed from all positions; a screw of the other positions alone stays.
    #[test]
    fn the_motion_of_the_datum_is_taken_out_everywhere() {
        let place =
            |at: usize| Vector3::from_fn(|axis, _| 500.0 + 300.0 * ((at * 3 + axis) as f64 * 1.7).sin());
        let positions: Vec<Vector3<f64>> = (0..10).map(place).collect();
        let screw = |p: &Vector3<f64>| Vector3::new(0.1, -0.2, 0.3).cross(p) + Vector3::new(4.0, 5.0, 6.0);
        let of = |from: usize| -> Vec<f64> {
            let moved = positions.iter().enumerate();
            let moved = moved.map(|(at, p)| if at >= from { screw(p) } else { Vector3::zeros() });
            moved.flat_map(<[f64; 3]>::from).collect()
        };
        let mut jacobian = DMatrix::from_column_slice(30, 2, &[of(0), of(2)].concat());
        take_out_rigid_motion_of(&mut jacobian, &positions, 2..10);
        assert!(jacobian.column(0).norm() < 1e-9, "{}", jacobian.column(0).norm());
        // The first two positions did not move, and now move against the screw.
        let first = jacobian.fixed_view::<3, 1>(0, 1).into_owned();
        assert!((first + screw(&positions[0])).norm() < 1e-9);
        assert!(jacobian.view((6, 1), (24, 1)).norm() < 1e-9);
    }

    /// The first row of the table moves the whole robot.
    #[test]
    fn parameters_of_the_first_row_move_no_ball_against_another() {
        let robot = robot();
        let poses = Workspace::uniform(&robot, 30, 1);
        let ids = [
            ParamId::Alpha(Joint::J1),
            ParamId::A(Joint::J1),
            ParamId::Theta(Joint::J1),
            ParamId::D(Joint::J1),
            ParamId::A(Joint::J2),
            ParamId::Tool(Coordinate::X),
        ];
        let workspace = Workspace::new(&robot.geometry, &poses, &ids);
        let sizes: Vec<f64> = workspace.jacobian().column_iter().map(|column| column.norm()).collect();
        // A radian moves the ball by up to two metres.
        assert!(sizes[..4].iter().all(|size| *size < 1e-6), "{sizes:?}");
        assert!(sizes[4..].iter().all(|size| *size > 1.0), "{sizes:?}");
        assert_eq!(workspace.ids(), ids);
    }

    #[test]
    fn poses_are_within_the_limits_and_repeat_with_their_seed() {
        let robot = robot();
        let poses = Workspace::uniform(&robot, 200, 7);
        assert_eq!(poses, Workspace::uniform(&robot, 200, 7));
        assert_ne!(poses, Workspace::uniform(&robot, 200, 8));
        let limits = robot.limits_at_deg(&[0.0; AXES]);
        for axis in 0..AXES {
            let [low, high] = limits[axis].map(f64::to_radians);
            let angles = || poses.iter().map(|pose| pose[axis]);
            assert!(angles().all(|angle| (low..=high).contains(&angle)), "{axis}");
            // 200 draws leave less than a tenth of the range open at each end.
            let tenth = 0.1 * (high - low);
            assert!(angles().any(|angle| angle < low + tenth) && angles().any(|angle| angle > high - tenth));
        }
    }

    #[test]
    fn table_alone_leaves_nothing_out() {
        let mut robot = robot();
        assert_eq!(SimplifiedModelError::of(&robot), None);
        robot.geometry.gear[1] = [1e-3, 0.0];
        // A milliradian about the second axis moves the ball by at most its reach of about two metres.
        let SimplifiedModelError { mean_mm, max_mm } = SimplifiedModelError::of(&robot).unwrap();
        assert!((1e-3..max_mm).contains(&mean_mm) && max_mm < 2.5, "{mean_mm} {max_mm}");
    }

    /// A base that is elsewhere is taken out; a forearm that is 1 mm longer moves a ball near the wrist by a millimetre in a direction
    /// that changes from pose to pose.
    #[test]
    fn another_table_leaves_out_its_difference() {
        let robot = robot();
        let mut model = robot.geometry.clone();
        model.rows[0].d += 7.0;
        model.rows[0].theta += 0.1;
        assert!(SimplifiedModelError::by(&robot, &model).max_mm < 1e-7);
        model.rows[3].d += 1.0;
        let SimplifiedModelError { mean_mm, max_mm } = SimplifiedModelError::by(&robot, &model);
        assert!((0.5..1.0).contains(&mean_mm) && (mean_mm..1.5).contains(&max_mm), "{mean_mm} {max_mm}");
    }
}
