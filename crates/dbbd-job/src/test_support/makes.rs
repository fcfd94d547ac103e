//! Robots of several makes: a job for each, and its program on the simulated controller.

use dbbd_job::program::Program;
use dbbd_job::sim::{ControllerMoment, SimulatedController};
use dbbd_model::robot::Robot;

/// A job of one circle of dwells about a ball.
pub(crate) fn job(robot: &str, centre: [f64; 3], points: usize) -> String {
    // A robot of the catalogue has no tool ball; a robot file has its own.
    let tool = Robot::built_in_file(robot).map_or("", |_| "tool.ball_mm = [0.0, 0.0, 0.0]\n");
    format!(
        "robot = '{robot}'\n{tool}[bar]\nlength_mm = 300.0\nstroke_mm = [-15.0, 15.0]\nmargin_mm = 0.5\nsigma_um = 20.0\n\
         length_u_mm = 0.002\n[[centre]]\nid = 1\nxyz_mm = {centre:?}\n[[circle]]\nplane = 'XY'\npoints = {points}\n\
         tilt_deg = 15.0\n"
    )
}

/// Runs to the end; the operator never keeps the program waiting.
pub(crate) fn run(program: impl Into<Program>, robot: &Robot) -> Vec<ControllerMoment> {
    let mut controller = SimulatedController::new(program, robot, 100.0).unwrap();
    let mut moments = Vec::new();
    while moments.len() < 500_000 {
        let moment = controller.step(0.02).unwrap();
        moments.push(moment);
        if moment.halted {
            controller.go_on();
        }
        if moment.done {
            return moments;
        }
    }
    panic!("never ends")
}
