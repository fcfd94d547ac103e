//! The choice of N poses among many candidates by exchange: D-optimal, then I-optimal or for the detection of changes.
//!
//! A candidate is its whitened design row a in the coordinates of a posterior's root, so that the prior information is I and
//! C = (I + sum a a')^-1. D-optimal designs minimise det C, I-optimal designs trace(C W), where W is the mean of J'J over the
//! Jacobians J of a workspace. Adding or removing a pose changes C by q v v', v = C a. It changes d = a' C a of each candidate
//! by q (a'v)^2, and e = a' C W C a by 2 q (a'v)(a'u) + q^2 s (a'v)^2, with u = C W v and s = v' W v (Fedorov, "Theory of
//! Optimal Experiments", 1972). An exchange takes one pass over the candidates and allocates nothing.
//!
//! A change with the whitened effects g on the lengths is detected by the part that the unknowns cannot compensate:
//! h = g - a' C (sum of a g over the chosen). Its noncentrality is s = sum of h^2 / (1 + d) over the poses as they are added.
//! Adding or removing a pose changes h by q (a'v) h_pose, and s by -q h_pose^2. The product of (1 + s) over all changes is
//! maximised, so that no change gains power at the expense of another.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// The objective of the choice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Criterion {
    /// Determinant of the covariance of the parameters.
    D,
    /// Mean square of the position error over a workspace.
    #[default]
    I,
    /// Detection of changes of a calibrated robot.
    #[serde(rename = "change")]
    Change,
}

/// Most passes over the chosen poses.
const PASSES: usize = 12;
/// Least relative improvement of the criterion by an exchange.
const WORTH: f64 = 1e-4;
/// A pass that exchanges less than one pose in this number is the last.
const SETTLED: usize = 25;

/// The state of the exchange; the symbols are those of the module's description.
#[derive(Clone)]
pub struct Exchange<'a> {
    /// The row a of each candidate, as a column.
    rows: &'a DMatrix<f64>,
    /// W.
    weight: DMatrix<f64>,
    /// C.
    covariance: DMatrix<f64>,
    d: Vec<f64>,
    e: Vec<f64>,
    taken: Vec<bool>,
    chosen: Vec<usize>,
    v: DVector<f64>,
    wv: DVector<f64>,
    u: DVector<f64>,
    /// The effects g: a row for each change, a column for each candidate.
    effects: DMatrix<f64>,
    /// The detectable part h of the effects: a row for each change, a column for each candidate.
    detectable: DMatrix<f64>,
    /// The noncentrality s of each change.
    noncentrality: DVector<f64>,
}

impl<'a> Exchange<'a> {
    /// `candidates` has a column for each candidate, `jacobian` is the Jacobian of the tool ball over the workspace,
    /// three rows for each pose; both are in the coordinates of the posterior's root.
    pub fn new(candidates: &'a DMatrix<f64>, jacobian: &DMatrix<f64>) -> Self {
        let n = candidates.nrows();
        let poses = (jacobian.nrows() / 3).max(1) as f64;
        let weight = jacobian.tr_mul(jacobian) / poses;
        let d = candidates.column_iter().map(|a| a.norm_squared()).collect();
        let e = candidates.column_iter().map(|a| (&weight * a).dot(&a)).collect();
        Self {
            rows: candidates,
            covariance: DMatrix::identity(n, n),
            d,
            e,
            taken: vec![false; candidates.ncols()],
            chosen: Vec::new(),
            v: DVector::zeros(n),
            wv: DVector::zeros(n),
            u: DVector::zeros(n),
            weight,
            effects: DMatrix::zeros(0, candidates.ncols()),
            detectable: DMatrix::zeros(0, candidates.ncols()),
            noncentrality: DVector::zeros(0),
        }
    }

    /// The exchange for [`Criterion::Change`]: `effects` has a row for each change and a column for each candidate,
    /// whitened.
    pub fn for_changes(candidates: &'a DMatrix<f64>, effects: DMatrix<f64>) -> Self {
        let none = Self::new(candidates, &DMatrix::zeros(0, candidates.nrows()));
        Self { detectable: effects.clone(), noncentrality: DVector::zeros(effects.nrows()), effects, ..none }
    }

    /// Chooses `count` candidates: a D-optimal design, which is then improved for another criterion.
    pub fn choose(&mut self, count: usize, criterion: Criterion) -> &[usize] {
        self.extend(count, Criterion::D);
        self.improve(Criterion::D);
        if criterion != Criterion::D {
            self.improve(criterion);
        }
        &self.chosen
    }

    /// Adds the best candidate until `count` are chosen, or none is left.
    pub fn extend(&mut self, count: usize, criterion: Criterion) {
        self.chosen.reserve(count);
        while self.chosen.len() < count {
            let Some((best, _)) = self.best(0..self.taken.len(), criterion) else { return };
            self.change(best, true, criterion);
            self.chosen.push(best);
        }
    }

    /// Exchanges chosen poses for better ones until the gain is small.
    pub fn improve(&mut self, criterion: Criterion) {
        self.renew(criterion);
        for _ in 0..PASSES {
            let mut exchanged = 0;
            for place in 0..self.chosen.len() {
                exchanged += usize::from(self.exchange(place, 0..self.taken.len(), criterion));
            }
            if exchanged * SETTLED < self.chosen.len() {
                return;
            }
        }
    }

    /// Exchanges one chosen pose for the best candidate `among` some, if that is better. Returns whether it was exchanged.
    fn exchange(&mut self, place: usize, among: Range<usize>, criterion: Criterion) -> bool {
        let old = self.chosen[place];
        self.change(old, false, criterion);
        let keep = self.gain(old, criterion);
        let new = match self.best(among, criterion) {
            Some((best, gain)) if gain > keep * (1.0 + WORTH) => best,
            _ => old,
        };
        self.change(new, true, criterion);
        self.chosen[place] = new;
        new != old
    }

    /// Computes the quantities of a criterion that the D-optimal exchange does not update.
    pub(super) fn renew(&mut self, criterion: Criterion) {
        match criterion {
            Criterion::D => {}
            Criterion::I => {
                for (at, e) in self.e.iter_mut().enumerate() {
                    self.v.gemv(1.0, &self.covariance, &self.rows.column(at), 0.0);
                    self.wv.gemv(1.0, &self.weight, &self.v, 0.0);
                    *e = self.v.dot(&self.wv);
                }
            }
            Criterion::Change => {
                let (rows, effects) =
                    (self.rows.select_columns(&self.chosen), self.effects.select_columns(&self.chosen));
                let crossed = rows * effects.transpose();
                let compensation = &self.covariance * &crossed;
                self.detectable = &self.effects - compensation.tr_mul(self.rows);
                for (change, noncentrality) in self.noncentrality.iter_mut().enumerate() {
                    let lost = crossed.column(change).dot(&compensation.column(change));
                    *noncentrality = (effects.row(change).norm_squared() - lost).max(0.0);
                }
            }
        }
    }

    /// Chooses the best candidate of each group, then exchanges within the groups until the gain is small.
    pub fn one_of_each(&mut self, groups: &[Range<usize>], criterion: Criterion) {
        let groups: Vec<&Range<usize>> = groups.iter().filter(|group| !group.is_empty()).collect();
        for &group in &groups {
            let first = self.best(group.clone(), criterion).map_or(group.start, |(best, _)| best);
            self.change(first, true, criterion);
            self.chosen.push(first);
        }
        for _ in 0..PASSES {
            let mut exchanged = false;
            for (place, &group) in groups.iter().enumerate() {
                exchanged |= self.exchange(place, group.clone(), criterion);
            }
            if !exchanged {
                return;
            }
        }
    }

    pub fn chosen(&self) -> &[usize] {
        &self.chosen
    }

    /// Root mean square of the position error over the workspace with the chosen poses, mm.
    pub fn rms_error_mm(&self) -> f64 {
        self.covariance.dot(&self.weight).sqrt()
    }

    /// The improvement of the criterion by adding a candidate.
    fn gain(&self, at: usize, criterion: Criterion) -> f64 {
        match criterion {
            Criterion::D => self.d[at],
            Criterion::I => self.e[at] / (1.0 + self.d[at]),
            Criterion::Change => {
                let h = self.detectable.column(at);
                let factor = |(h, s): (&f64, &f64)| 1.0 + h * h / ((1.0 + self.d[at]) * (1.0 + s));
                h.iter().zip(&self.noncentrality).map(factor).product()
            }
        }
    }

    /// The best candidate that is not taken, with its gain.
    fn best(&self, among: Range<usize>, criterion: Criterion) -> Option<(usize, f64)> {
        let free = among.filter(|&at| !self.taken[at]);
        free.map(|at| (at, self.gain(at, criterion))).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Adds or removes a candidate.
    fn change(&mut self, at: usize, enters: bool, criterion: Criterion) {
        let a = self.rows.column(at);
        self.v.gemv(1.0, &self.covariance, &a, 0.0);
        let d = a.dot(&self.v);
        let q = if enters { -1.0 / (1.0 + d) } else { 1.0 / (1.0 - d).max(1e-12) };
        self.taken[at] = enters;
        let n = self.v.len();
        let rows = self.rows.as_slice().chunks_exact(n.max(1));
        let v = self.v.as_slice();
        match criterion {
            Criterion::D => {
                for (a, d) in rows.zip(&mut self.d) {
                    let av = dot(a, v);
                    *d += q * av * av;
                }
            }
            Criterion::I => {
                self.wv.gemv(1.0, &self.weight, &self.v, 0.0);
                self.u.gemv(1.0, &self.covariance, &self.wv, 0.0);
                let s = self.v.dot(&self.wv);
                let u = self.u.as_slice();
                for ((a, d), e) in rows.zip(&mut self.d).zip(&mut self.e) {
                    let (av, au) = (dot(a, v), dot(a, u));
                    *d += q * av * av;
                    *e += q * av * (2.0 * au + q * s * av);
                }
            }
            Criterion::Change => {
                let of_pose = self.detectable.column(at).into_owned();
                for ((a, d), mut h) in rows.zip(&mut self.d).zip(self.detectable.column_iter_mut()) {
                    let av = dot(a, v);
                    *d += q * av * av;
                    h.axpy(q * av, &of_pose, 1.0);
                }
                of_pose.iter().zip(&mut self.noncentrality).for_each(|(h, s)| *s -= q * h * h);
            }
        }
        self.covariance.ger(q, &self.v, &self.v, 1.0);
    }
}

/// Dot product in four partial sums, for vector instructions.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in a4.iter().zip(b4) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve candidates of three unknowns and two changes, in no particular order.
    fn candidates() -> (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) {
        let value = |seed: f64| move |i: usize, j: usize| ((i * 12 + j) as f64 * 1.7 + seed).sin();
        (
            DMatrix::from_fn(3, 12, value(0.3)),
            DMatrix::from_fn(6, 3, value(1.1)),
            DMatrix::from_fn(2, 12, value(2.2)),
        )
    }

    /// (I + sum of a a')^-1 of the chosen candidates.
    fn covariance(rows: &DMatrix<f64>, chosen: &[usize]) -> DMatrix<f64> {
        let chosen = rows.select_columns(chosen);
        (DMatrix::identity(3, 3) + &chosen * chosen.transpose()).try_inverse().unwrap()
    }

    /// g'g - g'A'C A g of the chosen candidates: what the unknowns cannot compensate.
    fn noncentrality(rows: &DMatrix<f64>, effects: &DMatrix<f64>, chosen: &[usize], change: usize) -> f64 {
        let (a, g) = (rows.select_columns(chosen), effects.select_columns(chosen).row(change).transpose());
        let crossed = a * &g;
        g.norm_squared() - (crossed.transpose() * covariance(rows, chosen) * &crossed)[(0, 0)]
    }

    #[test]
    fn updated_covariance_is_the_inverse_of_the_information() {
        let (rows, jacobian, _) = candidates();
        let mut exchange = Exchange::new(&rows, &jacobian);
        for (at, enters, chosen) in
            [(4, true, vec![4]), (7, true, vec![4, 7]), (4, false, vec![7]), (1, true, vec![7, 1])]
        {
            exchange.change(at, enters, Criterion::I);
            let expected = covariance(&rows, &chosen);
            assert!((&exchange.covariance - &expected).norm() < 1e-12, "{chosen:?}");
            for at in 0..12 {
                let a = rows.column(at);
                let ca = &expected * a;
                assert!((exchange.d[at] - a.dot(&ca)).abs() < 1e-12);
                assert!((exchange.e[at] - ca.dot(&(&exchange.weight * &ca))).abs() < 1e-12);
            }
            let mean_square = (&expected * jacobian.tr_mul(&jacobian) / 2.0).trace();
            assert!((exchange.rms_error_mm() - mean_square.sqrt()).abs() < 1e-12);
        }
    }

    /// 1 + gain is the ratio of the determinants (matrix determinant lemma).
    #[test]
    fn gain_of_a_determinant() {
        let (rows, jacobian, _) = candidates();
        let mut exchange = Exchange::new(&rows, &jacobian);
        exchange.change(3, true, Criterion::D);
        for at in 4..12 {
            let ratio = covariance(&rows, &[3]).determinant() / covariance(&rows, &[3, at]).determinant();
            assert!((1.0 + exchange.gain(at, Criterion::D) - ratio).abs() < 1e-12);
        }
    }

    /// The gain is what the trace of C W loses.
    #[test]
    fn gain_of_a_mean_square() {
        let (rows, jacobian, _) = candidates();
        let mut exchange = Exchange::new(&rows, &jacobian);
        exchange.change(3, true, Criterion::I);
        let trace = |chosen: &[usize]| (covariance(&rows, chosen) * jacobian.tr_mul(&jacobian) / 2.0).trace();
        for at in 4..12 {
            let lost = trace(&[3]) - trace(&[3, at]);
            assert!((exchange.gain(at, Criterion::I) - lost).abs() < 1e-12);
        }
    }

    /// The gain is the ratio of the products of 1 + noncentrality.
    #[test]
    fn gain_of_the_detection_of_changes() {
        let (rows, _, effects) = candidates();
        let mut exchange = Exchange::for_changes(&rows, effects.clone());
        exchange.change(3, true, Criterion::Change);
        exchange.change(8, true, Criterion::Change);
        let product = |chosen: &[usize]| -> f64 {
            (0..2).map(|change| 1.0 + noncentrality(&rows, &effects, chosen, change)).product()
        };
        for change in 0..2 {
            let expected = noncentrality(&rows, &effects, &[3, 8], change);
            assert!((exchange.noncentrality[change] - expected).abs() < 1e-12);
        }
        for at in [0, 5, 11] {
            let ratio = product(&[3, 8, at]) / product(&[3, 8]);
            assert!((exchange.gain(at, Criterion::Change) - ratio).abs() < 1e-12);
        }
        // Computed again, the quantities are those of the updates.
        exchange.chosen = vec![3, 8];
        let (updated, s) = (exchange.detectable.clone(), exchange.noncentrality.clone());
        exchange.renew(Criterion::Change);
        assert!(
            (&exchange.detectable - updated).norm() < 1e-12 && (&exchange.noncentrality - s).norm() < 1e-12
        );
    }

    /// No exchange of one pose improves the design by more than the least relative improvement.
    #[test]
    fn chosen_pair_is_best_among_its_neighbours() {
        let (rows, jacobian, _) = candidates();
        let mut exchange = Exchange::new(&rows, &jacobian);
        exchange.choose(2, Criterion::D);
        let chosen = exchange.chosen().to_vec();
        let determinant = |chosen: &[usize]| covariance(&rows, chosen).determinant();
        for place in 0..2 {
            for other in (0..12).filter(|at| !chosen.contains(at)) {
                let mut neighbour = chosen.clone();
                neighbour[place] = other;
                assert!(determinant(&neighbour) > determinant(&chosen) * (1.0 - WORTH), "{neighbour:?}");
            }
        }
        assert_eq!(exchange.chosen().len(), 2);
        // No more can be chosen than there are.
        assert_eq!(Exchange::new(&rows, &jacobian).choose(20, Criterion::I).len(), 12);
    }

    #[test]
    fn one_candidate_of_each_group() {
        let (rows, jacobian, _) = candidates();
        let mut exchange = Exchange::new(&rows, &jacobian);
        exchange.one_of_each(&[0..4, 4..4, 4..12], Criterion::I);
        let [one, other] = exchange.chosen() else { panic!("{:?}", exchange.chosen()) };
        assert!((0..4).contains(one) && (4..12).contains(other));
    }

    #[test]
    fn dot_product_of_a_length_that_is_no_multiple_of_four() {
        let a: Vec<f64> = (1..=7).map(f64::from).collect();
        assert_eq!(dot(&a, &a), 140.0);
        assert_eq!(dot(&a[..3], &a[..3]), 14.0);
    }
}
