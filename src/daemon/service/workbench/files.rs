//! Finds the files of the work on a robot. They are recognised by their content, so that work begun on the command line
//! can be continued on the page, and the other way round.

use std::fs;
use std::path::{Component, Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::files;
use dbbd_job::plan::{Job, PoseKind};
use dbbd_job::recording::run::PlanFiles;
use dbbd_job::request::identify;
use dbbd_model::base::date;
use dbbd_model::base::hash::sha256;
use dbbd_model::conformity::StatedCheck;
use dbbd_model::diagnostic::{Diagnostic, FindingRecord};
use dbbd_model::provenance::ArtefactRole;
use dbbd_model::robot::Robot;
use serde_json::Value;

use crate::daemon::EndReason;
use crate::daemon::service::jobs::FINDINGS;
use crate::daemon::service::run_plans::{RunPlan, RunPlans};
use crate::daemon::service::runs::{
    CAPTURE, entry_of, is_plain_directory, is_plain_file, is_sound, list_recorded_runs,
};
use crate::live::RunEntry;
use crate::live::ServiceFinding::NamedOutside;

/// Reason of the end of a complete run.
pub(super) const END_MARK: &str = EndReason::Mark.reason();
/// The number of newest runs whose plan is looked for.
const MAX_RUNS: usize = 100;
/// Directories of one robot that are looked into.
const MAX_DIRECTORIES: usize = 200;
/// A file of findings is smaller.
const MAX_FINDINGS_BYTES: u64 = 1 << 20;
/// The main module of a program.
const MAIN: [&str; 5] = ["DBB_MAIN.dat", "DBB_MAIN.src", "DBB_MAIN.mod", "DBB_MAIN.script", "DBB_MAIN.ls"];
/// Directory in which the page keeps a program that shall be corrected.
pub(super) const UPLOADED: &str = "uploaded";
/// Directory into which the page writes the corrected program.
pub(super) const CORRECTED: &str = "corrected";
/// The true robot and world of a simulated cell.
const TRUTH: [&str; 2] = ["truth.toml", "world.toml"];

/// A directory with its files.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FoundDirectory {
    pub name: String,
    pub files: Vec<String>,
    /// Time at which each file was written, ms since the Unix epoch.
    pub times_ms: Vec<u64>,
    /// Time at which the newest file was written, ms since the Unix epoch.
    pub changed_ms: u64,
    /// The findings of the job that wrote the files.
    pub findings: Vec<FindingRecord>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FoundPlan {
    pub directory: FoundDirectory,
    pub hash: String,
    /// Whether the plan is for the check of a calibrated robot.
    pub is_check: bool,
    pub poses: usize,
    pub duration_s: f64,
    /// Position uncertainty that the plan will leave, 95 % of the poses, mm.
    pub predicted_mm: Option<f64>,
    /// The tolerance with which a check was planned, mm.
    pub tolerance_mm: Option<f64>,
    /// The hash of the job that the plan was made from.
    pub job_sha256: Option<String>,
    /// A program that carries the hash of the plan.
    pub program: Option<FoundDirectory>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FoundRun {
    pub name: String,
    /// Path of the capture for commands in the directory of the robot.
    pub path: String,
    pub plan_hash: String,
    pub changed_ms: u64,
    /// When it began, as the results of it state it.
    pub started: Option<String>,
    /// Reason of the end; `None` for a run that was cut off.
    pub reason: Option<String>,
    pub samples: Option<u64>,
}

/// A result with the JSON that states it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FoundDocument {
    pub directory: FoundDirectory,
    pub content: Value,
}

#[derive(Default)]
pub(super) struct WorkFiles {
    pub name: String,
    pub directory: PathBuf,
    /// Prefix of the names of plans: `NAME/`, or empty for the working directory itself.
    pub prefix: String,
    pub job: Option<WorkJob>,
    /// The plans, the newest first.
    pub plans: Vec<FoundPlan>,
    pub runs: Vec<FoundRun>,
    pub result: Option<FoundDocument>,
    pub check: FoundCheck,
    pub certificate: Option<FoundDirectory>,
    pub programs: UserPrograms,
    pub simulated: bool,
}

/// The newest check of the calibration in `result`.
#[derive(Default)]
pub(super) enum FoundCheck {
    #[default]
    None,
    /// There are only checks of other calibrations.
    OfOther,
    Of(FoundDocument),
}

impl FoundCheck {
    pub(super) fn document(&self) -> Option<&FoundDocument> {
        if let Self::Of(document) = self { Some(document) } else { None }
    }
}

/// The programs that the user uploaded, and their corrected files.
#[derive(Default)]
pub(super) struct UserPrograms {
    pub uploaded: Option<FoundDirectory>,
    pub corrected: Option<FoundDirectory>,
}

/// The job of a directory.
pub(super) struct WorkJob {
    /// The name of its file.
    pub file: String,
    pub job: Result<Job, Diagnostic>,
    pub sha256: Option<String>,
    /// The name of its robot; `None` if the job cannot be read.
    pub robot: Option<Result<String, Diagnostic>>,
}

fn unix_ms(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}

fn changed_ms(path: &Path) -> u64 {
    fs::metadata(path).and_then(|data| data.modified()).map_or(0, unix_ms)
}

/// The names in a directory that may be file names, sorted.
fn names(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| is_sound(name))
        .collect();
    names.sort();
    names
}

impl FoundDirectory {
    fn read(parent: &Path, name: &str) -> Self {
        let path = parent.join(name);
        // A link may lead out.
        let files: Vec<String> =
            names(&path).into_iter().filter(|file| is_plain_file(&path.join(file))).collect();
        let times_ms: Vec<u64> = files.iter().map(|file| changed_ms(&path.join(file))).collect();
        let changed_ms = times_ms.iter().copied().max().unwrap_or(0);
        let mut read = Self { name: name.into(), files, times_ms, changed_ms, findings: Vec::new() };
        // Files that the command line wrote since have other findings.
        if read.written_ms(FINDINGS) == Some(changed_ms) {
            let text = files::read_at_most(&path.join(FINDINGS), MAX_FINDINGS_BYTES).ok();
            read.findings = text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        }
        read
    }

    pub(super) fn has(&self, file: &str) -> bool {
        self.written_ms(file).is_some()
    }

    /// The time at which a file was written, ms since the Unix epoch.
    pub(super) fn written_ms(&self, file: &str) -> Option<u64> {
        let place = self.files.iter().position(|one| one == file)?;
        self.times_ms.get(place).copied()
    }
}

/// The place of the work on a robot.
#[derive(Clone)]
pub(super) struct WorkPlace {
    pub name: String,
    pub directory: PathBuf,
    /// Prefix of the names of plans: `NAME/`, or empty for the working directory itself.
    pub prefix: String,
}

/// The directories of robots: the working directory itself, if it has a job, a plan or a result, and such directories
/// in it. `data` has only runs and is left out.
pub(super) fn robots(plans: &Path, data: &Path) -> Vec<WorkPlace> {
    let own = own_name(plans);
    let inner = names(plans).into_iter().filter(|name| *name != own);
    let mut found: Vec<WorkPlace> = inner
        .map(|name| WorkPlace { directory: plans.join(&name), prefix: format!("{name}/"), name })
        .filter(|WorkPlace { directory, .. }| {
            is_plain_directory(directory) && !files::same_place(directory, data) && holds_work(directory)
        })
        .take(MAX_DIRECTORIES)
        .collect();
    if holds_work(plans) {
        // A directory beside a job has the job's plan or result: it is another robot only if it has a job itself.
        found.retain(|place| job_name(&place.directory).is_some());
        found.insert(0, WorkPlace { name: own, directory: plans.to_owned(), prefix: String::new() });
    }
    found
}

/// The name of the working directory itself on the page.
fn own_name(plans: &Path) -> String {
    let name = fs::canonicalize(plans).ok();
    let name = name.as_deref().and_then(Path::file_name).and_then(|name| name.to_str());
    name.filter(|name| is_sound(name)).unwrap_or("robot").to_owned()
}

fn holds_work(path: &Path) -> bool {
    job_name(path).is_some()
        || names(path).iter().any(|name| {
            let inner = path.join(name);
            is_plain_directory(&inner)
                && ["plan.json", "result.json"].iter().any(|file| inner.join(file).is_file())
        })
}

/// `job.toml`, or the first file that has the table of a bar.
fn job_name(path: &Path) -> Option<String> {
    let is_job = |name: &String| {
        let text = files::read_at_most(&path.join(name), 1 << 20);
        text.is_ok_and(|text| text.lines().any(|line| line.trim() == "[bar]"))
    };
    let all = names(path);
    all.iter().find(|name| *name == "job.toml").cloned().or_else(|| {
        all.into_iter().filter(|name| name.ends_with(".toml") && path.join(name).is_file()).find(is_job)
    })
}

impl WorkFiles {
    /// Looks into the directory of a robot. `running` is the run in progress.
    pub(super) fn read(
        WorkPlace { name, directory, prefix }: WorkPlace,
        data: &Path,
        running: Option<&str>,
        run_plans: &RunPlans,
    ) -> Self {
        let mut found = Self { name, prefix, ..Self::default() };
        found.simulated = TRUTH.iter().all(|name| directory.join(name).is_file());
        if let Some(name) = job_name(&directory) {
            let text = read_job(&directory, &name);
            let sha256 = text.as_ref().ok().map(sha256);
            let job = text.and_then(|text| Job::from_toml(&name, &text));
            found.job = Some(WorkJob {
                robot: job.as_ref().ok().map(|job| robot_name(&directory, &job.robot)),
                sha256,
                file: name,
                job,
            });
        }
        let (mut programs, mut checks) = (Vec::new(), Vec::new());
        let inner = names(&directory).into_iter().filter(|name| is_plain_directory(&directory.join(name)));
        for name in inner.take(MAX_DIRECTORIES) {
            let inside = FoundDirectory::read(&directory, &name);
            let path = directory.join(&name);
            if name == UPLOADED || name == CORRECTED {
                let place = if name == UPLOADED {
                    &mut found.programs.uploaded
                } else {
                    &mut found.programs.corrected
                };
                *place = (!inside.files.is_empty()).then_some(inside);
            } else if inside.has("result.json") {
                let is_newest = |one: &FoundDocument| one.directory.changed_ms < inside.changed_ms;
                if found.result.as_ref().is_none_or(is_newest) {
                    let read = FoundDocument::read(&path.join("result.json"), inside);
                    found.result = read.or(found.result);
                }
            } else if inside.has("check.json") {
                checks.extend(FoundDocument::read(&path.join("check.json"), inside));
            } else if inside.has("certificate.html") {
                if found.certificate.as_ref().is_none_or(|one| one.changed_ms < inside.changed_ms) {
                    found.certificate = Some(inside);
                }
            } else if inside.has("plan.csv") && inside.has("plan.json") {
                found.plans.extend(FoundPlan::read(&path, inside));
            } else if MAIN.iter().any(|main| inside.has(main)) {
                let texts =
                    MAIN.iter().filter_map(|main| files::read_at_most(&path.join(main), 4 << 20).ok());
                programs.push((inside, texts.collect::<String>()));
            }
        }
        let robot =
            found.result.as_ref().map(|result| directory.join(&result.directory.name).join(identify::ROBOT));
        let sha256 = robot.and_then(|robot| files::sha256(&robot).ok());
        let is_own = |check: &FoundDocument| {
            let stated: Option<StatedCheck> = serde_json::from_value(check.content.clone()).ok();
            stated.zip(sha256.as_ref()).is_some_and(|(check, robot)| check.is_of(robot))
        };
        let without_own = if checks.is_empty() { FoundCheck::None } else { FoundCheck::OfOther };
        let own = checks.into_iter().filter(is_own);
        found.check = own.max_by_key(|check| check.directory.changed_ms).map_or(without_own, FoundCheck::Of);
        found.plans.sort_by_key(|plan| std::cmp::Reverse(plan.directory.changed_ms));
        for plan in &mut found.plans {
            // The provenance of a program may name other plans too.
            let own = format!("calibration, plan {}", plan.hash);
            let of_plan = programs.iter().filter(|(_, text)| text.contains(&own));
            plan.program = of_plan.map(|(directory, _)| directory.clone()).max_by_key(|one| one.changed_ms);
        }
        found.runs = found_runs(&directory, data, running, run_plans);
        let plans = &found.plans;
        found.runs.retain(|run| plans.iter().any(|plan| plan.hash == run.plan_hash));
        found.runs.sort_by_key(|run| std::cmp::Reverse(run.changed_ms));
        found.directory = directory;
        found
    }

    /// The newest plan, of a calibration or of a check.
    pub(super) fn plan(&self, is_check: bool) -> Option<&FoundPlan> {
        self.plans.iter().find(|plan| plan.is_check == is_check)
    }

    /// The newest run of a plan.
    pub(super) fn run(&self, plan: &FoundPlan) -> Option<&FoundRun> {
        self.runs.iter().find(|run| run.plan_hash == plan.hash)
    }

    /// The time at which the newest file was written, ms since the Unix epoch.
    pub(super) fn changed_ms(&self) -> Option<u64> {
        let job = self.job.as_ref().map(|job| changed_ms(&self.directory.join(&job.file)));
        let directories = self.plans.iter().map(|plan| &plan.directory);
        let documents =
            [self.result.as_ref(), self.check.document()].into_iter().flatten().map(|one| &one.directory);
        let others = [&self.certificate, &self.programs.corrected].into_iter().flatten();
        let changed = directories.chain(documents).chain(others).map(|one| one.changed_ms);
        changed.chain(self.runs.iter().map(|run| run.changed_ms)).chain(job).max()
    }
}

impl FoundDocument {
    fn read(path: &Path, directory: FoundDirectory) -> Option<Self> {
        let content = serde_json::from_str(&files::read_text(path).ok()?).ok()?;
        Some(Self { directory, content })
    }
}

/// The text of the file of a job, which must be in the directory of the robot: a link may lead out.
pub(super) fn read_job(directory: &Path, name: &str) -> Result<String, Diagnostic> {
    check_inside(directory, name)?;
    files::read_definition(&directory.join(name))
}

/// Refuses a file that a job names and that is not in the directory of the robot: a client may write the job, and must not
/// read other files of the server by it.
pub(super) fn check_inside(directory: &Path, name: &str) -> Result<(), Diagnostic> {
    let outside = || Diagnostic::from(NamedOutside { file: name.into() });
    let is_plain = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
    match (directory.join(name).canonicalize(), directory.canonicalize()) {
        _ if !is_plain => Err(outside()),
        // A link may lead out.
        (Ok(file), Ok(directory)) if !file.starts_with(&directory) => Err(outside()),
        _ => Ok(()),
    }
}

/// Refuses a job that names a file outside of the directory of its robot.
pub(super) fn check_named_files(directory: &Path, job: &Job) -> Result<(), Diagnostic> {
    if Robot::built_in_file(&job.robot).is_none() {
        check_inside(directory, &job.robot)?;
    }
    if ProtocolDefinition::by_name(&job.bar.protocol).is_none() {
        check_inside(directory, &job.bar.protocol)?;
    }
    Ok(())
}

/// The name of a robot that a job names: built in, or a file beside the job.
fn robot_name(directory: &Path, name: &str) -> Result<String, Diagnostic> {
    let robot = match Robot::built_in_file(name) {
        Some(text) => Robot::from_toml(name, text)?,
        None if name.ends_with(".toml") => {
            check_inside(directory, name)?;
            Robot::from_toml(name, &files::read_definition(&directory.join(name))?)?
        }
        None => return Err(Robot::unknown(name)),
    };
    Ok(robot.name)
}

impl FoundPlan {
    /// Reads a plan. `None` if its files cannot be read: the plan is then made again.
    fn read(path: &Path, directory: FoundDirectory) -> Option<Self> {
        let PlanFiles { plan, json, .. } = PlanFiles::read(&path.join("plan.csv")).ok()?;
        // The predictions are written for people, so reading the plan does not return them.
        let header: Value = serde_json::from_str(&json).ok()?;
        let job = plan.header.provenance.from.iter().find(|source| source.role == ArtefactRole::Job);
        Some(Self {
            directory,
            hash: plan.header.hash.clone(),
            is_check: header["check"].is_object(),
            poses: plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).count(),
            duration_s: plan.duration_s(),
            predicted_mm: header["predictions"]["identified_mm"]["p95"].as_f64(),
            tolerance_mm: header["check"]["tolerance_mm"].as_f64(),
            job_sha256: job.map(|job| job.sha256.clone()),
            program: None,
        })
    }
}

/// The captures in the directory of a robot and the captures of the service.
fn found_runs(directory: &Path, data: &Path, running: Option<&str>, run_plans: &RunPlans) -> Vec<FoundRun> {
    let mut found = Vec::new();
    for name in names(directory).into_iter().filter(|name| name.ends_with(".dbbd")).take(MAX_RUNS) {
        let path = directory.join(&name);
        let Ok(entry) = entry_of(&name, &path, None, Vec::new()) else { continue };
        if let Some(RunPlan { hash: plan_hash, .. }) = run_plans.of(&path, entry.started_unix_ms) {
            found.push(FoundRun::new(name.clone(), name, plan_hash, changed_ms(&path), entry));
        }
    }
    let of_service = list_recorded_runs(data, running).unwrap_or_default();
    for entry in of_service.into_iter().take(MAX_RUNS).filter(|entry| running != Some(entry.name.as_str())) {
        let path = data.join(&entry.name).join(CAPTURE);
        if let Some(RunPlan { hash: plan_hash, .. }) = run_plans.of(&path, entry.started_unix_ms) {
            let shown = relative(directory, &path).display().to_string();
            found.push(FoundRun::new(entry.name.clone(), shown, plan_hash, changed_ms(&path), entry));
        }
    }
    found
}

/// A path as a command in `directory` names it: relative where both are in one working directory.
fn relative(directory: &Path, path: &Path) -> PathBuf {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (directory, path) = (absolute(directory), absolute(path));
    if let Ok(inside) = path.strip_prefix(&directory) {
        return inside.to_owned();
    }
    let beside = directory.parent().and_then(|parent| path.strip_prefix(parent).ok());
    beside.map_or_else(|| path.clone(), |beside| Path::new("..").join(beside))
}

impl FoundRun {
    /// Whether it reached the end of its program.
    pub(super) fn is_complete(&self) -> bool {
        self.reason.as_deref() == Some(END_MARK)
    }

    fn new(name: String, path: String, plan_hash: String, changed_ms: u64, entry: RunEntry) -> Self {
        let RunEntry { started_unix_ms, ended, .. } = entry;
        let started = started_unix_ms.map(|ms| date::utc(ms * 1_000_000));
        let (reason, samples) = ended.map(|ended| (ended.reason, ended.samples)).unzip();
        Self { name, path, plan_hash, changed_ms, started, reason, samples }
    }
}
