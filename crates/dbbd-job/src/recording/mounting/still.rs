//! A bar at rest: the means of blocks of its readings about their straight line.

use dbbd_model::math::distributions::chi_square_tail;
use dbbd_model::math::straight_line::RegressionLine;

/// Significant normal deviate: two-sided probability of 1e-9.
pub(super) const DEVIATE: f64 = 6.1;
/// Probability of a false alarm per comparison: there are 20 per second, 720,000 in ten hours.
const FALSE_ALARM: f64 = 1e-9;
/// Ratio of variances that is significant with any number of blocks.
const SURELY: f64 = 16.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StillStatistics {
    pub(super) blocks: usize,
    pub(super) span_s: f64,
    pub(super) slope_mm_s: f64,
    /// About the line, mm.
    pub(super) scatter_mm: f64,
    pub(super) roughness: f64,
    /// Standard deviation of a block mean by the noise, mm.
    noise_mm: f64,
}

impl StillStatistics {
    /// Block means at a spacing of `block_s`; `None` with fewer than two.
    pub(super) fn of(blocks: &[f64], block_s: f64, noise_mm: f64) -> Option<Self> {
        let RegressionLine { centre: [middle, mean], slope, .. } = regression(blocks.iter().copied())?;
        let n = blocks.len() as f64;
        let about = |at: usize| mean + slope * (at as f64 - middle);
        let squares: f64 = blocks.iter().enumerate().map(|(at, value)| (value - about(at)).powi(2)).sum();
        let variance = squares / (n - 2.0);
        let steps: f64 = blocks.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
        // About the mean: about a line the start of a pull is as rough as rocking.
        let total: f64 = blocks.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self {
            blocks: blocks.len(),
            span_s: n * block_s,
            slope_mm_s: slope / block_s,
            scatter_mm: variance.sqrt(),
            roughness: if total > 0.0 { 0.5 * steps / total } else { 0.0 },
            noise_mm,
        })
    }

    /// Whether the means scatter more than noise.
    pub(super) fn is_scattered(&self) -> bool {
        let freedom = self.blocks as f64 - 2.0;
        let ratio = (self.scatter_mm / self.noise_mm).powi(2);
        // Far out the tail underflows.
        ratio > SURELY || chi_square_tail(freedom * ratio, freedom) < FALSE_ALARM
    }

    pub(super) fn is_drifting(&self) -> bool {
        let n = self.blocks as f64;
        let sd_mm_s = self.noise_mm * (12.0 * n / (n * n - 1.0)).sqrt() / self.span_s;
        self.slope_mm_s.abs() > DEVIATE * sd_mm_s
    }

    pub(super) fn is_quiet(&self) -> bool {
        !self.is_scattered() && !self.is_drifting()
    }
}

/// The line through values at equal spacing; its slope is per step.
pub(super) fn regression(values: impl Iterator<Item = f64>) -> Option<RegressionLine> {
    let points: Vec<[f64; 2]> = values.enumerate().map(|(at, value)| [at as f64, value]).collect();
    RegressionLine::through(&points)
}
