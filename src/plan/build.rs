//! From a job to a plan, or to its refusal.

use super::cell::{Cell, StrokeMargin};
use super::check::{Inspector, Worst, judge, note_speed, path, summary, unreachable};
use super::quantity::{Check, Quantity};
use super::recommend::recommendations;
use super::refusal::Refusal;
use super::rig::Rig;
use super::risk::over_run;
use super::solve::runs;
use super::steps::{Step, steps};
use super::timing::{Pace, move_times};
use super::{Header, Job, Plan, PlanRow, PlanningPrior, Taught, optimise, orientations, pass};
use crate::catalogue::PlanFinding;
use crate::diagnostic::Diagnostic;
use crate::provenance::Provenance;
use crate::robot::inverse::Unsolved;
use crate::robot::{AXES, Robot};

/// How cautiously poses are chosen.
#[derive(Clone, Copy)]
struct Caution {
    /// Of the risk that is allowed.
    risk_share: f64,
    /// Beyond the least clearance, mm: a way is tried in coarser steps than it is checked.
    clearance_mm: f64,
}

/// Tried in turn.
const CAUTION: [Caution; 3] = [
    Caution { risk_share: 1.0, clearance_mm: 0.0 },
    Caution { risk_share: 0.3, clearance_mm: 3.0 },
    Caution { risk_share: 0.1, clearance_mm: 8.0 },
];
/// How many branches are followed finely before the best one is refused.
const TRIED: usize = 4;

/// Rows that were followed finely.
#[derive(Default)]
struct Inspected {
    rows: Vec<PlanRow>,
    paces: Vec<Option<Pace>>,
    worst: Vec<Worst>,
    findings: Vec<PlanFinding>,
    /// The worst pose of each row, for the risk of all runs together.
    margins: Vec<StrokeMargin>,
}

impl Inspected {
    fn refused(finding: PlanFinding) -> Self {
        Self { findings: vec![finding], ..Self::default() }
    }

    fn append(&mut self, mut run: Self) {
        self.rows.append(&mut run.rows);
        self.paces.append(&mut run.paces);
        self.worst.append(&mut run.worst);
        self.findings.append(&mut run.findings);
        self.margins.append(&mut run.margins);
    }

    fn judge(&self, job: &Job) -> Vec<Check> {
        judge(job, &self.rows, &self.worst)
    }
}

impl Plan {
    /// Plans a job for a robot. Where the robot was identified (it carries its nominal one), the poses
    /// are those that the controller, which computes with the nominal one, must be commanded.
    ///
    /// # Errors
    /// Every unsafe or impossible row, with value and limit.
    pub fn build(job: &Job, robot: &Robot) -> Result<Self, Refusal> {
        Self::build_with(job, robot, &PlanningPrior::datasheet(job, robot))
    }

    /// As [`Plan::build`], with what is known of the robot.
    ///
    /// # Errors
    /// As [`Plan::build`].
    pub fn build_with(job: &Job, robot: &Robot, prior: &PlanningPrior) -> Result<Self, Refusal> {
        job.check().map_err(|misplaced| misplaced.finding)?;
        let plan = Self::cautious(job, robot, prior);
        // Before the first length a ball may be moved: how it was taught must not bar what another way allows.
        let taught = job.centres.iter().any(|table| table.taught_deg.is_some());
        match plan {
            Err(refusal) if refusal.is_for_place() && prior.lengths == 0 && taught => {
                let job = job.untaught();
                let mut plan = Self::cautious(&job, robot, &PlanningPrior::datasheet(&job, robot))
                    .map_err(|_| refusal)?;
                let anew = plan.header.taught.iter().map(|ball| PlanFinding::TeachAnew { ball: ball.centre });
                plan.header.notes.extend(anew);
                Ok(plan)
            }
            plan => plan,
        }
    }

    /// With chosen poses of less and less risk, farther and farther from what is in the way: the ways between them count as
    /// well.
    fn cautious(job: &Job, robot: &Robot, prior: &PlanningPrior) -> Result<Self, Refusal> {
        let [first, further @ ..] = CAUTION;
        let plan = Self::attempt(job, robot, prior, first);
        let mut further = further.iter();
        let refused = |plan: &Result<Self, Refusal>| match plan {
            Err(refusal) => refusal.is_for_caution() && job.circles.is_empty(),
            Ok(_) => false,
        };
        if !refused(&plan) {
            return plan;
        }
        further.find_map(|caution| Self::attempt(job, robot, prior, *caution).ok()).map_or(plan, Ok)
    }

    fn attempt(job: &Job, robot: &Robot, prior: &PlanningPrior, caution: Caution) -> Result<Self, Refusal> {
        let rig = Rig::new(robot);
        let job = orientations::chosen(job, &rig, prior)?;
        let mut steps = steps(&job)?;
        let (mut notes, mut stage) = (Vec::new(), None);
        if job.optimise.is_some() {
            let mut wary = job.clone();
            wary.limits.min_clearance_mm += caution.clearance_mm;
            let chosen = optimise::steps(&wary, &rig, prior, caution.risk_share)?;
            steps.extend(chosen.steps);
            (notes, stage) = (chosen.notes, chosen.stage);
        }
        let planner = Planner { job: &job, robot, rig: &rig };
        let (mut inspected, taught) = planner.inspect_all(&steps, prior);
        // One robot makes all the runs: their risks are not independent.
        let stroke_risk = over_run(&inspected.margins);
        if let Some(last) = inspected.worst.last_mut() {
            last.note(Quantity::RunRisk, stroke_risk);
        }
        if !inspected.findings.is_empty() {
            return Err(planner.refusal(&inspected));
        }
        let seed = u64::from(job.seed);
        let mut moves = move_times(&inspected.rows, &inspected.paces, &job.motion, robot, seed);
        for worst in &mut inspected.worst {
            let at = worst.position();
            if let (Some(Some(pace)), Some(time)) = (inspected.paces.get(at), moves.get(at)) {
                note_speed(worst, pace, time);
            }
        }
        let checks = inspected.judge(&job);
        if !checks.iter().all(Check::holds) {
            return Err(planner.refusal(&inspected));
        }
        let rows = inspected.rows;
        let passes = pass::passes(&job, &rows, &mut moves).map_err(Diagnostic::from)?;
        let header = Header {
            schema: super::files::SCHEMA,
            hash: String::new(),
            text_hash: String::new(),
            robot: robot.to_toml().map_err(Diagnostic::from)?,
            provenance: Provenance::default(),
            moves,
            passes,
            checks: summary(&checks),
            notes,
            stage,
            taught,
            stroke_risk,
            predictions: None,
            check: None,
            job,
        };
        let mut plan = Self { rows, header };
        plan.header.hash = plan.hash().map_err(Diagnostic::from)?;
        Ok(plan)
    }

    /// Time that the program takes at full override, without the waits for the operator, s.
    pub fn duration_s(&self) -> f64 {
        self.row_times_s().sum()
    }

    /// The time of each row: the move to it, and the stop there, s.
    pub fn row_times_s(&self) -> impl Iterator<Item = f64> {
        let motion = &self.header.job.motion;
        self.rows.iter().zip(&self.header.moves).map(|(row, time)| {
            // A pass is waited for as a dwell is, and none follows.
            let stops = row.dwell_s > 0.0 || self.header.passes.iter().any(|pass| pass.end == row.index);
            let still_s = motion.settle_s + row.dwell_s + super::timing::AFTER_STROBE_S;
            time.duration_s + if stops { still_s } else { 0.0 }
        })
    }
}

struct Planner<'a> {
    job: &'a Job,
    robot: &'a Robot,
    rig: &'a Rig<'a>,
}

impl Planner<'_> {
    /// All runs, each in its best branch, and the balls that are to be taught for them.
    fn inspect_all(&self, steps: &[Step], prior: &PlanningPrior) -> (Inspected, Vec<Taught>) {
        let (mut all, mut taught, mut prior) = (Inspected::default(), Vec::new(), prior.clone());
        for run in runs(steps) {
            let first_index = run.start as u32 + 1;
            let best = self.best(steps.get(run).unwrap_or_default(), first_index, &prior, all.rows.last());
            if let Some(start) = best.rows.first() {
                let axes = start.axes_deg.map(f64::to_radians);
                let start = prior.at_start(self.job, self.rig.controller, start.centre, &axes);
                taught.extend(prior.begin(start));
            }
            all.append(best);
        }
        (all, taught)
    }

    /// The run in its best branch: that with the largest margin that has no finding; when all have, that with the
    /// largest margin.
    fn best(
        &self,
        run: &[Step],
        first_index: u32,
        prior: &PlanningPrior,
        before: Option<&PlanRow>,
    ) -> Inspected {
        let Some(first) = run.first() else { return Inspected::default() };
        let first_pose =
            |why: &Unsolved| Inspected::refused(unreachable(first_index, first.pose.position.into(), why));
        let starts = match self.rig.starts(first) {
            Ok(starts) => starts,
            Err(why) => return first_pose(&why),
        };
        let mut failed = None;
        let mut turns: Vec<(f64, [f64; AXES])> = Vec::new();
        for start in &starts {
            match self.rig.follow(self.job, run, first_index, start) {
                Ok(branch) => turns.extend(branch.starts),
                Err(finding) => failed = failed.or(Some(finding)),
            }
        }
        turns.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let mut best: Option<Inspected> = None;
        for (_, start) in turns.into_iter().take(TRIED) {
            let Ok(branch) = self.rig.follow(self.job, run, first_index, &start) else { continue };
            let inspected = self.inspect(branch.rows, prior, before);
            if inspected.findings.is_empty() && inspected.judge(self.job).iter().all(Check::holds) {
                return inspected;
            }
            best = best.or(Some(inspected));
        }
        match (best, failed) {
            (Some(best), _) => best,
            (None, Some(finding)) => Inspected::refused(finding),
            (None, None) => first_pose(&Unsolved::OutOfReach),
        }
    }

    /// Follows all motions of a run finely.
    fn inspect(&self, rows: Vec<PlanRow>, prior: &PlanningPrior, before: Option<&PlanRow>) -> Inspected {
        let Some(start) = rows.first() else { return Inspected::default() };
        let axes = start.axes_deg.map(f64::to_radians);
        let cell = Cell::new(self.job, self.rig, prior, start.centre, &axes);
        let mut inspector = Inspector::new(&cell, self.robot, start);
        let mut paces = Vec::with_capacity(rows.len());
        let mut from = before;
        let mut aux = None;
        let passes = match pass::groups(&rows) {
            Ok(passes) => passes,
            Err(ungrouped) => return Inspected::refused(ungrouped.finding),
        };
        for (at, row) in rows.iter().enumerate() {
            let pass = passes.iter().find(|pass| pass.holds(at));
            let path = match pass {
                Some(pass) if at == pass.end => pass.path(self.job, from, &rows),
                Some(_) => {
                    paces.push(None);
                    continue;
                }
                None if row.is_auxiliary() => {
                    aux = Some(row);
                    paces.push(None);
                    continue;
                }
                None => from.map(|from| path(from, aux.take(), row)),
            };
            paces.push(inspector.follow(from.zip(path), row));
            from = Some(row);
        }
        inspector.finish();
        let Inspector { worst, findings, margins, .. } = inspector;
        Inspected { rows, paces, worst, findings, margins }
    }

    /// What cannot be reached, then the limits that are not kept.
    fn refusal(&self, inspected: &Inspected) -> Refusal {
        let Inspected { rows, findings: lost, .. } = inspected;
        let mut broken = inspected.judge(self.job);
        broken.retain(|check| !check.holds());
        let recommended = recommendations(self.job, self.rig, rows, lost, &broken);
        let limits = broken.iter().map(|check| PlanFinding::from(check).into());
        Refusal {
            findings: lost.iter().cloned().map(Diagnostic::from).chain(limits).collect(),
            recommendations: recommended.into_iter().map(Diagnostic::from).collect(),
        }
    }
}
