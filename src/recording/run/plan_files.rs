//! The one loader of a plan: from its two files, or from the attachments of a capture.

use std::collections::BTreeMap;
use std::path::Path;

use crate::base::{date, files};
use crate::catalogue::{FileFinding, PlanFinding};
use crate::diagnostic::Diagnostic;
use crate::plan::Plan;
use crate::provenance::{Identity, Provenance};

/// The names of a plan's files among the attachments of a capture.
const ATTACHED_CSV: &str = "plan.csv";
const ATTACHED_JSON: &str = "plan.json";
const ATTACHED_ROBOT: &str = "robot.toml";
/// What was stated of the run when it began.
pub const ATTACHED_IDENTITY: &str = "identity.toml";

/// Longer than the files of any plan: 1000 poses take a few hundred kB.
const MOST_BYTES: u64 = 8 << 20;

/// A plan with the texts that it was read from.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanFiles {
    pub plan: Plan,
    pub csv: String,
    pub json: String,
}

impl PlanFiles {
    /// The plan whose rows are in the CSV at `csv`, with the .json beside it.
    pub fn read(csv: &Path) -> Result<Self, Diagnostic> {
        let json = csv.with_extension("json");
        let (csv_name, json_name) = (csv.display().to_string(), json.display().to_string());
        if csv.is_file() && !json.is_file() {
            return Err(Diagnostic::file(&csv_name, PlanFinding::NoHeader { json: json_name }));
        }
        let (csv, json) = (files::read_at_most(csv, MOST_BYTES)?, files::read_at_most(&json, MOST_BYTES)?);
        let plan = Plan::from_files(&csv_name, &csv, &json_name, &json)?;
        Ok(Self { plan, csv, json })
    }

    /// The files that a capture of a run of the plan carries, by their names.
    pub fn attachments(self) -> [(&'static str, String); 3] {
        [(ATTACHED_CSV, self.csv), (ATTACHED_JSON, self.json), (ATTACHED_ROBOT, self.plan.header.robot)]
    }
}

/// As [`PlanFiles::read`], without the texts.
pub fn read_plan(csv: &Path) -> Result<Plan, Diagnostic> {
    PlanFiles::read(csv).map(|files| files.plan)
}

/// The plan among the attachments of the capture `run`; `None` if there is none.
pub fn attached_plan(run: &str, attachments: &BTreeMap<String, Vec<u8>>) -> Result<Option<Plan>, Diagnostic> {
    let text = |name: &str| attached_text(run, attachments, name);
    let (Some(csv), Some(json)) = (text(ATTACHED_CSV)?, text(ATTACHED_JSON)?) else { return Ok(None) };
    let name = |file: &str| format!("{run}: {file}");
    Plan::from_files(&name(ATTACHED_CSV), csv, &name(ATTACHED_JSON), json).map(Some)
}

/// Whose the run is as a whole: what its plan states, with what was stated when it began, at `started` by the capture's own
/// clock (ns since the Unix epoch).
///
/// # Errors
/// What is wrong in the attachment.
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

/// Why the plan or the identity that is attached to a capture cannot be read; `None` where both can, or there are none.
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

/// The plan of a capture and what the capture was made from, as far as its attachments can be read: what cannot is refused
/// where the run is used.
///
/// # Errors
/// As [`Plan::traced`].
pub fn sources(
    attachments: &BTreeMap<String, Vec<u8>>,
    started: Option<u64>,
    dbbd: Option<String>,
) -> Result<(Option<Plan>, Provenance), Diagnostic> {
    let plan = attached_plan("the capture", attachments).ok().flatten();
    let identity = identity("the capture", plan.as_ref(), attachments, started);
    let made = Provenance::of(&plan.as_ref().map(Plan::traced).transpose()?);
    let (dbbd, identity) = (dbbd.unwrap_or_default(), identity.unwrap_or_default());
    Ok((plan, Provenance { dbbd, identity, ..made }))
}

/// The text of an attachment, if it is there.
pub(super) fn attached_text<'a>(
    run: &str,
    attachments: &'a BTreeMap<String, Vec<u8>>,
    name: &str,
) -> Result<Option<&'a str>, Diagnostic> {
    let text = attachments.get(name).map(|content| std::str::from_utf8(content));
    text.transpose().map_err(|_| Diagnostic::file(&format!("{run}: {name}"), FileFinding::NotUtf8))
}
