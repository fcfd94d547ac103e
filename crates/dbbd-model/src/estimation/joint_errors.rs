//! The fit with errors of the joints: first harmonic, smooth function of the angle, backlash, ripple and compliance beside
//! the geometry, each group with the variance of the largest evidence.
//!
//! The geometry keeps its prior from the robot's file. The lengths of one pose share the robot's own repeatability: their
//! covariance is sigma^2 (U U' + rho^2 W), U the unit vectors along the bar, W what is given of the lengths. The model is
//! linearised again until it settles. Without a gain in evidence over the geometry alone there are no errors of joints.
//! The noise of a pose stays where the lengths speak for it.

use super::estimate::Estimate;
use super::evidence::{Hypers, Optimum};
use super::fit::outliers;
use super::joint_fit::{JointFit, Solution};
use super::joint_system::{System, SystemPosterior, Whitened};
use super::joint_unknowns::{JointUnknowns, Terms};
use super::lengths::{Lengths, Sigma, Weighted};
use super::noise_shape::{BacklashNoise, NoiseScore, NoiseShape};
use super::options::Setting;
use super::priors::Group;
use super::ripple::{Candidate, RippleSearch, ln_candidates};
use crate::measurement::LengthModel;
use crate::robot::{AXES, Joint};

/// Lengths beyond the parameters of the geometry from which errors of joints are looked for.
const REDUNDANT: usize = 30;
/// Lengths that fit to this are exact, mm.
const ROUNDING_MM: f64 = 1e-6;
/// Gain in the logarithm of the evidence from which errors of joints, or the noise of a pose, are believed.
const GAIN: f64 = 3.0;
/// Rounds in which the set of outliers may change.
const OUTLIER_ROUNDS: usize = 3;
/// Linearisations, and those of the geometry alone.
const ROUNDS: usize = 4;
const GEOMETRY_ROUNDS: usize = 3;
/// Steps towards the likeliest backlash as noise in each.
const SCORES: usize = 2;
/// Shares of the length's own noise in that of the pose that are tried, until one is worse.
const RATIOS: [f64; 4] = [0.1, 0.3, 1.0, 3.0];
/// With this share the lengths of a pose are as good as independent.
const INDEPENDENT: f64 = 30.0;
/// Ripples that are looked for at most.
const MOST_RIPPLES: usize = 8;

/// Whether errors of joints can be looked for beside this estimate.
pub(super) fn can_be_determined(lengths: &Lengths, estimate: &Estimate) -> bool {
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

/// The fit from `estimate`, whose geometry a prior binds: with errors of the joints, or with the noise of a pose alone.
/// `None` without a gain, or when a number is not finite.
pub(super) fn fit(setting: &Setting<'_>, lengths: &Lengths, estimate: Estimate) -> Option<Estimate> {
    if let Some(found) = with_joint_errors(setting, lengths, estimate.clone()) {
        return Some(found);
    }
    let fit = with_pose_noise(setting, lengths, &estimate)?;
    Some(estimate.with_joints(lengths, fit))
}

fn with_joint_errors(setting: &Setting<'_>, lengths: &Lengths, mut estimate: Estimate) -> Option<Estimate> {
    let all = lengths.weighted(Sigma::Given, &[]);
    let mut fit = joint_errors(setting, lengths, &estimate)?;
    // Beside errors of the joints residuals are smaller: outliers show that the geometry alone hides.
    for _ in 0..OUTLIER_ROUNDS {
        let out = outliers(&all, &fit.model, fit.effective_parameters as usize);
        if out == estimate.fit.outliers {
            break;
        }
        estimate.fit.outliers = out;
        fit = joint_errors(setting, lengths, &estimate)?;
    }
    Some(estimate.with_joints(lengths, fit))
}

fn joint_errors(setting: &Setting<'_>, lengths: &Lengths, estimate: &Estimate) -> Option<JointFit> {
    let used = &estimate.used(lengths);
    let unknowns = &JointUnknowns::new(setting, estimate, used, Terms::JointErrors)?;
    let mut search = Search::new(unknowns, used, estimate.fit.model.clone());
    let mut step = search.round(0)?;
    for round in 1..ROUNDS {
        step = search.round(round)?;
        // A fit that is worse than the geometry alone after two rounds does not recover.
        if round == 1 && step.ln_evidence < search.geometry_alone(&step.system)? {
            return None;
        }
    }
    let before_ripple = search.hypers;
    step = search.with_ripple(step)?;
    let gain = step.ln_evidence - search.geometry_alone(&step.system)?;
    // A part of what a search among many ripples explains is chance: the uncertainty is that without it.
    let cautious = before_ripple.with_sd_of(Group::Ripple, &search.hypers);
    if gain > GAIN { search.fitted(&step, cautious, gain) } else { None }
}

/// The geometry with lengths that share the noise of their pose. What the user states of lengths is taken as it is.
fn with_pose_noise(setting: &Setting<'_>, lengths: &Lengths, estimate: &Estimate) -> Option<JointFit> {
    let used = &estimate.used(lengths);
    let unknowns = &JointUnknowns::new(setting, estimate, used, Terms::Geometry)?;
    let mut search = Search::new(unknowns, used, estimate.fit.model.clone());
    let mut step = search.round(0)?;
    if lengths.vouched || !step.system.rows.share_poses() {
        return None;
    }
    for round in 1..GEOMETRY_ROUNDS {
        step = search.round(round)?;
    }
    let independent = step.system.whitened(search.shape.with_ratio(INDEPENDENT), search.hypers.sigma_mm())?;
    let gain = step.ln_evidence - independent.equations.maximise(search.hypers)?.ln_evidence;
    let hypers = search.hypers;
    if gain > GAIN { search.fitted(&step, hypers, 0.0) } else { None }
}

/// The same model with the variances of `fit`, from other lengths.
pub(super) fn refit(
    setting: &Setting<'_>,
    lengths: &Lengths,
    estimate: &Estimate,
    fit: &JointFit,
) -> Option<LengthModel> {
    let used = &lengths.weighted(Sigma::Given, &[]);
    let unknowns = &JointUnknowns::new(setting, estimate, used, fit.terms())?;
    let new = Search::new(unknowns, used, fit.model.clone());
    let mut search = Search { hypers: fit.hypers, shape: fit.shape, ..new };
    for _ in 0..2 {
        let system = search.linearised();
        let whitened = system.whitened(search.shape, search.hypers.sigma_mm())?;
        search.move_to(&whitened.equations.posterior(&search.hypers)?);
    }
    Some(search.model)
}

/// Where a search for the hyper-parameters is.
#[derive(Clone)]
struct Search<'a> {
    unknowns: &'a JointUnknowns,
    used: &'a Weighted<'a>,
    model: LengthModel,
    hypers: Hypers,
    shape: NoiseShape,
}

/// A linearisation with the hyper-parameters that were found for it.
struct Step {
    system: System,
    whitened: Whitened,
    ln_evidence: f64,
}

impl<'a> Search<'a> {
    fn new(unknowns: &'a JointUnknowns, used: &'a Weighted<'a>, model: LengthModel) -> Self {
        Self {
            unknowns,
            used,
            model,
            hypers: Hypers::start(used.rms_sigma()),
            shape: NoiseShape { ratio: RATIOS[0], backlash: unknowns.backlash_noise() },
        }
    }

    /// Linearises, finds the hyper-parameters and moves the model to the likeliest unknowns.
    fn round(&mut self, round: usize) -> Option<Step> {
        if self.shape.backlash.is_known() {
            let errors = &self.model.geometry.joint_errors;
            let backlash = |at: usize| errors.at(at).map_or(0.0, |error| error.backlash);
            self.shape.backlash = BacklashNoise::Known(std::array::from_fn(|at| backlash(at).abs()));
        }
        self.model.geometry.joint_errors =
            self.unknowns.errors(&self.model.geometry.joint_errors, &self.hypers);
        let system = self.linearised();
        let sigma_mm = self.hypers.sigma_mm();
        let mut whitened = system.whitened(self.shape, sigma_mm)?;
        let mut best = maximise(&whitened, self.hypers)?;
        if round == 1 && system.rows.share_poses() {
            for ratio in RATIOS.into_iter().skip(1) {
                let other = system.whitened(self.shape.with_ratio(ratio), sigma_mm)?;
                let optimum = maximise(&other, best.hypers)?;
                if optimum.ln_evidence <= best.ln_evidence {
                    break;
                }
                (best, whitened) = (optimum, other);
            }
        }
        self.hypers = best.hypers;
        if !self.shape.backlash.is_known() && round < ROUNDS {
            for _ in 0..SCORES {
                let shape = self.scored(&system, &whitened)?;
                whitened = system.whitened(shape, self.hypers.sigma_mm())?;
            }
        }
        self.shape = whitened.shape;
        self.move_to(&whitened.equations.posterior(&self.hypers)?);
        Some(Step { system, whitened, ln_evidence: best.ln_evidence })
    }

    fn linearised(&self) -> System {
        self.unknowns.linearised(&self.model, self.used, self.shape.backlash)
    }

    fn move_to(&mut self, posterior: &SystemPosterior<'_>) {
        self.unknowns.move_to(&posterior.mean, &mut self.model);
    }

    /// With the ripples that more than chance speaks for, one after the other.
    fn with_ripple(&mut self, start: Step) -> Option<Step> {
        let mut best = start;
        for _ in 0..MOST_RIPPLES {
            let Some(candidate) = self.ripple(&best).filter(Candidate::is_believed) else { break };
            let mut wider = self.clone();
            wider.model.geometry.joint_errors.push(candidate.joint, candidate.order);
            let least = best.ln_evidence + ln_candidates();
            let Some(step) = wider.round(ROUNDS).filter(|step| step.ln_evidence > least) else { break };
            (*self, best) = (wider, step);
        }
        Some(best)
    }

    /// The ripple of the largest Bayes factor.
    fn ripple(&self, step: &Step) -> Option<Candidate> {
        let posterior = step.whitened.equations.posterior(&self.hypers)?;
        let joints = Joint::ALL.into_iter().filter(|joint| self.unknowns.moved(joint.index()));
        let search = RippleSearch {
            rows: &step.system.rows,
            whitened: &step.whitened,
            sigma_mm: self.hypers.sigma_mm(),
            mean: &posterior.mean,
            root: &posterior.root()?,
            sd_rad: self.hypers.sd(Group::Ripple),
            joints: &joints.collect::<Vec<Joint>>(),
        };
        search.strongest()
    }

    /// The noise after a step of its backlash towards the likeliest.
    fn scored(&self, system: &System, whitened: &Whitened) -> Option<NoiseShape> {
        let posterior = whitened.equations.posterior(&self.hypers)?;
        let score = NoiseScore {
            rows: &system.rows,
            whitened,
            sigma_mm: self.hypers.sigma_mm(),
            mean: &posterior.mean,
            root: &posterior.root()?,
            backlash_places: self.unknowns.backlash_places(&self.model),
        };
        score.step()
    }

    /// The logarithm of the evidence that the geometry alone reaches.
    fn geometry_alone(&self, system: &System) -> Option<f64> {
        let geometry = system.of_geometry();
        let of_ratio = |ratio: f64| {
            let shape = NoiseShape { ratio, backlash: BacklashNoise::Known([0.0; AXES]) };
            Some(maximise(&geometry.whitened(shape, self.hypers.sigma_mm())?, self.hypers)?.ln_evidence)
        };
        RATIOS.into_iter().filter_map(of_ratio).max_by(f64::total_cmp)
    }

    fn fitted(self, step: &Step, cautious: Hypers, gain: f64) -> Option<JointFit> {
        let Self { unknowns, hypers, .. } = self;
        let Step { system, whitened, .. } = step;
        JointFit::of(&Solution { unknowns, system, whitened, hypers, cautious }, self.model, gain)
    }
}

/// The hyper-parameters of the largest evidence, that of backlash as noise included.
fn maximise(whitened: &Whitened, start: Hypers) -> Option<Optimum> {
    let optimum = whitened.equations.maximise(start)?;
    let of_noise = whitened.shape.backlash.ln_prior();
    Some(Optimum { ln_evidence: optimum.ln_evidence + of_noise, ..optimum })
}
