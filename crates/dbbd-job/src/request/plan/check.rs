//! The poses of a short run of a calibrated robot in a new set-up: they show whether the robot changed, or renew its
//! calibration.

use super::CheckPoses;
use crate::plan::{Job, KnownCell, Plan, PlanningPrior, PoseKind};
use crate::request::RequestSession;
use crate::request::check::CheckSigma;
use crate::request::robots::today;
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::conformity::expected::{BallMounting, Mounting};
use dbbd_model::conformity::{CheckInput, DecisionRule, MAX_BALL_SHIFT_MM};
use dbbd_model::design::Criterion;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::result::MapPoint;
use dbbd_model::estimation::{Options, length_sd_mm};
use dbbd_model::measurement::{LengthModel, PreparedMeasurement};
use dbbd_model::robot::{AXES, BallId, Robot};
use nalgebra::Vector3;

/// The run that is planned, without its poses.
pub(super) struct PlannedCheck<'a> {
    file: &'a str,
    /// The job with the poses of the check, and the base balls where they are.
    job: Job,
    criterion: Criterion,
    robot: Robot,
    start: LengthModel,
    sigma_mm: f64,
    mounting: Mounting,
    tolerance_mm: Option<f64>,
    rule: DecisionRule,
    workspace: Vec<[f64; AXES]>,
}

impl<'a> PlannedCheck<'a> {
    pub(super) fn new(
        poses: CheckPoses,
        criterion: Criterion,
        file: &'a str,
        job: &Job,
        robot: &Robot,
        session: &RequestSession<'_>,
    ) -> Result<Self, Diagnostic> {
        let noise = CheckSigma::at_least(Some(length_sd_mm(job.bar.sigma_um * 1e-3, robot)), file, robot)?;
        session.findings(noise.finding);
        let mut mounting = Mounting::again(robot, job.bar.u_mm());
        if poses.balls_kept {
            mounting.balls = BallMounting::Kept(Mounting::SEAT_REPEAT_MM);
        }
        let (robot, job) = (today(robot), job.mounted(robot, false));
        let job = if poses.balls_kept {
            check_kept_balls(file, &job, &robot)?;
            job.mounted(&robot, true)
        } else {
            job
        };
        Ok(Self {
            file,
            criterion,
            start: LengthModel::new(robot.geometry.clone(), &job.balls()),
            sigma_mm: noise.sigma_mm,
            mounting,
            tolerance_mm: poses.tolerance_mm,
            rule: DecisionRule::GuardBand { risk: poses.risk },
            workspace: Options::default().workspace_poses(&robot).into_owned(),
            job: job.as_check(poses.poses, criterion),
            robot,
        })
    }

    fn input<'b>(&'b self, readings: &'b [PreparedMeasurement]) -> CheckInput<'b> {
        CheckInput {
            robot: &self.robot,
            start: &self.start,
            readings,
            bars: 1,
            sigma_mm: self.sigma_mm,
            mounting: self.mounting,
            tolerance_mm: self.tolerance_mm,
            rule: self.rule,
            workspace: &self.workspace,
        }
    }

    pub(super) fn known(&self) -> Result<KnownCell, Diagnostic> {
        let expected = self.input(&[]).expected().map_err(|finding| Diagnostic::file(self.file, finding))?;
        let prior = PlanningPrior::of_check(&self.job, &self.robot, expected);
        Ok(KnownCell { job: self.job.clone(), robot: self.robot.clone(), prior })
    }

    /// Writes the predicted result of the run into the header. A check has no map of the remaining error.
    pub(super) fn predict(
        &self,
        plan: &mut Plan,
        prior: &PlanningPrior,
        session: &RequestSession<'_>,
    ) -> Result<Vec<MapPoint>, Diagnostic> {
        if self.criterion != Criterion::Change {
            return Ok(plan.predict(&self.robot, prior));
        }
        let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit);
        let readings: Vec<PreparedMeasurement> =
            dwells.map(|row| row.reading(&plan.header.job.bar)).collect();
        let power = self.input(&readings).power()?;
        let best_mm = power.least_tolerance_mm;
        if let Some(tolerance_mm) = power.tolerance_mm.filter(|tolerance| *tolerance < best_mm) {
            session.finding(ConformityFinding::Undecidable { tolerance_mm, best_mm });
        }
        plan.header.check = Some(power);
        Ok(Vec::new())
    }
}

/// Refuses kept base balls that were taught farther from where the calibration had them than the stroke allows, or that the
/// job has elsewhere.
fn check_kept_balls(file: &str, job: &Job, robot: &Robot) -> Result<(), Diagnostic> {
    let known = robot.posterior.as_ref();
    let [low_mm, high_mm] = job.bar.stroke_mm;
    for (at, table) in job.centres.iter().enumerate() {
        let ball = BallId::at(at);
        let Some(kept) = known.and_then(|known| known.ball(ball)) else { continue };
        let away_mm = (Vector3::from(table.xyz_mm) - kept).norm();
        let is_taught = table.taught_deg.is_some();
        if away_mm > if is_taught { 0.5 * (high_mm - low_mm) } else { MAX_BALL_SHIFT_MM } {
            let elsewhere = ConformityFinding::BallElsewhere { ball: ball.number(), away_mm };
            return Err(Diagnostic::file(file, elsewhere));
        }
    }
    Ok(())
}
