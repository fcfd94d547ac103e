//! Statistical efficiency: scatter at the Cramer-Rao bound, coverage of intervals, convergence from distant starts, detection
//! of outliers. The suite runs a seeded sample; the full campaigns are ignored tests, with their commands and figures in
//! docs/evidence/README.md.

use dbbd_model::estimation::result::Status;
use dbbd_model::estimation::{CompletedCalibration, Options, Prior};
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{BaseBall, Measurements};
use dbbd_model::robot::{Joint, ParamId, Robot, parameter};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::cell_of_poses::{drawn, normal};
use crate::test_support::cell::{
    CENTRE, Circle, DESIGNED, calibrated, kr60, measure, three_planes, with_errors,
};

fn balls(circles: &[Circle]) -> Vec<BaseBall> {
    let mut centres: Vec<BaseBall> = circles
        .iter()
        .map(|circle| BaseBall { id: circle.ball(), position: Vector3::from(circle.centre) })
        .collect();
    centres.dedup_by_key(|centre| centre.id);
    centres
}

fn find(robot: &Robot, data: &Measurements, centres: &[BaseBall], options: &Options) -> CompletedCalibration {
    calibrated(robot, data, centres, options).unwrap()
}

/// The paper's 13 from three planes with 1 um of noise: for each parameter the scatter over the
/// standard deviation that the result gives (which is the bound), and the fraction of 95 % intervals that cover.
fn scatter_and_coverage(seeds: u64) -> Vec<(String, f64, f64)> {
    let circles = three_planes(1, CENTRE);
    let exact = measure(&with_errors(DESIGNED), &circles, 27, 25.0);
    let options = Options {
        estimate: Some(parameter::parse_list("alpha1-5,a1-5,d4-6", &[], 1).unwrap()),
        sigma_mm: Some(0.001),
        folds: Some(0),
        ..Options::default()
    };
    let mut sums = vec![(0.0, 0.0); DESIGNED.len()];
    for seed in 0..seeds {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut data = exact.clone();
        data.rows.iter_mut().for_each(|row| row.length_mm += 0.001 * normal(&mut random));
        let found = find(&kr60(), &data, &balls(&circles), &options);
        for ((name, designed), (squares, covered)) in DESIGNED.iter().zip(&mut sums) {
            let parameter = found.result.parameter(name.parse().unwrap()).unwrap();
            let off = (parameter.correction - designed) / parameter.sd.unwrap();
            *squares += off * off;
            *covered += f64::from(off.abs() < 1.959_964);
        }
    }
    let n = seeds as f64;
    DESIGNED.iter().zip(sums).map(|((name, _), (s, c))| ((*name).to_owned(), (s / n).sqrt(), c / n)).collect()
}

#[test]
fn scatter_reaches_the_cramer_rao_bound() {
    for (name, scatter, covered) in scatter_and_coverage(100) {
        // Four standard errors of 100 draws: 1 / sqrt(200) of a scatter, sqrt(0.95 * 0.05 / 100) of a share.
        assert!((scatter - 1.0).abs() < 0.29, "{name}: scatter {scatter}");
        assert!(covered > 0.86, "{name}: covers {covered}");
    }
}

#[test]
#[ignore = "2000 seeds: see docs/evidence/README.md"]
fn scatter_reaches_the_cramer_rao_bound_in_2000_seeds() {
    for (name, scatter, covered) in scatter_and_coverage(2000) {
        eprintln!("{name}: scatter / bound {scatter:.3}, 95 % intervals cover {:.2} %", covered * 100.0);
        assert!((scatter - 1.0).abs() < 0.05 && (0.935..=0.965).contains(&covered));
    }
}

/// The lengths of one horizontal circle hardly determine the height of its ball: their change is quadratic in it, by 5 mm at a
/// radius of 300 mm as much as 0.04 mm. The fit comes to rest at their noise of 0.01 mm.
#[test]
fn lengths_of_one_circle_are_fitted_to_their_noise() {
    let circles = &three_planes(1, CENTRE)[..1];
    for seed in 1..=6 {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut data = measure(&drawn(&kr60(), seed), circles, 42, 25.0);
        data.rows.iter_mut().for_each(|row| row.length_mm += 0.01 * normal(&mut random));
        let mut centres = balls(circles);
        centres[0].position += Vector3::new(0.5, -0.4, 0.6);
        let options =
            Options { prior: Prior::Datasheet, bar_u_mm: Some(0.001), folds: Some(0), ..Options::default() };
        let found = find(&kr60(), &data, &centres, &options).result;
        let after = found.residual_mm.after;
        assert!(found.converged && after.rms < 0.012 && after.mean.abs() < 0.002, "{seed}: {after:?}");
    }
}

/// Starts off by up to `angle` rad on every joint offset and `length` mm on every length, ball and
/// tool; the fraction that reaches the right minimum, and the number of wrong ones without a finding.
fn far_starts(circles: &[Circle], points: usize, starts: u64, angle: f64, length: f64) -> (f64, u32) {
    let truth = with_errors(DESIGNED);
    let data = measure(&truth, circles, points, 25.0);
    let poses: Vec<[f64; 6]> = data.rows.iter().map(|row| row.axes.radians()).collect();
    let ball =
        |robot: &Robot| poses.iter().map(|axes| robot.geometry.ball(axes).position).collect::<Vec<_>>();
    let (mut right, mut silent) = (0, 0);
    for seed in 0..starts {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut off = |size: f64| random.random_range(-size..size);
        let mut start = kr60();
        for id in ParamId::denavit_hartenberg() {
            let error = match id {
                ParamId::Theta(_) => off(angle),
                ParamId::A(_) | ParamId::D(_) => off(length),
                _ => 0.0,
            };
            *start.geometry.value_mut(id).unwrap() += error;
        }
        let mut centres = balls(circles);
        for axis in 0..3 {
            start.geometry.tool[axis] += off(length);
            centres.iter_mut().for_each(|centre| centre.position[axis] += off(length));
        }
        let list = parameter::parse_list("geometric,tool,centres", &[Joint::J3], centres.len()).unwrap();
        let options =
            Options { estimate: Some(list), sigma_mm: Some(0.001), folds: Some(0), ..Options::default() };
        let Ok(found) = calibrated(&start, &data, &centres, &options) else { continue };
        let worst = aligned_distances(&ball(&truth), &ball(&found.robot)).into_iter().fold(0.0, f64::max);
        let warned = found.result.has_warnings();
        if worst < 1e-3 {
            right += 1;
        } else if !warned {
            silent += 1;
        }
    }
    (f64::from(right) / starts as f64, silent)
}

fn three_balls() -> Vec<Circle> {
    [
        three_planes(1, CENTRE),
        three_planes(2, [1100.0, 400.0, 600.0]),
        three_planes(3, [1200.0, -500.0, 1000.0]),
    ]
    .concat()
}

#[test]
fn distant_starts_converge() {
    assert_eq!(far_starts(&three_planes(1, CENTRE), 27, 12, 0.2, 50.0), (1.0, 0));
}

#[test]
#[ignore = "4000 fits: see docs/evidence/README.md"]
fn distant_starts_converge_in_1000() {
    for (name, circles, points) in
        [("one ball", three_planes(1, CENTRE).to_vec(), 27), ("three balls", three_balls(), 9)]
    {
        for factor in [1.0, 2.0] {
            let (share, silent) = far_starts(&circles, points, 1000, 0.2 * factor, 50.0 * factor);
            eprintln!(
                "{name}, {} rad, {} mm: {:.1} % right, {silent} silent",
                0.2 * factor,
                50.0 * factor,
                share * 100.0
            );
            assert_eq!(silent, 0);
            assert!(factor > 1.0 || share == 1.0);
        }
    }
}

/// 21 lengths whose given sigma is that of the bar, 2 um, while the robot repeats to 14 um: as many parameters take
/// make most residuals vanish, and the others must not be outliers relative to these.
#[test]
fn few_clean_lengths_have_no_outliers() {
    let circles = three_planes(1, CENTRE);
    let truth = with_errors([("a1", 0.4), ("alpha2", 6e-4), ("d4", -0.5), ("theta3", 9e-4), ("a3", -0.3)]);
    let mut named = 0;
    for seed in 0..20 {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut data = measure(&truth, &circles, 7, 25.0);
        for row in &mut data.rows {
            row.length_mm += 0.014 * normal(&mut random);
            row.sigma_mm = Some(0.002);
        }
        let options = Options { folds: Some(0), prior: Prior::Datasheet, ..Options::default() };
        let out = find(&kr60(), &data, &balls(&circles), &options).result.outliers;
        assert!(out.len() <= 1, "seed {seed}: {out:?}");
        named += out.len();
    }
    // One in a hundred data sets, by the limit.
    assert!(named <= 1, "{named}");
}

/// So many lengths that they are prepared piece by piece, and that an even sample gives their scale. The bar's sigma is a fifth
/// of their noise.
#[test]
fn many_lengths_agree_with_few() {
    let circles = three_planes(1, CENTRE);
    let mut random = Pcg64::seed_from_u64(1);
    let mut data = measure(&with_errors(DESIGNED), &circles, 50, 25.0);
    let poses = data.rows.clone();
    data.rows = poses.iter().cycle().take(20_000).cloned().collect();
    for (row, index) in data.rows.iter_mut().zip(1..) {
        row.index = index;
        row.length_mm += 0.005 * normal(&mut random);
        row.sigma_mm = Some(0.001);
    }
    let spoiled = [17, 4096, 4097, 12_345, 20_000];
    spoiled.iter().for_each(|at| data.rows[at - 1].length_mm += 3.0);
    let asked = DESIGNED.iter().map(|(name, _)| name.parse().unwrap()).collect();
    let options = Options { estimate: Some(asked), folds: Some(0), ..Options::default() };
    let found = find(&kr60(), &data, &balls(&circles), &options);
    let named: Vec<usize> = found.result.outliers.iter().map(|outlier| outlier.index as usize).collect();
    assert_eq!(named, spoiled.to_vec());
    assert!(found.excluded_rows.iter().map(|rows| rows.end).eq(named.iter().copied()));
    assert!((found.result.noise_mm.length / 0.005 - 1.0).abs() < 0.03, "{}", found.result.noise_mm.length);
    assert!((found.result.residual_mm.after.rms / 0.005 - 1.0).abs() < 0.03);
    for (name, error) in DESIGNED {
        let parameter = found.result.parameter(name.parse().unwrap()).unwrap();
        let off = (parameter.correction - error).abs() / parameter.sd.unwrap();
        assert!(off < 4.0, "{name} is off by {off} standard deviations");
    }
}

#[test]
fn outliers_are_reported_and_have_no_effect() {
    let circles = three_planes(1, CENTRE);
    for seed in 0..5 {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut data = measure(&with_errors(DESIGNED), &circles, 80, 25.0);
        data.rows.iter_mut().for_each(|row| row.length_mm += 0.01 * normal(&mut random));
        let options = Options { folds: Some(0), ..Options::default() };
        let clean = find(&kr60(), &data, &balls(&circles), &options);
        let mut spoiled: Vec<u32> = Vec::new();
        for _ in 0..12 {
            let at = random.random_range(0..data.rows.len());
            let size = 10f64.powf(random.random_range(0.0..2.0));
            if !spoiled.contains(&data.rows[at].index) {
                data.rows[at].length_mm += if random.random::<bool>() { size } else { -size };
                spoiled.push(data.rows[at].index);
            }
        }
        spoiled.sort_unstable();
        let found = find(&kr60(), &data, &balls(&circles), &options);
        let named: Vec<u32> = found.result.outliers.iter().map(|outlier| outlier.index).collect();
        assert_eq!(named, spoiled, "seed {seed}");
        for (with, without) in found.result.parameters.iter().zip(&clean.result.parameters) {
            if with.status == Status::Identified && without.status == Status::Identified {
                let sd = without.sd.unwrap();
                assert!((with.correction - without.correction).abs() < sd, "seed {seed}: {}", with.name);
            }
        }
    }
}

/// By default cross-validation needs three lengths for each parameter.
#[test]
fn cross_validation_needs_enough_lengths() {
    let circles = three_planes(1, CENTRE);
    let asked: Vec<ParamId> = DESIGNED.iter().map(|(name, _)| name.parse().unwrap()).collect();
    let enough = 3 * asked.len();
    for (lengths, folds, held_out) in [
        (enough, None, Some(5)),
        (enough - 1, None, None),
        (enough - 1, Some(4), Some(4)),
        (enough, Some(0), None),
    ] {
        let mut data = measure(&with_errors(DESIGNED), &circles, 27, 25.0);
        // From all circles.
        data.rows = (0..lengths).map(|at| data.rows[at * data.rows.len() / lengths].clone()).collect();
        let options = Options { estimate: Some(asked.clone()), folds, ..Options::default() };
        let found = find(&kr60(), &data, &balls(&circles), &options);
        assert_eq!(found.result.folds.map(|folds| folds.folds), held_out, "{lengths} lengths, {folds:?}");
    }
}
