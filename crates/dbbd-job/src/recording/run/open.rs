//! Opens a run.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::RecordedRun;
use super::plan_files::{attached_plan, attached_text, identity, read_plan};
use super::temperature::SampleTemperatures;
use crate::files;
use crate::plan::Plan;
use crate::program::krl;
use crate::recording::RecordingFinding;
use crate::recording::axes::AxisTrackBuilder;
use crate::recording::capture::{self, CaptureRecord, CaptureSummary, RunEvent, StampedRecord};
use crate::recording::matching::MeasuredAxes;
use crate::recording::reports::{DwellReport, reported_axes};
use crate::recording::stream::StreamBuilder;
use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::base::text::unreadable;
use dbbd_model::diagnostic::{Diagnostic, Severity};
use dbbd_model::provenance::Identity;

/// Whether the file at `path` is a capture, whatever its name.
pub fn is_capture(path: &Path) -> Result<bool, Diagnostic> {
    use std::io::Read as _;
    /// A record starts within this many bytes, even if the header and the first records are damaged.
    const GLIMPSE: u64 = 1 << 16;
    let mut first = Vec::new();
    let read = files::open(path)?.take(GLIMPSE).read_to_end(&mut first);
    read.map_err(unreadable(path.display()))?;
    Ok(capture::is_capture(&first))
}

/// Reads the capture at `path` and the axis angles logged in the `.dat` files `axes`. Damages and other findings
/// go to `report`.
pub fn open_run(
    path: &Path,
    plan: Option<&Path>,
    axes: &[PathBuf],
    report: &mut dyn FnMut(Diagnostic),
) -> Result<RecordedRun, Diagnostic> {
    let name = path.display().to_string();
    let mut report = |finding: Diagnostic| report(finding.in_file(&name));
    let mut gathered = GatheredCapture::default();
    let pass = CaptureSummary::over(path, |stamped| gathered.add(stamped, &name))?;
    let lacks = pass.all_findings();
    let mut has_warnings = !lacks.is_empty();
    lacks.into_iter().map(Diagnostic::from).for_each(&mut report);
    let GatheredCapture { attachments, stream, temperatures, reports, axes: track, started } = gathered;
    let track = track.build();
    let plan = match plan {
        Some(csv) => read_plan(csv)?,
        None => attached_plan(&name, &attachments)?
            .ok_or_else(|| Diagnostic::file(&name, RecordingFinding::NoPlan))?,
    };
    let stream = stream.map(StreamBuilder::build);
    let mut stream = stream.ok_or_else(|| Diagnostic::file(&name, RecordingFinding::NoSample))?;
    stream.limit_to(plan.header.job.bar.stroke_mm);
    let mut axes_deg = reported_axes(&reports);
    for path in axes {
        let data = read_data(path, &plan)?;
        let logged = krl::logged_axes(&data)?;
        if krl::absolute_accuracy(&data) == Some(true) {
            report(RecordingFinding::AbsoluteAccuracy.into());
        }
        if logged.is_empty() {
            has_warnings = true;
            report(RecordingFinding::NoAxesLogged { data: path.display().to_string() }.into());
        }
        axes_deg.extend(logged);
    }
    let other = other_plan(attachments.get("plan.json"), &plan);
    for finding in incomplete_axes(&plan, &axes_deg).into_iter().chain(other) {
        has_warnings = true;
        report(finding.into());
    }
    let identity = identity(&name, Some(&plan), &attachments, started)?;
    if let Some(finding) = unlikely_date(&identity) {
        report(finding.into());
    }
    let mut run = RecordedRun {
        plan,
        stream,
        temperatures,
        reports,
        track,
        has_warnings,
        axes_deg,
        identity,
        started,
        origin: pass.origin,
    };
    let of_temperature = run.temperatures.finding().into_iter().chain(run.temperature_finding());
    of_temperature.for_each(&mut report);
    for finding in run.mounting() {
        run.has_warnings = true;
        report(finding.into());
    }
    Ok(run)
}

/// The finding if the date of a run, by the clock of a computer, cannot be right.
fn unlikely_date(identity: &Identity) -> Option<RecordingFinding> {
    let wrong = identity.check_all().and_then(|()| identity.check_dates(clock::unix_ns()));
    wrong.err().map(|(_, why)| RecordingFinding::UnlikelyDate { why: why.message() })
}

/// Reads the capture at `path` back and returns the damages in it.
pub fn damages(path: &Path) -> Result<Vec<RecordingFinding>, Diagnostic> {
    Ok(CaptureSummary::over(path, |_| Ok(()))?.findings())
}

/// Most samples that are compared with a plan when a run ends: an hour at 1 kHz, and the samples before and after it.
/// They take 60 MB.
pub const MAX_COMPARED: u64 = 4_000_000;

/// The [`losses`] of a run that has just ended, unless it has more than `most` samples.
pub fn losses_at_end(path: &Path, samples: u64, most: u64) -> Result<Vec<Diagnostic>, Diagnostic> {
    if samples > most {
        return Ok(vec![Diagnostic::file(
            path.display(),
            RecordingFinding::TooLongToCompare { samples, most },
        )]);
    }
    losses(path)
}

/// Findings about lengths that were lost between the capture at `path` and the poses of its plan.
pub fn losses(path: &Path) -> Result<Vec<Diagnostic>, Diagnostic> {
    let run = open_run(path, None, &[], &mut |_| {})?;
    let mounting = run.mounting().into_iter().map(Diagnostic::from);
    let found = mounting.chain(run.matching(None)?.findings.into_iter().map(Diagnostic::from));
    Ok(found.filter(|finding| finding.severity() == Severity::Warning).collect())
}

/// The `.dat` of a program of the plan.
fn read_data(path: &Path, plan: &Plan) -> Result<krl::syntax::Data, Diagnostic> {
    let name = path.display().to_string();
    let data = krl::parse_data(&name, &files::read_text(path)?)?;
    match krl::plan_hash(&data) {
        Some(hash) if hash != plan.header.hash => {
            let run = plan.header.hash.clone();
            Err(Diagnostic::file(&name, RecordingFinding::OtherPlansData { plan: hash, run }))
        }
        _ => Ok(data),
    }
}

/// Largest difference between axes that follow the nominal robot and the commanded axes, degrees.
const APART_DEG: f64 = 0.005;

/// The finding if known axis angles differ from the commanded angles while the angles of other poses are unknown.
fn incomplete_axes(plan: &Plan, axes_deg: &MeasuredAxes) -> Option<RecordingFinding> {
    let (mut worst_deg, mut poses) = (0.0_f64, 0);
    for row in plan.rows.iter().filter(|row| row.dwell_s > 0.0) {
        match axes_deg.get(&row.index) {
            Some(axes) => {
                let apart = axes.iter().zip(row.axes_deg).map(|(a, b)| (a - b).abs());
                worst_deg = apart.fold(worst_deg, f64::max);
            }
            None => poses += 1,
        }
    }
    (worst_deg > APART_DEG && poses > 0).then_some(RecordingFinding::AxesIncomplete { worst_deg, poses })
}

/// The finding if the capture was recorded with another plan than the named one.
fn other_plan(attached: Option<&Vec<u8>>, plan: &Plan) -> Option<RecordingFinding> {
    let header = serde_json::from_slice::<Value>(attached?).unwrap_or_default();
    let recorded = header.get("hash").and_then(Value::as_str).unwrap_or("that cannot be read");
    let named = plan.header.hash.clone();
    (recorded != named).then(|| RecordingFinding::OtherPlan { recorded: recorded.into(), named })
}

/// The data collected in one pass over a capture.
#[derive(Default)]
struct GatheredCapture {
    attachments: BTreeMap<String, Vec<u8>>,
    stream: Option<StreamBuilder>,
    temperatures: SampleTemperatures,
    reports: Vec<DwellReport>,
    axes: AxisTrackBuilder,
    /// Start of the run by the clock of the recording computer, ns since the Unix epoch.
    started: Option<u64>,
}

impl GatheredCapture {
    fn add(&mut self, stamped: StampedRecord, run: &str) -> Result<(), Diagnostic> {
        self.axes.add(stamped.host, &stamped.record);
        match stamped.record {
            CaptureRecord::Attachment { name, content } => {
                self.attachments.insert(name, content);
            }
            CaptureRecord::Samples(samples) => {
                // The attachments of a capture precede its samples.
                let stream = match &mut self.stream {
                    Some(stream) => stream,
                    none => none.insert(stream(&self.attachments, run)?),
                };
                for sample in &samples {
                    stream.push(stamped.host, sample);
                    self.temperatures.push(sample.temperature_c);
                }
            }
            CaptureRecord::Event(RunEvent::Controller { index, phase, axes_deg }) => {
                self.reports.push(DwellReport { host: stamped.host, index, phase, axes_deg });
            }
            CaptureRecord::Event(RunEvent::Started { unix_ns, .. }) => {
                self.started = self.started.or(Some(unix_ns))
            }
            CaptureRecord::Raw(_)
            | CaptureRecord::Fault(_)
            | CaptureRecord::Axes(_)
            | CaptureRecord::Event(_) => {}
        }
        Ok(())
    }
}

/// An empty stream, with the clock and the sequence numbers of the attached protocol if it has them.
fn stream(attachments: &BTreeMap<String, Vec<u8>>, run: &str) -> Result<StreamBuilder, Diagnostic> {
    let Some(text) = attached_text(run, attachments, "protocol.toml")? else {
        return Ok(StreamBuilder::new(None));
    };
    let definition = ProtocolDefinition::from_toml(&format!("{run}: protocol.toml"), text)?;
    let clock = definition.clock.map(Into::into);
    Ok(StreamBuilder::new(clock).sequence(definition.sequence_modulo))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_run_is_not_compared_when_it_ends() {
        let [found] = &losses_at_end(Path::new("none"), 11, 10).unwrap()[..] else { panic!("one finding") };
        assert_eq!(found.code().as_str(), "W0417");
        assert!(losses_at_end(Path::new("none"), 10, 10).is_err(), "it is read");
    }
}
