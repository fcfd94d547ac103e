//! Least-squares circle with exact distances. Removing the centre linearly would leave e^2 / (2 R) of a set-up error e
//! in the data.

use nalgebra::{Matrix3, Vector3};

/// A programmed point relative to the programmed centre, and the length measured there, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadialMeasurement {
    pub point: [f64; 2],
    pub length_mm: f64,
}

/// The least-squares circle: length = |point - centre| + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedCircle {
    /// The base ball relative to the programmed centre, mm.
    pub centre: [f64; 2],
    /// Mean radial deviation, mm.
    pub offset_mm: f64,
    /// Condition number of the three columns, each scaled to unit norm.
    pub condition: f64,
    /// Covariance of centre and offset for lengths of unit variance.
    pub covariance: Matrix3<f64>,
}

impl RadialMeasurement {
    /// Distance from `centre` to the programmed point, mm, and the unit vector there.
    #[inline]
    pub fn reach(&self, centre: [f64; 2]) -> (f64, [f64; 2]) {
        let (x, y) = (self.point[0] - centre[0], self.point[1] - centre[1]);
        // `hypot` guards against overflow, which does not occur here, and is several times slower.
        let reach = (x * x + y * y).sqrt();
        (reach, [x / reach, y / reach])
    }

    /// Length less the distance from `centre`, mm.
    #[inline]
    pub fn deviation(&self, centre: [f64; 2]) -> f64 {
        self.length_mm - self.reach(centre).0
    }
}

/// Largest number of Gauss-Newton steps.
const MAX_GAUSS_NEWTON_STEPS: usize = 20;

/// Fits centre and offset by Gauss-Newton from the programmed centre. `None` if the points do not determine them (fewer
/// than three directions) or the iteration does not converge.
pub fn fit_circle(rays: impl Iterator<Item = RadialMeasurement> + Clone) -> Option<FittedCircle> {
    let mut centre = [0.0; 2];
    for _ in 0..MAX_GAUSS_NEWTON_STEPS {
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for ray in rays.clone() {
            let (reach, [x, y]) = ray.reach(centre);
            let row = Vector3::new(-x, -y, 1.0);
            normal += row * row.transpose();
            right += row * (ray.length_mm - reach);
        }
        let covariance = normal.try_inverse()?;
        let solved = covariance * right;
        // One refinement removes the rounding error of the inverse.
        let step = solved + covariance * (right - normal * solved);
        centre = [centre[0] + step[0], centre[1] + step[1]];
        let moved = step[0].hypot(step[1]);
        if !moved.is_finite() {
            return None;
        }
        if moved < 1e-11 {
            return Some(FittedCircle {
                centre,
                offset_mm: step[2],
                condition: condition(&normal)?,
                covariance,
            });
        }
    }
    None
}

fn condition(normal: &Matrix3<f64>) -> Option<f64> {
    let scale = normal.diagonal().map(f64::sqrt);
    let scaled = Matrix3::from_fn(|i, j| normal[(i, j)] / (scale[i] * scale[j]));
    let values = scaled.symmetric_eigenvalues();
    let (least, most) = (values.min(), values.max());
    let condition = (most / least).sqrt();
    (least > 0.0 && condition.is_finite()).then_some(condition)
}
