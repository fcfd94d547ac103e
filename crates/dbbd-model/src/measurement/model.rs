//! The measurement model: the length or coordinate that a measurement gives, as a function of all parameters of robot,
//! targets, base balls, bars and tracker.

use nalgebra::Vector3;

use super::{BaseBall, MeasuredPosition, Measurement, Measurements, Tracker};
use crate::math::map_pieces;
use crate::robot::{
    AXES, Approach, AxesAtPose, AxisAngles, BallId, BarId, Datum, FurtherColumns, Geometry, JointSinCos,
    KinematicChain, LengthRow, ParamId, ParamOwner, PayloadId, TargetId, TrackerPlane,
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
    pub payload: PayloadId,
    /// Distance between the ball centres, or from a plane of the tracker's frame.
    pub length_mm: f64,
    /// Force with which the bar pulls the tool ball towards the base ball, N.
    pub force_n: f64,
}

impl PreparedMeasurement {
    /// A length to the tool ball with the first bar; axis angles in rad.
    pub fn new(axes: [f64; AXES], ball: BallId, length_mm: f64) -> Self {
        let sin_cos = JointSinCos::of(&axes);
        let (datum, target) = (Datum::Ball(ball, BarId::FIRST), TargetId::FIRST);
        let (approach, payload) = (Approach::default(), PayloadId::FIRST);
        Self { axes, sin_cos, approach, datum, target, payload, length_mm, force_n: 0.0 }
    }
}

impl Measurement {
    /// A prepared length as a row of a table, without a standard deviation of its own, a time or the pull of the bar.
    pub fn of_prepared(index: u32, length: &PreparedMeasurement) -> Self {
        let &PreparedMeasurement { datum, target, payload, length_mm, approach, .. } = length;
        let axes = AxisAngles::from_degrees(length.axes.map(f64::to_degrees));
        Self { index, datum, target, axes, approach, length_mm, sigma_mm: None, payload, context: None }
    }
}

impl From<&Measurement> for PreparedMeasurement {
    fn from(measurement: &Measurement) -> Self {
        let &Measurement { datum, target, payload, length_mm, approach, .. } = measurement;
        Self {
            datum,
            target,
            payload,
            approach,
            force_n: measurement.context.as_ref().and_then(|context| context.force_n).unwrap_or(0.0),
            ..Self::new(measurement.axes.radians(), BallId::FIRST, length_mm)
        }
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
    pub(crate) fn residual(&self, measurement: &PreparedMeasurement) -> f64 {
        measurement.length_mm - self.length(measurement)
    }

    /// The predicted length or coordinate, mm; NaN if the model lacks its ball, target or tracker.
    #[inline]
    pub fn length(&self, measurement: &PreparedMeasurement) -> f64 {
        if measurement.force_n != 0.0 {
            return self.row(measurement).length;
        }
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
        let PreparedMeasurement { axes, sin_cos, approach, target, payload, .. } = measurement;
        AxesAtPose {
            axes,
            sin_cos,
            approach: *approach,
            target: self.model.target(*target),
            payload: *payload,
        }
    }

    /// The length and its derivatives; NaN as [`Self::length`].
    pub fn row(&self, measurement: &PreparedMeasurement) -> LengthRow {
        let mut row = LengthRow::default();
        self.fill(measurement, FurtherColumns::ALL, &mut row);
        row
    }

    /// As [`Self::row`], with the columns of a selection, into a row that is new or was filled by this model with this selection
    /// before.
    #[inline]
    pub fn row_into(
        &self,
        measurement: &PreparedMeasurement,
        selection: &ColumnSelection,
        row: &mut LengthRow,
    ) {
        self.fill(measurement, selection.further, row);
    }

    #[inline]
    fn fill(&self, measurement: &PreparedMeasurement, further: FurtherColumns, row: &mut LengthRow) {
        let at = self.at(measurement);
        match measurement.datum {
            Datum::Ball(ball, bar) => {
                self.chain.row(&at, &self.model.ball(ball), self.model.bar_offset(bar), further, row);
                if measurement.force_n != 0.0 {
                    row.pulled(&self.model.geometry, measurement.force_n, further);
                }
            }
            Datum::Plane(coordinate) => {
                self.chain.plane_row(&at, &self.planes[coordinate.index()], further, row);
            }
        }
        (row.datum, row.target) = (measurement.datum, measurement.target);
    }
}

/// The columns of some parameters within a [`LengthRow`].
#[derive(Clone, Debug)]
pub struct ColumnSelection {
    /// Column of the row, and the measurements whose derivative is not zero.
    columns: Vec<(usize, RowFilter)>,
    further: FurtherColumns,
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
            let rows = match id.owner() {
                ParamOwner::Robot => RowFilter::All,
                ParamOwner::Ball(ball) => RowFilter::From(ball),
                ParamOwner::Bar(bar) => RowFilter::With(bar),
                ParamOwner::ToolBall => RowFilter::To(TargetId::FIRST),
                ParamOwner::Target(target) => RowFilter::To(target),
                ParamOwner::Tracker => RowFilter::Tracked,
            };
            (id.column(), rows)
        };
        Self { columns: ids.iter().map(column).collect(), further: FurtherColumns::of(ids) }
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
    /// A model with the base balls in the order of their numbers, exact bars, no target but the tool ball, and no
    /// tracker.
    pub fn new(geometry: Geometry, balls: &[BaseBall]) -> Self {
        let balls = balls.iter().map(|ball| ball.position).collect();
        Self { geometry, balls, bar_offsets: vec![], targets: vec![], tracker: None }
    }

    /// The start of a fit, with exact bars. The tracker's frame is that of `Tracker::located`. A further target is at the
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
    #[expect(clippy::wildcard_enum_match_arm, reason = "the geometry's match has every parameter")]
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
    pub(crate) fn shifted<'a>(&self, ids: &[ParamId], steps: impl IntoIterator<Item = &'a f64>) -> Self {
        let mut shifted = self.clone();
        ids.iter().zip(steps).for_each(|(id, step)| shifted.shift(*id, *step));
        shifted
    }

    /// Adds `step` to a parameter, if the model has it.
    #[expect(clippy::wildcard_enum_match_arm, reason = "the geometry's match has every parameter")]
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Coordinate, Robot};

    fn model() -> LengthModel {
        let geometry = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry;
        LengthModel {
            geometry,
            balls: vec![Vector3::new(1200.0, -300.0, 500.0), Vector3::new(1000.0, 600.0, 300.0)],
            bar_offsets: vec![0.0, 0.4],
            targets: vec![Vector3::new(-80.0, 30.0, 150.0)],
            tracker: Some(Tracker {
                origin: Vector3::new(3000.0, -500.0, 900.0),
                turn: Vector3::new(0.4, -0.3, 2.0),
            }),
        }
    }

    const AXES_AT: [f64; AXES] = [0.3, -0.8, 0.6, 1.1, -0.7, 2.0];

    fn reading(datum: Datum, target: TargetId) -> PreparedMeasurement {
        PreparedMeasurement { datum, target, ..PreparedMeasurement::new(AXES_AT, BallId::FIRST, 700.0) }
    }

    #[test]
    fn a_length_is_a_distance_from_its_ball_plus_the_offset_of_its_bar() {
        let model = model();
        let flange = model.geometry.flange(&AXES_AT);
        let second = (BallId::at(1), BarId::at(1), TargetId::at(1));
        let of = reading(Datum::Ball(second.0, second.1), second.2);
        let target = flange.position + flange.rotation * model.targets[0];
        let expected = (target - model.balls[1]).norm() + 0.4;
        let prepared = model.prepare();
        assert!((prepared.length(&of) - expected).abs() < 1e-10);
        assert!((prepared.residual(&of) - (700.0 - expected)).abs() < 1e-10);
        assert!((prepared.row(&of).length - expected).abs() < 1e-10);
        // Beyond the end a bar is exact, and a ball or target is nowhere.
        let exact = prepared.length(&reading(Datum::Ball(second.0, BarId::at(2)), second.2));
        assert!((exact - expected + 0.4).abs() < 1e-10);
        assert!(prepared.length(&reading(Datum::Ball(BallId::at(2), second.1), second.2)).is_nan());
        assert!(prepared.length(&reading(of.datum, TargetId::at(2))).is_nan());
    }

    #[test]
    fn a_position_is_that_of_the_target_in_the_frame_of_the_tracker() {
        let model = model();
        let ball = model.geometry.ball(&AXES_AT).position;
        let tracker = model.tracker.unwrap();
        let place =
            Vector3::from(Coordinate::ALL.map(|coordinate| {
                model.prepare().length(&reading(Datum::Plane(coordinate), TargetId::FIRST))
            }));
        assert!((tracker.in_base(&place) - ball).norm() < 1e-9);
        let lost = LengthModel { tracker: None, ..model };
        assert!(lost.prepare().length(&reading(Datum::Plane(Coordinate::Y), TargetId::FIRST)).is_nan());
    }

    #[test]
    fn every_parameter_is_shifted_and_read_in_its_place() {
        let model = model();
        for id in [
            ParamId::Ball(BallId::at(1), Coordinate::Z),
            ParamId::BarOffset(BarId::at(1)),
            ParamId::Target(TargetId::at(1), Coordinate::X),
            ParamId::Tracker(Coordinate::Y),
            ParamId::TrackerTurn(Coordinate::Z),
            ParamId::Tool(Coordinate::X),
            ParamId::A(crate::robot::Joint::J2),
        ] {
            let shifted = model.shifted(&[id], &[0.25]);
            assert!((shifted.value(id) - model.value(id) - 0.25).abs() < 1e-12, "{id}");
            let back = shifted.shifted(&[id], &[-0.25]);
            assert!((back.value(id) - model.value(id)).abs() < 1e-12 && shifted != model);
        }
        assert_eq!(model.value(ParamId::Ball(BallId::at(1), Coordinate::Y)), 600.0);
        assert_eq!(model.value(ParamId::Target(TargetId::at(1), Coordinate::Z)), 150.0);
        assert_eq!(model.value(ParamId::TrackerTurn(Coordinate::Y)), -0.3);
        assert!(model.value(ParamId::Ball(BallId::at(2), Coordinate::Y)).is_nan());
        // A bar beyond the end is added; parameters that the model does not have are ignored.
        let further = model.shifted(&[ParamId::BarOffset(BarId::at(3))], &[0.5]);
        assert_eq!(further.bar_offsets, [0.0, 0.4, 0.0, 0.5]);
        assert_eq!(model.shifted(&[ParamId::Target(TargetId::at(5), Coordinate::X)], &[1.0]), model);
    }

    #[test]
    fn only_parameters_that_change_a_length_have_a_derivative() {
        let model = model();
        let ids = [
            ParamId::Ball(BallId::FIRST, Coordinate::X),
            ParamId::Ball(BallId::at(1), Coordinate::X),
            ParamId::BarOffset(BarId::FIRST),
            ParamId::BarOffset(BarId::at(1)),
            ParamId::Tool(Coordinate::Y),
            ParamId::Target(TargetId::at(1), Coordinate::Y),
            ParamId::Tracker(Coordinate::Z),
            ParamId::D(crate::robot::Joint::J4),
        ];
        let changes = |datum, target| {
            let mut row = [7.0; 8];
            let reading = reading(datum, target);
            ColumnSelection::new(&ids).pick(&model.prepare().row(&reading), &mut row);
            for (id, value) in ids.iter().zip(row) {
                let at = |step: f64| model.shifted(&[*id], &[step]).prepare().length(&reading);
                assert!((value - (at(1e-3) - at(-1e-3)) / 2e-3).abs() < 1e-6, "{id}");
            }
            row.map(|value| value != 0.0)
        };
        let length = changes(Datum::Ball(BallId::at(1), BarId::at(1)), TargetId::FIRST);
        assert_eq!(length, [false, true, false, true, true, false, false, true]);
        let position = changes(Datum::Plane(Coordinate::X), TargetId::at(1));
        assert_eq!(position, [false, false, false, false, false, true, true, true]);
    }

    /// A pull of 50 N turns joint 3 by its compliance times the torque of the force about its axis, as a load there would.
    #[test]
    fn a_bar_that_pulls_shortens_its_length_by_the_compliance() {
        let mut model = model();
        let free = reading(Datum::Ball(BallId::FIRST, BarId::FIRST), TargetId::FIRST);
        let pulled = PreparedMeasurement { force_n: 50.0, ..free };
        let [stiff, same] = [free, pulled].map(|of| model.prepare().length(&of));
        assert_eq!(stiff, same);
        let ball = model.geometry.ball(&AXES_AT).position;
        let towards = (model.balls[0] - ball).normalize();
        let (shift, _) = model.geometry.axis_jacobian(&AXES_AT)[2];
        let torque_nm = 1e-3 * shift.dot(&(towards * 50.0));
        let moved = shift * (4e-7 * torque_nm);
        let expected = (ball + moved - model.balls[0]).norm();
        for split in [0.0, 1e-7] {
            model.geometry.compliance[2] = 4e-7 - split;
            model.geometry.payload_compliance[2] = split;
            model.geometry.load.masses.clear();
            model.geometry.load.payloads.clear();
            let found = model.prepare().length(&pulled);
            assert!((found - expected).abs() < 1e-6 && stiff - found > 0.005, "{found} {expected} {stiff}");
        }
        let joint = crate::robot::Joint::J3;
        let ids = [ParamId::Compliance(joint), ParamId::PayloadCompliance(joint), ParamId::Theta(joint)];
        let mut row = [0.0; 3];
        ColumnSelection::new(&ids).pick(&model.prepare().row(&pulled), &mut row);
        for ((id, value), step) in ids.iter().zip(row).zip([1e-8, 1e-8, 1e-6]) {
            let at = |step: f64| model.shifted(&[*id], &[step]).prepare().length(&pulled);
            let expected = (at(step) - at(-step)) / (2.0 * step);
            assert!((value - expected).abs() < 1e-4 * expected.abs(), "{id}: {value} {expected}");
        }
    }

    #[test]
    fn pieces_have_their_standard_deviations() {
        let readings = vec![reading(Datum::Ball(BallId::FIRST, BarId::FIRST), TargetId::FIRST); 5000];
        let sigma: Vec<f64> = (0..5000).map(f64::from).collect();
        let found =
            (&readings[..], &sigma[..]).in_pieces(|first, piece, sigma| (first, piece.len(), sigma[0]));
        assert_eq!(found, [(0, 4096, 0.0), (4096, 904, 4096.0)]);
        let plain = readings[..3].in_pieces(|first, piece, sigma| (first, piece.len(), sigma.len()));
        assert_eq!(plain, [(0, 3, 0)]);
    }

    /// The start of a fit: the tracker where its positions agree, a further target where it was seen.
    #[test]
    fn the_start_of_a_fit_finds_tracker_and_targets() {
        let truth = model();
        let poses: [[f64; AXES]; 4] = std::array::from_fn(|at| {
            std::array::from_fn(|axis| AXES_AT[axis] + 0.3 * ((at * (axis + 2)) as f64).sin())
        });
        let mut rows = Vec::new();
        for axes in poses {
            for target in [TargetId::FIRST, TargetId::at(1)] {
                let place = Coordinate::ALL.map(|coordinate| {
                    let axes = PreparedMeasurement::new(axes, BallId::FIRST, 0.0);
                    truth.prepare().length(&PreparedMeasurement {
                        datum: Datum::Plane(coordinate),
                        target,
                        ..axes
                    })
                });
                let row = Measurement {
                    index: 1,
                    datum: Datum::Plane(Coordinate::X),
                    target,
                    axes: crate::robot::AxisAngles::from_degrees(axes.map(f64::to_degrees)),
                    approach: Approach::default(),
                    length_mm: 0.0,
                    sigma_mm: None,
                    payload: PayloadId::FIRST,
                    context: None,
                };
                rows.extend(row.at_place(place));
            }
        }
        let observations = Measurements::new(rows, Vec::new()).unwrap();
        let start = LengthModel::before(truth.geometry.clone(), &[], &observations);
        let (found, expected) = (start.tracker.unwrap(), truth.tracker.unwrap());
        assert!((found.origin - expected.origin).norm() < 1e-7 && (found.turn - expected.turn).norm() < 1e-9);
        assert!((start.targets[0] - truth.targets[0]).norm() < 1e-7);
        assert_eq!((observations.count(), observations.targets(), observations.balls()), (8, 2, 0));
    }
}
