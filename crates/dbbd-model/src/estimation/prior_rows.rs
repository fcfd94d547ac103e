//! The prior as rows of the least-squares problem: each parameter of the robot about its nominal value with its tolerance, a
//! bar that the lengths do not determine with its certificate, or the posterior of an earlier identification.
//!
//! With a prior no parameter has to be fixed as poorly observable. If only a sum of parameters is identifiable, its correction
//! is distributed in proportion to their variances, which is the most probable robot. The set-up has no prior and is free:
//! a parameter that depends on the set-up alone stays at its start.

use nalgebra::{DMatrix, DVector};

use super::Analysis;
use super::options::Setting;
use super::priors::Priors;
use super::selection::is_bar;
use crate::math::Triangle;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// Equations `rows * (p - mean) = 0` of unit variance for the estimated parameters p.
#[derive(Clone, Debug)]
pub(super) struct PriorRows {
    /// The inverse root of the covariance of the bound parameters, with a column for each estimated parameter.
    rows: DMatrix<f64>,
    mean: DVector<f64>,
}

impl PriorRows {
    /// Adds the rows to a system of `ids` and perhaps more parameters at `model`. Returns the sum of squares of their
    /// right-hand sides.
    pub(super) fn add_to(&self, system: &mut Triangle, model: &LengthModel, ids: &[ParamId]) -> f64 {
        let deviates = self.deviates(model, ids);
        let mut values = vec![0.0; system.unknowns()];
        for (row, deviate) in self.rows.row_iter().zip(&deviates) {
            values.iter_mut().zip(row.iter()).for_each(|(value, own)| *value = *own);
            system.push(&values, -deviate);
        }
        deviates.norm_squared()
    }

    /// The residuals of the equations at a model, whose values of `ids` are p: deviates of unit variance.
    pub(super) fn deviates(&self, model: &LengthModel, ids: &[ParamId]) -> DVector<f64> {
        &self.rows * (values(model, ids) - &self.mean)
    }
}

fn values(model: &LengthModel, ids: &[ParamId]) -> DVector<f64> {
    DVector::from_fn(ids.len(), |k, _| model.value(ids[k]))
}

/// The prior of the parameters `kept` about their values at the start. If a list is estimated without a prior, only
/// bars have one.
pub(super) fn prior_rows(setting: &Setting<'_>, kept: &[ParamId]) -> Option<PriorRows> {
    let follows_list = setting.options.follows_list();
    let is_bound = |id: &ParamId| !follows_list || is_bar(id);
    let sd = |place: usize| {
        let id = Some(kept[place]).filter(is_bound)?;
        Some((place, setting.priors.bound_at_start(id)?))
    };
    let (bound, sd): (Vec<usize>, Vec<f64>) = (0..kept.len()).filter_map(sd).unzip();
    if bound.is_empty() {
        return None;
    }
    let ids: Vec<ParamId> = bound.iter().map(|place| kept[*place]).collect();
    let root = setting.priors.root(&ids, &sd);
    let inverse = root.solve_lower_triangular(&DMatrix::identity(ids.len(), ids.len()))?;
    let mut rows = DMatrix::zeros(ids.len(), kept.len());
    bound.iter().enumerate().for_each(|(at, place)| rows.set_column(*place, &inverse.column(at)));
    Some(PriorRows { rows, mean: values(setting.start, kept) })
}

/// The parameters that are estimated because of the prior although they are not in the base set: members of identifiable
/// combinations, and parameters of an earlier identification, whose errors are correlated with those of others.
pub(super) fn sharing(priors: &Priors, analysis: &Analysis) -> Vec<ParamId> {
    let bound = |id: ParamId| priors.bound(id).is_some();
    let mut sharing: Vec<ParamId> = analysis
        .combinations()
        .into_iter()
        .filter(|combination| bound(combination.kept))
        .flat_map(|combination| combination.members.into_iter().skip(1).map(|(id, _)| id))
        .filter(|id| bound(*id))
        .collect();
    let others = analysis.dependent().into_iter().chain(analysis.zero());
    sharing.extend(others.filter(|id| priors.is_of_posterior(*id)));
    // A parameter that does not move this tool ball moves another tool.
    sharing.extend(analysis.zero().into_iter().filter(|id| id.is_geometric()));
    sharing.sort();
    sharing.dedup();
    sharing
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::estimation::Options;
    use crate::measurement::{BaseBall, Measurements};
    use crate::robot::{BallId, BarId, Coordinate, Joint, Robot};

    const IDS: [ParamId; 3] =
        [ParamId::A(Joint::J2), ParamId::Tool(Coordinate::X), ParamId::BarOffset(BarId::FIRST)];

    fn model() -> LengthModel {
        let geometry = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry;
        let ball = BaseBall { id: BallId::FIRST, position: Vector3::new(1300.0, 0.0, 800.0) };
        LengthModel::new(geometry, &[ball])
    }

    /// The prior of a1 and the bar's offset, whose rows have these inverse standard deviations.
    fn rows_of([length, bar]: [f64; 2], mean: [f64; 3]) -> PriorRows {
        let rows = DMatrix::from_row_slice(2, 3, &[length, 0.0, 0.0, 0.0, 0.0, bar]);
        PriorRows { rows, mean: DVector::from_column_slice(&mean) }
    }

    /// The tolerance of a1 is 0.5 mm, a certificate of 0.05 mm; the ball is free.
    #[test]
    fn rows_divide_by_the_standard_deviation_and_leave_free_parameters_out() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let (start, options) = (model(), Options { bar_u_mm: Some(0.05), ..Options::default() });
        let setting = Setting::new(&robot, &start, &Measurements::default(), &options);
        let ids = [IDS[0], ParamId::Ball(BallId::FIRST, Coordinate::X), IDS[2]];
        let prior = prior_rows(&setting, &ids).unwrap();
        let expected = DMatrix::from_row_slice(2, 3, &[2.0, 0.0, 0.0, 0.0, 0.0, 20.0]);
        assert!((&prior.rows - expected).norm() < 1e-12);
    }

    /// a1 is 1.5 mm above its mean, 3 standard deviations; the offset 0.1 mm below, 2 standard deviations.
    #[test]
    fn deviates_are_in_standard_deviations_from_the_mean() {
        let model = model();
        let mean = [model.value(IDS[0]) - 1.5, 77.0, model.value(IDS[2]) + 0.1];
        let prior = rows_of([2.0, 20.0], mean);
        assert!((prior.deviates(&model, &IDS) - DVector::from_row_slice(&[3.0, -2.0])).norm() < 1e-9);
    }
}
