//! Poses chosen from what can be reached, as steps: one module for each base ball.

use std::f64::consts::{FRAC_PI_2, PI};

use super::PlanningPrior;
use super::cell::{Cell, Reach};
use super::job::{CentreTable, Job, Optimise};
use super::module::module;
use super::prior::{length_sigma_mm, touching};
use super::refusal::Refusal;
use super::rig::Rig;
use super::stage::Stage;
use super::steps::{Step, Walk, least_marker};
use super::workspace::workspace;
use crate::catalogue::{JobFinding, PlanFinding};
use crate::design::{Candidate, Criterion, Exchange, Near, change_rows, design_rows, workspace_rows};
use crate::diagnostic::Diagnostic;
use crate::estimation::Posterior;
use crate::math::distributions::normal_deviate;
use crate::robot::BallId;
use crate::robot::inverse::status;
use crate::robot::parameter;
use crate::robot::pose::{rot_x, rot_z};

/// Poses of the workspace over which the 3-D error is made least.
const POSES: usize = 400;
/// Start poses that are tried where the ball is known by touching it alone, and poses by which they are compared.
const STARTS: usize = 40;
const COMPARED: usize = 150;
/// Poses of the smallest stage.
const FEWEST: u32 = 6;

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

impl About<'_> {
    /// The poses that are allowed besides the start.
    fn others(&self) -> impl Iterator<Item = &Candidate> {
        self.allowed.iter().filter(|pose| **pose != self.start)
    }
}

/// What can be reached about one base ball.
struct Scan {
    ball: BallId,
    /// Anywhere.
    reach: Vec<Candidate>,
    /// Near the orientation in which the ball was taught, or with the tool down.
    near: Vec<Candidate>,
}

impl Scan {
    /// The poses from which a run may start: from there the ball can be touched with the tool held alike.
    fn starts<'c>(&'c self, chooser: &'c Chooser<'_>) -> impl Iterator<Item = &'c Candidate> {
        let touches = |start: &&Candidate| {
            touching(chooser.job, chooser.rig.controller, self.ball.number(), &start.axes).is_some()
        };
        self.near.iter().chain(&self.reach).filter(touches)
    }

    /// The controller's axis angles at which it touches the ball, as at the first start, degrees.
    fn touching(&self, chooser: &Chooser<'_>) -> Option<String> {
        let axes = self.starts(chooser).find_map(|start| {
            touching(chooser.job, chooser.rig.controller, self.ball.number(), &start.axes)
        })?;
        Some(axes.map(|angle| format!("{:.4}", angle.to_degrees())).join(", "))
    }
}

/// What can be measured about all base balls, for a number of poses.
struct Survey<'a> {
    points: u32,
    /// Greatest risk of one pose: that of the whole run is shared among its poses.
    risk: f64,
    abouts: Vec<About<'a>>,
    stage: Stage,
}

impl Survey<'_> {
    /// Poses to choose, besides the starts, and those to choose from.
    fn count(&self) -> usize {
        (self.points as usize).saturating_sub(self.abouts.len())
    }

    fn pool(&self) -> usize {
        self.abouts.iter().map(|about| about.others().count()).sum()
    }
}

/// Chooses the job's poses, of this share of the risk that is allowed.
///
/// # Errors
/// Why none could be chosen, and what would help.
pub(crate) fn steps(job: &Job, rig: &Rig<'_>, prior: &PlanningPrior, share: f64) -> Result<Chosen, Refusal> {
    let wanted = job.optimise.clone().unwrap_or_default();
    let risk = share * job.limits.max_stroke_risk;
    let chooser =
        Chooser { job, rig, prior, risk, share: wanted.candidates as usize / job.centres.len().max(1) };
    let scans: Result<Vec<Scan>, PlanFinding> = job.centres.iter().map(|table| chooser.scan(table)).collect();
    let scans = scans.map_err(|finding| Refusal {
        findings: vec![finding.into()],
        recommendations: vec![PlanFinding::FewInReach { reachable: 0, wanted: wanted.points }.into()],
    })?;
    let survey = chooser.safe(&scans, &wanted)?;
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
        return Err(Diagnostic::from(PlanFinding::NoPath).into());
    }
    Ok(Chosen { steps: walk.steps, notes, stage: staged.then_some(survey.stage) })
}

struct Chooser<'a> {
    job: &'a Job,
    rig: &'a Rig<'a>,
    prior: &'a PlanningPrior,
    /// Greatest risk of all poses together.
    risk: f64,
    /// Candidates for each base ball.
    share: usize,
}

impl<'a> Chooser<'a> {
    /// What can be measured safely: all poses wanted, or as many of a stage as can be, down to the fewest.
    fn safe(&self, scans: &[Scan], wanted: &Optimise) -> Result<Survey<'a>, Refusal> {
        let halves = std::iter::successors(Some(wanted.stage_points), |points| Some(points / 2));
        let stages = halves.take_while(|points| *points >= FEWEST).filter(|points| *points < wanted.points);
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
            if enough && !(whole && survey.stage.bars_many() && wanted.stage_points < points) {
                return Ok(survey);
            }
            let few = PlanFinding::TooFewPoses { allowed: survey.pool(), wanted: points as usize };
            // Where the risk bars none, fewer poses make none safer.
            if survey.stage.barred == 0 {
                let reach = PlanFinding::FewInReach { reachable: survey.stage.reachable, wanted: points };
                return Err(Refusal { findings: vec![few.into()], recommendations: vec![reach.into()] });
            }
            refused = Some(few);
        }
        let help = scans.iter().filter_map(|scan| self.help(scan)).map(Diagnostic::from).collect();
        let findings = refused.into_iter().map(Diagnostic::from).collect();
        Err(Refusal { findings, recommendations: help })
    }

    /// Of the smallest stage.
    fn least_risk(&self) -> f64 {
        self.risk / f64::from(FEWEST)
    }

    fn survey(&self, scans: &[Scan], points: u32) -> Result<Survey<'a>, PlanFinding> {
        let risk = self.risk / f64::from(points.max(1));
        let abouts: Result<Vec<_>, _> = scans.iter().map(|scan| self.about(scan, risk)).collect();
        let abouts = abouts?;
        let stage = Stage {
            lengths: self.prior.lengths,
            reachable: abouts.iter().map(|about| about.reachable).sum(),
            barred: abouts.iter().map(|about| about.barred).sum(),
        };
        Ok(Survey { points, risk, abouts, stage })
    }

    /// What makes the fewest poses of a stage about a ball safe: that it is taught, or a stroke.
    fn help(&self, scan: &Scan) -> Option<PlanFinding> {
        let ball = scan.ball;
        if let Some(axes_deg) = self.prior.untaught(ball).then(|| scan.touching(self)).flatten() {
            return Some(PlanFinding::TeachFirst { ball: ball.number(), axes_deg });
        }
        let needed = |start: &Candidate| {
            let cell = self.cell(start);
            let mut sd: Vec<f64> = scan.near.iter().chain(&scan.reach).map(|pose| cell.sd_mm(pose)).collect();
            sd.sort_by(f64::total_cmp);
            let most = sd.get(FEWEST as usize)?.max(cell.sd_mm(start));
            Some(
                normal_deviate(self.least_risk().ln()) * most
                    + least_marker(&self.job.bar, self.job.bar.length_mm),
            )
        };
        let starts = scan.starts(self).take(STARTS).filter_map(needed);
        let half_mm = starts.fold(f64::INFINITY, f64::min);
        let [low_mm, high_mm] = self.job.bar.stroke_mm;
        half_mm.is_finite().then_some(PlanFinding::StrokeNeeded {
            ball: ball.number(),
            half_mm,
            low_mm,
            high_mm,
        })
    }

    /// The cell for a run that starts there.
    fn cell(&self, start: &Candidate) -> Cell<'a> {
        Cell::new(self.job, self.rig, self.prior, start.ball.number(), &start.axes)
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

    /// What can be reached about one base ball, be it safe or not.
    fn scan(&self, table: &CentreTable) -> Result<Scan, PlanFinding> {
        let &Self { job, rig, prior, share, .. } = self;
        let ball = BallId::new(table.id).unwrap_or(BallId::FIRST);
        // Nothing is barred here: only the limits and the rest of the cell count.
        let anywhere = Cell::new(job, rig, prior, table.id, &[0.0; 6]);
        let candidates =
            |count, branch, near| anywhere.candidates(table.id, count, &Reach { risk: 1.0, branch, near });
        // Where the ball was taught the risk is least in that branch, with the tool held as then.
        let taught = table.taught_deg.map(|deg| deg.map(f64::to_radians));
        let branch = taught.map(|axes| status(rig.arm, &axes) & 7);
        let reach = candidates(share, branch, None);
        let first = reach.first().ok_or(PlanFinding::NoPose { ball: table.id })?;
        let branch = Some(status(rig.arm, &first.axes) & 7);
        let near = match taught {
            Some(axes) => {
                let orientation = rig.arm.ball(&axes).rotation;
                let exactly = candidates(COMPARED / 2, branch, Some(Near::exactly(orientation)));
                [exactly, candidates(COMPARED, branch, Some(Near::about(orientation)))].concat()
            }
            // Else with the tool down, from where the others can be reached.
            None => [0.0, FRAC_PI_2, PI, -FRAC_PI_2]
                .map(|spin| candidates(COMPARED, branch, Some(Near::about(rot_x(PI) * rot_z(spin)))))
                .into_iter()
                .max_by_key(Vec::len)
                .unwrap_or_default(),
        };
        Ok(Scan { ball, reach, near })
    }

    /// Start and candidates about one base ball, each of a risk of at most `risk`.
    fn about(&self, scan: &Scan, risk: f64) -> Result<About<'a>, PlanFinding> {
        let ball = scan.ball.number();
        let start = self.start(scan, risk).ok_or(PlanFinding::NoSafeStart { ball })?;
        let cell = self.cell(&start);
        let reachable = scan.reach.len();
        let mut allowed = scan.reach.clone();
        allowed.retain(|pose| cell.risk(pose) <= risk);
        let barred = reachable - allowed.len();
        if barred > reachable / 10 {
            let branch = Some(status(self.rig.arm, &start.axes) & 7);
            let near = Some(Near::about(start.pose.rotation));
            allowed = cell.candidates(ball, self.share, &Reach { risk, branch, near });
        }
        Ok(About { cell, start, reachable, barred, allowed })
    }

    /// The start from which most of the poses are safe.
    fn start(&self, scan: &Scan, risk: f64) -> Option<Candidate> {
        let marker = least_marker(&self.job.bar, self.job.bar.length_mm);
        scan.starts(self)
            .filter(|start| self.cell(start).risk_out(start, marker) <= risk)
            .take(STARTS)
            .map(|start| {
                let cell = self.cell(start);
                let others = scan.near.iter().take(COMPARED).chain(scan.reach.iter().take(COMPARED));
                (start, others.filter(|other| cell.risk(other) <= risk).count())
            })
            .max_by_key(|(_, count)| *count)
            .map(|(start, _)| start.clone())
    }

    /// The poses that determine most, besides the starts, which are measured as well.
    fn choose(&self, survey: &Survey<'_>) -> Result<Vec<Candidate>, Diagnostic> {
        let mut pool: Vec<Candidate> = Vec::new();
        for about in &survey.abouts {
            pool.extend(about.others().cloned());
        }
        let criterion = self.job.optimise.as_ref().map(|optimise| optimise.criterion).unwrap_or_default();
        let unknown = self.unknown()?;
        let sigma_mm = length_sigma_mm(self.job, self.rig.controller);
        let rows = design_rows(&unknown, &pool, sigma_mm);
        let mut exchange = match (criterion, &self.prior.calibrated) {
            (Criterion::Change, None) => return Err(PlanFinding::NotCalibrated.into()),
            (Criterion::Change, Some(expected)) => {
                Exchange::for_changes(&rows, change_rows(expected, &pool, sigma_mm))
            }
            (Criterion::D | Criterion::I, _) => {
                let poses = workspace(self.job, self.rig.controller, POSES);
                Exchange::new(&rows, &workspace_rows(&unknown, &poses))
            }
        };
        let chosen = exchange.choose(survey.count(), criterion);
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
