//! The rigid motion that best fits one set of points to another.

use nalgebra::{DMatrix, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use super::svd;

/// The rigid motion `to = rotation * from + shift`.
#[derive(Clone, Copy, Debug)]
pub struct RigidAlignment {
    pub rotation: Rotation3<f64>,
    /// The shift, in the unit of the points.
    pub shift: Vector3<f64>,
    /// The scale factor about the centroid that least squares would add to the motion. The motion does not contain it.
    pub scale: f64,
    /// RMS residual of motion and scale, relative to the RMS distance of the target points from their centroid.
    pub(crate) misfit: f64,
}

impl RigidAlignment {
    /// The least-squares motion of `from` to `to`, which correspond pairwise: Horn, "Closed-form solution of absolute
    /// orientation using unit quaternions", J. Opt. Soc. Am. A 4, 1987. `None` if a number is not finite or all points of
    /// a set coincide.
    pub fn of(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Self> {
        let count = from.len().min(to.len()) as f64;
        let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / count;
        let [a, b] = [mean(from), mean(to)];
        let extent = |points: &[Vector3<f64>], mean: Vector3<f64>| -> f64 {
            points.iter().map(|point| (point - mean).norm_squared()).sum()
        };
        let [of_from, of_to] = [extent(from, a), extent(to, b)];
        if !(of_from * of_to > 0.0 && (of_from * of_to).is_finite()) {
            return None;
        }
        let pairs = || from.iter().zip(to).map(|(from, to)| (from - a, to - b));
        let s = pairs().fold(Matrix3::zeros(), |sum, (from, to)| sum + from * to.transpose());
        let rotation = Rotation3::from(rotation(&s)?);
        let along: f64 = pairs().map(|(from, to)| to.dot(&(rotation * from))).sum();
        Some(Self {
            rotation,
            shift: b - rotation * a,
            scale: along / of_from,
            misfit: (1.0 - along * along / (of_from * of_to)).max(0.0).sqrt(),
        })
    }

    pub fn apply(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.shift
    }
}

/// Horn's quaternion for the sum of outer products `s`: the eigenvector of a symmetric 4 x 4 matrix with the largest
/// eigenvalue.
fn rotation(s: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let (trace, axial) = (s.trace(), [s.m23 - s.m32, s.m31 - s.m13, s.m12 - s.m21]);
    let symmetric = s + s.transpose() - Matrix3::identity() * trace;
    // With this shift all eigenvalues are positive, so that they are the singular values.
    let shift = 3.0 * s.norm();
    let matrix = DMatrix::from_fn(4, 4, |i, j| {
        let own = match (i, j) {
            (0, 0) => trace,
            (0, k) | (k, 0) => axial[k - 1],
            _ => symmetric[(i - 1, j - 1)],
        };
        if i == j { own + shift } else { own }
    });
    let largest = svd(&matrix)?.v.column(0).into_owned();
    Some(UnitQuaternion::from_quaternion(Quaternion::new(largest[0], largest[1], largest[2], largest[3])))
}

/// Pairwise distances between `measured` and the best rigid motion of `model`, in their unit; NaN if a coordinate is NaN.
pub fn aligned_distances(measured: &[Vector3<f64>], model: &[Vector3<f64>]) -> Vec<f64> {
    aligned_differences(measured, model).iter().map(Vector3::norm).collect()
}

/// `measured` minus the best rigid motion of `model`, in their unit; NaN if a coordinate is NaN.
pub fn aligned_differences(measured: &[Vector3<f64>], model: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let pairs = measured.iter().zip(model);
    match RigidAlignment::of(model, measured) {
        Some(motion) => pairs.map(|(to, from)| to - motion.apply(from)).collect(),
        None => {
            let [to, from] =
                [measured, model].map(|set| set.iter().sum::<Vector3<f64>>() / set.len().max(1) as f64);
            pairs.map(|(a, b)| (a - to) - (b - from)).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rigidly_moved_copy_aligns_exactly() {
        let points: Vec<Vector3<f64>> =
            (0..20).map(|i| Vector3::new(f64::from(i % 4), f64::from(i % 7), f64::from(i)) * 100.0).collect();
        for turn in [Vector3::new(0.02, -0.03, 0.05), Vector3::new(2.0, -1.5, 1.0), Vector3::zeros()] {
            let turn = Rotation3::new(turn);
            let move_one = |p: &Vector3<f64>| turn * p + Vector3::new(5.0, -9000.0, 2.0);
            let moved: Vec<Vector3<f64>> = points.iter().map(move_one).collect();
            let largest = aligned_distances(&moved, &points).into_iter().fold(0.0, f64::max);
            assert!(largest < 1e-9, "{largest}");
            let metres: Vec<Vector3<f64>> = moved.iter().map(|point| point * 1e-3).collect();
            let found = RigidAlignment::of(&metres, &points).unwrap();
            assert!((found.scale - 1e3).abs() < 1e-6 && found.misfit < 1e-6, "{found:?}");
        }
        assert!(aligned_distances(&points[..1], &points[1..2]).iter().all(|distance| *distance == 0.0));
    }

    /// Umeyama's method by numpy.linalg.svd, IEEE Trans. Pattern Anal. 13, 1991.
    #[test]
    fn motion_scale_and_misfit_match_the_solution_by_singular_values() {
        let from = [[0., 0., 0.], [100., 0., 0.], [0., 200., 0.], [0., 0., 300.], [50., 80., 20.]];
        let to = [
            [11.0, 20.0, -5.0],
            [91.946858, 59.985782, 40.32051],
            [-95.248412, 191.041131, 31.661952],
            [-80.442439, -93.68505, 263.317423],
            [2.364568, 102.21034, 50.029531],
        ];
        let [from, to] = [from, to].map(|points| points.map(Vector3::from));
        let found = RigidAlignment::of(&from, &to).unwrap();
        let turn = Vector3::new(0.3010161338802957, -0.4031713677539118, 0.49974785506329183);
        let shift = Vector3::new(9.888703591859066, 20.898264544875524, -3.5070143311814235);
        assert!((found.rotation.scaled_axis() - turn).norm() < 1e-12);
        assert!((found.shift - shift).norm() < 1e-9, "{}", found.shift);
        assert!((found.scale - 1.018880895519757).abs() < 1e-12);
        assert!((found.misfit - 0.005451204542220778).abs() < 1e-10);
        let distances = aligned_distances(&to, &from);
        assert!((distances[3] - (to[3] - found.apply(&from[3])).norm()).abs() < 1e-12);
    }

    #[test]
    fn coinciding_points_have_no_motion_but_distances_from_their_mean() {
        let same = [Vector3::new(1.0, 2.0, 3.0); 2];
        let apart = [Vector3::new(0.0, 0.0, 0.0), Vector3::new(0.0, 6.0, 0.0)];
        assert!(RigidAlignment::of(&same, &apart).is_none());
        assert_eq!(aligned_distances(&apart, &same), [3.0, 3.0]);
    }
}
