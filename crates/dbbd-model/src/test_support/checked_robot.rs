//! A robot whose calibration is checked later.

use dbbd_model::estimation::{CompletedCalibration, Options, Workspace};
use dbbd_model::measurement::{BaseBall, Measurements};
use dbbd_model::robot::{BallId, Robot};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::cell::{CENTRE, DESIGNED, calibrated, kr60, measure, three_planes, with_errors};

pub(crate) const SIGMA: f64 = 0.01;
pub(crate) const SECOND: [f64; 3] = [1000.0, 600.0, 500.0];
pub(crate) fn normal(random: &mut Pcg64) -> f64 {
    StandardNormal.sample(random)
}

/// A calibration from two balls, and its lengths.
pub(crate) fn calibrated_from_two_balls() -> (CompletedCalibration, Measurements) {
    let circles = [three_planes(1, CENTRE), three_planes(2, SECOND)].concat();
    let mut data = measure(&with_errors(DESIGNED), &circles, 27, 40.0);
    let mut random = Pcg64::seed_from_u64(5);
    data.rows.iter_mut().for_each(|row| row.length_mm += SIGMA * normal(&mut random));
    let balls: Vec<BaseBall> = [CENTRE, SECOND]
        .into_iter()
        .enumerate()
        .map(|(at, place)| BaseBall { id: BallId::at(at), position: place.into() })
        .collect();
    let options = Options {
        sigma_mm: Some(SIGMA),
        folds: Some(0),
        bar_u_mm: Some(0.005),
        workspace: Some(Workspace::uniform(&kr60(), 50, 1)),
        ..Options::default()
    };
    (calibrated(&kr60(), &data, &balls, &options).unwrap(), data)
}

pub(crate) fn calibration() -> Robot {
    calibrated_from_two_balls().0.robot
}
