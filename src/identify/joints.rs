//! Do the residuals show what the model lacks at a joint: an error that returns with its angle, or play?
//!
//! An error e of joint j moves a length by its derivative by theta_j times e. So the residuals are regressed on that
//! derivative times cos A, sin A, cos 2A, sin 2A (a gear's error, sag) and times the sense in which the axis came to
//! its pose (play; of the sense only what those four do not explain counts), after all that the fitted parameters
//! explain has been taken out of both. Each of the twelve is judged by its F-test at 0.001 / 12 (Bonferroni), the
//! strongest first; what it explains is taken out before the next is judged. Residuals beyond three robust
//! deviations are brought in to there.

use nalgebra::{DMatrix, DVector};

use super::lengths::Weighted;
use super::result::{JointEffect, JointError};
use super::solver::robust_scale;
use crate::linalg::Triangle;
use crate::model::{AXES, LengthModel, LengthRow, ParamId, Reading, Selection};

/// Chance that a sound robot's residuals are accused of anything.
const CHANCE: f64 = 1e-3;
/// Readings that are looked at, evenly spread over a long run.
const MOST: usize = 4096;
/// Residuals below this are rounding, mm.
const ROUNDING_MM: f64 = 1e-7;
/// Regressors of a joint: four of its angle, one of its sense.
const COLUMNS: usize = 5;

/// For each pose (axis angles, rad) the sense in which each axis came to it, -1, 0 (not known) or 1: from the pose
/// before; an axis that stood still keeps its sense.
pub fn senses(axes: impl IntoIterator<Item = [f64; AXES]>) -> impl Iterator<Item = [i8; AXES]> {
    let mut sense = [0i8; AXES];
    let mut last: Option<[f64; AXES]> = None;
    axes.into_iter().map(move |axes| {
        if let Some(last) = last {
            for (axis, sense) in sense.iter_mut().enumerate() {
                let moved = axes[axis] - last[axis];
                if moved.abs() > 1e-9 {
                    *sense = if moved > 0.0 { 1 } else { -1 };
                }
            }
        }
        last = Some(axes);
        sense
    })
}

/// What the residuals of a fit of `kept` to `lengths` at `model` show beyond chance.
pub(super) fn effects(model: &LengthModel, lengths: &Weighted, kept: &[ParamId]) -> Vec<JointEffect> {
    let all = lengths.lengths();
    let stride = all.len().div_ceil(MOST).max(1);
    let senses = senses((0..all.len()).map(|at| all.axes(at)));
    let used = lengths.sigmas().zip(senses).enumerate().filter(|(_, (sigma, _))| *sigma != f64::INFINITY);
    let seen: Vec<(Reading, f64, [i8; AXES])> =
        used.step_by(stride).map(|(at, (sigma, senses))| (all.reading(at), sigma, senses)).collect();
    let prepared = model.prepare();
    let raw: Vec<f64> = seen.iter().map(|(reading, ..)| reading.length - prepared.length(reading)).collect();
    let scale = robust_scale(&raw);
    let freedom = seen.len() as f64 - kept.len() as f64;
    if scale < ROUNDING_MM || freedom <= (AXES * COLUMNS) as f64 {
        return Vec::new();
    }
    let selection = Selection::new(kept);
    let mut triangle = Triangle::new(kept.len() + AXES * COLUMNS);
    let mut row = vec![0.0; kept.len() + AXES * COLUMNS];
    for ((reading, sigma, senses), residual) in seen.iter().zip(&raw) {
        let derivatives = prepared.row(reading);
        selection.pick(&derivatives, reading.centre, &mut row);
        for axis in 0..AXES {
            let lever = derivatives.columns()[LengthRow::position(ParamId::Theta(axis + 1))];
            let [s, c] = reading.turns.0[axis];
            let sense = f64::from(senses[axis]);
            let own = [c, s, c * c - s * s, 2.0 * s * c, sense].map(|value| value * lever);
            row[kept.len() + axis * COLUMNS..][..COLUMNS].copy_from_slice(&own);
        }
        row.iter_mut().for_each(|value| *value /= sigma);
        triangle.push(&row, residual.clamp(-3.0 * scale, 3.0 * scale) / sigma);
    }
    let count = seen.len() as f64;
    let sigma_mm = (seen.iter().map(|(_, sigma, _)| sigma * sigma).sum::<f64>() / count).sqrt();
    let mut found = judge(&mut triangle, kept.len(), freedom);
    found.iter_mut().for_each(|effect| effect.rms_mm *= sigma_mm / count.sqrt());
    found
}

/// Names the errors, strongest first.
fn judge(triangle: &mut Triangle, kept: usize, mut freedom: f64) -> Vec<JointEffect> {
    let (factor, rhs) = (triangle.factor(), triangle.rhs());
    let size = AXES * COLUMNS;
    let norms: Vec<f64> = (0..size).map(|k| factor.column(kept + k).norm()).collect();
    // Below the fitted parameters' rows stands what they do not explain.
    let mut columns = factor.view((kept, kept), (size, size)).into_owned();
    let mut rest = rhs.rows(kept, size).into_owned();
    let mut left = rest.norm_squared() + triangle.residual_sum();
    let tests = (2 * AXES) as f64;
    let mut found: Vec<JointEffect> = Vec::new();
    while found.len() < 2 * AXES {
        let mut strongest: Option<(JointEffect, DMatrix<f64>, f64)> = None;
        for axis in 1..=AXES {
            for error in [JointError::Angle, JointError::Reversal] {
                if found.iter().any(|known| known.axis == axis && known.error == error) {
                    continue;
                }
                let Some((effect, basis, explained)) =
                    test(&columns, &norms, &rest, left, freedom, axis, error)
                else {
                    continue;
                };
                if effect.chance < CHANCE / tests
                    && strongest.as_ref().is_none_or(|(other, ..)| effect.z > other.z)
                {
                    strongest = Some((effect, basis, explained));
                }
            }
        }
        let Some((effect, basis, explained)) = strongest else { break };
        rest -= &basis * basis.tr_mul(&rest);
        columns -= &basis * basis.tr_mul(&columns);
        left -= explained;
        freedom -= basis.ncols() as f64;
        found.push(effect);
    }
    found
}

/// The F-test of one error of one joint (its `rms_mm` still in sigmas and summed), an orthonormal basis of its columns, and
/// what they explain.
fn test(
    columns: &DMatrix<f64>,
    norms: &[f64],
    rest: &DVector<f64>,
    left: f64,
    freedom: f64,
    axis: usize,
    error: JointError,
) -> Option<(JointEffect, DMatrix<f64>, f64)> {
    let first = (axis - 1) * COLUMNS;
    // Where the sense goes with the angle, as on a circle driven once, the angle has the word.
    let (given, own) = match error {
        JointError::Angle => (0, 4),
        JointError::Reversal => (4, 5),
    };
    let mut directions: Vec<DVector<f64>> = Vec::new();
    let mut taken: Vec<usize> = Vec::new();
    let mut passed = 0;
    for k in first..first + own {
        let mut column = columns.column(k).into_owned();
        for _ in 0..2 {
            for direction in &directions {
                column.axpy(-direction.dot(&column), direction, 1.0);
            }
        }
        // What the fit or an error found before has taken up says nothing any more.
        if column.norm() > 1e-3 * norms[k] {
            directions.push(column.normalize());
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
    let basis = DMatrix::from_columns(&directions[passed..]);
    let explained = basis.tr_mul(rest).norm_squared();
    let (p, other) = (basis.ncols() as f64, freedom - basis.ncols() as f64);
    let z = deviate(explained / p / ((left - explained).max(0.0) / other), p, other);
    let solved = basis.tr_mul(&columns.select_columns(&taken)).solve_upper_triangular(&basis.tr_mul(rest))?;
    // A play moves the joint by half of it to either side.
    let play_rad = (error == JointError::Reversal).then(|| 2.0 * solved.norm());
    let rms_mm = explained.sqrt();
    Some((JointEffect { axis, error, rms_mm, play_rad, chance: tail(z), z }, basis, explained))
}

/// The normal deviate of an F of `p` and `other` degrees of freedom: for one by Wallace (Ann. Math. Stat. 30, 1959), else
/// by Paulson (Ann. Math. Stat. 13, 1942).
fn deviate(f: f64, p: f64, other: f64) -> f64 {
    if p == 1.0 {
        return (other * (f / other).ln_1p()).sqrt() * (8.0 * other + 1.0) / (8.0 * other + 3.0);
    }
    let (a, b) = (2.0 / (9.0 * p), 2.0 / (9.0 * other));
    let root = f.cbrt();
    ((1.0 - b) * root - (1.0 - a)) / (b * root * root + a).sqrt()
}

/// The chance of a normal deviate beyond `z`, on either side: an upper bound by Mills' ratio, close where it is small.
fn tail(z: f64) -> f64 {
    if z < 1.0 { 1.0 } else { ((2.0 / std::f64::consts::PI).sqrt() / z * (-0.5 * z * z).exp()).min(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of F and of the normal deviate from SciPy 1.17 (`f.isf`, `norm.isf`; one numerator degree counts both
    /// sides). Paulson is off by 0.02 where chance is a thousandth.
    #[test]
    fn deviates_are_those_of_the_tables() {
        for (p, other, f, z) in [
            (4.0, 100.0, 2.462_615, 1.644_854),
            (4.0, 60.0, 5.306_702, 3.090_232),
            (1.0, 60.0, 4.001_191, 1.959_964),
            (1.0, 30.0, 13.293_014, 3.290_527),
        ] {
            let found = deviate(f, p, other);
            assert!((found - z).abs() < 0.03, "F({p}, {other}) = {f}: {found}, not {z}");
        }
    }
}
