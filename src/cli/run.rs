//! A capture as the verbs see it that need lengths at poses: its plan, its stream, joined.

use std::error::Error;
use std::path::Path;

use super::{Output, files, info};
use crate::capture::{Capture, Event, Record};
use crate::diag::Diagnostic;
use crate::plan::Plan;
use crate::protocol::{Definition, Sample};
use crate::sync::{DeviceClock, Report, Stream};

/// What a capture gives to be joined; lay it over in [`crate::sync::Input`].
pub(crate) struct Run {
    /// The plan: the one attached, unless another one was named. Its header holds the job with
    /// the base balls, and the robot.
    pub(crate) plan: Plan,
    /// The samples on one clock.
    pub(crate) stream: Stream,
    /// What the controller reported.
    pub(crate) reports: Vec<Report>,
    /// Whether something of the run was lost: a damage, a cut end, samples lost on the way to the disk.
    pub(crate) torn: bool,
}

/// Reads the capture at `path`; says its damages on stderr.
///
/// # Errors
/// When it is no capture, has no samples, or there is no plan for it.
pub(crate) fn open(path: &Path, plan: Option<&Path>, out: &Output) -> Result<Run, Box<dyn Error>> {
    let name = path.display().to_string();
    let capture = info::open(path)?;
    info::warn_of_damages(&capture, out);
    let plan = match plan {
        Some(csv) => {
            let json = csv.with_extension("json");
            let (csv_name, json_name) = (csv.display().to_string(), json.display().to_string());
            Plan::from_files(&csv_name, &files::read(csv)?, &json_name, &files::read(&json)?)?
        }
        None => match (attached(&capture, &name, "plan.csv")?, attached(&capture, &name, "plan.json")?) {
            (Some(csv), Some(json)) => {
                Plan::from_files(&format!("{name}: plan.csv"), &csv, &format!("{name}: plan.json"), &json)?
            }
            _ => {
                return Err(Diagnostic::file(&name, "carries no plan")
                    .help("name it: --plan PLAN.csv, with its .json beside it")
                    .into());
            }
        },
    };
    let clock = match attached(&capture, &name, "protocol.toml")? {
        Some(text) => Definition::from_toml(&format!("{name}: protocol.toml"), &text)?.clock,
        None => None,
    };
    let mut stream = Stream::new(clock.map(|clock| DeviceClock {
        seconds_per_tick: f64::from(clock.tick_ns) * 1e-9,
        wrap: 1u64.checked_shl(clock.wrap_bits),
    }));
    let mut reports = Vec::new();
    let (mut unreadable, mut lost, mut ended) = (0_u64, 0, false);
    for stamped in &capture.records {
        match &stamped.record {
            Record::Sample(json) => match serde_json::from_slice::<Sample>(json) {
                Ok(sample) => stream.push(stamped.host, &sample),
                Err(_) => unreadable += 1,
            },
            Record::Event(Event::Controller { index, phase, .. }) => {
                reports.push(Report { host: stamped.host, index: *index, phase: *phase });
            }
            Record::Event(Event::Ended { lost: on_the_way, .. }) => (ended, lost) = (true, *on_the_way),
            _ => {}
        }
    }
    if stream.is_empty() {
        return Err(Diagnostic::file(&name, "holds no sample: the bar said nothing").into());
    }
    if unreadable > 0 {
        out.warning(format!("{unreadable} samples cannot be read and are passed over"));
    }
    if lost > 0 {
        out.warning(format!("{lost} samples were lost on the way to the disk"));
    }
    if !ended {
        out.warning("the run was cut off: it has no record of its end");
    }
    let torn = !capture.damages.is_empty() || unreadable > 0 || lost > 0 || !ended;
    Ok(Run { plan, stream, reports, torn })
}

/// The text of an attachment, if it is there.
fn attached(capture: &Capture, run: &str, name: &str) -> Result<Option<String>, Diagnostic> {
    let text = capture.attachment(name).map(|content| String::from_utf8(content.to_vec()));
    text.transpose().map_err(|_| Diagnostic::file(&format!("{run}: {name}"), "is not UTF-8 text"))
}
