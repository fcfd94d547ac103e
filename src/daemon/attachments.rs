//! The files in force during a run, which its capture carries.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde_json::Value;
use thiserror::Error;

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
        let modules = circles(&rows).map_err(|message| PlanError::Header { path: csv.into(), message })?;
        let files = vec![
            ("plan.csv".to_owned(), rows),
            ("plan.json".to_owned(), header),
            ("robot.toml".to_owned(), robot),
        ];
        Ok(Self { files, modules: Some(modules), protocol })
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
    let mut reader = csv::Reader::from_reader(rows);
    let headers = reader.headers().map_err(|error| error.to_string())?;
    let column = headers.iter().position(|name| name == "circle").ok_or("no column `circle`")?;
    let mut circles = BTreeSet::new();
    for row in reader.records() {
        let row = row.map_err(|error| error.to_string())?;
        let circle: u32 =
            row.get(column).and_then(|text| text.parse().ok()).ok_or("a circle is no number")?;
        circles.insert(circle);
    }
    circles.remove(&0);
    u32::try_from(circles.len()).map_err(|error| error.to_string())
}
