//! Corrects the points of a program for an identified robot.

use std::path::{Path, PathBuf};

use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{EstimationFinding, ProgramUncertainty, ToolPoses, Workspace};
use dbbd_model::measurement::ToolPoint;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, TracedArtefact};
use dbbd_model::robot::{AXES, ControllerModel, LoadedRobot, Pose, Robot};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use super::robots::{carrying, edited, robot_for_measurement, today};
use super::workspace::read_workspace;
use super::{AnswerOutcome, RequestResult, RequestSession};
use crate::file_set::{EarlierFiles, FileSet};
use crate::files;
use crate::plan::Plan;
use crate::program::CompensationFinding;
use crate::program::ProgramFinding;
use crate::program::compensate::in_metres;
use crate::program::fanuc::{self, GivenFrames};
use crate::program::krl::{self, Files, Given};
use crate::program::{
    Correction, Language, MountedBalls, Moved, Target, Text, check_one_plan, provenance, rapid, stamped,
    urscript,
};
use crate::recording::run::read_plan;
use crate::robot_files::{RobotName, standing_of};

/// Which program shall be corrected, and for which robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompensateRequest {
    /// The program; its extension is the extension of its language.
    pub program: PathBuf,
    /// The identified robot.
    pub robot: RobotName,
    /// The directory of the corrected program.
    pub out: PathBuf,
    /// The file that declares tools and bases.
    pub config: Option<PathBuf>,
    /// The tool frame in the flange frame if the program does not set it: X, Y, Z in mm, A, B, C in degrees.
    pub tool_mm_deg: Option<[f64; 6]>,
    /// The base in the robot's base if the program does not set it: X, Y, Z in mm, A, B, C in degrees.
    pub base_mm_deg: Option<[f64; 6]>,
    /// The axis angles at which the robot stands before the program, degrees: they select the branch of a first pose without one.
    #[serde(default)]
    pub start_deg: Option<[f64; AXES]>,
    /// Payload of the flange while the program runs: a payload of the robot file by its name, or `KG,X,Y,Z`.
    pub payload: Option<String>,
    /// The controller has the nominal model, although its make has another one by default.
    #[serde(default)]
    pub nominal_controller: bool,
    /// The poses over which robot and program are aligned, for the predicted uncertainty.
    #[serde(default)]
    pub datum: ProgramDatum,
    /// The program is refused if a commanded point would move by more than this.
    #[serde(default = "default_limit_mm")]
    pub limit_mm: f64,
    /// The plan of a program that holds the bar; `None` for the one in a directory beside the program.
    #[serde(default)]
    pub plan: Option<PathBuf>,
    /// Replace the files of an earlier result; otherwise it is refused.
    #[serde(default)]
    pub replace: bool,
}

/// Poses over which robot and program are aligned.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProgramDatum {
    /// The points of the program, whose base is measured at them.
    #[default]
    Program,
    /// The workspace of the robot, as in `result.json`.
    Workspace,
    /// A table of poses with the columns a1_deg..a6_deg.
    File(PathBuf),
}

impl ProgramDatum {
    /// Poses and seed of the workspace.
    const WORKSPACE: (usize, u64) = (2000, 1);

    /// The name of the datum, as in the answer.
    fn name(&self) -> String {
        match self {
            Self::Program => "program".into(),
            Self::Workspace => "workspace".into(),
            Self::File(path) => path.display().to_string(),
        }
    }

    /// Axis angles of the poses, rad; empty if the points of the program are the datum.
    fn poses(&self, robot: &Robot, session: &RequestSession<'_>) -> Result<Vec<[f64; AXES]>, Diagnostic> {
        match self {
            Self::Program => Ok(Vec::new()),
            Self::Workspace => {
                let (poses, seed) = Self::WORKSPACE;
                Ok(Workspace::uniform(robot.controller(), poses, seed))
            }
            Self::File(path) => read_workspace(path, robot, session),
        }
    }
}

/// The default of [`CompensateRequest::limit_mm`].
pub const DEFAULT_LIMIT_MM: f64 = 5.0;

fn default_limit_mm() -> f64 {
    DEFAULT_LIMIT_MM
}

/// The corrected points.
#[derive(Clone, Debug)]
pub struct CompensateDocument {
    pub points: Vec<Moved>,
    /// Number of points that are not corrected.
    pub left: usize,
    /// Predicted uncertainty of the program's own tools at its points; `None` if all points are axis angles, or the
    /// file lacks the posterior.
    pub predicted: Option<ProgramUncertainty>,
    /// The poses over which robot and program are aligned: `program`, `workspace` or a file.
    pub datum: String,
    /// The directory of the corrected program.
    pub out: String,
}

impl CompensateDocument {
    pub fn mean_shift_mm(&self) -> f64 {
        // The sum of no numbers is -0.
        let sum = self.points.iter().map(|point| point.shift_mm).fold(0.0, |sum, shift| sum + shift);
        sum / self.points.len().max(1) as f64
    }

    pub fn largest_shift_mm(&self) -> f64 {
        self.points.iter().map(|point| point.shift_mm).fold(0.0, f64::max)
    }
}

impl Serialize for CompensateDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (mean_mm, largest_mm) = (self.mean_shift_mm(), self.largest_shift_mm());
        let document = json!({
            "points": self.points, "mean_shift_mm": mean_mm, "largest_shift_mm": largest_mm,
            "left": self.left, "out": self.out,
            "predicted_position_uncertainty_mm": self.predicted, "datum": self.datum,
        });
        document.serialize(serializer)
    }
}

/// A corrected program.
struct CorrectedProgram {
    /// The files of the program with their new texts.
    texts: Vec<(ProgramFile, String)>,
    /// The files of the program with their chains.
    sources: Vec<TracedArtefact>,
    moved: Vec<Moved>,
    /// The number of points that are not corrected.
    left: usize,
}

impl CompensateRequest {
    pub(super) fn result(
        &self,
        session: &RequestSession<'_>,
    ) -> Result<RequestResult<CompensateDocument>, Diagnostic> {
        let LoadedRobot { mut robot, source: identified, .. } = robot_for_measurement(&self.robot, session)?;
        robot = today(&robot);
        session.findings_in(&*self.robot, carrying(&self.robot, &mut robot, self.payload.as_deref())?);
        session.findings_in(&*self.robot, robot.calibration_warnings());
        let standing = standing_of(Path::new(&*self.robot), &robot)?;
        session.findings_in(&*self.robot, standing.and_then(|standing| standing.finding(&robot.name)));
        if robot.nominal.is_none() {
            return Err(Diagnostic::file(&*self.robot, CompensationFinding::NotIdentified));
        }
        robot.check_tool().map_err(|why| Diagnostic::file(&*self.robot, why))?;
        let edited = edited(&robot).filter(|finding| *finding == EstimationFinding::PosteriorOfOtherValues);
        session.findings_in(&*self.robot, edited);
        let language = program_language(&self.program)?;
        let wanted = language.name();
        if let Some(other) = robot.controller_language().filter(|other| *other != wanted) {
            let (robot, language) = (robot.name.clone(), other.to_owned());
            let finding = ProgramFinding::OtherLanguage { robot, language, wanted };
            return Err(Diagnostic::file(&*self.robot, finding));
        }
        let datum = self.datum.poses(&robot, session)?;
        let context = CorrectionContext { request: self, robot: &robot, identified: &identified, session };
        let corrected = match language {
            Language::Krl => context.krl()?,
            Language::Rapid | Language::Urscript | Language::Fanuc => context.one_file(language)?,
        };
        self.check_controller(&robot)?;
        let provenance = crate::artefact::made_from(corrected.sources.iter().chain([&identified]));
        session.findings(identified.provenance.of_origin());
        let mut set = FileSet::begin(&self.out, EarlierFiles::refused_unless(self.replace))?;
        for (program, text) in &corrected.texts {
            program.write(&mut set, &stamped(language, text, &provenance)?)?;
        }
        let files = set.finish()?;
        report(&corrected.moved, session);
        let tool_points: Vec<_> = corrected.moved.iter().filter_map(|moved| moved.tool_point).collect();
        let predicted =
            robot.has_posterior().then(|| ProgramUncertainty::of(&robot, &tool_points, &datum)).flatten();
        if let Some(ProgramUncertainty { before, after, .. }) = predicted.filter(|errors| !errors.is_better())
        {
            let [before_mm, after_mm] = [before.mean, after.mean];
            session.finding(CompensationFinding::NoBetter { before_mm, after_mm });
        }
        let document = CompensateDocument {
            predicted,
            datum: self.datum.name(),
            points: corrected.moved,
            left: corrected.left,
            out: self.out.display().to_string(),
        };
        Ok(RequestResult { outcome: AnswerOutcome::Done, files, document })
    }

    /// Refuses a controller that corrects with a table of its own that is not known: the controller does not drive the
    /// nominal robot.
    fn check_controller(&self, robot: &Robot) -> Result<(), Diagnostic> {
        let wrong = match (robot.controller_model, self.nominal_controller) {
            (ControllerModel::Unknown, false) => {
                CompensationFinding::ControllerUnknown { robot: robot.name.clone() }
            }
            (ControllerModel::Calibrated, true) => CompensationFinding::ControllerCalibrated,
            (ControllerModel::Unknown | ControllerModel::Nominal, true)
            | (ControllerModel::Nominal | ControllerModel::Calibrated, false) => return Ok(()),
        };
        Err(Diagnostic::file(&*self.robot, wrong))
    }

    /// The stated frame of the tool in the flange frame.
    fn tool(&self) -> Option<Pose> {
        self.tool_mm_deg.map(Pose::from_xyzabc)
    }

    /// The stated base in the robot's base.
    fn base(&self) -> Option<Pose> {
        self.base_mm_deg.map(Pose::from_xyzabc)
    }
}

/// The tools of a program at the axis angles of its points, as its controller moves there; without points that are axis angles.
///
/// # Errors
/// Those of a program that is corrected.
pub(super) fn points_of_program(
    program: &Path,
    robot: &LoadedRobot,
    session: &RequestSession<'_>,
) -> Result<Vec<ToolPoses>, Diagnostic> {
    let controller = robot.robot.controller().clone();
    let request = CompensateRequest {
        program: program.to_owned(),
        robot: RobotName::from(controller.name.as_str()),
        // Nothing is written.
        out: program.join("corrected"),
        config: None,
        tool_mm_deg: None,
        base_mm_deg: None,
        start_deg: None,
        payload: None,
        nominal_controller: false,
        datum: ProgramDatum::Program,
        limit_mm: DEFAULT_LIMIT_MM,
        plan: None,
        replace: false,
    };
    // Where a robot is as its controller has it, no point moves.
    let unchanged = Robot { nominal: Some(Box::new(controller.clone())), ..controller };
    let context =
        CorrectionContext { request: &request, robot: &unchanged, identified: &robot.source, session };
    let corrected = context.one_file(program_language(program)?)?;
    let mut tools: Vec<ToolPoses> = Vec::new();
    for ToolPoint { tool, pose } in corrected.moved.iter().filter_map(|moved| moved.tool_point) {
        let axes = pose.axes.radians();
        match tools.iter_mut().find(|of| of.tool_mm == Some(tool)) {
            Some(of_tool) => of_tool.poses.push(axes),
            None => tools.push(ToolPoses { tool_mm: Some(tool), poses: vec![axes] }),
        }
    }
    if tools.is_empty() {
        return Err(Diagnostic::file(program.display(), CompensationFinding::NothingCorrected));
    }
    Ok(tools)
}

/// The language of a program, by its extension.
pub fn program_language(program: &Path) -> Result<Language, Diagnostic> {
    let extension = program.extension().and_then(|extension| extension.to_str()).unwrap_or("src");
    Language::of_extension(extension).ok_or_else(|| {
        let file = program.display().to_string();
        Diagnostic::file(program.display(), CompensationFinding::NoLanguage { file })
    })
}

/// Reports a file of tools and bases that is not a `$config.dat`.
fn check_config(config: &ProgramFile, session: &RequestSession<'_>) {
    let words =
        |line: &str| line.split_whitespace().take(2).collect::<Vec<_>>().join(" ").to_ascii_uppercase();
    let begins = config.content.lines().map(words).find(|line| line.starts_with("DEFDAT"));
    let begins = begins.unwrap_or_default();
    if begins != "DEFDAT $CONFIG" {
        session.finding(Diagnostic::file(&config.name, ProvenanceFinding::NotConfig { begins }));
    }
}

/// The data with which a program is corrected.
struct CorrectionContext<'a> {
    request: &'a CompensateRequest,
    robot: &'a Robot,
    identified: &'a TracedArtefact,
    session: &'a RequestSession<'a>,
}

impl CorrectionContext<'_> {
    fn krl(&self) -> Result<CorrectedProgram, Diagnostic> {
        let Self { request, robot, identified, session } = *self;
        let source = ProgramFile::open(&request.program)?;
        if request.program.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("dat")) {
            return Err(Diagnostic::file(&source.name, CompensationFinding::DataNamed));
        }
        let data = data_file(&request.program).map(|path| ProgramFile::open(&path)).transpose()?;
        let config = request.config.as_deref().map(ProgramFile::open).transpose()?;
        config.iter().for_each(|config| check_config(config, session));
        source.check("DEF", &source)?;
        data.iter().try_for_each(|data| data.check("DEFDAT", &source))?;
        let files: Vec<&ProgramFile> = [&source].into_iter().chain(&data).collect();
        self.check_not_overwritten(&files)?;
        let sources = files.iter().map(|file| file.traced()).collect::<Result<Vec<_>, _>>()?;
        sources.iter().try_for_each(|program| check_robot(program, identified, session))?;
        data.iter().try_for_each(|data| check_one_plan(source.text(), data.text()))?;
        let program = Files {
            source: source.text(),
            data: data.as_ref().map(ProgramFile::text),
            config: config.as_ref().map(ProgramFile::text),
        };
        let points = krl::read(program, Given { tool: request.tool(), base: request.base() })?;
        check_unit(&source, points.points.iter().map(|point| &point.target))?;
        let accurate = points.points.iter().find(|point| point.is_absolutely_accurate());
        if let Some(point) = accurate.filter(|_| robot.controller_model == ControllerModel::Calibrated) {
            let corrects = CompensationFinding::ControllerCorrectsTaught { name: point.name.clone() };
            return Err(source.text().wrong(&point.first_use, corrects));
        }
        session.findings(points.warnings.iter().chain(&points.not_corrected).cloned());
        let mounted = self.mounted(&sources[0])?;
        let correction = self.correction(mounted.as_ref())?;
        let corrected = krl::compensate(program, &points, correction)
            .map_err(|refused| self.refused(&source, &refused))?;
        let texts = [(source, corrected.source)].into_iter().chain(data.zip(corrected.data)).collect();
        Ok(CorrectedProgram { texts, sources, moved: corrected.moved, left: points.not_corrected.len() })
    }

    /// A program in a language whose points are in one file.
    fn one_file(&self, language: Language) -> Result<CorrectedProgram, Diagnostic> {
        let Self { request, identified, session, .. } = *self;
        let source = ProgramFile::open(&request.program)?;
        self.check_not_overwritten(&[&source])?;
        let traced = source.traced()?;
        check_robot(&traced, identified, session)?;
        let config = request.config.as_deref().map(ProgramFile::open).transpose()?;
        let (text, config) = (source.text(), config.as_ref().map(ProgramFile::text));
        let (tool, base) = (request.tool(), request.base());
        let unused = || Err(CompensationFinding::FrameUnused { language: language.name() }.into());
        let points = match language {
            Language::Krl => return self.krl(),
            Language::Rapid if tool.is_some() || base.is_some() => return unused(),
            Language::Rapid => rapid::read(text, config)?,
            Language::Urscript if config.is_some() || base.is_some() => return unused(),
            Language::Urscript => urscript::read(text, tool)?,
            Language::Fanuc => fanuc::read(text, GivenFrames { config, tool, base })?,
        };
        check_unit(&source, points.points.iter().map(|point| &point.target))?;
        session.findings(points.warnings.iter().chain(&points.not_corrected).cloned());
        let mounted = self.mounted(&traced)?;
        let correction = self.correction(mounted.as_ref())?;
        let corrected = points.compensate(text, correction);
        let (corrected, moved) = corrected.map_err(|refused| self.refused(&source, &refused))?;
        Ok(CorrectedProgram {
            texts: vec![(source, corrected)],
            sources: vec![traced],
            moved,
            left: points.not_corrected.len(),
        })
    }

    fn correction<'c>(&'c self, mounted: Option<&'c MountedBalls>) -> Result<Correction<'c>, Diagnostic> {
        let Self { request, robot, .. } = *self;
        if let Some(axes_deg) = request.start_deg {
            let limits = robot.controller().limits_at_deg(&axes_deg);
            let beyond = (1..)
                .zip(axes_deg.into_iter().zip(limits))
                .find(|(_, (angle, [low, high]))| !(low..=high).contains(&angle));
            if let Some((axis, (angle_deg, [low_deg, high_deg]))) = beyond {
                return Err(
                    CompensationFinding::StartBeyondLimit { axis, angle_deg, low_deg, high_deg }.into()
                );
            }
        }
        Ok(Correction::of(robot, request.limit_mm).about(mounted).from_start(request.start_deg))
    }

    /// The base balls of the plan that a program was made from: it holds the bar.
    fn mounted(&self, program: &TracedArtefact) -> Result<Option<MountedBalls>, Diagnostic> {
        let Self { request, robot, identified, .. } = *self;
        let is_plan = |source: &&Artefact| source.role == ArtefactRole::Plan;
        let Some(made_from) = program.provenance.from.iter().rev().find(is_plan) else { return Ok(None) };
        let refused = |why: CompensationFinding| Diagnostic::file(&program.artefact.name, why);
        let plan = made_from.name.clone();
        let found = match &request.plan {
            Some(csv) => read_plan(csv)?,
            None => plan_beside(&request.program, &plan)
                .ok_or_else(|| refused(CompensationFinding::NoPlanBeside { plan: plan.clone() }))?,
        };
        if found.header.hash != plan {
            let given = found.header.hash.clone();
            return Err(refused(CompensationFinding::OtherPlan { plan, given }));
        }
        let are_kept = identified.provenance.from.iter().any(|source| source.name == plan);
        MountedBalls::of(&found, robot, are_kept).map(Some).map_err(refused)
    }

    /// Refuses an output directory where a file of the program would be overwritten.
    fn check_not_overwritten(&self, programs: &[&ProgramFile]) -> Result<(), Diagnostic> {
        let out = &self.request.out;
        if programs.iter().any(|program| files::same_place(&out.join(&program.file_name), &program.path)) {
            let directory = out.display().to_string();
            return Err(Diagnostic::new(CompensationFinding::WouldOverwrite { directory }));
        }
        Ok(())
    }

    /// Reports the points that cannot be corrected.
    fn refused(&self, source: &ProgramFile, points: &[Diagnostic]) -> Diagnostic {
        self.session.findings(points.iter().cloned());
        Diagnostic::file(&source.name, CompensationFinding::PointsRefused { points: points.len() })
    }
}

/// The plan with this hash in the [`files::directories_around`] the program.
fn plan_beside(program: &Path, hash: &str) -> Option<Plan> {
    let around = files::directories_around(program).into_iter();
    let mut plans = around.map(|directory| directory.join("plan.csv")).filter(|csv| files::is_there(csv));
    plans.find_map(|csv| read_plan(&csv).ok().filter(|plan| plan.header.hash == hash))
}

/// Refuses a program whose points are in metres.
fn check_unit<'a>(
    program: &ProgramFile,
    targets: impl Iterator<Item = &'a Target>,
) -> Result<(), Diagnostic> {
    let refused = |finding| Err(Diagnostic::file(&program.name, finding));
    in_metres(targets).map_or(Ok(()), refused)
}

/// Refuses a program that was corrected before, or was made for another robot.
fn check_robot(
    program: &TracedArtefact,
    identified: &TracedArtefact,
    session: &RequestSession<'_>,
) -> Result<(), Diagnostic> {
    if let Some(source) = program.provenance.corrected_by() {
        let before = ProvenanceFinding::CorrectedBefore { source: source.to_string() };
        return Err(Diagnostic::file(&program.artefact.name, before));
    }
    program.check_made_for(&identified.artefact)?;
    let Some(made_for) = program.robot() else { return Ok(()) };
    if let Some(nominal) = identified.provenance.from.iter().find(|source| source.role == ArtefactRole::Robot)
        && !identified.provenance.has(made_for)
    {
        let [artefact, made_for, given] = [&program.artefact, made_for, nominal].map(ToString::to_string);
        session.finding(ProvenanceFinding::RobotChanged { artefact, made_for, given });
    }
    Ok(())
}

/// Reports the points at which an axis moved through zero.
fn report(moved: &[Moved], session: &RequestSession<'_>) {
    if moved.is_empty() {
        session.finding(CompensationFinding::NothingCorrected);
    }
    for Moved { name, line, turn_bits, .. } in moved {
        if let Some([taught, corrected]) = *turn_bits {
            let (name, line) = (name.clone(), *line);
            session.finding(CompensationFinding::TurnChanged { name, line, taught, corrected });
        }
    }
}

/// The largest file of a program, bytes.
const MAX_PROGRAM_BYTES: u64 = 64 << 20;

/// A file of a program. Its comments may be in any old code page: each byte is then read as the character with the
/// number of the byte, and written back unchanged.
struct ProgramFile {
    path: PathBuf,
    /// The path as text.
    name: String,
    file_name: String,
    sha256: String,
    content: String,
    is_utf8: bool,
}

impl ProgramFile {
    fn open(path: &Path) -> Result<Self, Diagnostic> {
        let name = path.display().to_string();
        let bytes = files::read_bytes(path, MAX_PROGRAM_BYTES)?;
        let sha256 = sha256(&bytes);
        let file_name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (content, is_utf8) = match String::from_utf8(bytes) {
            // A controller does not read a byte order mark, which editors write: the corrected file has none.
            Ok(text) => (text.trim_start_matches('\u{feff}').to_owned(), true),
            Err(error) => (error.into_bytes().into_iter().map(char::from).collect(), false),
        };
        Ok(Self { path: path.into(), name, file_name, sha256, content, is_utf8 })
    }

    fn traced(&self) -> Result<TracedArtefact, Diagnostic> {
        let (name, sha256) = (self.file_name.clone(), self.sha256.clone());
        let artefact = Artefact { role: ArtefactRole::Program, name, serial: None, sha256, origin: None };
        Ok(TracedArtefact { artefact, provenance: provenance(&self.name, &self.content)? })
    }

    /// Refuses a file that is cut off, and data of another module than the module of `source`.
    fn check(&self, begins: &str, source: &Self) -> Result<(), Diagnostic> {
        let words = |line: &str| -> Vec<String> {
            let words = line.split(|c: char| c.is_whitespace() || c == '(');
            let words = words.filter(|word| !word.is_empty() && !word.eq_ignore_ascii_case("GLOBAL"));
            words.map(str::to_ascii_uppercase).take(2).collect()
        };
        let mut lines = self.content.lines().map(words);
        let Some(name) = lines.find(|words| words.first().is_some_and(|word| word == begins)) else {
            return Ok(());
        };
        let end = format!("END{}", begins.trim_start_matches("DEF"));
        if !lines.any(|words| words.first() == Some(&end)) {
            return Err(Diagnostic::file(&self.name, CompensationFinding::CutOff { end }));
        }
        let module = source.path.file_stem().unwrap_or_default().to_string_lossy().to_ascii_uppercase();
        match name.get(1).filter(|name| begins == "DEFDAT" && **name != module) {
            Some(data) => {
                let data = data.clone();
                Err(Diagnostic::file(&self.name, ProgramFinding::OtherDataName { data, module }))
            }
            None => Ok(()),
        }
    }

    fn text(&self) -> Text<'_> {
        Text { file: &self.name, text: &self.content }
    }

    fn write(&self, set: &mut FileSet, text: &str) -> Result<(), Diagnostic> {
        if self.is_utf8 {
            return set.write(&self.file_name, text);
        }
        let bytes: Vec<u8> = text.chars().filter_map(|c| u8::try_from(c).ok()).collect();
        set.write(&self.file_name, bytes)
    }
}

/// The .dat beside a .src, in any case.
fn data_file(source: &Path) -> Option<PathBuf> {
    let wanted = source.with_extension("dat");
    let wanted = wanted.file_name()?.to_str()?;
    files::directory_of(source).read_dir().ok()?.find_map(|entry| {
        let entry = entry.ok()?;
        entry.file_name().to_str()?.eq_ignore_ascii_case(wanted).then(|| entry.path())
    })
}
