//! Checks whether a calibrated robot has changed.

use std::path::{Path, PathBuf};

use dbbd_model::base::serialised::{self, Seal};
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::conformity::expected::{BallMounting, Mounting};
use dbbd_model::conformity::{self, CheckInput, ConformityOutcome, DecisionRule, InterimCheck};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::estimation::{DistanceQuantities, Options, Priors};
use dbbd_model::measurement::{LengthModel, Measurements, PreparedMeasurement, are_lengths_known};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{Coordinate, LoadedRobot, ParamId, Robot};
use serde::{Deserialize, Serialize};

use super::identify::LENGTHS;
use super::identify::SetUpRelation;
use super::identify::inputs::{LoadedInputs, NamedInputs, known_lengths};
use super::workspace::read_workspace;
use super::{AnswerOutcome, RequestResult, RequestSession, earlier};
use crate::file_set::{EarlierFiles, FileSet};
use crate::files;
use crate::report;
use crate::robot_files::{ROBOT, ResultBeside, RobotName, result_beside};

/// Which robot shall be checked, with which lengths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckRequest {
    /// A table of lengths, or a capture.
    pub input: PathBuf,
    /// The calibrated robot, with its posterior.
    pub robot: RobotName,
    /// The directory of the result.
    pub out: PathBuf,
    /// A table of the base balls; `None` for the base balls of the capture's plan.
    pub centres: Option<PathBuf>,
    /// Tool ball in the flange frame, if it is not the one of the calibration.
    pub tool_mm: Option<[f64; 3]>,
    /// Tolerance of the position error of 95 % of the poses of the workspace.
    pub tolerance_mm: Option<f64>,
    /// How the check decides on the tolerance.
    pub rule: DecisionRule,
    /// Standard deviation of every length; `None` for the value in the data and the robot's repeatability.
    pub sigma_mm: Option<f64>,
    /// Standard deviation of the place of the tool ball when it is mounted again.
    pub tool_repeat_mm: f64,
    /// The base balls are still mounted as in the calibration.
    #[serde(default)]
    pub balls_kept: bool,
    /// Standard deviation of the base balls; `None` for unlimited, or for the standard deviation of a seat if the balls
    /// are kept.
    pub ball_repeat_mm: Option<f64>,
    /// Standard uncertainty (k = 1) of the bar's length; `None` for the value in the certificate, if known.
    pub bar_u_mm: Option<f64>,
    /// A table of poses over which the position error is taken.
    pub workspace: Option<PathBuf>,
    /// Identify what changed, and write the robot and the lengths.
    #[serde(default)]
    pub update: bool,
    /// Replace the files of an earlier result; otherwise they are kept beside it.
    #[serde(default)]
    pub replace: bool,
}

impl CheckRequest {
    /// Largest probability of a wrong decision where none is asked for.
    pub const RISK: f64 = 0.05;

    /// A check with the defaults of everything else.
    pub fn new(input: PathBuf, robot: RobotName, out: PathBuf, tolerance_mm: Option<f64>) -> Self {
        Self {
            input,
            robot,
            out,
            centres: None,
            tool_mm: None,
            tolerance_mm,
            rule: DecisionRule::GuardBand { risk: Self::RISK },
            sigma_mm: None,
            tool_repeat_mm: Mounting::SEAT_REPEAT_MM,
            balls_kept: false,
            ball_repeat_mm: None,
            bar_u_mm: None,
            workspace: None,
            update: false,
            replace: false,
        }
    }
}

/// `check.json`.
#[derive(Clone, Debug, Serialize)]
pub struct CheckDocument {
    #[serde(flatten)]
    pub checked: CheckedLengths,
    pub findings: Vec<Diagnostic>,
    pub provenance: Provenance,
}

/// The result of a check of lengths.
#[derive(Clone, Debug, Serialize)]
pub struct CheckedLengths {
    #[serde(flatten)]
    pub check: InterimCheck,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<DistanceQuantities>,
}

impl CheckedLengths {
    /// Checks the readings of these measurements.
    pub fn of(input: &CheckInput<'_>, observations: &Measurements) -> Result<Self, ConformityFinding> {
        let check = input.check()?;
        let distance = input.set_up().and_then(|model| DistanceQuantities::of(&observations.rows, &model));
        Ok(Self { check, distance })
    }

    /// The findings of the check, and the reasons why it cannot decide.
    pub fn findings(&self) -> Vec<ConformityFinding> {
        let mut findings = self.check.findings.clone();
        let decision = &self.check.decision;
        if let (ConformityOutcome::Undecided, Some(tolerance_mm), Some(risk)) =
            (decision.decision, decision.tolerance_mm, decision.specific_risk)
        {
            let position_error_mm = decision.position_error_mm;
            findings.push(ConformityFinding::Undecided { tolerance_mm, position_error_mm, risk });
        }
        findings
    }

    /// Decides nothing if lengths of the check identified the robot, and says so. `known` counts these.
    pub fn of_known_lengths(&mut self, known: usize) -> Option<ConformityFinding> {
        let lengths = self.check.lengths;
        are_lengths_known(known, lengths).then(|| {
            self.check.decide_nothing();
            ConformityFinding::LengthsOfCalibration { known, lengths }
        })
    }
}

impl CheckRequest {
    pub(super) fn result(
        &self,
        session: &RequestSession<'_>,
    ) -> Result<RequestResult<CheckDocument>, Diagnostic> {
        let given = self.read_inputs(session)?;
        let start = LengthModel::new(given.robot.geometry.clone(), &given.centres);
        let readings: Vec<PreparedMeasurement> =
            given.observations.rows.iter().map(PreparedMeasurement::from).collect();
        let workspace = self.workspace.as_deref();
        let workspace = workspace.map(|path| read_workspace(path, &given.robot, session)).transpose()?;
        let workspace = Options { workspace, ..Options::default() };
        let noise = CheckSigma::of(self.sigma_mm, &given.observations, Some(&self.robot), &given.robot)?;
        session.findings(noise.finding);
        let input = CheckInput {
            robot: &given.robot,
            start: &start,
            readings: &readings,
            bars: given.observations.bars(),
            sigma_mm: noise.sigma_mm,
            mounting: mounting(self, &given),
            tolerance_mm: self.tolerance_mm,
            rule: self.rule,
            workspace: &workspace.workspace_poses(&given.robot),
        };
        let mut checked = CheckedLengths::of(&input, &given.observations)
            .map_err(|finding| Diagnostic::file(&*self.robot, finding))?;
        let known = known_lengths(self.robot.file(), &given.observations)?;
        session.findings(given.findings());
        session.findings(checked.findings());
        session.findings(checked.of_known_lengths(known));
        if self.update && checked.check.update().is_none() && checked.check.is_explained() {
            session.finding(ConformityFinding::NothingToUpdate);
        }
        let document =
            CheckDocument { checked, findings: session.so_far(), provenance: given.provenance.clone() };
        let files = write_check(self, &document, &given)?;
        let outcome = match document.checked.check.decision.decision.confirms() {
            Some(true) => AnswerOutcome::Done,
            Some(false) => AnswerOutcome::Failed,
            None => AnswerOutcome::Undecided,
        };
        Ok(RequestResult { outcome, files, document })
    }

    fn read_inputs(&self, session: &RequestSession<'_>) -> Result<LoadedInputs, Diagnostic> {
        let LoadedRobot { robot, .. } = self.robot.read()?;
        if robot.posterior.is_none() {
            let finding = ConformityFinding::NoPosterior { robot: robot.name };
            return Err(Diagnostic::file(&*self.robot, finding));
        }
        if self.update {
            files::keeps(&self.out.join(ROBOT), [Path::new(&*self.robot)])?;
        }
        let named = NamedInputs {
            exclude: &[],
            input: &self.input,
            further: &[],
            set_ups: SetUpRelation::default(),
            positions: None,
            robot: Some(&self.robot),
            tool_mm: self.tool_mm,
            centres: self.centres.as_deref(),
            bar_u_mm: self.bar_u_mm,
        };
        let mut given = LoadedInputs::read(named, session)?;
        given.age_robot(None);
        if given.observations.set_up(0).trackers > 0 {
            return Err(EstimationFinding::LengthsOnly.into());
        }
        given.check_planned_robot()?;
        let replaced = self.out.join("check.json");
        earlier::check_replaced(&replaced, Some(&given.robot.name), &given.provenance)?;
        session.findings_in(&*self.robot, given.robot.calibration_warnings());
        Ok(given)
    }
}

/// The changes by mounting. The posterior does not hold another tool ball: its place has the prior of the datasheet.
fn mounting(request: &CheckRequest, given: &LoadedInputs) -> Mounting {
    let datasheet = || Priors::datasheet(&given.robot, given.bar_u_mm()).sd(ParamId::Tool(Coordinate::X));
    let tool_mm = if request.tool_mm.is_some() { datasheet() } else { request.tool_repeat_mm };
    let balls = match request.ball_repeat_mm {
        repeat if request.balls_kept => BallMounting::Kept(repeat.unwrap_or(Mounting::SEAT_REPEAT_MM)),
        Some(repeat) => BallMounting::About(repeat),
        None => BallMounting::Anywhere,
    };
    Mounting { tool_mm, balls, ..Mounting::again(&given.robot, given.bar_u_mm()) }
}

/// The standard deviation of a length, mm, and a finding if a part of it is unknown.
pub struct CheckSigma {
    pub sigma_mm: f64,
    pub finding: Option<ConformityFinding>,
}

impl CheckSigma {
    /// The standard deviation of bar and repeatability, at least the one in the result.json beside a robot file.
    pub(super) fn at_least(own: Option<f64>, file: &str, robot: &Robot) -> Result<Self, Diagnostic> {
        let (path, beside) = result_beside(Path::new(file), robot)?;
        let looked_for = path.display().to_string();
        let sigma = |of_result| conformity::sigma_mm(own, of_result);
        let (sigma_mm, finding) = match beside {
            ResultBeside::Own(result) => (sigma(Some(result.noise_mm.length))?, None),
            ResultBeside::Another => {
                let sigma_mm = sigma(None)?;
                (sigma_mm, Some(ConformityFinding::OtherResultBeside { looked_for, sigma_mm }))
            }
            ResultBeside::Nothing => {
                let sigma_mm = sigma(None)?;
                (sigma_mm, Some(ConformityFinding::NoResultBeside { looked_for, sigma_mm }))
            }
        };
        Ok(Self { sigma_mm, finding })
    }

    /// The standard deviation that is given, else the one of the data. A robot without a file has no result beside it.
    pub fn of(
        given: Option<f64>,
        observations: &Measurements,
        file: Option<&str>,
        robot: &Robot,
    ) -> Result<Self, Diagnostic> {
        if let Some(sigma_mm) = given {
            return Ok(Self { sigma_mm, finding: None });
        }
        let own = conformity::own_sigma_mm(observations, robot);
        match file {
            Some(file) => Self::at_least(own, file, robot),
            None => Ok(Self { sigma_mm: conformity::sigma_mm(own, None)?, finding: None }),
        }
    }
}

/// Writes the files of a check, and returns their names.
fn write_check(
    request: &CheckRequest,
    document: &CheckDocument,
    given: &LoadedInputs,
) -> Result<Vec<String>, Diagnostic> {
    let CheckDocument { checked: CheckedLengths { check, distance }, findings, provenance } = document;
    let mut set = FileSet::begin(&request.out, EarlierFiles::kept_unless(request.replace))?;
    set.write("check.json", serialised::sealed_json(document)?)?;
    set.write("check.html", report::check::html(check, distance.as_ref(), findings, provenance)?)?;
    if let Some(robot) = check.update().filter(|_| request.update) {
        let robot = Robot { provenance: provenance.clone(), ..robot.clone() };
        set.write(ROBOT, Seal::Toml.append(&robot.to_toml()?))?;
        set.write_pieces(LENGTHS, given.observations.csv_pieces(|_| true))?;
    }
    set.finish()
}
