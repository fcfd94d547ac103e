//! A circle of the job: its plane, its points in order, and the orientation of the tool.

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::job::{CircleDirection, CircleTable, Job, OrientationPattern, PlaneAxes};
use crate::plan::job::JobFinding;
use dbbd_model::robot::pose::{Pose, rot_x, rot_y, rot_z};

/// Points between two visits of the reference pose.
pub const REFERENCE_EVERY: u32 = 20;

/// Amplitude of an orientation pattern when the job does not say, degrees (the paper's).
const AMPLITUDE_DEG: f64 = 45.0;

impl CircleTable {
    /// Dwells in its module: the points of all passes and the reference poses.
    pub(crate) fn dwells(&self) -> u32 {
        let passes = if self.direction == CircleDirection::Both { 2 } else { 1 };
        let points = self.points.saturating_mul(passes);
        points.saturating_add(points.div_ceil(REFERENCE_EVERY))
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.arc_deg >= 360.0
    }

    /// Angle between neighbours, rad.
    pub(crate) fn step(&self) -> f64 {
        let gaps = if self.is_closed() { self.points } else { self.points.saturating_sub(1).max(1) };
        self.arc_deg.to_radians() / f64::from(gaps)
    }

    /// Angle of a continuous pass with its feed-in and overshoot, degrees.
    pub(crate) fn sweep_deg(&self) -> f64 {
        self.arc_deg + 2.0 * self.overshoot_deg
    }

    /// Whether its first pass, or its `second`, goes against growing angles.
    pub(crate) fn is_clockwise(&self, second: bool) -> bool {
        match self.direction {
            CircleDirection::Ccw => false,
            CircleDirection::Cw => true,
            CircleDirection::Both => second,
        }
    }

    /// The angles of the points in the order in which they are visited, rad from the first, not wrapped: the path between
    /// two of them goes through the angles between them.
    pub(crate) fn angles(&self) -> Vec<f64> {
        let step = self.step();
        let last = if self.is_closed() { self.points } else { self.points.saturating_sub(1) };
        let growing = (0..self.points).map(|i| f64::from(i) * step);
        match self.direction {
            CircleDirection::Ccw => growing.collect(),
            CircleDirection::Cw => growing.map(|angle| -angle).collect(),
            CircleDirection::Both => {
                growing.chain((0..self.points).map(|i| f64::from(last - i) * step)).collect()
            }
        }
    }
}

/// A circle in the robot base, mm and rad.
pub(crate) struct PlannedCircle<'a> {
    pub(crate) number: u32,
    table: &'a CircleTable,
    pub(crate) centre: Vector3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    pub(crate) radius: f64,
    start: f64,
    /// Greatest turn of the tool about each axis.
    pub(crate) amplitude: f64,
    /// The base orientation of the tool.
    down: Matrix3<f64>,
    seed: u64,
}

impl<'a> PlannedCircle<'a> {
    /// The circle number `number` (from 1) of the job; an error only in a job that was not checked.
    pub(crate) fn new(job: &Job, table: &'a CircleTable, number: u32) -> Result<Self, JobFinding> {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let (first, second) = match (table.plane, table.normal) {
            (Some(PlaneAxes::Xy), _) => (x, y),
            (Some(PlaneAxes::Xz), _) => (x, z),
            (Some(PlaneAxes::Yz), _) => (y, z),
            (None, normal) => {
                let normal = normal.ok_or(JobFinding::NoPlane { circle: number as usize })?;
                let normal = Vector3::from(normal).normalize();
                // The first axis is X seen in the plane; Y where X is normal to it.
                let along = if normal.x.abs() < 0.999 { x } else { y };
                let first = (along - normal * normal.dot(&along)).normalize();
                (first, normal.cross(&first))
            }
        };
        let centre = job.ball(table.centre).ok_or(JobFinding::NoSuchBall {
            circle: number as usize,
            centre: table.centre as usize,
            balls: job.centres.len(),
        })?;
        Ok(Self {
            number,
            table,
            centre: Vector3::from(centre.xyz_mm),
            first,
            second,
            radius: table.radius_mm.unwrap_or(job.bar.length_mm),
            start: table.start_deg.to_radians(),
            amplitude: table.amplitude_deg.unwrap_or(AMPLITUDE_DEG).to_radians(),
            down: rot_y(table.tilt_deg.to_radians())
                * rot_x(std::f64::consts::PI)
                * rot_z(table.spin_deg.to_radians()),
            seed: u64::from(job.seed) << 32 | u64::from(number) << 16,
        })
    }

    /// Unit vector from the base ball to the point at `angle` (rad from the first point).
    pub(crate) fn direction(&self, angle: f64) -> Vector3<f64> {
        let (sin, cos) = (self.start + angle).sin_cos();
        self.first * cos + self.second * sin
    }

    /// Angle at which a point is seen from the base ball, degrees from the plane's first axis, 0..360.
    pub(crate) fn angle_deg(&self, point: Vector3<f64>) -> f64 {
        let out = point - self.centre;
        let angle = out.dot(&self.second).atan2(out.dot(&self.first)).to_degrees().rem_euclid(360.0);
        // A tiny negative angle wraps to 360 itself.
        if angle < 360.0 { angle } else { 0.0 }
    }

    /// The tool's orientation at `angle` (rad from the first point), the same in both passes.
    pub(crate) fn orientation(&self, angle: f64) -> Matrix3<f64> {
        let down = self.down;
        let (t, q) = (self.start + angle, self.amplitude);
        match self.table.orientation {
            OrientationPattern::Fixed => down,
            OrientationPattern::Turning => rot_z(t) * down,
            OrientationPattern::Seed => {
                rot_z(q * (2.0 * t).sin()) * rot_y(q * (3.0 * t).sin()) * rot_x(q * (5.0 * t).sin()) * down
            }
            OrientationPattern::Random => {
                let mut rng = Pcg64::seed_from_u64(self.seed(angle));
                let mut drawn = || rng.random_range(-1.0..=1.0) * q;
                let (a, b, c) = (drawn(), drawn(), drawn());
                self.turned([a, b, c])
            }
            OrientationPattern::Optimal => {
                let turn = self.table.turns_deg.get(self.point(angle) as usize);
                let turn = turn.copied().unwrap_or_default();
                self.turned(turn.map(f64::to_radians))
            }
        }
    }

    /// The tool turned about Z, Y, X by these angles (rad) from its base orientation.
    pub(crate) fn turned(&self, [a, b, c]: [f64; 3]) -> Matrix3<f64> {
        rot_z(a) * rot_y(b) * rot_x(c) * self.down
    }

    /// The number of the point at an angle, from 0, the same in both passes.
    pub(crate) fn point(&self, angle: f64) -> u64 {
        let step = self.table.step();
        let whole = (std::f64::consts::TAU / step).round().max(1.0);
        (angle / step).round().rem_euclid(whole) as u64
    }

    /// Seed of the random orientations at an angle.
    pub(crate) fn seed(&self, angle: f64) -> u64 {
        self.seed.wrapping_add(self.point(angle))
    }

    /// The pose of the tool ball at `angle`, `out` mm outside the circle.
    pub(crate) fn pose(&self, angle: f64, out: f64) -> Pose {
        let rotation = self.orientation(angle);
        Pose { rotation, position: self.centre + self.direction(angle) * (self.radius + out) }
    }
}
