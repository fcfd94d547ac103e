//! Steps to poses that are chosen among the poses that can be reached: one module for each base ball.

use std::f64::consts::{FRAC_PI_2, PI};

use super::job::{BaseBallTable, Job, OptimiseTable};
use super::module::{ModuleVisits, RoutePlanner, module};
use super::prior::length_sigma_mm;
use super::refusal::Refusal;
use super::stage::Stage;
use super::steps::min_marker;
use super::workspace::goal_poses;
use super::{CandidateConditions, PlanKinematics, PlanStep, PlanningCell, PlanningPrior, StepBuilder};
use crate::plan::PlanFinding;
use crate::plan::job::JobFinding;
use dbbd_model::design::{Candidate, Criterion, Exchange, Near, change_rows, design_rows, tool_rows};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::Posterior;
use dbbd_model::math::distributions::normal_deviate;
use dbbd_model::math::map_items;
use dbbd_model::robot::inverse::status;
use dbbd_model::robot::parameter;
use dbbd_model::robot::pose::{rot_x, rot_z};
use dbbd_model::robot::{BallId, max_axis_difference};

/// Poses of the workspace over which the 3-D error is minimised.
const OPTIMISE_WORKSPACE_POSES: usize = 400;
/// Start poses that are tried about a ball, and poses by which they are compared.
const STARTS: usize = 40;
const COMPARED: usize = 150;
/// Starts that are compared by their ways, and poses to which each has ways or none: the number of ways has a standard
/// deviation of 3, and a part with a third of the poses has one of the starts with a probability of 96 %.
const RESTARTS: usize = 8;
const WAYS: usize = 40;
/// Rounds in which poses without a path are replaced by others: where a fifth has none, all but one in 600 have one then.
const ROUNDS: usize = 3;
/// Poses of the smallest stage.
const MIN_STAGE_POSES: u32 = 6;

pub(super) struct ChosenSteps {
    pub(super) steps: Vec<PlanStep>,
    pub(super) notes: Vec<PlanFinding>,
    /// Present if not every pose that can be reached is allowed yet.
    pub(super) stage: Option<Stage>,
}

/// The poses about one base ball that can be reached, whatever their stroke risk.
struct ReachablePoses {
    ball: BallId,
    /// Poses in any orientation.
    reach: Vec<Candidate>,
    /// Poses near the orientation in which the ball was taught, or with the tool down.
    near: Vec<Candidate>,
}

impl ReachablePoses {
    /// The poses from which a run may start: from there the ball can be touched with the same orientation.
    fn starts<'c>(&'c self, rig: &'c PlanKinematics<'_>) -> impl Iterator<Item = &'c Candidate> {
        let touches = |start: &&Candidate| rig.touching(self.ball.number(), &start.axes).is_some();
        self.near.iter().chain(&self.reach).filter(touches)
    }

    /// The controller's axis angles at which the tool ball touches the base ball, with the orientation of the first
    /// start, degrees.
    fn touching(&self, rig: &PlanKinematics<'_>) -> Option<String> {
        let axes = self.starts(rig).find_map(|start| rig.touching(self.ball.number(), &start.axes))?;
        Some(axes.map(|angle| format!("{:.4}", angle.to_degrees())).join(", "))
    }
}

/// The safe poses about one base ball.
struct SafePoses<'a> {
    cell: PlanningCell<'a>,
    start: Candidate,
    /// Poses that can be reached, and how many of them are barred by their risk.
    reachable: usize,
    barred: usize,
    allowed: Vec<Candidate>,
}

impl SafePoses<'_> {
    /// The poses that are allowed besides the start.
    fn others(&self) -> impl Iterator<Item = &Candidate> {
        self.allowed.iter().filter(|pose| **pose != self.start)
    }

    /// Keeps the poses to which there is a path from the nearest of those that a module visits.
    fn retain_reached(&mut self, visits: &ModuleVisits, risk: f64) {
        let Some(router) = RoutePlanner::new(&self.cell, self.start.ball.number(), risk) else { return };
        let is_reached = |pose: &Candidate| {
            let turn = |from: &&Candidate| max_axis_difference(&from.axes, &pose.axes);
            let nearest = visits.visited.iter().min_by(|a, b| turn(a).total_cmp(&turn(b)));
            let has_way = nearest.is_some_and(|from| router.way(from, pose).is_some());
            has_way && !visits.left_out.contains(pose)
        };
        let mut reached = map_items(&self.allowed, is_reached).into_iter();
        self.allowed.retain(|_| reached.next() == Some(true));
    }
}

/// The safe poses about all base balls, for a number of poses to choose.
struct SafePoseSearch<'a> {
    points: u32,
    /// Greatest risk of one pose: an equal share of the risk of the whole run.
    risk: f64,
    abouts: Vec<SafePoses<'a>>,
    /// Number of lengths that were measured before.
    lengths: usize,
}

impl SafePoseSearch<'_> {
    /// Number of poses to choose besides the starts.
    fn count(&self) -> usize {
        (self.points as usize).saturating_sub(self.abouts.len())
    }

    /// The steps to chosen poses, in a module for each ball.
    fn route(&self, chosen: &[Candidate], job: &Job) -> Route {
        let mut walk = StepBuilder::new(job);
        walk.circle = job.circles.len() as u32;
        let mut modules = Vec::with_capacity(self.abouts.len());
        for SafePoses { cell, start, .. } in &self.abouts {
            let poses: Vec<Candidate> =
                chosen.iter().filter(|pose| pose.ball == start.ball).cloned().collect();
            let visits =
                if poses.is_empty() { None } else { module(&mut walk, cell, start, poses, self.risk) };
            modules.push(visits);
        }
        Route { steps: walk.steps, modules }
    }

    /// Leaves out the poses to which a route has no path.
    fn leave_out(&mut self, route: &Route) {
        for (about, visits) in self.abouts.iter_mut().zip(&route.modules) {
            let left_out = visits.iter().flat_map(|visits| &visits.left_out).collect::<Vec<_>>();
            about.allowed.retain(|pose| !left_out.contains(&pose));
        }
    }

    fn stage(&self) -> Stage {
        Stage {
            lengths: self.lengths,
            reachable: self.abouts.iter().map(|about| about.reachable).sum(),
            barred: self.abouts.iter().map(|about| about.barred).sum(),
        }
    }

    /// Number of poses to choose from.
    fn pool(&self) -> usize {
        self.abouts.iter().map(|about| about.others().count()).sum()
    }
}

/// The steps to chosen poses, and what the module of each ball visits; `None` where nothing was chosen.
struct Route {
    steps: Vec<PlanStep>,
    modules: Vec<Option<ModuleVisits>>,
}

impl Route {
    /// Whether there is no path to a chosen pose.
    fn is_incomplete(&self) -> bool {
        self.modules.iter().flatten().any(|visits| !visits.left_out.is_empty())
    }
}

/// Chooses the job's poses, with this share of the allowed risk, about each ball in the branch of the arm of this rank by the error that
/// poses there leave, or in the last one.
pub(super) fn choose_steps(
    rig: &PlanKinematics<'_>,
    prior: &PlanningPrior,
    share: f64,
    rank: usize,
) -> Result<ChosenSteps, Refusal> {
    let job = rig.job;
    let wanted = job.optimise.clone().unwrap_or_default();
    let risk = share * job.limits.max_stroke_risk;
    let candidates = wanted.candidates as usize / job.centres.len().max(1);
    let chooser = PoseChooser { rig: *rig, prior, risk, candidates };
    let scans: Result<Vec<ReachablePoses>, PlanFinding> =
        job.centres.iter().map(|table| chooser.scan(table, rank)).collect();
    let scans = scans.map_err(|finding| Refusal {
        findings: vec![finding.into()],
        recommendations: vec![PlanFinding::FewInReach { reachable: 0, wanted: wanted.points }.into()],
    })?;
    let mut survey = chooser.safe(&scans, &wanted)?;
    let staged = survey.points < wanted.points;
    let mut route = survey.route(&chooser.choose(&survey)?, job);
    // Ways that keep the limits connect only a part of the poses, and a start may belong to a small part.
    if route.is_incomplete() {
        survey.abouts = scans
            .iter()
            .zip(survey.abouts)
            .map(|(scan, about)| chooser.restarted(scan, about, survey.risk))
            .collect();
        route = survey.route(&chooser.choose(&survey)?, job);
    }
    for _ in 0..ROUNDS {
        if !route.is_incomplete() {
            break;
        }
        survey.leave_out(&route);
        route = survey.route(&chooser.choose(&survey)?, job);
    }
    // To look for ways among all poses takes long.
    if route.is_incomplete() {
        for (about, visits) in survey.abouts.iter_mut().zip(&route.modules) {
            visits.iter().for_each(|visits| about.retain_reached(visits, survey.risk));
        }
        route = survey.route(&chooser.choose(&survey)?, job);
    }
    let mut notes = chooser.notes(&survey, staged);
    for (about, visits) in survey.abouts.iter().zip(&route.modules) {
        notes.extend(visit_notes(about.start.ball, visits.as_ref()));
        if survey.pool() < survey.count() {
            notes.push(chooser.few_candidates(about.start.ball, about.allowed.len()));
        }
    }
    if route.steps.is_empty() {
        return Err(Diagnostic::from(PlanFinding::NoPath).into());
    }
    Ok(ChosenSteps { steps: route.steps, notes, stage: staged.then_some(survey.stage()) })
}

/// Findings about poses about a ball that were left out.
fn visit_notes(ball: BallId, visits: Option<&ModuleVisits>) -> Vec<PlanFinding> {
    match visits {
        Some(visits) => visits.notes(ball).collect(),
        None => vec![PlanFinding::NothingChosen { ball: ball.number() }],
    }
}

/// The steps to given poses, in modules of one base ball and one branch each.
pub(super) fn given_steps(
    rig: &PlanKinematics<'_>,
    prior: &PlanningPrior,
    poses: &[Candidate],
    share: f64,
) -> Result<ChosenSteps, Refusal> {
    let risk = share * rig.job.limits.max_stroke_risk;
    let mut walk = StepBuilder::new(rig.job);
    let mut groups: Vec<((BallId, u8), Vec<Candidate>)> = Vec::new();
    for pose in poses {
        let key = (pose.ball, status(rig.arm, &pose.axes) & 7);
        match groups.iter_mut().find(|(other, _)| *other == key) {
            Some((_, group)) => group.push(pose.clone()),
            None => groups.push((key, vec![pose.clone()])),
        }
    }
    let mut notes = Vec::new();
    for ((ball, _), mut group) in groups {
        // From the start the ball can be touched.
        let touches = |pose: &Candidate| rig.touching(ball.number(), &pose.axes).is_some();
        let start = group.remove(group.iter().position(touches).unwrap_or(0));
        let cell = PlanningCell::new(*rig, prior, ball.number(), &start.axes);
        let visits = module(&mut walk, &cell, &start, group, risk);
        notes.extend(visit_notes(ball, visits.as_ref()));
    }
    if walk.steps.is_empty() {
        return Err(Diagnostic::from(PlanFinding::NoPath).into());
    }
    Ok(ChosenSteps { steps: walk.steps, notes, stage: None })
}

struct PoseChooser<'a> {
    rig: PlanKinematics<'a>,
    prior: &'a PlanningPrior,
    /// Greatest risk of all poses together.
    risk: f64,
    /// Number of candidates for each base ball.
    candidates: usize,
}

impl<'a> PoseChooser<'a> {
    /// The safe poses: for all requested poses; else for a stage, whose number of poses is halved down to the minimum.
    fn safe(&self, scans: &[ReachablePoses], wanted: &OptimiseTable) -> Result<SafePoseSearch<'a>, Refusal> {
        let halves = std::iter::successors(Some(wanted.stage_points), |points| Some(points / 2));
        let stages =
            halves.take_while(|points| *points >= MIN_STAGE_POSES).filter(|points| *points < wanted.points);
        let mut refused = None;
        for points in [wanted.points].into_iter().chain(stages) {
            let survey = match self.survey(scans, points) {
                Ok(survey) => survey,
                Err(finding) => {
                    refused = Some(finding);
                    continue;
                }
            };
            let whole = points == wanted.points;
            let enough = survey.pool() >= survey.count();
            if enough && !(whole && survey.stage().bars_many() && wanted.stage_points < points) {
                return Ok(survey);
            }
            let few = PlanFinding::TooFewPoses { allowed: survey.pool(), wanted: points as usize };
            // If the risk bars no pose, choosing fewer does not help.
            if survey.stage().barred == 0 {
                let reach = PlanFinding::FewInReach { reachable: survey.stage().reachable, wanted: points };
                return Err(Refusal { findings: vec![few.into()], recommendations: vec![reach.into()] });
            }
            refused = Some(few);
        }
        let help = scans.iter().filter_map(|scan| self.help(scan)).map(Diagnostic::from).collect();
        let findings = refused.into_iter().map(Diagnostic::from).collect();
        Err(Refusal { findings, recommendations: help })
    }

    fn survey(&self, scans: &[ReachablePoses], points: u32) -> Result<SafePoseSearch<'a>, PlanFinding> {
        let risk = self.risk / f64::from(points.max(1));
        let abouts: Result<Vec<_>, _> = scans.iter().map(|scan| self.about(scan, risk)).collect();
        Ok(SafePoseSearch { points, risk, abouts: abouts?, lengths: self.prior.lengths() })
    }

    /// A remedy if even the smallest stage about a ball is not safe: teach the ball, or use a bar with a longer stroke.
    fn help(&self, scan: &ReachablePoses) -> Option<PlanFinding> {
        let (job, ball) = (self.rig.job, scan.ball.number());
        // After lengths were measured, it matters whether the ball was taught.
        let untaught = self.prior.lengths() > 0 && job.ball(ball)?.taught_deg.is_none();
        if let Some(axes_deg) = untaught.then(|| scan.touching(&self.rig)).flatten() {
            return Some(PlanFinding::TeachFirst { ball, axes_deg });
        }
        let min_risk = self.risk / f64::from(MIN_STAGE_POSES);
        let needed = |start: &Candidate| {
            let cell = self.cell(start);
            let mut sd: Vec<f64> = scan.near.iter().chain(&scan.reach).map(|pose| cell.sd_mm(pose)).collect();
            sd.sort_by(f64::total_cmp);
            let most = sd.get(MIN_STAGE_POSES as usize)?.max(cell.sd_mm(start));
            Some(normal_deviate(min_risk.ln()) * most + min_marker(&job.bar, job.bar.length_mm))
        };
        let starts = scan.starts(&self.rig).take(STARTS).filter_map(needed);
        let half_mm = starts.fold(f64::INFINITY, f64::min);
        let [low_mm, high_mm] = job.bar.stroke_mm;
        half_mm.is_finite().then_some(PlanFinding::StrokeNeeded { ball, half_mm, low_mm, high_mm })
    }

    /// The cell for a run that starts at `start`.
    fn cell(&self, start: &Candidate) -> PlanningCell<'a> {
        PlanningCell::new(self.rig, self.prior, start.ball.number(), &start.axes)
    }

    fn notes(&self, survey: &SafePoseSearch<'_>, staged: bool) -> Vec<PlanFinding> {
        let few = survey.abouts.iter().filter(|about| about.reachable < self.candidates);
        let mut notes: Vec<PlanFinding> =
            few.map(|about| self.few_candidates(about.start.ball, about.reachable)).collect();
        let Stage { lengths, barred, reachable } = survey.stage();
        notes.extend(match (staged, lengths, barred) {
            (true, 0, _) => Some(PlanFinding::FirstStage { barred, reachable }),
            (true, ..) => Some(PlanFinding::FurtherStage { lengths, barred, reachable }),
            (false, _, 0) => None,
            (false, ..) => Some(PlanFinding::Barred { barred, reachable }),
        });
        notes
    }

    fn few_candidates(&self, ball: BallId, found: usize) -> PlanFinding {
        PlanFinding::FewCandidates { ball: ball.number(), found, wanted: self.candidates }
    }

    /// The poses about a base ball that can be reached, in the branch of this rank.
    fn scan(&self, table: &BaseBallTable, rank: usize) -> Result<ReachablePoses, PlanFinding> {
        let rig = &self.rig;
        let ball = BallId::new(table.id).unwrap_or(BallId::FIRST);
        // With a risk of 1 only the limits and the obstacles count, so that any start does.
        let anywhere = PlanningCell::new(*rig, self.prior, table.id, &[0.0; 6]);
        let branches = anywhere.branches(table, &self.prior.posterior);
        let branch = branches.get(rank).or(branches.last()).copied();
        let candidates = |count, near| {
            anywhere.candidates(table.id, count, &CandidateConditions { risk: 1.0, branch, near })
        };
        let reach = if branch.is_some() { candidates(self.candidates, None) } else { Vec::new() };
        if reach.is_empty() {
            return Err(PlanFinding::NoPose { ball: table.id });
        }
        // If the ball was taught, the risk is least in that orientation.
        let near = match table.taught_deg.map(|deg| deg.map(f64::to_radians)) {
            Some(axes) => {
                let orientation = rig.arm.ball(&axes).rotation;
                let exactly = candidates(COMPARED / 2, Some(Near::exactly(orientation)));
                [exactly, candidates(COMPARED, Some(Near::about(orientation)))].concat()
            }
            // Otherwise with the tool down.
            None => [0.0, FRAC_PI_2, PI, -FRAC_PI_2]
                .map(|spin| candidates(COMPARED, Some(Near::about(rot_x(PI) * rot_z(spin)))))
                .into_iter()
                .max_by_key(Vec::len)
                .unwrap_or_default(),
        };
        Ok(ReachablePoses { ball, reach, near })
    }

    /// Start and candidates about one base ball with a risk of at most `risk` each.
    fn about(&self, scan: &ReachablePoses, risk: f64) -> Result<SafePoses<'a>, PlanFinding> {
        let start = self.start(scan, risk).ok_or(PlanFinding::NoSafeStart { ball: scan.ball.number() })?;
        Ok(self.safe_poses(scan, risk, start))
    }

    /// The candidates about one base ball with a risk of at most `risk` each in a run from `start`.
    fn safe_poses(&self, scan: &ReachablePoses, risk: f64, start: Candidate) -> SafePoses<'a> {
        let ball = scan.ball.number();
        let cell = self.cell(&start);
        let reachable = scan.reach.len();
        let mut allowed = scan.reach.clone();
        allowed.retain(|pose| cell.risk(pose) <= risk);
        let barred = reachable - allowed.len();
        if barred > reachable / 10 {
            let branch = Some(status(self.rig.arm, &start.axes) & 7);
            let near = Some(Near::about(start.pose.rotation));
            allowed = cell.candidates(ball, self.candidates, &CandidateConditions { risk, branch, near });
        }
        SafePoses { cell, start, reachable, barred, allowed }
    }

    /// The start from which most of the poses are safe.
    fn start(&self, scan: &ReachablePoses, risk: f64) -> Option<Candidate> {
        self.starts(scan, risk).max_by_key(|(_, count)| *count).map(|(start, _)| start.clone())
    }

    /// Safe starts, each with the number of poses that are safe from there.
    fn starts<'c>(
        &'c self,
        scan: &'c ReachablePoses,
        risk: f64,
    ) -> impl Iterator<Item = (&'c Candidate, usize)> {
        let bar = &self.rig.job.bar;
        let marker = min_marker(bar, bar.length_mm);
        scan.starts(&self.rig)
            .filter(move |start| self.cell(start).risk_out(start, marker) <= risk)
            .take(STARTS)
            .map(move |start| {
                let cell = self.cell(start);
                let others = scan.near.iter().take(COMPARED).chain(scan.reach.iter().take(COMPARED));
                (start, others.filter(|other| cell.risk(other) <= risk).count())
            })
    }

    /// The safe poses in a run from the start with ways to most of them. No more poses are barred than in the run `about`.
    fn restarted(&self, scan: &ReachablePoses, about: SafePoses<'a>, risk: f64) -> SafePoses<'a> {
        let mut starts: Vec<_> = self.starts(scan, risk).collect();
        let most = starts.iter().map(|(_, safe)| *safe).max();
        starts.retain(|(_, safe)| Some(*safe) == most);
        // A start that lost more ways than the best one so far is not looked at further.
        let mut best: Option<(&Candidate, usize)> = None;
        for (start, _) in starts.into_iter().take(RESTARTS) {
            let cell = self.cell(start);
            let Some(router) = RoutePlanner::new(&cell, scan.ball.number(), risk) else { continue };
            let most = best.map_or(usize::MAX, |(_, lost)| lost);
            let others = about.others().take(WAYS);
            let lost =
                others.filter(|pose| router.way(start, pose).is_none()).take(most.saturating_add(1)).count();
            if lost <= most {
                best = Some((start, lost));
            }
        }
        let restarted = best.map(|(start, _)| self.safe_poses(scan, risk, start.clone()));
        restarted.filter(|other| other.barred <= about.barred).unwrap_or(about)
    }

    /// The most informative poses besides the starts; the starts are measured as well.
    fn choose(&self, survey: &SafePoseSearch<'_>) -> Result<Vec<Candidate>, Diagnostic> {
        let job = self.rig.job;
        let pool: Vec<Candidate> = survey.abouts.iter().flat_map(SafePoses::others).cloned().collect();
        let criterion = job.optimise.as_ref().map(|optimise| optimise.criterion).unwrap_or_default();
        let unknown = self.unknown()?;
        let sigma_mm = length_sigma_mm(job, self.rig.controller);
        let rows = design_rows(&unknown, &pool, sigma_mm);
        let mut exchange = match (criterion, &self.prior.calibrated) {
            (Criterion::Change, None) => return Err(PlanFinding::NotCalibrated.into()),
            (Criterion::Change, Some(expected)) => {
                Exchange::for_changes(&rows, change_rows(expected, &pool, sigma_mm))
            }
            (Criterion::D | Criterion::I, _) => {
                let tools = goal_poses(job, self.rig.controller, OPTIMISE_WORKSPACE_POSES);
                Exchange::new(&rows, &tool_rows(&unknown, &tools))
            }
        };
        let chosen = exchange.choose(survey.count(), criterion);
        Ok(chosen.iter().filter_map(|&at| pool.get(at).cloned()).collect())
    }

    /// The unknowns that the poses are to determine: those of an identification, with the errors of the joints; or the parameters
    /// that the job lists, with the maker's tolerances as their prior.
    fn unknown(&self) -> Result<Posterior, JobFinding> {
        let (PlanKinematics { job, controller, .. }, prior) = (self.rig, &self.prior.posterior);
        let Some(list) = job.optimise.as_ref().and_then(|wanted| wanted.parameters.clone()) else {
            return Ok(prior.clone());
        };
        let ids = parameter::parse_list(&list, &controller.parallel_joints(), job.centres.len())
            .map_err(|why| JobFinding::Parameters { list: list.clone(), why: why.to_string() })?;
        let all = PlanningPrior::of_maker(job, controller);
        let sd: Option<Vec<f64>> = ids.iter().map(|id| all.sd(*id)).collect();
        let sd = sd.ok_or(JobFinding::ParametersWithoutPrior { list })?;
        Ok(Posterior::new(prior.model.clone(), &ids, &sd))
    }
}
