//! The problem that `benches/peers` solves too: lengths of a robot with errors of its tolerance.
#![allow(clippy::expect_used)]

use dbbd_model::estimation::{AngleSource, Input, Options};
use dbbd_model::measurement::{BaseBall, Datum, LengthModel, Measurement, Measurements, TargetId};
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, ParamId, ParamUnit, PayloadId, Robot, parameter,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

/// Lengths of a robot with errors of its tolerance at random poses, sigma 0.01 mm, one ball.
pub(crate) fn problem(poses: usize) -> (Robot, Measurements, Vec<BaseBall>) {
    let mut random = Pcg64::seed_from_u64(1);
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).expect("built in").expect("reads");
    let mut truth = robot.geometry.clone();
    for id in parameter::parse_list("alpha1-5,a1-5,d4-6", &[], 1).expect("a list") {
        let sd = if id.unit() == ParamUnit::Mm { 0.5 } else { 0.05f64.to_radians() };
        *truth.value_mut(id).expect("geometric") += sd * random.sample::<f64, _>(rand_distr::StandardNormal);
    }
    let centre = Vector3::new(1300.0, 0.0, 800.0);
    let noise = Normal::new(0.0, 0.01).expect("positive");
    let rows = (0..poses)
        .map(|i| {
            let mut row = Measurement {
                index: i as u32 + 1,
                datum: Datum::Ball(BallId::FIRST, BarId::FIRST),
                target: TargetId::FIRST,
                axes: AxisAngles::from_degrees(std::array::from_fn(|j| {
                    let [low, high] = robot.limits_deg[j];
                    random.random_range(low..high)
                })),
                approach: Approach::default(),
                length_mm: 0.0,
                sigma_mm: None,
                payload: PayloadId::FIRST,
                context: None,
            };
            row.length_mm = truth.length(&row.axes.radians(), &centre, 0.0) + noise.sample(&mut random);
            row
        })
        .collect();
    (
        robot,
        Measurements { rows, ..Measurements::default() },
        vec![BaseBall { id: BallId::FIRST, position: centre }],
    )
}

pub(crate) fn thirteen() -> Vec<ParamId> {
    parameter::parse_list("alpha1-5,a1-5,d4-6", &[], 1).expect("a list")
}

pub(crate) fn input<'a>(
    robot: &'a Robot,
    observations: &'a Measurements,
    start: &'a LengthModel,
    options: &'a Options,
) -> Input<'a> {
    Input { robot, observations, start, validation: None, options, axes: AngleSource::Given }
}
