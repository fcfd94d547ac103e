//! `dbbd export`.

use std::path::PathBuf;

use serde_json::json;

use super::{Outcome, Output, Verdict, files, info};
use crate::capture::{Capture, Record};
use crate::protocol::{Fault, Sample};

/// Arguments of the verb.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The capture.
    run: PathBuf,
    /// Directory for samples.csv, raw.csv, events.csv and faults.csv.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let capture = info::open(&args.run)?;
    files::directory(&args.out)?;
    let mut counts = serde_json::Map::new();
    for (name, rows) in [
        ("samples.csv", samples(&capture)?),
        ("raw.csv", raw(&capture)),
        ("events.csv", events(&capture)?),
        ("faults.csv", faults(&capture)?),
    ] {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in &rows {
            writer.write_record(row)?;
        }
        let path = args.out.join(name);
        files::write(&path, writer.into_inner()?)?;
        let count = rows.len().saturating_sub(1);
        out.result(format!("{}: {count} rows", path.display()));
        counts.insert(name.to_owned(), json!(count));
    }
    out.document(&counts)?;
    info::warn_of_damages(&capture, out);
    Ok(if capture.damages.is_empty() { Outcome::Done } else { Outcome::Doubt })
}

type Rows = Vec<Vec<String>>;

fn header(names: &str) -> Rows {
    vec![names.split(',').map(str::to_owned).collect()]
}

/// A float as the shortest text that reads back bit for bit; empty when there is none.
fn cell<T: ToString>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

fn samples(capture: &Capture) -> Result<Rows, serde_json::Error> {
    let mut rows = header("host_ns,sequence,ticks,reading_mm,trigger,valid,temperature_c,status,offset");
    for stamped in &capture.records {
        if let Record::Sample(json) = &stamped.record {
            let sample: Sample = serde_json::from_slice(json)?;
            rows.push(vec![
                stamped.host.0.to_string(),
                cell(sample.sequence),
                cell(sample.ticks.map(|ticks| ticks.0)),
                sample.reading_mm.to_string(),
                cell(sample.trigger.map(u8::from)),
                u8::from(sample.valid).to_string(),
                cell(sample.temperature_c),
                sample.status.to_string(),
                sample.offset.to_string(),
            ]);
        }
    }
    Ok(rows)
}

fn raw(capture: &Capture) -> Rows {
    let mut rows = header("host_ns,bytes_hex");
    for stamped in &capture.records {
        if let Record::Raw(bytes) = &stamped.record {
            let hex = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            rows.push(vec![stamped.host.0.to_string(), hex]);
        }
    }
    rows
}

fn events(capture: &Capture) -> Result<Rows, serde_json::Error> {
    let mut rows = header("host_ns,event,detail_json");
    for stamped in &capture.records {
        if let Record::Event(event) = &stamped.record {
            let mut value = serde_json::to_value(event)?;
            let name = value.as_object_mut().and_then(|object| object.remove("event"));
            let name = name.as_ref().and_then(|name| name.as_str()).unwrap_or_default().to_owned();
            rows.push(vec![stamped.host.0.to_string(), name, value.to_string()]);
        }
    }
    Ok(rows)
}

fn faults(capture: &Capture) -> Result<Rows, serde_json::Error> {
    let mut rows = header("host_ns,kind,word,offset,bytes");
    for stamped in &capture.records {
        if let Record::Fault(json) = &stamped.record {
            let fault: Fault = serde_json::from_slice(json)?;
            let word = match &fault.kind {
                crate::protocol::FaultKind::Reject(word) => word.clone(),
                _ => String::new(),
            };
            rows.push(vec![
                stamped.host.0.to_string(),
                info::word(&fault.kind).to_owned(),
                word,
                fault.offset.to_string(),
                fault.bytes.to_string(),
            ]);
        }
    }
    Ok(rows)
}
