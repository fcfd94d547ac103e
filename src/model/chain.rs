//! The forward pass that the solver asks for a million times: one walk inwards along the chain gives
//! the ball, one walk outwards the derivatives of the length by every parameter.
//!
//! With u the unit vector from the base ball to the tool ball p, every geometric parameter moves p
//! by a unit screw, so its column is the reciprocal product of that screw with the line of the bar:
//! `w . (p x u)` for a turn about the axis w through the origin, `w . u` for a shift along w. The screw
//! of a row lies on an axis of the row's own frame: p is carried inwards and u outwards into that frame,
//! where the product is one component. No matrix is formed, and no sine is taken: those of the
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

/// A length and its derivatives by every parameter (mm per mm, mm per rad, mm per rad/(N m)); the default is room
/// for one.
#[derive(Clone, Debug)]
pub struct LengthRow {
    /// Distance between the ball centres plus the bar offset, mm.
    pub length: f64,
    /// The bar it was read with, from 0.
    pub bar: usize,
    columns: [f64; column::COUNT],
}

impl Default for LengthRow {
    fn default() -> Self {
        Self { length: 0.0, bar: 0, columns: [0.0; column::COUNT] }
    }
}

impl LengthRow {
    /// Number of values in [`LengthRow::columns`].
    pub const COLUMNS: usize = column::COUNT;

    /// All columns; [`LengthRow::position`] tells which is which.
    pub fn columns(&self) -> &[f64; Self::COLUMNS] {
        &self.columns
    }

    /// Where the derivative by `id` stands. A centre's columns are those of the row's own base ball, the
    /// bar's that of its own bar: the derivatives by other balls and bars are zero.
    pub fn position(id: ParamId) -> usize {
        match id {
            ParamId::Alpha(i) => column::ALPHA + i,
            ParamId::A(i) => column::A + i,
            ParamId::Theta(i) => column::THETA + i - 1,
            ParamId::D(i) => column::D + i - 1,
            ParamId::Beta(i) => column::BETA + i - 1,
            ParamId::Tool(axis) => column::TOOL + axis,
            ParamId::Centre(_, axis) => column::CENTRE + axis,
            ParamId::BarOffset(_) => column::BAR,
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
        let mut row = LengthRow::default();
        Chain::new(self).row(axes, &Turns::of(axes), centre, bar_offset, &mut row);
        row
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

/// The walk inwards at some axis angles.
struct Reach {
    /// Sine and cosine of each joint angle in the table's sense.
    joints: [(f64, f64); AXES],
    /// The tool ball in the frame of each row after its twist, before its shift along x.
    points: [Vector3<f64>; AXES],
    /// The tool ball in the robot base.
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
    #[inline]
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

    /// From the flange inwards: each row turns and shifts one point.
    #[inline]
    fn reach(&self, axes: &[f64; AXES], turns: &Turns) -> Reach {
        let joints = self.joints(axes, turns);
        let mut points = [Vector3::zeros(); AXES];
        let mut point = self.geometry.tool;
        for i in (0..AXES).rev() {
            let row = &self.geometry.rows[i];
            let (s, c) = joints[i];
            let (x, y, z) = (point.x * c - point.y * s + row.a, point.x * s + point.y * c, point.z + row.d);
            points[i] = Vector3::new(x, y, z);
            let (s, c) = self.alpha[i];
            point = Vector3::new(x, y * c - z * s, y * s + z * c);
            if row.beta != 0.0 {
                let (s, c) = self.beta[i];
                point = Vector3::new(point.x * c + point.z * s, point.y, point.z * c - point.x * s);
            }
        }
        Reach { joints, points, ball: point }
    }

    /// From the base outwards: the derivatives of the ball's place along the unit vector `u` (robot
    /// base) by the parameters of the robot and its tool.
    #[inline]
    fn derivatives(&self, reach: &Reach, mut u: Vector3<f64>, columns: &mut [f64; column::COUNT]) {
        for i in 0..AXES {
            if self.geometry.rows[i].beta != 0.0 {
                let (s, c) = self.beta[i];
                u = Vector3::new(u.x * c - u.z * s, u.y, u.z * c + u.x * s);
            }
            let p = &reach.points[i];
            let (s, c) = self.alpha[i];
            if i > 0 {
                columns[column::BETA + i - 1] = (p.y * s + p.z * c) * u.x - p.x * u.z;
            }
            u = Vector3::new(u.x, u.y * c + u.z * s, u.z * c - u.y * s);
            columns[column::ALPHA + i] = p.y * u.z - p.z * u.y;
            columns[column::A + i] = u.x;
            columns[column::THETA + i] = (p.x - self.geometry.rows[i].a) * u.y - p.y * u.x;
            columns[column::D + i] = u.z;
            let (s, c) = reach.joints[i];
            u = Vector3::new(u.x * c + u.y * s, u.y * c - u.x * s, u.z);
        }
        columns[column::TOOL..column::TOOL + 3].copy_from_slice(u.as_slice());
    }

    /// The tool ball in the robot base, mm.
    pub fn ball(&self, axes: &[f64; AXES], turns: &Turns) -> Vector3<f64> {
        self.reach(axes, turns).ball
    }

    /// The length from a base ball at `centre` plus `bar_offset` (mm), and its derivatives, into `row`, which is new
    /// or was filled for this robot before. Where the balls coincide the length has no derivative, and the columns
    /// are zero.
    #[inline]
    pub fn row(
        &self,
        axes: &[f64; AXES],
        turns: &Turns,
        centre: &Vector3<f64>,
        bar_offset: f64,
        row: &mut LengthRow,
    ) {
        let reach = self.reach(axes, turns);
        let bar = reach.ball - centre;
        let distance = bar.norm();
        row.length = distance + bar_offset;
        let columns = &mut row.columns;
        if distance > 0.0 {
            let u = bar / distance;
            self.derivatives(&reach, u, columns);
            for axis in 0..3 {
                columns[column::CENTRE + axis] = -u[axis];
            }
            columns[column::BAR] = 1.0;
            self.non_geometric(axes, turns, columns);
        } else {
            *columns = [0.0; column::COUNT];
        }
    }

    /// Compliance and gear error turn the joints: their columns are shares of theta's.
    #[inline]
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
        let reach = self.reach(axes, &turns);
        let along = [0, 1, 2].map(|axis| {
            let mut columns = [0.0; column::COUNT];
            self.derivatives(&reach, Vector3::ith(axis, 1.0), &mut columns);
            self.non_geometric(axes, &turns, &mut columns);
            columns
        });
        for (at, id) in ids.iter().enumerate() {
            let place = LengthRow::position(*id);
            each(at, Vector3::from_fn(|axis, _| along[axis][place]));
        }
        reach.ball
    }
}
