//! Times of the inverse kinematics: all branches of a pose, for each kind of geometry.

#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dbbd_model::robot::inverse::branches;
use dbbd_model::robot::{Geometry, Robot};

fn built_in(name: &str) -> Geometry {
    Robot::by_name(name).expect("built in").expect("reads").geometry
}

fn benches(c: &mut Criterion) {
    // The wrist of a CRX-10iA/L: axes 4 and 6 pass each other at 150 mm.
    let mut offset = built_in("kr60ha");
    offset.rows[4].d = 150.0;
    let mut identified = built_in("kr60ha");
    identified.rows.iter_mut().for_each(|row| row.alpha += 1e-3);
    let arms = [
        ("spherical wrist", built_in("kr60ha")),
        ("three parallel axes", built_in("ur10")),
        ("identified", identified),
        ("offset wrist", offset),
    ];
    let mut group = c.benchmark_group("all branches");
    for (name, arm) in arms {
        let poses: Vec<_> = (0..100)
            .map(|k| arm.ball(&std::array::from_fn(|i| (f64::from(k) * 1.7 + i as f64 * 2.3).sin() * 1.5)))
            .collect();
        let mut pose = poses.iter().cycle();
        group.bench_function(name, |b| {
            b.iter(|| {
                branches(&arm, black_box(pose.next().expect("endless"))).map_or(0, |found| found.len())
            });
        });
    }
    group.finish();
}

criterion_group!(group, benches);
criterion_main!(group);
