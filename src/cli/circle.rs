//! `dbbd circle`.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::run::{self, Run};
use super::{Outcome, Output, Verdict, files, temperature};
use crate::circular::{
    self, Drive, Evaluation, Mover, NAMES, Point, Quantity, Sense, Settings, TERM_NAMES, TRACE_NAMES,
    Temperature, Trace,
};
use crate::model::{AXES, Robot};
use crate::plan::{Kind, PlanRow};
use crate::report::circle::{CircleTest, CircleView};
use crate::report::{self, Provenance, Source};
use crate::sync::Fate;

/// Evaluate circular tests by the quantities of ISO 230-4.
///
/// G, G(b), D, F and H, each with a 95 % interval, and what reverses where. docs/circular-test.md says what of the
/// standard could not be read.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Captures that carry a plan, or CSV files run,direction,angle_deg,length_mm[,t_s,temp_c] (direction cw
    /// or ccw; length between ball centres). Several are set side by side as a trend, in this order.
    #[arg(required = true, value_name = "RUN|CSV")]
    inputs: Vec<PathBuf>,
    /// Directory for circle.json, circle.html and the polar plots as SVG.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Nominal radius, mm [default: the plan's; of a CSV the mean length, rounded to a millimetre].
    #[arg(long, value_name = "MM", value_parser = positive)]
    radius: Option<f64>,
    /// The plan that was driven, with its .json beside it [default: the one in the capture].
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// The .dat of a module as fetched from the controller after the run: where joints reverse is then told
    /// by the axis angles that the program logged. Once for each module.
    #[arg(long, value_name = "FILE.dat")]
    axes: Vec<PathBuf>,
    /// Standard uncertainty of a single length, mm [default: that of the dwells; of a CSV the scatter].
    #[arg(long, value_name = "MM", value_parser = positive)]
    sigma: Option<f64>,
    /// Standard uncertainty of the bar's length by its certificate, mm: part of D and F [default: half of a
    /// capture's job's length_u_mm].
    #[arg(long, value_name = "MM", value_parser = positive)]
    bar_u: Option<f64>,
    /// Expansion of the bar, 1/K [default: of a capture its job's certificate]: with temperatures (of a capture, or
    /// the column temp_c) a length is what the bar had then, not at the certificate's temperature.
    #[arg(long, value_name = "PER_K", value_parser = positive)]
    expansion: Option<f64>,
    /// Temperature of the bar's certificate, degrees Celsius [default: of a capture its job's, else 20].
    #[arg(long, value_name = "C", allow_negative_numbers = true)]
    certified: Option<f64>,
    /// Expansion of the machine, 1/K: with temperatures, its circle is referred to 20 degrees Celsius.
    #[arg(long, value_name = "PER_K", value_parser = positive)]
    machine_expansion: Option<f64>,
    /// Draws of the Monte Carlo for the 95 % intervals; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    monte_carlo: usize,
}

/// A circle of an input, before its evaluation.
struct Found {
    source: String,
    circle: Option<u32>,
    radius_mm: f64,
    traces: Vec<Trace>,
    notes: Vec<String>,
    /// What the bar's certificate says, where there is one.
    certificate: Certificate,
}

#[derive(Clone, Copy, Default)]
struct Certificate {
    temperature: Option<Temperature>,
    /// Standard uncertainty of the length, mm.
    u_mm: Option<f64>,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a positive number is needed".into()),
    }
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let mut doubt = false;
    let mut found = Vec::new();
    let mut provenance =
        Provenance { dbbd_version: env!("CARGO_PKG_VERSION").into(), ..Provenance::default() };
    for path in &args.inputs {
        let name = path.display().to_string();
        if run::is_capture(path)? {
            let (circles, plan_hash, torn) = from_capture(path, args, out)?;
            doubt |= torn;
            provenance.plan_hash = provenance.plan_hash.or(Some(plan_hash));
            found.extend(circles);
        } else {
            found.push(from_csv(&name, &files::read(path)?, args.radius)?);
        }
        provenance.sources.push(Source { role: "lengths".into(), name, hash: None });
    }
    let mut tests = Vec::new();
    for Found { source, circle, radius_mm, traces, notes, certificate } in found {
        let settings = Settings {
            sigma_mm: args.sigma,
            bar_u_mm: args.bar_u.or(certificate.u_mm).unwrap_or(0.0),
            temperature: in_force(args, certificate.temperature),
            draws: args.monte_carlo,
            ..Settings::new(radius_mm)
        };
        let mut evaluation =
            circular::circular(&traces, &settings).map_err(|error| format!("{source}: {error}"))?;
        evaluation.notes.splice(0..0, notes);
        tests.push(CircleTest { source, circle, evaluation });
    }
    files::directory(&args.out)?;
    for (at, test) in tests.iter().enumerate() {
        let name = if at == 0 { "circle.svg".to_owned() } else { format!("circle-{}.svg", at + 1) };
        files::write(&args.out.join(name), report::svg::standalone(&test.svg()))?;
    }
    let document = document(&tests);
    files::write(&args.out.join("circle.json"), serde_json::to_string_pretty(&document)? + "\n")?;
    let view = CircleView { tests: &tests, provenance };
    files::write(&args.out.join("circle.html"), report::circle::html(&view)?)?;
    out.document(&document)?;
    tests.iter().for_each(|test| show(test, out));
    out.result(format!("results in {}", args.out.display()));
    Ok(if doubt { Outcome::Doubt } else { Outcome::Done })
}

/// The command line before the certificate.
fn in_force(args: &Args, certificate: Option<Temperature>) -> Temperature {
    let known = certificate.unwrap_or_default();
    Temperature {
        bar_per_k: args.expansion.or(known.bar_per_k),
        certified_c: args.certified.unwrap_or(known.certified_c),
        machine_per_k: args.machine_expansion,
    }
}

fn from_csv(name: &str, text: &str, radius: Option<f64>) -> Result<Found, Box<dyn Error>> {
    let traces = circular::traces_from_csv(name, text)?;
    let mut notes = Vec::new();
    let radius_mm = radius.unwrap_or_else(|| {
        let lengths = || traces.iter().flat_map(|trace| &trace.points).map(|point| point.length_mm);
        let mean: f64 = lengths().sum::<f64>() / lengths().count().max(1) as f64;
        notes.push(format!("no --radius was given: the nominal radius is taken to be {} mm", mean.round()));
        mean.round()
    });
    let certificate = Certificate::default();
    Ok(Found { source: name.to_owned(), circle: None, radius_mm, traces, notes, certificate })
}

/// The circles of a capture, its plan's hash, and whether something of it is in doubt.
fn from_capture(
    path: &Path,
    args: &Args,
    out: &Output,
) -> Result<(Vec<Found>, String, bool), Box<dyn Error>> {
    let run = run::open(path, args.plan.as_deref(), &args.axes, out)?;
    let job = &run.plan.header.job;
    // As read: the evaluation corrects them itself, and tells both.
    let synced = run.measured(None::<(fn(usize, &[f64; AXES]) -> f64, f64)>);
    let certificate = Certificate {
        temperature: temperature::certificate(job),
        u_mm: job.bar.length_u_mm.map(|u| 0.5 * u),
    };
    let robot = run.robot()?;
    for warning in &synced.warnings {
        if warning.doubt { out.warning(&warning.text) } else { out.progress(&warning.text) }
    }
    let doubt = run.torn || synced.warnings.iter().any(|warning| warning.doubt);
    let times: BTreeMap<u32, f64> = synced
        .fates
        .iter()
        .filter_map(|pose| match &pose.fate {
            Fate::Matched { dwell, .. } => Some((pose.index, 0.5 * (dwell.from_s + dwell.to_s))),
            _ => None,
        })
        .collect();
    let places = run.plan.circle_places();
    let mut found: Vec<Found> = Vec::new();
    let mut lost = vec![0_usize; job.circles.len()];
    let measured = synced.observations.rows.iter().map(|row| (row.index, row)).collect::<BTreeMap<_, _>>();
    for (row, place) in run.plan.rows.iter().zip(&places) {
        let (Some(place), Kind::Measure) = (place, row.kind) else { continue };
        let Some(observation) = measured.get(&row.index) else {
            if let Some(lost) = lost.get_mut(row.circle as usize - 1) {
                *lost += 1;
            }
            continue;
        };
        let radius_mm = args.radius.unwrap_or(place.radius_mm);
        if found.last().is_none_or(|last| last.circle != Some(row.circle)) {
            found.push(Found {
                source: format!("{}, circle {}", path.display(), row.circle),
                circle: Some(row.circle),
                radius_mm,
                traces: Vec::new(),
                notes: Vec::new(),
                certificate,
            });
        }
        let sense = if place.clockwise { Sense::Clockwise } else { Sense::CounterClockwise };
        let point = Point {
            angle_deg: place.angle_deg,
            // The pose as printed is off the circle by up to a micrometre; that is no error of the robot.
            length_mm: observation.length_mm - (row.length_mm - place.radius_mm),
            sigma_mm: observation.sigma_mm,
            t_s: None,
            temp_c: times.get(&row.index).and_then(|t_s| run.temperature_at(*t_s)),
            axes_deg: Some(observation.axes_deg),
            drives: drives(&run, &robot, row),
        };
        let Some(circle) = found.last_mut() else { continue };
        match circle.traces.iter_mut().find(|trace| trace.sense == sense) {
            Some(trace) => trace.points.push(point),
            None => circle.traces.push(Trace { run: "1".into(), sense, points: vec![point] }),
        }
    }
    for circle in &mut found {
        let lost = circle.circle.and_then(|number| lost.get(number as usize - 1)).copied().unwrap_or(0);
        if lost > 0 {
            circle.notes.push(format!("{lost} poses have no length (`dbbd sync` says why)"));
        }
    }
    if found.is_empty() {
        return Err(format!("{}: no dwell can be told to be a pose on a circle", path.display()).into());
    }
    Ok((found, run.plan.header.hash.clone(), doubt))
}

/// What the joints do to the length at a pose, and in which sense each came there.
fn drives(run: &Run, robot: &Robot, row: &PlanRow) -> Option<[Drive; AXES]> {
    /// Half of the step of the derivative, rad.
    const STEP: f64 = 1e-5;
    /// A joint that moves less stands, degrees.
    const STANDS_DEG: f64 = 1e-3;
    let ball = run.plan.header.job.centres.iter().find(|ball| ball.id == row.centre)?;
    let at = (row.index as usize).checked_sub(1)?;
    let neighbour = |at: Option<usize>| at.and_then(|at| run.plan.rows.get(at)).map(|row| row.axes_deg);
    let (before, after) = (neighbour(at.checked_sub(1)), neighbour(Some(at + 1)));
    let axes = row.axes_deg.map(f64::to_radians);
    Some(std::array::from_fn(|joint| {
        let length = |step: f64| {
            let mut moved = axes;
            moved[joint] += step;
            robot.geometry.length(&moved, &ball.xyz_mm.into(), 0.0)
        };
        let lever_mm = (length(STEP) - length(-STEP)) / (2.0 * STEP);
        let sense = |from: f64, to: f64| match to - from {
            step if step >= STANDS_DEG => 1,
            step if step <= -STANDS_DEG => -1,
            _ => 0,
        };
        let came = before.map_or(0, |before| sense(before[joint], row.axes_deg[joint]));
        let goes = after.map_or(0, |after| sense(row.axes_deg[joint], after[joint]));
        // Next to where it turns the joint may have turned on the way already.
        Drive { lever_mm, sense: if came == goes { came } else { 0 } }
    }))
}

fn show(test: &CircleTest, out: &Output) {
    let Evaluation { radius_mm, arc, traces, .. } = &test.evaluation;
    let points: usize = traces.iter().map(|trace| trace.points).sum();
    out.result(format!(
        "{}: radius {radius_mm} mm, {points} points, {:.0} degrees, condition {:.1}",
        test.source, arc.span_deg, arc.condition
    ));
    for (name, quantity) in NAMES.iter().zip(&test.evaluation.quantities) {
        if let Some(value) = quantity.value {
            let u95 = quantity.u95.map_or(String::new(), |u| format!(" +- {u:.5}"));
            out.result(format!("  {name:6} {value:10.5}{u95} mm"));
        }
    }
    for note in &test.evaluation.notes {
        out.progress(format!("note: {note}"));
    }
}

fn put(map: &mut Map<String, Value>, name: &str, quantity: Quantity) {
    map.insert(name.to_owned(), json!(quantity.value));
    map.insert(format!("{name}_u95"), json!(quantity.u95));
}

/// The first test's keys stand at the top; all tests follow where there are more.
fn document(tests: &[CircleTest]) -> Value {
    let mut all: Vec<Map<String, Value>> = tests.iter().map(test_document).collect();
    let mut top = Map::new();
    top.insert("schema".into(), json!(1));
    if all.len() > 1 {
        top.extend(all.first().cloned().unwrap_or_default());
        top.insert("tests".into(), Value::Array(all.into_iter().map(Value::Object).collect()));
    } else if let Some(only) = all.pop() {
        top.extend(only);
    }
    Value::Object(top)
}

fn test_document(test: &CircleTest) -> Map<String, Value> {
    let found = &test.evaluation;
    let mut map = Map::new();
    map.insert("source".into(), json!(test.source));
    map.insert("circle".into(), json!(test.circle));
    map.insert("radius_mm".into(), json!(found.radius_mm));
    for (name, quantity) in NAMES.iter().zip(&found.quantities) {
        put(&mut map, name, *quantity);
    }
    let arc = &found.arc;
    map.insert(
        "arc".into(),
        json!({
            "from_deg": arc.from_deg, "span_deg": arc.span_deg, "largest_gap_deg": arc.largest_gap_deg,
            "full": arc.full, "condition": arc.condition,
        }),
    );
    map.insert("F_centre".into(), json!(if found.free_centre { "least_squares" } else { "instrument" }));
    if let Some(values) = &found.as_measured {
        let named: Map<String, Value> =
            NAMES.iter().zip(values).map(|(name, value)| ((*name).to_owned(), json!(value))).collect();
        map.insert("as_measured".into(), Value::Object(named));
    }
    let traces: Vec<Value> = found
        .traces
        .iter()
        .map(|trace| {
            let mut one = Map::new();
            one.insert("run".into(), json!(trace.run));
            one.insert("direction".into(), json!(trace.sense.word()));
            one.insert("points".into(), json!(trace.points));
            for (name, quantity) in TRACE_NAMES.iter().zip(&trace.quantities) {
                put(&mut one, name, *quantity);
            }
            Value::Object(one)
        })
        .collect();
    map.insert("traces".into(), Value::Array(traces));
    let harmonics: Vec<Value> = found
        .diagnosis
        .harmonics
        .iter()
        .map(|harmonic| {
            let mut one = Map::new();
            one.insert("direction".into(), json!(harmonic.sense.word()));
            for (at, name) in TERM_NAMES.iter().enumerate() {
                one.insert((*name).to_owned(), json!(harmonic.values_mm[at]));
                one.insert(format!("{name}_u95"), json!(harmonic.u95_mm[at]));
            }
            Value::Object(one)
        })
        .collect();
    map.insert("harmonics".into(), Value::Array(harmonics));
    let meaning = &found.diagnosis;
    for (name, pair) in [
        ("scale_mismatch", meaning.scale_mismatch),
        ("squareness_rad", meaning.squareness_rad),
        ("servo_mismatch_s", meaning.servo_mismatch_s),
    ] {
        map.insert(name.into(), json!(pair.map(|pair| pair[0])));
        map.insert(format!("{name}_u95"), json!(pair.map(|pair| pair[1])));
    }
    let reversals: Vec<Value> = found
        .reversals
        .iter()
        .map(|at| {
            json!({ "run": at.run, "direction": at.sense.word(), "joint": at.joint, "angle_deg": at.angle_deg })
        })
        .collect();
    map.insert("joint_reversals".into(), Value::Array(reversals));
    let steps: Vec<Value> = found
        .steps
        .iter()
        .map(|step| match step.mover {
            Mover::Axis(axis) => json!({
                "axis": axis, "play_mm": step.play, "play_mm_u95": step.u95, "largest_step_mm": step.most_mm,
            }),
            Mover::Joint(joint) => json!({
                "joint": joint, "play_rad": step.play, "play_rad_u95": step.u95, "largest_step_mm": step.most_mm,
            }),
        })
        .collect();
    map.insert("reversal_steps".into(), Value::Array(steps));
    map.insert("length_sigma_mm".into(), json!(found.sigma_mm));
    map.insert("length_sigma_source".into(), json!(found.sigma_source));
    map.insert("monte_carlo_draws".into(), json!(found.draws));
    map.insert("notes".into(), json!(found.notes));
    map
}
