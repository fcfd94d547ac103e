//! A capture as the verbs see it that need lengths at poses: its plan, its stream, joined.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Output, files, info};
use crate::capture::{Capture, Event, Record};
use crate::diag::Diagnostic;
use crate::krl;
use crate::model::{AXES, Centre, Robot};
use crate::plan::Plan;
use crate::protocol::{Definition, Sample};
use crate::sync::{self, DeviceClock, Expected, Input, Report, Stream, StreamBuilder, Synced};

/// What a capture gives to be joined.
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
    /// Axis angles (degrees) that the program measured, by the plan's index: as it told them over EthernetKRL, and
    /// those of a `.dat` before these.
    pub(crate) axes_deg: BTreeMap<u32, [f64; AXES]>,
}

impl Run {
    /// The observations. With a `model` of the lengths and their standard deviation (mm) it speaks in the
    /// alignment as well: it is given the number of the base ball and the axis angles in degrees.
    ///
    /// To align, identify and align again until [`Synced::same_pairs`] says that nothing changed.
    pub(crate) fn observations<F>(&self, model: Option<(F, f64)>) -> Synced
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
    let mut stream = StreamBuilder::new(clock.map(|clock| DeviceClock {
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
            Record::Event(Event::Controller { index, phase, axes_deg }) => {
                reports.push(Report {
                    host: stamped.host,
                    index: *index,
                    phase: *phase,
                    axes_deg: *axes_deg,
                });
            }
            Record::Event(Event::Ended { lost: on_the_way, .. }) => (ended, lost) = (true, *on_the_way),
            _ => {}
        }
    }
    let stream = stream.build();
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
    let doubtful = elsewhere.is_some() || other_plan(&capture, &plan, out);
    Ok(Run { plan, stream, reports, torn: torn || doubtful, axes_deg })
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
fn other_plan(capture: &Capture, plan: &Plan, out: &Output) -> bool {
    let header = capture.attachment("plan.json").and_then(|json| serde_json::from_slice::<Value>(json).ok());
    let recorded = header.as_ref().and_then(|header| header.get("hash")?.as_str());
    let Some(recorded) = recorded.filter(|hash| *hash != plan.header.hash) else { return false };
    out.warning(format!(
        "the capture was recorded with plan {recorded}, and plan {} is named",
        plan.header.hash
    ));
    true
}

/// The text of an attachment, if it is there.
fn attached(capture: &Capture, run: &str, name: &str) -> Result<Option<String>, Diagnostic> {
    let text = capture.attachment(name).map(|content| String::from_utf8(content.to_vec()));
    text.transpose().map_err(|_| Diagnostic::file(&format!("{run}: {name}"), "is not UTF-8 text"))
}
