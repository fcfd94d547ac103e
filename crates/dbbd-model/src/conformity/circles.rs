//! Comparison of circular tests of one machine over time.

use crate::estimation::ResultFinding;
use crate::estimation::result::check_schema;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::ResultTimeline;
use super::tracked::{TrackedQuantity, TrackedValue, ValueSeries, track};
use crate::circular::{CircleSense, QUANTITY_NAMES};
use crate::conformity::ConformityFinding;
use crate::diagnostic::Diagnostic;
use crate::math::distributions::COVERAGE_95;
use crate::math::straight_line::LevelCrossing;
use crate::provenance::Provenance;

const CIRCLE_FILE_SCHEMA: u32 = 1;
/// Position of the base ball, which changes with its mounting.
const PLACES: [&str; 2] = ["x", "y"];
/// The circular deviation to which the tolerance applies: the first of these that the tests have.
const DEVIATIONS: [&str; 2] = ["Gb", "G_lsc"];

/// The content of a circle.json.
#[derive(Clone, Debug)]
pub struct CircleFile {
    pub file: String,
    pub circles: Vec<StoredCircle>,
    /// SHA-256 of its source.
    made_from: Option<String>,
}

/// A circle of a circle.json.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredCircle {
    /// Number in the plan.
    pub circle: Option<u32>,
    pub radius_mm: f64,
    /// The quantities in the order of [`QUANTITY_NAMES`], with standard deviations from the 95 % intervals.
    quantities: Vec<Option<TrackedValue>>,
    pub traces: Vec<StoredTrace>,
    /// Covered angle, degrees; `None` in files of earlier versions.
    span_deg: Option<f64>,
}

/// A trace of a circle.json.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct StoredTrace {
    pub direction: CircleSense,
    /// Angle (degrees) and deviation (mm); empty in files of earlier versions.
    #[serde(default)]
    pub deviations: Vec<[f64; 2]>,
}

/// A circle in all files.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedCircle {
    pub circle: Option<u32>,
    pub radius_mm: f64,
    pub quantities: Vec<TrackedQuantity<&'static str>>,
    /// The time at which the trend of the circular deviation reaches the tolerance.
    pub reaches_tolerance: Option<LevelCrossing>,
    /// The traces of each file.
    #[serde(skip)]
    pub traces: Vec<Vec<StoredTrace>>,
}

impl CircleFile {
    pub fn from_json(file: &str, json: &Json) -> Result<Self, Diagnostic> {
        let wrong = |finding| Diagnostic::file(file, finding);
        check_schema(json, CIRCLE_FILE_SCHEMA).map_err(wrong)?;
        let circles = match json.get("tests").and_then(Json::as_array) {
            Some(tests) => tests.iter().map(StoredCircle::from_json).collect(),
            None => StoredCircle::from_json(json).map(|circle| vec![circle]),
        };
        // The last source is the newest.
        let made = json.get("provenance").and_then(|made| Provenance::deserialize(made).ok());
        let made_from = made.and_then(|made| Some(made.from.last()?.sha256.clone()));
        Ok(Self { file: file.into(), circles: circles.map_err(wrong)?, made_from })
    }
}

impl StoredCircle {
    fn from_json(json: &Json) -> Result<Self, ResultFinding> {
        #[derive(Deserialize)]
        struct CircleFields {
            circle: Option<u32>,
            radius_mm: f64,
            traces: Vec<StoredTrace>,
            arc: Option<ArcFields>,
        }
        #[derive(Deserialize)]
        struct ArcFields {
            span_deg: f64,
        }
        let incomplete = |error: serde_json::Error| ResultFinding::Incomplete { why: error.to_string() };
        let CircleFields { circle, radius_mm, traces, arc } =
            CircleFields::deserialize(json).map_err(incomplete)?;
        let number = |name: &str| json.get(name).and_then(Json::as_f64);
        let quantity = |name: &&str| {
            let u95 = number(&format!("{name}_u95")).filter(|u95| *u95 > 0.0)?;
            Some(TrackedValue { value: number(name)?, sd: u95 / COVERAGE_95, freedom: None })
        };
        Ok(Self {
            circle,
            radius_mm,
            quantities: QUANTITY_NAMES.iter().map(quantity).collect(),
            traces,
            span_deg: arc.map(|arc| arc.span_deg),
        })
    }

    /// Whether both are tests of the same circle.
    fn is_same_circle(&self, other: &Self) -> bool {
        self.circle == other.circle && self.radius_mm == other.radius_mm
    }
}

/// Arcs whose spans differ by more are not comparable, degrees.
const ALIKE_DEG: f64 = 20.0;

/// Findings about tests that are not comparable.
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
            let again = first.circles.iter().find(|first| first.is_same_circle(circle));
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

/// Compares the circles that are in all files. `repeat_u_mm` is the standard uncertainty of the repeatability of a
/// quantity from run to run. It is an error if no circle is in all files.
pub fn compare_circles(
    files: &[CircleFile],
    timeline: &ResultTimeline,
    tolerance_mm: Option<f64>,
    repeat_u_mm: f64,
) -> Result<Vec<ComparedCircle>, Diagnostic> {
    let Some((first, others)) = files.split_first() else { return Ok(Vec::new()) };
    let mut compared = Vec::new();
    for circle in &first.circles {
        let again = others.iter().map(|file| file.circles.iter().find(|other| other.is_same_circle(circle)));
        let Some(again) = again.collect::<Option<Vec<&StoredCircle>>>() else { continue };
        let tests: Vec<&StoredCircle> = std::iter::once(circle).chain(again).collect();
        compared.push(compare(&tests, timeline, tolerance_mm, repeat_u_mm));
    }
    if compared.is_empty() {
        let last = files.last().map_or("", |file| file.file.as_str());
        let finding = ConformityFinding::NothingInCommon { first: first.file.clone() };
        return Err(Diagnostic::file(last, finding));
    }
    Ok(compared)
}

/// Compares the tests of one circle.
fn compare(
    tests: &[&StoredCircle],
    timeline: &ResultTimeline,
    tolerance_mm: Option<f64>,
    repeat_u_mm: f64,
) -> ComparedCircle {
    let named = QUANTITY_NAMES.iter().enumerate().filter(|(_, name)| !PLACES.contains(name));
    let series = named.filter_map(|(at, name)| {
        let values: Option<Vec<TrackedValue>> = tests.iter().map(|test| test.quantities[at]).collect();
        let repeated = |value: TrackedValue| TrackedValue { sd: value.sd.hypot(repeat_u_mm), ..value };
        Some(ValueSeries { name: *name, unit: "mm", values: values?.into_iter().map(repeated).collect() })
    });
    let quantities = track(series.collect(), timeline);
    let deviation = DEVIATIONS.iter().find_map(|name| quantities.iter().find(|q| q.name == *name));
    let trend = deviation.and_then(|quantity| quantity.trend).filter(|trend| trend.significant);
    let reaches_tolerance = trend
        .zip(tolerance_mm)
        .and_then(|(trend, tolerance)| trend.line.reaches(tolerance, timeline.last(), COVERAGE_95));
    let first = tests.first();
    ComparedCircle {
        circle: first.and_then(|test| test.circle),
        radius_mm: first.map_or(f64::NAN, |test| test.radius_mm),
        quantities,
        reaches_tolerance,
        traces: tests.iter().map(|test| test.traces.clone()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, gb: f64, u95: f64, span_deg: f64, source: &str) -> CircleFile {
        let json = serde_json::json!({
            "schema": 1, "radius_mm": 150.0, "circle": 2, "Gb": gb, "Gb_u95": u95, "D": 0.01, "D_u95": 0.0, "x": 1.0,
            "x_u95": 0.1, "traces": [{ "direction": "cw", "deviations": [[0.0, 0.001]] }],
            "arc": { "span_deg": span_deg },
            "provenance": { "from": [{ "role": "measurements", "name": "t", "sha256": source }] },
        });
        CircleFile::from_json(name, &json).unwrap()
    }

    #[test]
    fn a_circle_is_read_with_standard_deviations() {
        let file = file("a.json", 0.02, 0.00196, 360.0, "1");
        let circle = &file.circles[0];
        assert_eq!((circle.circle, circle.radius_mm, circle.span_deg), (Some(2), 150.0, Some(360.0)));
        let gb = circle.quantities[2].unwrap();
        assert!((gb.sd - 0.001).abs() < 1e-15 && gb.value == 0.02);
        // An interval of zero says nothing.
        assert_eq!(circle.quantities[3], None);
        assert_eq!(circle.traces[0].direction, CircleSense::Clockwise);
        let other = serde_json::json!({ "schema": 2, "radius_mm": 150.0, "traces": [] });
        assert!(CircleFile::from_json("b.json", &other).is_err());
        assert!(CircleFile::from_json("c.json", &serde_json::json!({ "schema": 1 })).is_err());
    }

    /// The line through 0.020, 0.022, 0.024, 0.026 reaches 0.030 two results after the last.
    #[test]
    fn the_trend_of_the_circular_deviation_reaches_the_tolerance() {
        let files: Vec<CircleFile> = [0.020, 0.022, 0.024, 0.026]
            .iter()
            .map(|gb| file("a.json", *gb, 0.000196, 360.0, &gb.to_string()))
            .collect();
        let timeline = ResultTimeline::numbered(4);
        let compared = compare_circles(&files, &timeline, Some(0.030), 0.0).unwrap();
        assert_eq!((compared.len(), compared[0].quantities.len(), compared[0].traces.len()), (1, 1, 4));
        let reached = compared[0].reaches_tolerance.unwrap();
        assert!((reached.at - 5.0).abs() < 1e-9 && reached.earliest < 5.0, "{reached:?}");
        // The repeatability from run to run adds in squares.
        let repeated = compare_circles(&files, &timeline, Some(0.030), 0.01).unwrap();
        assert!((repeated[0].quantities[0].values[1].sd - 0.0001f64.hypot(0.01)).abs() < 1e-15);
        assert!(repeated[0].reaches_tolerance.is_none(), "no significant trend");
        assert!(compare_circles(&files, &timeline, None, 0.0).unwrap()[0].reaches_tolerance.is_none());
        assert_eq!(compare_circles(&[], &timeline, None, 0.0).unwrap(), []);
    }

    #[test]
    fn tests_that_are_not_comparable_are_reported() {
        let first = file("a.json", 0.02, 0.002, 360.0, "1");
        let arc =
            |span_deg, source: &str| unlike(&[first.clone(), file("b.json", 0.02, 0.002, span_deg, source)]);
        assert!(arc(341.0, "2").is_empty());
        assert!(matches!(
            arc(339.0, "2")[..],
            [ConformityFinding::ArcAndCircle { span_deg: 339.0, first_deg: 360.0, .. }]
        ));
        assert!(matches!(arc(360.0, "1")[..], [ConformityFinding::SameLengths { .. }]));
        let mut other = file("b.json", 0.02, 0.002, 360.0, "2");
        other.circles[0].radius_mm = 100.0;
        let nothing = compare_circles(&[first, other], &ResultTimeline::numbered(2), None, 0.0);
        assert!(nothing.is_err());
    }
}
