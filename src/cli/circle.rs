//! `dbbd circle`.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::{Outcome, Output, bar_u, length_sd, positive};
use crate::base::{FileSet, serialised};
use crate::catalogue::{CircularFinding, CliFinding, MatchingFinding, ProvenanceFinding};
use crate::circular::{
    self, Diagnosis, Evaluation, Harmonics, Mover, NAMES, Quantity, Settings, Step, TERM_NAMES, TRACE_NAMES,
    Temperature, Trace, TraceResult,
};
use crate::diagnostic::Diagnostic;
use crate::provenance::{Artefact, CERTIFIED_C, Provenance, Role, Traced, one_robot};
use crate::recording::run;
use crate::report;
use crate::report::circle::CircleTest;

/// Deviations of a trace that circle.json has at most: an even sample of more.
const DEVIATIONS: usize = 2000;

/// Evaluate circular tests by the quantities of ISO 230-4.
///
/// G, G(b), D, F and H, each with a 95 % interval, and what reverses where. docs/reference/circular-test.md says what of the
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
    /// The .dat of a module as fetched from the controller after the run: the axis angles that the program logged
    /// then show where joints reverse. Once for each module.
    #[arg(long, value_name = "FILE.dat")]
    axes: Vec<PathBuf>,
    /// Standard uncertainty of a single length, mm [default: that of the dwells; of a CSV the scatter].
    #[arg(long, value_name = "MM", value_parser = length_sd)]
    sigma: Option<f64>,
    /// Standard uncertainty of the bar's length by its certificate, mm: part of D and F [default: half of a
    /// capture's job's length_u_mm].
    #[arg(long, value_name = "MM", value_parser = bar_u)]
    bar_u: Option<f64>,
    /// Expansion of the bar, 1/K [default: of a capture its job's certificate]: with temperatures (of a capture, or
    /// the column temp_c) a length is what the bar had then, not at the certificate's temperature.
    #[arg(long, value_name = "PER_K", value_parser = expansion)]
    expansion: Option<f64>,
    /// Temperature of the bar's certificate, degrees Celsius [default: of a capture its job's, else 20].
    #[arg(long, value_name = "C", value_parser = certified, allow_negative_numbers = true)]
    certified: Option<f64>,
    /// Expansion of the machine, 1/K: with temperatures, its circle is referred to 20 degrees Celsius.
    #[arg(long, value_name = "PER_K", value_parser = expansion)]
    machine_expansion: Option<f64>,
    /// Draws of the Monte Carlo for the 95 % intervals; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = draws)]
    monte_carlo: usize,
}

/// A circle of an input, before its evaluation.
struct Found {
    source: String,
    circle: Option<u32>,
    radius_mm: f64,
    traces: Vec<Trace>,
    notes: Vec<CircularFinding>,
    /// What the bar's certificate says, where there is one.
    certificate: Certificate,
}

#[derive(Clone, Copy, Default)]
struct Certificate {
    temperature: Option<Temperature>,
    /// Standard uncertainty of the length, mm.
    u_mm: Option<f64>,
}

fn expansion(text: &str) -> Result<f64, CliFinding> {
    match positive(text)? {
        per_k if per_k < 1e-3 => Ok(per_k),
        _ => Err(CliFinding::NotAnExpansion),
    }
}

fn certified(text: &str) -> Result<f64, CliFinding> {
    let [least, most] = CERTIFIED_C;
    match text.parse() {
        Ok(celsius) if (least..=most).contains(&celsius) => Ok(celsius),
        _ => Err(CliFinding::NotACertifiedTemperature { least, most }),
    }
}

/// Fewer give no interval of 95 %.
fn draws(text: &str) -> Result<usize, CliFinding> {
    const DRAWS: std::ops::RangeInclusive<usize> = 50..=1_000_000;
    let outside =
        CliFinding::Outside { least: *DRAWS.start() as f64, most: *DRAWS.end() as f64, unit: "draws, or 0" };
    text.parse().ok().filter(|draws| *draws == 0 || DRAWS.contains(draws)).ok_or(outside)
}

/// An option about temperatures that no circle can use.
fn unused(args: &Args, found: &[Found]) -> Option<CircularFinding> {
    let is_warm = |circle: &&Found| {
        circle.traces.iter().flat_map(|trace| &trace.points).all(|point| point.temp_c.is_some())
    };
    let known = |circle: &Found| in_force(args, circle.certificate.temperature).bar_per_k.is_some();
    let warm: Vec<&Found> = found.iter().filter(is_warm).collect();
    let given = [
        ("--expansion", args.expansion),
        ("--machine-expansion", args.machine_expansion),
        ("--certified", args.certified),
    ];
    match given.into_iter().find(|(_, value)| value.is_some()) {
        Some((option, _)) if warm.is_empty() => Some(CircularFinding::NoTemperature { option }),
        _ if args.certified.is_some() && !warm.into_iter().any(known) => {
            Some(CircularFinding::CertifiedAlone)
        }
        _ => None,
    }
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let mut found = Vec::new();
    let mut sources = Vec::new();
    let captures = args.inputs.iter().map(|path| run::is_capture(path)).collect::<Result<Vec<_>, _>>()?;
    if !captures.contains(&true) && (args.plan.is_some() || !args.axes.is_empty()) {
        return Err(CircularFinding::NoCapture.into());
    }
    for (path, is_capture) in args.inputs.iter().zip(captures) {
        if is_capture {
            let captured = from_capture(path, args, out)?;
            found.extend(captured.circles);
            sources.push(captured.source);
        } else {
            let traces = out.table(path, circular::traces_from_table)?;
            found.push(from_csv(&path.display().to_string(), traces, args.radius));
            sources.push(Artefact::file(Role::Measurements, path)?.into());
        }
    }
    for (at, source) in sources.iter().enumerate() {
        if sources[..at].iter().any(|other| other.artefact.sha256 == source.artefact.sha256) {
            out.finding(ProvenanceFinding::GivenTwice { lengths: source.artefact.to_string() });
        }
    }
    one_robot(args.inputs.iter().map(|path| path.display().to_string()).zip(&sources))?;
    if let Some(unused) = unused(args, &found) {
        return Err(unused.into());
    }
    let provenance = Provenance::of(&sources);
    let mut tests = Vec::new();
    let circles = found.len();
    for (at, circle) in found.into_iter().enumerate() {
        out.done(50 + u8::try_from(40 * at / circles).unwrap_or(40));
        tests.push(evaluate(circle, args)?);
    }
    out.done(90);
    let mut set = FileSet::begin(&args.out)?;
    for (at, test) in tests.iter().enumerate() {
        let name = if at == 0 { "circle.svg".to_owned() } else { format!("circle-{}.svg", at + 1) };
        set.write(&name, report::svg::standalone(&test.svg()))?;
    }
    // Those of an earlier evaluation of more circles.
    let more = (tests.len() + 1..).map(|number| format!("circle-{number}.svg"));
    more.take_while(|file| args.out.join(file).exists()).for_each(|file| set.remove(&file));
    let document = document(&tests, &provenance);
    set.write("circle.json", serialised::sealed_json(&document)?)?;
    set.write("circle.html", report::circle::html(&tests, &provenance)?)?;
    set.finish()?;
    for CircleTest { source, evaluation, .. } in &tests {
        evaluation.notes.iter().for_each(|note| out.finding(Diagnostic::file(source, note.clone())));
    }
    out.document(&document)?;
    tests.iter().for_each(|test| show(test, out));
    out.result(format!("results in {}", args.out.display()));
    Ok(Outcome::Done)
}

fn evaluate(found: Found, args: &Args) -> Result<CircleTest, Diagnostic> {
    let Found { source, circle, radius_mm, traces, notes, certificate } = found;
    let settings = Settings {
        sigma_mm: args.sigma,
        bar_u_mm: args.bar_u.or(certificate.u_mm).unwrap_or(0.0),
        temperature: in_force(args, certificate.temperature),
        draws: args.monte_carlo,
        ..Settings::new(radius_mm)
    };
    let mut evaluation =
        circular::circular(&traces, &settings).map_err(|finding| Diagnostic::file(&source, finding))?;
    evaluation.notes.splice(0..0, notes);
    if settings.temperature.machine_per_k.is_some() && settings.temperature.bar_per_k.is_none() {
        evaluation.notes.push(CircularFinding::BarAsMeasured);
    }
    Ok(CircleTest { source, circle, evaluation })
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

fn from_csv(name: &str, traces: Vec<Trace>, radius: Option<f64>) -> Found {
    let mut notes = Vec::new();
    let lengths = || traces.iter().flat_map(|trace| &trace.points).map(|point| point.length_mm);
    let mean: f64 = lengths().sum::<f64>() / lengths().count().max(1) as f64;
    notes.extend(radius.and_then(|radius_mm| other_radius(radius_mm, mean)));
    let radius_mm = radius.unwrap_or_else(|| {
        notes.push(CircularFinding::RadiusAssumed { radius_mm: mean.round() });
        mean.round()
    });
    let certificate = Certificate::default();
    Found { source: name.to_owned(), circle: None, radius_mm, traces, notes, certificate }
}

/// That the mean length is that of a whole millimetre, which programs have, rather than that of --radius.
fn other_radius(radius_mm: f64, mean_mm: f64) -> Option<CircularFinding> {
    /// Times nearer.
    const NEARER: f64 = 5.0;
    const LEAST_MM: f64 = 0.1;
    let off_mm = (mean_mm - radius_mm).abs();
    let is_other = off_mm > LEAST_MM && off_mm > NEARER * (mean_mm - mean_mm.round()).abs();
    (is_other && radius_mm != mean_mm.round()).then_some(CircularFinding::OtherRadius { mean_mm, radius_mm })
}

/// The circles of a capture, and the capture.
struct Captured {
    circles: Vec<Found>,
    source: Traced,
}

fn from_capture(path: &Path, args: &Args, out: &Output) -> Result<Captured, Diagnostic> {
    let run = run::open(path, args.plan.as_deref(), &args.axes, &mut |finding| out.finding(finding))?;
    let bar = &run.plan.header.job.bar;
    let certificate = Certificate { temperature: run.certificate(), u_mm: bar.u_mm() };
    let found = run.circles()?;
    out.about(&found.findings);
    let name = path.display().to_string();
    let (circles, empty): (Vec<_>, Vec<_>) =
        found.circles.into_iter().partition(|circle| circle.measured() > 0);
    if circles.is_empty() {
        return Err(Diagnostic::file(&name, MatchingFinding::NoCircle));
    }
    for circle in empty {
        let without = CircularFinding::CircleWithoutLength { circle: circle.number, poses: circle.lost };
        out.finding(Diagnostic::file(&name, without));
    }
    let circles = circles.into_iter().map(|circle| Found {
        source: format!("{}, circle {}", path.display(), circle.number),
        circle: Some(circle.number),
        radius_mm: args.radius.unwrap_or(circle.radius_mm),
        notes: notes(&circle, args.radius),
        traces: circle.traces,
        certificate,
    });
    Ok(Captured { circles: circles.collect(), source: run.traced(path)? })
}

/// What of a circle of a capture is lost, and that --radius is not the plan's.
fn notes(circle: &run::Circle, radius: Option<f64>) -> Vec<CircularFinding> {
    /// Plans are printed to so much, mm.
    const PRINTED_MM: f64 = 0.01;
    let planned_mm = circle.radius_mm;
    let other = radius.filter(|radius_mm| (radius_mm - planned_mm).abs() > PRINTED_MM);
    let other = other.map(|radius_mm| CircularFinding::RadiusOfPlan { radius_mm, planned_mm });
    let (lost, poses) = (circle.lost, circle.lost + circle.measured());
    let percent = 100.0 * lost as f64 / poses.max(1) as f64;
    let without = (lost > 0).then_some(CircularFinding::PosesWithoutLength { lost, poses, percent });
    without.into_iter().chain(other).collect()
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
}

fn put(map: &mut Map<String, Value>, name: &str, quantity: Quantity) {
    map.insert(name.to_owned(), json!(quantity.value));
    map.insert(format!("{name}_u95"), json!(quantity.u95));
}

/// The first test's keys are at the top; all tests follow where there are more.
fn document(tests: &[CircleTest], provenance: &Provenance) -> Value {
    let mut all: Vec<Map<String, Value>> = tests.iter().map(test_document).collect();
    let mut top = Map::new();
    top.insert("schema".into(), json!(1));
    if all.len() > 1 {
        top.extend(all.first().cloned().unwrap_or_default());
        top.insert("tests".into(), Value::Array(all.into_iter().map(Value::Object).collect()));
    } else if let Some(only) = all.pop() {
        top.extend(only);
    }
    top.insert("provenance".into(), json!(provenance));
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
    let list = |values: Vec<Value>| Value::Array(values);
    map.insert("traces".into(), list(found.traces.iter().map(trace_document).collect()));
    map.extend(diagnosis_document(&found.diagnosis));
    let reversals = found.reversals.iter().map(|at| {
        json!({ "run": at.run, "direction": at.sense.word(), "joint": at.joint, "angle_deg": at.angle_deg })
    });
    map.insert("joint_reversals".into(), list(reversals.collect()));
    map.insert("reversal_steps".into(), list(found.steps.iter().map(step_document).collect()));
    map.insert("length_sigma_mm".into(), json!(found.sigma_mm));
    map.insert("length_sigma_source".into(), json!(found.sigma_source.word()));
    map.insert("monte_carlo_draws".into(), json!(found.draws));
    let notes = found.notes.iter().map(|note| json!(Diagnostic::new(note.clone())));
    map.insert("notes".into(), list(notes.collect()));
    map
}

fn trace_document(trace: &TraceResult) -> Value {
    let mut map = Map::new();
    map.insert("run".into(), json!(trace.run));
    map.insert("direction".into(), json!(trace.sense.word()));
    map.insert("points".into(), json!(trace.points));
    for (name, quantity) in TRACE_NAMES.iter().zip(&trace.quantities) {
        put(&mut map, name, *quantity);
    }
    let stride = trace.deviations.len().div_ceil(DEVIATIONS).max(1);
    let deviations: Vec<&[f64; 2]> = trace.deviations.iter().step_by(stride).collect();
    map.insert("deviations".into(), json!(deviations));
    Value::Object(map)
}

fn diagnosis_document(meaning: &Diagnosis) -> Map<String, Value> {
    let harmonic = |harmonic: &Harmonics| {
        let mut map = Map::new();
        map.insert("direction".into(), json!(harmonic.sense.word()));
        for (at, name) in TERM_NAMES.iter().enumerate() {
            map.insert((*name).to_owned(), json!(harmonic.values_mm[at]));
            map.insert(format!("{name}_u95"), json!(harmonic.u95_mm[at]));
        }
        Value::Object(map)
    };
    let mut map = Map::new();
    map.insert("harmonics".into(), Value::Array(meaning.harmonics.iter().map(harmonic).collect()));
    for (name, pair) in [
        ("scale_mismatch", meaning.scale_mismatch),
        ("squareness_rad", meaning.squareness_rad),
        ("servo_mismatch_s", meaning.servo_mismatch_s),
    ] {
        map.insert(name.into(), json!(pair.map(|pair| pair[0])));
        map.insert(format!("{name}_u95"), json!(pair.map(|pair| pair[1])));
    }
    map
}

fn step_document(step: &Step) -> Value {
    match step.mover {
        Mover::Axis(axis) => json!({
            "axis": axis, "play_mm": step.play, "play_mm_u95": step.u95, "largest_step_mm": step.most_mm,
        }),
        Mover::Joint(joint) => json!({
            "joint": joint, "play_rad": step.play, "play_rad_u95": step.u95, "largest_step_mm": step.most_mm,
        }),
    }
}
