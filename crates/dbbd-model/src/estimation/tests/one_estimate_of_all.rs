//! One estimate of everything that is unknown: few lengths do no harm, nothing depends on the order of the rows, a list is
//! followed exactly, and a second run goes on where the first ended.

use dbbd_model::estimation::{
    AngleSource, CompletedCalibration, ErrorModel, Input, Options, PlannedLengths, Posterior, Prior, Priors,
    Workspace, factor,
};
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{BaseBall, LengthModel, Measurements, PreparedMeasurement};
use dbbd_model::robot::{BallId, BarId, Joint, ParamId, Robot, parameter};
use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::cell_of_poses::{drawn, normal};
use crate::test_support::cell::{CENTRE, Circle, calibrated, kr60, measure, three_planes};

const SECOND: [f64; 3] = [1000.0, 600.0, 500.0];

fn circles() -> Vec<Circle> {
    [three_planes(1, CENTRE), three_planes(2, SECOND)].concat()
}

fn balls() -> Vec<BaseBall> {
    let ball =
        |(at, place): (usize, [f64; 3])| BaseBall { id: BallId::at(at), position: Vector3::from(place) };
    [CENTRE, SECOND].into_iter().enumerate().map(ball).collect()
}

/// Lengths of `truth` with noise, `points` on each of six circles.
fn lengths(truth: &Robot, points: usize, sigma_mm: f64, seed: u64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut data = measure(truth, &circles(), points, 40.0);
    data.rows.iter_mut().for_each(|row| row.length_mm += sigma_mm * normal(&mut random));
    data
}

/// A robot with an eccentric joint.
fn eccentric(seed: u64) -> Robot {
    let mut robot = drawn(&kr60(), seed);
    robot.geometry.gear[1] = [4e-4, -3e-4];
    robot.geometry.gear[2] = [-2e-4, 5e-4];
    robot
}

fn options() -> Options {
    let workspace = Some(Workspace::uniform(&kr60(), 60, 3));
    Options { folds: Some(0), bar_u_mm: Some(0.005), workspace, ..Options::default() }
}

/// Mean 3-D error over the workspace, mm.
fn error_mm(truth: &Robot, found: &Robot) -> f64 {
    let poses = Workspace::uniform(&kr60(), 200, 5);
    let at = |robot: &Robot| poses.iter().map(|axes| robot.geometry.ball(axes).position).collect::<Vec<_>>();
    let errors = aligned_distances(&at(truth), &at(found));
    errors.iter().sum::<f64>() / errors.len() as f64
}

fn find(robot: &Robot, data: &Measurements, options: &Options) -> CompletedCalibration {
    calibrated(robot, data, &balls(), options).unwrap()
}

/// Gauss and Newton's steps by the QR decomposition of the rows, with differences of the model as derivatives' check: the
/// estimate of a list is where they end.
#[test]
fn a_list_is_followed_exactly() {
    let data = lengths(&drawn(&kr60(), 1), 12, 0.01, 1);
    let list = parameter::parse_list("alpha1-5,a1-5,d4-6,centres", &[], 2).unwrap();
    let options =
        Options { estimate: Some(list.clone()), prior: Prior::None, sigma_mm: Some(0.01), ..options() };
    let found = find(&kr60(), &data, &options);
    let ids: Vec<ParamId> = found.posterior.ids().to_vec();
    assert!(ids.len() >= 13, "{ids:?}");
    let readings: Vec<PreparedMeasurement> = data.rows.iter().map(PreparedMeasurement::from).collect();
    let sigma = vec![0.01; readings.len()];
    let mut model = LengthModel::new(kr60().geometry, &balls());
    for _ in 0..12 {
        let prepared = model.prepare();
        let rows: Vec<Vec<f64>> = readings
            .iter()
            .map(|reading| {
                let row = prepared.row(reading);
                let selection = dbbd_model::measurement::ColumnSelection::new(&ids);
                let mut values = vec![0.0; ids.len()];
                selection.pick(&row, &mut values);
                values
            })
            .collect();
        let a = DMatrix::from_fn(readings.len(), ids.len(), |i, j| rows[i][j]);
        let right = DVector::from_iterator(
            readings.len(),
            readings.iter().map(|one| one.length_mm - prepared.length(one)),
        );
        let units = DVector::from_iterator(ids.len(), a.column_iter().map(|column| column.norm().recip()));
        let qr = (a * DMatrix::from_diagonal(&units)).qr();
        let step =
            qr.r().solve_upper_triangular(&(qr.q().transpose() * right)).unwrap().component_mul(&units);
        ids.iter().zip(&step).for_each(|(id, step)| model.shift(*id, *step));
    }
    // The covariance is that of the rows at the end.
    let mut triangle = factor(&model, &(readings.as_slice(), sigma.as_slice()), &ids);
    let norms: Vec<f64> = triangle.column_iter().map(|column| column.norm()).collect();
    triangle.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
    let inverse = triangle.qr().r().try_inverse().unwrap();
    for (at, id) in ids.iter().enumerate() {
        let off = found.posterior.model.value(*id) - model.value(*id);
        assert!(off.abs() < 1e-9 * model.value(*id).abs().max(1.0), "{id}: {off:e}");
        let sd = found.posterior.sd(*id).unwrap();
        let expected = inverse.row(at).norm() / norms[at];
        assert!((sd / expected - 1.0).abs() < 1e-6, "{id}: {sd} {expected}");
    }
    assert_eq!(found.result.prior_scale, None);
    assert!(found.result.joint_errors.is_none() && found.result.groups.is_empty());
}

#[test]
fn thirty_lengths_do_not_make_a_robot_worse() {
    for seed in 0..6 {
        let truth = eccentric(seed);
        let found = find(&kr60(), &lengths(&truth, 5, 0.01, seed), &options());
        let [before, after] = [error_mm(&truth, &kr60()), error_mm(&truth, &found.robot)];
        assert!(after < before, "seed {seed}: {before} -> {after} mm");
    }
}

#[test]
fn the_order_of_the_rows_does_not_matter() {
    let mut data = lengths(&eccentric(2), 10, 0.01, 2);
    let found = find(&kr60(), &data, &options());
    data.rows.shuffle(&mut Pcg64::seed_from_u64(1));
    let shuffled = find(&kr60(), &data, &options());
    let ids = found.posterior.ids();
    assert_eq!(ids, shuffled.posterior.ids());
    let worst = aligned_worst(&found.robot, &shuffled.robot);
    assert!(worst < 1e-6, "{worst} mm");
}

/// Largest distance of the tool balls over the workspace, mm.
fn aligned_worst(one: &Robot, other: &Robot) -> f64 {
    let poses = Workspace::uniform(&kr60(), 100, 5);
    let at = |robot: &Robot, axes: &[f64; 6]| robot.geometry.ball(axes).position;
    poses.iter().map(|axes| (at(one, axes) - at(other, axes)).norm()).fold(0.0, f64::max)
}

/// Lengths of other poses to balls that were mounted again.
#[test]
fn a_second_run_goes_on_from_the_first() {
    let (mut first_mm, mut second_mm) = (0.0, 0.0);
    for seed in 0..8 {
        let truth = eccentric(10 + seed);
        let first = find(&kr60(), &lengths(&truth, 10, 0.01, seed), &options());
        let again = Options { prior: Prior::Posterior, ..options() };
        let data = lengths(&truth, 8, 0.01, 50 + seed);
        let second = find(&first.robot, &data, &again);
        first_mm += error_mm(&truth, &first.robot);
        second_mm += error_mm(&truth, &second.robot);
        assert!(second.result.outliers.is_empty(), "{:?}", second.result.outliers);
        let [before, after] =
            [&first, &second].map(|of| of.result.predicted_position_uncertainty_mm.identified.mean);
        assert!(after < 1.02 * before, "seed {seed}: predicted {before} -> {after} mm");
    }
    assert!(second_mm <= first_mm, "{first_mm} -> {second_mm} mm");
}

/// The bar is 301 mm, and all lengths are stated as if it were 300.
#[test]
fn a_bar_that_is_a_millimetre_longer_is_found() {
    for seed in 0..3 {
        let truth = drawn(&kr60(), seed);
        let mut data = lengths(&truth, 20, 0.01, seed);
        data.rows.iter_mut().for_each(|row| row.length_mm -= 1.0);
        let found = find(&kr60(), &data, &Options { bar_u_mm: None, ..options() });
        let bar = found.result.parameter(ParamId::BarOffset(BarId::FIRST)).unwrap();
        let sd = bar.sd.unwrap();
        assert!((bar.correction + 1.0).abs() < 4.0 * sd, "seed {seed}: {} +- {sd}", bar.correction);
        assert!(bar.correction < -0.5, "seed {seed}: {} +- {sd}", bar.correction);
        assert!(error_mm(&truth, &found.robot) < error_mm(&truth, &kr60()), "seed {seed}");
    }
}

#[test]
fn the_geometry_alone_has_what_it_leaves_out_as_noise_of_every_pose() {
    let truth = eccentric(3);
    let data = lengths(&truth, 20, 0.01, 3);
    let whole = find(&kr60(), &data, &options());
    let alone = find(&kr60(), &data, &Options { model: ErrorModel::Geometric, ..options() });
    assert!(!whole.robot.geometry.is_rigid());
    assert!(alone.robot.geometry.is_rigid() && alone.robot.geometry.joint_errors.is_none());
    assert_eq!(alone.robot.geometry.gear, [[0.0; 2]; 6]);
    assert!(
        alone
            .result
            .parameters
            .iter()
            .all(|parameter| !parameter.name.is_optional() || parameter.sd.is_none())
    );
    let [of_whole, of_alone] = [&whole, &alone].map(|of| of.robot.uncertainty.as_ref().unwrap().pose_mm);
    assert!(of_alone > 1.2 * of_whole, "{of_whole} {of_alone}");
    let [of_whole, of_alone] = [&whole, &alone].map(|of| error_mm(&truth, &of.robot));
    assert!(of_alone > of_whole && of_alone < error_mm(&truth, &kr60()), "{of_whole} {of_alone}");
    assert!(alone.robot.geometry.value(ParamId::GearCos(Joint::J2)).is_none_or(|value| value == 0.0));
}

/// Robots, harmonics and compliance of all joints drawn from the prior: mean 3-D error over the workspace, true and as predicted, mm.
fn true_and_predicted(model: ErrorModel) -> [f64; 2] {
    let priors = Priors::datasheet(&kr60(), None);
    let mut sums = [0.0; 2];
    for seed in 20..26 {
        let mut truth = drawn(&kr60(), seed);
        let mut random = Pcg64::seed_from_u64(700 + seed);
        truth.geometry.gear.iter_mut().flatten().for_each(|part| *part = 5e-4 * normal(&mut random));
        for id in parameter::compliance() {
            *truth.geometry.value_mut(id).unwrap() = priors.sd(id) * normal(&mut random);
        }
        let found = find(&kr60(), &lengths(&truth, 20, 0.01, seed), &Options { model, ..options() });
        sums[0] += error_mm(&truth, &found.robot) / 6.0;
        sums[1] += found.result.predicted_position_uncertainty_mm.identified.mean / 6.0;
    }
    sums
}

#[test]
fn the_error_of_eccentric_robots_is_as_predicted() {
    let [truth, predicted] = true_and_predicted(ErrorModel::Joints);
    assert!((0.67..1.5).contains(&(predicted / truth)), "{predicted} predicted, {truth} true");
}

#[test]
fn the_error_of_the_geometry_alone_is_as_predicted() {
    let [truth, predicted] = true_and_predicted(ErrorModel::Geometric);
    assert!((0.67..1.5).contains(&(predicted / truth)), "{predicted} predicted, {truth} true");
}

/// With hardly a length that is planned a forecast is what the result of the measured lengths states; as many lengths again at the
/// same poses leave less.
#[test]
fn a_forecast_begins_with_what_the_result_states() {
    let (robot, data) = (kr60(), lengths(&eccentric(3), 20, 0.01, 3));
    let options = Options { prior: Prior::Datasheet, ..options() };
    let start = LengthModel::new(robot.geometry.clone(), &balls());
    let (observations, axes) = (&data, AngleSource::Commanded);
    let input =
        Input { robot: &robot, observations, start: &start, validation: None, options: &options, axes };
    let found = find(&robot, &data, &options).result;
    let stated = found.predicted_position_uncertainty_mm.identified.mean;
    let planned = PlannedLengths::new(input, &data.rows).unwrap();
    let before = planned.stated_before().mean;
    assert!((before / stated - 1.0).abs() < 1e-9, "{before} {stated}");
    let prior = input.posterior().unwrap();
    let after = |count: usize| planned.predict(&prior, 0..count, 0.02).unwrap().forecast.position_mm.mean;
    let [one, all] = [1, data.rows.len()].map(after);
    assert!((one / stated - 1.0).abs() < 0.03 && all < 0.95 * stated, "{one} {all} {stated}");
}

/// What an estimate knows of a length is what it states of the tool ball, with the prior of a ball that no length shows. The
/// place of the robot's base, which four parameters of its first row describe, is that of the balls.
#[test]
fn a_posterior_has_what_the_lengths_show_and_the_prior_of_the_rest() {
    let (robot, data) = (kr60(), lengths(&drawn(&kr60(), 2), 10, 0.01, 2));
    let options = Options { prior: Prior::Datasheet, ..options() };
    let further = BaseBall { id: BallId::at(2), position: Vector3::new(900.0, -600.0, 700.0) };
    let start = LengthModel::new(robot.geometry.clone(), &[balls(), vec![further]].concat());
    let (observations, axes) = (&data, AngleSource::Commanded);
    let input =
        Input { robot: &robot, observations, start: &start, validation: None, options: &options, axes };
    let known = input.posterior().unwrap();
    let priors = Priors::datasheet(&robot, Some(0.005));
    let before = Posterior::prior(&robot, start.clone(), &priors);
    let lacking = before.ids().iter().filter(|id| !known.ids().contains(id));
    let base =
        [ParamId::Alpha(Joint::J1), ParamId::A(Joint::J1), ParamId::Theta(Joint::J1), ParamId::D(Joint::J1)];
    assert_eq!(lacking.copied().collect::<Vec<_>>(), base);
    // At a measured pose the length is known to a few times its noise, at the base of the prior to millimetres.
    let reading = PreparedMeasurement::from(&data.rows[17]);
    let ball = reading.datum.ball().unwrap();
    let [then, now] = [&before, &known].map(|one| one.design_row(&reading.axes, ball).norm());
    assert!(now < 0.05 && then > 1.0, "{then} {now}");
    let of_further = known.design_row(&reading.axes, BallId::at(2)).norm();
    assert!((of_further / before.design_row(&reading.axes, BallId::at(2)).norm() - 1.0).abs() < 0.02);
    assert!(known.own_sd_mm(&reading.axes, ball) > 0.0 && before.own_sd_mm(&reading.axes, ball) == 0.0);
}
