//! `simulate`: lengths that a bar would read.

use std::collections::BTreeMap;

use dbbd_job::sim::World;
use dbbd_job::sim::world::{TrueBar, WorldSetup};
use dbbd_model::robot::AXES;
use pyo3::prelude::*;

use crate::arrays::{Floats, Numbers, Rows, Wholes, array, column};
use crate::error::Failure;
use crate::lengths::balls;
use crate::robot::PyRobot;

/// The lengths (mm) that a bar reads at rest at axis angles (degrees) of the true `robot`; NaN where the bar is out of its
/// stroke. Each pose is reached by a motion of its own, which draws the repeatability again.
#[pyfunction]
#[pyo3(signature = (
    axes_deg, ball, *, robot, balls_mm, bar_mm, stroke_mm=[-1e9, 1e9], noise_um=1.0, resolution_um=0.1,
    repeatability_um=0.0, backlash_deg=[0.0; AXES], seed=1
))]
#[allow(clippy::too_many_arguments)] // keywords of a Python function
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    axes_deg: Numbers<'py>,
    ball: Wholes<'py>,
    robot: &PyRobot,
    balls_mm: Numbers<'py>,
    bar_mm: f64,
    stroke_mm: [f64; 2],
    noise_um: f64,
    resolution_um: f64,
    repeatability_um: f64,
    backlash_deg: [f64; AXES],
    seed: u64,
) -> Result<Floats<'py>, Failure> {
    let q = Rows::<AXES>::of(&axes_deg, "axes_deg")?;
    let numbers = column(&ball, "ball", q.rows.len())?;
    let centres_mm: BTreeMap<u32, [f64; 3]> =
        balls(&balls_mm)?.iter().map(|ball| (ball.id.number(), ball.position.into())).collect();
    let bar = TrueBar {
        length_mm: bar_mm,
        stroke_mm,
        noise_um,
        resolution_um,
        rate_hz: 200.0,
        temperature_c: 20.0,
        force_n: 0.0,
    };
    let setup = WorldSetup {
        centres_mm,
        taught_deg: BTreeMap::new(),
        bar,
        repeatability_um,
        backlash_deg,
        following_ms: [0.0; AXES],
    };
    setup.check()?;
    let geometry = robot.robot().geometry.clone();
    let lengths = py.detach(|| {
        let poses = q.rows.iter().zip(&numbers);
        let poses = poses.map(|(axes, ball)| (axes.map(f64::to_radians), u32::try_from(*ball).unwrap_or(0)));
        let read = World::new(geometry, setup, seed).readings(poses);
        let length = |read: dbbd_job::sim::world::TrueReading| {
            if read.in_stroke { bar_mm + read.reading_mm } else { f64::NAN }
        };
        read.into_iter().map(length).collect::<Vec<f64>>()
    });
    Ok(array(py, lengths, &q.shape(&[]))?)
}
