//! Loads a plan from its two files, or from the attachments of a capture.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::artefact::{kind_of, read_as};
use crate::files;
use crate::plan::Plan;
use crate::plan::PlanFinding;
use dbbd_model::base::FileFinding;
use dbbd_model::base::date;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{ArtefactRole, Identity, Provenance};

/// Names of a plan's files among the attachments of a capture.
const ATTACHED_CSV: &str = "plan.csv";
const ATTACHED_JSON: &str = "plan.json";
const ATTACHED_ROBOT: &str = "robot.toml";
/// The identity stated at the start of a run.
pub const ATTACHED_IDENTITY: &str = "identity.toml";

/// Size limit of a plan's files, bytes: 1000 poses take a few hundred kB.
const MAX_PLAN_FILE_BYTES: u64 = 8 << 20;

#[derive(Clone, Debug, PartialEq)]
pub struct PlanFiles {
    /// The plan.csv.
    pub path: PathBuf,
    pub plan: Plan,
    pub csv: String,
    pub json: String,
}

impl PlanFiles {
    /// Reads the plan that is named by its directory or by one of its two files.
    pub fn read(named: &Path) -> Result<Self, Diagnostic> {
        if named.is_dir() {
            return Self::of_rows(&named.join(ATTACHED_CSV));
        }
        let is_json = named.extension().is_some_and(|extension| extension == "json");
        let is_header = is_json
            && files::read_at_most(named, MAX_PLAN_FILE_BYTES)
                .is_ok_and(|text| kind_of(&text) == Some(ArtefactRole::Plan));
        let csv = if is_header { named.with_extension("csv") } else { named.to_owned() };
        read_as(named, ArtefactRole::Plan, Self::of_rows(&csv))
    }

    /// Reads the plan whose rows are in `csv`, with the .json beside it.
    fn of_rows(csv: &Path) -> Result<Self, Diagnostic> {
        let path = csv.to_owned();
        let json = csv.with_extension("json");
        let (csv_name, json_name) = (csv.display().to_string(), json.display().to_string());
        if files::is_there(csv) && !json.is_file() {
            return Err(Diagnostic::file(&csv_name, PlanFinding::NoHeader { json: json_name }));
        }
        let (csv, json) = (
            files::read_at_most(csv, MAX_PLAN_FILE_BYTES)?,
            files::read_at_most(&json, MAX_PLAN_FILE_BYTES)?,
        );
        let plan = Plan::from_files(&csv_name, &csv, &json_name, &json)?;
        Ok(Self { path, plan, csv, json })
    }

    /// The files that a capture of a run of the plan contains, by name.
    pub fn attachments(self) -> [(&'static str, String); 3] {
        [(ATTACHED_CSV, self.csv), (ATTACHED_JSON, self.json), (ATTACHED_ROBOT, self.plan.header.robot)]
    }
}

/// The plan that is named by its directory or by one of its two files.
pub fn read_plan(named: &Path) -> Result<Plan, Diagnostic> {
    PlanFiles::read(named).map(|files| files.plan)
}

/// The plan among the attachments of the capture `run`, if there is one.
pub fn attached_plan(run: &str, attachments: &BTreeMap<String, Vec<u8>>) -> Result<Option<Plan>, Diagnostic> {
    let text = |name: &str| attached_text(run, attachments, name);
    let (Some(csv), Some(json)) = (text(ATTACHED_CSV)?, text(ATTACHED_JSON)?) else { return Ok(None) };
    let name = |file: &str| format!("{run}: {file}");
    Plan::from_files(&name(ATTACHED_CSV), csv, &name(ATTACHED_JSON), json).map(Some)
}

/// The identity of a run: the identity of its plan, completed by what was stated at the start of the run. `started` is
/// the start by the clock of the recording computer, ns since the Unix epoch.
pub fn identity(
    run: &str,
    plan: Option<&Plan>,
    attachments: &BTreeMap<String, Vec<u8>>,
    started: Option<u64>,
) -> Result<Identity, Diagnostic> {
    let mut identity = plan.map(|plan| plan.header.provenance.identity.clone()).unwrap_or_default();
    if let Some(text) = attached_text(run, attachments, ATTACHED_IDENTITY)? {
        identity.extend(&Identity::from_toml(&format!("{run}: {ATTACHED_IDENTITY}"), text)?);
    }
    identity.measured = started.filter(|ns| *ns > 0).map(date::utc).or(identity.measured);
    Ok(identity)
}

/// The reason why the attached plan or identity of a capture cannot be read.
pub fn unread(
    run: &str,
    attachments: &BTreeMap<String, Vec<u8>>,
    started: Option<u64>,
) -> Option<Diagnostic> {
    let plan = attached_plan(run, attachments);
    let known = plan.as_ref().ok().and_then(Option::as_ref);
    let identity = identity(run, known, attachments, started).err();
    plan.err().or(identity)
}

/// The plan of a capture and its provenance, as far as its attachments can be read. Attachments that cannot be read are
/// refused where the run is used.
pub fn sources(
    attachments: &BTreeMap<String, Vec<u8>>,
    started: Option<u64>,
    dbbd: Option<String>,
) -> Result<(Option<Plan>, Provenance), Diagnostic> {
    let plan = attached_plan("the capture", attachments).ok().flatten();
    let identity = identity("the capture", plan.as_ref(), attachments, started);
    let made = crate::artefact::made_from(&plan.as_ref().map(Plan::traced).transpose()?);
    let (dbbd, identity) = (dbbd.unwrap_or_default(), identity.unwrap_or_default());
    Ok((plan, Provenance { dbbd, identity, ..made }))
}

/// The text of an attachment, if there is one.
pub(super) fn attached_text<'a>(
    run: &str,
    attachments: &'a BTreeMap<String, Vec<u8>>,
    name: &str,
) -> Result<Option<&'a str>, Diagnostic> {
    let text = attachments.get(name).map(|content| std::str::from_utf8(content));
    text.transpose().map_err(|_| Diagnostic::file(format!("{run}: {name}"), FileFinding::NotUtf8))
}
