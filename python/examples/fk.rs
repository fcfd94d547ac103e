//! How long 100 000 forward kinematics take in Rust, s, the least of ten: what one call from Python is compared with.

use std::hint::black_box;
use std::time::Instant;

use dbbd_model::robot::{Pose, Robot};

fn main() {
    let Some(Ok(robot)) = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]) else { return };
    let axes: Vec<[f64; 6]> =
        (0..100_000).map(|at| std::array::from_fn(|axis| (0.37 * at as f64 + axis as f64).sin())).collect();
    let one = || {
        let started = Instant::now();
        let poses: Vec<Pose> = axes.iter().map(|axes| robot.geometry.ball(axes)).collect();
        black_box(poses);
        started.elapsed().as_secs_f64()
    };
    println!("{}", (0..10).map(|_| one()).fold(f64::INFINITY, f64::min));
}
