//! Measurements that are left out of a fit on request.

use std::str::FromStr;

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{CompletedCalibration, EstimationFinding};
use dbbd_model::measurement::{Measurement, Measurements};
use serde::{Deserialize, Serialize};

use crate::request::RowIndices;

/// Rows that are left out, by the index that `lengths.csv` and the findings give them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exclusion {
    pub rows: RowIndices,
    pub reason: Option<String>,
    /// Who left them out; `None` for the operator of the measurement.
    #[serde(default)]
    pub by: Option<String>,
}

impl FromStr for Exclusion {
    type Err = String;

    /// Reads rows with or without a reason: `3,7-9` or `3,7-9:why`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (rows, reason) = text.split_once(':').unwrap_or((text, ""));
        let reason = Some(reason.trim()).filter(|reason| !reason.is_empty()).map(str::to_owned);
        Ok(Self { rows: rows.parse()?, reason, by: None })
    }
}

/// The rows that were left out of the observations.
pub(super) struct AppliedExclusion {
    asked: Vec<Exclusion>,
    rows: Vec<Measurement>,
}

impl AppliedExclusion {
    /// Takes the requested rows out of the observations.
    ///
    /// # Errors
    /// There is no such row, or no other row would be left.
    pub(super) fn of(
        observations: &mut Measurements,
        asked: &[Exclusion],
    ) -> Result<Self, EstimationFinding> {
        let mut indices = asked.iter().flat_map(|one| one.rows.iter());
        match indices.find(|index| !observations.rows.iter().any(|row| row.index == *index)) {
            Some(index) => Err(EstimationFinding::NoRowToExclude { index }),
            None => Self { asked: asked.to_vec(), rows: Vec::new() }.again(observations),
        }
    }

    /// Takes the same rows out of observations that were matched again. A row that has no length any more is left out, too.
    ///
    /// # Errors
    /// No other row would be left.
    pub(super) fn again(&self, observations: &mut Measurements) -> Result<Self, EstimationFinding> {
        let is_asked = |row: &Measurement| self.asked.iter().any(|one| one.rows.contains(row.index));
        let (rows, used): (Vec<_>, Vec<_>) =
            std::mem::take(&mut observations.rows).into_iter().partition(is_asked);
        observations.rows = used;
        match observations.rows.is_empty() {
            true => Err(EstimationFinding::NoLength),
            false => Ok(Self { asked: self.asked.clone(), rows }),
        }
    }

    /// The finding about rows that are left out.
    pub(super) fn finding(&self) -> Option<Diagnostic> {
        let mut indices: Vec<u32> = self.rows.iter().map(|row| row.index).collect();
        indices.dedup();
        let rows = RowIndices::from_iter(indices.iter().copied()).to_string();
        (!indices.is_empty()).then(|| EstimationFinding::Excluded { count: indices.len(), rows }.into())
    }

    /// Lists the rows in the result. `operator` is named for rows for which nobody else is named.
    pub(super) fn listed_in(
        &self,
        calibration: CompletedCalibration,
        operator: Option<&str>,
    ) -> CompletedCalibration {
        self.asked.iter().fold(calibration, |calibration, Exclusion { rows, reason, by }| {
            let is_own = |row: &&Measurement| rows.contains(row.index) && row.datum.is_first();
            let own: Vec<Measurement> = self.rows.iter().filter(is_own).cloned().collect();
            calibration.with_excluded(&own, by.as_deref().or(operator), reason.as_deref())
        })
    }
}
