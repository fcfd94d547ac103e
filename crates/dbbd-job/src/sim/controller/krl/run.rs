//! Runs a program: from one statement that takes time to the next.

use super::{
    DwellCounter, EkrlChannel, ExecutionLevel, Interpreter, KrlActivity, KrlCallStack, KrlVariables,
    ModuleMemory, OutputPulse, memory,
};
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::krl::Program;
use crate::program::krl::evaluate::{At, Fault};
use crate::program::krl::value::Value;
use crate::sim::ControllerMoment;
use crate::sim::controller::{ProgramExecutor, SimulatedArm};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;

/// Most waits and motions in one step of time: a program with more is assumed to hang.
const ACTIVITIES: usize = 10_000;

impl Interpreter {
    pub(in crate::sim::controller) fn new(
        program: Program,
        robot: &Robot,
        override_percent: f64,
    ) -> Result<Self, Diagnostic> {
        let mut interpreter = Self {
            arm: SimulatedArm::at_home(robot, Language::Krl),
            t_s: 0.0,
            ball: 1,
            dwells: DwellCounter::default(),
            activity: KrlActivity::Ready,
            calls: KrlCallStack { levels: Vec::new(), at: (0, 0..0) },
            system: memory::system(program.is_kss5()),
            memory: vec![ModuleMemory::default(); program.modules.len()],
            pulses: Vec::new(),
            ekrl: EkrlChannel::default(),
            program,
        };
        interpreter.set_system("$OV_PRO", Value::Int(override_percent as i64));
        for module in 0..interpreter.program.modules.len() {
            interpreter.calls.at = (module, 0..0);
            interpreter.load(module)?;
        }
        interpreter.calls.at = (0, 0..0);
        let mut strobes = interpreter.memory.iter().filter_map(|memory| memory.signals.get("DBBSTB"));
        interpreter.dwells.strobe = strobes.next().map(|signal| signal.first);
        if let Some(first) =
            interpreter.program.modules.first().and_then(|module| module.source.routines.first())
        {
            interpreter.calls.levels.push(ExecutionLevel::routine(0, first, KrlVariables::new()));
            interpreter.select_ball(0);
        }
        Ok(interpreter)
    }

    fn run_to(&mut self, end_s: f64) -> Result<(), Fault> {
        for _ in 0..ACTIVITIES {
            if matches!(self.activity, KrlActivity::Ready) {
                self.execute()?;
            }
            if !self.proceed(end_s)? {
                return Ok(());
            }
        }
        // The waits take no time, or nearly none.
        Err(Fault::new(&self.calls.at.1, ProgramFinding::NeverWaits))
    }

    /// Continues the current activity up to `end_s`. Returns whether the activity ended before, so that the next
    /// statement is due.
    fn proceed(&mut self, end_s: f64) -> Result<bool, Fault> {
        let left_s = end_s - self.t_s;
        match std::mem::replace(&mut self.activity, KrlActivity::Ready) {
            KrlActivity::Ready => return Ok(true),
            KrlActivity::Waiting(until_s) if until_s <= end_s => {
                self.t_s = self.t_s.max(until_s);
                self.end_pulses();
                return Ok(true);
            }
            KrlActivity::Until(condition) => {
                if condition.bool(self)? {
                    return Ok(true);
                }
                self.activity = KrlActivity::Until(condition);
            }
            KrlActivity::Moving(mut motion) => {
                // The override stretches the time along the path.
                let (rate, geometry) = (self.override_share(), self.geometry());
                let ended = self.arm.advance(&mut motion, &geometry, [left_s, rate]).at(&self.calls.at.1)?;
                if let Some(needed_s) = ended {
                    self.t_s += needed_s;
                    self.end_pulses();
                    return Ok(true);
                }
                self.activity = KrlActivity::Moving(motion);
            }
            other @ (KrlActivity::Waiting(_) | KrlActivity::Halted | KrlActivity::Done) => {
                self.activity = other;
            }
        }
        Ok(false)
    }

    fn set_system(&mut self, name: &str, value: Value) {
        if let Some(variable) = self.system.get_mut(name) {
            variable.value = value;
        }
    }

    /// `$OV_PRO` as a share.
    fn override_share(&self) -> f64 {
        let percent = self.system("$OV_PRO").and_then(|value| value.number().ok());
        percent.unwrap_or(100.0).clamp(0.0, 100.0) / 100.0
    }

    fn end_pulses(&mut self) {
        let now_s = self.t_s + 1e-9;
        let (ended, pulses): (Vec<OutputPulse>, _) =
            self.pulses.iter().partition(|pulse| pulse.until_s <= now_s);
        self.pulses = pulses;
        for pulse in ended {
            self.set_bit("$OUT", pulse.output, pulse.level);
        }
    }

    fn diagnostic(&self, fault: Fault) -> Diagnostic {
        match self.program.modules.get(self.module()) {
            Some(module) => module.source.as_text().wrong(&fault.span, fault.finding),
            None => fault.finding.into(),
        }
    }
}

impl ProgramExecutor for Interpreter {
    fn step(&mut self, dt_s: f64) -> Result<ControllerMoment, Diagnostic> {
        let end_s = self.t_s + dt_s.max(0.0);
        self.run_to(end_s).map_err(|fault| self.diagnostic(fault))?;
        self.t_s = end_s;
        self.end_pulses();
        Ok(self.moment())
    }

    fn moment(&self) -> ControllerMoment {
        ControllerMoment {
            t_s: self.t_s,
            axes: self.arm.axes,
            centre: self.ball,
            strobe: self.dwells.strobe.is_some_and(|output| self.output(output)),
            motions: self.arm.motions,
            halted: matches!(self.activity, KrlActivity::Halted),
            done: matches!(self.activity, KrlActivity::Done),
        }
    }

    fn go_on(&mut self) {
        if matches!(self.activity, KrlActivity::Halted) {
            self.activity = KrlActivity::Ready;
        }
    }

    fn position(&self) -> (&str, usize) {
        let (module, span) = &self.calls.at;
        self.program
            .modules
            .get(*module)
            .map_or(("", 0), |module| (module.source.file.as_str(), module.source.as_text().line(span.start)))
    }

    fn dwells(&self) -> u32 {
        self.dwells.count
    }

    fn set_absolute_accuracy(&mut self) {
        self.set_system("$ABS_ACCUR", memory::absolute_accuracy(self.program.is_kss5(), true));
    }

    fn saved(&self) -> Vec<(String, String)> {
        self.saved_files()
    }

    fn link_ekrl(&mut self) {
        self.ekrl.is_linked = true;
    }

    fn ekrl_open(&self) -> bool {
        self.ekrl.is_open
    }

    fn telegram(&mut self) -> Option<String> {
        self.ekrl.sent.pop_front()
    }

    fn answer(&mut self, id: i64) {
        self.receive_answer(id);
    }
}
