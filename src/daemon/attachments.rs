//! The files in force during a run, which its capture carries.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde_json::Value;
use thiserror::Error;

use super::reports::Driven;
use crate::sync::run_number;

/// CRC-64/XZ ties `plan.json` to the text of `plan.csv`.
const PLAN_HASH: crc::Crc<u64> = crc::Crc::<u64>::new(&crc::CRC_64_XZ);

/// Why a plan cannot be used.
#[derive(Debug, Error)]
pub enum PlanError {
    /// A file cannot be read.
    #[error("{} cannot be read", .0.display())]
    Read(PathBuf, #[source] io::Error),
    /// The header is no JSON or lacks something.
    #[error("{}: {message}\n  help: make the plan again with `dbbd plan`", .path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The pair does not match.
    #[error("{} does not belong to {}\n  help: one of them was changed; make the plan again with `dbbd plan`", .json.display(), .csv.display())]
    Mismatch {
        /// The header.
        json: PathBuf,
        /// The rows.
        csv: PathBuf,
    },
}

/// The files, and what of them the run itself needs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Attachments {
    /// Names and contents.
    pub files: Vec<(String, Vec<u8>)>,
    /// Circles of the plan, which are the modules of its program.
    pub modules: Option<u32>,
    /// The protocol that the plan's job names.
    pub protocol: Option<String>,
    /// What the plan's program tells over EthernetKRL.
    pub driven: Option<Driven>,
}

impl Attachments {
    /// A plan's files: `plan.csv`, the `.json` beside it, and the robot in that.
    ///
    /// # Errors
    /// When a file is missing or the two do not match.
    pub fn of_plan(csv: &Path) -> Result<Self, PlanError> {
        let json = csv.with_extension("json");
        let read = |path: &Path| fs::read(path).map_err(|error| PlanError::Read(path.into(), error));
        let (rows, header) = (read(csv)?, read(&json)?);
        let wrong = |message: String| PlanError::Header { path: json.clone(), message };
        let value: Value = serde_json::from_slice(&header).map_err(|error| wrong(error.to_string()))?;
        let hash = value.get("hash").and_then(Value::as_str).ok_or_else(|| wrong("no `hash`".into()))?;
        if !hash.eq_ignore_ascii_case(&format!("{:016x}", PLAN_HASH.checksum(&rows))) {
            return Err(PlanError::Mismatch { json, csv: csv.into() });
        }
        let robot = value.get("robot").and_then(Value::as_str).ok_or_else(|| wrong("no `robot`".into()))?;
        let robot = robot.as_bytes().to_vec();
        let protocol = value.pointer("/job/bar/protocol").and_then(Value::as_str).map(str::to_owned);
        let wrong_row = |message: String| PlanError::Header { path: csv.into(), message };
        let modules = circles(&rows).map_err(wrong_row)?;
        let mut dwells = column(&rows, "index", |kind| kind != "transit").map_err(wrong_row)?;
        // A pass without stops is told by the row at which it ends.
        let passes = value.get("passes").and_then(Value::as_array).into_iter().flatten();
        let ends = passes.filter_map(|pass| u32::try_from(pass.get("end")?.as_u64()?).ok());
        dwells.extend(ends);
        let driven = Some(Driven { run: run_number(hash), dwells });
        let files = vec![
            ("plan.csv".to_owned(), rows),
            ("plan.json".to_owned(), header),
            ("robot.toml".to_owned(), robot),
        ];
        Ok(Self { files, modules: Some(modules), protocol, driven })
    }

    /// One file more.
    #[must_use]
    pub fn with(mut self, name: &str, content: impl Into<Vec<u8>>) -> Self {
        self.files.push((name.into(), content.into()));
        self
    }
}

/// Distinct circles of a plan; rows of circle 0 belong to none.
fn circles(rows: &[u8]) -> Result<u32, String> {
    let mut circles = column(rows, "circle", |_| true)?;
    circles.remove(&0);
    u32::try_from(circles.len()).map_err(|error| error.to_string())
}

/// The distinct numbers of a column, of the rows that are `wanted` by their kind.
fn column(rows: &[u8], name: &str, wanted: impl Fn(&str) -> bool) -> Result<BTreeSet<u32>, String> {
    let mut reader = csv::Reader::from_reader(rows);
    let headers = reader.headers().map_err(|error| error.to_string())?;
    let position = |wanted: &str| headers.iter().position(|name| name == wanted);
    let column = position(name).ok_or_else(|| format!("no column `{name}`"))?;
    let kind = position("kind");
    let mut numbers = BTreeSet::new();
    for row in reader.records() {
        let row = row.map_err(|error| error.to_string())?;
        let text = row.get(column).unwrap_or_default();
        let number = text.parse().map_err(|_| format!("{name} `{text}` is no number"))?;
        if wanted(kind.and_then(|kind| row.get(kind)).unwrap_or_default()) {
            numbers.insert(number);
        }
    }
    Ok(numbers)
}
