//! `dbbd archive fleet`.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use serde_json::json;

use crate::cli::{CommandOutcome, CommandOutput};
use dbbd_job::files;
use dbbd_model::base::date;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;
use dbbd_plant::ArchiveFinding;
use dbbd_plant::fleet::{Assumptions, RunPosterior, fleet};
use dbbd_plant::{Archive, ArchivedResult, IdentifySettings, RunSelection, WrittenPosterior};

/// A result as the estimation of the fleet takes it; `None` if it has no posterior or no date.
fn of_result(result: &ArchivedResult, kind: &str, bar: &str) -> Option<RunPosterior> {
    let written = WrittenPosterior::read(result.found.posterior.as_ref()?)?;
    let size = written.parameters.len();
    let covariance = DMatrix::from_fn(size, size, |i, j| written.covariance[i.max(j)][i.min(j)]);
    Some(RunPosterior {
        robot: result.robot.clone(),
        kind: kind.into(),
        bar: bar.into(),
        day: date::day_number(result.measured.split('T').next()?)?,
        ids: written.parameters,
        corrections: DVector::from_vec(written.corrections),
        covariance,
        prior: written.prior,
    })
}

/// Writes fleet.json, and a robot file for each type.
pub(super) fn run(
    archive: &mut Archive,
    selection: &RunSelection,
    directory: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let settings = IdentifySettings::new(&[])?;
    let results = archive.results(selection, Some(&settings))?;
    let runs: BTreeMap<String, [String; 2]> =
        archive.list(selection)?.into_iter().map(|run| (run.sha256, [run.kind, run.bar])).collect();
    let mut newest: BTreeMap<&str, RunPosterior> = BTreeMap::new();
    let mut example: BTreeMap<&str, &str> = BTreeMap::new();
    for result in &results {
        let Some([kind, bar]) = runs.get(&result.run) else { continue };
        if let Some(run) = of_result(result, kind, bar) {
            newest.insert(&result.run, run);
            example.insert(kind, &result.run);
        }
    }
    let posteriors: Vec<RunPosterior> = newest.into_values().collect();
    let used = posteriors.len();
    if let left @ 1.. = runs.len() - used {
        out.finding(ArchiveFinding::NotInFleet { left, runs: runs.len() });
    }
    let estimated = fleet(&posteriors, &Assumptions::default()).filter(|_| used > 0);
    let fleet = estimated.ok_or(ArchiveFinding::NoFleet { results: used })?;
    files::directory(directory)?;
    let mut written = Vec::new();
    for kind in &fleet.types {
        let Some(run) = example.get(kind.kind.as_str()) else { continue };
        let Some(text) = archive.result_file(run, "robot-identified.toml")? else { continue };
        let identified = Robot::from_toml("robot-identified.toml", &String::from_utf8_lossy(&text))?;
        let Some(robot) = identified.nominal.and_then(|nominal| kind.robot(&nominal)) else { continue };
        let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
        let name = format!("{}.toml", kind.kind.chars().map(plain).collect::<String>());
        files::write_file(&directory.join(&name), robot.to_toml()?)?;
        written.push(name);
    }
    out.findings(fleet.findings());
    let crashed = fleet.robots.iter().filter(|robot| !robot.crashes.is_empty());
    let crashes: Vec<_> =
        crashed.map(|robot| json!({ "robot": robot.robot, "days": robot.crashes })).collect();
    let document = json!({
        "results": used, "unusable": fleet.unusable, "robots": fleet.robots.len(), "bars": fleet.bars,
        "changed": crashes, "types": written,
    });
    files::write_file(&directory.join("fleet.json"), serialised::json(&document)? + "\n")?;
    out.document(&document)?;
    out.result(format!("{used} results, {} robots, {} bars", fleet.robots.len(), fleet.bars.len()));
    Ok(CommandOutcome::Done)
}
