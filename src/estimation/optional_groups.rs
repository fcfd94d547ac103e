//! Whether the data carry joint compliance and gear error: each optional group is added only when three
//! tests agree.
//!
//! The nested F-test asks whether the group explains more of the residuals than as many random columns
//! would. On a real robot everything that the model lacks raises F, so the held-out lengths must also be predicted
//! better, by more than the standard error of the gain. That holds where poses were
//! measured; so that it does not cost accuracy elsewhere, the predicted 3-D error over the workspace must not rise.

use super::estimate::{Estimate, estimate};
use super::lengths::{Lengths, Sigma};
use super::linear_system::LinearSystem;
use super::predicted::Prediction;
use super::result::{FTest, GroupOutcome, GroupTest, OptionalGroup, Untested, WithoutWith};
use super::setting::Setting;
use super::validation::{DEFAULT_FOLDS, held_out, predicts_better, rms};
use crate::catalogue::EstimationFinding;
use crate::math::distributions::{ChiSquare, f_tail};
use crate::measurement::MeasurementPieces;
use crate::robot::{ParamId, parameter};

/// A group is taken for chance above this probability: two groups are tested, and neither may slip into one
/// data set in a hundred.
const CHANCE: f64 = 1e-3;
/// A column that has less than this share of its own beside the others is none.
const INDEPENDENT: f64 = 1e-6;
/// Lengths that fit to this are exact, mm: what is left is rounding.
const ROUNDING_MM: f64 = 1e-6;

/// An estimate with the optional groups that the data carry, and what was found of each.
pub(super) struct Chosen {
    pub(super) estimate: Estimate,
    pub(super) groups: Vec<GroupTest>,
}

/// A group without what the user fixes.
struct Candidate {
    group: OptionalGroup,
    members: Vec<ParamId>,
}

/// Estimates `asked`, and with it each optional group that the data carry. A list that the user gave is
/// complete: then nothing is added.
pub(super) fn choose(
    setting: &Setting<'_>,
    lengths: &Lengths,
    mut asked: Vec<ParamId>,
) -> Result<Chosen, EstimationFinding> {
    let mut best = estimate(setting, lengths, &asked)?;
    let mut groups = Vec::new();
    if setting.options.estimate.is_some() {
        return Ok(Chosen { estimate: best, groups });
    }
    let mut open = Vec::new();
    for candidate in candidates(setting) {
        match candidate.untested(setting, &best, lengths) {
            Some(reason) => {
                groups.push(GroupTest { group: candidate.group, outcome: GroupOutcome::Untested(reason) });
            }
            None => open.push(candidate),
        }
    }
    loop {
        let tests: Vec<Option<FTest>> =
            open.iter().map(|candidate| f_test(&best, lengths, &candidate.members)).collect();
        let strongest = (0..open.len())
            .filter_map(|at| Some((at, tests[at]?)))
            .filter(|(_, test)| test.p < CHANCE)
            .min_by(|(_, a), (_, b)| a.p.total_cmp(&b.p));
        let Some((at, test)) = strongest else {
            groups.extend(open.iter().zip(tests).map(|(candidate, test)| by_chance(candidate.group, test)));
            break;
        };
        let Candidate { group, members } = open.remove(at);
        let wider = [asked.clone(), members].concat();
        let judged = judge(setting, lengths, test, Comparison { asked: &asked, best: &best, wider: &wider })?;
        groups.push(GroupTest { group, outcome: judged.outcome });
        if let Some(candidate) = judged.added {
            (asked, best) = (wider, candidate);
        }
    }
    groups.sort_by_key(|test| test.group);
    Ok(Chosen { estimate: best, groups })
}

/// What is estimated now, and what with a group more.
struct Comparison<'a> {
    asked: &'a [ParamId],
    best: &'a Estimate,
    wider: &'a [ParamId],
}

struct Judged {
    outcome: GroupOutcome,
    /// The estimate with the group, if it is added.
    added: Option<Estimate>,
}

/// Whether a group that passed its F-test predicts held-out lengths and the position better.
fn judge(
    setting: &Setting<'_>,
    lengths: &Lengths,
    test: FTest,
    Comparison { asked, best, wider }: Comparison<'_>,
) -> Result<Judged, EstimationFinding> {
    // A fold that cannot be fitted must not cost the result that there is without the group.
    let out = |ids: &[ParamId]| {
        let fit = |training: &Lengths| Ok(estimate(setting, training, ids)?.fit.model);
        held_out(lengths, &best.fit.out, DEFAULT_FOLDS, fit).ok().flatten()
    };
    let not_added = |outcome| Ok(Judged { outcome, added: None });
    let (Some(without), Some(with)) = (out(asked), out(wider)) else {
        return not_added(GroupOutcome::Untested(Untested::TooFewPoses));
    };
    let held_out = WithoutWith { without: rms(&without), with: rms(&with) };
    if !predicts_better(&without, &with) {
        return not_added(GroupOutcome::NotPredictive { test, held_out });
    }
    let candidate = estimate(setting, lengths, wider)?;
    let error = |estimate: &Estimate| predicted_mm(setting, estimate, lengths);
    let predicted = WithoutWith { without: error(best)?, with: error(&candidate)? };
    if predicted.with > predicted.without {
        return not_added(GroupOutcome::CostsAccuracy { test, held_out, predicted });
    }
    Ok(Judged { outcome: GroupOutcome::Added { test, held_out, predicted }, added: Some(candidate) })
}

fn by_chance(group: OptionalGroup, test: Option<FTest>) -> GroupTest {
    let outcome = match test {
        Some(test) => GroupOutcome::Chance { test },
        None => GroupOutcome::Untested(Untested::TooFewLengths),
    };
    GroupTest { group, outcome }
}

fn candidates(setting: &Setting<'_>) -> Vec<Candidate> {
    let free = |ids: &mut dyn Iterator<Item = ParamId>| {
        ids.filter(|id| !setting.options.hold.contains(id)).collect()
    };
    vec![
        Candidate { group: OptionalGroup::Compliance, members: free(&mut parameter::compliance()) },
        Candidate { group: OptionalGroup::Gear, members: free(&mut parameter::gear()) },
    ]
}

impl Candidate {
    /// Why it need not be tested.
    fn untested(&self, setting: &Setting<'_>, best: &Estimate, lengths: &Lengths) -> Option<Untested> {
        let prepared = best.fit.model.prepare();
        let used = best.used(lengths);
        let fits = || {
            let pieces = used.in_pieces(|_, readings, sigma| {
                let left =
                    readings.iter().map(|reading| (reading.length_mm - prepared.length(reading)).abs());
                left.zip(sigma).all(|(left, sigma)| left < ROUNDING_MM || *sigma == f64::INFINITY)
            });
            pieces.into_iter().all(|fits| fits)
        };
        if self.members.is_empty() {
            Some(Untested::FixedAsAsked)
        } else if self.group == OptionalGroup::Compliance && setting.robot.geometry.masses.is_empty() {
            Some(Untested::NoMass)
        } else if used.count() > best.base.len() && fits() {
            Some(Untested::FitsToRounding)
        } else {
            None
        }
    }
}

/// The nested F-test of a group beside what is estimated, to first order about the estimate. Rows of the
/// prior count as observations, which is what they are to least squares. `None` where it leaves no degree of
/// freedom or none of its columns is independent.
fn f_test(best: &Estimate, lengths: &Lengths, members: &[ParamId]) -> Option<FTest> {
    let own = best.kept.len();
    let ids = [best.kept.as_slice(), members].concat();
    let used = best.used(lengths);
    let mut system = LinearSystem::at(&best.fit.model, &used, &ids);
    let mut observations = used.count();
    if let Some(prior) = &best.prior {
        system.add_prior(prior, &best.fit.model, &best.kept);
        observations += prior.count();
    }
    // A column that depends on those before it takes its place in the triangle with rounding: leave it out.
    loop {
        let factor = system.factor();
        let dependent = |k: &usize| factor[(*k, *k)].abs() <= INDEPENDENT * factor.column(*k).norm();
        let Some(out) = (own..system.unknowns()).find(dependent) else { break };
        system = system.without(out);
    }
    let columns = system.unknowns();
    let (explained, residual) = (system.rhs().rows(own, columns - own).norm_squared(), system.residual_sum());
    let freedom = [(columns - own) as f64, observations as f64 - columns as f64];
    if columns == own || freedom[1] < 1.0 {
        return None;
    }
    let f = (explained / freedom[0]) / (residual / freedom[1]);
    f.is_finite().then(|| FTest { f, p: f_tail(f, freedom[0], freedom[1]), freedom })
}

/// The predicted mean position error over the workspace, with a sigma of the lengths that the residuals bear out.
fn predicted_mm(
    setting: &Setting<'_>,
    estimate: &Estimate,
    lengths: &Lengths,
) -> Result<f64, EstimationFinding> {
    let mut used = estimate.used(lengths);
    let prepared = estimate.fit.model.prepare();
    let chi = used.sum(|reading, sigma| ((reading.length_mm - prepared.length(reading)) / sigma).powi(2));
    let freedom = (used.count() as f64 - estimate.base.len() as f64).max(1.0);
    // A sigma that was vouched for is not brought to the residuals by the estimate.
    if ChiSquare::of(chi / freedom, freedom) == ChiSquare::Greater && estimate.noise.freedom.is_none() {
        used = lengths.weighted(Sigma::Times((chi / freedom).sqrt()), &estimate.fit.out);
    }
    Ok(Prediction::of(setting, estimate, &used)?.pair.identified.mean)
}
