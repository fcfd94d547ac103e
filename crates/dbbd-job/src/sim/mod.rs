//! Simulated hardware: a controller that executes programs, the true robot, a virtual ball-bar.

mod catalogue;
pub use catalogue::SimulationFinding;

pub mod axes;
pub mod bar;
pub mod controller;
pub mod ekrl;
pub mod fault;
pub mod mounting;
mod terminal;
pub mod truth;
pub mod world;

pub use controller::SimulatedController;
pub use world::World;

use dbbd_model::robot::AXES;

/// The simulated controller at one moment of device time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerMoment {
    /// Device time since the start, s.
    pub t_s: f64,
    /// Commanded axis angles, rad.
    pub axes: [f64; AXES],
    /// Number of the base ball on which the bar sits, from 1.
    pub centre: u32,
    /// Whether the strobe output is high.
    pub strobe: bool,
    /// Number of motions that have begun; each one draws a new repeatability error.
    pub motions: u32,
    /// Whether the program waits at HALT.
    pub halted: bool,
    /// Whether the program has ended.
    pub done: bool,
}

#[cfg(test)]
mod tests;
