//! From a job to a plan, or to what stands against it.

use super::advice::advice;
use super::cell::Cell;
use super::check::{Check, Facts, Finding, Inspector, judge, note_speed, path, summary};
use super::solve::{Branch, Rig, runs};
use super::steps::{Step, steps};
use super::timing::{Pace, move_times};
use super::{Header, Job, Plan, PlanRow, optimise, pass, prediction};
use crate::identifiability::Belief;
use crate::model::{Reading, Robot};

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

/// What is known of robot and set-up when a plan is made.
#[derive(Clone, Debug)]
pub struct Knowledge {
    /// The model and its covariance.
    pub belief: Belief,
    /// Whether lengths to these base balls stand behind it. If not, the bar is set to zero at each start.
    pub measured: bool,
}

impl Knowledge {
    /// Before anything is measured: the robot's tolerance, the bar's certificate.
    pub fn datasheet(job: &Job, robot: &Robot) -> Self {
        Self { belief: prediction::datasheet(job, robot), measured: false }
    }

    /// After lengths: the likeliest robot (with the given one as its nominal) and base balls, and what
    /// is known of them. `None` when a number is not finite.
    pub fn learned(job: &Job, robot: &Robot, lengths: &[Reading]) -> Option<Self> {
        let nominal = robot.controller();
        let belief =
            prediction::datasheet(job, nominal).learn(lengths, prediction::length_sigma_mm(job, nominal))?;
        Some(Self { belief, measured: true })
    }

    /// The job and the robot as they are now known: base balls and geometry moved to the likeliest.
    pub fn applied(&self, job: &Job, robot: &Robot) -> (Job, Robot) {
        let (mut job, nominal) = (job.clone(), robot.controller());
        for (table, centre) in job.centres.iter_mut().zip(&self.belief.model.centres) {
            table.xyz_mm = (*centre).into();
        }
        let robot = Robot {
            geometry: self.belief.model.geometry.clone(),
            nominal: Some(Box::new(nominal.clone())),
            ..nominal.clone()
        };
        (job, robot)
    }
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
        let mut steps = steps(job);
        let rig = Rig::new(robot);
        let mut notes = Vec::new();
        if job.optimise.is_some() {
            let (chosen, told) = optimise::steps(job, &rig, known)
                .map_err(|advice| Refused { findings: vec![], advice: vec![advice] })?;
            steps.extend(chosen);
            notes = told;
        }
        let (mut rows, mut paces, mut facts) = (Vec::new(), Vec::new(), Vec::new());
        let mut findings = Vec::new();
        for (first, past) in runs(&steps) {
            let run = steps.get(first..past).unwrap_or_default();
            let mut best = inspect_best(job, robot, &rig, known, run, first as u32 + 1, rows.last());
            rows.append(&mut best.rows);
            paces.append(&mut best.paces);
            facts.append(&mut best.facts);
            findings.append(&mut best.findings);
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
    let refused = |row: u32, xyz_mm: [f64; 3], reason| Inspected {
        rows: Vec::new(),
        paces: Vec::new(),
        facts: Vec::new(),
        findings: vec![Finding::Unsolved { row, xyz_mm, reason }],
    };
    let Some(first) = run.first() else {
        return Inspected { rows: Vec::new(), paces: Vec::new(), facts: Vec::new(), findings: Vec::new() };
    };
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
        return Inspected { rows, paces: Vec::new(), facts: Vec::new(), findings: Vec::new() };
    };
    let axes = start.axes_deg.map(f64::to_radians);
    let cell = Cell::new(job, rig, &known.belief, known.measured, (start.centre, &axes));
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
    let (facts, findings) = (inspector.facts, inspector.findings);
    Inspected { rows, paces, facts, findings }
}
