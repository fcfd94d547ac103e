//! How fast a robot drifts between measurements, and the conditions of a measurement.

use serde::{Deserialize, Serialize};

/// When a robot was measured, and how warm it was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasurementConditions {
    /// `YYYY-MM-DD`, with or without a time; `None` if it is not known.
    pub date: Option<String>,
    /// Mean temperature, degrees Celsius; `None` if it was not measured.
    pub temperature_c: Option<f64>,
}

/// How fast the zeros of a robot's joints wander. The rate is log-normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Median of the standard deviation of a zero's step in a month, rad; that in t months is t^(1/2) times as large.
    pub zero_rad: f64,
    /// Standard deviation of its logarithm.
    pub ln_sd: f64,
    /// Intervals between measurements of this robot that it was learnt from; none: it is a hyper-prior.
    pub intervals: u32,
}

/// A hyper-prior that is reasoned, not measured: belts, couplings and gears of a sound arm settle by 20 urad in a year, which is as
/// far at 2 m, 0.04 mm, as it repeats; robots differ by a factor of e.
impl Default for Drift {
    fn default() -> Self {
        Self { zero_rad: 20e-6 / 12f64.sqrt(), ln_sd: 1.0, intervals: 0 }
    }
}

impl Drift {
    /// Whether its numbers are possible.
    pub(super) fn is_sound(&self) -> bool {
        self.zero_rad > 0.0 && self.zero_rad <= 0.01 && (0.0..=2.0).contains(&self.ln_sd)
    }

    /// The root of the mean square of the rate, rad for a month: robots that wander fast count with their squares.
    pub fn rms_zero_rad(&self) -> f64 {
        self.zero_rad * (self.ln_sd * self.ln_sd).exp()
    }
}
