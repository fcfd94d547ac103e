//! What changed since a robot was calibrated: the innovation of a few lengths against the posterior of the calibration.
//!
//! Under the hypothesis that nothing changed, the lengths differ from the identified robot's by the errors that its
//! posterior allows, by what mounting changes (base balls free or kept, tool ball and bar by their repeat mounting) and by noise.
//! In the coordinates w of the posterior's root that is a least-squares problem with unit normal w; its least sum of
//! squares, the innovation, is chi-square. A change of some parameters adds columns to it. Triangularised in the order
//! w, balls, candidates, the factor's last block has all that the lengths say of changes.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::expected::{Expected, typical};
use super::pose_rows::LengthNoise;
use crate::math::Triangle;
use crate::math::distributions::{chi_square_exceeded, chi_square_tail, noncentral_tail, noncentrality};
use crate::measurement::PreparedMeasurement;
use crate::robot::{BallId, ParamId, Unit};

/// Probability that a change is reported although nothing changed.
pub const FALSE_ALARM: f64 = 0.01;
/// Probability with which the smallest change that is stated is found.
pub const POWER: f64 = 0.95;
/// Probabilities of the hypotheses before the lengths: nothing changed, one thing, two. Half of the one is a joint offset.
const NOTHING: f64 = 0.5;
const ONE: f64 = 0.45;
const TWO: f64 = 0.05;
const OFFSET_SHARE: f64 = 0.5;
/// Changes whose effects on the lengths have at least this cosine are not separable.
const ALIKE: f64 = 0.995;
/// Draws for the distribution of the test without a change, and their seed.
const DRAWS: usize = 10_000;
const SEED: u64 = 1;

/// What lengths say of changes.
#[derive(Clone, Debug)]
pub struct Innovation {
    changeable: Vec<ParamId>,
    candidates: Vec<Candidate>,
    /// Effect of each changeable parameter, a column each, in units of the noise,
    effects: DMatrix<f64>,
    /// and the innovation in the same coordinates,
    seen: DVector<f64>,
    /// with the sum of squares beyond these.
    rest: f64,
    freedom: usize,
    /// The statistic of the test where nothing changed, drawn and in order.
    null: Vec<f64>,
}

/// A change that is thinkable: a parameter, or the coordinates of the tool ball or of a base ball.
#[derive(Clone, Debug, PartialEq)]
struct Candidate {
    parameters: Vec<ParamId>,
    /// Columns of the effects.
    columns: Vec<usize>,
}

/// A hypothesis of what changed, and how much.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hypothesis {
    /// None where nothing changed.
    pub parameters: Vec<ParamId>,
    /// By least squares, in the order of the parameters, mm or rad.
    pub change: Vec<f64>,
    pub sd: Vec<f64>,
    /// Ends of the 95 % interval of each.
    pub interval95: Vec<[f64; 2]>,
    pub probability: f64,
    /// Single parameters and base balls whose change would do the same to these lengths.
    pub alike: Vec<ParamId>,
    /// Probability of an innovation as large as what the hypothesis leaves of it.
    pub p_rest: f64,
}

/// The test whether anything changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChangeTest {
    /// The innovation, chi-square of `freedom` degrees where nothing changed, and the chance that it is as large.
    pub chi_square: f64,
    pub freedom: usize,
    pub p_chi_square: f64,
    /// The chance of an innovation that speaks as clearly, as a whole or for any single change. The test goes by it.
    pub p: f64,
    pub false_alarm: f64,
    pub changed: bool,
}

/// The smallest change of a parameter that is found with the stated power.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Detectable {
    pub name: ParamId,
    pub unit: Unit,
    /// mm or rad; `None` where no change of ten times the usual is found.
    pub smallest: Option<f64>,
}

/// What a check by planned poses will find. `least_tolerance_mm`: the smallest tolerance of the position error of 95 % of
/// the poses with which lengths that agree with the calibrated robot pass.
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

/// Changes beyond so many typical ones are not looked for.
const LARGEST: f64 = 10.0;

impl Innovation {
    /// `None` when a number is not finite, or no length is left over.
    pub fn of(expected: &Expected, readings: &[PreparedMeasurement], noise: LengthNoise<'_>) -> Option<Self> {
        let learnt = expected.posterior().learnt(readings, noise)?;
        Self::at(expected, readings, noise, &learnt)
    }

    /// Of lengths as the model predicts them: the effects alone.
    pub fn foreseen(
        expected: &Expected,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
    ) -> Option<Self> {
        let nothing = DVector::zeros(expected.posterior().root().ncols());
        let model = expected.posterior().clone();
        Self::at(expected, readings, noise, &super::posterior::Learnt { found: model, w: nothing })
    }

    fn at(
        expected: &Expected,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
        learnt: &super::posterior::Learnt,
    ) -> Option<Self> {
        let freedom = readings.len().checked_sub(expected.free().len()).filter(|freedom| *freedom > 0)?;
        let root = expected.posterior().root();
        let ids = expected.posterior().ids();
        let changeable: Vec<usize> = expected.changeable().collect();
        let mut system = expected.posterior().system(&learnt.found.model, readings, noise)?;
        let (factor, rhs) = (system.factor(), system.rhs());
        let known = &factor * root;
        let right = rhs + &known * &learnt.w;
        let unknowns = root.ncols();
        let mut triangle = Triangle::new(unknowns + changeable.len());
        (0..unknowns)
            .filter(|at| !expected.free().contains(at))
            .for_each(|at| triangle.push_single(at, 1.0, 0.0));
        for row in 0..factor.nrows() {
            let mut values: Vec<f64> = known.row(row).iter().copied().collect();
            values.extend(changeable.iter().map(|column| factor[(row, *column)]));
            triangle.push(&values, right[row]);
        }
        let rest = system.residual_sum() + triangle.residual_sum();
        let size = changeable.len();
        let effects = triangle.factor().view((unknowns, unknowns), (size, size)).into_owned();
        let seen = triangle.rhs().rows(unknowns, size).into_owned();
        let finite = effects.iter().chain(seen.iter()).chain([&rest]).all(|x| x.is_finite());
        let changeable: Vec<ParamId> = changeable.into_iter().map(|at| ids[at]).collect();
        if !finite {
            return None;
        }
        let candidates = candidates(&changeable, &effects);
        let mut innovation = Self { changeable, candidates, effects, seen, rest, freedom, null: Vec::new() };
        innovation.null = innovation.drawn();
        Some(innovation)
    }

    /// Rows of the effects that have content: the dimensions in which changes can be seen.
    fn rank(&self) -> usize {
        let rows = 0..self.effects.nrows();
        let content = |row: usize| self.effects.row(row).norm() > 0.0 || self.seen[row] != 0.0;
        rows.filter(|row| content(*row)).count().min(self.freedom)
    }

    fn chi_square(&self) -> f64 {
        self.seen.norm_squared() + self.rest
    }

    /// Whether anything changed.
    pub fn test(&self) -> ChangeTest {
        let chi_square = self.chi_square();
        let null = &self.null;
        let seen = DMatrix::from_columns(std::slice::from_ref(&self.seen));
        let statistic = self.statistic(&self.projections(&seen), 0, chi_square);
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

    /// The smallest of the chances of the whole innovation and of each candidate's part of it.
    fn statistic(&self, parts: &[DVector<f64>], draw: usize, chi_square: f64) -> f64 {
        let mut least = chi_square_tail(chi_square, self.freedom as f64);
        let mut largest = [0.0; 3];
        for (candidate, parts) in self.candidates.iter().zip(parts) {
            let of_freedom = &mut largest[candidate.columns.len().clamp(1, 3) - 1];
            *of_freedom = parts[draw].max(*of_freedom);
        }
        for (freedom, part) in (1..).zip(largest).filter(|(_, part)| *part > 0.0) {
            least = chi_square_tail(part, f64::from(freedom)).min(least);
        }
        least
    }

    /// For each candidate its part of the innovations, a column each.
    fn projections(&self, innovations: &DMatrix<f64>) -> Vec<DVector<f64>> {
        let part = |candidate: &Candidate| {
            let basis = orthonormal(&self.effects.select_columns(&candidate.columns));
            let along = basis.tr_mul(innovations);
            DVector::from_iterator(
                innovations.ncols(),
                along.column_iter().map(|column| column.norm_squared()),
            )
        };
        self.candidates.iter().map(part).collect()
    }

    /// The statistic where nothing changed, drawn and in order.
    fn drawn(&self) -> Vec<f64> {
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
        let parts = self.projections(&drawn);
        let mut null: Vec<f64> = (0..DRAWS)
            .map(|draw| {
                let rest = beyond.map_or(0.0, |beyond| beyond.sample(&mut random));
                self.statistic(&parts, draw, drawn.column(draw).norm_squared() + rest)
            })
            .collect();
        null.sort_by(f64::total_cmp);
        null
    }

    /// The smallest change of each parameter that the test finds with the stated power.
    pub fn detectable(&self) -> Vec<Detectable> {
        let needed =
            [1.0, 2.0, 3.0].map(|freedom| noncentrality(self.exceeded(freedom), freedom, POWER).sqrt());
        let smallest = |(column, name): (usize, &ParamId)| {
            let candidate = self.candidates.iter().find(|candidate| candidate.columns.contains(&column));
            let smallest =
                candidate.map(|found| needed[found.columns.len() - 1] / self.effects.column(column).norm());
            let smallest = smallest.filter(|found| *found <= LARGEST * typical(*name));
            Detectable { name: *name, unit: name.unit(), smallest }
        };
        self.changeable.iter().enumerate().map(smallest).collect()
    }

    /// Probability with which the test along a change of these parameters finds it (mm, rad); `None` of one that is not
    /// looked for. The whole test finds it at least as often.
    pub fn power(&self, change: &[(ParamId, f64)]) -> Option<f64> {
        let column = |id: &ParamId| self.changeable.iter().position(|other| other == id);
        let columns: Vec<usize> = change.iter().map(|(id, _)| column(id)).collect::<Option<_>>()?;
        let candidate = self
            .candidates
            .iter()
            .find(|found| columns.iter().all(|column| found.columns.contains(column)))?;
        let sizes = DVector::from_iterator(change.len(), change.iter().map(|(_, size)| *size));
        let effect = (self.effects.select_columns(&columns) * sizes).norm_squared();
        let freedom = candidate.columns.len() as f64;
        Some(noncentral_tail(self.exceeded(freedom), freedom, effect))
    }

    /// The chi-square of a part of the innovation beyond which a change is reported.
    fn exceeded(&self, freedom: f64) -> f64 {
        let level = self.null[((FALSE_ALARM * DRAWS as f64) as usize).min(self.null.len() - 1)];
        chi_square_exceeded(level, freedom)
    }

    /// The hypotheses by their probability, likeliest first: nothing, one change, two.
    pub fn hypotheses(&self) -> Vec<Hypothesis> {
        let offsets = |candidate: &&Candidate| matches!(candidate.parameters[..], [ParamId::Theta(_)]);
        let count = self.candidates.iter().filter(offsets).count();
        let others = self.candidates.len() - count;
        let share = |candidate: &Candidate| match (offsets(&candidate), count > 0 && others > 0) {
            (true, true) => OFFSET_SHARE / count as f64,
            (false, true) => (1.0 - OFFSET_SHARE) / others as f64,
            _ => 1.0 / self.candidates.len() as f64,
        };
        let mut weighted: Vec<(Vec<usize>, f64)> = vec![(vec![], NOTHING.ln())];
        for (at, one) in self.candidates.iter().enumerate() {
            weighted.push((vec![at], (ONE * share(one)).ln() + self.evidence(&one.columns)));
            for (second, two) in self.candidates.iter().enumerate().skip(at + 1) {
                let columns = [one.columns.as_slice(), &two.columns].concat();
                if columns.len() == 2 && self.cosine(columns[0], &columns[1..]) < ALIKE {
                    let prior = 2.0 * TWO * share(one) * share(two);
                    weighted.push((vec![at, second], prior.ln() + self.evidence(&columns)));
                }
            }
        }
        let largest = weighted.iter().map(|(_, weight)| *weight).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = weighted.iter().map(|(_, weight)| (weight - largest).exp()).sum();
        weighted.sort_by(|a, b| b.1.total_cmp(&a.1));
        let probable = weighted.into_iter().map(|(of, weight)| (of, (weight - largest).exp() / sum));
        probable
            .take_while(|(_, probability)| *probability > LEAST_PROBABLE)
            .map(|(of, probability)| self.hypothesis(&of, probability))
            .collect()
    }

    /// Logarithm of the likelihood ratio of a change of the usual size to none: of y ~ N(0, I + U S^2 U').
    fn evidence(&self, columns: &[usize]) -> f64 {
        let mut scaled = self.effects.select_columns(columns);
        for (mut column, at) in scaled.column_iter_mut().zip(columns) {
            column *= self.typical(*at);
        }
        let along = scaled.tr_mul(&self.seen);
        let inner = DMatrix::identity(columns.len(), columns.len()) + scaled.tr_mul(&scaled);
        let Some(root) = inner.cholesky() else { return f64::NEG_INFINITY };
        0.5 * along.dot(&root.solve(&along)) - root.l().diagonal().iter().map(|x| x.ln()).sum::<f64>()
    }

    fn typical(&self, column: usize) -> f64 {
        let of_column = |candidate: &&Candidate| candidate.columns.contains(&column);
        self.candidates.iter().find(of_column).map_or(0.0, |candidate| typical(candidate.parameters[0]))
    }

    /// Of the angle between a column of the effects and the space of others.
    fn cosine(&self, column: usize, others: &[usize]) -> f64 {
        let effect = self.effects.column(column);
        orthonormal(&self.effects.select_columns(others)).tr_mul(&effect).norm() / effect.norm()
    }

    fn hypothesis(&self, of: &[usize], probability: f64) -> Hypothesis {
        let chosen: Vec<&Candidate> = of.iter().map(|at| &self.candidates[*at]).collect();
        let columns: Vec<usize> = chosen.iter().flat_map(|candidate| candidate.columns.clone()).collect();
        let effects = self.effects.select_columns(&columns);
        let inverse = effects.tr_mul(&effects).try_inverse();
        let inverse = inverse.unwrap_or_else(|| DMatrix::zeros(columns.len(), columns.len()));
        let change = &inverse * effects.tr_mul(&self.seen);
        let sd: Vec<f64> = inverse.diagonal().iter().map(|variance| variance.sqrt()).collect();
        let left = (&self.seen - &effects * &change).norm_squared() + self.rest;
        let freedom = self.freedom.saturating_sub(columns.len());
        let alike = |other: &&Candidate| {
            columns.len() == 1
                && (other.columns.len() == 1 || matches!(other.parameters[0], ParamId::Ball(..)))
                && other.columns != columns
                && self.cosine(columns[0], &other.columns) >= ALIKE
        };
        Hypothesis {
            parameters: chosen.iter().flat_map(|candidate| candidate.parameters.clone()).collect(),
            interval95: change.iter().zip(&sd).map(|(x, sd)| [x - 1.96 * sd, x + 1.96 * sd]).collect(),
            change: change.iter().copied().collect(),
            sd,
            probability,
            alike: self.candidates.iter().filter(alike).flat_map(|other| other.parameters.clone()).collect(),
            p_rest: if freedom > 0 { chi_square_tail(left, freedom as f64) } else { 1.0 },
        }
    }
}

/// Hypotheses below this probability are not listed.
const LEAST_PROBABLE: f64 = 1e-3;

/// The ball that a coordinate is of; `None` of other parameters.
fn ball_of(id: ParamId) -> Option<ChangedBall> {
    match id {
        ParamId::Tool(_) => Some(ChangedBall::Tool),
        ParamId::Ball(ball, _) => Some(ChangedBall::Base(ball)),
        _ => None,
    }
}

/// A ball that changes its place as a whole.
#[derive(Clone, Copy, PartialEq)]
enum ChangedBall {
    Tool,
    Base(BallId),
}

/// Single parameters, and balls as a whole, of which a change of the usual size can be seen in the lengths.
fn candidates(changeable: &[ParamId], effects: &DMatrix<f64>) -> Vec<Candidate> {
    let visible = |column: &usize| effects.column(*column).norm() * typical(changeable[*column]) > 1.0;
    let mut found: Vec<Candidate> = Vec::new();
    for column in (0..changeable.len()).filter(visible) {
        let id = changeable[column];
        let ball = ball_of(id);
        let same = |candidate: &&mut Candidate| ball.is_some() && ball_of(candidate.parameters[0]) == ball;
        match found.iter_mut().find(same) {
            Some(whole) => {
                whole.parameters.push(id);
                whole.columns.push(column);
            }
            None => found.push(Candidate { parameters: vec![id], columns: vec![column] }),
        }
    }
    found
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
