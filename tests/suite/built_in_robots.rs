//! The built-in robots agree with their published descriptions (tests/independent/robots.py, which uses no DH parameter).

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd_job::plan::{Job, Plan};
use dbbd_model::robot::{AXES, Pose, Robot};
use tempfile::tempdir;

use crate::cell::{dbbd, stderr};

#[test]
fn built_in_robots_agree_with_their_descriptions() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/golden/robots.csv");
    let text = fs::read_to_string(path).unwrap();
    let mut checked = BTreeSet::new();
    for line in text.lines().skip(1) {
        let (name, numbers) = line.split_once(',').unwrap();
        let numbers: Vec<f64> = numbers.split(',').map(|cell| cell.parse().unwrap()).collect();
        let robot = Robot::by_name(name).unwrap().unwrap();
        let axes: [f64; AXES] = std::array::from_fn(|i| numbers[i].to_radians());
        let flange = robot.geometry.flange(&axes);
        for (axis, expected) in numbers[6..9].iter().enumerate() {
            assert!((flange.position[axis] - expected).abs() < 1e-8, "{line}");
        }
        for (at, expected) in numbers[9..18].iter().enumerate() {
            assert!((flange.rotation[(at / 3, at % 3)] - expected).abs() < 1e-11, "{line}");
        }
        checked.insert(name.to_owned());
    }
    let built_in: BTreeSet<String> = Robot::built_in().iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(checked, built_in, "each robot needs its poses in fixtures/golden/robots.csv");
}

/// A short arc about a ball in front of the robot, level with its shoulder.
fn small_job(robot: &Robot) -> Job {
    let reach = robot.reach_mm();
    let text = format!(
        "robot = \"any\"\n[bar]\nlength_mm = {:.1}\nstroke_mm = [-5.0, 5.0]\n[[centre]]\nid = 1\nxyz_mm = [{:.1}, {:.1}, {:.1}]\n\
         [[circle]]\nplane = \"XY\"\npoints = 3\narc_deg = 60.0\norientation = \"fixed\"\ntilt_deg = 20.0\n\
         [limits]\nmin_overhead_mm = 20.0\nmax_stroke_risk = 0.1\n",
        0.15 * reach,
        0.55 * reach,
        0.1 * reach,
        robot.geometry.rows[0].d,
    );
    Job::from_toml("job.toml", &text).unwrap()
}

#[test]
fn every_robot_has_a_plan() {
    for (name, _) in Robot::built_in() {
        let robot = Robot::by_name(name).unwrap().unwrap();
        let job = small_job(&robot);
        let plan = Plan::build(&job, &robot).unwrap_or_else(|refusal| panic!("{name}: {refusal:?}"));
        assert!(plan.rows.len() >= 3, "{name}");
        for row in &plan.rows {
            let there = robot.geometry.ball(&row.axes_deg.map(f64::to_radians));
            let commanded = Pose::from_kuka(row.xyz_mm, row.abc_deg);
            // The axis angles in the plan are those of the printed pose.
            assert!((there.position - commanded.position).norm() < 1e-6, "{name}");
            assert!(there.angle_to(&commanded) < 1e-9, "{name}");
            let within =
                |i: usize| (robot.limits_deg[i][0]..=robot.limits_deg[i][1]).contains(&row.axes_deg[i]);
            assert!((0..AXES).all(within), "{name}: {:?}", row.axes_deg);
        }
    }
}

#[test]
fn robots_are_listed_and_shown_with_their_source() {
    let dir = tempdir().unwrap();
    let stdout = |output: &Output| String::from_utf8(output.stdout.clone()).unwrap();
    let list = stdout(&dbbd(dir.path(), &["robots"]));
    for (name, _) in Robot::built_in() {
        assert!(list.contains(name), "{list}");
        let shown = dbbd(dir.path(), &["robots", "show", name]);
        assert!(shown.status.success(), "{}", stderr(&shown));
        assert!(stdout(&shown).contains("Geometry"), "{name} has no source");
    }
}
