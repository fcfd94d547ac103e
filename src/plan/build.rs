//! From a job to a plan, or to what stands against it.

use super::advice::advice;
use super::cell::{Cell, Near};
use super::check::{Facts, Finding, Inspector, judge, note_speed, path, summary};
use super::hold::held;
use super::quantity::{Check, Quantity};
use super::rig::Rig;
use super::risk::over_run;
use super::solve::{Branch, runs};
use super::steps::{Step, steps};
use super::timing::{Pace, move_times};
use super::{Header, Job, Knowledge, Plan, PlanRow, optimise, pass};
use crate::model::Robot;

/// How many findings are told.
const TOLD: usize = 10;
/// How many branches are followed finely before the best one's findings stand.
const TRIED: usize = 4;

/// A plan that would not be safe, or not be possible.
#[derive(Clone, Debug, PartialEq)]
pub struct Refused {
    /// What stands against it, in the order of the rows.
    pub findings: Vec<Finding>,
    /// What would help, or why no poses could be chosen.
    pub advice: Vec<String>,
}

impl std::fmt::Display for Refused {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "the plan is refused: {} finding(s)", self.findings.len().max(1))?;
        for finding in self.findings.iter().take(TOLD) {
            write!(out, "\n  {finding}")?;
        }
        if self.findings.len() > TOLD {
            write!(out, "\n  and {} more", self.findings.len() - TOLD)?;
        }
        for advice in &self.advice {
            write!(out, "\n  {advice}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Refused {}

/// A run of rows that was followed finely.
struct Inspected {
    rows: Vec<PlanRow>,
    paces: Vec<Option<Pace>>,
    facts: Vec<Facts>,
    findings: Vec<Finding>,
    /// The worst pose of each row, for the risk of all runs together.
    nears: Vec<Near>,
}

impl Inspected {
    fn nothing(findings: Vec<Finding>) -> Self {
        Self { rows: Vec::new(), paces: Vec::new(), facts: Vec::new(), findings, nears: Vec::new() }
    }
}

impl Plan {
    /// Plans a job for a robot. Where the robot was identified (it carries its nominal one), the poses
    /// are those that the controller, which computes with the nominal one, must be told.
    ///
    /// # Errors
    /// Everything that stands against the plan, with row, value and limit.
    pub fn build(job: &Job, robot: &Robot) -> Result<Self, Refused> {
        Self::build_knowing(job, robot, &Knowledge::datasheet(job, robot))
    }

    /// As [`Plan::build`], with what is known of the robot.
    ///
    /// # Errors
    /// As [`Plan::build`].
    pub fn build_knowing(job: &Job, robot: &Robot, known: &Knowledge) -> Result<Self, Refused> {
        let rig = Rig::new(robot);
        let job =
            &held(job, &rig, known).map_err(|advice| Refused { findings: vec![], advice: vec![advice] })?;
        let mut steps = steps(job);
        let (mut notes, mut stage) = (Vec::new(), None);
        if job.optimise.is_some() {
            let chosen = optimise::steps(job, &rig, known)
                .map_err(|advice| Refused { findings: vec![], advice: vec![advice] })?;
            steps.extend(chosen.steps);
            (notes, stage) = (chosen.notes, chosen.stage);
        }
        let (mut rows, mut paces, mut facts) = (Vec::new(), Vec::new(), Vec::new());
        let (mut findings, mut taught, mut nears) = (Vec::new(), Vec::new(), Vec::new());
        let mut known = known.clone();
        for (first, past) in runs(&steps) {
            let run = steps.get(first..past).unwrap_or_default();
            let mut best = inspect_best(job, robot, &rig, &known, run, first as u32 + 1, rows.last());
            if let Some(start) = best.rows.first() {
                let axes = start.axes_deg.map(f64::to_radians);
                if let (belief, Some(ball)) = known.at_start(job, rig.controller, start.centre, &axes) {
                    known.teach(belief, ball);
                    taught.push(ball);
                }
            }
            rows.append(&mut best.rows);
            paces.append(&mut best.paces);
            facts.append(&mut best.facts);
            findings.append(&mut best.findings);
            nears.append(&mut best.nears);
        }
        // One robot makes all the runs: their risks are not independent.
        let stroke_risk = over_run(&nears);
        if let Some(last) = facts.last_mut() {
            last.note(Quantity::RunRisk, stroke_risk);
        }
        if !findings.is_empty() {
            findings
                .extend(judge(job, &rows, &facts).into_iter().filter(|c| !c.holds()).map(Finding::Beyond));
            let advice = advice(job, &rig, &rows, &findings);
            return Err(Refused { findings, advice });
        }
        let mut moves = move_times(&rows, &paces, &job.motion, robot, u64::from(job.seed));
        for facts in &mut facts {
            let at = facts.position();
            if let (Some(Some(pace)), Some(time)) = (paces.get(at), moves.get(at)) {
                note_speed(facts, pace, time);
            }
        }
        let all = judge(job, &rows, &facts);
        let beyond: Vec<Finding> =
            all.iter().filter(|check| !check.holds()).cloned().map(Finding::Beyond).collect();
        if !beyond.is_empty() {
            let advice = advice(job, &rig, &rows, &beyond);
            return Err(Refused { findings: beyond, advice });
        }
        let checks: Vec<Check> = summary(&all);
        let passes = pass::passes(job, &rows, &mut moves);
        let header = Header {
            schema: super::files::SCHEMA,
            hash: String::new(),
            job: job.clone(),
            robot: robot.to_toml(),
            moves,
            passes,
            checks,
            notes,
            stage,
            taught,
            stroke_risk,
            predictions: None,
        };
        let mut plan = Self { rows, header };
        plan.header.hash = plan.hash();
        Ok(plan)
    }

    /// Time that the program takes at full override, without the waits for the operator, s.
    pub fn duration_s(&self) -> f64 {
        let motion = &self.header.job.motion;
        let moving: f64 = self.header.moves.iter().map(|time| time.duration_s).sum();
        let dwells = self.rows.iter().filter(|row| row.dwell_s > 0.0).map(|row| row.dwell_s);
        // A pass is waited for as a dwell is, and none follows.
        let still: f64 = dwells
            .chain(self.header.passes.iter().map(|_| 0.0))
            .map(|dwell_s| motion.settle_s + dwell_s + super::timing::AFTER_STROBE_S)
            .sum();
        moving + still
    }
}

/// The run in its best branch: that with the largest margin that has no finding; when all have, the
/// largest margin's findings stand.
fn inspect_best(
    job: &Job,
    robot: &Robot,
    rig: &Rig<'_>,
    known: &Knowledge,
    run: &[Step],
    first_index: u32,
    before: Option<&PlanRow>,
) -> Inspected {
    let refused = |row: u32, xyz_mm: [f64; 3], reason| {
        Inspected::nothing(vec![Finding::Unsolved { row, xyz_mm, reason }])
    };
    let Some(first) = run.first() else { return Inspected::nothing(Vec::new()) };
    let starts = match rig.starts(first) {
        Ok(starts) => starts,
        Err(reason) => return refused(first_index, first.pose.position.into(), reason),
    };
    let mut failed = None;
    let mut branches: Vec<Branch> = Vec::new();
    for start in &starts {
        match rig.follow(job, run, first_index, start) {
            Ok(branch) => branches.push(branch),
            Err(reason) => failed = failed.or(Some(reason)),
        }
    }
    branches.sort_by(|a, b| b.margin_deg.total_cmp(&a.margin_deg));
    let mut best: Option<Inspected> = None;
    for branch in branches.into_iter().take(TRIED) {
        let inspected = inspect(job, robot, rig, known, branch.rows, before);
        let clean = inspected.findings.is_empty() && judge_run(job, &inspected);
        if clean {
            return inspected;
        }
        best = best.or(Some(inspected));
    }
    match (best, failed) {
        (Some(best), _) => best,
        (None, Some((row, xyz_mm, reason))) => refused(row, xyz_mm, reason),
        (None, None) => {
            refused(first_index, first.pose.position.into(), crate::model::inverse::Unsolved::OutOfReach)
        }
    }
}

/// Whether every check of a run holds.
fn judge_run(job: &Job, run: &Inspected) -> bool {
    judge(job, &run.rows, &run.facts).iter().all(Check::holds)
}

/// Follows all motions of a run finely.
fn inspect(
    job: &Job,
    robot: &Robot,
    rig: &Rig<'_>,
    known: &Knowledge,
    rows: Vec<PlanRow>,
    before: Option<&PlanRow>,
) -> Inspected {
    let Some(start) = rows.first() else {
        return Inspected::nothing(Vec::new());
    };
    let axes = start.axes_deg.map(f64::to_radians);
    let cell = Cell::new(job, rig, known, start.centre, &axes);
    let mut inspector = Inspector::new(&cell, robot, start);
    let mut paces = Vec::with_capacity(rows.len());
    let mut from = before;
    let mut aux = None;
    let passes = pass::groups(&rows).unwrap_or_default();
    for (at, row) in rows.iter().enumerate() {
        let pass = passes.iter().find(|pass| pass.holds(at));
        let path = match pass {
            Some(pass) if at == pass.end => pass.path(job, from, &rows),
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
    let Inspector { facts, findings, nears, .. } = inspector;
    Inspected { rows, paces, facts, findings, nears }
}
