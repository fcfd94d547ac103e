//! The choice of N poses among many candidates: D-optimal, then I-optimal or to see changes, by exchange.
//!
//! A candidate is the row a of its length in the coordinates of a posterior, over sigma, so that the
//! information before any length is I and C = (I + sum a a')^-1. D-optimal makes det C least, I-optimal the
//! trace of C W, with W the mean square of what each parameter moves over a workspace. Taking a pose in
//! or out changes C by q v v', v = C a, and with it what every candidate would gain: for
//! d = a' C a by q (a'v)^2, for e = a' C W C a by 2 q (a'v)(a'u) + q^2 s (a'v)^2, u = C W v, s = v' W v (Fedorov,
//! "Theory of Optimal Experiments", 1972). One pass over the candidates a change, nothing allocated.
//!
//! A change that moves the lengths of the candidates by g, over sigma, is seen through what the unknowns cannot imitate:
//! h = g - a' C (sum of a g over the chosen), with the noncentrality s = sum of h^2 / (1 + d) over the poses as they come
//! in. A pose in or out changes h by q (a'v) h_pose, and s by -q h_pose^2. The product of the 1 + s of all changes is
//! made greatest: of their powers none is bought with another's.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// What is made least.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Criterion {
    /// The volume of what is left unknown of the parameters.
    D,
    /// The mean square of the 3-D error over a workspace.
    #[default]
    I,
    /// What is not seen of changes of a calibrated robot.
    #[serde(rename = "change")]
    Change,
}

/// Passes over the chosen poses before the choice is final.
const PASSES: usize = 12;
/// Least share by which an exchange must better its criterion.
const WORTH: f64 = 1e-4;
/// A pass that exchanges less than this share of the poses is the last.
const SETTLED: usize = 25;

/// Candidates with what each would gain.
#[derive(Clone)]
pub struct Exchange<'a> {
    /// A column a candidate.
    rows: &'a DMatrix<f64>,
    /// The workspace's W in the same coordinates.
    weight: DMatrix<f64>,
    covariance: DMatrix<f64>,
    d: Vec<f64>,
    e: Vec<f64>,
    taken: Vec<bool>,
    chosen: Vec<usize>,
    v: DVector<f64>,
    wv: DVector<f64>,
    u: DVector<f64>,
    /// Effects of the changes on the candidates, a column a candidate, over sigma,
    effects: DMatrix<f64>,
    /// what the unknowns do not imitate of them,
    seen: DMatrix<f64>,
    /// and the noncentrality of each change.
    noncentrality: DVector<f64>,
}

impl<'a> Exchange<'a> {
    /// For `candidates` (a column each, in the coordinates of the posterior, over sigma); `moves` is the workspace's
    /// Jacobian in the same coordinates, three rows a pose.
    pub fn new(candidates: &'a DMatrix<f64>, moves: &DMatrix<f64>) -> Self {
        let n = candidates.nrows();
        let poses = (moves.nrows() / 3).max(1) as f64;
        let weight = moves.tr_mul(moves) / poses;
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
            seen: DMatrix::zeros(0, candidates.ncols()),
            noncentrality: DVector::zeros(0),
        }
    }

    /// For [`Criterion::Change`]: `effects` has a row a change and a column a candidate, over sigma.
    pub fn for_changes(candidates: &'a DMatrix<f64>, effects: DMatrix<f64>) -> Self {
        let none = Self::new(candidates, &DMatrix::zeros(0, candidates.nrows()));
        Self { seen: effects.clone(), noncentrality: DVector::zeros(effects.nrows()), effects, ..none }
    }

    /// Chooses `count` candidates: D-optimal ones, which are then bettered where the criterion is another one.
    pub fn choose(&mut self, count: usize, criterion: Criterion) -> &[usize] {
        self.extend(count, Criterion::D);
        self.improve(Criterion::D);
        if criterion != Criterion::D {
            self.improve(criterion);
        }
        &self.chosen
    }

    /// Takes in the best candidates one by one until `count` are chosen, or none is left.
    pub fn extend(&mut self, count: usize, criterion: Criterion) {
        self.chosen.reserve(count);
        while self.chosen.len() < count {
            let Some((best, _)) = self.best(criterion) else { return };
            self.change(best, true, criterion);
            self.chosen.push(best);
        }
    }

    /// Exchanges chosen poses for better ones until none is worth it.
    pub fn improve(&mut self, criterion: Criterion) {
        self.renew(criterion);
        for _ in 0..PASSES {
            let mut exchanged = 0;
            for place in 0..self.chosen.len() {
                let old = self.chosen[place];
                self.change(old, false, criterion);
                let keep = self.gain(old, criterion);
                let new = match self.best(criterion) {
                    Some((best, gain)) if best != old && gain > keep * (1.0 + WORTH) => best,
                    _ => old,
                };
                self.change(new, true, criterion);
                self.chosen[place] = new;
                exchanged += usize::from(new != old);
            }
            if exchanged * SETTLED < self.chosen.len().max(1) {
                return;
            }
        }
    }

    /// What the D-optimal passes left behind.
    fn renew(&mut self, criterion: Criterion) {
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
                let imitated = &self.covariance * &crossed;
                self.seen = &self.effects - imitated.tr_mul(self.rows);
                for (change, noncentrality) in self.noncentrality.iter_mut().enumerate() {
                    let lost = crossed.column(change).dot(&imitated.column(change));
                    *noncentrality = (effects.row(change).norm_squared() - lost).max(0.0);
                }
            }
        }
    }

    /// Takes one candidate of each group, then exchanges each for a better one of its own group until none is worth it.
    pub fn one_of_each(&mut self, groups: &[Range<usize>], criterion: Criterion) {
        for group in groups.iter().filter(|group| !group.is_empty()) {
            let first = self.best_of(group.clone(), criterion).map_or(group.start, |(best, _)| best);
            self.change(first, true, criterion);
            self.chosen.push(first);
        }
        for _ in 0..PASSES {
            let mut exchanged = false;
            for (place, group) in groups.iter().filter(|group| !group.is_empty()).enumerate() {
                let old = self.chosen[place];
                self.change(old, false, criterion);
                let keep = self.gain(old, criterion);
                let new = match self.best_of(group.clone(), criterion) {
                    Some((best, gain)) if gain > keep * (1.0 + WORTH) => best,
                    _ => old,
                };
                self.change(new, true, criterion);
                self.chosen[place] = new;
                exchanged |= new != old;
            }
            if !exchanged {
                return;
            }
        }
    }

    /// The chosen candidates.
    pub fn chosen(&self) -> &[usize] {
        &self.chosen
    }

    /// Root mean square of the 3-D error over the workspace with what is chosen, mm.
    pub fn rms_error_mm(&self) -> f64 {
        self.covariance.dot(&self.weight).sqrt()
    }

    /// What taking a candidate in would better.
    fn gain(&self, at: usize, criterion: Criterion) -> f64 {
        match criterion {
            Criterion::D => self.d[at],
            Criterion::I => self.e[at] / (1.0 + self.d[at]),
            Criterion::Change => {
                let seen = self.seen.column(at);
                let share = |(h, s): (&f64, &f64)| 1.0 + h * h / ((1.0 + self.d[at]) * (1.0 + s));
                seen.iter().zip(&self.noncentrality).map(share).product()
            }
        }
    }

    fn best(&self, criterion: Criterion) -> Option<(usize, f64)> {
        self.best_of(0..self.taken.len(), criterion)
    }

    fn best_of(&self, among: Range<usize>, criterion: Criterion) -> Option<(usize, f64)> {
        let free = among.filter(|&at| !self.taken[at]);
        free.map(|at| (at, self.gain(at, criterion))).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Takes a candidate in or out.
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
                let of_pose = self.seen.column(at).into_owned();
                for ((a, d), mut seen) in rows.zip(&mut self.d).zip(self.seen.column_iter_mut()) {
                    let av = dot(a, v);
                    *d += q * av * av;
                    seen.axpy(q * av, &of_pose, 1.0);
                }
                of_pose.iter().zip(&mut self.noncentrality).for_each(|(h, s)| *s -= q * h * h);
            }
        }
        self.covariance.ger(q, &self.v, &self.v, 1.0);
    }
}

/// Four sums side by side, which the processor adds at once.
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
