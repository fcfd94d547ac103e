//! The length at a moment of a motion, by a parabola through the samples around it.

use crate::recording::dwell::{DwellReading, ResidualScatter, least_u_mm};
use crate::recording::stream::SampleStream;

/// The reading as the robot passed a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PassingReading {
    /// `u_mm` is that of the parabola at the point, with the effective number of samples as for a dwell.
    pub(super) reading: DwellReading,
    pub(super) slope_mm_s: f64,
    /// Effective number of samples.
    pub(super) effective: f64,
}

/// Least-squares fit of y = a + b x + c x^2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parabola {
    coefficients: nalgebra::Vector3<f64>,
    inverse: nalgebra::Matrix3<f64>,
}

impl Parabola {
    pub(super) fn value(&self) -> f64 {
        self.coefficients[0]
    }

    fn at(&self, x: f64) -> f64 {
        self.coefficients[0] + x * (self.coefficients[1] + x * self.coefficients[2])
    }
}

/// Fits points with |x| <= 1; `None` if they are too few, or all on one side.
pub(super) fn parabola(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<Parabola> {
    let (first, last) = points
        .clone()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (x, _)| (low.min(x), high.max(x)));
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
    if count < MIN_PASSING_SAMPLES || first > -MIN_SIDE_SHARE || last < MIN_SIDE_SHARE {
        return None;
    }
    let inverse = nalgebra::Matrix3::from_fn(|i, j| powers[i + j]).try_inverse()?;
    let mut coefficients = inverse * nalgebra::Vector3::from(products);
    coefficients[0] += origin;
    Some(Parabola { coefficients, inverse })
}

/// Least number of samples.
const MIN_PASSING_SAMPLES: usize = 6;
/// Least share of the window on each side of the point.
const MIN_SIDE_SHARE: f64 = 0.5;

/// The reading at `at_s` by the samples within `half_s`.
pub(super) fn passing(stream: &SampleStream, at_s: f64, half_s: f64) -> Option<PassingReading> {
    let range = stream.at(at_s - half_s)..stream.at(at_s + half_s);
    let valid: Vec<(f64, f64)> = range
        .clone()
        .filter(|&at| stream.valid(at))
        .map(|at| ((stream.t_s[at] - at_s) / half_s, stream.reading_mm[at]))
        .collect();
    let parabola = parabola(valid.iter().copied())?;
    let ResidualScatter { squares, correlation } =
        ResidualScatter::of(valid.iter().map(|(x, y)| y - parabola.at(*x)));
    let count = valid.len() as f64;
    let variance = squares / (count - 3.0) * (1.0 + correlation) / (1.0 - correlation);
    let reading = DwellReading {
        from_s: at_s - half_s,
        to_s: at_s + half_s,
        reading_mm: parabola.value(),
        u_mm: (variance * parabola.inverse[(0, 0)]).sqrt().max(least_u_mm()),
        samples: valid.len(),
        invalid: range.len() - valid.len(),
        gaps: range.skip(1).filter(|&at| stream.gap_before(at)).count(),
        creep_mm: None,
    };
    let slope_mm_s = parabola.coefficients[1] / half_s;
    let effective = count * (1.0 - correlation) / (1.0 + correlation);
    Some(PassingReading { reading, slope_mm_s, effective })
}
