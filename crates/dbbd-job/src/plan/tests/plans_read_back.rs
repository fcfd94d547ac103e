//! The shipped jobs plan cleanly; a plan's files read back to the last bit and only as a pair.

use std::collections::BTreeSet;

use dbbd_job::plan::timing::ramped_s;
use dbbd_job::plan::{Job, MotionKind, Plan, PlanRow, PoseKind};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::inverse::from_status_turn;
use dbbd_model::robot::{BallId, Pose, Robot};
use proptest::prelude::*;

fn example(name: &str) -> Plan {
    let text = std::fs::read_to_string(format!("{}/../../examples/{name}.toml", env!("CARGO_MANIFEST_DIR")))
        .unwrap();
    let job = Job::from_toml(name, &text).unwrap();
    let mut robot = Robot::by_name(&job.robot).unwrap().unwrap();
    job.tool.state_in(&mut robot);
    Plan::build(&job, &robot).unwrap_or_else(|refused| panic!("{refused}"))
}

fn count(plan: &Plan, kind: PoseKind) -> usize {
    plan.rows.iter().filter(|row| row.kind == kind).count()
}

#[test]
fn the_demo_plans_without_findings() {
    let plan = example("circles");
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    assert_eq!((count(&plan, PoseKind::Measure), count(&plan, PoseKind::Reference)), (240, 12));
    assert!(plan.header.checks.iter().all(dbbd_job::plan::PlanCheck::holds));
    // The base ball's cup stands on a post: no circle goes through it, and none below what the cup allows.
    let worst = |quantity| plan.header.checks.iter().find(|check| check.quantity == quantity).unwrap().worst;
    assert!(worst(dbbd_job::plan::CheckQuantity::CupDeg) <= 120.0);
    assert!(worst(dbbd_job::plan::CheckQuantity::ClearanceMm) >= 10.0);
    for row in plan.rows.iter().filter(|row| row.kind == PoseKind::Measure) {
        assert!((row.length_mm - 300.0).abs() < 2e-3, "{row:?}");
    }
    for row in &plan.rows {
        // Axis angles, status and turn are those of the printed pose.
        let pose = Pose::from_kuka(row.xyz_mm, row.abc_deg);
        let axes = from_status_turn(&robot, &pose, row.status, row.turn).unwrap();
        for i in 0..6 {
            assert!((axes[i].to_degrees() - row.axes_deg[i]).abs() < 2e-6, "{row:?} {axes:?}");
        }
        assert_eq!(row.xyz_mm.map(|x| (x * 1e3).round() / 1e3), row.xyz_mm);
    }
    for circle in 1..=3 {
        let module: Vec<&PlanRow> = plan.rows.iter().filter(|row| row.circle == circle).collect();
        assert_eq!(module[0].motion, MotionKind::Ptp);
        assert!(module.iter().filter(|row| row.kind != PoseKind::Transit).count() <= 255);
        // Three sync markers: out and back, and the reading goes out.
        for marker in 0..3 {
            let out = module[1 + 2 * marker].length_mm - module[2 + 2 * marker].length_mm;
            assert!((out - 0.3).abs() < 2e-3, "{out}");
        }
        // No two moves into dwells of a module last alike.
        let mut times: Vec<f64> = module
            .iter()
            .filter(|row| row.kind != PoseKind::Transit)
            .map(|row| plan.header.moves[row.index as usize - 1].duration_s)
            .collect();
        times.sort_by(f64::total_cmp);
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] > 1e-3), "{times:?}");
        assert!(times[0] >= 0.79, "{}", times[0]);
    }
    // Between two circles about one ball the bar stays on: the module's first move is none.
    for pair in plan.rows.windows(2) {
        if pair[1].motion == MotionKind::Ptp {
            assert_eq!((pair[0].xyz_mm, pair[0].abc_deg), (pair[1].xyz_mm, pair[1].abc_deg));
        }
    }
}

/// The chosen poses are measured on paths that keep everything, and most of them are reached.
#[test]
fn the_chosen_poses_plan_without_findings() {
    let text = std::fs::read_to_string(format!("{}/../../examples/optimal.toml", env!("CARGO_MANIFEST_DIR")))
        .unwrap();
    let text =
        text.replace("points = 80 ", "points = 30 ").replace("candidates = 4000 ", "candidates = 400 ");
    let job = Job::from_toml("optimal", &text).unwrap();
    let mut robot = Robot::by_name(&job.robot).unwrap().unwrap();
    job.tool.state_in(&mut robot);
    let plan = Plan::build(&job, &robot).unwrap_or_else(|refused| panic!("{refused}"));
    assert!(count(&plan, PoseKind::Measure) >= 24, "{:?}", plan.header.notes);
    assert!(plan.header.checks.iter().all(dbbd_job::plan::PlanCheck::holds));
    for row in plan.rows.iter().filter(|row| row.motion != MotionKind::Lin) {
        assert!((row.length_mm - 300.0).abs() < 2e-3, "{row:?}");
    }
    let (csv, json) = plan.to_files().unwrap();
    let read = Plan::from_files("plan.csv", &csv, "plan.json", &json).unwrap();
    assert_eq!((read.rows, read.header.moves), (plan.rows, plan.header.moves));
}

#[test]
fn the_paper_s_circle_has_eighty_points() {
    let plan = example("seed-experiment");
    assert_eq!((count(&plan, PoseKind::Measure), count(&plan, PoseKind::Reference)), (80, 4));
    let places: BTreeSet<String> = plan
        .rows
        .iter()
        .filter(|row| row.kind == PoseKind::Measure)
        .map(|row| format!("{:?}", row.xyz_mm))
        .collect();
    assert_eq!(places.len(), 80);
    assert!(plan.rows.iter().all(|row| row.circle == 1 && row.centre == BallId::FIRST));
}

/// d/v + v/a, and 2 sqrt(d/a) where the speed is not reached.
#[test]
fn a_ramped_move_takes_its_time() {
    assert!((ramped_s(100.0, 20.0, 200.0) - 5.1).abs() < 1e-12);
    assert!((ramped_s(2.0, 20.0, 200.0) - 0.2).abs() < 1e-12);
    assert!((ramped_s(0.5, 20.0, 200.0) - 0.1).abs() < 1e-12);
}

#[test]
fn both_directions_pass_every_point_twice() {
    let text = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\n[[centre]]\nid = 1\n\
        xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 20\norientation = \"fixed\"\n\
        direction = \"both\"\n";
    for text in [text.to_owned(), text.replace("points = 20", "points = 20\narc_deg = 200.0")] {
        let plan = Plan::build(
            &Job::from_toml("job", &text).unwrap(),
            &Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap(),
        );
        let plan = plan.unwrap();
        let points: Vec<_> =
            plan.rows.iter().filter(|r| r.kind == PoseKind::Measure).map(|r| r.xyz_mm).collect();
        assert_eq!(points.len(), 40);
        for point in &points {
            let near = |other: &&[f64; 3]| other.iter().zip(point).all(|(a, b)| (a - b).abs() < 2e-3);
            assert_eq!(points.iter().filter(near).count(), 2);
        }
    }
}

/// Files that are no plan: which is changed, what is replaced in it, the code and the file and line that are named.
const FILES: &[(&str, &str, &str, &str, &str, usize)] = &[
    ("csv", "1599.075", "1599.076", "E0730", "plan.json", 0),
    ("csv", "\n2,", "\n3,", "E0731", "plan.csv", 3),
    ("csv", "measure", "mesure", "E0111", "plan.csv", 10),
    ("csv", "transit,circ", "transit,lin", "E0731", "plan.csv", 10),
    ("json", "\"schema\": 1", "\"schema\": 2", "E0731", "plan.json", 0),
    ("json", "\"schema\": 1", "\"scheme\": 1", "E0731", "plan.json", 2),
    ("json", "\"index\": 2,", "\"index\": 3,", "E0730", "plan.json", 0),
    ("json", "\"id\": 1", "\"id\": 2", "E0604", "plan.json", 0),
];

#[test]
fn a_pair_that_does_not_match_is_refused() {
    let plan = example("seed-experiment");
    let (csv, json) = plan.to_files().unwrap();
    assert_eq!(Plan::from_files("plan.csv", &csv, "plan.json", &json).unwrap(), plan);
    for (which, from, to, code, file, line) in FILES {
        let changed = |name: &str, text: &str| {
            assert!(name != *which || text.contains(from), "{from}");
            if name == *which { text.replacen(from, to, 1) } else { text.to_owned() }
        };
        let (csv, json) = (changed("csv", &csv), changed("json", &json));
        let error = Plan::from_files("plan.csv", &csv, "plan.json", &json).unwrap_err();
        assert_eq!((error.code().as_str(), error.file_name()), (*code, *file), "{from}: {error}");
        assert_eq!(error.line_number(), *line, "{from}: {error}");
    }
    assert!(Plan::from_files("plan.csv", "", "plan.json", &json).is_err());
    assert!(Plan::from_files("plan.csv", &csv, "plan.json", "{}").is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn numbers_read_back_bit_for_bit(values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::ZERO, 13)) {
        let job = "robot = \"x\"\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\n[[centre]]\nid = 1\n\
            xyz_mm = [0.1, 0.2, 0.3]\n[[circle]]\nplane = \"XY\"\npoints = 5\n";
        let job = Job::from_toml("job", job).unwrap();
        let row = PlanRow {
            index: 1, circle: 1, centre: BallId::FIRST, kind: PoseKind::Measure, motion: MotionKind::Lin,
            xyz_mm: [values[0], values[1], values[2]],
            abc_deg: [values[3], values[4], values[5]],
            axes_deg: std::array::from_fn(|i| values[6 + i]),
            status: 2, turn: 35, length_mm: values[12], dwell_s: 0.1 + values[0].abs(),
        };
        let time = dbbd_job::plan::MoveTime {
            index: 1, feed_mm_s: values[1], turn_deg_s: values[2], axis_percent: values[3], duration_s: values[4],
        };
        let header = dbbd_job::plan::PlanHeader {
            schema: 1, hash: String::new(), text_hash: String::new(), pose_hash: String::new(), job, robot: "text".into(), provenance: Provenance::default(), moves: vec![time], passes: Vec::new(), checks: Vec::new(), notes: Vec::new(), taught: Vec::new(), again: false, stage: None, stroke_risk: 0.0, goal: None, predictions: None,
        check: None,
        };
        let (csv, json) = Plan { rows: vec![row.clone()], header }.to_files().unwrap();
        let read = Plan::from_files("plan.csv", &csv, "plan.json", &json).unwrap();
        prop_assert_eq!(&read.rows[0], &row);
        prop_assert_eq!(read.header.moves[0], time);
        prop_assert_eq!(read.to_files().unwrap(), (csv, json));
    }
}
