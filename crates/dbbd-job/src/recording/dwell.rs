//! A dwell: its interval in the stream, and its reading.

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
    /// First time at which the reading counts, s.
    pub settled_s: f64,
    /// Last time at which the reading counts, s.
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
/// The least uncertainty of a reading, mm: the standard deviation of a uniform distribution over the step.
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
    /// Sum of the squares of the residuals.
    pub(super) squares: f64,
    /// Correlation of neighbouring residuals, 0 to 0.99.
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
    // The slope of the effective number of independent samples, spread over the same time.
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    /// A stream at 100 Hz with one reading per value, mm.
    fn stream(readings_mm: impl IntoIterator<Item = f64>) -> SampleStream {
        let mut builder = StreamBuilder::new(None);
        for (at, reading_mm) in (0..).zip(readings_mm) {
            builder.push(
                HostNs(at * 10_000_000),
                &Sample { valid: reading_mm < 100.0, ..Sample::of(reading_mm) },
            );
        }
        builder.build()
    }

    #[test]
    fn three_readings_are_enough_for_a_dwell() {
        let of = |mode, nominal_hz, dwell_s| {
            let mut bar = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
            (bar.mode, bar.nominal_hz) = (mode, nominal_hz);
            too_short(dwell_s, &bar)
        };
        let polled = ProtocolMode::Poll { hz: 4.0, timeout: Duration::ZERO };
        for (mode, nominal_hz) in [(polled, None), (ProtocolMode::Stream, Some(4.0))] {
            assert!(of(mode, nominal_hz, 0.75).is_none());
            let short = of(mode, nominal_hz, 0.74);
            assert!(matches!(short, Some(JobFinding::ShortDwell { hz: 4.0, least: 3, .. })));
        }
        for mode in [ProtocolMode::Stream, ProtocolMode::Push] {
            assert!(of(mode, None, 0.0).is_none());
        }
    }

    fn alternating(count: usize) -> impl Iterator<Item = f64> {
        (0..count).map(|at| if at % 2 == 0 { 1.1 } else { 0.9 })
    }

    /// Residuals +-0.1: s = sqrt(10 * 0.01 / 9), no positive correlation, u = s / sqrt(10).
    #[test]
    fn reading_is_the_mean_with_its_uncertainty() {
        let reading = reading_between(&stream(alternating(12)), 0.0, 0.095).unwrap();
        assert_eq!((reading.samples, reading.invalid, reading.gaps, reading.creep_mm), (10, 0, 0, None));
        assert!((reading.reading_mm - 1.0).abs() < 1e-12);
        assert!((reading.u_mm - (0.1f64 / 9.0).sqrt() / 10f64.sqrt()).abs() < 1e-12, "{}", reading.u_mm);
        assert!((reading.middle_s() - 0.0475).abs() < 1e-12);
    }

    /// The standard deviation of a uniform distribution is its width over the square root of 12.
    #[test]
    fn constant_reading_is_known_to_the_resolution() {
        let reading = reading_between(&stream([2.0; 10]), 0.0, 1.0).unwrap();
        assert!((reading.u_mm - 1e-4 / 12f64.sqrt()).abs() < 1e-12);
        // One sample of ten on the next step: its deviation is a third of a step, less than a half.
        let mut steps = [2.0; 10];
        steps[4] = 2.01;
        let reading = reading_between(&stream(steps), 0.0, 1.0).unwrap();
        assert!((reading.u_mm - 0.01 / 12f64.sqrt()).abs() < 1e-12, "{}", reading.u_mm);
    }

    /// Products of neighbours over squares of 1, 2, 3: (2 + 6) / 14; negative correlation counts as none.
    #[test]
    fn correlation_of_neighbours() {
        let ResidualScatter { squares, correlation } = ResidualScatter::of([1.0, 2.0, 3.0].into_iter());
        assert_eq!(squares, 14.0);
        assert!((correlation - 8.0 / 14.0).abs() < 1e-15);
        assert_eq!(ResidualScatter::of([1.0, -1.0].into_iter()).correlation, 0.0);
        assert_eq!(ResidualScatter::of(std::iter::repeat_n(1.0, 1000)).correlation, 0.99);
        assert_eq!(ResidualScatter::of(std::iter::empty()).correlation, 0.0);
    }

    /// A rise of 0.02 mm a second in noise of 0.001 mm, which alternates.
    #[test]
    fn drift_within_a_dwell_is_creep() {
        let rising = |slope: f64| {
            (0..100).map(move |at| slope * 0.01 * f64::from(at) + if at % 2 == 0 { 0.001 } else { -0.001 })
        };
        assert_eq!(reading_between(&stream(rising(0.0)), 0.0, 1.0).unwrap().creep_mm, None);
        let creep_mm = reading_between(&stream(rising(0.002)), 0.0, 1.0).unwrap().creep_mm.unwrap();
        assert!((creep_mm - 0.002 * 0.99).abs() < 1e-4, "{creep_mm}");
    }

    #[test]
    fn invalid_samples_do_not_count() {
        let mut readings: Vec<f64> = alternating(12).collect();
        readings[3] = 999.0;
        let reading = reading_between(&stream(readings), 0.0, 1.0).unwrap();
        assert_eq!((reading.samples, reading.invalid), (11, 1));
        assert!((reading.reading_mm - 1.0).abs() < 0.03);
        assert!(reading_between(&stream([1.0, 1.0, 999.0]), 0.0, 1.0).is_none());
        assert!(reading_between(&stream([1.0, 1.0]), 0.0, 1.0).is_none());
        assert!(reading_between(&stream([1.0, 1.0, 1.0]), 0.0, 1.0).is_some());
    }
}
