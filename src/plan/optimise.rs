//! Poses chosen from what can be reached, as steps: one module for each base ball.

use std::f64::consts::{FRAC_PI_2, PI};

use super::PlanningPrior;
use super::cell::{Cell, Reach};
use super::job::{self, CentreTable, Job};
use super::module::module;
use super::prior::{length_sigma_mm, touching};
use super::rig::Rig;
use super::stage::Stage;
use super::steps::{Step, Walk, least_marker};
use super::workspace::workspace;
use crate::catalogue::{JobFinding, PlanFinding};
use crate::design::{Candidate, Criterion, Exchange, design_rows, workspace_rows};
use crate::diagnostic::Diagnostic;
use crate::estimation::Posterior;
use crate::robot::inverse::status;
use crate::robot::parameter;
use crate::robot::pose::{rot_x, rot_z};

/// Poses of the workspace over which the 3-D error is made least.
const POSES: usize = 400;
/// Start poses that are tried where the ball is known by touching it alone, and poses by which they are compared.
const STARTS: usize = 40;
const COMPARED: usize = 150;

/// The steps of the chosen poses, and what was found about them.
pub(crate) struct Chosen {
    pub(crate) steps: Vec<Step>,
    pub(crate) notes: Vec<PlanFinding>,
    /// Where not every pose is allowed yet.
    pub(crate) stage: Option<Stage>,
}

/// What can be measured about one base ball.
struct About<'a> {
    cell: Cell<'a>,
    start: Candidate,
    /// Poses that can be reached, and how many of them the risk bars.
    reachable: usize,
    barred: usize,
    /// Poses that are allowed.
    allowed: Vec<Candidate>,
}

/// What can be measured about all base balls, for a number of poses.
struct Survey<'a> {
    points: u32,
    /// Greatest risk of one pose: that of the whole run is shared among its poses.
    risk: f64,
    abouts: Vec<About<'a>>,
    stage: Stage,
}

/// Chooses the job's poses.
///
/// # Errors
/// Why none could be chosen.
pub(crate) fn steps(job: &Job, rig: &Rig<'_>, prior: &PlanningPrior) -> Result<Chosen, Diagnostic> {
    let wanted = job.optimise.clone().unwrap_or_default();
    let chooser = Chooser { job, rig, prior, share: wanted.candidates as usize / job.centres.len().max(1) };
    let mut survey = chooser.survey(wanted.points)?;
    if survey.stage.bars_many() && wanted.stage_points < survey.points {
        survey = chooser.survey(wanted.stage_points)?;
    }
    let staged = survey.points < wanted.points;
    let mut notes = chooser.notes(&survey, staged);
    let chosen = chooser.choose(&survey)?;
    let mut walk = Walk::new(job);
    walk.circle = job.circles.len() as u32;
    for about in &survey.abouts {
        let ball = about.start.ball.number();
        let poses: Vec<Candidate> = chosen.iter().filter(|c| c.ball.number() == ball).cloned().collect();
        if poses.is_empty() {
            notes.push(PlanFinding::NothingChosen { ball });
            continue;
        }
        notes.extend(module(&mut walk, &about.cell, &about.start, poses, survey.risk));
    }
    if walk.steps.is_empty() {
        return Err(PlanFinding::NoPath.into());
    }
    Ok(Chosen { steps: walk.steps, notes, stage: staged.then_some(survey.stage) })
}

struct Chooser<'a> {
    job: &'a Job,
    rig: &'a Rig<'a>,
    prior: &'a PlanningPrior,
    /// Candidates for each base ball.
    share: usize,
}

impl<'a> Chooser<'a> {
    fn survey(&self, points: u32) -> Result<Survey<'a>, PlanFinding> {
        let risk = self.job.limits.max_stroke_risk / f64::from(points.max(1));
        let abouts: Result<Vec<_>, _> =
            self.job.centres.iter().map(|table| self.about(table, risk)).collect();
        let abouts = abouts?;
        let stage = Stage {
            lengths: self.prior.lengths,
            reachable: abouts.iter().map(|about| about.reachable).sum(),
            barred: abouts.iter().map(|about| about.barred).sum(),
        };
        Ok(Survey { points, risk, abouts, stage })
    }

    fn notes(&self, survey: &Survey<'_>, staged: bool) -> Vec<PlanFinding> {
        let few = survey.abouts.iter().filter(|about| about.reachable < self.share);
        let mut notes: Vec<PlanFinding> = few
            .map(|about| PlanFinding::FewCandidates {
                ball: about.start.ball.number(),
                found: about.reachable,
                wanted: self.share,
            })
            .collect();
        let Stage { lengths, barred, reachable } = survey.stage;
        notes.extend(match (staged, lengths, barred) {
            (true, 0, _) => Some(PlanFinding::FirstStage { barred, reachable }),
            (true, ..) => Some(PlanFinding::FurtherStage { lengths, barred, reachable }),
            (false, _, 0) => None,
            (false, ..) => Some(PlanFinding::Barred { barred, reachable }),
        });
        notes
    }

    /// Start and candidates about one base ball, each of a risk of at most `risk`.
    fn about(&self, table: &CentreTable, risk: f64) -> Result<About<'a>, PlanFinding> {
        let &Self { job, rig, prior, share } = self;
        let centre = table.id;
        // Nothing is barred here: only the limits and the rest of the cell count.
        let anywhere = Cell::new(job, rig, prior, centre, &[0.0; 6]);
        // Where the ball was taught the risk is least in that branch, with the tool held as then.
        let taught = table.taught_deg.map(|deg| deg.map(f64::to_radians));
        let branch = taught.map(|axes| status(rig.arm, &axes) & 7);
        let reach = anywhere.candidates(centre, share, &Reach { risk: 1.0, branch, near: None });
        let first = reach.first().ok_or(PlanFinding::NoPose { ball: centre })?;
        let branch = Some(status(rig.arm, &first.axes) & 7);
        // Else with the tool down, from where the others can be reached.
        let down = [0.0, FRAC_PI_2, PI, -FRAC_PI_2].map(|spin| rot_x(PI) * rot_z(spin));
        let orientations = taught.map_or(down.to_vec(), |axes| vec![rig.arm.ball(&axes).rotation]);
        let near = orientations.into_iter().map(|orientation| {
            anywhere.candidates(centre, COMPARED, &Reach { risk: 1.0, branch, near: Some(orientation) })
        });
        let near = near.max_by_key(Vec::len).unwrap_or_default();
        let start = self.start(&near, &reach, risk).ok_or(PlanFinding::NoSafeStart { ball: centre })?.clone();
        let cell = Cell::new(job, rig, prior, centre, &start.axes);
        let reachable = reach.len();
        let mut allowed = reach;
        allowed.retain(|pose| cell.risk(pose) <= risk);
        let barred = reachable - allowed.len();
        if barred > reachable / 10 {
            let near = Some(start.pose.rotation);
            allowed = cell.candidates(centre, share, &Reach { risk, branch, near });
        }
        Ok(About { cell, start, reachable, barred, allowed })
    }

    /// The start from which most of the poses are safe.
    fn start<'c>(&self, near: &'c [Candidate], reach: &'c [Candidate], risk: f64) -> Option<&'c Candidate> {
        let &Self { job, rig, prior, .. } = self;
        let marker = least_marker(&job.bar, job.bar.length_mm);
        let at = |start: &Candidate| Cell::new(job, rig, prior, start.ball.number(), &start.axes);
        near.iter()
            .chain(reach)
            .filter(|start| touching(job, rig.controller, start.ball.number(), &start.axes).is_some())
            .filter(|start| at(start).risk_out(start, marker) <= risk)
            .take(STARTS)
            .map(|start| {
                let cell = at(start);
                let others = near.iter().take(COMPARED).chain(reach.iter().take(COMPARED));
                (start, others.filter(|other| cell.risk(other) <= risk).count())
            })
            .max_by_key(|(_, count)| *count)
            .map(|(start, _)| start)
    }

    /// The poses that determine most, besides the starts, which are measured as well.
    fn choose(&self, survey: &Survey<'_>) -> Result<Vec<Candidate>, Diagnostic> {
        let mut pool: Vec<Candidate> = Vec::new();
        for about in &survey.abouts {
            pool.extend(about.allowed.iter().filter(|pose| **pose != about.start).cloned());
        }
        let wanted = survey.points as usize;
        let count = wanted.saturating_sub(survey.abouts.len());
        if pool.len() < count {
            return Err(PlanFinding::TooFewPoses { allowed: pool.len(), wanted }.into());
        }
        let criterion = match self.job.optimise.as_ref().map(|optimise| optimise.criterion) {
            Some(job::Criterion::D) => Criterion::D,
            Some(job::Criterion::I) | None => Criterion::I,
        };
        let unknown = self.unknown()?;
        let rows = design_rows(&unknown, &pool, length_sigma_mm(self.job, self.rig.controller));
        let moved = workspace_rows(&unknown, &workspace(self.job, self.rig.controller, POSES));
        let mut exchange = Exchange::new(&rows, &moved);
        let chosen = exchange.choose(count, criterion);
        Ok(chosen.iter().filter_map(|&at| pool.get(at).cloned()).collect())
    }

    /// What the poses are to determine: all that is not known, or only the parameters that the job lists, with what
    /// the maker promises of these.
    fn unknown(&self) -> Result<Posterior, JobFinding> {
        let &Self { job, rig, prior, .. } = self;
        let robot = rig.controller;
        let Some(list) = job.optimise.as_ref().and_then(|wanted| wanted.parameters.clone()) else {
            return Ok(prior.posterior.clone());
        };
        let ids = parameter::parse_list(&list, &robot.parallel_joints(), job.centres.len())
            .map_err(|why| JobFinding::Parameters { list: list.clone(), why: why.to_string() })?;
        let all = PlanningPrior::of_maker(job, robot);
        let sd: Option<Vec<f64>> = ids.iter().map(|id| all.sd(*id)).collect();
        let sd = sd.ok_or(JobFinding::ParametersWithoutPrior { list })?;
        Ok(Posterior::new(prior.posterior.model.clone(), &ids, &sd))
    }
}
