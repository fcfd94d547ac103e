//! The fit with errors of the joints: first harmonic, smooth function of the angle, backlash, ripple and compliance beside
//! the geometry, each group with the variance that the evidence gives it.
//!
//! The geometry keeps its prior from the robot's file. The lengths of one pose share the robot's own repeatability: their
//! covariance is sigma^2 (U U' + rho^2 W), U the unit vectors along the bar, W what is given of the lengths. The fit is
//! relinearised until it rests. Without a gain in evidence over the geometry alone there is no such fit.

use nalgebra::DVector;

use super::estimate::Estimate;
use super::evidence::{Evidence, Found, Hypers, Normal, Variance};
use super::fit::outliers;
use super::joint_fit::{GroupEvidence, JointFit};
use super::joint_system::System;
use super::lengths::{Lengths, Sigma, Weighted};
use super::noise_shape::{BacklashNoise, NoiseShape, Scored};
use super::options::Setting;
use super::pose_rows::{LengthNoise, PoseRows};
use super::prior::PriorRows;
use super::priors::Group;
use super::ripple::{Beside, Candidate, ln_candidates};
use crate::measurement::LengthModel;
use crate::robot::{AXES, JointError, JointErrors, JointTerm, ParamId, Smooth, TermKind, Visited, parameter};

/// Lengths beyond the parameters of the geometry from which errors of joints are looked for.
const REDUNDANT: usize = 30;
/// Lengths that fit to this are exact, mm.
const ROUNDING_MM: f64 = 1e-6;
/// Gain in the logarithm of the evidence over the geometry alone from which errors of joints are believed.
const GAIN: f64 = 3.0;
/// Rounds in which the set of outliers may change.
const OUTLIER_ROUNDS: usize = 3;
/// Linearisations.
const ROUNDS: usize = 4;
/// Steps towards the likeliest backlash as noise in each.
const SCORES: usize = 2;
/// Shares of the length's own noise in that of the pose that are tried, until one is worse.
const RATIOS: [f64; 4] = [0.1, 0.3, 1.0, 3.0];
/// An axis that turns by less has no function of its angle, rad.
const LEAST_RANGE: f64 = 0.05;
/// Basis functions for each length of likeness in half the interval (Riutort-Mayol et al., Statistics and Computing 33,
/// 2022), and their limits.
const FUNCTIONS: f64 = 2.65;
const FEWEST: usize = 10;
const MOST: usize = 48;

/// Whether errors of joints can be looked for beside this estimate.
pub(super) fn carries(lengths: &Lengths, estimate: &Estimate) -> bool {
    let used = estimate.used(lengths);
    let prepared = estimate.fit.model.prepare();
    let squares =
        used.by(Sigma::All(1.0)).sum(|reading, _| (reading.length_mm - prepared.length(reading)).powi(2));
    let rms_mm = (squares / used.count().max(1) as f64).sqrt();
    !lengths.are_many()
        && estimate.fit.converged
        && used.count() >= estimate.base.len() + REDUNDANT
        && rms_mm > ROUNDING_MM
}

/// The fit from `estimate`, whose geometry a prior binds, with the lengths that it leaves out. `None` without a gain, or
/// when a number is not finite.
pub(super) fn fit(setting: &Setting<'_>, lengths: &Lengths, estimate: Estimate) -> Option<Estimate> {
    let whole = lengths.weighted(Sigma::Given, &[]);
    let mut found = from(setting, lengths, &estimate)?;
    let mut estimate = estimate;
    // Beside errors of the joints residuals are smaller: outliers show that the geometry alone hides.
    for _ in 0..OUTLIER_ROUNDS {
        let out = outliers(&whole, &found.model, found.effective_parameters as usize);
        if out == estimate.fit.outliers {
            break;
        }
        estimate.fit.outliers = out;
        found = from(setting, lengths, &estimate)?;
    }
    Some(estimate.with_joints(lengths, found))
}

fn from(setting: &Setting<'_>, lengths: &Lengths, estimate: &Estimate) -> Option<JointFit> {
    let used = estimate.used(lengths);
    let mut search = Search::new(setting, estimate, &used)?;
    let mut found = None;
    for round in 0..ROUNDS {
        let step = search.round(&used, round)?;
        // What loses to the geometry by then, no further round makes up for.
        if round == 1 && step.1.value < search.geometry_alone(&step.0)? {
            return None;
        }
        found = Some(step);
    }
    let (system, found) = search.with_ripple(&used, found?)?;
    let gain = found.value - search.geometry_alone(&system)?;
    (gain > GAIN).then(|| search.fitted(&system, gain)).flatten()
}

/// The same model with the variances of `fit`, from other lengths.
pub(super) fn refit(
    setting: &Setting<'_>,
    lengths: &Lengths,
    estimate: &Estimate,
    fit: &JointFit,
) -> Option<LengthModel> {
    let used = lengths.weighted(Sigma::Given, &[]);
    let mut search = Search::new(setting, estimate, &used)?;
    search.model = fit.model.clone();
    search.hypers = fit.hypers;
    search.shape = fit.shape;
    for _ in 0..2 {
        let system = search.linearise(&used);
        search.solve(&system)?;
    }
    Some(search.model)
}

/// Ripples that are looked for at most.
const MOST_RIPPLES: usize = 8;

/// A fit on its way.
#[derive(Clone)]
struct Search<'a> {
    setting: &'a Setting<'a>,
    estimate: &'a Estimate,
    ids: Vec<ParamId>,
    /// 1 / prior standard deviation, 0 of what is free; before that of a group counts.
    weights: Vec<f64>,
    mean: Vec<f64>,
    model: LengthModel,
    hypers: Hypers,
    /// Those before ripples were looked for.
    unsearched: Option<Hypers>,
    shape: NoiseShape,
    sigma_is_given: bool,
    /// The angles of each joint: lowest and highest, rad.
    ranges: [[f64; 2]; AXES],
    visited: [Visited; AXES],
}

impl<'a> Search<'a> {
    fn new(setting: &'a Setting<'a>, estimate: &'a Estimate, used: &Weighted) -> Option<Self> {
        let prior = estimate.prior.as_ref()?;
        let held = |id: &ParamId| setting.options.hold.contains(id) || estimate.kept.contains(id);
        let massless = setting.robot.geometry.masses.is_empty();
        let optional = parameter::optional().filter(|id| !held(id));
        let optional = optional.filter(|id| !(massless && matches!(id, ParamId::Compliance(_))));
        let mut ids: Vec<ParamId> = estimate.kept.iter().copied().chain(optional).collect();
        ids.sort();
        let own = |id: &ParamId| estimate.kept.iter().position(|kept| kept == id);
        let weight = |id: &ParamId| match own(id) {
            Some(at) => prior.sd(at).map_or(0.0, f64::recip),
            None => 1.0,
        };
        let weights: Vec<f64> = ids.iter().map(weight).collect();
        let mean: Vec<f64> = ids.iter().map(|id| setting.start.value(*id)).collect();
        let mut visited: [Vec<f64>; AXES] = Default::default();
        let mut approached = false;
        for (at, _) in used.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY) {
            let reading = used.lengths().reading(at);
            approached |= !reading.approach.is_unknown();
            let angles = setting.start.geometry.coupling.joints(&reading.axes);
            visited.iter_mut().zip(angles).for_each(|(own, angle)| own.push(angle));
        }
        let ranges = [0, 1, 2, 3, 4, 5].map(|at: usize| range(&visited[at]));
        let moved = ranges.map(|[low, high]| high - low >= LEAST_RANGE);
        let backlash = match approached {
            true => BacklashNoise::Known([0.0; AXES]),
            false => BacklashNoise::sought(moved, used.rms_sigma()),
        };
        Some(Self {
            setting,
            estimate,
            ids,
            weights,
            mean,
            model: estimate.fit.model.clone(),
            hypers: Hypers::start(used.rms_sigma()),
            unsearched: None,
            shape: NoiseShape { ratio: RATIOS[0], backlash },
            sigma_is_given: used.lengths().vouched,
            ranges,
            visited: visited.map(Visited::of),
        })
    }

    /// The functions that the length of likeness needs, with the coefficients that are known of them.
    fn errors(&self) -> JointErrors {
        let [quick, _] = self.hypers.processes();
        let joint = |at: usize| {
            let [low, high] = self.ranges[at];
            let half_width = Smooth::half_width_for([low, high]);
            let before = self.model.geometry.joint_errors.at(at).cloned().unwrap_or_default();
            if high - low < LEAST_RANGE {
                return JointError::default();
            }
            let count = ((FUNCTIONS * half_width / quick.likeness_rad) as usize).clamp(FEWEST, MOST);
            let mut smooth = Smooth::new(0.5 * (low + high), half_width, count);
            if smooth.is_alike(&before.smooth) {
                let known = smooth.coefficients.iter_mut().zip(before.smooth.coefficients);
                known.for_each(|(own, value)| *own = value);
            }
            JointError { smooth, visited: self.visited[at], ..before }
        };
        JointErrors::new(std::array::from_fn(joint))
    }

    /// Linearises, finds the variances and solves.
    fn round(&mut self, used: &Weighted, round: usize) -> Option<(System, Found)> {
        if self.shape.backlash.is_known() {
            let found =
                |at: usize| self.model.geometry.joint_errors.at(at).map_or(0.0, |error| error.backlash);
            let relative = std::array::from_fn(|at| found(at).abs() / self.hypers.sigma_mm());
            self.shape.backlash = BacklashNoise::Known(relative);
        }
        self.model.geometry.joint_errors = self.errors();
        let system = self.linearise(used);
        let mut best = self.maximise(&system, self.shape, self.hypers)?;
        if round == 1 && system.lines.poses.iter().any(|rows| rows.len() > 1) {
            for ratio in RATIOS.into_iter().skip(1) {
                let shape = self.shape.with_ratio(ratio);
                let found = self.maximise(&system, shape, best.hypers)?;
                if found.value <= best.value {
                    break;
                }
                (best, self.shape) = (found, shape);
            }
        }
        self.hypers = best.hypers;
        if round + 1 < ROUNDS {
            for _ in 0..SCORES {
                self.score_backlash(&system)?;
            }
        }
        self.solve(&system)?;
        Some((system, best))
    }

    /// With the ripples that more than chance speaks for, one after the other.
    fn with_ripple(&mut self, used: &Weighted, start: (System, Found)) -> Option<(System, Found)> {
        let mut best = start;
        self.unsearched = Some(self.hypers);
        for _ in 0..MOST_RIPPLES {
            let Some(candidate) = self.ripple(&best.0).filter(Candidate::is_believed) else { break };
            let mut wider = self.clone();
            wider.model.geometry.joint_errors.push(candidate.joint, candidate.order);
            let rounds = wider.round(used, ROUNDS).and_then(|_| wider.round(used, ROUNDS));
            let Some(found) = rounds.filter(|(_, found)| found.value > best.1.value + ln_candidates()) else {
                break;
            };
            (*self, best) = (wider, found);
        }
        Some(best)
    }

    /// The ripple that most speaks for beside the fit at the model.
    fn ripple(&self, system: &System) -> Option<Candidate> {
        let reduced = system.reduced(self.shape)?;
        let variances = system.bound_variances();
        let solved = self.evidence(&reduced.normal, &variances).solve(&self.hypers)?;
        let sigma_mm = self.hypers.sigma_mm();
        let beside = Beside {
            system,
            shape: self.shape,
            sigma_mm,
            root: &system.root(&reduced, &solved, sigma_mm)?,
            unknowns: &system.all(&reduced, &solved),
            sd_rad: self.hypers.sd(Group::Ripple),
        };
        beside.strongest()
    }

    fn maximise(&self, system: &System, shape: NoiseShape, start: Hypers) -> Option<Found> {
        let reduced = system.reduced(shape)?;
        let found = self.evidence(&reduced.normal, &system.bound_variances()).maximise(start)?;
        Some(Found { value: found.value + shape.backlash.ln_prior(found.hypers.sigma_mm()), ..found })
    }

    /// Brings the backlash that acts as noise nearer to the likeliest.
    fn score_backlash(&mut self, system: &System) -> Option<()> {
        if self.shape.backlash.is_known() {
            return Some(());
        }
        let reduced = system.reduced(self.shape)?;
        let variances = system.bound_variances();
        let solved = self.evidence(&reduced.normal, &variances).solve(&self.hypers)?;
        let sigma_mm = self.hypers.sigma_mm();
        let of_own = |place: Option<usize>| place.map(|place| self.ids.len() + place);
        let scored = Scored {
            system,
            shape: self.shape,
            sigma_mm,
            unknowns: &system.all(&reduced, &solved),
            root: &system.root(&reduced, &solved, sigma_mm)?,
            coefficients: self.model.geometry.joint_errors.backlash_places().map(of_own),
        };
        self.shape = scored.step()?;
        Some(())
    }

    fn evidence<'b>(&self, normal: &'b Normal, variances: &'b [Variance]) -> Evidence<'b> {
        Evidence { normal, variances, sigma_is_given: self.sigma_is_given }
    }

    /// Where the geometry alone could come to, by the logarithm of its evidence.
    fn geometry_alone(&self, system: &System) -> Option<f64> {
        let geometry = system.with_groups(&[]);
        let found = RATIOS.into_iter().filter_map(|ratio| {
            let shape = NoiseShape { ratio, backlash: BacklashNoise::Known([0.0; AXES]) };
            self.maximise(&geometry, shape, self.hypers)
        });
        found.map(|found| found.value).max_by(f64::total_cmp)
    }

    /// The rows at the model.
    fn linearise(&self, used: &Weighted) -> System {
        let own = self.ids.len();
        let mean = used.by(Sigma::Given).rms_sigma();
        let lines = PoseRows::at(&self.model, &used.by(Sigma::All(1.0)), &self.ids);
        let is_free = |at: &usize| *at < own && self.weights[*at] == 0.0;
        let (free, bound) = (0..lines.values.ncols()).partition(is_free);
        System {
            right: &lines.residual + &lines.values * self.unknowns(),
            weights: lines.places.iter().map(|place| used.lengths().given(*place) / mean).collect(),
            lines,
            variances: self.variances(&self.model.geometry.joint_errors),
            free,
            bound,
        }
    }

    /// The corrections of the model: zero of what is free.
    fn unknowns(&self) -> DVector<f64> {
        let own = (0..self.ids.len()).map(|k| match self.weights[k] {
            0.0 => 0.0,
            _ => self.model.value(self.ids[k]) - self.mean[k],
        });
        let errors = self.model.geometry.joint_errors.coefficients();
        let all: Vec<f64> = own.chain(errors).collect();
        DVector::from_vec(all)
    }

    fn variances(&self, errors: &JointErrors) -> Vec<Variance> {
        let own = (0..self.ids.len()).map(|k| match self.ids[k] {
            id if self.estimate.kept.contains(&id) => Variance::Fixed(self.weights[k].recip()),
            id @ ParamId::Compliance(_) => Variance::Of(Group::Compliance, self.setting.priors.sd(id)),
            _ => Variance::Of(Group::Harmonic, 1.0),
        });
        let backlash = self.shape.backlash.sds().map(|sd| sd * self.hypers.sigma_mm());
        let term = |term: JointTerm| match term.kind {
            TermKind::Smooth { frequency } => Variance::Spectral(frequency),
            TermKind::Backlash if self.shape.backlash.is_known() => Variance::Of(Group::Backlash, 1.0),
            TermKind::Backlash => Variance::ByNoise(backlash[term.joint.index()]),
            TermKind::Ripple { .. } => Variance::Of(Group::Ripple, 1.0),
        };
        own.chain(errors.terms().into_iter().map(term)).collect()
    }

    /// Moves the model to the likeliest unknowns.
    fn solve(&mut self, system: &System) -> Option<()> {
        let reduced = system.reduced(self.shape)?;
        let variances = system.bound_variances();
        let solved = self.evidence(&reduced.normal, &variances).solve(&self.hypers)?;
        let unknowns = system.all(&reduced, &solved);
        let own = self.ids.len();
        for (k, id) in self.ids.iter().enumerate() {
            // Of what is free the unknown is the step itself.
            let step = match self.weights[k] {
                0.0 => unknowns[k],
                _ => self.mean[k] + unknowns[k] - self.model.value(*id),
            };
            self.model.shift(*id, step);
        }
        let errors = &mut self.model.geometry.joint_errors;
        *errors = errors.with(unknowns.iter().skip(own).copied());
        Some(())
    }

    fn fitted(self, system: &System, gain: f64) -> Option<JointFit> {
        let reduced = system.reduced(self.shape)?;
        let variances = system.bound_variances();
        // A part of what a search among many ripples explains is chance: the uncertainty is that without it.
        let cautious = self.unsearched.unwrap_or(self.hypers).with_sd_of(Group::Ripple, &self.hypers);
        let solved = self.evidence(&reduced.normal, &variances).solve(&cautious)?;
        let determined = solved.determined()?;
        let own = self.ids.len();
        let sd = |k: usize| match system.variances[k] {
            _ if self.weights[k] == 0.0 => None,
            variance => Some(variance.sd(&self.hypers)),
        };
        let sds: Vec<Option<f64>> = (0..own).map(sd).collect();
        let prior = PriorRows::independent(&sds, &self.mean);
        Some(JointFit {
            prior,
            root: system.root(&reduced, &solved, cautious.sigma_mm())?,
            groups: self.groups(system, &determined)?,
            effective_parameters: determined.iter().sum::<f64>() + system.free.len() as f64,
            sigma_mm: system.rms_sd(self.shape) * cautious.sigma_mm(),
            noise: LengthNoise {
                pose_mm: cautious.sigma_mm(),
                length_mm: self.shape.ratio * cautious.sigma_mm(),
                joints: None,
            },
            hypers: self.hypers,
            cautious,
            shape: self.shape,
            gain,
            ids: self.ids,
            model: self.model,
        })
    }

    /// What each group that can be estimated came to; what it explains is beyond the groups before it.
    fn groups(&self, system: &System, determined: &[f64]) -> Option<Vec<GroupEvidence>> {
        let present =
            |group: &Group| system.variances.iter().any(|variance| variance.group() == Some(*group));
        let present: Vec<Group> = Group::ALL.into_iter().filter(present).collect();
        let of_geometry = self.left(&system.with_groups(&[]))?;
        let mut before = of_geometry;
        let mut found = Vec::new();
        for (at, group) in present.iter().enumerate() {
            let left = self.left(&system.with_groups(&present[..=at]))?;
            let members = system.bound.iter().zip(determined);
            let members = members.filter(|(k, _)| system.variances[**k].group() == Some(*group));
            let explained = (before - left).max(0.0);
            found.push(GroupEvidence {
                group: *group,
                sd: self.sd_of(*group),
                effective_parameters: members.map(|(_, share)| share).sum(),
                rms_mm: explained.sqrt(),
                share: explained / of_geometry,
            });
            before = left;
        }
        Some(found)
    }

    /// One standard deviation of the members of a group.
    fn sd_of(&self, group: Group) -> f64 {
        match (group, self.shape.backlash) {
            (Group::Smooth, _) => {
                let [quick, slow] = self.hypers.processes();
                quick.sd_rad.hypot(slow.sd_rad)
            }
            (Group::Backlash, BacklashNoise::Sought(sds)) => {
                let moved = sds.iter().filter(|sd| **sd > 0.0).count().max(1) as f64;
                self.hypers.sigma_mm() * (sds.iter().map(|sd| sd * sd).sum::<f64>() / moved).sqrt()
            }
            _ => self.hypers.sd(group),
        }
    }

    /// Mean square of the residuals that a system leaves at these variances, mm^2.
    fn left(&self, system: &System) -> Option<f64> {
        let reduced = system.reduced(self.shape)?;
        let variances = system.bound_variances();
        let solved = self.evidence(&reduced.normal, &variances).solve(&self.hypers)?;
        Some(system.mean_square(&system.all(&reduced, &solved)))
    }
}

/// Lowest and highest, rad.
fn range(angles: &[f64]) -> [f64; 2] {
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    angles.iter().fold(start, |[low, high], angle| [low.min(*angle), high.max(*angle)])
}
