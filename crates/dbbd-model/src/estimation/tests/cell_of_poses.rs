//! Poses all over the range of a robot, with a length to every base ball at each: what the tests of the parts of an estimate share.

use nalgebra::{DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::estimation::hyper_parameters::{HyperPrior, Hypers};
use crate::measurement::{BaseBall, LengthModel, PreparedMeasurement};
use crate::robot::{AXES, BallId, ParamId, ParamUnit, Robot};
use crate::test_support::cell::kr60;

pub(in crate::estimation) const PLACES: [[f64; 3]; 3] =
    [[1300.0, 0.0, 800.0], [1000.0, 700.0, 400.0], [900.0, -600.0, 1200.0]];

pub(in crate::estimation) fn base_balls(count: usize) -> Vec<BaseBall> {
    let ball = |at: usize| BaseBall { id: BallId::at(at), position: Vector3::from(PLACES[at]) };
    (0..count).map(ball).collect()
}

/// The KR 60 HA with the first of the base balls.
pub(in crate::estimation) fn model(balls: usize) -> LengthModel {
    LengthModel::new(kr60().geometry, &base_balls(balls))
}

/// Axis angles in the working range, rad.
pub(in crate::estimation) fn pose(random: &mut Pcg64) -> [f64; AXES] {
    let middle: [f64; AXES] = [0.0, -60.0, 90.0, 0.0, 60.0, 0.0];
    let range = [60.0, 25.0, 30.0, 90.0, 40.0, 120.0];
    std::array::from_fn(|axis| (middle[axis] + range[axis] * random.random_range(-1.0..1.0)).to_radians())
}

/// A length to each ball of the model at each pose, as the model has it.
pub(in crate::estimation) fn readings(
    model: &LengthModel,
    poses: usize,
    seed: u64,
) -> Vec<PreparedMeasurement> {
    let mut random = Pcg64::seed_from_u64(seed);
    let prepared = model.prepare();
    let mut readings = Vec::new();
    for _ in 0..poses {
        let axes = pose(&mut random);
        for ball in 0..model.balls.len() {
            let mut reading = PreparedMeasurement::new(axes, BallId::at(ball), 0.0);
            reading.length_mm = prepared.length(&reading);
            readings.push(reading);
        }
    }
    readings
}

pub(in crate::estimation) fn normal(random: &mut Pcg64) -> f64 {
    StandardNormal.sample(random)
}

pub(in crate::estimation) fn normals(count: usize, seed: u64) -> DVector<f64> {
    let mut random = Pcg64::seed_from_u64(seed);
    DVector::from_fn(count, |_, _| normal(&mut random))
}

/// A robot drawn by the maker's tolerance.
pub(in crate::estimation) fn drawn(nominal: &Robot, seed: u64) -> Robot {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut robot = nominal.clone();
    for id in ParamId::denavit_hartenberg() {
        let tolerance = match id.unit() {
            ParamUnit::Mm => nominal.tolerance.length_mm,
            _ => nominal.tolerance.angle_deg.to_radians(),
        };
        *robot.geometry.value_mut(id).unwrap() += tolerance * normal(&mut random);
    }
    robot
}

/// The middle of the priors, with this noise of a pose, mm.
pub(in crate::estimation) fn hypers(sigma_mm: f64) -> Hypers {
    Hypers::start(&HyperPrior::all(0.03), sigma_mm)
}
