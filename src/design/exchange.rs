//! The choice of N poses among many candidates: D-optimal, then I-optimal, by exchange.
//!
//! A candidate is the row a of its length in the coordinates of a posterior, over sigma, so that the
//! information before any length is I and C = (I + sum a a')^-1. D-optimal makes det C least, I-optimal the
//! trace of C W, with W the mean square of what each parameter moves over a workspace. Taking a pose in
//! or out changes C by q v v', v = C a, and with it what every candidate would gain: for
//! d = a' C a by q (a'v)^2, for e = a' C W C a by 2 q (a'v)(a'u) + q^2 s (a'v)^2, u = C W v, s = v' W v (Fedorov,
//! "Theory of Optimal Experiments", 1972). One pass over the candidates a change, nothing allocated.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

/// What is made least.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// The volume of what is left unknown.
    D,
    /// The mean square of the 3-D error over a workspace.
    I,
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
        }
    }

    /// Chooses `count` candidates: D-optimal ones, which are then bettered where the criterion is another one.
    pub fn choose(&mut self, count: usize, criterion: Criterion) -> &[usize] {
        self.extend(count, Criterion::D);
        self.improve(Criterion::D);
        if criterion == Criterion::I {
            self.improve(Criterion::I);
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
        if criterion == Criterion::I {
            // The D-optimal passes left this behind.
            for (at, e) in self.e.iter_mut().enumerate() {
                self.v.gemv(1.0, &self.covariance, &self.rows.column(at), 0.0);
                self.wv.gemv(1.0, &self.weight, &self.v, 0.0);
                *e = self.v.dot(&self.wv);
            }
        }
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
        if criterion == Criterion::D {
            for (a, d) in rows.zip(&mut self.d) {
                let av = dot(a, v);
                *d += q * av * av;
            }
        } else {
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
