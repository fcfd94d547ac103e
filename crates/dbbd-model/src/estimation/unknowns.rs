//! The unknowns of an estimate (parameters of the model, coefficients of the joints' errors, and errors that the model
//! lacks), their priors, and the design rows by them.
//!
//! The parameters and coefficients are x = mean + T z, with a prior of independent unknowns z. T is the root of the
//! covariance of an earlier identification, or holds the directions in which the data alone judge the geometry; else it
//! is the identity. A free parameter has no prior, and its unknown is the step from its value in the model.

use nalgebra::{DMatrix, DVector};

use super::hyper_parameters::{Group, Hypers, Variance};
use super::hypotheses::SupposedEvent;
use super::lengths::{Sigma, Weighted};
use super::noise_shape::JointNoise;
use super::pose_rows::PoseRows;
use super::system::System;
use crate::math::{beside, stacked};
use crate::measurement::LengthModel;
use crate::robot::{
    AXES, JointErrorModel, JointErrors, JointTerm, ParamId, SmoothJointError, TermKind, VisitedAngles,
};

/// A joint that turns by less has no smooth function of its angle, rad.
const MIN_RANGE: f64 = 0.05;
/// Basis functions for each length scale in half the interval (Riutort-Mayol et al., Statistics and Computing 33, 2022),
/// and their limits.
const FUNCTIONS: f64 = 2.65;
const MIN_FUNCTIONS: usize = 10;
const MAX_FUNCTIONS: usize = 96;
/// Largest number of clusters of poses, and least number of poses in each. The poses of a cluster share a displacement
/// of the tool ball.
const CLUSTERS: usize = 24;
const POSES_PER_CLUSTER: usize = 4;
/// Number of cosines of time by which zeros and links may change as the robot warms up.
const WARMING: usize = 3;

/// The prior of the parameters and coefficients.
#[derive(Clone, Debug, Default)]
pub(super) struct KnownBefore {
    /// The parameters, in canonical order.
    pub(super) ids: Vec<ParamId>,
    /// Prior mean of each parameter; 0 for a free one.
    pub(super) means: Vec<f64>,
    /// Prior variance of each column of T, or of each parameter if there is no T; `None` for a free one.
    pub(super) variances: Vec<Option<Variance>>,
    /// The matrix T: a row for each parameter, then, if T contains coefficients, for each coefficient of the errors.
    pub(super) transform: Option<DMatrix<f64>>,
    /// Whether T contains the coefficients of the joints' errors, so that the functions stay as they are.
    pub(super) has_coefficients: bool,
    /// Whether bars have the prior of a bar without a certificate.
    pub(super) are_bars_uncertified: bool,
}

/// The unknowns besides parameters and coefficients.
#[derive(Clone, Debug)]
struct ModelErrors {
    /// The centre of each cluster of poses.
    centres: Vec<Features>,
    warms: bool,
    /// The events that certainly happened.
    events: Vec<SupposedEvent>,
}

/// Sines and cosines of the joint angles, weighted by how far each joint moves the tool ball.
type Features = [f64; 2 * AXES];

#[derive(Clone, Debug)]
pub(super) struct Unknowns {
    pub(super) before: KnownBefore,
    /// The angles of each joint: lowest and highest, rad; equal where there are no errors of the joints.
    ranges: [[f64; 2]; AXES],
    visited: [VisitedAngles; AXES],
    /// Whether the sense of approach is known for any length.
    approached: bool,
    errors: ModelErrors,
}

impl Unknowns {
    /// `with_errors` adds errors that the geometry does not explain.
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
        let visited = if with_errors { angles.map(VisitedAngles::of) } else { Default::default() };
        Self { before, ranges, visited, approached, errors }
    }

    /// The same unknowns, and an event as further ones.
    pub(super) fn with_event(mut self, event: SupposedEvent) -> Self {
        self.errors.events.push(event);
        self
    }

    pub(super) fn events(&self) -> &[SupposedEvent] {
        &self.errors.events
    }

    pub(super) fn ids(&self) -> &[ParamId] {
        &self.before.ids
    }

    /// Whether the prior contains the coefficients of the joints' errors.
    pub(super) fn has_coefficients(&self) -> bool {
        self.before.has_coefficients
    }

    /// Whether a joint (from 0) turned far enough for a function of its angle.
    pub(super) fn moved(&self, joint: usize) -> bool {
        let [low, high] = self.ranges[joint];
        high - low >= MIN_RANGE
    }

    /// Number of columns that belong to the parameters.
    fn own(&self) -> usize {
        self.before.variances.len()
    }

    /// Number of the unknowns that change the model: parameters and coefficients. They are the first ones.
    pub(super) fn of_model(&self, model: &LengthModel) -> usize {
        self.own() + if self.before.has_coefficients { 0 } else { model.geometry.joint_errors.count() }
    }

    /// The places of the backlash coefficients of a model among all unknowns; none if T mixes them with others.
    pub(super) fn backlash_places(&self, model: &LengthModel) -> [Option<usize>; AXES] {
        if self.before.has_coefficients {
            return [None; AXES];
        }
        model.geometry.joint_errors.backlash_places().map(|place| Some(self.own() + place?))
    }

    /// The noise of the joints at which its search begins.
    pub(super) fn joint_noise(&self) -> JointNoise {
        let moved: [bool; AXES] = std::array::from_fn(|joint| self.moved(joint));
        JointNoise::of_moved(moved, self.approached || moved == [false; AXES])
    }

    /// Joint errors with as many basis functions as the length scale needs, with the coefficients of `before` where the
    /// functions are the same.
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
            let count = ((FUNCTIONS * half_width / quick.length_scale_rad) as usize)
                .clamp(MIN_FUNCTIONS, MAX_FUNCTIONS);
            let mut smooth = SmoothJointError::new(0.5 * (low + high), half_width, count);
            if smooth.is_alike(&before.smooth) {
                let known = smooth.coefficients.iter_mut().zip(before.smooth.coefficients);
                known.for_each(|(own, value)| *own = value);
            }
            JointErrorModel { smooth, visited: self.visited[at], ..before }
        };
        JointErrors::new(std::array::from_fn(joint))
    }

    /// Design rows at a model; `z` are the values of the unknowns in the model.
    pub(super) fn linearised(
        &self,
        model: &LengthModel,
        z: &DVector<f64>,
        used: &Weighted,
        noise: JointNoise,
        bar_sds: &[f64],
    ) -> System {
        let KnownBefore { ids, transform, variances, has_coefficients, .. } = &self.before;
        let mean_sd = used.by(Sigma::Given).rms_sigma();
        let mut rows =
            PoseRows::at(model, &used.by(Sigma::All(1.0)), ids, |place| used.lengths().time(place));
        if let Some(transform) = transform {
            let mixed = rows.values.columns(0, transform.nrows()) * transform;
            let rest = rows.values.columns_range(transform.nrows()..).into_owned();
            rows.values = beside(mixed, &rest);
        }
        let errors = &model.geometry.joint_errors;
        let of_term = |term: JointTerm| match term.kind {
            TermKind::Smooth { frequency } => Variance::Spectral(term.joint, frequency),
            TermKind::Backlash if noise.is_approached() => Variance::Of(Group::Backlash, 1.0),
            TermKind::Backlash => Variance::ByNoise(noise.sought()[term.joint.index()]),
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
            weights: rows.lengths.iter().map(|length| used.lengths().given(length.place) / mean_sd).collect(),
            rows,
            variances,
            is_sigma_given: used.lengths().is_sigma_given,
            sigma_mm: used.lengths().repeatability_mm.unwrap_or(USUAL_SIGMA_MM),
        }
    }

    /// The values of the unknowns in a model; `known` are the values to which the model was moved before.
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

    /// The columns of bars without a certificate; T does not mix these parameters with others.
    pub(super) fn bar_columns(&self) -> impl Iterator<Item = usize> {
        let KnownBefore { ids, transform, are_bars_uncertified, .. } = &self.before;
        let is_bar = |at: &usize| *are_bars_uncertified && matches!(ids[*at], ParamId::BarOffset(_));
        let column = move |at: usize| match transform {
            Some(transform) => transform.row(at).transpose().iamax(),
            None => at,
        };
        (0..ids.len()).filter(is_bar).map(column)
    }

    /// Prior standard deviations of the parameters; `None` for a free one.
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

    /// Moves a model from the unknowns `now` to the unknowns `then`.
    pub(super) fn move_to(&self, now: &DVector<f64>, then: &DVector<f64>, model: &mut LengthModel) {
        let own = self.of_model(model);
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

    /// The unknowns after the model moved to them: a free unknown is a step, which is done and becomes 0.
    pub(super) fn rested(&self, mut z: DVector<f64>) -> DVector<f64> {
        for (k, _) in self.before.variances.iter().enumerate().filter(|(_, variance)| variance.is_none()) {
            z[k] = 0.0;
        }
        z
    }

    /// The rows of parameters and coefficients that follow from rows of unknowns.
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
pub(super) const USUAL_SIGMA_MM: f64 = 0.03;

impl ModelErrors {
    /// The columns of these errors, with a row for each design row, and the prior of each column.
    fn columns(&self, rows: &PoseRows, used: &Weighted) -> (DMatrix<f64>, Vec<Variance>) {
        let places = 3 * self.centres.len();
        let warming = if self.warms { (AXES + 1) * WARMING } else { 0 };
        let mut columns = DMatrix::zeros(rows.lengths.len(), places + warming);
        for (row, length) in rows.lengths.iter().enumerate() {
            let here = features(&length.joints);
            let distances = self.centres.iter().map(|centre| square(centre, &here)).enumerate();
            if let Some((cluster, _)) = distances.min_by(|a, b| a.1.total_cmp(&b.1)) {
                for axis in 0..3 {
                    columns[(row, 3 * cluster + axis)] = rows.lengths[row].unit[axis];
                }
            }
        }
        for row in 0..if self.warms { rows.lengths.len() } else { 0 } {
            let elapsed = used.lengths().elapsed(rows.lengths[row].place).unwrap_or(0.0);
            for order in 1..=WARMING {
                let wave = (std::f64::consts::PI * order as f64 * elapsed).cos() / order as f64;
                let first = places + (order - 1) * (AXES + 1);
                for joint in 0..AXES {
                    columns[(row, first + joint)] = wave * rows.lengths[row].by_joint[joint];
                }
                columns[(row, first + AXES)] = wave * rows.lengths[row].growth;
            }
        }
        let mut variances = vec![Variance::Of(Group::Cluster, 1.0); places];
        variances.extend(vec![Variance::Of(Group::Warming, 1.0); warming]);
        for event in &self.events {
            columns = beside(columns, &event.of_rows(rows, used.lengths()));
            variances.extend(vec![Variance::Fixed(event.size); event.columns()]);
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

/// The centres of the clusters: poses (joint angles, rad) that are far from each other. The first is the farthest from
/// the middle of all poses, each further one the farthest from those before it.
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

/// Lowest and highest angle, rad.
fn range(angles: &[f64]) -> [f64; 2] {
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    angles.iter().fold(start, |[low, high], angle| [low.min(*angle), high.max(*angle)])
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::super::lengths::Lengths;
    use super::super::options::Options;
    use super::super::tests::cell_of_poses::{base_balls, hypers, model, normals, pose, readings};
    use super::*;
    use crate::measurement::{Measurement, PreparedMeasurement};
    use crate::robot::{BallId, Coordinate, Joint};
    use crate::test_support::cell::kr60;

    fn poses(count: usize) -> Vec<[f64; AXES]> {
        let mut random = Pcg64::seed_from_u64(1);
        (0..count).map(|_| pose(&mut random)).collect()
    }

    #[test]
    fn clusters_are_far_from_each_other_and_do_not_depend_on_the_order() {
        for (count, expected) in [(7, 0), (8, 2), (43, 10), (96, 24), (400, 24)] {
            assert_eq!(centres(&poses(count)).len(), expected, "{count} poses");
        }
        let mut poses = poses(60);
        let found = centres(&poses);
        // Each is the farthest from those before it, the first from the middle.
        let all: Vec<Features> = poses.iter().map(features).collect();
        let middle: Features = std::array::from_fn(|k| all.iter().map(|one| one[k]).sum::<f64>() / 60.0);
        for (at, centre) in found.iter().enumerate() {
            let off = |one: &Features| match at {
                0 => square(one, &middle),
                _ => found[..at].iter().map(|before| square(one, before)).fold(f64::INFINITY, f64::min),
            };
            let farthest = all.iter().map(off).fold(0.0, f64::max);
            assert!((off(centre) - farthest).abs() < 1e-12, "{at}");
        }
        poses.reverse();
        poses.extend_from_within(..30);
        poses.swap(3, 40);
        assert_eq!(centres(&poses), found, "nor on poses that are repeated");
    }

    /// Rows of readings as a table has them, measured one after the other.
    fn table(readings: &[PreparedMeasurement]) -> Vec<Measurement> {
        (1..).zip(readings).map(|(index, one)| Measurement::of_prepared(index, one)).collect()
    }

    fn known(
        ids: &[ParamId],
        variances: Vec<Option<Variance>>,
        transform: Option<DMatrix<f64>>,
    ) -> KnownBefore {
        let start = model(2);
        let mean = |(id, variance): (&ParamId, &Option<Variance>)| variance.map_or(0.0, |_| start.value(*id));
        let means = ids.iter().zip(&variances).map(mean).collect();
        KnownBefore {
            ids: ids.to_vec(),
            means,
            variances,
            transform,
            has_coefficients: false,
            are_bars_uncertified: false,
        }
    }

    const IDS: [ParamId; 4] = [
        ParamId::A(Joint::J2),
        ParamId::D(Joint::J4),
        ParamId::Theta(Joint::J3),
        ParamId::Ball(BallId::FIRST, Coordinate::X),
    ];

    fn sorted_ids() -> Vec<ParamId> {
        let mut ids = IDS.to_vec();
        ids.sort();
        ids
    }

    /// Every parameter except the ball has a prior.
    fn variances(ids: &[ParamId]) -> Vec<Option<Variance>> {
        let of = |id: &ParamId| match id {
            ParamId::Ball(..) => None,
            ParamId::Theta(_) => Some(Variance::Fixed(1e-3)),
            _ => Some(Variance::Of(Group::Tolerance, 0.5)),
        };
        ids.iter().map(of).collect()
    }

    /// A transform that mixes the first three of the four parameters.
    fn transform() -> DMatrix<f64> {
        DMatrix::from_row_slice(
            4,
            4,
            &[1.0, 0.2, -0.1, 0.0, 0.0, 0.8, 0.3, 0.0, 0.4, 0.0, 1.1, 0.0, 0.0, 0.0, 0.0, 1.0],
        )
    }

    #[test]
    fn columns_of_warming_are_what_zeros_and_links_move_with_time() {
        let (model, robot) = (model(2), kr60());
        let readings = readings(&model, 30, 1);
        let (rows, options) = (table(&readings), Options::default());
        let lengths = Lengths::of(&rows, &options, &robot);
        let used = lengths.plain();
        let ids = sorted_ids();
        let unknowns = Unknowns::new(known(&ids, variances(&ids), None), &model, &used, true);
        let mut there = model.clone();
        there.geometry.joint_errors = unknowns.errors(&model.geometry.joint_errors, &hypers(0.03));
        let system = unknowns.linearised(
            &there,
            &unknowns.at(&there, &DVector::zeros(0)),
            &used,
            JointNoise::NONE,
            &[],
        );
        let warming = (AXES + 1) * WARMING;
        let first = system.variances.len() - warming;
        assert!(system.variances[first..].iter().all(|one| *one == Some(Variance::Of(Group::Warming, 1.0))));
        // 30 poses have 7 clusters of 3 columns before, whose row has the direction of the length once.
        assert!(
            system.variances[first - 21..first]
                .iter()
                .all(|one| *one == Some(Variance::Of(Group::Cluster, 1.0)))
        );
        let step = 1e-6;
        for row in [0, 17, 59] {
            let reading = lengths.reading(row);
            let length = |model: &LengthModel| model.prepare().length(&reading);
            let elapsed = row as f64 / 59.0;
            let by = |moved: &LengthModel| (length(moved) - length(&there)) / step;
            let mut moves: Vec<f64> = Joint::ALL
                .map(|joint| {
                    let mut moved = there.clone();
                    moved.shift(ParamId::Theta(joint), step);
                    by(&moved)
                })
                .to_vec();
            let mut grown = there.clone();
            for joint in Joint::ALL {
                for id in [ParamId::A(joint), ParamId::D(joint)] {
                    grown.shift(id, step * there.value(id));
                }
            }
            moves.push(by(&grown));
            for order in 1..=WARMING {
                let wave = (std::f64::consts::PI * order as f64 * elapsed).cos() / order as f64;
                for (at, mm) in moves.iter().enumerate() {
                    let found = system.rows.values[(row, first + (order - 1) * (AXES + 1) + at)];
                    assert!(
                        (found - wave * mm).abs() < 0.02,
                        "row {row}, order {order}, {at}: {found} {}",
                        wave * mm
                    );
                }
            }
            let clusters = system.rows.values.view((row, first - 21), (1, 21)).into_owned();
            assert!((clusters.norm() - 1.0).abs() < 1e-12, "{}", clusters.norm());
        }
    }

    #[test]
    fn without_an_order_nothing_warms() {
        let (model, robot) = (model(2), kr60());
        let mut rows = table(&readings(&model, 30, 1));
        rows.iter_mut().for_each(|row| row.index = 1);
        let options = Options::default();
        let lengths = Lengths::of(&rows, &options, &robot);
        let ids = sorted_ids();
        let unknowns = |with_errors| {
            Unknowns::new(known(&ids, variances(&ids), None), &model, &lengths.plain(), with_errors)
        };
        assert!(!unknowns(true).errors.warms && !unknowns(true).errors.centres.is_empty());
        assert!(unknowns(false).errors.centres.is_empty());
        assert!((0..AXES).all(|joint| unknowns(true).moved(joint) && !unknowns(false).moved(joint)));
    }

    #[test]
    fn parameters_have_the_covariance_of_the_transform() {
        let ids = sorted_ids();
        let mut of = variances(&ids);
        let free = of.iter().position(Option::is_none).unwrap();
        // The ball is the last of them, as the transform has it.
        assert_eq!(free, 3, "{ids:?}");
        let model = model(2);
        let readings = readings(&model, 10, 1);
        let lengths = Lengths::few(readings, vec![1.0; 20]);
        let unknowns =
            Unknowns::new(known(&ids, of.clone(), Some(transform())), &model, &lengths.plain(), false);
        let hypers = hypers(0.03);
        let found = unknowns.prior_sds(&hypers);
        assert_eq!(found[free], None);
        of[free] = Some(Variance::Fixed(1.0));
        let diagonal = DVector::from_iterator(4, of.iter().flatten().map(|variance| variance.value(&hypers)));
        let covariance = transform() * DMatrix::from_diagonal(&diagonal) * transform().transpose();
        for at in 0..3 {
            assert!((found[at].unwrap() / covariance[(at, at)].sqrt() - 1.0).abs() < 1e-12, "{at}");
        }
        // Rows of two coefficients and of an unknown beyond them follow those of the parameters.
        let rows = DMatrix::from_fn(7, 5, |i, j| ((3 * i + 5 * j) as f64).sin());
        let mixed = unknowns.rows_of_parameters(&rows, 2);
        assert_eq!(mixed.shape(), (6, 5));
        assert!((mixed.rows(0, 4) - transform() * rows.rows(0, 4)).norm() < 1e-12);
        assert_eq!(mixed.rows(4, 2), rows.rows(4, 2));
    }

    #[test]
    fn a_model_that_is_moved_to_unknowns_has_them() {
        let ids = sorted_ids();
        for transform in [None, Some(transform())] {
            let start = model(2);
            let readings = readings(&start, 20, 1);
            let lengths = Lengths::few(readings, vec![1.0; 40]);
            let unknowns = Unknowns::new(
                known(&ids, variances(&ids), transform.clone()),
                &start,
                &lengths.plain(),
                true,
            );
            let mut model = start.clone();
            model.geometry.joint_errors = unknowns.errors(&model.geometry.joint_errors, &hypers(0.03));
            let now = unknowns.at(&model, &DVector::zeros(0));
            assert_eq!(now.len(), 4 + model.geometry.joint_errors.count());
            let then = normals(now.len(), 5) * 1e-3;
            unknowns.move_to(&now, &then, &mut model);
            let found = unknowns.at(&model, &DVector::zeros(0));
            assert!((found - unknowns.rested(then.clone())).norm() < 1e-12);
            // The free ball made its step.
            assert!((model.balls[0].x - base_balls(1)[0].position.x - then[3]).abs() < 1e-12);
            let step = transform.map_or(then[0], |transform| (transform.row(0) * then.rows(0, 4))[0]);
            assert!((model.value(ids[0]) - start.value(ids[0]) - step).abs() < 1e-12);
            // And back.
            let here = unknowns.at(&model, &DVector::zeros(0));
            unknowns.move_to(&here, &now, &mut model);
            assert!((model.value(ids[0]) - start.value(ids[0])).abs() < 1e-12);
        }
    }
}
