//! Poses chosen from what can be reached, as steps: one module for each base ball.

use std::f64::consts::{FRAC_PI_2, PI};

use super::Knowledge;
use super::candidates::{Candidate, moves, rows};
use super::cell::Cell;
use super::datasheet::{datasheet, length_sigma_mm};
use super::job::{self, Job};
use super::knowledge::touching;
use super::module::module;
use super::rig::Rig;
use super::stage::Stage;
use super::steps::{Step, Walk, least_knock};
use super::workspace::workspace;
use crate::identifiability::{Belief, Criterion, Exchange};
use crate::model::inverse::status;
use crate::model::pose::{rot_x, rot_z};
use crate::model::{ParamId, Robot, parameter};

/// Poses of the workspace over which the 3-D error is made least.
const POSES: usize = 400;
/// Start poses that are tried where the ball is known by touching it alone, and poses by which they are compared.
const STARTS: usize = 40;
const COMPARED: usize = 150;

/// The steps of the chosen poses, and what there is to say about them.
pub(crate) struct Chosen {
    pub(crate) steps: Vec<Step>,
    pub(crate) notes: Vec<String>,
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

/// Chooses the job's poses.
///
/// # Errors
/// Why none could be chosen.
pub(crate) fn steps(job: &Job, rig: &Rig<'_>, known: &Knowledge) -> Result<Chosen, String> {
    let wanted = job.optimise.clone().unwrap_or_default();
    // The risk of the whole run is shared among its poses.
    let shared = |points: u32| job.limits.max_stroke_risk / f64::from(points.max(1));
    let share = wanted.candidates as usize / job.centres.len().max(1);
    let look = |points: u32| -> Result<(Vec<About<'_>>, Stage), String> {
        let abouts: Result<Vec<_>, _> =
            job.centres.iter().map(|table| about(job, rig, known, table.id, share, shared(points))).collect();
        let abouts = abouts?;
        let stage = Stage {
            lengths: known.lengths,
            reachable: abouts.iter().map(|about| about.reachable).sum(),
            barred: abouts.iter().map(|about| about.barred).sum(),
        };
        Ok((abouts, stage))
    };
    let (mut abouts, mut stage) = look(wanted.points)?;
    let mut points = wanted.points;
    if stage.bars_many() && wanted.stage_points < points {
        points = wanted.stage_points;
        (abouts, stage) = look(points)?;
    }
    let mut notes = Vec::new();
    let few = abouts.iter().filter(|about| about.reachable < share);
    notes.extend(few.map(|about| {
        let (ball, found) = (about.start.centre, about.reachable);
        format!("base ball {ball}: {found} of {share} candidates can be reached within the limits")
    }));
    let staged = points < wanted.points;
    if staged {
        notes.push(stage.to_string());
    } else if stage.barred > 0 {
        notes.push(format!(
            "{} of {} poses that can be reached are barred, because their length might leave the stroke",
            stage.barred, stage.reachable
        ));
    }
    let risk = shared(points);
    // The starts are measured as well.
    let others = |about: &About<'_>| {
        about.allowed.iter().filter(|pose| **pose != about.start).cloned().collect::<Vec<_>>()
    };
    let pool: Vec<Candidate> = abouts.iter().flat_map(others).collect();
    let count = (points as usize).saturating_sub(abouts.len());
    if pool.len() < count {
        return Err(format!(
            "{} poses can be reached within the limits and the stroke, {points} are wanted; a longer stroke, a known \
             ball (taught_deg) or a robot of less tolerance would allow more",
            pool.len(),
        ));
    }
    let chosen = choose(job, rig, known, &pool, count)?;
    let mut walk = Walk::new(job);
    walk.circle = job.circles.len() as u32;
    for about in &abouts {
        let ball = about.start.centre;
        let poses: Vec<Candidate> = chosen.iter().filter(|c| c.centre == ball).cloned().collect();
        if poses.is_empty() {
            notes.push(format!("base ball {ball}: no pose about it was worth choosing"));
            continue;
        }
        module(&mut walk, &about.cell, &about.start, poses, risk, &mut notes);
    }
    if walk.steps.is_empty() {
        return Err("none of the chosen poses can be reached from another".into());
    }
    Ok(Chosen { steps: walk.steps, notes, stage: staged.then_some(stage) })
}

/// Start and candidates about one base ball, each of a risk of at most `risk`.
fn about<'a>(
    job: &'a Job,
    rig: &'a Rig<'a>,
    known: &Knowledge,
    centre: u32,
    share: usize,
    risk: f64,
) -> Result<About<'a>, String> {
    // Nothing is barred here: only the limits and the rest of the cell count.
    let anywhere = Cell::new(job, rig, known, centre, &[0.0; 6]);
    // Where the ball was taught the risk is least in that branch, with the tool held as then.
    let table = job.centres.get(centre.saturating_sub(1) as usize);
    let taught = table.and_then(|table| table.taught_deg).map(|deg| deg.map(f64::to_radians));
    let branch = taught.map(|axes| status(rig.arm, &axes) & 7);
    let reach = anywhere.candidates(centre, share, 1.0, branch, None);
    let none = || format!("no pose about base ball {centre} can be reached within the limits");
    let branch = Some(status(rig.arm, &reach.first().ok_or_else(none)?.axes) & 7);
    // Else with the tool down, from where the others can be reached.
    let down = [0.0, FRAC_PI_2, PI, -FRAC_PI_2].map(|spin| rot_x(PI) * rot_z(spin));
    let holds = taught.map_or(down.to_vec(), |axes| vec![rig.arm.ball(&axes).rotation]);
    let near = holds.iter().map(|hold| anywhere.candidates(centre, COMPARED, 1.0, branch, Some(hold)));
    let near = near.max_by_key(Vec::len).unwrap_or_default();
    let at = |start: &Candidate| Cell::new(job, rig, known, centre, &start.axes);
    let knocks = least_knock(&job.bar, job.bar.length_mm);
    let start = near
        .iter()
        .chain(&reach)
        .filter(|start| touching(job, rig.controller, centre, &start.axes).is_some())
        .filter(|start| at(start).risk_out(start, knocks) <= risk)
        .take(STARTS)
        .map(|start| {
            let cell = at(start);
            let others = near.iter().take(COMPARED).chain(reach.iter().take(COMPARED));
            (start, others.filter(|other| cell.risk(other) <= risk).count())
        })
        .max_by_key(|(_, count)| *count);
    let (start, _) = start.ok_or_else(|| {
        format!(
            "no pose about base ball {centre} is safe enough to start from as the robot is known now: a longer stroke, a \
             ball taught as its taught_deg says, or a robot of less tolerance would allow one"
        )
    })?;
    let (start, cell) = (start.clone(), at(start));
    let reachable = reach.len();
    let mut allowed = reach;
    allowed.retain(|pose| cell.risk(pose) <= risk);
    let barred = reachable - allowed.len();
    if barred > reachable / 10 {
        allowed = cell.candidates(centre, share, risk, branch, Some(&start.pose.rotation));
    }
    Ok(About { cell, start, reachable, barred, allowed })
}

/// The poses that tell most.
fn choose(
    job: &Job,
    rig: &Rig<'_>,
    known: &Knowledge,
    pool: &[Candidate],
    count: usize,
) -> Result<Vec<Candidate>, String> {
    let robot = rig.controller;
    let sigma_mm = length_sigma_mm(job, robot);
    let belief = unknown(job, robot, known)?;
    let candidates = rows(&belief, pool, sigma_mm);
    let moved = moves(&belief, &workspace(job, robot, POSES));
    let criterion = match job.optimise.as_ref().map(|wanted| wanted.criterion).unwrap_or_default() {
        job::Criterion::D => Criterion::D,
        job::Criterion::I => Criterion::I,
    };
    let mut exchange = Exchange::new(&candidates, &moved);
    exchange.extend(count, Criterion::D);
    exchange.improve(Criterion::D);
    if criterion == Criterion::I {
        exchange.improve(Criterion::I);
    }
    Ok(exchange.chosen().iter().filter_map(|&at| pool.get(at).cloned()).collect())
}

/// What the poses are to tell: all that is not known, or only the parameters that the job lists, with what the maker
/// promises of these.
fn unknown(job: &Job, robot: &Robot, known: &Knowledge) -> Result<Belief, String> {
    let Some(list) = job.optimise.as_ref().and_then(|wanted| wanted.parameters.as_deref()) else {
        return Ok(known.belief.clone());
    };
    let ids = parameter::parse_list(list, &robot.parallel_joints(), job.centres.len())
        .map_err(|error| format!("[optimise] parameters = \"{list}\": {error}"))?;
    let all = datasheet(job, robot);
    let sd = |id: &ParamId| all.ids().iter().position(|other| other == id).map(|at| all.sd(at));
    let known_sd: Option<Vec<f64>> = ids.iter().map(sd).collect();
    let sd = known_sd.ok_or("[optimise] parameters: geometric, tool, centres and bar can be listed")?;
    Ok(Belief::new(known.belief.model.clone(), &ids, &sd))
}
