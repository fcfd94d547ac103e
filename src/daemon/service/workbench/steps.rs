//! The states of the nine steps, from the files that exist and the jobs of the service.

use dbbd_job::request::identify;
use dbbd_model::base::date;
use dbbd_model::conformity::{ConformityOutcome, Headline, Standing, StatedCheck, StatedResult, standing};
use dbbd_model::diagnostic::{Diagnostic, FindingRecord, Severity};
use dbbd_model::provenance::Provenance;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::exclusions;
use super::files::{
    CORRECTED, FoundCheck, FoundDirectory, FoundDocument, FoundPlan, FoundRun, UPLOADED, WorkFiles, WorkJob,
};
use crate::live::{
    EvaluationJob, ExplainedFinding, JobState, RunChoice, StepAction, StepReport, StepState, StepVerdict,
    WorkStep,
};

/// Number of findings that are shown of a result.
const MAX_FINDINGS: usize = 40;
/// A renewal is offered this many months before a calibration ends.
const RENEWAL_MONTHS: f64 = 1.0;
/// The directory of the plan of a renewal, so that the plan of the job is kept.
const RENEWAL: &str = "renewal-plan";

/// The present activity of the service.
pub(super) struct Activity<'a> {
    /// The jobs of this robot, the newest first.
    pub(super) jobs: &'a [EvaluationJob],
    /// The plan of the run in progress.
    pub(super) recording: Option<&'a str>,
    /// The time, as `date::utc` writes it.
    pub(super) today: &'a str,
    pub(super) explain: &'a dyn Fn(FindingRecord) -> ExplainedFinding,
}

/// The next part of a check. Plan, programs and decision are computed one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CheckPart {
    Plan,
    Programs,
    Measure,
    Decide,
}

/// The state of a step by its files alone, without the jobs of the service.
struct Drafted {
    state: StepState,
    verdict: StepVerdict,
    text: &'static str,
    values: Value,
    findings: Vec<FindingRecord>,
    action: Option<StepAction>,
    label: &'static str,
    command: String,
    plan: Option<String>,
    runs: Vec<RunChoice>,
    directory: Option<FoundDirectory>,
}

impl Drafted {
    fn new(state: StepState, verdict: StepVerdict, text: &'static str, values: Value) -> Self {
        Self {
            state,
            verdict,
            text,
            values,
            findings: Vec::new(),
            action: None,
            label: "act.none",
            command: String::new(),
            plan: None,
            runs: Vec::new(),
            directory: None,
        }
    }

    fn todo(text: &'static str) -> Self {
        Self::new(StepState::Todo, StepVerdict::None, text, Value::Null)
    }

    fn ready(text: &'static str) -> Self {
        Self::new(StepState::Ready, StepVerdict::None, text, Value::Null)
    }

    fn done(verdict: StepVerdict, text: &'static str, values: Value) -> Self {
        Self::new(StepState::Done, verdict, text, values)
    }

    fn refused(text: &'static str, why: &Diagnostic) -> Self {
        let mut refused = Self::new(StepState::Attention, StepVerdict::Fail, text, Value::Null);
        refused.findings.push(FindingRecord::from(why));
        refused
    }

    fn acting(mut self, action: StepAction, label: &'static str) -> Self {
        (self.action, self.label) = (Some(action), label);
        self
    }

    fn command(mut self, command: String) -> Self {
        self.command = command;
        self
    }

    fn made(mut self, directory: Option<&FoundDirectory>) -> Self {
        self.directory = directory.cloned();
        self
    }
}

/// The nine steps.
pub(super) fn steps(files: &WorkFiles, now: &Activity<'_>) -> Vec<StepReport> {
    [
        (WorkStep::Robot, robot(files)),
        (WorkStep::Cell, cell(files)),
        (WorkStep::Plan, plan(files, now)),
        (WorkStep::Programs, programs(files)),
        (WorkStep::Measure, measure(files, now)),
        (WorkStep::Result, result(files, now)),
        (WorkStep::Correct, correct(files, now)),
        (WorkStep::Check, check(files, now)),
        (WorkStep::Certificate, certificate(files, now)),
    ]
    .map(|(step, drafted)| report(step, drafted, now))
    .into()
}

/// The report of a step, with its last job.
fn report(step: WorkStep, mut drafted: Drafted, now: &Activity<'_>) -> StepReport {
    let job = now.jobs.iter().find(|job| job.step == Some(step));
    let mut findings: Vec<ExplainedFinding> =
        drafted.findings.drain(..).map(|finding| (now.explain)(finding)).collect();
    match job.map(|job| job.state) {
        Some(JobState::Waiting | JobState::Running) => {
            drafted = Drafted {
                command: drafted.command,
                ..Drafted::new(StepState::Running, StepVerdict::None, "computing", Value::Null)
            };
        }
        // Files that were made after the refusal, also by the command line, are newer.
        Some(JobState::Failed) if !made_since(&drafted, job) && is_refusal(job) => {
            (drafted.state, drafted.verdict) = (StepState::Attention, StepVerdict::Fail);
            (drafted.text, drafted.values) = ("refused", Value::Null);
            findings.clear();
        }
        Some(JobState::Failed | JobState::Done | JobState::Warned | JobState::Cancelled) | None => {}
    }
    let directory = drafted.directory.unwrap_or_default();
    if findings.is_empty() {
        findings = match job {
            Some(job) if job.state != JobState::Done && job.state != JobState::Warned => job.findings.clone(),
            // What was found in files that are to be made again is no longer about these files.
            _ if drafted.state == StepState::Ready => Vec::new(),
            _ => directory.findings.iter().cloned().map(now.explain).collect(),
        };
    }
    findings.sort_by_key(|one| match one.finding.severity {
        Severity::Error => 0,
        Severity::Warning => 1,
        Severity::Info => 2,
    });
    findings.truncate(MAX_FINDINGS);
    StepReport {
        step,
        state: drafted.state,
        verdict: drafted.verdict,
        text: drafted.text,
        values: drafted.values,
        findings,
        action: drafted.action,
        label: drafted.label,
        command: drafted.command,
        plan: drafted.plan,
        runs: drafted.runs,
        changed_unix_ms: (!directory.files.is_empty()).then_some(directory.changed_ms),
        directory: directory.name,
        files: directory.files,
        job: job.cloned(),
    }
}

fn made_since(drafted: &Drafted, job: Option<&EvaluationJob>) -> bool {
    let ended_ms = job.and_then(|job| job.ended_unix_ms).unwrap_or(0);
    drafted.directory.as_ref().is_some_and(|directory| directory.changed_ms > ended_ms)
}

/// Whether a failed job is a refusal: a check that fails is a result, not a refusal.
fn is_refusal(job: Option<&EvaluationJob>) -> bool {
    let mut findings = job.iter().flat_map(|job| &job.findings);
    job.is_some_and(|job| job.kind != "check") || findings.any(|one| one.finding.severity == Severity::Error)
}

fn robot(files: &WorkFiles) -> Drafted {
    let robot = match files.job.as_ref().map(|of| (&of.job, &of.robot)) {
        Some((Err(why), _)) => Drafted::refused("robot.job_refused", why),
        Some((Ok(_), Some(Err(why)))) => Drafted::refused("robot.refused", why),
        Some((Ok(job), Some(Ok(name)))) => {
            let values = json!({ "robot": name, "file": job.robot, "serial": job.serial });
            Drafted::done(StepVerdict::Pass, "robot.found", values)
        }
        Some((Ok(_), None)) | None => Drafted::ready("robot.none"),
    };
    let label = if files.job.is_some() { "act.edit" } else { "act.new_job" };
    robot.acting(StepAction::Edit, label).command("dbbd robots list".into())
}

fn cell(files: &WorkFiles) -> Drafted {
    let Some(WorkJob { job: Ok(job), .. }) = &files.job else { return Drafted::todo("cell.none") };
    let values = json!({
        "length_mm": job.bar.length_mm, "low_mm": job.bar.stroke_mm[0], "high_mm": job.bar.stroke_mm[1],
        "balls": job.centres.len(), "circles": job.circles.len(), "obstacles": job.obstacles.len(),
        "u_mm": job.bar.length_u_mm,
    });
    Drafted::done(StepVerdict::Pass, "cell.found", values).acting(StepAction::Edit, "act.edit")
}

/// The name of the job's file in a command.
fn job_file(files: &WorkFiles) -> &str {
    files.job.as_ref().map_or("job.toml", |job| &job.file)
}

/// The directory of the newest plan of a kind, or the directory for a new one.
fn plan_directory(files: &WorkFiles, is_check: bool) -> &str {
    let new = if is_check { "check-plan" } else { "plan" };
    let own = |plan: &&FoundPlan| plan.is_check == is_check && plan.directory.name != RENEWAL;
    files.plans.iter().find(own).map_or(new, |plan| &plan.directory.name)
}

/// The robot that the next plan is made for (`None` for the robot of the job), and the directory of the plan: of a
/// check, of a renewal, or of the job.
pub(super) fn planned<'a>(files: &'a WorkFiles, is_check: bool, today: &str) -> (Option<String>, &'a str) {
    let is_renewal = !is_check && is_renewed(files, today);
    let robot = (is_check || is_renewal).then(|| identified_robot(files));
    (robot, if is_renewal { RENEWAL } else { plan_directory(files, is_check) })
}

/// Whether the next plan renews the calibration: its validity is over or nearly over, and the job was not changed since
/// it was planned.
fn is_renewed(files: &WorkFiles, today: &str) -> bool {
    let left = months_left(files, today);
    let is_current = files.plan(false).is_none_or(|plan| !is_stale(files, plan));
    left.is_some_and(|months| months < RENEWAL_MONTHS) && is_current
}

/// Months until the end of the validity; `None` if the end is not known.
fn months_left(files: &WorkFiles, today: &str) -> Option<f64> {
    let check: Option<StatedCheck> = files.check.document().and_then(stated);
    let result: StatedResult = stated(files.result.as_ref()?)?;
    date::months_between(today, result.until(check.as_ref())?)
}

/// Whether the calibration of the newest result may be used.
pub(super) fn standing_of(files: &WorkFiles, today: &str) -> Option<Standing> {
    let result = stated(files.result.as_ref()?)?;
    let check: Option<StatedCheck> = files.check.document().and_then(stated);
    Some(standing(&result, check.as_ref(), Some(today)))
}

/// What a document states.
fn stated<T: DeserializeOwned>(document: &FoundDocument) -> Option<T> {
    serde_json::from_value(document.content.clone()).ok()
}

/// The file of the identified robot.
pub(super) fn identified_robot(files: &WorkFiles) -> String {
    format!("{}/{}", result_directory(files), identify::ROBOT)
}

fn plan(files: &WorkFiles, now: &Activity<'_>) -> Drafted {
    let (robot, directory) = planned(files, false, now.today);
    let asked = robot.as_ref().map(|robot| format!(" --renew --robot {robot}")).unwrap_or_default();
    let command = format!("dbbd plan {}{asked} --out {directory}", job_file(files));
    let Some(WorkJob { job: Ok(_), .. }) = &files.job else {
        return Drafted::todo("plan.no_job").command(command);
    };
    let ending = files.result.as_ref().filter(|_| robot.is_some());
    let drafted = match (files.plan(false), ending) {
        (Some(plan), _) if is_stale(files, plan) => {
            Drafted::ready("plan.stale").acting(StepAction::Compute, "act.plan_again")
        }
        (plan, Some(result))
            if plan.is_none_or(|plan| plan.directory.changed_ms < result.directory.changed_ms) =>
        {
            let is_over = matches!(standing_of(files, now.today), Some(Standing::Over { .. }));
            let text = if is_over { "plan.over" } else { "plan.ends" };
            let values = json!({ "until": result.content["validity"]["until"] });
            let ready = Drafted::new(StepState::Ready, StepVerdict::None, text, values);
            ready.acting(StepAction::Compute, "act.renew")
        }
        (None, _) => Drafted::ready("plan.none").acting(StepAction::Compute, "act.plan"),
        (Some(plan), _) => {
            let values = json!({
                "poses": plan.poses, "minutes": plan.duration_s / 60.0, "predicted_mm": plan.predicted_mm,
            });
            let text = if plan.predicted_mm.is_some() { "plan.found" } else { "plan.found_bare" };
            Drafted::done(StepVerdict::Pass, text, values).acting(StepAction::Compute, "act.plan_again")
        }
    };
    drafted.command(command).made(files.plan(false).map(|plan| &plan.directory))
}

/// Whether the job was changed since the plan was made.
fn is_stale(files: &WorkFiles, plan: &FoundPlan) -> bool {
    let of_job = files.job.as_ref().and_then(|job| job.sha256.as_ref());
    matches!((&plan.job_sha256, of_job), (Some(of_plan), Some(of_job)) if of_plan != of_job)
}

/// The directory of the programs of a plan, or the directory for new ones.
pub(super) fn program_directory(plan: &FoundPlan) -> &str {
    let new = match &*plan.directory.name {
        RENEWAL => "renewal-program",
        _ if plan.is_check => "check-program",
        _ => "program",
    };
    plan.program.as_ref().map_or(new, |directory| &directory.name)
}

fn program_command(plan: &FoundPlan) -> String {
    format!("dbbd program {}/plan.csv --out {}", plan.directory.name, program_directory(plan))
}

fn programs(files: &WorkFiles) -> Drafted {
    let Some(plan) = files.plan(false) else {
        return Drafted::todo("programs.no_plan").command("dbbd program plan/plan.csv --out program".into());
    };
    let drafted = match &plan.program {
        None => Drafted::ready("programs.none").acting(StepAction::Compute, "act.programs"),
        Some(program) => {
            let values = json!({ "files": program.files.len(), "directory": program.name });
            let done = Drafted::done(StepVerdict::None, "programs.found", values);
            done.acting(StepAction::Compute, "act.programs_again")
        }
    };
    drafted.command(program_command(plan)).made(plan.program.as_ref())
}

fn acquire_command(plan: &FoundPlan, run: &str) -> String {
    format!("dbbd acquire --port PORT --plan {}/plan.csv --out {run}", plan.directory.name)
}

/// The name of a plan as the service knows it.
pub(super) fn served_plan(files: &WorkFiles, plan: &FoundPlan) -> String {
    format!("{}{}", files.prefix, plan.directory.name)
}

fn measure(files: &WorkFiles, now: &Activity<'_>) -> Drafted {
    let Some(plan) = files.plan(false) else {
        let command = "dbbd acquire --port PORT --plan plan/plan.csv --out run.dbbd";
        return Drafted::todo("measure.no_plan").command(command.into());
    };
    let served = served_plan(files, plan);
    let run = files.run(plan);
    let mut drafted = match run {
        _ if now.recording == Some(&*served) => {
            let running = Drafted::new(StepState::Running, StepVerdict::None, "measure.running", Value::Null);
            running.acting(StepAction::Measure, "act.watch")
        }
        None if plan.program.is_none() => Drafted::todo("measure.no_programs"),
        None => Drafted::ready("measure.ready").acting(StepAction::Measure, "act.measure"),
        Some(run) => of_run(run).acting(StepAction::Measure, "act.measure_again"),
    };
    drafted.plan = Some(served);
    drafted.command(acquire_command(plan, "run.dbbd"))
}

/// The state of a step with a run that ended, by the content of the run.
fn of_run(run: &FoundRun) -> Drafted {
    let values = json!({ "run": run.name, "samples": run.samples, "reason": run.reason });
    match (run.samples, run.reason.as_deref()) {
        (Some(0), _) => Drafted::new(StepState::Attention, StepVerdict::Fail, "measure.empty", values),
        (Some(_), Some(_)) if run.is_complete() => Drafted::done(StepVerdict::Pass, "measure.done", values),
        (Some(_), _) => Drafted::new(StepState::Attention, StepVerdict::Undecided, "measure.early", values),
        (None, _) => Drafted::new(StepState::Attention, StepVerdict::Undecided, "measure.cut_off", values),
    }
}

/// The runs of a plan with samples, those that reached the end of their program first, then by their times.
pub(super) fn usable_runs<'a>(files: &'a WorkFiles, plan: &FoundPlan) -> Vec<&'a FoundRun> {
    let of_plan = files.runs.iter().filter(|run| run.plan_hash == plan.hash && run.samples != Some(0));
    let (mut usable, others): (Vec<_>, Vec<_>) = of_plan.partition(|run| run.is_complete());
    usable.extend(others);
    usable
}

/// The run that a result is made from: the newest complete one. A run that was cut off never replaces it.
pub(super) fn usable_run<'a>(files: &'a WorkFiles, plan: &FoundPlan) -> Option<&'a FoundRun> {
    usable_runs(files, plan).first().copied()
}

/// The directory of the newest result, or the directory for a new one.
pub(super) fn result_directory(files: &WorkFiles) -> &str {
    files.result.as_ref().map_or("result", |result| &result.directory.name)
}

fn result(files: &WorkFiles, now: &Activity<'_>) -> Drafted {
    let run = files.plan(false).and_then(|plan| usable_run(files, plan));
    let input = run.map_or("run.dbbd", |run| &run.path);
    let exclude = exclusions::options(&exclusions::of_result(files, run));
    let command = format!("dbbd identify {input}{exclude} --out {}", result_directory(files));
    let drafted = match (&files.result, run) {
        (None, None) => return Drafted::todo("result.no_run").command(command),
        (None, Some(_)) => Drafted::ready("result.none").acting(StepAction::Compute, "act.result"),
        (Some(result), Some(run)) if run.changed_ms > result.directory.changed_ms => {
            Drafted::ready("result.stale").acting(StepAction::Compute, "act.result")
        }
        (Some(result), run) => {
            let done = of_result(files, result, now.today);
            if run.is_some() { done.acting(StepAction::Compute, "act.result_again") } else { done }
        }
    };
    let mut drafted = drafted.command(command).made(files.result.as_ref().map(|result| &result.directory));
    drafted.runs = choices(files, files.plan(false));
    drafted
}

/// The runs of a plan to choose from.
fn choices(files: &WorkFiles, plan: Option<&FoundPlan>) -> Vec<RunChoice> {
    let usable = plan.map(|plan| usable_runs(files, plan)).unwrap_or_default();
    let choice = |run: &FoundRun| RunChoice {
        name: run.name.clone(),
        complete: run.is_complete(),
        samples: run.samples,
    };
    usable.into_iter().map(choice).collect()
}

fn of_result(files: &WorkFiles, result: &FoundDocument, today: &str) -> Drafted {
    let standing = standing_of(files, today);
    let content = &result.content;
    let found: Vec<FindingRecord> =
        content["findings"].as_array().into_iter().flatten().filter_map(recorded).collect();
    let run = files
        .runs
        .iter()
        .find(|run| run.started.as_deref() == content["provenance"]["identity"]["measured"].as_str());
    let headline = standing.as_ref().and_then(|standing| Headline::of_json(content, standing));
    let [until, measured] = [|one: &Headline| one.until.clone(), |one: &Headline| one.measured.clone()]
        .map(|of| headline.as_ref().and_then(of));
    let values = json!({
        "robot": content["robot"], "measurements": content["measurements"], "headline": headline,
        "rank": content["rank"], "until": until, "measured": measured, "run": run.map(|run| &run.name),
    });
    let mut drafted = match standing {
        Some(Standing::Usable { until: Some(_) }) => Drafted::done(StepVerdict::Pass, "result.valid", values),
        Some(Standing::Usable { until: None }) => Drafted::done(StepVerdict::None, "result.found", values),
        Some(Standing::Undecided) => Drafted::done(StepVerdict::Undecided, "result.undecided", values),
        Some(Standing::Over { .. }) => Drafted::done(StepVerdict::Undecided, "result.over", values),
        Some(Standing::Failed) => {
            Drafted::new(StepState::Attention, StepVerdict::Fail, "result.failed", values)
        }
        Some(Standing::Warned) | None => Drafted::done(StepVerdict::Undecided, "result.warned", values),
    };
    drafted.findings = found;
    drafted
}

fn recorded(finding: &Value) -> Option<FindingRecord> {
    serde_json::from_value(finding.clone()).ok()
}

fn correct(files: &WorkFiles, now: &Activity<'_>) -> Drafted {
    let robot = identified_robot(files);
    let next = uncorrected(files).first().copied().or(programs_in(files.programs.uploaded.as_ref()).next());
    let program = next.unwrap_or("PROGRAM.src");
    let command = format!("dbbd compensate {UPLOADED}/{program} --robot {robot} --out {CORRECTED}");
    if files.result.is_none() {
        return Drafted::todo("correct.no_result").command(command);
    }
    let is_failed = standing_of(files, now.today) == Some(Standing::Failed);
    let left = uncorrected(files);
    let all = programs_in(files.programs.uploaded.as_ref()).count();
    let drafted = match &files.programs.corrected {
        _ if all == 0 && is_failed => {
            let values = json!({ "left": 0, "all": 0 });
            let attention = Drafted::new(StepState::Attention, StepVerdict::Fail, "correct.failed", values);
            attention.acting(StepAction::Upload, "act.upload")
        }
        _ if all == 0 => Drafted::ready("correct.none").acting(StepAction::Upload, "act.upload"),
        Some(made) if left.is_empty() && !is_failed => {
            let values = json!({ "files": made.files.len(), "directory": made.name });
            let done = Drafted::done(StepVerdict::None, "correct.found", values);
            done.acting(StepAction::Upload, "act.upload_again")
        }
        Some(_) | None => {
            let values = json!({ "left": left.len(), "all": all });
            if is_failed {
                let attention =
                    Drafted::new(StepState::Attention, StepVerdict::Fail, "correct.failed", values);
                attention.acting(StepAction::Compute, "act.correct_anyway")
            } else {
                let ready = Drafted::new(StepState::Ready, StepVerdict::None, "correct.uploaded", values);
                ready.acting(StepAction::Compute, "act.correct")
            }
        }
    };
    drafted.command(command).made(files.programs.corrected.as_ref())
}

/// The programs among uploaded files; the other files belong to the programs.
fn programs_in(uploaded: Option<&FoundDirectory>) -> impl Iterator<Item = &str> {
    let is_program = |name: &&str| {
        [".src", ".mod", ".script", ".ls"].iter().any(|end| name.to_ascii_lowercase().ends_with(end))
    };
    uploaded.into_iter().flat_map(|uploaded| &uploaded.files).map(String::as_str).filter(is_program)
}

/// The uploaded programs that were not corrected with the result yet.
pub(super) fn uncorrected(files: &WorkFiles) -> Vec<&str> {
    let result_ms = files.result.as_ref().map_or(0, |result| result.directory.changed_ms);
    let uploaded = files.programs.uploaded.as_ref();
    let is_corrected = |name: &str| {
        let written_ms = files.programs.corrected.as_ref().and_then(|corrected| corrected.written_ms(name));
        let uploaded_ms = uploaded.and_then(|uploaded| uploaded.written_ms(name)).unwrap_or(0);
        written_ms.is_some_and(|written_ms| written_ms >= uploaded_ms.max(result_ms))
    };
    programs_in(uploaded).filter(|name| !is_corrected(name)).collect()
}

/// The next part of a check; `None` without a result.
pub(super) fn check_part(files: &WorkFiles) -> Option<CheckPart> {
    files.result.as_ref()?;
    let Some(plan) = files.plan(true) else { return Some(CheckPart::Plan) };
    let run = usable_run(files, plan);
    Some(match (run, &plan.program) {
        (Some(_), _) => CheckPart::Decide,
        (None, None) => CheckPart::Programs,
        (None, Some(_)) => CheckPart::Measure,
    })
}

fn check(files: &WorkFiles, now: &Activity<'_>) -> Drafted {
    let robot = identified_robot(files);
    let directory = files.check.document().map_or("check", |check| &check.directory.name);
    let plan = files.plan(true);
    // The tolerance of the decision, else that with which the check was planned.
    let decided_mm = files.check.document().and_then(|check| check.content["tolerance_mm"].as_f64());
    let tolerance_mm = decided_mm.or_else(|| plan?.tolerance_mm);
    let tolerance = tolerance_mm.map_or_else(String::new, |mm| format!(" --tolerance {mm}"));
    let plan_command = format!(
        "dbbd plan --check {} --robot {robot}{tolerance} --out {}",
        job_file(files),
        plan_directory(files, true)
    );
    let run = plan.and_then(|plan| usable_run(files, plan));
    let served = plan.map(|plan| served_plan(files, plan));
    let decide_command = |run: &str| format!("dbbd check {run} --robot {robot}{tolerance} --out {directory}");
    let drafted = match (check_part(files), plan) {
        (None, _) => return Drafted::todo("check.no_result").command(plan_command),
        _ if served.is_some() && served.as_deref() == now.recording => {
            let running = Drafted::new(StepState::Running, StepVerdict::None, "measure.running", Value::Null);
            running.acting(StepAction::Measure, "act.watch")
        }
        (Some(CheckPart::Programs), Some(plan)) => {
            let ready = Drafted::ready("check.programs").acting(StepAction::Compute, "act.check_programs");
            ready.command(program_command(plan))
        }
        (Some(CheckPart::Measure), Some(plan)) => {
            let ready = Drafted::ready("check.measure").acting(StepAction::Measure, "act.check_measure");
            ready.command(acquire_command(plan, "check.dbbd"))
        }
        (Some(CheckPart::Decide), _) => {
            let is_decided =
                |check: &&FoundDocument| run.is_none_or(|run| run.changed_ms <= check.directory.changed_ms);
            let decided = match files.check.document().filter(is_decided) {
                Some(check) => of_check(check).acting(StepAction::Compute, "act.check_again"),
                None if matches!(files.check, FoundCheck::OfOther) => {
                    Drafted::ready("check.stale").acting(StepAction::Compute, "act.check_again")
                }
                None => Drafted::ready("check.none").acting(StepAction::Compute, "act.check"),
            };
            decided.command(decide_command(run.map_or("check.dbbd", |run| &run.path)))
        }
        (Some(CheckPart::Plan | CheckPart::Programs | CheckPart::Measure), _) => match files.check.document()
        {
            // The check was made on the command line, and its plan is not here.
            Some(check) => of_check(check).command(decide_command("check.dbbd")),
            None => {
                let ready = Drafted::ready("check.plan").acting(StepAction::Compute, "act.check_plan");
                ready.command(plan_command)
            }
        },
    };
    let mut drafted = drafted.made(files.check.document().map(|check| &check.directory));
    if drafted.values.is_null() && tolerance_mm.is_some() {
        drafted.values = json!({ "tolerance_mm": tolerance_mm });
    }
    drafted.plan = served;
    drafted.runs = choices(files, plan);
    drafted
}

fn of_check(check: &FoundDocument) -> Drafted {
    let content = &check.content;
    let is_bare = content["tolerance_mm"].is_null();
    let decision =
        serde_json::from_value(content["decision"].clone()).unwrap_or(ConformityOutcome::Undecided);
    let (state, verdict, text) = match decision {
        ConformityOutcome::Pass => (StepState::Done, StepVerdict::Pass, "check.pass"),
        ConformityOutcome::Unchanged => (StepState::Done, StepVerdict::Pass, "check.unchanged"),
        ConformityOutcome::Fail => (StepState::Attention, StepVerdict::Fail, "check.fail"),
        ConformityOutcome::Changed => (StepState::Attention, StepVerdict::Fail, "check.changed"),
        ConformityOutcome::Undecided if is_bare => {
            (StepState::Attention, StepVerdict::Undecided, "check.undecided_bare")
        }
        ConformityOutcome::Undecided => (StepState::Attention, StepVerdict::Undecided, "check.undecided"),
    };
    let values = json!({
        "error_mm": content["position_error_mm"], "upper_mm": content["upper_mm"],
        "tolerance_mm": content["tolerance_mm"], "risk": content["specific_risk"],
        "lengths": content["lengths"], "until": content["validity"]["until"],
    });
    Drafted::new(state, verdict, text, values)
}

/// Whether any readings of the result or of its check are simulated.
pub(super) fn is_simulated(files: &WorkFiles) -> bool {
    let provenance =
        |made: &FoundDocument| serde_json::from_value::<Provenance>(made.content["provenance"].clone()).ok();
    let documents = files.result.iter().chain(files.check.document());
    documents.filter_map(provenance).any(|made| made.is_simulated())
}

fn certificate(files: &WorkFiles, now: &Activity<'_>) -> Drafted {
    let directory = files.certificate.as_ref().map_or("certificate", |made| &made.name);
    let check = files.check.document().map(|check| format!(" --check {}", check.directory.name));
    let check = check.unwrap_or_default();
    let specimen = if is_simulated(files) { " --specimen" } else { "" };
    let command = format!("dbbd certificate {}{check}{specimen} --out {directory}", result_directory(files));
    let Some(result) = &files.result else { return Drafted::todo("certificate.no_result").command(command) };
    let is_failed = standing_of(files, now.today) == Some(Standing::Failed);
    // What a certificate states is older than the check.
    let checked_ms = files.check.document().map_or(0, |check| check.directory.changed_ms);
    let label = if is_simulated(files) { "act.specimen" } else { "act.certificate" };
    let drafted = match &files.certificate {
        made if is_failed && made.as_ref().is_none_or(|made| made.changed_ms < checked_ms) => {
            let failed =
                Drafted::new(StepState::Attention, StepVerdict::Fail, "certificate.failed", Value::Null);
            failed.acting(StepAction::Compute, "act.certificate_anyway")
        }
        None if is_simulated(files) => {
            Drafted::ready("certificate.simulated").acting(StepAction::Compute, label)
        }
        None => Drafted::ready("certificate.none").acting(StepAction::Compute, "act.certificate"),
        Some(made) if made.changed_ms < result.directory.changed_ms.max(checked_ms) => {
            Drafted::ready("certificate.stale").acting(StepAction::Compute, label)
        }
        Some(made) => {
            let values = json!({ "files": made.files.len() });
            let done = Drafted::done(StepVerdict::None, "certificate.found", values);
            done.acting(StepAction::Compute, "act.certificate_again")
        }
    };
    drafted.command(command).made(files.certificate.as_ref())
}

#[cfg(test)]
mod tests {
    use dbbd_job::plan::Job;

    use super::super::files::END_MARK;
    use super::*;

    const TODAY: &str = "2026-05-01T12:00:00Z";

    fn directory(name: &str, changed_ms: u64) -> FoundDirectory {
        let (files, times_ms) = (vec!["a".into()], vec![changed_ms]);
        FoundDirectory { name: name.into(), files, times_ms, changed_ms, ..FoundDirectory::default() }
    }

    fn job() -> WorkFiles {
        let text = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\n[[centre]]\nid = 1\n\
                    xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 8\n";
        WorkFiles {
            job: Some(WorkJob {
                file: "job.toml".into(),
                job: Job::from_toml("job.toml", text),
                sha256: Some("aa".into()),
                robot: Some(Ok("KUKA KR 60 HA".into())),
            }),
            ..WorkFiles::default()
        }
    }

    fn planned(is_check: bool) -> FoundPlan {
        FoundPlan {
            directory: directory(if is_check { "check-plan" } else { "plan" }, 10),
            hash: if is_check { "c" } else { "p" }.into(),
            is_check,
            job_sha256: Some("aa".into()),
            program: Some(directory("krl", 11)),
            ..FoundPlan::default()
        }
    }

    fn run(hash: &str, changed_ms: u64) -> FoundRun {
        FoundRun {
            name: format!("run-{hash}"),
            path: format!("../dbbd-runs/run-{hash}/run.dbbd"),
            plan_hash: hash.into(),
            changed_ms,
            started: None,
            reason: Some(END_MARK.into()),
            samples: Some(1000),
        }
    }

    fn identified(changed_ms: u64) -> Option<FoundDocument> {
        let content = json!({ "findings": [], "budget": { "expanded_mm": 0.5, "coverage_factor": 2.0 } });
        Some(FoundDocument { directory: directory("result", changed_ms), content })
    }

    fn seen(files: &WorkFiles, jobs: &[EvaluationJob], recording: Option<&str>) -> Vec<StepReport> {
        let explain = |finding| ExplainedFinding { finding, cause: "", cure: "" };
        steps(files, &Activity { jobs, recording, today: TODAY, explain: &explain })
    }

    fn states(files: &WorkFiles) -> Vec<StepState> {
        seen(files, &[], None).iter().map(|step| step.state).collect()
    }

    #[test]
    fn each_file_makes_the_next_step_ready() {
        use StepState::{Done as D, Ready as R, Todo as T};
        let mut files = WorkFiles::default();
        assert_eq!(states(&files), [R, T, T, T, T, T, T, T, T]);
        files = job();
        assert_eq!(states(&files), [D, D, R, T, T, T, T, T, T]);
        files.plans = vec![FoundPlan { program: None, ..planned(false) }];
        assert_eq!(states(&files), [D, D, D, R, T, T, T, T, T]);
        files.plans = vec![planned(false)];
        assert_eq!(states(&files), [D, D, D, D, R, T, T, T, T]);
        files.runs = vec![run("p", 20)];
        assert_eq!(states(&files), [D, D, D, D, D, R, T, T, T]);
        files.result = identified(30);
        assert_eq!(states(&files), [D, D, D, D, D, D, R, R, R]);
        // A newer run needs a new result.
        files.runs = vec![run("p", 40)];
        assert_eq!(states(&files)[5], R);
    }

    #[test]
    fn a_changed_job_asks_for_a_new_plan() {
        let mut files = WorkFiles { plans: vec![planned(false)], ..job() };
        files.job.as_mut().unwrap().sha256 = Some("bb".into());
        let plan = &seen(&files, &[], None)[2];
        assert_eq!((plan.state, plan.text), (StepState::Ready, "plan.stale"));
    }

    #[test]
    fn a_calibration_that_ends_is_renewed() {
        let mut files = WorkFiles { plans: vec![planned(false)], ..job() };
        let of = |until: &str| {
            let content = json!({ "findings": [], "validity": { "until": until } });
            Some(FoundDocument { directory: directory("result", 30), content })
        };
        let texts = |files: &WorkFiles| {
            let steps = seen(files, &[], None);
            (steps[2].text, steps[5].text, steps[2].command.clone())
        };
        let job_plan = "dbbd plan job.toml --out plan";
        let renewing = "dbbd plan job.toml --renew --robot result/robot-identified.toml --out renewal-plan";
        for (until, plan, result, command) in [
            ("2026-06-02", "plan.found_bare", "result.valid", job_plan),
            ("2026-05-20", "plan.ends", "result.valid", renewing),
            ("2026-04-30", "plan.over", "result.over", renewing),
        ] {
            files.result = of(until);
            assert_eq!(texts(&files), (plan, result, command.into()), "{until}");
        }
        // Once the renewal is planned, its programs are next; the programs of the job are kept.
        let renewal = FoundPlan {
            directory: directory(RENEWAL, 40),
            hash: "r".into(),
            program: None,
            ..planned(false)
        };
        files.plans.insert(0, renewal);
        let steps = seen(&files, &[], None);
        assert_eq!((steps[2].text, steps[3].text), ("plan.found_bare", "programs.none"));
        assert_eq!(steps[3].command, "dbbd program renewal-plan/plan.csv --out renewal-program");
        files.runs = vec![run("r", 50)];
        assert_eq!(seen(&files, &[], None)[5].text, "result.stale");
        // A changed job is planned as a whole, without a renewal.
        files.job.as_mut().unwrap().sha256 = Some("bb".into());
        assert_eq!(texts(&files).2, job_plan);
        files.runs.clear();
        assert_eq!(texts(&files).1, "result.over");
    }

    #[test]
    fn a_run_of_a_check_leads_to_the_check() {
        let mut files = WorkFiles { plans: vec![planned(true), planned(false)], ..job() };
        (files.runs, files.result) = (vec![run("c", 50)], identified(30));
        let steps = seen(&files, &[], None);
        // The run of a check is no run of the calibration: the robot is neither measured nor identified.
        assert_eq!((steps[4].text, steps[5].text), ("measure.ready", "result.found"));
        assert_eq!((steps[7].text, steps[7].label), ("check.none", "act.check"));
        assert!(steps[7].command.starts_with("dbbd check ../dbbd-runs/run-c/run.dbbd --robot result/"));
    }

    #[test]
    fn a_run_without_samples_is_no_success() {
        let mut files = WorkFiles { plans: vec![planned(false)], ..job() };
        for (samples, reason, text) in [
            (Some(0), Some(END_MARK), "measure.empty"),
            (Some(9), Some("stopped"), "measure.early"),
            (None, None, "measure.cut_off"),
        ] {
            files.runs = vec![FoundRun { samples, reason: reason.map(str::to_owned), ..run("p", 20) }];
            let measure = &seen(&files, &[], None)[4];
            assert_eq!((measure.state, measure.text), (StepState::Attention, text));
        }
    }

    #[test]
    fn a_refused_plan_shows_why_until_another_is_made() {
        let refusal = FindingRecord::from(&Diagnostic::new(crate::live::ServiceFinding::NoRunIsOn));
        let job_of_plan = EvaluationJob {
            id: 1,
            kind: "plan",
            run: String::new(),
            robot: Some("r".into()),
            step: Some(WorkStep::Plan),
            state: JobState::Failed,
            elapsed_s: 1.0,
            ended_unix_ms: Some(20),
            percent: 100,
            log: Vec::new(),
            findings: vec![ExplainedFinding { finding: refusal, cause: "cause", cure: "cure" }],
        };
        let files = WorkFiles { plans: vec![planned(false)], ..job() };
        let jobs = [job_of_plan];
        let plan = &seen(&files, &jobs, None)[2];
        assert_eq!(
            (plan.state, plan.verdict, plan.text),
            (StepState::Attention, StepVerdict::Fail, "refused")
        );
        assert_eq!((plan.findings[0].cure, &*plan.findings[0].finding.code), ("cure", "E1504"));
        let newer = FoundPlan { directory: directory("plan", 21), ..planned(false) };
        let files = WorkFiles { plans: vec![newer], ..job() };
        assert_eq!(seen(&files, &jobs, None)[2].state, StepState::Done);
    }

    #[test]
    fn every_uploaded_program_is_corrected_once() {
        let of = |files: [(&str, u64); 2]| {
            let (files, times_ms): (Vec<String>, Vec<u64>) =
                files.map(|(name, ms)| (name.to_owned(), ms)).into_iter().unzip();
            Some(FoundDirectory { files, times_ms, ..FoundDirectory::default() })
        };
        let mut files = WorkFiles { result: identified(30), ..job() };
        assert_eq!(seen(&files, &[], None)[6].text, "correct.none");
        files.programs.uploaded = of([("a.src", 40), ("b.SRC", 40)]);
        assert_eq!(uncorrected(&files), ["a.src", "b.SRC"]);
        // A correction is too old if it was made before the program was uploaded again, or before the robot was
        // identified again.
        files.programs.corrected = of([("a.src", 50), ("b.SRC", 39)]);
        assert_eq!(uncorrected(&files), ["b.SRC"]);
        let step = &seen(&files, &[], None)[6];
        assert_eq!((step.state, step.values["left"].as_u64()), (StepState::Ready, Some(1)));
        assert!(step.command.starts_with("dbbd compensate uploaded/b.SRC "));
        files.programs.corrected = of([("a.src", 50), ("b.SRC", 51)]);
        assert_eq!(seen(&files, &[], None)[6].state, StepState::Done);
        files.result = identified(60);
        assert_eq!(uncorrected(&files), ["a.src", "b.SRC"]);
    }

    /// A check that does not confirm the calibration is shown at every step that would use it.
    #[test]
    fn a_decision_travels_to_every_step() {
        let mut files = WorkFiles { plans: vec![planned(true), planned(false)], ..job() };
        (files.runs, files.result) = (vec![run("c", 50)], identified(30));
        let uploaded =
            FoundDirectory { files: vec!["a.src".into()], times_ms: vec![40], ..FoundDirectory::default() };
        files.programs.uploaded = Some(uploaded.clone());
        let texts = |files: &WorkFiles| [5, 6, 7, 8].map(|at| seen(files, &[], None)[at].text);
        let states = |files: &WorkFiles| [5, 6, 7, 8].map(|at| seen(files, &[], None)[at].state);
        let usable = ["result.found", "correct.uploaded", "check.none", "certificate.none"];
        assert_eq!(texts(&files), usable);
        let checked = |files: &mut WorkFiles, decision: &str, tolerance_mm: Option<f64>| {
            files.check = found_check(json!({ "decision": decision, "tolerance_mm": tolerance_mm }));
            (texts(files), states(files))
        };
        use StepState::{Attention as A, Done as D, Ready as R};
        for (decision, tolerance_mm, text) in
            [("pass", Some(1.0), "check.pass"), ("unchanged", None, "check.unchanged")]
        {
            let [.., certificate] = usable;
            let expected = ["result.found", "correct.uploaded", text, certificate];
            assert_eq!(checked(&mut files, decision, tolerance_mm), (expected, [D, R, D, R]));
        }
        for (decision, tolerance_mm, text) in
            [("fail", Some(1.0), "check.fail"), ("changed", None, "check.changed")]
        {
            let expected = ["result.failed", "correct.failed", text, "certificate.failed"];
            assert_eq!(checked(&mut files, decision, tolerance_mm), (expected, [A, A, A, A]));
        }
        // Also where no program was uploaded yet, and where each was corrected before the check.
        files.programs.corrected = Some(FoundDirectory { times_ms: vec![55], ..uploaded.clone() });
        assert_eq!(seen(&files, &[], None)[6].text, "correct.failed");
        (files.programs.uploaded, files.programs.corrected) = (None, None);
        let correct = &seen(&files, &[], None)[6];
        assert_eq!((correct.text, correct.label), ("correct.failed", "act.upload"));
        files.programs.uploaded = Some(uploaded);
        let expected = ["result.undecided", "correct.uploaded", "check.undecided", "certificate.none"];
        assert_eq!(checked(&mut files, "undecided", Some(1.0)), (expected, [D, R, A, R]));
        // A certificate that was made before the check does not state it.
        files.certificate = Some(directory("certificate", 55));
        assert_eq!(seen(&files, &[], None)[8].text, "certificate.stale");
        // A check of another calibration does not count.
        (files.check, files.certificate) = (FoundCheck::OfOther, None);
        assert_eq!(texts(&files), ["result.found", "correct.uploaded", "check.stale", "certificate.none"]);
    }

    fn found_check(content: Value) -> FoundCheck {
        FoundCheck::Of(FoundDocument { directory: directory("check", 60), content })
    }

    /// A check with simulated readings of a robot with measured ones makes the certificate a specimen.
    #[test]
    fn a_simulated_check_makes_a_specimen() {
        let mut files = WorkFiles { result: identified(30), ..job() };
        let certificate = |files: &WorkFiles| {
            let step = seen(files, &[], None).swap_remove(8);
            (step.text, step.command.contains("--specimen"))
        };
        assert_eq!(certificate(&files), ("certificate.none", false));
        for (origin, expected) in
            [("simulated", ("certificate.simulated", true)), ("measured", ("certificate.none", false))]
        {
            let capture = json!({ "role": "capture", "name": "c.dbbd", "sha256": "aa", "origin": origin });
            let provenance = json!({ "from": [capture] });
            files.check = found_check(json!({ "decision": "unchanged", "provenance": provenance }));
            assert_eq!(certificate(&files), expected, "{origin}");
        }
    }

    /// The tolerance of a check is that of its plan until it is decided, and then that of the decision.
    #[test]
    fn commands_of_a_check_have_its_tolerance() {
        let of_plan = FoundPlan { tolerance_mm: Some(0.8), ..planned(true) };
        let mut files = WorkFiles { plans: vec![of_plan, planned(false)], ..job() };
        files.result = identified(30);
        let check = |files: &WorkFiles| seen(files, &[], None).swap_remove(7);
        assert_eq!(check(&files).values["tolerance_mm"].as_f64(), Some(0.8));
        files.runs = vec![run("c", 50)];
        assert!(check(&files).command.contains(" --tolerance 0.8 --out check"), "{}", check(&files).command);
        files.check = found_check(json!({ "decision": "pass", "tolerance_mm": 1.5 }));
        assert!(check(&files).command.contains(" --tolerance 1.5 "));
        files.check = found_check(json!({ "decision": "unchanged" }));
        files.plans[0].tolerance_mm = None;
        assert!(!check(&files).command.contains("--tolerance"));
    }

    #[test]
    fn a_run_that_was_cut_off_never_replaces_a_complete_one() {
        let mut files = WorkFiles { plans: vec![planned(false)], ..job() };
        let short = FoundRun { reason: None, samples: None, name: "short".into(), ..run("p", 40) };
        files.runs = vec![short.clone(), run("p", 20)];
        let names = |files: &WorkFiles| {
            seen(files, &[], None)[5].runs.iter().map(|run| run.name.clone()).collect::<Vec<_>>()
        };
        assert_eq!(names(&files), ["run-p", "short"]);
        assert!(seen(&files, &[], None)[5].command.contains("run-p"));
        files.result = identified(30);
        assert_eq!(seen(&files, &[], None)[5].text, "result.found");
        files.runs = vec![short];
        assert_eq!(names(&files), ["short"]);
    }

    #[test]
    fn the_findings_of_a_step_outlive_the_process() {
        let warning = FindingRecord::from(&Diagnostic::new(crate::live::ServiceFinding::NoRunIsOn));
        let mut files = WorkFiles { plans: vec![planned(false)], ..job() };
        files.plans[0].directory.findings = vec![warning];
        assert_eq!(seen(&files, &[], None)[2].findings.len(), 1);
        // Of a plan that is to be made again they say nothing any more.
        files.job.as_mut().unwrap().sha256 = Some("bb".into());
        let plan = &seen(&files, &[], None)[2];
        assert_eq!((plan.text, plan.findings.len()), ("plan.stale", 0));
    }

    #[test]
    fn a_run_in_progress_is_running_at_its_own_step() {
        let mut files =
            WorkFiles { plans: vec![planned(true), planned(false)], prefix: "r/".into(), ..job() };
        files.result = identified(30);
        let at = |recording| {
            let steps = seen(&files, &[], recording);
            (steps[4].state, steps[7].state)
        };
        assert_eq!(at(Some("r/plan")), (StepState::Running, StepState::Ready));
        assert_eq!(at(Some("r/check-plan")), (StepState::Ready, StepState::Running));
        assert_eq!(at(Some("other/plan")), (StepState::Ready, StepState::Ready));
    }
}
