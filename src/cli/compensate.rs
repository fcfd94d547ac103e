//! `dbbd compensate`.

use dbbd_model::base::text::unreadable;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::{CommandOutcome, CommandOutput, program, robots, value};
use dbbd_job::file_set::FileSet;
use dbbd_job::files;
use dbbd_job::program::CompensationFinding;
use dbbd_job::program::ProgramFinding;
use dbbd_job::program::compensate::in_metres;
use dbbd_job::program::krl::{self, Files, Given};
use dbbd_job::program::{
    Language, Moved, Target, Text, check_one_plan, provenance, rapid, stamped, urscript,
};
use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, TracedArtefact};
use dbbd_model::robot::{LoadedRobot, Pose, Robot};

/// Correct the points of a program for an identified robot.
///
/// Corrects the points of a program in KRL (PROGRAM.src and the PROGRAM.dat beside it), RAPID or URScript; the extension
/// of the file selects the language. Every other byte remains. Only points in these files are corrected, not XHOME points and
/// relative motions.
///
/// Lengths do not determine the robot's base frame. The points are corrected in the robot's own frame, so that they are right
/// with respect to each other; measure $BASE again afterwards if a place in the room matters. $BASE is taken in the robot's
/// own base ($ROBROOT null). Lengths do not determine the place of the ball on the flange either: it is taken from the
/// nominal robot file. $TOOL is that of the program, never the ball.
#[derive(clap::Args)]
pub(crate) struct CompensateArgs {
    /// The program: .src of KRL (motions by PTP, LIN, CIRC, SPTP, SLIN, SCIRC and SPL, inline forms or plain), .mod of
    /// RAPID (MoveAbsJ, MoveJ, MoveL, MoveC) or .script of URScript (movej, movel, movec).
    #[arg(value_name = "PROGRAM")]
    program: PathBuf,
    /// The identified robot: its file, or a built-in name.
    #[arg(long, value_name = "NAME|FILE")]
    robot: String,
    /// Directory for the corrected program; not that of the program itself.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The controller's $config.dat, for TOOL_DATA and BASE_DATA; in RAPID a module that declares tools and work objects.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["tool", "base"])]
    config: Option<PathBuf>,
    /// $TOOL (in URScript the TCP) if the program does not set it: mm and degrees, in the flange frame.
    #[arg(long, value_name = "X,Y,Z,A,B,C", value_parser = value::frame, allow_hyphen_values = true)]
    tool: Option<Pose>,
    /// $BASE if the program does not set it: mm and degrees, in the robot's base.
    #[arg(long, value_name = "X,Y,Z,A,B,C", value_parser = value::frame, allow_hyphen_values = true)]
    base: Option<Pose>,
    /// Refuse the program if a commanded point would move by more than this, mm.
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    limit: f64,
}

/// No calibration moves a point so far: a larger limit is in another unit, mm.
const MAX_LIMIT_MM: f64 = 100.0;

/// A corrected program.
struct CorrectedProgram {
    /// Its files with their new texts.
    texts: Vec<(ProgramFile, String)>,
    /// Its files with their chains.
    sources: Vec<TracedArtefact>,
    moved: Vec<Moved>,
    /// The points that are not corrected, with the reasons.
    left: Vec<Diagnostic>,
}

pub(crate) fn run(args: &CompensateArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    if !(args.limit > 0.0 && args.limit <= MAX_LIMIT_MM) {
        let (limit_mm, most_mm) = (args.limit, MAX_LIMIT_MM);
        return Err(Diagnostic::new(CompensationFinding::BadLimit { limit_mm, most_mm }));
    }
    let LoadedRobot { robot, source: identified, .. } = robots::read_named_robot(&args.robot, out)?;
    if robot.nominal.is_none() {
        return Err(Diagnostic::file(&args.robot, CompensationFinding::NotIdentified));
    }
    let edited = robots::edited(&robot).filter(|doubt| *doubt == EstimationFinding::PosteriorOfOtherValues);
    out.findings_in(&args.robot, edited);
    let language = program::language(&args.program)?;
    let wanted = language.name();
    if let Some(other) = robot.controller_language().filter(|other| *other != wanted) {
        let (robot, language) = (robot.name.clone(), other.to_owned());
        return Err(Diagnostic::file(&args.robot, ProgramFinding::OtherLanguage { robot, language, wanted }));
    }
    let cell = CorrectionContext { args, robot: &robot, identified: &identified, out };
    let corrected = match language {
        Language::Krl => cell.krl()?,
        Language::Rapid | Language::Urscript => cell.one_file(language)?,
    };
    let provenance = dbbd_job::artefact::made_from(corrected.sources.iter().chain([&identified]));
    let mut set = FileSet::begin(&args.out)?;
    for (program, text) in &corrected.texts {
        program.write(&mut set, &stamped(language, text, &provenance)?)?;
    }
    set.finish()?;
    report(args, &corrected, out)?;
    Ok(CommandOutcome::Done)
}

/// Reports a file with tools and bases that is not a `$config.dat`.
fn check_config(config: &ProgramFile, out: &CommandOutput) {
    let words =
        |line: &str| line.split_whitespace().take(2).collect::<Vec<_>>().join(" ").to_ascii_uppercase();
    let begins = config.content.lines().map(words).find(|line| line.starts_with("DEFDAT"));
    let begins = begins.unwrap_or_default();
    if begins != "DEFDAT $CONFIG" {
        out.finding(Diagnostic::file(&config.name, ProvenanceFinding::NotConfig { begins }));
    }
}

/// What a program is corrected with.
struct CorrectionContext<'a> {
    args: &'a CompensateArgs,
    robot: &'a Robot,
    identified: &'a TracedArtefact,
    out: &'a CommandOutput,
}

impl CorrectionContext<'_> {
    fn krl(&self) -> Result<CorrectedProgram, Diagnostic> {
        let Self { args, robot, identified, out } = *self;
        let source = ProgramFile::open(&args.program)?;
        if args.program.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("dat")) {
            return Err(Diagnostic::file(&source.name, CompensationFinding::DataNamed));
        }
        let data = data_file(&args.program).map(|path| ProgramFile::open(&path)).transpose()?;
        let config = args.config.as_deref().map(ProgramFile::open).transpose()?;
        config.iter().for_each(|config| check_config(config, out));
        source.check("DEF", &source)?;
        data.iter().try_for_each(|data| data.check("DEFDAT", &source))?;
        let files: Vec<&ProgramFile> = [&source].into_iter().chain(&data).collect();
        self.check_not_overwritten(&files)?;
        let sources = files.iter().map(|file| file.traced()).collect::<Result<Vec<_>, _>>()?;
        sources.iter().try_for_each(|program| check_robot(program, identified, out))?;
        data.iter().try_for_each(|data| check_one_plan(source.text(), data.text()))?;
        let program = Files {
            source: source.text(),
            data: data.as_ref().map(ProgramFile::text),
            config: config.as_ref().map(ProgramFile::text),
        };
        let points = krl::read(program, Given { tool: args.tool, base: args.base })?;
        check_unit(&source, points.points.iter().map(|point| &point.target))?;
        out.findings(points.doubts.iter().cloned());
        let corrected = krl::compensate(program, &points, robot, args.limit)
            .map_err(|refused| self.refused(&source, &refused))?;
        let texts = [(source, corrected.source)].into_iter().chain(data.zip(corrected.data)).collect();
        Ok(CorrectedProgram { texts, sources, moved: corrected.moved, left: points.not_corrected })
    }

    /// A program in a language whose points are in one file.
    fn one_file(&self, language: Language) -> Result<CorrectedProgram, Diagnostic> {
        let Self { args, robot, identified, out } = *self;
        let source = ProgramFile::open(&args.program)?;
        self.check_not_overwritten(&[&source])?;
        let traced = source.traced()?;
        check_robot(&traced, identified, out)?;
        let config = args.config.as_deref().map(ProgramFile::open).transpose()?;
        let has_unused_option = match language {
            Language::Urscript => config.is_some() || args.base.is_some(),
            _ => args.tool.is_some() || args.base.is_some(),
        };
        if has_unused_option {
            return Err(CompensationFinding::FrameUnused { language: language.name() }.into());
        }
        let text = source.text();
        let points = match language {
            Language::Urscript => urscript::read(text, args.tool)?,
            _ => rapid::read(text, config.as_ref().map(ProgramFile::text))?,
        };
        check_unit(&source, points.points.iter().map(|point| &point.target))?;
        out.findings(points.doubts.iter().cloned());
        let corrected = points.compensate(text, robot, args.limit);
        let (corrected, moved) = corrected.map_err(|refused| self.refused(&source, &refused))?;
        Ok(CorrectedProgram {
            texts: vec![(source, corrected)],
            sources: vec![traced],
            moved,
            left: points.not_corrected,
        })
    }

    /// Refuses an output directory where a file of the program would be overwritten.
    fn check_not_overwritten(&self, programs: &[&ProgramFile]) -> Result<(), Diagnostic> {
        let out = &self.args.out;
        if programs.iter().any(|program| files::same_place(&out.join(&program.file_name), &program.path)) {
            let directory = out.display().to_string();
            return Err(Diagnostic::new(CompensationFinding::WouldOverwrite { directory }));
        }
        Ok(())
    }

    /// Reports the points that cannot be corrected.
    fn refused(&self, source: &ProgramFile, points: &[Diagnostic]) -> Diagnostic {
        self.out.findings(points.iter().cloned());
        Diagnostic::file(&source.name, CompensationFinding::PointsRefused { points: points.len() })
    }
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
    out: &CommandOutput,
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
        out.finding(ProvenanceFinding::RobotChanged { artefact, made_for, given });
    }
    Ok(())
}

fn report(
    args: &CompensateArgs,
    corrected: &CorrectedProgram,
    out: &CommandOutput,
) -> Result<(), Diagnostic> {
    let CorrectedProgram { moved, left, .. } = corrected;
    out.findings(left.iter().cloned());
    let left = left.len();
    if moved.is_empty() {
        out.finding(CompensationFinding::NothingCorrected);
    }
    for Moved { name, line, shift_mm, turn_deg, turn_bits } in moved {
        out.detail(format!("line {line}: {name} moved by {shift_mm:.3} mm, {turn_deg:.4} deg"));
        if let Some([taught, corrected]) = *turn_bits {
            let (name, line) = (name.clone(), *line);
            out.finding(CompensationFinding::TurnChanged { name, line, taught, corrected });
        }
    }
    let shifts = moved.iter().map(|point| point.shift_mm);
    let mean_mm = shifts.clone().sum::<f64>() / moved.len().max(1) as f64;
    let largest_mm = shifts.fold(0.0, f64::max);
    out.document(&json!({
        "points": moved, "mean_shift_mm": mean_mm, "largest_shift_mm": largest_mm, "left": left,
        "out": args.out.display().to_string(),
    }))?;
    out.result(format!(
        "{} points corrected, by {mean_mm:.3} mm on average and {largest_mm:.3} mm at most; {left} left as they are; \
         written to {}",
        moved.len(),
        args.out.display()
    ));
    out.progress("corrected in the robot's own frame; run it first in T1, slowly");
    Ok(())
}

/// A file of a program. Its comments may be in any old code page: each byte is then read as the character of that number, and
/// written back unchanged.
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
        let bytes = fs::read(path).map_err(unreadable(&name))?;
        let sha256 = sha256(&bytes);
        let file_name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (content, is_utf8) = match String::from_utf8(bytes) {
            Ok(text) => (text, true),
            Err(error) => (error.into_bytes().into_iter().map(char::from).collect(), false),
        };
        Ok(Self { path: path.into(), name, file_name, sha256, content, is_utf8 })
    }

    fn traced(&self) -> Result<TracedArtefact, Diagnostic> {
        let (name, sha256) = (self.file_name.clone(), self.sha256.clone());
        let artefact = Artefact { role: ArtefactRole::Program, name, serial: None, sha256 };
        Ok(TracedArtefact { artefact, provenance: provenance(&self.name, &self.content)? })
    }

    /// Refuses a file that is cut off, and data of another module than that of `source`.
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
