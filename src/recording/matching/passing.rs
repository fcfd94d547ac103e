//! The length at a moment of a motion: all samples around it, by a parabola.

use crate::recording::dwell::{DwellReading, Scatter, least_u_mm};
use crate::recording::stream::Stream;

/// What was read as the robot passed a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Passing {
    /// `u_mm` is that of the parabola's value at the point, with the effective number of samples as for a dwell.
    pub(super) reading: DwellReading,
    /// Change of the reading there, mm/s.
    pub(super) slope_mm_s: f64,
}

/// Fewer samples determine no parabola.
const LEAST_SAMPLES: usize = 6;
/// A side of the point on which less than this share of the window was read is too little.
const LEAST_SHARE: f64 = 0.5;

/// The reading at `at_s` by the samples no more than `half_s` away.
pub(super) fn passing(stream: &Stream, at_s: f64, half_s: f64) -> Option<Passing> {
    let range = stream.at(at_s - half_s)..stream.at(at_s + half_s);
    let valid: Vec<(f64, f64)> = range
        .clone()
        .filter(|&at| stream.valid(at))
        .map(|at| ((stream.t_s[at] - at_s) / half_s, stream.reading_mm[at]))
        .collect();
    let (first, last) = (valid.first()?, valid.last()?);
    if valid.len() < LEAST_SAMPLES || first.0 > -LEAST_SHARE || last.0 < LEAST_SHARE {
        return None;
    }
    let origin = first.1;
    // Normal equations of y = a + b x + c x^2, with |x| <= 1.
    let (mut powers, mut products) = ([0.0; 5], [0.0; 3]);
    for (x, y) in &valid {
        let mut power = 1.0;
        for (at, sum) in powers.iter_mut().enumerate() {
            *sum += power;
            if let Some(product) = products.get_mut(at) {
                *product += power * (y - origin);
            }
            power *= x;
        }
    }
    let normal = nalgebra::Matrix3::from_fn(|i, j| powers[i + j]);
    let inverse = normal.try_inverse()?;
    let parabola = inverse * nalgebra::Vector3::from(products);
    let residual = |(x, y): &(f64, f64)| y - origin - parabola[0] - x * (parabola[1] + x * parabola[2]);
    let Scatter { squares, correlation } = Scatter::of(valid.iter().map(residual));
    let count = valid.len() as f64;
    let variance = squares / (count - 3.0) * (1.0 + correlation) / (1.0 - correlation);
    let reading = DwellReading {
        from_s: at_s - half_s,
        to_s: at_s + half_s,
        reading_mm: origin + parabola[0],
        u_mm: (variance * inverse[(0, 0)]).sqrt().max(least_u_mm()),
        samples: valid.len(),
        invalid: range.len() - valid.len(),
        gaps: range.skip(1).filter(|&at| stream.gap_before(at)).count(),
        creep_mm: None,
    };
    Some(Passing { reading, slope_mm_s: parabola[1] / half_s })
}
