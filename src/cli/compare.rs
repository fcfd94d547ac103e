//! `dbbd compare`.

use dbbd_model::base::InternalFinding;
use dbbd_model::estimation::ResultFinding;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value as Json;

use super::catalogue::CliFinding;
use super::{CommandOutcome, CommandOutput, artefact, robots, value};
use dbbd_device::clock;
use dbbd_job::file_set::{EarlierFiles, FileSet};
use dbbd_job::files;
use dbbd_job::report::compare;
use dbbd_job::request::identify::ROBOT;
use dbbd_job::robot_files::{RobotName, robot_of_result};
use dbbd_model::base::date::{day_number, is_after};
use dbbd_model::base::serialised::{self, Seal};
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::conformity::{
    CircleFile, ComparedInput, ComparisonSubject, PositionChange, ResultComparison, ResultTimeline,
    SIGNIFICANCE_LEVEL, StoredResult, TrackedQuantity, compare_circles, compare_results, of_robot,
    same_robot, unlike_circles,
};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::diagnostic::Names;
use dbbd_model::math::straight_line::LevelCrossing;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, Identity, Provenance, TracedArtefact, one_robot};
use dbbd_model::robot::Robot;

/// Compare calibrations of a robot, or circular tests, over time.
///
/// Shows the change of each parameter or quantity with its uncertainty and significance (Holm correction over all of them),
/// how far the robot moved over the workspace and how much of it the uncertainties explain, overlaid circles, and a trend with
/// the time at which a tolerance is reached.
#[derive(clap::Args)]
pub(crate) struct CompareArgs {
    /// result.json of `dbbd identify` or circle.json of `dbbd circle`, or their directories, the oldest first.
    #[arg(required = true, num_args = 2.., value_name = "RESULT|CIRCLE")]
    inputs: Vec<PathBuf>,
    /// Directory for compare.json, compare.csv and compare.html. position_change_mm is the difference of the predictions of the first
    /// and the last result at the tool ball of the last (tool), after one best rigid alignment (whole), beside what both
    /// uncertainties let expect of a robot that did not change (expected: mean, p95, max, sd, and p, the probability of a mean as
    /// large as the one found). is_significant: p is below level.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The date YYYY-MM-DD of each result. Trends are then per day, else per result.
    #[arg(long, value_name = "DATE,..", value_delimiter = ',')]
    dates: Vec<String>,
    /// Tolerance, mm, of the change of position since the first result (95 % of the poses), or of the circular deviation.
    /// A significant trend is extrapolated to it.
    #[arg(long, value_name = "MM", value_parser = value::tolerance)]
    tolerance: Option<f64>,
    /// Robot with the axes and limits of the results [default: robot-identified.toml beside the first]. Positions are those of the
    /// robot-identified.toml beside the first and the last result.
    #[arg(long, value_name = "NAME|FILE|DIR")]
    robot: Option<RobotName>,
    /// Standard uncertainty of the repeatability of a circle's quantities from run to run, mm [default: 0].
    #[arg(long, value_name = "MM", value_parser = value::length_sd)]
    repeat_u: Option<f64>,
    /// Replace an earlier result in DIR [default: its files move to DIR/previous-1, DIR/previous-2 and so on].
    #[arg(long)]
    replace: bool,
}

/// The files that are looked for in a directory.
const KNOWN: [&str; 2] = ["result.json", "circle.json"];

/// A file whose kind is not known yet.
struct ComparedFile {
    path: PathBuf,
    name: String,
    text: String,
    json: Json,
}

pub(crate) fn run(args: &CompareArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    if let Some(date) = args.dates.iter().find(|date| is_after(date, clock::unix_ns())) {
        return Err(ConformityFinding::FutureDate { date: date.clone() }.into());
    }
    let documents: Vec<ComparedFile> =
        args.inputs.iter().map(|path| read_document(path)).collect::<Result<_, _>>()?;
    check_different(&documents)?;
    let sources: Vec<TracedArtefact> =
        documents.iter().map(|one| traced(one, out)).collect::<Result<_, _>>()?;
    one_robot(documents.iter().map(|one| one.name.clone()).zip(&sources))?;
    for ((date, document), source) in args.dates.iter().zip(&documents).zip(&sources) {
        out.findings_in(&document.name, other_date(date, &source.provenance.identity));
    }
    let timeline = if args.dates.is_empty() {
        ResultTimeline::numbered(documents.len())
    } else {
        ResultTimeline::dated(&args.dates, documents.len()).map_err(Diagnostic::from)?
    };
    let subject = subject(args, &documents, &sources, &timeline, out)?;
    let dates = args.dates.iter().cloned().map(Some).chain(std::iter::repeat(None));
    let input = |(document, date): (&ComparedFile, Option<String>)| ComparedInput {
        file: document.name.clone(),
        date,
    };
    let comparison = ResultComparison {
        schema: 1,
        inputs: documents.iter().zip(dates).map(input).collect(),
        level: SIGNIFICANCE_LEVEL,
        time_unit: timeline.unit,
        tolerance_mm: args.tolerance,
        subject,
    };
    let written =
        ComparisonDocument { comparison: &comparison, provenance: dbbd_job::artefact::made_from(&sources) };
    write_comparison(args, &written, &timeline)?;
    if let ComparisonSubject::Results(results) = &comparison.subject {
        if !results.not_compared.is_empty() {
            let parameters = Names::of(results.not_compared.iter().map(|parameter| parameter.name));
            out.finding(ConformityFinding::DifferentlyEstimated { parameters });
        }
        out.findings(warnings_of_results(&documents, &sources));
    }
    out.document(&written)?;
    comparison_lines(&comparison).into_iter().for_each(|line| out.result(line));
    out.result(format!("results in {}", args.out.display()));
    Ok(CommandOutcome::Done)
}

fn read_document(path: &Path) -> Result<ComparedFile, Diagnostic> {
    let mut path = path.to_path_buf();
    if path.is_dir() {
        let known = KNOWN.iter().map(|name| path.join(name)).find(|file| files::is_there(file));
        path = known.ok_or_else(|| Diagnostic::file(path.display(), ResultFinding::NoFileInDirectory))?;
    }
    let name = path.display().to_string();
    let text = files::read_text(&path)?;
    Seal::Json.check(&text).map_err(|finding| Diagnostic::file(&name, finding))?;
    let json = serde_json::from_str(&text).map_err(|error| {
        let finding = ResultFinding::NotJson { why: error.to_string() };
        Diagnostic::position(&name, &text, error.line(), error.column(), finding)
    })?;
    Ok(ComparedFile { path, name, text, json })
}

/// Refuses a result that is given twice.
fn check_different(documents: &[ComparedFile]) -> Result<(), Diagnostic> {
    for (at, document) in documents.iter().enumerate() {
        if let Some(first) = documents[..at].iter().find(|first| first.text == document.text) {
            let finding = ConformityFinding::Twice { first: first.name.clone() };
            return Err(Diagnostic::file(&document.name, finding));
        }
    }
    Ok(())
}

/// A finding if a date is not that of the measurement.
fn other_date(date: &str, identity: &Identity) -> Option<ConformityFinding> {
    /// A run may last over midnight, and time zones differ.
    const TOLERANCE_DAYS: f64 = 1.5;
    let measured = identity.day()?.to_owned();
    let apart_days = (day_number(date)? - day_number(&measured)?).abs();
    (apart_days > TOLERANCE_DAYS).then(|| ConformityFinding::OtherDate { date: date.into(), measured })
}

/// Why the difference of results may not be a change of the robot: a result has warnings itself, two rest on the same lengths, or they are not
/// in the order of time.
fn warnings_of_results(documents: &[ComparedFile], sources: &[TracedArtefact]) -> Vec<Diagnostic> {
    let mut findings = Vec::new();
    for (at, (document, source)) in documents.iter().zip(sources).enumerate() {
        let mut warn = |finding: Diagnostic| findings.push(finding.in_file(&document.name));
        let warnings = warning_codes(&document.json);
        if !warnings.is_empty() {
            let (robot, warnings) = (document.name.clone(), Names::of(warnings));
            warn(ProvenanceFinding::RobotWithWarnings { robot, warnings }.into());
        }
        let own = &source.provenance;
        for (first, before) in documents.iter().zip(sources).take(at) {
            let known: Vec<&Artefact> = before.provenance.measured().collect();
            let same = own.measured().find(|one| known.iter().any(|other| other.sha256 == one.sha256));
            if let Some(lengths) = same.map(ToString::to_string) {
                warn(ProvenanceFinding::SameLengths { lengths, first: first.name.clone() }.into());
            }
        }
        let day = |source: &TracedArtefact| source.provenance.identity.day().map(str::to_owned);
        if let Some((before, now)) =
            at.checked_sub(1).and_then(|before| day(&sources[before])).zip(day(source))
            && day_number(&now) < day_number(&before)
        {
            warn(ConformityFinding::MeasuredBefore { measured: now, before }.into());
        }
    }
    findings
}

/// The codes of the warnings in a result.json.
fn warning_codes(result: &Json) -> Vec<String> {
    let warnings = result.get("findings").and_then(Json::as_array).into_iter().flatten();
    let warnings = warnings.filter(|warning| warning.get("severity").and_then(Json::as_str) != Some("info"));
    let code = |warning: &Json| warning.get("code").and_then(Json::as_str).map(str::to_owned);
    let mut codes: Vec<String> = warnings.filter_map(code).collect();
    codes.sort();
    codes.dedup();
    codes
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum ComparedKind {
    Result,
    Circle,
}

/// The kind of a file, by keys that no other kind has.
fn kind(document: &ComparedFile) -> Result<ComparedKind, Diagnostic> {
    let has = |key| document.json.get(key).is_some();
    match (has("parameters") && has("residual_mm"), has("radius_mm") && has("traces")) {
        (true, _) => Ok(ComparedKind::Result),
        (_, true) => Ok(ComparedKind::Circle),
        _ => Err(Diagnostic::file(&document.name, ResultFinding::NeitherResultNorCircle)),
    }
}

fn subject(
    args: &CompareArgs,
    documents: &[ComparedFile],
    sources: &[TracedArtefact],
    timeline: &ResultTimeline,
    out: &CommandOutput,
) -> Result<ComparisonSubject, Diagnostic> {
    let kinds: Vec<ComparedKind> = documents.iter().map(kind).collect::<Result<_, _>>()?;
    if let Some(other) = kinds.iter().position(|kind| *kind != kinds[0]) {
        let finding = ConformityFinding::OtherKind { first: documents[0].name.clone() };
        return Err(Diagnostic::file(&documents[other].name, finding));
    }
    let unused = match kinds[0] {
        ComparedKind::Circle => args.robot.as_ref().map(|_| "--robot"),
        ComparedKind::Result => args.repeat_u.map(|_| "--repeat-u"),
    };
    if let Some(option) = unused {
        return Err(CliFinding::Unused { option }.into());
    }
    if kinds[0] == ComparedKind::Circle {
        let files = documents.iter().map(|document| CircleFile::from_json(&document.name, &document.json));
        let files: Vec<CircleFile> = files.collect::<Result<_, _>>()?;
        out.findings(unlike_circles(&files));
        let circles = compare_circles(&files, timeline, args.tolerance, args.repeat_u.unwrap_or(0.0))?;
        return Ok(ComparisonSubject::Circles { circles });
    }
    let results = documents.iter().zip(sources).map(|(document, source)| stored(document, source));
    let results: Vec<StoredResult> = results.collect::<Result<_, _>>()?;
    same_robot(&results)?;
    let robot = robot(args, &documents[0], out)?;
    of_robot(&results, &robot.name)
        .map_err(|finding| Diagnostic::file(args.robot.as_deref().unwrap_or(ROBOT), finding))?;
    let compared = compare_results(&robot, &results, timeline, args.tolerance)?;
    // The position is compared between the first and the last.
    let ends = [results.first(), results.last()].into_iter().flatten();
    let without: Vec<&str> =
        ends.filter(|result| !result.has_robot()).map(|result| result.file.as_str()).collect();
    if !without.is_empty() {
        out.finding(ConformityFinding::PositionByParameters { results: Names::of(without) });
    }
    Ok(ComparisonSubject::Results(Box::new(compared)))
}

/// A result with its robot, as far as that is beside it.
fn stored(document: &ComparedFile, source: &TracedArtefact) -> Result<StoredResult, Diagnostic> {
    let result = StoredResult::from_json(&document.name, document.json.clone())?;
    Ok(match robot_of_result(&document.path, &source.provenance)? {
        Some(robot) => result.with_robot(robot),
        None => result,
    })
}

fn robot(args: &CompareArgs, first: &ComparedFile, out: &CommandOutput) -> Result<Robot, Diagnostic> {
    if let Some(name) = &args.robot {
        return robots::named(name, out);
    }
    let beside = first.path.with_file_name(ROBOT);
    if !beside.exists() {
        let finding = ConformityFinding::NoRobotBeside { looked_for: ROBOT.into() };
        return Err(Diagnostic::file(&first.name, finding));
    }
    robots::named(&beside.display().to_string().into(), out)
}

/// `compare.json`.
#[derive(Serialize)]
struct ComparisonDocument<'a> {
    #[serde(flatten)]
    comparison: &'a ResultComparison,
    provenance: Provenance,
}

/// A result with its chain.
fn traced(document: &ComparedFile, out: &CommandOutput) -> Result<TracedArtefact, Diagnostic> {
    match artefact::read_traced(&document.path, out)? {
        Some(traced) => Ok(traced),
        None => dbbd_job::artefact::of_file(ArtefactRole::Result, &document.path).map(TracedArtefact::from),
    }
}

fn write_comparison(
    args: &CompareArgs,
    written: &ComparisonDocument<'_>,
    timeline: &ResultTimeline,
) -> Result<(), Diagnostic> {
    let ComparisonDocument { comparison, provenance } = written;
    let mut set = FileSet::begin(&args.out, EarlierFiles::kept_unless(args.replace))?;
    set.write("compare.json", serialised::sealed_json(written)?)?;
    set.write("compare.csv", csv(comparison)?)?;
    set.write("compare.html", compare::html(comparison, timeline, provenance)?)?;
    set.finish().map(drop)
}

/// One row per quantity: family and name, value and deviation of each input, change and trend.
fn csv(comparison: &ResultComparison) -> Result<String, InternalFinding> {
    let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let mut columns = owned(&["family", "name", "unit"]);
    columns.extend((1..=comparison.inputs.len()).flat_map(|at| [format!("value_{at}"), format!("sd_{at}")]));
    columns.extend(owned(&["change", "change_sd", "p", "p_holm", "significant", "slope", "slope_sd"]));
    serialised::csv_table(columns, rows(comparison))
}

/// The rows of the table. The quantities of a family are tested together.
fn rows(comparison: &ResultComparison) -> Vec<Vec<String>> {
    fn rows<N: std::fmt::Display>(family: &str, tracked: &[TrackedQuantity<N>]) -> Vec<Vec<String>> {
        let row = |tracked: &TrackedQuantity<N>| {
            let mut row = vec![family.to_owned(), tracked.name.to_string(), tracked.unit.to_owned()];
            row.extend(
                tracked.values.iter().flat_map(|value| [value.value, value.sd].map(|x| x.to_string())),
            );
            let change = tracked.change;
            row.extend([change.change, change.sd, change.p, change.p_holm].map(|x| x.to_string()));
            row.push(change.significant.to_string());
            let line = tracked.trend.map(|trend| trend.line);
            row.extend(line.map_or([String::new(), String::new()], |line| {
                [line.slope, line.slope_sd].map(|x| x.to_string())
            }));
            row
        };
        tracked.iter().map(row).collect()
    }
    match &comparison.subject {
        ComparisonSubject::Results(results) => {
            [rows("robot", &results.parameters), rows("set-up", &results.set_up)].concat()
        }
        ComparisonSubject::Circles { circles } => {
            let name = |circle: Option<u32>| circle.map_or("circle".into(), |at| format!("circle {at}"));
            circles.iter().flat_map(|circle| rows(&name(circle.circle), &circle.quantities)).collect()
        }
    }
}

/// The comparison on the terminal.
fn comparison_lines(comparison: &ResultComparison) -> Vec<String> {
    let word = comparison.time_unit.word();
    let mut lines = Vec::new();
    let reached = |reached: Option<LevelCrossing>| {
        reached.map(|LevelCrossing { at, earliest, latest, .. }| {
            let latest = latest.map_or("never".into(), |latest| format!("{latest:.1}"));
            format!("tolerance reached {at:.1} {word}s after the first (95 %: {earliest:.1} to {latest})")
        })
    };
    match &comparison.subject {
        ComparisonSubject::Results(results) => {
            let position = &results.position_change_mm;
            lines.push(format!("{}: {} results", results.robot, comparison.inputs.len()));
            lines.push(moved(position));
            let own = results.predicted_position_uncertainty_mm.iter();
            let own: Vec<String> = own.map(|summary| format!("{:.3}", summary.mean)).collect();
            lines.push(format!("predicted position uncertainty of the results: {} mm", own.join(", ")));
            lines.extend(significant(&results.parameters));
            if let Some(drift) = position.drift {
                lines.push(format!("drift {:.2e} mm per {word} (95 % of the poses)", drift.slope));
            }
            lines.extend(reached(position.reaches_tolerance));
        }
        ComparisonSubject::Circles { circles } => {
            for circle in circles {
                let number = circle.circle.map_or(String::new(), |number| format!(" {number}"));
                lines.push(format!("circle{number}, radius {} mm", circle.radius_mm));
                lines.extend(significant(&circle.quantities));
                lines.extend(reached(circle.reaches_tolerance));
            }
        }
    }
    lines
}

/// How far the robot moved, and how much of it its uncertainty explains.
fn moved(position: &PositionChange) -> String {
    let (mean, of) = (position.whole.mean, &position.tool.of);
    let at = format!("mean over the workspace, at the tool ball of {of}");
    match position.expected.zip(position.is_significant) {
        Some((expected, true)) => format!(
            "the robot moved by {mean:.3} mm ({at}; {:.3} mm expected from the uncertainty alone: significant, p {:.1e})",
            expected.summary.mean, expected.p
        ),
        Some((expected, false)) => format!(
            "the predictions differ by {mean:.3} mm ({at}; {:.3} mm expected from the uncertainty alone: not significant)",
            expected.summary.mean
        ),
        None => format!("by the parameters alone the positions differ by {mean:.3} mm ({at})"),
    }
}

fn significant<N: std::fmt::Display>(tracked: &[TrackedQuantity<N>]) -> Vec<String> {
    let changed: Vec<String> = tracked
        .iter()
        .filter(|tracked| tracked.change.significant)
        .map(|tracked| {
            let change = tracked.change;
            let (name, unit) = (&tracked.name, tracked.unit);
            format!("  {name} {:+.3e} {unit} (u {:.1e}, p {:.1e})", change.change, change.sd, change.p_holm)
        })
        .collect();
    if changed.is_empty() {
        return vec![format!("  none of {} changed significantly", tracked.len())];
    }
    changed
}
