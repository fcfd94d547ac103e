//! Work of the archive: jobs that any number of workers share.
//!
//! A worker claims a job for a while and says again and again that it is at it. When it goes silent, the job is another's.
//! What two workers find of one job is the same, and is kept once.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::database::{Row, Value};
use super::query::Selection;
use super::{Archive, ColumnKind};
use crate::base::hash::sha256;
use crate::catalogue::ArchiveFinding::{GivenUp, NotASetting, OtherValue};
use crate::diagnostic::Diagnostic;
use crate::robot::parameter::{self, SetUp};

/// A job that lost its worker so often is not tried again.
const MOST_ATTEMPTS: u64 = 5;

/// How a run is identified: options of `dbbd identify`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings(String);

impl Settings {
    /// Every run's: the geometry with the robot's tolerance as prior, which any number of lengths bears.
    pub const USUAL: &'static str = "--model=geometric --prior=datasheet";

    /// Those of every run.
    pub fn usual() -> Self {
        Self(Self::USUAL.into())
    }

    /// Options and their values, those that are given.
    ///
    /// # Errors
    /// A value that is no list of names, or that `dbbd identify` would refuse for every run.
    pub fn new(options: &[(&str, Option<&str>)]) -> Result<Self, Diagnostic> {
        let mut given = Vec::new();
        for (option, value) in options {
            let Some(value) = value else { continue };
            let sound = |byte: u8| byte.is_ascii_alphanumeric() || b"_,-".contains(&byte);
            if value.is_empty() || value.len() > 1000 || !value.bytes().all(sound) {
                let (option, value) = ((*option).into(), (*value).into());
                return Err(NotASetting { option, value }.into());
            }
            check_value(option, value)?;
            given.push(format!("--{option}={value}"));
        }
        given.sort();
        Ok(Self(if given.is_empty() { Self::USUAL.into() } else { given.join(" ") }))
    }

    /// Those of a job. Only what [`Settings::new`] makes is executed.
    fn of_job(text: &str) -> Result<Self, Diagnostic> {
        let options: Vec<(&str, Option<&str>)> = text
            .split(' ')
            .map(|part| {
                part.strip_prefix("--")
                    .and_then(|part| part.split_once('='))
                    .map_or((part, Some("")), |(a, b)| (a, Some(b)))
            })
            .collect();
        match options.iter().find(|(option, _)| !["estimate", "hold", "model", "prior"].contains(option)) {
            Some((option, _)) => Err(NotASetting { option: (*option).into(), value: text.into() }.into()),
            None => Self::new(&options),
        }
    }

    pub fn text(&self) -> &str {
        &self.0
    }

    /// As arguments of a command.
    pub fn arguments(&self) -> impl Iterator<Item = &str> {
        self.0.split(' ')
    }
}

/// A job that a worker has claimed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Job {
    /// SHA-256 of the run's capture.
    pub run: String,
    pub settings: Settings,
    /// The version that is asked for; empty for any.
    asked: String,
}

/// Who works, and for how long it may be silent.
#[derive(Clone, Debug)]
pub struct Worker {
    pub name: String,
    pub version: String,
    pub lease: Duration,
}

/// What an identification found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    pub doubtful: bool,
    pub lengths: u64,
    pub sigma_mm: Option<f64>,
    pub rms_before_mm: Option<f64>,
    pub rms_after_mm: Option<f64>,
    pub error_nominal_mm: Option<f64>,
    pub error_identified_mm: Option<f64>,
    /// JSON of [`crate::estimation::fleet::RunPosterior`].
    pub posterior: Option<String>,
}

/// A result in the archive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArchivedResult {
    pub run: String,
    pub robot: String,
    pub measured: String,
    pub settings: String,
    pub version: String,
    #[serde(flatten)]
    pub found: Summary,
}

impl ArchivedResult {
    /// What a table of results has of each.
    pub const TABLE: [(&'static str, ColumnKind); 12] = [
        ("run", ColumnKind::Text),
        ("robot", ColumnKind::Text),
        ("measured", ColumnKind::Text),
        ("settings", ColumnKind::Text),
        ("version", ColumnKind::Text),
        ("doubtful", ColumnKind::Flag),
        ("lengths", ColumnKind::Integer),
        ("sigma_mm", ColumnKind::Real),
        ("rms_before_mm", ColumnKind::Real),
        ("rms_after_mm", ColumnKind::Real),
        ("error_nominal_mm", ColumnKind::Real),
        ("error_identified_mm", ColumnKind::Real),
    ];
}

/// The jobs by state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Queue {
    pub waiting: u64,
    pub running: u64,
    pub done: u64,
    pub failed: u64,
}

impl ArchivedResult {
    /// The columns that [`Self::of_row`] reads.
    fn columns() -> String {
        let of = |name: &str| if ["robot", "measured"].contains(&name) { "run" } else { "result" };
        let names = Self::TABLE.iter().map(|(name, _)| *name).chain(["posterior"]);
        names.map(|name| format!("{}.{name}", of(name))).collect::<Vec<_>>().join(", ")
    }

    fn of_row(row: &Row) -> Result<Self, Diagnostic> {
        let found = Summary {
            doubtful: row.int(5)? != 0,
            lengths: row.count(6)?,
            sigma_mm: row.some_real(7)?,
            rms_before_mm: row.some_real(8)?,
            rms_after_mm: row.some_real(9)?,
            error_nominal_mm: row.some_real(10)?,
            error_identified_mm: row.some_real(11)?,
            posterior: row.some_text(12)?,
        };
        let [run, robot, measured, settings, version] = [0, 1, 2, 3, 4].map(|at| row.text(at));
        Ok(Self {
            run: run?,
            robot: robot?,
            measured: measured?,
            settings: settings?,
            version: version?,
            found,
        })
    }
}

impl Archive {
    /// Asks for the runs of a selection to be identified by `version`, where that was not asked for before or failed; how
    /// many.
    pub fn ask(
        &mut self,
        selection: &Selection,
        settings: &Settings,
        version: &str,
    ) -> Result<u64, Diagnostic> {
        let (condition, mut values) = selection.limited();
        let count = values.len();
        values.extend([settings.text().into(), version.into()]);
        let sql = format!(
            "INSERT INTO job (run, settings, version) SELECT sha256, ${}, ${} FROM run WHERE {condition} \
             ON CONFLICT (run, settings, version) DO UPDATE SET state = 'waiting', attempts = 0, code = NULL, \
             message = NULL WHERE job.state = 'failed'",
            count + 1,
            count + 2
        );
        Ok(self.database.execute(&sql, &values)? + self.ask_for_lost(&condition, &values)?)
    }

    /// Asks again for results of which the store lost a file. The last two values are settings and version.
    fn ask_for_lost(&mut self, condition: &str, values: &[Value]) -> Result<u64, Diagnostic> {
        let sql = format!(
            "SELECT f.run, f.sha256, f.bytes FROM result_file f JOIN run ON run.sha256 = f.run \
             WHERE {condition} AND f.settings = ${} AND f.version = ${} ORDER BY f.run",
            values.len() - 1,
            values.len()
        );
        let mut lost = Vec::new();
        for row in self.database.query(&sql, values)? {
            let run = row.text(0)?;
            if !lost.contains(&run) && !self.store.holds(&row.text(1)?, row.count(2)?)? {
                lost.push(run);
            }
        }
        let mut asked = 0;
        let wanted = values.get(values.len().saturating_sub(2)..).unwrap_or_default();
        for run in lost {
            let sql = "UPDATE job SET state = 'waiting', attempts = 0 \
                WHERE settings = $1 AND version = $2 AND run = $3 AND state = 'done'";
            let values = [wanted, &[(&run).into()]].concat();
            asked += self.database.execute(sql, &values)?;
        }
        Ok(asked)
    }

    /// How many runs of a selection this version could not identify with these settings.
    pub fn failed(
        &mut self,
        selection: &Selection,
        settings: &Settings,
        version: &str,
    ) -> Result<u64, Diagnostic> {
        let (condition, mut values) = selection.limited();
        values.extend([settings.text().into(), version.into()]);
        let sql = format!(
            "SELECT count(*) FROM job JOIN run ON run.sha256 = job.run WHERE {condition} \
             AND job.settings = ${} AND job.version = ${} AND job.state = 'failed'",
            values.len() - 1,
            values.len()
        );
        self.database.query(&sql, &values)?.first().map_or(Ok(0), |row| row.count(0))
    }

    /// The next job, which is this worker's until its lease ends.
    pub fn claim(&mut self, worker: &Worker) -> Result<Option<Job>, Diagnostic> {
        let sql = "UPDATE job SET state = 'running', worker = $1, lease_until = {now} + $2, attempts = attempts + 1 \
            WHERE (run, settings, version) = (SELECT run, settings, version FROM job \
                WHERE (state = 'waiting' OR (state = 'running' AND lease_until < {now})) \
                AND attempts < $3 AND version IN ('', $4) ORDER BY asked_at, run LIMIT 1 {skip_locked}) \
            RETURNING run, settings, version";
        let values = [(&worker.name).into(), lease(worker), MOST_ATTEMPTS.into(), (&worker.version).into()];
        let Some(row) = self.database.query(sql, &values)?.pop() else {
            self.give_up()?;
            return Ok(None);
        };
        let (run, settings, asked) = (row.text(0)?, row.text(1)?, row.text(2)?);
        match Settings::of_job(&settings) {
            Ok(known) if known.text() == settings => Ok(Some(Job { run, settings: known, asked })),
            _ => {
                // Not from here: it is never executed.
                let sql = "UPDATE job SET state = 'failed', code = 'E2411', message = 'unknown settings' \
                    WHERE run = $1 AND settings = $2 AND version = $3";
                let values = [(&run).into(), (&settings).into(), (&asked).into()];
                self.database.execute(sql, &values)?;
                self.claim(worker)
            }
        }
    }

    /// Jobs that lost their worker too often have failed.
    fn give_up(&mut self) -> Result<(), Diagnostic> {
        let why = Diagnostic::from(GivenUp { attempts: MOST_ATTEMPTS });
        let sql = "UPDATE job SET state = 'failed', code = $1, message = $2 \
            WHERE state = 'running' AND lease_until < {now} AND attempts >= $3";
        let values = [why.code.0.into(), why.to_string().as_str().into(), MOST_ATTEMPTS.into()];
        self.database.execute(sql, &values).map(drop)
    }

    /// Says that the worker is still at it; whether the job is still its own.
    pub fn keep(&mut self, job: &Job, worker: &Worker) -> Result<bool, Diagnostic> {
        let sql = "UPDATE job SET lease_until = {now} + $1 \
            WHERE run = $2 AND settings = $3 AND version = $4 AND worker = $5 AND state = 'running'";
        let [run, settings, asked] = key(job);
        let values = [lease(worker), run, settings, asked, (&worker.name).into()];
        Ok(self.database.execute(sql, &values)? == 1)
    }

    /// Keeps what a job found, with its files by name and content; what is there already stays.
    pub fn finish(
        &mut self,
        job: &Job,
        worker: &Worker,
        found: &Summary,
        files: &[(String, Vec<u8>)],
    ) -> Result<(), Diagnostic> {
        let mut stored = Vec::new();
        for (name, content) in files {
            let (sha256, bytes) = (sha256(content), content.len() as u64);
            if !self.store.holds(&sha256, bytes)? {
                self.store.put(&sha256, &mut content.as_slice(), bytes)?;
            }
            self.store.verify(&sha256)?;
            stored.push((name, sha256, bytes));
        }
        self.database.transaction(|database| {
            let [run, settings, asked] = key(job);
            let version = || Value::from(&worker.version);
            let sql = "INSERT INTO result (run, settings, version, made_at, worker, doubtful, lengths, sigma_mm, \
                rms_before_mm, rms_after_mm, error_nominal_mm, error_identified_mm, posterior) \
                VALUES ($1, $2, $3, {now}, $4, $5, $6, $7, $8, $9, $10, $11, $12) ON CONFLICT DO NOTHING";
            let values = [
                run.clone(),
                settings.clone(),
                version(),
                (&worker.name).into(),
                i64::from(found.doubtful).into(),
                found.lengths.into(),
                found.sigma_mm.into(),
                found.rms_before_mm.into(),
                found.rms_after_mm.into(),
                found.error_nominal_mm.into(),
                found.error_identified_mm.into(),
                found.posterior.as_ref().into(),
            ];
            if database.execute(sql, &values)? == 1 {
                for (name, sha256, bytes) in &stored {
                    let sql = "INSERT INTO result_file VALUES ($1, $2, $3, $4, $5, $6)";
                    let (name, sha256) = (Value::from(*name), Value::from(sha256));
                    let values = [run.clone(), settings.clone(), version(), name, sha256, (*bytes).into()];
                    database.execute(sql, &values)?;
                }
            }
            let sql = "UPDATE job SET state = 'done', code = NULL, message = NULL \
                WHERE run = $1 AND settings = $2 AND version = $3";
            database.execute(sql, &[run, settings, asked]).map(drop)
        })
    }

    /// Notes why a run cannot be identified.
    pub fn fail(&mut self, job: &Job, code: &str, message: &str) -> Result<(), Diagnostic> {
        let sql = "UPDATE job SET state = 'failed', code = $4, message = $5 \
            WHERE run = $1 AND settings = $2 AND version = $3 AND state = 'running'";
        let [run, settings, asked] = key(job);
        let message: String = message.chars().take(1000).collect();
        self.database.execute(sql, &[run, settings, asked, code.into(), (&message).into()]).map(drop)
    }

    /// How many jobs are in which state.
    pub fn queue(&mut self) -> Result<Queue, Diagnostic> {
        let mut queue = Queue::default();
        for row in self.database.query("SELECT state, jobs FROM queue", &[])? {
            let jobs = row.count(1)?;
            match row.text(0)?.as_str() {
                "waiting" => queue.waiting = jobs,
                "running" => queue.running = jobs,
                "done" => queue.done = jobs,
                _ => queue.failed = jobs,
            }
        }
        Ok(queue)
    }

    /// The results of a selection of runs, in the order of robots and time; of these settings where they are given.
    pub fn results(
        &mut self,
        selection: &Selection,
        settings: Option<&Settings>,
    ) -> Result<Vec<ArchivedResult>, Diagnostic> {
        let (mut condition, mut values) = selection.limited();
        if let Some(settings) = settings {
            values.push(settings.text().into());
            condition += &format!(" AND result.settings = ${}", values.len());
        }
        self.results_where(&condition, &values)
    }

    pub(super) fn results_where(
        &mut self,
        condition: &str,
        values: &[Value],
    ) -> Result<Vec<ArchivedResult>, Diagnostic> {
        let columns = ArchivedResult::columns();
        let sql = format!(
            "SELECT {columns} FROM result JOIN run ON run.sha256 = result.run WHERE {condition} \
             ORDER BY run.robot, run.measured, result.settings, result.made_at"
        );
        self.database.query(&sql, values)?.iter().map(ArchivedResult::of_row).collect()
    }

    /// The content of a file of a run's newest result; `None` where there is none.
    pub fn result_file(&mut self, run: &str, name: &str) -> Result<Option<Vec<u8>>, Diagnostic> {
        self.result_object(run, name)?.map(|object| self.store.get(&object)).transpose()
    }

    /// The SHA-256 of that file.
    pub(super) fn result_object(&mut self, run: &str, name: &str) -> Result<Option<String>, Diagnostic> {
        let sql = "SELECT f.sha256 FROM result_file f JOIN result r ON r.run = f.run AND r.settings = f.settings \
            AND r.version = f.version WHERE f.run = $1 AND f.name = $2 ORDER BY r.made_at DESC LIMIT 1";
        let rows = self.database.query(sql, &[run.into(), name.into()])?;
        rows.first().map(|row| row.text(0)).transpose()
    }
}

/// That a value of an option is one for some run: each run has its own balls and bars.
fn check_value(option: &str, value: &str) -> Result<(), Diagnostic> {
    let known: &[&str] = match option {
        "prior" => &["none", "datasheet", "posterior"],
        "model" => &["joints", "geometric"],
        _ => {
            const MOST: usize = 99;
            let any = SetUp { balls: MOST, bars: MOST, targets: MOST, trackers: 1 };
            return parameter::parse_list(value, &[], any).map(drop);
        }
    };
    if known.contains(&value) {
        return Ok(());
    }
    let (option, value, known) = (option.into(), value.into(), known.join(", "));
    Err(OtherValue { option, value, known }.into())
}

fn lease(worker: &Worker) -> Value {
    u64::try_from(worker.lease.as_millis()).unwrap_or(u64::MAX).into()
}

fn key(job: &Job) -> [Value; 3] {
    [(&job.run).into(), job.settings.text().into(), (&job.asked).into()]
}
