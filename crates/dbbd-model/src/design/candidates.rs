//! Candidate poses on a sphere about a base ball, within all limits.

use nalgebra::{DMatrix, DVector, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::conformity::expected::Expected;
use crate::estimation::{Posterior, ToolPoses};
use crate::math::stacked;
use crate::robot::inverse::{branches, status, turns_within};
use crate::robot::{AXES, BallId, Geometry, Pose, Robot};

/// Drawn poses per candidate after which the search ends.
const PATIENCE: u32 = 30;
/// Drawn poses after which the search ends if none of them is allowed: where one of so many can be reached, no run can be made.
const HOPELESS: u32 = 120_000;

#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    pub ball: BallId,
    /// The controller's axis angles, rad, including full turns.
    pub axes: [f64; AXES],
    /// Pose of the tool ball.
    pub pose: Pose,
}

/// Restricts the orientations of the tool.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    pub orientation: Matrix3<f64>,
    /// Half of the poses are rotated from the orientation by a uniform angle up to this, rad. If it is 0, all poses
    /// have the orientation.
    pub angle_rad: f64,
}

impl Near {
    /// Half of the poses within 40 degrees.
    pub fn about(orientation: Matrix3<f64>) -> Self {
        Self { orientation, angle_rad: 0.7 }
    }

    pub fn exactly(orientation: Matrix3<f64>) -> Self {
        Self { orientation, angle_rad: 0.0 }
    }
}

/// The sphere about a base ball on which the tool ball is, and the arm that moves it there.
#[derive(Clone, Copy)]
pub struct Sphere<'a> {
    pub arm: &'a Geometry,
    /// The robot with the axis limits.
    pub controller: &'a Robot,
    pub id: BallId,
    pub ball: Vector3<f64>,
    pub radius_mm: f64,
    /// Restricts the orientations; without it all orientations are equally probable.
    pub near: Option<&'a Near>,
}

impl Sphere<'_> {
    /// Poses in random directions that `allows` accepts, in random order. All are in one branch of the arm: the one with most poses.
    pub fn candidates(
        &self,
        count: usize,
        seed: u64,
        allows: impl Fn(&[f64; AXES]) -> bool,
    ) -> Vec<Candidate> {
        self.by_branch(count, seed, allows).into_iter().max_by_key(Vec::len).unwrap_or_default()
    }

    /// Poses in random directions that `allows` accepts, in random order: those of each branch of the arm, until one has `count`.
    pub fn by_branch(
        &self,
        count: usize,
        seed: u64,
        allows: impl Fn(&[f64; AXES]) -> bool,
    ) -> [Vec<Candidate>; 8] {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut by_branch: [Vec<Candidate>; 8] = Default::default();
        let mut left = PATIENCE.saturating_mul(u32::try_from(count).unwrap_or(u32::MAX));
        let hopeless = left.saturating_sub(HOPELESS);
        while left > 0 && by_branch.iter().all(|found| found.len() < count) {
            if left == hopeless && by_branch.iter().all(Vec::is_empty) {
                break;
            }
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
        for found in &mut by_branch {
            found.truncate(count);
            for i in (1..found.len()).rev() {
                found.swap(i, random.random_range(0..=i));
            }
        }
        by_branch
    }

    /// A pose in a random direction. `half` says whether it belongs to the half that [`Near::angle_rad`] restricts.
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

/// The largest axis angle in magnitude, rad.
pub fn largest(axes: &[f64; AXES]) -> f64 {
    axes.iter().map(|angle| angle.abs()).fold(0.0, f64::max)
}

/// The whitened design rows of candidates for an [`super::Exchange`]: a column each, in the coordinates of the posterior's
/// root.
pub fn design_rows(posterior: &Posterior, candidates: &[Candidate], sigma_mm: f64) -> DMatrix<f64> {
    let row = |candidate: &Candidate| posterior.design_row(&candidate.axes, candidate.ball) / sigma_mm;
    columns(posterior.root().ncols(), candidates.iter().map(row))
}

/// The whitened effects of typical changes for an [`super::Exchange`]: a column a candidate.
pub fn change_rows(expected: &Expected, candidates: &[Candidate], sigma_mm: f64) -> DMatrix<f64> {
    let effects =
        candidates.iter().map(|candidate| expected.effects(&candidate.axes, candidate.ball) / sigma_mm);
    DMatrix::from_columns(&effects.collect::<Vec<_>>())
}

/// A matrix of columns with this number of rows; without columns it is empty.
pub(super) fn columns(rows: usize, columns: impl ExactSizeIterator<Item = DVector<f64>>) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(rows, columns.len());
    matrix.column_iter_mut().zip(columns).for_each(|(mut column, values)| column.copy_from(&values));
    matrix
}

/// The Jacobian of the tool ball over a workspace, three rows a pose, in the coordinates of the posterior's root.
pub fn workspace_rows(posterior: &Posterior, poses: &[[f64; AXES]]) -> DMatrix<f64> {
    posterior.workspace(poses).jacobian() * posterior.root()
}

/// The Jacobian of tools at their poses, three rows a pose, in the coordinates of the posterior's root.
pub fn tool_rows(posterior: &Posterior, tools: &[ToolPoses]) -> DMatrix<f64> {
    let of_tool = |ToolPoses { tool_mm, poses }: &ToolPoses| match tool_mm {
        Some(tool) => workspace_rows(&posterior.with_exact_tool(tool), poses),
        None => workspace_rows(posterior, poses),
    };
    let none = DMatrix::zeros(0, posterior.root().ncols());
    tools.iter().map(of_tool).reduce(|above, below| stacked(&above, &below)).unwrap_or(none)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::cell::{CENTRE, kr60};

    /// A pose has at most eight branches.
    #[test]
    fn the_search_for_poses_that_nothing_allows_ends_early() {
        let robot = kr60();
        let (arm, controller, id) = (&robot.geometry, &robot, BallId::FIRST);
        let sphere = Sphere { arm, controller, id, ball: CENTRE.into(), radius_mm: 300.0, near: None };
        let asked = std::cell::Cell::new(0);
        let found = sphere.candidates(100_000, 1, |_| {
            asked.set(asked.get() + 1);
            false
        });
        assert!(found.is_empty() && (1..=8 * HOPELESS).contains(&asked.get()), "{}", asked.get());
    }

    /// Axes 4 and 6 of the KR 60 HA reach 350 degrees to both sides.
    #[test]
    fn an_axis_does_not_turn_further_than_it_must() {
        let robot = kr60();
        let (arm, controller, id) = (&robot.geometry, &robot, BallId::FIRST);
        let sphere = Sphere { arm, controller, id, ball: CENTRE.into(), radius_mm: 300.0, near: None };
        let found = sphere.candidates(20, 1, |_| true);
        assert_eq!(found.len(), 20);
        let turns: Vec<_> = found.iter().map(|one| (one, turns_within(&one.axes, controller))).collect();
        assert!(turns.iter().any(|(_, others)| others.len() > 1));
        for (one, others) in turns {
            assert!(others.iter().all(|other| largest(&one.axes) <= largest(other) + 1e-12), "{one:?}");
        }
    }
}
