//! What the archive holds.

use std::path::Path;

use serde::Serialize;

use super::database::{Database, Row, Value};
use super::local::is_sound;
use super::{Archive, ColumnKind};
use crate::base::{date, files};
use crate::catalogue::ArchiveFinding::{
    self, EndsBefore, InFuture, ManyRuns, NoRun, NoneOf, NoneSelected, NotAMoment, NotAName, NotDigits,
};
use crate::diagnostic::Diagnostic;

/// Fewer digits of a SHA-256 are no name.
const LEAST_DIGITS: usize = 6;

/// What the registry states of a run; empty where it was not stated.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ArchivedRun {
    /// Of the capture.
    pub sha256: String,
    pub cell: String,
    /// Its serial number, else its name.
    pub robot: String,
    /// The name of the robot's model.
    #[serde(rename = "type")]
    pub kind: String,
    /// Its serial number.
    pub bar: String,
    pub certificate: Option<String>,
    pub certified_on: Option<String>,
    pub operator: Option<String>,
    /// Date and time, UTC.
    pub measured: String,
    /// Its hash.
    pub plan: Option<String>,
    pub bytes: u64,
    /// `pass`, `fail` or `undecided`, of the check that was pushed with it.
    pub decision: Option<String>,
    /// JSON of [`crate::provenance::Provenance`].
    #[serde(skip)]
    pub provenance: String,
}

impl ArchivedRun {
    /// What a table of runs has of each.
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
}

/// The columns of a run, in the order of [`ArchivedRun::of_row`].
const COLUMNS: &str = "sha256, cell, robot, type, bar, certificate, certified_on, operator, measured, plan, bytes, \
    decision, provenance";

impl ArchivedRun {
    fn of_row(row: &Row) -> Result<Self, Diagnostic> {
        Ok(Self {
            sha256: row.text(0)?,
            cell: row.text(1)?,
            robot: row.text(2)?,
            kind: row.text(3)?,
            bar: row.text(4)?,
            certificate: row.some_text(5)?,
            certified_on: row.some_text(6)?,
            operator: row.some_text(7)?,
            measured: row.text(8)?,
            plan: row.some_text(9)?,
            bytes: row.count(10)?,
            decision: row.some_text(11)?,
            provenance: row.text(12)?,
        })
    }

    /// Writes it if no run of this capture is there; whether it was written.
    pub(super) fn insert(&self, database: &mut Database) -> Result<bool, Diagnostic> {
        let values: [Value; 13] = [
            (&self.sha256).into(),
            (&self.cell).into(),
            (&self.robot).into(),
            (&self.kind).into(),
            (&self.bar).into(),
            self.certificate.as_ref().into(),
            self.certified_on.as_ref().into(),
            self.operator.as_ref().into(),
            (&self.measured).into(),
            self.plan.as_ref().into(),
            self.bytes.into(),
            self.decision.as_ref().into(),
            (&self.provenance).into(),
        ];
        let sql = format!(
            "INSERT INTO run ({COLUMNS}, pushed_at) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, {{now}}) ON CONFLICT DO NOTHING"
        );
        Ok(database.execute(&sql, &values)? == 1)
    }
}

/// A file of a run in the archive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArchivedFile {
    pub name: String,
    pub sha256: String,
    pub bytes: u64,
}

/// Which runs: all that is given must hold.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    pub robot: Option<String>,
    pub kind: Option<String>,
    pub bar: Option<String>,
    pub cell: Option<String>,
    /// Dates, or dates and times: from the first on, up to before the second.
    pub since: Option<String>,
    pub until: Option<String>,
    /// A text that is in robot, type, bar, cell or operator.
    pub search: Option<String>,
    /// Those that follow this one in the order of the list, the newest first.
    pub after: Option<Place>,
    pub limit: Option<u64>,
}

/// The place of a run in the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    pub measured: String,
    pub sha256: String,
}

/// The pattern of what contains a text, whatever its case.
pub(super) fn like(text: &str) -> Value {
    let escaped = text.to_lowercase().replace('\\', "\\\\").replace('%', "\\%").replace('_', "\\_");
    format!("%{escaped}%").as_str().into()
}

impl Selection {
    /// That its dates are dates, and leave time between them; `today` in ns since the Unix epoch.
    ///
    /// # Errors
    /// Names the option.
    pub fn check(&self, today: u64) -> Result<(), Diagnostic> {
        for (option, text) in [("--since", &self.since), ("--until", &self.until)] {
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

    /// The condition on the table `run` with the limit, and its values.
    pub(super) fn limited(&self) -> (String, Vec<Value>) {
        let (condition, mut values) = self.condition();
        let Some(limit) = self.limit else { return (condition, values) };
        values.push(limit.into());
        let newest = "ORDER BY run.measured DESC, run.sha256 DESC";
        let chosen = format!("SELECT run.sha256 FROM run WHERE {condition} {newest} LIMIT ${}", values.len());
        (format!("run.sha256 IN ({chosen})"), values)
    }

    /// The condition on the table `run`, and its values.
    pub(super) fn condition(&self) -> (String, Vec<Value>) {
        let mut values: Vec<Value> = Vec::new();
        let mut parts = vec!["1 = 1".to_owned()];
        let equal = [("robot", &self.robot), ("type", &self.kind), ("bar", &self.bar), ("cell", &self.cell)];
        let equal = equal.into_iter().map(|(column, value)| (format!("run.{column} = $"), value));
        let bounds = [("run.measured >= $", &self.since), ("run.measured < $", &self.until)];
        let bounds = bounds.into_iter().map(|(part, value)| (part.to_owned(), value));
        for (part, value) in equal.chain(bounds) {
            if let Some(value) = value {
                values.push(value.into());
                parts.push(format!("{part}{}", values.len()));
            }
        }
        if let Some(Place { measured, sha256 }) = &self.after {
            values.extend([measured.into(), sha256.into()]);
            parts.push(format!("(run.measured, run.sha256) < (${}, ${})", values.len() - 1, values.len()));
        }
        if let Some(search) = &self.search {
            values.push(like(search));
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
    pub fn list(&mut self, selection: &Selection) -> Result<Vec<ArchivedRun>, Diagnostic> {
        let (condition, mut values) = selection.condition();
        values.push(selection.limit.unwrap_or(i64::MAX as u64).into());
        let sql = format!(
            "SELECT {COLUMNS} FROM run WHERE {condition} ORDER BY measured DESC, sha256 DESC LIMIT ${}",
            values.len()
        );
        self.database.query(&sql, &values)?.iter().map(ArchivedRun::of_row).collect()
    }

    /// Why a selection holds nothing: names that no run has, or that all of it together holds for none.
    pub fn nothing_of(&mut self, selection: &Selection) -> Result<Vec<ArchiveFinding>, Diagnostic> {
        let Selection { robot, kind, bar, cell, .. } = selection;
        let mut findings = Vec::new();
        for (column, name) in [("robot", robot), ("type", kind), ("bar", bar), ("cell", cell)] {
            let Some(name) = name else { continue };
            let sql = format!("SELECT 1 FROM run WHERE run.{column} = $1 LIMIT 1");
            if self.database.query(&sql, &[name.into()])?.is_empty() {
                findings.push(NoneOf { option: format!("--{column}"), name: name.clone() });
            }
        }
        let is_choice = !selection.condition().1.is_empty();
        if findings.is_empty() && is_choice {
            let one = Selection { limit: Some(1), ..selection.clone() };
            findings.extend(self.list(&one)?.is_empty().then_some(NoneSelected));
        }
        Ok(findings)
    }

    /// The run whose SHA-256 begins with these digits.
    pub fn run(&mut self, digits: &str) -> Result<ArchivedRun, Diagnostic> {
        let digits = digits.to_ascii_lowercase();
        if !(LEAST_DIGITS..=64).contains(&digits.len())
            || !digits.bytes().all(|byte| byte.is_ascii_hexdigit())
        {
            return Err(NotDigits { digits }.into());
        }
        // `g` follows every digit; a pattern would not use the index in every collation.
        let sql = format!("SELECT {COLUMNS} FROM run WHERE sha256 >= $1 AND sha256 < $2 LIMIT 100");
        let mut found = self.database.query(&sql, &[(&digits).into(), (&format!("{digits}g")).into()])?;
        match (found.pop(), found.len()) {
            (None, _) => Err(NoRun { digits }.into()),
            (Some(one), 0) => ArchivedRun::of_row(&one),
            (Some(_), more) => Err(ManyRuns { digits, runs: more + 1 }.into()),
        }
    }

    /// Its files, the newest version of each.
    pub fn files(&mut self, run: &ArchivedRun) -> Result<Vec<ArchivedFile>, Diagnostic> {
        let sql = "SELECT name, sha256, bytes FROM run_file WHERE run = $1 ORDER BY name, pushed_at, sha256";
        let mut found: Vec<ArchivedFile> = Vec::new();
        for row in self.database.query(sql, &[(&run.sha256).into()])? {
            let file = ArchivedFile { name: row.text(0)?, sha256: row.text(1)?, bytes: row.count(2)? };
            found.retain(|older| older.name != file.name);
            found.push(file);
        }
        Ok(found)
    }

    /// Writes one object as a file.
    pub fn fetch_object(&self, sha256: &str, path: &Path) -> Result<(), Diagnostic> {
        self.store.fetch(sha256, path)
    }

    /// Writes the files of a run into a directory, each as it was pushed; a file with another content is not replaced.
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
