//! The work on robots: the view of the pages on the files in the working directory, and the requests that make the next
//! files.
//!
//! Every file is made by a request or a command in a child process, as from the command line, in the directory of the
//! robot.

mod exclusions;
mod files;
mod job_file;
mod steps;
mod trial;

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_job::page::Download;
use dbbd_job::plan::Job;
use dbbd_job::request::Request;
use dbbd_job::request::certificate::CertificateRequest;
use dbbd_job::request::check::CheckRequest;
use dbbd_job::request::compensate::{CompensateRequest, DEFAULT_LIMIT_MM, ProgramDatum};
use dbbd_job::request::identify::IdentifyRequest;
use dbbd_job::request::plan::{CheckPoses, PlanRequest, PlannedPoses};
use dbbd_job::request::scene::CellScene;
use dbbd_model::base::date;
use dbbd_model::base::hash::sha256;
use dbbd_model::conformity::Standing;
use dbbd_model::diagnostic::Diagnostic;
use serde_json::{Value, json};
use toml_edit::DocumentMut;

use self::files::{CORRECTED, FoundPlan, FoundRun, UPLOADED, WorkFiles, WorkJob, WorkPlace};
use self::steps::{Activity, CheckPart};
use super::jobs::{JobSubject, JobWork};
use super::log::LogLevel;
use super::runs::{is_plain_directory, is_sound, open_plain};
use super::{LineUse, Supervisor};
use crate::live::ServiceFinding::{
    JobChanged, LinkedDirectory, NoResult, NoRobot, NoRun, ProgramName, RobotIsMeasured, RobotName,
    RobotTaken, RunIsOn, StepTooEarly, Unwritten,
};
use crate::live::{
    EvaluationJob, JobEdit, JobInForce, NewRobot, ProgramUpload, RobotSummary, RobotWork, StepOptions,
    StepReport, StepState, WorkStep, Workbench,
};

/// The name of the simulated cell.
const DEMO: &str = "demo";
/// The ends of the files of a program.
const PROGRAM_ENDS: [&str; 6] = [".src", ".dat", ".mod", ".pgf", ".script", ".ls"];
/// Files of one upload.
const MAX_UPLOADED: usize = 50;
/// The declarations of a controller, as the page names them (`$config.dat` is no plain name).
const CONFIG: &str = "config.dat";
/// Locked while the file of a job is edited.
static EDITED: Mutex<()> = Mutex::new(());

impl Supervisor {
    /// The files of a robot.
    fn files_of(&self, robot: &str) -> Result<WorkFiles, Diagnostic> {
        let mut all = files::robots(&self.config.plans, &self.config.data).into_iter();
        let found = all.find(|place| place.name == robot).ok_or_else(|| NoRobot { robot: robot.into() })?;
        Ok(self.read_files(found))
    }

    fn read_files(&self, place: WorkPlace) -> WorkFiles {
        WorkFiles::read(place, &self.config.data, self.running().as_deref(), &self.known.of_runs)
    }

    fn reports(&self, files: &WorkFiles) -> Vec<StepReport> {
        let mut jobs = self.jobs.list();
        jobs.retain(|job| job.robot.as_ref() == Some(&files.name));
        let recording = match &self.inner().run {
            LineUse::On(running) => running.plan.clone(),
            LineUse::None | LineUse::Starting | LineUse::Reading(_) => None,
        };
        let explain = |finding| self.jobs.explained(finding);
        let (recording, today) = (recording.as_deref(), &*today());
        steps::steps(files, &Activity { jobs: &jobs, recording, today, explain: &explain })
    }

    /// Refuses a change of the job, the plan or the programs of a run in progress.
    fn check_unlocked(&self, files: &WorkFiles) -> Result<(), Diagnostic> {
        let inner = self.inner();
        let LineUse::On(running) = &inner.run else { return Ok(()) };
        let is_own = |plan: &FoundPlan| running.plan.as_deref() == Some(&*steps::served_plan(files, plan));
        if !files.plans.iter().any(is_own) {
            return Ok(());
        }
        let by = running.by.clone().unwrap_or_else(|| "this service".into());
        Err(RobotIsMeasured { robot: files.name.clone(), run: running.name.clone(), by }.into())
    }

    /// Refuses to compute with a job that names a file outside of its directory, however the job came there.
    fn check_job_of(&self, files: &WorkFiles) -> Result<(), Diagnostic> {
        let Some(WorkJob { file, .. }) = &files.job else { return Ok(()) };
        let text = files::read_job(&files.directory, file)?;
        Job::from_toml(file, &text).map_or(Ok(()), |job| files::check_named_files(&files.directory, &job))
    }

    /// Checks the job after a change, and writes it.
    fn write_job(&self, path: &Path, document: &DocumentMut) -> Result<(), Diagnostic> {
        let text = document.to_string();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let job = Job::from_toml(name, &text)?;
        files::check_named_files(dbbd_job::files::directory_of(path), &job)?;
        dbbd_job::files::write_file(path, text)
    }
}

/// The file of the job, and its text with these keys set.
fn edited_job(files: &WorkFiles, keys: &Value) -> Result<(PathBuf, DocumentMut), Diagnostic> {
    let name = files.job.as_ref().map_or("job.toml", |job| &job.file);
    let path = files.directory.join(name);
    let text =
        if path.exists() { files::read_job(&files.directory, name)? } else { job_file::HEAD.to_owned() };
    let mut document: DocumentMut = text.parse().map_err(|error| not_written(&error))?;
    job_file::set_keys(&mut document, keys)?;
    Ok((path, document))
}

fn today() -> String {
    date::utc(clock::unix_ns())
}

/// The error for a step that cannot be computed yet.
fn too_early(step: WorkStep) -> Diagnostic {
    StepTooEarly { step: step.name() }.into()
}

/// The run that a client chose, else the newest complete one.
fn chosen_run<'a>(
    files: &'a WorkFiles,
    plan: &FoundPlan,
    options: &StepOptions,
) -> Result<&'a FoundRun, Diagnostic> {
    let usable = steps::usable_runs(files, plan);
    match &options.run {
        None => usable.first().copied().ok_or_else(|| too_early(WorkStep::Result)),
        Some(name) => {
            let chosen = usable.into_iter().find(|run| run.name == *name);
            chosen.ok_or_else(|| NoRun { run: name.clone() }.into())
        }
    }
}

/// The computation of a step, and the name of the directory of its results.
fn work_of(
    files: &WorkFiles,
    step: WorkStep,
    options: &StepOptions,
) -> Result<(JobWork, String), Diagnostic> {
    let early = || too_early(step);
    let result = steps::result_directory(files).to_owned();
    let identified = steps::identified_robot(files);
    let plan = |is_check: bool| files.plan(is_check).ok_or_else(early);
    let (request, out) = match step {
        WorkStep::Robot | WorkStep::Cell | WorkStep::Measure => return Err(early()),
        WorkStep::Plan => {
            let (robot, out) = steps::planned(files, false, &today());
            let renewal = PlannedPoses::Renew { poses: PlannedPoses::RENEWAL };
            let poses = if robot.is_some() { renewal } else { PlannedPoses::Job };
            plan_request(files, robot, poses, out).ok_or_else(early)?
        }
        WorkStep::Programs => return Ok(programs_of(plan(false)?)),
        WorkStep::Result => {
            let run = chosen_run(files, plan(false)?, options)?;
            let request = IdentifyRequest {
                input: run.path.clone().into(),
                out: result.clone().into(),
                exclude: exclusions::asked(files, run, options.exclude.as_deref(), options.by.as_deref())?,
                ..IdentifyRequest::default()
            };
            (Request::Identify(request), result)
        }
        WorkStep::Correct => {
            let uploaded =
                files.programs.uploaded.as_ref().filter(|_| files.result.is_some()).ok_or_else(early)?;
            let chosen = options.program.as_deref().filter(|name| uploaded.has(name));
            let program = chosen.or(steps::uncorrected(files).first().copied()).ok_or_else(early)?;
            let in_upload = |name: &str| Path::new(UPLOADED).join(name);
            let request = CompensateRequest {
                program: in_upload(program),
                robot: identified.into(),
                out: CORRECTED.into(),
                config: uploaded.has(CONFIG).then(|| in_upload(CONFIG)),
                tool_mm_deg: None,
                start_deg: None,
                base_mm_deg: None,
                payload: None,
                plan: None,
                nominal_controller: false,
                datum: ProgramDatum::Program,
                limit_mm: DEFAULT_LIMIT_MM,
                // The directory belongs to the page.
                replace: true,
            };
            (Request::Compensate(request), CORRECTED.to_owned())
        }
        WorkStep::Check => match steps::check_part(files).ok_or_else(early)? {
            CheckPart::Plan => {
                let (poses, risk) = (CheckPoses::COUNT, CheckRequest::RISK);
                let tolerance_mm = options.tolerance_mm;
                let poses = CheckPoses { poses, balls_kept: false, tolerance_mm, risk };
                let (robot, out) = steps::planned(files, true, &today());
                plan_request(files, robot, PlannedPoses::Check(poses), out).ok_or_else(early)?
            }
            CheckPart::Programs => return Ok(programs_of(plan(true)?)),
            CheckPart::Measure => return Err(early()),
            CheckPart::Decide => {
                let run = chosen_run(files, plan(true)?, options)?;
                let out = files.check.document().map_or("check", |check| &check.directory.name).to_owned();
                let request = CheckRequest::new(
                    run.path.clone().into(),
                    identified.into(),
                    out.clone().into(),
                    options.tolerance_mm,
                );
                (Request::Check(request), out)
            }
        },
        WorkStep::Certificate => {
            files.result.as_ref().ok_or_else(early)?;
            let out = files.certificate.as_ref().map_or("certificate", |made| &made.name).to_owned();
            let check = files.check.document().map(|check| PathBuf::from(&check.directory.name));
            let request = CertificateRequest {
                result: result.into(),
                out: out.clone().into(),
                check,
                identity: None,
                specimen: steps::is_simulated(files),
                replace: false,
            };
            (Request::Certificate(request), out)
        }
    };
    Ok((JobWork::Request(Box::new(request)), out))
}

/// The request for a plan of the job, for the robot of the job or the robot in a file; `None` without a job.
fn plan_request(
    files: &WorkFiles,
    robot: Option<String>,
    poses: PlannedPoses,
    out: &str,
) -> Option<(Request, String)> {
    let job = files.job.as_ref()?.file.as_str().into();
    let request = PlanRequest {
        job,
        out: out.into(),
        robot: robot.map(Into::into),
        measured: Vec::new(),
        poses,
        replace: false,
    };
    Some((Request::Plan(request), out.to_owned()))
}

fn programs_of(plan: &FoundPlan) -> (JobWork, String) {
    let out = steps::program_directory(plan).to_owned();
    let csv = format!("{}/plan.csv", plan.directory.name);
    (JobWork::Document(vec!["program".into(), csv, "--out".into(), out.clone(), "--replace".into()]), out)
}

/// Refuses a directory that is a link or holds one, so that all files are written in the working directory.
fn check_plain(directory: &Path, name: &str) -> Result<(), Diagnostic> {
    let path = directory.join(name);
    let linked = || Diagnostic::from(LinkedDirectory { directory: name.into() });
    match std::fs::symlink_metadata(&path) {
        Err(_) => Ok(()),
        Ok(data) if !data.is_dir() => Err(linked()),
        Ok(_) => {
            let mut entries = std::fs::read_dir(&path).into_iter().flatten().flatten();
            let is_plain = entries.all(|entry| entry.file_type().is_ok_and(|kind| !kind.is_symlink()));
            if is_plain { Ok(()) } else { Err(linked()) }
        }
    }
}

impl Workbench for Supervisor {
    fn robots(&self) -> Result<Vec<RobotSummary>, Diagnostic> {
        let all = files::robots(&self.config.plans, &self.config.data).into_iter();
        let mut found: Vec<RobotSummary> = all
            .map(|place| {
                let files = self.read_files(place);
                let changed_unix_ms = files.changed_ms();
                let steps = self.reports(&files);
                summary(&files, &steps, changed_unix_ms)
            })
            .collect();
        found.sort_by_key(|robot| std::cmp::Reverse(robot.changed_unix_ms));
        Ok(found)
    }

    fn work(&self, robot: &str) -> Result<RobotWork, Diagnostic> {
        let files = self.files_of(robot)?;
        let steps = self.reports(&files);
        let directory = files.directory.display().to_string();
        Ok(RobotWork {
            robot: robot_of(&files),
            simulated_readings: steps::is_simulated(&files),
            name: files.name,
            directory,
            simulated: files.simulated,
            steps,
        })
    }

    fn create(&self, NewRobot { name, job }: NewRobot) -> Result<(), Diagnostic> {
        if !is_sound(&name) {
            return Err(RobotName.into());
        }
        let directory = self.config.plans.join(&name);
        if directory.exists() {
            return Err(RobotTaken { robot: name }.into());
        }
        let mut document: DocumentMut = job_file::HEAD.parse().map_err(|error| not_written(&error))?;
        job_file::set_keys(&mut document, &job)?;
        let made = Job::from_toml("job.toml", &document.to_string())?;
        files::check_named_files(&directory, &made)?;
        dbbd_job::files::directory(&directory)?;
        self.write_job(&directory.join("job.toml"), &document)?;
        self.log.event(LogLevel::Info, "robot_created", &[("robot", &name)]);
        Ok(())
    }

    fn demo(&self) -> Result<String, Diagnostic> {
        let directory = self.config.plans.join(DEMO);
        check_plain(&self.config.plans, DEMO)?;
        (self.simulated.make_demo)(&directory)?;
        self.log.event(LogLevel::Info, "robot_created", &[("robot", &DEMO)]);
        Ok(DEMO.into())
    }

    fn job_of(&self, robot: &str) -> Result<JobInForce, Diagnostic> {
        let files = self.files_of(robot)?;
        let Some(WorkJob { file: name, .. }) = &files.job else {
            return Ok(JobInForce { job: Value::Null, sha256: None });
        };
        let text = files::read_job(&files.directory, name)?;
        let job = dbbd_model::base::parse::from_toml(name, &text)?;
        Ok(JobInForce { job, sha256: Some(sha256(text)) })
    }

    fn edit_job(&self, robot: &str, edit: &JobEdit) -> Result<(), Diagnostic> {
        // One edit after the other: of two with the same hash the second one is refused.
        let _one = lock(&EDITED);
        let files = self.files_of(robot)?;
        self.check_unlocked(&files)?;
        let (path, document) = edited_job(&files, &edit.keys)?;
        let present = path.exists().then(|| dbbd_job::files::sha256(&path)).transpose()?;
        if present != edit.sha256 {
            return Err(JobChanged.into());
        }
        self.write_job(&path, &document)?;
        self.log.event(LogLevel::Info, "job_edited", &[("robot", &robot)]);
        Ok(())
    }

    fn try_job(&self, robot: &str, keys: &Value) -> Result<Value, Diagnostic> {
        let files = self.files_of(robot)?;
        let document = edited_job(&files, keys)?.1;
        // What is wrong with the job itself, the trial says.
        if let Ok(job) = Job::from_toml("job.toml", &document.to_string()) {
            files::check_named_files(&files.directory, &job)?;
        }
        // A trial must not take the processor from a recording or from another trial.
        if matches!(self.inner().run, LineUse::On(_) | LineUse::Starting) {
            return Err(RunIsOn.into());
        }
        let _one = self.jobs.begin_trial()?;
        let explained = |finding| json!(self.jobs.explained(finding));
        trial::try_job(&files.directory, document, explained)
    }

    fn scene(&self, robot: &str) -> Result<Value, Diagnostic> {
        let files = self.files_of(robot)?;
        let plan = files.plan(false).or(files.plans.first()).ok_or_else(|| too_early(WorkStep::Cell))?;
        let csv = files.directory.join(&plan.directory.name).join("plan.csv");
        let result = files.result.as_ref().map(|result| files.directory.join(&result.directory.name));
        let scene = CellScene::read(&csv, result.as_deref())?;
        let mut scene = serde_json::to_value(scene).map_err(|error| not_written(&error))?;
        // The name of the plan for the runs of the service.
        scene["plan"] = steps::served_plan(&files, plan).into();
        Ok(scene)
    }

    fn upload(&self, robot: &str, upload: ProgramUpload) -> Result<(), Diagnostic> {
        let files = self.files_of(robot)?;
        let is_program = |name: &str| {
            is_sound(name) && PROGRAM_ENDS.iter().any(|end| name.to_ascii_lowercase().ends_with(end))
        };
        if let Some(file) = upload.files.iter().find(|file| !is_program(&file.name)) {
            return Err(ProgramName { name: file.name.chars().take(80).collect() }.into());
        }
        let taken = upload.files.len();
        if taken == 0 || taken > MAX_UPLOADED {
            return Err(ProgramName { name: format!("{taken} files") }.into());
        }
        check_plain(&files.directory, UPLOADED)?;
        let directory = files.directory.join(UPLOADED);
        dbbd_job::files::directory(&directory)?;
        // A program is uploaded as a whole: files left of another program would be corrected with it.
        for name in
            files.programs.uploaded.iter().flat_map(|earlier| &earlier.files).filter(|name| is_program(name))
        {
            let _ = std::fs::remove_file(directory.join(name));
        }
        for file in &upload.files {
            let bytes: Result<Vec<u8>, _> = file.bytes.chars().map(u8::try_from).collect();
            let bytes = bytes.map_err(|_| ProgramName { name: file.name.clone() })?;
            dbbd_job::files::write_file(&directory.join(&file.name), bytes)?;
        }
        Ok(())
    }

    fn compute(
        &self,
        robot: &str,
        step: WorkStep,
        options: StepOptions,
    ) -> Result<EvaluationJob, Diagnostic> {
        let files = self.files_of(robot)?;
        match step {
            WorkStep::Plan | WorkStep::Programs | WorkStep::Check => self.check_unlocked(&files)?,
            WorkStep::Robot
            | WorkStep::Cell
            | WorkStep::Measure
            | WorkStep::Result
            | WorkStep::Correct
            | WorkStep::Certificate => {}
        }
        let (work, out) = work_of(&files, step, &options)?;
        if let JobWork::Request(request) = &work {
            request.check_numbers()?;
        }
        check_plain(&files.directory, &out)?;
        self.check_job_of(&files)?;
        let kind = match &work {
            JobWork::Command(_) | JobWork::Document(_) => "program",
            JobWork::Request(request) => match **request {
                Request::Identify(_) => "identify",
                Request::Plan(_) => "plan",
                Request::Check(_) => "check",
                Request::Compensate(_) => "compensate",
                Request::Circle(_) => "circle",
                Request::Certificate(_) => "certificate",
            },
        };
        let results = Some(files.directory.join(&out));
        let subject = JobSubject { kind, run: String::new(), step: Some((files.name, step)), results };
        let job = self.jobs.submit(subject, work, files.directory)?;
        self.log.event(LogLevel::Info, "job_taken", &[("job", &job.id), ("kind", &kind), ("robot", &robot)]);
        Ok(job)
    }

    fn work_file(&self, robot: &str, directory: &str, file: &str) -> Result<Download, Diagnostic> {
        let files = self.files_of(robot)?;
        let missing = || Diagnostic::from(NoResult { file: file.into() });
        let parent = files.directory.join(directory);
        if !is_sound(directory) || !is_sound(file) || !is_plain_directory(&parent) {
            return Err(missing());
        }
        let opened = open_plain(&parent.join(file)).map_err(|_| missing())?;
        let bytes = opened.metadata().map_err(|_| missing())?.len();
        Ok(Download { file: opened, name: file.to_owned(), bytes })
    }

    fn job_answer(&self, id: u64) -> Result<Value, Diagnostic> {
        self.jobs.get(id)?;
        Ok(self.jobs.document(id).map_or(Value::Null, |document| (*document).clone()))
    }
}

fn not_written(error: &dyn std::fmt::Display) -> Diagnostic {
    Unwritten { why: error.to_string() }.into()
}

/// The name of the robot of the job, or else of the result.
fn robot_of(files: &WorkFiles) -> Option<String> {
    let of_job = files.job.as_ref().and_then(|job| job.robot.as_ref()?.as_ref().ok()).cloned();
    let of_result = || Some(files.result.as_ref()?.content["robot"].as_str()?.to_owned());
    of_job.or_else(of_result)
}

/// The summary of a robot, which shows what decides on its standing: a check of its calibration, unless the validity is over;
/// else the result; else the next step.
fn summary(files: &WorkFiles, steps: &[StepReport], changed_unix_ms: Option<u64>) -> RobotSummary {
    let is_done = |step: &&StepReport| step.state == StepState::Done;
    let of = |wanted| steps.iter().find(|step| step.step == wanted);
    let decided = match steps::standing_of(files, &today()) {
        Some(Standing::Over { .. }) => of(WorkStep::Result),
        Some(_) if files.check.document().is_some() => of(WorkStep::Check),
        Some(_) => of(WorkStep::Result).filter(is_done),
        None => None,
    };
    let open = steps.iter().find(|step| !is_done(step));
    let shown = decided.or(open).or(steps.first());
    RobotSummary {
        name: files.name.clone(),
        robot: robot_of(files),
        simulated_readings: steps::is_simulated(files),
        step: shown.map_or(WorkStep::Robot, |step| step.step),
        state: shown.map_or(StepState::Todo, |step| step.state),
        verdict: shown.map_or(crate::live::StepVerdict::None, |step| step.verdict),
        text: shown.map_or("robot.none", |step| step.text),
        values: shown.map_or(Value::Null, |step| step.values.clone()),
        changed_unix_ms,
    }
}
