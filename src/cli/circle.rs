//! `dbbd circle`.

use std::path::{Path, PathBuf};

use super::{CommandOutcome, CommandOutput, artefact, value};
use dbbd_job::file_set::FileSet;
use dbbd_job::recording::matching::MatchingFinding;
use dbbd_job::recording::run;
use dbbd_job::report;
use dbbd_job::report::circle::CircleTest;
use dbbd_model::base::serialised;
use dbbd_model::circular::CircularFinding;
use dbbd_model::circular::{
    self, CircleTrace, CircularEvaluation, CircularSettings, QUANTITY_NAMES, ThermalExpansion,
};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{ArtefactRole, TracedArtefact, one_robot};

/// Evaluate circular tests according to ISO 230-4.
///
/// Computes G, G(b), D, F and H, each with a 95 % interval, and the reversal error of each axis or joint.
/// docs/reference/circular-test.md says which parts of the standard could not be consulted.
#[derive(clap::Args)]
pub(crate) struct CircleArgs {
    /// Captures that contain a plan, or CSV files run,direction,angle_deg,length_mm[,t_s,temp_c] (direction cw or ccw;
    /// length between ball centres). Several inputs are shown as a trend, in this order.
    #[arg(required = true, value_name = "RUN|CSV")]
    inputs: Vec<PathBuf>,
    /// Directory for circle.json, circle.html and the polar plots as SVG.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Nominal radius, mm [default: the plan's; of a CSV the mean length, rounded to a millimetre].
    #[arg(long, value_name = "MM", value_parser = value::positive)]
    radius: Option<f64>,
    /// The plan that the robot executed, with its .json beside it [default: the one in the capture].
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// The .dat of a module, fetched from the controller after the run: the axis angles that the program logged show where
    /// joints reverse. Give it once for each module.
    #[arg(long, value_name = "FILE.dat")]
    axes: Vec<PathBuf>,
    /// Standard uncertainty of a single length, mm [default: that of the dwells; of a CSV the scatter].
    #[arg(long, value_name = "MM", value_parser = value::length_sd)]
    sigma: Option<f64>,
    /// Standard uncertainty (k = 1) of the bar's length by its certificate, mm; it contributes to D and F [default: half of
    /// length_u_mm in the job of a capture].
    #[arg(long, value_name = "MM", value_parser = value::bar_u)]
    bar_u: Option<f64>,
    /// Thermal expansion of the bar, 1/K [default: of a capture, that in its job]. With temperatures (in a capture, or in the
    /// column temp_c) a length is corrected from the certificate's temperature to that of the bar.
    #[arg(long, value_name = "PER_K", value_parser = value::expansion)]
    expansion: Option<f64>,
    /// Temperature of the bar's certificate, degrees Celsius [default: of a capture, that in its job; else 20].
    #[arg(long, value_name = "C", value_parser = value::certified, allow_negative_numbers = true)]
    certified: Option<f64>,
    /// Thermal expansion of the machine, 1/K. With temperatures, its circle is referred to 20 degrees Celsius.
    #[arg(long, value_name = "PER_K", value_parser = value::expansion)]
    machine_expansion: Option<f64>,
    /// Number of Monte Carlo draws for the 95 % intervals: 0 for none, else 50 to 1000000.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = value::draws)]
    monte_carlo: usize,
}

/// The circle of an input, before its evaluation.
struct CircleInput {
    source: String,
    number: Option<u32>,
    radius_mm: f64,
    traces: Vec<CircleTrace>,
    notes: Vec<CircularFinding>,
    /// The expansion of the bar and the temperature of its certificate, if known.
    certified: Option<ThermalExpansion>,
    /// Standard uncertainty of the bar's length, mm, if known.
    bar_u_mm: Option<f64>,
}

pub(crate) fn run(args: &CircleArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let (circles, sources) = read_circles(args, out)?;
    for (at, source) in sources.iter().enumerate() {
        if sources[..at].iter().any(|other| other.artefact.sha256 == source.artefact.sha256) {
            out.finding(ProvenanceFinding::GivenTwice { lengths: source.artefact.to_string() });
        }
    }
    one_robot(args.inputs.iter().map(|path| path.display().to_string()).zip(&sources))?;
    if let Some(unused) = unused_option(args, &circles) {
        return Err(unused.into());
    }
    let provenance = dbbd_job::artefact::made_from(&sources);
    let robot = provenance.robot().map(|robot| robot.name.as_str());
    artefact::check_replaced(&args.out.join("circle.json"), robot, &provenance)?;
    let (mut tests, count) = (Vec::new(), circles.len());
    for (at, circle) in circles.into_iter().enumerate() {
        out.done(50 + u8::try_from(40 * at / count).unwrap_or(40));
        tests.push(evaluate(circle, args)?);
    }
    out.done(90);
    let document = report::circle_json::document(&tests, &provenance);
    let mut set = FileSet::begin(&args.out)?;
    for (at, test) in tests.iter().enumerate() {
        let name = if at == 0 { "circle.svg".to_owned() } else { format!("circle-{}.svg", at + 1) };
        set.write(&name, report::svg::standalone(&test.svg()))?;
    }
    // Remove the plots of circles that an earlier evaluation left behind.
    let further = (tests.len() + 1..).map(|number| format!("circle-{number}.svg"));
    further.take_while(|file| args.out.join(file).exists()).for_each(|file| set.remove(&file));
    set.write("circle.json", serialised::sealed_json(&document)?)?;
    set.write("circle.html", report::circle::html(&tests, &provenance)?)?;
    set.finish()?;
    for CircleTest { source, evaluation, .. } in &tests {
        out.findings_in(source, evaluation.notes.iter().cloned());
    }
    out.document(&document)?;
    tests.iter().for_each(|test| show_circular_test(test, out));
    out.result(format!("results in {}", args.out.display()));
    Ok(CommandOutcome::Done)
}

/// The circles of all inputs, and the inputs.
fn read_circles(
    args: &CircleArgs,
    out: &CommandOutput,
) -> Result<(Vec<CircleInput>, Vec<TracedArtefact>), Diagnostic> {
    let captures = args.inputs.iter().map(|path| run::is_capture(path)).collect::<Result<Vec<_>, _>>()?;
    if !captures.contains(&true) && (args.plan.is_some() || !args.axes.is_empty()) {
        return Err(CircularFinding::NoCapture.into());
    }
    let (mut circles, mut sources) = (Vec::new(), Vec::new());
    for (path, is_capture) in args.inputs.iter().zip(captures) {
        if is_capture {
            let (of_capture, capture) = from_capture(path, args, out)?;
            circles.extend(of_capture);
            sources.push(capture);
        } else {
            let traces = out.table(path, circular::traces_from_table)?;
            circles.push(from_csv(&path.display().to_string(), traces, args.radius));
            sources.push(dbbd_job::artefact::of_file(ArtefactRole::Measurements, path)?.into());
        }
    }
    Ok((circles, sources))
}

/// The first temperature option that has no effect on any circle.
fn unused_option(args: &CircleArgs, circles: &[CircleInput]) -> Option<CircularFinding> {
    let has_temperatures = |circle: &&CircleInput| {
        circle.traces.iter().flat_map(|trace| &trace.points).all(|point| point.temp_c.is_some())
    };
    let warm: Vec<&CircleInput> = circles.iter().filter(has_temperatures).collect();
    let options = [
        ("--expansion", args.expansion),
        ("--machine-expansion", args.machine_expansion),
        ("--certified", args.certified),
    ];
    match options.into_iter().find(|(_, value)| value.is_some()) {
        Some((option, _)) if warm.is_empty() => Some(CircularFinding::NoTemperature { option }),
        _ if args.certified.is_some()
            && warm.iter().all(|circle| temperature(args, circle.certified).bar_per_k.is_none()) =>
        {
            Some(CircularFinding::CertifiedAlone)
        }
        _ => None,
    }
}

fn evaluate(circle: CircleInput, args: &CircleArgs) -> Result<CircleTest, Diagnostic> {
    let CircleInput { source, number, radius_mm, traces, notes, certified, bar_u_mm } = circle;
    let settings = CircularSettings {
        sigma_mm: args.sigma,
        bar_u_mm: args.bar_u.or(bar_u_mm).unwrap_or(0.0),
        temperature: temperature(args, certified),
        draws: args.monte_carlo,
        ..CircularSettings::new(radius_mm)
    };
    let mut evaluation =
        circular::circular(&traces, &settings).map_err(|finding| Diagnostic::file(&source, finding))?;
    evaluation.notes.splice(0..0, notes);
    if settings.temperature.machine_per_k.is_some() && settings.temperature.bar_per_k.is_none() {
        evaluation.notes.push(CircularFinding::BarAsMeasured);
    }
    Ok(CircleTest { source, circle: number, evaluation })
}

/// The temperature settings of the command line, else those of the certificate.
fn temperature(args: &CircleArgs, certified: Option<ThermalExpansion>) -> ThermalExpansion {
    let certified = certified.unwrap_or_default();
    ThermalExpansion {
        bar_per_k: args.expansion.or(certified.bar_per_k),
        certified_c: args.certified.unwrap_or(certified.certified_c),
        machine_per_k: args.machine_expansion,
    }
}

fn from_csv(name: &str, traces: Vec<CircleTrace>, radius: Option<f64>) -> CircleInput {
    let mut notes = Vec::new();
    let lengths = || traces.iter().flat_map(|trace| &trace.points).map(|point| point.length_mm);
    let mean: f64 = lengths().sum::<f64>() / lengths().count().max(1) as f64;
    notes.extend(radius.and_then(|radius_mm| other_radius(radius_mm, mean)));
    let radius_mm = radius.unwrap_or_else(|| {
        notes.push(CircularFinding::RadiusAssumed { radius_mm: mean.round() });
        mean.round()
    });
    CircleInput {
        source: name.to_owned(),
        number: None,
        radius_mm,
        traces,
        notes,
        certified: None,
        bar_u_mm: None,
    }
}

/// A finding if the mean length is near a whole millimetre, as programs have it, and far from --radius.
fn other_radius(radius_mm: f64, mean_mm: f64) -> Option<CircularFinding> {
    /// How many times nearer the whole millimetre must be.
    const NEARER: f64 = 5.0;
    const MIN_OTHER_RADIUS_MM: f64 = 0.1;
    let off_mm = (mean_mm - radius_mm).abs();
    let is_other = off_mm > MIN_OTHER_RADIUS_MM && off_mm > NEARER * (mean_mm - mean_mm.round()).abs();
    (is_other && radius_mm != mean_mm.round()).then_some(CircularFinding::OtherRadius { mean_mm, radius_mm })
}

/// The circles of a capture, and the capture.
fn from_capture(
    path: &Path,
    args: &CircleArgs,
    out: &CommandOutput,
) -> Result<(Vec<CircleInput>, TracedArtefact), Diagnostic> {
    let run = run::open_run(path, args.plan.as_deref(), &args.axes, &mut |finding| out.finding(finding))?;
    let (certified, bar_u_mm) = (run.certificate(), run.plan.header.job.bar.u_mm());
    let circles = run.circles()?;
    out.findings(circles.findings);
    let (measured, empty): (Vec<_>, Vec<_>) =
        circles.circles.into_iter().partition(|circle| circle.measured() > 0);
    if measured.is_empty() {
        return Err(Diagnostic::file(path.display(), MatchingFinding::NoCircle));
    }
    let without_length = |circle: run::MeasuredCircle| CircularFinding::CircleWithoutLength {
        circle: circle.number,
        poses: circle.lost,
    };
    out.findings_in(path.display(), empty.into_iter().map(without_length));
    let circles = measured.into_iter().map(|circle| CircleInput {
        source: format!("{}, circle {}", path.display(), circle.number),
        number: Some(circle.number),
        radius_mm: args.radius.unwrap_or(circle.radius_mm),
        notes: notes(&circle, args.radius),
        traces: circle.traces,
        certified,
        bar_u_mm,
    });
    Ok((circles.collect(), run.traced(path)?))
}

/// Findings about lost poses of a circle, and about a --radius that is not the plan's.
fn notes(circle: &run::MeasuredCircle, radius: Option<f64>) -> Vec<CircularFinding> {
    /// The resolution of printed plans, mm.
    const PRINTED_MM: f64 = 0.01;
    let planned_mm = circle.radius_mm;
    let other = radius.filter(|radius_mm| (radius_mm - planned_mm).abs() > PRINTED_MM);
    let other = other.map(|radius_mm| CircularFinding::RadiusOfPlan { radius_mm, planned_mm });
    let (lost, poses) = (circle.lost, circle.lost + circle.measured());
    let percent = 100.0 * lost as f64 / poses.max(1) as f64;
    let without_length = (lost > 0).then_some(CircularFinding::PosesWithoutLength { lost, poses, percent });
    without_length.into_iter().chain(other).collect()
}

fn show_circular_test(test: &CircleTest, out: &CommandOutput) {
    let CircularEvaluation { radius_mm, arc, traces, .. } = &test.evaluation;
    let points: usize = traces.iter().map(|trace| trace.points).sum();
    out.result(format!(
        "{}: radius {radius_mm} mm, {points} points, {:.0} degrees, condition {:.1}",
        test.source, arc.span_deg, arc.condition
    ));
    for (name, quantity) in QUANTITY_NAMES.iter().zip(&test.evaluation.quantities) {
        if let Some(value) = quantity.value {
            let u95 = quantity.u95.map_or(String::new(), |u| format!(" +- {u:.5}"));
            out.result(format!("  {name:6} {value:10.5}{u95} mm"));
        }
    }
}
