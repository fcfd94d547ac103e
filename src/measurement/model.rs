//! The whole measurement: robot, tool ball, base balls and bar, as one function of the parameters.

use nalgebra::Vector3;

use super::{BaseBall, Measurement};
use crate::robot::{AXES, Approach, At, BallId, BarId, Chain, Geometry, JointSinCos, LengthRow, ParamId};

/// Everything that a length depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct LengthModel {
    /// The robot and its tool ball.
    pub geometry: Geometry,
    /// Base balls in the robot base, mm, by [`BallId::index`].
    pub balls: Vec<Vector3<f64>>,
    /// Length offset of each bar, mm, by [`BarId::index`]; one that is not there is exact.
    pub bar_offsets: Vec<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreparedMeasurement {
    /// The controller's axis angles, rad.
    pub axes: [f64; AXES],
    pub sin_cos: JointSinCos,
    pub approach: Approach,
    pub ball: BallId,
    pub bar: BarId,
    /// Distance between the ball centres.
    pub length_mm: f64,
}

impl PreparedMeasurement {
    /// At axis angles (rad), with the first bar.
    pub fn new(axes: [f64; AXES], ball: BallId, length_mm: f64) -> Self {
        let sin_cos = JointSinCos::of(&axes);
        Self { axes, sin_cos, approach: Approach::default(), ball, bar: BarId::FIRST, length_mm }
    }

    fn at(&self) -> At<'_> {
        At { axes: &self.axes, sin_cos: &self.sin_cos, approach: self.approach }
    }
}

impl From<&Measurement> for PreparedMeasurement {
    fn from(measurement: &Measurement) -> Self {
        let &Measurement { ball, bar, length_mm, approach, .. } = measurement;
        Self { bar, approach, ..Self::new(measurement.axes.radians(), ball, length_mm) }
    }
}

/// A model prepared for many measurements.
#[derive(Clone, Debug)]
pub struct PreparedModel<'a> {
    model: &'a LengthModel,
    chain: Chain<'a>,
}

impl PreparedModel<'_> {
    /// The length that the model predicts, mm; not a number from a ball that it does not have.
    #[inline]
    pub fn length(&self, measurement: &PreparedMeasurement) -> f64 {
        let ball = self.chain.ball(&measurement.at());
        (ball - self.model.ball(measurement.ball)).norm() + self.model.bar_offset(measurement.bar)
    }

    /// The length and its derivatives; not a number from a ball that the model does not have.
    pub fn row(&self, measurement: &PreparedMeasurement) -> LengthRow {
        let mut row = LengthRow::default();
        self.row_into(measurement, &mut row);
        row
    }

    /// The same, into a row that is new or was filled by this model before: what a solver asks for a million times.
    #[inline]
    pub fn row_into(&self, measurement: &PreparedMeasurement, row: &mut LengthRow) {
        let ball = self.model.ball(measurement.ball);
        let offset = self.model.bar_offset(measurement.bar);
        self.chain.row(&measurement.at(), &ball, offset, row);
        (row.ball, row.bar) = (measurement.ball, measurement.bar);
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
    From(BallId),
    With(BarId),
}

impl Selection {
    /// For these parameters, in this order.
    pub fn new(ids: &[ParamId]) -> Self {
        let column = |id: &ParamId| {
            let rows = match id {
                ParamId::Ball(ball, _) => Rows::From(*ball),
                ParamId::BarOffset(bar) => Rows::With(*bar),
                _ => Rows::All,
            };
            (id.column(), rows)
        };
        Self { columns: ids.iter().map(column).collect() }
    }

    /// Writes the chosen derivatives of a row.
    #[inline]
    pub fn pick(&self, row: &LengthRow, out: &mut [f64]) {
        for ((place, rows), value) in self.columns.iter().zip(out) {
            let changes = match rows {
                Rows::All => true,
                Rows::From(ball) => *ball == row.ball,
                Rows::With(bar) => *bar == row.bar,
            };
            *value = if changes { row.columns()[*place] } else { 0.0 };
        }
    }
}

impl LengthModel {
    /// With the base balls in the order of their numbers, bars exact.
    pub fn new(geometry: Geometry, balls: &[BaseBall]) -> Self {
        Self { geometry, balls: balls.iter().map(|ball| ball.position).collect(), bar_offsets: vec![] }
    }

    pub fn prepare(&self) -> PreparedModel<'_> {
        PreparedModel { model: self, chain: Chain::new(&self.geometry) }
    }

    /// Where a ball is, mm; not a number of one that is not there.
    #[inline]
    fn ball(&self, ball: BallId) -> Vector3<f64> {
        self.balls.get(ball.index()).copied().unwrap_or(Vector3::repeat(f64::NAN))
    }

    #[inline]
    pub fn bar_offset(&self, bar: BarId) -> f64 {
        self.bar_offsets.get(bar.index()).copied().unwrap_or(0.0)
    }

    /// The value of a parameter in its unit; not a number of a ball that is not there.
    pub fn value(&self, id: ParamId) -> f64 {
        match id {
            ParamId::Ball(ball, coordinate) => self.ball(ball)[coordinate.index()],
            ParamId::BarOffset(bar) => self.bar_offset(bar),
            _ => self.geometry.value(id).unwrap_or(f64::NAN),
        }
    }

    /// Adds `step` to a parameter; a ball that is not there stays so.
    pub fn shift(&mut self, id: ParamId, step: f64) {
        let value = match id {
            ParamId::Ball(ball, coordinate) => {
                self.balls.get_mut(ball.index()).map(|ball| &mut ball[coordinate.index()])
            }
            ParamId::BarOffset(bar) => {
                if self.bar_offsets.len() <= bar.index() {
                    self.bar_offsets.resize(bar.index() + 1, 0.0);
                }
                self.bar_offsets.get_mut(bar.index())
            }
            _ => self.geometry.value_mut(id),
        };
        if let Some(value) = value {
            *value += step;
        }
    }
}
