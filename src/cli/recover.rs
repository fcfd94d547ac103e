//! `dbbd recover`.

use std::path::PathBuf;

use serde_json::json;

use super::{Outcome, Output, Verdict, info};
use crate::capture::Writer;

/// Arguments of the verb.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The damaged capture; it is not changed.
    run: PathBuf,
    /// The capture to write, with every whole record of the other.
    #[arg(long, value_name = "RUN2")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let capture = info::open(&args.run)?;
    if capture.records.is_empty() {
        return Err(format!("{}: no whole record is left", args.run.display()).into());
    }
    let mut writer = Writer::create(&args.out)?;
    for stamped in &capture.records {
        writer.write(stamped.host, &stamped.record)?;
    }
    writer.sync()?;
    info::warn_of_damages(&capture, out);
    let lost: u64 = capture.damages.iter().map(|damage| damage.bytes).sum();
    out.document(&json!({
        "records": capture.records.len(),
        "samples": writer.samples(),
        "damages": capture.damages.len(),
        "lost_bytes": lost,
    }))?;
    out.result(format!(
        "{}: {} records ({} samples); {lost} bytes in {} damages are lost",
        args.out.display(),
        capture.records.len(),
        writer.samples(),
        capture.damages.len()
    ));
    Ok(if capture.damages.is_empty() { Outcome::Done } else { Outcome::Doubt })
}
