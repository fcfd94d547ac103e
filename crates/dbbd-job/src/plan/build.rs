//! Makes a plan from a job, or refuses it.

use super::check::{Inspection, summary};
use super::quantity::PlanCheck;
use super::recommend::recommendations;
use super::refusal::Refusal;
use super::rig::{runs, unreachable};
use super::steps::circle_steps;
use super::timing::AFTER_STROBE_S;
use super::{
    Job, Plan, PlanHeader, PlanKinematics, PlanPrediction, PlanRow, PlanStep, PlanningPrior, TaughtBall,
    files, optimise, orientations, pass,
};
use crate::plan::PlanFinding;
use dbbd_model::design::Candidate;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::result::MapPoint;
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::inverse::Unsolved;
use dbbd_model::robot::{AXES, BallId, Robot};

/// The caution with which poses are chosen.
#[derive(Clone, Copy)]
struct SafetyMargin {
    /// Share of the allowed risk that is used.
    risk_share: f64,
    /// Distance to keep beyond the least clearance, mm: ways are tried in coarser steps than they are checked.
    clearance_mm: f64,
}

/// Where the poses of an attempt come from.
#[derive(Clone, Copy)]
enum PoseSource<'a> {
    Given(&'a [Candidate]),
    /// They are chosen about each ball in the branch of the arm of this rank, by the error that poses there leave.
    Chosen {
        rank: usize,
    },
}

/// Degrees of caution that are tried in turn.
const CAUTION: [SafetyMargin; 3] = [
    SafetyMargin { risk_share: 1.0, clearance_mm: 0.0 },
    SafetyMargin { risk_share: 0.3, clearance_mm: 3.0 },
    SafetyMargin { risk_share: 0.1, clearance_mm: 8.0 },
];
/// Starts of a run that are followed finely before the best one is refused.
const TRIED: usize = 4;

impl Plan {
    /// Plans a job for a robot. For an identified robot (which carries its nominal robot), the plan has the poses to
    /// command to its controller, which computes with the nominal robot.
    pub fn build(job: &Job, robot: &Robot) -> Result<Self, Refusal> {
        Self::build_with(job, robot, &PlanningPrior::datasheet(job, robot))
    }

    /// The same as [`Plan::build`], with prior knowledge of the robot.
    pub fn build_with(job: &Job, robot: &Robot, prior: &PlanningPrior) -> Result<Self, Refusal> {
        Self::of_poses(job, robot, prior, None)
    }

    /// Plans these poses of the controller (axis angles, rad) about the base balls of the job, in place of its circles.
    pub fn build_again(
        job: &Job,
        robot: &Robot,
        prior: &PlanningPrior,
        poses: &[(BallId, [f64; AXES])],
    ) -> Result<Self, Refusal> {
        let rig = PlanKinematics::new(job, robot);
        let given =
            poses.iter().map(|(ball, axes)| Candidate { ball: *ball, axes: *axes, pose: rig.arm.ball(axes) });
        Self::of_poses(job, robot, prior, Some(&given.collect::<Vec<_>>()))
    }

    fn of_poses(
        job: &Job,
        robot: &Robot,
        prior: &PlanningPrior,
        given: Option<&[Candidate]>,
    ) -> Result<Self, Refusal> {
        job.check().map_err(|misplaced| *misplaced.finding)?;
        let plan = Self::in_a_branch(job, robot, prior, given);
        // Before the first length a ball can still be taught from elsewhere: try without `taught_deg`.
        let taught = job.centres.iter().any(|table| table.taught_deg.is_some());
        match plan {
            Err(refusal) if refusal.is_for_place() && prior.lengths() == 0 && taught => {
                let job = job.untaught();
                let mut plan =
                    Self::in_a_branch(&job, robot, &prior.before_teaching(), given).map_err(|_| refusal)?;
                let again =
                    plan.header.taught.iter().map(|ball| PlanFinding::TeachAgain { ball: ball.centre });
                plan.header.notes.extend(again);
                Ok(plan)
            }
            plan => plan,
        }
    }

    /// Chooses poses in the branches of the arm that leave the smallest errors, or in the next ones if a plan there is refused for its risk.
    fn in_a_branch(
        job: &Job,
        robot: &Robot,
        prior: &PlanningPrior,
        given: Option<&[Candidate]>,
    ) -> Result<Self, Refusal> {
        if let Some(given) = given {
            return Self::cautious(job, robot, prior, PoseSource::Given(given));
        }
        let in_branch = |rank| Self::cautious(job, robot, prior, PoseSource::Chosen { rank });
        let is_free = job.centres.iter().any(|table| table.taught_deg.is_none());
        match in_branch(0) {
            Err(refusal) if refusal.is_for_place() && job.optimise.is_some() && is_free => {
                in_branch(1).map_err(|_| refusal)
            }
            plan => plan,
        }
    }

    /// Chooses poses ever more cautiously while the paths between them are refused.
    fn cautious(
        job: &Job,
        robot: &Robot,
        prior: &PlanningPrior,
        source: PoseSource<'_>,
    ) -> Result<Self, Refusal> {
        let [first, further @ ..] = CAUTION;
        match Self::attempt(job, robot, prior, source, first) {
            Err(refusal) if refusal.is_for_caution() && job.circles.is_empty() => {
                let mut plans =
                    further.into_iter().map(|caution| Self::attempt(job, robot, prior, source, caution));
                plans.find_map(Result::ok).ok_or(refusal)
            }
            plan => plan,
        }
    }

    fn attempt(
        job: &Job,
        robot: &Robot,
        prior: &PlanningPrior,
        source: PoseSource<'_>,
        caution: SafetyMargin,
    ) -> Result<Self, Refusal> {
        let job = orientations::chosen(&PlanKinematics::new(job, robot), prior)?;
        let mut steps = circle_steps(&job)?;
        let (mut notes, mut stage) = (Vec::new(), None);
        if job.optimise.is_some() {
            let mut wary = job.clone();
            wary.limits.min_clearance_mm += caution.clearance_mm;
            let (rig, share) = (PlanKinematics::new(&wary, robot), caution.risk_share);
            let chosen = match source {
                PoseSource::Given(poses) => optimise::given_steps(&rig, prior, poses, share)?,
                PoseSource::Chosen { rank } => optimise::choose_steps(&rig, prior, share, rank)?,
            };
            steps.extend(chosen.steps);
            (notes, stage) = (chosen.notes, chosen.stage);
        }
        let rig = PlanKinematics::new(&job, robot);
        let (mut found, taught) = rig.inspect(&steps, prior);
        // One robot makes all the runs, so their risks are not independent.
        let stroke_risk = found.note_run_risk();
        if !found.findings.is_empty() {
            return Err(rig.refusal(&found));
        }
        let pose_hash = files::pose_hash(&found.rows, &job, robot).map_err(Diagnostic::from)?;
        let mut moves = found.time_moves(&job, robot, pose_hash);
        let checks = found.checks(&job);
        if !checks.iter().all(PlanCheck::holds) {
            return Err(rig.refusal(&found));
        }
        let rows = found.rows;
        let passes = pass::passes(&job, &rows, &mut moves).map_err(Diagnostic::from)?;
        let header = PlanHeader {
            schema: files::PLAN_FILE_SCHEMA,
            hash: String::new(),
            text_hash: String::new(),
            pose_hash: files::digits(pose_hash),
            robot: robot.to_toml().map_err(Diagnostic::from)?,
            provenance: Provenance::default(),
            moves,
            passes,
            checks: summary(&checks),
            notes,
            again: false,
            stage,
            taught,
            stroke_risk,
            goal: None,
            predictions: None,
            check: None,
            job,
        };
        let mut plan = Self { rows, header };
        plan.header.hash = plan.hash().map_err(Diagnostic::from)?;
        Ok(plan)
    }

    /// Predicts what this plan will add to `prior`, and stores it in the header. Returns the map of the error that is left,
    /// empty if a number is not finite.
    pub fn predict(&mut self, robot: &Robot, prior: &PlanningPrior) -> Vec<MapPoint> {
        let PlanHeader { job, stage, .. } = &self.header;
        let Some((prediction, map)) = PlanPrediction::of_rows(job, &self.rows, stage.is_some(), robot, prior)
        else {
            return Vec::new();
        };
        self.header.predictions = Some(prediction);
        map
    }

    /// Time that the program takes at full override, without the waits for the operator, s.
    pub fn duration_s(&self) -> f64 {
        self.row_times_s().sum()
    }

    /// The shortest time of a run, s: no override exceeds 100 %, but controllers may accelerate faster than planned.
    pub fn least_duration_s(&self) -> f64 {
        0.95 * self.duration_s()
    }

    /// The time of each row, s: the move to it, and the stop there.
    pub fn row_times_s(&self) -> impl Iterator<Item = f64> {
        let motion = &self.header.job.motion;
        self.rows.iter().zip(&self.header.moves).map(|(row, time)| {
            // The robot waits at the end of a pass as it does for a dwell, of length 0.
            let stops = row.dwell_s > 0.0 || self.header.passes.iter().any(|pass| pass.end == row.index);
            let still_s = motion.settle_s + row.dwell_s + AFTER_STROBE_S;
            time.duration_s + if stops { still_s } else { 0.0 }
        })
    }
}

impl PlanKinematics<'_> {
    /// All runs, each in its best branch, and the balls that are to be taught for them.
    fn inspect(&self, steps: &[PlanStep], prior: &PlanningPrior) -> (Inspection, Vec<TaughtBall>) {
        let (mut all, mut taught, mut prior) = (Inspection::default(), Vec::new(), prior.clone());
        for run in runs(steps) {
            let first_index = run.start as u32 + 1;
            let best = self.best(steps.get(run).unwrap_or_default(), first_index, &prior, all.rows.last());
            if let Some(start) = best.rows.first() {
                let axes = start.axes_deg.map(f64::to_radians);
                let start = prior.at_start(self, start.centre.number(), &axes);
                taught.extend(prior.begin(start));
            }
            all.append(best);
        }
        (all, taught)
    }

    /// The run in the safe branch and turn with the largest margin; if none is safe, the run with the largest margin.
    fn best(
        &self,
        run: &[PlanStep],
        first_index: u32,
        prior: &PlanningPrior,
        before: Option<&PlanRow>,
    ) -> Inspection {
        let Some(first) = run.first() else { return Inspection::default() };
        let first_pose =
            |why: &Unsolved| Inspection::refused(unreachable(first_index, first.pose.position.into(), why));
        let starts = match self.starts(first) {
            Ok(starts) => starts,
            Err(why) => return first_pose(&why),
        };
        let mut failed = None;
        let mut turns: Vec<(f64, [f64; AXES])> = Vec::new();
        for start in &starts {
            match self.follow(run, first_index, start) {
                Ok(branch) => turns.extend(branch.starts),
                Err(finding) => failed = failed.or(Some(finding)),
            }
        }
        turns.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let mut best: Option<Inspection> = None;
        for (_, start) in turns.into_iter().take(TRIED) {
            let Ok(branch) = self.follow(run, first_index, &start) else { continue };
            let found = Inspection::new(self, prior, branch.rows, before);
            if found.is_safe(self.job) {
                return found;
            }
            best = best.or(Some(found));
        }
        let refused = || failed.map_or_else(|| first_pose(&Unsolved::OutOfReach), Inspection::refused);
        best.unwrap_or_else(refused)
    }

    /// The refusal: the poses and paths that cannot be reached, then the limits that are not kept.
    fn refusal(&self, found: &Inspection) -> Refusal {
        let mut broken = found.checks(self.job);
        broken.retain(|check| !check.holds());
        let recommended = recommendations(self, &found.rows, &found.findings, &broken);
        let limits = broken.iter().map(|check| PlanFinding::from(check).into());
        Refusal {
            findings: found.findings.iter().cloned().map(Diagnostic::from).chain(limits).collect(),
            recommendations: recommended.into_iter().map(Diagnostic::from).collect(),
        }
    }
}
