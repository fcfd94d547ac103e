//! Whether the data contradict the assumptions of the estimate: places that the user fixed, the certified length of a
//! bar, and that lengths and positions are of the same robot.

use super::calibration::Calibration;
use super::estimator::Estimate;
use super::lengths::Lengths;
use super::linear_system::linear_system;
use super::selection::{is_bar, is_place};
use crate::diagnostic::Names;
use crate::estimation::EstimationFinding;
use crate::math::distributions::ln_f_tail;
use crate::math::{Triangle, rank};
use crate::robot::ParamId;

/// Significance levels of the F-tests of fixed places, and of lengths against positions.
const PLACES_LEVEL: f64 = 1e-6;
const KINDS_LEVEL: f64 = 1e-4;
/// The residuals of lengths and positions together must exceed those of separate fits by this factor: the errors that the
/// model lacks differ slightly between any two sets of poses.
const LARGER: f64 = 1.5;
/// Degrees of freedom below which nothing is decided.
const MIN_FREEDOM: f64 = 10.0;
/// The limit for a bar in standard deviations; a sound bar exceeds it in one run of 400.
const BAR_LIMIT: f64 = 3.0;
/// A smaller part of the information about a bar that comes from the lengths is rounding.
const MIN_PART: f64 = 1e-8;

/// The sum of squared residuals of a linearised fit, in units of the noise, and its degrees of freedom.
#[derive(Clone, Copy)]
struct Residuals {
    squares: f64,
    freedom: f64,
}

impl Residuals {
    fn of(system: &mut Triangle, rows: usize) -> Option<Self> {
        let freedom = rows as f64 - rank(&system.factor())? as f64;
        Some(Self { squares: system.residual_sum().max(0.0), freedom })
    }

    fn rms(self) -> f64 {
        (self.squares / self.freedom).sqrt()
    }

    /// Natural logarithm of the tail probability of the F-test against a `free` fit of more parameters.
    fn ln_f_test(self, free: Self) -> f64 {
        let constraints = self.freedom - free.freedom;
        let f = ((self.squares - free.squares) / constraints) / (free.squares / free.freedom);
        ln_f_tail(f, constraints, free.freedom)
    }
}

/// Fixed places and bars that the lengths contradict.
pub(super) fn contradicted(of: &Calibration<'_>) -> impl Iterator<Item = EstimationFinding> {
    places(of).into_iter().chain(bars(of)).chain(uncertified(of))
}

/// Tests whether the lengths fit better with the fixed places free.
fn places(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let (estimate, lengths) = (&of.estimate, &of.lengths);
    let fixed: Vec<ParamId> = of.setting.options.hold.iter().copied().filter(is_place).collect();
    if fixed.is_empty() || lengths.are_many() {
        return None;
    }
    let used = estimate.used(lengths);
    let residuals = |more: &[ParamId]| {
        let ids = [estimate.kept.as_slice(), more].concat();
        let mut system = linear_system(&estimate.fit.model, &used, &ids);
        let bound = estimate.prior_sds.iter().enumerate().filter_map(|(k, sd)| Some((k, (*sd)?)));
        let mut count = used.count();
        for (k, sd) in bound {
            let id = estimate.kept[k];
            let step = estimate.fit.model.value(id) - of.setting.start.value(id);
            system.push_single(k, sd.recip(), -step / sd);
            count += 1;
        }
        Residuals::of(&mut system, count)
    };
    let (held, free) = (residuals(&[])?, residuals(&fixed)?);
    if free.freedom < MIN_FREEDOM || held.freedom <= free.freedom {
        return None;
    }
    let sigma_mm = used.rms_sigma();
    (held.ln_f_test(free) < PLACES_LEVEL.ln()).then(|| EstimationFinding::PlaceContradicted {
        fixed: Names::of(&fixed),
        held_mm: held.rms() * sigma_mm,
        free_mm: free.rms() * sigma_mm,
    })
}

/// Compares the certified length of each bar with the length that the data give without the certificate.
fn bars(of: &Calibration<'_>) -> impl Iterator<Item = EstimationFinding> {
    let bound = of.estimate.kept.iter().copied().filter(is_bar);
    bound.filter_map(|id| {
        let (before, after) = (of.estimate.prior_sd(id)?, of.posterior.sd(id)?);
        // The part of the information that comes from the data.
        let part = 1.0 - (after / before).powi(2);
        if part < MIN_PART {
            return None;
        }
        let step_mm = of.estimate.fit.model.value(id) - of.setting.start.value(id);
        let (off_mm, sd_mm) = (step_mm / part, after / part.sqrt());
        (off_mm.abs() > BAR_LIMIT * sd_mm.hypot(before))
            .then_some(EstimationFinding::BarContradicted { off_mm, sd_mm })
    })
}

/// A bar that is fixed although it has no certificate.
fn uncertified(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let options = &of.setting.options;
    let is_held = options.hold.iter().any(is_bar) && options.bar_u_mm.is_none();
    is_held.then_some(EstimationFinding::UncertifiedHeld)
}

/// Whether lengths and positions are of different robots: Chow's test (Econometrica 28, 1960), linearised at the estimate.
/// There is no prior in it, which would bind both alike.
pub(super) fn kinds_disagree(estimate: &Estimate, lengths: &Lengths) -> Option<EstimationFinding> {
    let model = &estimate.fit.model;
    model.tracker?;
    let is_used = |at: &usize| estimate.fit.outliers.binary_search(at).is_err();
    let is_position = |at: &usize| lengths.reading(*at).datum.is_plane();
    let (positions, others): (Vec<usize>, Vec<usize>) =
        (0..lengths.len()).filter(is_used).partition(is_position);
    if others.is_empty() {
        return None;
    }
    let residuals = |places: &[usize]| {
        let some = lengths.at(places);
        let weighted = some.weighted(estimate.sigma, &[]);
        Residuals::of(&mut linear_system(model, &weighted, &estimate.base), places.len())
    };
    let together = residuals(&[others.as_slice(), positions.as_slice()].concat())?;
    let (one, other) = (residuals(&others)?, residuals(&positions)?);
    let apart = Residuals { squares: one.squares + other.squares, freedom: one.freedom + other.freedom };
    if one.freedom.min(other.freedom) < MIN_FREEDOM
        || together.freedom <= apart.freedom
        || together.ln_f_test(apart) > KINDS_LEVEL.ln()
        || together.rms() < LARGER * apart.rms()
    {
        return None;
    }
    let sigma_mm = estimate.used(lengths).rms_sigma();
    Some(EstimationFinding::KindsDisagree {
        apart_mm: apart.rms() * sigma_mm,
        together_mm: together.rms() * sigma_mm,
    })
}
