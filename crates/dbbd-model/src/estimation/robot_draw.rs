//! The errors of a robot's joints before any length: drawn from the priors with which an identification begins, and as unknowns
//! by which poses are chosen.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::hyper_parameters::{Group, HyperPrior, Hypers, Variance};
use super::posterior::Posterior;
use super::priors::Priors;
use crate::robot::{
    JointErrorModel, JointErrors, JointTerm, ParamGroup, ParamId, Robot, SmoothJointError, TermKind,
    parameter,
};

/// Basis functions of a drawn smooth function: over the whole range of a joint they reach the frequencies of a process with a
/// length scale of 0.1 rad.
const FUNCTIONS: usize = 120;
/// Basis functions of each joint by which poses are chosen: with four times as many the chosen poses leave the same error.
const DESIGN_FUNCTIONS: usize = 12;
/// The interval of a drawn function is this many times as wide as the range of the axis, so that the function does not vanish at
/// its ends.
const WIDER: f64 = 1.2;

/// The robot with errors of its joints that are drawn from the priors of an identification: first their variances, then
/// harmonics, smooth functions, backlash and compliance. Its geometry stays. The same seed gives the same robot.
pub fn with_drawn_joint_errors(robot: &Robot, seed: u64) -> Robot {
    let mut random = Pcg64::seed_from_u64(seed ^ 0x6a6f_696e_7473_0000);
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let hypers = Hypers::drawn(&HyperPrior::all(1.0), &mut normal);
    let mut drawn = robot.clone();
    let sds = Priors::datasheet(robot, None);
    for id in parameter::optional() {
        let error = if id.group() == ParamGroup::Compliance {
            sds.sd(id) * hypers.sd(Group::Compliance) * normal().abs()
        } else {
            hypers.sd(Group::Harmonic) * normal()
        };
        if let Some(value) = drawn.geometry.value_mut(id) {
            *value += error;
        }
    }
    let errors = smooth_errors(robot, FUNCTIONS);
    let coefficients = errors.terms().into_iter().map(|term| match term.kind {
        TermKind::Smooth { frequency } => Variance::Spectral(term.joint, frequency).sd(&hypers) * normal(),
        TermKind::Backlash => hypers.sd(Group::Backlash) * normal(),
        TermKind::Ripple { .. } => 0.0,
    });
    drawn.geometry.joint_errors = errors.with(coefficients.collect::<Vec<f64>>());
    drawn
}

/// Errors of the joints with `count` basis functions over the whole range of each axis, all zero.
fn smooth_errors(robot: &Robot, count: usize) -> JointErrors {
    let [low, high] = [0, 1]
        .map(|end| robot.geometry.coupling.joints(&robot.limits_deg.map(|limits| limits[end].to_radians())));
    let joint = |at: usize| JointErrorModel {
        smooth: SmoothJointError::new(
            0.5 * (low[at] + high[at]),
            WIDER * 0.5 * (high[at] - low[at]).abs(),
            count,
        ),
        ..JointErrorModel::default()
    };
    JointErrors::new(std::array::from_fn(joint))
}

/// The knowledge of a robot, with the errors of joints that no length has shown yet: harmonics, and smooth functions over the whole
/// range of each axis, by the medians of their priors. Backlash is left out: its sense changes from pose to pose.
pub fn with_usual_joint_errors(known: &Posterior, robot: &Robot) -> Posterior {
    with_joint_errors(known, robot, &Hypers::usual(), DESIGN_FUNCTIONS)
}

/// As [`with_usual_joint_errors`], with the mean of each variance over its prior, as robots with large errors need it, and with half
/// as many functions, for a search that asks often.
pub fn with_mean_joint_errors(known: &Posterior, robot: &Robot) -> Posterior {
    with_joint_errors(known, robot, &Hypers::root_mean_square(), DESIGN_FUNCTIONS / 2)
}

fn with_joint_errors(known: &Posterior, robot: &Robot, usual: &Hypers, functions: usize) -> Posterior {
    let harmonics: Vec<(ParamId, f64)> =
        parameter::gear().map(|id| (id, usual.sd(Group::Harmonic))).collect();
    let errors = smooth_errors(robot, functions);
    let sd = |term: JointTerm| match term.kind {
        TermKind::Smooth { frequency } => Variance::Spectral(term.joint, frequency).sd(usual),
        TermKind::Backlash | TermKind::Ripple { .. } => 0.0,
    };
    let sds: Vec<f64> = errors.terms().into_iter().map(sd).collect();
    known.with_parameters(&harmonics).with_joint_errors(errors, &sds)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::measurement::{BaseBall, LengthModel};
    use crate::robot::{Approach, BallId, Joint, ParamId};
    use crate::test_support::cell::{CENTRE, kr60};

    /// Medians of log-normal priors: the harmonics have 0.5 mrad. The smooth functions have two processes with 0.1 mrad each and the
    /// factor of a joint, whose product has a median of 0.193 mrad by 200 001 draws of Python's `random`. Of 400 robots the median of
    /// a logarithm with a standard deviation of 1 has one of 6 %.
    #[test]
    fn errors_have_the_medians_of_their_priors() {
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let robots: Vec<Robot> = (0..400).map(|seed| with_drawn_joint_errors(&kr60(), seed)).collect();
        let rms_of_gear = |robot: &Robot| {
            let squares = parameter::gear().map(|id| robot.geometry.value(id).unwrap().powi(2));
            (squares.sum::<f64>() / parameter::gear().count() as f64).sqrt()
        };
        let found = median(robots.iter().map(rms_of_gear).collect());
        assert!((found / 5e-4).ln().abs() < 0.2, "{found}");
        let rms_of_smooth = |robot: &Robot| {
            let errors = robot.geometry.joint_errors.of(Joint::J1).unwrap();
            let squares = (0..300).map(|at| errors.smooth.value(-2.5 + at as f64 / 60.0).powi(2));
            (squares.sum::<f64>() / 300.0).sqrt()
        };
        let found = median(robots.iter().map(rms_of_smooth).collect());
        assert!((found / 1.93e-4).ln().abs() < 0.25, "{found}");
        let [one, other] = [1, 2].map(|seed| with_drawn_joint_errors(&kr60(), seed));
        assert_eq!(one, with_drawn_joint_errors(&kr60(), 1));
        let axes = [0.3, -1.0, 1.2, 0.4, 0.5, 0.1];
        let ball = |robot: &Robot| robot.geometry.approached(Approach::new([1; 6])).ball(&axes).position;
        assert!((ball(&one) - ball(&other)).norm() > 0.01);
        assert_eq!(one.geometry.value(ParamId::A(Joint::J2)), kr60().geometry.value(ParamId::A(Joint::J2)));
    }

    /// Where only the joints err, a length has the squares of its derivatives by the angles times the variance of a joint: half a
    /// milliradian of the harmonic (a sine and a cosine at any angle), 0.1 mrad of each of two smooth processes. Twelve functions
    /// leave out the quickest part of a smooth process, at most half of its variance.
    #[test]
    fn unknown_errors_of_joints_move_a_length_by_their_prior() {
        let robot = kr60();
        let ball = BaseBall { id: BallId::FIRST, position: Vector3::from(CENTRE) };
        let nothing = Posterior::new(LengthModel::new(robot.geometry.clone(), &[ball]), &[], &[]);
        let known = with_usual_joint_errors(&nothing, &robot);
        let axes = [0.2, -1.1, 1.4, 0.5, 0.8, -0.3];
        let row = robot.geometry.length_row(&axes, &Vector3::from(CENTRE), 0.0);
        let arms: f64 = row.by_joint().iter().map(|by| by * by).sum();
        let variance = known.design_row(&axes, BallId::FIRST).norm_squared() / arms;
        let [harmonic, smooth] = [2.5e-7, 2.0 * 1e-8];
        assert!((harmonic + 0.5 * smooth..harmonic + 1.05 * smooth).contains(&variance), "{variance}");
    }
}
