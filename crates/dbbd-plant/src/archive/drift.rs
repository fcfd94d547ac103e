//! Drift of a robot or a bar: the straight line through its results, and the date of a robot's next check.

use serde::Serialize;

use dbbd_job::report::plot::{TrendLine, TrendPoint};
use dbbd_model::base::date;
use dbbd_model::conformity::SIGNIFICANCE_LEVEL;
use dbbd_model::math::distributions::{coverage_95, two_sided_tail};
use dbbd_model::math::straight_line::{LevelCrossing, StraightLine, WeightedPoint};

/// Minimum number of values for a line.
pub(super) const MIN_TREND_VALUES: usize = 4;
/// A forecast is drawn this far beyond the last value, and later days than the second number have no date.
const AHEAD_DAYS: f64 = 365.0;
const LAST_DAY: f64 = 200_000.0;
const YEAR_DAYS: f64 = 365.25;
/// Standard deviation for equal weights, mm: negligible beside the scatter of the values.
const NO_SD_MM: f64 = 1e-9;

/// Weights of the values of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LineWeights {
    Equal,
    /// Weights from the uncertainties of the values.
    Uncertainties,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorTrend {
    line: StraightLine,
    coverage: f64,
    significant: bool,
    last: f64,
    reached: Option<LevelCrossing>,
}

impl ErrorTrend {
    /// The line through values in the order of time. `None` for fewer than [`MIN_TREND_VALUES`] values, or a single
    /// day.
    pub(super) fn of(points: &[TrendPoint], weights: LineWeights, limit_mm: Option<f64>) -> Option<Self> {
        let sd = |point: &TrendPoint| match weights {
            LineWeights::Equal => NO_SD_MM,
            LineWeights::Uncertainties => point.u95 / coverage_95(None),
        };
        let sighting = |point: &TrendPoint| WeightedPoint { x: point.time, y: point.value, sd: sd(point) };
        let sightings: Vec<WeightedPoint> = points.iter().map(sighting).filter(|one| one.sd > 0.0).collect();
        let last = points.last()?.time;
        let line = StraightLine::through(&sightings).filter(|_| sightings.len() >= MIN_TREND_VALUES)?;
        let freedom = Some((sightings.len() - 2) as f64);
        let significant = two_sided_tail(line.slope / line.slope_sd, freedom) < SIGNIFICANCE_LEVEL;
        let coverage = coverage_95(freedom);
        let reached = limit_mm.filter(|_| significant).and_then(|limit| line.reaches(limit, last, coverage));
        Some(Self { line, coverage, significant, last, reached })
    }

    /// The line of the chart. A significant trend is extended to where it reaches the limit, within bounds.
    pub(super) fn line(&self) -> TrendLine {
        let ahead =
            self.reached.map_or(AHEAD_DAYS, |reached| (reached.at - self.last).clamp(30.0, AHEAD_DAYS));
        let until = if self.significant { self.last + ahead } else { self.last };
        TrendLine { line: self.line, coverage: Some(self.coverage), until }
    }

    /// The day on which the limit is reached; the last day if it is exceeded already.
    fn reaches(&self, limit_mm: f64) -> Option<f64> {
        let now = if self.significant { self.line.at(self.last) } else { self.line.level };
        if now >= limit_mm { Some(self.last) } else { self.reached.map(|reached| reached.at) }
    }

    pub(super) fn forecast(&self) -> Forecast {
        let reached = self.reached.filter(|reached| reached.at < LAST_DAY);
        Forecast {
            slope_a_year: self.line.slope * YEAR_DAYS,
            u95_a_year: self.coverage * self.line.slope_sd * YEAR_DAYS,
            significant: self.significant,
            reached: reached.map(|reached| day_text(reached.at)),
            earliest: reached.map(|reached| day_text(reached.earliest)),
            latest: reached.and_then(|reached| reached.latest).filter(|day| *day < LAST_DAY).map(day_text),
        }
    }
}

/// The slope in mm per year, and the dates at which the limit is reached.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Forecast {
    slope_a_year: f64,
    u95_a_year: f64,
    significant: bool,
    reached: Option<String>,
    earliest: Option<String>,
    latest: Option<String>,
}

/// The last check of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LastCheck<'a> {
    pub(super) on: Option<&'a str>,
    pub(super) failed: bool,
}

/// The date of a robot's next check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct CheckDue {
    date: String,
    overdue: bool,
    by: DueBy,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum DueBy {
    Interval,
    Forecast,
    /// The last check failed.
    Failed,
}

impl CheckDue {
    /// `interval_days` after the last check, at once after a failed one, or when the drift reaches the limit if that is earlier.
    pub(super) fn of(
        checked: &LastCheck<'_>,
        interval_days: f64,
        trend: Option<(&ErrorTrend, f64)>,
        today: f64,
    ) -> Option<Self> {
        let by_interval = checked.on.and_then(day_of).map(|day| match checked.failed {
            true => (day, DueBy::Failed),
            false => (day + interval_days, DueBy::Interval),
        });
        let by_drift = trend.and_then(|(trend, limit_mm)| trend.reaches(limit_mm));
        let by_drift = by_drift.map(|day| (day, DueBy::Forecast));
        let earlier = |(day, _): &(f64, DueBy)| *day;
        let both = by_interval.into_iter().chain(by_drift).filter(|(day, _)| *day < LAST_DAY);
        let (day, by) = both.min_by(|one, other| earlier(one).total_cmp(&earlier(other)))?;
        Some(Self { date: day_text(day), overdue: day < today, by })
    }
}

/// Days since 1970-01-01 of a date or a date with time; `None` for another text.
pub(super) fn day_of(moment: &str) -> Option<f64> {
    if !date::is_moment(moment) {
        return None;
    }
    let (date, time) = moment.split_once('T').unwrap_or((moment, ""));
    let mut parts = time.split([':', 'Z']).map(|part| part.parse::<f64>().unwrap_or(0.0));
    let mut part = || parts.next().unwrap_or(0.0);
    let day = date::day_number(date)?;
    Some(day + (part() + part() / 60.0 + part() / 3600.0) / 24.0)
}

/// `YYYY-MM-DD`.
pub(super) fn day_text(day: f64) -> String {
    let ns = (day.clamp(0.0, LAST_DAY) * 86_400.0) as u64 * 1_000_000_000;
    date::utc(ns).split('T').next().unwrap_or_default().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(values: &[f64]) -> Vec<TrendPoint> {
        let point = |(at, value): (usize, &f64)| TrendPoint {
            time: 20_000.0 + 100.0 * at as f64,
            value: *value,
            u95: 0.0,
            has_warnings: false,
        };
        values.iter().enumerate().map(point).collect()
    }

    /// Slope by hand: (2 (0.505 - 0.100) + (0.395 - 0.205)) / 10 = 0.1 mm in 100 days.
    #[test]
    fn trends_are_forecast_and_scatter_is_not_significant() {
        let rising = points(&[0.100, 0.205, 0.300, 0.395, 0.505]);
        let trend = ErrorTrend::of(&rising, LineWeights::Equal, Some(0.8)).unwrap();
        let forecast = trend.forecast();
        assert!((forecast.slope_a_year / YEAR_DAYS - 1.0e-3).abs() < 1e-12, "{forecast:?}");
        assert!(forecast.significant);
        // The limit of 0.8 mm is reached 500 days after the mean day 20 200, where the mean is 0.301 mm.
        let passed = LastCheck { on: Some("2024-10-04T00:00:00Z"), failed: false };
        let due = CheckDue::of(&passed, 365.0, Some((&trend, 0.8)), 20_301.0).unwrap();
        assert_eq!((due.by, due.overdue), (DueBy::Interval, false));
        let due = CheckDue::of(&passed, 3650.0, Some((&trend, 0.8)), 21_000.0).unwrap();
        assert_eq!((due.by, due.overdue), (DueBy::Forecast, true));
        let due = CheckDue::of(&LastCheck { failed: true, ..passed }, 365.0, None, 20_401.0).unwrap();
        assert_eq!((due.by, due.date.as_str()), (DueBy::Failed, "2024-10-04"));
        let flat =
            ErrorTrend::of(&points(&[0.3, 0.31, 0.29, 0.31, 0.3]), LineWeights::Equal, Some(0.8)).unwrap();
        assert!(!flat.forecast().significant && flat.forecast().reached.is_none());
        let never = LastCheck { on: None, failed: false };
        let due = CheckDue::of(&never, 365.0, Some((&flat, 0.2)), 0.0);
        assert!(due.is_some_and(|due| due.by == DueBy::Forecast));
        assert!(ErrorTrend::of(&points(&[0.1, 0.2, 0.3]), LineWeights::Equal, None).is_none());
    }

    #[test]
    fn days_convert_to_dates_and_back() {
        assert_eq!(day_text(day_of("2024-02-29T12:00:00Z").unwrap()), "2024-02-29");
        assert_eq!(day_of("2024-02-29T12:00:00Z").unwrap() - day_of("2024-02-28").unwrap(), 1.5);
        assert!(["soon", "2024-02-29Tnoon", "2024-2-29"].into_iter().all(|text| day_of(text).is_none()));
    }
}
