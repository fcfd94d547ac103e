//! A circle of the job: its plane, its points in order, and the orientation of the tool.

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::PlannedCircle;
use super::job::{CircleDirection, CircleTable, Job, OrientationPattern, PlaneAxes};
use crate::plan::job::JobFinding;
use dbbd_model::robot::pose::{Pose, rot_x, rot_y, rot_z};

/// Points between two visits of the reference pose.
pub const REFERENCE_EVERY: u32 = 20;

/// Amplitude of an orientation pattern if the job states none, degrees (the paper's).
const AMPLITUDE_DEG: f64 = 45.0;

impl CircleTable {
    /// Number of dwells in the module of the circle: the points of all passes and the reference poses.
    pub(super) fn dwells(&self) -> u32 {
        let passes = if self.direction == CircleDirection::Both { 2 } else { 1 };
        let points = self.points.saturating_mul(passes);
        points.saturating_add(points.div_ceil(REFERENCE_EVERY))
    }

    pub(super) fn is_closed(&self) -> bool {
        self.arc_deg >= 360.0
    }

    /// Angle between neighbouring points, rad.
    pub(super) fn step(&self) -> f64 {
        let gaps = if self.is_closed() { self.points } else { self.points.saturating_sub(1).max(1) };
        self.arc_deg.to_radians() / f64::from(gaps)
    }

    /// Angle of a continuous pass with its feed-in and overshoot, degrees.
    pub(super) fn sweep_deg(&self) -> f64 {
        self.arc_deg + 2.0 * self.overshoot_deg
    }

    /// Whether the first pass of the circle, or its `second`, goes against growing angles.
    pub(super) fn is_clockwise(&self, second: bool) -> bool {
        match self.direction {
            CircleDirection::Ccw => false,
            CircleDirection::Cw => true,
            CircleDirection::Both => second,
        }
    }

    /// The angles of the points in the order in which they are visited, rad from the first, not wrapped: the path between
    /// two of them goes through the angles between them.
    pub(super) fn angles(&self) -> Vec<f64> {
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

impl<'a> PlannedCircle<'a> {
    /// The circle number `number` (from 1) of the job; an error only in a job that was not checked.
    pub(super) fn new(job: &Job, table: &'a CircleTable, number: u32) -> Result<Self, JobFinding> {
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
    fn direction(&self, angle: f64) -> Vector3<f64> {
        let (sin, cos) = (self.start + angle).sin_cos();
        self.first * cos + self.second * sin
    }

    /// Angle at which a point is seen from the base ball, degrees from the plane's first axis, 0..360.
    pub(super) fn angle_deg(&self, point: Vector3<f64>) -> f64 {
        let out = point - self.centre;
        let angle = out.dot(&self.second).atan2(out.dot(&self.first)).to_degrees().rem_euclid(360.0);
        // A tiny negative angle wraps to 360 itself.
        if angle < 360.0 { angle } else { 0.0 }
    }

    /// The tool's orientation at `angle` (rad from the first point), the same in both passes.
    pub(super) fn orientation(&self, angle: f64) -> Matrix3<f64> {
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
    pub(super) fn turned(&self, [a, b, c]: [f64; 3]) -> Matrix3<f64> {
        rot_z(a) * rot_y(b) * rot_x(c) * self.down
    }

    /// The number of the point at an angle, from 0, the same in both passes.
    pub(super) fn point(&self, angle: f64) -> u64 {
        let step = self.table.step();
        let whole = (std::f64::consts::TAU / step).round().max(1.0);
        (angle / step).round().rem_euclid(whole) as u64
    }

    /// Seed of the random orientations at an angle.
    pub(super) fn seed(&self, angle: f64) -> u64 {
        self.seed.wrapping_add(self.point(angle))
    }

    /// The pose of the tool ball at `angle`, `out` mm outside the circle.
    pub(super) fn pose(&self, angle: f64, out: f64) -> Pose {
        let rotation = self.orientation(angle);
        Pose { rotation, position: self.centre + self.direction(angle) * (self.radius + out) }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::plan::example::job;

    fn table(keys: &str) -> CircleTable {
        job(&format!("[[circle]]\n{keys}")).circles.remove(0)
    }

    fn degrees(angles: &[f64]) -> Vec<f64> {
        angles.iter().map(|angle| angle.to_degrees().round()).collect()
    }

    /// The passes of an open arc begin at its two ends; on a closed circle both begin at the first point.
    #[test]
    fn second_pass_goes_back_over_the_points_of_the_first() {
        let open = table("plane = \"XY\"\npoints = 4\narc_deg = 90.0\ndirection = \"both\"\n");
        assert_eq!(degrees(&open.angles()), [0.0, 30.0, 60.0, 90.0, 90.0, 60.0, 30.0, 0.0]);
        let closed = table("plane = \"XY\"\npoints = 4\ndirection = \"both\"\n");
        assert_eq!(degrees(&closed.angles()), [0.0, 90.0, 180.0, 270.0, 360.0, 270.0, 180.0, 90.0]);
        let clockwise = table("plane = \"XY\"\npoints = 3\ndirection = \"cw\"\n");
        assert_eq!(degrees(&clockwise.angles()), [0.0, -120.0, -240.0]);
        assert_eq!([closed.is_clockwise(false), closed.is_clockwise(true)], [false, true]);
        assert_eq!([clockwise.is_clockwise(false), clockwise.is_clockwise(true)], [true, true]);
    }

    /// A visit of the reference for each twenty points begun.
    #[test]
    fn dwells_are_the_points_and_the_visits_of_the_reference() {
        for (points, direction, dwells) in
            [(80, "ccw", 84), (81, "cw", 86), (80, "both", 168), (4, "both", 9), (20, "ccw", 21)]
        {
            let keys = format!("plane = \"XY\"\npoints = {points}\ndirection = \"{direction}\"\n");
            assert_eq!(table(&keys).dwells(), dwells, "{points} {direction}");
        }
    }

    #[test]
    fn continuous_pass_has_feed_in_and_overshoot() {
        let keys = "plane = \"XY\"\npoints = 50\narc_deg = 220.0\nmode = \"continuous\"\novershoot_deg = 12.0\n\
                    orientation = \"fixed\"\n";
        assert_eq!(table(keys).sweep_deg(), 244.0);
        assert!((table(keys).step().to_degrees() - 220.0 / 49.0).abs() < 1e-12);
    }

    #[test]
    fn point_is_at_its_angle_in_the_plane() {
        let quarter = "points = 8\nradius_mm = 300.5\nstart_deg = 30.0\n";
        let (radius, sine, cosine) = (300.5, 0.5, 0.75_f64.sqrt());
        for (plane, expected) in [
            ("plane = \"XY\"\n", [radius * cosine, radius * sine, 0.0]),
            ("plane = \"XZ\"\n", [radius * cosine, 0.0, radius * sine]),
            ("plane = \"YZ\"\n", [0.0, radius * cosine, radius * sine]),
            // X is in the plane, and the plane's second axis is -Z.
            ("normal = [0.0, 2.0, 0.0]\n", [radius * cosine, 0.0, -radius * sine]),
            // X is normal to the plane: Y is its first axis.
            ("normal = [1.0, 0.0, 0.0]\n", [0.0, radius * cosine, radius * sine]),
        ] {
            let job = job(&format!("[[circle]]\n{plane}{quarter}"));
            let circle = PlannedCircle::new(&job, &job.circles[0], 1).expect("the circle is possible");
            let point = circle.pose(0.0, 0.0).position;
            let offset = point - Vector3::new(1300.0, 0.0, 800.0);
            assert!((offset - Vector3::from(expected)).norm() < 1e-9, "{plane}: {offset}");
            assert!((circle.angle_deg(point) - 30.0).abs() < 1e-9);
            let outside = circle.pose(FRAC_PI_2, 0.7);
            assert!(((outside.position - circle.centre).norm() - 301.2).abs() < 1e-9);
            assert!((circle.angle_deg(outside.position) - 120.0).abs() < 1e-9);
        }
    }

    /// R = Rz(q sin 2t) Ry(q sin 3t) Rx(q sin 5t) Ry(tilt) Rx(180) Rz(spin). At t = 90 degrees the sines are 0, -1 and 1.
    #[test]
    fn seed_pattern_has_two_three_and_five_swings() {
        let keys = "plane = \"XY\"\npoints = 8\namplitude_deg = 20.0\ntilt_deg = 10.0\nspin_deg = 30.0\n";
        let job = job(&format!("[[circle]]\n{keys}"));
        let circle = PlannedCircle::new(&job, &job.circles[0], 1).expect("the circle is possible");
        let (q, degree) = (20.0_f64.to_radians(), PI / 180.0);
        let down = rot_y(10.0 * degree) * rot_x(PI) * rot_z(30.0 * degree);
        assert!((circle.orientation(0.0) - down).norm() < 1e-12);
        assert!((circle.orientation(FRAC_PI_2) - rot_y(-q) * rot_x(q) * down).norm() < 1e-12);
        // At 30 degrees they are sqrt(3) / 2, 1 and 1 / 2.
        let expected = rot_z(q * 0.75_f64.sqrt()) * rot_y(q) * rot_x(0.5 * q) * down;
        assert!((circle.orientation(30.0 * degree) - expected).norm() < 1e-12);
    }

    #[test]
    fn orientation_of_a_point_is_the_same_in_both_passes() {
        for orientation in ["seed", "random", "turning", "fixed", "optimal"] {
            let keys = format!(
                "plane = \"XY\"\npoints = 6\ndirection = \"both\"\norientation = \"{orientation}\"\n"
            );
            let mut job = job(&format!("[[circle]]\n{keys}"));
            job.circles[0].turns_deg = (0..6).map(|at| [f64::from(at), 0.0, 7.0]).collect();
            let circle = PlannedCircle::new(&job, &job.circles[0], 1).expect("the circle is possible");
            let angles = job.circles[0].angles();
            let (forward, backward) = angles.split_at(6);
            for angle in forward {
                let same = backward.iter().find(|back| circle.point(**back) == circle.point(*angle));
                let back = same.expect("each point is passed twice");
                let difference = circle.orientation(*angle) - circle.orientation(*back);
                assert!(difference.norm() < 1e-9, "{orientation} {angle}");
            }
        }
    }

    #[test]
    fn tool_turns_with_the_bar_or_as_chosen() {
        let job_of = |keys: &str| job(&format!("[[circle]]\nplane = \"XY\"\npoints = 6\n{keys}"));
        let turning = job_of("orientation = \"turning\"\nstart_deg = 20.0\n");
        let circle = PlannedCircle::new(&turning, &turning.circles[0], 1).expect("the circle is possible");
        let expected = rot_z(50.0_f64.to_radians()) * rot_x(PI);
        assert!((circle.orientation(30.0_f64.to_radians()) - expected).norm() < 1e-12);
        let mut optimal = job_of("orientation = \"optimal\"\n");
        optimal.circles[0].turns_deg = vec![[0.0; 3], [0.0; 3], [10.0, 20.0, 30.0]];
        let circle = PlannedCircle::new(&optimal, &optimal.circles[0], 1).expect("the circle is possible");
        let [a, b, c] = [10.0_f64, 20.0, 30.0].map(f64::to_radians);
        let expected = rot_z(a) * rot_y(b) * rot_x(c) * rot_x(PI);
        assert!((circle.orientation(120.0_f64.to_radians()) - expected).norm() < 1e-12);
        assert_eq!(circle.point((-120.0_f64).to_radians()), 4);
    }
}
