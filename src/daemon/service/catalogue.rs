//! What there is to choose from: ports, protocols, robots, plans.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde_json::{Value, json};

use super::names;
use crate::device::port;
use crate::device::protocol::Definition;
use crate::diagnostic::Diagnostic;
use crate::live::Catalogue;
use crate::plan::Kind;
use crate::recording::run;
use crate::robot::Robot;

/// One of the lists, under its name.
pub(super) fn list(which: Catalogue, plans: &Path) -> Result<Value, Diagnostic> {
    Ok(match which {
        Catalogue::Ports => json!({ "ports": port::list()? }),
        Catalogue::Protocols => json!({ "protocols": protocols() }),
        Catalogue::Robots => {
            let names: Vec<&str> = Robot::built_in().iter().map(|(name, _)| *name).collect();
            json!({ "robots": names })
        }
        Catalogue::Plans => json!({ "plans": all_plans(plans) }),
    })
}

fn protocols() -> Vec<Value> {
    let all = Definition::built_in().iter();
    all.filter_map(|(name, text)| Definition::from_toml(name, text).ok())
        .map(|one| {
            json!({
                "id": one.id, "title": one.title, "confidence": one.confidence, "baud": one.line.baud,
                "nominal_hz": one.nominal_hz, "resolution_mm": one.resolution_mm(),
            })
        })
        .collect()
}

/// The file of a plan by its name, where the name is one.
pub(super) fn plan_file(plans: &Path, name: &str) -> Option<PathBuf> {
    Some(plans.join(name).join("plan.csv")).filter(|path| names::is_sound(name) && path.is_file())
}

/// The newest first: it is the one that is driven next.
fn all_plans(plans: &Path) -> Vec<Value> {
    let entries = fs::read_dir(plans).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut found: Vec<(Option<SystemTime>, String, PathBuf)> = names
        .filter_map(|name| {
            let csv = plan_file(plans, &name)?;
            let written = fs::metadata(&csv).and_then(|file| file.modified()).ok();
            Some((written, name, csv))
        })
        .collect();
    found.sort_by(|(a, first, _), (b, second, _)| b.cmp(a).then_with(|| first.cmp(second)));
    found.iter().map(|(_, name, csv)| describe(name, csv)).collect()
}

fn describe(name: &str, csv: &Path) -> Value {
    match run::read_plan(csv) {
        Ok(plan) => {
            let poses = plan.rows.iter().filter(|row| row.kind != Kind::Transit).count();
            let (job, robot) = (&plan.header.job, Robot::from_toml("robot", &plan.header.robot));
            json!({
                "name": name, "robot": robot.map(|robot| robot.name).ok(), "poses": poses,
                "circles": job.circles.len(), "bar_length_mm": job.bar.length_mm,
                "stroke_mm": job.bar.stroke_mm, "protocol": job.bar.protocol, "hash": plan.header.hash,
                "duration_s": plan.duration_s(), "error": null,
            })
        }
        Err(error) => json!({ "name": name, "error": error.to_string(), "code": error.code }),
    }
}
