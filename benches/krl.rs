//! Times of writing, reading and compensating programs of 100 000 points.

#![allow(missing_docs, clippy::expect_used, clippy::panic)]

#[path = "support/production.rs"]
mod production;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::program::Correction;
use dbbd_job::program::krl::{
    Controller, Files, Given, Options, Sync, Text, compensate, emit, parse_data, parse_source, read,
};
use dbbd_job::sim::truth;
use dbbd_model::robot::Robot;

use production::production;

const POINTS: usize = 100_000;
const JOB: &str = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\n\
                   xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 200\norientation = \"fixed\"\n\
                   tilt_deg = 20.0";

/// A circle of 200 poses, as often as makes the points: one module each.
fn plan(robot: &Robot) -> Plan {
    let mut plan = Plan::build(&Job::from_toml("job", JOB).expect("a job"), robot).expect("a plan");
    let (rows, moves) = (plan.rows.clone(), plan.header.moves.clone());
    let dwells = rows.iter().filter(|row| row.kind == PoseKind::Measure).count();
    (plan.rows, plan.header.moves) = (Vec::new(), Vec::new());
    for circle in 1..=POINTS.div_ceil(dwells) {
        for (row, time) in rows.iter().zip(&moves) {
            let index = plan.rows.len() as u32 + 1;
            let mut row = row.clone();
            (row.index, row.circle) = (index, circle as u32);
            plan.rows.push(row);
            let mut time = *time;
            time.index = index;
            plan.header.moves.push(time);
        }
    }
    plan
}

fn benches(c: &mut Criterion) {
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).expect("built in").expect("reads");
    let plan = plan(&robot);
    let options = Options { sync: Sync::Output, controller: Controller::Krc4 };
    let files = emit(&plan, options).expect("a program");
    let mut group = c.benchmark_group("100000 points");
    group.sample_size(10);
    group.bench_function("write", |b| b.iter(|| emit(black_box(&plan), options).expect("a program").len()));
    group.bench_function("read back", |b| {
        b.iter(|| {
            let mut points = 0;
            for pair in files.chunks(2).skip(1) {
                let [(name, source), (data_name, data)] = pair else { panic!("a .src and its .dat") };
                parse_source(name, source).expect("reads");
                parse_data(data_name, data).expect("reads");
                let data = Some(Text { file: data_name, text: data });
                let files = Files { source: Text { file: name, text: source }, data, config: None };
                points += read(files, Given::default()).expect("points").motions.len();
            }
            points
        });
    });
    let (source, data) = production(&robot, POINTS);
    let files = Files {
        source: Text { file: "P.src", text: &source },
        data: Some(Text { file: "P.dat", text: &data }),
        config: None,
    };
    let points = read(files, Given::default()).expect("points");
    assert_eq!(points.points.len(), POINTS);
    let identified =
        Robot { nominal: Some(Box::new(robot.clone())), ..truth::draw_true_robot(&robot, 1, 1.0) };
    group.bench_function("read for compensation", |b| {
        b.iter(|| read(files, Given::default()).expect("points").points.len())
    });
    group.bench_function("compensate", |b| {
        b.iter(|| {
            compensate(files, black_box(&points), Correction::of(&identified, 50.0))
                .expect("compensated")
                .moved
                .len()
        });
    });
    group.finish();
}

criterion_group!(group, benches);
criterion_main!(group);
