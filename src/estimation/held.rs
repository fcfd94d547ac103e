//! Whether the lengths contradict what they were not to change: places that the user fixed, and the length of a bar that
//! its certificate binds.

use super::calibration::Calibration;
use super::linear_system::LinearSystem;
use super::selection::{is_bar, is_place};
use crate::catalogue::{EstimationFinding, Names};
use crate::math::base_set;
use crate::math::distributions::ln_f_tail;
use crate::robot::ParamId;

/// The chance of such a difference in sound lengths.
const CHANCE: f64 = 1e-6;
/// Degrees of freedom below which nothing is decided.
const FEWEST: f64 = 10.0;
/// A normal deviate of a robot within its tolerance: one run of 400 has it by chance.
const DEVIATE: f64 = 3.0;
/// A smaller part of what is known of a bar, by the lengths, is rounding.
const LEAST_PART: f64 = 1e-8;

pub(super) fn contradicted(of: &Calibration<'_>) -> impl Iterator<Item = EstimationFinding> {
    places(of).into_iter().chain(bars(of)).chain(uncertified(of))
}

/// Places that are fixed: with them free the lengths fit better than by chance.
fn places(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let (estimate, lengths) = (&of.estimate, &of.lengths);
    let fixed: Vec<ParamId> = of.setting.options.hold.iter().copied().filter(is_place).collect();
    let used = estimate.used(lengths);
    let left = |more: &[ParamId]| {
        let ids = [estimate.kept.as_slice(), more].concat();
        let mut system = LinearSystem::at(&estimate.fit.model, &used, &ids);
        let bound = estimate.prior.as_ref().map_or(0, |prior| {
            system.add_prior(prior, &estimate.fit.model, &estimate.kept);
            prior.count()
        });
        let order: Vec<usize> = (0..ids.len()).collect();
        let rank = base_set(&system.factor(), &order)?.rank;
        Some((system.residual_sum().max(0.0), (used.count() + bound) as f64 - rank as f64))
    };
    if fixed.is_empty() || lengths.are_many() {
        return None;
    }
    let ((held, freedom), (free, remaining)) = (left(&[])?, left(&fixed)?);
    if remaining < FEWEST || freedom <= remaining {
        return None;
    }
    let f = ((held - free) / (freedom - remaining)) / (free / remaining);
    let size_mm = |squares: f64, freedom: f64| (squares / freedom).sqrt() * used.rms_sigma();
    (ln_f_tail(f, freedom - remaining, remaining) < CHANCE.ln()).then(|| {
        EstimationFinding::PlaceContradicted {
            fixed: Names::of(&fixed),
            held_mm: size_mm(held, freedom),
            free_mm: size_mm(free, remaining),
        }
    })
}

/// What the lengths alone, by the robot's tolerance, say of a bar that its certificate binds.
fn bars(of: &Calibration<'_>) -> impl Iterator<Item = EstimationFinding> {
    let bound = of.estimate.kept.iter().copied().filter(is_bar);
    bound.filter_map(|id| {
        let (before, after) = (of.estimate.prior_sd(id)?, of.uncertainty.posterior.sd(id)?);
        let part = 1.0 - (after / before).powi(2);
        if part < LEAST_PART {
            return None;
        }
        let step_mm = of.estimate.fit.model.value(id) - of.setting.start.value(id);
        let (off_mm, sd_mm) = (step_mm / part, after / part.sqrt());
        (off_mm.abs() > DEVIATE * sd_mm.hypot(before))
            .then_some(EstimationFinding::BarContradicted { off_mm, sd_mm })
    })
}

/// A bar without certificate that is fixed.
fn uncertified(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let options = &of.setting.options;
    let is_held = options.hold.iter().any(is_bar) && options.bar_u_mm.is_none();
    is_held.then_some(EstimationFinding::UncertifiedHeld)
}
