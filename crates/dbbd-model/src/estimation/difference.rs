//! The difference of the predictions of two estimates of one robot, and what their uncertainties let expect of it.
//!
//! A robot that did not change has one true position. Two estimates of it differ by their errors, M1 z1 and M2 z2 with
//! unit normal z, where M is the displacement by each column of the root of an estimate's covariance, and by what each has
//! beside its root: errors of the joints at angles that it did not measure and scatter that it does not explain. These
//! count as independent, which lets expect more. The repeatability of a pose is in neither prediction.

use nalgebra::{DMatrix, DVector, Vector3};
use serde::Serialize;

use super::position::{Positions, displacement, unit_draws};
use super::workspace::ErrorSummary;
use crate::math::{Svd, svd};
use crate::measurement::ApproachedPose;
use crate::robot::{ParamId, Robot, RobotUncertainty};

/// Drawn pairs of estimates of a robot that did not change.
const PAIRS: usize = 1000;
/// Seeds of what the poses of each estimate have by themselves.
const FIRST_SEED: u64 = 3;
const LATER_SEED: u64 = 4;
/// A column that moves the tool ball by less than this share of the largest one is not determined by displacements.
const DETERMINED: f64 = 1e-9;

/// What two estimates of one robot rest on together.
#[derive(Clone, Debug, PartialEq)]
pub enum CommonKnowledge {
    /// Nothing: their errors are independent.
    Nothing,
    /// The same prior of independent parameters, with its standard deviation in each estimate, mm or rad. With its
    /// precision W the errors of posteriors with the covariances C1 and C2 have the covariance C1 W C2: the error of the
    /// prior, of which each estimate keeps the part C W, is in both, and the noise of the lengths is independent.
    Prior(Vec<(ParamId, [f64; 2])>),
    /// The posterior of the first is the prior of the later one, that is W = C1^-1: what the later lengths change has the
    /// covariance C1 - C2. The months between count as no change.
    Earlier,
}

/// The change of the predicted position from one estimate of a robot to another, after the best rigid alignment.
pub struct PredictedDifference {
    /// The tool ball by the first estimate, mm.
    pub balls: Vec<Vector3<f64>>,
    /// 3 rows for each pose, mm.
    pub moved: DVector<f64>,
    /// The differences of estimates of a robot that did not change, a column each, mm.
    unchanged: DMatrix<f64>,
}

/// The difference that the uncertainties of two estimates let expect of a robot that did not change, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExpectedDifference {
    #[serde(flatten)]
    pub summary: ErrorSummary,
    /// Standard deviation of the difference: root mean square over the poses.
    pub sd: f64,
    /// Probability that the mean difference of a robot that did not change is as large as the one found.
    pub p: f64,
}

impl PredictedDifference {
    /// From `first` to `later` at poses. Both robots have the same tool point and payload.
    pub fn of(first: &Robot, later: &Robot, common: &CommonKnowledge, poses: &[ApproachedPose]) -> Self {
        let [of_first, of_later] = [first, later].map(Robot::known_uncertainty);
        let [one, two] = [(first, &of_first), (later, &of_later)]
            .map(|(robot, unknown)| Positions::new(&robot.geometry, unknown, poses));
        let coupling = coupling(common, [&of_first, &of_later], [one.by_column(), two.by_column()]);
        let columns = one.by_column().ncols();
        let drawn = unit_draws(columns + two.by_column().ncols(), PAIRS);
        let of_first = drawn.rows(0, columns).into_owned();
        let of_later = drawn.rows(columns, two.by_column().ncols()).into_owned();
        let of_later = correlated(&coupling, &of_first, of_later);
        let unchanged = two.of_numbers(&of_later, LATER_SEED) - one.of_numbers(&of_first, FIRST_SEED);
        Self { moved: displacement(&one.balls, &two.balls), balls: one.balls, unchanged }
    }

    /// What the uncertainties let expect without a change. The probability is that of a test by draws, which counts the
    /// difference itself as one of them (Phipson and Smyth, Stat. Appl. Genet. Mol. Biol. 9, 39, 2010).
    pub fn expected(&self) -> ExpectedDifference {
        let mean = |column: DVector<f64>| ErrorSummary::of(&DMatrix::from_columns(&[column])).mean;
        let found = mean(self.moved.clone());
        let pairs = self.unchanged.column_iter();
        let as_large = pairs.filter(|pair| mean(pair.clone_owned()) >= found).count();
        ExpectedDifference {
            summary: ErrorSummary::of(&self.unchanged),
            sd: (3.0 * self.unchanged.norm_squared() / self.unchanged.len().max(1) as f64).sqrt(),
            p: (as_large + 1) as f64 / (self.unchanged.ncols() + 1) as f64,
        }
    }
}

/// The covariance of the unit normal numbers of two estimates, a row for each column of the first root.
fn coupling(
    common: &CommonKnowledge,
    unknown: [&RobotUncertainty; 2],
    [first, later]: [&DMatrix<f64>; 2],
) -> DMatrix<f64> {
    let nothing = DMatrix::zeros(first.ncols(), later.ncols());
    match common {
        CommonKnowledge::Nothing => nothing,
        CommonKnowledge::Prior(parameters) => {
            let mut coupling = nothing;
            for (id, sds) in parameters {
                let row = |at: usize| {
                    let RobotUncertainty { parameters, root, .. } = unknown[at];
                    let row = parameters.iter().position(|own| own == id)?;
                    // Uncertainties of the payload follow the columns of the root.
                    let columns = [first, later][at].ncols();
                    Some((root.row(row) / sds[at]).resize_horizontally(columns, 0.0))
                };
                if let Some((one, two)) = row(0).zip(row(1)) {
                    coupling += one.transpose() * two;
                }
            }
            coupling
        }
        CommonKnowledge::Earlier => coupling_by_displacements(first, later).unwrap_or(nothing),
    }
}

/// The coupling K with the least |M1 K - M2|: where M2 M2' <= M1 M1', the difference has the covariance M1 M1' - M2 M2'.
fn coupling_by_displacements(first: &DMatrix<f64>, later: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let Svd { values, v } = svd(&first.clone().qr().r())?;
    let least = DETERMINED * values.iter().copied().fold(0.0, f64::max);
    let kept: Vec<usize> = (0..values.len()).filter(|at| values[*at] > least).collect();
    let directions = v.select_columns(&kept);
    let mut along = (first * &directions).tr_mul(later);
    for (mut row, at) in along.row_iter_mut().zip(kept) {
        row /= values[at] * values[at];
    }
    Some(directions * along)
}

/// Unit normal numbers that have the covariance `coupling` with those of the first estimate, from independent ones. No
/// correlation exceeds 1: a root in few columns keeps the coupling only nearly.
fn correlated(coupling: &DMatrix<f64>, first: &DMatrix<f64>, independent: DMatrix<f64>) -> DMatrix<f64> {
    let Some(Svd { values, v }) = svd(coupling) else { return independent };
    let along = (coupling * &v).tr_mul(first);
    let mut mixed = v.tr_mul(&independent);
    for (at, value) in values.iter().enumerate().filter(|(_, value)| **value > 0.0) {
        let shared = value.min(1.0);
        let own = mixed.row(at) * (1.0 - shared * shared).sqrt();
        mixed.set_row(at, &(along.row(at) * (shared / value) + own));
    }
    v * mixed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Workspace;
    use crate::robot::Joint;

    const ARM: ParamId = ParamId::A(Joint::J3);

    /// A robot whose second arm is known to `sd_mm`.
    fn known_to(sd_mm: f64) -> Robot {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let unknown = RobotUncertainty {
            parameters: vec![ARM],
            root: DMatrix::from_element(1, 1, sd_mm),
            pose_mm: 0.3,
            ..robot.known_uncertainty()
        };
        robot.uncertainty = Some(Box::new(unknown));
        robot
    }

    fn poses(robot: &Robot) -> Vec<ApproachedPose> {
        Workspace::uniform(robot, 60, 4).iter().map(ApproachedPose::unapproached).collect()
    }

    /// The standard deviation of the difference in units of the effect of 1 mm on the position.
    fn sd_by_arm(first: f64, later: f64, common: &CommonKnowledge) -> f64 {
        let (one, two, unit) = (known_to(first), known_to(later), known_to(1.0));
        let poses = poses(&one);
        let effect = Positions::new(&unit.geometry, &unit.known_uncertainty(), &poses);
        let effect = (effect.by_column().norm_squared() / poses.len() as f64).sqrt();
        PredictedDifference::of(&one, &two, common, &poses).expected().sd / effect
    }

    /// A length known to p before, and to s1 and s2 by its lengths: C = 1 / (1/p^2 + 1/s^2). The difference has the variance
    /// C1^2/s1^2 + C2^2/s2^2 + (C1 - C2)^2/p^2: the noises, and the parts of the prior's error that are not alike.
    #[test]
    fn estimates_share_the_error_of_their_prior() {
        for (p, s1, s2) in [(1.0, 1.0, 1.0), (0.5, 0.2, 2.0), (1.0, 50.0, 50.0), (10.0, 0.1, 0.2)] {
            let [c1, c2] = [s1, s2].map(|s: f64| 1.0 / (1.0 / (p * p) + 1.0 / (s * s)));
            let variance = (c1 / s1).powi(2) + (c2 / s2).powi(2) + ((c1 - c2) / p).powi(2);
            let common = CommonKnowledge::Prior(vec![(ARM, [p, p])]);
            let found = sd_by_arm(c1.sqrt(), c2.sqrt(), &common);
            assert!((found / f64::sqrt(variance) - 1.0).abs() < 1e-9, "{p} {s1} {s2}: {found} {variance}");
            let independent = sd_by_arm(c1.sqrt(), c2.sqrt(), &CommonKnowledge::Nothing);
            assert!((independent / (c1 + c2).sqrt() - 1.0).abs() < 1e-9, "{independent}");
        }
    }

    /// The step of an update has the variance that it takes away: 0.5^2 - 0.3^2 = 0.4^2.
    #[test]
    fn an_update_moves_by_what_it_learns() {
        let found = sd_by_arm(0.5, 0.3, &CommonKnowledge::Earlier);
        assert!((found / 0.4 - 1.0).abs() < 1e-9, "{found}");
    }

    /// Without a change every difference is as large as none; a change of ten standard deviations is larger than all of 1000, so
    /// that p is 1 / 1001.
    #[test]
    fn only_a_difference_beyond_the_uncertainties_is_improbable() {
        let (one, mut two) = (known_to(0.1), known_to(0.1));
        let poses = poses(&one);
        let p =
            |two: &Robot| PredictedDifference::of(&one, two, &CommonKnowledge::Nothing, &poses).expected().p;
        assert_eq!(p(&two), 1.0);
        *two.geometry.value_mut(ARM).unwrap() += 0.1;
        assert!((0.3..0.7).contains(&p(&two)), "{}", p(&two));
        *two.geometry.value_mut(ARM).unwrap() += 1.3;
        assert!((p(&two) - 1.0 / 1001.0).abs() < 1e-15);
    }
}
