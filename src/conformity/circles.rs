//! Circular tests of one machine in the order of time.

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::Timeline;
use super::tracked::{Series, Tracked, Value, track};
use crate::catalogue::ConformityFinding;
use crate::circular::{NAMES, Sense};
use crate::diagnostic::Diagnostic;
use crate::math::straight_line::Reached;
use crate::provenance::Provenance;

/// The schema that is known.
const SCHEMA: u32 = 1;
/// Half width of a 95 % interval in standard deviations.
const COVERAGE: f64 = 1.96;
/// Quantities that say where the base ball is, which mounting changes.
const PLACES: [&str; 2] = ["x", "y"];
/// The circular deviation, to which the tolerance applies: the first that is in the tests.
const DEVIATIONS: [&str; 2] = ["Gb", "G_lsc"];

/// A circle.json that was read.
#[derive(Clone, Debug)]
pub struct CircleFile {
    pub file: String,
    pub circles: Vec<CircleRead>,
    /// SHA-256 of what it was made from.
    made_from: Option<String>,
}

/// A circle of a circle.json.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleRead {
    /// Its number in the plan, where there is one.
    pub circle: Option<u32>,
    pub radius_mm: f64,
    /// By [`NAMES`], with half widths of 95 % intervals made standard deviations.
    quantities: Vec<Option<Value>>,
    pub traces: Vec<TraceRead>,
    /// The angle that it covers, degrees; not in files of earlier versions.
    span_deg: Option<f64>,
}

/// A trace of a circle.json.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct TraceRead {
    pub direction: Sense,
    /// Angle (degrees) and deviation (mm); empty in files of earlier versions.
    #[serde(default)]
    pub deviations: Vec<[f64; 2]>,
}

/// A circle side by side.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CircleCompared {
    pub circle: Option<u32>,
    pub radius_mm: f64,
    pub quantities: Vec<Tracked<&'static str>>,
    /// When the trend of the circular deviation reaches the tolerance.
    pub reaches_tolerance: Option<Reached>,
    /// Of each file.
    #[serde(skip)]
    pub traces: Vec<Vec<TraceRead>>,
}

/// That a file has the schema that is known.
pub(super) fn check_schema(json: &Json, known: u32) -> Result<(), ConformityFinding> {
    match json.get("schema") {
        Some(schema) if schema.as_u64() == Some(u64::from(known)) => Ok(()),
        schema => {
            let schema = schema.map_or("none".into(), ToString::to_string);
            Err(ConformityFinding::OtherSchema { schema, known })
        }
    }
}

impl CircleFile {
    /// # Errors
    /// What is no circle.json of the known schema.
    pub fn from_json(file: &str, json: &Json) -> Result<Self, Diagnostic> {
        let wrong = |finding| Diagnostic::file(file, finding);
        check_schema(json, SCHEMA).map_err(wrong)?;
        let circles = match json.get("tests").and_then(Json::as_array) {
            Some(tests) => tests.iter().map(CircleRead::from_json).collect(),
            None => CircleRead::from_json(json).map(|circle| vec![circle]),
        };
        // The newest source comes last.
        let made = json.get("provenance").and_then(|made| Provenance::deserialize(made).ok());
        let made_from = made.and_then(|made| Some(made.from.last()?.sha256.clone()));
        Ok(Self { file: file.into(), circles: circles.map_err(wrong)?, made_from })
    }
}

impl CircleRead {
    fn from_json(json: &Json) -> Result<Self, ConformityFinding> {
        #[derive(Deserialize)]
        struct Fields {
            circle: Option<u32>,
            radius_mm: f64,
            traces: Vec<TraceRead>,
            arc: Option<Arc>,
        }
        #[derive(Deserialize)]
        struct Arc {
            span_deg: f64,
        }
        let incomplete = |error: serde_json::Error| ConformityFinding::Incomplete { why: error.to_string() };
        let Fields { circle, radius_mm, traces, arc } = Fields::deserialize(json).map_err(incomplete)?;
        let number = |name: &str| json.get(name).and_then(Json::as_f64);
        let quantity = |name: &&str| {
            let u95 = number(&format!("{name}_u95")).filter(|u95| *u95 > 0.0)?;
            Some(Value { value: number(name)?, sd: u95 / COVERAGE, freedom: None })
        };
        Ok(Self {
            circle,
            radius_mm,
            quantities: NAMES.iter().map(quantity).collect(),
            traces,
            span_deg: arc.map(|arc| arc.span_deg),
        })
    }

    /// Whether two are tests of one circle.
    fn is_again(&self, other: &Self) -> bool {
        self.circle == other.circle && self.radius_mm == other.radius_mm
    }
}

/// Two arcs whose spans differ by more are not one circle measured again, degrees.
const ALIKE_DEG: f64 = 20.0;

/// What is not alike in tests that are compared.
pub fn unlike(files: &[CircleFile]) -> Vec<ConformityFinding> {
    let Some((first, others)) = files.split_first() else { return Vec::new() };
    let mut findings = Vec::new();
    for (at, file) in others.iter().enumerate() {
        let same = |before: &&CircleFile| before.made_from.is_some() && before.made_from == file.made_from;
        if let Some(same) = files.iter().take(at + 1).find(same) {
            let (file, first) = (file.file.clone(), same.file.clone());
            findings.push(ConformityFinding::SameLengths { file, first });
        }
        for circle in &file.circles {
            let again = first.circles.iter().find(|first| first.is_again(circle));
            let spans = circle.span_deg.zip(again.and_then(|again| again.span_deg));
            if let Some((span_deg, first_deg)) = spans.filter(|(one, other)| (one - other).abs() > ALIKE_DEG)
            {
                let (file, first) = (file.file.clone(), first.file.clone());
                findings.push(ConformityFinding::ArcAndCircle { file, span_deg, first, first_deg });
            }
        }
    }
    findings
}

/// Compares the circles that are in all files. `repeat_u_mm` is the standard uncertainty by which a quantity repeats from
/// run to run, mm.
///
/// # Errors
/// No circle that is in all.
pub fn compare_circles(
    files: &[CircleFile],
    timeline: &Timeline,
    tolerance_mm: Option<f64>,
    repeat_u_mm: f64,
) -> Result<Vec<CircleCompared>, Diagnostic> {
    let Some((first, others)) = files.split_first() else { return Ok(Vec::new()) };
    let mut compared = Vec::new();
    for circle in &first.circles {
        let again = others.iter().map(|file| file.circles.iter().find(|other| other.is_again(circle)));
        let Some(again) = again.collect::<Option<Vec<&CircleRead>>>() else { continue };
        let tests: Vec<&CircleRead> = std::iter::once(circle).chain(again).collect();
        compared.push(Tests { tests: &tests, timeline, repeat_u_mm }.compared(tolerance_mm));
    }
    if compared.is_empty() {
        let last = files.last().map_or("", |file| file.file.as_str());
        let finding = ConformityFinding::NothingInCommon { first: first.file.clone() };
        return Err(Diagnostic::file(last, finding));
    }
    Ok(compared)
}

/// The tests of one circle.
struct Tests<'a> {
    tests: &'a [&'a CircleRead],
    timeline: &'a Timeline,
    repeat_u_mm: f64,
}

impl Tests<'_> {
    fn compared(&self, tolerance_mm: Option<f64>) -> CircleCompared {
        let named = NAMES.iter().enumerate().filter(|(_, name)| !PLACES.contains(name));
        let series = named.filter_map(|(at, name)| {
            let values: Option<Vec<Value>> = self.tests.iter().map(|test| test.quantities[at]).collect();
            let repeated = |value: Value| Value { sd: value.sd.hypot(self.repeat_u_mm), ..value };
            let values = values?.into_iter().map(repeated).collect();
            Some(Series { name: *name, unit: "mm", values })
        });
        let quantities = track(series.collect(), self.timeline);
        let deviation = DEVIATIONS.iter().find_map(|name| quantities.iter().find(|q| q.name == *name));
        let trend = deviation.and_then(|quantity| quantity.trend).filter(|trend| trend.significant);
        let reaches_tolerance = trend
            .zip(tolerance_mm)
            .and_then(|(trend, tolerance)| trend.line.reaches(tolerance, self.timeline.last(), COVERAGE));
        let first = self.tests.first();
        CircleCompared {
            circle: first.and_then(|test| test.circle),
            radius_mm: first.map_or(f64::NAN, |test| test.radius_mm),
            quantities,
            reaches_tolerance,
            traces: self.tests.iter().map(|test| test.traces.clone()).collect(),
        }
    }
}
