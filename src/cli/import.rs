//! `dbbd import`.

use std::path::PathBuf;

use serde_json::json;

use super::{CommandOutcome, CommandOutput};
use dbbd_job::files;
use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEvent};
use dbbd_job::recording::import::ImportFinding;
use dbbd_job::recording::import::{TraceBar, TraceCounts, TraceFormat, TraceMapping, TraceReader, TraceRow};
use dbbd_job::recording::run::PlanFiles;
use dbbd_job::request::open_text;
use dbbd_model::base::table::TableReader;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;

/// The size of a record with lines of the trace, bytes.
const BLOCK: usize = 1 << 16;

/// A trace longer than this multiple of the plan's duration gives a warning: the lowest override is 1 %.
const MAX_DURATION_RATIO: f64 = 100.0;
/// A trace longer than this multiple of it is reported.
const LONG: f64 = 1.5;

/// Printed below the options.
const LAYOUT: &str = "Without --mapping, FILE has the columns t_s (s, or dates) and length_mm (between the ball centres, or \
the bar's reading); other columns are ignored. Delimiter, decimal mark and encoding are detected. A mapping describes other \
layouts: [file] delimiter decimal skip_lines header comment; [time] column date_column format unit = s|ms|us|ns|iso, or \
rate_hz; [length] column unit = mm|um|m|inch kind = distance|reading; [strobe], [valid] column threshold; [temperature] \
column. A column is a name, or a \
number from 1. examples/mapping.toml explains each key.";

/// Convert a trace that other software recorded into a capture.
///
/// Use it for an instrument that dbbd cannot read: time and length as text, recorded while the program of the plan ran. A
/// small mapping file describes the layout of the text.
#[derive(clap::Args)]
#[command(after_help = LAYOUT)]
pub(crate) struct ImportArgs {
    /// The trace: text with one reading per line.
    file: PathBuf,
    /// Plan that the robot executed; it and the plan.json beside it are copied into the capture.
    #[arg(long, value_name = "PLAN.csv")]
    plan: PathBuf,
    /// Layout of the trace [default: a CSV t_s,length_mm].
    #[arg(long, value_name = "MAP.toml")]
    mapping: Option<PathBuf>,
    /// Capture to write; an existing file is not overwritten.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
}

pub(crate) fn run(args: &ImportArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let name = args.file.display().to_string();
    let map_text = args.mapping.as_deref().map(files::read_text).transpose()?.unwrap_or_default();
    let map_name = args.mapping.as_ref().map_or_else(String::new, |path| path.display().to_string());
    let mapping = TraceMapping::from_toml(&map_name, &map_text)?;
    let files = PlanFiles::read(&args.plan)?;
    let bar = &files.plan.header.job.bar;
    let bar = TraceBar { length_mm: bar.length_mm, stroke_mm: bar.stroke_mm };
    let format = TraceFormat::detect(&mut table(args, &mapping, out)?, &mapping, bar.length_mm)?;
    let trace = || table(args, &mapping, out).map(|table| TraceReader::new(table, &mapping, &format, bar));
    // A first pass checks every line, so that a wrong one leaves no capture behind.
    let (counts, findings) = rows(trace()?, |_| Ok(()))?;
    out.findings(findings);
    let TraceCounts { samples, invalid, missing, unix_ns, .. } = counts;
    if let Some([low_mm, high_mm]) = counts.range_mm.filter(|_| invalid == samples) {
        let invalid = ImportFinding::AllInvalid { readings: samples, low_mm, high_mm };
        return Err(Diagnostic::file(&name, invalid));
    }
    let mut writer = CaptureWriter::create(&args.out)?;
    let begin = HostNs(0);
    let version = dbbd_job::artefact::VERSION.to_owned();
    writer.write(begin, &CaptureRecord::Event(RunEvent::Started { unix_ns, version }))?;
    let (planned_s, least_s) = (files.plan.duration_s(), files.plan.least_duration_s());
    let dwell_s = files.plan.header.job.motion.dwell_s;
    for (name, content) in files.attachments().into_iter().chain([("mapping.toml", map_text)]) {
        let record = CaptureRecord::Attachment { name: name.into(), content: content.into_bytes() };
        writer.write(begin, &record)?;
    }
    writer.write(begin, &CaptureRecord::Event(RunEvent::Mark { text: format!("imported from {name}") }))?;
    let mut last = begin;
    let mut block = ImportBlock::default();
    rows(trace()?, |read| {
        last = read.sample.map_or(last, |(host, _)| host);
        block.text.extend(read.text.into_bytes());
        block.samples.extend(read.sample);
        if block.text.len() >= BLOCK { block.write(&mut writer, last) } else { Ok(()) }
    })?;
    block.write(&mut writer, last)?;
    writer.finish(last, "the end of the file that was imported", 0)?;
    let seconds = last.seconds_since(begin);
    if invalid > missing {
        out.finding(Diagnostic::file(&name, ImportFinding::NotValid { readings: invalid - missing }));
    }
    if !(least_s..=MAX_DURATION_RATIO * planned_s).contains(&seconds) {
        out.finding(Diagnostic::file(&name, ImportFinding::Duration { seconds, planned_s }));
    } else if seconds > LONG * planned_s {
        let times = seconds / planned_s;
        out.finding(Diagnostic::file(&name, ImportFinding::Longer { seconds, times }));
    }
    out.findings_in(&name, counts.findings(seconds, dwell_s));
    out.document(
        &json!({ "samples": samples, "invalid": invalid, "no_reading": missing, "seconds": seconds }),
    )?;
    out.result(format!("{}: {samples} samples over {seconds:.1} s", args.out.display()));
    Ok(CommandOutcome::Done)
}

fn table<'a>(
    args: &ImportArgs,
    mapping: &TraceMapping,
    out: &CommandOutput,
) -> Result<TableReader<'a>, Diagnostic> {
    TableReader::new(&args.file.display().to_string(), open_text(&args.file, out)?, mapping.layout())
}

/// Calls `each` with every row and its text.
fn rows(
    mut trace: TraceReader<'_>,
    mut each: impl FnMut(TraceRow) -> Result<(), Diagnostic>,
) -> Result<(TraceCounts, Vec<Diagnostic>), Diagnostic> {
    loop {
        let read = trace.row()?;
        let last = read.sample.is_none();
        each(read)?;
        if last {
            return trace.finish();
        }
    }
}

/// Lines and samples that are not written yet.
#[derive(Default)]
struct ImportBlock {
    text: Vec<u8>,
    samples: Vec<(HostNs, Sample)>,
}

impl ImportBlock {
    /// Writes the text and then its samples. A text without a sample is stamped with `otherwise`.
    fn write(&mut self, writer: &mut CaptureWriter, otherwise: HostNs) -> Result<(), Diagnostic> {
        let host = self.samples.first().map_or(otherwise, |(host, _)| *host);
        writer.write(host, &CaptureRecord::Raw(std::mem::take(&mut self.text)))?;
        for (host, sample) in self.samples.drain(..) {
            writer.write(host, &CaptureRecord::Samples(vec![sample]))?;
        }
        Ok(())
    }
}
