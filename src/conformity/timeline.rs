//! When the results were made.

use serde::Serialize;

use crate::base::date::day_number;
use crate::catalogue::ConformityFinding;

/// What is counted along a trend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// From the first result.
    Days,
    /// The number of the result, from 0.
    Results,
}

impl TimeUnit {
    /// One of it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Days => "day",
            Self::Results => "result",
        }
    }
}

/// The times of the results: days from the first where their dates are known, else their numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    pub unit: TimeUnit,
    pub times: Vec<f64>,
}

impl Timeline {
    /// Of so many results in their order.
    pub fn numbered(results: usize) -> Self {
        Self { unit: TimeUnit::Results, times: (0..results).map(|at| at as f64).collect() }
    }

    /// Of dates `YYYY-MM-DD`, one for each of so many results.
    ///
    /// # Errors
    /// Another number of dates, what is no date, or one that is not after the one before.
    pub fn dated(dates: &[String], results: usize) -> Result<Self, ConformityFinding> {
        if dates.len() != results {
            return Err(ConformityFinding::DateCount { dates: dates.len(), results });
        }
        let mut days: Vec<f64> = Vec::new();
        let mut before: Option<&String> = None;
        for date in dates {
            let day = day_number(date).ok_or(ConformityFinding::NotADate { date: date.clone() })?;
            if let Some((before, last)) = before.zip(days.last())
                && day <= *last
            {
                return Err(ConformityFinding::NotAfter { date: date.clone(), before: before.clone() });
            }
            days.push(day);
            before = Some(date);
        }
        let first = days.first().copied().unwrap_or(0.0);
        Ok(Self { unit: TimeUnit::Days, times: days.into_iter().map(|day| day - first).collect() })
    }

    /// Two values are a difference: any line fits them.
    pub fn has_trend(&self) -> bool {
        self.times.len() > 2
    }

    /// The time of the last result.
    pub fn last(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_days_apart_and_ascend() {
        let dated = |dates: &[&str]| {
            let dates: Vec<String> = dates.iter().map(ToString::to_string).collect();
            Timeline::dated(&dates, dates.len())
        };
        assert_eq!(dated(&["2024-02-28", "2024-03-01", "2025-03-01"]).unwrap().times, [0.0, 2.0, 367.0]);
        for wrong in [&["2025-02-29"][..], &["2025-13-01"], &["yesterday"], &["2025-01"], &["2025-01-02"; 2]]
        {
            assert!(dated(wrong).is_err(), "{wrong:?}");
        }
    }
}
