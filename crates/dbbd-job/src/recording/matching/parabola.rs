//! A parabola through samples around a moment.

use nalgebra::{Matrix3, Vector3};

/// Least number of points.
const MIN_PARABOLA_POINTS: usize = 6;
/// Least share of the window on each side of 0.
const MIN_SIDE_SHARE: f64 = 0.5;

/// Least-squares fit of y = a + b x + c x^2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parabola {
    coefficients: Vector3<f64>,
    /// Inverse of the normal matrix.
    inverse: Matrix3<f64>,
}

impl Parabola {
    /// Fits points with |x| <= 1; `None` if they are too few, or all on one side.
    pub(super) fn through(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<Self> {
        let (first, last) = points
            .clone()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (x, _)| (low.min(x), high.max(x)));
        // The sums use differences, which keep their digits.
        let origin = points.clone().next()?.1;
        let (mut powers, mut products, mut count) = ([0.0; 5], [0.0; 3], 0);
        for (x, y) in points {
            count += 1;
            let mut power = 1.0;
            for (at, sum) in powers.iter_mut().enumerate() {
                *sum += power;
                if let Some(product) = products.get_mut(at) {
                    *product += power * (y - origin);
                }
                power *= x;
            }
        }
        if count < MIN_PARABOLA_POINTS || first > -MIN_SIDE_SHARE || last < MIN_SIDE_SHARE {
            return None;
        }
        let inverse = Matrix3::from_fn(|i, j| powers[i + j]).try_inverse()?;
        let mut coefficients = inverse * Vector3::from(products);
        coefficients[0] += origin;
        Some(Self { coefficients, inverse })
    }

    /// The value at 0.
    pub(super) fn value(&self) -> f64 {
        self.coefficients[0]
    }

    /// The slope at 0.
    pub(super) fn slope(&self) -> f64 {
        self.coefficients[1]
    }

    pub(super) fn at(&self, x: f64) -> f64 {
        self.coefficients[0] + x * (self.coefficients[1] + x * self.coefficients[2])
    }

    /// Variance of the value at 0 for points of variance 1.
    pub(super) fn value_variance(&self) -> f64 {
        self.inverse[(0, 0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = 7 - 2 x + 5 x^2 is its own fit. The sums of powers of x = -1, -0.6, .., 1 are 6, 0, 2.8, 0, 2.2624, so
    /// that the variance at 0 is 2.2624 / (6 * 2.2624 - 2.8^2).
    #[test]
    fn parabola_returns_its_coefficients() {
        let points = (0..6).map(|at| -1.0 + 0.4 * f64::from(at)).map(|x| (x, 7.0 - 2.0 * x + 5.0 * x * x));
        let fit = Parabola::through(points).unwrap();
        let off = [fit.value() - 7.0, fit.slope() + 2.0, fit.at(0.5) - 7.25, fit.at(-1.0) - 14.0];
        assert!(off.iter().all(|off| off.abs() < 1e-12), "{off:?}");
        assert!((fit.value_variance() - 2.2624 / (6.0 * 2.2624 - 2.8 * 2.8)).abs() < 1e-12);
    }

    /// Cramer's rule in exact fractions (Python's `fractions`) gives a, b, c and the variance at 0.
    #[test]
    fn parabola_is_the_least_squares_fit() {
        let points = [(-1.0, 1.2), (-0.5, 0.9), (0.0, 0.7), (0.5, 0.8), (0.75, 0.8), (1.0, 1.0)];
        let fit = Parabola::through(points.into_iter()).unwrap();
        let (value, slope, at_one, variance) =
            (0.726445971268, -0.114316052467, 0.980149906309, 0.466833229232);
        let off =
            [fit.value() - value, fit.slope() - slope, fit.at(1.0) - at_one, fit.value_variance() - variance];
        assert!(off.iter().all(|off| off.abs() < 1e-11), "{off:?}");
    }

    #[test]
    fn too_few_or_one_sided_points_give_none() {
        let at = |xs: &[f64]| Parabola::through(xs.iter().map(|x| (*x, 1.0))).is_some();
        assert!(at(&[-0.5, -0.3, -0.1, 0.1, 0.3, 0.5]));
        assert!(!at(&[-0.5, -0.3, 0.1, 0.3, 0.5]));
        assert!(!at(&[-0.49, -0.3, -0.1, 0.1, 0.3, 0.5]));
        assert!(!at(&[-0.5, -0.3, -0.1, 0.1, 0.3, 0.49]));
        assert!(Parabola::through(std::iter::empty()).is_none());
    }
}
