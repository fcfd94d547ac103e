//! The types of robots, and the information of a run on a robot of a type.
//!
//! The mean of a type is an unknown of the plant, its covariance follows by empirical Bayes (EM: Dempster, Laird and Rubin
//! 1977). Everything is in units of the manufacturer's tolerance. The prior standard deviation of the mean is one tolerance.
//! The covariance has an inverse Wishart prior about s^2 I, where s, the scatter of a type's robots in tolerances, is
//! estimated too.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::{FleetType, RunPosterior, inverse};
use dbbd_model::robot::ParamId;

/// Weight of the prior scatter of one tolerance, as a number of values.
const SCATTER_WEIGHT: f64 = 4.0;
/// Directions in which a run's lengths reduce the variance by a smaller fraction have no information.
const MIN_SHARE: f64 = 1e-9;

/// The robots of a type, in units of `scale`.
pub(super) struct Kind {
    pub(super) name: String,
    pub(super) ids: Vec<ParamId>,
    pub(super) scale: DVector<f64>,
    /// Covariance of a robot about the mean of its type.
    pub(super) covariance: DMatrix<f64>,
}

/// The posterior of a robot.
pub(super) struct Moments {
    pub(super) mean: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Second moment about the mean of its type.
    pub(super) about_mean: DMatrix<f64>,
}

impl Kind {
    /// The number of parameters of a robot.
    pub(super) fn count(&self) -> usize {
        self.ids.len()
    }

    /// Updates the covariance from the second moments of the robots about the mean. Returns its relative change.
    pub(super) fn maximise(&mut self, robots: &[&Moments]) -> f64 {
        let (count, size) = (robots.len() as f64, self.count() as f64);
        let sum = robots
            .iter()
            .fold(DMatrix::zeros(self.count(), self.count()), |sum, robot| sum + &robot.about_mean);
        let scatter = (SCATTER_WEIGHT + sum.trace()) / (SCATTER_WEIGHT + count * size);
        // A covariance of full rank needs at least as many robots as parameters.
        let weight = size;
        let prior = DMatrix::identity(self.count(), self.count()) * (weight * scatter);
        let found = (sum + prior) / (count + weight);
        let change = (&found - &self.covariance).norm() / found.norm();
        self.covariance = found;
        change
    }

    /// The prior of a new robot, with this mean of the type and its `covariance`.
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

/// The types of the runs' robots, with the parameters that have a tolerance.
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

/// The information of a run's lengths alone, without its prior, on the parameters of its kind (scaled) and on the offset of its
/// bar (last). `None` if the run has no bar offset or its covariance is singular.
pub(super) fn information(run: &RunPosterior, kind: &Kind) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let count = kind.count();
    let place = |id: &ParamId| {
        if matches!(id, ParamId::BarOffset(_)) {
            Some(count)
        } else {
            kind.ids.iter().position(|own| own == id)
        }
    };
    // The index in the run, the index in the result, and the scale of each parameter.
    let kept: Vec<(usize, usize, f64)> = (run.ids.iter().enumerate())
        .filter_map(|(at, id)| Some((at, place(id)?)))
        .map(|(at, to)| (at, to, if to == count { 1.0 } else { kind.scale[to] }))
        .collect();
    let n = kept.len();
    let covariance = DMatrix::from_fn(n, n, |i, j| {
        let ((row, _, row_scale), (column, _, column_scale)) = (kept[i], kept[j]);
        run.covariance[(row, column)] / (row_scale * column_scale)
    });
    let all = inverse(&covariance)?;
    let mean = DVector::from_iterator(n, kept.iter().map(|(at, _, scale)| run.corrections[*at] / scale));
    let prior = kept.iter().map(|(at, _, scale)| run.prior[*at].map_or(0.0, |sd| (scale / sd).powi(2)));
    let prior: Vec<f64> = prior.collect();
    // In units of the prior its information is 1 in each direction, so that smaller eigenvalues are rounding.
    let unit = |i: usize| if prior[i] > 0.0 { prior[i].sqrt() } else { all[(i, i)].sqrt() };
    let unit: Vec<f64> = (0..n).map(unit).collect();
    let whitened = DMatrix::from_fn(n, n, |i, j| {
        (all[(i, j)] - if i == j { prior[i] } else { 0.0 }) / (unit[i] * unit[j])
    });
    let eigen = whitened.symmetric_eigen();
    let values = eigen.eigenvalues.map(|value| if value > MIN_SHARE { value } else { 0.0 });
    let data = &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose();
    let weighted = &all * mean;
    let (mut matrix, mut rhs) = (DMatrix::zeros(count + 1, count + 1), DVector::zeros(count + 1));
    for (i, &(_, row, _)) in kept.iter().enumerate() {
        rhs[row] = weighted[i];
        for (j, &(_, column, _)) in kept.iter().enumerate() {
            matrix[(row, column)] = data[(i, j)] * unit[i] * unit[j];
        }
    }
    kept.iter().any(|(_, to, _)| *to == count).then_some((matrix, rhs))
}
