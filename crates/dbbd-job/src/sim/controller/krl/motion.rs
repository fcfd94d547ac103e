//! Begins motions: evaluates targets, frames and speeds.

use super::{Interpreter, KrlActivity};
use crate::program::Frames;
use crate::program::ProgramFinding;
use crate::program::krl::evaluate::{At, Fault, POSE_NAMES, Position};
use crate::program::krl::syntax::{Expression, Move, Span};
use crate::program::krl::value::Value;
use crate::sim::controller::{CommandedPath, FixedAxisTurn, SpeedProfile, ToolArc, unsolved};
use dbbd_model::robot::inverse;
use dbbd_model::robot::pose::Pose;
use dbbd_model::robot::{AXES, Geometry};

/// Highest plausible speed, m/s: a higher one is probably in another unit.
const FASTEST_M_S: f64 = 3.0;

impl Interpreter {
    /// A system variable that is a frame.
    fn frame(&self, name: &str) -> Pose {
        Pose::from_xyzabc(POSE_NAMES.map(|component| self.system_number(name, component).unwrap_or(0.0)))
    }

    /// `$TOOL` and `$BASE` for the table of the robot.
    fn frames(&self) -> Frames {
        let [tool, base] = ["$TOOL", "$BASE"].map(|name| self.frame(name));
        Frames { tool, base }.for_table(&self.arm.robot.frames)
    }

    /// The nominal robot with the tool of the program.
    pub(super) fn geometry(&self) -> Geometry {
        Geometry { tool: self.frames().tool.position, ..self.arm.robot.geometry.clone() }
    }

    /// X, Y, Z, A, B, C of the tool in the base frame.
    pub(super) fn current_pose(&self) -> [f64; 6] {
        let (ball, frames) = (self.geometry().ball(&self.arm.axes), self.frames());
        let tool = Pose { rotation: ball.rotation * frames.tool.rotation, position: ball.position };
        frames.base.inverse().then(&tool).xyzabc()
    }

    /// The tool point in the robot base, with the orientation of the flange, at a commanded pose. Missing components
    /// are taken from the current pose.
    fn pose(&self, components: [Option<f64>; 6]) -> Pose {
        let current = self.current_pose();
        let commanded = std::array::from_fn(|i| components[i].unwrap_or(current[i]));
        let frames = self.frames();
        let tool = frames.base.then(&Pose::from_xyzabc(commanded));
        let rotation = tool.rotation * frames.tool.rotation.transpose();
        Pose { rotation, position: tool.position }
    }

    /// Commanded axis angles, rad.
    fn commanded_axes(&self, components: [Option<f64>; 6]) -> [f64; AXES] {
        std::array::from_fn(|i| components[i].map_or(self.arm.axes[i], f64::to_radians))
    }

    fn commanded(&mut self, to: &Expression) -> Result<Position, Fault> {
        Position::of(&to.value(self)?).at(&to.span)
    }

    pub(super) fn ptp(&mut self, to: &Expression, span: &Span) -> Result<(), Fault> {
        let target = match self.commanded(to)? {
            Position::Axes(components) => self.commanded_axes(components),
            Position::Pose { components, status: Some(status), turn: Some(turn) } => {
                self.configuration(&self.pose(components), status, turn).at(&to.span)?
            }
            Position::Pose { .. } if self.arm.motions == 0 => {
                return Err(Fault::new(span, ProgramFinding::FirstMotion));
            }
            Position::Pose { components, .. } => {
                let pose = self.pose(components);
                self.arm.nearest(&self.geometry(), &pose).at(&to.span)?
            }
        };
        self.arm.check_limits(&target).at(span)?;
        let percent = |name: &str, i: usize| match self.system(name) {
            Some(Value::Array(axes)) => axes.get(i).and_then(|value| value.number().ok()).unwrap_or(100.0),
            _ => 100.0,
        };
        let accelerations_deg_s2 = self.arm.robot.acceleration_deg_s2();
        let limits = (0..AXES).map(|i| {
            let speed = self.arm.robot.max_speed_deg_s[i] * percent("$VEL_AXIS", i) / 100.0;
            let acceleration = accelerations_deg_s2[i] * percent("$ACC_AXIS", i) / 100.0;
            (target[i] - self.arm.axes[i], speed.to_radians(), acceleration.to_radians())
        });
        let profile = SpeedProfile::within(limits);
        self.begin(CommandedPath::Axes { from: self.arm.axes, to: target }, profile);
        Ok(())
    }

    /// The axis angles (rad) for a pose with status and turn.
    fn configuration(&self, pose: &Pose, status: i64, turn: i64) -> Result<[f64; AXES], ProgramFinding> {
        let mut robot = self.arm.robot.clone();
        robot.geometry = self.geometry();
        // Bits 3 and above of the status say how the point was taught, not where it is.
        let bits = |value: i64| u8::try_from(value).map_err(|_| ProgramFinding::NoConfiguration { value });
        inverse::from_status_turn(&robot, pose, bits(status)?, bits(turn)?).map_err(unsolved)
    }

    pub(super) fn lin(&mut self, to: &Expression, span: &Span) -> Result<(), Fault> {
        let [from, target] = self.path_ends(to, span)?;
        let length = (target.position - from.position).norm();
        let path =
            CommandedPath::Tool { from, to: target, turn: FixedAxisTurn::between(&from, &target), arc: None };
        self.begin_tool(path, length).at(span)
    }

    pub(super) fn circ(&mut self, motion: &Move, through: &Expression, span: &Span) -> Result<(), Fault> {
        self.check_mode("$CIRC_TYPE", "BASE").at(span)?;
        let via = self.tool_pose(through)?;
        let [from, target] = self.path_ends(&motion.to, span)?;
        let sweep = motion.angle.as_ref().map(|angle| angle.number(self)).transpose()?.map(f64::to_radians);
        let Some((arc, length)) = ToolArc::through(from.position, via.position, target.position, sweep)
        else {
            return Err(Fault::new(span, ProgramFinding::StraightArc));
        };
        let turn = FixedAxisTurn::between(&from, &target);
        self.begin_tool(CommandedPath::Tool { from, to: target, turn, arc: Some(arc) }, length).at(span)
    }

    /// Start and end of a Cartesian motion.
    fn path_ends(&mut self, to: &Expression, span: &Span) -> Result<[Pose; 2], Fault> {
        if self.arm.motions == 0 {
            return Err(Fault::new(span, ProgramFinding::FirstMotion));
        }
        self.check_mode("$IPO_MODE", "BASE").at(span)?;
        self.check_mode("$ORI_TYPE", "VAR").at(span)?;
        let target = self.tool_pose(to)?;
        Ok([self.geometry().ball(&self.arm.axes), target])
    }

    /// The tool point in the robot base, with the orientation of the flange, at a commanded position.
    fn tool_pose(&mut self, to: &Expression) -> Result<Pose, Fault> {
        Ok(match self.commanded(to)? {
            Position::Axes(components) => self.geometry().ball(&self.commanded_axes(components)),
            Position::Pose { components, .. } => self.pose(components),
        })
    }

    fn begin_tool(&mut self, path: CommandedPath, length_mm: f64) -> Result<(), ProgramFinding> {
        let setting = |name: &str, field: &str| {
            let value = self.system_number(name, field).filter(|value| *value > 0.0);
            value.ok_or_else(|| ProgramFinding::NoSpeed { variable: format!("{name}.{field}") })
        };
        let m_per_s = setting("$VEL", "CP")?;
        if m_per_s > FASTEST_M_S {
            return Err(ProgramFinding::TooFast { m_per_s });
        }
        let angle = match &path {
            CommandedPath::Tool { turn, .. } => turn.angle,
            CommandedPath::Axes { .. } => 0.0,
        };
        // Position and orientation have a speed profile each; the slower one applies to both.
        let profile = SpeedProfile::slowest([
            (length_mm, 1e3 * m_per_s, 1e3 * setting("$ACC", "CP")?),
            (angle, setting("$VEL", "ORI1")?.to_radians(), setting("$ACC", "ORI1")?.to_radians()),
        ]);
        self.begin(path, profile);
        Ok(())
    }

    fn begin(&mut self, path: CommandedPath, profile: SpeedProfile) {
        self.activity = KrlActivity::Moving(Box::new(self.arm.begin(path, profile)));
    }

    /// Refuses a mode other than the one that is simulated.
    fn check_mode(&self, name: &str, mode: &str) -> Result<(), ProgramFinding> {
        match self.system(name) {
            Some(Value::Enum(word)) if word != mode => Err(ProgramFinding::Unsupported {
                what: format!("{name}=#{word}"),
                instead: format!("the simulator supports {name}=#{mode}"),
            }),
            _ => Ok(()),
        }
    }
}
