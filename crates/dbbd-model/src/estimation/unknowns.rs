//! The unknowns of an estimate: parameters of the model, coefficients of the joints' errors, and errors that the model lacks;
//! what is known of each before the lengths; and the design rows by them.
//!
//! With x the parameters and coefficients, x = mean + T z: the unknowns z of what is known before are independent. T is the
//! root of the posterior of an earlier identification, or the directions in which data alone are judged; else it is the
//! identity. A free parameter has no prior, and its unknown is the step from where the model is.

use nalgebra::{DMatrix, DVector};

use super::hyper_parameters::{Group, Hypers, Variance};
use super::hypotheses::RunEvent;
use super::lengths::{Sigma, Weighted};
use super::noise_shape::BacklashNoise;
use super::pose_rows::PoseRows;
use super::system::System;
use crate::math::stacked;
use crate::measurement::LengthModel;
use crate::robot::{
    AXES, JointErrorModel, JointErrors, JointTerm, ParamId, SmoothJointError, TermKind, VisitedAngles,
};

/// An axis that turns by less has no function of its angle, rad.
const LEAST_RANGE: f64 = 0.05;
/// Basis functions for each length scale in half the interval (Riutort-Mayol et al., Statistics and Computing 33, 2022),
/// and their limits.
const FUNCTIONS: f64 = 2.65;
const FEWEST: usize = 10;
const MOST: usize = 48;
/// Clusters of poses that share a displacement of the tool ball, and poses for each at least.
const CLUSTERS: usize = 24;
const POSES_PER_CLUSTER: usize = 4;
/// Cosines of the time by which zeros and links may warm up.
const WARMING: usize = 3;

/// What the prior says of the parameters and coefficients.
#[derive(Clone, Debug)]
pub(super) struct KnownBefore {
    /// In canonical order.
    pub(super) ids: Vec<ParamId>,
    /// Of each parameter; 0 for a free one.
    pub(super) means: Vec<f64>,
    /// Of each column of T, or of each parameter without T; `None` of what is free.
    pub(super) variances: Vec<Option<Variance>>,
    /// A row for each parameter, then, if there are coefficients in it, for each coefficient of the errors.
    pub(super) transform: Option<DMatrix<f64>>,
    /// Whether the coefficients of the joints' errors are in the transform, so that their functions stay as they are.
    pub(super) has_coefficients: bool,
    /// Whether bars have the prior of one without a certificate.
    pub(super) are_bars_uncertified: bool,
}

/// The unknowns beside parameters and coefficients.
#[derive(Clone, Debug)]
struct ModelErrors {
    /// The middle of each cluster of poses.
    centres: Vec<Features>,
    warms: bool,
    /// What happened for certain.
    events: Vec<RunEvent>,
}

/// Sines and cosines of the joints, by how far they move the tool ball.
type Features = [f64; 2 * AXES];

#[derive(Clone, Debug)]
pub(super) struct Unknowns {
    pub(super) before: KnownBefore,
    /// The angles of each joint: lowest and highest, rad; equal where there are no errors of the joints.
    ranges: [[f64; 2]; AXES],
    visited: [VisitedAngles; AXES],
    /// Whether the sense of approach is known of any length.
    approached: bool,
    errors: ModelErrors,
}

impl Unknowns {
    /// `with_errors`: also what the geometry does not explain.
    pub(super) fn new(before: KnownBefore, start: &LengthModel, used: &Weighted, with_errors: bool) -> Self {
        let (mut angles, mut approached): ([Vec<f64>; AXES], bool) = Default::default();
        let (mut poses, mut warms) = (Vec::new(), with_errors);
        for (at, _) in used.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY) {
            let reading = used.lengths().reading(at);
            approached |= !reading.approach.is_unknown();
            warms &= used.lengths().elapsed(at).is_some();
            let joints = start.geometry.coupling.joints(&reading.axes);
            poses.push(joints);
            angles.iter_mut().zip(joints).for_each(|(own, angle)| own.push(angle));
        }
        let range = |at: usize| if with_errors { range(&angles[at]) } else { [0.0; 2] };
        let ranges = std::array::from_fn(range);
        let errors = ModelErrors {
            centres: if with_errors { centres(&poses) } else { Vec::new() },
            warms,
            events: Vec::new(),
        };
        Self { before, ranges, visited: angles.map(VisitedAngles::of), approached, errors }
    }

    /// With an event as further unknowns.
    pub(super) fn with_event(mut self, event: RunEvent) -> Self {
        self.errors.events.push(event);
        self
    }

    pub(super) fn events(&self) -> &[RunEvent] {
        &self.errors.events
    }

    pub(super) fn ids(&self) -> &[ParamId] {
        &self.before.ids
    }

    /// Whether the coefficients of the joints' errors are known before.
    pub(super) fn has_coefficients(&self) -> bool {
        self.before.has_coefficients
    }

    /// Whether a joint (from 0) turned far enough for a function of its angle.
    pub(super) fn moved(&self, joint: usize) -> bool {
        let [low, high] = self.ranges[joint];
        high - low >= LEAST_RANGE
    }

    /// How many columns belong to the parameters.
    fn own(&self) -> usize {
        self.before.variances.len()
    }

    /// Where the coefficients of backlash in a model are among all unknowns; nowhere if they are mixed with others.
    pub(super) fn backlash_places(&self, model: &LengthModel) -> [Option<usize>; AXES] {
        if self.before.has_coefficients {
            return [None; AXES];
        }
        model.geometry.joint_errors.backlash_places().map(|place| Some(self.own() + place?))
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
        if self.before.has_coefficients {
            return before.clone();
        }
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

    /// Design rows at a model; `z` are the unknowns that the model has.
    pub(super) fn linearised(
        &self,
        model: &LengthModel,
        z: &DVector<f64>,
        used: &Weighted,
        backlash: BacklashNoise,
        bar_sds: &[f64],
    ) -> System {
        let KnownBefore { ids, transform, variances, has_coefficients, .. } = &self.before;
        let mean_sd = used.by(Sigma::Given).rms_sigma();
        let mut rows =
            PoseRows::at(model, &used.by(Sigma::All(1.0)), ids, |place| used.lengths().time(place));
        if let Some(transform) = transform {
            let mixed = &rows.values.columns(0, transform.nrows()) * transform;
            let rest = rows.values.columns_range(transform.nrows()..).into_owned();
            rows.values = beside(mixed, &rest);
        }
        let errors = &model.geometry.joint_errors;
        let of_term = |term: JointTerm| match term.kind {
            TermKind::Smooth { frequency } => Variance::Spectral(term.joint, frequency),
            TermKind::Backlash if backlash.is_known() => Variance::Of(Group::Backlash, 1.0),
            TermKind::Backlash => Variance::ByNoise(backlash.sds()[term.joint.index()]),
            TermKind::Ripple { .. } => Variance::Of(Group::Ripple, 1.0),
        };
        let terms = if *has_coefficients { Vec::new() } else { errors.terms() };
        let of_terms = terms.into_iter().map(|term| Some(of_term(term)));
        let mut variances: Vec<Option<Variance>> = variances.iter().copied().chain(of_terms).collect();
        self.bar_columns()
            .zip(bar_sds)
            .for_each(|(column, sd)| variances[column] = Some(Variance::Fixed(*sd)));
        let right = &rows.residual + &rows.values * z.rows(0, variances.len());
        let (further, of_further) = self.errors.columns(&rows, used);
        rows.values = beside(std::mem::replace(&mut rows.values, DMatrix::zeros(0, 0)), &further);
        variances.extend(of_further.into_iter().map(Some));
        System {
            right,
            weights: rows.places.iter().map(|place| used.lengths().given(*place) / mean_sd).collect(),
            rows,
            variances,
            sigma_is_given: used.lengths().vouched,
            sigma_mm: used.lengths().repeatability_mm.unwrap_or(USUAL_SIGMA_MM),
        }
    }

    /// The unknowns that a model has; `known` are those to which it was brought.
    pub(super) fn at(&self, model: &LengthModel, known: &DVector<f64>) -> DVector<f64> {
        let KnownBefore { ids, means, variances, transform, has_coefficients, .. } = &self.before;
        if *has_coefficients {
            return if known.is_empty() { DVector::zeros(self.own()) } else { self.rested(known.clone()) };
        }
        let own = (0..ids.len()).map(|k| model.value(ids[k]) - means[k]);
        let mut own = DVector::from_iterator(ids.len(), own);
        if let Some(solved) = transform.as_ref().and_then(|transform| transform.clone().lu().solve(&own)) {
            own = solved;
        }
        (0..ids.len()).filter(|k| variances[*k].is_none()).for_each(|k| own[k] = 0.0);
        let coefficients = model.geometry.joint_errors.coefficients();
        DVector::from_iterator(ids.len() + coefficients.len(), own.iter().copied().chain(coefficients))
    }

    /// The columns of bars without a certificate: those of parameters that the transform leaves as they are.
    pub(super) fn bar_columns(&self) -> impl Iterator<Item = usize> {
        let KnownBefore { ids, transform, are_bars_uncertified, .. } = &self.before;
        let is_bar = |at: &usize| *are_bars_uncertified && matches!(ids[*at], ParamId::BarOffset(_));
        let column = move |at: usize| match transform {
            Some(transform) => transform.row(at).transpose().iamax(),
            None => at,
        };
        (0..ids.len()).filter(is_bar).map(column)
    }

    /// Prior standard deviations of the parameters; `None` of what is free.
    pub(super) fn prior_sds(&self, hypers: &Hypers) -> Vec<Option<f64>> {
        let KnownBefore { ids, variances, transform, .. } = &self.before;
        let of = |k: usize| match transform {
            None => variances[k].map(|variance| variance.sd(hypers)),
            Some(transform) => {
                let row = transform.row(k);
                let parts = row.iter().zip(variances).filter(|(share, _)| **share != 0.0);
                let squares =
                    parts.map(|(share, variance)| Some(share * share * variance.as_ref()?.value(hypers)));
                squares.sum::<Option<f64>>().map(f64::sqrt)
            }
        };
        (0..ids.len()).map(of).collect()
    }

    /// Brings a model from the unknowns `now` to those `then`.
    pub(super) fn move_to(&self, now: &DVector<f64>, then: &DVector<f64>, model: &mut LengthModel) {
        let own =
            self.own() + if self.before.has_coefficients { 0 } else { model.geometry.joint_errors.count() };
        let mut steps = then.rows(0, own) - now.rows(0, own);
        if let Some(transform) = &self.before.transform {
            let mixed = transform * steps.rows(0, transform.ncols());
            let rest = steps.rows_range(transform.ncols()..).into_owned();
            steps = DVector::from_iterator(mixed.len() + rest.len(), mixed.iter().chain(&rest).copied());
        }
        self.before.ids.iter().zip(&steps).for_each(|(id, step)| model.shift(*id, *step));
        let errors = &mut model.geometry.joint_errors;
        let coefficients: Vec<f64> = errors
            .coefficients()
            .iter()
            .zip(steps.iter().skip(self.before.ids.len()))
            .map(|(own, step)| own + step)
            .collect();
        *errors = errors.with(coefficients);
    }

    /// The unknowns where the model is: a free one is a step, which was made.
    pub(super) fn rested(&self, mut z: DVector<f64>) -> DVector<f64> {
        for (k, _) in self.before.variances.iter().enumerate().filter(|(_, variance)| variance.is_none()) {
            z[k] = 0.0;
        }
        z
    }

    /// Rows of parameters and coefficients from rows of unknowns.
    pub(super) fn rows_of_parameters(&self, rows: &DMatrix<f64>, coefficients: usize) -> DMatrix<f64> {
        match &self.before.transform {
            Some(transform) => {
                let mixed = transform * rows.rows(0, transform.ncols());
                let more = self.before.ids.len() + coefficients - transform.nrows();
                stacked(&mixed, &rows.rows(transform.ncols(), more).into_owned())
            }
            None => rows.rows(0, self.before.ids.len() + coefficients).into_owned(),
        }
    }
}

/// Standard deviation of a robot's repeatability along a length where it is not stated, mm.
const USUAL_SIGMA_MM: f64 = 0.03;

impl ModelErrors {
    /// Columns with the prior of each, a row each row.
    fn columns(&self, rows: &PoseRows, used: &Weighted) -> (DMatrix<f64>, Vec<Variance>) {
        let places = 3 * self.centres.len();
        let warming = if self.warms { (AXES + 1) * WARMING } else { 0 };
        let mut columns = DMatrix::zeros(rows.places.len(), places + warming);
        for (row, joints) in rows.joints.iter().enumerate() {
            let here = features(joints);
            let distances = self.centres.iter().map(|centre| square(centre, &here)).enumerate();
            if let Some((cluster, _)) = distances.min_by(|a, b| a.1.total_cmp(&b.1)) {
                for axis in 0..3 {
                    columns[(row, 3 * cluster + axis)] = rows.units[row][axis];
                }
            }
        }
        for row in 0..if self.warms { rows.places.len() } else { 0 } {
            let elapsed = used.lengths().elapsed(rows.places[row]).unwrap_or(0.0);
            for order in 1..=WARMING {
                let wave = (std::f64::consts::PI * order as f64 * elapsed).cos() / order as f64;
                let first = places + (order - 1) * (AXES + 1);
                for joint in 0..AXES {
                    columns[(row, first + joint)] = wave * rows.levers[row][joint];
                }
                columns[(row, first + AXES)] = wave * rows.growths[row];
            }
        }
        let mut variances = vec![Variance::Of(Group::Cluster, 1.0); places];
        variances.extend(vec![Variance::Of(Group::Warming, 1.0); warming]);
        for event in &self.events {
            columns = beside(columns, &event.of_rows(rows, used.lengths()));
            variances.extend(vec![Variance::Fixed(event.size_mm); event.columns()]);
        }
        (columns, variances)
    }
}

fn features(joints: &[f64; AXES]) -> Features {
    /// The first joints move the tool ball most.
    const REACH: [f64; AXES] = [1.0, 1.0, 0.8, 0.3, 0.3, 0.1];
    std::array::from_fn(|at| {
        let (sin, cos) = joints[at / 2].sin_cos();
        REACH[at / 2] * if at % 2 == 0 { sin } else { cos }
    })
}

fn square(one: &Features, other: &Features) -> f64 {
    one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum()
}

/// Poses (joint angles, rad) that are far from each other, the farthest from the middle first: each is the middle of a cluster.
fn centres(poses: &[[f64; AXES]]) -> Vec<Features> {
    let mut distinct: Vec<[u64; AXES]> = poses.iter().map(|pose| pose.map(f64::to_bits)).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let all: Vec<Features> = distinct.iter().map(|pose| features(&pose.map(f64::from_bits))).collect();
    let count = CLUSTERS.min(all.len() / POSES_PER_CLUSTER);
    if count < 2 {
        return Vec::new();
    }
    let sum = all.iter().fold([0.0; 2 * AXES], |sum, one| std::array::from_fn(|k| sum[k] + one[k]));
    let middle = sum.map(|sum| sum / all.len() as f64);
    let mut distances: Vec<f64> = all.iter().map(|one| square(one, &middle)).collect();
    let mut centres: Vec<Features> = Vec::new();
    while centres.len() < count {
        let Some(far) = (0..all.len()).max_by(|a, b| distances[*a].total_cmp(&distances[*b])) else { break };
        let centre = all[far];
        let is_first = centres.is_empty();
        for (one, distance) in all.iter().zip(&mut distances) {
            let here = square(one, &centre);
            *distance = if is_first { here } else { distance.min(here) };
        }
        centres.push(centre);
    }
    centres
}

fn beside(left: DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let own = left.ncols();
    let mut both = left.resize_horizontally(own + right.ncols(), 0.0);
    both.columns_mut(own, right.ncols()).copy_from(right);
    both
}

/// Lowest and highest, rad.
fn range(angles: &[f64]) -> [f64; 2] {
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    angles.iter().fold(start, |[low, high], angle| [low.min(*angle), high.max(*angle)])
}
