//! The motion of the controller between two rows: straight line, arc, or all axes together.

use nalgebra::{Matrix3, Rotation3, Vector3};

use dbbd_model::robot::pose::rotation_vector;
use dbbd_model::robot::{AXES, Pose};

/// A motion of the tool ball from one pose to the next.
#[derive(Clone, Debug, PartialEq)]
pub enum ToolBallPath {
    /// All axes start and stop together; axis angles in rad.
    Axes { from: [f64; AXES], to: [f64; AXES] },
    /// The ball on a straight line.
    Line { from: Pose, to: Pose },
    /// The ball on an arc of `angle` rad about the unit vector `axis` through `centre`, mm.
    Arc { from: Pose, to: Pose, centre: Vector3<f64>, axis: Vector3<f64>, angle: f64 },
}

/// A way from one pose to the next.
pub(crate) enum RouteLeg {
    /// One arc through this auxiliary pose.
    Arc(Pose),
    /// Straight lines from pose to pose; the last one is the end.
    Chords(Vec<Pose>),
}

impl ToolBallPath {
    /// The arc from `from` through `aux` to `to`, of less than a full turn; a line if the three are on one.
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
pub(crate) fn between(from: &Matrix3<f64>, to: &Matrix3<f64>, share: f64) -> Matrix3<f64> {
    let turn = rotation_vector(&(from.transpose() * to));
    from * Rotation3::from_scaled_axis(turn * share).matrix()
}
