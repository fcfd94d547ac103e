//! Straight lines by weighted and by unweighted least squares.

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedPoint {
    pub x: f64,
    pub y: f64,
    pub sd: f64,
}

/// y = level + slope (x - centre). `centre` is the weighted mean of x, so that the errors of level and slope are
/// uncorrelated.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct StraightLine {
    pub centre: f64,
    pub level: f64,
    pub level_sd: f64,
    pub slope: f64,
    pub slope_sd: f64,
}

/// The x at which a line reaches a level, with its interval.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct LevelCrossing {
    pub at: f64,
    pub earliest: f64,
    /// `None` if the interval is unbounded.
    pub latest: Option<f64>,
}

/// The least-squares line through points of equal weight; its uncertainty comes from the residuals.
#[derive(Clone, Copy, Debug)]
pub struct RegressionLine {
    /// Means of x and y; the line passes through them.
    pub centre: [f64; 2],
    pub slope: f64,
    pub slope_sd: f64,
}

impl RegressionLine {
    /// `None` if all x are equal. With two points `slope_sd` is NaN.
    pub fn through(points: &[[f64; 2]]) -> Option<Self> {
        let count = points.len() as f64;
        let [x, y] = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count);
        let spread: f64 = points.iter().map(|point| (point[0] - x).powi(2)).sum();
        let slope = points.iter().map(|point| (point[0] - x) * (point[1] - y)).sum::<f64>() / spread;
        let rest: f64 = points.iter().map(|point| (point[1] - y - slope * (point[0] - x)).powi(2)).sum();
        let slope_sd = (rest / (count - 2.0) / spread).sqrt();
        (spread > 0.0).then_some(Self { centre: [x, y], slope, slope_sd })
    }
}

impl StraightLine {
    /// The line by weighted least squares; `None` if all x are equal. Where the residuals exceed the standard
    /// deviations, both uncertainties are multiplied by the Birge ratio.
    pub fn through(sightings: &[WeightedPoint]) -> Option<Self> {
        let weight = |sighting: &WeightedPoint| sighting.sd.powi(-2);
        let sum = |of: &dyn Fn(&WeightedPoint) -> f64| -> f64 {
            sightings.iter().map(|sighting| weight(sighting) * of(sighting)).sum()
        };
        let all = sum(&|_| 1.0);
        let (centre, level) = (sum(&|s| s.x) / all, sum(&|s| s.y) / all);
        let spread = sum(&|s| (s.x - centre).powi(2));
        if !(spread > 0.0 && spread.is_finite()) {
            return None;
        }
        let slope = sum(&|s| (s.x - centre) * (s.y - level)) / spread;
        let chi_square = sum(&|s| (s.y - level - slope * (s.x - centre)).powi(2));
        let freedom = sightings.len().saturating_sub(2);
        let birge = if freedom > 0 { (chi_square / freedom as f64).sqrt().max(1.0) } else { 1.0 };
        Some(Self { centre, level, level_sd: birge / all.sqrt(), slope, slope_sd: birge / spread.sqrt() })
    }

    pub fn at(&self, x: f64) -> f64 {
        self.level + self.slope * (x - self.centre)
    }

    /// The x at or after `now` at which the line reaches `level`; `None` if it never does. The interval is Fieller's with
    /// the coverage factor `k`.
    pub fn reaches(&self, level: f64, now: f64, k: f64) -> Option<LevelCrossing> {
        let at = self.centre + (level - self.level) / self.slope;
        if !(at.is_finite() && at >= now) {
            return None;
        }
        // (slope u - rise)^2 = k^2 (level_sd^2 + slope_sd^2 u^2) with u = x - centre.
        let rise = level - self.level;
        let a = self.slope.powi(2) - (k * self.slope_sd).powi(2);
        let b = -2.0 * self.slope * rise;
        let c = rise.powi(2) - (k * self.level_sd).powi(2);
        let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
        let mut ends = [-b - root, -b + root].map(|end| self.centre + end / (2.0 * a));
        ends.sort_by(f64::total_cmp);
        // If the slope may be zero, the interval is unbounded above.
        let (earliest, latest) = if a > 0.0 {
            (ends[0], Some(ends[1]))
        } else {
            (ends.into_iter().find(|end| *end >= now).unwrap_or(now), None)
        };
        Some(LevelCrossing { at, earliest: earliest.max(now), latest })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sightings(values: &[f64], sd: f64) -> Vec<WeightedPoint> {
        values.iter().enumerate().map(|(at, y)| WeightedPoint { x: at as f64, y: *y, sd }).collect()
    }

    #[test]
    fn a_line_has_its_slope_and_reaches_its_level() {
        let line = StraightLine::through(&sightings(&[1.0, 3.0, 5.0, 7.0], 0.1)).unwrap();
        assert!((line.slope - 2.0).abs() < 1e-12 && (line.at(10.0) - 21.0).abs() < 1e-12);
        // 0.1 / sqrt(sum (x - 1.5)^2) = 0.1 / sqrt(5).
        assert!((line.slope_sd - 0.1 / 5f64.sqrt()).abs() < 1e-12);
        let reached = line.reaches(21.0, 3.0, 1.96).unwrap();
        assert!((reached.at - 10.0).abs() < 1e-12);
        assert!(reached.earliest < 10.0 && reached.latest.unwrap() > 10.0);
        for end in [reached.earliest, reached.latest.unwrap()] {
            let sd = line.level_sd.hypot(line.slope_sd * (end - line.centre));
            assert!(((line.at(end) - 21.0).abs() - 1.96 * sd).abs() < 1e-9);
        }
        assert_eq!(line.reaches(0.0, 3.0, 1.96), None);
    }

    #[test]
    fn scatter_is_scaled_by_the_birge_ratio_and_a_flat_line_has_no_latest_end() {
        let line = StraightLine::through(&sightings(&[0.0, 1.0, 0.0, 1.0], 0.1)).unwrap();
        assert!(line.slope_sd > 0.1 / 5f64.sqrt() * 4.0);
        assert_eq!(line.reaches(5.0, 3.0, 1.96).unwrap().latest, None);
        assert_eq!(StraightLine::through(&sightings(&[1.0], 0.1)), None);
    }

    /// numpy: weights 1 / sd^2, weighted means, slope = sum w (x - c) (y - l) / sum w (x - c)^2, chi-square 11.05 with two
    /// degrees of freedom.
    #[test]
    fn weighted_line_matches_numpy() {
        let point = |x, y, sd| WeightedPoint { x, y, sd };
        let points = [point(0.0, 1.0, 0.5), point(1.0, 2.5, 0.2), point(2.0, 2.0, 0.4), point(4.0, 6.0, 1.0)];
        let line = StraightLine::through(&points).unwrap();
        for (found, expected) in [
            (line.centre, 1.1448275862068966),
            (line.level, 2.344827586206897),
            (line.slope, 0.767437523312197),
            (line.level_sd, 0.3904017621187346),
            (line.slope_sd, 0.5466399510334591),
        ] {
            assert!((found - expected).abs() < 1e-13, "{found} for {expected}");
        }
    }

    /// scipy.stats.linregress([1, 2, 4, 7], [2, 1, 5, 6]).
    #[test]
    fn regression_line_matches_scipy() {
        let line = RegressionLine::through(&[[1.0, 2.0], [2.0, 1.0], [4.0, 5.0], [7.0, 6.0]]).unwrap();
        assert!((line.slope - 0.8095238095238095).abs() < 1e-14);
        assert!((line.slope_sd - 0.2776643759450143).abs() < 1e-14);
        assert_eq!(line.centre, [3.5, 3.5]);
        assert!(RegressionLine::through(&[[1.0, 2.0], [1.0, 3.0]]).is_none());
    }

    #[test]
    fn a_crossing_lies_ahead_and_its_interval_begins_now() {
        let line = StraightLine { centre: 0.0, level: 0.0, level_sd: 0.3, slope: -1.0, slope_sd: 0.0 };
        let reached = line.reaches(-1.0, 0.9, 2.0).unwrap();
        // |level - line| = 2 * 0.3 at 1 -/+ 0.6; the earlier end is in the past.
        assert!((reached.at - 1.0).abs() < 1e-12);
        assert_eq!(reached.earliest, 0.9);
        assert!((reached.latest.unwrap() - 1.6).abs() < 1e-12);
        assert_eq!(line.reaches(-1.0, 1.1, 2.0), None);
        assert_eq!(line.reaches(-1.0, 0.0, 2.0).map(|reached| (1e9 * reached.earliest).round()), Some(4e8));
    }
}
