//! Times of the identification, to be compared with `benches/peers` in one run on one machine.
#![allow(missing_docs, clippy::expect_used)]

#[path = "support/problem.rs"]
mod problem;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dbbd_model::design::calibrate;
use dbbd_model::estimation::Options;
use dbbd_model::measurement::{ColumnSelection, LengthModel, PreparedMeasurement};
use dbbd_model::robot::{LengthRow, parameter};

use problem::{input, problem, thirteen};

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
    let readings: Vec<_> = observations.rows.iter().map(PreparedMeasurement::from).collect();
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
