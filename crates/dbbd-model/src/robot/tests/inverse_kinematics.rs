//! Inverse kinematics: all solution branches, full turns, KUKA's status and turn.

use std::f64::consts::{PI, TAU};

use dbbd_model::diagnostic::Finding;
use dbbd_model::robot::inverse::{
    branches, clearance, from_status_turn, nearest, numeric, status, turn, turns_within,
};
use dbbd_model::robot::{AXES, Geometry, Joint, ParamId, ParamUnit, Pose, Robot};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn kr60ha() -> Robot {
    Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()
}

fn rad(deg: [f64; AXES]) -> [f64; AXES] {
    deg.map(f64::to_radians)
}

fn apart(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn miss(geometry: &Geometry, axes: &[f64; AXES], ball: &Pose) -> (f64, f64) {
    let there = geometry.ball(axes);
    ((there.position - ball.position).norm(), (there.rotation - ball.rotation).norm())
}

/// An identified robot: every parameter, with the betas, has an error within the tolerance.
fn perturbed(seed: [f64; 6]) -> Robot {
    let mut robot = kr60ha();
    for (k, id) in ParamId::denavit_hartenberg().chain([ParamId::Beta(Joint::J3)]).enumerate() {
        let size = if id.unit() == ParamUnit::Mm { 0.5 } else { 0.001 };
        *robot.geometry.value_mut(id).unwrap() += size * (seed[k % 6] * (k as f64 + 1.0)).sin();
    }
    robot
}

/// Axis angles at these shares of the ranges of the axes.
fn at_shares(robot: &Robot, share: [f64; AXES]) -> [f64; AXES] {
    let mut axes_deg = [0.0; AXES];
    for i in 0..AXES {
        let [low, high] = robot.limits_at_deg(&axes_deg)[i];
        axes_deg[i] = low + share[i] * (high - low);
    }
    rad(axes_deg)
}

/// Axis angles, uniformly distributed within the limits of the robot.
fn within_limits() -> impl Strategy<Value = [f64; AXES]> {
    prop::array::uniform6(0.0..1.0f64).prop_map(|share| at_shares(&kr60ha(), share))
}

/// A built-in robot with a closed form, and axis angles within its limits and off its singular positions.
fn any_robot() -> impl Strategy<Value = (Robot, [f64; AXES])> {
    (0..Robot::built_in().len(), prop::array::uniform6(0.0..1.0f64)).prop_filter_map(
        "singular",
        |(at, share)| {
            let robot = Robot::by_name(Robot::built_in()[at].0).unwrap().unwrap();
            let axes = at_shares(&robot, share);
            let clear = clearance(&robot.geometry, &axes)?;
            (clear.wrist > 1e-3 && clear.elbow > 1e-3 && clear.overhead > 1.0).then_some((robot, axes))
        },
    )
}

/// Flange (tool zero), A, S and T of the KR 60 HA from the ROS-Industrial model and KUKA's rules.
#[test]
fn check_poses_have_their_status_and_turn() {
    let mut robot = kr60ha();
    robot.geometry.tool = nalgebra::Vector3::zeros();
    let checks = [
        ([0.0, -90.0, 90.0, 0.0, 0.0, 0.0], [1340.0, 0.0, 1810.0], 2, 2),
        ([0.0, -90.0, 90.0, 0.0, 90.0, 0.0], [1170.0, 0.0, 1640.0], 2, 2),
        ([10.0, -80.0, 100.0, 20.0, 45.0, -30.0], [1363.778, -282.219, 1360.625], 2, 34),
    ];
    for (deg, xyz, s, t) in checks {
        let axes = rad(deg);
        let ball = robot.geometry.ball(&axes);
        assert!((ball.position - nalgebra::Vector3::from(xyz)).norm() < 1e-3, "{:?}", ball.position);
        assert_eq!((status(&robot.geometry, &axes), turn(&axes)), (s, t), "{deg:?}");
        let found = from_status_turn(&robot, &ball, s, t).unwrap();
        assert!(apart(&found, &axes) < 1e-9, "{found:?} for {axes:?}");
        // A robot with the absolute-accuracy option sets bit 4 as well.
        assert_eq!(from_status_turn(&robot, &ball, s | 16, t).unwrap(), found);
    }
    let ball = Pose::from_kuka([1363.778, -282.219, 1360.625], [152.596, 29.472, -174.261]);
    let found = from_status_turn(&robot, &ball, 2, 34).unwrap();
    assert!(apart(&found, &rad(checks[2].0)) < 2e-5, "{found:?}");
}

#[test]
fn pose_out_of_reach_has_no_solution() {
    let geometry = kr60ha().geometry;
    let far = Pose::from_kuka([3000.0, 0.0, 800.0], [0.0, 90.0, 0.0]);
    let nowhere = Pose::from_kuka([f64::NAN, 0.0, 800.0], [0.0, 90.0, 0.0]);
    let unreached = [
        branches(&geometry, &far).err(),
        branches(&geometry, &nowhere).err(),
        nearest(&geometry, &far, &rad([0.0, -60.0, 60.0, 0.0, 60.0, 0.0])).err(),
        nearest(&perturbed([0.3; 6]).geometry, &far, &[0.1; 6]).err(),
        from_status_turn(&kr60ha(), &geometry.ball(&[0.1; 6]), 7, 63).err(),
    ];
    for finding in unreached {
        assert_eq!(finding.map(|finding| finding.code().as_str()), Some("E0506"));
    }
}

/// Axis 3 or axis 4 of an arm with three parallel axes may point against axis 2.
#[test]
fn parallel_axes_may_point_against_each_other() {
    let axes = rad([20.0, -70.0, 80.0, -40.0, 60.0, 15.0]);
    for [third, fourth] in [[PI, 0.0], [0.0, PI], [PI, PI], [PI, -PI]] {
        let mut geometry = Robot::by_name("ur10e").unwrap().unwrap().geometry;
        *geometry.value_mut(ParamId::Alpha(Joint::J3)).unwrap() += third;
        *geometry.value_mut(ParamId::Alpha(Joint::J4)).unwrap() += fourth;
        let ball = geometry.ball(&axes);
        let found = branches(&geometry, &ball).unwrap();
        for branch in &found {
            let (mm, turn) = miss(&geometry, branch, &ball);
            assert!(mm < 1e-6 && turn < 1e-9, "{third} {fourth}: {branch:?} misses by {mm} mm");
        }
        let is_original = |branch: &[f64; AXES]| {
            branch.iter().zip(&axes).all(|(a, b)| ((a - b + PI).rem_euclid(TAU) - PI).abs() < 1e-9)
        };
        assert!(found.iter().any(is_original), "{third} {fourth}: {found:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn every_branch_reaches_the_pose_and_one_is_the_original((robot, axes) in any_robot()) {
        let ball = robot.geometry.ball(&axes);
        let found = branches(&robot.geometry, &ball).unwrap();
        prop_assert!(found.len() <= 8);
        for branch in &found {
            let (mm, turn) = miss(&robot.geometry, branch, &ball);
            prop_assert!(mm < 1e-8 && turn < 1e-10, "{mm} mm, {turn}");
        }
        let original = found.iter().flat_map(|branch| turns_within(branch, &robot))
            .map(|variant| apart(&variant, &axes)).fold(f64::MAX, f64::min);
        prop_assert!(original < 1e-6, "{original}");
        // S and T determine it, except for the full turns of an axis that can make more than one to a side.
        let named = from_status_turn(&robot, &ball, status(&robot.geometry, &axes), turn(&axes)).unwrap();
        let turns: [f64; AXES] = std::array::from_fn(|i| ((named[i] - axes[i]) / TAU).round());
        prop_assert!(robot.limits_deg.iter().zip(turns).all(|(limits, turn)| turn == 0.0 || limits[1] > 360.0));
        let unturned = std::array::from_fn(|i| named[i] - TAU * turns[i]);
        prop_assert!(apart(&unturned, &axes) < 1e-6);
    }

    #[test]
    fn nearest_solution_keeps_branch_and_turn((robot, axes) in any_robot(), off in prop::array::uniform6(-0.02..0.02)) {
        let geometry = robot.geometry;
        let near: [f64; AXES] = std::array::from_fn(|i| axes[i] + off[i]);
        let ball = geometry.ball(&axes);
        let found = nearest(&geometry, &ball, &near).unwrap();
        let (mm, turn) = miss(&geometry, &found, &ball);
        prop_assert!(mm < 1e-8 && turn < 1e-10);
        // Near a singularity another branch may be nearer than that of the pose.
        prop_assert!(apart(&found, &near) <= apart(&axes, &near) + 1e-6);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn iteration_agrees_with_the_closed_form(axes in within_limits(), off in prop::array::uniform6(-0.01..0.01)) {
        let geometry = kr60ha().geometry;
        // Away from the wrist, elbow (10.03 deg) and overhead singularities.
        let overhead = 350.0 + 850.0 * axes[1].cos() + 820.0 * (axes[1] + axes[2]).cos() + 145.0 * (axes[1] + axes[2]).sin();
        prop_assume!(axes[4].sin().abs() > 0.1 && (axes[2] - 0.175).abs() > 0.15 && overhead.abs() > 150.0);
        let ball = geometry.ball(&axes);
        let start: [f64; AXES] = std::array::from_fn(|i| axes[i] + off[i]);
        let found = numeric(&geometry, &ball, &start).unwrap();
        prop_assert!(apart(&found, &axes) < 1e-9, "{}", apart(&found, &axes));
    }

    #[test]
    fn identified_arm_has_all_branches(axes in within_limits(), seed in prop::array::uniform6(0.0..6.0)) {
        let overhead = 350.0 + 850.0 * axes[1].cos() + 820.0 * (axes[1] + axes[2]).cos() + 145.0 * (axes[1] + axes[2]).sin();
        prop_assume!(axes[4].sin().abs() > 0.1 && (axes[2] - 0.175).abs() > 0.15 && overhead.abs() > 150.0);
        let robot = perturbed(seed);
        let ball = robot.geometry.ball(&axes);
        let found = nearest(&robot.geometry, &ball, &axes).unwrap();
        prop_assert!(apart(&found, &axes) < 1e-8);
        let named = from_status_turn(&robot, &ball, status(&robot.geometry, &axes), turn(&axes)).unwrap();
        prop_assert!(apart(&named, &axes) < 1e-8);
        for branch in branches(&robot.geometry, &ball).unwrap() {
            let (mm, turn) = miss(&robot.geometry, &branch, &ball);
            prop_assert!(mm < 1e-8 && turn < 1e-10);
        }
    }
}

/// At A5 = 0 only A4 + A6 is defined: the nearest solution keeps A4.
#[test]
fn straight_wrist_keeps_axis_four() {
    let geometry = kr60ha().geometry;
    let axes = rad([10.0, -80.0, 100.0, 33.0, 0.0, -50.0]);
    let found = nearest(&geometry, &geometry.ball(&axes), &axes).unwrap();
    assert!(apart(&found, &axes) < 1e-8, "{found:?}");
}

/// A KR 60 HA with the wrist of a CRX-10iA/L (axes 4 and 6 have a distance of 150 mm), with an offset between axes 4 and 5, with a
/// 60-degree wrist like that of painting robots, and the first one as an identified robot.
fn without_a_closed_form() -> [Geometry; 4] {
    let nominal = kr60ha().geometry;
    let [mut passing, mut beside, mut painting] = [nominal.clone(), nominal.clone(), nominal];
    passing.rows[4].d = 150.0;
    beside.rows[4].a = 80.0;
    (painting.rows[4].alpha, painting.rows[5].alpha) = (60.0_f64.to_radians(), -60.0_f64.to_radians());
    painting.rows[4].d = 90.0;
    let mut identified = perturbed([0.3; 6]).geometry;
    identified.rows[4].d += 150.0;
    [passing, beside, painting, identified]
}

/// Branches at random poses: the number found, and the number that another method finds in addition.
#[derive(Debug, Default)]
struct Census {
    branches: usize,
    most: usize,
    /// Poses whose own axis angles are not among the branches.
    lost: usize,
    /// Solutions from random starts that are not among the branches.
    missed: usize,
    from_random_starts: usize,
}

fn census(geometry: &Geometry, poses: usize, starts: usize, seed: u64) -> Census {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut draw = || -> [f64; AXES] { std::array::from_fn(|_| random.random_range(-PI..PI)) };
    let mut census = Census::default();
    let off = |a: f64, b: f64| ((a - b) / TAU - ((a - b) / TAU).round()).abs() * TAU;
    let is = |a: &[f64; AXES], b: &[f64; AXES]| (0..AXES).all(|i| off(a[i], b[i]) < 1e-4);
    for _ in 0..poses {
        let axes = draw();
        let ball = geometry.ball(&axes);
        let found = branches(geometry, &ball).unwrap_or_default();
        for branch in &found {
            let (mm, turn) = miss(geometry, branch, &ball);
            assert!(mm < 1e-9 && turn < 1e-9, "{mm} mm, {turn}");
        }
        census.branches += found.len();
        census.most = census.most.max(found.len());
        census.lost += usize::from(!found.iter().any(|branch| is(branch, &axes)));
        let mut others: Vec<[f64; AXES]> = Vec::new();
        for _ in 0..starts {
            let Ok(other) = numeric(geometry, &ball, &draw()) else { continue };
            if !others.iter().any(|known| is(known, &other)) {
                others.push(other);
            }
        }
        census.from_random_starts += others.len();
        census.missed += others.iter().filter(|other| !found.iter().any(|branch| is(branch, other))).count();
    }
    census
}

fn geometries() -> Vec<Geometry> {
    let built_in = ["kr60ha", "tx2-90l", "ur10", "m10id12", "m20id25", "crx10ia"];
    let built_in = built_in.map(|name| Robot::by_name(name).unwrap().unwrap().geometry);
    built_in.into_iter().chain(without_a_closed_form()).collect()
}

#[test]
fn no_branch_is_lost() {
    for geometry in geometries() {
        let census = census(&geometry, 8, 2, 1);
        assert!(census.lost == 0 && census.missed == 0 && census.most > 4, "{census:?}");
    }
}

#[test]
#[ignore = "takes minutes; prints the figures of docs/evidence/README.md"]
fn a_hundred_thousand_poses() {
    for geometry in geometries() {
        println!("{:?}", census(&geometry, 100_000, 0, 2));
        println!("{:?}", census(&geometry, 1_000, 300, 3));
    }
}
