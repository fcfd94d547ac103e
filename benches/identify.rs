//! Times of the identification, to be compared with `benches/peers` in one run on one machine.
#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dbbd_model::design::calibrate;
use dbbd_model::estimation::{AngleSource, Input, Options};
use dbbd_model::measurement::{
    BaseBall, ColumnSelection, Datum, LengthModel, Measurement, Measurements, TargetId,
};
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, LengthRow, ParamId, ParamUnit, PayloadId, Robot, parameter,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

/// Lengths of a robot with errors of its tolerance at random poses, sigma 0.01 mm, one ball.
fn problem(poses: usize) -> (Robot, Measurements, Vec<BaseBall>) {
    let mut random = Pcg64::seed_from_u64(1);
    let robot = Robot::by_name("kr60ha").expect("built in").expect("reads");
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

fn thirteen() -> Vec<ParamId> {
    parameter::parse_list("alpha1-5,a1-5,d4-6", &[], 1).expect("a list")
}

fn input<'a>(
    robot: &'a Robot,
    observations: &'a Measurements,
    start: &'a LengthModel,
    options: &'a Options,
) -> Input<'a> {
    Input { robot, observations, start, validation: None, options, axes: AngleSource::Given }
}

fn benches(c: &mut Criterion) {
    for poses in [80, 1000] {
        let (robot, observations, centres) = problem(poses);
        let start = LengthModel::new(robot.geometry.clone(), &centres);
        let options = Options { estimate: Some(thirteen()), folds: Some(0), ..Options::default() };
        c.bench_function(&format!("fit 13 parameters, {poses} poses"), |b| {
            b.iter(|| input(black_box(&robot), &observations, &start, &options).fit());
        });
        let options = Options { folds: Some(0), ..Options::default() };
        c.bench_function(&format!("all parameters with the full report, {poses} poses"), |b| {
            b.iter(|| calibrate(&input(black_box(&robot), &observations, &start, &options), Vec::new()));
        });
    }
    let (robot, observations, centres) = problem(1000);
    let readings: Vec<_> =
        observations.rows.iter().map(dbbd_model::measurement::PreparedMeasurement::from).collect();
    // Divide by 1000 for one pose; sines and cosines of the axis angles are taken in the first, once before in the second.
    c.bench_function("1000 Jacobian rows of all columns, from axis angles", |b| {
        b.iter(|| {
            for reading in &readings {
                black_box(robot.geometry.length_row(&reading.axes, &centres[0].position, 0.0));
            }
        });
    });
    let model = LengthModel::new(robot.geometry.clone(), &centres);
    let ids = parameter::all_parameters(&robot.parallel_joints(), 1);
    let selection = ColumnSelection::new(&ids);
    c.bench_function(&format!("1000 Jacobian rows of {} columns, in the solver", ids.len()), |b| {
        let (mut derivatives, mut row) = (LengthRow::default(), vec![0.0; ids.len()]);
        b.iter(|| {
            let prepared = model.prepare();
            for reading in &readings {
                prepared.row_into(reading, &selection, &mut derivatives);
                selection.pick(&derivatives, &mut row);
                black_box(&row);
            }
        });
    });
}

criterion_group!(group, benches);
criterion_main!(group);
