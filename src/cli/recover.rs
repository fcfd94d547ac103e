//! `dbbd recover`.

use std::path::PathBuf;

use serde_json::json;

use super::{CommandOutcome, CommandOutput};
use dbbd_job::recording::capture::{CaptureSummary, CaptureWriter};
use dbbd_model::diagnostic::Diagnostic;

/// Copy every undamaged record of a damaged capture into a new capture.
///
/// A capture that was only cut off needs no repair: every command reads it up to and past a damage, and reports the damage.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 nothing was lost; 3 something was lost, and is reported; 1 no undamaged record is left."
)]
pub(crate) struct RecoverArgs {
    /// The damaged capture; it is not changed.
    run: PathBuf,
    /// Capture to write; an existing file is not overwritten.
    #[arg(long, value_name = "RUN2")]
    out: PathBuf,
}

pub(crate) fn run(args: &RecoverArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    // The file is created with the first record, so that nothing is left if there is none.
    let mut writer = None;
    let pass = CaptureSummary::over(&args.run, |stamped| {
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(CaptureWriter::create(&args.out)?),
        };
        writer.write(stamped.host, &stamped.record)
    })?;
    if let Some(writer) = &mut writer {
        writer.sync()?;
    }
    out.findings_in(args.run.display(), pass.findings());
    let (records, samples, ended) = (pass.records, pass.samples, pass.end.is_some());
    let (lost_bytes, damages) = (pass.lost_bytes(), pass.damages.len());
    out.document(&json!({
        "records": records, "samples": samples, "damages": damages, "lost_bytes": lost_bytes, "ended": ended,
    }))?;
    out.result(format!(
        "{}: {records} records ({samples} samples); {lost_bytes} bytes in {damages} damages are lost",
        args.out.display(),
    ));
    Ok(CommandOutcome::Done)
}
