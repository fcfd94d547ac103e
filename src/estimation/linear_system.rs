//! The linear system of lengths at a model: the only code that forms their rows.
//!
//! A row is the derivative of a length by the parameters, beside it what is measured minus what the model predicts, both
//! over the length's standard deviation. Rows are formed piece by piece on all cores and folded into one triangle, so
//! that memory does not grow with their number.

use nalgebra::{DMatrix, DVector};

use super::pose_rows::{LengthNoise, PoseRows};
use super::prior::PriorRows;
use crate::math::Triangle;
use crate::measurement::{LengthModel, MeasurementPieces, PreparedMeasurement, Selection};
use crate::robot::{LengthRow, ParamId};

/// One row.
pub(super) struct WhitenedRow<'a> {
    /// Its place among all lengths.
    pub(super) place: usize,
    pub(super) reading: &'a PreparedMeasurement,
    /// 1 / standard deviation; 0 for a length that is left out.
    pub(super) weight: f64,
    /// By all parameters of the model, mm per unit.
    pub(super) derivatives: &'a LengthRow,
    /// By the parameters chosen, in standard deviations; behind them room for the further columns.
    pub(super) values: &'a mut [f64],
    /// Measured minus predicted, in standard deviations.
    pub(super) residual: f64,
}

/// The rows of some parameters at a model, with room for `further` columns behind them.
pub(super) struct Rows<'a> {
    pub(super) model: &'a LengthModel,
    pub(super) ids: &'a [ParamId],
    pub(super) further: usize,
}

impl Rows<'_> {
    /// Gives each row of a piece to `each` beside what `start` makes for the piece; what became of the pieces, in order.
    pub(super) fn fold<L: MeasurementPieces + ?Sized, T: Send>(
        &self,
        lengths: &L,
        start: impl Fn() -> T + Sync,
        each: impl Fn(&mut T, WhitenedRow<'_>) + Sync,
    ) -> Vec<T> {
        let selection = Selection::new(self.ids);
        let prepared = self.model.prepare();
        lengths.in_pieces(|first, readings, sigma| {
            let mut made = start();
            let mut values = vec![0.0; self.ids.len() + self.further];
            let mut derivatives = LengthRow::default();
            for (at, reading) in readings.iter().enumerate() {
                let weight = sigma.get(at).map_or(1.0, |sigma| sigma.recip());
                prepared.row_into(reading, &mut derivatives);
                selection.pick(&derivatives, &mut values);
                values[..self.ids.len()].iter_mut().for_each(|value| *value *= weight);
                let residual = (reading.length_mm - derivatives.length) * weight;
                let (place, derivatives) = (first + at, &derivatives);
                each(
                    &mut made,
                    WhitenedRow { place, reading, weight, derivatives, values: &mut values, residual },
                );
            }
            made
        })
    }
}

/// All rows, folded.
#[derive(Clone, Debug)]
pub struct LinearSystem {
    unknowns: usize,
    triangle: Triangle,
}

impl LinearSystem {
    /// Of `lengths` by `ids` at `model`.
    pub fn at<L: MeasurementPieces + ?Sized>(model: &LengthModel, lengths: &L, ids: &[ParamId]) -> Self {
        let rows = Rows { model, ids, further: 0 };
        let triangles = rows.fold(
            lengths,
            || Triangle::new(ids.len()),
            |triangle, row| triangle.push(row.values, row.residual),
        );
        Self::of(triangles, ids.len())
    }

    /// Of lengths by `ids`, then by the coefficients of the joints' errors, whitened pose by pose. `None` where the noise has
    /// no inverse.
    pub(super) fn by_pose(
        model: &LengthModel,
        readings: &[PreparedMeasurement],
        noise: LengthNoise<'_>,
        ids: &[ParamId],
    ) -> Option<Self> {
        let unit = vec![1.0; readings.len()];
        let lines = PoseRows::at(model, &(readings, unit.as_slice()), ids);
        let unknowns = lines.values.ncols();
        let mut whole = lines.values.clone().insert_column(unknowns, 0.0);
        whole.set_column(unknowns, &lines.residual);
        lines.whiten(&mut whole, &lines.noise(&noise, model))?;
        let mut triangle = Triangle::new(unknowns);
        for row in whole.row_iter() {
            let values: Vec<f64> = row.iter().copied().collect();
            triangle.push(&values[..unknowns], values[unknowns]);
        }
        Some(Self { unknowns, triangle })
    }

    /// Of the triangles of pieces.
    pub(super) fn of(triangles: Vec<Triangle>, unknowns: usize) -> Self {
        Self { unknowns, triangle: Triangle::merged(triangles, unknowns) }
    }

    /// Adds the prior's equations about `model`, where the rows were formed; the sum of their squares.
    pub(super) fn add_prior(&mut self, prior: &PriorRows, model: &LengthModel, ids: &[ParamId]) -> f64 {
        let wrong = prior.deviates(model, ids);
        let mut values = vec![0.0; self.unknowns];
        for (row, wrong) in prior.matrix().row_iter().zip(&wrong) {
            values.iter_mut().zip(row.iter()).for_each(|(value, own)| *value = *own);
            let mut nonzero = (0..values.len()).filter(|k| values[*k] != 0.0);
            match (nonzero.next(), nonzero.next()) {
                (Some(single), None) => self.triangle.push_single(single, values[single], -wrong),
                _ => self.triangle.push(&values, -wrong),
            }
        }
        wrong.norm_squared()
    }

    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// The triangular factor of the rows: it has their Gram matrix.
    pub fn factor(&mut self) -> DMatrix<f64> {
        self.triangle.factor()
    }

    /// The residuals in the coordinates of the factor.
    pub fn rhs(&mut self) -> DVector<f64> {
        self.triangle.rhs()
    }

    /// The sum of squares that no step of the parameters removes.
    pub fn residual_sum(&mut self) -> f64 {
        self.triangle.residual_sum()
    }

    /// The step that makes the sum of squares least, damped by `damping` times the squares of `scale`; `None` where it is
    /// not determined.
    pub(super) fn damped_step(&self, scale: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
        let mut damped = self.triangle.clone();
        for (unknown, scale) in scale.iter().enumerate() {
            damped.push_single(unknown, damping.sqrt() * scale, 0.0);
        }
        damped.solve()
    }
}

/// The triangular factor of the rows of `lengths` by `ids` at `model`.
pub fn factor<L: MeasurementPieces + ?Sized>(
    model: &LengthModel,
    lengths: &L,
    ids: &[ParamId],
) -> DMatrix<f64> {
    LinearSystem::at(model, lengths, ids).factor()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::BaseBall;
    use crate::robot::{BallId, Joint, Robot};
    use nalgebra::Vector3;

    fn model() -> LengthModel {
        let geometry = Robot::by_name("kr60ha").unwrap().unwrap().geometry;
        LengthModel::new(
            geometry,
            &[BaseBall { id: BallId::FIRST, position: Vector3::new(1300.0, 0.0, 800.0) }],
        )
    }

    fn readings(count: usize) -> Vec<PreparedMeasurement> {
        let axes = |at: usize| std::array::from_fn(|axis| 0.3 + ((at * 7 + axis * 3) as f64 * 12.9898).sin());
        (0..count).map(|at| PreparedMeasurement::new(axes(at), BallId::FIRST, 300.0)).collect()
    }

    #[test]
    fn a_row_is_the_derivative_and_the_residual_over_sigma() {
        let (model, readings) = (model(), readings(40));
        let ids = [ParamId::Theta(Joint::J2), ParamId::A(Joint::J2)];
        let sigma = vec![0.5; readings.len()];
        let mut system = LinearSystem::at(&model, &(readings.as_slice(), sigma.as_slice()), &ids);
        let step = 1e-4;
        let mut gram = DMatrix::<f64>::zeros(2, 2);
        for reading in &readings {
            let derivative = ids.map(|id| {
                let mut moved = model.clone();
                moved.shift(id, step);
                (moved.prepare().length(reading) - model.prepare().length(reading)) / step / 0.5
            });
            gram += DVector::from_row_slice(&derivative) * DVector::from_row_slice(&derivative).transpose();
        }
        let factor = system.factor();
        assert!((factor.tr_mul(&factor) - &gram).norm() < 1e-3 * gram.norm());
    }

    #[test]
    fn a_length_left_out_counts_for_nothing() {
        let (model, mut readings) = (model(), readings(40));
        let ids = [ParamId::Theta(Joint::J2), ParamId::A(Joint::J2)];
        let all = vec![1.0; readings.len()];
        let expected = LinearSystem::at(&model, &(readings.as_slice(), all.as_slice()), &ids).residual_sum();
        readings.push(PreparedMeasurement { length_mm: 9000.0, ..readings[3] });
        let sigma = [all.as_slice(), &[f64::INFINITY]].concat();
        let found = LinearSystem::at(&model, &(readings.as_slice(), sigma.as_slice()), &ids).residual_sum();
        assert!((found / expected - 1.0).abs() < 1e-12);
    }
}
