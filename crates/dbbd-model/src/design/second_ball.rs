//! The best place of a second base ball: for each place the best poses are chosen.

use nalgebra::{Rotation3, Vector3};

use super::placement::{BallPlace, Placement};
use super::{Sphere, workspace_rows};
use crate::estimation::Posterior;
use crate::robot::{AXES, BallId, Robot};

/// Candidate poses about each ball.
const CANDIDATES: usize = 300;
/// Places relative to the first ball: radially (mm), upwards (mm) and about axis 1 (degrees). The first is only rotated.
const PLACES: [([f64; 3], &str); 6] = [
    ([0.0, 0.0, 60.0], "turned about axis 1 alone"),
    ([-350.0, 0.0, 60.0], "nearer to axis 1"),
    ([0.0, -400.0, 60.0], "lower"),
    ([0.0, 400.0, 60.0], "higher"),
    ([-350.0, -400.0, 60.0], "nearer and lower"),
    ([-350.0, 400.0, 60.0], "nearer and higher"),
];

/// A plan with one base ball.
pub struct OneBall<'a> {
    pub robot: &'a Robot,
    pub ball: Vector3<f64>,
    pub radius_mm: f64,
    /// Number of lengths, each of standard deviation `sigma_mm`.
    pub lengths: usize,
    pub sigma_mm: f64,
    /// Axis vectors (rad) over which the position error is predicted.
    pub workspace: &'a [[f64; AXES]],
    pub seed: u64,
}

/// The best place of a second ball.
pub struct SecondBall {
    pub place: &'static str,
    pub ball: Vector3<f64>,
    /// The position error with as many poses about both balls, as a fraction of the error with the best poses about the first.
    pub share: f64,
    /// The same fraction for a ball that is only rotated about axis 1.
    pub turned_share: f64,
    /// Number of places that were compared.
    pub places: usize,
}

impl OneBall<'_> {
    /// `prior` returns the prior with balls at places. `None` if no place has enough poses.
    pub fn second(
        &self,
        prior: impl Fn(&[Vector3<f64>]) -> Posterior + Sync,
        allows: impl Fn(&[f64; AXES]) -> bool,
    ) -> Option<SecondBall> {
        let errors = |known: &Posterior| workspace_rows(known, self.workspace);
        let placement = Placement { prior: &prior, errors: &errors, sigma_mm: self.sigma_mm };
        let first = self.reached(self.ball, &allows);
        let alone_mm = placement.error_mm(&[&first], self.lengths)?;
        let tried = PLACES.iter().filter_map(|(shift, place)| {
            let other = self.reached(self.moved(*shift), &allows);
            let left_mm = placement.error_mm(&[&first, &other], self.lengths)?;
            Some((left_mm / alone_mm, other.position, *place))
        });
        let tried: Vec<(f64, Vector3<f64>, &str)> = tried.collect();
        let turned_share = tried.first().map_or(1.0, |(share, ..)| *share);
        let (share, ball, place) = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(SecondBall { place, ball, share, turned_share, places: PLACES.len() })
    }

    fn moved(&self, [out, up, turn_deg]: [f64; 3]) -> Vector3<f64> {
        let radius = self.ball.xy().norm();
        let place = Vector3::new(
            self.ball.x * (radius + out) / radius.max(1.0),
            self.ball.y * (radius + out) / radius.max(1.0),
            self.ball.z + up,
        );
        Rotation3::from_axis_angle(&Vector3::z_axis(), turn_deg.to_radians()) * place
    }

    /// Candidate poses about a ball. Obstacles at a new place are not known.
    fn reached(&self, position: Vector3<f64>, allows: impl Fn(&[f64; AXES]) -> bool) -> BallPlace {
        let Self { robot, radius_mm, .. } = *self;
        let id = BallId::FIRST;
        let sphere =
            Sphere { arm: &robot.geometry, controller: robot, id, ball: position, radius_mm, near: None };
        BallPlace { position, poses: sphere.candidates(CANDIDATES, self.seed, allows) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball at a radius of 1500 mm, 500 mm further out, 100 mm lower and a quarter turn about axis 1.
    #[test]
    fn place_is_moved_outwards_upwards_and_about_axis_1() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ball = Vector3::new(900.0, 1200.0, 600.0);
        let (workspace, sigma_mm) = (&[][..], 0.01);
        let plan =
            OneBall { robot: &robot, ball, radius_mm: 300.0, lengths: 60, sigma_mm, workspace, seed: 1 };
        let moved = plan.moved([500.0, -100.0, 90.0]);
        assert!((moved - Vector3::new(-1600.0, 1200.0, 500.0)).norm() < 1e-9, "{moved}");
        // A ball on axis 1 stays there.
        let above = OneBall { ball: Vector3::new(0.0, 0.0, 2000.0), ..plan };
        assert_eq!(above.moved([500.0, 0.0, 60.0]), above.ball);
    }
}
