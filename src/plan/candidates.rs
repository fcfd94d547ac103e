//! Poses that can be reached under all limits, many of them, for the choice of a few.

use nalgebra::{DMatrix, Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::identifiability::{Belief, Workspace};
use crate::model::inverse::{branches, status, turns_within};
use crate::model::{AXES, Pose};

/// How far from an orientation the poses near it are turned at most, rad: all angles alike.
const NEAR: f64 = 0.7;
/// Poses drawn at most for each candidate wanted.
const PATIENCE: u32 = 30;

/// A pose that may be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Base ball, from 1.
    pub centre: u32,
    /// The controller's axis angles, rad, full turns included.
    pub axes: [f64; AXES],
    /// The tool ball.
    pub pose: Pose,
}

/// Poses of the tool ball on the sphere of `radius` mm about the base ball `centre` (number from 1, place in mm), in
/// all directions, that `allows` lets pass, all in the one branch of the arm that has most: in all orientations alike,
/// or, with `held`, half of them near that one. `arm` solves the axis angles within `limits_deg`.
#[allow(clippy::too_many_arguments)] // the arm, the sphere, the draw, the filter: each used once
pub fn candidates(
    arm: &crate::model::Geometry,
    limits_deg: &[[f64; 2]; AXES],
    (centre, ball): (u32, Vector3<f64>),
    radius: f64,
    held: Option<&Matrix3<f64>>,
    count: usize,
    seed: u64,
    allows: impl Fn(&[f64; AXES]) -> bool,
) -> Vec<Candidate> {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut by_branch: [Vec<Candidate>; 8] = Default::default();
    let mut left = PATIENCE.saturating_mul(u32::try_from(count).unwrap_or(u32::MAX));
    while left > 0 && by_branch.iter().all(|found| found.len() < count) {
        left -= 1;
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let direction = Vector3::new(normal(), normal(), normal()).normalize();
        let axis = Vector3::new(normal(), normal(), normal());
        let turn = nalgebra::Quaternion::new(axis.x, axis.y, axis.z, normal());
        let rotation = match held {
            Some(held) if left.is_multiple_of(2) => {
                let angle = random.random_range(0.0..NEAR);
                held * Rotation3::from_scaled_axis(axis.normalize() * angle).matrix()
            }
            _ => *UnitQuaternion::from_quaternion(turn).to_rotation_matrix().matrix(),
        };
        let pose = Pose { rotation, position: ball + direction * radius };
        for axes in branches(arm, &pose).unwrap_or_default() {
            let turned =
                turns_within(&axes, limits_deg).into_iter().min_by(|a, b| size(a).total_cmp(&size(b)));
            if let Some(axes) = turned.filter(|axes| allows(axes)) {
                let branch = usize::from(status(arm, &axes) & 7);
                by_branch[branch].push(Candidate { centre, axes, pose });
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

/// The greatest axis angle, rad.
fn size(axes: &[f64; AXES]) -> f64 {
    axes.iter().map(|angle| angle.abs()).fold(0.0, f64::max)
}

/// The candidates as an exchange takes them: a column each, in the coordinates of the belief, over sigma.
pub fn rows(belief: &Belief, candidates: &[Candidate], sigma_mm: f64) -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(belief.root().ncols(), candidates.len());
    for (mut column, candidate) in rows.column_iter_mut().zip(candidates) {
        let swing = belief.swing(&candidate.axes, candidate.centre.saturating_sub(1) as usize);
        column.copy_from(&(swing / sigma_mm));
    }
    rows
}

/// What moves over a workspace, in the coordinates of the belief, three rows a pose.
pub fn moves(belief: &Belief, poses: &[[f64; AXES]]) -> DMatrix<f64> {
    Workspace::new(&belief.model.geometry, poses, belief.ids()).jacobian() * belief.root()
}
