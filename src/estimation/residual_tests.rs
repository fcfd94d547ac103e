//! Do the residuals show what the model lacks at a joint: an error that returns with its angle, or reversal error?
//!
//! An error e of joint j moves a length by its derivative by theta_j times e. So the residuals are regressed on that
//! derivative times cos A, sin A, cos 2A, sin 2A (a gear's error, sag; A is the joint's own angle) and times the sense in
//! which the joint came to its pose (reversal error; of the sense only what those four do not explain counts), after all that the fitted parameters
//! explain has been taken out of both. Each of the twelve is judged by its F-test at 0.001 / 12 (Bonferroni), the
//! strongest first; what it explains is taken out before the next is judged. Residuals beyond three robust
//! deviations are brought in to there.

use nalgebra::{DMatrix, DVector};

use super::lengths::Weighted;
use super::linear_system::{LinearSystem, Rows};
use super::result::{JointEffect, JointError};
use super::solver::robust_scale;
use crate::math::distributions::{ln_f_tail, normal_deviate};
use crate::math::{Orthonormal, Triangle};
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::{AXES, Approach, Coupling, Joint, ParamId};

/// Chance that a sound robot's residuals are accused of anything.
const CHANCE: f64 = 1e-3;
/// MeasurementPieces that are looked at, evenly spread over a long run.
const MOST: usize = 4096;
/// Residuals below this are rounding, mm.
const ROUNDING_MM: f64 = 1e-7;
/// Regressors of a joint: four of its angle, one of its sense.
const COLUMNS: usize = 5;

/// For each pose (axis angles, rad) the sense in which each axis came to it, -1, 0 (not known) or 1: from the pose
/// before; an axis that stood still keeps its sense.
pub fn senses(axes: impl IntoIterator<Item = [f64; AXES]>) -> impl Iterator<Item = [i8; AXES]> {
    Approach::along(axes).map(|approach| approach.senses())
}

/// What the residuals of a fit of `kept` to `lengths` at `model` show beyond chance, the strongest first.
pub(super) fn joint_effects(model: &LengthModel, lengths: &Weighted, kept: &[ParamId]) -> Vec<JointEffect> {
    let Sample { readings, sigma, senses } = Sample::of(lengths, &model.geometry.coupling);
    let prepared = model.prepare();
    let raw: Vec<f64> = readings.iter().map(|reading| reading.length_mm - prepared.length(reading)).collect();
    let scale = robust_scale(&raw);
    let freedom = readings.len() as f64 - kept.len() as f64;
    if scale < ROUNDING_MM || freedom <= (AXES * COLUMNS) as f64 {
        return Vec::new();
    }
    let unknowns = kept.len() + AXES * COLUMNS;
    let rows = Rows { model, ids: kept, further: AXES * COLUMNS };
    let triangles = rows.fold(
        &(readings.as_slice(), sigma.as_slice()),
        || Triangle::new(unknowns),
        |triangle, row| {
            let turned = model.geometry.coupling.sin_cos(&row.reading.sin_cos.0);
            for (axis, joint) in Joint::ALL.into_iter().enumerate() {
                let lever = row.weight * row.derivatives.derivative(ParamId::Theta(joint));
                let [s, c] = turned[axis];
                let own = [c, s, c * c - s * s, 2.0 * s * c, f64::from(senses[row.place][axis])];
                let at = kept.len() + axis * COLUMNS;
                row.values[at..at + COLUMNS].copy_from_slice(&own.map(|value| value * lever));
            }
            triangle.push(row.values, raw[row.place].clamp(-3.0 * scale, 3.0 * scale) * row.weight);
        },
    );
    let count = readings.len() as f64;
    let sigma_mm = (sigma.iter().map(|sigma| sigma * sigma).sum::<f64>() / count).sqrt();
    let mut unexplained = Unexplained::of(LinearSystem::of(triangles, unknowns), kept.len(), freedom);
    let mut found: Vec<JointEffect> = Vec::new();
    while let Some(strongest) = unexplained.strongest(&found) {
        unexplained.take_out(&strongest);
        found.push(strongest.effect(sigma_mm / count.sqrt()));
    }
    found
}

/// The lengths that are looked at, with the sense in which each joint came to its pose.
struct Sample {
    readings: Vec<PreparedMeasurement>,
    sigma: Vec<f64>,
    senses: Vec<[i8; AXES]>,
}

impl Sample {
    fn of(lengths: &Weighted, coupling: &Coupling) -> Self {
        let all = lengths.lengths();
        let stride = all.len().div_ceil(MOST).max(1);
        let senses = senses((0..all.len()).map(|at| coupling.joints(&all.axes(at))));
        let used = lengths.sigmas().zip(senses).enumerate().filter(|(_, (sigma, _))| *sigma != f64::INFINITY);
        let mut sample = Self { readings: Vec::new(), sigma: Vec::new(), senses: Vec::new() };
        for (at, (sigma, senses)) in used.step_by(stride) {
            sample.readings.push(all.reading(at));
            sample.sigma.push(sigma);
            sample.senses.push(senses);
        }
        sample
    }
}

/// What neither the fitted parameters nor the errors found so far explain.
struct Unexplained {
    /// The regressors of all joints.
    columns: DMatrix<f64>,
    /// Their norms before anything was taken out of them.
    norms: Vec<f64>,
    residuals: DVector<f64>,
    /// Sum of squares of all residuals that are left.
    squares: f64,
    freedom: f64,
}

/// An error of a joint with its F-test.
struct Tested {
    axis: usize,
    error: JointError,
    ln_chance: f64,
    /// An orthonormal basis of its columns.
    basis: DMatrix<f64>,
    /// Sum of squares that it explains.
    explained: f64,
    reversal_rad: Option<f64>,
}

impl Unexplained {
    fn of(mut system: LinearSystem, kept: usize, freedom: f64) -> Self {
        let (factor, rhs) = (system.factor(), system.rhs());
        let size = AXES * COLUMNS;
        // Below the rows of the fitted parameters is what they do not explain.
        let residuals = rhs.rows(kept, size).into_owned();
        Self {
            norms: (0..size).map(|k| factor.column(kept + k).norm()).collect(),
            columns: factor.view((kept, kept), (size, size)).into_owned(),
            squares: residuals.norm_squared() + system.residual_sum(),
            residuals,
            freedom,
        }
    }

    /// The strongest error beyond chance that is not among those `found`.
    fn strongest(&self, found: &[JointEffect]) -> Option<Tested> {
        let tests = (2 * AXES) as f64;
        let errors = (1..=AXES).flat_map(|axis| [(axis, JointError::Angle), (axis, JointError::Reversal)]);
        errors
            .filter(|(axis, error)| !found.iter().any(|known| known.axis == *axis && known.error == *error))
            .filter_map(|(axis, error)| self.test(axis, error))
            .filter(|tested| tested.ln_chance < (CHANCE / tests).ln())
            .min_by(|a, b| a.ln_chance.total_cmp(&b.ln_chance))
    }

    fn test(&self, axis: usize, error: JointError) -> Option<Tested> {
        let first = (axis - 1) * COLUMNS;
        // Where the sense goes with the angle, as on a circle driven once, the angle explains it.
        let (given, own) = match error {
            JointError::Angle => (0, 4),
            JointError::Reversal => (4, 5),
        };
        let mut basis = Orthonormal::default();
        let mut taken: Vec<usize> = Vec::new();
        let mut passed = 0;
        for k in first..first + own {
            // What the fit or an error found before has taken up says nothing any more.
            if basis.push(self.columns.column(k).into_owned(), 1e-3 * self.norms[k]) {
                if k < first + given {
                    passed += 1;
                } else {
                    taken.push(k);
                }
            }
        }
        if taken.is_empty() {
            return None;
        }
        let basis = basis.columns_from(passed);
        let shares = basis.tr_mul(&self.residuals);
        let explained = shares.norm_squared();
        let (p, other) = (basis.ncols() as f64, self.freedom - basis.ncols() as f64);
        let f = explained / p / ((self.squares - explained).max(0.0) / other);
        let solved = basis.tr_mul(&self.columns.select_columns(&taken)).solve_upper_triangular(&shares)?;
        // A reversal error moves the joint by half of it to either side.
        let reversal_rad = (error == JointError::Reversal).then(|| 2.0 * solved.norm());
        Some(Tested { axis, error, ln_chance: ln_f_tail(f, p, other), basis, explained, reversal_rad })
    }

    fn take_out(&mut self, tested: &Tested) {
        let basis = &tested.basis;
        self.residuals -= basis * basis.tr_mul(&self.residuals);
        self.columns -= basis * basis.tr_mul(&self.columns);
        self.squares -= tested.explained;
        self.freedom -= basis.ncols() as f64;
    }
}

impl Tested {
    /// In mm of the lengths: `mm` is a standard deviation of them over the root of their number.
    fn effect(&self, mm: f64) -> JointEffect {
        JointEffect {
            axis: self.axis,
            error: self.error,
            rms_mm: self.explained.sqrt() * mm,
            play_rad: self.reversal_rad,
            chance: self.ln_chance.exp(),
            z: normal_deviate(self.ln_chance),
        }
    }
}
