//! The whole measurement: robot, tool ball, base balls and bar, as one function of the parameters.

use nalgebra::Vector3;

use super::{AXES, Centre, Chain, Geometry, LengthRow, Observation, ParamId, Turns};

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
    /// Their sines and cosines.
    pub turns: Turns,
    /// Base ball, from 0.
    pub centre: usize,
    /// Distance between the ball centres, mm.
    pub length: f64,
}

impl Reading {
    /// At axis angles (rad), from base ball `centre` (from 0), of a length in mm.
    pub fn new(axes: [f64; AXES], centre: usize, length: f64) -> Self {
        Self { axes, turns: Turns::of(&axes), centre, length }
    }
}

impl From<&Observation> for Reading {
    fn from(observation: &Observation) -> Self {
        Self::new(observation.axes(), observation.centre - 1, observation.length_mm)
    }
}

/// A model made ready for many readings.
#[derive(Clone, Debug)]
pub struct Prepared<'a> {
    model: &'a LengthModel,
    chain: Chain<'a>,
}

impl Prepared<'_> {
    /// The length that the model predicts for a reading, mm.
    #[inline]
    pub fn length(&self, reading: &Reading) -> f64 {
        let ball = self.chain.ball(&reading.axes, &reading.turns);
        (ball - self.model.centres[reading.centre]).norm() + self.model.bar_offset
    }

    /// The length and its derivatives for a reading.
    #[inline]
    pub fn row(&self, reading: &Reading) -> LengthRow {
        let centre = &self.model.centres[reading.centre];
        self.chain.row(&reading.axes, &reading.turns, centre, self.model.bar_offset)
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
    #[inline]
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

    /// Made ready for many readings.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared { model: self, chain: Chain::new(&self.geometry) }
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
