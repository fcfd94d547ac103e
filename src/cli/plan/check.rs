//! `dbbd plan --check`: the poses of a short check of a calibrated robot.

use super::{PlanArgs, PlanningKnowledge};
use crate::cli::CommandOutput;
use crate::cli::check::LengthSigma;
use dbbd_job::plan::{Job, Plan, PlanRow, PlanningPrior, PoseKind};
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::conformity::{CheckInput, DecisionRule};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::change::CheckPower;
use dbbd_model::estimation::expected::{BallMounting, Mounting};
use dbbd_model::estimation::result::MapPoint;
use dbbd_model::estimation::{Options, length_sd_mm};
use dbbd_model::measurement::{LengthModel, PreparedMeasurement};
use dbbd_model::robot::{AXES, BallId, ParamUnit, Robot};

/// The check that is planned, without its poses.
pub(super) struct PlannedCheck<'a> {
    file: &'a str,
    poses: u32,
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
        args: &'a PlanArgs,
        job: &Job,
        robot: &Robot,
        out: &CommandOutput,
    ) -> Result<Self, Diagnostic> {
        let file = args.robot.as_deref().unwrap_or_default();
        let noise = LengthSigma::at_least(Some(length_sd_mm(job.bar.sigma_um * 1e-3, robot)), file, robot)?;
        out.findings(noise.finding);
        let mut mounting = Mounting::again(robot, job.bar.u_mm());
        if args.balls_kept {
            mounting.balls = BallMounting::Kept(Mounting::SEAT_REPEAT_MM);
        }
        Ok(Self {
            file,
            poses: args.poses,
            robot: robot.clone(),
            start: LengthModel::new(robot.geometry.clone(), &job.balls()),
            sigma_mm: noise.sigma_mm,
            mounting,
            tolerance_mm: args.tolerance,
            rule: DecisionRule::GuardBand { risk: args.risk },
            workspace: Options::default().workspace_poses(robot).into_owned(),
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

    pub(super) fn known(&self, job: &Job) -> Result<PlanningKnowledge, Diagnostic> {
        self.check_kept_balls(job)?;
        let expected = self.input(&[]).expected().map_err(|finding| Diagnostic::file(self.file, finding))?;
        let prior = PlanningPrior::of_check(job, &self.robot, expected);
        Ok(PlanningKnowledge { job: job.as_check(self.poses), robot: self.robot.clone(), prior })
    }

    /// Refuses kept base balls that are farther from their places in the job, about which the poses are, than the stroke
    /// allows.
    fn check_kept_balls(&self, job: &Job) -> Result<(), Diagnostic> {
        let known = self.robot.posterior.as_ref();
        let [low_mm, high_mm] = job.bar.stroke_mm;
        let stays = matches!(self.mounting.balls, BallMounting::Kept(_));
        for (at, place) in self.start.balls.iter().enumerate().filter(|_| stays) {
            let ball = BallId::at(at);
            let Some(kept) = known.and_then(|known| known.ball(ball)) else { continue };
            let away_mm = (place - kept).norm();
            if away_mm > 0.5 * (high_mm - low_mm) {
                let elsewhere = ConformityFinding::BallElsewhere { ball: ball.number(), away_mm };
                return Err(Diagnostic::file(self.file, elsewhere));
            }
        }
        Ok(())
    }

    /// Writes what the check can detect into the header. A check has no map of the remaining error.
    pub(super) fn predict(&self, plan: &mut Plan, out: &CommandOutput) -> Result<Vec<MapPoint>, Diagnostic> {
        let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit);
        let readings: Vec<PreparedMeasurement> = dwells.map(PlanRow::reading).collect();
        let power = self.input(&readings).power()?;
        let best_mm = power.least_tolerance_mm;
        if let Some(tolerance_mm) = power.tolerance_mm.filter(|tolerance| *tolerance < best_mm) {
            out.finding(ConformityFinding::Undecidable { tolerance_mm, best_mm });
        }
        plan.header.check = Some(power);
        Ok(Vec::new())
    }
}

/// What a check can detect, on the terminal.
pub(super) fn check_power_lines(power: &CheckPower) -> Vec<String> {
    let smallest = |angles: bool| {
        let of_unit = power.detectable.iter().filter(|change| (change.unit == ParamUnit::Rad) == angles);
        let smallest = of_unit.filter_map(|change| {
            let size = change.smallest?;
            Some(if angles {
                format!("{} {:.4} deg", change.name, size.to_degrees())
            } else {
                format!("{} {size:.3} mm", change.name)
            })
        });
        smallest.collect::<Vec<String>>().join(", ")
    };
    vec![
        format!(
            "smallest changes found with {:.0} % probability at {:.0} % of false alarms:",
            100.0 * power.power,
            100.0 * power.false_alarm
        ),
        format!("  {}", smallest(true)),
        format!("  {}", smallest(false)),
        format!(
            "smallest tolerance of the position error that it decides: {:.3} mm",
            power.least_tolerance_mm
        ),
    ]
}
