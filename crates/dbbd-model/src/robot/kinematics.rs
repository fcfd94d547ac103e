//! The geometry of a robot and its forward kinematics.

use nalgebra::Vector3;

use super::dh_row::DhRow;
use super::load::{ArmLoad, GravityTorques};
use super::pose::{Pose, rot_x, rot_y, rot_z};
use super::{AXES, Approach, Coupling, Joint, JointErrors, ParamId, PayloadId};

/// The parameters of the forward kinematics.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// The DH table, base to flange.
    pub rows: [DhRow; AXES],
    /// Converts axis angles of the controller to joint angles.
    pub coupling: Coupling,
    /// Tool ball in the flange frame, mm.
    pub tool: Vector3<f64>,
    pub load: ArmLoad,
    /// Compliance of each joint, rad/(N m).
    pub compliance: [f64; AXES],
    /// Added to the compliance under the torque of the payload, rad/(N m): it shows how wrong the stated masses of the
    /// links are.
    pub payload_compliance: [f64; AXES],
    /// First harmonic of the transmission error of each joint: cosine and sine, rad.
    pub gear: [[f64; 2]; AXES],
    /// Further errors of each joint as functions of its angle and the sense of its motion.
    pub joint_errors: JointErrors,
}

/// A reference to a parameter in a geometry.
macro_rules! place {
    ($geometry:ident, $id:ident $(, $mutable:tt)?) => {
        match $id {
            ParamId::Alpha(joint) => Some(&$($mutable)? $geometry.rows[joint.index()].alpha),
            ParamId::A(joint) => Some(&$($mutable)? $geometry.rows[joint.index()].a),
            ParamId::Theta(joint) => Some(&$($mutable)? $geometry.rows[joint.index()].theta),
            ParamId::D(joint) => Some(&$($mutable)? $geometry.rows[joint.index()].d),
            ParamId::Beta(joint) => Some(&$($mutable)? $geometry.rows[joint.index()].beta),
            ParamId::Tool(coordinate) => Some(&$($mutable)? $geometry.tool[coordinate.index()]),
            ParamId::Compliance(joint) => Some(&$($mutable)? $geometry.compliance[joint.index()]),
            ParamId::PayloadCompliance(joint) => {
                Some(&$($mutable)? $geometry.payload_compliance[joint.index()])
            }
            ParamId::GearCos(joint) => Some(&$($mutable)? $geometry.gear[joint.index()][0]),
            ParamId::GearSin(joint) => Some(&$($mutable)? $geometry.gear[joint.index()][1]),
            ParamId::Target(..)
            | ParamId::Ball(..)
            | ParamId::BarOffset(_)
            | ParamId::Tracker(_)
            | ParamId::TrackerTurn(_) => None,
        }
    };
}

impl Geometry {
    /// The joint angles (rad, in the sense of the table) at axis angles (rad), for an unknown sense of approach.
    pub(super) fn joint_angles(&self, axes: &[f64; AXES]) -> [f64; AXES] {
        self.joint_angles_approached(axes, Approach::default())
    }

    /// As [`Self::joint_angles`], for a known sense of approach.
    fn joint_angles_approached(&self, axes: &[f64; AXES], approach: Approach) -> [f64; AXES] {
        self.joint_angles_carrying(axes, approach, PayloadId::FIRST)
    }

    /// The joint angles with a payload of the list.
    pub(super) fn joint_angles_carrying(
        &self,
        axes: &[f64; AXES],
        approach: Approach,
        payload: PayloadId,
    ) -> [f64; AXES] {
        self.joint_angles_under(axes, approach, |angles| self.torques(angles, payload))
    }

    /// As [`Self::joint_angles_carrying`], with the torques at joint angles.
    pub(super) fn joint_angles_under(
        &self,
        axes: &[f64; AXES],
        approach: Approach,
        torques: impl Fn(&[f64; AXES]) -> GravityTorques,
    ) -> [f64; AXES] {
        let mut angles = [0.0; AXES];
        let joints = self.coupling.joints(axes);
        for i in 0..AXES {
            let [cos_part, sin_part] = self.gear[i];
            let (sin, cos) = joints[i].sin_cos();
            angles[i] = self.rows[i].sign * joints[i] + self.rows[i].theta + cos_part * cos + sin_part * sin;
        }
        if !self.joint_errors.is_none() {
            let senses = self.coupling.senses(approach).senses();
            for i in 0..AXES {
                angles[i] += self.joint_errors.correction(i, joints[i], senses[i]);
            }
        }
        if self.bends() {
            let torques = torques(&angles);
            for i in 0..AXES {
                angles[i] +=
                    self.compliance[i] * torques.all[i] + self.payload_compliance[i] * torques.payload[i];
            }
        }
        angles
    }

    /// Calls `each` with the index of a joint and the derivative of its error with respect to a coefficient, at axis angles
    /// (rad), in the order of [`JointErrors::terms`].
    pub(crate) fn error_derivatives(
        &self,
        axes: &[f64; AXES],
        approach: Approach,
        each: impl FnMut(usize, f64),
    ) {
        let (joints, senses) = (self.coupling.joints(axes), self.coupling.senses(approach));
        self.joint_errors.derivatives(&joints, senses, each);
    }

    /// The compliance of a joint under a known torque, rad/(N m). `compliance` alone refers to the torque of the links,
    /// which is known only as well as their masses.
    pub(super) fn compliance_of_payload(&self, joint: usize) -> f64 {
        self.compliance[joint] + self.payload_compliance[joint]
    }

    /// Whether gravity turns the joints.
    fn bends(&self) -> bool {
        self.compliance.iter().chain(&self.payload_compliance).any(|compliance| *compliance != 0.0)
    }

    /// Whether the joints are rigid and have no errors.
    pub(crate) fn is_rigid(&self) -> bool {
        !self.bends() && self.gear.iter().flatten().all(|part| *part == 0.0) && self.joint_errors.is_none()
    }

    /// The same robot with rigid joints that have no errors.
    pub fn rigid(&self) -> Self {
        Self {
            compliance: [0.0; AXES],
            payload_compliance: [0.0; AXES],
            gear: [[0.0; 2]; AXES],
            joint_errors: JointErrors::default(),
            ..self.clone()
        }
    }

    /// The same robot at poses with this approach: if the sense of a joint is known, its backlash is part of the joint offset.
    pub fn approached(&self, approach: Approach) -> Self {
        let mut approached = self.clone();
        for (i, sense) in self.coupling.senses(approach).senses().into_iter().enumerate() {
            if sense != 0 {
                approached.rows[i].theta += f64::from(sense) * approached.joint_errors.take_backlash(i);
            }
        }
        approached
    }

    /// The frame after each row at joint angles in the sense of the table.
    pub(super) fn frames(&self, angles: &[f64; AXES]) -> [Pose; AXES] {
        let mut frames = [Pose::identity(); AXES];
        let mut frame = Pose::identity();
        for (i, row) in self.rows.iter().enumerate() {
            if row.beta != 0.0 {
                frame.rotation *= rot_y(row.beta);
            }
            frame.rotation *= rot_x(row.alpha);
            frame.position += frame.rotation.column(0) * row.a;
            frame.rotation *= rot_z(angles[i]);
            frame.position += frame.rotation.column(2) * row.d;
            frames[i] = frame;
        }
        frames
    }

    /// An upper bound of the gravity torque about each joint in any pose, N m.
    pub(crate) fn greatest_torques(&self) -> [f64; AXES] {
        self.load.greatest_torques(&self.rows)
    }

    /// The flange (frame 6) in the robot base at axis angles (rad).
    pub fn flange(&self, axes: &[f64; AXES]) -> Pose {
        self.frames(&self.joint_angles(axes))[AXES - 1]
    }

    /// The tool ball in the robot base, with the orientation of the flange, at axis angles (rad).
    pub fn ball(&self, axes: &[f64; AXES]) -> Pose {
        let flange = self.flange(axes);
        Pose { rotation: flange.rotation, position: flange.position + flange.rotation * self.tool }
    }

    /// The origins of the frames, mm: the robot as a polyline.
    pub fn skeleton(&self, axes: &[f64; AXES]) -> [Vector3<f64>; AXES] {
        self.frames(&self.joint_angles(axes)).map(|frame| frame.position)
    }

    /// The Jacobian of the tool ball in the robot base: for each axis of the *controller* the translation and rotation, mm/rad
    /// and rad/rad.
    pub fn axis_jacobian(&self, axes: &[f64; AXES]) -> [(Vector3<f64>, Vector3<f64>); AXES] {
        let frames = self.frames(&self.joint_angles(axes));
        let ball = frames[AXES - 1].position + frames[AXES - 1].rotation * self.tool;
        let mut columns = [(Vector3::zeros(), Vector3::zeros()); AXES];
        for i in 0..AXES {
            let z: Vector3<f64> = frames[i].rotation.column(2) * self.rows[i].sign;
            columns[i] = (z.cross(&(ball - frames[i].position)), z);
        }
        let [shifts, turns] = [columns.map(|column| column.0), columns.map(|column| column.1)];
        let [shifts, turns] = [shifts, turns].map(|by_joint| self.coupling.by_axis(by_joint));
        std::array::from_fn(|i| (shifts[i], turns[i]))
    }

    /// The distance of the tool ball from a base ball at `ball` (mm, robot base) plus `bar_offset`, mm.
    pub fn length(&self, axes: &[f64; AXES], ball: &Vector3<f64>, bar_offset: f64) -> f64 {
        (self.ball(axes).position - ball).norm() + bar_offset
    }

    /// The value of a parameter of the robot or its tool; `None` for one of the rest of the set-up.
    pub fn value(&self, id: ParamId) -> Option<f64> {
        place!(self, id).copied()
    }

    /// Mutable access to the value of [`Geometry::value`].
    pub fn value_mut(&mut self, id: ParamId) -> Option<&mut f64> {
        place!(self, id, mut)
    }

    pub fn row(&self, joint: Joint) -> &DhRow {
        &self.rows[joint.index()]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Mass, Payload};
    use super::*;
    use nalgebra::Matrix3;

    /// An arm without any right angle. numpy computed the numbers of these tests from its table.
    fn arm() -> Geometry {
        let row = |alpha, a, theta, d, beta, sign| DhRow { alpha, a, theta, d, beta, sign };
        let mass = |joint, kg, centre: [f64; 3]| Mass { joint, kg, centre: centre.into() };
        Geometry {
            rows: [
                row(0.1, 5.0, 0.2, 800.0, 0.0, -1.0),
                row(-1.5, 350.0, -0.1, 3.0, 0.02, 1.0),
                row(0.03, 850.0, -1.6, -4.0, -0.01, 1.0),
                row(-1.6, 145.0, 0.05, 820.0, 0.0, -1.0),
                row(1.55, 2.0, -0.02, 1.0, 0.03, 1.0),
                row(-1.58, -3.0, 3.1, 170.0, 0.0, -1.0),
            ],
            coupling: Coupling::default(),
            tool: Vector3::new(10.0, -20.0, 150.0),
            load: ArmLoad::known(vec![
                mass(Joint::J2, 100.0, [400.0, 0.0, 50.0]),
                mass(Joint::J6, 60.0, [10.0, 20.0, 150.0]),
            ]),
            compliance: [0.0; AXES],
            payload_compliance: [0.0; AXES],
            gear: [[0.0; 2]; AXES],
            joint_errors: JointErrors::default(),
        }
    }

    fn torques(arm: &Geometry) -> [f64; AXES] {
        arm.torques(&arm.joint_angles(&AT), PayloadId::FIRST).all
    }

    const AT: [f64; AXES] = [0.3, -0.8, 0.6, 1.1, -0.7, 2.0];

    /// The product Ry(beta) Rx(alpha) Tx(a) Rz(sign A + theta) Tz(d) of all rows.
    #[test]
    fn forward_kinematics_match_numpy() {
        let (flange, ball) = (arm().flange(&AT), arm().ball(&AT));
        let expected = Matrix3::new(
            -0.6201179231692802,
            0.45870766053205336,
            0.6364283490962902, //
            -0.24302113894573055,
            -0.8836598309067282,
            0.4001075221330048, //
            0.7459185527855835,
            0.09344830341479442,
            0.6594489572356287,
        );
        assert!((flange.rotation - expected).norm() < 1e-14);
        let place = Vector3::new(1728.5299980256295, -350.5066467192436, 1911.7644724062818);
        assert!((flange.position - place).norm() < 1e-11);
        let place = Vector3::new(1808.6189179477392, -275.2475331706156, 2016.272035451186);
        assert!((ball.position - place).norm() < 1e-11 && ball.rotation == flange.rotation);
        assert_eq!(arm().skeleton(&AT)[AXES - 1], flange.position);
        let length = arm().length(&AT, &Vector3::new(1500.0, 200.0, 300.0), 0.25);
        assert!((length - 1807.65021964471).abs() < 1e-10);
    }

    /// tau_i = z_i . ((c - o_i) x (0, 0, -9.80665 m)) over the masses that joint i carries.
    #[test]
    fn gravity_torques_match_numpy() {
        let torques = torques(&arm());
        let expected = [
            -166.24672728305254,
            1111.1987798067726,
            543.4510813130335,
            -78.77746534495489,
            54.25600819594883,
            8.228105728000083,
        ];
        for (found, expected) in torques.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-10, "{found} for {expected}");
        }
        let unloaded = Geometry { load: ArmLoad::known(Vec::new()), ..arm() };
        assert_eq!(self::torques(&unloaded), [0.0; AXES]);
        // What the flange carries is a mass of the last frame.
        let mut carrying = arm();
        let last = carrying.load.masses.pop().unwrap();
        let payload = Payload { kg: last.kg, centre: last.centre, ..Payload::default() };
        carrying.load.payloads = vec![Payload::default(), payload];
        let carried = |at: usize| carrying.torques(&arm().joint_angles(&AT), PayloadId::at(at));
        assert_eq!(carried(0).payload, [0.0; AXES]);
        let without = carried(0).all;
        for (carried, torque) in carried(1).all.into_iter().zip(torques) {
            assert!((carried - torque).abs() < 1e-10);
        }
        for (joint, payload) in carried(1).payload.into_iter().enumerate() {
            assert!((without[joint] + payload - torques[joint]).abs() < 1e-10);
        }
        // On its head the arm hangs.
        let hanging = ArmLoad { gravity: -ArmLoad::DOWN, ..arm().load };
        let hanging = Geometry { load: hanging, ..arm() };
        assert_eq!(self::torques(&hanging), torques.map(|torque| -torque));
    }

    /// The sum over the masses of 9.80665 m (|c| + sum hypot(a, d) of the rows between), with 0.2 * 160 kg in front of the flange by
    /// a tenth of the length of the rows from the third on.
    #[test]
    fn greatest_torques_stretch_every_mass() {
        let expected = [
            2875.393906848042,
            2216.3628188766697,
            1054.1555977817445,
            302.86448667821327,
            300.84707976331083,
            147.44719354529383,
        ];
        let at = torques(&arm());
        for ((found, expected), at) in arm().greatest_torques().into_iter().zip(expected).zip(at) {
            assert!((found - expected).abs() < 1e-9 && at.abs() <= found, "{found} for {expected}");
        }
    }

    #[test]
    fn axis_jacobian_matches_differences() {
        let by = Some(crate::robot::CoupledAxis { axis: Joint::J2, factor: 1.0 });
        let coupled = Geometry { coupling: Coupling::new([None, None, by, None, None, None]), ..arm() };
        for geometry in [arm(), coupled] {
            for (axis, (shift, turn)) in geometry.axis_jacobian(&AT).into_iter().enumerate() {
                let at = |step: f64| {
                    let mut axes = AT;
                    axes[axis] += step;
                    geometry.ball(&axes)
                };
                let (low, high) = (at(-1e-6), at(1e-6));
                assert!(((high.position - low.position) / 2e-6 - shift).norm() < 1e-5, "{axis}");
                let rotation =
                    crate::robot::pose::rotation_vector(&(high.rotation * low.rotation.transpose()));
                assert!((rotation / 2e-6 - turn).norm() < 1e-8, "{axis}");
            }
        }
    }

    #[test]
    fn joint_angles_have_transmission_errors_joint_errors_and_compliance() {
        let mut errors: [crate::robot::JointErrorModel; AXES] = Default::default();
        errors[3].backlash = 2e-4;
        let geometry = Geometry {
            gear: std::array::from_fn(|i| if i == 1 { [3e-4, -5e-4] } else { [0.0; 2] }),
            joint_errors: JointErrors::new(errors),
            ..arm()
        };
        let rigid = arm().joint_angles(&AT);
        let approach = Approach::new([0, 0, 0, -1, 0, 0]);
        let bent = geometry.joint_angles_approached(&AT, approach);
        let expected = 3e-4 * 0.8f64.cos() + 5e-4 * 0.8f64.sin();
        assert!((bent[1] - rigid[1] - expected).abs() < 1e-15);
        assert!((bent[3] - rigid[3] + 2e-4).abs() < 1e-15);
        assert_eq!(bent[0], rigid[0]);
        let compliant = Geometry { compliance: [0.0, 1e-6, 0.0, 0.0, 0.0, 0.0], ..arm() };
        let sagged = compliant.joint_angles(&AT);
        assert!((sagged[1] - rigid[1] - 1e-6 * 1111.1987798067726).abs() < 1e-14);
        assert_eq!((sagged[0], sagged[5]), (rigid[0], rigid[5]));
        // The payload's own part: 60 kg in front of the last frame.
        let mut carrying = Geometry { payload_compliance: compliant.compliance, ..arm() };
        let last = carrying.load.masses.pop().unwrap();
        carrying.load.payloads = vec![Payload { kg: last.kg, centre: last.centre, ..Payload::default() }];
        let torque = carrying.torques(&rigid, PayloadId::FIRST).payload[1];
        assert!((carrying.joint_angles(&AT)[1] - rigid[1] - 1e-6 * torque).abs() < 1e-14 && torque > 100.0);
        assert!(arm().is_rigid() && !geometry.is_rigid() && !compliant.is_rigid());
        assert!(geometry.rigid().is_rigid() && compliant.rigid().is_rigid());
        // With a known approach the backlash is part of the joint offset.
        let approached = geometry.approached(approach);
        assert!((approached.rows[3].theta - arm().rows[3].theta + 2e-4).abs() < 1e-16);
        let again = approached.joint_angles_approached(&AT, approach);
        assert!((again[3] - bent[3]).abs() < 1e-15);
    }

    #[test]
    fn every_parameter_has_its_own_place() {
        for id in crate::robot::parameter::all_parameters(&Joint::ALL[1..], 0)
            .into_iter()
            .chain(crate::robot::parameter::optional())
            .filter(|id| !matches!(id, ParamId::BarOffset(_)))
        {
            let mut changed = arm();
            *changed.value_mut(id).unwrap() += 0.5;
            assert_eq!(changed.value(id), arm().value(id).map(|value| value + 0.5), "{id}");
            *changed.value_mut(id).unwrap() = arm().value(id).unwrap();
            assert_eq!(changed, arm());
        }
        assert_eq!(arm().value(ParamId::Alpha(Joint::J3)), Some(0.03));
        assert_eq!(arm().value(ParamId::Beta(Joint::J2)), Some(0.02));
        assert_eq!(arm().value(ParamId::Tool(crate::robot::Coordinate::Y)), Some(-20.0));
        assert_eq!(arm().value(ParamId::Tracker(crate::robot::Coordinate::Y)), None);
    }
}
