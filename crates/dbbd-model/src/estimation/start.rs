//! The start of an estimate: the set-up is fitted to the nominal robot, the base set is chosen there, and the
//! parameters are fitted with their prior, without errors that a nominal robot cannot have.

use nalgebra::{DMatrix, SymmetricEigen};

use super::Analysis;
use super::fit::{self, Fit};
use super::hyper_parameters::{Group, Variance};
use super::lengths::{Lengths, Sigma};
use super::linear_system::{factor, linear_system};
use super::options::Setting;
use super::prior_rows;
use super::priors::{FAR_BAR_MM, Prior, WEAK, largest_plausible};
use super::selection::{is_bar, is_place, open_places, without_open_places};
use super::unknowns::KnownBefore;
use crate::estimation::EstimationFinding;
use crate::math::{Triangle, stacked};
use crate::measurement::LengthModel;
use crate::robot::{ParamGroup, ParamId, parameter};

/// Least standard deviation of a length, mm, so that exact data cause no division by zero.
const FLOOR_MM: f64 = 1e-9;

/// Largest number of single parameters that may be far beyond their tolerance, such as a lost zero.
const MAX_FAR: usize = 2;
/// Standard uncertainties beyond which a tool ball was not measured.
const GUESSED: f64 = 10.0;

#[derive(Clone, Debug)]
pub(super) struct EstimateStart {
    /// The nominal robot with the free part of the set-up fitted.
    pub(super) before: LengthModel,
    /// The same model with bars as stated.
    pub(super) at_start: LengthModel,
    pub(super) analysis: Analysis,
    /// The parameters to estimate, in canonical order.
    pub(super) kept: Vec<ParamId>,
    /// The parameters to estimate that are independent by the lengths alone.
    pub(super) base: Vec<ParamId>,
    /// Coordinates of the set-up that the poses do not determine, worst first.
    pub(super) open: Vec<ParamId>,
    pub(super) fit: Fit,
    pub(super) sigma: Sigma,
}

impl EstimateStart {
    pub(super) fn of(
        setting: &Setting<'_>,
        lengths: &Lengths,
        asked: &[ParamId],
    ) -> Result<Self, EstimationFinding> {
        const NOT_FINITE: EstimationFinding = EstimationFinding::NotFinite;
        let (priors, follows_list) = (&setting.priors, setting.options.follows_list());
        let mut free = asked.to_vec();
        if !follows_list {
            free = without_open_places(priors, setting.start, &lengths.plain(), asked).ok_or(NOT_FINITE)?;
        }
        // A fit of the set-up alone must not change what an earlier identification determined.
        free.retain(|id| !priors.is_of_posterior(*id));
        let before = fit::set_up(lengths, &free, setting.start);
        // Nor may the fit begin with a bar of any length.
        let without_bars: Vec<ParamId> =
            free.iter().copied().filter(|id| follows_list || !is_bar(id)).collect();
        let set_up = match without_bars.len() < free.len() {
            true => fit::set_up(lengths, &without_bars, setting.start),
            false => before.clone(),
        };
        let mut open = Vec::new();
        let (analysis, rows) = loop {
            let mut judged: Vec<ParamId> = asked.iter().copied().filter(|id| !open.contains(id)).collect();
            judged.sort();
            let mut rows = linear_system(&set_up.model, &lengths.plain(), &judged);
            let analysis = Analysis::of(judged, &mut rows).ok_or(NOT_FINITE)?;
            if follows_list {
                break (analysis, rows);
            }
            let mut places = analysis.kept();
            places.retain(|id| is_place(id) && !priors.is_of_posterior(*id));
            let more = open_places(priors, &set_up.model, &lengths.plain(), places);
            if more.is_empty() {
                break (analysis, rows);
            }
            open.extend(more);
        };
        let base = analysis.kept();
        if base.is_empty() {
            return Err(EstimationFinding::NothingToEstimate);
        }
        let mut kept = base.clone();
        if !follows_list {
            kept.extend(prior_rows::sharing(priors, &analysis));
            kept.sort();
        }
        let sigma = start_sigma(lengths, &set_up, &analysis, rows);
        let prior = prior_rows::prior_rows(setting, &kept);
        let fit = fit::all(lengths, sigma, &kept, base.len(), prior.as_ref(), follows_list, &set_up.model);
        let iterations = set_up.iterations + fit.iterations;
        let fit = Fit { iterations, ..fit };
        Ok(Self { before: before.model, at_start: set_up.model, analysis, kept, base, open, fit, sigma })
    }

    /// The prior of the unknowns of an estimate.
    pub(super) fn known_before(&self, setting: &Setting<'_>, lengths: &Lengths) -> Option<KnownBefore> {
        let Setting { options, priors, start, .. } = setting;
        if options.follows_list() {
            // A list says nothing about the length of a bar, and without a prior of the robot nothing else does. A bar
            // without a certificate has the full standard deviation of Student's t with four degrees of freedom.
            let far_mm = std::f64::consts::SQRT_2 * FAR_BAR_MM;
            let sd = |id: ParamId| if priors.is_certified() { priors.bound(id) } else { Some(far_mm) };
            let ids = self.kept.clone();
            let of_bar = |id: &ParamId| sd(*id).filter(|_| is_bar(id)).map(Variance::Fixed);
            let variances: Vec<Option<Variance>> = ids.iter().map(of_bar).collect();
            let means =
                ids.iter().zip(&variances).map(|(id, v)| v.map_or(0.0, |_| start.value(*id))).collect();
            return Some(KnownBefore { ids, means, variances, ..KnownBefore::default() });
        }
        let is_fixed = |id: &ParamId| options.hold.contains(id) || self.kept.contains(id);
        let optional = parameter::optional().filter(|id| !is_fixed(id));
        let optional = optional.filter(|_| options.estimate.is_none());
        let mut ids: Vec<ParamId> = self.kept.iter().copied().chain(optional).collect();
        ids.sort();
        // An implausible correction that the geometry finds, such as a lost zero, is no draw from the prior. The prior
        // is widened to its size, so that it costs errors of the joints and geometry the same.
        let correction = |id: ParamId| (self.fit.model.value(id) - start.value(id)).abs();
        let is_far = |id: &ParamId| {
            priors.bound_at_start(*id).is_some_and(|sd| correction(*id) > largest_plausible(true) * sd)
        };
        // If several are far, the tolerance is too small.
        let few = self.kept.iter().filter(|id| id.is_geometric() && is_far(id)).count() <= MAX_FAR;
        let widened = |id: ParamId, sd: f64| {
            (few && correction(id) > largest_plausible(true) * sd).then(|| correction(id))
        };
        let variance = |id: &ParamId| match id.group() {
            ParamGroup::Compliance => Some(Variance::Of(Group::Compliance, priors.sd(*id))),
            ParamGroup::Gear => Some(Variance::Of(Group::Harmonic, 1.0)),
            ParamGroup::Tool if !priors.is_of_posterior(*id) => {
                // The position of a tool ball that is centimetres away was not measured, but guessed.
                let guessed = |sd: f64| correction(*id) > GUESSED * sd;
                let variance = |sd| {
                    if guessed(sd) { Variance::Fixed(correction(*id)) } else { Variance::Of(Group::Tool, sd) }
                };
                priors.bound(*id).map(variance)
            }
            ParamGroup::Geometric if options.prior == Prior::Datasheet => priors
                .bound(*id)
                .map(|sd| widened(*id, sd).map_or(Variance::Of(Group::Tolerance, sd), Variance::Fixed)),
            ParamGroup::Bar if !priors.is_certified() => Some(Variance::Fixed(FAR_BAR_MM)),
            ParamGroup::Geometric
            | ParamGroup::Tool
            | ParamGroup::Targets
            | ParamGroup::Balls
            | ParamGroup::Bar
            | ParamGroup::Tracker => {
                priors.bound(*id).map(|sd| Variance::Fixed(widened(*id, sd).unwrap_or(sd)))
            }
        };
        let are_bars_uncertified = !priors.is_certified();
        let variances: Vec<Option<Variance>> = ids.iter().map(variance).collect();
        let means = ids.iter().zip(&variances).map(|(id, v)| v.map_or(0.0, |_| start.value(*id))).collect();
        let known = KnownBefore { ids, means, variances, are_bars_uncertified, ..KnownBefore::default() };
        match options.prior {
            Prior::Posterior => continued(setting, known),
            Prior::None => self.judged_by_data(setting, lengths, known),
            Prior::Datasheet | Prior::Given(_) => Some(known),
        }
    }

    /// The prior without a prior of the geometry, except in directions that the data determine worse than three
    /// tolerances.
    fn judged_by_data(
        &self,
        setting: &Setting<'_>,
        lengths: &Lengths,
        known: KnownBefore,
    ) -> Option<KnownBefore> {
        /// Standard deviation in tolerances of a direction that counts as free.
        const FREE: f64 = 1e4;
        let is_judged = |id: &ParamId| id.is_geometric();
        let (own, others): (Vec<usize>, Vec<usize>) =
            (0..known.ids.len()).partition(|at| is_judged(&known.ids[*at]));
        let set_up: Vec<usize> = others.iter().copied().filter(|at| known.ids[*at].is_setup()).collect();
        let weighted = lengths.weighted(self.sigma, &self.fit.outliers);
        // The set-up comes first and is eliminated: the rest of the geometry's rows then shows what the data determine.
        let order: Vec<ParamId> = set_up.iter().chain(&own).map(|at| known.ids[*at]).collect();
        let mut sorted = order.clone();
        sorted.sort();
        let whole = factor(&self.at_start, &weighted, &sorted);
        let places: Vec<usize> = order.iter().filter_map(|id| sorted.binary_search(id).ok()).collect();
        let mut rows = whole.select_columns(&places);
        for (mut column, id) in rows.column_iter_mut().zip(&order).skip(set_up.len()) {
            column *= setting.priors.geometric(*id)?;
        }
        let mut bound = DMatrix::zeros(set_up.len(), order.len());
        // A bar without a certificate says nothing about the size of the robot.
        let says_size = |id: &ParamId| !is_bar(id) || setting.priors.is_certified();
        for (row, at) in set_up.iter().enumerate() {
            let id = Some(known.ids[*at]).filter(says_size);
            bound[(row, row)] = id.and_then(|id| setting.priors.bound(id)).map_or(0.0, f64::recip);
        }
        let triangle = stacked(&rows, &bound).qr().r();
        let size = own.len();
        let left = triangle.view((set_up.len(), set_up.len()), (size, size)).into_owned();
        let eigen = SymmetricEigen::new(left.tr_mul(&left));
        let mut transform = DMatrix::zeros(known.ids.len(), known.ids.len());
        let mut variances = known.variances.clone();
        for at in others {
            transform[(at, at)] = 1.0;
        }
        for (column, at) in own.iter().enumerate() {
            let is_weak = eigen.eigenvalues[column] < WEAK.powi(-2);
            variances[*at] = Some(Variance::Fixed(if is_weak { 1.0 } else { FREE }));
            for (row, to) in own.iter().enumerate() {
                let sd = setting.priors.geometric(known.ids[*to])?;
                transform[(*to, *at)] = sd * eigen.eigenvectors[(row, column)];
            }
        }
        Some(KnownBefore { transform: Some(transform), variances, ..known })
    }
}

/// The prior from the posterior of an earlier identification: parameters, and coefficients of the joints' errors.
fn continued(setting: &Setting<'_>, known: KnownBefore) -> Option<KnownBefore> {
    let uncertainty = setting.robot.known_uncertainty();
    let KnownBefore { ids, are_bars_uncertified, .. } = known;
    // A tool ball that is not in the posterior is not the one of the identification.
    let is_here = |id: &ParamId| match id.group() {
        ParamGroup::Balls => false,
        ParamGroup::Tool => setting.priors.is_of_posterior(*id),
        ParamGroup::Geometric
        | ParamGroup::Targets
        | ParamGroup::Bar
        | ParamGroup::Tracker
        | ParamGroup::Compliance
        | ParamGroup::Gear => true,
    };
    let is_robots = |id: &ParamId| uncertainty.parameters.contains(id) && is_here(id);
    // Harmonics and compliance that the robot does not have are not added.
    let ids: Vec<ParamId> = ids.into_iter().filter(|id| !id.is_optional() || is_robots(id)).collect();
    let own: Vec<usize> = (0..ids.len()).filter(|at| is_robots(&ids[*at])).collect();
    let (coefficients, columns) = (setting.start.geometry.joint_errors.count(), uncertainty.root.ncols());
    let rest: Vec<usize> = (0..ids.len()).filter(|at| !own.contains(at)).collect();
    let mut transform = DMatrix::zeros(ids.len() + coefficients, columns + rest.len());
    for at in &own {
        let row = uncertainty.parameters.iter().position(|id| *id == ids[*at])?;
        transform.view_mut((*at, 0), (1, columns)).copy_from(&uncertainty.root.row(row));
    }
    for term in 0..coefficients {
        let row = uncertainty.root.row(uncertainty.parameters.len() + term);
        transform.view_mut((ids.len() + term, 0), (1, columns)).copy_from(&row);
    }
    let mut variances = vec![Some(Variance::Fixed(1.0)); columns];
    for (at, place) in rest.iter().enumerate() {
        transform[(*place, columns + at)] = 1.0;
        variances.push(setting.priors.bound(ids[*place]).map(|sd| match ids[*place].group() {
            ParamGroup::Tool => Variance::Of(Group::Tool, sd),
            ParamGroup::Geometric
            | ParamGroup::Targets
            | ParamGroup::Balls
            | ParamGroup::Bar
            | ParamGroup::Tracker
            | ParamGroup::Compliance
            | ParamGroup::Gear => Variance::Fixed(sd),
        }));
    }
    let means = ids.iter().map(|id| setting.start.value(*id)).collect();
    Some(KnownBefore {
        ids,
        means,
        variances,
        transform: Some(transform),
        has_coefficients: true,
        are_bars_uncertified,
    })
}

/// The standard deviation of the lengths from the residuals of a linearised fit of the base set, with which a fit begins.
/// `rows` are those of all lengths at the fitted set-up, by the analysed parameters.
fn start_sigma(lengths: &Lengths, set_up: &Fit, analysis: &Analysis, mut rows: Triangle) -> Sigma {
    let repeatability = lengths.repeatability_mm.unwrap_or(0.0).powi(2);
    if lengths.is_sigma_given {
        return Sigma::Given;
    }
    let used = lengths.weighted(Sigma::All(1.0), &set_up.outliers);
    if !set_up.outliers.is_empty() {
        rows = linear_system(&set_up.model, &used, &analysis.ids);
    }
    let freedom = used.count() as f64 - analysis.base.rank as f64;
    // Equal lengths determine the bar and the scale of the robot only together. With a free bar a robot of size zero
    // would fit them with any angles.
    let sized: Vec<usize> =
        analysis.base.kept.iter().copied().filter(|at| !is_bar(&analysis.ids[*at])).collect();
    let scatter = match freedom > 0.0 {
        true => rows.of_unknowns(&sized).residual_sum().max(0.0) / freedom,
        false => repeatability,
    };
    match lengths.known {
        true => Sigma::And(scatter),
        false => Sigma::All(scatter.sqrt().max(FLOOR_MM)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::cell_of_poses::base_balls;
    use super::*;
    use crate::estimation::Options;
    use crate::robot::{BarId, Joint};
    use crate::test_support::cell::{CENTRE, horizontal, kr60, measure, with_errors};

    /// A list leaves the robot without a prior, but not the bar: Student's t with scale 0.5 mm and four degrees of freedom has the
    /// variance 0.25 * 4 / 2 mm^2.
    #[test]
    fn a_list_leaves_the_bar_what_is_known_of_it() {
        let data = measure(&with_errors([("a1", 0.4)]), &[horizontal(1, CENTRE)], 40, 25.0);
        let robot = kr60();
        let ids = vec![ParamId::A(Joint::J2), ParamId::BarOffset(BarId::FIRST)];
        let start = LengthModel::new(robot.geometry.clone(), &base_balls(1));
        for (bar_u_mm, variance) in [(None, 0.5f64), (Some(0.003), 9e-6)] {
            let estimate = Some(ids.clone());
            let options = Options { estimate, prior: Prior::None, bar_u_mm, ..Options::default() };
            let setting = Setting::new(&robot, &start, &data, &options);
            let lengths = Lengths::of(&data.rows, &options, &robot);
            let found = EstimateStart::of(&setting, &lengths, &setting.asked()).unwrap();
            let known = found.known_before(&setting, &lengths).unwrap();
            assert_eq!((known.ids.as_slice(), known.variances[0]), (ids.as_slice(), None));
            let Some(Variance::Fixed(sd)) = known.variances[1] else { panic!("{:?}", known.variances) };
            assert!((sd * sd / variance - 1.0).abs() < 1e-12 && !known.are_bars_uncertified, "{sd}");
        }
    }

    /// The information of the lengths of one circle about the directions of the transform, in tolerances, with the
    /// set-up eliminated from dense normal equations by its Schur complement.
    #[test]
    fn without_a_prior_directions_that_the_data_do_not_know_have_the_tolerance() {
        let circles = [horizontal(1, CENTRE)];
        let data = measure(&with_errors([("a1", 0.4), ("d4", -0.3)]), &circles, 40, 25.0);
        let (robot, options) =
            (kr60(), Options { prior: Prior::None, sigma_mm: Some(0.02), ..Options::default() });
        let start = LengthModel::new(robot.geometry.clone(), &base_balls(1));
        let setting = Setting::new(&robot, &start, &data, &options);
        let lengths = Lengths::of(&data.rows, &options, &robot);
        let found = EstimateStart::of(&setting, &lengths, &setting.asked()).unwrap();
        let known = found.known_before(&setting, &lengths).unwrap();
        let transform = known.transform.as_ref().unwrap();
        let is_own = |at: &usize| known.ids[*at].is_geometric();
        let (own, rest): (Vec<usize>, Vec<usize>) = (0..known.ids.len()).partition(is_own);
        let set_up: Vec<usize> = rest.iter().copied().filter(|at| known.ids[*at].is_setup()).collect();
        let ids: Vec<ParamId> = set_up.iter().chain(&own).map(|at| known.ids[*at]).collect();
        let mut sorted = ids.clone();
        sorted.sort();
        let rows = factor(&found.before, &lengths.weighted(found.sigma, &found.fit.outliers), &sorted);
        let places: Vec<usize> = ids.iter().map(|id| sorted.binary_search(id).unwrap()).collect();
        let mut rows = rows.select_columns(&places);
        // The set-up in units of a millimetre, the geometry in tolerances.
        for (mut column, id) in rows.column_iter_mut().zip(&ids) {
            column *= setting.priors.geometric(*id).unwrap_or(1.0);
        }
        let mut normal = rows.tr_mul(&rows);
        for (row, id) in ids[..set_up.len()].iter().enumerate() {
            let bound = setting.priors.bound(*id).filter(|_| !is_bar(id));
            normal[(row, row)] += bound.map_or(0.0, |sd| sd.powi(-2));
        }
        let (s, g) = (set_up.len(), own.len());
        let of_set_up = normal.view((0, 0), (s, s)).into_owned();
        let across = normal.view((0, s), (s, g)).into_owned();
        let left =
            normal.view((s, s), (g, g)) - across.transpose() * of_set_up.try_inverse().unwrap() * across;
        let (mut weak, mut strong) = (0, 0);
        for at in &own {
            let direction = nalgebra::DVector::from_iterator(
                g,
                own.iter()
                    .map(|to| transform[(*to, *at)] / setting.priors.geometric(known.ids[*to]).unwrap()),
            );
            assert!((direction.norm() - 1.0).abs() < 1e-9);
            let information = direction.dot(&(&left * &direction));
            match known.variances[*at] {
                Some(Variance::Fixed(1.0)) => {
                    weak += 1;
                    assert!(information < 1.0 / 9.0 + 1e-6, "{information}");
                }
                Some(Variance::Fixed(1e4)) => {
                    strong += 1;
                    assert!(information > 1.0 / 9.0 - 1e-6, "{information}");
                }
                other => panic!("{other:?}"),
            }
        }
        assert!(weak > 0 && strong > 0, "{weak} {strong}");
        // The others are their own.
        for at in rest {
            assert_eq!(transform.column(at).iter().filter(|share| **share != 0.0).count(), 1);
            assert_eq!(transform[(at, at)], 1.0);
        }
    }
}
