//! The shortest run that reaches a goal: about which balls, with which bar, with how many poses.
//!
//! A search compares bars and sets of balls by the root mean square of the position error that poses about them leave, with the usual
//! errors of joints (`search.rs`). What a plan leaves is then taken from robots that are drawn from what is known, as an
//! identification would find them: the goal is reached if 90 % of them keep it. How the two depend on each other is learnt from the runs
//! that were judged (`kept.rs`), until a plan and its goal agree.

mod kept;
mod limits;
pub mod outcome;
mod search;

use self::kept::{GoalRun, JudgedRun, KeptErrors, RunClass};
use self::limits::GoalLimit;
use self::outcome::{GoalOutcome, GoalPoint};
use self::search::GoalSearch;
use super::job::{GoalTable, Job};
use super::prediction::{first_model, lengths_at, planned_lengths};
use super::prior::KnownCell;
use super::workspace::goal_poses;
use super::{Plan, Refusal};
use crate::plan::PlanFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::PlannedLengths;
use dbbd_model::measurement::Measurement;

/// The share of the drawn robots that keep the goal.
const SHARE: f64 = 0.9;
/// Kinds of robots that are drawn: each has variances of its own, and is drawn a hundred times.
const ROBOT_KINDS: u64 = 24;
/// Poses of each tool over which the error of a plan is taken.
const GOAL_POSES: usize = 300;
/// Plans that are made until one reaches the goal without being much better.
const PLANS: usize = 5;
/// A plan that leaves less than this share of the goal has more poses than it needs.
const MUCH_BETTER: f64 = 0.93;
/// A plan aims at the middle of what is good enough. After the first one that falls short the next aims lower by this share, then by its
/// square, its fourth power and so on: the plans of two runs with nearly as many poses differ by a few percent, not always in favour of the
/// longer one, and of runs with few poses by more.
const AIM: f64 = 0.965;
/// A source of uncertainty without which more than this share is left does not limit a goal.
const LIMITS: f64 = 0.97;
/// Runs of a class that are judged by the poses of the search before a plan is made.
const MAX_JUDGED: usize = 4;

/// What is known of the cell of a job.
type CellOfJob<'a> = dyn Fn(Job) -> Result<KnownCell, Diagnostic> + 'a;

/// A plan for a goal, with its cell.
struct GoalPlan {
    plan: Plan,
    known: KnownCell,
    outcome: GoalOutcome,
}

/// The shortest plan that reaches a goal, with its cell. `mounted` is the cell with the balls that are mounted already, `cell` returns what is
/// known of a job with further balls.
///
/// # Errors
/// The goal is below what any run reaches, or takes longer than the time that is available; or the plans are refused.
pub fn plan_for_goal(
    goal: &GoalTable,
    mounted: &KnownCell,
    cell: &CellOfJob<'_>,
) -> Result<(Plan, KnownCell), Refusal> {
    if goal_poses(&mounted.job, &mounted.robot, GOAL_POSES).iter().any(|tool| tool.poses.is_empty()) {
        return Err(Diagnostic::from(PlanFinding::NoPoseOfRegion).into());
    }
    let search = GoalSearch::new(&mounted.job, goal, &mounted.robot, &mounted.prior);
    GoalPlanner { goal, search, cell }.plan()
}

struct GoalPlanner<'a> {
    goal: &'a GoalTable,
    search: GoalSearch<'a>,
    cell: &'a CellOfJob<'a>,
}

impl GoalPlanner<'_> {
    fn plan(&self) -> Result<(Plan, KnownCell), Refusal> {
        if self.search.best_in(None, |_| true).is_none() {
            return Err(Diagnostic::from(PlanFinding::NoPlaceForBall).into());
        }
        let mut judged = self.judged_runs()?;
        let goal_mm = self.goal.position_mm;
        let (mut shortest, mut refused) = (None::<GoalPlan>, Vec::<(GoalRun, Refusal)>::new());
        let (mut tried, mut aim_mm, mut lower) = (Vec::new(), AIM * goal_mm, AIM);
        let mut short = Vec::<GoalRun>::new();
        for _ in 0..PLANS {
            // Other balls may have ways where the poses about some have none.
            let is_refused = |run: &GoalRun| refused.iter().any(|(other, _)| other.is_about(run));
            let wanted = |run: &GoalRun| (!is_refused(run)).then(|| judged.wanted_mm(run, aim_mm));
            let run = self.search.shortest_beyond(&short, wanted);
            let Some(run) = run.filter(|run| self.is_in_time(run) && !tried.contains(run)) else { break };
            tried.push(run);
            let found = match self.planned(&run, &judged) {
                Ok(found) => found,
                Err(refusal) => {
                    refused.push((run, refusal));
                    continue;
                }
            };
            let GoalOutcome { reached_mm, minutes, .. } = found.outcome;
            judged.add(JudgedRun { run, search_mm: self.search.error_mm(&run), kept_mm: reached_mm });
            let is_close = found.plan.header.stage.is_some() || reached_mm > MUCH_BETTER * goal_mm;
            let is_reached = self.is_reached(&found.outcome);
            if is_reached && shortest.as_ref().is_none_or(|other| minutes < other.outcome.minutes) {
                shortest = Some(found);
            }
            if is_reached && is_close {
                break;
            }
            (aim_mm, lower) = if reached_mm > goal_mm {
                short.push(run);
                (aim_mm * lower, lower * lower)
            } else {
                (AIM * goal_mm, AIM)
            };
        }
        let mut best_mm = None;
        if shortest.is_none() && refused.is_empty() {
            let most = self.search.best_in(self.goal.minutes, |_| true);
            let most = most.and_then(|run| self.planned(&run, &judged).ok());
            best_mm = most.as_ref().map(|found| found.outcome.reached_mm);
            shortest = most.filter(|found| self.is_reached(&found.outcome));
        }
        match (shortest, refused.pop()) {
            (Some(GoalPlan { mut plan, outcome, known }), _) => {
                plan.header.goal = Some(outcome);
                Ok((plan, known))
            }
            (None, Some((_, refusal))) => Err(refusal),
            (None, None) => Err(self.refusal(&judged, best_mm)?),
        }
    }

    fn is_reached(&self, outcome: &GoalOutcome) -> bool {
        outcome.reached_mm <= outcome.position_mm
            && self.goal.minutes.is_none_or(|minutes| outcome.minutes <= minutes)
    }

    fn is_in_time(&self, run: &GoalRun) -> bool {
        self.goal.minutes.is_none_or(|minutes| self.search.time_s(run) <= 60.0 * minutes)
    }

    /// Runs that are judged by the poses of the search, before a plan is made: of each class the shortest one, as long as it can be
    /// shorter than those that reach the goal.
    fn judged_runs(&self) -> Result<KeptErrors, Refusal> {
        let (mut judged, mut shortest_s) = (KeptErrors::default(), f64::INFINITY);
        // Robots keep no less than the error of the search.
        let min_s = |class: &RunClass| {
            let of_class = |run: &GoalRun| (run.class() == *class).then_some(self.goal.position_mm);
            self.search.shortest(of_class).map_or(f64::INFINITY, |run| self.search.time_s(&run))
        };
        let mut classes: Vec<(f64, RunClass)> =
            self.search.classes().into_iter().map(|class| (min_s(&class), class)).collect();
        classes.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (min_s, class) in classes {
            let is_hopeless = min_s.is_infinite() && !judged.is_empty();
            if min_s >= shortest_s || is_hopeless {
                continue;
            }
            for _ in 0..MAX_JUDGED {
                let wanted = |run: &GoalRun| {
                    (run.class() == class).then(|| judged.wanted_mm(run, self.goal.position_mm))
                };
                let run = self.search.shortest(wanted).filter(|run| self.is_in_time(run));
                let run = run.or_else(|| self.search.best_in(self.goal.minutes, |run| run.class() == class));
                let Some(run) = run.filter(|run| !judged.has(run)) else { break };
                let known = (self.cell)(self.search.job(&run))?;
                let Some(kept_mm) = self.reached_mm(&known, &self.lengths_of_search(&run, &known)) else {
                    break;
                };
                judged.add(JudgedRun { run, search_mm: self.search.error_mm(&run), kept_mm });
                if kept_mm <= self.goal.position_mm {
                    shortest_s = shortest_s.min(self.search.time_s(&run));
                }
            }
        }
        Ok(judged)
    }

    /// The lengths of a run at the poses of the search, in place of a plan.
    fn lengths_of_search(&self, run: &GoalRun, known: &KnownCell) -> Vec<Measurement> {
        lengths_at(&known.job, &self.search.poses(run), &known.prior.posterior.model)
    }

    /// The plan of a run. A stage is judged by the poses of the search, of which it has the first ones.
    fn planned(&self, run: &GoalRun, judged: &KeptErrors) -> Result<GoalPlan, Refusal> {
        let known = (self.cell)(self.search.job(run))?;
        let plan = Plan::build_with(&known.job, &known.robot, &known.prior)?;
        let lengths = planned_lengths(&known.job, &plan.rows, &known.prior.posterior.model);
        let of_search_mm = self.search.error_mm(run);
        let reached_mm = if plan.header.stage.is_some() {
            judged.kept_mm(run, of_search_mm)
        } else {
            self.reached_mm(&known, &lengths).unwrap_or(f64::INFINITY)
        };
        let pose_s = self.goal.seconds_per_pose.unwrap_or(plan.duration_s() / lengths.len().max(1) as f64);
        let poses = if plan.header.stage.is_some() { run.poses } else { lengths.len() };
        let mut judged = judged.clone();
        judged.add(JudgedRun { run: *run, search_mm: of_search_mm, kept_mm: reached_mm });
        let outcome = GoalOutcome {
            position_mm: self.goal.position_mm,
            of: self.goal.of,
            reached_mm,
            minutes: self.search.time_with(run, pose_s, poses) / 60.0,
            curve: self.search.curve(&judged, self.search.slower(run, pose_s)),
        };
        Ok(GoalPlan { plan, known, outcome })
    }

    /// The position error that 90 % of the drawn robots keep after an identification of these lengths, mm. `None` if a number is
    /// not finite.
    fn reached_mm(&self, known: &KnownCell, planned: &[Measurement]) -> Option<f64> {
        let KnownCell { job, robot, prior } = known;
        let (start, options) = (first_model(robot, prior), prior.options(job, None));
        let lengths = PlannedLengths::new(prior.identification(robot, &start, &options), planned).ok()?;
        let robots = lengths.drawn_errors(&goal_poses(job, robot, GOAL_POSES), ROBOT_KINDS)?;
        let mut errors: Vec<f64> = robots.iter().map(|error| self.goal.of.of(error)).collect();
        errors.sort_by(f64::total_cmp);
        let kept = (SHARE * errors.len() as f64).ceil() as usize;
        errors.get(kept.saturating_sub(1)).copied().filter(|error| error.is_finite())
    }

    /// The best run leaves more than the goal in the time that is available, `planned_mm` by its plan: what would reach it, or what
    /// limits it.
    fn refusal(&self, judged: &KeptErrors, planned_mm: Option<f64>) -> Result<Refusal, Refusal> {
        let Some(best) = self.search.best_in(self.goal.minutes, |_| true) else {
            return Ok(Diagnostic::from(PlanFinding::NoTimeForPoses).into());
        };
        let known = (self.cell)(self.search.job(&best))?;
        let left = |known: &KnownCell| self.reached_mm(known, &self.lengths_of_search(&best, known));
        let point = self.search.point(&best, judged, 1.0);
        let best_mm = left(&known).unwrap_or(point.position_mm);
        let (goal_mm, of) = (self.goal.position_mm, self.goal.of.name());
        let GoalPoint { minutes, poses, balls, bar_mm, .. } = point;
        let left_mm = planned_mm.unwrap_or(best_mm);
        let not_reached =
            PlanFinding::GoalNotReached { goal_mm, of, best_mm: left_mm, minutes, poses, balls, bar_mm };
        let longer = self.search.shortest(|run| Some(judged.wanted_mm(run, goal_mm))).map(|run| {
            let GoalPoint { minutes, poses, balls, bar_mm, .. } = self.search.point(&run, judged, 1.0);
            PlanFinding::GoalTakesLonger { minutes, poses, balls, bar_mm }
        });
        let mut limits: Vec<(GoalLimit, f64)> = GoalLimit::ALL
            .into_iter()
            .filter_map(|limit| Some((limit, left(&limit.removed(&known))?)))
            .filter(|(_, left_mm)| *left_mm < LIMITS * best_mm)
            .collect();
        limits.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut further: Vec<PlanFinding> = longer.into_iter().collect();
        further.extend(
            limits.iter().map(|&(limit, left_mm)| PlanFinding::GoalLimited { source: limit.name(), left_mm }),
        );
        if further.is_empty() {
            further.push(PlanFinding::GoalLimitedByPlaces);
        }
        Ok(Refusal {
            findings: vec![not_reached.into()],
            recommendations: further.into_iter().map(Diagnostic::from).collect(),
        })
    }
}
