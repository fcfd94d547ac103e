//! Changes of a robot since its calibration: the innovation of a few lengths against the posterior of the calibration.
//!
//! If nothing changed, the lengths differ from those of the identified robot by errors within its posterior, by the changes of
//! mounting (base balls free or kept, tool ball and bar by the repeatability of their mounting) and by noise. In the
//! coordinates w of the posterior's root this is a least-squares problem with unit normal w. Its minimum, the innovation, is
//! chi-square distributed. A change of parameters adds columns. Triangularised in the order w, balls, changes, the last block
//! of the factor contains all information about changes.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::expected::{Expected, typical};
use crate::estimation::LengthNoise;
use crate::estimation::posterior::Learnt;
use crate::math::Triangle;
use crate::math::distributions::{
    COVERAGE_95, chi_square_exceeded, chi_square_tail, noncentral_tail, noncentrality,
};
use crate::measurement::PreparedMeasurement;
use crate::robot::{ParamId, ParamOwner, ParamUnit};

/// Probability that a change is reported although nothing changed.
pub const FALSE_ALARM: f64 = 0.01;
/// Probability of finding the smallest detectable change.
pub const POWER: f64 = 0.95;
/// Prior probabilities of no change, one change and two changes. Half of the probability of one is for joint offsets.
const NOTHING: f64 = 0.5;
const ONE: f64 = 0.45;
const TWO: f64 = 0.05;
const OFFSET_SHARE: f64 = 0.5;
/// Changes whose effects on the lengths have at least this cosine are not separable.
const ALIKE: f64 = 0.995;
/// Hypotheses with a lower probability are not listed.
const MIN_PROBABLE: f64 = 1e-3;
/// Changes beyond this number of typical changes are not considered.
const LARGEST: f64 = 10.0;
/// Draws for the distribution of the test statistic without a change, and their seed.
const DRAWS: usize = 10_000;
const SEED: u64 = 1;

#[derive(Clone, Debug)]
pub struct Innovation {
    changeable: Vec<ParamId>,
    /// Possible changes, by their columns of the effects: of one parameter, or of all coordinates of the tool ball or of a base
    /// ball.
    candidates: Vec<Vec<usize>>,
    /// Effect of each changeable parameter, a column each, in units of the noise.
    effects: DMatrix<f64>,
    /// The innovation in the same coordinates as the effects.
    innovation: DVector<f64>,
    /// The sum of squares that is not in the innovation.
    rest: f64,
    freedom: usize,
    /// The test statistic without a change, drawn and sorted.
    null: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hypothesis {
    /// The changed parameters.
    pub parameters: Vec<ParamId>,
    /// Least-squares estimate of the change, in the order of the parameters, mm or rad.
    pub change: Vec<f64>,
    pub sd: Vec<f64>,
    pub interval95: Vec<[f64; 2]>,
    pub probability: f64,
    /// Single parameters and base balls whose change would have the same effect on these lengths.
    pub alike: Vec<ParamId>,
    /// Tail probability of the part of the innovation that the hypothesis does not explain.
    pub p_rest: f64,
}

/// The test for any change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChangeTest {
    /// The innovation: chi-square with `freedom` degrees of freedom if nothing changed.
    pub chi_square: f64,
    pub freedom: usize,
    pub p_chi_square: f64,
    /// The p-value of the test statistic, by which the test decides. The statistic is the least of the tail probabilities of
    /// the whole innovation and of its part along each single change.
    pub p: f64,
    pub false_alarm: f64,
    pub changed: bool,
}

/// The smallest change of a parameter that is found with the stated power.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Detectable {
    pub name: ParamId,
    pub unit: ParamUnit,
    /// mm or rad; `None` if it is larger than ten typical changes.
    pub smallest: Option<f64>,
}

/// The power of a check at planned poses. `least_tolerance_mm` is the smallest tolerance (position error of 95 % of the
/// poses) that a robot passes whose lengths agree with the calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckPower {
    pub lengths: usize,
    pub sigma_mm: f64,
    pub false_alarm: f64,
    pub power: f64,
    pub detectable: Vec<Detectable>,
    pub tolerance_mm: Option<f64>,
    pub least_tolerance_mm: f64,
}

impl ChangeTest {
    /// The least p-value of the test: none of the draws was as extreme.
    pub const MIN_P: f64 = 1.0 / (DRAWS as f64 + 1.0);
}

impl Innovation {
    /// `None` if a number is not finite, or there are no more lengths than free coordinates.
    pub fn of(expected: &Expected, readings: &[PreparedMeasurement], noise: LengthNoise<'_>) -> Option<Self> {
        Self::at(expected, readings, noise, &expected.posterior.learnt(readings, noise)?)
    }

    /// The test for planned lengths: it has no innovation.
    pub fn foreseen(
        expected: &Expected,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
    ) -> Option<Self> {
        let posterior = expected.posterior.clone();
        let w = DVector::zeros(posterior.root().ncols());
        Self::at(expected, readings, noise, &Learnt { posterior, w })
    }

    fn at(
        expected: &Expected,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
        learnt: &Learnt,
    ) -> Option<Self> {
        let Expected { posterior, free, .. } = expected;
        let freedom = readings.len().checked_sub(free.len()).filter(|freedom| *freedom > 0)?;
        let changeable: Vec<usize> = expected.changeable().collect();
        let mut system = posterior.system(&learnt.posterior.model, readings, noise)?;
        let (factor, rhs) = (system.factor(), system.rhs());
        let known = &factor * posterior.root();
        let right = rhs + &known * &learnt.w;
        let (unknowns, size) = (known.ncols(), changeable.len());
        let mut triangle = Triangle::new(unknowns + size);
        for at in (0..unknowns).filter(|at| !free.contains(at)) {
            triangle.push_single(at, 1.0, 0.0);
        }
        for row in 0..factor.nrows() {
            let mut values: Vec<f64> = known.row(row).iter().copied().collect();
            values.extend(changeable.iter().map(|column| factor[(row, *column)]));
            triangle.push(&values, right[row]);
        }
        let rest = system.residual_sum() + triangle.residual_sum();
        let effects = triangle.factor().view((unknowns, unknowns), (size, size)).into_owned();
        let innovation = triangle.rhs().rows(unknowns, size).into_owned();
        if !effects.iter().chain(innovation.iter()).chain([&rest]).all(|x| x.is_finite()) {
            return None;
        }
        let changeable: Vec<ParamId> = changeable.into_iter().map(|at| posterior.ids()[at]).collect();
        let candidates = candidates(&changeable, &effects);
        let mut found = Self { changeable, candidates, effects, innovation, rest, freedom, null: Vec::new() };
        found.null = found.drawn(noise.degrees_of_freedom_together(&posterior.model, readings));
        Some(found)
    }

    /// Number of rows in which changes are visible.
    fn rank(&self) -> usize {
        let rows = 0..self.effects.nrows();
        let has_content = |row: usize| self.effects.row(row).norm() > 0.0 || self.innovation[row] != 0.0;
        rows.filter(|row| has_content(*row)).count().min(self.freedom)
    }

    pub fn test(&self) -> ChangeTest {
        let chi_square = self.innovation.norm_squared() + self.rest;
        let null = &self.null;
        let innovation = DMatrix::from_columns(std::slice::from_ref(&self.innovation));
        let statistic = self.statistic(&self.projections(&innovation), 0, chi_square);
        let smaller = null.partition_point(|least| *least <= statistic);
        let p = (smaller + 1) as f64 / (null.len() + 1) as f64;
        ChangeTest {
            chi_square,
            freedom: self.freedom,
            p_chi_square: chi_square_tail(chi_square, self.freedom as f64),
            p,
            false_alarm: FALSE_ALARM,
            changed: p < FALSE_ALARM,
        }
    }

    /// The least of the tail probabilities of the whole innovation and of its part along each candidate.
    fn statistic(&self, parts: &[DVector<f64>], draw: usize, chi_square: f64) -> f64 {
        let mut largest = [0.0; 3];
        for (candidate, parts) in self.candidates.iter().zip(parts) {
            let of_freedom = &mut largest[candidate.len().clamp(1, 3) - 1];
            *of_freedom = parts[draw].max(*of_freedom);
        }
        let visible = (1..).zip(largest).filter(|(_, part)| *part > 0.0);
        visible.fold(chi_square_tail(chi_square, self.freedom as f64), |least, (freedom, part)| {
            chi_square_tail(part, f64::from(freedom)).min(least)
        })
    }

    /// The squared part along each candidate of each innovation (a column).
    fn projections(&self, innovations: &DMatrix<f64>) -> Vec<DVector<f64>> {
        let part = |candidate: &Vec<usize>| {
            let basis = orthonormal(&self.effects.select_columns(candidate));
            let along = basis.tr_mul(innovations);
            DVector::from_iterator(
                innovations.ncols(),
                along.column_iter().map(|column| column.norm_squared()),
            )
        };
        self.candidates.iter().map(part).collect()
    }

    /// The test statistic without a change, drawn and sorted. `tails` are the degrees of freedom of t-distributed lengths.
    fn drawn(&self, tails: Option<f64>) -> Vec<f64> {
        let mut random = Pcg64::seed_from_u64(SEED);
        let rank = self.rank();
        let mut drawn = DMatrix::zeros(self.effects.nrows(), DRAWS);
        let content: Vec<usize> =
            (0..self.effects.nrows()).filter(|row| self.effects.row(*row).norm() > 0.0).take(rank).collect();
        for row in content.iter().copied() {
            drawn.row_mut(row).iter_mut().for_each(|x| *x = StandardNormal.sample(&mut random));
        }
        let beyond = (self.freedom - content.len().min(self.freedom)) as f64;
        let beyond = (beyond > 0.0).then(|| ChiSquared::new(beyond).ok()).flatten();
        // A t-distributed innovation of the same covariance: the root of a gamma variable divides all of it.
        let scales: Vec<f64> = match tails.and_then(|freedom| Some((freedom, ChiSquared::new(freedom).ok()?)))
        {
            Some((freedom, gamma)) => {
                (0..DRAWS).map(|_| (freedom - 2.0) / gamma.sample(&mut random)).collect()
            }
            None => vec![1.0; DRAWS],
        };
        drawn.column_iter_mut().zip(&scales).for_each(|(mut column, scale)| column *= scale.sqrt());
        let parts = self.projections(&drawn);
        let mut null: Vec<f64> = (0..DRAWS)
            .map(|draw| {
                let rest = beyond.map_or(0.0, |beyond| scales[draw] * beyond.sample(&mut random));
                self.statistic(&parts, draw, drawn.column(draw).norm_squared() + rest)
            })
            .collect();
        null.sort_by(f64::total_cmp);
        null
    }

    /// The smallest change of each parameter that the test finds with the probability [`POWER`].
    pub fn detectable(&self) -> Vec<Detectable> {
        let needed =
            [1.0, 2.0, 3.0].map(|freedom| noncentrality(self.exceeded(freedom), freedom, POWER).sqrt());
        let smallest = |(column, name): (usize, &ParamId)| {
            let candidate = self.candidates.iter().find(|candidate| candidate.contains(&column));
            let smallest =
                candidate.map(|found| needed[found.len() - 1] / self.effects.column(column).norm());
            let smallest = smallest.filter(|found| *found <= LARGEST * typical(*name));
            Detectable { name: *name, unit: name.unit(), smallest }
        };
        self.changeable.iter().enumerate().map(smallest).collect()
    }

    /// The probability with which the test along a change of these parameters (mm, rad) finds it, a lower bound of the power of
    /// the whole test; `None` if they are not tested.
    pub fn power(&self, change: &[(ParamId, f64)]) -> Option<f64> {
        let column = |id: &ParamId| self.changeable.iter().position(|other| other == id);
        let columns: Vec<usize> = change.iter().map(|(id, _)| column(id)).collect::<Option<_>>()?;
        let has_all = |candidate: &&Vec<usize>| columns.iter().all(|column| candidate.contains(column));
        let candidate = self.candidates.iter().find(has_all)?;
        let sizes = DVector::from_iterator(change.len(), change.iter().map(|(_, size)| *size));
        let effect = (self.effects.select_columns(&columns) * sizes).norm_squared();
        let freedom = candidate.len() as f64;
        Some(noncentral_tail(self.exceeded(freedom), freedom, effect))
    }

    /// The limit of a part of the innovation with `freedom` degrees of freedom.
    fn exceeded(&self, freedom: f64) -> f64 {
        let level = self.null[((FALSE_ALARM * DRAWS as f64) as usize).min(self.null.len() - 1)];
        chi_square_exceeded(level, freedom)
    }

    /// Hypotheses of no, one and two changes, most probable first.
    pub fn hypotheses(&self) -> Vec<Hypothesis> {
        let is_offset = |candidate: &&Vec<usize>| matches!(self.changeable[candidate[0]], ParamId::Theta(_));
        let count = self.candidates.iter().filter(is_offset).count();
        let others = self.candidates.len() - count;
        let share = |candidate: &Vec<usize>| match (is_offset(&candidate), count > 0 && others > 0) {
            (true, true) => OFFSET_SHARE / count as f64,
            (false, true) => (1.0 - OFFSET_SHARE) / others as f64,
            _ => 1.0 / self.candidates.len() as f64,
        };
        // The changed columns with the logarithm of their unnormalised posterior probability.
        let mut weighted: Vec<(Vec<usize>, f64)> = vec![(vec![], NOTHING.ln())];
        for (at, one) in self.candidates.iter().enumerate() {
            weighted.push((one.clone(), (ONE * share(one)).ln() + self.evidence(one)));
            for two in &self.candidates[at + 1..] {
                let columns = [one.as_slice(), two].concat();
                if columns.len() == 2 && self.cosine(columns[0], two) < ALIKE {
                    let prior = 2.0 * TWO * share(one) * share(two);
                    let weight = prior.ln() + self.evidence(&columns);
                    weighted.push((columns, weight));
                }
            }
        }
        let largest = weighted.iter().map(|(_, weight)| *weight).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = weighted.iter().map(|(_, weight)| (weight - largest).exp()).sum();
        weighted.sort_by(|a, b| b.1.total_cmp(&a.1));
        let probable =
            weighted.into_iter().map(|(columns, weight)| (columns, (weight - largest).exp() / sum));
        probable
            .take_while(|(_, probability)| *probability > MIN_PROBABLE)
            .map(|(columns, probability)| self.hypothesis(&columns, probability))
            .collect()
    }

    /// Logarithm of the Bayes factor of typical changes against none: y ~ N(0, I + U S^2 U') against N(0, I).
    fn evidence(&self, columns: &[usize]) -> f64 {
        let mut scaled = self.effects.select_columns(columns);
        for (mut column, at) in scaled.column_iter_mut().zip(columns) {
            column *= typical(self.changeable[*at]);
        }
        let along = scaled.tr_mul(&self.innovation);
        let inner = DMatrix::identity(columns.len(), columns.len()) + scaled.tr_mul(&scaled);
        let Some(root) = inner.cholesky() else { return f64::NEG_INFINITY };
        0.5 * along.dot(&root.solve(&along)) - root.l().diagonal().iter().map(|x| x.ln()).sum::<f64>()
    }

    /// Cosine of the angle between a column of the effects and the space of others.
    fn cosine(&self, column: usize, others: &[usize]) -> f64 {
        let effect = self.effects.column(column);
        orthonormal(&self.effects.select_columns(others)).tr_mul(&effect).norm() / effect.norm()
    }

    fn hypothesis(&self, columns: &[usize], probability: f64) -> Hypothesis {
        let parameters =
            |columns: &[usize]| columns.iter().map(|at| self.changeable[*at]).collect::<Vec<_>>();
        let effects = self.effects.select_columns(columns);
        let inverse = effects.tr_mul(&effects).try_inverse();
        let inverse = inverse.unwrap_or_else(|| DMatrix::zeros(columns.len(), columns.len()));
        let change = &inverse * effects.tr_mul(&self.innovation);
        let sd: Vec<f64> = inverse.diagonal().iter().map(|variance| variance.sqrt()).collect();
        let left = (&self.innovation - &effects * &change).norm_squared() + self.rest;
        let freedom = self.freedom.saturating_sub(columns.len());
        let is_alike = |other: &&Vec<usize>| {
            columns.len() == 1
                && (other.len() == 1 || matches!(self.changeable[other[0]], ParamId::Ball(..)))
                && other.as_slice() != columns
                && self.cosine(columns[0], other) >= ALIKE
        };
        Hypothesis {
            parameters: parameters(columns),
            interval95: change
                .iter()
                .zip(&sd)
                .map(|(x, sd)| [x - COVERAGE_95 * sd, x + COVERAGE_95 * sd])
                .collect(),
            change: change.iter().copied().collect(),
            sd,
            probability,
            alike: self.candidates.iter().filter(is_alike).flat_map(|other| parameters(other)).collect(),
            p_rest: if freedom > 0 { chi_square_tail(left, freedom as f64) } else { 1.0 },
        }
    }
}

/// Whether two parameters are coordinates of the same ball.
fn are_of_one_ball(one: ParamId, other: ParamId) -> bool {
    one.owner() == other.owner() && matches!(one.owner(), ParamOwner::ToolBall | ParamOwner::Ball(_))
}

/// Single parameters, and balls as a whole, whose typical change is visible in the lengths.
fn candidates(changeable: &[ParamId], effects: &DMatrix<f64>) -> Vec<Vec<usize>> {
    let is_visible = |column: &usize| effects.column(*column).norm() * typical(changeable[*column]) > 1.0;
    let mut candidates: Vec<Vec<usize>> = Vec::new();
    for column in (0..changeable.len()).filter(is_visible) {
        let is_same_ball =
            |other: &&mut Vec<usize>| are_of_one_ball(changeable[other[0]], changeable[column]);
        match candidates.iter_mut().find(is_same_ball) {
            Some(ball) => ball.push(column),
            None => candidates.push(vec![column]),
        }
    }
    candidates
}

/// An orthonormal basis of the columns.
fn orthonormal(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let mut unit = columns.clone();
    unit.column_iter_mut().for_each(|mut column| {
        let norm = column.norm();
        column /= if norm > 0.0 { norm } else { 1.0 };
    });
    unit.qr().q()
}
