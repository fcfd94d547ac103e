//! The commands of `dbbd archive`.

use dbbd_model::base::InternalFinding;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;
use serde_json::json;

use super::work::{WorkerEnd, compare, report_failures, work, worker};
use super::{ArchiveArgs, ArchiveVerb, RunChoice, TableFormat};
use crate::cli::serve::LogLines;
use crate::cli::{CommandOutcome, CommandOutput, artefact};
use crate::daemon::{Endpoint, serve_plant};
use dbbd_device::clock;
use dbbd_job::artefact::VERSION;
use dbbd_job::files;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::Provenance;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_plant::ArchiveFinding;
use dbbd_plant::{
    Archive, ArchiveAddresses, ArchivedFile, ArchivedResult, ArchivedRun, ColumnKind, IdentifySettings,
    LocalRun, PlantOptions, PlantPages, PushOutcome, RunJob, RunSelection, Secrets, Spool, StoreDamage,
    parquet,
};

/// The first bytes of a Parquet file.
const PARQUET: &str = "PAR1";

pub(super) fn run(args: &ArchiveArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let environment = |name| std::env::var(name).ok();
    let archive = args.archive.clone().or_else(|| environment("DBBD_ARCHIVE"));
    let store = args.store.clone().or_else(|| environment("DBBD_STORE"));
    let addresses = ArchiveAddresses::read(archive.as_deref(), store.as_deref(), &Secrets::of_environment())?;
    match &args.what {
        ArchiveVerb::Init => init(&addresses, out),
        ArchiveVerb::Push { runs, spool } => push(&addresses, runs, spool.as_deref(), out),
        ArchiveVerb::List(choice) => list_archived_runs(&mut Archive::open(&addresses)?, choice, out),
        ArchiveVerb::Show { run } => show_run(&mut Archive::open(&addresses)?, run, out),
        ArchiveVerb::Worker { until_empty, lease } => {
            let until = if *until_empty { WorkerEnd::Empty } else { WorkerEnd::Stopped };
            let mut archive = Archive::open_whole(&addresses)?;
            let [done, failed] = work(&mut archive, &worker(*lease), until, out)?;
            report_failures(archive.queue()?.failed, out);
            out.document(&json!({ "done": done, "failed": failed }))?;
            out.result(format!("{done} runs identified, {failed} not"));
            Ok(CommandOutcome::Done)
        }
        ArchiveVerb::Reprocess { choice, estimate, hold, prior, model, ask_only } => {
            let options = [("estimate", estimate), ("hold", hold), ("model", model), ("prior", prior)];
            let settings = IdentifySettings::new(&options.map(|(name, value)| (name, value.as_deref())))?;
            let mut archive = Archive::open_whole(&addresses)?;
            let selection = choice.select(&mut archive, out)?;
            reprocess(&mut archive, &selection, &settings, *ask_only, out)
        }
        ArchiveVerb::Fleet { choice, out: directory } => {
            let mut archive = Archive::open(&addresses)?;
            let selection = choice.select(&mut archive, out)?;
            super::fleet::run(&mut archive, &selection, directory, out)
        }
        ArchiveVerb::Export { choice, format, out: directory } => {
            let mut archive = Archive::open(&addresses)?;
            let selection = choice.select(&mut archive, out)?;
            export(&mut archive, &selection, *format, directory, out)
        }
        ArchiveVerb::Serve { listen, token_file, host, interval, limit } => {
            let endpoint = Endpoint::new(listen, token_file.as_deref(), host)?;
            let options = PlantOptions { interval_days: *interval, limit_mm: *limit };
            let pages = PlantPages::open(addresses, options)?;
            serve_plant(endpoint, Arc::new(LogLines { out: out.clone() }), Arc::new(pages))?;
            Ok(CommandOutcome::Done)
        }
        ArchiveVerb::Get { run, out: directory } => get(&mut Archive::open(&addresses)?, run, directory, out),
    }
}

fn init(addresses: &ArchiveAddresses, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let steps = Archive::init(addresses)?;
    out.document(&json!({ "steps": steps }))?;
    out.result(if steps == 0 { "nothing to do".into() } else { format!("{steps} steps made") });
    Ok(CommandOutcome::Done)
}

/// The JSON document of `archive push`: hashes of runs.
#[derive(Default, Serialize)]
struct PushDocument {
    new: Vec<String>,
    held: Vec<String>,
    waiting: Vec<String>,
}

fn push(
    addresses: &ArchiveAddresses,
    runs: &[PathBuf],
    spool: Option<&Path>,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    spool.map_or(Ok(()), |spool| addresses.check_spool(Path::new(""), spool))?;
    let paths: Vec<Vec<PathBuf>> = runs.iter().map(|run| LocalRun::find(run)).collect::<Result<_, _>>()?;
    let (mut sent, spool) = (PushDocument::default(), spool.map(Spool::open).transpose()?);
    let mut archive = Archive::open_whole(addresses);
    if let (Ok(archive), Some(spool)) = (&mut archive, &spool) {
        for path in spool.waiting()? {
            match read_run(&path, out).and_then(|run| send(archive, &run, &mut sent, out)) {
                Ok(()) => spool.remove(&path)?,
                Err(why) => out.finding(waits(&path.display().to_string(), &why)),
            }
        }
    }
    for path in paths.concat() {
        let run = read_run(&path, out)?;
        let done = match &mut archive {
            Ok(archive) => send(archive, &run, &mut sent, out),
            Err(why) => Err(why.clone()),
        };
        match (done, &spool) {
            (Ok(()), _) => {}
            (Err(why), Some(spool)) => {
                spool.add(&run)?;
                sent.waiting.push(run.sha256().into());
                out.finding(waits(run.sha256(), &why));
            }
            (Err(why), None) => return Err(why),
        }
    }
    if let (Err(why), Some(spool), true) = (&archive, &spool, paths.is_empty()) {
        out.finding(ArchiveFinding::SpoolWaits { runs: spool.waiting()?.len() });
        out.finding(waits("", why));
    }
    out.document(&sent)?;
    let [new, held, waiting] = [&sent.new, &sent.held, &sent.waiting].map(Vec::len);
    out.result(format!("{new} runs stored, {held} held already, {waiting} wait"));
    Ok(CommandOutcome::Done)
}

fn waits(run: &str, why: &Diagnostic) -> ArchiveFinding {
    ArchiveFinding::Spooled { run: run.into(), why: why.to_string() }
}

/// Reads a run, and reports what is damaged, missing or unknown in it.
fn read_run(path: &Path, out: &CommandOutput) -> Result<LocalRun, Diagnostic> {
    let run = LocalRun::read(path)?;
    out.findings(run.findings().iter().cloned());
    Ok(run)
}

fn send(
    archive: &mut Archive,
    run: &LocalRun,
    sent: &mut PushDocument,
    out: &CommandOutput,
) -> Result<(), Diagnostic> {
    let name = run.sha256().to_owned();
    match archive.push(run)? {
        PushOutcome::New => sent.new.push(name),
        PushOutcome::HeldAlready(StoreDamage { restored, lost }) => {
            let run = || name.clone();
            out.finding(ArchiveFinding::HeldAlready { run: run() });
            if restored > 0 {
                out.finding(ArchiveFinding::Restored { run: run(), objects: restored });
            }
            for file in lost {
                out.finding(ArchiveFinding::Lost { run: run(), file });
            }
            sent.held.push(name);
        }
    }
    Ok(())
}

impl RunChoice {
    /// The selection. Reports why it is empty.
    fn select(&self, archive: &mut Archive, out: &CommandOutput) -> Result<RunSelection, Diagnostic> {
        let selection = RunSelection {
            robot: self.robot.clone(),
            kind: self.kind.clone(),
            bar: self.bar.clone(),
            cell: self.cell.clone(),
            since: self.since.clone(),
            until: self.until.clone(),
            search: self.search.clone(),
            after: None,
            limit: self.limit,
        };
        selection.check(clock::unix_ns())?;
        out.findings(archive.nothing_of(&selection)?);
        Ok(selection)
    }
}

fn list_archived_runs(
    archive: &mut Archive,
    choice: &RunChoice,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let selection = choice.select(archive, out)?;
    let runs = archive.list(&selection)?;
    out.list(&runs)?;
    for run in &runs {
        let ArchivedRun { sha256, measured, cell, robot, bar, .. } = run;
        let digits = sha256.get(..12).unwrap_or(sha256);
        out.result(format!("{digits}  {measured:20}  {cell:12}  {robot:16}  {bar}"));
    }
    Ok(CommandOutcome::Done)
}

/// The JSON document of `archive show` and `archive get`.
#[derive(Serialize)]
struct RunDocument<'a> {
    #[serde(flatten)]
    run: &'a ArchivedRun,
    files: &'a [ArchivedFile],
    jobs: &'a [RunJob],
    provenance: Provenance,
}

fn show_run(archive: &mut Archive, digits: &str, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let run = archive.run(digits)?;
    let (files, jobs) = (archive.files(&run)?, archive.jobs(std::slice::from_ref(&run))?);
    let provenance: Provenance = serde_json::from_str(&run.provenance)
        .map_err(|error| ProvenanceFinding::Damaged { why: error.to_string() })?;
    out.document(&RunDocument { run: &run, files: &files, jobs: &jobs, provenance: provenance.clone() })?;
    out.field("run", &run.sha256);
    out.field("robot", format!("{} ({})", run.robot, run.kind));
    artefact::show_chain(&provenance, out);
    for file in &files {
        out.field("file", format!("{:32} {} bytes", file.name, file.bytes));
    }
    for RunJob { settings, state, code, message, .. } in &jobs {
        let why = [code.as_deref(), message.as_deref()].map(Option::unwrap_or_default).join(" ");
        out.field("job", format!("{settings} {state} {why}").trim_end());
    }
    Ok(CommandOutcome::Done)
}

fn reprocess(
    archive: &mut Archive,
    selection: &RunSelection,
    settings: &IdentifySettings,
    ask_only: bool,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let asked = archive.ask(selection, settings, VERSION)?;
    out.result(format!("{asked} runs to identify"));
    if ask_only {
        out.document(&json!({ "asked": asked }))?;
        return Ok(CommandOutcome::Done);
    }
    work(archive, &worker(None), WorkerEnd::Empty, out)?;
    compare(archive, selection, settings, out)
}

fn export(
    archive: &mut Archive,
    selection: &RunSelection,
    format: TableFormat,
    directory: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let (runs, mut results) = (archive.list(selection)?, archive.results(selection, None)?);
    results.iter_mut().for_each(|result| result.found.posterior = None);
    files::directory(directory)?;
    let tables = match format {
        TableFormat::Csv => {
            let [run_columns, result_columns] =
                [columns(&ArchivedRun::TABLE), columns(&ArchivedResult::TABLE)];
            let run_table = serialised::csv_table(&run_columns, &runs)?;
            let result_table = results_csv(&result_columns, &results)?;
            [
                ("runs.csv", run_columns.join(",") + "\n", run_table.into()),
                ("results.csv", result_columns.join(",") + "\n", result_table.into()),
            ]
        }
        TableFormat::Parquet => [
            ("runs.parquet", PARQUET.into(), parquet(&ArchivedRun::TABLE, &runs)?),
            ("results.parquet", PARQUET.into(), parquet(&ArchivedResult::TABLE, &results)?),
        ],
    };
    for (name, head, _) in &tables {
        files::is_earlier(&directory.join(name), head.as_bytes())?;
    }
    for (name, _, content) in tables {
        files::write_file(&directory.join(name), content)?;
    }
    out.document(&json!({ "runs": runs.len(), "results": results.len() }))?;
    out.result(format!("{} runs and {} results in {}", runs.len(), results.len(), directory.display()));
    Ok(CommandOutcome::Done)
}

fn results_csv(columns: &[&str], results: &[ArchivedResult]) -> Result<String, InternalFinding> {
    let rows = results.iter().map(|one| {
        let summary = &one.found;
        let numbers = [
            summary.sigma_mm,
            summary.rms_before_mm,
            summary.rms_after_mm,
            summary.error_nominal_mm,
            summary.error_identified_mm,
        ];
        (
            &one.run,
            &one.robot,
            &one.measured,
            &one.settings,
            &one.version,
            summary.has_warnings,
            summary.lengths,
            numbers,
        )
    });
    serialised::csv_table(columns, rows)
}

fn columns<'a>(table: &[(&'a str, ColumnKind)]) -> Vec<&'a str> {
    table.iter().map(|(name, _)| *name).collect()
}

fn get(
    archive: &mut Archive,
    digits: &str,
    directory: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let run = archive.run(digits)?;
    let files = archive.fetch(&run, directory)?;
    out.document(&RunDocument { run: &run, files: &files, jobs: &[], provenance: Provenance::default() })?;
    out.result(format!("{} files in {}", files.len(), directory.display()));
    Ok(CommandOutcome::Done)
}
