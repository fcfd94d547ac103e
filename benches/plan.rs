//! Times of the choice of poses: 80 of 20 000 candidates, 32 parameters.

#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion as Bench, criterion_group, criterion_main};
use dbbd_model::design::{Criterion, Exchange, Sphere, design_rows, workspace_rows};
use dbbd_model::estimation::{Posterior, Priors, Workspace};
use dbbd_model::measurement::{BaseBall, LengthModel};
use dbbd_model::robot::{BallId, Robot};
use nalgebra::Vector3;

fn benches(c: &mut Bench) {
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).expect("built in").expect("reads");
    let ball = Vector3::new(1300.0, 0.0, 800.0);
    let model = LengthModel::new(robot.geometry.clone(), &[BaseBall { id: BallId::FIRST, position: ball }]);
    let belief = Posterior::prior(&robot, model, &Priors::datasheet(&robot, None));
    let sphere = Sphere {
        arm: &robot.geometry,
        controller: &robot,
        id: BallId::FIRST,
        ball,
        radius_mm: 300.0,
        near: None,
    };
    let pool = sphere.candidates(20_000, 1, |_| true);
    assert_eq!(pool.len(), 20_000);
    let pool = design_rows(&belief, &pool, 0.02);
    let moved = workspace_rows(&belief, &Workspace::uniform(&robot, 400, 1));
    let mut group = c.benchmark_group("80 of 20000 poses");
    group.sample_size(10);
    group.bench_function("D-optimal", |b| {
        b.iter(|| {
            let mut exchange = Exchange::new(black_box(&pool), &moved);
            exchange.choose(80, Criterion::D).len()
        });
    });
    group.bench_function("D-optimal, then I-optimal", |b| {
        b.iter(|| {
            let mut exchange = Exchange::new(black_box(&pool), &moved);
            exchange.choose(80, Criterion::I).len()
        });
    });
    group.finish();
}

criterion_group!(group, benches);
criterion_main!(group);
