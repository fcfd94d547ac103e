//! A dwell: its interval in the stream, and what was read in it.

use super::stream::SampleStream;
use crate::plan::job::JobFinding;
use dbbd_device::protocol::{ProtocolDefinition, ProtocolMode};
use dbbd_model::math::robust;

/// A detected dwell; times in s of the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dwell {
    pub start_s: f64,
    pub end_s: f64,
    /// Standard deviation of the start.
    pub start_sd_s: f64,
    /// The reading counts from here.
    pub settled_s: f64,
    /// The reading counts until here at most.
    pub until_s: f64,
}

impl Dwell {
    /// A dwell whose reading counts from start to end.
    pub fn whole(start_s: f64, end_s: f64, start_sd_s: f64) -> Self {
        Self { start_s, end_s, start_sd_s, settled_s: start_s, until_s: end_s }
    }

    pub fn duration_s(&self) -> f64 {
        self.end_s - self.start_s
    }
}

/// The reading of the bar in a dwell, or as the robot passed a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DwellReading {
    /// First time that counts, s of the stream.
    pub from_s: f64,
    /// Last time that counts, s of the stream.
    pub to_s: f64,
    /// Mean without the outer tenths, mm.
    pub reading_mm: f64,
    /// Standard uncertainty of the mean, mm: `s / sqrt(N (1 - r) / (1 + r))` with r the correlation of neighbouring
    /// samples. It does not contain the robot's repeatability, which a single dwell does not show.
    pub u_mm: f64,
    /// Number of valid samples.
    pub samples: usize,
    /// Number of samples that the device marked as invalid; they do not count.
    pub invalid: usize,
    /// Number of gaps in the sequence numbers.
    pub gaps: usize,
    /// Change of the reading over the dwell, mm, if it is significant.
    pub creep_mm: Option<f64>,
}

impl DwellReading {
    pub fn middle_s(&self) -> f64 {
        0.5 * (self.from_s + self.to_s)
    }
}

/// Resolution assumed for a constant reading, mm.
const MIN_RESOLUTION_MM: f64 = 1e-4;
/// The least uncertainty of a reading, mm: that of a uniform distribution over the step.
pub(super) fn least_u_mm() -> f64 {
    MIN_RESOLUTION_MM / 12f64.sqrt()
}
/// Least number of samples of a dwell.
const MIN_DWELL_SAMPLES: usize = 3;

/// A finding if a dwell of `dwell_s` can have too few readings of a bar.
pub fn too_short(dwell_s: f64, bar: &ProtocolDefinition) -> Option<JobFinding> {
    let hz = match bar.mode {
        ProtocolMode::Poll { hz, .. } => hz,
        ProtocolMode::Stream => bar.nominal_hz?,
        ProtocolMode::Push => return None,
    };
    (dwell_s * hz < MIN_DWELL_SAMPLES as f64).then_some(JobFinding::ShortDwell {
        dwell_s,
        hz,
        least: MIN_DWELL_SAMPLES,
    })
}

/// A change is creep from this number of standard deviations on.
const CREEP: f64 = 4.0;

/// Scatter of residuals in time.
pub(super) struct ResidualScatter {
    /// Sum of their squares.
    pub(super) squares: f64,
    /// Correlation of neighbours, 0 to 0.99.
    pub(super) correlation: f64,
}

impl ResidualScatter {
    pub(super) fn of(residuals: impl Iterator<Item = f64>) -> Self {
        let (mut squares, mut products, mut before) = (0.0, 0.0, 0.0);
        for residual in residuals {
            squares += residual * residual;
            products += before * residual;
            before = residual;
        }
        let correlation = if squares > 0.0 { (products / squares).clamp(0.0, 0.99) } else { 0.0 };
        Self { squares, correlation }
    }
}

/// The reading between two times; `None` with too few valid samples, or if the clock broke between.
pub fn reading_between(stream: &SampleStream, from_s: f64, to_s: f64) -> Option<DwellReading> {
    let range = stream.at(from_s)..stream.at(to_s);
    if range.len() < MIN_DWELL_SAMPLES || stream.broken_between(stream.t_s[range.start], to_s) {
        return None;
    }
    let valid: Vec<usize> = range.clone().filter(|&at| stream.valid(at)).collect();
    if valid.len() < MIN_DWELL_SAMPLES {
        return None;
    }
    let mut readings: Vec<f64> = valid.iter().map(|&at| stream.reading_mm[at]).collect();
    let reading_mm = robust::trimmed_mean(&mut readings)?;
    let count = valid.len() as f64;
    let middle_s = valid.iter().map(|&at| stream.t_s[at]).sum::<f64>() / count;
    let (mut tt, mut ty) = (0.0, 0.0);
    for &at in &valid {
        let (t, y) = (stream.t_s[at] - middle_s, stream.reading_mm[at] - reading_mm);
        tt += t * t;
        ty += t * y;
    }
    let ResidualScatter { squares, correlation } =
        ResidualScatter::of(valid.iter().map(|&at| stream.reading_mm[at] - reading_mm));
    let effective = (count * (1.0 - correlation) / (1.0 + correlation)).max(1.0);
    // A reading that stays on one step of the scale is known to that step, however many samples there are.
    let step_mm = readings.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    let step_mm = step_mm.fold(f64::INFINITY, f64::min);
    let deviation = (squares / (count - 1.0)).sqrt();
    let u_mm = if step_mm.is_finite() && deviation > 0.5 * step_mm {
        deviation / effective.sqrt()
    } else {
        if step_mm.is_finite() { step_mm / 12f64.sqrt() } else { least_u_mm() }
    };
    let slope = if tt > 0.0 { ty / tt } else { 0.0 };
    // The slope of as many independent samples, spread over the same time.
    let slope_sd = if tt > 0.0 { deviation * (count / effective / tt).sqrt() } else { f64::INFINITY };
    let creeps = slope.abs() > CREEP * slope_sd && effective > 5.0;
    let last_s = stream.t_s[range.end - 1];
    Some(DwellReading {
        from_s,
        to_s,
        reading_mm,
        u_mm,
        samples: valid.len(),
        invalid: range.len() - valid.len(),
        gaps: range.clone().skip(1).filter(|&at| stream.gap_before(at)).count(),
        creep_mm: creeps.then(|| slope * (last_s - stream.t_s[range.start])),
    })
}
