//! A true robot, drawn at random within the tolerances of the nominal one.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use dbbd_model::robot::{Joint, Robot};

/// The first keys of a WORLD.toml: a robot with the repeatability of its file, and a bar with the noise `sigma_um`.
pub fn noise(robot: &Robot, sigma_um: f64) -> String {
    let repeatability_um = 1e3 * robot.repeatability_sd_mm().unwrap_or(0.0);
    format!("repeatability_um = {repeatability_um:.3}\n\n[bar]\nnoise_um = {sigma_um:?}\n")
}

/// A robot whose parameters have normal errors with `scale` times the tolerance of the nominal robot as standard deviation:
/// all a, alpha, theta and d. A joint that is nominally parallel to the one before has an error of beta in place of d, because
/// only the sum of the two d has an effect. The same seed gives the same robot.
pub fn draw_true_robot(nominal: &Robot, seed: u64, scale: f64) -> Robot {
    // A random stream of its own: the noise of the world is drawn with the plain seed.
    let mut random = Pcg64::seed_from_u64(seed ^ 0x7472_7574_6800_0000);
    let mut error = |sd: f64| {
        let normal: f64 = StandardNormal.sample(&mut random);
        scale * sd * normal
    };
    let length = nominal.tolerance.length_mm;
    let angle = nominal.tolerance.angle_deg.to_radians();
    let parallel = nominal.parallel_joints();
    let mut robot = nominal.clone();
    for (joint, row) in Joint::ALL.into_iter().zip(&mut robot.geometry.rows) {
        row.alpha += error(angle);
        row.a += error(length);
        row.theta += error(angle);
        if parallel.contains(&joint) {
            row.beta += error(angle);
        } else {
            row.d += error(length);
        }
    }
    robot.name = format!("{}, true robot of seed {seed}", nominal.name);
    robot.nominal = None;
    robot
}
