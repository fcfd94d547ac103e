//! Intervals at rest by the measured axes.

use std::ops::Range;

use super::track::AxisTrack;
use crate::math::robust;
use crate::robot::AXES;

/// Measured axes that stay within this are at rest, degrees; more where the encoders are noisier.
const STILL_DEG: f64 = 0.003;
/// Ratio of that to the noise of an axis.
const STILL_NOISES: f64 = 10.0;
/// A rest lasts at least so long, s.
const LEAST_S: f64 = 0.25;
/// What lies between the parts of one rest, s: a push by hand, packets that are missing.
const TORN_S: f64 = 0.12;
/// Over a longer loss of packets nobody knows where the robot was, s.
pub(crate) const LOSS_S: f64 = 0.25;

/// An interval at rest, by its samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    pub samples: Range<usize>,
    pub start_s: f64,
    pub end_s: f64,
    /// Where it rests: the commanded axes where they are known, degrees.
    pub axes_deg: [f64; AXES],
}

impl AxisTrack {
    /// The intervals at rest, in order; times are those of the track.
    pub fn rests(&self) -> Vec<Rest> {
        let still_deg = self.still_deg();
        let mut rests: Vec<Rest> = Vec::new();
        let mut first = 0;
        for at in 1..=self.len() {
            let goes_on = at < self.len()
                && self.t_s[at] - self.t_s[at - 1] <= LOSS_S
                && !self.breaks.contains(&at)
                && within(&self.measured_deg[first], &self.measured_deg[at], still_deg);
            if goes_on {
                continue;
            }
            self.add(&mut rests, first..at, still_deg);
            first = at;
        }
        rests.retain(|rest| rest.end_s - rest.start_s >= LEAST_S);
        rests
    }

    /// Adds a run of samples that are alike, to the rest before where it is the same.
    fn add(&self, rests: &mut Vec<Rest>, samples: Range<usize>, still_deg: f64) {
        let (Some(start_s), Some(end_s)) = (self.t_s.get(samples.start), self.t_s.get(samples.end - 1))
        else {
            return;
        };
        // A slow motion is a chain of short runs.
        if end_s - start_s < 0.5 * LEAST_S {
            return;
        }
        let axes_deg = self.mean_deg(&samples, self.commanded());
        if let Some(last) = rests.last_mut()
            && start_s - last.end_s <= TORN_S
            && within(&last.axes_deg, &axes_deg, still_deg)
        {
            last.samples.end = samples.end;
            last.end_s = *end_s;
            return;
        }
        rests.push(Rest { samples, start_s: *start_s, end_s: *end_s, axes_deg });
    }

    /// The commanded axes where they are known, else the measured ones.
    pub(in crate::recording) fn commanded(&self) -> &[[f64; AXES]] {
        if self.commanded_deg.is_empty() { &self.measured_deg } else { &self.commanded_deg }
    }

    /// The mean of some samples of a column, degrees.
    pub(in crate::recording) fn mean_deg(
        &self,
        samples: &Range<usize>,
        column: &[[f64; AXES]],
    ) -> [f64; AXES] {
        let rows = column.get(samples.clone()).unwrap_or_default();
        std::array::from_fn(|axis| rows.iter().map(|row| row[axis]).sum::<f64>() / rows.len() as f64)
    }

    /// How far measured axes at rest are apart at most, degrees.
    fn still_deg(&self) -> f64 {
        /// Standard deviation of a second difference of independent values.
        const SECOND_DIFFERENCE: f64 = 2.449_489_742_783_178;
        let stride = (self.len() / 20_000).max(1);
        let noise = |axis: usize| {
            let bends = self.measured_deg.windows(3).step_by(stride);
            let mut bends: Vec<f64> =
                bends.map(|w| (w[0][axis] - 2.0 * w[1][axis] + w[2][axis]).abs()).collect();
            robust::median(&mut bends).unwrap_or(0.0) * robust::SIGMA_OF_MAD / SECOND_DIFFERENCE
        };
        (0..AXES).map(noise).fold(STILL_DEG, |still, noise| still.max(STILL_NOISES * noise))
    }
}

fn within(a: &[f64; AXES], b: &[f64; AXES], deg: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= deg)
}
