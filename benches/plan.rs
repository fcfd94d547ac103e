//! Times of the choice of poses: 80 of 20 000 candidates, 32 parameters.

#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion as Bench, criterion_group, criterion_main};
use dbbd::identifiability::{Belief, Criterion, Exchange, Workspace};
use dbbd::model::{Centre, LengthModel, Robot};
use dbbd::plan::candidates::{candidates, moves, rows};
use nalgebra::Vector3;

fn benches(c: &mut Bench) {
    let robot = Robot::by_name("kr60ha").expect("built in").expect("reads");
    let ball = Vector3::new(1300.0, 0.0, 800.0);
    let model = LengthModel::new(robot.geometry.clone(), &[Centre { id: 1, position: ball }]);
    let belief = Belief::datasheet(&robot, model, None);
    let pool = candidates(&robot.geometry, &robot.limits_deg, (1, ball), 300.0, None, 20_000, 1, |_| true);
    assert_eq!(pool.len(), 20_000);
    let pool = rows(&belief, &pool, 0.02);
    let moved = moves(&belief, &Workspace::uniform(&robot, 400, 1));
    let mut group = c.benchmark_group("80 of 20000 poses");
    group.sample_size(10);
    group.bench_function("D-optimal", |b| {
        b.iter(|| {
            let mut exchange = Exchange::new(black_box(&pool), &moved);
            exchange.extend(80, Criterion::D);
            exchange.improve(Criterion::D);
            exchange.chosen().len()
        });
    });
    group.bench_function("D-optimal, then I-optimal", |b| {
        b.iter(|| {
            let mut exchange = Exchange::new(black_box(&pool), &moved);
            exchange.extend(80, Criterion::D);
            exchange.improve(Criterion::D);
            exchange.improve(Criterion::I);
            exchange.chosen().len()
        });
    });
    group.finish();
}

criterion_group!(group, benches);
criterion_main!(group);
