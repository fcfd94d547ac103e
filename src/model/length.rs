//! The whole measurement: robot, tool ball, base balls and bar, as one function of the parameters.

use nalgebra::Vector3;

use super::{AXES, Centre, Geometry, LengthRow, Observation, ParamId};

/// Everything that a length depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct LengthModel {
    /// The robot and its tool ball.
    pub geometry: Geometry,
    /// Base balls in the robot base, mm; ball k stands at k - 1.
    pub centres: Vec<Vector3<f64>>,
    /// Length offset of the bar, mm.
    pub bar_offset: f64,
}

/// A length made ready for the solver: angles in rad, base ball from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The controller's axis angles, rad.
    pub axes: [f64; AXES],
    /// Base ball, from 0.
    pub centre: usize,
    /// Distance between the ball centres, mm.
    pub length: f64,
}

impl From<&Observation> for Reading {
    fn from(observation: &Observation) -> Self {
        Self { axes: observation.axes(), centre: observation.centre - 1, length: observation.length_mm }
    }
}

/// The columns of some parameters within a [`LengthRow`].
#[derive(Clone, Debug)]
pub struct Selection {
    /// Place in the row, and the only base ball (from 0) for which the column is not zero.
    columns: Vec<(usize, Option<usize>)>,
}

impl Selection {
    /// For these parameters, in this order.
    pub fn new(ids: &[ParamId]) -> Self {
        let column = |id: &ParamId| {
            let centre = if let ParamId::Centre(k, _) = id { Some(k - 1) } else { None };
            (LengthRow::position(*id), centre)
        };
        Self { columns: ids.iter().map(column).collect() }
    }

    /// Writes the chosen derivatives of a row measured from base ball `centre` (from 0).
    pub fn pick(&self, row: &LengthRow, centre: usize, out: &mut [f64]) {
        for ((place, only), value) in self.columns.iter().zip(out) {
            *value = if only.is_none_or(|k| k == centre) { row.columns()[*place] } else { 0.0 };
        }
    }
}

impl LengthModel {
    /// With the nominal robot and base balls at `centres` (in the order of their numbers), bar exact.
    pub fn new(geometry: Geometry, centres: &[Centre]) -> Self {
        Self { geometry, centres: centres.iter().map(|centre| centre.position).collect(), bar_offset: 0.0 }
    }

    /// The length that the model predicts for a reading, mm.
    pub fn length(&self, reading: &Reading) -> f64 {
        self.geometry.length(&reading.axes, &self.centres[reading.centre], self.bar_offset)
    }

    /// The length and its derivatives for a reading.
    pub fn row(&self, reading: &Reading) -> LengthRow {
        self.geometry.length_row(&reading.axes, &self.centres[reading.centre], self.bar_offset)
    }

    /// The value of a parameter, mm or rad (rad/(N m) of a compliance).
    pub fn value(&self, id: ParamId) -> f64 {
        match id {
            ParamId::Centre(k, axis) => self.centres[k - 1][axis],
            ParamId::BarOffset => self.bar_offset,
            _ => self.geometry.value(id).unwrap_or(0.0),
        }
    }

    /// Adds `step` to a parameter.
    pub fn shift(&mut self, id: ParamId, step: f64) {
        match id {
            ParamId::Centre(k, axis) => self.centres[k - 1][axis] += step,
            ParamId::BarOffset => self.bar_offset += step,
            _ => {
                if let Some(value) = self.geometry.value_mut(id) {
                    *value += step;
                }
            }
        }
    }
}
