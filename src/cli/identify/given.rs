//! What an identification starts from: an observations CSV with its robot and balls, or a capture.

use std::error::Error;

use super::Args;
use super::inputs::observations;
use crate::cli::Output;
use crate::cli::robots;
use crate::diag::Diagnostic;
use crate::files;
use crate::identify::{Identified, mistaken_unit};
use crate::model::{AXES, Centre, Observations, Robot};
use crate::report::Source;
use crate::run::{self, Run};
use crate::sync::Synced;

/// Least standard deviation with which a predicted length speaks in the alignment, mm.
const LEAST_SIGMA_MM: f64 = 0.02;

/// Robot, base balls and lengths.
pub(super) struct Given {
    pub(super) robot: Robot,
    pub(super) centres: Vec<Centre>,
    pub(super) observations: Observations,
    /// Standard uncertainty of the bar's length, mm, where it has a certificate.
    pub(super) bar_u_mm: Option<f64>,
    pub(super) sources: Vec<Source>,
    /// What is to be doubted of a run: lost parts, poses dropped as ambiguous, another robot.
    pub(super) doubts: Vec<String>,
    /// Whether the axis angles are those that were commanded in a capture, none having been measured.
    pub(super) commanded: bool,
    /// The capture that the lengths come from, and how it was joined last.
    joined: Option<(Box<Run>, Synced)>,
}

impl Given {
    /// Reads what the command line names.
    ///
    /// # Errors
    /// What is missing or wrong, with its file and line.
    pub(super) fn read(args: &Args, out: &Output) -> Result<Self, Box<dyn Error>> {
        let input = args.input.display().to_string();
        let joined = if run::is_capture(&args.input)? {
            let run = run::open(&args.input, None, &[], &mut |note| out.note(&note))?;
            let synced = run.timed();
            Some((Box::new(run), synced))
        } else {
            None
        };
        let observations = match &joined {
            Some((_, synced)) => synced.observations.clone(),
            None => observations(&args.input)?,
        };
        if observations.rows.is_empty() {
            return Err(Diagnostic::file(&input, "no length could be matched to a pose")
                .help("`dbbd sync` tells for each pose why")
                .into());
        }
        let mut robot = match (&args.robot, &joined) {
            (Some(name), _) => robots::named(name)?,
            (None, Some((run, _))) => run.robot()?,
            (None, None) => return Err("an observations CSV needs --robot NAME|FILE".into()),
        };
        if let Some(tool) = args.tool {
            robot.geometry.tool = tool.into();
        }
        let centres = match (&args.centres, &joined) {
            (Some(path), _) => Centre::from_csv(&path.display().to_string(), &files::read(path)?)?,
            (None, Some((run, _))) => run.centres(),
            (None, None) => {
                return Err("an observations CSV needs --centres C.csv with the base balls".into());
            }
        };
        check_lengths(&input, &observations, &robot, &centres)?;
        let source = |role: &str, name: String| Source { role: role.into(), name, hash: None };
        let from_plan = || "the plan in the capture".to_owned();
        let sources = vec![
            source("lengths", input),
            source(
                "base balls",
                args.centres.as_ref().map_or_else(from_plan, |path| path.display().to_string()),
            ),
            source("robot", args.robot.clone().unwrap_or_else(from_plan)),
        ];
        let doubts = joined.as_ref().map_or_else(Vec::new, |(run, synced)| doubts(run, synced, &robot));
        let commanded = joined.as_ref().is_some_and(|(run, _)| run.axes_deg.is_empty());
        // The job has it expanded, k = 2.
        let certified = joined.as_ref().and_then(|(run, _)| run.plan.header.job.bar.length_u_mm);
        let bar_u_mm = args.bar_u.or(certified.map(|u| 0.5 * u));
        Ok(Self { robot, centres, observations, bar_u_mm, sources, doubts, commanded, joined })
    }

    /// Joins the capture anew with the lengths that the identified robot predicts; whether the pairs changed.
    pub(super) fn align_again(&mut self, found: &Identified) -> bool {
        let Some((run, before)) = &mut self.joined else { return false };
        let model = &found.model;
        let length = |centre: usize, axes_deg: &[f64; AXES]| match model.centres.get(centre.wrapping_sub(1)) {
            Some(centre) => {
                model.geometry.length(&axes_deg.map(f64::to_radians), centre, model.bar_offset(0))
            }
            None => f64::NAN,
        };
        let synced = run.observations(Some((length, (3.0 * found.result.sigma_mm).max(LEAST_SIGMA_MM))));
        if synced.same_pairs(before) || synced.observations.rows.is_empty() {
            return false;
        }
        self.observations = synced.observations.clone();
        self.doubts = doubts(run, &synced, &self.robot);
        *before = synced;
        true
    }
}

/// Parts of the run that were lost, poses that were dropped, and another robot than the plan's.
fn doubts(run: &Run, synced: &Synced, robot: &Robot) -> Vec<String> {
    let torn = run.torn.then(|| "a part of the run was lost: `dbbd info` names the damages".to_owned());
    let matching = synced.warnings.iter().filter(|warning| warning.doubt).map(|warning| warning.text.clone());
    let planned = run.robot().ok().map(|planned| planned.name).filter(|name| *name != robot.name);
    let other =
        planned.map(|planned| format!("the poses are of a plan for {planned}, --robot names {}", robot.name));
    torn.into_iter().chain(matching).chain(other).collect()
}

/// Every observation must have its ball, in millimetres and degrees.
pub(super) fn check_lengths(
    file: &str,
    observations: &Observations,
    robot: &Robot,
    centres: &[Centre],
) -> Result<(), Diagnostic> {
    for row in &observations.rows {
        if row.centre > centres.len() {
            let message = format!(
                "index {}: base ball {} is not among the {} given by --centres",
                row.index,
                row.centre,
                centres.len()
            );
            return Err(Diagnostic::file(file, message));
        }
    }
    match mistaken_unit(&robot.geometry, centres, &observations.rows) {
        Some((columns, unit)) => Err(Diagnostic::file(
            file,
            format!("{columns} seem to be {unit}: in these the lengths are those of the poses"),
        )
        .help("convert the table: lengths in mm, angles in degrees")),
        None => Ok(()),
    }
}

/// Observations that only check must be of the bars that were identified.
pub(super) fn check_bars(file: &str, observations: &Observations, bars: usize) -> Result<(), Diagnostic> {
    match observations.rows.iter().find(|row| row.bar > bars) {
        Some(row) => {
            let message =
                format!("index {}: bar {} is not among the {bars} of the input", row.index, row.bar);
            Err(Diagnostic::file(file, message))
        }
        None => Ok(()),
    }
}
