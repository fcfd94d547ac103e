//! The geometry of a robot and its forward kinematics.

use nalgebra::Vector3;

use super::pose::{Pose, rot_x, rot_y, rot_z};
use super::{AXES, Approach, Coupling, Joint, JointErrors, ParamId};

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.806_65;

/// One row of the modified-DH table: `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DhRow {
    /// Twist before the joint, rad.
    pub alpha: f64,
    /// Link length before the joint, mm.
    pub a: f64,
    /// Joint angle at axis angle zero, rad.
    pub theta: f64,
    /// Link offset along the joint, mm.
    pub d: f64,
    /// Hayati's turn about y before the row, rad.
    pub beta: f64,
    /// +1 or -1: the sense of the controller's axis angle.
    pub sign: f64,
}

/// A mass that loads the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass {
    /// The joint whose frame it moves with; for the payload the last one.
    pub joint: Joint,
    pub kg: f64,
    /// Centre of mass in that joint's frame, mm.
    pub centre: Vector3<f64>,
}

/// The parameters of the forward kinematics.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// The DH table, base to flange.
    pub rows: [DhRow; AXES],
    /// Converts axis angles of the controller to joint angles.
    pub coupling: Coupling,
    /// Tool ball in the flange frame, mm.
    pub tool: Vector3<f64>,
    /// Masses that load the joints.
    pub masses: Vec<Mass>,
    /// Compliance of each joint, rad/(N m).
    pub compliance: [f64; AXES],
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
    pub(super) fn joint_angles_approached(&self, axes: &[f64; AXES], approach: Approach) -> [f64; AXES] {
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
        if self.compliance.iter().any(|c| *c != 0.0) {
            let torques = self.torques(&angles);
            for i in 0..AXES {
                angles[i] += self.compliance[i] * torques[i];
            }
        }
        angles
    }

    /// Calls `each` with the index of a joint and the derivative of its error with respect to a coefficient, at axis angles
    /// (rad), in the order of [`JointErrors::terms`].
    pub fn error_derivatives(&self, axes: &[f64; AXES], approach: Approach, each: impl FnMut(usize, f64)) {
        let (joints, senses) = (self.coupling.joints(axes), self.coupling.senses(approach));
        self.joint_errors.derivatives(&joints, senses, each);
    }

    /// Whether the joints are rigid and have no errors.
    pub fn is_rigid(&self) -> bool {
        let bends = self.compliance.iter().any(|c| *c != 0.0) && !self.masses.is_empty();
        !bends && self.gear.iter().flatten().all(|part| *part == 0.0) && self.joint_errors.is_none()
    }

    /// The same robot with rigid joints that have no errors.
    pub fn rigid(&self) -> Self {
        Self {
            compliance: [0.0; AXES],
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

    /// Gravity torque about each joint, N m, at joint angles in the sense of the table. The base is upright.
    pub(super) fn torques(&self, angles: &[f64; AXES]) -> [f64; AXES] {
        let mut torques = [0.0; AXES];
        if self.masses.is_empty() {
            return torques;
        }
        let frames = self.frames(angles);
        for mass in &self.masses {
            let carrier = &frames[mass.joint.index()];
            let centre = carrier.position + carrier.rotation * mass.centre;
            let weight = Vector3::new(0.0, 0.0, -GRAVITY * mass.kg);
            for joint in 0..mass.joint.number() {
                let lever = (centre - frames[joint].position) * 1e-3;
                torques[joint] += frames[joint].rotation.column(2).dot(&lever.cross(&weight));
            }
        }
        torques
    }

    /// An upper bound of the gravity torque about each joint in any pose, N m: every mass at full stretch.
    pub fn greatest_torques(&self) -> [f64; AXES] {
        let mut torques = [0.0; AXES];
        for mass in &self.masses {
            let mut lever_mm = mass.centre.norm();
            for joint in (0..mass.joint.number()).rev() {
                torques[joint] += GRAVITY * mass.kg * lever_mm * 1e-3;
                lever_mm += self.rows[joint].a.hypot(self.rows[joint].d);
            }
        }
        torques
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
