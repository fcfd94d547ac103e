//! A motion: its path and its position on the path at a time.

use nalgebra::{Rotation3, Unit, UnitVector3, Vector3};

use dbbd_model::robot::AXES;
use dbbd_model::robot::pose::{Pose, rotation_vector};

/// A trapezoidal speed profile over a path from 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpeedProfile {
    speed: f64,
    acceleration: f64,
    duration_s: f64,
}

impl SpeedProfile {
    /// The fastest profile within all limits, each a distance with its largest speed and acceleration.
    pub(super) fn within(limits: impl IntoIterator<Item = (f64, f64, f64)>) -> Self {
        let (mut speed, mut acceleration) = (f64::INFINITY, f64::INFINITY);
        for (distance, largest_speed, largest_acceleration) in limits {
            let distance = distance.abs();
            if distance > 1e-12 {
                speed = speed.min(largest_speed / distance);
                acceleration = acceleration.min(largest_acceleration / distance);
            }
        }
        if !speed.is_finite() {
            return Self { speed: 0.0, acceleration: 0.0, duration_s: 0.0 }; // nothing moves
        }
        // If full speed is not reached, the trapezoid is a triangle.
        speed = speed.min(acceleration.sqrt());
        Self { speed, acceleration, duration_s: 1.0 / speed + speed / acceleration }
    }

    /// The profile of the limit that alone takes longest.
    pub(super) fn slowest<const N: usize>(limits: [(f64, f64, f64); N]) -> Self {
        let profiles = limits.map(|limit| Self::within([limit]));
        profiles
            .into_iter()
            .max_by(|a, b| a.duration_s.total_cmp(&b.duration_s))
            .unwrap_or_else(|| Self::within([]))
    }

    /// A profile with this duration, a quarter of it for each ramp.
    pub(super) fn lasting(seconds: f64) -> Self {
        if seconds <= 0.0 {
            return Self::within([]);
        }
        let speed = 4.0 / (3.0 * seconds);
        Self { speed, acceleration: 4.0 * speed / seconds, duration_s: seconds }
    }

    /// This profile, or if it is shorter, one with this duration.
    pub(super) fn not_before(self, seconds: f64) -> Self {
        if self.duration_s < seconds && self.duration_s > 0.0 { Self::lasting(seconds) } else { self }
    }

    /// The position on the path, 0 to 1, after `t_s` seconds.
    fn share(&self, t_s: f64) -> f64 {
        if t_s >= self.duration_s {
            return 1.0;
        }
        let ramp_s = self.speed / self.acceleration;
        let left_s = self.duration_s - t_s;
        if t_s < ramp_s {
            0.5 * self.acceleration * t_s * t_s
        } else if left_s < ramp_s {
            1.0 - 0.5 * self.acceleration * left_s * left_s
        } else {
            self.speed * (t_s - 0.5 * ramp_s)
        }
    }
}

/// A commanded place on a path.
pub(super) enum CommandedPlace {
    /// Axis angles, rad.
    Axes([f64; AXES]),
    /// The tool point in the robot base, with the orientation of the flange.
    Pose(Pose),
}

/// The path from one point to the next.
#[derive(Clone, Debug)]
pub(super) enum CommandedPath {
    /// All axes in proportion, rad.
    Axes { from: [f64; AXES], to: [f64; AXES] },
    /// The tool on a line or an arc; its orientation turns about one axis.
    Tool { from: Pose, to: Pose, turn: FixedAxisTurn, arc: Option<ToolArc> },
}

/// A turn about a fixed axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct FixedAxisTurn {
    axis: UnitVector3<f64>,
    pub(super) angle: f64,
}

impl FixedAxisTurn {
    /// The shortest turn from one orientation to the other, in the robot base.
    pub(super) fn between(from: &Pose, to: &Pose) -> Self {
        let turn = rotation_vector(&(to.rotation * from.rotation.transpose()));
        let (axis, angle) = Unit::try_new_and_get(turn, 0.0).unwrap_or((Vector3::z_axis(), 0.0));
        Self { axis, angle }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ToolArc {
    centre: Vector3<f64>,
    normal: UnitVector3<f64>,
    /// Signed sweep, rad.
    sweep: f64,
}

impl ToolArc {
    /// The arc from `start` through `via` to `end` and its length (mm); `sweep` (rad, negative against the taught direction)
    /// replaces the taught one. `None` if the points are on a line.
    pub(super) fn through(
        start: Vector3<f64>,
        via: Vector3<f64>,
        end: Vector3<f64>,
        sweep: Option<f64>,
    ) -> Option<(Self, f64)> {
        let (a, b) = (via - start, end - start);
        let normal = a.cross(&b);
        let area = normal.norm_squared();
        if area <= 1e-9 * a.norm_squared() * b.norm_squared() || area == 0.0 {
            return None;
        }
        // Circumcentre of the triangle.
        let centre = start
            + (normal.cross(&a) * b.norm_squared() + b.cross(&normal) * a.norm_squared()) / (2.0 * area);
        let normal = Unit::new_normalize(normal);
        let (from, to) = (start - centre, end - centre);
        // About this normal, start, via and end are in counter-clockwise order.
        let taught = normal.dot(&from.cross(&to)).atan2(from.dot(&to)).rem_euclid(std::f64::consts::TAU);
        let sweep = sweep.unwrap_or(taught);
        Some((Self { centre, normal, sweep }, from.norm() * sweep.abs()))
    }

    fn at(&self, start: &Vector3<f64>, share: f64) -> Vector3<f64> {
        self.centre + Rotation3::from_axis_angle(&self.normal, self.sweep * share) * (start - self.centre)
    }
}

#[derive(Clone, Debug)]
pub(super) struct CommandedMotion {
    pub(super) path: CommandedPath,
    pub(super) profile: SpeedProfile,
    /// Time on the path at full override, s.
    pub(super) t_s: f64,
}

impl CommandedMotion {
    pub(super) fn left_s(&self) -> f64 {
        self.profile.duration_s - self.t_s
    }

    /// The current place; at the end it is exactly the commanded point.
    pub(super) fn place(&self) -> CommandedPlace {
        let share = self.profile.share(self.t_s);
        match &self.path {
            CommandedPath::Axes { to, .. } if share >= 1.0 => CommandedPlace::Axes(*to),
            CommandedPath::Axes { from, to } => {
                CommandedPlace::Axes(std::array::from_fn(|i| from[i] + share * (to[i] - from[i])))
            }
            CommandedPath::Tool { to, arc, from, turn } => {
                let turned = Rotation3::from_axis_angle(&turn.axis, turn.angle * share);
                let position = match arc {
                    Some(arc) => arc.at(&from.position, share),
                    None => from.position + (to.position - from.position) * share,
                };
                if share >= 1.0 {
                    // An arc with a programmed sweep does not end at the taught point.
                    let position = if arc.is_some() { position } else { to.position };
                    return CommandedPlace::Pose(Pose { rotation: to.rotation, position });
                }
                CommandedPlace::Pose(Pose { rotation: turned.matrix() * from.rotation, position })
            }
        }
    }
}
