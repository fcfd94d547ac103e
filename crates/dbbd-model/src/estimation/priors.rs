//! Prior standard deviations, and the limits of poor observability and of plausibility. Estimation, design and plan have no
//! other source of them.
//!
//! | parameter | prior standard deviation | reason |
//! |---|---|---|
//! | geometric | the robot's tolerance | stated by the manufacturer |
//! | gear error | the tolerance of an angle | the zero of a joint is no better |
//! | compliance | the tolerance of an angle over the greatest torque | the deflection is then as large as the tolerance |
//! | bar | its certificate, else 0.05 mm | the bar is not part of the robot |
//! | tool ball, base ball | 0.1 mm, 10 mm | measured, taught or estimated by eye; free in an estimate |

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::estimation::EstimationFinding;
use crate::robot::{AXES, ParamId, ParamUnit, Robot, RobotPosterior};

const TOOL_BALL_MM: f64 = 0.1;
const BASE_BALL_MM: f64 = 10.0;
/// A tracker and targets may be set up anywhere.
const TARGET_MM: f64 = 100.0;
const TRACKER_MM: f64 = 1000.0;
const TRACKER_RAD: f64 = 1.0;
const UNCERTIFIED_BAR_MM: f64 = 0.05;
/// Compliance of a robot without known masses, rad/(N m): one arc minute at 300 N m. It has no effect on any length.
const COMPLIANCE: f64 = 1e-6;

/// A parameter counts as identified if its standard deviation is at most so many tolerances.
pub const WEAK: f64 = 3.0;
/// A coordinate of the set-up with a larger standard deviation is better measured with a ruler.
const OPEN_TOOL_BALL_MM: f64 = 50.0;
const OPEN_BASE_BALL_MM: f64 = 500.0;
const OPEN_TURN_RAD: f64 = 0.1;
/// Corrections beyond so many standard deviations (of prior and data together) are doubted if a part of the set-up is
/// fixed, which they may compensate,
const IMPLAUSIBLE: f64 = 5.0;
/// and beyond so many in any case.
const IMPOSSIBLE: f64 = 20.0;
/// Larger corrections of base balls, of the tool ball (which is known from a drawing or from the controller) and of bars are
/// doubted.
const DISPLACED_BALL_MM: f64 = 300.0;
const DISPLACED_TOOL_MM: f64 = 20.0;
const DISPLACED_BAR_MM: f64 = 50.0;

/// The prior of a hyperparameter: log-normal about `median`.
#[derive(Clone, Copy, Debug)]
pub(super) struct HyperPrior {
    pub(super) median: f64,
    /// Standard deviation of the logarithm; `None` for a flat prior.
    pub(super) ln_sd: Option<f64>,
    pub(super) bounds: [f64; 2],
}

/// The number of hyperparameters.
pub(super) const HYPERS: usize = 9;

/// Groups of unknowns that share a variance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// First harmonic of a joint's angle, rad.
    Harmonic,
    /// Smooth function of a joint's angle, rad.
    Smooth,
    /// Half of the reversal error, rad.
    Backlash,
    /// Transmission ripple, rad.
    Ripple,
    /// Compliance, in prior standard deviations.
    Compliance,
}

impl Group {
    pub const ALL: [Self; 5] = [Self::Harmonic, Self::Smooth, Self::Backlash, Self::Ripple, Self::Compliance];

    pub fn name(self) -> &'static str {
        match self {
            Self::Harmonic => "harmonic",
            Self::Smooth => "smooth",
            Self::Backlash => "backlash",
            Self::Ripple => "ripple",
            Self::Compliance => "compliance",
        }
    }
}

impl HyperPrior {
    /// Indices of the hyperparameters that are not the standard deviation of a group: the length scale of the smooth function,
    /// rad; the noise, mm; standard deviation and length scale of the slow part of the smooth function, rad.
    pub(super) const LENGTH: usize = 5;
    pub(super) const SIGMA: usize = 6;
    pub(super) const SLOW: usize = 7;
    pub(super) const SLOW_LENGTH: usize = 8;
    /// Those of the groups in their order, then the others. Typical of industrial joints: an eccentricity of half a
    /// milliradian, the other errors a fifth of it and less.
    pub(super) const ALL: [Self; HYPERS] = [
        Self { median: 5e-4, ln_sd: Some(1.0), bounds: [1e-8, 1e-1] },
        Self { median: 1e-4, ln_sd: Some(1.0), bounds: [1e-8, 1e-1] },
        Self { median: 3e-5, ln_sd: Some(1.0), bounds: [1e-8, 1e-1] },
        Self { median: 2e-5, ln_sd: Some(0.7), bounds: [1e-8, 1e-1] },
        Self { median: 1.0, ln_sd: Some(1.0), bounds: [1e-4, 1e4] },
        Self { median: 0.15, ln_sd: Some(1.0), bounds: [0.03, 3.0] },
        Self { median: 0.03, ln_sd: None, bounds: [1e-9, 1e3] },
        Self { median: 1e-4, ln_sd: Some(1.0), bounds: [1e-8, 1e-1] },
        Self { median: 0.5, ln_sd: Some(1.0), bounds: [0.3, 5.0] },
    ];

    /// The normal deviate of a logarithm; 0 for a flat prior.
    pub(super) fn off(self, ln: f64) -> f64 {
        self.ln_sd.map_or(0.0, |sd| (ln - self.median.ln()) / sd)
    }
}

/// The prior on the robot that the user chose.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Prior {
    #[default]
    None,
    /// The tolerance in the robot's file.
    Datasheet,
    /// Standard deviations of some parameters; the datasheet's of the rest.
    Given(BTreeMap<ParamId, f64>),
    /// The posterior of an earlier identification; the datasheet's of the rest.
    Posterior,
}

impl Prior {
    /// The default prior for so many lengths: the posterior in the robot's file if there is one. `known` counts those of the
    /// lengths that are in it already. The finding says why a posterior is not used.
    ///
    /// # Errors
    /// Those of `known`.
    pub fn continued<E>(
        robot: &Robot,
        lengths: usize,
        known: impl FnOnce() -> Result<usize, E>,
    ) -> Result<(Self, Option<EstimationFinding>), E> {
        let lost = match &robot.posterior {
            Some(posterior) if posterior.is_of(&robot.geometry) => {
                let known = known()?;
                if 2 * known <= lengths {
                    return Ok((Self::Posterior, None));
                }
                Some(EstimationFinding::KnownLengths { known, lengths })
            }
            Some(_) => Some(EstimationFinding::PosteriorOfOtherValues),
            None => robot.nominal.as_ref().map(|_| EstimationFinding::PosteriorLost),
        };
        Ok((Self::None, lost))
    }
}

/// Prior standard deviations and limits for one robot, bar and choice of the user.
#[derive(Clone, Debug)]
pub struct Priors {
    length_mm: f64,
    angle_rad: f64,
    greatest_torques: [f64; AXES],
    bar_u_mm: Option<f64>,
    given: BTreeMap<ParamId, f64>,
    posterior: Option<RobotPosterior>,
    /// Factor on the standard deviations of the robot's parameters.
    scale: f64,
}

impl Priors {
    /// From the robot's tolerance and the standard uncertainty of the bar's length by its certificate, mm.
    pub fn datasheet(robot: &Robot, bar_u_mm: Option<f64>) -> Self {
        Self {
            length_mm: robot.tolerance.length_mm,
            angle_rad: robot.tolerance.angle_deg.to_radians(),
            greatest_torques: robot.geometry.greatest_torques(),
            bar_u_mm,
            given: BTreeMap::new(),
            posterior: None,
            scale: 1.0,
        }
    }

    /// As [`Self::datasheet`], with the `prior` of the user.
    pub fn of(robot: &Robot, bar_u_mm: Option<f64>, prior: &Prior) -> Self {
        let given = if let Prior::Given(given) = prior { given.clone() } else { BTreeMap::new() };
        let posterior = robot.posterior.clone().filter(|_| *prior == Prior::Posterior);
        Self { given, posterior, ..Self::datasheet(robot, bar_u_mm) }
    }

    /// With all standard deviations of the robot multiplied.
    pub(super) fn widened(self, factor: f64) -> Self {
        Self { scale: self.scale * factor, ..self }
    }

    pub(super) fn scale(&self) -> f64 {
        self.scale
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
        let block = posterior.root_of(&own) * self.scale;
        for (row, &at) in places.iter().enumerate() {
            root[(at, at)] = 0.0;
            places[..=row].iter().enumerate().for_each(|(column, &to)| root[(at, to)] = block[(row, column)]);
        }
        root
    }

    /// The prior standard deviation, mm, rad or rad/(N m).
    pub fn sd(&self, id: ParamId) -> f64 {
        self.robot_or_bar(id).unwrap_or(match id {
            ParamId::Tool(_) => TOOL_BALL_MM,
            ParamId::Ball(..) => BASE_BALL_MM,
            ParamId::Target(..) => TARGET_MM,
            ParamId::Tracker(_) => TRACKER_MM,
            ParamId::TrackerTurn(_) => TRACKER_RAD,
            ParamId::Compliance(_) => COMPLIANCE,
            _ => UNCERTIFIED_BAR_MM,
        })
    }

    /// The standard deviation of a parameter that the prior binds; `None` for free parameters: balls, and a bar without
    /// certificate unless it is among the `undetermined` ones.
    pub fn bound(&self, id: ParamId, undetermined: &[ParamId]) -> Option<f64> {
        self.robot_or_bar(id).or_else(|| undetermined.contains(&id).then_some(UNCERTIFIED_BAR_MM))
    }

    /// Standard uncertainty of the length of a bar with or without a certificate, mm.
    pub fn certified_bar_mm(u_mm: Option<f64>) -> f64 {
        u_mm.unwrap_or(UNCERTIFIED_BAR_MM)
    }

    fn robot_or_bar(&self, id: ParamId) -> Option<f64> {
        let given = self.given.get(&id).copied();
        let posterior = || self.posterior.as_ref()?.sd(id);
        let by_prior = given.or_else(posterior).or_else(|| self.geometric(id)).or_else(|| self.optional(id));
        let bar = || self.bar_u_mm.filter(|_| matches!(id, ParamId::BarOffset(_)));
        by_prior.map(|sd| self.scale * sd).or_else(bar)
    }

    /// The manufacturer's tolerance of a geometric parameter, independent of the user's prior.
    pub fn geometric(&self, id: ParamId) -> Option<f64> {
        id.is_geometric().then(|| if id.unit() == ParamUnit::Mm { self.length_mm } else { self.angle_rad })
    }

    fn optional(&self, id: ParamId) -> Option<f64> {
        match id {
            ParamId::GearCos(_) | ParamId::GearSin(_) => Some(self.angle_rad),
            ParamId::Compliance(j) => Some(self.angle_rad / self.greatest_torques[j.index()])
                .filter(|compliance| compliance.is_finite()),
            _ => None,
        }
    }

    /// The tolerance of a parameter, independent of the user's prior; `None` for balls.
    fn tolerance(&self, id: ParamId) -> Option<f64> {
        match id {
            ParamId::BarOffset(_) => Some(Self::certified_bar_mm(self.bar_u_mm)),
            _ => self.geometric(id).or_else(|| self.optional(id)),
        }
    }

    /// The largest standard deviation with which a parameter counts as identified; infinite for balls.
    pub fn weak_limit(&self, id: ParamId) -> f64 {
        self.tolerance(id).map_or(f64::INFINITY, |sd| WEAK * sd)
    }

    /// The standard deviation of the error of a fixed parameter; 0 for optional ones.
    pub fn fixed_sd(&self, id: ParamId) -> f64 {
        self.tolerance(id).filter(|_| !id.is_optional()).unwrap_or(0.0)
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

/// Corrections beyond so many prior standard deviations are doubted.
pub fn largest_plausible(set_up_is_fixed: bool) -> f64 {
    if set_up_is_fixed { IMPLAUSIBLE } else { IMPOSSIBLE }
}

/// The largest standard deviation with which a place of the set-up is estimated, mm or rad.
pub fn open_limit(id: ParamId) -> f64 {
    match id {
        ParamId::Tool(_) | ParamId::Target(..) => OPEN_TOOL_BALL_MM,
        ParamId::TrackerTurn(_) => OPEN_TURN_RAD,
        _ => OPEN_BASE_BALL_MM,
    }
}

/// The largest plausible correction of the set-up, mm; `None` for parameters of the robot.
pub fn largest_displacement_mm(id: ParamId) -> Option<f64> {
    match id {
        ParamId::Tool(_) => Some(DISPLACED_TOOL_MM),
        ParamId::Ball(..) => Some(DISPLACED_BALL_MM),
        ParamId::BarOffset(_) => Some(DISPLACED_BAR_MM),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{BarId, Coordinate, Joint};

    fn priors(bar_u_mm: Option<f64>, prior: Prior) -> Priors {
        let robot = Robot::by_name("kr60ha").unwrap().unwrap();
        Priors::of(&robot, bar_u_mm, &prior)
    }

    #[test]
    fn a_bar_has_its_certificate_or_the_default() {
        let bar = ParamId::BarOffset(BarId::FIRST);
        for (u, sd) in [(None, UNCERTIFIED_BAR_MM), (Some(0.002), 0.002)] {
            let priors = priors(u, Prior::None);
            for found in [priors.sd(bar), priors.weak_limit(bar) / WEAK, priors.fixed_sd(bar)] {
                assert!((found - sd).abs() < 1e-15, "{found}");
            }
            assert_eq!(priors.bound(bar, &[]), u);
            assert_eq!(priors.bound(bar, &[bar]), Some(sd));
        }
    }

    #[test]
    fn a_wider_prior_does_not_change_the_limits() {
        let given = Prior::Given(BTreeMap::from([(ParamId::A(Joint::J3), 0.1)]));
        let priors = priors(None, given).widened(2.0);
        assert_eq!([priors.sd(ParamId::A(Joint::J3)), priors.sd(ParamId::A(Joint::J2))], [0.2, 1.0]);
        assert_eq!(priors.weak_limit(ParamId::A(Joint::J3)), 1.5);
        assert_eq!(priors.weak_limit(ParamId::Tool(Coordinate::X)), f64::INFINITY);
    }

    #[test]
    fn prior_of_compliance_follows_from_the_greatest_torque() {
        let mut robot = Robot::by_name("kr60ha").unwrap().unwrap();
        let id = ParamId::Compliance(Joint::J2);
        assert_eq!(Priors::datasheet(&robot, None).bound(id, &[]), None);
        robot.geometry.masses =
            vec![crate::robot::Mass { joint: Joint::J2, kg: 100.0, centre: nalgebra::Vector3::x() * 500.0 }];
        let torque = robot.geometry.greatest_torques()[1];
        assert_eq!(Priors::datasheet(&robot, None).sd(id), 0.05f64.to_radians() / torque);
    }
}
