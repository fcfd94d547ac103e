//! The robots of a type: their mean is an unknown of the plant, their covariance follows by empirical Bayes (EM: Dempster,
//! Laird and Rubin 1977).
//!
//! Everything is in units of the maker's tolerance. The mean is known to one tolerance before any run. The covariance has an
//! inverse Wishart prior about s^2 I, and s^2, the scatter of a type's robots as a share of the tolerance, is estimated too.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::plant::Moments;
use super::{FleetType, RunPosterior};
use crate::robot::ParamId;

/// Values, each of one tolerance, that the scatter starts from: a type of which no robot is known.
const SCATTER_WEIGHT: f64 = 4.0;

/// The robots of a type while they are estimated, in units of `scale`.
pub(super) struct Kind {
    pub(super) name: String,
    pub(super) ids: Vec<ParamId>,
    pub(super) scale: DVector<f64>,
    /// Of a robot about the mean of its type.
    pub(super) covariance: DMatrix<f64>,
}

impl Kind {
    /// How many parameters a robot has.
    pub(super) fn count(&self) -> usize {
        self.ids.len()
    }

    /// The likeliest covariance from the second moments of its robots about the mean. How much it changed, relatively.
    pub(super) fn maximise(&mut self, robots: &[&Moments]) -> f64 {
        let (count, size) = (robots.len() as f64, self.count() as f64);
        let sum = robots
            .iter()
            .fold(DMatrix::zeros(self.count(), self.count()), |sum, robot| sum + &robot.about_mean);
        let scatter = (SCATTER_WEIGHT + sum.trace()) / (SCATTER_WEIGHT + count * size);
        // As many robots as parameters: so many a covariance needs at least to be of full rank.
        let weight = size;
        let prior = DMatrix::identity(self.count(), self.count()) * (weight * scatter);
        let found = (sum + prior) / (count + weight);
        let change = (&found - &self.covariance).norm() / found.norm();
        self.covariance = found;
        change
    }

    /// What a new robot is, the type's mean being known to `mean` and `covariance`.
    pub(super) fn of_type(&self, mean: DVector<f64>, covariance: &DMatrix<f64>, robots: usize) -> FleetType {
        let scale = DMatrix::from_diagonal(&self.scale);
        FleetType {
            kind: self.name.clone(),
            ids: self.ids.clone(),
            mean: mean.component_mul(&self.scale),
            covariance: &scale * (&self.covariance + covariance) * &scale,
            robots,
        }
    }
}

/// The types of the runs' robots, by what they were nominally and by the maker's tolerance.
pub(super) fn kinds(runs: &[RunPosterior]) -> Vec<Kind> {
    let mut found: BTreeMap<&str, BTreeMap<ParamId, f64>> = BTreeMap::new();
    for run in runs {
        let own = found.entry(&run.kind).or_default();
        for (id, prior) in run.ids.iter().zip(&run.prior) {
            if let (true, Some(sd)) = (id.is_geometric(), prior) {
                own.insert(*id, *sd);
            }
        }
    }
    let kind = |(name, own): (&str, BTreeMap<ParamId, f64>)| Kind {
        name: name.into(),
        covariance: DMatrix::identity(own.len(), own.len()),
        scale: DVector::from_iterator(own.len(), own.values().copied()),
        ids: own.into_keys().collect(),
    };
    found.into_iter().map(kind).collect()
}
