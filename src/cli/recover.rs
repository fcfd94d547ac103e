//! `dbbd recover`.

use std::path::PathBuf;

use serde_json::json;

use super::{Outcome, Output};
use crate::diagnostic::Diagnostic;
use crate::recording::capture::{Pass, Writer};

/// Restore every whole record of a damaged capture.
///
/// The damaged one is not changed. A capture that was merely cut off needs no repair: every verb reads it up to and
/// past a damage, and says so.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 nothing was lost; 3 something was, and what is said; 1 no whole record is left."
)]
pub(crate) struct Args {
    /// The damaged capture; it is not changed.
    run: PathBuf,
    /// The capture to write, with every whole record of the other.
    #[arg(long, value_name = "RUN2")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    // Nothing is made where there is nothing to write.
    let mut writer = None;
    let pass = Pass::over(&args.run, |stamped| {
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(Writer::create(&args.out)?),
        };
        writer.write(stamped.host, &stamped.record)
    })?;
    if let Some(writer) = &mut writer {
        writer.sync()?;
    }
    let name = args.run.display().to_string();
    pass.findings().into_iter().for_each(|doubt| out.finding(Diagnostic::file(&name, doubt)));
    let (records, samples, ended) = (pass.records, pass.samples, pass.end.is_some());
    let (lost_bytes, damages) = (pass.lost_bytes(), pass.damages.len());
    out.document(&json!({
        "records": records, "samples": samples, "damages": damages, "lost_bytes": lost_bytes, "ended": ended,
    }))?;
    out.result(format!(
        "{}: {records} records ({samples} samples); {lost_bytes} bytes in {damages} damages are lost",
        args.out.display(),
    ));
    Ok(Outcome::Done)
}
