//! The job queue of the archive, shared by any number of workers, and the results.
//!
//! A worker claims a job with a lease and renews it. When the lease ends, another worker may claim the job. Two workers
//! find the same result for a job, which is kept once.

use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Value, json};

use super::query::RunSelection;
use super::{Archive, ColumnKind};
use crate::ArchiveFinding::{GivenUp, NotASetting, OtherValue};
use dbbd_job::request::Request;
use dbbd_job::request::identify::{IdentifyRequest, RequestedPrior};
use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::priors::Priors;
use dbbd_model::estimation::{CalibrationResult, ErrorModel};
use dbbd_model::robot::ParamId;
use dbbd_model::robot::parameter::{self, SetUpCounts};

/// A job whose worker was lost this often has failed.
const MAX_ATTEMPTS: u64 = 5;

/// The settings of an identification.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdentifySettings {
    /// The settings as the database and users have them: options of `dbbd identify`.
    text: String,
    estimate: Option<String>,
    hold: Option<String>,
    model: ErrorModel,
    prior: Option<RequestedPrior>,
}

impl IdentifySettings {
    /// The settings of every new run: the geometry, with the robot's tolerances as prior, so that few lengths suffice.
    pub const DEFAULT: &'static str = "--model=geometric --prior=datasheet";

    /// Settings from options and their values. Values that `dbbd identify` would refuse for every run are errors.
    pub fn new(options: &[(&str, Option<&str>)]) -> Result<Self, Diagnostic> {
        let mut given = Vec::new();
        let mut settings =
            Self { text: String::new(), estimate: None, hold: None, model: ErrorModel::Joints, prior: None };
        for (option, value) in options {
            let Some(value) = value else { continue };
            let refused = || NotASetting { option: (*option).into(), value: (*value).into() };
            let sound = |byte: u8| byte.is_ascii_alphanumeric() || b"_,-".contains(&byte);
            if value.is_empty() || value.len() > 1000 || !value.bytes().all(sound) {
                return Err(refused().into());
            }
            check_value(option, value)?;
            match *option {
                "estimate" => settings.estimate = Some((*value).into()),
                "hold" => settings.hold = Some((*value).into()),
                "model" if *value == "geometric" => settings.model = ErrorModel::Geometric,
                "model" => settings.model = ErrorModel::Joints,
                "prior" => settings.prior = Some(RequestedPrior::named(value)),
                _ => return Err(refused().into()),
            }
            given.push(format!("--{option}={value}"));
        }
        if given.is_empty() {
            return Self::of_job(Self::DEFAULT);
        }
        given.sort();
        Ok(Self { text: given.join(" "), ..settings })
    }

    /// The settings of a job in the database, which are not trusted.
    fn of_job(text: &str) -> Result<Self, Diagnostic> {
        let options: Vec<(&str, Option<&str>)> = text
            .split(' ')
            .map(|part| {
                let option = part.strip_prefix("--").and_then(|part| part.split_once('='));
                option.map_or((part, Some("")), |(name, value)| (name, Some(value)))
            })
            .collect();
        Self::new(&options)
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    /// The request to identify a robot from `input` with these settings.
    pub fn request(&self, input: &Path, out: &Path) -> Request {
        let Self { estimate, hold, model, prior, .. } = self.clone();
        let (input, out) = (input.into(), out.into());
        let request =
            IdentifyRequest { input, out, estimate, hold, model, prior, ..IdentifyRequest::default() };
        Request::Identify(request)
    }
}

/// A claimed job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClaimedJob {
    /// SHA-256 of the run's capture.
    pub run: String,
    pub settings: IdentifySettings,
    /// The requested version; empty for any.
    asked: String,
}

#[derive(Clone, Debug)]
pub struct Worker {
    pub name: String,
    pub version: String,
    pub lease: Duration,
}

/// The findings of an identification in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResultSummary {
    #[serde(deserialize_with = "flag")]
    pub has_warnings: bool,
    pub lengths: u64,
    pub sigma_mm: Option<f64>,
    pub rms_before_mm: Option<f64>,
    pub rms_after_mm: Option<f64>,
    pub error_nominal_mm: Option<f64>,
    pub error_identified_mm: Option<f64>,
    /// JSON of [`WrittenPosterior`].
    pub posterior: Option<String>,
}

/// Databases without a type for flags have 0 and 1.
fn flag<'a, D: Deserializer<'a>>(column: D) -> Result<bool, D::Error> {
    i64::deserialize(column).map(|flag| flag != 0)
}

/// The posterior of robot and bar after a run, as the archive stores it; lengths in mm, angles in rad. Balls and tool
/// differ between runs.
#[derive(Serialize, Deserialize)]
pub struct WrittenPosterior {
    pub parameters: Vec<ParamId>,
    /// Corrections to the nominal values.
    pub corrections: Vec<f64>,
    /// The lower triangle, a row per parameter.
    pub covariance: Vec<Vec<f64>>,
    /// Prior standard deviations; `None` for a parameter without a prior.
    pub prior: Vec<Option<f64>>,
}

impl WrittenPosterior {
    /// The posterior of a result with the text of its `covariance.csv`; `None` if they do not fit each other.
    pub fn of(result: &CalibrationResult, covariance: &str, priors: &Priors) -> Option<Self> {
        let mut lines = covariance.lines().map(|line| line.split(',').skip(1));
        let ids = lines.next()?.map(|name| name.parse::<ParamId>().ok()).enumerate();
        let kept: Vec<(usize, ParamId)> = ids
            .filter_map(|(at, id)| Some((at, id?)))
            .filter(|(_, id)| id.is_geometric() || matches!(id, ParamId::BarOffset(_)))
            .collect();
        let rows: Vec<Vec<f64>> =
            lines.map(|cells| cells.map(|cell| cell.parse().ok()).collect()).collect::<Option<_>>()?;
        let parameters: Vec<ParamId> = kept.iter().map(|(_, id)| *id).collect();
        let correction = |id: &ParamId| Some(result.parameter(*id)?.correction);
        let triangle = kept.iter().enumerate().map(|(row, (at, _))| {
            kept[..=row].iter().map(|(to, _)| rows.get(*at)?.get(*to).copied()).collect()
        });
        Some(Self {
            corrections: parameters.iter().map(correction).collect::<Option<_>>()?,
            covariance: triangle.collect::<Option<_>>()?,
            prior: parameters.iter().map(|id| priors.bound(*id)).collect(),
            parameters,
        })
    }

    /// The stored text.
    pub fn write(&self) -> String {
        json!(self).to_string()
    }

    /// Reads the stored text; `None` if it is malformed or its sizes differ.
    pub fn read(text: &str) -> Option<Self> {
        let written: Self = serde_json::from_str(text).ok()?;
        let size = written.parameters.len();
        let triangle = written.covariance.iter().enumerate().all(|(at, row)| row.len() == at + 1);
        let fits = [written.corrections.len(), written.covariance.len(), written.prior.len()] == [size; 3];
        (triangle && fits).then_some(written)
    }

    /// Difference of the first bar's length from its certificate, and its standard deviation, mm.
    pub fn bar_offset(&self) -> Option<[f64; 2]> {
        let at = self.parameters.iter().position(|id| matches!(id, ParamId::BarOffset(_)))?;
        Some([*self.corrections.get(at)?, self.covariance.get(at)?.get(at)?.sqrt()])
    }
}

/// A result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArchivedResult {
    pub run: String,
    pub robot: String,
    pub measured: String,
    pub settings: String,
    pub version: String,
    #[serde(flatten)]
    pub found: ResultSummary,
}

impl ArchivedResult {
    /// The columns of an exported table.
    pub const TABLE: [(&'static str, ColumnKind); 12] = [
        ("run", ColumnKind::Text),
        ("robot", ColumnKind::Text),
        ("measured", ColumnKind::Text),
        ("settings", ColumnKind::Text),
        ("version", ColumnKind::Text),
        ("has_warnings", ColumnKind::Flag),
        ("lengths", ColumnKind::Integer),
        ("sigma_mm", ColumnKind::Real),
        ("rms_before_mm", ColumnKind::Real),
        ("rms_after_mm", ColumnKind::Real),
        ("error_nominal_mm", ColumnKind::Real),
        ("error_identified_mm", ColumnKind::Real),
    ];
}

/// Numbers of jobs by state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct QueueCounts {
    pub waiting: u64,
    pub running: u64,
    pub done: u64,
    pub failed: u64,
}

impl Archive {
    /// Queues the runs of a selection for identification by `version`, unless they are queued or done. Returns their
    /// number.
    pub fn ask(
        &mut self,
        selection: &RunSelection,
        settings: &IdentifySettings,
        version: &str,
    ) -> Result<u64, Diagnostic> {
        let (condition, mut values) = selection.limited();
        values.extend([settings.text().into(), version.into()]);
        let (at_settings, at_version) = (values.len() - 1, values.len());
        let sql = format!(
            "INSERT INTO job (run, settings, version) SELECT sha256, ${at_settings}, ${at_version} FROM run \
             WHERE {condition} ON CONFLICT (run, settings, version) DO UPDATE SET state = 'waiting', attempts = 0, \
             code = NULL, message = NULL WHERE job.state = 'failed'"
        );
        let asked = self.database.execute(&sql, &values)?;
        let sql = format!(
            "SELECT f.run, f.sha256, f.bytes FROM result_file f JOIN run ON run.sha256 = f.run \
             WHERE {condition} AND f.settings = ${at_settings} AND f.version = ${at_version} ORDER BY f.run"
        );
        Ok(asked + self.ask_for_lost(&sql, &values, (settings.text(), version))?)
    }

    /// Queues again the results of which the store lost a file. `sql` selects run, SHA-256 and size of the files.
    fn ask_for_lost(
        &mut self,
        sql: &str,
        values: &[Value],
        (settings, version): (&str, &str),
    ) -> Result<u64, Diagnostic> {
        let mut lost = Vec::new();
        for (run, sha256, bytes) in self.database.tuples::<(String, String, u64)>(sql, values)? {
            if !lost.contains(&run) && !self.store.holds(&sha256, bytes)? {
                lost.push(run);
            }
        }
        let sql = "UPDATE job SET state = 'waiting', attempts = 0 \
            WHERE settings = $1 AND version = $2 AND run = $3 AND state = 'done'";
        lost.iter().map(|run| self.database.execute(sql, (settings, version, run))).sum()
    }

    /// The number of runs of a selection whose identification by this version failed.
    pub fn failed(
        &mut self,
        selection: &RunSelection,
        settings: &IdentifySettings,
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
        Ok(self.database.tuples(&sql, values)?.pop().unwrap_or(0))
    }

    /// Claims the next job until the lease ends.
    pub fn claim(&mut self, worker: &Worker) -> Result<Option<ClaimedJob>, Diagnostic> {
        let sql = "UPDATE job SET state = 'running', worker = $1, lease_until = {now} + $2, attempts = attempts + 1 \
            WHERE (run, settings, version) = (SELECT run, settings, version FROM job \
                WHERE (state = 'waiting' OR (state = 'running' AND lease_until < {now})) \
                AND attempts < $3 AND version IN ('', $4) ORDER BY asked_at, run LIMIT 1 {skip_locked}) \
            RETURNING run, settings, version";
        let parameters = (&worker.name, lease_ms(worker), MAX_ATTEMPTS, &worker.version);
        let claimed: Option<(String, String, String)> = self.database.tuples(sql, parameters)?.pop();
        let Some((run, settings, asked)) = claimed else {
            self.give_up()?;
            return Ok(None);
        };
        match IdentifySettings::of_job(&settings) {
            Ok(known) if known.text() == settings => Ok(Some(ClaimedJob { run, settings: known, asked })),
            _ => {
                // The job was not written by this program, so it is not executed.
                let sql = "UPDATE job SET state = 'failed', code = 'E2411', message = 'unknown settings' \
                    WHERE run = $1 AND settings = $2 AND version = $3";
                self.database.execute(sql, (run, settings, asked))?;
                self.claim(worker)
            }
        }
    }

    /// Fails the jobs that lost their worker too often.
    fn give_up(&mut self) -> Result<(), Diagnostic> {
        let why = Diagnostic::from(GivenUp { attempts: MAX_ATTEMPTS });
        let sql = "UPDATE job SET state = 'failed', code = $1, message = $2 \
            WHERE state = 'running' AND lease_until < {now} AND attempts >= $3";
        self.database.execute(sql, (why.code().as_str(), why.to_string(), MAX_ATTEMPTS)).map(drop)
    }

    /// Renews the lease. Returns whether the job still belongs to this worker.
    pub fn keep(&mut self, job: &ClaimedJob, worker: &Worker) -> Result<bool, Diagnostic> {
        let sql = "UPDATE job SET lease_until = {now} + $1 \
            WHERE run = $2 AND settings = $3 AND version = $4 AND worker = $5 AND state = 'running'";
        let ClaimedJob { run, settings, asked } = job;
        let parameters = (lease_ms(worker), run, settings.text(), asked, &worker.name);
        Ok(self.database.execute(sql, parameters)? == 1)
    }

    /// Stores the result of a job and its files (name and content). An existing result stays.
    pub fn finish(
        &mut self,
        job: &ClaimedJob,
        worker: &Worker,
        found: &ResultSummary,
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
        let ClaimedJob { run, settings, asked } = job;
        let (settings, version) = (settings.text(), &worker.version);
        self.database.transaction(|database| {
            let mut row = json!(found);
            row["run"] = json!(run);
            row["settings"] = json!(settings);
            row["version"] = json!(version);
            row["worker"] = json!(worker.name);
            if database.insert("result", row, Some("made_at"))? {
                for (name, sha256, bytes) in &stored {
                    let sql = "INSERT INTO result_file VALUES ($1, $2, $3, $4, $5, $6)";
                    database.execute(sql, (run, settings, version, name, sha256, bytes))?;
                }
            }
            let sql = "UPDATE job SET state = 'done', code = NULL, message = NULL \
                WHERE run = $1 AND settings = $2 AND version = $3";
            database.execute(sql, (run, settings, asked)).map(drop)
        })
    }

    /// Fails a job, with the reason.
    pub fn fail(&mut self, job: &ClaimedJob, code: &str, message: &str) -> Result<(), Diagnostic> {
        let sql = "UPDATE job SET state = 'failed', code = $4, message = $5 \
            WHERE run = $1 AND settings = $2 AND version = $3 AND state = 'running'";
        let ClaimedJob { run, settings, asked } = job;
        let message: String = message.chars().take(1000).collect();
        self.database.execute(sql, (run, settings.text(), asked, code, message)).map(drop)
    }

    pub fn queue(&mut self) -> Result<QueueCounts, Diagnostic> {
        let mut queue = QueueCounts::default();
        for (state, jobs) in self.database.tuples::<(String, u64)>("SELECT state, jobs FROM queue", ())? {
            match state.as_str() {
                "waiting" => queue.waiting = jobs,
                "running" => queue.running = jobs,
                "done" => queue.done = jobs,
                _ => queue.failed = jobs,
            }
        }
        Ok(queue)
    }

    /// The results of a selection of runs, by robot and time; only those with `settings` if given.
    pub fn results(
        &mut self,
        selection: &RunSelection,
        settings: Option<&IdentifySettings>,
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
        parameters: impl Serialize,
    ) -> Result<Vec<ArchivedResult>, Diagnostic> {
        let sql = format!(
            "SELECT result.*, run.robot, run.measured FROM result JOIN run ON run.sha256 = result.run WHERE {condition} \
             ORDER BY run.robot, run.measured, result.settings, result.made_at"
        );
        self.database.query(&sql, parameters)
    }

    /// The content of a file of a run's newest result.
    pub fn result_file(&mut self, run: &str, name: &str) -> Result<Option<Vec<u8>>, Diagnostic> {
        self.result_object(run, name)?.map(|object| self.store.get(&object)).transpose()
    }

    /// The SHA-256 of a file of a run's newest result.
    pub(super) fn result_object(&mut self, run: &str, name: &str) -> Result<Option<String>, Diagnostic> {
        let sql = "SELECT f.sha256 FROM result_file f JOIN result r ON r.run = f.run AND r.settings = f.settings \
            AND r.version = f.version WHERE f.run = $1 AND f.name = $2 ORDER BY r.made_at DESC LIMIT 1";
        Ok(self.database.tuples(sql, (run, name))?.pop())
    }
}

/// Checks that a value is valid for some run: each run has its own balls and bars.
fn check_value(option: &str, value: &str) -> Result<(), Diagnostic> {
    let known: &[&str] = match option {
        "prior" => &["none", "datasheet", "posterior"],
        "model" => &["joints", "geometric"],
        _ => {
            const MAX_SET_UP_COUNT: usize = 99;
            let any = SetUpCounts {
                balls: MAX_SET_UP_COUNT,
                bars: MAX_SET_UP_COUNT,
                targets: MAX_SET_UP_COUNT,
                trackers: 1,
            };
            return parameter::parse_list(value, &[], any).map(drop);
        }
    };
    if known.contains(&value) {
        return Ok(());
    }
    let (option, value, known) = (option.into(), value.into(), known.join(", "));
    Err(OtherValue { option, value, known }.into())
}

fn lease_ms(worker: &Worker) -> i64 {
    i64::try_from(worker.lease.as_millis()).unwrap_or(i64::MAX)
}
