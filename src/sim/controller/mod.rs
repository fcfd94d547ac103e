//! A controller that executes a program in virtual time; the program is its only source of motion.
//!
//! It knows the NOMINAL robot: Cartesian positions become axis angles by the nominal inverse kinematics, as in a real
//! controller. KRL is interpreted (`krl`); of other languages the list of what the program does is executed
//! (`listed`), with the stopping behaviour of their controllers.

mod arm;
mod krl;
mod listed;
mod motion;

use super::Moment;
use crate::diagnostic::Diagnostic;
use crate::program::Program;
use crate::robot::Robot;

#[derive(Clone, Debug)]
pub struct Controller(Machine);

#[derive(Clone, Debug)]
enum Machine {
    Krl(Box<krl::Interpreter>),
    Listed(Box<listed::Executor>),
}

impl Controller {
    /// A controller of the nominal `robot` with `program` selected, at `override_percent` (1 to 100).
    /// The robot is at its controller's home, or as near to it as its limits allow.
    pub fn new(
        program: impl Into<Program>,
        robot: &Robot,
        override_percent: f64,
    ) -> Result<Self, Diagnostic> {
        let percent = override_percent.clamp(1.0, 100.0).round();
        Ok(Self(match program.into() {
            Program::Krl(program) => Machine::Krl(Box::new(krl::Interpreter::new(program, robot, percent)?)),
            Program::Listed(listing) => {
                Machine::Listed(Box::new(listed::Executor::new(listing, robot, percent)))
            }
        }))
    }

    /// Goes on for `dt_s` seconds of device time.
    pub fn step(&mut self, dt_s: f64) -> Result<Moment, Diagnostic> {
        match &mut self.0 {
            Machine::Krl(machine) => machine.step(dt_s),
            Machine::Listed(machine) => machine.step(dt_s),
        }
    }

    /// Where it is now.
    pub fn moment(&self) -> Moment {
        match &self.0 {
            Machine::Krl(machine) => machine.moment(),
            Machine::Listed(machine) => machine.moment(),
        }
    }

    /// Presses START: a program that waits for the operator goes on.
    pub fn go_on(&mut self) {
        match &mut self.0 {
            Machine::Krl(machine) => machine.go_on(),
            Machine::Listed(machine) => machine.go_on(),
        }
    }

    /// File and line (from 1) of the statement that was begun last.
    pub fn position(&self) -> (&str, usize) {
        match &self.0 {
            Machine::Krl(machine) => machine.position(),
            Machine::Listed(machine) => machine.position(),
        }
    }

    /// How often the strobe went high and low again, or, in a program without a strobe, how often the measured axes were
    /// logged or the robot settled and waited.
    pub fn dwells(&self) -> u32 {
        match &self.0 {
            Machine::Krl(machine) => machine.dwells(),
            Machine::Listed(machine) => machine.dwells(),
        }
    }

    /// Says that the controller corrects by an accuracy model of its own, which the robot that it was given then is: a
    /// Cartesian command moves the axes elsewhere than the nominal robot's would, and in KRL `$ABS_ACCUR` is TRUE.
    pub fn correct_by_itself(&mut self) {
        if let Machine::Krl(machine) = &mut self.0 {
            machine.correct_by_itself();
        }
    }

    /// The name of each `.dat` file of a KRL program and its text with what the program has set since: scalars in their
    /// declarations, elements of arrays in lines before `ENDDAT`. All else stays as it is.
    pub fn saved(&self) -> Vec<(String, String)> {
        match &self.0 {
            Machine::Krl(machine) => machine.saved(),
            Machine::Listed(_) => Vec::new(),
        }
    }

    /// Says that telegrams are carried to a server: without that a KRL program cannot open a channel.
    pub fn link_ekrl(&mut self) {
        if let Machine::Krl(machine) = &mut self.0 {
            machine.link_ekrl();
        }
    }

    /// Whether the program holds the channel open.
    pub fn ekrl_open(&self) -> bool {
        matches!(&self.0, Machine::Krl(machine) if machine.ekrl_open())
    }

    /// The next telegram to be sent.
    pub fn telegram(&mut self) -> Option<String> {
        match &mut self.0 {
            Machine::Krl(machine) => machine.telegram(),
            Machine::Listed(_) => None,
        }
    }

    /// The `Id` of an answer that has come.
    pub fn answer(&mut self, id: i64) {
        if let Machine::Krl(machine) = &mut self.0 {
            machine.answer(id);
        }
    }
}
