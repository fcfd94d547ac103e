//! An interpreter of KRL: statements take effect when they are reached, there is no advance run, and all stops are exact.

mod drive;
mod ekrl;
mod execute;
mod save;
mod start;
mod store;
mod variables;

use std::collections::BTreeMap;

use self::execute::Level;
use self::store::Names;
use super::arm::Arm;
use super::motion::Motion;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::krl::Program;
use crate::program::krl::evaluate::{At, Fault};
use crate::program::krl::syntax::{Expression, Span};
use crate::program::krl::value::Value;
use crate::sim::Moment;

/// Waits and motions in one step of time, after which a program is held to hang.
const ACTIVITIES: usize = 10_000;

/// What the controller is doing.
#[derive(Clone, Debug)]
enum Activity {
    /// The next statement is to be executed.
    Ready,
    Moving(Box<Motion>),
    /// Until this time, s.
    Waiting(f64),
    /// Until this condition holds.
    Until(Expression),
    /// Until the operator presses START.
    Halted,
    Done,
}

/// An output that goes back to a level at a time.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    output: usize,
    level: bool,
    until_s: f64,
}

/// The first and the last output (or input) of a signal, from 1.
#[derive(Clone, Copy, Debug)]
struct Signal {
    output: bool,
    first: usize,
    last: usize,
}

#[derive(Clone, Debug)]
pub(in crate::sim::controller) struct Interpreter {
    program: Program,
    arm: Arm,
    t_s: f64,
    dwells: u32,
    centre: u32,
    /// The output that is the strobe, where the program has one.
    strobe: Option<usize>,
    activity: Activity,
    levels: Vec<Level>,
    system: Names,
    /// Variables of each module's `.dat`.
    data: Vec<Names>,
    signals: Vec<BTreeMap<String, Signal>>,
    pulses: Vec<Pulse>,
    ekrl: ekrl::Channel,
    /// Module and bytes of the statement that was begun last.
    at: (usize, Span),
}

impl Interpreter {
    /// Goes on for `dt_s` seconds of device time.
    pub(in crate::sim::controller) fn step(&mut self, dt_s: f64) -> Result<Moment, Diagnostic> {
        let end_s = self.t_s + dt_s.max(0.0);
        self.run_to(end_s).map_err(|fault| self.diagnose(fault))?;
        self.t_s = end_s;
        self.end_pulses();
        Ok(self.moment())
    }

    fn run_to(&mut self, end_s: f64) -> Result<(), Fault> {
        for _ in 0..ACTIVITIES {
            if matches!(self.activity, Activity::Ready) {
                self.execute()?;
            }
            if !self.proceed(end_s)? {
                return Ok(());
            }
        }
        // Waits of no time, or of nearly none.
        Err(Fault::new(&self.at.1, ProgramFinding::NeverWaits))
    }

    /// Says that the controller corrects by an accuracy model of its own, which the robot that it was given
    /// then is: `$ABS_ACCUR` is TRUE, and a Cartesian command moves the axes elsewhere than the nominal robot's would.
    pub(in crate::sim::controller) fn correct_by_itself(&mut self) {
        if let Some(variable) = self.system.get_mut("$ABS_ACCUR") {
            variable.value = Value::Bool(true);
        }
    }

    /// Presses START: a program at HALT goes on.
    pub(in crate::sim::controller) fn go_on(&mut self) {
        if matches!(self.activity, Activity::Halted) {
            self.activity = Activity::Ready;
        }
    }

    /// File and line (from 1) of the statement that was begun last.
    pub(in crate::sim::controller) fn position(&self) -> (&str, usize) {
        let (module, span) = &self.at;
        self.program
            .modules
            .get(*module)
            .map_or(("", 0), |module| (module.source.file.as_str(), module.source.as_text().line(span.start)))
    }

    /// How often the strobe went high and low again, or, in a program without a strobe, how often the
    /// measured axes were logged.
    pub(in crate::sim::controller) fn dwells(&self) -> u32 {
        self.dwells
    }

    pub(in crate::sim::controller) fn moment(&self) -> Moment {
        Moment {
            t_s: self.t_s,
            axes: self.arm.axes,
            centre: self.centre,
            strobe: self.strobe.is_some_and(|output| self.output(output)),
            motions: self.arm.motions,
            halted: matches!(self.activity, Activity::Halted),
            done: matches!(self.activity, Activity::Done),
        }
    }

    /// Goes on with the present activity up to `end_s`; whether it ended before, so that the next
    /// statement has its turn.
    fn proceed(&mut self, end_s: f64) -> Result<bool, Fault> {
        let left_s = end_s - self.t_s;
        match std::mem::replace(&mut self.activity, Activity::Ready) {
            Activity::Ready => return Ok(true),
            Activity::Waiting(until_s) if until_s <= end_s => {
                self.t_s = self.t_s.max(until_s);
                self.end_pulses();
                return Ok(true);
            }
            Activity::Until(condition) => {
                if condition.bool(self)? {
                    return Ok(true);
                }
                self.activity = Activity::Until(condition);
            }
            Activity::Moving(mut motion) => {
                // The override stretches the time on the path.
                let (rate, geometry) = (self.override_share(), self.geometry());
                let ended = self.arm.advance(&mut motion, &geometry, [left_s, rate]).at(&self.at.1)?;
                if let Some(needed_s) = ended {
                    self.t_s += needed_s;
                    self.end_pulses();
                    return Ok(true);
                }
                self.activity = Activity::Moving(motion);
            }
            other => self.activity = other,
        }
        Ok(false)
    }

    fn system(&self, name: &str) -> Option<&Value> {
        self.system.get(name).map(|variable| &variable.value)
    }

    /// `$OV_PRO` as a share.
    fn override_share(&self) -> f64 {
        let percent = self.system("$OV_PRO").and_then(|value| value.number().ok());
        percent.unwrap_or(100.0).clamp(0.0, 100.0) / 100.0
    }

    fn end_pulses(&mut self) {
        let now_s = self.t_s + 1e-9;
        let (due, left) = self.pulses.iter().partition(|pulse| pulse.until_s <= now_s);
        self.pulses = left;
        let due: Vec<Pulse> = due;
        for pulse in due {
            self.set_output(pulse.output, pulse.level);
        }
    }

    /// The level of an output, from 1.
    fn output(&self, output: usize) -> bool {
        match self.system("$OUT") {
            Some(Value::Array(levels)) => {
                output.checked_sub(1).and_then(|at| levels.get(at)) == Some(&Value::Bool(true))
            }
            _ => false,
        }
    }

    fn set_output(&mut self, output: usize, level: bool) {
        self.set_bit("$OUT", output, level);
    }

    /// Sets an element, from 1, of a system variable that is an array of BOOL.
    fn set_bit(&mut self, array: &str, number: usize, level: bool) {
        if let Some(Value::Array(levels)) = self.system.get_mut(array).map(|variable| &mut variable.value)
            && let Some(here) = number.checked_sub(1).and_then(|at| levels.get_mut(at))
        {
            *here = Value::Bool(level);
        }
    }

    /// The module whose routine runs.
    fn module(&self) -> usize {
        self.levels.iter().rev().find_map(Level::module).unwrap_or(self.at.0)
    }

    /// A fault as the user reads it.
    fn diagnose(&self, fault: Fault) -> Diagnostic {
        match self.program.modules.get(self.module()) {
            Some(module) => module.source.as_text().wrong(&fault.span, fault.finding),
            None => fault.finding.into(),
        }
    }
}
