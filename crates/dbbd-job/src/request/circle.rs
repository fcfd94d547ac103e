//! Evaluates circular tests according to ISO 230-4.

use std::path::{Path, PathBuf};

use dbbd_model::base::expansion::ThermalExpansion;
use dbbd_model::base::serialised;
use dbbd_model::circular::CircularFinding;
use dbbd_model::circular::{self, CircleTrace, CircularSettings};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{ArtefactRole, Provenance, TracedArtefact, one_robot};
use serde::{Deserialize, Serialize, Serializer};

use super::{AnswerOutcome, RequestResult, RequestSession, earlier};
use crate::file_set::{EarlierFiles, FileSet};
use crate::recording::matching::MatchingFinding;
use crate::recording::run;
use crate::report;
use crate::report::circle::CircleTest;

/// Which circles shall be evaluated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CircleRequest {
    /// Captures that contain a plan, or tables. Several are shown as a trend, in this order.
    pub inputs: Vec<PathBuf>,
    /// The directory of the result.
    pub out: PathBuf,
    /// Nominal radius; `None` for the radius in the plan, or for a table the mean length, rounded to a millimetre.
    pub radius_mm: Option<f64>,
    /// The plan that the robot executed; `None` for the one in the capture.
    pub plan: Option<PathBuf>,
    /// The data lists that the programs logged their axis angles to.
    #[serde(default)]
    pub axes: Vec<PathBuf>,
    /// Standard uncertainty of a single length; `None` for the uncertainty of the dwells, or for a table the scatter.
    pub sigma_mm: Option<f64>,
    /// Standard uncertainty (k = 1) of the bar's length; `None` for the value in the job of a capture.
    pub bar_u_mm: Option<f64>,
    /// Thermal expansion of the bar, 1/K; `None` for the value in the job of a capture.
    pub expansion_per_k: Option<f64>,
    /// Temperature of the bar's certificate, degrees Celsius; `None` for the value in the job of a capture, else 20.
    pub certified_c: Option<f64>,
    /// Thermal expansion of the machine, 1/K.
    pub machine_expansion_per_k: Option<f64>,
    /// Number of Monte Carlo draws for the intervals; 0 for none.
    #[serde(default = "default_draws")]
    pub monte_carlo: usize,
    /// Replace the files of an earlier result; otherwise they are kept beside it.
    #[serde(default)]
    pub replace: bool,
}

/// The default number of Monte Carlo draws.
pub const DEFAULT_DRAWS: usize = 1000;

fn default_draws() -> usize {
    DEFAULT_DRAWS
}

/// `circle.json`.
#[derive(Clone, Debug)]
pub struct CircleDocument {
    pub tests: Vec<CircleTest>,
    pub provenance: Provenance,
}

impl Serialize for CircleDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        report::circle_json::document(&self.tests, &self.provenance).serialize(serializer)
    }
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

impl CircleRequest {
    pub(super) fn result(
        &self,
        session: &RequestSession<'_>,
    ) -> Result<RequestResult<CircleDocument>, Diagnostic> {
        let (circles, sources) = read_circles(self, session)?;
        for (at, source) in sources.iter().enumerate() {
            if sources[..at].iter().any(|other| other.artefact.sha256 == source.artefact.sha256) {
                session.finding(ProvenanceFinding::GivenTwice { lengths: source.artefact.to_string() });
            }
        }
        one_robot(self.inputs.iter().map(|path| path.display().to_string()).zip(&sources))?;
        if let Some(unused) = unused_option(self, &circles) {
            return Err(unused.into());
        }
        let provenance = crate::artefact::made_from(&sources);
        session.findings(provenance.of_origin());
        let robot = provenance.robot().map(|robot| robot.name.as_str());
        earlier::check_replaced(&self.out.join("circle.json"), robot, &provenance)?;
        let (mut tests, count) = (Vec::new(), circles.len());
        for (at, circle) in circles.into_iter().enumerate() {
            session.done(50 + u8::try_from(40 * at / count).unwrap_or(40));
            tests.push(evaluate(circle, self)?);
        }
        session.done(90);
        let document = CircleDocument { tests, provenance };
        let files = self.write(&document)?;
        for CircleTest { source, evaluation, .. } in &document.tests {
            session.findings(evaluation.notes.iter().map(|note| note.clone().in_file(source)));
        }
        Ok(RequestResult { outcome: AnswerOutcome::Done, files, document })
    }

    /// Writes the files of a circular test, and returns their names.
    fn write(&self, document: &CircleDocument) -> Result<Vec<String>, Diagnostic> {
        let CircleDocument { tests, provenance } = document;
        let mut set = FileSet::begin(&self.out, EarlierFiles::kept_unless(self.replace))?;
        for (at, test) in tests.iter().enumerate() {
            let name = if at == 0 { "circle.svg".to_owned() } else { format!("circle-{}.svg", at + 1) };
            set.write(&name, report::svg::standalone(&test.svg()))?;
        }
        // Remove the plots of circles that are left from an earlier evaluation.
        let further = (tests.len() + 1..).map(|number| format!("circle-{number}.svg"));
        further.take_while(|file| self.out.join(file).exists()).for_each(|file| set.remove(&file));
        set.write("circle.json", serialised::sealed_json(document)?)?;
        set.write("circle.html", report::circle::html(tests, provenance)?)?;
        set.finish()
    }
}

/// The circles of all inputs, and the inputs.
fn read_circles(
    request: &CircleRequest,
    session: &RequestSession<'_>,
) -> Result<(Vec<CircleInput>, Vec<TracedArtefact>), Diagnostic> {
    let captures = request.inputs.iter().map(|path| run::is_capture(path)).collect::<Result<Vec<_>, _>>()?;
    if !captures.contains(&true) && (request.plan.is_some() || !request.axes.is_empty()) {
        return Err(CircularFinding::NoCapture.into());
    }
    let (mut circles, mut sources) = (Vec::new(), Vec::new());
    for (path, is_capture) in request.inputs.iter().zip(captures) {
        if is_capture {
            let (of_capture, capture) = from_capture(path, request, session)?;
            circles.extend(of_capture);
            sources.push(capture);
        } else {
            let traces = session.table(path, circular::traces_from_table)?;
            circles.push(from_csv(&path.display().to_string(), traces, request.radius_mm));
            sources.push(crate::artefact::of_file(ArtefactRole::Measurements, path)?.into());
        }
    }
    Ok((circles, sources))
}

/// The first temperature of the request that has no effect on any circle.
fn unused_option(request: &CircleRequest, circles: &[CircleInput]) -> Option<CircularFinding> {
    let has_temperatures = |circle: &&CircleInput| {
        circle.traces.iter().flat_map(|trace| &trace.points).all(|point| point.temp_c.is_some())
    };
    let warm: Vec<&CircleInput> = circles.iter().filter(has_temperatures).collect();
    let inputs = [
        ("the expansion of the bar", request.expansion_per_k),
        ("the expansion of the machine", request.machine_expansion_per_k),
        ("the temperature of the certificate", request.certified_c),
    ];
    match inputs.into_iter().find(|(_, value)| value.is_some()) {
        Some((input, _)) if warm.is_empty() => Some(CircularFinding::NoTemperature { input }),
        _ if request.certified_c.is_some()
            && warm.iter().all(|circle| temperature(request, circle.certified).bar_per_k.is_none()) =>
        {
            Some(CircularFinding::CertifiedAlone)
        }
        _ => None,
    }
}

fn evaluate(circle: CircleInput, request: &CircleRequest) -> Result<CircleTest, Diagnostic> {
    let CircleInput { source, number, radius_mm, traces, notes, certified, bar_u_mm } = circle;
    let settings = CircularSettings {
        sigma_mm: request.sigma_mm,
        bar_u_mm: request.bar_u_mm.or(bar_u_mm).unwrap_or(0.0),
        temperature: temperature(request, certified),
        draws: request.monte_carlo,
        ..CircularSettings::new(radius_mm)
    };
    let mut evaluation =
        circular::circular(&traces, &settings).map_err(|finding| Diagnostic::file(&source, finding))?;
    evaluation.notes.splice(0..0, notes.into_iter().map(Diagnostic::from));
    if settings.temperature.machine_per_k.is_some() && settings.temperature.bar_per_k.is_none() {
        evaluation.notes.push(CircularFinding::BarAsMeasured.into());
    }
    Ok(CircleTest { source, circle: number, evaluation })
}

/// The temperature settings of the request, else those of the certificate.
fn temperature(request: &CircleRequest, certified: Option<ThermalExpansion>) -> ThermalExpansion {
    let certified = certified.unwrap_or_default();
    ThermalExpansion {
        bar_per_k: request.expansion_per_k.or(certified.bar_per_k),
        certified_c: request.certified_c.unwrap_or(certified.certified_c),
        machine_per_k: request.machine_expansion_per_k,
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

/// The finding if the mean length is near a whole millimetre, as in programs, and far from the radius of the request.
fn other_radius(radius_mm: f64, mean_mm: f64) -> Option<CircularFinding> {
    /// Ratio by which the whole millimetre must be nearer than the radius.
    const NEARER: f64 = 5.0;
    const MIN_OTHER_RADIUS_MM: f64 = 0.1;
    let off_mm = (mean_mm - radius_mm).abs();
    let is_other = off_mm > MIN_OTHER_RADIUS_MM && off_mm > NEARER * (mean_mm - mean_mm.round()).abs();
    (is_other && radius_mm != mean_mm.round()).then_some(CircularFinding::OtherRadius { mean_mm, radius_mm })
}

/// The circles of a capture, and the capture.
fn from_capture(
    path: &Path,
    request: &CircleRequest,
    session: &RequestSession<'_>,
) -> Result<(Vec<CircleInput>, TracedArtefact), Diagnostic> {
    let run =
        run::open_run(path, request.plan.as_deref(), &request.axes, &mut |finding| session.finding(finding))?;
    let (certified, bar_u_mm) = (run.bar_expansion(), run.plan.header.job.bar.u_mm());
    let circles = run.circles()?;
    session.findings(circles.findings);
    let (measured, empty): (Vec<_>, Vec<_>) =
        circles.circles.into_iter().partition(|circle| circle.measured() > 0);
    if measured.is_empty() {
        return Err(Diagnostic::file(path.display(), MatchingFinding::NoCircle));
    }
    let without_length = |circle: run::MeasuredCircle| CircularFinding::CircleWithoutLength {
        circle: circle.number,
        poses: circle.lost,
    };
    session.findings_in(path.display(), empty.into_iter().map(without_length));
    let circles = measured.into_iter().map(|circle| CircleInput {
        source: format!("{}, circle {}", path.display(), circle.number),
        number: Some(circle.number),
        radius_mm: request.radius_mm.unwrap_or(circle.radius_mm),
        notes: notes(&circle, request.radius_mm),
        traces: circle.traces,
        certified,
        bar_u_mm,
    });
    Ok((circles.collect(), run.traced(path)?))
}

/// Findings about lost poses of a circle, and about a radius that is not the plan's.
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
