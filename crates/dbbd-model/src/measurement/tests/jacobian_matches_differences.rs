//! The analytic design row of a length agrees with central differences, for every parameter.

use dbbd_model::measurement::{ColumnSelection, Datum, LengthModel, PreparedMeasurement, TargetId, Tracker};
use dbbd_model::robot::Mass;
use dbbd_model::robot::parameter::SetUpCounts;
use dbbd_model::robot::pose::rotation_vector;
use dbbd_model::robot::{
    Approach, BallId, Coordinate, CoupledAxis, Coupling, Geometry, Joint, JointErrorModel, JointErrors,
    ParamUnit, Ripple, Robot, SmoothJointError, VisitedAngles, parameter,
};
use nalgebra::Vector3;
use proptest::prelude::*;

/// An arm without coupled axes, one whose joint 3 turns by A3 + A2, and one whose joint 5 turns by A5 - A3 as well.
fn arms() -> [Geometry; 3] {
    let named = |name: &str| Robot::by_name(name).unwrap().unwrap().geometry;
    let by = |axis, factor| Some(CoupledAxis { axis, factor });
    let coupling = Coupling::new([None, None, by(Joint::J2, 1.0), None, by(Joint::J3, -1.0), None]);
    [named("kr60ha"), named("m10id12"), Geometry { coupling, ..named("crx10ia") }]
}

/// One base ball, two targets on the tool, a tracker.
fn model(geometry: Geometry, ball: Vector3<f64>) -> LengthModel {
    let tracker = Tracker { origin: Vector3::new(3000.0, -500.0, 900.0), turn: Vector3::new(0.4, -0.3, 2.0) };
    let (targets, tracker) = (vec![Vector3::new(-80.0, 30.0, 150.0)], Some(tracker));
    LengthModel { geometry, balls: vec![ball], bar_offsets: vec![], targets, tracker }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..ProptestConfig::default() })]
    #[test]
    fn row_matches_central_differences(
        arm in 0..3usize,
        axes in proptest::array::uniform6(-3.0f64..3.0),
        errors in proptest::collection::vec(-0.01f64..0.01, 61),
        plane in 0..4usize,
        target in 0..2usize,
        centre in proptest::array::uniform3(-1500.0f64..1500.0),
    ) {
        let mut model = model(arms()[arm].clone(), Vector3::from(centre));
        model.geometry.load.masses = vec![
            Mass { joint: Joint::J2, kg: 100.0, centre: Vector3::new(400.0, 0.0, 50.0) },
            Mass { joint: Joint::J6, kg: 60.0, centre: Vector3::new(10.0, 20.0, 150.0) },
        ];
        // Compliance deflects the joints, which changes the torques: the columns do not contain this second-order effect.
        let mut ids = parameter::all_parameters(&Joint::ALL[1..], SetUpCounts { balls: 1, bars: 1, targets: 2, trackers: 1 });
        ids.extend(parameter::parse_list("compliance,gear", &[], 1).unwrap());
        for (id, error) in ids.iter().zip(errors).filter(|(id, _)| id.unit() != ParamUnit::RadPerNm) {
            model.shift(*id, error);
        }
        let of_ball = PreparedMeasurement::new(axes, BallId::FIRST, 0.0);
        let datum = Coordinate::ALL.get(plane).map_or(of_ball.datum, |coordinate| Datum::Plane(*coordinate));
        let reading = PreparedMeasurement { datum, target: TargetId::at(target), ..of_ball };
        let mut row = vec![0.0; ids.len()];
        ColumnSelection::new(&ids).pick(&model.prepare().row(&reading), &mut row);
        prop_assert!((model.prepare().row(&reading).length - model.prepare().length(&reading)).abs() < 1e-10);
        for (id, analytic) in ids.iter().zip(row) {
            let step = if id.unit() == ParamUnit::RadPerNm { 1e-6 } else if id.unit() == ParamUnit::Rad { 1e-5 } else { 1e-2 };
            let difference = |h: f64| {
                let (mut up, mut down) = (model.clone(), model.clone());
                up.shift(*id, h);
                down.shift(*id, -h);
                (up.prepare().length(&reading) - down.prepare().length(&reading)) / (2.0 * h)
            };
            // Richardson extrapolation removes the second-order error.
            let numeric = (4.0 * difference(step / 2.0) - difference(step)) / 3.0;
            let size = numeric.abs().max(1.0);
            prop_assert!((analytic - numeric).abs() < 1e-6 * size, "{id}: {analytic} for {numeric}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..ProptestConfig::default() })]
    #[test]
    fn axis_jacobian_matches_differences(arm in 0..3usize, axes in proptest::array::uniform6(-3.0f64..3.0)) {
        let geometry = &arms()[arm];
        for (axis, (shift, turn)) in geometry.axis_jacobian(&axes).into_iter().enumerate() {
            let at = |step: f64| {
                let mut moved = axes;
                moved[axis] += step;
                geometry.ball(&moved)
            };
            let (up, down) = (at(1e-5), at(-1e-5));
            let moved = (up.position - down.position) / 2e-5;
            let turned = rotation_vector(&(up.rotation * down.rotation.transpose())) / 2e-5;
            prop_assert!((moved - shift).norm() < 1e-5 && (turned - turn).norm() < 1e-8, "arm {arm}, axis {axis}");
        }
    }
}

#[test]
fn rows_of_joint_errors_match_differences() {
    arms().into_iter().for_each(joint_error_rows);
}

fn joint_error_rows(geometry: Geometry) {
    let empty = JointErrors::new(std::array::from_fn(|joint| JointErrorModel {
        smooth: SmoothJointError::new(0.0, 3.5, 5),
        backlash: 0.0,
        visited: VisitedAngles { middle: 0.2, scale: 0.5 },
        ripple: vec![Ripple { order: 7 + joint as u32, ..Ripple::default() }],
    }));
    let with_errors = Geometry { joint_errors: empty.clone(), ..geometry.clone() };
    let mut model = model(geometry, Vector3::new(1300.0, 0.0, 800.0));
    let axes = [0.4, -1.2, 1.5, 0.7, -0.8, 0.3];
    let approach = Approach::new([1, -1, 1, 0, -1, 1]);
    let reading = PreparedMeasurement { approach, ..PreparedMeasurement::new(axes, BallId::FIRST, 0.0) };
    let start: Vec<f64> = (0..empty.count()).map(|at| 1e-4 * (at as f64).cos()).collect();
    let mut length = |coefficients: &[f64]| {
        model.geometry.joint_errors = empty.with(coefficients.iter().copied());
        (model.prepare().length(&reading), model.prepare().row(&reading))
    };
    let (_, row) = length(&start);
    let mut analytic = vec![f64::NAN; start.len()];
    row.joint_terms(&with_errors, &axes, approach, &mut analytic);
    for at in 0..start.len() {
        let moved = |step: f64| {
            let mut moved = start.clone();
            moved[at] += step;
            moved
        };
        let numeric = (length(&moved(1e-5)).0 - length(&moved(-1e-5)).0) / 2e-5;
        assert!((analytic[at] - numeric).abs() < 1e-5 * numeric.abs().max(1.0), "{at}");
    }
    // A sense of approach is an offset of the joints.
    let there = model.geometry.approached(approach).length(&axes, &model.balls[0], 0.0);
    assert!((there - model.prepare().length(&reading)).abs() < 1e-9);
}
