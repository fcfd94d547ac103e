//! The times of the compared results.

use serde::Serialize;

use crate::base::date::day_number;
use crate::conformity::ConformityFinding;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TimelineUnit {
    /// Days since the first result.
    Days,
    /// Number of the result, from 0.
    Results,
}

impl TimelineUnit {
    pub fn word(self) -> &'static str {
        match self {
            Self::Days => "day",
            Self::Results => "result",
        }
    }
}

/// Days since the first result if the dates are known, else the numbers of the results.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultTimeline {
    pub unit: TimelineUnit,
    pub times: Vec<f64>,
}

impl ResultTimeline {
    pub fn numbered(results: usize) -> Self {
        Self { unit: TimelineUnit::Results, times: (0..results).map(|at| at as f64).collect() }
    }

    /// The timeline from ascending dates `YYYY-MM-DD`, one per result.
    pub fn dated(dates: &[String], results: usize) -> Result<Self, ConformityFinding> {
        if dates.len() != results {
            return Err(ConformityFinding::DateCount { dates: dates.len(), results });
        }
        let day = |date: &String| day_number(date).ok_or(ConformityFinding::NotADate { date: date.clone() });
        let days: Vec<f64> = dates.iter().map(day).collect::<Result<_, _>>()?;
        if let Some(at) = days.windows(2).position(|pair| pair[1] <= pair[0]) {
            let (before, date) = (dates[at].clone(), dates[at + 1].clone());
            return Err(ConformityFinding::NotAfter { date, before });
        }
        let first = days.first().copied().unwrap_or(0.0);
        Ok(Self { unit: TimelineUnit::Days, times: days.into_iter().map(|day| day - first).collect() })
    }

    /// Two values have no trend: a line fits them exactly.
    pub fn has_trend(&self) -> bool {
        self.times.len() > 2
    }

    pub fn last(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_become_days_and_must_ascend() {
        let dated = |dates: &[&str]| {
            let dates: Vec<String> = dates.iter().map(ToString::to_string).collect();
            ResultTimeline::dated(&dates, dates.len())
        };
        assert_eq!(dated(&["2024-02-28", "2024-03-01", "2025-03-01"]).unwrap().times, [0.0, 2.0, 367.0]);
        for wrong in [&["2025-02-29"][..], &["2025-13-01"], &["yesterday"], &["2025-01"], &["2025-01-02"; 2]]
        {
            assert!(dated(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn results_without_dates_are_numbered() {
        let numbered = ResultTimeline::numbered(3);
        assert_eq!((numbered.unit, numbered.times.as_slice()), (TimelineUnit::Results, &[0.0, 1.0, 2.0][..]));
        assert!(numbered.has_trend() && !ResultTimeline::numbered(2).has_trend());
        assert_eq!((numbered.last(), ResultTimeline::numbered(0).last()), (2.0, 0.0));
        let dates = vec!["2024-01-01".to_owned()];
        assert!(matches!(
            ResultTimeline::dated(&dates, 2),
            Err(ConformityFinding::DateCount { dates: 1, results: 2 })
        ));
        let back = ["2024-01-02", "2024-01-01"].map(str::to_owned);
        assert!(matches!(ResultTimeline::dated(&back, 2), Err(ConformityFinding::NotAfter { .. })));
    }
}
