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

/// A robot whose parameters have normal errors with `scale` times the tolerance of the nominal robot as standard
/// deviation: all a, alpha, theta and d; the last theta and d have the tolerances of the flange. A joint that is
/// nominally parallel to the joint before has an error of beta in place of d, because only the sum of the two d has an
/// effect. The same seed gives the same robot.
pub fn draw_true_robot(nominal: &Robot, seed: u64, scale: f64) -> Robot {
    // A separate random stream: the noise of the world is drawn with the plain seed.
    let mut random = Pcg64::seed_from_u64(seed ^ 0x7472_7574_6800_0000);
    let mut error = |sd: f64| {
        let normal: f64 = StandardNormal.sample(&mut random);
        scale * sd * normal
    };
    let tolerance = nominal.tolerance;
    let (length, angle) = (tolerance.length_mm, tolerance.angle_deg.to_radians());
    let (flange_mm, flange_rad) = (tolerance.flange_prior_mm(), tolerance.flange_prior_rad());
    let parallel = nominal.parallel_joints();
    let mut robot = nominal.clone();
    for (joint, row) in Joint::ALL.into_iter().zip(&mut robot.geometry.rows) {
        row.alpha += error(angle);
        row.a += error(length);
        let is_last = joint == Joint::J6;
        row.theta += error(if is_last { flange_rad } else { angle });
        if parallel.contains(&joint) {
            row.beta += error(angle);
        } else {
            row.d += error(if is_last { flange_mm } else { length });
        }
    }
    robot.name = format!("{}, true robot of seed {seed}", nominal.name);
    robot.nominal = None;
    robot
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 200 robots: the standard deviation of a standard deviation is 5 %.
    #[test]
    fn errors_have_the_tolerance_as_standard_deviation() {
        let nominal = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0])
            .expect("it is built in")
            .expect("its file can be read");
        let errors = |of: fn(&Robot) -> f64, scale: f64| {
            let squares =
                (0..200).map(|seed| (of(&draw_true_robot(&nominal, seed, scale)) - of(&nominal)).powi(2));
            (squares.sum::<f64>() / 200.0).sqrt()
        };
        // The file: 0.5 mm and 0.05 degrees; a flange 0.05 mm and 0.02 degrees. Joint 3 is parallel to joint 2.
        let angle = 0.05_f64.to_radians();
        for (of, expected) in [
            ((|robot| robot.geometry.rows[1].a) as fn(&Robot) -> f64, 0.5),
            (|robot| robot.geometry.rows[3].d, 0.5),
            (|robot| robot.geometry.rows[0].alpha, angle),
            (|robot| robot.geometry.rows[5].theta, 0.4 * angle),
            (|robot| robot.geometry.rows[5].d, 0.05),
            (|robot| robot.geometry.rows[2].beta, angle),
            (|robot| robot.geometry.rows[2].d, 0.0),
            (|robot| robot.geometry.rows[1].beta, 0.0),
        ] {
            for scale in [1.0, 3.0] {
                let found = errors(of, scale);
                assert!((found - scale * expected).abs() <= 0.2 * scale * expected, "{found} {expected}");
            }
        }
        assert_eq!(draw_true_robot(&nominal, 4, 1.0), draw_true_robot(&nominal, 4, 1.0));
    }

    /// The KR 60 repeats to 0.05 mm by ISO 9283: 0.05 / 3.616 of each coordinate.
    #[test]
    fn world_has_the_repeatability_of_the_robot() {
        let nominal = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0])
            .expect("it is built in")
            .expect("its file can be read");
        assert_eq!(noise(&nominal, 2.5), "repeatability_um = 13.827\n\n[bar]\nnoise_um = 2.5\n");
    }
}
