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
    /// Scatter about the line, mm.
    pub(super) scatter_mm: f64,
    pub(super) roughness: f64,
    /// Standard deviation of a block mean due to the noise, mm.
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
        // Squares about the mean: about a line, the start of a pull is as rough as rocking.
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
        // For such large ratios the tail underflows.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The line through 0, 1, 2, 4 is 1.75 + 1.3 (x - 1.5), its residuals 0.2, -0.1, -0.4, 0.3; their squares are
    /// 0.3, the squared steps 6, the squares about the mean 8.75.
    #[test]
    fn blocks_scatter_about_their_line() {
        let still = StillStatistics::of(&[0.0, 1.0, 2.0, 4.0], 0.5, 1.0).unwrap();
        assert_eq!((still.blocks, still.span_s), (4, 2.0));
        let off = [still.slope_mm_s - 2.6, still.scatter_mm - 0.15f64.sqrt(), still.roughness - 3.0 / 8.75];
        assert!(off.iter().all(|off| off.abs() < 1e-12), "{still:?}");
        assert!(StillStatistics::of(&[1.0], 0.5, 1.0).is_none());
        assert_eq!(StillStatistics::of(&[1.0; 8], 0.5, 1.0).unwrap().roughness, 0.0);
    }

    /// The slope of n block means over T has the standard deviation noise sqrt(12 n / (n^2 - 1)) / T: 0.8944 of the
    /// noise here, so that 2.6 mm/s are 6.1 of them at a noise of 0.4765 mm.
    #[test]
    fn slope_beyond_its_noise_is_a_drift() {
        let drifts =
            |noise_mm| StillStatistics::of(&[0.0, 1.0, 2.0, 4.0], 0.5, noise_mm).unwrap().is_drifting();
        assert!(drifts(0.476) && !drifts(0.477));
    }

    /// With two degrees of freedom the tail of chi square is exp(-x / 2): the ratio of variances 15 has 3e-7, which
    /// is no alarm; 16 always is one.
    #[test]
    fn scatter_beyond_its_noise_is_an_alarm() {
        let still = |noise_mm| StillStatistics::of(&[0.0, 1.0, 2.0, 4.0], 0.5, noise_mm).unwrap();
        assert!(!still(0.1).is_scattered() && still(0.096).is_scattered());
        assert!(still(0.5).is_quiet() && !still(0.3).is_quiet());
        // Twenty degrees of freedom and the ratio 4.5: the tail of 90 is 7e-11; of 4, that of 80: 4e-9 (closed form).
        let alternating: Vec<f64> = (0..22).map(|at| if at % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let ratio = |ratio: f64| {
            let scatter = StillStatistics::of(&alternating, 0.5, 1.0).unwrap().scatter_mm;
            StillStatistics::of(&alternating, 0.5, scatter / ratio.sqrt()).unwrap().is_scattered()
        };
        assert!(ratio(4.5) && !ratio(4.0));
    }
}
