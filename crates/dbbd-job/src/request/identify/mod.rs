//! Identifies the parameters of a robot from lengths or positions.

mod exclusion;
mod files;
pub(super) mod inputs;
mod matched_run;
mod options;
mod parts;
pub(super) mod tables;

use std::path::{Path, PathBuf};

use dbbd_device::clock;
use dbbd_model::base::date;
use dbbd_model::conformity::UncertaintyBudget;
use dbbd_model::design;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{CalibrationResult, CompletedCalibration, ErrorModel, Input, Options, Prior};
use dbbd_model::measurement::{LengthModel, Measurements};
use dbbd_model::provenance::{ArtefactRole, Provenance};
use dbbd_model::robot::parameter::SetUpCounts;
use serde::{Deserialize, Serialize, Serializer};

use super::workspace::read_workspace;
use super::{AnswerOutcome, RequestResult, RequestSession, earlier};
use crate::file_set::EarlierFiles;
pub use crate::robot_files::ROBOT;
use crate::robot_files::RobotName;
pub use exclusion::Exclusion;
pub use files::{LENGTHS, POSITIONS};
use inputs::{LoadedInputs, NamedInputs};
pub use inputs::{known_lengths, measured_conditions, stated_conditions};
pub use options::AskedIdentification;
pub use parts::SetUpRelation;
pub use tables::plausible_deviation;
use tables::read_prior;

/// Most repetitions of the matching of a capture with the identified robot.
const MAX_MATCHINGS: usize = 5;

/// The request of an identification: the robot, and the measurements.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdentifyRequest {
    /// A table of lengths or of positions, or a capture.
    pub input: PathBuf,
    /// Further captures and tables of the same robot.
    #[serde(default)]
    pub further: Vec<PathBuf>,
    #[serde(default)]
    pub set_ups: SetUpRelation,
    /// The directory of the result.
    pub out: PathBuf,
    /// A built-in name or a file; `None` for the robot of the capture's plan.
    pub robot: Option<RobotName>,
    /// The parameters to estimate: names, ranges, groups. `None` for all that are identifiable.
    pub estimate: Option<String>,
    /// The parameters to fix at their start values.
    pub hold: Option<String>,
    /// A table of positions beside the lengths of the input.
    pub positions: Option<PathBuf>,
    /// A table of the base balls; `None` for the base balls of the capture's plan.
    pub centres: Option<PathBuf>,
    /// Tool ball in the flange frame, in place of the one in the robot file.
    pub tool_mm: Option<[f64; 3]>,
    /// Standard deviation of every length and coordinate; `None` for the values in the data.
    pub sigma_mm: Option<f64>,
    /// The largest expanded uncertainty (k = 2) with which the calibration is still used: the result states until when. `None`:
    /// it states its uncertainty and no date.
    #[serde(default)]
    pub tolerance_mm: Option<f64>,
    /// Standard uncertainty (k = 1) of each bar's length; `None` for the value in the certificate, if known.
    pub bar_u_mm: Option<f64>,
    /// A table of measurements that only check the result.
    pub validate: Option<PathBuf>,
    /// Number of cross-validation folds; 0 for none.
    pub folds: Option<usize>,
    /// `None` for the posterior of the robot file if it has one, else its tolerance; with a list of parameters for none.
    pub prior: Option<RequestedPrior>,
    #[serde(default)]
    pub model: ErrorModel,
    /// Trials of a Monte Carlo of the uncertainties; `None` for none.
    pub monte_carlo: Option<usize>,
    /// A file with the identity of robot and bar, in place of the identity in the capture.
    pub identity: Option<PathBuf>,
    /// A table of poses over which the position uncertainty is predicted.
    pub workspace: Option<PathBuf>,
    /// Measurements that are left out of the fit.
    #[serde(default)]
    pub exclude: Vec<Exclusion>,
    /// Replace the files of an earlier result; otherwise they are kept beside it.
    #[serde(default)]
    pub replace: bool,
}

/// The knowledge of the robot before the identification. `T` is a table of standard deviations: its path, or its
/// content.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RequestedPrior<T = PathBuf> {
    None,
    /// The tolerance in the robot file.
    Datasheet,
    /// The posterior of the robot's earlier identification.
    Posterior,
    /// A table of standard deviations.
    Table(T),
}

impl RequestedPrior {
    /// The prior with this name, else the table with this path.
    pub fn named(name: &str) -> Self {
        match name {
            "none" => Self::None,
            "datasheet" => Self::Datasheet,
            "posterior" => Self::Posterior,
            file => Self::Table(file.into()),
        }
    }

    fn read<T>(
        &self,
        table: impl FnOnce(&Path) -> Result<T, Diagnostic>,
    ) -> Result<RequestedPrior<T>, Diagnostic> {
        Ok(match self {
            Self::None => RequestedPrior::None,
            Self::Datasheet => RequestedPrior::Datasheet,
            Self::Posterior => RequestedPrior::Posterior,
            Self::Table(file) => RequestedPrior::Table(table(file)?),
        })
    }
}

/// `result.json`.
#[derive(Clone, Debug)]
pub struct IdentifyDocument {
    pub calibration: CompletedCalibration,
    pub budget: UncertaintyBudget,
    pub provenance: Provenance,
}

impl Serialize for IdentifyDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { calibration, budget, provenance } = self;
        let without = ResultDocument::without_files(calibration, budget);
        ResultDocument { provenance: Some(provenance), ..without }.serialize(serializer)
    }
}

/// The keys of `result.json`.
#[derive(Serialize)]
pub struct ResultDocument<'a> {
    #[serde(flatten)]
    result: &'a CalibrationResult,
    budget: &'a UncertaintyBudget,
    #[serde(skip_serializing_if = "Option::is_none")]
    provenance: Option<&'a Provenance>,
}

impl<'a> ResultDocument<'a> {
    /// The document of a result that was made from no file.
    pub fn without_files(calibration: &'a CompletedCalibration, budget: &'a UncertaintyBudget) -> Self {
        Self { result: &calibration.result, budget, provenance: None }
    }
}

impl IdentifyRequest {
    pub(super) fn result(
        &self,
        session: &RequestSession<'_>,
    ) -> Result<RequestResult<IdentifyDocument>, Diagnostic> {
        self.check_inputs_are_kept()?;
        let mut given = self.read_inputs(session)?;
        let set_up = given.observations.set_up(given.centres.len());
        let options = self.options(&mut given, set_up, session)?;
        let validation = self.validate.as_deref();
        let validation = validation.map(|path| given.validation(path, session)).transpose()?;
        let busy = session.busy(&format!("identifying from {} measurements", given.observations.count()));
        let calibration = calibrate_and_match(&mut given, validation.as_ref(), &options, session)?;
        let calibration = given.with_excluded(calibration);
        drop(busy);
        let bar_u_mm = given.bar_u_mm();
        let observations = given.observations;
        let identity = &given.provenance.identity;
        let budget = UncertaintyBudget::of(&calibration, &observations, bar_u_mm, identity);
        let document = IdentifyDocument { calibration, budget, provenance: given.provenance };
        let (document, files) = files::write_results(
            &self.out,
            EarlierFiles::kept_unless(self.replace),
            document,
            &observations,
        )?;
        Ok(RequestResult {
            outcome: if document.calibration.result.has_warnings() {
                AnswerOutcome::Warned
            } else {
                AnswerOutcome::Done
            },
            files,
            document,
        })
    }

    /// Refuses a directory in which the result would replace an input.
    fn check_inputs_are_kept(&self) -> Result<(), Diagnostic> {
        let inputs =
            || [&self.input].into_iter().chain(&self.further).chain(&self.positions).map(PathBuf::as_path);
        crate::files::keeps(&self.out.join(LENGTHS), inputs())?;
        crate::files::keeps(&self.out.join(POSITIONS), inputs())?;
        crate::files::keeps(&self.out.join(ROBOT), self.robot.as_deref().map(Path::new))
    }

    /// Reads the inputs, and completes their provenance and identity.
    fn read_inputs(&self, session: &RequestSession<'_>) -> Result<LoadedInputs, Diagnostic> {
        let named = NamedInputs {
            input: &self.input,
            further: &self.further,
            set_ups: self.set_ups,
            positions: self.positions.as_deref(),
            robot: self.robot.as_ref(),
            tool_mm: self.tool_mm,
            centres: self.centres.as_deref(),
            bar_u_mm: self.bar_u_mm,
            exclude: &self.exclude,
        };
        let mut given = LoadedInputs::read(named, session)?;
        let balls = given.centres.len();
        if let Some(RequestedPrior::Table(file)) = &self.prior {
            given.provenance.add(&crate::artefact::of_file(ArtefactRole::Prior, file)?);
        }
        let stated = self.identity.as_ref().map(|path| earlier::read_identity(path)).transpose()?;
        given.age_robot(stated.as_ref());
        let identity = &mut given.provenance.identity;
        if let Some(stated) = &stated {
            session.findings(earlier::other_run(identity, balls, stated));
            identity.extend(stated);
        }
        session.findings(identity.old_certificate(&date::utc(clock::unix_ns())));
        let replaced = self.out.join(files::RESULT);
        earlier::check_replaced(&replaced, Some(&given.robot.name), &given.provenance)?;
        Ok(given)
    }

    fn options(
        &self,
        given: &mut LoadedInputs,
        set_up: SetUpCounts,
        session: &RequestSession<'_>,
    ) -> Result<Options, Diagnostic> {
        let prior = self
            .prior
            .as_ref()
            .map(|prior| prior.read(|file| session.table(file, |table| read_prior(table, set_up))));
        let asked = AskedIdentification {
            estimate: self.estimate.as_deref(),
            hold: self.hold.as_deref(),
            prior: prior.transpose()?,
            rest: Options {
                model: self.model,
                sigma_mm: self.sigma_mm,
                tolerance_mm: self.tolerance_mm,
                bar_u_mm: given.bar_u_mm(),
                folds: self.folds,
                monte_carlo: self.monte_carlo,
                measured: given.measured.clone(),
                ..Options::default()
            },
        };
        let prior = match &self.prior {
            Some(RequestedPrior::Table(file)) => Some(file.as_path()),
            _ => self.robot.as_ref().and_then(RobotName::file),
        };
        let mut options = given.options(asked, prior, set_up)?;
        // A warning about the earlier identification matters only if this identification is the prior.
        session.findings(
            given.robot.calibration_warnings().filter(|_| matches!(options.prior, Prior::Posterior)),
        );
        let workspace = self.workspace.as_deref();
        options.workspace = workspace.map(|path| read_workspace(path, &given.robot, session)).transpose()?;
        Ok(options)
    }
}

/// Identifies, and matches a capture again with the identified robot until its pairs no longer change.
fn calibrate_and_match(
    given: &mut LoadedInputs,
    validation: Option<&Measurements>,
    options: &Options,
    session: &RequestSession<'_>,
) -> Result<CompletedCalibration, Diagnostic> {
    session.done(20);
    // If nothing can be computed, the findings about the inputs may explain why.
    let mut calibrated =
        calibrate(given, validation, options).inspect_err(|_| session.findings(given.findings()))?;
    session.done(60);
    for _ in 0..MAX_MATCHINGS {
        if !given.match_again(&calibrated) {
            break;
        }
        calibrated = calibrate(given, validation, options)?;
    }
    session.done(90);
    Ok(calibrated)
}

fn calibrate(
    given: &LoadedInputs,
    validation: Option<&Measurements>,
    options: &Options,
) -> Result<CompletedCalibration, Diagnostic> {
    let LoadedInputs { robot, centres, observations, axes, .. } = given;
    let start = &LengthModel::before(robot.geometry.clone(), centres, observations);
    let input = Input { robot, observations, start, validation, options, axes: *axes };
    Ok(design::calibrate(&input, given.findings())?)
}
