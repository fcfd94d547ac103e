//! The whole measurement: robot, targets, base balls, bars and tracker, as one function of the parameters.

use nalgebra::Vector3;

use super::{BaseBall, Measurement, Measurements, Position, Tracker};
use crate::robot::{
    AXES, Approach, At, BallId, BarId, Chain, Datum, Geometry, JointSinCos, LengthRow, ParamId, Plane,
    TargetId,
};

/// The place of what is not there.
const NOWHERE: Vector3<f64> = Vector3::new(f64::NAN, f64::NAN, f64::NAN);

/// Everything that a length depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct LengthModel {
    /// The robot and its tool ball.
    pub geometry: Geometry,
    /// Base balls in the robot base, mm, by [`BallId::index`].
    pub balls: Vec<Vector3<f64>>,
    /// Length offset of each bar, mm, by [`BarId::index`]; one that is not there is exact.
    pub bar_offsets: Vec<f64>,
    /// Further targets on the tool in the flange frame, mm, from the second.
    pub targets: Vec<Vector3<f64>>,
    /// Where positions were measured.
    pub tracker: Option<Tracker>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreparedMeasurement {
    /// The controller's axis angles, rad.
    pub axes: [f64; AXES],
    pub sin_cos: JointSinCos,
    pub approach: Approach,
    pub datum: Datum,
    pub target: TargetId,
    /// Distance between the ball centres, or from a plane.
    pub length_mm: f64,
}

impl PreparedMeasurement {
    /// Of the tool ball at axis angles (rad), with the first bar.
    pub fn new(axes: [f64; AXES], ball: BallId, length_mm: f64) -> Self {
        let sin_cos = JointSinCos::of(&axes);
        let (datum, target) = (Datum::Ball(ball, BarId::FIRST), TargetId::FIRST);
        Self { axes, sin_cos, approach: Approach::default(), datum, target, length_mm }
    }
}

impl From<&Measurement> for PreparedMeasurement {
    fn from(measurement: &Measurement) -> Self {
        let &Measurement { datum, target, length_mm, approach, .. } = measurement;
        Self { datum, target, approach, ..Self::new(measurement.axes.radians(), BallId::FIRST, length_mm) }
    }
}

/// A model prepared for many measurements.
#[derive(Clone, Debug)]
pub struct PreparedModel<'a> {
    model: &'a LengthModel,
    chain: Chain<'a>,
    planes: [Plane; 3],
}

impl PreparedModel<'_> {
    /// The length that the model predicts, mm; not a number from or to what it does not have.
    #[inline]
    pub fn length(&self, measurement: &PreparedMeasurement) -> f64 {
        let target = self.chain.ball(&self.at(measurement));
        match measurement.datum {
            Datum::Ball(ball, bar) => (target - self.model.ball(ball)).norm() + self.model.bar_offset(bar),
            Datum::Plane(coordinate) => {
                let Plane { origin, normal, .. } = &self.planes[coordinate.index()];
                normal.dot(&(target - origin))
            }
        }
    }

    fn at<'b>(&'b self, measurement: &'b PreparedMeasurement) -> At<'b> {
        let PreparedMeasurement { axes, sin_cos, approach, target, .. } = measurement;
        At { axes, sin_cos, approach: *approach, target: self.model.target(*target) }
    }

    /// The length and its derivatives; not a number from or to what the model does not have.
    pub fn row(&self, measurement: &PreparedMeasurement) -> LengthRow {
        let mut row = LengthRow::default();
        self.row_into(measurement, &mut row);
        row
    }

    /// The same, into a row that is new or was filled by this model before: what a solver asks for a million times.
    #[inline]
    pub fn row_into(&self, measurement: &PreparedMeasurement, row: &mut LengthRow) {
        let at = self.at(measurement);
        match measurement.datum {
            Datum::Ball(ball, bar) => {
                self.chain.row(&at, &self.model.ball(ball), self.model.bar_offset(bar), row);
            }
            Datum::Plane(coordinate) => self.chain.plane_row(&at, &self.planes[coordinate.index()], row),
        }
        (row.datum, row.target) = (measurement.datum, measurement.target);
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
    To(TargetId),
    Tracked,
}

impl Selection {
    /// For these parameters, in this order.
    pub fn new(ids: &[ParamId]) -> Self {
        let column = |id: &ParamId| {
            let rows = match id {
                ParamId::Ball(ball, _) => Rows::From(*ball),
                ParamId::BarOffset(bar) => Rows::With(*bar),
                ParamId::Tool(_) => Rows::To(TargetId::FIRST),
                ParamId::Target(target, _) => Rows::To(*target),
                ParamId::Tracker(_) | ParamId::TrackerTurn(_) => Rows::Tracked,
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
                Rows::From(ball) => row.datum.ball() == Some(*ball),
                Rows::With(bar) => row.datum.bar() == Some(*bar),
                Rows::To(target) => row.target == *target,
                Rows::Tracked => row.datum.is_plane(),
            };
            *value = if changes { row.columns()[*place] } else { 0.0 };
        }
    }
}

impl LengthModel {
    /// With the base balls in the order of their numbers, bars exact, no target but the tool ball, no tracker.
    pub fn new(geometry: Geometry, balls: &[BaseBall]) -> Self {
        let balls = balls.iter().map(|ball| ball.position).collect();
        Self { geometry, balls, bar_offsets: vec![], targets: vec![], tracker: None }
    }

    /// Before any fit, bars exact: the tracker's frame where the tool ball of this geometry best follows the positions, and
    /// further targets where they then are on the tool in the mean, else at the tool ball.
    pub fn before(geometry: Geometry, balls: &[BaseBall], observations: &Measurements) -> Self {
        let positions: Vec<Position> = observations.positions().collect();
        let tracker = Tracker::located(&geometry, &positions);
        let on_tool = |target: TargetId| {
            let of_target = positions.iter().filter(|position| position.target == target);
            let on_tool = of_target.zip(tracker.iter().cycle()).map(|(position, tracker)| {
                let flange = geometry.flange(&position.axes);
                flange.rotation.transpose() * (tracker.in_base(&position.place) - flange.position)
            });
            let places: Vec<Vector3<f64>> = on_tool.collect();
            match places.len() {
                0 => geometry.tool,
                count => places.iter().sum::<Vector3<f64>>() / count as f64,
            }
        };
        let targets = (1..observations.targets()).map(|at| on_tool(TargetId::at(at))).collect();
        Self { targets, tracker, ..Self::new(geometry, balls) }
    }

    pub fn prepare(&self) -> PreparedModel<'_> {
        let nowhere = Tracker { origin: NOWHERE, turn: Vector3::zeros() };
        let planes = self.tracker.unwrap_or(nowhere).planes();
        PreparedModel { model: self, chain: Chain::new(&self.geometry), planes }
    }

    /// Where a ball is, mm; not a number of one that is not there.
    #[inline]
    fn ball(&self, ball: BallId) -> Vector3<f64> {
        self.balls.get(ball.index()).copied().unwrap_or(NOWHERE)
    }

    /// Where a target is in the flange frame, mm; not a number of one that is not there.
    #[inline]
    fn target(&self, target: TargetId) -> &Vector3<f64> {
        match target {
            TargetId::FIRST => &self.geometry.tool,
            further => self.targets.get(further.index() - 1).unwrap_or(&NOWHERE),
        }
    }

    #[inline]
    pub fn bar_offset(&self, bar: BarId) -> f64 {
        self.bar_offsets.get(bar.index()).copied().unwrap_or(0.0)
    }

    /// The value of a parameter in its unit; not a number of what is not there.
    pub fn value(&self, id: ParamId) -> f64 {
        match id {
            ParamId::Ball(ball, coordinate) => self.ball(ball)[coordinate.index()],
            ParamId::BarOffset(bar) => self.bar_offset(bar),
            ParamId::Target(target, coordinate) => self.target(target)[coordinate.index()],
            ParamId::Tracker(coordinate) => self.tracker.map_or(f64::NAN, |at| at.origin[coordinate.index()]),
            ParamId::TrackerTurn(coordinate) => {
                self.tracker.map_or(f64::NAN, |at| at.turn[coordinate.index()])
            }
            _ => self.geometry.value(id).unwrap_or(f64::NAN),
        }
    }

    /// Adds `step` to a parameter; what is not there stays so.
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
            ParamId::Target(target, coordinate) => {
                let further = target.index().checked_sub(1).and_then(|at| self.targets.get_mut(at));
                further.map(|target| &mut target[coordinate.index()])
            }
            ParamId::Tracker(coordinate) => {
                self.tracker.as_mut().map(|tracker| &mut tracker.origin[coordinate.index()])
            }
            ParamId::TrackerTurn(coordinate) => {
                self.tracker.as_mut().map(|tracker| &mut tracker.turn[coordinate.index()])
            }
            _ => self.geometry.value_mut(id),
        };
        if let Some(value) = value {
            *value += step;
        }
    }
}
