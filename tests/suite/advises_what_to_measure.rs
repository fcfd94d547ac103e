//! Advice found by trying: what is proposed does what was said, and a ball turned about axis 1 does not.

use dbbd::estimation::result_file::Kind;
use dbbd::estimation::{CalibrationResult, Options, Prior, ResultFile};
use dbbd::measurement::{BaseBall, Measurements};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::cell::{
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

fn find(circles: &[Circle], data: &Measurements) -> CalibrationResult {
    let options =
        Options { sigma_mm: Some(0.02), folds: Some(0), prior: Prior::Datasheet, ..Options::default() };
    calibrated(&kr60(), data, &balls(circles), &options).unwrap()
}

#[test]
fn a_ball_elsewhere_helps_and_one_turned_about_axis_1_does_not() {
    let circles = three_planes(1, CENTRE);
    let found = find(&circles, &noisy(&circles, 27, 0.02));
    let advice = &ResultFile::from(&found).advice;
    let of = |kind: Kind| advice.iter().find(|advice| advice.kind == kind).unwrap();
    let mean = found.predicted.identified.mean;
    for advice in advice {
        assert!((advice.before_mm - mean).abs() < 1e-9);
        assert!(advice.after_mm <= advice.before_mm, "lengths cannot lose anything: {}", advice.text);
    }
    assert!(advice.windows(2).all(|pair| pair[0].after_mm <= pair[1].after_mm), "best first");
    let turned = of(Kind::TurnedBall);
    assert!(turned.after_mm > 0.9 * turned.before_mm, "{}", turned.text);
    let ball = of(Kind::Ball);
    assert!(ball.after_mm < 0.7 * ball.before_mm, "{}", ball.text);

    // The ball that is advised, measured as it was tried: three circles, 20 poses.
    let further = three_planes(2, ball.ball_mm.unwrap());
    let all = [circles, further].concat();
    let mut data = noisy(&all[..3], 27, 0.02);
    data.rows.extend(noisy(&all[3..], 7, 0.02).rows);
    let found = find(&all, &data);
    let mean = found.predicted.identified.mean;
    assert!((0.67..1.5).contains(&(mean / ball.after_mm)), "{mean} for {}", ball.text);
}

/// A horizontal circle has alpha1, d2 and d3 in one direction; any other plane tells alpha1 from d2 + d3, which is
/// all that lengths can tell (the reference's rank table).
#[test]
fn another_plane_separates_what_a_horizontal_circle_confounds() {
    let circles = [horizontal(1, CENTRE)];
    let list = dbbd::robot::parameter::parse_list("alpha1-5,a1-5,d2-6", &[], 1).unwrap();
    let options = |prior| Options {
        estimate: Some(list.clone()),
        sigma_mm: Some(0.02),
        folds: Some(0),
        prior,
        ..Options::default()
    };
    let data = noisy(&circles, 80, 0.02);
    for prior in [Prior::None, Prior::Datasheet] {
        let found =
            ResultFile::from(&calibrated(&kr60(), &data, &balls(&circles), &options(prior.clone())).unwrap());
        let circle = found.advice.iter().find(|advice| advice.kind == Kind::Circle).unwrap();
        assert!(circle.tells.contains(&"d2".to_owned()), "{}", circle.text);
        assert!(!circle.tells.contains(&"d3".to_owned()), "{}", circle.text);
        let with_prior = found.advice.iter().any(|advice| advice.kind == Kind::Prior);
        assert_eq!(with_prior, prior == Prior::None);
    }
}

#[test]
fn nothing_is_advised_where_lengths_tell_all_they_can() {
    let circles = [three_planes(1, CENTRE), three_planes(2, [1100.0, 400.0, 600.0])].concat();
    let data = noisy(&circles, 27, 0.001);
    let hold = dbbd::robot::parameter::parse_list("bar", &[], 2).unwrap();
    let options = Options { sigma_mm: Some(0.001), hold, folds: Some(0), ..Options::default() };
    let found = calibrated(&kr60(), &data, &balls(&circles), &options).unwrap();
    // d2 + d3 and where the base stands remain: no lengths tell them.
    assert!(!found.combinations.is_empty());
    assert!(found.recommendations.is_empty(), "{:?}", found.recommendations);
}

/// Poses that never turn the tool leave it and the ball open: followed blindly, as a list is, they are fitted metres
/// away. What is advised rests on what is known of them, is better than what there is, and lies where the arm gets.
#[test]
fn poses_that_tell_little_lead_to_no_absurd_advice() {
    let circles = [horizontal(1, CENTRE)];
    let data = turned(&circles, 36, 0.02, 0.0);
    let all = dbbd::robot::parameter::parse_list("all", &kr60().parallel_joints(), 1).unwrap();
    let mut further = Vec::new();
    for (prior, estimate) in [(Prior::None, None), (Prior::None, Some(all)), (Prior::Datasheet, None)] {
        let options = Options { sigma_mm: Some(0.02), folds: Some(0), prior, estimate, ..Options::default() };
        let found = calibrated(&kr60(), &data, &balls(&circles), &options).unwrap();
        let advice = ResultFile::from(&found).advice;
        for one in &advice {
            assert!(one.after_mm < one.before_mm, "{}", one.text);
            // Outstretched: d1, a1, a2, d4 and d6 of the KR 60 and the tool.
            let reach_mm = 815.0 + 350.0 + 850.0 + 820.0 + 170.0 + 40.0;
            assert!(one.ball_mm.is_none_or(|ball| Vector3::from(ball).norm() < reach_mm), "{}", one.text);
        }
        let ball = advice.iter().find(|advice| advice.kind == Kind::Ball).unwrap();
        assert!(ball.adds, "{}", ball.text);
        further.push(ball.after_mm);
    }
    // The same measurement, whatever was asked of what there is.
    let [least, most] = [f64::min, f64::max].map(|pick| further.iter().copied().reduce(pick).unwrap());
    assert!(most < 1.3 * least, "{further:?}");
}
