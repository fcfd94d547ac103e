//! The linearised least-squares problem of lengths at a model. Only this module forms design rows.
//!
//! A design row has the derivatives of a length by the parameters; its right-hand side is measured minus predicted. Both
//! are divided by the standard deviation of the length. Rows are formed piece by piece on all cores and folded into a
//! triangle, so that memory does not grow with their number.

use nalgebra::DMatrix;

use crate::math::Triangle;
use crate::measurement::{ColumnSelection, LengthModel, MeasurementPieces, PreparedMeasurement};
use crate::robot::{LengthRow, ParamId};

pub(super) struct WhitenedRow<'a> {
    /// Index among all lengths.
    pub(super) place: usize,
    pub(super) reading: &'a PreparedMeasurement,
    /// 1 / standard deviation; 0 for an excluded length.
    pub(super) weight: f64,
    /// Derivatives by all parameters of the model, mm per unit.
    pub(super) derivatives: &'a LengthRow,
    /// Derivatives by the selected parameters, in standard deviations of the length, followed by the further columns.
    pub(super) values: &'a mut [f64],
    /// Measured minus predicted, in standard deviations.
    pub(super) residual: f64,
}

/// The rows of some parameters at a model, with room for `further` columns after them.
pub(super) struct Rows<'a> {
    pub(super) model: &'a LengthModel,
    pub(super) ids: &'a [ParamId],
    pub(super) further: usize,
}

impl Rows<'_> {
    /// Accumulates the rows of each piece in a value that `start` makes. Returns the values of the pieces, in order.
    pub(super) fn fold<L: MeasurementPieces + ?Sized, T: Send>(
        &self,
        lengths: &L,
        start: impl Fn() -> T + Sync,
        each: impl Fn(&mut T, WhitenedRow<'_>) + Sync,
    ) -> Vec<T> {
        let selection = ColumnSelection::new(self.ids);
        let prepared = self.model.prepare();
        lengths.in_pieces(|first, readings, sigma| {
            let mut accumulated = start();
            let mut values = vec![0.0; self.ids.len() + self.further];
            let mut derivatives = LengthRow::default();
            for (at, reading) in readings.iter().enumerate() {
                let weight = sigma.get(at).map_or(1.0, |sigma| sigma.recip());
                prepared.row_into(reading, &selection, &mut derivatives);
                selection.pick(&derivatives, &mut values);
                values[..self.ids.len()].iter_mut().for_each(|value| *value *= weight);
                let residual = (reading.length_mm - derivatives.length) * weight;
                let (place, derivatives, values) = (first + at, &derivatives, &mut values);
                each(&mut accumulated, WhitenedRow { place, reading, weight, derivatives, values, residual });
            }
            accumulated
        })
    }
}

/// The rows of `lengths` by `ids` at `model`: each solution is a step of the parameters.
pub fn linear_system<L: MeasurementPieces + ?Sized>(
    model: &LengthModel,
    lengths: &L,
    ids: &[ParamId],
) -> Triangle {
    let triangles = Rows { model, ids, further: 0 }.fold(
        lengths,
        || Triangle::new(ids.len()),
        |triangle, row| triangle.push(row.values, row.residual),
    );
    Triangle::merged(triangles, ids.len())
}

/// The triangular factor of the rows of `lengths` by `ids` at `model`.
pub fn factor<L: MeasurementPieces + ?Sized>(
    model: &LengthModel,
    lengths: &L,
    ids: &[ParamId],
) -> DMatrix<f64> {
    linear_system(model, lengths, ids).factor()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::BaseBall;
    use crate::robot::{BallId, BarId, Joint, Robot};
    use nalgebra::{DVector, Vector3};

    fn model() -> LengthModel {
        let geometry = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry;
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
    fn rows_are_derivatives_over_sigma() {
        let (model, readings) = (model(), readings(40));
        let ids = [ParamId::Theta(Joint::J2), ParamId::A(Joint::J2)];
        let sigma = vec![0.5; readings.len()];
        let mut system = linear_system(&model, &(readings.as_slice(), sigma.as_slice()), &ids);
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
    fn an_excluded_length_has_no_effect() {
        let (model, mut readings) = (model(), readings(40));
        let ids = [ParamId::Theta(Joint::J2), ParamId::A(Joint::J2)];
        let all = vec![1.0; readings.len()];
        let expected = linear_system(&model, &(readings.as_slice(), all.as_slice()), &ids).residual_sum();
        readings.push(PreparedMeasurement { length_mm: 9000.0, ..readings[3] });
        let sigma = [all.as_slice(), &[f64::INFINITY]].concat();
        let found = linear_system(&model, &(readings.as_slice(), sigma.as_slice()), &ids).residual_sum();
        assert!((found / expected - 1.0).abs() < 1e-12);
    }

    /// The right-hand side is measured minus predicted: a bar that is 0.08 mm longer asks for an offset of 0.08 mm.
    #[test]
    fn step_is_towards_the_measured_length() {
        let model = model();
        let mut readings = readings(10);
        let prepared = model.prepare();
        readings.iter_mut().for_each(|reading| reading.length_mm = prepared.length(reading) + 0.08);
        let sigma = vec![0.5; readings.len()];
        let ids = [ParamId::BarOffset(BarId::FIRST)];
        let mut system = linear_system(&model, &(readings.as_slice(), sigma.as_slice()), &ids);
        assert!((system.solve().unwrap()[0] - 0.08).abs() < 1e-9);
        // Ten lengths of 0.5 mm: the information is 10 / 0.25.
        assert!((system.factor()[(0, 0)].abs() - 40f64.sqrt()).abs() < 1e-9);
    }
}
