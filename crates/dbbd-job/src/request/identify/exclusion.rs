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

    /// Reads `3,7-9` or `3,7-9:why`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (rows, reason) = text.split_once(':').unwrap_or((text, ""));
        let reason = Some(reason.trim()).filter(|reason| !reason.is_empty()).map(str::to_owned);
        Ok(Self { rows: rows.parse()?, reason, by: None })
    }
}

/// Takes the rows out of the observations, and returns them.
///
/// # Errors
/// There is no such row, or no other one.
pub(super) fn leave_out(
    observations: &mut Measurements,
    exclude: &[Exclusion],
) -> Result<Vec<Measurement>, EstimationFinding> {
    let is_asked = |row: &Measurement| exclude.iter().any(|one| one.rows.contains(row.index));
    let (excluded, used): (Vec<_>, Vec<_>) =
        std::mem::take(&mut observations.rows).into_iter().partition(is_asked);
    observations.rows = used;
    let mut asked = exclude.iter().flat_map(|one| one.rows.iter());
    match asked.find(|index| !excluded.iter().any(|row| row.index == *index)) {
        Some(index) => Err(EstimationFinding::NoRowToExclude { index }),
        None if observations.rows.is_empty() => Err(EstimationFinding::NoLength),
        None => Ok(excluded),
    }
}

/// The finding about rows that are left out.
pub(super) fn finding(excluded: &[Measurement]) -> Option<Diagnostic> {
    let mut indices: Vec<u32> = excluded.iter().map(|row| row.index).collect();
    indices.dedup();
    let rows = RowIndices::from_iter(indices.iter().copied()).to_string();
    (!indices.is_empty()).then(|| EstimationFinding::Excluded { count: indices.len(), rows }.into())
}

/// Lists the rows in the result. `operator` left out those for which nobody is named.
pub(super) fn list(
    calibration: CompletedCalibration,
    excluded: &[Measurement],
    exclude: &[Exclusion],
    operator: Option<&str>,
) -> CompletedCalibration {
    exclude.iter().fold(calibration, |calibration, Exclusion { rows, reason, by }| {
        let own: Vec<Measurement> =
            excluded.iter().filter(|row| rows.contains(row.index) && row.datum.is_first()).cloned().collect();
        calibration.with_excluded(&own, by.as_deref().or(operator), reason.as_deref())
    })
}
