//! Recommendations have the predicted effect, and a ball rotated about axis 1 has none.

use dbbd_model::estimation::result::{FurtherMeasurement, Recommendation};
use dbbd_model::estimation::{CompletedCalibration, Options, Prior};
use dbbd_model::measurement::{BaseBall, Measurements};
use dbbd_model::robot::{Joint, ParamId};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::test_support::cell::{
    CENTRE, Circle, DESIGNED, calibrated, horizontal, kr60, measure, three_planes, with_errors,
};

fn balls(circles: &[Circle]) -> Vec<BaseBall> {
    let mut centres: Vec<BaseBall> =
        circles.iter().map(|c| BaseBall { id: c.ball(), position: Vector3::from(c.centre) }).collect();
    centres.dedup_by_key(|centre| centre.id);
    centres
}

fn noisy(circles: &[Circle], points: usize, sigma_mm: f64) -> Measurements {
    turned(circles, points, sigma_mm, 25.0)
}

/// The wrist turns by `amplitude_deg` along each circle.
fn turned(circles: &[Circle], points: usize, sigma_mm: f64, amplitude_deg: f64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(1);
    let mut data = measure(&with_errors(DESIGNED), circles, points, amplitude_deg);
    for row in &mut data.rows {
        row.length_mm += sigma_mm * {
            let z: f64 = StandardNormal.sample(&mut random);
            z
        };
    }
    data
}

fn find(circles: &[Circle], data: &Measurements) -> CompletedCalibration {
    let options =
        Options { sigma_mm: Some(0.02), folds: Some(0), prior: Prior::Datasheet, ..Options::default() };
    calibrated(&kr60(), data, &balls(circles), &options).unwrap()
}

/// A calibration of the geometry alone: a ball turned about axis 1 would show errors of that joint.
fn find_geometry(circles: &[Circle], data: &Measurements) -> CompletedCalibration {
    let balls = balls(circles);
    let estimate = dbbd_model::robot::parameter::parse_list("all", &kr60().parallel_joints(), balls.len());
    let options = Options {
        estimate: Some(estimate.unwrap()),
        sigma_mm: Some(0.02),
        folds: Some(0),
        prior: Prior::Datasheet,
        ..Options::default()
    };
    calibrated(&kr60(), data, &balls, &options).unwrap()
}

/// The word of `result.json`.
fn kind_of(one: &Recommendation) -> &'static str {
    match one.measure {
        FurtherMeasurement::Circle { .. } => "circle",
        FurtherMeasurement::Wrist { .. } => "wrist",
        FurtherMeasurement::Ball { .. } => "ball",
        FurtherMeasurement::TurnedBall { .. } => "turned_ball",
        FurtherMeasurement::Bar { .. } => "bar",
    }
}

/// The place of a further ball (robot base, mm).
fn ball_mm(one: &Recommendation) -> Option<[f64; 3]> {
    match one.measure {
        FurtherMeasurement::Ball { ball_mm } | FurtherMeasurement::TurnedBall { ball_mm } => Some(ball_mm),
        _ => None,
    }
}

#[test]
fn a_further_ball_helps_and_a_rotation_about_axis_1_does_not() {
    let circles = three_planes(1, CENTRE);
    let found = find(&circles, &noisy(&circles, 27, 0.02));
    let advice = &found.result.recommendations;
    let of = |kind: &str| advice.iter().find(|one| kind_of(one) == kind).unwrap();
    let mean = found.result.predicted_position_uncertainty_mm.identified.mean;
    for advice in advice {
        assert!((advice.before_mm - mean).abs() < 1e-9);
        assert!(advice.after_mm <= advice.before_mm, "lengths cannot lose anything: {advice}");
    }
    assert!(advice.windows(2).all(|pair| pair[0].after_mm <= pair[1].after_mm), "best first");
    let turned = of("turned_ball");
    assert!(turned.after_mm > 0.9 * turned.before_mm, "{turned}");
    let ball = of("ball");
    assert!(ball.after_mm < 0.7 * ball.before_mm, "{ball}");

    // The recommended ball, measured as it was simulated: three circles, 20 poses.
    let further = three_planes(2, ball_mm(ball).unwrap());
    let all = [circles, further].concat();
    let mut data = noisy(&all[..3], 27, 0.02);
    data.rows.extend(noisy(&all[3..], 7, 0.02).rows);
    let found = find(&all, &data);
    let mean = found.result.predicted_position_uncertainty_mm.identified.mean;
    assert!((0.67..1.5).contains(&(mean / ball.after_mm)), "{mean} for {ball}");
}

#[test]
fn a_rotation_about_axis_1_does_not_help_with_a_bar_without_certificate() {
    let circles = three_planes(1, CENTRE);
    let found = find_geometry(&circles, &noisy(&circles, 27, 0.02));
    let turned = found.result.recommendations.iter().find(|one| kind_of(one) == "turned_ball").unwrap();
    assert!(turned.after_mm > 0.9 * turned.before_mm, "{turned}");
}

/// On a horizontal circle alpha1, d2 and d3 are dependent. Any other plane separates alpha1 from d2 + d3; lengths cannot
/// separate more (the reference's rank table).
#[test]
fn another_plane_separates_the_parameters_of_a_horizontal_circle() {
    let circles = [horizontal(1, CENTRE)];
    let list = dbbd_model::robot::parameter::parse_list("alpha1-5,a1-5,d2-6", &[], 1).unwrap();
    let options = |prior| Options {
        estimate: Some(list.clone()),
        sigma_mm: Some(0.02),
        folds: Some(0),
        prior,
        ..Options::default()
    };
    let data = noisy(&circles, 80, 0.02);
    for prior in [Prior::None, Prior::Datasheet] {
        let found = calibrated(&kr60(), &data, &balls(&circles), &options(prior.clone())).unwrap().result;
        let circle = found.recommendations.iter().find(|one| kind_of(one) == "circle").unwrap();
        assert!(circle.identifies.contains(&ParamId::D(Joint::J2)), "{circle}");
        assert!(!circle.identifies.contains(&ParamId::D(Joint::J3)), "{circle}");
    }
}

#[test]
fn no_recommendation_if_all_parameters_are_identified() {
    let circles = [three_planes(1, CENTRE), three_planes(2, [1100.0, 400.0, 600.0])].concat();
    let data = noisy(&circles, 27, 0.001);
    let hold = dbbd_model::robot::parameter::parse_list("bar", &[], 2).unwrap();
    let options = Options { sigma_mm: Some(0.001), hold, folds: Some(0), ..Options::default() };
    let found = calibrated(&kr60(), &data, &balls(&circles), &options).unwrap();
    // Only d2 + d3 and the place of the base are left, which no lengths determine.
    assert!(!found.result.combinations.is_empty());
    assert!(found.result.recommendations.is_empty(), "{:?}", found.result.recommendations);
}

/// The further ball of a calibration from poses that never rotate the tool: they do not determine tool and ball.
fn ball_after_uninformative_poses(prior: Prior, estimate: Option<Vec<ParamId>>) -> f64 {
    let circles = [horizontal(1, CENTRE)];
    let data = turned(&circles, 36, 0.02, 0.0);
    let options = Options { sigma_mm: Some(0.02), folds: Some(0), prior, estimate, ..Options::default() };
    let found = calibrated(&kr60(), &data, &balls(&circles), &options).unwrap();
    let advice = found.result.recommendations;
    for one in &advice {
        assert!(one.after_mm < one.before_mm, "{one}");
        // Outstretched: d1, a1, a2, d4 and d6 of the KR 60 and the tool.
        let reach_mm = 815.0 + 350.0 + 850.0 + 820.0 + 170.0 + 40.0;
        assert!(ball_mm(one).is_none_or(|ball| Vector3::from(ball).norm() < reach_mm), "{one}");
    }
    let ball = advice.iter().find(|one| kind_of(one) == "ball").unwrap();
    assert!(ball.adds, "{ball}");
    ball.after_mm
}

/// Recommendations improve the result and are within reach, also where a list was fitted metres away: it takes places that the
/// poses leave open as exact. The same measurement is about as good, whether the tolerance binds
/// all directions or only those that the data leave open.
#[test]
fn uninformative_poses_give_no_absurd_recommendation() {
    let after = [Prior::None, Prior::Datasheet].map(|prior| ball_after_uninformative_poses(prior, None));
    assert!(after[0].max(after[1]) < 1.5 * after[0].min(after[1]), "{after:?}");
    ball_after_uninformative_poses(Prior::None, Some(everything()));
}

fn everything() -> Vec<ParamId> {
    dbbd_model::robot::parameter::parse_list("all", &kr60().parallel_joints(), 1).unwrap()
}
