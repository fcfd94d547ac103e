//! The motion of the controller between two rows: a straight line, an arc, or all axes together.

use nalgebra::{Matrix3, Rotation3, Vector3};

use dbbd_model::robot::pose::rotation_vector;
use dbbd_model::robot::{AXES, Pose, max_axis_difference};

/// Finest step along a path: of the ball in mm, of the tool's orientation or of an axis in degrees.
const STEP_MM: f64 = 1.0;
const STEP_DEG: f64 = 1.0;

/// A motion of the tool ball from one pose to the next.
#[derive(Clone, Debug, PartialEq)]
pub enum ToolBallPath {
    /// All axes start and stop together; axis angles in rad.
    Axes { from: [f64; AXES], to: [f64; AXES] },
    /// The ball moves on a straight line.
    Line { from: Pose, to: Pose },
    /// The ball moves on an arc of `angle` rad about the unit vector `axis` through `centre`, mm.
    Arc { from: Pose, to: Pose, centre: Vector3<f64>, axis: Vector3<f64>, angle: f64 },
}

impl ToolBallPath {
    /// The arc from `from` through `aux` to `to`, of less than a full turn; a line if the three points are collinear.
    pub fn arc(from: Pose, aux: &Vector3<f64>, to: Pose) -> Self {
        let (a, b) = (aux - from.position, to.position - from.position);
        let normal = a.cross(&b);
        let squared = normal.norm_squared();
        if squared < 1e-12 * a.norm_squared() * b.norm_squared() || squared == 0.0 {
            return Self::Line { from, to };
        }
        let across = b.cross(&normal) * a.norm_squared() + normal.cross(&a) * b.norm_squared();
        let centre = from.position + across / (2.0 * squared);
        let axis = normal / squared.sqrt();
        let (start, end) = (from.position - centre, to.position - centre);
        let angle = axis.dot(&start.cross(&end)).atan2(start.dot(&end)).rem_euclid(std::f64::consts::TAU);
        Self::Arc { from, to, centre, axis, angle }
    }

    /// Length of the ball's path, mm; 0 for [`ToolBallPath::Axes`].
    pub fn length_mm(&self) -> f64 {
        match self {
            Self::Axes { .. } => 0.0,
            Self::Line { from, to } => (to.position - from.position).norm(),
            Self::Arc { from, centre, angle, .. } => (from.position - centre).norm() * angle,
        }
    }

    /// Angle between the orientations at the ends, degrees; 0 for [`ToolBallPath::Axes`].
    pub fn turn_deg(&self) -> f64 {
        match self {
            Self::Axes { .. } => 0.0,
            Self::Line { from, to } | Self::Arc { from, to, .. } => from.angle_to(to).to_degrees(),
        }
    }

    /// Number of steps in which the path is followed when it is planned and checked: at most a millimetre of the ball, and a
    /// degree of the tool's orientation or of an axis of [`ToolBallPath::Axes`].
    pub(super) fn steps(&self) -> u32 {
        let turn_deg = match self {
            Self::Axes { from, to } => max_axis_difference(from, to).to_degrees(),
            Self::Line { .. } | Self::Arc { .. } => self.turn_deg(),
        };
        (self.length_mm() / STEP_MM).max(turn_deg / STEP_DEG).ceil().clamp(1.0, 1e5) as u32
    }

    /// The pose at `share` (0..=1) of a line or an arc: the orientation turns about one axis in proportion to the path.
    /// `None` for [`ToolBallPath::Axes`].
    pub fn pose(&self, share: f64) -> Option<Pose> {
        let (from, to, position) = match self {
            Self::Axes { .. } => return None,
            Self::Line { from, to } => (from, to, from.position + (to.position - from.position) * share),
            Self::Arc { from, to, centre, axis, angle } => {
                let turned = Rotation3::from_scaled_axis(axis * (angle * share));
                (from, to, centre + turned * (from.position - centre))
            }
        };
        if share >= 1.0 {
            return Some(*to);
        }
        Some(Pose { rotation: between(&from.rotation, &to.rotation, share), position })
    }
}

/// The orientation at `share` of the turn about one axis from `from` to `to`.
pub(super) fn between(from: &Matrix3<f64>, to: &Matrix3<f64>, share: f64) -> Matrix3<f64> {
    let turn = rotation_vector(&(from.transpose() * to));
    from * Rotation3::from_scaled_axis(turn * share).matrix()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use dbbd_model::robot::pose::{rot_x, rot_z};

    fn at(position: [f64; 3]) -> Pose {
        Pose { rotation: Matrix3::identity(), position: position.into() }
    }

    fn assert_at(path: &ToolBallPath, share: f64, expected: [f64; 3]) {
        let found = path.pose(share).expect("a line or an arc has poses").position;
        assert!((found - Vector3::from(expected)).norm() < 1e-9, "{share}: {found}, not {expected:?}");
    }

    #[test]
    fn path_is_followed_in_steps_of_a_millimetre_or_a_degree() {
        let line = |length_mm: f64, turn_deg: f64| {
            let to = Pose { rotation: rot_z(turn_deg.to_radians()), ..at([length_mm, 0.0, 0.0]) };
            ToolBallPath::Line { from: at([0.0; 3]), to }.steps()
        };
        assert_eq!([line(7.5, 3.0), line(7.5, 19.5), line(0.0, 0.0)], [8, 20, 1]);
        // The duration of a motion of the axes follows from its widest turn.
        let to = [0.0, -12.5, 3.0, 0.0, 0.0, 0.0].map(f64::to_radians);
        assert_eq!(ToolBallPath::Axes { from: [0.0; AXES], to }.steps(), 13);
    }

    /// A circle of 50 mm about (100, 20, 7) parallel to XY; 30 degrees have the sine 1/2.
    #[test]
    fn arc_goes_through_its_auxiliary_point() {
        let (from, to) = (at([150.0, 20.0, 7.0]), at([100.0, 70.0, 7.0]));
        let short = ToolBallPath::arc(from, &Vector3::new(130.0, 60.0, 7.0), to);
        assert!((short.length_mm() - 50.0 * FRAC_PI_2).abs() < 1e-9);
        assert_at(&short, 1.0 / 3.0, [100.0 + 50.0 * 0.75_f64.sqrt(), 45.0, 7.0]);
        assert_at(&short, 0.0, [150.0, 20.0, 7.0]);
        assert_at(&short, 1.0, [100.0, 70.0, 7.0]);
        // The other way round: 270 degrees through the opposite side.
        let long = ToolBallPath::arc(from, &Vector3::new(50.0, 20.0, 7.0), to);
        assert!((long.length_mm() - 75.0 * PI).abs() < 1e-9);
        assert_at(&long, 1.0 / 3.0, [100.0, -30.0, 7.0]);
        assert_at(&long, 2.0 / 3.0, [50.0, 20.0, 7.0]);
    }

    #[test]
    fn arc_through_three_points_of_a_line_is_a_line() {
        let path = ToolBallPath::arc(at([0.0; 3]), &Vector3::new(1.0, 2.0, 2.0), at([3.0, 6.0, 6.0]));
        assert_eq!(path, ToolBallPath::Line { from: at([0.0; 3]), to: at([3.0, 6.0, 6.0]) });
        assert!((path.length_mm() - 9.0).abs() < 1e-12);
        assert_at(&path, 0.25, [0.75, 1.5, 1.5]);
    }

    /// Rx(90) then Rz(share 60) of the tool: the orientations do not commute.
    #[test]
    fn orientation_turns_about_one_axis_of_the_tool() {
        let (from, degree) = (rot_x(FRAC_PI_2), PI / 180.0);
        let to = from * rot_z(60.0 * degree);
        for (share, turned_deg) in [(0.0, 0.0), (0.25, 15.0), (0.5, 30.0), (1.0, 60.0)] {
            let expected = from * rot_z(turned_deg * degree);
            assert!((between(&from, &to, share) - expected).norm() < 1e-12, "{share}");
        }
        let (start, end) =
            (Pose { rotation: from, ..at([0.0; 3]) }, Pose { rotation: to, ..at([8.0, 0.0, 0.0]) });
        let path = ToolBallPath::Line { from: start, to: end };
        assert!((path.turn_deg() - 60.0).abs() < 1e-9);
        let quarter = path.pose(0.25).expect("a line has poses");
        assert!((quarter.rotation - from * rot_z(15.0 * degree)).norm() < 1e-12);
        assert_eq!(path.pose(1.0), Some(end));
    }

    #[test]
    fn motion_of_the_axes_has_no_path_of_the_ball() {
        let path = ToolBallPath::Axes { from: [0.0; AXES], to: [1.0; AXES] };
        assert_eq!((path.length_mm(), path.turn_deg(), path.pose(0.5)), (0.0, 0.0, None));
    }
}
