//! Length and design row of a pose: the inner loop of the solver. A pass from the flange to the base gives the ball, a pass from
//! the base to the flange the derivatives of the length with respect to all parameters.
//!
//! A coordinate in the frame of a tracker is a length as well: the distance of a target from a plane of that frame.
//!
//! Let u be the unit vector along the length to the tool ball p. Every geometric parameter moves p by a unit screw, so the
//! derivative is the reciprocal product of that screw with the line of the bar: `w . (p x u)` for a rotation about the axis w
//! through the origin, `w . u` for a translation along w. The screw of a row lies on an axis of the row's frame. If p is
//! transformed inwards and u outwards into that frame, the product is one component of each. No matrix is formed. Sines and
//! cosines are computed once per model for the table, and once per measurement for the axis angles.

use nalgebra::Vector3;

use super::load::GravityTorques;
use super::{
    AXES, Approach, BallId, BarId, Coordinate, Datum, Geometry, Joint, ParamGroup, ParamId, PayloadId,
    TargetId,
};

/// A length and its derivatives with respect to all parameters (mm per mm, mm per rad, mm per rad/(N m)); the default is zero.
#[derive(Clone, Debug)]
pub struct LengthRow {
    /// Distance between the ball centres plus the bar offset, or from a plane, mm.
    pub length: f64,
    pub datum: Datum,
    pub target: TargetId,
    columns: DerivativeColumns,
}

type DerivativeColumns = [f64; ParamId::COLUMNS];

// The first column of each family of parameters.
const ALPHA_COLUMN: usize = ParamId::Alpha(Joint::J1).column();
const A_COLUMN: usize = ParamId::A(Joint::J1).column();
const THETA_COLUMN: usize = ParamId::Theta(Joint::J1).column();
const D_COLUMN: usize = ParamId::D(Joint::J1).column();
const BETA_COLUMN: usize = ParamId::Beta(Joint::J1).column();
const TOOL_COLUMN: usize = ParamId::Tool(Coordinate::X).column();
const BALL_COLUMN: usize = ParamId::Ball(BallId::FIRST, Coordinate::X).column();
const BAR_COLUMN: usize = ParamId::BarOffset(BarId::FIRST).column();
const COMPLIANCE_COLUMN: usize = ParamId::Compliance(Joint::J1).column();
const PAYLOAD_COMPLIANCE_COLUMN: usize = ParamId::PayloadCompliance(Joint::J1).column();
const GEAR_COS_COLUMN: usize = ParamId::GearCos(Joint::J1).column();
const GEAR_SIN_COLUMN: usize = ParamId::GearSin(Joint::J1).column();
const TURN_COLUMN: usize = ParamId::TrackerTurn(Coordinate::X).column();

impl LengthRow {
    /// The amount by which the length is shorter if the bar pulls the tool ball with a force F (N), mm. With the
    /// derivative a of the length by a joint's angle, the joint turns by its compliance c times the torque F a, which
    /// shortens the length by F c a^2.
    pub fn shortened_mm(&self, geometry: &Geometry, force_n: f64) -> f64 {
        let of_joint = |joint| geometry.compliance_of_payload(joint) * self.by_compliance(joint, force_n);
        -(0..AXES).map(of_joint).sum::<f64>()
    }

    /// Changes the length to that of a bar that pulls. The effect on derivatives by other parameters than the
    /// compliances is of second order.
    pub(crate) fn pulled(&mut self, geometry: &Geometry, force_n: f64, further: FurtherColumns) {
        self.length -= self.shortened_mm(geometry, force_n);
        if !further.compliance {
            return;
        }
        for joint in 0..AXES {
            let by_compliance = self.by_compliance(joint, force_n);
            self.columns[COMPLIANCE_COLUMN + joint] += by_compliance;
            self.columns[PAYLOAD_COMPLIANCE_COLUMN + joint] += by_compliance;
        }
    }

    /// The derivative of a length by the compliance of a joint that the bar's force turns, mm per rad/(N m).
    fn by_compliance(&self, joint: usize, force_n: f64) -> f64 {
        -1e-3 * force_n * self.columns[THETA_COLUMN + joint].powi(2)
    }
}

impl Default for LengthRow {
    fn default() -> Self {
        let datum = Datum::Ball(BallId::FIRST, BarId::FIRST);
        Self { length: 0.0, datum, target: TargetId::FIRST, columns: [0.0; ParamId::COLUMNS] }
    }
}

impl LengthRow {
    /// The derivative with respect to a parameter. A target, ball or bar counts as the one of this row.
    pub(crate) fn derivative(&self, id: ParamId) -> f64 {
        self.columns[id.column()]
    }

    /// The unit vector along the length, from the base ball or plane to the target, in the robot base.
    pub fn unit(&self) -> Vector3<f64> {
        -Vector3::from_fn(|axis, _| self.columns[BALL_COLUMN + axis])
    }

    /// The derivatives with respect to the angles of the joints, mm/rad.
    pub(crate) fn by_joint(&self) -> &[f64] {
        &self.columns[THETA_COLUMN..THETA_COLUMN + AXES]
    }

    /// The derivatives with respect to the coefficients of the joint errors, mm per unit, for a row at these axis angles (rad).
    pub fn joint_terms(&self, geometry: &Geometry, axes: &[f64; AXES], approach: Approach, out: &mut [f64]) {
        let by_joint = self.by_joint();
        let mut out = out.iter_mut();
        geometry.error_derivatives(axes, approach, |joint, value| {
            if let Some(out) = out.next() {
                *out = by_joint[joint] * value;
            }
        });
    }

    /// The derivatives in the order of [`ParamId::column`].
    pub(crate) fn columns(&self) -> &DerivativeColumns {
        &self.columns
    }
}

impl Geometry {
    /// Gravity torques at joint angles in the sense of the table.
    pub(super) fn torques(&self, angles: &[f64; AXES], payload: PayloadId) -> GravityTorques {
        KinematicChain::new(self).torques(&angles.map(f64::sin_cos), payload)
    }

    /// The length and its derivatives with respect to all parameters: see `KinematicChain::row`.
    pub fn length_row(&self, axes: &[f64; AXES], ball: &Vector3<f64>, bar_offset: f64) -> LengthRow {
        let mut row = LengthRow::default();
        let sin_cos = JointSinCos::of(axes);
        let (approach, payload) = (Approach::default(), PayloadId::FIRST);
        let at = AxesAtPose { axes, sin_cos: &sin_cos, approach, target: &self.tool, payload };
        KinematicChain::new(self).row(&at, ball, bar_offset, FurtherColumns::ALL, &mut row);
        row
    }
}

/// The columns of a row that are made only if they are wanted: they cost more than all others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FurtherColumns {
    /// By the compliances of the joints.
    compliance: bool,
    /// By the first harmonics of the transmissions.
    gear: bool,
}

impl FurtherColumns {
    pub(crate) const ALL: Self = Self { compliance: true, gear: true };

    /// Those of some parameters.
    pub(crate) fn of(ids: &[ParamId]) -> Self {
        let has = |group| ids.iter().any(|id| id.group() == group);
        Self { compliance: has(ParamGroup::Compliance), gear: has(ParamGroup::Gear) }
    }
}

/// Sine and cosine of each axis angle of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSinCos(pub(crate) [[f64; 2]; AXES]);

impl JointSinCos {
    /// Sine and cosine of axis angles in rad.
    pub(crate) fn of(axes: &[f64; AXES]) -> Self {
        Self(axes.map(|angle| angle.sin_cos().into()))
    }
}

/// The axes at a measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxesAtPose<'a> {
    /// Axis angles of the controller, rad.
    pub(crate) axes: &'a [f64; AXES],
    pub(crate) sin_cos: &'a JointSinCos,
    pub(crate) approach: Approach,
    /// The tool ball or another target, in the flange frame, mm.
    pub(crate) target: &'a Vector3<f64>,
    pub(crate) payload: PayloadId,
}

/// A plane of the tracker's frame, in the robot base.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrackerPlane {
    /// The origin of the frame, mm.
    pub(crate) origin: Vector3<f64>,
    pub(crate) normal: Vector3<f64>,
    /// The derivatives of the normal with respect to the rotation vector of the frame.
    pub(crate) normal_by_turn: [Vector3<f64>; 3],
}

/// A geometry with the sines and cosines of its DH table.
#[derive(Clone, Debug)]
pub(crate) struct KinematicChain<'a> {
    geometry: &'a Geometry,
    alpha: [(f64, f64); AXES],
    theta: [(f64, f64); AXES],
    beta: [(f64, f64); AXES],
    /// Whether the joint angles are those of the axes: no compliance, no joint errors.
    is_rigid: bool,
    is_coupled: bool,
    /// The mass that moves with each row, kg, and its first moment about the origin of the row's frame, kg mm.
    masses: [(f64, Vector3<f64>); AXES],
}

/// The angle by which each joint turns for a unit of its compliance, of that of the payload, and of the cosine and sine of its
/// transmission error, rad.
#[derive(Default)]
struct JointTurns {
    torques: GravityTorques,
    gear: [[f64; 2]; AXES],
}

/// The pass from the flange to the base.
struct InwardPass {
    /// Sine and cosine of each joint angle in the sense of the table.
    joints: [(f64, f64); AXES],
    /// The target in the frame of each row after its twist, before its translation along x.
    points: [Vector3<f64>; AXES],
    /// The target in the robot base.
    ball: Vector3<f64>,
}

impl<'a> KinematicChain<'a> {
    pub(crate) fn new(geometry: &'a Geometry) -> Self {
        let rows = &geometry.rows;
        Self {
            geometry,
            alpha: std::array::from_fn(|i| rows[i].alpha.sin_cos()),
            theta: std::array::from_fn(|i| rows[i].theta.sin_cos()),
            beta: std::array::from_fn(|i| rows[i].beta.sin_cos()),
            is_rigid: geometry.is_rigid(),
            is_coupled: !geometry.coupling.is_none(),
            masses: geometry.load.of_rows(),
        }
    }

    /// Sine and cosine of each joint angle in the sense of the table.
    #[inline]
    fn joints(&self, at: &AxesAtPose<'_>) -> [(f64, f64); AXES] {
        if !self.is_rigid {
            let torques = |angles: &[f64; AXES]| self.torques(&angles.map(f64::sin_cos), at.payload);
            return self.geometry.joint_angles_under(at.axes, at.approach, torques).map(f64::sin_cos);
        }
        let own_angles = self.own_angles(at);
        std::array::from_fn(|i| {
            let [sin, cos] = own_angles[i];
            let sin = self.geometry.rows[i].sign * sin;
            let (sin_offset, cos_offset) = self.theta[i];
            (sin * cos_offset + cos * sin_offset, cos * cos_offset - sin * sin_offset)
        })
    }

    /// Sine and cosine of the own angle of each joint.
    #[inline]
    fn own_angles(&self, at: &AxesAtPose<'_>) -> [[f64; 2]; AXES] {
        if self.is_coupled { self.geometry.coupling.sin_cos(&at.sin_cos.0) } else { at.sin_cos.0 }
    }

    /// The pass from the flange to the base: each row rotates and translates one point.
    #[inline]
    fn inward(&self, at: &AxesAtPose<'_>) -> InwardPass {
        let joints = self.joints(at);
        let mut points = [Vector3::zeros(); AXES];
        let mut point = *at.target;
        for i in (0..AXES).rev() {
            let row = &self.geometry.rows[i];
            point = about_z(joints[i], point) + Vector3::new(row.a, 0.0, row.d);
            points[i] = point;
            point = self.twisted(i, point);
        }
        InwardPass { joints, points, ball: point }
    }

    /// A vector in the frame of a row after its twist, in the frame of the row before.
    #[inline]
    fn twisted(&self, row: usize, vector: Vector3<f64>) -> Vector3<f64> {
        let vector = about_x(self.alpha[row], vector);
        if self.geometry.rows[row].beta == 0.0 { vector } else { about_y(self.beta[row], vector) }
    }

    /// Gravity torques at joint angles. From the flange to the base the masses beyond each row become one mass M with the
    /// first moment h about the row's origin; the torque about the row's axis z is z . (h x g).
    fn torques(&self, joints: &[(f64, f64); AXES], payload: PayloadId) -> GravityTorques {
        let load = &self.geometry.load;
        let mut gravity = [Vector3::zeros(); AXES];
        let mut outward = load.gravity_by_mm();
        for i in 0..AXES {
            if self.geometry.rows[i].beta != 0.0 {
                outward = about_y(back(self.beta[i]), outward);
            }
            outward = about_z(back(joints[i]), about_x(back(self.alpha[i]), outward));
            gravity[i] = outward;
        }
        let torques = |own: &dyn Fn(usize) -> (f64, Vector3<f64>)| {
            let (mut mass, mut moment) = (0.0, Vector3::zeros());
            let mut torques = [0.0; AXES];
            for i in (0..AXES).rev() {
                let (of_row, at_row) = own(i);
                (mass, moment) = (mass + of_row, moment + at_row);
                torques[i] = moment.x * gravity[i].y - moment.y * gravity[i].x;
                let row = &self.geometry.rows[i];
                moment = self.twisted(i, about_z(joints[i], moment) + Vector3::new(row.a, 0.0, row.d) * mass);
            }
            torques
        };
        let mut all = torques(&|row| self.masses[row]);
        let Some(carried) = load.payloads.get(payload.index()).map(|payload| payload.mass()) else {
            return GravityTorques { all, payload: [0.0; AXES] };
        };
        let of_payload =
            |row| if row == carried.joint.index() { carried.moments() } else { Default::default() };
        let payload = torques(&of_payload);
        all.iter_mut().zip(payload).for_each(|(all, payload)| *all += payload);
        GravityTorques { all, payload }
    }

    /// The pass from the base to the flange: the derivatives of the target's position along the unit vector `u` (robot
    /// base) with respect to the parameters of the robot and its tool.
    #[inline]
    fn derivatives(&self, inward: &InwardPass, mut u: Vector3<f64>, columns: &mut DerivativeColumns) {
        for i in 0..AXES {
            if self.geometry.rows[i].beta != 0.0 {
                u = about_y(back(self.beta[i]), u);
            }
            let p = &inward.points[i];
            let (s, c) = self.alpha[i];
            columns[BETA_COLUMN + i] = (p.y * s + p.z * c) * u.x - p.x * u.z;
            u = about_x(back((s, c)), u);
            columns[ALPHA_COLUMN + i] = p.y * u.z - p.z * u.y;
            columns[A_COLUMN + i] = u.x;
            columns[THETA_COLUMN + i] = (p.x - self.geometry.rows[i].a) * u.y - p.y * u.x;
            columns[D_COLUMN + i] = u.z;
            u = about_z(back(inward.joints[i]), u);
        }
        columns[TOOL_COLUMN..TOOL_COLUMN + 3].copy_from_slice(u.as_slice());
    }

    /// The target in the robot base, mm.
    pub(crate) fn ball(&self, at: &AxesAtPose<'_>) -> Vector3<f64> {
        self.inward(at).ball
    }

    /// Writes the distance from a base ball at `ball` plus `bar_offset` (mm) and its derivatives to `row`, which is new or was
    /// written for this robot with the same further columns. If the balls coincide, the length has no derivative, and the
    /// columns are zero.
    #[inline]
    pub(crate) fn row(
        &self,
        at: &AxesAtPose<'_>,
        ball: &Vector3<f64>,
        bar_offset: f64,
        further: FurtherColumns,
        row: &mut LengthRow,
    ) {
        let inward = self.inward(at);
        let bar = inward.ball - ball;
        let distance = bar.norm();
        row.length = distance + bar_offset;
        let columns = &mut row.columns;
        if distance > 0.0 {
            self.along(bar / distance, at, &inward, further, columns);
            columns[BAR_COLUMN] = 1.0;
        } else {
            *columns = [0.0; ParamId::COLUMNS];
        }
    }

    /// Writes the distance from a plane and its derivatives to a row, as [`Self::row`] does.
    pub(crate) fn plane_row(
        &self,
        at: &AxesAtPose<'_>,
        plane: &TrackerPlane,
        further: FurtherColumns,
        row: &mut LengthRow,
    ) {
        let inward = self.inward(at);
        let from = inward.ball - plane.origin;
        row.length = plane.normal.dot(&from);
        self.along(plane.normal, at, &inward, further, &mut row.columns);
        row.columns[BAR_COLUMN] = 0.0;
        for (axis, by_turn) in plane.normal_by_turn.iter().enumerate() {
            row.columns[TURN_COLUMN + axis] = by_turn.dot(&from);
        }
    }

    /// The derivatives of a length along the unit vector `u` with respect to the parameters of the robot, the target, and the
    /// base ball or plane.
    #[inline]
    fn along(
        &self,
        u: Vector3<f64>,
        at: &AxesAtPose<'_>,
        inward: &InwardPass,
        further: FurtherColumns,
        columns: &mut DerivativeColumns,
    ) {
        self.derivatives(inward, u, columns);
        for axis in 0..3 {
            columns[BALL_COLUMN + axis] = -u[axis];
        }
        Self::non_geometric(&self.turns(at, inward, further), further, columns);
    }

    /// The angles by which compliance and transmission errors turn the joints, as far as their columns are wanted.
    #[inline]
    fn turns(&self, at: &AxesAtPose<'_>, inward: &InwardPass, further: FurtherColumns) -> JointTurns {
        let mut turns = JointTurns::default();
        if further.compliance {
            turns.torques = self.torques(&inward.joints, at.payload);
        }
        if further.gear {
            turns.gear = self.own_angles(at).map(|[sin, cos]| [cos, sin]);
        }
        turns
    }

    /// The columns of what turns the joints are multiples of those of theta.
    #[inline]
    fn non_geometric(turns: &JointTurns, further: FurtherColumns, columns: &mut DerivativeColumns) {
        let JointTurns { torques, gear } = turns;
        if further.compliance {
            for j in 0..AXES {
                columns[COMPLIANCE_COLUMN + j] = columns[THETA_COLUMN + j] * torques.all[j];
                columns[PAYLOAD_COMPLIANCE_COLUMN + j] = columns[THETA_COLUMN + j] * torques.payload[j];
            }
        }
        if further.gear {
            for (j, [cos, sin]) in gear.iter().enumerate() {
                columns[GEAR_COS_COLUMN + j] = columns[THETA_COLUMN + j] * cos;
                columns[GEAR_SIN_COLUMN + j] = columns[THETA_COLUMN + j] * sin;
            }
        }
    }

    /// Calls `each` with the index of a parameter and the derivative of the tool ball's position with respect to it, mm per mm
    /// or rad; it is zero for parameters of the rest of the set-up. Returns the position of the tool ball.
    pub(crate) fn ball_jacobian(
        &self,
        axes: &[f64; AXES],
        ids: &[ParamId],
        mut each: impl FnMut(usize, Vector3<f64>),
    ) -> Vector3<f64> {
        let sin_cos = JointSinCos::of(axes);
        let target = &self.geometry.tool;
        let (approach, payload) = (Approach::default(), PayloadId::FIRST);
        let at = AxesAtPose { axes, sin_cos: &sin_cos, approach, target, payload };
        let inward = self.inward(&at);
        let further = FurtherColumns::of(ids);
        let turns = self.turns(&at, &inward, further);
        let along = [0, 1, 2].map(|axis| {
            let mut columns = [0.0; ParamId::COLUMNS];
            self.derivatives(&inward, Vector3::ith(axis, 1.0), &mut columns);
            Self::non_geometric(&turns, further, &mut columns);
            columns
        });
        for (at, id) in ids.iter().enumerate() {
            let factor = if id.moves_tool_ball() { 1.0 } else { 0.0 };
            each(at, Vector3::from_fn(|axis, _| factor * along[axis][id.column()]));
        }
        inward.ball
    }
}

/// A vector turned about an axis by the angle with this sine and cosine.
#[inline]
fn about_x((s, c): (f64, f64), v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, v.y * c - v.z * s, v.y * s + v.z * c)
}

#[inline]
fn about_y((s, c): (f64, f64), v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x * c + v.z * s, v.y, v.z * c - v.x * s)
}

#[inline]
fn about_z((s, c): (f64, f64), v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x * c - v.y * s, v.x * s + v.y * c, v.z)
}

/// Sine and cosine of the opposite angle.
#[inline]
fn back((s, c): (f64, f64)) -> (f64, f64) {
    (-s, c)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::parameter::{all_parameters, optional};
    use crate::robot::{
        CoupledAxis, Coupling, JointErrorModel, JointErrors, Mass, ParamUnit, Payload, Ripple, Robot,
    };

    const AXES_AT: [f64; AXES] = [0.3, -0.8, 0.6, 1.1, -0.7, 2.0];

    /// An arm with every effect: beta, compliance under load, transmission errors, a coupled joint, joint errors.
    fn arm() -> Geometry {
        let mut geometry = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry;
        let mut errors: [JointErrorModel; AXES] = Default::default();
        errors[1].backlash = 3e-4;
        errors[4].ripple = vec![Ripple { order: 5, cos: 2e-4, sin: -1e-4 }];
        geometry.joint_errors = JointErrors::new(errors);
        let by = Some(CoupledAxis { axis: Joint::J2, factor: 1.0 });
        geometry.coupling = Coupling::new([None, None, by, None, None, None]);
        geometry.rows[2].beta = 0.02;
        geometry.gear[3] = [4e-4, -2e-4];
        let centre = Vector3::new(20.0, 30.0, 200.0);
        geometry.load.payloads = vec![Payload { kg: 30.0, centre, ..Payload::default() }];
        geometry.load.masses =
            vec![Mass { joint: Joint::J3, kg: 80.0, centre: Vector3::new(100.0, 20.0, 5.0) }];
        geometry
    }

    fn ids() -> Vec<ParamId> {
        let robot = all_parameters(&Joint::ALL[1..], 0).into_iter();
        robot.filter(|id| !matches!(id, ParamId::BarOffset(_))).chain(optional()).collect()
    }

    fn step(id: ParamId) -> f64 {
        match id.unit() {
            ParamUnit::Mm => 1e-2,
            ParamUnit::Rad => 1e-5,
            ParamUnit::RadPerNm => 1e-8,
        }
    }

    fn moved(id: ParamId, step: f64) -> Geometry {
        let mut moved = arm();
        *moved.value_mut(id).unwrap() += step;
        moved
    }

    #[test]
    fn length_and_columns_match_forward_kinematics() {
        let ball = Vector3::new(1200.0, -300.0, 500.0);
        let row = arm().length_row(&AXES_AT, &ball, 0.25);
        assert!((row.length - arm().length(&AXES_AT, &ball, 0.25)).abs() < 1e-10);
        for id in ids() {
            let at = |step: f64| moved(id, step).length(&AXES_AT, &ball, 0.25);
            let difference = (at(step(id)) - at(-step(id))) / (2.0 * step(id));
            let size = difference.abs().max(1.0);
            assert!((row.derivative(id) - difference).abs() < 1e-5 * size, "{id}: {difference}");
        }
        for axis in Coordinate::ALL {
            let step = Vector3::ith(axis.index(), 1e-3);
            let at = |ball: Vector3<f64>| arm().length(&AXES_AT, &ball, 0.25);
            let difference = (at(ball + step) - at(ball - step)) / 2e-3;
            assert!((row.derivative(ParamId::Ball(BallId::FIRST, axis)) - difference).abs() < 1e-7);
        }
        assert_eq!(row.derivative(ParamId::BarOffset(BarId::FIRST)), 1.0);
        let along = (arm().ball(&AXES_AT).position - ball).normalize();
        assert!((row.unit() - along).norm() < 1e-12);
    }

    #[test]
    fn a_length_between_balls_that_coincide_has_no_derivative() {
        let ball = arm().ball(&AXES_AT).position;
        let sin_cos = JointSinCos::of(&AXES_AT);
        let geometry = arm();
        let at = AxesAtPose {
            axes: &AXES_AT,
            sin_cos: &sin_cos,
            approach: Approach::default(),
            target: &geometry.tool,
            payload: PayloadId::FIRST,
        };
        let mut row = geometry.length_row(&AXES_AT, &Vector3::zeros(), 0.0);
        let chain = KinematicChain::new(&geometry);
        let here = chain.ball(&at);
        assert!((here - ball).norm() < 1e-9);
        chain.row(&at, &here, 0.5, FurtherColumns::ALL, &mut row);
        assert_eq!((row.length, row.columns.iter().all(|column| *column == 0.0)), (0.5, true));
    }

    #[test]
    fn a_coordinate_of_a_tracker_is_a_distance_from_a_plane() {
        let geometry = arm();
        let sin_cos = JointSinCos::of(&AXES_AT);
        let target = Vector3::new(-40.0, 10.0, 60.0);
        let approach = Approach::new([0, 1, 1, 0, 0, 0]);
        let (axes, payload) = (&AXES_AT, PayloadId::FIRST);
        let at = AxesAtPose { axes, sin_cos: &sin_cos, approach, target: &target, payload };
        let chain = KinematicChain::new(&geometry);
        let normal = Vector3::new(2.0, -1.0, 2.0) / 3.0;
        let by_turn = [Vector3::x(), Vector3::y() * 2.0, Vector3::z() * -1.0];
        let origin = Vector3::new(10.0, 20.0, 30.0);
        let plane = TrackerPlane { origin, normal, normal_by_turn: by_turn };
        let mut row = LengthRow::default();
        chain.plane_row(&at, &plane, FurtherColumns::ALL, &mut row);
        let from = chain.ball(&at) - origin;
        assert!((row.length - normal.dot(&from)).abs() < 1e-10);
        let turned = Coordinate::ALL.map(|axis| row.derivative(ParamId::TrackerTurn(axis)));
        assert_eq!(turned, [from.x, 2.0 * from.y, -from.z]);
        let shifted = Coordinate::ALL.map(|axis| row.derivative(ParamId::Tracker(axis)));
        assert_eq!(Vector3::from(shifted), -normal);
        assert_eq!(row.derivative(ParamId::BarOffset(BarId::FIRST)), 0.0);
        // The target moves with the flange.
        let flange = geometry.approached(approach).flange(&AXES_AT);
        let by_target = Coordinate::ALL.map(|axis| row.derivative(ParamId::Target(TargetId::at(1), axis)));
        assert!((Vector3::from(by_target) - flange.rotation.transpose() * normal).norm() < 1e-12);
    }

    #[test]
    fn ball_jacobian_matches_differences() {
        let ids: Vec<ParamId> =
            ids().into_iter().chain([ParamId::Ball(BallId::FIRST, Coordinate::X)]).collect();
        let mut found = Vec::new();
        let geometry = arm();
        let ball =
            KinematicChain::new(&geometry).ball_jacobian(&AXES_AT, &ids, |at, by| found.push((at, by)));
        assert!((ball - arm().ball(&AXES_AT).position).norm() < 1e-9);
        assert_eq!(found.len(), ids.len());
        for (at, by) in found {
            let Some((id, step)) = Some(ids[at]).filter(|id| id.moves_tool_ball()).map(|id| (id, step(id)))
            else {
                assert_eq!(by, Vector3::zeros());
                continue;
            };
            let [low, high] = [-step, step].map(|step| moved(id, step).ball(&AXES_AT).position);
            let difference = (high - low) / (2.0 * step);
            assert!((by - difference).norm() < 1e-5 * difference.norm().max(1.0), "{id}");
        }
    }

    #[test]
    fn joint_terms_are_the_derivatives_by_the_coefficients() {
        let (geometry, ball) = (arm(), Vector3::new(1200.0, -300.0, 500.0));
        let approach = Approach::new([1, -1, -1, 1, 1, 0]);
        let count = geometry.joint_errors.count();
        let sin_cos = JointSinCos::of(&AXES_AT);
        let length = |geometry: &Geometry| {
            let (axes, payload) = (&AXES_AT, PayloadId::FIRST);
            let at = AxesAtPose { axes, sin_cos: &sin_cos, approach, target: &geometry.tool, payload };
            let mut row = LengthRow::default();
            KinematicChain::new(geometry).row(&at, &ball, 0.0, FurtherColumns::ALL, &mut row);
            row
        };
        let mut terms = vec![0.0; count];
        length(&geometry).joint_terms(&geometry, &AXES_AT, approach, &mut terms);
        let values = geometry.joint_errors.coefficients();
        for (at, term) in terms.into_iter().enumerate() {
            let with = |step: f64| {
                let mut values = values.clone();
                values[at] += step;
                let joint_errors = geometry.joint_errors.with(values);
                length(&Geometry { joint_errors, ..geometry.clone() }).length
            };
            let difference = (with(1e-5) - with(-1e-5)) / 2e-5;
            assert!((term - difference).abs() < 1e-4, "{at}: {term} for {difference}");
        }
    }
}
