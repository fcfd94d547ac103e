//! `circle.json`: circular tests by the quantities of ISO 230-4.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::circle::CircleTest;
use dbbd_model::circular::{
    DriveBacklash, DriveId, HarmonicDiagnosis, Harmonics, QUANTITY_NAMES, TERM_NAMES, TRACE_NAMES,
    TraceResult,
};
use dbbd_model::provenance::Provenance;

/// Most deviations of a trace. A longer trace is sampled evenly.
const DEVIATIONS: usize = 2000;

/// Adds a value and the half width of its 95 % interval to a JSON object.
fn put(object: &mut Value, name: &str, value: impl Serialize, u95: impl Serialize) {
    object[name] = json!(value);
    object[format!("{name}_u95")] = json!(u95);
}

/// The keys of the first test are at the top; if there are several tests, all follow under `tests`.
pub fn document(tests: &[CircleTest], provenance: &Provenance) -> Value {
    let tests: Vec<Value> = tests.iter().map(test_document).collect();
    let mut document = tests.first().cloned().unwrap_or_else(|| json!({}));
    document["schema"] = json!(1);
    document["provenance"] = json!(provenance);
    if tests.len() > 1 {
        document["tests"] = json!(tests);
    }
    document
}

fn test_document(test: &CircleTest) -> Value {
    let evaluation = &test.evaluation;
    let arc = &evaluation.arc;
    let reversals = evaluation.reversals.iter().map(|at| {
        json!({ "run": at.run, "direction": at.sense.word(), "joint": at.joint, "angle_deg": at.angle_deg })
    });
    let mut document = json!({
        "source": test.source,
        "circle": test.circle,
        "radius_mm": evaluation.radius_mm,
        "arc": {
            "from_deg": arc.from_deg, "span_deg": arc.span_deg, "largest_gap_deg": arc.largest_gap_deg,
            "full": arc.full, "condition": arc.condition,
        },
        "F_centre": if evaluation.free_centre { "least_squares" } else { "instrument" },
        "traces": evaluation.traces.iter().map(trace_document).collect::<Vec<_>>(),
        "joint_reversals": reversals.collect::<Vec<_>>(),
        "reversal_steps": evaluation.steps.iter().map(step_document).collect::<Vec<_>>(),
        "length_sigma_mm": evaluation.sigma_mm,
        "length_sigma_source": evaluation.sigma_source.word(),
        "monte_carlo_draws": evaluation.draws,
        "notes": evaluation.notes,
    });
    for (name, quantity) in QUANTITY_NAMES.iter().zip(&evaluation.quantities) {
        put(&mut document, name, quantity.value, quantity.u95);
    }
    if let Some(values) = &evaluation.as_measured {
        let named = QUANTITY_NAMES.iter().zip(values).map(|(name, value)| ((*name).to_owned(), json!(value)));
        document["as_measured"] = Value::Object(named.collect::<Map<_, _>>());
    }
    put_diagnosis(&mut document, &evaluation.diagnosis);
    document
}

fn trace_document(trace: &TraceResult) -> Value {
    let stride = trace.deviations.len().div_ceil(DEVIATIONS).max(1);
    let deviations: Vec<&[f64; 2]> = trace.deviations.iter().step_by(stride).collect();
    let mut document = json!({
        "run": trace.run, "direction": trace.sense.word(), "points": trace.points, "deviations": deviations,
    });
    for (name, quantity) in TRACE_NAMES.iter().zip(&trace.quantities) {
        put(&mut document, name, quantity.value, quantity.u95);
    }
    document
}

fn put_diagnosis(document: &mut Value, diagnosis: &HarmonicDiagnosis) {
    let harmonics = |harmonics: &Harmonics| {
        let mut document = json!({ "direction": harmonics.sense.word() });
        for (at, name) in TERM_NAMES.iter().enumerate() {
            put(&mut document, name, harmonics.values_mm[at], harmonics.u95_mm[at]);
        }
        document
    };
    document["harmonics"] = diagnosis.harmonics.iter().map(harmonics).collect();
    for (name, pair) in [
        ("scale_mismatch", diagnosis.scale_mismatch),
        ("squareness_rad", diagnosis.squareness_rad),
        ("servo_mismatch_s", diagnosis.servo_mismatch_s),
    ] {
        put(document, name, pair.map(|[value, _]| value), pair.map(|[_, u95]| u95));
    }
}

fn step_document(step: &DriveBacklash) -> Value {
    let (mover, number, play) = match step.mover {
        DriveId::Axis(axis) => ("axis", json!(axis), "play_mm"),
        DriveId::Joint(joint) => ("joint", json!(joint), "play_rad"),
    };
    let mut document = json!({ mover: number, "largest_step_mm": step.most_mm });
    put(&mut document, play, step.play, step.u95);
    document
}
