//! The arm of a simulated controller: the nominal robot, its commanded position and its limits.

use super::motion::{CommandedMotion, CommandedPath, CommandedPlace, SpeedProfile};
use crate::program::Language;
use crate::program::ProgramFinding;
use dbbd_model::robot::inverse::{self, Unsolved};
use dbbd_model::robot::{AXES, Geometry, Pose, Robot};

#[derive(Clone, Debug)]
pub(super) struct SimulatedArm {
    /// The robot as the controller knows it.
    pub(super) robot: Robot,
    /// Commanded axis angles, rad.
    pub(super) axes: [f64; AXES],
    /// Number of motions that have begun.
    pub(super) motions: u32,
}

pub(super) fn unsolved(why: Unsolved) -> ProgramFinding {
    ProgramFinding::NoAxisAngles { why: why.to_string() }
}

impl SimulatedArm {
    /// At the home position for a language, or as near to it as the limits of the robot allow.
    pub(super) fn at_home(robot: &Robot, language: Language) -> Self {
        let mut home = language.home_deg();
        for i in 0..AXES {
            let [low, high] = robot.limits_at_deg(&home)[i];
            home[i] = home[i].clamp(low, high);
        }
        Self { robot: robot.clone(), axes: home.map(f64::to_radians), motions: 0 }
    }

    pub(super) fn begin(&mut self, path: CommandedPath, profile: SpeedProfile) -> CommandedMotion {
        self.motions = self.motions.saturating_add(1);
        CommandedMotion { path, profile, t_s: 0.0 }
    }

    /// The axis angles for a pose, near the commanded ones; `geometry` has the tool of the program.
    pub(super) fn nearest(&self, geometry: &Geometry, pose: &Pose) -> Result<[f64; AXES], ProgramFinding> {
        inverse::nearest(geometry, pose, &self.axes).map_err(unsolved)
    }

    /// Continues a motion for at most `left_s`, at the share `rate` of its speed; the time it took if it ended.
    pub(super) fn advance(
        &mut self,
        motion: &mut CommandedMotion,
        geometry: &Geometry,
        [left_s, rate]: [f64; 2],
    ) -> Result<Option<f64>, ProgramFinding> {
        let needed_s = motion.left_s() / rate;
        if needed_s <= left_s {
            motion.t_s = f64::INFINITY;
            self.command(&motion.place(), geometry, needed_s)?;
            return Ok(Some(needed_s));
        }
        motion.t_s += left_s * rate;
        self.command(&motion.place(), geometry, left_s)?;
        Ok(None)
    }

    /// Commands a place on the path, `elapsed_s` after the last one; `geometry` has the tool of the program.
    fn command(
        &mut self,
        place: &CommandedPlace,
        geometry: &Geometry,
        elapsed_s: f64,
    ) -> Result<(), ProgramFinding> {
        self.axes = match place {
            CommandedPlace::Axes(axes) => *axes,
            CommandedPlace::Pose(pose) => {
                let axes = self.nearest(geometry, pose)?;
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
        Ok(())
    }

    /// Refuses axis angles (rad) outside of the robot's limits.
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
