//! Base balls at places: poses about them, and the position error that they leave.
//!
//! Poses are added one after the other: first those that show where the balls are ([`Criterion::D`]), then always the one that takes
//! most from the mean square of the position error ([`Criterion::I`]). So one pass gives the error after any number of poses: as many
//! as an exchange chooses leave a little less.

use nalgebra::{DMatrix, Vector3};

use super::{Candidate, Criterion, Exchange, design_rows};
use crate::estimation::Posterior;
use crate::math::map_items;
use crate::robot::BallId;

/// Poses about each ball that come first: a ball has three coordinates.
const POSES_OF_BALL: usize = 4;

/// Poses by which branches are compared: as many as a short run has about a ball.
const POSES_OF_BRANCH: usize = 40;

/// A place of a base ball, with poses about it.
#[derive(Clone, Debug)]
pub struct BallPlace {
    pub position: Vector3<f64>,
    pub poses: Vec<Candidate>,
}

/// By what poses about balls are chosen.
pub struct Placement<'a> {
    /// What is known with base balls at these places, in this order.
    pub prior: &'a (dyn Fn(&[Vector3<f64>]) -> Posterior + Sync),
    /// The position errors that matter, as [`super::workspace_rows`] has them.
    pub errors: &'a (dyn Fn(&Posterior) -> DMatrix<f64> + Sync),
    /// Standard deviation of a length, mm.
    pub sigma_mm: f64,
}

impl Placement<'_> {
    /// Root mean square of the position error with the best `count` poses about all these places, mm. `None` if they are fewer.
    pub fn error_mm(&self, places: &[&BallPlace], count: usize) -> Option<f64> {
        let (rows, errors) = self.rows(places);
        if rows.ncols() < count {
            return None;
        }
        let mut exchange = Exchange::new(&rows, &errors);
        exchange.choose(count, Criterion::I);
        Some(exchange.rms_error_mm()).filter(|error| error.is_finite())
    }

    /// The poses about these places as they are chosen one after the other, at most `max` and until they leave `enough_mm`, by their
    /// number among the poses of all places, with the root mean square of the position error after each, mm.
    pub fn chosen(&self, places: &[&BallPlace], max: usize, enough_mm: f64) -> (Vec<usize>, Vec<f64>) {
        let (rows, errors) = self.rows(places);
        one_after_the_other(&rows, &errors, places.len(), max, enough_mm)
    }

    fn rows(&self, places: &[&BallPlace]) -> (DMatrix<f64>, DMatrix<f64>) {
        let positions: Vec<Vector3<f64>> = places.iter().map(|place| place.position).collect();
        let known = (self.prior)(&positions);
        (design_rows(&known, &all_poses(places), self.sigma_mm), (self.errors)(&known))
    }
}

/// Poses of `rows` about a number of balls as [`Placement::chosen`] has them.
fn one_after_the_other(
    rows: &DMatrix<f64>,
    errors: &DMatrix<f64>,
    balls: usize,
    max: usize,
    enough_mm: f64,
) -> (Vec<usize>, Vec<f64>) {
    let mut exchange = Exchange::new(rows, errors);
    // The first poses about a ball only show where the ball is.
    let of_balls = POSES_OF_BALL * balls;
    let error_with = |count| {
        let criterion = if count <= of_balls { Criterion::D } else { Criterion::I };
        if count == of_balls + 1 {
            exchange.renew(criterion);
        }
        exchange.extend(count, criterion);
        (exchange.chosen().len() == count).then(|| exchange.rms_error_mm())
    };
    let mut errors_mm = Vec::new();
    for error in (1..=max).map_while(error_with).take_while(|error| error.is_finite()) {
        errors_mm.push(error);
        if error <= enough_mm {
            break;
        }
    }
    let mut chosen = exchange.chosen().to_vec();
    chosen.truncate(errors_mm.len());
    (chosen, errors_mm)
}

/// Poses about one more base ball in several branches of the arm, those first that leave the smallest position error: `known` is what is
/// known with the ball as its last one, `errors` are the position errors that matter, as [`super::workspace_rows`] has them. A branch
/// with less than half as many poses as another one is narrow, and is left out.
pub fn ordered_branches(
    branches: impl IntoIterator<Item = Vec<Candidate>>,
    known: &Posterior,
    errors: &DMatrix<f64>,
    sigma_mm: f64,
) -> Vec<Vec<Candidate>> {
    let mut branches: Vec<Vec<Candidate>> = branches.into_iter().filter(|poses| !poses.is_empty()).collect();
    let most = branches.iter().map(Vec::len).max().unwrap_or(0);
    branches.retain(|poses| 2 * poses.len() >= most);
    let ball = BallId::at(known.model.balls.len().saturating_sub(1));
    let left_mm = |poses: &Vec<Candidate>| {
        let about: Vec<Candidate> = poses.iter().map(|pose| Candidate { ball, ..pose.clone() }).collect();
        let (_, errors_mm) =
            one_after_the_other(&design_rows(known, &about, sigma_mm), errors, 1, POSES_OF_BRANCH, 0.0);
        errors_mm.last().copied().unwrap_or(f64::INFINITY)
    };
    let mut by_error: Vec<_> = map_items(&branches, left_mm).into_iter().zip(branches).collect();
    by_error.sort_by(|a, b| a.0.total_cmp(&b.0));
    by_error.into_iter().map(|(_, poses)| poses).collect()
}

/// The poses of all places, each about the ball that has its place's number.
pub fn all_poses(places: &[&BallPlace]) -> Vec<Candidate> {
    let numbered = |(at, place): (usize, &&BallPlace)| -> Vec<Candidate> {
        place.poses.iter().map(|pose| Candidate { ball: BallId::at(at), ..pose.clone() }).collect()
    };
    places.iter().enumerate().flat_map(numbered).collect()
}

/// Prices of a run in time, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunPrices {
    /// To mount the bar.
    pub bar_s: f64,
    /// To mount a base ball and to teach it.
    pub ball_s: f64,
    /// A pose with its way.
    pub pose_s: f64,
}

impl RunPrices {
    pub fn time_s(&self, balls: usize, poses: usize) -> f64 {
        self.bar_s + self.ball_s * balls as f64 + self.pose_s * poses as f64
    }
}

/// Balls with the error that 1, 2, .. poses about them leave.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedBalls {
    /// The places, by their position in the list of places.
    pub places: Vec<usize>,
    /// The poses in the order in which they are chosen, by their number among the poses of all these places.
    pub chosen: Vec<usize>,
    /// Root mean square of the position error with 1, 2, .. poses, mm.
    pub errors_mm: Vec<f64>,
}

impl PlacedBalls {
    /// The smallest number of poses that leave at most this error.
    pub fn poses_for(&self, error_mm: f64) -> Option<usize> {
        self.errors_mm.iter().position(|error| *error <= error_mm).map(|at| at + 1)
    }

    /// The smallest error that is left, mm.
    pub fn min_error_mm(&self) -> f64 {
        self.errors_mm.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// The search for the balls about which the shortest run reaches a goal.
pub struct PlacementSearch<'a> {
    pub placement: Placement<'a>,
    pub places: &'a [BallPlace],
    /// This many of the first places have a ball already.
    pub given: usize,
    /// Largest number of balls of a run.
    pub max_balls: usize,
    /// Largest number of poses of a run.
    pub max_poses: usize,
    /// Root mean square of the position error that is better than any goal, mm.
    pub enough_mm: f64,
    pub prices: RunPrices,
}

/// Sets of balls that are compared all; of more, sets grow from the best smaller ones.
const ALL_SETS: usize = 150;
/// Sets from which larger ones grow.
const BEST: usize = 6;

impl PlacementSearch<'_> {
    /// Sets of balls, with the error that poses about them leave. For the first sets of each size the goal decides which are the
    /// best: the root mean square `error_mm` of the position error, mm.
    pub fn sets(&self, error_mm: f64) -> Vec<PlacedBalls> {
        let given: Vec<usize> = (0..self.given).collect();
        let mut found: Vec<PlacedBalls> = Vec::new();
        let mut smaller = vec![given];
        if self.given > 0 {
            found.extend(self.tried(&smaller));
        }
        while smaller.first().is_some_and(|set| set.len() < self.max_balls) {
            let mut larger: Vec<Vec<usize>> =
                smaller.iter().flat_map(|set| self.with_one_more(set)).collect();
            larger.sort();
            larger.dedup();
            let mut tried = self.tried(&larger);
            tried.sort_by(|a, b| self.order(a, error_mm).total_cmp(&self.order(b, error_mm)));
            let kept = if found.len() + tried.len() <= ALL_SETS { tried.len() } else { BEST };
            smaller = tried.iter().take(kept).map(|set| set.places.clone()).collect();
            found.extend(tried);
        }
        found
    }

    /// The sets with one more ball at a place that has none.
    fn with_one_more(&self, set: &[usize]) -> Vec<Vec<usize>> {
        let free = (self.given..self.places.len()).filter(|place| !set.contains(place));
        let larger = |place| {
            let mut larger = [set, &[place]].concat();
            larger.sort_unstable();
            larger
        };
        free.map(larger).collect()
    }

    fn tried(&self, sets: &[Vec<usize>]) -> Vec<PlacedBalls> {
        let tried = |set: &Vec<usize>| {
            let places: Vec<&BallPlace> = set.iter().filter_map(|at| self.places.get(*at)).collect();
            let (chosen, errors_mm) = self.placement.chosen(&places, self.max_poses, self.enough_mm);
            PlacedBalls { places: set.clone(), chosen, errors_mm }
        };
        map_items(sets, tried)
    }

    /// The time until the error is reached, s; beyond all times and by the least error where it is not.
    fn order(&self, set: &PlacedBalls, error_mm: f64) -> f64 {
        match set.poses_for(error_mm) {
            Some(poses) => self.prices.time_s(set.places.len() - self.given, poses),
            None => {
                self.prices.time_s(self.places.len(), self.max_poses) * (1.0 + set.min_error_mm() / error_mm)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{Sphere, workspace_rows};
    use crate::estimation::{Priors, with_mean_joint_errors};
    use crate::measurement::{BaseBall, LengthModel};
    use crate::robot::inverse::status;
    use crate::robot::{AXES, Robot};
    use crate::test_support::cell::kr60;

    const BAR_MM: f64 = 600.0;
    const SIGMA_MM: f64 = 0.02;
    const PRICES: RunPrices = RunPrices { bar_s: 300.0, ball_s: 240.0, pose_s: 15.0 };

    fn place(robot: &Robot, position: [f64; 3], count: usize) -> BallPlace {
        let ball = Vector3::from(position);
        let sphere = Sphere {
            arm: &robot.geometry,
            controller: robot,
            id: BallId::FIRST,
            ball,
            radius_mm: BAR_MM,
            near: None,
        };
        BallPlace { position: ball, poses: sphere.candidates(count, 3, |_| true) }
    }

    fn prior(robot: &Robot, balls: &[Vector3<f64>]) -> Posterior {
        let base =
            |(at, position): (usize, &Vector3<f64>)| BaseBall { id: BallId::at(at), position: *position };
        let balls: Vec<BaseBall> = balls.iter().enumerate().map(base).collect();
        let model = LengthModel::new(robot.geometry.clone(), &balls);
        Posterior::prior(robot, model, &Priors::datasheet(robot, Some(0.002)))
    }

    fn workspace() -> Vec<[f64; AXES]> {
        crate::estimation::Workspace::uniform(&kr60(), 30, 4)
    }

    /// The root of the mean square of the position error after lengths, from the inverse of the information.
    fn error_mm(known: &Posterior, poses: &[Candidate]) -> f64 {
        let rows = design_rows(known, poses, SIGMA_MM);
        let unknowns = rows.nrows();
        let covariance =
            (DMatrix::identity(unknowns, unknowns) + &rows * rows.transpose()).try_inverse().unwrap();
        let errors = workspace_rows(known, &workspace());
        ((&errors * covariance).dot(&errors) / 30.0).sqrt()
    }

    #[test]
    fn errors_are_those_of_the_inverse_of_the_information() {
        let robot = kr60();
        let places = [place(&robot, [1500.0, 0.0, 800.0], 12), place(&robot, [300.0, 1300.0, 500.0], 12)];
        let (prior, poses) = (|balls: &[Vector3<f64>]| prior(&robot, balls), workspace());
        let errors = |known: &Posterior| workspace_rows(known, &poses);
        let placement = Placement { prior: &prior, errors: &errors, sigma_mm: SIGMA_MM };
        let places: Vec<&BallPlace> = places.iter().collect();
        let (chosen, errors_mm) = placement.chosen(&places, 20, 0.0);
        assert_eq!((chosen.len(), errors_mm.len()), (20, 20));
        let (all, known) = (all_poses(&places), prior(&[places[0].position, places[1].position]));
        for count in [1, 8, 9, 20] {
            let poses: Vec<Candidate> = chosen[..count].iter().map(|at| all[*at].clone()).collect();
            let expected = error_mm(&known, &poses);
            assert!((errors_mm[count - 1] / expected - 1.0).abs() < 1e-5, "{count}: {expected}");
        }
        // As many poses as there are, and no more.
        assert_eq!(placement.chosen(&places, 100, 0.0).0.len(), 24);
        // Better than enough is nothing.
        assert_eq!(placement.chosen(&places, 20, errors_mm[11]).0.len(), 12);
        // An exchange leaves no more.
        assert!(placement.error_mm(&places, 14).unwrap() <= errors_mm[13] * (1.0 + 1e-9));
        assert_eq!(placement.error_mm(&places, 25), None);
    }

    /// A UR10 has as many poses in each of its eight branches. Errors at poses of one branch are determined best by lengths in that
    /// branch or in one that is near to it: others leave more than a tenth more, by exchanges.
    #[test]
    fn first_branch_is_the_one_that_leaves_least() {
        let robot = Robot::by_name_with_tool("ur10", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ball = Vector3::new(600.0, 100.0, 300.0);
        let sphere = Sphere {
            arm: &robot.geometry,
            controller: &robot,
            id: BallId::FIRST,
            ball,
            radius_mm: 420.0,
            near: None,
        };
        let branches = sphere.by_branch(80, 3, |_| true);
        let mut poses = crate::estimation::Workspace::uniform(&robot, 400, 4);
        poses.retain(|axes| status(&robot.geometry, axes) & 7 == 2);
        let (prior, known) = (|balls: &[Vector3<f64>]| prior(&robot, balls), prior(&robot, &[ball]));
        let known = with_mean_joint_errors(&known, &robot);
        let prior = |balls: &[Vector3<f64>]| with_mean_joint_errors(&prior(balls), &robot);
        let errors = |known: &Posterior| workspace_rows(known, &poses);
        let placement = Placement { prior: &prior, errors: &errors, sigma_mm: SIGMA_MM };
        let left_mm = |poses: &Vec<Candidate>| {
            placement.error_mm(&[&BallPlace { position: ball, poses: poses.clone() }], 40).unwrap()
        };
        let all_mm: Vec<f64> = branches.iter().filter(|poses| poses.len() >= 40).map(left_mm).collect();
        let smallest = all_mm.iter().copied().fold(f64::INFINITY, f64::min);
        let ordered = ordered_branches(branches.clone(), &known, &errors(&known), SIGMA_MM);
        let best = ordered[0].clone();
        assert!(left_mm(&best) < 1.03 * smallest, "{} {all_mm:?}", left_mm(&best));
        assert!(all_mm.iter().any(|error| *error > 1.1 * smallest), "{all_mm:?}");
        // A branch with less than half as many poses as another one is not compared.
        let other = branches.iter().find(|poses| poses.len() >= 40 && **poses != best).unwrap();
        let narrow = best[..other.len() / 2 - 1].to_vec();
        let found = ordered_branches([narrow, other.clone()], &known, &errors(&known), SIGMA_MM);
        assert_eq!(found, std::slice::from_ref(other));
        assert!(ordered_branches([Vec::new()], &known, &errors(&known), SIGMA_MM).is_empty());
    }

    /// All sets of three places, each with the least number of poses of which an exchange leaves at most the goal: the search takes at
    /// most a quarter longer than the shortest of these runs.
    #[test]
    fn shortest_run_is_nearly_that_of_all_runs() {
        let robot = kr60();
        let at = [[1500.0, 0.0, 800.0], [300.0, 1300.0, 500.0], [200.0, -1200.0, 1500.0]];
        let places = at.map(|position| place(&robot, position, 40));
        let (prior, poses) = (|balls: &[Vector3<f64>]| prior(&robot, balls), workspace());
        let errors = |known: &Posterior| workspace_rows(known, &poses);
        let search = PlacementSearch {
            placement: Placement { prior: &prior, errors: &errors, sigma_mm: SIGMA_MM },
            places: &places,
            given: 0,
            max_balls: 3,
            max_poses: 80,
            enough_mm: 0.0,
            prices: PRICES,
        };
        let found = search.sets(0.2);
        // Three places alone, in pairs, and all together.
        assert_eq!(found.len(), 7);
        for goal_mm in [0.6, 0.25, 0.1] {
            let times =
                found.iter().filter_map(|set| Some(PRICES.time_s(set.places.len(), set.poses_for(goal_mm)?)));
            let shortest_s = times.fold(f64::INFINITY, f64::min);
            let exchanged = |set: usize| {
                let some: Vec<&BallPlace> =
                    (0..3).filter(|at| set & (1 << at) != 0).map(|at| &places[at]).collect();
                let reaches = |count: &usize| {
                    search.placement.error_mm(&some, *count).is_some_and(|error| error <= goal_mm)
                };
                Some(PRICES.time_s(some.len(), (4..=80).find(reaches)?))
            };
            let best_s = (1..8).filter_map(exchanged).fold(f64::INFINITY, f64::min);
            assert!(
                shortest_s.is_finite() && shortest_s <= 1.25 * best_s,
                "{goal_mm}: {shortest_s} {best_s}"
            );
        }
    }

    #[test]
    fn mounted_balls_belong_to_every_set_and_cost_nothing() {
        let robot = kr60();
        let at = [[1500.0, 0.0, 800.0], [300.0, 1300.0, 500.0], [200.0, -1200.0, 1500.0]];
        let places = at.map(|position| place(&robot, position, 6));
        let (prior, poses) = (|balls: &[Vector3<f64>]| prior(&robot, balls), workspace());
        let errors = |known: &Posterior| workspace_rows(known, &poses);
        let search = PlacementSearch {
            placement: Placement { prior: &prior, errors: &errors, sigma_mm: SIGMA_MM },
            places: &places,
            given: 1,
            max_balls: 2,
            max_poses: 6,
            enough_mm: 0.0,
            prices: PRICES,
        };
        let mut sets: Vec<Vec<usize>> = search.sets(0.2).into_iter().map(|set| set.places).collect();
        sets.sort();
        assert_eq!(sets, [vec![0], vec![0, 1], vec![0, 2]]);
        // A bar, two balls and ten poses: 300 + 2 240 + 10 15 s.
        assert_eq!(PRICES.time_s(2, 10), 930.0);
    }
}
