//! The posterior of a result as the archive stores it.

use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::estimation::ResultFile;
use crate::estimation::priors::Priors;
use crate::robot::ParamId;

/// The parameters of robot and bar after a run; lengths in mm, angles in rad. Balls and tool differ between runs.
#[derive(Serialize, Deserialize)]
pub struct WrittenPosterior {
    pub parameters: Vec<ParamId>,
    /// Corrections of the nominal values.
    pub corrections: Vec<f64>,
    /// The lower triangle, one row per parameter.
    pub covariance: Vec<Vec<f64>>,
    /// Prior standard deviations; `None` for a parameter without a prior.
    pub prior: Vec<Option<f64>>,
}

impl WrittenPosterior {
    /// The posterior of a result with the text of its `covariance.csv`; `None` if they do not fit each other.
    pub fn of(result: &ResultFile, covariance: &str, priors: &Priors) -> Option<Self> {
        let mut lines = covariance.lines().map(|line| line.split(',').skip(1));
        let ids = lines.next()?.map(|name| name.parse::<ParamId>().ok()).enumerate();
        let kept: Vec<(usize, ParamId)> = ids
            .filter_map(|(at, id)| Some((at, id?)))
            .filter(|(_, id)| id.is_geometric() || matches!(id, ParamId::BarOffset(_)))
            .collect();
        let rows: Vec<Vec<f64>> =
            lines.map(|cells| cells.map(|cell| cell.parse().ok()).collect()).collect::<Option<_>>()?;
        let parameters: Vec<ParamId> = kept.iter().map(|(_, id)| *id).collect();
        let correction = |id: &ParamId| {
            let name = id.to_string();
            Some(result.parameters.iter().find(|parameter| parameter.name == name)?.correction)
        };
        let triangle = kept.iter().enumerate().map(|(row, (at, _))| {
            kept[..=row].iter().map(|(to, _)| rows.get(*at)?.get(*to).copied()).collect()
        });
        Some(Self {
            corrections: parameters.iter().map(correction).collect::<Option<_>>()?,
            covariance: triangle.collect::<Option<_>>()?,
            prior: parameters.iter().map(|id| priors.bound(*id, &[])).collect(),
            parameters,
        })
    }

    /// The stored text.
    pub fn write(&self) -> String {
        json!(self).to_string()
    }

    /// Reads the stored text; `None` if it is not a posterior, or its tables do not fit each other.
    pub fn read(text: &str) -> Option<Self> {
        let written: Self = serde_json::from_str(text).ok()?;
        let size = written.parameters.len();
        let triangle = written.covariance.iter().enumerate().all(|(at, row)| row.len() == at + 1);
        let fits = [written.corrections.len(), written.covariance.len(), written.prior.len()] == [size; 3];
        (triangle && fits).then_some(written)
    }

    /// The difference between the length of the first bar and its certificate, and its standard deviation, mm.
    pub fn bar_offset(&self) -> Option<[f64; 2]> {
        let at = self.parameters.iter().position(|id| matches!(id, ParamId::BarOffset(_)))?;
        Some([*self.corrections.get(at)?, self.covariance.get(at)?.get(at)?.sqrt()])
    }
}
