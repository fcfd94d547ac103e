//! A capture as the verbs see it that need lengths at poses: its plan, its stream, joined.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::pass::Pass;
use super::temperature::{Temperatures, certificate};
use super::{Output, files};
use crate::capture::{Event, Record, Stamped};
use crate::diag::Diagnostic;
use crate::krl;
use crate::model::{AXES, Centre, Robot};
use crate::plan::Plan;
use crate::protocol::Definition;
use crate::sync::{self, DeviceClock, Expected, Fate, Input, Report, Stream, StreamBuilder, Synced};

/// What a capture gives to be joined.
pub(crate) struct Run {
    /// The plan: the one attached, unless another one was named. Its header holds the job with
    /// the base balls, and the robot.
    pub(crate) plan: Plan,
    /// The samples on one clock.
    pub(crate) stream: Stream,
    /// The bar's temperature, where it was told.
    temperatures: Temperatures,
    /// What the controller reported.
    pub(crate) reports: Vec<Report>,
    /// Whether something of the run was lost: a damage, a cut end, samples lost on the way to the disk.
    pub(crate) torn: bool,
    /// Axis angles (degrees) that the program measured, by the plan's index: as it told them over EthernetKRL, and
    /// those of a `.dat` before these.
    pub(crate) axes_deg: BTreeMap<u32, [f64; AXES]>,
}

impl Run {
    /// The observations, with their lengths referred by the bar's certificate to the temperature that they
    /// were read at. With a `model` of the lengths and their standard deviation (mm) it speaks in the
    /// alignment as well: it is given the number of the base ball and the axis angles in degrees.
    ///
    /// To align, identify and align again until [`Synced::same_pairs`] says that nothing changed.
    pub(crate) fn observations<F>(&self, model: Option<(F, f64)>) -> Synced
    where
        F: Fn(usize, &[f64; AXES]) -> f64,
    {
        let certificate = certificate(&self.plan.header.job);
        let warm = certificate.zip(self.temperatures.mean());
        let factor = warm.map_or(1.0, |(certificate, mean_c)| certificate.referred_mm(1.0, mean_c));
        // Readings are aligned as they were read.
        let mut synced = self.measured(model.map(|(length_mm, sigma_mm)| {
            (move |centre: usize, axes_deg: &[f64; AXES]| length_mm(centre, axes_deg) / factor, sigma_mm)
        }));
        let dwells = synced.fates.iter().filter_map(|pose| match &pose.fate {
            Fate::Matched { dwell, .. } => Some(0.5 * (dwell.from_s + dwell.to_s)),
            _ => None,
        });
        let temperatures: Vec<_> = dwells.map(|t_s| self.temperature_at(t_s)).collect();
        if temperatures.iter().any(Option::is_some) {
            let observations = &mut synced.observations;
            observations.extra_columns.push("temp_c".to_owned());
            for (row, temp_c) in observations.rows.iter_mut().zip(temperatures) {
                if let (Some(certificate), Some(temp_c)) = (certificate, temp_c) {
                    row.length_mm = certificate.referred_mm(row.length_mm, temp_c);
                }
                row.extra.push(temp_c.map_or(String::new(), |c| format!("{c:.2}")));
            }
        }
        synced
    }

    /// The observations as read.
    pub(crate) fn measured<F>(&self, model: Option<(F, f64)>) -> Synced
    where
        F: Fn(usize, &[f64; AXES]) -> f64,
    {
        let axes_deg = (!self.axes_deg.is_empty()).then_some(&self.axes_deg);
        let lengths = model
            .map(|(length_mm, sigma_mm)| (sync::expected_lengths(&self.plan, axes_deg, length_mm), sigma_mm));
        sync::observations(&Input {
            reports: &self.reports,
            expected: lengths
                .as_ref()
                .map(|(length_mm, sigma_mm)| Expected { length_mm, sigma_mm: *sigma_mm }),
            bar_sigma_mm: self.plan.header.job.bar.sigma_um * 1e-3,
            axes_deg,
            ..Input::new(&self.plan, &self.stream)
        })
    }

    /// The bar's temperature at a time of the run, degrees Celsius.
    pub(crate) fn temperature_at(&self, t_s: f64) -> Option<f64> {
        self.temperatures.at(self.stream.at(t_s))
    }

    /// What was done about temperature, for the user.
    fn temperature_note(&self) -> Option<String> {
        let bar = &self.plan.header.job.bar;
        match (certificate(&self.plan.header.job), self.temperatures.mean()) {
            (Some(certificate), Some(mean_c)) => {
                let more_um = 1e3 * (certificate.referred_mm(bar.length_mm, mean_c) - bar.length_mm);
                Some(format!(
                    "bar at {mean_c:.1} degrees: lengths are corrected by its certificate ({more_um:+.1} um at {} mm)",
                    bar.length_mm
                ))
            }
            (Some(_), None) => {
                Some("no temperature of the bar was recorded: lengths are not corrected for it".into())
            }
            (None, _) => None,
        }
    }

    /// The observations by their times alone.
    pub(crate) fn timed(&self) -> Synced {
        self.observations(None::<(fn(usize, &[f64; AXES]) -> f64, f64)>)
    }

    /// The base balls of the job.
    pub(crate) fn centres(&self) -> Vec<Centre> {
        let balls = &self.plan.header.job.centres;
        balls.iter().map(|ball| Centre { id: ball.id as usize, position: ball.xyz_mm.into() }).collect()
    }

    /// The robot that the plan was made for.
    ///
    /// # Errors
    /// What is wrong in its text.
    pub(crate) fn robot(&self) -> Result<Robot, Diagnostic> {
        Robot::from_toml("the plan's robot", &self.plan.header.robot)
    }
}

/// Whether the file at `path` is a capture, whatever its name.
///
/// # Errors
/// When it cannot be read.
pub(crate) fn is_capture(path: &Path) -> Result<bool, Diagnostic> {
    use std::io::Read as _;
    /// How a capture begins.
    const MAGIC: &[u8] = b"DBBDCAP\n";
    let mut first = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut first))
        .map_err(|error| Diagnostic::file(&path.display().to_string(), format!("cannot be read: {error}")))?;
    Ok(first == MAGIC)
}

/// Reads the capture at `path`, and the axis angles logged into the `.dat` files `axes`; says the capture's
/// damages on stderr.
///
/// # Errors
/// When it is no capture, has no samples, or there is no plan for it; what is wrong in a `.dat`.
pub(crate) fn open(
    path: &Path,
    plan: Option<&Path>,
    axes: &[PathBuf],
    out: &Output,
) -> Result<Run, Box<dyn Error>> {
    let name = path.display().to_string();
    let mut gathered = Gathered::default();
    let pass = Pass::over(path, |stamped| gathered.add(stamped, &name))?;
    pass.warn(out);
    let Gathered { attachments, stream, temperatures, reports, lost, ended } = gathered;
    let attached = |wanted: &str| text(&attachments, &name, wanted);
    let plan = match plan {
        Some(csv) => {
            let json = csv.with_extension("json");
            let (csv_name, json_name) = (csv.display().to_string(), json.display().to_string());
            Plan::from_files(&csv_name, &files::read(csv)?, &json_name, &files::read(&json)?)?
        }
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
        out.warning(format!("{lost} samples were lost on the way to the disk"));
    }
    if !ended {
        out.warning("the run was cut off: it has no record of its end");
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
            out.progress(format!(
                "{name}: the controller corrects by an accuracy model of its own ($ABS_ACCUR)"
            ));
        }
        axes_deg.extend(krl::logged_axes(&data)?);
    }
    let elsewhere = partly_elsewhere(&plan, &axes_deg);
    if let Some(doubt) = &elsewhere {
        out.warning(doubt);
    }
    let doubtful = elsewhere.is_some() || other_plan(attachments.get("plan.json"), &plan, out);
    let run = Run { plan, stream, temperatures, reports, torn: torn || doubtful, axes_deg };
    if let Some(note) = run.temperature_note() {
        out.progress(note);
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

/// Whether the capture was recorded with another plan than the one named.
fn other_plan(attached: Option<&Vec<u8>>, plan: &Plan, out: &Output) -> bool {
    let header = attached.and_then(|json| serde_json::from_slice::<Value>(json).ok());
    let recorded = header.as_ref().and_then(|header| header.get("hash")?.as_str());
    let Some(recorded) = recorded.filter(|hash| *hash != plan.header.hash) else { return false };
    out.warning(format!(
        "the capture was recorded with plan {recorded}, and plan {} is named",
        plan.header.hash
    ));
    true
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
                    stream.push(stamped.host, &sample.into());
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
