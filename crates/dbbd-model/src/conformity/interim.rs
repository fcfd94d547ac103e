//! The interim check of a calibrated robot: what changed, the position uncertainty now, and the decision.

use nalgebra::{DMatrix, Vector3};
use serde::Serialize;

use super::change::{ChangeTest, CheckPower, Detectable, FALSE_ALARM, Hypothesis, Innovation, POWER};
use super::decision::{ConformityDecision, DecisionRule, decide};
use super::expected::{BallMounting, Expected, Mounting};
use crate::conformity::{ConformityFinding, ConformityOutcome};
use crate::diagnostic::Names;
use crate::estimation::priors::FREE_BALL_MM;
use crate::estimation::result::MapPoint;
use crate::estimation::{
    ErrorSummary, LengthNoise, Positions, Posterior, Priors, Validity, ValidityLimit, displacement,
    fits_no_robot, largest_plausible, length_sd_mm, of_maker, tool_balls,
};
use crate::math::distributions::chi_square_tail;
use crate::measurement::{ApproachedPose, LengthModel, Measurements, PreparedMeasurement};
use crate::robot::{AXES, BallId, BarId, Coordinate, ParamId, Robot, RobotPosterior, RobotUncertainty};

/// Least number of lengths beyond those that determine the base balls.
pub const MIN_DOF: usize = 4;
/// Lengths of the nominal robot leave of it no more than so many standard deviations, as a root of the mean square: with the
/// fewest lengths that are checked in 997 of 1000 checks.
const NOMINAL_SIGMAS: f64 = 2.0;
/// Monte Carlo draws of the robot for a decision.
const DRAWS: usize = 400;
/// A hypothesis explains the innovation badly if the rest has a smaller p-value.
const BADLY_EXPLAINED: f64 = 1e-3;
/// A base ball that is farther from its calibrated position is not the same mounting, mm: positions are stated to
/// centimetres.
pub const MAX_BALL_SHIFT_MM: f64 = 50.0;
/// An innovation that is this improbably small contradicts the standard deviation of the lengths.
const TOO_GOOD: f64 = 1e-4;

#[derive(Clone, Copy)]
pub struct CheckInput<'a> {
    /// The calibrated robot with its posterior.
    pub robot: &'a Robot,
    /// Geometry of the robot, with the base balls of the check.
    pub start: &'a LengthModel,
    pub readings: &'a [PreparedMeasurement],
    pub bars: usize,
    /// Standard deviation of a length, mm: noise, repeatability and model error.
    pub sigma_mm: f64,
    pub mounting: Mounting,
    pub tolerance_mm: Option<f64>,
    pub rule: DecisionRule,
    /// Axis vectors (rad) over which the position error is evaluated.
    pub workspace: &'a [[f64; AXES]],
}

/// The standard deviation of the lengths according to the data and the robot's repeatability, mm, if either states one.
pub fn own_sigma_mm(observations: &Measurements, robot: &Robot) -> Option<f64> {
    let squares = observations.rows.iter().map(|row| row.sigma_mm.map(|sigma| sigma * sigma));
    let bar = squares.sum::<Option<f64>>().map(|sum| (sum / observations.rows.len() as f64).sqrt());
    bar.or(robot.repeatability_sd_mm().map(|_| 0.0)).map(|bar| length_sd_mm(bar, robot))
}

/// The standard deviation of the lengths of a check, mm: at least the standard deviation of the calibration, which
/// includes the model error.
pub fn sigma_mm(own: Option<f64>, of_calibration: Option<f64>) -> Result<f64, ConformityFinding> {
    let sigma_mm = own.into_iter().chain(of_calibration).reduce(f64::max);
    sigma_mm.filter(|mm| *mm > 0.0).ok_or(ConformityFinding::NoNoise)
}

#[derive(Clone, Debug, Serialize)]
pub struct InterimCheck {
    pub schema: u32,
    pub robot: String,
    pub lengths: usize,
    pub sigma_mm: f64,
    #[serde(flatten)]
    pub decision: ConformityDecision,
    pub test: ChangeTest,
    /// The probable changes, most probable first; empty if the test finds no change.
    pub changes: Vec<Hypothesis>,
    /// Probability that nothing changed.
    pub unchanged_probability: f64,
    pub predicted_position_uncertainty_mm: CheckUncertainty,
    /// For which tool, payload and time the robot file holds after a check that found no change.
    pub validity: Option<Validity>,
    pub detectable: Vec<Detectable>,
    /// The 95th percentile of the position error over the poses, for each drawn robot, ascending, mm.
    #[serde(skip)]
    pub position_errors_mm: Vec<f64>,
    /// Position uncertainty over the workspace after the check.
    #[serde(skip)]
    pub map: Vec<MapPoint>,
    #[serde(skip)]
    pub findings: Vec<ConformityFinding>,
    #[serde(skip)]
    update: Option<Robot>,
}

/// Predicted position uncertainty over the workspace, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CheckUncertainty {
    /// Uncertainty after the calibration.
    pub calibrated: ErrorSummary,
    /// Uncertainty of the robot file, after this check.
    pub now: ErrorSummary,
    /// Uncertainty of the robot that this check updates; `None` if nothing changed.
    pub updated: Option<ErrorSummary>,
}

impl CheckInput<'_> {
    pub fn check(&self) -> Result<InterimCheck, ConformityFinding> {
        let known = self.known()?;
        let expected = Expected::new(&known, self.bars, self.mounting);
        self.enough()?;
        let innovation =
            Innovation::of(&expected, self.readings, self.noise()).ok_or(ConformityFinding::NotFinite)?;
        let (test, hypotheses) = (innovation.test(), innovation.hypotheses());
        let position = CheckWorkspace::new(self, &known);
        let now = position.now(&expected, &hypotheses, self).ok_or(ConformityFinding::NotFinite)?;
        let calibrated = position.positions(&known).summary();
        let nothing = |hypothesis: &&Hypothesis| hypothesis.parameters.is_empty();
        let unchanged = hypotheses.iter().find(nothing).map_or(0.0, |hypothesis| hypothesis.probability);
        // A robot that was driven to where the nominal robot would be did not change.
        let nominal_rms_mm = if test.changed { self.nominal_rms_mm() } else { None }
            .filter(|rms_mm| *rms_mm < NOMINAL_SIGMAS * self.sigma_mm);
        let changed = test.changed && nominal_rms_mm.is_none();
        let mut changes = hypotheses;
        changes.retain(|hypothesis| changed && !hypothesis.parameters.is_empty());
        let updated = match changes.first() {
            Some(likeliest) => Some(self.updated(&expected, likeliest).ok_or(ConformityFinding::NotFinite)?),
            None => None,
        };
        let another = changes.first().and_then(|likeliest| self.another_robot(likeliest));
        let updated = updated.filter(|_| another.is_none());
        let least_mm = self.least_tolerance(&expected, &position).ok_or(ConformityFinding::NotFinite)?;
        let map = MapPoint::map(&position.calibrated, &now);
        let undecidable = self.tolerance_mm.is_some_and(|tolerance| tolerance < least_mm);
        let position_errors_mm = sizes(&now);
        let mut decision = decide(&position_errors_mm, self.tolerance_mm, self.rule, test.changed);
        // If lengths that agree with the robot would fail as well, only a change is evidence of failure.
        if undecidable && !test.changed || nominal_rms_mm.is_some() {
            decision = decision.failure_as_undecided();
        }
        if another.is_some() {
            decision = decision.nothing();
        }
        let is_undecidable =
            another.is_none() && undecidable && decision.decision == ConformityOutcome::Undecided;
        let growth = decision.growth().filter(|_| !test.changed);
        let validity = match growth {
            Some(growth) => self.validity(&expected, &known, growth, &map)?,
            None => None,
        };
        Ok(InterimCheck {
            schema: 1,
            robot: self.robot.name.clone(),
            lengths: self.readings.len(),
            sigma_mm: self.sigma_mm,
            findings: self.findings(
                is_undecidable.then_some(least_mm),
                &test,
                &changes,
                another.or(nominal_rms_mm.map(|rms_mm| ConformityFinding::DrivenAsNominal { rms_mm })),
            ),
            decision,
            test,
            position_errors_mm,
            unchanged_probability: unchanged,
            predicted_position_uncertainty_mm: CheckUncertainty {
                calibrated,
                now: ErrorSummary::of(&now),
                updated: updated.as_ref().map(|posterior| position.positions(posterior).summary()),
            },
            validity,
            detectable: innovation.detectable(),
            map,
            update: updated.and_then(|posterior| self.robot_of(&posterior, &known)),
            changes,
        })
    }

    /// The power of a check with lengths at these poses, before they are measured.
    pub fn power(&self) -> Result<CheckPower, ConformityFinding> {
        let expected = self.expected()?;
        self.enough()?;
        let foreseen = Innovation::foreseen(&expected, self.readings, self.noise());
        let position = CheckWorkspace::new(self, &self.known()?);
        let least = self.least_tolerance(&expected, &position);
        let (foreseen, least_tolerance_mm) = foreseen.zip(least).ok_or(ConformityFinding::NotFinite)?;
        Ok(CheckPower {
            lengths: self.readings.len(),
            sigma_mm: self.sigma_mm,
            false_alarm: FALSE_ALARM,
            power: POWER,
            detectable: foreseen.detectable(),
            tolerance_mm: self.tolerance_mm,
            least_tolerance_mm,
        })
    }

    /// The state of the robot before the check.
    pub fn expected(&self) -> Result<Expected, ConformityFinding> {
        Ok(Expected::new(&self.known()?, self.bars, self.mounting))
    }

    pub fn noise(&self) -> LengthNoise<'_> {
        LengthNoise::of(self.sigma_mm, self.robot.uncertainty.as_deref())
    }

    /// The model of the robot file with base balls and bar fitted to the lengths.
    pub fn set_up(&self) -> Option<LengthModel> {
        let balls = (0..self.start.balls.len()).flat_map(|ball| {
            Coordinate::ALL.map(|axis| (ParamId::Ball(BallId::at(ball), axis), FREE_BALL_MM))
        });
        let bars = (0..self.bars).map(|bar| (ParamId::BarOffset(BarId::at(bar)), self.mounting.bar_mm));
        let (ids, sd): (Vec<ParamId>, Vec<f64>) = balls.chain(bars).unzip();
        let found = Posterior::new(self.start.clone(), &ids, &sd).learn(self.readings, self.sigma_mm)?;
        Some(found.model)
    }

    /// What the lengths leave of the nominal robot with base balls and bar fitted, mm: the root of the mean square. `None` for
    /// lengths that they would explain whatever the robot is.
    fn nominal_rms_mm(&self) -> Option<f64> {
        let geometry = self.robot.nominal.as_ref()?.geometry.clone();
        let start = LengthModel { geometry, ..self.start.clone() };
        self.rms_mm(&CheckInput { start: &start, ..*self }.set_up()?)
    }

    /// The finding if the lengths are of no change of this robot: the most likely one is of a part that cannot change so far, or
    /// it explains nothing, and the lengths fit worse than the nominal robot could.
    fn another_robot(&self, likeliest: &Hypothesis) -> Option<ConformityFinding> {
        let Hypothesis { parameters, change, sd, p_rest, .. } = likeliest;
        let (priors, times) = (Priors::datasheet(self.robot, None), largest_plausible(false));
        // A zero may be lost by any angle.
        let changed = parameters.iter().zip(change).zip(sd);
        let parts = changed.filter(|((id, _), _)| !matches!(id, ParamId::Theta(_)));
        let excess = |((id, change), sd): &((&ParamId, &f64), &f64)| priors.excess(**id, **change, **sd);
        let impossible = parts.filter(|part| excess(part).is_some_and(|excess| excess > times));
        let impossible: Vec<&ParamId> = impossible.map(|((id, _), _)| id).collect();
        if !impossible.is_empty() {
            let parameters = Names::of(impossible);
            return Some(ConformityFinding::ImpossibleChange { parameters, times });
        }
        let maker = of_maker(self.robot, self.workspace);
        let residual_rms_mm = self.rms_mm(&self.set_up()?)?;
        (*p_rest < BADLY_EXPLAINED && fits_no_robot(residual_rms_mm, &maker))
            .then_some(ConformityFinding::AnotherRobot { residual_rms_mm, predicted_max_mm: maker.max })
    }

    /// What the lengths leave of a model whose base balls and bar were fitted to them, mm: the root of the mean square. `None`
    /// for lengths that it would explain whatever the robot is.
    fn rms_mm(&self, found: &LengthModel) -> Option<f64> {
        let prepared = found.prepare();
        let left = |reading: &PreparedMeasurement| (prepared.length(reading) - reading.length_mm).powi(2);
        let dof = self
            .readings
            .len()
            .checked_sub(3 * self.start.balls.len() + self.bars)
            .filter(|dof| *dof >= MIN_DOF)?;
        Some((self.readings.iter().map(left).sum::<f64>() / dof as f64).sqrt())
    }

    /// The smallest tolerance at which lengths that agree with the calibrated robot pass.
    fn least_tolerance(&self, expected: &Expected, position: &CheckWorkspace) -> Option<f64> {
        let best = expected.posterior.after(self.readings, self.noise())?;
        let best = decide(&sizes(&position.positions(&best).draws(DRAWS)), None, self.rule, false);
        Some(if self.rule == DecisionRule::SimpleAcceptance { best.position_error_mm } else { best.upper_mm })
    }

    /// The validity of the robot with the information of the check's lengths, until its uncertainty is `growth` times as
    /// large.
    fn validity(
        &self,
        expected: &Expected,
        known: &Posterior,
        growth: f64,
        map: &[MapPoint],
    ) -> Result<Option<Validity>, ConformityFinding> {
        let after =
            expected.posterior.after(self.readings, self.noise()).ok_or(ConformityFinding::NotFinite)?;
        Ok(self
            .robot_of(&after, known)
            .and_then(|robot| Validity::of(&robot, Some(ValidityLimit::Growth(growth)), map)))
    }

    /// The posterior of the calibration.
    fn known(&self) -> Result<Posterior, ConformityFinding> {
        let robot = || self.robot.name.clone();
        let Some(known) = &self.robot.posterior else {
            return Err(ConformityFinding::NoPosterior { robot: robot() });
        };
        if !known.is_of(&self.robot.geometry) {
            return Err(ConformityFinding::PosteriorOfAnother { robot: robot() });
        }
        let (mut start, unknown) = (self.start.clone(), self.robot.uncertainty.as_deref());
        if !matches!(self.mounting.balls, BallMounting::Kept(_)) {
            return Ok(Posterior::of_robot(start, known, unknown));
        }
        for (at, place) in start.balls.iter_mut().enumerate() {
            let ball = BallId::at(at);
            let kept =
                known.ball(ball).ok_or_else(|| ConformityFinding::BallUnknown { ball: ball.number() })?;
            let away_mm = (*place - kept).norm();
            if away_mm > MAX_BALL_SHIFT_MM {
                return Err(ConformityFinding::BallElsewhere { ball: ball.number(), away_mm });
            }
            *place = kept;
        }
        Ok(Posterior::of_robot_with_balls(start, known, unknown))
    }

    fn enough(&self) -> Result<(), ConformityFinding> {
        let (lengths, least) = (self.readings.len(), 3 * self.start.balls.len() + MIN_DOF);
        if lengths < least { Err(ConformityFinding::TooFewLengths { lengths, least }) } else { Ok(()) }
    }

    /// The posterior under a hypothesis.
    fn updated(&self, expected: &Expected, hypothesis: &Hypothesis) -> Option<Posterior> {
        let parameters = [hypothesis.parameters.as_slice(), &hypothesis.alike].concat();
        expected.changed(&parameters).posterior.learn(self.readings, self.noise())
    }

    fn robot_of(&self, found: &Posterior, known: &Posterior) -> Option<Robot> {
        let geometry = found.model.geometry.clone();
        let before = self.robot.posterior.as_ref()?;
        let balls = found.ids().iter().copied().filter(|id| matches!(id, ParamId::Ball(..)));
        let with_balls = |ids: &[ParamId]| -> Vec<ParamId> {
            let own = ids.iter().copied().filter(|id| !matches!(id, ParamId::Ball(..)));
            own.chain(balls.clone()).collect()
        };
        let own: Vec<usize> = places(found, &with_balls(before.ids())).collect();
        let ids: Vec<ParamId> = own.iter().map(|at| found.ids()[*at]).collect();
        let root = found.root().select_rows(&own);
        let posterior = RobotPosterior::with_balls(&ids, &geometry, &found.model.balls, &root)?;
        let after = |unknown: &RobotUncertainty| {
            let parameters = with_balls(known.ids());
            let root = found.root().select_rows(&rows_of(found, &parameters));
            RobotUncertainty { parameters, root, ..unknown.clone() }
        };
        let uncertainty = self.robot.uncertainty.as_deref().map(|unknown| Box::new(after(unknown)));
        Some(Robot { geometry, posterior: Some(posterior), uncertainty, ..self.robot.clone() })
    }

    fn findings(
        &self,
        undecidable: Option<f64>,
        test: &ChangeTest,
        changes: &[Hypothesis],
        other: Option<ConformityFinding>,
    ) -> Vec<ConformityFinding> {
        let mut findings = Vec::new();
        if self.mounting.balls == BallMounting::Anywhere {
            findings.push(ConformityFinding::BallsNotTested);
        }
        if let Some((tolerance_mm, best_mm)) = self.tolerance_mm.zip(undecidable) {
            findings.push(ConformityFinding::Undecidable { tolerance_mm, best_mm });
        }
        let unexplained = changes.first().is_none_or(|likeliest| likeliest.p_rest < BADLY_EXPLAINED);
        if chi_square_tail(test.chi_square, test.freedom as f64) > 1.0 - TOO_GOOD {
            let ChangeTest { chi_square, freedom, .. } = *test;
            findings.push(ConformityFinding::TooGood { chi_square, freedom });
        }
        let not_explained = || ConformityFinding::NotExplained { p: test.p };
        findings.extend(other.or_else(|| (test.changed && unexplained).then(not_explained)));
        findings
    }
}

impl InterimCheck {
    /// The lengths cannot check this robot: without a tolerance exceeded, nothing is decided.
    pub fn decide_nothing(&mut self) {
        if self.decision.decision.confirms() == Some(true) {
            self.decision.decision = ConformityOutcome::Undecided;
            self.decision.specific_risk = None;
        }
        self.validity = None;
    }

    /// The robot with the changed parameters identified again; `None` if nothing changed or no hypothesis explains the
    /// lengths.
    pub fn update(&self) -> Option<&Robot> {
        self.update.as_ref().filter(|_| self.is_explained())
    }

    /// Whether a change of few parameters explains the lengths.
    pub fn is_explained(&self) -> bool {
        let is_unexplained =
            |finding: &ConformityFinding| matches!(finding, ConformityFinding::NotExplained { .. });
        !self.is_of_another() && !self.findings.iter().any(is_unexplained)
    }

    /// Whether the lengths are of no change of this robot.
    pub fn is_of_another(&self) -> bool {
        self.findings.iter().any(|finding| {
            matches!(
                finding,
                ConformityFinding::AnotherRobot { .. } | ConformityFinding::ImpossibleChange { .. }
            )
        })
    }
}

/// The rows of the root for these parameters, then for the joint error coefficients.
fn rows_of(posterior: &Posterior, ids: &[ParamId]) -> Vec<usize> {
    places(posterior, ids).chain(posterior.ids().len()..posterior.root().nrows()).collect()
}

/// The rows of the root for these parameters, as far as the root has them.
fn places(posterior: &Posterior, ids: &[ParamId]) -> impl Iterator<Item = usize> {
    ids.iter().filter_map(|id| posterior.ids().iter().position(|other| other == id))
}

/// The poses over which position errors are evaluated.
struct CheckWorkspace {
    poses: Vec<ApproachedPose>,
    /// What the robot file says of a single pose.
    of_pose: RobotUncertainty,
    /// The tool ball of the calibrated robot, mm.
    calibrated: Vec<Vector3<f64>>,
    /// The tool point, if it is not the tool ball of the calibration: the place of another ball is no error of the robot.
    exact_tool: Option<Vector3<f64>>,
}

impl CheckWorkspace {
    fn new(check: &CheckInput<'_>, known: &Posterior) -> Self {
        let poses: Vec<ApproachedPose> = check.workspace.iter().map(ApproachedPose::unapproached).collect();
        let calibrated = tool_balls(&known.model.geometry, &poses);
        let has_tool = known.ids().iter().any(|id| matches!(id, ParamId::Tool(_)));
        let exact_tool = (!has_tool).then_some(known.model.geometry.tool);
        Self { poses, of_pose: check.robot.known_uncertainty().rootless(), calibrated, exact_tool }
    }

    /// The predicted positions of a robot with this posterior.
    fn positions(&self, posterior: &Posterior) -> Positions {
        let (mut geometry, parameters) = (posterior.model.geometry.clone(), posterior.ids().to_vec());
        // Coefficients of joint errors that the posterior does not have are exact.
        let rows = parameters.len() + geometry.joint_errors.count();
        let root = posterior.root().clone().resize_vertically(rows, 0.0);
        let mut unknown = RobotUncertainty { parameters, root, ..self.of_pose.clone() };
        if let Some(tool) = self.exact_tool {
            (geometry.tool, unknown) = (tool, unknown.without_tool());
        }
        Positions::new(&geometry, &unknown, &self.poses)
    }

    /// Draws of the position errors of the robot file after the check, over all hypotheses by their probability, mm.
    fn now(
        &self,
        expected: &Expected,
        hypotheses: &[Hypothesis],
        of: &CheckInput<'_>,
    ) -> Option<DMatrix<f64>> {
        let mut columns = Vec::new();
        for hypothesis in hypotheses {
            let draws = (hypothesis.probability * DRAWS as f64).round() as usize;
            if draws == 0 {
                continue;
            }
            let posterior =
                expected.changed(&hypothesis.parameters).posterior.learn(of.readings, of.noise())?;
            let found = self.positions(&posterior);
            let moved = displacement(&self.calibrated, &found.balls);
            columns.extend(found.draws(draws).column_iter().take(draws).map(|column| column + &moved));
        }
        Some(DMatrix::from_columns(&columns))
    }
}

/// The 95th percentile of the position error over the poses, for each draw, ascending, mm.
fn sizes(errors: &DMatrix<f64>) -> Vec<f64> {
    let mut sizes: Vec<f64> =
        (0..errors.ncols()).map(|draw| ErrorSummary::of(&errors.columns(draw, 1).into_owned()).p95).collect();
    sizes.sort_by(f64::total_cmp);
    sizes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_standard_deviation_counts() {
        assert_eq!(sigma_mm(Some(0.01), Some(0.02)).ok(), Some(0.02));
        assert_eq!(sigma_mm(Some(0.03), Some(0.02)).ok(), Some(0.03));
        assert_eq!(sigma_mm(None, Some(0.02)).ok(), Some(0.02));
        for nothing in [sigma_mm(None, None), sigma_mm(Some(0.0), None), sigma_mm(None, Some(f64::NAN))] {
            assert!(matches!(nothing, Err(ConformityFinding::NoNoise)));
        }
    }
}
