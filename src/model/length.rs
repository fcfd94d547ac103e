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
    /// Length offset of each bar, mm; bar k stands at k - 1, and one that is not there is exact.
    pub bar_offsets: Vec<f64>,
}

/// A length made ready for the solver: angles in rad, base ball and bar from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The controller's axis angles, rad.
    pub axes: [f64; AXES],
    /// Their sines and cosines.
    pub turns: Turns,
    /// Base ball, from 0.
    pub centre: usize,
    /// Bar, from 0.
    pub bar: usize,
    /// Distance between the ball centres, mm.
    pub length: f64,
}

impl Reading {
    /// At axis angles (rad), from base ball `centre` (from 0), of a length in mm, with the first bar.
    pub fn new(axes: [f64; AXES], centre: usize, length: f64) -> Self {
        Self { axes, turns: Turns::of(&axes), centre, bar: 0, length }
    }
}

impl From<&Observation> for Reading {
    fn from(observation: &Observation) -> Self {
        let reading = Self::new(observation.axes(), observation.centre - 1, observation.length_mm);
        Self { bar: observation.bar - 1, ..reading }
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
        (ball - self.model.centres[reading.centre]).norm() + self.model.bar_offset(reading.bar)
    }

    /// The length and its derivatives for a reading.
    pub fn row(&self, reading: &Reading) -> LengthRow {
        let mut row = LengthRow::default();
        self.row_into(reading, &mut row);
        row
    }

    /// The same, into a row that is new or was filled by this model before: what a solver asks for a million times.
    #[inline]
    pub fn row_into(&self, reading: &Reading, row: &mut LengthRow) {
        let centre = &self.model.centres[reading.centre];
        let offset = self.model.bar_offset(reading.bar);
        self.chain.row(&reading.axes, &reading.turns, centre, offset, row);
        row.bar = reading.bar;
    }
}

/// The columns of some parameters within a [`LengthRow`].
#[derive(Clone, Debug)]
pub struct Selection {
    /// Place in the row, and the rows for which the column is not zero.
    columns: Vec<(usize, Rows)>,
}

/// The rows that a parameter changes.
#[derive(Clone, Copy, Debug)]
enum Rows {
    All,
    /// Those from this base ball (from 0).
    Ball(usize),
    /// Those with this bar (from 0).
    Bar(usize),
}

impl Selection {
    /// For these parameters, in this order.
    pub fn new(ids: &[ParamId]) -> Self {
        let column = |id: &ParamId| {
            let rows = match id {
                ParamId::Centre(k, _) => Rows::Ball(k - 1),
                ParamId::BarOffset(k) => Rows::Bar(k - 1),
                _ => Rows::All,
            };
            (LengthRow::position(*id), rows)
        };
        Self { columns: ids.iter().map(column).collect() }
    }

    /// Writes the chosen derivatives of a row measured from base ball `centre` (from 0).
    #[inline]
    pub fn pick(&self, row: &LengthRow, centre: usize, out: &mut [f64]) {
        for ((place, rows), value) in self.columns.iter().zip(out) {
            let changes = match rows {
                Rows::All => true,
                Rows::Ball(ball) => *ball == centre,
                Rows::Bar(bar) => *bar == row.bar,
            };
            *value = if changes { row.columns()[*place] } else { 0.0 };
        }
    }
}

impl LengthModel {
    /// With the nominal robot and base balls at `centres` (in the order of their numbers), bars exact.
    pub fn new(geometry: Geometry, centres: &[Centre]) -> Self {
        Self {
            geometry,
            centres: centres.iter().map(|centre| centre.position).collect(),
            bar_offsets: vec![],
        }
    }

    /// Made ready for many readings.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared { model: self, chain: Chain::new(&self.geometry) }
    }

    /// The offset of a bar (from 0), mm.
    pub fn bar_offset(&self, bar: usize) -> f64 {
        self.bar_offsets.get(bar).copied().unwrap_or(0.0)
    }

    /// The value of a parameter, mm or rad (rad/(N m) of a compliance).
    pub fn value(&self, id: ParamId) -> f64 {
        match id {
            ParamId::Centre(k, axis) => self.centres[k - 1][axis],
            ParamId::BarOffset(k) => self.bar_offset(k - 1),
            _ => self.geometry.value(id).unwrap_or(0.0),
        }
    }

    /// Adds `step` to a parameter.
    pub fn shift(&mut self, id: ParamId, step: f64) {
        match id {
            ParamId::Centre(k, axis) => self.centres[k - 1][axis] += step,
            ParamId::BarOffset(k) => {
                if self.bar_offsets.len() < k {
                    self.bar_offsets.resize(k, 0.0);
                }
                self.bar_offsets[k - 1] += step;
            }
            _ => {
                if let Some(value) = self.geometry.value_mut(id) {
                    *value += step;
                }
            }
        }
    }
}
