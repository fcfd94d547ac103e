//! The arm under a controller: the nominal robot, where it is commanded to be, and what it cannot do.

use super::motion::{Motion, Path, Place, Profile};
use crate::catalogue::ProgramFinding;
use crate::program::Language;
use crate::robot::{AXES, Geometry, Robot, inverse};

#[derive(Clone, Debug)]
pub(super) struct Arm {
    /// As the controller knows it.
    pub(super) robot: Robot,
    /// Commanded axis angles, rad.
    pub(super) axes: [f64; AXES],
    /// How many motions have begun.
    pub(super) motions: u32,
}

impl Arm {
    /// At the home of the controllers of a language, or as near to it as the robot's limits allow.
    pub(super) fn at_home(robot: &Robot, language: Language) -> Self {
        let mut home = language.home_deg();
        for i in 0..AXES {
            let [low, high] = robot.limits_at_deg(&home)[i];
            home[i] = home[i].clamp(low, high);
        }
        Self { robot: robot.clone(), axes: home.map(f64::to_radians), motions: 0 }
    }

    pub(super) fn begin(&mut self, path: Path, profile: Profile) -> Motion {
        self.motions = self.motions.saturating_add(1);
        Motion { path, profile, t_s: 0.0 }
    }

    /// Goes on with a motion, at most for the time given (s) and at a share of its speed; how long it took if it ended.
    pub(super) fn advance(
        &mut self,
        motion: &mut Motion,
        geometry: &Geometry,
        [left_s, rate]: [f64; 2],
    ) -> Result<Option<f64>, ProgramFinding> {
        let needed_s = motion.left_s() / rate;
        if needed_s <= left_s {
            motion.t_s = f64::INFINITY;
            self.take(&motion.place(), geometry, needed_s)?;
            return Ok(Some(needed_s));
        }
        motion.t_s += left_s * rate;
        self.take(&motion.place(), geometry, left_s)?;
        Ok(None)
    }

    /// Takes the robot to a place on its path, `elapsed_s` after the last; `geometry` has the program's tool.
    fn take(&mut self, place: &Place, geometry: &Geometry, elapsed_s: f64) -> Result<(), ProgramFinding> {
        let axes = match place {
            Place::Axes(axes) => *axes,
            Place::Pose(pose) => {
                let axes = inverse::nearest(geometry, pose, &self.axes)
                    .map_err(|unsolved| ProgramFinding::NoAxisAngles { why: unsolved.to_string() })?;
                self.check_limits(&axes)?;
                for i in 0..AXES {
                    let most = self.robot.max_speed_deg_s[i].to_radians() * elapsed_s;
                    if (axes[i] - self.axes[i]).abs() > 1.05 * most + 1e-6 {
                        return Err(ProgramFinding::AxisSpeed { axis: i + 1 });
                    }
                }
                axes
            }
        };
        self.axes = axes;
        Ok(())
    }

    /// Refuses axis angles (rad) outside the robot's limits.
    pub(super) fn check_limits(&self, axes: &[f64; AXES]) -> Result<(), ProgramFinding> {
        let axes_deg = axes.map(f64::to_degrees);
        let limits_deg = self.robot.limits_at_deg(&axes_deg);
        for (i, angle_deg) in axes_deg.into_iter().enumerate() {
            let [low_deg, high_deg] = limits_deg[i];
            if !(low_deg - 1e-9..=high_deg + 1e-9).contains(&angle_deg) {
                return Err(ProgramFinding::AxisLimit { axis: i + 1, angle_deg, low_deg, high_deg });
            }
        }
        Ok(())
    }
}
