//! Plans the poses of a calibration from a job, and checks them.

mod again;
mod check;

use std::path::{Path, PathBuf};

pub use again::RepeatedRows;
use check::PlannedCheck;
use dbbd_device::clock;
use dbbd_model::base::serialised;
use dbbd_model::conformity::change::CheckPower;
use dbbd_model::design::Criterion;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{check_measurements, measurement_findings};
use dbbd_model::measurement::BaseBall;
use dbbd_model::measurement::Measurements;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, TracedArtefact, one_robot};
use dbbd_model::robot::{LoadedRobot, Robot};
use serde::{Deserialize, Serialize, Serializer};

use super::check::CheckRequest;
use super::compensate::points_of_program;
use super::identify::LENGTHS;
use super::identify::tables::{lengths, measurements};
use super::robots::robot_for_measurement;
use super::{AnswerOutcome, RequestResult, RequestSession, RequestWatch, read_protocol};
use crate::artefact::read_as;
use crate::file_set::{EarlierFiles, FileSet};
use crate::files;
use crate::plan::PlanFinding;
use crate::plan::goal::outcome::GoalOutcome;
use crate::plan::goal::plan_for_goal;
use crate::plan::job::JobFinding;
use crate::plan::{
    Job, JobTable, KnownCell, Plan, PlanCheck, PlanPrediction, PlanningPrior, PoseKind, Refusal, Stage,
    TaughtBall,
};
use crate::program::ProgramFinding;
use crate::recording::dwell;
use crate::report;
use crate::robot_files::RobotName;

/// The request of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRequest {
    /// The file of the job.
    pub job: PathBuf,
    /// The directory of the plan.
    pub out: PathBuf,
    /// A built-in name or a file, in place of the robot of the job.
    pub robot: Option<RobotName>,
    /// Tables of lengths measured before to the same base balls.
    #[serde(default)]
    pub measured: Vec<PathBuf>,
    #[serde(default)]
    pub poses: PlannedPoses,
    /// Replace the files of an earlier result; otherwise they are kept beside it.
    #[serde(default)]
    pub replace: bool,
}

/// Which poses are planned.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlannedPoses {
    /// The poses of the job.
    #[default]
    Job,
    /// This number of safe poses about the base balls, to be measured first.
    Stage { poses: u32 },
    /// The poses of a check of a calibrated robot.
    Check(CheckPoses),
    /// The poses that renew the calibration of a robot best.
    Renew { poses: u32 },
    /// The poses of the plans of these captures that have no length in any of the captures.
    Remaining { runs: Vec<PathBuf> },
    /// The poses of a capture, a table or a result that are measured again.
    Repeat { run: PathBuf, rows: RepeatedRows },
}

/// The check whose poses are planned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckPoses {
    /// The number of poses.
    pub poses: u32,
    /// The base balls are still mounted as in the calibration.
    pub balls_kept: bool,
    /// Tolerance of the position error.
    pub tolerance_mm: Option<f64>,
    /// Largest probability of a wrong decision.
    pub risk: f64,
}

impl CheckPoses {
    /// Number of poses of a check if no number is requested.
    pub const COUNT: u32 = 18;
}

impl PlannedPoses {
    /// Number of poses that renew a calibration if no number is requested.
    pub const RENEWAL: u32 = 20;
}

/// A plan with its page. It is in no file yet.
#[derive(Clone, Debug)]
pub struct UnwrittenPlan {
    pub plan: Plan,
    /// `plan.html`; `None` for a plan that was read.
    page: Option<String>,
}

/// A plan that was read.
impl From<Plan> for UnwrittenPlan {
    fn from(plan: Plan) -> Self {
        Self { plan, page: None }
    }
}

impl UnwrittenPlan {
    /// Writes the files of the plan into a directory, and returns their names.
    pub fn write(&self, directory: &Path, earlier: EarlierFiles) -> Result<Vec<String>, Diagnostic> {
        let (csv, json) = self.plan.to_files()?;
        let mut set = FileSet::begin(directory, earlier)?;
        set.write("plan.csv", csv)?;
        set.write("plan.json", json)?;
        if let Some(page) = &self.page {
            set.write("plan.html", page)?;
        }
        let job = &self.plan.header.job;
        set.write("centres.csv", BaseBall::to_csv(&job.balls()))?;
        // The job with the balls and the bar that were chosen: for a later stage, a check and another plan.
        if self.plan.header.goal.is_some() {
            set.write("job.toml", serialised::toml(job)?)?;
        }
        set.finish()
    }
}

/// A plan and the name of its robot. It is serialised as its summary.
#[derive(Clone, Debug)]
pub struct PlanDocument {
    pub robot: String,
    pub plan: Plan,
}

impl PlanDocument {
    /// Number of poses of the plan that are of this kind.
    pub fn count(&self, kind: PoseKind) -> usize {
        self.plan.rows.iter().filter(|row| row.kind == kind).count()
    }
}

impl Serialize for PlanDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct PlanSummary<'a> {
            robot: &'a str,
            hash: &'a str,
            rows: usize,
            measure: usize,
            reference: usize,
            duration_s: f64,
            checks: &'a [PlanCheck],
            stage: Option<Stage>,
            taught: &'a [TaughtBall],
            #[serde(skip_serializing_if = "Option::is_none")]
            goal: Option<&'a GoalOutcome>,
            predictions: Option<&'a PlanPrediction>,
            #[serde(skip_serializing_if = "Option::is_none")]
            check: Option<&'a CheckPower>,
        }
        let Self { robot, plan } = self;
        let summary = PlanSummary {
            robot,
            hash: &plan.header.hash,
            rows: plan.rows.len(),
            measure: self.count(PoseKind::Measure),
            reference: self.count(PoseKind::Reference),
            duration_s: plan.duration_s(),
            checks: &plan.header.checks,
            stage: plan.header.stage,
            taught: &plan.header.taught,
            goal: plan.header.goal.as_ref(),
            predictions: plan.header.predictions.as_ref(),
            check: plan.header.check.as_ref(),
        };
        summary.serialize(serializer)
    }
}

impl PlanRequest {
    pub(super) fn result(
        &self,
        session: &RequestSession<'_>,
    ) -> Result<RequestResult<PlanDocument>, Diagnostic> {
        let (robot, unwritten) = self.plan(None, session)?;
        let files = unwritten.write(&self.out, EarlierFiles::kept_unless(self.replace))?;
        let plan = unwritten.plan;
        session.findings(plan.header.notes.iter().cloned());
        let predictions = plan.header.predictions.iter();
        session.findings(predictions.flat_map(|prediction| prediction.recommendations.iter().cloned()));
        let document = PlanDocument { robot: robot.name, plan };
        Ok(RequestResult { outcome: AnswerOutcome::Done, files, document })
    }

    /// Plans without writing, for `robot` in place of the named robot. Also returns the findings of the inputs.
    pub fn unwritten(
        &self,
        robot: Option<LoadedRobot>,
        watch: &dyn RequestWatch,
    ) -> Result<(UnwrittenPlan, Vec<Diagnostic>), Diagnostic> {
        let session = RequestSession::new(watch);
        let (_, unwritten) = self.plan(robot, &session)?;
        Ok((unwritten, session.into_findings()))
    }

    /// Plans for the given robot, else for the named robot. Also returns the robot after the earlier measurements.
    fn plan(
        &self,
        given: Option<LoadedRobot>,
        session: &RequestSession<'_>,
    ) -> Result<(Robot, UnwrittenPlan), Diagnostic> {
        let name = self.job.display().to_string();
        let (job, made_from, text) = self.read_job(session)?;
        let in_job = |header, key, why| JobTable::new(header).wrong(key, why).in_text(&name, &text);
        // A robot that is given without a name is in no file, so no lengths are beside it.
        let named = given.is_none().then(|| RobotName::from(job.robot.as_str()));
        let named = self.robot.clone().or(named);
        let file = named.as_deref();
        let robot_name = file.unwrap_or(given.as_ref().map_or("", |given| &given.robot.name)).to_owned();
        let read = match (given, &named) {
            (Some(given), _) => Ok(given),
            (None, Some(named)) => robot_for_measurement(named, session),
            (None, None) => Err(Robot::unknown("")),
        };
        let is_of_job = self.robot.is_none();
        let read = read.map_err(|why| if is_of_job { in_job("", "robot", why) } else { why })?;
        let with_serial = with_serial(&job, read).map_err(|why| in_job("", "serial", why));
        let loaded = with_serial?;
        let mut job = job;
        if let Some(goal) = &mut job.goal
            && let Some(program) = &goal.program
        {
            let file = files::directory_of(&self.job).join(program);
            goal.of_program = points_of_program(&file, &loaded, session)?;
        }
        let LoadedRobot { mut robot, source, .. } = loaded;
        job.tool.state_in(&mut robot);
        robot.check_tool().map_err(|why| in_job("[tool]", "ball_mm", why.into()))?;
        let carried = job.payload.as_ref().map(|payload| robot.geometry.load.carry(payload));
        carried.transpose().map_err(|why| in_job("", "payload", why))?;
        job.check_against(&robot).map_err(|wrong| wrong.in_text(&name, &text))?;
        session.findings_in(&name, job.without_effect(&robot));
        session.findings_in(&name, job.in_robot(&robot));
        if job.centres.is_empty() && self.poses != PlannedPoses::Job {
            return Err(in_job("[goal]", "", JobFinding::BallsAreOpen.into()));
        }
        let check = match &self.poses {
            PlannedPoses::Check(poses) => {
                // Without a file of the robot there is no posterior: the check refuses that.
                let file = self.robot.as_deref().unwrap_or_default();
                Some(PlannedCheck::new(*poses, Criterion::Change, file, &job, &robot, session)?)
            }
            PlannedPoses::Renew { poses } => {
                let file = self.robot.as_deref().unwrap_or_default();
                let risk = CheckRequest::RISK;
                let poses = CheckPoses { poses: *poses, balls_kept: false, tolerance_mm: None, risk };
                Some(PlannedCheck::new(poses, Criterion::I, file, &job, &robot, session)?)
            }
            PlannedPoses::Job
            | PlannedPoses::Stage { .. }
            | PlannedPoses::Remaining { .. }
            | PlannedPoses::Repeat { .. } => None,
        };
        let given = match &self.poses {
            PlannedPoses::Job
            | PlannedPoses::Stage { .. }
            | PlannedPoses::Check(_)
            | PlannedPoses::Renew { .. } => None,
            PlannedPoses::Remaining { runs } => {
                Some(again::remaining(runs.iter().map(AsRef::as_ref), session)?)
            }
            PlannedPoses::Repeat { run, rows } => Some(again::repeated(run, rows, session)?),
        };
        let measured = match check {
            Some(_) => EarlierMeasurements::default(),
            None => EarlierMeasurements::find(self, file, &source, session)?,
        };
        let earlier = measured.tables.iter().map(|table| (table.name.clone(), &table.source));
        one_robot(earlier.clone().chain([(robot_name, &source)]))?;
        // With lengths measured before, their own findings report this.
        session.findings(robot.asked_repeatability().filter(|_| measured.tables.is_empty()));
        let sources = earlier.map(|(_, source)| source);
        let provenance = crate::artefact::made_from([&made_from, &source].into_iter().chain(sources));
        let job = given.as_ref().map_or_else(|| job.clone(), |given| job.as_given(given.len()));
        let known = match &check {
            Some(check) => check.known()?,
            None => {
                let (known, findings) = measured.cell(job, &robot)?;
                session.findings(findings);
                known
            }
        };
        let refused = |refusal: Refusal| {
            session.findings(refusal.printed().cloned());
            Diagnostic::from(refusal).in_file(&name)
        };
        let (mut plan, known) =
            match (&given, known.job.goal.as_ref().filter(|_| self.poses == PlannedPoses::Job)) {
                (Some(poses), _) => (
                    Plan::build_again(&known.job, &known.robot, &known.prior, poses).map_err(refused)?,
                    known,
                ),
                (None, Some(goal)) => {
                    let cell = |job| measured.cell(job, &robot).map(|(known, _)| known);
                    plan_for_goal(goal, &known, &cell).map_err(refused)?
                }
                (None, None) => {
                    (Plan::build_with(&known.job, &known.robot, &known.prior).map_err(refused)?, known)
                }
            };
        plan.header.provenance = provenance;
        plan.header.again = matches!(self.poses, PlannedPoses::Repeat { .. });
        let map = match &check {
            Some(check) => check.predict(&mut plan, &known.prior, session)?,
            None => plan.predict(&known.robot, &known.prior),
        };
        let page = Some(report::plan::html(&plan, &known.robot, &map)?);
        Ok((known.robot, UnwrittenPlan { plan, page }))
    }

    /// The job, or its stage, and the job's file with its text.
    fn read_job(&self, session: &RequestSession<'_>) -> Result<(Job, TracedArtefact, String), Diagnostic> {
        let name = self.job.display().to_string();
        let text = files::read_definition(&self.job)?;
        let job = read_as(&self.job, ArtefactRole::Job, Job::from_toml(&name, &text))?;
        job.identity().check_dates(clock::unix_ns()).map_err(|(_, why)| why.in_file(&name))?;
        let made_from = job.traced(&self.job)?;
        let job = match self.poses {
            PlannedPoses::Stage { poses } => job.as_stage(poses),
            PlannedPoses::Job
            | PlannedPoses::Check(_)
            | PlannedPoses::Renew { .. }
            | PlannedPoses::Remaining { .. }
            | PlannedPoses::Repeat { .. } => job,
        };
        // The file of a definition may exist only on the computer that records.
        if !job.bar.protocol.ends_with(".toml") {
            let bar = read_protocol(&job.bar.protocol, &[]);
            let bar =
                bar.map_err(|why| JobTable::new("[bar]").wrong("protocol", why).in_text(&name, &text))?;
            session.findings_in(&name, dwell::too_short(job.motion.dwell_s, &bar));
        }
        Ok((job, made_from, text))
    }
}

/// A finding for the job and for the robot file beside a plan, or in the directory above, if it is not the one from which the
/// plan was made.
pub fn changed_sources(plan: &Plan, csv: &Path) -> impl Iterator<Item = ProgramFinding> {
    let directory = files::directory_of(csv);
    let changed = move |role: ArtefactRole| {
        let source = plan.header.provenance.from.iter().rev().find(|source| source.role == role)?;
        // A robot has a name of its own; the job names its file.
        let name = if role == ArtefactRole::Robot { &plan.header.job.robot } else { &source.name };
        let file = [directory.join(name), directory.join("..").join(name)]
            .into_iter()
            .find(|file| file.is_file())?;
        let changed = files::sha256(&file).ok()? != source.sha256;
        changed.then(|| ProgramFinding::SourceChanged { source: file.display().to_string() })
    };
    [ArtefactRole::Job, ArtefactRole::Robot].into_iter().filter_map(changed)
}

/// The robot with the serial number of the job. Refuses a robot that has another serial number.
fn with_serial(job: &Job, read: LoadedRobot) -> Result<LoadedRobot, Diagnostic> {
    let LoadedRobot { mut robot, mut source, findings } = read;
    if let (Some(of_job), Some(of_robot)) = (&job.serial, &robot.serial)
        && of_job != of_robot
    {
        let (job, robot) = (of_job.clone(), of_robot.clone());
        return Err(ProvenanceFinding::OtherJobSerial { job, robot }.into());
    }
    if let Some(serial) = &job.serial {
        robot.serial = Some(serial.clone());
        robot.nominal.iter_mut().for_each(|nominal| nominal.serial = Some(serial.clone()));
        source.artefact.serial = Some(serial.clone());
    }
    Ok(LoadedRobot { robot, source, findings })
}

/// A table of lengths measured before.
struct EarlierTable {
    /// The file.
    name: String,
    source: TracedArtefact,
    measurements: Measurements,
}

/// The lengths measured before, each once.
#[derive(Default)]
struct EarlierMeasurements {
    tables: Vec<EarlierTable>,
    findings: Vec<Diagnostic>,
}

impl EarlierMeasurements {
    /// The tables of the request, and the lengths.csv beside an identified robot. Refuses a table of another result.
    fn find(
        request: &PlanRequest,
        robot_file: Option<&str>,
        robot: &TracedArtefact,
        session: &RequestSession<'_>,
    ) -> Result<Self, Diagnostic> {
        let mut measured = Self::default();
        request.measured.iter().try_for_each(|path| measured.add(path, session))?;
        let identified = robot_file.filter(|_| robot.artefact.role == ArtefactRole::IdentifiedRobot);
        let Some(robot_file) = identified else { return Ok(measured) };
        let path = Path::new(robot_file).with_file_name(LENGTHS);
        if !path.is_file() {
            session.finding(PlanFinding::NoLengths { file: path.display().to_string() });
            return Ok(measured);
        }
        let lengths = crate::artefact::of_file(ArtefactRole::Measurements, &path)?;
        let of_result =
            |source: &&Artefact| source.role == ArtefactRole::Measurements && source.name == lengths.name;
        if let Some(expected) = robot.provenance.from.iter().rev().find(of_result)
            && expected.sha256 != lengths.sha256
        {
            let (lengths, expected) = (lengths.to_string(), expected.to_string());
            return Err(ProvenanceFinding::OtherLengths { lengths, expected }.into());
        }
        measured.add(&path, session)?;
        Ok(measured)
    }

    fn add(&mut self, path: &Path, session: &RequestSession<'_>) -> Result<(), Diagnostic> {
        let (source, changed) = crate::artefact::of_table(ArtefactRole::Measurements, path)?;
        session.findings(changed);
        let measurements = measurements(path, lengths, &mut self.findings, session)?;
        let table = EarlierTable { name: path.display().to_string(), source, measurements };
        match self.tables.iter_mut().find(|known| known.measurements.repeats(&table.measurements)) {
            // Of a table and a part of it the whole table counts.
            Some(known) => {
                session.finding(ProvenanceFinding::GivenTwice { lengths: table.source.artefact.to_string() });
                if table.measurements.rows.len() > known.measurements.rows.len() {
                    *known = table;
                }
            }
            None => self.tables.push(table),
        }
        Ok(())
    }

    /// What is known of a job and a robot after the measurements, with findings about these.
    fn cell(&self, job: Job, robot: &Robot) -> Result<(KnownCell, Vec<Diagnostic>), Diagnostic> {
        if self.tables.is_empty() {
            let job = job.mounted(robot, false);
            let prior = PlanningPrior::datasheet(&job, robot);
            return Ok((KnownCell { job, robot: robot.clone(), prior }, Vec::new()));
        }
        let mut findings = self.findings.clone();
        for EarlierTable { name, measurements, .. } in &self.tables {
            check_measurements(name, measurements, robot, &job.balls())?;
            findings.extend(measurement_findings(name, measurements, robot, &job.balls()));
        }
        let mut lengths = Measurements::default();
        for EarlierTable { name, measurements, .. } in &self.tables {
            lengths = lengths.and(measurements).map_err(|finding| Diagnostic::file(name, finding))?;
        }
        // If the job does not state where a ball was taught for an earlier stage, the lengths of that stage tell its
        // place.
        let mut job = job;
        for row in &lengths.rows {
            let taught_deg = row.context.as_ref().and_then(|context| context.taught_deg.as_deref());
            let ball = row.datum.ball().and_then(|ball| job.centres.get_mut(ball.index()));
            if let Some((table, axes_deg)) = ball.zip(taught_deg) {
                table.taught_deg.get_or_insert(*axes_deg);
            }
        }
        job.check_against(robot).map_err(|wrong| *wrong.finding)?;
        let job = job.mounted(robot.controller(), false);
        let prior = PlanningPrior::after_lengths(&job, robot, &lengths).map_err(Diagnostic::from)?;
        findings.extend(prior.lengths_findings(&job, robot, &lengths).into_iter().map(Diagnostic::from));
        let (job, robot) = prior.applied(&job, robot);
        Ok((KnownCell { job, robot, prior }, findings))
    }
}
