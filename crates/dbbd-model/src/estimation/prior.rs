//! The prior as rows of the least-squares problem: each parameter of the robot about its nominal value with its tolerance, a
//! bar that the lengths do not determine with its certificate, or the posterior of an earlier identification.
//!
//! With a prior no parameter has to be fixed as poorly observable. If only a sum of parameters is identifiable, its correction
//! is distributed in proportion to their variances, which is the most probable robot. The set-up has no prior and is free:
//! a parameter that depends on the set-up alone stays at its start.

use nalgebra::{DMatrix, DVector};

use super::Analysis;
use super::options::Setting;
use super::priors::{Prior, Priors};
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// Equations `rows * (p - mean) = 0` of unit variance for the estimated parameters p.
#[derive(Clone, Debug)]
pub(super) struct PriorRows {
    /// Indices of the bound parameters; the others are free.
    bound: Vec<usize>,
    /// Root of the covariance of the bound parameters.
    root: DMatrix<f64>,
    /// Its inverse, with a column for each estimated parameter.
    rows: DMatrix<f64>,
    mean: DVector<f64>,
}

impl PriorRows {
    /// Independent parameters with these standard deviations; `None` for a free parameter.
    pub(super) fn independent(sds: &[Option<f64>], mean: &[f64]) -> Self {
        let bound: Vec<usize> = (0..sds.len()).filter(|&k| sds[k].is_some()).collect();
        let sd = DVector::from_iterator(bound.len(), sds.iter().copied().flatten());
        let mut rows = DMatrix::zeros(bound.len(), sds.len());
        bound.iter().enumerate().for_each(|(row, k)| rows[(row, *k)] = sd[row].recip());
        Self { root: DMatrix::from_diagonal(&sd), rows, mean: DVector::from_column_slice(mean), bound }
    }

    /// The number of bound parameters.
    pub(super) fn count(&self) -> usize {
        self.bound.len()
    }

    /// Standard deviation of the parameter with this index; `None` if it is free.
    pub(super) fn sd(&self, place: usize) -> Option<f64> {
        let at = self.bound.iter().position(|bound| *bound == place)?;
        Some(self.root.row(at).norm())
    }

    /// The coefficients, a row an equation.
    pub(super) fn matrix(&self) -> &DMatrix<f64> {
        &self.rows
    }

    /// The residuals of the equations at a model, whose values of `ids` are p: deviates of unit variance.
    pub(super) fn deviates(&self, model: &LengthModel, ids: &[ParamId]) -> DVector<f64> {
        &self.rows * (values(model, ids) - &self.mean)
    }

    /// The prior about a mean drawn from it, centred on a model.
    pub(super) fn drawn(
        &self,
        model: &LengthModel,
        ids: &[ParamId],
        mut normal: impl FnMut() -> f64,
    ) -> Self {
        let mut mean = values(model, ids);
        let drawn = &self.root * DVector::from_fn(self.count(), |_, _| normal());
        self.bound.iter().zip(&drawn).for_each(|(place, step)| mean[*place] += step);
        Self { mean, ..self.clone() }
    }
}

fn values(model: &LengthModel, ids: &[ParamId]) -> DVector<f64> {
    DVector::from_fn(ids.len(), |k, _| model.value(ids[k]))
}

/// The prior of the parameters `kept` about their values at the start; `None` without a prior.
pub(super) fn rows(
    setting: &Setting<'_>,
    undetermined_bars: &[ParamId],
    kept: &[ParamId],
) -> Option<PriorRows> {
    if setting.options.prior == Prior::None {
        return None;
    }
    let sd = |place: usize| Some((place, setting.priors.bound(kept[place], undetermined_bars)?));
    let (bound, sd): (Vec<usize>, Vec<f64>) = (0..kept.len()).filter_map(sd).unzip();
    let ids: Vec<ParamId> = bound.iter().map(|place| kept[*place]).collect();
    let root = setting.priors.root(&ids, &sd);
    let inverse = root.solve_lower_triangular(&DMatrix::identity(ids.len(), ids.len()))?;
    let mut rows = DMatrix::zeros(ids.len(), kept.len());
    bound.iter().enumerate().for_each(|(at, place)| rows.set_column(*place, &inverse.column(at)));
    Some(PriorRows { bound, root, rows, mean: values(setting.start, kept) })
}

/// The parameters that are estimated because of the prior although they are not in the base set: members of identifiable
/// combinations, and parameters of an earlier identification, whose errors are correlated with those of others.
pub(super) fn sharing(priors: &Priors, undetermined_bars: &[ParamId], analysis: &Analysis) -> Vec<ParamId> {
    let bound = |id: ParamId| priors.bound(id, undetermined_bars).is_some();
    let mut sharing: Vec<ParamId> = analysis
        .combinations()
        .into_iter()
        .filter(|combination| bound(combination.kept))
        .flat_map(|combination| combination.members.into_iter().skip(1).map(|(id, _)| id))
        .filter(|id| bound(*id))
        .collect();
    let others = analysis.dependent().into_iter().chain(analysis.zero());
    sharing.extend(others.filter(|id| priors.is_of_posterior(*id)));
    sharing.sort();
    sharing.dedup();
    sharing
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::measurement::BaseBall;
    use crate::robot::{BallId, BarId, Coordinate, Joint, Robot};

    const IDS: [ParamId; 3] =
        [ParamId::A(Joint::J2), ParamId::Tool(Coordinate::X), ParamId::BarOffset(BarId::FIRST)];

    fn model() -> LengthModel {
        let geometry = Robot::by_name("kr60ha").unwrap().unwrap().geometry;
        let ball = BaseBall { id: BallId::FIRST, position: Vector3::new(1300.0, 0.0, 800.0) };
        LengthModel::new(geometry, &[ball])
    }

    #[test]
    fn rows_divide_by_the_standard_deviation_and_leave_free_parameters_out() {
        let prior = PriorRows::independent(&[Some(0.5), None, Some(0.05)], &[0.0; 3]);
        assert_eq!((prior.count(), prior.sd(0), prior.sd(1), prior.sd(2)), (2, Some(0.5), None, Some(0.05)));
        let expected = DMatrix::from_row_slice(2, 3, &[2.0, 0.0, 0.0, 0.0, 0.0, 20.0]);
        assert!((prior.matrix() - expected).norm() < 1e-12);
    }

    /// a1 is 1.5 mm above its mean, 3 standard deviations; the offset 0.1 mm below, 2 standard deviations.
    #[test]
    fn deviates_are_in_standard_deviations_from_the_mean() {
        let model = model();
        let mean = [model.value(IDS[0]) - 1.5, 77.0, model.value(IDS[2]) + 0.1];
        let prior = PriorRows::independent(&[Some(0.5), None, Some(0.05)], &mean);
        assert!((prior.deviates(&model, &IDS) - DVector::from_row_slice(&[3.0, -2.0])).norm() < 1e-9);
    }

    #[test]
    fn drawn_prior_has_its_mean_so_many_deviations_from_the_model() {
        let model = model();
        let mut draws = [1.0, -2.0].into_iter();
        let prior = PriorRows::independent(&[Some(0.5), None, Some(0.05)], &[0.0; 3]);
        let drawn = prior.drawn(&model, &IDS, || draws.next().unwrap());
        assert!((drawn.deviates(&model, &IDS) - DVector::from_row_slice(&[-1.0, 2.0])).norm() < 1e-9);
        assert_eq!(drawn.matrix(), prior.matrix());
    }
}
