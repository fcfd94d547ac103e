//! Executes a list of actions: the programs of RAPID and of URScript.
//!
//! Unlike KRL's interpreter it has an arm that lags behind its command: a motion ends for the program when the command
//! is at its end, and the arm comes to rest later. So a program that does not wait for standstill is seen to measure a
//! moving robot. The lag, the band and the speed are chosen for what one project found on its virtual controller of a
//! maker whose `fine` is such an end: 1.3 mm off without a wait, 0.28 mm in position, nothing at zero speed and 0.2 s later.

use super::arm::Arm;
use super::motion::{Arc, Motion, Path, Profile, Turn};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::listing::{Does, Move, Pace, Standstill};
use crate::program::{self, Frames, Language, Listing, Target};
use crate::robot::{AXES, Geometry, Pose, Robot, inverse};
use crate::sim::Moment;

/// Time constant of the lag, s.
const LAG_S: f64 = 0.08;
/// The arm is in position when no axis is further off than this, rad: 0.28 mm a metre from it.
const IN_POSITION: f64 = 2.8e-4;
/// It has no speed when no axis turns faster, rad/s.
const ZERO_SPEED: f64 = 1.75e-4;
/// The lag is followed in steps of these at most, s: while a standstill is waited for, and while the command moves.
const SETTLING_S: f64 = 0.004;
const MOVING_S: f64 = 0.02;
/// Greatest acceleration of the orientation, degrees/s^2, where a program cannot set one.
const TURN_DEG_S2: f64 = 500.0;
/// A speed of the tool in a motion of the axes is taken for that of a point so far from each axis, mm.
const LEVER_MM: f64 = 1000.0;

#[derive(Clone, Debug)]
enum Activity {
    Ready,
    Moving {
        motion: Box<Motion>,
        geometry: Box<Geometry>,
        /// That the end must have.
        configuration: Option<[i32; 4]>,
    },
    /// Until this time, s.
    Waiting(f64),
    Settling(Standstill),
    Halted,
    Done,
}

#[derive(Clone, Debug)]
pub(super) struct Executor {
    listing: Listing,
    arm: Arm,
    /// Where the arm is, rad; the command is that of `arm`.
    axes: [f64; AXES],
    /// How fast it goes, rad/s.
    speed: [f64; AXES],
    t_s: f64,
    /// The override, a share of the speed.
    rate: f64,
    /// Number of the action that is next.
    next: usize,
    activity: Activity,
    ball: u32,
    strobe: bool,
    /// When a pulse of the strobe ends, s.
    pulse_end_s: Option<f64>,
    has_strobe: bool,
    dwells: u32,
}

impl Executor {
    pub(super) fn new(listing: Listing, robot: &Robot, override_percent: f64) -> Self {
        let arm = Arm::at_home(robot, listing.language);
        let has_strobe = listing.actions.iter().any(|action| matches!(action.does, Does::Strobe(_)));
        Self {
            axes: arm.axes,
            arm,
            listing,
            speed: [0.0; AXES],
            t_s: 0.0,
            rate: override_percent / 100.0,
            next: 0,
            activity: Activity::Ready,
            ball: 1,
            strobe: false,
            pulse_end_s: None,
            has_strobe,
            dwells: 0,
        }
    }

    pub(super) fn step(&mut self, dt_s: f64) -> Result<Moment, Diagnostic> {
        let end_s = self.t_s + dt_s.max(0.0);
        while self.t_s < end_s {
            let longest_s = match self.activity {
                Activity::Settling(_) => SETTLING_S,
                Activity::Ready | Activity::Moving { .. } => MOVING_S,
                Activity::Waiting(_) | Activity::Halted | Activity::Done => f64::INFINITY,
            };
            self.slice((end_s - self.t_s).min(longest_s)).map_err(|finding| self.wrong(finding))?;
        }
        self.t_s = end_s;
        Ok(self.moment())
    }

    pub(super) fn moment(&self) -> Moment {
        Moment {
            t_s: self.t_s,
            axes: self.axes,
            centre: self.ball,
            strobe: self.strobe,
            motions: self.arm.motions,
            halted: matches!(self.activity, Activity::Halted),
            done: matches!(self.activity, Activity::Done),
        }
    }

    pub(super) fn go_on(&mut self) {
        if matches!(self.activity, Activity::Halted) {
            self.activity = Activity::Ready;
        }
    }

    pub(super) fn dwells(&self) -> u32 {
        self.dwells
    }

    /// The action that was begun last.
    fn current(&self) -> Option<&program::listing::Action> {
        self.listing.actions.get(self.next.saturating_sub(1))
    }

    pub(super) fn position(&self) -> (&str, usize) {
        self.current().map_or(("", 0), |action| {
            let text = self.listing.text(action.file);
            (text.file, text.line(action.span.start))
        })
    }

    fn wrong(&self, finding: ProgramFinding) -> Diagnostic {
        match self.current() {
            Some(action) => self.listing.wrong(action, finding),
            None => finding.into(),
        }
    }

    /// Goes on for so long, s, in which the command moves evenly.
    fn slice(&mut self, slice_s: f64) -> Result<(), ProgramFinding> {
        let end_s = self.t_s + slice_s;
        loop {
            let left_s = end_s - self.t_s;
            let from = self.arm.axes;
            let ended = self.proceed(left_s)?;
            let took_s = ended.unwrap_or(left_s);
            self.follow(&from, took_s);
            self.t_s += took_s;
            if self.pulse_end_s.is_some_and(|end_s| end_s <= self.t_s + 1e-9) {
                (self.strobe, self.pulse_end_s) = (false, None);
            }
            if ended.is_none() {
                return Ok(());
            }
            self.activity = Activity::Ready;
        }
    }

    /// Goes on with the present activity, at most so long, s; how long it took if it ended.
    fn proceed(&mut self, left_s: f64) -> Result<Option<f64>, ProgramFinding> {
        while matches!(self.activity, Activity::Ready) {
            self.begin()?;
        }
        let rate = self.rate;
        match &mut self.activity {
            Activity::Ready | Activity::Halted | Activity::Done => Ok(None),
            Activity::Waiting(until_s) => {
                let needed_s = (*until_s - self.t_s).max(0.0);
                Ok((needed_s <= left_s).then_some(needed_s))
            }
            Activity::Settling(standstill) => {
                let standstill = *standstill;
                Ok(self.is_at_rest(standstill).then_some(0.0))
            }
            Activity::Moving { motion, geometry, configuration } => {
                let ended = self.arm.advance(motion, geometry, [left_s, rate])?;
                if let (Some(_), Some(programmed)) = (ended, *configuration) {
                    let reached = inverse::quadrants(geometry, &self.arm.axes);
                    if reached != programmed {
                        return Err(ProgramFinding::OtherConfiguration {
                            programmed: format!("{programmed:?}"),
                            reached: format!("{reached:?}"),
                        });
                    }
                }
                Ok(ended)
            }
        }
    }

    /// The arm follows a command that went evenly from `from` to where it is now, in so long, s.
    fn follow(&mut self, from: &[f64; AXES], took_s: f64) {
        if took_s <= 0.0 {
            return;
        }
        let left = (-took_s / LAG_S).exp();
        for i in 0..AXES {
            let rate = (self.arm.axes[i] - from[i]) / took_s;
            // The answer of a lag of first order to a ramp.
            let behind = from[i] - self.axes[i] - rate * LAG_S;
            self.axes[i] = self.arm.axes[i] - rate * LAG_S - behind * left;
            self.speed[i] = (self.arm.axes[i] - self.axes[i]) / LAG_S;
        }
    }

    fn is_at_rest(&self, standstill: Standstill) -> bool {
        let off = |i: usize| (self.arm.axes[i] - self.axes[i]).abs();
        (0..AXES).all(|i| match standstill {
            Standstill::InPosition => off(i) <= IN_POSITION,
            Standstill::ZeroSpeed => self.speed[i].abs() <= ZERO_SPEED,
        })
    }

    /// Begins the next action.
    fn begin(&mut self) -> Result<(), ProgramFinding> {
        let Some(action) = self.listing.actions.get(self.next) else {
            self.activity = Activity::Done;
            return Ok(());
        };
        let does = action.does.clone();
        self.next += 1;
        match does {
            Does::Ball(ball) => self.ball = ball,
            Does::Wait(seconds) => {
                self.dwells += u32::from(!self.has_strobe && self.has_settled());
                self.activity = Activity::Waiting(self.t_s + seconds.max(0.0));
            }
            Does::Standstill(standstill) => self.activity = Activity::Settling(standstill),
            Does::Strobe(level) => {
                self.dwells += u32::from(level && self.has_settled());
                (self.strobe, self.pulse_end_s) = (level, None);
            }
            Does::Pulse(seconds) => (self.strobe, self.pulse_end_s) = (true, Some(self.t_s + seconds)),
            Does::Halt => self.activity = Activity::Halted,
            Does::Move(motion) => self.activity = self.moving(&motion)?,
        }
        Ok(())
    }

    /// Whether the action that begins follows a wait and then a standstill: that is how a dwell begins.
    fn has_settled(&self) -> bool {
        let before = self.listing.actions.get(..self.next.saturating_sub(1)).unwrap_or_default();
        let does = before.iter().rev().map(|action| &action.does);
        let standstills = does.take_while(|does| matches!(does, Does::Standstill(_))).count();
        let at = self.next.saturating_sub(2 + standstills);
        let waits = self.listing.actions.get(at).is_some_and(|action| matches!(action.does, Does::Wait(_)));
        standstills > 0 && waits
    }

    fn moving(&mut self, motion: &Move) -> Result<Activity, ProgramFinding> {
        let geometry = Geometry { tool: motion.frames.tool.position, ..self.arm.robot.geometry.clone() };
        if motion.motion == program::Motion::Ptp {
            let to = self.axes_at(motion, &geometry)?;
            self.arm.check_limits(&to)?;
            let path = Path::Axes { from: self.arm.axes, to };
            let motion = Box::new(self.arm.begin(path, self.axes_profile(&to, motion.pace)));
            return Ok(Activity::Moving { motion, geometry: Box::new(geometry), configuration: None });
        }
        if self.arm.motions == 0 {
            return Err(ProgramFinding::FirstMotion);
        }
        let from = geometry.ball(&self.arm.axes);
        let to = match &motion.to {
            Target::Axes(axes_deg) => geometry.ball(&axes_deg.map(f64::to_radians)),
            Target::Pose { xyz_mm, abc_deg, .. } => with_flange(&motion.frames, *xyz_mm, *abc_deg),
        };
        let (arc, length_mm) = match motion.through_mm {
            None => (None, (to.position - from.position).norm()),
            Some(through_mm) => {
                let via = with_flange(&motion.frames, through_mm, [0.0; 3]).position;
                let arc = Arc::through(from.position, via, to.position, None);
                let (arc, length_mm) = arc.ok_or(ProgramFinding::StraightArc)?;
                (Some(arc), length_mm)
            }
        };
        let turn = Turn::between(&from, &to);
        let profile = match motion.pace {
            Pace::Duration(seconds) => Profile::lasting(seconds),
            Pace::Tool { mm_s, mm_s2, deg_s } => {
                let turns = deg_s.map_or((0.0, 1.0, 1.0), |deg_s| {
                    (turn.angle, deg_s.to_radians(), TURN_DEG_S2.to_radians())
                });
                Profile::slowest([(length_mm, mm_s, mm_s2), turns])
            }
            Pace::Axis { .. } => return Err(ProgramFinding::NoSpeed { variable: "the speed".into() }),
        };
        let path = Path::Tool { from, to, turn, arc };
        Ok(Activity::Moving {
            motion: Box::new(self.arm.begin(path, profile)),
            geometry: Box::new(geometry),
            configuration: motion.configuration,
        })
    }

    /// The axis angles (rad) to which a motion of the axes goes.
    fn axes_at(&self, motion: &Move, geometry: &Geometry) -> Result<[f64; AXES], ProgramFinding> {
        let (xyz_mm, abc_deg) = match motion.to {
            Target::Axes(axes_deg) => return Ok(axes_deg.map(f64::to_radians)),
            Target::Pose { xyz_mm, abc_deg, .. } => (xyz_mm, abc_deg),
        };
        let pose = with_flange(&motion.frames, xyz_mm, abc_deg);
        let robot = || Robot { geometry: geometry.clone(), ..self.arm.robot.clone() };
        match motion.configuration {
            Some(configuration) => inverse::from_quadrants(&robot(), &pose, configuration),
            None if self.arm.motions == 0 && self.listing.language == Language::Rapid => {
                return Err(ProgramFinding::FirstMotion);
            }
            None => inverse::nearest(geometry, &pose, &self.arm.axes),
        }
        .map_err(|unsolved| ProgramFinding::NoAxisAngles { why: unsolved.to_string() })
    }

    fn axes_profile(&self, to: &[f64; AXES], pace: Pace) -> Profile {
        let (robot, hardest) = (&self.arm.robot, self.arm.robot.acceleration_deg_s2());
        let within = |deg_s: f64, deg_s2: f64| {
            Profile::within((0..AXES).map(|i| {
                let (speed, ramp) = (robot.max_speed_deg_s[i].min(deg_s), hardest[i].min(deg_s2));
                (to[i] - self.arm.axes[i], speed.to_radians(), ramp.to_radians())
            }))
        };
        let fastest = within(f64::INFINITY, f64::INFINITY);
        match pace {
            Pace::Duration(seconds) => fastest.not_before(seconds),
            Pace::Axis { deg_s, deg_s2 } => within(deg_s, deg_s2),
            Pace::Tool { mm_s, .. } => within((mm_s / LEVER_MM).to_degrees(), f64::INFINITY),
        }
    }
}

/// The tool point of a commanded pose in the robot base, with the flange's orientation.
fn with_flange(frames: &Frames, xyz_mm: [f64; 3], abc_deg: [f64; 3]) -> Pose {
    let tool = frames.base.then(&Pose::from_kuka(xyz_mm, abc_deg));
    Pose { rotation: tool.rotation * frames.tool.rotation.transpose(), position: tool.position }
}
