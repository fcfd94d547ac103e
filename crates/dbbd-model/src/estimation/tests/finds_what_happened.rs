//! What happened while the lengths were measured is found and named, and noise has no events.

use dbbd_model::estimation::{
    CompletedCalibration, EventTreatment, Options, RunHypothesis, SupposedEventKind, Workspace,
};
use dbbd_model::measurement::{BaseBall, Datum, Measurements};
use dbbd_model::robot::{BallId, BarId, Robot};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::cell_of_poses::{drawn, normal};
use crate::test_support::cell::{CENTRE, Circle, calibrated, kr60, measure, three_planes};

const SECOND: [f64; 3] = [1000.0, 600.0, 500.0];

fn circles() -> Vec<Circle> {
    [three_planes(1, CENTRE), three_planes(2, SECOND)].concat()
}

/// Lengths of a robot drawn by its tolerance, 16 on each of six circles, the balls in turn: an order in which nothing but time
/// tells the first half from the second.
fn run(seed: u64) -> (Robot, Measurements) {
    run_of(seed, 16)
}

fn run_of(seed: u64, of_circle: usize) -> (Robot, Measurements) {
    let truth = drawn(&kr60(), seed);
    let mut random = Pcg64::seed_from_u64(seed);
    let mut data = measure(&truth, &circles(), of_circle, 40.0);
    let count = data.rows.len();
    // 37 and 96 have no common divisor.
    data.rows = (0..count).map(|at| data.rows[at * 37 % count].clone()).collect();
    for (row, index) in data.rows.iter_mut().zip(1..) {
        row.index = index;
        row.length_mm += 0.01 * normal(&mut random);
    }
    (truth, data)
}

fn find(data: &Measurements) -> CompletedCalibration {
    let ball =
        |(at, place): (usize, [f64; 3])| BaseBall { id: BallId::at(at), position: Vector3::from(place) };
    let balls: Vec<BaseBall> = [CENTRE, SECOND].into_iter().enumerate().map(ball).collect();
    let workspace = Some(Workspace::uniform(&kr60(), 40, 3));
    let options = Options { folds: Some(0), bar_u_mm: Some(0.005), workspace, ..Options::default() };
    calibrated(&kr60(), data, &balls, &options).unwrap()
}

fn certain(found: &CompletedCalibration) -> Vec<&RunHypothesis> {
    let is_certain = |one: &&RunHypothesis| one.treated == EventTreatment::Unknown;
    found.result.hypotheses.iter().filter(is_certain).collect()
}

#[test]
fn a_step_of_the_zero_is_named_at_its_row() {
    let (_, mut data) = run(1);
    data.rows.iter_mut().filter(|row| row.index >= 49).for_each(|row| row.length_mm += 0.3);
    let found = find(&data);
    let all = certain(&found);
    let [step] = all[..] else { panic!("{:?}", found.result.hypotheses) };
    assert_eq!(
        (step.name, step.place.index, step.place.bar),
        (SupposedEventKind::BarZeroStep, Some(49), Some(BarId::FIRST.number()))
    );
    assert!((step.size - 0.3).abs() < 4.0 * step.sd, "{step:?}");
    // The data are as they were.
    assert_eq!(found.result.measurements, 96);
}

/// The arm is hit: axes are elsewhere than the controller says from index 50 on.
fn with_steps(seed: u64, steps_deg: &[(usize, f64)]) -> Measurements {
    let (truth, mut data) = run(seed);
    for row in data.rows.iter_mut().filter(|row| row.index >= 50) {
        let ball = Vector3::from(if row.datum.ball() == Some(BallId::at(1)) { SECOND } else { CENTRE });
        let mut axes = row.axes.radians();
        let before = truth.geometry.length(&axes, &ball, 0.0);
        steps_deg.iter().for_each(|(axis, deg)| axes[axis - 1] += deg.to_radians());
        row.length_mm += truth.geometry.length(&axes, &ball, 0.0) - before;
    }
    data
}

#[test]
fn a_step_of_an_axis_is_named() {
    const STEP_DEG: f64 = 0.1;
    let found = find(&with_steps(3, &[(3, STEP_DEG)]));
    let all = certain(&found);
    let [event] = all[..] else { panic!("{:?}", found.result.hypotheses) };
    assert_eq!(
        (event.name, event.place.joint, event.place.index),
        (SupposedEventKind::JointZeroStep, Some(3), Some(50))
    );
    assert!((event.size - 1e3 * STEP_DEG.to_radians()).abs() < 4.0 * event.sd, "{event:?}");
}

#[test]
fn two_axes_that_step_at_one_row_are_both_named() {
    let found = find(&with_steps(3, &[(2, 0.1), (3, -0.15)]));
    let steps: Vec<_> = certain(&found).iter().map(|event| (event.place.joint, event.place.index)).collect();
    let is_named = |axis: usize| steps.contains(&(Some(axis), Some(50)));
    assert!(is_named(2) && is_named(3), "{:?}", found.result.hypotheses);
}

#[test]
fn a_base_ball_that_moved_is_named() {
    let (truth, mut data) = run(2);
    let moved = Vector3::from(SECOND) + Vector3::new(0.5, -0.4, 0.3);
    let is_later = |datum: Datum, index: u32| index >= 50 && datum.ball() == Some(BallId::at(1));
    for row in data.rows.iter_mut().filter(|row| is_later(row.datum, row.index)) {
        let length = |place: &Vector3<f64>| truth.geometry.length(&row.axes.radians(), place, 0.0);
        row.length_mm += length(&moved) - length(&Vector3::from(SECOND));
    }
    let found = find(&data);
    let all = certain(&found);
    let [event] = all[..] else { panic!("{:?}", found.result.hypotheses) };
    assert_eq!((event.name, event.place.ball), (SupposedEventKind::BaseBallMoved, Some(2)));
    assert!((event.size - 0.5f64.sqrt()).abs() < 5.0 * event.sd, "{event:?}");
    // The row of another ball may be named with it.
    assert!(event.place.index.is_some_and(|index| index.abs_diff(50) <= 3), "{event:?}");
}

#[test]
fn noise_has_no_events() {
    for seed in 10..18 {
        let found = find(&run(seed).1);
        assert!(certain(&found).is_empty(), "seed {seed}: {:?}", found.result.hypotheses);
    }
}

/// Three of 96 are too few to be certain of the other ball, but they are left out; more have the number of their ball.
#[test]
fn wrong_ball_numbers_never_spoil_the_estimate() {
    for (count, seed) in [(1, 4), (3, 5), (3, 6), (5, 5), (8, 6)] {
        let (_, mut data) = run(seed);
        let sound = find(&data).result.residual_mm.after.rms;
        for at in (10..).step_by(11).take(count) {
            let Datum::Ball(ball, bar) = data.rows[at].datum else { continue };
            data.rows[at].datum = Datum::Ball(BallId::at(1 - ball.index()), bar);
        }
        let found = find(&data).result;
        let renumbered: usize = found.hypotheses.iter().map(|one| one.place.rows.len()).sum();
        assert_eq!(found.outliers.len() + renumbered, count, "seed {seed}: {:?}", found.hypotheses);
        assert_eq!(renumbered > 0, count > 3);
        assert!(
            (found.residual_mm.after.rms / sound - 1.0).abs() < 0.1,
            "{} {sound}",
            found.residual_mm.after.rms
        );
    }
}

/// One ball after the other: a step between them is the same as an offset of a ball.
#[test]
fn a_step_that_an_offset_of_a_ball_explains_as_well_is_at_most_reported() {
    let (_, mut data) = run(3);
    data.rows.sort_by_key(|row| row.datum.ball());
    for (row, index) in data.rows.iter_mut().zip(1..) {
        row.index = index;
        if index > 48 {
            row.length_mm += 0.1;
        }
    }
    let found = find(&data);
    assert!(certain(&found).is_empty(), "{:?}", found.result.hypotheses);
    for one in &found.result.hypotheses {
        assert!(!one.rivals.is_empty() || one.probability < 0.99, "{one:?}");
    }
}

#[test]
fn a_wrong_ball_number_is_found_and_the_table_stays() {
    let (_, mut data) = run(4);
    let wrong = [11, 12, 13, 14, 40, 77];
    let mut expected = Vec::new();
    for index in wrong {
        let row = &mut data.rows[index - 1];
        let Datum::Ball(ball, bar) = row.datum else { continue };
        row.datum = Datum::Ball(BallId::at(1 - ball.index()), bar);
        expected.push((ball.number(), index as u32));
    }
    let found = find(&data);
    let all = certain(&found);
    assert!(all.iter().all(|one| one.name == SupposedEventKind::WrongBall), "{all:?}");
    let mut rows: Vec<(u32, u32)> =
        all.iter().flat_map(|one| one.place.rows.iter().map(|row| (one.place.ball.unwrap(), *row))).collect();
    rows.sort_by_key(|(_, row)| *row);
    assert_eq!(rows, expected);
    assert!(found.result.outliers.is_empty(), "{:?}", found.result.outliers);
}

/// Of so many lengths a sample is searched; the place is that among all lengths.
#[test]
fn a_step_among_many_lengths_is_named_at_its_row() {
    let (_, mut data) = run_of(1, 1000);
    data.rows.iter_mut().filter(|row| row.index >= 3001).for_each(|row| row.length_mm += 0.3);
    let found = find(&data);
    let step = certain(&found)[0];
    let index = step.place.index.unwrap();
    // Every 50th row or so is tried.
    assert!(step.name == SupposedEventKind::BarZeroStep && (2950..3050).contains(&index), "{step:?}");
}
