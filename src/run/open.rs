//! Reading a run.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::temperature::Temperatures;
use super::{Note, Run};
use crate::capture::{Event, Pass, Record, Stamped};
use crate::diag::Diagnostic;
use crate::files;
use crate::krl;
use crate::model::AXES;
use crate::plan::Plan;
use crate::protocol::Definition;
use crate::sync::{self, DeviceClock, Report, StreamBuilder};

/// Whether the file at `path` is a capture, whatever its name.
///
/// # Errors
/// When it cannot be read.
pub fn is_capture(path: &Path) -> Result<bool, Diagnostic> {
    use std::io::Read as _;
    /// How a capture begins.
    const MAGIC: &[u8] = b"DBBDCAP\n";
    let mut first = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut first))
        .map_err(|error| Diagnostic::file(&path.display().to_string(), format!("cannot be read: {error}")))?;
    Ok(first == MAGIC)
}

/// The plan whose rows stand in the CSV at `csv`, with the .json beside it.
///
/// # Errors
/// What cannot be read or is wrong, with its file and line.
pub fn plan_beside(csv: &Path) -> Result<Plan, Box<dyn Error>> {
    let json = csv.with_extension("json");
    if csv.is_file() && !json.is_file() {
        let message = format!("has no {} beside it: it is no plan, or half of one", json.display());
        return Err(Diagnostic::file(&csv.display().to_string(), message)
            .help("name the plan.csv that `dbbd plan` wrote, with its plan.json in the same directory")
            .into());
    }
    let (csv_name, json_name) = (csv.display().to_string(), json.display().to_string());
    Ok(Plan::from_files(&csv_name, &files::read(csv)?, &json_name, &files::read(&json)?)?)
}

/// Reads the capture at `path`, and the axis angles logged into the `.dat` files `axes`; tells the capture's
/// damages and what else is to be known.
///
/// # Errors
/// When it is no capture, has no samples, or there is no plan for it; what is wrong in a `.dat`.
pub fn open(
    path: &Path,
    plan: Option<&Path>,
    axes: &[PathBuf],
    tell: &mut dyn FnMut(Note),
) -> Result<Run, Box<dyn Error>> {
    let name = path.display().to_string();
    let mut gathered = Gathered::default();
    let pass = Pass::over(path, |stamped| gathered.add(stamped, &name))?;
    pass.remarks().into_iter().for_each(|remark| tell(Note::Warning(remark)));
    let Gathered { attachments, stream, temperatures, reports, lost, ended } = gathered;
    let attached = |wanted: &str| text(&attachments, &name, wanted);
    let plan = match plan {
        Some(csv) => plan_beside(csv)?,
        None => match (attached("plan.csv")?, attached("plan.json")?) {
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
    let Some(stream) = stream.map(StreamBuilder::build) else {
        return Err(Diagnostic::file(&name, "holds no sample: the bar said nothing").into());
    };
    if lost > 0 {
        tell(Note::Warning(format!("{lost} samples were lost on the way to the disk")));
    }
    if !ended {
        tell(Note::Warning("the run was cut off: it has no record of its end".into()));
    }
    let torn = !pass.damages.is_empty() || lost > 0 || !ended;
    let mut axes_deg = sync::reported_axes(&reports);
    for path in axes {
        let name = path.display().to_string();
        let data = krl::parse_data(&name, &files::read(path)?)?;
        let hash = krl::plan_hash(&data);
        if hash.as_deref().is_some_and(|hash| hash != plan.header.hash) {
            let message =
                format!("was written for plan {}, not {}", hash.unwrap_or_default(), plan.header.hash);
            return Err(Diagnostic::file(&name, message)
                .help("give the .dat of the program that ran")
                .into());
        }
        if krl::own_accuracy(&data) == Some(true) {
            tell(Note::Remark(format!(
                "{name}: the controller corrects by an accuracy model of its own ($ABS_ACCUR)"
            )));
        }
        axes_deg.extend(krl::logged_axes(&data)?);
    }
    let elsewhere = partly_elsewhere(&plan, &axes_deg);
    let other = other_plan(attachments.get("plan.json"), &plan);
    let doubtful = elsewhere.is_some() || other.is_some();
    elsewhere.into_iter().chain(other).for_each(|doubt| tell(Note::Warning(doubt)));
    let run = Run { plan, stream, temperatures, reports, torn: torn || doubtful, axes_deg };
    if let Some(note) = run.temperature_note() {
        tell(Note::Remark(note));
    }
    Ok(run)
}

/// Axes that stand this far beside the commanded ones do not follow the nominal robot, degrees.
const ELSEWHERE_DEG: f64 = 0.005;

/// What to say when the axes that were logged stand beside the commanded ones, and those of other poses are not known.
fn partly_elsewhere(plan: &Plan, axes_deg: &BTreeMap<u32, [f64; AXES]>) -> Option<String> {
    let (mut most, mut unknown) = (0.0_f64, 0);
    for row in plan.rows.iter().filter(|row| row.dwell_s > 0.0) {
        match axes_deg.get(&row.index) {
            Some(axes) => {
                most = axes.iter().zip(row.axes_deg).map(|(a, b)| (a - b).abs()).fold(most, f64::max)
            }
            None => unknown += 1,
        }
    }
    (most > ELSEWHERE_DEG && unknown > 0).then(|| {
        format!(
            "the logged axes stand up to {most:.3} degrees beside the commanded ones, and {unknown} poses have no logged \
             ones: give the .dat of every module"
        )
    })
}

/// What to say when the capture was recorded with another plan than the one named.
fn other_plan(attached: Option<&Vec<u8>>, plan: &Plan) -> Option<String> {
    let header = serde_json::from_slice::<Value>(attached?).ok()?;
    let recorded = header.get("hash")?.as_str().filter(|hash| *hash != plan.header.hash)?;
    Some(format!("the capture was recorded with plan {recorded}, and plan {} is named", plan.header.hash))
}

/// What one pass over a capture collects.
#[derive(Default)]
struct Gathered {
    attachments: BTreeMap<String, Vec<u8>>,
    stream: Option<StreamBuilder>,
    temperatures: Temperatures,
    reports: Vec<Report>,
    lost: u64,
    ended: bool,
}

impl Gathered {
    fn add(&mut self, stamped: Stamped, run: &str) -> Result<(), Box<dyn Error>> {
        match stamped.record {
            Record::Attachment { name, content } => {
                self.attachments.insert(name, content);
            }
            Record::Samples(samples) => {
                // A capture's files stand before its samples.
                let stream = match &mut self.stream {
                    Some(stream) => stream,
                    none => none.insert(StreamBuilder::new(device_clock(&self.attachments, run)?)),
                };
                for sample in &samples {
                    stream.push(stamped.host, sample);
                    self.temperatures.push(sample.temperature_c);
                }
            }
            Record::Event(Event::Controller { index, phase, axes_deg }) => {
                self.reports.push(Report { host: stamped.host, index, phase, axes_deg });
            }
            Record::Event(Event::Ended { lost, .. }) => (self.ended, self.lost) = (true, lost),
            _ => {}
        }
        Ok(())
    }
}

/// The clock of the protocol in force, where it has one.
fn device_clock(
    attachments: &BTreeMap<String, Vec<u8>>,
    run: &str,
) -> Result<Option<DeviceClock>, Diagnostic> {
    let Some(text) = text(attachments, run, "protocol.toml")? else { return Ok(None) };
    let definition = Definition::from_toml(&format!("{run}: protocol.toml"), &text)?;
    Ok(definition.clock.map(|clock| DeviceClock {
        seconds_per_tick: f64::from(clock.tick_ns) * 1e-9,
        wrap: 1u64.checked_shl(clock.wrap_bits),
    }))
}

/// The text of an attachment, if it is there.
fn text(
    attachments: &BTreeMap<String, Vec<u8>>,
    run: &str,
    name: &str,
) -> Result<Option<String>, Diagnostic> {
    let text = attachments.get(name).map(|content| String::from_utf8(content.clone()));
    text.transpose().map_err(|_| Diagnostic::file(&format!("{run}: {name}"), "is not UTF-8 text"))
}
