//! The unknowns of a fit with errors of the joints: parameters, then coefficients of the errors, what is known of each
//! before the lengths, and the design rows by them.

use nalgebra::DVector;

use super::estimate::Estimate;
use super::evidence::{Hypers, Variance};
use super::joint_system::System;
use super::lengths::{Sigma, Weighted};
use super::noise_shape::BacklashNoise;
use super::options::Setting;
use super::pose_rows::PoseRows;
use super::priors::{Group, largest_plausible};
use crate::measurement::LengthModel;
use crate::robot::{
    AXES, JointErrorModel, JointErrors, JointTerm, ParamGroup, ParamId, SmoothJointError, TermKind,
    VisitedAngles, parameter,
};

/// An axis that turns by less has no function of its angle, rad.
const LEAST_RANGE: f64 = 0.05;
/// Basis functions for each length scale in half the interval (Riutort-Mayol et al., Statistics and Computing 33, 2022),
/// and their limits.
const FUNCTIONS: f64 = 2.65;
const FEWEST: usize = 10;
const MOST: usize = 48;

/// What is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Terms {
    /// The parameters that the estimate has.
    Geometry,
    /// First harmonic, compliance, and the errors of the joints beside them.
    JointErrors,
}

pub(super) struct JointUnknowns {
    /// In canonical order.
    pub(super) ids: Vec<ParamId>,
    /// Of each parameter; `None` of what is free.
    pub(super) variances: Vec<Option<Variance>>,
    /// Means of the parameters before the lengths.
    pub(super) means: Vec<f64>,
    /// The angles of each joint: lowest and highest, rad; equal where there are no errors of the joints.
    ranges: [[f64; 2]; AXES],
    visited: [VisitedAngles; AXES],
    /// Whether the sense of approach is known of any length.
    approached: bool,
}

impl JointUnknowns {
    /// Beside an estimate; `None` where no prior binds its geometry.
    pub(super) fn new(
        setting: &Setting<'_>,
        estimate: &Estimate,
        used: &Weighted,
        terms: Terms,
    ) -> Option<Self> {
        let prior = estimate.prior.as_ref()?;
        let massless = setting.robot.geometry.masses.is_empty();
        let is_fixed = |id: &ParamId| setting.options.hold.contains(id) || estimate.kept.contains(id);
        let is_void = |id: &ParamId| massless && matches!(id, ParamId::Compliance(_));
        let optional = parameter::optional().filter(|id| !is_fixed(id) && !is_void(id));
        let optional = optional.filter(|_| terms == Terms::JointErrors);
        let mut ids: Vec<ParamId> = estimate.kept.iter().copied().chain(optional).collect();
        ids.sort();
        let own = |id: &ParamId| estimate.kept.iter().position(|kept| kept == id);
        // An implausible correction that the geometry finds, as of a lost zero, is no draw from the prior: the prior takes its
        // size, so that it costs errors of the joints and geometry the same.
        let widened = |id: &ParamId, sd: f64| {
            let correction = (estimate.fit.model.value(*id) - setting.start.value(*id)).abs();
            if correction > largest_plausible(true) * sd { correction } else { sd }
        };
        let variance = |id: &ParamId| match own(id) {
            Some(at) => prior.sd(at).map(|sd| Variance::Fixed(widened(id, sd))),
            None if id.group() == ParamGroup::Compliance => {
                Some(Variance::Of(Group::Compliance, setting.priors.sd(*id)))
            }
            None => Some(Variance::Of(Group::Harmonic, 1.0)),
        };
        let (mut angles, mut approached): ([Vec<f64>; AXES], bool) = Default::default();
        for (at, _) in used.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY) {
            let reading = used.lengths().reading(at);
            approached |= !reading.approach.is_unknown();
            let joints = setting.start.geometry.coupling.joints(&reading.axes);
            angles.iter_mut().zip(joints).for_each(|(own, angle)| own.push(angle));
        }
        let range = |at: usize| match terms {
            Terms::Geometry => [0.0; 2],
            Terms::JointErrors => range(&angles[at]),
        };
        Some(Self {
            variances: ids.iter().map(variance).collect(),
            means: ids.iter().map(|id| setting.start.value(*id)).collect(),
            ranges: std::array::from_fn(range),
            visited: angles.map(VisitedAngles::of),
            approached,
            ids,
        })
    }

    /// Whether a joint (from 0) turned far enough for a function of its angle.
    pub(super) fn moved(&self, joint: usize) -> bool {
        let [low, high] = self.ranges[joint];
        high - low >= LEAST_RANGE
    }

    /// Where the coefficients of backlash in a model are among all unknowns.
    pub(super) fn backlash_places(&self, model: &LengthModel) -> [Option<usize>; AXES] {
        let places = model.geometry.joint_errors.backlash_places();
        places.map(|place| Some(self.ids.len() + place?))
    }

    /// Where the search for backlash as noise begins.
    pub(super) fn backlash_noise(&self) -> BacklashNoise {
        let moved: [bool; AXES] = std::array::from_fn(|joint| self.moved(joint));
        if self.approached || moved == [false; AXES] {
            return BacklashNoise::Known([0.0; AXES]);
        }
        BacklashNoise::sought(moved)
    }

    /// The functions that the length scale needs, with the coefficients that `before` has of them.
    pub(super) fn errors(&self, before: &JointErrors, hypers: &Hypers) -> JointErrors {
        let [quick, _] = hypers.processes();
        let joint = |at: usize| {
            if !self.moved(at) {
                return JointErrorModel::default();
            }
            let [low, high] = self.ranges[at];
            let half_width = SmoothJointError::half_width_for([low, high]);
            let before = before.at(at).cloned().unwrap_or_default();
            let count = ((FUNCTIONS * half_width / quick.length_scale_rad) as usize).clamp(FEWEST, MOST);
            let mut smooth = SmoothJointError::new(0.5 * (low + high), half_width, count);
            if smooth.is_alike(&before.smooth) {
                let known = smooth.coefficients.iter_mut().zip(before.smooth.coefficients);
                known.for_each(|(own, value)| *own = value);
            }
            JointErrorModel { smooth, visited: self.visited[at], ..before }
        };
        JointErrors::new(std::array::from_fn(joint))
    }

    /// Design rows at a model.
    pub(super) fn linearised(&self, model: &LengthModel, used: &Weighted, backlash: BacklashNoise) -> System {
        let mean_sd = used.by(Sigma::Given).rms_sigma();
        let rows = PoseRows::at(model, &used.by(Sigma::All(1.0)), &self.ids);
        let errors = &model.geometry.joint_errors;
        let of_term = |term: JointTerm| match term.kind {
            TermKind::Smooth { frequency } => Variance::Spectral(frequency),
            TermKind::Backlash if backlash.is_known() => Variance::Of(Group::Backlash, 1.0),
            TermKind::Backlash => Variance::ByNoise(backlash.sds()[term.joint.index()]),
            TermKind::Ripple { .. } => Variance::Of(Group::Ripple, 1.0),
        };
        let of_terms = errors.terms().into_iter().map(|term| Some(of_term(term)));
        System {
            right: &rows.residual + &rows.values * self.corrections(model),
            weights: rows.places.iter().map(|place| used.lengths().given(*place) / mean_sd).collect(),
            rows,
            variances: self.variances.iter().copied().chain(of_terms).collect(),
            sigma_is_given: used.lengths().vouched,
        }
    }

    /// What a model has of the unknowns: zero of what is free.
    fn corrections(&self, model: &LengthModel) -> DVector<f64> {
        let own = (0..self.ids.len()).map(|k| match self.variances[k] {
            None => 0.0,
            Some(_) => model.value(self.ids[k]) - self.means[k],
        });
        let all: Vec<f64> = own.chain(model.geometry.joint_errors.coefficients()).collect();
        DVector::from_vec(all)
    }

    /// Brings a model to these unknowns.
    pub(super) fn move_to(&self, unknowns: &DVector<f64>, model: &mut LengthModel) {
        for (k, id) in self.ids.iter().enumerate() {
            // Of what is free the unknown is the step itself.
            let step = match self.variances[k] {
                None => unknowns[k],
                Some(_) => self.means[k] + unknowns[k] - model.value(*id),
            };
            model.shift(*id, step);
        }
        let errors = &mut model.geometry.joint_errors;
        *errors = errors.with(unknowns.iter().skip(self.ids.len()).copied());
    }
}

/// Lowest and highest, rad.
fn range(angles: &[f64]) -> [f64; 2] {
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    angles.iter().fold(start, |[low, high], angle| [low.min(*angle), high.max(*angle)])
}
