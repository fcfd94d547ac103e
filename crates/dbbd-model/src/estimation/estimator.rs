//! The estimate: maximum a posteriori of all unknowns, with the variances that have the largest marginal likelihood.
//!
//! Geometry, set-up, bar, errors of the joints, and errors that no parameter explains are groups of one linear system.
//! The lengths of one pose share the repeatability of the robot: their covariance is m^2 U U' + t^2 W, with U the unit
//! vectors along the bar and W from the given standard deviations of the lengths. The model is linearised again until
//! it settles. A group that the lengths do not support shrinks: nothing is chosen by a threshold.

use nalgebra::{Cholesky, DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::Analysis;
use super::ball_motion::BallMotion;
use super::fit::{Fit, outliers};
use super::hyper_parameters::{Group, HYPERS, HyperPrior, Hypers, SIGMA, Variance};
use super::hypotheses::{
    EventSearch, JudgedEvent, MAX_CERTAIN, MIN_LENGTHS, SupposedEvent, are_wrong_balls, sd_along, wrong_balls,
};
use super::leave_one_out::LeftOutVisits;
use super::lengths::{Lengths, Sigma, Weighted};
use super::noise_score::NoiseScore;
use super::noise_shape::{JointNoise, NoiseShape, OwnNoise};
use super::options::{ErrorModel, Setting};
use super::pose_rows::{LengthAtPose, LengthNoise, PoseRows};
use super::priors::uncertified_variance;
use super::ripple::{Candidate, RippleSearch, ln_candidates};
use super::selection::{is_bar, is_place};
use super::shifted_rows::ShiftedRowSearch;
use super::start::EstimateStart;
use super::system::{NormalSums, System, SystemPosterior, Whitened};
use super::unknowns::{USUAL_SIGMA_MM, Unknowns};
use super::workspace::take_out_rigid_motion;
use crate::estimation::EstimationFinding;
use crate::math::distributions::ChiSquareOutcome;
use crate::math::map_items;
use crate::measurement::LengthModel;
use crate::robot::{
    AXES, Approach, BallId, GaussianProcess, Geometry, Joint, ParamId, Robot, RobotUncertainty,
};

/// Rounds in which the set of outliers may change.
const OUTLIER_ROUNDS: usize = 3;
/// Linearisations in which the variances settle.
const ROUNDS: usize = 4;
/// Least number of linearisations with known variances for other lengths, and the largest number of them.
const MIN_REFIT_ROUNDS: usize = 2;
const MAX_REFIT_ROUNDS: usize = 30;
/// A model is at rest if its step is shorter, in standard deviations of the posterior: no parameter moves by more than this
/// share of its own standard deviation, which adds 2 % to it, and the unknowns become more probable by a factor of 1.02 at
/// most.
const REST: f64 = 0.2;
/// More lengths than this are summed a piece at a time, with the variances from an even sample.
const MAX_WHOLE: usize = 4800;
/// Rows of a piece of many lengths, and pieces whose sums are in memory together.
const PIECE: usize = 1024;
const TOGETHER: usize = 8;
/// Number of poses over which a geometry alone is fitted to the estimate.
const PROJECTED: usize = 400;
/// With fewer degrees of freedom the residuals say nothing about the noise.
const MIN_FREEDOM: f64 = 0.5;
/// Noise that is larger by less than this factor counts as the same.
const SAME_NOISE: f64 = 1.5;
/// The variances are settled if a round changes the logarithm of the evidence by less.
const SETTLED: f64 = 1e-3;
/// Largest number of ripples that are searched.
const MAX_RIPPLES: usize = 8;
/// Ripple is searched only if there are this many more lengths than parameters.
const REDUNDANT: usize = 30;
/// The share of a pose's noise in a standard deviation that is stated for the whole length.
const POSE_SHARE: f64 = 0.1;
/// A pose scatters by at least this share of the noise of a length.
const MIN_POSE: f64 = 0.05;

#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// The nominal robot with the free part of the set-up fitted, and the same with bars as stated.
    pub(crate) before: LengthModel,
    at_start: LengthModel,
    pub(crate) analysis: Analysis,
    /// The estimated parameters, in canonical order.
    pub(crate) kept: Vec<ParamId>,
    /// The estimated parameters that are independent by the lengths alone.
    pub(crate) base: Vec<ParamId>,
    /// Coordinates of the set-up that the poses do not determine: they are fixed.
    pub(crate) open: Vec<ParamId>,
    pub(super) fit: Fit,
    /// The weights of the lengths, and the degrees of freedom if the residuals were used.
    pub(super) sigma: Sigma,
    pub(super) freedom: Option<f64>,
    /// The degrees of freedom of the errors of a visit; `None` for normal ones.
    visit_freedom: Option<f64>,
    /// Prior standard deviations of the estimated parameters; `None` for a free one.
    pub(super) prior_sds: Vec<Option<f64>>,
    /// A root of the covariance of parameters and coefficients, a row for each.
    pub(super) root: DMatrix<f64>,
    /// A factor of root' P root, with P the precision of the prior and C = root root' the covariance of all unknowns.
    /// The identity minus this product is the part of the noise.
    pub(super) of_prior: DMatrix<f64>,
    pub(super) groups: Vec<GroupEvidence>,
    /// How far the data determine each unknown, from 0 to 1.
    determined: Vec<f64>,
    pub(super) noise: LengthNoise<'static>,
    pub(super) hypers: Hypers,
    /// The hyper-parameters with which the uncertainty is computed.
    cautious: Hypers,
    pub(super) shape: NoiseShape,
    /// Random error of each joint's angle from visit to visit, one standard deviation, rad.
    scatter_rad: [f64; AXES],
    /// Error of each joint's angle by backlash where the sense of approach is not known, one standard deviation, rad.
    pub(super) unapproached_rad: [f64; AXES],
    unknowns: Unknowns,
    /// The values of the unknowns in the model.
    z: DVector<f64>,
    bar_sds: Vec<f64>,
    /// Events that happened while the lengths were measured, or could have happened.
    pub(super) events: Vec<JudgedEvent>,
    /// The effect of the certain events on each length, mm; empty without such events.
    pub(super) event_mm: Vec<f64>,
    /// The errors that a result of the geometry alone leaves out.
    pub(super) left_out: Option<GeometryRemainder>,
    /// Rows that belong to another ball than the table says.
    pub(super) wrong_balls: Vec<(usize, BallId)>,
}

/// The errors that a geometry alone leaves out of an estimate.
#[derive(Clone, Debug)]
pub(super) struct GeometryRemainder {
    /// The geometry with all errors of the joints, and its uncertainty.
    pub(super) whole: Geometry,
    pub(super) uncertainty: RobotUncertainty,
    /// The displacement that is left out at the measured poses, with its uncertainty: root mean square in each
    /// direction, mm.
    rms_mm: f64,
}

impl GeometryRemainder {
    /// The displacement of the tool ball between the geometry `alone` and the whole geometry at poses, 3 rows for each
    /// pose, mm; the rigid motion of all poses is removed.
    pub(super) fn displacements(&self, alone: &Geometry, poses: &[([f64; AXES], Approach)]) -> DVector<f64> {
        let [whole, alone] = [&self.whole, alone].map(|geometry| BallMotion::new(geometry, poses, &[]).balls);
        let mut off =
            DMatrix::from_fn(3 * poses.len(), 1, |row, _| (whole[row / 3] - alone[row / 3])[row % 3]);
        take_out_rigid_motion(&mut off, &alone);
        off.column(0).into_owned()
    }
}

/// The evidence for a group of unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupEvidence {
    #[serde(rename = "name")]
    pub group: Group,
    /// One standard deviation of the group's members by the evidence: rad or mm; in prior standard deviations for
    /// compliance, tolerance and tool ball.
    pub sd: f64,
    /// Number of the group's members that the data determine.
    pub effective_parameters: f64,
    /// The part of the lengths that the group explains beyond the geometry and the groups before it, root mean square,
    /// mm.
    pub rms_mm: f64,
    /// The explained squares as a share of the squared residuals that the geometry alone leaves; `None` for geometry
    /// and tool ball.
    pub share: Option<f64>,
}

/// The errors of the joints in a result; this is `joint_errors` of `result.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointSummary {
    /// The smooth functions are the sum of a fast and a slow process.
    pub smooth: [GaussianProcess; 2],
    /// Half of the reversal error of each joint as noise, one standard deviation, rad, if no sense of approach is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backlash_noise_rad: Option<[f64; AXES]>,
}

/// Estimates the parameters among `asked` that the data or a prior determine, from the nominal robot and a rough
/// set-up.
///
/// # Errors
/// A number is not finite, or there is nothing to estimate.
pub(super) fn estimate(
    setting: &Setting<'_>,
    lengths: &Lengths,
    asked: &[ParamId],
) -> Result<Estimate, EstimationFinding> {
    let found = with_wrong_balls(setting, lengths, asked)?;
    Ok(match setting.options.model {
        ErrorModel::Geometric => found.geometry_alone(setting, lengths),
        ErrorModel::Joints => found,
    })
}

fn with_wrong_balls(
    setting: &Setting<'_>,
    lengths: &Lengths,
    asked: &[ParamId],
) -> Result<Estimate, EstimationFinding> {
    let found = with_events(setting, lengths, asked)?;
    let sd_mm = found.used(lengths).rms_sigma().hypot(MIN_ERROR_MM);
    let wrong = wrong_balls(&found.fit.model, lengths, &found.fit.outliers, sd_mm);
    if !are_wrong_balls(wrong.len(), lengths.len(), sd_mm) {
        return Ok(found);
    }
    let again = with_events(setting, &lengths.relabelled(&wrong), asked)?;
    Ok(Estimate { wrong_balls: wrong, ..again })
}

/// A length to another ball is predicted no better than this, mm.
const MIN_ERROR_MM: f64 = 0.05;

/// The estimate with the events that happened while the lengths were measured; without them if shifted rows explain the
/// lengths.
fn with_events(
    setting: &Setting<'_>,
    lengths: &Lengths,
    asked: &[ParamId],
) -> Result<Estimate, EstimationFinding> {
    let found = with_outliers(setting, lengths, asked, true)?;
    if !found.events.iter().any(|event| event.is_certain) {
        return Ok(found);
    }
    let plain = with_outliers(setting, lengths, asked, false)?;
    Ok(if plain.shifted_rows(lengths).is_some() { plain } else { found })
}

fn with_outliers(
    setting: &Setting<'_>,
    lengths: &Lengths,
    asked: &[ParamId],
    seeks_events: bool,
) -> Result<Estimate, EstimationFinding> {
    let mut start = EstimateStart::of(setting, lengths, asked)?;
    // Many outliers may come from an event that began at one row. Then they are no outliers, and with them the noise is
    // no larger.
    if seeks_events && start.fit.outliers.len() >= MIN_LENGTHS {
        let whole = EstimateStart {
            fit: Fit { outliers: gross(lengths, &start), ..start.fit.clone() },
            ..start.clone()
        };
        let [without, with] = [&start, &whole].map(|start| from_start(setting, lengths, start, true));
        if let (Some(without), Some(with)) = (without, with)
            && with.events.iter().any(|event| event.is_certain)
            && with.noise.sigma_mm() < SAME_NOISE * without.noise.sigma_mm()
        {
            start = whole;
        }
    }
    for round in 0.. {
        let found = from_start(setting, lengths, &start, seeks_events).ok_or(EstimationFinding::NotFinite)?;
        // With errors of the joints the residuals are smaller: outliers appear that the geometry alone hides.
        let corrected = found.corrected(lengths);
        let all = corrected.weighted(Sigma::Given, &[]);
        let out = outliers(&all, &found.fit.model, found.effective_parameters() as usize);
        if round == OUTLIER_ROUNDS || out == found.fit.outliers || lengths.len() > MAX_WHOLE {
            return Ok(found);
        }
        start.fit.outliers = out;
    }
    Err(EstimationFinding::NotFinite)
}

/// Rows with an outlier that is too large for a ball or a bar that moved while the lengths were measured.
fn gross(lengths: &Lengths, start: &EstimateStart) -> Vec<usize> {
    /// Larger residuals are mistakes of a row, mm.
    const GROSS_MM: f64 = 20.0;
    let prepared = start.fit.model.prepare();
    let is_gross = |at: &usize| prepared.residual(&lengths.reading(*at)).abs() > GROSS_MM;
    start.fit.outliers.iter().copied().filter(is_gross).collect()
}

fn from_start(
    setting: &Setting<'_>,
    lengths: &Lengths,
    start: &EstimateStart,
    seeks_events: bool,
) -> Option<Estimate> {
    let all = lengths.weighted(start.sigma, &start.fit.outliers);
    // The variances follow from an even sample of many lengths.
    let places = (all.count() > MAX_WHOLE).then(|| all.sampled_places());
    let sample = places.as_ref().map(|places| lengths.at(places));
    let used = &sample.as_ref().map_or(all, |sample| sample.weighted(start.sigma, &[]));
    let known = start.known_before(setting, lengths)?;
    let model = if known.has_coefficients { &start.at_start } else { &start.fit.model };
    let with_errors = setting.options.seeks_joint_errors();
    let mut unknowns = Unknowns::new(known, model, used, with_errors);
    let (mut state, mut events): (_, Vec<JudgedEvent>) = (None, Vec::new());
    loop {
        let first = usize::from(state.is_some());
        let mut search = Search::new(&unknowns, used, model.clone(), state.take());
        let step = search.round(first)?;
        let mut step = search.settled(step, first + 1)?;
        let has_room = unknowns.events().len() < MAX_CERTAIN;
        let event = if with_errors && seeks_events && has_room { search.event(&step) } else { None };
        let certain = event.as_ref().filter(|event| event.is_certain).map(|event| event.event);
        events.extend(event);
        if let Some(event) = certain {
            state = Some(search.state());
            unknowns = unknowns.with_event(event);
            continue;
        }
        if with_errors && !unknowns.has_coefficients() && used.count() >= start.base.len() + REDUNDANT {
            step = search.with_ripple(step)?;
            step = search.settled(step, ROUNDS)?;
        }
        if sample.is_some() && step.is_at_rest() {
            search.streamed(&mut step, &all)?;
        }
        // An event that was found in the sample gets its row among all lengths.
        for (_, place) in events.iter_mut().filter_map(|judged| judged.event.from.as_mut()) {
            *place = places.as_ref().map_or(*place, |places| places[*place]);
        }
        let found = search.estimate(&step, &all, start, events)?;
        let groups = groups(&step.system, &step.whitened, &found.hypers, &found.determined)?;
        return Some(Estimate { groups, ..found });
    }
}

/// Groups whose standard deviations are multiples of what is stated.
const AS_STATED: [Group; 2] = [Group::Tolerance, Group::Tool];

/// The variances with which an estimate is expected.
pub(super) enum ForecastVariances<'a> {
    /// Those that were found before.
    Found(&'a Estimate),
    /// The means of their priors: the mean over all robots of a standard deviation that is stated after the lengths is its mean before
    /// them.
    Expected,
    /// Drawn from their priors with a seed.
    Drawn(u64),
}

/// Lengths of which an estimate is expected; those that are still to be measured agree with the model.
pub(super) struct ForecastStart<'a> {
    setting: &'a Setting<'a>,
    lengths: &'a Lengths<'a>,
    start: EstimateStart,
}

impl<'a> ForecastStart<'a> {
    /// # Errors
    /// A number is not finite, or there is nothing to estimate.
    pub(super) fn new(
        setting: &'a Setting<'a>,
        lengths: &'a Lengths<'a>,
        asked: &[ParamId],
    ) -> Result<Self, EstimationFinding> {
        Ok(Self { setting, lengths, start: EstimateStart::of(setting, lengths, asked)? })
    }

    /// The estimate that is expected. `None` if a number is not finite.
    pub(super) fn forecast(&self, variances: ForecastVariances<'_>) -> Option<Estimate> {
        forecast_from(self.setting, self.lengths, &self.start, variances)
    }
}

fn forecast_from(
    setting: &Setting<'_>,
    lengths: &Lengths,
    start: &EstimateStart,
    variances: ForecastVariances<'_>,
) -> Option<Estimate> {
    let used = &lengths.weighted(Sigma::Given, &start.fit.outliers);
    let known = start.known_before(setting, lengths)?;
    let model = if known.has_coefficients { &start.at_start } else { &start.fit.model };
    let unknowns = Unknowns::new(known, model, used, setting.options.seeks_joint_errors());
    let mut search = Search::new(&unknowns, used, model.clone(), None);
    let priors = HyperPrior::all(lengths.repeatability_mm.unwrap_or(USUAL_SIGMA_MM));
    // The maker's tolerance and the tool ball are as stated until lengths contradict them.
    let as_stated = |hypers: Hypers| {
        hypers.with_sigma(priors[SIGMA].median).with_groups(AS_STATED.map(|group| (group, 1.0)))
    };
    match variances {
        ForecastVariances::Found(before) => {
            search.state.hypers = before.cautious.with_sigma(before.hypers.sigma_mm());
            search.state.shape = before.shape;
        }
        ForecastVariances::Expected => {
            search.state.hypers = as_stated(search.state.hypers);
            search.ln_sd = priors.map(|prior| prior.ln_sd);
            AS_STATED.into_iter().for_each(|group| search.ln_sd[group as usize] = 0.0);
        }
        ForecastVariances::Drawn(seed) => {
            let mut random = Pcg64::seed_from_u64(seed);
            search.state.hypers = as_stated(Hypers::drawn(&priors, || StandardNormal.sample(&mut random)));
        }
    }
    let SearchState { model, hypers, .. } = &mut search.state;
    model.geometry.joint_errors = unknowns.errors(&model.geometry.joint_errors, hypers);
    let step = search.stepped(search.linearised())?;
    search.estimate(&step, used, start, Vec::new())
}

/// The model that is fitted to other lengths with the same variances: after the first linearisation, and when it has
/// come to rest. `None` if it does not come to rest.
pub(super) fn refit(lengths: &Lengths, estimate: &Estimate) -> Option<[LengthModel; 2]> {
    let used = &lengths.weighted(Sigma::Given, &[]);
    let unknowns = &estimate.unknowns;
    let model = estimate.fit.model.clone();
    let state = SearchState {
        model,
        z: estimate.z.clone(),
        hypers: estimate.hypers,
        shape: estimate.shape,
        bar_sds: estimate.bar_sds.clone(),
    };
    let mut search = Search { unknowns, used, state, ln_sd: [0.0; HYPERS] };
    let mut first = None;
    for round in 1..=MAX_REFIT_ROUNDS {
        let step = search.stepped(search.linearised())?;
        let first = first.get_or_insert_with(|| search.state.model.clone());
        if round >= MIN_REFIT_ROUNDS && step.is_at_rest() {
            return Some([first.clone(), search.state.model]);
        }
    }
    None
}

/// The state of a search for the hyper-parameters.
#[derive(Clone)]
struct Search<'a> {
    unknowns: &'a Unknowns,
    used: &'a Weighted<'a>,
    state: SearchState,
    /// Standard deviations of the logarithms of the hyper-parameters.
    ln_sd: [f64; HYPERS],
}

#[derive(Clone)]
struct SearchState {
    model: LengthModel,
    /// The values of the unknowns in the model.
    z: DVector<f64>,
    hypers: Hypers,
    shape: NoiseShape,
    /// Prior standard deviations of bars without a certificate, mm.
    bar_sds: Vec<f64>,
}

/// A linearisation, whitened with the noise that was found for it.
struct Step {
    system: System,
    whitened: Whitened,
    ln_evidence: f64,
    /// The step to the most probable unknowns, in standard deviations of the posterior.
    step_sds: f64,
}

impl Step {
    fn is_at_rest(&self) -> bool {
        self.step_sds < REST
    }
}

impl<'a> Search<'a> {
    /// Begins at a state, else at a model and the medians of the priors.
    fn new(
        unknowns: &'a Unknowns,
        used: &'a Weighted<'a>,
        model: LengthModel,
        state: Option<SearchState>,
    ) -> Self {
        let (lengths, start_mm) = (used.lengths(), used.rms_sigma());
        let stated_mm = if lengths.known { used.by(Sigma::Given).rms_sigma() } else { MIN_POSE * start_mm };
        let pose_mm = if lengths.is_sigma_given { POSE_SHARE * stated_mm } else { start_mm };
        // The pose and the independent noise together have the stated standard deviation.
        let stated_mm = if lengths.is_sigma_given {
            stated_mm * (1.0 - POSE_SHARE * POSE_SHARE).sqrt()
        } else {
            stated_mm
        };
        let state = state.unwrap_or_else(|| SearchState {
            z: unknowns.at(&model, &DVector::zeros(0)),
            model,
            hypers: Hypers::start(&HyperPrior::all(1.0), pose_mm),
            shape: NoiseShape { own: OwnNoise::Stated(stated_mm), joints: unknowns.joint_noise() },
            bar_sds: Vec::new(),
        });
        Self { unknowns, used, state, ln_sd: [0.0; HYPERS] }
    }

    fn state(&self) -> SearchState {
        self.state.clone()
    }

    /// The most probable event of the run, if it is more probable than no event. Its effect was in the noise before:
    /// events that are not unlikely are therefore judged again, with variances that are fitted to them.
    fn event(&self, step: &Step) -> Option<JudgedEvent> {
        let lengths = self.used.lengths();
        if !step.system.is_noisy() {
            return None;
        }
        let posterior = step.whitened.equations.posterior(&self.state.hypers)?;
        let sigma_mm = self.state.hypers.sigma_mm();
        let search = EventSearch::new(&step.system.rows, &step.whitened, &posterior, lengths, sigma_mm)?;
        let mut candidates = search.candidates(self.unknowns.events());
        for candidate in candidates.iter_mut().filter(|candidate| candidate.is_worth_a_fit()) {
            let unknowns = self.unknowns.clone().with_event(candidate.event);
            let mut again =
                Search { unknowns: &unknowns, used: self.used, state: self.state.clone(), ln_sd: self.ln_sd };
            if let Some(with) = again.round(1) {
                candidate.ln_bayes =
                    candidate.ln_bayes.max(with.ln_evidence - step.ln_evidence - candidate.ln_sizes());
            }
        }
        search.strongest(candidates)
    }

    /// Finds the hyper-parameters in the rounds that are left from the round `from` on after a step, and then keeps them until the
    /// model is at rest. Returns the last step.
    fn settled(&mut self, mut step: Step, from: usize) -> Option<Step> {
        for round in from..ROUNDS {
            let before = step.ln_evidence;
            step = self.round(round)?;
            if step.is_at_rest() && (step.ln_evidence - before).abs() < SETTLED {
                break;
            }
        }
        // A round changes the noise after its step.
        if !self.state.shape.is_known() {
            step = self.stepped(self.linearised())?;
        }
        for _ in 0..MAX_REFIT_ROUNDS {
            if step.is_at_rest() {
                break;
            }
            step = self.stepped(self.linearised())?;
        }
        Some(step)
    }

    /// Linearises, finds the hyper-parameters and moves the model to the most probable unknowns.
    fn round(&mut self, round: usize) -> Option<Step> {
        if let JointNoise::Approached { backlash, .. } = &mut self.state.shape.joints {
            let errors = &self.state.model.geometry.joint_errors;
            *backlash = std::array::from_fn(|at| errors.at(at).map_or(0.0, |error| error.backlash.abs()));
        }
        self.state.model.geometry.joint_errors =
            self.unknowns.errors(&self.state.model.geometry.joint_errors, &self.state.hypers);
        let system = self.linearised();
        if round == 0 && !system.is_sigma_given && system.rows.tell_noise_apart() {
            let stated = if self.used.lengths().known { self.state.shape.own.sd() } else { system.sigma_mm };
            self.state.shape.own = OwnNoise::Sought { sd: stated.min(self.state.hypers.sigma_mm()), stated };
        }
        let mut whitened = system.whitened(self.state.shape, self.state.hypers.sigma_mm())?;
        let best = whitened.equations.maximise(self.state.hypers)?;
        self.ln_sd = best.ln_sd;
        whitened.shape = self.state.shape.scaled(best.hypers.sigma_mm() / self.state.hypers.sigma_mm());
        self.rescale(best.hypers);
        if !self.state.shape.is_known() {
            let posterior = whitened.equations.posterior(&best.hypers)?;
            self.state.shape = self.scored(&system, &whitened, &posterior)?;
        }
        let whitened = system.whitened(self.state.shape, self.state.hypers.sigma_mm())?;
        let posterior = whitened.equations.posterior(&self.state.hypers)?;
        let ln_evidence = self.ln_evidence(&posterior);
        let scored = self.scored(&system, &whitened, &posterior)?;
        self.state.bar_sds = self.bar_sds(&posterior)?;
        let step_sds = self.move_to(&system, &whitened, &posterior)?;
        self.state.shape = scored;
        Some(Step { system, whitened, ln_evidence, step_sds })
    }

    /// Moves the model to the most probable unknowns of a system, with the hyper-parameters as they are.
    fn stepped(&mut self, system: System) -> Option<Step> {
        let whitened = system.whitened(self.state.shape, self.state.hypers.sigma_mm())?;
        let posterior = whitened.equations.posterior(&self.state.hypers)?;
        let step_sds = self.move_to(&system, &whitened, &posterior)?;
        let ln_evidence = self.ln_evidence(&posterior);
        Some(Step { system, whitened, ln_evidence, step_sds })
    }

    /// The logarithm of the evidence for all that is sought.
    fn ln_evidence(&self, posterior: &SystemPosterior<'_>) -> f64 {
        posterior.ln_evidence(&self.state.hypers) + self.state.shape.joints.ln_prior()
    }

    /// The prior standard deviations of bars without a certificate, from the posterior of their lengths.
    fn bar_sds(&self, posterior: &SystemPosterior<'_>) -> Option<Vec<f64>> {
        let columns = self.unknowns.bar_columns();
        let mean_square = |k: usize| Some(posterior.mean[k].powi(2) + posterior.variance(k)?);
        columns.map(|k| Some(uncertified_variance(mean_square(k)?).sqrt())).collect()
    }

    /// Takes over hyper-parameters, whose sigma scales the whole noise; a stated part of the noise stays.
    fn rescale(&mut self, hypers: Hypers) {
        let (before_mm, now_mm) = (self.state.hypers.sigma_mm(), hypers.sigma_mm());
        let own_mm = self.state.shape.own.sd();
        let whole = now_mm.powi(2) * (1.0 + (own_mm / before_mm).powi(2));
        let pose_mm = match &mut self.state.shape.own {
            OwnNoise::Stated(_) if self.used.lengths().is_sigma_given => now_mm,
            OwnNoise::Stated(own) => (whole - *own * *own).max(MIN_POSE.powi(2) * whole).sqrt(),
            OwnNoise::Sought { sd, .. } => {
                *sd *= now_mm / before_mm;
                now_mm
            }
        };
        self.state.hypers = hypers.with_sigma(pose_mm);
    }

    fn linearised(&self) -> System {
        let z = self.unknowns.at(&self.state.model, &self.state.z);
        self.unknowns.linearised(
            &self.state.model,
            &z,
            self.used,
            self.state.shape.joints,
            &self.state.bar_sds,
        )
    }

    /// Moves the model towards the most probable unknowns. Lengths are not linear in the model: if the whole step makes the
    /// unknowns less probable, it follows the curve of equal lengths to second order (Transtrum and Sethna, "Improvements to
    /// the Levenberg-Marquardt algorithm", arXiv 1201.5885), and is halved until it makes them more probable, or is none.
    /// Returns the length of the step in standard deviations of the posterior: its square is twice the logarithm of the factor
    /// by which the unknowns became more probable.
    fn move_to(
        &mut self,
        system: &System,
        whitened: &Whitened,
        posterior: &SystemPosterior<'_>,
    ) -> Option<f64> {
        /// Rounding of the sum of squares, as a share of it.
        const ROUNDING: f64 = 1e-12;
        /// The share of the step over which the curve is measured.
        const PROBE: f64 = 0.1;
        let (values, variance) = (&system.rows.values, self.state.hypers.sigma_mm().powi(2));
        let now = self.unknowns.at(&self.state.model, &self.state.z);
        let own = self.unknowns.of_model(&self.state.model);
        let is_known = self.state.z.len() == posterior.mean.len();
        let mut from = if is_known { self.state.z.clone() } else { &posterior.mean * 0.0 };
        from.rows_mut(0, own).copy_from(&now.rows(0, own));
        let step = &posterior.mean - &from;
        // The model at unknowns, and its lengths beyond the linear ones.
        let at = |z: &DVector<f64>| {
            let mut model = self.state.model.clone();
            self.unknowns.move_to(&now, z, &mut model);
            let beyond = self.residuals(&model, system) - &system.rows.residual
                + values.columns(0, own) * (z - &from).rows(0, own);
            (model, beyond)
        };
        let cost = |z: &DVector<f64>, beyond: &DVector<f64>| {
            let mut left = &system.right - values * z + beyond;
            whitened.whitening.apply(&mut left);
            let of_prior = z
                .iter()
                .zip(&system.variances)
                .filter_map(|(z, variance)| Some(z * z / variance.as_ref()?.value(&self.state.hypers)));
            left.norm_squared() / variance + of_prior.sum::<f64>()
        };
        // An increase by rounding is none.
        let here = cost(&from, &(&system.right * 0.0)) * (1.0 + ROUNDING);
        let mut z = posterior.mean.clone();
        let (mut model, beyond) = at(&z);
        let mut there = cost(&z, &beyond);
        if there > here {
            let (_, mut bend) = at(&(&from + &step * PROBE));
            whitened.whitening.apply(&mut bend);
            let root = posterior.root()?;
            let bend = &root * root.tr_mul(&whitened.rows.tr_mul(&bend)) / (variance * PROBE * PROBE);
            let mut share = 1.0;
            while there > here && share > f64::EPSILON {
                z = &from + &step * share + &bend * (share * share);
                let (moved, beyond) = at(&z);
                (model, there) = (moved, cost(&z, &beyond));
                share *= 0.5;
            }
        }
        self.state.model = model;
        self.state.z = self.unknowns.rested(z);
        Some((here - there).max(0.0).sqrt())
    }

    /// Measured minus predicted length of a model for each row of a system, mm.
    fn residuals(&self, model: &LengthModel, system: &System) -> DVector<f64> {
        let (prepared, lengths) = (model.prepare(), self.used.lengths());
        let of = |row: &LengthAtPose| prepared.residual(&lengths.reading(row.place));
        DVector::from_iterator(system.rows.lengths.len(), system.rows.lengths.iter().map(of))
    }

    /// Computes the equations of all lengths, a piece at a time, with the variances that were found.
    fn streamed(&mut self, step: &mut Step, all: &Weighted) -> Option<()> {
        let z = self.unknowns.at(&self.state.model, &self.state.z);
        let places: Vec<usize> = all.used_places().collect();
        let pieces: Vec<&[usize]> = places.chunks(PIECE).collect();
        let sums_of = |piece: &&[usize]| {
            let some = all.lengths().at(piece);
            let used = some.weighted(Sigma::Given, &[]);
            let system = self.unknowns.linearised(
                &self.state.model,
                &z,
                &used,
                self.state.shape.joints,
                &self.state.bar_sds,
            );
            system.normal_sums(self.state.shape, self.state.hypers.sigma_mm())
        };
        let mut sums: Option<NormalSums> = None;
        for some in pieces.chunks(TOGETHER) {
            for more in map_items(some, sums_of) {
                let more = more?;
                sums = Some(match sums.take() {
                    Some(sums) => sums.and(&more),
                    None => more,
                });
            }
        }
        step.whitened.equations = sums?.equations(&step.system)?;
        let posterior = step.whitened.equations.posterior(&self.state.hypers)?;
        let now = self.unknowns.at(&self.state.model, &self.state.z);
        self.unknowns.move_to(&now, &posterior.mean, &mut self.state.model);
        self.state.z = self.unknowns.rested(posterior.mean.clone());
        Some(())
    }

    /// Adds the ripples that the evidence supports beyond chance, one after the other.
    fn with_ripple(&mut self, start: Step) -> Option<Step> {
        let mut best = start;
        for _ in 0..MAX_RIPPLES {
            let Some(candidate) = self.ripple(&best).filter(Candidate::is_believed) else { break };
            let mut wider = self.clone();
            wider.state.model.geometry.joint_errors.push(candidate.joint, candidate.order);
            let least = best.ln_evidence + ln_candidates();
            let Some(step) = wider.round(1).filter(|step| step.ln_evidence > least) else { break };
            (*self, best) = (wider, step);
        }
        Some(best)
    }

    /// The ripple with the largest Bayes factor. During the search the scatter of the joints is at most its usual
    /// value, because the effect of a ripple was part of the noise before.
    fn ripple(&self, step: &Step) -> Option<Candidate> {
        let shape = NoiseShape { joints: self.state.shape.joints.at_most_usual(), ..self.state.shape };
        let whitened = step.system.whitened(shape, self.state.hypers.sigma_mm())?;
        let posterior = whitened.equations.posterior(&self.state.hypers)?;
        let joints = Joint::ALL.into_iter().filter(|joint| self.unknowns.moved(joint.index()));
        let search = RippleSearch {
            rows: &step.system.rows,
            whitened: &whitened,
            posterior: &posterior,
            sd_rad: self.state.hypers.sd(Group::Ripple),
            joints: &joints.collect::<Vec<Joint>>(),
        };
        search.strongest()
    }

    /// The noise after a step towards its most probable value; what is not sought stays.
    fn scored(
        &self,
        system: &System,
        whitened: &Whitened,
        posterior: &SystemPosterior<'_>,
    ) -> Option<NoiseShape> {
        if self.state.shape.is_known() {
            return Some(self.state.shape);
        }
        let score = NoiseScore {
            rows: &system.rows,
            whitened,
            posterior,
            backlash_places: self.unknowns.backlash_places(&self.state.model),
        };
        Some(self.state.shape.with_sought(score.step()?))
    }

    fn estimate(
        self,
        step: &Step,
        whole: &Weighted,
        start: &EstimateStart,
        mut events: Vec<JudgedEvent>,
    ) -> Option<Estimate> {
        let Step { system, whitened, .. } = step;
        let Self { unknowns, used, ln_sd, state } = self;
        let SearchState { model, z, hypers, shape, bar_sds } = state;
        let cautious = hypers.mean_sds(whitened.equations.hyper_priors(), &ln_sd);
        let posterior = whitened.equations.posterior(&cautious)?;
        let determined = posterior.determined();
        // Whoever lists parameters without a prior asks for least squares, and for its covariance.
        let free = |(id, variance): (&ParamId, &Option<Variance>)| is_bar(id) || variance.is_none();
        let is_list = unknowns.ids().len() == system.variances.len()
            && unknowns.ids().iter().zip(&system.variances).all(free);
        // What no unknown describes makes the visits that are left out worse than predicted, and so all other poses.
        let left_out = if is_list { None } else { Some(LeftOutVisits::of(whitened, &posterior)?) };
        let factor = left_out.map_or(1.0, |visits| visits.noise_factor);
        let all = if factor > 1.0 {
            whitened.equations.posterior(&cautious.with_sigma(factor * posterior.sigma_mm))?.root()?
        } else {
            posterior.root()?
        };
        let coefficients = model.geometry.joint_errors.count();
        let root = unknowns.rows_of_parameters(&all, coefficients);
        let backlash_places = unknowns.backlash_places(&model);
        let score = NoiseScore { rows: &system.rows, whitened, posterior: &posterior, backlash_places };
        let of_coefficient = |place: Option<usize>| place.map_or(0.0, |place| all.row(place).norm());
        let (scatter_rad, unapproached_rad) = match shape.joints {
            // If the scatter is larger than estimated, sigma is smaller.
            JointNoise::Approached { backlash, scatter } => {
                let left = |joint: usize| of_coefficient(backlash_places[joint]);
                (scatter, std::array::from_fn(|joint| backlash[joint].hypot(left(joint))))
            }
            // Several lengths show the scatter of a pose in other directions too: if backlash is larger, sigma is
            // smaller.
            JointNoise::Unapproached(sds) if system.rows.tell_noise_apart() => ([0.0; AXES], sds),
            JointNoise::Unapproached(_) => ([0.0; AXES], score.rms_rad()?),
        };
        // The coefficients of the events are the last unknowns.
        let mut place =
            posterior.mean.len() - unknowns.events().iter().map(SupposedEvent::columns).sum::<usize>();
        for judged in events.iter_mut().take(unknowns.events().len()) {
            let columns = judged.event.columns();
            judged.coefficients = posterior.mean.rows(place, columns).into_owned();
            let own = all.rows(place, columns);
            judged.sd = sd_along(&judged.coefficients, &(own * own.transpose()));
            place += columns;
        }
        let effective_parameters: f64 = determined.iter().sum();
        let sigma_mm = hypers.sigma_mm();
        let whole_mm = system.rms_sd(shape, sigma_mm) * sigma_mm;
        let mut root = root;
        // If a list of parameters is estimated without a prior, and the residuals agree with the stated standard
        // deviations of the lengths, these are the noise.
        let stated_mm = used.by(Sigma::Given).rms_sigma();
        let dof = whole.count() as f64 - effective_parameters;
        let ratio = (whole_mm / stated_mm).powi(2);
        let agrees = is_list
            && used.lengths().known
            && ChiSquareOutcome::of(ratio, dof.max(1.0)) != ChiSquareOutcome::Greater;
        if agrees {
            root *= stated_mm / whole_mm;
        }
        let is_given = used.lengths().is_sigma_given || agrees;
        let freedom = whole.count() as f64 - effective_parameters;
        Some(Estimate {
            before: start.before.clone(),
            at_start: start.at_start.clone(),
            analysis: start.analysis.clone(),
            kept: unknowns.ids().to_vec(),
            base: start.base.clone(),
            open: start.open.clone(),
            sigma: if is_given { Sigma::Given } else { Sigma::All(whole_mm) },
            freedom: (!is_given && freedom > MIN_FREEDOM).then_some(freedom),
            visit_freedom: left_out.map(|visits| visits.degrees_of_freedom),
            prior_sds: unknowns.prior_sds(&cautious),
            root,
            of_prior: of_prior(system, &all, &cautious),
            groups: Vec::new(),
            determined,
            noise: LengthNoise { pose_mm: sigma_mm, length_mm: shape.own.sd(), joints: None },
            hypers,
            cautious,
            shape,
            scatter_rad,
            unapproached_rad,
            z,
            bar_sds,
            event_mm: event_mm(&events, whole.lengths(), &model),
            events,
            left_out: None,
            wrong_balls: Vec::new(),
            fit: Fit { model, converged: step.is_at_rest(), ..start.fit.clone() },
            unknowns: unknowns.clone(),
        })
    }
}

/// The effect of the certain events on each length, mm; empty without such events.
fn event_mm(events: &[JudgedEvent], lengths: &Lengths, model: &LengthModel) -> Vec<f64> {
    let certain: Vec<&JudgedEvent> = events.iter().filter(|event| event.is_certain).collect();
    if certain.is_empty() {
        return Vec::new();
    }
    let rows = PoseRows::at(model, &lengths.plain(), &[], |place| lengths.time(place));
    let effects = certain.iter().map(|judged| judged.event.of_rows(&rows, lengths) * &judged.coefficients);
    let mut of_rows = vec![0.0; lengths.len()];
    for effect in effects {
        rows.lengths.iter().zip(&effect).for_each(|(length, mm)| of_rows[length.place] += mm);
    }
    of_rows
}

/// The rows of the root, divided by the standard deviations of their priors, transposed.
fn of_prior(system: &System, root: &DMatrix<f64>, hypers: &Hypers) -> DMatrix<f64> {
    let bound: Vec<usize> = (0..system.variances.len()).filter(|k| system.variances[*k].is_some()).collect();
    let mut rows = root.select_rows(&bound);
    for (mut row, k) in rows.row_iter_mut().zip(&bound) {
        row /= system.variances[*k].map_or(1.0, |variance| variance.sd(hypers));
    }
    rows.transpose()
}

/// The evidence for each group; each group counts beyond the groups before it.
fn groups(
    system: &System,
    whitened: &Whitened,
    hypers: &Hypers,
    determined: &[f64],
) -> Option<Vec<GroupEvidence>> {
    let group_of = |k: usize| system.variances[k].and_then(Variance::group);
    let unknowns = 0..system.variances.len();
    let is_present = |group: &Group| unknowns.clone().any(|k| group_of(k) == Some(*group));
    let mut present: Vec<Group> = Group::ALL.into_iter().filter(is_present).collect();
    present.sort_by_key(|group| !matches!(group, Group::Tolerance | Group::Tool));
    let mean_square = |groups: &[Group]| {
        let posterior = whitened.equations.with_groups(groups);
        Some(system.mean_square(&posterior.posterior(hypers)?.mean))
    };
    let mut before = mean_square(&[])?;
    let mut of_geometry = before;
    let mut groups = Vec::new();
    for (at, group) in present.iter().enumerate() {
        let left = mean_square(&present[..=at])?;
        let explained = (before - left).max(0.0);
        let members = unknowns.clone().filter(|&k| group_of(k) == Some(*group));
        let is_geometry = matches!(group, Group::Tolerance | Group::Tool);
        if is_geometry {
            of_geometry = left;
        }
        groups.push(GroupEvidence {
            group: *group,
            sd: sd_of(*group, hypers, whitened.shape),
            effective_parameters: members.map(|k| determined[k]).sum(),
            rms_mm: explained.sqrt(),
            share: (!is_geometry).then(|| explained / of_geometry),
        });
        before = left;
    }
    Some(groups)
}

/// One standard deviation of the members of a group.
fn sd_of(group: Group, hypers: &Hypers, shape: NoiseShape) -> f64 {
    match (group, shape.joints) {
        (Group::Smooth, _) => {
            let [quick, slow] = hypers.processes();
            quick.sd_rad.hypot(slow.sd_rad)
        }
        (Group::Backlash, JointNoise::Unapproached(sds)) => {
            let moved = sds.iter().filter(|sd| **sd > 0.0).count().max(1) as f64;
            (sds.iter().map(|sd| sd * sd).sum::<f64>() / moved).sqrt()
        }
        _ => hypers.sd(group),
    }
}

impl Estimate {
    /// Number of unknowns that the data determine.
    pub(super) fn effective_parameters(&self) -> f64 {
        self.determined.iter().sum()
    }

    /// The prior standard deviation of a parameter; `None` if it is free or not estimated.
    pub(super) fn prior_sd(&self, id: ParamId) -> Option<f64> {
        self.prior_sds[self.kept.iter().position(|kept| *kept == id)?]
    }

    /// The shift of the rows with which the lengths fit decisively better.
    pub(super) fn shifted_rows(&self, lengths: &Lengths) -> Option<EstimationFinding> {
        let search = ShiftedRowSearch { start: &self.at_start, base: &self.base, sigma: self.sigma };
        search.shift_of(lengths)
    }

    /// Whether backlash is noise, because no sense of approach is known.
    pub(super) fn lacks_approach(&self) -> bool {
        !self.shape.joints.is_approached()
    }

    /// The factor on the maker's tolerance by the evidence.
    pub(super) fn tolerance_scale(&self) -> f64 {
        self.hypers.sd(Group::Tolerance)
    }

    /// The ratio of the corrections of the geometry to their prior standard deviations (RMS), if it is significantly above 1.
    pub(super) fn beyond_prior(&self, setting: &Setting<'_>) -> Option<f64> {
        let deviate = |id: &ParamId| {
            let sd = setting.priors.bound(*id)?;
            Some((self.fit.model.value(*id) - setting.start.value(*id)) / sd)
        };
        let deviates = self.kept.iter().filter(|id| id.is_geometric()).filter_map(deviate);
        let squares: Vec<f64> = deviates.map(|deviate| deviate * deviate).collect();
        let count = squares.len() as f64;
        let ratio = squares.iter().sum::<f64>() / count;
        (count > 0.0 && ChiSquareOutcome::of(ratio, count) == ChiSquareOutcome::Greater).then(|| ratio.sqrt())
    }

    /// The lengths with the weights of the fit, without outliers.
    pub(crate) fn used<'a>(&'a self, lengths: &'a Lengths) -> Weighted<'a> {
        lengths.weighted(self.sigma, &self.fit.outliers)
    }

    /// The lengths as they would be without the certain events, each with its own ball. The table keeps the measured
    /// values.
    pub(super) fn corrected<'a>(&self, lengths: &Lengths<'a>) -> Lengths<'a> {
        let relabelled = lengths.relabelled(&self.wrong_balls);
        if self.event_mm.is_empty() {
            return relabelled;
        }
        let corrected = self.event_mm.iter().enumerate().map(|(at, mm)| lengths.reading(at).length_mm - mm);
        relabelled.with_lengths(corrected.collect())
    }

    /// The uncertainty of the robot, its tool ball and the base balls.
    pub(super) fn uncertainty(&self, robot: &Robot) -> RobotUncertainty {
        let is_own = |id: ParamId| id.moves_tool_ball() || matches!(id, ParamId::Ball(..));
        let own: Vec<usize> = (0..self.kept.len()).filter(|&k| is_own(self.kept[k])).collect();
        let rows: Vec<usize> = own.iter().copied().chain(self.kept.len()..self.root.nrows()).collect();
        let has_errors = !self.fit.model.geometry.joint_errors.is_none();
        // An error that similar poses have in common is an error of any other pose too.
        let cluster_mm = if has_errors { self.cautious.sd(Group::Cluster) } else { 0.0 };
        let pose_mm = match &self.left_out {
            Some(left_out) => left_out.uncertainty.pose_mm.hypot(left_out.rms_mm),
            None => self.noise.pose_mm.hypot(cluster_mm),
        };
        // The smooth functions of an earlier identification keep its processes.
        let (smooth, smooth_of_joints) = if self.unknowns.has_coefficients() {
            let RobotUncertainty { smooth, smooth_of_joints, .. } = robot.known_uncertainty();
            (smooth, smooth_of_joints)
        } else if has_errors {
            (self.cautious.processes().to_vec(), self.cautious.of_joints())
        } else {
            (Vec::new(), [1.0; AXES])
        };
        RobotUncertainty {
            parameters: own.iter().map(|&k| self.kept[k]).collect(),
            root: self.root.select_rows(&rows),
            pose_mm,
            shared_mm: None,
            unexplained_mm: self.left_out.as_ref().map_or(0.0, |left_out| left_out.rms_mm),
            degrees_of_freedom: self.freedom,
            visit_degrees_of_freedom: self.visit_freedom,
            smooth,
            smooth_of_joints,
            scatter_rad: self.scatter_rad,
            unapproached_rad: self.unapproached_rad,
        }
    }

    /// The estimate with the geometry alone that is nearest to it at the measured poses, without errors that are not
    /// geometric. The part that is left out is an error of every pose.
    fn geometry_alone(mut self, setting: &Setting<'_>, lengths: &Lengths) -> Self {
        let whole = self.fit.model.geometry.clone();
        if whole.is_rigid() {
            return self;
        }
        let measured = (0..lengths.len()).step_by(lengths.len().div_ceil(PROJECTED).max(1));
        let poses: Vec<([f64; AXES], Approach)> =
            measured.map(|at| lengths.reading(at)).map(|reading| (reading.axes, reading.approach)).collect();
        let moves = |id: &ParamId| id.is_geometric() || matches!(id, ParamId::Tool(_));
        let moving: Vec<usize> = (0..self.kept.len()).filter(|at| moves(&self.kept[*at])).collect();
        let ids: Vec<ParamId> = moving.iter().map(|at| self.kept[*at]).collect();
        let rigid = whole.rigid();
        let alone = BallMotion::new(&rigid, &poses, &ids);
        let mut jacobian = alone.jacobian.columns(0, ids.len()).into_owned();
        take_out_rigid_motion(&mut jacobian, &alone.balls);
        let (optional, geometric): (Vec<usize>, Vec<usize>) =
            (0..self.kept.len()).partition(|at| self.kept[*at].is_optional());
        let rows: Vec<usize> = optional.iter().copied().chain(self.kept.len()..self.root.nrows()).collect();
        let optional: Vec<ParamId> = optional.iter().map(|at| self.kept[*at]).collect();
        let full = BallMotion::new(&whole, &poses, &optional);
        let mut unknown = full.jacobian * self.root.select_rows(&rows);
        take_out_rigid_motion(&mut unknown, &full.balls);
        let mut left_out =
            GeometryRemainder { whole, uncertainty: self.uncertainty(setting.robot), rms_mm: 0.0 };
        let off = left_out.displacements(&rigid, &poses);
        let mean_square = off.norm_squared() / off.len() as f64;
        let mut normal = jacobian.tr_mul(&jacobian);
        for (at, id) in ids.iter().enumerate() {
            normal[(at, at)] += setting.priors.bound(*id).map_or(0.0, |sd| mean_square / (sd * sd));
        }
        let Some(factor) = Cholesky::new(normal) else { return self };
        // The geometry takes over the same part of the errors and of their uncertainty, which is correlated with its own.
        let step = factor.solve(&jacobian.tr_mul(&off));
        let of_unknown = factor.solve(&jacobian.tr_mul(&unknown));
        let left = off - &jacobian * &step;
        let left_unknown = unknown - jacobian * &of_unknown;
        left_out.rms_mm = ((left.norm_squared() + left_unknown.norm_squared()) / left.len() as f64).sqrt();
        for (own, row) in moving.iter().zip(of_unknown.row_iter()) {
            let sum = self.root.row(*own) + row;
            self.root.set_row(*own, &sum);
        }
        self.left_out = Some(left_out);
        self.fit.model.geometry = rigid;
        ids.iter().zip(&step).for_each(|(id, step)| self.fit.model.shift(*id, *step));
        self.root = self.root.select_rows(&geometric);
        self.prior_sds = geometric.iter().map(|at| self.prior_sds[*at]).collect();
        self.kept.retain(|id| !id.is_optional());
        let places: Vec<ParamId> =
            self.kept.iter().copied().filter(|id| is_place(id) && !matches!(id, ParamId::Tool(_))).collect();
        let set_up = super::fit::set_up(&self.corrected(lengths), &places, &self.fit.model);
        self.fit.model = set_up.model;
        // Known backlash is part of the errors that are left out at the measured poses.
        if !self.lacks_approach() {
            self.unapproached_rad = [0.0; AXES];
            self.scatter_rad = [0.0; AXES];
        }
        self
    }

    /// `None` if errors of the joints were not sought.
    pub(super) fn joint_summary(&self) -> Option<JointSummary> {
        let joints = self.shape.joints;
        (!self.fit.model.geometry.joint_errors.is_none()).then(|| JointSummary {
            smooth: self.hypers.processes(),
            backlash_noise_rad: (!joints.is_approached()).then(|| joints.sought()),
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::super::unknowns::KnownBefore;
    use super::*;
    use crate::measurement::{BaseBall, PreparedMeasurement};
    use crate::robot::{BarId, Coordinate};
    use crate::test_support::cell::{CENTRE, Circle, kr60, poses, three_planes};

    const SIGMA_MM: f64 = 0.01;
    const COUNT: usize = 24;
    const BAR: ParamId = ParamId::BarOffset(BarId::FIRST);
    const HEIGHT: ParamId = ParamId::Ball(BallId::FIRST, Coordinate::Z);

    fn start() -> LengthModel {
        LengthModel::new(kr60().geometry, &[BaseBall { id: BallId::FIRST, position: CENTRE.into() }])
    }

    /// Lengths of a base ball that is `up_mm` higher with a bar that is `longer_mm` longer, on a circle that is tilted by 0.02 rad.
    fn lengths(up_mm: f64, longer_mm: f64) -> Lengths<'static> {
        let [flat, ..] = three_planes(1, CENTRE);
        let plane = Rotation3::from_axis_angle(&Vector3::x_axis(), 0.02).into();
        let truth = start().shifted(&[HEIGHT, BAR], &DVector::from_row_slice(&[up_mm, longer_mm]));
        let prepared = truth.prepare();
        let reading = |axes_deg: [f64; AXES]| {
            let mut reading = PreparedMeasurement::new(axes_deg.map(f64::to_radians), BallId::FIRST, 0.0);
            reading.length_mm = prepared.length(&reading);
            reading
        };
        let axes = poses(&kr60().geometry, &Circle { plane, ..flat }, COUNT, 25.0);
        Lengths::few(axes.into_iter().map(reading).collect(), vec![SIGMA_MM; COUNT])
    }

    /// The root mean square of the joints that moved: 3 and 4 of the unit have (25 / 2)^1/2.
    #[test]
    fn backlash_of_joints_that_rest_does_not_count() {
        let of = |sds: [f64; AXES]| {
            let shape = NoiseShape { own: OwnNoise::Stated(SIGMA_MM), joints: JointNoise::Unapproached(sds) };
            sd_of(Group::Backlash, &Hypers::usual(), shape)
        };
        assert!((of([3e-5, 0.0, 4e-5, 0.0, 0.0, 0.0]) - 12.5f64.sqrt() * 1e-5).abs() < 1e-18);
        assert_eq!(of([0.0; AXES]), 0.0);
    }

    /// The bar has this prior standard deviation; the height of the ball, if it is unknown, is free.
    fn unknowns(ids: &[ParamId], used: &Weighted, bar_sd_mm: f64) -> Unknowns {
        let (ids, means) = (ids.to_vec(), vec![0.0; ids.len()]);
        let variances = ids.iter().map(|id| (*id == BAR).then_some(Variance::Fixed(bar_sd_mm))).collect();
        let before = KnownBefore { ids, means, variances, ..KnownBefore::default() };
        Unknowns::new(before, &start(), used, false)
    }

    /// Lengths are linear in the bar: n lengths with the residual d and the variance v, and a prior variance of v / n, move it by
    /// d / 2, by d / 2 (2 n / v)^1/2 standard deviations of the posterior.
    #[test]
    fn a_linear_step_has_the_length_of_its_equations() {
        const LONGER_MM: f64 = 0.02;
        let lengths = lengths(0.0, LONGER_MM);
        let used = lengths.weighted(Sigma::Given, &[]);
        let of_prior = |sd_mm| unknowns(&[BAR], &used, sd_mm);
        let wide = of_prior(1.0);
        let state = Search::new(&wide, &used, start(), None).state;
        let variance = state.hypers.sigma_mm().powi(2) + state.shape.own.sd().powi(2);
        let count = COUNT as f64;
        let narrow = of_prior((variance / count).sqrt());
        let mut search = Search::new(&narrow, &used, start(), None);
        let step = search.stepped(search.linearised()).unwrap();
        let moved_mm = search.state.model.value(BAR);
        assert!((moved_mm.abs() - 0.5 * LONGER_MM).abs() < 1e-9, "{moved_mm}");
        let expected = 0.5 * LONGER_MM * (2.0 * count / variance).sqrt();
        assert!((step.step_sds / expected - 1.0).abs() < 1e-6, "{} {expected}", step.step_sds);
    }

    /// A circle that is tilted by 0.02 rad hardly shows the height of its ball. A ball that is 20 mm higher makes the lengths
    /// longer by 20^2 / 600 mm, which a bar of hardly known length takes back: only their slope is left. A straight step of 20 mm
    /// misses them by 0.67 mm, 67 standard deviations; a step along the curve does not.
    #[test]
    fn a_step_follows_a_curved_valley() {
        const UP_MM: f64 = 20.0;
        let lengths = lengths(UP_MM, -UP_MM * UP_MM / 600.0);
        let used = lengths.weighted(Sigma::Given, &[]);
        let mut ids = [BAR, HEIGHT];
        ids.sort();
        let unknowns = unknowns(&ids, &used, 2.0);
        let mut search = Search::new(&unknowns, &used, start(), None);
        let step = search.stepped(search.linearised()).unwrap();
        let up_mm = search.state.model.value(HEIGHT) - CENTRE[2];
        assert!((up_mm - UP_MM).abs() < 1.0 && !step.is_at_rest(), "{up_mm}");
        let step = search.settled(step, ROUNDS).unwrap();
        let up_mm = search.state.model.value(HEIGHT) - CENTRE[2];
        assert!((up_mm - UP_MM).abs() < 0.1 && step.is_at_rest(), "{up_mm} {}", step.step_sds);
    }
}
