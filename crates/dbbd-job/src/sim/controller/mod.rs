//! A controller that executes a program in virtual time; the program is its only source of motion.
//!
//! It knows only the NOMINAL robot: like a real controller it converts Cartesian positions to axis angles by the nominal
//! inverse kinematics. KRL is interpreted (`krl`). Of other languages the list of actions is executed (`listed`), with the
//! stopping behaviour of their controllers.

mod arm;
mod krl;
mod listed;
mod motion;

use std::fmt::Debug;
use std::ops::{Deref, DerefMut};

use super::ControllerMoment;
use crate::program::Program;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;

/// A simulated controller with a program selected.
#[derive(Debug)]
pub struct SimulatedController(Box<dyn ProgramExecutor>);

impl SimulatedController {
    /// A controller of the nominal `robot` with `program` selected, at `override_percent` (1 to 100). The robot is at the home
    /// position of its controller, or as near to it as its limits allow.
    pub fn new(
        program: impl Into<Program>,
        robot: &Robot,
        override_percent: f64,
    ) -> Result<Self, Diagnostic> {
        let percent = override_percent.clamp(1.0, 100.0).round();
        Ok(Self(match program.into() {
            Program::Krl(program) => Box::new(krl::Interpreter::new(program, robot, percent)?),
            Program::Listed(listing) => Box::new(listed::ListingExecutor::new(listing, robot, percent)),
        }))
    }
}

impl Deref for SimulatedController {
    type Target = dyn ProgramExecutor;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl DerefMut for SimulatedController {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut *self.0
    }
}

/// What executes a program. The default implementations are those of a controller without `.dat` files and EthernetKRL.
pub trait ProgramExecutor: Debug + Send {
    /// Continues for `dt_s` seconds of device time.
    fn step(&mut self, dt_s: f64) -> Result<ControllerMoment, Diagnostic>;

    fn moment(&self) -> ControllerMoment;

    /// Presses START: a program that waits for the operator continues.
    fn go_on(&mut self);

    /// File and line (from 1) of the statement that was begun last.
    fn position(&self) -> (&str, usize);

    /// Number of dwells so far: how often the strobe went high and low again. In a program without a strobe, how often the
    /// measured axes were logged, or the robot settled and waited.
    fn dwells(&self) -> u32;

    /// Switches to absolute-accuracy mode: the robot of the controller is the calibrated one, and in KRL `$ABS_ACCUR` is TRUE.
    fn set_absolute_accuracy(&mut self) {}

    /// Name and text of each `.dat` file with what the program has assigned: scalars in their declarations, elements of arrays
    /// in lines before `ENDDAT`.
    fn saved(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Connects EthernetKRL: telegrams are carried to a server. Without that a program cannot open a channel.
    fn link_ekrl(&mut self) {}

    /// Whether the program holds the channel open.
    fn ekrl_open(&self) -> bool {
        false
    }

    /// The next telegram to send.
    fn telegram(&mut self) -> Option<String> {
        None
    }

    /// Receives the `Id` of an answer.
    fn answer(&mut self, _id: i64) {}
}
