//! Executes a list of actions: programs of RAPID and URScript, and TP programs.
//!
//! Unlike the interpreter of KRL it has an arm that lags behind its command: for the program a motion ends when the
//! command ends, and the arm comes to rest later. So a program that does not wait for standstill measures a moving
//! robot. Lag, band and speed reproduce the errors that one project found on a virtual controller of a maker whose
//! `fine` ends a motion this way: 1.3 mm without a wait, 0.28 mm in position, and none at zero speed and 0.2 s later.

use super::{
    CommandedMotion, CommandedPath, FixedAxisTurn, ProgramExecutor, SimulatedArm, SpeedProfile, ToolArc,
    unsolved,
};
use crate::program::ProgramFinding;
use crate::program::listing::{Action, ActionKind, Move, Pace, ProgrammedConfiguration, Standstill};
use crate::program::{self, Frames, Language, Listing, Target};
use crate::sim::ControllerMoment;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{AXES, Geometry, Pose, Robot};

/// Time constant of the lag, s.
const LAG_S: f64 = 0.08;
/// The arm is in position if no axis is off by more than this, rad: 0.28 mm at a distance of a metre.
const IN_POSITION: f64 = 2.8e-4;
/// The arm is at zero speed if no axis is faster, rad/s.
const ZERO_SPEED: f64 = 1.75e-4;
/// Longest steps, s: while the program waits for standstill, and while the command moves.
const SETTLING_S: f64 = 0.004;
const MOVING_S: f64 = 0.02;
/// Acceleration of the orientation, degrees/s^2, which a program cannot set.
const TURN_DEG_S2: f64 = 500.0;
/// In a joint motion, the speed of the tool is taken as the speed of a point at this distance from each axis, mm.
const LEVER_MM: f64 = 1000.0;

#[derive(Clone, Debug)]
enum ListingActivity {
    Ready,
    Moving {
        motion: Box<CommandedMotion>,
        geometry: Box<Geometry>,
        /// The configuration that is checked at the end.
        configuration: Option<ProgrammedConfiguration>,
        /// Whether the program waits until the arm is in position.
        ends_in_position: bool,
    },
    /// Waits until this time, s.
    Waiting(f64),
    Settling(Standstill),
    Halted,
    Done,
}

#[derive(Clone, Debug)]
pub(super) struct ListingExecutor {
    listing: Listing,
    arm: SimulatedArm,
    lagging: LaggingArm,
    t_s: f64,
    /// The override as a share.
    rate: f64,
    /// Index of the next action.
    next: usize,
    activity: ListingActivity,
    ball: u32,
    strobe: ListedStrobe,
    dwells: u32,
}

/// The arm that lags behind its command.
#[derive(Clone, Debug)]
struct LaggingArm {
    /// The present axis angles of the arm, rad.
    axes: [f64; AXES],
    /// The speed of each axis, rad/s.
    speed: [f64; AXES],
}

/// The output that marks the dwells.
#[derive(Clone, Debug)]
struct ListedStrobe {
    /// Whether the program uses a strobe.
    is_used: bool,
    is_high: bool,
    /// The time at which a pulse ends, s.
    pulse_end_s: Option<f64>,
}

impl LaggingArm {
    /// Moves the arm after a command that went at constant speed from `from` to `to`, rad, in `took_s`.
    fn follow(&mut self, from: &[f64; AXES], to: &[f64; AXES], took_s: f64) {
        if took_s <= 0.0 {
            return;
        }
        let decay = (-took_s / LAG_S).exp();
        for i in 0..AXES {
            let rate = (to[i] - from[i]) / took_s;
            // The response of a first-order lag to a ramp.
            let behind = from[i] - self.axes[i] - rate * LAG_S;
            self.axes[i] = to[i] - rate * LAG_S - behind * decay;
            self.speed[i] = (to[i] - self.axes[i]) / LAG_S;
        }
    }

    /// Whether the arm is at rest at the command, rad.
    fn is_at_rest(&self, command: &[f64; AXES], standstill: Standstill) -> bool {
        (0..AXES).all(|i| match standstill {
            Standstill::InPosition => (command[i] - self.axes[i]).abs() <= IN_POSITION,
            Standstill::ZeroSpeed => self.speed[i].abs() <= ZERO_SPEED,
        })
    }
}

impl ListingExecutor {
    pub(super) fn new(listing: Listing, robot: &Robot, override_percent: f64) -> Self {
        let arm = SimulatedArm::at_home(robot, listing.language);
        let is_used = listing.actions.iter().any(|action| matches!(action.kind, ActionKind::SetStrobe(_)));
        Self {
            lagging: LaggingArm { axes: arm.axes, speed: [0.0; AXES] },
            arm,
            listing,
            t_s: 0.0,
            rate: override_percent / 100.0,
            next: 0,
            activity: ListingActivity::Ready,
            ball: 1,
            strobe: ListedStrobe { is_used, is_high: false, pulse_end_s: None },
            dwells: 0,
        }
    }

    /// The action that was begun last.
    fn current(&self) -> Option<&Action> {
        self.listing.actions.get(self.next.saturating_sub(1))
    }

    fn diagnostic(&self, finding: ProgramFinding) -> Diagnostic {
        match self.current() {
            Some(action) => self.listing.wrong(action, finding),
            None => finding.into(),
        }
    }

    /// Continues for a time in which the speed of the command is assumed to be constant.
    fn slice(&mut self, slice_s: f64) -> Result<(), ProgramFinding> {
        let end_s = self.t_s + slice_s;
        loop {
            let left_s = end_s - self.t_s;
            let from = self.arm.axes;
            let ended = self.proceed(left_s)?;
            let took_s = ended.unwrap_or(left_s);
            self.lagging.follow(&from, &self.arm.axes, took_s);
            self.t_s += took_s;
            if self.strobe.pulse_end_s.is_some_and(|end_s| end_s <= self.t_s + 1e-9) {
                (self.strobe.is_high, self.strobe.pulse_end_s) = (false, None);
            }
            if ended.is_none() {
                return Ok(());
            }
            let settles = matches!(self.activity, ListingActivity::Moving { ends_in_position: true, .. });
            let settling = ListingActivity::Settling(Standstill::InPosition);
            self.activity = if settles { settling } else { ListingActivity::Ready };
        }
    }

    /// Continues the current activity for at most `left_s`. Returns the time that it took if it ended.
    fn proceed(&mut self, left_s: f64) -> Result<Option<f64>, ProgramFinding> {
        while matches!(self.activity, ListingActivity::Ready) {
            self.begin_action()?;
        }
        let rate = self.rate;
        match &mut self.activity {
            ListingActivity::Ready | ListingActivity::Halted | ListingActivity::Done => Ok(None),
            ListingActivity::Waiting(until_s) => {
                let needed_s = (*until_s - self.t_s).max(0.0);
                Ok((needed_s <= left_s).then_some(needed_s))
            }
            ListingActivity::Settling(standstill) => {
                let standstill = *standstill;
                Ok(self.lagging.is_at_rest(&self.arm.axes, standstill).then_some(0.0))
            }
            ListingActivity::Moving { motion, geometry, configuration, .. } => {
                let ended = self.arm.advance(motion, geometry, [left_s, rate])?;
                if let (Some(_), Some(programmed)) = (ended, *configuration)
                    && let Some(reached) = programmed.refused(geometry, &self.arm.axes)
                {
                    let [programmed, reached] = [programmed, reached].map(|config| config.to_string());
                    return Err(ProgramFinding::OtherConfiguration { programmed, reached });
                }
                Ok(ended)
            }
        }
    }

    fn begin_action(&mut self) -> Result<(), ProgramFinding> {
        let Some(action) = self.listing.actions.get(self.next) else {
            self.activity = ListingActivity::Done;
            return Ok(());
        };
        let kind = action.kind.clone();
        self.next += 1;
        match kind {
            ActionKind::SelectBall(ball) => self.ball = ball,
            ActionKind::Wait(seconds) => {
                self.dwells += u32::from(!self.strobe.is_used && self.has_settled());
                self.activity = ListingActivity::Waiting(self.t_s + seconds.max(0.0));
            }
            ActionKind::WaitForStandstill(standstill) => {
                self.activity = ListingActivity::Settling(standstill)
            }
            ActionKind::SetStrobe(level) => {
                self.dwells += u32::from(level && self.has_settled());
                (self.strobe.is_high, self.strobe.pulse_end_s) = (level, None);
            }
            ActionKind::PulseStrobe(seconds) => {
                (self.strobe.is_high, self.strobe.pulse_end_s) = (true, Some(self.t_s + seconds))
            }
            ActionKind::Halt => self.activity = ListingActivity::Halted,
            ActionKind::Move(motion) => self.activity = self.begin_motion(&motion)?,
        }
        Ok(())
    }

    /// Whether the action that begins follows a wait and a standstill, as at a dwell.
    fn has_settled(&self) -> bool {
        let before = self.listing.actions.get(..self.next.saturating_sub(1)).unwrap_or_default();
        let is_standstill = |action: &&Action| matches!(action.kind, ActionKind::WaitForStandstill(_));
        let standstills = before.iter().rev().take_while(is_standstill).count();
        let kinds: Vec<_> =
            before.iter().rev().skip(standstills).take(2).map(|action| &action.kind).collect();
        match kinds.as_slice() {
            [ActionKind::Wait(_), ActionKind::Move(motion)] => standstills > 0 || motion.ends_in_position,
            [ActionKind::Wait(_), ..] => standstills > 0,
            _ => false,
        }
    }

    fn begin_motion(&mut self, motion: &Move) -> Result<ListingActivity, ProgramFinding> {
        let motion = &Move { frames: motion.frames.for_table(&self.arm.robot.frames), ..motion.clone() };
        let geometry = Geometry { tool: motion.frames.tool.position, ..self.arm.robot.geometry.clone() };
        if motion.motion == program::MotionKind::Ptp {
            let to = self.axes_at(motion, &geometry)?;
            self.arm.check_limits(&to)?;
            let path = CommandedPath::Axes { from: self.arm.axes, to };
            let ends_in_position = motion.ends_in_position;
            let motion = Box::new(self.arm.begin(path, self.joint_profile(&to, motion.pace)));
            let geometry = Box::new(geometry);
            return Ok(ListingActivity::Moving { motion, geometry, configuration: None, ends_in_position });
        }
        if self.arm.motions == 0 {
            return Err(ProgramFinding::FirstMotion);
        }
        let from = geometry.ball(&self.arm.axes);
        let place = |target: &Target| match target {
            Target::Axes(axes_deg) => geometry.ball(&axes_deg.map(f64::to_radians)),
            Target::Pose { xyz_mm, abc_deg, .. } => tool_point(&motion.frames, *xyz_mm, *abc_deg),
        };
        let to = place(&motion.to);
        let (arc, length_mm) = match &motion.through {
            None => (None, (to.position - from.position).norm()),
            Some(through) => {
                let via = place(through).position;
                let arc = ToolArc::through(from.position, via, to.position, None);
                let (arc, length_mm) = arc.ok_or(ProgramFinding::StraightArc)?;
                (Some(arc), length_mm)
            }
        };
        let turn = FixedAxisTurn::between(&from, &to);
        let profile = match motion.pace {
            Pace::Duration(seconds) => SpeedProfile::lasting(seconds),
            Pace::Tool { mm_s, mm_s2, deg_s } => {
                let orientation = deg_s.map_or((0.0, 1.0, 1.0), |deg_s| {
                    (turn.angle, deg_s.to_radians(), TURN_DEG_S2.to_radians())
                });
                SpeedProfile::slowest([(length_mm, mm_s, mm_s2), orientation])
            }
            Pace::Axis { .. } | Pace::AxisShare(_) => {
                return Err(ProgramFinding::NoSpeed { variable: "the speed".into() });
            }
        };
        let path = CommandedPath::Tool { from, to, turn, arc };
        Ok(ListingActivity::Moving {
            motion: Box::new(self.arm.begin(path, profile)),
            geometry: Box::new(geometry),
            configuration: motion.configuration,
            ends_in_position: motion.ends_in_position,
        })
    }

    /// The axis angles (rad) of the end of a joint motion.
    fn axes_at(&self, motion: &Move, geometry: &Geometry) -> Result<[f64; AXES], ProgramFinding> {
        let (xyz_mm, abc_deg) = match motion.to {
            Target::Axes(axes_deg) => return Ok(axes_deg.map(f64::to_radians)),
            Target::Pose { xyz_mm, abc_deg, .. } => (xyz_mm, abc_deg),
        };
        let pose = tool_point(&motion.frames, xyz_mm, abc_deg);
        match motion.configuration {
            Some(configuration) => {
                let robot = Robot { geometry: geometry.clone(), ..self.arm.robot.clone() };
                configuration.axes(&robot, &pose).map_err(unsolved)
            }
            None if self.arm.motions == 0 && self.listing.language == Language::Rapid => {
                Err(ProgramFinding::FirstMotion)
            }
            None => self.arm.nearest(geometry, &pose),
        }
    }

    /// The speed profile of a joint motion.
    fn joint_profile(&self, to: &[f64; AXES], pace: Pace) -> SpeedProfile {
        let (robot, accelerations_deg_s2) = (&self.arm.robot, self.arm.robot.acceleration_deg_s2());
        let within = |deg_s: f64, deg_s2: f64| {
            SpeedProfile::within((0..AXES).map(|i| {
                let speed = robot.max_speed_deg_s[i].min(deg_s).to_radians();
                (to[i] - self.arm.axes[i], speed, accelerations_deg_s2[i].min(deg_s2).to_radians())
            }))
        };
        let fastest = within(f64::INFINITY, f64::INFINITY);
        match pace {
            Pace::Duration(seconds) => fastest.not_before(seconds),
            Pace::Axis { deg_s, deg_s2 } => within(deg_s, deg_s2),
            Pace::AxisShare(share) => fastest.not_before(fastest.duration_s / share),
            Pace::Tool { mm_s, .. } => within((mm_s / LEVER_MM).to_degrees(), f64::INFINITY),
        }
    }
}

impl ProgramExecutor for ListingExecutor {
    fn step(&mut self, dt_s: f64) -> Result<ControllerMoment, Diagnostic> {
        let end_s = self.t_s + dt_s.max(0.0);
        while self.t_s < end_s {
            let longest_s = match self.activity {
                ListingActivity::Settling(_) => SETTLING_S,
                ListingActivity::Ready | ListingActivity::Moving { .. } => MOVING_S,
                ListingActivity::Waiting(_) | ListingActivity::Halted | ListingActivity::Done => {
                    f64::INFINITY
                }
            };
            self.slice((end_s - self.t_s).min(longest_s)).map_err(|finding| self.diagnostic(finding))?;
        }
        self.t_s = end_s;
        Ok(self.moment())
    }

    fn moment(&self) -> ControllerMoment {
        ControllerMoment {
            t_s: self.t_s,
            axes: self.lagging.axes,
            centre: self.ball,
            strobe: self.strobe.is_high,
            motions: self.arm.motions,
            halted: matches!(self.activity, ListingActivity::Halted),
            done: matches!(self.activity, ListingActivity::Done),
        }
    }

    fn go_on(&mut self) {
        if matches!(self.activity, ListingActivity::Halted) {
            self.activity = ListingActivity::Ready;
        }
    }

    fn position(&self) -> (&str, usize) {
        self.current().map_or(("", 0), |action| {
            let text = self.listing.text(action.file);
            (text.file, text.line(action.span.start))
        })
    }

    fn dwells(&self) -> u32 {
        self.dwells
    }
}

/// The tool point in the robot base, with the orientation of the flange, at a commanded pose.
fn tool_point(frames: &Frames, xyz_mm: [f64; 3], abc_deg: [f64; 3]) -> Pose {
    let tool = frames.base.then(&Pose::from_kuka(xyz_mm, abc_deg));
    Pose { rotation: tool.rotation * frames.tool.rotation.transpose(), position: tool.position }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn executor() -> ListingExecutor {
        let robot = Robot::by_name("ur10e").expect("it is built in").expect("its file can be read");
        let text =
            crate::program::urscript::open(("p.script".into(), "def p():\n  sleep(1.0)\nend\n".into()));
        ListingExecutor::new(text.expect("it is a program"), &robot, 100.0)
    }

    /// A first-order lag T answers a ramp of the rate v with v (t - T (1 - exp(-t / T))), T = 0.08 s, and its speed is
    /// v (1 - exp(-t / T)); afterwards both decay with T.
    #[test]
    fn arm_lags_behind_its_command() {
        let (rate, start) = (0.5, [0.2; AXES]);
        let mut arm = LaggingArm { axes: start, speed: [0.0; AXES] };
        let mut command = start;
        command[0] += rate * 0.04;
        arm.follow(&start, &command, 0.04);
        let decay = (-0.5_f64).exp();
        assert!((arm.axes[0] - start[0] - rate * (0.04 - 0.08 * (1.0 - decay))).abs() < 1e-12);
        assert!((arm.speed[0] - rate * (1.0 - decay)).abs() < 1e-12);
        assert!((arm.axes[1] - start[1]).abs() < 1e-12);
        let behind = command[0] - arm.axes[0];
        arm.follow(&command, &command, 0.08);
        assert!((command[0] - arm.axes[0] - behind * (-1.0_f64).exp()).abs() < 1e-12);
        assert!((arm.speed[0] - (command[0] - arm.axes[0]) / 0.08).abs() < 1e-12);
    }

    #[test]
    fn arm_is_at_rest_within_its_band_or_at_zero_speed() {
        let command = [0.2; AXES];
        for (off, speed, in_position, zero_speed) in
            [(0.0, 0.0, true, true), (2.7e-4, 1.8e-4, true, false), (-2.9e-4, -1.7e-4, false, true)]
        {
            let mut arm = LaggingArm { axes: command, speed: [0.0; AXES] };
            (arm.axes[3], arm.speed[3]) = (command[3] + off, speed);
            assert_eq!(arm.is_at_rest(&command, Standstill::InPosition), in_position, "{off}");
            assert_eq!(arm.is_at_rest(&command, Standstill::ZeroSpeed), zero_speed, "{speed}");
        }
    }

    #[test]
    fn program_waits_and_ends() {
        let mut executor = executor();
        assert!(!executor.step(0.9).expect("it is possible").done);
        assert!(executor.step(0.2).expect("it is possible").done);
        assert!((executor.moment().t_s - 1.1).abs() < 1e-12);
    }
}
