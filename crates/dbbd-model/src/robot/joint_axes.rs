//! The table of an arm from its joint axes as lines in space: for descriptions that are not in modified DH, and for tables
//! whose nearly parallel axes have their common normal far away.

use nalgebra::{Matrix3, Vector3};

use super::dh_row::DhRow;
use super::{AXES, Geometry, Pose};
use crate::plausibility::Quantity;

/// Axes with a smaller sine of the angle between them get Hayati's beta: their common normal is badly defined.
pub(super) const PARALLEL: f64 = 0.1;
/// Lines that are nearer than this meet, mm: rounding errors of published tables are larger.
const MEET_MM: f64 = 1e-9;

/// A joint axis where all joint angles are zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointAxis {
    /// Any point of the axis, mm.
    pub point: Vector3<f64>,
    /// Unit vector along the axis, in the sense of a positive angle.
    pub direction: Vector3<f64>,
}

/// A table with the poses of its first and its last frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmTable {
    pub rows: [DhRow; AXES],
    /// The base frame of the table in the frame of the lines.
    pub base: Pose,
    /// The given flange in the flange frame of the table.
    pub flange: Pose,
}

impl ArmTable {
    /// The table of an arm by its joint axes and its flange where all joint angles are zero.
    ///
    /// Each frame has its z along an axis and its x towards the next one: along the common normal, or, of nearly parallel axes,
    /// to the foot of the perpendicular from the frame's origin, with beta (Hayati 1983). The first frame is the given one, and
    /// the last one the given flange, as far as a row can express them; `base` and `flange` are what remains.
    pub fn of(axes: &[JointAxis; AXES], flange: &Pose) -> Self {
        let world = JointAxis { point: Vector3::zeros(), direction: Vector3::z() };
        let mut before = AxisToAxis::between(&world, &axes[0], &Vector3::zeros(), &Vector3::x());
        let base = frame(before.origin, before.x, world.direction);
        let rows = std::array::from_fn(|at| {
            let axis = &axes[at];
            let (next, origin, x) = match axes.get(at + 1) {
                Some(next) => {
                    let next = AxisToAxis::between(axis, next, &before.foot, &before.turned_x());
                    (Some(next), next.origin, next.x)
                }
                None => (None, axis.nearest(&flange.position), before.last_x(axis, flange)),
            };
            let (turned, w) = (before.turned_x(), axis.direction);
            let row = DhRow {
                alpha: before.alpha,
                a: before.a,
                theta: w.dot(&turned.cross(&x)).atan2(turned.dot(&x)),
                d: w.dot(&(origin - before.foot)),
                beta: before.beta,
                sign: 1.0,
            };
            before = next.unwrap_or(before);
            row
        });
        let last = &axes[AXES - 1];
        let end = frame(last.nearest(&flange.position), before.last_x(last, flange), last.direction);
        Self { rows, base, flange: end.inverse().then(flange) }
    }
}

impl JointAxis {
    /// The point of the axis that is nearest to another point, mm.
    fn nearest(&self, to: &Vector3<f64>) -> Vector3<f64> {
        self.point + self.direction * self.direction.dot(&(to - self.point))
    }
}

/// The way from one axis to the next: a row without its joint.
#[derive(Clone, Copy)]
struct AxisToAxis {
    /// The point where the way leaves the first axis, and the point where it meets the second axis.
    origin: Vector3<f64>,
    foot: Vector3<f64>,
    /// The x and the z of the frame on the first axis.
    x: Vector3<f64>,
    z: Vector3<f64>,
    alpha: f64,
    a: f64,
    beta: f64,
}

impl AxisToAxis {
    /// `origin` (a point of the first axis) and `x` are taken where the axes leave them free.
    fn between(from: &JointAxis, to: &JointAxis, origin: &Vector3<f64>, x: &Vector3<f64>) -> Self {
        let (z, w) = (from.direction, to.direction);
        let cross = z.cross(&w);
        let is_parallel = cross.norm() < PARALLEL;
        let (origin, foot) = if is_parallel {
            (*origin, to.nearest(origin))
        } else {
            let between = to.point - from.point;
            let along = |other: &Vector3<f64>| between.cross(other).dot(&cross) / cross.norm_squared();
            (from.point + z * along(&w), to.point + w * along(&z))
        };
        let towards = foot - origin;
        // Both senses of the x are right. The joint offset is below a right angle in this one.
        let along = |way: Vector3<f64>| if way.dot(x) < -MEET_MM { -way } else { way };
        let (x, a, beta) = if !is_parallel {
            let x = along(if towards.norm() > MEET_MM { towards } else { cross }.normalize());
            (x, towards.dot(&x), 0.0)
        } else if towards.norm() > MEET_MM {
            let x = along(normal_part(&towards, &z, x));
            let a = towards.norm().copysign(towards.dot(&x));
            (x, a, (-towards.dot(&z) / a).atan2(towards.dot(&x) / a))
        } else {
            let x = normal_part(x, &z, &any_other(&z));
            (x, 0.0, w.dot(&x).atan2(w.dot(&z)))
        };
        let turned_z = x * beta.sin() + z * beta.cos();
        let alpha = (-w.dot(&z.cross(&x))).atan2(w.dot(&turned_z));
        Self { origin, foot, x, z, alpha, a, beta }
    }

    /// The x after the turns of the row.
    fn turned_x(&self) -> Vector3<f64> {
        self.x * self.beta.cos() - self.z * self.beta.sin()
    }

    /// The x of the flange, as far as it is normal to the last axis.
    fn last_x(&self, last: &JointAxis, flange: &Pose) -> Vector3<f64> {
        normal_part(&flange.rotation.column(0).into(), &last.direction, &self.turned_x())
    }
}

/// The direction of the part of `vector` that is normal to a unit vector; of `other` if `vector` is along it.
fn normal_part(vector: &Vector3<f64>, unit: &Vector3<f64>, other: &Vector3<f64>) -> Vector3<f64> {
    let part = |vector: &Vector3<f64>| vector - unit * unit.dot(vector);
    part(vector).try_normalize(MEET_MM).unwrap_or_else(|| part(other).normalize())
}

/// A direction that is not along another one.
fn any_other(direction: &Vector3<f64>) -> Vector3<f64> {
    if direction.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() }
}

fn frame(origin: Vector3<f64>, x: Vector3<f64>, z: Vector3<f64>) -> Pose {
    Pose { rotation: Matrix3::from_columns(&[x, z.cross(&x), z]), position: origin }
}

impl Geometry {
    /// The joint axes of the rigid arm where all joint angles (in the sense of the table) are zero.
    pub fn joint_axes(&self) -> [JointAxis; AXES] {
        let frames = self.frames(&self.rows.map(|row| row.theta));
        frames.map(|frame| JointAxis { point: frame.position, direction: frame.rotation.column(2).into() })
    }

    /// Replaces offsets that no arm has: in a table without beta, nearly parallel axes have offsets of many metres that cancel
    /// each other. The arm stays the same.
    pub(super) fn shorten_offsets(&mut self) {
        if self.rows.iter().all(|row| Quantity::ArmLength.check("d_mm", row.d).is_ok()) {
            return;
        }
        let flange = self.frames(&self.rows.map(|row| row.theta))[AXES - 1];
        let ArmTable { rows, base, .. } = ArmTable::of(&self.joint_axes(), &flange);
        // Where the first axis is beside the base, the table would have another base frame.
        if base == Pose::identity() {
            self.rows = std::array::from_fn(|at| DhRow { sign: self.rows[at].sign, ..rows[at] });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    /// The flange of a table at angles that are added to those of the table.
    fn flange(rows: [DhRow; AXES], angles: [f64; AXES]) -> Pose {
        let geometry = Geometry {
            rows,
            ..Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry
        };
        geometry.frames(&std::array::from_fn(|at| rows[at].theta + angles[at]))[AXES - 1]
    }

    fn assert_same(rows: [DhRow; AXES], table: &ArmTable, within_mm: f64, what: &str) {
        for angles in [[0.0; AXES], [0.3, -0.8, 0.6, 1.1, -0.7, 2.0], [-2.0, 1.0, -1.5, 0.2, 2.4, -0.4]] {
            let expected = flange(rows, angles);
            let found = table.base.then(&flange(table.rows, angles)).then(&table.flange);
            let off = (found.position - expected.position).norm();
            assert!(
                off < within_mm && found.angle_to(&expected) < 1e-3 * within_mm,
                "{what} {angles:?}: {off}"
            );
        }
    }

    /// Spherical wrists, three parallel axes, offset wrists: the lines of a table give an arm with the same flange, and a base and
    /// flange of its own are not needed.
    #[test]
    fn the_lines_of_every_built_in_table_are_the_same_arm() {
        for (name, text) in Robot::built_in() {
            let geometry = Robot::from_toml(name, text).unwrap().geometry;
            let end = flange(geometry.rows, [0.0; AXES]);
            let table = ArmTable::of(&geometry.joint_axes(), &end);
            assert_same(geometry.rows, &table, 1e-8, name);
            assert!(table.base == Pose::identity(), "{name}: {:?}", table.base);
            assert!(table.flange.position.norm() < 1e-9 && table.flange.angle_to(&Pose::identity()) < 1e-9);
        }
    }

    /// A twist of 1e-4 between axes 2 and 3 puts their common normal 60 m away, as in the factory tables of arms with parallel axes.
    #[test]
    fn offsets_that_cancel_each_other_become_short() {
        let row = |alpha: f64, a, theta, d| DhRow { alpha, a, theta, d, beta: 0.0, sign: 1.0 };
        let half = std::f64::consts::FRAC_PI_2;
        let rows = [
            row(0.0, 0.0, 0.01, 127.3),
            row(half + 2e-4, 0.05, -0.02, 60_000.0),
            row(1e-4, -612.0, 0.03, -60_100.0),
            row(-2e-4, -572.3, -0.01, 264.0),
            row(half, 0.02, 0.0, 115.7),
            row(-half, 0.0, 0.0, 92.2),
        ];
        let arm = Geometry { rows, ..Robot::by_name("ur10").unwrap().unwrap().geometry };
        let mut short = arm.clone();
        short.shorten_offsets();
        let compact = short.rows;
        assert!(compact.iter().all(|row| row.d.abs() < 1000.0 && row.a.abs() < 1000.0), "{compact:?}");
        let table = ArmTable { rows: compact, base: Pose::identity(), flange: Pose::identity() };
        // Sixty metres times the rounding of an angle.
        assert_same(rows, &table, 1e-6, "factory table");
    }

    /// An axis that is inclined to the base has no place in a row: base and flange of the table are elsewhere, and say where.
    #[test]
    fn a_base_or_flange_that_no_row_expresses_is_returned() {
        let rows = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry.rows;
        let moved = Pose::from_kuka([10.0, 20.0, 30.0], [40.0, 50.0, 60.0]);
        let arm = Geometry {
            rows,
            ..Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry
        };
        let axes = arm.joint_axes().map(|axis| JointAxis {
            point: moved.position + moved.rotation * axis.point,
            direction: moved.rotation * axis.direction,
        });
        let tilted = Pose::from_kuka([1.0, 2.0, 3.0], [0.0, 90.0, 10.0]);
        let end = moved.then(&flange(rows, [0.0; AXES])).then(&tilted);
        let table = ArmTable::of(&axes, &end);
        for angles in [[0.0; AXES], [0.3, -0.8, 0.6, 1.1, -0.7, 2.0]] {
            let expected = moved.then(&flange(rows, angles)).then(&tilted);
            let found = table.base.then(&flange(table.rows, angles)).then(&table.flange);
            assert!((found.position - expected.position).norm() < 1e-8, "{angles:?}");
            assert!(found.angle_to(&expected) < 1e-11);
        }
    }
}
