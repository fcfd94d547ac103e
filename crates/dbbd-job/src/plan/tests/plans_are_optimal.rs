//! Chosen poses give more information than circles: the figures of the reference, on the KR 60 HA and one ball.

use dbbd_job::plan::PoseKind;
use dbbd_job::plan::workspace::in_box;
use dbbd_job::program::krl;
use dbbd_model::design::{Candidate, Criterion, Exchange, Sphere, design_rows, workspace_rows};
use dbbd_model::estimation::{Posterior, Priors, Workspace, factor, with_usual_joint_errors};
use dbbd_model::measurement::{BaseBall, LengthModel, PreparedMeasurement};
use dbbd_model::robot::inverse::clearance;
use dbbd_model::robot::{BallId, BarId, ParamId, Robot, parameter};
use nalgebra::Vector3;

use crate::test_support::cell::{self, CENTRE, RADIUS};
use crate::test_support::production::chosen as chosen_about;

/// Length noise of the 3-D figures, mm.
const SIGMA_MM: f64 = 0.02;

/// With a calibrated bar, as in the reference: one that is known to 50 um only leaves 64 um in the cube, because its
/// offset is confounded with the robot's scale.
fn datasheet(robot: &Robot) -> Posterior {
    let ball = BaseBall { id: BallId::FIRST, position: Vector3::from(CENTRE) };
    let model = LengthModel::new(robot.geometry.clone(), &[ball]);
    Posterior::prior(robot, model, &Priors::datasheet(robot, Some(0.001)))
}

fn reachable(robot: &Robot, count: usize) -> Vec<Candidate> {
    let sphere = Sphere {
        arm: &robot.geometry,
        controller: robot,
        id: BallId::FIRST,
        ball: Vector3::from(CENTRE),
        radius_mm: RADIUS,
        near: None,
    };
    sphere.candidates(count, 1, |axes| {
        clearance(&robot.geometry, axes)
            .is_some_and(|c| c.wrist > 0.09 && c.elbow > 0.09 && c.overhead > 100.0)
    })
}

/// 1 m about the ball.
fn cube(robot: &Robot, poses: usize) -> Vec<[f64; 6]> {
    let found = in_box(robot, CENTRE.map(|x| x - 500.0), CENTRE.map(|x| x + 500.0), poses);
    assert_eq!(found.len(), poses);
    found
}

fn reading(axes: &[f64; 6]) -> PreparedMeasurement {
    PreparedMeasurement::new(*axes, BallId::FIRST, RADIUS)
}

/// Mean standard deviation for 1 um of noise with only the paper's 13 unknown: of the angles, urad, and the lengths, um.
fn thirteen(robot: &Robot, readings: &[PreparedMeasurement]) -> [f64; 2] {
    let ids = parameter::parse_list("alpha1-5,a1-5,d4-6", &[], 1).unwrap();
    let mut rows = factor(&datasheet(robot).model, readings, &ids);
    let norms: Vec<f64> = rows.column_iter().map(|column| column.norm()).collect();
    rows.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
    let inverse = rows.qr().r().try_inverse().unwrap();
    let mean = |unit: &str, scale: f64| {
        let of: Vec<f64> = (0..ids.len())
            .filter(|&k| ids[k].unit().name() == unit)
            .map(|k| inverse.row(k).norm() / norms[k] * 1e-3 * scale)
            .collect();
        of.iter().sum::<f64>() / of.len() as f64
    };
    [mean("rad", 1e6), mean("mm", 1e3)]
}

/// Poses that are chosen for errors of joints too leave less of the position error that these make, over the whole workspace.
#[test]
fn poses_for_errors_of_joints_leave_less_of_them() {
    let robot = cell::kr60();
    let pool = reachable(&robot, 1000);
    let workspace = Workspace::uniform(&robot, 200, 1);
    let geometry = datasheet(&robot);
    let all = with_usual_joint_errors(&geometry, &robot);
    let chosen_for = |known: &Posterior| {
        let rows = design_rows(known, &pool, SIGMA_MM);
        Exchange::new(&rows, &workspace_rows(known, &workspace)).choose(100, Criterion::I).to_vec()
    };
    let left_mm = |chosen: &[usize]| {
        let readings: Vec<PreparedMeasurement> = chosen.iter().map(|&at| reading(&pool[at].axes)).collect();
        let after = all.after(&readings, SIGMA_MM).unwrap();
        ((all.workspace(&workspace).jacobian() * after.root()).norm_squared() / 200.0).sqrt()
    };
    let [by_geometry, by_all] = [&geometry, &all].map(|known| left_mm(&chosen_for(known)));
    assert!(by_all < 0.97 * by_geometry, "{by_all} mm, {by_geometry} mm by the geometry");
}

/// Root mean square of the 3-D error of the geometry in the cube, before and after, mm.
fn in_cube(robot: &Robot, readings: &[PreparedMeasurement], poses: &[[f64; 6]]) -> [f64; 2] {
    let before = datasheet(robot);
    let after = before.after(readings, SIGMA_MM).unwrap();
    let workspace = before.workspace(poses);
    [before, after]
        .map(|known| ((workspace.jacobian() * known.root()).norm_squared() / poses.len() as f64).sqrt())
}

struct Figures {
    thirteen: [f64; 2],
    cube: [f64; 2],
}

impl Figures {
    /// Mean of all thirteen, each in its tolerance (0.05 degrees, 0.5 mm): five angles, eight lengths.
    fn scaled(&self) -> f64 {
        (5.0 * self.thirteen[0] * 1e-6 / 0.05_f64.to_radians() + 8.0 * self.thirteen[1] * 1e-3 / 0.5) / 13.0
    }
}

/// D-optimal for the thirteen alone, as `[optimise] parameters` chooses.
fn chosen_for_thirteen(robot: &Robot, pool: &[Candidate], poses: &[[f64; 6]]) -> Figures {
    let all = datasheet(robot);
    let ids = parameter::parse_list("alpha1-5,a1-5,d4-6", &[], 1).unwrap();
    let sd: Vec<f64> = ids.iter().map(|id| all.sd(*id).unwrap()).collect();
    let belief = Posterior::new(all.model, &ids, &sd);
    let candidates = design_rows(&belief, pool, SIGMA_MM);
    let mut exchange = Exchange::new(&candidates, &workspace_rows(&belief, poses));
    let chosen = exchange.choose(80, Criterion::D);
    let readings: Vec<PreparedMeasurement> = chosen.iter().map(|&at| reading(&pool[at].axes)).collect();
    figures(robot, &readings, poses)
}

fn circles(robot: &Robot, flat: bool, poses: &[[f64; 6]]) -> Figures {
    let axes: Vec<[f64; 6]> = if flat {
        cell::poses(&robot.geometry, &cell::horizontal(1, CENTRE), 80, 45.0)
    } else {
        let each = cell::three_planes(1, CENTRE);
        each.iter().flat_map(|circle| cell::poses(&robot.geometry, circle, 27, 45.0)).take(80).collect()
    };
    figures(robot, &axes.iter().map(|deg| reading(&deg.map(f64::to_radians))).collect::<Vec<_>>(), poses)
}

fn figures(robot: &Robot, readings: &[PreparedMeasurement], poses: &[[f64; 6]]) -> Figures {
    Figures { thirteen: thirteen(robot, readings), cube: in_cube(robot, readings, poses) }
}

fn chosen(robot: &Robot, pool: &[Candidate], poses: &[[f64; 6]], criterion: Criterion) -> Figures {
    let belief = datasheet(robot);
    let candidates = design_rows(&belief, pool, SIGMA_MM);
    let moved = workspace_rows(&belief, &poses[..poses.len().min(400)]);
    let mut exchange = Exchange::new(&candidates, &moved);
    let mut places = exchange.choose(80, criterion).to_vec();
    let readings: Vec<PreparedMeasurement> = places.iter().map(|&at| reading(&pool[at].axes)).collect();
    places.sort_unstable();
    places.dedup();
    assert_eq!(places.len(), 80, "no pose is chosen twice");
    figures(robot, &readings, poses)
}

fn show(name: &str, figures: &Figures) {
    eprintln!(
        "{name}: 13: {:.2} urad, {:.3} um, {:.5} tolerances; cube {:.1} -> {:.1} um",
        figures.thirteen[0],
        figures.thirteen[1],
        figures.scaled(),
        figures.cube[0] * 1e3,
        figures.cube[1] * 1e3
    );
}

fn campaign(count: usize, cube_poses: usize) {
    let robot = cell::kr60();
    let poses = cube(&robot, cube_poses);
    let flat = circles(&robot, true, &poses);
    let three = circles(&robot, false, &poses);
    let pool = reachable(&robot, count);
    assert_eq!(pool.len(), count);
    let best_d = chosen(&robot, &pool, &poses, Criterion::D);
    let best_i = chosen(&robot, &pool, &poses, Criterion::I);
    let for_thirteen = chosen_for_thirteen(&robot, &pool, &poses);
    for (name, figures) in [
        ("horizontal", &flat),
        ("three circles", &three),
        ("D-optimal", &best_d),
        ("I-optimal", &best_i),
        ("D-optimal for the 13", &for_thirteen),
    ] {
        show(name, figures);
    }
    assert!(flat.scaled() / for_thirteen.scaled() > 25.0 && three.scaled() / for_thirteen.scaled() > 1.3);
    for unit in 0..2 {
        assert!(flat.thirteen[unit] / for_thirteen.thirteen[unit] > if unit == 0 { 25.0 } else { 14.0 });
        assert!(three.thirteen[unit] / for_thirteen.thirteen[unit] > 1.3);
    }
    assert!(flat.cube[1] / best_i.cube[1] > 8.0);
    assert!(three.cube[1] / best_i.cube[1] > 1.6);
}

/// 25 and 1.3 times for the mean of the 13, 8 and 1.6 times for the cube: `attainable.md` A.
#[test]
fn eighty_chosen_poses_beat_circles() {
    campaign(3000, 300);
}

#[test]
#[ignore = "the full figures of docs/evidence/README.md: a minute"]
fn eighty_of_twenty_thousand() {
    campaign(20_000, 2000);
}

/// The error that the exchange updates is that of its final poses.
#[test]
fn the_exchange_updates_agree_with_recomputation() {
    let robot = cell::kr60();
    let belief = datasheet(&robot);
    let pool = reachable(&robot, 300);
    let poses = cube(&robot, 50);
    let candidates = design_rows(&belief, &pool, SIGMA_MM);
    let moved = workspace_rows(&belief, &poses);
    let mut exchange = Exchange::new(&candidates, &moved);
    let chosen = exchange.choose(40, Criterion::I);
    let readings: Vec<PreparedMeasurement> = chosen.iter().map(|&at| reading(&pool[at].axes)).collect();
    let after = belief.after(&readings, SIGMA_MM).unwrap();
    let left = Workspace::new(&belief.model.geometry, &poses, belief.ids()).jacobian() * after.root();
    let rms = (left.norm_squared() / 50.0).sqrt();
    assert!((exchange.rms_error_mm() / rms - 1.0).abs() < 1e-6, "{} {rms}", exchange.rms_error_mm());
}

/// A prior updated by lengths of a robot drawn from it: truth and most probable model agree within the covariance.
#[test]
fn the_update_is_within_its_covariance() {
    let robot = cell::kr60();
    let truth = dbbd_job::sim::truth::draw_true_robot(&robot, 5, 1.0);
    let belief = datasheet(&robot);
    let pool = reachable(&robot, 400);
    let centre = Vector3::from(CENTRE) + Vector3::new(0.4, -0.3, 0.2);
    let readings: Vec<PreparedMeasurement> = pool
        .iter()
        .take(60)
        .map(|c| PreparedMeasurement {
            length_mm: truth.geometry.length(&c.axes, &centre, 0.0),
            ..reading(&c.axes)
        })
        .collect();
    let learned = belief.learn(&readings, 0.002).unwrap();
    for candidate in &pool[60..] {
        let sd = learned.design_row(&candidate.axes, BallId::FIRST).norm();
        let there = truth.geometry.length(&candidate.axes, &centre, 0.0);
        let off = learned.model.prepare().length(&reading(&candidate.axes)) - there;
        assert!(off.abs() < 5.0 * sd + 0.002, "{off} {sd}");
        assert!(sd < belief.design_row(&candidate.axes, BallId::FIRST).norm());
    }
    assert!(learned.ids().contains(&ParamId::BarOffset(BarId::FIRST)));
}

/// A module numbers at most 255 dwells; more poses are chosen about one ball, and measured in several modules.
#[test]
fn more_poses_than_a_module_numbers() {
    let plan = chosen_about(1, 300, true);
    let measured = plan.rows.iter().filter(|row| row.kind == PoseKind::Measure).count();
    assert_eq!(measured, 300);
    let last = plan.rows.iter().map(|row| row.circle).max().unwrap();
    assert!(last > 1);
    for module in 1..=last {
        let dwells =
            plan.rows.iter().filter(|row| row.circle == module && row.kind != PoseKind::Transit).count();
        assert!((1..=255).contains(&dwells), "module {module}: {dwells}");
    }
    let options = krl::Options { sync: krl::Sync::Output, controller: krl::Controller::Krc4 };
    assert_eq!(krl::emit(&plan, options).unwrap().len(), 2 * (last as usize + 1));
}
