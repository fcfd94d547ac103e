//! The forward pass that the solver asks for a million times: one walk along the chain gives the
//! ball, the length, and its derivatives by every parameter.
//!
//! With u the unit vector from the base ball to the tool ball p, every geometric parameter moves p
//! by a unit screw fixed in some frame of the chain, so its column is the reciprocal product of that
//! screw with the line of the bar: `u . (w x (p - o))` for a turn about the unit axis w through o,
//! `u . w` for a shift along w. No matrix derivative is formed, and no sine is taken: those of the
//! table are taken once for a model, those of the axis angles once for a reading.

use nalgebra::Vector3;

use super::{AXES, Geometry, ParamId};

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
    /// The length and its derivative by every parameter. Where the balls coincide the length has no
    /// derivative, and the columns are zero.
    pub fn length_row(&self, axes: &[f64; AXES], centre: &Vector3<f64>, bar_offset: f64) -> LengthRow {
        Chain::new(self).row(axes, &Turns::of(axes), centre, bar_offset)
    }
}

/// Sine and cosine of each axis angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turns(pub [[f64; 2]; AXES]);

impl Turns {
    /// Of the controller's axis angles, rad.
    pub fn of(axes: &[f64; AXES]) -> Self {
        Self(axes.map(|angle| angle.sin_cos().into()))
    }
}

/// A geometry with the sines and cosines of its table.
#[derive(Clone, Debug)]
pub struct Chain<'a> {
    geometry: &'a Geometry,
    alpha: [(f64, f64); AXES],
    theta: [(f64, f64); AXES],
    beta: [(f64, f64); AXES],
    /// Whether the joints are where the axes say: no compliance, no gear error.
    rigid: bool,
}

/// The screws of a pose: where each parameter's axis goes through, and its direction.
struct Screws {
    /// Before each row: origin, x (alpha, a) and y (beta).
    before: [[Vector3<f64>; 3]; AXES],
    /// At each joint: origin and z (theta, d).
    joint: [[Vector3<f64>; 2]; AXES],
    /// Axes of the flange.
    flange: [Vector3<f64>; 3],
    ball: Vector3<f64>,
}

impl<'a> Chain<'a> {
    /// Of a geometry.
    pub fn new(geometry: &'a Geometry) -> Self {
        let rigid = geometry.compliance.iter().all(|c| *c == 0.0)
            && geometry.gear.iter().flatten().all(|g| *g == 0.0);
        let rows = &geometry.rows;
        Self {
            geometry,
            alpha: std::array::from_fn(|i| rows[i].alpha.sin_cos()),
            theta: std::array::from_fn(|i| rows[i].theta.sin_cos()),
            beta: std::array::from_fn(|i| rows[i].beta.sin_cos()),
            rigid,
        }
    }

    /// Sine and cosine of each joint angle in the table's sense.
    fn joints(&self, axes: &[f64; AXES], turns: &Turns) -> [(f64, f64); AXES] {
        if !self.rigid {
            return self.geometry.joint_angles(axes).map(f64::sin_cos);
        }
        std::array::from_fn(|i| {
            let (sin, cos) = (self.geometry.rows[i].sign * turns.0[i][0], turns.0[i][1]);
            let (sin_offset, cos_offset) = self.theta[i];
            (sin * cos_offset + cos * sin_offset, cos * cos_offset - sin * sin_offset)
        })
    }

    fn screws(&self, axes: &[f64; AXES], turns: &Turns) -> Screws {
        let joints = self.joints(axes, turns);
        let [mut x, mut y, mut z] = [0, 1, 2].map(|axis| Vector3::ith(axis, 1.0));
        let mut origin = Vector3::zeros();
        let mut before = [[Vector3::zeros(); 3]; AXES];
        let mut joint = [[Vector3::zeros(); 2]; AXES];
        for (i, row) in self.geometry.rows.iter().enumerate() {
            if row.beta != 0.0 {
                let (s, c) = self.beta[i];
                (x, z) = (x * c - z * s, z * c + x * s);
            }
            before[i] = [origin, x, y];
            let (s, c) = self.alpha[i];
            (y, z) = (y * c + z * s, z * c - y * s);
            origin += x * row.a;
            joint[i] = [origin, z];
            let (s, c) = joints[i];
            (x, y) = (x * c + y * s, y * c - x * s);
            origin += z * row.d;
        }
        let tool = &self.geometry.tool;
        let ball = origin + x * tool.x + y * tool.y + z * tool.z;
        Screws { before, joint, flange: [x, y, z], ball }
    }

    /// The tool ball in the robot base, mm.
    pub fn ball(&self, axes: &[f64; AXES], turns: &Turns) -> Vector3<f64> {
        let joints = self.joints(axes, turns);
        let tool = &self.geometry.tool;
        let mut point = *tool;
        // From the flange inwards: each row turns and shifts one point.
        for i in (0..AXES).rev() {
            let row = &self.geometry.rows[i];
            let (s, c) = joints[i];
            let (px, py, pz) =
                (point.x * c - point.y * s + row.a, point.x * s + point.y * c, point.z + row.d);
            let (s, c) = self.alpha[i];
            point = Vector3::new(px, py * c - pz * s, py * s + pz * c);
            if row.beta != 0.0 {
                let (s, c) = self.beta[i];
                point = Vector3::new(point.x * c + point.z * s, point.y, point.z * c - point.x * s);
            }
        }
        point
    }

    /// The length from a base ball at `centre` plus `bar_offset` (mm), and its derivatives. Where
    /// the balls coincide the length has no derivative, and the columns are zero.
    pub fn row(
        &self,
        axes: &[f64; AXES],
        turns: &Turns,
        centre: &Vector3<f64>,
        bar_offset: f64,
    ) -> LengthRow {
        let screws = self.screws(axes, turns);
        let bar = screws.ball - centre;
        let distance = bar.norm();
        let mut columns = [0.0; column::COUNT];
        if distance > 0.0 {
            let u = bar / distance;
            for i in 0..AXES {
                let [origin, x, y] = &screws.before[i];
                let moment = (screws.ball - origin).cross(&u);
                columns[column::ALPHA + i] = x.dot(&moment);
                columns[column::A + i] = x.dot(&u);
                if i > 0 {
                    columns[column::BETA + i - 1] = y.dot(&moment);
                }
                let [origin, z] = &screws.joint[i];
                columns[column::THETA + i] = z.dot(&(screws.ball - origin).cross(&u));
                columns[column::D + i] = z.dot(&u);
            }
            for axis in 0..3 {
                columns[column::TOOL + axis] = screws.flange[axis].dot(&u);
                columns[column::CENTRE + axis] = -u[axis];
            }
            columns[column::BAR] = 1.0;
            self.non_geometric(axes, turns, &mut columns);
        }
        LengthRow { length: distance + bar_offset, columns }
    }

    /// Compliance and gear error turn the joints: their columns are shares of theta's.
    fn non_geometric(&self, axes: &[f64; AXES], turns: &Turns, columns: &mut [f64; column::COUNT]) {
        if !self.geometry.masses.is_empty() {
            let torques = self.geometry.torques(&self.geometry.joint_angles(axes));
            for j in 2..=5 {
                columns[column::COMPLIANCE + j - 2] = columns[column::THETA + j - 1] * torques[j - 1];
            }
        }
        for j in 0..AXES {
            columns[column::GEAR_COS + j] = columns[column::THETA + j] * turns.0[j][1];
            columns[column::GEAR_SIN + j] = columns[column::THETA + j] * turns.0[j][0];
        }
    }

    /// How each of the parameters moves the ball, mm per mm or per rad; those of the base balls and of
    /// the bar do not.
    pub fn ball_jacobian(
        &self,
        axes: &[f64; AXES],
        ids: &[ParamId],
        mut each: impl FnMut(usize, Vector3<f64>),
    ) -> Vector3<f64> {
        let turns = Turns::of(axes);
        let screws = self.screws(axes, &turns);
        let torques = self.geometry.torques(&self.geometry.joint_angles(axes));
        let turned = |axis: &Vector3<f64>, origin: &Vector3<f64>| axis.cross(&(screws.ball - origin));
        let joint = |j: usize| turned(&screws.joint[j - 1][1], &screws.joint[j - 1][0]);
        for (at, id) in ids.iter().enumerate() {
            let moved = match *id {
                ParamId::Alpha(i) => turned(&screws.before[i][1], &screws.before[i][0]),
                ParamId::A(i) => screws.before[i][1],
                ParamId::Theta(j) => joint(j),
                ParamId::D(j) => screws.joint[j - 1][1],
                ParamId::Beta(i) => turned(&screws.before[i][2], &screws.before[i][0]),
                ParamId::Tool(axis) => screws.flange[axis],
                ParamId::Centre(..) | ParamId::BarOffset => Vector3::zeros(),
                ParamId::Compliance(j) => joint(j) * torques[j - 1],
                ParamId::GearCos(j) => joint(j) * turns.0[j - 1][1],
                ParamId::GearSin(j) => joint(j) * turns.0[j - 1][0],
            };
            each(at, moved);
        }
        screws.ball
    }
}
