//! A controller with a program selected.

use std::ops::{Deref, DerefMut};

use super::{ProgramExecutor, krl, listed};
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
