//! The knowledge of robot and set-up when a plan is made.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{Job, PlanKinematics};
use crate::plan::PlanFinding;
use crate::plan::job::{BaseBallTable, JobCheck, JobFinding, JobTable};
use dbbd_model::conformity::expected::Expected;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::estimation::{
    AngleSource, Input, Options, Posterior, Prior, Priors, beyond_repeatability, largest_plausible,
    length_sd_mm, with_usual_joint_errors,
};
use dbbd_model::measurement::{LengthModel, Measurements, PreparedMeasurement};
use dbbd_model::robot::{AXES, BallId, BarId, ParamId, Robot, RobotPosterior};

/// Greatest distance between `xyz_mm` of a ball and the tool ball at its `taught_deg`, mm: more is a mistake in one of them.
const TAUGHT_MM: f64 = 1.0;
/// Greatest distance between the program's tool and the tool ball, mm: the resolution of KRL.
const TOOL_MM: f64 = 1e-3;

/// The robot and the set-up as they are known when a plan is made.
#[derive(Clone, Debug)]
pub struct PlanningPrior {
    pub posterior: Posterior,
    /// The lengths from which the posterior was determined.
    measured: Measurements,
    /// The posterior without what was taught.
    untaught: Posterior,
    /// Whether each base ball was measured or taught. A ball that was not is taught before its first run: it is put
    /// where the arm has the tool ball, so that its error is the error of the robot there.
    located: Vec<bool>,
    /// Present if a check of a calibrated robot in a new set-up is planned.
    pub(super) calibrated: Option<Expected>,
}

/// Job and robot with what is known of them.
#[derive(Clone, Debug)]
pub struct KnownCell {
    pub job: Job,
    pub robot: Robot,
    pub prior: PlanningPrior,
}

/// The pose at which a base ball is to be taught.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaughtBall {
    pub centre: u32,
    /// The controller's axis angles with the tool ball on the base ball, degrees.
    pub axes_deg: [f64; AXES],
}

impl PlanningPrior {
    /// The robot's tolerance and the bar's certificate, without the taught balls.
    pub(super) fn of_maker(job: &Job, robot: &Robot) -> Posterior {
        let model = LengthModel::new(robot.geometry.clone(), &job.balls());
        Posterior::prior(robot, model, &Priors::datasheet(robot, job.bar.u_mm()))
    }

    /// As [`Self::of_maker`], with the usual errors of joints.
    pub(super) fn before_lengths(job: &Job, robot: &Robot) -> Posterior {
        with_usual_joint_errors(&Self::of_maker(job, robot), robot.controller())
    }

    /// Knowledge before anything is measured: the robot's tolerance, the usual errors of its joints, the bar's certificate, the
    /// balls that were taught.
    pub fn datasheet(job: &Job, robot: &Robot) -> Self {
        Self::with_taught(job, robot, Self::before_lengths(job, robot))
    }

    /// Knowledge before a check: the posterior of the calibration, the changes by mounting again, the balls that were
    /// taught, or that stayed where the calibration had them.
    pub fn of_check(job: &Job, robot: &Robot, expected: Expected) -> Self {
        let posterior = expected.posterior.clone();
        let known = if expected.are_balls_kept() {
            let located = vec![true; job.centres.len()];
            Self {
                untaught: posterior.clone(),
                posterior,
                measured: Measurements::default(),
                located,
                calibrated: None,
            }
        } else {
            Self::with_taught(job, robot, posterior)
        };
        Self { calibrated: Some(expected), ..known }
    }

    fn with_taught(job: &Job, robot: &Robot, untaught: Posterior) -> Self {
        let mut posterior = untaught.clone();
        for (at, table) in job.centres.iter().enumerate() {
            if let Some(taught) = table.taught() {
                let sd_mm = length_sigma_mm(job, robot.controller()).hypot(table.off_taught_mm(robot));
                posterior = posterior.touched(BallId::at(at), &taught, sd_mm);
            }
        }
        let located = job.centres.iter().map(|table| table.taught_deg.is_some()).collect();
        Self { posterior, measured: Measurements::default(), untaught, located, calibrated: None }
    }

    /// Number of lengths from which the posterior was determined.
    pub(super) fn lengths(&self) -> usize {
        self.measured.rows.len()
    }

    /// The options of the identification of a plan's lengths, with the position error over `workspace` (axis angles, rad), else
    /// over that of the robot.
    pub(super) fn options(&self, job: &Job, workspace: Option<Vec<[f64; AXES]>>) -> Options {
        let prior = if self.calibrated.is_some() { Prior::Posterior } else { Prior::Datasheet };
        Options { prior, bar_u_mm: job.bar.u_mm(), workspace, ..Options::default() }
    }

    /// The identification of the lengths that were measured before the plan, from `start`.
    pub(super) fn identification<'a>(
        &'a self,
        robot: &'a Robot,
        start: &'a LengthModel,
        options: &'a Options,
    ) -> Input<'a> {
        let robot = if self.calibrated.is_some() { robot } else { robot.controller() };
        let (observations, axes) = (&self.measured, AngleSource::Commanded);
        Input { robot, observations, start, validation: None, options, axes }
    }

    /// The knowledge if no ball was taught yet.
    pub(super) fn before_teaching(&self) -> Self {
        let located = vec![false; self.located.len()];
        Self { posterior: self.untaught.clone(), located, ..self.clone() }
    }

    /// Knowledge after lengths were measured, as an identification has it: the most probable robot (with the given one as its
    /// nominal robot) and base balls, and their covariance, with the balls where they were taught.
    ///
    /// # Errors
    /// A number is not finite, a length is to a ball that the job does not have, or the bar of the lengths is longer or
    /// shorter than the job's bar by more than its stroke.
    pub fn after_lengths(job: &Job, robot: &Robot, lengths: &Measurements) -> Result<Self, PlanFinding> {
        let nominal = robot.controller();
        let readings: Vec<PreparedMeasurement> = lengths.rows.iter().map(PreparedMeasurement::from).collect();
        let bar = BarLengthError::by_lengths(job, nominal, &readings).filter(|bar| bar.is_contradicted(job));
        let [low_mm, high_mm] = job.bar.stroke_mm;
        if let Some(BarLengthError { off_mm, sd_mm }) = bar
            && !(low_mm..=high_mm).contains(&off_mm)
        {
            return Err(PlanFinding::OtherBar { off_mm, sd_mm, low_mm, high_mm });
        }
        let before = Self { measured: lengths.clone(), ..Self::datasheet(job, nominal) };
        let (start, options) =
            (LengthModel::new(nominal.geometry.clone(), &job.balls()), before.options(job, None));
        let untaught = before.identification(nominal, &start, &options).posterior();
        let known = Self::with_taught(job, nominal, untaught.map_err(|_| PlanFinding::NoFiniteRobot)?);
        let Self { mut located, measured, .. } = before;
        for reading in &readings {
            let ball = reading.datum.ball().and_then(|ball| located.get_mut(ball.index()));
            *ball.ok_or(PlanFinding::NoFiniteRobot)? = true;
        }
        Ok(Self { measured, located, ..known })
    }

    /// Warnings about the lengths: their residual far exceeds the robot's repeatability, or another bar fits far
    /// better.
    pub fn lengths_findings(
        &self,
        job: &Job,
        robot: &Robot,
        lengths: &Measurements,
    ) -> Vec<EstimationFinding> {
        let lengths: Vec<PreparedMeasurement> = lengths.rows.iter().map(PreparedMeasurement::from).collect();
        let model = self.posterior.model.prepare();
        let squares = lengths.iter().map(|one| (one.length_mm - model.length(one)).powi(2));
        let rms_mm = (squares.sum::<f64>() / lengths.len().max(1) as f64).sqrt();
        let worse = beyond_repeatability(rms_mm, job.bar.sigma_um * 1e-3, robot.controller());
        let bar = BarLengthError::by_lengths(job, robot.controller(), &lengths);
        let bar = bar.filter(|bar| bar.is_contradicted(job));
        let other =
            bar.map(|BarLengthError { off_mm, sd_mm }| EstimationFinding::BarContradicted { off_mm, sd_mm });
        worse.into_iter().chain(other).collect()
    }

    /// The job and the robot with the most probable base balls and geometry.
    pub fn applied(&self, job: &Job, robot: &Robot) -> (Job, Robot) {
        let nominal = robot.controller();
        let job = job.with_balls(self.posterior.model.balls.iter().copied().map(Some));
        let robot = Robot {
            geometry: self.posterior.model.geometry.clone(),
            nominal: Some(Box::new(nominal.clone())),
            posterior: self.of_robot(),
            ..nominal.clone()
        };
        (job, robot)
    }

    /// The posterior of the robot's own parameters, so that lengths measured on the plan add to it.
    fn of_robot(&self) -> Option<RobotPosterior> {
        let posterior = &self.posterior;
        let is_own = |id: &ParamId| id.is_geometric() || matches!(id, ParamId::Tool(_));
        let own: Vec<usize> = (0..posterior.ids().len()).filter(|&at| is_own(&posterior.ids()[at])).collect();
        let ids: Vec<ParamId> = own.iter().map(|&at| posterior.ids()[at]).collect();
        RobotPosterior::new(&ids, &posterior.model.geometry, &posterior.root().select_rows(&own))
    }

    /// The knowledge when a run about base ball `centre` (from 1) starts at axis angles in rad. A ball that was neither
    /// measured nor taught is touched before the run, with the orientation of the tool at the start.
    pub(super) fn at_start(&self, rig: &PlanKinematics<'_>, centre: u32, start: &[f64; AXES]) -> RunStart {
        let unlocated = |ball: &BallId| self.located.get(ball.index()) == Some(&false);
        let Some(ball) = BallId::new(centre).filter(unlocated) else {
            return RunStart { posterior: self.posterior.clone(), taught: None };
        };
        let axes = rig.touching(centre, start).unwrap_or(*start);
        let axes_deg = axes.map(|angle| (angle.to_degrees() * 1e4).round() / 1e4);
        let sd_mm = length_sigma_mm(rig.job, rig.controller);
        let posterior = self.posterior.touched(ball, &axes_deg.map(f64::to_radians), sd_mm);
        RunStart { posterior, taught: Some(TaughtBall { centre, axes_deg }) }
    }

    /// Continues with the knowledge at a start, and returns the ball that is to be taught for it.
    pub(super) fn begin(&mut self, start: RunStart) -> Option<TaughtBall> {
        let taught = start.taught?;
        self.posterior = start.posterior;
        let ball = BallId::new(taught.centre);
        if let Some(located) = ball.and_then(|ball| self.located.get_mut(ball.index())) {
            *located = true;
        }
        Some(taught)
    }
}

/// The error of the bar's length: how much longer the bar would have to be for a robot within its tolerance to explain
/// the lengths.
struct BarLengthError {
    off_mm: f64,
    sd_mm: f64,
}

impl BarLengthError {
    fn by_lengths(job: &Job, robot: &Robot, readings: &[PreparedMeasurement]) -> Option<Self> {
        // A prior standard deviation so wide that the bar's length is unknown.
        const UNKNOWN_MM: f64 = 1e3;
        let model = LengthModel::new(robot.geometry.clone(), &job.balls());
        let prior = Posterior::prior(robot, model, &Priors::datasheet(robot, Some(UNKNOWN_MM)));
        let before = PlanningPrior::with_taught(job, robot, prior).posterior;
        let found = before.learn(readings, length_sigma_mm(job, robot))?;
        let sd_mm = found.sd(ParamId::BarOffset(BarId::FIRST))?;
        Some(Self { off_mm: found.model.bar_offset(BarId::FIRST), sd_mm })
    }

    /// Whether the error is implausible by the bar's certificate and the robot's tolerance.
    fn is_contradicted(&self, job: &Job) -> bool {
        let u_mm = Priors::certified_bar_mm(job.bar.u_mm());
        self.off_mm.abs() > largest_plausible(true) * self.sd_mm.hypot(u_mm)
    }
}

/// The knowledge at the start of a run.
pub(super) struct RunStart {
    pub(super) posterior: Posterior,
    /// The ball that is taught before the run.
    taught: Option<TaughtBall>,
}

impl BaseBallTable {
    /// `taught_deg` in rad.
    fn taught(&self) -> Option<[f64; AXES]> {
        self.taught_deg.map(|deg| deg.map(f64::to_radians))
    }

    /// How far `xyz_mm` is from the tool ball at `taught_deg`, mm; 0 for a ball without them. The place is that of the
    /// controller, or of the identified robot if a plan on it had asked for the angles.
    fn off_taught_mm(&self, robot: &Robot) -> f64 {
        let Some(taught) = self.taught() else { return 0.0 };
        let off_mm = |arm: &Robot| (arm.geometry.ball(&taught).position - Vector3::from(self.xyz_mm)).norm();
        off_mm(robot.controller()).min(off_mm(robot))
    }
}

impl Job {
    /// The job with each base ball where it is in the frame of the arm of `robot`: where its tool ball is at `taught_deg`, or
    /// where the calibration had the ball if it is kept. Else `xyz_mm` is where the ball is to be put.
    #[must_use]
    pub(crate) fn mounted(&self, robot: &Robot, are_balls_kept: bool) -> Self {
        let known = robot.posterior.as_ref().filter(|_| are_balls_kept);
        self.with_balls(self.centres.iter().enumerate().map(|(at, table)| {
            let kept = known.and_then(|known| known.ball(BallId::at(at)));
            kept.or_else(|| Some(robot.geometry.ball(&table.taught()?).position))
        }))
    }

    fn with_balls(&self, places: impl Iterator<Item = Option<Vector3<f64>>>) -> Self {
        let mut job = self.clone();
        for (table, place) in job.centres.iter_mut().zip(places) {
            table.xyz_mm = place.map_or(table.xyz_mm, Into::into);
        }
        job
    }

    /// Checks that each ball is where a bar can reach it, that its `taught_deg` brings the tool ball to its `xyz_mm`, and that
    /// the program's tool is at the tool ball.
    pub(crate) fn check_against(&self, robot: &Robot) -> JobCheck {
        let controller = robot.controller();
        self.check_places(controller)?;
        for (at, table) in self.centres.iter().enumerate() {
            let Some(taught) = table.taught() else { continue };
            let off_mm = table.off_taught_mm(robot);
            if off_mm > TAUGHT_MM {
                let [x_mm, y_mm, z_mm] = controller.geometry.ball(&taught).position.into();
                let finding = JobFinding::TaughtElsewhere { ball: table.id, x_mm, y_mm, z_mm, off_mm };
                return Err(JobTable::nth("[[centre]]", at).wrong("taught_deg", finding));
            }
        }
        let Some([x_mm, y_mm, z_mm, ..]) = self.motion.tool else { return Ok(()) };
        let ball = controller.geometry.tool;
        if (ball - Vector3::new(x_mm, y_mm, z_mm)).norm() > TOOL_MM {
            let [ball_x_mm, ball_y_mm, ball_z_mm] = ball.into();
            let finding = JobFinding::ToolElsewhere { x_mm, y_mm, z_mm, ball_x_mm, ball_y_mm, ball_z_mm };
            return Err(JobTable::new("[motion]").wrong("tool", finding));
        }
        Ok(())
    }
}

/// Standard deviation of one length, mm: the bar's sigma and the robot's repeatability together.
pub(super) fn length_sigma_mm(job: &Job, robot: &Robot) -> f64 {
    length_sd_mm(job.bar.sigma_um * 1e-3, robot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::{job, robot};

    #[test]
    fn taught_ball_is_known_as_well_as_the_tool_there() {
        let (job, robot) = (job(""), robot());
        let rig = PlanKinematics::new(&job, &robot);
        let prior = PlanningPrior::datasheet(&job, &robot);
        let start = [2.0, -62.0, 117.0, 0.0, 60.0, 10.0].map(f64::to_radians);
        let RunStart { posterior, taught } = prior.at_start(&rig, 1, &start);
        let taught = taught.expect("the ball was not taught");
        let axes = taught.axes_deg.map(f64::to_radians);
        // The ball's place from the four decimals of the angles: 0.00005 degrees at 1.5 m are 1.3 um for each axis.
        let ball = robot.geometry.ball(&axes).position;
        assert!((ball - Vector3::new(1300.0, 0.0, 800.0)).norm() < 0.01);
        // At the very place of the ball, the length from the ball to the tool ball is exact except for the noise of
        // teaching.
        let near_mm = posterior.design_row(&axes, BallId::FIRST).norm();
        let far_mm = prior.posterior.design_row(&axes, BallId::FIRST).norm();
        assert!(near_mm < far_mm, "{near_mm} {far_mm}");
        let mut next = prior.clone();
        assert_eq!(next.begin(prior.at_start(&rig, 1, &start)), Some(taught));
        assert_eq!(next.at_start(&rig, 1, &start).taught, None);
    }

    #[test]
    fn taught_angles_and_tool_must_fit_the_robot() {
        let robot = robot();
        let mut job = job("");
        let rig = PlanKinematics::new(&job, &robot);
        let start = [2.0, -62.0, 117.0, 0.0, 60.0, 10.0].map(f64::to_radians);
        let axes = rig.touching(1, &start).expect("it is in reach");
        let [x, y, z] = job.centres[0].xyz_mm;
        for (off_mm, fits) in [(0.0, true), (0.99, true), (1.01, false)] {
            job.centres[0].xyz_mm = [x, y + off_mm, z];
            job.centres[0].taught_deg = Some(axes.map(f64::to_degrees));
            assert_eq!(job.check_against(&robot).is_ok(), fits, "{off_mm}");
        }
        job.centres[0].taught_deg = None;
        // The tool ball of the file is at (30, 20, 10).
        for (tool_z_mm, fits) in [(10.0, true), (10.0005, true), (10.002, false)] {
            job.motion.tool = Some([30.0, 20.0, tool_z_mm, 0.0, 0.0, 0.0]);
            assert_eq!(job.check_against(&robot).is_ok(), fits, "{tool_z_mm}");
        }
    }
}
