//! Operations whose instructions are counted: `benches/counts/run` starts this program under valgrind, once for each name.
#![allow(missing_docs, clippy::expect_used, clippy::panic, clippy::print_stdout)]

#[path = "support/problem.rs"]
mod problem;
#[path = "support/production.rs"]
mod production;
#[path = "support/stream.rs"]
mod stream;

use std::hint::black_box;

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::program::Correction;
use dbbd_job::program::krl::{Files, Given, Text, compensate, read};
use dbbd_job::sim::truth;
use dbbd_model::design::calibrate;
use dbbd_model::estimation::{Options, Workspace};
use dbbd_model::measurement::{ColumnSelection, LengthModel, Measurements, PreparedMeasurement};
use dbbd_model::robot::inverse::branches;
use dbbd_model::robot::{LengthRow, Robot, parameter};

/// An operation by its name.
const OPERATIONS: [(&str, fn()); 10] = [
    ("rows", rows),
    ("fit-80", || fit(80)),
    ("fit-1000", || fit(1000)),
    ("estimate-40", || report(40, Some(40))),
    ("report-80", || report(80, None)),
    ("report-1000", || report(1000, None)),
    ("decode", decode),
    ("branches", all_branches),
    ("compensate-1000", compensate_program),
    ("read-table", read_table),
];

/// 1000 rows by all 32 columns of the geometry and the set-up.
fn rows() {
    let (robot, observations, centres) = problem::problem(1000);
    let ids = parameter::all_parameters(&robot.parallel_joints(), 1);
    let selection = ColumnSelection::new(&ids);
    let model = LengthModel::new(robot.geometry.clone(), &centres);
    let (mut derivatives, mut row) = (LengthRow::default(), vec![0.0; ids.len()]);
    let prepared = model.prepare();
    for reading in observations.rows.iter().map(PreparedMeasurement::from) {
        prepared.row_into(&reading, &selection, &mut derivatives);
        selection.pick(&derivatives, &mut row);
        black_box(&row);
    }
}

fn fit(poses: usize) {
    let (robot, observations, centres) = problem::problem(poses);
    let start = LengthModel::new(robot.geometry.clone(), &centres);
    let options = Options { estimate: Some(problem::thirteen()), folds: Some(0), ..Options::default() };
    let model = problem::input(&robot, &observations, &start, &options).fit().expect("a model");
    black_box(model);
}

/// The full report; over so many poses of the workspace, else over the usual ones.
fn report(poses: usize, workspace: Option<usize>) {
    let (robot, observations, centres) = problem::problem(poses);
    let start = LengthModel::new(robot.geometry.clone(), &centres);
    let workspace = workspace.map(|count| Workspace::uniform(&robot, count, 1));
    let options = Options { folds: Some(0), workspace, ..Options::default() };
    let input = problem::input(&robot, &observations, &start, &options);
    black_box(calibrate(&input, Vec::new()).expect("a result"));
}

/// 200 frames by each definition.
fn decode() {
    for (name, _) in ProtocolDefinition::built_in() {
        let definition = ProtocolDefinition::by_name(name).expect("built in").expect("reads");
        let mut out = Vec::new();
        definition.decoder().push(&stream::stream(&definition, 200), &mut out);
        assert!(out.len() >= 200, "{name}: {}", out.len());
    }
}

/// All branches of 50 poses of an arm with a spherical wrist, of one with parallel axes, and of an identified one.
fn all_branches() {
    let built_in = |name: &str| Robot::by_name(name).expect("built in").expect("reads").geometry;
    let mut identified = built_in("kr60ha");
    identified.rows.iter_mut().for_each(|row| row.alpha += 1e-3);
    for arm in [built_in("kr60ha"), built_in("ur10"), identified] {
        for k in 0..50 {
            let axes = std::array::from_fn(|i| (f64::from(k) * 1.7 + i as f64 * 2.3).sin() * 1.5);
            black_box(branches(&arm, &arm.ball(&axes)).expect("branches"));
        }
    }
}

fn compensate_program() {
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).expect("built in").expect("reads");
    let (source, data) = production::production(&robot, 1000);
    let files = Files {
        source: Text { file: "P.src", text: &source },
        data: Some(Text { file: "P.dat", text: &data }),
        config: None,
    };
    let points = read(files, Given::default()).expect("points");
    let identified =
        Robot { nominal: Some(Box::new(robot.clone())), ..truth::draw_true_robot(&robot, 1, 1.0) };
    assert_eq!(
        compensate(files, &points, Correction::of(&identified, 50.0)).expect("compensated").moved.len(),
        1000
    );
}

/// A table of 20 000 lengths.
fn read_table() {
    let mut table = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm\n".to_owned();
    for index in 1..=20_000 {
        table +=
            &format!("{index},1,10.{index:06},-80.5,95.25,30.125,-40.0625,12.5,300.{:04}\n", index % 10_000);
    }
    assert_eq!(Measurements::from_csv("table.csv", &table).expect("reads").rows.len(), 20_000);
}

fn main() {
    let asked = std::env::args().nth(1).unwrap_or_default();
    match OPERATIONS.iter().find(|(name, _)| *name == asked) {
        Some((_, operation)) => operation(),
        None => OPERATIONS.iter().for_each(|(name, _)| println!("{name}")),
    }
}
