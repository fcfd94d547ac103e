//! Jobs: child processes of this program, one at a time.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::{io, thread};

use tokio::sync::broadcast;

use super::runs::CAPTURE;
use crate::live::ServiceFinding::{
    self, CommandFailed, JobEnded, JobTooLong, NoJob, OptionOfAnotherJob, OptionValue, TooManyJobs,
    WorkerLost,
};
use crate::live::{EvaluationJob, ExplainedFinding, JobKind, JobRequest, JobState, Message, WorkStep};
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_job::child_process;
use dbbd_job::child_process::{PROGRESS, PROGRESS_VARIABLE};
use dbbd_job::files;
use dbbd_job::request::circle::{CircleRequest, DEFAULT_DRAWS};
use dbbd_job::request::identify::{IdentifyRequest, RequestedPrior};
use dbbd_job::request::{AnswerOutcome, AnswerResult, Request, RequestChild, RequestResult, read_answer};
use dbbd_model::base::serialised;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::{Diagnostic, FindingRecord};
use serde::Deserialize;
use serde_json::Value;

/// Cause and cure of a code.
pub type Explain = fn(&str) -> Option<(&'static str, &'static str)>;

/// The file of the findings of a job, beside its results.
pub(super) const FINDINGS: &str = "findings.json";
const MAX_WAITING_JOBS: usize = 16;
const MAX_KEPT_JOBS: usize = 100;
/// Output lines that are kept per job, and their longest length in characters.
const MAX_LOG_LINES: usize = 200;
const LONGEST_LINE: usize = 400;
/// Output lines of a job in a message of the live stream.
const LINES_STREAMED: usize = 12;

pub(super) struct JobQueue {
    shared: Arc<JobsShared>,
    queue: Sender<JobTask>,
    /// Locked while a changed job is tried.
    trial: Mutex<()>,
}

struct JobsShared {
    jobs: Mutex<VecDeque<KeptJob>>,
    child: Mutex<Option<(u64, Child)>>,
    messages: broadcast::Sender<Message>,
    /// Signals the end of each job.
    over: Sender<()>,
    explain: Explain,
}

struct KeptJob {
    job: EvaluationJob,
    began: Option<HostNs>,
    /// The result of the job's request.
    document: Option<Arc<Value>>,
}

/// The subject of a job: the command, and the run or the step that it is for.
pub(super) struct JobSubject {
    pub(super) kind: &'static str,
    /// Name of the run; empty if no run is evaluated.
    pub(super) run: String,
    /// Robot and step of the workbench, if the job computes a step.
    pub(super) step: Option<(String, WorkStep)>,
    /// The directory of the results, in which the findings are kept.
    pub(super) results: Option<PathBuf>,
}

struct JobTask {
    id: u64,
    /// The directory in which the job runs.
    directory: PathBuf,
    work: JobWork,
    results: Option<PathBuf>,
}

/// The computation of a job.
pub(super) enum JobWork {
    /// A command without a request, by its arguments; its output is the log.
    Command(Vec<String>),
    /// A command that prints a JSON document with its findings.
    Document(Vec<String>),
    Request(Box<Request>),
}

/// The computation that a client requests. Settings must be lists of names.
pub(super) fn work_of(request: &JobRequest) -> Result<JobWork, Diagnostic> {
    let mut identify =
        IdentifyRequest { input: CAPTURE.into(), out: request.kind.name().into(), ..Default::default() };
    for (option, value) in
        [("prior", &request.prior), ("estimate", &request.estimate), ("hold", &request.hold)]
    {
        let Some(value) = value.as_deref().filter(|value| !value.is_empty()) else { continue };
        if request.kind != JobKind::Identify {
            return Err(OptionOfAnotherJob { option: option.into() }.into());
        }
        let sound = |byte: u8| byte.is_ascii_alphanumeric() || b"_,-".contains(&byte);
        let prior = RequestedPrior::named(value);
        // A client must not name a file.
        let known = option != "prior" || !matches!(prior, RequestedPrior::Table(_));
        if !known || value.len() > 1000 || !value.bytes().all(sound) {
            return Err(OptionValue { option: option.into(), value: value.into() }.into());
        }
        match option {
            "prior" => identify.prior = Some(prior),
            "estimate" => identify.estimate = Some(value.into()),
            _ => identify.hold = Some(value.into()),
        }
    }
    Ok(match request.kind {
        JobKind::Sync => {
            JobWork::Command(["sync", CAPTURE, "--out=sync/observations.csv"].map(String::from).into())
        }
        JobKind::Identify => JobWork::Request(Box::new(Request::Identify(identify))),
        JobKind::Circle => JobWork::Request(Box::new(Request::Circle(CircleRequest {
            inputs: vec![CAPTURE.into()],
            out: request.kind.name().into(),
            monte_carlo: DEFAULT_DRAWS,
            ..Default::default()
        }))),
    })
}

impl JobQueue {
    /// Starts the worker thread.
    pub(super) fn start(
        messages: broadcast::Sender<Message>,
        over: Sender<()>,
        explain: Explain,
    ) -> io::Result<Self> {
        let (jobs, child) = (Mutex::default(), Mutex::default());
        let shared = Arc::new(JobsShared { jobs, child, messages, over, explain });
        let (queue, tasks) = channel();
        let worker = Arc::clone(&shared);
        thread::Builder::new().name("jobs".into()).spawn(move || work(&worker, &tasks))?;
        Ok(Self { shared, queue, trial: Mutex::default() })
    }

    /// Lets one changed job at a time be tried. The trial does not wait in the queue.
    pub(super) fn begin_trial(&self) -> Result<MutexGuard<'_, ()>, Diagnostic> {
        match self.trial.try_lock() {
            Ok(trial) => Ok(trial),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => Err(TooManyJobs.into()),
        }
    }

    /// Queues a job in `directory`.
    pub(super) fn submit(
        &self,
        subject: JobSubject,
        work: JobWork,
        directory: PathBuf,
    ) -> Result<EvaluationJob, Diagnostic> {
        let mut jobs = lock(&self.shared.jobs);
        if jobs.iter().filter(|kept| kept.job.state == JobState::Waiting).count() >= MAX_WAITING_JOBS {
            return Err(TooManyJobs.into());
        }
        let id = jobs.back().map_or(1, |kept| kept.job.id + 1);
        let (robot, step) = subject.step.unzip();
        let job = EvaluationJob {
            id,
            kind: subject.kind,
            run: subject.run,
            robot,
            step,
            state: JobState::Waiting,
            elapsed_s: 0.0,
            ended_unix_ms: None,
            percent: 0,
            log: Vec::new(),
            findings: Vec::new(),
        };
        jobs.push_back(KeptJob { job: job.clone(), began: None, document: None });
        if jobs.len() > MAX_KEPT_JOBS {
            jobs.pop_front();
        }
        drop(jobs);
        let task = JobTask { id, directory, work, results: subject.results };
        self.queue.send(task).map_err(|_| WorkerLost { worker: "jobs".into() })?;
        self.shared.publish(id);
        Ok(job)
    }

    /// All jobs, the newest first.
    pub(super) fn list(&self) -> Vec<EvaluationJob> {
        lock(&self.shared.jobs).iter().rev().map(KeptJob::now).collect()
    }

    /// Whether a waiting or running job belongs to this run.
    #[cfg(feature = "archive")]
    pub(super) fn has_open_job(&self, run: &str) -> bool {
        lock(&self.shared.jobs).iter().any(|kept| kept.job.run == run && kept.is_open())
    }

    pub(super) fn get(&self, id: u64) -> Result<EvaluationJob, Diagnostic> {
        self.shared.get(id).ok_or_else(|| NoJob { job: id.to_string() }.into())
    }

    /// The result of the request of a job.
    pub(super) fn document(&self, id: u64) -> Option<Arc<Value>> {
        lock(&self.shared.jobs).iter().find(|kept| kept.job.id == id)?.document.clone()
    }

    /// Explains a finding by the catalogue.
    pub(super) fn explained(&self, finding: FindingRecord) -> ExplainedFinding {
        explained(self.shared.explain, finding)
    }

    pub(super) fn cancel(&self, id: u64) -> Result<EvaluationJob, Diagnostic> {
        if matches!(self.get(id)?.state, JobState::Waiting | JobState::Running) {
            self.shared.change(id, |job| job.state = JobState::Cancelled);
            self.kill(|running| running == id);
        }
        self.get(id)
    }

    /// Cancels all jobs before the process ends.
    pub(super) fn end(&self) {
        for kept in lock(&self.shared.jobs).iter_mut().filter(|kept| kept.is_open()) {
            kept.job.state = JobState::Cancelled;
        }
        self.kill(|_| true);
    }

    fn kill(&self, meant: impl Fn(u64) -> bool) {
        if let Some((id, child)) = &mut *lock(&self.shared.child)
            && meant(*id)
        {
            // Fails if the child has just ended.
            let _ = child.kill();
        }
    }
}

/// A finding with cause and cure; both are empty for a code of another version.
fn explained(explain: Explain, finding: FindingRecord) -> ExplainedFinding {
    let (cause, cure) = explain(&finding.code).unwrap_or_default();
    ExplainedFinding { finding, cause, cure }
}

/// The parts of a document printed with `--json` that are the same for all commands.
#[derive(Deserialize)]
struct PrintedDocument {
    #[serde(default)]
    findings: Vec<FindingRecord>,
    error: Option<FindingRecord>,
}

impl KeptJob {
    fn is_open(&self) -> bool {
        matches!(self.job.state, JobState::Waiting | JobState::Running)
    }

    fn now(&self) -> EvaluationJob {
        let mut job = self.job.clone();
        if let (Some(began), JobState::Running) = (self.began, job.state) {
            job.elapsed_s = clock::now().seconds_since(began);
        }
        job
    }
}

impl JobsShared {
    fn get(&self, id: u64) -> Option<EvaluationJob> {
        lock(&self.jobs).iter().find(|kept| kept.job.id == id).map(KeptJob::now)
    }

    fn change(&self, id: u64, change: impl FnOnce(&mut EvaluationJob)) {
        if let Some(kept) = lock(&self.jobs).iter_mut().find(|kept| kept.job.id == id) {
            change(&mut kept.job);
        }
        self.publish(id);
    }

    fn keep(&self, id: u64, document: Value) {
        if let Some(kept) = lock(&self.jobs).iter_mut().find(|kept| kept.job.id == id) {
            kept.document = Some(Arc::new(document));
        }
    }

    /// Adds a finding of the service itself.
    fn found(&self, id: u64, finding: ServiceFinding) {
        let finding = explained(self.explain, FindingRecord::from(&Diagnostic::new(finding)));
        self.change(id, |job| job.findings.push(finding));
    }

    /// Writes the findings of a job beside its results, so that they outlive this process.
    fn write_findings(&self, id: u64, directory: &Path) {
        let findings = self.get(id).map(|job| job.findings).unwrap_or_default();
        let records: Vec<&FindingRecord> = findings.iter().map(|one| &one.finding).collect();
        let written = serialised::json(&records).map_err(Diagnostic::from);
        let written = written.and_then(|json| files::write_file(&directory.join(FINDINGS), json));
        if let Err(error) = written {
            self.line(id, &error.labelled());
        }
    }

    fn publish(&self, id: u64) {
        if let Some(mut job) = self.get(id) {
            // The stream carries the newest lines. The API gives the whole log.
            job.log.drain(..job.log.len().saturating_sub(LINES_STREAMED));
            // Fails without a receiver.
            let _ = self.messages.send(Message::new("job", &job));
        }
    }

    fn line(&self, id: u64, line: &str) {
        self.change(id, |job| {
            if let Some(percent) = line.strip_prefix(PROGRESS).and_then(|rest| rest.trim().parse().ok()) {
                job.percent = percent;
                return;
            }
            if job.log.len() >= MAX_LOG_LINES {
                job.log.remove(0);
            }
            job.log.push(line.chars().take(LONGEST_LINE).collect());
        });
    }
}

fn work(shared: &Arc<JobsShared>, tasks: &Receiver<JobTask>) {
    for task in tasks {
        let id = task.id;
        let mut jobs = lock(&shared.jobs);
        let waits = |kept: &&mut KeptJob| kept.job.id == id && kept.job.state == JobState::Waiting;
        // A job that was cancelled or dropped from the list does not run.
        let Some(kept) = jobs.iter_mut().find(waits) else { continue };
        (kept.job.state, kept.began) = (JobState::Running, Some(clock::now()));
        drop(jobs);
        shared.publish(id);
        let state = run(shared, &task).unwrap_or_else(|error| {
            let finding = CommandFailed { why: error.to_string() };
            shared.line(id, &Diagnostic::new(finding).labelled());
            JobState::Failed
        });
        if let Some(directory) = task.results.as_deref().filter(|directory| directory.is_dir()) {
            shared.write_findings(id, directory);
        }
        let elapsed_s = shared.get(id).map_or(0.0, |job| job.elapsed_s);
        shared.change(id, |job| {
            job.ended_unix_ms = Some(clock::unix_ns() / 1_000_000);
            if job.state == JobState::Running {
                (job.state, job.elapsed_s, job.percent) = (state, elapsed_s, 100);
            }
        });
        // Fails without an archive.
        let _ = shared.over.send(());
    }
}

/// Computes a job in a child process, and collects its output.
fn run(shared: &Arc<JobsShared>, task: &JobTask) -> io::Result<JobState> {
    let set_up = |command: &mut Command| {
        command.current_dir(&task.directory).env("NO_COLOR", "1").env(PROGRESS_VARIABLE, "1");
    };
    match &task.work {
        JobWork::Command(args) => {
            let mut command = child_process::own()?;
            command.args(args);
            command.stdout(Stdio::piped()).stderr(Stdio::piped());
            set_up(&mut command);
            let mut child = command.spawn()?;
            let _stdin = child.stdin.take();
            let line = |stdout: ChildStdout| listen(shared, task.id, stdout);
            let (status, _) = follow(shared, task.id, child, line)?;
            Ok(state_of(status))
        }
        JobWork::Document(args) => {
            let mut command = child_process::own()?;
            command.args(args).arg("--json");
            command.stdout(Stdio::piped()).stderr(Stdio::piped());
            set_up(&mut command);
            let mut child = command.spawn()?;
            let _stdin = child.stdin.take();
            let (status, printed) = follow(shared, task.id, child, io::read_to_string)?;
            if let Ok(document) =
                serde_json::from_str::<PrintedDocument>(&printed.transpose()?.unwrap_or_default())
            {
                let all = document.findings.into_iter().chain(document.error);
                let findings: Vec<_> = all.map(|finding| explained(shared.explain, finding)).collect();
                shared.change(task.id, |job| job.findings = findings);
            }
            fail_if_ended(shared, task.id, status);
            Ok(state_of(status))
        }
        JobWork::Request(request) => {
            let RequestChild { child, stdin: _stdin } = RequestChild::start(request, set_up)?;
            let (status, answer) = follow(shared, task.id, child, io::read_to_string)?;
            fail_if_ended(shared, task.id, status);
            let answer = answer.transpose()?.as_deref().and_then(read_answer);
            let Some(mut answer) = answer else { return Ok(JobState::Failed) };
            if let AnswerResult::Refusal(refusal) = &answer.result {
                answer.findings.push(refusal.clone());
            }
            let findings: Vec<_> =
                answer.findings.into_iter().map(|finding| explained(shared.explain, finding)).collect();
            shared.change(task.id, |job| job.findings = findings);
            Ok(match answer.result {
                AnswerResult::Result(RequestResult { outcome, document, .. }) => {
                    shared.keep(task.id, document);
                    match outcome {
                        AnswerOutcome::Done => JobState::Done,
                        AnswerOutcome::Warned | AnswerOutcome::Undecided => JobState::Warned,
                        AnswerOutcome::Failed => JobState::Failed,
                    }
                }
                AnswerResult::Refusal(_) => JobState::Failed,
            })
        }
    }
}

/// Adds the finding of a job that the system ended.
fn fail_if_ended(shared: &JobsShared, id: u64, status: ExitStatus) {
    let state = shared.get(id).map(|job| job.state);
    if status.code().is_none() && state == Some(JobState::Running) {
        shared.found(id, JobEnded { max_bytes: MAX_JOB_BYTES });
    }
}

/// The state of a job whose child ended: all commands have the same exit codes.
fn state_of(status: ExitStatus) -> JobState {
    match status.code() {
        Some(0) => JobState::Done,
        Some(3) => JobState::Warned,
        _ => JobState::Failed,
    }
}

/// Follows a child process to its end. Returns its status and the result of `read` on its stdout; its stderr is the
/// log.
fn follow<T: Send>(
    shared: &Arc<JobsShared>,
    id: u64,
    mut child: Child,
    read: impl FnOnce(ChildStdout) -> T + Send,
) -> io::Result<(ExitStatus, Option<T>)> {
    confine(&child);
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    *lock(&shared.child) = Some((id, child));
    // The job may have been cancelled while its process was starting.
    if shared.get(id).is_some_and(|job| job.state == JobState::Cancelled)
        && let Some((_, child)) = &mut *lock(&shared.child)
    {
        let _ = child.kill();
    }
    let is_over = AtomicBool::new(false);
    let output = thread::scope(|scope| {
        scope.spawn(|| end_in_time(shared, id, &is_over));
        let reader = stdout.map(|stdout| scope.spawn(move || read(stdout)));
        if let Some(stderr) = stderr {
            listen(shared, id, stderr);
        }
        let output = reader.and_then(|reader| reader.join().ok());
        is_over.store(true, Ordering::Relaxed);
        output
    });
    // The outputs of the child are closed, so it ends.
    let Some((_, mut child)) = lock(&shared.child).take() else {
        return Err(io::Error::other("the child process was lost"));
    };
    Ok((child.wait()?, output))
}

/// The address space of a job, bytes, and its longest time, s.
const MAX_JOB_BYTES: u64 = 2 << 30;
const MAX_JOB_S: f64 = 3600.0;

/// Ends the child of a job that takes too long.
fn end_in_time(shared: &JobsShared, id: u64, is_over: &AtomicBool) {
    let began = clock::now();
    while !is_over.load(Ordering::Relaxed) {
        clock::sleep(0.05);
        if clock::now().seconds_since(began) > MAX_JOB_S {
            shared.found(id, JobTooLong { max_s: MAX_JOB_S });
            shared.change(id, |job| job.state = JobState::Failed);
            if let Some((_, child)) = &mut *lock(&shared.child) {
                // Fails if the child has just ended.
                let _ = child.kill();
            }
            return;
        }
    }
}

/// Limits the memory of a child process, and makes the system kill it and not the recorder if memory runs out. Only Linux can
/// do this to another process.
pub(super) fn confine(child: &Child) {
    let _ = std::fs::write(format!("/proc/{}/oom_score_adj", child.id()), "1000");
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Pid, Resource, Rlimit, prlimit};
        let most = Rlimit { current: Some(MAX_JOB_BYTES), maximum: Some(MAX_JOB_BYTES) };
        // Fails if the child has just ended.
        let _ = prlimit(Pid::from_child(child).into(), Resource::As, most);
    }
}

fn listen(shared: &JobsShared, id: u64, output: impl Read) {
    for line in BufReader::new(output).split(b'\n').map_while(Result::ok) {
        shared.line(id, &String::from_utf8_lossy(&line));
    }
}
