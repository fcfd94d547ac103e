//! The posterior of a result, as a worker writes it.

use serde::Deserialize;

use crate::robot::ParamId;

/// Robot and bar after a run; lengths in mm, angles in rad.
#[derive(Deserialize)]
pub struct WrittenPosterior {
    pub parameters: Vec<ParamId>,
    /// Of the nominal values.
    pub corrections: Vec<f64>,
    /// The lower triangle, a row for each parameter.
    pub covariance: Vec<Vec<f64>>,
    /// Standard deviations beforehand; none of what was free.
    pub prior: Vec<Option<f64>>,
}

impl WrittenPosterior {
    /// `None` of what is no posterior, or whose tables do not fit each other.
    pub fn read(text: &str) -> Option<Self> {
        let written: Self = serde_json::from_str(text).ok()?;
        let size = written.parameters.len();
        let triangle = written.covariance.iter().enumerate().all(|(at, row)| row.len() == at + 1);
        let fits = [written.corrections.len(), written.covariance.len(), written.prior.len()] == [size; 3];
        (triangle && fits).then_some(written)
    }

    /// By how much the first bar is longer than its certificate, with its standard deviation, mm.
    pub fn bar_offset(&self) -> Option<[f64; 2]> {
        let at = self.parameters.iter().position(|id| matches!(id, ParamId::BarOffset(_)))?;
        Some([*self.corrections.get(at)?, self.covariance.get(at)?.get(at)?.sqrt()])
    }
}
