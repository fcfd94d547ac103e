//! Begins motions: targets, frames, speeds.

use std::collections::BTreeMap;

use super::motion::{Arc, Motion, Path, Profile, Turn};
use super::value::Value;
use super::{Activity, Controller, Fault};
use crate::krl::syntax::{Expression, Span};
use crate::model::pose::Pose;
use crate::model::{AXES, Geometry, inverse};

const AXIS_NAMES: [&str; AXES] = ["A1", "A2", "A3", "A4", "A5", "A6"];
const POSE_NAMES: [&str; 6] = ["X", "Y", "Z", "A", "B", "C"];
/// m/s; above it the unit was most likely mistaken.
const FASTEST_M_S: f64 = 3.0;

impl Controller {
    /// A system variable that is a frame.
    fn frame(&self, name: &str) -> Pose {
        let value = self.system.get(name).map(|variable| &variable.value);
        let component = |name: &str| {
            value.and_then(|value| value.field(name)).and_then(|value| value.number().ok()).unwrap_or(0.0)
        };
        let [x, y, z, a, b, c] = POSE_NAMES.map(component);
        Pose::from_kuka([x, y, z], [a, b, c])
    }

    /// The nominal robot with the program's tool.
    pub(super) fn geometry(&self) -> Geometry {
        Geometry { tool: self.frame("$TOOL").position, ..self.robot.geometry.clone() }
    }

    /// X, Y, Z, A, B, C of the tool in the base frame, now.
    pub(super) fn pose_fields(&self) -> BTreeMap<String, Value> {
        let ball = self.geometry().ball(&self.axes);
        let tool = Pose { rotation: ball.rotation * self.frame("$TOOL").rotation, position: ball.position };
        let pose = self.frame("$BASE").inverse().then(&tool);
        let [x, y, z] = pose.position.into();
        let [a, b, c] = pose.abc_deg();
        POSE_NAMES.into_iter().map(str::to_owned).zip([x, y, z, a, b, c].map(Value::Real)).collect()
    }

    /// A commanded position with the components that it lacks taken from where the robot is: the tool
    /// point in the robot base with the flange's orientation.
    fn pose(&self, given: &Value, span: &Span) -> Result<Pose, Fault> {
        let here = self.pose_fields();
        let mut numbers = [0.0; 6];
        for (number, name) in numbers.iter_mut().zip(POSE_NAMES) {
            let value = given.field(name).or_else(|| here.get(name)).unwrap_or(&Value::Unset);
            *number = value.number().map_err(|why| Fault::new(span, format!("{name}: {why}")))?;
        }
        let [x, y, z, a, b, c] = numbers;
        let tool = self.frame("$BASE").then(&Pose::from_kuka([x, y, z], [a, b, c]));
        let rotation = tool.rotation * self.frame("$TOOL").rotation.transpose();
        Ok(Pose { rotation, position: tool.position })
    }

    /// Axis angles (rad) that are commanded as such.
    fn axis_target(&self, given: &Value, span: &Span) -> Result<[f64; AXES], Fault> {
        let mut axes = self.axes;
        for (axis, name) in axes.iter_mut().zip(AXIS_NAMES) {
            if let Some(value) = given.field(name) {
                *axis = value.number().map_err(|why| Fault::new(span, why))?.to_radians();
            }
        }
        Ok(axes)
    }

    pub(super) fn ptp(&mut self, to: &Expression, span: &Span) -> Result<(), Fault> {
        let given = self.evaluate(to)?;
        let target = if is_axes(&given) {
            self.axis_target(&given, span)?
        } else {
            let bits = |name: &str| given.field(name).and_then(|value| value.int().ok());
            let pose = self.pose(&given, &to.span)?;
            match (bits("S"), bits("T")) {
                (Some(status), Some(turn)) => self.configuration(&pose, status, turn, &to.span)?,
                _ if self.motions == 0 => {
                    return Err(Fault::new(span, "the first motion must tell all axes")
                        .help("give an axis position, or a position with S and T"));
                }
                _ => inverse::nearest(&self.geometry(), &pose, &self.axes)
                    .map_err(|unsolved| Fault::new(&to.span, unsolved.to_string()))?,
            }
        };
        self.check_limits(&target, span)?;
        let percent = |name: &str, i: usize| match self.system.get(name).map(|variable| &variable.value) {
            Some(Value::Array(axes)) => axes.get(i).and_then(|value| value.number().ok()).unwrap_or(100.0),
            _ => 100.0,
        };
        let hardest = self.robot.acceleration_deg_s2();
        let limits = (0..AXES).map(|i| {
            let speed = self.robot.max_speed_deg_s[i] * percent("$VEL_AXIS", i) / 100.0;
            let acceleration = hardest[i] * percent("$ACC_AXIS", i) / 100.0;
            (target[i] - self.axes[i], speed.to_radians(), acceleration.to_radians())
        });
        let profile = Profile::within(limits);
        self.begin(Path::Axes { from: self.axes, to: target }, profile);
        Ok(())
    }

    /// Axis angles (rad) for a pose with the status and turn bits given.
    fn configuration(&self, pose: &Pose, status: i64, turn: i64, span: &Span) -> Result<[f64; AXES], Fault> {
        let mut robot = self.robot.clone();
        robot.geometry = self.geometry();
        // Bit 3 of S and above say how the point was taught, not where it is.
        let bits =
            |value: i64| u8::try_from(value).map_err(|_| Fault::new(span, format!("S or T is {value}")));
        match inverse::from_status_turn(&robot, pose, bits(status)?, bits(turn)?) {
            Err(inverse::Unsolved::NotAnalytic) => inverse::nearest(&robot.geometry, pose, &self.axes),
            solved => solved,
        }
        .map_err(|unsolved| Fault::new(span, unsolved.to_string()))
    }

    pub(super) fn lin(&mut self, to: &Expression, span: &Span) -> Result<(), Fault> {
        let (from, target) = self.tool_motion(to, span)?;
        let length = (target.position - from.position).norm();
        self.begin_tool(from, target, None, length, span)
    }

    pub(super) fn circ(
        &mut self,
        through: &Expression,
        to: &Expression,
        angle: Option<&Expression>,
        span: &Span,
    ) -> Result<(), Fault> {
        self.word("$CIRC_TYPE", &["BASE"], span)?;
        let via = self.evaluate(through)?;
        let via = self.pose(&via, &through.span)?;
        let (from, target) = self.tool_motion(to, span)?;
        let sweep = angle.map(|angle| self.number(angle)).transpose()?.map(f64::to_radians);
        let Some((arc, length)) = Arc::through(from.position, via.position, target.position, sweep) else {
            return Err(Fault::new(span, "the three points of the arc lie on a line")
                .help("move the auxiliary point, or write LIN"));
        };
        self.begin_tool(from, target, Some(arc), length, span)
    }

    /// Start and end of a Cartesian motion.
    fn tool_motion(&mut self, to: &Expression, span: &Span) -> Result<(Pose, Pose), Fault> {
        if self.motions == 0 {
            return Err(Fault::new(span, "the first motion of a program is a PTP")
                .help("drive to the start by PTP to an axis position"));
        }
        self.word("$IPO_MODE", &["BASE"], span)?;
        self.word("$ORI_TYPE", &["VAR"], span)?;
        let given = self.evaluate(to)?;
        let geometry = self.geometry();
        let target = if is_axes(&given) {
            geometry.ball(&self.axis_target(&given, &to.span)?)
        } else {
            self.pose(&given, &to.span)?
        };
        Ok((geometry.ball(&self.axes), target))
    }

    fn begin_tool(
        &mut self,
        from: Pose,
        to: Pose,
        arc: Option<Arc>,
        length: f64,
        span: &Span,
    ) -> Result<(), Fault> {
        let turn = Turn::between(&from, &to);
        let setting = |name: &str, field: &str| {
            let variable = self.system.get(name).map(|variable| &variable.value);
            let value = variable.and_then(|value| value.field(field)).and_then(|value| value.number().ok());
            value.filter(|value| *value > 0.0).ok_or_else(|| {
                Fault::new(span, format!("{name}.{field} must be above zero"))
                    .help("set it before the motion")
            })
        };
        let speed = setting("$VEL", "CP")?;
        if speed > FASTEST_M_S {
            return Err(Fault::new(span, format!("$VEL.CP={speed} is faster than the robot"))
                .help("$VEL.CP is in m/s, not mm/s"));
        }
        // The path and the orientation have a ramp each; the slower of the two sets the pace.
        let profile = Profile::slowest([
            (length, 1e3 * speed, 1e3 * setting("$ACC", "CP")?),
            (turn.angle, setting("$VEL", "ORI1")?.to_radians(), setting("$ACC", "ORI1")?.to_radians()),
        ]);
        self.begin(Path::Tool { from, to, turn, arc }, profile);
        Ok(())
    }

    fn begin(&mut self, path: Path, profile: Profile) {
        self.motions = self.motions.saturating_add(1);
        self.activity = Activity::Moving(Box::new(Motion { path, profile, t_s: 0.0 }));
    }

    /// Refuses a mode that is not simulated.
    fn word(&self, name: &str, simulated: &[&str], span: &Span) -> Result<(), Fault> {
        match self.system.get(name).map(|variable| &variable.value) {
            Some(Value::Enum(word)) if !simulated.contains(&word.as_str()) => {
                Err(Fault::new(span, format!("{name}=#{word} is not simulated"))
                    .help("the simulator knows $IPO_MODE=#BASE, $ORI_TYPE=#VAR, $CIRC_TYPE=#BASE"))
            }
            _ => Ok(()),
        }
    }
}

/// Whether a position gives axis angles.
fn is_axes(given: &Value) -> bool {
    AXIS_NAMES.into_iter().any(|name| given.field(name).is_some())
}
