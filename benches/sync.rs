//! An hour at 1 kHz, 3.6 million samples: joined to its plan, and evaluated as a circle.
//!
//! `cargo bench --bench sync`. Memory: the stream holds 17 bytes a sample (time, reading, flags), 61 MB;
//! the circle's points 120 bytes and its rays 24 bytes each.
#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::recording::matching::{MatchingInput, match_poses};
use dbbd_job::recording::{DeviceClock, SampleStream, StreamBuilder};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::circular::{CirclePoint, CircleSense, CircleTrace, CircularSettings, circular};
use dbbd_model::measurement::sample::Sample;
use dbbd_model::robot::Robot;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const SAMPLES: u64 = 3_600_000;

/// The demonstration's circles with 240 points each, driven once: 750 dwells fill most of the hour.
fn run() -> (Plan, SampleStream) {
    let text = include_str!("../examples/circles.toml").replace("points = 80", "points = 240");
    let job = Job::from_toml("circles.toml", &text).expect("reads");
    let plan = Plan::build(
        &job,
        &Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).expect("built in").expect("reads"),
    )
    .expect("safe");
    let mut random = Pcg64::seed_from_u64(1);
    // Time at which each row is left, and whether it is a dwell.
    let (mut edges, mut t_s, mut level) = (Vec::new(), 5.0, 0.0);
    for (row, time) in plan.rows.iter().zip(&plan.header.moves) {
        let to = random.random_range(-0.3..0.3);
        edges.push((t_s, t_s + time.duration_s, level, to));
        t_s += time.duration_s;
        if row.kind != PoseKind::Transit {
            t_s += job.motion.settle_s + row.dwell_s + 0.1;
        }
        level = to;
    }
    let mut stream = StreamBuilder::new(Some(DeviceClock { seconds_per_tick: 1e-6, wrap: Some(1 << 32) }));
    let mut at = 0;
    for k in 0..SAMPLES {
        let t_s = k as f64 * 1e-3;
        while at + 1 < edges.len() && edges[at + 1].0 <= t_s {
            at += 1;
        }
        let (from_s, to_s, from, to) = edges[at];
        let share = ((t_s - from_s) / (to_s - from_s).max(1e-9)).clamp(0.0, 1.0);
        let sample = Sample {
            sequence: Some(k as u32),
            ticks: Some(DeviceTicks((k * 1000) % (1 << 32))),
            ..Sample::of(from + share * (to - from) + random.random_range(-0.002..0.002))
        };
        stream.push(HostNs(k * 1_000_000 + 2_000_000), &sample);
    }
    (plan, stream.build())
}

fn circle() -> Vec<CircleTrace> {
    let mut random = Pcg64::seed_from_u64(2);
    let half = SAMPLES / 2;
    [CircleSense::CounterClockwise, CircleSense::Clockwise]
        .map(|sense| {
            let sign = if sense == CircleSense::Clockwise { -1.0 } else { 1.0 };
            let point = |k: u64| {
                let angle_deg = sign * 360.0 * k as f64 / half as f64;
                let theta = angle_deg.to_radians();
                let form = 0.005 * (2.0 * theta).sin() + 0.1 * theta.cos();
                let length_mm = 150.0 + form + random.random_range(-0.001..0.001);
                CirclePoint {
                    angle_deg,
                    length_mm,
                    sigma_mm: None,
                    t_s: None,
                    temp_c: None,
                    axes_deg: None,
                    drives: None,
                }
            };
            CircleTrace { run: "1".into(), sense, points: (0..half).map(point).collect() }
        })
        .into()
}

fn hour(bench: &mut Criterion) {
    let mut group = bench.benchmark_group("an hour at 1 kHz");
    group.sample_size(10);
    let (plan, stream) = run();
    group.bench_function("sync", |bench| {
        bench.iter(|| match_poses(black_box(&MatchingInput::new(&plan, &stream))))
    });
    drop(stream);
    let traces = circle();
    let settings = CircularSettings { draws: 100, ..CircularSettings::new(150.0) };
    group.bench_function("circle", |bench| bench.iter(|| circular(black_box(&traces), &settings)));
    group.finish();
}

criterion_group!(benches, hour);
criterion_main!(benches);
