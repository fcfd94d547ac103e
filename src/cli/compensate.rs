//! `dbbd compensate`.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::robots;
use super::{Outcome, Output};
use crate::base::hash::sha256;
use crate::base::{FileSet, files};
use crate::catalogue::{CompensationFinding, EstimationFinding, ProgramFinding, ProvenanceFinding};
use crate::diagnostic::Diagnostic;
use crate::program::krl::{self, Files, Given};
use crate::program::{Language, Moved, Text, provenance, rapid, stamped, urscript};
use crate::provenance::{Artefact, Provenance, Role, Traced};
use crate::robot::pose::is_part_of_turn;
use crate::robot::{Pose, Robot, RobotRead};

/// Correct the points of a program for an identified robot.
///
/// Rewrites the points of a program in KRL (PROGRAM.src and the PROGRAM.dat beside it), RAPID or URScript, which are known
/// by the extension; every other byte stays. Only points in these files are corrected; XHOME points and relative motions
/// stay.
///
/// The robot's base frame is not identifiable from lengths. The points are corrected in the robot's own frame, so that
/// positions come out right with respect to each other; measure $BASE again afterwards where a place in the room
/// matters. $BASE is taken in the robot's own base ($ROBROOT null). Nor is the place of the ball on the
/// flange: the ball is taken to be where the nominal robot file has it. $TOOL is the program's own,
/// never the ball.
#[derive(clap::Args)]
pub(crate) struct Args {
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
    /// $TOOL (in URScript the TCP) where the program does not set it: mm and degrees, in the flange frame.
    #[arg(long, value_name = "X,Y,Z,A,B,C", value_parser = parse_frame, allow_hyphen_values = true)]
    tool: Option<Pose>,
    /// $BASE where the program does not set it: mm and degrees, in the robot's base.
    #[arg(long, value_name = "X,Y,Z,A,B,C", value_parser = parse_frame, allow_hyphen_values = true)]
    base: Option<Pose>,
    /// The program is refused when a commanded point would move by more, mm.
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    limit: f64,
}

fn parse_frame(text: &str) -> Result<Pose, CompensationFinding> {
    let numbers: Vec<f64> = text.split(',').map(|part| part.trim().parse().unwrap_or(f64::NAN)).collect();
    match numbers[..] {
        [_, _, _, a, b, c] if [a, b, c].into_iter().any(is_part_of_turn) => {
            Err(CompensationFinding::FrameInRadians)
        }
        [x, y, z, a, b, c] if numbers.iter().all(|number| number.is_finite()) => {
            Ok(Pose::from_kuka([x, y, z], [a, b, c]))
        }
        _ => Err(CompensationFinding::NotAFrame),
    }
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    if !(args.limit.is_finite() && args.limit > 0.0) {
        return Err(Diagnostic::new(CompensationFinding::BadLimit { limit_mm: args.limit }));
    }
    let RobotRead { robot, source: identified, .. } = robots::read(&args.robot, out)?;
    if robot.nominal.is_none() {
        return Err(Diagnostic::file(&args.robot, CompensationFinding::NotIdentified));
    }
    let changed = robots::edited(&robot).filter(|doubt| *doubt == EstimationFinding::PosteriorOfOtherValues);
    changed.into_iter().for_each(|doubt| out.finding(Diagnostic::file(&args.robot, doubt)));
    let language = language(&args.program)?;
    let wanted = language.name();
    if let Some(other) = robot.controller_language().filter(|other| *other != wanted) {
        let (robot, language) = (robot.name.clone(), other.to_owned());
        return Err(Diagnostic::file(&args.robot, ProgramFinding::OtherLanguage { robot, language, wanted }));
    }
    let cell = Cell { args, robot: &robot, identified: &identified, out };
    match language {
        Language::Krl => cell.krl(),
        Language::Rapid | Language::Urscript => cell.one_file(language),
    }
}

/// The language of a program, by its extension.
fn language(program: &Path) -> Result<Language, Diagnostic> {
    let extension = program.extension().and_then(|extension| extension.to_str()).unwrap_or("src");
    Language::of_extension(extension).ok_or_else(|| {
        let file = program.display().to_string();
        Diagnostic::file(&file.clone(), CompensationFinding::NoLanguage { file })
    })
}

/// Doubts a file with tools and bases that is no `$config.dat`.
fn out_of_config(config: &Program, out: &Output) {
    let words =
        |line: &str| line.split_whitespace().take(2).collect::<Vec<_>>().join(" ").to_ascii_uppercase();
    let begins = config.text().text.lines().map(words).find(|line| line.starts_with("DEFDAT"));
    let begins = begins.unwrap_or_default();
    if begins != "DEFDAT $CONFIG" {
        out.finding(Diagnostic::file(&config.name, ProvenanceFinding::NotConfig { begins }));
    }
}

/// What a program is corrected with.
struct Cell<'a> {
    args: &'a Args,
    robot: &'a Robot,
    identified: &'a Traced,
    out: &'a Output,
}

impl Cell<'_> {
    fn krl(&self) -> Result<Outcome, Diagnostic> {
        let Self { args, robot, identified, out } = *self;
        let source = Program::open(&args.program)?;
        if args.program.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("dat")) {
            return Err(Diagnostic::file(&source.name, CompensationFinding::DataNamed));
        }
        let data = beside(&args.program, "dat").map(|path| Program::open(&path)).transpose()?;
        let config = args.config.as_deref().map(Program::open).transpose()?;
        config.iter().for_each(|config| out_of_config(config, out));
        source.check("DEF", &source)?;
        data.iter().try_for_each(|data| data.check("DEFDAT", &source))?;
        let both: Vec<&Program> = [Some(&source), data.as_ref()].into_iter().flatten().collect();
        self.keeps(&both)?;
        let program = Files {
            source: source.text(),
            data: data.as_ref().map(Program::text),
            config: config.as_ref().map(Program::text),
        };
        let sources = both.iter().map(|program| program.traced()).collect::<Result<Vec<_>, _>>()?;
        sources.iter().try_for_each(|program| belongs(program, identified, out))?;
        of_one_plan(&both, &sources)?;
        let points = krl::read(program, Given { tool: args.tool, base: args.base })?;
        let corrected = krl::compensate(program, &points, robot, args.limit)
            .map_err(|refused| self.refused(&source, &refused))?;
        let made = Provenance::of(sources.iter().chain([identified]));
        let texts = [Some(&corrected.source), corrected.data.as_ref()].into_iter().flatten();
        let mut set = FileSet::begin(&args.out)?;
        for (program, text) in both.iter().zip(texts) {
            program.write(&mut set, &stamped(Language::Krl, text, &made)?)?;
        }
        set.finish()?;
        points.left.iter().for_each(|left| out.finding(left.clone()));
        report(out, args, &corrected.moved, points.left.len())?;
        Ok(Outcome::Done)
    }

    /// A program whose points are in one file.
    fn one_file(&self, language: Language) -> Result<Outcome, Diagnostic> {
        let Self { args, robot, identified, out } = *self;
        let source = Program::open(&args.program)?;
        self.keeps(&[&source])?;
        let traced = source.traced()?;
        belongs(&traced, identified, out)?;
        let config = args.config.as_deref().map(Program::open).transpose()?;
        let unused = match language {
            Language::Urscript => config.is_some() || args.base.is_some(),
            _ => args.tool.is_some() || args.base.is_some(),
        };
        if unused {
            return Err(CompensationFinding::FrameUnused { language: language.name() }.into());
        }
        let text = source.text();
        let points = match language {
            Language::Urscript => urscript::read(text, args.tool)?,
            _ => rapid::read(text, config.as_ref().map(Program::text))?,
        };
        let corrected = points.compensate(text, robot, args.limit);
        let (corrected, moved) = corrected.map_err(|refused| self.refused(&source, &refused))?;
        let made = Provenance::of([&traced, identified]);
        let mut set = FileSet::begin(&args.out)?;
        source.write(&mut set, &stamped(language, &corrected, &made)?)?;
        set.finish()?;
        points.left.iter().for_each(|left| out.finding(left.clone()));
        report(out, args, &moved, points.left.len())?;
        Ok(Outcome::Done)
    }

    /// The program itself is not written over.
    fn keeps(&self, programs: &[&Program]) -> Result<(), Diagnostic> {
        let out = &self.args.out;
        if programs.iter().any(|program| files::same_place(&out.join(&program.stem), &program.path)) {
            let directory = out.display().to_string();
            return Err(Diagnostic::new(CompensationFinding::WouldOverwrite { directory }));
        }
        Ok(())
    }

    /// Names the points that cannot be corrected.
    fn refused(&self, source: &Program, points: &[Diagnostic]) -> Diagnostic {
        points.iter().for_each(|point| self.out.finding(point.clone()));
        Diagnostic::file(&source.name, CompensationFinding::PointsRefused { points: points.len() })
    }
}

/// A program is corrected once, and for its own robot.
fn belongs(program: &Traced, identified: &Traced, out: &Output) -> Result<(), Diagnostic> {
    if let Some(source) = program.provenance.corrected_by() {
        let before = ProvenanceFinding::CorrectedBefore { source: source.to_string() };
        return Err(Diagnostic::file(&program.artefact.name, before));
    }
    let Some(made_for) = program.robot() else { return Ok(()) };
    if made_for.differs(&identified.artefact).is_some() {
        return Err(program.of_another_robot(made_for, &identified.artefact).into());
    }
    if let Some(nominal) = identified.provenance.from.iter().find(|source| source.role == Role::Robot)
        && !identified.provenance.has(made_for)
    {
        let [artefact, made_for, given] = [&program.artefact, made_for, nominal].map(ToString::to_string);
        out.finding(ProvenanceFinding::RobotChanged { artefact, made_for, given });
    }
    Ok(())
}

/// That source and data of a module were written for one plan, where both name theirs.
fn of_one_plan(files: &[&Program], sources: &[Traced]) -> Result<(), Diagnostic> {
    let ([program, data], [of_program, of_data]) = (files, sources) else { return Ok(()) };
    let plan = |traced: &Traced| {
        let mut plans = traced.provenance.from.iter().rev();
        plans.find(|artefact| artefact.role == Role::Plan).map(|plan| plan.name.clone())
    };
    match plan(of_program).zip(plan(of_data)).filter(|(plan, data_plan)| plan != data_plan) {
        Some((plan, data_plan)) => {
            let data = data.name.clone();
            Err(Diagnostic::file(&program.name, ProgramFinding::OtherPlansData { data, plan, data_plan }))
        }
        None => Ok(()),
    }
}

fn report(out: &Output, args: &Args, moved: &[Moved], left: usize) -> Result<(), Diagnostic> {
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

/// A file of KRL. Comments may hold bytes of any old code page: then each byte is read as the
/// character of that number, and written back as it was.
struct Program {
    path: PathBuf,
    name: String,
    stem: String,
    sha256: String,
    content: String,
    bytewise: bool,
}

impl Program {
    fn open(path: &Path) -> Result<Self, Diagnostic> {
        let name = path.display().to_string();
        let bytes = fs::read(path).map_err(files::unreadable(&name))?;
        let sha256 = sha256(&bytes);
        let stem = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let (content, bytewise) = match String::from_utf8(bytes) {
            Ok(text) => (text, false),
            Err(error) => (error.into_bytes().into_iter().map(char::from).collect(), true),
        };
        Ok(Self { path: path.into(), name, stem, sha256, content, bytewise })
    }

    fn traced(&self) -> Result<Traced, Diagnostic> {
        let (name, sha256) = (self.stem.clone(), self.sha256.clone());
        let artefact = Artefact { role: Role::Program, name, serial: None, sha256 };
        Ok(Traced { artefact, provenance: provenance(&self.name, &self.content)? })
    }

    /// That it is not cut off, and of the module that `source` is named by.
    fn check(&self, begins: &str, source: &Self) -> Result<(), Diagnostic> {
        let words = |line: &str| -> Vec<String> {
            let words = line.split(|c: char| c.is_whitespace() || c == '(').filter(|word| !word.is_empty());
            words
                .filter(|word| !word.eq_ignore_ascii_case("GLOBAL"))
                .map(str::to_ascii_uppercase)
                .take(2)
                .collect()
        };
        let mut lines = self.content.lines().map(words);
        let Some(name) = lines.find(|words| words.first().is_some_and(|word| word == begins)) else {
            return Ok(());
        };
        let end = format!("END{}", begins.trim_start_matches("DEF"));
        if !lines.any(|words| words.first() == Some(&end)) {
            return Err(Diagnostic::file(&self.name, CompensationFinding::CutOff { end }));
        }
        let stem =
            source.stem.rsplit_once('.').map_or(source.stem.as_str(), |(stem, _)| stem).to_ascii_uppercase();
        match name.get(1).filter(|name| begins == "DEFDAT" && **name != stem) {
            Some(data) => {
                let (data, module) = (data.clone(), stem);
                Err(Diagnostic::file(&self.name, ProgramFinding::OtherDataName { data, module }))
            }
            None => Ok(()),
        }
    }

    fn text(&self) -> Text<'_> {
        Text { file: &self.name, text: &self.content }
    }

    fn write(&self, set: &mut FileSet, text: &str) -> Result<(), Diagnostic> {
        if self.bytewise {
            let bytes: Vec<u8> = text.chars().filter_map(|c| u8::try_from(c).ok()).collect();
            return set.write(&self.stem, bytes);
        }
        set.write(&self.stem, text)
    }
}

/// The file beside `path` with its stem and another extension, in any case.
fn beside(path: &Path, extension: &str) -> Option<PathBuf> {
    let wanted = path.with_extension(extension);
    let wanted = wanted.file_name()?.to_str()?;
    files::directory_of(path).read_dir().ok()?.find_map(|entry| {
        let entry = entry.ok()?;
        entry.file_name().to_str()?.eq_ignore_ascii_case(wanted).then(|| entry.path())
    })
}
