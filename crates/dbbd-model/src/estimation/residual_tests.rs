//! Tests of the residuals for errors of single joints that the model lacks: an error periodic in the joint angle, and reversal
//! error.
//!
//! An error e of joint j changes a length by its derivative by theta_j times e. The residuals are regressed on that derivative
//! times cos A, sin A, cos 2A, sin 2A (transmission error, sag; A is the joint's own angle) and times the sense in which the
//! joint came to the pose (reversal error; only the part of the sense that the other four do not explain). The columns of the
//! fitted parameters are projected out of both. Each of the twelve errors has an F-test at 0.001 / 12 (Bonferroni). The
//! strongest is projected out before the next is tested. Residuals are truncated at three robust standard deviations.

use nalgebra::{DMatrix, DVector};

use super::lengths::Weighted;
use super::linear_system::Rows;
use super::result::{JointEffect, JointError};
use super::solver::robust_scale;
use crate::math::distributions::{ln_f_tail, normal_deviate};
use crate::math::{OrthonormalBasis, Triangle};
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::{AXES, Approach, Coupling, Joint, ParamId};

/// Probability of any finding for a robot without such errors.
const LEVEL: f64 = 1e-3;
/// At most so many measurements are used, evenly spread.
const MOST: usize = 4096;
/// Residuals below this are rounding, mm.
const ROUNDING_MM: f64 = 1e-7;
/// Regressors of a joint: four of its angle, one of its sense.
const COLUMNS: usize = 5;

/// The sense in which each axis came to each pose from the pose before (axis angles, rad): -1, 0 (not known) or 1. An axis
/// that did not move keeps its sense.
pub fn senses(axes: impl IntoIterator<Item = [f64; AXES]>) -> impl Iterator<Item = [i8; AXES]> {
    Approach::along(axes).map(|approach| approach.senses())
}

/// The significant errors in the residuals of a fit of `kept` to `lengths`, strongest first.
pub(super) fn joint_effects(model: &LengthModel, lengths: &Weighted, kept: &[ParamId]) -> Vec<JointEffect> {
    let Sample { readings, sigma, senses } = Sample::of(lengths, &model.geometry.coupling);
    let prepared = model.prepare();
    let raw: Vec<f64> = readings.iter().map(|reading| prepared.residual(reading)).collect();
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
    let mut unexplained = Unexplained::of(Triangle::merged(triangles, unknowns), kept.len(), freedom);
    let mut effects: Vec<JointEffect> = Vec::new();
    while let Some(strongest) = unexplained.strongest(&effects) {
        unexplained.project_out(&strongest);
        effects.push(JointEffect {
            axis: strongest.axis,
            error: strongest.error,
            rms_mm: strongest.explained.sqrt() * (sigma_mm / count.sqrt()),
            play_rad: strongest.reversal_rad,
            chance: strongest.ln_chance.exp(),
            z: normal_deviate(strongest.ln_chance),
        });
    }
    effects
}

/// The tested lengths, with the sense in which each joint came to the pose.
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

/// Regressors and residuals, orthogonal to the fitted parameters and the errors found so far.
struct Unexplained {
    /// The regressors of all joints.
    columns: DMatrix<f64>,
    /// Their norms before any projection.
    norms: Vec<f64>,
    residuals: DVector<f64>,
    /// Sum of squares of the whole residual.
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
    fn of(mut system: Triangle, kept: usize, freedom: f64) -> Self {
        let (factor, rhs) = (system.factor(), system.rhs());
        let size = AXES * COLUMNS;
        // The rows below those of the fitted parameters are orthogonal to them.
        let residuals = rhs.rows(kept, size).into_owned();
        Self {
            norms: (0..size).map(|k| factor.column(kept + k).norm()).collect(),
            columns: factor.view((kept, kept), (size, size)).into_owned(),
            squares: residuals.norm_squared() + system.residual_sum(),
            residuals,
            freedom,
        }
    }

    /// The strongest significant error that is not among the `known` ones.
    fn strongest(&self, known: &[JointEffect]) -> Option<Tested> {
        let tests = (2 * AXES) as f64;
        let errors = (1..=AXES).flat_map(|axis| [(axis, JointError::Angle), (axis, JointError::Reversal)]);
        errors
            .filter(|error| !known.iter().any(|known| (known.axis, known.error) == *error))
            .filter_map(|(axis, error)| self.test(axis, error))
            .filter(|tested| tested.ln_chance < (LEVEL / tests).ln())
            .min_by(|a, b| a.ln_chance.total_cmp(&b.ln_chance))
    }

    fn test(&self, axis: usize, error: JointError) -> Option<Tested> {
        let first = (axis - 1) * COLUMNS;
        // Where the sense is a function of the angle, as on a circle driven once, the angle explains it.
        let (nuisance, end) = match error {
            JointError::Angle => (first, first + 4),
            JointError::Reversal => (first + 4, first + 5),
        };
        let mut basis = OrthonormalBasis::default();
        // A column that the fit or an earlier error explains is skipped.
        let mut independent: Vec<usize> = (first..end)
            .filter(|&k| basis.push(self.columns.column(k).into_owned(), 1e-3 * self.norms[k]))
            .collect();
        let taken = independent.split_off(independent.partition_point(|k| *k < nuisance));
        if taken.is_empty() {
            return None;
        }
        let basis = basis.columns_from(independent.len());
        let shares = basis.tr_mul(&self.residuals);
        let explained = shares.norm_squared();
        let (p, other) = (basis.ncols() as f64, self.freedom - basis.ncols() as f64);
        let f = explained / p / ((self.squares - explained).max(0.0) / other);
        let solved = basis.tr_mul(&self.columns.select_columns(&taken)).solve_upper_triangular(&shares)?;
        // The reversal error is the whole difference between the two senses.
        let reversal_rad = (error == JointError::Reversal).then(|| 2.0 * solved.norm());
        Some(Tested { axis, error, ln_chance: ln_f_tail(f, p, other), basis, explained, reversal_rad })
    }

    fn project_out(&mut self, tested: &Tested) {
        let basis = &tested.basis;
        self.residuals -= basis * basis.tr_mul(&self.residuals);
        self.columns -= basis * basis.tr_mul(&self.columns);
        self.squares -= tested.explained;
        self.freedom -= basis.ncols() as f64;
    }
}
