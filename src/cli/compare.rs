//! `dbbd compare`.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value as Json;

use super::{Outcome, Output, length_sd, tolerance};
use super::{artefact, robots};
use crate::base::date::{day_number, is_after};
use crate::base::{FileSet, clock, files, serialised};
use crate::catalogue::{CliFinding, ConformityFinding, Names, ProvenanceFinding};
use crate::conformity::{
    CircleFile, Comparison, Input, LEVEL, ResultRead, Subject, Timeline, Tracked, compare_circles,
    compare_results, of_robot, same_robot, unlike_circles,
};
use crate::diagnostic::Diagnostic;
use crate::provenance::{Artefact, Identity, Provenance, Role, Traced, one_robot};
use crate::report::compare;
use crate::robot::Robot;

/// Compare calibrations of a robot, or circular tests, in the order of time.
///
/// Parameters or quantities with their change, its uncertainty and significance (Holm over all of them), the change of
/// position over the workspace as a map, circles overlaid, and a trend with the time at which a tolerance is reached.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// result.json of `dbbd identify` or circle.json of `dbbd circle`, or their directories, oldest first.
    #[arg(required = true, num_args = 2.., value_name = "RESULT|CIRCLE")]
    inputs: Vec<PathBuf>,
    /// Directory for compare.json, compare.csv and compare.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The date YYYY-MM-DD of each result: trends are then per day, else per result.
    #[arg(long, value_name = "DATE,..", value_delimiter = ',')]
    dates: Vec<String>,
    /// Tolerance, mm: of the change of position since the first result (95 % of the poses), or of the circular
    /// deviation. Forecasts when a significant trend reaches it.
    #[arg(long, value_name = "MM", value_parser = tolerance)]
    tolerance: Option<f64>,
    /// Robot with the axes and limits of the results [default: robot-identified.toml beside the first].
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// Standard uncertainty by which a quantity of a circle repeats from run to run, mm [default: 0].
    #[arg(long, value_name = "MM", value_parser = length_sd)]
    repeat_u: Option<f64>,
}

/// The files that a directory is looked through for.
const KNOWN: [&str; 2] = ["result.json", "circle.json"];
const ROBOT: &str = "robot-identified.toml";

/// A file before its kind is known.
struct Document {
    path: PathBuf,
    name: String,
    text: String,
    json: Json,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    if let Some(date) = args.dates.iter().find(|date| is_after(date, clock::unix_ns())) {
        return Err(ConformityFinding::FutureDate { date: date.clone() }.into());
    }
    let documents: Vec<Document> = args.inputs.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
    different(&documents)?;
    let sources: Vec<Traced> = documents.iter().map(|one| traced(one, out)).collect::<Result<_, _>>()?;
    one_robot(documents.iter().map(|one| one.name.clone()).zip(&sources))?;
    for ((date, document), source) in args.dates.iter().zip(&documents).zip(&sources) {
        let other = other_date(date, &source.provenance.identity);
        other.into_iter().for_each(|doubt| out.finding(Diagnostic::file(&document.name, doubt)));
    }
    let timeline = if args.dates.is_empty() {
        Timeline::numbered(documents.len())
    } else {
        Timeline::dated(&args.dates, documents.len()).map_err(Diagnostic::from)?
    };
    let subject = subject(args, &documents, &timeline, out)?;
    let dates = args.dates.iter().cloned().map(Some).chain(std::iter::repeat(None));
    let input = |(document, date): (&Document, Option<String>)| Input { file: document.name.clone(), date };
    let comparison = Comparison {
        schema: 1,
        inputs: documents.iter().zip(dates).map(input).collect(),
        level: LEVEL,
        time_unit: timeline.unit,
        tolerance_mm: args.tolerance,
        subject,
    };
    let made = Made { comparison: &comparison, provenance: Provenance::of(&sources) };
    write(args, &made, &timeline)?;
    if let Subject::Results(results) = &comparison.subject
        && !results.not_compared.is_empty()
    {
        let parameters = Names::of(results.not_compared.iter().map(|parameter| parameter.name));
        out.finding(ConformityFinding::DifferentlyEstimated { parameters });
    }
    if let Subject::Results(_) = &comparison.subject {
        of_results(&documents, &sources).into_iter().for_each(|doubt| out.finding(doubt));
    }
    out.document(&made)?;
    lines(&comparison).into_iter().for_each(|line| out.result(line));
    out.result(format!("results in {}", args.out.display()));
    Ok(Outcome::Done)
}

fn read(path: &Path) -> Result<Document, Diagnostic> {
    let mut path = path.to_path_buf();
    if path.is_dir() {
        let found = KNOWN.iter().map(|name| path.join(name)).find(|file| file.exists());
        let name = path.display().to_string();
        path = found.ok_or_else(|| Diagnostic::file(&name, ConformityFinding::NoFileInDirectory))?;
    }
    let name = path.display().to_string();
    let text = files::read(&path)?;
    serialised::check_seal(&text).map_err(|finding| Diagnostic::file(&name, finding))?;
    let json = serde_json::from_str(&text).map_err(|error| {
        let finding = ConformityFinding::NotJson { why: error.to_string() };
        Diagnostic::position(&name, &text, error.line(), error.column(), finding)
    })?;
    Ok(Document { path, name, text, json })
}

/// That no result is given twice.
fn different(documents: &[Document]) -> Result<(), Diagnostic> {
    for (at, document) in documents.iter().enumerate() {
        if let Some(first) = documents[..at].iter().find(|first| first.text == document.text) {
            let finding = ConformityFinding::Twice { first: first.name.clone() };
            return Err(Diagnostic::file(&document.name, finding));
        }
    }
    Ok(())
}

/// That a date is not that of the measurement.
fn other_date(date: &str, identity: &Identity) -> Option<ConformityFinding> {
    /// A run over midnight, and zones of time.
    const ALIKE_DAYS: f64 = 1.5;
    let measured = identity.day()?.to_owned();
    let apart_days = (day_number(date)? - day_number(&measured)?).abs();
    (apart_days > ALIKE_DAYS).then(|| ConformityFinding::OtherDate { date: date.into(), measured })
}

/// What makes the difference of results doubtful: one that is doubtful itself, the same lengths in two, or an earlier one
/// behind a later one.
fn of_results(documents: &[Document], sources: &[Traced]) -> Vec<Diagnostic> {
    let mut found = Vec::new();
    for (at, (document, source)) in documents.iter().zip(sources).enumerate() {
        let mut doubt =
            |finding: Diagnostic| found.push(Diagnostic { file: document.name.clone(), ..finding });
        let doubts = doubts(&document.json);
        if !doubts.is_empty() {
            let (robot, doubts) = (document.name.clone(), Names::of(doubts));
            doubt(ProvenanceFinding::DoubtfulRobot { robot, doubts }.into());
        }
        let own = &source.provenance;
        for (first, before) in documents.iter().zip(sources).take(at) {
            let known: Vec<&Artefact> = before.provenance.measured().collect();
            let same = own.measured().find(|one| known.iter().any(|other| other.sha256 == one.sha256));
            if let Some(lengths) = same.map(ToString::to_string) {
                doubt(ProvenanceFinding::SameLengths { lengths, first: first.name.clone() }.into());
            }
        }
        let day = |source: &Traced| source.provenance.identity.day().map(str::to_owned);
        if let Some((before, now)) =
            at.checked_sub(1).and_then(|before| day(&sources[before])).zip(day(source))
            && day_number(&now) < day_number(&before)
        {
            doubt(ConformityFinding::MeasuredBefore { measured: now, before }.into());
        }
    }
    found
}

/// The codes of the doubts that a result has.
fn doubts(result: &Json) -> Vec<String> {
    let warnings = result.get("warnings").and_then(Json::as_array).into_iter().flatten();
    let doubtful = warnings.filter(|warning| warning.get("kind").and_then(Json::as_str) == Some("doubt"));
    let code = |warning: &Json| warning.get("code").and_then(Json::as_str).map(str::to_owned);
    let mut codes: Vec<String> = doubtful.filter_map(code).collect();
    codes.sort();
    codes.dedup();
    codes
}

/// The kind of a file by the keys that only it has.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Result,
    Circle,
}

fn kind(document: &Document) -> Result<Kind, Diagnostic> {
    let has = |key| document.json.get(key).is_some();
    match (has("parameters") && has("residual_mm"), has("radius_mm") && has("traces")) {
        (true, _) => Ok(Kind::Result),
        (_, true) => Ok(Kind::Circle),
        _ => Err(Diagnostic::file(&document.name, ConformityFinding::NeitherResultNorCircle)),
    }
}

fn subject(
    args: &Args,
    documents: &[Document],
    timeline: &Timeline,
    out: &Output,
) -> Result<Subject, Diagnostic> {
    let kinds: Vec<Kind> = documents.iter().map(kind).collect::<Result<_, _>>()?;
    if let Some(other) = kinds.iter().position(|kind| *kind != kinds[0]) {
        let finding = ConformityFinding::OtherKind { first: documents[0].name.clone() };
        return Err(Diagnostic::file(&documents[other].name, finding));
    }
    let unused = match kinds[0] {
        Kind::Circle => args.robot.as_ref().map(|_| "--robot"),
        Kind::Result => args.repeat_u.map(|_| "--repeat-u"),
    };
    if let Some(option) = unused {
        return Err(ConformityFinding::Unused { option }.into());
    }
    if kinds[0] == Kind::Circle {
        let files = documents.iter().map(|document| CircleFile::from_json(&document.name, &document.json));
        let files: Vec<CircleFile> = files.collect::<Result<_, _>>()?;
        out.about(&unlike_circles(&files));
        let circles = compare_circles(&files, timeline, args.tolerance, args.repeat_u.unwrap_or(0.0))?;
        return Ok(Subject::Circles { circles });
    }
    let read = |document: &Document| ResultRead::from_json(&document.name, document.json.clone());
    let results: Vec<ResultRead> = documents.iter().map(read).collect::<Result<_, _>>()?;
    same_robot(&results)?;
    let robot = robot(args, &documents[0], out)?;
    of_robot(&results, &robot.name)
        .map_err(|finding| Diagnostic::file(args.robot.as_deref().unwrap_or(ROBOT), finding))?;
    Ok(Subject::Results(Box::new(compare_results(&robot, &results, timeline, args.tolerance)?)))
}

fn robot(args: &Args, first: &Document, out: &Output) -> Result<Robot, Diagnostic> {
    if let Some(name) = &args.robot {
        return robots::named(name, out);
    }
    let beside = first.path.with_file_name(ROBOT);
    if !beside.exists() {
        let finding = ConformityFinding::NoRobotBeside { looked_for: ROBOT.into() };
        return Err(Diagnostic::file(&first.name, finding).help("give --robot NAME|FILE"));
    }
    robots::named(&beside.display().to_string(), out)
}

/// `compare.json`.
#[derive(Serialize)]
struct Made<'a> {
    #[serde(flatten)]
    comparison: &'a Comparison,
    provenance: Provenance,
}

/// A result with what it was made from.
fn traced(document: &Document, out: &Output) -> Result<Traced, Diagnostic> {
    match artefact::read(&document.path, out)? {
        Some(traced) => Ok(traced),
        None => Artefact::file(Role::Result, &document.path).map(Traced::from),
    }
}

fn write(args: &Args, made: &Made<'_>, timeline: &Timeline) -> Result<(), Diagnostic> {
    let Made { comparison, provenance } = made;
    let mut set = FileSet::begin(&args.out)?;
    set.write("compare.json", serialised::sealed_json(made)?)?;
    let table = csv(comparison).map_err(|error| CliFinding::NoOutput { why: error.to_string() })?;
    set.write("compare.csv", table)?;
    set.write("compare.html", compare::html(comparison, timeline, provenance)?)?;
    set.finish()
}

/// A row a quantity: what it belongs to, its values and deviations in the order of time, change and trend.
fn csv(comparison: &Comparison) -> Result<Vec<u8>, ::csv::Error> {
    let mut table = ::csv::Writer::from_writer(Vec::new());
    let mut header: Vec<String> = ["family", "name", "unit"].map(str::to_owned).into();
    header.extend((1..=comparison.inputs.len()).flat_map(|at| [format!("value_{at}"), format!("sd_{at}")]));
    header.extend(
        ["change", "change_sd", "p", "p_holm", "significant", "slope", "slope_sd"].map(str::to_owned),
    );
    table.write_record(&header)?;
    for (family, rows) in families(comparison) {
        for row in rows {
            let mut record = vec![family.clone()];
            record.extend(row);
            table.write_record(&record)?;
        }
    }
    table.into_inner().map_err(|error| error.into_error().into())
}

/// The families that are tested together, with the cells of their rows.
fn families(comparison: &Comparison) -> Vec<(String, Vec<Vec<String>>)> {
    fn cells<N: std::fmt::Display>(tracked: &[Tracked<N>]) -> Vec<Vec<String>> {
        let row = |tracked: &Tracked<N>| {
            let mut row = vec![tracked.name.to_string(), tracked.unit.to_owned()];
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
        Subject::Results(results) => {
            vec![("robot".into(), cells(&results.parameters)), ("set-up".into(), cells(&results.set_up))]
        }
        Subject::Circles { circles } => {
            let name = |circle: Option<u32>| circle.map_or("circle".into(), |at| format!("circle {at}"));
            circles.iter().map(|circle| (name(circle.circle), cells(&circle.quantities))).collect()
        }
    }
}

/// The comparison on the terminal.
fn lines(comparison: &Comparison) -> Vec<String> {
    let word = comparison.time_unit.word();
    let mut lines = Vec::new();
    let reached = |when: &Option<crate::math::straight_line::Reached>| {
        when.map(|when| {
            let latest = when.latest.map_or("never".into(), |latest| format!("{latest:.1}"));
            let (at, earliest) = (when.at, when.earliest);
            format!("tolerance reached {at:.1} {word}s after the first (95 %: {earliest:.1} to {latest})")
        })
    };
    match &comparison.subject {
        Subject::Results(results) => {
            let position = &results.position_change_mm;
            let (mean, p95) = (position.whole.mean, position.whole.p95);
            lines.push(format!("{}: {} results", results.robot, comparison.inputs.len()));
            lines.push(format!(
                "position changed by {mean:.4} mm in the mean, 95 % of the poses by {p95:.4} mm"
            ));
            lines.extend(significant(&results.parameters));
            if let Some(drift) = position.drift {
                lines.push(format!("drift {:.2e} mm per {word} (95 % of the poses)", drift.slope));
            }
            lines.extend(reached(&position.reaches_tolerance));
        }
        Subject::Circles { circles } => {
            for circle in circles {
                let number = circle.circle.map_or(String::new(), |number| format!(" {number}"));
                lines.push(format!("circle{number}, radius {} mm", circle.radius_mm));
                lines.extend(significant(&circle.quantities));
                lines.extend(reached(&circle.reaches_tolerance));
            }
        }
    }
    lines
}

fn significant<N: std::fmt::Display>(tracked: &[Tracked<N>]) -> Vec<String> {
    let changed: Vec<String> = tracked
        .iter()
        .filter(|tracked| tracked.change.significant)
        .map(|tracked| {
            let change = tracked.change;
            let (name, unit) = (&tracked.name, tracked.unit);
            format!("  {name} {:+.3e} +- {:.1e} {unit} (p {:.1e})", change.change, change.sd, change.p_holm)
        })
        .collect();
    if changed.is_empty() {
        return vec![format!("  none of {} changed significantly", tracked.len())];
    }
    changed
}
