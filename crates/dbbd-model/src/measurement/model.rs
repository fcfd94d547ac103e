//! The measurement model: the length or coordinate that a measurement gives, as a function of all parameters of robot,
//! targets, base balls, bars and tracker.

use nalgebra::Vector3;

use super::{BaseBall, MeasuredPosition, Measurement, Measurements, Tracker};
use crate::math::map_pieces;
use crate::robot::{
    AXES, Approach, AxesAtPose, BallId, BarId, Datum, Geometry, JointSinCos, KinematicChain, LengthRow,
    ParamId, TargetId, TrackerPlane,
};

/// The position of a ball, target or tracker that the model does not have.
const NOWHERE: Vector3<f64> = Vector3::new(f64::NAN, f64::NAN, f64::NAN);

#[derive(Clone, Debug, PartialEq)]
pub struct LengthModel {
    /// The robot and its tool ball.
    pub geometry: Geometry,
    /// Base balls in the robot base, mm, by [`BallId::index`].
    pub balls: Vec<Vector3<f64>>,
    /// Length offset of each bar, mm, by [`BarId::index`]; 0 for a bar beyond the end.
    pub bar_offsets: Vec<f64>,
    /// Targets on the tool from the second on (the first is the tool ball), in the flange frame, mm.
    pub targets: Vec<Vector3<f64>>,
    pub tracker: Option<Tracker>,
}

/// A measurement in the form in which the model evaluates it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreparedMeasurement {
    /// The controller's axis angles, rad.
    pub axes: [f64; AXES],
    pub sin_cos: JointSinCos,
    pub approach: Approach,
    pub datum: Datum,
    pub target: TargetId,
    /// Distance between the ball centres, or from a plane of the tracker's frame.
    pub length_mm: f64,
}

impl PreparedMeasurement {
    /// A length to the tool ball with the first bar; axis angles in rad.
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

/// Measurements that can be prepared one piece at a time, to save memory.
pub trait MeasurementPieces: Sync {
    /// Applies `work` to the index of the first measurement of each piece, to the piece, and to its standard deviations
    /// (mm). The slice of standard deviations is empty if all are 1, an excluded measurement has an infinite one. The results are
    /// in order.
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R>;
}

impl MeasurementPieces for [PreparedMeasurement] {
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R> {
        (self, &[][..]).in_pieces(work)
    }
}

impl MeasurementPieces for (&[PreparedMeasurement], &[f64]) {
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R> {
        let (measurements, sigma) = *self;
        map_pieces(measurements, |first, piece| {
            work(first, piece, sigma.get(first..first + piece.len()).unwrap_or(&[]))
        })
    }
}

/// A model with what can be computed once for many measurements.
#[derive(Clone, Debug)]
pub struct PreparedModel<'a> {
    model: &'a LengthModel,
    chain: KinematicChain<'a>,
    planes: [TrackerPlane; 3],
}

impl PreparedModel<'_> {
    /// Measured minus predicted, mm; NaN as [`Self::length`].
    #[inline]
    pub fn residual(&self, measurement: &PreparedMeasurement) -> f64 {
        measurement.length_mm - self.length(measurement)
    }

    /// The predicted length or coordinate, mm; NaN if the model lacks its ball, target or tracker.
    #[inline]
    pub fn length(&self, measurement: &PreparedMeasurement) -> f64 {
        let target = self.chain.ball(&self.at(measurement));
        match measurement.datum {
            Datum::Ball(ball, bar) => (target - self.model.ball(ball)).norm() + self.model.bar_offset(bar),
            Datum::Plane(coordinate) => {
                let TrackerPlane { origin, normal, .. } = &self.planes[coordinate.index()];
                normal.dot(&(target - origin))
            }
        }
    }

    fn at<'b>(&'b self, measurement: &'b PreparedMeasurement) -> AxesAtPose<'b> {
        let PreparedMeasurement { axes, sin_cos, approach, target, .. } = measurement;
        AxesAtPose { axes, sin_cos, approach: *approach, target: self.model.target(*target) }
    }

    /// The length and its derivatives; NaN as [`Self::length`].
    pub fn row(&self, measurement: &PreparedMeasurement) -> LengthRow {
        let mut row = LengthRow::default();
        self.row_into(measurement, &mut row);
        row
    }

    /// As [`Self::row`], into a row that is new or was filled by this model before.
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
pub struct ColumnSelection {
    /// Column of the row, and the measurements whose derivative is not zero.
    columns: Vec<(usize, RowFilter)>,
}

/// The measurements that depend on a parameter.
#[derive(Clone, Copy, Debug)]
enum RowFilter {
    All,
    From(BallId),
    With(BarId),
    To(TargetId),
    Tracked,
}

impl ColumnSelection {
    pub fn new(ids: &[ParamId]) -> Self {
        let column = |id: &ParamId| {
            let rows = match id {
                ParamId::Ball(ball, _) => RowFilter::From(*ball),
                ParamId::BarOffset(bar) => RowFilter::With(*bar),
                ParamId::Tool(_) => RowFilter::To(TargetId::FIRST),
                ParamId::Target(target, _) => RowFilter::To(*target),
                ParamId::Tracker(_) | ParamId::TrackerTurn(_) => RowFilter::Tracked,
                _ => RowFilter::All,
            };
            (id.column(), rows)
        };
        Self { columns: ids.iter().map(column).collect() }
    }

    /// Copies the selected derivatives of a row to `out`, in the order of the parameters.
    #[inline]
    pub fn pick(&self, row: &LengthRow, out: &mut [f64]) {
        for ((place, rows), value) in self.columns.iter().zip(out) {
            let changes = match rows {
                RowFilter::All => true,
                RowFilter::From(ball) => row.datum.ball() == Some(*ball),
                RowFilter::With(bar) => row.datum.bar() == Some(*bar),
                RowFilter::To(target) => row.target == *target,
                RowFilter::Tracked => row.datum.is_plane(),
            };
            *value = if changes { row.columns()[*place] } else { 0.0 };
        }
    }
}

impl LengthModel {
    /// With the base balls in the order of their numbers, exact bars, no target but the tool ball, no tracker.
    pub fn new(geometry: Geometry, balls: &[BaseBall]) -> Self {
        let balls = balls.iter().map(|ball| ball.position).collect();
        Self { geometry, balls, bar_offsets: vec![], targets: vec![], tracker: None }
    }

    /// The start of a fit, with exact bars. The tracker's frame is that of [`Tracker::located`]. A further target is at the
    /// mean of its positions in the flange frame, or at the tool ball if it has none.
    pub fn before(geometry: Geometry, balls: &[BaseBall], observations: &Measurements) -> Self {
        let positions: Vec<MeasuredPosition> = observations.positions().collect();
        let tracker = Tracker::located(&geometry, &positions);
        let on_tool = |target: TargetId| {
            let of_target = positions.iter().filter(|position| position.target == target);
            let in_flange = of_target.zip(tracker.iter().cycle()).map(|(position, tracker)| {
                let flange = geometry.flange(&position.axes);
                flange.rotation.transpose() * (tracker.in_base(&position.place) - flange.position)
            });
            let places: Vec<Vector3<f64>> = in_flange.collect();
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
        PreparedModel { model: self, chain: KinematicChain::new(&self.geometry), planes }
    }

    #[inline]
    fn ball(&self, ball: BallId) -> Vector3<f64> {
        self.balls.get(ball.index()).copied().unwrap_or(NOWHERE)
    }

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

    /// The value of a parameter in its unit; NaN if the model does not have it.
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

    /// The model with `steps` added to the parameters `ids`.
    pub fn shifted<'a>(&self, ids: &[ParamId], steps: impl IntoIterator<Item = &'a f64>) -> Self {
        let mut shifted = self.clone();
        ids.iter().zip(steps).for_each(|(id, step)| shifted.shift(*id, *step));
        shifted
    }

    /// Adds `step` to a parameter, if the model has it.
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
