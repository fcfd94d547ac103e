//! The forward model, the length between the balls, and its derivatives by every parameter.
//!
//! With u the unit vector from the base ball to the tool ball p, every geometric parameter moves p
//! by a unit screw fixed in some frame of the chain, so its column is the reciprocal product of that
//! screw with the line of the bar: `u . (w x (p - o))` for a turn about the unit axis w through o,
//! `u . w` for a shift along w. One forward pass gives all columns.

use nalgebra::{Matrix3, Vector3};

use super::pose::{Pose, rot_x, rot_y, rot_z};
use super::{AXES, ParamId};

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.806_65;

/// One row of the modified-DH table: `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
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
    /// The joint (1..=6) with whose frame it moves; 6 for the payload.
    pub joint: usize,
    /// Mass, kg.
    pub kg: f64,
    /// Centre of mass in that joint's frame, mm.
    pub centre: Vector3<f64>,
}

/// The numbers that place the tool ball for given axis angles.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// The table, base to flange.
    pub rows: [Row; AXES],
    /// Tool ball in the flange frame, mm.
    pub tool: Vector3<f64>,
    /// Masses whose weight the joints carry.
    pub masses: Vec<Mass>,
    /// Compliance of each joint, rad/(N m).
    pub compliance: [f64; AXES],
    /// Error of each joint, once per turn of its axis: cosine and sine part, rad.
    pub gear: [[f64; 2]; AXES],
}

/// Where the columns of a [`LengthRow`] stand.
mod column {
    pub(super) const ALPHA: usize = 0;
    pub(super) const A: usize = 6;
    pub(super) const THETA: usize = 12;
    pub(super) const D: usize = 18;
    pub(super) const BETA: usize = 24;
    pub(super) const TOOL: usize = 29;
    pub(super) const CENTRE: usize = 32;
    pub(super) const BAR: usize = 35;
    pub(super) const COMPLIANCE: usize = 36;
    pub(super) const GEAR_COS: usize = 40;
    pub(super) const GEAR_SIN: usize = 46;
    pub(super) const COUNT: usize = 52;
}

/// A length and its derivatives by every parameter (mm per mm, mm per rad, mm per rad/(N m)).
#[derive(Clone, Debug)]
pub struct LengthRow {
    /// Distance between the ball centres plus the bar offset, mm.
    pub length: f64,
    columns: [f64; column::COUNT],
}

impl LengthRow {
    /// Number of values in [`LengthRow::columns`].
    pub const COLUMNS: usize = column::COUNT;

    /// All columns; [`LengthRow::position`] tells which is which.
    pub fn columns(&self) -> &[f64; Self::COLUMNS] {
        &self.columns
    }

    /// Where the derivative by `id` stands. A centre's columns are those of the row's own base ball:
    /// the derivative by another ball's centre is zero.
    pub fn position(id: ParamId) -> usize {
        match id {
            ParamId::Alpha(i) => column::ALPHA + i,
            ParamId::A(i) => column::A + i,
            ParamId::Theta(i) => column::THETA + i - 1,
            ParamId::D(i) => column::D + i - 1,
            ParamId::Beta(i) => column::BETA + i - 1,
            ParamId::Tool(axis) => column::TOOL + axis,
            ParamId::Centre(_, axis) => column::CENTRE + axis,
            ParamId::BarOffset => column::BAR,
            ParamId::Compliance(j) => column::COMPLIANCE + j - 2,
            ParamId::GearCos(j) => column::GEAR_COS + j - 1,
            ParamId::GearSin(j) => column::GEAR_SIN + j - 1,
        }
    }
}

impl Geometry {
    /// The joint angles (rad, in the table's sense) at the controller's axis angles (rad).
    pub(super) fn joint_angles(&self, axes: &[f64; AXES]) -> [f64; AXES] {
        let mut angles = [0.0; AXES];
        for i in 0..AXES {
            let [cos_part, sin_part] = self.gear[i];
            let (sin, cos) = axes[i].sin_cos();
            angles[i] = self.rows[i].sign * axes[i] + self.rows[i].theta + cos_part * cos + sin_part * sin;
        }
        if self.compliance.iter().any(|c| *c != 0.0) {
            let torques = self.torques(&angles);
            for i in 0..AXES {
                angles[i] += self.compliance[i] * torques[i];
            }
        }
        angles
    }

    /// Frame after each row, for joint angles in the table's sense.
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

    /// Gravity torque about each joint, N m, at joint angles in the table's sense. The base stands upright.
    fn torques(&self, angles: &[f64; AXES]) -> [f64; AXES] {
        let mut torques = [0.0; AXES];
        if self.masses.is_empty() {
            return torques;
        }
        let frames = self.frames(angles);
        for mass in &self.masses {
            let carrier = &frames[mass.joint - 1];
            let centre = carrier.position + carrier.rotation * mass.centre;
            let weight = Vector3::new(0.0, 0.0, -GRAVITY * mass.kg);
            for joint in 0..mass.joint {
                let lever = (centre - frames[joint].position) * 1e-3;
                torques[joint] += frames[joint].rotation.column(2).dot(&lever.cross(&weight));
            }
        }
        torques
    }

    /// The flange (frame 6) in the robot base at the controller's axis angles, rad.
    pub fn flange(&self, axes: &[f64; AXES]) -> Pose {
        self.frames(&self.joint_angles(axes))[AXES - 1]
    }

    /// The tool ball, with the flange's orientation, in the robot base at the axis angles, rad.
    pub fn ball(&self, axes: &[f64; AXES]) -> Pose {
        let flange = self.flange(axes);
        Pose { rotation: flange.rotation, position: flange.position + flange.rotation * self.tool }
    }

    /// Origins and z axes of the joints, then the flange: the robot as a line to draw, mm.
    pub fn skeleton(&self, axes: &[f64; AXES]) -> [Vector3<f64>; AXES] {
        self.frames(&self.joint_angles(axes)).map(|frame| frame.position)
    }

    /// The Jacobian of the tool ball in the base frame: six columns of (dp, turn) per rad of each
    /// *controller* axis, mm/rad and rad/rad.
    pub fn axis_jacobian(&self, axes: &[f64; AXES]) -> [(Vector3<f64>, Vector3<f64>); AXES] {
        let frames = self.frames(&self.joint_angles(axes));
        let ball = frames[AXES - 1].position + frames[AXES - 1].rotation * self.tool;
        let mut columns = [(Vector3::zeros(), Vector3::zeros()); AXES];
        for i in 0..AXES {
            let z: Vector3<f64> = frames[i].rotation.column(2) * self.rows[i].sign;
            columns[i] = (z.cross(&(ball - frames[i].position)), z);
        }
        columns
    }

    /// The length between the tool ball and a base ball at `centre` (mm, robot base), plus `bar_offset`, mm.
    pub fn length(&self, axes: &[f64; AXES], centre: &Vector3<f64>, bar_offset: f64) -> f64 {
        (self.ball(axes).position - centre).norm() + bar_offset
    }

    /// The length and its derivative by every parameter. Where the balls coincide the length has no
    /// derivative, and the columns are zero.
    pub fn length_row(&self, axes: &[f64; AXES], centre: &Vector3<f64>, bar_offset: f64) -> LengthRow {
        let angles = self.joint_angles(axes);
        // Origins and axes that the screws need, in chain order.
        let mut before = [(Vector3::zeros(), Vector3::zeros(), Vector3::zeros()); AXES];
        let mut joints = [(Vector3::zeros(), Vector3::zeros()); AXES];
        let mut rotation = Matrix3::identity();
        let mut origin = Vector3::zeros();
        for (i, row) in self.rows.iter().enumerate() {
            let y = rotation.column(1).into_owned();
            if row.beta != 0.0 {
                rotation *= rot_y(row.beta);
            }
            let x = rotation.column(0).into_owned();
            before[i] = (origin, x, y);
            // The twist turns about x, the joint about z: only two columns change in each.
            let (s, c) = row.alpha.sin_cos();
            let (y, z) = (rotation.column(1).into_owned(), rotation.column(2).into_owned());
            let (y, z) = (y * c + z * s, z * c - y * s);
            origin += x * row.a;
            joints[i] = (origin, z);
            let (s, c) = angles[i].sin_cos();
            rotation = Matrix3::from_columns(&[x * c + y * s, y * c - x * s, z]);
            origin += z * row.d;
        }
        let ball = origin + rotation * self.tool;
        let bar = ball - centre;
        let distance = bar.norm();
        let mut columns = [0.0; column::COUNT];
        if distance > 0.0 {
            let u = bar / distance;
            for i in 0..AXES {
                let (origin, x, y) = before[i];
                let moment = (ball - origin).cross(&u);
                columns[column::ALPHA + i] = x.dot(&moment);
                columns[column::A + i] = x.dot(&u);
                if i > 0 {
                    columns[column::BETA + i - 1] = y.dot(&moment);
                }
                let (origin, z) = joints[i];
                columns[column::THETA + i] = z.dot(&(ball - origin).cross(&u));
                columns[column::D + i] = z.dot(&u);
            }
            for axis in 0..3 {
                columns[column::TOOL + axis] = rotation.column(axis).dot(&u);
                columns[column::CENTRE + axis] = -u[axis];
            }
            columns[column::BAR] = 1.0;
            let torques = self.torques(&angles);
            for j in 2..=5 {
                columns[column::COMPLIANCE + j - 2] = columns[column::THETA + j - 1] * torques[j - 1];
            }
            for j in 0..AXES {
                let (sin, cos) = axes[j].sin_cos();
                columns[column::GEAR_COS + j] = columns[column::THETA + j] * cos;
                columns[column::GEAR_SIN + j] = columns[column::THETA + j] * sin;
            }
        }
        LengthRow { length: distance + bar_offset, columns }
    }

    /// The value of a parameter of the robot or its tool; `None` for those of the set-up's balls and bar.
    pub fn value(&self, id: ParamId) -> Option<f64> {
        Some(match id {
            ParamId::Alpha(i) => self.rows[i].alpha,
            ParamId::A(i) => self.rows[i].a,
            ParamId::Theta(i) => self.rows[i - 1].theta,
            ParamId::D(i) => self.rows[i - 1].d,
            ParamId::Beta(i) => self.rows[i].beta,
            ParamId::Tool(axis) => self.tool[axis],
            ParamId::Compliance(j) => self.compliance[j - 1],
            ParamId::GearCos(j) => self.gear[j - 1][0],
            ParamId::GearSin(j) => self.gear[j - 1][1],
            ParamId::Centre(..) | ParamId::BarOffset => return None,
        })
    }

    /// Mutable access as [`Geometry::value`].
    pub fn value_mut(&mut self, id: ParamId) -> Option<&mut f64> {
        Some(match id {
            ParamId::Alpha(i) => &mut self.rows[i].alpha,
            ParamId::A(i) => &mut self.rows[i].a,
            ParamId::Theta(i) => &mut self.rows[i - 1].theta,
            ParamId::D(i) => &mut self.rows[i - 1].d,
            ParamId::Beta(i) => &mut self.rows[i].beta,
            ParamId::Tool(axis) => &mut self.tool[axis],
            ParamId::Compliance(j) => &mut self.compliance[j - 1],
            ParamId::GearCos(j) => &mut self.gear[j - 1][0],
            ParamId::GearSin(j) => &mut self.gear[j - 1][1],
            ParamId::Centre(..) | ParamId::BarOffset => return None,
        })
    }
}
