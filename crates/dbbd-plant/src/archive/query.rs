//! The runs of the archive and their files.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::database::Database;
use super::{Archive, ColumnKind};
use crate::ArchiveFinding::{
    self, EndsBefore, InFuture, ManyRuns, NoRun, NoneOf, NoneSelected, NotAMoment, NotAName, NotDigits,
};
use dbbd_job::files;
use dbbd_model::base::date;
use dbbd_model::diagnostic::Diagnostic;

/// Minimum number of digits of a SHA-256 that identify a run.
const MIN_HASH_DIGITS: usize = 6;

/// The row of a run. Texts are empty if unknown.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ArchivedRun {
    /// SHA-256 of the capture.
    pub sha256: String,
    pub cell: String,
    /// Serial number of the robot, else the name of its model.
    pub robot: String,
    /// Name of the robot's model.
    #[serde(rename = "type")]
    pub kind: String,
    /// Serial number of the bar.
    pub bar: String,
    pub certificate: Option<String>,
    pub certified_on: Option<String>,
    pub operator: Option<String>,
    /// Date and time of the measurement, UTC.
    pub measured: String,
    /// Hash of the plan.
    pub plan: Option<String>,
    pub bytes: u64,
    /// Decision of the check that was pushed with the run: `pass`, `fail` or `undecided`.
    pub decision: Option<String>,
    /// JSON of [`dbbd_model::provenance::Provenance`].
    #[serde(skip_serializing)]
    pub provenance: String,
}

impl ArchivedRun {
    /// The columns of an exported table.
    pub const TABLE: [(&'static str, ColumnKind); 12] = [
        ("sha256", ColumnKind::Text),
        ("cell", ColumnKind::Text),
        ("robot", ColumnKind::Text),
        ("type", ColumnKind::Text),
        ("bar", ColumnKind::Text),
        ("certificate", ColumnKind::Text),
        ("certified_on", ColumnKind::Text),
        ("operator", ColumnKind::Text),
        ("measured", ColumnKind::Text),
        ("plan", ColumnKind::Text),
        ("bytes", ColumnKind::Integer),
        ("decision", ColumnKind::Text),
    ];

    /// Inserts the row unless the database has one for the capture. Returns whether it was inserted.
    pub(super) fn insert(&self, database: &mut Database) -> Result<bool, Diagnostic> {
        let mut row = json!(self);
        row["provenance"] = json!(self.provenance);
        database.insert("run", row, Some("pushed_at"))
    }
}

/// A file of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArchivedFile {
    pub name: String,
    pub sha256: String,
    pub bytes: u64,
}

/// A search for runs: all given conditions must hold.
#[derive(Clone, Debug, Default)]
pub struct RunSelection {
    pub robot: Option<String>,
    pub kind: Option<String>,
    pub bar: Option<String>,
    pub cell: Option<String>,
    /// Dates, or dates with times. `until` is exclusive.
    pub since: Option<String>,
    pub until: Option<String>,
    /// A part of robot, type, bar, cell, operator or SHA-256.
    pub search: Option<String>,
    /// The runs after this place of the list, the newest first.
    pub after: Option<RunCursor>,
    pub limit: Option<u64>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunCursor {
    pub measured: String,
    pub sha256: String,
}

/// The LIKE pattern of texts that contain this one, in lower case.
pub(super) fn like(text: &str) -> String {
    let escaped = text.to_lowercase().replace('\\', "\\\\").replace('%', "\\%").replace('_', "\\_");
    format!("%{escaped}%")
}

impl RunSelection {
    /// Checks the dates. `today` is in ns since the Unix epoch.
    pub fn check(&self, today: u64) -> Result<(), Diagnostic> {
        for (option, text) in [("since", &self.since), ("until", &self.until)] {
            if let Some(text) = text.as_ref().filter(|text| !date::is_moment(text)) {
                return Err(NotAMoment { option: option.into(), text: text.clone() }.into());
            }
        }
        let Some(since) = &self.since else { return Ok(()) };
        if date::is_after(since.split('T').next().unwrap_or(since), today) {
            return Err(InFuture { text: since.clone() }.into());
        }
        match &self.until {
            Some(until) if until <= since => {
                Err(EndsBefore { since: since.clone(), until: until.clone() }.into())
            }
            _ => Ok(()),
        }
    }

    /// The condition on the table `run` including the limit, and its parameters.
    pub(super) fn limited(&self) -> (String, Vec<Value>) {
        let (condition, mut values) = self.condition();
        let Some(limit) = self.limit else { return (condition, values) };
        values.push(limit.into());
        let newest = "ORDER BY run.measured DESC, run.sha256 DESC";
        let chosen = format!("SELECT run.sha256 FROM run WHERE {condition} {newest} LIMIT ${}", values.len());
        (format!("run.sha256 IN ({chosen})"), values)
    }

    /// The condition on the table `run` without the limit, and its parameters.
    pub(super) fn condition(&self) -> (String, Vec<Value>) {
        let mut values: Vec<Value> = Vec::new();
        let mut parts = vec!["1 = 1".to_owned()];
        let equal = [("robot", &self.robot), ("type", &self.kind), ("bar", &self.bar), ("cell", &self.cell)];
        let equal = equal.into_iter().map(|(column, value)| (format!("run.{column} = $"), value));
        let bounds = [("run.measured >= $", &self.since), ("run.measured < $", &self.until)];
        let bounds = bounds.into_iter().map(|(part, value)| (part.to_owned(), value));
        for (part, value) in equal.chain(bounds) {
            if let Some(value) = value {
                values.push(value.as_str().into());
                parts.push(format!("{part}{}", values.len()));
            }
        }
        if let Some(RunCursor { measured, sha256 }) = &self.after {
            values.extend([measured.as_str().into(), sha256.as_str().into()]);
            parts.push(format!("(run.measured, run.sha256) < (${}, ${})", values.len() - 1, values.len()));
        }
        if let Some(search) = &self.search {
            values.push(like(search).into());
            let at = values.len();
            let like = ["robot", "type", "bar", "cell", "operator", "sha256"]
                .map(|column| format!("lower(run.{column}) LIKE ${at} ESCAPE '\\'"));
            parts.push(format!("({})", like.join(" OR ")));
        }
        (parts.join(" AND "), values)
    }
}

impl Archive {
    /// The runs, the newest first.
    pub fn list(&mut self, selection: &RunSelection) -> Result<Vec<ArchivedRun>, Diagnostic> {
        let (condition, mut values) = selection.condition();
        values.push(selection.limit.unwrap_or(i64::MAX as u64).into());
        let sql = format!(
            "SELECT * FROM run WHERE {condition} ORDER BY measured DESC, sha256 DESC LIMIT ${}",
            values.len()
        );
        self.database.query(&sql, values)
    }

    /// Why a selection is empty: names that no run has, or no run for all conditions together.
    pub fn nothing_of(&mut self, selection: &RunSelection) -> Result<Vec<ArchiveFinding>, Diagnostic> {
        let RunSelection { robot, kind, bar, cell, .. } = selection;
        let mut findings = Vec::new();
        for (column, name) in [("robot", robot), ("type", kind), ("bar", bar), ("cell", cell)] {
            let Some(name) = name else { continue };
            let sql = format!("SELECT 1 FROM run WHERE run.{column} = $1 LIMIT 1");
            if self.database.tuples::<u64>(&sql, name)?.is_empty() {
                findings.push(NoneOf { option: column.to_string(), name: name.clone() });
            }
        }
        let is_choice = !selection.condition().1.is_empty();
        if findings.is_empty() && is_choice {
            let one = RunSelection { limit: Some(1), ..selection.clone() };
            findings.extend(self.list(&one)?.is_empty().then_some(NoneSelected));
        }
        Ok(findings)
    }

    /// The run whose SHA-256 starts with these digits.
    pub fn run(&mut self, digits: &str) -> Result<ArchivedRun, Diagnostic> {
        let digits = digits.to_ascii_lowercase();
        if !(MIN_HASH_DIGITS..=64).contains(&digits.len())
            || !digits.bytes().all(|byte| byte.is_ascii_hexdigit())
        {
            return Err(NotDigits { digits }.into());
        }
        // `g` follows every hexadecimal digit. LIKE would not use the index in every collation.
        let sql = "SELECT * FROM run WHERE sha256 >= $1 AND sha256 < $2 LIMIT 100";
        let mut found: Vec<ArchivedRun> = self.database.query(sql, (&digits, format!("{digits}g")))?;
        match (found.pop(), found.len()) {
            (None, _) => Err(NoRun { digits }.into()),
            (Some(one), 0) => Ok(one),
            (Some(_), more) => Err(ManyRuns { digits, runs: more + 1 }.into()),
        }
    }

    /// The files of a run, the newest version of each.
    pub fn files(&mut self, run: &ArchivedRun) -> Result<Vec<ArchivedFile>, Diagnostic> {
        let sql = "SELECT name, sha256, bytes FROM run_file WHERE run = $1 ORDER BY name, pushed_at, sha256";
        let mut found: Vec<ArchivedFile> = Vec::new();
        for file in self.database.query::<ArchivedFile>(sql, &run.sha256)? {
            found.retain(|older| older.name != file.name);
            found.push(file);
        }
        Ok(found)
    }

    /// Writes one object as a file.
    pub fn fetch_object(&self, sha256: &str, path: &Path) -> Result<(), Diagnostic> {
        self.store.fetch(sha256, path)
    }

    /// Writes the files of a run into a directory. A file with other content is not replaced.
    pub fn fetch(&mut self, run: &ArchivedRun, directory: &Path) -> Result<Vec<ArchivedFile>, Diagnostic> {
        let found = self.files(run)?;
        for file in &found {
            if !is_sound(&file.name) {
                return Err(NotAName { name: file.name.clone() }.into());
            }
            files::is_same(&directory.join(&file.name), &file.sha256)?;
        }
        for file in &found {
            let path = directory.join(&file.name);
            files::directory(path.parent().unwrap_or(directory))?;
            self.store.fetch(&file.sha256, &path)?;
        }
        Ok(found)
    }
}

/// Whether a name is a relative path of one or two safe parts.
pub(super) fn is_sound(name: &str) -> bool {
    let part = |part: &str| {
        (1..=100).contains(&part.len())
            && !part.starts_with('.')
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte))
    };
    name.split('/').count() <= 2 && name.split('/').all(part)
}
