//! Prior standard deviations, and the limits of poor observability and of plausibility. Estimation, design and plan
//! have no other source for them. The table of the parameters (`robot/parameter.rs`) states which rule each parameter
//! follows. Here the rules become numbers for one robot, one bar and the prior that the user chose.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::estimation::EstimationFinding;
use crate::measurement::are_lengths_known;
use crate::robot::{AXES, BarId, ParamGroup, ParamId, PriorRule, Robot, RobotPosterior};

/// A parameter counts as identified if its standard deviation is at most this number of tolerances.
pub const WEAK: f64 = 3.0;
/// Corrections beyond this number of standard deviations (of prior and data together) get a warning if a part of the
/// set-up is fixed, which they may compensate,
const IMPLAUSIBLE: f64 = 5.0;
/// and beyond this number in any case.
const IMPOSSIBLE: f64 = 20.0;
/// Standard deviation that stands for a free coordinate of a base ball, mm.
pub(crate) const FREE_BALL_MM: f64 = 1000.0;
/// A joint deflects by about this angle under the greatest torque of gravity: 2 to 6e-7 rad/(N m) for an arm that
/// carries 60 kg.
const DEFLECTION_RAD: f64 = 4e-4;
/// Relative standard deviation of masses that follow from the size of an arm, and of masses that its maker states.
const ASSUMED_MASS_ERROR: f64 = 0.5;
const STATED_MASS_ERROR: f64 = 0.1;

/// The prior on the robot that the user chose.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Prior {
    /// No prior, except in the directions that the data determine worse than three tolerances.
    None,
    /// The tolerance in the robot's file.
    #[default]
    Datasheet,
    /// Standard deviations of some parameters; the datasheet's for the rest.
    Given(BTreeMap<ParamId, f64>),
    /// The posterior of an earlier identification; the datasheet's prior for the rest.
    Posterior,
}

impl Prior {
    /// The default prior for this number of lengths: the posterior in the robot's file if there is one. `known` counts
    /// the lengths that are already in that posterior. The finding says why a posterior is not used.
    ///
    /// # Errors
    /// The errors of `known`.
    pub fn continued<E>(
        robot: &Robot,
        lengths: usize,
        known: impl FnOnce() -> Result<usize, E>,
    ) -> Result<(Self, Option<EstimationFinding>), E> {
        let lost = match &robot.posterior {
            Some(posterior) if posterior.is_of(&robot.geometry) => {
                return Ok(Self::Posterior.of_other_lengths(lengths, known()?));
            }
            Some(_) => Some(EstimationFinding::PosteriorOfOtherValues),
            None => robot.nominal.as_ref().map(|_| EstimationFinding::PosteriorLost),
        };
        Ok((Self::Datasheet, lost))
    }

    /// This prior, unless so many of the lengths are among the `known` ones from which it was identified that these would
    /// count twice; then the datasheet's.
    pub fn of_other_lengths(self, lengths: usize, known: usize) -> (Self, Option<EstimationFinding>) {
        match are_lengths_known(known, lengths) {
            true => (Self::Datasheet, Some(EstimationFinding::KnownLengths { known, lengths })),
            false => (self, None),
        }
    }
}

/// Prior standard deviations and limits for one robot, bar and choice of the user.
#[derive(Clone, Debug)]
pub struct Priors {
    length_mm: f64,
    angle_rad: f64,
    flange_mm: f64,
    flange_rad: f64,
    greatest_torques: [f64; AXES],
    /// Relative standard deviation of the masses of the links.
    mass_error: f64,
    bar_u_mm: Option<f64>,
    /// Standard uncertainty of each coordinate of the tool ball on the flange, mm.
    ball_u_mm: f64,
    given: BTreeMap<ParamId, f64>,
    posterior: Option<RobotPosterior>,
}

impl Priors {
    /// The priors from the robot's tolerance and the standard uncertainty of the bar's length in its certificate, mm.
    pub fn datasheet(robot: &Robot, bar_u_mm: Option<f64>) -> Self {
        Self {
            length_mm: robot.tolerance.length_mm,
            angle_rad: robot.tolerance.angle_deg.to_radians(),
            flange_mm: robot.tolerance.flange_prior_mm(),
            flange_rad: robot.tolerance.flange_prior_rad(),
            greatest_torques: robot.geometry.greatest_torques(),
            mass_error: if robot.geometry.load.is_assumed { ASSUMED_MASS_ERROR } else { STATED_MASS_ERROR },
            bar_u_mm,
            ball_u_mm: robot.ball_u_mm,
            given: BTreeMap::new(),
            posterior: None,
        }
    }

    /// As [`Self::datasheet`], with the `prior` of the user.
    pub fn of(robot: &Robot, bar_u_mm: Option<f64>, prior: &Prior) -> Self {
        let given = if let Prior::Given(given) = prior { given.clone() } else { BTreeMap::new() };
        let posterior = robot.posterior.clone().filter(|_| *prior == Prior::Posterior);
        Self { given, posterior, ..Self::datasheet(robot, bar_u_mm) }
    }

    /// Whether the posterior of an earlier identification contains the parameter.
    pub(super) fn is_of_posterior(&self, id: ParamId) -> bool {
        self.posterior.as_ref().is_some_and(|posterior| posterior.ids().contains(&id))
    }

    /// The root of the prior covariance of `ids`, square and lower triangular: standard deviations `sd`, and the block of the
    /// posterior of an earlier identification.
    pub fn root(&self, ids: &[ParamId], sd: &[f64]) -> DMatrix<f64> {
        let mut root = DMatrix::from_diagonal(&DVector::from_column_slice(sd));
        let Some(posterior) = &self.posterior else { return root };
        let places: Vec<usize> = (0..ids.len()).filter(|&at| posterior.ids().contains(&ids[at])).collect();
        let own: Vec<ParamId> = places.iter().map(|&at| ids[at]).collect();
        let block = posterior.root_of(&own);
        for (row, &at) in places.iter().enumerate() {
            root[(at, at)] = 0.0;
            places[..=row].iter().enumerate().for_each(|(column, &to)| root[(at, to)] = block[(row, column)]);
        }
        root
    }

    /// The prior standard deviation, mm, rad or rad/(N m).
    pub fn sd(&self, id: ParamId) -> f64 {
        self.robot_or_bar(id).unwrap_or_else(|| Self::unbound(id))
    }

    /// The standard deviation of a parameter that the prior binds: the robot, its tool ball and bars; `None` for base balls,
    /// targets and trackers, which are free.
    pub fn bound(&self, id: ParamId) -> Option<f64> {
        match id.group() {
            ParamGroup::Balls | ParamGroup::Targets | ParamGroup::Tracker => self.robot_or_bar(id),
            ParamGroup::Tool => Some(self.robot_or_bar(id).unwrap_or(self.ball_u_mm)),
            ParamGroup::Bar | ParamGroup::Geometric | ParamGroup::Compliance | ParamGroup::Gear => {
                Some(self.sd(id))
            }
        }
    }

    /// As [`Self::bound`], at the start of a fit: a bar without a certificate may have any length near the stated one.
    pub(super) fn bound_at_start(&self, id: ParamId) -> Option<f64> {
        if matches!(id, ParamId::BarOffset(_)) && !self.is_certified() {
            Some(FAR_BAR_MM)
        } else if matches!(id, ParamId::Tool(_)) && !self.is_of_posterior(id) {
            Some(FAR_TOOL_MM)
        } else {
            self.bound(id)
        }
    }

    /// Whether the standard uncertainty of the bars is known.
    pub(super) fn is_certified(&self) -> bool {
        self.bar_u_mm.is_some()
    }

    /// Standard uncertainty of the length of a bar with or without a certificate, mm.
    pub fn certified_bar_mm(u_mm: Option<f64>) -> f64 {
        u_mm.unwrap_or_else(|| Self::unbound(ParamId::BarOffset(BarId::FIRST)))
    }

    /// The standard deviation of a parameter that neither a tolerance nor a certificate binds; infinite for parameters
    /// that a tolerance always binds.
    fn unbound(id: ParamId) -> f64 {
        match id.prior() {
            PriorRule::Free(sd) | PriorRule::Certificate { uncertified: sd } => sd,
            PriorRule::DeflectionOverTorque(_)
            | PriorRule::MassErrorOverTorque(_)
            | PriorRule::LengthTolerance
            | PriorRule::AngleTolerance
            | PriorRule::FlangeLength
            | PriorRule::FlangeAngle => f64::INFINITY,
        }
    }

    fn robot_or_bar(&self, id: ParamId) -> Option<f64> {
        let given = self.given.get(&id).copied();
        let posterior = || self.posterior.as_ref()?.sd(id);
        let by_prior = given.or_else(posterior).or_else(|| self.of_robot(id));
        let bar = || self.bar_u_mm.filter(|_| matches!(id, ParamId::BarOffset(_)));
        by_prior.or_else(bar)
    }

    /// The manufacturer's tolerance of a parameter of the robot; `None` for the set-up.
    fn of_robot(&self, id: ParamId) -> Option<f64> {
        match id.prior() {
            PriorRule::LengthTolerance => Some(self.length_mm),
            PriorRule::AngleTolerance => Some(self.angle_rad),
            PriorRule::FlangeLength => Some(self.flange_mm),
            PriorRule::FlangeAngle => Some(self.flange_rad),
            PriorRule::DeflectionOverTorque(joint) => {
                Some(DEFLECTION_RAD / self.greatest_torques[joint.index()])
            }
            PriorRule::MassErrorOverTorque(joint) => {
                Some(self.mass_error * DEFLECTION_RAD / self.greatest_torques[joint.index()])
            }
            PriorRule::Certificate { .. } | PriorRule::Free(_) => None,
        }
    }

    /// The manufacturer's tolerance of a geometric parameter, independent of the user's prior.
    pub fn geometric(&self, id: ParamId) -> Option<f64> {
        self.of_robot(id).filter(|_| id.is_geometric())
    }

    /// The tolerance of a parameter, independent of the user's prior; `None` for balls.
    fn tolerance(&self, id: ParamId) -> Option<f64> {
        match id.prior() {
            PriorRule::Certificate { uncertified } => Some(self.bar_u_mm.unwrap_or(uncertified)),
            PriorRule::LengthTolerance
            | PriorRule::AngleTolerance
            | PriorRule::FlangeLength
            | PriorRule::FlangeAngle
            | PriorRule::DeflectionOverTorque(_)
            | PriorRule::MassErrorOverTorque(_)
            | PriorRule::Free(_) => self.of_robot(id),
        }
    }

    /// The largest standard deviation with which a parameter counts as identified; infinite for balls.
    pub fn weak_limit(&self, id: ParamId) -> f64 {
        self.tolerance(id).map_or(f64::INFINITY, |sd| WEAK * sd)
    }

    /// The manufacturer's tolerance of a length, mm.
    pub fn length_tolerance_mm(&self) -> f64 {
        self.length_mm
    }

    /// A geometric correction in standard deviations of tolerance and data together; `None` for other parameters.
    pub fn excess(&self, id: ParamId, correction: f64, sd: f64) -> Option<f64> {
        self.geometric(id).map(|tolerance| correction.abs() / tolerance.hypot(sd))
    }
}

/// The a priori standard deviation of a length, mm: of the bar, and of the robot's repeatability if it is known.
pub fn length_sd_mm(bar_mm: f64, robot: &Robot) -> f64 {
    bar_mm.hypot(robot.repeatability_sd_mm().unwrap_or(0.0))
}

/// A bar without a certificate has a prior of Student's t; at the start of a fit its standard deviation is this, mm.
pub(super) const FAR_BAR_MM: f64 = 0.5;
/// At the start of a fit a tool ball may be anywhere on the tool, mm.
const FAR_TOOL_MM: f64 = 50.0;
/// Degrees of freedom of the prior of a bar without a certificate: nobody knows how wrong such a bar is.
const BAR_FREEDOM: f64 = 4.0;

/// The variance of the normal prior that has the same weight as Student's t at an offset with this mean square, mm^2
/// (the mean weight of its representation as a normal distribution with a gamma-distributed precision). For a bar that
/// is as stated it is the variance of a bar without a certificate.
pub(super) fn uncertified_variance(mean_square: f64) -> f64 {
    Priors::certified_bar_mm(None).powi(2) + mean_square / (BAR_FREEDOM + 1.0)
}

/// Corrections beyond this number of prior standard deviations get a warning.
pub fn largest_plausible(set_up_is_fixed: bool) -> f64 {
    if set_up_is_fixed { IMPLAUSIBLE } else { IMPOSSIBLE }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{BallId, BarId, Coordinate, Joint, TargetId};

    fn priors(bar_u_mm: Option<f64>, prior: Prior) -> Priors {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        Priors::of(&robot, bar_u_mm, &prior)
    }

    #[test]
    fn a_bar_has_its_certificate_or_the_default() {
        let bar = ParamId::BarOffset(BarId::FIRST);
        for (u, sd) in [(None, 0.07), (Some(0.002), 0.002)] {
            let priors = priors(u, Prior::None);
            for found in [priors.sd(bar), priors.weak_limit(bar) / WEAK] {
                assert!((found - sd).abs() < 1e-15, "{found}");
            }
            assert_eq!(priors.bound(bar), Some(sd));
            assert_eq!(priors.bound_at_start(bar), Some(u.unwrap_or(0.5)));
        }
    }

    /// Student's t of four degrees of freedom: 0.07 mm where the offset is known to be nothing, and far away a fifth
    /// of the square of the offset.
    #[test]
    fn a_bar_without_certificate_may_be_far_off() {
        assert!((uncertified_variance(0.0) - 0.07 * 0.07).abs() < 1e-15);
        assert!((uncertified_variance(4.0) - (0.07 * 0.07 + 0.8)).abs() < 1e-12);
    }

    #[test]
    fn a_given_prior_does_not_change_the_limits() {
        let given = Prior::Given(BTreeMap::from([(ParamId::A(Joint::J3), 0.1)]));
        let priors = priors(None, given);
        assert_eq!([priors.sd(ParamId::A(Joint::J3)), priors.sd(ParamId::A(Joint::J2))], [0.1, 0.5]);
        assert_eq!(priors.weak_limit(ParamId::A(Joint::J3)), 1.5);
        assert_eq!(priors.weak_limit(ParamId::Tool(Coordinate::X)), f64::INFINITY);
    }

    #[test]
    fn prior_of_compliance_follows_from_the_greatest_torque() {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let id = ParamId::Compliance(Joint::J2);
        robot.geometry.load.masses =
            vec![crate::robot::Mass { joint: Joint::J2, kg: 100.0, centre: nalgebra::Vector3::x() * 500.0 }];
        let torque = robot.geometry.greatest_torques()[1];
        assert_eq!(Priors::datasheet(&robot, None).sd(id), 4e-4 / torque);
        // The masses of a usual arm are right to a half, stated ones to a tenth.
        let payload = ParamId::PayloadCompliance(Joint::J2);
        assert_eq!(Priors::datasheet(&robot, None).sd(payload), 0.5 * 4e-4 / torque);
        robot.geometry.load.is_assumed = false;
        assert_eq!(Priors::datasheet(&robot, None).sd(payload), 0.1 * 4e-4 / torque);
    }

    /// The tolerances of the built-in KR 60 HA are 0.5 mm and 0.05 deg.
    #[test]
    fn prior_follows_the_rule_of_the_parameter() {
        let priors = priors(None, Prior::None);
        let angle = 0.05f64.to_radians();
        for (id, sd, weak) in [
            (ParamId::Alpha(Joint::J1), angle, 3.0 * angle),
            (ParamId::A(Joint::J2), 0.5, 1.5),
            (ParamId::Theta(Joint::J5), angle, 3.0 * angle),
            // The flange is made better than the arm.
            (ParamId::Theta(Joint::J6), 0.4 * angle, 1.2 * angle),
            (ParamId::D(Joint::J6), 0.05, 0.15),
            (ParamId::D(Joint::J4), 0.5, 1.5),
            (ParamId::Beta(Joint::J3), angle, 3.0 * angle),
            (ParamId::GearCos(Joint::J1), angle, 3.0 * angle),
            (ParamId::GearSin(Joint::J6), angle, 3.0 * angle),
            (ParamId::Tool(Coordinate::X), 0.1, f64::INFINITY),
            (ParamId::Target(TargetId::at(1), Coordinate::Y), 100.0, f64::INFINITY),
            (ParamId::Ball(BallId::FIRST, Coordinate::Z), 10.0, f64::INFINITY),
            (ParamId::Tracker(Coordinate::X), 1000.0, f64::INFINITY),
            (ParamId::TrackerTurn(Coordinate::X), 1.0, f64::INFINITY),
            (ParamId::BarOffset(BarId::FIRST), 0.07, 0.21),
        ] {
            for (found, expected) in [(priors.sd(id), sd), (priors.weak_limit(id), weak)] {
                assert!(
                    found == expected || (found / expected - 1.0).abs() < 1e-12,
                    "{id}: {found} for {expected}"
                );
            }
        }
    }

    #[test]
    fn places_are_free_and_the_robot_is_bound() {
        let priors = priors(None, Prior::None);
        let (ball, tool) = (ParamId::Ball(BallId::FIRST, Coordinate::X), ParamId::Tool(Coordinate::Z));
        assert_eq!([ball, tool].map(|id| priors.bound(id)), [None, Some(0.5)]);
        assert_eq!(priors.bound(ParamId::D(Joint::J2)), Some(0.5));
        assert_eq!([ball, tool].map(|id| priors.geometric(id)), [None; 2]);
        assert_eq!(priors.geometric(ParamId::GearCos(Joint::J2)), None);
    }

    /// 0.9 / sqrt(0.5^2 + 1.2^2) = 9 / 13.
    #[test]
    fn excess_of_a_correction_is_in_deviations_of_tolerance_and_data() {
        let priors = priors(None, Prior::None);
        let found = priors.excess(ParamId::A(Joint::J2), -0.9, 1.2).unwrap();
        assert!((found - 9.0 / 13.0).abs() < 1e-15);
        assert_eq!(priors.excess(ParamId::Tool(Coordinate::X), 0.9, 1.2), None);
        assert_eq!([true, false].map(largest_plausible), [5.0, 20.0]);
    }

    /// A robot whose posterior has the root [[0.1, 0], [0.02, 0.03]] of the covariance of a1 and theta3.
    fn identified() -> Robot {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ids = [ParamId::A(Joint::J2), ParamId::Theta(Joint::J3)];
        let root = DMatrix::from_row_slice(2, 2, &[0.1, 0.0, 0.02, 0.03]);
        robot.posterior = RobotPosterior::new(&ids, &robot.geometry, &root);
        robot
    }

    #[test]
    fn root_has_the_block_of_the_posterior_among_independent_parameters() {
        let robot = identified();
        let priors = Priors::of(&robot, None, &Prior::Posterior);
        let ids = [ParamId::Theta(Joint::J3), ParamId::D(Joint::J4), ParamId::A(Joint::J2)];
        let sd = ids.map(|id| priors.sd(id));
        // (0.02^2 + 0.03^2)^(1/2), the tolerance, 0.1.
        for (found, expected) in sd.iter().zip([0.0013f64.sqrt(), 0.5, 0.1]) {
            assert!((found - expected).abs() < 1e-15, "{found}");
        }
        let root = priors.root(&ids, &sd);
        // The covariance of the posterior; d4 is independent of it.
        let expected = DMatrix::from_row_slice(3, 3, &[0.0013, 0.0, 0.002, 0.0, 0.25, 0.0, 0.002, 0.0, 0.01]);
        assert!((&root * root.transpose() - expected).norm() < 1e-15);
        assert!(priors.is_of_posterior(ids[0]) && !priors.is_of_posterior(ids[1]));
        // Without the posterior as prior the tolerances hold, and the root is diagonal.
        let datasheet = Priors::of(&robot, None, &Prior::Datasheet);
        assert_eq!(datasheet.sd(ids[2]), 0.5);
        assert_eq!(
            datasheet.root(&ids[1..], &[3.0, 4.0]),
            DMatrix::from_row_slice(2, 2, &[3.0, 0.0, 0.0, 4.0])
        );
    }

    #[test]
    fn posterior_of_an_earlier_identification_is_continued_with_new_lengths() {
        let known = |count: usize| move || Ok::<usize, ()>(count);
        let robot = identified();
        assert_eq!(Prior::continued(&robot, 100, known(20)).unwrap(), (Prior::Posterior, None));
        let (prior, finding) = Prior::continued(&robot, 100, known(21)).unwrap();
        assert_eq!(prior, Prior::Datasheet);
        assert!(matches!(finding, Some(EstimationFinding::KnownLengths { known: 21, lengths: 100 })));
        assert_eq!(Prior::continued(&robot, 100, || Err("unread")), Err("unread"));
        let mut edited = robot.clone();
        edited.geometry.rows[1].a += 1e-6;
        let (prior, finding) = Prior::continued(&edited, 100, known(0)).unwrap();
        assert_eq!(prior, Prior::Datasheet);
        assert!(matches!(finding, Some(EstimationFinding::PosteriorOfOtherValues)));
        let nominal = Robot { posterior: None, nominal: None, ..robot };
        assert_eq!(Prior::continued(&nominal, 100, known(0)).unwrap(), (Prior::Datasheet, None));
    }
}
