//! Check of a bar at rest: noise, resolution, rate, drift, and the standard deviation of a length at a dwell.

use serde::Serialize;

use super::SampleStream;
use crate::recording::BarFinding::{self, Drifts, FewReadings, Invalid, NotAtRest, RateDiffers};
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::math::robust::{SIGMA_OF_MAD, median, slope};
use dbbd_model::math::straight_line::{StraightLine, WeightedPoint};

/// Readings are averaged over this time, as at a dwell, s.
const MEAN_S: f64 = 1.0;
/// Least number of averages.
const MIN_MEANS: usize = 5;
/// An average is an outlier beyond this number of robust standard deviations.
const JUMP: f64 = 8.0;
/// Least standard deviation of an average, mm.
const MIN_MEAN_SD_MM: f64 = 1e-9;
/// A slope is a drift from this number of standard deviations on.
const SIGNIFICANT: f64 = 3.0;
/// Largest relative difference from the nominal rate.
const RATE_SHARE: f64 = 0.1;

/// Lengths in mm, times in s.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BarCheck {
    pub protocol: String,
    pub samples: usize,
    /// Number of invalid readings, which do not count.
    pub invalid: usize,
    pub span_s: f64,
    /// All readings per second, valid or not.
    pub rate_hz: f64,
    pub nominal_hz: Option<f64>,
    pub mean_mm: f64,
    /// Smallest difference of two readings; the resolution of the protocol if all are equal.
    pub resolution_mm: f64,
    /// Standard deviation of one reading by the mean square of successive differences (von Neumann 1941), which a drift
    /// does not change; at least the standard deviation of rounding, resolution / sqrt(12).
    pub noise_mm: f64,
    /// Slope of the straight line through the means of one second, per minute.
    pub drift_mm_min: f64,
    pub drift_sd_mm_min: f64,
    /// Standard deviation of the means of one second about that line: noise that averaging does not remove.
    wander_mm: f64,
    /// Standard deviation of a length at a dwell: wander and rounding together.
    pub sigma_mm: f64,
    pub findings: Vec<BarFinding>,
    /// Time, value and standard deviation of each mean.
    #[serde(skip)]
    pub means: Vec<[f64; 3]>,
    #[serde(skip)]
    pub line: StraightLine,
    /// Readings less the line, mm.
    #[serde(skip)]
    pub residual_mm: Vec<f64>,
}

impl BarCheck {
    pub fn of(stream: &SampleStream, definition: &ProtocolDefinition) -> Result<Self, BarFinding> {
        let valid: Vec<usize> = (0..stream.len()).filter(|at| stream.valid(*at)).collect();
        let t_s: Vec<f64> = valid.iter().map(|at| stream.t_s[*at]).collect();
        let reading_mm: Vec<f64> = valid.iter().map(|at| stream.reading_mm[*at]).collect();
        let few = || FewReadings { readings: valid.len(), needed_s: MIN_MEANS as f64 * MEAN_S };
        let resolution_mm = resolution_mm(&reading_mm, definition.resolution_mm());
        let rounding_mm = resolution_mm / 12f64.sqrt();
        let span = |t_s: &[f64]| t_s.last().unwrap_or(&0.0) - t_s.first().unwrap_or(&0.0);
        let whole_s = span(&stream.t_s);
        if valid.len() < 2 || whole_s <= 0.0 {
            return Err(few());
        }
        let squares: f64 = reading_mm.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
        let noise_mm = (squares / (2.0 * (reading_mm.len() - 1) as f64)).sqrt().max(rounding_mm);
        let means = means(&t_s, &reading_mm, noise_mm);
        let sightings: Vec<WeightedPoint> =
            means.iter().map(|&[x, y, sd]| WeightedPoint { x, y, sd }).collect();
        let line = StraightLine::through(&sightings).filter(|_| means.len() >= MIN_MEANS).ok_or_else(few)?;
        let off: Vec<f64> = means.iter().map(|[x, y, _]| y - line.at(*x)).collect();
        let wander_mm = (off.iter().map(|off| off * off).sum::<f64>() / (off.len() - 2) as f64).sqrt();
        let mut check = Self {
            protocol: definition.id.clone(),
            samples: valid.len(),
            invalid: stream.len() - valid.len(),
            span_s: span(&t_s),
            rate_hz: (stream.len() - 1) as f64 / whole_s,
            nominal_hz: definition.nominal_hz,
            mean_mm: line.level,
            resolution_mm,
            noise_mm,
            drift_mm_min: 60.0 * line.slope,
            drift_sd_mm_min: 60.0 * line.slope_sd,
            wander_mm,
            sigma_mm: wander_mm.hypot(rounding_mm),
            findings: Vec::new(),
            residual_mm: t_s.iter().zip(&reading_mm).map(|(t_s, mm)| mm - line.at(*t_s)).collect(),
            means,
            line,
        };
        check.findings = check.judged();
        Ok(check)
    }

    fn judged(&self) -> Vec<BarFinding> {
        let jump = self.jump();
        let drift_um = 1e3 * self.drift_mm_min;
        let drifts = self.drift_mm_min.abs() > SIGNIFICANT * self.drift_sd_mm_min
            && self.drift_mm_min.abs() > SIGNIFICANT * self.sigma_mm;
        let rate = self.nominal_hz.filter(|nominal| (self.rate_hz / nominal - 1.0).abs() > RATE_SHARE);
        let (invalid, samples) = (self.invalid, self.samples + self.invalid);
        [
            jump.map(|(t_s, off_mm)| NotAtRest { t_s, off_um: 1e3 * off_mm }),
            drifts.then_some(Drifts { drift_um_min: drift_um, sigma_um: 1e3 * self.sigma_mm }),
            rate.map(|nominal_hz| RateDiffers { rate_hz: self.rate_hz, nominal_hz }),
            (invalid > 0).then_some(Invalid { invalid, samples }),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// The mean that is farthest from a robust line, if it is an outlier: time and distance.
    fn jump(&self) -> Option<(f64, f64)> {
        let points: Vec<(f64, f64)> = self.means.iter().map(|&[t_s, mm, _]| (t_s, mm)).collect();
        let slope = slope(&points, &mut Vec::new());
        let mut levels: Vec<f64> = points.iter().map(|(t_s, mm)| mm - slope * t_s).collect();
        let level = median(&mut levels)?;
        let mut sizes: Vec<f64> = levels.iter().map(|mm| (mm - level).abs()).collect();
        let scale_mm = SIGMA_OF_MAD * median(&mut sizes)?;
        let off = |(t_s, mm): &(f64, f64)| (*t_s, mm - slope * t_s - level);
        let worst = points.iter().map(off).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        let floor_mm = self.resolution_mm / 12f64.sqrt();
        (worst.1.abs() > JUMP * scale_mm.max(floor_mm)).then_some(worst)
    }

    /// The section of the job for this bar.
    pub fn to_toml(&self) -> String {
        let Self { protocol, samples, span_s, rate_hz, .. } = self;
        let um =
            [self.noise_mm, self.resolution_mm, self.drift_mm_min, self.drift_sd_mm_min].map(|mm| 1e3 * mm);
        let [noise_um, resolution_um, drift_um, drift_sd_um] = um;
        format!(
            "# Measured at rest by `dbbd bar check`: {samples} readings in {span_s:.0} s, {rate_hz:.4} per second.\n\
             # One reading {noise_um:.3} um (1 sd), resolution {resolution_um:.3} um, drift {drift_um:.3} um/min \
             ({drift_sd_um:.3}, 1 sd).\n[bar]\nprotocol = {protocol:?}\nsigma_um = {:.3}            # of a length at a \
             dwell, without the robot's repeatability\n# length_mm and stroke_mm: from the bar's certificate\n",
            (1e3 * self.sigma_mm).max(1e-3)
        )
    }
}

/// The smallest step between readings, apart from rounding of the arithmetic.
fn resolution_mm(reading_mm: &[f64], of_protocol_mm: f64) -> f64 {
    let mut sorted = reading_mm.to_vec();
    sorted.sort_by(f64::total_cmp);
    let least = (0.5 * of_protocol_mm).max(1e-9);
    let steps = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > least);
    let smallest = steps.fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { of_protocol_mm }
}

/// Means over whole intervals, each at the mean of its times, with its standard deviation if the noise is white.
fn means(t_s: &[f64], reading_mm: &[f64], noise_mm: f64) -> Vec<[f64; 3]> {
    let first = t_s.first().copied().unwrap_or(0.0);
    let interval = |t_s: f64| ((t_s - first) / MEAN_S).floor() as u64;
    let rows: Vec<(f64, f64)> = t_s.iter().copied().zip(reading_mm.iter().copied()).collect();
    let mut chunks: Vec<&[(f64, f64)]> = rows.chunk_by(|a, b| interval(a.0) == interval(b.0)).collect();
    // The last interval is incomplete.
    chunks.pop();
    let mean = |chunk: &[(f64, f64)]| {
        let count = chunk.len() as f64;
        let t_s = chunk.iter().map(|row| row.0).sum::<f64>() / count;
        let mm = chunk.iter().map(|row| row.1).sum::<f64>() / count;
        [t_s, mm, (noise_mm / count.sqrt()).max(MIN_MEAN_SD_MM)]
    };
    chunks.into_iter().map(mean).collect()
}
