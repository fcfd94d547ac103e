//! The lists to choose from: ports, protocols, robots, plans.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

use serde_json::{Value, json};

use super::runs::{is_plain_directory, is_plain_file, is_sound};
use crate::live::Catalogue;
use dbbd_device::port::{self, PortAddress, PortInfo};
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_device::sync::lock;
use dbbd_job::plan::PoseKind;
use dbbd_job::recording::run;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;

/// A JSON object with the list under its name.
pub(super) fn list_catalogue(
    which: Catalogue,
    plans: &PlanCache,
    directory: &Path,
    configured: Option<&PortAddress>,
) -> Result<Value, Diagnostic> {
    Ok(match which {
        Catalogue::Ports => json!({ "ports": ports(configured)? }),
        Catalogue::Protocols => json!({ "protocols": protocols() }),
        Catalogue::Robots => {
            let names: Vec<&str> = Robot::built_in().iter().map(|(name, _)| *name).collect();
            json!({ "robots": names })
        }
        Catalogue::Plans => json!({ "plans": plans.list(directory) }),
    })
}

/// The ports of this computer, and that of the configuration, which stays in the list whatever is chosen.
fn ports(configured: Option<&PortAddress>) -> Result<Vec<PortInfo>, Diagnostic> {
    let mut ports = port::list_ports()?;
    let missing = configured.filter(|port| !ports.iter().any(|one| one.is(&port.to_string())));
    ports.extend(missing.map(PortInfo::named));
    Ok(ports)
}

fn protocols() -> Vec<Value> {
    let all = ProtocolDefinition::built_in().iter();
    all.filter_map(|(name, text)| ProtocolDefinition::from_toml(name, text).ok())
        .map(|one| {
            json!({
                "id": one.id, "title": one.title, "confidence": one.confidence, "baud": one.line.baud,
                "nominal_hz": one.nominal_hz, "resolution_mm": one.resolution_mm(),
            })
        })
        .collect()
}

/// The file of a plan `NAME` or `ROBOT/NAME`; `None` for an invalid name, and where a link may lead out of `plans`.
pub(super) fn plan_file(plans: &Path, name: &str) -> Option<PathBuf> {
    let mut directory = plans.to_owned();
    for part in name.splitn(2, '/') {
        directory.push(part);
        if !is_sound(part) || !is_plain_directory(&directory) {
            return None;
        }
    }
    let csv = directory.join("plan.csv");
    let is_there = dbbd_job::files::is_there(&csv) && is_plain_file(&csv);
    let is_link = fs::symlink_metadata(csv.with_extension("json")).is_ok_and(|data| data.is_symlink());
    (is_there && !is_link).then_some(csv)
}

/// The names of the directories in a directory.
fn names(directory: &Path) -> impl Iterator<Item = String> {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    entries
        .filter(|entry| is_plain_directory(&entry.path()))
        .filter_map(|entry| entry.file_name().into_string().ok())
}

/// Plans that are listed.
const MAX_LISTED_PLANS: usize = 200;

/// Size and time of a plan's two files. A changed plan has another stamp.
type FileStamps = [Option<(u64, SystemTime)>; 2];

fn stamp(csv: &Path) -> FileStamps {
    [csv.to_owned(), csv.with_extension("json")].map(|path| {
        let data = fs::metadata(path).ok()?;
        Some((data.len(), data.modified().ok()?))
    })
}

/// A cache of the descriptions of plans. Concurrent requests wait, so that only one plan at a time is in memory.
#[derive(Default)]
pub(super) struct PlanCache(Mutex<BTreeMap<String, (FileStamps, Value)>>);

impl PlanCache {
    /// The newest first.
    fn list(&self, plans: &Path) -> Vec<Value> {
        let mut known = lock(&self.0);
        let of_robots = |name: String| {
            let inner: Vec<String> =
                names(&plans.join(&name)).map(|inner| format!("{name}/{inner}")).collect();
            std::iter::once(name).chain(inner)
        };
        let mut found: Vec<(FileStamps, String, PathBuf)> = names(plans)
            .flat_map(of_robots)
            .filter_map(|name| {
                let csv = plan_file(plans, &name)?;
                Some((stamp(&csv), name, csv))
            })
            .collect();
        let written = |stamp: &FileStamps| stamp[0].map(|(_, time)| time);
        found.sort_by(|(a, first, _), (b, second, _)| {
            written(b).cmp(&written(a)).then_with(|| first.cmp(second))
        });
        found.truncate(MAX_LISTED_PLANS);
        let mut described = BTreeMap::new();
        let mut listed = Vec::new();
        for (stamp, name, csv) in found {
            let same = known.remove(&name).filter(|(before, _)| *before == stamp);
            let value = same.map_or_else(|| describe(&name, &csv), |(_, value)| value);
            listed.push(value.clone());
            described.insert(name, (stamp, value));
        }
        *known = described;
        listed
    }
}

fn describe(name: &str, csv: &Path) -> Value {
    match run::read_plan(csv) {
        Ok(plan) => {
            let poses = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).count();
            let (job, robot) = (&plan.header.job, Robot::from_toml("robot", &plan.header.robot));
            json!({
                "name": name, "robot": robot.map(|robot| robot.name).ok(), "poses": poses,
                "circles": job.circles.len(), "bar_length_mm": job.bar.length_mm,
                "stroke_mm": job.bar.stroke_mm, "protocol": job.bar.protocol, "hash": plan.header.hash,
                "duration_s": plan.duration_s(), "error": null,
            })
        }
        Err(error) => json!({ "name": name, "error": error.to_string(), "code": error.code() }),
    }
}
