//! Assembles the result: parameters with their fate, residuals, predicted error, warnings.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use super::covariance::{Spread, leaked, spread};
use super::diagnosis::{self, Seen};
use super::estimate::{Estimate, IdentifyError};
use super::lengths::{Lengths, Weighted};
use super::options::Options;
use super::places::{is_place, open_mm};
use super::prior::PriorRows;
use super::result::{
    BeforeAfter, Dependent, Folds, Identification, Outlier, ParameterResult, PredictedError, PredictedPair,
    Residual, SigmaSource, Status,
};
use super::{ErrorMap, Identified, joints, verdict};
use crate::identifiability::{Combination, ErrorSummary, Estimator, Workspace, factor};
use crate::linalg::base_set;
use crate::model::parameter::{self, SetUp};
use crate::model::{LengthModel, Observation, Observations, ParamId, Reading, Readings, Robot};

#[allow(clippy::too_many_arguments)] // the parts of one result, each used once
pub(super) fn summarise(
    robot: &Robot,
    observations: &Observations,
    start: &LengthModel,
    lengths: &Lengths,
    estimate: &Estimate,
    folds: Option<Folds>,
    validation: Option<&Observations>,
    options: &Options,
) -> Result<Identified, IdentifyError> {
    let model = &estimate.fit.model;
    let used = estimate.used(lengths);
    let mut spread = spread(model, &used, &estimate.kept, &estimate.base, estimate.prior.as_ref())
        .ok_or(IdentifyError::NotFinite)?;
    let tolerances = options.tolerances(robot);
    if estimate.prior.is_none() && !estimate.weak.is_empty() {
        spread.covariance += leaked(tolerances, model, &used, &estimate.kept, &estimate.weak)
            .ok_or(IdentifyError::NotFinite)?;
    }
    let residual_mm = residuals(&estimate.before, model, &used).ok_or(IdentifyError::NotFinite)?;
    let nominal = nominal_model(robot, start);
    let set_up = SetUp { centres: start.centres.len(), bars: observations.bars() };
    let parameters = parameters(robot, set_up, &nominal, start, estimate, &spread, options);
    let after = model.prepare();
    let set_aside = estimate.fit.out.iter().map(|&at| (&observations.rows[at], lengths.reading(at)));
    let outlier = |(row, reading): (&Observation, Reading)| Outlier {
        index: row.index,
        centre: row.centre,
        residual_mm: reading.length - after.length(&reading),
    };
    let outliers = set_aside.map(outlier).collect();
    let (predicted_pair, predicted, seen) = predicted(robot, estimate, &used, options)?;
    let sigma_mm = used.rms_sigma();
    if !sigma_mm.is_finite() {
        return Err(IdentifyError::NotFinite);
    }
    let on_both = |set| {
        let (before, after) = (residual_on(&estimate.before, set)?, residual_on(model, set)?);
        Some(BeforeAfter { before, after })
    };
    let validation = validation.map(|set| on_both(set).ok_or(IdentifyError::NotFinite)).transpose()?;
    let told = told(&parameters);
    let pinned = verdict::is_pinned(&predicted_pair);
    let mut result = Identification {
        schema: 1,
        robot: robot.name.clone(),
        observations: used.count(),
        rank: estimate.analysis.base.rank,
        rank_at_solution: rank_at(model, &lengths.plain(), &estimate.analysis.ids)?,
        condition: estimate.analysis.base.condition,
        observability: diagnosis::indices(robot, &seen, &told, used.count(), sigma_mm),
        iterations: estimate.fit.iterations,
        converged: estimate.fit.converged,
        sigma_mm,
        residual_mm,
        sigma_source: SigmaSource::default(),
        sigma_freedom: None,
        coverage_factor: None,
        prior: None,
        groups: Vec::new(),
        monte_carlo: None,
        folds,
        validation,
        predicted_position_error_mm: predicted_pair,
        parameters,
        dependent: dependent(estimate),
        correlated: diagnosis::correlated(estimate, &spread.covariance),
        advice: diagnosis::advice(
            robot,
            (start, estimate),
            &used,
            &seen,
            &told,
            (&predicted_pair, pinned),
            options,
        ),
        joints: if estimate.fit.converged {
            joints::effects(model, &used, &estimate.base)
        } else {
            Vec::new()
        },
        outliers,
        warnings: Vec::new(),
    };
    result.warnings = verdict::warnings(&result, estimate, lengths, spread.parameters, robot, options);
    Ok(Identified {
        robot: identified_robot(robot, model),
        model: model.clone(),
        estimated: estimate.kept.clone(),
        covariance: spread.covariance,
        before: estimate.before.clone(),
        out: estimate.fit.out.clone(),
        predicted,
        result,
    })
}

/// The parameters that the data tell.
fn told(parameters: &[ParameterResult]) -> Vec<ParamId> {
    let told = parameters.iter().filter(|parameter| parameter.status == Status::Identified);
    told.filter_map(|parameter| parameter.name.parse().ok()).collect()
}

/// The nominal geometry: that of the `[nominal]` table where the robot was identified before.
fn nominal_model(robot: &Robot, start: &LengthModel) -> LengthModel {
    let mut nominal = start.clone();
    if let Some(before) = &robot.nominal {
        nominal.geometry = before.geometry.clone();
    }
    nominal
}

/// The robot as its file will hold it.
fn identified_robot(robot: &Robot, model: &LengthModel) -> Robot {
    let nominal = robot.nominal.clone().unwrap_or_else(|| Box::new(robot.clone()));
    Robot { geometry: model.geometry.clone(), nominal: Some(nominal), ..robot.clone() }
}

fn rank_at(model: &LengthModel, lengths: &Weighted, ids: &[ParamId]) -> Result<usize, IdentifyError> {
    let order: Vec<usize> = (0..ids.len()).collect();
    let set = base_set(&factor(model, lengths, ids), &order).ok_or(IdentifyError::NotFinite)?;
    Ok(set.rank)
}

/// Every parameter of the model with its fate.
fn parameters(
    robot: &Robot,
    set_up: SetUp,
    nominal: &LengthModel,
    start: &LengthModel,
    estimate: &Estimate,
    spread: &Spread,
    options: &Options,
) -> Vec<ParameterResult> {
    let mut ids = parameter::all(&robot.parallel_joints(), set_up);
    ids.extend(&estimate.analysis.ids);
    ids.sort();
    ids.dedup();
    let fate = Fate::new(robot, estimate, spread, options);
    ids.into_iter()
        .map(|id| {
            let (status, reason, sd) = fate.of(id);
            let identified = estimate.fit.model.value(id);
            ParameterResult {
                name: id.to_string(),
                unit: id.unit().into(),
                start: start.value(id),
                nominal: nominal.value(id),
                identified,
                correction: identified - nominal.value(id),
                sd,
                interval95: None,
                monte_carlo: None,
                status,
                reason,
            }
        })
        .collect()
}

/// What became of each parameter, and why.
struct Fate<'a> {
    robot: &'a Robot,
    estimate: &'a Estimate,
    spread: &'a Spread,
    options: &'a Options,
    zero: Vec<ParamId>,
    combinations: Vec<Combination>,
}

impl<'a> Fate<'a> {
    fn new(robot: &'a Robot, estimate: &'a Estimate, spread: &'a Spread, options: &'a Options) -> Self {
        Self {
            robot,
            estimate,
            spread,
            options,
            zero: estimate.analysis.zero(),
            combinations: estimate.analysis.combinations(),
        }
    }

    fn of(&self, id: ParamId) -> (Status, String, Option<f64>) {
        if let Some(k) = self.estimate.kept.iter().position(|kept| *kept == id) {
            return self.estimated(id, k);
        }
        let (status, reason) = if self.options.hold.contains(&id) {
            (Status::Held, "held as asked".to_owned())
        } else if self.estimate.weak.contains(&id) {
            (Status::TooWeak, self.too_weak(id))
        } else if !self.estimate.analysis.ids.contains(&id) {
            (Status::Held, "not asked for".to_owned())
        } else if self.zero.contains(&id) {
            (Status::Held, "changes no length in these poses".to_owned())
        } else {
            (Status::Dependent, self.combination(id))
        };
        (status, reason, None)
    }

    fn estimated(&self, id: ParamId, k: usize) -> (Status, String, Option<f64>) {
        let sd = self.spread.covariance[(k, k)].sqrt();
        let limit = self.options.tolerances(self.robot).weak_limit(id).unwrap_or(f64::INFINITY);
        let own = self.spread.data_sd[k];
        if !self.estimate.base.contains(&id) {
            let reason = format!("{}; the prior shares it out", self.combination(id));
            return (Status::Prior, reason, Some(sd));
        }
        if self.estimate.prior.is_some() && own > limit {
            let reason = format!("the data alone leave {}; the prior carries it", with_unit(own, id));
            return (Status::Prior, reason, Some(sd));
        }
        let Some(stands_for) = self.combinations.iter().find(|c| c.kept == id) else {
            return (Status::Identified, String::new(), Some(sd));
        };
        let shared = |(member, _): &(ParamId, f64)| *member != id && self.estimate.kept.contains(member);
        let by_prior = if stands_for.members.iter().any(shared) { "; the prior shares it out" } else { "" };
        (Status::Identified, format!("{}{by_prior}", stands_for.text), Some(sd))
    }

    /// The first combination that a parameter belongs to.
    fn combination(&self, id: ParamId) -> String {
        let member = |c: &&Combination| c.members.iter().any(|(member, _)| *member == id);
        self.combinations.iter().find(member).map_or_else(String::new, |c| c.text.clone())
    }

    fn too_weak(&self, id: ParamId) -> String {
        if is_place(&id) {
            return format!(
                "data too weak: these poses leave it open by more than {:.0} mm, as where the tool never turns or \
                 every bar lies in one plane; vary the poses",
                open_mm(id)
            );
        }
        let limit = self.options.tolerances(self.robot).weak_limit(id).unwrap_or(f64::INFINITY);
        format!(
            "data too weak: its standard deviation would be more than {} (3 tolerances)",
            with_unit(limit, id)
        )
    }
}

/// A value for people: mm, or mrad.
fn with_unit(value: f64, id: ParamId) -> String {
    match id.unit() {
        _ if value.is_infinite() => "nothing known".into(),
        "rad" => format!("{:.3} mrad", value * 1e3),
        "rad/Nm" => format!("{:.3} urad/(N m)", value * 1e6),
        unit if value >= 10.0 => format!("{value:.0} {unit}"),
        unit => format!("{value:.3} {unit}"),
    }
}

fn dependent(estimate: &Estimate) -> Vec<Dependent> {
    estimate
        .analysis
        .combinations()
        .into_iter()
        .map(|Combination { kept, members, text }| Dependent {
            combination: members
                .iter()
                .map(|(id, share)| (id.to_string(), *share))
                .collect::<BTreeMap<_, _>>(),
            kept: kept.to_string(),
            text,
        })
        .collect()
}

/// The predicted 3-D errors of the nominal and the identified robot, and the latter's over the workspace.
pub(super) fn predicted(
    robot: &Robot,
    estimate: &Estimate,
    lengths: &Weighted,
    options: &Options,
) -> Result<(PredictedPair, ErrorMap, Seen), IdentifyError> {
    let mut ids = parameter::all(&robot.parallel_joints(), estimate.before.centres.len());
    ids.extend(&estimate.analysis.ids);
    ids.sort();
    ids.dedup();
    // What is optional counts as exact for both robots, as where it is not estimated.
    let of = |id: &ParamId| {
        if id.is_optional() { None } else { options.prior_sd(robot, *id).or_else(|| estimate.prior_sd(*id)) }
    };
    let tolerances: Vec<f64> = ids.iter().map(|id| of(id).unwrap_or(0.0)).collect();
    let kept: Vec<usize> =
        estimate.kept.iter().filter_map(|id| ids.iter().position(|other| other == id)).collect();
    let prior = estimate.prior.as_ref();
    let no_prior = DMatrix::zeros(0, kept.len());
    let rows = prior.map_or(no_prior, PriorRows::matrix);
    let factor = factor(&estimate.fit.model, lengths, &ids);
    let estimator =
        Estimator { ids: &ids, factor: &factor, tolerance: &tolerances, kept: &kept, prior: &rows };
    let workspace = Workspace::new(&estimate.fit.model.geometry, &options.workspace_poses(robot), &ids);
    let [truths, noise] = estimator.draws();
    // What the user held is taken as exact; the nominal robot has all its tolerance.
    let mut unknown = truths.clone();
    for (at, id) in ids.iter().enumerate().filter(|(_, id)| !estimate.analysis.ids.contains(id)) {
        debug_assert!(!estimate.kept.contains(id));
        unknown.row_mut(at).fill(0.0);
    }
    let errors = estimator.errors(&unknown, &noise).ok_or(IdentifyError::NotFinite)?;
    let moved = workspace.displacements(&errors);
    let told =
        |summary: ErrorSummary| PredictedError { mean: summary.mean, p95: summary.p95, max: summary.max };
    let pair = PredictedPair {
        nominal: told(workspace.summary(&workspace.displacements(&truths))),
        identified: told(workspace.summary(&moved)),
    };
    let positions = workspace.positions.iter().map(|position| (*position).into());
    let map = positions.zip(workspace.map(&moved)).collect();
    Ok((pair, map, Seen { ids, factor, workspace }))
}

/// Residuals as they add up.
#[derive(Clone, Copy, Default)]
struct Tally {
    count: usize,
    sum: f64,
    squares: f64,
    max: f64,
}

impl Tally {
    fn add(&mut self, residual: f64) {
        *self =
            self.with(Self { count: 1, sum: residual, squares: residual * residual, max: residual.abs() });
    }

    fn with(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
            max: self.max.max(other.max),
        }
    }

    fn residual(self) -> Residual {
        let count = self.count.max(1) as f64;
        Residual { rms: (self.squares / count).sqrt(), mean: self.sum / count, max: self.max }
    }
}

/// The residuals of the lengths that were used; `None` when one of all, or the sum of their squares, is not finite.
fn residuals(before: &LengthModel, after: &LengthModel, used: &Weighted) -> Option<BeforeAfter> {
    let (before, after) = (before.prepare(), after.prepare());
    let pieces = used.in_pieces(|readings, sigma| {
        let (mut tallies, mut finite) = ([Tally::default(); 2], true);
        for (reading, sigma) in readings.iter().zip(sigma) {
            let residuals = [&before, &after].map(|model| reading.length - model.length(reading));
            finite &= residuals[1].is_finite();
            if *sigma != f64::INFINITY {
                tallies.iter_mut().zip(residuals).for_each(|(tally, residual)| tally.add(residual));
            }
        }
        finite.then_some(tallies)
    });
    let mut sums = [Tally::default(); 2];
    for tallies in pieces {
        let [before, after] = tallies?;
        sums = [sums[0].with(before), sums[1].with(after)];
    }
    let [before, after] = sums.map(Tally::residual);
    (before.rms.is_finite() && after.rms.is_finite()).then_some(BeforeAfter { before, after })
}

/// The residuals of other lengths; `None` when the sum of their squares is not finite.
fn residual_on(model: &LengthModel, set: &Observations) -> Option<Residual> {
    let prepared = model.prepare();
    let mut tally = Tally::default();
    for reading in set.rows.iter().map(Reading::from) {
        tally.add(reading.length - prepared.length(&reading));
    }
    Some(tally.residual()).filter(|residual| residual.rms.is_finite())
}
