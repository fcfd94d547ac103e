//! Poses that can be reached under all limits, many of them, for the choice of a few.

use nalgebra::{DMatrix, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::estimation::expected::Expected;
use crate::estimation::{Posterior, Workspace};
use crate::robot::inverse::{branches, status, turns_within};
use crate::robot::{AXES, BallId, Geometry, Pose, Robot};

/// Poses drawn at most for each candidate wanted.
const PATIENCE: u32 = 30;

/// A pose that may be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    pub ball: BallId,
    /// The controller's axis angles, rad, full turns included.
    pub axes: [f64; AXES],
    /// The tool ball.
    pub pose: Pose,
}

/// Orientations of the tool near one.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    pub orientation: Matrix3<f64>,
    /// How far half of the poses are turned from it at most, rad, all angles alike; at 0 all poses have it.
    pub angle_rad: f64,
}

impl Near {
    /// Half of the poses as much as 40 degrees from it.
    pub fn about(orientation: Matrix3<f64>) -> Self {
        Self { orientation, angle_rad: 0.7 }
    }

    /// That orientation alone.
    pub fn exactly(orientation: Matrix3<f64>) -> Self {
        Self { orientation, angle_rad: 0.0 }
    }
}

/// The sphere about a base ball on which the tool ball is, and the arm that takes it there.
#[derive(Clone, Copy)]
pub struct Sphere<'a> {
    pub arm: &'a Geometry,
    /// Whose limits hold.
    pub controller: &'a Robot,
    pub id: BallId,
    pub ball: Vector3<f64>,
    pub radius_mm: f64,
    /// Near which orientation of the tool; all alike where there is none.
    pub near: Option<&'a Near>,
}

impl Sphere<'_> {
    /// Poses in all directions that `allows` lets pass, all in the one branch of the arm that has most.
    pub fn candidates(
        &self,
        count: usize,
        seed: u64,
        allows: impl Fn(&[f64; AXES]) -> bool,
    ) -> Vec<Candidate> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut by_branch: [Vec<Candidate>; 8] = Default::default();
        let mut left = PATIENCE.saturating_mul(u32::try_from(count).unwrap_or(u32::MAX));
        while left > 0 && by_branch.iter().all(|found| found.len() < count) {
            left -= 1;
            let pose = self.draw(&mut random, left.is_multiple_of(2));
            for axes in branches(self.arm, &pose).unwrap_or_default() {
                let turned = turns_within(&axes, self.controller)
                    .into_iter()
                    .min_by(|a, b| largest(a).total_cmp(&largest(b)));
                if let Some(axes) = turned.filter(|axes| allows(axes)) {
                    let branch = usize::from(status(self.arm, &axes) & 7);
                    by_branch[branch].push(Candidate { ball: self.id, axes, pose });
                }
            }
        }
        let mut most = by_branch.into_iter().max_by_key(Vec::len).unwrap_or_default();
        most.truncate(count);
        // In no order, so that a part of them is as good a sample as all.
        for i in (1..most.len()).rev() {
            most.swap(i, random.random_range(0..=i));
        }
        most
    }

    /// A pose in any direction; near the orientation given, if there is one and this is of that half.
    fn draw(&self, random: &mut Pcg64, half: bool) -> Pose {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        let direction = Vector3::new(normal(), normal(), normal()).normalize();
        let axis = Vector3::new(normal(), normal(), normal());
        let turn = Quaternion::new(axis.x, axis.y, axis.z, normal());
        let rotation = match self.near {
            Some(near) if near.angle_rad <= 0.0 => near.orientation,
            Some(near) if half => {
                let angle = random.random_range(0.0..near.angle_rad);
                near.orientation * Rotation3::from_scaled_axis(axis.normalize() * angle).matrix()
            }
            _ => *UnitQuaternion::from_quaternion(turn).to_rotation_matrix().matrix(),
        };
        Pose { rotation, position: self.ball + direction * self.radius_mm }
    }
}

/// The greatest axis angle, rad.
pub(crate) fn largest(axes: &[f64; AXES]) -> f64 {
    axes.iter().map(|angle| angle.abs()).fold(0.0, f64::max)
}

/// The design rows of candidates as an exchange takes them: a column each, in the coordinates of the prior, over sigma.
pub fn design_rows(posterior: &Posterior, candidates: &[Candidate], sigma_mm: f64) -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(posterior.root().ncols(), candidates.len());
    for (mut column, candidate) in rows.column_iter_mut().zip(candidates) {
        let row = posterior.design_row(&candidate.axes, candidate.ball);
        column.copy_from(&(row / sigma_mm));
    }
    rows
}

/// The effects of changes of the usual size as an exchange takes them: a column a candidate, over sigma.
pub fn change_rows(expected: &Expected, candidates: &[Candidate], sigma_mm: f64) -> DMatrix<f64> {
    let columns: Vec<_> = candidates
        .iter()
        .map(|candidate| expected.effects(&candidate.axes, candidate.ball) / sigma_mm)
        .collect();
    DMatrix::from_columns(&columns)
}

/// The Jacobian of the tool ball over a workspace, in the coordinates of the prior, three rows a pose.
pub fn workspace_rows(posterior: &Posterior, poses: &[[f64; AXES]]) -> DMatrix<f64> {
    Workspace::new(&posterior.model.geometry, poses, posterior.ids()).jacobian() * posterior.root()
}
