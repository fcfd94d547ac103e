//! The 3-D differences of two sets of positions after one best rigid motion.

use nalgebra::{DMatrix, Rotation3, Vector3};

use crate::math::Triangle;

/// Distances between `measured` and `model` (mm, pairwise) after the rigid motion of `model` that
/// makes their squares least. Gauss-Newton on the motion: sets that are not far from each other
/// (here a robot and its model) are aligned to rounding in a few steps.
pub fn aligned_distances(measured: &[Vector3<f64>], model: &[Vector3<f64>]) -> Vec<f64> {
    let mut moved = model.to_vec();
    for _ in 0..5 {
        let centroid = moved.iter().sum::<Vector3<f64>>() / moved.len().max(1) as f64;
        let mut equations = Triangle::new(6);
        for (to, from) in measured.iter().zip(&moved) {
            let (lever, gap) = (from - centroid, to - from);
            // A turn w moves a point by w x lever.
            let rows = DMatrix::from_row_slice(
                3,
                6,
                &[
                    1.0, 0.0, 0.0, 0.0, lever.z, -lever.y, //
                    0.0, 1.0, 0.0, -lever.z, 0.0, lever.x, //
                    0.0, 0.0, 1.0, lever.y, -lever.x, 0.0,
                ],
            );
            for axis in 0..3 {
                let row: Vec<f64> = rows.row(axis).iter().copied().collect();
                equations.push(&row, gap[axis]);
            }
        }
        // Positions on a line leave a turn about it undetermined: any will do, so none.
        for turn in 3..6 {
            equations.push_single(turn, 1e-9, 0.0);
        }
        let Some(motion) = equations.solve() else { break };
        let shift = Vector3::new(motion[0], motion[1], motion[2]);
        let turn = Rotation3::new(Vector3::new(motion[3], motion[4], motion[5]));
        for point in &mut moved {
            *point = turn * (*point - centroid) + centroid + shift;
        }
    }
    measured.iter().zip(&moved).map(|(a, b)| (a - b).norm()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moved_copy_has_no_distance() {
        let points: Vec<Vector3<f64>> =
            (0..20).map(|i| Vector3::new(f64::from(i % 4), f64::from(i % 7), f64::from(i)) * 100.0).collect();
        let turn = Rotation3::new(Vector3::new(0.02, -0.03, 0.05));
        let moved: Vec<Vector3<f64>> =
            points.iter().map(|p| turn * p + Vector3::new(5.0, -9.0, 2.0)).collect();
        let largest = aligned_distances(&moved, &points).into_iter().fold(0.0, f64::max);
        assert!(largest < 1e-9, "{largest}");
    }
}
