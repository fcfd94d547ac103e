//! Whether the data carry joint compliance and gear error: each optional group is added only when three
//! judges agree.
//!
//! The nested F-test asks whether the group explains more of the residuals than as many random columns
//! would. On a real robot everything that the model lacks makes it speak up, so the held-out lengths
//! must also be predicted better, by more than the standard error of the gain. That holds where poses were
//! measured; so that it does not cost accuracy elsewhere, the predicted 3-D error over the workspace must not rise.

use std::cmp::Ordering;

use super::covariance::beyond_chance;
use super::distribution::f_tail;
use super::estimate::{Estimate, IdentifyError, estimate};
use super::folds::{DEFAULT_FOLDS, held_out, predicts_better, rms};
use super::lengths::{Lengths, Sigma};
use super::options::Options;
use super::result::{GroupChoice, WithoutWith};
use super::summary::predicted;
use crate::linalg::Triangle;
use crate::model::{LengthModel, LengthRow, ParamId, Readings, Robot, Selection, parameter};

/// A group is taken for chance above this probability: two groups are tested, and neither may slip into one
/// data set in a hundred.
const CHANCE: f64 = 1e-3;
/// A column that has less than this share of its own beside the others is none.
const INDEPENDENT: f64 = 1e-6;
/// Lengths that fit to this are exact, mm: what is left is rounding.
const ROUNDING_MM: f64 = 1e-6;

/// An optional group.
struct Group {
    name: &'static str,
    members: Vec<ParamId>,
}

/// The result of a nested F-test.
#[derive(Clone, Copy)]
struct Test {
    f: f64,
    p: f64,
    freedom: [f64; 2],
}

/// Estimates `asked`, and with it each optional group that the data carry. A list that the user gave is
/// complete: then nothing is added.
pub(super) fn choose(
    robot: &Robot,
    start: &LengthModel,
    lengths: &Lengths,
    mut asked: Vec<ParamId>,
    options: &Options,
) -> Result<(Estimate, Vec<GroupChoice>), IdentifyError> {
    let mut best = estimate(robot, start, lengths, &asked, options)?;
    let mut choices = Vec::new();
    if options.estimate.is_some() {
        return Ok((best, choices));
    }
    let mut open = Vec::new();
    for group in groups(options) {
        match reason_against(robot, &group, &best, lengths) {
            Some(reason) => choices.push(untested(group.name, &reason)),
            None => open.push(group),
        }
    }
    loop {
        let tests: Vec<Option<Test>> =
            open.iter().map(|group| test(&best, lengths, &group.members)).collect();
        let speaks = (0..open.len())
            .filter_map(|at| Some((at, tests[at]?)))
            .filter(|(_, test)| test.p < CHANCE)
            .min_by(|(_, a), (_, b)| a.p.total_cmp(&b.p));
        let Some((at, test)) = speaks else {
            choices.extend(open.iter().zip(tests).map(|(group, test)| chance(group.name, test)));
            break;
        };
        let group = open.remove(at);
        let wider = [asked.clone(), group.members].concat();
        // A fold that cannot be fitted must not cost the result that there is without the group.
        let out = |ids: &[ParamId]| {
            let fit = |training: &Lengths| estimate(robot, start, training, ids, options);
            held_out(lengths, &best.fit.out, DEFAULT_FOLDS, fit).ok().flatten()
        };
        let (Some(without), Some(with)) = (out(&asked), out(&wider)) else {
            choices.push(untested(group.name, "there are too few poses to hold some out"));
            continue;
        };
        let held_out = WithoutWith { without: rms(&without), with: rms(&with) };
        if !predicts_better(&without, &with) {
            choices.push(judged(group.name, test, held_out, None));
            continue;
        }
        let candidate = estimate(robot, start, lengths, &wider, options)?;
        let error = |estimate: &Estimate| predicted_mm(robot, estimate, lengths, options);
        let predicted = WithoutWith { without: error(&best)?, with: error(&candidate)? };
        let choice = judged(group.name, test, held_out, Some(predicted));
        if choice.added {
            (asked, best) = (wider, candidate);
        }
        choices.push(choice);
    }
    choices.sort_by_key(|choice| choice.name.clone());
    Ok((best, choices))
}

/// The groups, without what the user holds.
fn groups(options: &Options) -> Vec<Group> {
    let free = |ids: &mut dyn Iterator<Item = ParamId>| ids.filter(|id| !options.hold.contains(id)).collect();
    vec![
        Group { name: "compliance", members: free(&mut parameter::compliance()) },
        Group { name: "gear", members: free(&mut parameter::gear()) },
    ]
}

/// Why a group need not be tested.
fn reason_against(robot: &Robot, group: &Group, best: &Estimate, lengths: &Lengths) -> Option<String> {
    let prepared = best.fit.model.prepare();
    let used = best.used(lengths);
    let fits = || {
        let pieces = used.in_pieces(|readings, sigma| {
            let left = readings.iter().map(|reading| (reading.length - prepared.length(reading)).abs());
            left.zip(sigma).all(|(left, sigma)| left < ROUNDING_MM || *sigma == f64::INFINITY)
        });
        pieces.into_iter().all(|fits| fits)
    };
    if group.members.is_empty() {
        Some("held as asked".into())
    } else if group.name == "compliance" && robot.geometry.masses.is_empty() {
        Some("the robot file has no [[mass]] and no [payload]".into())
    } else if used.count() > best.base.len() && fits() {
        Some("the lengths fit without it to rounding".into())
    } else {
        None
    }
}

/// The nested F-test of a group beside what is estimated, to first order about the estimate. Rows of the
/// prior count as observations, which is what they are to least squares. `None` where it leaves no degree of
/// freedom or none of its columns is independent.
fn test(best: &Estimate, lengths: &Lengths, members: &[ParamId]) -> Option<Test> {
    let own = best.kept.len();
    let ids = [best.kept.as_slice(), members].concat();
    let selection = Selection::new(&ids);
    let prepared = best.fit.model.prepare();
    let used = best.used(lengths);
    let pieces = used.in_pieces(|readings, sigma| {
        let mut triangle = Triangle::new(ids.len());
        let mut row = vec![0.0; ids.len()];
        let mut predicted = LengthRow::default();
        for (reading, sigma) in readings.iter().zip(sigma).filter(|(_, sigma)| **sigma != f64::INFINITY) {
            prepared.row_into(reading, &mut predicted);
            selection.pick(&predicted, reading.centre, &mut row);
            row.iter_mut().for_each(|value| *value /= sigma);
            triangle.push(&row, (reading.length - predicted.length) / sigma);
        }
        triangle
    });
    let mut triangle = Triangle::merged(pieces, ids.len());
    let mut observations = used.count();
    if let Some(prior) = &best.prior {
        for k in prior.bound() {
            let off = prior.mean[k] - best.fit.model.value(best.kept[k]);
            triangle.push_single(k, prior.weights[k], prior.weights[k] * off);
            observations += 1;
        }
    }
    let mut residual = triangle.residual_sum();
    // A column that depends on those before it takes its place in the triangle with rounding: leave it out and
    // set up the triangle anew.
    let mut columns = ids.len();
    loop {
        let factor = triangle.factor();
        let dependent = |k: &usize| factor[(*k, *k)].abs() <= INDEPENDENT * factor.column(*k).norm();
        let Some(out) = (own..columns).find(dependent) else { break };
        let rhs = triangle.rhs();
        columns -= 1;
        let mut fewer = Triangle::new(columns);
        for (row, rhs) in factor.row_iter().zip(&rhs) {
            let left: Vec<f64> = row.iter().enumerate().filter(|(k, _)| *k != out).map(|(_, x)| *x).collect();
            fewer.push(&left, *rhs);
        }
        residual += fewer.residual_sum();
        triangle = fewer;
    }
    let explained = triangle.rhs().rows(own, columns - own).norm_squared();
    let freedom = [(columns - own) as f64, observations as f64 - columns as f64];
    if columns == own || freedom[1] < 1.0 {
        return None;
    }
    let f = (explained / freedom[0]) / (residual / freedom[1]);
    f.is_finite().then(|| Test { f, p: f_tail(f, freedom[0], freedom[1]), freedom })
}

/// The predicted mean 3-D error over the workspace, with a sigma of the lengths that the residuals bear out.
fn predicted_mm(
    robot: &Robot,
    estimate: &Estimate,
    lengths: &Lengths,
    options: &Options,
) -> Result<f64, IdentifyError> {
    let mut used = estimate.used(lengths);
    let prepared = estimate.fit.model.prepare();
    let chi = used.sum(|reading, sigma| ((reading.length - prepared.length(reading)) / sigma).powi(2));
    let freedom = (used.count() as f64 - estimate.base.len() as f64).max(1.0);
    // A sigma that was vouched for is not brought to the residuals by the estimate.
    if beyond_chance(chi / freedom, freedom) == Some(Ordering::Greater) && estimate.freedom.is_none() {
        used = lengths.weighted(Sigma::Times((chi / freedom).sqrt()), &estimate.fit.out);
    }
    let (pair, ..) = predicted(robot, estimate, &used, options)?;
    Ok(pair.identified.mean)
}

fn untested(name: &str, reason: &str) -> GroupChoice {
    GroupChoice {
        name: name.into(),
        added: false,
        f: None,
        freedom: None,
        p: None,
        held_out_mm: None,
        predicted_mm: None,
        text: format!("{} was not tested: {reason}", words(name)),
    }
}

fn chance(name: &str, test: Option<Test>) -> GroupChoice {
    let Some(test) = test else {
        return untested(name, "the lengths are too few for it, or do not depend on it");
    };
    let text = format!("{} was not added: the data do not carry it ({})", words(name), figures(&test));
    GroupChoice { text, ..told(name, &test) }
}

fn judged(name: &str, test: Test, held_out: WithoutWith, predicted: Option<WithoutWith>) -> GroupChoice {
    let (group, figures) = (words(name), figures(&test));
    let rms = format!("held-out rms {:.4} mm without, {:.4} mm with it", held_out.without, held_out.with);
    let (added, text) = match predicted {
        None => (
            false,
            format!(
                "{group} was not added: it would explain something ({figures}), but lengths held out are not \
                 predicted clearly better ({rms})"
            ),
        ),
        Some(WithoutWith { without, with }) if with > without => (
            false,
            format!(
                "{group} was not added: lengths like those measured are predicted better with it ({figures}; {rms}), \
                 but over the whole workspace it would cost accuracy: predicted 3-D error {without:.3} mm without, \
                 {with:.3} mm with it; `--estimate all,{name}` adds it"
            ),
        ),
        Some(WithoutWith { without, with }) => (
            true,
            format!(
                "{group} was added: {figures}; {rms}; predicted 3-D error {without:.3} mm without, {with:.3} mm with it"
            ),
        ),
    };
    GroupChoice { added, held_out_mm: Some(held_out), predicted_mm: predicted, text, ..told(name, &test) }
}

fn told(name: &str, test: &Test) -> GroupChoice {
    GroupChoice { f: Some(test.f), freedom: Some(test.freedom), p: Some(test.p), ..untested(name, "") }
}

fn figures(test: &Test) -> String {
    let p = if test.p < 1e-3 { format!("{:.0e}", test.p) } else { format!("{:.3}", test.p) };
    format!("F({}, {}) = {:.2}, p = {p}", test.freedom[0], test.freedom[1], test.f)
}

/// A group for people.
fn words(name: &str) -> &str {
    if name == "gear" { "gear error" } else { name }
}
